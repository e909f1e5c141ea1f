"""Our own models over ranges of steps, and the paper's explicit Runge-Kutta."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.error_time.measure import Job, Outcome, What
from skfem_joint.error_time.reference import (
    OWN,
    Grid,
    Reference,
    coarsened,
    full_system,
    results,
    variant,
)
from skfem_joint.errors import InputError
from skfem_joint.explicit import runge_kutta, stable_step
from skfem_joint.recording import Save
from skfem_joint.scene import Scene
from skfem_joint.study import run_scene
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

FULL, STEEPNESS, COULOMB = "full", "full, other beta", "full, Coulomb"
COARSE, POD, GAUSS = "coarse mesh", "POD, all nodes", "POD, Gauss points"
EXPLICIT = "Runge-Kutta"

#: Share of the stable step that the explicit runs take.
SAFETY = 0.95
#: Steps of a short piece of an explicit run, and of one that shows its memory.
PIECE, SHORT_PIECE = 400, 20


@dataclass(frozen=True)
class Range:
    """What is run.

    Attributes
    ----------
    parts : tuple of int
        Steps of an interval of the comparison (25 of them make a cycle), full models.
    factors : tuple of float
        Other steepnesses, times the scene's beta.
    meshes : tuple of int
        Elements of coarse meshes.
    modes : tuple of int
        Modes of reduced models, at ``usual`` steps an interval.
    swept : tuple of int
        Modes of those that are run at ``reduced_parts`` steps an interval.
    counts : tuple of int
        Gauss points, besides the automatic number, with the first of ``swept``.
    longest_explicit : float
        Explicit runs up to so many seconds are done whole.
    """

    parts: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64)
    factors: tuple[float, ...] = (0.01, 0.1, 10.0, 100.0)
    meshes: tuple[int, ...] = (10, 20, 50, 100)
    modes: tuple[int, ...] = tuple(range(1, 16))
    swept: tuple[int, ...] = (5, 9)
    reduced_parts: tuple[int, ...] = (1, 2, 4, 8, 16)
    usual: int = 4
    counts: tuple[int, ...] = (5, 6, 8, 10, 16)
    longest_explicit: float = 5.0


#: For a look in seconds.
QUICK = Range(
    parts=(1, 4, 16),
    factors=(10.0,),
    meshes=(10, 50),
    modes=(2, 5),
    swept=(5,),
    reduced_parts=(2, 4),
    counts=(6,),
    longest_explicit=0.3,
)


def _implicit(system: System, grid: Grid, parts: int, rho: float) -> Outcome:
    begin = time.perf_counter()
    run = grid.integrate(system, parts, rho)
    elapsed = time.perf_counter() - begin
    counters = run.counters
    return Outcome(
        results(run),
        elapsed - run.preparation_s,
        counters.steps,
        counters.newton_iterations,
        counters.friction_evaluations,
        offline_s=run.preparation_s,
    )


def _jobs(
    system: System, grid: Grid, rho: float, parts: Sequence[int], what: What, **options: Any
) -> Iterator[Job]:
    for count in parts:
        step = grid.duration / (count * grid.intervals)
        yield Job(replace(what, step=step), partial(_implicit, system, grid, count, rho), **options)


def _scheme(rho: float) -> str:
    return "average acceleration" if rho == 1.0 else f"generalised-alpha, {rho:g}"


def _steepness(system: System) -> float:
    return float(system.beta[system.w > 0.0].max())


def full_jobs(scene: Scene, reference: Reference, wanted: Range) -> Iterator[Job]:
    """Full models: the scene's law, other laws, and coarse meshes with consistent forces."""
    grid, rho, system = reference.grid, scene.time.rho_infinity, reference.system
    beta = _steepness(system)
    elements = int(scene.bar.mesh.t.shape[1])
    law = COULOMB if np.isinf(beta) else FULL
    plan: list[tuple[str, str, System, FloatArray | None, int]] = [
        (law, "full", system, reference.results.point_u, elements)
    ]
    if law == FULL:
        plan += [
            (STEEPNESS, "full", replace(system, beta=f * system.beta), None, elements)
            for f in wanted.factors
        ]
        plan.append((COULOMB, "full", system.with_beta(np.inf), None, elements))
    for count in wanted.meshes:
        if count > elements:
            continue
        bar = coarsened(scene.bar, count) if count < elements else scene.bar
        coarse = full_system(variant(scene, bar=bar, joint={"normal_force": "consistent"}))
        size = int(bar.mesh.t.shape[1])
        plan.append((COARSE, "full, consistent forces", coarse, None, size))
    for family, model, one, own, size in plan:
        if own is None:
            own = grid.integrate(one, OWN, rho).point_u
        what = What(family, model, _scheme(rho), size, None, one.contact_points, _steepness(one))
        yield from _jobs(one, grid, rho, wanted.parts, what, own=own)


