"""The polynomial lens of Eq. 9, of any order."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._registry import register
from jaxlens.numerics import as_coefficients, jitted, polynomial
from jaxlens.polynomials import smallest_positive_root


@register("RadialPolynomial", short="radial")
class RadialPolynomial(RadialLens):
    """`x_d = c + (x_u − c) Φ(r²)` with `Φ(r²) = 1 + κ1 r² + κ2 r⁴ + …` (Eq. 9) and `r = |x_u − c|`.

    κ > 0 is pincushion, κ < 0 barrel; order one, `1 + k r²`, is the model of the paper's Section 2.4.

    Attributes:
        coefficients: κ1, κ2, …, as many as wanted; none is the identity.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> lens = jl.RadialPolynomial([0.0, 1.0])
        >>> lens.undistort(lens.distort(jnp.array([[0.5, 0.0]]))).tolist()
        [[0.5, 0.0]]
    """

    coefficients: Float[Array, " order"]
    term_counts: ClassVar[tuple[int, ...]] = (2, 1, 3, 4, 5, 6, 7, 8)

    def __init__(self, coefficients: ArrayLike | list | tuple, *, center: ArrayLike | list | tuple | None = None):
        self.coefficients = as_coefficients(coefficients, "RadialPolynomial", "κ1, κ2, …")
        self.center = as_center(center, self.coefficients.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "RadialPolynomial":
        """Returns the lens of one to eight zeros, two unless given; the constructor takes any number."""
        return cls([0.0] * cls.count_terms(terms))

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ(r²) of Eq. 9."""
        return 1 + squared_radius * polynomial(self.coefficients, squared_radius)

    def radius_and_slope(self, radius: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Returns ρ Φ(ρ²) and its derivative 1 + 3 κ1 ρ² + 5 κ2 ρ⁴ + …, cheaper than by differentiation."""
        squared = radius * radius
        slope = 1 + squared * polynomial(self._slope_coefficients(), squared)
        return radius * self.factor(squared), slope

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns kappa1, kappa2, … for the coefficients."""
        if field == "coefficients":
            return [f"kappa{i + 1}" for i in range(*shape)]
        return super().parameter_names(field, shape)

    @jitted
    def fold_radius(self) -> Float[Array, ""]:
        """Returns the first ρ at which d(ρ Φ(ρ²))/dρ = 1 + 3 κ1 ρ² + 5 κ2 ρ⁴ + … turns negative; ∞ if it never does."""
        return jnp.sqrt(smallest_positive_root(self._slope_coefficients()))

    def _slope_coefficients(self) -> Float[Array, " order"]:
        odd = 2 * jnp.arange(1, self.coefficients.shape[0] + 1, dtype=self.coefficients.dtype) + 1
        return odd * self.coefficients
