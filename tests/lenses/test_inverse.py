"""The inverse of radial lenses: exact, masked, differentiable; and the peers' beside it."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxlens as jl

FOCAL, WIDTH, HEIGHT = 500.0, 640, 480
# Coefficients, and the least error in pixels that OpenCV's default inverse is known to make.
CASES = [([-0.3], 1.0), ([0.5], 3.0), ([1.0], 50.0), ([-0.45], 10.0), ([1.0, 3.0], 1.0)]


@jax.jit
def _invert(coefficients, points):
    lens = jl.RadialPolynomial(coefficients)
    return lens.invert(points), lens.fold_radius(), lens.edge_radius()


def _pixel_points(fold):
    x, y = np.meshgrid((np.arange(0, WIDTH, 8) - WIDTH / 2) / FOCAL, (np.arange(0, HEIGHT, 8) - HEIGHT / 2) / FOCAL)
    points = np.stack([x.ravel(), y.ravel()], -1)
    return points[np.hypot(*points.T) <= 0.98 * fold]


@pytest.mark.parametrize(("coefficients", "peer_error"), CASES)
def test_round_trip_in_pixels(dtype, coefficients, peer_error):
    lens = jl.RadialPolynomial(coefficients)
    ideal = _pixel_points(float(lens.fold_radius()))
    found = _invert(lens.coefficients, lens.distort(ideal))[0]
    assert bool(jnp.all(found.valid))
    error = FOCAL * np.max(np.hypot(*(np.asarray(found.points, float) - ideal).T))
    assert error <= (1e-9 if dtype == "float64" else 2e-3)
    if dtype == "float64":
        k = [*coefficients, 0.0][:2]
        observed = np.asarray(lens.distort(ideal))[:, None]
        theirs = cv2.undistortPoints(observed, np.eye(3), np.array([*k, 0, 0, 0]))[:, 0]
        assert FOCAL * np.max(np.hypot(*(theirs - ideal).T)) > peer_error


def test_no_preimage(dtype):
    found, fold, edge = _invert(
        jnp.asarray([-0.3]), jnp.asarray([[0.75, 0.0], [0.7, 0.0], [0.0, -0.71], [0.0, 0.7027]])
    )
    assert float(edge) == pytest.approx(0.702728, abs=1e-6)
    assert found.valid.tolist() == [False, True, False, True]
    assert found.status.tolist() == [1, 0, 1, 0]
    # Beyond the edge stands the fold, on the point's own ray.
    np.testing.assert_allclose(found.points[0], [fold, 0], rtol=1e-6)
    np.testing.assert_allclose(found.points[2], [0, -fold], rtol=1e-6)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_every_coefficient_up_to_five(dtype, order):
    """Several hundred lenses, folding ones included, against roots that NumPy finds in double precision."""
    tolerance = {"float32": 3e-5, "float64": 1e-13}[dtype]
    random = np.random.default_rng(order)
    for _ in range(150):
        k = random.uniform(-5, 5, order).astype(dtype)
        radius, angle = random.uniform(0, 1.5, 300), random.uniform(0, 2 * np.pi, 300)
        radius[0] = 0
        observed = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1).astype(dtype)
        found, fold, edge = _invert(k, observed)
        slopes = [*((2 * np.arange(1, order + 1) + 1) * k.astype(float))[::-1], 1.0]
        roots = np.roots(slopes)
        real = roots[(np.abs(roots.imag) < 1e-12 * np.abs(roots)) & (roots.real > 0)].real
        expected = np.sqrt(real.min()) if len(real) else np.inf
        if dtype == "float64":
            assert float(fold) == pytest.approx(expected, rel=1e-7)
        points, valid = np.asarray(found.points, float), np.asarray(found.valid)
        assert np.isfinite(points).all()
        np.testing.assert_array_equal(valid, np.hypot(*observed.astype(float).T) <= float(edge))
        assert not np.any(np.asarray(found.status) == jl.InverseStatus.NOT_CONVERGED)
        squared = np.sum(points**2, -1)
        factor = 1 + sum(float(c) * squared ** (i + 1) for i, c in enumerate(k))
        assert np.max(np.abs(points * factor[:, None] - observed)[valid], initial=0) <= tolerance
        assert np.all(np.sqrt(squared) <= float(fold) * (1 + 1e-6))


LENSES = [
    jl.RadialPolynomial(np.float32([0.0, 1.0])),
    jl.RadialPolynomial(np.float32([-0.4, 0.1, 0.2]), center=np.float32([0.1, -0.05])),
    jl.Division(np.float32(0.3)),
    jl.Division(np.float32(-0.4)),
]


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(LENSES)))
def test_derivatives(x64, index):
    lens = jax.tree.map(lambda leaf: leaf.astype(float), LENSES[index])
    points = jnp.asarray([[0.3, 0.2], [-0.5, 0.4], [1e-3, 0.0]])
    check_grads(lambda lens, points: lens.invert(points).points, (lens, points), 2, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(LENSES)))
def test_derivatives_are_finite_everywhere(x64, index):
    lens = jax.tree.map(lambda leaf: leaf.astype(float), LENSES[index])
    points = jnp.asarray([[0.0, 0.0], [0.3, 0.2], [5.0, 5.0], [jnp.nan, 1.0], [jnp.inf, 0.0]])

    def total(lens, points):
        found = lens.invert(points)
        return jnp.sum(found.points * jnp.where(found.valid, 1.0, 0.0)[:, None]) + jnp.nansum(lens.undistort(points))

    for derivative in (jax.grad(total, (0, 1)), jax.jacfwd(total, (0, 1)), jax.hessian(total, (0, 1))):
        for leaf in jax.tree.leaves(derivative(lens, points)):
            assert bool(jnp.all(jnp.isfinite(leaf)))


@pytest.mark.parametrize("index", range(len(LENSES)))
def test_the_plane_s_newton_agrees(x64, index):
    lens = jax.tree.map(lambda leaf: leaf.astype(float), LENSES[index])
    observed = lens.distort(jax.random.uniform(jax.random.key(0), (200, 2), minval=-0.45, maxval=0.45))
    radial, plane = lens.invert(observed), jl.CoordinateMap.invert(lens, observed)
    assert bool(jnp.all(plane.valid))
    np.testing.assert_allclose(plane.points, radial.points, atol=1e-13)


def test_batches(dtype):
    coefficients = jnp.asarray([[0.3, 0.1], [-0.5, 0.0], [1.0, 3.0]])
    lenses = jax.vmap(jl.RadialPolynomial)(coefficients)
    points = jax.random.uniform(jax.random.key(1), (3, 50, 2), minval=-1, maxval=1)
    together = jax.vmap(lambda lens, points: lens.undistort(points))(lenses, points)
    for i in range(3):
        alone = jl.RadialPolynomial(coefficients[i]).undistort(points[i])
        np.testing.assert_allclose(together[i], alone, rtol=1e-6 if dtype == "float32" else 1e-14)
    assert jl.RadialPolynomial([0.1]).undistort(jnp.zeros(2)).shape == (2,)
    assert jl.RadialPolynomial([0.1]).undistort(jnp.zeros((0, 2))).shape == (0, 2)
    assert jl.RadialPolynomial([0.1]).undistort(jnp.zeros((4, 5, 2))).shape == (4, 5, 2)


def test_a_large_batch_is_solved_picture_by_picture(dtype):
    lenses = jax.vmap(jl.RadialPolynomial)(jnp.asarray([[0.3], [-1.0]]))
    points = jnp.linspace(-1, 1, 2 * 40_000).reshape(-1, 2)
    together = jax.vmap(lambda lens: lens.invert(points))(lenses)
    for i, k in enumerate((0.3, -1.0)):
        alone = jl.RadialPolynomial([k]).invert(points)
        np.testing.assert_array_equal(together.valid[i], alone.valid)
        np.testing.assert_allclose(together.points[i], alone.points, rtol=2e-6 if dtype == "float32" else 1e-14)


def test_dtype_follows_the_lens_and_the_points(x64):
    single = jl.RadialPolynomial(np.float32([0.1, 0.2]))
    assert single.undistort(np.ones((3, 2), np.float32)).dtype == np.float32
    assert single.undistort(np.ones((3, 2))).dtype == np.float64
    assert jl.RadialPolynomial([0.1]).undistort(np.ones((3, 2), np.float32)).dtype == np.float64
