"""What a calibration leaves unknown: long lenses, data that determine nothing, the uncertainty of projections."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.fitting import Boards, FitStatus, Poses, calibrate, rotation_matrix

BOARD = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2)
VIEWS = 12
LENS = jl.RadialPolynomial([-0.25, 0.08])


def _boards(turns, middles, camera, lens=LENS, *, spacing=1.0, noise=0.0, seed=0):
    """Views of a board whose middle stands at `middles`, turned by rotation vectors `turns`."""
    board = spacing * BOARD
    turned = np.asarray(rotation_matrix(jnp.asarray(turns))) @ [*(spacing * np.array([4, 2.5])), 0.0]
    poses = Poses(jnp.asarray(turns), jnp.asarray(middles - turned))
    ideal = poses.project(jnp.broadcast_to(jnp.asarray(board), (len(turns), *board.shape)))
    seen = np.asarray(camera.denormalize(lens.distort(ideal)))
    return Boards(board, seen + noise * np.random.default_rng(seed).normal(size=seen.shape))


def _calibrate(boards, size=(640, 480), **keywords):
    """One program for all: the size of the picture is an argument of it."""
    return calibrate(jl.RadialPolynomial(np.zeros(2)), boards, size, **keywords)


def _turns(random, most=0.45, about_z=0.3):
    return np.column_stack([random.uniform(-most, most, (VIEWS, 2)), random.uniform(-about_z, about_z, VIEWS)])


def _middles(random):
    return random.uniform([-2.2, -1.6, 9], [2.2, 1.6, 14], (VIEWS, 3))


CAMERA = ([322.0, 236.0], [540.0, 540.0])


@pytest.mark.parametrize("noise", [pytest.param(0.0, marks=pytest.mark.slow), 0.2])
def test_a_long_lens_is_determined(x64, noise):
    """Rotations of the boards make up for nearly any principal point; of use the camera is all the same."""
    random = np.random.default_rng(1)
    middles = np.column_stack([random.uniform(-2.5, 2.5, VIEWS), random.uniform(-2, 2, VIEWS), np.full(VIEWS, 100.0)])
    camera, lens = jl.Frame([2000.0, 1500.0], 22990.0), jl.RadialPolynomial([0.2, -18.0])
    boards = _boards(_turns(random, 0.6, 0.2), middles, camera, lens, spacing=1.2, noise=noise)
    fit = _calibrate(boards, (4000, 3000))
    assert fit.status == FitStatus.CONVERGED
    assert fit.problems() == []
    truth = np.array([22990, 22990, 2000, 1500, 0.2, -18])
    if noise:
        assert np.max(np.abs(np.asarray(fit.values) - truth) / np.asarray(fit.standard_errors)) < 3
        assert 5 < float(fit.standard_errors[2]) < 12
        assert float(fit.projection_uncertainty(jnp.array([2000.0, 1500.0]))) < 0.1
        assert float(fit.projection_uncertainty(jnp.zeros(2))) < 4
    else:
        np.testing.assert_allclose(fit.values, truth, rtol=1e-6)


@pytest.mark.filterwarnings("ignore::jaxlens.fitting.FitWarning")
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.2, 1.0])
@pytest.mark.parametrize("tilted", [False, True], ids=["frontal", "tilted"])
@pytest.mark.parametrize("lens", [LENS, jl.RadialPolynomial([0.0, 0.0])], ids=["barrel", "none"])
def test_one_rotation_in_twelve_views_determines_nothing(x64, lens, tilted, noise):
    random = np.random.default_rng(2)
    turns = np.tile([0.3, -0.2, 0.1], (VIEWS, 1)) if tilted else _turns(random, 0.0)
    boards = _boards(turns, _middles(random), jl.Frame(*CAMERA), lens, noise=noise)
    assert _calibrate(boards, throw=False).status == FitStatus.RANK_DEFICIENT


# --- projections ------------------------------------------------------------------------------------------------------

GRID = np.stack(np.meshgrid(np.linspace(0, 639, 14), np.linspace(0, 479, 11)), -1).reshape(-1, 2)
PIXELS = np.array([[319.5, 239.5], [100.0, 100.0], [0.0, 0.0], [639.0, 479.0], [320.0, 0.0]])


def _fitted(noise=0.2):
    random = np.random.default_rng(3)
    return _boards(_turns(random), _middles(random), jl.Frame(*CAMERA), noise=noise)


def _shifts(frame, lens, other_frame, other_lens):
    """How far another camera sees the rays of pixels, after the rotation that is best over the picture."""
    rays = lens.unproject(frame.normalize(GRID))

    def missed(turn):
        return other_frame.denormalize(other_lens.project(rays @ rotation_matrix(turn).T)) - GRID

    turn = jnp.zeros(3)
    for _ in range(2):
        slope = jax.jacfwd(missed)(turn).reshape(-1, 3)
        turn = turn - jnp.linalg.lstsq(slope, missed(turn).ravel())[0]
    rays = lens.unproject(frame.normalize(PIXELS)) @ rotation_matrix(turn).T
    return other_frame.denormalize(other_lens.project(rays)) - PIXELS


def _worst(shifts):
    """The root of the largest eigenvalue of the shifts' covariance, for each pixel."""
    covariance = np.einsum("nqi,nqj->qij", shifts, shifts) / len(shifts)
    return np.sqrt(np.linalg.eigvalsh(covariance)[:, -1])


