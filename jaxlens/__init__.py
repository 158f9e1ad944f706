"""Lens distortion in JAX: exact inverses with a validity mask, implicit gradients, batches, speed."""

from jaxlens import metrics as metrics
from jaxlens.frames import Frame as Frame
from jaxlens.lenses import (
    Division as Division,
    Lens as Lens,
    RadialLens as RadialLens,
    RadialPolynomial as RadialPolynomial,
)
from jaxlens.maps import (
    Chain as Chain,
    CoordinateMap as CoordinateMap,
    Inverse as Inverse,
    InverseStatus as InverseStatus,
    Inverted as Inverted,
    OneToOne as OneToOne,
)
from jaxlens.sampling import remap as remap
from jaxlens.warping import (
    distort_image as distort_image,
    distortion_map as distortion_map,
    source_coordinates as source_coordinates,
    undistort_image as undistort_image,
    undistortion_map as undistortion_map,
    warp as warp,
)
