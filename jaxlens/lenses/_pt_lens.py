"""The lens of PanoTools, Hugin and lensfun: a quartic that keeps the radius one."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from jaxlens.lenses._lens import as_center
from jaxlens.lenses._powers import PowersLens, check_scale
from jaxlens.lenses._registry import register
from jaxlens.numerics import as_parameters


@register("PtLens", short="ptlens")
class PtLens(PowersLens):
    """`r_d = r_u (a r³ + b r² + c r + 1 − a − b − c)` with r = r_u (PanoTools, Hugin; lensfun's `ptlens`).

    The radius one stays where it is; a + b + c < 1, so that the centre is seen the right way round. For Hugin its unit
    is half the shorter side of the picture, for lensfun that of the picture on which the lens was calibrated. With
    lensfun's crop factors and the `aspect_ratio` of its calibration, 1.5 unless it says otherwise, the frame of a
    picture is `Frame(((w − 1) / 2, (h − 1) / 2), s)` with
    `s = hypot(w − 1, h − 1) / 2 / hypot(aspect_ratio, 1) * camera_crop / calibration_crop`.

    Attributes:
        a: The coefficient of r³.
        b: The coefficient of r².
        c: The coefficient of r. Other than zero it has no second derivative at the centre: zero stands in for it.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl
        >>> jl.PtLens(0.0, 0.5, 0.25).distort([0.5, 0.0]).tolist()
        [0.25, 0.0]
    """

    a: Float[Array, ""]
    b: Float[Array, ""]
    c: Float[Array, ""]
    term_counts: ClassVar[tuple[int, ...]] = (3,)

    def __init__(self, a: ArrayLike, b: ArrayLike, c: ArrayLike, *, center: ArrayLike | list | tuple | None = None):
        self.a, self.b, self.c = as_parameters(a=a, b=b, c=c)
        check_scale(self, 1 - self.a - self.b - self.c, "1 − a − b − c")
        self.center = as_center(center, self.a.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "PtLens":
        """Returns the lens with a = b = c = 0."""
        cls.count_terms(terms)
        return cls(0.0, 0.0, 0.0)

    def powers(self) -> Float[Array, " terms"]:
        """Returns 1 − a − b − c, c, b, a."""
        return jnp.stack([1 - self.a - self.b - self.c, self.c, self.b, self.a])
