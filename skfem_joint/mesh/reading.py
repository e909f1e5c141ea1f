"""Reads mesh files of lines, triangles, quadrilaterals, tetrahedra, hexahedra or prisms.

Files of Abaqus and CalculiX are read by `skfem_joint.mesh.decks.abaqus`, MED files by
`skfem_joint.mesh.med`, Nastran's by `skfem_joint.mesh.nastran`. meshio reads those of Gmsh, since
``skfem.Mesh.load`` projects inclined bars onto x, keeps cells that a file holds twice, loses groups
inside a mesh and boundaries of second-order files, and drops a kind of cell if a file mixes two.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import struct
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.files import read_whole
from skfem_joint.ground.values import POSITIVE, several
from skfem_joint.mesh.cells import CELLS, TOLERANCE, Cell, distinct, same_columns, spot
from skfem_joint.mesh.collapsed import joined
from skfem_joint.mesh.decks.abaqus import read_inp
from skfem_joint.mesh.file_mesh import FileMesh
from skfem_joint.mesh.gmsh import PRISM_18, Groups, check_msh, meshio_with_prisms
from skfem_joint.mesh.med import read_med
from skfem_joint.mesh.named import (
    NamedMesh,
    check_finite,
    facet_numbers,
    from_parts,
    merged,
    not_a_side,
)
from skfem_joint.mesh.nastran import read_nastran
from skfem_joint.mesh.straightening import at_nodes_of, straightening

if TYPE_CHECKING:
    import meshio


#: Readers of the package by the endings of files; Gmsh's have any other.
_READERS: dict[str, Callable[[Path], FileMesh]] = {
    **{".inp": read_inp, ".med": read_med},
    **dict.fromkeys((".bdf", ".nas", ".dat"), read_nastran),
}


def load_meshes(paths: str | Path | Sequence[str | Path], scale: float = 1.0) -> NamedMesh:
    """Read a mesh from files of lines, triangles, quadrilaterals, tetrahedra, hexahedra or prisms.

    Gmsh files of format 2.2 or 4.1, ASCII or binary, are read: physical groups of the elements
    become regions, those of their sides boundaries, physical points points; of a bar several
    points with one name are a boundary. Files of Abaqus and CalculiX (.inp) are read, with element
    sets as regions, surfaces as boundaries, and node sets as points, or as boundaries where their
    nodes make up whole sides; the instance stands before a dot where several have a name;
    materials, steps and contact are passed over with a note. MED files (.med, by h5py) are read
    with their groups, and Nastran's bulk data (.bdf, .nas, .dat) with a region or boundary for each
    property, such as PSOLID_3 and PSHELL_7. Bodies that share no nodes, in the
    same file or in several, stay separate even if they overlap. A file of lines is a straight bar
    in space; its first end is that with the lexicographically smaller position. Plane meshes lie in
    a plane z = const. Prisms may stand beside hexahedra, and triangles beside quadrilaterals, in
    one body and in several.

    Repairs: cells that a file repeats for each of their groups are merged and belong to all these
    groups; nodes that no element uses are dropped; mirrored elements are turned over; lines of
    higher order are split at their inner nodes. Other second-order elements keep their order and
    corners. Their edges are made straight; ``notes`` report curved edges.
    Groups without a name are left out.

    Parameters
    ----------
    paths : str or Path, or a sequence of them
        Mesh file, or several with the same order of elements, of kinds that go together, and with
        different names; see `merged`.
    scale : float
        Metres per unit of length of the files, e.g. 1e-3 for meshes drawn in mm.

    Returns
    -------
    NamedMesh

    Raises
    ------
    InputError
        A file is missing, cut or damaged, or holds no mesh as described; elements without size,
        not convex, crossing themselves or overlapping in a body; bodies that touch in a point or
        an edge; nodes that hang on edges or faces of others; bars that are curved, branched,
        closed, folded or disconnected; unmerged nodes of a body; middle nodes in another order;
        groups without elements; points on several nodes; names used twice.
    """
    paths = several(
        "paths", [paths] if isinstance(paths, str | os.PathLike) else paths, str | os.PathLike
    )
    if not paths:
        raise InputError("no mesh file is given: name a file, or several for several bodies")
    if scale not in POSITIVE:
        files = ", ".join(map(str, paths))
        raise InputError(f"scale of mesh {files} is {scale}: it must be positive and finite")
    meshes: list[NamedMesh] = []
    problems: list[str] = []
    for file in map(Path, paths):
        try:
            meshes += _meshes_of(file, scale)
        except InputError as error:
            problems += error.problems
        except ValueError as error:
            problems.append(f"{file}: {error}")
    refuse(problems)
    return meshes[0] if len(meshes) == 1 else merged(meshes)


def _meshes_of(file: Path, scale: float) -> list[NamedMesh]:
    """Meshes of a file: each bar of an Abaqus file, or all that it holds."""
    if not file.is_file():
        wrong = "not a file" if file.exists() else "no such mesh file"
        raise InputError(f"{file}: {wrong}; a mesh file is needed, e.g. a Gmsh .msh")
    read = _READERS.get(file.suffix.lower())
    if read is None:
        return [_named_mesh(_read(file), str(file), scale)]
    found = read(file)
    meshes = [_named_mesh(body, str(file), scale) for body in found.bodies]
    notes = tuple(f"{file}: {note}" for note in found.notes)
    return [replace(each, notes=each.notes + notes, plane=found.plane) for each in meshes]


def _read(file: Path) -> meshio.Mesh:
    """Mesh as meshio reads it, with the groups as cell sets and the file's numbering of nodes.

    Every failure becomes an InputError. meshio prints about files that it cannot parse and ends the
    process: both are caught.
    """
    import meshio

    data = read_whole(file)
    # Exceptions that meshio's parsers raise for damaged files, besides its own ReadError and exit.
    failures = (
        *(SystemExit, meshio.ReadError, struct.error),
        *(ArithmeticError, AssertionError, AttributeError, EOFError, LookupError),
        *(MemoryError, NameError, OSError, RuntimeError, TypeError, ValueError),
        DeprecationWarning,
    )
    printed = io.StringIO()
    try:
        with (
            contextlib.redirect_stdout(printed),
            contextlib.redirect_stderr(printed),
            warnings.catch_warnings(),
        ):
            # numpy 2 refuses such texts; version 1 warns and goes on with other numbers.
            for damage in ("string or file could not be read", "NumPy will stop allowing"):
                warnings.filterwarnings("error", damage, DeprecationWarning)
            content, tags, groups = check_msh(data)
            raw = _through_meshio(content)
            raw.cell_sets = _members(raw, groups)
            order = np.argsort(tags)  # nodes are numbered as in the file
            raw.points = raw.points[order]
            for block in raw.cells:
                block.data = np.argsort(order)[block.data]
                if block.type == "wedge18":
                    block.data = block.data[:, PRISM_18]
    except failures as error:
        reason = str(error) or type(error).__name__
        if isinstance(error, SystemExit):
            reason = " ".join(printed.getvalue().split())
        elif isinstance(error, LookupError):
            reason = f"it refers to something that it does not define ({error})"
        raise InputError(
            f"{file}: cannot be read as a mesh: {reason}. Readable are whole Gmsh files of format "
            "2.2 or 4.1 (.msh) and files of Abaqus or CalculiX (.inp), Salome (.med) or Nastran "
            "(.bdf, .nas, .dat). Gmsh converts others, e.g. gmsh mesh.cgns -save -o mesh.msh"
        ) from error
    return raw


def _through_meshio(content: bytes) -> meshio.Mesh:
    """Mesh that meshio reads from a file with this content."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "mesh"
        copy.write_bytes(content)
        mesh: meshio.Mesh = meshio_with_prisms().read(copy, file_format="gmsh")
        return mesh


