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
from jaxtyping import Array, Float, Int

from jaxlens.fitting._result import Fit, FitStatus
from jaxlens.fitting._robust import Loss, influence, noise_scale, robustify
from jaxlens.fitting._solver import NormalLevenbergMarquardt, Unknowns, normal_equations
from jaxlens.linear import invert_definite, squares_rounding
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import epsilon

# Rounds of estimating the noise, and fitting anew, and the relative change of the loss scale at which they end.
_ROUNDS = 10
_SETTLED = 1e-3


class Problem(eqx.Module):
    """Data, and the residuals that parameters leave in them.

    Attributes:
        weights: The weight of each point; points of weight zero do not count, and their residuals are zero.
    """

    weights: eqx.AbstractVar[Float[Array, "blocks points"]]
    fused: ClassVar[bool] = False
    """Whether residuals cost less than writing their derivatives to memory; see `normal_equations`."""

    @abc.abstractmethod
    def residuals(self, unknowns: Unknowns) -> Float[Array, "blocks points components"]:
        """Returns the residuals, not weighted; finite, with finite derivatives, even where the weight is zero."""

    def weighted(self, unknowns: Unknowns) -> Float[Array, "blocks points components"]:
        """Returns the residuals of which each component has the same variance."""
        used = self.weights > 0
        return self.residuals(unknowns) * jnp.where(used, jnp.sqrt(jnp.where(used, self.weights, 1)), 0)[..., None]


class Minimum(eqx.Module):
    """Where the loss is least: parameters, where the robust loss bends, how the solver got there."""

    unknowns: Unknowns
    loss_scale: Float[Array, ""]
    status: Int[Array, ""]
    steps: Int[Array, ""]


class Knowledge(eqx.Module):
    """What residuals and their derivatives tell about the shared parameters; attributes as of `Fit`."""

    residuals: Float[Array, "blocks points components"]
    covariance: Float[Array, "shared shared"]
    information: Float[Array, "shared shared"]
    inflation: Float[Array, " shared"]
    rms: Float[Array, ""]
    per_block_rms: Float[Array, " blocks"]
    degrees_of_freedom: Int[Array, ""]
    status: Int[Array, ""]


def minimize(
    problem: Problem,
    start: Unknowns,
    *,
    loss: Loss,
    loss_scale: Float[Array, ""] | None,
    bounds: tuple[Float[Array, " shared"], Float[Array, " shared"]] | None,
    max_steps: int,
) -> Minimum:
    """Minimizes the sum of the robust loss of a problem's residuals.

    The loss scale, unless given, follows from the median residual, in rounds. Differentiable in the problem, of every
    order, by the implicit function theorem at a fixed loss scale.
    """
    found = descend(problem, start, loss=loss, loss_scale=loss_scale, bounds=bounds, max_steps=max_steps)
    return differentiable(problem, found, loss)


def descend(
    problem: Problem,
    start: Unknowns,
    *,
    loss: Loss,
    loss_scale: Float[Array, ""] | None,
    bounds: tuple[Float[Array, " shared"], Float[Array, " shared"]] | None,
    max_steps: int,
) -> Minimum:
    """Is `minimize` without derivatives."""
    fixed, start = lax.stop_gradient((problem, start))
    if bounds is not None:
        start = Unknowns(jnp.clip(start.shared, *bounds), start.blocks)
    dtype = start.shared.dtype
    if loss == "linear" or loss_scale is not None:
        scale = jnp.asarray(jnp.inf if loss_scale is None or loss == "linear" else loss_scale, dtype)
        return _solve(fixed, start, loss, scale, bounds, max_steps)
    return _solve_in_rounds(fixed, start, loss, bounds, max_steps)


def differentiable(problem: Problem, found: Minimum, loss: Loss) -> Minimum:
    """Gives a minimum that was found its derivatives with respect to the problem."""
    unknowns = _implicit(loss, found.unknowns, problem, found.loss_scale)
    return Minimum(unknowns, found.loss_scale, found.status, found.steps)


