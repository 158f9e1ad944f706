"""Shortest ways on a grid of heights: for each pixel, the point between two of its neighbours that its way comes from.

With T the distance, T(X) = min over Y of T(Y) + |X − Y|, where Y runs along the edge between two neighbours. T itself
would be interpolated poorly between them, above all near the source S; what it exceeds the straight line by,
u = T − |X − S|, is zero on planes and smooth at the source. So u is interpolated, and the straight line is exact:

    u(X) = min over share of (1 − share) u(B) + share u(A) + c,
    c = |X − Y| + |Y − S| − |X − S|,   Y = B + share (A − B).
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
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
    """A surface and sources.

    Attributes:
        depth: z at each pixel.
        mask: Where there is surface.
        spacing: World units per column and row.
        sources: (x, y, z) of each source.
        label: Which source a pixel's way leads to.
        free: Where u is unknown: on the surface, and not beside the source, where it is zero.
    """

    depth: Float[Array, "height width"]
    mask: Bool[Array, "height width"]
    spacing: Float[Array, "2"]
    sources: Float[Array, "sources 3"]
    label: Int[Array, "height width"]
    free: Bool[Array, "height width"]

    def offsets(self) -> tuple[Array, Array, Array]:
        """Returns X − S as planes."""
        height, width = self.depth.shape
        x = jnp.arange(width, dtype=self.depth.dtype)[None, :] * self.spacing[0]
        y = jnp.arange(height, dtype=self.depth.dtype)[:, None] * self.spacing[1]
        if len(self.sources) == 1:
            source = self.sources[0]
            shape = self.depth.shape
            x, y = jnp.broadcast_to(x - source[0], shape), jnp.broadcast_to(y - source[1], shape)
            return x, y, self.depth - source[2]
        source = self.sources.T[:, self.label]
        return x - source[0], y - source[1], self.depth - source[2]


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
    """Returns X − Y and Y − S, from X − S, X − B and A − B."""
    step = (middle[0] - share * edge[0], middle[1] - share * edge[1], middle[2] - share * edge[2])
    return step, (offset[0] - step[0], offset[1] - step[1], offset[2] - step[2])


def _cost(share: Array, offset: Vector, chord: Array, middle: Vector, edge: Vector) -> Array:
    """Returns c = |X − Y| + |Y − S| − |X − S|, the difference of the long ones without cancellation."""
    step, there = _walk(share, offset, middle, edge)
    both = (offset[0] + there[0], offset[1] + there[1], offset[2] + there[2])
    return length(step) - _ratio(dot(step, both), chord + length(there))


class _Neighbours:
    """The neighbours of all pixels that stand at an offset, known only when it runs."""

    def __init__(self, values: Array, fill: ArrayLike):
        self.padded, self.shape = jnp.pad(values, 1, constant_values=fill), values.shape

    def at(self, offset: Array) -> Array:
        return lax.dynamic_slice(self.padded, (1 + offset[0], 1 + offset[1]), self.shape)


def _vectors(field: Field, heights: _Neighbours, middle: Array, beside: Array) -> tuple[Vector, Vector]:
    """Returns X − B and A − B for one triangle, as planes."""
    dx, dy = field.spacing
    z_middle = heights.at(middle)
    edge = beside - middle
    return (-middle[1] * dx, -middle[0] * dy, field.depth - z_middle), (
        edge[1] * dx,
        edge[0] * dy,
        heights.at(beside) - z_middle,
    )


def smallest_excess(
    field: Field, tolerance: Float[Array, ""], progress: Callable[[int, int], None] | None = None
) -> tuple[Float[Array, "height width"], Int[Array, "height width"]]:
    """Returns u, by sweeps in the four directions until none lowers a distance by more than the tolerance, and labels.

    `field.label` says which source is nearest to the pixels beside one. `FAR` where nothing leads to a source. Between
    the two triangles that a line of pixels offers, the slope at the straight neighbour decides; the share is the one
    that is best for |Y − S| linear along the edge. (Newton's step on top of it makes XLA's loop several times slower,
    for far less than the discretization's error.)

    Several sources are solved for at once: a pixel's way leads to that of its three neighbours' sources which is the
    nearest, if their excess were its own. A neighbour whose way leads elsewhere is no nearer to this source than it is
    to its own; that bounds its excess, and the one that has the source says how large it is about here.

    `progress` is told, after each round of four sweeps, how many pixels it has not lowered, and of how many.
    """
    x, y, z = field.offsets()
    chord = length((x, y, z))
    inverse = _ratio(jnp.ones_like(chord), chord)
    several = len(field.sources) > 1
    spacing = field.spacing

    def sweep(u, label, direction):
        dx, dy = spacing if direction < 2 else spacing[::-1]
        dy = -dy if direction % 2 else dy
        sources = field.sources[:, jnp.array((0, 1, 2) if direction < 2 else (1, 0, 2))]

        def best(before, row):
            """Returns the smallest u for a source, with X − S, from the row before."""
            (u_left, u_middle, u_right), (z_left, z_middle, z_right) = before
            x, y, z, chord, inverse = row
            rise = z - z_middle
            near = dy * dy + rise * rise

            def slopes(u_beside, z_beside, side):
                edge = z_beside - z_middle
                slope = u_beside - u_middle + (edge * z - side * dx * x) * inverse
                return slope, slope - rise * edge * near_inverse, edge

            near_inverse = 1 / jnp.sqrt(near)
            left, at_left, edge_left = slopes(u_left, z_left, 1)
            right, at_right, edge_right = slopes(u_right, z_right, -1)
            go_left = at_left < at_right
            slope = jnp.where(go_left, left, right)
            edge = jnp.where(go_left, edge_left, edge_right)
            u_beside = jnp.where(go_left, u_left, u_right)
            side = jnp.where(go_left, dx, -dx)
            square, product = dx * dx + edge * edge, rise * edge
            rest = jnp.maximum(square - slope * slope, 1e-6 * square)
            aside = near * square - product * product
            share = jnp.clip((product - slope * jnp.sqrt(aside / rest)) / square, 0, 1)
            share = jnp.where(u_beside >= FAR / 2, 0, jnp.where(u_middle >= FAR / 2, 1, share))
            return (
                (1 - share) * u_middle
                + share * u_beside
                + _cost(share, (x, y, z), chord, (0, dy, rise), (-side, 0, edge))
            )

        def step(before, row):
            u_before, z_before = before
            u, free, x, y, z, chord, inverse = row
            value = best((_threes(u_before), _threes(z_before)), (x, y, z, chord, inverse))
            new = jnp.where(free, jnp.minimum(u, value), u)
            return (jnp.pad(new, 1, constant_values=FAR), jnp.pad(z, 1)), new

        def step_several(before, row):
            u_before, z_before, chord_before, label_before, y_before = before
            u, label, mask, z, y = row
            across = jnp.arange(-1, len(u) + 1, dtype=z.dtype) * dx
            neighbours = list(zip(*(_threes(plane) for plane in (u_before, label_before)), strict=True))
            nearest = None
            for u_there, label_there in (neighbours[1], neighbours[0], neighbours[2]):
                source = sources[label_there]
                vector = across[1:-1] - source[:, 0], y - source[:, 1], z - source[:, 2]
                chord = length(vector)
                one = (u_there + chord, u_there, label_there, chord, *vector, *source.T)
                nearest = one if nearest is None else _where(one[0] < nearest[0], one, nearest)
            _, u_near, label_near, chord, *vector, sx, sy, sz = nearest
            places = list(zip(*(_threes(p) for p in (across, z_before, chord_before)), strict=True))
            relative = []
            for (u_there, label_there), (x_there, z_there, chord_there) in zip(neighbours, places, strict=True):
                to_source = length((x_there - sx, y_before - sy, z_there - sz))
                bound = jnp.maximum(u_there + chord_there - to_source, u_near)
                bound = jnp.where(u_there < FAR / 2, bound, FAR)
                relative.append(jnp.where(label_there == label_near, u_there, bound))
            value = best(
                (relative, [z_there - sz for _, z_there, _ in places]),
                (*vector, chord, _ratio(jnp.ones_like(chord), chord)),
            )
            own = sources[label]
            chord_own = length((across[1:-1] - own[:, 0], y - own[:, 1], z - own[:, 2]))
            lower = jnp.where(label == label_near, value < u, value + chord < u + chord_own)
            lower = lower & mask & (u_near < FAR / 2)
            new = jnp.where(lower, value, u), jnp.where(lower, label_near, label)
            padded = jnp.pad(jnp.where(lower, chord, chord_own), 1)
            state = jnp.pad(new[0], 1, constant_values=FAR), jnp.pad(z, 1), padded, jnp.pad(new[1], 1), y
            return state, new

        zeros = jnp.zeros((u.shape[1 if direction < 2 else 0] + 2,), chord.dtype)
        start = jnp.full_like(zeros, FAR), zeros
        if several:
            along = jnp.arange(u.shape[0 if direction < 2 else 1], dtype=z.dtype) * jnp.abs(dy)
            rows = (*(turned(direction, plane) for plane in (u, label, field.mask, field.depth)), along)
            start = (*start, zeros, jnp.zeros(zeros.shape, label.dtype), jnp.zeros((), z.dtype))
            u, label = lax.scan(step_several, start, rows, reverse=direction % 2 == 1)[1]
            return turned(direction, u), turned(direction, label)
        planes = (u, field.free, *((x, y) if direction < 2 else (y, x)), z, chord, inverse)
        rows = tuple(turned(direction, plane) for plane in planes)
        lowered: Array = lax.scan(step, start, rows, reverse=direction % 2 == 1)[1]
        return turned(direction, lowered), label

    def total(u, label):
        return u + length(eqx.tree_at(lambda f: f.label, field, label).offsets()) if several else u

    def body(state):
        count, u, label, _ = state
        old = total(u, label)
        for direction in DIRECTIONS:
            u, label = sweep(u, label, direction)
        lowered = total(u, label) < old - tolerance
        if progress is not None:
            jax.debug.callback(partial(_tell, progress, lowered.size), jnp.sum(lowered))
        return count + 1, u, label, jnp.any(lowered)

    start = jnp.where(field.mask & ~field.free, 0, FAR).astype(field.depth.dtype)
    _, u, label, _ = lax.while_loop(unfinished(start), body, (0, start, field.label, jnp.array(True)))
    return u, label


def _tell(progress: Callable[[int, int], None], total: int, lowered: Int[Array, ""]) -> None:
    progress(total - int(lowered), total)


def _threes(row: Array) -> tuple[Array, Array, Array]:
    return row[:-2], row[1:-1], row[2:]


def _where(condition: Array, yes: tuple, no: tuple) -> tuple:
    return tuple(jnp.where(condition, a, b) for a, b in zip(yes, no, strict=True))


def improved(u: Float[Array, "height width"], field: Field) -> Policy:
    """Returns the best policy against given values.

    If these are an upper bound that no step improves upon the wrong way (as those of `first_values`, and of every
    policy, are), the policy leads to the source from everywhere (Howard 1960).
    """
    heights = _Neighbours(field.depth, 0.0)
    values, labels = _Neighbours(jnp.where(field.mask, u, FAR), FAR), _Neighbours(field.label, -1)
    offset = field.offsets()
    chord = length(offset)
    inverse = _ratio(jnp.ones_like(u), chord)

    def compare(state, triangle):
        best, which, best_share = state
        index, middle, beside = triangle
        to_middle, edge = _vectors(field, heights, middle, beside)
        # Another source's excess is no part of this one's way.
        u_middle, u_beside = (jnp.where(labels.at(at) == field.label, values.at(at), FAR) for at in (middle, beside))
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
    on_surface, labels = field.mask.ravel(), field.label.ravel()
    both = on_surface[middle] & on_surface[beside] & (jnp.maximum(u_middle, u_beside) < FAR / 2)
    both = both & (labels[middle] == field.label) & (labels[beside] == field.label)
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
    """Returns X − B and A − B for the triangle of each pixel, and the flat indices of B and A."""
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
