"""Roots by safeguarded Newton iteration, with derivatives from the implicit function theorem.

Finding a root and differentiating it are kept apart. The solvers below run on plain numbers and say which of
them converged; `implicit_root` then gives their result the derivatives that the equation implies. Nothing is
unrolled through, and because the rule calls itself, derivatives of every order follow, forward and reverse.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import max_dim, min_dim
from jaxtyping import Array, Bool, Float, Int

from jaxlens.memory import in_memory
from jaxlens.numerics import epsilon

# Steps taken in registers, unguarded, before anything is written to memory. From the starts used here they reach the
# last bits for all but a few per mille of the points; the rest are solved again with every safeguard.
_FUSED_STEPS = {2: 2, 4: 2, 8: 3}  # by bytes of the dtype
# In units in the last place: the residual at which an iteration stops, and the one that rounding alone can leave where
# the terms of a function cancel.
_ROOT_ULPS = 8.0
_ROUNDING_ULPS = 256.0
_MAXIMUM_STEPS = 200
# Elements, and points, that the second chance takes at a time.
_CHUNK = 8192
_BATCH = 1 << 14
# Whole steps that all points take together before those that are left go on with every safeguard.
_QUICK_STEPS = 8

ScalarFunction = Callable[[Float[Array, "*batch"]], Float[Array, "*batch"]]
PointFunction = Callable[[Float[Array, "*batch n"]], Float[Array, "*batch n"]]
Admissible = Callable[[Float[Array, "*batch n"], Float[Array, "*batch"]], Bool[Array, "*batch"]]
ValueAndSlope = Callable[[Float[Array, "*batch"]], tuple[Float[Array, "*batch"], Float[Array, "*batch"]]]


def solve_increasing(
    value_and_slope: ValueAndSlope,
    target: Float[Array, "*batch"],
    start: ScalarFunction,
    upper: Float[Array, ""],
) -> Float[Array, "*batch"]:
    """Solves `f(x) = target` for each element, where f rises from zero at zero up to `upper`.

    Newton's iteration, a fixed number of steps for all elements; those that it leaves unfinished, or outside the
    bracket, go to `solve_bracketed`.

    Args:
        value_and_slope: Gives f and its derivative; elementwise and differentiable. f increases on `[0, upper]` from
            f(0) = 0.
        target: Finite values that f takes there.
        start: Gives first guesses for targets.
        upper: The end of the bracket, may be ∞.

    Returns:
        The roots, to the rounding of f in the dtype of `target`: `is_root` tells. They carry no derivatives: see
        `implicit_root`.
    """
    shape = target.shape
    target, upper = lax.stop_gradient((target.ravel(), upper))
    x = start(target)
    for _ in range(_FUSED_STEPS[x.dtype.itemsize]):
        value, slope = value_and_slope(x)
        x = x - (value - target) / slope
    # Without the barrier XLA would compute the steps twice, for the test and for the result.
    x = lax.optimization_barrier(x)

    def function(x):
        return value_and_slope(x)[0]

    def found(x, target):
        return (x >= 0) & (x <= upper) & is_root(function(x), target, x, _ROOT_ULPS)

    # The second chance works on a chunk at a time, within the cache and in place: where nothing is left to do it
    # costs nothing, not even memory, and otherwise only the chunks with unfinished elements iterate.
    count = target.size
    size = min_dim(_CHUNK, count)

    def refine(state):
        chunk, x = state
        begin = jnp.minimum(chunk * size, count - size)  # the last chunk overlaps the one before
        goal, guess = (lax.dynamic_slice(values, (begin,), (size,)) for values in (target, x))
        guess = jnp.where(found(guess, goal), guess, start(goal))
        solved = solve_bracketed(function, goal, guess, jnp.zeros_like(upper), upper)
        return chunk + 1, lax.dynamic_update_slice(x, solved, (begin,))

    chunks = jnp.where(jnp.all(found(x, target)), 0, -(-count // max_dim(size, 1)))
    _, x = lax.while_loop(lambda state: state[0] < chunks, refine, (jnp.zeros_like(chunks), x))
    return x.reshape(shape)


def solve_bracketed(
    function: ScalarFunction,
    target: Float[Array, "*batch"],
    start: Float[Array, "*batch"],
    lower: Float[Array, "*#batch"],
    upper: Float[Array, "*#batch"],
) -> Float[Array, "*batch"]:
    """Solves `function(x) = target` for each element, where `function` rises from `lower` to `upper`.

    Halley's form of Newton's step (cubic near the root), inside a bracket that only shrinks: a step that would
    leave it is replaced by a bisection, or by a doubling while `upper` is infinite. It ends for every element: at its
    root, at a standstill, or between neighbouring floats. Arguments as of `solve_increasing`.
    """
    spacing = 2 * epsilon(start.dtype)

    def unfinished(state):
        count, _, _, _, done = state
        return (count < _MAXIMUM_STEPS) & ~jnp.all(done)

    def body(state):
        count, x, low, high, done = state
        candidate, low, high = _safeguarded_step(function, target, x, low, high)
        standstill = jnp.abs(candidate - x) <= spacing * jnp.abs(x)
        collapsed = jnp.isfinite(high) & (high - low <= spacing * jnp.abs(high))
        x = jnp.where(done, x, candidate)
        return count + 1, x, low, high, done | standstill | collapsed | is_root(function(x), target, x, _ROOT_ULPS)

    low, high = jnp.broadcast_to(lower, start.shape), jnp.broadcast_to(upper, start.shape)
    done = is_root(function(start), target, start, _ROOT_ULPS)
    return lax.while_loop(unfinished, body, (0, start, low, high, done))[1]


def is_root(
    value: Float[Array, "*batch"],
    target: Float[Array, "*batch"],
    x: Float[Array, "*batch"],
    ulps: float = _ROUNDING_ULPS,
) -> Bool[Array, "*batch"]:
    """Tells where `value`, a function at `x`, differs from `target` by no more than this much rounding."""
    return jnp.abs(value - target) <= ulps * epsilon(x.dtype) * jnp.maximum(jnp.abs(target), jnp.abs(x))


def _safeguarded_step(
    function: ScalarFunction, target: Array, x: Array, low: Array, high: Array
) -> tuple[Array, Array, Array]:
    """Takes one bracketed step; returns the new iterate and the bracket that the old one shrank."""
    value, slope, curvature = derivatives(function, x)
    residual = value - target
    low = jnp.where(residual <= 0, jnp.maximum(low, x), low)
    high = jnp.where(residual >= 0, jnp.minimum(high, x), high)
    # Halley's correction is held between half and twice Newton's step: at a fold it would bring every step to zero.
    # Written in ratios, because products of large slopes overflow, and a step of x / ∞ would look like a standstill.
    newton = residual / slope
    proposal = x - newton / (1 - jnp.clip(0.5 * newton * (curvature / slope), -1, 0.5))
    inside = (proposal >= low) & (proposal <= high) & jnp.isfinite(slope)  # false for NaN too
    halfway = jnp.where(jnp.isinf(high), 2 * x + 1, low + 0.5 * (high - low))
    return jnp.where(inside, proposal, halfway), low, high


def derivatives(function: ScalarFunction, x: Array) -> tuple[Array, Array, Array]:
    """Returns the value, slope and curvature of an elementwise function."""
    ones = jnp.ones_like(x)

    def first(x):
        return jax.jvp(function, (x,), (ones,))

    (value, slope), (_, curvature) = jax.jvp(first, (x,), (ones,))
    return value, slope, curvature


def solve_points(
    function: PointFunction,
    target: Float[Array, "*batch n"],
    start: Float[Array, "*batch n"],
    *,
    restart: Callable[[Float[Array, "*batch n"]], Float[Array, "*batch n"]] | None = None,
    admissible: Admissible | None = None,
) -> tuple[Float[Array, "*batch n"], Bool[Array, "*batch"], Bool[Array, "*batch"]]:
    """Solves `function(x) = target` for each point of a plane or of space by damped Newton iteration.

    A step is shortened until it lowers the residual *and* stays where the map is admissible, so that an iterate never
    crosses a fold: where the start lies in the one-to-one region around the target's preimage, the root found lies
    there too. Without a preimage the iterates stall at the fold.

    Args:
        function: Pointwise and differentiable, orientation preserving at `start`.
        target: Points to reach, finite.
        start: First guesses, admissible.
        restart: Gives better first guesses, for targets that these leave unsolved.
        admissible: Tells, from points and their Jacobian determinants, where iterates may stand; where the determinant
            is positive by default.

    Returns:
        The last iterates, always finite; whether each has converged to the dtype's rounding; and whether it stands,
        short of that, before a fold: a whole step would leave where the map is admissible.
    """
    target, start = lax.stop_gradient((target, start))
    allowed = _is_regular if admissible is None else admissible
    dimensions, shape = target.shape[-1], target.shape[:-1]
    count = math.prod(shape)
    if not isinstance(count, int) or count <= _BATCH:  # a size may be a symbol of `jax.export`
        return _solve_carefully(function, target, start if restart is None else restart(target), allowed)
    target, start = target.reshape(count, dimensions), start.reshape(count, dimensions)
    x, settled = _solve_quickly(function, target, start, allowed)

    def solve(places: Array) -> tuple[Array, Array, Array]:
        goal = target.at[places].get(mode="clip")
        guess = start.at[places].get(mode="clip") if restart is None else restart(goal)
        return _solve_carefully(function, goal, guess, allowed)

    x, settled, at_fold = complete((x, settled, jnp.zeros_like(settled)), ~settled, solve)
    return x.reshape(*shape, dimensions), settled.reshape(shape), at_fold.reshape(shape)


def _is_regular(points: Array, determinants: Array) -> Bool[Array, "*batch"]:
    return determinants > 0


def complete(
    answers: tuple[Array, ...], left: Bool[Array, " count"], solve: Callable[[Array], tuple[Array, ...]]
) -> tuple[Array, ...]:
    """Replaces the answers that are left to be found, a batch of them at a time; where none is, that costs nothing.

    Args:
        answers: Arrays whose first axis is that of the problems.
        left: Which of them are to be replaced.
        solve: Takes the places of some of the problems, one past the end where there are no more, to their answers.
    """
    count = left.shape[0]
    batch = min_dim(_BATCH, count)

    def refine(state):
        places = _first_places(jnp.cumsum(state[-1]), jnp.arange(1, batch + 1))
        found = (*solve(places), jnp.zeros(batch, bool))
        return tuple(values.at[places].set(better, mode="drop") for values, better in zip(state, found, strict=True))

    return lax.while_loop(lambda state: jnp.any(state[-1]), refine, (*answers, left))[:-1]


def _first_places(counts: Int[Array, " size"], ranks: Int[Array, " batch"]) -> Int[Array, " batch"]:
    """Returns the first place at which rising counts reach each rank, or their end.

    Is `jnp.searchsorted`, which cannot do with a size that is a symbol of `jax.export`.
    """

    def halve(bracket):
        low, high = bracket
        middle = low + (high - low) // 2
        before = (low < high) & (counts[middle] < ranks)
        return jnp.where(before, middle + 1, low), jnp.where(before, high, middle)

    bracket = jnp.zeros_like(ranks), jnp.full_like(ranks, counts.size)
    return lax.while_loop(lambda bracket: jnp.any(bracket[0] < bracket[1]), halve, bracket)[0]


def _solve_quickly(
    function: PointFunction, target: Float[Array, "count n"], start: Float[Array, "count n"], allowed: Admissible
) -> tuple[Float[Array, "count n"], Bool[Array, " count"]]:
    """Takes the whole steps of `_solve_carefully` for all points at once, as long as each is one that it would take.

    On planes: arithmetic on them is vectorized. Returns the iterates, and which of them have converged.
    """
    goal = _planes(target)

    def unfinished(state):
        steps, *_, good, settled = state
        return (steps < _QUICK_STEPS) & jnp.any(good & ~settled)

    def body(state):
        steps, x, before, good, settled = state
        value, columns = in_memory(lambda: _linearized(function, x), target)
        residual = [v - g for v, g in zip(value, goal, strict=True)]
        jacobian = jnp.stack([jnp.stack(column, axis=-1) for column in columns], axis=-1)
        points, left = jnp.stack(x, axis=-1), jnp.stack(residual, axis=-1)
        size = _size(left)
        good = good & (settled | (size < before) & allowed(points, determinant(jacobian)))
        settled = settled | good & (size <= _rounding(target, points))
        moves = good & ~settled
        step = _planes(solve_small(jacobian, left))
        x = tuple(jnp.where(moves, old - change, old) for old, change in zip(x, step, strict=True))
        return steps + 1, x, size, good, settled

    everywhere = jnp.ones(target.shape[0], bool)
    state = (0, _planes(start), jnp.full(target.shape[0], jnp.inf, target.dtype), everywhere, ~everywhere)
    _, x, _, _, settled = lax.while_loop(unfinished, body, state)
    return jnp.stack(x, axis=-1), settled


def _planes(points: Float[Array, "*batch n"]) -> tuple[Float[Array, "*batch"], ...]:
    return tuple(points[..., k] for k in range(points.shape[-1]))


def _linearized(function: PointFunction, x: tuple[Array, ...]) -> tuple[tuple[Array, ...], list[tuple[Array, ...]]]:
    """Returns the value and the columns of the Jacobian, plane by plane."""
    value, jacobian = value_and_jacobian(function, jnp.stack(x, axis=-1))
    return _planes(value), [_planes(jacobian[..., k]) for k in range(len(x))]


def _rounding(target: Float[Array, "*batch n"], x: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Returns the residual at which an iteration has converged."""
    unit = epsilon(target.dtype)
    return _ROOT_ULPS * unit * (jnp.maximum(_size(target), _size(x)) + unit)


