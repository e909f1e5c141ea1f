"""From a scene to results: the full model, the reduced one, and how they compare."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias, overload

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.active_length import THRESHOLD, Estimate, measured
from skfem_joint.checkpoint import Checkpoint, Checkpoints, fingerprint
from skfem_joint.errors import InputError
from skfem_joint.hyper_reduction import with_friction_points
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic, Load, MultiHarmonic
from skfem_joint.plate_study import (
    PlateStudy,
    plate_structure_of,
    plate_system_of,
    run_plate_scene,
)
from skfem_joint.pod import ProperModes, orthonormal, proper_modes
from skfem_joint.recording import Run, Save
from skfem_joint.reduction import (
    ReferenceModes,
    Zone,
    active_zones,
    estimate_active_length,
    interface_modes_needed,
    snapshot_matrix,
    structure_basis,
)
from skfem_joint.reference import paper_reference
from skfem_joint.results import (
    STUCK_VELOCITY,
    Model,
    Progress,
    Results,
    ZoneLength,
    check_friction,
    finished,
    full_run,
    integrated,
    run_models,
    run_warnings,
    save_of,
    with_resolvable_beta,
)
from skfem_joint.scene import AnyScene, PlateScene, Scene
from skfem_joint.schemes import generalized_alpha
from skfem_joint.structure import Structure, assemble, build_structure
from skfem_joint.system import System

__all__ = ["AnyStudy", "Model", "PlateStudy", "Progress", "Study", "ZoneLength", "run_scene",
           "save_of", "structure_of"]  # fmt: skip

FloatArray = NDArray[np.float64]

#: A probe run takes at most so many cycles and steps a cycle.
PROBE_CYCLES, PROBE_STEPS = 4, 100
#: Friction points of an active stretch for each mode, by default: enough that the quadrature
#: changes less than the modes leave out, whatever the mesh.
POINTS_PER_MODE = 4
#: A joint slips as a whole when its least relative slip exceeds this share of its largest.
GROSS_SLIP = 0.02


class Study(Results[Scene, Structure]):
    """Results of a scene of struts."""


AnyStudy: TypeAlias = Study | PlateStudy


def structure_of(scene: Scene) -> Structure:
    """Structure that a scene describes."""
    return build_structure(
        scene.bar,
        E=scene.material.E,
        density=scene.material.density,
        width=scene.section.width,
        thickness=scene.section.thickness,
        fixed=scene.support.fixed,
        joints=[joint.to_joint() for joint in scene.joint],
        stiffness_damping=scene.damping.stiffness,
        mass_damping=scene.damping.mass,
        lumped_mass=scene.material.mass_matrix == "lumped",
        regions=scene.overrides,
    )


@overload
def run_scene(
    scene: Scene, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> Study: ...
@overload
def run_scene(
    scene: PlateScene, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> PlateStudy: ...
def run_scene(
    scene: AnyScene, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> AnyStudy:
    """Run the models that a scene asks for, and nothing else.

    Parameters
    ----------
    scene : Scene or PlateScene
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
    """
    if isinstance(scene, PlateScene):
        return run_plate_scene(scene, progress, checkpoints)
    origin = _origin(scene) if checkpoints is not None else ""
    structure = structure_of(scene)
    study = Study(scene, structure, _system_of(scene, structure))
    makers = {"full": _full, "reduced": _reduced}
    return run_models(study, makers, progress, checkpoints, origin, _check)


def _system_of(scene: Scene, structure: Structure) -> System:
    loads = [(item.on, item.to_load()) for item in scene.load]
    return assemble(structure, loads, scene.output_points)


def full_system(scene: AnyScene) -> System:
    """System of the full model that a scene describes."""
    if isinstance(scene, PlateScene):
        return plate_system_of(scene, plate_structure_of(scene))
    return _system_of(scene, structure_of(scene))


def _origin(scene: Scene) -> str:
    """Fingerprint of a scene, its mesh and the tables of its loads."""
    bar = scene.bar
    return fingerprint(
        scene.model_dump(mode="json"),
        [item.to_load() for item in scene.load],
        [bar.mesh.p, bar.coordinates, bar.regions, bar.points],
    )


def _full(
    study: Study, progress: Callable[[int, int], None], checkpoint: Checkpoint | None
) -> Model:
    structure = study.structure

    def place(unknown: int) -> str:
        node = int(structure.free[unknown])
        return f"node {node}, {structure.position[node]:.6g} m along the bar"

    run = full_run(study, progress, checkpoint, place)
    return Model("full", run, None, run.preparation_s, _measure(study, run))


def _contact_rows(study: Study, nodes: NDArray[np.intp]) -> NDArray[np.intp]:
    """Contact rows of nodes; -1 for nodes without contact."""
    rows = np.full(study.structure.n_nodes, -1)
    rows[study.structure.free[study.system.B.indices]] = np.arange(study.system.w.size)
    return rows[nodes]


def _measure(study: Study, run: Run) -> dict[str, float]:
    """Active length of each joint from the largest slips of a run, from the end that moves most."""
    lengths = {}
    for joint in study.structure.joints:
        nodes = study.structure.joint_nodes(joint)
        position = study.structure.position[nodes]
        peak = run.slip_peak[_contact_rows(study, nodes)]
        if peak[-1] > peak[0]:
            peak, position = peak[::-1], position[::-1]
        lengths[joint.region] = measured(np.abs(position - position[0]), peak)
    return lengths


def _reduced(
    study: Study, progress: Callable[[int, int], None], checkpoint: Checkpoint | None
) -> Model:
    begin = time.perf_counter()
    options = study.scene.reduction
    check_friction(study.system)
    maker = _basis_from_paper if options.reference == "paper" else _basis_from_itself
    reduction = maker(study)
    system = study.system.project(reduction.V)
    if options.friction_points != "all":
        asked = options.friction_points
        count = POINTS_PER_MODE * options.modes if isinstance(asked, str) else asked
        position = study.structure.position[study.structure.free[study.system.B.indices]]
        system = with_friction_points(system, position, reduction.stretches, count)
    system = with_resolvable_beta(study, system, reduction.slip_velocity)
    before = time.perf_counter() - begin
    run = integrated(study.scene, system, progress, checkpoint)
    return Model(
        "reduced",
        run,
        reduction.V,
        before + run.preparation_s,
        reduction.active_length,
        reduction.zones,
        reduction.proper,
        reduction.reference,
    )


@dataclass(frozen=True)
class _Reduction:
    """Basis of a reduced model and what else the way to it has shown.

    ``stretches`` holds the contact rows of each active stretch; ``slip_velocity`` the largest, m/s.
    """

    V: FloatArray
    slip_velocity: float
    stretches: list[NDArray[np.intp]]
    active_length: dict[str, float]
    proper: ProperModes
    zones: tuple[ZoneLength, ...] = ()
    reference: ReferenceModes | None = None


def _probe(study: Study, zones: list[Zone]) -> Run:
    """Quick run of the full model with exact Coulomb friction, which costs least.

    Its points are the mouths of the zones; the displacement beyond the active length is exactly
    zero, so that the length measured hardly depends on the threshold.
    """
    scene, system, structure = study.scene, study.system, study.structure
    unknown = np.searchsorted(structure.free, [zone.nodes[0] for zone in zones])
    P = np.zeros((len(zones), system.n))
    P[np.arange(len(zones)), unknown] = 1.0
    probe = replace(
        system.with_beta(np.inf),
        P=sparse.csr_array(P),
        points=tuple(f"mouth {k}" for k in range(len(zones))),
    )
    cycles = scene.time.cycles
    if cycles is None:
        return finished(integrate(probe, step=scene.time_step, n_steps=scene.n_steps))
    period = scene.time_step * scene.time.steps_per_cycle
    steps = min(scene.time.steps_per_cycle, PROBE_STEPS)
    n_steps = min(cycles, PROBE_CYCLES) * steps
    return finished(integrate(probe, step=period / steps, n_steps=n_steps))


def _basis_from_paper(study: Study) -> _Reduction:
    """Scaled modes of the paper's reference system, carried into the structure."""
    scene, structure, system = study.scene, study.structure, study.system
    options = scene.reduction
    zones = active_zones(structure, system)
    for zone in zones:
        if zone.tau == 0.0:
            raise InputError(
                f"joint {zone.name!r}: no friction acts in it, so that reference modes cannot be "
                'scaled to its active length; leave the joint out or use reference = "self"'
            )
    if not zones:
        raise InputError(
            "reduction: no force enters any joint, so that no active length can be found; "
            'use reference = "self"'
        )
    probe = _probe(study, zones)
    if "full" not in study.models:
        _warn_of_gross_slip(study, probe)
    if all(load.amplitude.peak_value == 0.0 for load in system.loads):
        raise InputError(
            "reduction: all loads are zero: nothing moves, so that no joint has an active length; "
            "give an amplitude, or run 'full' alone"
        )
    reference = paper_reference(snapshots=options.snapshots, inner_product=options.inner_product)
    most = reference.modes.shape[1]
    if options.modes > most:
        raise InputError(
            f"reduction.modes: found {options.modes}, must be <= {most}, the modes of the paper's "
            "reference system"
        )
    loads = [load.amplitude for load in system.loads]
    estimates = [_estimate(structure, system, zone, loads) for zone in zones]
    lengths = [
        _length(study, zone, guess, probe) for zone, guess in zip(zones, estimates, strict=True)
    ]
    _cap(study, zones, lengths)
    highest = max((f for load in loads if (f := load.highest_frequency)), default=None)
    interface = options.interface_modes
    V = structure_basis(
        structure,
        system,
        reference,
        zones,
        [length.length for length in lengths],
        modes=options.modes,
        interface_modes=interface_modes_needed(structure, system, highest)
        if isinstance(interface, str)
        else interface,
    )
    stretches = []
    active: dict[str, float] = {}
    for zone, found in zip(zones, lengths, strict=True):
        rows = _contact_rows(study, zone.nodes)
        stretches.append(rows[(rows >= 0) & (zone.distance < found.length)])
        active[zone.name] = active.get(zone.name, 0.0) + found.length
    # Where every mouth sticks throughout, any velocity will do.
    velocity = float(np.abs(probe.point_v).max()) or STUCK_VELOCITY
    return _Reduction(V, velocity, stretches, active, reference.proper, tuple(lengths), reference)


