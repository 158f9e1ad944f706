"""transforms.json of nerfstudio and instant-ngp.

Both count pixels from the picture's corner: the first pixel's centre, (0, 0) here, is (½, ½) there. Poses are not part
of the camera.
"""

import json
import math
from collections.abc import Sequence
from typing import Any

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
    sized,
)
from jaxlens.calibrations._keys import Keys

_NAME = "nerfstudio"
_HALF = 0.5
_RADIAL = ("k1", "k2", "k3", "k4")
_NUMBERS = ("fl_x", "fl_y", "cx", "cy", "w", "h", *_RADIAL, "p1", "p2", "camera_angle_x", "camera_angle_y")
_CAMERA = (*_NUMBERS, "camera_model", "is_fisheye")
_PLANE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "RADIAL", "SIMPLE_RADIAL")
_FAMILIES = "Perspective, RadialPolynomial of up to 3 terms, BrownConrady of up to 5 and KannalaBrandt of up to 4"


def recognizes(document: Document) -> bool:
    """Tells whether a file has frames, or a focal length as it stands there."""
    content = document.mapping
    return isinstance(content.get("frames"), list) or "fl_x" in content or "camera_angle_x" in content


def parse(document: Document) -> list[Calibration]:
    """Reads the camera of all frames; where frames have their own, each that is different, named by its first file."""
    content = document.mapping
    frames = content.get("frames", [])
    if not isinstance(frames, list):
        raise document.wrong("frames must be a list")
    shared = {key: content[key] for key in _CAMERA if key in content}
    own = [
        (index, frame) for index, frame in enumerate(frames) if isinstance(frame, dict) and set(frame) & set(_CAMERA)
    ]
    if not own:
        return [_camera(Keys(document, shared), "")]
    found: dict[str, Calibration] = {}
    for index, frame in own:
        values = shared | {key: frame[key] for key in _CAMERA if key in frame}
        key = json.dumps(values)
        if key not in found:
            keys = Keys(document, values, f"frames[{index}]")
            found[key] = _camera(keys, Keys(document, frame, keys.place).text("file_path", ""))
    if len(own) < len(frames):
        # The others have the camera of the file.
        return [_camera(Keys(document, shared), ""), *found.values()]
    return list(found.values())


def _camera(keys: Keys, name: str) -> Calibration:
    width, height = keys.size("w", "h")
    fl_x = keys.number("fl_x") if "fl_x" in keys else _focal(keys, "camera_angle_x", width)
    if "fl_y" in keys:
        fl_y = keys.number("fl_y")
    else:
        fl_y = _focal(keys, "camera_angle_y", height) if "camera_angle_y" in keys else fl_x
    focal = keys.positive("fl_x", fl_x), keys.positive("fl_y", fl_y)
    center = keys.number("cx", width / 2) - _HALF, keys.number("cy", height / 2) - _HALF
    return calibration(_lens(keys), focal, center, (width, height), name)


def _focal(keys: Keys, key: str, size: int) -> float:
    """Returns the focal length of a field of view from edge to edge."""
    angle = keys.number(key, least=0.0)
    if angle >= math.pi:
        raise keys.wrong(key, f"must be less than π, got {angle:g}")
    return size / (2 * math.tan(angle / 2))


def _lens(keys: Keys) -> tuple[str, dict[str, Value]]:
    fisheye = keys.values.get("is_fisheye", False)
    if not isinstance(fisheye, bool):
        raise keys.wrong("is_fisheye", "must be true or false")
    model = keys.text("camera_model", "OPENCV_FISHEYE" if fisheye else "OPENCV")
    k1, k2, k3, k4 = (keys.number(key, 0.0) for key in _RADIAL)
    p1, p2 = keys.number("p1", 0.0), keys.number("p2", 0.0)
    if model == "OPENCV_FISHEYE":
        if p1 or p2:
            raise keys.wrong("p1", "a fisheye of OpenCV is not tangential, so p1 and p2 must be zero")
        return kannala_brandt((k1, k2, k3, k4))
    if model not in _PLANE or fisheye:
        known = ", ".join((*_PLANE, "OPENCV_FISHEYE"))
        raise keys.wrong("camera_model", f"must be one of {known}, the last where is_fisheye, got {model[:40]!r}")
    if k4:
        raise keys.wrong("k4", f"means different things to its readers, so it must be zero, got {k4:g}")
    if not any((k1, k2, p1, p2, k3)):
        return pinhole()
    return brown_conrady((k1, k2, p1, p2, k3))


def render(calibrations: Sequence[Calibration]) -> str:
    """Returns a transforms.json without poses: one camera for all frames, or a frame for each camera."""
    content: dict[str, Any] = {}
    if len(calibrations) == 1:
        content = _entries(calibrations[0]) | {"frames": []}
    else:
        content = {"frames": [{"file_path": one.name} | _entries(one) for one in calibrations]}
    return json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _entries(one: Calibration) -> dict[str, Any]:
    fx, fy, cx, cy = framed(one, _NAME)
    width, height = sized(one, _NAME)
    size = {"fl_x": fx, "fl_y": fy, "cx": cx + _HALF, "cy": cy + _HALF, "w": width, "h": height}
    fisheye = as_kannala_brandt(one, (len(_RADIAL),))
    if fisheye is not None:
        return {"camera_model": "OPENCV_FISHEYE"} | size | dict(zip(_RADIAL, fisheye, strict=True))
    brown = as_brown_conrady(one, (5,))
    if brown is None:
        raise no_room(one, _NAME, _FAMILIES)
    return {"camera_model": "OPENCV"} | size | dict(zip(("k1", "k2", "p1", "p2", "k3"), brown, strict=True))
