"""Dense kernels of the compiled loops, against numpy, for sizes that fill tiles and that do not."""

import numpy as np
import pytest

from skfem_joint.ground.compiling import compiled
from skfem_joint.linalg import kernels


@compiled
def _factor_and_solve(X, Y, columns, S, x):
    kernels.add_product(X, Y, columns, S, True)
    if not kernels.cholesky(S):
        return False
    kernels.solve_factorised(S, x)
    return True


@compiled
def _slips_and_forces(B, x, y, slip, force):
    kernels.combine_rows(B, x, slip)
    kernels.add_row_products(B, y, force)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7, 8, 11])
@pytest.mark.parametrize("columns", [0, 1, 6, 13])
def test_products_of_first_columns_are_added_and_factorised(n, columns):
    rng = np.random.default_rng(n + columns)
    Y = rng.normal(size=(n, 13))
    X = Y * rng.uniform(1.0, 2.0, size=13)
    H = np.eye(n) + 0.1
    b = rng.normal(size=n)
    S, x = np.triu(H), b.copy()
    assert _factor_and_solve(X, Y, columns, S, x)
    A = H + X[:, :columns] @ Y[:, :columns].T
    assert np.allclose(A @ x, b, rtol=0.0, atol=1e-12 * abs(A).max())
    U = np.triu(S, 1) + np.diag(1.0 / np.diag(S))
    assert np.allclose(U.T @ U, A)


def test_a_matrix_that_is_not_positive_definite_has_no_factor():
    for at in range(6):
        S = np.eye(6)
        S[at, at] = -1.0
        assert not _factor_and_solve(np.zeros((6, 1)), np.zeros((6, 1)), 1, S, np.zeros(6))
        S[:] = np.eye(6)
        S[at, at] = np.nan
        assert not _factor_and_solve(np.zeros((6, 1)), np.zeros((6, 1)), 1, S, np.zeros(6))


@pytest.mark.parametrize("n", [1, 3, 4, 6, 9])
def test_rows_are_combined_and_multiplied(n):
    rng = np.random.default_rng(n)
    B, x, y = rng.normal(size=(n, 10)), rng.normal(size=n), rng.normal(size=10)
    slip, force = np.full(10, np.nan), np.ones(n)
    _slips_and_forces(B, x, y, slip, force)
    assert np.allclose(slip, x @ B)
    assert np.allclose(force, 1.0 + B @ y)
