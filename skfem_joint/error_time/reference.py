"""The solution that errors are measured against, and how well it is known.

The reference is the *discrete truth*: the scene's own mesh and friction law, integrated by the full
model at small steps and extrapolated in the step. Its certificate tells how far that is from the
exact solution in time, on a fine mesh, and under Coulomb friction, each separately.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint import friction
from skfem_joint.certificate import ORDERS, Estimate, certify
from skfem_joint.errors import InputError
from skfem_joint.history import AT_REST, peaks
from skfem_joint.integrate import integrate
from skfem_joint.meshing import BarMesh, build_bar, refined
from skfem_joint.recording import Run, Save
from skfem_joint.scene import Scene
from skfem_joint.schemes import generalized_alpha
from skfem_joint.structure import assemble
from skfem_joint.study import structure_of
from skfem_joint.system import System

FloatArray = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

#: Intervals at whose ends all runs are compared: per cycle, or of a run without cycles.
PER_CYCLE, PER_RUN = 25, 100
#: Samples of an interval from which energies of ready-made integrators are summed.
SAMPLES = 8
#: Steps of an interval of the reference; the certificate's own runs go to four times as many.
FINE, FINE_QUICK = 512, 64
#: Steps of an interval of a model's own reference, to tell its time-step error from the rest.
OWN = 256


@dataclass(frozen=True)
class Grid:
    """Times at which runs are compared.

    Attributes
    ----------
    duration : float
        s.
    cycles : int or None
        None without a common period of the loads.
    """

    duration: float
    cycles: int | None

    @property
    def intervals(self) -> int:
        """Number of intervals in all."""
        return PER_RUN if self.cycles is None else PER_CYCLE * self.cycles

    def integrate(self, system: System, parts: int, rho: float, fields: bool = False) -> Run:
        """Whole implicit run of ``parts`` steps an interval.

        Raises
        ------
        KeyboardInterrupt
            If it was interrupted: half a run is worth nothing here.
        """
        n_steps = parts * self.intervals
        run = integrate(
            system,
            step=self.duration / n_steps,
            n_steps=n_steps,
            scheme=generalized_alpha(rho),
            save=Save(every=parts, fields=fields, fields_every=max(parts // SAMPLES, 1)),
            cycle_steps=self.cycle_steps(parts),
        )
        if run.interrupted:
            raise KeyboardInterrupt
        return run

    def cycle_steps(self, parts: int) -> int | None:
        """Steps of a cycle at ``parts`` steps an interval."""
        return None if self.cycles is None else parts * PER_CYCLE

    def samples(self) -> FloatArray:
        """Times of the samples, s."""
        return np.linspace(0.0, self.duration, SAMPLES * self.intervals + 1)


def grid_of(scene: Scene) -> Grid:
    """Grid of a scene."""
    return Grid(scene.n_steps * scene.time_step, scene.time.cycles)


@dataclass(frozen=True)
class Results:
    """What is compared.

    Attributes
    ----------
    point_u : ndarray, shape (intervals + 1, points)
        Histories of the named points, m.
    peak, friction_energy, loop_energy : float
        Largest displacement (m), friction dissipation and work of the loads (J) of the last cycle,
        or of the whole run without cycles.
    """

    point_u: FloatArray
    peak: float
    friction_energy: float
    loop_energy: float


@dataclass(frozen=True)
class Distance:
    """Relative differences of results from a reference; the last three are signed.

    ``rms`` and ``largest`` are those of the named point that differs most.
    """

    rms: float
    largest: float
    peak: float
    friction_energy: float
    loop_energy: float


def results(run: Run) -> Results:
    """Results of a run of ours, accumulated over every step."""
    cycles = run.cycles
    whole = cycles.friction.size == 0
    return Results(
        run.point_u,
        float(peaks(run).max(initial=0.0)),
        float(run.friction_work.sum() if whole else cycles.friction[-1]),
        float(run.input_work.sum() if whole else cycles.input[-1].sum()),
    )


def sampled_results(system: System, grid: Grid, u: FloatArray, v: FloatArray) -> Results:
    """Results from samples of all unknowns, shape (samples, n), by the trapezoidal rule."""
    first = 0 if grid.cycles is None else (grid.cycles - 1) * PER_CYCLE * SAMPLES
    force = system.w * friction.force((system.B @ v[first:].T).T, system.beta)
    du = np.diff(u[first:], axis=0)
    load = system.load_amplitudes(grid.samples()[first:])
    work = system.load_vectors().T @ du.T
    point_u = np.asarray((system.P @ u.T).T)
    return Results(
        point_u[::SAMPLES],
        float(np.abs(point_u[first:]).max(initial=0.0)),
        float(np.sum(0.5 * (force[1:] + force[:-1]) * (system.B @ du.T).T)),
        float(np.sum(0.5 * (load[:, 1:] + load[:, :-1]) * work)),
    )


def displacement_rms(reference: FloatArray, other: FloatArray) -> float:
    """Relative root-mean-square difference of the named point that differs most."""
    return _history(reference, other)[0]


def _history(reference: FloatArray, other: FloatArray) -> tuple[float, float]:
    largest = np.abs(reference).max(axis=0, initial=0.0)
    moves = largest > AT_REST * largest.max(initial=0.0)
    difference = (other - reference)[:, moves]
    rms = np.linalg.norm(difference, axis=0) / np.linalg.norm(reference[:, moves], axis=0)
    most = np.abs(difference).max(axis=0, initial=0.0) / largest[moves]
    return float(rms.max(initial=0.0)), float(most.max(initial=0.0))


def distance(reference: Results, other: Results) -> Distance:
    """Distance of results from a reference."""

    def relative(name: str) -> float:
        value = getattr(reference, name)
        return float(getattr(other, name) / value - 1.0) if value != 0.0 else 0.0

    rms, largest = _history(reference.point_u, other.point_u)
    return Distance(
        rms, largest, relative("peak"), relative("friction_energy"), relative("loop_energy")
    )


@dataclass(frozen=True)
class Reference:
    """The discrete truth and its certificate.

    Attributes
    ----------
    grid : Grid
    system : System
        The scene's full model.
    results : Results
        Extrapolated in the step.
    sampled : Results
        Of the finest run, by the rule that serves ready-made integrators.
    velocity, displacement : float
        Largest of all unknowns, for absolute tolerances, m/s and m.
    fine_mesh : ndarray, shape (intervals + 1, points)
        Histories on a mesh of quarter elements with consistent friction forces, m.
    estimates : list of Estimate
        Errors of a run at ``parts`` steps an interval, by source.
    extrapolation : float
        Relative change of the histories from the finest run to the extrapolated one.
    order : float
        Order of convergence that extrapolated.
    parts : int
        Steps an interval; the finest run had twice as many.
    """

    grid: Grid
    system: System
    results: Results
    sampled: Results
    velocity: float
    displacement: float
    fine_mesh: FloatArray
    estimates: list[Estimate]
    extrapolation: float
    order: float
    parts: int


def variant(
    scene: Scene, *, bar: BarMesh | None = None, joint: dict[str, Any] | None = None, **tables: Any
) -> Scene:
    """Scene with keys of a joint, the mesh or whole tables changed."""
    joints = tuple(one.model_copy(update=joint or {}) for one in scene.joint)
    changed = scene.model_copy(update={"joint": joints, **tables})
    changed._bar, changed._path = bar or scene.bar, scene.path
    return changed


def full_system(scene: Scene) -> System:
    """Full model of a scene."""
    loads = [(item.on, item.to_load()) for item in scene.load]
    return assemble(structure_of(scene), loads, scene.output_points)


def coarsened(bar: BarMesh, elements: int) -> BarMesh:
    """Bar of about ``elements`` equal elements between the ends of its regions and its points."""
    s = bar.mesh.p[0]
    starts = np.concatenate([e[np.diff(e, prepend=-2) > 1] for e in bar.regions.values()])
    stops = np.concatenate([e[np.diff(e, append=s.size + 1) > 1] + 1 for e in bar.regions.values()])
    corners = np.unique([0, s.size - 1, *starts, *stops, *bar.points.values()])
    size = bar.length / elements
    lengths = np.diff(s[corners])
    counts = [max(1, round(length / size)) for length in lengths]
    at = {name: float(s[node] - s[0]) for name, node in bar.points.items()}
    parts = [
        (f"part {k}", float(length), count)
        for k, (length, count) in enumerate(zip(lengths, counts, strict=True))
    ]
    coarse = build_bar(parts, at)
    first = dict(zip(corners.tolist(), np.cumsum([0, *counts]).tolist(), strict=True))
    position = coarse.mesh.p[0] + s[0]
    regions = {}
    for name, owned in bar.regions.items():
        new = [
            np.arange(first[a], first[b])
            for a, b in zip(corners[:-1].tolist(), corners[1:].tolist(), strict=True)
            if a in owned
        ]
        regions[name] = np.concatenate(new)
    mesh = type(coarse.mesh)(position[np.newaxis], coarse.mesh.t)
    coordinates = np.stack([np.interp(position, s, x) for x in bar.coordinates.T], axis=1)
    return replace(coarse, mesh=mesh, coordinates=coordinates, regions=regions)


def _at(scene: Scene, grid: Grid, parts: int) -> Scene:
    """Scene with ``parts`` steps an interval that stores the ends of the intervals."""
    time: dict[str, Any] = (
        {"step": grid.duration / (parts * grid.intervals)}
        if grid.cycles is None
        else {"steps_per_cycle": parts * PER_CYCLE}
    )
    return variant(
        scene,
        time=scene.time.model_copy(update=time),
        output=scene.output.model_copy(update={"every": parts}),
        models=scene.models.model_copy(update={"run": ("full",)}),
    )


def make_reference(
    scene: Scene, quick: bool = False, progress: Progress | None = None
) -> Reference:
    """Reference of a scene with its certificate.

    Raises
    ------
    InputError
        If the scene has no friction: there is nothing to choose between.
    ConvergenceError
        If a run does not converge.
    """
    grid, system, rho = grid_of(scene), full_system(scene), scene.time.rho_infinity
    if system.contact_points == 0:
        raise InputError(
            "error-time: nothing slips in this scene, every model is the same linear one; "
            "give it a joint with friction and pressure"
        )
    parts = FINE_QUICK if quick else FINE
    estimates = certify(_at(scene, grid, parts), "full", progress)
    order = estimates[0].order
    order = ORDERS[1] if order is None else float(np.clip(order, *ORDERS))
    coarse = results(grid.integrate(system, parts, rho))
    finest_run = grid.integrate(system, 2 * parts, rho, fields=True)
    finest = results(finest_run)

    def extrapolate(name: str) -> Any:
        fine = getattr(finest, name)
        return fine + (fine - getattr(coarse, name)) / (2.0**order - 1.0)

    names = ("point_u", "peak", "friction_energy", "loop_energy")
    exact = Results(**{name: extrapolate(name) for name in names})
    fine_bar = refined(refined(scene.bar))
    consistent = full_system(variant(scene, bar=fine_bar, joint={"normal_force": "consistent"}))
    return Reference(
        grid=grid,
        system=system,
        results=exact,
        sampled=sampled_results(system, grid, finest_run.u, finest_run.v),
        velocity=float(np.abs(finest_run.v).max()),
        displacement=float(np.abs(finest_run.u).max()),
        fine_mesh=grid.integrate(consistent, FINE_QUICK, rho).point_u,
        estimates=estimates,
        extrapolation=displacement_rms(exact.point_u, finest.point_u),
        order=order,
        parts=parts,
    )
