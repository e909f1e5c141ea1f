"""Responses of a scene's models over frequency, by its table ``[response]``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from skfem_joint.accuracy import run_estimate
from skfem_joint.accuracy.estimate import Estimate, Parts
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.progress import Progress, announced, silent
from skfem_joint.ground.rows import Rows
from skfem_joint.harmonic.response import BalancedCurve, harmonic_response
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.reduction.friction_points import NOWHERE
from skfem_joint.reduction.models import notes_of, reduced_for_response
from skfem_joint.results.loss import Losses
from skfem_joint.results.places import of_all, slips_of_all
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.runs.swept_response import SweptResponse, swept_loads, swept_response
from skfem_joint.scene import Scene
from skfem_joint.scene.tables import ResponseTable
from skfem_joint.steady.marching import MAY_DEPEND
from skfem_joint.steady.steady import odd_loads
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.study.models import (
    largest_model,
    model_by,
    options_of,
    origin_of,
    other_reference,
    with_friction,
)
from skfem_joint.study.scene_backbone import given_backbones, named_backbone
from skfem_joint.study.scene_range import model_in_range
from skfem_joint.system.system import System
from skfem_joint.vibration.backbone import Backbone
from skfem_joint.vibration.coarse_model import CoarseModel
from skfem_joint.vibration.linear_response import linear_response
from skfem_joint.vibration.response import at_frequency, response, steady_plan, suited_steps
from skfem_joint.vibration.response_curve import Curve, State, SteadyPoint, check_kind

#: What the response of a reduced model says that has contact that opens.
CREPT = (
    "The reduced model's response with contact that opens is that at which creep under its law of "
    "friction has ended. At levels where little slips its friction energy may be far too small: "
    "see its estimated errors at the peaks, or run 'condensed' in its place."
)
#: Dataclasses that rows of finished work of `scene_response` hold.
RESPONSE_ROWS = (SteadyPoint, Losses, BalancedCurve, FourierSeries, SweptResponse)
#: Frequencies of the linear limits beside those asked for, and entries that the stiffness may have
#: in all of them together. Their factors take some ten seconds so, of plates and of solids.
BETWEEN, ENTRIES = 400, 10_000_000


@dataclass(frozen=True)
class ModelResponse:
    """Response of one model of a scene.

    Attributes
    ----------
    name : str
        "full", "condensed" or "reduced".
    curves : list of Curve
        At the scene's levels, rising.
    estimates : list of Estimate
        Errors at the peak of each curve; empty if they were not asked for.
    offline_s : float
        Time of modes, projection and friction points, s.
    wall_s : float
        Time of the curves, s, with that of rows taken up from an earlier command.
    compilation_s : float
        Time of compiling loops, once on a machine and in no other time here, s.
    notes : tuple of str
        What to beware of.
    sweeps : list of SweptResponse
        Up and down at each rate and level that the scene asks for.
    """

    name: str
    curves: list[Curve]
    estimates: list[Estimate]
    offline_s: float
    wall_s: float
    compilation_s: float
    notes: tuple[str, ...]
    sweeps: list[SweptResponse] = field(default_factory=list)

    @property
    def largest(self) -> int:
        """Number of the named point that moves most, at the highest level."""
        return self.curves[-1].largest

    def sweeps_at(self, level: float) -> list[SweptResponse]:
        """Those of a level."""
        return [sweep for sweep in self.sweeps if sweep.level == level]


@dataclass(frozen=True)
class SceneResponse:
    """Response of a scene's models.

    Attributes
    ----------
    scene : Scene
    frequencies : ndarray, shape (k,)
        That the scene asks for, Hz.
    linear_frequencies : ndarray, shape (l,)
        Of the linear limits, Hz: those and up to 400 more, which their peaks need; fewer where the
        stiffness has more than 25,000 entries.
    stuck, loose : ndarray, shape (l, points)
        Amplitudes of the linear limits at level 1, m.
    models : list of ModelResponse
    notes : tuple of str
        Of the structure, all models and the backbones.
    backbones : list of Backbone
        Full model's curves beside the response, of a scene with a table ``[backbone]``.
    """

    scene: Scene
    frequencies: FloatArray
    linear_frequencies: FloatArray
    stuck: FloatArray
    loose: FloatArray
    models: list[ModelResponse]
    notes: tuple[str, ...]
    backbones: list[Backbone] = field(default_factory=list)


def response_table(scene: Scene) -> ResponseTable:
    """Table ``[response]`` of a scene.

    InputError if there is none, a load of the scene has no frequency that could be changed, no
    joint carries friction and the full model is not asked for, or a sine cannot be swept; as
    `named_backbone` for a table ``[backbone]`` beside it.
    """
    table: ResponseTable = scene.asked("response")
    at_frequency(scene.system(), table.frequencies.to)
    for kind in table.functions:
        try:
            check_kind(scene.system(), kind)
        except InputError as error:
            own = str(error).replace("frequency response: ", f"{scene.path}: response.functions: ")
            raise InputError(own) from error
    if table.sweep_rates:
        swept_loads(scene.system(), table.frequencies.from_, table.frequencies.to, 1.0)
        if scene.reduction.range is not None and "reduced" in scene.models.run:
            raise InputError(
                f"{scene.path}: response.sweep_rates: a reduced model for a range cannot be swept; "
                "leave out reduction.range, or the rates"
            )
    with_friction(scene)
    if "backbone" in scene.model_fields_set:
        named_backbone(scene)
    return table


def scene_response(
    scene: Scene,
    executor: Executor | None = None,
    progress: Progress = silent,
    rows: Rows | None = None,
    workers: int | None = None,
) -> SceneResponse:
    """Response of each model of a scene with a table ``[response]``, at its levels.

    A reduced model is made for the highest level at the frequency at which the stuck structure
    moves most. Errors of each model are estimated at the peak of each level.

    Parameters
    ----------
    scene : Scene
    executor : concurrent.futures.Executor, optional
        Where levels are run side by side.
    progress : callable, optional
        Called with (what is done, how much, of how much).
    rows : Rows, optional
        Made for `RESPONSE_ROWS`; where finished work is kept, and taken up again.
    workers : int, optional
        How many the executor has: levels that take longest go first where they are fewer.

    Raises
    ------
    InputError
        As :func:`response_table` and `skfem_joint.response`.
    ConvergenceError
        As `skfem_joint.response`.
    """
    table = response_table(scene)
    # The backbones first: they take seconds, and a wrong mode ends the command at once.
    beside = given_backbones(scene, progress)
    scene, left_out = with_friction(scene)
    between, levels = table.frequencies, sorted(table.levels)
    highest = _highest(scene.system(), between.to)
    system = largest_model(scene, frequency=highest)
    frequencies = np.linspace(between.from_, between.to, between.points)
    more = min(BETWEEN, ENTRIES // max(system.K.size, 1))
    fine = np.union1d(frequencies, np.linspace(between.from_, between.to, more))
    limits = []
    for held, limit in ((True, "stuck"), (False, "loose")):
        with announced(progress, f"linear response, {limit}"):
            limits.append(linear_response(system, fine, held))
    stuck, loose = limits
    rows, cycles = rows or Rows(), {"steps_per_cycle": scene.time.steps_per_cycle}
    resonance = float(frequencies[stuck[np.isin(fine, frequencies)].max(axis=1).argmax()])
    models = []
    for name in scene.models.run:
        watch = Stopwatch()
        with announced(progress, f"making the {name} model"):
            model = system if scene.parts else _model(name, scene, resonance, rows)
            coarse, notes = _coarse(model, scene, resonance)
        offline, compilation = watch.read()
        watch, earlier = Stopwatch(), rows.earlier_s
        how: dict[str, Any] = {"progress": partial(progress, f"{name} model"), "rows": rows}
        curves: list[Curve]
        if table.method == "harmonic":
            curves = [*harmonic_response(model, frequencies, levels, **how)]
        else:
            how |= {"executor": executor, "workers": workers, "coarse": coarse}
            how |= {"estimated": scene.accuracy.estimate, **cycles}
            curves = response(model, frequencies, levels, **how)
        curves = [_with_all_slips(curve, model, system) for curve in curves]
        wall, compiled = watch.read()
        if name == "reduced":
            crept = scene.opens and table.method == "time"
            notes += [*notes_of(model), *[CREPT] * crept]
        for curve in curves:
            level = f"Level {curve.level:g}"
            notes += [note.replace(level, f"{level}, {name} model", 1) for note in curve.notes]
        curves = [curve for curve in curves if curve.found]
        estimates: list[Estimate] = []
        if scene.accuracy.estimate and scene.parts:
            notes.append("Errors of models by parts are not estimated: the full model finds them.")
        elif scene.accuracy.estimate:
            report = partial(progress, f"errors of the {name} model")
            estimates, of_errors = _estimates(name, model, scene, curves, executor, rows, report)
            notes += of_errors
        times = offline, wall + rows.earlier_s - earlier, compilation + compiled
        sweeps = _sweeps(model, scene, partial(progress, f"{name} model, swept sine"), rows)
        models.append(ModelResponse(name, curves, estimates, *times, tuple(notes), sweeps))
    of_models = [note for model in models for note in model.notes]
    warnings = (*left_out, *system.notes, *other_reference(scene), *of_models)
    if not system.contact.count and "backbone" in scene.model_fields_set:
        warnings += (f"backbone: there is no curve beside the response, for {NOWHERE}.",)
    if scene.opens:
        warnings += (MAY_DEPEND,)
    if scene.time.rho_infinity < 1.0:
        warnings += ("time.rho_infinity has no effect on responses: their steps are trapezoidal.",)
    warnings += tuple(note for curve in beside for note in curve.notes)
    return SceneResponse(scene, frequencies, fine, stuck, loose, models, warnings, beside)


def _model(name: str, scene: Scene, resonance: float, rows: Rows) -> System:
    """Model of a scene; a reduced one serves its range, or the ``resonance`` (Hz) best."""
    system, table = scene.system(), scene.asked("response")

    def reduced() -> System:
        in_range = model_in_range(scene, None if rows.path is None else rows.path.parent)
        options = options_of(scene, "static")
        highest = max(table.levels)
        return in_range or reduced_for_response(system, resonance, highest, options)

    return model_by(name, scene, reduced, _highest(system, table.frequencies.to))


def _sweeps(model: System, scene: Scene, report: Progress, rows: Rows) -> list[SweptResponse]:
    """Responses of a model to the swept sines that a scene asks for."""
    table = scene.asked("response")
    ends, steps = (table.frequencies.from_, table.frequencies.to), scene.time.steps_per_cycle
    origin = rows.mark("swept sine", model, steps)
    swept = partial(swept_response, model, steps_per_cycle=steps, progress=report)
    return [
        rows.row(rows.mark(origin, way, rate, level), partial(swept, way, rate, level))
        for level in sorted(table.levels)
        for rate in table.sweep_rates
        for way in (ends, ends[::-1])
    ]


def _highest(system: System, frequency: float) -> float:
    """Highest frequency of the loads (Hz), if that of their common period is some frequency."""
    loads = at_frequency(system, frequency).loads
    return max(load.amplitude.highest_frequency or 0.0 for load in loads)


def _coarse(model: System, scene: Scene, resonance: float) -> tuple[CoarseModel | None, list[str]]:
    """Reduced model beside a full or condensed one, where that helps, and a note if it fails."""
    table = scene.asked("response")
    alone = model.made_for or model.serves or not model.contact.count or scene.parts
    if alone or table.method != "time":
        return None, []
    V = None if model.origin is None else model.origin.basis.V
    try:
        return CoarseModel.of(scene.system(), resonance, max(table.levels), V), []
    except (InputError, ConvergenceError) as error:
        name = "full" if V is None else "condensed"
        note = f"No reduced model helps the {name} model's response, which takes longer then"
        return None, [f"{note}: {error}"]


def _with_all_slips(curve: Curve, model: System, full: System) -> Curve:
    """Curve of a model with slip and friction work of the full model's points."""
    slips = None if model.origin is None else full.contact.B @ model.origin.basis.V

    def changed(point: SteadyPoint) -> SteadyPoint:
        if point.friction_work is not None:
            point = replace(point, friction_work=of_all(model, point.friction_work))
        slip = slips_of_all(model, point.slip)
        if slips is not None and point.course is not None:  # not of a range, which has many bases
            slip = full.contact.slip_norm(0.5 * np.ptp(point.course @ slips.T, axis=0))
        return replace(point, slip=slip, course=None)

    return replace(curve, points=tuple(map(changed, curve.points)))


