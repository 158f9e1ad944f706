"""The inverse of any lens, from nothing but `distort`: Newton's iteration inside the region where it is one-to-one."""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int8

from jaxlens.batching import in_parts, in_turns
from jaxlens.lenses._first_guess import first_guess
from jaxlens.lenses._region import PlaneMap, Region, find_region
from jaxlens.maps import InverseStatus
from jaxlens.newton import complete, determinant, solve_points, value_and_jacobian
from jaxlens.numerics import epsilon, join, split

# Steps that the points of a part take together; those that are left are solved again with every safeguard.
_WHOLE_STEPS = 4
# In units in the last place: the residual at which a fused iteration has ended.
_ROOT_ULPS = 8.0

# Bisections on the ray of a point that is left, of a bracket this much wider than its radius to both sides.
_BISECTIONS, _WIDTH = 32, 2.0**100
# How much nearer than the nearest fold they end.
_MARGIN = 0.01

Plane = Float[Array, "*batch"]


@in_turns
def lies_inside(lens: Any, x: Plane, y: Plane) -> Bool[Array, "*batch"]:
    """Tells whether ideal points lie in the lens's region, by three numbers at most if all lie well inside."""
    region = find_region(lens.distort, jnp.zeros(2, x.dtype), lens.pole_radius())

    def by_its_place(x, y):
        return region.contains(lens.distort, x, y, determinant(value_and_jacobian(lens.distort, join(x, y))[1]))

    surely = jnp.all(region.surely(x, y))
    return lax.cond(surely, lambda x, y: jnp.ones(x.shape, bool), partial(in_parts, by_its_place), x, y)


@in_turns
def solve(lens: Any, x: Plane, y: Plane) -> tuple[Plane, Plane, Int8[Array, "*batch"]]:
    """Finds the ideal points of finite observed ones, without derivatives, and the `InverseStatus` of each.

    A point beyond the image of the region gets the origin.
    """
    function: PlaneMap = lens.distort
    region = find_region(function, jnp.zeros(2, x.dtype), lens.pole_radius())
    image = function(region.center)
    ratio = _radial_guess(function, region, x - image[0], y - image[1])

    def solve_part(x: Plane, y: Plane) -> tuple[Plane, Plane, Int8[Array, "*batch"]]:
        x, y, shape = x.ravel(), y.ravel(), x.shape
        target = x, y
        beyond = region.beyond(x - image[0], y - image[1])
        right, up = x - image[0], y - image[1]
        scale = ratio(jnp.sqrt(right * right + up * up))
        start = region.center[0] + right * scale, region.center[1] + up * scale

        def unfinished(state):
            steps, _, done = state
            return (steps < _WHOLE_STEPS) & ~jnp.all(done)

        def body(state):
            steps, root, done = state
            moved = _newton_step(function, root, target)
            # As one complex number: of two results the compiler would compute each by a loop of its own.
            number = lax.optimization_barrier(
                lax.complex(*(jnp.where(done, *pair) for pair in zip(root, moved, strict=True)))
            )
            root = jnp.real(number), jnp.imag(number)
            return steps + 1, root, beyond | is_settled(root)

        def is_settled(root):
            value = split(function(join(*root)))
            miss = jnp.maximum(jnp.abs(value[0] - x), jnp.abs(value[1] - y))
            size = jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.maximum(jnp.abs(root[0]), jnp.abs(root[1])))
            return (miss <= _ROOT_ULPS * epsilon(size.dtype) * size) & region.surely(*root)

        _, root, done = lax.while_loop(unfinished, body, (0, start, beyond))
        status = jnp.where(beyond, InverseStatus.NO_PREIMAGE, InverseStatus.CONVERGED).astype(jnp.int8)

        def solve_some(places: Array) -> tuple[Plane, Plane, Int8[Array, " batch"]]:
            goal = join(*(plane.at[places].get(mode="fill", fill_value=0) for plane in target))
            goal = jnp.where((places < x.size)[..., None], goal, image[None])
            found, converged, blocked = solve_points(
                function,
                goal,
                _on_its_ray(function, region, goal),
                admissible=lambda points, size: region.contains(function, points[..., 0], points[..., 1], size),
            )
            reason = jnp.where(blocked, InverseStatus.NO_PREIMAGE, InverseStatus.NOT_CONVERGED)
            return *split(found), jnp.where(converged, InverseStatus.CONVERGED, reason).astype(jnp.int8)

        root_x, root_y, status = complete((*root, status), ~done, solve_some)
        return root_x.reshape(shape), root_y.reshape(shape), status.reshape(shape)

    return in_parts(solve_part, x, y)


def _newton_step(function: PlaneMap, root: tuple[Plane, Plane], target: tuple[Plane, Plane]) -> tuple[Plane, Plane]:
    """Newton's step, unguarded, on planes throughout: stacked, the steps would not fuse."""

    def on_planes(x, y):
        return split(function(join(x, y)))

    one, zero = jnp.ones_like(root[0]), jnp.zeros_like(root[0])
    (u, v), (ux, vx) = jax.jvp(on_planes, root, (one, zero))
    _, (uy, vy) = jax.jvp(on_planes, root, (zero, one))
    inverse = 1 / (ux * vy - uy * vx)
    u, v = u - target[0], v - target[1]
    return root[0] - (vy * u - uy * v) * inverse, root[1] - (ux * v - vx * u) * inverse


def _on_its_ray(function: PlaneMap, region: Region, goal: Float[Array, "batch 2"]) -> Float[Array, "batch 2"]:
    """Returns, on the ray of each observed point, the ideal point that is seen as far out, before the nearest fold.

    Far out, where a high power rules, Newton's iteration would take long to get there from the centre.
    """
    x, y = split(goal)
    image = function(region.center)
    x, y = x - image[0], y - image[1]
    size = jnp.sqrt(x * x + y * y)
    unit = jnp.where(size > 0, 1 / jnp.where(size > 0, size, 1), 0)
    x, y = x * unit, y * unit

    def point(ideal: Array) -> Array:
        return join(region.center[0] + ideal * x, region.center[1] + ideal * y)

    def bisect(_, bracket):
        low, high = bracket
        middle = jnp.sqrt(low) * jnp.sqrt(high)
        u, v = split(function(point(middle)))
        u, v = u - image[0], v - image[1]
        nearer = u * u + v * v < size * size  # false, too, where the lens is no longer finite
        return jnp.where(nearer, middle, low), jnp.where(nearer, high, middle)

    nearest = (1 - _MARGIN) * jnp.min(region.edges)
    farthest = jnp.minimum(nearest, jnp.finfo(size.dtype).max)
    low, high = size / _WIDTH, jnp.minimum(size * _WIDTH, farthest)
    low, _ = lax.fori_loop(0, _BISECTIONS, bisect, (jnp.minimum(low, high), high))
    return point(low)


def _radial_guess(function: PlaneMap, region: Region, x: Plane, y: Plane) -> Callable[[Plane], Plane]:
    """Returns `first_guess` along the ray of the nearest fold, for observed points at offsets (x, y)."""
    nearest = jnp.argmin(region.edges)
    ray, image = region.rays[nearest], function(region.center)

    def radius(ideal):
        x, y = split(function(join(region.center[0] + ideal * ray[0], region.center[1] + ideal * ray[1])))
        return jnp.sqrt((x - image[0]) ** 2 + (y - image[1]) ** 2)

    return first_guess(radius, region.edges[nearest], region.observed[nearest], jnp.sqrt(x * x + y * y))
