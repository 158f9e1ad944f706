"""COLMAP's cameras.txt and cameras.bin.

COLMAP counts pixels from the picture's corner: the first pixel's centre, (0, 0) here, is (½, ½) there. Its division
models have the other sign of k.
"""

import math
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from jaxlens.calibrations._calibration import Calibration, CalibrationError, Value, check_model
from jaxlens.calibrations._documents import Document
from jaxlens.calibrations._families import (
    as_brown_conrady,
    as_kannala_brandt,
    calibration,
    eucm,
    framed,
    no_room,
    padded,
    sized,
)
from jaxlens.calibrations._keys import Keys

_HALF = 0.5
_ORIGIN = (0.0, 0.0)
_MOST = 10_000
_NUMBER = re.compile(r"\d{1,9}", re.ASCII)
_ROUNDING = 1e-12


@dataclass(frozen=True)
class _Model:
    """One of COLMAP's models: its number, how many focal lengths, the family here and how many coefficients."""

    name: str
    number: int
    focal_lengths: int
    family: str
    terms: int

    @property
    def count(self) -> int:
        """How many numbers it has."""
        return 2 if self.family == "Equirectangular" else self.focal_lengths + 2 + self.terms


# Of two that hold a lens, it is written as the first.
_MODELS = (
    _Model("SIMPLE_PINHOLE", 0, 1, "Perspective", 0),
    _Model("PINHOLE", 1, 2, "Perspective", 0),
    _Model("SIMPLE_RADIAL", 2, 1, "RadialPolynomial", 1),
    _Model("RADIAL", 3, 1, "RadialPolynomial", 2),
    _Model("OPENCV", 4, 2, "BrownConrady", 4),
    _Model("FULL_OPENCV", 6, 2, "BrownConrady", 8),
    _Model("FOV", 7, 2, "FieldOfView", 1),
    _Model("SIMPLE_RADIAL_FISHEYE", 8, 1, "KannalaBrandt", 1),
    _Model("RADIAL_FISHEYE", 9, 1, "KannalaBrandt", 2),
    _Model("OPENCV_FISHEYE", 5, 2, "KannalaBrandt", 4),
    _Model("THIN_PRISM_FISHEYE", 10, 2, "ThinPrismFisheye", 8),
    _Model("RAD_TAN_THIN_PRISM_FISHEYE", 11, 2, "RadTanThinPrismFisheye", 12),
    _Model("SIMPLE_DIVISION", 12, 1, "Division", 1),
    _Model("DIVISION", 13, 2, "Division", 1),
    _Model("SIMPLE_FISHEYE", 14, 1, "Equidistant", 0),
    _Model("FISHEYE", 15, 2, "Equidistant", 0),
    _Model("EUCM", 16, 2, "ExtendedUnifiedCamera", 2),
    _Model("EQUIRECTANGULAR", 17, 0, "Equirectangular", 0),
)
_BY_NAME = {model.name: model for model in _MODELS}
_BY_NUMBER = {model.number: model for model in _MODELS}


def recognizes_text(document: Document) -> bool:
    """Tells whether the first line with data is a camera's: a number, a model, a size."""
    if document.is_binary:
        return False
    for _, words in _lines(document):
        return len(words) > 3 and words[0].isdecimal() and words[1].isupper() and words[2].isdecimal()
    return document.text.startswith("# Camera list")


def parse_text(document: Document) -> list[Calibration]:
    """Reads the cameras of a cameras.txt; each is named by its number."""
    found = []
    for line, words in _lines(document):
        place = f"line {line}"
        if len(words) < 4:
            raise document.wrong(f"{place}: a camera is CAMERA_ID MODEL WIDTH HEIGHT PARAMS…, got {len(words)} words")
        model = _BY_NAME.get(words[1])
        if model is None:
            raise document.wrong(f"{place}: there is no model {words[1][:40]!r}; there are {', '.join(_BY_NAME)}")
        width, height = (_number(document, place, word) for word in words[2:4])
        values = [_number(document, place, word) for word in words[4:]]
        found.append(_camera(document, place, words[0][:40], model, width, height, values))
    return _some(document, found)


