"""Imports go one way: a module imports only from floors below its own."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import skfem_joint

PACKAGE = Path(skfem_joint.__file__).parent

#: Floor of each module, lowest first. A new module gets the lowest floor above all it imports; a
#: subpackage stands on one floor, and imports inside it must not run in a circle.
FLOORS = {
    "__init__": -1.0,
    "errors": 0.0,
    "files": 0.25,
    "vtk_files": 0.5,
    "bolts": 0.5,
    "offscreen": 0.5,
    "forms": 0.5,
    "friction": 0.5,
    "loads": 0.5,
    "contact": 1.0,
    "system": 2.0,
    "gmsh_file": 2.5,
    "mesh_file": 2.75,
    "meshing": 3.0,
    "plate_checks": 3.1,
    "plate_mesh": 3.25,
    "plate_file": 3.3,
    "plate_structure": 3.4,
    "plate_contact": 1.5,
    "plate": 3.5,
    "schemes": 3.0,
    "resolution": 3.9,
    "recording": 3.0,
    "chain": 3.0,
    "kernels_friction": 3.0,
    "kernels_fronts": 3.1,
    "kernels_tridiagonal": 3.25,
    "kernels_dense": 3.25,
    "kernels_contact": 3.25,
    "steppers_shared": 3.25,
    "contact_solver": 3.4,
    "steppers_contact": 3.45,
    "structure": 3.5,
    "two_bars": 3.6,
    "checkpoint": 3.5,
    "steppers": 3.5,
    "integrate": 4.0,
    "explicit": 4.0,
    "pod": 4.0,
    "active_length": 4.0,
    "pseudo_static": 4.0,
    "reduction": 4.5,
    "hyper_reduction": 4.5,
    "plate_reduction": 4.75,
    "plate_doubts": 4.75,
    "history": 5.0,
    "reference": 5.0,
    "report": 6.0,
    "vtk": 6.0,
    "plot": 6.0,
    "plate_vtk": 6.0,
    "plate_plot": 6.25,
    "scene_messages": 6.5,
    "scene_values": 6.6,
    "scene_tables": 6.7,
    "scene_loads": 6.7,
    "scene_plates": 6.8,
    "scene_checks": 6.9,
    "scene": 7.0,
    "results": 7.2,
    "plate_study": 7.4,
    "study": 7.5,
    "plate_output": 7.5,
    "certificate": 7.6,
    "memory": 7.6,
    "output": 7.6,
    "paper": 7.7,
    "error_time": 7.75,
    "stability": 7.8,
    "reproduce": 7.9,
    "cli": 8.0,
    "__main__": 8.5,
}
MODULES = sorted(
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in PACKAGE.rglob("*.py")
)


def path_of(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")).with_suffix(".py")


def imported(tree: ast.AST) -> set[str]:
    """Modules of the package that a module imports, at its top or inside functions."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert not node.level, "imports name the package in full"
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    inside = {name.removeprefix("skfem_joint.") for name in names if name.startswith("skfem_joint")}
    return inside & set(MODULES)


def floor(module: str) -> float:
    top = module.split(".")[0]
    assert top in FLOORS, f"{top} is new: add it to FLOORS in {Path(__file__).name}"
    return FLOORS[top]


@pytest.mark.parametrize("module", MODULES)
def test_module_imports_only_from_below(module: str) -> None:
    tree = ast.parse(path_of(module).read_text(encoding="utf-8"))
    package = module.partition(".")[0] if "." in module else None
    too_high = sorted(
        name
        for name in imported(tree)
        if floor(name) >= floor(module) and name.partition(".")[0] != package
    )
    assert not too_high, f"{module} (floor {floor(module):g}) must not import {too_high}"


def test_imports_run_in_no_circle() -> None:
    graph = {
        module: imported(ast.parse(path_of(module).read_text(encoding="utf-8")))
        for module in MODULES
    }
    assert len(list(TopologicalSorter(graph).static_order())) == len(MODULES)


@pytest.mark.parametrize("module", MODULES)
def test_heavy_libraries_are_imported_only_where_they_are_used(module: str) -> None:
    heavy = {"meshio", "pyvista", "vtk", "vtkmodules", "matplotlib", "numba"}
    if module.startswith("kernels_"):
        heavy -= {"numba"}
    tree = ast.parse(path_of(module).read_text(encoding="utf-8"))
    found = set()
    for node in tree.body:
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").split(".")[0])
    assert not heavy & found