def _estimate(
    structure: Structure, system: System, zone: Zone, loads: list[Load]
) -> Estimate | None:
    """Active length by Eqs. (17)-(20), with the amplitudes of all harmonics superposed."""
    amplitudes = []
    frequency = 0.0
    for load in loads:
        if isinstance(load, MultiHarmonic):
            parts = load.components
        elif isinstance(load, Harmonic):
            parts = (load,)
        else:
            return None
        amplitudes.append(sum(abs(part.amplitude) for part in parts))
        frequency = max(frequency, *(part.frequency for part in parts))
    return estimate_active_length(structure, system, zone, amplitudes, frequency)


def _length(study: Study, zone: Zone, guess: Estimate | None, probe: Run) -> ZoneLength:
    asked = study.scene.reduction.active_length
    if isinstance(asked, dict) and zone.name in asked:
        return ZoneLength(zone.name, asked[zone.name], "given", guess)
    if isinstance(asked, float):
        return ZoneLength(zone.name, asked, "given", guess)
    if asked == "estimate":
        if guess is None:
            raise InputError(
                "reduction.active_length: 'estimate' needs harmonic loads; use 'auto' or a length"
            )
        if not guess.converged or guess.frequency_ratio > 0.5:
            study.warnings.append(
                f"The estimated active length of joint '{zone.name}' "
                + ("" if guess.converged else "did not settle and ")
                + f"is doubtful: the load has {guess.frequency_ratio:.2g} times the natural "
                "frequency, and Eq. (17) holds up to half of it. Use active_length = 'auto'."
            )
        return ZoneLength(zone.name, guess.length, "estimate", guess)
    rows = _contact_rows(study, zone.nodes)
    inside = rows >= 0
    found = measured(zone.distance[inside], probe.slip_peak[rows[inside]])
    return ZoneLength(zone.name, max(found, zone.distance[1]), "probe", guess)


