"""Imports go one way: a module imports only from floors below its own."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from inspect import isfunction
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

import skfem_joint

PACKAGE = Path(skfem_joint.__file__).parent
#: The floors, lowest first: the package's own modules, then its folders, then the command line.
FLOORS = ["", "mesh", "structure", "stepping", "reduction", "scene", "analysis", "output", "cli"]
MODULES = sorted(
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in PACKAGE.rglob("*.py")
)
HEAVY = {"meshio", "pyvista", "vtk", "vtkmodules", "matplotlib", "rich", "distributed", "pyarrow"}


def path_of(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")).with_suffix(".py")


def tree_of(module: str) -> ast.Module:
    return ast.parse(path_of(module).read_text(encoding="utf-8"))


def imported(module: str, tree: ast.AST) -> set[str]:
    """Modules of the package that a module imports, at its top or inside functions."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert not node.level, f"{module}: imports name the package in full"
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    inside = {name.removeprefix("skfem_joint.") for name in names if name.startswith("skfem_joint")}
    found = {name for name in inside if name in MODULES}
    return found | {f"{name}.__init__" for name in inside if f"{name}.__init__" in MODULES}


def floor(module: str) -> int:
    top = module.split(".")[0] if "." in module or module == "cli" else ""
    return len(FLOORS) if module in ("__init__", "__main__") else FLOORS.index(top)


@pytest.mark.parametrize("module", [name for name in MODULES if name != "__init__"])
def test_module_imports_only_from_its_own_floor_and_those_below(module):
    found = imported(module, tree_of(module)) - {"__init__"}
    too_high = sorted(name for name in found if floor(name) > floor(module))
    assert not too_high, f"{module} must not import {too_high}"


def test_imports_run_in_no_circle():
    graph = {
        module: {
            name
            for name in imported(module, _without_typing(tree_of(module)))
            if name not in ("__init__", module)
            # A module may import its own folder's other modules through their full names only.
            and name != f"{module.rpartition('.')[0]}.__init__"
        }
        for module in MODULES
        if module != "__init__"
    }
    assert len(list(TopologicalSorter(graph).static_order())) >= len(MODULES) - 1


def _without_typing(tree: ast.Module) -> ast.Module:
    tree.body = [
        node
        for node in tree.body
        if not (isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING")
    ]
    return tree


@pytest.mark.parametrize("module", MODULES)
def test_heavy_libraries_are_imported_only_where_they_are_used(module):
    found = set()
    for node in tree_of(module).body:
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add((node.module or "").split(".")[0])
    assert not HEAVY & found


def test_the_public_names_are_there_and_cost_nothing_until_they_are_used():
    for name in skfem_joint.__all__:
        assert getattr(skfem_joint, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        skfem_joint.nothing  # noqa: B018
    code = "import sys, skfem_joint; print(*(m for m in sys.modules if '.' not in m))"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "scipy", "skfem", "numba", "pydantic"} & set(ended.stdout.split())
    assert (PACKAGE / "py.typed").is_file()


def test_what_signatures_of_public_functions_name_is_public():
    named: set[type] = set()

    def collect(hint: object) -> None:
        if isinstance(hint, type) and hint.__module__.startswith("skfem_joint"):
            named.add(hint)
        for part in get_args(hint):
            collect(part)

    for name in skfem_joint.__all__:
        public = getattr(skfem_joint, name)
        for hint in get_type_hints(public).values() if isfunction(public) else ():
            collect(hint)
    assert len(named) > 10
    assert {one.__name__ for one in named} <= set(skfem_joint.__all__)
    assert all(getattr(skfem_joint, one.__name__) is one for one in named)
