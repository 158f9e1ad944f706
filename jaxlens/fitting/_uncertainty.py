"""How well a calibrated camera is known: where it puts a ray, with its standard deviation."""

from functools import partial
from typing import TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from jaxlens.fitting._parameters import Selection, named
from jaxlens.fitting._poses import rotation_matrix
from jaxlens.fitting._result import Fit
from jaxlens.frames import Frame
from jaxlens.lenses import Lens, RadialLens, WideLens
from jaxlens.numerics import as_points, split

# Columns and rows of the rays over which the best rotation of a picture is sought.
_GRID = (16, 12)


@jax.jit
def projection_uncertainty(fit: Fit, pixels: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch"]:
    """Does the work of `Fit.projection_uncertainty`."""
    assert fit.frame is not None
    assert fit.image_size is not None
    assert isinstance(fit.lens, Lens)
    selection, places = named(model_of(fit.frame, fit.lens), fit.names)
    steps = [jnp.linspace(0, 1, count, dtype=fit.values.dtype) for count in _GRID]
    grid = jnp.stack(jnp.meshgrid(*steps), axis=-1).reshape(-1, 2) * (fit.image_size - 1)[None]
    pixels = as_points(pixels).astype(fit.values.dtype)
    # One inverse for both: it is what takes longest to compile.
    every = jnp.concatenate([grid, pixels.reshape(-1, 2)])
    rays = fit.lens.unproject(fit.frame.normalize(every))
    turns = best_rotation(selection, rays[: len(grid)])
    root = root_of(fit.covariance[np.ix_(places, places)])
    rays = rays[len(grid) :].reshape(*pixels.shape[:-1], 3)
    xx, xy, yy = covariance_of_pixels(selection, root, turns, rays)
    # The larger eigenvalue; where both are one, the root has no slope.
    apart = 0.25 * (xx - yy) ** 2 + xy**2
    variance = 0.5 * (xx + yy) + jnp.where(apart > 0, jnp.sqrt(jnp.where(apart > 0, apart, 1)), 0)
    return jnp.where(variance > 0, jnp.sqrt(jnp.where(variance > 0, variance, 1)), variance)


def model_of(frame: Frame, lens: Lens) -> dict:
    """Returns what a calibration fits, as a pytree in which the frame's numbers are called fx, fy, cx and cy."""
    return {"camera": {"focal_length": frame.scale, "principal_point": frame.center}, "lens": lens}


def frame_of(model: dict) -> Frame:
    """Returns the frame of a fitted model."""
    return Frame(model["camera"]["principal_point"], model["camera"]["focal_length"])


def is_wide(lens: Lens) -> TypeGuard[WideLens]:
    """Tells whether a lens is fitted on rays; a radial one that also has them fits more surely on the plane."""
    return isinstance(lens, WideLens) and not isinstance(lens, RadialLens)


def seen_at(lens: Lens, frame: Frame, places: Float[Array, "*batch 3"]) -> Float[Array, "*batch 2"]:
    """Returns the pixels at which points before a camera are seen, smooth also beyond what it really sees.

    A fit may pass through there, and comes back only where derivatives lead.
    """
    if is_wide(lens):
        return frame.denormalize(lens.observe(places)[0])
    return frame.denormalize(lens.distort(places[..., :2] / places[..., 2:]))


def best_rotation(
    selection: Selection, rays: Float[Array, "rays 3"], weights: Float[Array, " rays"] | None = None
) -> Float[Array, "3 parameters"]:
    """Returns which rotation of the camera best undoes, over some rays, what a unit of each parameter does to pixels.

    Args:
        selection: A model of a camera and a lens, and which of its numbers are known from a fit alone.
        rays: The rays; what the camera does not see does not count.
        weights: Of the rays; ones by default.
    """
    pixels, derivative = jax.linearize(partial(_pixels, selection, rays), selection.values(), jnp.zeros(3, rays.dtype))
    count = selection.values().shape[0]
    units = jnp.eye(count + 3, dtype=pixels.dtype)
    columns = jax.vmap(lambda unit: derivative(unit[:count], unit[count:]))(units)
    seen = jnp.isfinite(pixels)
    scale = seen if weights is None else jnp.where(seen, jnp.sqrt(weights)[:, None], 0)
    columns = jnp.where(seen[None], columns, 0) * scale[None]
    gram = jnp.einsum("anc,bnc->ab", columns[count:], columns)
    return -jnp.linalg.solve(gram[:, count:], gram[:, :count])


def covariance_of_pixels(
    selection: Selection,
    root: Float[Array, "parameters parameters"],
    turns: Float[Array, "3 parameters"],
    rays: Float[Array, "*batch 3"],
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"], Float[Array, "*batch"]]:
    """Returns the covariance of where rays are seen, its xx, xy and yy, after the best rotation.

    Args:
        selection: As of `best_rotation`.
        root: A root of the parameters' covariance: its columns are independent errors of one standard deviation.
        turns: What `best_rotation` returned.
        rays: The rays.
    """
    _, derivative = jax.linearize(partial(_pixels, selection, rays), selection.values(), jnp.zeros(3, rays.dtype))

    def add(sums, error):
        dx, dy = split(derivative(error, turns @ error))
        return (sums[0] + dx * dx, sums[1] + dx * dy, sums[2] + dy * dy), None

    # One error after the other: as many planes as there are parameters would not fit into memory for a large picture.
    zeros = jnp.zeros(rays.shape[:-1], rays.dtype)
    return lax.scan(add, (zeros, zeros, zeros), root.T)[0]


def _pixels(selection: Selection, rays: Array, values: Array, turn: Array) -> Float[Array, "*batch 2"]:
    model = selection.insert(values)
    return seen_at(model["lens"], frame_of(model), rays @ rotation_matrix(turn).T)


def root_of(covariance: Float[Array, "parameters parameters"]) -> Float[Array, "parameters parameters"]:
    """Returns a root of a covariance, NaN where that is."""
    errors = jnp.sqrt(jnp.diagonal(covariance))
    unit = jnp.where(errors > 0, 1 / jnp.where(errors > 0, errors, 1), 0)
    correlation = jnp.fill_diagonal(covariance * unit[:, None] * unit[None], 1, inplace=False)
    return jnp.linalg.cholesky(correlation) * errors[:, None]
