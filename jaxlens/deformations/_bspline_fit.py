"""A B-spline field through scattered correspondences, as smooth as they allow."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from jaxlens.deformations._arguments import as_correspondences
from jaxlens.deformations._bspline import BSplineField, energy_terms
from jaxlens.interpolation import kernel_weights
from jaxlens.linear import solve_definite
from jaxlens.numerics import epsilon, is_concrete, split

# A variance, in units in the last place of one, that is no more than rounding.
_ROUNDING_ULPS = 16.0


def fit_bspline_field(
    source: Float[ArrayLike, "points 2"],
    target: Float[ArrayLike, "points 2"],
    *,
    cells: tuple[int, int],
    lower: ArrayLike | list | tuple,
    upper: ArrayLike | list | tuple,
    penalty: Float[ArrayLike, ""],
    weights: Float[ArrayLike, " points"] | None = None,
) -> BSplineField:
    """Finds the B-spline field that takes source to target points, by penalized least squares.

    It minimizes the weighted mean of `|source + d(source) − target|²`, plus `penalty` times the bending energy of d:
    the mean over the rectangle of |d_xx|² + 2 |d_xy|² + |d_yy|² (that of a thin plate;
    `BSplineField.bending_energy`). Both are means: the penalty means the same whatever the number of points and of
    cells. Solved directly, in time and memory that grow with the cube and the square of (nx + 3)(ny + 3): some 40 ×
    40 cells.

    Args:
        source: `(N, 2)` points, (x, y) order; one outside the rectangle counts at the nearest point of its border.
        target: `(N, 2)`, where they are to go.
        cells: nx and ny, the number of cells along x and y.
        lower: (x_min, y_min) of the rectangle.
        upper: (x_max, y_max).
        penalty: Above 0, in units of length to the fourth power: with points everywhere, waves in the displacement
            that are shorter than 2π penalty^(1/4) are smoothed away, longer ones kept.
        weights: `(N,)`, relative weights of the points, ones by default. Points of weight zero do not count, and may be
            NaN.

    Returns:
        The field, in the widest dtype of the data. Differentiable with respect to points, weights, penalty and
        rectangle. Under `jax.jit` and `jax.vmap`, where nothing can be raised, its coefficients are NaN if the data
        do not determine it.

    Raises:
        ValueError: shapes that do not fit, points that are not finite, a penalty that is not positive, or data that
            leave the field undetermined: points on one line, or a penalty so small that rounding drowns it.

    Example:
        >>> import jax, jax.numpy as jnp, jaxlens as jl
        >>> source = jax.random.uniform(jax.random.key(0), (200, 2))
        >>> target = source + 0.1 * jnp.sin(3 * source[:, ::-1])
        >>> field = jl.deformations.fit_bspline_field(
        ...     source, target, cells=(4, 4), lower=(0, 0), upper=(1, 1), penalty=1e-5
        ... )
        >>> bool(jnp.max(jnp.abs(field(source) - target)) < 1e-2)
        True
    """
    source, target, weights = as_correspondences(source, target, weights)
    if min(cells) < 1:
        raise ValueError(f"cells must be two numbers of one or more, along x and y, got {cells}")
    if is_concrete(penalty) and not 0 < float(np.asarray(penalty)) < np.inf:
        raise ValueError(f"penalty must be a finite number above 0, got {penalty}")
    zero = jnp.zeros((cells[0] + 3, cells[1] + 3, 2), jnp.result_type(source, target, weights))
    field = _fit(BSplineField(zero, lower, upper), source, target, weights, penalty)
    if is_concrete(field) and not np.isfinite(np.asarray(field.coefficients)).all():
        raise ValueError(
            f"the points do not determine a field of {cells[0]} × {cells[1]} cells with penalty {penalty}: at least "
            "three are needed that do not lie on one line; if there are, raise the penalty, or take double precision"
        )
    return field


@jax.jit
def _fit(field: BSplineField, source: Array, target: Array, weights: Array, penalty: Array) -> BSplineField:
    dtype = field.coefficients.dtype
    source, target, weights = (values.astype(dtype) for values in (source, target, weights))
    used = weights > 0
    weights = jnp.where(used, weights, 0) / jnp.sum(weights)
    source, target = jnp.where(used[:, None], source, 0), jnp.where(used[:, None], target, 0)
    count = field.coefficients.shape[1]
    # At the far borders a position is the last of a cell.
    positions = list(zip(field.positions(source), field.cells, strict=True))
    column, row = (jnp.minimum(jnp.floor(p).astype(jnp.int32), cells - 1) for p, cells in positions)
    across, down = (kernel_weights("cubic_b_spline", 0, p - jnp.minimum(jnp.floor(p), n - 1)) for p, n in positions)
    taps = range(4)
    index = jnp.stack([(column + i) * count + row + j for i in taps for j in taps], axis=-1)
    basis = jnp.stack([across[i] * down[j] for i in taps for j in taps], axis=-1)

    size = field.coefficients.shape[0] * count
    data = jnp.zeros((size, size), dtype)
    data = data.at[index[:, :, None], index[:, None, :]].add(
        weights[:, None, None] * basis[:, :, None] * basis[:, None, :]
    )
    right = (
        jnp.zeros((size, 2), dtype)
        .at[index]
        .add((weights[:, None] * basis)[:, :, None] * (target - source)[:, None, :])
    )
    terms = energy_terms(field.cells, (field.upper - field.lower).astype(dtype))
    energy = jnp.sum(jnp.stack([jnp.kron(along_x, along_y) for along_x, along_y in terms]), axis=0)
    solution = solve_definite(data + jnp.asarray(penalty, dtype) * energy, right)
    spread = _spread(*lax.stop_gradient((field, source, weights)))
    solution = jnp.where(spread > _ROUNDING_ULPS * epsilon(dtype), solution, jnp.nan)
    return BSplineField(solution.reshape(field.coefficients.shape), field.lower, field.upper)


def _spread(field: BSplineField, source: Array, weights: Array) -> Float[Array, ""]:
    """Returns the least variance of points along any direction, in units of the rectangle: it decides an affine field.

    These fields do not bend: of them, the data alone must tell.
    """
    x, y = (
        (jnp.clip(values, low, high) - low) / (high - low)
        for values, low, high in zip(split(source), field.lower, field.upper, strict=True)
    )
    x, y = x - jnp.sum(weights * x), y - jnp.sum(weights * y)
    xx, xy, yy = (jnp.sum(weights * product) for product in (x * x, x * y, y * y))
    return 0.5 * (xx + yy - jnp.sqrt((xx - yy) ** 2 + 4 * xy**2))
