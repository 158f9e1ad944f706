"""lens.json: jaxlens's own calibration file, read strictly and written whole.

The file says what it is (`format`, `schema_version`), which lens (`model`, a registered name, and `parameters`), what
ties it to pixels (`frame`, `image_size`), in which units, and what a fit found out (`estimate`). Unknown keys are
refused: a misspelt one would otherwise change the lens without a word.
"""

import json
import math
import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from jaxlens.calibrations._calibration import Calibration, CalibrationError, Estimate, Value, check_model
from jaxlens.files import write_text

_FORMAT = "jaxlens calibration"
_VERSION = 1
_UNITS = {
    "frame": "pixels, (x, y) order, pixel centres at integers; normalized = (pixel - center) / scale",
    "parameters": "normalized coordinates; distort takes ideal points to observed ones",
}
# A calibration has some hundred numbers: what is larger is something else.
_LARGEST = 4 * 2**20

_Number = Annotated[float, Field(allow_inf_nan=False)]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Size = Annotated[int, Field(gt=0, le=2**20)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Frame(_Strict):
    center: Annotated[list[_Number], Field(min_length=2, max_length=2)]
    scale: Annotated[list[_Positive], Field(min_length=2, max_length=2)]


class _Estimate(_Strict):
    names: list[str]
    values: list[_Number]
    covariance: list[list[_Number | None]]
    rms: _Number
    degrees_of_freedom: int


class _File(_Strict):
    format: Literal["jaxlens calibration"]
    schema_version: Literal[1]
    software: str = ""
    model: str
    parameters: dict[str, _Number | list[_Number]]
    units: dict[str, str] = {}
    frame: _Frame | None = None
    image_size: Annotated[list[_Size], Field(min_length=2, max_length=2)] | None = None
    estimate: _Estimate | None = None


def write_calibration(path: str | os.PathLike[str], calibration: Calibration, *, overwrite: bool = False) -> None:
    """Writes a calibration, whole or not at all; the same calibration is the same bytes.

    Args:
        path: The file.
        calibration: What to write.
        overwrite: Replace an existing file.

    Raises:
        CalibrationError: a number that is not finite, which JSON does not have.
        OSError: as `jaxlens.files.write_text`.
    """
    from importlib.metadata import PackageNotFoundError, version

    try:
        software = f"jaxlens {version('jaxlens')}"
    except PackageNotFoundError:
        software = "jaxlens"
    content = {
        "format": _FORMAT,
        "schema_version": _VERSION,
        "software": software,
        "model": calibration.model,
        "parameters": dict(calibration.parameters),
        "units": _UNITS,
        "frame": None if calibration.center is None else {"center": calibration.center, "scale": calibration.scale},
        "image_size": calibration.image_size,
        "estimate": _estimate(calibration.estimate),
    }
    try:
        text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False)
    except ValueError as error:
        raise CalibrationError(
            "the calibration has a number that is not finite; a fit that failed is not written"
        ) from error
    write_text(path, text + "\n", overwrite=overwrite)


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Reads what `write_calibration` has written.

    Args:
        path: The file.

    Raises:
        CalibrationError: no such file, or no calibration; the message names the file, the key and the value.
    """
    path = Path(path)
    name = repr(str(path))
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST + 1)
    except OSError as error:
        raise CalibrationError(f"cannot read the calibration {name}: {error.strerror}") from error
    if len(data) > _LARGEST:
        raise CalibrationError(f"{name} is no calibration: it is larger than {_LARGEST // 2**20} MiB")
    try:
        content = json.loads(data.decode("utf-8"), parse_constant=_refuse_constant)
    except RecursionError:
        raise CalibrationError(f"{name} is no calibration: it is nested too deeply") from None
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{name} is no calibration: it is not UTF-8 at byte {error.start}") from error
    except json.JSONDecodeError as error:
        raise CalibrationError(
            f"{name} is no calibration: not JSON at line {error.lineno}, column {error.colno}: {error.msg}"
        ) from error
    except ValueError as error:
        raise CalibrationError(f"{name}: {error}") from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise CalibrationError(f'{name} is no calibration of jaxlens: it does not say "format": "{_FORMAT}"')
    if content.get("schema_version") != _VERSION:
        raise CalibrationError(
            f"{name} has the schema version {content.get('schema_version')!r}; this jaxlens reads {_VERSION}"
        )
    try:
        file = _File.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise CalibrationError(f"{name}: {key}: {first['msg']}, got {_shown(first.get('input'))}") from error
    try:
        check_model(file.model)
    except CalibrationError as error:
        raise CalibrationError(f"{name}: model: {error}") from error
    calibration = Calibration(
        file.model,
        tuple((key, _value(value)) for key, value in sorted(file.parameters.items())),
        None if file.frame is None else (file.frame.center[0], file.frame.center[1]),
        None if file.frame is None else (file.frame.scale[0], file.frame.scale[1]),
        None if file.image_size is None else (file.image_size[0], file.image_size[1]),
        None if file.estimate is None else _checked_estimate(name, file.estimate),
    )
    return calibration


def _value(value: float | list[float]) -> Value:
    return tuple(value) if isinstance(value, list) else value


def _estimate(estimate: Estimate | None) -> dict | None:
    if estimate is None:
        return None
    covariance = [[value if math.isfinite(value) else None for value in row] for row in estimate.covariance]
    return {
        "names": estimate.names,
        "values": estimate.values,
        "covariance": covariance,
        "rms": estimate.rms,
        "degrees_of_freedom": estimate.degrees_of_freedom,
    }


def _checked_estimate(name: str, estimate: _Estimate) -> Estimate:
    count = len(estimate.names)
    if len(estimate.values) != count or [len(row) for row in estimate.covariance] != [count] * count:
        raise CalibrationError(
            f"{name}: estimate: {count} names need {count} values and a covariance of {count} × {count} numbers"
        )
    covariance = tuple(tuple(math.nan if value is None else value for value in row) for row in estimate.covariance)
    return Estimate(
        tuple(estimate.names), tuple(estimate.values), covariance, estimate.rms, estimate.degrees_of_freedom
    )


def _refuse_constant(word: str) -> float:
    raise ValueError(f"{word} is no number of JSON")


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
