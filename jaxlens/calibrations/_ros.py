"""ROS camera_info in YAML, as camera_calibration writes it, and as its messages are printed.

ROS counts as OpenCV does, and so do we: nothing is converted. R and P, which rectify, are not part of the camera.
"""

from collections.abc import Sequence

from jaxlens.calibrations._calibration import Calibration, Value
from jaxlens.calibrations._documents import Document
from jaxlens.calibrations._families import (
    as_brown_conrady,
    as_kannala_brandt,
    brown_conrady,
    calibration,
    framed,
    kannala_brandt,
    no_room,
    pinhole,
    single,
    sized,
)
from jaxlens.calibrations._keys import Keys, quoted

_NAME = "ROS"
# The model's name, and how many coefficients it may have.
_BROWN = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14)}
_FISHEYES = ("equidistant", "fisheye")
_FISHEYE = 4
_FAMILIES = "Perspective, RadialPolynomial of up to 3 terms, BrownConrady and KannalaBrandt of up to 4"


def recognizes(document: Document) -> bool:
    """Tells whether a file has a camera matrix and the name of its distortion's model."""
    content = document.mapping
    if not {"camera_matrix", "K", "k"} & set(content) or not {"image_width", "width"} & set(content):
        return False
    # OpenCV's files may say which model they have, as well.
    return "distortion_model" in content and "opencv-matrix" not in document.text


def parse(document: Document) -> list[Calibration]:
    """Reads the camera."""
    keys = Keys(document, document.mapping)
    size = keys.size("image_width", "image_height") if "image_width" in keys else keys.size("width", "height")
    matrix_key = next(key for key in ("camera_matrix", "K", "k") if key in keys.values)
    fx, skew, cx, below, fy, cy, *last = _numbers(keys, matrix_key, (9,))
    if skew or below or last != [0.0, 0.0, 1.0]:
        raise keys.wrong(matrix_key, "must be [fx, 0, cx, 0, fy, cy, 0, 0, 1]: cameras here have no skew")
    focal = keys.positive(matrix_key, fx), keys.positive(matrix_key, fy)
    return [calibration(_lens(keys), focal, (cx, cy), size, keys.text("camera_name", ""))]


def _lens(keys: Keys) -> tuple[str, dict[str, Value]]:
    model = keys.text("distortion_model")
    key = next((key for key in ("distortion_coefficients", "D", "d") if key in keys), "distortion_coefficients")
    if model in ("", "none") or (model == "plumb_bob" and not _numbers(keys, key)):
        # A message of a camera that was not calibrated has no model either, but its focal length is 0.
        if key in keys and any(_numbers(keys, key)):
            raise keys.wrong("distortion_model", f"must say what the coefficients in {key} are")
        return pinhole()
    if model in _BROWN:
        return brown_conrady(_numbers(keys, key, _BROWN[model]))
    if model in _FISHEYES:
        return kannala_brandt(_numbers(keys, key, (_FISHEYE,)))
    raise keys.wrong("distortion_model", f"must be one of {', '.join((*_BROWN, *_FISHEYES))}, got {model[:40]!r}")


def _numbers(keys: Keys, key: str, counts: Sequence[int] | None = None) -> tuple[float, ...]:
    value = keys.get(key)
    return keys.inner(key).numbers("data", counts) if isinstance(value, dict) else keys.numbers(key, counts)


def render(calibrations: Sequence[Calibration]) -> str:
    """Returns a file as camera_calibration writes it; R is the identity, and P has the camera matrix."""
    one = single(calibrations, _NAME)
    fx, fy, cx, cy = framed(one, _NAME)
    width, height = sized(one, _NAME)
    model, coefficients = _coefficients(one)
    return "\n".join(
        [
            f"image_width: {width}",
            f"image_height: {height}",
            f"camera_name: {quoted(one.name or 'camera')}",
            *_matrix("camera_matrix", 3, (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)),
            f"distortion_model: {model}",
            *_matrix("distortion_coefficients", 1, coefficients),
            *_matrix("rectification_matrix", 3, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)),
            *_matrix("projection_matrix", 3, (fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0)),
            "",
        ]
    )


def _coefficients(one: Calibration) -> tuple[str, tuple[float, ...]]:
    for model, counts in (("plumb_bob", (5,)), ("rational_polynomial", (8, 12, 14))):
        found = as_brown_conrady(one, counts)
        if found is not None:
            return model, found
    found = as_kannala_brandt(one, (_FISHEYE,))
    if found is None:
        raise no_room(one, _NAME, _FAMILIES)
    return "equidistant", found


def _matrix(key: str, rows: int, values: Sequence[float]) -> list[str]:
    numbers = ", ".join(repr(value) for value in values)
    return [f"{key}:", f"  rows: {rows}", f"  cols: {len(values) // rows}", f"  data: [{numbers}]"]
