"""Factors solve what they were made of."""

import numpy as np
import pytest
from scipy import sparse

from skfem_joint import factors
from skfem_joint.factors import (
    BAND,
    THIN,
    Band,
    BlockFactors,
    Condensation,
    condensed,
    condenses,
    factorised,
)


def eye(n: int) -> sparse.csr_array:
    return sparse.csr_array(sparse.eye_array(n))


def grid(shape: tuple[int, ...]) -> sparse.csr_array:
    """Laplacian of a grid of one to three dimensions, numbered at random."""
    A = sparse.eye_array(1)
    for m in shape:
        line = sparse.diags_array([2.1, -1.0, -1.0], offsets=[0, 1, -1], shape=(m, m))
        n = A.shape[0]
        A = sparse.kron(A, sparse.eye_array(m)) + sparse.kron(sparse.eye_array(n), line)
    order = np.random.default_rng(5).permutation(A.shape[0])
    return sparse.csr_array(A)[order][:, order]


@pytest.mark.parametrize("shape", [(1,), (200,), (60, 7), (6, 6, 5), (14, 14, 14)])
def test_a_factor_solves_matrices_of_narrow_and_wide_bands_in_any_order(shape):
    """The last is wider than a band."""
    A = grid(shape)
    assert (min(shape) ** (len(shape) - 1) > BAND) == (len(shape) == 3 and shape[0] == 14)
    X = np.random.default_rng(6).normal(size=(A.shape[0], 3))
    solve = factorised(A)
    np.testing.assert_allclose(solve(A @ X), X, atol=1e-11)
    np.testing.assert_allclose(solve(A @ X[:, 0]), X[:, 0], atol=1e-11)


@pytest.mark.parametrize("apart", [1, 2])
@pytest.mark.parametrize("width", [5, 20, 80])
def test_a_strip_has_a_band_as_narrow_as_itself(width, apart):
    """Each point meets the eight around it; numbered at random, alone and beside another strip."""
    along, across = (
        sparse.diags_array(np.ones((3, m)), offsets=(-1, 0, 1), shape=(m, m)) for m in (100, width)
    )
    strips = sparse.block_diag([sparse.kron(along, across)] * apart)
    strips += 10.0 * eye(strips.shape[0])
    order = np.random.default_rng(8).permutation(strips.shape[0])
    A = sparse.csr_array(strips)[order][:, order]
    entries = A.tocoo()
    band = Band(*entries.coords, order.size)
    assert band.height <= max(width + 5, THIN)
    factor = band.factorised(entries.data)
    assert factor is not None
    x = np.sin(1.0 + np.arange(order.size))
    np.testing.assert_allclose(factor(A @ x), x, atol=1e-11)
    if width == 5:
        np.testing.assert_allclose(np.log(factor.pivots).sum(), np.linalg.slogdet(A.toarray())[1])


@pytest.fixture(params=["SuperLU", "PARDISO"])
def library(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Large matrices by each of the libraries."""
    if request.param == "PARDISO":
        pytest.importorskip("pypardiso")
        monkeypatch.setattr(factors, "LARGE", 1)
    else:
        monkeypatch.setattr(factors, "find_spec", lambda _: None)
    return str(request.param)


def test_a_factor_solves_a_matrix_that_is_not_definite(library):
    for A in (sparse.csr_array([[1.0, 2.0], [2.0, 1.0]]), grid((14, 14, 14)) - 1.3 * eye(14**3)):
        x = np.sin(1.0 + np.arange(A.shape[0]))
        np.testing.assert_allclose(factorised(A)(A @ x), x, atol=1e-9)


def test_factors_stand_beside_each_other(library):
    A = grid((14, 14, 14))
    x = np.sin(1.0 + np.arange(A.shape[0]))
    solvers = [factorised(A + shift * eye(x.size)) for shift in range(4)]
    del solvers[1]
    for solve, shift in zip(solvers, (0, 2, 3), strict=True):
        np.testing.assert_allclose(solve(A @ x + shift * x), x, atol=1e-11)
        X = np.outer(x, [1.0, 2.0])
        np.testing.assert_allclose(solve(A @ X + shift * X), X, atol=1e-11)


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("shape", [(200,), (14, 14, 14)])
@pytest.mark.parametrize("dense", [False, True])
def test_what_is_condensed_follows(shape, apart, dense, library):
    """The complement is the inverse of the inverse's part, for bodies that are apart too."""
    if dense and (apart or len(shape) == 3):
        return
    A = sparse.csr_array(sparse.block_diag([grid(shape)] * 2)) if apart else grid(shape)
    kept = np.sort(np.random.default_rng(7).permutation(A.shape[0])[:30])
    made = Condensation(A.toarray() if dense else A, kept)
    forces = np.zeros((A.shape[0], kept.size))
    forces[kept] = np.eye(kept.size)
    inverse = factorised(A)(forces)
    right, still = made.inward(forces)
    np.testing.assert_allclose(made.complement @ inverse[kept], right, atol=1e-11)
    np.testing.assert_allclose(made.outward(inverse[kept], still), inverse, atol=1e-11)
    some = np.sin(np.arange(A.shape[0]))
    right, still = made.inward(some)
    u = made.outward(np.linalg.solve(made.complement, right), still)
    np.testing.assert_allclose(A @ u, some, atol=1e-11)


def test_many_that_meet_few_others_stay_sparse():
    A, place = grid((60, 20)), np.random.default_rng(5).permutation(60 * 20)
    kept = np.flatnonzero(place >= 30 * 20)  # of a grid half of its length
    made = Condensation(A, kept)
    assert condenses(A, kept)
    assert made.complement.nnz < A[kept][:, kept].nnz + 20**2
    inverse = np.linalg.inv(A.toarray())[np.ix_(kept, kept)]
    np.testing.assert_allclose(made.complement @ inverse, np.eye(kept.size), atol=1e-11)
    some = np.sin(np.arange(A.shape[0]))
    added = sparse.diags_array(2.0 * (place >= 30 * 20))
    u = condensed(A, kept).solver(added)(some)
    np.testing.assert_allclose(A @ u + added @ u, some, atol=1e-11)
    assert not condenses(A, np.arange(0, A.shape[0], 2))


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("shape", [(40,), (14, 14, 14)])
def test_a_factor_with_blocks_added_solves_for_what_is_not_held(shape, dense, hold):
    """Points of one and of two unknowns, one matrix for two sets of blocks."""
    A = grid(shape)
    first, second = np.array([3, 7, 11]), np.array([5, -1, 2])
    held = np.isin(np.arange(A.shape[0]), [7, 11, 2, 20] if hold else [])
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
