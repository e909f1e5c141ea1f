"""The condensed model that errors of reduced ones are measured against, where contact is small.

A condensed model keeps the slips of all contact points and the full model's law. With a few more
fixed-interface modes than it takes by itself it errs by some hundredths of a percent: on eight
plates of 900 to 2,900 unknowns with two to five bolts under Coulomb's law its friction energy was
0.01 to 0.06 % off, where a reduced model with 150 to 230 modes of residuals beside its own was
still 0.1 to 1.2 % off, and took three times as long. So it shows what a reduced model misses.

A chain, whose steps cost less than those of its condensed model, is its own reference.

Its run also shows the slip that a basis misses: proper orthogonal modes of its states and
velocities, without what the basis spans. Some 60 of them left 0.3 % of the friction energy of these
plates, as many modes of residuals 1 to 2 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, Matrix
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.shifts import shifted
from skfem_joint.reduction.condensed import reference_model
from skfem_joint.reduction.pod import modes_beyond
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.system import System

#: Largest product of the steps of a run and the square of its slip rows, where the full model's
#: law is steeper than the reduced model's.
WORK = 6e8


@dataclass(frozen=True)
class CondensedReference:
    """Condensed model of a system, and its runs.

    Attributes
    ----------
    system : System
        The full model.
    small : System
        The condensed model; the full one where that takes its place: of chains, and in slow runs
        where contact is large.
    times : float
        How many times as much work as by itself a run may take.
    """

    system: System
    small: System
    times: float = 1.0
    _runs: dict[tuple[Any, ...], Run] = field(default_factory=dict, repr=False)

    @staticmethod
    def of(system: System, shared: bool = False) -> CondensedReference | None:
        """Condensed model of a full system; None if contact is large, or slips are no unknowns.

        ``shared`` is whether several estimates use its runs.
        """
        # So many times as much work where several estimates share its runs, as in the search for a
        # model of some accuracy. (On a plate with six bolts, whose step had become eight times as
        # short, modes of residuals took 300 s for each estimate, and did not end.)
        opens, times = system.contact.opens, 4.0 if shared else 1.0
        if not opens and arranged(system).kind == "chain":  # whose steps cost less than condensed
            return CondensedReference(system, system, times)
        # With more slip rows that carry friction contact is large.
        if not opens and (system.is_dense or not 0 < _rows(system) <= 700):
            return None
        try:
            return CondensedReference(system, reference_model(system), times)
        except InputError:  # slip rows depend on each other: there is no condensed model
            if opens:  # nor any other that is better
                raise
            return None

    @property
    def V(self) -> Matrix:
        """Basis of the condensed model, not orthonormal, (n, j)."""
        whole = self.small is self.system
        return sparse.eye_array(self.system.n) if whole else self.small.origin.basis.V

    def affords(self, plan: Plan, periods: int = 1, steeper: bool = True) -> bool:
        """Whether a run costs little enough.

        Parameters
        ----------
        plan : Plan
            Of the run.
        periods : int
            Periods until it is steady, where the plan is of one.
        steeper : bool
            Whether the full model's law is steeper than the reduced model's. Otherwise modes of
            residuals do well, and less is spent.
        """
        steps = plan.n_steps * periods
        if self.system.contact.opens:  # then with all of its unknowns
            return plan.n_steps * self.small.n**2 <= 1e8
        if plan.quasi_static:
            return True
        if self.small is self.system:  # a chain
            return steps * self.system.n <= self.times * WORK
        most = WORK if steeper else 2e7
        return steps * _rows(self.system) ** 2 <= self.times * most

    def run(self, plan: Plan, verify: Callable[..., Run]) -> Run:
        """Run of the condensed model with fields; made once for each plan."""
        key = plan.step, plan.n_steps, plan.until, plan.save.points
        if key not in self._runs:
            # Fewest instants of a run that missing modes are made of.
            every = max(1, plan.n_steps // 200)
            self._runs[key] = verify(self.small, plan, fields_every=every)
        return self._runs[key]

    def missing_modes(self, V: FloatArray, run: Run, most: int) -> tuple[FloatArray, FloatArray]:
        """Basis with the modes of a run of this model that ``V`` misses, and its velocities.

        Parameters
        ----------
        V : ndarray, shape (n, j)
            Basis of a reduced model, orthonormal in mass.
        run : Run
            Of `run`.
        most : int
            Most modes that are added.

        Returns
        -------
        tuple of ndarray
            V with the new modes (n, j + k), and velocities of its coordinates (times, j + k).
        """
        M, stiffness = self.system.M, shifted(self.system.K, self.system.M)
        parts = []
        for x in (run.u, run.v):
            size = float(np.sqrt(max(np.vdot(x.T, self.small.K @ x.T), 0.0)))
            parts.append(self.V @ (x.T / (size or 1.0)))
        wide = np.hstack([V, modes_beyond(V, np.hstack(parts), M, stiffness, 1e-6, most)])
        return wide, np.asarray(run.v @ (self.V.T @ (M @ wide)))


def _rows(system: System) -> int:
    """Slip rows of the points that carry friction."""
    return int(np.count_nonzero(system.contact.on_rows(system.contact.w)))
