"""Where levels of load begin: the forces on joints while the structure vibrates without slip."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.reduction.interface_modes import RestrictedMotion, motions_without_slip, up_to
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import congruent


@dataclass(frozen=True)
class StuckVibration:
    """Steady vibration of a structure whose joints stick, in few coordinates.

    Attributes
    ----------
    modes : ndarray, shape (n, k)
        Natural modes without slip up to three times the highest frequency, of unit mass.
    M, C, K : ndarray, shape (j, j)
        Matrices in these modes and the static responses to the loads.
    loads : ndarray, shape (j, loads)
        The loads' vectors there.
    rows : tuple of ndarray, shapes (rows, loads) and three times (rows, j)
        Forces on the slip rows, N: of the loads, of M, of C and of K.
    """

    modes: FloatArray
    M: FloatArray
    C: FloatArray
    K: FloatArray
    loads: FloatArray
    rows: tuple[FloatArray, FloatArray, FloatArray, FloatArray]

    @staticmethod
    def of(system: System, highest: float) -> StuckVibration:
        """Vibration with the modes up to three times a frequency (Hz), at least one.

        The normal forces of the system are constant.
        """
        F = motions_without_slip(system, carrying=system.contact.has_springs)
        held = replace(system, K=system.stuck_stiffness)
        restricted = RestrictedMotion.of(held, F)
        modes = np.asarray(F @ up_to(restricted, highest, 1, 16, (restricted.solver, 1e-6)))
        static = F @ restricted.solver(np.asarray(F.T @ system.load_vectors()))
        W = orthonormal(np.hstack([modes, np.reshape(static, (system.n, -1))]), system.M)
        M, C, K = (np.asarray(congruent(A, W)) for A in (held.M, held.C, held.K))
        to = arranged(system)

        def on_rows(forces: FloatArray) -> FloatArray:
            return np.asarray(to.system.contact.B @ to.force(forces))

        loads = system.load_vectors()
        rows = on_rows(loads), on_rows(system.M @ W), on_rows(system.C @ W), on_rows(system.K @ W)
        return StuckVibration(modes, M, C, K, W.T @ loads, rows)

    def level(self, system: System) -> float:
        """Factor on the loads of a system at which the forces on a joint add up to its limit.

        The system has the unknowns, slip rows and load vectors of the one that this was made of.
        """
        forces = np.zeros(system.contact.w.size)
        parts = [
            (harmonic, number)
            for number, load in enumerate(system.loads)
            for harmonic in load.amplitude.harmonics
        ]
        for harmonic, number in parts:
            omega = 2.0 * np.pi * harmonic.frequency
            Z = self.K - omega**2 * self.M + 1j * omega * self.C
            x = np.linalg.solve(Z, self.loads[:, number].astype(complex))
            load, M, C, K = self.rows
            row = load[:, number] - (K @ x - omega**2 * (M @ x) + 1j * omega * (C @ x))
            forces += abs(harmonic.amplitude) * system.contact.slip_norm(np.abs(row))
        limits = system.contact.J @ system.contact.w
        shares = (system.contact.J @ forces)[limits > 0.0] / limits[limits > 0.0]
        largest = float(shares.max(initial=0.0))
        return 1.0 / largest if largest > 0.0 else np.inf
