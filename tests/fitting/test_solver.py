"""The solver: known minima, SciPy beside it, bounds, the arrow-shaped system against a dense one, hopeless starts."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize

import jaxlens as jl
from jaxlens.fitting._solver import NormalLevenbergMarquardt, Unknowns, normal_equations, solve

INFINITY = np.inf


def _minimize(residuals, start, data=None, *, lower=None, upper=None, max_steps=300):
    """Minimizes over a vector, without blocks; returns the vector and optimistix's solution."""
    start = jnp.asarray(start)
    bounds = {"lower": lower, "upper": upper}
    options = {name: jnp.asarray(bound, start.dtype) for name, bound in bounds.items() if bound is not None}
    solution = optx.least_squares(
        lambda unknowns, data: residuals(unknowns.shared, data)[None],
        NormalLevenbergMarquardt(rtol=0.5 * float(jnp.finfo(start.dtype).eps) ** 0.5),
        Unknowns.dense(start),
        data,
        options,
        max_steps=max_steps,
        throw=False,
    )
    return np.asarray(solution.value.shared), solution


def _peer(residuals, start, data=None, **options):
    """The same by SciPy, to the last digits."""
    derivative = jax.jit(jax.jacfwd(residuals))
    found = scipy.optimize.least_squares(
        lambda x: np.asarray(residuals(jnp.asarray(x), data)),
        start,
        jac=lambda x: np.asarray(derivative(jnp.asarray(x), data)),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        **options,
    )
    return found.x


def _succeeded(solution):
    return bool(solution.result == optx.RESULTS.successful)


def _rosenbrock(x, _):
    return jnp.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def _beale(x, _):
    return jnp.stack([1.5 - x[0] * (1 - x[1]), 2.25 - x[0] * (1 - x[1] ** 2), 2.625 - x[0] * (1 - x[1] ** 3)])


def _brown(x, _):
    return jnp.stack([x[0] - 1e6, x[1] - 2e-6, x[0] * x[1] - 2])


def _helical_valley(x, _):
    angle = jnp.arctan2(x[1], x[0]) / (2 * jnp.pi)
    return jnp.stack([10 * (x[2] - 10 * angle), 10 * (jnp.hypot(x[0], x[1]) - 1), x[2]])


def _freudenstein_roth(x, _):
    return jnp.stack(
        [-13 + x[0] + ((5 - x[1]) * x[1] - 2) * x[1], -29 + x[0] + ((x[1] + 1) * x[1] - 14) * x[1]],
    )


