"""What a scene asks for, as the functions that run it take it."""

from __future__ import annotations

from typing import Any

from skfem_joint.reduction.basis import Options
from skfem_joint.scene import Scene
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


def how_of(scene: Scene) -> dict[str, Any]:
    """Steps, scheme and output that a scene asks for, for `integrate`."""
    return {
        "step": scene.time_step,
        "n_steps": scene.n_steps,
        "scheme": generalized_alpha(scene.time.rho_infinity),
        "save": save_of(scene),
        "cycle_steps": scene.cycle_steps,
        "until": scene.time.until or "end",
    }


def options_of(scene: Scene) -> Options:
    """Options of a reduction as a scene has them."""
    return Options(**{name: getattr(scene.reduction, name) for name in Options.__annotations__})
