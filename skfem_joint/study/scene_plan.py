"""From a scene to a run: its plan, the basis of its reduced model, and its fingerprint.

`plan_of` gives the time steps and `save_of` what they store. `options_of` copies the scene's table
``[reduction]`` to `Options`; `basis_of_scene` hands these to `make_reduced`, which calls
`skfem_joint.reduction.sources.make_basis` for the references "static" and "self". `origin_of` gives
the fingerprint by which saved results are recognised.

Only this module knows the paper's scaled modes, which it imports where a scene needs them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from skfem_joint.ground.array_files import fingerprint
from skfem_joint.ground.errors import InputError
from skfem_joint.reduction.basis import Basis, Options
from skfem_joint.reduction.elastic_contact import check_reference
from skfem_joint.reduction.friction_points import NO_FRICTION, NOWHERE
from skfem_joint.reduction.sources import make_basis
from skfem_joint.scene import Scene
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.structure.model import AnyStructure
from skfem_joint.system.system import System

if TYPE_CHECKING:
    from skfem_joint.slow.quasi_static import QuasiStatic

#: Cycles for which modes are made where the run goes on until the vibration is steady.
TO_STEADY = 100


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
    """Store only what a picture, a file or a comparison of this scene needs."""
    output, cycle = scene.output, scene.cycle_steps
    stride = max(1, -(-scene.n_steps // output.frames))
    if cycle is not None and stride >= cycle:
        # Less than a frame a cycle: each a twentieth of a cycle on, lest all are of one phase.
        stride = -(-stride // cycle) * cycle + max(1, cycle // 20)
    return Save(
        every=output.every,
        points=output.history or output.plots or len(scene.models.run) > 1,
        slips=output.history,
        fields=output.vtk or output.plots,
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


def options_of(scene: Scene) -> Options:
    """Options of a reduction: the values of the scene's table ``[reduction]``, by their names."""
    return Options(**{name: getattr(scene.reduction, name) for name in Options.__annotations__})


def basis_of_scene(
    scene: Scene,
    structure: AnyStructure,
    system: System,
    options: Options,
    path: QuasiStatic | None = None,
    *,
    enriched: bool = False,
) -> Basis:
    """Basis of a structure for the run that a scene asks for.

    The other arguments, and the errors raised, are those of `make_reduced`.
    """
    plan = plan_of(scene)
    if plan.until == "steady":
        plan = replace(plan, n_steps=plan.n_steps * TO_STEADY, until="end")
    return make_reduced(structure, system, options, plan, enriched=enriched, path=path)


def make_reduced(
    structure: AnyStructure,
    system: System,
    options: Options,
    plan: Plan,
    *,
    enriched: bool = False,
    path: QuasiStatic | None = None,
) -> Basis:
    """Basis of a structure by its options; computes the path or runs that it needs.

    Parameters and errors are those of `skfem_joint.reduction.sources.make_basis`. The reference
    "paper" needs a structure with a mesh.
    """
    if options.reference != "paper":
        return make_basis(system, options, plan, enriched=enriched, path=path)
    check_reference(system, options.reference)
    from skfem_joint.reduction.scaled.basis import paper_basis  # few scenes need it

    return paper_basis(structure, system, options, plan, enriched=enriched)


def origin_of(scene: Scene) -> str:
    """Fingerprint of a scene, its mesh and the tables of its loads."""
    # `model_copy` takes values as they are: here a list is as good as a tuple.
    content = scene.model_dump(mode="json", exclude={"sweep"}, warnings=False)
    return fingerprint(
        content,
        [load.amplitude for load in scene.loads()],
        *scene.structure().identity,
    )
