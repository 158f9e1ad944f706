"""From a problem to its minimum, and to what is known about it."""

import abc
from functools import partial
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Float, Int

from jaxlens.fitting._arguments import check_loss, check_solver
from jaxlens.fitting._result import Fit, FitStatus, named_status
from jaxlens.fitting._robust import Loss, influence, noise_scale, robustify
from jaxlens.fitting._solver import NormalLevenbergMarquardt, Unknowns, normal_equations
from jaxlens.linear import invert_definite, squares_rounding
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import as_floating, epsilon

# Rounds of estimating the noise, and fitting anew, and the relative change of the loss scale at which they end.
_ROUNDS = 10
_SETTLED = 1e-3


class Problem(eqx.Module):
    """A fit of one's own: data as fields, and the residuals that parameters leave in them.

    A problem is a pytree: its fields are arrays, or problems' and maps' own trees of them; what is not an array is a
    static field (`equinox.field(static=True)`). `minimize` finds the parameters, `assess` what is known about them.

    Residuals have three axes. The last holds the components of a point, whose noise is alike. Where parameters are all
    shared, the first has length one. Where some belong to blocks, as a pose to a view, it tells the blocks apart: the
    residuals of a block may depend on the shared parameters and on that block's own, and the solver then eliminates
    the latter.

    Attributes:
        weights: `(blocks, points)`, inverse variances up to a common factor; points of weight zero do not count.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> from jaxtyping import Array, Float
        >>> class Decay(jl.fitting.Problem):
        ...     times: Float[Array, "1 points"]
        ...     heights: Float[Array, "1 points"]
        ...     weights: Float[Array, "1 points"]
        ...
        ...     def residuals(self, unknowns):
        ...         height, rate = unknowns.shared
        ...         return (self.heights - height * jnp.exp(-rate * self.times))[..., None]
        >>> times = jnp.linspace(0.0, 2.0, 21)[None]
        >>> noise = 0.01 * jnp.sin(50 * times)
        >>> problem = Decay(times, 3 * jnp.exp(-0.5 * times) + noise, jnp.ones_like(times))
        >>> minimum = jl.fitting.minimize(problem, jnp.ones(2))
        >>> minimum.status, [round(float(value), 2) for value in minimum.unknowns.shared]
        (<FitStatus.CONVERGED: 0>, [3.0, 0.5])
        >>> errors = jl.fitting.assess(problem, minimum).standard_errors
        >>> [round(float(error), 3) for error in errors]
        [0.004, 0.001]
    """

    weights: eqx.AbstractVar[Float[Array, "blocks points"]]
    fused: ClassVar[bool] = False
    """Whether residuals cost less than writing their derivatives to memory (a few dozen operations a point do): these
    are then computed within the sums over them, on one thread. Only speed depends on it."""

    @abc.abstractmethod
    def residuals(self, unknowns: Unknowns) -> Float[Array, "blocks points components"]:
        """Returns the residuals, observed − predicted, not weighted.

        A pure function of JAX, twice differentiable for derivatives of the minimum. Its values and derivatives must be
        finite even where the weight is zero; the values there do not matter.
        """

    def weighted(self, unknowns: Unknowns) -> Float[Array, "blocks points components"]:
        """Returns the residuals of which each component has the same variance."""
        used = self.weights > 0
        return self.residuals(unknowns) * jnp.where(used, jnp.sqrt(jnp.where(used, self.weights, 1)), 0)[..., None]


class Minimum(eqx.Module):
    """What `minimize` found.

    Attributes:
        unknowns: The parameters where the loss is least.
        loss_scale: Where the robust loss bends, ∞ for `linear`.
        status_code: The number of `status`.
        steps: Steps of the solver, over all rounds of a robust loss.
    """

    unknowns: Unknowns
    loss_scale: Float[Array, ""]
    status_code: Int[Array, ""]
    steps: Int[Array, ""]

    @property
    def status(self) -> FitStatus | Int[Array, "*batch"]:
        """How the solver ended. Of a batch, and under `jax.jit` and `jax.vmap`, an array of the numbers."""
        return named_status(self.status_code)


