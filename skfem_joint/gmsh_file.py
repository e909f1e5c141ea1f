"""Check of a Gmsh file before meshio reads it: everything it announces must be in it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Nodes per element of the Gmsh element types that a bar may hold: a point, and lines of order 1-10.
_NODES_IN_BAR = {15: 1, 1: 2, 8: 3, 26: 4, 27: 5, 28: 6, 62: 7, 63: 8, 64: 9, 65: 10, 66: 11}
# In a plate there may be triangles and quadrangles of first and second order besides.
_NODES_IN_PLATE = {**_NODES_IN_BAR, 2: 3, 3: 4, 9: 6, 10: 9, 16: 8}
_BAR, _PLATE = 1, 2


class _Numbers:
    """Numbers of one section in turn; asking for more than the section holds raises ValueError."""

    def __init__(self, body: bytes, name: str, binary: bool) -> None:
        self.name = name
        self.binary = binary
        self.body = body
        self.values = np.empty(0) if binary else np.fromstring(body.decode("ascii"), sep=" ")
        self.position = 0

    def take(self, kind: str, count: int) -> NDArray[Any]:
        size = np.dtype(kind).itemsize if self.binary else 1
        stop = self.position + size * count
        if count < 0 or stop > (len(self.body) if self.binary else self.values.size):
            raise ValueError(
                f"${self.name} announces more than it holds: the file is cut or damaged"
            )
        start, self.position = self.position, stop
        if self.binary:
            return np.frombuffer(self.body, kind, count, start)
        return self.values[start:stop]

    def integers(self, kind: str, count: int) -> list[int]:
        return [int(value) for value in self.take(kind, count)]


def check_msh(data: bytes, dimension: int = _BAR) -> dict[tuple[int, int], set[int]] | None:
    """Refuse a Gmsh file from which meshio would read something else than what it says.

    meshio allocates what the counts in a file ask for, ends up with the wrong node where an
    element names one that does not exist, keeps one of two groups of the same name, and reads on
    where a section is cut off. Raises ValueError with the reason.

    Parameters
    ----------
    data : bytes
        Content of the file.
    dimension : int
        Largest dimension of the elements that it may hold, 1 or 2.

    Returns
    -------
    dict or None
        Physical tags, without sign, by dimension and tag of the entity; None where the file has no
        entities (format 2.2).
    """
    sections = _sections(data)
    binary, legacy = _check_format(sections["MeshFormat"])
    _check_group_names(sections.get("PhysicalNames", b""))
    groups = None
    if not legacy and "Entities" in sections:
        groups = _groups_of_entities(_Numbers(sections["Entities"], "Entities", binary))
    bodies = []
    for name in ("Nodes", "Elements"):
        count, body = 0, sections[name].lstrip(b"\r\n") if not binary else sections[name]
        if legacy:
            line, _, body = body.partition(b"\n")
            count = int(line)
        bodies.append((_Numbers(body, name, binary), count))
    (nodes, n_nodes), (elements, n_elements) = bodies
    tags = _node_tags_22(nodes, n_nodes) if legacy else _node_tags_41(nodes)
    # meshio's table of nodes is as long as the largest tag.
    largest = max(10**6, len(data))
    if not np.all((tags >= 1) & (tags <= largest)):
        raise ValueError(f"$Nodes numbers nodes beyond 1 ... {largest}: renumber the mesh")
    if np.unique(tags).size != tags.size:
        raise ValueError("$Nodes uses a node number twice")
    if legacy:
        used = _element_tags_22(elements, n_elements, dimension)
    else:
        used = _element_tags_41(elements, dimension)
    unknown = np.setdiff1d(used, tags)
    if unknown.size:
        raise ValueError(f"an element refers to node {unknown[0]:.0f}, which $Nodes does not hold")
    return groups


def without_entities(data: bytes) -> bytes:
    """Content of a file that `check_msh` has let pass, without its section of entities."""
    head, _, rest = data.partition(b"$Entities")
    return head + rest.partition(b"$EndEntities")[2].lstrip(b" \t\r\n")


def _sections(data: bytes) -> dict[str, bytes]:
    sections: dict[str, bytes] = {}
    position = 0
    while match := re.compile(rb"^\$(\w+)[ \t]*\r?\n", re.M).search(data, position):
        name = match[1].decode("ascii")
        position = data.find(b"$End" + match[1], match.end())
        if position < 0:
            raise ValueError(f"section ${name} is not closed by $End{name}: the file is cut")
        if name in sections and name != "Comments":
            raise ValueError(f"section ${name} stands twice in the file")
        sections[name] = data[match.end() : position]
        position += len(b"$End" + match[1])
    for name in ("MeshFormat", "Nodes", "Elements"):
        if name not in sections:
            raise ValueError(f"no section ${name}: not a whole Gmsh file")
    for name in ("NodeData", "ElementData"):
        if name in sections:
            raise ValueError(f"the file holds results (${name}): save the mesh alone")
    return sections


def _check_format(header: bytes) -> tuple[bool, bool]:
    """Whether the file is binary, and whether it is of format 2."""
    version, mode, size = (word.decode("ascii") for word in header.split()[:3])
    if version not in ("2", "2.2", "4.1"):  # Gmsh calls format 4.0 "4"
        raise ValueError(f"Gmsh format {version}; save it again with Mesh.MshFileVersion = 4.1")
    if mode not in ("0", "1") or size != "8":
        raise ValueError(f"unknown kind of Gmsh file: mode {mode}, data size {size}")
    return mode == "1", version.startswith("2")


def _check_group_names(section: bytes) -> None:
    names = re.findall(r'^\s*\d+\s+-?\d+\s+"(.*)"', section.decode("utf-8"), re.M)
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{names.count(name)} groups are named {name!r}: give each its own")


def _groups_of_entities(numbers: _Numbers) -> dict[tuple[int, int], set[int]]:
    groups = {}
    for dimension, count in enumerate(numbers.integers("u8", 4)):
        for _ in range(count):
            (tag,) = numbers.integers("i4", 1)
            numbers.take("f8", 6 if dimension else 3)
            physical = numbers.integers("i4", *numbers.integers("u8", 1))
            groups[dimension, tag] = {abs(number) for number in physical}  # negative: reversed
            if dimension:
                numbers.take("i4", *numbers.integers("u8", 1))  # bounding entities
    return groups


def _node_tags_22(numbers: _Numbers, count: int) -> NDArray[Any]:
    if numbers.binary:
        record = np.dtype([("tag", "i4"), ("position", "f8", 3)])
        body = numbers.take("u1", record.itemsize * count)
        return np.frombuffer(body.tobytes(), record)["tag"]
    return numbers.take("f8", 4 * count)[::4]


def _node_tags_41(numbers: _Numbers) -> NDArray[Any]:
    blocks, total, _, _ = numbers.integers("u8", 4)
    tags: list[NDArray[Any]] = [np.empty(0)]
    for _ in range(blocks):
        _, _, parametric = numbers.integers("i4", 3)
        if parametric:
            raise ValueError("nodes with parameters; save it again with Mesh.SaveParametric = 0")
        (count,) = numbers.integers("u8", 1)
        tags.append(numbers.take("u8", count))
        numbers.take("f8", 3 * count)
    found = np.concatenate(tags)
    if found.size != total:
        raise ValueError(f"$Nodes announces {total} nodes and holds {found.size}")
    return found


def _element_tags_22(numbers: _Numbers, total: int, dimension: int) -> NDArray[Any]:
    """Tags of all nodes that elements refer to, once each."""
    used: list[NDArray[Any]] = [np.empty(0)]
    found = 0
    while found < total:
        if numbers.binary:
            kind, count, n_tags = numbers.integers("i4", 3)
        else:
            (_, kind, n_tags), count = numbers.integers("i4", 3), 1
        if count < 1 or n_tags < 0:
            raise ValueError("$Elements is damaged: negative counts")
        n_nodes = _nodes_of_type(kind, dimension)
        width = n_tags + n_nodes + numbers.binary
        used.append(numbers.take("i4", count * width).reshape(count, width)[:, -n_nodes:].ravel())
        found += count
    return np.unique(np.concatenate(used))


def _element_tags_41(numbers: _Numbers, dimension: int) -> NDArray[Any]:
    """Tags of all nodes that elements refer to, once each."""
    blocks, total, _, _ = numbers.integers("u8", 4)
    used: list[NDArray[Any]] = [np.empty(0)]
    found = 0
    for _ in range(blocks):
        _, _, kind = numbers.integers("i4", 3)
        (count,) = numbers.integers("u8", 1)
        n_nodes = _nodes_of_type(kind, dimension)
        used.append(numbers.take("u8", count * (1 + n_nodes)).reshape(count, -1)[:, 1:].ravel())
        found += count
    if found != total:
        raise ValueError(f"$Elements announces {total} elements and holds {found}")
    return np.unique(np.concatenate(used))


def _nodes_of_type(kind: int, dimension: int) -> int:
    known = _NODES_IN_BAR if dimension < _PLATE else _NODES_IN_PLATE
    if kind in known:
        return known[kind]
    if dimension < _PLATE:
        raise ValueError(
            f"it holds elements of Gmsh type {kind} (2 is a triangle, 3 a quadrangle): this loader "
            "is for bars; allowed are lines and points. Save the curves alone"
        )
    raise ValueError(
        f"it holds elements of Gmsh type {kind} (4 is a tetrahedron, 5 a hexahedron, 21 a triangle "
        "and 36 a quadrangle of third order): allowed are points, lines, triangles and quadrangles "
        "of first or second order. Save a plane mesh with Mesh.ElementOrder = 1 or 2"
    )
