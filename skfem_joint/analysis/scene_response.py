"""Responses of a scene's models over frequency, by its table ``[response]``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from skfem_joint.analysis import run_estimate
from skfem_joint.analysis.coarse_model import CoarseModel
from skfem_joint.analysis.estimate import Estimate, Parts
from skfem_joint.analysis.linear_response import linear_response
from skfem_joint.analysis.response import (
    Curve,
    SideBySide,
    State,
    SteadyPoint,
    at_frequency,
    guided_response,
    steady_plan,
    suited_steps,
)
from skfem_joint.analysis.rows import Rows
from skfem_joint.analysis.scene_plan import (
    TO_STEADY,
    make_reduced,
    options_of,
    origin_of,
    with_friction,
)
from skfem_joint.analysis.scene_range import of_scene, range_model, served_scene
from skfem_joint.arrays import FloatArray
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.progress import Progress, announced, silent
from skfem_joint.reduction.basis import Basis, notes_of_reduction, reduced_system
from skfem_joint.reduction.condensed import condensed_basis, condensed_system
from skfem_joint.reduction.friction_points import NOWHERE
from skfem_joint.scene import Scene
from skfem_joint.scene.tables import ResponseTable
from skfem_joint.stepping.integrate import integrate_plan
from skfem_joint.stepping.marching import MAY_DEPEND
from skfem_joint.stepping.steady import odd_loads
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.structure import doubts
from skfem_joint.system import System

#: What the response of a reduced model says that has contact that opens.
CREPT = (
    "The reduced model's response with contact that opens is that at which creep under its law of "
    "friction has ended. At levels where little slips its friction energy may be far too small: "
    "see its estimated errors at the peaks, or run 'condensed' in its place."
)
#: Dataclasses that rows of finished work of `scene_response` hold.
RESPONSE_ROWS = (SteadyPoint,)
#: Frequencies of the linear limits beside those asked for, and entries that the stiffness may have
#: in all of them together. Their factors take some ten seconds so, of plates and of solids.
BETWEEN, ENTRIES = 400, 10_000_000
#: Relative error of an amplitude by its time step that is doubtful.
DOUBTFUL = 0.05


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
    """

    name: str
    curves: list[Curve]
    estimates: list[Estimate]
    offline_s: float
    wall_s: float
    compilation_s: float
    notes: tuple[str, ...]

    @property
    def largest(self) -> int:
        """Number of the named point that moves most, at the highest level."""
        return self.curves[-1].largest


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
    warnings : tuple of str
        Of the structure and of all models.
    """

    scene: Scene
    frequencies: FloatArray
    linear_frequencies: FloatArray
    stuck: FloatArray
    loose: FloatArray
    models: list[ModelResponse]
    warnings: tuple[str, ...]


def asked_table(scene: Scene) -> ResponseTable:
    """Table ``[response]`` of a scene; InputError if there is none."""
    if scene.response is None:
        raise InputError(
            f"{scene.path}: response: missing; say frequencies = {{ from, to, points }} and levels "
            "in a table [response]"
        )
    return scene.response


def response_table(scene: Scene) -> ResponseTable:
    """Table ``[response]`` of a scene.

    InputError if there is none, a load of the scene has no frequency that could be changed, or no
    joint carries friction and the full model is not asked for.
    """
    table = asked_table(scene)
    at_frequency(scene.system(), table.frequencies.to)
    with_friction(scene)
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
    scene, left_out = with_friction(scene)
    system, between = scene.system(), table.frequencies
    frequencies = np.linspace(between.from_, between.to, between.points)
    more = min(BETWEEN, ENTRIES // max(system.K.nnz, 1))
    fine = np.union1d(frequencies, np.linspace(between.from_, between.to, more))
    limits = []
    for held, limit in ((True, "stuck"), (False, "loose")):
        with announced(progress, f"linear response, {limit}"):
            limits.append(linear_response(system, fine, held))
    stuck, loose = limits
    rows = rows or Rows()
    resonance = float(frequencies[stuck[np.isin(fine, frequencies)].max(axis=1).argmax()])
    models = []
    for name in scene.models.run:
        watch = Stopwatch()
        with announced(progress, f"making the {name} model"):
            model = _with_coarse(
                _prepared(name, scene, table, resonance, rows), scene, table, resonance
            )
        offline, compilation = watch.read()
        watch, earlier = Stopwatch(), rows.earlier_s
        errors = _PeakErrors(model, scene, executor, workers, rows)
        curves = _curves(model, scene, table, frequencies, errors, progress, rows)
        wall, compiled = watch.read()
        of_levels = [note for curve in curves for note in _whole_slip(model.name, curve)]
        curves = [curve for curve in curves if curve.found]
        estimates, notes = _checked(model, scene, curves, errors, progress)
        notes = of_levels + notes
        times = offline, wall + rows.earlier_s - earlier, compilation + compiled
        models.append(ModelResponse(name, curves, estimates, *times, (*model.notes, *notes)))
    of_models = [note for model in models for note in model.notes]
    warnings = (*left_out, *doubts(scene.structure(), system), *of_models)
    if not system.contact.count and "backbone" in scene.model_fields_set:
        warnings += (f"backbone: there is no curve beside the response, for {NOWHERE}.",)
    if scene.opens:
        warnings += (MAY_DEPEND,)
    if scene.time.rho_infinity < 1.0:
        warnings += ("time.rho_infinity has no effect on responses: their steps are trapezoidal.",)
    return SceneResponse(scene, frequencies, fine, stuck, loose, models, warnings)


@dataclass(frozen=True)
class _Prepared:
    """A model of a scene before its curves are computed.

    Attributes
    ----------
    name : str
    system : System
        Of the model, with its loads at ``level``.
    basis : Basis or None
        What a reduced or condensed model is made of.
    level : float
        Level of the scene that is level 1 of ``system``.
    notes : tuple of str
        How it was made, where users should know.
    coarse : CoarseModel, optional
        Reduced model beside a larger one.
    """

    name: str
    system: System
    basis: Basis | None = None
    level: float = 1.0
    notes: tuple[str, ...] = ()
    coarse: CoarseModel | None = None


def _prepared(
    name: str, scene: Scene, table: ResponseTable, resonance: float, rows: Rows
) -> _Prepared:
    """Model of a scene; a reduced one serves its range, or the ``resonance`` (Hz) best."""
    system, level = scene.system(), max(table.levels)
    served = served_scene(scene) if name == "reduced" else None
    if served is not None:
        folder = None if rows.path is None else rows.path.parent
        small = of_scene(scene, range_model(served, folder))
        return _Prepared(name, small, notes=(CREPT,) if scene.opens else ())
    if name == "full":
        return _Prepared(name, system)
    if name == "condensed":
        loaded = at_frequency(system, table.frequencies.to, level)
        basis = condensed_basis(loaded)
        return _Prepared(name, condensed_system(loaded, basis.V), basis, level)
    loaded, options = at_frequency(system, resonance, level), options_of(scene)
    plan = steady_plan(loaded, suited_steps(loaded, scene.time.steps_per_cycle))
    plan = replace(plan, n_steps=plan.n_steps * TO_STEADY, until="end")
    basis = make_reduced(scene.structure(), loaded, options, plan)
    small = reduced_system(loaded, basis, **options.friction)
    notes = (*basis.notes, *notes_of_reduction(loaded, small))
    return _Prepared(name, small, basis, level, (*notes, CREPT) if scene.opens else notes)


def _with_coarse(
    model: _Prepared, scene: Scene, table: ResponseTable, resonance: float
) -> _Prepared:
    """A full or condensed model with a reduced one beside it, where that helps."""
    if model.name == "reduced" or not scene.system().contact.count:
        return model
    V = None if model.basis is None else model.basis.V
    level, loaded = max(table.levels), scene.system()
    loaded = at_frequency(loaded, resonance, model.level)
    try:
        coarse = CoarseModel.of(loaded, resonance, level / model.level, V)
    except (InputError, ConvergenceError) as error:
        note = f"No reduced model helps the {model.name} model's response, which takes longer then"
        return replace(model, notes=(*model.notes, f"{note}: {error}"))
    return replace(model, coarse=coarse)


def _curves(
    model: _Prepared,
    scene: Scene,
    table: ResponseTable,
    frequencies: FloatArray,
    errors: _PeakErrors,
    progress: Progress,
    rows: Rows,
) -> list[Curve]:
    """Curves of a model at the levels of a scene, rising, with the slip of all contact points.

    Their ``errors`` begin to be estimated while other curves are computed.
    """
    levels, system = sorted(table.levels), scene.system()
    curves = guided_response(
        model.system,
        frequencies,
        [level / model.level for level in levels],
        model.coarse,
        steps_per_cycle=scene.time.steps_per_cycle,
        estimated=scene.accuracy.estimate,
        beside=SideBySide(
            errors.executor,
            errors.workers,
            lambda number, curve: errors.begin(levels[number], curve) if curve.found else None,
        ),
        progress=partial(progress, f"{model.name} model"),
        rows=rows,
    )
    shares = model.system.contact.shares
    if model.basis is None and shares is not None:  # of a range, which is of many bases
        of_points = [
            [replace(p, slip=(shares > 0.0).T @ p.slip, course=None) for p in c.points]
            for c in curves
        ]
        pairs = zip(levels, of_points, strict=True)
        return [Curve(level, tuple(points)) for level, points in pairs]
    if model.basis is None:
        return curves
    slips = system.contact.B @ model.basis.V

    def with_all_slips(point: SteadyPoint) -> SteadyPoint:
        """Point with the slip of the full model's contact points, by its course."""
        if point.course is None:
            return point
        slip = system.contact.slip_norm(point.course @ slips.T).max(axis=0)
        return replace(point, slip=slip, course=None)

    return [
        Curve(level, tuple(map(with_all_slips, curve.points)))
        for level, curve in zip(levels, curves, strict=True)
    ]


