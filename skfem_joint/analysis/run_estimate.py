"""Estimated errors of any model's run: which estimate is whose."""

from __future__ import annotations

from collections.abc import Callable

from skfem_joint.analysis import estimate, range_estimate, step_estimate
from skfem_joint.analysis.estimate import Estimate
from skfem_joint.reduction.basis import Basis
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system import System


def of_run(
    system: System,
    basis: Basis | None,
    run: Run,
    plan: Plan,
    progress: Callable[..., None] | None = None,
) -> Estimate:
    """Errors of a model's run: a reduced one's, or without ``basis`` the full one's.

    Those of a model for a range are estimated by what it carries.
    """
    if run.system.serves is not None:
        return range_estimate.of_range(run, plan, progress)
    if basis is None:
        return step_estimate.of_full(system, run, plan, progress)
    return estimate.of_reduced(system, basis, run.system, plan, run, progress)
