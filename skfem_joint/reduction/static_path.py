"""Static slip path: how the joints slip, without a run of the full model. Joint modes come from it.

Under the loads of the run to come, less inertia and damping, the quasi-static path of the structure
(:mod:`skfem_joint.slow.quasi_static`) passes through the states of the run. The forces of
inertia are known well from a coarse reduced model, long before its friction energy is right. So

1. a first path is followed under the loads and the inertia of their static response;
2. its modes make a preliminary reduced model, whose run gives inertia and damping;
3. a second path is followed under the loads less these.

Steps 2 and 3 are repeated while the second path moves many points that stuck before. Snapshots are
the states of all paths and, on paths through time, their increments. ``docs/theory/static-path.md``
has the method with its formulas, ``docs/verification/reduction.md`` what it gives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.linalg.schur import Uncondensed
from skfem_joint.reduction import friction_points, interface_modes
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.reduction.elastic_contact import strain_norm
from skfem_joint.reduction.excitation import CYCLES, Excitation, steps_of_a_period
from skfem_joint.reduction.friction_points import NO_FRICTION, merged_points
from skfem_joint.reduction.joint_slides import joint_slides
from skfem_joint.reduction.missing_modes import acceleration
from skfem_joint.reduction.pod import orthonormal, proper_decomposition
from skfem_joint.runs.integrate import TOLERANCE, integrate_plan
from skfem_joint.runs.resolution import check_resolution
from skfem_joint.runs.slow_run import slow_run
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.system.system import System

#: Load levels of the first and of the second path where one harmonic acts.
FIRST_LEVELS, SECOND_LEVELS = 6, 12
#: Highest level of these paths, relative to the load's peak.
FIRST_BEYOND, SECOND_BEYOND = 1.12, 1.05
#: Levels of paths through time: in 1.25 periods, in the time before the last of these, and in a
#: run whose loads do not repeat.
PERIOD_LEVELS, START_LEVELS, RUN_LEVELS = 50, 16, 100
#: Weight of the increments of a path through time, relative to that of its states.
INCREMENTS = 3.0
#: The preliminary run goes on while the strain energy of its last period exceeds that of earlier
#: ones by this factor.
GROWING = 1.05
#: Most periods of the preliminary run.
MOST_CYCLES = 64
#: Most rounds of preliminary run and second path.
ROUNDS = 3
#: Largest share of the points that slip on a second path, by friction limits, that may have stuck
#: on all paths before.
NEWLY_SLIPPING = 0.1
#: Joint modes of the preliminary model.
MODES = 14
#: The preliminary model's law is no steeper than this over the slip velocity, s/m.
RESOLVED = 10000.0
#: Slip velocity below which that does not grow, m/s.
SLOW = 1e-9


@dataclass(frozen=True)
class StaticPath:
    """Snapshots of static slip paths, and the preliminary model between them.

    Attributes
    ----------
    snapshots : ndarray, shape (s, n)
        States and increments of all paths, each path with norm one.
    response : ndarray, shape (n, loads)
        Static response to the peak of each load, m; in a quasi-static run followed by the sliding
        of each joint, see :mod:`skfem_joint.reduction.joint_slides`.
    rigid : ndarray, shape (n, r)
        Rigid motions that friction alone holds, if it did not hold them on a path, or all points
        slipped there: the sliding of a body then takes part, and states of paths, which are held,
        hardly show it. With contact that opens always: a body also rocks on its contact.
    interface : ndarray, shape (n, k)
        Fixed-interface modes, in the order of their shares in the response.
    share : ndarray, shape (k,)
        Their shares, see `skfem_joint.reduction.interface_modes.driven`.
    slip_peak : ndarray, shape (m,)
        Largest slip of each contact point on the last second path, m.
    V : ndarray, shape (n, j)
        Basis of the preliminary model.
    run : Run
        Run of the preliminary model, with fields.
    loads : Excitation
        Loads that act.
    stiffness : Uncondensed, optional
        Stiffness with its Schur complement, if the path had it; shifted a little by the mass where
        bodies can move rigidly.
    newly_slipping : float
        Share of the points that slip on the last path, by friction limits, that stuck on all paths
        before: preliminary runs did not know that they slip.
    work : mapping of str to int
        Counts of states, factorizations and preliminary steps.
    """

    snapshots: FloatArray
    response: FloatArray
    rigid: FloatArray
    interface: FloatArray
    share: FloatArray
    slip_peak: FloatArray
    V: FloatArray
    run: Run
    loads: Excitation
    stiffness: Uncondensed | None
    newly_slipping: float
    work: Mapping[str, int]


def slip_path(
    system: System,
    plan: Plan,
    modes: int = 0,
    given: QuasiStatic | None = None,
) -> StaticPath:
    """Follow the slip of a system through a run to come.

    Parameters
    ----------
    system : System
    plan : Plan
        Steps of the run to come.
    modes : int
        Number of joint modes to be made. If there are more than the levels of one harmonic's peak
        can tell apart, its path through time is followed too: vibration beside the load's has
        phases of its own.
    given : QuasiStatic, optional
        A path of the system, whose factors are used.

    Raises
    ------
    InputError
        If no load moves anything, or slip rows depend on each other.
    ConvergenceError
        If a state does not converge.
    KeyboardInterrupt
        If the preliminary run is interrupted.
    """
    if system.contact.count == 0:
        raise InputError(NO_FRICTION)
    loads = Excitation.of(system, plan)
    tolerance = 3e-5  # singular values are the same to three digits below
    path = QuasiStatic(system, tolerance) if given is None else given.afresh(given.to, tolerance)
    rise = np.array([loads.rise_time])
    response = np.stack([path.follow(f[np.newaxis], rise)[0] for f in loads.vectors.T], axis=1)
    snapshots = [_first(system, path, loads, response)]
    slipping, steps, newly_slipping = _slipping(system, snapshots[0])[0], 0, 1.0
    w, every = system.contact.w, system.contact.w > 0.0
    slides = bool(slipping[every].all()) or system.contact.opens
    beside, interface, share = _beside(system, response, loads, path)
    counting = interface[:, share > interface_modes.LEAST_DRIVEN]
    rigid, energy = path.to.outer(path.rigid.T).T, strain_norm(system)
    for _ in range(ROUNDS):
        joint = proper_decomposition(_scaled(snapshots), energy).modes[:, :MODES]
        V = orthonormal(np.hstack([joint, beside, rigid, counting]), system.M)
        run = _preliminary(system, V, loads, snapshots[-1])
        steps += run.counters.steps
        driving = _Driving(system, V, run)
        states, within = _second(path, loads, response, driving)
        snapshots.append(states)
        now, slip_peak = _slipping(system, states[:within])
        newly_slipping = float(w[now & ~slipping].sum() / max(w[now].sum(), 1e-300))
        slides |= bool(now[every].all())
        if newly_slipping <= NEWLY_SLIPPING:
            break
        slipping |= now
    if _is_monotone(system, loads) and modes > SECOND_LEVELS:
        snapshots.append(_in_time(path, loads, driving))
    return StaticPath(
        snapshots=_scaled(snapshots),
        response=beside,
        rigid=rigid if slides or path.scaled_back else rigid[:, :0],
        interface=interface,
        share=share,
        slip_peak=slip_peak,
        V=V,
        run=run,
        loads=loads,
        stiffness=path.schur,
        newly_slipping=newly_slipping,
        work={
            "quasi-static states": path.solves,
            "factorizations": path.factorizations,
            "preliminary steps": steps,
        },
    )


def _is_monotone(system: System, loads: Excitation) -> bool:
    """Whether a path to the peak of a single harmonic shows all: both ways are alike then.

    With contact that opens they are not.
    """
    return loads.is_one_harmonic and not system.contact.opens


def _beside(
    system: System, response: FloatArray, loads: Excitation, path: QuasiStatic
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Static shapes beside the modes, fixed-interface modes and shares of these; see `StaticPath`.

    Nothing vibrates in a quasi-static run, whose joints' forces need the sliding of each.
    """
    if loads.plan.quasi_static:
        still = np.zeros((system.n, 0)), np.zeros(0)
        return np.hstack([response, joint_slides(system)]), *still
    return response, *interface_modes.driven(system, response, loads, path=path)


