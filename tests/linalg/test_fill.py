"""What a factor takes is counted on its pattern."""

import numpy as np
import pytest
from grid_matrices import grid
from scipy import sparse

from skfem_joint.linalg.factors import symmetric_lu
from skfem_joint.linalg.fill import Fill, fill


def test_along_a_band_the_count_is_that_of_the_band():
    assert fill(grid((500,))).entries == 2 * 500  # tridiagonal
    assert fill(grid((200, 10))).entries <= 2000 * 12


@pytest.mark.parametrize("unknowns", [1, 3])
@pytest.mark.parametrize("shape", [(150, 140), (13, 13, 13)])
def test_elsewhere_it_is_near_that_of_a_library(shape, unknowns):
    """With one unknown at each node, or three that are coupled alike."""
    A = sparse.csr_array(sparse.kron(grid(shape), np.eye(unknowns) + 0.1))
    counted, made = fill(A), symmetric_lu(A).L
    assert 0.6 < counted.entries / made.nnz < 1.8
    below = np.diff(made.indptr) - 1.0
    assert 0.5 < counted.work / (0.5 * np.sum(below**2)) < 4.0


def test_parts_that_are_apart_add_up_whatever_the_order():
    A = grid((16, 16, 16))
    once = fill(A)
    twice = fill(sparse.csr_array(sparse.block_diag([A, A])))
    np.testing.assert_allclose(twice, 2.0 * np.array(once), rtol=0.02)  # cut from another corner
    order = np.random.default_rng(3).permutation(A.shape[0])
    other = fill(sparse.csr_array(A)[order][:, order])
    np.testing.assert_allclose(other, once, rtol=0.3)


def test_a_full_front_is_a_dense_factor():
    n = np.array([30.0])
    entries, work = Fill(0.0, 0.0).plus(n, 0.0 * n)
    assert entries == 30**2 / 2
    assert work == 30**3 / 3
