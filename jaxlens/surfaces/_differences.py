"""Values on the pixels of a mask: their differences, and their continuation beyond it."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Shaped

from jaxlens.surfaces._depth_map import DepthMap

# A cubic kernel about a pixel of the mask reaches two pixels.
MARGIN = 2


def shifted(values: Shaped[Array, "height width"], rows: int, columns: int, fill) -> Shaped[Array, "height width"]:
    """Returns, at each pixel, the value that stands `rows` below and `columns` to the right; `fill` outside."""
    height, width = values.shape
    margin = max(abs(rows), abs(columns))
    padded = jnp.pad(values, margin, constant_values=fill)
    top, left = margin + rows, margin + columns
    return padded[top : top + height, left : left + width]


def masked_slopes(
    values: Float[Array, "height width"], mask: Bool[Array, "height width"]
) -> tuple[Float[Array, "height width"], Float[Array, "height width"]]:
    """Returns the derivatives by column and by row, of second order wherever the mask lets them.

    Central differences; at an edge of the mask one-sided ones of three points, or of two where there are no more; zero
    at a pixel that stands alone. Exact on planes but for the lone pixel; nothing outside the mask is read.
    """
    return _slope(values, mask, 0, 1), _slope(values, mask, 1, 0)


def _slope(values: Array, mask: Array, rows: int, columns: int) -> Array:
    def neighbour(steps):
        return shifted(values, steps * rows, steps * columns, 0), shifted(mask, steps * rows, steps * columns, False)

    (after, has_after), (before, has_before) = neighbour(1), neighbour(-1)
    (far_after, has_far_after), (far_before, has_far_before) = neighbour(2), neighbour(-2)
    forward, backward = after - values, values - before
    one_sided = jnp.where(
        has_after,
        jnp.where(has_far_after, 2 * forward - 0.5 * (far_after - values), forward),
        jnp.where(has_far_before, 2 * backward - 0.5 * (values - far_before), backward),
    )
    slope = jnp.where(has_after & has_before, 0.5 * (after - before), one_sided)
    return jnp.where(mask & (has_after | has_before), slope, 0)


def continued(values: Float[Array, "height width"], mask: Bool[Array, "height width"]) -> Float[Array, "height width"]:
    """Returns values that go on smoothly two pixels beyond the mask: the mean of their neighbours' tangent planes.

    Planes are continued exactly. Farther out the values are zero.
    """
    values = jnp.where(mask, values, 0)
    for _ in range(MARGIN):
        along_x, along_y = masked_slopes(values, mask)
        total, count = jnp.zeros_like(values), jnp.zeros_like(values)
        for rows in (-1, 0, 1):
            for columns in (-1, 0, 1):
                if rows or columns:
                    there = shifted(mask, rows, columns, False)
                    # The neighbour's plane, one step back from it.
                    plane = shifted(values - rows * along_y - columns * along_x, rows, columns, 0)
                    total = total + jnp.where(there, plane, 0)
                    count = count + there
        ring = ~mask & (count > 0)
        values = jnp.where(ring, total / jnp.maximum(count, 1), values)
        mask = mask | ring
    return values


def padded_depth(depth_map: DepthMap) -> Float[Array, "padded_height padded_width"]:
    """Returns the depth with `MARGIN` more pixels on each side, going on smoothly beyond the mask."""
    return continued(jnp.pad(depth_map.depth, MARGIN), jnp.pad(depth_map.mask, MARGIN))


def cubic_at(padded: Float[Array, "padded_height padded_width"], point: Float[Array, "2"]) -> Float[Array, ""]:
    """Interpolates at a point (x, y) of a picture that was padded by `MARGIN`; from outside, at its border."""
    last = jnp.array([padded.shape[1] - 2 * MARGIN - 1, padded.shape[0] - 2 * MARGIN - 1], point.dtype)
    point = jnp.clip(point, -0.5, last + 0.5)
    first = jnp.floor(lax.stop_gradient(point))
    column, row = first.astype(jnp.int32) + (MARGIN - 1)
    x, y = point - first
    patch = lax.dynamic_slice(padded, (row, column), (4, 4))
    return jnp.stack(cubic_weights(y)) @ patch @ jnp.stack(cubic_weights(x))


def cubic_weights(offset: Float[Array, "*batch"]) -> list[Float[Array, "*batch"]]:
    """Returns the weights of four neighbours at an offset, in [0, 1], from the second: Keys (1981), a = −1/2."""
    t = offset
    return [
        ((-0.5 * t + 1) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1,
        ((-1.5 * t + 2) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    ]
