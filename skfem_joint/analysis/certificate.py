"""Estimated errors of a scene's results: time step, mesh, steepness of the law, number of modes.

Each source of error is looked at alone, by running the scene again with that one thing changed:

time step
    Steps halved twice. The observed order p (kept between 1/2 and 2, friction is not smooth)
    extrapolates the difference of the first two runs to the error of the first.
mesh
    Elements halved twice, likewise; full model only. In two and three dimensions they are halved
    once, and the error is taken to go with the size of the elements: another halving would cost
    sixteen times the first and more.
beta
    Against exact Coulomb friction: what the regularisation changes. Full model only, a reduced
    model chooses its beta below its truncation error.
modes
    j against j + 2 modes; no full model is run.
friction points
    The reduced model's few friction points against all contact nodes.

A *reference* is the discrete truth: the scene's own mesh and friction law, integrated by the full
model at small steps and extrapolated in the step. Its certificate tells how far that is from the
exact solution in time, on a fine mesh, and under Coulomb friction, each separately.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import log2
from typing import TYPE_CHECKING, Any

from skfem_joint.analysis.history import differences, energies, peaks
from skfem_joint.analysis.study import Progress, options_of, run_scene
from skfem_joint.arrays import FloatArray
from skfem_joint.errors import InputError
from skfem_joint.mesh import refined
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.stepping.resolution import longest_step
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.mesh import NamedMesh
    from skfem_joint.scene import Scene

#: Results that errors are estimated for.
QUANTITIES = ("displacement_rms", "peak_displacement", "friction_energy", "loop_energy")
#: Orders of convergence that an extrapolation may use.
ORDERS = (0.5, 2.0)
#: How often elements are halved, by the dimension of the mesh.
HALVINGS = {1: 2, 2: 1, 3: 1}
#: Intervals at whose ends runs are compared with a reference: of a cycle, or of a run without any.
PER_CYCLE, PER_RUN = 25, 100
#: Steps of an interval of a reference's finest run: no more, in a quick report, and no fewer.
FINEST, FINEST_QUICK, COARSEST = 2048, 256, 16


@dataclass(frozen=True)
class Estimate:
    """Estimated relative errors from one source.

    Attributes
    ----------
    source : str
        ``time step``, ``mesh``, ``beta``, ``modes`` or ``friction points``.
    errors : dict
        By quantity, see `QUANTITIES`; not negative. None: zero in the run that is certified, which
        says nothing of how large it is.
    order : float or None
        Observed order of convergence of the displacement history; None where nothing was halved
        twice. Outside `ORDERS` the extrapolation is not to be trusted beyond its size.
    """

    source: str
    errors: dict[str, float | None]
    order: float | None = None


@dataclass(frozen=True)
class Results:
    """What is compared: histories (rows, points) of the named points, and numbers, m and J.

    Peak and energies are those of the last cycle, or of the whole run without cycles.
    """

    points: tuple[str, ...]
    point_u: FloatArray
    peak_displacement: float
    friction_energy: float
    loop_energy: float


def results(run: Run) -> Results:
    """Results of a run, accumulated over every step."""
    peak = float(peaks(run).max(initial=0.0))
    return Results(run.system.points, run.point_u, peak, *energies(run))


def difference(one: Results, other: Results) -> dict[str, float | None]:
    """Differences of two results, relative to the first one's; see `QUANTITIES`."""
    rows = min(len(one.point_u), len(other.point_u))  # a duration may not be whole steps
    by_point = differences(one.points, one.point_u[:rows], other.point_u[:rows])
    found = {QUANTITIES[0]: max((rms for rms, _ in by_point.values()), default=None)}
    for name in QUANTITIES[1:]:
        value, changed = getattr(one, name), getattr(other, name)
        found[name] = abs(value - changed) / abs(value) if value != 0.0 else None
    return found


