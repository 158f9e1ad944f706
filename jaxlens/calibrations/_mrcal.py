"""mrcal's .cameramodel: a Python literal, of which nothing is run.

mrcal counts pixels from the first one's centre, x to the right, y down, as we do: nothing is converted. Its extrinsics
are not part of the camera.
"""

from collections.abc import Sequence

from jaxlens.calibrations._calibration import Calibration, Value
from jaxlens.calibrations._documents import Document
from jaxlens.calibrations._families import as_brown_conrady, brown_conrady, calibration, framed, no_room, single, sized
from jaxlens.calibrations._keys import Keys

_NAME = "mrcal"
_PREFIX = "LENSMODEL_"
_OPENCV = {"OPENCV4": 4, "OPENCV5": 5, "OPENCV8": 8, "OPENCV12": 12}
_BARE = {"PINHOLE": "Perspective", "STEREOGRAPHIC": "Stereographic", "LONLAT": "Equirectangular"}
_MODELS = ", ".join(_PREFIX + name for name in (*_OPENCV, *_BARE))
_FAMILIES = (
    "Perspective, Stereographic, Equirectangular, RadialPolynomial of up to 3 terms and BrownConrady of up to 12"
)


def recognizes(document: Document) -> bool:
    """Tells whether a file says which of mrcal's models it has."""
    return "lensmodel" in document.mapping or "lens_model" in document.mapping


def parse(document: Document) -> list[Calibration]:
    """Reads the camera."""
    keys = Keys(document, document.mapping)
    key = "lensmodel" if "lensmodel" in keys else "lens_model"
    model = keys.text(key).removeprefix(_PREFIX)
    if model not in _OPENCV and model not in _BARE:
        # LATLON's poles are left and right, and no lens here has them there.
        raise keys.wrong(key, f"{_PREFIX}{model[:40]} is no lens of jaxlens; read are {_MODELS}")
    size_key = "imagersize" if "imagersize" in keys else "imager_size"
    width, height = keys.numbers(size_key, (2,))
    size = keys.whole(size_key, width), keys.whole(size_key, height)
    fx, fy, cx, cy, *rest = keys.numbers("intrinsics", (4 + _OPENCV.get(model, 0),))
    lens: tuple[str, dict[str, Value]] = brown_conrady(rest) if rest else (_BARE[model], {})
    focal = keys.positive("intrinsics", fx), keys.positive("intrinsics", fy)
    return [calibration(lens, focal, (cx, cy), size)]


def render(calibrations: Sequence[Calibration]) -> str:
    """Returns a .cameramodel, its camera in the origin."""
    one = single(calibrations, _NAME)
    width, height = sized(one, _NAME)
    model, rest = _as_mrcal(one)
    return "\n".join(
        [
            "{",
            f"    'lensmodel': '{_PREFIX}{model}',",
            f"    'intrinsics': {[*framed(one, _NAME), *rest]!r},",
            "    'extrinsics': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],",
            f"    'imagersize': [{width}, {height}],",
            "}",
            "",
        ]
    )


def _as_mrcal(one: Calibration) -> tuple[str, tuple[float, ...]]:
    for model, family in _BARE.items():
        if one.model == family:
            return model, ()
    for model, count in _OPENCV.items():
        values = as_brown_conrady(one, (count,))
        if values is not None:
            return model, values
    raise no_room(one, _NAME, _FAMILIES)
