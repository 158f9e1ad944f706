"""Lens distortion in JAX: exact inverses with a validity mask, implicit gradients, batches, speed.

The names below are imported when they are first used, so that `jaxlens --help` need not wait for JAX.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxlens import calibrations as calibrations
    from jaxlens import deformations as deformations
    from jaxlens import diagnostics as diagnostics
    from jaxlens import fitting as fitting
    from jaxlens import images as images
    from jaxlens import lenses as lenses
    from jaxlens import meshes as meshes
    from jaxlens import metrics as metrics
    from jaxlens import projections as projections
    from jaxlens import self_calibration as self_calibration
    from jaxlens import surfaces as surfaces
    from jaxlens.frames import Frame as Frame
    from jaxlens.lenses import BrownConrady as BrownConrady
    from jaxlens.lenses import Division as Division
    from jaxlens.lenses import Lens as Lens
    from jaxlens.lenses import RadialLens as RadialLens
    from jaxlens.lenses import RadialPolynomial as RadialPolynomial
    from jaxlens.maps import Chain as Chain
    from jaxlens.maps import CoordinateMap as CoordinateMap
    from jaxlens.maps import Inverse as Inverse
    from jaxlens.maps import InverseStatus as InverseStatus
    from jaxlens.maps import Inverted as Inverted
    from jaxlens.maps import OneToOne as OneToOne
    from jaxlens.sampling import remap as remap
    from jaxlens.warping import distort_image as distort_image
    from jaxlens.warping import distortion_map as distortion_map
    from jaxlens.warping import source_coordinates as source_coordinates
    from jaxlens.warping import undistort_image as undistort_image
    from jaxlens.warping import undistortion_map as undistortion_map
    from jaxlens.warping import warp as warp

# The same names for the interpreter, module by module; a test holds the two lists together.
_MODULES = (
    "calibrations",
    "deformations",
    "diagnostics",
    "fitting",
    "images",
    "lenses",
    "meshes",
    "metrics",
    "projections",
    "self_calibration",
    "surfaces",
)
_NAMES = {
    "frames": ("Frame",),
    "lenses": ("BrownConrady", "Division", "Lens", "RadialLens", "RadialPolynomial"),
    "maps": ("Chain", "CoordinateMap", "Inverse", "InverseStatus", "Inverted", "OneToOne"),
    "sampling": ("remap",),
    "warping": (
        "distort_image",
        "distortion_map",
        "source_coordinates",
        "undistort_image",
        "undistortion_map",
        "warp",
    ),
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}

if not TYPE_CHECKING:
    __all__ = sorted([*_MODULES, *_HOMES])

    def __getattr__(name: str) -> object:
        from importlib import import_module

        if name in _MODULES:
            return import_module(f"jaxlens.{name}")
        if name in _HOMES:
            value = globals()[name] = getattr(import_module(f"jaxlens.{_HOMES[name]}"), name)
            return value
        raise AttributeError(f"module 'jaxlens' has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
