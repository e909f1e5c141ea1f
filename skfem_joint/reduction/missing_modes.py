"""Modes that a reduced model is missing, from its residual in the full equation of motion.

The states of a reduced run, put into the full equation, leave forces R that its basis V cannot
balance:

    R = f − M V a − C V v − K V q − Bᵀ (w ∘ σ(B V v)).

The response to R, without what V spans already, is what the basis is missing. Its proper orthogonal
modes in the norm of strain energy are the missing modes, the most important ones first. So a
reduced model shows what it misses without a run of the full model.

Half of the modes come from the response to R of a structure in which friction holds points as a
Newton step does: springs of the slope of the law where points creep, none where the force would
exceed the friction limit. (The response without springs moves what sticks: the friction energy of a
plate, 1.7 % off, came to 1.6 % with 16 such modes, and to 0.1 % with modes of the response with
springs.) The other half come from the response without springs: it alone finds a slip front that
the basis cannot move.

Errors of a less steep law, or of merged friction points, are not detected here.
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

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.linalg.schur import DENSE, SchurComplement, Uncondensed, condensed
from skfem_joint.linalg.shifts import shifted
from skfem_joint.minimise import law
from skfem_joint.reduction.pod import modes_beyond
from skfem_joint.runs.friction_along import friction_along
from skfem_joint.stepping.recording import Run
from skfem_joint.system.system import System

#: Instants of a run at which its residual is computed.
INSTANTS = 100
#: Sets of instants at which friction holds points alike: a matrix is factorised for each.
SETS = 10
#: Rate at which the springs of friction answer, over the rate of the instants.
RATE = 10.0
#: Smallest spring, over the largest.
LEAST_SPRING = 1e-06
#: Singular values below this share of the largest are left out.
NEGLIGIBLE = 1e-08


def stride(n_steps: int, cycle_steps: int | None, instants: int = INSTANTS) -> int:
    """Steps between so many instants of a run, so that these meet many phases of a cycle."""
    every = max(1, n_steps // instants)
    while cycle_steps is not None and every > 1 and gcd(every, cycle_steps) > 1:
        every += 1
    return every


def acceleration(run: Run) -> FloatArray:
    """Acceleration of a reduced model's run at its stored fields, (j, frames), m/s2.

    It follows from the equation of motion, which holds at the end of every step.
    """
    small, contact = run.system, run.system.contact
    driving = small.load_vectors() @ small.load_amplitudes(run.field_times)
    driving -= small.C @ run.v.T + small.K @ run.u.T
    driving -= contact.B.T @ (contact.on_rows(contact.w)[:, np.newaxis] * run.sigma.T)
    return np.asarray(linalg.solve(small.M, driving, assume_a="pos"))


@dataclass(frozen=True)
class Residual:
    """Residuals of reduced runs in the equation of motion of a full system.

    Attributes
    ----------
    system : System
        The full system.
    stiffness : Uncondensed, optional
        Its stiffness, if its Schur complement exists already.
    """

    system: System
    stiffness: Uncondensed | None = None

    def under(self, system: System) -> Residual:
        """Residual of the same structure under other loads and limits, with factors that exist."""
        return Residual(system, self._condensed)

    @cached_property
    def _stiffness(self) -> Any:
        """Stiffness with a small multiple of the mass, as bodies may move rigidly."""
        return sparse.csc_array(shifted(self.system.K, self.system.M))

    @cached_property
    def _condensed(self) -> Uncondensed:
        """Schur complement of the stiffness: springs will be added to the contact unknowns."""
        moved = np.unique(sparse.csr_array(self.system.contact.B).indices)
        known = self.stiffness
        if isinstance(known, SchurComplement) and np.array_equal(known.kept, moved):
            return known
        return condensed(self._stiffness, moved, DENSE)

    def _with_springs(self, springs: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Solver for the contact unknowns with a spring (N/m) on each slip row."""
        B = sparse.csc_array(self.system.contact.B)
        return self._condensed.solver_of_kept(B.T @ sparse.diags_array(springs) @ B)

    @cached_property
    def _free(self) -> Callable[[FloatArray], FloatArray]:
        """Solver for the contact unknowns without springs."""
        return self._with_springs(np.zeros(self.system.contact.B.shape[0]))

    def forces(self, V: FloatArray, run: Run) -> FloatArray:
        """Residual R (N) of a run at its stored fields, (n, frames).

        The run is that of ``system.project(V)``, maybe with a law or friction points of its own.
        """
        system, contact = self.system, self.system.contact
        left = system.load_vectors() @ system.load_amplitudes(run.field_times)
        motions = acceleration(run), run.v.T, run.u.T
        for A, x in zip((system.M, system.C, system.K), motions, strict=True):
            left -= (A @ V) @ x
        friction = contact.on_rows(contact.w) * self._friction(V, run)
        return np.asarray(left - contact.B.T @ friction.T)

    def _friction(self, V: FloatArray, run: Run) -> FloatArray:
        """Friction over its limit of all slip rows at the fields of a run, (frames, rows)."""
        slips, repeats = (self.system.contact.B @ V).T, run.steady is not None
        laws = self.system.no_steeper(run.system.contact.steepest)
        return friction_along(laws, run.u @ slips, run.v @ slips, run.field_times, repeats)

    def _springs(self, V: FloatArray, run: Run, R: FloatArray) -> FloatArray:
        """Springs (frames, m), N/m, by which friction holds points on which the forces R act."""
        contact, sigma = self.system.contact, self._friction(V, run)
        slip = run.v @ (contact.B @ V).T
        force = contact.on_rows(contact.w) * sigma
        squares = sparse.csr_array(contact.B).power(2).sum(axis=1)
        force += (contact.B @ R).T / np.where(squares > 0.0, squares, 1.0)
        beta = self.system.no_steeper(run.system.contact.steepest).contact.beta
        slope = law.force_slope(contact.slip_norm(slip), beta)
        slope[contact.slip_norm(force) > contact.w] = 0.0
        rate = RATE / (run.field_times[1] - run.field_times[0])
        springs = contact.w * slope * rate
        if contact.has_springs:
            stretched = np.where(contact.slip_norm(sigma) < 1.0, contact.spring_constants, 0.0)
            springs = np.where(contact.sprung, stretched, springs)
        return np.asarray(springs)

    def _responses(self, V: FloatArray, run: Run) -> Iterator[FloatArray]:
        """Responses (n, frames), m, to the residual: first without springs, then with these."""
        R, whole = self.forces(V, run), self._condensed
        right, still = whole.restrict(np.ascontiguousarray(R))
        yield whole.extend(self._free(right), still)
        springs = self._springs(V, run, R)
        least = LEAST_SPRING * max(float(springs.max(initial=0.0)), 1e-300)
        springs = np.log(np.maximum(springs, least))
        kinds = fclusterdata(springs, SETS, "maxclust", method="ward")
        x = np.zeros_like(right)
        for kind in np.unique(kinds):
            alike = np.flatnonzero(kinds == kind)
            mean = np.exp(springs[alike].mean(axis=0))
            solve = self._with_springs(self.system.contact.on_rows(mean))
            x[:, alike] = solve(np.ascontiguousarray(right[:, alike]))
        yield whole.extend(x, still)

    def missing_modes(self, V: FloatArray, run: Run, most: int, known: FloatArray) -> FloatArray:
        """Modes that the basis of a run is missing.

        Half of them come from each response of the residual. As many more come from ``known``
        motions that the basis should follow.

        Parameters
        ----------
        V : ndarray, shape (n, j)
            Basis of the run, orthonormal in mass.
        run : Run
            With stored fields.
        most : int
            Most modes of the residual, and most modes of known motions.
        known : ndarray, shape (n, s)

        Returns
        -------
        ndarray, shape (n, k)
            Orthonormal in mass, and to V.
        """
        M, stiffness, wide = self.system.M, self._stiffness, V
        motions = [(X, most // 2) for X in self._responses(V, run)]
        for X, more in (*motions, (known, most)):
            new = modes_beyond(wide, X, M, stiffness, NEGLIGIBLE, more)
            wide = np.hstack([wide, new])
        return wide[:, V.shape[1] :]
