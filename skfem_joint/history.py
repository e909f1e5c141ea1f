"""What a run's history says: loops, stick and slip, steady state, distance from another run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.recording import Run

FloatArray = NDArray[np.float64]

#: A point that moves less than this share of what moves most is at rest: it is not compared.
AT_REST = 1e-9

#: Under the regularised law a point slips while it is faster than this share of its own largest
#: velocity; points whose own largest velocity is below `GREY_SHARE` of the joint's always stick.
SLIP_SHARE = 0.05
GREY_SHARE = 1e-3


def hysteresis_loop(
    run: Run, point: str, load: int = 0, rows_per_cycle: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Displacement (m) of a named point against a load's force (N).

    Parameters
    ----------
    rows_per_cycle : int, optional
        Stored rows in a cycle: the last complete cycle is returned, closed; the whole history
        if not given.
    """
    u, f = run.point(point), run.amplitudes[:, load]
    if rows_per_cycle is not None:
        if u.size <= rows_per_cycle:
            raise InputError("hysteresis loop: less than one cycle was stored")
        u, f = u[-rows_per_cycle - 1 :], f[-rows_per_cycle - 1 :]
    return u, f


def slip_state(slip_velocity: FloatArray, beta: FloatArray) -> NDArray[np.int8]:
    """1 where a contact point slips, 0 where it sticks.

    Under set-valued Coulomb friction a sticking point has exactly zero velocity. Under the
    regularised law every point creeps, and its friction may stay near the limit while it does, so
    that the velocity decides.

    Parameters
    ----------
    slip_velocity : ndarray, shape (frames, m)
        m/s.
    beta : ndarray, shape (m,)
        Scaling constant of the law of each point, s/m.
    """
    speed = np.abs(slip_velocity)
    own = speed.max(axis=0, initial=0.0)
    limit = np.where(np.isinf(beta), 0.0, SLIP_SHARE * own)
    active = np.isinf(beta) | (own > GREY_SHARE * own.max(initial=0.0))
    return np.asarray((speed > limit) & active, dtype=np.int8)


@dataclass(frozen=True)
class SteadyState:
    """How much the last cycle differs from the one before.

    Attributes
    ----------
    reached : bool
        Whether the changes stay below the tolerance asked for.
    energy_change, peak_change : float
        Relative change of the work put in per cycle and of the peaks.
    """

    reached: bool
    energy_change: float
    peak_change: float


def steady_state(run: Run, tolerance: float = 2e-3) -> SteadyState | None:
    """Compare the last two cycles; None when the run has fewer than two."""
    cycles = run.cycles
    if cycles.friction.size < 2:
        return None
    work = np.abs(cycles.input.sum(axis=1))
    energy = abs(work[-1] - work[-2]) / work[-1] if work[-1] > 0.0 else 0.0
    largest = cycles.peak[-1].max(initial=0.0)
    change = np.abs(cycles.peak[-1] - cycles.peak[-2]).max(initial=0.0)
    peak = change / largest if largest > 0.0 else 0.0
    return SteadyState(bool(max(energy, peak) <= tolerance), float(energy), float(peak))


@dataclass(frozen=True)
class Errors:
    """Distance of a run from a reference run, relative to the reference.

    All but the first two are signed. Energies per cycle are None without cycles.

    Attributes
    ----------
    displacement_rms, displacement_max : float
        Root mean square and largest difference of the histories over the reference's root mean
        square and largest value; the named point that differs most counts.
    by_point : dict
        The same two for each named point; both components of a plate's point are compared with
        the larger one.
    peak_displacement : float
        Of the named point that moves most, in the last cycle (or the whole run without cycles).
    friction_energy_per_cycle, loop_energy_per_cycle : float or None
        In the last cycle.
    friction_energy : float
        Over the whole run.
    """

    displacement_rms: float
    displacement_max: float
    by_point: dict[str, tuple[float, float]]
    peak_displacement: float
    friction_energy_per_cycle: float | None
    loop_energy_per_cycle: float | None
    friction_energy: float


def peaks(run: Run) -> FloatArray:
    """Peak of each named point: in the last cycle, or in the whole run without cycles, m."""
    return run.cycles.peak[-1] if run.cycles.peak.shape[0] else run.peak


def compare(reference: Run, other: Run) -> Errors:
    """Errors of ``other`` against ``reference``; both must have stored the same times.

    Raises
    ------
    InputError
        If the stored times or the named points differ.
    """
    same_times = reference.times.shape == other.times.shape and np.allclose(
        reference.times, other.times, rtol=1e-9, atol=0.0
    )
    if not same_times or reference.system.points != other.system.points:
        raise InputError("compare: the runs must store the same times and named points")
    difference = other.point_u - reference.point_u
    by_point = {}
    norm = np.linalg.norm(reference.point_u, axis=0)
    most_of = np.abs(reference.point_u).max(axis=0, initial=0.0)
    places = [name.removesuffix(".x").removesuffix(".y") for name in reference.system.points]
    for k, name in enumerate(reference.system.points):
        # The components of a plate's point are compared with the larger of them.
        same = [i for i, place in enumerate(places) if place == places[k]]
        if most_of[same].max() > AT_REST * most_of.max():
            by_point[name] = (
                float(np.linalg.norm(difference[:, k]) / norm[same].max()),
                float(np.abs(difference[:, k]).max() / most_of[same].max()),
            )
    peak = peaks(reference)
    most = int(np.argmax(peak)) if peak.size else 0
    both_have_cycles = min(reference.cycles.friction.size, other.cycles.friction.size) > 0
    return Errors(
        displacement_rms=max((a for a, _ in by_point.values()), default=0.0),
        displacement_max=max((b for _, b in by_point.values()), default=0.0),
        by_point=by_point,
        peak_displacement=_relative(peaks(other)[most], peak[most]) if peak.size else 0.0,
        friction_energy_per_cycle=_relative(
            other.cycles.friction[-1], reference.cycles.friction[-1]
        )
        if both_have_cycles
        else None,
        loop_energy_per_cycle=_relative(
            other.cycles.input[-1].sum(), reference.cycles.input[-1].sum()
        )
        if both_have_cycles
        else None,
        friction_energy=_relative(other.friction_work.sum(), reference.friction_work.sum()),
    )


def _relative(value: float, reference: float) -> float:
    return float(value / reference - 1.0) if reference != 0.0 else 0.0
