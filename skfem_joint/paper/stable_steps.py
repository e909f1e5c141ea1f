"""Stable steps of the reference system, full and reduced, computed and measured (section 7.5)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from scipy import linalg
from scipy.optimize import bisect

from skfem_joint import explicit
from skfem_joint.errors import ConvergenceError
from skfem_joint.integrate import integrate
from skfem_joint.loads import RampAndHold
from skfem_joint.paper.cases import CASES, PLAIN, study
from skfem_joint.recording import Save
from skfem_joint.study import Study
from skfem_joint.system import System

CASE = CASES["reference"]
MODES = 15
CYCLES, STEPS = 3, 200
#: A displacement beyond so many times the static one counts as unstable.
GROWTH = 1e3


@cache
def reference(modes: int, own: bool) -> Study:
    """Reference system reduced by its own displacement modes, or by this package's default."""
    return study(
        CASE,
        run=("reduced",),
        time={"cycles": CYCLES, "steps_per_cycle": STEPS},
        reduction=(PLAIN | {"active_length": "auto", "reference": "self"} if own else {})
        | {"modes": modes},
    )


def systems(modes: int = 5) -> dict[str, System]:
    """Full reference system and its projection on its own first displacement modes."""
    made = reference(MODES, True)
    basis = made.models["reduced"].basis
    if basis is None:
        raise ValueError("a reduced model has a basis")
    return {"full": made.system, "reduced": made.system.project(basis[:, :modes])}


def without_friction(system: System, damped: bool) -> System:
    """Linear part of a system, with or without C, under a step load."""
    none = np.zeros(0)
    step_load = RampAndHold(CASE.force, 1e-12)
    return replace(
        system,
        B=system.B[:0],
        w=none,
        beta=none,
        directions=none.astype(np.int64),
        C=system.C if damped else 0.0 * system.C,
        loads=tuple(replace(load, amplitude=step_load) for load in system.loads),
    )


def largest_frequency(system: System) -> float:
    """Of (K, M), rad/s."""
    K, M = (np.asarray(A if system.is_dense else A.toarray()) for A in (system.K, system.M))
    return float(np.sqrt(linalg.eigh(K, M, eigvals_only=True)[-1]))


def measured_step(system: System, shortest: float, longest: float, n_steps: int) -> float:
    """Largest stable Runge-Kutta step of a linear system, by running to the edge and bisecting, s.

    A run is unstable if a named point exceeds `GROWTH` times its static displacement.
    """
    static = CASE.force * CASE.length / (200e9 * 0.05 * 0.01)

    def is_stable(logarithm: float) -> float:
        step = float(np.exp(logarithm))
        try:
            run = explicit.runge_kutta(system, step=step, n_steps=n_steps, check=False)
        except ConvergenceError:
            return -1.0
        return 1.0 if run.peak.max() <= GROWTH * static else -1.0

    return float(np.exp(bisect(is_stable, np.log(shortest), np.log(longest), xtol=2e-3)))


def chatter(system: System, step: float) -> float:
    """Error of the slip velocities after a Runge-Kutta run with friction and this step, percent.

    Against an implicit run, relative to the largest slip velocity; steps beyond the stable one.
    """
    n_steps = min(2000, int(0.2 / CASE.frequency / step))
    run = explicit.runge_kutta(
        system, step=step, n_steps=n_steps, check=False, save=Save(points=False)
    )
    exact = integrate(system, step=step * n_steps / STEPS, n_steps=STEPS, save=Save(points=False))
    slip = system.B @ exact.final[1]
    return float(100.0 * np.abs(system.B @ run.final[1] - slip).max() / np.abs(slip).max())
