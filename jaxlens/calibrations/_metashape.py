"""Agisoft Metashape's calibration in XML, and the sensors of its exported cameras.

Metashape's principal point is counted from the middle of the picture, whose first pixel's centre is (½, ½) there and
(0, 0) here. Its P1 and P2 are OpenCV's p2 and p1, its B1 is fx − fy. A number that is not written is zero.
"""

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
    padded,
    radial,
    single,
    sized,
)
from jaxlens.calibrations._keys import Keys

_NAME = "Metashape"
_HALF = 0.5
_ORIGIN = (0.0, 0.0)
_RADIAL = ("k1", "k2", "k3", "k4")
_FAMILIES = "Perspective, RadialPolynomial of up to 4 terms, BrownConrady of up to 5 and KannalaBrandt of up to 4"


def recognizes(document: Document) -> bool:
    """Tells whether a file is XML with a calibration, or with sensors that have one."""
    if document.is_binary or not document.is_xml:
        return False
    return isinstance(document.mapping.get("calibration"), dict) or bool(_sensors(document))


def parse(document: Document) -> list[Calibration]:
    """Reads the calibration, or those of all sensors, each named by its label."""
    alone = document.mapping.get("calibration")
    if isinstance(alone, dict):
        return [_camera(Keys(document, alone, "calibration"), alone.get("projection"), "")]
    found = []
    for sensor in _sensors(document):
        label = str(sensor.get("@label", ""))
        # As it was told, and as it was found: the last is what counts.
        one = _listed(sensor["calibration"])[-1]
        keys = Keys(document, one, f"sensor {label!r}, calibration")
        resolution = keys.inner("resolution")
        for key in ("width", "height"):
            keys.values[key] = _integer(resolution, f"@{key}")
        found.append(_camera(keys, one.get("@type"), label))
    return found


def _listed(value: Any) -> list:
    return value if isinstance(value, list) else [value]


def _sensors(document: Document) -> list[dict]:
    """Returns the sensors with a calibration, wherever they stand."""
    found: list[dict] = []
    waiting: list[Any] = [document.mapping]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            found += [one for one in _listed(value.get("sensor")) if isinstance(one, dict) and "calibration" in one]
            waiting += value.values()
        elif isinstance(value, list):
            waiting += value
    return found


def _integer(keys: Keys, key: str) -> int:
    value = keys.text(key)
    if not value.isdecimal() or not value.isascii() or len(value) > 9:
        raise keys.wrong(key, f"must be a whole number of pixels, got {value[:40]!r}")
    return int(value)


def _camera(keys: Keys, projection: Any, name: str) -> Calibration:
    if projection not in ("frame", "fisheye"):
        raise keys.wrong("projection", f"must be frame or fisheye, got {str(projection)[:40]!r}")
    f, b1 = keys.number("f"), keys.number("b1", 0.0)
    for key in ("b2", "p3", "p4"):
        if keys.number(key, 0.0):
            raise keys.wrong(key, f"no lens of jaxlens has it, got {keys.number(key):g}; calibrate without it")
    width, height = keys.size("width", "height")
    center = (width / 2 + keys.number("cx", 0.0) - _HALF, height / 2 + keys.number("cy", 0.0) - _HALF)
    focal = keys.positive("f", f + b1), keys.positive("f", f)
    return calibration(_lens(keys, projection), focal, center, (width, height), name)


def _lens(keys: Keys, projection: str) -> tuple[str, dict[str, Value]]:
    k1, k2, k3, k4 = (keys.number(key, 0.0) for key in _RADIAL)
    p1, p2 = keys.number("p1", 0.0), keys.number("p2", 0.0)
    if projection == "fisheye":
        if p1 or p2:
            raise keys.wrong("p1", "no fisheye of jaxlens is tangential; calibrate without p1 and p2")
        return kannala_brandt((k1, k2, k3, k4))
    if not k4:
        return brown_conrady((k1, k2, p2, p1, k3))
    if p1 or p2:
        raise keys.wrong("k4", "no lens of jaxlens has k4 beside p1 and p2; calibrate without one of them")
    return radial((k1, k2, k3, k4))


def render(calibrations: Sequence[Calibration]) -> str:
    """Returns a calibration as Metashape exports one."""
    one = single(calibrations, _NAME)
    fx, fy, cx, cy = framed(one, _NAME)
    width, height = sized(one, _NAME)
    projection, numbers = _as_metashape(one)
    middle = {"cx": cx + _HALF - width / 2, "cy": cy + _HALF - height / 2, "b1": fx - fy, "b2": 0.0}
    values: dict[str, Any] = {"projection": projection, "width": width, "height": height, "f": fy} | middle | numbers
    lines = [f"  <{key}>{value}</{key}>" for key, value in values.items()]
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', "<calibration>", *lines, "</calibration>", ""])


def _as_metashape(one: Calibration) -> tuple[str, dict[str, float]]:
    fisheye = as_kannala_brandt(one, (len(_RADIAL),))
    if fisheye is not None:
        return "fisheye", dict(zip(_RADIAL, fisheye, strict=True))
    parameters = dict(one.parameters)
    found = parameters.get("coefficients")
    if one.model == "RadialPolynomial" and parameters["center"] == _ORIGIN and isinstance(found, tuple):
        values = padded(found, (len(_RADIAL),))
        if values is not None:
            return "frame", dict(zip(_RADIAL, values, strict=True))
    brown = as_brown_conrady(one, (5,))
    if brown is None:
        raise no_room(one, _NAME, _FAMILIES)
    return "frame", dict(zip(("k1", "k2", "p2", "p1", "k3"), brown, strict=True))
