"""The field-of-view lens of Devernay and Faugeras: one number, both directions in closed form."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int8

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._registry import register
from jaxlens.maps import inverse_status
from jaxlens.numerics import as_parameter, epsilon, polynomial

# Below this square of the angle the series of tan z / z and arctan z / z take over, to all digits.
_SMALL = 0.05
_TERMS = 14


@register("FieldOfView", short="fov")
class FieldOfView(RadialLens):
    """`r_d = arctan(2 r_u tan(ω / 2)) / ω` (Devernay and Faugeras 2001; COLMAP's FOV).

    The picture of an ideal equidistant fisheye whose field of view is ω. It is always barrel; the sign of ω means
    nothing, and ω = 0 is the identity. All ideal points are seen, within the observed radius π / (2 |ω|).

    Attributes:
        omega: ω, in radians, of size less than π.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> [round(float(x), 4) for x in jl.FieldOfView(1.0).undistort(np.array([0.5, 0.0]))]
        [0.5, 0.0]
    """

    omega: Float[Array, ""]
    term_counts: ClassVar[tuple[int, ...]] = (1,)

    def __init__(self, omega: ArrayLike, *, center: ArrayLike | list | tuple | None = None):
        self.omega = as_parameter(omega, "omega")
        self.center = as_center(center, self.omega.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "FieldOfView":
        """Returns the lens with ω = 0.1, which moves a point at radius one by 0.3 %: zero is a start no fit can leave.

        There the derivative by ω vanishes, because ω and −ω are the same lens.
        """
        cls.count_terms(terms)
        return cls(0.1)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ = arctan(2 r tan(ω / 2)) / (ω r), smooth in r² and ω²."""
        stretch = self._stretch()
        return stretch * _arctangent_ratio((self.omega * stretch) ** 2 * squared_radius)

    def fold_radius(self) -> Float[Array, ""]:
        """Returns ∞: it never folds; for an ω that is no field of view, of π or more, zero."""
        return jnp.where(jnp.abs(self.omega) < jnp.pi, jnp.asarray(jnp.inf, self.omega.dtype), 0)

    def edge_radius(self) -> Float[Array, ""]:
        """Returns π / (2 |ω|), where points at infinity are seen; ∞ for ω = 0."""
        size = jnp.abs(self.omega)
        bounded = size > 0
        return jnp.where(bounded, 0.5 * jnp.pi / jnp.where(bounded, size, 1), jnp.inf)

    def ideal_scale(self, squared: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Int8[Array, "*batch"]]:
        """Returns the ratio of ideal to observed radius, and the status (see `RadialLens.ideal_scale`)."""
        # The formula solved for r_u. Beyond the edge stands a very distant point.
        finite = squared <= jnp.finfo(squared.dtype).max
        squared = jnp.square(self.omega) * jnp.where(finite, squared, 0)
        smallest = epsilon(squared.dtype)
        inside = (squared < (0.5 * np.pi) ** 2 * (1 - 4 * smallest)) & (jnp.abs(self.omega) < jnp.pi)
        scale = _tangent_ratio(jnp.where(inside, squared, 0)) / self._stretch()
        return jnp.where(inside, scale, 1 / smallest), inverse_status(finite, inside, jnp.ones_like(inside))

    def _stretch(self) -> Float[Array, ""]:
        """Returns tan(ω / 2) / (ω / 2)."""
        seen = jnp.abs(self.omega) < jnp.pi
        return _tangent_ratio(jnp.square(jnp.where(seen, self.omega, 0)) / 4)


# The series in z² of tan z / z, whose terms follow from each other by tan' = 1 + tan², and of arctan z / z.
_TANGENT = np.ones(_TERMS)
for _n in range(1, _TERMS):
    _TANGENT[_n] = _TANGENT[:_n] @ _TANGENT[:_n][::-1] / (2 * _n + 1)
_ARCTANGENT = (-1.0) ** np.arange(_TERMS) / (2 * np.arange(_TERMS) + 1)


def _tangent_ratio(squared: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Returns tan z / z at z², below (π / 2)²."""
    small = squared < _SMALL
    z = jnp.sqrt(jnp.where(small, 1, squared))
    series = polynomial(jnp.asarray(_TANGENT, squared.dtype), jnp.where(small, squared, 0))
    return jnp.where(small, series, jnp.tan(z) / z)


def _arctangent_ratio(squared: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Returns arctan z / z at z²."""
    small = squared < _SMALL
    z = jnp.sqrt(jnp.where(small, 1, squared))
    series = polynomial(jnp.asarray(_ARCTANGENT, squared.dtype), jnp.where(small, squared, 0))
    return jnp.where(small, series, jnp.arctan(z) / z)
