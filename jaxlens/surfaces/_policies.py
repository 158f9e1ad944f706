"""Shortest ways on a grid of heights: for each pixel, the point between two of its neighbours that its way comes from.

With T the distance, T(X) = min over Y of T(Y) + |X − Y|, where Y runs along the edge between two neighbours. T itself
would be interpolated poorly between them, above all near the source S; what it exceeds the straight line by,
u = T − |X − S|, is zero on planes and smooth at the source. So u is interpolated, and the straight line is exact:

    u(X) = min over share of (1 − share) u(B) + share u(A) + c,
    c = |X − Y| + |Y − S| − |X − S|,   Y = B + share (A − B).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxlens.surfaces._sweeps import DIRECTIONS, turned, unfinished

# Stands for infinity: a difference of two is zero, not NaN.
FAR = 1e30
# (row, column) of B, the straight neighbour, and of A, the one beside it, by twice the direction (as in `_sweeps`); the
# second of a pair has A on the other side.
_MIDDLE = np.repeat([[-1, 0], [1, 0], [0, -1], [0, 1]], 2, axis=0)
_BESIDE = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1], [-1, -1], [1, -1], [-1, 1], [1, 1]])
_NEWTON_STEPS = 3

Vector = tuple[ArrayLike, ArrayLike, ArrayLike]


class Field(eqx.Module):
    """A surface and a source.

    Attributes:
        depth: z at each pixel.
        mask: Where there is surface.
        spacing: World units per column and row.
        source: (x, y, z) of the source.
        free: Where u is unknown: on the surface, and not beside the source, where it is zero.
    """

    depth: Float[Array, "height width"]
    mask: Bool[Array, "height width"]
    spacing: Float[Array, "2"]
    source: Float[Array, "3"]
    free: Bool[Array, "height width"]

    def offsets(self) -> tuple[Array, Array, Array]:
        """Returns X − S as planes."""
        height, width = self.depth.shape
        x = jnp.arange(width, dtype=self.depth.dtype) * self.spacing[0] - self.source[0]
        y = jnp.arange(height, dtype=self.depth.dtype) * self.spacing[1] - self.source[1]
        shape = self.depth.shape
        return jnp.broadcast_to(x[None, :], shape), jnp.broadcast_to(y[:, None], shape), self.depth - self.source[2]


class Policy(eqx.Module):
    """Where each pixel's way comes from.

    Attributes:
        triangle: 0 to 7, the pair of neighbours; −1 where there is none.
        share: 0 at the straight neighbour, 1 at the one beside it.
    """

    triangle: Int[Array, "height width"]
    share: Float[Array, "height width"]

    def directions(self) -> tuple[Int[Array, "height width"], Float[Array, "height width"]]:
        """Returns the direction and the signed share, as `_sweeps` wants them."""
        direction = jnp.where(self.triangle < 0, -1, self.triangle // 2)
        return direction, jnp.where(self.triangle % 2 == 0, self.share, -self.share)


def dot(a: Vector, b: Vector) -> Array:
    """Returns the scalar products of planes of vectors."""
    (ax, ay, az), (bx, by, bz) = a, b
    return jnp.asarray(ax * bx + ay * by + az * bz)


def length(a: Vector) -> Array:
    """Returns the lengths of planes of vectors; the derivative at zero is zero."""
    square = dot(a, a)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def _ratio(a: Array, b: Array) -> Array:
    return jnp.where(b > 0, a / jnp.where(b > 0, b, 1), 0)


def _walk(share: Array, offset: Vector, middle: Vector, edge: Vector) -> tuple[Vector, Vector]:
    """X − Y and Y − S, from X − S, X − B and A − B."""
    step = (middle[0] - share * edge[0], middle[1] - share * edge[1], middle[2] - share * edge[2])
    return step, (offset[0] - step[0], offset[1] - step[1], offset[2] - step[2])


def _cost(share: Array, offset: Vector, chord: Array, middle: Vector, edge: Vector) -> Array:
    """Returns c = |X − Y| + |Y − S| − |X − S|, the difference of the long ones without cancellation."""
    step, there = _walk(share, offset, middle, edge)
    both = (offset[0] + there[0], offset[1] + there[1], offset[2] + there[2])
    return length(step) - _ratio(dot(step, both), chord + length(there))


class _Neighbours:
    """The neighbours of all pixels that stand at an offset, known only when it runs."""

    def __init__(self, values: Array, fill: float):
        self.padded, self.shape = jnp.pad(values, 1, constant_values=fill), values.shape

    def at(self, offset: Array) -> Array:
        return lax.dynamic_slice(self.padded, (1 + offset[0], 1 + offset[1]), self.shape)


def _vectors(field: Field, heights: _Neighbours, middle: Array, beside: Array) -> tuple[Vector, Vector]:
    """X − B and A − B for one triangle, as planes."""
    dx, dy = field.spacing
    z_middle = heights.at(middle)
    edge = beside - middle
    return (-middle[1] * dx, -middle[0] * dy, field.depth - z_middle), (
        edge[1] * dx,
        edge[0] * dy,
        heights.at(beside) - z_middle,
    )


def smallest_excess(field: Field, tolerance: Float[Array, ""]) -> Float[Array, "height width"]:
    """Returns u, by sweeps in the four directions until none lowers a value by more than the tolerance.

    `FAR` where nothing leads to the source. Between the two triangles that a line of pixels offers, the slope at the
    straight neighbour decides; the share is the one that is best for |Y − S| linear along the edge. (Newton's step on
    top of it makes XLA's loop several times slower, for far less than the discretization's error.)
    """
    x, y, z = field.offsets()
    chord = length((x, y, z))
    inverse = _ratio(jnp.ones_like(chord), chord)
    spacing = field.spacing

    def sweep(u, direction):
        dx, dy = spacing if direction < 2 else spacing[::-1]
        dy = -dy if direction % 2 else dy
        along, across = (x, y) if direction < 2 else (y, x)

        def step(before, row):
            u_before, z_before = before
            u, free, x, y, z, chord, inverse = row
            u_middle, z_middle = u_before[1:-1], z_before[1:-1]
            rise = z - z_middle
            near = dy * dy + rise * rise

            def slopes(u_beside, z_beside, side):
                edge = z_beside - z_middle
                slope = u_beside - u_middle + (edge * z - side * dx * x) * inverse
                return slope, slope - rise * edge * near_inverse, edge

            near_inverse = 1 / jnp.sqrt(near)
            left, at_left, edge_left = slopes(u_before[:-2], z_before[:-2], 1)
            right, at_right, edge_right = slopes(u_before[2:], z_before[2:], -1)
            go_left = at_left < at_right
            slope = jnp.where(go_left, left, right)
            edge = jnp.where(go_left, edge_left, edge_right)
            u_beside = jnp.where(go_left, u_before[:-2], u_before[2:])
            side = jnp.where(go_left, dx, -dx)
            square, product = dx * dx + edge * edge, rise * edge
            rest = jnp.maximum(square - slope * slope, 1e-6 * square)
            aside = near * square - product * product
            share = jnp.clip((product - slope * jnp.sqrt(aside / rest)) / square, 0, 1)
            share = jnp.where(u_beside >= FAR / 2, 0, jnp.where(u_middle >= FAR / 2, 1, share))
            value = (
                (1 - share) * u_middle
                + share * u_beside
                + _cost(share, (x, y, z), chord, (0, dy, rise), (-side, 0, edge))
            )
            new = jnp.where(free, jnp.minimum(u, value), u)
            return (jnp.pad(new, 1, constant_values=FAR), jnp.pad(z, 1)), new

        rows = tuple(turned(direction, plane) for plane in (u, field.free, along, across, z, chord, inverse))
        width = rows[0].shape[1] + 2
        start = jnp.full((width,), FAR, chord.dtype), jnp.zeros((width,), chord.dtype)
        lowered: Array = lax.scan(step, start, rows, reverse=direction % 2 == 1)[1]
        return turned(direction, lowered)

    def body(state):
        count, u, _ = state
        old = u
        for direction in DIRECTIONS:
            u = sweep(u, direction)
        return count + 1, u, jnp.any(u < old - tolerance)

    start = jnp.where(field.mask & ~field.free, 0, FAR).astype(field.depth.dtype)
    return lax.while_loop(unfinished(start), body, (0, start, jnp.array(True)))[1]


def improved(u: Float[Array, "height width"], field: Field) -> Policy:
    """Returns the best policy against given values.

    If these are an upper bound that no step improves upon the wrong way (as those of `first_values`, and of every
    policy, are), the policy leads to the source from everywhere (Howard 1960).
    """
    heights = _Neighbours(field.depth, 0.0)
    values = _Neighbours(jnp.where(field.mask, u, FAR), FAR)
    offset = field.offsets()
    chord = length(offset)
    inverse = _ratio(jnp.ones_like(u), chord)

    def compare(state, triangle):
        best, which, best_share = state
        index, middle, beside = triangle
        to_middle, edge = _vectors(field, heights, middle, beside)
        u_middle, u_beside = values.at(middle), values.at(beside)
        # With |Y − S| taken as linear along the edge the best share is known in closed form.
        square, along = dot(edge, edge), dot(to_middle, edge)
        slope = u_beside - u_middle + dot(offset, edge) * inverse
        aside = jnp.sqrt(jnp.maximum(dot(to_middle, to_middle) * square - along * along, 0))
        rest = jnp.maximum(square - slope * slope, 1e-6 * square)
        share = jnp.clip((along - aside * slope / jnp.sqrt(rest)) / square, 0, 1)
        share = jnp.where(u_beside >= FAR / 2, 0, jnp.where(u_middle >= FAR / 2, 1, share))
        value = (1 - share) * u_middle + share * u_beside + _cost(share, offset, chord, to_middle, edge)
        better = value < best
        return (
            jnp.where(better, value, best),
            jnp.where(better, index, which),
            jnp.where(better, share, best_share),
        ), None

    start = jnp.full_like(u, FAR / 2), jnp.full(u.shape, -1, jnp.int32), jnp.zeros_like(u)
    triangles = jnp.arange(8, dtype=jnp.int32), jnp.asarray(_MIDDLE), jnp.asarray(_BESIDE)
    _, which, share = lax.scan(compare, start, triangles)[0]
    return _refined(Policy(jnp.where(field.free, which, -1), share), u, field)


def _refined(policy: Policy, u: Array, field: Field) -> Policy:
    """Newton's iteration for the share, within its triangle."""
    (to_middle, edge), (middle, beside) = _chosen(policy, field)
    u_middle, u_beside = u.ravel()[middle], u.ravel()[beside]
    offset = field.offsets()
    on_surface = field.mask.ravel()
    both = on_surface[middle] & on_surface[beside] & (jnp.maximum(u_middle, u_beside) < FAR / 2)
    slope, square = jnp.where(both, u_beside - u_middle, 0), dot(edge, edge)
    share = policy.share
    for _ in range(_NEWTON_STEPS):
        step, there = _walk(share, offset, to_middle, edge)
        near, far = length(step), length(there)
        along_near, along_far = _ratio(dot(step, edge), near), _ratio(dot(there, edge), far)
        curvature = _ratio(square - along_near * along_near, near) + _ratio(square - along_far * along_far, far)
        change = _ratio(slope - along_near + along_far, curvature)
        share = jnp.where(both, jnp.clip(share - change, 0, 1), share)
    return Policy(policy.triangle, share)


