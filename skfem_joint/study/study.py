"""From a scene to its results, by functions that `run_scene` calls one after the other.

Structure and system follow from the scene. `describe` states what they are and how they respond to
static loads; `choose` finds time steps and a reduced model for an accuracy, if the scene asks for
one. Then, for each model of the scene, `make_model` runs it, and `compare_with_full` compares it
with the full model. All that is `run_models`. After it `estimated` goes through the models once
more, for their errors, those by the mesh, and how far an arctan law takes them from Coulomb's. Each
takes a study, which is frozen, and returns one that says more.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from skfem_joint.accuracy import halved_mesh, run_estimate
from skfem_joint.accuracy.against_coulomb import with_coulomb
from skfem_joint.accuracy.estimate import Estimate
from skfem_joint.ground.errors import ConvergenceError, JointError
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.ground.values import check_kind
from skfem_joint.linalg.schur import condensing_pays
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.reduction.models import notes_of
from skfem_joint.results.active_region import region_of
from skfem_joint.results.history import compare, difference, joint_differences, results
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.scene import Scene
from skfem_joint.slow.quasi_static import factors_at_rest
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.checkpoint import Checkpoints
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.study.accuracy import Choice, choose, choose_in_range, shortened_steps, stated
from skfem_joint.study.description import description_of
from skfem_joint.study.models import (
    finer_system,
    largest_model,
    model_of,
    origin_of,
    plan_of,
    with_friction,
)
from skfem_joint.study.results import Failure, Model, Study
from skfem_joint.study.scene_range import middle_of, served_scene
from skfem_joint.study.summary import violated
from skfem_joint.system.system import System

_log = logging.getLogger(__name__)


def run_scene(
    scene: Scene,
    progress: Progress = silent,
    checkpoints: Checkpoints | None = None,
    folder: Path | None = None,
    *,
    described: bool = True,
) -> Study:
    """Run the models that a scene asks for, and nothing else, and compare them.

    Parameters
    ----------
    scene : Scene
    progress : callable, optional
        Called with (what is done, steps done, steps in all).
    checkpoints : Checkpoints, optional
        Where to save the models as they run. A model that was saved whole is not integrated again;
        the modes of a reduced one are made again.
    folder : Path, optional
        Where a model for the range of the scene is loaded from, and saved to if it is not there.
    described : bool
        Whether a scene whose only model is a point of that for its range is described. Else nothing
        of it is assembled: structure and system of the study are those in the middle of the range.

    Returns
    -------
    Study
        Where a model after the first one fails, the study holds the models before it, its
        `Study.failure` says which one failed and why, and so does the last of its warnings.
        `Study.finished` raises that error. After an interrupt it holds what was finished, with
        ``interrupted`` set.

    Raises
    ------
    ConvergenceError
        If a step of the first model does not converge, or no model meets the accuracy asked for.
    InputError
        If the scene does not fit its mesh, or the first model the scene, or a checkpoint its run.
    KeyboardInterrupt
        If it is interrupted before the first model has run a step.
    """
    check_kind("scene", scene, Scene)
    study = run_models(scene, progress, checkpoints, folder, described=described)
    return estimated(study, progress)


def run_models(
    scene: Scene,
    progress: Progress = silent,
    checkpoints: Checkpoints | None = None,
    folder: Path | None = None,
    *,
    described: bool = True,
) -> Study:
    """Run the models that a scene asks for and compare them, without estimated errors.

    Arguments, result and errors are those of `run_scene`.
    """
    served = served_scene(scene)
    in_range = None if served is None else choose_in_range(scene, served, folder, progress)
    point = in_range if in_range is not None and in_range.model is not None else None
    if not described and served and point and scene.models.run == ("reduced",):
        middle = middle_of(served)
        notes = (*middle.system().notes, *point.notes)
        study = Study(point.scene, middle.structure(), middle.system(), notes=notes)
        return _with_models(study, point, progress, None, "")
    scene, left_out = with_friction(scene)
    origin = "" if checkpoints is None else origin_of(scene)
    structure, system = scene.structure(), scene.system()
    watch, small = Stopwatch(), None if scene.parts is None else largest_model(scene)
    by_parts = watch.read()
    path = None if small is not None or system.contact.opens else factors_at_rest(system)
    description = description_of(scene, path, small)
    choice = point or choose(scene, path, progress)
    if small is not None:
        choice = Choice(choice.scene, small, None, choice.notes, *by_parts)
    if in_range is not None and point is None:
        choice = replace(choice, notes=(*in_range.notes, *choice.notes))
    del path  # its factors are large: the choice has it where a basis needs them
    notes = (*scene.left_out, *left_out, *system.notes, *description.doubts, *choice.notes)
    study = Study(choice.scene, structure, system, description, notes=notes)
    return _with_models(study, choice, progress, checkpoints, origin)


def _with_models(
    study: Study, choice: Choice, progress: Progress, checkpoints: Checkpoints | None, origin: str
) -> Study:
    """Study with the models that its scene asks for, until one fails or is interrupted."""
    for name in study.scene.models.run:
        checkpoint = None if checkpoints is None else checkpoints.of(name, origin)
        labelled = partial(progress, f"{name} model")
        integrate = partial(integrate_plan, progress=labelled, checkpoint=checkpoint)
        study = make_model(name, study, choice, integrate)
        study = compare_with_full(study, name)
        if study.ended:
            break
    return study


def estimated(study: Study, progress: Progress = silent) -> Study:
    """Study whose models have estimated errors, until that is interrupted."""
    for name in study.models:
        if study.interrupted:
            break
        for what, (label, source) in _SOURCES.items():
            report = partial(progress, label.format(name))
            study = _with_estimate(study, name, what, partial(source, report=report))
        if (model := study.whole(name)) is not None:
            study = study.noting(*violated(study, model))
    return study


#: `integrate_plan` with progress and checkpoint of a model.
_Integrate = Callable[..., Run]


def make_model(name: str, study: Study, choice: Choice, integrate: _Integrate) -> Study:
    """Study with one more model, which is made and run.

    What fails, or is interrupted, after another model of the study was run is a result too; an
    error of the first one is raised. So is a quasi-static run that ends where friction does not
    hold the loads, with the levels before.
    """
    try:
        study = _with_model(name, study, choice, integrate)
    except JointError as error:
        if isinstance(error, ConvergenceError) and error.run is not None:
            return _ended_by(error, name, study)
        if not study.models:
            raise
        note = f"There is no {name} model: {error}"
        return replace(study.noting(note), failure=Failure(name, error))
    except KeyboardInterrupt:
        if not study.models:
            raise
        note = f"The run was interrupted while the {name} model was made."
        return study.noting(note, interrupted=True)
    if study.whole(name) is not None:
        return study
    time = study.models[name].run.counters.steps * study.scene.time_step
    note = (
        f"The run was interrupted in the {name} model at t = {time:.6g} s; results are those until "
        "then."
    )
    return study.noting(note, interrupted=True)


def _ended_by(error: ConvergenceError, name: str, study: Study) -> Study:
    """Study with a model whose quasi-static run has no further level, with the levels before."""
    run: Run = error.run
    model = Model(name, run, run.preparation_s, {}, compilation_s=run.compilation_s)
    if name == "full":
        model = _with_region(study, model)
    note = f"The results of the {name} model end with its last level. {error}."
    return replace(study.holding(model).noting(note), failure=Failure(name, error))


def compare_with_full(study: Study, name: str) -> Study:
    """Give a model its distance from the full one, where that was run before."""
    model, full = study.whole(name), study.models.get("full")
    if model is None or full is None or model is full:
        return study
    return study.holding(replace(model, errors=compare(full.run, model.run)))


def _with_estimate(
    study: Study, name: str, what: str, source: Callable[[Study, Model], Estimate | None]
) -> Study:
    """Model with estimated errors; what ends their computation early costs no more than a note."""
    model, watch = study.whole(name), Stopwatch()
    if model is None or study.interrupted:
        return study
    try:
        errors = source(study, model)
    except JointError as error:
        return study.noting(f"The {what} of the {name} model are not estimated: {error}")
    except KeyboardInterrupt:
        note = f"The run was interrupted in the {what} of the {name} model."
        return study.noting(note, interrupted=True)
    if errors is None or errors is model.estimate:
        return study
    took, compiled = watch.read()
    _log.info("The %s of the %s model are estimated, in %.3g s.", what, name, took)
    took, compiled = took + model.estimate_s, compiled + model.compilation_s
    return study.holding(replace(model, estimate=errors, estimate_s=took, compilation_s=compiled))


def _own_errors(study: Study, model: Model, report: Progress) -> Estimate | None:
    """Estimated errors of a model; the distance from a full one beside it counts among them."""
    errors = model.estimate
    if errors is None and study.scene.accuracy.estimate:
        errors = run_estimate.of_run(model.run, plan_of(study.scene), report)
    if errors is None or model.errors is None:
        return errors
    runs = results(study.models["full"].run), results(model.run)
    joints = joint_differences(*runs, study.system.contact.joints)
    return errors.beside(difference(*runs), joints)


def _with_mesh(study: Study, model: Model, report: Progress) -> Estimate | None:
    """The same with the error by the mesh, where a finer one costs little.

    It is found once, beside the first model, and is the same for all.
    """
    scene, first = study.scene, next(iter(study.models.values()))
    if model.estimate is None:
        return None
    known = None if first.estimate is None else first.estimate.parts.get("mesh")
    served = model.run.system.serves is not None  # no full model is assembled
    if known is None:
        judges = model.name == first.name and not served
        finer = finer_system(scene, study.system) if judges else None
        if finer is None:
            return None
        known = halved_mesh.of_run(model.run, plan_of(scene), study.system, finer, report)
    return model.estimate.with_mesh(known)


def _with_coulomb(study: Study, model: Model, report: Progress) -> Estimate | None:
    """The same with the distance from Coulomb's law, unless the model has that."""
    if model.estimate is None:
        return None
    return with_coulomb(study.system, model.run, plan_of(study.scene), model.estimate, report)


