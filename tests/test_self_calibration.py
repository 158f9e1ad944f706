"""A rotating camera: exact without a lens, too short with pincushion, too long with barrel, exact again undistorted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxlens as jl
from jaxlens.self_calibration import (
    RotatingCamera,
    calibrate_by_rotation,
    focal_length_bias,
    pan_and_tilt,
    self_calibrate_focal_length,
)

KAPPAS = np.array([-0.2, -0.1, -0.05, -0.03, -0.01, 0.01, 0.03, 0.05, 0.1, 0.2])


def _homographies(vectors, focal, center):
    matrix = np.array([[focal, 0, center[0]], [0, focal, center[1]], [0, 0, 1]])
    return np.stack([matrix @ Rotation.from_rotvec(v).as_matrix() @ np.linalg.inv(matrix) for v in vectors])


def test_exact_homographies(dtype):
    """Of any scale and sign, in pixels, with a roll beside the pan and tilt."""
    vectors = np.random.default_rng(0).normal(0, 0.2, (5, 3))
    matrices = _homographies(vectors, 812.0, (320.0, 240.0)) * np.array([1, -2, 1e-3, 50, -1e3])[:, None, None]
    found = self_calibrate_focal_length(matrices.astype(dtype), center=(320.0, 240.0), unit=400.0)
    assert found.focal_length.dtype == dtype
    assert bool(found.valid)
    np.testing.assert_allclose(found.focal_length, 812, rtol=1e-13 if dtype == "float64" else 1e-4)


def test_rotations_that_say_nothing(x64):
    rolls = _homographies([[0, 0, 0.3], [0, 0, -0.5], [0, 0, 0]], 2.0, (0, 0))
    found = self_calibrate_focal_length(rolls)
    assert not bool(found.valid)
    gradient = jax.grad(lambda h: self_calibrate_focal_length(h).inverse_square)(jnp.asarray(rolls))
    assert np.isfinite(gradient).all()


def test_the_derivative(x64):
    matrices = jnp.asarray(_homographies([[0, 0.2, 0], [0.1, 0, 0.05]], 1.7, (0, 0)))
    direction = jnp.asarray(np.random.default_rng(1).normal(size=matrices.shape))

    def value(h):
        return self_calibrate_focal_length(h).focal_length

    expected = jnp.sum(jax.grad(value)(matrices) * direction)
    numeric = (value(matrices + 1e-6 * direction) - value(matrices - 1e-6 * direction)) / 2e-6
    np.testing.assert_allclose(numeric, expected, rtol=1e-7)


@pytest.fixture(scope="module")
def study():
    """Bias by κ, for three focal lengths (half the diagonal spans 45°, 34° and 22°); then with the lens removed."""

    def bias(kappa, focal, undistorted):
        camera = RotatingCamera(jl.RadialPolynomial(kappa[None]), focal)
        return focal_length_bias(camera, undistorted=undistorted), calibrate_by_rotation(camera).inverse_square

    both = jax.vmap(bias, in_axes=(0, None, None))
    with jax.enable_x64(True):
        kappas = jnp.asarray(KAPPAS)
        return {focal: (*both(kappas, focal, False), both(kappas, focal, True)[0]) for focal in (1.0, 1.5, 2.5)}


def test_pincushion_is_too_short_and_barrel_too_long(study):
    """For every κ and focal length tried, and the more so the stronger the lens."""
    for bias, _, _ in study.values():
        bias = np.asarray(bias)
        assert np.all(bias[KAPPAS > 0] < 0)
        assert np.all(bias[KAPPAS < 0] > 0)
        finite = np.isfinite(bias)
        assert np.all(np.diff(bias[finite]) < 0)
        assert np.all(finite[KAPPAS > -0.05])


def test_how_much_and_when_no_focal_length_is_left(study):
    """1/f² comes out about 2 to 4 κ too large; where that makes it negative, the bias is infinite."""
    for focal, (bias, inverse_square, _) in study.items():
        slope = (np.asarray(inverse_square) - 1 / focal**2) / KAPPAS
        assert slope.min() > 1.9
        assert slope.max() < 4.3
        np.testing.assert_array_equal(np.isinf(bias), np.asarray(inverse_square) <= 0)


def test_undistorted_points_leave_no_bias(study):
    for _, _, bias in study.values():
        assert np.abs(bias).max() <= 1e-12


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_the_sign_does_not_depend_on_how_far_the_camera_turns(x64, share):
    def bias(kappa):
        camera = RotatingCamera(jl.RadialPolynomial(kappa[None]), 1.5, aspect=1.0)
        return focal_length_bias(camera, rotations=pan_and_tilt(camera, share=share)[:4], side=15)

    found = jax.vmap(bias)(jnp.asarray([-0.1, -0.03, -0.01, 0.01, 0.03, 0.1]))
    assert np.all(np.diff(found) < 0)
    assert float(found[2]) > 0 > float(found[3])


def test_correspondences(x64):
    """The second picture is the homography of the first, but for the lens; what leaves the picture is not seen."""
    camera = RotatingCamera(jl.RadialPolynomial([0.1]), 1.5)
    rotation = jnp.asarray(Rotation.from_rotvec([0, 0.3, 0]).as_matrix())
    before, after, seen = camera.correspondences(rotation, side=11)
    ideal = np.asarray(camera.lens.undistort(before))
    matrix = np.diag([1.5, 1.5, 1]) @ np.asarray(rotation) @ np.diag([1 / 1.5, 1 / 1.5, 1])
    expected = np.column_stack([ideal, np.ones(len(ideal))]) @ matrix.T
    expected = np.asarray(camera.lens.distort(expected[:, :2] / expected[:, 2:]))
    seen = np.asarray(seen)
    np.testing.assert_allclose(np.asarray(after)[seen], expected[seen], rtol=0, atol=1e-14)
    assert 0.4 < seen.mean() < 0.9
    assert np.all((np.abs(expected) <= [0.8, 0.6]).all(axis=1) == seen)


@pytest.mark.parametrize("shape", [(3, 3), (0, 3, 3), (2, 3, 4)])
def test_a_wrong_shape(shape):
    with pytest.raises((ValueError, TypeError), match=r"\(V, 3, 3\)|views 3 3"):
        self_calibrate_focal_length(np.zeros(shape, np.float32))
