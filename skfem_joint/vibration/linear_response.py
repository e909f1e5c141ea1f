"""Steady response of the linear limits of a jointed structure: all joints stuck, or all loose."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import harmonic_factors
from skfem_joint.linalg.factors import symmetric_lu
from skfem_joint.reduction.interface_modes import motions_without_slip
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import congruent
from skfem_joint.vibration.response import at_frequency

#: Times in a period from which half of peak to peak is read: the largest of 256 samples of a sine
#: is at most 8e-5 below its amplitude.
SAMPLES = 256
#: Pivots are taken from the diagonal unless they are smaller than this share of their column:
#: beyond the first natural frequency the matrix is indefinite.
PIVOT = 1e-3


def linear_response(system: System, frequencies: FloatArray, stuck: bool) -> FloatArray:
    """Amplitudes of the linear structure that is the limit of small or of large loads.

    Under very small loads all contact points stick; under very large ones friction is negligible,
    and all of them are loose. The motion at each frequency is the sum of its harmonics,
    ``u = (K + i w C - w^2 M)^-1 f``, each with a factor of its own. Contact that opens counts as
    closed where it is pressed at rest.

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

    Raises
    ------
    InputError
        If a harmonic meets a natural frequency that nothing damps.
    """
    inner = arranged(system.closed()).system
    V = motions_without_slip(inner, True) if stuck else sparse.eye_array(inner.n, format="csc")
    stiffness = inner.stuck_stiffness if stuck else inner.K
    K, C, M = (sparse.csc_array(congruent(A, V)) for A in (stiffness, inner.C, inner.M))
    P, F = inner.P @ V, (V.T @ inner.load_vectors()).astype(complex)
    turn = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    loads = at_frequency(inner, 1.0).loads  # refuses those that are not harmonic
    factors = harmonic_factors([load.amplitude for load in loads])
    motion = np.zeros((frequencies.size, len(system.points), turn.size))
    for moved, frequency in zip(motion, frequencies.tolist(), strict=True):
        for multiple, factor in factors.items():
            omega = 2.0 * np.pi * multiple * frequency
            try:
                solve = symmetric_lu(K + 1j * omega * C - omega**2 * M, pivot=PIVOT).solve
            except RuntimeError as error:
                raise InputError(
                    f"response: found {multiple * frequency:.9g} Hz, which is a natural frequency "
                    "of the linear structure that nothing damps: give damping, or another frequency"
                ) from error
            moved += np.outer(P @ solve(F @ factor), np.exp(1j * multiple * turn)).real
    return np.asarray(0.5 * np.ptp(motion, axis=2))
