"""Imports go one way: from a folder to those before it in the list, and in no circle inside one.

Imports that serve annotations alone count like all others.
"""

import ast
import subprocess
import sys
from functools import cache
from inspect import isfunction
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

import skfem_joint

PACKAGE = Path(skfem_joint.__file__).parent
#: A module may import from its own folder and from those before it; "" is that of the commands.
FOLDERS = [
    *("ground", "matrix_files", "linalg", "system", "mesh", "body", "joint", "structure"),
    *("minimise", "stepping"),
    *("slow", "steady", "runs", "reduction", "scene", "reduction.scaled", "results", "accuracy"),
    *("vibration", "harmonic", "fitting", "study", "output", ""),
]
MODULES = dict.fromkeys(
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    for path in sorted(PACKAGE.rglob("*.py"))
)
HEAVY = {"meshio", "pyvista", "vtk", "vtkmodules", "matplotlib", "rich", "distributed", "pyarrow"}
HEAVY |= {"tomlkit", "h5py", "pandas"}


def path_of(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")).with_suffix(".py")


@cache
def tree_of(module: str) -> ast.Module:
    return ast.parse(path_of(module).read_text(encoding="utf-8"))


@cache
def imported(module: str, tree: ast.AST) -> set[str]:
    """Modules of the package that a module imports, at its top or inside functions."""
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert not node.level, f"{module}: imports name the package in full"
            full = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= full
            # `from skfem_joint.mesh import cells` needs the module, not what the folder's init has.
            if not all(name.removeprefix("skfem_joint.") in MODULES for name in full):
                names.add(str(node.module))
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    inside = {name.removeprefix("skfem_joint.") for name in names if name.startswith("skfem_joint")}
    modules = {name for name in inside if name in MODULES}
    return modules | {f"{name}.__init__" for name in inside if f"{name}.__init__" in MODULES}


def place(module: str) -> int:
    folder = module.rpartition(".")[0]
    return FOLDERS.index(
        folder.removesuffix(".ranges").removesuffix(".drawing").removesuffix(".decks")
    )


def test_modules_import_only_from_their_own_folder_and_those_before():
    too_late = [
        f"{module} must not import {name}"
        for module in MODULES
        if module != "__init__"
        for name in sorted(imported(module, tree_of(module)) - {"__init__"})
        if place(name) > place(module)
    ]
    assert not too_late


def test_imports_run_in_no_circle():
    """A circle is a set of modules each of which leads to each other by imports."""
    reached = {module: imported(module, tree_of(module)) for module in MODULES}
    # `skfem_joint` itself imports all for its annotations, and is imported by name alone.
    reached = {module: names - {"__init__", module} for module, names in reached.items()}
    for through in MODULES:
        for module in MODULES:
            if through in reached[module]:
                reached[module] |= reached[through]
    circles = {
        frozenset(name for name in reached[module] if module in reached[name])
        for module in MODULES
        if module != "__init__" and module in reached[module]
    }
    assert not circles


def test_the_paper_s_scaled_modes_are_reached_by_one_lazy_import():
    scaled = {name for name in MODULES if name.startswith("reduction.scaled")}
    outside = {name: imported(name, tree_of(name)) & scaled for name in set(MODULES) - scaled}
    reach = {name: found for name, found in outside.items() if found}
    assert reach == {"study.models": {"reduction.scaled.basis"}}
    top = ast.Module(body=tree_of("study.models").body, type_ignores=[])
    top.body = [node for node in top.body if not isinstance(node, ast.FunctionDef)]
    assert not imported("study.models", top) & scaled


def test_heavy_libraries_are_imported_only_where_they_are_used():
    found = set()
    for module in MODULES:
        for node in tree_of(module).body:
            if isinstance(node, ast.Import):
                found |= {(module, alias.name.split(".")[0]) for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add((module, str(node.module).split(".")[0]))
    assert not [pair for pair in found if pair[1] in HEAVY]


def test_the_public_names_are_there_and_cost_nothing_until_they_are_used():
    for name in skfem_joint.__all__:
        assert getattr(skfem_joint, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        skfem_joint.nothing  # noqa: B018
    for use, left in (("", {"numpy", "scipy", "skfem", "numba", "pydantic"}),
                      ("skfem_joint.load_scene;", {"numba", "pyvista", "matplotlib"})):  # fmt: skip
        code = f"import sys, skfem_joint; {use} print(*(m for m in sys.modules if '.' not in m))"
        ended = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        assert not left & set(ended.stdout.split())
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
    assert {kind.__name__ for kind in named} <= set(skfem_joint.__all__)
    assert all(getattr(skfem_joint, kind.__name__) is kind for kind in named)
