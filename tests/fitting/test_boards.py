"""Calibration from boards: OpenCV and SciPy beside it, exact views, honest errors, held-out views, poses, failures."""

import re
import warnings

import cv2
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxlens as jl
from jaxlens.fitting import Boards, FitError, FitStatus, FitWarning, Poses, calibrate, validate
from jaxlens.fitting._poses import rotation_matrix, rotation_vector

SIZE = (640, 480)
to_matrix, to_vector = jax.jit(rotation_matrix), jax.jit(rotation_vector)
BOARD = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2)
CAMERA = np.array([[540.0, 0, 322], [0, 536, 236], [0, 0, 1]])
DISTORTION = np.array([-0.28, 0.1, 1e-3, -5e-4, 0.05])
TRUTH = np.array([540, 536, 322, 236, *DISTORTION])
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
NOISE = 0.2
VIEWS = 10


@pytest.fixture
def unchecked():
    """Leaves misuse to the functions themselves, as it is for users, who run without jaxtyping's hook."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


def _poses(seed, views=VIEWS, tilt=0.45):
    """Rotation vectors and translations `(views, 6)`, the board's middle near the optical axis."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(views):
        vector = np.array([*random.uniform(-tilt, tilt, 2), random.uniform(-0.3, 0.3)])
        middle = np.array([*random.uniform([-1.2, -0.8], [1.2, 0.8]), random.uniform(9, 14)])
        found.append([*vector, *(middle - cv2.Rodrigues(vector)[0] @ [4, 2.5, 0])])
    return np.array(found)


def _project(pose, camera=CAMERA, distortion=DISTORTION):
    """OpenCV's image points `(54, 2)`, and their derivatives by pose, focal lengths, centre, coefficients."""
    corners = np.column_stack([BOARD, np.zeros(len(BOARD))])
    points, jacobian = cv2.projectPoints(corners, pose[:3], pose[3:], np.asarray(camera), np.asarray(distortion))
    return points[:, 0], jacobian


def _views(poses, distortion=DISTORTION):
    return np.stack([_project(pose, distortion=distortion)[0] for pose in poses])


POSES = _poses(0)
EXACT = _views(POSES)


def _noisy(exact, seed, noise=NOISE):
    """Rounded to single precision, which is all that OpenCV takes."""
    return (exact + noise * np.random.default_rng(seed).normal(size=exact.shape)).astype(np.float32).astype(float)


NOISY = _noisy(EXACT, 0)


def _calibrate(boards, **keywords):
    """The calibration that nearly all tests share, so that it is compiled once."""
    return calibrate(jl.BrownConrady(np.zeros(5)), boards, SIZE, **keywords)


def _opencv(pairs, flags=0):
    """OpenCV's: rms, the nine parameters, their standard errors, poses `(V, 6)`, rms by view."""
    board = [np.column_stack([board, np.zeros(len(board))]).astype(np.float32) for board, _ in pairs]
    seen = [seen.astype(np.float32) for _, seen in pairs]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-14)
    rms, camera, distortion, rotations, translations, errors, _, views = cv2.calibrateCameraExtended(
        board, seen, SIZE, None, None, flags=flags, criteria=criteria
    )
    # OpenCV 4 gives tuples of (3, 1), OpenCV 5 an array; the standard errors have places for 14 coefficients or more.
    poses = np.column_stack([np.reshape(rotations, (-1, 3)), np.reshape(translations, (-1, 3))])
    values = np.array([camera[0, 0], camera[1, 1], camera[0, 2], camera[1, 2], *np.ravel(distortion)[:5]])
    return rms, values, np.ravel(errors)[:9], poses, np.ravel(views)


def _vectors(poses):
    return np.concatenate([poses.rotation_vectors, poses.translations], axis=-1)


def _assert_as_opencv(fit, pairs):
    rms, values, errors, poses, views = _opencv(pairs)
    assert fit.names == NAMES
    assert int(fit.status) == FitStatus.CONVERGED
    assert float(fit.rms) == pytest.approx(rms, abs=1e-10)
    assert np.max(np.abs(np.asarray(fit.values) - values) / errors) < 1e-4
    np.testing.assert_allclose(fit.standard_errors, errors, rtol=1e-6)
    np.testing.assert_allclose(fit.per_view_rms, views, rtol=0, atol=1e-7)
    np.testing.assert_allclose(_vectors(fit.poses), poses, rtol=0, atol=1e-6)


