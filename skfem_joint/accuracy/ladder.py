"""A ladder of better models: the error of a source is what one better thing changes.

From the run that is judged each rung makes one thing better: all contact points in place of merged
ones, the full model's law in place of a less steep one, a better basis, half of the step. The
error of a source is the difference of the rungs that make it better, and the total the distance
from the lowest rung to the top one: energies may rise and fall on the way, so that it is not the
sum of the parts. What still better rungs of a source would change follows its last changes as a
geometric series, which is Richardson's extrapolation where steps are halved.

Where the last two changes of a source go the same way, and the way of the distance that its rest is
added to, so does the rest, and it is added. Where they do not, the series has no sign: the rest may
as well make the error smaller, and both are combined as independent errors are, by the root of the
sum of their squares. (A plate with bolts under a versine errs by 0.52 % in its friction energy;
half of the step makes that 1.02 %, a quarter of it 0.06 % on the other side. The sum of distance
and rest is 1.7 %, the root 1.2 %.)

What rungs a kind of model has says :mod:`skfem_joint.accuracy.rungs`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse

from skfem_joint.accuracy.estimate import SOURCES, Estimate, Parts, named, sizes, verification_run
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.results.history import QUANTITIES, Results, difference, joint_differences, results
from skfem_joint.steady.steady import odd_loads
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.system import System

#: Source of the error of the time step.
STEP = "time_step"


class Series(NamedTuple):
    """Ratio of neighbouring changes of a source, by which they go on beyond its last rung.

    Attributes
    ----------
    least, most : float
        Bounds of what two changes show.
    single : float
        Where there is one change only.
    """

    least: float
    most: float
    single: float

    def rest(self, changes: Sequence[FloatArray]) -> FloatArray:
        """Sum of what follows the last of some changes, each by `QUANTITIES`."""
        last, ratio = changes[-1], np.full(len(QUANTITIES), self.single)
        if len(changes) > 1:
            before = changes[-2]
            shown = np.divide(last, before, out=np.full_like(last, np.inf), where=before > 0.0)
            ratio = np.clip(shown, self.least, self.most)
        rest: FloatArray = last * ratio / (1.0 - ratio)
        return rest


#: A step that is halved: from second order, as of smooth motion, to first order, as kinks of
#: friction may leave it. One change alone is taken to be of second order.
HALVED = Series(0.25, 0.5, 0.25)
#: Nothing is left.
WHOLE = Series(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Rung:
    """Results before and after one thing is made better.

    Attributes
    ----------
    source : str
        What is better, see `skfem_joint.accuracy.estimate.SOURCES`.
    before, after : Results
    change : ndarray
        Size of what it changes, by `QUANTITIES`, by which the series goes on; nan: not known.
    series : Series
        How still better rungs of this source would go on.
    unseen : ndarray or float
        Error of the source that no rung shows, by `QUANTITIES`.
    """

    source: str
    before: Results
    after: Results
    change: FloatArray
    series: Series
    unseen: FloatArray | float = 0.0

    @staticmethod
    def of(source: str, before: Results, after: Results, series: Series) -> Rung:
        """Rung of results alone, whose change is their difference."""
        return Rung(source, before, after, sizes(difference(after, before)), series)


def errors_of(base: Results, rungs: Sequence[Rung]) -> dict[str, Parts]:
    """Errors of some results by source, and in total, by the rungs that lead from them."""
    truth = _climbed(base, rungs)
    by_source = {rung.source: of(rungs, rung.source) for rung in rungs}
    parts = {
        source: _with_rests([some], truth, _climbed(truth, some, -1.0))
        for source, some in by_source.items()
    }
    total = _with_rests(by_source.values(), truth, base)
    if len(parts) > 1:
        others = [rung for rung in rungs if rung.source != STEP]
        total = at_least(total, _climbed(base, others), base, *parts.values())
    return {source: named(errors) for source, errors in {**parts, "total": total}.items()}


def of(rungs: Iterable[Rung], source: str) -> list[Rung]:
    """Those rungs that make a source better."""
    return [rung for rung in rungs if rung.source == source]


def _climbed(start: Results, rungs: Iterable[Rung], factor: float = 1.0) -> Results:
    """Results with what some rungs change, times a factor."""
    for rung in rungs:
        start = start.plus(factor, rung.after, rung.before)
    return start


def rest_of(rungs: Sequence[Rung]) -> FloatArray:
    """What the last rung of a source leaves."""
    return rungs[-1].series.rest([rung.change for rung in rungs]) + rungs[-1].unseen


def _with_rests(by_source: Iterable[list[Rung]], truth: Results, start: Results) -> FloatArray:
    """Distance of results from better ones with what the last rungs of some sources leave."""
    errors = sizes(difference(truth, start))
    for rungs in by_source:
        rest, goes_on = rest_of(rungs), _go_on(rungs, start, truth)
        errors = np.where(goes_on, errors + rest, np.hypot(errors, rest))
    return errors


def _go_on(rungs: Sequence[Rung], start: Results, truth: Results) -> bool | list[bool]:
    """Whether the last two changes of a source go the way of a distance, by `QUANTITIES`."""
    if len(rungs) == 1:
        return True
    pairs = [*((rung.before, rung.after) for rung in rungs[-2:]), (start, truth)]
    rows = min(len(each.point_u) for pair in pairs for each in pair)
    ways = []
    for before, after in pairs:
        numbers = (getattr(after, name) - getattr(before, name) for name in QUANTITIES[1:])
        ways.append((after.point_u[:rows] - before.point_u[:rows], *numbers))
    by_name = zip(*ways, strict=True)
    return [min(np.vdot(last, first), np.vdot(last, all_)) > 0.0 for first, last, all_ in by_name]


class Ladder:
    """Rungs from a run to the best one; see the module.

    A search for steady vibration starts from that of the rung before of a model of the same kind,
    where that is unique, and with contact that opens, where it is one of perhaps several. (On a
    lapped solid the searches of an estimate took half the time from there.)

    Parameters
    ----------
    run : Run
        What is judged.
    progress : callable or None
        As `integrate` takes it.
    """

    def __init__(self, run: Run, progress: Callable[..., None] | None) -> None:
        self.base = self.top = run
        self.progress = progress
        self.rungs: list[Rung] = []
        self.states = {keeps_contact(run.system): run.final}

    def run(self, system: System, plan: Plan, *, fields_every: int = 0) -> Run:
        """Run a system as `verification_run`."""
        kind, initial = keeps_contact(system), None
        alike = plan.until == "steady" and (odd_loads(system) or system.contact.opens)
        if alike and kind in self.states:
            # The unknowns of a larger model begin with those of a smaller one.
            initial = tuple(np.append(x, np.zeros(system.n))[: system.n] for x in self.states[kind])
        run = verification_run(
            system, plan, fields_every=fields_every, initial=initial, progress=self.progress
        )
        self.states[kind] = run.final
        return run

    def climb(
        self, source: str, system: System, plan: Plan, series: Series = WHOLE, fields_every: int = 0
    ) -> Run:
        """Run a system as the next rung; where nothing is better the last rung's run serves.

        ``series`` is what it leaves.
        """
        same = system is self.top.system and source != STEP
        run = self.top if same else self.run(system, plan, fields_every=fields_every)
        return self.add(source, run, series)

    def add(
        self, source: str, run: Run, series: Series = WHOLE, unseen: FloatArray | float = 0.0
    ) -> Run:
        """Add a run that is known as the next rung."""
        both = results(self.top), results(run)
        self.rungs.append(Rung(source, *both, apart(run, self.top), series, unseen))
        self.top = run
        return run

    def halve(self, system: System, plan: Plan, finer: Iterable[int] = (2, 4)) -> None:
        """Add rungs of a system with a ``finer``-th of the step each."""
        for factor in finer:
            self.climb(STEP, system, plan.finer(factor), HALVED)

    def changes(self, source: str) -> list[FloatArray]:
        """What each rung of a source changes, by `QUANTITIES`."""
        return [rung.change for rung in of(self.rungs, source)]

    def estimate(self) -> Estimate:
        """Errors of the run by source, in total and of each joint."""
        base, joints = results(self.base), self.base.system.contact.joints
        found = errors_of(base, self.rungs)
        rests = np.nansum([rest_of(of(self.rungs, s)) for s in found if s != "total"], axis=0)
        left = float(rests[QUANTITIES.index("friction_energy")])
        by_joint = joint_differences(_climbed(base, self.rungs), base, joints, left)
        return Estimate({s: found[s] for s in SOURCES if s in found}, by_joint=by_joint)


def keeps_contact(system: System) -> bool:
    """Whether contact has unknowns of its own, and does not share the few of a reduced model."""
    return bool(sparse.issparse(system.contact.B))


def apart(fine: Run, coarse: Run) -> FloatArray:
    """Difference of two runs over the same times, by `QUANTITIES`; nan where it is not known.

    Energies and peaks of different runs may agree by chance in the last cycle. The root mean square
    of their differences in the last quarter of the cycles is therefore a lower bound, unless the
    difference of the displacement histories is smaller.
    """
    better, other = results(fine), results(coarse)
    errors, ours, theirs = sizes(difference(better, other)), by_cycle(fine), by_cycle(coarse)
    if ours.size:
        last = max(1, ours.shape[1] // 4)
        mean = np.sqrt(np.mean((ours - theirs)[:, -last:] ** 2, axis=1))
        size = np.abs(ours[:, -1])
        mean = np.divide(mean, size, out=np.zeros(3), where=size > 0.0)
        errors[1:] = np.maximum(errors[1:], np.fmin(mean, errors[0]))
    return at_least(errors, better, other)


def at_least(total: FloatArray, truth: Results, base: Results, *parts: FloatArray) -> FloatArray:
    """Errors with lower bounds, because parts may cancel by chance.

    The bounds are the largest part, and of peaks and energies a share of the error in the
    displacement history of the point that moves most.
    """
    main = difference(truth.most_moving(), base.most_moving(truth))[QUANTITIES[0]] or 0.0
    share = 0.1 * main * (np.arange(len(QUANTITIES)) > 0)
    return np.maximum(total, np.fmax.reduce([share, *parts]))


def by_cycle(run: Run) -> FloatArray:
    """Peak, friction energy and work of the loads of each cycle, (3, cycles)."""
    cycles = run.cycles
    peak = cycles.peak.max(axis=1, initial=0.0)
    return np.stack([peak, cycles.friction, cycles.input.sum(axis=1)])


def cycles_to_settle(run: Run, settled: float, fewest: int) -> int:
    """Cycles after which peak and energies of a run change by less than a share ``settled``.

    At least ``fewest``; all of them where they go on changing.
    """
    series = by_cycle(run)
    last = series[:, -1:]
    changes = np.any(np.abs(series - last) > settled * np.abs(last), axis=0)
    return max(fewest, int(np.flatnonzero(changes).max(initial=-1)) + 2)
