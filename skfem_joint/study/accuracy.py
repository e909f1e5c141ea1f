"""Steps and a reduced model for an accuracy that is asked for.

The reduced model is refined where its estimated error comes from, until the estimate is below what
is asked for: by the modes that it misses, more friction points, a steeper law, half the time step.
The full model is run with the step that the reduced one needs, and again with a shorter one if its
own estimate says so. With contact that opens the modes that a reduced model misses are not known:
it is made anew with twice as many; full and condensed models find their steps by themselves.

A scene that is a point of its range takes the model for the range, if that is good enough.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, log2
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.accuracy import range_modes, run_estimate, rungs
from skfem_joint.accuracy.condensed_reference import CondensedReference
from skfem_joint.accuracy.estimate import Estimate, verification_run
from skfem_joint.ground.errors import ConvergenceError, JointError
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.reduction.models import reduced_on
from skfem_joint.reduction.ranges.points import check_short_of_gross_slip
from skfem_joint.runs.resolution import longest_step
from skfem_joint.scene import Scene
from skfem_joint.scene.tables import AccuracyTable
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.recording import Run
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.study.models import model_of, options_of, plan_of
from skfem_joint.study.scene_range import ServedScene, point_of, range_model
from skfem_joint.system.served import Served
from skfem_joint.system.system import System

#: Rounds of refinement, vectors of a basis, and halvings of the step that are tried.
ROUNDS = 8
MOST_VECTORS = 200
MOST_HALVINGS = 6
#: A source is refined from this share of the error asked for on.
WORTHWHILE = 0.4


@dataclass(frozen=True)
class Choice:
    """What is run of a scene, so that the accuracy that it asks for is met.

    Attributes
    ----------
    scene : Scene
        Scene with the time steps that are taken at first.
    model : System, optional
        Reduced model that meets the accuracy, the point that the scene is of one for a range, or
        the condensed one of a structure in parts; None where neither is asked for.
    estimate : Estimate, optional
        Its estimated errors, where an accuracy is asked for.
    notes : tuple of str
        What to beware of.
    seconds, compilation_s : float
        Time that the choice took, and time of compilation in it, s.
    path : QuasiStatic, optional
        A quasi-static path of the system, whose factors a reduced model to be made uses.
    """

    scene: Scene
    model: System | None = None
    estimate: Estimate | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    compilation_s: float = 0.0
    path: QuasiStatic | None = None


def choose(scene: Scene, path: QuasiStatic | None = None, progress: Progress = silent) -> Choice:
    """Choose time steps, and a reduced model where one is run, for the accuracy asked for.

    Without a reduced model only steps that are too long for the loads are changed. Where no
    accuracy is asked for, the scene is taken as it is. ``path`` is a quasi-static path of the
    system, whose factors are used.

    Raises
    ------
    ConvergenceError
        If the rounds, vectors or halvings at hand do not do.
    InputError
        If the reduction does not fit the scene.
    """
    reduces, watch = "reduced" in scene.models.run, Stopwatch()
    if not scene.accuracy.is_given:
        return Choice(scene, path=path if reduces else None)
    scene = resolved(scene, scene.system())
    if not reduces:
        return Choice(scene)
    options = options_of(scene)

    def made(modes: int | None = None) -> System:
        chosen = options if modes is None else replace(options, modes=modes)
        return model_of("reduced", scene, chosen, path, enriched=modes is None)

    first = made()
    report = partial(progress, "choosing a reduced model")
    scene, model, errors = _accurate_model(scene, first, report, made)
    # What a basis misses before it is enriched is of no concern.
    basis, contact = first.origin.basis, model.contact
    notes = basis.notes if model.origin.basis is basis else ()
    said = (
        f"For the accuracy asked for the reduced model has {model.n} vectors, "
        f"{contact.w.size} friction points, beta = {contact.steepest:.3g} s/m and "
        f"steps of {scene.time_step:.4g} s; it errs by an estimated {stated(errors)}."
    )
    return Choice(scene, model, errors, (*notes, said), *watch.read())


def excess(accuracy: AccuracyTable, errors: Estimate, source: str = "total") -> float:
    """Largest of the errors from a source over what is asked for."""
    motion, energy = largest(errors, source)
    asked = ((motion, accuracy.displacement), (energy, accuracy.energy))
    return max((error / most for error, most in asked if most is not None), default=0.0)


def largest(errors: Estimate, source: str = "total") -> tuple[float, float]:
    """Largest errors from a source, of motion and of energy."""
    known = {name: e for name, e in errors.parts.get(source, {}).items() if e is not None}
    motion = max((e for name, e in known.items() if "energy" not in name), default=0.0)
    return motion, max((e for name, e in known.items() if "energy" in name), default=0.0)


def stated(errors: Estimate) -> str:
    """Largest estimated errors, in words."""
    motion, energy = largest(errors)
    mesh = ", that of the mesh not counted" * errors.lacks_mesh
    return f"{100 * motion:.2g} % in displacement and {100 * energy:.2g} % in energy{mesh}"


def resolved(scene: Scene, system: System) -> Scene:
    """Scene with a step that is not too long for its loads."""
    vibrates = not scene.time.quasi_static
    longest = longest_step(system, scene.n_steps * scene.time_step, vibrates)
    ratio = scene.time_step / longest
    return scene.finer(2 ** ceil(log2(ratio) - 1e-9)) if ratio > 1.0 else scene


def _accurate_model(
    scene: Scene, small: System, report: Progress, remade: Callable[[int], System]
) -> tuple[Scene, System, Estimate]:
    """Refine a reduced model until its estimated errors are below what the scene asks for.

    Returned are the scene with the steps that it takes, the model, and its errors.

    It starts with ``small``; ``report`` is called with (rounds done, most rounds). ``remade`` makes
    a model of some number of joint modes anew, where it is not known which ones are missing.

    Raises
    ------
    ConvergenceError
        If the rounds, vectors or halvings at hand do not do.
    """
    system, accuracy, options = scene.system(), scene.accuracy, options_of(scene)
    points, beta, halvings = options.friction_points, options.beta, 0
    basis = small.origin.basis
    reference = CondensedReference.of(system, shared=True)
    errors: list[float] = []
    for done in range(ROUNDS):
        report(done, ROUNDS)
        own: dict[str, Any] = {"friction_points": points, "beta": beta}
        if done:
            small = reduced_on(system, basis, **own)
        step, plan = scene.time_step, plan_of(scene)
        stands = rungs.of_reduced(verification_run(small, plan), plan, reference=reference)
        errors.append(excess(accuracy, stands))
        if errors[-1] <= 1.0:
            return scene, small, stands
        sources = {s: excess(accuracy, stands, s) for s in ("basis", "law", "points", "time_step")}
        # The search ends where two rounds leave more than this share of the error of earlier
        # ones, unless shorter steps are what is left to try: their errors may rise at first.
        stalls = min(errors[-2:]) > 0.9 * min(errors[:-2], default=np.inf)
        if stalls and max(sources.values()) > sources["time_step"]:
            break
        least = min(WORTHWHILE, max(sources.values()))
        refined = {source for source, ratio in sources.items() if ratio >= least}
        if "basis" in refined and stands.missing is not None:
            if basis.V.shape[1] >= MOST_VECTORS:
                break
            V, velocities = stands.missing.V, stands.missing.velocities
            most = slice(MOST_VECTORS)  # the most important ones stand first
            basis = basis.enriched(system, V[:, most], velocities[:, most])
        elif "basis" in refined:
            if 2 * basis.modes > MOST_VECTORS:
                break
            basis = remade(2 * basis.modes).origin.basis
        if "points" in refined:
            points = 2 * small.contact.w.size
            points = points if points < system.contact.count else "all"
        if "law" in refined:
            beta = min(rungs.STEEPER * small.contact.steepest, system.contact.steepest)
        if "time_step" in refined:
            more = min(max(_halvings(sources["time_step"]), 1), 3)
            halvings, scene = halvings + more, scene.finer(2**more)
        if halvings > MOST_HALVINGS:
            break
    worst = max(sources, key=lambda source: sources[source]).replace("_", " ")
    raise ConvergenceError(
        f"accuracy: a reduced model of {small.n} vectors and {small.contact.w.size} friction "
        f"points with steps of {step:.4g} s still errs by an estimated {stated(stands)}, most of "
        f"it from its {worst}. Ask for less, or run 'full' alone"
    )


def _halvings(ratio: float) -> int:
    """Halvings of the step for so much less error: it goes as the power 3/2 with friction."""
    return ceil(log2(max(1.1 * ratio, 1.0)) / 1.5)


def shortened_steps(
    scene: Scene, integrate: Callable[..., Run]
) -> tuple[Scene, Run, Estimate | None]:
    """Run a full or condensed model with steps that meet the accuracy asked for.

    Parameters
    ----------
    scene : Scene
        Its steps are tried first; they are taken as they are where no accuracy is asked for.
    integrate : callable
        Runs the model by a plan, as `integrate_plan`. What it saved is not taken up again with
        another step.

    Returns
    -------
    tuple
        Scene with the steps taken, the run, and its estimated errors where an accuracy is asked
        for and the run was not interrupted.

    Raises
    ------
    ConvergenceError
        If no step that is tried meets the accuracy, or it would have to be so many times shorter
        that it will not do.
    """
    run = integrate(plan_of(scene))
    for _ in range(ROUNDS):
        if run.interrupted or not scene.accuracy.is_given:
            return scene, run, None
        errors = run_estimate.of_run(run, plan_of(scene))
        ratio = excess(scene.accuracy, errors)
        if ratio <= 1.0:
            return scene, run, errors
        if excess(scene.accuracy, errors, "basis") > 1.0:
            raise ConvergenceError(
                f"accuracy: the model errs by an estimated {stated(errors)}, and what its modes "
                "miss is more than what is asked for, however short the steps. Run 'full', or ask "
                "for less"
            )
        halvings = _halvings(ratio)
        if halvings > MOST_HALVINGS:
            raise ConvergenceError(
                f"accuracy: steps of {scene.time_step:.4g} s err by an estimated {stated(errors)}: "
                "the steps asked for are far too long. Give more steps, or ask for less"
            )
        scene = scene.finer(2**halvings)
        run = integrate(plan_of(scene), checkpoint=None)
    raise ConvergenceError(
        f"accuracy: no step that the model meets it with was found; {scene.time_step:.4g} s does "
        "not do. Ask for less"
    )


def choose_in_range(
    scene: Scene, served: ServedScene, folder: Path | None, progress: Progress = silent
) -> Choice:
    """Take the point that a scene is of the model for its range, if that serves it.

    The model is loaded from the folder, or made and saved there. A run of the point shows whether a
    joint slips as a whole. Where the scene asks for an accuracy, the time steps are chosen by the
    point's estimated errors.

    Returns
    -------
    Choice
        Without ``model`` where the model does not serve the scene: its notes say why, and that
        the scene needs a reduced model of its own.

    Raises
    ------
    InputError, ConvergenceError
        If the model for the range cannot be made or loaded.
    """
    watch, known = Stopwatch(), None
    progress("model for the range", 0, 1)
    model = range_model(served, folder)
    progress("model for the range", 1, 1)
    try:
        point = point_of(scene, model)
        if scene.accuracy.is_given:
            scene, known = _with_steps(scene, point, partial(progress, "errors in the range"))
        else:
            report = partial(progress, "slip in the range")
            check_short_of_gross_slip(verification_run(point, plan_of(scene), progress=report))
    except JointError as error:
        return Choice(scene, notes=(_own(str(error)),))
    short = Served.by(model).shortfall
    notes: tuple[str, ...] = () if short is None else (f"{short}.",)
    if known is not None:
        if excess(scene.accuracy, known) > 1.0:
            return Choice(scene, notes=(_own(f"it errs by an estimated {stated(known)}"),))
        notes += (
            f"The reduced model for the range has steps of {scene.time_step:.4g} s for the "
            f"accuracy asked for; it errs by an estimated {stated(known)}.",
        )
    return Choice(scene, point, known, notes, *watch.read())


def _own(why: str) -> str:
    return (
        "The reduced model for the range does not serve this scene, which has one of its own: "
        f"{why.removeprefix('at: ')}."
    )


def _with_steps(scene: Scene, point: System, progress: Progress) -> tuple[Scene, Estimate]:
    """Scene with steps short enough for the accuracy that it asks for, and errors with them.

    They are halved as long as most of a too large error comes from them.
    """
    scene = resolved(scene, point)
    for left in reversed(range(MOST_HALVINGS + 1)):
        plan = plan_of(scene)
        errors = range_modes.of_range(verification_run(point, plan, progress=progress), plan)
        in_time = excess(scene.accuracy, errors, "time_step")
        if in_time <= WORTHWHILE or excess(scene.accuracy, errors) <= 1.0 or not left:
            break
        scene = scene.finer(2)
    return scene, errors
