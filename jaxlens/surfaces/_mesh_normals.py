"""The normals of a mesh as it is seen, for smooth shading: between the vertices they turn, as the surface would."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from jaxlens.surfaces._from_mesh import Projection, Seen, look_at
from jaxlens.surfaces._mesh import Mesh
from jaxlens.surfaces._rasterize import expanded

# The cosine of the angle from which a bend between faces is an edge.
_EDGE = np.cos(np.radians(60))
# Faces about a vertex from which on they are not compared, one with each other.
_MANY = 256


def normals_from_mesh(
    mesh: Mesh,
    height: int,
    width: int,
    *,
    projection: Projection = "orthographic",
    field_of_view: float = 30.0,
    center: ArrayLike | Sequence[ArrayLike] | None = None,
    spacing: float | None = None,
    margin: float = 0.05,
) -> Float[Array, "height width 3"]:
    """Finds the unit normals of what `from_mesh` sees, for `shade`: a mesh lit by them shows no facets.

    The normal at a face's corner is the mean of those of the faces around it, weighted by area; within the face normals
    are interpolated (Phong). Vertices at one place count as one, and a face that is turned by more than 60° against
    another lies behind an edge and does not count.

    Args:
        mesh: As for `from_mesh`, and so are the others.
        height: Height of the picture, in pixels.
        width: Width of the picture, in pixels.
        projection: `orthographic`, or `perspective`.
        field_of_view: In perspective, the angle in degrees that the picture's height spans.
        center: (x, y, z), what stands in the middle of the picture.
        spacing: Mesh units a pixel.
        margin: The share of the picture left free on each side.

    Returns:
        `(H, W, 3)` in the world of `DepthMap`: x to the right, y downwards, z towards the viewer, on the viewer's side
        of the surface. Where there is no surface, (0, 0, 1).

    Raises:
        ValueError: as `from_mesh`.

    Example:
        >>> from jaxlens.surfaces import Mesh, normals_from_mesh
        >>> triangle = Mesh([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 2.0, 1.0]], [[0, 1, 2]])
        >>> float(normals_from_mesh(triangle, 3, 3)[1, 1, 2])
        1.0
    """
    seen = look_at(mesh, height, width, projection, field_of_view, center, spacing, margin)
    rows, columns = np.nonzero(seen.face >= 0)
    face = seen.face[rows, columns]
    share = _shares(seen, face, np.stack([columns, rows], axis=-1))
    once, which = np.unique(face, return_inverse=True)
    found = np.zeros((height, width, 3))
    found[..., 2] = 1
    found[rows, columns] = _unit(np.einsum("pi,pij->pj", share, _corner_normals(seen, once)[which])) * [1, -1, 1]
    return jnp.asarray(found)


def _corner_normals(seen: Seen, some: np.ndarray) -> np.ndarray:
    """Returns `(n, 3, 3)`, the unit normals at the corners of some faces, on the viewer's side."""
    first, second, third = (seen.vertices[seen.faces[:, i]] for i in range(3))
    area = np.cross(second - first, third - first)
    own = _unit(area)
    place = np.unique(seen.vertices, axis=0, return_inverse=True)[1].reshape(-1)[seen.faces]
    total = np.stack([np.bincount(place.ravel(), np.repeat(area[:, i], 3)) for i in range(3)], axis=-1)
    # The corners at one place stand together in this order.
    order, counts = np.argsort(place.ravel(), kind="stable"), np.bincount(place.ravel())
    starts = np.cumsum(counts) - counts
    corners = place[some].ravel()
    few = np.flatnonzero(counts[corners] <= _MANY)
    corner, step = expanded(counts[corners[few]])
    around = order[starts[corners[few]][corner] + step] // 3
    same_side = np.sum(own[some][few[corner] // 3] * own[around], axis=-1) >= _EDGE
    sums = total[corners]
    for i in range(3):
        sums[few, i] = np.bincount(corner, area[around, i] * same_side, len(few))
    towards = np.array([0.0, 0.0, 1.0]) if seen.eye is None else seen.eye - first[some]
    side = np.where(np.sum(area[some] * towards, axis=-1) < 0, -1, 1)
    return _unit(sums).reshape(-1, 3, 3) * side[:, None, None]


def _shares(seen: Seen, face: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Returns `(P, 3)`, by how much each corner of a pixel's face counts there."""
    corners = seen.faces[face]
    a, b, c = (seen.points[corners[:, i]] - pixels for i in range(3))
    share = np.stack([p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((b, c), (c, a), (a, b))], axis=-1)
    share = share / share.sum(axis=-1, keepdims=True)
    # Covered pixels may lie a rounding error outside, and of slivers more.
    share = np.clip(share, 0, None) * seen.closeness[corners]
    return share / share.sum(axis=-1, keepdims=True)


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
