"""Configurations of points that leave a map of the plane undetermined, by name."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Points that determine a map of each kind.
_NEEDED = {"projective": 4, "affine": 3, "similarity": 2, "isometry": 2}
# Distance from a line, in units in the last place of the coordinates, that is no more than rounding.
_ROUNDING_ULPS = 16.0


def check_configuration(
    source: Float[Array, "points 2"], target: Float[Array, "points 2"], weights: Float[Array, " points"], kind: str
) -> None:
    """Raises `ValueError` if correspondences do not determine a regular map of that kind."""
    used = np.asarray(weights) > 0
    count, needed = int(used.sum()), _NEEDED[kind]
    if count < needed:
        raise ValueError(
            f"too few points: {count} for a map of the kind {kind!r}, which needs {needed}; give more data"
        )
    for name, points in (("source", source), ("target", target)):
        reason = _degeneracy(np.asarray(points, np.float64)[used], float(jnp.finfo(points.dtype).eps), needed)
        if reason:
            raise ValueError(
                f"degenerate configuration: {reason} of the {count} {name} points; they leave a map of the kind "
                f"{kind!r} undetermined, or make it singular: give points that are spread over the plane"
            )


def _degeneracy(points: Float[np.ndarray, "points 2"], eps: float, needed: int) -> str | None:
    rounding = _ROUNDING_ULPS * eps * np.max(np.abs(points))
    # Three points as far apart as there are.
    first = points[np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1))]
    second = points[np.argmax(np.linalg.norm(points - first, axis=1))]
    if np.linalg.norm(second - first) <= rounding:
        return "coincident points: no two different ones"
    if needed == 2:
        return None
    third = points[np.argmax(np.abs(_distances(points, first, second)))]
    if not _off(points, first, second, rounding).any():
        return "collinear points: all"
    if needed == 3:
        return None
    # Were all but one of the points on a line, two of the three would lie on it.
    for a, b in ((first, second), (first, third), (second, third)):
        off = points[_off(points, a, b, rounding)]
        if len(off) and np.max(np.linalg.norm(off - off[0], axis=1)) <= rounding:
            return "collinear points: all but one (or coincident ones beside a line)"
    return None


def _off(points: np.ndarray, a: np.ndarray, b: np.ndarray, rounding: float) -> np.ndarray:
    """Returns which points lie off the line through a and b by more than rounding in these can explain."""
    lever = 1 + np.linalg.norm(points - a, axis=1) / np.linalg.norm(b - a)
    return np.abs(_distances(points, a, b)) > rounding * lever


def _distances(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    direction, offset = b - a, points - a
    return (direction[0] * offset[:, 1] - direction[1] * offset[:, 0]) / np.linalg.norm(direction)
