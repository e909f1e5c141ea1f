"""Backbone curves of a scene's models, nonlinear modes beside them, and random vibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from skfem_joint.accuracy.halved_mesh import BEYOND
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError, JointError, refuse
from skfem_joint.ground.progress import Progress, announced, silent
from skfem_joint.harmonic.curve import NonlinearMode
from skfem_joint.harmonic.modes import nonlinear_modes
from skfem_joint.reduction.interface_modes import motions_without_slip
from skfem_joint.reduction.models import notes_of, reduced_for_mode
from skfem_joint.results.loss import over
from skfem_joint.results.normal_force import NormalChange, normal_change_of_mode
from skfem_joint.results.places import of_all, slips_of_all
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.scene import Scene
from skfem_joint.scene.tables import BackboneTable, NonlinearModesTable, RandomTable
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.study.models import (
    UNKNOWN_CHANGE,
    finer_system,
    largest_model,
    model_by,
    options_of,
    other_reference,
)
from skfem_joint.study.scene_range import model_in_range
from skfem_joint.system.system import System
from skfem_joint.vibration.amplitudes import Amplitudes
from skfem_joint.vibration.backbone import Backbone, backbone
from skfem_joint.vibration.mesh_of_curve import mesh_of_curve
from skfem_joint.vibration.random_response import RandomResponse, random_loads, random_response
from skfem_joint.vibration.ring_down import RingDown, ring_down

#: Displacement (m) and velocity (m/s), each of shape (n,), and friction as `integrate` takes it.
State = tuple[FloatArray, ...]
#: Relative error of a ring-down's damping from its time step beyond which a note says so.
DOUBTFUL_STEP = 0.02
#: Modes of a condensed model by parts beyond the highest of its curves.
MODES_BEYOND = 10


@dataclass(frozen=True)
class ModelBackbone:
    """Curves of one model of a scene.

    Attributes
    ----------
    name : str
        "full", "condensed" or "reduced".
    curves : list of Backbone
        Of each mode.
    ring_downs : list of RingDown
        Free vibration of each mode; empty if it was not asked for.
    errors : list of dict
        Of each curve the largest relative distances from the full model's, by name; of a structure
        in parts none are known.
    at : list of AtAmplitudes
        The same mode at the amplitudes that are asked for; empty if none are.
    systems : list of System
        Of each mode.
    """

    name: str
    curves: list[Backbone]
    ring_downs: list[RingDown]
    errors: list[dict[str, float]]
    at: list[AtAmplitudes] = field(default_factory=list)
    systems: list[System] = field(default_factory=list)


@dataclass(frozen=True)
class AtAmplitudes:
    """A mode at amplitudes that are asked for.

    Attributes
    ----------
    asked : Amplitudes
    curve : Backbone
        Its levels are those of the amplitudes.
    errors : dict of str to ndarray, shape (2, levels)
        Stated relative errors by source, as far as they are known: "mesh", "cycles", of their
        increments, and "model", the distance of a smaller model from the full one. They are for
        friction, pressure and damping as given. The first are of the loss factor, the others of the
        energy that friction takes, and of its part in the loss factor: the larger.
    merged : int
        Friction points of a smaller model that stand for the full one's; 0 if it has all of them.
    """

    asked: Amplitudes
    curve: Backbone
    errors: dict[str, FloatArray]
    merged: int = 0

    @property
    def total(self) -> FloatArray:
        """Sums of all known errors, (2, levels); nan where none is."""
        unknown, every = np.full((2, self.curve.level.size), np.nan), [*self.errors.values()]
        known = ([each[k] for each in every if np.isfinite(each[k]).all()] for k in (0, 1))
        return np.array([np.sum(x, axis=0) if x else unknown[0] for x in known])


@dataclass(frozen=True)
class SceneBackbone:
    """Curves of the modes that a scene asks for.

    Attributes
    ----------
    scene : Scene
    moved : list of ndarray, shape (N, dim)
        Of each mode the displacements of all nodes for a modal amplitude of 1 m kg^1/2, kg^(-1/2);
        empty where nodes are not known.
    models : list of ModelBackbone
    notes : tuple of str
        Of the structure, the full model's curves, and the smaller models.
    normal : dict of int to NormalChange
        Change of the normal force at the highest level of each mode; none where no contact is
        closed.
    mesh : dict of int to dict
        Errors of each mode's curves by the mesh, which are the same for all models; none where a
        finer mesh would cost much.
    shapes : tuple of str
        Sentence about each mode's direction and frequency with the joints stuck; none where nodes
        are not known.
    """

    scene: Scene
    moved: list[FloatArray]
    models: list[ModelBackbone]
    notes: tuple[str, ...]
    normal: dict[int, NormalChange]
    mesh: dict[int, dict[str, FloatArray]] = field(default_factory=dict)
    shapes: tuple[str, ...] = ()

    @property
    def largest(self) -> list[float]:
        """Of each mode the displacement of the node that it moves most, kg^(-1/2)."""
        return [float(np.linalg.norm(u, axis=1).max()) for u in self.moved]


def scene_backbone(
    scene: Scene, progress: Progress = silent, folder: Path | None = None
) -> SceneBackbone:
    """Frequency and damping over amplitude as a scene's table ``[backbone]`` asks for.

    The curves of the full model come first. A reduced model is made for each mode from the full
    model's states at the levels of its curve.

    Parameters
    ----------
    scene : Scene
    progress : callable, optional
        Called with (what is done, how much, of how much).
    folder : Path, optional
        Where a reduced model for a range is kept, and taken up again.

    Raises
    ------
    InputError, ConvergenceError
        As :func:`backbone` and :func:`ring_down`.
    """
    structure = scene.structure()
    system, full = full_backbones(scene, partial(progress, "full model"))
    warnings = [*system.notes, *other_reference(scene)]
    warnings += [warning for curve in full for warning in curve.notes]
    acts = structure.reactions(scene.loads())
    if acts is not None and scene.parts is not None:
        acts, warnings = None, [*warnings, UNKNOWN_CHANGE]
    normal = {}
    for c in full:
        moved = c.shape, c.stuck_frequency, float(c.amplitude[-1])
        change = normal_change_of_mode(structure, acts, *moved)
        if change is not None:
            normal[c.mode] = change
            warnings += change.doubts(f"Mode {c.mode}: at the highest level ")
    mesh, finer, why = _by_mesh(scene, system, full, partial(progress, "error of the mesh"))
    warnings += why
    full_at, why = _full_at(scene, system, full, finer, progress)
    warnings += why
    released = _released(scene, system)
    models, static = [], options_of(scene, "static")
    for name in scene.models.run:
        model = ModelBackbone(name, [], [], [])
        in_range = model_in_range(scene, folder) if name == "reduced" else None
        for curve in full:
            report = partial(progress, f"{name} model, mode {curve.mode}")
            small, own = system if scene.parts else in_range, curve
            if small is None:
                reduced = partial(reduced_for_mode, scene.system(), curve, static)
                small = model_by(name, scene, reduced, curve.stuck_frequency)
            if small is not system:
                own = _like(curve, scene, small, report)
                warnings += notes_of(small) if in_range is None else [_in_range(own)]
            if curve.mode in full_at:
                at = full_at[curve.mode]
                if small is not system:
                    at = _beside(_at(scene, small, own, at.asked, report), at)
                model.at.append(at)
            model.curves.append(own)
            model.systems.append(small)
            model.errors.append(_distances(own, curve) if scene.parts is None else {})
            if scene.backbone.ring_down:
                start = released if small is system else _released(scene, small)
                warnings += _rings_down(scene, model, own, start, progress)
        models.append(model)
    displaced, shapes = _shapes(scene, system, full)
    return SceneBackbone(scene, displaced, models, tuple(warnings), normal, mesh, shapes)


def _rings_down(
    scene: Scene,
    model: ModelBackbone,
    curve: Backbone | NonlinearMode,
    start: State | None,
    progress: Progress,
) -> tuple[str, ...]:
    """Notes of the free vibration of a model's next mode, which begins on a curve or in ``start``.

    It is added to the model, and compared with its slow curve.
    """
    given, k = "rho_infinity" in scene.time.model_fields_set, len(model.ring_downs)
    scheme = generalized_alpha(scene.time.rho_infinity) if given else None
    steps = scene.backbone.ring_down, scene.time.steps_per_cycle, scheme
    own, mode = model.curves[k], f"Mode {curve.mode}"
    report = partial(progress, f"{model.name} model, mode {curve.mode} rings down")
    rung = ring_down(model.systems[k], curve, *steps, start, report)
    model.ring_downs.append(rung)
    model.curves[k] = rung.beside(own)
    notes = model.curves[k].notes[len(own.notes) :]
    named = (note.replace(mode, f"{mode}, {model.name} model", 1) for note in notes)
    return *named, *_doubts(model, curve.mode)


def _full_at(
    scene: Scene,
    system: System,
    curves: Sequence[Backbone],
    finer: System | None,
    progress: Progress,
) -> tuple[dict[int, AtAmplitudes], list[str]]:
    """Full model's modes at the amplitudes that a scene asks for, and notes; none if it asks none.

    Their errors by the mesh are what a ``finer`` one changes at the same amplitudes.
    """
    found, notes, table = dict[int, AtAmplitudes](), list[str](), scene.backbone.at
    if table is None:
        return found, notes
    asked = Amplitudes(**table.model_dump(exclude_none=True))
    for curve in curves:
        mode, report = curve.mode, partial(progress, "full model, amplitudes")
        found[mode] = at = _at(scene, system, curve, asked, report)
        if finer is None:
            continue
        report = partial(progress, "error of the mesh, amplitudes")
        try:
            (other,) = backbone(finer, (mode,), asked, scene.backbone.up_to, progress=report)
        except JointError as error:
            notes.append(
                f"Mode {mode}: the errors by the mesh at given amplitudes are not estimated: "
                f"{error}"
            )
        else:
            errors = at.errors | {"mesh": BEYOND * _apart(other, at.curve)}
            found[mode] = replace(at, errors=errors)
    return found, notes


def _at(
    scene: Scene, system: System, curve: Backbone, asked: Amplitudes, report: Progress
) -> AtAmplitudes:
    """Mode of a model at amplitudes, with slips and works of the full model's points."""
    found = _like(curve, scene, system, report, asked)
    share = over(found.losses.friction, found.losses.lost)
    errors, source = {}, "cycles" if system.serves is None else "model"
    if found.work_error is not None and system.serves is None:
        errors[source] = np.array([share * found.work_error, found.work_error])
    elif "damping_ratio" in found.estimated:  # all of it by friction
        whole = np.full(found.level.size, found.estimated["damping_ratio"])
        errors[source] = np.array([whole, over(whole, share)])
    merged = 0 if system.contact.shares is None else system.contact.w.size
    return AtAmplitudes(asked, found, errors, merged)


