"""Triangle meshes."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from jaxlens.numerics import as_floating, is_concrete


class Mesh(eqx.Module):
    """A surface of triangles.

    Written as mesh files are: x to the right, y **upwards**, z towards the viewer, in whatever units the file has.
    (Pictures and depth maps have y downwards; `from_mesh` turns it over.)

    Attributes:
        vertices: `(V, 3)` positions.
        faces: `(F, 3)` indices into the vertices, counterclockwise seen from outside.
        texture_coordinates: `(V, 2)` (u, v) of each vertex in a texture picture, or none. They stay with the vertices
            whatever moves these.

    Raises:
        ValueError: shapes that do not fit, a vertex that is not finite, an index beyond the vertices. Under `jax.jit`
            the values are not looked at.

    Example:
        >>> from jaxlens.surfaces import Mesh
        >>> triangle = Mesh([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0, 1, 2]])
        >>> triangle.vertex_normals()[0].tolist()
        [0.0, 0.0, 1.0]
    """

    vertices: Float[Array, "vertices 3"]
    faces: Int[Array, "faces 3"]
    texture_coordinates: Float[Array, "vertices 2"] | None

    def __init__(
        self,
        vertices: ArrayLike | Sequence,
        faces: ArrayLike | Sequence,
        *,
        texture_coordinates: ArrayLike | Sequence | None = None,
    ):
        self.vertices = as_floating(vertices)
        self.faces = jnp.asarray(faces)
        self.texture_coordinates = None if texture_coordinates is None else as_floating(texture_coordinates)
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise ValueError(f"vertices must have shape (V, 3), got {self.vertices.shape}")
        if self.faces.ndim != 2 or self.faces.shape[1] != 3 or not jnp.issubdtype(self.faces.dtype, jnp.integer):
            raise ValueError(
                f"faces must be integers of shape (F, 3), three vertices each, got {self.faces.dtype} "
                f"{self.faces.shape}"
            )
        expected = (self.vertices.shape[0], 2)
        if self.texture_coordinates is not None and self.texture_coordinates.shape != expected:
            raise ValueError(
                f"texture_coordinates must have shape {expected}, one pair for each vertex, got "
                f"{self.texture_coordinates.shape}"
            )
        if is_concrete(self.vertices, self.faces):
            check_mesh(np.asarray(self.vertices), np.asarray(self.faces))

    def face_normals(self) -> Float[Array, "faces 3"]:
        """Returns the unit normals of the faces, zero for triangles without area. Differentiable."""
        return _unit(self._areas())

    def vertex_normals(self) -> Float[Array, "vertices 3"]:
        """Returns unit normals at the vertices: the mean of the faces around each, weighted by area.

        Zero where a vertex has no face, or where its faces cancel. Differentiable with respect to the vertices.
        """
        areas = jnp.repeat(self._areas(), 3, axis=0)
        return _unit(jnp.zeros_like(self.vertices).at[self.faces.ravel()].add(areas))

    def _areas(self) -> Float[Array, "faces 3"]:
        """Normals of the faces, twice their area long."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return jnp.cross(b - a, c - a)


def check_mesh(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raises `ValueError` for a vertex that is not finite, or an index beyond the vertices."""
    if not np.isfinite(vertices).all():
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        raise ValueError(
            f"vertices must be finite, got {vertices[bad[0]].tolist()} at index {bad[0]} ({len(bad)} such vertices); "
            "remove them and their faces"
        )
    if faces.size and (faces.min() < 0 or faces.max() >= len(vertices)):
        wrong = np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))
        raise ValueError(
            f"faces must index the {len(vertices)} vertices, from 0, got {faces[wrong[0]].tolist()} at face {wrong[0]} "
            f"({len(wrong)} such faces)"
        )


@jax.jit
def _unit(vectors: Float[Array, "count 3"]) -> Float[Array, "count 3"]:
    # Divided by the largest component first: the areas of small triangles are squares of small lengths.
    largest = jnp.max(jnp.abs(vectors), axis=-1, keepdims=True)
    nonzero = largest > 0
    scaled = vectors / jnp.where(nonzero, largest, 1)
    length = jnp.sqrt(jnp.where(nonzero, jnp.sum(scaled**2, axis=-1, keepdims=True), 1))
    return jnp.where(nonzero, scaled / length, 0)
