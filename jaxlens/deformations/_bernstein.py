"""Rational Bernstein polynomials on the unit cube of any dimension: what free-form deformations are made of (Eq. 4).

A lattice of control points is held as *offsets* from the regular lattice, and a point's *displacement* is evaluated:
what is not deformed then stays where it is to the last bit, and rounding is that of the displacement and not of the
position.
"""

import operator
from collections.abc import Sequence
from functools import partial, reduce
from math import comb

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxlens.newton import implicit_point_root, solve_points
from jaxlens.numerics import epsilon

# Control points up to which sums are written out: several times faster, but long to compile for many.
_UNROLLED = 25
# Rounding, in units in the last place, that may part a point of the border from what it is mapped to.
_BORDER_ULPS = 64.0
# Points along each axis from which an inverse may start, by the number of axes.
_SAMPLES = {1: 64, 2: 8, 3: 4}


class Cube(eqx.Module):
    """A deformation of the unit cube [0, 1]ᵈ, in its own coordinates.

    Attributes:
        offsets: `(n1 + 1, …, nd + 1, d)`, control points less those of the regular lattice (i1 / n1, …, id / nd).
        weights: `(n1 + 1, …, nd + 1)`, positive; None stands for equal ones.
    """

    offsets: Float[Array, "*lattice dimensions"]
    weights: Float[Array, "*lattice"] | None

    def displacement(self, local: Float[Array, "*batch dimensions"]) -> Float[Array, "*batch dimensions"]:
        """Returns where Eq. 4 takes points of the cube, less the points themselves.

        With L the regular lattice and p = Σ B L, what a weighted mean adds to that of the offsets is Σ B w (L − p) /
        Σ B w. By s (1 − s) B′ᵢ = (i − n s) Bᵢ its numerator is, along each axis, s Σ Bᵢ (1 − i/n) (wᵢ₊₁ − wᵢ): no
        cancellation, however the weights differ, and zero where they do not.
        """
        dimensions = local.shape[-1]
        coordinates = tuple(local[..., axis] for axis in range(dimensions))
        if self.weights is None:
            return jnp.stack(_sums(coordinates, self.offsets), axis=-1)
        weights = self.weights[..., None]
        terms = jnp.concatenate([weights * self.offsets, _slopes(self.weights), weights], axis=-1)
        *moved, total = _sums(coordinates, terms)
        offsets, slopes = moved[:dimensions], moved[dimensions:]
        triples = zip(coordinates, offsets, slopes, strict=True)
        return jnp.stack([(offset + s * slope) / total for s, offset, slope in triples], axis=-1)

    def moved(self, local: Float[Array, "*batch dimensions"]) -> Float[Array, "*batch dimensions"]:
        """Returns where points of the cube go."""
        return local + self.displacement(local)

    def extended(self, local: Float[Array, "*batch dimensions"]) -> Float[Array, "*batch dimensions"]:
        """Returns where points go, those beyond the cube displaced as the nearest point of it.

        Bounded where the polynomial itself grows without limit.
        """
        above = jnp.where(local >= 0, local, 0)
        return local + self.displacement(jnp.where(above <= 1, above, 1))


def preimages(
    cube: Cube, target: Float[Array, "*batch dimensions"]
) -> tuple[Float[Array, "*batch dimensions"], Bool[Array, "*batch"], Bool[Array, "*batch"]]:
    """Returns the points of the cube that go to `target`, whether there are such, and whether the solver gave up.

    Newton's iteration for the extended deformation, from the targets themselves; those that this leaves start again,
    from one of the points of a grid if that is nearer. Then a root outside the cube is brought back to its border,
    where it counts if it is a root still. How far outside it may be depends on how steep the map is:
    the residual does not.

    Args:
        cube: The deformation.
        target: Finite points.
    """
    fixed, goal = lax.stop_gradient((cube, target))
    near = jnp.clip(goal, 0, 1)
    root, converged, at_fold = solve_points(fixed.extended, goal, near, restart=lambda goal: _first_guess(fixed, goal))
    root = jnp.clip(root, 0, 1)
    miss = jnp.max(jnp.abs(fixed.moved(root) - goal), axis=-1)
    rounding = _BORDER_ULPS * epsilon(goal.dtype) * jnp.maximum(1, jnp.max(jnp.abs(goal), axis=-1))
    found = converged & (miss <= rounding)
    solution = jnp.where(found[..., None], implicit_point_root(_residual, root, (cube, target)), root)
    return solution, found, ~converged & ~at_fold


def _first_guess(cube: Cube, target: Float[Array, "*batch dimensions"]) -> Float[Array, "*batch dimensions"]:
    """Returns the targets themselves, or the points of a grid that go nearest to them, whichever ends up nearer."""
    dimensions = target.shape[-1]
    grid = unit_lattice([_SAMPLES[dimensions]] * dimensions, target.dtype).reshape(-1, dimensions)
    seen = cube.moved(grid)

    def squared(points, goals):
        return reduce(operator.add, [(points[..., k] - goals[..., k]) ** 2 for k in range(dimensions)])

    best = jnp.argmin(squared(seen.reshape(*[1] * (target.ndim - 1), *seen.shape), target[..., None, :]), axis=-1)
    own, from_grid = jnp.clip(target, 0, 1), grid[best]
    nearer = squared(cube.moved(own), target) <= squared(seen[best], target)
    return jnp.where(nearer[..., None], own, from_grid)


def _residual(local: Array, parameters: tuple[Cube, Array]) -> Array:
    cube, target = parameters
    return cube.moved(local) - target


