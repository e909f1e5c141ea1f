"""Public names for type checkers; `skfem_joint` loads each when it is first used."""

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
from skfem_joint.structure import point_contact as point_contact
from skfem_joint.structure import point_friction as point_friction
from skfem_joint.structure.sensitivities import sensitivities as sensitivities
from skfem_joint.system import AppliedLoad as AppliedLoad
from skfem_joint.system import System as System
from skfem_joint.system_files import load as load
from skfem_joint.system_files import save as save

__version__: str
__all__: list[str]
