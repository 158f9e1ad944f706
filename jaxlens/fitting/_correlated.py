"""Residuals of pictures are correlated from pixel to pixel where these were compressed or resampled: what that adds.

The variance of an estimate is that of a sum over pixels of residual times influence. Where neighbouring residuals agree
it is larger than the sum of the variances. It is estimated by sums over windows, in place of pixels: what lies in
windows apart is taken for independent (Bartlett's kernel; Newey and West 1987, Conley 1999).
"""

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

# The side of a window in pixels: two of the blocks in which JPEG rounds.
WINDOW = 16
# Neighbours that agree by so many standard errors do not by chance.
_CHANCE = 4.0


def variance_inflation(
    influences: Callable[[Float[Array, " parameters"]], Float[Array, "height width"]],
    residuals: Float[Array, "height width"],
    inverse: Float[Array, "parameters parameters"],
) -> Float[Array, " parameters"]:
    """Returns how many times correlation inflates the variance of each estimate; ones where none is seen.

    Args:
        influences: The change of all predictions for a change of the parameters: J times a vector.
        residuals: What moves the estimates, zero where nothing counts.
        inverse: The inverse of JᵀJ, to any factor.
    """
    count = jnp.sum(residuals != 0)

    def one(column: Array) -> Array:
        influence = influences(column)
        scores = influence * residuals
        # Every place of the window, those that hang over the picture's edge too: each pixel is in as many.
        sums = lax.reduce_window(
            lax.reduce_window(scores, 0.0, lax.add, (WINDOW, 1), (1, 1), [(WINDOW - 1, WINDOW - 1), (0, 0)]),
            0.0,
            lax.add,
            (1, WINDOW),
            (1, 1),
            [(0, 0), (WINDOW - 1, WINDOW - 1)],
        )
        alone = jnp.sum(influence**2) * jnp.sum(residuals**2) / jnp.maximum(count, 1)
        return jnp.sum(sums**2) / WINDOW**2 / jnp.where(alone > 0, alone, 1)

    def all_of_them() -> Array:
        return jnp.maximum(lax.map(one, inverse.T), 1)

    seen = _agreement(residuals) * jnp.sqrt(2 * count) > _CHANCE
    return lax.cond(seen, all_of_them, lambda: jnp.ones_like(inverse[0]))


def _agreement(residuals: Float[Array, "height width"]) -> Float[Array, ""]:
    """Returns the mean correlation of residuals side by side and one below the other."""
    products = jnp.sum(residuals[1:] * residuals[:-1]) + jnp.sum(residuals[:, 1:] * residuals[:, :-1])
    return 0.5 * products / jnp.maximum(jnp.sum(residuals**2), jnp.finfo(residuals.dtype).tiny)