def _checked(
    model: _Prepared, scene: Scene, curves: list[Curve], errors: _PeakErrors, progress: Progress
) -> tuple[list[Estimate], list[str]]:
    """Errors at the peak of each curve, if they are asked for, and what to beware of."""
    estimates, notes = [], []
    for curve in curves:
        notes += _frequencies_without(model.name, curve)
    if not scene.accuracy.estimate:
        return [], notes
    for curve in curves:
        parts: dict[str, Parts] = {}
        try:
            parts = errors.of(curve, progress)
        except ConvergenceError as error:  # which does not cost the curve
            notes.append(
                f"The errors of the {model.name} model at the peak of level {curve.level:g} are "
                f"not estimated: {error}"
            )
        estimates.append(Estimate(parts))
        notes += _step_error_notes(model.name, curve, scene.time.steps_per_cycle)
    return estimates, notes


def _step_error_notes(name: str, curve: Curve, steps_per_cycle: int) -> Iterator[str]:
    """Sentences about where the time step makes a curve doubtful, and the cure.

    A sentence also says where the error is not estimated. The steps are exact at the driven
    frequency: what errs are the harmonics of friction, where they meet higher modes.

    Parameters
    ----------
    name : str
        Of the model, for the sentences.
    curve : Curve
        With its estimated errors of the step.
    steps_per_cycle : int
    """
    error = curve.column("step_error")
    failed = np.array([point.failure is not None for point in curve.points])
    if not (np.isfinite(error) | failed).all():
        yield (
            f"The {name} model at level {curve.level:g} has no steady vibration with half the "
            "step at every frequency: where step_error is empty in response.csv the error of the "
            "step is not known."
        )
    error = np.nan_to_num(error)
    doubtful = error > DOUBTFUL
    if doubtful.any():
        frequency = curve.column("frequency")[doubtful]
        # Errors fall with the square of the step: so many steps leave one percent, in whole
        # fifties.
        enough = 50 * np.ceil(steps_per_cycle * np.sqrt(error.max() / 0.01) / 50)
        yield (
            f"The {name} model at level {curve.level:g}: the time step alone errs by up to "
            f"{100 * error.max():.2g} % of the amplitude, and by more than {100 * DOUBTFUL:g} % at "
            f"{frequency.size} frequencies from {frequency[0]:.6g} to {frequency[-1]:.6g} Hz, "
            "where harmonics of friction meet higher modes; see column step_error of "
            f"response.csv. Set time.steps_per_cycle = {enough:.0f}."
        )


