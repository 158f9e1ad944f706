"""The inverse of any lens, from nothing but `distort`: Newton's iteration inside the region where it is one-to-one."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int8

from jaxlens.batching import in_turns
from jaxlens.lenses._region import PlaneMap, Region, find_region
from jaxlens.maps import InverseStatus
from jaxlens.newton import complete, derivatives, determinant, solve_points, value_and_jacobian
from jaxlens.numerics import epsilon, join, split

# Steps taken in registers, unguarded; what they leave unfinished is solved again with every safeguard.
_FUSED_STEPS = {4: 5, 8: 6}  # by bytes of the dtype
# In units in the last place: the residual at which a fused iteration has ended.
_ROOT_ULPS = 8.0

Plane = Float[Array, "*batch"]


@in_turns
def lies_inside(lens: Any, x: Plane, y: Plane) -> Bool[Array, "*batch"]:
    """Whether ideal points lie in the lens's region: at most three numbers to compare if all lie well inside."""
    region = find_region(lens.distort, jnp.zeros(2, x.dtype))

    def by_its_place(x, y):
        return region.contains(x, y, determinant(value_and_jacobian(lens.distort, join(x, y))[1]))

    surely = jnp.all(region.surely(x, y))
    return lax.cond(surely, lambda x, y: jnp.ones(x.shape, bool), by_its_place, x, y)


@in_turns
def solve(lens: Any, x: Plane, y: Plane) -> tuple[Plane, Plane, Int8[Array, "*batch"]]:
    """Finds the ideal points of finite observed ones, without derivatives, and the `InverseStatus` of each.

    A point beyond the image of the region gets the origin.
    """
    function: PlaneMap = lens.distort
    shape = x.shape
    target = x.ravel(), y.ravel()
    region = find_region(function, jnp.zeros(2, x.dtype))
    image = function(region.center)
    beyond = region.beyond(target[0] - image[0], target[1] - image[1])
    root = _start(function, region, target[0] - image[0], target[1] - image[1])
    for _ in range(_FUSED_STEPS[x.dtype.itemsize]):
        root = _newton_step(function, root, target)
    # As one complex number: of two results the compiler would compute each by a loop of its own, with all the steps.
    number = lax.optimization_barrier(lax.complex(*root))
    root = jnp.real(number), jnp.imag(number)

    def settled(root, target):
        value = split(function(join(*root)))
        miss = jnp.maximum(jnp.abs(value[0] - target[0]), jnp.abs(value[1] - target[1]))
        size = jnp.maximum(jnp.abs(target[0]), jnp.abs(target[1]))
        size = jnp.maximum(size, jnp.maximum(jnp.abs(root[0]), jnp.abs(root[1])))
        return (miss <= _ROOT_ULPS * epsilon(size.dtype) * size) & region.surely(*root)

    done = settled(root, target) | beyond
    status = jnp.where(beyond, InverseStatus.NO_PREIMAGE, InverseStatus.CONVERGED).astype(jnp.int8)

    def solve_some(places: Array) -> tuple[Plane, Plane, Int8[Array, " batch"]]:
        goal = join(*(plane.at[places].get(mode="fill", fill_value=0) for plane in target))
        goal = jnp.where((places < x.size)[..., None], goal, image[None])
        start = jnp.broadcast_to(region.center, goal.shape)
        found, converged, blocked = solve_points(
            function, goal, start, admissible=lambda points, size: region.contains(*split(points), size)
        )
        reason = jnp.where(blocked, InverseStatus.NO_PREIMAGE, InverseStatus.NOT_CONVERGED)
        return *split(found), jnp.where(converged, InverseStatus.CONVERGED, reason).astype(jnp.int8)

    root_x, root_y, status = complete((*root, status), ~done, solve_some)
    return root_x.reshape(shape), root_y.reshape(shape), status.reshape(shape)


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


def _start(function: PlaneMap, region: Region, x: Plane, y: Plane) -> tuple[Plane, Plane]:
    """First guesses for observed points at offsets (x, y) from the image of the centre.

    The points themselves, if the lens never folds. Else, near the nearest fold r ≈ edge − C (fold − ρ)²: a cubic in
    √(1 − r / edge) that agrees with the lens to first order at centre and fold.
    """
    nearest = jnp.argmin(region.edges)
    folds = jnp.isfinite(region.edges[nearest])
    fold, edge = (jnp.where(folds, radii[nearest], 1) for radii in (region.edges, region.observed))
    ray = region.rays[nearest]

    def observed_radius(radius):
        return jnp.sqrt(jnp.sum((function(region.center + radius * ray) - function(region.center)) ** 2))

    curvature = -0.5 * derivatives(observed_radius, fold)[2]
    bend = jnp.sqrt(edge / jnp.maximum(curvature, 0.25 * edge / fold**2)) / fold
    slope = 3 - 2 * bend - 2 * edge / fold
    radius = jnp.sqrt(x * x + y * y)
    root = jnp.sqrt(jnp.maximum(1 - radius / edge, 0))
    share = jnp.clip(1 - root * (bend + root * (slope + root * (1 - bend - slope))), 0, 1)
    scale = jnp.where(folds, jnp.where(radius > 0, fold * share / jnp.where(radius > 0, radius, 1), 1), 1)
    return region.center[0] + x * scale, region.center[1] + y * scale
