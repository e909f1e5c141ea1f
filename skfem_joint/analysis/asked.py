"""What a scene asks for, as the functions that run it take it."""

from __future__ import annotations

from skfem_joint.reduction.basis import Options
from skfem_joint.scene import Scene
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import generalized_alpha

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
