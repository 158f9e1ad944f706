"""OpenCV's FileStorage: YAML, XML and JSON, with the names that people give to a camera matrix and its distortion.

OpenCV counts as we do: pixel centres at integers, x to the right, y down; nothing is converted.
"""

import json
import re
from collections.abc import Callable, Sequence
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
)
from jaxlens.calibrations._keys import Keys, flat

_COUNTS = (4, 5, 8, 12, 14)
_FISHEYE = 4
# Without case and underscores; what stands behind is the camera: 1, left, …
_MATRIX = re.compile(r"(?:cameramatrix|intrinsicmatrix|intrinsics?|mtx|k|m)(\d*|left|right|l|r)", re.ASCII)
_DISTORTION = re.compile(
    r"(?:fisheye)?(?:distortioncoefficients|distortioncoeffs|distcoeffs?|distcoefs|distortion|dist|d)"
    r"(\d*|left|right|l|r)",
    re.ASCII,
)
_WORDS = {"fisheye": True, "equidistant": True, "kannalabrandt": True, "pinhole": False, "plumbbob": False}
_FAMILIES = "Perspective, RadialPolynomial of up to 3 terms, BrownConrady, KannalaBrandt of up to 4 and UnifiedCamera"


def recognizes(document: Document) -> bool:
    """Tells whether a file has a camera matrix under one of the usual names."""
    return bool(_found(_content(document), _MATRIX))


def recognizes_as(start: str) -> Callable[[Document], bool]:
    """Returns the test for one of the three spellings, by what the text begins with."""

    def test(document: Document) -> bool:
        if not recognizes(document):
            return False
        here = document.text.lstrip()[:1]
        return here == start if start else here not in ("<", "{")

    return test


def parse(document: Document) -> list[Calibration]:
    """Reads the cameras of a file: one, or those of a pair."""
    content = _content(document)
    keys = Keys(document, content)
    matrices, distortions = _found(content, _MATRIX), _found(content, _DISTORTION)
    return [_camera(keys, key, distortions.get(which), which) for which, key in matrices.items()]


def _content(document: Document) -> dict[str, Any]:
    content = document.mapping
    inner = content.get("opencv_storage")
    return inner if isinstance(inner, dict) else content


def _found(content: dict[str, Any], pattern: re.Pattern[str]) -> dict[str, str]:
    """Returns the keys that a pattern names and that hold several numbers, by the camera that they are of."""
    found: dict[str, str] = {}
    for key, value in content.items():
        match = pattern.fullmatch(re.sub(r"[_\- ]", "", str(key)).lower())
        if match is not None and isinstance(value, dict | list):
            found.setdefault(match[1], str(key))
    return found


def _camera(keys: Keys, matrix_key: str, distortion_key: str | None, which: str) -> Calibration:
    (fx, skew, cx, below, fy, cy, *last) = _numbers(keys, matrix_key, (9,))
    if skew or below or last != [0.0, 0.0, 1.0]:
        raise keys.wrong(matrix_key, "must be [fx, 0, cx, 0, fy, cy, 0, 0, 1]: cameras here have no skew")
    focal = keys.positive(matrix_key, fx), keys.positive(matrix_key, fy)
    if distortion_key is None:
        there = ", ".join(str(key) for key in list(keys.values)[:20])
        raise keys.wrong(
            matrix_key, f"no distortion goes with it; its usual name is distortion_coefficients or D, there are {there}"
        )
    coefficients = _numbers(keys, distortion_key, (0, *_COUNTS))
    lens = _lens(keys, distortion_key, coefficients)
    return calibration(lens, focal, (cx, cy), _size(keys), which)


def _lens(keys: Keys, key: str, coefficients: tuple[float, ...]) -> tuple[str, dict[str, Value]]:
    fisheye = _is_fisheye(keys, key)
    if "xi" in keys:
        (xi,) = _numbers(keys, "xi", (1,))
        return "UnifiedCamera", {"xi": keys.positive("xi", xi), "coefficients": coefficients}
    if not fisheye:
        return brown_conrady(coefficients or [0.0] * _FISHEYE)
    if len(coefficients) != _FISHEYE:
        raise keys.wrong(key, f"a fisheye has {_FISHEYE} coefficients, got {len(coefficients)}")
    return kannala_brandt(coefficients)


def _is_fisheye(keys: Keys, distortion_key: str) -> bool:
    """Tells whether the file calls its camera a fisheye, in one of the usual ways."""
    for key in ("fisheye", "fisheye_model", "is_fisheye"):
        if key in keys:
            value = keys.values[key]
            if value not in (0, 1):
                raise keys.wrong(key, f"must be 0 or 1, got {str(value)[:40]!r}")
            return bool(value)
    for key in ("distortion_model", "camera_model", "model"):
        if key in keys:
            word = re.sub(r"[_\- ]", "", keys.text(key)).lower()
            if word not in _WORDS and word not in ("rationalpolynomial", "opencv", "omnidir", "brownconrady"):
                raise keys.wrong(key, f"{keys.text(key)!r} is no model of OpenCV; there are pinhole and fisheye")
            return _WORDS.get(word, False)
    return "fisheye" in distortion_key.lower()


