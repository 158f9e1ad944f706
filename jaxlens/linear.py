"""Small regular systems: equations with a positive definite matrix, and the rule for what is singular to rounding.

The rule: of the matrix, scaled to a diagonal of ones, each squared pivot of Cholesky's decomposition tells what is left
of a column when those before it are taken out of it. The matrix is singular to rounding unless the smallest exceeds
`size × rounding`, where `rounding` says how exact the entries are.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, DTypeLike, Float

from jaxlens.numerics import epsilon

# Unknowns up to which a system is solved by written-out arithmetic. It fuses, also over a batch, where a call for each
# matrix of the batch costs more than the arithmetic does; the operations grow as the cube.
_SMALL = 8


class DefiniteInverse(NamedTuple):
    """The inverse of a positive definite matrix, and what it says about its columns.

    Attributes:
        inverse: The inverse; NaN where the matrix is singular to rounding.
        inflation: For each column how many times the others' being unknown inflates its variance: the diagonal of
            the inverse of the scaled matrix; ∞ where that is singular to rounding.
        regular: Whether the matrix is regular by the rule.
    """

    inverse: Float[Array, "*batch size size"]
    inflation: Float[Array, "*batch size"]
    regular: Bool[Array, "*batch"]


def squares_rounding(dtype: DTypeLike) -> float:
    """Returns how exact sums of many products are, as those of normal equations: to three quarters of the digits."""
    return epsilon(dtype) ** 0.75


def solve_definite(
    matrix: Float[Array, "*batch size size"],
    right: Float[Array, "*batch size columns"],
    *,
    rounding: float | None = None,
) -> Float[Array, "*batch size columns"]:
    """Solves `matrix @ x = right` by Cholesky's decomposition; NaN where the matrix is singular to rounding.

    Args:
        matrix: Symmetric; the lower triangle is read.
        right: The right-hand sides, one a column.
        rounding: How exact the entries are, relative to the diagonal; the dtype's epsilon unless given.
    """
    scale, scaled = _scaled(matrix, jnp.diagonal(matrix, axis1=-2, axis2=-1))
    solution, pivots = solve_cholesky(scaled, right * scale[..., None])
    regular = _regular(pivots, rounding)
    return jnp.where(regular[..., None, None], solution * scale[..., None], jnp.nan)


def invert_definite(
    matrix: Float[Array, "*batch size size"],
    *,
    diagonal: Float[Array, "*batch size"] | None = None,
    rounding: float | None = None,
) -> DefiniteInverse:
    """Returns the inverse of a positive definite matrix. Derivatives are finite where it is singular, too.

    Args:
        matrix: Symmetric; the lower triangle is read.
        diagonal: What is scaled to one in place of the matrix's own diagonal: of a Schur complement, that of the matrix
            from which something has been eliminated, since this may have left nothing but rounding.
        rounding: As in `solve_definite`.
    """
    scale, scaled = _scaled(matrix, jnp.diagonal(matrix, axis1=-2, axis2=-1) if diagonal is None else diagonal)
    one = jnp.broadcast_to(jnp.eye(matrix.shape[-1], dtype=matrix.dtype), matrix.shape)
    finite = jnp.all(jnp.isfinite(scaled), axis=(-2, -1))
    scaled = jnp.where(finite[..., None, None], scaled, one)
    regular = finite & _regular(solve_cholesky(lax.stop_gradient(scaled), one[..., :0])[1], rounding)
    inverse, _ = solve_cholesky(jnp.where(regular[..., None, None], scaled, one), one)
    inflation = jnp.where(regular[..., None], jnp.diagonal(inverse, axis1=-2, axis2=-1), jnp.inf)
    inverse = inverse * scale[..., :, None] * scale[..., None, :]
    return DefiniteInverse(jnp.where(regular[..., None, None], inverse, jnp.nan), inflation, regular)


def solve_cholesky(
    matrix: Float[Array, "*batch size size"], right: Float[Array, "*batch size columns"]
) -> tuple[Float[Array, "*batch size columns"], Float[Array, "*batch size"]]:
    """Solves `matrix @ x = right` as it is, for matrices that are scaled already and damped.

    Returns:
        The solution, and the squared pivots; NaN where the matrix is not positive definite.
    """
    if matrix.shape[-1] <= _SMALL:
        return _written_out(matrix, right)
    factor = lax.linalg.cholesky(matrix, symmetrize_input=False)
    half = lax.linalg.triangular_solve(factor, right, left_side=True, lower=True)
    whole = lax.linalg.triangular_solve(factor, half, left_side=True, lower=True, transpose_a=True)
    return whole, jnp.diagonal(factor, axis1=-2, axis2=-1) ** 2


def _scaled(matrix: Array, diagonal: Array) -> tuple[Array, Array]:
    """Returns what scales a diagonal to ones from both sides, and the matrix scaled by it; a zero column stays."""
    scale = jnp.where(diagonal > 0, lax.rsqrt(jnp.where(diagonal > 0, diagonal, 1)), 0)
    return scale, matrix * scale[..., :, None] * scale[..., None, :]


def _regular(pivots: Array, rounding: float | None) -> Array:
    size, least = pivots.shape[-1], epsilon(pivots.dtype) if rounding is None else rounding
    return jnp.all(pivots > size * least, axis=-1)


def _written_out(matrix: Array, right: Array) -> tuple[Array, Array]:
    size = matrix.shape[-1]
    factor: list[list[Array]] = []  # rows of the lower triangle, over their diagonals'
    scales: list[Array] = []  # reciprocals of the diagonal
    pivots: list[Array] = []  # its squares
    for i in range(size):
        row: list[Array] = []
        for j in range(i):
            row.append((matrix[..., i, j] - _dot(row, factor[j])) * scales[j])
        pivots.append(matrix[..., i, i] - _dot(row, row))
        scales.append(lax.rsqrt(pivots[i]))
        factor.append(row)
    solution: list[Array] = []
    for i in range(size):
        known = _dot([value[..., None] for value in factor[i]], solution)
        solution.append((right[..., i, :] - known) * scales[i][..., None])
    for i in reversed(range(size)):
        below = [factor[k][i][..., None] for k in range(i + 1, size)]
        solution[i] = (solution[i] - _dot(below, solution[i + 1 :])) * scales[i][..., None]
    return jnp.stack(solution, axis=-2), jnp.stack(pivots, axis=-1)


def _dot(a: list[Array], b: list[Array]) -> Array | float:
    total = 0.0
    for one, other in zip(a, b, strict=False):
        total = total + one * other
    return total
