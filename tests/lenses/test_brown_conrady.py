"""The Brown–Conrady lens: a point by hand, OpenCV in both directions, derivatives, and where it folds."""

from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from preimages import check_against_a_search

import jaxlens as jl

# A mild lens of the lengths that OpenCV's order has (that of 12 is in the last one); all are one-to-one on POINTS.
COEFFICIENTS = {
    4: [-0.28, 0.09, 1.5e-3, -8e-4],
    5: [-0.31, 0.12, -2e-3, 1e-3, -0.02],
    8: [0.6, -0.2, 1e-3, 2e-3, 0.05, 0.85, 0.02, 0.08],
    14: [0.6, -0.2, 1e-3, 2e-3, 0.05, 0.85, 0.02, 0.08, 4e-3, -2e-3, -3e-3, 1e-3, 0.06, -0.04],
}
POINTS = np.random.default_rng(0).uniform(-0.55, 0.55, (400, 2))
counts = pytest.mark.parametrize("count", COEFFICIENTS)
_TILTED = pytest.param(14, marks=pytest.mark.slow)


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
        ([0.0] * 8 + [0.4, 1.6, -0.4, 3.2], [0.3 + 0.1 + 0.1, 0.4 - 0.1 + 0.2]),
        # sin τ = 0.6: the sensor sees it at depth 0.8 − 0.4 · 0.6, 0.8 + 0.3 · 0.6, and 0.64 + 0.3 · 0.6 − 0.4 · 0.48.
        ([0.0] * 12 + [np.arcsin(0.6), 0.0], [0.24 / 0.56, 0.4 / 0.56]),
        ([0.0] * 12 + [0.0, np.arcsin(0.6)], [0.3 / 0.98, 0.32 / 0.98]),
        ([0.0] * 12 + [np.arcsin(0.6), np.arcsin(0.6)], [0.24 / 0.628, (0.32 - 0.3 * 0.36) / 0.628]),
    ],
)
def test_a_point_by_hand(dtype, coefficients, expected):
    observed = jl.BrownConrady(np.asarray(coefficients, dtype)).distort(np.asarray([0.3, 0.4], dtype))
    assert observed.dtype == dtype
    np.testing.assert_allclose(observed, expected, rtol=8 * jnp.finfo(dtype).eps)


@pytest.mark.parametrize(
    "count", [pytest.param(4, marks=pytest.mark.slow), 5, pytest.param(8, marks=pytest.mark.slow), _TILTED]
)
def test_zero_coefficients_are_the_identity(x64, count):
    lens = jl.BrownConrady(np.zeros(count))
    np.testing.assert_array_equal(lens.distort(POINTS), POINTS)
    inverse = lens.invert(POINTS)
    np.testing.assert_array_equal(inverse.points, POINTS)
    assert bool(jnp.all(inverse.valid))


@counts
def test_distort_is_opencv_s(x64, count):
    k = COEFFICIENTS[count]
    np.testing.assert_allclose(jl.BrownConrady(k).distort(POINTS), _opencv_distort(POINTS, k), rtol=0, atol=1e-15)


@counts
def test_undistort_undoes_it(x64, count):
    lens = jl.BrownConrady(COEFFICIENTS[count])
    inverse = lens.invert(lens.distort(POINTS))
    assert bool(jnp.all(inverse.valid))
    np.testing.assert_allclose(inverse.points, POINTS, rtol=0, atol=1e-14)


def test_undistort_undoes_it_in_single_precision():
    lens = jl.BrownConrady(np.float32(COEFFICIENTS[5]))
    points = POINTS.astype(np.float32)
    inverse = lens.invert(lens.distort(points))
    assert inverse.points.dtype == np.float32
    assert bool(jnp.all(inverse.valid))
    np.testing.assert_allclose(inverse.points, points, rtol=0, atol=1e-6)


@counts
def test_undistort_is_what_opencv_s_iteration_tends_to(x64, count):
    k = COEFFICIENTS[count]
    observed = _opencv_distort(POINTS, k)
    np.testing.assert_allclose(
        jl.BrownConrady(k).undistort(observed), _opencv_undistort(observed, k), rtol=0, atol=1e-12
    )


