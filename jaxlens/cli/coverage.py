"""What a lens leaves of a picture: where it folds, which is warned of, and the rectangle that --crop keeps."""

import math
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxlens import diagnostics
from jaxlens.cli.lenses import LensChoice
from jaxlens.frames import Frame
from jaxlens.lenses import Lens, RadialLens
from jaxlens.maps import CoordinateMap, OneToOne
from jaxlens.warping import source_coordinates

Direction = Literal["distort", "undistort"]


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


def mapping_of(lens: Lens, direction: Direction) -> CoordinateMap:
    """Returns the map from pixels of the result to those of the picture."""
    return lens.inverse() if direction == "distort" else OneToOne(lens)


@cache
def inner_rectangle(chosen: LensChoice, direction: Direction, height: int, width: int) -> tuple[int, int, int, int]:
    """Finds the largest upright rectangle of the output that draws from inside the picture throughout.

    Returns:
        (top, left, height, width) in pixels, all zero where there is none.
    """
    with jax.enable_x64(False):
        lens, frame = chosen.place(height, width)
        covered = diagnostics.coverage(mapping_of(lens, direction), height, width, frame=frame)
        top, left, tall, wide = (int(value) for value in diagnostics.largest_rectangle(covered))
    return top, left, tall, wide


@cache
def find_fold(chosen: LensChoice, direction: Direction, height: int, width: int) -> Fold | None:
    """Tells whether the lens folds inside a picture of this size, and what that costs; None if it does not."""
    with jax.enable_x64(False):
        lens, frame = chosen.place(height, width)
        mapping = mapping_of(lens, direction)
        if not isinstance(lens, RadialLens):
            share = float(_share_without_source(mapping, frame, height, width))
            return Fold(None, None, share) if share > 0 else None
        (x, y), (wide, tall) = (np.asarray(part).tolist() for part in (frame.denormalize(lens.center), frame.scale))
        corner = math.hypot(max(x, width - 1 - x) / wide, max(y, height - 1 - y) / tall)
        radius, edge = (float(value) for value in _fold_radii(lens))
        # Of distorting, pixels beyond the fold's observed radius are without a preimage; and what of the source lies
        # beyond the fold itself is seen nowhere.
        if radius >= corner and (direction == "undistort" or edge >= corner):
            return None
        share = float(_share_without_source(mapping, frame, height, width))
    return Fold(radius, radius * min(wide, tall), share)


@jax.jit
def _fold_radii(lens: RadialLens) -> tuple[Float[Array, ""], Float[Array, ""]]:
    return lens.fold_radius(), lens.edge_radius()


@partial(jax.jit, static_argnames=("height", "width"))
def _share_without_source(mapping: CoordinateMap, frame: Frame, height: int, width: int) -> Float[Array, ""]:
    sources = source_coordinates(mapping, height, width, frame=frame)
    return jnp.mean(jnp.isnan(sources[..., 0]).astype(sources.dtype))
