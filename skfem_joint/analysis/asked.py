"""Plan, options and basis that a scene asks for, and its fingerprint."""

from __future__ import annotations

from dataclasses import replace

from skfem_joint.analysis.reduced_models import make_reduced
from skfem_joint.reduction.basis import Basis, Options
from skfem_joint.scene import Scene
from skfem_joint.stepping.checkpoint import fingerprint
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.quasi_static import QuasiStatic
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.structure import AnyStructure
from skfem_joint.system import System

#: Cycles of the run that modes are made for where it goes on until vibration is steady.
TO_STEADY = 100


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
    )


def options_of(scene: Scene) -> Options:
    """Options of a reduction as a scene has them."""
    return Options(**{name: getattr(scene.reduction, name) for name in Options.__annotations__})


def basis_of(
    scene: Scene,
    structure: AnyStructure,
    system: System,
    options: Options,
    rest: QuasiStatic | None = None,
    *,
    enriched: bool = False,
) -> Basis:
    """Basis of a structure for the run that a scene asks for.

    ``rest`` may have factors of the system; errors, and a basis that is to be ``enriched`` before
    it is used, as in `make_reduced`.
    """
    plan = plan_of(scene)
    if plan.until == "steady":
        plan = replace(plan, n_steps=plan.n_steps * TO_STEADY, until="end")
    return make_reduced(structure, system, options, plan, enriched=enriched, path=rest)


def origin_of(scene: Scene) -> str:
    """Fingerprint of a scene, its mesh and the tables of its loads."""
    # `Scene.changed` takes values as they are: here a list is as good as a tuple.
    content = scene.model_dump(mode="json", exclude={"sweep"}, warnings=False)
    return fingerprint(
        content,
        [load.amplitude for load in scene.loads()],
        *scene.structure().identity,
    )
