"""Steady vibration of a scene's models: what its tables [backbone] and [response] ask for."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from skfem_joint.analysis import estimate
from skfem_joint.analysis.asked import TO_STEADY, options_of
from skfem_joint.analysis.backbone import (
    CHECKED,
    INCREMENTS,
    Backbone,
    RingDown,
    backbone,
    ring_down,
    stuck_modes,
)
from skfem_joint.analysis.estimate import Estimate, Parts
from skfem_joint.analysis.linear_response import linear_response
from skfem_joint.analysis.response import Curve, SteadyPoint, at_frequency, response
from skfem_joint.analysis.rows import Rows
from skfem_joint.analysis.study import origin_of
from skfem_joint.arrays import FloatArray, Matrix
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.progress import Progress, silent
from skfem_joint.reduction.basis import Basis, make_basis, stuck_basis
from skfem_joint.reduction.condensed import condensed_basis, condensed_system
from skfem_joint.reduction.friction_points import reduced_system
from skfem_joint.scene import Scene
from skfem_joint.stepping.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.structure import doubts
from skfem_joint.system import System

#: Errors of a step that are told in a sentence, and that the steps which it asks for leave.
DOUBTFUL, WELL = 0.05, 0.01
#: Modes of what slips that a reduced model has, and stuck ones beyond the mode's own.
MODES, BESIDE = 24, 2
#: What rows of finished work hold, of `scene_response` and of `scene_backbone`.
RESPONSE_ROWS, BACKBONE_ROWS = (SteadyPoint,), (RingDown,)


@dataclass(frozen=True)
class ModelResponse:
    """Response of one model of a scene."""

    name: str
    curves: list[Curve]
    offline_s: float  #: of modes, projection and friction points, s
    wall_s: float  #: with the time that rows taken up from an earlier command took
    estimates: list[Estimate]  #: of each curve at its peak
    compilation_s: float = 0.0  #: of loops, once on a machine and in no other time here, s

    @property
    def largest(self) -> int:
        """Number of the named point that moves most, at the highest level."""
        return self.curves[-1].largest


@dataclass
class SceneResponse:
    """Response of a scene's models, with the linear limits, (frequencies, points), for level 1."""

    scene: Scene
    frequencies: FloatArray
    stuck: FloatArray
    free: FloatArray
    models: list[ModelResponse] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def scene_response(
    scene: Scene,
    executor: Executor | None = None,
    progress: Progress = silent,
    rows: Rows | None = None,
) -> SceneResponse:
    """Response of each model of a scene with a table ``[response]``, at its levels.

    A reduced model is made for the highest level at the frequency at which the stuck structure
    answers most, and its errors are estimated at the peak of each level. ``rows``, which may hold
    `RESPONSE_ROWS`, keeps what is finished and is gone on from. InputError if there is no such
    table, or as :func:`response`.
    """
    asked = scene.response
    if asked is None:
        raise InputError(
            f"{scene.path}: response: missing; say frequencies = {{ from, to, points }} and levels "
            "in a table [response]"
        )
    system, between = scene.system(), asked.frequencies
    frequencies = np.linspace(between.from_, between.to, between.points)
    stuck, free = (linear_response(system, frequencies, held) for held in (True, False))
    found = SceneResponse(scene, frequencies, stuck, free)
    found.warnings += doubts(scene.structure(), system)
    levels, steps = sorted(asked.levels), scene.time.steps_per_cycle
    rows, of_curve = rows or Rows(), frequencies.size
    if scene.accuracy.estimate:
        of_curve += frequencies.size + 1
    rows.asked += len(scene.models.run) * len(levels) * of_curve
    for name in scene.models.run:
        watch, model, basis, unit = Stopwatch(), system, None, 1.0
        if name != "full":
            unit, top = levels[-1], between.to
            if name == "reduced":
                top = float(frequencies[stuck.max(axis=1).argmax()])
            basis, model = _loaded(name, scene, top, unit, found.warnings)
        (offline, before), watch, earlier = watch.read(), Stopwatch(), rows.earlier_s
        curves = response(
            model,
            frequencies,
            [level / unit for level in levels],
            steps_per_cycle=steps,
            scheme=generalized_alpha(scene.time.rho_infinity),
            estimated=scene.accuracy.estimate,
            executor=executor,
            progress=partial(progress, f"{name} model"),
            rows=rows,
        )
        wall, compiled = watch.read()
        wall += rows.earlier_s - earlier
        slips = None if basis is None else system.B @ basis.V
        curves = [_told(c, v, system, slips) for c, v in zip(curves, levels, strict=True)]
        found.models.append(ModelResponse(name, curves, offline, wall, [], before + compiled))
        for curve in curves:
            lost = [f"{p.frequency:.6g}" for p in curve.points if p.failure is not None]
            if lost:
                found.warnings.append(
                    f"The {name} model at level {curve.level:g} has no steady vibration at "
                    f"{', '.join(lost)} Hz: these are no points of its curve."
                )
            if scene.accuracy.estimate:
                report = partial(progress, f"errors of the {name} model")
                V = None if basis is None else basis.V
                of = origin_of(scene), model, V, unit, curve.peak[0], curve.level
                errors = partial(_errors, scene, curve, basis, model, unit, report)
                try:
                    parts = rows.row(rows.mark("errors", *of), errors)
                except ConvergenceError as error:  # which does not cost the curve
                    parts = {}
                    found.warnings.append(
                        f"The errors of the {name} model at the peak of level {curve.level:g} are "
                        f"not estimated: {error}"
                    )
                found.models[-1].estimates.append(Estimate(parts))
                found.warnings += _too_long_steps(name, curve, model, scene)
    return found


