"""The Brown–Conrady lens: a point by hand, OpenCV in both directions, derivatives, and where it folds."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

import jaxlens as jl

# A mild lens of each length that OpenCV's order has; all are one-to-one on POINTS.
COEFFICIENTS = {
    4: [-0.28, 0.09, 1.5e-3, -8e-4],
    5: [-0.31, 0.12, -2e-3, 1e-3, -0.02],
    8: [0.6, -0.2, 1e-3, 2e-3, 0.05, 0.85, 0.02, 0.08],
}
POINTS = np.random.default_rng(0).uniform(-0.55, 0.55, (400, 2))
counts = pytest.mark.parametrize("count", COEFFICIENTS)


def _opencv_distort(points, coefficients):
    rays = np.column_stack([points, np.ones(len(points))])
    return cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), np.array(coefficients))[0][:, 0]


def _opencv_undistort(points, coefficients):
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 500, 1e-16)
    arguments = (points[:, None], np.eye(3), np.array(coefficients))
    if hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
        return cv2.undistortPointsIter(*arguments, None, None, criteria)[:, 0]
    return cv2.undistortPoints(*arguments, criteria=criteria)[:, 0]


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [
        # r² = 1/4 at (0.3, 0.4), so that R = 1 + 0.4/4 − 0.8/16; and 2xy = 0.24, r² + 2x² = 0.43, r² + 2y² = 0.57.
        ([0.4, -0.8, 0.01, 0.02], [0.3 * 1.05 + 0.0024 + 0.0086, 0.4 * 1.05 + 0.0057 + 0.0048]),
        ([0.4, -0.8, 0.01, 0.02, 1.6], [0.3335, 0.4405]),
        ([0.4, -0.8, 0.01, 0.02, 1.6, 0.4, -0.8, 1.6], [0.311, 0.4105]),  # R = 1.075 / 1.075
        ([0.0, 0.0, 0.1, 0.0], [0.324, 0.457]),
        ([0.0, 0.0, 0.0, 0.1], [0.343, 0.424]),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0], [0.15, 0.2]),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 16.0, 0.0], [0.15, 0.2]),
        ([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 64.0], [0.15, 0.2]),
    ],
)
def test_a_point_by_hand(dtype, coefficients, expected):
    observed = jl.BrownConrady(np.asarray(coefficients, dtype)).distort(np.asarray([0.3, 0.4], dtype))
    assert observed.dtype == dtype
    np.testing.assert_allclose(observed, expected, rtol=8 * jnp.finfo(dtype).eps)


@counts
def test_zero_coefficients_are_the_identity(dtype, count):
    lens = jl.BrownConrady(np.zeros(count, dtype))
    points = POINTS.astype(dtype)
    np.testing.assert_array_equal(lens.distort(points), points)
    inverse = lens.invert(points)
    np.testing.assert_array_equal(inverse.points, points)
    assert bool(jnp.all(inverse.valid))


@counts
def test_distort_is_opencv_s(x64, count):
    k = COEFFICIENTS[count]
    np.testing.assert_allclose(jl.BrownConrady(k).distort(POINTS), _opencv_distort(POINTS, k), rtol=0, atol=1e-15)


@counts
def test_undistort_undoes_it(dtype, count):
    lens = jl.BrownConrady(np.asarray(COEFFICIENTS[count], dtype))
    inverse = lens.invert(lens.distort(POINTS.astype(dtype)))
    assert bool(jnp.all(inverse.valid))
    error = np.abs(np.asarray(inverse.points, float) - POINTS.astype(dtype)).max()
    assert error <= (1e-14 if dtype == "float64" else 2e-6)


@counts
def test_undistort_is_what_opencv_s_iteration_tends_to(x64, count):
    k = COEFFICIENTS[count]
    observed = _opencv_distort(POINTS, k)
    np.testing.assert_allclose(
        jl.BrownConrady(k).undistort(observed), _opencv_undistort(observed, k), rtol=0, atol=1e-12
    )


@counts
def test_jacobian(x64, count):
    lens = jl.BrownConrady(COEFFICIENTS[count])
    jacobian = np.asarray(lens.jacobian(POINTS))
    h = 1e-5
    for column in range(2):
        step = h * np.eye(2)[column]
        differences = (
            _opencv_distort(POINTS + step, COEFFICIENTS[count]) - _opencv_distort(POINTS - step, lens.coefficients)
        ) / (2 * h)
        np.testing.assert_allclose(jacobian[..., column], differences, rtol=0, atol=1e-9)
    inverse = lens.inverse().jacobian(lens.distort(POINTS))
    np.testing.assert_allclose(inverse @ jacobian, np.broadcast_to(np.eye(2), jacobian.shape), rtol=0, atol=1e-12)


@counts
def test_derivatives_of_both_directions(x64, count):
    lens = jl.BrownConrady(COEFFICIENTS[count])
    points = jnp.asarray([[0.3, 0.2], [-0.5, 0.4], [0.0, 0.0]])
    check_grads(lambda lens, points: lens.distort(points), (lens, points), 2, rtol=1e-5, atol=1e-5)
    check_grads(lambda lens, points: lens.invert(points).points, (lens, points), 2, rtol=1e-5, atol=1e-5)


def test_beyond_the_fold_nothing_is_valid(dtype):
    """k1 = −0.3 alone folds at ρ = √(1/0.9), which is seen at two thirds of that."""
    lens = jl.BrownConrady(np.asarray([-0.3, 0, 0, 0], dtype))
    fold = np.sqrt(1 / 0.9)
    radii = np.asarray([0.5, 0.999, 1.001, 2.0])
    ideal = np.stack([0.6 * fold * radii, 0.8 * fold * radii], -1).astype(dtype)
    assert lens.one_to_one(ideal).tolist() == [True, True, False, False]
    observed = ideal * np.asarray(2 / 3, dtype)
    inverse = lens.invert(observed)
    assert inverse.valid.tolist() == [True, True, False, False]
    assert inverse.status.tolist() == [jl.InverseStatus.CONVERGED] * 2 + [jl.InverseStatus.NO_PREIMAGE] * 2
    assert bool(jnp.all(jnp.isfinite(inverse.points)))
    assert np.isnan(lens.undistort(observed)).all(axis=-1).tolist() == [False, False, True, True]
    assert (
        lens.invert(np.asarray([[np.nan, 0], [np.inf, 0]], dtype)).status.tolist() == [jl.InverseStatus.NOT_FINITE] * 2
    )


@pytest.mark.parametrize("terms", [(-0.4, 0.0, 0.0), (-0.3, 0.1, 0.05), (0.3, -0.2, 0.0), (-0.5, 0.3, -0.1)])
def test_without_tangential_terms_it_is_the_radial_polynomial(x64, terms):
    """The plane's Newton iteration against the exact inverse along the ray, fold and all."""
    brown, radial = jl.BrownConrady([*terms[:2], 0.0, 0.0, terms[2]]), jl.RadialPolynomial(np.array(terms))
    points = np.random.default_rng(1).uniform(-1.2, 1.2, (2000, 2))
    np.testing.assert_allclose(brown.distort(points), radial.distort(points), rtol=1e-13, atol=1e-15)
    away = np.abs(np.hypot(*points.T) / float(radial.edge_radius()) - 1) > 1e-6
    points = points[away]
    assert 0.2 < np.mean(radial.invert(points).valid) < 1
    ours, theirs = brown.invert(points), radial.invert(points)
    np.testing.assert_array_equal(ours.valid, theirs.valid)
    valid = np.asarray(theirs.valid)
    # Rounding in what is seen moves the preimage by more, the nearer it is to the fold.
    slopes = np.asarray(radial.jacobian_determinant(theirs.points))[valid]
    errors = np.abs(np.asarray(ours.points) - np.asarray(theirs.points))[valid]
    assert np.max(errors * slopes[:, None]) <= 1e-14


