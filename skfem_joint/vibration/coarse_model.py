"""A reduced model beside a larger one, whose responses it makes cheaper.

At each frequency its own steady vibration gives two things. The derivative of its map of a period
corrects the search for the larger model's vibration (:mod:`skfem_joint.steady.correction`). Its
vibration with half the step gives the error of the step, which in the larger model would take as
long as the vibration itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.reduction.basis import MANY_MODES, Options
from skfem_joint.reduction.models import reduced_for_response
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.runs.steady_run import MOST
from skfem_joint.steady.correction import Correction
from skfem_joint.steady.steady import odd_loads
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.recording import Save
from skfem_joint.system.system import System
from skfem_joint.vibration.response import (
    Guide,
    at_frequency,
    error_of_step,
    steady_plan,
    steady_point,
)
from skfem_joint.vibration.response_curve import SteadyPoint


@dataclass(frozen=True)
class CoarseModel:
    """A reduced model and its place in a larger one.

    Attributes
    ----------
    system : System
        Reduced, with the loads of the larger one.
    down : ndarray, shape (k, n)
        Its displacement of one of the larger model.
    up : ndarray, shape (n, k)
        The larger model's displacement of one of it.
    """

    system: System
    down: FloatArray
    up: FloatArray

    @staticmethod
    def of(
        full: System, frequency: float, level: float, basis: FloatArray | None
    ) -> CoarseModel | None:
        """Coarse model of a system with harmonic loads, or None where none would help.

        Parameters
        ----------
        full : System
            The full system, with harmonic loads.
        frequency, level : float
            Frequency (Hz) and level that its modes are made at.
        basis : ndarray, shape (n, j), or None
            Basis of the larger model, None for the full one.

        Raises
        ------
        InputError
            If nothing moves under the loads, or slip rows depend on each other.
        ConvergenceError
            If a state of the static slip path does not converge.
        """
        size = full.n if basis is None else basis.shape[1]
        # Not of contact that opens either, where no load counts as odd.
        if not full.contact.count or size <= MOST or not odd_loads(full):
            return None
        if arranged(full).kind == "chain":
            return None
        small = reduced_for_response(full, frequency, level, Options(modes=MANY_MODES))
        V, M = small.origin.basis.V, full.M
        cross, own = V.T @ (M @ (V if basis is None else basis)), V.T @ (M @ V)
        if basis is None:
            return CoarseModel(small, np.linalg.solve(own, np.asarray((M @ V).T)), V)
        up = np.linalg.solve(basis.T @ (M @ basis), cross.T)
        return CoarseModel(small, np.linalg.solve(own, cross), up)

    def guide(
        self, frequency: float, level: float, steps_per_cycle: int, finer: int | None
    ) -> Guide:
        """What its vibration says of that of the larger model, see `Guide`."""
        point = steady_point(self.system, frequency, level, steps_per_cycle)
        if point.failure is not None or point.state is None:
            return Guide(np.nan, np.nan, None)
        error, k = np.nan, int(point.amplitude.argmax())
        if finer is not None:
            other = steady_point(self.system, frequency, level, finer, point.state)
            error = error_of_step(point.amplitude[k], other.amplitude[k], steps_per_cycle, finer)
        return Guide(
            float(point.amplitude[k]), error, self._correction(point, level, steps_per_cycle)
        )

    def _correction(
        self, point: SteadyPoint, level: float, steps_per_cycle: int
    ) -> Correction | None:
        """Correction by the derivative of its map where it vibrates steadily."""
        loaded = at_frequency(self.system, point.frequency, level)
        plan = steady_plan(loaded, steps_per_cycle)
        half = replace(plan, until="end", n_steps=plan.n_steps // 2, save=Save(fields=True))
        run = integrate_plan(loaded, half, initial=point.state)
        return Correction.of(loaded, plan, run.v[1:], self.down, self.up)
