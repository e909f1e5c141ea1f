"""Meshes with named parts, in every dimension: built, read, checked, merged, refined, written.

`named` is the type of all meshes, `cells` the kinds of their elements; `collapsed` lets several
kinds stand in one mesh, `splitting` has the nodes of second order. `building` makes bars, plates
and boxes; `reading` reads files by meshio, after the checks of `gmsh` (which also writes),
those of Abaqus and CalculiX by the folder `decks`, those of Salome by `med` and Nastran's by
`nastran`, all of which hand over a mesh as in `file_mesh`; `node_fields` reads values at nodes;
`straightening` says what straight edges in place of curved ones change.
"""

from skfem_joint.mesh.building import build_bar as build_bar
from skfem_joint.mesh.building import build_box as build_box
from skfem_joint.mesh.building import build_plate as build_plate
from skfem_joint.mesh.gmsh import write_mesh as write_mesh
from skfem_joint.mesh.named import NamedMesh as NamedMesh
from skfem_joint.mesh.named import merged as merged
from skfem_joint.mesh.named import named as named
from skfem_joint.mesh.named import refined as refined
from skfem_joint.mesh.reading import load_meshes as load_meshes
