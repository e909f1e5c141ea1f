"""Estimated errors of any model's run: which estimate is whose, and `estimate` for users."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
from scipy import sparse

from skfem_joint.accuracy import halved_mesh, range_modes, rungs
from skfem_joint.accuracy.against_coulomb import with_coulomb
from skfem_joint.accuracy.estimate import Estimate
from skfem_joint.accuracy.ladder import keeps_contact
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.values import check_kind
from skfem_joint.results.history import QUANTITIES
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.system import CHANGED, System

_log = logging.getLogger(__name__)


def estimate(
    run: Run, *, finer: System | None = None, progress: Callable[..., None] | None = None
) -> Estimate:
    """Estimate the errors of a run: of a full model, or one that `reduce` or `condense` made.

    A full model is judged by its time step, a reduced or condensed one by its basis, its law, its
    friction points and its time step; a point of a range by the larger model that it carries. The
    full model is run for a reduced one only on bars, whose steps cost next to nothing, and in
    quasi-static runs with large contact. Of a law with a finite beta the distance from Coulomb's
    law stands apart, as ``parts["coulomb"]``.

    Parameters
    ----------
    run : Run
        From rest, to its end, with the named points stored.
    finer : System, optional
        The full system on a mesh whose elements are halved, under the same loads and with the same
        points; then the error by the mesh is estimated too, with two more runs at most.
        ``sj.refined(mesh)`` halves elements.
    progress : callable, optional
        As `integrate` takes it, called in every run that this takes.

    Returns
    -------
    Estimate
        Relative errors by source and quantity; ``estimate(run).parts["total"]`` has those of all
        sources together.

    Raises
    ------
    ConvergenceError
        If a step of a verification run does not converge.
    InputError
        If the run was interrupted, began in motion or stored no named points, if its system was
        changed after it was reduced, or loaded from a file, so that the full one is not known, or
        if the finer system has other points or loads, or stands beside a point of a range.
    KeyboardInterrupt
        If a verification run is interrupted.
    """
    check_kind("run", run, Run)
    system, plan = run.system, run.plan
    if run.interrupted or plan is None:
        raise InputError("estimate: found an interrupted run, must have reached its end")
    if run.start is not None:
        raise InputError(
            "estimate: the run starts displaced or in motion; verification runs start from rest. "
            "Compare it with a run of half the step instead: sj.compare"
        )
    if not plan.save.points:
        raise InputError("estimate: the run stored no named points; leave out points=False")
    if finer is not None:
        _check_finer(system, finer, run.times)
    if system.serves is not None:  # judged without the full system, which may not be known
        return range_modes.of_range(run, plan, progress)
    if system.origin is not None and not system.origin.made(system):
        raise InputError(f"estimate: {CHANGED}")
    errors = of_run(run, plan, progress)
    if finer is not None:
        errors = errors.with_mesh(halved_mesh.of_run(run, plan, full_of(system), finer, progress))
    try:
        return with_coulomb(full_of(system), run, plan, errors, progress)
    except ConvergenceError as error:
        _log.warning("The distance from Coulomb's law is not known: %s", error)
        return errors.having("coulomb", dict.fromkeys(QUANTITIES))


def _check_finer(model: System, finer: System, times: FloatArray) -> None:
    """Refuse what cannot be the full system of a model on a finer mesh, by loads over the times."""
    check_kind("finer", finer, System)
    if model.serves is not None:
        raise InputError(
            "estimate: finer: found a run of a point of a range, whose full system is not known; "
            "leave it out, and give it with a run of the full system, whose error by the mesh is "
            "the same"
        )
    system = full_of(model)
    loads, others = ([load.on for load in each.loads] for each in (system, finer))
    if finer.points != system.points or others != loads or finer.n <= system.n:
        raise InputError(
            f"estimate: finer: found {finer.n} unknowns, points {finer.points} and loads {others}, "
            f"must have more than {system.n} unknowns, points {system.points} and loads {loads}: "
            "build it as the system itself, on sj.refined(mesh)"
        )
    own, theirs = (each.load_amplitudes(times) for each in (system, finer))
    # Inertia forces and tractions on curved borders are not quite the same on both meshes.
    if np.abs(own - theirs).max(initial=0.0) > 0.05 * np.abs(own).max(initial=0.0):
        raise InputError(
            "estimate: finer: found loads of other amplitudes than those of the run, must be the "
            "same: build it as the system itself, on sj.refined(mesh)"
        )


def full_of(system: System) -> System:
    """The full system that a model was made of; itself if it is one, or made for a range."""
    return system if system.origin is None else system.origin.system


def of_run(run: Run, plan: Plan, progress: Callable[..., None] | None = None) -> Estimate:
    """Errors of a model's run by a plan; its origin says what it is a model of.

    Those of a model for a range are estimated by what it carries.
    """
    system = run.system
    if system.serves is not None:  # judged without the full system
        return range_modes.of_range(run, plan, progress)
    made = system.made_for or not (system.T is None or sparse.issparse(system.T))
    if system.origin is None and made:
        raise InputError(
            "estimate: the full system that this model was made from is not known: it was loaded "
            "from a file, projected by hand, or condensed by parts. Give a run of a model as "
            "reduce or condense return it"
        )
    if system.origin is None:
        return rungs.of_full(run, plan, progress)
    if keeps_contact(system):
        return rungs.of_condensed(run, plan, progress)
    return rungs.of_reduced(run, plan, progress)
