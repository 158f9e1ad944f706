"""What lenses share whose observed radius is a polynomial in the ideal one, odd and even powers alike."""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxlens.lenses._lens import RadialLens
from jaxlens.numerics import epsilon, is_concrete, jitted, polynomial
from jaxlens.polynomials import smallest_positive_root


class PowersLens(RadialLens):
    """`x_d = c + (x_u − c) P(r)` with `P(r) = p0 + p1 r + p2 r² + …` and `r = |x_u − c|`; p0 is positive.

    At the centre itself the first derivatives are those of p0; second derivatives, which p1 ≠ 0 denies a meaning
    there, are those without p1.
    """

    @abc.abstractmethod
    def powers(self) -> Float[Array, " terms"]:
        """Returns p0, p1, p2, … of P."""

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ = P(r)."""
        return polynomial(self.powers(), smooth_root(squared_radius))

    def radius(self, radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns the observed radius of ideal radii, ρ P(ρ)."""
        return radius * polynomial(self.powers(), radius)

    def radius_and_slope(self, radius: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Returns ρ P(ρ) and its derivative p0 + 2 p1 ρ + 3 p2 ρ² + …, cheaper than by differentiation."""
        return self.radius(radius), polynomial(_slopes(self.powers()), radius)

    @jitted
    def fold_radius(self) -> Float[Array, ""]:
        """Returns the first ρ at which d(ρ P(ρ))/dρ turns negative; ∞ if it never does."""
        return first_root(_slopes(self.powers()))


def _slopes(powers: Float[Array, " terms"]) -> Float[Array, " terms"]:
    return powers * jnp.arange(1, powers.shape[0] + 1, dtype=powers.dtype)


def first_root(powers: Float[Array, " terms"]) -> Float[Array, ""]:
    """Returns the first radius at which a polynomial, positive at zero, turns negative; ∞ if it never does."""
    first = powers[0]
    positive = first > 0
    return jnp.where(positive, smallest_positive_root(powers[1:] / jnp.where(positive, first, 1)), 0)


def smooth_root(squared: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Returns the square root, zero with zero derivatives where adding it to one would be no change."""
    visible = squared > epsilon(squared.dtype) ** 2
    return jnp.where(visible, jnp.sqrt(jnp.where(visible, squared, 1)), 0)


def check_scale(lens: RadialLens, scale: Float[Array, ""], meaning: str) -> None:
    """Refuses a lens that does not keep orientation at its centre.

    Raises:
        ValueError: the ratio of radii there is known, and not positive.
    """
    if is_concrete(scale) and not scale > 0:
        raise ValueError(
            f"{type(lens).__name__} scales by {meaning} at its centre, which must be positive, got {scale:g}"
        )
