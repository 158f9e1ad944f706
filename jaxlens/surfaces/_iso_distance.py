"""Curves of equal distance."""

from collections.abc import Sequence

import numpy as np
from contourpy import LineType, contour_generator
from jaxtyping import ArrayLike


def iso_distance_curves(distance: ArrayLike, levels: ArrayLike | Sequence[float]) -> list[list[np.ndarray]]:
    """Returns the curves along which a distance has given values.

    The distance is linear along the edges between pixels. Works on concrete arrays, outside `jax.jit`.

    Args:
        distance: `(H, W)`; what is not finite (outside the mask, or not reached) has no curves.
        levels: The values, in the distance's units.

    Returns:
        For each level a list of curves, each `(N, 2)` (x, y) in pixels; a closed curve ends at its first point. A level
        that is nowhere reached has an empty list.

    Raises:
        ValueError: a distance that is no picture of at least 2×2 pixels, a level that is not finite.

    Example:
        >>> import numpy as np
        >>> from jaxlens.surfaces import iso_distance_curves
        >>> x = np.broadcast_to(np.arange(4.0), (3, 4))
        >>> [[sorted(curve.tolist()) for curve in curves] for curves in iso_distance_curves(x, [1.5])]
        [[[[1.5, 0.0], [1.5, 1.0], [1.5, 2.0]]]]
    """
    values, wanted = np.asarray(distance, np.float64), np.atleast_1d(np.asarray(levels, np.float64))
    if values.ndim != 2 or min(values.shape) < 2:
        raise ValueError(f"distance must have shape (H, W) of at least 2×2 pixels, got {values.shape}")
    if wanted.ndim != 1 or not np.all(np.isfinite(wanted)):
        raise ValueError(f"levels must be finite numbers, got {wanted.tolist()}")
    generator = contour_generator(z=np.ma.masked_invalid(values), line_type=LineType.Separate)
    return [[np.asarray(curve) for curve in generator.lines(level)] for level in wanted]
