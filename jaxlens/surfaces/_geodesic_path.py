"""Ways down a distance: shortest paths back to the source."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxlens.numerics import as_floating, as_points, is_concrete
from jaxlens.surfaces._depth_map import DepthMap
from jaxlens.surfaces._differences import MARGIN, continued, cubic_at, padded_depth
from jaxlens.surfaces._geodesic import check_inside

# Pixels from one point of a path to the next, and how near to the source the last step begins.
_STEP = 0.5
_LAST = 1.0


class GeodesicPath(eqx.Module):
    """A path on a surface.

    Attributes:
        points: `(N, 2)` (x, y) in pixels, from the start on; after `count` points the last one is repeated, so that
            lengths and plots need not mind.
        count: How many points the path has.
        reached: Whether it ends at a source.
    """

    points: Float[Array, "points 2"]
    count: Int[Array, ""]
    reached: Bool[Array, ""]


def geodesic_path(
    depth_map: DepthMap,
    distance: Float[ArrayLike, "height width"],
    start: Float[ArrayLike, "2"] | list | tuple,
    *,
    max_points: int | None = None,
) -> GeodesicPath:
    """Follows the steepest descent of a distance, along G⁻¹ ∇T, from a start back to the source.

    The square of the distance is interpolated, which is smooth at the source, and followed in steps of half a pixel
    (Heun's method); within a pixel of the source its gradient tells where the source is. Exact on planes. Where the
    descent would leave the surface, the path steps to the lowest neighbouring pixel.

    Args:
        depth_map: The surface.
        distance: `(H, W)`, of `geodesic_distance`.
        start: (x, y) in pixels, where the distance is finite.
        max_points: The length of the result, 4 (H + W) unless given.

    Returns:
        A `GeodesicPath`. Works under `jax.jit` and `jax.vmap`, and is not made to be differentiated.

    Raises:
        ValueError: a start off the surface, or where the distance is not finite; a distance of another shape.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxlens.surfaces import DepthMap, geodesic_distance, geodesic_path
        >>> plane = DepthMap(jnp.zeros((20, 30)))
        >>> path = geodesic_path(plane, geodesic_distance(plane, source=(4.0, 3.0)), (25.0, 16.0))
        >>> [round(float(x), 3) for x in path.points[path.count - 1]]
        [4.0, 3.0]
    """
    distance, point = as_floating(distance), as_points(start)
    if distance.shape != depth_map.shape:
        raise ValueError(f"distance must have the depth map's shape {depth_map.shape}, got {distance.shape}")
    if point.shape != (2,):
        raise ValueError(f"start must be one point (x, y), got shape {point.shape}; for several use jax.vmap")
    check_inside(depth_map, point, "start")
    if is_concrete(distance, point):
        column, row = np.clip(np.round(np.asarray(point)), 0, np.array(depth_map.shape[::-1]) - 1).astype(int)
        if not np.isfinite(distance[row, column]):
            raise ValueError(f"the distance at start {column, row} is {distance[row, column]}: no way leads from there")
    points = 4 * sum(depth_map.shape) if max_points is None else max_points
    if points < 2:
        raise ValueError(f"max_points must be at least 2, got {max_points}")
    return _descend(depth_map, distance, point, max_points=points)


@partial(jax.jit, static_argnames="max_points")
def _descend(depth_map: DepthMap, distance: Array, start: Array, *, max_points: int) -> GeodesicPath:
    height, width = depth_map.shape
    dx, dy = depth_map.spacing
    known = depth_map.mask & jnp.isfinite(distance)
    square = jnp.where(known, distance, 0) ** 2
    smooth = continued(jnp.pad(square, MARGIN), jnp.pad(known, MARGIN))
    depth = padded_depth(depth_map)

    def towards(point):
        """Returns the vector from the source, in pixels, as the descent has it: exact on planes."""
        p, q = jax.grad(cubic_at, argnums=1)(depth, point) / depth_map.spacing
        e, f = 0.5 * jax.grad(cubic_at, argnums=1)(smooth, point) / depth_map.spacing
        area = 1 + p * p + q * q
        return jnp.stack([((1 + q * q) * e - p * q * f) / (area * dx), ((1 + p * p) * f - p * q * e) / (area * dy)])

    def direction(vector):
        size = jnp.sqrt(jnp.sum(vector * vector))
        return vector / jnp.where(size > 0, size, 1)

    def at(point):
        column = jnp.clip(jnp.round(point[0]), 0, width - 1).astype(jnp.int32)
        row = jnp.clip(jnp.round(point[1]), 0, height - 1).astype(jnp.int32)
        return row, column

    columns, rows = (axis.ravel() for axis in jnp.meshgrid(jnp.arange(-1, 2), jnp.arange(-1, 2)))
    lowest = jnp.where(jnp.pad(known, 1), jnp.pad(square, 1), jnp.inf)

    def body(state):
        count, point, points, _, _ = state
        vector = towards(point)
        ends = jnp.sum(vector * vector) <= _LAST**2
        first = direction(vector)
        second = direction(towards(point - _STEP * first))
        candidate = point - _STEP * direction(first + second)
        candidate = jnp.where(ends, point - vector, candidate)
        row, column = at(candidate)
        here = cubic_at(smooth, point)
        good = known[row, column] & (ends | (cubic_at(smooth, candidate) < here)) & jnp.all(jnp.isfinite(candidate))
        row, column = at(point)
        around = lowest[row + 1 + rows, column + 1 + columns]
        best = jnp.argmin(around)
        pixel = jnp.stack([column + columns[best], row + rows[best]]).astype(point.dtype)
        down = around[best] < here
        following = jnp.where(good, candidate, jnp.where(down, pixel, point))
        points = points.at[count].set(following)
        return count + 1, following, points, good & ends, ~good & ~down

    def unfinished(state):
        count, _, _, reached, stuck = state
        return (count < max_points) & ~reached & ~stuck

    start = start.astype(distance.dtype)
    points = jnp.zeros((max_points, 2), distance.dtype).at[0].set(start)
    no = jnp.array(False)
    count, last, points, reached, stuck = lax.while_loop(unfinished, body, (jnp.array(1), start, points, no, no))
    count = count - stuck
    points = jnp.where((jnp.arange(max_points) < count)[:, None], points, last[None, :])
    return GeodesicPath(points, count, reached)