def _members(raw: meshio.Mesh, entities: Groups | None) -> dict[str, dict[int, IntArray]]:
    """Cells of each named physical group: numbers within a block, by number of the block."""
    members: dict[str, dict[int, IntArray]] = {name: {} for name in raw.field_data}
    names: dict[tuple[int, int], list[str]] = {}
    for name, (tag, dim) in raw.field_data.items():
        names.setdefault((int(dim), int(tag)), []).append(name)
    for number, block in enumerate(raw.cells):
        inside: dict[int, IntArray] = {}  # by tag
        if entities is not None and len(block.data):
            entity = int(raw.cell_data["gmsh:geometrical"][number][0])
            groups = entities.get((block.dim, entity), ())  # an entity that is not listed has none
            inside = dict.fromkeys(groups, np.arange(len(block.data)))
        elif "gmsh:physical" in raw.cell_data:
            tags = np.abs(raw.cell_data["gmsh:physical"][number])
            order = np.argsort(tags, kind="stable")
            values, first = np.unique(tags[order], return_index=True)
            parts = np.split(order, first[1:])
            inside = dict(zip(values.tolist(), parts, strict=True)) if values.size else {}
        for tag, cells in inside.items():
            for name in names.get((block.dim, tag), ()):
                members[name][number] = cells
    return members


