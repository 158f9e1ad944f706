"""The Brown–Conrady lens in OpenCV's parameters: radial, tangential, rational, thin-prism terms, a tilted sensor."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.lenses._lens import Lens
from jaxlens.lenses._registry import register
from jaxlens.lenses._tilted_sensor import TiltedSensor
from jaxlens.maps import Chain, Inverse
from jaxlens.numerics import as_coefficients, as_points, is_concrete, jitted, join, split
from jaxlens.polynomials import smallest_positive_root

_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
_ORDER = "k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4[, tau_x, tau_y]]]]"
_UNTILTED = 12


@register("BrownConrady", short="brown-conrady")
class BrownConrady(Lens):
    """`x_d = x_u R + (2 p1 x y + p2 (r² + 2 x²), p1 (r² + 2 y²) + 2 p2 x y)` (Brown 1966; OpenCV's model and order).

    R = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) with r = |x_u|. The coordinates are those of a
    camera matrix (`Frame.from_camera_matrix`), and the principal point is the centre of distortion. Twelve
    coefficients add the thin prism, (s1 r² + s2 r⁴, s3 r² + s4 r⁴); fourteen turn the sensor, after all that, by τx
    and τy radians, as OpenCV does: points that it would see from behind are not in its region.

    Attributes:
        coefficients: k1, k2, p1, p2[, k3[, k4, k5, k6[, s1, s2, s3, s4[, τx, τy]]]]: 4, 5, 8, 12 or 14 of them, as
            OpenCV orders them.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.BrownConrady([-0.28, 0.03, 0.001, 0.0, 0.16])
        >>> bool(lens.invert(np.array([0.3, 0.2])).valid)
        True
    """

    coefficients: Float[Array, " terms"]
    term_counts: ClassVar[tuple[int, ...]] = (5, 4, 8, 12, 14)

    def __init__(self, coefficients: ArrayLike | list | tuple):
        self.coefficients = as_coefficients(coefficients, "BrownConrady", _ORDER)
        if self.coefficients.shape[0] not in self.term_counts:
            raise ValueError(
                f"BrownConrady takes {_ORDER}, that is 4, 5, 8, 12 or 14 numbers, got {self.coefficients.shape[0]}"
            )

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "BrownConrady":
        """Returns the lens of 4, 5, 8, 12 or 14 zeros; five unless given."""
        return cls([0.0] * cls.count_terms(terms))

    @property
    def needs_frame(self) -> bool:
        """True: the coordinates are those of a camera matrix."""
        return True

    @jitted
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones, beyond a fold too."""
        x, y = split(as_points(points))
        k1, k2, p1, p2, *rest = self.coefficients
        k3 = rest[0] if rest else 0
        squared = x * x + y * y
        factor = 1 + squared * (k1 + squared * (k2 + squared * k3))
        if len(rest) > 1:
            k4, k5, k6 = rest[1:4]
            factor = factor / (1 + squared * (k4 + squared * (k5 + squared * k6)))
        cross = 2 * x * y
        x, y = (
            x * factor + p1 * cross + p2 * (squared + 2 * x * x),
            y * factor + p1 * (squared + 2 * y * y) + p2 * cross,
        )
        if len(rest) > 4:
            s1, s2, s3, s4 = rest[4:8]
            x, y = x + squared * (s1 + squared * s2), y + squared * (s3 + squared * s4)
        return self._parts()[1](join(x, y)) if self._is_tilted() else join(x, y)

    def one_to_one(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether ideal points lie before the first fold on their ray, and are seen from the sensor's front."""
        return Chain(self._parts()).one_to_one(points) if self._is_tilted() else super().one_to_one(points)

    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the ideal points of observed ones, as every lens: a tilt is taken off first, in closed form."""
        return Chain(self._parts()).invert(points) if self._is_tilted() else super().invert(points)

    def preimages(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Returns the points of `invert`, NaN where they are not valid."""
        if not self._is_tilted():
            return super().preimages(points)
        lens, sensor = self._parts()
        return lens.preimages(sensor.preimages(points))

    def pole_radius(self) -> Float[Array, ""]:
        """Returns the ideal radius where 1 + k4 r² + k5 r⁴ + k6 r⁶ first vanishes, ∞ if it does not."""
        return jnp.sqrt(smallest_positive_root(self.coefficients[5:8]))

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns OpenCV's names, in its order."""
        return list(_NAMES[: shape[0]]) if field == "coefficients" else super().parameter_names(field, shape)

    def _is_tilted(self) -> bool:
        return self.coefficients.shape[0] > _UNTILTED

    def _parts(self) -> tuple["BrownConrady", TiltedSensor]:
        """Returns the lens before a square sensor, and the tilt."""
        return BrownConrady(self.coefficients[:_UNTILTED]), TiltedSensor(self.coefficients[_UNTILTED:])

    def _turned_quarter(self) -> Lens:
        k1, k2, p1, p2, *rest = self.coefficients
        radial, prism, tilt = rest[:4], rest[4:8], rest[8:]
        if tilt:
            if not is_concrete(tilt) or (tilt[0] != 0 and tilt[1] != 0):
                # Turned, the sensor's rotations would stand in the other order, which no lens of this kind has.
                return super()._turned_quarter()
            tilt = [tilt[1], -tilt[0]]
        if prism:
            s1, s2, s3, s4 = prism
            prism = [s3, s4, -s1, -s2]
        return BrownConrady(jnp.stack([k1, k2, -p2, p1, *radial, *prism, *tilt]))
