"""Schur complements are the inverse of the inverse's part, and solve for all unknowns."""

import numpy as np
import pytest
from grid_matrices import grid
from scipy import sparse

from skfem_joint.linalg import schur
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.schur import SchurComplement, condensed, condensing_pays


@pytest.mark.parametrize(
    ("shape", "apart", "dense"),
    [
        ((200,), False, False),
        ((200,), True, False),
        ((200,), False, True),
        ((14, 14, 14), False, False),
        ((14, 14, 14), True, False),
        ((18, 18, 18), False, False),
    ],
)
def test_what_is_condensed_follows(shape, apart, dense):
    """The complement is the inverse of the inverse's part, for bodies that are apart too."""
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


def blocks(shape):
    """Pattern of a body of bricks or squares of first order: all nodes of an element coupled."""
    whole = sparse.eye_array(1)
    for n in shape:
        whole = sparse.kron(
            whole, sparse.diags_array([1.0, 4.0, 1.0], offsets=[-1, 0, 1], shape=(n, n))
        )
    return sparse.csr_array(sparse.kron(whole, np.eye(len(shape)) + 0.1))


@pytest.mark.parametrize("points", [100, 300, 600, 700, 1500])
def test_contact_of_solids_is_condensed_at_any_number_of_points(points):
    """Two slips at each point of one face, which has as many nodes, of a body four nodes thick."""
    side = int(np.sqrt(points))
    A = blocks((side, points // side, 4))
    nodes = np.arange(0, A.shape[0] // 3, 4)
    assert condensing_pays(A, np.sort(np.concatenate([3 * nodes, 3 * nodes + 1])))


@pytest.mark.parametrize(("kept", "pays"), [(100, True), (600, True), (4800, False)])
def test_contact_of_a_plate_is_condensed_where_it_is_small(kept, pays):
    """Of 12,800 unknowns, scattered so that all meet others."""
    A = blocks((80, 80))
    assert condensing_pays(A, np.arange(0, A.shape[0], A.shape[0] // kept)[:kept]) == pays


def test_what_does_not_fit_into_memory_is_not_condensed():
    """Every other unknown of a chain, were its complement for nothing."""
    most = int(np.sqrt(schur.MEMORY_SHARE * schur.physical_memory() / schur.dense_bytes(1)))
    for kept, pays in ((most, True), (most + 1, False)):
        A = sparse.diags_array([1.0, 4.0, 1.0], offsets=[-1, 0, 1], shape=(2 * kept, 2 * kept))
        every_other = np.arange(0, 2 * kept, 2)
        assert condensing_pays(sparse.csr_array(A), every_other, dense=(0.0, 0.0)) == pays