def _too_long_steps(name: str, curve: Curve, model: System, scene: Scene) -> Iterator[str]:
    """Sentences about where a curve errs much by its time step, and by what."""
    steps = scene.time.steps_per_cycle
    known = np.isfinite(curve.column("step_error"))
    failed = np.array([point.failure is not None for point in curve.points])
    if not (known | failed).all():
        yield (
            f"The {name} model at level {curve.level:g} has no steady vibration with twice the "
            "step at every frequency: where step_error is empty in response.csv the error of the "
            "step is not known."
        )
    error = np.nan_to_num(curve.column("step_error"))
    shift = generalized_alpha(scene.time.rho_infinity).frequency_shift(2.0 * np.pi / steps)
    width = half_power_widths(curve, model)
    explained = error <= 2.0 * _by_shift(curve, shift, width)
    enough = 50 * np.ceil(steps * np.sqrt(error.max() / WELL) / 50)
    for light in (True, False):
        there = (error > DOUBTFUL) & (explained if light else ~explained)
        if not there.any():
            continue
        doubtful, worst = curve.column("frequency")[there], float(error[there].max())
        cause = "where harmonics of friction meet higher modes"
        if light:
            cause = (
                f"where damping is light: the steps lower the natural frequency by "
                f"{100 * shift:.2g} %, and the resonance is only {100 * width[there].min():.2g} % "
                "wide at half its power"
            )
        yield (
            f"The {name} model at level {curve.level:g}: the time step alone errs by up to "
            f"{100 * worst:.2g} % of the amplitude, and by more than {100 * DOUBTFUL:g} % at "
            f"{doubtful.size} frequencies from {doubtful[0]:.6g} to {doubtful[-1]:.6g} Hz, {cause}"
            f"; see column step_error of response.csv. Set time.steps_per_cycle = {enough:.0f}."
        )


def half_power_widths(curve: Curve, model: System) -> FloatArray:
    """Half-power width over frequency of a resonance at each point of a curve, (points,).

    It is the loss factor, the energy lost in a period over 2 pi times the energy stored.
    """
    stored = [np.nan if p.state is None else model.stored_energy(*p.state) for p in curve.points]
    energy = 2.0 * np.pi * np.array(stored)
    lost = np.abs(curve.column("input_energy"))
    width = np.full(energy.shape, np.inf)
    np.divide(lost, energy, out=width, where=energy > 0.0)
    return width


