"""Points: the exact inverse of a lens."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlens as jl
from benchmarks import material, peers
from benchmarks.checks import check

ERROR = "largest error, normalized units"


def _undistort_points(race, dtype, limit, *, tolerance=None, peer_limit=None):
    ideal, observed = material.observed_points()
    observed = observed.astype(dtype)
    # A context, as users of float32 would not switch all of JAX to float64.
    with jax.enable_x64(dtype == np.float64):
        lens, points = jl.RadialPolynomial(np.asarray(material.KAPPA, dtype)), jnp.asarray(observed)
        ours, theirs = lambda: lens.undistort(points), peers.opencv_undistort_points(observed, tolerance)
        found = check(
            ERROR,
            lambda result: float(np.max(np.abs(result - ideal))),
            ours,
            theirs,
            limit=limit,
            peer_limit=peer_limit,
        )
        race(ours, theirs, package="OpenCV", checks=[found], moved=2 * observed.nbytes)


@pytest.mark.row("`lens.undistort`, 10⁶ points, float64", against="`cv2.undistortPoints`, default", target=0.15)
def bench_undistort_points(race):
    _undistort_points(race, np.float64, 1e-12)


@pytest.mark.row("`lens.undistort`, 10⁶ points, float64", against="`cv2.undistortPoints`, iterated to 1e-12")
def bench_undistort_points_exact(race):
    _undistort_points(race, np.float64, 1e-12, tolerance=1e-12, peer_limit=1e-10)


@pytest.mark.row("`lens.undistort`, 10⁶ points, float32", against="`cv2.undistortPoints`, default")
def bench_undistort_points_float32(race):
    _undistort_points(race, np.float32, 1e-6)
