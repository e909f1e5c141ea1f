"""Estimated errors of results, by the source of error.

A reduced or condensed model is looked at from four sides, and no step of the full one is done (on
short bars, where that would be cheaper, looks take tenths of a second, and say which source errs):

basis
    The residual of its run in the full equation tells what the basis lacks (:mod:`skfem_joint
    .reduction.missing_modes`). With the first modes of that, and the next of what its own modes
    come from, the model is run again, and once more with what that run lacks, unless they hardly
    changed anything. How the second change relates to the first tells what is still missing.
law
    A law of friction ten times as steep, but no steeper than the full model's, with the first of
    what the basis lacks; further looks at the basis keep it.
points
    All contact points instead of its few friction points.
time step
    Half of it, with the first of what the basis lacks: a poor one is smoother than the truth.
    (Twice the step, which full models are run with, stated a fifth of an error in energy of 2.7 %
    with 60 steps a period.)

A condensed model has law and points of the full one: there its basis and time step alone err.
Looks end with the cycle in which the reduced run has settled: a transient goes on to matter.
Where contact points are very many they are merged in looks; all of them tell at the velocities of a
run what that leaves out, and the run is made again under it (or with all, where that is much).

The looks are steps of one way, from the model asked for to the best one: energies may go up and
down on it, so that the total error is that of the whole way, and not the sum of the parts, plus
what the last look of each kind still leaves.

A full model is run with twice the step; with half of it where twice is too long for the load, or
tells of large errors, which that one only guesses (a resonant structure's friction energy with 50
steps a period: 4.3 % off, 2.0 % by twice the step, 4.3 % by half), and a quarter where the step is
too long itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from skfem_joint.analysis.history import QUANTITIES, Results, difference, results
from skfem_joint.arrays import FloatArray
from skfem_joint.loads import Function
from skfem_joint.minimise import law
from skfem_joint.reduction.basis import Basis
from skfem_joint.reduction.condensed import carrying, slips_first
from skfem_joint.reduction.friction_points import SETTINGS as MERGING
from skfem_joint.reduction.friction_points import merged_points, shared_points
from skfem_joint.reduction.missing_modes import Residual, stride
from skfem_joint.stepping.arrangement import picks_unknowns
from skfem_joint.stepping.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.stepping.resolution import longest_step
from skfem_joint.system import AppliedLoad, System

#: Sources of error, as a summary names them.
SOURCES = ("basis", "law", "points", "mesh", "time_step", "full_run", "total")
#: Relative change of cycles below which they are alike.
SETTLED = 0.01
#: Fewest cycles of looks; most steps of a correction for all points, unless one cycle has more, how
#: many numbers it takes at once, and up to what it is believed; cycles of the look at all points.
FIRST, MOST_STEPS, AT_ONCE, SURE, SHORT = 4, 4000, 300_000, 5e-3, 2
#: Modes that are added at a time, twice; oftener where a residual has fewer, as those of a slip
#: front that the basis holds: each look frees the next points.
ADDED, MOST_LOOKS = 8, 4
#: Steepness of the law's look over that of the model's.
STEEPER = 10.0
#: Share of an energy's or peak's largest part, and of the error in the history of the point that
#: moves most, below which its error does not fall because parts cancel.
CHANCE, AT_LEAST = 0.7, 0.1
#: Change, relative, by modes that are added from which on no more are.
ENOUGH = 1e-3
#: Largest ratio of the second change to the first that what is left is taken from.
SLOWEST = 0.4
#: Twice the step is looked at where it is at most this share of what a load allows (20 steps in a
#: period): longer ones may agree with each other and miss the joint's higher harmonics.
FOLLOWS = 0.4
#: Error of a step over the difference to half of it, of second order.
HALVED = 4.0 / 3.0
#: Error of a step over the difference to twice the step: 1/3 for second order, more with friction.
SMOOTH = 0.45
#: Difference to twice the step, relative, from which on half of it is looked at: errors this large
#: do not yet fall with the square of the step.
LONG = 0.05

#: Relative errors by quantity; None: not known, or zero in the result.
Parts = dict[str, float | None]


@dataclass(frozen=True)
class Lacking:
    """What a reduced model lacks."""

    V: FloatArray  #: (n, j), its basis with what it lacks
    velocities: FloatArray  #: (times, j), of the coordinates in a run with that
    slips: bool  #: whether the most of it is slip, and not motion out of contact


@dataclass(frozen=True)
class Estimate:
    """Estimated relative errors of one model's results.

    ``parts`` are by source, see `SOURCES`, and quantity; what is not there is not estimated.
    """

    parts: Mapping[str, Parts]
    lacks: Lacking | None = field(default=None, repr=False)
    #: Total as it was estimated before the full model's run was known, where it is.
    unmeasured: Parts | None = field(default=None, repr=False)

    def beside(self, full_run: Parts) -> Estimate:
        """With the distances from a run of the full model; a total is no less than they are.

        A total that is not known is then that distance, without the full model's own error.
        """
        stated = self.parts.get("total", {})
        total = {
            name: max((e for one in (stated, full_run) if (e := one.get(name)) is not None),
                      default=None)
            for name in QUANTITIES
        }  # fmt: skip
        parts = {**self.parts, "full_run": full_run, "total": total}
        return replace(self, parts=parts, unmeasured=dict(stated))

    def of(self, source: str, quantity: str) -> float | None:
        """One of the errors; None where it is not known."""
        return self.parts.get(source, {}).get(quantity)


def verification_run(
    system: System,
    plan: Plan,
    *,
    fields_every: int = 0,
    progress: Callable[..., None] | None = None,
) -> Run:
    """Whole run of a system that stores its named points, and fields every so many steps."""
    plan = plan.storing(fields_every=fields_every)
    return integrate_plan(system, plan, progress=progress).finished()


def of_run(
    system: System,
    basis: Basis | None,
    run: Run,
    plan: Plan,
    progress: Callable[..., None] | None = None,
) -> Estimate:
    """Errors of a model's run: a reduced one's, or without ``basis`` the full one's."""
    if basis is None:
        return of_full(system, run, plan, progress)
    return of_reduced(system, basis, run.system, plan, run, progress)


