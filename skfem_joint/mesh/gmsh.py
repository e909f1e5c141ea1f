"""Gmsh files: read as they are written, in format 2.2 or 4.1, and a writer."""

from __future__ import annotations

import os
import re
import warnings
from collections import Counter
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import FloatArray, IntArray, Numbering
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import read_whole
from skfem_joint.ground.values import check_kind
from skfem_joint.mesh.cells import Cell, cell_of, corner_count, same_columns
from skfem_joint.mesh.file_mesh import Block, FileMesh, RawMesh
from skfem_joint.mesh.named import NamedMesh, check_count
from skfem_joint.mesh.splitting import split

# Name that meshio has for each Gmsh element type that is read, and its number of nodes: points,
# lines of order 1 to 10, and other elements of first and second order.
_READ = {
    **{15: ("vertex", 1), 1: ("line", 2)},
    **{kind: (f"line{n}", n) for n, kind in enumerate((8, 26, 27, 28, 62, 63, 64, 65, 66), 3)},
    **{2: ("triangle", 3), 9: ("triangle6", 6), 4: ("tetra", 4), 11: ("tetra10", 10)},
    **{3: ("quad", 4), 16: ("quad8", 8), 10: ("quad9", 9), 5: ("hexahedron", 8)},
    **{17: ("hexahedron20", 20), 12: ("hexahedron27", 27)},
    **{6: ("wedge", 6), 18: ("wedge15", 15), 13: ("wedge18", 18)},
}
# Order of VTK for the nodes of Gmsh's elements, where it is another.
_CUBE = (*range(8), 8, 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15)
_PRISM = (*range(6), 6, 9, 7, 12, 14, 13, 8, 10, 11)
_OF_VTK = {
    **{"tetra10": (*range(8), 9, 8), "wedge15": _PRISM, "wedge18": (*_PRISM, 15, 17, 16)},
    **{"hexahedron20": _CUBE, "hexahedron27": (*_CUBE, 22, 23, 21, 24, 20, 25, 26)},
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


#: Numbers of nodes are below it, so that those of texts are exact.
_LARGEST = 2**53
#: Cells, with the numbers of their nodes as they are written, and members of physical groups.
_Grouped = tuple[Block, dict[int, IntArray]]


class _Numbers:
    """Numbers of a section, read in turn; ValueError if fewer are left than are to be read."""

    def __init__(self, body: bytes, name: str, binary: bool) -> None:
        self.name, self.binary, self.position = name, binary, 0
        self.values: NDArray[Any] = np.frombuffer(body, "u1")
        if not binary:
            with warnings.catch_warnings():
                warnings.simplefilter("error", DeprecationWarning)  # of text that is no number
                self.values = np.fromstring(body.decode("ascii"), sep=" ")
            self.whole = np.isfinite(self.values) & (self.values == np.floor(self.values))

    def take(self, kind: str, count: int) -> NDArray[Any]:
        """Next ``count`` numbers, of a numpy type in binary files."""
        start = self.position
        self.position += count * (np.dtype(kind).itemsize if self.binary else 1)
        if count < 0 or self.position > self.values.size:
            raise ValueError(
                f"${self.name} announces more than it holds: the file is cut or damaged"
            )
        values = self.values[start : self.position]
        if self.binary:
            return np.frombuffer(values.tobytes(), kind)
        if kind[0] != "f" and not self.whole[start : self.position].all():
            raise ValueError(f"${self.name} has numbers that are not whole where it refers to some")
        return values

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


def read_msh(path: Path) -> FileMesh:
    """Read a Gmsh file; InputError says why it cannot be read."""
    return FileMesh([numbered_msh(path)[0]])


def numbered_msh(path: Path) -> tuple[RawMesh, IntArray]:
    """Mesh of a Gmsh file with groups as cell sets, and the numbers of its nodes, which ascend.

    InputError for files that are cut or damaged, and for kinds of elements that are not read.
    """
    data = read_whole(path)
    try:
        return _mesh_of(_sections(data.removeprefix(b"\xef\xbb\xbf")))
    except (ValueError, OverflowError, DeprecationWarning) as error:
        raise InputError(
            f"{path}: cannot be read as a mesh: {error}. Readable are whole Gmsh files of format "
            "2.2 or 4.1 (.msh) and files of Abaqus or CalculiX (.inp), Salome (.med) or Nastran "
            "(.bdf, .nas, .dat). Gmsh converts others, e.g. gmsh mesh.cgns -save -o mesh.msh"
        ) from error


def _mesh_of(sections: Mapping[str, bytes]) -> tuple[RawMesh, IntArray]:
    """Mesh of the sections of a file, and the numbers of its nodes."""
    version, mode, size = (word.decode("ascii") for word in sections["MeshFormat"].split()[:3])
    if version not in ("2", "2.2", "4.1"):  # Gmsh calls format 4.0 "4"
        raise ValueError(f"Gmsh format {version}; save it again with Mesh.MshFileVersion = 4.1")
    if mode not in ("0", "1") or size != "8":
        raise ValueError(f"unknown kind of Gmsh file: mode {mode}, data size {size}")
    names = _names(sections["PhysicalNames"].decode())
    numbers = {
        name: _Numbers(body, name, mode == "1")
        for name, body in sections.items()
        if name in ("Nodes", "Elements", "Entities", "PartitionedEntities")
    }
    if version == "4.1":
        tags, places = _nodes_41(numbers["Nodes"])
        cells = _elements_41(numbers)
    else:
        tags, places = _nodes_22(numbers["Nodes"])
        cells = _elements_22(numbers["Elements"])
    if not np.all((tags >= 1) & (tags < _LARGEST)):
        raise ValueError(f"$Nodes numbers nodes beyond 1 ... {_LARGEST - 1}: renumber the mesh")
    order = np.argsort(tags)
    numbering = Numbering(tags[order].astype(np.intp))
    if numbering.repeated()[0].size:
        raise ValueError("$Nodes uses a node number twice")
    mesh = RawMesh(places[order].astype(np.float64), [])
    for block, _ in cells:
        own = block.nodes
        known = (own > 0) & (own < _LARGEST)
        nodes = numbering.places(np.where(known, own, 0).astype(np.intp))
        if (nodes < 0).any():
            lost = own[nodes < 0][0]
            raise ValueError(f"an element refers to node {lost:.0f}, which $Nodes does not hold")
        mesh.blocks.append(Block(block.type, nodes[:, _OF_VTK.get(block.type, slice(None))]))
    mesh.cell_sets = {name: {} for (dim, _), name in names.items() if dim <= mesh.top}
    for number, (block, groups) in enumerate(cells):
        for tag, members in groups.items():
            if members.size and (block.dim, tag) in names:
                mesh.cell_sets[names[block.dim, tag]][number] = members
    return mesh, numbering.sorted


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


def _names(text: str) -> dict[tuple[int, int], str]:
    """Names of the physical groups by dimension and tag, from a section that states their count."""
    announced, _, text = text.partition("\n")
    found = re.findall(r'^\s*(\d+)\s+(-?\d+)\s+"(.*)"', text, re.M)
    check_count(len(found))
    for name, count in Counter(name for _, _, name in found).items():
        if count > 1:
            raise ValueError(f"{count} groups are named {name!r}: give each its own")
    names = {(int(dim), int(tag)): name for dim, tag, name in found}
    _check_total("physical names", int(announced or 0), len(names))
    return names


def _nodes_22(numbers: _Numbers) -> tuple[NDArray[Any], NDArray[Any]]:
    """Numbers of the nodes, (n,), and their positions, (n, 3), in format 2.2."""
    if numbers.binary:
        record = np.dtype([("tag", "i4"), ("position", "f8", 3)])
        rows = numbers.take("u1", record.itemsize * numbers.line()).view(record)
        return rows["tag"], rows["position"]
    table = numbers.take("f8", 4 * numbers.line()).reshape(-1, 4)
    return table[:, 0], table[:, 1:]


def _elements_22(numbers: _Numbers) -> list[_Grouped]:
    """Elements in format 2.2, which states the physical group of each."""
    tables, count_read, total = [], 0, numbers.line()
    while count_read < total:
        kind, count, n_tags = numbers.integers("i4", 3)
        if not numbers.binary:  # number of the element, kind, tags
            kind, count = count, 1
        if count < 1 or n_tags < 0:
            raise ValueError("$Elements is damaged: negative counts")
        nodes = _nodes_of(kind)
        width = n_tags + nodes + numbers.binary
        table = numbers.take("i4", count * width).reshape(count, width)
        tags = table[:, numbers.binary : numbers.binary + min(n_tags, 1)]
        tables.append((kind, tags, table[:, -nodes:]))
        count_read += count
    if len({tags.shape[1] for _, tags, _ in tables}) > 1:
        raise ValueError(
            "some elements have tags and some have none; save it again with "
            "Mesh.MshFileVersion = 4.1"
        )
    cells = []
    for kind, own in groupby(tables, key=lambda table: table[0]):
        _, tags, parts = zip(*own, strict=True)
        groups = _by_value(np.abs(np.concatenate(tags)).ravel())
        cells.append((Block(_READ[kind][0], np.concatenate(parts)), groups))
    return cells


def _by_value(values: NDArray[Any]) -> dict[int, IntArray]:
    """Places of each value."""
    order = np.argsort(values, kind="stable")
    found, first = np.unique(values[order], return_index=True)
    return dict(zip(map(int, found), np.split(order, first[1:]), strict=False))


def _nodes_41(numbers: _Numbers) -> tuple[NDArray[Any], NDArray[Any]]:
    """Numbers of the nodes, (n,), and their positions, (n, 3), in format 4.1."""
    tags, places = [np.empty(0)], [np.empty(0)]
    blocks, n_nodes, _, _ = numbers.integers("u8", 4)
    for _ in range(blocks):
        if numbers.integers("i4", 3)[2]:
            raise ValueError("nodes with parameters; save it again with Mesh.SaveParametric = 0")
        (count,) = numbers.integers("u8", 1)
        tags.append(numbers.take("u8", count))
        places.append(numbers.take("f8", 3 * count))
    every = np.concatenate(tags)
    _check_total("nodes", n_nodes, every.size)
    return every, np.concatenate(places).reshape(-1, 3)


def _elements_41(numbers: Mapping[str, _Numbers]) -> list[_Grouped]:
    """Elements in format 4.1, by entities, which have the physical groups."""
    groups: dict[tuple[int, int], set[int]] = {}
    for name in ("Entities", "PartitionedEntities"):  # the latter are parts of the former
        if name in numbers and "Entities" in numbers:
            groups |= _groups_of_entities(numbers[name])
    elements, found = numbers["Elements"], []
    blocks, total, _, _ = elements.integers("u8", 4)
    for _ in range(blocks):
        _, entity, kind = elements.integers("i4", 3)
        width = 1 + _nodes_of(kind)
        (count,) = elements.integers("u8", 1)
        nodes = elements.take("u8", count * width).reshape(count, width)[:, 1:]
        block = Block(_READ[kind][0], nodes)
        own = groups.get((block.dim, entity), set())  # one that is not listed has none
        found.append((block, dict.fromkeys(own, np.arange(count))))
    _check_total("elements", total, sum(len(block.nodes) for block, _ in found))
    return found


def _check_total(what: str, announced: int, found: int) -> None:
    if found != announced:
        raise ValueError(f"the file announces {announced} {what} and holds {found}")


def _groups_of_entities(numbers: _Numbers) -> dict[tuple[int, int], set[int]]:
    """Physical groups of each entity, by dimension and tag, without sign.

    They stand in a section $Entities or $PartitionedEntities.
    """
    groups: dict[tuple[int, int], set[int]] = {}
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


def _nodes_of(kind: int) -> int:
    """Number of nodes of an element type of Gmsh; ValueError for types that are not read."""
    if kind not in _READ:
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
    return _READ[kind][1]


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