class Knowledge(eqx.Module):
    """What residuals and their derivatives tell about the shared parameters: the result of `assess`.

    Attributes:
        residuals: As of `Problem.residuals`, not weighted; zero where the weight is zero.
        covariance: Covariance of the shared parameters, as in `Fit`; NaN where the data do not determine it.
        information: JᵀJ, the columns of J scaled to length one, and cleared of what blocks could explain as well.
        inflation: How many times the other shared parameters' being unknown inflates the variance of each, beyond what
            the blocks do, which count as unknown either way.
        rms: The root of the mean squared length of the residuals, weighted.
        per_block_rms: The same for each block.
        degrees_of_freedom: Residual components less parameters, those of blocks counted.
        status_code: The number of `status`.
    """

    residuals: Float[Array, "blocks points components"]
    covariance: Float[Array, "shared shared"]
    information: Float[Array, "shared shared"]
    inflation: Float[Array, " shared"]
    rms: Float[Array, ""]
    per_block_rms: Float[Array, " blocks"]
    degrees_of_freedom: Int[Array, ""]
    status_code: Int[Array, ""]

    @property
    def status(self) -> FitStatus | Int[Array, "*batch"]:
        """The solver's status, or what keeps the minimum from being worth having; an array as in `Minimum`."""
        return named_status(self.status_code)

    @property
    def standard_errors(self) -> Float[Array, "*batch shared"]:
        """The square roots of the variances."""
        return jnp.sqrt(jnp.diagonal(self.covariance, axis1=-2, axis2=-1))


def minimize(
    problem: Problem,
    start: Unknowns | Float[ArrayLike, " shared"],
    *,
    loss: Loss = "linear",
    loss_scale: Float[ArrayLike, ""] | None = None,
    bounds: tuple[Float[ArrayLike, " shared"], Float[ArrayLike, " shared"]] | None = None,
    max_steps: int = 200,
    solver: optx.AbstractLeastSquaresSolver | None = None,
) -> Minimum:
    """Minimizes the sum of the robust loss of a problem's weighted residuals.

    Args:
        problem: The problem.
        start: Where to start; a vector, where all parameters are shared.
        loss: `linear` for normal noise; `huber` or `cauchy` when some points are wrong.
        loss_scale: The residual at which the loss bends, in units of a point of weight one; it follows from the median
            residual, in rounds, unless given.
        bounds: The smallest and largest values of the shared parameters, each a vector, ±∞ where there is none.
        max_steps: Steps of the solver, in each round of a robust loss.
        solver: A least-squares solver of optimistix in place of ours, such as `optimistix.Dogleg(1e-8, 1e-8)`. It knows
            no bounds, and its tolerances are its own.

    Returns:
        A `Minimum`. Differentiable in the problem's arrays, of every order, by the implicit function theorem: where the
        solver has converged, no bound is active, and at a fixed loss scale. Not in the start.

    Raises:
        ValueError: shapes that do not fit, a loss or a solver that is none.

    Example:
        See `Problem`.
    """
    check_loss(loss, loss_scale)
    check_solver(solver, bounded=bounds is not None)
    if not isinstance(start, Unknowns):
        start = Unknowns.dense(as_floating(start).reshape(-1))
    start = _checked(problem, start)
    options = {"loss": loss, "loss_scale": loss_scale, "bounds": bounds, "max_steps": max_steps, "solver": solver}
    return differentiable(problem, descend(problem, start, **options), loss)


def _checked(problem: Problem, start: Unknowns) -> Unknowns:
    """Returns the start, in the dtype of the residuals.

    Raises:
        ValueError: residuals of another shape than the weights say, or a start of other blocks.
    """
    shape = jnp.shape(problem.weights)
    residuals = jax.eval_shape(problem.residuals, start)
    if residuals.ndim != 3 or residuals.shape[:2] != shape:
        raise ValueError(
            f"{type(problem).__name__}.residuals must return (blocks, points, components), with as many blocks and "
            f"points as there are weights, {shape}; got {residuals.shape}"
        )
    if start.blocks.shape[1] and start.blocks.shape[0] != shape[0]:
        raise ValueError(f"there are weights for {shape[0]} blocks, and a start for {start.blocks.shape[0]}")
    return jax.tree.map(lambda values: values.astype(jnp.result_type(values, residuals.dtype)), start)


def descend(
    problem: Problem,
    start: Unknowns,
    *,
    loss: Loss,
    loss_scale: Float[ArrayLike, ""] | None,
    bounds: tuple[Float[ArrayLike, " shared"], Float[ArrayLike, " shared"]] | None,
    max_steps: int,
    solver: optx.AbstractLeastSquaresSolver | None = None,
) -> Minimum:
    """Finds the minimum as `minimize` does, without derivatives."""
    fixed, start = lax.stop_gradient((problem, start))
    bounds = None if bounds is None else (jnp.asarray(bounds[0]), jnp.asarray(bounds[1]))
    if bounds is not None:
        start = Unknowns(jnp.clip(start.shared, *bounds), start.blocks)
    dtype = start.shared.dtype
    if loss == "linear" or loss_scale is not None:
        scale = jnp.asarray(jnp.inf if loss_scale is None or loss == "linear" else loss_scale, dtype)
        return _solve(fixed, start, loss, scale, bounds, max_steps, solver)
    return _solve_in_rounds(fixed, start, loss, bounds, max_steps, solver)


