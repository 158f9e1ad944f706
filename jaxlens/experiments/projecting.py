"""Integral projections of a picture before and after a lens of Section 2.4, and how far it should move them."""

from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxlens.experiments.schema import Warp
from jaxlens.frames import Frame
from jaxlens.lenses import RadialPolynomial
from jaxlens.projections import integral_projections, projection_displacement
from jaxlens.warping import pixel_grid, undistort_image, undistortion_map

Axis = Literal["x", "y"]
AXES: tuple[Axis, ...] = ("x", "y")
"""Along which a profile runs: `x` has the mean of each column, `y` that of each row."""

# How far beyond the outermost centres a source may lie, in pixels: coordinates are rounded.
_EDGE = 1e-3


@dataclass(frozen=True, eq=False)
class Profile:
    """One projection of the distorted picture against that of the initial one, element by element.

    Attributes:
        initial: Gray levels.
        distorted: Likewise; NaN where the whole row or column has no source.
        measured: How far the initial profile's features have moved along it, in pixels; NaN where not found.
        score: The correlation of the match; NaN likewise.
        expected: What the lens lets expect: the mean displacement of the pixels of the window, weighted by their
            squared slopes along the profile; NaN where there is no slope.
    """

    initial: Float[np.ndarray, " length"]
    distorted: Float[np.ndarray, " length"]
    measured: Float[np.ndarray, " length"]
    score: Float[np.ndarray, " length"]
    expected: Float[np.ndarray, " length"]

    @property
    def error(self) -> Float[np.ndarray, " length"]:
        """Measured less expected displacement, where there are both."""
        error = self.measured - self.expected
        return error[np.isfinite(error)]


def distorted(
    pixels: Float[np.ndarray, "height width"], k: float, warp: Warp
) -> tuple[Float[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
    """Returns the picture that Section 2.4 makes, 1 + k r² taking output to source, and which pixels have a source."""
    lens, (height, width) = _lens(k, pixels), pixels.shape
    picture = undistort_image(
        jnp.asarray(pixels), lens, method=warp.method, border=warp.border, fill=warp.fill, antialias=warp.antialias
    )
    x, y = np.moveaxis(np.asarray(undistortion_map(lens, height, width)), -1, 0)
    # Further out the border's value would be mixed in.
    seen = (x >= -_EDGE) & (x <= width - 1 + _EDGE) & (y >= -_EDGE) & (y <= height - 1 + _EDGE)
    return np.asarray(picture), seen


def profiles(
    pixels: Float[np.ndarray, "height width"],
    picture: Float[np.ndarray, "height width"],
    seen: Bool[np.ndarray, "height width"],
    k: float,
    *,
    window: int,
    largest: int,
    least_score: float,
) -> dict[Axis, Profile]:
    """Compares the projections of a picture and of its distorted one, over the pixels that have a source."""
    before, after = integral_projections(pixels), integral_projections(picture, mask=seen)
    pairs = {
        "x": (before.vertical, after.vertical, after.vertical_valid),
        "y": (before.horizontal, after.horizontal, after.horizontal_valid),
    }
    expected, found = _expected(pixels, k, window), {}
    for axis in AXES:
        reference, other, there = pairs[axis]
        result = projection_displacement(reference, other, window=window, largest=largest)
        good = np.asarray(result.valid) & (np.asarray(result.score) >= least_score)
        found[axis] = Profile(
            np.asarray(reference),
            np.where(there, other, np.nan),
            np.where(good, result.displacement, np.nan),
            np.where(good, result.score, np.nan),
            expected[axis],
        )
    return found


def _expected(pixels: Float[np.ndarray, "height width"], k: float, window: int) -> dict[Axis, np.ndarray]:
    height, width = pixels.shape
    frame, grid = Frame.half_diagonal(height, width), pixel_grid(height, width, pixels.dtype)
    # Section 2.4 maps output to source: features go where its inverse takes them.
    inverse = _lens(k, pixels).invert(frame.normalize(grid))
    moved = np.asarray(frame.denormalize(inverse.points) - grid)
    found: dict[Axis, np.ndarray] = {}
    for index, axis in enumerate(AXES):
        # Along x (index 0) runs the array's second axis.
        weight = np.where(inverse.valid, np.gradient(pixels, axis=1 - index) ** 2, 0)
        total, slope = (
            np.convolve(one.sum(axis=index), np.ones(window), "same") for one in (weight * moved[..., index], weight)
        )
        there = slope > 1e-9 * slope.max()
        found[axis] = np.where(there, total / np.where(there, slope, 1), np.nan)
    return found


def _lens(k: float, pixels: Float[np.ndarray, "height width"]) -> RadialPolynomial:
    return RadialPolynomial(jnp.asarray([k], pixels.dtype))
