"""Cycles of a force between both signs of rising levels, followed slowly.

With constant friction limits the unloading path is the loading path doubled where slip keeps its
direction (Masing's rule), so that the work of a cycle is 4 sum w |slip| without following it. Half
cycles are followed at some levels to check the rule; the ratio of the two works, interpolated over
the level, corrects the others. Where slip turns far the rule fails, and a half cycle is followed at
each level.

With contact that opens the limits follow the normal forces: the rule does not hold, and the
structure is not the same for both signs of the force. So the force goes round at each level: from
the end of the cycle before up to the level, and then down to its opposite and back, until a cycle
ends where it began. Points that slip carry their limit, so that the work of friction in an
increment is sum w |slip| with the mean w of its ends: exact where limits are constant, and of
second order in the increment where they are not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, evenly
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.reduction.stuck import StuckMode
from skfem_joint.slow.levels import Level, NoLevelError, Walk
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.arrangement import Arranged
from skfem_joint.system.contacts import Contact
from skfem_joint.system.system import System

#: Levels at which half cycles are followed to check Masing's rule, or, with contact that opens, a
#: cycle with twice the increments for the error.
CHECKED = 3
#: Increments of each half of a cycle with constant limits that is followed.
HALF_CYCLE = 4
#: Masing's rule is given up where the slip added up along the path is more than this times the slip
#: at its end.
TURNED = 1.05
#: Increments of each half of a cycle with contact that opens. With 2, 4, 8 and 16 the work on a
#: Brake-Reuss beam was 10, 2.5, 0.7 and 0.2 % too large at a low level, and 2.7, 0.5, 0.2 and
#: 0.04 % at a high one.
INCREMENTS = 8
#: Such a cycle is closed if its mean friction limits do this share of its work on what is left of
#: the slips at its end, and most cycles at a level, which end with the first that is closed.
CLOSED, MOST = 5e-3, 12
#: Work of friction over alpha q that counts as none: a damping ratio of 1.6e-5.
LEAST = 1e-4
#: Loss of a cycle over the largest at any level, up to which its ratio to Masing's is not found:
#: points that stick in reduced models creep a little.
COUNTS = 1e-3
#: Relative error of the damping ratio beyond which a note says so.
DOUBTFUL = 0.05
#: Factor of the difference to half the increment: what is left falls with its square.
HALVED = 4.0 / 3.0


@dataclass(frozen=True)
class RisingCycles:
    """Cycles of a force between both signs of some levels.

    Attributes
    ----------
    level : ndarray, shape (levels,)
        Multiples of the force; fewer than asked for where the last ones have no state.
    states : ndarray, shape (levels, n)
        Displacement from the middle of a cycle to its end at the level, m.
    by_point : ndarray, shape (levels, m)
        Work of friction in a cycle at each contact point, J.
    strain : ndarray, shape (levels,)
        Largest strain energy in a cycle, J; with contact that opens above that at rest.
    slip, sliding : ndarray, shape (levels, m)
        Slip of each contact point that belongs to ``states``, m, and that of its slider: what is
        left by a spring in series, and zero where nothing is pressed all along.
    friction : ndarray, shape (levels, rows of B)
        Friction over its limit at the level.
    loops : ndarray, shape (increments, n)
        Increments of displacement along the half cycles that were followed with constant limits, m.
    ways : list of list of Walk
        Of each level the way to it, and then what was followed from there: a half cycle or none
        with constant limits; with contact that opens all cycles but those with twice the
        increments, of which the last leads to the next level. None there unless they are kept.
    masing_error : float or None
        Largest relative error of the work by Masing's rule; None where it was not used.
    middle : ndarray, shape (levels, n), or None
        Displacement in the middle of both turning points, m; None where it is zero.
    opened : ndarray, shape (levels,), or None
        Share of the pressure points pressed at rest that opened; None where none can.
    limits : ndarray, shape (levels, m), or None
        Friction limits at the level, N; None where they are constant.
    errors : mapping of str to float
        Estimated relative errors of "frequency" and "damping_ratio", if they are known.
    work_error : ndarray, shape (levels,), or None
        Estimated relative error of the work by the increments of half cycles, 0 where it is not
        checked; None where no level was given to check.
    notes : tuple of str
        What to beware of.
    """

    level: FloatArray
    states: FloatArray
    by_point: FloatArray
    strain: FloatArray
    slip: FloatArray
    sliding: FloatArray
    friction: FloatArray
    loops: FloatArray
    ways: list[list[Walk]]
    masing_error: float | None = None
    middle: FloatArray | None = None
    opened: FloatArray | None = None
    limits: FloatArray | None = None
    errors: Mapping[str, float] = field(default_factory=dict)
    work_error: FloatArray | None = None
    notes: tuple[str, ...] = ()

    @property
    def work(self) -> FloatArray:
        """Work of friction in a cycle, (levels,), J."""
        return np.asarray(self.by_point.sum(axis=1))


def items_of_work(levels: int, opens: bool) -> int:
    """What is counted of so many levels, as far as it is known before slip turns.

    With constant limits all states that are computed; with contact that ``opens`` cycles, those
    with twice the increments once more.
    """
    checked = min(CHECKED, levels)
    return levels + checked * (1 if opens else HALF_CYCLE)


def between(level: FloatArray, followed: IntArray, ratio: FloatArray) -> FloatArray:
    """Ratios at all levels, (levels, ...), from those (followed, ...) of some; 1 without any."""
    if not followed.size:
        return np.ones(level.size)
    known, at = np.log(level[followed]), np.log(level)
    columns = [np.interp(at, known, column) for column in np.atleast_2d(ratio.T)]
    return np.array(columns).T.reshape(level.size, *ratio.shape[1:])


def lowest(walk: Walk) -> int:
    """Place of the opposite turning point in a cycle."""
    return int(np.argmin([alpha for alpha, _ in walk]))


class _Cycle(NamedTuple):
    """A cycle between both signs of a level, with contact that opens.

    Attributes
    ----------
    end : Level
    low : ndarray, shape (n,)
        Displacement at the opposite of the level, m.
    opened : ndarray of bool, shape (q,)
        Whether each pressure point was without force at an increment.
    slid : ndarray, shape (m,)
        Half of the slip of each slider between the turning points, m; zero where no friction acts.
    by_point : ndarray, shape (m,)
        Work of friction at each contact point, J.
    strain : float
        Largest strain energy, J.
    slip_left : float
        Work of the mean friction limits on the slips that are left at its end, over ``work``.
    way_left : float
        Modal displacement that is left at its end, over that from peak to peak.
    """

    end: Level
    low: FloatArray
    opened: BoolArray
    slid: FloatArray
    by_point: FloatArray
    strain: float
    slip_left: float
    way_left: float

    @property
    def work(self) -> float:
        """Work of friction, J."""
        return float(self.by_point.sum())

    @property
    def half(self) -> FloatArray:
        """Displacement from the middle of both turning points to the end, (n,), m."""
        return 0.5 * (self.end.u - self.low)

    @property
    def middle(self) -> FloatArray:
        """Displacement in the middle of both turning points, (n,), m."""
        return 0.5 * (self.end.u + self.low)


class CyclePath:
    """Slow path of a system in cycles of a force.

    Parameters
    ----------
    system : System
        Full, condensed or reduced.
    closed : Arranged
        The system with contact that stays closed, `System.closed`.
    stays : QuasiStatic
        Of ``closed.system``; followed where no contact opens. Its tally counts `items_of_work`.
    keeps : bool
        Whether `RisingCycles.ways` are kept with contact that opens: there are many.

    Attributes
    ----------
    system, closed, stays
        As given: the system, and with contact that stays closed arranged and its path.
    levels : QuasiStatic
        Solver of the levels, in whose unknowns all is.
    to : Arranged
        System in these unknowns, with maps to and from those of the given one.
    """

    def __init__(
        self, system: System, closed: Arranged, stays: QuasiStatic, keeps: bool = False
    ) -> None:
        self.system, self.closed, self.stays, self._keeps = system, closed, stays, keeps
        self.levels, self.to, self.tally, self._motions = stays, closed, stays.tally, None
        if system.contact.opens:
            self.levels = QuasiStatic(system, stays.tolerance)
            self.to, self._motions = self.levels.to, system.contact.normal.closed_motions()

    @property
    def opens(self) -> bool:
        """Whether contact opens, so that a cycle is followed at each level."""
        return self.levels.opens

    def of_closed(self, u: FloatArray) -> FloatArray:
        """Unknowns of the path, (n, ...), from those of ``closed``."""
        if self._motions is None:
            return u
        return self.to.inner(np.asarray(self._motions @ self.closed.outer(u.T).T))

    def follow(
        self, force: FloatArray, level: FloatArray, damping: float, checked: IntArray | None
    ) -> RisingCycles:
        """Cycles of a force (n,), N, between both signs of some levels, from rest.

        ``checked`` are numbers of levels at which Masing's rule is checked, a few evenly spread
        ones if not given. The half cycles of given ones have twice the increments, and the error of
        the damping ratio is known there.

        With contact that opens they end with the last level that has a state, which a note says,
        and the error of the damping ratio is that of friction over the whole one, with the modal
        ``damping``, 1/s.

        Raises
        ------
        ConvergenceError
            If a level is not found, or the first one has no state.
        """
        if self.opens:
            return self._around(force, level, damping)
        return self._by_masings_rule(force, level, damping, checked)

    def _by_masings_rule(
        self, force: FloatArray, level: FloatArray, damping: float, checked: IntArray | None
    ) -> RisingCycles:
        """Cycles with constant limits."""
        levels, contact = self.levels, self.to.system.contact
        ways = [[way] for way in levels.walk(levels.rest(), force, np.append(0.0, level))]
        ends = [way[-1][1] for (way,) in ways]
        states, rows, friction = _stacked(contact, ends)
        still = level * (states @ force) <= 0.0
        if still.any():
            raise InputError(
                f"backbone: levels: found {level[still][0]:g} m/s² kg^1/2, whose work "
                "numbers do not tell from zero; give higher ones"
            )
        sliders = contact.slider_slip(rows, friction)
        slip, sliding = contact.slip_norm(rows), contact.slip_norm(sliders)
        by_point, idle = 4.0 * sliding * contact.w, 1e-12 * level * (states @ force)
        by_point[by_point.sum(axis=1) <= idle] = 0.0  # round-off
        work = by_point.sum(axis=1)
        along = np.cumsum(contact.slip_norm(np.diff(sliders, axis=0, prepend=0.0)), axis=0)
        masing = bool(np.all(4.0 * along @ contact.w <= np.maximum(TURNED * work, idle)))
        followed = evenly(level.size, CHECKED) if checked is None else checked
        followed = followed if masing else np.arange(level.size)
        loss = work / (level * (states @ force))
        followed = followed[loss[followed] > COUNTS * loss.max()]
        twice = [] if checked is None else checked.tolist()
        self.tally.total += HALF_CYCLE * (followed.size - min(CHECKED, level.size))
        self.tally.total += 2 * HALF_CYCLE * len(twice)
        loops, apart, errs = [states[:0]], 0.0, np.zeros(level.size)
        cycle = np.zeros((followed.size, contact.w.size))
        for k, at in enumerate(followed.tolist()):
            half, moved, cycle[k] = self._half_cycle(ends[at], force, level[at], HALF_CYCLE)
            if at in twice:
                coarse = cycle[k].sum()
                half, moved, cycle[k] = self._half_cycle(ends[at], force, level[at], 2 * HALF_CYCLE)
                q, fine = float(force @ states[at]), cycle[k].sum()
                whole = fine + np.pi * damping * np.sqrt(q / level[at]) * level[at] * q
                errs[at] = abs(coarse / fine - 1.0) if coarse != fine else 0.0
                apart = max(apart, float(abs(coarse - fine) / whole))
            ways[at].append(half)
            loops.append(moved)
        ratio = cycle.sum(axis=1) / work[followed]
        by_point *= between(level, followed, ratio)[:, np.newaxis]
        by_point[followed] = cycle
        return RisingCycles(
            level=level,
            states=states,
            by_point=by_point,
            strain=np.array([self._strain(end) for end in ends]),
            slip=slip,
            sliding=sliding,
            friction=friction,
            loops=np.concatenate(loops),
            ways=ways,
            masing_error=float(np.abs(ratio - 1.0).max(initial=0.0)) if masing else None,
            errors={} if checked is None else {"damping_ratio": apart},
            work_error=None if checked is None else errs,
        )

    def _half_cycle(
        self, end: Level, force: FloatArray, alpha: float, count: int
    ) -> tuple[Walk, FloatArray, FloatArray]:
        """Way from a level to its opposite in some increments, with constant limits.

        Also returns the increments of displacement, (increments, n), m, and the work of friction of
        the whole cycle at each contact point, (m,), J.
        """
        contact, turn = self.to.system.contact, np.linspace(1.0, -1.0, count + 1)
        parts = self.levels.walk(end, alpha * force, turn)
        half = [(share * alpha, one) for part in parts for share, one in part]
        u, _, sigma = _stacked(contact, [end, *(one for _, one in half)])
        moved = np.diff(u, axis=0)
        slips = np.asarray((contact.B @ moved.T).T)
        slid = contact.slip_norm(contact.slider_slip(slips, np.diff(sigma, axis=0)))
        return half, moved, 2.0 * slid.sum(axis=0) * contact.w

    def _strain(self, level: Level) -> float:
        """Strain energy of a level, J, that of springs and of contact that opens included."""
        system = self.to.system
        return system.strain_energy(level.u, _stacked(system.contact, [level])[2][0], level.limits)

    def _around(self, force: FloatArray, level: FloatArray, damping: float) -> RisingCycles:
        """Cycles with contact that opens."""
        start, done, ways, notes = self.levels.rest(), list[_Cycle](), list[list[Walk]](), []
        before = 0.0
        for alpha in level.tolist():
            try:
                cycle, walks = self._settled(force, (before, alpha), start, INCREMENTS)
            except NoLevelError as error:
                share = alpha / level[-1]
                if not error.beyond or not done:
                    raise ConvergenceError(
                        f"backbone: there is no cycle at {share:.3g} of the highest level: {error}"
                    ) from error
                notes.append(
                    f"the curve ends at {before / level[-1]:.3g} of the highest level that "
                    f"was asked for: at {share:.3g} of it {error}. A lower up_to has all levels "
                    "below."
                )
                break
            done.append(cycle)
            ways.append(walks if self._keeps else [])
            before, start = alpha, cycle.end
        level = level[: len(done)]
        apart = np.zeros(2)
        for k in evenly(level.size, CHECKED).tolist():
            alpha = float(level[k])
            twice = 2 * INCREMENTS
            finer, _ = self._settled(force, (alpha, alpha), done[k].end, twice, 1)
            apart = np.maximum(apart, _apart(force, damping, alpha, done[k], finer))
        errors = {
            "frequency": float(apart[0]) + 0.5 * max(cycle.way_left for cycle in done),
            "damping_ratio": float(apart[1]),
        }
        system, contact = self.to.system, self.levels.contact
        pressed = max(int(np.count_nonzero(contact.at_all(contact.force))), 1)
        opened = [np.count_nonzero(contact.at_all(cycle.opened)) for cycle in done]
        states = np.array([cycle.half for cycle in done])
        slip = system.contact.slip_norm(np.asarray((system.contact.B @ states.T).T))
        creep = INCREMENTS * self.levels.creep  # in half of a cycle
        slip[slip <= creep] = 0.0
        slid = np.array([cycle.slid for cycle in done])
        left = max(cycle.slip_left for cycle in done)
        if left > CLOSED:
            notes.append(
                f"cycles are not closed after {MOST} of them: friction would do "
                f"{100.0 * left:.2g} % of the work of a cycle on the slip that is left at its end."
            )
        if errors["damping_ratio"] > DOUBTFUL:
            notes.append(
                "the contact opens and slips so abruptly that the damping errs by an "
                f"estimated {100.0 * errors['damping_ratio']:.2g} % from the increments of cycles."
            )
        return RisingCycles(
            level=level,
            states=states,
            by_point=np.array([cycle.by_point for cycle in done]),
            strain=np.array([cycle.strain for cycle in done]),
            slip=slip,
            sliding=np.where(slid > creep, slid, 0.0),
            friction=_stacked(system.contact, [cycle.end for cycle in done])[2],
            loops=np.zeros((0, system.n)),
            ways=ways,
            middle=np.array([cycle.middle for cycle in done]),
            opened=np.array(opened) / pressed,
            limits=np.array([cycle.end.limits for cycle in done]),
            errors=errors,
            notes=tuple(notes),
        )

    def _settled(
        self,
        force: FloatArray,
        way: tuple[float, float],
        start: Level,
        increments: int,
        most: int | None = None,
    ) -> tuple[_Cycle, list[Walk]]:
        """The first cycle at a level that is closed, or the last of at most so many.

        ``way`` are the multiples of the force at the ``start`` and at the level. Also returns the
        way to it, and all cycles.
        """
        walks = [self._walk(start, force, np.array(way))]
        down = way[1] * np.linspace(1.0, -1.0, increments + 1)
        for _ in range(most or MOST):
            begin = walks[-1][-1][1]
            walks.append(self._walk(begin, force, np.append(down, -down[1:])))
            cycle = self._cycle(begin, way[1] * force, walks[-1])
            if cycle.slip_left <= CLOSED:
                break
        self.tally.add()
        return cycle, walks

    def _walk(self, begin: Level, force: FloatArray, multiples: FloatArray) -> Walk:
        """Levels under multiples of a force (n,), N, and of the parts of the ways between them."""
        return [one for way in self.levels.walk(begin, force, multiples) for one in way]

    def _cycle(self, begin: Level, force: FloatArray, walk: Walk) -> _Cycle:
        """Cycle from a level under a force, (n,), N, with the levels that follow."""
        contact, pressed = self.to.system.contact, self.levels.contact.force > 0.0
        path, middle = [begin, *(level for _, level in walk)], 1 + lowest(walk)
        limits = np.array([level.limits for level in path])
        ways = np.array([x.slip - contact.spring_flexibility * x.friction for x in path])
        slips = np.diff(ways, axis=0)
        by_point = (0.5 * (limits[1:] + limits[:-1]) * contact.slip_norm(slips)).sum(axis=0)
        work = float(by_point.sum())
        normal = np.array([level.normal for level in path])
        end, low = path[-1], path[middle].u
        left = float(limits.mean(axis=0) @ contact.slip_norm(ways[-1] - ways[0]))
        slid = 0.5 * contact.slip_norm(ways[-1] - ways[middle])
        way = float(force @ (end.u - low))
        return _Cycle(
            end=end,
            low=low,
            opened=np.any(normal <= 0.0, axis=0) & pressed,
            slid=np.where(np.any(limits > 0.0, axis=0), slid, 0.0),
            by_point=by_point,
            strain=max(map(self._strain, path[1:])),
            slip_left=left / max(work, 0.5 * LEAST * way),
            way_left=abs(float(force @ (end.u - begin.u)) / way),
        )


def _stacked(contact: Contact, levels: list[Level]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacements (levels, n), m, slips (levels, rows), m, and friction over its limits."""
    u, slip, friction = (np.array([one[k] for one in levels]) for k in (0, 2, 1))
    limits = (contact.w if one.limits is None else one.limits for one in levels)
    w = np.array([contact.on_rows(each) for each in limits])
    return u, slip, np.divide(friction, w, out=np.zeros_like(friction), where=w > 0.0)


def _apart(
    force: FloatArray, damping: float, alpha: float, cycle: _Cycle, finer: _Cycle
) -> tuple[float, float]:
    """Relative errors of frequency and damping ratio of a cycle, by one with twice its increments.

    What is left of the slips at its end counts as an error of the work.
    """
    q = np.array([force @ cycle.half, force @ finer.half])
    loss = np.array([cycle.work, finer.work]) / (alpha * q)
    whole = float(loss[1]) + np.pi * damping * float(np.sqrt(q[1] / alpha))
    left = cycle.slip_left * max(float(loss[0]), LEAST)
    frequency = HALVED * abs(float(np.sqrt(q[1] / q[0])) - 1.0)
    return frequency, (HALVED * abs(float(loss[0] - loss[1])) + left) / max(whole, LEAST)


@dataclass(frozen=True)
class ModePath:
    """What a backbone was followed along.

    Attributes
    ----------
    mode : StuckMode
        In the unknowns of ``cycles.closed``.
    shape : ndarray, shape (n,)
        The mode in the unknowns of the path.
    cycles : CyclePath
        The path.
    found : RisingCycles
        What was found on it.
    """

    mode: StuckMode
    shape: FloatArray
    cycles: CyclePath
    found: RisingCycles
