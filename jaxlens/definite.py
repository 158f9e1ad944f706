"""Systems of equations with a positive definite matrix, small ones without a call to LAPACK."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

# Unknowns up to which a system is solved by written-out arithmetic. It fuses, also over a batch, where a call for each
# matrix of the batch costs more than the arithmetic does; the operations grow as the cube.
_SMALL = 8


def solve_definite(
    matrix: Float[Array, "*batch size size"], right: Float[Array, "*batch size columns"]
) -> Float[Array, "*batch size columns"]:
    """Solves `matrix @ x = right` by Cholesky's decomposition; NaN where the matrix is not positive definite."""
    if matrix.shape[-1] <= _SMALL:
        return _written_out(matrix, right)
    factor = lax.linalg.cholesky(matrix, symmetrize_input=False)
    half = lax.linalg.triangular_solve(factor, right, left_side=True, lower=True)
    return lax.linalg.triangular_solve(factor, half, left_side=True, lower=True, transpose_a=True)


def _written_out(matrix: Array, right: Array) -> Array:
    size = matrix.shape[-1]
    factor: list[list[Array]] = []  # rows of the lower triangle, over their diagonals'
    scales: list[Array] = []  # reciprocals of the diagonal
    for i in range(size):
        row: list[Array] = []
        for j in range(i):
            row.append((matrix[..., i, j] - _dot(row, factor[j])) * scales[j])
        scales.append(lax.rsqrt(matrix[..., i, i] - _dot(row, row)))
        factor.append(row)
    solution: list[Array] = []
    for i in range(size):
        known = _dot([value[..., None] for value in factor[i]], solution)
        solution.append((right[..., i, :] - known) * scales[i][..., None])
    for i in reversed(range(size)):
        below = [factor[k][i][..., None] for k in range(i + 1, size)]
        solution[i] = (solution[i] - _dot(below, solution[i + 1 :])) * scales[i][..., None]
    return jnp.stack(solution, axis=-2)


def _dot(a: list[Array], b: list[Array]) -> Array | float:
    total = 0.0
    for one, other in zip(a, b, strict=False):
        total = total + one * other
    return total
