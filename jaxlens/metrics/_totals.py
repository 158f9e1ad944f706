"""Sums over the pixels of a pair of images, of which pointwise metrics are made, and how those of strips add up."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxlens.metrics._inputs import RealScalar
from jaxlens.metrics._pointwise import mae, minkowski, mse

MINKOWSKI_P = 4.0


class Totals(NamedTuple):
    """What pointwise metrics are made of: scalars, or one value a strip.

    Attributes:
        samples: How many samples there are, channels included.
        data_range: L of Eq. 8.
        signal: Mean square of the reference.
        noise: Mean square of the error.
        absolute: Mean magnitude of the error.
        mean: Mean error.
        variance: Variance of the error.
        low: Least value of the reference.
        high: Greatest value of the reference.
        minkowski: (Σ |error|⁴)^¼.
    """

    samples: Float[Array, "*strips"]
    data_range: Float[Array, "*strips"]
    signal: Float[Array, "*strips"]
    noise: Float[Array, "*strips"]
    absolute: Float[Array, "*strips"]
    mean: Float[Array, "*strips"]
    variance: Float[Array, "*strips"]
    low: Float[Array, "*strips"]
    high: Float[Array, "*strips"]
    minkowski: Float[Array, "*strips"]


def totals_of(x: Array, y: Array, samples: RealScalar, data_range: RealScalar) -> Totals:
    """Computes the totals of one strip; `samples` is no constant of XLA's, which rounds differently with one."""
    noise = mse(x, y)
    floating = noise.dtype
    error = x.astype(floating) - y.astype(floating)
    samples = jnp.asarray(samples, floating)
    mean = jnp.sum(error) / samples
    return Totals(
        samples=samples,
        data_range=jnp.asarray(data_range, floating),
        signal=mse(x, jnp.zeros_like(x)),
        noise=noise,
        absolute=mae(x, y),
        mean=mean,
        variance=jnp.sum((error - mean) ** 2) / samples,
        low=jnp.min(x).astype(floating),
        high=jnp.max(x).astype(floating),
        minkowski=minkowski(x, y, p=MINKOWSKI_P),
    )


def totals_of_all(strips: Totals) -> Totals:
    """Computes the totals of the whole from those of its strips along the first axis."""

    def mean(values: Array) -> Array:
        return jnp.sum(values * strips.samples) / jnp.sum(strips.samples)

    error = mean(strips.mean)
    return Totals(
        samples=jnp.sum(strips.samples),
        data_range=strips.data_range[0],
        signal=mean(strips.signal),
        noise=mean(strips.noise),
        absolute=mean(strips.absolute),
        mean=error,
        # The spread within the strips and that of their means.
        variance=mean(strips.variance + (strips.mean - error) ** 2),
        low=jnp.min(strips.low),
        high=jnp.max(strips.high),
        minkowski=minkowski(strips.minkowski[None], jnp.zeros_like(strips.minkowski)[None], p=MINKOWSKI_P),
    )
