"""Estimated errors of condensed and reduced models with contact that opens.

A residual in the full equation would need the normal forces of points that the model does not
follow. So the model is run again, better in one respect at a time: with half and, where it is
small, a quarter of its step; and with a better basis. That of a condensed model has twice as many
fixed-interface modes, which a quasi-static run does without: its statics are exact. The better
basis of a reduced model is that of the condensed one, whose contact is rigid: its run, by the same
steps, shows what modes, elastic contact and a less steep law of friction have changed.
"""

from __future__ import annotations

from collections.abc import Callable

from skfem_joint.analysis.estimate import (
    SETTINGS,
    Estimate,
    Parts,
    Verification,
    added,
    at_least,
    left_of_steps,
)
from skfem_joint.analysis.history import QUANTITIES, difference, joint_differences, results
from skfem_joint.analysis.step_estimate import is_small
from skfem_joint.reduction.basis import Basis
from skfem_joint.reduction.condensed import condensed_basis, condensed_system
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system import System


def of_condensed(
    system: System,
    basis: Basis,
    run: Run,
    plan: Plan,
    progress: Callable[..., None] | None = None,
) -> Estimate:
    """Errors of a condensed model's run with contact that opens.

    Parameters
    ----------
    system : System
        The full model.
    basis : Basis
        Of the condensed one.
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
    wider = None if plan.quasi_static else _wider(system, basis)
    return _estimated(run, plan, is_small(system, plan), wider, _with_rest, True, progress)


def of_reduced(
    system: System,
    run: Run,
    plan: Plan,
    progress: Callable[..., None] | None = None,
) -> Estimate:
    """Errors of a reduced model's run with contact that opens.

    Parameters and errors are those of `of_condensed`.
    """
    condensed = condensed_system(system, condensed_basis(system).V)
    return _estimated(run, plan, True, condensed, dict, False, progress)


def _estimated(
    run: Run,
    plan: Plan,
    quarter: bool,
    better: System | None,
    with_rest: Callable[[Parts], Parts],
    begins_alike: bool,
    progress: Callable[..., None] | None,
) -> Estimate:
    """Errors from half and maybe a ``quarter`` of the step, and from a model of a ``better`` basis.

    ``with_rest`` adds to what that changes what it still misses itself. ``begins_alike`` says
    whether the better basis begins with the unknowns of the model's own.
    """
    verify = Verification(progress, run)
    base, half = results(run), results(verify(run.system, plan.finer(2)))
    finest, before = half, None
    if quarter:
        finest, before = results(verify(run.system, plan.finer(4))), difference(half, base)
    left = left_of_steps(before, difference(finest, base if before is None else half))
    steps = added(difference(finest, base), left)
    truth = finest
    of_basis: Parts = dict.fromkeys(QUANTITIES, 0.0)
    if better is not None:
        verify = verify if begins_alike else Verification(progress)
        wide = results(verify(better, plan))
        truth = finest.plus(1.0, wide, base)
        of_basis = with_rest(difference(wide, base))
    total = at_least(added(steps, of_basis), truth, base, of_basis, steps)
    parts = {"basis": of_basis, "time_step": steps, "total": total}
    rest = left["friction_energy"] or 0.0
    joints = joint_differences(truth, base, run.system.joints, rest)
    return Estimate(parts, by_joint=joints)


def _wider(system: System, basis: Basis) -> System | None:
    """Condensed model with twice as many fixed-interface modes; None where it has all motions."""
    kept = condensed_basis(system, 0).V.shape[1]
    V = condensed_basis(system, max(SETTINGS.added, 2 * (basis.V.shape[1] - kept))).V
    return condensed_system(system, V) if V.shape[1] > basis.V.shape[1] else None


def _with_rest(change: Parts) -> Parts:
    """Change by twice as many modes, and what is left when changes go on to fall as they may."""
    series = 1.0 / (1.0 - SETTINGS.slowest)
    return {name: None if e is None else series * e for name, e in change.items()}
