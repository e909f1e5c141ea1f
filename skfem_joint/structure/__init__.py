"""Bodies, supports and joints of any dimension, and the system of equations that they make."""

from skfem_joint.structure.bolts import Bolt, Bolts
from skfem_joint.structure.checks import doubts
from skfem_joint.structure.contact import contact, point_friction
from skfem_joint.structure.patch import Joint, Patch
from skfem_joint.structure.pressure import PressureTable
from skfem_joint.structure.structure import Load, Material, Structure

__all__ = [
    "Bolt",
    "Bolts",
    "Joint",
    "Load",
    "Material",
    "Patch",
    "PressureTable",
    "Structure",
    "contact",
    "doubts",
    "point_friction",
]
