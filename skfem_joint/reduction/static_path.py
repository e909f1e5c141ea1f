"""How a structure's joints slip, found without a run of the full model: the source of its modes.

The quasi-static path (:mod:`skfem_joint.stepping.quasi_static`) under the right forces passes
through the states of the run. These are the loads less inertia and damping, which a reduced model
can tell long before it can tell the friction energy: a first path, under the loads and the inertia
of their static response, makes a preliminary model, whose run gives the forces of a second path.
Snapshots are the states of both and, where they turn, their increments. ``examples/reduction.md``
has the method with its formulas, measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.linalg.schur import Uncondensed
from skfem_joint.linalg.shifts import shifted
from skfem_joint.loads import Amplitude, common_period
from skfem_joint.modal_response import modal_response
from skfem_joint.modes import eigenmodes
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.reduction.friction_points import MANY, MERGED, NO_FRICTION, merged_points
from skfem_joint.reduction.pod import orthonormal, proper_decomposition
from skfem_joint.reduction.residual import acceleration
from skfem_joint.reduction.zones import QUICK_CYCLES, motions_without_slip, steps_of_a_period
from skfem_joint.stepping.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.system import System
from skfem_joint.unknowns import congruent

if TYPE_CHECKING:
    from skfem_joint.stepping.quasi_static import QuasiStatic

#: Levels of the first path and of the second where one harmonic acts, and how far beyond the peak
#: they go.
FIRST, SECOND, BEYOND = 6, 12, (1.12, 1.05)
#: Levels of paths through time: in 1.25 periods, in the period at the start, in a run without any.
PERIOD, START, WHOLE = 50, 16, 100
#: More periods while the strain energy of the last one is so much more than before, and the most.
GROWING, MOST_CYCLES = 1.05, 64
#: Rounds of preliminary run and path, while so much more slips than before.
ROUNDS, BLIND = 3, 0.1
#: Interface modes of the preliminary model: share in the response that counts, and most of them;
#: their tolerance (that of their frequencies is its square).
_SHARE, _MOST, _INEXACT = 4e-3, 20, 1e-6
#: Increments of a path through time weigh so much more than its states.
_INCREMENTS = 3.0
#: Modes of the preliminary model.
_MODES = 14
#: The preliminary model's law goes from -1 to 1 within this inverse share of the slip velocity,
#: which is not below the second, m/s.
_RESOLVED, _SLOW = 1e4, 1e-3


@dataclass(frozen=True)
class StaticPath:
    """What the paths and the preliminary run tell about a system."""

    snapshots: FloatArray  #: (s, n), states and increments of both paths, scaled
    response: FloatArray  #: (n, loads), static response to the peak of each load, m
    rigid: FloatArray  #: (n, r), motions that friction alone holds
    interface: FloatArray  #: (n, k), fixed-interface modes, by their share in the response
    share: FloatArray  #: (k,), their shares, see :func:`interface_modes`
    slip_peak: FloatArray  #: (m,), largest slip of each contact point on the second path, m
    V: FloatArray  #: (n, j), basis of the preliminary model
    run: Run  #: of the preliminary model, with fields
    loads: Excitation  #: that act
    stiffness: Uncondensed | None  #: condensed, if the path had it
    blind: float  #: share of what slips on the second path (by limits) that did not on the first
    work: Mapping[str, int]  #: counts of what it took


@dataclass(frozen=True)
class Excitation:
    """Loads of a run to come that act, scaled to one at their peak, and its times."""

    vectors: FloatArray  #: (n, loads), N
    amplitudes: tuple[Amplitude, ...]
    peak: FloatArray  #: (loads,), N
    plan: Plan
    period: float | None  #: of all loads, s; None where one does not repeat within the run

    @staticmethod
    def of(system: System, plan: Plan) -> Excitation:
        """Loads of a system that act in a run."""
        period = common_period(load.amplitude for load in system.loads)
        repeat = all(load.amplitude.period is not None for load in system.loads)
        if period is None or not repeat or plan.duration < period:
            period = None
        known = plan.n_steps
        if period is not None:
            known = min(known, round(2.0 * period / plan.step))
        times = plan.step * np.arange(known + 1, dtype=float)
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
        """Amplitudes over their peaks at some times, (loads, times)."""
        return np.stack([a(times) for a in self.amplitudes]) / self.peak[:, np.newaxis]

    @property
    def fastest(self) -> float:
        """Highest known angular frequency of the loads, else that of the whole run, rad/s."""
        known = [a.highest_frequency or 0.0 for a in self.amplitudes]
        return 2.0 * np.pi * max(*known, 1.0 / self.plan.duration)

    @property
    def lasting(self) -> float:
        """Time in which the loads rise to their peaks, s; of loads that repeat, a quarter."""
        if self.single and self.period is not None:
            return 0.25 * self.period
        known = [a.highest_frequency for a in self.amplitudes]
        rise = 0.5 / known[0] if len(known) == 1 and known[0] else np.inf
        return min(rise, self.plan.duration)

    @property
    def single(self) -> bool:
        """Whether it is one harmonic."""
        return self.period is not None and [len(a.harmonics) for a in self.amplitudes] == [1]

    def forces(self, times: FloatArray, inertia: FloatArray) -> FloatArray:
        """Forces, (times, n), with the ``inertia`` (n, loads) that goes with each load's peak."""
        forces = self(times).T @ self.vectors.T
        for k, amplitude in enumerate(self.amplitudes):
            for one in amplitude.harmonics:
                square = (2.0 * np.pi * one.frequency) ** 2 / self.peak[k]
                forces += square * np.outer(one(times), inertia[:, k])
        return forces


