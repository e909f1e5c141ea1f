"""Meshes with names: built, read and checked, merged, refined and written, in every dimension."""

from skfem_joint.mesh.building import build_bar, build_box, build_plate
from skfem_joint.mesh.gmsh import write_mesh
from skfem_joint.mesh.named import NamedMesh, merged, named, refined
from skfem_joint.mesh.reading import load_meshes

__all__ = [
    "NamedMesh",
    "build_bar",
    "build_box",
    "build_plate",
    "load_meshes",
    "merged",
    "named",
    "refined",
    "write_mesh",
]