@counts
def test_jacobian(x64, count):
    k = COEFFICIENTS[count]
    lens = jl.BrownConrady(k)
    jacobian = np.asarray(lens.jacobian(POINTS))
    for column in range(2):
        step = 1e-5 * np.eye(2)[column]
        differences = (_opencv_distort(POINTS + step, k) - _opencv_distort(POINTS - step, k)) / 2e-5
        np.testing.assert_allclose(jacobian[..., column], differences, rtol=0, atol=1e-9)


@pytest.mark.parametrize("count", [5, 8, _TILTED])
def test_derivatives_by_the_coefficients(x64, count):
    """Of distort against those that OpenCV writes out; of the inverse against what the implicit function implies."""
    lens = jl.BrownConrady(COEFFICIENTS[count])
    rays = np.column_stack([POINTS, np.ones(len(POINTS))])
    full = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), np.eye(3), np.array(COEFFICIENTS[count]))[1]
    expected = full[:, 10 : 10 + count].reshape(len(POINTS), 2, count)
    found = jax.jacfwd(lambda lens: lens.distort(POINTS))(lens).coefficients
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    observed = lens.distort(POINTS)
    implied = -np.linalg.solve(np.asarray(lens.jacobian(POINTS)), expected)
    forward = jax.jacfwd(lambda lens: lens.undistort(observed))(lens).coefficients
    np.testing.assert_allclose(forward, implied, rtol=0, atol=1e-13)
    reverse = jax.grad(lambda lens: jnp.sum(lens.undistort(observed) * POINTS))(lens).coefficients
    np.testing.assert_allclose(reverse, np.sum(implied * POINTS[..., None], axis=(0, 1)), rtol=1e-12, atol=1e-12)


def test_beyond_the_fold_nothing_is_valid(dtype):
    """k1 = −0.3 alone folds at ρ = √(1/0.9), which is seen at two thirds of that."""
    lens = jl.BrownConrady(np.asarray([-0.3, 0, 0, 0], dtype))
    edge = np.sqrt(1 / 0.9) * 2 / 3
    radii = edge * np.asarray([0.0, 0.5, 0.999, 1.001, 1.01, 1.05])
    observed = np.stack([0.6 * radii, -0.8 * radii], -1).astype(dtype)
    inverse = lens.invert(observed)
    status = jl.InverseStatus
    assert inverse.valid.tolist() == [True, True, True, False, False, False]
    assert inverse.status.tolist() == [status.CONVERGED] * 3 + [status.NO_PREIMAGE] * 3
    assert bool(jnp.all(jnp.isfinite(inverse.points)))
    assert np.isnan(lens.undistort(observed)).all(axis=-1).tolist() == [False, False, False, True, True, True]
    off = np.concatenate([np.asarray([[np.nan, 0], [np.inf, 0], [0, -np.inf]], dtype), observed[:3]])
    assert lens.invert(off).status.tolist() == [status.NOT_FINITE] * 3 + [status.CONVERGED] * 3
    # The lens itself goes on beyond its fold: ρ = 1 / √0.3 is seen in the centre again.
    np.testing.assert_allclose(lens.distort(np.asarray([0.3**-0.5, 0], dtype)), 0, atol=4 * jnp.finfo(dtype).eps)


@pytest.mark.parametrize("terms", [(-0.4, 0.0, 0.0), (-0.3, 0.1, 0.05), (0.3, -0.2, 0.0), (-0.5, 0.3, -0.1)])
def test_without_tangential_terms_it_is_the_radial_polynomial(x64, terms):
    """The plane's Newton iteration against the exact inverse along the ray, up to the fold."""
    brown, radial = jl.BrownConrady([*terms[:2], 0.0, 0.0, terms[2]]), jl.RadialPolynomial(np.array(terms))
    points = 2.2 * POINTS
    np.testing.assert_allclose(brown.distort(points), radial.distort(points), rtol=1e-13, atol=1e-15)
    ours, theirs = brown.invert(points), radial.invert(points)
    seen = np.asarray(theirs.valid) & (np.hypot(*points.T) < (1 - 1e-6) * float(radial.edge_radius()))
    assert seen.mean() > 0.2
    assert np.asarray(ours.valid)[seen].all()
    # Rounding in what is seen moves the preimage by more, the nearer it is to the fold.
    slopes = np.asarray(radial.jacobian_determinant(theirs.points))[seen]
    errors = np.abs(np.asarray(ours.points) - np.asarray(theirs.points))[seen]
    assert np.max(errors * slopes[:, None]) <= 1e-14