def _chosen(policy: Policy, field: Field) -> tuple[tuple[Vector, Vector], tuple[Array, Array]]:
    """X − B and A − B for the triangle of each pixel, and the flat indices of B and A."""
    height, width = field.depth.shape
    dx, dy = field.spacing
    triangle = jnp.maximum(policy.triangle, 0)
    rows, columns = jnp.arange(height)[:, None], jnp.arange(width)[None, :]

    def neighbour(table):
        row, column = jnp.asarray(table[:, 0])[triangle], jnp.asarray(table[:, 1])[triangle]
        # Only where there is no triangle would the index lie outside.
        inside_row = jnp.clip(jnp.broadcast_to(rows, row.shape) + row, 0, height - 1)
        inside_column = jnp.clip(jnp.broadcast_to(columns, row.shape) + column, 0, width - 1)
        return row, column, inside_row * width + inside_column

    (row, column, middle), (row_beside, column_beside, beside) = neighbour(_MIDDLE), neighbour(_BESIDE)
    depth = field.depth.ravel()
    z_middle = depth[middle]
    to_middle = (-column * dx, -row * dy, field.depth - z_middle)
    edge = ((column_beside - column) * dx, (row_beside - row) * dy, depth[beside] - z_middle)
    return (to_middle, edge), (middle, beside)


def costs(policy: Policy, field: Field) -> Float[Array, "height width"]:
    """Returns c of each pixel's step, zero where it has none; differentiable in the field."""
    (to_middle, edge), _ = _chosen(policy, field)
    offset = field.offsets()
    return jnp.where(policy.triangle >= 0, _cost(policy.share, offset, length(offset), to_middle, edge), 0)
