"""Free vibration of a mode: frequency and damping against amplitude, to compare with its curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.signal import butter, find_peaks, sosfiltfilt

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import Scheme
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.analysis.backbone import Backbone

#: Cycles at the end of a ring-down that are left out.
ENDS = 2


@dataclass(frozen=True)
class RingDown:
    """Free vibration of a mode: an entry for each cycle, at rising times."""

    time: FloatArray  #: of the peak that a cycle begins with, s
    amplitude: FloatArray  #: modal, mean over the cycle, m kg^1/2
    frequency: FloatArray  #: without damping, Hz
    damping_ratio: FloatArray  #: by the logarithmic decrement
    energy: FloatArray  #: (periods + 1,) of all modes, at whole periods of the stuck one, J
    friction_work: FloatArray  #: (periods + 1, joints) of each joint up to then, J


def ring_down(
    system: System,
    curve: Backbone,
    cycles: int,
    steps_per_cycle: int = 200,
    scheme: Scheme | None = None,
    start: tuple[FloatArray, FloatArray] | None = None,
    progress: Callable[..., None] | None = None,
) -> RingDown:
    """Free vibration of a mode, released at rest from the highest level of its curve or as it is.

    ``start`` is a displacement (m) and a velocity (m/s) to begin with, such as ``run.final`` of a
    run whose pulse has ended; the loads act no more. The system's own law acts. Of modes that ring
    together one is told by its modal displacement, phi^T M u; half of peak to peak has no part of
    what joints come to rest at. What is left above twice the mode's frequency is filtered out,
    forwards and backwards so that peaks stay where they are. ``progress`` is that of `integrate`.

    Raises
    ------
    InputError
        If too few cycles are asked for.
    ConvergenceError
        If a step does not converge, or no cycle is left to measure.
    """
    if cycles < 2 * ENDS:
        raise InputError(f"ring_down: found {cycles} cycles, must be at least {2 * ENDS}")
    modal = sparse.csr_array((system.M @ curve.shape)[np.newaxis])
    alone = replace(system, loads=(), P=modal, points=("modal",))
    step = 1.0 / curve.stuck_frequency / steps_per_cycle
    run = integrate(
        alone,
        step=step,
        n_steps=cycles * steps_per_cycle,
        scheme=scheme,
        save=Save(fields=True, fields_every=steps_per_cycle),
        initial=(curve.states[-1], np.zeros(system.n)) if start is None else start,
        progress=progress,
    ).finished()
    low = butter(4, 2.0 * curve.stuck_frequency, fs=1.0 / step, output="sos")
    q = sosfiltfilt(low, run.point("modal"))
    q *= np.sign(q[np.abs(q).argmax()])  # a mode has no sign of its own
    tops, bottoms = (find_peaks(sign * q, distance=steps_per_cycle // 2)[0] for sign in (1.0, -1.0))
    tops = tops[tops >= steps_per_cycle // 2]  # which the filter sees whole, as below
    bottoms = bottoms[np.searchsorted(bottoms, tops[0]) if tops.size else 0 :]
    count = min(tops.size - 1, bottoms.size) - ENDS
    if count < 1:
        raise ConvergenceError("ring_down: no cycle is left to measure; ask for more")
    (top, at), bottom = _extremes(q, tops), _extremes(q, bottoms)[0]
    half = 0.5 * (0.5 * (top[:-1] + top[1:])[: count + 1] - bottom[: count + 1])
    decrement = np.log(half[:-1] / half[1:])
    whole = np.hypot(2.0 * np.pi, decrement)  # angle of a cycle, had it no damping
    return RingDown(
        time=at[:count] * step,
        amplitude=np.sqrt(half[:-1] * half[1:]),
        frequency=whole / (np.pi * (at[2:] - at[:-2])[:count] * step),
        damping_ratio=decrement / whole,
        energy=np.array([system.stored_energy(u, v) for u, v in zip(run.u, run.v, strict=True)]),
        friction_work=run.joint_work[::steps_per_cycle],
    )


def _extremes(q: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Values and places (rows) of extremes, by parabolas through three samples."""
    a, b, c = q[rows - 1], q[rows], q[rows + 1]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c)
    return b - 0.25 * (a - c) * shift, rows + shift
