"""Steady response of the linear limits of a jointed structure: all joints stuck, or all loose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from skfem_joint.analysis.response import at_frequency
from skfem_joint.arrays import FloatArray
from skfem_joint.reduction.interface_modes import motions_without_slip
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.system import System
from skfem_joint.unknowns import congruent


@dataclass(frozen=True)
class LinearResponseSettings:
    """Numbers of linear responses.

    Attributes
    ----------
    samples : int
        Times in a period from which half of peak to peak is read: the largest of 256 samples of a
        sine is at most 8e-5 below its amplitude.
    first : int
        Frequencies, evenly spread, that are solved first. The others mostly lie in the span of
        their solutions.
    residual : float
        Largest residual over the force of a solution in that span; beyond it the matrix is
        factorised.
    """

    samples: int = 256
    first: int = 7
    residual: float = 1e-8


SETTINGS = LinearResponseSettings()


def linear_response(system: System, frequencies: FloatArray, stuck: bool) -> FloatArray:
    """Amplitudes of the linear structure that is the limit of small or of large loads.

    Under very small loads all contact points stick; under very large ones friction is negligible,
    and all of them are loose. The motion at each frequency is the sum of its harmonics,
    ``u = (K + i w C - w^2 M)^-1 f``.

    Parameters
    ----------
    system : System
        Its loads are harmonic.
    frequencies : ndarray, shape (k,)
        Of the loads' common period, Hz.
    stuck : bool
        Whether contact points stick, or are loose.

    Returns
    -------
    ndarray, shape (k, points)
        Half of peak to peak of the named points, m.
    """
    inner = arranged(system).system
    V = motions_without_slip(inner, True) if stuck else sparse.eye_array(inner.n, format="csc")
    solve = _HarmonicSolver(
        *(sparse.csr_array(congruent(A, V)) for A in (inner.K, inner.C, inner.M))
    )
    P, F = inner.P @ V, V.T @ inner.load_vectors()
    turn = 2.0 * np.pi * np.arange(SETTINGS.samples) / SETTINGS.samples
    amplitudes = np.zeros((frequencies.size, len(system.points)))
    spread = np.linspace(0, frequencies.size - 1, SETTINGS.first)
    first = np.unique(spread.astype(int))
    for row in [*first, *np.setdiff1d(np.arange(frequencies.size), first)]:
        frequency = float(frequencies[row])
        motion = np.zeros((len(system.points), turn.size))
        for force, load in zip(F.T, at_frequency(inner, frequency).loads, strict=True):
            for part in load.amplitude.harmonics:
                u = P @ solve(2.0 * np.pi * part.frequency, force) * part.amplitude
                phase = turn * part.frequency / frequency + part.phase
                motion += (u[:, np.newaxis] * np.exp(1j * phase)).imag
        amplitudes[row] = 0.5 * np.ptp(motion, axis=1)
    return amplitudes


class _HarmonicSolver:
    """Solves ``(K + i w C - w^2 M) u = f`` at many frequencies with few factorisations.

    Solutions are kept as an orthonormal basis V. At a new frequency the system is first projected
    on V; where the residual of that solution is too large the matrix is factorised, and the new
    solution joins V.
    """

    def __init__(self, K: sparse.csr_array, C: sparse.csr_array, M: sparse.csr_array) -> None:
        self.matrices = K, C, M
        self.factor: tuple[float, SuperLU] | None = None  # the last one, and its frequency
        self.V = np.zeros((K.shape[0], 0))
        self.images = [self.V, self.V, self.V]  # of V by each of the matrices

    def __call__(self, omega: float, force: FloatArray) -> NDArray[np.complex128]:
        """Complex amplitude, (n,), m, at an angular frequency (rad/s) under a force (n,), N."""
        factors = 1.0, 1j * omega, -(omega**2)
        if self.V.shape[1]:
            image = sum(a * A for a, A in zip(factors, self.images, strict=True))
            u = np.linalg.solve(self.V.T @ image, self.V.T @ force)
            residual = np.linalg.norm(force - image @ u)
            if residual <= SETTINGS.residual * np.linalg.norm(force):
                return np.asarray(self.V @ u)
        if self.factor is None or self.factor[0] != omega:  # loads often share a frequency
            H = sum(a * A for a, A in zip(factors, self.matrices, strict=True))
            self.factor = omega, splu(sparse.csc_array(H))
        u = self.factor[1].solve(force.astype(complex))
        self._add(np.stack([u.real, u.imag], axis=1))
        return np.asarray(u)

    def _add(self, vectors: FloatArray) -> None:
        """Add the span of some vectors to the basis; twice, since once leaves round-off."""
        for _ in range(2):
            vectors = vectors - self.V @ (self.V.T @ vectors)
            vectors = orthonormal(vectors, sparse.eye_array(len(vectors)))
        self.V = np.hstack([self.V, vectors])
        self.images = [
            np.hstack([B, A @ vectors]) for A, B in zip(self.matrices, self.images, strict=True)
        ]
