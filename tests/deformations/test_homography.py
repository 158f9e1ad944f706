"""Homographies: points by hand, the line at infinity, inverses, products, parts, and rectified pictures."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.deformations import Homography, rectification

MATRIX = np.array([[1.2, 0.1, 30.0], [-0.2, 0.9, 50.0], [3e-4, -2e-4, 1.0]])
POINTS = np.random.default_rng(0).uniform(0, 1, (200, 2)) * [640, 480]
PIXELS = jl.Frame((0, 0), 1)


@pytest.fixture
def homography(x64):
    return Homography(MATRIX)


def test_points_by_hand(dtype):
    tilted = Homography(np.array([[2, 0, 1], [0, 1, 0], [0.5, 0, 1]], dtype))
    points = np.array([[0, 0], [2, 2], [-1, 3], [-2, 0], [-3, 0], [np.nan, 0]], dtype)
    found = tilted(points)
    assert found.dtype == dtype
    expected = [[1, 0], [2.5, 1], [-2, 6]] + [[np.nan, np.nan]] * 3
    np.testing.assert_allclose(found, expected, rtol=4 * jnp.finfo(dtype).eps)
    assert tilted.one_to_one(points).tolist() == [True, True, True, False, False, False]


def test_opencv_s_transform(homography):
    expected = cv2.perspectiveTransform(POINTS[None], MATRIX)[0]
    np.testing.assert_allclose(homography(POINTS), expected, rtol=1e-14)


def test_the_sign_of_the_matrix_chooses_the_side(homography):
    """−H is the same map, beyond the line that H sends to infinity."""
    scaled, other = Homography(3 * MATRIX), Homography(-MATRIX)
    np.testing.assert_allclose(scaled(POINTS), homography(POINTS), rtol=0, atol=1e-12)
    assert np.isnan(other(POINTS)).all()
    beyond = POINTS - np.array([5000, 0])
    assert np.isnan(homography(beyond)).all()
    assert bool(jnp.isfinite(other(beyond)).all())


def test_inverse(homography):
    observed = homography(POINTS)
    found = homography.invert(observed)
    assert bool(found.valid.all())
    np.testing.assert_allclose(found.points, POINTS, rtol=0, atol=1e-11)
    np.testing.assert_allclose(homography.inverse()(observed), POINTS, rtol=0, atol=1e-11)
    np.testing.assert_allclose((homography.inverse() @ homography).matrix, np.eye(3), rtol=0, atol=1e-13)


def test_what_is_beyond_the_horizon_has_no_preimage(homography):
    """The horizon is the image of the line at infinity: h11 / h31 = 4000 along x, towards which x → ∞ goes."""
    targets = np.array([[3000.0, 0.0], [5000.0, 0.0], [np.inf, 0.0]])
    found = homography.invert(targets)
    assert found.valid.tolist() == [True, False, False]
    assert found.status.tolist() == [0, jl.InverseStatus.NO_PREIMAGE, jl.InverseStatus.NOT_FINITE]
    assert bool(jnp.isfinite(found.points).all())
    assert np.isnan(homography.preimages(targets)).all(axis=-1).tolist() == [False, True, True]


def test_a_mirror_is_one_to_one(x64):
    mirror = Homography.isometry(0.3, [1.0, 2.0], reflect=True)
    assert bool(mirror.one_to_one(POINTS).all())
    assert float(mirror.jacobian_determinant(POINTS).max()) < 0
    np.testing.assert_allclose(mirror.invert(mirror(POINTS)).points, POINTS, rtol=0, atol=1e-12)


def test_the_hierarchy(x64):
    """What each keeps: lengths, their ratios, parallels, lines."""
    line = np.array([[0.0, 0.0], [1.0, 2.0], [2.0, 4.0], [2.0, 1.0], [3.0, 3.0]])

    def lengths(points):
        return np.linalg.norm(np.diff(np.asarray(points), axis=0), axis=1)

    turned = Homography.isometry(np.pi / 2, [5.0, 0.0])
    np.testing.assert_allclose(turned(np.array([1.0, 0.0])), [5.0, 1.0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(lengths(turned(line)), lengths(line), rtol=1e-14)
    doubled = Homography.similarity(2.0, -0.4, [0.0, 1.0])
    np.testing.assert_allclose(lengths(doubled(line)), 2 * lengths(line), rtol=1e-14)
    sheared = Homography.affine([[1.0, 0.5], [0.2, 3.0]], [1.0, 1.0])
    np.testing.assert_allclose(sheared(line), line @ np.array([[1.0, 0.2], [0.5, 3.0]]) + 1, rtol=1e-14)
    receding = Homography.projective([0.1, 0.2, 2.0])
    expected = line / (line @ [0.1, 0.2] + 2)[:, None]
    np.testing.assert_allclose(receding(line), expected, rtol=1e-14, atol=1e-16)


def test_a_product_is_the_map_after_the_map(homography):
    other = Homography.similarity(0.7, 0.2, [3.0, -20.0], reflect=True)
    both = other @ homography
    np.testing.assert_allclose(both(POINTS), other(homography(POINTS)), rtol=0, atol=1e-11)
    np.testing.assert_allclose(homography.then(other)(POINTS), both(POINTS), rtol=0, atol=1e-11)


@pytest.mark.parametrize("sign", [1, -1])
def test_parts(x64, sign):
    """Each is what it is called; their product is the matrix with |h33| = 1, mirrored and beyond infinity too."""
    for matrix in (MATRIX, MATRIX @ np.diag([1.0, -1.0, 1.0]), 7 * np.random.default_rng(1).normal(size=(3, 3))):
        whole = Homography(sign * matrix)
        similarity, affine, projective = (part.matrix for part in whole.decompose())
        np.testing.assert_allclose(
            similarity @ affine @ projective, sign * matrix / abs(matrix[2, 2]), rtol=0, atol=1e-13
        )
        turn = np.asarray(similarity[:2, :2])
        scale = np.sqrt(abs(np.linalg.det(turn)))
        np.testing.assert_allclose(turn @ turn.T, scale**2 * np.eye(2), rtol=0, atol=1e-13 * scale**2)
        np.testing.assert_array_equal(similarity[2], [0, 0, 1])
        assert affine[1, 0] == 0
        assert min(affine[0, 0], affine[1, 1]) > 0
        np.testing.assert_allclose(affine[0, 0] * affine[1, 1], 1, rtol=1e-13)
        np.testing.assert_array_equal(affine[2], [0, 0, 1])
        np.testing.assert_array_equal(affine[:2, 2], [0, 0])
        np.testing.assert_array_equal(projective[:2], np.eye(3)[:2])
    with pytest.raises(ValueError, match="sends the origin to infinity"):
        Homography([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]).decompose()


def test_derivatives(homography):
    jacobian = np.asarray(homography.jacobian(POINTS))
    for column in range(2):
        step = 1e-4 * np.eye(2)[column]
        differences = [cv2.perspectiveTransform((POINTS + sign * step)[None], MATRIX)[0] for sign in (1, -1)]
        np.testing.assert_allclose(jacobian[..., column], (differences[0] - differences[1]) / 2e-4, rtol=0, atol=1e-8)
    # In closed form: det H / W³.
    down = POINTS @ MATRIX[2, :2] + 1
    np.testing.assert_allclose(homography.jacobian_determinant(POINTS), np.linalg.det(MATRIX) / down**3, rtol=1e-11)

    def total(matrix, points):
        there = Homography(matrix)
        return jnp.nansum(there(points)) + jnp.nansum(there.invert(points).points * jnp.arange(2.0)[None])

    around = jnp.asarray(np.concatenate([POINTS[:3], [[-1 / 3e-4, 0], [-9e3, 0], [1e4, 0], [np.nan, 0]]]))
    by_matrix, by_points = jax.jit(jax.grad(total, argnums=(0, 1)))(jnp.asarray(MATRIX), around)
    assert bool(jnp.isfinite(by_matrix).all())
    assert bool(jnp.isfinite(by_points).all())


def test_batches(homography):
    matrices = jnp.asarray(np.stack([MATRIX, np.eye(3)]))
    moved = jax.jit(jax.vmap(lambda homography: homography(POINTS)))(jax.vmap(Homography)(matrices))
    np.testing.assert_allclose(moved[0], homography(POINTS), rtol=1e-14)
    np.testing.assert_array_equal(moved[1], POINTS)
    assert homography(jnp.zeros((0, 2))).shape == (0, 2)
    np.testing.assert_array_equal(homography.adjustable().matrix, np.arange(9).reshape(3, 3) < 8)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(2), r"shape \(3, 3\), got \(2, 2\)"),
        (np.ones((3, 3)), "must be regular"),
        (np.outer([1e6, 1, 1e-6], [1e-3, 2, 3.0]) + np.outer([1, 2, 3.0], [4, 5, 6.0]), "must be regular"),
        (np.full((3, 3), np.nan), "must be finite"),
    ],
)
def test_misuse(x64, matrix, message):
    with pytest.raises(ValueError, match=message):
        Homography(matrix)


def test_matrices_of_pixels_are_not_taken_for_singular(x64):
    """Their determinants are small only because of their units."""
    Homography(np.diag([1e-8, 1e8, 1e-4]) @ MATRIX @ np.diag([1e-6, 1e3, 1e6]))


CORNERS = np.array([[102.0, 51.0], [380.0, 90.0], [352.0, 301.0], [60.0, 250.0]])


def test_rectification_is_opencv_s(x64):
    upright = rectification(CORNERS, 120, 200)
    goals = np.array([[0, 0], [199, 0], [199, 119], [0, 119]], float)
    np.testing.assert_allclose(upright(CORNERS), goals, rtol=0, atol=1e-11)
    expected = cv2.getPerspectiveTransform(np.float32(CORNERS), np.float32(goals))
    np.testing.assert_allclose(upright.matrix / upright.matrix[2, 2], expected, rtol=1e-9, atol=1e-12)
    assert bool(upright.one_to_one(CORNERS).all())


def test_rectification_of_a_rectangle_is_affine_and_differentiable(x64):
    """Where the perspective vanishes its derivatives do not: they are those of a general quadrilateral nearby."""
    rectangle = jnp.asarray([[10.0, 20.0], [50.0, 20.0], [50.0, 40.0], [10.0, 40.0]])

    def image(corners):
        return rectification(corners, 11, 21)(jnp.asarray([30.0, 25.0]))

    np.testing.assert_allclose(image(rectangle), [10.0, 2.5], rtol=0, atol=1e-13)
    forward = jax.jacfwd(image)(rectangle)
    for row, column in ((0, 0), (2, 1)):
        step = np.zeros((4, 2))
        step[row, column] = 1e-6
        differences = (image(rectangle + step) - image(rectangle - step)) / 2e-6
        np.testing.assert_allclose(forward[:, row, column], differences, rtol=0, atol=1e-8)


def test_a_checkerboard_seen_at_an_angle_is_set_upright(x64):
    """Drawn by a homography, and rectified back to where its fields are, to what interpolation loses at their edges."""
    rows, columns = np.mgrid[:120, :200]
    board = ((rows // 20 + columns // 20) % 2).astype(float)
    upright = rectification(CORNERS, 120, 200)
    seen = jl.warp(board, upright, frame=PIXELS, shape=(340, 460), fill=0.5)
    back = np.asarray(jl.warp(seen, upright.inverse(), frame=PIXELS, shape=(120, 200)))
    interior = (rows % 20 > 2) & (rows % 20 < 17) & (columns % 20 > 2) & (columns % 20 < 17)
    np.testing.assert_allclose(back[interior], board[interior], rtol=0, atol=1e-9)
    assert abs(back - board).mean() < 0.1


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        (CORNERS[[0, 2, 1, 3]], "its sides cross"),
        (CORNERS[::-1], "counterclockwise"),
        (CORNERS * [[1, 1], [1, 1], [0.5, 0.5], [1, 1]], "not convex"),
        (np.array([[0, 0], [1, 0], [2, 0], [0, 1.0]]), "three of them lie on a line"),
        (CORNERS[[0, 1, 1, 3]], "or two coincide"),
        (CORNERS * np.nan, "not all of them are finite"),
        (CORNERS[:3], r"shape \(4, 2\), got \(3, 2\)"),
    ],
)
@pytest.mark.usefixtures("untyped")
def test_no_quadrilateral(x64, corners, message):
    with pytest.raises(ValueError, match=message):
        rectification(corners, 10, 10)


def test_no_picture():
    with pytest.raises(ValueError, match="2 pixels or more, got 1 and 7"):
        rectification(CORNERS, 1, 7)