#: Estimated errors of a model, one after the other: what they are called, also in progress.
_SOURCES: dict[str, tuple[str, Callable[..., Estimate | None]]] = {
    "errors": ("errors of the {} model", _own_errors),
    "errors by the mesh": ("error of the mesh", _with_mesh),
    "distances from Coulomb's law": ("{} model, Coulomb's law", _with_coulomb),
}


def _with_model(name: str, study: Study, choice: Choice, integrate: _Integrate) -> Study:
    """Study with a model that is made and run, in steps that meet the accuracy asked for."""
    watch, scene, notes = Stopwatch(), study.scene, tuple[str, ...]()
    ready = choice if name == "reduced" or scene.parts is not None else Choice(scene)
    system = study.system if name == "full" else ready.model
    if system is None:
        system = model_of(name, scene, path=choice.path)
        notes = notes_of(system) if name == "reduced" else _costly(study, system)
    before, compiled = np.add(watch.read(), (ready.seconds, ready.compilation_s)).tolist()
    if name == "reduced":
        points = system.contact.count
        _log.info("Reduced to %d vectors, %d friction points, in %.3g s.", system.n, points, before)
        run, errors = integrate(system, plan_of(scene)), ready.estimate
    else:
        call = partial(_named_places, study, integrate) if name == "full" else integrate
        scene, run, errors = shortened_steps(scene, partial(call, system))
        if errors is not None:
            notes += (
                f"For the accuracy asked for the {name} model has steps of {scene.time_step:.4g} "
                f"s; it errs by an estimated {stated(errors)}.",
            )
    offline, compiled = before + run.preparation_s, compiled + run.compilation_s
    model = Model(name, run, offline, {}, estimate=errors, compilation_s=compiled)
    return replace(study, scene=scene).noting(*notes).holding(_with_region(study, model))


