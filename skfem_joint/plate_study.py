"""From a scene with plates to results: the full model, the reduced one, and how they compare."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skfem_joint.checkpoint import Checkpoint, Checkpoints, fingerprint
from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate
from skfem_joint.plate import PlateStructure, assemble_plate, build_plate_structure
from skfem_joint.plate_doubts import doubts
from skfem_joint.plate_reduction import (
    PlateBasis,
    active_area_fraction,
    own_basis,
    scaled_basis,
    with_friction_points,
)
from skfem_joint.recording import Run, Save
from skfem_joint.reference import paper_reference
from skfem_joint.results import (
    STUCK_VELOCITY,
    Model,
    Progress,
    Results,
    check_friction,
    finished,
    full_run,
    integrated,
    run_models,
    run_warnings,
    with_resolvable_beta,
)
from skfem_joint.scene import PlateScene
from skfem_joint.schemes import generalized_alpha
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: Cycles of the run that a reduced model's modes come from.
TRAINING_CYCLES = 3
#: Friction points of a reduced plate for each mode, by default.
POINTS_PER_MODE = 4
#: Share of a run that the modes made with it may miss without a word, and at all.
DOUBTFUL_BASIS, WRONG_BASIS = 0.1, 0.5
#: A joint slips as a whole when the least slip of its points exceeds this share of the largest.
GROSS_SLIP = 0.02


class PlateStudy(Results[PlateScene, PlateStructure]):
    """Results of a scene of plates."""


def plate_structure_of(scene: PlateScene) -> PlateStructure:
    """Structure that a scene describes."""
    with _mistakes_of(scene):
        return build_plate_structure(
            scene.plate,
            E=scene.material.E,
            poisson=scene.material.poisson,
            density=scene.material.density,
            thickness=scene.section.thickness,
            plane=scene.section.plane,
            supports=scene.support.named,
            joints=[joint.to_joint() for joint in scene.joint],
            stiffness_damping=scene.damping.stiffness,
            mass_damping=scene.damping.mass,
            regions=scene.overrides,
        )


def plate_system_of(scene: PlateScene, structure: PlateStructure) -> System:
    """Full system of a scene."""
    loads = [(item.on, item.direction, item.to_load()) for item in scene.load]
    with _mistakes_of(scene):
        return assemble_plate(structure, loads, scene.output_points)


@contextmanager
def _mistakes_of(scene: PlateScene) -> Iterator[None]:
    """Name the scene's file in what is found wrong with it."""
    try:
        yield
    except InputError as error:
        raise InputError([f"{scene.path}: {problem}" for problem in error.problems]) from error


