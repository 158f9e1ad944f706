"""Free-form deformation of a rectangle (Eqs. 3 and 4)."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from jaxlens.deformations._arguments import as_rectangle, as_weights
from jaxlens.deformations._bernstein import Cube, frozen_rows, preimages, unit_lattice
from jaxlens.maps import CoordinateMap, Inverse, InverseStatus, inverse_status
from jaxlens.numerics import as_floating, as_points, jitted, join, split

Side = Literal["left", "right", "top", "bottom"]
"""A side of a rectangle, y downwards: `top` is at the smallest y."""

_SIDES: tuple[Side, ...] = ("left", "right", "top", "bottom")


class FreeForm(CoordinateMap):
    """Free-form deformation: a rectangle dragged by a lattice of control points (Eqs. 3, 4; Sederberg and Parry 1986).

    A point's coordinates in the rectangle, `s = (x − x_min) / (x_max − x_min)` and t alike, weight the control points
    by a rational tensor product of Bernstein polynomials: `X(s, t) = Σ Bᵢᵐ(s) Bⱼⁿ(t) w_ij P_ij / Σ Bᵢᵐ(s) Bⱼⁿ(t)
    w_ij`. Points outside the rectangle are not moved; its border belongs to it. A lattice left regular, with weights
    that are all equal, is the identity.

    Across the border the map is continuous only where the border's control points are left in place, and smooth only
    where the rows behind them are, too: see `freeze`. Nor need the rectangle be mapped onto itself: what is dragged
    over the border covers points that do not move, and what is drawn in leaves a gap that nothing is mapped to.
    `one_to_one` is about the neighbourhood of a point: it does not see the first, and a lattice that mirrors is
    one-to-one nowhere.

    Attributes:
        control_points: `(m + 1, n + 1, 2)`: [i, j] is the (x, y) of the control point in column i (along x) and row j
            (along y), for degrees m and n of one or more.
        weights: `(m + 1, n + 1)`, positive: the larger, the more a control point attracts. None are equal ones,
            which is faster; a common factor has no effect.
        lower: (x_min, y_min) of the rectangle.
        upper: (x_max, y_max).

    Raises:
        ValueError: shapes that do not fit, weights that are not positive, an empty rectangle.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> still = jl.deformations.FreeForm.identity(2, 2)
        >>> pulled = jl.deformations.FreeForm(still.control_points.at[1, 1].add(jnp.array([0.2, 0.0])))
        >>> pulled(jnp.array([[0.5, 0.5], [0.0, 0.5], [7.0, 8.0]])).round(2).tolist()
        [[0.550000011920929, 0.5], [0.0, 0.5], [7.0, 8.0]]
    """

    control_points: Float[Array, "columns rows 2"]
    weights: Float[Array, "columns rows"] | None
    lower: Float[Array, "2"]
    upper: Float[Array, "2"]

    def __init__(
        self,
        control_points: ArrayLike | list | tuple,
        *,
        weights: ArrayLike | list | tuple | None = None,
        lower: ArrayLike | list | tuple = (0.0, 0.0),
        upper: ArrayLike | list | tuple = (1.0, 1.0),
    ):
        self.control_points = as_floating(control_points)
        shape = self.control_points.shape
        if len(shape) != 3 or shape[-1] != 2 or min(shape[:-1]) < 2:
            raise ValueError(
                "control_points must have shape (m + 1, n + 1, 2) for degrees m and n of one or more, got "
                f"{shape}; a batch of deformations is made by jax.vmap(FreeForm)(control_points)"
            )
        self.weights = as_weights(weights, shape[:-1], self.control_points.dtype)
        self.lower, self.upper = as_rectangle(lower, upper, self.control_points.dtype)

    @classmethod
    def identity(
        cls,
        m: int,
        n: int,
        *,
        lower: ArrayLike | list | tuple = (0.0, 0.0),
        upper: ArrayLike | list | tuple = (1.0, 1.0),
    ) -> "FreeForm":
        """Returns the deformation that moves nothing: a regular lattice of degrees m along x and n along y."""
        dtype = jnp.result_type(*(as_floating(corner) for corner in (lower, upper)))
        lower, upper = as_rectangle(lower, upper, dtype)
        return cls(_lattice((m + 1, n + 1), lower, upper), lower=lower, upper=upper)

    @jitted
    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Moves the points `(..., 2)` that lie in the rectangle."""
        x, y = split(as_points(points))
        inside = self.contains(join(x, y))
        # A point that does not count stands in a corner, where derivatives are finite.
        local = self._local(join(jnp.where(inside, x, self.lower[0]), jnp.where(inside, y, self.lower[1])))
        along_x, along_y = split(self._cube().displacement(local))
        width, height = self.upper - self.lower
        return join(x + jnp.where(inside, along_x * width, 0), y + jnp.where(inside, along_y * height, 0))

    def contains(self, points: Float[ArrayLike, "*batch 2"]) -> Bool[Array, "*batch"]:
        """Tells whether points lie in the rectangle, its border included."""
        x, y = split(as_points(points))
        (left, top), (right, bottom) = self.lower, self.upper
        return (left <= x) & (x <= right) & (top <= y) & (y <= bottom)

    @jitted
    def invert(self, points: Float[ArrayLike, "*batch 2"]) -> Inverse:
        """Finds what is moved to points: a point of the rectangle, or the point itself if it lies outside and stays.

        Newton's iteration for the deformation, continued beyond the rectangle; a root outside it does not count.

        Args:
            points: `(..., 2)`.

        Returns:
            An `Inverse`. Valid are points of the rectangle's image and points outside the rectangle; where a point is
            both, the preimage is the one in the rectangle. Where the lattice folds, one of the preimages at which it
            keeps orientation. In a gap at the border, the nearest thing is a point of the border. Derivatives as of
            `CoordinateMap.invert`.
        """
        points = as_points(points)
        finite = jnp.all(jnp.isfinite(points), axis=-1)
        points = jnp.where(finite[..., None], points, 0)
        target = self._local(points)
        local, found, gave_up = preimages(self._cube(), target)
        unmoved = ~found & ~self.contains(points)
        # As a displacement of the target, so that what does not move comes back to the last bit.
        x, y = split(points)
        along_x, along_y = split(jnp.where(unmoved[..., None], 0, local - target))
        width, height = self.upper - self.lower
        valid = found | unmoved
        status = inverse_status(finite, valid | gave_up, valid)
        return Inverse(join(x + along_x * width, y + along_y * height), status == InverseStatus.CONVERGED, status)

    def adjustable(self) -> PyTree:
        """Returns the control points: not the rectangle, and not the weights, of which a common factor has no effect.

        To fit a frozen deformation, make those of `frozen(…)` false.
        """
        fixed = jax.tree.map(lambda _: False, self)
        return eqx.tree_at(lambda deformation: deformation.control_points, fixed, True)

    def frozen(self, continuity: int, *, sides: Sequence[Side] = _SIDES) -> Bool[np.ndarray, "columns rows"]:
        """Returns which control points `freeze` puts back: the outermost `continuity + 1` rows of each side.

        Raises:
            ValueError: an order below zero, an unknown side, or no control point left free.
        """
        return frozen_rows(self.control_points.shape[:-1], continuity, sides, _SIDES)

    def freeze(self, continuity: int, *, sides: Sequence[Side] = _SIDES) -> "FreeForm":
        """Returns the deformation that joins what does not move smoothly: outer rows of its lattice are put back.

        Args:
            continuity: The order k of the highest derivative that is to be continuous across the border: 0 for
                continuity alone. The outermost k + 1 rows return to the regular lattice, with weight one.
            sides: The sides of the rectangle across which it is to be continuous.

        Raises:
            ValueError: an order below zero, an unknown side, or degrees that would leave no control point free: two
                opposite sides need a degree of at least 2 k + 2.
        """
        frozen = jnp.asarray(self.frozen(continuity, sides=sides))
        lattice = _lattice(frozen.shape, self.lower, self.upper)
        control_points = jnp.where(frozen[..., None], lattice, self.control_points)
        weights = None if self.weights is None else jnp.where(frozen, 1, self.weights)
        return FreeForm(control_points, weights=weights, lower=self.lower, upper=self.upper)

    def _local(self, points: Float[Array, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Coordinates s and t of points in the rectangle (Eq. 3)."""
        x, y = split(points)
        width, height = self.upper - self.lower
        return join((x - self.lower[0]) / width, (y - self.lower[1]) / height)

    def _cube(self) -> Cube:
        lattice = _lattice(self.control_points.shape[:-1], self.lower, self.upper)
        return Cube((self.control_points - lattice) / (self.upper - self.lower)[None, None], self.weights)


def _lattice(shape: Sequence[int], lower: Array, upper: Array) -> Float[Array, "columns rows 2"]:
    unit = unit_lattice(shape, jnp.result_type(lower, upper))
    # At both ends exactly the corner.
    return lower[None, None] * (1 - unit) + upper[None, None] * unit
