"""Factors solve what they were made of."""

import logging
import sys

import numpy as np
import pytest
from grid_matrices import eye, grid
from scipy import sparse

from skfem_joint.linalg import bands, factors
from skfem_joint.linalg.factors import BlockFactors, factorised


@pytest.mark.parametrize("shape", [(1,), (200,), (60, 7), (6, 6, 5), (14, 14, 14)])
def test_a_factor_solves_matrices_of_narrow_and_wide_bands_in_any_order(shape):
    """The last is wider than a band."""
    A = grid(shape)
    assert (min(shape) ** (len(shape) - 1) > bands.WIDEST) == (len(shape) == 3 and shape[0] == 14)
    X = np.random.default_rng(6).normal(size=(A.shape[0], 3))
    solve = factorised(A)
    np.testing.assert_allclose(solve(A @ X), X, atol=1e-11)
    np.testing.assert_allclose(solve(A @ X[:, 0]), X[:, 0], atol=1e-11)


def test_a_factor_solves_a_matrix_that_is_not_definite(library):
    for A in (sparse.csr_array([[1.0, 2.0], [2.0, 1.0]]), grid((14, 14, 14)) - 1.3 * eye(14**3)):
        x = np.sin(1.0 + np.arange(A.shape[0]))
        np.testing.assert_allclose(factorised(A)(A @ x), x, atol=1e-9)


@pytest.mark.parametrize("error", ["ImportError('no mkl_rt')", "OSError('cannot open libmkl_rt')"])
def test_pardiso_without_its_library_is_as_if_not_installed(error, tmp_path, monkeypatch, caplog):
    """What pypardiso raises at its import where MKL is missing or cannot be loaded."""
    (tmp_path / "pypardiso.py").write_text(f"raise {error}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "pypardiso", raising=False)
    monkeypatch.setattr(factors, "LARGE", 1)
    factors.pardiso.cache_clear()
    A = grid((14, 14, 14))
    x = np.sin(1.0 + np.arange(A.shape[0]))
    with caplog.at_level(logging.WARNING):
        for _ in range(2):
            np.testing.assert_allclose(factorised(A)(A @ x), x, atol=1e-11)
    factors.pardiso.cache_clear()
    (said,) = caplog.messages
    assert "pypardiso" in said
    assert "mkl" in said


def test_factors_stand_beside_each_other(library):
    A = grid((14, 14, 14))
    x = np.sin(1.0 + np.arange(A.shape[0]))
    solvers = [factorised(A + shift * eye(x.size)) for shift in range(4)]
    del solvers[1]
    for solve, shift in zip(solvers, (0, 2, 3), strict=True):
        np.testing.assert_allclose(solve(A @ x + shift * x), x, atol=1e-11)
        X = np.outer(x, [1.0, 2.0])
        np.testing.assert_allclose(solve(A @ X + shift * X), X, atol=1e-11)


@pytest.mark.parametrize("hold", [[], [7, 11, 2, 20], [5, 20]])
@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("shape", [(40,), (14, 14, 14)])
def test_a_factor_with_blocks_added_solves_for_what_is_not_held(shape, dense, hold):
    """Points of one and of two unknowns, of which one may be held; two sets of blocks."""
    A = grid(shape)
    first, second = np.array([3, 7, 11]), np.array([5, -1, 2])
    held = np.isin(np.arange(A.shape[0]), hold)
    made = BlockFactors(A.toarray() if dense else A, first, second)
    for blocks in ([[2.0, 1.0, 4.0], [3.0, 0.0, 0.0], [1.0, -0.5, 2.0]], np.zeros((3, 3))):
        values = np.array(blocks)
        values[held[first]] = 0.0
        T = A.toarray()
        for i, j, (along, between, across) in zip(first, second, values, strict=True):
            T[i, i] += along
            if j >= 0:
                T[j, j] += across
                T[i, j] += between
                T[j, i] += between
        x = np.where(held, 0.0, np.sin(1.0 + np.arange(A.shape[0])))
        right = np.where(held, 1e9, T @ x)
        np.testing.assert_allclose(made.factorised(values, held)(right), x, atol=1e-11)
