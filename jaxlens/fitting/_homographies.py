"""Closed-form starts for calibration: homographies of a plane, focal lengths and poses from them (Zhang 2000)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxlens.fitting._poses import Poses, rotation_vector
from jaxlens.frames import Frame


def plane_homographies(
    source: Float[Array, "views points 2"],
    target: Float[Array, "views points 2"],
    weights: Float[Array, "views points"],
) -> Float[Array, "views 3 3"]:
    """Returns the homographies from source to target points: the normalized direct linear transform (Hartley 1997)."""
    return jax.vmap(_homography)(source, target, weights)


def _homography(source: Array, target: Array, weights: Array) -> Array:
    used = (weights > 0).astype(source.dtype)
    source, from_source = _conditioned(source, used)
    target, from_target = _conditioned(target, used)
    x, y = source[:, 0], source[:, 1]
    u, v = target[:, 0], target[:, 1]
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    first = jnp.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=-1)
    second = jnp.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=-1)
    rows = jnp.concatenate([first, second]) * jnp.concatenate([used, used])[:, None]
    # The coordinates are conditioned, and a start need not be exact: the square of the matrix serves.
    matrix = jnp.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    return jnp.linalg.solve(from_target, matrix @ from_source)


def _conditioned(points: Array, used: Array) -> tuple[Array, Array]:
    """Points about the origin at a mean distance of about √2, and the matrix that brings them there."""
    count = jnp.sum(used)
    points = jnp.where(used[:, None] > 0, points, 0)
    middle = jnp.sum(points, axis=0, keepdims=True) / count
    spread = jnp.sqrt(0.5 * jnp.sum(used[:, None] * (points - middle) ** 2) / count)
    scale = 1 / jnp.where(spread > 0, spread, 1)
    zero, one = jnp.zeros_like(scale), jnp.ones_like(scale)
    shift = -scale * middle[0]
    matrix = jnp.stack(
        [jnp.stack([scale, zero, shift[0]]), jnp.stack([zero, scale, shift[1]]), jnp.stack([zero, zero, one])]
    )
    return scale * (points - middle), matrix


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