def test_whatever_the_lens_a_valid_inverse_maps_back(x64):
    """Hundreds of wild lenses, folding ones and ones with poles among them."""
    random = np.random.default_rng(2)
    shares = []
    for count in (4, 5, 8):
        for _ in range(100):
            k = random.uniform(-1, 1, count)
            k[2:4] *= 0.1
            lens = jl.BrownConrady(k)
            observed = random.uniform(-1, 1, POINTS.shape)
            inverse = lens.invert(observed)
            valid = np.asarray(inverse.valid)
            assert np.isfinite(inverse.points).all()
            back = np.asarray(lens.distort(inverse.points))
            assert np.max(np.abs(back - observed)[valid], initial=0) <= 1e-12
            assert np.all(np.asarray(lens.jacobian_determinant(inverse.points))[valid] > 0)
            shares.append(valid.mean())
    assert 0.4 < np.mean(shares) < 0.99


@pytest.mark.parametrize("count", [5, pytest.param(8, marks=pytest.mark.slow), _TILTED])
def test_batches(x64, count):
    coefficients = np.array(COEFFICIENTS[count]) * np.random.default_rng(3).uniform(0, 1, (4, 1))
    lenses = jax.vmap(jl.BrownConrady)(jnp.asarray(coefficients))
    points = POINTS.reshape(2, 200, 2)
    distorted, undistorted = jax.jit(jax.vmap(lambda lens: (lens.distort(points), lens.undistort(points))))(lenses)
    assert distorted.shape == undistorted.shape == (4, 2, 200, 2)
    for i in range(4):
        lens = jl.BrownConrady(coefficients[i])
        np.testing.assert_allclose(distorted[i].reshape(-1, 2), lens.distort(POINTS), rtol=0, atol=1e-15)
        np.testing.assert_allclose(undistorted[i].reshape(-1, 2), lens.undistort(POINTS), rtol=0, atol=1e-14)
    assert lens.distort(jnp.zeros(2)).shape == (2,)
    assert lens.undistort(jnp.zeros((0, 2))).shape == (0, 2)


@pytest.mark.parametrize("shape", [(0,), (3,), (6,), (7,), (9,), (13,), (15,), (3, 1)])
def test_a_wrong_number_of_coefficients(shape):
    with pytest.raises(ValueError, match=f"that is 4, 5, 8, 12 or 14 numbers, got {shape[0]}"):
        jl.BrownConrady(np.zeros(shape))


def test_coefficients_are_a_vector():
    """OpenCV's 1×5 and 5×1 too; a number and a batch are told what they should be."""
    for shape in ((5,), (1, 5), (5, 1)):
        assert jl.BrownConrady(np.arange(5.0).reshape(shape)).coefficients.tolist() == [0, 1, 2, 3, 4]
        assert jl.RadialPolynomial(np.arange(5.0).reshape(shape)).coefficients.tolist() == [0, 1, 2, 3, 4]
    for make in (jl.BrownConrady, jl.RadialPolynomial):
        with pytest.raises(ValueError, match=rf"write {make.__name__}\(\[-0.3\]\)"):
            make(-0.3)
        with pytest.raises(ValueError, match=rf"jax.vmap\({make.__name__}\)"):
            make(np.zeros((2, 4)))


def test_its_frame_is_asked_for():
    """Eq. 10's would be wrong in silence."""
    lens, image = jl.BrownConrady([-0.28, 0.03, 0.001, 0.0, 0.16]), jnp.zeros((6, 8))
    for attempt in (jl.distort_image, jl.undistort_image, jl.warp):
        with pytest.raises(ValueError, match="give its frame"):
            attempt(image, lens)
    chain = jl.RadialPolynomial([0.1]).then(lens.inverse())
    with pytest.raises(ValueError, match="coordinates of a camera"):
        jl.diagnostics.coverage(chain, 6, 8)
    frame = jl.Frame([4.0, 3.0], 8.0)
    assert jl.undistort_image(image, lens, frame=frame).shape == (6, 8)


