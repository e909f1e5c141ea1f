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

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse

from skfem_joint.accuracy.estimate import (
    SOURCES,
    Estimate,
    MissingModes,
    Parts,
    added,
    verification_run,
)
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.results.history import (
    QUANTITIES,
    Results,
    difference,
    joint_differences,
    results,
)
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

    def rest(self, changes: list[Parts]) -> Parts:
        """Sum of what follows the last of some changes."""
        errors: Parts = {}
        for name, last in changes[-1].items():
            ratio = self.single
            if len(changes) > 1 and last is not None:
                before = changes[-2][name]
                ratio = min(max(last / before, self.least), self.most) if before else self.most
            errors[name] = None if last is None else last * ratio / (1.0 - ratio)
        return errors


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
    change : dict
        Size of what it changes, by which the series goes on.
    series : Series
        How still better rungs of this source would go on.
    unseen : dict, optional
        Error of the source that no rung shows.
    """

    source: str
    before: Results
    after: Results
    change: Parts
    series: Series
    unseen: Parts | None = None

    @staticmethod
    def of(source: str, before: Results, after: Results, series: Series) -> Rung:
        """Rung of results alone, whose change is their difference."""
        return Rung(source, before, after, difference(after, before), series)

    def way(self, name: str) -> FloatArray:
        """Change of a quantity with its sign: one number, or the histories (rows, points)."""
        return _way(self.before, self.after, name)


def _way(before: Results, after: Results, name: str) -> FloatArray:
    """From a quantity of some results to that of others."""
    if name != QUANTITIES[0]:
        return np.atleast_1d(getattr(after, name) - getattr(before, name))
    rows = min(len(after.point_u), len(before.point_u))
    return after.point_u[:rows] - before.point_u[:rows]


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
    order = {source: place for place, source in enumerate(SOURCES)}
    named = sorted(parts, key=lambda source: order.get(source, 0))
    return {source: parts[source] for source in named} | {"total": total}


def of(rungs: Iterable[Rung], source: str) -> list[Rung]:
    """Those rungs that make a source better."""
    return [rung for rung in rungs if rung.source == source]


def _climbed(start: Results, rungs: Iterable[Rung], factor: float = 1.0) -> Results:
    """Results with what some rungs change, times a factor."""
    for rung in rungs:
        start = start.plus(factor, rung.after, rung.before)
    return start


def rest_of(rungs: Sequence[Rung]) -> Parts:
    """What the last rung of a source leaves."""
    rest = rungs[-1].series.rest([rung.change for rung in rungs])
    return rest if rungs[-1].unseen is None else added(rest, rungs[-1].unseen)


def _with_rests(by_source: Iterable[list[Rung]], truth: Results, start: Results) -> Parts:
    """Distance of results from better ones with what the last rungs of some sources leave."""
    errors = difference(truth, start)
    for rungs in by_source:
        for name, rest in rest_of(rungs).items():
            distance = errors[name]
            if distance is None or rest is None:
                errors[name] = None
            elif _go_on(rungs, name, _way(start, truth, name)):
                errors[name] = distance + rest
            else:
                errors[name] = math.hypot(distance, rest)
    return errors


def _go_on(rungs: Sequence[Rung], name: str, distance: FloatArray) -> bool:
    """Whether the last two changes of a source go the way of a distance."""
    if len(rungs) == 1:
        return True
    ways = [rung.way(name) for rung in rungs[-2:]] + [distance]
    first, last, whole = (way[: min(map(len, ways))] for way in ways)
    return bool(min(np.vdot(last, first), np.vdot(last, whole)) > 0.0)


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

    def __init__(self, run: Run, progress: Callable[..., None] | None = None) -> None:
        self.base = self.top = run
        self.progress = progress
        self.rungs: list[Rung] = []
        self.states = {_condensed(run.system): run.final}

    def run(self, system: System, plan: Plan, *, fields_every: int = 0) -> Run:
        """Run a system as `verification_run`."""
        kind, initial = _condensed(system), None
        alike = plan.until == "steady" and (odd_loads(system) or system.contact.opens)
        if alike and kind in self.states:
            # The unknowns of a larger model begin with those of a smaller one.
            initial = np.zeros(system.n), np.zeros(system.n)
            for whole, known in zip(initial, self.states[kind], strict=True):
                whole[: known.size] = known[: whole.size]
        run = verification_run(
            system, plan, fields_every=fields_every, initial=initial, progress=self.progress
        )
        self.states[kind] = run.final
        return run

    def climb(
        self,
        source: str,
        system: System,
        plan: Plan,
        series: Series = WHOLE,
        *,
        before: Run | None = None,
        fields_every: int = 0,
    ) -> Run:
        """Run a system as the next rung; where nothing is better the last rung's run serves.

        ``before`` is a run that it is compared with in place of the last rung's: of another model
        on which the source has the same error. ``series`` is what it leaves.
        """
        last = before or self.top
        stepped = last.plan is not None and plan.step == last.plan.step
        same = system is last.system and stepped and not fields_every
        after = last if same else self.run(system, plan, fields_every=fields_every)
        return self.add(source, after, series, before=last)

    def add(
        self,
        source: str,
        after: Run,
        series: Series = WHOLE,
        *,
        before: Run | None = None,
        unseen: Parts | None = None,
    ) -> Run:
        """Add a run that is known as the next rung."""
        before = before or self.top
        both = results(before), results(after)
        self.rungs.append(Rung(source, *both, apart(after, before), series, unseen))
        self.top = after
        return after

    def halve(
        self, system: System, plan: Plan, finer: Iterable[int] = (2, 4), before: Run | None = None
    ) -> None:
        """Add rungs of a system with a ``finer``-th of the step each."""
        for factor in finer:
            before = self.climb(STEP, system, plan.finer(factor), HALVED, before=before)

    def changes(self, source: str) -> list[Parts]:
        """What each rung of a source changes."""
        return [rung.change for rung in of(self.rungs, source)]

    def estimate(self, missing: MissingModes | None = None) -> Estimate:
        """Errors of the run by source, in total and of each joint."""
        base = results(self.base)
        parts = errors_of(base, self.rungs)
        rests = (rest_of(of(self.rungs, source)) for source in parts if source != "total")
        left = sum(rest["friction_energy"] or 0.0 for rest in rests)
        truth, joints = _climbed(base, self.rungs), self.base.system.contact.joints
        return Estimate(parts, missing, by_joint=joint_differences(truth, base, joints, left))


def _condensed(system: System) -> bool:
    """Whether contact has unknowns of its own, and does not share the few of a reduced model."""
    return bool(sparse.issparse(system.contact.B))


def apart(fine: Run, coarse: Run) -> Parts:
    """Difference of two runs over the same times.

    Energies and peaks of different runs may agree by chance in the last cycle. The root mean square
    of their differences in the last quarter of the cycles is therefore a lower bound, unless the
    difference of the displacement histories is smaller.
    """
    better, other = results(fine), results(coarse)
    errors = difference(better, other)
    last, motion = max(1, fine.cycles.friction.size // 4), errors[QUANTITIES[0]]
    for name, ours, theirs in zip(QUANTITIES[1:], by_cycle(fine), by_cycle(coarse), strict=True):
        error = errors[name]
        if error is not None and ours.size:
            mean = float(np.sqrt(np.mean((ours - theirs)[-last:] ** 2))) / abs(float(ours[-1]))
            errors[name] = max(error, mean if motion is None else min(mean, motion))
    return at_least(errors, better, other)


def at_least(total: Parts, truth: Results, base: Results, *parts: Parts) -> Parts:
    """Errors with lower bounds, because parts may cancel by chance.

    The bounds are the largest part, and of peaks and energies a share of the error in the
    displacement history of the point that moves most.
    """
    errors = dict(total)
    main = difference(truth.most_moving(), base.most_moving(truth))[QUANTITIES[0]]
    for name, error in total.items():
        if error is not None:
            share = 0.0 if name == QUANTITIES[0] else 0.1 * (main or 0.0)
            errors[name] = max(error, share, *(part[name] or 0.0 for part in parts))
    return errors


def by_cycle(run: Run) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Peak, friction energy and work of the loads of each cycle."""
    cycles = run.cycles
    return cycles.peak.max(axis=1, initial=0.0), cycles.friction, cycles.input.sum(axis=1)


def cycles_to_settle(run: Run, settled: float, fewest: int) -> int:
    """Cycles after which peak and energies of a run change by less than a share ``settled``.

    At least ``fewest``; all of them where they go on changing.
    """
    series = np.stack(by_cycle(run))
    last = series[:, -1:]
    changes = np.any(np.abs(series - last) > settled * np.abs(last), axis=0)
    return max(fewest, int(np.flatnonzero(changes).max(initial=-1)) + 2)
