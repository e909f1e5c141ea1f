"""Results of runs: loops, stick and slip, and distances between runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.values import check_kind
from skfem_joint.runs.last_cycle import beyond_round_off, energies, peaks
from skfem_joint.stepping.recording import Run

States = NDArray[np.int8]

#: Results that errors are estimated for.
QUANTITIES = ("displacement_rms", "peak_displacement", "friction_energy", "loop_energy")


#: A point always sticks under the regularised law if its own largest velocity is below this share
#: of the largest velocity of all points; the second is that for reduced models, in which points
#: that should stick still move a little.
GREY, GREY_REDUCED = 1e-3, 1e-2


def hysteresis_loop(
    run: Run, point: str, load: int = 0, rows_per_cycle: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Displacement (m) of a named point against a load's force (N).

    Of the last complete cycle, closed, if the number of stored rows in a cycle is given, else of
    the whole run. `InputError`: less than one cycle was stored.
    """
    u, f = run.point(point), run.amplitudes[:, load]
    if rows_per_cycle is not None:
        if u.size <= rows_per_cycle:
            raise InputError("hysteresis loop: less than one cycle was stored")
        u, f = u[-rows_per_cycle - 1 :], f[-rows_per_cycle - 1 :]
    return u, f


def slip_state(slip_velocity: FloatArray, beta: FloatArray, grey: float = GREY) -> States:
    """1 where a contact point slips, 0 where it sticks.

    Under set-valued Coulomb friction a sticking point has exactly zero velocity. Under the
    regularised law every point creeps, and its friction may stay near the limit while it does, so
    that the velocity decides.

    Parameters
    ----------
    slip_velocity : ndarray, shape (frames, m)
        Norm of the slip velocity of each contact point, m/s.
    beta : ndarray, shape (m,)
        Steepness of each point's law, s/m.
    grey : float
        See `GREY`.
    """
    speed = np.abs(slip_velocity)
    own = speed.max(axis=0, initial=0.0)
    # It slips while it is faster than this share of its own largest velocity.
    limit = np.where(np.isinf(beta), 0.0, 0.05 * own)
    active = np.isinf(beta) | (own > grey * own.max(initial=0.0))
    return np.asarray((speed > limit) & active, dtype=np.int8)


@dataclass(frozen=True)
class Errors:
    """Distance of a run from a reference run, relative to the reference.

    None where there is nothing to compare with: no cycles, or a reference of zero for what is not.

    Attributes
    ----------
    displacement_rms, displacement_max : float or None
        Root mean square and largest difference between the displacements, divided by the root mean
        square and the largest displacement of the reference; at the named point where each is
        largest.
    by_point : dict of str to tuple of float
        The same two for each named point.
    peak_displacement : float or None
        Signed difference between the peaks of the named point that moves most; of the last cycle,
        or of the whole run if it has no cycles.
    friction_energy_per_cycle, loop_energy_per_cycle : float or None
        Difference of the energies lost by friction and of the work of the loads in the last cycle,
        with its sign.
    friction_energy : float or None
        Difference of the energies lost by friction over the whole run, with its sign.
    """

    displacement_rms: float | None
    displacement_max: float | None
    by_point: dict[str, tuple[float, float]]
    peak_displacement: float | None
    friction_energy_per_cycle: float | None
    loop_energy_per_cycle: float | None
    friction_energy: float | None


def compare(reference: Run, other: Run) -> Errors:
    """Errors of a run against a reference run, by quantity.

    Parameters
    ----------
    reference, other : Run
        Full, condensed or reduced, of the same named points, stored at the same times.

    Returns
    -------
    Errors
        Relative to the reference.

    Raises
    ------
    InputError
        If the stored times or the named points differ.
    """
    check_kind("reference", reference, Run)
    check_kind("other", other, Run)
    same_times = reference.times.shape == other.times.shape and np.allclose(
        reference.times, other.times, rtol=1e-9, atol=0.0
    )
    if not same_times or reference.system.points != other.system.points:
        raise InputError("compare: the runs must store the same times and named points")
    by_point = differences(reference.system.points, reference.point_u, other.point_u)
    peak = peaks(reference)
    most = int(np.argmax(peak)) if peak.size else 0
    have_cycles = min(reference.cycles.friction.size, other.cycles.friction.size) > 0
    ours, theirs = energies(other), energies(reference)
    at_rest = None if np.any(other.point_u) else 0.0  # where the reference is
    return Errors(
        displacement_rms=max((rms for rms, _ in by_point.values()), default=at_rest),
        displacement_max=max((largest for _, largest in by_point.values()), default=at_rest),
        by_point=by_point,
        peak_displacement=relative(peaks(other)[most], peak[most]) if peak.size else None,
        friction_energy_per_cycle=relative(ours[0], theirs[0]) if have_cycles else None,
        loop_energy_per_cycle=relative(ours[1], theirs[1]) if have_cycles else None,
        friction_energy=relative(
            *(float(beyond_round_off(run, run.friction_work.sum())) for run in (other, reference))
        ),
    )