def test_it_shows_its_numbers():
    lens = jl.BrownConrady([-0.25, 0.5, 0.0, 0.0])
    assert repr(lens) == "BrownConrady(coefficients=[-0.25,  0.5 ,  0.  ,  0.  ])"
    assert "mapping=BrownConrady(coefficients=[-0.25" in str(lens.inverse())
    assert repr(jl.Frame([4.0, 3.0], 8.0)) == "Frame(center=[4., 3.], scale=[8., 8.])"
    told = []
    jax.eval_shape(lambda lens: told.append(repr(lens)), lens)  # unknown numbers are told by their shapes
    assert told == ["BrownConrady(coefficients=f32[4])"]


def test_where_it_is_one_to_one(x64):
    """1 + 3 k1 ρ² vanishes at ρ = √(1 / 0.9) for k1 = −0.3."""
    radii = np.sqrt(1 / 0.9) * np.array([0.5, 0.999, 1.001, 2.0])
    points = np.stack([0.6 * radii, 0.8 * radii], axis=-1)
    lens = jl.BrownConrady([-0.3, 0.0, 0.0, 0.0])
    assert lens.one_to_one(points).tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    "radial", [(-0.28, 0.0, 0.0), (-0.28, 0.03, 0.16), (-0.5, 0.3, -0.1), (1.0, -0.5, 0.0), (-0.1, -0.1, -0.1)]
)
def test_without_tangential_terms_valid_is_what_the_radial_lens_says(x64, radial):
    """Newton's step may leap over the fold, to where the lens keeps orientation again."""
    points = np.random.default_rng(8).uniform(-1.5, 1.5, (4000, 2))
    reference = jl.RadialPolynomial(np.array(radial)).invert(points)
    k1, k2, k3 = radial
    found = jl.BrownConrady([k1, k2, 0.0, 0.0, k3]).invert(points)
    assert found.valid.tolist() == reference.valid.tolist()
    valid = np.asarray(found.valid)
    np.testing.assert_allclose(found.points[valid], reference.points[valid], rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("count", [5, 8, _TILTED])
def test_single_precision_says_what_double_does(count):
    """Strong lenses, most of which fold or have poles: every status, but next to an edge, where rounding decides."""
    random = np.random.default_rng(7)
    tangential = random.normal(0, 0.005, (12, 2))
    lenses = random.normal(0, random.choice([0.1, 0.3, 1.0], (12, 1)), (12, count))
    lenses[:, 2:4] = tangential
    lenses[:, 8:] *= 0.3
    points = random.uniform(-1, 1, (12, 3000, 2)).astype(np.float32)
    lenses = lenses.astype(np.float32)

    def invert(coefficients, points):
        lens = jl.BrownConrady(coefficients)
        inverse = lens.invert(points)
        return inverse.status, inverse.points, lens.jacobian_determinant(inverse.points)

    single = [np.asarray(found) for found in jax.jit(jax.vmap(invert))(lenses, points)]
    with jax.enable_x64(True):
        double = jax.jit(jax.vmap(invert))(jnp.asarray(lenses, float), jnp.asarray(points, float))
        status, _, determinants = (np.asarray(found) for found in double)
    assert set(np.unique(status)) == {0, 1}
    # Where the map keeps a thousandth of the area, the preimages of two precisions are on the same side of the edge.
    clear = (status == 1) | (determinants > 1e-3)
    differ = clear & (single[0] != status)
    near = (status == 1) & (single[0] == 0) & (single[2] < 1e-2)
    assert not (differ & ~near).any()


@pytest.mark.parametrize(
    "coefficients",
    [
        # Tangential terms end the fold at 0.80 in some directions, between two rays: there the edge jumps to 2.1.
        [-0.2522, -0.3185, 0.0011, 0.001, 0.3303, 0.4954, 0.1703, -0.075],
        # A pole at 1.2234, and a zero that nearly cancels it at 1.2240: the determinant is negative between them only.
        [0.0143, 0.5782, 0.0003, -0.0008, -0.6898, 0.061, -0.2281, -0.1731],
        # A sensor turned so far that it stands in the way of the light: from 0.42 on it is seen from behind.
        pytest.param(
            [-0.28, 0.03, 1e-3, -2e-3, 0.1, 0.0, 0.0, 0.0, 0.01, 0.0, -0.02, 0.0, 0.9, -0.7], marks=pytest.mark.slow
        ),
    ],
)
def test_narrow_folds_are_seen_by_brute_force(x64, coefficients):
    lens = jl.BrownConrady(coefficients)
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)[:, None]
    radius = np.linspace(3e-4, 3, 10000)
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    regular = np.asarray(lens.jacobian_determinant(radius[:, None] * directions)) > 0
    inside = np.logical_and.accumulate(regular, axis=1)
    # Between two directions and two radii of the grid nothing is known.
    edge = np.where(inside.all(axis=1), np.inf, radius[inside.sum(axis=1) - 1])
    asked = radius[33::150]
    known = np.abs(asked - edge[:, None]) > 2e-3 * edge[:, None]
    points = asked[:, None] * directions
    found = np.asarray(lens.one_to_one(points))
    np.testing.assert_array_equal(found[known], (asked < edge[:, None])[known])
    observed = np.asarray(lens.distort(points))
    inverse = lens.invert(observed)
    back = np.abs(np.asarray(inverse.points) - points).max(axis=-1)
    expected = known & (asked < edge[:, None])
    assert np.asarray(inverse.valid)[expected].all()
    assert back[expected].max() < 1e-9
    # What folds over is either seen by another point, of the region, or by none.
    size = np.hypot(*np.moveaxis(np.asarray(inverse.points), -1, 0))
    beyond = np.asarray(inverse.valid) & ~expected & known
    assert (size[beyond] < asked[None].repeat(120, axis=0)[beyond]).all()