def _distance(fit, other):
    """The largest difference in standard errors."""
    return np.max(np.abs(np.asarray(fit.values) - np.asarray(other.values)) / np.asarray(other.standard_errors))


def _cosines(fit, seen, distortion):
    """Between the residuals and each column of the Jacobian, both by OpenCV; zero at a minimum.

    The first four are of fx, fy, cx, cy, then those of the coefficients, then those of the poses.
    """
    shared, own, residuals = [], [], []
    for pose, view in zip(_vectors(fit.poses), seen, strict=True):
        points, jacobian = _project(pose, fit.camera_matrix, distortion)
        own.append(jacobian[:, :6])
        shared.append(jacobian[:, 6:])
        residuals.append((view - points).ravel())
    shared, residual = np.concatenate(shared), np.concatenate(residuals)
    by_shared = residual @ shared / np.linalg.norm(shared, axis=0) / np.linalg.norm(residual)
    by_pose = [part @ rows / np.linalg.norm(rows, axis=0) for part, rows in zip(residuals, own, strict=True)]
    return by_shared, np.array(by_pose) / np.linalg.norm(residual)


# --- against OpenCV ---------------------------------------------------------------------------------------------------


def test_agrees_with_opencv(x64):
    fit = _calibrate(Boards(BOARD, NOISY))
    _assert_as_opencv(fit, [(BOARD, view) for view in NOISY])
    assert int(fit.degrees_of_freedom) == 2 * VIEWS * 54 - 9 - 6 * VIEWS
    assert fit.residuals.shape == (VIEWS, 54, 2)
    assert float(fit.rms) == pytest.approx(np.sqrt(np.mean(np.sum(np.asarray(fit.residuals) ** 2, -1))), rel=1e-13)
    predicted = np.stack([_project(pose, fit.camera_matrix, fit.values[4:])[0] for pose in _vectors(fit.poses)])
    np.testing.assert_allclose(fit.residuals, NOISY - predicted, rtol=0, atol=1e-9)
    assert np.max(np.abs(np.asarray(fit.values) - TRUTH) / np.asarray(fit.standard_errors)) < 3
    assert not bool(fit.folds)
    assert not fit.unidentified.any()


def test_missing_corners_agree_with_opencv(x64):
    """The same views with NaN, with weight zero, and as a list with corners of their own."""
    missing = np.random.default_rng(1).uniform(size=(VIEWS, 54)) < 0.3
    missing[0] = False  # the longest view has all corners, and the list the same shape
    pairs = [(BOARD[~gaps], view[~gaps]) for view, gaps in zip(NOISY, missing, strict=True)]
    as_nan = _calibrate(Boards(BOARD, np.where(missing[..., None], np.nan, NOISY)))
    _assert_as_opencv(as_nan, pairs)
    assert int(as_nan.degrees_of_freedom) == 2 * np.sum(~missing) - 9 - 6 * VIEWS
    assert np.all(np.asarray(as_nan.residuals)[missing] == 0)
    as_list = _calibrate(pairs)
    as_weights = _calibrate(Boards(BOARD, NOISY, weights=(~missing).astype(float)))
    for other in (as_list, as_weights):
        np.testing.assert_allclose(other.values, as_nan.values, rtol=1e-8)
        np.testing.assert_allclose(other.covariance, as_nan.covariance, rtol=1e-6)
        np.testing.assert_allclose(other.per_view_rms, as_nan.per_view_rms, rtol=1e-9)


def test_weights_repeat_corners(x64):
    twice = np.random.default_rng(2).integers(0, 2, (VIEWS, 54)).astype(bool)
    fit = _calibrate(Boards(BOARD, NOISY, weights=1.0 + twice))
    pairs = [
        (np.concatenate([BOARD, BOARD[more]]), np.concatenate([view, view[more]]))
        for view, more in zip(NOISY, twice, strict=True)
    ]
    rms, values, errors, _, views = _opencv(pairs)
    assert np.max(np.abs(np.asarray(fit.values) - values) / errors) < 1e-4
    assert float(fit.rms) == pytest.approx(rms, abs=1e-10)
    np.testing.assert_allclose(fit.per_view_rms, views, rtol=0, atol=1e-7)
    # Inverse variances count up to a common factor.
    scaled = _calibrate(Boards(BOARD, NOISY, weights=7.0 * (1.0 + twice)))
    np.testing.assert_allclose(scaled.values, fit.values, rtol=1e-8)
    np.testing.assert_allclose(scaled.standard_errors, fit.standard_errors, rtol=1e-6)


