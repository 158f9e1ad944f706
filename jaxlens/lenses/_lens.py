"""What every lens can do, and what every radial lens can."""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float, Int8, PyTree

from jaxlens.batching import in_turns
from jaxlens.lenses._first_guess import first_guess
from jaxlens.lenses._general import lies_inside, solve
from jaxlens.lenses._region import find_region
from jaxlens.maps import CoordinateMap, Inverse, InverseStatus, inverse_status
from jaxlens.newton import implicit_point_root, implicit_root, is_root, solve_increasing
from jaxlens.numerics import as_floating, as_points, as_rays, jitted, join, masked, split


class Lens(CoordinateMap):
    """A coordinate map that takes ideal points to observed ones, both normalized.

    An ideal point (x, y) is the direction (x, y, 1): x to the right, y down, z forward. `project` and `unproject` speak
    of directions; a lens that is written on the plane sees those with z > 0, a `WideLens` perhaps more.

    A lens of one's own defines `distort`; for fits by name, from the command line, `identity`, too; and
    `jaxlens.lenses.register` gives it a name in files.
    """

    term_counts: ClassVar[tuple[int, ...]] = ()
    """How many coefficients `identity` can be asked for, the usual number first; none where there is no choice."""

    is_round: ClassVar[bool] = False
    """Whether the lens is the same when it is turned about its axis."""

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "Lens":
        """Returns the lens that distorts nothing: where a fit starts that knows no better.

        Args:
            terms: How many coefficients, of a class with `term_counts`; the usual number unless given.

        Raises:
            ValueError: a number that is none of `term_counts`.
            NotImplementedError: the class does not define it.
        """
        raise NotImplementedError(
            f"{cls.__name__} does not say where a fit starts: let its classmethod identity(cls, *, terms=None) return "
            "the lens that distorts nothing"
        )

    @classmethod
    def count_terms(cls, terms: int | None) -> int:
        """Returns how many coefficients are meant: those asked for, or the usual number.

        Raises:
            ValueError: a number that is none of `term_counts`.
        """
        if terms is None and cls.term_counts:
            return cls.term_counts[0]
        if terms not in cls.term_counts:
            listed = ", ".join(str(count) for count in sorted(cls.term_counts)) or "no"
            raise ValueError(f"the coefficients of {cls.__name__} can be {listed} in number, got {terms}")
        return terms

    @abc.abstractmethod
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones."""

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones, as `distort`."""
        return self.distort(points)

    @jitted
    def undistort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps observed points `(..., 2)` to ideal ones, exactly; NaN where there is none (see `invert`)."""
        return self.preimages(points)

    @jitted
    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether ideal points lie before the first fold on their ray from the origin."""
        x, y = split(as_points(points))
        return lies_inside(*lax.stop_gradient((self, x, y)))

    def pole_radius(self) -> Float[Array, ""]:
        """Returns the ideal radius about the origin where the lens becomes infinite; ∞ if it never does, or is unknown.

        Where `distort` divides by what may vanish, a lens of one's own defines this: a pole that the numerator nearly
        cancels is too narrow to be found by looking.
        """
        return jnp.asarray(jnp.inf)

    def surely_one_to_one(self, points: Float[Array, "*batch 2"]) -> Bool[Array, "*batch"] | None:
        """Tells whether ideal points lie nearer to the origin than the nearest fold."""
        lens, points = lax.stop_gradient((self, points))
        return find_region(lens.distort, jnp.zeros(2, points.dtype), lens.pole_radius()).surely(*split(points))

    @jitted
    def project(self, rays: Float[ArrayLike, "*batch 3"]) -> Float[Array, "*batch 2"]:
        """Maps rays to observed points.

        Args:
            rays: `(..., 3)` directions from the centre of projection, of any length: x to the right, y down, z forward.

        Returns:
            `(..., 2)` observed points in normalized coordinates; NaN where the lens does not see: beyond its field,
            beyond a fold, or where a ray is zero or not finite. Derivatives are finite, in masked places zero.
        """
        rays = as_rays(rays)
        finite = jnp.all(jnp.isfinite(rays), axis=-1)
        points, seen = self.observe(jnp.where(finite[..., None], rays, jnp.asarray([0, 0, 1], rays.dtype)))
        return masked(points, finite & seen)

    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, finite everywhere, and which of the rays the lens sees."""
        ideal, ahead = on_the_plane(rays)
        seen = ahead & self.one_to_one(ideal)
        return self.distort(jnp.where(seen[..., None], ideal, 0)), seen

    def turned(self, quarters: int) -> "Lens":
        """Returns the lens of pictures turned by quarters, as by `np.rot90`: (x, y) comes to (y, −x)."""
        lens = self
        for _ in range(quarters % 4):
            lens = lens._turned_quarter()
        return lens

    def _turned_quarter(self) -> "Lens":
        if self.is_round:
            return self
        # Here, for that lens is one itself.
        from jaxlens.lenses._turned import Turned

        return Turned(self, 1)

    @jitted
    def unproject(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 3"]:
        """Maps observed points `(..., 2)` to unit rays `(..., 3)`, exactly; NaN where there is none."""
        found = self.preimages(points)
        valid = found[..., 0] == found[..., 0]
        return masked(_unit_ray(*split(jnp.where(valid[..., None], found, 0))), valid)

    @jitted
    def invert_projection(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the rays of observed points: as `unproject`, with the reason where there is none.

        Args:
            points: `(..., 2)` observed points.

        Returns:
            An `Inverse` whose points are unit rays `(..., 3)`, finite everywhere; the rest is as in `invert`.
        """
        found = self.invert(points)
        return Inverse(_unit_ray(*split(found.points)), found.valid, found.status)

    def field_of_view(self) -> Float[Array, ""]:
        """Returns the angle from the axis, in radians, up to which the lens is one-to-one in every direction."""
        return jnp.arctan(self.nearest_fold())

    @jitted
    def nearest_fold(self) -> Float[Array, ""]:
        """Returns the ideal radius about the origin of the nearest point where the lens folds; ∞ if it never does."""
        fixed = lax.stop_gradient(self)
        parameters = jax.tree.leaves(eqx.filter(self, eqx.is_inexact_array))
        dtype = jnp.result_type(*parameters) if parameters else jnp.result_type(float)
        return jnp.min(find_region(fixed.distort, jnp.zeros(2, dtype), fixed.pole_radius()).edges)

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the ideal points of observed ones, in the region about the origin where the lens is one-to-one.

        The region is star-shaped: on each ray from the origin it ends where the Jacobian determinant first vanishes.
        Newton's iteration, which does not leave it; the lens should be near the identity at the origin.

        Args:
            points: `(..., 2)` observed points.

        Returns:
            An `Inverse`, exact to the dtype's rounding. A point beyond the image of the region gets a point of its
            edge; one that is not finite gets the origin. Derivatives of every order with respect to points and
            parameters follow from the implicit function theorem; in masked places they are finite.
        """
        lens, target, root, status = self._solved(points)
        x, y = split(target)
        center = jnp.zeros(2, x.dtype)
        fixed = lax.stop_gradient(lens)
        region = find_region(fixed.distort, center, fixed.pole_radius())
        image = lens.distort(center)
        lost = region.beyond(x - image[0], y - image[1])
        root = jnp.where(lost[..., None], region.edge(x - image[0], y - image[1]), root)
        solution = implicit_point_root(_point_residual, root, (lens, target))
        converged = status == InverseStatus.CONVERGED
        return Inverse(jnp.where(converged[..., None], solution, lax.stop_gradient(root)), converged, status)

    @jitted
    def preimages(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Returns the points of `invert`, NaN where they are not valid."""
        lens, target, root, status = self._solved(points)
        root = implicit_point_root(_point_residual, root, (lens, target))
        return masked(root, status == InverseStatus.CONVERGED)

    def _solved(self, points: ArrayLike) -> tuple["Lens", Array, Array, Array]:
        """Returns the lens and finite observed points in one dtype, ideal points without derivatives, the status."""
        # At least in single precision: complex numbers, which the solver packs points into, have no half.
        points = as_points(points)
        points = points.astype(jnp.promote_types(points.dtype, jnp.float32))
        lens, (x, y) = _in_common_dtype(self, split(points))
        finite = squared_length(x, y) < jnp.inf
        x, y = jnp.where(finite, x, 0), jnp.where(finite, y, 0)
        *root, status = solve(*lax.stop_gradient((lens, x, y)))
        return lens, join(x, y), join(*root), jnp.where(finite, status, jnp.int8(InverseStatus.NOT_FINITE))


