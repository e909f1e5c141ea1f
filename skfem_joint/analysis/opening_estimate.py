"""Estimated errors of condensed and reduced models with contact that opens.

A residual in the full equation would need the normal forces of points that the model does not
follow. So a better model is run: the condensed one with more fixed-interface modes, whose contact
is rigid where the full model's is, with all contact points. Its runs with the step, half and a
quarter of it show what the basis, elastic contact, merged points, a less steep law of friction and
the step have changed, together and with their signs: the distance of the run from the finest of
them is its error, but for what that still misses. Where a quarter of the step would cost too much,
the model itself is run with half of the step (a reduced one with a quarter too), and the better one
with the step alone; the differences are added with their signs. A quasi-static run of a condensed
model needs no better one: its statics are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from skfem_joint.analysis.condensed_reference import MODES
from skfem_joint.analysis.estimate import (
    Estimate,
    Steps,
    Verification,
    added,
    at_least,
)
from skfem_joint.analysis.history import QUANTITIES, difference, joint_differences, results
from skfem_joint.analysis.step_estimate import by_finer_steps, is_small
from skfem_joint.reduction.basis import Basis
from skfem_joint.reduction.condensed import condensed_basis, condensed_system
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system import System

#: Largest product of the steps of a run and the square of the better model's unknowns with which
#: that takes the shorter steps, some ten seconds of its own run.
AFFORDED = 1e8
#: What more modes than those of the better model would change, over what these have changed.
LEFT_OF_MODES = 0.25


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
    small = is_small(system, plan)
    kept = condensed_basis(system, 0).V.shape[1]
    modes = max(MODES, 2 * (basis.V.shape[1] - kept))
    V = basis.V if plan.quasi_static else condensed_basis(system, modes).V
    if V.shape[1] <= basis.V.shape[1]:
        verify = Verification(progress, run)
        finer = [verify(run.system, plan.finer(k)) for k in ((2, 4) if small else (2,))]
        errors = by_finer_steps(run, *finer)
        return replace(errors, parts={"basis": dict.fromkeys(QUANTITIES, 0.0), **errors.parts})
    better = condensed_system(system, V)
    alike = Verification(progress, run)
    return _estimated(run, plan, better, small, (alike, alike), LEFT_OF_MODES)


def of_reduced(
    system: System,
    run: Run,
    plan: Plan,
    progress: Callable[..., None] | None = None,
) -> Estimate:
    """Errors of a reduced model's run with contact that opens.

    Parameters and errors are those of `of_condensed`.
    """
    modes = 0 if plan.quasi_static else MODES
    better = condensed_system(system, condensed_basis(system, modes).V)
    return _estimated(
        run, plan, better, True, (Verification(progress, run), Verification(progress))
    )


def _estimated(
    run: Run,
    plan: Plan,
    better: System,
    quarter: bool,
    verify: tuple[Verification, Verification],
    left_of_modes: float = 0.0,
) -> Estimate:
    """Errors by a ``better`` model's run with the step and by half and maybe a quarter of it.

    The better model takes these steps, or, where it is large, the run's own. ``verify`` runs the
    model's own system and the better one. ``left_of_modes`` is what still more modes would change,
    over what those of the better one have.
    """
    better_steps = quarter and plan.n_steps * better.n**2 <= AFFORDED
    own, of_better = verify
    wide = of_better(better, plan)
    stepped, runs = (wide, of_better) if better_steps else (run, own)
    finer = [runs(stepped.system, plan.finer(k)) for k in ((2, 4) if quarter else (2,))]
    steps, base, same = Steps(stepped, *finer), results(run), results(wide)
    truth = steps.finest if better_steps else steps.finest.plus(1.0, same, base)
    of_basis = difference(truth, truth.plus(1.0, base, same))
    left = {k: None if e is None else left_of_modes * e for k, e in of_basis.items()}
    of_steps = steps.with_rest(steps.finest, results(stepped))
    total = added(steps.with_rest(truth, base), left)
    if not better_steps:  # else it is a distance, in which nothing cancels by chance
        total = at_least(total, truth, base, of_basis, of_steps)
    parts = {"basis": added(of_basis, left), "time_step": of_steps, "total": total}
    rest = steps.left["friction_energy"] or 0.0
    joints = joint_differences(truth, base, run.system.contact.joints, rest)
    return Estimate(parts, by_joint=joints)