def _estimates(
    name: str,
    model: System,
    scene: Scene,
    curves: Sequence[Curve],
    executor: Executor | None,
    rows: Rows,
    report: Progress,
) -> tuple[list[Estimate], list[str]]:
    """Errors of a model at the peak of each curve, side by side with an executor, and notes."""
    steps = scene.time.steps_per_cycle
    jobs: list[tuple[str, Callable[[], dict[str, Parts]]]] = []
    for curve in curves:
        at = curve.peak[0], curve.level
        V = None if model.origin is None else model.origin.basis.V
        mark = rows.mark("errors", origin_of(scene), model, V, *at)
        given = at_frequency(model, *at), steps, curve.start
        if executor is None or mark in rows:
            jobs.append((mark, partial(_errors, *given, report)))
        else:
            jobs.append((mark, executor.submit(_errors, *given).result))
    estimates, notes = [], []
    for curve, (mark, job) in zip(curves, jobs, strict=True):
        parts: dict[str, Parts] = {}
        try:
            parts = rows.row(mark, job)
        except ConvergenceError as error:  # which does not cost the curve
            notes.append(
                f"The errors of the {name} model at the peak of level {curve.level:g} are "
                f"not estimated: {error}"
            )
        estimates.append(Estimate(parts))
    return estimates, notes


def _errors(
    loaded: System, steps_per_cycle: int, start: State, report: Callable[..., None] | None = None
) -> dict[str, Parts]:
    """Estimated errors of the steady vibration of a model, by source and quantity."""
    full = run_estimate.full_of(loaded)
    plan = steady_plan(full, suited_steps(full, steps_per_cycle))
    initial = start if odd_loads(full) or full.contact.opens else None
    run = integrate_plan(loaded, plan, initial=initial, progress=report)
    return dict(run_estimate.of_run(run, plan, report).parts)
