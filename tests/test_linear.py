"""Small systems are written out, large ones go to LAPACK; both are NumPy's, and one rule says what is singular."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlens.linear import invert_definite, solve_cholesky, solve_definite, squares_rounding

SIZES = [1, 5, 8, 9]


def _definite(size, batch=3):
    random = np.random.default_rng(size)
    tall, right = random.normal(size=(batch, 20, size)), random.normal(size=(batch, size, 2))
    return np.swapaxes(tall, 1, 2) @ tall, right


@pytest.mark.parametrize("size", SIZES)
def test_solutions_are_numpy_s(x64, size):
    matrix, right = _definite(size)
    expected = np.linalg.solve(matrix, right)
    found, pivots = solve_cholesky(jnp.asarray(matrix), jnp.asarray(right))
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    diagonals = np.diagonal(np.linalg.cholesky(matrix), axis1=1, axis2=2)
    np.testing.assert_allclose(pivots, diagonals**2, rtol=1e-11)
    np.testing.assert_allclose(solve_definite(jnp.asarray(matrix), jnp.asarray(right)), expected, rtol=1e-11)


@pytest.mark.parametrize("size", SIZES)
def test_inverses_are_numpy_s_whatever_the_units(x64, size):
    matrix = _definite(size)[0]
    units = 10.0 ** np.linspace(-60, 60, size)
    found = invert_definite(jnp.asarray(matrix * units[:, None] * units[None]))
    expected = np.linalg.inv(matrix)
    inverse = np.asarray(found.inverse) * units[:, None] * units[None]
    np.testing.assert_allclose(inverse, expected, rtol=1e-11, atol=1e-14)
    inflation = np.diagonal(expected, axis1=1, axis2=2) * np.diagonal(matrix, axis1=1, axis2=2)
    np.testing.assert_allclose(found.inflation, inflation, rtol=1e-11)
    assert found.regular.all()


@pytest.mark.parametrize("size", [3, 9])
def test_no_solution_where_the_matrix_is_not_positive_definite(x64, size):
    matrix = jnp.diag(jnp.ones(size).at[1].set(-1.0))
    assert np.isnan(solve_cholesky(matrix, jnp.ones((size, 1)))[0]).any()
    assert np.isnan(solve_definite(matrix, jnp.ones((size, 1)))).all()
    found = invert_definite(matrix)
    assert np.isnan(found.inverse).all()
    assert np.isinf(found.inflation).all()
    assert not found.regular


@pytest.mark.parametrize("size", [3, 9])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_rule_is_the_squared_pivot_against_the_size_times_rounding(x64, size, dtype):
    """A column of which all but a little is the one before it: what is left squared is its last pivot."""
    for rounding in (None, squares_rounding(dtype)):
        limit = size * (np.finfo(dtype).eps if rounding is None else rounding)
        for share, regular in ((2.0, True), (0.25, False)):
            matrix = np.eye(size)
            matrix[-1, -2] = matrix[-2, -1] = 1 - 0.5 * share * limit
            matrix = jnp.asarray(matrix, dtype)
            assert bool(invert_definite(matrix, rounding=rounding).regular) == regular
            solution = solve_definite(matrix, jnp.ones((size, 1), dtype), rounding=rounding)
            assert np.isfinite(solution).all() == regular


def test_what_elimination_has_left_is_compared_with_what_was_there(x64):
    matrix = jnp.diag(jnp.asarray([1.0, 1e-15]))
    assert bool(invert_definite(matrix).regular)
    assert not bool(invert_definite(matrix, diagonal=jnp.ones(2), rounding=1e-12).regular)


@pytest.mark.parametrize("size", [3, 9])
def test_derivatives_are_finite_where_there_is_no_inverse(x64, size):
    def total(matrix):
        found = invert_definite(matrix)
        return jnp.sum(jnp.where(found.regular, found.inverse, 0))

    for matrix in (jnp.zeros((size, size)), jnp.ones((size, size)), jnp.full((size, size), jnp.nan)):
        np.testing.assert_array_equal(jax.grad(total)(matrix), jnp.zeros((size, size)))
