"""Fields of uniform cubic B-splines (section 2.3): displacements with local control and two continuous derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from jaxlens.deformations._arguments import as_rectangle
from jaxlens.interpolation import KERNELS, interpolated
from jaxlens.maps import CoordinateMap
from jaxlens.numerics import as_floating, as_points, jitted, join, split

_KERNEL = "cubic_b_spline"


class BSplineField(CoordinateMap):
    """A field of displacements, a linear sum of weighted and shifted cubic B-splines: `p + Σ β(u − i) β(v − j) c_ij`.

    The rectangle is divided into nx × ny equal cells. u and v are a point's coordinates in it, in cells: 0 and nx at
    its left and right. Coefficient [i, j] weighs the B-spline whose peak is at u = i − 1, v = j − 1: coefficients
    reach one cell beyond the rectangle on every side. They are *displacements*, not positions, and not interpolated:
    zero is the identity, and equal coefficients are a translation by them.

    Beyond the rectangle a point is displaced as the nearest point of the border is: the field is continuous
    everywhere, and twice continuously differentiable off the border.

    Attributes:
        coefficients: `(nx + 3, ny + 3, 2)`: [i, j] is the displacement (x, y) of column i (along x) and row j
            (along y), in the units of the points.
        lower: (x_min, y_min) of the rectangle.
        upper: (x_max, y_max).

    Raises:
        ValueError: shapes that do not fit, an empty rectangle.

    Example:
        >>> import jax.numpy as jnp, jaxlens as jl
        >>> field = jl.deformations.BSplineField(jnp.zeros((7, 6, 2)).at[3, 2].set(9.0), (0, 0), (40, 30))
        >>> field(jnp.array([[20.0, 10.0], [0.0, 0.0]])).tolist()
        [[24.0, 14.0], [0.0, 0.0]]
    """

    coefficients: Float[Array, "columns rows 2"]
    lower: Float[Array, "2"]
    upper: Float[Array, "2"]

    def __init__(
        self,
        coefficients: ArrayLike | list | tuple,
        lower: ArrayLike | list | tuple,
        upper: ArrayLike | list | tuple,
    ):
        self.coefficients = as_floating(coefficients)
        shape = self.coefficients.shape
        if len(shape) != 3 or shape[-1] != 2 or min(shape[:-1]) < 4:
            raise ValueError(
                "coefficients must have shape (nx + 3, ny + 3, 2) for one cell or more along x and y, got "
                f"{shape}; a batch of fields is made by jax.vmap(BSplineField, (0, None, None))"
            )
        self.lower, self.upper = as_rectangle(lower, upper, self.coefficients.dtype)

    @property
    def cells(self) -> tuple[int, int]:
        """The number of cells along x and y."""
        return self.coefficients.shape[0] - 3, self.coefficients.shape[1] - 3

    @jitted
    def __call__(self, points: Float[ArrayLike, "*batch 2"]) -> Float[Array, "*batch 2"]:
        """Displaces points `(..., 2)`."""
        x, y = split(as_points(points))
        u, v = self.positions(join(x, y))
        # At the far borders a position is the first of a cell that there is not, whose last weight is zero. A plane of
        # each component: sums of pairs are not vectorized.
        along_x, along_y = (
            interpolated(plane, u, v, jnp.zeros((), u.dtype), kernel=_KERNEL, border=None, dtype=u.dtype)
            for plane in split(jnp.swapaxes(jnp.pad(self.coefficients, ((0, 1), (0, 1), (0, 0))), 0, 1))
        )
        return join(x + along_x, y + along_y)

    def positions(self, points: Float[Array, "*batch 2"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Returns where points lie along x and y, in cells; those beyond the rectangle on its border.

        The coefficients that a point reads are the four from the floor of each on.
        """
        shares = [(p - low) / (high - low) for p, low, high in zip(split(points), self.lower, self.upper, strict=True)]
        x, y = (_within(share * count, count) for share, count in zip(shares, self.cells, strict=True))
        return x, y

    def adjustable(self) -> PyTree:
        """Returns the coefficients, and not the rectangle."""
        fixed = jax.tree.map(lambda _: False, self)
        return eqx.tree_at(lambda field: field.coefficients, fixed, True)

    def refine(self) -> "BSplineField":
        """Returns the same map on twice as many cells along x and y: knots inserted midway (masks 4 4, 1 6 1)."""
        fine = _refine(jnp.swapaxes(_refine(self.coefficients), 0, 1))
        return BSplineField(jnp.swapaxes(fine, 0, 1), self.lower, self.upper)

    def bending_energy(self) -> Float[Array, ""]:
        """Returns the mean over the rectangle of |d_xx|² + 2 |d_xy|² + |d_yy|² of the displacement d, exactly.

        In the units of a displacement, squared, over those of a length, to the fourth power. Zero for affine fields
        only.
        """
        total = jnp.zeros((), self.coefficients.dtype)
        for along_x, along_y in energy_terms(self.cells, self.upper - self.lower):
            total += jnp.einsum("ik,jl,ijc,klc->", along_x, along_y, self.coefficients, self.coefficients)
        return total


def _within(position: Float[Array, "*batch"], count: int) -> Float[Array, "*batch"]:
    # Comparisons that are false for NaN, and that leave the border its derivative from the inside.
    position = jnp.where(position >= 0, position, 0)
    return jnp.where(position <= count, position, count)


def _refine(coefficients: Float[Array, " count *rest"]) -> Float[Array, " refined *rest"]:
    """Halves the cells along the first axis."""
    middles = 0.5 * (coefficients[:-1] + coefficients[1:])
    knots = 0.5 * (coefficients[1:-1] + 0.5 * (middles[:-1] + middles[1:]))
    pairs = jnp.stack([middles[:-1], knots], axis=1).reshape(-1, *coefficients.shape[1:])
    return jnp.concatenate([pairs, middles[-1:]])


def energy_terms(
    cells: tuple[int, int], size: Float[Array, "2"]
) -> list[tuple[Float[Array, "columns columns"], Float[Array, "rows rows"]]]:
    """Returns the bending energy as a quadratic form of coefficients: pairs of matrices along x and y, to be summed."""
    width, height = size[0] / cells[0], size[1] / cells[1]
    x, y = ([jnp.asarray(_products(count, order), size.dtype) / count for order in range(3)] for count in cells)
    return [
        (x[2] / width**4, y[0]),
        (2 * x[1] / width**2, y[1] / height**2),
        (x[0], y[2] / height**4),
    ]


def _products(count: int, order: int) -> Float[np.ndarray, "terms terms"]:
    """Returns ∫ β⁽ᵒ⁾(u − i) β⁽ᵒ⁾(u − j) du over `count` cells, exactly: polynomials are integrated cell by cell."""
    pieces = np.array([np.polynomial.polynomial.polyder(piece, order) for piece in KERNELS[_KERNEL]])
    powers = np.arange(pieces.shape[1])
    element = pieces @ (1 / (powers[:, None] + powers[None] + 1)) @ pieces.T
    total = np.zeros((count + 3, count + 3))
    for cell in range(count):
        total[cell : cell + 4, cell : cell + 4] += element
    return total
