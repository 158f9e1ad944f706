"""Coordinate maps: functions from points to points, with exact inverses that say where they exist."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Int8, PyTree

from jaxlens.newton import determinant, implicit_point_root, solve_points, value_and_jacobian
from jaxlens.numerics import Status, as_points, jitted, masked, numbered, shown


class InverseStatus(Status):
    """Why a point of an inverse is, or is not, valid."""

    CONVERGED = 0
    """The preimage was found, to the precision of the dtype."""
    NO_PREIMAGE = 1
    """The point lies outside the image of the region where the map is one-to-one."""
    NOT_CONVERGED = 2
    """The solver gave up; a preimage may exist."""
    NOT_FINITE = 3
    """The point is NaN or infinite, or its square overflows."""


class Inverse(eqx.Module):
    """What `CoordinateMap.invert` found.

    Attributes:
        points: `(..., 2)`, or rays `(..., 3)`, finite everywhere. Where a point has no preimage, the nearest thing to
            one: the edge of the region where the map is one-to-one, so that the points are continuous across it.
        valid: `(...)`, true where `points` is the preimage.
        status: `(...)`, an `InverseStatus` for each point.
    """

    points: Float[Array, "*batch axes"]
    valid: Bool[Array, "*batch"]
    status: Int8[Array, "*batch"]

    def masked(self) -> Float[Array, "*batch axes"]:
        """Returns the points, with NaN where they are not valid."""
        return masked(self.points, self.valid)


def inverse_status(
    finite: Bool[Array, "*batch"], inside: Bool[Array, "*batch"], converged: Bool[Array, "*batch"]
) -> Int8[Array, "*batch"]:
    """Returns the first reason, in this order, that keeps each point from being valid."""
    status = jnp.where(converged, InverseStatus.CONVERGED, InverseStatus.NOT_CONVERGED)
    status = jnp.where(inside, status, InverseStatus.NO_PREIMAGE)
    return jnp.where(finite, status, InverseStatus.NOT_FINITE).astype(jnp.int8)


class CoordinateMap(eqx.Module):
    """A map of the plane, pointwise and differentiable: lenses, deformations, and chains of them.

    A map is a pytree of its parameters: `jax.jit`, `jax.grad` and `jax.vmap` over a batch of maps work as on any
    array. Subclasses define `__call__`; they override `invert` where something better than the two-dimensional
    Newton iteration is known.
    """

    def __repr__(self) -> str:
        return shown(self)

    @property
    def needs_frame(self) -> bool:
        """Whether the map is written in coordinates of its own, as a camera's, so that Eq. 10's frame is not meant."""
        return False

    @abc.abstractmethod
    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps points `(..., 2)` in (x, y) order."""

    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether points lie where the map is one-to-one; here: where it keeps orientation."""
        return self.jacobian_determinant(points) > 0

    def surely_one_to_one(self, points: Float[Array, "*batch 2"]) -> Bool[Array, "*batch"] | None:
        """Tells whether points lie in a convex set where the map is known to be one-to-one; None where none is known.

        What surely holds for the corners of a picture holds for all of its pixels: one need not look at each.
        """
        return None

    def adjustable(self) -> PyTree:
        """Returns which of the map's numbers a fit adjusts unless told otherwise: its structure, True for each array.

        A map with numbers that tell where it is, rather than what it does, overrides this.
        """
        return jax.tree.map(lambda _: True, self)

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns what a fit calls the numbers of a field, row by row: by default the field's name and an index.

        Args:
            field: The field's name.
            shape: Shape of the array that it holds.
        """
        return numbered(field, shape)

    @jitted
    def jacobian(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2 2"]:
        """Returns the matrices of derivatives: row = output coordinate, column = input coordinate."""
        return value_and_jacobian(self.__call__, as_points(points))[1]

    @jitted
    def jacobian_determinant(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch"]:
        """Returns the local change of area, negative where the map has folded over."""
        return determinant(self.jacobian(points))

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the preimages of points by a two-dimensional Newton iteration that never crosses a fold.

        Args:
            points: `(..., 2)`; the iteration starts at the points themselves, unless a map knows better, so the
                map should be a deformation of the identity.

        Returns:
            An `Inverse`. Its points have derivatives of every order with respect to `points` and the map's
            parameters, by the implicit function theorem; in masked places they are finite.
        """
        points = as_points(points)
        finite = jnp.all(jnp.isfinite(points), axis=-1)
        target = jnp.where(finite[..., None], points, 0)
        fixed = lax.stop_gradient(self)
        root, converged, at_fold = solve_points(fixed.__call__, target, fixed.first_guess(target))
        solution = implicit_point_root(_plane_residual, root, (self, target))
        solution = jnp.where(converged[..., None], solution, root)
        # An iteration that stalls at a fold stands at the edge of the map's range.
        status = inverse_status(finite, ~at_fold, converged)
        return Inverse(solution, status == InverseStatus.CONVERGED, status)

    def first_guess(self, points: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Returns where `invert` starts: points where the map keeps orientation, on this side of every fold."""
        return points

    def preimages(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Returns the points of `invert`, NaN where they are not valid."""
        return self.invert(points).masked()

    def inverse(self) -> "CoordinateMap":
        """Returns the inverse as a map of its own; it sends points without preimage to NaN."""
        return Inverted(self)

    def then(self, *others: "CoordinateMap") -> "Chain":
        """Returns the map that applies this one first, then the others in turn."""
        return Chain((self, *others))


def _plane_residual(x: Array, parameters: tuple[CoordinateMap, Array]) -> Array:
    mapping, target = parameters
    return mapping(x) - target


class Inverted(CoordinateMap):
    """The inverse of a map: NaN where the map has no preimage."""

    mapping: CoordinateMap

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Returns the preimages of points, NaN where there is none."""
        return self.mapping.preimages(points)

    @property
    def needs_frame(self) -> bool:
        """Whether the map itself needs a frame."""
        return self.mapping.needs_frame

    def adjustable(self) -> PyTree:
        """Returns which numbers a fit adjusts: those of the map itself."""
        return Inverted(self.mapping.adjustable())

    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether points have a preimage."""
        return self.mapping.invert(points).valid

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Applies the map itself; valid where it is one-to-one."""
        points = as_points(points)
        finite = jnp.all(jnp.isfinite(points), axis=-1)
        safe = jnp.where(finite[..., None], points, 0)
        inside = self.mapping.one_to_one(safe)
        status = inverse_status(finite, inside, jnp.ones_like(inside))
        return Inverse(self.mapping(safe), status == InverseStatus.CONVERGED, status)

    def inverse(self) -> CoordinateMap:
        """Returns the map that this one inverts."""
        return self.mapping


class OneToOne(CoordinateMap):
    """A map restricted to where it is one-to-one: NaN elsewhere, so that what has folded over is not seen twice."""

    mapping: CoordinateMap

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Applies the map, NaN where it is not one-to-one."""
        points = as_points(points)
        return masked(self.mapping(points), self.mapping.one_to_one(points))

    @property
    def needs_frame(self) -> bool:
        """Whether the map itself needs a frame."""
        return self.mapping.needs_frame

    def adjustable(self) -> PyTree:
        """Returns which numbers a fit adjusts: those of the map itself."""
        return OneToOne(self.mapping.adjustable())

    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether points lie where the map is one-to-one."""
        return self.mapping.one_to_one(points)

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the preimages as the map itself does."""
        return self.mapping.invert(points)


class Chain(CoordinateMap):
    """Maps applied one after another, the first one first.

    Attributes:
        maps: The maps, in the order in which a point meets them; none at all is the identity.
    """

    maps: tuple[CoordinateMap, ...]

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Applies each map in turn."""
        points = as_points(points)
        for mapping in self.maps:
            points = mapping(points)
        return points

    @property
    def needs_frame(self) -> bool:
        """Whether one of the maps needs a frame."""
        return any(mapping.needs_frame for mapping in self.maps)

    def adjustable(self) -> PyTree:
        """Returns which numbers a fit adjusts: those of each map."""
        return Chain(tuple(mapping.adjustable() for mapping in self.maps))

    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether each map is one-to-one where the point meets it."""
        points = as_points(points)
        inside = jnp.ones(points.shape[:-1], bool)
        for mapping in self.maps:
            inside &= mapping.one_to_one(points)
            points = mapping(points)
        return inside

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Inverts each map, the last one first; a point is valid where every step is."""
        points = as_points(points)
        finite = jnp.all(jnp.isfinite(points), axis=-1)
        status = inverse_status(finite, finite, finite)
        current = jnp.where(finite[..., None], points, 0)
        for mapping in reversed(self.maps):
            step = mapping.invert(current)
            current = step.points
            status = jnp.where(status == InverseStatus.CONVERGED, step.status, status)
        return Inverse(current, status == InverseStatus.CONVERGED, status)

    def then(self, *others: CoordinateMap) -> "Chain":
        """Returns the longer chain."""
        return type(self)((*self.maps, *others))