class _Elements(NamedTuple):
    """Elements of a file.

    Attributes
    ----------
    blocks : list of (Cell, ndarray of int, shape (nodes, n))
        Kind and nodes, in scikit-fem's order, of the elements of each block of a file.
    order : int
    own : list of ndarray of int
        Elements (cells, parts) of each block of a file; none of a block of other cells. A line of
        higher order is split into parts at its inner nodes. Other cells have one part.
    """

    blocks: list[tuple[Cell, IntArray]]
    order: int
    own: list[IntArray]


def _elements(raw: meshio.Mesh) -> _Elements:
    """Elements of a file; ValueError for kinds that are not read, and orders that differ."""
    from skfem.io.meshio import INV_HEX_MAPPING

    kinds = {  # by meshio's name, without the number of nodes that it ends with in second order
        "line": "line",
        "triangle": "triangle",
        "quad": "quadrilateral",
        "tetra": "tetrahedron",
        "hexahedron": "hexahedron",
        "wedge": "prism",
    }
    top = max((block.dim for block in raw.cells if len(block.data)), default=0)
    types = sorted({block.type for block in raw.cells if block.dim == top and len(block.data)})
    if top == 0:
        raise ValueError(
            "it holds neither lines (a bar) nor triangles or quadrilaterals (a plate), tetrahedra, "
            "hexahedra or prisms (a solid). In Gmsh, mesh the curves, surfaces or volumes, and "
            "save elements of named groups or all"
        )
    names = {each: each.rstrip("0123456789") for each in types}
    orders = {1 if top == 1 else 1 + (name != each) for each, name in names.items()}
    if len(orders) > 1:
        raise ValueError(
            f"it mixes cells of type {' and '.join(types)}: all elements of a mesh must have the "
            "same order"
        )
    if not set(names.values()) <= set(kinds):
        raise ValueError(f"it holds {' and '.join(types)}: allowed are {', '.join(kinds)}")
    blocks, own, count = [], [], 0
    for block in raw.cells:
        nodes = np.asarray(block.data, dtype=np.intp)
        if block.dim == top == 1:  # two ends, then inner nodes from the first end to the second
            nodes = nodes[:, [0, *range(2, nodes.shape[1]), 1]]
            nodes = np.stack([nodes[:, :-1], nodes[:, 1:]], axis=-1).reshape(-1, 2)
        if block.dim == top and len(nodes):
            cell = CELLS[kinds[names[block.type]]]
            rows = INV_HEX_MAPPING[: nodes.shape[1]] if cell.sign < 0 else slice(None)
            blocks.append((cell, nodes.T[rows]))
            count += len(nodes)
        own.append(np.arange(count - len(nodes), count).reshape(len(block.data), -1))
    return _Elements(blocks, orders.pop(), own)


