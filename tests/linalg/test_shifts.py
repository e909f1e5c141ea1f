"""A shift of the stiffness by the mass makes it definite and does not show in frequencies."""

import numpy as np
import pytest
from grid_matrices import grid
from scipy import sparse

from skfem_joint.linalg.factors import with_pivots
from skfem_joint.linalg.shifts import mean_square_frequency, shifted
from skfem_joint.reduction.interface_modes import RestrictedMotion
from skfem_joint.system.modes import lowest_modes


def free_chain(n: int) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Stiffness and mass of equal masses between equal springs, held by nothing."""
    diagonal = np.r_[1.0, np.full(n - 2, 2.0), 1.0]
    K = sparse.diags_array([diagonal, -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1])
    return sparse.csr_array(3e8 * K), sparse.csr_array(0.2 * sparse.eye_array(n))


def test_a_floating_chain_has_a_factor_after_the_shift():
    K, M = free_chain(50)
    assert np.all(with_pivots(shifted(K, M))[0] > 0.0)
    assert mean_square_frequency(K, M) == pytest.approx(98 * 3e8 / (50 * 0.2), rel=1e-12)


def test_frequencies_of_a_floating_chain_are_exact():
    """2 sqrt(k/m) sin(pi i / (2 n)), of which the first is that of the rigid motion, zero."""
    n = 50
    frequencies, modes = lowest_modes(*free_chain(n), 4)
    exact = np.sqrt(3e8 / 0.2) * 2.0 * np.sin(np.pi * np.arange(4) / (2 * n)) / (2.0 * np.pi)
    assert frequencies[0] == 0.0
    np.testing.assert_allclose(frequencies[1:], exact[1:], rtol=1e-8)
    np.testing.assert_allclose(0.2 * modes.T @ modes, np.eye(4), atol=1e-9)


@pytest.mark.parametrize("size", [1.0, -1.0])
def test_pivots_have_the_signs_of_the_eigenvalues_however_full_a_matrix_is(size):
    full = np.random.default_rng(3).normal(size=(40, 40))
    for A in (full @ full.T + np.eye(40), grid((9, 5)).toarray()):
        B = A.copy()
        B[7, 7] *= size
        expected = np.linalg.eigvalsh(B)
        each, _ = with_pivots(sparse.csr_array(B))
        assert np.count_nonzero(each < 0.0) == np.count_nonzero(expected < 0.0)
        assert np.prod(each / np.abs(expected)) == pytest.approx(np.sign(expected).prod(), rel=1e-6)


def test_motions_that_nothing_holds_have_modes_and_responses():
    """The same chain, whose factor without a shift stops at a pivot of exactly zero."""
    K, M = free_chain(50)
    restricted = RestrictedMotion(sparse.eye_array(50, format="csc"), K, M)
    frequencies, _ = restricted.lowest(4)
    np.testing.assert_allclose(frequencies, lowest_modes(K, M, 4)[0], rtol=1e-9)
    stretched = restricted.solver(np.eye(50)[0] - np.eye(50)[-1])
    np.testing.assert_allclose(np.diff(stretched), -1.0 / 3e8, rtol=1e-6)


def test_masses_without_stiffness_have_rigid_motions_alone():
    M = sparse.diags_array(np.arange(1.0, 31.0))
    frequencies, modes = lowest_modes(sparse.csr_array((30, 30)), sparse.csr_array(M), 4)
    assert np.all(frequencies == 0.0)
    np.testing.assert_allclose(modes.T @ M @ modes, np.eye(4), atol=1e-9)