def differentiable(problem: Problem, found: Minimum, loss: Loss) -> Minimum:
    """Gives a minimum that was found its derivatives with respect to the problem."""
    unknowns = _implicit(loss, found.unknowns, problem, found.loss_scale)
    return Minimum(unknowns, found.loss_scale, found.status_code, found.steps)


def _solve_in_rounds(
    problem: Problem, start: Unknowns, loss: Loss, bounds: Any, max_steps: int, solver: Any
) -> Minimum:
    """Estimates the loss scale and minimizes in turn, until the scale settles."""

    def unsettled(state):
        rounds, found, scale = state
        return (rounds < _ROUNDS) & ~(jnp.abs(scale - found.loss_scale) <= _SETTLED * scale)

    def one_round(state):
        rounds, found, scale = state
        better = _solve(problem, found.unknowns, loss, scale, bounds, max_steps, solver)
        found = Minimum(better.unknowns, scale, better.status_code, found.steps + better.steps)
        return rounds + 1, found, noise_scale(problem.weighted(better.unknowns), problem.weights, loss)

    nothing = Minimum(start, jnp.zeros_like(start.shared, shape=()), jnp.asarray(FitStatus.MAX_STEPS), jnp.asarray(0))
    first = noise_scale(problem.weighted(start), problem.weights, loss)
    return lax.while_loop(unsettled, one_round, (jnp.asarray(0), nothing, first))[1]


def _solve(
    problem: Problem, start: Unknowns, loss: Loss, scale: Array, bounds: Any, max_steps: int, solver: Any
) -> Minimum:
    if solver is None:
        # A step that changes the residuals by less than this leaves an error of its square: it converges quadratically.
        solver = NormalLevenbergMarquardt(rtol=0.5 * epsilon(start.shared.dtype) ** 0.5, fused=problem.fused)
    options = {} if bounds is None else {"lower": bounds[0], "upper": bounds[1]}
    solution = optx.least_squares(
        partial(_rows, loss), solver, start, (problem, scale), options, max_steps=max_steps, throw=False
    )
    status: Array = jnp.where(
        solution.result == optx.RESULTS.successful,
        FitStatus.CONVERGED,
        jnp.where(solution.result == optx.RESULTS.nonlinear_max_steps_reached, FitStatus.MAX_STEPS, FitStatus.DIVERGED),
    )
    return Minimum(solution.value, scale, status, jnp.asarray(solution.stats["num_steps"], int))


def _rows(loss: Loss, unknowns: Unknowns, args: tuple[Problem, Array]) -> Float[Array, "blocks rows"]:
    problem, scale = args
    return _flat(robustify(problem.weighted(unknowns), loss, scale))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _implicit(loss: Loss, unknowns: Unknowns, problem: Problem, scale: Array) -> Unknowns:
    """Gives a minimum, already found, its derivatives with respect to the problem: where the gradient stays zero.

    Optimistix's implicit adjoint would do, were a minimum found in one call: here it comes in rounds, and the
    derivatives belong to the last.
    """
    del loss, problem, scale
    return unknowns


@_implicit.defjvp
def _implicit_jvp(loss, primals, tangents):
    _, problem, scale = primals
    minimum = _implicit(loss, *primals)
    flat, unravel = ravel_pytree(minimum)

    def gradient(flat, problem):
        return jax.grad(lambda flat: 0.5 * jnp.sum(_rows(loss, unravel(flat), (problem, scale)) ** 2))(flat)

    change = jax.jvp(lambda problem: gradient(flat, problem), (problem,), (tangents[1],))[1]
    hessian = jax.jacfwd(gradient)(flat, problem)
    return minimum, unravel(-jnp.linalg.solve(hessian, change))


def report(minimum: Minimum, known: Knowledge, names: tuple[str, ...], *, lens: CoordinateMap, **own: Any) -> Fit:
    """Returns the `Fit` of what was found and is known.

    Args:
        minimum: What `minimize` found.
        known: What `assess` said.
        names: Names of the shared parameters.
        lens: The map with the found parameters in it.
        own: Further fields of a `Fit` (`folds` at least), and those that this kind of fit sees in its own way.
    """
    common = {
        "frame": None,
        "poses": None,
        "names": names,
        "values": minimum.unknowns.shared,
        "covariance": known.covariance,
        "information": known.information,
        "inflation": known.inflation,
        "residuals": known.residuals,
        "rms": known.rms,
        "per_view_rms": None,
        "degrees_of_freedom": known.degrees_of_freedom,
        "loss_scale": minimum.loss_scale,
        "status_code": known.status_code,
        "steps": minimum.steps,
    }
    return Fit(lens=lens, **(common | own))


