"""Depth maps: surfaces z(x, y) on a grid of pixels."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.numerics import as_floating, is_concrete


class DepthMap(eqx.Module):
    """A surface seen along one direction: a depth at each pixel where there is surface.

    The world is written as pictures are: x to the right along the columns, y **downwards** along the rows, z towards
    the viewer; the first pixel is at x = y = 0. (This system is left-handed; lengths do not mind.)

    Attributes:
        depth: `(H, W)` z in world units, the larger the nearer to the viewer. Finite everywhere: what was not, outside
            the mask, has become zero.
        mask: `(H, W)`, true where there is surface.
        spacing: (dx, dy), world units from one column to the next, and from one row to the next.

    Raises:
        ValueError: shapes that do not fit, a depth inside the mask that is not finite, a spacing that is not positive
            and finite. Under `jax.jit` the values are not looked at.

    Example:
        >>> import jax.numpy as jnp
        >>> from jaxlens.surfaces import DepthMap
        >>> plane = DepthMap(jnp.zeros((3, 4)), spacing=0.5)
        >>> plane.points()[2, 3].tolist()
        [1.5, 1.0, 0.0]
    """

    depth: Float[Array, "height width"]
    mask: Bool[Array, "height width"]
    spacing: Float[Array, "2"]

    def __init__(
        self,
        depth: ArrayLike,
        *,
        mask: ArrayLike | None = None,
        spacing: ArrayLike | list | tuple = 1.0,
    ):
        """Makes a depth map.

        Args:
            depth: `(H, W)` z in world units, towards the viewer.
            mask: `(H, W)`, where there is surface; where the depth is finite, unless given.
            spacing: World units a pixel: one number, or (dx, dy).
        """
        depth = as_floating(depth)
        if depth.ndim != 2 or 0 in depth.shape:
            raise ValueError(f"depth must have shape (H, W) and at least one pixel, got {depth.shape}")
        finite = jnp.isfinite(depth)
        mask = finite if mask is None else jnp.asarray(mask)
        if mask.shape != depth.shape or mask.dtype != bool:
            raise ValueError(
                f"mask must be an array of booleans of the depth's shape {depth.shape}, got {mask.dtype} {mask.shape}"
            )
        spacing = as_floating(spacing).astype(depth.dtype)
        if spacing.shape not in ((), (2,)):
            raise ValueError(f"spacing must be one number or (dx, dy), got shape {spacing.shape}")
        if is_concrete(depth, mask):
            bad = np.argwhere(np.asarray(mask & ~finite))
            if len(bad):
                row, column = bad[0]
                raise ValueError(
                    f"depth must be finite inside the mask, got {depth[row, column]} at row {row}, column {column} "
                    f"({len(bad)} such pixels); leave them out of the mask"
                )
        if is_concrete(spacing) and not np.all((np.asarray(spacing) > 0) & np.isfinite(np.asarray(spacing))):
            raise ValueError(f"spacing must be positive and finite, got {np.asarray(spacing).tolist()}")
        self.depth = jnp.where(finite, depth, 0)
        self.mask = mask
        self.spacing = jnp.broadcast_to(spacing, (2,))

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.depth.shape
        return height, width

    def points(self) -> Float[Array, "height width 3"]:
        """Returns the world positions of all pixels, those outside the mask too."""
        height, width = self.shape
        dx, dy = self.spacing
        x = jnp.broadcast_to(jnp.arange(width, dtype=self.depth.dtype)[None, :] * dx, self.shape)
        y = jnp.broadcast_to(jnp.arange(height, dtype=self.depth.dtype)[:, None] * dy, self.shape)
        return jnp.stack([x, y, self.depth], axis=-1)
