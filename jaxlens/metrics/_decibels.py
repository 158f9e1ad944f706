"""Ratios of powers on the scale of decibels."""

import jax.numpy as jnp
from jaxtyping import Array


def decibels(signal: Array, noise: Array) -> Array:
    """Returns ten times the common logarithm of a ratio of powers: `inf` without noise, `-inf` without signal.

    Each 0 is replaced before its logarithm is taken, so that the derivative is 0 there and not NaN.
    """
    level = jnp.log10(jnp.where(signal == 0, 1, signal)) - jnp.log10(jnp.where(noise == 0, 1, noise))
    level = jnp.where(signal == 0, -jnp.inf, level)
    # A signal of NaN (no traced range is below 0) stays NaN even without noise.
    return 10 * jnp.where((noise == 0) & ~jnp.isnan(signal), jnp.inf, level)