def _by_shift(curve: Curve, shift: float, width: FloatArray) -> FloatArray:
    """Largest relative error of the amplitude where the natural frequency is off by ``shift``.

    On the flank of a resonance the amplitude falls by at most 1 / width, and by 1 / distance, of
    itself for each relative change of the frequency.
    """
    f, (known, A) = curve.column("frequency"), curve.known
    tops = known[np.flatnonzero(np.diff(np.sign(np.diff(np.pad(A, 1)))) < 0)]
    distance = np.abs(f[:, np.newaxis] / tops - 1.0).min(axis=1)
    return np.asarray(shift / np.maximum(width, distance))


def _told(curve: Curve, level: float, system: System, slips: Matrix) -> Curve:
    """Curve at a level of the scene, with the slip of all contact points of the full ``system``."""
    points = tuple(
        p
        if p.course is None
        else replace(p, slip=system.slip_norm(p.course @ slips.T).max(axis=0), course=None)
        for p in curve.points
    )
    return Curve(level, points)


def _plan(scene: Scene, frequency: float) -> Plan:
    """Steps of a period at a frequency (Hz), and their scheme."""
    steps, scheme = scene.time.steps_per_cycle, generalized_alpha(scene.time.rho_infinity)
    return Plan(1.0 / frequency / steps, steps, scheme, cycle_steps=steps)


def _loaded(
    name: str, scene: Scene, frequency: float, level: float, warn: list[str]
) -> tuple[Basis, System]:
    """Basis and smaller system for steady vibration under the loads at a frequency (Hz)."""
    loaded, options = at_frequency(scene.system(), frequency, level), options_of(scene)
    if name == "condensed":
        basis = condensed_basis(loaded)
        return basis, condensed_system(loaded, basis.V)
    plan = _plan(scene, frequency)
    plan = replace(plan, n_steps=plan.n_steps * TO_STEADY)
    basis = make_basis(scene.structure(), loaded, options, plan)
    small = reduced_system(loaded, basis, **options.friction)
    warn += [*basis.notes, *small.notes]
    return basis, small


def _errors(
    scene: Scene, curve: Curve, basis: Basis | None, model: System, unit: float, report: Progress
) -> dict[str, Parts]:
    """Estimated errors at the peak of a curve, by source and quantity."""
    at = curve.peak[0]
    plan = replace(_plan(scene, at), until="steady")
    full = at_frequency(scene.system(), at, curve.level)
    run = integrate_plan(at_frequency(model, at, curve.level / unit), plan, progress=report)
    return dict(estimate.of_run(full, basis, run, plan, progress=report).parts)


@dataclass(frozen=True)
class ModelBackbone:
    """Curves of one model of a scene, and what their modes ring down like where it asks."""

    name: str
    curves: list[Backbone]
    ring_downs: list[RingDown]  #: of each curve; none where none is asked for
    errors: list[dict[str, float]]  #: of each curve: largest relative distances from the full one's


