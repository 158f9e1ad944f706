"""Roots by safeguarded Newton iteration, with derivatives from the implicit function theorem.

Finding a root and differentiating it are kept apart. The solvers below run on plain numbers and say which of
them converged; `implicit_root` then gives their result the derivatives that the equation implies. Nothing is
unrolled through, and because the rule calls itself, derivatives of every order follow, forward and reverse.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxlens.numerics import epsilon, join

# Steps taken in registers, unguarded, before anything is written to memory. From the starts used here they reach the
# last bits for all but a few per mille of the points; the rest are solved again with every safeguard.
_FUSED_STEPS = {2: 4, 4: 6, 8: 7}  # by bytes of the dtype
# In units in the last place: the residual at which an iteration stops, and the one that rounding alone can leave where
# the terms of a function cancel.
_ROOT_ULPS = 8.0
_ROUNDING_ULPS = 256.0
_MAXIMUM_STEPS = 200
# Elements that the second chance takes at a time.
_CHUNK = 8192

ScalarFunction = Callable[[Float[Array, "*batch"]], Float[Array, "*batch"]]
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
    size = min(_CHUNK, count)

    def refine(state):
        chunk, x = state
        begin = jnp.minimum(chunk * size, count - size)  # the last chunk overlaps the one before
        goal, guess = (lax.dynamic_slice(values, (begin,), (size,)) for values in (target, x))
        guess = jnp.where(found(guess, goal), guess, start(goal))
        solved = solve_bracketed(function, goal, guess, jnp.zeros_like(upper), upper)
        return chunk + 1, lax.dynamic_update_slice(x, solved, (begin,))

    chunks = jnp.where(jnp.all(found(x, target)), 0, -(-count // max(size, 1)))
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
    """One bracketed step; returns the new iterate and the bracket that the old one shrank."""
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


def solve_plane(
    function: Callable[[Float[Array, "*batch 2"]], Float[Array, "*batch 2"]],
    target: Float[Array, "*batch 2"],
    start: Float[Array, "*batch 2"],
) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
    """Solves `function(x) = target` for each point of a plane by damped Newton iteration.

    A step is halved until it lowers the residual *and* stays where the Jacobian determinant is positive, so that
    an iterate never crosses a fold: where the start lies in the one-to-one region around the target's preimage, the
    root found lies there too. Without a preimage the iterates stall at the fold, and the point is not converged.

    Args:
        function: Pointwise and differentiable, orientation preserving at `start`.
        target: Points to reach, finite.
        start: First guesses.

    Returns:
        The last iterates, always finite, and whether each has converged to the dtype's rounding.
    """
    target, start = lax.stop_gradient(target), lax.stop_gradient(start)
    tolerance = _ROOT_ULPS * epsilon(target.dtype)
    smallest_damping = 2.0**-20

    def residual_size(residual):
        return jnp.max(jnp.abs(residual), axis=-1)

    def scale(x):
        return jnp.maximum(residual_size(target), residual_size(x)) + epsilon(target.dtype)

    def unfinished(state):
        count, _, _, done = state
        return (count < _MAXIMUM_STEPS) & ~jnp.all(done)

    def body(state):
        count, x, damping, done = state
        value, jacobian = plane_jacobian(function, x)
        residual = value - target
        candidate = x - damping[..., None] * solve_2x2(jacobian, residual)
        candidate = jnp.where(jnp.isfinite(candidate), candidate, x)
        value_there, jacobian_there = plane_jacobian(function, candidate)
        size, size_there = residual_size(residual), residual_size(value_there - target)
        better = (size_there < size) & (determinant(jacobian_there) > 0)
        x = jnp.where((better & ~done)[..., None], candidate, x)
        found = jnp.where(better, size_there, size) <= tolerance * scale(x)
        # An accepted step earns a bolder one, a refused one a more careful one; at the smallest nothing helps.
        damping = jnp.where(better, jnp.minimum(1.0, 4 * damping), damping / 4)
        return count + 1, x, damping, done | found | (damping < smallest_damping)

    ones = jnp.ones(target.shape[:-1], target.dtype)
    _, x, _, _ = lax.while_loop(unfinished, body, (0, start, ones, jnp.zeros(target.shape[:-1], bool)))
    # Rounding may refuse the last step of a converged iteration: judge by how far Newton would still go.
    value, jacobian = plane_jacobian(function, x)
    residual = value - target
    remaining = residual_size(solve_2x2(jacobian, residual))
    rounding = tolerance * jnp.maximum(scale(x), 1)  # of a map that is written in units of about one
    close = (residual_size(residual) <= tolerance * scale(x)) | (remaining <= rounding)
    return x, close & (determinant(jacobian) > 0)


def plane_jacobian(
    function: Callable[[Array], Array], points: Float[Array, "*batch 2"]
) -> tuple[Float[Array, "*batch 2"], Float[Array, "*batch 2 2"]]:
    """Returns the value and the 2×2 Jacobian of a pointwise map of the plane (row: output, column: input)."""
    zeros, ones = jnp.zeros_like(points[..., 0]), jnp.ones_like(points[..., 0])
    value, along_x = jax.jvp(function, (points,), (join(ones, zeros),))
    _, along_y = jax.jvp(function, (points,), (join(zeros, ones),))
    return value, jnp.stack([along_x, along_y], axis=-1)


def determinant(matrix: Float[Array, "*batch 2 2"]) -> Float[Array, "*batch"]:
    """Returns the determinant of 2×2 matrices."""
    return matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]


def solve_2x2(matrix: Float[Array, "*batch 2 2"], right: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
    """Solves 2×2 systems by Cramer's rule; a singular one gets zero, not infinity."""
    size = determinant(matrix)
    regular = jnp.abs(size) > jnp.finfo(size.dtype).tiny
    size = jnp.where(regular, size, 1)
    x = (matrix[..., 1, 1] * right[..., 0] - matrix[..., 0, 1] * right[..., 1]) / size
    y = (matrix[..., 0, 0] * right[..., 1] - matrix[..., 1, 0] * right[..., 0]) / size
    return join(jnp.where(regular, x, 0), jnp.where(regular, y, 0))


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
def implicit_plane_root(residual: Callable[[Array, Any], Array], root: Array, parameters: Any) -> Array:
    """Is `implicit_root` for points of a plane: `root` and the residual have shape (..., 2)."""
    del residual, parameters
    return root


@implicit_plane_root.defjvp
def _implicit_plane_root_jvp(residual, primals, tangents):
    root = implicit_plane_root(residual, *primals)
    parameters, parameters_dot = primals[1], tangents[1]
    _, change = jax.jvp(lambda p: residual(root, p), (parameters,), (parameters_dot,))
    _, jacobian = plane_jacobian(lambda x: residual(x, parameters), root)
    return root, -solve_2x2(jacobian, change)