def _apart(one: Backbone, other: Backbone) -> FloatArray:
    """Relative distances of loss factors and of friction's part in them, (2, levels)."""

    def distance(name: str) -> FloatArray:
        a, b = getattr(one.losses, name), getattr(other.losses, name)
        return np.where(a == b, 0.0, np.abs(over(a, b) - 1.0))

    friction = np.maximum(distance("friction"), distance("by_friction"))
    return np.array([distance("loss_factor"), friction])


def _beside(small: AtAmplitudes, full: AtAmplitudes) -> AtAmplitudes:
    """Smaller model's results with their distance from the full one's, and its other errors."""
    errors = full.errors | {"model": _apart(small.curve, full.curve)}
    return replace(small, curve=replace(small.curve, higher=full.curve.higher), errors=errors)


def _like(
    curve: Backbone,
    scene: Scene,
    model: System,
    report: Progress,
    levels: Amplitudes | FloatArray | int | None = None,
) -> Backbone:
    """Curve of a model at the levels of one of the full model, with all points of that model.

    At others, where they are given.
    """
    full, table = scene.system(), scene.backbone
    if levels is None:
        # Where the structure lifts off; a model for a range follows its own curve.
        ends = model.serves is None and curve.level.size < table.levels
        levels = curve.level if ends else table.levels
    (own,) = backbone(model, (curve.mode,), levels, table.up_to, curve.slips_at, report)
    if model is full:
        return own
    work, slip = of_all(model, own.friction_work), slips_of_all(model, own.slip)
    if model.origin is not None:
        slip = full.contact.slip_norm(own.states @ (full.contact.B @ model.origin.basis.V).T)
    share = full.slipping_share(full.contact.slid(work))
    return replace(own, slip=slip, friction_work=work, share=share)


