"""Meshes of Nastran's bulk data (``.bdf``, ``.nas``, ``.dat``), with their properties as names.

Every entry is read, passed over with a note, or refused with its line: readers of other libraries
leave out those that they do not know, such as elements with long fields, without a word.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from skfem_joint.ground.arrays import IntArray, Numbering
from skfem_joint.ground.files import read_whole
from skfem_joint.matrix_files.bulk_data import Entry, entries, real, whole
from skfem_joint.mesh.cells import repeated
from skfem_joint.mesh.decks.elements import FORMS
from skfem_joint.mesh.decks.sets import FARTHEST
from skfem_joint.mesh.file_mesh import FileMesh
from skfem_joint.mesh.gmsh import meshio_with_prisms
from skfem_joint.mesh.named import check_count


class _Kind(NamedTuple):
    """Elements of a word: dimension, card of their properties, and names of meshio by nodes."""

    dim: int
    card: str
    names: dict[int, str]


_KINDS = {
    **{f"C{name}": _Kind(1, f"P{name}", {2: "line"}) for name in ("ROD", "TUBE", "BAR", "BEAM")},
    **dict.fromkeys(("CTRIA3", "CTRIAR"), _Kind(2, "PSHELL", {3: "triangle"})),
    **dict.fromkeys(("CQUAD4", "CQUADR"), _Kind(2, "PSHELL", {4: "quad"})),
    "CTRIA6": _Kind(2, "PSHELL", {6: "triangle6"}),
    "CQUAD8": _Kind(2, "PSHELL", {8: "quad8"}),
    "CTETRA": _Kind(3, "PSOLID", {4: "tetra", 10: "tetra10"}),
    "CPENTA": _Kind(3, "PSOLID", {6: "wedge", 15: "wedge15"}),
    "CHEXA": _Kind(3, "PSOLID", {8: "hexahedron", 20: "hexahedron20"}),
}
#: In what order Nastran has the nodes of meshio's elements, where it is another.
_ORDERS = {
    "hexahedron20": [*range(12), *range(16, 20), *range(12, 16)],
    "wedge15": [*range(9), *range(12, 15), *range(9, 12)],
}
_SECTIONS = "properties, which [material] and [section] say"
_LOADED = "supports and loads, which [support], [[load]] and [[bolt]] say"
#: Entries that are passed over, by what they are about.
_PASSED = {
    "materials, which [material] says": r"MAT\w*|CREEP",
    _SECTIONS: r"P(SOLID|SHELL|LSOLID|COMP|ROD|TUBE|BAR|"
    r"BEAM)\w*",
    _LOADED: r"SPC\w*|FORCE\d?|MOMENT\d?|"
    r"PLOAD\w*|GRAV|LOAD|LSEQ|TEMP\w*|RFORCE\d?|ACCEL\d?|DAREA|[DRT]LOAD\d?|DPHASE|DEFORM|"
    r"SUPORT\d?|CHBDY\w|PHBDY|QBDY\d|QVOL|QSET\d?|P?CONV\w?|RADM|RADBC",
    "contact, which [[joint]] says": r"BC\w+|BSURFS?|BFRIC",
    "what is to be optimised": r"DRESP\d|DCONSTR|DCONADD|DESVAR|DLINK|DVPREL\d|DVMREL\d|DVCREL\d|"
    r"DOPTPRM|DSCREEN|DEQATN|TOPVAR",
    "sets, tables and settings of the program": r"PARAM|MDLPRM|EIG[RCB]L?|TAB\w+|TSTEP\w*|"
    r"FREQ\d?|RANDPS|RANDT1|NL(PARM|PCI|STEP|CNTL\w*|ADAPT)|SET\d|CORD\d[RCS]|[ABCO]SET\d?|"
    r"OMIT\d?|USET\d?|PLOTEL\d?|ECHOO\w*",
}
_JOINED = (
    "it joins or stiffens parts of the model, which is not read: join the bodies in the mesh, by "
    "shared nodes, or say a joint that sticks as [[joint]], hold or load faces in [support] and "
    "[[load]], and take it out"
)
_MASS = "it adds springs, masses or matrices, which is not read: take it and its property out"
_REFUSED = {
    r"RBE\d|RBAR\d?|RROD|RTRPLT\d?|RSPLINE|RSSCON|RJOINT|MPC\w*|C(WELD|FAST|SEAM)|BGSET|BGADD": (
        _JOINED
    ),
    r"C(ELAS|DAMP|MASS)\d|P(ELAS|DAMP|MASS|VISC|GAP)\w*|[CP]BUSH\w*|CONM\d|CVISC|CGAP|DMIG": _MASS,
    r"GRDSET": "it gives nodes what their own fields leave out: write the fields of GRID out",
    r"SPOINT|EPOINT": "points without a place are not read: take them out",
    r"INCLUDE": "included files are not read: put the content of the file in its place",
    r"CPYRAM\w*": "pyramids are not read: mesh with tetrahedra or hexahedra alone",
    r"CTRIAX\w*|CQUADX\w*": "bodies of revolution are not read: mesh the solid",
    r"CONROD|CBEND|CSHEAR|CQUAD": "such elements are not read: write them as CROD, CBAR or CQUAD4",
}


def read_nastran(path: Path) -> FileMesh:
    """Read the bulk data of a file; the sections before BEGIN BULK are passed over.

    Elements of a property are a group, named after the card of such properties and its number:
    PSOLID_3, PSHELL_7, PROD_1. In a solid, shells on its faces name these.

    Raises
    ------
    ValueError
        Says what is refused, with line, word and cure.
    InputError
        If the file cannot be read.
    """
    text = read_whole(path).decode("latin-1").replace("\r\n", "\n")
    begins = [*re.finditer(r"^[ \t]*BEGIN[ \t]+\w.*\n", text, re.MULTILINE | re.IGNORECASE)]
    if len(begins) > 1:
        raise ValueError("it has several BEGIN BULK, of superelements: save each in its own file")
    start = begins[0].end() if begins else 0
    end = re.compile(r"^ENDDATA", re.MULTILINE | re.IGNORECASE).search(text, start)
    if end is None:
        raise ValueError("it has no ENDDATA: the file is cut; write it at the end if it is whole")
    bulk = _Bulk()
    first = text.count("\n", 0, start) + 1
    for entry in entries(text[start : end.start()], bulk.wanted, first):
        try:
            bulk.add(entry)
        except ValueError as error:
            said = str(error).removeprefix(f"line {entry.line}: ")
            raise ValueError(f"line {entry.line}: {entry.word}: {said}") from error
    return bulk.mesh()


@dataclass
class _ElementsOfType:
    """Elements of a type of meshio as they are read: nodes, numbers and lines."""

    nodes: list[list[int]] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


class _Bulk:
    """Nodes and elements of the entries so far."""

    def __init__(self) -> None:
        self.numbers, self.places, self.lines = list[int](), list[list[float]](), list[int]()
        self.blocks = defaultdict[str, _ElementsOfType](_ElementsOfType)
        self.groups = defaultdict[str, dict[str, list[int]]](lambda: defaultdict(list))
        self.words = dict[str, int]()  # first line of the elements of each word
        self.passed = defaultdict[str, dict[str, None]](dict)

    def wanted(self, word: str, line: int) -> bool:
        """Whether an entry is read; notes it, if it is passed over, and refuses unknown ones."""
        if word == "GRID" or word in _KINDS:
            return True
        for why, words in _PASSED.items():
            if re.fullmatch(words, word):
                self.passed[why][word] = None
                return False
        cure = "an entry that is not known: take it out if it changes no mass or stiffness"
        for words, own in _REFUSED.items():
            cure = own if re.fullmatch(words, word) else cure
        raise ValueError(f"line {line}: {word[:20] or 'field'}: {cure}")

    def add(self, entry: Entry) -> None:
        """Add a node or an element."""
        cells = entry.cells
        number = whole(cells[0])
        if number < 1:
            raise ValueError("has no number")
        if entry.word == "GRID":
            if whole(cells[1]):
                raise ValueError(
                    f"{number} is in coordinate system {cells[1]}: save the file with all nodes in "
                    "the basic system, 0"
                )
            if len(cells) < 5:
                raise ValueError(f"{number} has no third coordinate: the line below it is missing")
            place = [real(cell, entry.line) if cell else 0.0 for cell in cells[2:5]]
            if not max(map(abs, place)) < FARTHEST:
                raise ValueError(f"coordinates must be below {FARTHEST:g}")
            if any(cells[6:7]):
                self.passed[_LOADED]["fixed directions of GRID"] = None
            self.numbers.append(number)
            self.places.append(place)
            self.lines.append(entry.line)
            return
        kind, owner = _KINDS[entry.word], whole(cells[1])
        nodes = [whole(cell) for cell in cells[2 : 2 + max(kind.names)]]
        if kind.dim == 3:  # whose nodes between corners may be missing
            given = max((k for k, node in enumerate(nodes, 1) if node), default=0)
            nodes = nodes[:given]
        if not owner or not all(nodes) or len(nodes) not in kind.names:
            counts = " or ".join(map(str, kind.names))
            raise ValueError(f"{number} must have a property and {counts} nodes, none left out")
        if kind.dim == 2 and any(cells[2 + len(nodes) :]):
            self.passed[_SECTIONS][f"thickness, offset and angle of {entry.word}"] = None
        name = kind.names[len(nodes)]
        block = self.blocks[name]
        self.groups[f"{kind.card}_{owner}"][name].append(len(block.nodes))
        block.nodes.append([nodes[k] for k in _ORDERS.get(name, range(len(nodes)))])
        block.numbers.append(number)
        block.lines.append(entry.line)
        self.words.setdefault(entry.word, entry.line)

    def mesh(self) -> FileMesh:
        """The mesh."""
        meshio = meshio_with_prisms()
        if not self.blocks:
            raise ValueError("it holds no elements: write GRID, CTETRA, CHEXA and the like")
        top = max(_KINDS[word].dim for word in self.words)
        beams = [word for word in self.words if _KINDS[word].dim == 1 < top]
        if beams:
            raise ValueError(
                f"line {self.words[beams[0]]}: {beams[0]}: bars beside solids or plates are not "
                "read: say bolts as [[bolt]], and take them out"
            )
        numbering = self._numbering()
        cells = [(name, self._nodes(block, numbering)) for name, block in self.blocks.items()]
        found = meshio.Mesh(np.array(self.places), cells)
        for cells_of, block in zip(found.cells, self.blocks.values(), strict=True):
            if cells_of.dim == top and (
                again := repeated(cells_of.data, FORMS[cells_of.type].corners)
            ):
                place, other = again
                raise ValueError(
                    f"line {block.lines[place]}: element {block.numbers[place]} has the corners of "
                    f"element {block.numbers[other]}, which would count twice: take one out"
                )
        check_count(len(self.groups))
        order = {name: place for place, name in enumerate(self.blocks)}
        found.cell_sets = {  # as blocks and members, which meshio's constructor does not take
            group: {order[name]: np.array(members) for name, members in own.items()}
            for group, own in self.groups.items()
        }
        return FileMesh([found], self._notes(top))

    def _numbering(self) -> Numbering:
        """Places of the nodes by their numbers."""
        numbering = Numbering(np.array(self.numbers, dtype=np.intp))
        again, _ = numbering.repeated()
        if again.size:
            place = int(again.min())
            raise ValueError(
                f"line {self.lines[place]}: GRID: {self.numbers[place]} stands twice: number them "
                "anew"
            )
        own = [(number, line) for block in self.blocks.values()
               for number, line in zip(block.numbers, block.lines, strict=True)]  # fmt: skip
        again, _ = Numbering(np.array([number for number, _ in own])).repeated()
        if again.size:
            number, line = own[int(again.min())]
            raise ValueError(f"line {line}: element {number} stands twice: number them anew")
        return numbering

    def _nodes(self, block: _ElementsOfType, numbering: Numbering) -> IntArray:
        """Places of the nodes of elements."""
        numbers = np.array(block.nodes, dtype=np.intp)
        places = numbering.places(numbers)
        missing = (places < 0).any(axis=1)
        if missing.any():
            row = int(np.argmax(missing))
            raise ValueError(
                f"line {block.lines[row]}: node {numbers[row, np.argmin(places[row])]} of element "
                f"{block.numbers[row]} is not in the file"
            )
        return places

    def _notes(self, top: int) -> list[str]:
        """What is passed over, or computed otherwise."""
        notes = [f"{why} ({', '.join(words)})" for why, words in self.passed.items()]
        notes = [f"passed over are {'; '.join(notes)}"] if notes else []
        shells = [word for word in self.words if _KINDS[word].dim == 2]
        beams = [word for word in self.words if word in ("CBAR", "CBEAM")]
        if beams:
            notes.append(f"{', '.join(beams)} are computed as bars, which carry no bending")
        if shells and top == 2:
            notes.append(f"{', '.join(shells)} are computed as plates, loaded in their plane")
        elif shells:
            notes.append(f"{', '.join(shells)} on solids name their faces, and have no stiffness")
        return notes