@pytest.mark.parametrize(
    ("residuals", "start", "minimum"),
    [
        (_rosenbrock, [-1.2, 1.0], [1.0, 1.0]),
        (_beale, [1.0, 1.0], [3.0, 0.5]),
        (_brown, [1.0, 1.0], [1e6, 2e-6]),
        (_helical_valley, [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        # The local minimum that this start is known to lead to, with residuals left.
        (_freudenstein_roth, [0.5, -2.0], [(53 - 4 * 22**0.5) / 3, (2 - 22**0.5) / 3]),
    ],
    ids=["Rosenbrock", "Beale", "Brown", "helical valley", "Freudenstein and Roth"],
)
def test_minima_known_in_closed_form(x64, residuals, start, minimum):
    """Problems of Moré, Garbow and Hillstrom (1981)."""
    found, solution = _minimize(residuals, start)
    assert _succeeded(solution)
    np.testing.assert_allclose(found, minimum, rtol=1e-7 if residuals is _freudenstein_roth else 1e-12, atol=1e-12)


def test_a_linear_problem_is_solved_at_once(dtype):
    random = np.random.default_rng(0)
    matrix, goal = random.normal(size=(30, 4)), random.normal(size=30)
    found, solution = _minimize(
        lambda x, data: data[0] @ x - data[1], np.zeros(4, dtype), (matrix.astype(dtype), goal.astype(dtype))
    )
    assert _succeeded(solution)
    assert found.dtype == dtype
    assert int(solution.stats["num_steps"]) <= 4
    expected = np.linalg.lstsq(matrix, goal, rcond=None)[0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 if dtype == "float64" else 3e-6)


# The solver ends where less than a hundred-thousandth of a standard error is left to go; those below are some 0.05.
NOTHING = 5e-7
TIMES = np.linspace(0, 4, 60)
DECAY = np.array([2.5, 1.3, 0.5])


def _decay(x, data):
    times, observed = data
    return observed - (x[0] * jnp.exp(-x[1] * times) + x[2])


def _observed(seed):
    noise = np.random.default_rng(seed).normal(size=TIMES.size)
    return DECAY[0] * np.exp(-DECAY[1] * TIMES) + DECAY[2] + 0.05 * noise


@pytest.mark.parametrize("start", [[1.0, 1.0, 0.0], [0.1, 5.0, 3.0], [10.0, 0.05, -5.0]])
def test_exponential_decay_is_scipy_s(x64, start):
    data = (jnp.asarray(TIMES), jnp.asarray(_observed(0)))
    found, solution = _minimize(_decay, start, data)
    assert _succeeded(solution)
    np.testing.assert_allclose(found, _peer(_decay, [1.0, 1.0, 0.0], data, method="lm"), rtol=0, atol=NOTHING)


def test_exponential_decay_in_single_precision():
    data = (jnp.asarray(TIMES, jnp.float32), jnp.asarray(_observed(0), jnp.float32))
    found, solution = _minimize(_decay, np.float32([1, 1, 0]), data)
    assert _succeeded(solution)
    assert found.dtype == np.float32
    # SciPy's answer in double precision, and a thousandth of the standard errors.
    np.testing.assert_allclose(found, [2.5003287927, 1.3551236645, 0.5224417190], rtol=0, atol=4e-5)


BOUNDED = [
    (_rosenbrock, [-1.2, 1.0], [-INFINITY, -INFINITY], [0.5, INFINITY]),  # at (0.5, 0.25)
    (_rosenbrock, [2.0, 1.0], [1.5, -INFINITY], [INFINITY, INFINITY]),  # at (1.5, 2.25)
    (_rosenbrock, [-1.2, 0.25], [-INFINITY, -INFINITY], [INFINITY, 0.5]),
    (_rosenbrock, [0.9, 0.9], [0.0, 0.0], [2.0, 2.0]),  # where no bound matters
    (_decay, [1.0, 1.0, 0.6], [0.0, 0.0, 0.55], [INFINITY, INFINITY, 0.7]),
    (_decay, [1.0, 1.0, 0.6], [0.0, 0.0, 0.55], [2.2, 9.0, 0.7]),  # at two bounds
    (_decay, [1.0, 1.0, 0.55], [0.0, 0.0, 0.45], [2.55, 9.0, 0.55]),  # starts at one that it leaves
]


@pytest.mark.parametrize(("residuals", "start", "lower", "upper"), BOUNDED)
def test_bounded_minima_are_scipy_s(x64, residuals, start, lower, upper):
    data = (jnp.asarray(TIMES), jnp.asarray(_observed(0)))
    found, solution = _minimize(residuals, start, data, lower=lower, upper=upper)
    assert _succeeded(solution)
    assert (found >= lower).all()
    assert (found <= upper).all()
    inside = np.clip(start, np.add(lower, 1e-3), np.subtract(upper, 1e-3))
    peer = _peer(residuals, inside, data, bounds=(lower, upper), method="trf")
    np.testing.assert_allclose(found, peer, rtol=0, atol=NOTHING)


def test_a_bound_is_reached_exactly(x64):
    for start, lower, upper, expected in (
        ([-1.2, 1.0], None, [0.5, INFINITY], [0.5, 0.25]),
        ([2.0, 1.0], [1.5, -INFINITY], None, [1.5, 2.25]),
    ):
        found, _ = _minimize(_rosenbrock, start, lower=lower, upper=upper)
        assert found[0] == expected[0]
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def _arrow(unknowns, data):
    """Residuals of six blocks: each knows the shared parameters and its own."""
    a, b = unknowns.shared[0], unknowns.shared[1:]
    places, observed = data
    phase, height = unknowns.blocks[:, :1], unknowns.blocks[:, 1:]
    wave = height * jnp.sin(a * places + phase)
    return observed - wave - b[0] * places - b[1] * places**2


def _arrow_problem(seed=0, noise=0.1):
    random = np.random.default_rng(seed)
    places = np.sort(random.uniform(0, 3, (6, 25)), axis=1)
    truth = Unknowns(
        jnp.asarray([1.7, 0.4, -0.2]), jnp.asarray(np.column_stack([random.uniform(-1, 1, 6), np.ones(6) * 2]))
    )
    observed = -np.asarray(_arrow(truth, (places, jnp.zeros((6, 25))))) + noise * random.normal(size=places.shape)
    return truth, (jnp.asarray(places), jnp.asarray(observed))


def _flatten(unknowns):
    return np.concatenate([unknowns.shared, np.ravel(unknowns.blocks)])


def _unflatten(values):
    return Unknowns(jnp.asarray(values[:3]), jnp.asarray(values[3:]).reshape(6, 2))


@jax.jit
def _normal(unknowns, data):
    return normal_equations(lambda unknowns: _arrow(unknowns, data), unknowns)[0]


@jax.jit
def _jacobian(values, data):
    return jax.jacfwd(lambda values: _arrow(_unflatten(values), data).ravel())(values)


def _dense_jacobian(unknowns, data):
    return np.asarray(_jacobian(jnp.asarray(_flatten(unknowns)), data))


def test_normal_equations_are_those_of_the_dense_jacobian(x64):
    truth, data = _arrow_problem()
    normal = _normal(truth, data)
    jacobian, residual = _dense_jacobian(truth, data), np.asarray(_arrow(truth, data)).ravel()
    full = jacobian.T @ jacobian
    assert float(normal.loss) == pytest.approx(0.5 * residual @ residual, rel=1e-14)
    np.testing.assert_allclose(_flatten(normal.gradient), jacobian.T @ residual, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(normal.shared, full[:3, :3], rtol=1e-13)
    np.testing.assert_allclose(_flatten(normal.diagonal()), np.diag(full), rtol=1e-13)
    for block in range(6):
        own = slice(3 + 2 * block, 5 + 2 * block)
        np.testing.assert_allclose(normal.cross[block], full[:3, own], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(normal.blocks[block], full[own, own], rtol=1e-12, atol=1e-12)
    step = np.random.default_rng(1).normal(size=15)
    assert float(normal.curvature(_unflatten(step))) == pytest.approx(step @ full @ step, rel=1e-13)


@pytest.mark.parametrize("count", [3, 12])
def test_both_ways_to_the_normal_equations_are_those_of_the_dense_jacobian(x64, count):
    """Few parameters are summed in one pass, many are a matrix product."""
    random = np.random.default_rng(2)
    matrix, goal = random.normal(size=(2, 150, count)), random.normal(size=(2, 150))
    normal, values = jax.jit(lambda unknowns: normal_equations(lambda u: matrix @ u.shared - goal, unknowns))(
        Unknowns.dense(jnp.ones(count))
    )
    tall, residual = matrix.reshape(-1, count), (matrix.sum(axis=-1) - goal).ravel()
    np.testing.assert_allclose(np.ravel(values), residual, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(normal.shared, tall.T @ tall, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(normal.gradient.shared, tall.T @ residual, rtol=1e-12, atol=1e-12)
    assert float(normal.loss) == pytest.approx(0.5 * residual @ residual, rel=1e-14)


@pytest.mark.parametrize("damping", [0.0, 1e-3, 10.0])
def test_the_schur_step_is_the_dense_solution(x64, damping):
    truth, data = _arrow_problem()
    normal = _normal(truth, data)
    jacobian = _dense_jacobian(truth, data)
    full = jacobian.T @ jacobian
    full = full + damping * np.diag(np.diag(full))
    right = np.random.default_rng(3).normal(size=15)
    step = jax.jit(solve)(normal, _unflatten(right), jnp.asarray(damping))
    np.testing.assert_allclose(_flatten(step), jnp.linalg.solve(full, jnp.asarray(right)), rtol=1e-10, atol=1e-13)


def test_a_singular_system_has_no_step(x64):
    unknowns = Unknowns.dense(jnp.zeros(2))
    normal, _ = normal_equations(lambda u: 1 + jnp.ones((1, 5)) * u.shared[0], unknowns)
    assert np.isnan(_flatten(jax.jit(solve)(normal, normal.gradient, jnp.asarray(0.0)))).all()
    assert np.isfinite(_flatten(jax.jit(solve)(normal, normal.gradient, jnp.asarray(1e-3)))).all()


@jax.jit
def _solve_arrow(start, data):
    solution = optx.least_squares(
        _arrow, NormalLevenbergMarquardt(rtol=1e-8), start, data, {}, max_steps=100, throw=False
    )
    return solution.value, solution.result == optx.RESULTS.successful


def test_blocks_and_all_are_scipy_s(x64):
    truth, data = _arrow_problem()
    start = Unknowns(truth.shared + 0.1, truth.blocks - 0.2)
    found, succeeded = _solve_arrow(start, data)
    assert bool(succeeded)
    peer = _peer(lambda x, data: _arrow(_unflatten(x), data).ravel(), _flatten(start), data, method="lm")
    np.testing.assert_allclose(_flatten(found), peer, rtol=0, atol=NOTHING)
    exact, succeeded = _solve_arrow(start, _arrow_problem(noise=0.0)[1])
    assert bool(succeeded)
    np.testing.assert_allclose(_flatten(exact), _flatten(truth), rtol=0, atol=1e-12)


def test_a_batch_is_solved_as_each_alone(x64):
    truth = _arrow_problem()[0]
    start = Unknowns(truth.shared + 0.1, truth.blocks - 0.2)
    problems = [_arrow_problem(noise=noise)[1] for noise in (0.0, 0.05, 0.3)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *problems)
    together, succeeded = jax.vmap(lambda data: _solve_arrow(start, data))(batch)
    assert bool(jnp.all(succeeded))
    for i, data in enumerate(problems):
        alone = _solve_arrow(start, data)[0]
        np.testing.assert_allclose(together.shared[i], alone.shared, rtol=1e-10)
        np.testing.assert_allclose(together.blocks[i], alone.blocks, rtol=1e-10)


def test_parameters_that_only_matter_together(x64):
    """A singular problem ends at one of its minima, not at infinity."""
    found, solution = _minimize(
        lambda x, _: (x[0] + x[1]) * jnp.asarray([1.0, 2.0]) - jnp.asarray([2.0, 4.5]), [0.0, 1.0]
    )
    assert _succeeded(solution)
    assert found.sum() == pytest.approx(2.2, abs=1e-12)
    assert np.abs(found).max() < 3


def test_a_step_to_where_nothing_is_defined_is_taken_back(x64):
    """Gauss–Newton's first step from 30 leads below zero, where the logarithm is NaN."""
    found, solution = _minimize(lambda x, _: jnp.log(x) - jnp.log(0.01), [30.0])
    assert _succeeded(solution)
    np.testing.assert_allclose(found, [0.01], rtol=1e-12)


@pytest.mark.parametrize("residuals", [lambda x, _: jnp.log(x), lambda x, _: jnp.exp(-800 * x)], ids=["NaN", "inf"])
def test_a_start_without_finite_residuals_ends_where_it_is(x64, residuals):
    found, solution = _minimize(residuals, [-1.0, 2.0])
    assert int(solution.stats["num_steps"]) <= 2
    np.testing.assert_array_equal(found, [-1.0, 2.0])


@pytest.mark.parametrize("start", [[-1.2, 1.0], [3.0, 9.0]])
def test_a_start_outside_its_bounds_is_brought_inside(x64, start):
    """`minimize`, through which all fits go, starts within the bounds: the first candidate is the start itself."""
    ideal = np.random.default_rng(5).uniform(-0.7, 0.7, (60, 2))
    observed = jl.RadialPolynomial([0.1, 0.05]).distort(ideal)
    fit = jl.fitting.fit_points(
        jl.RadialPolynomial(np.array(start)), ideal, observed, bounds={"kappa1": (0.2, 1.0), "kappa2": (-5.0, 5.0)}
    )
    assert fit.values[0] == 0.2
    other = jl.fitting.fit_points(jl.RadialPolynomial([0.2, 0.0]), ideal, observed, free=_only_the_second())
    np.testing.assert_allclose(fit.values[1], other.values[0], rtol=1e-9)


def _only_the_second():
    mask = jax.tree.map(lambda _: False, jl.RadialPolynomial([0.2, 0.0]))
    return eqx.tree_at(lambda lens: lens.coefficients, mask, np.array([False, True]))


def test_out_of_steps(x64):
    found, solution = _minimize(_rosenbrock, [-1.2, 1.0], max_steps=20)
    assert bool(solution.result == optx.RESULTS.nonlinear_max_steps_reached)
    assert int(solution.stats["num_steps"]) == 20
    loss = np.sum(np.square(_rosenbrock(jnp.asarray(found), None)))
    assert loss < np.sum(np.square(_rosenbrock(jnp.asarray([-1.2, 1.0]), None)))