class RadialLens(Lens):
    """A lens that moves points along rays: `x_d = c + (x_u − c) Φ(|x_u − c|²)`.

    Attributes:
        center: The centre of distortion c, in normalized coordinates.
    """

    center: Float[Array, "2"]

    @abc.abstractmethod
    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ, the ratio of observed to ideal radius, at squared ideal radii."""

    @abc.abstractmethod
    def fold_radius(self) -> Float[Array, ""]:
        """Returns the ideal radius about the centre of distortion where the lens stops being one-to-one; ∞ if never."""

    @jitted
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones, beyond the fold radius too."""
        x, y = self.offset(points)
        return self.scaled(x, y, self.factor(x * x + y * y))

    def nearest_fold(self) -> Float[Array, ""]:
        """Returns the ideal radius about the origin of the nearest point of the fold; ∞ if there is none."""
        return jnp.maximum(self.fold_radius() - jnp.sqrt(squared_length(*self.center)), 0)

    def surely_one_to_one(self, points: Float[Array, "*batch 2"]) -> None:
        """Returns None: to compare each point's radius with the fold's is as quick."""
        return None

    @jitted
    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether ideal points lie within the fold radius."""
        x, y = self.offset(points)
        return x * x + y * y <= self.fold_radius() ** 2

    def adjustable(self) -> PyTree:
        """Returns all but the centre of distortion, which trades against the picture's own centre."""
        return eqx.tree_at(lambda lens: lens.center, super().adjustable(), False)

    def offset(self, points: Float[ArrayLike, "*batch 2"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Returns the x and y of points from the centre of distortion."""
        x, y = split(as_points(points))
        return x - self.center[0], y - self.center[1]

    def scaled(
        self, x: Float[Array, "*batch"], y: Float[Array, "*batch"], factor: Float[Array, "*batch"]
    ) -> Float[Array, "*batch 2"]:
        """Returns the points at offsets (x, y) times `factor` from the centre of distortion."""
        return join(self.center[0] + x * factor, self.center[1] + y * factor)

    def _turned_quarter(self) -> "RadialLens":
        x, y = self.center
        return eqx.tree_at(lambda lens: lens.center, self, join(y, -x))

    def edge_radius(self) -> Float[Array, ""]:
        """Returns the observed radius of the fold, beyond which nothing is seen; ∞ if there is none."""
        fold = self.fold_radius()
        folds = jnp.isfinite(fold)
        return jnp.where(folds, self.radius(jnp.where(folds, fold, 0)), jnp.inf)

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the ideal points of observed ones: solves ρ Φ(ρ²) = r for each, within the fold radius.

        Args:
            points: `(..., 2)` observed points.

        Returns:
            An `Inverse`, exact to the dtype's rounding. A point beyond the fold's observed radius gets the point of
            the fold on its own ray; one that is not finite gets the centre of distortion. Derivatives of every
            order with respect to points and parameters follow from the implicit function theorem, finite at the
            centre and in masked places (at the fold itself the true derivative is infinite).
        """
        x, y = self.offset(points)
        scale, status = self.ideal_scale(squared_length(x, y))
        finite = status != InverseStatus.NOT_FINITE
        points = self.scaled(jnp.where(finite, x, 0), jnp.where(finite, y, 0), scale)
        return Inverse(points, status == InverseStatus.CONVERGED, status)

    @jitted
    def preimages(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Returns the points of `invert`, NaN where they are not valid."""
        x, y = self.offset(points)
        scale, status = self.ideal_scale(squared_length(x, y))
        # The mask travels as NaN in the one scale: computing it again for both coordinates would cost more than all
        # the rest. Where it is NaN the product is formed with zero, for the sake of its derivative.
        scale = jnp.where(status == InverseStatus.CONVERGED, scale, jnp.nan)
        valid = scale == scale
        x, y = split(self.scaled(x, y, jnp.where(valid, scale, 0)))
        return join(jnp.where(valid, x, jnp.nan), jnp.where(valid, y, jnp.nan))

    def radius_and_slope(self, radius: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Returns the observed radius of ideal radii, ρ Φ(ρ²), and its derivative."""
        return jax.jvp(self.radius, (radius,), (jnp.ones_like(radius),))

    def radius(self, radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns the observed radius of ideal radii, ρ Φ(ρ²)."""
        return radius * self.factor(radius * radius)

    def ideal_scale(self, squared: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Int8[Array, "*batch"]]:
        """Returns the ratio of ideal to observed radius at squared observed radii, and the `InverseStatus`."""
        finite = squared <= jnp.finfo(squared.dtype).max
        lens, squared = _in_common_dtype(self, jnp.where(finite, squared, 0))
        fold, edge = lens.fold_radius(), lens.edge_radius()
        inside = squared <= lax.stop_gradient(edge) ** 2
        found = _solve(*lax.stop_gradient((lens, squared, fold, edge)))
        # In squared radii, q Φ(q)² = s, nothing is singular at the centre.
        solution = implicit_root(_squared_residual, found * found, (lens, squared))
        converged = is_root(_squared_residual(solution, (lens, squared)) + squared, squared, solution)
        # A point beyond the edge goes to the fold on its own ray.
        scale = jnp.where(inside, 1, fold) / jnp.where(
            inside, lens.factor(jnp.where(inside, solution, 0)), jnp.sqrt(jnp.where(inside, 1, squared))
        )
        return scale, inverse_status(finite, inside, converged)


def _in_common_dtype(lens: Lens, arrays: Any) -> tuple[Any, Any]:
    """Brings a lens and arrays to one dtype: a fold found in a coarser one would not fit the points."""
    parameters, rest = eqx.partition(lens, eqx.is_inexact_array)
    dtype = jnp.result_type(*jax.tree.leaves((parameters, arrays)))
    parameters, arrays = jax.tree.map(lambda leaf: leaf.astype(dtype), (parameters, arrays))
    return eqx.combine(parameters, rest), arrays


def as_center(center: ArrayLike | list | tuple | None, dtype: jnp.dtype) -> Float[Array, "2"]:
    """Returns a centre of distortion: the origin for None; plain numbers take `dtype`, arrays keep their own.

    Raises:
        ValueError: the centre is not one point.
    """
    if center is None:
        return jnp.asarray(np.zeros(2, dtype))
    array = as_floating(center)
    if array.shape != (2,):
        raise ValueError(f"a centre of distortion has shape (2,), (x, y), got {array.shape}")
    return array if hasattr(center, "dtype") else array.astype(dtype)


@in_turns
def _solve(
    lens: RadialLens, squared: Float[Array, "*batch"], fold: Float[Array, ""], edge: Float[Array, ""]
) -> Float[Array, "*batch"]:
    """Solves ρ Φ(ρ²) = √s, without derivatives, for s up to the edge; the rest get the fold."""
    radii = jnp.sqrt(jnp.minimum(squared, edge * edge))
    ratio = first_guess(lens.radius, fold, edge, radii)
    return solve_increasing(lens.radius_and_slope, radii, lambda radii: radii * ratio(radii), fold)


@jax.custom_jvp
def squared_length(x: Array, y: Array) -> Array:
    """Returns `x² + y²`, or ∞ where that is not finite."""
    squared = x * x + y * y
    # A comparison, because XLA would rather write a plane to memory than compute `isfinite` twice.
    return jnp.where(squared <= jnp.finfo(squared.dtype).max, squared, jnp.inf)


@squared_length.defjvp
def _squared_length_jvp(primals, tangents):
    x, y = primals
    squared = squared_length(x, y)
    finite = squared < jnp.inf
    x, y = jnp.where(finite, x, 0), jnp.where(finite, y, 0)
    return squared, 2 * (x * tangents[0] + y * tangents[1])


def on_the_plane(rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
    """Returns the points (x, y) / z of rays, and which of them lie ahead; those that do not are at the origin."""
    x, y, z = split(rays)
    ahead = z > 0
    depth = jnp.where(ahead, z, 1)
    x, y = x / depth, y / depth
    ahead &= squared_length(x, y) < jnp.inf
    return join(jnp.where(ahead, x, 0), jnp.where(ahead, y, 0)), ahead


def _unit_ray(x: Array, y: Array) -> Float[Array, "*batch 3"]:
    """Returns the direction of ideal points."""
    z = lax.rsqrt(1 + x * x + y * y)
    return join(x * z, y * z, z)


def _squared_residual(squared_ideal: Array, parameters: tuple[RadialLens, Array]) -> Array:
    lens, squared = parameters
    factor = lens.factor(squared_ideal)
    return squared_ideal * factor * factor - squared


def _point_residual(ideal: Array, parameters: tuple[Lens, Array]) -> Array:
    lens, observed = parameters
    return lens.distort(ideal) - observed
