"""How a surface looks in light: its normals, and Lambert's law."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.numerics import as_floating
from jaxlens.surfaces._depth_map import DepthMap

_TOWARDS_VIEWER_FROM_UPPER_LEFT = (-0.35, -0.45, 1.0)


@jax.jit
def normals(depth_map: DepthMap) -> Float[Array, "height width 3"]:
    """Returns the unit normals of a surface, on the viewer's side: `(−∂z/∂x, −∂z/∂y, 1)`, normalized.

    Slopes are central differences; at the mask's border and the picture's, differences to the one neighbour that is
    there, so that planes are exact everywhere. A pixel without a neighbour along an axis has slope zero there.

    Args:
        depth_map: The surface.

    Returns:
        `(H, W, 3)` in the world of `DepthMap`: x to the right, y downwards, z towards the viewer. Outside the mask the
        normal is (0, 0, 1). Differentiable with respect to the depth (inside the mask) and the spacing.
    """
    dx, dy = depth_map.spacing
    slope_x = _slope(depth_map.depth, depth_map.mask, 1) / dx
    slope_y = _slope(depth_map.depth, depth_map.mask, 0) / dy
    length = jnp.sqrt(1 + slope_x**2 + slope_y**2)
    return jnp.stack([-slope_x, -slope_y, jnp.ones_like(length)], axis=-1) / length[..., None]


depth_map_normals = normals  # where an argument has its name


@jax.jit
def shade(
    depth_map: DepthMap,
    *,
    light: Float[ArrayLike, "3"] | Sequence[ArrayLike] = _TOWARDS_VIEWER_FROM_UPPER_LEFT,
    ambient: Float[ArrayLike, ""] = 0.3,
    albedo: Float[ArrayLike, "height width"] | None = None,
    normals: Float[ArrayLike, "height width 3"] | None = None,
    background: Float[ArrayLike, ""] = 0.0,
) -> Float[Array, "height width"]:
    """Makes the gray picture of a matt surface: `albedo · (ambient + (1 − ambient) · max(0, n · l))`, Lambert's law.

    Args:
        depth_map: The surface.
        light: Direction to the light, far away, of any length: x to the right, y downwards, z towards the viewer. The
            default shines from the upper left.
        ambient: The share of light that comes from everywhere, 0 to 1. Nothing casts a shadow.
        albedo: `(H, W)`, the share of light reflected, 0 to 1; all of it by default.
        normals: `(H, W, 3)`, unit normals in place of the depth map's own: of a mesh those of `normals_from_mesh` show
            no facets.
        background: The value outside the mask.

    Returns:
        `(H, W)` between 0 and 1, viewed along z, without perspective. Differentiable with respect to the depth,
        spacing, light, ambient and albedo; where the light just grazes the surface, the derivative is that of the lit
        side.

    Raises:
        ValueError: an albedo, or normals, of another shape.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxlens.surfaces import DepthMap, shade
        >>> plane = DepthMap(jnp.zeros((2, 2)))
        >>> float(shade(plane, light=(0.0, 3.0, 4.0), ambient=0.5)[0, 0])
        0.8999999761581421
    """
    direction = as_floating(light).astype(depth_map.depth.dtype)
    if normals is None:
        normals = depth_map_normals(depth_map)
    elif jnp.shape(normals) != (*depth_map.shape, 3):
        raise ValueError(f"normals must have the shape {(*depth_map.shape, 3)}, got {jnp.shape(normals)}")
    facing = jnp.asarray(normals, depth_map.depth.dtype) @ (direction / jnp.linalg.norm(direction))
    picture = ambient + (1 - ambient) * jnp.where(facing >= 0, facing, 0)
    if albedo is not None:
        albedo = as_floating(albedo)
        if albedo.shape != depth_map.shape:
            raise ValueError(f"albedo must have the shape {depth_map.shape} of the depth map, got {albedo.shape}")
        picture = picture * albedo
    return jnp.where(depth_map.mask, picture, background)


def _slope(depth: Float[Array, "height width"], mask: Bool[Array, "height width"], axis: int) -> Array:
    """Returns the difference a pixel along an axis, from those neighbours that are inside the mask."""
    depth = jnp.where(mask, depth, 0)

    def shifted(values, offset):
        moved = jnp.roll(values, -offset, axis)
        return moved.at[(slice(None),) * axis + (-1 if offset > 0 else 0,)].set(
            jnp.zeros((), values.dtype)
        )  # nothing comes around the edge

    after, before = shifted(mask, 1) & mask, shifted(mask, -1) & mask
    forward = jnp.where(after, shifted(depth, 1) - depth, 0)
    backward = jnp.where(before, depth - shifted(depth, -1), 0)
    return (forward + backward) / jnp.maximum(after.astype(depth.dtype) + before.astype(depth.dtype), 1)
