"""Dynamics of bolted joints with micro-slip friction: a finite-element plugin on scikit-fem.

The folders of the package; a module imports only from its own folder and those above it:

===========  =====================================================================================
(here)       errors, files, arrays in files, checks of numbers, progress, loads (force over time),
             compilation
linalg       compressed rows, factors, Schur complements, shifts, compiled kernels
(here)       modes, unknowns, contact, slips, and `System`, the type of all models, also in files:
             ``M a + C v + K u + B^T (w sigma(B v)) = f(t)``
mesh         named meshes of lines, triangles, quadrilaterals, tetrahedra and hexahedra: read,
             checked, built, merged, refined, written
structure    the elastic body (mass, stiffness, stress), joints, pressure, preload, the contact
             manifold with its friction limits, and the `Structure` that makes a `System` of
             them; `MatrixModel` for given matrices
minimise     the step problem ``1/2 v H v - g v + sum w psi(|B v|)``: the law of friction, the
             protocol, and three methods: front elimination on chains, truncated nonsmooth
             Newton, primal-dual Newton
stepping     time integration: the plan of a run, schemes, steppers, the compiled time loop,
             energies, recording, checkpoints, and whether a step is short enough; steady
             vibration; quasi-static response
reduction    proper orthogonal modes, the static slip path, bases, fewer friction points,
             condensation, active lengths; in ``scaled`` the paper's scaled modes
scene        the text file that describes a run, checked as a whole, and the reference of its keys
analysis     slips, stress and active regions of a run, natural modes; the models of a scene, run
             and compared, their estimated errors, error against run time, damping against
             amplitude, response over frequency, sweeps of many scenes, fits to measured curves
output       tables, histories, fields for ParaView, pictures
===========  =====================================================================================

How a scene is computed: `scene.load_scene` reads it and `mesh.load_meshes` its mesh.
`structure.Structure` makes the `System`, `stepping.integrate` the run, and `reduction` the smaller
system, which is run in the same way. `analysis.study.run_scene` does all of it, pass by pass, and
`output.folder.write` writes the results. Words and symbols are explained in
``docs/reference/glossary.md``.

The names below are loaded when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from skfem_joint.analysis.active_region import ActiveRegion as ActiveRegion
    from skfem_joint.analysis.active_region import active_region as active_region
    from skfem_joint.analysis.backbone import Backbone as Backbone
    from skfem_joint.analysis.backbone import backbone as backbone
    from skfem_joint.analysis.backbone_sensitivity import (
        BackboneSensitivity as BackboneSensitivity,
    )
    from skfem_joint.analysis.backbone_sensitivity import (
        backbone_sensitivity as backbone_sensitivity,
    )
    from skfem_joint.analysis.damping_curve import DampingCurve as DampingCurve
    from skfem_joint.analysis.damping_curve import damping_curve as damping_curve
    from skfem_joint.analysis.estimate import Estimate as Estimate
    from skfem_joint.analysis.fit import Fit as Fit
    from skfem_joint.analysis.fit import FitProblem as FitProblem
    from skfem_joint.analysis.fit import fit as fit
    from skfem_joint.analysis.history import Errors as Errors
    from skfem_joint.analysis.history import compare as compare
    from skfem_joint.analysis.measured import MeasuredCurve as MeasuredCurve
    from skfem_joint.analysis.measured import measured_curve as measured_curve
    from skfem_joint.analysis.models import Model as Model
    from skfem_joint.analysis.models import Study as Study
    from skfem_joint.analysis.natural_modes import NaturalModes as NaturalModes
    from skfem_joint.analysis.natural_modes import natural_modes as natural_modes
    from skfem_joint.analysis.response import Curve as Curve
    from skfem_joint.analysis.response import SteadyPoint as SteadyPoint
    from skfem_joint.analysis.response import response as response
    from skfem_joint.analysis.ring_down import RingDown as RingDown
    from skfem_joint.analysis.ring_down import ring_down as ring_down
    from skfem_joint.analysis.rows import Rows as Rows
    from skfem_joint.analysis.run_estimate import estimate as estimate
    from skfem_joint.analysis.stress import StressHistory as StressHistory
    from skfem_joint.analysis.stress import stress_history as stress_history
    from skfem_joint.analysis.study import run_scene as run_scene
    from skfem_joint.analysis.sweep import Row as Row
    from skfem_joint.analysis.sweep import sweep as sweep
    from skfem_joint.contacts import Contact as Contact
    from skfem_joint.errors import ConvergenceError as ConvergenceError
    from skfem_joint.errors import InputError as InputError
    from skfem_joint.loads import Amplitude as Amplitude
    from skfem_joint.loads import HalfSine as HalfSine
    from skfem_joint.loads import Harmonic as Harmonic
    from skfem_joint.loads import MultiHarmonic as MultiHarmonic
    from skfem_joint.loads import RampAndHold as RampAndHold
    from skfem_joint.loads import Rectangle as Rectangle
    from skfem_joint.loads import Table as Table
    from skfem_joint.loads import Triangle as Triangle
    from skfem_joint.loads import Versine as Versine
    from skfem_joint.mesh import NamedMesh as NamedMesh
    from skfem_joint.mesh import build_bar as build_bar
    from skfem_joint.mesh import build_box as build_box
    from skfem_joint.mesh import build_plate as build_plate
    from skfem_joint.mesh import load_meshes as load_meshes
    from skfem_joint.mesh import merged as merged
    from skfem_joint.normal import NormalPart as NormalPart
    from skfem_joint.output.series import write_vtk as write_vtk
    from skfem_joint.reduction import at as at
    from skfem_joint.reduction import condense as condense
    from skfem_joint.reduction import reduce as reduce
    from skfem_joint.reduction.pod import ProperModes as ProperModes
    from skfem_joint.reduction.pod import proper_modes as proper_modes
    from skfem_joint.scene import Scene as Scene
    from skfem_joint.scene import load_scene as load_scene
    from skfem_joint.scene import load_sweep as load_sweep
    from skfem_joint.scene.reading import Swept as Swept
    from skfem_joint.sensitivity import OpeningSensitivity as OpeningSensitivity
    from skfem_joint.sensitivity import SystemSensitivity as SystemSensitivity
    from skfem_joint.served import Range as Range
    from skfem_joint.slips import SlipRows as SlipRows
    from skfem_joint.stepping.checkpoint import Checkpoint as Checkpoint
    from skfem_joint.stepping.checkpoint import Checkpoints as Checkpoints
    from skfem_joint.stepping.integrate import integrate as integrate
    from skfem_joint.stepping.integrate import quasi_static as quasi_static
    from skfem_joint.stepping.loops import Loops as Loops
    from skfem_joint.stepping.recording import Counters as Counters
    from skfem_joint.stepping.recording import Cycles as Cycles
    from skfem_joint.stepping.recording import Run as Run
    from skfem_joint.stepping.recording import Save as Save
    from skfem_joint.stepping.recording import Steady as Steady
    from skfem_joint.stepping.schemes import Scheme as Scheme
    from skfem_joint.stepping.schemes import generalized_alpha as generalized_alpha
    from skfem_joint.structure import Bolt as Bolt
    from skfem_joint.structure import Bolts as Bolts
    from skfem_joint.structure import Clamp as Clamp
    from skfem_joint.structure import Joint as Joint
    from skfem_joint.structure import Load as Load
    from skfem_joint.structure import Material as Material
    from skfem_joint.structure import PressureTable as PressureTable
    from skfem_joint.structure import Structure as Structure
    from skfem_joint.structure import contact as contact
    from skfem_joint.structure import iwan as iwan
    from skfem_joint.structure import point_friction as point_friction
    from skfem_joint.structure.sensitivities import sensitivities as sensitivities
    from skfem_joint.system import AppliedLoad as AppliedLoad
    from skfem_joint.system import System as System
    from skfem_joint.system_files import load as load
    from skfem_joint.system_files import save as save

#: Public names by the module that defines them.
_NAMES = {
    "analysis.active_region": "ActiveRegion active_region",
    "analysis.backbone": "Backbone backbone",
    "analysis.backbone_sensitivity": "BackboneSensitivity backbone_sensitivity",
    "analysis.damping_curve": "DampingCurve damping_curve",
    "analysis.estimate": "Estimate",
    "analysis.fit": "Fit FitProblem fit",
    "analysis.history": "Errors compare",
    "analysis.measured": "MeasuredCurve measured_curve",
    "analysis.models": "Model Study",
    "analysis.natural_modes": "NaturalModes natural_modes",
    "analysis.response": "Curve SteadyPoint response",
    "analysis.ring_down": "RingDown ring_down",
    "analysis.rows": "Rows",
    "analysis.run_estimate": "estimate",
    "analysis.stress": "StressHistory stress_history",
    "analysis.study": "run_scene",
    "analysis.sweep": "Row sweep",
    "contacts": "Contact",
    "errors": "ConvergenceError InputError",
    "loads": "Amplitude HalfSine Harmonic MultiHarmonic RampAndHold Rectangle Table Triangle "
    "Versine",
    "mesh": "NamedMesh build_bar build_box build_plate load_meshes merged",
    "normal": "NormalPart",
    "output.series": "write_vtk",
    "reduction": "at condense reduce",
    "reduction.pod": "ProperModes proper_modes",
    "scene": "Scene load_scene load_sweep",
    "scene.reading": "Swept",
    "stepping.checkpoint": "Checkpoint Checkpoints",
    "stepping.integrate": "integrate quasi_static",
    "stepping.loops": "Loops",
    "stepping.recording": "Counters Cycles Run Save Steady",
    "stepping.schemes": "Scheme generalized_alpha",
    "structure": "Bolt Bolts Clamp Joint Load Material PressureTable Structure contact iwan "
    "point_friction",
    "structure.sensitivities": "sensitivities",
    "system": "AppliedLoad System",
    "system_files": "load save",
    "served": "Range",
    "sensitivity": "OpeningSensitivity SystemSensitivity",
    "slips": "SlipRows",
}
_MODULE = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_MODULE)


def __getattr__(name: str) -> Any:
    if name not in _MODULE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"skfem_joint.{_MODULE[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
