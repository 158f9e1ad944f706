"""Making data with a known lens, and recovering the lens from them, many times over."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxlens.fitting import Fit, FitStatus, fit_images, fit_points
from jaxlens.frames import Frame
from jaxlens.lenses import RadialPolynomial
from jaxlens.warping import distort_image


@dataclass(frozen=True)
class Recovery:
    """How well a lens came back.

    Attributes:
        method: What it was recovered from, `points` or `pictures`.
        kappa: The lens.
        noise: Of the data.
        unit: Of the noise.
        fits: How many data sets were made.
        failed: Fits that did not converge; they are in none of the figures below.
        errors: For each coefficient the root of the mean squared error.
        predicted: For each the root of the mean predicted variance.
    """

    method: str
    kappa: tuple[float, ...]
    noise: float
    unit: str
    fits: int
    failed: int
    errors: tuple[float, ...]
    predicted: tuple[float, ...]


def from_points(
    kappa: Float[Array, " order"], noise: float, key: Array, height: int, width: int, *, count: int, seeds: int
) -> Recovery:
    """Recovers a lens from points, all sets of them under one `vmap`.

    Args:
        kappa: The lens.
        noise: Standard deviation of a coordinate, in pixels.
        key: Of the random numbers.
        height: Of the picture over which observed points are spread.
        width: Of it.
        count: Points in a set.
        seeds: Sets.
    """
    fits = _fits_of_points(kappa, noise, jax.random.split(key, seeds), height=height, width=width, count=count)
    return _recovery("points", kappa, noise, "px", fits.values, fits.standard_errors, fits.status)


@partial(jax.jit, static_argnames=("height", "width", "count"))
def _fits_of_points(
    kappa: Float[Array, " order"], noise: float | Float[Array, ""], keys: Array, *, height: int, width: int, count: int
) -> Fit:
    """Makes a set of points for each key, and fits each; one program for every lens and level of noise."""
    frame, lens = Frame.half_diagonal(height, width), RadialPolynomial(kappa)
    size = jnp.asarray([width - 1, height - 1], kappa.dtype)

    def once(key: Array) -> Fit:
        places, errors = jax.random.split(key)
        observed = jax.random.uniform(places, (count, 2), kappa.dtype) * size[None]
        ideal = lens.invert(frame.normalize(observed)).points
        observed = observed + noise * jax.random.normal(errors, (count, 2), kappa.dtype)
        return fit_points(RadialPolynomial(jnp.zeros_like(kappa)), ideal, observed, frame=frame)

    return jax.vmap(once)(keys)


def from_pictures(
    kappa: Float[Array, " order"],
    noise: float,
    key: Array,
    source: Float[np.ndarray, "height width"],
    *,
    peak: float,
    gain: float,
    offset: float,
    seeds: int,
) -> Recovery:
    """Recovers a lens from pairs of pictures, one after another.

    Args:
        kappa: The lens.
        noise: Standard deviation of a gray value of the distorted picture, as a share of the peak.
        key: Of the random numbers.
        source: The picture without the lens.
        peak: The largest gray value.
        gain: Of the distorted picture.
        offset: Of it, as a share of the peak.
        seeds: Pairs; without noise one is enough, for all are alike.
    """
    clean = gain * distort_image(source, RadialPolynomial(kappa)) + offset * peak
    start, values, errors, status = RadialPolynomial(jnp.zeros_like(kappa)), [], [], []
    for one in jax.random.split(key, seeds if noise > 0 else 1):
        distorted = clean + noise * peak * jax.random.normal(one, clean.shape, clean.dtype)
        fit = fit_images(start, source, distorted, throw=False)
        values.append(fit.values)
        errors.append(fit.standard_errors)
        status.append(fit.status)
    return _recovery("pictures", kappa, noise, "× peak", jnp.stack(values), jnp.stack(errors), jnp.stack(status))


def _recovery(
    method: str, kappa: Array, noise: float, unit: str, values: Array, errors: Array, status: Array
) -> Recovery:
    order = kappa.shape[0]
    good = np.asarray(status) == FitStatus.CONVERGED
    deviations = (np.asarray(values)[:, :order] - np.asarray(kappa))[good]
    predicted = np.asarray(errors)[:, :order][good]
    return Recovery(
        method,
        tuple(float(value) for value in kappa),
        noise,
        unit,
        len(good),
        int(np.sum(~good)),
        tuple(float(value) for value in np.sqrt(np.mean(deviations**2, axis=0))),
        tuple(float(value) for value in np.sqrt(np.mean(predicted**2, axis=0))),
    )
