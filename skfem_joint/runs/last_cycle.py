"""The last cycle of a run: its peaks and energies, and whether it has become steady."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.stepping.recording import Run

#: Share of the energy in play below which an energy is round-off: forces are in balance to 1e-11.
ROUND_OFF = 1e-11
#: The same over the energy that a period of steady vibration gains: a search ends at 5,000.
GAINED = 100.0


#: Share by which cycles of a steady state may differ.
_SAME = 2e-3


@dataclass(frozen=True)
class SteadyState:
    """How much the last cycle differs from the one before.

    Attributes
    ----------
    reached : bool
        Whether both changes stay below the tolerance asked for.
    energy_change : float
        Relative change of the work put in.
    peak_change : float
        Change of the peaks, relative to the largest. Of a quasi-static run both are how far the
        last cycle is from being closed, relative to its size (`Loops.opening`): its first cycle,
        from rest, is unlike the others, of which each is closed.
    """

    reached: bool
    energy_change: float
    peak_change: float


def steady_state(run: Run) -> SteadyState | None:
    """Compare the last two cycles; None when the run has fewer than two.

    Of a quasi-static run the last cycle is compared with itself: whether it ends where it began.
    """
    if run.loops is not None:
        gap = run.loops.opening
        return None if gap is None else SteadyState(gap <= _SAME, gap, gap)
    cycles = run.cycles
    if cycles.friction.size < 2:
        return None
    work = np.abs(beyond_round_off(run, cycles.input.sum(axis=1)))
    energy = abs(work[-1] - work[-2]) / work[-1] if work[-1] > 0.0 else 0.0
    largest = cycles.peak[-1].max(initial=0.0)
    change = np.abs(cycles.peak[-1] - cycles.peak[-2]).max(initial=0.0)
    peak = change / largest if largest > 0.0 else 0.0
    return SteadyState(bool(max(energy, peak) <= _SAME), float(energy), float(peak))


def peaks(run: Run) -> FloatArray:
    """Peak of each named point: in the last cycle, or in the whole run without cycles, m."""
    return run.cycles.peak[-1] if run.cycles.peak.shape[0] else run.peak


def beyond_round_off(run: Run, energy: ArrayLike) -> FloatArray:
    """Energies of a run, J, with zero in place of those that are round-off.

    They are compared with the largest energy in play that is known: works, what is stored at the
    start and the end, and the strain energy of the loads' points at their peaks. A period of steady
    vibration tells nothing of losses that are not far above what it gains itself, which the search
    leaves.
    """
    system, works = run.system, (run.viscous_work, run.scheme_work, run.impact_work)
    peaks_at = dict(zip(system.points, run.peak.tolist(), strict=False))
    strain = 0.0
    for k, load in enumerate(system.loads):
        largest = load.amplitude.peak_value
        if largest is None:
            largest = float(np.abs(run.amplitudes[:, k]).max(initial=0.0))
        strain += 0.5 * largest * peaks_at.get(load.on, 0.0)
    in_play = max(
        strain, *map(abs, (*run.stored_energy, *works)), float(np.abs(run.input_work).sum())
    )
    start, end = run.stored_energy
    least = max(ROUND_OFF * in_play, GAINED * abs(end - start) if run.steady else 0.0)
    energy = np.asarray(energy, dtype=float)
    return np.where(np.abs(energy) > least, energy, 0.0)


def energies(run: Run) -> tuple[float, float]:
    """Friction dissipation and work of the loads: in the last cycle, or the whole run, J."""
    if run.cycles.friction.size:
        lost, work = run.cycles.friction[-1], run.cycles.input[-1].sum()
    else:
        lost, work = run.friction_work.sum(), run.input_work.sum()
    lost, work = beyond_round_off(run, [lost, work]).tolist()
    return lost, work