def _groups(
    raw: meshio.Mesh, cell: Cell, elements: _Elements
) -> tuple[dict[str, IntArray], dict[str, IntArray], list[str]]:
    """Groups of a file.

    Returns
    -------
    regions : dict of str to ndarray, shape (n,)
        Elements by name.
    others : dict of str to ndarray, shape (n, corners)
        Nodes of the sides, or of the point, by name.
    left_out : list of str
        Names of groups of lines in a solid.
    """
    corners_of = {"line": 2, "tria": 3, "quad": 4}  # by the first letters of meshio's name
    allowed = {n for kind, _ in elements.blocks for n in kind.corners_of_sides}
    own, rows = elements.own, max(cell.corners_of_sides)
    regions: dict[str, IntArray] = {}
    others = {name: np.reshape(nodes, (-1, 1)) for name, nodes in raw.point_sets.items()}
    left_out, lost = [], []
    for name, blocks in raw.cell_sets.items():
        blocks = blocks if isinstance(blocks, dict) else dict(enumerate(blocks))
        inside = [i for i, members in blocks.items() if members is not None and len(members)]
        dim = raw.cells[inside[0]].dim if inside else -1
        if dim == cell.dim:
            regions[name] = np.concatenate([own[i][blocks[i]].ravel() for i in inside])
        elif 0 < dim < cell.dim - 1:
            left_out.append(name)
        elif dim >= 0:
            count = [corners_of[raw.cells[i].type[:4]] if dim else 1 for i in inside]
            if dim and not set(count) <= allowed:
                raise ValueError(f"group {name!r} holds cells that are no sides of its elements")
            # The last corner of a triangle stands twice beside quadrilaterals.
            corners = [np.minimum(range(rows if dim else 1), n - 1) for n in count]
            others[name] = np.concatenate(
                [raw.cells[i].data[blocks[i]][:, n] for i, n in zip(inside, corners, strict=True)]
            )
        elif raw.field_data.get(name, (0, 0))[1] <= cell.dim:
            lost.append(name)
    if lost:
        raise ValueError(
            f"groups without elements: {', '.join(lost)}. Gmsh loses them when a file of format "
            "2.2 is saved with Mesh.SaveAll; save it without, or take the names out"
        )
    return regions, others, left_out


def _named_mesh(raw: meshio.Mesh, path: str, scale: float) -> NamedMesh:
    """Named mesh of a file that meshio has read; ValueError says why there is none."""
    elements = _elements(raw)
    cell, corners = joined([(kind, nodes[: kind.corners]) for kind, nodes in elements.blocks])
    position = np.zeros((len(raw.points), 3))
    position[:, : raw.points.shape[1]] = raw.points
    position *= scale
    check_finite(position)
    regions, others, left_out = _groups(raw, cell, elements)
    first, set_of = same_columns(distinct(corners))  # cells are repeated for each group
    kept = np.sort(first)
    number = np.searchsorted(kept, first)[set_of]
    used = np.zeros(len(position), dtype=np.bool_)
    used[corners] = True
    vertex = np.where(used, np.cumsum(used) - 1, -1)
    _check_sides(others, vertex, position, cell.dim)
    single = {name for name, parts in others.items() if np.unique(parts).size == 1}
    sides = {n: vertex[parts.T] for n, parts in others.items() if n not in single}
    t = np.ascontiguousarray(vertex[corners[:, kept]])
    p = np.ascontiguousarray(_plain(position[used], t, cell.dim))
    mesh = from_parts(
        cell,
        p,
        t,
        xyz=position[used],
        order=elements.order,
        regions={name: number[members] for name, members in regions.items()},
        facets=sides,
        points={n: int(vertex[parts[0, 0]]) for n, parts in others.items() if n in single},
    )
    if cell.dim == 1 and mesh.body.max():
        beyond = int(np.argmax(mesh.body == 1))
        ends = mesh.mesh.t[[1, 0], [beyond - 1, beyond]]
        raise ValueError(
            f"the bar is disconnected: no element joins {spot(*mesh.coordinates[ends])}"
        )
    notes = [f"group {name!r} of lines in a solid is left out" for name in left_out]
    held = np.concatenate([nodes.ravel() for _, nodes in elements.blocks])
    for block in raw.cells:
        lower = 0 < block.dim < cell.dim
        apart = ~np.isin(block.data, held).all(axis=1) if lower else np.zeros(0)
        if apart.any():
            notes.append(
                f"{np.count_nonzero(apart)} cells of type {block.type} have nodes that no "
                f"{cell.name} has: they are left out, with their mass and stiffness"
            )
    if elements.order == 2:
        straight = cell.mesh(p, t, sort_t=False)
        curved = [(kind, position.T[: cell.dim, nodes]) for kind, nodes in elements.blocks]
        boundaries = facet_numbers(straight.facets, sides, position[used])
        notes += straightening(straight, at_nodes_of(cell, curved)[..., kept], boundaries)
    notes = [f"{path}: {note}" for note in notes]
    return replace(mesh, path=path, notes=tuple(notes))


