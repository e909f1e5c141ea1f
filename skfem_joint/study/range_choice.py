"""Whether a scene is a point of its range, and whether the model for the range is good enough."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from skfem_joint.accuracy import range_modes
from skfem_joint.accuracy.estimate import Estimate, verification_run
from skfem_joint.ground.errors import JointError
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.reduction.ranges.points import check_short_of_gross_slip
from skfem_joint.runs.resolution import longest_step
from skfem_joint.scene import Scene
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.study import accuracy
from skfem_joint.study.accuracy import Choice
from skfem_joint.study.models import plan_of
from skfem_joint.study.scene_range import ServedScene, point_of, range_model
from skfem_joint.system.served import Served
from skfem_joint.system.system import System


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
    watch = Stopwatch()
    progress("model for the range", 0, 1)
    model = range_model(served, folder)
    progress("model for the range", 1, 1)
    try:
        point = point_of(scene, model)
        if scene.accuracy.is_given:
            shorter, errors = _with_steps(scene, point, partial(progress, "errors in the range"))
        else:
            report = partial(progress, "slip in the range")
            check_short_of_gross_slip(verification_run(point, plan_of(scene), progress=report))
    except JointError as error:
        return Choice(scene, notes=(_own(str(error)),))
    short = Served.by(model).shortfall
    notes, stated = () if short is None else (f"{short}.",), None
    if scene.accuracy.is_given:
        scene = shorter
        if accuracy.excess(scene.accuracy, errors) > 1.0:
            return Choice(
                scene, notes=(_own(f"it errs by an estimated {accuracy.stated(errors)}"),)
            )
        notes = (
            *notes,
            f"The reduced model for the range has steps of {scene.time_step:.4g} s for the "
            f"accuracy asked for; it errs by an estimated {accuracy.stated(errors)}.",
        )
        stated = errors
    return Choice(scene, point, stated, notes, *watch.read())


def _own(why: str) -> str:
    return (
        "The reduced model for the range does not serve this scene, which has one of its own: "
        f"{why.removeprefix('at: ')}."
    )


def _with_steps(scene: Scene, point: System, progress: Progress) -> tuple[Scene, Estimate]:
    """Scene with steps short enough for the accuracy that it asks for, and errors with them.

    They are halved as long as most of a too large error comes from them.
    """
    longest = longest_step(point, scene.n_steps * scene.time_step)
    while scene.time_step > longest:
        scene = scene.finer(2)
    for halvings in range(accuracy.MOST_HALVINGS + 1):
        plan = plan_of(scene)
        run = verification_run(point, plan, progress=progress)
        errors = range_modes.of_range(run, plan)
        in_time = accuracy.excess(scene.accuracy, errors, "time_step")
        enough = in_time <= accuracy.WORTHWHILE
        last = halvings == accuracy.MOST_HALVINGS
        if enough or last or accuracy.excess(scene.accuracy, errors) <= 1.0:
            break
        scene = scene.finer(2)
    return scene, errors
