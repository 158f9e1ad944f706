"""The Brown–Conrady lens in OpenCV's parameters: radial, tangential, and rational terms."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxlens.lenses._lens import Lens
from jaxlens.lenses._registry import register
from jaxlens.numerics import as_coefficients, as_points, jitted, join, split
from jaxlens.polynomials import smallest_positive_root

_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


@register("BrownConrady", short="brown-conrady")
class BrownConrady(Lens):
    """`x_d = x_u R + (2 p1 x y + p2 (r² + 2 x²), p1 (r² + 2 y²) + 2 p2 x y)` (Brown 1966; OpenCV's model and order).

    R = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) with r = |x_u|. The coordinates are those of a
    camera matrix (`Frame.from_camera_matrix`), and the principal point is the centre of distortion.

    Attributes:
        coefficients: k1, k2, p1, p2[, k3[, k4, k5, k6]]: 4, 5 or 8 of them, as OpenCV orders them.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> lens = jl.BrownConrady([-0.28, 0.03, 0.001, 0.0, 0.16])
        >>> bool(lens.invert(np.array([0.3, 0.2])).valid)
        True
    """

    coefficients: Float[Array, " terms"]
    term_counts: ClassVar[tuple[int, ...]] = (5, 4, 8)

    def __init__(self, coefficients: ArrayLike | list | tuple):
        self.coefficients = as_coefficients(coefficients, "BrownConrady", "k1, k2, p1, p2[, k3[, k4, k5, k6]]")
        if self.coefficients.shape[0] not in self.term_counts:
            raise ValueError(
                "BrownConrady takes k1, k2, p1, p2[, k3[, k4, k5, k6]], that is 4, 5 or 8 numbers, got "
                f"{self.coefficients.shape[0]}"
            )

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "BrownConrady":
        """Returns the lens of 4, 5 or 8 zeros; five unless given."""
        return cls([0.0] * cls.count_terms(terms))

    @property
    def needs_frame(self) -> bool:
        """True: the coordinates are those of a camera matrix."""
        return True

    @jitted
    def distort(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Maps ideal points `(..., 2)` to observed ones, beyond a fold too."""
        x, y = split(as_points(points))
        k1, k2, p1, p2, *rest = self.coefficients
        k3 = rest[0] if rest else 0
        squared = x * x + y * y
        factor = 1 + squared * (k1 + squared * (k2 + squared * k3))
        if len(rest) > 1:
            _, k4, k5, k6 = rest
            factor = factor / (1 + squared * (k4 + squared * (k5 + squared * k6)))
        cross = 2 * x * y
        return join(
            x * factor + p1 * cross + p2 * (squared + 2 * x * x),
            y * factor + p1 * (squared + 2 * y * y) + p2 * cross,
        )

    def pole_radius(self) -> Float[Array, ""]:
        """Returns the ideal radius where 1 + k4 r² + k5 r⁴ + k6 r⁶ first vanishes, ∞ if it does not."""
        return jnp.sqrt(smallest_positive_root(self.coefficients[5:]))

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns OpenCV's names, in its order."""
        return list(_NAMES[: shape[0]]) if field == "coefficients" else super().parameter_names(field, shape)
