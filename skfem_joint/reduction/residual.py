"""Modes that a reduced model lacks, from its residual in the full equation of motion.

The states of a reduced run, put into the full equation, leave forces that its basis cannot balance.
Their static response, without what the basis spans already, is what the basis lacks, in the order
of its energy: a reduced model needs no full run to know what it misses. What its own law of
friction differs in from the full one's, or its friction points, this does not see.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import gcd
from typing import Any

import numpy as np
from scipy import linalg, sparse

from skfem_joint import friction
from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.factors import factorised
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.stepping.arrangement import picks_unknowns
from skfem_joint.stepping.recording import Run
from skfem_joint.system import System

#: Instants of a run at which its residual is looked at.
INSTANTS = 100
# Singular values that are left out, over the largest; share of the stiffness, over that of mass,
# that holds bodies which friction alone holds.
_NEGLIGIBLE, _HOLD = 1e-8, 1e-9


def stride(n_steps: int, cycle_steps: int | None) -> int:
    """Steps between the instants of a run, so that they meet many phases of a cycle."""
    every = max(1, n_steps // INSTANTS)
    while cycle_steps is not None and every > 1 and gcd(every, cycle_steps) > 1:
        every += 1
    return every


def acceleration(run: Run) -> FloatArray:
    """Acceleration of a reduced model's run at its stored fields, (j, frames), m/s2.

    That of its equation of motion, which holds at the end of every step.
    """
    small = run.system
    driving = small.load_vectors() @ small.load_amplitudes(run.field_times)
    driving -= small.C @ run.v.T + small.K @ run.u.T
    driving -= small.B.T @ (small.on_rows(small.w)[:, np.newaxis] * run.sigma.T)
    return np.asarray(linalg.solve(small.M, driving, assume_a="pos"))


@dataclass(frozen=True)
class Residual:
    """What reduced runs of a full system lack; its stiffness is factorised once."""

    system: System

    @cached_property
    def _stiffness(self) -> Any:
        system = self.system
        return sparse.csc_array(system.K + _HOLD * system.mean_square_frequency * system.M)

    @cached_property
    def _carrying(self) -> IntArray:
        return np.flatnonzero(self.system.on_rows(self.system.w))

    @cached_property
    def _solve(self) -> Any:
        return factorised(self._stiffness)

    def forces(self, V: FloatArray, run: Run) -> FloatArray:
        """Forces (N) that are left in the full equation at a run's stored fields, (n, frames).

        The run is that of ``system.project(V)``, maybe with a law or friction points of its own.
        """
        system, v = self.system, V @ run.v.T
        left = system.load_vectors() @ system.load_amplitudes(run.field_times)
        left -= system.M @ (V @ acceleration(run)) + system.C @ v + system.K @ (V @ run.u.T)
        if picks_unknowns(run.system.B):  # condensed: its friction is that of the same points
            sigma = np.zeros((v.shape[1], system.B.shape[0]))
            sigma[:, self._carrying] = run.sigma
        else:
            beta = np.minimum(system.beta, run.system.beta.max(initial=0.0))
            sigma = friction.force_vectors((system.B @ v).T, beta, system.directions)
        return np.asarray(left - system.B.T @ (system.on_rows(system.w) * sigma).T)

    def lacking(self, V: FloatArray, run: Run, most: int) -> FloatArray:
        """Modes that the basis ``V`` of a run lacks, at most so many, (n, k).

        Orthonormal in mass, and against ``V``, in the order of the energy of the static response;
        without slips where those are coordinates of ``V``.
        """
        R = self.forces(V, run)
        left, values, _ = linalg.svd(R, full_matrices=False)
        keep = values > _NEGLIGIBLE * values[0]
        if not np.any(keep):  # no residual at all
            return np.zeros((self.system.n, 0))
        X = self._solve(np.ascontiguousarray(left[:, keep] * values[keep]))
        whole = float(np.einsum("ij,ij", X, self._stiffness @ X))
        for _ in range(2):
            X = X - V @ linalg.solve(run.system.M, V.T @ (self.system.M @ X), assume_a="pos")
        if picks_unknowns(run.system.B):
            X = X - V @ (run.system.B.T @ (self.system.B[self._carrying] @ X))
        sizes, turn = np.linalg.eigh(X.T @ (self._stiffness @ X))
        most = min(most, self.system.n - V.shape[1])
        first = np.flatnonzero(sizes > _NEGLIGIBLE**2 * whole)[::-1][:most]
        return orthonormal(X @ turn[:, first], self.system.M) if first.size else X[:, :0]
