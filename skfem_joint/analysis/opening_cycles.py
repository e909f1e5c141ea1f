"""Cycles of a load with contact that opens, whose friction limits follow the normal forces.

Masing's rule does not hold, and the structure is not the same for both signs of the load. So the
load goes round at each level: from the end of the cycle before up to the level, and then down to
its opposite and back, until a cycle ends where it began. Points that slip carry their limit, so
that the work of friction in an increment is sum w |slip| with the mean w of its ends: exact where
limits are constant, and of second order in the increment where they are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, cast

import numpy as np

from skfem_joint.analysis.cycles import Cycles, spread
from skfem_joint.arrays import BoolArray, FloatArray
from skfem_joint.errors import ConvergenceError
from skfem_joint.opening import OpeningContact
from skfem_joint.progress import Tally
from skfem_joint.stepping.levels import Level, NoLevelError, in_parts
from skfem_joint.stepping.opening_levels import Kept, OpeningLevels
from skfem_joint.system import System


@dataclass(frozen=True)
class OpeningCycleSettings:
    """Numbers of cycles with contact that opens.

    Attributes
    ----------
    increments : int
        Increments of each half of a cycle. With 2, 4, 8 and 16 the work on a Brake-Reuss beam was
        10, 2.5, 0.7 and 0.2 % too large at a low level, and 2.7, 0.5, 0.2 and 0.04 % at a high one.
    checked : int
        Levels at which a cycle with twice the increments is followed too, for the error.
    closed : float
        A cycle is closed if its mean friction limits do this share of its work on what is left of
        the slips at its end.
    most : int
        Most cycles at a level, which end with the first that is closed.
    least : float
        Work of friction over alpha q that counts as none: a damping ratio of 1.6e-5.
    doubtful : float
        Relative error of the damping ratio beyond which a note says so.
    """

    increments: int = 8
    checked: int = 3
    closed: float = 5e-3
    most: int = 12
    least: float = 1e-4
    doubtful: float = 0.05


SETTINGS = OpeningCycleSettings()
#: Factor of the difference to half the increment: what is left falls with its square.
HALVED = 4.0 / 3.0


def cycles_to_follow(levels: int) -> int:
    """Levels at which cycles are followed, those with twice the increments counted once more."""
    return levels + min(SETTINGS.checked, levels)


class _Start(NamedTuple):
    """Where a way to the next level begins.

    Attributes
    ----------
    level : Level
    kept : Kept
        What the solver keeps from the increment before.
    alpha : float
        Multiple of the force.
    """

    level: Level
    kept: Kept
    alpha: float


class _Cycle(NamedTuple):
    """A cycle between both signs of a level.

    Attributes
    ----------
    end : Level
    kept : Kept
        What the solver keeps from its last increment.
    low : ndarray, shape (n,)
        Displacement at the opposite of the level, m.
    opened : ndarray of bool, shape (q,)
        Whether each pressure point was without force at an increment.
    slid : ndarray, shape (m,)
        Half of the slip of each slider between the turning points, m; zero where no friction acts.
    work : float
        Of friction, J.
    slip_left : float
        Work of the mean friction limits on the slips that are left at its end, over ``work``.
    way_left : float
        Modal displacement that is left at its end, over that from peak to peak.
    """

    end: Level
    kept: Kept
    low: FloatArray
    opened: BoolArray
    slid: FloatArray
    work: float
    slip_left: float
    way_left: float

    def start(self, alpha: float) -> _Start:
        """Its end at a multiple of the force, from which one goes on."""
        return _Start(self.end, self.kept, alpha)

    @property
    def half(self) -> FloatArray:
        """Displacement from the middle of both turning points to the end, (n,), m."""
        return 0.5 * (self.end.u - self.low)

    @property
    def middle(self) -> FloatArray:
        """Displacement in the middle of both turning points, (n,), m."""
        return 0.5 * (self.end.u + self.low)


#: Levels that follow each other, with their multiples of the force.
Walk = list[tuple[float, Level]]


def lowest(walk: Walk) -> int:
    """Place of the opposite turning point in a cycle."""
    return int(np.argmin([alpha for alpha, _ in walk]))


class OpeningPath:
    """Quasi-static path of a system with contact that opens, in cycles.

    Parameters
    ----------
    system : System
        Full, condensed or reduced.
    tolerance : float
        Largest force residual of a level, relative to its largest force.
    tally : Tally
        Counts the levels' cycles.
    keeps : bool
        Whether ``walked`` is kept.

    Attributes
    ----------
    to : Arranged
        System in whose unknowns levels are solved.
    walked : list of list
        Of each level that was computed, all cycles but those with twice the increments, each a list
        of its levels with their multiples of the force; first of the way to it.
    """

    def __init__(self, system: System, tolerance: float, tally: Tally, keeps: bool = False) -> None:
        self.solver = OpeningLevels(system, tolerance)
        self.to, self.tally = self.solver.to, tally
        self._closed = cast("OpeningContact", system.opening).closed_motions()
        self._taken = self.to.system.spring_flexibility
        self.given = system
        self.walked: list[list[Walk]] = []
        self._keeps = keeps

    def of_closed(self, u: FloatArray) -> FloatArray:
        """Unknowns of the path, (n,), from those of `System.closed`."""
        return self.to.inner(np.asarray(self._closed @ u))

    def touched(self) -> tuple[BoolArray, BoolArray]:
        """Contact points, (m,), and pressure points, (q,), with a force at any level walked."""
        levels = [level for walks in self.walked for walk in walks for _, level in walk]
        limits = np.array([level.limits for level in levels])
        normal = np.array([level.normal for level in levels])
        return np.any(limits > 0.0, axis=0), np.any(normal > 0.0, axis=0)

    def follow(self, force: FloatArray, level: FloatArray, damping: float = 0.0) -> Cycles:
        """Cycles of a force (n,), N, between both signs of some levels, from rest.

        They end with the last level that has a state, which a note says. The error of the damping
        ratio is that of friction over the whole one, with the modal ``damping``, 1/s.

        Raises
        ------
        ConvergenceError
            If a level is not found, or the first one has no state.
        """
        start = _Start(self.solver.rest(), Kept(np.zeros(self.to.system.n), 0.0), 0.0)
        done, notes = list[_Cycle](), list[str]()
        for alpha in level.tolist():
            try:
                done.append(self._settled(force, alpha, start, SETTINGS.increments, SETTINGS.most))
            except NoLevelError as error:
                share = alpha / level[-1]
                if not error.beyond or not done:
                    raise ConvergenceError(
                        f"backbone: there is no cycle at {share:.3g} of the highest level: {error}"
                    ) from error
                notes.append(
                    f"the curve ends at {start.alpha / level[-1]:.3g} of the highest level that "
                    f"was asked for: at {share:.3g} of it {error}. A lower up_to has all levels "
                    "below."
                )
                break
            start = done[-1].start(alpha)
        level = level[: len(done)]
        pairs = list[tuple[float, _Cycle, _Cycle]]()
        for k in spread(level.size, SETTINGS.checked).tolist():
            alpha = float(level[k])
            begin = done[k].start(alpha)
            finer = self._settled(force, alpha, begin, 2 * SETTINGS.increments, 1)
            pairs.append((alpha, done[k], finer))
        apart = np.array([_apart(force, damping, *pair) for pair in pairs]).max(axis=0)
        errors = {
            "frequency": float(apart[0]) + 0.5 * max(cycle.way_left for cycle in done),
            "damping_ratio": float(apart[1]),
        }
        return self._cycles(level, done, errors, notes)

    def _settled(
        self, force: FloatArray, alpha: float, start: _Start, increments: int, most: int
    ) -> _Cycle:
        """The first cycle at a level that is closed, or the last of at most so many."""
        self.solver.kept = start.kept
        walks = [self._levels(start.level, force, start.alpha, alpha)]
        for _ in range(most):
            begin = walks[-1][-1][1]
            walks.append(self._walk(begin, force, alpha, increments))
            cycle = self._cycle(begin, alpha * force, walks[-1])
            if cycle.slip_left <= SETTINGS.closed:
                break
        if self._keeps and increments == SETTINGS.increments:
            self.walked.append(walks)
        self.tally.add()
        return cycle

    def _levels(self, last: Level, force: FloatArray, before: float, after: float) -> Walk:
        """Levels on the way between two multiples of a force, (n,), N."""
        ends = before * force, after * force
        along = 1.0 / float(force @ force)
        return [
            (float(loads @ force) * along, level)
            for loads, level in in_parts(self.solver.next, last, *ends)
        ]

    def _walk(self, begin: Level, force: FloatArray, alpha: float, increments: int) -> Walk:
        """Levels of a cycle from a level at a multiple of a force to its opposite and back."""
        turn = alpha * np.linspace(1.0, -1.0, increments + 1)
        walk: Walk = [(alpha, begin)]
        for half in (turn, -turn):
            for a, b in pairwise(half.tolist()):
                walk += self._levels(walk[-1][1], force, a, b)
        return walk[1:]

    def _cycle(self, begin: Level, force: FloatArray, walk: Walk) -> _Cycle:
        """Cycle from a level under a force, (n,), N, with the levels that follow."""
        system, pressed = self.to.system, self.solver.contact.force > 0.0
        path, middle = [begin, *(level for _, level in walk)], 1 + lowest(walk)
        limits = np.array([level.limits for level in path])
        ways = np.array([level.slip - self._taken * level.friction for level in path])
        slips = np.diff(ways, axis=0)
        work = float((0.5 * (limits[1:] + limits[:-1]) * system.slip_norm(slips)).sum())
        normal = np.array([level.normal for level in path])
        end, low = path[-1], path[middle].u
        left = float(limits.mean(axis=0) @ system.slip_norm(ways[-1] - ways[0]))
        slid = 0.5 * system.slip_norm(ways[-1] - ways[middle])
        way = float(force @ (end.u - low))
        return _Cycle(
            end=end,
            kept=self.solver.kept,
            low=low,
            opened=np.any(normal <= 0.0, axis=0) & pressed,
            slid=np.where(np.any(limits > 0.0, axis=0), slid, 0.0),
            work=work,
            slip_left=left / max(work, 0.5 * SETTINGS.least * way),
            way_left=abs(float(force @ (end.u - begin.u)) / way),
        )

    def _cycles(
        self, level: FloatArray, done: list[_Cycle], errors: dict[str, float], notes: list[str]
    ) -> Cycles:
        """Result of the cycles at all levels."""
        system, contact = self.to.system, self.solver.contact
        pressed = max(int(np.count_nonzero(contact.at_all(contact.force))), 1)
        opened = [np.count_nonzero(contact.at_all(cycle.opened)) for cycle in done]
        states = np.array([cycle.half for cycle in done])
        slip = system.slip_norm(np.asarray((system.B @ states.T).T))
        limits = np.array([cycle.end.limits for cycle in done])
        on_rows = np.array([system.on_rows(w) for w in limits])
        forces = np.array([cycle.end.friction for cycle in done])
        creep = SETTINGS.increments * self.solver.creep  # in half of a cycle
        slip[slip <= creep] = 0.0
        slid = np.array([cycle.slid for cycle in done])
        left = max(cycle.slip_left for cycle in done)
        if left > SETTINGS.closed:
            notes.append(
                f"cycles are not closed after {SETTINGS.most} of them: friction would do "
                f"{100.0 * left:.2g} % of the work of a cycle on the slip that is left at its end."
            )
        if errors["damping_ratio"] > SETTINGS.doubtful:
            notes.append(
                "the contact opens and slips so abruptly that the damping errs by an "
                f"estimated {100.0 * errors['damping_ratio']:.2g} % from the increments of cycles."
            )
        return Cycles(
            level=level,
            states=states,
            work=np.array([cycle.work for cycle in done]),
            slip=slip,
            sliding=np.where(slid > creep, slid, 0.0),
            friction=np.divide(forces, on_rows, out=np.zeros_like(forces), where=on_rows > 0.0),
            loops=np.zeros((0, system.n)),
            middle=np.array([cycle.middle for cycle in done]),
            opened=np.array(opened) / pressed,
            limits=limits,
            errors=errors,
            notes=tuple(notes),
        )


def _apart(
    force: FloatArray, damping: float, alpha: float, cycle: _Cycle, finer: _Cycle
) -> tuple[float, float]:
    """Relative errors of frequency and damping ratio of a cycle, by one with twice its increments.

    What is left of the slips at its end counts as an error of the work.
    """
    q = np.array([force @ cycle.half, force @ finer.half])
    loss = np.array([cycle.work, finer.work]) / (alpha * q)
    whole = float(loss[1]) + np.pi * damping * float(np.sqrt(q[1] / alpha))
    left = cycle.slip_left * max(float(loss[0]), SETTINGS.least)
    frequency = HALVED * abs(float(np.sqrt(q[1] / q[0])) - 1.0)
    return frequency, (HALVED * abs(float(loss[0] - loss[1])) + left) / max(whole, SETTINGS.least)
