"""Poses: where a board stands before the camera."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float


class Poses(eqx.Module):
    """Rotations and translations from the board's coordinates to the camera's (x right, y down, z forward).

    Attributes:
        rotation_vectors: `(..., 3)`, axis times angle in radians (OpenCV's rvec).
        translations: `(..., 3)`, in the board's units (OpenCV's tvec).
    """

    rotation_vectors: Float[Array, "*views 3"] = eqx.field(converter=jnp.asarray)
    translations: Float[Array, "*views 3"] = eqx.field(converter=jnp.asarray)

    def rotations(self) -> Float[Array, "*views 3 3"]:
        """Returns the rotation matrices."""
        return rotation_matrix(self.rotation_vectors)

    def place(self, board: Float[ArrayLike, "*#views points 2"]) -> Float[Array, "*views points 3"]:
        """Returns where points of the board's plane are before the camera, (X, Y, Z)."""
        rotation = self.rotations()
        turned = jnp.einsum("...ij,...nj->...ni", rotation[..., :, :2], jnp.asarray(board))
        return turned + self.translations[..., None, :]

    def project(self, board: Float[ArrayLike, "*#views points 2"]) -> Float[Array, "*views points 2"]:
        """Returns the ideal image points (X/Z, Y/Z) of points of the board's plane, (x, y) order."""
        inside = self.place(board)
        return inside[..., :2] / inside[..., 2:]


def rotation_matrix(vector: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Returns the matrices of rotation vectors, axis times angle in radians (Rodrigues); smooth at zero.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> jl.fitting.rotation_matrix(jnp.array([0.0, 0.0, jnp.pi / 2])).round(3).tolist()
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    vector = jnp.asarray(vector)
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    squared = x * x + y * y + z * z
    small = squared < 1e-4
    safe = jnp.where(small, 1, squared)
    angle = jnp.sqrt(safe)
    # sin θ / θ and (1 − cos θ) / θ², by their series near zero.
    first = jnp.where(small, 1 - squared / 6 * (1 - squared / 20 * (1 - squared / 42)), jnp.sin(angle) / angle)
    second = jnp.where(small, 0.5 - squared / 24 * (1 - squared / 30 * (1 - squared / 56)), (1 - jnp.cos(angle)) / safe)
    rows = [
        [1 - second * (y * y + z * z), second * x * y - first * z, second * x * z + first * y],
        [second * x * y + first * z, 1 - second * (x * x + z * z), second * y * z - first * x],
        [second * x * z - first * y, second * y * z + first * x, 1 - second * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def rotation_vector(matrix: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Returns the rotation vectors of rotation matrices; angles up to π, by way of quaternions."""
    trace = jnp.trace(matrix, axis1=-2, axis2=-1)
    diagonal = jnp.diagonal(matrix, axis1=-2, axis2=-1)
    # Four times the squares of a quaternion's parts (w, x, y, z); the largest is safe to divide by.
    squares = jnp.concatenate([1 + trace[..., None], 1 + 2 * diagonal - trace[..., None]], axis=-1)
    difference = jnp.stack(
        [
            matrix[..., 2, 1] - matrix[..., 1, 2],
            matrix[..., 0, 2] - matrix[..., 2, 0],
            matrix[..., 1, 0] - matrix[..., 0, 1],
        ],
        axis=-1,
    )
    total = matrix + jnp.swapaxes(matrix, -1, -2)
    on_diagonal = jnp.broadcast_to(jnp.eye(3, dtype=bool), total.shape)
    imaginary = jnp.where(on_diagonal, squares[..., 1:, None], total)
    with_real = jnp.concatenate([difference[..., :, None], imaginary], axis=-1)
    real = jnp.concatenate([squares[..., :1], difference], axis=-1)
    candidates = jnp.concatenate([real[..., None, :], with_real], axis=-2)
    best = jnp.argmax(squares, axis=-1)
    quaternion = jnp.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    quaternion = quaternion / jnp.linalg.norm(quaternion, axis=-1, keepdims=True)
    quaternion = jnp.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    imaginary = quaternion[..., 1:]
    sine = jnp.linalg.norm(imaginary, axis=-1, keepdims=True)
    angle = 2 * jnp.arctan2(sine, quaternion[..., :1])
    return imaginary * jnp.where(sine > 1e-12, angle / jnp.where(sine > 1e-12, sine, 1), 2)
