"""Wide lenses whose observed radius is a function of the angle from the axis."""

import abc

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.lenses._angles import angle_over_radius, sine_and_cosine
from jaxlens.lenses._lens import RadialLens, squared_length
from jaxlens.lenses._projections import Equidistant
from jaxlens.lenses._wide_lens import DistortedProjection, Plane, scaled
from jaxlens.maps import InverseStatus
from jaxlens.numerics import as_points, jitted, join, split


class AngularLens(DistortedProjection):
    """A radial lens of the angle from the axis in place of a radius: `r_d = θ Φ(θ²)`.

    It is what `DistortedProjection` makes of the two, computed as one factor a point.
    """

    @property
    def projection(self) -> Equidistant:
        """Equidistant."""
        return Equidistant()

    @property
    @abc.abstractmethod
    def plane(self) -> RadialLens:
        """The lens that takes θ to r_d, its centre the origin."""

    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, and which of the rays the lens sees."""
        x, y, z, some = scaled(rays)
        points, seen = self._observe(x, y, z)
        return points, some & seen

    @jitted
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` of the plane z = 1 to observed ones, beyond a fold too."""
        x, y = split(as_points(points))
        return self._observe(x, y, jnp.ones_like(x))[0]

    @jitted
    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether the lens sees ideal points of the plane z = 1."""
        x, y = split(as_points(points))
        return self._observe(x, y, jnp.ones_like(x))[1]

    @jitted
    def unproject(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 3"]:
        """Maps observed points `(..., 2)` to unit rays `(..., 3)`, exactly; NaN where there is none."""
        x, y = split(as_points(points))
        squared = squared_length(x, y)
        scale, status = self.plane.ideal_scale(squared)
        # The mask travels as NaN in the one scale, see `RadialLens.preimages`.
        valid = (status == InverseStatus.CONVERGED) & (scale * scale * squared < np.pi**2)
        scale = jnp.where(valid, scale, jnp.nan)
        valid = scale == scale
        scale, squared = jnp.where(valid, scale, 0), jnp.where(valid, squared, 0)
        sine, cosine = sine_and_cosine(scale * scale * squared)
        scale = scale * sine
        return join(*(jnp.where(valid, plane, jnp.nan) for plane in (x * scale, y * scale, cosine)))

    def _observe(self, x: Plane, y: Plane, z: Plane) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        squared = x * x + y * y
        ratio = angle_over_radius(squared, z)
        squared_angle = squared * ratio * ratio
        plane = self.plane
        scale = ratio * plane.factor(squared_angle)
        seen = (squared_angle <= lax.stop_gradient(plane.fold_radius()) ** 2) & ((z > 0) | (squared > 0))
        return join(x * scale, y * scale), seen
