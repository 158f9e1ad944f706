"""The radial geodesic distance: the length of the surface above straight rays (Eqs. 1 and 2)."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from jaxlens.numerics import as_points
from jaxlens.surfaces._depth_map import DepthMap
from jaxlens.surfaces._differences import MARGIN, cubic_at, cubic_weights, padded_depth
from jaxlens.surfaces._geodesic import check_inside

# Rays beyond the diagonals, for the cubic that reads between rays.
_SPARE = 2


def radial_geodesic_distance(
    depth_map: DepthMap, source: Float[ArrayLike, "2"] | list | tuple
) -> Float[Array, "height width"]:
    """Returns the length of the surface's curve above the straight ray from a source to each pixel.

    The curve is l(t) = (x(t), y(t), z(t)) with x and y along the ray (Eq. 1), its length ∫ √(x_t² + y_t² + z_t²) dt
    (Eq. 2). It is no shorter than `geodesic_distance`, and equals it on planes, and on surfaces of revolution about
    the source.

    Rays towards the rows above and below, and rays towards the columns on both sides, are followed from row to row
    (column to column), where the depth is interpolated by a cubic; between rays the ratio of the length to the
    straight line is. Exact on planes; elsewhere the error is of second order in the spacing.

    Args:
        depth_map: The surface.
        source: (x, y) in pixels, also between pixels.

    Returns:
        `(H, W)` lengths in world units; NaN outside the mask, ∞ where the ray leaves the mask on its way.
        Differentiable with respect to the depth, the spacing and the source.

    Raises:
        ValueError: a source that is not finite, or lies outside the picture or the mask; under `jax.jit` it is not
            looked at.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxlens.surfaces import DepthMap, radial_geodesic_distance
        >>> slope = DepthMap(jnp.broadcast_to(0.75 * jnp.arange(9.0), (3, 9)))
        >>> float(radial_geodesic_distance(slope, (0.0, 1.0))[1, 8])
        10.0
    """
    point = as_points(source)
    if point.shape != (2,):
        raise ValueError(f"source must be one point (x, y), got shape {point.shape}; for several use jax.vmap")
    check_inside(depth_map, point, "source")
    return _radial(depth_map, point)


@jax.jit
def _radial(depth_map: DepthMap, source: Array) -> Array:
    source = source.astype(depth_map.depth.dtype)
    x, y = _steps(depth_map, source)
    padded = padded_depth(depth_map)
    z_source = cubic_at(padded, source)
    lengths = _cone(depth_map, padded, source, z_source)
    turned = DepthMap(depth_map.depth.T, mask=depth_map.mask.T, spacing=depth_map.spacing[::-1])
    sideways = _cone(turned, padded.T, source[::-1], z_source).T
    lengths = jnp.where(jnp.abs(x) <= jnp.abs(y), lengths, sideways)
    return jnp.where(depth_map.mask, lengths, jnp.nan)


def _steps(depth_map: DepthMap, source: Array) -> tuple[Array, Array]:
    """Columns and rows from the source."""
    (height, width), dtype = depth_map.shape, depth_map.depth.dtype
    x = jnp.arange(width, dtype=dtype) - source[0]
    y = jnp.arange(height, dtype=dtype) - source[1]
    return jnp.broadcast_to(x[None, :], depth_map.shape), jnp.broadcast_to(y[:, None], depth_map.shape)


def _cone(depth_map: DepthMap, padded: Array, source: Array, z_source: Array) -> Array:
    """Returns the lengths at pixels that are at least as many rows as columns away; anything elsewhere."""
    height, width = depth_map.shape
    dx, dy = depth_map.spacing
    count = max(height, width)
    x, y = _steps(depth_map, source)
    rows = y[:, 0]
    # Columns a row: the ray's slope. One ray for each pixel of the last row, were the source in the first.
    slopes = jnp.arange(-count - _SPARE, count + _SPARE + 1, dtype=x.dtype) / count
    crossings = source[0] + slopes[None, :] * rows[:, None]
    z, inside = _crossed(depth_map.mask, padded, crossings)
    flat = jnp.sqrt((slopes * dx) ** 2 + dy * dy)

    def followed(rows, z, inside):
        """Lengths along the rays, and whether they are on the surface yet, where `rows` is positive and grows."""

        def step(state, row):
            total, z_before, reached, alive = state
            along, z, inside = row
            ahead = along > 0
            piece = jnp.sqrt(jnp.where(ahead, ((along - reached) * flat) ** 2 + (z - z_before) ** 2, 1))
            total = jnp.where(ahead, total + piece, total)
            alive = alive & (inside | ~ahead)
            return (total, jnp.where(ahead, z, z_before), jnp.where(ahead, along, reached), alive), (total, alive)

        zeros = jnp.zeros_like(slopes)
        start = zeros, zeros + z_source, jnp.zeros_like(z_source), jnp.ones(slopes.shape, bool)
        return lax.scan(step, start, (rows, z, inside))[1]

    both = (jnp.stack([below, above]) for below, above in ((rows, -rows[::-1]), (z, z[::-1]), (inside, inside[::-1])))
    totals, lives = jax.vmap(followed)(*both)
    down = (rows > 0)[:, None]
    total, alive = (jnp.where(down, pair[0], pair[1, ::-1]) for pair in (totals, lives))
    straight = _straight(rows[:, None] * flat[None, :], z - z_source)
    off = (rows != 0)[:, None] & (straight > 0)
    ratio = jnp.where(off, total / jnp.where(off, straight, 1), 1)

    slope = jnp.where(y != 0, x / jnp.where(y != 0, y, 1), 0)
    ratio, reached = _between_rays(ratio, alive, jnp.clip(slope, -1, 1) * count + count + _SPARE)
    world = jnp.sqrt(jnp.where((x != 0) | (y != 0), (x * dx) ** 2 + (y * dy) ** 2, 1))
    world = jnp.where((x != 0) | (y != 0), world, 0)
    return jnp.where(reached, _straight(world, depth_map.depth - z_source) * ratio, jnp.inf)


def _straight(along: Array, rise: Array) -> Array:
    square = along * along + rise * rise
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def _crossed(mask: Array, padded: Array, crossings: Array) -> tuple[Array, Array]:
    """Returns the depth where rays cross the rows, and whether there is surface."""
    height, width = mask.shape
    padded = padded[MARGIN:-MARGIN]
    place = jnp.clip(crossings, -0.5, width - 0.5)
    first = jnp.floor(lax.stop_gradient(place))
    begin = (jnp.arange(height) * (width + 2 * MARGIN))[:, None] + first.astype(jnp.int32) + (MARGIN - 1)
    z = sum(
        weight * padded.ravel().at[begin + k].get(mode="promise_in_bounds", wrap_negative_indices=False)
        for k, weight in enumerate(cubic_weights(place - first))
    )
    nearest = jnp.clip(jnp.round(place), 0, width - 1).astype(jnp.int32)
    inside = mask.ravel()[(jnp.arange(height) * width)[:, None] + nearest]
    return jnp.asarray(z), inside & (crossings == place)


def _between_rays(ratio: Array, alive: Array, position: Array) -> tuple[Array, Array]:
    """Reads each row at positions between rays, from those that stayed on the surface."""
    height, count = ratio.shape
    first = jnp.clip(jnp.floor(lax.stop_gradient(position)), 1, count - 3)
    begin = (jnp.arange(height) * count)[:, None] + first.astype(jnp.int32) - 1
    offset = position - first
    values = [ratio.ravel()[begin + k] for k in range(4)]
    living = [alive.ravel()[begin + k] for k in range(4)]
    cubic = sum(weight * value for weight, value in zip(cubic_weights(offset), values, strict=True))
    linear = values[1] + offset * (values[2] - values[1])
    one = jnp.where(living[1], values[1], values[2])
    both = living[1] & living[2]
    result = jnp.where(both, jnp.where(living[0] & living[3], cubic, linear), one)
    return result, living[1] | living[2]