def _lines(document: Document) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(document.text.splitlines(), 1):
        if line.strip() and not line.startswith("#"):
            yield number, line.split()


def _number(document: Document, place: str, word: str) -> float:
    try:
        return float(word)
    except ValueError:
        raise document.wrong(f"{place}: {word[:40]!r} is no number") from None


def recognizes_binary(document: Document) -> bool:
    """Tells whether the bytes begin as cameras.bin does: how many cameras, the first one's number and its model."""
    if len(document.data) < _HEAD.size or not document.is_binary:
        return False
    count, _, number = _HEAD.unpack_from(document.data)
    return 0 < count <= _MOST and number in _BY_NUMBER


_HEAD = struct.Struct("<QIi")
_COUNT = struct.Struct("<Q")
_CAMERA = struct.Struct("<IiQQ")


def parse_binary(document: Document) -> list[Calibration]:
    """Reads the cameras of a cameras.bin; each is named by its number."""
    data = document.data
    (count,) = _COUNT.unpack_from(data)
    offset, found = _COUNT.size, []
    for index in range(count):
        place = f"camera {index + 1} of {count}, byte {offset}"
        if offset + _CAMERA.size > len(data):
            raise document.wrong(f"{place}: the file ends before it")
        name, number, width, height = _CAMERA.unpack_from(data, offset)
        model = _BY_NUMBER.get(number)
        if model is None:
            raise document.wrong(f"{place}: there is no model {number}; there are 0 to {max(_BY_NUMBER)}")
        offset += _CAMERA.size
        if offset + 8 * model.count > len(data):
            raise document.wrong(f"{place}: the file ends within it")
        values = list(struct.unpack_from(f"<{model.count}d", data, offset))
        offset += 8 * model.count
        found.append(_camera(document, place, str(name), model, width, height, values))
    if offset != len(data):
        raise document.wrong(f"{len(data) - offset} bytes follow the {count} cameras")
    return _some(document, found)


def _some(document: Document, found: list[Calibration]) -> list[Calibration]:
    if not found:
        raise document.wrong("there is no camera in it")
    if len({one.name for one in found}) < len(found):
        raise document.wrong("two of its cameras have one number")
    return found


def _camera(
    document: Document,
    place: str,
    name: str,
    model: _Model,
    width: float | int,
    height: float | int,
    values: list[float],
) -> Calibration:
    keys = Keys(document, {}, f"{place}, {model.name}")
    size = keys.whole("width", width), keys.whole("height", height)
    given = keys.checked("parameters", values, (model.count,))
    try:
        check_model(model.family)
    except CalibrationError as error:
        raise document.wrong(f"{place}: {error}") from error
    if model.family == "Equirectangular":
        # All round from edge to edge, whatever the two numbers repeat of the size.
        if given != (float(size[0]), float(size[1])):
            raise keys.wrong("parameters", f"must be the size, {size[0]} and {size[1]}, got {given[0]:g}, {given[1]:g}")
        focal: tuple[float, ...] = (size[0] / (2 * math.pi), size[1] / math.pi)
        center: tuple[float, ...] = (size[0] / 2, size[1] / 2)
        rest: tuple[float, ...] = ()
    else:
        focal, given = given[: model.focal_lengths], given[model.focal_lengths :]
        center, rest = given[:2], given[2:]
    focal = tuple(keys.positive("focal length", one) for one in (*focal, *focal)[:2])
    return calibration(
        (model.family, _parameters(keys, model, rest)), focal, [one - _HALF for one in center], size, name
    )


def _parameters(keys: Keys, model: _Model, values: tuple[float, ...]) -> dict[str, Value]:
    if model.family == "FieldOfView":
        if not abs(values[0]) < math.pi:
            raise keys.wrong("omega", f"must be less than π, got {values[0]:g}")
        return {"omega": values[0], "center": _ORIGIN}
    if model.family == "Division":
        return {"k": -values[0], "center": _ORIGIN}
    if model.family == "ExtendedUnifiedCamera":
        return dict(zip(("alpha", "beta"), eucm(keys, values), strict=True))
    if model.family == "RadialPolynomial":
        return {"coefficients": values, "center": _ORIGIN}
    return {"coefficients": values} if values else {}