def of_reduced(
    system: System,
    basis: Basis,
    reduced: System,
    plan: Plan,
    run: Run | None = None,
    progress: Callable[..., None] | None = None,
) -> Estimate:
    """Errors of a reduced model.

    ``plan`` is that of its whole ``run``, which is made here if it is needed and not given.
    ConvergenceError if a step of a verification run does not converge, KeyboardInterrupt if one is
    interrupted.
    """
    steepest = float(reduced.beta.max())
    points = _Points.of(system, basis, reduced)
    verify = partial(verification_run, progress=progress)
    if run is None or not plan.save.points:
        run = verify(reduced, plan)
    if plan.cycle_steps is not None:
        plan = plan.first(_settles(run))
        if plan.n_steps < run.counters.steps:
            run = verify(reduced, plan)
    base = results(run)
    start, merged = _merged(points, steepest, plan, verify)
    looks, bases, last = _enriched(points, steepest, plan, start, verify)
    V, W = bases[-1], bases[1]
    (first, grown), best = looks[0], results(last)
    steep = best if len(looks) == 1 else looks[1][0]
    beta = float(last.system.beta.max())
    law = 1.0 / (STEEPER - 1.0) if beta > steepest else 0.0
    other = results(verify(points.model(W, beta), plan.finer(2)))
    truth = best.plus(HALVED, other, steep)

    def change(one: Results, other: Results, factor: float = 1.0) -> Parts:
        return difference(truth, truth.plus(factor, one, other))

    whole = first
    for before, after in looks:
        whole = whole.plus(1.0, after, before)
    left = _left([change(after, before) for before, after in looks])
    parts = {
        "basis": added(change(whole, first), left),
        "law": change(steep, grown, 1.0 + law),
        "points": added(change(first, base), merged),
        "time_step": change(other, steep, HALVED),
    }
    total = added(difference(truth, base), left, change(steep, grown, law), merged)
    parts["total"] = _at_least(total, truth, base, *parts.values())
    return Estimate(parts, Lacking(V, last.v, _slips(system, V[:, basis.V.shape[1] :])))


def _settles(run: Run) -> int:
    """Cycles after which a run's energies and peak hardly change any more, or all of them."""
    series = np.stack(_by_cycle(run))
    changes = np.any(np.abs(series - series[:, -1:]) > SETTLED * np.abs(series[:, -1:]), axis=0)
    return max(FIRST, int(np.flatnonzero(changes).max(initial=-1)) + 2)


