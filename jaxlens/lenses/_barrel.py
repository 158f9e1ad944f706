"""ImageMagick's two lenses, `-distort Barrel` and `-distort BarrelInverse`."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int8

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._powers import PowersLens, check_scale, first_root, smooth_root
from jaxlens.lenses._quotient import Quotient
from jaxlens.lenses._registry import register
from jaxlens.maps import inverse_status
from jaxlens.numerics import as_parameters, epsilon, jitted, polynomial


def _numbers(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike | None) -> list[Float[Array, ""]]:
    if d is not None:
        return as_parameters(a=a, b=b, c=c, d=d)
    a, b, c = as_parameters(a=a, b=b, c=c)
    return [a, b, c, 1 - a - b - c]


class _FourNumbers(RadialLens):
    a: Float[Array, ""]
    b: Float[Array, ""]
    c: Float[Array, ""]
    d: Float[Array, ""]
    term_counts: ClassVar[tuple[int, ...]] = (4,)

    def powers(self) -> Float[Array, " terms"]:
        """Returns d, c, b, a."""
        return jnp.stack([self.d, self.c, self.b, self.a])


@register("Barrel", short="barrel")
class Barrel(_FourNumbers, PowersLens):
    """`r_d = r_u (a r³ + b r² + c r + d)` with r = r_u (ImageMagick's `-distort Barrel "a b c d"`).

    ImageMagick's output is the undistorted picture, and r the radius there, in units of half the shorter side, about
    the middle: `Frame(((w − 1) / 2, (h − 1) / 2), min(w, h) / 2)`. d is positive.

    Attributes:
        a: The coefficient of r³.
        b: The coefficient of r².
        c: The coefficient of r. Other than zero it has no second derivative at the centre: zero stands in for it.
        d: The scale at the centre; 1 − a − b − c unless given, as in ImageMagick: the radius one stays where it is.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> jl.Barrel(0.0, 0.5, 0.25).distort(np.array([0.5, 0.0])).tolist()
        [0.25, 0.0]
    """

    def __init__(
        self,
        a: ArrayLike,
        b: ArrayLike,
        c: ArrayLike,
        *,
        d: ArrayLike | None = None,
        center: ArrayLike | list | tuple | None = None,
    ):
        self.a, self.b, self.c, self.d = _numbers(a, b, c, d)
        check_scale(self, self.d, "d")
        self.center = as_center(center, self.a.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "Barrel":
        """Returns the lens with a = b = c = 0 and d = 1."""
        cls.count_terms(terms)
        return cls(0.0, 0.0, 0.0, d=1.0)


@register("BarrelInverse", short="barrel-inverse")
class BarrelInverse(_FourNumbers):
    """`r_d = r_u / (a r³ + b r² + c r + d)` with r = r_u (ImageMagick's `-distort BarrelInverse "a b c d"`).

    Not the inverse of `Barrel`: ImageMagick calls so what divides by the polynomial. The units are those of `Barrel`.

    Attributes:
        a: The coefficient of r³.
        b: The coefficient of r².
        c: The coefficient of r. Other than zero it has no second derivative at the centre: zero stands in for it.
        d: One over the scale at the centre; 1 − a − b − c unless given, as in ImageMagick.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jaxlens as jl, numpy as np
        >>> jl.BarrelInverse(0.0, 0.5, 0.25).distort(np.array([0.5, 0.0])).tolist()
        [1.0, 0.0]
    """

    def __init__(
        self,
        a: ArrayLike,
        b: ArrayLike,
        c: ArrayLike,
        *,
        d: ArrayLike | None = None,
        center: ArrayLike | list | tuple | None = None,
    ):
        self.a, self.b, self.c, self.d = _numbers(a, b, c, d)
        check_scale(self, self.d, "d")
        self.center = as_center(center, self.a.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "BarrelInverse":
        """Returns the lens with a = b = c = 0 and d = 1."""
        cls.count_terms(terms)
        return cls(0.0, 0.0, 0.0, d=1.0)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ = 1 / (a r³ + b r² + c r + d)."""
        return 1 / polynomial(self.powers(), smooth_root(squared_radius))

    @jitted
    def fold_radius(self) -> Float[Array, ""]:
        """Returns the first r where d − b r² − 2 a r³, or the polynomial itself, turns negative; ∞ if neither does."""
        return jnp.minimum(*self._ends())

    @jitted
    def edge_radius(self) -> Float[Array, ""]:
        """Returns the observed radius of the fold; ∞ where the polynomial vanishes first, 1 / c where nothing ends."""
        fold, pole = self._ends()
        folds, unending = fold < pole, jnp.isinf(fold) & jnp.isinf(pole)
        bounded = unending & (self.c > 0)
        limit = jnp.where(bounded, 1 / jnp.where(bounded, self.c, 1), jnp.inf)
        return jnp.where(folds, self.radius(jnp.where(folds, fold, 0)), limit)

    def _ends(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        return _Series(self.powers()).fold_radius(), first_root(self.powers())

    def ideal_scale(self, squared: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Int8[Array, "*batch"]]:
        """Returns the ratio of ideal to observed radius, and the status (see `RadialLens.ideal_scale`)."""
        finite = squared <= jnp.finfo(squared.dtype).max
        squared = jnp.where(finite, squared, 0)
        ratio, inside = _Series(self.powers() / self.d).ratio(squared * self.d**2, jnp.ones_like(squared))
        scale = ratio * self.d
        # A point beyond the edge goes to the fold on its own ray, or far away where there is none.
        end = jnp.minimum(self.fold_radius(), 1 / epsilon(squared.dtype))
        beyond = end / jnp.sqrt(jnp.where(inside, 1, squared))
        return jnp.where(inside, scale, beyond), inverse_status(finite, inside, jnp.ones_like(inside))


class _Series(Quotient):
    powers: Float[Array, " terms"]

    def depth(self, squared: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        return polynomial(self.powers, smooth_root(squared))

    def fold_radius(self) -> Float[Array, ""]:
        return first_root(self.powers * (1 - jnp.arange(self.powers.shape[0], dtype=self.powers.dtype)))

    def limit(self) -> Float[Array, ""]:
        return jnp.where(jnp.any(self.powers[2:] != 0), -jnp.inf, self.powers[1])
