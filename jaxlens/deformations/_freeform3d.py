"""Free-form deformation of a parallelepiped of space (Sederberg and Parry 1986)."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int8

from jaxlens.deformations._arguments import as_like, as_weights
from jaxlens.deformations._bernstein import Cube, frozen_rows, preimages, unit_lattice
from jaxlens.maps import InverseStatus, inverse_status
from jaxlens.newton import adjugate, determinant, value_and_jacobian
from jaxlens.numerics import as_floating, epsilon, is_concrete, jitted

Face = Literal["s=0", "s=1", "t=0", "t=1", "u=0", "u=1"]
"""A face of the parallelepiped, by its equation in the local coordinates."""

_FACES: tuple[Face, ...] = ("s=0", "s=1", "t=0", "t=1", "u=0", "u=1")
# Rounding of local coordinates, in units in the last place of what they are differences of.
_FACE_ULPS = 4.0
_ORIGIN = (0.0, 0.0, 0.0)
_UNIT_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Inverse3D(eqx.Module):
    """What `FreeForm3D.invert` found: as `jaxlens.Inverse`, of points of space.

    Attributes:
        points: `(..., 3)`, finite everywhere.
        valid: `(...)`, true where `points` is a preimage.
        status: `(...)`, a `jaxlens.InverseStatus` for each point.
    """

    points: Float[Array, "*batch 3"]
    valid: Bool[Array, "*batch"]
    status: Int8[Array, "*batch"]

    def masked(self) -> Float[Array, "*batch 3"]:
        """Returns the points, with NaN where they are not valid."""
        return jnp.where(self.valid[..., None], self.points, jnp.nan)


class FreeForm3D(eqx.Module):
    """Free-form deformation of space: `FreeForm`, for points `(..., 3)` of a parallelepiped.

    A point is `origin + s axes[0] + t axes[1] + u axes[2]`; where s, t and u lie in [0, 1] it moves to
    `Σ Bᵢ(s) Bⱼ(t) Bₖ(u) w_ijk P_ijk / Σ Bᵢ(s) Bⱼ(t) Bₖ(u) w_ijk`, elsewhere it stays. All that `FreeForm` says of
    identity, borders and folds holds here, too.

    Attributes:
        control_points: `(l + 1, m + 1, n + 1, 3)`, for degrees l, m and n of one or more along the three axes.
        weights: `(l + 1, m + 1, n + 1)`, positive; None are equal ones.
        origin: The corner from which the axes start.
        axes: `(3, 3)`: each row is an edge of the parallelepiped; a right-handed or a left-handed three of them.

    Raises:
        ValueError: shapes that do not fit, weights that are not positive, axes that lie in a plane.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> still = jl.deformations.FreeForm3D.identity(2, 2, 2)
        >>> pulled = jl.deformations.FreeForm3D(still.control_points.at[1, 1, 1].add(0.8))
        >>> pulled(jnp.array([0.5, 0.5, 0.5])).round(3).tolist()
        [0.6000000238418579, 0.6000000238418579, 0.6000000238418579]
    """

    control_points: Float[Array, "l m n 3"]
    weights: Float[Array, "l m n"] | None
    origin: Float[Array, "3"]
    axes: Float[Array, "3 3"]

    def __init__(
        self,
        control_points: ArrayLike | list | tuple,
        *,
        weights: ArrayLike | list | tuple | None = None,
        origin: ArrayLike | list | tuple = _ORIGIN,
        axes: ArrayLike | list | tuple = _UNIT_AXES,
    ):
        self.control_points = as_floating(control_points)
        shape = self.control_points.shape
        if len(shape) != 4 or shape[-1] != 3 or min(shape[:-1]) < 2:
            raise ValueError(
                "control_points must have shape (l + 1, m + 1, n + 1, 3) for degrees l, m and n of one or more, got "
                f"{shape}; a batch of deformations is made by jax.vmap(FreeForm3D)(control_points)"
            )
        self.weights = as_weights(weights, shape[:-1], self.control_points.dtype)
        self.origin, self.axes = _as_parallelepiped(origin, axes, self.control_points.dtype)

    @classmethod
    def identity(
        cls,
        l: int,  # noqa: E741
        m: int,
        n: int,
        *,
        origin: ArrayLike | list | tuple = _ORIGIN,
        axes: ArrayLike | list | tuple = _UNIT_AXES,
    ) -> "FreeForm3D":
        """Returns the deformation that moves nothing: a regular lattice of degrees l, m and n."""
        dtype = jnp.result_type(as_floating(origin), as_floating(axes))
        origin, axes = _as_parallelepiped(origin, axes, dtype)
        return cls(_lattice((l + 1, m + 1, n + 1), origin, axes), origin=origin, axes=axes)

    @jitted
    def __call__(self, points: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 3"]:
        """Moves the points `(..., 3)` that lie in the parallelepiped."""
        points = _as_points(points)
        local = self._local(points)
        inside = self.contains(points)[..., None]
        # A point that does not count stands in a corner, where derivatives are finite.
        return points + jnp.where(inside, self._from_local(self._cube().displacement(jnp.where(inside, local, 0))), 0)

    def contains(self, points: Float[ArrayLike, "*batch 3"]) -> Bool[Array, "*batch"]:
        """Tells whether points lie in the parallelepiped, its faces included, to the rounding of their coordinates."""
        points = _as_points(points)
        local = self._local(points)
        shares = jnp.abs(adjugate(self.axes) / determinant(self.axes))
        sizes = [jnp.abs(points[..., k]) + jnp.abs(self.origin[k]) for k in range(3)]
        rounding = [sum(sizes[k] * shares[k, j] for k in range(3)) for j in range(3)]
        rounding = _FACE_ULPS * epsilon(local.dtype) * jnp.stack(rounding, axis=-1)
        return jnp.all((local >= -rounding) & (local <= 1 + rounding), axis=-1)

    @jitted
    def jacobian(self, points: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
        """Returns the matrices of derivatives: row = output coordinate, column = input coordinate."""
        return value_and_jacobian(self.__call__, _as_points(points))[1]

    @jitted
    def jacobian_determinant(self, points: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch"]:
        """Returns the local change of volume, negative where the map has folded over."""
        return determinant(self.jacobian(points))

    def one_to_one(self, points: Float[ArrayLike, "*batch 3"]) -> Bool[Array, "*batch"]:
        """Tells whether the map keeps orientation at points."""
        return self.jacobian_determinant(points) > 0

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 3"]) -> Inverse3D:
        """Finds what is moved to points `(..., 3)`: as `FreeForm.invert`, with an `Inverse3D`."""
        points = _as_points(points)
        finite = jnp.all(jnp.isfinite(points), axis=-1)
        points = jnp.where(finite[..., None], points, 0)
        target = self._local(points)
        local, found, gave_up = preimages(self._cube(), target)
        unmoved = ~found & ~self.contains(points)
        points = points + self._from_local(jnp.where(unmoved[..., None], 0, local - target))
        valid = found | unmoved
        status = inverse_status(finite, valid | gave_up, valid)
        return Inverse3D(points, status == InverseStatus.CONVERGED, status)

    def frozen(self, continuity: int, *, sides: Sequence[Face] = _FACES) -> Bool[np.ndarray, "l m n"]:
        """Returns which control points `freeze` puts back: the outermost `continuity + 1` layers of each face.

        Raises:
            ValueError: as `freeze`.
        """
        return frozen_rows(self.control_points.shape[:-1], continuity, sides, _FACES)

    def freeze(self, continuity: int, *, sides: Sequence[Face] = _FACES) -> "FreeForm3D":
        """Returns the deformation that joins what does not move with continuous derivatives up to an order.

        The outermost `continuity + 1` layers of control points return to the regular lattice, with weight one.

        Args:
            continuity: The order, 0 for continuity alone.
            sides: The faces across which it is to be.

        Raises:
            ValueError: an order below zero, an unknown face, or no control point left free.
        """
        frozen = jnp.asarray(self.frozen(continuity, sides=sides))
        lattice = _lattice(frozen.shape, self.origin, self.axes)
        control_points = jnp.where(frozen[..., None], lattice, self.control_points)
        weights = None if self.weights is None else jnp.where(frozen, 1, self.weights)
        return FreeForm3D(control_points, weights=weights, origin=self.origin, axes=self.axes)

    def _local(self, points: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
        """Coordinates s, t and u of points."""
        from_origin = [points[..., k] - self.origin[k] for k in range(3)]
        rows, size = adjugate(self.axes), determinant(self.axes)
        return jnp.stack([sum(from_origin[k] * rows[k, j] for k in range(3)) / size for j in range(3)], axis=-1)

    def _from_local(self, vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
        return jnp.stack([sum(vectors[..., j] * self.axes[j, k] for j in range(3)) for k in range(3)], axis=-1)

    def _cube(self) -> Cube:
        lattice = _lattice(self.control_points.shape[:-1], self.origin, self.axes)
        return Cube(self._local(self.control_points - lattice + self.origin[None, None, None]), self.weights)


def _as_points(points: ArrayLike) -> Float[Array, "*batch 3"]:
    array = as_floating(points)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"points of space must have shape (..., 3), got {array.shape}")
    return array


def _as_parallelepiped(
    origin: ArrayLike | Sequence, axes: ArrayLike | Sequence, dtype: jnp.dtype
) -> tuple[Float[Array, "3"], Float[Array, "3 3"]]:
    origin, axes = as_like(origin, dtype), as_like(axes, dtype)
    if origin.shape != (3,) or axes.shape != (3, 3):
        raise ValueError(f"origin must have shape (3,) and axes (3, 3), got {origin.shape} and {axes.shape}")
    if is_concrete(axes) and not np.linalg.matrix_rank(np.asarray(axes)) == 3:
        raise ValueError(f"axes must be three edges that do not lie in a plane, got {axes.tolist()}")
    return origin, axes


def _lattice(shape: Sequence[int], origin: Array, axes: Array) -> Float[Array, "l m n 3"]:
    unit = unit_lattice(shape, jnp.result_type(origin, axes))
    moved = [origin[k] + sum(unit[..., j] * axes[j, k] for j in range(3)) for k in range(3)]
    return jnp.stack(moved, axis=-1)
