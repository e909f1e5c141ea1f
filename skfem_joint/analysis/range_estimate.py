"""Estimated errors of runs of a point of a range, without the full model.

A model for a range carries a larger one, with half as many joint modes more and more friction
points, of the same point. The difference of the two runs, times a factor, is the error of the
smaller one's basis, friction points and law. The factor was found where the model was made, at
points that it was not trained with, where the full system was at hand: there the residual of a run
in the full equation showed which modes the larger models miss. The error of the time step is found
by half of it.
"""

from __future__ import annotations

from collections.abc import Callable

from skfem_joint.analysis.estimate import Estimate, added, verification_run
from skfem_joint.analysis.history import difference, extrapolation, results
from skfem_joint.analysis.range_modes import served_by
from skfem_joint.errors import InputError
from skfem_joint.reduction.ranges.points import check_short_of_gross_slip
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run


def of_range(run: Run, plan: Plan, progress: Callable[..., None] | None = None) -> Estimate:
    """Errors of a run of a point of a range.

    Parameters
    ----------
    run : Run
        Of a system from `skfem_joint.at`, from rest.
    plan : Plan
        Its plan.
    progress : callable, optional
        As `integrate` takes it, called in both runs that this takes.

    Raises
    ------
    InputError
        If the system is no point of a range.
    ConvergenceError
        If a joint slips as a whole in the run, or a step of a verification run does not converge.
    KeyboardInterrupt
        If a verification run is interrupted.
    """
    serves = served_by(run.system)
    if serves.point is None:
        raise InputError("estimate: found a run of no point of a range; take one by sj.at")
    check_short_of_gross_slip(run)
    base = results(run)
    larger = results(verification_run(serves.larger, plan, progress=progress))
    halved = results(verification_run(run.system, plan.finer(2), progress=progress))
    factors = {name: serves.factors["energy"] for name in ("friction_energy", "loop_energy")}
    apart = difference(larger, base)
    basis = {
        name: _times(factors.get(name, serves.factors["history"]), e) for name, e in apart.items()
    }
    step = {name: _times(extrapolation(4.0), e) for name, e in difference(halved, base).items()}
    return Estimate({"basis": basis, "time_step": step, "total": added(basis, step)})


def _times(factor: float, error: float | None) -> float | None:
    return None if error is None else factor * error