def _costly(study: Study, small: System) -> tuple[str, ...]:
    """Note of a condensed model whose steps cost more than those of the full one, if they do."""
    to = arranged(study.system)
    limited = ContactPoints.of(to.system).limited
    sparse = to.kind == "contact" and not condensing_pays(to.system.K, limited)
    if not sparse and to.kind != "chain":
        return ()
    less = "far less, of a chain" if to.kind == "chain" else "hardly more, of few entries"
    return (
        f"The condensed model keeps {small.contact.B.shape[0]} contact unknowns and has full "
        f"matrices: a step of the full one costs {less}; a reduced one costs less.",
    )


def _with_region(study: Study, model: Model) -> Model:
    """Model with its active region; a reduced one beside the full one has lengths alone."""
    sliding, length = model.slider_peak(study.system), None
    if model.name == "reduced":
        if model.basis is None:
            return model
        length = dict(model.basis.active_length)
        if "full" in study.models:
            return replace(model, active_length=length)
        sliding = study.system.contact.slider_peak(model.slip_peak)
    region = region_of(study.structure, study.system, (model.slip_peak, sliding), study.period)
    return replace(
        model,
        active_length=region.length if length is None else length,
        active_area_fraction=region.area_fraction,
        slipping_fraction=region.point_fraction,
    )


def _named_places(
    study: Study, integrate: _Integrate, system: System, plan: Plan, **others: None
) -> Run:
    """Run of the full model, whose errors say where in the structure they are."""
    try:
        return integrate(system, plan, **others)
    except ConvergenceError as error:
        if error.unknown is None:
            raise
        dof = int(abs(system.T[:, [error.unknown]]).argmax())  # that it moves most
        message = f"full model: {error} That unknown is of {study.structure.spot(dof)}."
        raise ConvergenceError(message, error.unknown, error.run) from error
