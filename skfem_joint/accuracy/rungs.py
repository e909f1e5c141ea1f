"""Which rungs the ladder of a model has, see :mod:`skfem_joint.accuracy.ladder`.

A full model errs by its step alone. A longer step says nothing of what the step itself does not
follow: friction and kinks of loads excite higher modes, which a coarse run leaves at rest, and one
with twice the step all the more. (Of 412 quantities of 141 random scenes twice the step stated 86 %
between a half and three times the truth, a half step 94 %, a half and a quarter 99 %.) So the step
is halved twice, and a third time where a change is larger than the one before, or where impacts
take energy, whose times leave errors of first order with any ratio. (A mass that bounces on a
spring of contact for eight steps at a time: the work of the loads errs by 3.7 %, with half and a
quarter of the step by 3.6 and 2.9 %, of which the series makes 1.6 %, with an eighth 3.1 %.)

Small full models are run themselves, which takes four to six times as long as the run. Large ones
have a reduced model beside them that takes the steps: modes of its static slip path, the lowest
natural modes with the contact held and with it loose, and all contact points (merged ones, where
they are very many). What this model errs by itself is in all its runs and cancels. If it differs
from the full one by more than the steps do, it is no model of these errors, and the full one is run
once more with half the step; so is a large one in a quasi-static run, where no higher modes are
excited, and one with contact that opens. (Of 479 quantities of 160 plates and solids 99 % were
stated as above; 6 scenes in 179 took the full model.)

A condensed model has the law and the points of the full one. Its basis is bettered by more
fixed-interface modes. Its statics are exact: without inertia no mode is missing. Where its points
are merged, the first cycles of a run with all of them show what that causes.

A reduced model is bettered by all contact points, then by a law ten times as steep, but no steeper
than the full model's. Then a condensed model takes its place, with the full model's points and law
(:mod:`skfem_joint.accuracy.condensed_reference`), where contact is small enough. On plates with
several bolts under Coulomb's law errors fall so slowly with modes that nothing else was reliable.
With contact that opens points and law have no rungs of their own. Where the condensed model would
be too slow, the residual of the run in the full equation shows which modes the basis misses
(:mod:`skfem_joint.reduction.missing_modes`), and some of these are added at a time, with the next
proper modes of the model's own snapshots; very many points are merged, and the first cycles of a
run with all of them show what that causes.

The step is halved on the best model: on a poor basis the motion is too smooth, and the error of the
step another one. (Half the step alone changed the results of a bar under a table with kinks by
0.8 %, where they were 6.5 % off: both missed the same modes.) Where modes are added at a time that
is the first model with more modes, whose steps cost a tenth of the last one's, and the last one
only where the two differ by more than the step does. No more modes are added where what the last
ones changed is small beside the error of the step. (Two lapped solids with 384 points: the step
errs by 2.4 % in the friction energy on 47 vectors and on 143, by 14.0 and 14.9 % in the work of the
loads.) Ladders of condensed and reduced models end with the cycle in which their run has become
steady; if it does not they are whole runs. For them no step of the full model is taken, except of
chains, whose steps cost next to nothing, and in quasi-static runs with large contact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from skfem_joint.accuracy.condensed_reference import CondensedReference
from skfem_joint.accuracy.estimate import Estimate, MissingModes, sizes, verification_run
from skfem_joint.accuracy.ladder import HALVED, STEP, Ladder, Series, apart, cycles_to_settle
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.reduction.basis import Basis, Options
from skfem_joint.reduction.condensed import condense, interface_modes_in, reference_model
from skfem_joint.reduction.condensed_points import points_of, with_points_of
from skfem_joint.reduction.friction_points import MANY, MERGED
from skfem_joint.reduction.missing_modes import Residual, stride
from skfem_joint.reduction.models import reduced, reduced_on
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.results.history import QUANTITIES, difference, results
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.modes import lowest_modes
from skfem_joint.system.system import System

#: Modes that are added to a basis at a time, twice; oftener where a residual has fewer, as those
#: of a slip front that the basis holds (each run frees the next points), and twice and four times
#: as many where the changes do not fall.
ADDED = 8
#: Relative change by added modes below which no more are added.
ENOUGH = 1e-3
#: Ratio of a change by added modes to the one before above which more are added.
SLOWEST = 0.4
#: Steepness of the better law over that of the model.
STEEPER = 10.0
#: The error of a less steep law is proportional to 1 / beta.
LAW = Series(*[1.0 / STEEPER] * 3)
#: Added modes.
MODES_ADDED = Series(0.0, 0.75, SLOWEST)
#: More fixed-interface modes would change a quarter of what these have changed.
INTERFACE_MODES = Series(*[0.2] * 3)


def of_full(run: Run, plan: Plan, progress: Callable[..., None] | None = None) -> Estimate:
    """Errors of a full model's run.

    Parameters
    ----------
    run : Run
        Of any system, by ``plan``, with its named points.
    plan : Plan
    progress : callable, optional
        As `integrate` takes it.

    Raises
    ------
    ConvergenceError
        If a step of another run does not converge.
    KeyboardInterrupt
        If one is interrupted.
    """
    way, system = Ladder(run, progress), run.system
    if is_small(system, plan):
        way.halve(system, plan)
        half, quarter = np.nan_to_num(way.changes(STEP))
        # A change by the quarter of the step that counts, and is more than that by half of it.
        grows = np.any(quarter > np.maximum(5e-3, half))
        # Energy lost by impacts that counts, over the work of the loads.
        if grows or run.impact_work > 1e-3 * np.abs(run.input_work).sum():
            way.halve(system, plan, (8,))
    # Levels cost about as much as those of a reduced model; contact that opens has none.
    elif plan.quasi_static or system.contact.opens or not _halved_beside(way, plan):
        way.halve(system, plan, (2,))
    return way.estimate()


def is_small(system: System, plan: Plan) -> bool:
    """Whether half and quarter steps of the model itself cost little.

    They do up to some two seconds of its own run; of chains, whose steps cost next to nothing, they
    always do.
    """
    # Unknowns that cost as much as what a step costs anyhow.
    if plan.n_steps * (system.n + 150) <= 5e5 or system.is_dense:
        return True
    return system.contact.count > 0 and arranged(system).kind == "chain"


def _halved_beside(way: Ladder, plan: Plan) -> bool:
    """Halve the step on a reduced model; False where there is none, or where it is too poor."""
    try:
        small = model_beside(way.base.system, plan)
    except (InputError, ConvergenceError):
        return False  # without friction, without a load, or no path
    steps = _halved(way, way.run(small, plan), plan)
    good = _stands_for(way.base, steps, 1e-2)  # a difference that does not count
    way.rungs += steps.rungs if good else []
    return good


def _halved(way: Ladder, run: Run, plan: Plan) -> Ladder:
    """Ladder of the steps alone, from a run beside another ladder's."""
    steps = Ladder(run, way.progress)
    steps.halve(run.system, plan)
    return steps