def _whole_slip(name: str, curve: Curve) -> list[str]:
    """Note of where on a curve a joint slips as a whole, and of what is left out for that."""
    if not curve.gross.size:
        return []
    low, high = curve.gross.min(), curve.gross.max()
    where = f"{low:.6g} Hz" if low == high else f"{low:.6g} to {high:.6g} Hz"
    note = f"The {name} model at level {curve.level:g}: a joint slips as a whole at {where}"
    given_up = [p.failure for p in curve.points if p.failure is not None and p.periods > 0]
    if given_up:
        what = "the curve ends there" if curve.found else "the level has no curve"
        note += f"; {what}: {given_up[0]}"
    return [f"{note}."]


def _frequencies_without(name: str, curve: Curve) -> list[str]:
    """Note of the frequencies of a curve that have no steady vibration."""
    without = [f"{p.frequency:.6g}" for p in curve.points if p.failure is not None]
    if not without:
        return []
    return [
        f"The {name} model at level {curve.level:g} has no steady vibration at "
        f"{', '.join(without)} Hz: these are no points of its curve."
    ]


class _PeakErrors:
    """Estimated errors of a model at the peaks of its curves; with an executor side by side.

    Parameters
    ----------
    model : _Prepared
    scene : Scene
    executor : concurrent.futures.Executor or None
    workers : int or None
        How many it has, if that is known.
    rows : Rows
        Where estimates are kept, and taken up again.
    """

    def __init__(
        self,
        model: _Prepared,
        scene: Scene,
        executor: Executor | None,
        workers: int | None,
        rows: Rows,
    ) -> None:
        self.model, self.scene, self.rows = model, scene, rows
        self.executor, self.workers = executor, workers
        basis = model.basis
        if basis is not None and executor is not None:
            basis = replace(basis, stiffness=None)  # whose factors cannot go to another process
        self.basis, self.begun = basis, dict[float, Future[dict[str, Parts]]]()  # by level

    def begin(self, level: float, curve: Curve) -> None:
        """Begin with a curve at a level of the scene, where there is an executor."""
        if self.executor is None or not self.scene.accuracy.estimate:
            return
        mark, job = self._job(level, curve)
        if mark not in self.rows:
            self.begun[level] = self.executor.submit(job)

    def of(self, curve: Curve, progress: Progress) -> dict[str, Parts]:
        """Errors at the peak of a curve, at a level of the scene, by source and quantity.

        ConvergenceError if a run of the estimate does not converge.
        """
        mark, job = self._job(curve.level, curve)
        if (begun := self.begun.get(curve.level)) is not None:
            return self.rows.row(mark, begun.result)
        report = partial(progress, f"errors of the {self.model.name} model")
        return self.rows.row(mark, partial(job, report))

    def _job(self, level: float, curve: Curve) -> tuple[str, Callable[..., dict[str, Parts]]]:
        """Name of a row, and what computes it."""
        model, scene, frequency = self.model, self.scene, curve.peak[0]
        full = at_frequency(scene.system(), frequency, level)
        loaded = at_frequency(model.system, frequency, level / model.level)
        V = None if self.basis is None else self.basis.V
        mark = self.rows.mark(
            "errors", origin_of(scene), model.system, V, model.level, frequency, level
        )
        steps = scene.time.steps_per_cycle
        return mark, partial(_errors, full, loaded, self.basis, steps, curve.start)


def _errors(
    full: System,
    loaded: System,
    basis: Basis | None,
    steps_per_cycle: int,
    start: State,
    report: Callable[..., None] | None = None,
) -> dict[str, Parts]:
    """Estimated errors of the steady vibration of a model, by source and quantity.

    ``full`` and ``loaded`` are the full system and the model, under the same load.
    """
    plan = steady_plan(full, suited_steps(full, steps_per_cycle))
    initial = start if odd_loads(full) or full.contact.opens else None
    run = integrate_plan(loaded, plan, initial=initial, progress=report)
    return dict(run_estimate.of_run(full, basis, run, plan, progress=report).parts)
