"""The direct linear transform: a homography from correspondences in closed form (Hartley 1997)."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

_HIGHEST = lax.Precision.HIGHEST  # else a GPU rounds products in single precision to ten bits


def direct_linear_transform(
    source: Float[Array, "points 2"], target: Float[Array, "points 2"], weights: Float[Array, " points"]
) -> Float[Array, "3 3"]:
    """Returns the homography from source to target points by the normalized direct linear transform.

    Good as a start: it minimizes an algebraic error. Points of weight zero do not count, other weights are not looked
    at. Its sign is that of a denominator that is positive in the middle of the source points, its scale arbitrary.
    """
    used = (weights > 0).astype(source.dtype)
    source, from_source = conditioned(source, used)
    target, from_target = conditioned(target, used)
    x, y = source[:, 0], source[:, 1]
    u, v = target[:, 0], target[:, 1]
    zero, one = jnp.zeros_like(x), jnp.ones_like(x)
    first = jnp.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=-1)
    second = jnp.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=-1)
    rows = jnp.concatenate([first, second]) * jnp.concatenate([used, used])[:, None]
    # The coordinates are conditioned, and a start need not be exact: the square of the matrix serves.
    matrix = jnp.linalg.eigh(jnp.matmul(rows.T, rows, precision=_HIGHEST))[1][:, 0].reshape(3, 3)
    matrix = jnp.where(matrix[2, 2] < 0, -matrix, matrix)
    return unconditioned(matrix, from_source, from_target)


def conditioned(
    points: Float[Array, "points 2"], weights: Float[Array, " points"]
) -> tuple[Float[Array, "points 2"], Float[Array, "3 3"]]:
    """Returns points about the origin at a mean distance of about √2, and the matrix that brings them there."""
    total = jnp.sum(weights)
    used = weights[:, None] > 0
    middle = jnp.sum(jnp.where(used, weights[:, None] * points, 0), axis=0) / total
    points = jnp.where(used, points - middle[None], 0)
    spread = jnp.sqrt(0.5 * jnp.sum(weights[:, None] * points**2) / total)
    scale = 1 / jnp.where(spread > 0, spread, 1)
    zero, one = jnp.zeros_like(scale), jnp.ones_like(scale)
    x, y = -scale * middle
    matrix = jnp.stack([jnp.stack([scale, zero, x]), jnp.stack([zero, scale, y]), jnp.stack([zero, zero, one])])
    return scale * points, matrix


def unconditioned(
    matrix: Float[Array, "3 3"], from_source: Float[Array, "3 3"], from_target: Float[Array, "3 3"]
) -> Float[Array, "3 3"]:
    """Returns a homography of points as they are, from that of conditioned ones."""
    return jnp.linalg.solve(from_target, jnp.matmul(matrix, from_source, precision=_HIGHEST))