def slip_path(
    system: System,
    plan: Plan,
    modes: int = 0,
    path: QuasiStatic | None = None,
    tolerance: float = 3e-5,
) -> StaticPath:
    """Follow the slip of a system through a run to come.

    Where more ``modes`` are to be made than the levels of one harmonic's peak tell apart, its path
    through time is followed too: motions that ring beside the load's have phases of their own. A
    ``path`` of the system may have its factors. The ``tolerance`` of states is the largest force
    residual over the largest force: singular values are the same to three digits below 3e-5.

    InputError if no load moves anything, or slip rows depend on each other; ConvergenceError if a
    state is not found; KeyboardInterrupt if the preliminary run is interrupted.
    """
    from skfem_joint.stepping.quasi_static import QuasiStatic  # its compiled loops are slow to load

    if system.contact_points == 0:
        raise InputError(NO_FRICTION)
    loads = Excitation.of(system, plan)
    path = QuasiStatic(system, tolerance) if path is None else path.afresh(path.to, tolerance)
    rise = np.array([loads.lasting])
    response = np.stack([path.follow(f[np.newaxis], rise)[0] for f in loads.vectors.T], axis=1)
    snapshots = [_first(system, path, loads, response)]
    if not np.any(snapshots[0]):
        raise InputError(
            "reduction: nothing moves under the loads, which friction holds where they act; load "
            "more, or run 'full' alone"
        )
    slipping, steps, blind = _slipping(system, snapshots[0])[0], 0, 1.0
    interface, share = interface_modes(system, response, loads, path=path)
    rigid = path.to.outer(path.rigid.T).T
    for _ in range(ROUNDS):
        found = proper_decomposition(_scaled(snapshots), energy(system)).modes[:, :_MODES]
        V = orthonormal(np.hstack([found, response, rigid, interface[:, share > _SHARE]]), system.M)
        run = _preliminary(system, V, loads, snapshots[-1])
        steps += run.counters.steps
        acting = _Acting(system, V, run)
        states, beyond = _second(path, loads, response, acting)
        snapshots.append(states)
        now, slip_peak = _slipping(system, states[:beyond])
        blind = float(system.w[now & ~slipping].sum() / max(system.w[now].sum(), 1e-300))
        if blind <= BLIND:
            break
        slipping |= now
    if loads.single and modes > SECOND:
        snapshots.append(_in_time(path, loads, acting))
    return StaticPath(
        snapshots=_scaled(snapshots),
        response=response,
        rigid=rigid if path.held_back else rigid[:, :0],
        interface=interface,
        share=share,
        slip_peak=slip_peak,
        V=V,
        run=run,
        loads=loads,
        stiffness=path.unshifted,
        blind=blind,
        work={
            "quasi-static states": path.solves,
            "factorizations": path.factorizations,
            "preliminary steps": steps,
        },
    )