def _solve_carefully(
    function: PointFunction, target: Float[Array, "*batch n"], start: Float[Array, "*batch n"], allowed: Admissible
) -> tuple[Float[Array, "*batch n"], Bool[Array, "*batch"], Bool[Array, "*batch"]]:
    """Does what `solve_points` does, for all points with every safeguard."""
    tolerance = _ROOT_ULPS * epsilon(target.dtype)
    rounding = partial(_rounding, target)

    def standstill(x):
        # Nearer than this to a fold the residual does not tell places apart: it is quadratic there.
        return epsilon(target.dtype) ** 0.5 * (_size(target) + _size(x) + epsilon(target.dtype))

    def unfinished(state):
        count, *_, done = state
        return (count < _MAXIMUM_STEPS) & ~jnp.all(done)

    def body(state):
        count, x, residual, jacobian, damping, done = state
        candidate = x - damping[..., None] * solve_small(jacobian, residual)
        candidate = jnp.where(jnp.isfinite(candidate), candidate, x)
        value, slopes = value_and_jacobian(function, candidate)
        left = value - target
        may = allowed(candidate, determinant(slopes))
        lower = _size(left) < _size(residual)
        refused = ~(may & lower)
        take = ~refused & ~done
        step = _size(candidate - x)
        x = jnp.where(take[..., None], candidate, x)
        residual = jnp.where(take[..., None], left, residual)
        jacobian = jnp.where(take[..., None, None], slopes, jacobian)
        # An accepted step earns a bolder one, a refused one a more careful one; at the smallest nothing helps.
        damping = jnp.where(refused, damping / 4, jnp.minimum(1.0, 4 * damping))
        done = done | (_size(residual) <= rounding(x)) | (damping < 1) & refused & (step <= standstill(x))
        return count + 1, x, residual, jacobian, damping, done

    value, jacobian = value_and_jacobian(function, start)
    residual = value - target
    state = (
        0,
        start,
        residual,
        jacobian,
        jnp.ones(target.shape[:-1], target.dtype),
        _size(residual) <= rounding(start),
    )
    _, x, residual, jacobian, _, _ = lax.while_loop(unfinished, body, state)
    # Rounding may refuse the last step of a converged iteration: judge by how far Newton would still go, too, in units
    # of about one, in which maps are written.
    step = solve_small(jacobian, residual)
    remaining = _size(step)
    close = (_size(residual) <= rounding(x)) | (remaining <= tolerance * jnp.maximum(_size(x), 1))
    converged = close & allowed(x, determinant(jacobian))
    # Next to a fold the Jacobian is nearly singular, and a whole step leaps over it.
    whole = x - step
    blocked = ~allowed(whole, determinant(value_and_jacobian(function, whole)[1])) | _is_nearly_singular(jacobian)
    return x, converged, blocked & ~converged