def _first(
    system: System, path: QuasiStatic, loads: Excitation, response: FloatArray
) -> FloatArray:
    """Snapshots (s, n) of the path under the loads with the inertia of their static response.

    InputError if nothing moves.
    """
    inertia = system.M @ response
    # With contact that opens both ways differ, and more than the load might lift a body off.
    opens = system.contact.opens
    beyond = 1.0 if opens else FIRST_BEYOND
    if loads.plan.quasi_static:
        inertia = np.zeros_like(inertia)
    pulse = len(loads.amplitudes) == 1 and loads.period is None
    if not opens and (pulse or loads.is_one_harmonic):
        square = sum((2.0 * np.pi * a.frequency) ** 2 for a in loads.amplitudes[0].harmonics)
        levels = _levels(FIRST_LEVELS, beyond)
        force = loads.vectors[:, 0] + square * inertia[:, 0]
        snapshots = path.follow(levels * force, loads.rise_time * levels[:, 0])
    else:
        whole = loads.plan.duration if loads.period is None else 1.25 * loads.period
        times = _levels(PERIOD_LEVELS, whole)[:, 0]
        states = path.follow(beyond * loads.forces(times, inertia), times)
        snapshots = _with_increments(states)
    if not np.any(snapshots):
        raise InputError(
            "reduction: nothing moves under the loads, which friction holds where they act; load "
            "more, or run 'full' alone"
        )
    return snapshots


