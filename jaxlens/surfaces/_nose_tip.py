"""The tip of the nose on the depth map of a face."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxlens.surfaces._depth_map import DepthMap

# In units of the face's size, the root of its area: what is smoothed away to find the nose, the surroundings above
# which it stands out, and what is smoothed away to place its tip.
_NOSE, _SURROUNDINGS, _FINE = 0.025, 0.12, 0.004
# How far from the coarse place the tip is sought, and how far from the face's middle the nose may stand.
_WINDOW, _CENTRAL = 0.06, 0.35
# The ring of face about the nose that the plane is fitted to in the end, and how often.
_INNER, _NEAR, _ROUNDS = 0.18, 0.3, 2


@jax.jit
def nose_tip(depth_map: DepthMap) -> Float[Array, "2"]:
    """Finds the tip of the nose of a face that looks at the viewer.

    The nose is what, at its own scale, stands out most from its surroundings in the middle of the face, above the
    plane that fits the whole face best. Its tip is the highest point above the plane that fits the face in a ring about
    the nose, which takes out how the head is tilted; to a fraction of a pixel by a quadratic.

    It is a heuristic, for depth maps that show a whole face and little else: the scales are shares of the mask's
    area. At 256², for the default `FaceShape` and for a mesh of a mean face, it is off by 0.2 pixels from the front,
    by less than one where the head nods by 15°, and by up to 2.5 where it is turned sideways by 15° (1 % of the face's
    size: the plane then sees more of one cheek than of the other). Hair, hands, or glasses that stand out more than the
    nose does mislead it.

    Args:
        depth_map: The face, upright or not.

    Returns:
        (x, y) in pixels. Inside the picture whatever the depth map; not differentiable.
    """
    depth, mask = depth_map.depth, depth_map.mask
    height, width = depth.shape
    weight = mask.astype(depth.dtype)
    columns = jnp.broadcast_to(jnp.arange(width, dtype=depth.dtype)[None, :], depth.shape)
    rows = jnp.broadcast_to(jnp.arange(height, dtype=depth.dtype)[:, None], depth.shape)
    area = jnp.maximum(jnp.sum(weight), 1)
    size = jnp.sqrt(area)
    x, y = columns - jnp.sum(weight * columns) / area, rows - jnp.sum(weight * rows) / area
    relief = _above_plane(columns, rows, depth, weight)
    bump = _smoothed(relief, weight, _NOSE * size) - _smoothed(relief, weight, _SURROUNDINGS * size)
    central = mask & (x * x + y * y <= (_CENTRAL * size) ** 2)
    row, column = jnp.unravel_index(jnp.argmax(jnp.where(central, bump, -jnp.inf)), depth.shape)

    def disc(radius):
        return mask & ((columns - column) ** 2 + (rows - row) ** 2 <= (radius * size) ** 2)

    fine = _smoothed(depth, weight, jnp.maximum(_FINE * size, 0.5))
    for _ in range(_ROUNDS):
        # About the nose the mask shows the same of a head that is turned.
        fine = _above_plane(columns, rows, fine, (disc(_NEAR) & ~disc(_INNER)).astype(depth.dtype))
        row, column = jnp.unravel_index(jnp.argmax(jnp.where(disc(_WINDOW), fine, -jnp.inf)), depth.shape)
    patch = jax.lax.dynamic_slice(jnp.pad(fine, 1, mode="edge"), (row, column), (3, 3))
    whole = jnp.all(jax.lax.dynamic_slice(jnp.pad(mask, 1), (row, column), (3, 3)))
    offset = jnp.where(whole, _summit(patch), 0)
    return jnp.stack([column, row]).astype(depth.dtype) + offset


def _above_plane(columns: Array, rows: Array, depth: Array, weight: Array) -> Array:
    """Returns the depth less the plane of least squares, whose normal equations are 2×2 about the mean."""
    total = jnp.maximum(jnp.sum(weight), 1)
    x, y, z = (values - jnp.sum(weight * values) / total for values in (columns, rows, depth))
    xx, xy, yy, xz, yz = (jnp.sum(weight * a * b) / total for a, b in ((x, x), (x, y), (y, y), (x, z), (y, z)))
    determinant = xx * yy - xy * xy
    safe = jnp.where(determinant > 0, determinant, 1)
    p, q = (yy * xz - xy * yz) / safe, (xx * yz - xy * xz) / safe
    return jnp.where(determinant > 0, z - p * x - q * y, z)


def _smoothed(values: Array, weight: Array, sigma: Array) -> Array:
    """Returns a Gaussian mean over the mask, by products of matrices because sigma is only known when it runs."""

    def kernel(size):
        index = jnp.arange(size, dtype=values.dtype)
        return jnp.exp(-0.5 * ((index[:, None] - index[None, :]) / sigma) ** 2)

    height, width = values.shape
    vertical, horizontal = kernel(height), kernel(width)
    total = vertical @ (values * weight) @ horizontal
    share = vertical @ weight @ horizontal
    return total / jnp.maximum(share, jnp.finfo(values.dtype).tiny)


def _summit(patch: Array) -> Array:
    """Finds where the least-squares quadratic of 3×3 values is highest: (x, y) from the middle, within a pixel."""
    columns, rows = jnp.sum(patch, axis=0), jnp.sum(patch, axis=1)
    x, y = (columns[2] - columns[0]) / 6, (rows[2] - rows[0]) / 6
    xx = (columns[0] - 2 * columns[1] + columns[2]) / 3
    yy = (rows[0] - 2 * rows[1] + rows[2]) / 3
    xy = (patch[0, 0] - patch[0, 2] - patch[2, 0] + patch[2, 2]) / 4
    determinant = xx * yy - xy * xy
    peak = (determinant > 0) & (xx < 0)
    safe = jnp.where(peak, determinant, 1)
    offset = jnp.stack([xy * y - yy * x, xy * x - xx * y]) / safe
    return jnp.where(peak, jnp.clip(offset, -1, 1), 0)
