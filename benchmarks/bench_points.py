"""Points: the exact inverse of a lens."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import material, peers
from benchmarks.checks import check

ERROR = "largest error, normalized units"
_COUNTS = pytest.mark.parametrize("count", [2, 5, 8, 14])


def _undistort_points(race, count, dtype, limit, *, tolerance=None, peer_limit=None):
    ideal = material.ideal_points()
    # A context, as users of float32 would not switch all of JAX to float64.
    with jax.enable_x64(True):
        observed = np.asarray(material.lens(count, np.float64).distort(ideal), dtype)
    with jax.enable_x64(dtype == np.float64):
        lens, points = material.lens(count, dtype), jnp.asarray(observed)
        ours, theirs = lambda: lens.undistort(points), peers.opencv_undistort_points(observed, count, tolerance)
        found = check(
            ERROR,
            lambda result: float(np.max(np.abs(result - ideal))),
            ours,
            theirs,
            limit=limit,
            peer_limit=peer_limit,
        )
        race(ours, theirs, package="OpenCV", checks=[found], moved=2 * observed.nbytes)


@pytest.mark.row(
    "`lens.undistort`, {count} coefficients, 10⁶ points, float64",
    against="`cv2.undistortPoints`, iterated to 1e-12",
    target=0.25,
)
@_COUNTS
def bench_undistort_points(race, count):
    _undistort_points(race, count, np.float64, 1e-12, tolerance=1e-12, peer_limit=1e-10)


@pytest.mark.row(
    "`lens.undistort`, {count} coefficients, 10⁶ points, float64",
    against="`cv2.undistortPoints`, default",
    target=0.15,
)
@pytest.mark.parametrize("count", [2])
def bench_undistort_points_inexact(race, count):
    _undistort_points(race, count, np.float64, 1e-12)


@pytest.mark.row(
    "`lens.undistort`, {count} coefficients, 10⁶ points, float32", against="`cv2.undistortPoints`, default"
)
@_COUNTS
def bench_undistort_points_float32(race, count):
    _undistort_points(race, count, np.float32, 2e-6)
