"""The smallest positive root of a polynomial, for folds: where a radial lens stops being one-to-one."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from jaxlens.newton import implicit_root
from jaxlens.numerics import polynomial


def smallest_positive_root(coefficients: Float[Array, " terms"]) -> Float[Array, ""]:
    """Returns the smallest s > 0 where `1 + Σ coefficients[i] sⁱ⁺¹` changes sign, ∞ if it never does.

    The roots of a polynomial are separated by those of its derivative, so they are found from the highest derivative
    down, each alone in its bracket: no root is missed, none is complex, and a double root (a touch without a change
    of sign) is not reported. A bracket is halved in the order of the floating-point numbers, which lie as densely at
    1e-9 as at 1e9, down to two neighbours: coefficients of any scale and vanishing leading ones are nothing special.

    Args:
        coefficients: Coefficients of s, s², …; any number of them, zeros and leading zeros included.

    Returns:
        A scalar, differentiable with respect to the coefficients by the implicit function theorem; its derivative
        is zero where there is no root.
    """
    root = _find(lax.stop_gradient(coefficients))
    exists = jnp.isfinite(root)
    finite = implicit_root(_residual, jnp.where(exists, root, 0), coefficients)
    return jnp.where(exists, finite, jnp.inf)


def _residual(s: Array, coefficients: Array) -> Array:
    # Times s, so that its slope is of order one however large the root.
    return s * (1 + s * polynomial(coefficients, s))


def _find(coefficients: Array) -> Array:
    degree = coefficients.shape[0]
    if degree == 0:
        return jnp.asarray(jnp.inf, coefficients.dtype)
    derivatives = [jnp.concatenate([jnp.ones((1,), coefficients.dtype), coefficients])]
    for _ in range(degree - 1):
        last = derivatives[-1]
        derivatives.append(last[1:] * jnp.arange(1, last.shape[0], dtype=last.dtype))
    ends = separators = jnp.asarray([0, jnp.finfo(coefficients.dtype).max], coefficients.dtype)
    roots, exist = ends[:1], jnp.zeros(1, bool)
    for derivative in reversed(derivatives):
        roots, exist = _bracketed_roots(derivative, separators)
        # A bracket without a root lends its upper end: one separator too many does no harm.
        separators = jnp.concatenate([ends[:1], roots, ends[1:]])
    return jnp.min(jnp.where(exist, roots, jnp.inf))


def _bracketed_roots(coefficients: Array, separators: Array) -> tuple[Array, Array]:
    """Returns the place of each change of sign, between neighbouring separators, and whether there is one.

    Where there is none, the upper separator is returned. Horner's rule may overflow, but not to NaN: its sign stays.
    """
    negative = polynomial(coefficients, separators) < 0
    before, changes = negative[:-1], negative[:-1] != negative[1:]
    bits = jnp.finfo(separators.dtype).bits
    ordered = lax.bitcast_convert_type(separators, f"int{bits}")  # keeps the order of positive numbers

    def evaluate(number):
        place = lax.bitcast_convert_type(number, separators.dtype)
        return place, polynomial(coefficients, place)

    def halve(_, bracket):
        low, high = bracket
        middle = low + (high - low) // 2
        same = (evaluate(middle)[1] < 0) == before
        return jnp.where(same, middle, low), jnp.where(same, high, middle)

    low, high = map(evaluate, lax.fori_loop(0, bits - 1, halve, (ordered[:-1], ordered[1:])))
    # The better of the two neighbours: where a root is a number, a polynomial that has it twice then vanishes there.
    roots = jnp.where(jnp.abs(low[1]) < jnp.abs(high[1]), low[0], high[0])
    return jnp.where(changes, roots, separators[1:]), changes
