"""Small systems are written out, large ones go to LAPACK; both are NumPy's."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlens.definite import solve_definite


@pytest.mark.parametrize("size", [1, 5, 8, 9])
def test_solutions_are_numpy_s(x64, size):
    random = np.random.default_rng(size)
    tall, right = random.normal(size=(3, 20, size)), random.normal(size=(3, size, 2))
    matrix = np.swapaxes(tall, 1, 2) @ tall
    found = solve_definite(jnp.asarray(matrix), jnp.asarray(right))
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-11)


@pytest.mark.parametrize("size", [3, 9])
def test_no_solution_where_the_matrix_is_not_positive_definite(x64, size):
    matrix = jnp.diag(jnp.ones(size).at[1].set(-1.0))
    assert np.isnan(solve_definite(matrix, jnp.ones((size, 1)))).any()
