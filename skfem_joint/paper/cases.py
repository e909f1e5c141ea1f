"""The paper's systems as scenes: reference system, Cases I to VII, the jointed structure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from skfem_joint.meshing import BarMesh, build_bar
from skfem_joint.scene import Scene, scene_from
from skfem_joint.study import Study, run_scene

#: The paper's own choices, where this package has better defaults.
PLAIN = {
    "snapshots": "displacement",
    "friction_points": "all",
    "active_length": "estimate",
    "beta": 1e5,
}


@dataclass(frozen=True)
class Case:
    """One system under one load.

    Attributes
    ----------
    length : float
        Joint length, m.
    pressure : float
        Pa.
    friction : float
    force : float
        Amplitude or peak, N.
    frequency : float
        Excitation frequency, Hz.
    linear : float
        Length of the linear region beyond the joint, m.
    """

    length: float
    pressure: float
    friction: float
    force: float
    frequency: float
    linear: float = 0.0

    @property
    def limit(self) -> float:
        """Friction limit, N."""
        return self.friction * self.pressure * 0.05 * self.length

    @property
    def static_length(self) -> float:
        """Active length without inertia, m."""
        return self.force / (self.friction * self.pressure * 0.05)


#: Normal force of Cases IV to VII: stated nowhere; 100 kN as in the reference system makes their
#: 35 kN half of the friction limit.
_NORMAL = 100e3

CASES = {
    "reference": Case(0.25, 8e6, 0.7, 63e3, 1000.0),
    "weak": Case(0.25, 8e6, 0.7, 28e3, 100.0),
    "I": Case(0.5, 50e6, 0.7, 437.5e3, 2000.0),
    "II": Case(0.25, 50e6, 0.1, 31.25e3, 4000.0),
    "III": Case(0.5, 50e6, 0.1, 37.5e3, 4000.0),
    "IV": Case(0.25, _NORMAL / 0.05 / 0.25, 0.7, 35e3, 10_000.0),
    "V": Case(0.3, _NORMAL / 0.05 / 0.3, 0.7, 35e3, 8000.0),
    "VI": Case(0.4, _NORMAL / 0.05 / 0.4, 0.7, 35e3, 60.0),
    "VII": Case(0.5, _NORMAL / 0.05 / 0.5, 0.7, 35e3, 5000.0),
    "structure": Case(0.1, 50e6, 0.7, 87.5e3, 500.0, linear=0.5),
}


@cache
def bar(length: float, linear: float = 0.0, elements: int = 100) -> BarMesh:
    """Mesh of a joint with ``elements`` elements and, beyond it, a linear region with as many."""
    if linear == 0.0:
        return build_bar([("joint", length, elements)], {"fixed": 0.0, "free_end": length})
    return build_bar(
        [("joint", length, elements), ("linear", linear, elements)],
        {"fixed": 0.0, "junction": length, "free_end": length + linear},
    )


def scene(
    case: Case,
    *,
    load: dict[str, Any] | None = None,
    time: dict[str, Any] | None = None,
    run: tuple[str, ...] = ("full",),
    reduction: dict[str, Any] | None = None,
    beta: float = 1e5,
    normal_force: str = "equal",
    elements: int = 100,
    stiffness_damping: float = 1e-5,
    output: dict[str, Any] | None = None,
) -> Scene:
    """Scene of a case; harmonic, 8 cycles of 200 steps unless told otherwise.

    Parameters
    ----------
    load : dict, optional
        Keys of the load but ``on``, e.g. ``{"kind": "triangle", "peak": ..., "rise_time": ...}``.
    time : dict, optional
        Keys of ``[time]``.
    run : tuple of str
        Models.
    reduction : dict, optional
        Keys of ``[reduction]``; `PLAIN` is the paper's choice.
    beta : float
        Steepness of the arctan law, s/m; ``inf`` is Coulomb.
    """
    joint: dict[str, Any] = {
        "region": "joint",
        "pressure": case.pressure,
        "friction": case.friction,
        "normal_force": normal_force,
    }
    joint |= {"law": "coulomb"} if beta == float("inf") else {"beta": beta}
    harmonic = {"kind": "harmonic", "amplitude": case.force, "frequency": case.frequency}
    return scene_from(
        {
            "mesh": {"file": "built in memory"},
            "material": {"E": 200e9, "density": 8000.0},
            "section": {"width": 0.05, "thickness": 0.01},
            "support": {"fixed": ["fixed"]},
            "joint": [joint],
            "damping": {"stiffness": stiffness_damping},
            "load": [{"on": "free_end", **(load or harmonic)}],
            "time": time or {"cycles": 8, "steps_per_cycle": 200},
            "models": {"run": list(run)},
            "reduction": reduction or {},
            "output": output or {},
        },
        bar(case.length, case.linear, elements),
    )


def study(case: Case, **options: Any) -> Study:
    """Run a case; options as for :func:`scene`."""
    return run_scene(scene(case, **options))
