"""Modes that a reduced model lacks, from its residual in the full equation of motion.

The states of a reduced run, put into the full equation, leave forces that its basis cannot balance.
Their response, without what the basis spans already, is what the basis lacks, in the order of its
energy: a reduced model needs no full run to know what it misses. Half of the modes are of a Newton
step: points that creep are held by the slope of their friction, those whose force would exceed the
limit are free. (The response of the structure alone moves what sticks: a plate's friction energy,
1.7 % off, came to 1.6 % with 16 such modes, to 0.1 % with held ones.) Half are of that free
response: it alone finds a slip front that the basis cannot move. What its own law of friction
differs in from the full one's, or its friction points, this does not see.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import gcd
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.cluster.hierarchy import fclusterdata

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.linalg.schur import SchurComplement, Uncondensed, condensed
from skfem_joint.linalg.shifts import shifted
from skfem_joint.minimise import law
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.stepping.arrangement import picks_unknowns
from skfem_joint.stepping.recording import Run
from skfem_joint.system import System

#: Instants of a run at which its residual is looked at.
INSTANTS = 100
#: Sets of instants that friction holds alike: as many matrices are factorised for a run.
ALIKE = 10
#: Rate at which friction answers, over that of instants; slope of friction, over the largest, below
#: which points are free.
_RATE, _FREE = 10.0, 1e-6
# Share of a mode's mass within a span from which on it is round-off of what that spans.
_INSIDE = 1.0 - 1e-6
# Singular values that are left out, over the largest.
_NEGLIGIBLE = 1e-8


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
    """What reduced runs of a full system lack; its stiffness may have been condensed before."""

    system: System
    stiffness: Uncondensed | None = None

    @cached_property
    def _stiffness(self) -> Any:
        return sparse.csc_array(shifted(self.system.K, self.system.M))

    @cached_property
    def _carrying(self) -> IntArray:
        return np.flatnonzero(self.system.on_rows(self.system.w))

    @cached_property
    def _condensed(self) -> Uncondensed:
        """The stiffness, to which springs at what the contact moves will be added."""
        moved = np.unique(sparse.csr_array(self.system.B).indices)
        known = self.stiffness
        if isinstance(known, SchurComplement) and np.array_equal(known.kept, moved):
            return known
        return condensed(self._stiffness, moved)

    def _holding(self, rows: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Solver for what is kept, with springs (N/m) that resist each slip."""
        B = sparse.csc_array(self.system.B)
        return self._condensed.solver_of_kept(B.T @ sparse.diags_array(rows) @ B)

    @cached_property
    def _free(self) -> Callable[[FloatArray], FloatArray]:
        return self._holding(np.zeros(self.system.B.shape[0]))

    def forces(self, V: FloatArray, run: Run) -> FloatArray:
        """Forces (N) that are left in the full equation at a run's stored fields, (n, frames).

        The run is that of ``system.project(V)``, maybe with a law or friction points of its own.
        """
        system = self.system
        left = system.load_vectors() @ system.load_amplitudes(run.field_times)
        motions = acceleration(run), run.v.T, run.u.T
        for A, x in zip((system.M, system.C, system.K), motions, strict=True):
            # A condensed model has more unknowns than frames.
            left -= (A @ V) @ x if V.shape[1] < x.shape[1] else A @ (V @ x)
        if picks_unknowns(run.system.B):  # condensed: its friction is that of the same points
            sigma = np.zeros((len(run.v), system.B.shape[0]))
            sigma[:, self._carrying] = run.sigma
        else:
            slip = run.v @ (system.B @ V).T
            sigma = law.force_vectors(slip, self._beta(run), system.directions)
        return np.asarray(left - system.B.T @ (system.on_rows(system.w) * sigma).T)

    def _beta(self, run: Run) -> FloatArray:
        return np.asarray(np.minimum(self.system.beta, run.system.beta.max(initial=0.0)))

    def _held(self, V: FloatArray, run: Run, R: FloatArray) -> FloatArray:
        """Stiffness (frames, m), N/m, by which friction holds points that the forces R act on."""
        system, slip = self.system, run.v @ (self.system.B @ V).T
        force = system.on_rows(system.w) * law.force_vectors(
            slip, self._beta(run), system.directions
        )
        squares = sparse.csr_array(system.B).power(2).sum(axis=1)
        force += (system.B @ R).T / np.where(squares > 0.0, squares, 1.0)
        slope = law.force_slope(system.slip_norm(slip), self._beta(run))
        slope[system.slip_norm(force) > system.w] = 0.0
        return np.asarray(system.w * slope * _RATE / (run.field_times[1] - run.field_times[0]))

    def _responses(self, V: FloatArray, run: Run) -> Iterator[FloatArray]:
        """Responses (n, frames), m, to the forces that a run leaves: free, and held by friction."""
        R, whole = self.forces(V, run), self._condensed
        right, still = whole.restrict(np.ascontiguousarray(R))
        yield whole.extend(self._free(right), still)
        if picks_unknowns(run.system.B):  # all slips are in the basis
            return
        held = self._held(V, run, R)
        held = np.log(np.maximum(held, _FREE * max(float(held.max(initial=0.0)), 1e-300)))
        kinds = fclusterdata(held, ALIKE, "maxclust", method="ward")
        x = np.zeros_like(right)
        for kind in np.unique(kinds):
            alike = np.flatnonzero(kinds == kind)
            solve = self._holding(self.system.on_rows(np.exp(held[alike].mean(axis=0))))
            x[:, alike] = solve(np.ascontiguousarray(right[:, alike]))
        yield whole.extend(x, still)

    def lacking(self, V: FloatArray, run: Run, most: int, known: FloatArray) -> FloatArray:
        """Modes that the basis ``V`` of a run lacks, at most so many, (n, k).

        Orthonormal in mass, and against ``V``; half of them of the free response, half of the held
        one, each in the order of energy; without slips where those are coordinates of ``V``. There
        are as many more of motions that are ``known`` (n, s).
        """
        system, M = self.system, self.system.M
        found = V[:, :0]
        responses = list(self._responses(V, run))
        each = most // len(responses)
        for X, more in [*((X, each) for X in responses), (known, most)]:
            whole = float(np.vdot(X, self._stiffness @ X))
            MN = M @ found
            between = V.T @ MN
            gram = np.block([[run.system.M, between], [between.T, found.T @ MN]])
            for _ in range(2):
                share, _ = _spanned(V, found, gram, M @ X)
                X = X - V @ share[: V.shape[1]]
                X -= found @ share[V.shape[1] :]
            if picks_unknowns(run.system.B):
                X = X - V @ (run.system.B.T @ (system.B[self._carrying] @ X))
            sizes, turn = np.linalg.eigh(X.T @ (self._stiffness @ X))
            told = np.flatnonzero(sizes > _NEGLIGIBLE**2 * whole)[::-1]
            first = told[: min(more, system.n - V.shape[1] - found.shape[1])]
            if first.size:
                new = orthonormal(X @ turn[:, first], M)
                inside = np.einsum("ij,ij->j", *_spanned(V, found, gram, M @ new))
                found = np.hstack([found, new[:, inside < _INSIDE]])
        return found


def _spanned(
    V: FloatArray, found: FloatArray, gram: FloatArray, MX: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Coordinates of what is nearest to some X in the span of both, and its products with them."""
    right = np.vstack([V.T @ MX, found.T @ MX])
    return linalg.solve(gram, right, assume_a="pos"), right
