"""Depth maps of meshes, as an orthographic or a perspective camera sees them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import ArrayLike

from jaxlens.surfaces._depth_map import DepthMap
from jaxlens.surfaces._mesh import Mesh, check_mesh
from jaxlens.surfaces._rasterize import rasterize_faces

Projection = Literal["orthographic", "perspective"]


def from_mesh(
    mesh: Mesh,
    height: int,
    width: int,
    *,
    projection: Projection = "orthographic",
    field_of_view: float = 30.0,
    center: ArrayLike | Sequence[ArrayLike] | None = None,
    spacing: float | None = None,
    margin: float = 0.05,
) -> DepthMap:
    """Makes the depth map of a mesh: at each pixel the surface that is nearest to the viewer.

    The viewer looks along −z, with the mesh's x to the right and its y upwards. With the centre c, the spacing s and
    the middle of the picture m = ((W − 1)/2, (H − 1)/2), the vertex (x, y, z) is seen at the pixel

        (m_x + (x − c_x)/s · q,  m_y − (y − c_y)/s · q)

    where q = 1 in orthographic projection, and q = D / (D − (z − c_z)) in perspective: the camera stands at the
    distance D = s · (H/2) / tan(field_of_view/2) in front of the centre.

    Args:
        mesh: The mesh; `jaxlens.meshes.read` reads one from a file.
        height: Height of the picture, in pixels.
        width: Width of the picture, in pixels.
        projection: `orthographic`, or `perspective`.
        field_of_view: In perspective, the angle in degrees that the picture's height spans.
        center: (x, y, z), what stands in the middle of the picture; the middle of the mesh's bounding box by default.
        spacing: Mesh units a pixel (in perspective: at the centre's z). By default as small as shows the whole mesh.
        margin: The share of the picture left free on each side then, 0 ≤ margin < 0.5.

    Returns:
        A `DepthMap` with the mesh's z as depth, seen from both sides of a triangle; holes and the surroundings are
        outside the mask. Its x runs as the mesh's, its y against it. In perspective the pixels of a depth map lie on
        rays that diverge, while its x and y do not: they are right at the centre's z only.

    Raises:
        ValueError: no faces; arguments out of range; a mesh without extent; a perspective camera that does not stand in
            front of the whole mesh.

    Example:
        >>> from jaxlens.surfaces import Mesh, from_mesh
        >>> triangle = Mesh([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 2.0, 1.0]], [[0, 1, 2]])
        >>> from_mesh(triangle, 3, 3, spacing=1.0).mask.astype(int).tolist()
        [[1, 0, 0], [1, 1, 0], [1, 1, 1]]
    """
    seen = look_at(mesh, height, width, projection, field_of_view, center, spacing, margin)
    return DepthMap(seen.depth, mask=seen.face >= 0, spacing=seen.spacing)


@dataclass(frozen=True, eq=False)
class Seen:
    """A mesh as it is seen.

    Attributes:
        vertices: `(V, 3)`, as in the mesh.
        faces: `(F, 3)`.
        points: `(V, 2)`, the pixels where the vertices are seen.
        closeness: `(V,)`, one over the distance along the line of sight, in perspective; ones without.
        eye: (x, y, z) of the camera in perspective; None without.
        depth: `(H, W)`; not finite where there is no surface.
        face: `(H, W)`, which one is seen; −1 where there is none.
        spacing: Mesh units a pixel.
    """

    vertices: np.ndarray
    faces: np.ndarray
    points: np.ndarray
    closeness: np.ndarray
    eye: np.ndarray | None
    depth: np.ndarray
    face: np.ndarray
    spacing: float


def look_at(
    mesh: Mesh,
    height: int,
    width: int,
    projection: Projection,
    field_of_view: float,
    center: ArrayLike | Sequence[ArrayLike] | None,
    spacing: float | None,
    margin: float,
) -> Seen:
    """Checks the arguments of `from_mesh`, and returns what is seen."""
    if height < 1 or width < 1:
        raise ValueError(f"a picture needs at least one pixel, got height {height} and width {width}")
    if projection not in get_args(Projection):
        raise ValueError(f"projection must be one of {', '.join(get_args(Projection))}, got {projection!r}")
    if not 0 <= margin < 0.5:
        raise ValueError(f"margin must be a share of the picture, 0 ≤ margin < 0.5, got {margin}")
    if not 0 < field_of_view < 180:
        raise ValueError(f"field_of_view must lie between 0 and 180 degrees, got {field_of_view}")
    vertices, faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces)
    check_mesh(vertices, faces)
    if not len(faces):
        raise ValueError("the mesh has no faces; a surface needs triangles")
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True  # what has no face is not seen
    middle_of_mesh = _center(vertices[used], center)
    relative = vertices - middle_of_mesh
    focal = 0.5 * height / np.tan(np.radians(field_of_view) / 2)  # in pixels
    perspective = projection == "perspective"
    usable = np.array([width, height]) * (1 - 2 * margin)
    step = _spacing(relative[used], usable, focal if perspective else None, spacing)
    distance = step * focal
    middle = np.array([width - 1, height - 1]) / 2
    flat = relative[:, :2] * [1, -1] / step
    if not perspective:
        points = middle + flat
        found, face = rasterize_faces(points, vertices[:, 2], faces, height, width)
        return Seen(vertices, faces, points, np.ones(len(vertices)), None, found, face, step)
    ahead = distance - relative[:, 2]
    nearest = ahead[used].min()
    if nearest <= 1e-6 * distance:
        raise ValueError(
            f"the camera stands {distance:.6g} in front of the centre, inside or behind the mesh; use a larger spacing "
            "or a smaller field of view"
        )
    # Along a straight line in the picture not z is linear but the reciprocal of the distance.
    ahead = np.maximum(ahead, nearest)  # for vertices without a face
    points = middle + flat * (distance / ahead)[:, None]
    found, face = rasterize_faces(points, 1 / ahead, faces, height, width)
    depth = np.where(face >= 0, distance - 1 / np.where(face >= 0, found, 1) + middle_of_mesh[2], np.nan)
    eye = middle_of_mesh + np.array([0, 0, distance])
    return Seen(vertices, faces, points, 1 / ahead, eye, depth, face, step)


def _center(vertices: np.ndarray, center: ArrayLike | Sequence[ArrayLike] | None) -> np.ndarray:
    if center is None:
        return 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    values = np.asarray(center, np.float64)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ValueError(f"center must be three finite numbers (x, y, z), got {center}")
    return values


def _spacing(relative: np.ndarray, usable: np.ndarray, focal: float | None, spacing: float | None) -> float:
    """Returns the spacing: the given one, or the smallest that shows all vertices."""
    if spacing is not None:
        if not 0 < spacing < np.inf:
            raise ValueError(f"spacing must be positive and finite, got {spacing}")
        return float(spacing)
    half = np.abs(relative[:, :2]) / (0.5 * usable)
    if focal is None:
        smallest = half.max()
    else:
        # |x − c_x| / s · D / (D − z) ≤ usable/2 with D = s · focal
        extent = float(np.ptp(relative, axis=0).max())
        smallest = max((half + relative[:, 2:] / focal).max(), (relative[:, 2].max() + 1e-3 * extent) / focal)
    if not smallest > 0:
        raise ValueError("the mesh has no extent across the line of sight; pass a spacing")
    return float(smallest)
