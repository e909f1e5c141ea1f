"""Estimated errors of results, by the source of error.

The errors of a reduced or condensed model are estimated by verification runs of better models, each
better in one respect. No step of the full model is taken. (On short bars a run of the full model
would be cheaper, but verification runs take tenths of a second, and show which source errs.)

Where contact is small, the best of them is a condensed model with the full model's points and law
(:mod:`skfem_joint.analysis.condensed_reference`), run with the step itself, with half and with a
quarter of it. The total is the distance from its finest run and what that leaves. All contact
points instead of the reduced model's, and then a steeper law, on the same basis, tell points and
law from the basis. On plates with several bolts under Coulomb's law errors fall so slowly with
modes that nothing else was reliable.

Where contact is larger, a condensed model would be too slow:

basis
    The residual of its run in the full equation shows which modes the basis misses
    (:mod:`skfem_joint.reduction.missing_modes`). The model is run again with the first of these
    modes and with the next proper modes of its own snapshots. If that changes the results, it is
    run once more with the modes that this run misses, and again with twice as many of them where
    changes do not fall. The ratio of the last change to the one before is extrapolated to what is
    missing.
law
    A law of friction ten times as steep, but no steeper than the full model's, with the first of
    the missing modes; further verification runs keep it.
points
    All contact points in place of its few friction points.
time step
    Half and a quarter of it, with all missing modes that were added: on a poor basis the motion is
    too smooth, and the error of the step another one. (Half the step alone changed the results of a
    bar under a table with kinks by 0.8 %, where they were 6.5 % off: both missed the same modes.
    With the first of the missing modes only, 40 in place of 42, a quarter of the step raised the
    peak of a bar by 2.4 %, which in truth it lowers by 1.2 %.)

A condensed model has the law and the points of the full one: only its basis and its time step err.
Verification runs end with the cycle in which the reduced run has become steady; if it does not they
are whole runs. If there are very many contact points, verification runs merge them; the first
cycles of a run with all points show what that causes.

The verification runs lead step by step from the model asked for to the best one. Energies may rise
and fall on that way, so that the total error is that of the whole way and not the sum of its parts,
plus what the last run of each kind still leaves.

Without inertia a condensed model is exact but for its step, and so is the reference of a reduced
one in quasi-static runs; where contact is large the full model itself takes its place.

Errors of a full model are those of its time step, see :mod:`skfem_joint.analysis.step_estimate`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from skfem_joint.analysis.condensed_reference import CondensedReference
from skfem_joint.analysis.history import (
    QUANTITIES,
    Results,
    difference,
    extrapolation,
    joint_differences,
    results,
)
from skfem_joint.arrays import FloatArray
from skfem_joint.reduction.basis import Basis
from skfem_joint.reduction.condensed import carrying, slips_picked
from skfem_joint.reduction.friction_points import SETTINGS as MERGING
from skfem_joint.reduction.friction_points import merged_points, shared_points
from skfem_joint.reduction.missing_modes import Residual, stride
from skfem_joint.stepping.arrangement import picks_unknowns
from skfem_joint.stepping.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.stepping.steady import odd_loads
from skfem_joint.system import System

#: Sources of error, as a summary names them. The distance from Coulomb's law is in no total, see
#: `skfem_joint.analysis.against_coulomb`.
SOURCES = ("basis", "law", "points", "mesh", "time_step", "full_run", "total", "coulomb")
#: What a total is called that leaves the mesh out.
WITHOUT_MESH = "total without mesh"
#: What a table calls those whose names say too little.
NAMES = {"coulomb": "against Coulomb's law"}


#: Relative change of cycles below which they are alike.
SETTLED = 0.01
#: Contact points beyond which they are merged in verification runs.
MANY = MERGING.many
#: Sets that they are merged into.
MERGED = MERGING.merged
#: Cycles of a run with all points.
SHORT = 2
#: Modes that are added to a basis at a time, twice; oftener where a residual has fewer, as those
#: of a slip front that the basis holds (each verification run frees the next points), and twice
#: and four times as many where the changes do not fall.
ADDED = 8
#: Relative change by added modes below which no more are added.
ENOUGH = 1e-3
#: Ratio of a change by added modes to the one before above which more are added. The rest is
#: extrapolated with it where the ratio is not known, or where the change is less than `ENOUGH`.
SLOWEST = 0.4
#: Steepness of the law in its verification run over that of the model.
STEEPER = 10.0


#: Relative errors by quantity; None: not known, or zero in the result.
Parts = dict[str, float | None]

#: Error of each joint's friction energy, over that of all joints and over its own.
ByJoint = Mapping[str, tuple[float | None, float | None]]


@dataclass(frozen=True)
class MissingModes:
    """Modes that the basis of a reduced model misses.

    Attributes
    ----------
    V : ndarray, shape (n, j)
        The basis with the modes that it misses.
    velocities : ndarray, shape (times, j)
        Velocities of the coordinates in a run with that basis.
    slips : bool
        Whether the first of them is slip, and not motion out of contact.
    """

    V: FloatArray
    velocities: FloatArray
    slips: bool


@dataclass(frozen=True, repr=False)
class Estimate:
    """Estimated relative errors of one model's results.

    Attributes
    ----------
    parts : mapping
        Errors by source (see `SOURCES`) and by quantity; a source that is not there is not
        estimated.
    missing : MissingModes, optional
        Modes that a reduced model misses.
    unmeasured : mapping, optional
        Total as it was estimated before the full model's run was known, where it is.
    by_joint : mapping
        Error of the friction energy of each joint, by its name: relative to the friction energy of
        all joints, and to the joint's own. None where that is zero; empty where not estimated.
    """

    parts: Mapping[str, Parts]
    missing: MissingModes | None = field(default=None, repr=False)
    unmeasured: Parts | None = field(default=None, repr=False)
    by_joint: ByJoint = field(default_factory=dict)

    def beside(self, full_run: Parts, by_joint: ByJoint | None = None) -> Estimate:
        """Copy with the distances from a run of the full model; no total is less than they are.

        A total that is not known is then that distance, without the full model's own error.
        ``by_joint`` has the distances of the joints' friction energies.
        """
        stated = self.parts.get("total", {})
        total: Parts = {}
        for name in QUANTITIES:
            known = [e for errors in (stated, full_run) if (e := errors.get(name)) is not None]
            total[name] = max(known, default=None)
        parts = {**self.parts, "full_run": full_run, "total": total}
        joints = dict(self.by_joint)
        for name, measured in (by_joint or {}).items():
            joints[name] = _larger(measured, joints.get(name, (None, None)))
        return replace(self, parts=parts, unmeasured=dict(stated), by_joint=joints)

    @property
    def lacks_mesh(self) -> bool:
        """Whether the total leaves out what the size and order of the elements do."""
        return all(error is None for error in self.parts.get("mesh", {}).values())

    def __repr__(self) -> str:
        lines = ["Estimate of relative errors:"]
        for source, errors in self.parts.items():
            known = {name: e for name, e in errors.items() if e is not None}
            shown = ", ".join(f"{name} {100.0 * e:.2g} %" for name, e in known.items())
            label = WITHOUT_MESH if source == "total" and self.lacks_mesh else source
            lines.append(f"  {label.replace('_', ' ')}: {shown or 'not known'}")
        return "\n".join(lines)

    @property
    def worst_joint(self) -> str | None:
        """Joint whose friction energy errs most in relation to its own; None if not known."""
        known = {name: own for name, (_, own) in self.by_joint.items() if own is not None}
        return max(known, key=lambda name: known[name], default=None)

    def of(self, source: str, quantity: str) -> float | None:
        """Error of a quantity from a source; None where it is not known."""
        return self.parts.get(source, {}).get(quantity)


def _larger(
    first: tuple[float | None, float | None], second: tuple[float | None, float | None]
) -> tuple[float | None, float | None]:
    """The larger ones of two pairs of errors that may be unknown."""
    a, b = (
        max((e for e in pair if e is not None), default=None)
        for pair in zip(first, second, strict=True)
    )
    return a, b


def verification_run(
    system: System,
    plan: Plan,
    *,
    fields_every: int = 0,
    initial: tuple[FloatArray, FloatArray] | None = None,
    progress: Callable[..., None] | None = None,
) -> Run:
    """Run a system to estimate errors: it stores its named points, and fields every so many steps.

    ``initial`` is where a search for steady vibration starts. An interrupt is raised as
    KeyboardInterrupt: half a run is of no use.
    """
    plan = plan.storing(fields_every=fields_every)
    return integrate_plan(system, plan, initial=initial, progress=progress).finished()


class Verification:
    """Runs of one model and of others on bases that begin alike.

    Where the steady vibration is unique, and with contact that opens, where it is one of perhaps
    several, a search for it starts from the last one of a model with as many modes, or else from
    the last one of any. (On a lapped solid the searches of an estimate
    took half the time from there.)

    Parameters
    ----------
    progress : callable or None
        As `integrate` takes it.
    run : Run, optional
        First run, of the model itself.
    """

    def __init__(self, progress: Callable[..., None] | None, run: Run | None = None) -> None:
        self.progress = progress
        self.states = {} if run is None else {run.system.n: (*run.final,)}

    def __call__(self, system: System, plan: Plan, *, fields_every: int = 0) -> Run:
        """Run a system as `verification_run`."""
        opens = system.contact.opens
        alike = plan.until == "steady" and (odd_loads(system) or opens)
        initial = self.states.get(system.n)
        if alike and initial is None and self.states:
            initial = np.zeros(system.n), np.zeros(system.n)
            for whole, known in zip(initial, [*self.states.values()][-1], strict=True):
                whole[: known.size] = known[: whole.size]
        run = verification_run(
            system,
            plan,
            fields_every=fields_every,
            initial=initial if alike else None,
            progress=self.progress,
        )
        if alike:
            self.states.pop(system.n, None)  # so that the last one stands last
            self.states[system.n] = (*run.final,)
        return run


def of_reduced(
    system: System,
    basis: Basis,
    reduced: System,
    plan: Plan,
    run: Run | None = None,
    progress: Callable[..., None] | None = None,
    reference: CondensedReference | None = None,
) -> Estimate:
    """Errors of a reduced or condensed model.

    Parameters
    ----------
    system : System
        The full model.
    basis : Basis
    reduced : System
        The model on it.
    plan : Plan
        Of its whole run.
    run : Run, optional
        That run; it is made here if it is needed and not given.
    progress : callable, optional
        As `integrate` takes it.
    reference : CondensedReference, optional
        Condensed model of the system, if it exists already, whose runs are used again.

    Raises
    ------
    ConvergenceError
        If a step of a verification run does not converge.
    KeyboardInterrupt
        If one is interrupted.
    """
    steepest = reduced.contact.steepest
    points = _Points.of(system, basis, reduced)
    verify = Verification(progress, run)
    if run is None or not plan.save.points:
        run = verify(reduced, plan)
    if plan.cycle_steps is not None:
        steps, plan = plan.n_steps, plan.first(_settles(run))
        if plan.n_steps < steps:
            run = verify(reduced, plan)
    base = results(run)
    if plan.quasi_static:
        return _of_slow(points, reduced, steepest, plan, run, (verify, progress, reference))
    if reference is None and not points.condensed:
        reference = CondensedReference.of(system)
    periods, steeper = run.steady.periods if run.steady else 1, system.contact.steepest > steepest
    if reference is not None and reference.affords(plan, periods, steeper):
        return _by_reference(points, reference, steepest, plan, base, verify, progress)
    merged = _merged(points, steepest, plan, verify)
    changes, V, last = _enriched(points, steepest, plan, verify)
    (first, grown), best = changes[0], results(last)
    steep = best if len(changes) == 1 else changes[1][0]
    beta = last.system.contact.steepest
    law = extrapolation(STEEPER) - 1.0 if beta > steepest else 0.0
    finer = Steps(last, *(verify(last.system, plan.finer(factor)) for factor in (2, 4)))
    truth = finer.finest

    def change(first: Results, second: Results, factor: float = 1.0) -> Parts:
        return difference(truth, truth.plus(factor, first, second))

    whole = first
    for before, after in changes:
        whole = whole.plus(1.0, after, before)
    left = _left([change(after, before) for before, after in changes])
    parts = {
        "basis": added(change(whole, first), left),
        "law": change(steep, grown, 1.0 + law),
        "points": added(change(first, base), merged),
        "time_step": finer.with_rest(truth, best),
    }
    total = added(finer.with_rest(truth, base), left, change(steep, grown, law), merged)
    parts["total"] = at_least(total, best, base, *parts.values())
    missing = MissingModes(V, last.v, _slips(system, V[:, basis.V.shape[1] :]))
    joints = joint_differences(truth, base, system.contact.joints, _rest(left))
    return Estimate(parts, missing, by_joint=joints)


@dataclass(frozen=True)
class Steps:
    """Runs of one model with a step, with half and maybe with a quarter of it.

    What the last change by the step leaves of the error follows it as a geometric series. Where
    both changes go the same way, and the way of the distance that the rest is added to, so does the
    rest, and it is added. Where they do not, the series has no sign: the rest may as well make the
    error smaller, and the two are combined as independent errors are, by the root of the sum of
    their squares. (A plate with bolts under a versine errs by 0.52 % in its friction energy; half
    of the step makes that 1.02 %, a quarter of it 0.06 % on the other side. The sum of distance and
    rest is 1.7 %, the root 1.2 %.)

    Attributes
    ----------
    run, half : Run
    quarter : Run, optional
        Without it the step is taken to be of second order.
    """

    run: Run
    half: Run
    quarter: Run | None = None

    @property
    def finest(self) -> Results:
        """Results with the shortest step."""
        return results(self.quarter or self.half)

    @cached_property
    def left(self) -> Parts:
        """What the shortest step leaves of the step's error."""
        first = apart(self.half, self.run)
        if self.quarter is None:
            return left_of_steps(None, first)
        return left_of_steps(first, apart(self.quarter, self.half))

    def with_rest(self, truth: Results, base: Results) -> Parts:
        """Distance of some results from better ones, with what the shortest step leaves.

        Parameters
        ----------
        truth : Results
            With the shortest step.
        base : Results
            With the step itself.
        """
        errors: Parts = {}
        for name, distance in difference(truth, base).items():
            rest = self.left[name]
            if distance is None or rest is None:
                errors[name] = None
            elif self._go_on(name, truth, base):
                errors[name] = distance + rest
            else:
                errors[name] = math.hypot(distance, rest)
        return errors

    def _go_on(self, name: str, truth: Results, base: Results) -> bool:
        """Whether both changes by the step go the way of a distance."""
        if self.quarter is None:
            return True
        run, half, quarter = (results(each) for each in (self.run, self.half, self.quarter))
        if name == QUANTITIES[0]:
            rows = min(len(x.point_u) for x in (run, half, quarter, truth, base))
            values = [x.point_u[:rows] for x in (run, half, quarter, truth, base)]
        else:
            values = [np.asarray(getattr(x, name)) for x in (run, half, quarter, truth, base)]
        first, last = values[1] - values[0], values[2] - values[1]
        way = min(np.vdot(last, first), np.vdot(last, values[3] - values[4]))
        return bool(way > 0.0)


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


