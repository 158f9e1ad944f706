"""A free-form deformation of a part of a picture: its settings, and where it tears, folds and covers."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxlens.deformations import FreeForm
from jaxlens.experiments.schema import ControlPointMove, Crop, Warp
from jaxlens.sampling import remap
from jaxlens.warping import pixel_grid

# Points along each side of the border.
_SAMPLES = 401


@dataclass(frozen=True, eq=False)
class Deformed:
    """What a deformation, written in pixels, makes of a picture.

    Attributes:
        mapping: The deformation: where points of the picture go.
        picture: The picture, pulled back through the inverse.
        determinant: `(H, W)`, the change of area at each pixel of the initial picture; NaN outside the rectangle.
        gap: `(H, W)`, pixels of the new picture that nothing is moved to.
        covered: `(H, W)`, pixels of the new picture outside the rectangle that are moved over.
        measures: Numbers by name.
    """

    mapping: FreeForm
    picture: Float[np.ndarray, "height width *channels"]
    determinant: Float[np.ndarray, "height width"]
    gap: Bool[np.ndarray, "height width"]
    covered: Bool[np.ndarray, "height width"]
    measures: dict[str, float | int]


def lattice_of(region: Crop, degrees: Sequence[int], dtype: str) -> FreeForm:
    """Returns the deformation that moves nothing, of the area that a rectangle of pixels covers."""
    # Pixel centres lie at integers: the area begins half a pixel before the first of them.
    lower = jnp.asarray([region.left - 0.5, region.top - 0.5], dtype)
    return FreeForm.identity(*degrees, lower=lower, upper=lower + jnp.asarray([region.width, region.height], dtype))


def moved(still: FreeForm, moves: Sequence[ControlPointMove]) -> FreeForm:
    """Returns a deformation whose control points are moved, and weighted."""
    control_points, weights = still.control_points, jnp.ones(still.control_points.shape[:2], still.control_points.dtype)
    for move in moves:
        step = jnp.asarray([move.dx, move.dy], control_points.dtype)
        control_points = control_points.at[move.column, move.row].add(step)
        weights = weights.at[move.column, move.row].set(move.weight)
    equal = all(move.weight == 1 for move in moves)
    return FreeForm(control_points, weights=None if equal else weights, lower=still.lower, upper=still.upper)


def deform(pixels: Float[np.ndarray, "height width *channels"], mapping: FreeForm, warp: Warp) -> Deformed:
    """Deforms a picture, and looks at the deformation at every pixel and along its border."""
    seen = {name: np.asarray(value) for name, value in _at_pixels(jnp.asarray(pixels), mapping, warp=warp).items()}
    jump, slope = (float(value) for value in _at_border(mapping, _border_of(mapping)))
    determinant = np.where(seen["inside"], seen["determinant"], np.nan)
    gap, covered = ~seen["valid"], seen["covered"]
    measures: dict[str, float | int] = {
        "largest_displacement_px": max(float(seen["displacement"].max()), jump),
        "jump_at_border_px": jump,
        "slope_jump_at_border": slope,
        "smallest_determinant": float(np.nanmin(determinant)),
        "largest_determinant": float(np.nanmax(determinant)),
        "folded_px": int(np.sum(determinant <= 0)),
        "gap_px": int(gap.sum()),
        "covered_px": int(covered.sum()),
        "round_trip_px": float(seen["round_trip"].max()),
    }
    return Deformed(mapping, seen["picture"], determinant, gap, covered, measures)


@partial(jax.jit, static_argnames="warp")
def _at_pixels(image: Array, mapping: FreeForm, *, warp: Warp) -> dict[str, Array]:
    """The picture, and at each pixel: of the initial picture the forward map's, of the new one its inverse's."""
    height, width = image.shape[:2]
    pixels = pixel_grid(height, width, mapping.lower.dtype)
    inverse = mapping.invert(pixels)
    inside = mapping.contains(pixels)
    return {
        "picture": remap(
            image,
            inverse.masked(),
            method=warp.method,
            border=warp.border,
            fill=warp.fill,
            antialias=warp.antialias,
        ),
        "inside": inside,
        "displacement": _length(mapping(pixels) - pixels),
        "determinant": mapping.jacobian_determinant(pixels),
        "valid": inverse.valid,
        "covered": inverse.valid & mapping.contains(inverse.points) & ~inside,
        "round_trip": jnp.where(inverse.valid, _length(mapping(inverse.points) - pixels), 0),
    }


def _border_of(mapping: FreeForm) -> Float[np.ndarray, "sides points 2"]:
    along = np.linspace(0, 1, _SAMPLES)
    zero, one = np.zeros_like(along), np.ones_like(along)
    unit = np.stack([np.stack(side, axis=-1) for side in ((along, zero), (along, one), (zero, along), (one, along))])
    lower, upper = np.asarray(mapping.lower), np.asarray(mapping.upper)
    # Both ends are the corners to the last bit, so that the border lies in the rectangle.
    return (lower * (1 - unit) + upper * unit).astype(lower.dtype)


@jax.jit
def _at_border(mapping: FreeForm, border: Float[Array, "sides points 2"]) -> tuple[Array, Array]:
    """How far the border's points are moved at most, and how much the derivative there differs from that outside."""
    change = mapping.jacobian(border) - jnp.eye(2, dtype=border.dtype)[None, None]
    return jnp.max(_length(mapping(border) - border)), jnp.max(jnp.abs(change))


def _length(vectors: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    return jnp.hypot(vectors[..., 0], vectors[..., 1])
