from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlens.polynomials import smallest_positive_root

EPSILON = {"float32": 2.0**-23, "float64": 2.0**-52}
find = jax.jit(smallest_positive_root)
find_many = jax.jit(jax.vmap(smallest_positive_root))
gradient = jax.jit(jax.grad(smallest_positive_root))


def exactly(coefficients, s):
    """1 + Σ cᵢ sⁱ⁺¹ and the sum of its terms' magnitudes, in rational arithmetic."""
    s = Fraction(float(s))
    terms = [Fraction(float(c)) * s ** (i + 1) for i, c in enumerate(coefficients)]
    return 1 + sum(terms), 1 + sum(map(abs, terms))


def relative(coefficients, s):
    """The polynomial in units of its terms: what no evaluation in floating point could tell from zero is an ulp."""
    value, magnitude = exactly(coefficients, s)
    return float(value / magnitude)


# Coefficients of s, s², …, and the first change of sign of 1 + c₁ s + c₂ s² + …
KNOWN = [
    ([], np.inf),
    ([0.0], np.inf),
    ([0.0, 0.0, 0.0, 0.0], np.inf),
    ([1.0, 2.0, 3.0], np.inf),
    ([1.0, 2.0, 0.0, 0.0], np.inf),
    ([-1.0], 1.0),
    ([-1.0, 0.0, 0.0, 0.0], 1.0),
    ([0.0, 0.0, -8.0], 0.5),
    ([0.0, 0.0, 0.0, -16.0], 0.5),
    ([1.0, -1.0], (1 + 5**0.5) / 2),
    ([-3.0, 2.0], 0.5),  # (1 − s)(1 − 2 s)
    ([-1e6], 1e-6),
    ([-1e-12], 1e12),
    ([-1e-30], 1e30),
    ([1e6, -1e-12], 1e18),  # far beyond the scale of the other coefficient
    ([0.0, 1e6, 0.0, -1e-6], 1e6),
    # Touches without a change of sign are no fold; these are exact, where others are a matter of rounding.
    ([-2.0, 1.0], np.inf),
    ([-4.0, 4.0], np.inf),
    ([0.0, -2.0, 0.0, 1.0], np.inf),  # (1 − s²)²
    ([-3.0, 3.0, 0.0], np.inf),
]


@pytest.mark.parametrize(("coefficients", "root"), KNOWN)
def test_known_roots(dtype, coefficients, root):
    found = find(jnp.asarray(coefficients, dtype))
    assert found.dtype == dtype
    assert float(found) == pytest.approx(root, rel=4 * EPSILON[dtype], abs=0)


def test_a_triple_root_is_found_as_well_as_rounding_allows(dtype):
    found = find(jnp.asarray([-3.0, 3.0, -1.0], dtype))  # (1 − s)³
    assert float(found) == pytest.approx(1, abs=(8 * EPSILON[dtype]) ** (1 / 3))


def uniform(random, order):
    return random.uniform(-5, 5, order)


def integers(random, order):
    """Many zeros, many multiple roots."""
    return random.integers(-3, 4, order).astype(float)


def any_scale(random, order):
    return random.choice([-1, 1], order) * 10 ** random.uniform(-12, 6, order)


def nearly_double(random, order):
    """(1 − s/a)² + δ times whatever else: two roots, or none, nearly at the same place."""
    place, offset = 10 ** random.uniform(-3, 3), random.choice([-1, 1]) * 10 ** random.uniform(-12, -1)
    total = np.poly1d([1 / place**2, -2 / place, 1 + offset]) / (1 + offset)
    while total.order < order:
        total *= np.poly1d([random.choice([-1, 1]) / (place * 10 ** random.uniform(-0.5, 2)), 1])
    return total.c[::-1][1:]


@pytest.mark.parametrize("family", [uniform, integers, any_scale, nearly_double])
@pytest.mark.parametrize("order", [2, 3, 4, 6])
def test_every_first_root_is_found(dtype, family, order):
    """The root is one of the polynomial to its rounding, and the polynomial is positive up to there."""
    random = np.random.default_rng([order, len(family.__name__)])
    batch = np.stack([family(random, order) for _ in range(100)]).astype(dtype)
    few = 4 * EPSILON[dtype]
    for coefficients, root in zip(batch, np.asarray(find_many(batch)), strict=True):
        if np.isfinite(root):
            assert abs(relative(coefficients, root)) <= few
        # NumPy's roots know nothing of the order of ours; between them the sign is constant.
        nonzero = np.trim_zeros(coefficients[::-1].astype(float), "f")
        complex_roots = np.roots([*nonzero, 1.0])
        places = np.sort(np.abs(complex_roots[complex_roots.real > 0]))
        places = np.concatenate([places, np.sqrt(places[1:] * places[:-1]), 0.999 * places, 1.001 * places])
        if np.isinf(root):
            places = np.append(places, [1.0, 1e30])
        assert all(relative(coefficients, place) >= -few for place in places if place < root * (1 - few))


def test_roots_of_numpy(x64):
    """Where roots are simple, they are NumPy's."""
    random = np.random.default_rng(0)
    for order in (1, 2, 3, 4):
        batch = random.uniform(-5, 5, (200, order))
        for coefficients, root in zip(batch, np.asarray(find_many(batch)), strict=True):
            roots = np.roots([*coefficients[::-1], 1.0])
            real = np.sort(roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].real)
            assert root == pytest.approx(real[0] if len(real) else np.inf, rel=1e-10)


def test_gradient_in_closed_form(dtype):
    tolerance = 8 * EPSILON[dtype]
    for k in (-3.0, -1e-6, -1e6, -1e-15):  # s = −1/k
        np.testing.assert_allclose(gradient(jnp.asarray([k], dtype)), [1 / np.asarray(k, dtype) ** 2], rtol=tolerance)
    # c₁ s + c₂ s² = −1: ds = −(s dc₁ + s² dc₂) / (c₁ + 2 c₂ s), at c = (1, −1).
    s = (1 + 5**0.5) / 2
    np.testing.assert_allclose(
        gradient(jnp.asarray([1.0, -1.0], dtype)), [s / (2 * s - 1), s**2 / (2 * s - 1)], rtol=tolerance
    )


def test_higher_derivatives(x64):
    """Of −1/k at k = −2: n! / 2ⁿ⁺¹, forward and reverse."""
    third = jax.jit(jax.jacfwd(jax.jacrev(jax.jacfwd(smallest_positive_root))))
    second = jax.jit(jax.jacrev(jax.jacfwd(smallest_positive_root)))
    np.testing.assert_allclose(second(jnp.asarray([-2.0])), [[2 / 8]], rtol=1e-14)
    np.testing.assert_allclose(third(jnp.asarray([-2.0])), [[[6 / 16]]], rtol=1e-14)


def test_gradient_without_a_root_is_zero(dtype):
    for coefficients in ([1.0, 2.0], [0.0, 0.0], [-2.0, 1.0], [-1.0, 5.0]):
        np.testing.assert_array_equal(gradient(jnp.asarray(coefficients, dtype)), 0)


def test_jit_and_vmap_change_nothing(x64):
    batch = np.random.default_rng(1).uniform(-5, 5, (5, 3))
    together = find_many(batch)
    for coefficients, root in zip(batch, together, strict=True):
        np.testing.assert_array_equal(find(coefficients), root)
    np.testing.assert_array_equal(smallest_positive_root(jnp.asarray(batch[0])), together[0])
