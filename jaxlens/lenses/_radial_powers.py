"""Discorpy's two lenses: all powers of the radius, of the ideal one or of the observed one."""

from typing import ClassVar

from jaxtyping import Array, ArrayLike, Float

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._powers import PowersLens, check_scale
from jaxlens.lenses._registry import register
from jaxlens.lenses._reversed import ReversedLens
from jaxlens.numerics import as_coefficients


def _coefficients(values: ArrayLike | list | tuple, lens: RadialLens) -> Float[Array, " terms"]:
    name = type(lens).__name__
    coefficients = as_coefficients(values, name, "k0, k1, k2, …")
    if not coefficients.size:
        raise ValueError(f"{name} takes k0, k1, k2, …, at least the first of them: [1.0] is the identity")
    check_scale(lens, coefficients[0], "k0")
    return coefficients


class _Coefficients(RadialLens):
    coefficients: Float[Array, " terms"]
    term_counts: ClassVar[tuple[int, ...]] = (5, 2, 3, 4, 6, 7, 8)

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns k0, k1, … for the coefficients."""
        if field == "coefficients":
            return [f"k{i}" for i in range(*shape)]
        return super().parameter_names(field, shape)


@register("RadialPowers", short="radial-powers")
class RadialPowers(_Coefficients, PowersLens):
    """`x_d = c + (x_u − c) (k0 + k1 r + k2 r² + …)` with `r = |x_u − c|` (discorpy's backward model).

    Discorpy counts in pixels: its coefficient of rⁱ, times the frame's scale to the power i, is ours. k0 is positive,
    and need not be one.

    Attributes:
        coefficients: k0, k1, k2, …, at least one. With k1 ≠ 0 there are no second derivatives at the centre: those
            without that term stand in for them.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> jl.RadialPowers([1.0, 0.5, 0.5]).distort(np.array([1.0, 0.0])).tolist()
        [2.0, 0.0]
    """

    def __init__(self, coefficients: ArrayLike | list | tuple, *, center: ArrayLike | list | tuple | None = None):
        self.coefficients = _coefficients(coefficients, self)
        self.center = as_center(center, self.coefficients.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "RadialPowers":
        """Returns the lens of two to eight coefficients, 1, 0, 0, …; five unless given."""
        return cls([1.0] + [0.0] * (cls.count_terms(terms) - 1))

    def powers(self) -> Float[Array, " terms"]:
        """Returns the coefficients."""
        return self.coefficients


@register("RadialPowersInverse", short="radial-powers-inverse")
class RadialPowersInverse(_Coefficients, ReversedLens):
    """`x_u = c + (x_d − c) (k0 + k1 r + k2 r² + …)` with `r = |x_d − c|` (discorpy's forward model).

    The exact inverse of `RadialPowers` of the same coefficients: `undistort` is the polynomial.

    Attributes:
        coefficients: k0, k1, k2, …, at least one; k0 is positive, and need not be one. With k1 ≠ 0 there are no second
            derivatives at the centre: those without that term stand in for them.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> jl.RadialPowersInverse([1.0, 0.5, 0.5]).undistort(np.array([1.0, 0.0])).tolist()
        [2.0, 0.0]
    """

    def __init__(self, coefficients: ArrayLike | list | tuple, *, center: ArrayLike | list | tuple | None = None):
        self.coefficients = _coefficients(coefficients, self)
        self.center = as_center(center, self.coefficients.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "RadialPowersInverse":
        """Returns the lens of two to eight coefficients, 1, 0, 0, …; five unless given."""
        return cls([1.0] + [0.0] * (cls.count_terms(terms) - 1))

    def reverse(self) -> RadialPowers:
        """Returns the lens of the same coefficients that takes observed points to ideal ones."""
        return RadialPowers(self.coefficients, center=self.center)