def run_plate_scene(
    scene: PlateScene, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> PlateStudy:
    """Run the models that a scene of plates asks for; see `skfem_joint.study.run_scene`."""
    origin = _origin(scene) if checkpoints is not None else ""
    structure = plate_structure_of(scene)
    study = PlateStudy(scene, structure, plate_system_of(scene, structure))
    study.warnings += [*scene.plate.notes, *doubts(structure, study.system)]
    study.warnings += _unused(scene)
    makers = {"full": _full, "reduced": _reduced}
    return run_models(study, makers, progress, checkpoints, origin, _check)


def _origin(scene: PlateScene) -> str:
    """Fingerprint of a scene, its mesh and the tables of its loads."""
    plate = scene.plate
    return fingerprint(
        scene.model_dump(mode="json"),
        [item.to_load() for item in scene.load],
        [plate.mesh.p, plate.mesh.t, plate.order],
        [plate.regions, plate.boundaries, plate.points],
    )


def place_of(structure: PlateStructure, unknown: int) -> tuple[int, FloatArray]:
    """Displacement node that an unknown moves most, and its position, m."""
    column = structure.T[:, [unknown]].tocoo()
    node = int(column.coords[0][np.argmax(np.abs(column.data))]) // 2
    return node, np.asarray(structure.nodes[node])


def _full(
    study: PlateStudy, progress: Callable[[int, int], None], checkpoint: Checkpoint | None
) -> Model:
    def place(unknown: int) -> str:
        node, (x, y) = place_of(study.structure, unknown)
        return f"of node {node}, at ({x:.6g}, {y:.6g}) m"

    run = full_run(study, progress, checkpoint, place)
    return Model(
        "full",
        run,
        None,
        run.preparation_s,
        {},
        active_area_fraction=_active_area(study, run.slip_peak),
    )


def _active_area(study: PlateStudy, slip_peak: FloatArray) -> dict[str, float]:
    return active_area_fraction(study.structure, study.system, slip_peak, period_of(study.scene))


def period_of(scene: PlateScene) -> float:
    """Period of the load, or the length of the run where it has none, s."""
    return (scene.cycle_steps or scene.n_steps) * scene.time_step


def _unused(scene: PlateScene) -> list[str]:
    """Sentences about keys that do nothing in this scene."""
    if scene.reduction.reference == "paper" or "reduced" not in scene.models.run:
        return []
    if scene.reduction.active_length == "auto":
        return []
    return ["reduction.active_length has no effect beside reference = 'self'."]


def _reduced(
    study: PlateStudy, progress: Callable[[int, int], None], checkpoint: Checkpoint | None
) -> Model:
    begin = time.perf_counter()
    scene = study.scene
    options = scene.reduction
    check_friction(study.system)
    training = _training(study)
    basis = (_scaled if options.reference == "paper" else _own)(study, training)
    _check_basis(study, basis)
    if options.friction_points == "all":
        system = study.system.project(basis.V)
    else:
        asked = options.friction_points
        count = POINTS_PER_MODE * basis.V.shape[1] if isinstance(asked, str) else asked
        system = with_friction_points(study.system, basis, count)
        if not isinstance(asked, str) and system.w.size < asked:
            study.warnings.append(
                f"The reduced model has {system.w.size} friction points instead of {asked}: no "
                "more of the joints' points slip apart from each other."
            )
    system = with_resolvable_beta(study, system, basis.slip_velocity or STUCK_VELOCITY)
    before = time.perf_counter() - begin
    run = integrated(scene, system, progress, checkpoint)
    return Model(
        "reduced",
        run,
        basis.V,
        before + run.preparation_s,
        dict(basis.active_length),
        proper=basis.proper,
        # Beside a full model its own says more.
        active_area_fraction={}
        if "full" in study.models
        else _active_area(study, training.slip_peak),
    )


def _check_basis(study: PlateStudy, basis: PlateBasis) -> None:
    """See that the modes can follow the run that they were made with.

    Scaled modes are made for pulls along the axis of a joint; they cannot bend it.
    """
    share = 100 * min(basis.missed, 1.0)
    missed = f"{share:.2g} % of the full model's displacement (norm of strain energy)"
    if basis.missed > WRONG_BASIS:
        raise InputError(
            f"reduction: the {basis.V.shape[1]} vectors of its basis cannot follow {missed}; "
            "scaled modes hold for pulls along the axes of the joints: use reference = 'self', or "
            "more modes"
        )
    if basis.missed > DOUBTFUL_BASIS:
        study.warnings.append(
            f"The modes of the reduced model cannot follow {missed}; use more modes"
            + (', or reference = "self".' if study.scene.reduction.reference == "paper" else ".")
        )


def _training(study: PlateStudy) -> Run:
    """Run that a reduced model is made from; with Coulomb friction where lengths are measured."""
    scene = study.scene
    cycle = scene.cycle_steps
    steps = scene.n_steps if cycle is None else min(scene.n_steps, TRAINING_CYCLES * cycle)
    paper = scene.reduction.reference == "paper"
    training = finished(
        integrate(
            study.system.with_beta(np.inf) if paper else study.system,
            step=scene.time_step,
            n_steps=steps,
            scheme=generalized_alpha(scene.time.rho_infinity),
            save=Save(fields=True, points=False),
        )
    )
    if not (np.linalg.norm(training.u) > 0.0 and np.linalg.norm(training.v) > 0.0):
        raise InputError(
            "reduction: nothing moves in the run that the reduced model is made from, the "
            f"first {steps} steps; give a load that acts by then, or run 'full' alone"
        )
    return training


def _own(study: PlateStudy, training: Run) -> PlateBasis:
    """Proper orthogonal modes of the scene's own full model."""
    options = study.scene.reduction
    return own_basis(
        study.system,
        training,
        options.modes,
        snapshots=options.snapshots,
        inner_product=options.inner_product,
        interface_modes=0 if isinstance(options.interface_modes, str) else options.interface_modes,
    )


def _scaled(study: PlateStudy, probe: Run) -> PlateBasis:
    """Scaled modes of the paper's reference system, laid along the axes of the joints."""
    scene = study.scene
    options = scene.reduction
    asked = options.active_length
    lengths = asked if isinstance(asked, dict) else None
    if isinstance(asked, float):
        lengths = {joint.name: asked for joint in scene.joint}
    reference = paper_reference(snapshots=options.snapshots, inner_product="euclidean")
    most = reference.modes.shape[1]
    if options.modes > most:
        raise InputError(
            f"reduction.modes: found {options.modes}, must be <= {most}, the modes of the paper's "
            "reference system"
        )
    return scaled_basis(
        study.structure,
        study.system,
        reference,
        {joint.name: np.array(joint.axis) for joint in scene.joint if joint.axis is not None},
        probe,
        modes=options.modes,
        interface_modes=2 if isinstance(options.interface_modes, str) else options.interface_modes,
        lengths=lengths,
    )


def _check(study: PlateStudy, model: Model) -> None:
    """Say what assumption the results violate."""
    if model.basis is None:
        _warn_of_gross_slip(study, model.run)
    study.warnings += run_warnings(model)


def _warn_of_gross_slip(study: PlateStudy, run: Run) -> None:
    """Say so when a joint has no point left that sticks.

    Points near a support can move but little: their slip is compared with that of a plate strained
    evenly between the support and the point that moves most.
    """
    structure = study.structure
    for patch in structure.patches:
        peak = run.slip_peak[patch.points]
        if peak.size == 0 or peak.max() == 0.0:
            continue
        room = np.ones(peak.size)
        if patch.held_nodes.size:
            held = cKDTree(structure.nodes[patch.held_nodes])
            room = held.query(structure.nodes[patch.nodes])[0]
        least = (peak / room).min() / (peak.max() / room.max())
        # Under a regularised law all points creep a little while they stick.
        creep = study.scene.n_steps * study.scene.time_step / patch.joint.beta
        if least > GROSS_SLIP and peak.max() > 10.0 * creep:
            study.warnings.append(
                f"Every point of joint '{patch.joint.name}' slips, the least by "
                f"{peak.min():.3g} m: the paper's assumption of no gross slip is violated."
            )