def _reduced(
    scene: Scene, modes: int, points: str | int, **options: Any
) -> tuple[System, float] | None:
    """Reduced system of a scene and its off-line time; None where so many modes do not exist."""
    changed = variant(
        scene,
        models=scene.models.model_copy(update={"run": ("reduced",)}),
        reduction=scene.reduction.model_copy(
            update={"modes": modes, "friction_points": points, **options}
        ),
        output=scene.output.model_copy(update={"vtk": False, "plots": False}),
    )
    try:
        study = run_scene(changed)
    except InputError:
        if modes > reduced_limit(scene):
            return None
        raise
    if study.interrupted:
        raise KeyboardInterrupt
    model = study.models["reduced"]
    return model.run.system, model.offline_s - model.run.preparation_s


def reduced_limit(scene: Scene) -> int:
    """Modes beyond which a small mesh may not have any more independent ones."""
    return int(scene.bar.mesh.t.shape[1]) // 2


def reduced_jobs(scene: Scene, reference: Reference, wanted: Range) -> Iterator[Job]:
    """Reduced models: friction at all nodes, and at Gauss points of the active length.

    The swept numbers of modes are also taken from snapshots of velocity and acceleration.
    """
    grid, rho = reference.grid, scene.time.rho_infinity
    plan: list[tuple[int, str | int, tuple[int, ...]]] = []
    rates: list[tuple[int, str | int, tuple[int, ...]]] = []
    for modes in wanted.modes:
        parts = wanted.reduced_parts if modes in wanted.swept else (wanted.usual,)
        plan += [(modes, "all", parts), (modes, "auto", parts)]
    plan += [(wanted.swept[0], count, wanted.reduced_parts) for count in wanted.counts]
    for modes in wanted.swept:
        rates += [(modes, points, wanted.reduced_parts) for points in ("auto", 6 * modes)]
    for k, (modes, points, parts) in enumerate(plan + rates):
        by_rates = k >= len(plan)
        made = _reduced(scene, modes, points, **({"snapshots": "rates"} if by_rates else {}))
        if made is None:
            continue
        system, offline = made
        family = POD if points == "all" else GAUSS
        what = What(
            family,
            "reduced, rates" if by_rates else "reduced",
            _scheme(rho),
            int(scene.bar.mesh.t.shape[1]),
            system.n,
            system.contact_points,
            _steepness(system),
        )
        yield from _jobs(system, grid, rho, parts, what, offline_s=offline)


def explicit_jobs(scene: Scene, reference: Reference, wanted: Range) -> Iterator[Job]:
    """The paper's way: the classical Runge-Kutta method at its stable step."""
    grid, system = reference.grid, reference.system
    elements = int(scene.bar.mesh.t.shape[1])
    models: list[tuple[str, System, float, int | None]] = []
    if not np.isinf(_steepness(system)):
        models.append(("full", system, 0.0, None))
    made = _reduced(scene, wanted.swept[0], "all")
    if made is not None:
        models.append(("reduced", made[0], made[1], made[0].n))
        steep = _steepness(system)
        if np.isfinite(steep):
            models.append(("reduced", made[0].with_beta(steep), made[1], made[0].n))
    for model, one, offline, modes in models:
        begin = time.perf_counter()
        parts = int(np.ceil(grid.duration / (SAFETY * stable_step(one)) / grid.intervals))
        offline += time.perf_counter() - begin
        step = grid.duration / (parts * grid.intervals)
        what = What(
            EXPLICIT,
            model,
            "Runge-Kutta 4",
            elements,
            modes,
            one.contact_points,
            _steepness(one),
            step,
        )
        yield Job(
            what,
            partial(_explicit, one, grid, parts, wanted.longest_explicit),
            offline,
            piece=partial(runge_kutta, one, step=step, n_steps=SHORT_PIECE, check=False),
        )


def _explicit(system: System, grid: Grid, parts: int, longest: float) -> Outcome:
    """Explicit run, whole if it is short enough, else a piece of it."""
    n_steps = parts * grid.intervals
    step = grid.duration / n_steps
    begin = time.perf_counter()
    piece = min(PIECE, n_steps)
    runge_kutta(system, step=step, n_steps=piece, save=Save(points=False), check=False)
    wall = (time.perf_counter() - begin) * n_steps / piece
    if wall > longest:
        return Outcome(None, wall, n_steps, evaluations=4 * n_steps, status="extrapolated")
    begin = time.perf_counter()
    run = runge_kutta(
        system,
        step=step,
        n_steps=n_steps,
        save=Save(every=parts),
        cycle_steps=grid.cycle_steps(parts),
        check=False,
    )
    wall = time.perf_counter() - begin
    return Outcome(results(run), wall, n_steps, evaluations=run.counters.friction_evaluations)
