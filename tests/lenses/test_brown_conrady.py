"""The Brown–Conrady lens: a point by hand, OpenCV in both directions, derivatives, and where it folds."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

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


@pytest.mark.parametrize("count", [5, 8])
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
    for count in COEFFICIENTS:
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


@pytest.mark.parametrize("count", [5, 8])
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


@pytest.mark.parametrize("shape", [(0,), (3,), (6,), (7,), (9,), (12,), (14,), (3, 1)])
def test_a_wrong_number_of_coefficients(shape):
    with pytest.raises(ValueError, match=f"that is 4, 5 or 8 numbers, got {shape[0]}"):
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


@pytest.mark.parametrize("count", [5, 8])
def test_single_precision_says_what_double_does(count):
    """Strong lenses, most of which fold or have poles: every status, but next to an edge, where rounding decides."""
    random = np.random.default_rng(7)
    tangential = random.normal(0, 0.005, (12, 2))
    lenses = random.normal(0, random.choice([0.1, 0.3, 1.0], (12, 1)), (12, count))
    lenses[:, 2:4] = tangential
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
