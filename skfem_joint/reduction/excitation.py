"""The loads of a run to come, and the steps of the short runs that models are made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Amplitude, common_period
from skfem_joint.runs.resolution import longest_step
from skfem_joint.stepping.plan import Plan
from skfem_joint.system.system import System

#: Cycles of quick runs, of which only slip and forces are needed, roughly.
CYCLES = 4
#: Fewest steps of a quick run in a cycle, and in the shortest period of the loads.
LEAST_STEPS, STEPS_PER_PERIOD = 100, 20


def repeats(system: System, duration: float | None = None) -> bool:
    """Whether all loads repeat together within a duration, s, or ever."""
    period = common_period(load.amplitude for load in system.loads)
    if period is None or any(load.amplitude.period is None for load in system.loads):
        return False
    return duration is None or duration >= period


@dataclass(frozen=True)
class Excitation:
    """Loads that act in a run to come, each scaled to an amplitude of one at its peak.

    Attributes
    ----------
    vectors : ndarray, shape (n, loads)
        Force vector of each load at its peak, N.
    amplitudes : tuple of Amplitude
        Functions of time of the loads.
    peak : ndarray, shape (loads,)
        Peak of each amplitude, N.
    plan : Plan
        Steps of the run.
    period : float, optional
        Common period of all loads, s; None where a load does not repeat within the run.
    """

    vectors: FloatArray
    amplitudes: tuple[Amplitude, ...]
    peak: FloatArray
    plan: Plan
    period: float | None

    @staticmethod
    def of(system: System, plan: Plan) -> Excitation:
        """Loads of a system that act in a run; InputError if there is none."""
        period = None
        if repeats(system, plan.duration):
            period = common_period(load.amplitude for load in system.loads)
        steps = plan.n_steps
        if period is not None:
            steps = min(steps, round(2.0 * period / plan.step))
        times = plan.step * np.arange(steps + 1, dtype=float)
        peak = np.abs(system.load_amplitudes(times)).max(axis=1, initial=0.0)
        act = np.flatnonzero(peak * np.abs(system.load_vectors()).max(axis=0))
        if act.size == 0:
            raise InputError(
                "reduction: nothing moves, no load acts in the run; give one, or run 'full' alone"
            )
        amplitudes = tuple(system.loads[k].amplitude for k in act)
        vectors = system.load_vectors()[:, act] * peak[act]
        return Excitation(vectors, amplitudes, peak[act], plan, period)

    def __call__(self, times: FloatArray) -> FloatArray:
        """Amplitudes over their peaks at some times (s), shape (loads, times)."""
        return np.stack([a(times) for a in self.amplitudes]) / self.peak[:, np.newaxis]

    @property
    def fastest(self) -> float:
        """Highest known angular frequency of the loads, at least that of the whole run, rad/s."""
        known = [a.highest_frequency or 0.0 for a in self.amplitudes]
        return 2.0 * np.pi * max(*known, 1.0 / self.plan.duration)

    @property
    def rise_time(self) -> float:
        """Time in which the loads rise to their peaks, s; a quarter of a harmonic's period."""
        if self.is_one_harmonic and self.period is not None:
            return 0.25 * self.period
        known = [a.highest_frequency for a in self.amplitudes]
        rise = 0.5 / known[0] if len(known) == 1 and known[0] else np.inf
        return min(rise, self.plan.duration)

    @property
    def is_one_harmonic(self) -> bool:
        """Whether a single load acts, with a single harmonic, and repeats within the run."""
        return self.period is not None and [len(a.harmonics) for a in self.amplitudes] == [1]

    def forces(self, times: FloatArray, inertia: FloatArray) -> FloatArray:
        """Loads with the inertia of their quasi-static response, shape (times, n), N.

        A harmonic of angular frequency ω adds ω² M u, with the static response u to the load.
        ``inertia`` (n, loads) is M u for the peak of each load.
        """
        forces = self(times).T @ self.vectors.T
        for k, amplitude in enumerate(self.amplitudes):
            for harmonic in amplitude.harmonics:
                square = (2.0 * np.pi * harmonic.frequency) ** 2 / self.peak[k]
                forces += square * np.outer(harmonic(times), inertia[:, k])
        return forces


def steps_of_a_period(
    system: System,
    period: float,
    cycles: int,
    highest: float,
    most: int,
    vibrates: bool = True,
) -> int:
    """Fewest steps in a period (s) of a quick run, but no more than ``most``.

    They resolve the ``highest`` frequency of the loads (Hz), and, where inertia acts, the vibration
    after jumps of the loads in all ``cycles``.
    """
    least = max(STEPS_PER_PERIOD * highest * period, LEAST_STEPS)
    least = max(least, period / longest_step(system, cycles * period, vibrates))
    return min(most, int(np.ceil(least * (1.0 - 1e-9))))