def _by_mesh(
    scene: Scene, system: System, curves: Sequence[Backbone], report: Progress
) -> tuple[dict[int, dict[str, FloatArray]], System | None, list[str]]:
    """Errors of curves by the mesh, by mode, the finer system, and why they are not known.

    Nothing where a finer mesh would cost too much, as cycles do with contact that opens.
    """
    if system.contact.opens or not scene.accuracy.estimate:
        return {}, None, []
    try:
        finer = finer_system(scene, system)
        if finer is None:
            return {}, None, []
        return {c.mode: mesh_of_curve(c, finer, report) for c in curves}, finer, []
    except JointError as error:
        return {}, None, [f"The errors by the mesh are not estimated: {error}"]


@dataclass(frozen=True)
class SceneNonlinearModes:
    """Nonlinear modes that a scene asks for.

    Attributes
    ----------
    scene : Scene
    model : ModelBackbone
        Slow curves and ring-downs of the same model.
    curves : dict of int to NonlinearMode
        By number of the mode, with slips and works of the full model's points.
    failures : tuple of ConvergenceError
        Of modes that end before their last amplitude, or have no curve.
    notes : tuple of str
    """

    scene: Scene
    model: ModelBackbone
    curves: dict[int, NonlinearMode]
    failures: tuple[ConvergenceError, ...]
    notes: tuple[str, ...]


