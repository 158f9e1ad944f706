"""Newton's iteration in space: what `jaxlens.newton` is for points of a plane."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxlens.numerics import epsilon

_ROOT_ULPS = 8.0
_MAXIMUM_STEPS = 200
_SMALLEST_DAMPING = 2.0**-20

SpaceFunction = Callable[[Float[Array, "*batch 3"]], Float[Array, "*batch 3"]]


def solve_space(
    function: SpaceFunction, target: Float[Array, "*batch 3"], start: Float[Array, "*batch 3"]
) -> tuple[Float[Array, "*batch 3"], Bool[Array, "*batch"]]:
    """Solves `function(x) = target` for each point by damped Newton iteration that never crosses a fold.

    A step is shortened until it lowers the residual and stays where the Jacobian determinant is positive.

    Args:
        function: Pointwise and differentiable, written in units of about one, orientation preserving at `start`.
        target: Points to reach, finite.
        start: First guesses.

    Returns:
        The last iterates, always finite, and whether each has converged to the dtype's rounding.
    """
    target, start = lax.stop_gradient((target, start))
    tolerance = _ROOT_ULPS * epsilon(target.dtype)

    def size_of(residual):
        return jnp.max(jnp.abs(residual), axis=-1)

    def rounding(x):
        return tolerance * jnp.maximum(1, jnp.maximum(size_of(target), size_of(x)))

    def unfinished(state):
        count, *_, done = state
        return (count < _MAXIMUM_STEPS) & ~jnp.all(done)

    def body(state):
        count, x, residual, jacobian, damping, done = state
        candidate = x - damping[..., None] * solve_3x3(jacobian, residual)
        candidate = jnp.where(jnp.isfinite(candidate), candidate, x)
        value, slopes = space_jacobian(function, candidate)
        left = value - target
        better = (size_of(left) < size_of(residual)) & (determinant_3x3(slopes) > 0)
        take = better & ~done
        x = jnp.where(take[..., None], candidate, x)
        residual = jnp.where(take[..., None], left, residual)
        jacobian = jnp.where(take[..., None, None], slopes, jacobian)
        damping = jnp.where(better, jnp.minimum(1.0, 4 * damping), damping / 4)
        done = done | (size_of(residual) <= rounding(x)) | (damping < _SMALLEST_DAMPING)
        return count + 1, x, residual, jacobian, damping, done

    value, jacobian = space_jacobian(function, start)
    ones, no = jnp.ones(target.shape[:-1], target.dtype), jnp.zeros(target.shape[:-1], bool)
    _, x, residual, jacobian, _, _ = lax.while_loop(unfinished, body, (0, start, value - target, jacobian, ones, no))
    # Rounding may refuse the last step of a converged iteration: judge by how far Newton would still go, too.
    remaining = jnp.minimum(size_of(residual), size_of(solve_3x3(jacobian, residual)))
    return x, (remaining <= rounding(x)) & (determinant_3x3(jacobian) > 0)


def space_jacobian(
    function: SpaceFunction, points: Float[Array, "*batch 3"]
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3 3"]]:
    """Returns the value and the 3×3 Jacobian of a pointwise map of space (row: output, column: input)."""
    axes = jnp.eye(3, dtype=points.dtype)
    value, tangent = jax.linearize(function, points)
    columns = [tangent(jnp.broadcast_to(axis, points.shape)) for axis in axes]
    return value, jnp.stack(columns, axis=-1)


def determinant_3x3(matrix: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch"]:
    """Returns the determinants of 3×3 matrices."""
    a, b, c = matrix[..., 0], matrix[..., 1], matrix[..., 2]
    return jnp.sum(a * jnp.cross(b, c), axis=-1)


def adjugate_3x3(matrix: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3 3"]:
    """Returns the adjugates of 3×3 matrices: determinant times inverse, for singular ones too."""
    a, b, c = matrix[..., 0], matrix[..., 1], matrix[..., 2]
    return jnp.stack([jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)], axis=-2)


def solve_3x3(matrix: Float[Array, "*batch 3 3"], right: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Solves 3×3 systems by Cramer's rule; a singular one gets zero, not infinity."""
    size = determinant_3x3(matrix)[..., None]
    regular = jnp.abs(size) > jnp.finfo(size.dtype).tiny
    solution = jnp.sum(adjugate_3x3(matrix) * right[..., None, :], axis=-1)
    return jnp.where(regular, solution / jnp.where(regular, size, 1), 0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def implicit_space_root(residual: Callable[[Array, Any], Array], root: Array, parameters: Any) -> Array:
    """Is `jaxlens.newton.implicit_root` for points of space: `root` and the residual have shape (..., 3)."""
    del residual, parameters
    return root


@implicit_space_root.defjvp
def _implicit_space_root_jvp(residual, primals, tangents):
    root = implicit_space_root(residual, *primals)
    parameters, parameters_dot = primals[1], tangents[1]
    _, change = jax.jvp(lambda p: residual(root, p), (parameters,), (parameters_dot,))
    _, jacobian = space_jacobian(lambda x: residual(x, parameters), root)
    return root, -solve_3x3(jacobian, change)
