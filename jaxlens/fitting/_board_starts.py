"""Closed-form starts for calibration: focal lengths and poses of boards, from homographies (Zhang 2000) or from rays.

A camera that sees wide bends a board too much for a homography, and one that sees past 90° does not even have the plane
z = 1 on which there could be one. Its poses follow from rays, and its focal length by trying a few.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxlens.fitting._poses import Poses, rotation_vector
from jaxlens.frames import Frame

# Focal lengths that are tried, in units of the picture's longer side: an equidistant lens sees 230° … 46° across it.
_FOCAL_LENGTHS = (0.25, 0.32, 0.4, 0.5, 0.63, 0.8, 1.0, 1.25)


def focal_lengths(
    homographies: Float[Array, "views 3 3"], center: Float[Array, "2"], fallback: Float[Array, ""]
) -> Float[Array, "2"]:
    """Returns fx and fy, given the principal point: the two constraints that each view of a plane gives (Zhang 2000).

    Where they give nothing sensible (parallel boards, strong distortion) the answer is `fallback`.
    """
    shift = jnp.eye(3, dtype=homographies.dtype).at[:2, 2].set(-center)
    matrices = jnp.einsum("ij,vjk->vik", shift, homographies)
    matrices = matrices / jnp.linalg.norm(matrices, axis=(1, 2), keepdims=True)
    a, b = matrices[:, :, 0], matrices[:, :, 1]
    products = jnp.concatenate([a * b, a * a - b * b])
    # products · (1/fx², 1/fy², 1) = 0. Both focal lengths as one where only that is well determined.
    normal = products[:, :2].T @ products[:, :2]
    right = -products[:, :2].T @ products[:, 2]
    separate = jnp.linalg.solve(normal + 1e-12 * jnp.trace(normal) * jnp.eye(2, dtype=normal.dtype), right)
    total = products[:, 0] + products[:, 1]
    common = -jnp.sum(total * products[:, 2]) / jnp.sum(total * total)

    def length(inverse_square):
        return jax.lax.rsqrt(jnp.where(inverse_square > 0, inverse_square, jnp.nan))

    def sensible(length):
        return (length > 0.1 * fallback) & (length < 20 * fallback)

    both, one = length(separate), length(common)
    ratio = both[0] / both[1]
    trusted = jnp.all(sensible(both)) & (ratio > 0.5) & (ratio < 2)
    return jnp.where(trusted, both, jnp.where(sensible(one), one, fallback))


def poses_from_homographies(homographies: Float[Array, "views 3 3"], frame: Frame) -> Poses:
    """Returns the poses of boards before a camera, in front of it."""
    matrices = jnp.einsum("ij,vjk->vik", jnp.linalg.inv(frame.camera_matrix()), homographies)
    return _nearest_poses(matrices * jnp.where(matrices[:, 2, 2] < 0, -1, 1)[:, None, None])


def poses_from_rays(
    board: Float[Array, "views corners 2"],
    rays: Float[Array, "views corners 3"],
    weights: Float[Array, "views corners"],
) -> Poses:
    """Returns the poses of boards whose corners are seen along rays, by a direct linear transform.

    The corner (x, y) of a board is before the camera at p = x r₁ + y r₂ + t, and its ray u goes there: u × p = 0, which
    is linear in the two columns of the rotation and the translation.

    Args:
        board: Corners in the board's plane.
        rays: Unit rays, finite also where the weight is zero.
        weights: Corners of weight zero do not count; other weights are not looked at.
    """
    used = (weights > 0).astype(rays.dtype)
    total = jnp.sum(used, axis=1)
    middle = jnp.sum(used[..., None] * board, axis=1) / total[:, None]
    about = board - middle[:, None]
    spread = jnp.sqrt(jnp.sum(used[..., None] * about**2, axis=(1, 2)) / total)
    places = jnp.concatenate([about / spread[:, None, None], jnp.ones_like(used)[..., None]], axis=-1)
    # |u × p|² = pᵀ (1 − u uᵀ) p for a unit u; p is linear in the nine unknowns.
    across = jnp.eye(3, dtype=rays.dtype)[None, None] - rays[..., :, None] * rays[..., None, :]
    gram = jnp.einsum("vn,vnij,vna,vnb->viajb", used, across, places, places)
    matrices = jnp.linalg.eigh(gram.reshape(-1, 9, 9))[1][:, :, 0].reshape(-1, 3, 3)
    ahead = jnp.einsum("vn,vni,via,vna->v", used, rays, matrices, places)
    # Back from the scaled board about its middle.
    turned = matrices[:, :, :2] / spread[:, None, None]
    origin = matrices[:, :, 2] - jnp.einsum("via,va->vi", turned, middle)
    matrices = jnp.concatenate([turned, origin[..., None]], axis=-1)
    return _nearest_poses(matrices * jnp.where(ahead < 0, -1, 1)[:, None, None])


def equidistant_start(
    board: Float[Array, "views corners 2"],
    observed: Float[Array, "views corners 2"],
    weights: Float[Array, "views corners"],
    size: Float[Array, "2"],
) -> tuple[Float[Array, ""], Poses]:
    """Returns a focal length and poses with which an equidistant fisheye sees the boards best, of a few tries.

    Args:
        board: Corners in the board's plane.
        observed: Where they are seen, in pixels.
        weights: As of `poses_from_rays`.
        size: Width and height of the picture; its middle is the principal point.
    """
    used = weights > 0
    about = observed - (0.5 * (size - 1))[None, None]
    radius = jnp.sqrt(jnp.sum(about**2, axis=-1))

    def attempt(length):
        angle = radius / length
        # sin θ along the picture's direction, cos θ ahead.
        rays = jnp.concatenate([about / length * jnp.sinc(angle / jnp.pi)[..., None], jnp.cos(angle)[..., None]], -1)
        poses = poses_from_rays(board, rays, weights)
        x, y, z = jnp.moveaxis(poses.place(board), -1, 0)
        aside = jnp.sqrt(x * x + y * y)
        stretch = length * jnp.arctan2(aside, z) / jnp.where(aside > 0, aside, 1)
        missed = about - jnp.stack([x * stretch, y * stretch], axis=-1)
        return jnp.sum(jnp.where(used[..., None], missed**2, 0)), poses

    lengths = jnp.asarray(_FOCAL_LENGTHS, observed.dtype) * jnp.max(size)
    missed, poses = jax.vmap(attempt)(lengths)
    best = jnp.argmin(missed)
    return lengths[best], jax.tree.map(lambda leaf: leaf[best], poses)


def _nearest_poses(matrices: Float[Array, "views 3 3"]) -> Poses:
    """Returns the poses nearest to matrices [r₁ r₂ t] of some scale."""
    size = 0.5 * (jnp.linalg.norm(matrices[:, :, 0], axis=1) + jnp.linalg.norm(matrices[:, :, 1], axis=1))
    matrices = matrices / size[:, None, None]
    first, second, translation = matrices[:, :, 0], matrices[:, :, 1], matrices[:, :, 2]
    left, _, right = jnp.linalg.svd(jnp.stack([first, second, jnp.cross(first, second)], axis=-1))
    rotation = left @ right
    rotation = rotation * jnp.sign(jnp.linalg.det(rotation))[:, None, None]
    return Poses(rotation_vector(rotation), translation)
