"""An accuracy that is asked for: basis, friction points, law and time step chosen to meet it.

The reduced model is refined where its estimated error comes from, until the estimate is below what
is asked for: by the modes that it lacks, more friction points, a steeper law, half the time step.
The full model is run with the step that the reduced one needs, and again with a shorter one if its
own estimate says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, log2
from typing import Any

import numpy as np

from skfem_joint.analysis import estimate
from skfem_joint.analysis.asked import options_of, plan_of
from skfem_joint.analysis.estimate import Estimate
from skfem_joint.errors import ConvergenceError
from skfem_joint.progress import Progress, silent
from skfem_joint.reduction.basis import Basis, reduced_system
from skfem_joint.scene import Scene
from skfem_joint.scene.tables import AccuracyTable
from skfem_joint.stepping.resolution import longest_step
from skfem_joint.system import System

#: Rounds of refinement, vectors of a basis and halvings of the step that are tried.
ROUNDS, MOST_VECTORS, MOST_HALVINGS = 8, 100, 6
#: Share of the error of earlier rounds that two rounds must get below.
STALLED = 0.9
#: Share of the error asked for from which on its source is refined.
WORTHWHILE = 0.4


def excess(accuracy: AccuracyTable, found: Estimate, source: str = "total") -> float:
    """Largest of the errors from a source over what is asked for."""
    motion, energy = largest(found, source)
    asked = ((motion, accuracy.displacement), (energy, accuracy.energy))
    return max((error / most for error, most in asked if most is not None), default=0.0)


def largest(found: Estimate, source: str = "total") -> tuple[float, float]:
    """Largest errors from a source, of motion and of energy."""
    errors = {name: e for name, e in found.parts.get(source, {}).items() if e is not None}
    motion = max((e for name, e in errors.items() if "energy" not in name), default=0.0)
    return motion, max((e for name, e in errors.items() if "energy" in name), default=0.0)


def stated(found: Estimate) -> str:
    """What is estimated, in words."""
    motion, energy = largest(found)
    return f"{100 * motion:.2g} % in displacement and {100 * energy:.2g} % in energy"


def followed(scene: Scene) -> Scene:
    """Scene with a step that is not too long for its loads."""
    longest = longest_step(scene.system(), scene.n_steps * scene.time_step)
    ratio = scene.time_step / longest
    return scene.finer(2 ** ceil(log2(ratio) - 1e-9)) if ratio > 1.0 else scene


def stepped(scene: Scene, basis: Basis) -> Scene:
    """Scene with the step that a reduced model needs, where to look for it costs little.

    ConvergenceError as `shorter`, or if a step does not converge.
    """
    reduced = reduced_system(scene.system(), basis)
    for _ in range(ROUNDS):
        plan = plan_of(scene)
        run = estimate.verification_run(reduced, plan)
        finer = shorter(scene, estimate.of_full(reduced, run, plan))
        if finer is None:
            break
        scene = finer
    return scene


@dataclass(frozen=True)
class Met:
    """A reduced model that meets an accuracy, and the scene with the steps that it takes."""

    scene: Scene
    basis: Basis
    system: System
    estimate: Estimate


def meet(scene: Scene, basis: Basis, report: Progress = silent) -> Met:
    """Refine a reduced model until its estimated errors are below what the scene asks for.

    It starts with ``basis``; ``report`` is called with (rounds done, most rounds).
    ConvergenceError if the rounds, vectors or halvings at hand do not do.
    """
    system, accuracy, options = scene.system(), scene.accuracy, options_of(scene)
    points, beta, halvings = options.friction_points, options.beta, 0
    errors: list[float] = []
    for done in range(ROUNDS):
        report(done, ROUNDS)
        own: dict[str, Any] = {"friction_points": points, "beta": beta}
        reduced = reduced_system(system, basis, **own, periodic=scene.periodic)
        step, found = scene.time_step, estimate.of_reduced(system, basis, reduced, plan_of(scene))
        errors.append(excess(accuracy, found))
        if errors[-1] <= 1.0:
            return Met(scene, basis, reduced, found)
        sources = {s: excess(accuracy, found, s) for s in ("basis", "law", "points", "time_step")}
        if min(errors[-2:]) > STALLED * min(errors[:-2], default=np.inf):
            break
        least = min(WORTHWHILE, max(sources.values()))
        refined = {source for source, ratio in sources.items() if ratio >= least}
        if "basis" in refined and found.lacks is not None:
            basis = basis.enriched(system, found.lacks.V, found.lacks.velocities)
        if "points" in refined:
            points = 2 * reduced.w.size if 2 * reduced.w.size < system.contact_points else "all"
        if "law" in refined:
            beta = min(estimate.STEEPER * float(reduced.beta.max()), float(system.beta.max()))
        if "time_step" in refined:
            more = min(max(_halvings(sources["time_step"]), 1), 3)
            halvings, scene = halvings + more, scene.finer(2**more)
        if basis.V.shape[1] > MOST_VECTORS or halvings > MOST_HALVINGS:
            break
    worst = max(sources, key=lambda source: sources[source]).replace("_", " ")
    raise ConvergenceError(
        f"accuracy: a reduced model of {reduced.n} vectors and {reduced.w.size} friction points "
        f"with steps of {step:.4g} s still errs by an estimated {stated(found)}, most of it from "
        f"its {worst}. Ask for less, or run 'full' alone"
    )


def _halvings(ratio: float) -> int:
    """Halvings of the step for so much less error: it goes as the power 3/2 with friction."""
    return ceil(log2(max(1.1 * ratio, 1.0)) / 1.5)


def shorter(scene: Scene, found: Estimate) -> Scene | None:
    """Scene with steps short enough for the estimated error of a full model; None: they are.

    ConvergenceError if that would take steps so many times shorter that it will not do.
    """
    ratio = excess(scene.accuracy, found)
    if ratio <= 1.0:
        return None
    halvings = _halvings(ratio)
    if halvings > MOST_HALVINGS:
        raise ConvergenceError(
            f"accuracy: with steps of {scene.time_step:.4g} s the full model errs by an estimated "
            f"{stated(found)}: the steps asked for are far too long. Give more "
            "steps, or ask for less"
        )
    return scene.finer(2**halvings)
