"""Frames: between pixels and the normalized coordinates in which a map is written (Eq. 10)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxlens.numerics import as_floating, as_points, join, shown, split


class Frame(eqx.Module):
    """A centre and a scale: `normalized = (pixel − center) / scale`, for x and y.

    Pixel centres lie at integers: the first pixel of an image is at (0, 0).

    Attributes:
        center: (x, y) of the origin of normalized coordinates, in pixels.
        scale: Pixels per normalized unit along x and y; a single number serves both.
    """

    center: Float[Array, "2"]
    scale: Float[Array, "2"]

    def __init__(self, center: ArrayLike | Sequence, scale: ArrayLike | Sequence):
        self.center = _pair(center)
        self.scale = _pair(scale)

    def __repr__(self) -> str:
        return shown(self)

    @classmethod
    def half_diagonal(cls, height: ArrayLike, width: ArrayLike) -> "Frame":
        """Returns the frame of Eq. 10: centre (w/2, h/2), half the diagonal as unit.

        With pixel centres at integers the middle of the image is ((w − 1)/2, (h − 1)/2); Eq. 10's centre lies half
        a pixel to the right of it and below. See `docs/conventions.md`.
        """
        # Floating first: a size may be a symbol of `jax.export`, and of such there is no root.
        width, height = 1.0 * width, 1.0 * height
        return cls([width / 2, height / 2], (width**2 + height**2) ** 0.5 / 2)

    @classmethod
    def from_camera_matrix(cls, camera_matrix: Float[ArrayLike, "3 3"] | Sequence) -> "Frame":
        """Returns the frame of a camera matrix `[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]` without skew."""
        matrix = camera_matrix if isinstance(camera_matrix, jax.Array) else np.asarray(camera_matrix)
        if matrix.shape != (3, 3):
            raise ValueError(f"a camera matrix has shape (3, 3), got {matrix.shape}")
        return cls([matrix[0, 2], matrix[1, 2]], [matrix[0, 0], matrix[1, 1]])

    def normalize(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps pixels `(..., 2)`, (x, y) order, to normalized coordinates (Eq. 10)."""
        x, y = split(as_points(points))
        inverse = 1 / self.scale  # two divisions, not two a point
        return join((x - self.center[0]) * inverse[0], (y - self.center[1]) * inverse[1])

    def denormalize(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps normalized coordinates `(..., 2)`, (x, y) order, to pixels."""
        x, y = split(as_points(points))
        return join(x * self.scale[0] + self.center[0], y * self.scale[1] + self.center[1])

    def zoomed(self, zoom: ArrayLike) -> "Frame":
        """Returns the frame of a picture enlarged about this one's centre: `zoom` times the pixels per unit."""
        return type(self)(self.center, self.scale * zoom)

    def stretched(self, wide: ArrayLike, tall: ArrayLike) -> "Frame":
        """Returns the frame of a picture resized to that many times its width and height.

        Pixel centres lie at integers: it is the picture's corners, at −1/2, that keep their place.
        """
        factors = jnp.stack([jnp.asarray(factor, self.scale.dtype) for factor in (wide, tall)])
        return type(self)((self.center + 0.5) * factors - 0.5, self.scale * factors)

    def camera_matrix(self) -> Float[Array, "3 3"]:
        """Returns the frame as a camera matrix."""
        zero, one = jnp.zeros_like(self.scale[0]), jnp.ones_like(self.scale[0])
        (fx, fy), (cx, cy) = self.scale, self.center
        return jnp.stack([jnp.stack([fx, zero, cx]), jnp.stack([zero, fy, cy]), jnp.stack([zero, zero, one])])


def _pair(values: ArrayLike | Sequence) -> Float[Array, "2"]:
    array = as_floating(values)
    return array if array.shape == (2,) else jnp.broadcast_to(array, (2,))