def _stands_for(run: Run, steps: Ladder, negligible: float) -> bool:
    """Whether the error of the step of another model, which has ``steps``, is that of a run.

    It is believed where both models differ by no more than it, or by what is ``negligible``. (Of
    293 quantities 7 differed by more, 3 of these were stated wrongly; of the others 1.5 %.)
    """
    distance, error = apart(run, steps.base), sizes(steps.estimate().parts["total"])
    zero = np.isnan(distance) & np.isnan(error)  # in both
    return bool(np.all(zero | (distance <= np.maximum(negligible, error))))


def model_beside(system: System, plan: Plan, beta: str | float = "auto") -> System:
    """Reduced model of a system that takes the same steps at little cost.

    Its basis has the history of the one that it began with. ``beta`` is as for `reduced_on`.

    Raises
    ------
    InputError, ConvergenceError
        If there is no static slip path.
    """
    # With 12, 20 and 30 modes the friction energy of a plate with two bolts is 1.5, 0.4 and 0.2 %
    # off the full model's.
    duration = None if plan.until == "steady" else plan.duration
    many = Options(modes=20, friction_points="all")
    basis = reduced(system, many, duration, plan.step, plan.scheme, enriched=True).origin.basis
    V = orthonormal(np.hstack([basis.V, _natural_modes(system)]), system.M)
    wide = replace(basis, V=orthonormal(V, system.M))
    small = reduced_on(system, wide, friction_points="all", beta=beta)
    # Most contact points; more are merged. (With 150 in place of 1,408 that friction energy is
    # 1.8 % off.)
    most = 500
    merge: Callable[[System], System] = basis.merging(system, most, most)
    return merge(small)