# --- recovery ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_exact_views_give_the_camera_back(x64, seed):
    poses = _poses(seed)
    fit = _calibrate(Boards(BOARD, _views(poses)))
    assert int(fit.status) == FitStatus.CONVERGED
    np.testing.assert_allclose(fit.values, TRUTH, rtol=0, atol=1e-9)
    np.testing.assert_allclose(_vectors(fit.poses), poses, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.camera_matrix, CAMERA, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.lens.coefficients, DISTORTION, rtol=0, atol=1e-9)
    assert float(fit.rms) < 1e-10


@pytest.mark.parametrize(
    ("start", "truth", "names"),
    [
        (jl.RadialPolynomial([0.0, 0.0]), jl.RadialPolynomial([-0.25, 0.08]), ("kappa1", "kappa2")),
        (jl.Division(0.0), jl.Division(0.3), ("k",)),
    ],
    ids=["polynomial", "division"],
)
@pytest.mark.slow
def test_other_lenses(x64, start, truth, names):
    start, truth = jax.tree.map(lambda leaf: leaf.astype(float), (start, truth))
    frame = jl.Frame.from_camera_matrix(CAMERA)
    poses = Poses(jnp.asarray(POSES[:, :3]), jnp.asarray(POSES[:, 3:]))
    board = jnp.broadcast_to(jnp.asarray(BOARD), (VIEWS, 54, 2))
    exact = np.asarray(frame.denormalize(truth.distort(poses.project(board))))
    fit = calibrate(start, Boards(BOARD, exact), SIZE)
    assert fit.names == ("fx", "fy", "cx", "cy", *names)
    for found, expected in zip(jax.tree.leaves(fit.lens), jax.tree.leaves(truth), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(fit.camera_matrix, CAMERA, rtol=0, atol=1e-8)
    np.testing.assert_allclose(_vectors(fit.poses), POSES, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_single_precision():
    """The same data as OpenCV's test; what is lost is a small part of the noise."""
    fit = _calibrate(Boards(BOARD.astype(np.float32), NOISY.astype(np.float32)))
    _, values, errors, _, _ = _opencv([(BOARD, view) for view in NOISY])
    assert fit.values.dtype == np.float32
    assert int(fit.status) == FitStatus.CONVERGED
    assert np.max(np.abs(np.asarray(fit.values) - values) / errors) < 0.05
    np.testing.assert_allclose(fit.standard_errors, errors, rtol=0.01)


@pytest.mark.slow
def test_a_robust_loss_sees_past_misplaced_corners(x64):
    random = np.random.default_rng(3)
    bad = random.uniform(size=(VIEWS, 54)) < 0.05
    seen = NOISY + np.where(bad[..., None], random.choice([-20, 20], (VIEWS, 54, 2)), 0)
    fit = _calibrate(Boards(BOARD, seen), loss="cauchy")
    clean = _calibrate(Boards(BOARD, NOISY))
    scores = (np.asarray(fit.values) - TRUTH) / np.asarray(fit.standard_errors)
    assert np.abs(scores).max() < 3
    assert np.all(np.asarray(fit.standard_errors) < 1.2 * np.asarray(clean.standard_errors))
    plain = _calibrate(Boards(BOARD, seen))
    assert np.all(np.asarray(plain.standard_errors) > 5 * np.asarray(clean.standard_errors))


# --- uncertainty ------------------------------------------------------------------------------------------------------

SEEDS = 200


@pytest.mark.slow
def test_standard_errors_are_those_of_repeated_noise(x64):
    """Two hundred calibrations at once; each also agrees with the one alone."""
    noise = np.random.default_rng(4).normal(size=(SEEDS, *EXACT.shape))
    boards = jax.vmap(lambda seen: Boards(BOARD, seen))(jnp.asarray(EXACT + NOISE * noise))
    fits = jax.vmap(_calibrate)(boards)
    assert np.all(np.asarray(fits.status) == FitStatus.CONVERGED)
    errors = np.asarray(jax.vmap(lambda fit: fit.standard_errors)(fits))
    scores = (np.asarray(fits.values) - TRUTH) / errors
    # 200 fits know a spread to 5 %, and the mean of the scores to 0.07.
    np.testing.assert_allclose(np.sqrt(np.mean(scores**2, axis=0)), 1, atol=0.2)
    assert np.abs(scores.mean(axis=0)).max() < 0.3
    # So they do together: the squared Mahalanobis distance has as many degrees of freedom as there are parameters.
    difference = np.asarray(fits.values) - TRUTH
    distances = np.einsum("si,sij,sj->s", difference, np.linalg.inv(np.asarray(fits.covariance)), difference)
    assert distances.mean() == pytest.approx(9, abs=4 * np.sqrt(18 / SEEDS))
    # The residuals tell the noise.
    squares = 54 * VIEWS * np.asarray(fits.rms) ** 2 / int(fits.degrees_of_freedom[0])
    assert np.sqrt(squares.mean()) == pytest.approx(NOISE, rel=0.01)
    for seed in (0, 77):
        alone = _calibrate(Boards(BOARD, EXACT + NOISE * noise[seed]))
        np.testing.assert_allclose(fits.values[seed], alone.values, rtol=1e-8)
        np.testing.assert_allclose(fits.covariance[seed], alone.covariance, rtol=1e-5)


def test_derivatives_by_what_was_observed(x64):
    """By the implicit function theorem, against calibrations of views a little different."""
    direction = np.random.default_rng(5).normal(size=EXACT.shape)

    def values(seen):
        return _calibrate(Boards(BOARD, seen), throw=False).values

    slope = jax.jit(lambda seen: jax.jvp(values, (seen,), (jnp.asarray(direction),))[1])(jnp.asarray(NOISY))
    step = 1e-2
    differences = (values(NOISY + step * direction) - values(NOISY - step * direction)) / (2 * step)
    errors = np.asarray(_calibrate(Boards(BOARD, NOISY)).standard_errors)
    np.testing.assert_allclose(np.asarray(slope) / errors, np.asarray(differences) / errors, rtol=0, atol=1e-4)


# --- fixed parameters, bounds, starts ---------------------------------------------------------------------------------


def _calibrate_about(focal_length, coefficients):
    start = np.array([[focal_length, 0, 320], [0, focal_length, 240], [0, 0, 1]])
    boards = Boards(BOARD, NOISY)
    return calibrate(jl.BrownConrady(coefficients), boards, SIZE, camera_matrix=start, fixed=("cx", "cy"))


@pytest.mark.slow
def test_a_fixed_center_and_a_camera_to_start_from(x64):
    """What is fixed stays where it was; near or far, with the lens or without it, the minimum is the same."""
    fit = _calibrate_about(540.0, DISTORTION)
    assert fit.names == ("fx", "fy", "k1", "k2", "p1", "p2", "k3")
    assert fit.frame.center.tolist() == [320.0, 240.0]
    assert int(fit.degrees_of_freedom) == 2 * VIEWS * 54 - 7 - 6 * VIEWS
    by_shared, by_pose = _cosines(fit, NOISY, fit.lens.coefficients)
    assert np.abs(by_pose).max() < 1e-7
    assert np.abs(by_shared[[0, 1, 4, 5, 6, 7, 8]]).max() < 1e-7
    assert np.abs(by_shared[2:4]).max() > 1e-3
    assert _distance(_calibrate_about(400.0, np.zeros(5)), fit) < 1e-4
    assert _distance(_calibrate_about(800.0, np.array([0.1, 0, 0, 0, 0])), fit) < 1e-4


@pytest.mark.slow
def test_bounds(x64):
    """A bound that holds is reached, and all else is at its minimum given that; one that does not changes nothing."""

    def bounded(low, high):
        return _calibrate(Boards(BOARD, NOISY), bounds={"fx": (low, high)})

    fit = bounded(545.0, 700.0)
    assert float(fit.parameters["fx"]) == 545.0
    by_shared, by_pose = _cosines(fit, NOISY, fit.lens.coefficients)
    assert np.abs(by_pose).max() < 1e-7
    assert np.abs(by_shared[1:]).max() < 1e-7
    assert by_shared[0] < -1e-3
    reference = _calibrate(Boards(BOARD, NOISY))
    free = bounded(500.0, 700.0)
    assert _distance(free, reference) < 1e-4


# --- views not seen ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_held_out_views(x64):
    fit = _calibrate(Boards(BOARD, NOISY))
    poses = _poses(7, 12)
    exact = _views(poses)
    lens, frame = jl.BrownConrady(DISTORTION), jl.Frame.from_camera_matrix(CAMERA)
    # With the true camera the poses of exact views are exact.
    known = validate(lens, frame, Boards(BOARD, exact))
    np.testing.assert_allclose(_vectors(known.poses), poses, rtol=0, atol=1e-9)
    assert float(known.rms) < 1e-9
    assert np.all(np.asarray(known.status) == FitStatus.CONVERGED)
    # With noise they are OpenCV's, and what is left is the noise less what the poses take of it.
    seen = _noisy(exact, 8)
    held = validate(lens, frame, Boards(BOARD, seen))
    corners = np.column_stack([BOARD, np.zeros(54)])
    for view in range(12):
        _, rotation, translation = cv2.solvePnP(corners, seen[view], CAMERA, DISTORTION)
        rotation, translation = cv2.solvePnPRefineLM(
            corners,
            seen[view],
            CAMERA,
            DISTORTION,
            rotation,
            translation,
            (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-14),
        )
        pose = np.concatenate([np.ravel(rotation), np.ravel(translation)])
        np.testing.assert_allclose(_vectors(held.poses)[view], pose, rtol=0, atol=1e-5)
        residuals = seen[view] - _project(pose)[0]
        np.testing.assert_allclose(held.residuals[view], residuals, rtol=0, atol=1e-4)
        assert float(held.per_view_rms[view]) == pytest.approx(np.sqrt(np.mean(np.sum(residuals**2, -1))), abs=1e-8)
    expected = NOISE * np.sqrt(2 - 6 / 54)
    assert float(held.rms) == pytest.approx(expected, rel=4 / np.sqrt(2 * 12 * (108 - 6)))
    assert float(held.rms) == pytest.approx(np.sqrt(np.mean(np.square(held.per_view_rms))), rel=1e-12)
    # The fitted camera does nearly as well on them as the true one.
    fitted = validate(fit.lens, fit.frame, Boards(BOARD, seen))
    assert 1 - 1e-3 < float(fitted.rms / held.rms) < 1.02
    # A view of three corners cannot be judged, and does not disturb the others.
    gaps = seen.copy()
    gaps[3, 3:] = np.nan
    some = validate(lens, frame, Boards(BOARD, gaps))
    assert some.status.tolist() == [FitStatus.TOO_FEW if view == 3 else FitStatus.CONVERGED for view in range(12)]
    others = np.arange(12) != 3
    np.testing.assert_allclose(some.per_view_rms[others], held.per_view_rms[others], rtol=1e-9)


# --- failures ---------------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:the fitted lens folds over:jaxlens.fitting.FitWarning")
@pytest.mark.parametrize("noise", [0.0, 0.01, NOISE])
def test_parallel_boards_are_rank_deficient(x64, noise):
    """Frontal views at different distances, turned in their plane: distance is traded for focal length."""
    poses = np.array([[0, 0, 0.1 * i, -4 + 0.2 * i, -2.5, 9 + 0.5 * i] for i in range(VIEWS)])
    boards = Boards(BOARD, _noisy(_views(poses), 9, noise))
    assert int(_calibrate(boards, throw=False).status) == FitStatus.RANK_DEFICIENT
    with pytest.raises(FitError, match=r"the data do not determine .*fx.*show the board at more angles"):
        _calibrate(boards)


def test_too_many_coefficients_are_not_identified(x64):
    lens = jl.BrownConrady(np.zeros(8))
    # So far from any real lens, whether it folds over in the picture's last corner is up to rounding.
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always", FitWarning)
        fit = calibrate(lens, Boards(BOARD, NOISY), SIZE)
    assert re.search("k1, k2.* are not identified", str(seen[0].message))
    by_name = dict(zip(fit.names, np.asarray(fit.unidentified), strict=True))
    assert by_name["k1"]
    assert by_name["k4"]
    assert not any(by_name[name] for name in ("fx", "fy", "cx", "cy", "p1", "p2"))
    assert float(fit.rms) <= float(_calibrate(Boards(BOARD, NOISY)).rms)


@pytest.mark.slow
def test_views_without_weight_might_as_well_not_be_there(x64):
    """Under `jax.jit` it is known late that a view has no corners; so views are held out by one program."""
    keep = np.arange(VIEWS) % 3 != 1
    weights = np.ones(NOISY.shape[:2]) * keep[:, None]
    fit = jax.jit(lambda weights: _calibrate(Boards(BOARD, NOISY, weights=weights), throw=False))(weights)
    alone = _calibrate(Boards(BOARD, NOISY[keep]))
    assert int(fit.status) == FitStatus.CONVERGED
    assert int(fit.degrees_of_freedom) == int(alone.degrees_of_freedom)
    errors = np.asarray(alone.standard_errors)
    np.testing.assert_allclose(np.asarray(fit.values) / errors, np.asarray(alone.values) / errors, rtol=0, atol=1e-4)
    np.testing.assert_allclose(fit.standard_errors, errors, rtol=1e-5)


def test_a_view_of_three_corners(x64):
    seen = NOISY.copy()
    seen[2, 3:] = np.nan
    with pytest.raises(ValueError, match="view 2 has 3 corners; at least 4"):
        _calibrate(Boards(BOARD, seen))


def test_too_few_views(x64):
    with pytest.raises(ValueError, match="1 view of a plane cannot determine fx, fy, cx, cy"):
        _calibrate(Boards(BOARD, NOISY[:1]))
    with pytest.raises(ValueError, match=r"too few corners: 16 equations for 9 parameters .* and 12 more"):
        _calibrate(Boards(BOARD[:4], NOISY[:2, :4]))


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"fixed": ("k6",)}, "cannot fix 'k6': the parameters are fx, fy, cx, cy, k1, k2, p1, p2, k3"),
        ({"bounds": {"kappa1": (0.0, 1.0)}}, "bounds are given for 'kappa1', which is not fitted"),
        ({"bounds": {"fx": (600.0, 500.0)}}, r"bounds of fx must be \(smallest, largest\)"),
        ({"fixed": ("cx",), "bounds": {"cx": (0.0, 1.0)}}, "bounds are given for 'cx', which is not fitted"),
        ({"loss": "tukey"}, "loss must be one of linear, huber, cauchy"),
        ({"free": jl.Division(0.0)}, "`free` must have the structure of what is fitted"),
        ({"camera_matrix": np.eye(4)[:3]}, r"a camera matrix has shape \(3, 3\), got \(3, 4\)"),
    ],
)
def test_arguments_that_do_not_fit(x64, unchecked, keywords, message):
    with pytest.raises(ValueError, match=message):
        _calibrate(Boards(BOARD, NOISY), **keywords)