def _by_cycle(run: Run) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Peak, friction energy and work of the loads of each cycle."""
    cycles = run.cycles
    return cycles.peak.max(axis=1, initial=0.0), cycles.friction, cycles.input.sum(axis=1)


def _twice(system: System, plan: Plan) -> bool:
    """Whether twice the step of a plan still follows the loads, and ends where it does."""
    whole = plan.n_steps % 2 == 0 and (plan.cycle_steps is None or plan.cycle_steps % 2 == 0)
    return whole and bool(2.0 * plan.step <= FOLLOWS * longest_step(system, plan.duration))


@dataclass(frozen=True)
class _Points:
    """Contact points of looks: all of them, or as many as it takes where they are many."""

    system: System
    basis: Basis
    condensed: bool  #: whether the basis keeps all of them as unknowns, which costs nothing
    projected: dict[int, System]  #: projections by the number of modes, each begins as the last

    @staticmethod
    def of(system: System, basis: Basis, reduced: System) -> _Points:
        """Those of a reduced or condensed model."""
        if not picks_unknowns(reduced.B):
            return _Points(system, basis, condensed=False, projected={})
        known = {basis.V.shape[1]: reduced}
        return _Points(carrying(system), basis, condensed=True, projected=known)

    @property
    def few(self) -> bool:
        return self.condensed or self.system.contact_points <= MERGING.many

    @cached_property
    def merged(self) -> System:
        every = self.projection(self.basis.V)
        points, rates = np.flatnonzero(self.system.w), self.basis.history.velocities
        return merged_points(every, rates, points, MERGING.merged)

    def projection(self, V: FloatArray) -> System:
        """Projection on V, which begins with the basis, and with those that were asked for."""
        j, known = V.shape[1], self.projected
        if j not in known and not known:
            known[j] = self.system.project(V)
        elif j not in known:
            most = max(known)
            known[j] = self.system.widened(known[most], V[:, :most], V[:, most:])
        return known[j]

    def everywhere(self, V: FloatArray, beta: float) -> System:
        """Reduced model on V with all points."""
        return replace(self.projection(V), beta=np.minimum(self.system.beta, beta))

    def model(self, V: FloatArray, beta: float) -> System:
        """Reduced model on V with as many points as looks have."""
        if self.condensed:
            return slips_first(self.projection(V))
        small = self.everywhere(V, beta)
        if self.few:
            return small
        return shared_points(small, self.merged.shares, self.merged.w)


def _merged(
    points: _Points, beta: float, plan: Plan, verify: Callable[..., Run]
) -> tuple[Run | None, Parts]:
    """What a look's points cause: none if it has all; before it a run of the look, if there is one.

    It is told by a correction, where that is small, else by the start of a run with all points.
    """
    if points.few:
        return None, dict.fromkeys(QUANTITIES, 0.0)
    V, cycle = points.basis.V, plan.cycle_steps
    every, few = points.everywhere(V, beta), points.model(V, beta)
    some = replace(plan, until="end").first(MOST_STEPS if cycle is None else MOST_STEPS // cycle)
    run = verify(few, some, fields_every=1)
    found = _corrected(every, run, some, verify)
    if max((error for error in found.values() if error is not None), default=0.0) > SURE:
        some = plan.first(plan.n_steps // 2 if cycle is None else SHORT)
        some = some.finer(0.5) if _twice(points.system, some) else some
        found = difference(*(results(verify(system, some)) for system in (every, few)))
    whole = plan.until != "steady" and run.counters.steps == plan.n_steps
    return run if whole else None, found


def _corrected(every: System, run: Run, plan: Plan, verify: Callable[..., Run]) -> Parts:
    """What few points cause in a run of a model that could have all, by a defect correction.

    In each step all of them tell what the few leave out, which acts as a load when the model is run
    again. That costs no iteration with all points. It says too much where few points do not resolve
    how the model slips: nothing then holds what differs within one of them.
    """
    few = run.system
    missing = _friction(every, run.v) - _friction(few, run.v)
    courses = [Function(partial(np.interp, xp=run.field_times, fp=-force)) for force in missing.T]
    added = map(AppliedLoad, np.eye(few.n), courses)
    corrected = verify(replace(few, loads=(*few.loads, *added)), replace(plan, until="end"))
    work, own = corrected.cycles.input, len(few.loads)
    work = work[-1] if len(work) else corrected.input_work
    found = results(corrected)
    lost = found.friction_energy - float(work[own:].sum())
    other = replace(found, friction_energy=lost, loop_energy=float(work[:own].sum()))
    return difference(other, results(run))


def _friction(system: System, v: FloatArray) -> FloatArray:
    """Forces of friction (times, n), N, at some velocities of the unknowns (times, n)."""
    B, limits = np.asarray(system.B), system.on_rows(system.w)
    parts = np.array_split(v, 1 + len(v) * len(B) // AT_ONCE)
    forces = (law.force_vectors(x @ B.T, system.beta, system.directions) for x in parts)
    return np.vstack([(limits * force) @ B for force in forces])


def _at_least(total: Parts, truth: Results, base: Results, *parts: Parts) -> Parts:
    """Errors of peaks and energies that do not vanish because their parts cancel by chance.

    They are no less than a share of the largest part, and of the error in the history of the point
    that moves most.
    """
    found = dict(total)
    main = difference(truth.most_moving(), base.most_moving(truth))[QUANTITIES[0]]
    for name in QUANTITIES[1:]:
        error = total[name]
        if error is not None:
            others = (CHANCE * (part[name] or 0.0) for part in parts)
            found[name] = max(error, AT_LEAST * (main or 0.0), *others)
    return found


def _enriched(
    points: _Points, beta: float, plan: Plan, start: Run | None, verify: Callable[..., Run]
) -> tuple[list[tuple[Results, Results]], list[FloatArray], Run]:
    """Results before and after a basis gets the next modes that it lacks, all bases, the last run.

    The first run may be there, with the fields of all steps. All but the first have a steeper law,
    where the full model has: modes that are there to hold points still creep with one that a poor
    basis resolves.
    """
    V, known = points.basis.V, points.basis.followed
    residual = Residual(points.system, points.basis.stiffness)
    fields = stride(plan.n_steps, plan.cycle_steps)
    most, steeper = V.shape[1] + 2 * ADDED, bool(np.any(points.system.beta > beta))
    stored = partial(verify, plan=plan, fields_every=fields)
    run = start.thinned(fields) if start else stored(points.model(V, beta))
    bases = [V]
    looks: list[tuple[Results, Results]] = []
    while len(looks) < 2 or (len(looks) < MOST_LOOKS and V.shape[1] < most):
        before = results(run)
        V = np.hstack([V, residual.missing_modes(V, run, ADDED, known)])
        run = stored(points.model(V, beta))
        looks.append((before, results(run)))
        bases.append(V)
        changed = difference(*reversed(looks[-1])).values()
        if steeper:
            beta, steeper = STEEPER * beta, False
            run = stored(points.model(V, beta))
        if max((e for e in changed if e is not None), default=0.0) < ENOUGH:
            break
    return looks, bases, run


def _left(changes: list[Parts]) -> Parts:
    """What is left after changes that go on as a geometric series."""
    found: Parts = {}
    for name in QUANTITIES:
        last, ratio = changes[-1][name], SLOWEST
        if len(changes) > 1 and last is not None:
            before = changes[-2][name] or 0.0
            ratio = min(last / before, SLOWEST) if before > 0.0 else 0.0
        found[name] = None if last is None else last * ratio / (1.0 - ratio)
    return found


def added(*parts: Parts) -> Parts:
    """Sum of errors by quantity; None where one of them is not known."""
    found: Parts = {}
    for name in QUANTITIES:
        known = [error for part in parts if (error := part[name]) is not None]
        found[name] = sum(known) if len(known) == len(parts) else None
    return found


def _slips(system: System, modes: FloatArray) -> bool:
    """Whether the first of some modes is slip rather than motion out of contact."""
    if modes.shape[1] == 0:
        return False
    slip = float(np.abs(system.B @ modes[:, 0]).max(initial=0.0))
    return slip > 0.5 * float(np.abs(modes[:, 0]).max())


def of_full(
    system: System, run: Run, plan: Plan, progress: Callable[..., None] | None = None
) -> Estimate:
    """Errors of a full model's run from its time step.

    ConvergenceError if a step of the other run does not converge, KeyboardInterrupt if it is
    interrupted.
    """
    verify = partial(verification_run, system, progress=progress)
    found = _of_twice(system, run, plan, verify)
    if found is None:
        factor = 2.0 if plan.step <= FOLLOWS * longest_step(system, plan.duration) else 4.0
        found = _times(1.0 / (1.0 - factor**-2), _steps_apart(verify(plan.finer(factor)), run))
    return Estimate({"time_step": found, "total": found})


def _of_twice(system: System, run: Run, plan: Plan, verify: Callable[..., Run]) -> Parts | None:
    """Errors of a full model's run from twice its step; None where that is too long to tell."""
    if not _twice(system, plan):
        return None
    thinner = replace(plan, save=replace(plan.save, every=2 * plan.save.every))
    apart = _steps_apart(run, verify(thinner.finer(0.5)), 2)
    if max((e for e in apart.values() if e is not None), default=0.0) > LONG:
        return None
    return _times(SMOOTH, apart)


def _times(factor: float, parts: Parts) -> Parts:
    return {name: None if e is None else factor * e for name, e in parts.items()}


def _steps_apart(fine: Run, coarse: Run, every: int = 1) -> Parts:
    """Difference of two runs of one model; ``every`` so many rows of the first are in the other.

    Where runs far apart meet by chance in the last cycle, the cycles before it tell, but no more
    than the histories are apart.
    """
    found = difference(results(fine, every), results(coarse))
    last, motion = max(1, fine.cycles.friction.size // 4), found[QUANTITIES[0]]
    for name, one, other in zip(QUANTITIES[1:], _by_cycle(fine), _by_cycle(coarse), strict=True):
        error = found[name]
        if error is not None and one.size:
            mean = float(np.sqrt(np.mean((one - other)[-last:] ** 2))) / abs(float(one[-1]))
            found[name] = max(error, mean if motion is None else min(mean, motion))
    return _at_least(found, results(fine, every), results(coarse))
