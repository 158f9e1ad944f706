"""Calibration of cameras that bend a board too much for a homography, or see past a right angle."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from jaxlens.fitting import Boards, FitStatus, Poses, calibrate, validate
from jaxlens.fitting._board_starts import poses_from_rays

# Compilation takes minutes: run by pytest -m slow; the contract of every lens is in test_contract.py.
pytestmark = pytest.mark.slow

BOARD = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2)
SIZE = (640, 480)
FRAME = ([322.0, 236.0], [180.0, 181.0])
TRUTH = jl.KannalaBrandt([0.03, -0.01, 0.003, -0.0005])


def _poses(views):
    """Boards about the camera, the middles as far as 75° from the axis, so that corners lie past 90°."""
    random = np.random.default_rng(0)
    aside, about = random.uniform(0.2, 1.3, views), random.uniform(0, 2 * np.pi, views)
    middles = np.stack([np.sin(aside) * np.cos(about), np.sin(aside) * np.sin(about), np.cos(aside)], -1)
    # Each faces the camera, then is turned somewhat.
    facing = np.cross([0.0, 0.0, 1.0], middles)
    facing *= (aside / np.linalg.norm(facing, axis=1))[:, None]
    turns = facing + random.uniform(-0.4, 0.4, (views, 3))
    turned = np.asarray(jl.fitting.rotation_matrix(jnp.asarray(turns))) @ [4.0, 2.5, 0.0]
    return Poses(jnp.asarray(turns), jnp.asarray(6 * middles - turned))


def _views(poses):
    places = poses.place(jnp.broadcast_to(jnp.asarray(BOARD), (poses.translations.shape[0], 54, 2)))
    seen = jl.Frame(*FRAME).denormalize(jl.KannalaBrandt(np.asarray(TRUTH.coefficients, float)).project(places))
    return np.asarray(seen), np.asarray(places)


def test_poses_come_from_rays(x64):
    poses = _poses(8)
    _, places = _views(poses)
    rays = places / np.linalg.norm(places, axis=-1, keepdims=True)
    weights = np.ones(rays.shape[:2])
    weights[:, ::7] = 0
    rays = np.where(weights[..., None] > 0, rays, np.array([0.0, 0.0, 1.0]))
    board = jnp.broadcast_to(jnp.asarray(BOARD), (8, 54, 2))
    found = jax.jit(poses_from_rays)(board, jnp.asarray(rays), jnp.asarray(weights))
    np.testing.assert_allclose(found.rotation_vectors, poses.rotation_vectors, atol=1e-7)
    np.testing.assert_allclose(found.translations, poses.translations, atol=1e-7)


def test_a_fisheye_comes_back(x64):
    """From nothing, with noise and some corners missing, within its own standard errors; some corners lie past 90°."""
    poses = _poses(10)
    exact, places = _views(poses)
    assert (places[..., 2] < 0).sum() > 10
    seen = exact + 0.1 * np.random.default_rng(1).normal(size=exact.shape)
    seen[:, ::9] = np.nan
    fit = calibrate(jl.KannalaBrandt.identity(), Boards(BOARD, seen), SIZE)
    assert fit.status == FitStatus.CONVERGED
    assert fit.names == ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    truth = np.array([*FRAME[1], *FRAME[0], *np.asarray(TRUTH.coefficients)])
    assert np.max(np.abs(np.asarray(fit.values) - truth) / np.asarray(fit.standard_errors)) < 3.5
    assert float(fit.rms) == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert not bool(fit.folds)
    assert float(fit.projection_uncertainty(jnp.array(FRAME[0]))) < 0.1
    judged = validate(fit.lens, fit.frame, Boards(BOARD, exact))
    assert float(judged.rms) < 0.1