@pytest.mark.parametrize(
    ("points", "observed", "message"),
    [
        (BOARD[:53], NOISY, r"got \(53, 2\) and \(10, 54, 2\)"),
        (BOARD, NOISY[0], r"got \(54, 2\) and \(54, 2\)"),
        (BOARD[0], NOISY, r"got \(2,\) and \(10, 54, 2\)"),
        (np.broadcast_to(BOARD, (9, 54, 2)), NOISY, r"as many views .* got \(9, 54, 2\) and \(10, 54, 2\)"),
        (BOARD, NOISY[..., 0], r"points must have shape \(\.\.\., 2\)"),
    ],
)
def test_shapes_that_do_not_fit(x64, unchecked, points, observed, message):
    with pytest.raises(ValueError, match=message):
        Boards(points, observed)


def test_lists_that_do_not_fit(x64):
    with pytest.raises(ValueError, match="no views"):
        Boards.from_views([])
    with pytest.raises(ValueError, match="view 1 needs as many board points as image points"):
        Boards.from_views([(BOARD, NOISY[0]), (BOARD, NOISY[1, :53])])
    with pytest.raises(ValueError, match="weights must be finite and not negative, got -1"):
        Boards(BOARD, NOISY, weights=np.full((VIEWS, 54), -1.0))


