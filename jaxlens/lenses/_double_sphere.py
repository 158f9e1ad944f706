"""The double-sphere lens of Usenko, Demmel and Cremers."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.lenses._registry import register
from jaxlens.lenses._wide_lens import Projection, unit
from jaxlens.numerics import as_parameter, join, split


@register("DoubleSphere", short="double-sphere")
class DoubleSphere(Projection):
    """`x_d = (x, y) / (α d₂ + (1 − α) (ξ d₁ + z))`, d₁ = |ray|, d₂² = x² + y² + (ξ d₁ + z)² (Usenko et al. 2018).

    Closed form both ways. The coordinates are those of a camera matrix, as in basalt and in Kalibr's `ds`. Beyond the
    angle where r stops growing it does not see.

    Attributes:
        xi: ξ, between −1 and 1: from the first sphere's centre to the second's.
        alpha: α, between 0 and 1: how far the pinhole lies behind.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.DoubleSphere(-0.2, 0.6)
        >>> np.round(lens.unproject(lens.project(np.array([0.8, 0.0, -0.6]))), 6).tolist()
        [0.8, 0.0, -0.6]
    """

    xi: Float[Array, ""]
    alpha: Float[Array, ""]
    term_counts: ClassVar[tuple[int, ...]] = ()
    is_round: ClassVar[bool] = True

    def __init__(self, xi: ArrayLike, alpha: ArrayLike):
        self.xi, self.alpha = as_parameter(xi, "xi"), as_parameter(alpha, "alpha")

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "DoubleSphere":
        """Returns ξ = 0, α = ½, a wide lens (the stereographic one at half the scale), from where a fit goes well."""
        if terms is not None:
            cls.count_terms(terms)
        return cls(0.0, 0.5)

    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, and which of them the lens sees."""
        x, y, z, some = unit(rays)
        seen = some & (z > self._least_cosine())
        shifted = jnp.where(seen, self.xi + z, 1 + self.xi)
        distance = jnp.sqrt(jnp.where(seen, x * x + y * y, 0) + shifted * shifted)
        depth = self.alpha * distance + (1 - self.alpha) * shifted
        return join(jnp.where(seen, x, 0) / depth, jnp.where(seen, y, 0) / depth), seen

    def raised(self, points: Float[Array, "*batch 2"]) -> tuple[Float[Array, "*batch 3"], Bool[Array, "*batch"]]:
        """Returns the unit rays of finite observed points, and which of the points are of a ray that the lens sees."""
        x, y = split(points)
        squared = x * x + y * y
        under = 1 - (2 * self.alpha - 1) * squared
        reached = under > 0
        squared = jnp.where(reached, squared, 0)
        height = (1 - self.alpha**2 * squared) / (self.alpha * jnp.sqrt(jnp.where(reached, under, 1)) + 1 - self.alpha)
        under = height * height + (1 - self.xi**2) * squared
        reached &= under > 0
        scale = (height * self.xi + jnp.sqrt(jnp.where(reached, under, 1))) / (height * height + squared)
        z = scale * height - self.xi
        reached &= z > self._least_cosine()
        scale = jnp.where(reached, scale, 0)
        return join(x * scale, y * scale, jnp.where(reached, z, 1)), reached

    def field_of_view(self) -> Float[Array, ""]:
        """Returns the angle from the axis, in radians, where r stops growing."""
        return jnp.arccos(jnp.clip(self._least_cosine(), -1, 1))

    def _least_cosine(self) -> Float[Array, ""]:
        """The cosine of the angle where r stops growing, or grows without bound; below −1 where neither happens.

        Both happen at ξ + z = −w d₂, with w = α / (1 − α) for the pole and its inverse for the fold: the smaller
        comes first. (The paper's bound, −w₂, is another: nearer for some lenses, beyond the fold for others.)
        """
        near = self.alpha <= 0.5
        bend = jnp.where(near, self.alpha, 1 - self.alpha) / jnp.where(near, 1 - self.alpha, self.alpha)
        # d₂² = 1 − ξ² + 2 ξ (ξ + z) for unit rays, so that it is a root of a quadratic.
        half, constant = self.xi * bend**2, bend**2 * (1 - self.xi**2)
        under = half * half + constant
        return jnp.where(under > 0, half - jnp.sqrt(jnp.where(under > 0, under, 1)), -2) - self.xi
