"""Gmsh files: a reader, which trusts no number that a file states, and a writer.

meshio allocates memory for any count that a file states, takes a wrong node if an element refers to
a missing one, keeps only the last of two groups with the same name, reads beyond the end of a
section that is cut off, refuses a file in which some entities belong to no group, and empties
groups of reversed curves (negative tags).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.mesh.cells import CELLS, cell_of, same_columns, split
from skfem_joint.mesh.named import NamedMesh, check_count

#: Kind, order and number of nodes of each Gmsh element type that is read: points, lines of order 1
#: to 10, and triangles, quadrilaterals, tetrahedra and hexahedra of first and second order.
KINDS = {15: ("point", 1, 1), 1: ("line", 1, 2), 8: ("line", 2, 3)}
KINDS |= {23 + order: ("line", order, order + 1) for order in (3, 4, 5)}
KINDS |= {56 + order: ("line", order, order + 1) for order in (6, 7, 8, 9, 10)}
KINDS |= {2: ("triangle", 1, 3), 9: ("triangle", 2, 6), 3: ("quadrilateral", 1, 4)}
KINDS |= {16: ("quadrilateral", 2, 8), 10: ("quadrilateral", 2, 9)}
KINDS |= {4: ("tetrahedron", 1, 4), 11: ("tetrahedron", 2, 10)}
KINDS |= {5: ("hexahedron", 1, 8), 17: ("hexahedron", 2, 20), 12: ("hexahedron", 2, 27)}
# Gmsh element types that are written, by dimension, number of corners and order.
_TYPES = {
    **{(0, 1, 1): 15, (0, 1, 2): 15, (1, 2, 1): 1, (1, 2, 2): 8, (2, 3, 1): 2, (2, 3, 2): 9},
    **{(2, 4, 1): 3, (2, 4, 2): 10, (3, 4, 1): 4, (3, 4, 2): 11, (3, 8, 1): 5, (3, 8, 2): 12},
}
#: Tags of the physical groups, without sign, by dimension and tag of the entity.
Groups = dict[tuple[int, int], set[int]]


class CellBlock(NamedTuple):
    """Cells of one type.

    Attributes
    ----------
    kind : int
        Element type of Gmsh.
    nodes : ndarray of int, shape (cells, nodes)
    groups : dict of int to ndarray of int
        Cells by the tag of their physical group.
    """

    kind: int
    nodes: IntArray
    groups: dict[int, IntArray]

    @property
    def dim(self) -> int:
        """Dimension of the cells."""
        return _dim(self.kind)


class RawMesh(NamedTuple):
    """What a file holds.

    Attributes
    ----------
    positions : ndarray, shape (n, 3)
        Of the nodes, in the order of their numbers in the file.
    blocks : list of CellBlock
        With the places of their nodes among all.
    names : list of (int, int, str)
        Dimension, tag and name of each physical group.
    """

    positions: FloatArray
    blocks: list[CellBlock]
    names: list[tuple[int, int, str]]


def _dim(kind: int) -> int:
    """Dimension of an element type of Gmsh."""
    return 0 if kind == 15 else CELLS[KINDS[kind][0]].dim


class _Numbers:
    """Numbers of a section, read in turn; ValueError if fewer are left than are to be read."""

    def __init__(self, body: bytes, name: str, binary: bool) -> None:
        self.name, self.binary, self.position = name, binary, 0
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


def read_msh(data: bytes) -> RawMesh:
    """Read a Gmsh file; sections with anything but the mesh and its groups are passed over.

    Raises
    ------
    ValueError
        Says why the file is refused: it is cut or damaged, of another format, holds elements of
        other types, or groups with the same name.
    """
    sections = _sections(data.removeprefix(b"\xef\xbb\xbf"))
    version, mode, size = (word.decode("ascii") for word in sections["MeshFormat"].split()[:3])
    if version not in ("2", "2.2", "4.1"):  # Gmsh calls format 4.0 "4"
        raise ValueError(f"Gmsh format {version}; save it again with Mesh.MshFileVersion = 4.1")
    if mode not in ("0", "1") or size != "8":
        raise ValueError(f"unknown kind of Gmsh file: mode {mode}, data size {size}")
    text = sections["PhysicalNames"].decode()
    lines = re.findall(r'^\s*(\d+)\s+(-?\d+)\s+"(.*)"', text, re.M)
    names = [(int(dim), int(tag), name) for dim, tag, name in lines]
    check_count(len(names))
    for name, count in Counter(name for _, _, name in names).items():
        if count > 1:
            raise ValueError(f"{count} groups are named {name!r}: give each its own")
    parts = {name: _Numbers(body, name, mode == "1") for name, body in sections.items()
             if name in ("Nodes", "Elements", "Entities", "PartitionedEntities")}  # fmt: skip
    tags, positions, blocks = (_walk_41 if version == "4.1" else _walk_22)(parts)
    if not np.all((tags >= 1.0) & (tags < 2.0**53)):
        raise ValueError("$Nodes has node numbers that are no whole numbers from 1 on")
    order = np.argsort(tags, kind="stable")
    known = tags[order]
    if np.any(np.diff(known) == 0.0):
        raise ValueError("$Nodes uses a node number twice")

    def placed(block: CellBlock) -> CellBlock:
        """The block with the places of its nodes in place of their numbers."""
        place = np.searchsorted(known, block.nodes).clip(max=known.size - 1)
        unknown = block.nodes[known[place] != block.nodes]
        if unknown.size:
            raise ValueError(
                f"an element refers to node {unknown[0]:.0f}, which $Nodes does not hold"
            )
        return block._replace(nodes=place)

    return RawMesh(positions[order], [placed(block) for block in blocks if len(block.nodes)], names)


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


#: Numbers of the nodes, their positions, and blocks with these numbers.
Walked = tuple[FloatArray, FloatArray, list[CellBlock]]


def _walk_22(parts: Mapping[str, _Numbers]) -> Walked:
    """Nodes and elements in format 2.2."""
    Nodes, Elements = parts["Nodes"], parts["Elements"]
    if Nodes.binary:
        record = np.dtype([("tag", "i4"), ("position", "f8", 3)])
        nodes = Nodes.take("u1", record.itemsize * Nodes.line()).view(record)
        tags, positions = nodes["tag"].astype(float), nodes["position"]
    else:
        table = Nodes.take("f8", 4 * Nodes.line()).reshape(-1, 4)
        tags, positions = table[:, 0], table[:, 1:]
    found: dict[int, list[NDArray[Any]]] = {}  # group and nodes of the elements, by type
    with_tags, count_read, total = set(), 0, Elements.line()
    while count_read < total:
        kind, count, n_tags = Elements.integers("i4", 3)
        if not Elements.binary:  # number of the element, kind, tags
            kind, count = count, 1
        if count < 1 or n_tags < 0:
            raise ValueError("$Elements is damaged: negative counts")
        width = n_tags + _nodes_of(kind) + Elements.binary
        table = Elements.take("i4", count * width).reshape(count, width).astype(float)
        first = int(Elements.binary)  # column of the first tag
        group = np.abs(table[:, first : first + 1]) if n_tags else np.zeros((count, 1))
        found.setdefault(kind, []).append(np.hstack([group, table[:, -_nodes_of(kind) :]]))
        with_tags.add(n_tags if Elements.binary else n_tags > 0)
        count_read += count
    if len(with_tags) > 1:
        raise ValueError(
            "some elements have tags and some have none, or other numbers of them, as in a binary "
            "file of parts; save it again with Mesh.MshFileVersion = 4.1"
        )
    blocks = []
    for kind, rows in found.items():
        table = np.vstack(rows)
        groups = {int(tag): np.flatnonzero(table[:, 0] == tag) for tag in np.unique(table[:, 0])}
        blocks.append(CellBlock(kind, table[:, 1:], groups))
    return tags, positions, blocks


def _walk_41(parts: Mapping[str, _Numbers]) -> Walked:
    """Nodes and elements in format 4.1."""
    Nodes, Elements, groups = parts["Nodes"], parts["Elements"], Groups()
    for name in ("Entities", "PartitionedEntities"):  # the latter are parts of the former
        if name in parts:
            groups |= _groups_of_entities(parts[name])
    tags, positions = [np.empty(0)], [np.empty((0, 3))]
    blocks, n_nodes, _, _ = Nodes.integers("u8", 4)
    for _ in range(blocks):
        if Nodes.integers("i4", 3)[2]:
            raise ValueError("nodes with parameters; save it again with Mesh.SaveParametric = 0")
        (count,) = Nodes.integers("u8", 1)
        tags.append(Nodes.take("u8", count).astype(float))
        positions.append(Nodes.take("f8", 3 * count).reshape(-1, 3))
    found: list[CellBlock] = []
    blocks, n_elements, _, _ = Elements.integers("u8", 4)
    for _ in range(blocks):
        _, entity, kind = Elements.integers("i4", 3)
        width = 1 + _nodes_of(kind)
        (count,) = Elements.integers("u8", 1)
        table = Elements.take("u8", count * width).reshape(count, width).astype(float)
        own = groups.get((_dim(kind), entity), ())  # an entity that is not listed has none
        found.append(CellBlock(kind, table[:, 1:], dict.fromkeys(own, np.arange(count))))
    nodes, count_read = np.concatenate(tags), sum(len(block.nodes) for block in found)
    if (nodes.size, count_read) != (n_nodes, n_elements):
        raise ValueError(
            f"the file announces {n_nodes} nodes and {n_elements} elements and holds {nodes.size} "
            f"and {count_read}"
        )
    return nodes, np.concatenate(positions), found


def _nodes_of(kind: int) -> int:
    """Number of nodes of an element type of Gmsh; ValueError for types that are not read."""
    if kind not in KINDS:
        what = dict.fromkeys((6, 13, 18), "prisms") | dict.fromkeys((7, 14, 19), "pyramids")
        cure = "Mesh it with tetrahedra or hexahedra alone: in Gmsh, recombine no surface, or all"
        if kind not in what:
            cure = "Save it with Mesh.ElementOrder = 1 or 2"
        found = what.get(kind, "elements of third order, or of another kind")
        raise ValueError(
            f"it holds {found} (Gmsh type {kind}); allowed are points, lines, and triangles, "
            f"quadrangles, tetrahedra and hexahedra of first or second order. {cure}"
        )
    return KINDS[kind][2]


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
        If the file cannot be written, or the mesh holds several bars.
    """
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
    tables = {
        0: (np.arange(len(mesh.coordinates))[np.newaxis], 1),
        cell.dim - 1: (facets, len(mesh.mesh.facets)),
        cell.dim: (nodes[list(cell.gmsh or range(27))[: len(nodes)]], len(mesh.mesh.t)),
    }
    entities = []
    for dim, (table, corners) in tables.items():
        kind = _TYPES[dim, corners, mesh.order]
        for names, chosen in _by_membership(named[dim], table.shape[1]):
            if names or dim == cell.dim:
                of_names = [tags[dim, name] for name in names]
                entities.append(_Entity(dim, of_names, kind, table[:, chosen].T + 1))
    return positions, entities, tags


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
