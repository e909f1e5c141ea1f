"""Response to a sine whose frequency rises or falls at a rate, cycle by cycle.

A slow sweep has the amplitudes of steady vibration at each frequency. A faster one lags: with a
growth of the angular frequency of r (rad/s²) the peak of a linear mode of the frequency omega and
the damping ratio zeta comes later by 2 r / (zeta omega), to first order in r / (zeta omega)^2, and
is lower to second order (F. M. Lewis, Trans. ASME 54, 1932, has all orders).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Harmonic, Scaled, SweptSine
from skfem_joint.ground.plain_values import Tabular, spread
from skfem_joint.ground.values import POSITIVE, at_least, check
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.system.system import AppliedLoad, System

#: Spectral radius of the scheme, which damps what its steps do not follow, as in ring-downs.
RHO_INFINITY = 0.9
#: Fewest steps in a cycle of the highest frequency: with 20 half of peak to peak errs by 1 %.
FEWEST_STEPS = 20


@dataclass(frozen=True)
class SweptResponse(Tabular):
    """Response to a swept sine.

    Attributes
    ----------
    level : float
        Factor of the loads' amplitudes.
    rate : float
        Octaves per minute; below zero where the frequency falls.
    frequency : ndarray, shape (cycles,)
        Of the loads in the middle of each of their cycles, Hz.
    amplitude : ndarray, shape (cycles, points)
        Half of peak to peak of each named point in it, m.
    """

    level: float
    rate: float
    frequency: FloatArray
    amplitude: FloatArray

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each cycle, as ``swept.csv``, points by their numbers."""
        return {"frequency_Hz": self.frequency, **spread("amplitude_{}_m", self.amplitude)}

    @property
    def peak(self) -> tuple[float, float]:
        """Frequency (Hz) and amplitude (m) of the largest cycle of the point that moves most."""
        largest = self.amplitude[:, self.amplitude.max(axis=0).argmax()]
        k = int(largest.argmax())
        return float(self.frequency[k]), float(largest[k])


def swept_response(
    system: System,
    frequencies: tuple[float, float],
    rate: float,
    level: float = 1.0,
    *,
    steps_per_cycle: int = 200,
    progress: Callable[..., None] | None = None,
) -> SweptResponse:
    """Vibration from rest under loads whose frequency goes from one value to another.

    Parameters
    ----------
    system : System
        Full, condensed, or reduced for a response; its loads are `Harmonic`, of one frequency and
        in phase.
    frequencies : tuple of float
        First and last frequency, Hz. It falls where the last one is lower. The vibration that the
        start sets off takes some 1 / (damping ratio) cycles to decay.
    rate : float
        Octaves per minute, above 0.
    level : float
        Factor of the loads' amplitudes.
    steps_per_cycle : int
        Time steps in a cycle of the highest frequency; natural frequencies are too low by 8e-5 of
        their value with 200, and by 1e-3 with 57.
    progress : callable, optional
        Called with (steps done, steps in all).

    Returns
    -------
    SweptResponse

    Raises
    ------
    InputError
        If a number is out of range, a load is not harmonic, or not of the frequency and phase of
        the others, nothing is observed, or the system is a reduced model made for something else or
        for a range.
    ConvergenceError
        If a step does not converge.
    """
    system.check_any_load("response", level)
    if system.serves is not None:
        raise InputError(
            "swept_response: found a reduced model for a range, whose points have one frequency; "
            "give the full system, or one by sj.condense or sj.reduce(frequency=, level=)"
        )
    check("swept_response: level", level, POSITIVE)
    check("swept_response: steps_per_cycle", steps_per_cycle, at_least(FEWEST_STEPS))
    if not system.points:
        raise InputError("swept_response: nothing is observed; name a point")
    if np.shape(frequencies) != (2,):
        raise InputError("swept_response: frequencies: must be two, the first and the last one")
    first, last = frequencies
    loads = swept_loads(system, first, last, rate, level)
    signed = rate if last > first else -rate
    growth = np.log(2.0) / 60.0 * signed
    # So many cycles after its beginning the sine is at t: first (exp(growth t) - 1) / growth.
    cycles = np.arange(int((last - first) / growth * (1.0 + 1e-12)) + 1)
    if cycles.size < 2:
        raise InputError(
            f"swept_response: rate: found {rate:g} octaves a minute, at which the sweep is over "
            "within a cycle; give a lower one"
        )
    ends = np.log1p(growth * cycles / first) / growth
    step = 1.0 / (max(frequencies) * steps_per_cycle)
    count = int(np.ceil(np.log(last / first) / growth / step))
    plan = Plan(step, count, generalized_alpha(RHO_INFINITY))
    swept = replace(system, loads=loads)
    run = integrate_plan(swept, plan, progress=progress).finished()
    *rows, end = np.searchsorted(run.times, ends).tolist()
    high, low = (f.reduceat(run.point_u[:end], rows, axis=0) for f in (np.maximum, np.minimum))
    middle = 0.5 * (ends[:-1] + ends[1:])
    return SweptResponse(level, signed, first * np.exp(growth * middle), 0.5 * (high - low))


def swept_loads(
    system: System, first: float, last: float, rate: float, level: float = 1.0
) -> tuple[AppliedLoad, ...]:
    """Harmonic loads of a system as swept sines; InputError as of `swept_response`."""
    swept, phases, frequencies = [], set(), set()
    for load in system.loads:
        amplitude: Any = load.amplitude
        scaled = isinstance(amplitude, Scaled)
        of, factor = (amplitude.of, amplitude.factor) if scaled else (amplitude, 1.0)
        if not isinstance(of, Harmonic):
            raise InputError(
                f"swept sine: load on {load.on!r}: found {type(of).__name__}, must be Harmonic"
            )
        sweep = SweptSine(level * factor * of.amplitude, first, last, rate)
        swept.append(replace(load, amplitude=sweep))
        phases.add(of.phase)
        frequencies.add(of.frequency)
    if len(phases) != 1:
        raise InputError("swept sine: needs loads, all of the same phase")
    if len(frequencies) > 1:
        found = ", ".join(f"{frequency:g}" for frequency in sorted(frequencies))
        raise InputError(
            f"swept sine: found loads of {found} Hz, must be of one frequency, which is swept; "
            "sweep those of each frequency by themselves"
        )
    return tuple(swept)