def _natural_modes(system: System) -> FloatArray:
    """Lowest natural modes with the contact held, then with it loose, (n, k)."""
    B = system.contact.B[np.flatnonzero(system.contact.on_rows(system.contact.w))]
    # Spring at a held contact point, over the mean diagonal of the stiffness.
    held = system.K + 1e3 * float(system.K.diagonal().mean()) * (B.T @ B)
    # Its natural modes with the contact held, and as many with it loose.
    count = min(15, system.n)
    return np.hstack([lowest_modes(K, system.M, count)[1] for K in (held, system.K)])


def _until_settled(
    run: Run, plan: Plan, progress: Callable[..., None] | None
) -> tuple[Ladder, Plan]:
    """Ladder of a run up to the cycle in which it has become steady, and its plan."""
    if plan.cycle_steps is not None and not run.system.contact.opens:
        # Relative change of cycles below which they are alike, and the fewest of them.
        short = plan.first(cycles_to_settle(run, 0.01, 4))
        if short.n_steps < plan.n_steps:
            run, plan = verification_run(run.system, short, progress=progress), short
    return Ladder(run, progress), plan


def of_condensed(run: Run, plan: Plan, progress: Callable[..., None] | None = None) -> Estimate:
    """Errors of a condensed model's run.

    Parameters
    ----------
    run : Run
        Of a model that knows the full one, by ``plan``, with its named points.
    plan : Plan
    progress : callable, optional
        As `integrate` takes it.

    Raises
    ------
    ConvergenceError
        If a step of another run does not converge.
    KeyboardInterrupt
        If one is interrupted.
    """
    way, plan = _until_settled(run, plan, progress)
    system, better = run.system.origin.system, run.system
    inner = with_points_of(system, better)
    modes, merged = interface_modes_in(inner, better.origin.basis.V), np.any(points_of(better) > 1)
    every, fewer = (condense(each, modes) if merged else better for each in (system, inner))
    way.add("points", way.top, unseen=_merged(way, every, fewer, plan))
    if inner.contact.steepest > better.contact.steepest:
        better = better.with_contact(beta=inner.contact.beta)
    way.climb("law", better, plan)
    if not plan.quasi_static:
        more = reference_model(inner, modes)
        better = more if more.n > better.n else better
    way.climb("basis", better, plan, INTERFACE_MODES)
    quarter = not system.contact.opens or is_small(system, plan)
    way.halve(better, plan, (2, 4) if quarter else (2,))
    return way.estimate()


