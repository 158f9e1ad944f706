"""Lenses that are written on rays: closed projections, and those whose plane another lens distorts."""

import abc

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.lenses._lens import Lens
from jaxlens.maps import Inverse, InverseStatus, inverse_status
from jaxlens.numerics import as_points, epsilon, jitted, join, masked, split

Plane = Float[Array, "*batch"]


class WideLens(Lens):
    """A lens that is written on rays, and may see past a right angle from its axis.

    On the plane z = 1 (`distort`, `undistort`, `invert`) it is the same lens, as far as a plane reaches.
    """

    @abc.abstractmethod
    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, finite everywhere, and which of the rays the lens sees."""

    @property
    def needs_frame(self) -> bool:
        """True: the coordinates are those of a camera."""
        return True

    def unproject(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 3"]:
        """Maps observed points `(..., 2)` to unit rays `(..., 3)`, exactly; NaN where there is none."""
        return self.invert_projection(points).masked()

    @abc.abstractmethod
    def invert_projection(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the unit rays of observed points (see `Lens.invert_projection`)."""

    @abc.abstractmethod
    def field_of_view(self) -> Float[Array, ""]:
        """Returns the angle from the axis, in radians, up to which the lens is one-to-one in every direction."""

    @jitted
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` of the plane z = 1 to observed ones, beyond a fold too."""
        return self.observe(_on_the_plane(points))[0]

    @jitted
    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether the lens sees ideal points of the plane z = 1."""
        return self.observe(_on_the_plane(points))[1]

    def nearest_fold(self) -> Float[Array, ""]:
        """Returns the radius on the plane z = 1 of the nearest fold, ∞ if that lies past the plane."""
        angle = self.field_of_view()
        ahead = angle < jnp.pi / 2
        return jnp.where(ahead, jnp.tan(jnp.where(ahead, angle, 0)), jnp.inf)

    def surely_one_to_one(self, points: Float[Array, "*batch 2"]) -> Bool[Array, "*batch"] | None:
        """Tells whether ideal points lie nearer to the axis than the nearest fold."""
        x, y = split(points)
        return x * x + y * y <= lax.stop_gradient(self.nearest_fold()) ** 2

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the ideal points of observed ones on the plane z = 1; a ray with z ≤ 0 has none."""
        found = self.invert_projection(points)
        x, y, z = jnp.moveaxis(found.points, -1, 0)
        # So near to the plane's horizon that the point is lost in rounding.
        ahead = z > epsilon(z.dtype)
        missed = (found.status == InverseStatus.CONVERGED) & ~ahead
        status = jnp.where(missed, jnp.int8(InverseStatus.NO_PREIMAGE), found.status)
        depth = jnp.where(ahead, z, epsilon(z.dtype))
        return Inverse(join(x / depth, y / depth), found.valid & ahead, status)

    def preimages(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Returns the points of `invert`, NaN where they are not valid."""
        return self.invert(points).masked()


class Projection(WideLens):
    """A wide lens in closed form, both ways."""

    @abc.abstractmethod
    def raised(self, points: Float[Array, "*batch 2"]) -> tuple[Float[Array, "*batch 3"], Bool[Array, "*batch"]]:
        """Returns the unit rays of finite observed points, finite everywhere, and which of the points are of a ray."""

    @jitted
    def invert_projection(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the unit rays of observed points, in closed form (see `Lens.invert_projection`)."""
        points = as_points(points)
        # Squares must not overflow.
        limit = jnp.sqrt(jnp.finfo(points.dtype).max) / 8
        finite = jnp.all(jnp.abs(points) < limit, axis=-1)
        rays, reached = self.raised(jnp.where(finite[..., None], points, 0))
        status = inverse_status(finite, reached, jnp.ones_like(finite))
        return Inverse(rays, status == InverseStatus.CONVERGED, status)


class DistortedProjection(WideLens):
    """A projection in closed form, the plane of which a lens distorts."""

    @property
    @abc.abstractmethod
    def projection(self) -> Projection:
        """The projection from rays to its plane."""

    @property
    @abc.abstractmethod
    def plane(self) -> Lens:
        """The lens from that plane to observed points, written as from the plane z = 1."""

    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, and which of the rays the lens sees."""
        points, seen = self.projection.observe(rays)
        seen &= self.plane.one_to_one(points)
        return self.plane.distort(points), seen

    @jitted
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` of the plane z = 1 to observed ones, beyond a fold too."""
        return self.plane.distort(self.projection.distort(points))

    @jitted
    def invert_projection(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the unit rays of observed points: the inverse of the plane's lens, then of the projection."""
        found = self.plane.invert(points)
        rays, reached = self.projection.raised(found.points)
        missed = (found.status == InverseStatus.CONVERGED) & ~reached
        status = jnp.where(missed, jnp.int8(InverseStatus.NO_PREIMAGE), found.status)
        return Inverse(rays, found.valid & reached, status)

    @jitted
    def unproject(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 3"]:
        """Maps observed points `(..., 2)` to unit rays `(..., 3)`, exactly; NaN where there is none."""
        found = self.plane.preimages(points)
        valid = found[..., 0] == found[..., 0]
        rays, reached = self.projection.raised(jnp.where(valid[..., None], found, 0))
        return masked(rays, valid & reached)

    def field_of_view(self) -> Float[Array, ""]:
        """Returns the angle of the nearest fold of the plane's lens, at most the projection's own field."""
        fold, field = self.plane.nearest_fold(), self.projection.field_of_view()
        folds = jnp.isfinite(fold)
        ray, reached = self.projection.raised(join(jnp.where(folds, fold, 0), jnp.zeros_like(fold)))
        angle = jnp.arctan2(jnp.hypot(ray[..., 0], ray[..., 1]), ray[..., 2])
        return jnp.where(folds & reached, jnp.minimum(angle, field), field)


def _on_the_plane(points: ArrayLike) -> Float[Array, "*batch 3"]:
    x, y = split(as_points(points))
    return join(x, y, jnp.ones_like(x))


def unit(rays: Float[Array, "*batch 3"]) -> tuple[Plane, Plane, Plane, Bool[Array, "*batch"]]:
    """Returns the x, y and z of rays made to have length one, and which had a length; the rest point forward."""
    x, y, z = jnp.moveaxis(rays, -1, 0)
    # The largest coordinate first, so that no square overflows or vanishes. What depends on a direction alone does not
    # change with the length, so the factor may count as a constant.
    size = lax.stop_gradient(jnp.maximum(jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.abs(z)))
    some = size > 0
    inverse = 1 / jnp.where(some, size, 1)
    x, y, z = x * inverse, y * inverse, jnp.where(some, z * inverse, 1)
    scale = lax.rsqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale, some
