"""Mesh files through checks and meshio: cells, groups and names as the file means them."""

from __future__ import annotations

import contextlib
import io
import re
import struct
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.files import read_whole
from skfem_joint.gmsh_file import check_msh, without_entities

if TYPE_CHECKING:
    import meshio

__all__ = ["cell_sets", "lost_groups", "name_problems", "read_mesh"]

IntArray = NDArray[np.int64]


def read_mesh(file: Path, dimension: int) -> meshio.Mesh:
    """Mesh as meshio reads it, every failure of which is turned into an InputError.

    Parameters
    ----------
    file : Path
        Gmsh (.msh) or Abaqus (.inp) file.
    dimension : int
        Largest dimension of the cells that a Gmsh file may hold: 1 for bars, 2 for plates as well.

    Raises
    ------
    InputError
        The file is missing, empty, cut or damaged, or holds cells that are not allowed.
    """
    import meshio

    if not file.exists():
        raise InputError(f"{file}: no such mesh file")
    if not file.is_file():
        raise InputError(f"{file}: not a file; a mesh file is needed, e.g. a Gmsh .msh")
    # What meshio's parsers let through on damaged input, besides its own ReadError and exit.
    failures = (
        *(SystemExit, meshio.ReadError, struct.error),
        *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError),
        *(MemoryError, NameError, OSError, RuntimeError, TypeError, ValueError),
    )
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            data = read_whole(file)
            if not data:
                raise ValueError("the file is empty")
            if file.suffix.lower() == ".msh":
                groups = check_msh(data, dimension)
                if groups is None:
                    return meshio.read(file, file_format="gmsh")
                return _read_by_entities(data, groups)
            if file.suffix.lower() != ".inp":
                raise ValueError(f"{file.suffix or 'no suffix'} is no known kind of mesh file")
            return meshio.read(file, file_format="abaqus")
    except failures as error:
        reason = str(error) or type(error).__name__
        if isinstance(error, SystemExit):
            reason = " ".join(said.getvalue().split())
        elif isinstance(error, LookupError):
            reason = f"it refers to something that it does not define ({error})"
        raise InputError(
            f"{file}: cannot be read as a mesh: {reason}. Readable are whole Gmsh files of format "
            "2.2 or 4.1 (.msh) and Abaqus files (.inp)"
        ) from error


def _read_by_entities(data: bytes, groups: dict[tuple[int, int], set[int]]) -> meshio.Mesh:
    """Gmsh 4.1 with the groups of each entity given.

    meshio itself refuses a file in which some entities belong to no group, and empties a group
    whose curves are reversed (negative tags), so that it is shown the file without entities.
    """
    import meshio

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mesh.msh"
        copy.write_bytes(without_entities(data))
        raw = meshio.read(copy, file_format="gmsh")
    members: dict[str, list[IntArray]] = {name: [] for name in raw.field_data}
    for block, entity in zip(raw.cells, raw.cell_data["gmsh:geometrical"], strict=True):
        tags = groups[block.dim, int(entity[0])] if len(entity) else set()
        for name, (tag, dimension) in raw.field_data.items():
            inside = dimension == block.dim and int(tag) in tags
            members[name].append(np.arange(len(block.data) if inside else 0))
    raw.cell_sets = members
    return raw


def cell_sets(raw: meshio.Mesh) -> dict[str, list[IntArray]]:
    """Cell indices of each named set in each block of cells."""
    sets = {
        name: [np.asarray([] if m is None else m, dtype=np.int64).ravel() for m in members]
        for name, members in raw.cell_sets.items()
        if not name.startswith("gmsh:")  # bounding entities, which are no cells
    }
    if "gmsh:physical" not in raw.cell_data:
        return sets
    for name, (tag, dimension) in _physical_groups(raw).items():
        if name not in sets:  # format 2.2 names no cell sets
            sets[name] = [
                np.flatnonzero(tags == tag) if block.dim == dimension else np.empty(0, np.int64)
                for block, tags in zip(raw.cells, raw.cell_data["gmsh:physical"], strict=True)
            ]
    return sets


def lost_groups(raw: meshio.Mesh, dimension: int, found: Iterable[str]) -> str | None:
    """Sentence on the groups of up to a dimension that hold nothing, None if there are none."""
    known = set(found)
    lost = [
        name
        for name, (_, size) in _physical_groups(raw).items()
        if size <= dimension and name not in known
    ]
    if not lost:
        return None
    return (
        f"groups without elements: {', '.join(lost)}. Gmsh loses them when a file of format "
        "2.2 is saved with Mesh.SaveAll; save it without, or take the names out"
    )


def _physical_groups(raw: meshio.Mesh) -> dict[str, tuple[int, int]]:
    """Tag and dimension of Gmsh's physical groups by name; empty for other formats."""
    gmsh = "gmsh:dim_tags" in raw.point_data or any(k.startswith("gmsh:") for k in raw.cell_data)
    return {name: (int(v[0]), int(v[1])) for name, v in raw.field_data.items()} if gmsh else {}


def name_problems(**names: Iterable[str]) -> list[str]:
    """Names that cannot stand in a file, or that stand for things of two kinds.

    Parameters
    ----------
    **names : iterable of str
        Names by kind of thing, e.g. ``region=...``, ``point=...``.
    """
    kinds: dict[str, list[str]] = {}
    for kind, given in names.items():
        for name in dict.fromkeys(given):
            kinds.setdefault(name, []).append(kind)
    problems = [
        f"name {name!r}: names may not be empty nor hold quotes, backslashes or control characters"
        for name in sorted(kinds)
        if not name.strip() or re.search(r'["\\\x00-\x1f\x7f]', name)
    ]
    problems += [
        f"name {name!r} is both a {' and a '.join(kinds[name])}: give each its own"
        for name in sorted(kinds)
        if len(kinds[name]) > 1
    ]
    return problems
