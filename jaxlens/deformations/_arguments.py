"""What the deformations ask of their arguments, once for all of them."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxlens.numerics import as_floating, as_points, is_concrete


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
