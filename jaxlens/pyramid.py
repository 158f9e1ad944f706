"""Image pyramids and pixel footprints, for sampling where a map shrinks the image."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxlens.numerics import split


class Pyramid(NamedTuple):
    """An image and its halvings, one after another in memory, so that each point can read at a level of its own.

    Attributes:
        pixels: The levels' pixels row by row, the finest first.
        offsets: Where each level, with what surrounds it, starts in `pixels`.
        heights: The height of each level alone.
        widths: The width of each level alone.
    """

    pixels: Float[Array, " size *channels"]
    offsets: Int[np.ndarray, " levels"]
    heights: Int[np.ndarray, " levels"]
    widths: Int[np.ndarray, " levels"]


def build_pyramid(image: Float[Array, "height width *channels"], surrounded: Callable[[Array], Array]) -> Pyramid:
    """Halves an image by 2×2 means until one of its sides is a pixel long; odd sides repeat their last line.

    Args:
        image: The image.
        surrounded: Gives the pixels of a level, row by row, with what shall surround it.
    """
    levels = [image]
    while min(levels[-1].shape[:2]) > 1:
        levels.append(halved(levels[-1]))
    pixels = [surrounded(level) for level in levels]
    offsets = np.cumsum([0, *(len(level) for level in pixels[:-1])], dtype=np.int32)
    heights, widths = np.array([level.shape[:2] for level in levels], np.int32).T
    return Pyramid(jnp.concatenate(pixels), offsets, heights, widths)


def halved(image: Float[Array, "height width *channels"]) -> Float[Array, "half_height half_width *channels"]:
    """Returns the image of 2×2 means; an odd side repeats its last line."""
    odd = [(0, size % 2) for size in image.shape[:2]] + [(0, 0)] * (image.ndim - 2)
    padded = jnp.pad(image, odd, mode="edge")
    return 0.25 * (padded[::2, ::2] + padded[1::2, ::2] + padded[::2, 1::2] + padded[1::2, 1::2])


def footprint(
    coordinates: Float[Array, "height width 2"],
) -> tuple[Float[Array, "height width 2"], Float[Array, "height width"], Float[Array, "height width"]]:
    """Measures the ellipse that each output pixel covers in the source.

    Its axes are the singular values of the map's Jacobian, taken from differences between neighbouring coordinates
    (one-sided at the edges of the grid and beside coordinates that are not finite, zero where there is nothing
    to compare). It carries no derivatives.

    Returns:
        The unit vector along the longer axis, and the lengths of the longer and the shorter axis in source pixels.
    """
    coordinates = lax.stop_gradient(coordinates)
    # The fourth powers of longer steps would overflow; they leave the image anyway.
    furthest = 0.1 * float(jnp.finfo(coordinates.dtype).max) ** 0.25
    coordinates = jnp.where(jnp.isfinite(coordinates), jnp.clip(coordinates, -furthest, furthest), jnp.nan)
    ax, ay = split(_difference(coordinates, axis=1))
    bx, by = split(_difference(coordinates, axis=0))
    # Eigenvalues and the leading eigenvector of J Jᵀ.
    mean = 0.5 * (ax * ax + bx * bx + ay * ay + by * by)
    half = 0.5 * (ax * ax + bx * bx - ay * ay - by * by)
    cross = ax * ay + bx * by
    radius = jnp.sqrt(half * half + cross * cross)
    angle = 0.5 * jnp.arctan2(cross, half)
    longer = jnp.sqrt(mean + radius)
    shorter = jnp.sqrt(jnp.maximum(mean - radius, 0))
    return jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1), longer, shorter


def _difference(values: Array, axis: int) -> Array:
    """Differentiates along an axis: centrally where both neighbours are finite, one-sidedly where one is, else zero."""
    forward = jnp.diff(values, axis=axis, append=jnp.nan)
    backward = jnp.roll(forward, 1, axis=axis)  # the appended NaN comes first
    has_forward, has_backward = jnp.isfinite(forward), jnp.isfinite(backward)
    total = jnp.where(has_forward, forward, 0) + jnp.where(has_backward, backward, 0)
    count = has_forward.astype(values.dtype) + has_backward.astype(values.dtype)
    return total / jnp.maximum(count, 1)
