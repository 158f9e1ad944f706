"""Where Newton's iteration starts: an interpolation of the inverse along one ray, made once a lens."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

Radii = Float[Array, "*batch"]

# Chebyshev's nodes of the first kind, and what takes values there to the coefficients of the polynomial through them.
_NODES = np.cos(np.pi * (np.arange(8) + 0.5) / 8)
_TO_COEFFICIENTS = np.linalg.inv(np.vander(_NODES))
# Bisections, of a bracket that is this much wider than the radius itself to both sides.
_BISECTIONS, _WIDTH = 24, 1024
# Radii farther than this many means from the centre are taken for outliers: others have the better guesses.
_FARTHEST = 6


def first_guess(
    radius: Callable[[Radii], Radii], fold: Float[Array, ""], edge: Float[Array, ""], targets: Radii
) -> Callable[[Radii], Radii]:
    """Returns a function of observed radii r: the ratio ρ / r to the ideal radius, to some 1e-4 or better.

    Towards a fold r ≈ edge − C (fold − ρ)²: ρ has a root's singularity there, and is smooth in √(1 − r / edge). The
    ratio is interpolated in that, or where nothing folds in the like for an edge at twice the farthest radius.

    Args:
        radius: Takes ideal radii to observed ones; rises from 0 to the fold.
        fold: The ideal radius where it ends, ∞ if it does not.
        edge: The observed radius there.
        targets: Observed radii, finite, for which guesses are wanted.
    """
    # The harmonic mean of 1 + r, which no outlier moves far.
    mean = 1 / jnp.mean(1 / (1 + targets)) - 1
    reach = jnp.minimum(jnp.max(targets, initial=0), _FARTHEST * mean)
    reach = jnp.where(reach > 0, jnp.minimum(reach, edge), jnp.minimum(1, edge))
    end = jnp.where(jnp.isfinite(edge), edge, 2 * reach)

    def place(radii: Radii) -> Radii:
        return jnp.sqrt(jnp.maximum(1 - radii / end, 0))

    middle, half = (1 + place(reach)) / 2, (1 - place(reach)) / 2
    nodes = middle + half * jnp.asarray(_NODES, reach.dtype)
    observed = end * (1 - nodes * nodes)

    def bisect(_, bracket):
        low, high = bracket
        ideal = jnp.sqrt(low * high)
        nearer = radius(ideal) < observed  # false, too, where the lens is no longer finite
        return jnp.where(nearer, ideal, low), jnp.where(nearer, high, ideal)

    low, high = lax.fori_loop(0, _BISECTIONS, bisect, (observed / _WIDTH, jnp.minimum(fold, observed * _WIDTH)))
    ratios = jnp.sqrt(low * high) / observed
    highest, *lower = jnp.sum(jnp.asarray(_TO_COEFFICIENTS, reach.dtype) * ratios[None], axis=1)

    def ratio(radii: Radii) -> Radii:
        position = jnp.clip((place(radii) - middle) / half, -1, 1)
        total = highest
        for coefficient in lower:
            total = total * position + coefficient
        return total

    return ratio
