"""What every lens can do, and what every radial lens can."""

import abc

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.maps import CoordinateMap, Inverse, InverseStatus, inverse_status
from jaxlens.newton import derivatives, implicit_root, solve_increasing
from jaxlens.numerics import as_points, join, split


class Lens(CoordinateMap):
    """A coordinate map that takes ideal points to observed ones, both normalized."""

    @abc.abstractmethod
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones."""

    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Is `distort`."""
        return self.distort(points)

    def undistort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps observed points `(..., 2)` to ideal ones, exactly; NaN where there is none (see `invert`)."""
        return self.invert(points).masked()


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
        """Returns the ideal radius, from the centre of distortion, at which the lens stops being one-to-one; ∞ if never."""

    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones, beyond the fold radius too."""
        x, y = self.offset(points)
        return self.scaled(x, y, self.factor(x * x + y * y))

    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Whether ideal points lie within the fold radius."""
        x, y = self.offset(points)
        return x * x + y * y <= self.fold_radius() ** 2

    def offset(self, points: Float[ArrayLike, "*batch 2"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Returns the x and y of points from the centre of distortion."""
        x, y = split(as_points(points))
        return x - self.center[0], y - self.center[1]

    def finite_offset(
        self, points: Float[ArrayLike, "*batch 2"]
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"], Bool[Array, "*batch"]]:
        """Is `offset` with zero in place of what is not finite (or whose square is not), and where that was."""
        x, y = self.offset(points)
        finite = jnp.isfinite(x * x + y * y)
        return jnp.where(finite, x, 0), jnp.where(finite, y, 0), finite

    def scaled(
        self, x: Float[Array, "*batch"], y: Float[Array, "*batch"], factor: Float[Array, "*batch"]
    ) -> Float[Array, "*batch 2"]:
        """Returns the points at offsets (x, y) times `factor` from the centre of distortion."""
        return join(self.center[0] + x * factor, self.center[1] + y * factor)

    def edge_radius(self) -> Float[Array, ""]:
        """Returns the observed radius of the fold: no point further from the centre of distortion is seen; ∞ if none."""
        fold = self.fold_radius()
        folds = jnp.isfinite(fold)
        return jnp.where(folds, self._radius(jnp.where(folds, fold, 0)), jnp.inf)

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
        x, y, finite = self.finite_offset(points)
        squared = x * x + y * y
        fold, edge = self.fold_radius(), self.edge_radius()
        radius = jnp.sqrt(lax.stop_gradient(squared))
        inside = radius <= lax.stop_gradient(edge)

        ideal, converged = lax.stop_gradient(self)._solve(radius, fold, edge)
        # In squared radii, q Φ(q)² = s, nothing is singular at the centre.
        solution = implicit_root(_squared_residual, ideal * ideal, (self, squared))
        clamped = fold / jnp.sqrt(jnp.where(inside, 1, squared))
        scale = jnp.where(inside, 1 / self.factor(jnp.where(inside, solution, 0)), clamped)
        status = inverse_status(finite, inside, converged)
        return Inverse(self.scaled(x, y, scale), status == InverseStatus.CONVERGED, status)

    def _radius(self, radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """The observed radius of ideal radii: ρ Φ(ρ²)."""
        return radius * self.factor(radius * radius)

    def _solve(
        self, radius: Float[Array, "*batch"], fold: Float[Array, ""], edge: Float[Array, ""]
    ) -> tuple[Float[Array, "*batch"], Bool[Array, "*batch"]]:
        """Solves ρ Φ(ρ²) = r, without derivatives, for radii up to the edge; the rest get the fold."""
        folds = jnp.isfinite(fold)
        fold_safe, edge_safe = jnp.where(folds, fold, 1), jnp.where(folds, edge, 1)
        target = jnp.minimum(radius, edge)
        # Near the fold r ≈ edge − C (fold − ρ)²: a cubic in √(1 − r / edge) that agrees with the solution to first
        # order at both ends lets Newton start within its fast region up to the fold itself.
        curvature = -0.5 * derivatives(self._radius, fold_safe)[2]
        bend = jnp.sqrt(edge_safe / jnp.maximum(curvature, 0.25 * edge_safe / fold_safe**2)) / fold_safe
        slope = 3 - 2 * bend - 2 * edge_safe / fold_safe
        root = jnp.sqrt(jnp.maximum(1 - target / edge_safe, 0))
        start = fold_safe * (1 - root * (bend + root * (slope + root * (1 - bend - slope))))
        start = jnp.where(folds, jnp.clip(start, 0, fold_safe), target)
        return solve_increasing(self._radius, target, start, jnp.zeros_like(fold), fold)


def _squared_residual(squared_ideal: Array, parameters: tuple[RadialLens, Array]) -> Array:
    lens, squared = parameters
    factor = lens.factor(squared_ideal)
    return squared_ideal * factor * factor - squared
