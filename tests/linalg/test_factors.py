"""Factors solve what they were made of."""

import os
import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from grid_matrices import eye, grid
from scipy import sparse

from skfem_joint.linalg import bands, factors
from skfem_joint.linalg.factors import LARGE, BlockFactors, factorised, partial_factor

#: Wider than a band; the larger is factorised by PARDISO where that is installed.
SMALL, BIG = (14, 14, 14), (18, 18, 18)


@pytest.mark.parametrize("shape", [(1,), (200,), (60, 7), (6, 6, 5), SMALL, BIG])
def test_a_factor_solves_matrices_of_narrow_and_wide_bands_in_any_order(shape):
    A = grid(shape)
    wide = shape in (SMALL, BIG)
    assert (min(shape) ** (len(shape) - 1) > bands.WIDEST) == wide
    assert (A.shape[0] > LARGE) == (shape == BIG)
    X = np.random.default_rng(6).normal(size=(A.shape[0], 3))
    # Of several factors each is that of its own matrix, whatever becomes of the others.
    solvers = [factorised(A + shift * eye(len(X))) for shift in range(3)]
    del solvers[1]
    for solve, shift in zip(solvers, (0, 2), strict=True):
        right = A @ X + shift * X
        np.testing.assert_allclose(solve(right), X, atol=1e-11)
        np.testing.assert_allclose(solve(right[:, 0]), X[:, 0], atol=1e-11)


@pytest.mark.parametrize(
    "A", [sparse.csr_array([[1.0, 2.0], [2.0, 1.0]]), grid(SMALL) - 1.3 * eye(14**3),
          grid(BIG) - 1.3 * eye(18**3)],
)  # fmt: skip
def test_a_factor_solves_a_matrix_that_is_not_definite(A):
    x = np.sin(1.0 + np.arange(A.shape[0]))
    np.testing.assert_allclose(factorised(A)(A @ x), x, atol=1e-9)


@pytest.mark.parametrize("error", ["ImportError('no mkl_rt')", "OSError('cannot open libmkl_rt')"])
def test_pardiso_without_its_library_is_as_if_not_installed(error, tmp_path):
    """What pypardiso raises at its import where MKL is missing or cannot be loaded."""
    (tmp_path / "pypardiso.py").write_text(f"raise {error}\n")
    code = (
        "import numpy as np; from scipy import sparse; from skfem_joint.linalg.factors import *\n"
        "A = sparse.kron(sparse.eye_array(20), np.eye(250) + 1.0)\n"
        "for _ in range(2): assert np.allclose(factorised(A)(A @ np.ones(5000)), 1.0)\n"
    )
    paths = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": paths},
    )  # fmt: skip
    (said,) = ran.stderr.splitlines()
    assert "pypardiso is installed but cannot be used" in said
    assert "mkl" in said


@pytest.mark.parametrize("hold", [[], [7, 11, 2, 20], [5, 20]])
@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("shape", [(40,), SMALL])
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


@pytest.mark.parametrize("count", [1, 300])
def test_a_complement_by_pardiso_is_the_inverse_of_the_inverse_s_part(count):
    A = grid(BIG)
    kept = np.sort(np.random.default_rng(1).permutation(A.shape[0])[:count])
    made = partial_factor(A, kept)
    assert (made is None) == (find_spec("pypardiso") is None)
    if made is not None:
        forces = np.zeros((A.shape[0], count))
        forces[kept] = np.eye(count)
        responses = factorised(A)(forces)[kept]
        np.testing.assert_allclose(made.complement @ responses, np.eye(count), atol=1e-11)


@pytest.mark.skipif(find_spec("pypardiso") is None, reason="of PARDISO alone")
def test_matrices_of_one_pattern_share_the_order_of_their_unknowns(monkeypatch):
    monkeypatch.setattr(factors, "_ORDERS", {})
    A = grid(BIG)
    first, second, other = factorised(A), factorised(A + eye(A.shape[0])), factorised(A @ A)
    assert first._solver.perm is second._solver.perm is not other._solver.perm
    assert [x._solver.get_iparm(5) for x in (first, second, other)] == [2, 1, 2]
