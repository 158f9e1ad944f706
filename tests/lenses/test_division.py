"""The division model: Eq. 5 by hand, both directions, and where it ends."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl

COEFFICIENTS = [0.4, 0.05, 1e-12, 0.0, -1e-12, -0.05, -0.4]


@pytest.mark.parametrize("k", COEFFICIENTS)
def test_undistort_is_equation_5(dtype, k):
    observed = np.array([[0.3, -0.2], [0.0, 0.0], [-0.7, 0.6]])
    expected = observed / (1 - k * (observed**2).sum(-1, keepdims=True))
    ideal = jl.Division(np.asarray(k, dtype)).undistort(observed.astype(dtype))
    np.testing.assert_allclose(ideal, expected, rtol=8 * jnp.finfo(dtype).eps)


@pytest.mark.parametrize("k", COEFFICIENTS)
def test_distort_undoes_it(dtype, k):
    lens = jl.Division(np.asarray(k, dtype), center=np.asarray([0.05, -0.1], dtype))
    ideal = np.random.default_rng(0).uniform(-0.4, 0.4, (200, 2)).astype(dtype)
    np.testing.assert_allclose(lens.undistort(lens.distort(ideal)), ideal, atol=8 * jnp.finfo(dtype).eps)


def test_a_small_coefficient_is_the_polynomial_s(x64):
    points = np.random.default_rng(1).uniform(-1, 1, (50, 2))
    k = 1e-7
    np.testing.assert_allclose(
        jl.Division(k).distort(points), jl.RadialPolynomial([-k, 2 * k * k]).distort(points), rtol=0, atol=1e-15
    )


def test_pincushion_ends_at_its_fold(x64):
    lens = jl.Division(-0.25)
    assert lens.fold_radius() == 1.0
    assert lens.edge_radius() == 2.0
    inverse = lens.invert(jnp.array([[1.99, 0.0], [2.0, 0.0], [2.5, 0.0], [jnp.nan, 0.0]]))
    assert inverse.valid.tolist() == [True, True, False, False]
    np.testing.assert_allclose(inverse.points[2], [1.0, 0.0])
    status = jl.InverseStatus
    assert inverse.status.tolist() == [status.CONVERGED, status.CONVERGED, status.NO_PREIMAGE, status.NOT_FINITE]


def test_barrel_sees_the_whole_plane_within_its_edge(x64):
    lens = jl.Division(0.25)
    assert lens.fold_radius() == jnp.inf
    assert np.linalg.norm(lens.distort(jnp.array([1e9, 0.0]))) == pytest.approx(2.0)
    inverse = lens.invert(jnp.array([[1.999, 0.0], [2.0, 0.0]]))
    assert inverse.valid.tolist() == [True, False]
    assert np.isfinite(inverse.points).all()


def test_batches(x64):
    points = np.random.default_rng(2).uniform(-0.5, 0.5, (5, 2))
    ks = jnp.array([-0.3, 0.0, 0.3])
    batch = jax.vmap(lambda k: jl.Division(k).undistort(points))(ks)
    for k, each in zip(ks, batch, strict=True):
        np.testing.assert_allclose(each, jl.Division(k).undistort(points), rtol=1e-15)


def test_a_number_or_a_list_is_a_lens():
    with pytest.raises(ValueError, match="k must be a number, or a list of one or more, got shape"):
        jl.Division(np.array([[0.1, 0.2]]))
