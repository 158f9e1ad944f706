"""lens.json: jaxlens's own calibration file, read strictly and written whole.

The file says what it is (`format`, `schema_version`), which lens (`model`, a registered name, and `parameters`), what
ties it to pixels (`frame`, `image_size`), in which units, and what a fit found out (`estimate`). Unknown keys are
refused: a misspelt one would otherwise change the lens without a word.
"""

import json
import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from jaxlens.calibrations._calibration import Calibration, CalibrationError, Estimate, Value, check_model
from jaxlens.calibrations._documents import Document
from jaxlens.calibrations._families import single
from jaxlens.calibrations._keys import shown

_FORMAT = "jaxlens calibration"
_VERSION = 1
_UNITS = {
    "frame": "pixels, (x, y) order, pixel centres at integers; normalized = (pixel - center) / scale",
    "parameters": "normalized coordinates; distort takes ideal points to observed ones",
}

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
    name: str = ""
    model: str
    parameters: dict[str, _Number | list[_Number]]
    units: dict[str, str] = {}
    frame: _Frame | None = None
    image_size: Annotated[list[_Size], Field(min_length=2, max_length=2)] | None = None
    estimate: _Estimate | None = None


def recognizes(document: Document) -> bool:
    """Tells whether a file says that it is ours, or looks like it."""
    return document.mapping.get("format") == _FORMAT or "schema_version" in document.mapping


def render(calibrations: Sequence[Calibration]) -> str:
    """Returns the one calibration as JSON; the same calibration is the same text."""
    from importlib.metadata import PackageNotFoundError, version

    calibration = single(calibrations, "jaxlens")
    try:
        software = f"jaxlens {version('jaxlens')}"
    except PackageNotFoundError:
        software = "jaxlens"
    content = {
        "format": _FORMAT,
        "schema_version": _VERSION,
        "software": software,
        **({"name": calibration.name} if calibration.name else {}),
        "model": calibration.model,
        "parameters": dict(calibration.parameters),
        "units": _UNITS,
        "frame": None if calibration.center is None else {"center": calibration.center, "scale": calibration.scale},
        "image_size": calibration.image_size,
        "estimate": _estimate(calibration.estimate),
    }
    try:
        return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    except ValueError as error:
        raise CalibrationError(
            "the calibration has a number that is not finite; a fit that failed is not written"
        ) from error


def parse(document: Document) -> list[Calibration]:
    """Reads what `render` has written."""
    name, content = document.name, document.mapping
    if content.get("format") != _FORMAT:
        raise CalibrationError(f'{name} is no calibration of jaxlens: it does not say "format": "{_FORMAT}"')
    if content.get("schema_version") != _VERSION:
        raise CalibrationError(
            f"{name} has the schema version {shown(content.get('schema_version'))}; this jaxlens reads {_VERSION}"
        )
    try:
        file = _File.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise CalibrationError(f"{name}: {key}: {first['msg']}, got {shown(first.get('input'))}") from error
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
        name=file.name,
    )
    return [calibration]


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