def of_reduced(
    run: Run,
    plan: Plan,
    progress: Callable[..., None] | None = None,
    reference: CondensedReference | None = None,
) -> Estimate:
    """Errors of a reduced model's run.

    Parameters
    ----------
    run : Run
        Of a model that knows the full one, by ``plan``, with its named points.
    plan : Plan
    progress : callable, optional
        As `integrate` takes it.
    reference : CondensedReference, optional
        Condensed model of the full one, if it exists already, whose runs are used again.

    Raises
    ------
    ConvergenceError
        If a step of another run does not converge.
    KeyboardInterrupt
        If one is interrupted.
    """
    small, system, basis = run.system, run.system.origin.system, run.system.origin.basis
    way, plan = _until_settled(run, plan, progress)
    opens, beta = system.contact.opens, small.contact.steepest
    steeper = system.contact.steepest > beta
    reference = reference or CondensedReference.of(system)
    if reference is None and plan.quasi_static:
        reference = CondensedReference(system, system)
    periods = run.steady.periods if run.steady else 1
    affords = reference is not None and reference.affords(plan, periods, steeper)
    if reference is None or not (affords or opens):
        return _with_added_modes(way, system, basis, plan, beta)
    if not opens:
        whole = system.project(basis.V)
        merged = small.contact.w.size < system.contact.w.size
        every = whole.no_steeper(beta) if merged else small
        way.climb("points", every, plan)
        way.climb("law", whole.no_steeper(STEEPER * beta) if steeper else every, plan)
    same = way.add("basis", reference.run(plan, way.run))
    if affords:
        for factor in (2, 4):
            way.add(STEP, reference.run(plan.finer(factor), way.run), HALVED)
    else:
        way.rungs += _halved(way, way.base, plan).rungs
    if opens:
        return way.estimate()
    most = max(2 * ADDED, basis.V.shape[1] // 2)
    V, velocities = reference.missing_modes(basis.V, same, most)
    return replace(way.estimate(), missing=_missing(system, basis, V, velocities))


def _missing(system: System, basis: Basis, V: FloatArray, velocities: FloatArray) -> MissingModes:
    """Modes that a basis misses, which follow those of the basis in ``V``."""
    first = V[:, basis.V.shape[1] :][:, :1]
    slip, most = (float(np.abs(x).max(initial=0.0)) for x in (system.contact.B @ first, first))
    return MissingModes(V, velocities, slip > 0.5 * most)


def _with_added_modes(
    way: Ladder, system: System, basis: Basis, plan: Plan, beta: float
) -> Estimate:
    """Errors of a reduced model by modes that it misses, where no condensed model is run.

    The rungs of points and of the first modes keep the model's law. From the rung of the law on it
    is steeper, if the full model's is: with the law of a poor basis points would still creep
    although the added modes let them stick.
    """
    V, merge = basis.V, basis.merging(system, MANY, MERGED)
    residual = Residual(system, basis.stiffness)
    # Instants from whose residual modes come. (With 100 they left as much on a lapped solid, and
    # took twice as long.)
    fields = stride(plan.n_steps, plan.cycle_steps, 40)
    steeper, most = system.contact.steepest > beta, V.shape[1] + 2 * ADDED

    every = system.project(V).no_steeper(beta)
    merged = merge(every)
    unseen = _merged(way, every, merged, plan)
    way.add("points", way.run(merged, plan, fields_every=fields), unseen=unseen)
    for k in range(4):
        more = ADDED * 2 ** max(0, k - 1)
        V = np.hstack([V, residual.missing_modes(V, way.top, more, basis.followed)])
        every = system.project(V)
        way.climb("basis", merge(every.no_steeper(beta)), plan, MODES_ADDED, fields)
        if k == 0:
            if steeper:
                beta = STEEPER * beta
                way.climb("law", merge(every.no_steeper(beta)), plan, LAW, fields)
            steps = _halved(way, way.top, plan)
            # Change beside the error of the step up to which no more are added.
            enough = np.fmax(ENOUGH, 0.2 * sizes(steps.estimate().parts["total"]))
        *before, last = way.changes("basis")
        if np.nan_to_num(last).max() < ENOUGH:
            break
        if k and V.shape[1] >= most and not np.any(last > np.fmax(enough, SLOWEST * before[-1])):
            break
    missing = _missing(system, basis, V, way.top.v)
    if not _stands_for(way.top, steps, ENOUGH):
        steps = _halved(way, way.top, plan)
    way.rungs += steps.rungs
    return replace(way.estimate(), missing=missing)


def _merged(way: Ladder, every: System, merged: System, plan: Plan) -> FloatArray:
    """Error that merged contact points cause, by the first cycles of a run with all of them."""
    if merged.contact.w.size == every.contact.w.size:
        return np.zeros(len(QUANTITIES))
    # Cycles of a run with all points.
    some = plan.first(plan.n_steps // 2 if plan.cycle_steps is None else 2)
    return sizes(difference(*(results(way.run(system, some)) for system in (every, merged))))
