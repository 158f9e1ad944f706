"""Surfaces through coordinate maps: depth maps are pulled back as pictures are, meshes are pushed forward."""

from collections.abc import Callable
from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxlens.frames import Frame
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import epsilon
from jaxlens.sampling import remap
from jaxlens.surfaces._depth_map import DepthMap
from jaxlens.surfaces._mesh import Mesh
from jaxlens.warping import frame_for, pixel_grid

SpaceMap = Callable[[Float[Array, "*batch 3"]], Float[Array, "*batch 3"]]
Interpolation = Literal["nearest", "bilinear", "bicubic"]


class DeformedDepthMap(eqx.Module):
    """What `deform_depth_map` returns.

    Attributes:
        depth_map: The deformed surface, on the same grid.
        folded: `(H, W)`, true where a pixel has a source but the map is not one-to-one: part of the surface is seen
            there a second time, or mirrored.
    """

    depth_map: DepthMap
    folded: Bool[Array, "height width"]


class DeformedMesh(eqx.Module):
    """What `deform_mesh` returns.

    Attributes:
        mesh: The moved mesh.
        folded: `(F,)`, true for triangles that the map has turned over.
    """

    mesh: Mesh
    folded: Bool[Array, " faces"]


@eqx.filter_jit
def deform_depth_map(
    depth_map: DepthMap, mapping: CoordinateMap, *, frame: Frame | None = None, method: Interpolation = "bilinear"
) -> DeformedDepthMap:
    """Pulls a surface back through a map of the picture's plane: `z_new(p) = z(mapping(p))`, as `jaxlens.warp`.

    Args:
        depth_map: The surface. Its mask decides what is there to be seen: a new pixel is inside the mask where all
            pixels that its depth is interpolated from are.
        mapping: From points of the new picture to points of the old one, both normalized. To deform with a lens,
            `Inverted(lens)`; without its fold, `OneToOne(mapping)`.
        frame: Ties pixels to normalized coordinates; Eq. 10's by default.
        method: The interpolation of the depth, as in `jaxlens.remap`.

    Returns:
        A `DeformedDepthMap`. Depths outside the mask are zero. Differentiable with respect to the depth, the map's
        parameters and the frame; the mask is not.

    Raises:
        ValueError: an unknown method.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> from jaxlens.surfaces import DepthMap, deform_depth_map
        >>> plane = DepthMap(jnp.ones((4, 6)))
        >>> int(deform_depth_map(plane, jl.Inverted(jl.RadialPolynomial([-0.3]))).depth_map.mask.sum()) < 24
        True
    """
    if method not in get_args(Interpolation):
        raise ValueError(f"method must be one of {', '.join(get_args(Interpolation))}, got {method!r}")
    height, width = depth_map.shape
    frame = frame_for(mapping, height, width) if frame is None else frame
    points = frame.normalize(pixel_grid(height, width, frame.scale.dtype))
    source = frame.denormalize(mapping(points))
    exists = jnp.all(jnp.isfinite(source), axis=-1)
    covered = jnp.ones((height, width), bool)
    present = depth_map.mask.astype(source.dtype)
    # Bicubic weights may cancel by chance; the bilinear ones beside them cannot.
    for kernel in ("bicubic", "bilinear") if method == "bicubic" else (method,):
        share = remap(present, source, method=kernel)
        covered &= jnp.abs(share - 1) <= 64 * epsilon(share.dtype)
    mask = covered & exists
    depth = remap(jnp.where(depth_map.mask, depth_map.depth, 0), source, method=method)
    folded = exists & ~mapping.one_to_one(points)
    return DeformedDepthMap(DepthMap(jnp.where(mask, depth, 0), mask=mask, spacing=depth_map.spacing), folded)


def deform_mesh(mesh: Mesh, mapping: CoordinateMap | SpaceMap, *, frame: Frame | None = None) -> DeformedMesh:
    """Moves the vertices of a mesh. Faces and texture coordinates stay; normals follow from the moved vertices.

    Args:
        mesh: The mesh.
        mapping: Either a map of the plane: it moves x and y as the viewer sees them and keeps z. It is given
            `frame.normalize((x, −y))`, with y downwards as in pictures, so that a map means the same for a mesh as for
            the picture of it. Or any pointwise function of space, `(…, 3)` to `(…, 3)` in the mesh's own coordinates.
            Points are pushed forward: a lens deforms by `lens`, not by its inverse.
        frame: For maps of the plane; by default the middle of the mesh's bounding box, and half its diagonal across
            the line of sight as the unit.

    Returns:
        A `DeformedMesh`. A triangle counts as folded where its area as the viewer sees it has changed sign (planar
        maps), or where the Jacobian determinant at its centroid is negative (maps of space). Differentiable with
        respect to the vertices and the map's parameters.

    Raises:
        ValueError: a frame for a map of space; a map that returns another shape, or sends a vertex to NaN (one without
            preimage under an inverse): remove such vertices before.

    Example:
        >>> import jaxlens as jl
        >>> from jaxlens.surfaces import Mesh, deform_mesh
        >>> triangle = Mesh([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]], [[0, 1, 2]])
        >>> deform_mesh(triangle, lambda points: 2 * points).mesh.vertices[1].tolist()
        [8.0, 0.0, 0.0]
    """
    corners = mesh.vertices[mesh.faces]
    if isinstance(mapping, CoordinateMap):
        frame = _frame_of(mesh.vertices) if frame is None else frame
        flip = jnp.asarray([1, -1], mesh.vertices.dtype)[None, :]
        flat = mesh.vertices[:, :2] * flip
        moved = frame.denormalize(mapping(frame.normalize(flat))) * flip
        vertices = jnp.concatenate([moved.astype(mesh.vertices.dtype), mesh.vertices[:, 2:]], axis=1)
        folded = _seen_area(corners) * _seen_area(vertices[mesh.faces]) < 0
    else:
        if frame is not None:
            raise ValueError("a frame belongs to maps of the plane; a map of space takes the mesh's own coordinates")
        vertices = mapping(mesh.vertices)
        shape = getattr(vertices, "shape", None)
        if shape != mesh.vertices.shape:
            raise ValueError(f"a map of space must return points of shape {mesh.vertices.shape}, got {shape}")
        folded = _determinant(mapping, jnp.mean(corners, axis=1)) < 0
    return DeformedMesh(Mesh(vertices, mesh.faces, texture_coordinates=mesh.texture_coordinates), folded)


def _frame_of(vertices: Float[Array, "vertices 3"]) -> Frame:
    flat = vertices[:, :2] * jnp.asarray([1, -1], vertices.dtype)[None, :]
    low, high = jnp.min(flat, axis=0), jnp.max(flat, axis=0)
    return Frame(0.5 * (low + high), 0.5 * jnp.linalg.norm(high - low))


def _seen_area(corners: Float[Array, "faces 3 3"]) -> Float[Array, " faces"]:
    first, second = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _determinant(mapping: SpaceMap, points: Float[Array, "points 3"]) -> Float[Array, " points"]:
    def along(axis):
        direction = jnp.zeros_like(points).at[:, axis].set(1)
        return jax.jvp(mapping, (points,), (direction,))[1]

    x, y, z = (along(axis) for axis in range(3))
    return jnp.sum(jnp.cross(x, y) * z, axis=-1)