@dataclass
class SceneBackbone:
    """Curves of the modes that a scene asks for.

    ``largest`` is, of each mode, the displacement of the node that it moves most for a modal
    amplitude of 1 m kg^1/2, kg^-1/2; none where nodes are not known.
    """

    scene: Scene
    largest: list[float] = field(default_factory=list)
    models: list[ModelBackbone] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def scene_backbone(
    scene: Scene, progress: Progress = silent, rows: Rows | None = None
) -> SceneBackbone:
    """Frequency and damping against amplitude as a scene's table ``[backbone]`` asks for.

    A reduced model is made for each mode, of the full one's states at its levels. ``progress`` is
    called with (what is done, how much, of how much). ``rows``, which may hold `BACKBONE_ROWS`,
    keeps what is finished and is gone on from. Errors as :func:`backbone` and :func:`ring_down`.
    """
    asked, system, structure = scene.backbone, scene.system(), scene.structure()
    full, rows = partial(progress, "full model"), rows or Rows()
    of_curve = 1 + asked.levels + INCREMENTS * min(CHECKED, asked.levels) + bool(asked.ring_down)
    rows.asked += len(scene.models.run) * len(asked.modes) * of_curve
    curves = backbone(system, asked.modes, asked.levels, asked.up_to, progress=full, rows=rows)
    found = SceneBackbone(scene, warnings=list(doubts(structure, system)))
    found.warnings += [warning for curve in curves for warning in curve.warnings]
    if structure.body is not None:
        shapes = (structure.body.unpacked(system.expand(curve.shape)) for curve in curves)
        moved = (np.linalg.norm(shape, axis=1) for shape in shapes)
        found.largest = [float(distance.max()) for distance in moved]
    start = None
    if asked.ring_down and asked.released == "loads":
        mark = rows.mark("loads' end", origin_of(scene))
        start = rows.row(mark, partial(_loads_end, scene, system))
        rows.asked += 1
    how = scene.time.steps_per_cycle, generalized_alpha(scene.time.rho_infinity)
    for name in scene.models.run:
        model = ModelBackbone(name, [], [], [])
        for curve in curves:
            one, own, begin = curve, system, start
            if name != "full":
                V, own = _vibrating(name, scene, system, curve, found.warnings)
                levels = asked.levels, asked.up_to
                report = partial(progress, f"{name} model, mode {curve.mode}")
                (one,) = backbone(own, (curve.mode,), *levels, curve.slips_at, report, rows)
                if start is not None:
                    at_end = V.T @ (system.M @ np.array(start).T)
                    begin = tuple(np.linalg.solve(own.M, at_end).T)
                slip = system.slip_norm((system.B @ (V @ one.states.T)).T)
                one = replace(one, slip=slip)
            model.curves.append(one)
            told = ("frequency", "damping_ratio")
            ratios = {k: getattr(one, k) / getattr(curve, k) for k in told}
            model.errors.append({k: float(np.abs(x - 1.0).max()) for k, x in ratios.items()})
            if asked.ring_down:
                report = partial(progress, f"{name} model, mode {curve.mode} rings down")
                released = one.shape, one.stuck_frequency, one.states[-1], begin
                mark = rows.mark("ring-down", own, *released, asked.ring_down, *how)
                ringing = partial(ring_down, own, one, asked.ring_down, *how, begin, report)
                model.ring_downs.append(rows.row(mark, ringing))
        found.models.append(model)
    return found


def _vibrating(
    name: str, scene: Scene, system: System, curve: Backbone, warn: list[str]
) -> tuple[FloatArray, System]:
    """Basis and smaller system for a mode."""
    options, number = options_of(scene), curve.mode
    modes = MODES if isinstance(options.modes, str) else options.modes
    beside = BESIDE if isinstance(options.interface_modes, str) else options.interface_modes
    if not curve.share.any():
        raise InputError(
            f"backbone: mode {number}: nothing slips at any level, so that there is nothing to "
            "reduce; set up_to higher, or run 'full' alone"
        )
    frequency = curve.stuck_frequency
    if name == "condensed":
        basis = condensed_basis(system, highest=frequency)
        small = condensed_system(system, basis.V)
    else:
        stuck = stuck_modes(system, number + beside)[1]
        basis = stuck_basis(system, stuck, curve.states, curve.loops, modes, frequency)
        small = reduced_system(system, basis, **options.friction, periodic=False)
        warn += small.notes
    return basis.V, small


def _loads_end(scene: Scene, system: System) -> tuple[FloatArray, FloatArray]:
    """Displacement and velocity when the last load of a scene has ended."""
    step, n_steps = scene.time_step, scene.n_steps
    act = np.flatnonzero(system.load_amplitudes(step * np.arange(n_steps + 1.0)).any(axis=0))
    if act.size == 0 or act[-1] >= n_steps - 1:
        raise InputError(
            f"{scene.path}: backbone.released: found 'loads', which must be pulses that end before "
            "the run does; choose others, a longer duration, or 'mode'"
        )
    scheme = generalized_alpha(scene.time.rho_infinity)
    return integrate_plan(system, Plan(step, int(act[-1]) + 1, scheme)).finished().final
