"""Reads mesh files of lines, triangles, quadrilaterals, tetrahedra, hexahedra or prisms.

Files of Gmsh are read by `skfem_joint.mesh.gmsh`, those of Abaqus and CalculiX by
`skfem_joint.mesh.decks.abaqus`, MED files by `skfem_joint.mesh.med`, Nastran's by
`skfem_joint.mesh.nastran`. ``skfem.Mesh.load`` projects inclined bars onto x, keeps cells that a
file holds twice, loses groups inside a mesh and boundaries of second-order files, and drops a kind
of cell if a file mixes two. meshio allocates memory for any count that a file states, takes a wrong
node if an element refers to a missing one, keeps the last of two groups with one name, refuses
files in which some entities belong to no group, and empties groups of reversed curves.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.values import POSITIVE, several
from skfem_joint.mesh.cells import CELLS, TOLERANCE, Cell, distinct, same_columns, spot
from skfem_joint.mesh.collapsed import joined
from skfem_joint.mesh.decks.abaqus import read_inp
from skfem_joint.mesh.file_mesh import FileMesh, RawMesh
from skfem_joint.mesh.gmsh import read_msh
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

#: Readers by the endings of files; Gmsh's have any other.
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
    found = _READERS.get(file.suffix.lower(), read_msh)(file)
    meshes = [_named_mesh(body, str(file), scale) for body in found.bodies]
    notes = tuple(f"{file}: {note}" for note in found.notes)
    return [replace(each, notes=each.notes + notes, plane=found.plane) for each in meshes]


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


def _elements(raw: RawMesh) -> _Elements:
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
    top = raw.top
    chosen = [block for block in raw.blocks if block.dim == top and len(block.nodes)]
    types = sorted({block.type for block in chosen})
    if top == 0:
        raise ValueError(
            "it holds neither lines (a bar) nor triangles or quadrilaterals (a plate), tetrahedra, "
            "hexahedra or prisms (a solid). In Gmsh, mesh the curves, surfaces or volumes, and "
            "save elements of named groups or all"
        )
    orders = {1 if top == 1 else 1 + (block.shape != block.type) for block in chosen}
    if len(orders) > 1:
        raise ValueError(
            f"it mixes cells of type {' and '.join(types)}: all elements of a mesh must have the "
            "same order"
        )
    if not {block.shape for block in chosen} <= set(kinds):
        raise ValueError(f"it holds {' and '.join(types)}: allowed are {', '.join(kinds)}")
    blocks, own, count = [], [], 0
    for block in raw.blocks:
        nodes = block.nodes
        if block.dim == top == 1:  # two ends, then inner nodes from the first end to the second
            nodes = nodes[:, [0, *range(2, nodes.shape[1]), 1]]
            nodes = np.stack([nodes[:, :-1], nodes[:, 1:]], axis=-1).reshape(-1, 2)
        if block.dim == top and len(nodes):
            cell = CELLS[kinds[block.shape]]
            rows = INV_HEX_MAPPING[: nodes.shape[1]] if cell.sign < 0 else slice(None)
            blocks.append((cell, nodes.T[rows]))
            count += len(nodes)
        own.append(np.arange(count - len(nodes), count).reshape(len(block.nodes), -1))
    return _Elements(blocks, orders.pop(), own)


def _groups(
    raw: RawMesh, cell: Cell, elements: _Elements
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
    others = {name: np.reshape(nodes, (-1, 1)) for name, nodes in raw.node_sets.items()}
    left_out, lost = [], []
    for name, blocks in raw.cell_sets.items():
        inside = [*blocks]
        dim = raw.blocks[inside[0]].dim if inside else -1
        if dim == cell.dim:
            regions[name] = np.concatenate([own[i][blocks[i]].ravel() for i in inside])
        elif 0 < dim < cell.dim - 1:
            left_out.append(name)
        elif dim >= 0:
            count = [corners_of[raw.blocks[i].type[:4]] if dim else 1 for i in inside]
            if dim and not set(count) <= allowed:
                raise ValueError(f"group {name!r} holds cells that are no sides of its elements")
            # The last corner of a triangle stands twice beside quadrilaterals.
            corners = [np.minimum(range(rows if dim else 1), n - 1) for n in count]
            others[name] = np.concatenate(
                [raw.blocks[i].nodes[blocks[i]][:, n] for i, n in zip(inside, corners, strict=True)]
            )
        else:
            lost.append(name)
    if lost:
        raise ValueError(
            f"groups without elements: {', '.join(lost)}. Gmsh loses them when a file of format "
            "2.2 is saved with Mesh.SaveAll; save it without, or take the names out"
        )
    return regions, others, left_out


def _named_mesh(raw: RawMesh, path: str, scale: float) -> NamedMesh:
    """Named mesh of what a file holds; ValueError says why there is none."""
    elements = _elements(raw)
    cell, corners = joined([(kind, nodes[: kind.corners]) for kind, nodes in elements.blocks])
    position = scale * np.pad(raw.places, ((0, 0), (0, 3 - raw.places.shape[1])))
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
    for block in raw.blocks:
        lower = 0 < block.dim < cell.dim
        apart = ~np.isin(block.nodes, held).all(axis=1) if lower else np.zeros(0)
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