def _second(
    path: QuasiStatic, loads: Excitation, response: FloatArray, driving: _Driving
) -> tuple[FloatArray, int]:
    """Snapshots (s, n) of the path under the forces of a run, and the number within its peak."""
    if _is_monotone(driving.system, loads):
        count = SECOND_LEVELS
        force = driving.at(np.array([np.argmax(np.abs(driving.work(response[:, 0])))]))
        levels = np.append(_levels(count, 1.0), [[SECOND_BEYOND]], axis=0)
        return path.follow(levels * force, loads.rise_time * levels[:, 0]), count
    snapshots = _in_time(path, loads, driving)
    return snapshots, len(snapshots) // 2


def _in_time(path: QuasiStatic, loads: Excitation, driving: _Driving) -> FloatArray:
    """States and increments (s, n) under the forces of a run: of its start and last period."""
    run, K = driving.run, driving.run.system.K
    rows = np.arange(1, len(run.u))
    if loads.period is None:
        rows = _evenly(run, K, rows, RUN_LEVELS)
    else:
        last = rows[run.times[rows] >= run.times[-1] - 1.25 * loads.period * (1.0 + 1e-9)]
        start = rows[run.times[rows] < run.times[last[0]]]
        parts = [(start, START_LEVELS)] if start.size else []
        parts.append((last, PERIOD_LEVELS))
        rows = np.concatenate([_evenly(run, K, *part) for part in parts])
    return _with_increments(path.follow(driving.at(rows), run.times[rows]))