def test_boards_of_views_of_their_own(x64):
    boards = Boards.from_views([(BOARD[:7], NOISY[0, :7]), (BOARD[10:15], NOISY[1, 10:15])])
    assert boards.points.shape == boards.observed.shape == (2, 7, 2)
    assert boards.weights.tolist() == [[1.0] * 7, [1.0] * 5 + [0.0] * 2]
    np.testing.assert_array_equal(boards.points[1, :5], BOARD[10:15])
    np.testing.assert_array_equal(boards.observed[1, :5], NOISY[1, 10:15])
    second = boards.view(np.array([1]))
    np.testing.assert_array_equal(second.observed, boards.observed[1:])
    np.testing.assert_array_equal(boards.view(np.array([False, True])).weights, boards.weights[1:])


# --- poses ------------------------------------------------------------------------------------------------------------

AXES = np.random.default_rng(10).normal(size=(40, 3))
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
ANGLES = [0.0, 1e-12, 1e-8, 1e-4, 0.009, 0.0099, 0.0101, 0.02, 0.5, 1.5, 3.0, np.pi - 1e-4, np.pi - 1e-9]


@pytest.mark.parametrize("angle", ANGLES)
def test_rotation_matrix_is_opencv_s_and_scipy_s(x64, angle):
    vectors = angle * AXES
    found = np.asarray(to_matrix(vectors))
    np.testing.assert_allclose(found, Rotation.from_rotvec(vectors).as_matrix(), rtol=0, atol=2e-15)
    for vector, matrix in zip(vectors, found, strict=True):
        np.testing.assert_allclose(matrix, cv2.Rodrigues(vector)[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(found @ np.swapaxes(found, 1, 2), np.broadcast_to(np.eye(3), found.shape), atol=4e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_rotation_vector_round_trip(x64, angle):
    vectors = angle * AXES
    matrices = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(to_vector(jnp.asarray(matrices)), vectors, rtol=0, atol=1e-14)
    np.testing.assert_allclose(to_vector(to_matrix(vectors)), vectors, rtol=0, atol=1e-14)


def test_rotation_vector_at_half_a_turn(x64):
    """The sign of the axis is free there; the matrix is not."""
    for axis in (*np.eye(3), *AXES):
        matrix = 2 * np.outer(axis, axis) - np.eye(3)
        vector = np.asarray(to_vector(jnp.asarray(matrix)))
        np.testing.assert_allclose(np.linalg.norm(vector), np.pi, rtol=1e-15)
        np.testing.assert_allclose(to_matrix(vector), matrix, rtol=0, atol=1e-14)


def test_rotations_in_single_precision():
    vectors = (AXES * np.linspace(0, 3.1, 40)[:, None]).astype(np.float32)
    matrices = to_matrix(vectors)
    assert matrices.dtype == np.float32
    np.testing.assert_allclose(matrices, Rotation.from_rotvec(vectors).as_matrix(), rtol=0, atol=1e-6)
    np.testing.assert_allclose(to_vector(matrices), vectors, rtol=0, atol=4e-6)


def test_derivatives_of_rotations(x64):
    """At zero they are the three generators; elsewhere OpenCV's."""
    generators = np.zeros((3, 3, 3))
    generators[2, 1, 0], generators[0, 2, 1], generators[1, 0, 2] = 1, 1, 1
    generators -= np.swapaxes(generators, 0, 1)
    derivative = jax.jit(jax.jacrev(rotation_matrix))
    np.testing.assert_array_equal(derivative(np.zeros(3)), generators)
    second = jax.jit(jax.hessian(lambda vector: rotation_matrix(vector)[0, 0]))(np.zeros(3))
    np.testing.assert_allclose(second, -np.diag([0.0, 1, 1]), atol=1e-15)
    for vector in (0.7 * AXES[0], 0.0101 * AXES[1], 0.0099 * AXES[2], 3 * AXES[3]):
        expected = cv2.Rodrigues(vector)[1].T.reshape(3, 3, 3)
        np.testing.assert_allclose(derivative(vector), expected, rtol=0, atol=1e-10)


def test_project_is_opencv_s(x64):
    poses = Poses(jnp.asarray(POSES[:, :3]), jnp.asarray(POSES[:, 3:]))
    found = poses.project(jnp.broadcast_to(jnp.asarray(BOARD), (VIEWS, 54, 2)))
    expected = np.stack([_project(pose, np.eye(3), np.zeros(4))[0] for pose in POSES])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    alone = Poses(jnp.asarray(POSES[0, :3]), jnp.asarray(POSES[0, 3:])).project(jnp.asarray(BOARD))
    np.testing.assert_allclose(alone, expected[0], rtol=0, atol=1e-14)
