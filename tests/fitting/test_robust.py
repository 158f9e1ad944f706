"""Robust losses: the formulas, SciPy's own, their derivatives, and the scale of normal noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from jaxlens.fitting._robust import influence, noise_scale, robustify

LOSSES = ["linear", "huber", "cauchy"]
# From far below the loss scale, where a series replaces the formula, to far above.
SIZES = np.geomspace(1e-6, 1e4, 61)


def _residuals(components, scale):
    direction = np.random.default_rng(components).normal(size=(len(SIZES), components))
    return scale * SIZES[:, None] * direction / np.linalg.norm(direction, axis=1, keepdims=True)


def _rho(loss, z):
    if loss == "linear":
        return z
    if loss == "huber":
        return np.where(z <= 1, z, 2 * np.sqrt(z) - 1)
    return np.log1p(z)


@pytest.mark.parametrize("components", [1, 2])
@pytest.mark.parametrize("loss", LOSSES)
def test_squares_sum_to_the_loss(dtype, loss, components):
    scale = 0.7
    residuals = _residuals(components, scale).astype(dtype)
    rows = np.asarray(robustify(jnp.asarray(residuals), loss, jnp.asarray(scale, dtype)), float)
    assert rows.shape == residuals.shape
    z = np.sum(residuals.astype(float) ** 2, axis=1) / scale**2
    tolerance = 50 * float(jnp.finfo(dtype).eps)
    np.testing.assert_allclose(np.sum(rows**2, axis=1), scale**2 * _rho(loss, z), rtol=max(tolerance, 1e-12))
    # Each residual keeps its direction.
    lengths = np.linalg.norm(rows, axis=1) / np.linalg.norm(residuals.astype(float), axis=1)
    np.testing.assert_allclose(rows, residuals * lengths[:, None], rtol=10 * tolerance)


@pytest.mark.parametrize("loss", ["huber", "cauchy"])
def test_the_loss_is_scipy_s(x64, loss):
    scale = 0.7
    residuals = _residuals(1, scale)
    rows = robustify(jnp.asarray(residuals), loss, jnp.asarray(scale))
    weighted = influence(jnp.asarray(residuals), loss, jnp.asarray(scale))
    for (residual,), (row,), (psi,) in zip(residuals, np.asarray(rows), np.asarray(weighted), strict=True):
        # A residual that is its own parameter: after one evaluation, its cost and the gradient of that.
        theirs = least_squares(
            lambda x: x, [residual], jac=lambda x: np.ones((1, 1)), loss=loss, f_scale=scale, max_nfev=1
        )
        assert 0.5 * row**2 == pytest.approx(theirs.cost, rel=1e-9)
        assert psi == pytest.approx(theirs.grad[0], rel=1e-12)


@pytest.mark.parametrize("components", [1, 2])
@pytest.mark.parametrize("loss", LOSSES)
def test_influence_is_the_derivative_of_half_the_loss(x64, loss, components):
    scale = jnp.asarray(0.7)
    residuals = jnp.asarray(_residuals(components, 0.7))
    derivative = jax.grad(lambda residuals: 0.5 * jnp.sum(robustify(residuals, loss, scale) ** 2))(residuals)
    np.testing.assert_allclose(derivative, influence(residuals, loss, scale), rtol=1e-6, atol=1e-15)
    # Bounded for Huber's loss; it comes back to zero for Cauchy's.
    size = np.linalg.norm(influence(residuals, loss, scale), axis=1)
    if loss == "huber":
        np.testing.assert_allclose(size, 0.7 * np.minimum(SIZES, 1), rtol=1e-12)
    if loss == "cauchy":
        assert size.max() <= 0.7 / 2
        assert size[-1] < 1e-3


@pytest.mark.parametrize("loss", LOSSES)
def test_at_zero_all_is_finite(x64, loss):
    """Residuals of points that do not count are zero: a NaN there would spoil every sum."""
    scale, zero = jnp.asarray(0.7), jnp.zeros((1, 2))

    def half(residuals):
        return 0.5 * jnp.sum(robustify(residuals, loss, scale) ** 2)

    assert np.all(robustify(zero, loss, scale) == 0)
    assert np.all(influence(zero, loss, scale) == 0)
    np.testing.assert_array_equal(jax.grad(half)(zero), zero)
    np.testing.assert_allclose(jax.jit(jax.hessian(half))(zero).reshape(2, 2), np.eye(2), rtol=1e-6)
    rows = jax.jacfwd(lambda residuals: robustify(residuals, loss, scale))(zero).reshape(2, 2)
    np.testing.assert_allclose(rows, np.eye(2), rtol=1e-6)
    slope = jax.jacrev(lambda residuals: influence(residuals, loss, scale))(zero).reshape(2, 2)
    np.testing.assert_allclose(slope, np.eye(2), rtol=1e-6)


@pytest.mark.parametrize(("loss", "bend"), [("huber", 1.345), ("cauchy", 2.3849)])
@pytest.mark.parametrize("components", [1, 2])
def test_the_noise_scale_is_consistent(x64, loss, bend, components):
    count, sigma = 200_000, 0.3
    residuals = sigma * np.random.default_rng(9).normal(size=(4, count // 4, components))
    ones = np.ones((4, count // 4))
    found = noise_scale(jnp.asarray(residuals), jnp.asarray(ones), loss)
    # The standard error of this median is about 1.2 (one component) or 0.7 (two) of σ / √n.
    assert float(found) == pytest.approx(bend * sigma, rel=4 * 1.2 / np.sqrt(count))
    # A third of nonsense moves a median, but what has no weight does not even do that.
    residuals[0], ones[0] = 1e6, 0
    without = noise_scale(jnp.asarray(residuals), jnp.asarray(ones), loss)
    alone = noise_scale(jnp.asarray(residuals[1:]), jnp.asarray(ones[1:]), loss)
    assert float(without) == float(alone)
    assert float(without) == pytest.approx(bend * sigma, rel=4 * 1.2 / np.sqrt(0.75 * count))
    # Exact data have no scale, and nothing at all has none: still positive, and finite.
    for weights in (ones, 0 * ones):
        nothing = float(noise_scale(jnp.zeros(residuals.shape), jnp.asarray(weights), loss))
        assert 0 < nothing < np.inf
