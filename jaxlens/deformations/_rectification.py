"""Perspective rectification: from a quadrilateral of a picture to an upright rectangle."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from jaxlens.deformations._homography import Homography
from jaxlens.numerics import as_points, is_concrete, split


def rectification(corners: ArrayLike | list | tuple, height: int, width: int) -> Homography:
    """Returns the homography that takes a quadrilateral of a picture to an upright rectangle, in pixels.

    Args:
        corners: `(4, 2)`, (x, y) pixels of the corners in the picture: those that shall become top left, top right,
            bottom right, bottom left. They go to the centres of the corner pixels of the new picture: (0, 0),
            (width − 1, 0), (width − 1, height − 1), (0, height − 1).
        height: Height of the new picture, in pixels, at least 2.
        width: Width of the new picture, in pixels, at least 2.

    Returns:
        The homography, from pixels of the picture to those of the new one; its denominator is positive in the
        quadrilateral. Differentiable with respect to the corners. Its inverse is what `jaxlens.warp` pulls a picture
        back by.

    Raises:
        ValueError: a shape or size that does not fit; corners that are not those of a convex quadrilateral in this
            order: crossed, concave, three on a line, or counterclockwise as seen in the picture.

    Example:
        The frame `(0, 0), 1` makes pixels the coordinates of `warp`.

        >>> import jax.numpy as jnp, jaxlens as jl
        >>> picture = jnp.arange(120.0).reshape(10, 12)
        >>> upright = jl.deformations.rectification([[2, 1], [9, 2], [10, 8], [1, 7]], 20, 30)
        >>> pixels = jl.Frame((0, 0), 1)
        >>> new = jl.warp(picture, upright.inverse(), frame=pixels, shape=(20, 30))
        >>> new.shape, abs(float(new[0, 0] - picture[1, 2])) < 1e-3
        ((20, 30), True)
    """
    corners = as_points(corners)
    if corners.shape != (4, 2):
        raise ValueError(f"a quadrilateral has four corners, of shape (4, 2), got {corners.shape}")
    if min(height, width) < 2:
        raise ValueError(f"a rectified picture needs a height and width of 2 pixels or more, got {height} and {width}")
    if is_concrete(corners):
        _check_convex(np.asarray(corners, np.float64), float(jnp.finfo(corners.dtype).eps))
    # From the unit square, whose corner (1, 1) goes to the third one (Heckbert 1989).
    (x0, x1, x2, x3), (y0, y1, y2, y3) = split(corners)
    ax, ay, bx, by = x1 - x2, y1 - y2, x3 - x2, y3 - y2
    sx, sy = x0 - x1 + x2 - x3, y0 - y1 + y2 - y3
    area = ax * by - bx * ay
    g, h = (sx * by - bx * sy) / area, (ax * sy - sx * ay) / area
    one = jnp.ones_like(g)
    rows = [
        [(x1 - x0 + g * x1) / (width - 1), (x3 - x0 + h * x3) / (height - 1), x0],
        [(y1 - y0 + g * y1) / (width - 1), (y3 - y0 + h * y3) / (height - 1), y0],
        [g / (width - 1), h / (height - 1), one],
    ]
    return Homography(jnp.stack([jnp.stack(row) for row in rows])).inverse()


def _check_convex(corners: np.ndarray, eps: float) -> None:
    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    rounding = 8 * eps * np.max(np.abs(corners)) * (np.max(np.abs(edges)))
    if np.isfinite(corners).all() and (turns > rounding).all():
        return
    if not np.isfinite(corners).all():
        reason = "not all of them are finite"
    elif (turns < -rounding).all():
        reason = "they go round counterclockwise, which would mirror the picture"
    elif (np.abs(turns) <= rounding).any():
        reason = "three of them lie on a line, or two coincide"
    elif (turns > 0).sum() == 2:
        reason = "its sides cross: the corners are not in order"
    else:
        reason = "it is not convex"
    raise ValueError(
        f"no quadrilateral to rectify, got {corners.tolist()}: {reason}; give top left, top right, bottom right, "
        "bottom left"
    )
