"""Gmsh files: checks before meshio reads them, and a writer."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.values import check_kind
from skfem_joint.mesh.cells import Cell, cell_of, corner_count, same_columns
from skfem_joint.mesh.named import NamedMesh, check_count
from skfem_joint.mesh.splitting import split

# Number of nodes of each Gmsh element type that is read: points, lines of order 1 to 10, and
# triangles, quadrangles, tetrahedra, hexahedra and prisms of first and second order.
_NODES = {
    **{15: 1, 1: 2, 8: 3, 26: 4, 27: 5, 28: 6, 62: 7, 63: 8, 64: 9, 65: 10, 66: 11},
    **{2: 3, 9: 6, 3: 4, 16: 8, 10: 9, 4: 4, 11: 10, 5: 8, 17: 20, 12: 27, 6: 6, 18: 15, 13: 18},
}
# Gmsh element types that are written, by dimension, number of corners and order.
_TYPES = {
    **{(0, 1, 1): 15, (0, 1, 2): 15, (1, 2, 1): 1, (1, 2, 2): 8, (2, 3, 1): 2, (2, 3, 2): 9},
    **{(2, 4, 1): 3, (2, 4, 2): 10, (3, 4, 1): 4, (3, 4, 2): 11, (3, 8, 1): 5, (3, 8, 2): 12},
    **{(3, 6, 1): 6, (3, 6, 2): 13},
}
# Corners between which the nodes of a prism of 18 nodes lie, in Gmsh's order.
_BETWEEN = (
    *((0,), (1,), (2,), (3,), (4,), (5,), (0, 1), (0, 2), (0, 3), (1, 2), (1, 4), (2, 5)),
    *((3, 4), (3, 5), (4, 5), (0, 1, 4, 3), (0, 2, 5, 3), (1, 2, 5, 4)),
)
#: Order of VTK for the nodes of Gmsh's prism of 18 nodes, which meshio leaves in Gmsh's.
PRISM_18 = (0, 1, 2, 3, 4, 5, 6, 9, 7, 12, 14, 13, 8, 10, 11, 15, 17, 16)
#: Tags of the physical groups, without sign, by dimension and tag of the entity.
Groups = dict[tuple[int, int], set[int]]


class _Numbers:
    """Numbers of a section, read in turn; ValueError if fewer are left than are to be read."""

    def __init__(self, body: bytes, name: str, binary: bool) -> None:
        self.name, self.binary, self.position, self.body = name, binary, 0, body
        self.values: NDArray[Any] = np.frombuffer(body, "u1")
        if not binary:
            self.values = np.fromstring(body.decode("ascii"), sep=" ")

    def take(self, kind: str, count: int) -> NDArray[Any]:
        """Next ``count`` numbers, of a numpy type in binary files."""
        start = self.position
        self.position += count * (np.dtype(kind).itemsize if self.binary else 1)
        if count < 0 or self.position > self.values.size:
            raise ValueError(
                f"${self.name} announces more than it holds: the file is cut or damaged"
            )
        values = self.values[start : self.position]
        return np.frombuffer(values.tobytes(), kind) if self.binary else values

    def integers(self, kind: str, count: int) -> list[int]:
        """Next ``count`` whole numbers."""
        return [int(value) for value in self.take(kind, count)]

    def line(self) -> int:
        """Next number, which is written on a line of its own also in binary files."""
        if not self.binary:
            return self.integers("u8", 1)[0]
        text = self.values[:20].tobytes().partition(b"\n")[0]
        self.position = len(text) + 1
        return int(text)


def meshio_with_prisms() -> Any:
    """meshio, told of the prism of 15 nodes, which its table of dimensions has left out."""
    import meshio
    from meshio._mesh import topological_dimension

    topological_dimension.setdefault("wedge15", 3)
    return meshio


def check_msh(data: bytes) -> tuple[bytes, IntArray, Groups | None]:
    """Check a Gmsh file and leave out the sections that meshio would misread.

    Refused are files that meshio would read wrongly: it allocates memory for any count that a file
    states, takes a wrong node if an element refers to a missing node, keeps only the last of two
    groups with the same name, and reads beyond the end of a section that is cut off.

    Left out are entities, results and other sections: meshio refuses a file in which some entities
    belong to no group, and empties groups of reversed curves (negative tags).

    Returns
    -------
    content : bytes
        File for meshio.
    tags : ndarray of int
        Numbers of the nodes.
    groups : dict or None
        Physical groups of the entities, if the file has a section of entities.

    Raises
    ------
    ValueError
        Says why the file is refused.
    """
    sections = _sections(data.removeprefix(b"\xef\xbb\xbf"))
    version, mode, size = (word.decode("ascii") for word in sections["MeshFormat"].split()[:3])
    if version not in ("2", "2.2", "4.1"):  # Gmsh calls format 4.0 "4"
        raise ValueError(f"Gmsh format {version}; save it again with Mesh.MshFileVersion = 4.1")
    if mode not in ("0", "1") or size != "8":
        raise ValueError(f"unknown kind of Gmsh file: mode {mode}, data size {size}")
    names = re.findall(r'^\s*\d+\s+-?\d+\s+"(.*)"', sections["PhysicalNames"].decode(), re.M)
    check_count(len(names))
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(f"{count} groups are named {name!r}: give each its own")
    numbers = {name: _Numbers(sections[name], name, mode == "1") for name in ("Nodes", "Elements")}
    if version == "4.1":
        tags, used = _walk_41(**numbers)
    else:
        tags, used, sections["Elements"] = _walk_22(**numbers)
    groups: Groups | None = None
    if version == "4.1" and "Entities" in sections:
        groups = {}
        for name in ("Entities", "PartitionedEntities"):  # the latter are parts of the former
            if name in sections:
                groups |= _groups_of_entities(_Numbers(sections[name], name, mode == "1"))
    largest = max(10**6, len(data))  # meshio's table of nodes is as long as the largest tag
    if not np.all((tags >= 1) & (tags <= largest)):
        raise ValueError(f"$Nodes numbers nodes beyond 1 ... {largest}: renumber the mesh")
    known = np.zeros(largest + 1, dtype=np.bool_)
    known[tags.astype(np.intp)] = True
    if np.count_nonzero(known) != tags.size:
        raise ValueError("$Nodes uses a node number twice")
    unknown = used[~known[np.where((used > 0) & (used <= largest), used, 0).astype(np.intp)]]
    if unknown.size:
        raise ValueError(f"an element refers to node {unknown[0]:.0f}, which $Nodes does not hold")
    parts = (
        f"${name}\n".encode() + sections[name] + f"$End{name}\n".encode()
        for name in ("MeshFormat", "PhysicalNames", "Nodes", "Elements")
        if sections[name]
    )
    return b"".join(parts), tags.astype(np.intp), groups


def _sections(data: bytes) -> dict[str, bytes]:
    """Content of each section by its name."""
    sections = {"PhysicalNames": b""}
    position = 0
    while match := re.compile(rb"^\$(\w+)[ \t]*\r?\n", re.M).search(data, position):
        name = match[1].decode("ascii")
        position = data.find(b"$End" + match[1], match.end())
        if position < 0:
            raise ValueError(f"section ${name} is not closed by $End{name}: the file is cut")
        if sections.get(name) and not name.endswith(("Data", "Comments", "Scheme")):
            raise ValueError(f"section ${name} stands twice in the file")
        sections[name] = data[match.end() : position]
        position += len(b"$End" + match[1])
    for name in ("MeshFormat", "Nodes", "Elements"):
        if name not in sections:
            raise ValueError(f"no section ${name}: not a whole Gmsh file")
    return sections


def _groups_of_entities(numbers: _Numbers) -> Groups:
    """Physical groups of each entity, from a section $Entities or $PartitionedEntities."""
    groups: Groups = {}
    partitioned = numbers.name == "PartitionedEntities"
    if partitioned:
        numbers.take("i4", 2 * numbers.integers("u8", 2)[1])  # ghosts
    for dimension, count in enumerate(numbers.integers("u8", 4)):
        for _ in range(count):
            (tag,) = numbers.integers("i4", 1)
            if partitioned:
                numbers.take("i4", 2)  # its parent
                numbers.take("i4", *numbers.integers("u8", 1))  # its partitions
            numbers.take("f8", 6 if dimension else 3)
            physical = numbers.integers("i4", *numbers.integers("u8", 1))
            groups[dimension, tag] = {abs(number) for number in physical}  # negative: reversed
            if dimension:
                numbers.take("i4", *numbers.integers("u8", 1))  # bounding entities
    return groups


def _walk_22(Nodes: _Numbers, Elements: _Numbers) -> tuple[NDArray[Any], NDArray[Any], bytes]:
    """Numbers of all nodes, of the nodes of all elements, and $Elements, in format 2.2.

    In a binary file each element keeps two tags, its physical group and its entity: those of a
    partitioned mesh have the numbers of their parts too, more or less of them, which meshio mixes.
    """
    if Nodes.binary:
        record = np.dtype([("tag", "i4"), ("position", "f8", 3)])
        tags = Nodes.take("u1", record.itemsize * Nodes.line()).view(record)["tag"]
    else:
        tags = Nodes.take("f8", 4 * Nodes.line())[::4]
    used, with_tags, count_read, total = [np.empty(0)], set(), 0, Elements.line()
    blocks = [b"%d\n" % total]
    while count_read < total:
        kind, count, n_tags = Elements.integers("i4", 3)
        if not Elements.binary:  # number of the element, kind, tags
            kind, count = count, 1
        if count < 1 or n_tags < 0:
            raise ValueError("$Elements is damaged: negative counts")
        width = n_tags + _nodes_of(kind) + Elements.binary
        table = Elements.take("i4", count * width).reshape(count, width)
        used.append(table[:, -_nodes_of(kind) :].ravel())
        with_tags.add(min(n_tags, 2 if Elements.binary else 1))
        if Elements.binary:
            kept = [*range(1 + min(n_tags, 2)), *range(-_nodes_of(kind), 0)]
            head = np.array([kind, count, min(n_tags, 2)], table.dtype)
            blocks += [head.tobytes(), table[:, kept].tobytes()]
        count_read += count
    if len(with_tags) > 1:  # meshio shifts or mixes them
        raise ValueError(
            "some elements have tags and some have none; save it again with "
            "Mesh.MshFileVersion = 4.1"
        )
    section = b"".join([*blocks, b"\n"]) if Elements.binary else Elements.body
    return tags, np.concatenate(used), section


def _walk_41(Nodes: _Numbers, Elements: _Numbers) -> tuple[NDArray[Any], NDArray[Any]]:
    """Numbers of all nodes, and of the nodes of all elements, in format 4.1."""
    tags, used, count_read = [np.empty(0)], [np.empty(0)], 0
    blocks, n_nodes, _, _ = Nodes.integers("u8", 4)
    for _ in range(blocks):
        if Nodes.integers("i4", 3)[2]:
            raise ValueError("nodes with parameters; save it again with Mesh.SaveParametric = 0")
        (count,) = Nodes.integers("u8", 1)
        tags.append(Nodes.take("u8", count))
        Nodes.take("f8", 3 * count)
    blocks, n_elements, _, _ = Elements.integers("u8", 4)
    for _ in range(blocks):
        width = 1 + _nodes_of(Elements.integers("i4", 3)[2])
        (count,) = Elements.integers("u8", 1)
        used.append(Elements.take("u8", count * width).reshape(count, width)[:, 1:].ravel())
        count_read += count
    nodes = np.concatenate(tags)
    if (nodes.size, count_read) != (n_nodes, n_elements):
        raise ValueError(
            f"the file announces {n_nodes} nodes and {n_elements} elements and holds {nodes.size} "
            f"and {count_read}"
        )
    return nodes, np.concatenate(used)


def _nodes_of(kind: int) -> int:
    """Number of nodes of an element type of Gmsh; ValueError for types that are not read."""
    if kind not in _NODES:
        found = "elements of third order, or of another kind"
        cure = "Save it with Mesh.ElementOrder = 1 or 2"
        if kind in (7, 14, 19):
            found = "pyramids"
            cure = (
                "Mesh it with tetrahedra alone, or with hexahedra and prisms: in Gmsh, recombine "
                "no surface, or extrude the surfaces that are recombined"
            )
        raise ValueError(
            f"it holds {found} (Gmsh type {kind}); allowed are points, lines, and triangles, "
            f"quadrangles, tetrahedra, hexahedra and prisms of first or second order. {cure}"
        )
    return _NODES[kind]


def write_mesh(mesh: NamedMesh, path: str | Path) -> None:
    """Write a mesh as Gmsh 4.1 ASCII, with regions, boundaries and points as physical groups.

    The elements that belong to the same regions form an entity, and so do the facets of the same
    boundaries. Overlapping groups therefore need no repeated cells. meshio's writer would repeat
    cells, and loses groups whose entities own no nodes. Elements are written in the order in which
    their entities first appear, those of second order with their middle nodes.

    Parameters
    ----------
    mesh : NamedMesh
        Mesh; a mesh of several bars must be written bar by bar.
    path : str or Path
        File, which is overwritten.

    Raises
    ------
    InputError
        If the file cannot be written, the mesh holds several bars, or it is no mesh.
    """
    check_kind("mesh", mesh, NamedMesh)
    check_kind("path", path, str | os.PathLike)
    if mesh.dim == 1 and mesh.body.max() > 0:
        raise InputError(f"{path}: a file holds one bar; write each bar to a file of its own")
    positions, entities, tags = _entities(mesh)
    lines = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat"]
    if tags:
        names = [f'{dim} {tag} "{name}"' for (dim, name), tag in tags.items()]
        lines += ["$PhysicalNames", str(len(tags)), *names, "$EndPhysicalNames"]
    dims = [entity.dim for entity in entities]
    lines += ["$Entities", _joined([dims.count(dim) for dim in range(4)])]
    for tag, entity in enumerate(entities, 1):
        used = positions[np.unique(entity.nodes) - 1]
        box = [*used.min(axis=0).tolist(), *(used.max(axis=0).tolist() if entity.dim else ())]
        ends = [0] if entity.dim else []
        lines.append(_joined([tag, *box, len(entity.groups), *entity.groups, *ends]))
    owner = np.zeros(len(positions), dtype=np.intp)  # first entity that uses a node
    for tag, entity in reversed(list(enumerate(entities, 1))):
        owner[entity.nodes - 1] = tag
    blocks, count = np.unique(owner), len(owner)
    lines += ["$EndEntities", "$Nodes", f"{blocks.size} {count} 1 {count}"]
    for tag in blocks.tolist():
        inside = np.flatnonzero(owner == tag)
        lines.append(f"{dims[tag - 1]} {tag} 0 {inside.size}")
        lines += [str(number) for number in (inside + 1).tolist()]
        lines += [_joined(position) for position in positions[inside].tolist()]
    total = sum(len(entity.nodes) for entity in entities)
    lines += ["$EndNodes", "$Elements", f"{len(entities)} {total} 1 {total}"]
    number = 0
    for tag, entity in enumerate(entities, 1):
        lines.append(f"{entity.dim} {tag} {entity.kind} {len(entity.nodes)}")
        lines += [_joined([i, *row]) for i, row in enumerate(entity.nodes.tolist(), number + 1)]
        number += len(entity.nodes)
    lines += ["$EndElements", ""]
    try:
        Path(path).write_text("\n".join(lines), encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


class _Entity(NamedTuple):
    """Cells of a Gmsh file that belong to the same physical groups.

    Attributes
    ----------
    dim : int
        Dimension of the cells.
    groups : list of int
        Tags of the physical groups.
    kind : int
        Element type.
    nodes : ndarray of int, shape (cells, nodes)
        Numbers of the nodes, from 1 on.
    """

    dim: int
    groups: list[int]
    kind: int
    nodes: IntArray


def _entities(mesh: NamedMesh) -> tuple[FloatArray, list[_Entity], dict[tuple[int, str], int]]:
    """Positions of all nodes, entities, and tags of the groups by dimension and name."""
    cell, _ = cell_of(mesh.mesh)
    positions, facets, nodes = mesh.coordinates, mesh.mesh.facets, mesh.mesh.t
    if mesh.order == 2:
        values, nodes, facets, _, _ = split(mesh.mesh, mesh.coordinates.T)
        positions = values.T
    named: dict[int, dict[str, IntArray]] = {}
    named[0] = {name: np.array([vertex]) for name, vertex in mesh.points.items()}
    named[cell.dim - 1] = named.get(cell.dim - 1, {}) | mesh.boundaries
    named[cell.dim] = mesh.regions
    groups = [(dim, name) for dim, members in named.items() for name in members]
    tags = {group: tag for tag, group in enumerate(groups, 1)}
    points = np.arange(len(mesh.coordinates))
    # Corners of a cell, numbers of the cells with as many, and their nodes, by dimension.
    tables: dict[int, list[tuple[int, IntArray, IntArray]]] = {}
    tables[0] = [(1, points, points[np.newaxis])]
    tables[cell.dim - 1] = _tables_of_sides(mesh, facets)
    tables[cell.dim] = [
        (kind.corners, elements, nodes[:, elements][_rows(kind, cell, len(nodes))])
        for kind, elements, _ in mesh.parts
    ]
    entities = []
    for dim, parts in tables.items():
        count = 1 + max(numbers.max() for _, numbers, _ in parts)
        for names, chosen in _by_membership(named[dim], count):
            if not names and dim < cell.dim:
                continue
            for corners, numbers, table in parts:
                inside = table[:, np.isin(numbers, chosen)]
                if inside.size:
                    of_names = [tags[dim, name] for name in names]
                    kind = _TYPES[dim, corners, mesh.order]
                    entities.append(_Entity(dim, of_names, kind, inside.T + 1))
    return *_without_spare(positions, entities), tags


def _rows(kind: Cell, cell: Cell, nodes: int) -> list[int]:
    """Rows of the nodes of a kind, in Gmsh's order, among those of the elements of a mesh.

    Parameters
    ----------
    kind, cell : Cell
        Kind of some elements, and of the mesh.
    nodes : int
        Number of nodes of the elements of the mesh.
    """
    if kind is cell:
        return list(cell.gmsh or range(27))[:nodes]
    if nodes == len(kind.at):
        return [kind.at.index(corner) for corner in range(kind.corners)]
    if kind.name == "prism":
        corners = kind.elements[0].doflocs
        places = np.array([corners[list(between)].mean(axis=0) for between in _BETWEEN])
    else:
        places = kind.elements[1].doflocs
    apart = np.abs(places[:, np.newaxis] - kind.collapsed_places).max(axis=-1)
    return [int(row) for row in apart.argmin(axis=1)]


def _tables_of_sides(mesh: NamedMesh, nodes: IntArray) -> list[tuple[int, IntArray, IntArray]]:
    """Corners, numbers and nodes of the sides of a mesh, by their number of corners.

    ``nodes`` (nodes, n) are those of all sides. Those of a collapsed quadrilateral come in the
    order of a triangle, with some twice, and the last in the middle, where a triangle has none.
    """
    count = corner_count(mesh.mesh.facets)
    tables = []
    for corners in np.unique(count[count >= mesh.dim]).tolist():
        numbers = np.flatnonzero(count == corners)
        table = nodes[:, numbers]
        if corners < len(mesh.mesh.facets):
            table = table[: len(table) - (mesh.order - 1)]
            again = np.array([(table[:i] == table[i]).any(axis=0) for i in range(len(table))])
            table = table.T[~again.T].reshape(len(numbers), -1).T
        tables.append((corners, numbers, table))
    return tables


def _without_spare(
    positions: FloatArray, entities: list[_Entity]
) -> tuple[FloatArray, list[_Entity]]:
    """Positions and entities without nodes that no cell has, as in the middles of triangles."""
    used = np.zeros(len(positions), dtype=np.bool_)
    for entity in entities:
        used[entity.nodes - 1] = True
    number = np.cumsum(used, dtype=np.intp)
    return positions[used], [each._replace(nodes=number[each.nodes - 1]) for each in entities]


def _joined(values: list[Any]) -> str:
    return " ".join(map(str, values))


def _by_membership(named: Mapping[str, IntArray], count: int) -> list[tuple[list[str], IntArray]]:
    """Combinations of groups that occur, each with the members of exactly these groups.

    ``named`` has the members of each group, numbered below ``count``. The combinations come in the
    order of their first members.
    """
    member = np.zeros((1 + len(named), count), dtype=np.bool_)
    for row, chosen in zip(member[1:], named.values(), strict=True):
        row[chosen] = True
    first, set_of = same_columns(np.packbits(member, axis=0))
    names = list(named)
    return [
        ([names[i] for i in np.flatnonzero(member[1:, first[k]])], np.flatnonzero(set_of == k))
        for k in np.argsort(first)
    ]
