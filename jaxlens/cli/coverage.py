"""What a lens leaves of a picture: where it folds, which is warned of, and the rectangle that --crop keeps."""

import math
from dataclasses import dataclass
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxlens import diagnostics
from jaxlens.cli.lenses import LensChoice
from jaxlens.cli.views import AS_IT_IS, Direction, View, place
from jaxlens.frames import Frame
from jaxlens.lenses import RadialLens
from jaxlens.maps import CoordinateMap
from jaxlens.warping import source_coordinates


@dataclass(frozen=True)
class Fold:
    """Where a lens stops being one-to-one, and what that costs a picture.

    Attributes:
        radius: The ideal radius in normalized coordinates (half-diagonals of the picture, in Eq. 10's frame); None for
            a lens that has no one radius.
        pixels: The same in pixels, along the shorter axis of the frame.
        share: The share of the output's pixels that have no preimage.
    """

    radius: float | None
    pixels: float | None
    share: float


@cache
def inner_rectangle(
    chosen: LensChoice, direction: Direction, height: int, width: int, view: View = AS_IT_IS
) -> tuple[int, int, int, int]:
    """Finds the largest upright rectangle of the output that draws from inside the picture throughout.

    Returns:
        (top, left, height, width) in pixels, all zero where there is none.
    """
    with jax.enable_x64(False):
        placed = place(chosen, direction, height, width, view)
        covered = diagnostics.coverage(
            placed.mapping, height, width, frame=placed.frame, output_frame=placed.output_frame, shape=placed.shape
        )
        top, left, tall, wide = (int(value) for value in diagnostics.largest_rectangle(covered))
    return top, left, tall, wide


@cache
def find_fold(chosen: LensChoice, direction: Direction, height: int, width: int, view: View = AS_IT_IS) -> Fold | None:
    """Tells whether the lens folds inside a picture of this size, and what that costs; None if it does not."""
    with jax.enable_x64(False):
        placed = place(chosen, direction, height, width, view)
        lens, frame = chosen.place(height, width)
        radius = pixels = None
        if isinstance(lens, RadialLens):
            (x, y), (wide, tall) = (np.asarray(part).tolist() for part in (frame.denormalize(lens.center), frame.scale))
            corner = math.hypot(max(x, width - 1 - x) / wide, max(y, height - 1 - y) / tall)
            fold, edge = (float(value) for value in _fold_radii(lens))
            # Of distorting, pixels beyond the fold's observed radius are without a preimage; and what of the source
            # lies beyond the fold itself is seen nowhere.
            if view == AS_IT_IS and fold >= corner and (direction == "undistort" or edge >= corner):
                return None
            if math.isfinite(fold):
                radius, pixels = fold, fold * min(wide, tall)
        share = float(_share_without_source(placed.mapping, frame, placed.output_frame, (height, width), placed.shape))
    if share == 0 and (radius is None or view != AS_IT_IS):
        return None
    return Fold(radius, pixels, share)


@jax.jit
def _fold_radii(lens: RadialLens) -> tuple[Float[Array, ""], Float[Array, ""]]:
    return lens.fold_radius(), lens.edge_radius()


@partial(jax.jit, static_argnames=("size", "shape"))
def _share_without_source(
    mapping: CoordinateMap, frame: Frame, output_frame: Frame, size: tuple[int, int], shape: tuple[int, int]
) -> Float[Array, ""]:
    sources = source_coordinates(mapping, *size, frame=frame, output_frame=output_frame, shape=shape)
    return jnp.mean(jnp.isnan(sources[..., 0]).astype(sources.dtype))