def _as_colmap(one: Calibration) -> tuple[_Model, tuple[int, int], list[float]]:
    """Returns the first model that holds a lens, the size, and its numbers."""
    fx, fy, cx, cy = framed(one, "COLMAP")
    size = sized(one, "COLMAP")
    if one.model == "Equirectangular":
        expected = (size[0] / (2 * math.pi), size[1] / math.pi, size[0] / 2 - _HALF, size[1] / 2 - _HALF)
        if any(abs(have - need) > _ROUNDING * need for have, need in zip((fx, fy, cx, cy), expected, strict=True)):
            raise CalibrationError("COLMAP's EQUIRECTANGULAR goes round from edge to edge, and this camera does not")
        return _BY_NAME["EQUIRECTANGULAR"], size, [float(size[0]), float(size[1])]
    for model in _MODELS:
        values = _values(one, model)
        if values is not None and (fx == fy or model.focal_lengths == 2):
            focal = [fx] if model.focal_lengths == 1 else [fx, fy]
            return model, size, [*focal, cx + _HALF, cy + _HALF, *values]
    families = ", ".join(dict.fromkeys(model.family for model in _MODELS))
    raise no_room(one, "COLMAP", f"{families} (BrownConrady of up to 8 numbers; centres of distortion in the middle)")


def _values(one: Calibration, model: _Model) -> Sequence[float] | None:
    """Returns the coefficients of a lens in a model, or None where it has no room for it."""
    parameters = dict(one.parameters)
    if model.family == "BrownConrady":
        return as_brown_conrady(one, (model.terms,))
    if model.family == "KannalaBrandt":
        return as_kannala_brandt(one, (model.terms,)) if one.model == model.family else None
    if one.model != model.family or parameters.get("center", _ORIGIN) != _ORIGIN:
        return None
    if model.family == "Division":
        k = parameters["k"]
        k = padded(k, (1,)) if isinstance(k, tuple) else (k,)
        return None if k is None else [-k[0]]
    if model.family in ("FieldOfView", "ExtendedUnifiedCamera"):
        names = ("omega",) if model.family == "FieldOfView" else ("alpha", "beta")
        values = [parameters[name] for name in names]
        return [value for value in values if isinstance(value, float)]
    coefficients = parameters.get("coefficients", ())
    return padded(coefficients, (model.terms,)) if isinstance(coefficients, tuple) else None


def _numbered(calibrations: Sequence[Calibration]) -> list[int]:
    """Returns the cameras' numbers: their names, where all are numbers and none stands twice; else 1, 2, …."""
    names = [one.name for one in calibrations]
    numbers = {int(name) for name in names if _NUMBER.fullmatch(name)}
    return list(map(int, names)) if len(numbers) == len(names) else list(range(1, len(names) + 1))


def render_text(calibrations: Sequence[Calibration]) -> str:
    """Returns a cameras.txt."""
    lines = ["# Camera list with one line of data per camera:", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    lines.append(f"# Number of cameras: {len(calibrations)}")
    for number, one in zip(_numbered(calibrations), calibrations, strict=True):
        model, (width, height), values = _as_colmap(one)
        lines.append(" ".join([str(number), model.name, str(width), str(height), *map(repr, values)]))
    return "\n".join(lines) + "\n"


def render_binary(calibrations: Sequence[Calibration]) -> bytes:
    """Returns a cameras.bin."""
    parts = [_COUNT.pack(len(calibrations))]
    for number, one in zip(_numbered(calibrations), calibrations, strict=True):
        model, (width, height), values = _as_colmap(one)
        parts += [_CAMERA.pack(number, model.number, width, height), struct.pack(f"<{len(values)}d", *values)]
    return b"".join(parts)
