"""Public names for type checkers; `skfem_joint` loads each when it is first used."""

from skfem_joint.accuracy.estimate import Estimate as Estimate
from skfem_joint.accuracy.run_estimate import estimate as estimate
from skfem_joint.body.body import Material as Material
from skfem_joint.fitting.damping_curve import DampingCurve as DampingCurve
from skfem_joint.fitting.damping_curve import damping_curve as damping_curve
from skfem_joint.fitting.fit import Fit as Fit
from skfem_joint.fitting.fit import FitProblem as FitProblem
from skfem_joint.fitting.fit import fit as fit
from skfem_joint.fitting.measured import MeasuredCurve as MeasuredCurve
from skfem_joint.fitting.measured import measured_curve as measured_curve
from skfem_joint.ground.errors import ConvergenceError as ConvergenceError
from skfem_joint.ground.errors import InputError as InputError
from skfem_joint.ground.loads import Amplitude as Amplitude
from skfem_joint.ground.loads import HalfSine as HalfSine
from skfem_joint.ground.loads import Harmonic as Harmonic
from skfem_joint.ground.loads import MultiHarmonic as MultiHarmonic
from skfem_joint.ground.loads import RampAndHold as RampAndHold
from skfem_joint.ground.loads import Rectangle as Rectangle
from skfem_joint.ground.loads import SweptSine as SweptSine
from skfem_joint.ground.loads import Table as Table
from skfem_joint.ground.loads import Triangle as Triangle
from skfem_joint.ground.loads import Versine as Versine
from skfem_joint.ground.power_density import PowerDensity as PowerDensity
from skfem_joint.ground.rows import Rows as Rows
from skfem_joint.joint.clamps import Clamp as Clamp
from skfem_joint.joint.contact import contact as contact
from skfem_joint.joint.contact import point_contact as point_contact
from skfem_joint.joint.contact import point_friction as point_friction
from skfem_joint.joint.joints import Joint as Joint
from skfem_joint.joint.pressure import Bolt as Bolt
from skfem_joint.joint.pressure import Bolts as Bolts
from skfem_joint.joint.pressure import PressureTable as PressureTable
from skfem_joint.linalg.parts import Parts as Parts
from skfem_joint.mesh import NamedMesh as NamedMesh
from skfem_joint.mesh import build_bar as build_bar
from skfem_joint.mesh import build_box as build_box
from skfem_joint.mesh import build_plate as build_plate
from skfem_joint.mesh import load_meshes as load_meshes
from skfem_joint.mesh import merged as merged
from skfem_joint.mesh import refined as refined
from skfem_joint.output.page import write_report as write_report
from skfem_joint.output.series import write_vtk as write_vtk
from skfem_joint.reduction.condensed import condense as condense
from skfem_joint.reduction.models import reduce as reduce
from skfem_joint.reduction.pod import ProperModes as ProperModes
from skfem_joint.reduction.pod import proper_modes as proper_modes
from skfem_joint.reduction.ranges.points import at as at
from skfem_joint.results.active_region import ActiveRegion as ActiveRegion
from skfem_joint.results.active_region import active_region as active_region
from skfem_joint.results.history import Errors as Errors
from skfem_joint.results.history import compare as compare
from skfem_joint.results.natural_modes import NaturalModes as NaturalModes
from skfem_joint.results.natural_modes import natural_modes as natural_modes
from skfem_joint.results.stress import StressHistory as StressHistory
from skfem_joint.results.stress import stress_history as stress_history
from skfem_joint.runs.integrate import integrate as integrate
from skfem_joint.runs.integrate import quasi_static as quasi_static
from skfem_joint.scene import Scene as Scene
from skfem_joint.scene import load_scene as load_scene
from skfem_joint.scene import load_sweep as load_sweep
from skfem_joint.scene.reading import Swept as Swept
from skfem_joint.stepping.checkpoint import Checkpoint as Checkpoint
from skfem_joint.stepping.checkpoint import Checkpoints as Checkpoints
from skfem_joint.stepping.loops import Loops as Loops
from skfem_joint.stepping.recording import Counters as Counters
from skfem_joint.stepping.recording import Cycles as Cycles
from skfem_joint.stepping.recording import Run as Run
from skfem_joint.stepping.recording import Save as Save
from skfem_joint.stepping.recording import Steady as Steady
from skfem_joint.stepping.schemes import Scheme as Scheme
from skfem_joint.stepping.schemes import generalized_alpha as generalized_alpha
from skfem_joint.structure.iwan import iwan as iwan
from skfem_joint.structure.load import Load as Load
from skfem_joint.structure.matrices import MatrixModel as MatrixModel
from skfem_joint.structure.sensitivities import sensitivities as sensitivities
from skfem_joint.structure.structure import Structure as Structure
from skfem_joint.study.description import Description as Description
from skfem_joint.study.description import describe as describe
from skfem_joint.study.results import Model as Model
from skfem_joint.study.results import Study as Study
from skfem_joint.study.study import run_scene as run_scene
from skfem_joint.study.sweep import Row as Row
from skfem_joint.study.sweep import sweep as sweep
from skfem_joint.system.contacts import Contact as Contact
from skfem_joint.system.normal import NormalPart as NormalPart
from skfem_joint.system.sensitivity import OpeningSensitivity as OpeningSensitivity
from skfem_joint.system.sensitivity import SystemSensitivity as SystemSensitivity
from skfem_joint.system.served import Range as Range
from skfem_joint.system.slips import SlipRows as SlipRows
from skfem_joint.system.system import AppliedLoad as AppliedLoad
from skfem_joint.system.system import System as System
from skfem_joint.system.system_files import load as load
from skfem_joint.system.system_files import save as save
from skfem_joint.vibration.backbone import Backbone as Backbone
from skfem_joint.vibration.backbone import backbone as backbone
from skfem_joint.vibration.backbone_sensitivity import (
    BackboneSensitivity as BackboneSensitivity,
)
from skfem_joint.vibration.backbone_sensitivity import (
    backbone_sensitivity as backbone_sensitivity,
)
from skfem_joint.vibration.random_response import RandomMode as RandomMode
from skfem_joint.vibration.random_response import RandomResponse as RandomResponse
from skfem_joint.vibration.random_response import random_response as random_response
from skfem_joint.vibration.response import response as response
from skfem_joint.vibration.response_curve import Curve as Curve
from skfem_joint.vibration.response_curve import SteadyPoint as SteadyPoint
from skfem_joint.vibration.ring_down import RingDown as RingDown
from skfem_joint.vibration.ring_down import ring_down as ring_down

__version__: str
__all__: list[str]
