"""Where Newton's iteration starts: near enough for two steps in single precision, and three in double."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.lenses._first_guess import first_guess


@pytest.mark.parametrize("kappa", [[-0.28], [-0.28, 0.1], [0.0, 1.0], [3.0, 2.0], [1.0, -0.5], [-0.2, 0.1, -0.3]])
def test_guesses_are_near(x64, kappa):
    lens = jl.RadialPolynomial(kappa)
    fold, edge = lens.fold_radius(), lens.edge_radius()
    ideal = np.linspace(1e-6, 1, 4001) * min(float(fold), 4)
    observed = np.asarray(lens.radius(jnp.asarray(ideal)))
    ideal, observed = ideal[observed <= 1], observed[observed <= 1]
    guess = jax.jit(lambda r: r * first_guess(lens.radius, fold, edge, r)(r))(jnp.asarray(observed))
    # Two steps of Newton square it twice: to rounding in double precision.
    np.testing.assert_allclose(guess, ideal, rtol=0, atol=1e-3)


def test_one_point_far_away_leaves_the_others_their_guesses(x64):
    lens = jl.RadialPolynomial([0.5])
    ideal = np.append(np.linspace(0.01, 1, 1000), 1e3)
    observed = np.asarray(lens.radius(jnp.asarray(ideal)))
    radii = jnp.asarray(observed)
    guess = radii * first_guess(lens.radius, jnp.asarray(np.inf), jnp.asarray(np.inf), radii)(radii)
    np.testing.assert_allclose(guess[:-1], ideal[:-1], rtol=0, atol=0.05)


@pytest.mark.parametrize("radii", [[], [0.0], [0.0, 0.0]])
def test_nothing_to_guess_from(x64, radii):
    lens = jl.RadialPolynomial([0.5])
    ratio = first_guess(lens.radius, jnp.asarray(np.inf), jnp.asarray(np.inf), jnp.asarray(radii, float))
    assert np.isfinite(ratio(jnp.asarray(radii, float))).all()