def assess(
    problem: Problem, minimum: Minimum, *, loss: Loss = "linear", further_parameters: int | Int[Array, ""] = 0
) -> Knowledge:
    """Returns what is known at the minimum of a problem: the covariance of the shared parameters, and a verdict.

    Args:
        problem: The problem.
        minimum: Where `minimize` ended.
        loss: The loss that was minimized.
        further_parameters: Parameters that the residuals have eliminated, to count in the degrees of freedom.

    Returns:
        A `Knowledge`. Its covariance is that of the least-squares estimate, with n − p degrees of freedom and the
        variance of the residuals; with a robust loss by Huber's formula. Parameters of blocks count as unknown. Its
        status is `RANK_DEFICIENT` where JᵀJ is singular to rounding (`jaxlens.linear`).

    Raises:
        ValueError: a loss that is none.

    Example:
        See `Problem`.
    """
    check_loss(loss, None)
    unknowns, weights = minimum.unknowns, problem.weights
    used = weights > 0
    normal, rows = normal_equations(lambda u: _flat(problem.weighted(u)), unknowns, fused=problem.fused)
    residuals = rows.reshape(*weights.shape, -1)
    components = residuals.shape[-1]
    count, blocks = unknowns.shared.shape[0], unknowns.blocks
    taken = jnp.any(used, axis=1)
    parameters = count + jnp.sum(taken) * blocks.shape[1] + further_parameters
    freedom = components * jnp.sum(used) - parameters

    # Columns of length one; what is left of them when each block has taken its part.
    lengths = jnp.sqrt(jnp.diagonal(normal.shared))
    unit = jnp.where(lengths > 0, 1 / jnp.where(lengths > 0, lengths, 1), 0)
    shared = normal.shared * unit[:, None] * unit[None]
    if blocks.shape[1]:
        cross = normal.cross * unit[None, :, None]
        # A block without data has nothing to tell, and must not spoil the others.
        own = jnp.where(taken[:, None, None], normal.blocks, jnp.eye(blocks.shape[1], dtype=blocks.dtype))
        shared = shared - jnp.einsum("vsb,vbt->st", cross, jnp.linalg.solve(own, jnp.swapaxes(cross, 1, 2)))
    # Of each column, what blocks could not explain as well: only the other shared parameters inflate beyond that.
    alone = jnp.diagonal(shared)
    finite = jnp.all(jnp.isfinite(shared))
    inverse, inflation, regular = invert_definite(
        shared, diagonal=jnp.ones(count, shared.dtype), rounding=squares_rounding(shared.dtype)
    )
    variance = _variance(residuals, used, loss, minimum.loss_scale, freedom, parameters)
    covariance = variance * inverse * unit[:, None] * unit[None]

    raw = residuals / jnp.sqrt(jnp.where(used, weights, 1))[..., None]
    squares = jnp.sum(residuals**2, axis=-1)
    status = jnp.where(regular, minimum.status_code, FitStatus.RANK_DEFICIENT)
    status = jnp.where(freedom < 0, FitStatus.TOO_FEW, status)
    status = jnp.where(jnp.all(jnp.isfinite(rows)) & finite, status, FitStatus.NOT_FINITE)
    return Knowledge(
        raw,
        covariance,
        shared,
        jnp.where(regular, inflation * alone, jnp.inf),
        jnp.sqrt(jnp.sum(squares) / jnp.sum(weights)),
        jnp.sqrt(jnp.sum(squares, axis=1) / jnp.sum(weights, axis=1)),
        freedom,
        status,
    )


def _variance(residuals, used, loss, scale, freedom, parameters):
    """Returns the variance of a residual component, as seen by the estimates: Huber (1981), Eq. 6.5 of section 7.6."""
    freedom = jnp.where(freedom > 0, freedom, jnp.nan)  # an exact fit says nothing about the noise
    if loss == "linear":
        return jnp.sum(residuals**2) / freedom
    curvature = _mean_slope(residuals, loss, scale)
    count = jnp.sum(used)
    mean = jnp.sum(jnp.where(used, curvature, 0)) / count
    spread = jnp.sum(jnp.where(used, (curvature - mean) ** 2, 0)) / count
    correction = 1 + parameters / (count * residuals.shape[-1]) * spread / mean**2
    return correction**2 * jnp.sum(influence(residuals, loss, scale) ** 2) / freedom / mean**2


def _mean_slope(residuals, loss, scale):
    """Returns the mean over components of ∂ψ_c/∂r_c, for each point."""
    components = residuals.shape[-1]
    total = 0.0
    for c in range(components):
        direction = jnp.zeros_like(residuals).at[..., c].set(1)
        total = total + jax.jvp(lambda r: influence(r, loss, scale), (residuals,), (direction,))[1][..., c]
    return total / components


def _flat(residuals: Array) -> Array:
    return residuals.reshape(residuals.shape[0], -1)
