"""The fisheye lens of Kannala and Brandt: an odd polynomial of the angle."""

from typing import ClassVar

from jaxtyping import Array, ArrayLike, Float

from jaxlens.lenses._angular_lens import AngularLens
from jaxlens.lenses._radial_polynomial import RadialPolynomial
from jaxlens.lenses._registry import register
from jaxlens.numerics import as_coefficients


@register("KannalaBrandt", short="kannala-brandt")
class KannalaBrandt(AngularLens):
    """`r = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`, θ the angle from the axis (Kannala and Brandt 2006).

    OpenCV's `fisheye`; COLMAP's OPENCV_FISHEYE (four coefficients), RADIAL_FISHEYE (two), SIMPLE_RADIAL_FISHEYE (one)
    and SIMPLE_FISHEYE (none). The coordinates are those of a camera matrix. It sees up to the angle where r stops
    growing, at most 180°.

    Attributes:
        coefficients: k1, k2, …, as many as wanted.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.KannalaBrandt([0.05, -0.01, 0.002, -0.0005])
        >>> ray = lens.unproject(lens.project(np.array([3.0, 0.0, -1.0])))
        >>> np.round(ray * np.sqrt(10.0), 5).tolist()
        [3.0, 0.0, -1.0]
    """

    coefficients: Float[Array, " terms"]
    term_counts: ClassVar[tuple[int, ...]] = (4, 1, 2, 3)
    is_round: ClassVar[bool] = True

    def __init__(self, coefficients: ArrayLike | list | tuple):
        self.coefficients = as_coefficients(coefficients, "KannalaBrandt", "k1, k2, k3, k4")

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "KannalaBrandt":
        """Returns the equidistant lens: one to four zeros, four unless given."""
        return cls([0.0] * cls.count_terms(terms))

    @property
    def plane(self) -> RadialPolynomial:
        """The polynomial of the angle, as one of a radius."""
        return RadialPolynomial(self.coefficients)

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns k1, k2 and so on."""
        return [f"k{i + 1}" for i in range(*shape)]
