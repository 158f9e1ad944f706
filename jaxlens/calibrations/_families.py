"""What the formats share: calibrations from focal lengths and coefficients, and back.

A lens that another family holds in other numbers is written as that one: what is exactly the same is no conversion.
"""

from collections.abc import Sequence

from jaxlens.calibrations._calibration import Calibration, CalibrationError, Value
from jaxlens.calibrations._keys import Keys

_ORIGIN = (0.0, 0.0)
_CONVERT = "jaxlens.fitting.convert finds the nearest camera of another family"


def pinhole() -> tuple[str, dict[str, Value]]:
    """Returns the lens that distorts nothing."""
    return "Perspective", {}


def brown_conrady(coefficients: Sequence[float]) -> tuple[str, dict[str, Value]]:
    """Returns the lens of OpenCV's coefficients, in its order."""
    return "BrownConrady", {"coefficients": tuple(coefficients)}


def kannala_brandt(coefficients: Sequence[float]) -> tuple[str, dict[str, Value]]:
    """Returns the fisheye of k1, k2, …."""
    return "KannalaBrandt", {"coefficients": tuple(coefficients)}


def radial(coefficients: Sequence[float]) -> tuple[str, dict[str, Value]]:
    """Returns the lens of a polynomial of r²."""
    return "RadialPolynomial", {"coefficients": tuple(coefficients), "center": _ORIGIN}


def calibration(
    lens: tuple[str, dict[str, Value]],
    focal: Sequence[float],
    center: Sequence[float],
    size: tuple[int, int] | None,
    name: str = "",
) -> Calibration:
    """Returns a calibration; pixel centres at integers."""
    model, parameters = lens
    pairs = tuple(sorted(parameters.items()))
    return Calibration(model, pairs, (center[0], center[1]), (focal[0], focal[1]), size, name=name)


def as_brown_conrady(calibration: Calibration, counts: Sequence[int]) -> tuple[float, ...] | None:
    """Returns the lens as coefficients in OpenCV's order, in the least of some counts that holds it; or None."""
    parameters = dict(calibration.parameters)
    found = parameters.get("coefficients")
    if calibration.model == "Perspective":
        full: tuple[float, ...] = ()
    elif calibration.model == "RadialPolynomial" and parameters["center"] == _ORIGIN and isinstance(found, tuple):
        if any(found[3:]):
            return None
        k1, k2, k3 = (*found, 0.0, 0.0, 0.0)[:3]
        full = (k1, k2, 0.0, 0.0, k3)
    elif calibration.model == "BrownConrady" and isinstance(found, tuple):
        full = found
    else:
        return None
    return padded(full, counts)


def as_kannala_brandt(calibration: Calibration, counts: Sequence[int]) -> tuple[float, ...] | None:
    """Returns the lens as k1, k2, … of the fisheye, in the least of some counts that holds it; or None."""
    if calibration.model == "Equidistant":
        return padded((), counts)
    found = dict(calibration.parameters).get("coefficients")
    if calibration.model == "KannalaBrandt" and isinstance(found, tuple):
        return padded(found, counts)
    return None


def padded(values: Sequence[float], counts: Sequence[int]) -> tuple[float, ...] | None:
    """Returns numbers without zeros at their end, or with more, in the least of some counts; None if they are more."""
    needed = max((index + 1 for index, value in enumerate(values) if value), default=0)
    for count in sorted(counts):
        if needed <= count:
            return (*values, *[0.0] * count)[:count]
    return None


def framed(calibration: Calibration, format: str) -> tuple[float, float, float, float]:
    """Returns fx, fy, cx, cy, pixel centres at integers.

    Raises:
        CalibrationError: the calibration has no frame in pixels, as a file of that format needs.
    """
    if calibration.center is None or calibration.scale is None:
        raise CalibrationError(
            f"{format} needs focal lengths and a principal point, and the calibration has no frame in pixels: make it "
            "with frame=…"
        )
    return (*calibration.scale, *calibration.center)


def sized(calibration: Calibration, format: str) -> tuple[int, int]:
    """Returns (width, height).

    Raises:
        CalibrationError: the calibration does not say how large its pictures are.
    """
    if calibration.image_size is None:
        raise CalibrationError(f"{format} needs the size of the pictures: make the calibration with image_size=…")
    return calibration.image_size


def single(calibrations: Sequence[Calibration], format: str) -> Calibration:
    """Returns the one calibration.

    Raises:
        CalibrationError: there are several, or none.
    """
    if len(calibrations) != 1:
        raise CalibrationError(f"a file of {format} holds one camera, got {len(calibrations)}: write each to a file")
    return calibrations[0]


def no_room(calibration: Calibration, format: str, families: str) -> CalibrationError:
    """Returns the error of a lens that a format has no room for."""
    return CalibrationError(f"{format} holds {families}, not this {calibration.model}; {_CONVERT}")


def eucm(keys: Keys, values: Sequence[float]) -> tuple[float, float]:
    """Returns α and β of the extended unified lens, where there is such a lens."""
    alpha, beta = values
    if not 0 <= alpha <= 1:
        raise keys.wrong("alpha", f"must be between 0 and 1, got {alpha:g}")
    return alpha, keys.positive("beta", beta)