def _slipping(system: System, states: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Which contact points slip in some states (s, n), and their largest slips (m), each (m,)."""
    slip = system.contact.slip_norm((system.contact.B @ states.T).T).max(axis=0)
    return slip > THRESHOLD * slip.max(), slip


def _scaled(snapshots: Sequence[FloatArray]) -> FloatArray:
    """All snapshots, (s, n), those of each path with norm one."""
    return np.vstack([x / np.linalg.norm(x) for x in snapshots])


def _levels(count: int, top: float) -> FloatArray:
    """Evenly spaced levels up to ``top``, (count, 1)."""
    return top * np.arange(1, count + 1)[:, np.newaxis] / count


def _with_increments(path: FloatArray) -> FloatArray:
    """States of a path through time and their differences, which modes must follow too."""
    return np.vstack([path, INCREMENTS * np.diff(path, axis=0, prepend=0.0 * path[:1])])


def _preliminary(system: System, V: FloatArray, loads: Excitation, path: FloatArray) -> Run:
    """Run of the preliminary model on ``V``: some periods in few steps, or the whole run.

    It has more periods while its vibration grows. Its law is no steeper than a few modes resolve at
    the velocities at which the loads pass through the ``path`` (levels, n). Very many contact
    points are merged as they slip on the path.
    """
    small = system.project(V)
    if system.contact.count > friction_points.MANY:
        known = path @ (system.M @ V)  # of contact that opens states, and then as many increments
        points, states = np.flatnonzero(system.contact.rubs), known[: len(known) // 2]
        small = merged_points(small, known, points, friction_points.MERGED, states)
    velocity = float(_slipping(system, path)[1].max()) * loads.fastest
    steepest = RESOLVED / max(velocity, SLOW)
    small = small.no_steeper(steepest)
    plan = loads.plan
    step, steps, cycles, most = plan.step, plan.n_steps, 1, 1
    if loads.period is not None:
        most = max(1, int(plan.duration / loads.period * (1.0 + 1e-9)))
        cycles, whole = min(CYCLES, most), round(loads.period / step)
        highest, vibrates = loads.fastest / (2.0 * np.pi), not plan.quasi_static
        steps = steps_of_a_period(small, loads.period, cycles, highest, whole, vibrates)
        step = loads.period / steps
    if plan.quasi_static:
        count, save = min(cycles, 2) * steps, Save(fields=True)
        return _slow(small, Plan(step, count, save=save, quasi_static=True))
    while True:
        whole_run = Plan(step, cycles * steps, plan.scheme, Save(fields=True))
        run = integrate_plan(small, whole_run, judged=False).finished()
        strain = np.einsum("ij,ij->i", run.u[1:] @ small.K, run.u[1:])
        peaks = strain.reshape(cycles, -1).max(axis=1)
        grows = peaks[-1] > GROWING * peaks[:-1].max(initial=0.0)
        if cycles >= min(most, MOST_CYCLES) or not grows:
            return run
        cycles = min(2 * cycles, most)


def _slow(small: System, plan: Plan) -> Run:
    """Quasi-static run of the preliminary model, as far as friction holds the loads."""
    check_resolution(small, plan)
    try:
        return slow_run(small, plan, tolerance=TOLERANCE).finished()
    except ConvergenceError as error:
        run: Run | None = error.run
        if run is None or not np.any(run.u):
            raise ConvergenceError(str(error)) from error
        return run


@dataclass(frozen=True)
class _Driving:
    """Forces on the full system in a run of a reduced model: loads less inertia and damping, N.

    Friction is what the quasi-static path adds to them.

    Attributes
    ----------
    system : System
        The full system.
    V : ndarray, shape (n, j)
        Basis of the reduced model.
    run : Run
        Its run, with all fields.
    """

    system: System
    V: FloatArray
    run: Run

    @cached_property
    def _parts(self) -> list[tuple[FloatArray, FloatArray]]:
        """Amplitudes (times, k) and vectors (n, k) of the loads, of inertia and of damping."""
        system, run = self.system, self.run
        loads = system.load_amplitudes(run.times).T, system.load_vectors()
        return [loads, (-acceleration(run).T, system.M @ self.V), (-run.v, system.C @ self.V)]

    def at(self, rows: IntArray) -> FloatArray:
        """Forces at some of the stored times, (rows, n), N."""
        return np.asarray(sum(amplitude[rows] @ shape.T for amplitude, shape in self._parts))

    def work(self, u: FloatArray) -> FloatArray:
        """Virtual work on a displacement ``u`` (n,) at all stored times, (times,), J."""
        return np.asarray(sum(amplitude @ (u @ shape) for amplitude, shape in self._parts))


def _evenly(run: Run, K: FloatArray, rows: IntArray, count: int) -> IntArray:
    """About ``count`` of the rows of a run with equal strain between them, with the last row.

    Strain is the length of the path of the reduced displacement in the norm of strain energy.
    """
    change = np.diff(run.u[rows], axis=0, prepend=0.0)
    length = np.cumsum(np.sqrt(np.maximum(np.einsum("ij,ij->i", change @ K, change), 0.0)))
    wanted = np.searchsorted(length, _levels(count, length[-1])[:, 0] * (1.0 - 1e-9))
    return np.asarray(rows[np.unique(np.minimum(wanted, rows.size - 1))])
