"""The direct linear transform: a homography from correspondences in closed form (Hartley 1997)."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

_HIGHEST = lax.Precision.HIGHEST  # else a GPU rounds products in single precision to ten bits


def direct_linear_transform(
    source: Float[Array, "points 2"], target: Float[Array, "points 2"], weights: Float[Array, " points"]
) -> Float[Array, "3 3"]:
    """Returns the homography from source to target points by the normalized direct linear transform.

    Good as a start, and in closed form: it minimizes an algebraic error. What `estimate_homography` returns is best in
    the target.

    Args:
        source: `(N, 2)` points, (x, y) order; at least four, no three of them on a line. A batch is made by `jax.vmap`.
        target: `(N, 2)`, where they are seen.
        weights: `(N,)`; points of weight zero do not count (but must be finite), other weights are not looked at.

    Returns:
        The matrix. Its sign is that of a denominator that is positive in the middle of the source points, its scale
        arbitrary. Differentiable where the homography is the only one.

    Raises:
        ValueError: shapes that do not fit.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> square = jnp.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        >>> matrix = jl.deformations.direct_linear_transform(square, 2 * square + 1, jnp.ones(4))
        >>> (matrix / matrix[2, 2]).round(3).tolist()
        [[2.0, 0.0, 1.0], [0.0, 2.0, 1.0], [0.0, 0.0, 1.0]]
    """
    count = weights.shape[0] if weights.ndim == 1 else -1
    if source.shape != (count, 2) or target.shape != (count, 2):
        raise ValueError(
            "source and target must both have shape (N, 2), and weights (N,), got "
            f"{source.shape}, {target.shape} and {weights.shape}; for a batch use jax.vmap"
        )
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
