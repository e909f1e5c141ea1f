"""Dynamics of bolted joints with micro-slip friction: a finite-element plugin on scikit-fem.

The house, room by room; a room uses only those above it:

===========  =====================================================================================
(here)       errors, files, friction law, loads (force over time), unknowns, and `System`: the one
             type of all models, ``M a + C v + K u + B^T (w sigma(B v)) = f(t)``
mesh         named meshes of lines, triangles, quadrilaterals, tetrahedra and hexahedra: read,
             checked, built, merged, refined, written
structure    material, joints, pressure and bolts, the contact manifold, assembly to a `System`;
             `contact` and `point_friction` for matrices of one's own
stepping     time integration: schemes, the steppers for what a system's matrices allow, recording,
             checkpoints, and whether a step is short enough
reduction    proper orthogonal modes, active lengths, bases, fewer friction points
scene        the text file that describes a run, checked as a whole
analysis     a scene's models run and compared, their estimated errors, error against run time
output       tables, histories, fields for ParaView, pictures
===========  =====================================================================================

The way of a scene: `scene.load_scene` reads it, `mesh.load_meshes` its mesh,
`structure.Structure` makes the `System`, `stepping.integrate` the run, `reduction` the smaller
system that is run in the same way, `analysis.run_scene` does all of it, and `output.folder.write`
writes what came out.

The names below are loaded when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from skfem_joint.analysis.study import run_scene
    from skfem_joint.errors import ConvergenceError, InputError
    from skfem_joint.loads import (
        HalfSine,
        Harmonic,
        MultiHarmonic,
        RampAndHold,
        Rectangle,
        Table,
        Triangle,
        Versine,
    )
    from skfem_joint.mesh import build_bar, build_box, build_plate, load_meshes, merged
    from skfem_joint.reduction import reduce
    from skfem_joint.scene import load_scene
    from skfem_joint.stepping.integrate import integrate
    from skfem_joint.stepping.recording import Save
    from skfem_joint.structure import (
        Bolt,
        Bolts,
        Joint,
        Load,
        Material,
        PressureTable,
        Structure,
        contact,
        point_friction,
    )
    from skfem_joint.system import System

_HOME = {
    "analysis.study": ("run_scene",),
    "errors": ("ConvergenceError", "InputError"),
    "loads": (
        "HalfSine",
        "Harmonic",
        "MultiHarmonic",
        "RampAndHold",
        "Rectangle",
        "Table",
        "Triangle",
        "Versine",
    ),
    "mesh": ("build_bar", "build_box", "build_plate", "load_meshes", "merged"),
    "reduction": ("reduce",),
    "scene": ("load_scene",),
    "stepping.integrate": ("integrate",),
    "stepping.recording": ("Save",),
    "structure": (
        "Bolt",
        "Bolts",
        "Joint",
        "Load",
        "Material",
        "PressureTable",
        "Structure",
        "contact",
        "point_friction",
    ),
    "system": ("System",),
}
_MODULE = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "Bolt",
    "Bolts",
    "ConvergenceError",
    "HalfSine",
    "Harmonic",
    "InputError",
    "Joint",
    "Load",
    "Material",
    "MultiHarmonic",
    "PressureTable",
    "RampAndHold",
    "Rectangle",
    "Save",
    "Structure",
    "System",
    "Table",
    "Triangle",
    "Versine",
    "build_bar",
    "build_box",
    "build_plate",
    "contact",
    "integrate",
    "load_meshes",
    "load_scene",
    "merged",
    "point_friction",
    "reduce",
    "run_scene",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"skfem_joint.{_MODULE[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
