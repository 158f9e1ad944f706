"""The projections that have no parameter, in closed form: where a ray falls at unit focal length."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

from jaxlens.lenses._angles import angle_over_radius, sine_and_cosine
from jaxlens.lenses._lens import on_the_plane
from jaxlens.lenses._registry import register
from jaxlens.lenses._wide_lens import Plane, Projection, unit
from jaxlens.numerics import join, split

_Observed = tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]
_Raised = tuple[Float[Array, "*batch 3"], Bool[Array, "*batch"]]


class _Plain(Projection):
    """A projection without parameters."""

    term_counts: ClassVar[tuple[int, ...]] = ()
    is_round: ClassVar[bool] = True
    largest_angle: ClassVar[float] = np.pi

    @classmethod
    def identity(cls, *, terms: int | None = None):
        """Returns the projection: there is nothing to fit in it."""
        if terms is not None:
            cls.count_terms(terms)
        return cls()

    def field_of_view(self) -> Float[Array, ""]:
        """Returns the largest angle from the axis, in radians, up to which it is one-to-one."""
        return jnp.asarray(self.largest_angle)


@register("Perspective", short="perspective")
class Perspective(_Plain):
    """`x_d = (x, y) / z`: the pinhole, r = tan θ; sees z > 0. On the plane it is the identity."""

    largest_angle: ClassVar[float] = np.pi / 2

    def observe(self, rays: Float[Array, "*batch 3"]) -> _Observed:
        """Returns the observed points of finite rays, and which of them lie ahead."""
        return on_the_plane(rays)

    def raised(self, points: Float[Array, "*batch 2"]) -> _Raised:
        """Returns the unit rays of observed points."""
        x, y = split(points)
        z = lax.rsqrt(1 + x * x + y * y)
        return join(x * z, y * z, z), jnp.ones(x.shape, bool)


@register("Equidistant", short="equidistant")
class Equidistant(_Plain):
    """`x_d = (x, y) θ / sin θ` of unit rays: r = θ, the angle from the axis; sees all but the antipode.

    The f-theta lens; COLMAP's SIMPLE_FISHEYE, OpenCV's `fisheye` with coefficients zero.
    """

    def observe(self, rays: Float[Array, "*batch 3"]) -> _Observed:
        """Returns the observed points of finite rays; the antipode and the zero ray are not seen."""
        x, y, z, some = unit(rays)
        squared = x * x + y * y
        scale = angle_over_radius(squared, z)
        return join(x * scale, y * scale), some & ((z > 0) | (squared > 0))

    def raised(self, points: Float[Array, "*batch 2"]) -> _Raised:
        """Returns the unit rays of observed points; those with r < π are of one."""
        x, y = split(points)
        squared = x * x + y * y
        sine, cosine = sine_and_cosine(squared)
        return join(x * sine, y * sine, cosine), squared < np.pi**2


@register("Equisolid", short="equisolid")
class Equisolid(_Plain):
    """`x_d = (x, y) √(2 / (1 + z))` of unit rays: r = 2 sin(θ/2), equal areas; sees all but the antipode."""

    def observe(self, rays: Float[Array, "*batch 3"]) -> _Observed:
        """Returns the observed points of finite rays; the antipode and the zero ray are not seen."""
        x, y, z, some = unit(rays)
        ahead = some & (z > -1)
        scale = jnp.sqrt(2 / jnp.where(ahead, 1 + z, 1))
        return join(x * scale, y * scale), ahead

    def raised(self, points: Float[Array, "*batch 2"]) -> _Raised:
        """Returns the unit rays of observed points; those with r < 2 are of one."""
        x, y = split(points)
        squared = x * x + y * y
        reached = squared < 4
        squared = jnp.where(reached, squared, 0)
        scale = jnp.sqrt(1 - squared / 4)
        return join(jnp.where(reached, x * scale, 0), jnp.where(reached, y * scale, 0), 1 - squared / 2), reached


@register("Stereographic", short="stereographic")
class Stereographic(_Plain):
    """`x_d = 2 (x, y) / (1 + z)` of unit rays: r = 2 tan(θ/2), angles kept; sees all but the antipode."""

    def observe(self, rays: Float[Array, "*batch 3"]) -> _Observed:
        """Returns the observed points of finite rays; the antipode and the zero ray are not seen."""
        x, y, z, some = unit(rays)
        ahead = some & (z > -1)
        scale = 2 / jnp.where(ahead, 1 + z, 1)
        return join(x * scale, y * scale), ahead

    def raised(self, points: Float[Array, "*batch 2"]) -> _Raised:
        """Returns the unit rays of observed points."""
        x, y = split(points)
        quarter = (x * x + y * y) / 4
        scale = 1 / (1 + quarter)
        return join(x * scale, y * scale, (1 - quarter) * scale), jnp.ones(x.shape, bool)


@register("Orthographic", short="orthographic")
class Orthographic(_Plain):
    """`x_d = (x, y)` of unit rays: r = sin θ; sees z > 0. Derivatives of its inverse grow without bound at r = 1."""

    largest_angle: ClassVar[float] = np.pi / 2

    def observe(self, rays: Float[Array, "*batch 3"]) -> _Observed:
        """Returns the observed points of finite rays, and which of them lie ahead."""
        x, y, z, some = unit(rays)
        return join(x, y), some & (z > 0)

    def raised(self, points: Float[Array, "*batch 2"]) -> _Raised:
        """Returns the unit rays of observed points; those with r < 1 are of one."""
        x, y = split(points)
        squared = x * x + y * y
        reached = squared < 1
        scale = jnp.where(reached, 1, lax.rsqrt(jnp.where(reached, 1, squared)))
        return join(x * scale, y * scale, jnp.sqrt(jnp.where(reached, 1 - squared, 0))), reached


@register("Equirectangular", short="equirectangular")
class Equirectangular(_Plain):
    """`x_d = (longitude, latitude)`: x = atan2(X, Z), y = atan2(Y, √(X² + Z²)), in radians.

    Sees all but straight up and straight down. Its picture of 2π by π is the usual panorama of a whole sphere.
    """

    is_round: ClassVar[bool] = False

    def observe(self, rays: Float[Array, "*batch 3"]) -> _Observed:
        """Returns the observed points of finite rays; the poles, which have no longitude, are not seen."""
        x, y, z, distance, beside = _about_the_vertical(rays)
        return join(jnp.arctan2(x, z), jnp.arctan2(y, distance)), beside

    def raised(self, points: Float[Array, "*batch 2"]) -> _Raised:
        """Returns the unit rays of observed points; those with |x| ≤ π and |y| < π/2 are of one."""
        x, y = split(points)
        across = jnp.cos(y)
        reached = (jnp.abs(x) <= np.pi) & (jnp.abs(y) < np.pi / 2)
        return join(jnp.sin(x) * across, jnp.sin(y), jnp.cos(x) * across), reached


@register("Cylindrical", short="cylindrical")
class Cylindrical(_Plain):
    """`x_d = (atan2(X, Z), Y / √(X² + Z²))`: an upright cylinder unrolled.

    Verticals stay straight; it sees all but straight up and straight down.
    """

    is_round: ClassVar[bool] = False

    def observe(self, rays: Float[Array, "*batch 3"]) -> _Observed:
        """Returns the observed points of finite rays; those straight up or down are not seen."""
        x, y, z, distance, beside = _about_the_vertical(rays)
        return join(jnp.arctan2(x, z), y / distance), beside

    def raised(self, points: Float[Array, "*batch 2"]) -> _Raised:
        """Returns the unit rays of observed points; those with |x| ≤ π are of one."""
        x, y = split(points)
        scale = lax.rsqrt(1 + y * y)
        return join(jnp.sin(x) * scale, y * scale, jnp.cos(x) * scale), jnp.abs(x) <= np.pi


def _about_the_vertical(rays: Float[Array, "*batch 3"]) -> tuple[Plane, Plane, Plane, Plane, Bool[Array, "*batch"]]:
    """Returns unit rays, their distance from the vertical, and whether they have any; one that has not looks ahead."""
    x, y, z, some = unit(rays)
    squared = x * x + z * z
    beside = some & (squared > 0)
    z = jnp.where(beside, z, 1)
    return x, y, z, jnp.sqrt(jnp.where(beside, squared, 1)), beside
