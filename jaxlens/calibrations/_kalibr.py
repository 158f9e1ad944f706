"""Kalibr's camchain in YAML.

Kalibr counts as OpenCV does, and so do we: nothing is converted.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from jaxlens.calibrations._calibration import Calibration, Value
from jaxlens.calibrations._documents import Document
from jaxlens.calibrations._families import (
    as_brown_conrady,
    as_kannala_brandt,
    brown_conrady,
    calibration,
    eucm,
    framed,
    kannala_brandt,
    no_room,
    pinhole,
    sized,
)
from jaxlens.calibrations._keys import Keys

_ORIGIN = (0.0, 0.0)
_TERMS = 4
# How many numbers each kind of camera has before its focal lengths.
_OWN = {"pinhole": 0, "omni": 1, "ds": 2, "eucm": 2}
_DISTORTIONS = {"radtan": 4, "equi": 4, "fov": 1, "none": 0}
_FAMILIES = (
    "Perspective, RadialPolynomial of up to 2 terms, BrownConrady of 4, KannalaBrandt of up to 4, FieldOfView, "
    "UnifiedCamera of up to 4, ExtendedUnifiedCamera and DoubleSphere"
)


def recognizes(document: Document) -> bool:
    """Tells whether a file has a camera with a model and intrinsics, under a name of its own."""
    return any(_is_camera(one) for one in document.mapping.values())


def parse(document: Document) -> list[Calibration]:
    """Reads the cameras of a chain, each named by its key."""
    keys = Keys(document, document.mapping)
    return [_camera(keys.inner(name), name) for name, one in keys.values.items() if _is_camera(one)]


def _is_camera(value: Any) -> bool:
    return isinstance(value, dict) and {"camera_model", "intrinsics"} <= set(value)


def _camera(keys: Keys, name: str) -> Calibration:
    model, distortion = _word(keys, "camera_model", list(_OWN)), _word(keys, "distortion_model", list(_DISTORTIONS))
    intrinsics = keys.numbers("intrinsics", (_OWN[model] + 4,))
    own, (fx, fy, cx, cy) = intrinsics[:-4], intrinsics[-4:]
    terms = _DISTORTIONS[distortion]
    coefficients = keys.numbers("distortion_coeffs", (terms,)) if terms else ()
    width, height = keys.numbers("resolution", (2,))
    size = keys.whole("resolution", width), keys.whole("resolution", height)
    focal = keys.positive("intrinsics", fx), keys.positive("intrinsics", fy)
    found = calibration(_lens(keys, model, own, distortion, coefficients), focal, (cx, cy), size, name)
    if "T_cn_cnm1" not in keys:
        return found
    pose = keys.numbers("T_cn_cnm1", (16,))
    return replace(found, from_previous=tuple(pose[row : row + 4] for row in range(0, 16, 4)))


def _word(keys: Keys, key: str, words: list[str]) -> str:
    word = keys.text(key)
    if word not in words:
        raise keys.wrong(key, f"must be one of {', '.join(words)}, got {word[:40]!r}")
    return word


def _lens(
    keys: Keys, model: str, own: Sequence[float], distortion: str, coefficients: Sequence[float]
) -> tuple[str, dict[str, Value]]:
    if model == "pinhole":
        if distortion == "fov":
            if not abs(coefficients[0]) < math.pi:
                raise keys.wrong("distortion_coeffs", f"must be less than π, got {coefficients[0]:g}")
            return "FieldOfView", {"omega": coefficients[0], "center": _ORIGIN}
        if distortion == "equi":
            return kannala_brandt(coefficients)
        return brown_conrady(coefficients) if coefficients else pinhole()
    if model == "omni" and distortion in ("radtan", "none"):
        if own[0] < 0:
            raise keys.wrong("intrinsics", f"xi must not be negative, got {own[0]:g}")
        return "UnifiedCamera", {"xi": own[0], "coefficients": tuple(coefficients)}
    if any(coefficients):
        raise keys.wrong("distortion_model", f"{distortion} after {model} is no lens of jaxlens; none is")
    if model == "omni":
        return "UnifiedCamera", {"xi": own[0], "coefficients": ()}
    if model == "ds":
        if not (-1 <= own[0] <= 1 and 0 <= own[1] <= 1):
            raise keys.wrong("intrinsics", f"xi is within ±1 and alpha between 0 and 1, got {own[0]:g}, {own[1]:g}")
        return "DoubleSphere", {"xi": own[0], "alpha": own[1]}
    alpha, beta = eucm(keys, own)
    return "ExtendedUnifiedCamera", {"alpha": alpha, "beta": beta}


def render(calibrations: Sequence[Calibration]) -> str:
    """Returns a camchain; the cameras are cam0, cam1, … in their order."""
    lines = []
    for index, one in enumerate(calibrations):
        model, own, distortion, coefficients = _as_kalibr(one)
        lines.append(f"cam{index}:")
        if one.from_previous is not None:
            lines += ["  T_cn_cnm1:", *(f"  - {list(row)!r}" for row in one.from_previous)]
        lines += [f"  camera_model: {model}", f"  intrinsics: {[*own, *framed(one, 'Kalibr')]!r}"]
        lines += [f"  distortion_model: {distortion}", f"  distortion_coeffs: {list(coefficients)!r}"]
        lines += [f"  resolution: {list(sized(one, 'Kalibr'))!r}", f"  rostopic: /cam{index}/image_raw"]
    return "\n".join([*lines, ""])


def _as_kalibr(one: Calibration) -> tuple[str, list[Value], str, Sequence[float]]:
    """Returns the kind of camera, its own numbers, the distortion and its coefficients."""
    parameters = dict(one.parameters)
    found = parameters.get("coefficients", ())
    if one.model == "Perspective":
        return "pinhole", [], "none", ()
    if one.model == "FieldOfView" and parameters["center"] == _ORIGIN and isinstance(parameters["omega"], float):
        return "pinhole", [], "fov", (parameters["omega"],)
    if one.model == "ExtendedUnifiedCamera":
        return "eucm", [parameters["alpha"], parameters["beta"]], "none", ()
    if one.model == "DoubleSphere":
        return "ds", [parameters["xi"], parameters["alpha"]], "none", ()
    if one.model == "UnifiedCamera" and isinstance(found, tuple):
        plain = brown_conrady(found)
        inner = as_brown_conrady(Calibration(plain[0], tuple(plain[1].items())), (_TERMS,)) if found else ()
        if inner is not None:
            return "omni", [parameters["xi"]], "radtan" if inner else "none", inner
    for distortion, values in (
        ("radtan", as_brown_conrady(one, (_TERMS,))),
        ("equi", as_kannala_brandt(one, (_TERMS,))),
    ):
        if values is not None:
            return "pinhole", [], distortion, values
    raise no_room(one, "Kalibr", _FAMILIES)
