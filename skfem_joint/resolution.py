"""Whether a time step is short enough for what a load does, before anything is integrated.

A step that is too long gives a smooth, energetically sound, wrong answer: sampled too seldom a
harmonic load is another load, a pulse may fall between two steps, and a load that jumps sets off a
vibration that the steps cannot follow. All three can be told in advance.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from skfem_joint.contact_solver import ContactProblem, contact_unknowns
from skfem_joint.errors import InputError
from skfem_joint.steppers import picks_unknowns
from skfem_joint.system import AppliedLoad, System

FloatArray = NDArray[np.float64]

#: Steps that a period of the load needs. At 8 the displacement may be off by more than a fifth.
PER_PERIOD = 8
#: Steps in the rise time of a pulse, or in the duration of a rectangle.
PER_RISE = 2
#: Steps in a period of the free vibration that a jump of the load sets off.
PER_VIBRATION = 10


def check_resolution(system: System, step: float, n_steps: int) -> None:
    """See that the step follows each load and what it sets off.

    Pulses shorter than PER_RISE steps are allowed where the vibration of the loaded unknowns
    themselves is resolved: the driver ends steps at the pulse's corners, so that its momentum is
    right, and nothing is fast enough to need more. Smooth pulses, whose corners do not show their
    shape, are not.

    Raises
    ------
    InputError
        Naming the load, what is too fast, and the step that would do.
    """
    problems = []
    for load in system.loads:
        amplitude = load.amplitude
        if amplitude.peak_value == 0.0 or not np.any(load.vector):
            continue
        where = f"load on {load.on!r}" if load.on else "load"
        frequency = amplitude.highest_frequency
        if frequency is not None and amplitude.period is not None:
            if step * frequency * PER_PERIOD > 1.0 + 1e-9:
                problems.append(
                    f"{where}: a step of {step:.4g} s is longer than 1/{PER_PERIOD} of its "
                    f"fastest period; use a step of at most {1.0 / frequency / PER_PERIOD:.4g} s"
                )
        elif frequency is not None:
            rise = 0.5 / frequency
            unseen = _round_pulse(amplitude) or step * PER_VIBRATION > _period(system, load)
            if step * PER_RISE > rise * (1.0 + 1e-9) and unseen:
                problems.append(
                    f"{where}: a step of {step:.4g} s is too long for a pulse that rises in "
                    f"{rise:.4g} s; use a step of at most {rise / PER_RISE:.4g} s"
                )
        if _jumps(amplitude, step * n_steps):
            period = _period(system, load, slowest=True)
            if step * PER_VIBRATION > period * (1.0 + 1e-9):
                problems.append(
                    f"{where}: it jumps, and a step of {step:.4g} s does not follow the vibration "
                    f"of period {period:.4g} s that this sets off; use a step of at most "
                    f"{period / PER_VIBRATION:.4g} s, or let the load rise in a ramp"
                )
    if problems:
        raise InputError(problems)


def _jumps(amplitude: Any, end: float) -> bool:
    """Whether a load sets in at its start or jumps later on."""
    peak = amplitude.peak_value
    times = [t for t in (0.0, *amplitude.corners) if 0.0 <= t < end]
    for t in times:
        before = 0.0 if t == 0.0 else float(amplitude(np.nextafter(t, 0.0)))
        if abs(float(amplitude(t)) - before) > 1e-6 * peak:
            return True
    return False


def _round_pulse(amplitude: Any) -> bool:
    """Whether a pulse is not made of straight lines between its corners."""
    corners = sorted(amplitude.corners)
    for a, b in pairwise(corners):
        inside = np.array([np.nextafter(a, b), 0.5 * (a + b), np.nextafter(b, a)])
        first, middle, last = np.asarray(amplitude(inside))
        if abs(middle - 0.5 * (first + last)) > 1e-6 * amplitude.peak_value:
            return True
    return not corners


def _period(system: System, load: AppliedLoad, slowest: bool = False) -> float:
    """Period of vibration by Rayleigh's quotient, s.

    Of the loaded unknowns with all others held, the fastest that the load can set off, or
    (``slowest``) of the shape in which the load bends the system statically. Zero: nothing moves.
    """
    u = _static_shape(system, load) if slowest else np.asarray(load.vector, dtype=float)
    stiffness, mass = float(u @ (system.K @ u)), float(u @ (system.M @ u))
    return float(2.0 * np.pi * np.sqrt(mass / stiffness)) if stiffness > 0.0 else np.inf


def _static_shape(system: System, load: AppliedLoad) -> FloatArray:
    """Displacement under the load at its peak, m, with joints that hold what they can.

    A load below the friction limit moves a part of the joint only, which vibrates the faster the
    smaller it is. In dense systems points share their unknowns: there friction is left out.
    """
    f: FloatArray = np.asarray(load.vector, dtype=float) * load.amplitude.peak_value
    acting = system.w > 0.0
    if not system.is_dense and acting.any() and picks_unknowns(system.B, distinct=True):
        K, M = (sparse.csr_array(A) for A in (system.K, system.M))
        # Bodies that friction alone holds have no stiffness of their own.
        small = 1e-9 * K.diagonal().sum() / M.diagonal().sum()
        first, second = contact_unknowns(system)
        problem = ContactProblem(
            sparse.csr_array(K + small * M),
            first[acting],
            second[acting],
            system.w[acting],
            np.full(int(acting.sum()), np.inf),
        )
        found = problem.solve(f, np.zeros(system.n), 1e-6)
        # Where all sticks nothing moves under Coulomb; a regularised law lets it creep.
        if found.converged and (np.any(found.v) or np.isinf(system.beta[acting]).all()):
            return found.v
    try:
        return np.asarray(
            linalg.solve(system.K, f, assume_a="sym")
            if isinstance(system.K, np.ndarray)
            else splu(sparse.csc_array(system.K)).solve(f)
        )
    except (linalg.LinAlgError, RuntimeError):
        return np.zeros_like(f)  # nothing holds it: it does not vibrate but moves away