def test_whatever_the_lens_a_valid_inverse_is_one(x64):
    """Hundreds of wild lenses: what is called valid maps back, and lies before the fold."""
    random = np.random.default_rng(2)
    invert = jax.jit(lambda lens, points: (lens.invert(points), lens))
    shares = []
    for count in COEFFICIENTS:
        for _ in range(60):
            k = random.uniform(-1, 1, count)
            k[2:4] *= 0.1
            lens = jl.BrownConrady(k)
            observed = random.uniform(-1, 1, (300, 2))
            inverse = invert(lens, observed)[0]
            points, valid = np.asarray(inverse.points), np.asarray(inverse.valid)
            assert np.isfinite(points).all()
            back = np.asarray(lens.distort(points))
            assert np.max(np.abs(back - observed)[valid], initial=0) <= 1e-12
            assert np.all(np.asarray(lens.jacobian_determinant(points))[valid] > 0)
            shares.append(valid.mean())
    assert np.mean(shares) > 0.4


@counts
def test_batches(dtype, count):
    random = np.random.default_rng(3)
    coefficients = np.asarray(COEFFICIENTS[count]) * random.uniform(0, 1, (4, 1))
    lenses = jax.vmap(jl.BrownConrady)(jnp.asarray(coefficients, dtype))
    points = jnp.asarray(POINTS[:40], dtype).reshape(2, 20, 2)
    together = jax.vmap(lambda lens: (lens.distort(points), lens.undistort(points)))(lenses)
    for i in range(4):
        lens = jl.BrownConrady(coefficients[i].astype(dtype))
        for batch, alone in zip(together, (lens.distort(points), lens.undistort(points)), strict=True):
            assert batch[i].shape == (2, 20, 2)
            np.testing.assert_allclose(batch[i], alone, rtol=8 * jnp.finfo(dtype).eps, atol=jnp.finfo(dtype).eps)
    assert jl.BrownConrady([0.1, 0, 0, 0]).distort(jnp.zeros(2)).shape == (2,)
    assert jl.BrownConrady([0.1, 0, 0, 0]).undistort(jnp.zeros((0, 2))).shape == (0, 2)


@pytest.mark.parametrize("shape", [(), (0,), (3,), (6,), (7,), (9,), (12,), (14,), (2, 4)])
def test_a_wrong_number_of_coefficients(shape):
    with pytest.raises(ValueError, match="that is 4, 5 or 8 numbers, got shape"):
        jl.BrownConrady(np.zeros(shape))
