"""Damping given by its ratio: exact where it is fitted, less between, more beyond."""

import numpy as np
import pytest
from bodies import block, pressed, structure
from scipy import linalg, sparse

import skfem_joint as sj

RATIO = 0.02


def some(shape: str, **changes: object) -> sj.Structure:
    body = block(shape, n=2 if shape == "hex" else 3, size=(2.0, 0.3, 0.2))
    return structure(body, [pressed("joint" if shape == "line" else "pressed")], **changes)


def loaded(structure: sj.Structure, amplitude: sj.Amplitude) -> sj.System:
    direction = (1.0, *[0.0] * (structure.dim - 1))
    return structure.system([sj.Load("right", amplitude, direction)])


def free_decay(system: sj.System) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, rad/s, and ratios of a system's free vibrations with its joints stuck."""
    free = np.setdiff1d(np.arange(system.n), system.contact.B.indices)
    M, C, K = (A.toarray()[np.ix_(free, free)] for A in (system.M, system.C, system.K))
    zero, one = np.zeros_like(M), np.eye(free.size)
    first = np.block([[zero, one], [-K, -C]])
    roots = linalg.eig(first, np.block([[one, zero], [zero, M]]), right=False)
    roots = roots[roots.imag > 0.0]
    roots = roots[np.argsort(np.abs(roots))]
    return np.abs(roots), -roots.real / np.abs(roots)


@pytest.mark.parametrize("shape", ["line", "quad", "hex"])
def test_the_ratio_is_exact_at_the_two_frequencies_of_the_fit(shape):
    omega, _ = free_decay(loaded(some(shape), sj.Triangle(1.0, 1e-3)))
    body, frequency = some(shape, damping_ratio=RATIO), omega / (2.0 * np.pi)
    for amplitude, second in (
        (sj.Triangle(1.0, 1e-3), 2),
        (sj.Harmonic(1.0, 1.05 * frequency[0]), 2),
        (sj.Harmonic(1.0, frequency[1]), 1),
    ):
        system = loaded(body, amplitude)
        _, ratio = free_decay(system)
        np.testing.assert_allclose(ratio[[0, second]], RATIO, rtol=1e-6)
        assert np.all(ratio[1:second] < RATIO)
        assert sum(note.startswith("Damping of ratio") for note in system.notes) == 1
    slow = loaded(body, sj.Harmonic(1.0, 0.2 * frequency[0]))
    _, ratio = free_decay(slow)
    np.testing.assert_allclose(ratio[0], RATIO, rtol=1e-6)
    # C = a M + b K: two of the ratios tell what it is at the frequency of the load.
    both = np.stack([0.5 / omega[[0, 2]], 0.5 * omega[[0, 2]]], axis=1)
    a, b = np.linalg.solve(both, ratio[[0, 2]])
    assert 0.5 * (a / (0.2 * omega[0]) + b * 0.2 * omega[0]) == pytest.approx(RATIO, rel=1e-6)


def test_a_joint_that_is_all_there_is_counts_as_loose():
    M, K = np.eye(2), np.array([[2.0, -1.0], [-1.0, 2.0]])
    slip = sj.point_friction([1.0, 0.0], 1.0) + sj.point_friction([0.0, 1.0], 1.0)
    system = sj.System.from_matrices(M, K, contact=slip, damping_ratio=RATIO)
    assert "joints loose" in system.notes[0]
    C = system.C.toarray()
    modes = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0)
    expected = 2.0 * RATIO * np.sqrt([1.0, 3.0])
    np.testing.assert_allclose(modes @ C @ modes, np.diag(expected), atol=1e-9)


def test_a_ratio_is_given_alone_and_of_something_that_vibrates():
    M, K = np.eye(2), np.array([[2.0, -1.0], [-1.0, 2.0]])
    for changes in ({"C": K}, {"stiffness_damping": 1.0}, {"mass_damping": 1.0}):
        with pytest.raises(sj.InputError, match="must be given alone"):
            sj.System.from_matrices(M, K, damping_ratio=RATIO, **changes)
    with pytest.raises(sj.InputError, match="nothing vibrates"):
        sj.System(
            M, None, sparse.csr_array(0.0 * K), sj.Contact(np.zeros((0, 2)), [], 1.0)
        ).with_damping_ratio(RATIO)
    with pytest.raises(sj.InputError, match=r"(?s)below 1.*must be given alone"):
        some("line", damping_ratio=2.0, stiffness_damping=1e-5)
