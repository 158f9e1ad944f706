"""The division model of Eq. 5, of any order: the ideal radius is a quotient of the observed one."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int8

from jaxlens.lenses._lens import RadialLens, as_center
from jaxlens.lenses._quotient import Quotient
from jaxlens.lenses._registry import register
from jaxlens.lenses._wide_lens import Plane, WideLens, unit
from jaxlens.maps import Inverse, inverse_status
from jaxlens.numerics import as_floating, epsilon, jitted, join, polynomial
from jaxlens.polynomials import smallest_positive_root


@register("Division", short="division")
class Division(RadialLens, WideLens):
    """`x_u = c + (x_d − c) / (1 − k |x_d − c|²)` (Eq. 5, second form); with more terms, `1 − k1 r² − k2 r⁴ − …`.

    k > 0 is barrel, k < 0 pincushion: the observed radius is smaller, or larger, than the ideal one. For small |k| the
    lens is `RadialPolynomial([-k])`. COLMAP's SIMPLE_DIVISION and DIVISION have the other sign: their k is −k.

    The ray of an observed point is (x_d, y_d, 1 − k r²), which for k > 0 passes through a right angle from the axis,
    where the ideal point is infinite: `project` and `unproject` go on to where two points would have one ray.

    Attributes:
        k: The coefficient, a number: both directions are then in closed form. Or k1, k2, …, one or more.
        center: The centre of distortion c in normalized coordinates; the frame's origin unless given.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> jl.Division(0.75).undistort(jnp.array([1.0, 0.0])).tolist()
        [4.0, 0.0]
        >>> [round(float(x), 4) for x in jl.Division(2.0).unproject(jnp.array([1.0, 0.0]))]
        [0.7071, 0.0, -0.7071]
    """

    k: Float[Array, ""] | Float[Array, " terms"]
    term_counts: ClassVar[tuple[int, ...]] = (1, 2, 3, 4)

    def __init__(self, k: ArrayLike | list | tuple, *, center: ArrayLike | list | tuple | None = None):
        self.k = as_floating(k)
        if self.k.ndim > 1 or not self.k.size:
            raise ValueError(
                f"k must be a number, or a list of one or more, got shape {self.k.shape}; a batch of lenses is made by "
                "jax.vmap(Division)(k)"
            )
        self.center = as_center(center, self.k.dtype)

    @classmethod
    def identity(cls, *, terms: int | None = None) -> "Division":
        """Returns the lens with k = 0, a number for one term, as is usual, and a list of two to four zeros for more."""
        count = cls.count_terms(terms)
        return cls(0.0 if count == 1 else [0.0] * count)

    @property
    def needs_frame(self) -> bool:
        """False: the paper writes it in Eq. 10's frame."""
        return False

    def parameter_names(self, field: str, shape: tuple[int, ...]) -> list[str]:
        """Returns k, or k1, k2, … for several."""
        if field == "k" and shape:
            return [f"k{i + 1}" for i in range(*shape)]
        return super().parameter_names(field, shape)

    def factor(self, squared_radius: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns Φ = 2 / (1 + √(1 + 4 k r²)): Eq. 5 solved for x_d without cancellation; NaN beyond the fold.

        With more terms Eq. 5 is solved by iteration, as accurately.
        """
        if self.k.ndim:
            scale, seen = self._observed_scale(squared_radius, jnp.ones_like(squared_radius))
            return jnp.where(seen, scale, jnp.nan)
        discriminant = 1 + 4 * self.k * squared_radius
        seen = discriminant > 0
        root = jnp.sqrt(jnp.where(seen, discriminant, 1))
        # The fold itself, where the discriminant vanishes up to rounding, is still seen.
        at_fold = jnp.where(discriminant >= -4 * epsilon(discriminant.dtype), 2, jnp.nan)
        return jnp.where(seen, 2 / (1 + root), at_fold)

    def fold_radius(self) -> Float[Array, ""]:
        """Returns the largest radius that `undistort` reaches, 1 / (2 √−k) for a number k < 0; ∞ where it has none."""
        if self.k.ndim:
            fold, depth = self._observed_fold()
            folds = jnp.isfinite(fold) & (depth > 0)
            return jnp.where(folds, jnp.where(folds, fold, 1) / jnp.where(folds, depth, 1), jnp.inf)
        folds = self.k < 0
        return jnp.where(folds, 0.5 / jnp.sqrt(jnp.where(folds, -self.k, 1)), jnp.inf)

    def edge_radius(self) -> Float[Array, ""]:
        """Returns the largest observed radius of an ideal point, of the fold or, where none is, of points at infinity.

        For a number k it is 1 / √|k|.
        """
        if self.k.ndim:
            return jnp.minimum(self._observed_fold()[0], jnp.sqrt(smallest_positive_root(-self.k)))
        bounded = self.k != 0
        return jnp.where(bounded, 1 / jnp.sqrt(jnp.where(bounded, jnp.abs(self.k), 1)), jnp.inf)

    def ideal_scale(self, squared: Float[Array, "*batch"]) -> tuple[Float[Array, "*batch"], Int8[Array, "*batch"]]:
        """Returns the ratio of ideal to observed radius, and the status (see `RadialLens.ideal_scale`)."""
        # Eq. 5 itself. Where the ideal radius grows without bound towards the edge, a very distant point stands beyond.
        finite = squared <= jnp.finfo(squared.dtype).max
        squared = jnp.where(finite, squared, 0)
        if self.k.ndim:
            fold, edge = self.fold_radius(), self.edge_radius()
            folds, size = jnp.isfinite(fold), squared
            inside = jnp.where(folds, squared <= edge * edge, squared < edge * edge)
            depth = self._depth(jnp.where(inside, squared, 0))
        else:
            squared = self.k * squared
            fold, folds, size = 0.5, self.k <= 0, jnp.abs(squared)
            inside = jnp.where(self.k > 0, squared < 1, squared >= -1)
            depth = jnp.where(inside, 1 - squared, 1)
        smallest = epsilon(squared.dtype)
        scale = 1 / jnp.maximum(depth, smallest)
        on_the_fold = jnp.where(folds, fold, 1) / jnp.sqrt(jnp.where(inside, 1, size))
        scale = jnp.where(inside, scale, jnp.where(folds, on_the_fold, 1 / smallest))
        return scale, inverse_status(finite, inside, jnp.ones_like(inside))

    def observe(self, rays: Float[Array, "*batch 3"]) -> tuple[Float[Array, "*batch 2"], Bool[Array, "*batch"]]:
        """Returns the observed points of finite rays, finite everywhere, and which of the rays the lens sees."""
        x, y, z, some = unit(rays)
        x, y = x - self.center[0] * z, y - self.center[1] * z
        scale, seen = self._observed_scale(x * x + y * y, z)
        return self.scaled(x, y, scale), some & seen

    @jitted
    def invert_projection(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds the unit rays of observed points, in closed form (see `Lens.invert_projection`)."""
        x, y = self.offset(points)
        fold, depth_there = self._observed_fold()
        squared = x * x + y * y
        depth = self._depth(squared)
        finite = (squared < jnp.inf) & (jnp.abs(depth) < jnp.inf)
        squared = jnp.where(finite, squared, 0)
        inside = squared <= fold * fold
        shrunk = jnp.where(inside, 1, fold / jnp.sqrt(jnp.where(inside, 1, squared)))
        depth = jnp.where(inside, self._depth(squared), depth_there)
        x, y = jnp.where(finite, x, 0) * shrunk, jnp.where(finite, y, 0) * shrunk
        *ray, _ = unit(join(x + self.center[0] * depth, y + self.center[1] * depth, depth))
        return Inverse(join(*ray), finite & inside, inverse_status(finite, inside, jnp.ones_like(inside)))

    def field_of_view(self) -> Float[Array, ""]:
        """Returns the angle of the fold; π where there is none and k > 0, seen from c; π/2 for k = 0."""
        fold, depth = self._observed_fold()
        folds, away = jnp.isfinite(fold), jnp.hypot(*self.center)
        nearest = jnp.arctan2(jnp.maximum(jnp.where(folds, fold, 1) - away * depth, 0), depth)
        unbounded = jnp.where(jnp.any(self.k != 0), jnp.pi - jnp.arctan(away), jnp.pi / 2)
        return jnp.where(folds, nearest, unbounded)

    def _depth(self, squared: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """Returns 1 − k1 r² − k2 r⁴ − …, the z of the ray at squared observed radii."""
        return _Series(self.k).depth(squared) if self.k.ndim else 1 - squared * self.k

    def _observed_fold(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Returns the observed radius at which the ray stops turning away from the axis, ∞ if none, and its z."""
        if self.k.ndim:
            fold = _Series(self.k).fold_radius()
        else:
            folds = self.k < 0
            fold = jnp.where(folds, 1 / jnp.sqrt(jnp.where(folds, -self.k, 1)), jnp.inf)
        return fold, self._depth(jnp.where(jnp.isfinite(fold), fold, 0) ** 2)

    def _observed_scale(self, squared: Plane, z: Plane) -> tuple[Plane, Bool[Array, "*batch"]]:
        """Returns the ratio of x_d − c to (x, y) for rays (x, y, z) of any length, and whether the lens sees them.

        Args:
            squared: x² + y².
            z: z.
        """
        if self.k.ndim:
            return _Series(self.k).ratio(squared, z)
        # r = 2 R / (z + √(z² + 4 k R²)), without cancellation for z < 0 as well.
        product = 4 * self.k * squared
        discriminant = z * z + product
        ahead = z > 0
        seen = (discriminant >= -4 * epsilon(z.dtype) * z * z) & (ahead | (product > 0))
        positive = seen & (discriminant > 0)
        root = jnp.where(positive, jnp.sqrt(jnp.where(positive, discriminant, 1)), 0)
        behind = seen & ~ahead
        in_front = 2 / jnp.where(seen & ahead, z + root, 1)
        return jnp.where(behind, 2 * (root - z) / jnp.where(behind, product, 1), in_front), seen


class _Series(Quotient):
    k: Float[Array, " terms"]

    def depth(self, squared: Plane) -> Plane:
        return 1 - squared * polynomial(self.k, squared)

    @jitted
    def fold_radius(self) -> Float[Array, ""]:
        odd = 2 * jnp.arange(1, self.k.shape[0] + 1, dtype=self.k.dtype) - 1
        return jnp.sqrt(smallest_positive_root(odd * self.k))

    def limit(self) -> Float[Array, ""]:
        return jnp.where(jnp.any(self.k != 0), -jnp.inf, jnp.zeros((), self.k.dtype))
