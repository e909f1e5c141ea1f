"""Bodies, supports and joints of any dimension, and the system of equations that they make."""

from skfem_joint.structure.body import Body as Body
from skfem_joint.structure.body import Material as Material
from skfem_joint.structure.clamps import Clamp as Clamp
from skfem_joint.structure.contact import contact as contact
from skfem_joint.structure.contact import point_friction as point_friction
from skfem_joint.structure.joints import Joint as Joint
from skfem_joint.structure.load import Load as Load
from skfem_joint.structure.matrices import MatrixModel as MatrixModel
from skfem_joint.structure.model import AnyStructure as AnyStructure
from skfem_joint.structure.model import doubts as doubts
from skfem_joint.structure.patch import Patch as Patch
from skfem_joint.structure.preload import Preload as Preload
from skfem_joint.structure.pressure import Bolt as Bolt
from skfem_joint.structure.pressure import Bolts as Bolts
from skfem_joint.structure.pressure import PressureTable as PressureTable
from skfem_joint.structure.structure import Structure as Structure
