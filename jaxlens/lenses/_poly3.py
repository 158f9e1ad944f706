"""The lens of lensfun's `poly3`, a cubic that keeps the radius one."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._powers import check_scale
from jaxlens.lenses._registry import register
from jaxlens.numerics import as_parameter


@register("Poly3", short="poly3")
class Poly3(RadialLens):
    """`r_d = r_u (1 − k1 + k1 r_u²)` (lensfun's `poly3`).

    The radius one stays where it is; k1 < 1, so that the centre is seen the right way round. The unit is lensfun's own:
    `PtLens` says which.

    Attributes:
        k1: The coefficient.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl
        >>> jl.Poly3(0.5).distort([0.5, 0.0]).tolist()
        [0.3125, 0.0]
    """

    k1: Float[Array, ""]
    term_counts: ClassVar[tuple[int, ...]] = (1,)

    def __init__(self, k1: ArrayLike, *, center: ArrayLike | list | tuple | None = None):
        self.k1 = as_parameter(k1, "k1")
        check_scale(self, 1 - self.k1, "1 − k1")
        self.center = as_center(center, self.k1.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "Poly3":
        """Returns the lens with k1 = 0."""
        cls.count_terms(terms)
        return cls(0.0)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ = 1 − k1 + k1 r²."""
        return 1 - self.k1 + self.k1 * squared_radius

    def fold_radius(self) -> Float[Array, ""]:
        """Returns √((k1 − 1) / (3 k1)) for k1 < 0, where 1 − k1 + 3 k1 r² vanishes; ∞ for k1 ≥ 0."""
        folds = self.k1 < 0
        k1 = jnp.where(folds, self.k1, -1)
        return jnp.where(folds, jnp.sqrt((k1 - 1) / (3 * k1)), jnp.inf)