def _check_sides(
    others: Mapping[str, IntArray], vertex: IntArray, position: FloatArray, dim: int
) -> None:
    """Refuse groups of sides or points with nodes of no element, and points on several nodes.

    ``vertex`` is the vertex at each node, -1 for nodes without one. Several nodes of a bar, in
    ``dim`` = 1, are a boundary.
    """
    for name, parts in others.items():
        off = (vertex[parts] < 0).any(axis=1)
        if off.any():
            raise ValueError(not_a_side(name, position[parts[np.argmax(off)]]))
        count = np.unique(parts).size
        if count == 0 or (parts.shape[1] == 1 < min(count, dim)):
            raise ValueError(f"point name {name!r} marks {count} nodes: give each its own")


def _plain(xyz: FloatArray, t: IntArray, dim: int) -> FloatArray:
    """Positions (dim, n) in the dimension of the mesh, from those in space (n, 3).

    They are arc lengths along a bar, and x and y of a plane mesh. ValueError if the nodes do not
    lie on a line, or in a plane z = const.
    """
    if dim == 3:
        return xyz.T
    if dim == 2:
        low, high = xyz.min(axis=0), xyz.max(axis=0)
        if high[2] - low[2] > TOLERANCE * (high - low)[:2].max():
            spread = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)
            cure = "turn it into the x-y plane"
            if not np.ptp(xyz[t, 2], axis=0).any():
                cure = "give bodies in different planes as different files"
            elif spread[2] > 1e-6 * spread[0]:
                cure = (
                    "if its surfaces bound a solid, name the volume: in Gmsh give each volume a "
                    "Physical Volume, without which its elements are not written"
                )
            raise ValueError(
                f"the mesh is not in a plane z = const: z runs from {low[2]:.9g} to {high[2]:.9g} "
                f"m; {cure}"
            )
        return xyz[:, :2].T
    start, axis = _line(xyz)
    position = (xyz - start) @ axis
    off = np.linalg.norm(xyz - start - position[:, np.newaxis] * axis, axis=1)
    allowed = TOLERANCE * float(position.max())
    if off.max() > allowed:
        worst = int(np.argmax(off))
        raise ValueError(
            f"the bar is not straight: {spot(xyz[worst])} is {off[worst]:.3g} m off the line "
            f"between the farthest nodes; {allowed:.1g} m are allowed. If its lines bound a plate "
            "or a solid, name that: in Gmsh give it a Physical Surface or Physical Volume"
        )
    return np.asarray(position[np.newaxis])


def _line(xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First end of a bar and the unit vector along it.

    Its ends are the farthest nodes along the coordinate axis on which it is longest.
    """
    axis = int(np.argmax(np.ptp(xyz, axis=0)))
    a, b = int(np.argmin(xyz[:, axis])), int(np.argmax(xyz[:, axis]))
    along = xyz[b] - xyz[a]
    length = math.hypot(*along)
    if length == 0.0:
        raise ValueError("the bar has no length: all its nodes lie in one place")
    # Lexicographic order of the ends, in which round-off in a shared coordinate does not count.
    if along[np.argmax(np.abs(along) > TOLERANCE * length)] < 0.0:
        a, along = b, -along
    return xyz[a], along / length


def group_nodes(file: Path, name: str) -> tuple[IntArray, FloatArray]:
    """Nodes of a physical group of a Gmsh file, and their places (k, 3) in its unit.

    The nodes, (k,), count from 0 in the order of their numbers in the file. InputError if the file
    cannot be read, or has no such group.
    """
    raw = _read(file)
    groups = {group: blocks for group, blocks in raw.cell_sets.items() if blocks}
    if name not in groups:
        raise InputError(f"{file}: found no group {name!r}; it has {', '.join(groups) or 'none'}")
    cells = (raw.cells[block].data[own].ravel() for block, own in groups[name].items())
    nodes = np.unique(np.concatenate([*cells]))
    return nodes, np.asarray(raw.points[nodes], dtype=np.float64)
