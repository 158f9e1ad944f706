"""Levenberg–Marquardt on normal equations, as a solver for optimistix.

Fits here have few parameters and very many residuals. What must survive from one step to the next is then not the
tall Jacobian, of which optimistix's own Levenberg–Marquardt takes a QR decomposition at every step, but the small
matrix JᵀJ. Its condition is that of J squared; scaling the columns to length one keeps that harmless for every problem
in which the parameters are identified at all.

Parameters may be split into a shared part and blocks: the residuals of block i then depend on the shared parameters
and on block i alone (the pose of a view, in bundle adjustment). One directional derivative gives a column of every
block at once, and the Schur complement solves the arrow-shaped system without ever forming it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import lax
from jaxtyping import Array, Bool, Float, PyTree

from jaxlens.linear import solve_cholesky
from jaxlens.numerics import epsilon

_FIRST_DAMPING = 1e-6
# Damping below this changes nothing but how long it takes to come back.
_SMALLEST_DAMPING = 1e-10
# What is left to go may be this share of the standard error of any combination of the parameters.
_IMMATERIAL = 3e-6
# Parameters up to which JᵀJ is summed in one pass over the residuals: its sums grow as their square.
_FEW = 8
# Damping relative to the diagonal beyond which a step is a blind one along the gradient.
_LARGEST_DAMPING = 1e12


class Unknowns(eqx.Module):
    """The parameters of a fit.

    Attributes:
        shared: `(shared,)`, parameters that every residual may depend on.
        blocks: `(blocks, size)`, parameters of which each row touches only its own row of the residuals, as the pose
            of a view does; `(1, 0)` where there are none.
    """

    shared: Float[Array, "*batch shared"]
    blocks: Float[Array, "*batch blocks size"]

    @classmethod
    def dense(cls, values: Float[Array, " shared"]) -> "Unknowns":
        """Returns parameters without blocks."""
        return cls(values, jnp.zeros((1, 0), values.dtype))


class NormalEquations(eqx.Module):
    """What a least-squares problem looks like from a point, to second order.

    Attributes:
        loss: Half the sum of the squared residuals.
        gradient: Jᵀ r.
        shared: JᵀJ among the shared parameters.
        cross: JᵀJ between the shared parameters and each block.
        blocks: JᵀJ within each block.
    """

    loss: Float[Array, ""]
    gradient: Unknowns
    shared: Float[Array, "shared shared"]
    cross: Float[Array, "blocks shared size"]
    blocks: Float[Array, "blocks size size"]

    def diagonal(self) -> Unknowns:
        """Returns the diagonal of JᵀJ: the squared lengths of the columns of J."""
        return Unknowns(jnp.diagonal(self.shared), jnp.diagonal(self.blocks, axis1=1, axis2=2))

    def curvature(self, step: Unknowns) -> Float[Array, ""]:
        """Returns |J step|²."""
        along = jnp.einsum("vsb,vb->s", self.cross, step.blocks)
        within = jnp.einsum("va,vab,vb->", step.blocks, self.blocks, step.blocks)
        return step.shared @ (self.shared @ step.shared + 2 * along) + within


def jacobian_rows(
    function: Any, unknowns: Unknowns
) -> tuple[Float[Array, "blocks rows"], Float[Array, "blocks rows shared"], Float[Array, "blocks rows size"]]:
    """Returns residuals, their derivatives by the shared parameters, and those of each block by its own."""
    residual, derivative = jax.linearize(function, unknowns)
    blocks, size = unknowns.blocks.shape
    count = unknowns.shared.shape[0]
    dtype = unknowns.shared.dtype
    columns = jax.vmap(derivative, out_axes=-1)
    by_shared = columns(Unknowns(jnp.eye(count, dtype=dtype), jnp.zeros((count, blocks, size), dtype)))
    if size == 0:
        return residual, by_shared, jnp.zeros((*residual.shape, 0), dtype)
    each = jnp.broadcast_to(jnp.eye(size, dtype=dtype)[:, None], (size, blocks, size))
    return residual, by_shared, columns(Unknowns(jnp.zeros((size, count), dtype), each))


def normal_equations(
    function: Any, unknowns: Unknowns, *, fused: bool = False
) -> tuple[NormalEquations, Float[Array, "blocks rows"]]:
    """Returns the normal equations of a function's values, and the values.

    Args:
        function: Returns `(blocks, rows)`.
        unknowns: Where.
        fused: Compute the derivatives within the sums over them, on one thread, and write none to memory: for functions
            that cost less than that.
    """
    blocks, size = unknowns.blocks.shape
    if size == 0:
        gram, residual = _gram(function, unknowns, fused=fused)
        nothing = jnp.zeros((blocks, gram.shape[0] - 1, 0), gram.dtype)
        within = jnp.zeros((blocks, 0, 0), gram.dtype)
        gradient = Unknowns(gram[:-1, -1], unknowns.blocks)
        return NormalEquations(0.5 * gram[-1, -1], gradient, gram[:-1, :-1], nothing, within), residual
    residual, by_shared, by_block = jacobian_rows(function, unknowns)
    # The residuals ride along as one more column: all sums over them are then one matrix product.
    tall = jnp.concatenate([by_shared, residual[..., None]], axis=-1)
    gram = jnp.einsum("vna,vnb->ab", tall, tall)
    with_blocks = jnp.einsum("vns,vnb->vsb", tall, by_block)
    normal = NormalEquations(
        0.5 * gram[-1, -1],
        Unknowns(gram[:-1, -1], with_blocks[:, -1]),
        gram[:-1, :-1],
        with_blocks[:, :-1],
        jnp.einsum("vna,vnb->vab", by_block, by_block),
    )
    return normal, residual


def _gram(
    function: Any, unknowns: Unknowns, *, fused: bool
) -> tuple[Float[Array, "columns columns"], Float[Array, "blocks rows"]]:
    """Returns [J r]ᵀ [J r] of a function without blocks, and its values r."""
    count, dtype = unknowns.shared.shape[0], unknowns.shared.dtype
    if count > _FEW:
        residual, by_shared, _ = jacobian_rows(function, unknowns)
        tall = jnp.concatenate([by_shared, residual[..., None]], axis=-1).reshape(-1, count + 1)
        return tall.T @ tall, residual
    residual, derivative = jax.linearize(function, unknowns)
    if fused:
        units = [Unknowns(jnp.asarray(unit), unknowns.blocks) for unit in np.eye(count, dtype=dtype)]
        columns = [*map(derivative, units), residual]
    else:
        units = Unknowns(jnp.eye(count, dtype=dtype), jnp.zeros((count, *unknowns.blocks.shape), dtype))
        columns = lax.optimization_barrier([*jax.vmap(derivative)(units), residual])
    # All sums in one pass over the columns: a product of matrices as thin as these is half as fast.
    rows, places = np.tril_indices(count + 1)
    products = tuple(columns[row] * columns[place] for row, place in zip(rows, places, strict=True))
    zeros = tuple(jnp.zeros((), dtype) for _ in products)
    sums = lax.reduce(products, zeros, lambda old, new: tuple(map(jnp.add, old, new)), (0, 1))
    lower = jnp.zeros((count + 1, count + 1), dtype).at[rows, places].set(jnp.stack(sums))
    return lower + jnp.tril(lower, -1).T, residual


def solve(normal: NormalEquations, right: Unknowns, damping: Float[Array, ""]) -> Unknowns:
    """Solves (JᵀJ + damping · diagonal) step = right; NaN where that is not positive definite."""
    diagonal = normal.diagonal()
    scale = jax.tree.map(lambda values: jnp.where(values > 0, lax.rsqrt(values), 1), diagonal)
    identity = jnp.eye(right.shared.shape[0], dtype=right.shared.dtype)
    shared = normal.shared * scale.shared[:, None] * scale.shared[None] + damping * identity
    goal = right.shared * scale.shared
    if right.blocks.shape[1] == 0:
        return Unknowns(solve_cholesky(shared, goal[:, None])[0][:, 0] * scale.shared, right.blocks)
    size = jnp.eye(right.blocks.shape[1], dtype=right.blocks.dtype)
    blocks = normal.blocks * scale.blocks[:, :, None] * scale.blocks[:, None, :] + damping * size[None]
    cross = normal.cross * scale.shared[None, :, None] * scale.blocks[:, None, :]
    goals = right.blocks * scale.blocks
    # Per block: B⁻¹ [Cᵀ g].
    solved, _ = solve_cholesky(blocks, jnp.concatenate([jnp.swapaxes(cross, 1, 2), goals[..., None]], axis=2))
    into_shared, offset = solved[:, :, :-1], solved[:, :, -1]
    reduced = shared - jnp.einsum("vsb,vbt->st", cross, into_shared)
    step = solve_cholesky(reduced, (goal - jnp.einsum("vsb,vb->s", cross, offset))[:, None])[0][:, 0]
    return Unknowns(step * scale.shared, (offset - jnp.einsum("vbs,s->vb", into_shared, step)) * scale.blocks)


class _State(eqx.Module):
    candidate: Unknowns
    normal: NormalEquations
    change: Float[Array, ""]
    damping: Float[Array, ""]
    growth: Float[Array, ""]
    done: Bool[Array, ""]
    failed: Bool[Array, ""]


class NormalLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg–Marquardt with Nielsen's damping, Marquardt's scaling, and bounds by an active set.

    The residual function takes `Unknowns` and returns `(blocks, rows)`. Options: `lower` and `upper`, vectors of bounds
    on the shared parameters.

    Attributes:
        rtol: A step is the last when it moves the residuals by less than this share of what the parameters do to them,
            or the parameters by less than anyone could see in their standard errors.
        fused: As in `normal_equations`.
    """

    rtol: float
    atol: float = 0.0
    fused: bool = False
    norm: Any = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _State:
        """Starts before the first evaluation, at an infinite loss."""
        del fn, args, options, f_struct, aux_struct, tags
        dtype = y.shared.dtype
        shared, (blocks, size) = y.shared.shape[0], y.blocks.shape
        nothing = NormalEquations(
            jnp.asarray(jnp.inf, dtype),
            jax.tree.map(jnp.zeros_like, y),
            jnp.zeros((shared, shared), dtype),
            jnp.zeros((blocks, shared, size), dtype),
            jnp.zeros((blocks, size, size), dtype),
        )
        no = jnp.asarray(False)
        first = jnp.asarray(_FIRST_DAMPING, dtype)
        return _State(y, nothing, jnp.zeros((), dtype), first, jnp.asarray(2.0, dtype), no, no)

    def step(self, fn, y, args, options, state: _State, tags):
        """Judges the candidate, and proposes the next."""
        del tags
        eps = epsilon(y.shared.dtype)
        there, residual = normal_equations(lambda unknowns: fn(unknowns, args)[0], state.candidate, fused=self.fused)
        old = state.normal
        moved = jax.tree.map(jnp.subtract, state.candidate, y)
        predicted = -(_dot(old.gradient, moved) + 0.5 * old.curvature(moved))
        # NaN is not accepted; anything finite is better than the infinite loss before the first evaluation.
        accept = there.loss < old.loss
        first = jnp.isinf(old.loss)
        ratio = jnp.where(first, 0.5, (old.loss - there.loss) / jnp.where(predicted > 0, predicted, 1))
        normal = _where(accept, there, old)
        y = _where(accept, state.candidate, y)
        shrunk = state.damping * jnp.maximum(0.01, 1 - (2 * ratio - 1) ** 3)
        damping = jnp.where(accept, jnp.where(first, state.damping, shrunk), state.damping * state.growth)
        damping = jnp.maximum(damping, max(_SMALLEST_DAMPING, 8 * eps))
        growth = jnp.where(accept, 2.0, 2 * state.growth).astype(damping.dtype)

        frozen = _blocked(y.shared, normal.gradient.shared, options)
        normal_free = _freeze(normal, frozen)
        step = jax.tree.map(jnp.negative, solve(normal_free, normal_free.gradient, damping))
        regular = jnp.all(jnp.isfinite(step.shared)) & jnp.all(jnp.isfinite(step.blocks))
        damping = jnp.where(regular, damping, jnp.maximum(damping, 1e-8) * 10)
        step = jax.tree.map(lambda values: jnp.where(regular, values, 0), step)
        moved_to = jax.tree.map(jnp.add, y, step)
        candidate = Unknowns(_clip(moved_to.shared, options), moved_to.blocks)

        change = jnp.sqrt(jnp.maximum(normal_free.curvature(step), 0))
        effect = jnp.sqrt(_dot(normal.diagonal(), jax.tree.map(jnp.square, y)))
        noise = jnp.sqrt(2 * normal.loss / residual.size)
        # After a full step the next is shorter by the same ratio at least.
        left = change * jnp.where(accept & (change < state.change), change / state.change, 1)
        nothing_left = (change <= self.rtol * effect) | (left <= _IMMATERIAL * noise)
        small = regular & (damping < 1e-2) & nothing_left
        expected = -(_dot(normal_free.gradient, step) + 0.5 * normal_free.curvature(step))
        in_rounding = regular & ~accept & (expected <= 8 * eps * normal.loss)
        started = ~(first & ~accept)
        done = (small | in_rounding) & started
        hopeless = (damping > _LARGEST_DAMPING) | ~started
        # A step too small to matter is taken unseen: there is nothing an evaluation could say against it.
        y = _where(small, candidate, y)
        state = _State(candidate, normal, change, damping, growth, done, hopeless & ~done)
        return y, state, None

    def terminate(self, fn, y, args, options, state: _State, tags):
        """Stops after a small step, when only rounding is left to gain, or when nothing helps."""
        del fn, y, args, options, tags
        result = optx.RESULTS.where(state.failed, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return state.done | state.failed, result

    def postprocess(self, fn, y, aux, args, options, state: _State, tags, result):
        """Returns the last accepted point."""
        del fn, args, options, state, tags, result
        return y, aux, {}


def _dot(a: Unknowns, b: Unknowns) -> Float[Array, ""]:
    return a.shared @ b.shared + jnp.sum(a.blocks * b.blocks)


def _where(condition: Array, yes: PyTree, no: PyTree) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _clip(values: Array, options: dict) -> Array:
    return jnp.clip(values, options.get("lower"), options.get("upper"))


def _blocked(values: Array, gradient: Array, options: dict) -> Bool[Array, " shared"]:
    """Parameters at a bound that the gradient would push beyond it."""
    lower, upper = options.get("lower"), options.get("upper")
    frozen = jnp.zeros(values.shape, bool)
    if lower is not None:
        frozen |= (values <= lower) & (gradient > 0)
    if upper is not None:
        frozen |= (values >= upper) & (gradient < 0)
    return frozen


def _freeze(normal: NormalEquations, frozen: Bool[Array, " shared"]) -> NormalEquations:
    """Returns the normal equations in which frozen parameters stay where they are."""
    free = ~frozen
    shared = jnp.where(
        free[:, None] & free[None], normal.shared, jnp.diag(jnp.where(frozen, 1, 0).astype(normal.shared.dtype))
    )
    gradient = Unknowns(jnp.where(free, normal.gradient.shared, 0), normal.gradient.blocks)
    cross = jnp.where(free[None, :, None], normal.cross, 0)
    return NormalEquations(normal.loss, gradient, shared, cross, normal.blocks)
