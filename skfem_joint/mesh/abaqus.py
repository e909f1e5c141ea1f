"""Abaqus files of bars: a reader, which refuses what it would have to pass over.

meshio takes the element sets of blocks by the number of the block, keeps the last of several blocks
of nodes, sets and parts, passes over what it does not know, and ends a block at a comment.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skfem_joint.mesh.gmsh import CellBlock, RawMesh

#: Parameters that are read right, by keyword; others change what a block means.
_READ = {
    "NODE": {"NSET"},
    "ELEMENT": {"TYPE", "ELSET"},
    "NSET": {"NSET", "GENERATE", "UNSORTED", "INTERNAL", "INSTANCE"},
    "ELSET": {"ELSET", "GENERATE", "UNSORTED", "INTERNAL", "INSTANCE"},
    "PART": {"NAME"},
    "INSTANCE": {"NAME", "PART"},
}
#: Keywords that make or move nodes and elements and are not read.
_MAKING = ("INCLUDE", "SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY")
_OWN_FILES = "save each part, at its place, in a file of its own, and name all files"
#: Number of nodes of the elements that are read.
_BARS = {"T2D2": 2, "T3D2": 2, "B21": 2, "B31": 2, "T2D3": 3, "T3D3": 3, "B22": 3, "B32": 3}


def read_inp(data: bytes) -> RawMesh:
    """Read an Abaqus file of bars; its sets are groups.

    Raises
    ------
    ValueError
        Says what is not read, with line, keyword and cure.
    """
    scan = _Scan()
    for number, line in enumerate(data.decode("utf-8-sig", "replace").splitlines(), 1):
        content = line.strip()
        if content and not content.startswith("**"):
            scan.line = number
            if content[0] == "*":
                scan.keyword(content[1:])
            else:
                scan.data(content)
    scan.not_empty()
    return scan.mesh()


@dataclass
class _Scan:
    """What stands in the lines of a file up to one of them.

    Attributes
    ----------
    line : int
        Number of the line.
    key, values : str, dict
        Last keyword, and its parameters.
    rows : int
        Lines of data since then.
    first : dict
        Line of the first part and of the first instance, of which there may be one.
    numbers : dict
        Numbers of all nodes and elements in turn, by keyword, with their places.
    positions, elements : list
        Of the nodes; number of nodes, and these, of the elements.
    sets : dict
        Places of the members of each set, by its keyword and name.
    """

    line: int = 0
    key: str = ""
    values: dict[str, str] = field(default_factory=dict)
    rows: int = 0
    first: dict[str, int] = field(default_factory=dict)
    numbers: dict[str, dict[int, int]] = field(default_factory=lambda: {"NODE": {}, "ELEMENT": {}})
    positions: list[list[float]] = field(default_factory=list)
    elements: list[list[int]] = field(default_factory=list)
    sets: dict[tuple[str, str], list[int]] = field(default_factory=dict)

    def refuse(self, reason: str) -> None:
        """Raise ValueError for this line."""
        raise ValueError(f"line {self.line}: *{self.key}: {reason}")

    def not_empty(self) -> None:
        """Refuse a block that ends without data."""
        if self.rows == 0 and self.key in ("ELEMENT", "NSET", "ELSET"):
            self.refuse("the block before has no members: take it out")

    def keyword(self, content: str) -> None:
        """Check a line with a keyword."""
        self.not_empty()
        words = [word.strip() for word in content.split(",")]
        self.key, self.rows = words[0].upper(), 0
        if self.key in _MAKING:
            self.refuse("is not read: save the file with all nodes and elements written out")
        if self.key not in _READ:
            return
        pairs = (word.partition("=") for word in words[1:])
        self.values = {key.strip().upper(): value.strip(' "') for key, _, value in pairs}
        for name in self.values:
            if not name:
                self.refuse("goes on in the next line: write it in one line")
            if name not in _READ[self.key]:
                self.refuse(f"{name} is not read: save the file without it")
        if self.key in ("PART", "INSTANCE"):
            first = self.first.setdefault(self.key, self.line)
            if first != self.line:
                self.refuse(f"stands in line {first} already: {_OWN_FILES}")
        for kind in ("NSET", "ELSET"):
            if kind in self.values:
                self.named(kind)
        if self.key == "ELEMENT":
            kind = self.values["TYPE"] = self.values.get("TYPE", "").upper()
            if kind.removesuffix("H") not in _BARS:
                self.refuse(
                    f"type {kind or 'missing'}: from .inp files only bars are read, of types "
                    f"{', '.join(_BARS)}; save a .msh"
                )

    def named(self, kind: str) -> list[int]:
        """Members so far of the set of a kind that the keyword names; case does not count."""
        name = self.values[kind]
        same = (
            known for known in self.sets if known[0] == kind and known[1].upper() == name.upper()
        )
        return self.sets.setdefault(next(same, (kind, name)), [])

    def data(self, content: str) -> None:
        """Read a line of data."""
        self.rows += 1
        if self.key == "INSTANCE":
            self.refuse(f"its part is moved, which is not read: {_OWN_FILES}")
        if self.key not in ("NODE", "ELEMENT", "NSET", "ELSET"):
            return
        words = [word.strip() for word in content.rstrip(", ").split(",")]
        words, coordinates = (words[:1], words[1:]) if self.key == "NODE" else (words, [])
        if not all(re.fullmatch(r"[0-9]+", word) for word in words):
            self.refuse(f"found {content[:40]!r}, must be numbers: list the members of sets")
        numbers: Sequence[int] = [int(word) for word in words]
        if self.key in self.numbers:
            if numbers[0] in self.numbers[self.key]:
                self.refuse(f"{self.key.lower()} {numbers[0]} stands twice: number all anew")
            self.numbers[self.key][numbers[0]] = len(self.numbers[self.key])
        if self.key == "NODE":
            if not 1 <= len(coordinates) <= 3:
                self.refuse(f"found {len(coordinates)} coordinates, must be up to 3")
            try:
                self.positions.append([*map(float, coordinates), 0.0, 0.0][:3])
            except ValueError:
                self.refuse(f"found {content[:40]!r}, must be numbers")
        elif self.key == "ELEMENT":
            if len(numbers) != 1 + _BARS[self.values["TYPE"].removesuffix("H")]:
                self.refuse(
                    f"found {len(numbers)} numbers, must be those of an element and its nodes"
                )
            self.elements.append(self.inner_last(self.known("NODE", numbers[1:])))
        elif "GENERATE" in self.values:
            if len(numbers) != 3 or self.rows > 1 or not numbers[2]:
                self.refuse("GENERATE needs one line of first, last and increment: 5, 12, 1")
            numbers = range(numbers[0], numbers[1] + 1, numbers[2])
            if len(numbers) > 10**7:
                self.refuse(f"found {len(numbers)} members, must be at most 10000000")
        of = "NODE" if "NSET" in self.values else "ELEMENT"
        if self.key == "ELSET" and "GENERATE" in self.values:
            # Elements that a range names and that are not there are left out, as by Abaqus.
            numbers = [number for number in numbers if number in self.numbers[of]]
        for kind in ("NSET", "ELSET"):
            if kind in self.values:
                own = numbers[:1] if self.key in self.numbers else numbers
                self.named(kind).extend(self.known(of, own))

    def known(self, kind: str, numbers: Sequence[int]) -> list[int]:
        """Places of nodes or elements; refuse numbers that none above has."""
        unknown = next((n for n in numbers if n not in self.numbers[kind]), None)
        if unknown is not None:
            self.refuse(f"{kind.lower()} {unknown} does not stand above: write *{kind} first")
        return [self.numbers[kind][n] for n in numbers]

    def mesh(self) -> RawMesh:
        """What was read."""
        points = [[node] for node in range(len(self.positions))]
        lines = self.elements
        blocks = [self.block(15, points, 1), self.block(1, lines, 2), self.block(8, lines, 3)]
        names = [(int(kind == "ELSET"), tag, name) for tag, (kind, name) in enumerate(self.sets)]
        positions = np.reshape(self.positions, (-1, 3))
        return RawMesh(positions, [block for block in blocks if len(block.nodes)], names)

    def block(self, kind: int, cells: list[list[int]], count: int) -> CellBlock:
        """Those of some cells that have ``count`` nodes, of a type of Gmsh, with their sets."""
        own = [i for i, nodes in enumerate(cells) if len(nodes) == count]
        key = "NSET" if count == 1 else "ELSET"
        groups = {
            tag: np.flatnonzero(inside)
            for tag, ((set_of, _), members) in enumerate(self.sets.items())
            if set_of == key and (inside := np.isin(own, members)).any()
        }
        nodes = np.reshape([cells[i] for i in own], (-1, count)).astype(np.intp)
        return CellBlock(kind, nodes, groups)

    def inner_last(self, nodes: list[int]) -> list[int]:
        """Places of an element's nodes, the one between two others last, as in Gmsh.

        It is the one opposite to the longest side.
        """
        if len(nodes) < 3:
            return nodes
        sides = [math.dist(*(self.positions[n] for n in nodes if n != node)) for node in nodes]
        inner = nodes[int(np.argmax(sides))]
        return [*(node for node in nodes if node != inner), inner]
