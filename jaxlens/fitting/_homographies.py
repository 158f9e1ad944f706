"""Closed-form starts for calibration: focal lengths and poses from homographies of a plane (Zhang 2000)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxlens.fitting._poses import Poses, rotation_vector
from jaxlens.frames import Frame


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
    size = 0.5 * (jnp.linalg.norm(matrices[:, :, 0], axis=1) + jnp.linalg.norm(matrices[:, :, 1], axis=1))
    sign = jnp.where(matrices[:, 2, 2] < 0, -1, 1)
    matrices = matrices * (sign / size)[:, None, None]
    first, second, translation = matrices[:, :, 0], matrices[:, :, 1], matrices[:, :, 2]
    left, _, right = jnp.linalg.svd(jnp.stack([first, second, jnp.cross(first, second)], axis=-1))
    rotation = left @ right
    rotation = rotation * jnp.sign(jnp.linalg.det(rotation))[:, None, None]
    return Poses(rotation_vector(rotation), translation)