@pytest.mark.slow
def test_the_uncertainty_is_the_spread_of_cameras_as_good(x64):
    """Cameras drawn from the covariance of a fit."""
    fit = _calibrate(_fitted())
    errors = np.linalg.cholesky(np.asarray(fit.covariance))
    draws = np.asarray(fit.values) + np.random.default_rng(4).normal(size=(2000, 6)) @ errors.T
    shifts = jax.jit(
        jax.vmap(lambda v: _shifts(fit.frame, fit.lens, jl.Frame(v[2:4], v[:2]), jl.RadialPolynomial(v[4:])))
    )(draws)
    expected = _worst(np.asarray(shifts))
    found = fit.projection_uncertainty(PIXELS)
    np.testing.assert_allclose(found, expected, rtol=0.06)
    assert found.shape == (5,)
    assert fit.projection_uncertainty(PIXELS[0]).shape == ()
    assert "a ray's place in the picture is known to" in fit.summary()


@pytest.mark.slow
def test_the_uncertainty_is_the_spread_of_calibrations(x64):
    exact = _fitted(0.0)
    noise = np.random.default_rng(5).normal(size=(200, *exact.observed.shape))
    fits = jax.vmap(lambda seen: _calibrate(Boards(BOARD, seen)))(exact.observed[None] + 0.2 * noise)
    frame = jl.Frame(*CAMERA)
    expected = _worst(np.asarray(jax.vmap(lambda fit: _shifts(frame, LENS, fit.frame, fit.lens))(fits)))
    found = jax.vmap(lambda fit: fit.projection_uncertainty(PIXELS))(fits)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(found), axis=0)), expected, rtol=0.1)


@pytest.mark.slow
def test_derivatives_of_the_uncertainty(x64):
    fit = _calibrate(_fitted())
    pixel, step = jnp.array([100.0, 60.0]), 1e-3
    slope = jax.grad(fit.projection_uncertainty)(pixel)
    differences = [
        (fit.projection_uncertainty(pixel + d) - fit.projection_uncertainty(pixel - d)) / (2 * step)
        for d in step * np.eye(2)
    ]
    np.testing.assert_allclose(slope, differences, rtol=1e-5)


def test_only_calibrations_know_a_camera(x64):
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 2))
    fit = jl.fitting.fit_points(jl.RadialPolynomial([0.0]), points, points)
    with pytest.raises(ValueError, match="only a calibration knows a camera"):
        fit.projection_uncertainty(points)


def test_corners_that_may_be_missing_stay_out(x64):
    """NaN in a corner does not reach the verdict."""
    boards = _fitted()
    seen = np.array(boards.observed)
    seen[:, ::5] = np.nan
    fit = _calibrate(Boards(BOARD, seen))
    assert fit.status == FitStatus.CONVERGED
    assert np.isfinite(fit.projection_uncertainty(PIXELS)).all()
