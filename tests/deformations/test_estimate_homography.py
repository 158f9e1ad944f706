"""Estimates of homographies: OpenCV, scipy, closed forms, uncertainty by simulation, derivatives, and refusals."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from jaxlens.deformations import EstimateStatus, Homography, estimate_homography

MATRIX = np.array([[1.2, 0.1, 30.0], [-0.2, 0.9, 50.0], [3e-4, -2e-4, 1.0]])
RANDOM = np.random.default_rng(0)
# In single precision, because that is what OpenCV reads, whatever it is given.
SOURCE = np.float64(np.float32(RANDOM.uniform(0, 1, (40, 2)) * [640, 480]))
NOISE = RANDOM.normal(size=(40, 2))
SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def image(points, matrix=MATRIX):
    return cv2.perspectiveTransform(np.float64(points)[None], matrix)[0]


def observed(noise):
    return np.float64(np.float32(image(SOURCE) + noise * NOISE))


@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_opencv_s_homography(x64, noise):
    target = observed(noise)
    expected = image(SOURCE, cv2.findHomography(SOURCE, target, 0)[0])
    estimate = estimate_homography(SOURCE, target)
    np.testing.assert_allclose(estimate.homography(SOURCE), expected, rtol=0, atol=1e-6)
    assert int(estimate.status) == EstimateStatus.CONVERGED
    assert str(EstimateStatus(int(estimate.status))) == "CONVERGED"


def test_four_points_are_met(x64):
    corners = np.array([[3.0, 5.0], [600.0, 20.0], [580.0, 470.0], [20.0, 400.0]])
    estimate = estimate_homography(SQUARE, corners)
    np.testing.assert_allclose(estimate.homography(SQUARE), corners, rtol=0, atol=1e-10)
    expected = cv2.getPerspectiveTransform(np.float32(SQUARE), np.float32(corners))
    matrix = np.asarray(estimate.homography.matrix)
    np.testing.assert_allclose(matrix / matrix[2, 2], expected, rtol=1e-9)
    # As the matrix says of itself: one in the middle, and no residuals to tell a variance from.
    np.testing.assert_allclose(matrix[2] @ [0.5, 0.5, 1], 1, rtol=1e-14)
    assert int(estimate.degrees_of_freedom) == 0
    assert np.isnan(estimate.covariance).all()


@pytest.mark.parametrize("noise", [0.5, 5.0])
def test_the_minimum_and_what_is_known_of_it(x64, noise):
    """scipy's least squares for the loss, and the covariance in another gauge."""
    weights = np.random.default_rng(1).uniform(0.2, 2, 40)
    target = observed(noise)
    estimate = estimate_homography(SOURCE, target, weights=weights)

    def rows(entries):
        matrix = np.append(entries, 1).reshape(3, 3)
        return (np.sqrt(weights)[:, None] * (target - image(SOURCE, matrix))).ravel()

    scale = np.array([1, 1, 100, 1, 1, 100, 1e-3, 1e-3])
    best = least_squares(rows, MATRIX.ravel()[:8], x_scale=scale, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    matrix = np.asarray(estimate.homography.matrix)
    loss = np.sum(rows((matrix / matrix[2, 2]).ravel()[:8]) ** 2)
    np.testing.assert_allclose(loss, 2 * best.cost, rtol=1e-11)
    np.testing.assert_allclose(estimate.rms, np.sqrt(loss / weights.sum()), rtol=1e-11)
    np.testing.assert_allclose(estimate.residuals, target - image(SOURCE, matrix), rtol=0, atol=1e-10)
    assert int(estimate.degrees_of_freedom) == 72
    assert np.linalg.matrix_rank(estimate.covariance / np.outer(d := np.sqrt(np.diag(estimate.covariance)), d)) == 8
    # In OpenCV's gauge, h33 = 1: where a point goes is as certain in both.
    point = np.array([321.0, 100.0])

    def seen(entries, points):
        image = jnp.concatenate([points, jnp.ones((len(points), 1))], axis=1) @ jnp.append(entries, 1.0).reshape(3, 3).T
        return (image[:, :2] / image[:, 2:]).ravel()

    by_entries = jax.jacfwd(seen)
    slopes = by_entries(best.x, SOURCE) * np.sqrt(np.repeat(weights, 2))[:, None]
    there = by_entries(best.x, point[None])
    expected = there @ np.linalg.inv(slopes.T @ slopes) @ there.T * loss / 72
    np.testing.assert_allclose(estimate.point_covariance(point), expected, rtol=1e-6)


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_measurements(x64):
    noise = np.random.default_rng(2).normal(size=(2000, 40, 2))
    estimates = jax.jit(jax.vmap(lambda noise: estimate_homography(SOURCE, image(SOURCE) + noise)))(noise)
    assert bool((estimates.status == EstimateStatus.CONVERGED).all())
    spread = np.std(estimates.homography.matrix, axis=0)
    claimed = np.sqrt(np.mean(estimates.standard_errors**2, axis=0))
    # Each spread is known to one part in √4000.
    np.testing.assert_allclose(claimed, spread, rtol=4 / np.sqrt(4000))
    np.testing.assert_allclose(np.mean(estimates.rms**2), 2 * 72 / 80, rtol=0.01)


@pytest.mark.parametrize("kind", ["affine", "similarity", "isometry"])
def test_simpler_maps(x64, kind):
    """Exact ones are found; noisy ones have the least loss, as scipy finds it from the answer."""
    maps = {
        "affine": Homography.affine([[1.3, 0.2], [-0.4, 0.8]], [30.0, -5.0]),
        "similarity": Homography.similarity(1.7, 2.8, [30.0, -5.0]),
        "isometry": Homography.isometry(-2.1, [30.0, -5.0]),
    }
    weights = np.random.default_rng(3).uniform(0.2, 2, 40)
    weights[4] = 0
    exact = np.array(maps[kind](SOURCE))
    exact[4] = np.nan
    estimate = estimate_homography(SOURCE, exact, weights=weights, kind=kind)
    np.testing.assert_allclose(estimate.homography.matrix, maps[kind].matrix, rtol=0, atol=1e-11)
    assert estimate.residuals[4].tolist() == [0, 0]
    target = exact + 3 * NOISE
    estimate = estimate_homography(SOURCE, target, weights=weights, kind=kind)
    build = {
        "affine": lambda v: Homography.affine(v[:4].reshape(2, 2), v[4:]),
        "similarity": lambda v: Homography.similarity(v[0], v[1], v[2:]),
        "isometry": lambda v: Homography.isometry(v[0], v[1:]),
    }[kind]
    start = {"affine": [1, 0, 0, 1, 0, 0], "similarity": [1, 2.5, 0, 0], "isometry": [-2, 0, 0]}[kind]
    used = np.arange(40) != 4

    def rows(values):
        difference = target - np.asarray(build(jnp.asarray(values))(SOURCE))
        return (np.sqrt(weights)[:, None] * difference)[used].ravel()

    best = least_squares(rows, np.array(start, float), x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(estimate.homography.matrix, build(jnp.asarray(best.x)).matrix, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(estimate.rms, np.sqrt(2 * best.cost / weights.sum()), rtol=1e-10)
    assert int(estimate.degrees_of_freedom) == 78 - len(start)


@pytest.mark.slow
@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_derivatives(x64, shift):
    """At the identity, where the fit is exact, and at a noisy homography: against differences of whole fits."""
    source = jnp.asarray([*SQUARE.tolist(), [0.5, 0.4], [0.2, 0.9]])
    target = source + shift * jnp.asarray(0.1 * NOISE[:6])
    change = jnp.asarray(np.random.default_rng(4).normal(size=(6, 2)))

    @jax.jit
    def found(source, target):
        return estimate_homography(source, target).homography.matrix

    _, forward = jax.jvp(found, (source, target), (change, change[::-1]))
    step = 1e-4  # where what the iteration leaves, some 1e-10 over the step, and the third derivative's part are alike
    differences = (
        found(source + step * change, target + step * change[::-1])
        - found(source - step * change, target - step * change[::-1])
    ) / (2 * step)
    np.testing.assert_allclose(forward, differences, rtol=0, atol=1e-6 * np.abs(differences).max())
    cotangent = jnp.asarray(np.random.default_rng(5).normal(size=(3, 3)))
    by_source, by_target = jax.vjp(found, source, target)[1](cotangent)
    np.testing.assert_allclose(
        jnp.sum(by_source * change) + jnp.sum(by_target * change[::-1]), jnp.sum(cotangent * forward), rtol=1e-9
    )


def test_single_precision():
    estimate = estimate_homography(np.float32(SOURCE), np.float32(observed(0.0)))
    assert estimate.homography.matrix.dtype == estimate.covariance.dtype == np.float32
    assert float(estimate.rms) < 1e-3


def test_an_origin_at_infinity_is_nothing_special(x64):
    """A road seen to the horizon, with the origin of the picture on it: h33 = 0, by which OpenCV would divide."""
    road = Homography([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    source = np.array([[-1.0, 1.0], [1.0, 1.0], [3.0, 4.0], [-2.0, 5.0], [0.3, 2.0]])
    estimate = estimate_homography(source, road(source))
    np.testing.assert_allclose(estimate.homography(source), road(source), rtol=0, atol=1e-12)
    np.testing.assert_allclose(estimate.homography.matrix[2, 2], 0, atol=1e-12)


LINE = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [5.0, 5.0]])


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        (LINE, SQUARE, "collinear points: all of the 4 source"),
        (SQUARE, LINE, "collinear points: all of the 4 target"),
        (np.array([[0, 0], [1, 1], [2, 2], [0, 1.0]]), SQUARE, "collinear points: all but one .* of the 4 source"),
        (SQUARE[[0, 0, 1, 2]], SQUARE, "all but one .* of the 4 source"),
        (SQUARE, np.array([[0, 1], [3, 4], [5, 5], [6, 7.0]]), "all but one .* of the 4 target"),
        (np.concatenate([LINE, [[0.0, 3.0], [0.0, 3.0]]]), SOURCE[:6], "all but one .* of the 6 source"),
        (1e5 + LINE / 3, SQUARE, "collinear points: all of the 4 source"),
        (SQUARE * 0 + 1, SQUARE, "coincident points: no two different ones of the 4 source"),
        (SQUARE[:3], SQUARE[:3], "too few points: 3 .* needs 4"),
        (SQUARE, SQUARE[[0, 2, 1, 3]], "in the right order"),
    ],
)
def test_degenerate_configurations(x64, source, target, message):
    with pytest.raises(ValueError, match=message):
        estimate_homography(source, target)
    status = jax.jit(lambda s, t: estimate_homography(s, t).status)(source, target)
    assert int(status) == EstimateStatus.DEGENERATE


@pytest.mark.parametrize(
    ("kind", "source", "message"),
    [
        ("affine", LINE, "collinear points: all"),
        ("affine", SQUARE[:2], "needs 3"),
        ("similarity", SQUARE[:1], "needs 2"),
        ("isometry", SQUARE[[1, 1]], "coincident points"),
    ],
)
def test_degenerate_configurations_of_simpler_maps(x64, kind, source, message):
    with pytest.raises(ValueError, match=message):
        estimate_homography(source, source, kind=kind)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "euclidean"}, "kind must be one of projective, affine, similarity, isometry, got 'euclidean'"),
        ({"target": SQUARE}, r"both have shape \(N, 2\)"),
        ({"source": np.zeros((2, 40, 2)), "target": np.zeros((2, 40, 2))}, "for a batch use jax.vmap"),
        ({"weights": np.full(40, np.nan)}, "finite and not negative"),
        ({"weights": np.zeros(40)}, "too few points: 0"),
        ({"source": SOURCE * np.nan}, r"source\[0\] is not finite"),
    ],
)
@pytest.mark.usefixtures("untyped")
def test_misuse(x64, arguments, message):
    with pytest.raises(ValueError, match=message):
        estimate_homography(**({"source": SOURCE, "target": SOURCE} | arguments))


EASTINGS = np.array([[396388.56, 5782566.0], [396477.0, 5782564.0], [396475.0, 5782467.5], [396386.56, 5782469.5]])
AERIAL = np.array([[0.0, 0.0], [22991.0, 0.0], [22991.0, 25094.0], [0.0, 25094.0]])


@pytest.mark.parametrize("turned", [False, True])
def test_coordinates_of_a_map_need_double_precision(turned):
    """Five million metres north of the origin, single precision knows places to a quarter of a metre: 7 pixels here."""
    source, target = (AERIAL, EASTINGS) if turned else (EASTINGS, AERIAL)
    with pytest.raises(ValueError, match="Subtract an origin first"):
        estimate_homography(source, target)
    near = EASTINGS - EASTINGS.mean(axis=0).round()
    source, target = (AERIAL, near) if turned else (near, AERIAL)
    error = jnp.max(jnp.abs(estimate_homography(source, target).homography(source) - target))
    assert float(error) < (1e-4 if turned else 0.03)
    with jax.enable_x64(True):
        source, target = (AERIAL, EASTINGS) if turned else (EASTINGS, AERIAL)
        error = jnp.max(jnp.abs(estimate_homography(source, target).homography(source) - target))
        assert float(error) < 1e-5
