"""Runs of the reference joint that Figs. 2 to 4 share."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from skfem_joint.paper.cases import CASES, study
from skfem_joint.recording import Run
from skfem_joint.reference import PLATE

REFERENCE = CASES["reference"]
#: Axial stiffness of the plate, N.
STIFFNESS: float = PLATE["E"] * PLATE["width"] * PLATE["thickness"]
#: Friction limit per length of the reference joint, N/m.
TAU = REFERENCE.limit / REFERENCE.length
#: Slow enough for inertia and viscous damping to vanish, and the paper's own low frequency, Hz.
SLOW = 5.0


@cache
def run_reference(
    force: float,
    frequency: float,
    beta: float,
    *,
    normal_force: str = "equal",
    elements: int = 100,
    steps: int = 200,
) -> Run:
    """Full model of the reference joint over four cycles."""
    return (
        study(
            replace(REFERENCE, force=force, frequency=frequency),
            beta=beta,
            normal_force=normal_force,
            elements=elements,
            time={"cycles": 4, "steps_per_cycle": steps},
        )
        .models["full"]
        .run
    )


def peak(run: Run) -> float:
    """Largest displacement of the free end in the last cycle, m."""
    return float(run.cycles.peak[-1, 0])


def loop_area(run: Run) -> float:
    """Work of the load in the last cycle, J."""
    return float(run.cycles.input[-1, 0])