def _size(vectors: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    return jnp.max(jnp.abs(vectors), axis=-1)


def _is_nearly_singular(matrix: Float[Array, "*batch n n"]) -> Bool[Array, "*batch"]:
    """Tells whether the determinant is as small, beside the matrix, as where a step stands still before a fold."""
    size = jnp.sqrt(jnp.sum(matrix * matrix, axis=(-2, -1)))
    return determinant(matrix) <= 16 * epsilon(matrix.dtype) ** 0.5 * size ** matrix.shape[-1]


def value_and_jacobian(
    function: PointFunction, points: Float[Array, "*batch n"]
) -> tuple[Float[Array, "*batch n"], Float[Array, "*batch n n"]]:
    """Returns the value and the Jacobian of a pointwise map of points (row: output, column: input)."""
    axes = jnp.eye(points.shape[-1], dtype=points.dtype)
    # The compiler sees that the value is computed alike each time; `jax.linearize` keeps loops from fusing.
    pairs = [jax.jvp(function, (points,), (jnp.broadcast_to(axis, points.shape),)) for axis in axes]
    return pairs[0][0], jnp.stack([column for _, column in pairs], axis=-1)


def determinant(matrix: Float[Array, "*batch n n"]) -> Float[Array, "*batch"]:
    """Returns the determinant of 2×2 or 3×3 matrices."""
    if matrix.shape[-1] == 2:
        return matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]
    a, b, c = matrix[..., 0], matrix[..., 1], matrix[..., 2]
    return jnp.sum(a * jnp.cross(b, c), axis=-1)


