"""From a scene to results: the full model, the reduced one, how they compare, what to beware of."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from skfem_joint.analysis import accuracy, estimate
from skfem_joint.analysis.active_region import region_of
from skfem_joint.analysis.asked import TO_STEADY, options_of, plan_of
from skfem_joint.analysis.description import Description, describe
from skfem_joint.analysis.estimate import Estimate
from skfem_joint.analysis.history import Errors, compare, difference, results
from skfem_joint.analysis.reduced_models import make_reduced
from skfem_joint.analysis.summary import violated
from skfem_joint.arrays import FloatArray
from skfem_joint.errors import ConvergenceError, InputError, JointError
from skfem_joint.linalg import schur
from skfem_joint.progress import Progress, silent
from skfem_joint.reduction.active_length import gross_slip
from skfem_joint.reduction.basis import Basis, Options, reduced_system
from skfem_joint.reduction.condensed import condensed_basis, condensed_system
from skfem_joint.scene import Scene
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.checkpoint import Checkpoints, fingerprint
from skfem_joint.stepping.integrate import integrate_plan
from skfem_joint.stepping.recording import Run
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.structure import AnyStructure, doubts
from skfem_joint.system import System

_log = logging.getLogger(__name__)
_ByJoint: TypeAlias = dict[str, float]


@dataclass(frozen=True)
class Model:
    """One model that was run."""

    name: str
    run: Run
    offline_s: float  #: before the first step: modes, active length, projection, s
    active_length: dict[str, float]  #: of each joint whose axis is known, m
    #: Share of each joint's contact area, and of its nodes, that slips; empty for a reduced model
    #: beside a full one.
    active_area_fraction: dict[str, float] = field(default_factory=dict)
    slipping_fraction: dict[str, float] = field(default_factory=dict)
    basis: Basis | None = None  #: what a reduced or condensed model is made of
    errors: Errors | None = None  #: against the full model, where both were run
    estimate: Estimate | None = None  #: errors as estimated without it
    estimate_s: float = 0.0  #: time for that, s
    compilation_s: float = 0.0  #: of loops, once on a machine and in no other time here, s

    @property
    def slip_peak(self) -> FloatArray:
        """Largest slip of each contact point of the full model, m, as far as it is known, (m,).

        Of a reduced model in the run that its modes were made from.
        """
        return self.run.slip_peak if self.basis is None else self.basis.history.slip_peak

    @property
    def modes(self) -> int | None:
        """Number of vectors of the basis; None for the full model."""
        return None if self.basis is None else int(self.basis.V.shape[1])


@dataclass
class Study:
    """Results of a scene."""

    scene: Scene
    structure: AnyStructure
    system: System  #: of the full model
    models: dict[str, Model] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)  #: whole sentences
    interrupted: bool = False  #: the last model may hold a part of its run
    met: accuracy.Met | None = None  #: reduced model that meets the accuracy asked for
    met_s: tuple[float, float] = (0.0, 0.0)  #: time to find it, and that of compilation in it, s
    description: Description = field(default_factory=Description)  #: what the structure is

    @property
    def runs(self) -> dict[str, Run]:
        """Runs by the names of their models."""
        return {name: model.run for name, model in self.models.items()}

    @property
    def period(self) -> float:
        """Period of the load, or the length of the run where it has none, s."""
        return (self.scene.cycle_steps or self.scene.n_steps) * self.scene.time_step


def run_scene(
    scene: Scene, progress: Progress = silent, checkpoints: Checkpoints | None = None
) -> Study:
    """Run the models that a scene asks for, and nothing else, and compare them.

    Parameters
    ----------
    scene : Scene
    progress : callable, optional
        Called with (what is done, steps done, steps in all).
    checkpoints : Checkpoints, optional
        Where to save the models as they run. A model that was saved whole is not integrated again;
        the modes of a reduced one are found again.

    Raises
    ------
    ConvergenceError
        If a step of a model does not converge.
    InputError
        If the reduction does not fit the scene, or a checkpoint the run.
        The ``results`` of both are the study where other models were run before.
    """
    origin = "" if checkpoints is None else origin_of(scene)
    study = Study(scene, scene.structure(), scene.system(), description=describe(scene))
    study.warnings += [*doubts(study.structure, study.system), *study.description.doubts]
    if scene.accuracy.asked:
        study.scene = accuracy.followed(scene)
        if "reduced" in scene.models.run:  # tells the full one its step
            _refine(study, progress)
        elif study.system.contact_points and scene.reduction.reference != "self":
            with suppress(InputError):  # no reduced model: the full one's own estimate tells
                study.scene = accuracy.stepped(study.scene, _basis(study, options_of(scene), []))
    if study.met is not None or "reduced" not in scene.models.run:
        study.description.path = None  # its factors are large
    for name in scene.models.run:
        how: dict[str, Any] = {"progress": partial(progress, f"{name} model")}
        if checkpoints is not None:
            how["checkpoint"] = checkpoints.of(name, origin)
        try:
            model = _MAKERS[name](study, how)
        except JointError as error:
            if not study.models:
                raise
            study.warnings.append(f"There is no {name} model: {error}")
            error.results = study
            raise
        except KeyboardInterrupt:
            if not study.models:
                raise
            study.interrupted = True
            study.warnings.append(f"The run was interrupted while the {name} model was made.")
            break
        if "full" in study.models and not model.run.interrupted:
            model = replace(model, errors=compare(study.models["full"].run, model.run))
        study.models[name] = model
        if not model.run.interrupted:
            _estimate(study, model, progress)
            _measure(study, study.models[name])
            study.warnings += violated(study, study.models[name])
        else:
            study.interrupted = True
            study.warnings.append(
                f"The run was interrupted in the {name} model at t = "
                f"{model.run.counters.steps * study.scene.time_step:.6g} s; "
                "results are those until then."
            )
        if study.interrupted:
            break
    return study


def origin_of(scene: Scene) -> str:
    """Fingerprint of a scene, its mesh and the tables of its loads."""
    # `Scene.changed` takes values as they are: here a list is as good as a tuple.
    content = scene.model_dump(mode="json", exclude={"sweep"}, warnings=False)
    return fingerprint(
        content,
        [load.amplitude for load in scene.loads()],
        *scene.structure().identity,
    )


def _refine(study: Study, progress: Progress) -> None:
    """Choose a reduced model, and a time step, for the accuracy that is asked for."""
    watch = Stopwatch()
    scene = study.scene
    warn: list[str] = []
    basis = _basis(study, options_of(scene), warn, enriched=True)
    study.met = accuracy.meet(scene, basis, partial(progress, "choosing a reduced model"))
    if study.met.basis is basis:  # what an enriched one lacked at first is of no concern
        study.warnings += warn
    study.scene, system = study.met.scene, study.met.system
    study.met_s = watch.read()
    study.warnings.append(
        f"For the accuracy asked for the reduced model has {system.n} vectors, {system.w.size} "
        f"friction points, beta = {system.beta.max():.3g} s/m and steps of "
        f"{study.scene.time_step:.4g} s; it errs by an estimated "
        f"{accuracy.stated(study.met.estimate)}."
    )


def _full(study: Study, how: Mapping[str, Any]) -> Model:
    run = _full_run(study, how)
    found: Estimate | None = None
    for _ in range(accuracy.ROUNDS if study.scene.accuracy.asked else 0):
        if run.interrupted:
            break
        found = estimate.of_full(study.system, run, plan_of(study.scene))
        finer = accuracy.shorter(study.scene, found)
        if finer is None:
            study.warnings.append(
                f"For the accuracy asked for the full model has steps of "
                f"{study.scene.time_step:.4g} s; it errs by an estimated {accuracy.stated(found)}."
            )
            break
        study.scene, found = finer, None
        # What was saved is of another step.
        run = _full_run(study, {name: how[name] for name in how if name != "checkpoint"})
    else:
        if study.scene.accuracy.asked:
            raise ConvergenceError(
                f"accuracy: no step that the full model meets it with was found; "
                f"{study.scene.time_step:.4g} s does not do. Ask for less"
            )
    active = _active(study, run.slip_peak)
    model = Model("full", run, run.preparation_s, *active, estimate=found)
    return replace(model, compilation_s=run.compilation_s)


def _active(study: Study, slip_peak: FloatArray) -> tuple[_ByJoint, _ByJoint, _ByJoint]:
    """Active lengths (m), shares of area and shares of nodes, from largest slips, (m,), m."""
    found = region_of(study.structure, study.system, slip_peak, study.period)
    return found.length, found.area_fraction, found.point_fraction


def _full_run(study: Study, how: Mapping[str, Any]) -> Run:
    try:
        return integrate_plan(study.system, plan_of(study.scene), **how)
    except ConvergenceError as error:
        if error.unknown is None:
            raise
        dof = int(abs(study.system.T[:, [error.unknown]]).argmax())  # that it moves most
        message = f"full model: {error} That unknown is of {study.structure.spot(dof)}."
        raise ConvergenceError(message, error.unknown) from error


def _estimate(study: Study, model: Model, progress: Progress) -> None:
    """Give a model its estimated errors; what ends that early does not cost the results."""
    scene, watch = study.scene, Stopwatch()
    if model.estimate is not None or not scene.accuracy.estimate:
        return
    report = partial(progress, f"errors of the {model.name} model")
    try:
        found = estimate.of_run(
            study.system, model.basis, model.run, plan_of(scene), progress=report
        )
    except JointError as error:
        study.warnings.append(f"The errors of the {model.name} model are not estimated: {error}")
        return
    except KeyboardInterrupt:
        study.interrupted = True
        study.warnings.append(f"The run was interrupted in the errors of the {model.name} model.")
        return
    took, compiled = watch.read()
    _log.info("The errors of the %s model are estimated, in %.3g s.", model.name, took)
    compiled += model.compilation_s
    timed = replace(model, estimate=found, estimate_s=took, compilation_s=compiled)
    study.models[model.name] = timed


def _measure(study: Study, model: Model) -> None:
    """Let the distance from the full model, where that was run, count among estimated errors."""
    if model.estimate is not None and model.errors is not None:
        apart = difference(results(study.models["full"].run), results(model.run))
        study.models[model.name] = replace(model, estimate=model.estimate.beside(apart))


def _reduced(study: Study, how: Mapping[str, Any]) -> Model:
    watch, met = Stopwatch(), study.met
    if met is None:
        basis, system = reduction_of(study, options_of(study.scene))
    else:
        basis, system = met.basis, met.system
    active: tuple[_ByJoint, _ByJoint] = {}, {}
    if "full" not in study.models:  # beside a full model that one says more
        study.warnings += gross_slip(study.structure, basis.history.slip_peak, study.period)
        active = _active(study, basis.history.slip_peak)[1:]
    before, compiled = np.add(watch.read(), study.met_s).tolist()
    vectors, points = basis.V.shape[1], system.contact_points
    _log.info("Reduced to %d vectors, %d friction points, in %.3g s.", vectors, points, before)
    run = integrate_plan(system, plan_of(study.scene), **how)
    length, found = dict(basis.active_length), None if met is None else met.estimate
    offline, compiled = before + run.preparation_s, compiled + run.compilation_s
    model = Model("reduced", run, offline, length, *active, basis, estimate=found)
    return replace(model, compilation_s=compiled)


def _condensed(study: Study, how: Mapping[str, Any]) -> Model:
    watch, system = Stopwatch(), study.system
    basis = condensed_basis(system)
    small = condensed_system(system, basis.V)
    kept = small.B.shape[0]
    if kept > schur.SETTINGS.most_dense or arranged(system).kind == "chain":
        study.warnings.append(
            f"The condensed model keeps {kept} contact unknowns and has full matrices: a step of "
            "the full one, which has few entries, will hardly cost more; a reduced one costs less."
        )
    before, compiled = watch.read()
    run = integrate_plan(small, plan_of(study.scene), **how)
    peak = np.asarray(run.slip_peak @ small.shares)
    basis = replace(basis, history=replace(basis.history, slip_peak=peak))
    offline = before + run.preparation_s
    model = Model("condensed", run, offline, *_active(study, peak), basis)
    return replace(model, compilation_s=compiled + run.compilation_s)


_MAKERS = {"full": _full, "condensed": _condensed, "reduced": _reduced}


def reduction_of(
    study: Study, options: Options, basis: Basis | None = None
) -> tuple[Basis, System]:
    """Basis, if it is not given, and reduced system of a study, whose warnings are added to."""
    if basis is None:
        basis = _basis(study, options, study.warnings)
    small = reduced_system(study.system, basis, **options.friction, periodic=study.scene.periodic)
    study.warnings += small.notes
    return basis, small


def _basis(study: Study, options: Options, warn: list[str], enriched: bool = False) -> Basis:
    plan = plan_of(study.scene)
    if plan.until == "steady":
        plan = replace(plan, n_steps=plan.n_steps * TO_STEADY, until="end")
    path = study.description.path
    basis = make_reduced(study.structure, study.system, options, plan, enriched=enriched, path=path)
    warn += basis.notes
    return basis