def _solve_in_rounds(problem: Problem, start: Unknowns, loss: Loss, bounds: Any, max_steps: int) -> Minimum:
    """Estimates the loss scale and minimizes in turn, until the scale settles."""

    def unsettled(state):
        rounds, found, scale = state
        return (rounds < _ROUNDS) & ~(jnp.abs(scale - found.loss_scale) <= _SETTLED * scale)

    def one_round(state):
        rounds, found, scale = state
        better = _solve(problem, found.unknowns, loss, scale, bounds, max_steps)
        found = Minimum(better.unknowns, scale, better.status, found.steps + better.steps)
        return rounds + 1, found, noise_scale(problem.weighted(better.unknowns), problem.weights, loss)

    nothing = Minimum(start, jnp.zeros_like(start.shared, shape=()), jnp.asarray(FitStatus.MAX_STEPS), jnp.asarray(0))
    first = noise_scale(problem.weighted(start), problem.weights, loss)
    return lax.while_loop(unsettled, one_round, (jnp.asarray(0), nothing, first))[1]


def _solve(problem: Problem, start: Unknowns, loss: Loss, scale: Array, bounds: Any, max_steps: int) -> Minimum:
    # A step that changes the residuals by less than this leaves an error of its square, quadratic convergence given.
    solver = NormalLevenbergMarquardt(rtol=0.5 * epsilon(start.shared.dtype) ** 0.5, fused=problem.fused)
    options = {} if bounds is None else {"lower": bounds[0], "upper": bounds[1]}
    solution = optx.least_squares(
        partial(_rows, loss), solver, start, (problem, scale), options, max_steps=max_steps, throw=False
    )
    status: Array = jnp.where(
        solution.result == optx.RESULTS.successful,
        FitStatus.CONVERGED,
        jnp.where(solution.result == optx.RESULTS.nonlinear_divergence, FitStatus.DIVERGED, FitStatus.MAX_STEPS),
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
    """Returns the `Fit` of what was found and is known; `own` is what a kind of fit has, or sees in its own way."""
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
        "status_code": known.status,
        "steps": minimum.steps,
    }
    return Fit(lens=lens, **(common | own))


def assess(problem: Problem, minimum: Minimum, loss: Loss, further_parameters: int | Array = 0) -> Knowledge:
    """Returns what is known at the minimum of a problem.

    Args:
        problem: The problem.
        minimum: Where `minimize` ended.
        loss: The loss that was minimized.
        further_parameters: Parameters that the residuals have eliminated, to count in the degrees of freedom.
    """
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
    finite = jnp.all(jnp.isfinite(shared))
    inverse, inflation, regular = invert_definite(
        shared, diagonal=jnp.ones(count, shared.dtype), rounding=squares_rounding(shared.dtype)
    )
    variance = _variance(residuals, used, loss, minimum.loss_scale, freedom, parameters)
    covariance = variance * inverse * unit[:, None] * unit[None]

    raw = residuals / jnp.sqrt(jnp.where(used, weights, 1))[..., None]
    squares = jnp.sum(residuals**2, axis=-1)
    status = jnp.where(regular, minimum.status, FitStatus.RANK_DEFICIENT)
    status = jnp.where(freedom < 0, FitStatus.TOO_FEW, status)
    status = jnp.where(jnp.all(jnp.isfinite(rows)) & finite, status, FitStatus.NOT_FINITE)
    return Knowledge(
        raw,
        covariance,
        shared,
        inflation,
        jnp.sqrt(jnp.sum(squares) / jnp.sum(weights)),
        jnp.sqrt(jnp.sum(squares, axis=1) / jnp.sum(weights, axis=1)),
        freedom,
        status,
    )


def _variance(residuals, used, loss, scale, freedom, parameters):
    """The variance of a residual component, as seen by the estimates: Huber (1981), Eq. 6.5 of section 7.6."""
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
    """The mean over components of ∂ψ_c/∂r_c, for each point."""
    components = residuals.shape[-1]
    total = 0.0
    for c in range(components):
        direction = jnp.zeros_like(residuals).at[..., c].set(1)
        total = total + jax.jvp(lambda r: influence(r, loss, scale), (residuals,), (direction,))[1][..., c]
    return total / components


def _flat(residuals: Array) -> Array:
    return residuals.reshape(residuals.shape[0], -1)