def backbone_table(scene: Scene) -> BackboneTable:
    """Table ``[backbone]`` of a scene.

    InputError if its structure has no such point or mode, or is to be released by loads that act
    until the end of the run.
    """
    table = named_backbone(scene)
    if table.ring_down and table.released == "loads":
        _last_loaded_step(scene)
    return table


def named_backbone(scene: Scene) -> BackboneTable:
    """Table ``[backbone]`` of a scene; InputError if its structure has no such point or mode."""
    table = scene.backbone
    _check_names(scene, "backbone", table.modes, "at.point", table.at.point if table.at else None)
    return table


def nonlinear_table(scene: Scene) -> NonlinearModesTable:
    """Table ``[nonlinear_modes]`` of a scene.

    InputError if there is none, or the structure has no such point or mode.
    """
    table: NonlinearModesTable = scene.asked("nonlinear_modes")
    _check_names(scene, "nonlinear_modes", table.modes, "at", table.at)
    return table


def _check_names(
    scene: Scene, table: str, modes: Sequence[int], key: str, point: str | None
) -> None:
    """Refuse a point, by its key of a table, and modes that the structure of a scene has not."""
    system, problems = scene.system(), []
    if point is not None and point not in system.points:
        problems.append(
            f"{table}.{key}: found {point!r}, must be one of {', '.join(system.points) or 'none'}; "
            "a load names another place or direction"
        )
    held = system.contact.B.shape[0] + system.contact.normal.gap.size  # at most
    if max(modes) > system.n - held:
        count = motions_without_slip(system.closed(), carrying=True).shape[1]
        problems += [
            f"{table}.modes: found mode {k}, there are {count} with the contact stuck"
            for k in modes
            if k > count
        ]
    refuse(f"{scene.path}: {problem}" for problem in problems)