def extrapolated(first: float, second: float) -> tuple[float, float | None]:
    """Error of the coarsest of three results from their successive differences, and the order.

    The error is ``first / (1 - 2**-p)`` with the order p = log2(first / second) kept between
    `ORDERS`; the order is given as observed, None if there is none.
    """
    if first == 0.0 or second == 0.0:
        return first, None
    order = log2(first / second)
    return max(first, second) / (1.0 - 2.0 ** -_kept(order)), order


def _kept(order: float | None) -> float:
    return ORDERS[1] if order is None else min(max(order, ORDERS[0]), ORDERS[1])


def halved(source: str, runs: Sequence[Results]) -> Estimate:
    """Errors of the first of two or three runs, each with half the step or size of the one before.

    Of two runs, the error is taken to go with the first power.
    """
    first = difference(runs[0], runs[1])
    if len(runs) == 2:
        return Estimate(source, {k: None if e is None else 2.0 * e for k, e in first.items()})
    found: dict[str, tuple[float | None, float | None]] = {}
    for (name, a), b in zip(first.items(), difference(runs[1], runs[2]).values(), strict=True):
        found[name] = (None, None) if a is None or b is None else extrapolated(a, b)
    errors = {name: error for name, (error, _) in found.items()}
    return Estimate(source, errors, found[QUANTITIES[0]][1])


def variant(
    scene: Scene,
    model: str,
    *,
    halvings: int = 0,
    mesh: NamedMesh | None = None,
    **tables: dict[str, Any],
) -> Scene:
    """Scene of one model with one thing changed, storing the same times, points, nothing else.

    The time step is halved ``halvings`` times; ``tables`` hold keys that differ, as
    ``reduction={"modes": 7}``, those of ``joint`` in every one.
    """
    factor = 2**halvings
    time = {"steps_per_cycle": scene.time.steps_per_cycle * factor}
    if scene.time.cycles is None:
        time = {"step": scene.time_step / factor}
    output = {"vtk": False, "plots": False, "history": True, "points": scene.output_points}
    output["every"] = scene.output.every * factor
    return scene.changed(mesh=mesh, models={"run": (model,)}, time=time, output=output, **tables)


def run_alone(scene: Scene) -> Run:
    """Run of a scene with one model; half a run, which tells nothing, is a KeyboardInterrupt."""
    study = run_scene(scene)
    if study.interrupted:
        raise KeyboardInterrupt
    (model,) = study.models.values()
    return model.run


def _plan(scene: Scene, model: str) -> dict[str, list[Scene]]:
    """Scenes to compare the scene's own model with, by source of error."""
    plan = {"time step": [variant(scene, model, halvings=k) for k in (1, 2)]}
    if model == "full":
        meshes = [scene.named_mesh]
        for _ in range(HALVINGS[meshes[0].dim]):
            meshes.append(refined(meshes[-1]))
        plan["mesh"] = [variant(scene, model, mesh=mesh) for mesh in meshes[1:]]
        if any(joint.law == "arctan" for joint in scene.joint):
            plan["beta"] = [variant(scene, model, joint={"law": "coulomb"})]
        return plan
    more = {"modes": options_of(scene).mode_count + 2}
    plan["modes"] = [variant(scene, model, reduction=more)]
    if scene.reduction.friction_points != "all":
        plan["friction points"] = [variant(scene, model, reduction={"friction_points": "all"})]
    return plan


def certify(scene: Scene, model: str, progress: Progress | None = None) -> list[Estimate]:
    """Estimate the errors of one model of a scene, source by source.

    Parameters
    ----------
    scene : Scene
    model : {"full", "reduced"}
    progress : callable, optional
        Called with (label, runs done, runs in all).

    Raises
    ------
    InputError
        For a model that the scene does not run.
    ConvergenceError
        If a run does not converge.
    """
    return certified_runs(scene, model, progress)[0]


