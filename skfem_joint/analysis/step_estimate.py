"""Estimated error of a full model's time step.

A longer step says nothing of what the step itself does not follow: friction and kinks of loads
excite higher modes, which a coarse run leaves at rest, and one with twice the step all the more.
(Of 412 quantities of 141 random scenes twice the step stated 86 % between a half and three times
the truth, a half step 94 %, a half and a quarter 99 %.) So the run is compared with runs of half
and of a quarter of the step,

    error = |u(h/4) - u(h)| + rest,    rest = |u(h/4) - u(h/2)| r / (1 - r),

where r is the ratio of the second change to the first one, but no less than 1/4 (second order) and
no more than 1/2 (first order, as kinks of friction may leave it). Where the changes differ in sign
so may the rest, and the error is the root of the sum of both squares.

A step is too long for such a series where a change is larger than the one before: then an eighth of
the step is run too, in place of which the two last changes count. (A mass that bounces on a spring
of contact for eight steps at a time: the work of the loads errs by 3.7 %, with half and a quarter
of the step by 3.6 and 2.9 %, of which the series makes 1.6 %, with an eighth 3.1 %.) It is run
as well where impacts take energy, for their times leave errors of first order with any ratio. (A
peak errs by 1.1, 0.7, 0.8 and 0.5 %, as steps are halved: three of them make it 0.3 %.)

Small models are run themselves, which takes four to six times as long as the run. Large ones have a
reduced model beside them that takes the three steps: modes of its static slip path, the lowest
natural modes with the contact held and with it loose, and all contact points (merged ones, where
they are very many). What this model errs by itself is in all three runs and cancels. Its run with
the step asked for is compared with the full model's. If they differ by more than the steps, it is
no model of these errors, and the full one is run once more with half the step; so is a large one in
a quasi-static run, where no higher modes are excited, and one with contact that opens. (Of 479
quantities of 160 plates and solids 99 % were stated as above; 6 scenes in 179 took the full model.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np

from skfem_joint.analysis.estimate import (
    Estimate,
    Steps,
    Verification,
    apart,
)
from skfem_joint.analysis.history import joint_differences, results
from skfem_joint.arrays import FloatArray
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.modes import lowest_modes
from skfem_joint.reduction.basis import Basis, Options, reduced_system
from skfem_joint.reduction.friction_points import merged_points, shared_points
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.reduction.sources import make_basis
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system import System

#: Steps of a run times (unknowns + 150) up to which the full model itself is run with half
#: and quarter steps, some two seconds of its own run; chains, whose steps cost next to nothing,
#: always are.
SMALL = 5e5
#: Most contact points of the reduced model; more are merged. (With 150 in place of 1,408 that
#: friction energy is 1.8 % off.)
POINTS = 500
#: Largest difference between the reduced and the full model, over the error of the step, with
#: which the estimate is believed. (Of 293 quantities 7 had more than one, 3 of these were stated
#: wrongly; of the others 1.5 %.)
TRUSTED = 1.0
#: Such a difference that does not count.
NEGLIGIBLE = 1e-2


def of_full(
    system: System, run: Run, plan: Plan, progress: Callable[..., None] | None = None
) -> Estimate:
    """Errors of a full model's run from its time step.

    Parameters
    ----------
    system : System
        Any system; one of full models.
    run : Run
        By ``plan``, with its named points.
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
    verify = Verification(progress, run)
    if is_small(system, plan):
        finer = [verify(system, plan.finer(k)) for k in (2, 4)]
        # Energy lost by impacts that counts, over the work of the loads.
        struck = run.impact_work > 1e-3 * np.abs(run.input_work).sum()
        if struck or _grow(run, *finer):
            finer.append(verify(system, plan.finer(8)))
        return by_finer_steps(run, *finer)
    errors = None
    # Levels cost about as much as those of a reduced model; contact that opens has none.
    if not plan.quasi_static and not system.contact.opens:
        errors = _of_reduced(system, run, plan, Verification(progress))
    return errors or by_finer_steps(run, verify(system, plan.finer(2)))


