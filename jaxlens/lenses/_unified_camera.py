"""The unified lens of Geyer, Barreto and Mei: a sphere, a pinhole beside its centre, and Brown–Conrady's terms."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.lenses._brown_conrady import BrownConrady
from jaxlens.lenses._lens import Lens
from jaxlens.lenses._projections import Perspective
from jaxlens.lenses._registry import register
from jaxlens.lenses._wide_lens import DistortedProjection, Projection, unit
from jaxlens.numerics import as_coefficients, as_parameter, join, split


class _Unified(Projection):
    """`(x, y) / (z + ξ)` of unit rays."""

    xi: Float[Array, ""]

    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, and which of them are seen."""
        x, y, z, some = unit(rays)
        seen = some & (z > self._least_cosine())
        depth = jnp.where(seen, z + self.xi, 1)
        return join(jnp.where(seen, x, 0) / depth, jnp.where(seen, y, 0) / depth), seen

    def raised(self, points: Float[Array, "*batch 2"]) -> tuple[Float[Array, "*batch 3"], Bool[Array, "*batch"]]:
        """Returns the unit rays of finite observed points, and which of the points are of a ray that is seen."""
        x, y = split(points)
        squared = x * x + y * y
        under = 1 + (1 - self.xi**2) * squared
        reached = under > 0
        scale = (self.xi + jnp.sqrt(jnp.where(reached, under, 1))) / (1 + squared)
        reached &= scale - self.xi > self._least_cosine()
        scale = jnp.where(reached, scale, 0)
        return join(x * scale, y * scale, jnp.where(reached, scale - self.xi, 1)), reached

    def field_of_view(self) -> Float[Array, ""]:
        """Returns the angle from the axis, in radians, where r stops growing."""
        return jnp.arccos(jnp.clip(self._least_cosine(), -1, 1))

    def _least_cosine(self) -> Float[Array, ""]:
        far = self.xi > 1
        return -jnp.where(far, 1 / jnp.where(far, self.xi, 1), self.xi)


@register("UnifiedCamera", short="unified")
class UnifiedCamera(DistortedProjection):
    """`m = (x, y) / (z + ξ)` of unit rays, then `BrownConrady` of m (Geyer and Daniilidis 2000; Mei and Rives 2007).

    The coordinates are those of a camera matrix, as in OpenCV's `omnidir` and in Kalibr's `omni` with `radtan`. It sees
    up to the angle where |m| stops growing, or where its coefficients fold it.

    Attributes:
        xi: ξ, the distance of the pinhole from the sphere's centre; 0 is a perspective lens, 1 a parabolic mirror.
        coefficients: k1, k2, p1, p2, … as of `BrownConrady`; none at all is the pure projection.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.UnifiedCamera(0.9, [-0.05, 0.01, 0.0, 0.001])
        >>> np.round(lens.unproject(lens.project(np.array([0.8, 0.0, -0.6]))), 5).tolist()
        [0.8, 0.0, -0.6]
    """

    xi: Float[Array, ""]
    coefficients: Float[Array, " terms"]
    term_counts: ClassVar[tuple[int, ...]] = (4, 0, 5)

    def __init__(self, xi: ArrayLike, coefficients: ArrayLike | list | tuple = ()):
        self.xi = as_parameter(xi, "xi")
        self.coefficients = as_coefficients(coefficients, "UnifiedCamera", "k1, k2, p1, p2 as its coefficients")
        if self.coefficients.shape[0]:
            BrownConrady(self.coefficients)  # says which numbers there may be

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "UnifiedCamera":
        """Returns ξ = 1, a wide lens (the stereographic one at half the scale), with zeros: four unless given."""
        return cls(1.0, [0.0] * cls.count_terms(terms))

    @property
    def projection(self) -> Projection:
        """The sphere's."""
        return _Unified(self.xi)

    @property
    def plane(self) -> Lens:
        """Brown–Conrady's terms."""
        return BrownConrady(self.coefficients) if self.coefficients.shape[0] else Perspective()

    def _turned_quarter(self) -> Lens:
        plane = self.plane.turned(1)
        if isinstance(plane, BrownConrady):
            return UnifiedCamera(self.xi, plane.coefficients)
        return self if plane.is_round else super()._turned_quarter()

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns xi, and OpenCV's names of the coefficients."""
        return ["xi"] if field == "xi" else BrownConrady(jnp.zeros(shape)).parameter_names(field, shape)