@jax.custom_jvp
def _sums(
    coordinates: tuple[Float[Array, "*batch"], ...], coefficients: Float[Array, "*lattice values"]
) -> Float[Array, " values *batch"]:
    """Returns `Σ B(s) B(t) … coefficients` over the lattice, a plane for each value.

    Its derivatives by a coordinate are sums of the same kind, of differences of coefficients and a degree less: several
    times cheaper than what automatic differentiation makes of the powers.
    """
    degrees = [size - 1 for size in coefficients.shape[:-1]]
    bases = [_basis(s, degree) for s, degree in zip(coordinates, degrees, strict=True)]
    if coefficients[..., 0].size <= _UNROLLED:
        # Planes that are summed one by one fuse into one loop, in which nothing is written to memory.
        return jnp.stack([_nested_sum(bases, plane) for plane in jnp.moveaxis(coefficients, -1, 0)])
    # The last axis by a product of matrices; single precision is not to be rounded to ten bits on a GPU.
    last = jnp.stack(bases[-1])
    rows = jnp.tensordot(jnp.swapaxes(coefficients, -1, -2), last, 1, precision=lax.Precision.HIGHEST)
    return _nested_sum([[plane[None] for plane in basis] for basis in bases[:-1]], rows)


@partial(_sums.defjvp, symbolic_zeros=True)
def _sums_jvp(primals, tangents):
    (coordinates, coefficients), (directions, change) = primals, tangents
    sums = _sums(coordinates, coefficients)
    parts = [] if _is_zero(change) else [_sums(coordinates, change)]
    for axis, direction in enumerate(directions):
        degree = coefficients.shape[axis] - 1
        if degree > 0 and not _is_zero(direction):
            slopes = _sums(coordinates, degree * jnp.diff(coefficients, axis=axis))
            parts.append(slopes * direction[None])
    return sums, reduce(operator.add, parts) if parts else jnp.zeros_like(sums)


def _is_zero(tangent) -> bool:
    return isinstance(tangent, jax.custom_derivatives.SymbolicZero)


def _basis(s: Float[Array, "*batch"], degree: int) -> list[Float[Array, "*batch"]]:
    """Returns the Bernstein polynomials of a degree.

    Products of positive numbers on [0, 1]: each is accurate to a few units in its last place, whatever the degree.
    """
    rising, falling = [jnp.ones_like(s)], [jnp.ones_like(s)]
    for _ in range(degree):
        rising.append(rising[-1] * s)
        falling.append(falling[-1] * (1 - s))
    return [comb(degree, i) * (rising[i] * falling[degree - i]) for i in range(degree + 1)]


def _nested_sum(bases: Sequence[Sequence[Array]], coefficients: Array) -> Array:
    if not bases:
        return coefficients
    parts = [basis * _nested_sum(bases[1:], part) for basis, part in zip(bases[0], coefficients, strict=True)]
    return reduce(operator.add, parts)


def _slopes(weights: Float[Array, "*lattice"]) -> Float[Array, "*lattice dimensions"]:
    """Returns (1 − i/n) (wᵢ₊₁ − wᵢ) along each axis; the last is zero."""
    slopes = []
    for axis, size in enumerate(weights.shape):
        share = (1 - np.arange(size - 1) / (size - 1)).reshape([-1 if k == axis else 1 for k in range(weights.ndim)])
        slope = jnp.diff(weights, axis=axis) * share.astype(weights.dtype)
        slopes.append(jnp.pad(slope, [(0, int(k == axis)) for k in range(weights.ndim)]))
    return jnp.stack(slopes, axis=-1)


def unit_lattice(shape: Sequence[int], dtype: jax.typing.DTypeLike) -> Float[Array, "*lattice dimensions"]:
    """Returns the regular lattice of the unit cube, of that many control points along each axis."""
    axes = [np.arange(size, dtype=np.float64) / (size - 1) for size in shape]
    return jnp.asarray(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), dtype)


def frozen_rows(
    shape: Sequence[int], continuity: int, sides: Sequence[str], names: Sequence[str]
) -> Bool[np.ndarray, "*lattice"]:
    """Returns which control points make a deformation leave the identity outside with continuous derivatives.

    Args:
        shape: Control points along each axis.
        continuity: Order k of the highest derivative that is continuous across the border: k + 1 rows are frozen.
        sides: The sides across which it is to be continuous.
        names: What the sides are called: the lower and the upper of each axis in turn.

    Raises:
        ValueError: an order below zero, an unknown side, or no control point left free.
    """
    if continuity < 0:
        raise ValueError(f"the order of continuity must be 0 or more, got {continuity}")
    unknown = [side for side in sides if side not in names]
    if unknown:
        raise ValueError(f"sides must be among {', '.join(names)}; got {unknown[0]!r}")
    frozen = np.zeros(shape, bool)
    for number, name in enumerate(names):
        if name in sides:
            rows = np.arange(shape[number // 2])
            rows = rows if number % 2 == 0 else rows[::-1]
            frozen |= np.expand_dims(rows <= continuity, [k for k in range(len(shape)) if k != number // 2])
    if frozen.all():
        degrees = tuple(size - 1 for size in shape)
        raise ValueError(
            f"continuity of order {continuity} across {', '.join(sides)} freezes all control points of a lattice of "
            f"degrees {degrees}: raise the degrees (two opposite sides need at least {2 * continuity + 2}), or "
            "ask for less"
        )
    return frozen