def _first(
    system: System, path: QuasiStatic, loads: Excitation, response: FloatArray
) -> FloatArray:
    """Path under the loads with their inertia: snapshots, (s, n)."""
    inertia = system.M @ response
    if len(loads.amplitudes) == 1 and (loads.single or loads.period is None):
        square = sum((2.0 * np.pi * a.frequency) ** 2 for a in loads.amplitudes[0].harmonics)
        levels = _levels(FIRST, BEYOND[0])
        force = loads.vectors[:, 0] + square * inertia[:, 0]
        return path.follow(levels * force, loads.lasting * levels[:, 0])
    whole = loads.plan.duration if loads.period is None else 1.25 * loads.period
    times = _levels(PERIOD, whole)[:, 0]
    return _with_increments(path.follow(BEYOND[0] * loads.forces(times, inertia), times))


def _second(
    path: QuasiStatic, loads: Excitation, response: FloatArray, acting: _Acting
) -> tuple[FloatArray, int]:
    """Path under the forces of a run: snapshots, (s, n), and how many are within its peak."""
    if loads.single:
        force = acting.at(np.array([np.argmax(np.abs(acting.work(response[:, 0])))]))
        levels = np.append(_levels(SECOND, 1.0), [[BEYOND[1]]], axis=0)
        return path.follow(levels * force, loads.lasting * levels[:, 0]), SECOND
    snapshots = _in_time(path, loads, acting)
    return snapshots, len(snapshots) // 2


def _in_time(path: QuasiStatic, loads: Excitation, acting: _Acting) -> FloatArray:
    """States and increments under the forces of a run, (s, n): its start and last period."""
    run, K = acting.run, acting.run.system.K
    rows = np.arange(1, len(run.u))
    if loads.period is None:
        rows = _evenly(run, K, rows, WHOLE)
    else:
        last = rows[run.times[rows] >= run.times[-1] - 1.25 * loads.period * (1.0 + 1e-9)]
        start = rows[run.times[rows] < run.times[last[0]]]
        parts = [(start, START)] if start.size else []
        rows = np.concatenate([_evenly(run, K, *part) for part in [*parts, (last, PERIOD)]])
    return _with_increments(path.follow(acting.at(rows), run.times[rows]))


