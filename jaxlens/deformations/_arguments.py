"""What the deformations ask of their arguments, once for all of them."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxlens.numerics import as_floating, as_points, epsilon, is_concrete

# Rounding of coordinates, as a share of what they extend over, that an estimate may suffer.
_COARSEST = 1e-5


def as_like(values: ArrayLike | Sequence, dtype: jnp.dtype) -> Array:
    """Returns `values` as a floating array: plain numbers take `dtype`, arrays keep their own."""
    array = as_floating(values)
    return array if hasattr(values, "dtype") else array.astype(dtype)


def as_rectangle(
    lower: ArrayLike | Sequence, upper: ArrayLike | Sequence, dtype: jnp.dtype
) -> tuple[Float[Array, "2"], Float[Array, "2"]]:
    """Returns the corners of a rectangle; plain numbers take `dtype`, arrays keep their own.

    Raises:
        ValueError: a corner is not one point, or the rectangle is empty.
    """
    lower, upper = as_like(lower, dtype), as_like(upper, dtype)
    for name, corner in (("lower", lower), ("upper", upper)):
        if corner.shape != (2,):
            raise ValueError(f"{name} must be one corner of a rectangle, (x, y), got shape {corner.shape}")
    if is_concrete(lower, upper) and not np.all(np.asarray(lower) < np.asarray(upper)):
        raise ValueError(f"the rectangle from lower={lower.tolist()} to upper={upper.tolist()} is empty: lower < upper")
    return lower, upper


def as_weights(weights: ArrayLike | Sequence | None, shape: tuple[int, ...], dtype: jnp.dtype) -> Array | None:
    """Returns the weights of control points; plain numbers take `dtype`.

    Raises:
        ValueError: a wrong shape, or a weight that is not positive and finite.
    """
    if weights is None:
        return None
    array = as_like(weights, dtype)
    if array.shape != shape:
        raise ValueError(f"weights must have shape {shape}, one for each control point, got {array.shape}")
    if is_concrete(array):
        values = np.asarray(array)
        bad = ~((values > 0) & np.isfinite(values))
        if bad.any():
            where = tuple(np.argwhere(bad)[0].tolist())
            raise ValueError(f"weights must be positive and finite, got {values[where]} at {list(where)}")
    return array


def check_digits(points: Float[Array, "points 2"], weights: Float[Array, " points"], name: str) -> None:
    """Makes sure that the dtype can tell points apart, however far from the origin they lie.

    Raises:
        ValueError: rounding of their coordinates is more than a hundred thousandth of their extent.
    """
    used = np.asarray(points, np.float64)[np.asarray(weights) > 0]
    extent, size = np.ptp(used, axis=0).max(), np.abs(used).max()
    if epsilon(points.dtype) * size > _COARSEST * extent:
        origin = used.mean(axis=0).round()
        raise ValueError(
            f"{name} points reach {size:.7g} and extend over {extent:.4g}: {points.dtype} keeps their places to "
            f"{epsilon(points.dtype) * size / 2:.1g}, and a matrix in it no better. Subtract an origin first, such as "
            f"{origin.tolist()}, or work in double precision (jax.enable_x64(True))"
        )


def as_correspondences(
    source: ArrayLike, target: ArrayLike, weights: ArrayLike | None
) -> tuple[Float[Array, "points 2"], Float[Array, "points 2"], Float[Array, " points"]]:
    """Returns points that belong together, and their weights: ones by default.

    Raises:
        ValueError: shapes that do not fit, a negative or non-finite weight, a point that counts and is not finite.
    """
    source, target = as_points(source), as_points(target)
    if source.ndim != 2 or source.shape != target.shape:
        raise ValueError(
            f"source and target must both have shape (N, 2), got {source.shape} and {target.shape}; for a batch use "
            "jax.vmap"
        )
    weights = jnp.ones(source.shape[:1], source.dtype) if weights is None else as_like(weights, source.dtype)
    if weights.shape != source.shape[:1]:
        raise ValueError(f"weights must have shape {source.shape[:1]}, one for each point, got {weights.shape}")
    if is_concrete(weights):
        values = np.asarray(weights)
        bad = ~(np.isfinite(values) & (values >= 0))
        if bad.any():
            where = int(np.argmax(bad))
            raise ValueError(f"weights must be finite and not negative, got {values[where]} at index {where}")
    for name, points in (("source", source), ("target", target)):
        if is_concrete(points, weights):
            bad = ~np.isfinite(np.asarray(points)).all(axis=-1) & (np.asarray(weights) > 0)
            if bad.any():
                where = int(np.argmax(bad))
                raise ValueError(
                    f"{name}[{where}] is not finite: {np.asarray(points)[where].tolist()}; remove it, or give it "
                    "weight 0"
                )
    return source, target, weights