def differences(
    names: Sequence[str], reference: FloatArray, other: FloatArray
) -> dict[str, tuple[float, float]]:
    """Root mean square and largest difference of each named point, relative; {} if none moves.

    Differences of histories (rows, points), m, are divided by the root mean square and the largest
    value of the reference. Of the components of a point, whose names end in ``.x``, ``.y`` and
    ``.z``, the largest counts. A point that moves less than a hundredth of the one that moves most
    is compared with that hundredth.
    """
    if not np.any(reference):
        return {}
    places = [name[:-2] if name.endswith((".x", ".y", ".z")) else name for name in names]
    both = [np.linalg.norm(x, axis=0) for x in (other - reference, reference)]
    most = [np.abs(x).max(axis=0) for x in (other - reference, reference)]
    by_point = {}
    for k, name in enumerate(names):
        same = [i for i, place in enumerate(places) if place == places[k]]
        rms, largest = (
            float(apart[k] / max(size[same].max(), 1e-2 * size.max()))
            for apart, size in (both, most)
        )
        by_point[name] = rms, largest
    return by_point


def relative(value: float, reference: float) -> float | None:
    """Signed difference over the reference; None where that is zero and the value is not."""
    if reference == 0.0:
        return 0.0 if value == 0.0 else None
    return float(value / reference - 1.0)


@dataclass(frozen=True)
class Results:
    """Results of a run that errors are estimated for.

    Peak and energies are those of the last cycle, or of the whole run without cycles.

    Attributes
    ----------
    points : tuple of str
        The named points.
    point_u : ndarray, shape (rows, points)
        Their displacements, m.
    peak_displacement : float
        Largest peak of a named point, m.
    friction_energy : float
        Energy dissipated by friction, J.
    loop_energy : float
        Work of the loads, J.
    by_joint : ndarray, shape (joints,)
        Energy dissipated by friction in each joint, J.
    """

    points: tuple[str, ...]
    point_u: FloatArray
    peak_displacement: float
    friction_energy: float
    loop_energy: float
    by_joint: FloatArray

    def most_moving(self, like: Results | None = None) -> Results:
        """Results with the history of the point alone that moves most, here or in ``like``."""
        size = np.abs((like or self).point_u).max(axis=0, initial=0.0)
        most = slice(int(size.argmax()), int(size.argmax()) + 1) if size.size else slice(0)
        return replace(self, points=self.points[most], point_u=self.point_u[:, most])

    def plus(self, factor: float, first: Results, second: Results) -> Results:
        """Results plus ``factor`` times the difference of two others, the first less the second."""
        numbers = {
            name: getattr(self, name) + factor * (getattr(first, name) - getattr(second, name))
            for name in QUANTITIES[1:]
        }
        # Durations that are no whole steps differ in their last rows.
        rows = min(len(x.point_u) for x in (self, first, second))
        u = self.point_u[:rows] + factor * (first.point_u[:rows] - second.point_u[:rows])
        by_joint = self.by_joint + factor * (first.by_joint - second.by_joint)
        return replace(self, point_u=u, by_joint=by_joint, **numbers)


def results(run: Run, every: int = 1) -> Results:
    """Results of a run, with each ``every``-th of its stored rows."""
    peak = float(peaks(run).max(initial=0.0))
    cycles = run.cycles
    by_joint = cycles.by_joint[-1] if cycles.friction.size else list(run.friction_energy.values())
    u = run.point_u[::every]
    return Results(run.system.points, u, peak, *energies(run), beyond_round_off(run, by_joint))


def difference(reference: Results, other: Results) -> dict[str, float | None]:
    """Differences of results from a reference, relative to that, by `QUANTITIES`.

    None where the reference is zero or was not stored.
    """
    rows = min(len(reference.point_u), len(other.point_u))
    histories = reference.point_u[:rows], other.point_u[:rows]
    by_point = differences(reference.points, *histories)
    errors = {QUANTITIES[0]: max((rms for rms, _ in by_point.values()), default=None)}
    for name in QUANTITIES[1:]:
        value, changed = getattr(reference, name), getattr(other, name)
        errors[name] = abs(value - changed) / abs(value) if value != 0.0 else None
    return errors


def joint_differences(
    reference: Results, other: Results, joints: Sequence[str], left: float = 0.0
) -> dict[str, tuple[float | None, float | None]]:
    """Differences of the friction energy of each joint, by its name.

    Relative to the friction energy of all joints of the reference, and to the joint's own; ``left``
    is a relative difference of all of them that is added. None where the reference is zero.
    """
    errors: dict[str, tuple[float | None, float | None]] = {}
    whole = abs(reference.friction_energy)
    for name, ours, theirs in zip(joints, reference.by_joint, other.by_joint, strict=True):
        own = abs(float(ours))
        error = abs(float(ours - theirs)) + left * own
        errors[name] = error / whole if whole else None, error / own if own else None
    return errors


def extrapolation(ratio: float) -> float:
    """Factor of Richardson's extrapolation, 1 / (1 - 1 / ratio).

    The difference of two results times this factor is the error of the coarser one; times the
    factor less one it is the error of the finer one. ``ratio`` is the ratio of the two errors: 2^p
    if the finer result has half the step and the method is of order p.
    """
    return 1.0 / (1.0 - 1.0 / ratio)
