"""The extended unified lens of Khomutenko, Garcia and Martinet."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from jaxlens.lenses._registry import register
from jaxlens.lenses._wide_lens import Projection, unit
from jaxlens.numerics import as_parameter, join, split


@register("ExtendedUnifiedCamera", short="extended-unified")
class ExtendedUnifiedCamera(Projection):
    """`x_d = (x, y) / (α d + (1 − α) z)`, d² = β (x² + y²) + z² (Khomutenko et al. 2016).

    Closed form both ways. The coordinates are those of a camera matrix, as in Kalibr's `eucm`. Beyond the angle where r
    stops growing it does not see. For β = 1 it is the unified lens.

    Attributes:
        alpha: α, between 0 (a pinhole) and 1.
        beta: β > 0.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.ExtendedUnifiedCamera(0.6, 1.1)
        >>> np.round(lens.unproject(lens.project(np.array([0.8, 0.0, -0.6]))), 6).tolist()
        [0.8, 0.0, -0.6]
    """

    alpha: Float[Array, ""]
    beta: Float[Array, ""]
    term_counts: ClassVar[tuple[int, ...]] = ()
    is_round: ClassVar[bool] = True

    def __init__(self, alpha: ArrayLike, beta: ArrayLike):
        self.alpha, self.beta = as_parameter(alpha, "alpha"), as_parameter(beta, "beta")

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "ExtendedUnifiedCamera":
        """Returns α = ½, β = 1, a wide lens (the stereographic one at half the scale), from where a fit goes well."""
        if terms is not None:
            cls.count_terms(terms)
        return cls(0.5, 1.0)

    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, and which of them the lens sees."""
        x, y, z, some = unit(rays)
        squared = x * x + y * y
        seen = some & self._sees(squared, z)
        distance = jnp.sqrt(jnp.where(seen, self.beta * squared + z * z, 1))
        depth = jnp.where(seen, self.alpha * distance + (1 - self.alpha) * z, 1)
        return join(jnp.where(seen, x, 0) / depth, jnp.where(seen, y, 0) / depth), seen

    def raised(self, points: Float[Array, "*batch 2"]) -> tuple[Float[Array, "*batch 3"], Bool[Array, "*batch"]]:
        """Returns the unit rays of finite observed points, and which of the points are of a ray that the lens sees."""
        x, y = split(points)
        squared = x * x + y * y
        under = 1 - (2 * self.alpha - 1) * self.beta * squared
        reached = under > 0
        squared, under = jnp.where(reached, squared, 0), jnp.where(reached, under, 1)
        z = (1 - self.beta * self.alpha**2 * squared) / (self.alpha * jnp.sqrt(under) + 1 - self.alpha)
        reached &= self._sees(squared, z)
        scale = jnp.where(reached, 1 / jnp.sqrt(squared + z * z), 0)
        return join(x * scale, y * scale, jnp.where(reached, z * scale, 1)), reached

    def field_of_view(self) -> Float[Array, ""]:
        """Returns the angle from the axis, in radians, where r stops growing."""
        widest = self._bend()
        whole = widest >= 1
        share = jnp.where(whole, 0, widest)
        behind = jnp.arctan(share * jnp.sqrt(self.beta / (1 - share * share)))
        return jnp.where(whole, jnp.pi, jnp.pi / 2 + behind)

    def _sees(self, squared: Float[Array, "*batch"], z: Float[Array, "*batch"]) -> Bool[Array, "*batch"]:
        return (z > 0) | (z * z < self._bend() ** 2 * (self.beta * squared + z * z))

    def _bend(self) -> Float[Array, ""]:
        """−z / d where r stops growing."""
        near = self.alpha <= 0.5
        return jnp.where(near, self.alpha, 1 - self.alpha) / jnp.where(near, 1 - self.alpha, self.alpha)
