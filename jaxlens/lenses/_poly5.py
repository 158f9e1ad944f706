"""The lens of lensfun's `poly5`, two even powers of the radius."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._registry import register
from jaxlens.numerics import as_parameters, jitted
from jaxlens.polynomials import smallest_positive_root


@register("Poly5", short="poly5")
class Poly5(RadialLens):
    """`r_d = r_u (1 + k1 r_u² + k2 r_u⁴)` (lensfun's `poly5`): `RadialPolynomial([k1, k2])` under its name there.

    The unit is lensfun's own: `PtLens` says which.

    Attributes:
        k1: The coefficient of r².
        k2: The coefficient of r⁴.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl
        >>> jl.Poly5(0.5, 1.0).distort([0.5, 0.0]).tolist()
        [0.59375, 0.0]
    """

    k1: Float[Array, ""]
    k2: Float[Array, ""]
    term_counts: ClassVar[tuple[int, ...]] = (2,)

    def __init__(self, k1: ArrayLike, k2: ArrayLike, *, center: ArrayLike | list | tuple | None = None):
        self.k1, self.k2 = as_parameters(k1=k1, k2=k2)
        self.center = as_center(center, self.k1.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "Poly5":
        """Returns the lens with k1 = k2 = 0."""
        cls.count_terms(terms)
        return cls(0.0, 0.0)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ = 1 + k1 r² + k2 r⁴."""
        return 1 + squared_radius * (self.k1 + squared_radius * self.k2)

    @jitted
    def fold_radius(self) -> Float[Array, ""]:
        """Returns the first r at which 1 + 3 k1 r² + 5 k2 r⁴ turns negative; ∞ if it never does."""
        return jnp.sqrt(smallest_positive_root(jnp.stack([3 * self.k1, 5 * self.k2])))
