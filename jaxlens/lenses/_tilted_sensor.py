"""The sensor that does not stand square to the optical axis: a homography, in closed form both ways."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.maps import CoordinateMap, Inverse, InverseStatus, inverse_status
from jaxlens.numerics import as_points, jitted, join, split

# Where a point that nothing is seen at stands in for one at infinity: this share of the way from the horizon.
_HORIZON = 1e-3


class TiltedSensor(CoordinateMap):
    """Projects points of the plane z = 1, through the lens's centre, to a sensor that is turned by R = Ry(τy) Rx(τx).

    From the sensor a point is seen at (X, Y, Z) = R (x, y, 1), and so on it at (R33 X / Z − R13, R33 Y / Z − R23):
    OpenCV's tilted sensor (Louhichi et al. 2007). As R is orthogonal that is

        (x cos τx, y cos τy − x sin τx sin τy) / Z  with  Z = cos τx cos τy + x sin τy − y sin τx cos τy

    and its inverse, of points (u, v),

        (u cos τy, v cos τx + u sin τx sin τy) / (1 − u cos τx sin τy + v sin τx).

    It sees the points with Z > 0; those beyond that line are behind it.

    Attributes:
        angles: τx and τy, radians.
    """

    angles: Float[Array, "2"]

    @jitted
    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps points `(..., 2)`, those behind the sensor too."""
        x, y = split(as_points(points))
        (cos_x, cos_y), (sin_x, sin_y) = jnp.cos(self.angles), jnp.sin(self.angles)
        inverse = 1 / self._depth(x, y)
        return join(x * cos_x * inverse, (y * cos_y - x * (sin_x * sin_y)) * inverse)

    @jitted
    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether points lie before the sensor, on the side of the origin."""
        return (self._depth(*split(as_points(points))) > 0) & self._faces_the_lens()

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the preimages of points, in closed form.

        Args:
            points: `(..., 2)`.

        Returns:
            An `Inverse`. A point of the sensor beyond its horizon, which no point is seen at, gets a distant one.
        """
        points = as_points(points)
        # At least in single precision, as the lens before it.
        x, y = split(points.astype(jnp.promote_types(points.dtype, jnp.float32)))
        finite = x * x + y * y <= jnp.finfo(x.dtype).max
        x, y = jnp.where(finite, x, 0), jnp.where(finite, y, 0)
        (cos_x, cos_y), (sin_x, sin_y) = jnp.cos(self.angles), jnp.sin(self.angles)
        share = 1 - x * (cos_x * sin_y) + y * sin_x
        seen = (share > 0) & self._faces_the_lens()
        inverse = 1 / jnp.where(seen, share, _HORIZON)
        status = inverse_status(finite, seen, seen)
        preimages = join(x * cos_y * inverse, (y * cos_x + x * (sin_x * sin_y)) * inverse)
        return Inverse(preimages, status == InverseStatus.CONVERGED, status)

    def _depth(self, x: Float[Array, "*batch"], y: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        (cos_x, cos_y), (sin_x, sin_y) = jnp.cos(self.angles), jnp.sin(self.angles)
        return cos_x * cos_y + x * sin_y - y * (sin_x * cos_y)

    def _faces_the_lens(self) -> Bool[Array, ""]:
        return jnp.prod(jnp.cos(self.angles)) > 0