def certified_runs(
    scene: Scene, model: str, progress: Progress | None = None
) -> tuple[list[Estimate], dict[str, list[Results]]]:
    """As `certify`, with the results for each source, those that are certified first."""
    if model not in scene.models.run:
        raise InputError(f"certify: the scene does not run the {model} model")
    plan = _plan(scene, model)
    total = 1 + sum(len(scenes) for scenes in plan.values())
    done = 0

    def run(one: Scene) -> Results:
        nonlocal done
        if progress is not None:
            progress(f"certifying the {model} model", done, total)
        done += 1
        return results(run_alone(one))

    base = run(variant(scene, model))
    runs = {source: [base, *map(run, scenes)] for source, scenes in plan.items()}
    estimates = [
        halved(source, found)
        if source in ("time step", "mesh")
        else Estimate(source, difference(found[0], found[1]))
        for source, found in runs.items()
    ]
    return estimates, runs


@dataclass(frozen=True)
class Grid:
    """Times at which runs are compared with a reference: ends of intervals of a whole run.

    ``duration`` (s) is that of all runs, ``cycles`` are None without a common period of the loads,
    ``rho`` is the spectral radius of the scheme at infinite frequency.
    """

    duration: float
    cycles: int | None
    rho: float

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return PER_RUN if self.cycles is None else PER_CYCLE * self.cycles

    def integrate(self, system: System, parts: int, fields: int = 0) -> Run:
        """Run of ``parts`` steps an interval, all unknowns stored ``fields`` times in each.

        Half a run, which is worth nothing here, is a KeyboardInterrupt.
        """
        n_steps = parts * self.intervals
        run = integrate(
            system,
            step=self.duration / n_steps,
            n_steps=n_steps,
            scheme=generalized_alpha(self.rho),
            save=Save(every=parts, fields=fields > 0, fields_every=max(1, parts // max(fields, 1))),
            cycle_steps=None if self.cycles is None else parts * PER_CYCLE,
        )
        if run.interrupted:
            raise KeyboardInterrupt
        return run


@dataclass(frozen=True)
class Reference:
    """The discrete truth of a scene's full model, and its certificate.

    ``results`` are those of ``parts`` steps an interval, extrapolated with ``order``; ``estimates``
    are of a quarter of the steps; ``fine_mesh`` is on the finest mesh of the certificate.
    """

    system: System
    grid: Grid
    parts: int
    order: float
    results: Results
    fine_mesh: Results
    estimates: list[Estimate]


def make_reference(
    scene: Scene, quick: bool = False, bound: float = 60.0, progress: Progress | None = None
) -> Reference:
    """Reference of a scene with its certificate; its longest run takes about ``bound`` s or less.

    Raises
    ------
    InputError
        If the scene has no friction: there is nothing to choose between.
    ConvergenceError
        If a run does not converge.
    """
    system, time = scene.system(), scene.time
    if system.contact_points == 0:
        raise InputError(
            "error-time: nothing slips in this scene, every model is the same linear one; "
            "give it a joint with friction and pressure"
        )
    grid = Grid(scene.n_steps * scene.time_step, time.cycles, time.rho_infinity)
    parts, most = COARSEST, FINEST_QUICK if quick else FINEST
    longest = longest_step(system, grid.duration)
    while grid.duration > longest * (parts // 4) * grid.intervals:
        parts *= 2
    seconds_a_part = grid.integrate(system, parts // 2).wall_s / (parts // 2)
    while parts < most and 2 * parts * seconds_a_part <= bound:
        parts *= 2
    steps: dict[str, Any] = {"steps_per_cycle": parts // 4 * PER_CYCLE}
    if time.cycles is None:
        steps = {"step": grid.duration / (parts // 4 * grid.intervals)}
    coarse = scene.changed(time=steps, output={"every": parts // 4}, models={"run": ("full",)})
    estimates, runs = certified_runs(coarse, "full", progress)
    order = _kept(estimates[0].order)
    _, middle, finest = runs["time step"]

    def extrapolate(name: str) -> Any:
        fine = getattr(finest, name)
        return fine + (fine - getattr(middle, name)) / (2.0**order - 1.0)

    names = ("point_u", *QUANTITIES[1:])
    truth = replace(finest, **{name: extrapolate(name) for name in names})
    return Reference(system, grid, parts, order, truth, runs["mesh"][-1], estimates)