def left_of_steps(before: Parts | None, last: Parts) -> Parts:
    """What halving a step leaves of its error, when changes go on as a geometric series.

    Parameters
    ----------
    before, last : dict
        Changes by half of the step, and by a quarter in place of half of it. Without the first of
        them the step is taken to be of second order.
    """
    # Bounds of the ratio of the change by a quarter of the step to that by half of it: second and
    # first order.
    least, most = 0.25, 0.5

    def ratio(name: str, change: float) -> float:
        if before is None:
            return least
        first = before[name]
        return min(max(change / first, least), most) if first else most

    return {
        name: None if change is None else _series(change, ratio(name, change))
        for name, change in last.items()
    }


def _series(last: float, ratio: float) -> float:
    """Sum of what follows the last term of a geometric series."""
    return last * ratio / (1.0 - ratio)


def _by_reference(
    points: _Points,
    reference: CondensedReference,
    beta: float,
    plan: Plan,
    base: Results,
    verify: Callable[..., Run],
    progress: Callable[..., None] | None,
) -> Estimate:
    """Errors of a reduced model whose results are ``base``, by a condensed model's runs."""
    system, V = points.system, points.basis.V
    every = results(verify(points.everywhere(V, beta), plan))
    steep, law = every, 1.0
    if system.contact.steepest > beta:
        steep = results(verify(points.everywhere(V, STEEPER * beta), plan))
        law = extrapolation(STEEPER)
    of_condensed = Verification(progress)
    run, *finer = (reference.run(plan.finer(factor), of_condensed) for factor in (1, 2, 4))
    steps, same = Steps(run, *finer), results(run)
    finest = steps.finest

    def change(first: Results, second: Results, factor: float = 1.0) -> Parts:
        return difference(finest, finest.plus(factor, first, second))

    parts = {
        "basis": change(same, steep),
        "law": change(steep, every, law),
        "points": change(every, base),
        "time_step": steps.with_rest(finest, same),
    }
    total = steps.with_rest(finest, base)
    parts["total"] = at_least(total, same, base, *parts.values())
    most = max(2 * ADDED, V.shape[1] // 2)
    wide, velocities = reference.missing_modes(V, run, most)
    missing = MissingModes(wide, velocities, _slips(system, wide[:, V.shape[1] :]))
    return Estimate(
        parts,
        missing,
        by_joint=joint_differences(finest, base, system.contact.joints, _rest(steps.left)),
    )


def _of_slow(
    points: _Points,
    reduced: System,
    beta: float,
    plan: Plan,
    run: Run,
    means: tuple[Callable[..., Run], Callable[..., None] | None, CondensedReference | None],
) -> Estimate:
    """Errors of the quasi-static ``run`` of a reduced or condensed model.

    ``means`` are how models are run, progress, and a condensed model if it exists already.
    """
    (verify, progress, known), base = means, results(run)
    if points.condensed:  # its statics are those of the full model
        steps = Steps(run, *(verify(reduced, plan.finer(factor)) for factor in (2, 4)))
        errors, finest = steps.with_rest(steps.finest, base), steps.finest
        nothing: Parts = dict.fromkeys(QUANTITIES, 0.0)
        joints = joint_differences(finest, base, reduced.contact.joints, _rest(steps.left))
        parts = {"basis": nothing, "time_step": errors, "total": errors}
        return Estimate(parts, by_joint=joints)
    reference = known or CondensedReference.of(points.system)
    reference = reference or CondensedReference.whole(points.system)
    found = _by_reference(points, reference, beta, plan, base, verify, progress)
    # Parts may cancel in their sum, but not in a run of the full model beside the reduced one.
    bound = added(*(found.parts[source] for source in ("basis", "points", "time_step")))
    return replace(found, parts={**found.parts, "total": bound})


def _settles(run: Run) -> int:
    """Cycles after which a run's energies and peak hardly change any more, or all of them."""
    # Fewest cycles of a verification run.
    return cycles_to_settle(np.stack(by_cycle(run)), SETTLED, 4)


def cycles_to_settle(series: FloatArray, settled: float, fewest: int) -> int:
    """Cycles after which rows of ``series`` (rows, cycles) change by less than a share ``settled``.

    At least ``fewest``; all of them where the rows go on changing.
    """
    last = series[:, -1:]
    changes = np.any(np.abs(series - last) > settled * np.abs(last), axis=0)
    return max(fewest, int(np.flatnonzero(changes).max(initial=-1)) + 2)


def by_cycle(run: Run) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Peak, friction energy and work of the loads of each cycle."""
    cycles = run.cycles
    return cycles.peak.max(axis=1, initial=0.0), cycles.friction, cycles.input.sum(axis=1)


@dataclass(frozen=True)
class _Points:
    """Contact points of verification runs: all of them, or merged ones where they are many.

    Attributes
    ----------
    system : System
        The full model.
    basis : Basis
        Of the reduced model.
    condensed : bool
        Whether the basis keeps all points as unknowns, which costs nothing.
    projected : dict of int to System
        Projections by the number of modes; each basis begins with the one before.
    """

    system: System
    basis: Basis
    condensed: bool
    projected: dict[int, System]

    @staticmethod
    def of(system: System, basis: Basis, reduced: System) -> _Points:
        """Points for a reduced or condensed model."""
        if not picks_unknowns(reduced.contact.B):
            return _Points(system, basis, condensed=False, projected={})
        known = {basis.V.shape[1]: reduced}
        return _Points(carrying(system), basis, condensed=True, projected=known)

    @property
    def all_are_kept(self) -> bool:
        """Whether verification runs have all contact points, because they are not too many."""
        return self.condensed or self.system.contact.count <= MANY

    @cached_property
    def merged(self) -> System:
        """Reduced model with merged points."""
        unmerged, points = self.projection(self.basis.V), np.flatnonzero(self.system.contact.w)
        return merged_points(unmerged, self.basis.history.velocities, points, MERGED)

    def projection(self, V: FloatArray) -> System:
        """Projection on V, which begins with the basis and with all V before; made once."""
        j, known = V.shape[1], self.projected
        if j not in known and not known:
            known[j] = self.system.project(V)
        elif j not in known:
            most = max(known)
            known[j] = self.system.widened(known[most], V[:, :most], V[:, most:])
        return known[j]

    def everywhere(self, V: FloatArray, beta: float) -> System:
        """Model on V with all points, under the law of the full one but no steeper than asked."""
        laws = self.projection(V).with_contact(beta=self.system.contact.beta)
        return laws.no_steeper(beta)

    def model(self, V: FloatArray, beta: float) -> System:
        """Reduced model on V with the points of verification runs."""
        if self.condensed:
            return slips_picked(self.everywhere(V, beta))
        small = self.everywhere(V, beta)
        if self.all_are_kept:
            return small
        return shared_points(small, self.merged.contact.shares, self.merged.contact.w)


def _merged(points: _Points, beta: float, plan: Plan, verify: Callable[..., Run]) -> Parts:
    """Error that merged contact points cause, by the first cycles of a run with all of them.

    It is zero if no points are merged.
    """
    if points.all_are_kept:
        return dict.fromkeys(QUANTITIES, 0.0)
    some = plan.first(plan.n_steps // 2 if plan.cycle_steps is None else SHORT)
    both = points.everywhere(points.basis.V, beta), points.model(points.basis.V, beta)
    return difference(*(results(verify(system, some)) for system in both))


def at_least(total: Parts, truth: Results, base: Results, *parts: Parts) -> Parts:
    """Errors of peaks and energies with lower bounds, because parts may cancel by chance.

    The bounds are a share of the largest part, and a share of the error in the displacement history
    of the point that moves most.
    """
    errors = dict(total)
    main = difference(truth.most_moving(), base.most_moving(truth))[QUANTITIES[0]]
    for name in QUANTITIES[1:]:
        error = total[name]
        if error is not None:
            others = (0.7 * (part[name] or 0.0) for part in parts)
            # It is no less than a share of its largest part, and of the error in the history of
            # the point that moves most, without that of the step: parts may cancel by chance.
            # Changes by the step have the second bound by themselves.
            errors[name] = max(error, 0.1 * (main or 0.0), *others)
    return errors


def _enriched(
    points: _Points, beta: float, plan: Plan, verify: Callable[..., Run]
) -> tuple[list[tuple[Results, Results]], FloatArray, Run]:
    """Results before and after each addition of missing modes, the last basis, and its run.

    All runs but the first have a steeper law, if the full model has one: with the law of a poor
    basis, points would still creep although the added modes let them stick.
    """
    V, known = points.basis.V, points.basis.followed
    residual = Residual(points.system, points.basis.stiffness)
    fields = stride(plan.n_steps, plan.cycle_steps)
    most, steeper = V.shape[1] + 2 * ADDED, points.system.contact.steepest > beta
    stored = partial(verify, plan=plan, fields_every=fields)
    run = stored(points.model(V, beta))
    changes: list[tuple[Results, Results]] = []
    while len(changes) < 2 or (
        # Most times that modes are added.
        len(changes) < 4 and (V.shape[1] < most or _is_slow(changes))
    ):
        before, more = results(run), ADDED * 2 ** max(0, len(changes) - 1)
        V = np.hstack([V, residual.missing_modes(V, run, more, known)])
        run = stored(points.model(V, beta))
        changes.append((before, results(run)))
        changed = difference(*reversed(changes[-1])).values()
        if steeper:
            beta, steeper = STEEPER * beta, False
            run = stored(points.model(V, beta))
        if max((e for e in changed if e is not None), default=0.0) < ENOUGH:
            break
    return changes, V, run


def _is_slow(changes: list[tuple[Results, Results]]) -> bool:
    """Whether the last change by added modes is no small share of the one before."""
    before, last = (difference(*reversed(pair)) for pair in changes[-2:])
    return any(
        error is not None and error > max(ENOUGH, SLOWEST * (before[name] or 0.0))
        for name, error in last.items()
    )


def _rest(left: Parts) -> float:
    """What is left of the friction energy; zero where it is not known."""
    return left["friction_energy"] or 0.0


def _left(changes: list[Parts]) -> Parts:
    """What is left after changes by added modes that go on as a geometric series."""
    errors: Parts = {}
    for name in QUANTITIES:
        last, ratio = changes[-1][name], SLOWEST
        if len(changes) > 1 and last is not None:
            before = changes[-2][name] or 0.0
            # Largest ratio that the rest is extrapolated with.
            most = 0.75 if last > ENOUGH else SLOWEST
            ratio = min(last / before, most) if before > 0.0 else most
        errors[name] = None if last is None else _series(last, ratio)
    return errors


def added(*parts: Parts) -> Parts:
    """Sum of errors by quantity; None where one of them is not known."""
    errors: Parts = {}
    for name in QUANTITIES:
        known = [error for part in parts if (error := part[name]) is not None]
        errors[name] = sum(known) if len(known) == len(parts) else None
    return errors


def _slips(system: System, modes: FloatArray) -> bool:
    """Whether the first of some modes is slip rather than motion out of contact."""
    if modes.shape[1] == 0:
        return False
    slip = float(np.abs(system.contact.B @ modes[:, 0]).max(initial=0.0))
    return slip > 0.5 * float(np.abs(modes[:, 0]).max())
