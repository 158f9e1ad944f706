"""A fit of one's own, by `Problem`, `minimize` and `assess`; and solvers of others in the fits there are."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize
from jaxtyping import Array, Float

import jaxlens as jl
from jaxlens.fitting import FitStatus, Minimum, Problem, Unknowns, assess, fit_lines, fit_points, minimize, report

TIMES = np.linspace(0, 4, 41)
NOISE = 0.05 * np.random.default_rng(0).normal(size=(3, 41))
SOLVERS = [
    optx.LevenbergMarquardt(rtol=1e-10, atol=1e-12),
    optx.Dogleg(rtol=1e-10, atol=1e-12),
    optx.GaussNewton(rtol=1e-10, atol=1e-12),
]


class Decay(Problem):
    """Decays of one rate; a height and an offset for each row, of which the blocks consist."""

    times: Float[Array, "rows points"]
    heights: Float[Array, "rows points"]
    weights: Float[Array, "rows points"]

    def residuals(self, unknowns):
        height, offset = unknowns.blocks[:, :1], unknowns.blocks[:, 1:]
        return (self.heights - height * jnp.exp(-unknowns.shared[0] * self.times) - offset)[..., None]


class Line(Problem):
    """A straight line, all of whose parameters are shared."""

    x: Float[Array, "1 points"]
    y: Float[Array, "1 points"]
    weights: Float[Array, "1 points"]

    def residuals(self, unknowns):
        return (self.y - unknowns.shared[0] - unknowns.shared[1] * self.x)[..., None]


def _decay():
    truth = np.array([[2.0, 0.1], [1.0, -0.2], [3.0, 0.0]])
    heights = truth[:, :1] * np.exp(-0.7 * TIMES) + truth[:, 1:] + NOISE
    times = jnp.broadcast_to(jnp.asarray(TIMES), heights.shape)
    start = Unknowns(jnp.asarray([0.3]), jnp.asarray([[1.0, 0.0]] * 3))
    return Decay(times, jnp.asarray(heights), jnp.ones(heights.shape)), start


@pytest.mark.parametrize("solver", [None, *SOLVERS], ids=lambda solver: type(solver).__name__)
def test_blocks_and_shared_parameters_are_scipy_s(x64, solver):
    problem, start = _decay()
    minimum = minimize(problem, start, solver=solver)
    known = assess(problem, minimum)

    def rows(values):
        height, offset = values[1::2, None], values[2::2, None]
        return (np.asarray(problem.heights) - height * np.exp(-values[0] * TIMES) - offset).ravel()

    found = scipy.optimize.least_squares(rows, [0.3, 1, 0, 1, 0, 1, 0], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert minimum.status is FitStatus.CONVERGED
    np.testing.assert_allclose(minimum.unknowns.shared, found.x[:1], rtol=1e-7)
    np.testing.assert_allclose(minimum.unknowns.blocks, found.x[1:].reshape(3, 2), rtol=0, atol=1e-7)
    covariance = np.linalg.inv(found.jac.T @ found.jac) * 2 * found.cost / (123 - 7)
    np.testing.assert_allclose(known.covariance, covariance[:1, :1], rtol=1e-5)
    np.testing.assert_allclose(known.standard_errors, np.sqrt(covariance[0, 0]), rtol=1e-5)
    assert int(known.degrees_of_freedom) == 123 - 7


def test_the_minimum_is_differentiable_in_the_data(x64):
    x, y = jnp.asarray(TIMES)[None], jnp.asarray(NOISE[:1])
    weights = jnp.ones_like(x)
    design = np.column_stack([np.ones(41), TIMES])

    def found(y):
        return minimize(Line(x, y, weights), jnp.zeros(2)).unknowns.shared

    np.testing.assert_allclose(found(y), np.linalg.lstsq(design, NOISE[0], rcond=None)[0], rtol=1e-9)
    for derivative in (jax.jacfwd(found)(y), jax.jacrev(found)(y)):
        np.testing.assert_allclose(derivative[:, 0], np.linalg.pinv(design), rtol=0, atol=1e-12)


def test_a_robust_loss_and_bounds(x64):
    y = NOISE[:1] + TIMES
    y[0, ::8] += 5
    problem = Line(jnp.asarray(TIMES)[None], jnp.asarray(y), jnp.ones((1, 41)))
    minimum = minimize(problem, np.zeros(2), loss="cauchy")
    known = assess(problem, minimum, loss="cauchy")
    assert np.all(np.abs(np.asarray(minimum.unknowns.shared) - [0, 1]) < 4 * known.standard_errors)
    held = minimize(problem, np.zeros(2), bounds=(np.array([-np.inf, -np.inf]), np.array([np.inf, 0.5])))
    assert float(held.unknowns.shared[1]) == 0.5
    with pytest.raises(ValueError, match="Dogleg knows no bounds"):
        minimize(problem, np.zeros(2), bounds=(-np.ones(2), np.ones(2)), solver=SOLVERS[1])


def test_a_fit_of_what_was_found(x64):
    """The same record as from every fit: here of a lens of one coefficient, from the radii of its points alone."""
    radii = jnp.linspace(0.1, 0.8, 30)
    seen = jl.Division(0.2).radius(radii) + 0.001 * jnp.asarray(NOISE[0, :30])

    class Radii(Problem):
        ideal: Float[Array, "1 points"]
        observed: Float[Array, "1 points"]
        weights: Float[Array, "1 points"]

        def residuals(self, unknowns):
            return (self.observed - jl.Division(unknowns.shared[0]).radius(self.ideal))[..., None]

    problem = Radii(radii[None], seen[None], jnp.ones((1, 30)))
    minimum = minimize(problem, jnp.zeros(1))
    lens = jl.Division(minimum.unknowns.shared[0])
    fit = report(minimum, assess(problem, minimum), ("k",), lens=lens, folds=jnp.asarray(False))
    assert abs(float(fit.parameters["k"]) - 0.2) < 4 * float(fit.standard_errors[0])
    assert "k" in fit.summary()


def test_what_does_not_fit():
    x = jnp.zeros((1, 5))

    class Flat(Line):
        def residuals(self, unknowns):
            return self.x

    with pytest.raises(ValueError, match=r"Flat.residuals must return \(blocks, points, components\).* got \(1, 5\)"):
        minimize(Flat(x, x, x), jnp.zeros(2))
    with pytest.raises(ValueError, match="weights for 1 blocks, and a start for 3"):
        minimize(Line(x, x, x), Unknowns(jnp.zeros(2), jnp.zeros((3, 1))))
    problem = Line(jnp.ones((1, 5)), x, jnp.ones((1, 5)))
    minimum = minimize(problem, jnp.zeros(2))
    assert isinstance(minimum, Minimum)
    assert assess(problem, minimum).status is FitStatus.RANK_DEFICIENT


IDEAL = np.random.default_rng(1).uniform(-0.7, 0.7, (60, 2))
LENS = [-0.2, 0.05]


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: type(solver).__name__)
@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_points_by_any_solver(x64, solver, loss):
    observed = jl.RadialPolynomial(LENS).distort(IDEAL) + 1e-3 * np.random.default_rng(2).normal(size=IDEAL.shape)
    ours = fit_points(jl.RadialPolynomial([0.0, 0.0]), IDEAL, observed, loss=loss)
    theirs = fit_points(jl.RadialPolynomial([0.0, 0.0]), IDEAL, observed, loss=loss, solver=solver)
    np.testing.assert_allclose(theirs.values, ours.values, rtol=0, atol=1e-8)
    np.testing.assert_allclose(theirs.covariance, ours.covariance, rtol=1e-5)

    def coefficient(observed, solver):
        return fit_points(jl.RadialPolynomial([0.0, 0.0]), IDEAL, observed, loss=loss, solver=solver).values[0]

    slopes = [jax.grad(coefficient)(observed, one) for one in (None, solver)]
    np.testing.assert_allclose(slopes[1], slopes[0], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_lines_pictures_and_boards_by_another_solver(x64):
    solver = SOLVERS[0]
    t = jnp.linspace(-0.6, 0.6, 15)
    straight = [jnp.stack([t, jnp.full_like(t, y)], -1) for y in (-0.5, -0.2, 0.4)]
    lines = [jl.Division(0.2).distort(line) for line in straight]
    for search in (True, False):
        fit = fit_lines(jl.Division(0.0), lines, search=search, solver=solver)
        np.testing.assert_allclose(fit.values, [0.2], rtol=0, atol=1e-7)
    source = jax.image.resize(jax.random.uniform(jax.random.key(0), (12, 16)), (48, 64), "cubic")
    fit = jl.fitting.fit_images(jl.Division(0.0), source, jl.distort_image(source, jl.Division(0.3)), solver=solver)
    np.testing.assert_allclose(fit.lens.k, 0.3, rtol=0, atol=1e-5)
    board = jnp.stack(jnp.meshgrid(jnp.arange(5.0), jnp.arange(4.0)), -1).reshape(-1, 2)
    turns = 0.4 * np.random.default_rng(3).normal(size=(4, 3))
    poses = jl.fitting.Poses(turns, np.array([[-2.0, -1.5, 9.0]] * 4))
    ideal = poses.project(jnp.broadcast_to(board, (4, 20, 2)))
    corners = jl.Frame([320.0, 240.0], [530.0, 530.0]).denormalize(jl.Division(0.2).distort(ideal))
    fit = jl.fitting.calibrate(jl.Division(0.0), jl.fitting.Boards(board, corners), (640, 480), solver=solver)
    np.testing.assert_allclose(fit.parameters["k"], 0.2, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("solver", "message"),
    [
        (optx.LevenbergMarquardt, "got the class LevenbergMarquardt"),
        ("lm", "must be a least-squares solver of optimistix, such as .* got str"),
        (optx.Newton(1e-8, 1e-8), "got Newton"),
        (optx.BFGS(1e-8, 1e-8), "got BFGS"),
    ],
)
def test_what_is_no_solver(solver, message):
    undecorated = getattr(fit_points, "__wrapped__", fit_points)
    with pytest.raises((ValueError, TypeError), match=f"{message}|Type-check error"):
        undecorated(jl.Division(0.0), IDEAL, IDEAL, solver=solver)
