"""Schur complements are the inverse of the inverse's part, and solve for all unknowns."""

import numpy as np
import pytest
from grid_matrices import grid
from scipy import sparse

from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.schur import SchurComplement, condensed, condensing_pays


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("shape", [(200,), (14, 14, 14)])
@pytest.mark.parametrize("dense", [False, True])
def test_what_is_condensed_follows(shape, apart, dense, library):
    """The complement is the inverse of the inverse's part, for bodies that are apart too."""
    if dense and (apart or len(shape) == 3):
        return
    A = sparse.csr_array(sparse.block_diag([grid(shape)] * 2)) if apart else grid(shape)
    kept = np.sort(np.random.default_rng(7).permutation(A.shape[0])[:30])
    made = SchurComplement(A.toarray() if dense else A, kept)
    forces = np.zeros((A.shape[0], kept.size))
    forces[kept] = np.eye(kept.size)
    inverse = factorised(A)(forces)
    right, still = made.restrict(forces)
    np.testing.assert_allclose(made.complement @ inverse[kept], right, atol=1e-11)
    np.testing.assert_allclose(made.extend(inverse[kept], still), inverse, atol=1e-11)
    some = np.sin(np.arange(A.shape[0]))
    right, still = made.restrict(some)
    u = made.extend(np.linalg.solve(made.complement, right), still)
    np.testing.assert_allclose(A @ u, some, atol=1e-11)


def test_many_that_meet_few_others_stay_sparse():
    A, place = grid((60, 20)), np.random.default_rng(5).permutation(60 * 20)
    kept = np.flatnonzero(place >= 30 * 20)  # of a grid half of its length
    made = SchurComplement(A, kept)
    assert condensing_pays(A, kept)
    assert made.complement.nnz < A[kept][:, kept].nnz + 20**2
    inverse = np.linalg.inv(A.toarray())[np.ix_(kept, kept)]
    np.testing.assert_allclose(made.complement @ inverse, np.eye(kept.size), atol=1e-11)
    some = np.sin(np.arange(A.shape[0]))
    added = sparse.diags_array(2.0 * (place >= 30 * 20))
    u = condensed(A, kept).solver(added)(some)
    np.testing.assert_allclose(A @ u + added @ u, some, atol=1e-11)
    assert not condensing_pays(A, np.arange(0, A.shape[0], 2))