def _grow(run: Run, half: Run, quarter: Run) -> bool:
    """Whether half of a step changes a result by more than the step before it did."""
    first, second = apart(half, run), apart(quarter, half)
    # Change by a quarter of the step that counts, where it is more than that by half of it.
    return any((second[name] or 0.0) > max(5e-3, first[name] or 0.0) for name in second)


def by_finer_steps(
    run: Run, half: Run, quarter: Run | None = None, eighth: Run | None = None
) -> Estimate:
    """Errors of a run from runs of the same model with half, maybe a quarter and an eighth of it.

    Distances are those from the finest run, the rest follows from the last two changes.
    """
    base = results(run)
    steps = Steps(run, half, quarter) if eighth is None else Steps(half, cast(Run, quarter), eighth)
    # The distance itself is no guess, and has no lower bound: with one, 13 % of errors between 0.1
    # and 0.3 % were stated at more than three times the truth, without it 5 %.
    errors, rest = steps.with_rest(steps.finest, base), steps.left["friction_energy"] or 0.0
    joints = joint_differences(steps.finest, base, run.system.contact.joints, rest)
    return Estimate({"time_step": errors, "total": errors}, by_joint=joints)


def is_small(system: System, plan: Plan) -> bool:
    """Whether half and quarter steps of the model itself cost little."""
    # Unknowns that cost as much as what a step costs anyhow.
    if plan.n_steps * (system.n + 150) <= SMALL or system.is_dense:
        return True
    return system.contact.count > 0 and arranged(system).kind == "chain"


def _of_reduced(
    system: System, run: Run, plan: Plan, verify: Callable[..., Run]
) -> Estimate | None:
    """Errors of a step by a reduced model; None where there is none, or where it is too poor."""
    try:
        small = reduced_for_steps(system, plan)
    except (InputError, ConvergenceError):
        return None  # without friction, without a load, or no path: the full model is run
    runs = [verify(small, plan.finer(k)) for k in (1, 2, 4)]
    errors, distances = by_finer_steps(*runs), apart(run, runs[0])
    for name, distance in distances.items():
        error = errors.of("total", name)
        if error is None and distance is None:
            continue  # zero in both
        if error is None or distance is None:
            return None
        if distance > max(NEGLIGIBLE, TRUSTED * error):
            return None
    return errors


def reduced_for_steps(system: System, plan: Plan) -> System:
    """Reduced model of a system that takes the same steps at little cost.

    Raises
    ------
    InputError, ConvergenceError
        If there is no static slip path.
    """
    whole = plan
    if plan.until == "steady":
        # Periods for which modes are made where the run goes on until the vibration is steady.
        whole = replace(plan, n_steps=plan.n_steps * 100, until="end")
    # Modes of the static slip path in the reduced model. With 12, 20 and 30 the friction energy
    # of a plate with two bolts is 1.5, 0.4 and 0.2 % off the full model's.
    basis = make_basis(system, Options(modes=20), whole, enriched=True)
    V = orthonormal(np.hstack([basis.V, _natural_modes(system)]), system.M)
    wide = replace(basis, V=orthonormal(V, system.M))
    small = reduced_system(
        system, wide, friction_points="all", periodic=plan.cycle_steps is not None
    )
    if system.contact.count <= POINTS:
        return small
    return shared_points(small, *_merged(system, basis))


def _merged(system: System, basis: Basis) -> tuple[FloatArray, FloatArray]:
    """Shares and limits of contact points that slip alike in a basis."""
    narrow, carrying = system.project(basis.V), np.flatnonzero(system.contact.w)
    merged = merged_points(narrow, basis.history.velocities, carrying, POINTS)
    return merged.contact.shares, merged.contact.w


def _natural_modes(system: System) -> FloatArray:
    """Lowest natural modes with the contact held, then with it loose, (n, k)."""
    B = system.contact.B[np.flatnonzero(system.contact.on_rows(system.contact.w))]
    # Spring at a held contact point, over the mean diagonal of the stiffness.
    held = system.K + 1e3 * float(system.K.diagonal().mean()) * (B.T @ B)
    # Its natural modes with the contact held, and as many with it loose.
    count = min(15, system.n)
    return np.hstack([lowest_modes(K, system.M, count)[1] for K in (held, system.K)])