def test_beyond_the_horizon_of_a_tilted_sensor_nothing_is_valid(x64):
    """τy = asin 0.6 alone: points with 0.8 + 0.6 x > 0 are seen, at x / (0.8 + 0.6 x), which is less than 1 / 0.6."""
    lens = jl.BrownConrady([0.0] * 13 + [np.arcsin(0.6)])
    assert lens.one_to_one(np.asarray([[-1.3, 0.2], [-1.4, 0.2], [0.0, 9.0]])).tolist() == [True, False, True]
    observed = np.asarray([[1.6, 0.0], [1.7, 0.0], [-40.0, 3.0], [np.nan, 0.0], [np.inf, 1.0], [-np.inf, 1.0]])
    # As many as the other tests have: what they compiled will do.
    observed = np.resize(observed, POINTS.shape)
    inverse = lens.invert(observed)
    status = jl.InverseStatus
    seen, behind, lost = status.CONVERGED, status.NO_PREIMAGE, status.NOT_FINITE
    assert inverse.status[:6].tolist() == [seen, behind, seen, lost, lost, lost]
    assert np.isnan(lens.undistort(observed)).all(axis=-1)[:6].tolist() == [False, True, False, True, True, True]
    assert bool(jnp.all(jnp.isfinite(inverse.points)))
    np.testing.assert_allclose(inverse.points[0], [1.28 / 0.04, 0.0], rtol=1e-13, atol=1e-13)
    assert float(inverse.points[1, 0]) > 1e3, "the one behind has a distant one in its stead"
    # Turned by more than a right angle the sensor sees nothing.
    averted = jl.BrownConrady([0.0] * 13 + [2.0])
    assert not averted.invert(observed).valid.any()
    assert not averted.one_to_one(observed[:3]).any()


@pytest.mark.slow
def test_derivatives_beyond_the_horizon_are_finite(x64):
    lens = jl.BrownConrady([0.0] * 13 + [np.arcsin(0.6)])
    observed = jnp.asarray([[1.6, 0.0], [1.7, 0.0], [-40.0, 3.0], [np.nan, 0.0], [-np.inf, 1.0]])

    def total(lens, points):
        found = lens.invert(points)
        return jnp.nansum(lens.undistort(points)) + jnp.sum(jnp.where(found.valid[:, None], found.points, 0))

    for leaf in jax.tree.leaves(jax.grad(total, (0, 1))(lens, observed)):
        assert bool(jnp.all(jnp.isfinite(leaf)))


