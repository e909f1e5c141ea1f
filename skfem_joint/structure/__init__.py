"""Bodies, supports and joints of any dimension, and the system of equations that they make.

A structure on a mesh: `nodes` and `assembly` make the mass and stiffness of a `body`; `joints`,
`load` and `clamps` describe what acts on it; `structure` holds it, makes the `System`, and removes
supports. `rigid` finds free motions, `reactions` changes of the normal forces, `doubts` and
`checks` mistakes of the user. `matrices` is a structure of given matrices; `model` is the interface
of both. `parameters` reads and changes single numbers by their keys, `sensitivities` derives the
system by them.

From pressure to friction limits: `pressure.nodal_pressure` (or `preload`, which solves for it with
`pressure_space` and `active_set`) gives the normal force of each node on the surface of a joint,
its `manifold`; `patch.make_patch` collects the nodes of a joint, and `contact.contact_rows` makes
the slip rows B and the limits w += friction * normal force. Where faces may part, `opening` makes
the pressure points (`skfem_joint.normal`) whose forces these limits follow.
"""

from skfem_joint.structure.body import Body as Body
from skfem_joint.structure.body import Material as Material
from skfem_joint.structure.clamps import Clamp as Clamp
from skfem_joint.structure.contact import contact as contact
from skfem_joint.structure.contact import point_contact as point_contact
from skfem_joint.structure.contact import point_friction as point_friction
from skfem_joint.structure.iwan import iwan as iwan
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
