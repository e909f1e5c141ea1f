"""From a scene to its models: their plan, which of them there are, and how each is made.

`plan_of` gives the time steps of a run and `save_of` what they store; `origin_of` gives the
fingerprint by which saved results are recognised. Each model is made here, for every command, by
what Python users call: `model_of` gives the full, condensed or reduced model of a run; responses
and damping curves take `reduced_for_response` and `reduced_for_mode`. Its
``origin`` has the full system and the basis, its ``notes`` say what to beware of. Numbers of modes,
notes and refusals are those of `skfem_joint.condense` and `skfem_joint.reduce`. (Models for a range
are kept in files, see `skfem_joint.study.scene_range`.)

Only this module knows the paper's scaled modes, which it imports where a scene needs them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.plain_values import fingerprint
from skfem_joint.mesh import refined
from skfem_joint.reduction.basis import Options
from skfem_joint.reduction.condensed import condense
from skfem_joint.reduction.elastic_contact import check_reference
from skfem_joint.reduction.excitation import repeats
from skfem_joint.reduction.friction_points import NO_FRICTION, NOWHERE
from skfem_joint.reduction.models import TO_STEADY, reduced, reduced_on
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.scene import Scene
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.system.system import System

#: Most unknowns and contact points of a system on halved elements that is made to see the error of
#: a mesh. (Both at their most take some ten times a reduced model's own time.)
MOST_UNKNOWNS, MOST_POINTS = 15_000, 5_000
#: Note where the assumption of constant normal forces is not judged.
UNKNOWN_CHANGE = (
    "By how much vibration changes the normal forces, which count as constant, is not computed of "
    "a structure in parts."
)


def with_friction(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """Scene without models that reduce slip where no joint carries friction, and a note.

    These are reduced models, and condensed ones unless contact opens. InputError where no model is
    left.
    """
    contact = scene.system().contact
    kept = ["full", "condensed"] if contact.opens else ["full"]
    left_out = [name for name in scene.models.run if name not in kept]
    if contact.count or not left_out:
        return scene, ()
    names = " and ".join(repr(name) for name in left_out)
    why = f"models.run: {names} left out: they reduce slip, and {NOWHERE}"
    kept = [name for name in scene.models.run if name in kept]
    if not kept:
        raise InputError(f"{scene.path}: {NO_FRICTION.replace('reduced', left_out[0])}")
    return scene.changed(models={"run": kept}), (f"{why}.",)


def save_of(scene: Scene) -> Save:
    """Store only what a picture, a file, a comparison or an estimate of this scene needs."""
    output, cycle = scene.output, scene.cycle_steps
    stride = max(1, -(-scene.n_steps // output.frames))
    if cycle is not None and stride >= cycle:
        # Less than a frame a cycle: each a twentieth of a cycle on, lest all are of one phase.
        stride = -(-stride // cycle) * cycle + max(1, cycle // 20)
    if cycle is not None and output.stress:  # peaks of a sine within 0.2 %
        stride = min(stride, max(1, cycle // 64))
    return Save(
        every=output.every,
        points=output.history
        or output.plots
        or scene.accuracy.estimate
        or len(scene.models.run) > 1,
        slips=output.history,
        fields=output.vtk or output.plots or bool(output.stress),
        fields_every=stride,
    )


def plan_of(scene: Scene) -> Plan:
    """Steps, scheme and output that a scene asks for."""
    return Plan(
        scene.time_step,
        scene.n_steps,
        generalized_alpha(scene.time.rho_infinity),
        save_of(scene),
        scene.cycle_steps,
        scene.time.until or "end",
        quasi_static=scene.time.quasi_static,
    )


def origin_of(scene: Scene) -> str:
    """Fingerprint of a scene, its mesh and the tables of its loads."""
    # `model_copy` takes values as they are: here a list is as good as a tuple.
    content = scene.model_dump(mode="json", exclude={"sweep"}, warnings=False)
    return fingerprint(
        content, [load.amplitude for load in scene.loads()], *scene.structure().identity
    )


def finer_mesh(scene: Scene) -> Scene:
    """Scene on its mesh with all elements halved, with the same points observed."""
    points: dict[str, Any] = {"points": scene.output_points}
    return scene.changed(mesh=refined(scene.named_mesh), output=points)


def finer_system(scene: Scene, system: System) -> System | None:
    """Full system on halved elements; None where it would cost much, or there is no mesh to halve.

    ``system`` is the full system of the scene.
    """
    if scene.matrices is not None or scene.parts is not None:
        return None
    times = 2**scene.named_mesh.dim
    small = system.n * times <= MOST_UNKNOWNS and system.contact.count * times <= MOST_POINTS
    return finer_mesh(scene).system() if small else None


def options_of(scene: Scene, reference: str | None = None) -> Options:
    """Options of a reduction: the values of the scene's table ``[reduction]``, by their names.

    ``reference`` takes the place of the scene's.
    """
    given = {name: getattr(scene.reduction, name) for name in Options.__annotations__}
    return Options(**given if reference is None else given | {"reference": reference})


def other_reference(scene: Scene) -> tuple[str, ...]:
    """Note that a response or curve has modes of its own, where the scene says of what else."""
    reference, kept = scene.reduction.reference, scene.reduction.range is None
    if reference == "static" or "reduced" not in scene.models.run or not kept:
        return ()
    return (
        f"reduction.reference = {reference!r} is for 'run' alone: the reduced model of a response "
        "has modes of a static slip path, that of a damping curve modes of the curve's states.",
    )


def largest_model(
    scene: Scene, interface_modes: str | int = "auto", *, frequency: float | None = None
) -> System:
    """Full model of a scene, or where it is factorised in parts the condensed one.

    ``interface_modes`` and ``frequency`` are those of `condense`.
    """
    if scene.parts is None:
        return scene.system()
    return _condensed(scene, interface_modes, frequency)


def _condensed(scene: Scene, interface_modes: str | int, frequency: float | None) -> System:
    """Condensed model of a scene, as its table ``[models]`` has it."""
    how: dict[str, Any] = {"contact_points": scene.models.contact_points, "parts": scene.parts}
    return condense(scene.system(), interface_modes, frequency=frequency, **how)


def model_by(
    name: str, scene: Scene, reduced_model: Callable[[], System], frequency: float | None = None
) -> System:
    """Model of a scene by its name; a reduced one is made by a function.

    A condensed one has the modes up to a ``frequency`` (Hz), or up to that of the loads.
    """
    if name == "reduced":
        return reduced_model()
    return scene.system() if name == "full" else _condensed(scene, "auto", frequency)


def model_of(
    name: str,
    scene: Scene,
    options: Options | None = None,
    path: QuasiStatic | None = None,
    *,
    enriched: bool = False,
) -> System:
    """Model of a scene for its run.

    Parameters
    ----------
    name : str
        "full", "condensed" or "reduced".
    scene : Scene
    options : Options, optional
        Of a reduced model, in place of the scene's.
    path : QuasiStatic, optional
        A quasi-static path of the scene's system, whose factors are used.
    enriched : bool
        Whether the basis gets more vectors before it is used, see `reduced`.

    Raises
    ------
    InputError
        As `skfem_joint.condense` and `skfem_joint.reduce`; for the reference "paper" if the
        structure has no mesh.
    ConvergenceError
        If a run that a basis is made of does not converge.
    """
    options = options or options_of(scene)
    return model_by(name, scene, partial(_for_run, scene, options, path, enriched=enriched))


def _for_run(scene: Scene, options: Options, path: QuasiStatic | None, *, enriched: bool) -> System:
    """Reduced model of a scene for its run, see `model_of`."""
    system, slow = scene.system(), scene.time.quasi_static
    check_reference(system, options.reference)
    duration = None if scene.time.until == "steady" else scene.n_steps * scene.time_step
    if options.reference != "paper":
        run = _training(scene, system) if options.reference == "self" else None
        times = duration, scene.time_step, plan_of(scene).scheme
        return reduced(
            system, options, *times, quasi_static=slow, run=run, path=path, enriched=enriched
        )
    from skfem_joint.reduction.scaled.basis import paper_basis  # few scenes need it

    basis = paper_basis(scene.structure(), system, options, plan_of(scene), enriched=enriched)
    if not repeats(system, duration):
        basis = basis.for_decay()
    return reduced_on(system, basis, **options.friction)


def _training(scene: Scene, system: System) -> Run:
    """First cycles of the run of a scene, or all of it, with its fields."""
    plan = plan_of(scene)
    if plan.until == "steady":
        plan = replace(plan, n_steps=TO_STEADY * plan.n_steps, until="end")
    if plan.cycle_steps is not None:
        plan = plan.first(3)  # cycles, those of the paper
    plan = replace(plan, save=Save(fields=True, points=False), cycle_steps=None)
    try:
        return integrate_plan(system, plan).finished()
    except ConvergenceError as error:  # without the states of this run, which is no result
        raise ConvergenceError(str(error), error.unknown) from error
