"""Robust losses: how much a residual counts, once it is larger than noise explains."""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Loss = Literal["linear", "huber", "cauchy"]
"""`linear` is plain least squares. `huber` grows linearly beyond the loss scale, `cauchy` only as a logarithm."""

# Multiples of the noise at which a loss bends: 95 % efficiency for normal noise.
_TUNING = {"huber": 1.345, "cauchy": 2.3849}
# Medians of the length of normal noise of unit variance per component, by the number of components.
_MEDIAN_LENGTH = {1: 0.67449, 2: 1.17741, 3: 1.53817, 4: 1.83213}


def robustify(
    residuals: Float[Array, "*batch components"], loss: Loss, scale: Float[Array, ""]
) -> Float[Array, "*batch components"]:
    """Returns residuals whose squares sum to the robust loss: r √(ρ(z) / z) with z = |r|² / scale².

    So any least-squares method minimizes it, and the implicit function theorem applies to what it finds.
    """
    if loss == "linear":
        return residuals
    z = jnp.sum(residuals**2, axis=-1, keepdims=True) / scale**2
    small = z < 1e-6
    safe = jnp.where(small, 1, z)
    if loss == "huber":
        share = jnp.where(safe <= 1, 1, (2 * jnp.sqrt(safe) - 1) / safe)
        series = jnp.ones_like(z)
    else:
        share = jnp.log1p(safe) / safe
        series = 1 - z / 2
    return residuals * jnp.sqrt(jnp.where(small, series, share))


def influence(
    residuals: Float[Array, "*batch components"], loss: Loss, scale: Float[Array, ""]
) -> Float[Array, "*batch components"]:
    """Returns ψ(r) = ρ'(z) r, the derivative of half the loss."""
    if loss == "linear":
        return residuals
    z = jnp.sum(residuals**2, axis=-1, keepdims=True) / scale**2
    if loss == "huber":
        return residuals * jnp.where(z <= 1, 1, jax.lax.rsqrt(jnp.maximum(z, 1)))
    return residuals / (1 + z)


def noise_scale(
    residuals: Float[Array, "*batch components"], weights: Float[Array, "*batch"], loss: Loss
) -> Float[Array, ""]:
    """Returns where the loss should bend, from the median length of the residuals with positive weight."""
    length = jnp.sqrt(jnp.sum(residuals**2, axis=-1)).ravel()
    used = weights.ravel() > 0
    ordered = jnp.sort(jnp.where(used, length, jnp.inf))
    count = jnp.sum(used)
    median = ordered[jnp.maximum(count - 1, 0) // 2]
    noise = median / _MEDIAN_LENGTH[residuals.shape[-1]]
    # Exact data have no noise to tell outliers from; any positive scale then serves.
    smallest = 100 * jnp.finfo(length.dtype).eps
    return _TUNING.get(loss, 1.0) * jnp.maximum(jnp.where(jnp.isfinite(noise), noise, 1), smallest)