def _slipping(system: System, states: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Which contact points slip in some states (s, n), and how far (m), each (m,)."""
    slip = system.slip_norm((system.B @ states.T).T).max(axis=0)
    return slip > THRESHOLD * slip.max(), slip


def _scaled(snapshots: Sequence[FloatArray]) -> FloatArray:
    """All snapshots, (s, n), as heavy from each path."""
    return np.vstack([x / np.linalg.norm(x) for x in snapshots])


def energy(system: System) -> sparse.csr_array:
    """Inner product of strain energy, with so little of mass that nothing else notices."""
    return sparse.csr_array(shifted(system.K, system.M))


def _levels(count: int, top: float) -> FloatArray:
    """Levels up to ``top``, (count, 1)."""
    return top * np.arange(1, count + 1)[:, np.newaxis] / count


def _with_increments(path: FloatArray) -> FloatArray:
    """States of a path through time and what they differ by, which modes must follow too."""
    return np.vstack([path, _INCREMENTS * np.diff(path, axis=0, prepend=0.0 * path[:1])])


def interface_modes(
    system: System,
    response: FloatArray,
    loads: Excitation,
    most: int = _MOST,
    path: QuasiStatic | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Fixed-interface modes, (n, k), and their shares in the response, the largest first.

    Each is an oscillator that the inertia of the static ``response`` (n, loads) drives; its share
    is its largest strain energy over that of the response, as a root. They are chosen of half the
    ``most`` lowest, or of as many or twice as many where those beyond may count. A ``path`` may
    have the factor for them.
    """
    F = motions_without_slip(system)
    if F.shape[1] == 0 or most == 0:
        return np.zeros((system.n, 0)), np.zeros(0)
    K, M, C = (sparse.csc_array(congruent(A, F)) for A in (system.K, system.M, system.C))
    solve = None if path is None else path.stuck(F)
    inertia, strain = system.M @ response, np.sqrt(np.sum(response * (system.K @ response)))
    for count in (max(1, most // 2), most, 2 * most):
        frequency, shapes = eigenmodes(K, M, min(count, F.shape[1]), solve, _INEXACT)
        omega = np.maximum(2.0 * np.pi * frequency, np.finfo(float).tiny)
        participation = shapes.T @ (F.T @ inertia)
        left = np.sqrt(max(np.sum(response * inertia) - np.sum(participation**2), 0.0))
        # Modes beyond the last follow their drive but for its acceleration over omega squared.
        if 2.0 * left * loads.fastest**2 <= _SHARE * strain * omega[-1]:
            break
    stop = loads.plan.duration
    stop = stop if loads.period is None else min(stop, QUICK_CYCLES * loads.period)
    driven = participation @ loads(np.arange(0.0, stop * (1.0 + 1e-9), loads.plan.step))
    damping = np.einsum("ij,ij->j", shapes, C @ shapes)
    # What each lags behind its support is its acceleration over the square of its frequency.
    acceleration = modal_response(omega, damping, driven, loads.plan.step, "acceleration")
    share = omega * np.abs(acceleration).max(axis=1)
    order = np.argsort(-share, kind="stable")[:most]
    return F @ shapes[:, order], share[order] / strain if strain > 0.0 else 0.0 * share[order]


def _preliminary(system: System, V: FloatArray, loads: Excitation, path: FloatArray) -> Run:
    """Run of the preliminary model: periods in steps that will do, or the whole run.

    There are more periods while it still swings up. Its law is no steeper than a few modes resolve
    of the velocities at which the ``path`` (levels, n) is passed through; very many contact points
    are merged as they slip on it.
    """
    small = system.project(V)
    if system.contact_points > MANY:
        small = merged_points(small, path @ (system.M @ V), np.flatnonzero(system.w), MERGED)
    velocity = float(_slipping(system, path)[1].max()) * loads.fastest
    small = replace(small, beta=np.minimum(small.beta, _RESOLVED / max(velocity, _SLOW)))
    plan = loads.plan
    step, steps, cycles, most = plan.step, plan.n_steps, 1, 1
    if loads.period is not None:
        most = max(1, int(plan.duration / loads.period * (1.0 + 1e-9)))
        cycles, whole = min(QUICK_CYCLES, most), round(loads.period / step)
        steps = steps_of_a_period(small, loads.period, cycles, loads.fastest / (2.0 * np.pi), whole)
        step = loads.period / steps
    while True:
        whole_run = Plan(step, cycles * steps, plan.scheme, Save(fields=True))
        run = integrate_plan(small, whole_run).finished()
        strain = np.einsum("ij,ij->i", run.u[1:] @ small.K, run.u[1:])
        peaks = strain.reshape(cycles, -1).max(axis=1)
        if cycles >= min(most, MOST_CYCLES) or peaks[-1] <= GROWING * peaks[:-1].max(initial=0.0):
            return run
        cycles = min(2 * cycles, most)


@dataclass(frozen=True)
class _Acting:
    """Forces that act in a reduced run, but for friction: loads less inertia and damping, N."""

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
        """At some of the stored times, (rows, n)."""
        return np.asarray(sum(amplitude[rows] @ shape.T for amplitude, shape in self._parts))

    def work(self, u: FloatArray) -> FloatArray:
        """Virtual work on a displacement ``u`` (n,) at all stored times, (times,), J."""
        return np.asarray(sum(amplitude @ (u @ shape) for amplitude, shape in self._parts))


def _evenly(run: Run, K: FloatArray, rows: IntArray, count: int) -> IntArray:
    """Some of the rows between which the structure strains by as much, the last one included."""
    change = np.diff(run.u[rows], axis=0, prepend=0.0)
    length = np.cumsum(np.sqrt(np.maximum(np.einsum("ij,ij->i", change @ K, change), 0.0)))
    wanted = np.searchsorted(length, _levels(count, length[-1])[:, 0] * (1.0 - 1e-9))
    return np.asarray(rows[np.unique(np.minimum(wanted, rows.size - 1))])
