"""The smallest positive root of a polynomial, for folds: where a radial lens stops being one-to-one."""

from math import comb

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxlens.newton import implicit_root, solve_bracketed
from jaxlens.numerics import polynomial


def smallest_positive_root(coefficients: Float[Array, " terms"]) -> Float[Array, ""]:
    """Returns the smallest s > 0 where `1 + Σ coefficients[i] sⁱ⁺¹` changes sign, ∞ if it never does.

    The roots of a polynomial are separated by those of its derivative, so they are found from the highest derivative
    down, each alone in its bracket: no root is missed, none is complex, and a double root (a touch without a change
    of sign) is not reported. The half-line is first mapped to [0, 1), where a vanishing leading coefficient is
    nothing special: its root is at one, that is s = ∞.

    Args:
        coefficients: Those of s, s², …; any number of them, zeros and leading zeros included.

    Returns:
        A scalar, differentiable with respect to the coefficients by the implicit function theorem; its derivative
        is zero where there is no root.
    """
    root = _find(lax.stop_gradient(coefficients))
    exists = jnp.isfinite(root)
    finite = implicit_root(_value, jnp.where(exists, root, 0), coefficients)
    return jnp.where(exists, finite, jnp.inf)


def _value(s: Array, coefficients: Array) -> Array:
    return 1 + s * polynomial(coefficients, s)


def _find(coefficients: Array) -> Array:
    degree = coefficients.shape[0]
    if degree == 0:
        return jnp.asarray(jnp.inf, coefficients.dtype)
    # In units of this scale every coefficient is at most one, and no root lies below one half (Fujiwara's bound).
    powers = np.arange(1, degree + 1)
    steepest = jnp.max(jnp.abs(coefficients) ** jnp.asarray(1 / powers, coefficients.dtype))
    scale = jnp.where(steepest > 0, 1 / jnp.where(steepest > 0, steepest, 1), 1)
    scaled = jnp.concatenate([jnp.ones((1,), coefficients.dtype), coefficients * scale ** jnp.asarray(powers)])
    # s = scale · t / (1 − t): Σ bᵢ tⁱ (1 − t)ⁿ⁻ⁱ has the same sign.
    in_t = jnp.asarray(_compactification(degree), scaled.dtype) @ scaled
    derivatives = [in_t]
    for _ in range(degree - 1):
        last = derivatives[-1]
        derivatives.append(last[1:] * jnp.arange(1, last.shape[0], dtype=last.dtype))
    separators = jnp.asarray([0, 1], scaled.dtype)
    for derivative in reversed(derivatives):
        roots, exist = _bracketed_roots(derivative, separators)
        # A bracket without a root lends its upper end: one separator too many does no harm.
        separators = jnp.concatenate([separators[:1], roots, separators[-1:]])
    t = jnp.min(jnp.where(exist, roots, 1))
    # The last few bits are won back in s, where nothing was cancelled by the change of variable.
    s = jnp.where(t < 1, scale * t / jnp.where(t < 1, 1 - t, 1), 1)
    for _ in range(2):
        slope = polynomial(jnp.arange(1, degree + 1, dtype=s.dtype) * coefficients, s)
        correction = _value(s, coefficients) / jnp.where(slope == 0, 1, slope)
        s = jnp.where((slope != 0) & (jnp.abs(correction) < 1e-3 * s), s - correction, s)
    return jnp.where(t < 1, s, jnp.inf)


def _bracketed_roots(coefficients: Array, separators: Array) -> tuple[Array, Array]:
    """The root between each pair of neighbouring separators, and whether there is one; else the upper separator."""
    low, high = separators[:-1], separators[1:]
    value_low, value_high = polynomial(coefficients, low), polynomial(coefficients, high)
    changes = (value_low < 0) != (value_high < 0)
    rising = jnp.where(value_high > value_low, 1, -1).astype(low.dtype)
    # `solve_bracketed` measures residuals against |target| and |x|: shift by one so that neither is near zero.
    roots = solve_bracketed(
        lambda t: 1 + rising * polynomial(coefficients, t),
        jnp.ones_like(low),
        0.5 * (low + high),
        low,
        jnp.where(changes, high, low),
    )
    return jnp.where(changes, roots, high), changes


def _compactification(degree: int) -> np.ndarray:
    """The matrix that turns b into the coefficients in t of Σ bᵢ tⁱ (1 − t)ⁿ⁻ⁱ."""
    matrix = np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        for j in range(degree - i + 1):
            matrix[i + j, i] = (-1) ** j * comb(degree - i, j)
    return matrix
