"""Dynamics of bolted joints with micro-slip friction: a finite-element plugin on scikit-fem.

The house, room by room; a room uses only those above it:

===========  =====================================================================================
(here)       errors, files, arrays in files, checks of numbers, progress, loads (force over time),
             compilation
linalg       compressed rows, factors, Schur complements, compiled kernels
(here)       modes, unknowns, slips, and `System`, the one type of all models:
             ``M a + C v + K u + B^T (w sigma(B v)) = f(t)``
mesh         named meshes of lines, triangles, quadrilaterals, tetrahedra and hexahedra: read,
             checked, built, merged, refined, written
structure    the elastic body (mass, stiffness, stress), joints, pressure, preload, the contact
             manifold, and the `Structure` that makes a `System` of them; `contact`,
             `point_friction` and `MatrixModel` for given matrices
minimise     the step problem ``1/2 v H v - g v + sum w psi(|B v|)``: the law of friction, the
             protocol, and three methods, chosen by the structure of the matrices
stepping     time integration: schemes, steppers, the compiled time loop, energies, recording,
             checkpoints, and whether a step is short enough; quasi-static response
reduction    proper orthogonal modes, active lengths, bases, fewer friction points
scene        the text file that describes a run, checked as a whole, and the reference of its keys
analysis     a scene's models run and compared, their estimated errors, error against run time,
             damping against amplitude, response over frequency, sweeps of many scenes
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
    from skfem_joint.analysis.backbone import backbone as backbone
    from skfem_joint.analysis.backbone import ring_down as ring_down
    from skfem_joint.analysis.response import response as response
    from skfem_joint.analysis.study import run_scene as run_scene
    from skfem_joint.analysis.sweep import sweep as sweep
    from skfem_joint.errors import ConvergenceError as ConvergenceError
    from skfem_joint.errors import InputError as InputError
    from skfem_joint.loads import HalfSine as HalfSine
    from skfem_joint.loads import Harmonic as Harmonic
    from skfem_joint.loads import MultiHarmonic as MultiHarmonic
    from skfem_joint.loads import RampAndHold as RampAndHold
    from skfem_joint.loads import Rectangle as Rectangle
    from skfem_joint.loads import Table as Table
    from skfem_joint.loads import Triangle as Triangle
    from skfem_joint.loads import Versine as Versine
    from skfem_joint.mesh import build_bar as build_bar
    from skfem_joint.mesh import build_box as build_box
    from skfem_joint.mesh import build_plate as build_plate
    from skfem_joint.mesh import load_meshes as load_meshes
    from skfem_joint.mesh import merged as merged
    from skfem_joint.reduction import condense as condense
    from skfem_joint.reduction import reduce as reduce
    from skfem_joint.scene import load_scene as load_scene
    from skfem_joint.scene import load_sweep as load_sweep
    from skfem_joint.stepping.integrate import integrate as integrate
    from skfem_joint.stepping.recording import Save as Save
    from skfem_joint.structure import Bolt as Bolt
    from skfem_joint.structure import Bolts as Bolts
    from skfem_joint.structure import Clamp as Clamp
    from skfem_joint.structure import Joint as Joint
    from skfem_joint.structure import Load as Load
    from skfem_joint.structure import Material as Material
    from skfem_joint.structure import PressureTable as PressureTable
    from skfem_joint.structure import Structure as Structure
    from skfem_joint.structure import contact as contact
    from skfem_joint.structure import point_friction as point_friction
    from skfem_joint.system import System as System

_SHAPES = "HalfSine Harmonic MultiHarmonic RampAndHold Rectangle Table Triangle Versine"
_PARTS = "Bolt Bolts Clamp Joint Load Material PressureTable Structure contact point_friction"
_NAMES = {
    "analysis.backbone": "backbone ring_down",
    "analysis.response": "response",
    "analysis.study": "run_scene",
    "analysis.sweep": "sweep",
    "errors": "ConvergenceError InputError",
    "loads": _SHAPES,
    "mesh": "build_bar build_box build_plate load_meshes merged",
    "reduction": "condense reduce",
    "scene": "load_scene load_sweep",
    "stepping.integrate": "integrate",
    "stepping.recording": "Save",
    "structure": _PARTS,
    "system": "System",
}
_MODULE = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_MODULE)


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"skfem_joint.{_MODULE[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