def _size(keys: Keys) -> tuple[int, int] | None:
    for wide, tall in (("image_width", "image_height"), ("width", "height"), ("w", "h")):
        if wide in keys and tall in keys:
            return keys.size(wide, tall)
    for key in ("image_size", "imageSize", "img_size", "size"):
        if key in keys:
            width, height = _numbers(keys, key, (2,))
            return keys.whole(key, width), keys.whole(key, height)
    return None


def _numbers(keys: Keys, key: str, counts: Sequence[int]) -> tuple[float, ...]:
    """Returns the numbers of a matrix or a list."""
    value = keys.get(key)
    if not isinstance(value, dict):
        return keys.numbers(key, counts)
    matrix = keys.inner(key)
    numbers = keys.checked(key, flat(value.get("data", [])) or [], counts)
    shape = matrix.numbers("sizes") if "sizes" in matrix else (matrix.number("rows"), matrix.number("cols"))
    count = 1.0
    for one in shape:
        count *= one
    if count != len(numbers):
        raise keys.wrong(
            key, f"{' × '.join(f'{one:g}' for one in shape)} numbers are told, and there are {len(numbers)}"
        )
    return numbers


def _entries(calibrations: Sequence[Calibration]) -> dict[str, Any]:
    """Returns what is written, in order; matrices as lists of rows."""
    entries: dict[str, Any] = {}
    if len(calibrations) > 1 and len({(one.image_size, _kind(one)) for one in calibrations}) > 1:
        raise no_room(calibrations[-1], "one file of OpenCV", "cameras of one size and family")
    for index, one in enumerate(calibrations):
        number = "" if len(calibrations) == 1 else str(index + 1)
        fx, fy, cx, cy = framed(one, "OpenCV")
        if one.image_size is not None:
            entries["image_width"], entries["image_height"] = one.image_size
        entries[f"camera_matrix{number}"] = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
        kind, coefficients, xi = _kind(one), _coefficients(one), dict(one.parameters).get("xi")
        if kind == "fisheye":
            entries["fisheye"] = 1
        if xi is not None:
            entries["xi"] = [[xi]]
        entries[f"distortion_coefficients{number}"] = [list(coefficients)]
    return entries


def _kind(one: Calibration) -> str:
    if one.model == "UnifiedCamera":
        return f"omnidir {dict(one.parameters)['xi']}"
    return "fisheye" if one.model in ("KannalaBrandt", "Equidistant") else "pinhole"


def _coefficients(one: Calibration) -> tuple[float, ...]:
    if one.model == "UnifiedCamera":
        found: Any = dict(one.parameters)["coefficients"]
        # OpenCV's omnidir has k1, k2, p1, p2.
        found = found if len(found) == _FISHEYE else None if any(found[_FISHEYE:]) else (*found, *[0.0] * 4)[:4]
    elif _kind(one) == "fisheye":
        found = as_kannala_brandt(one, (_FISHEYE,))
    else:
        found = as_brown_conrady(one, _COUNTS)
    if found is None:
        raise no_room(one, "OpenCV", _FAMILIES)
    return found


def render_yaml(calibrations: Sequence[Calibration]) -> str:
    """Returns FileStorage YAML, as every version of OpenCV reads it."""
    lines = ["%YAML:1.0", "---"]
    for key, value in _entries(calibrations).items():
        if isinstance(value, list):
            lines += [f"{key}: !!opencv-matrix", f"   rows: {len(value)}", f"   cols: {len(value[0])}", "   dt: d"]
            lines += ["   data: [ " + ", ".join(repr(one) for one in flat(value)) + " ]"]
        else:
            lines.append(f"{key}: {value}")
    return "\n".join(lines) + "\n"


def render_xml(calibrations: Sequence[Calibration]) -> str:
    """Returns FileStorage XML."""
    lines = ['<?xml version="1.0"?>', "<opencv_storage>"]
    for key, value in _entries(calibrations).items():
        if isinstance(value, list):
            numbers = " ".join(repr(one) for one in flat(value))
            lines += [f'<{key} type_id="opencv-matrix">', f"  <rows>{len(value)}</rows>"]
            lines += [f"  <cols>{len(value[0])}</cols>", "  <dt>d</dt>", f"  <data>{numbers}</data></{key}>"]
        else:
            lines.append(f"<{key}>{value}</{key}>")
    return "\n".join([*lines, "</opencv_storage>", ""])


def render_json(calibrations: Sequence[Calibration]) -> str:
    """Returns FileStorage JSON."""
    content = {
        key: {"type_id": "opencv-matrix", "rows": len(value), "cols": len(value[0]), "dt": "d", "data": flat(value)}
        if isinstance(value, list)
        else value
        for key, value in _entries(calibrations).items()
    }
    return json.dumps(content, indent=4, allow_nan=False) + "\n"
