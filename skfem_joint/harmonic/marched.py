"""Levels of a nonlinear mode judged by time steps.

Time steps start on the motion of the mode, under the force 2 zeta omega M du/dt of that motion as a
load, by a method that shares nothing with harmonic balance but the law. If the mode is right they
stay on it. A mode of another frequency and damping turns and grows by

    2 pi (omega' / omega - 1),   2 pi (zeta - zeta')

in a period, as logarithm of its first harmonic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.loads import Harmonic
from skfem_joint.harmonic.levels import NEGLIGIBLE, Levels
from skfem_joint.harmonic.points import state_of
from skfem_joint.runs.integrate import TOLERANCE
from skfem_joint.stepping.driver import Driver
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.system.system import AppliedLoad

#: Periods, least steps in each, and least steps in a period of the highest harmonic.
PERIODS, STEPS, FEWEST = 3, 400, 16
#: Spectral radius of the scheme, as of a ring-down.
RHO_INFINITY = 0.9


@dataclass(frozen=True)
class Marched:
    """Some levels of a mode, judged by time steps with the same springs.

    Attributes
    ----------
    levels : ndarray of int, shape (k,)
    frequency, damping_ratio : ndarray, shape (k,)
        Relative differences of the marched values from those of the mode; nan where time steps do
        not converge, zero of a damping that is negligible.
    notes : tuple of str
        Why they do not.
    """

    levels: IntArray
    frequency: FloatArray
    damping_ratio: FloatArray
    notes: tuple[str, ...] = ()


def march(levels: Levels, rows: IntArray) -> Marched:
    """Some levels, by number, judged by time steps."""
    both, notes = np.full((rows.size, 2), np.nan), []
    for k, row in enumerate(rows.tolist()):
        try:
            both[k] = _differences(levels, row)
        except ConvergenceError as error:
            notes.append(
                f"time steps, which judge the level number {row + 1}, do not converge: {error}"
            )
    return Marched(rows, both[:, 0], both[:, 1], tuple(notes))


def _differences(levels: Levels, k: int) -> tuple[float, float]:
    """Relative differences in frequency and damping of one level."""
    equations, series = levels.equations, levels.series
    balance, u = equations.balance, levels.u[k]
    omega, zeta = float(levels.omega[k]), float(levels.zeta[k])
    rate = series.rate(u)
    system, steps = balance.system.with_beta(np.inf), max(STEPS, FEWEST * series.highest)
    pushed = 2.0 * zeta * omega**2 * (rate @ as_dense(system.M))
    loads = []
    for place, order in enumerate(series.orders.tolist()):
        a = series.first + 2 * place
        frequency = order * omega / (2.0 * np.pi)
        loads.append(AppliedLoad(pushed[a], Harmonic(1.0, frequency, 0.5 * np.pi)))
        loads.append(AppliedLoad(pushed[a + 1], Harmonic(1.0, frequency)))
    looked = equations.looked_at[np.newaxis]
    system = replace(
        system, loads=tuple(loads), P=looked, points=("seen",), made_for="", serves=None
    )
    plan = Plan(
        step=2.0 * np.pi / omega / steps,
        n_steps=PERIODS * steps,
        scheme=generalized_alpha(RHO_INFINITY),
        save=Save(),
        cycle_steps=steps,
    )
    # not by `integrate`, which refuses loads that begin with a jump: the motion is under way
    driver = Driver(system, plan, state_of(balance, balance.inner(u), omega), TOLERANCE)
    driver.run(None, None, "")
    run = driver.finish(0.0).finished()
    angle = 2.0 * np.pi * np.arange(steps) / steps
    wave = np.exp(-1j * angle)
    seen = run.point("seen")
    first, last = (complex(wave @ seen[j * steps : (j + 1) * steps]) for j in (0, PERIODS - 1))
    drift = np.log(last / first) / (2.0 * np.pi * (PERIODS - 1))
    return float(drift.imag), float(-drift.real / zeta) if zeta > NEGLIGIBLE else 0.0
