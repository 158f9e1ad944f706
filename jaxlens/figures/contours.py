"""Contour lines of values on a grid, as points: to draw, and to write into files."""

from collections.abc import Sequence

import numpy as np
from contourpy import LineType, contour_generator
from jaxtyping import ArrayLike


def contour_lines(
    values: ArrayLike,
    levels: ArrayLike | Sequence[float],
    *,
    x: ArrayLike | None = None,
    y: ArrayLike | None = None,
) -> list[list[np.ndarray]]:
    """Finds the lines along which a function on a grid of pixels has given values.

    The function is linear along the edges between pixels. Of a distance along a surface they are the curves of equal
    distance.

    Args:
        values: `(H, W)`; through what is not finite (outside a mask, out of reach) no line runs.
        levels: The values wanted.
        x: Where the pixels stand, `(W,)` or `(H, W)`; 0 to W − 1 by default.
        y: The same downwards, `(H,)` or `(H, W)`; 0 to H − 1 by default.

    Returns:
        For each level a list of lines, each `(N, 2)` in (x, y); a closed line ends at its first point. A level that
        occurs nowhere has an empty list.

    Raises:
        ValueError: values that are no grid of at least 2×2 pixels, a level that is not finite.

    Example:
        >>> import numpy as np
        >>> from jaxlens.figures.contours import contour_lines
        >>> ramp = np.broadcast_to(np.arange(4.0), (3, 4))
        >>> [[sorted(line.tolist()) for line in lines] for lines in contour_lines(ramp, [1.5])]
        [[[[1.5, 0.0], [1.5, 1.0], [1.5, 2.0]]]]
    """
    heights, wanted = np.asarray(values, np.float64), np.atleast_1d(np.asarray(levels, np.float64))
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise ValueError(f"values must have shape (H, W) of at least 2×2 pixels, got {heights.shape}")
    if wanted.ndim != 1 or not np.all(np.isfinite(wanted)):
        raise ValueError(f"levels must be finite numbers, got {wanted.tolist()}")
    generator = contour_generator(x, y, np.ma.masked_invalid(heights), line_type=LineType.Separate)
    return [[np.asarray(line) for line in generator.lines(level)] for level in wanted]
