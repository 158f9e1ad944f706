"""Fits: points, one at a time and in batches, boards, and a pair of pictures."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import jaxlens as jl
from benchmarks import material, peers
from benchmarks.checks import check

POINTS, VIEWS = 10_000, 13
FITS, POINTS_A_FIT = 256, 54
SIZE = 512
START = (0.0, 0.0, 0.0)
# Both stop when their steps get small: what is left is far below the standard errors, of 2e-4 and more.
AGREED = 1e-6


def _distance_from(expected):
    return lambda result: float(np.max(np.abs(np.asarray(result) - expected)))


@pytest.mark.row(
    "`fit_points`, three coefficients and the centre to 10 000 points",
    against="`scipy.optimize.least_squares(method='lm')`, analytic Jacobian",
    target=0.25,
)
def bench_fit_points(race):
    ideal, observed = material.correspondences(1, POINTS)
    theirs = peers.scipy_fit(ideal, observed)
    with jax.enable_x64(True):
        lens, first, second = jl.RadialPolynomial(list(START)), jnp.asarray(ideal[0]), jnp.asarray(observed[0])

        def ours():
            return jl.fitting.fit_points(lens, first, second, center=True).values

        expected = np.asarray(ours()) if theirs is None else theirs.read(theirs.run())[0]
        found = check("largest difference from SciPy's estimates", _distance_from(expected), ours, None, limit=AGREED)
        race(ours, theirs, package="SciPy", checks=[found], moved=ideal.nbytes + observed.nbytes)


# Tolerances at which their last step leaves as little as ours does; and a start at which the centre has an effect,
# without which Dogleg takes no step.
_TOLERANCE = 1e-8
_BARREL = (-0.1, 0.0, 0.0)


def _race_solvers(race, solver):
    """Our solver against one of optimistix's, both within `fit_points`."""
    ideal, observed = (jnp.asarray(values[0]) for values in material.correspondences(1, POINTS))

    def fitted(**options):
        return jl.fitting.fit_points(jl.RadialPolynomial(list(_BARREL)), ideal, observed, center=True, **options).values

    theirs = peers.Peer(lambda: jax.block_until_ready(fitted(solver=solver)))
    expected = theirs.read(theirs.run())
    found = check("largest difference from their estimates", _distance_from(expected), fitted, None, limit=AGREED)
    race(fitted, theirs, package="optimistix", checks=[found], moved=ideal.nbytes + observed.nbytes)


@pytest.mark.row(
    "`fit_points`, three coefficients and the centre to 10 000 points, from κ1 = −0.1",
    against="the same with `solver=optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)`",
)
def bench_fit_points_levenberg_marquardt(race):
    with jax.enable_x64(True):
        _race_solvers(race, optx.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE))


@pytest.mark.row(
    "`fit_points`, three coefficients and the centre to 10 000 points, from κ1 = −0.1",
    against="the same with `solver=optimistix.Dogleg(rtol=1e-8, atol=1e-8)`",
)
def bench_fit_points_dogleg(race):
    with jax.enable_x64(True):
        _race_solvers(race, optx.Dogleg(rtol=_TOLERANCE, atol=_TOLERANCE))


@pytest.mark.row(
    "256 fits of 54 points under `vmap`",
    against="a loop over `scipy.optimize.least_squares(method='lm')`",
    target=0.02,
)
def bench_fit_points_batch(race):
    ideal, observed = material.correspondences(FITS, POINTS_A_FIT)
    theirs = peers.scipy_fit(ideal, observed)
    with jax.enable_x64(True):
        lens, first, second = jl.RadialPolynomial(list(START)), jnp.asarray(ideal), jnp.asarray(observed)
        batch = jax.jit(jax.vmap(lambda one, other: jl.fitting.fit_points(lens, one, other, center=True)))

        def ours():
            return batch(first, second).values

        expected = np.asarray(ours()) if theirs is None else theirs.read(theirs.run())
        found = check("largest difference from SciPy's estimates", _distance_from(expected), ours, None, limit=1e-4)
        race(ours, theirs, package="SciPy", checks=[found], moved=ideal.nbytes + observed.nbytes)


@pytest.mark.row("`calibrate`, 13 views of 9×6 corners, five coefficients", against="`cv2.calibrateCamera`", target=2.0)
def bench_calibrate(race):
    board, corners = material.boards(VIEWS)
    with jax.enable_x64(True):
        boards, start = jl.fitting.Boards(jnp.asarray(board), jnp.asarray(corners)), jl.BrownConrady([0.0] * 5)

        def ours():
            return jl.fitting.calibrate(start, boards, (640, 480)).rms

        theirs = peers.opencv_calibrate(board, corners, (640, 480))
        expected = np.asarray(ours()) if theirs is None else theirs.read(theirs.run())
        found = check("difference of the RMS from OpenCV's, pixels", _distance_from(expected), ours, None, limit=1e-6)
        race(ours, theirs, package="OpenCV", checks=[found], moved=2 * corners.nbytes)


@pytest.mark.row("`fit_images`, a pair of 512×512 pictures, from nothing (asked: at most 500 ms)", against="—")
def bench_fit_images(race):
    with jax.enable_x64(True):
        source = jnp.asarray(material.picture(1)[:SIZE, :SIZE, 0], float)
        lens = jl.RadialPolynomial([1.0, 2.0])
        distorted = jl.distort_image(source, lens)

        def ours():
            return jl.fitting.fit_images(jl.RadialPolynomial([0.0, 0.0]), source, distorted).values[:2]

        found = check("largest error of a coefficient", _distance_from([1.0, 2.0]), ours, None, limit=1e-6)
        race(ours, None, package=None, checks=[found], moved=2 * source.nbytes)
