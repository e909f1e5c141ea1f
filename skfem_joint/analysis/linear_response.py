"""Steady response of the linear limits of a jointed structure: all joints stuck, or all loose.

Few of the frequencies need a factor of their own matrix: the other solutions lie in the span of
theirs. That span grows where the residual is largest, until it is small everywhere (a greedy
reduced basis). In the span, all frequencies are solved at once with small matrices, and the norm of
the residual is that of a product with the triangular factor of [F, K V, C V, M V], which loses no
digits to cancellation as their Gram matrix would.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from skfem_joint.analysis.response import at_frequency
from skfem_joint.arrays import FloatArray, IntArray
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
    first, more : int
        Frequencies, evenly spread, that are factorised first, and most of those that follow at a
        time where residuals are largest.
    residual : float
        Largest residual over the force of a solution in the span of others.
    pivot : float
        A pivot is taken from the diagonal unless it is smaller than this share of its column. With
        the order of a symmetric matrix a complex one of 10,539 unknowns takes 0.6 s so, and 6.6 s
        with the order and the pivots of any matrix.
    """

    samples: int = 256
    first: int = 7
    more: int = 3
    residual: float = 1e-8
    pivot: float = 1e-3


SETTINGS = LinearResponseSettings()


def linear_response(system: System, frequencies: FloatArray, stuck: bool) -> FloatArray:
    """Amplitudes of the linear structure that is the limit of small or of large loads.

    Under very small loads all contact points stick; under very large ones friction is negligible,
    and all of them are loose. The motion at each frequency is the sum of its harmonics,
    ``u = (K + i w C - w^2 M)^-1 f``. Contact that opens counts as closed where it is pressed at
    rest.

    Parameters
    ----------
    system : System
        Its loads are harmonic.
    frequencies : ndarray, shape (k,)
        Of the loads' common period, Hz.
    stuck : bool
        Whether contact points stick, on the springs in series with their friction if they have any,
        or are loose.

    Returns
    -------
    ndarray, shape (k, points)
        Half of peak to peak of the named points, m.
    """
    inner = arranged(system.closed()).system
    V = motions_without_slip(inner, True) if stuck else sparse.eye_array(inner.n, format="csc")
    stiffness = inner.stuck_stiffness if stuck else inner.K
    K, C, M = (sparse.csr_array(congruent(A, V)) for A in (stiffness, inner.C, inner.M))
    P, F = inner.P @ V, V.T @ inner.load_vectors()
    turn = 2.0 * np.pi * np.arange(SETTINGS.samples) / SETTINGS.samples
    motion = np.zeros((frequencies.size, len(system.points), turn.size))
    loads = at_frequency(inner, 1.0).loads  # their frequencies are multiples of the common one
    for multiple in {part.frequency for load in loads for part in load.amplitude.harmonics}:
        u = _solutions(K, C, M, F, 2.0 * np.pi * multiple * frequencies, P)
        for number, load in enumerate(loads):
            for part in load.amplitude.harmonics:
                if part.frequency == multiple:
                    wave = part.amplitude * np.exp(1j * (multiple * turn + part.phase))
                    motion += (u[:, :, number, np.newaxis] * wave).imag
    return np.asarray(0.5 * np.ptp(motion, axis=2))


def _solutions(
    K: sparse.csr_array,
    C: sparse.csr_array,
    M: sparse.csr_array,
    F: FloatArray,
    omega: FloatArray,
    P: sparse.csr_array,
) -> NDArray[np.complex128]:
    """Rows ``P`` of the solutions of ``(K + i w C - w^2 M) u = F`` at angular frequencies.

    Returns
    -------
    ndarray of complex, shape (frequencies, rows of P, columns of F)
    """
    n, matrices = len(F), (K, C, M)
    factors = np.stack([np.ones_like(omega), 1j * omega, -(omega**2)])
    found = np.zeros((omega.size, P.shape[0], F.shape[1]), dtype=complex)
    acting = np.flatnonzero(np.linalg.norm(F, axis=0) > 0.0)
    if not acting.size:
        return found
    F = F[:, acting]
    force = np.linalg.norm(F, axis=0)
    basis, known = np.zeros((n, 0)), np.zeros(omega.size, dtype=np.bool_)
    chosen = np.unique(np.linspace(0, omega.size - 1, SETTINGS.first).astype(int))
    points = np.arange(P.shape[0])
    while True:
        for row in chosen:
            H = sum(a * A for a, A in zip(factors[:, row], matrices, strict=True))
            order = {"diag_pivot_thresh": SETTINGS.pivot, "options": {"SymmetricMode": True}}
            u = splu(sparse.csc_array(H), "MMD_AT_PLUS_A", **order).solve(F.astype(complex))
            found[np.ix_([row], points, acting)] = P @ u
            basis = _with(basis, np.hstack([u.real, u.imag]))
        known[chosen] = True
        images = [A @ basis for A in matrices]
        small = np.stack([basis.T @ image for image in images])
        # Singular at an undamped natural frequency; residuals show where it is no solution.
        y = np.linalg.pinv(np.tensordot(factors, small, (0, 0))) @ (basis.T @ F)
        triangle = np.linalg.qr(np.hstack([F, *images]), mode="r")
        own = np.broadcast_to(np.eye(acting.size), (omega.size, acting.size, acting.size))
        parts = [-a[:, np.newaxis, np.newaxis] * y for a in factors]
        left = np.linalg.norm(triangle @ np.concatenate([own, *parts], axis=1), axis=1)
        worst = np.where(known, 0.0, (left / force).max(axis=1))
        if worst.max() <= SETTINGS.residual:
            break
        chosen = _largest(worst)
    rest = np.flatnonzero(~known)
    found[np.ix_(rest, points, acting)] = (P @ basis) @ y[rest]
    return found


def _largest(worst: FloatArray) -> IntArray:
    """Places of the largest of residuals that are maxima among their neighbours."""
    padded = np.concatenate([[0.0], worst, [0.0]])
    peaks = (worst >= padded[:-2]) & (worst > padded[2:]) & (worst > SETTINGS.residual)
    order = np.argsort(-np.where(peaks, worst, 0.0), kind="stable")
    return order[: min(SETTINGS.more, int(np.count_nonzero(peaks)))]


def _with(basis: FloatArray, vectors: FloatArray) -> FloatArray:
    """Orthonormal basis with some vectors more; projected twice, since once leaves round-off."""
    for _ in range(2):
        vectors = vectors - basis @ (basis.T @ vectors)
        vectors = orthonormal(vectors, sparse.eye_array(len(vectors)))
    return np.hstack([basis, vectors])