def scene_nonlinear_modes(scene: Scene, progress: Progress = silent) -> SceneNonlinearModes:
    """Modes into gross slip as a scene's table ``[nonlinear_modes]`` asks for.

    Their models are those of :func:`scene_backbone`, of the levels of the table ``[backbone]``,
    whose curves stand beside them, with ring-downs that begin on the motion of the highest level.

    InputError and ConvergenceError as :func:`backbone` and :func:`nonlinear_modes`; modes that end
    early are among the results, if there are any.
    """
    table = nonlinear_table(scene)
    beside = {"modes": list(table.modes), "at": None, "ring_down": 0, "released": "mode"}
    one = {"run": [table.model]}
    slow = scene_backbone(
        scene.changed(backbone=beside, models=one, reduction={"range": None}), progress
    )
    (model,) = slow.models
    curves, failures, notes = {}, list[ConvergenceError](), [*slow.notes]
    rings = scene.backbone.ring_down > 0
    for number, system, own in zip(table.modes, model.systems, model.curves, strict=True):
        report = partial(progress, f"{model.name} model, nonlinear mode {number}")
        asked, judged = table.levels, table.confirm
        curve: NonlinearMode | None
        try:
            (curve,) = nonlinear_modes(
                system, (number,), amplitudes=asked, at=table.at, confirm=judged, progress=report
            )
        except ConvergenceError as error:
            failures.append(error)
            curve = error.run
        if rings:
            start, begun = _released(scene, system), own if curve is None else curve
            try:
                notes += _rings_down(scene, model, begun, start, progress)
            except ConvergenceError as error:
                rings = False
                notes.append(f"Mode {number}: no ring-downs stand beside from here on: {error}")
        if curve is None:
            continue
        work, slip = of_all(system, curve.friction_work), slips_of_all(system, curve.slip)
        curves[number] = replace(curve, slip=slip, friction_work=work)
        notes += curve.notes
    if not curves:
        raise failures[0]
    notes += [str(error) for error in failures]
    return SceneNonlinearModes(scene, model, curves, tuple(failures), tuple(notes))


def random_table(scene: Scene) -> RandomTable:
    """Table ``[random]`` of a scene.

    InputError if there is none, it does not fit the loads, or as `named_backbone`, of its modes.
    """
    table: RandomTable = scene.asked("random")
    named_backbone(scene)
    try:
        random_loads(scene.system(), table.given, table.load, table.unit)
    except InputError as error:
        raise InputError(
            [x.replace("random_response: ", f"{scene.path}: random.") for x in error.problems]
        ) from error
    return table


@dataclass(frozen=True)
class SceneRandom:
    """Response of a scene's full model to its random load.

    Attributes
    ----------
    scene : Scene
    found : RandomResponse
    curves : list of Backbone
        That it is made of, of the modes and levels of the scene's table ``[backbone]``.
    notes : tuple of str
    """

    scene: Scene
    found: RandomResponse
    curves: list[Backbone]
    notes: tuple[str, ...]


def scene_random(scene: Scene, progress: Progress = silent) -> SceneRandom:
    """Response of a scene's full model to its random load, as its table ``[random]`` asks for.

    InputError and ConvergenceError as :func:`backbone` and :func:`random_response`.
    """
    table = random_table(scene)
    system, curves = full_backbones(scene, partial(progress, "backbones"))
    with announced(progress, "random vibration"):
        found = random_response(
            system, curves, table.given, load=table.load, unit=table.unit, duration=table.duration
        )
    return SceneRandom(scene, found, curves, tuple(dict.fromkeys((*system.notes, *found.notes))))


def given_backbones(scene: Scene, progress: Progress = silent) -> list[Backbone]:
    """Full model's curves of a scene with a table ``[backbone]`` and friction; of others, none.

    InputError and ConvergenceError as :func:`backbone`.
    """
    if "backbone" not in scene.model_fields_set or not scene.system().contact.count:
        return []
    return full_backbones(scene, partial(progress, "backbone"))[1]