def _cap(study: Study, zones: list[Zone], lengths: list[ZoneLength]) -> None:
    """Keep active lengths inside their joints, and those from both ends of one joint apart."""
    asked = list(lengths)
    for k, (zone, found) in enumerate(zip(zones, asked, strict=True)):
        both = [
            other.length
            for other_zone, other in zip(zones, asked, strict=True)
            if set(zone.nodes) == set(other_zone.nodes)
        ]
        share = found.length / sum(both)
        if found.length > share * zone.length:
            study.warnings.append(
                f"The active length of joint '{zone.name}' comes out as {found.length:.4g} m, more "
                f"than the joint has for it: capped at {share * zone.length:.4g} m. The joint may "
                "slip as a whole (gross slip), which the method assumes it does not."
            )
            lengths[k] = replace(found, length=share * zone.length)


def _basis_from_itself(study: Study) -> _Reduction:
    """Proper orthogonal modes of the scene's own full model."""
    scene, system = study.scene, study.system
    options = scene.reduction
    cycle = scene.cycle_steps
    steps = scene.n_steps if cycle is None else min(scene.n_steps, 3 * cycle)
    training = integrate(
        system,
        step=scene.time_step,
        n_steps=steps,
        scheme=generalized_alpha(scene.time.rho_infinity),
        save=Save(fields=True, points=False),
    )
    finished(training)
    if not (np.linalg.norm(training.u) > 0.0 and np.linalg.norm(training.v) > 0.0):
        raise InputError(
            'reduction.reference: nothing moves in the run that "self" takes its modes from, the '
            f"first {steps} steps; give a load that acts by then, or run 'full' alone"
        )
    mass = system.M.toarray() if options.inner_product == "mass" else None
    proper = proper_modes(snapshot_matrix(training.u, training.v, options.snapshots), mass)
    if options.modes > proper.modes.shape[1]:
        raise InputError(
            f"reduction.modes: found {options.modes}, must be <= {proper.modes.shape[1]}, "
            "the unknowns of the full model"
        )
    V = orthonormal(proper.modes[:, : options.modes], system.M)
    velocity = float(np.abs(system.B @ training.v.T).max()) or STUCK_VELOCITY
    stretches = []
    for joint in study.structure.joints:
        rows = _contact_rows(study, study.structure.joint_nodes(joint))
        peak = training.slip_peak[rows]
        moving = rows[peak > THRESHOLD * peak.max()]
        stretches += np.split(moving, np.flatnonzero(np.diff(moving) > 1) + 1)
    stretches = [rows for rows in stretches if np.any(system.w[rows] > 0.0)]
    return _Reduction(V, velocity, stretches, _measure(study, training), proper)