def adjugate(matrix: Float[Array, "*batch n n"]) -> Float[Array, "*batch n n"]:
    """Returns the adjugate of 2×2 or 3×3 matrices: determinant times inverse, for singular ones too."""
    if matrix.shape[-1] == 2:
        first = jnp.stack([matrix[..., 1, 1], -matrix[..., 0, 1]], axis=-1)
        return jnp.stack([first, jnp.stack([-matrix[..., 1, 0], matrix[..., 0, 0]], axis=-1)], axis=-2)
    a, b, c = matrix[..., 0], matrix[..., 1], matrix[..., 2]
    return jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], axis=-2)


def solve_small(matrix: Float[Array, "*batch n n"], right: Float[Array, "*batch n"]) -> Float[Array, "*batch n"]:
    """Solves 2×2 or 3×3 systems by Cramer's rule; a singular one gets zero, not infinity."""
    size = determinant(matrix)
    regular = jnp.abs(size) > jnp.finfo(size.dtype).tiny
    inverse = jnp.where(regular, 1, 0) / jnp.where(regular, size, 1)
    rows, n = adjugate(matrix), matrix.shape[-1]
    products = [sum(rows[..., i, j] * right[..., j] for j in range(n)) for i in range(n)]
    return jnp.stack([jnp.where(regular, product * inverse, 0) for product in products], axis=-1)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def implicit_root(residual: Callable[[Array, Any], Array], root: Array, parameters: Any) -> Array:
    """Gives `root` the derivatives of the solution of `residual(root, parameters) = 0`.

    Args:
        residual: A function at module level (it is compared by identity), elementwise in `root`.
        root: The solution, already found. Its own derivatives are ignored.
        parameters: What the equation depends on; derivatives are with respect to these.

    Returns:
        `root`, unchanged in value: d root = −(∂residual/∂parameters · d parameters) / (∂residual/∂root). Where the
        denominator vanishes (a fold) the derivative is infinite, and zero is used instead, so that masked elements
        do not poison their neighbours.
    """
    del residual, parameters
    return root


@implicit_root.defjvp
def _implicit_root_jvp(residual, primals, tangents):
    root = implicit_root(residual, *primals)
    parameters, parameters_dot = primals[1], tangents[1]
    _, change = jax.jvp(lambda p: residual(root, p), (parameters,), (parameters_dot,))
    _, slope = jax.jvp(lambda x: residual(x, parameters), (root,), (jnp.ones_like(root),))
    regular = jnp.abs(slope) > epsilon(slope.dtype) ** 2
    return root, jnp.where(regular, -change / jnp.where(regular, slope, 1), 0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def implicit_point_root(residual: Callable[[Array, Any], Array], root: Array, parameters: Any) -> Array:
    """Does what `implicit_root` does, for points: `root` and the residual have shape `(..., n)`, n two or three."""
    del residual, parameters
    return root


@implicit_point_root.defjvp
def _implicit_point_root_jvp(residual, primals, tangents):
    root = implicit_point_root(residual, *primals)
    parameters, parameters_dot = primals[1], tangents[1]
    _, change = jax.jvp(lambda p: residual(root, p), (parameters,), (parameters_dot,))
    _, jacobian = value_and_jacobian(lambda x: residual(x, parameters), root)
    return root, -solve_small(jacobian, change)