def full_backbones(scene: Scene, report: Progress) -> tuple[System, list[Backbone]]:
    """Full model, or of a structure in parts the condensed one, and its curves."""
    table = named_backbone(scene)
    system = largest_model(scene, max(table.modes) + MODES_BEYOND)
    return system, backbone(system, table.modes, table.levels, table.up_to, progress=report)


def _in_range(curve: Backbone) -> str:
    """Note of the errors of a curve of a model for a range."""
    shown = " and ".join(
        f"its {name.replace('_', ' ')} by {100.0 * error:.2g} %"
        for name, error in curve.estimated.items()
    )
    return (
        f"Mode {curve.mode}: the curve of the reduced model for the range errs by an estimated "
        f"share of its largest value: {shown}."
    )


def _doubts(model: ModelBackbone, mode: int) -> list[str]:
    """Sentences about the last ring-down of a model, and where its step is too long."""
    last = model.ring_downs[-1]
    notes = [f"Ring-down of the {model.name} model: {note}" for note in last.notes]
    error = last.step_error["damping_ratio"]
    if error > DOUBTFUL_STEP:
        notes.append(
            f"Mode {mode}: the damping of the {model.name} model's ring-down errs by an estimated "
            f"{100.0 * error:.2g} % from its time step: give more time.steps_per_cycle, and leave "
            "out time.rho_infinity or set it below 1."
        )
    return notes


def _distances(curve: Backbone, full: Backbone) -> dict[str, float]:
    """Largest relative distances of a curve from the full model's.

    Levels at which joints that stick damp nothing, and nothing else does, are left out.
    """
    distances = {}
    for name in ("frequency", "damping_ratio"):
        values, reference = getattr(curve, name), getattr(full, name)
        count = min(values.size, reference.size)  # one may end before the other
        apart = np.abs(over(values[:count], reference[:count]) - 1.0)
        distances[name] = float(np.fmax.reduce(apart, initial=0.0))
    return distances


def _shapes(
    scene: Scene, system: System, curves: list[Backbone]
) -> tuple[list[FloatArray], tuple[str, ...]]:
    """Displacements of the nodes in each mode, (N, dim), and a sentence about its direction."""
    body, shapes, said = scene.structure().body, [], []
    if body is None:
        return [], ()
    for curve in curves:
        moved = body.unpacked(system.expand(curve.shape))
        size, squares = np.linalg.norm(moved, axis=1), (moved**2).sum(axis=0)
        place = ", ".join(f"{x:.4g}" for x in body.positions[size.argmax()])
        shapes.append(moved)
        said.append(
            f"Mode {curve.mode} with the joints stuck: {curve.stuck_frequency:.6g} Hz, moves along "
            f"{'xyz'[squares.argmax()]} ({100.0 * squares.max() / squares.sum():.3g} % of its "
            f"squared displacement), most at ({place}) m."
        )
    return shapes, tuple(said)


def _released(scene: Scene, system: System) -> State | None:
    """State of a model when the last load of a scene has ended, if it rings down from there.

    A model for a range is released in its mode.
    """
    table = scene.backbone
    if not table.ring_down or table.released != "loads" or system.serves is not None:
        return None
    scheme = generalized_alpha(scene.time.rho_infinity)
    plan = Plan(scene.time_step, _last_loaded_step(scene) + 1, scheme)
    return integrate_plan(system, plan).finished().end


def _last_loaded_step(scene: Scene) -> int:
    """Last step at which a load acts; InputError if one acts until the end of the run."""
    step, n_steps = scene.time_step, scene.n_steps
    acting = scene.system().load_amplitudes(step * np.arange(n_steps + 1.0)).any(axis=0)
    steps = np.flatnonzero(acting)
    if steps.size == 0 or steps[-1] >= n_steps - 1:
        raise InputError(
            f"{scene.path}: backbone.released: found 'loads', which must be pulses that end before "
            "the run does; choose others, a longer duration, or 'mode'"
        )
    return int(steps[-1])
