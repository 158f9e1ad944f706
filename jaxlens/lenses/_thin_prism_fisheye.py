"""Fisheyes with tangential and thin-prism terms: of Weng's equations, and Project Aria's."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxlens.lenses._lens import Lens
from jaxlens.lenses._projections import Equidistant
from jaxlens.lenses._registry import register
from jaxlens.lenses._wide_lens import DistortedProjection
from jaxlens.numerics import as_coefficients, as_points, join, polynomial, split

Plane = Float[Array, "*batch"]


class _Fisheye(DistortedProjection):
    """The equidistant projection, the plane of which `plane` distorts by a fixed number of coefficients."""

    coefficients: Float[Array, " terms"]
    names: ClassVar[tuple[str, ...]] = ()

    def __init__(self, coefficients: ArrayLike | list | tuple):
        name, listed = type(self).__name__, ", ".join(self.names)
        self.coefficients = as_coefficients(coefficients, name, listed)
        if self.coefficients.shape != (len(self.names),):
            raise ValueError(
                f"{name} takes {listed}, that is {len(self.names)} numbers, got {self.coefficients.shape[0]}"
            )

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "_Fisheye":
        """Returns the equidistant lens: all coefficients zero."""
        return cls([0.0] * cls.count_terms(terms))

    @property
    def projection(self) -> Equidistant:
        """Equidistant."""
        return Equidistant()

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns COLMAP's names, in its order."""
        return list(self.names)


@register("ThinPrismFisheye", short="thin-prism-fisheye")
class ThinPrismFisheye(_Fisheye):
    """`x_d = u (1 + k1 r² + k2 r⁴ + k3 r⁶ + k4 r⁸) + tangential + prism` of the equidistant point u = (u, v), r = θ.

    Tangential are (2 p1 u v + p2 (r² + 2 u²), p1 (r² + 2 v²) + 2 p2 u v), the prism's (sx1 r², sy1 r²) (Weng, Cohen and
    Herniou 1992, on a fisheye). COLMAP's THIN_PRISM_FISHEYE. The coordinates are those of a camera matrix.

    Attributes:
        coefficients: k1, k2, p1, p2, k3, k4, sx1, sy1, as COLMAP orders them.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.ThinPrismFisheye([0.05, -0.01, 1e-3, -1e-3, 0.0, 0.0, 1e-3, 0.0])
        >>> [round(float(x), 5) for x in lens.unproject(lens.project(np.array([0.48, 0.64, -0.6])))]
        [0.48, 0.64, -0.6]
    """

    names: ClassVar[tuple[str, ...]] = ("k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1")
    term_counts: ClassVar[tuple[int, ...]] = (8,)

    @property
    def plane(self) -> Lens:
        """The terms, of an equidistant point."""
        return _ThinPrism(self.coefficients)

    def _turned_quarter(self) -> "ThinPrismFisheye":
        k1, k2, p1, p2, k3, k4, sx1, sy1 = self.coefficients
        return ThinPrismFisheye(jnp.stack([k1, k2, -p2, p1, k3, k4, sy1, -sx1]))


@register("RadTanThinPrismFisheye", short="rad-tan-thin-prism-fisheye")
class RadTanThinPrismFisheye(_Fisheye):
    """`x_d = m + tangential(m) + prism(m)` with `m = u (1 + k0 θ² + k1 θ⁴ + … + k5 θ¹²)` of the equidistant point u.

    With m = (x, y) and ρ = |m| the tangential terms are (p0 (ρ² + 2 x²) + 2 p1 x y, 2 p0 x y + p1 (ρ² + 2 y²)), the
    prism's (s0 ρ² + s1 ρ⁴, s2 ρ² + s3 ρ⁴): the others' radius is that of m, after the radial terms. COLMAP's
    RAD_TAN_THIN_PRISM_FISHEYE, Project Aria's Fisheye624. The coordinates are those of a camera matrix.

    Attributes:
        coefficients: k0, k1, k2, k3, k4, k5, p0, p1, s0, s1, s2, s3, as both order them.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.RadTanThinPrismFisheye([-0.02, 0.1, -0.06, 0.01, 0.0, 0.0, 1e-3, -1e-3, 1e-3, 0.0, 0.0, -1e-4])
        >>> [round(float(x), 5) for x in lens.unproject(lens.project(np.array([0.48, 0.64, 0.6])))]
        [0.48, 0.64, 0.6]
    """

    names: ClassVar[tuple[str, ...]] = ("k0", "k1", "k2", "k3", "k4", "k5", "p0", "p1", "s0", "s1", "s2", "s3")
    term_counts: ClassVar[tuple[int, ...]] = (12,)

    @property
    def plane(self) -> Lens:
        """The terms, of an equidistant point."""
        return _RadTanThinPrism(self.coefficients)

    def _turned_quarter(self) -> "RadTanThinPrismFisheye":
        p0, p1, s0, s1, s2, s3 = self.coefficients[6:]
        turned = jnp.stack([p1, -p0, s2, s3, -s0, -s1])
        return RadTanThinPrismFisheye(jnp.concatenate([self.coefficients[:6], turned]))


class _ThinPrism(Lens):
    coefficients: Float[Array, "8"]

    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        x, y = split(as_points(points))
        k1, k2, p1, p2, k3, k4, sx1, sy1 = self.coefficients
        squared = x * x + y * y
        factor = 1 + squared * (k1 + squared * (k2 + squared * (k3 + squared * k4)))
        across, down = _tangential(x, y, squared, p2, p1)
        return join(x * factor + across + sx1 * squared, y * factor + down + sy1 * squared)


class _RadTanThinPrism(Lens):
    coefficients: Float[Array, "12"]

    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        x, y = split(as_points(points))
        p0, p1, s0, s1, s2, s3 = self.coefficients[6:]
        squared = x * x + y * y
        factor = 1 + squared * polynomial(self.coefficients[:6], squared)
        x, y = x * factor, y * factor
        squared = x * x + y * y
        across, down = _tangential(x, y, squared, p0, p1)
        return join(x + across + squared * (s0 + squared * s1), y + down + squared * (s2 + squared * s3))


def _tangential(x: Plane, y: Plane, squared: Plane, right: Array, down: Array) -> tuple[Plane, Plane]:
    """Returns the shift by a lens that is off its axis to the right and downwards by these coefficients."""
    cross = 2 * x * y
    return right * (squared + 2 * x * x) + down * cross, down * (squared + 2 * y * y) + right * cross