def _turned(points):
    return np.stack([points[..., 1], -points[..., 0]], axis=-1)


@pytest.mark.parametrize("tilt", [(0.1, 0.0), (0.0, -0.2), ()])
def test_turned_by_a_quarter_it_is_the_lens_of_the_turned_picture(x64, tilt):
    lens = jl.BrownConrady([*COEFFICIENTS[14][:12], *tilt])
    for _ in range(4):
        turned = lens.turned(1)
        np.testing.assert_allclose(
            turned.distort(_turned(POINTS)), _turned(np.asarray(lens.distort(POINTS))), rtol=0, atol=1e-15
        )
        lens = turned
    np.testing.assert_array_equal(lens.coefficients, jnp.asarray([*COEFFICIENTS[14][:12], *tilt]))
    assert jl.BrownConrady([1.0, 2.0, 3.0, 4.0]).turned(1).coefficients.tolist() == [1, 2, -4, 3]


def test_a_sensor_tilted_about_both_axes_is_turned_by_a_lens_around_it(x64):
    lens = jl.BrownConrady(COEFFICIENTS[14])
    for turn in (lambda lens: lens.turned(1), jax.jit(lambda lens: lens.turned(1))):
        found = turn(lens).distort(_turned(POINTS))
        np.testing.assert_allclose(found, _turned(np.asarray(lens.distort(POINTS))), rtol=0, atol=1e-14)
    assert type(lens.turned(4)) is jl.BrownConrady


def _by_the_documentation(points, coefficients):
    """OpenCV's equations as its documentation writes them, with the sensor's two matrices, for complex numbers too."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tilt_x, tilt_y = np.pad(coefficients, (0, 14 - len(coefficients)))
    x, y = points
    s = x * x + y * y
    factor = (1 + s * (k1 + s * (k2 + s * k3))) / (1 + s * (k4 + s * (k5 + s * k6)))
    across = x * factor + 2 * p1 * x * y + p2 * (s + 2 * x * x) + s1 * s + s2 * s * s
    down = y * factor + p1 * (s + 2 * y * y) + 2 * p2 * x * y + s3 * s + s4 * s * s
    about_x = [[1, 0, 0], [0, np.cos(tilt_x), np.sin(tilt_x)], [0, -np.sin(tilt_x), np.cos(tilt_x)]]
    about_y = [[np.cos(tilt_y), 0, -np.sin(tilt_y)], [0, 1, 0], [np.sin(tilt_y), 0, np.cos(tilt_y)]]
    turn = np.array(about_y) @ np.array(about_x)
    a, b, c = turn[:, 2]
    u, v, w = np.einsum(
        "ij,j...->i...", np.array([[c, 0, -a], [0, c, -b], [0, 0, 1]]) @ turn, [across, down, 1 + 0 * s]
    )
    return np.stack([u / w, v / w])


@pytest.mark.slow
@pytest.mark.parametrize("count", [12, 14])
def test_flags_against_every_preimage_that_a_search_finds(x64, count):
    random = np.random.default_rng(count)
    answers = []
    for _ in range(20):
        k = random.normal(0, random.choice([0.1, 0.3]), count)
        k[2:4] *= 0.1
        k[8:12] *= 0.2
        k[12:] = random.uniform(-1, 1, count - 12)
        observed = random.uniform(-1.5, 1.5, (60, 2))
        inverse = jl.BrownConrady(k).invert(observed)
        equation = partial(_by_the_documentation, coefficients=k)
        check_against_a_search(equation, observed, inverse.points, inverse.valid)
        answers.append(np.asarray(inverse.valid))
    assert 0.2 < np.mean(answers) < 0.95


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_distort_is_opencv_s_whatever_the_lens(x64, count):
    random = np.random.default_rng(count)
    for _ in range(20):
        points = random.uniform(-1, 1, (10_000, 2))
        k = random.uniform(-0.3, 0.3, count)
        k[2:4] *= 0.1
        theirs = _opencv_distort(points, k)
        errors = np.abs(np.asarray(jl.BrownConrady(k).distort(points)) - theirs)
        assert np.all(errors <= 1e-10 * np.hypot(*theirs.T)[:, None])
