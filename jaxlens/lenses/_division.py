"""The division model of Eq. 5: one coefficient, both directions in closed form."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int8

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._registry import register
from jaxlens.maps import inverse_status
from jaxlens.numerics import as_floating, epsilon


@register("Division", short="division")
class Division(RadialLens):
    """`x_u = c + (x_d − c) / (1 − k |x_d − c|²)` (Eq. 5, second form).

    k > 0 is barrel, k < 0 pincushion: the observed radius is smaller, or larger, than the ideal one. For small |k| the
    lens is `RadialPolynomial([-k])`.

    Attributes:
        k: The coefficient.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.
    """

    k: Float[Array, ""]
    term_counts: ClassVar[tuple[int, ...]] = (1,)

    def __init__(self, k: ArrayLike, *, center: ArrayLike | list | tuple | None = None):
        self.k = as_floating(k)
        if self.k.ndim != 0:
            raise ValueError(
                f"k must be a number, got shape {self.k.shape}; a batch of lenses is made by jax.vmap(Division)(k)"
            )
        self.center = as_center(center, self.k.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "Division":
        """Returns the lens with k = 0."""
        cls.count_terms(terms)
        return cls(0.0)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ = 2 / (1 + √(1 + 4 k r²)): Eq. 5 solved for x_d without cancellation; NaN beyond the fold."""
        discriminant = 1 + 4 * self.k * squared_radius
        seen = discriminant > 0
        root = jnp.sqrt(jnp.where(seen, discriminant, 1))
        # The fold itself, where the discriminant vanishes up to rounding, is still seen.
        at_fold = jnp.where(discriminant >= -4 * epsilon(discriminant.dtype), 2, jnp.nan)
        return jnp.where(seen, 2 / (1 + root), at_fold)

    def fold_radius(self) -> Float[Array, ""]:
        """Returns 1 / (2 √−k) for k < 0, where `undistort` reaches its largest radius; ∞ for k ≥ 0."""
        folds = self.k < 0
        return jnp.where(folds, 0.5 / jnp.sqrt(jnp.where(folds, -self.k, 1)), jnp.inf)

    def edge_radius(self) -> Float[Array, ""]:
        """Returns the largest observed radius, 1 / √|k|: of the fold for k < 0, of points at infinity for k > 0."""
        bounded = self.k != 0
        return jnp.where(bounded, 1 / jnp.sqrt(jnp.where(bounded, jnp.abs(self.k), 1)), jnp.inf)

    def _ideal_scale(self, squared: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Int8[Array, "*batch"]]:
        # Eq. 5 itself. For k > 0 the ideal radius grows without bound towards the edge: beyond it stands a very
        # distant point.
        finite = squared <= jnp.finfo(squared.dtype).max
        squared = self.k * jnp.where(finite, squared, 0)
        inside = jnp.where(self.k > 0, squared < 1, squared >= -1)
        smallest = epsilon(squared.dtype)
        scale = 1 / jnp.maximum(jnp.where(inside, 1 - squared, 1), smallest)
        on_the_fold = 0.5 / jnp.sqrt(jnp.where(inside, 1, jnp.abs(squared)))
        scale = jnp.where(inside, scale, jnp.where(self.k > 0, 1 / smallest, on_the_fold))
        return scale, inverse_status(finite, inside, jnp.ones_like(inside))