def _check(study: Study, model: Model) -> None:
    """Say what assumption the results violate."""
    if model.basis is None:
        _warn_of_gross_slip(study, model.run)
    study.warnings += run_warnings(model)


def _warn_of_gross_slip(study: Study, run: Run) -> None:
    """Say so when a joint has no point left that sticks.

    Points near a fixed end can move but little: their slip is compared with that of a bar strained
    evenly between the fixed end and the point that moves most.
    """
    structure = study.structure
    fixed = structure.position[structure.fixed_nodes]
    for joint in structure.joints:
        nodes = structure.joint_nodes(joint)
        held = np.intersect1d(structure.bar.region_nodes(joint.region), structure.fixed_nodes)
        peak = run.slip_peak[_contact_rows(study, nodes)]
        room = np.ones(nodes.size)
        if held.size:
            room = np.abs(structure.position[nodes][:, np.newaxis] - fixed).min(axis=1)
        least = (peak / room).min() / (peak.max() / room.max()) if peak.max() > 0.0 else 0.0
        # Under a regularised law all points creep a little while they stick.
        creep = study.scene.n_steps * study.scene.time_step / joint.beta
        if least > GROSS_SLIP and peak.max() > 10.0 * creep:
            study.warnings.append(
                f"Every point of joint '{joint.region}' slips, the least by {peak.min():.3g} m: "
                "the paper's assumption of no gross slip is violated."
            )
