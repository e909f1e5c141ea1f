"""Abaqus and CalculiX files that say the same mesh in many ways, for the tests of their reader.

Orders of nodes and numbers of faces are those of the programs' manuals, counted from 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.inp import model
from benchmarks.inp import sides as sides_of
from scipy.spatial.transform import Rotation

from skfem_joint.mesh import NamedMesh, build_bar, build_box, build_plate, merged

#: Kind and order of the package by type.
KINDS = {
    **{"T3D2": ("line", 1), "B31": ("line", 1), "B32": ("line", 1)},
    **{"CPS3": ("triangle", 1), "CPS4": ("quadrilateral", 1), "CPS6": ("triangle", 2)},
    **{"CPS8R": ("quadrilateral", 2), "C3D4": ("tetrahedron", 1), "C3D10": ("tetrahedron", 2)},
    **{"C3D8I": ("hexahedron", 1), "C3D8R": ("hexahedron", 1), "C3D20R": ("hexahedron", 2)},
}
TYPES = {
    "bar": ["T3D2", "B31", "B32"],
    "plates": ["CPS4", "CPS3", "CPS6", "CPS8R"],
    "solids": ["C3D10", "C3D8I", "C3D20R", "C3D4", "C3D8R"],
}


@dataclass
class Deck:
    """Mesh as a file writes it: nodes, also those between corners, elements and members of names.

    ``sides`` are element, number of the face from 1 on and nodes; all else counts from 0.
    """

    kind: str
    xyz: np.ndarray
    elements: np.ndarray
    body: np.ndarray
    regions: dict[str, np.ndarray]
    sides: dict[str, list[tuple[int, int, list[int]]]]
    points: dict[str, int]


@cache
def mesh_of(what: str, kind: str) -> NamedMesh:
    """Jointed bar, or lap of two plates or solids, with elements of a type."""
    shape, order = KINDS[kind]
    strips = [("ARM", 0.2, 4), ("JOINT", 0.1, 2)]
    if what == "bar":
        return build_bar(strips, {"FIXED": 0.0, "TIP": 0.3})
    bodies = []
    for name, start, face, arm in (
        ("lower", 0.0, "top", "left"),
        ("upper", 0.2, "bottom", "right"),
    ):
        ends = {"left": [("arm", 0.2, 3), ("lap", 0.1, 2)]}
        ends["right"] = ends["left"][::-1]
        own = [(f"{name}_{part}", length, count) for part, length, count in ends[arm]]
        options: dict[str, Any] = {"kind": shape, "order": order}
        low = 0.0 if name == "lower" else 0.02
        if what == "plates":
            names = {f"{name}_face": (face, f"{name}_lap"), f"{name}_end": arm}
            options |= {"boundaries": names, "points": {f"{name}_corner": (start, low)}}
            bodies.append(build_plate(own, 0.02, 2, origin=(start, low), **options))
        else:
            face = {"top": "back", "bottom": "front"}[face]
            names = {f"{name}_face": (face, f"{name}_lap"), f"{name}_end": arm}
            options |= {"boundaries": names, "points": {f"{name}_corner": (start, 0.0, low)}}
            bodies.append(build_box(own, (0.03, 0.02), (2, 2), origin=(start, 0.0, low), **options))
    return merged(bodies)


def deck_of(mesh: NamedMesh, kind: str) -> Deck:
    """The mesh as a file writes it with elements of a type."""
    xyz, tables = model(mesh)
    ((_, elements),) = tables.values()
    sides = {name: [*sides_of(mesh, name, tables)] for name in mesh.boundaries}
    regions = dict(mesh.regions)
    if kind == "B32":
        elements = np.array([[2 * k, 2 * k + 1, 2 * k + 2] for k in range(len(elements) // 2)])
        regions = {name: np.unique(chosen // 2) for name, chosen in regions.items()}
    body = mesh.body if kind != "B32" else np.zeros(len(elements), dtype=int)
    return Deck(kind, xyz, elements, body, regions, sides, dict(mesh.points))


#: Ways to write the same mesh; what is not said is as in the first.
WAYS: dict[str, dict[str, Any]] = {
    "plain": {},
    "two blocks of nodes": {"nodes": "two"},
    "a set on nodes": {"nodes": "set"},
    "a set over two blocks": {"elements": "cut"},
    "sets after the elements": {"elements": "plain"},
    "unsorted": {"elements": "plain", "sets": "unsorted"},
    "generated": {"elements": "plain", "sets": "generate"},
    "sets of sets": {"elements": "plain", "sets": "nested"},
    "named twice": {"elements": "plain", "sets": "twice", "surfaces": "nset"},
    "sets before the nodes": {"elements": "plain", "before": True},
    "faces of single elements": {"surfaces": "single"},
    "surfaces of nodes": {"surfaces": "nodes"},
    "sets of nodes": {"surfaces": "nset", "sets": "unsorted"},
    "parts": {"place": "parts", "surfaces": "single"},
    "parts with a shift": {"place": "shifted", "above": True, "elements": "plain"},
    "parts with a shift and a turn": {"place": "turned", "above": True, "surfaces": "nset"},
    "small letters and comments": {"text": ["lower", "comments"]},
    "other line ends": {"text": ["bom", "crlf", "continued"], "sets": "twice",
                        "elements": "plain"},
    "included and in quotes": {"text": ["included", "quoted"], "surfaces": "single"},
    "a whole model": {"text": ["model", "split", "exponents"]},
}  # fmt: skip


class Writer:
    """Writer of a deck in one way."""

    def __init__(self, deck: Deck, way: dict[str, Any], number: int = 0) -> None:
        self.deck, self.rng = deck, np.random.default_rng(number)
        self.nodes, self.elements = way.get("nodes", "one"), way.get("elements", "named")
        self.sets, self.surfaces = way.get("sets", "list"), way.get("surfaces", "faces")
        self.place, self.above = way.get("place", "flat"), way.get("above", False)
        self.before, self.text = way.get("before", False), way.get("text", [])

    def written(self, folder: Path) -> Path:
        """File in a folder."""
        bodies = [np.arange(len(self.deck.elements))]
        if self.place != "flat":
            bodies = [np.flatnonzero(self.deck.body == k) for k in range(self.deck.body.max() + 1)]
        lines, assembly = ["*Heading", "a model"], ["*Assembly, name=All"]
        for number, own in enumerate(bodies):
            nodes, instance = np.unique(self.deck.elements[own]), f"Body-{number}"
            shift, turn = self._placing(number)
            sets = self._sets(own, nodes, instance if self.above else "")
            base = self._base(own, nodes, shift, turn)
            if self.place == "flat":
                lines += [*sets, *base] if self.before else [*base, *sets]
                continue
            lines += [f"*Part, name=P{number}", *base, *([] if self.above else sets), "*End Part"]
            assembly += [f"*Instance, name={instance}, part=P{number}", *shift, *turn]
            assembly += ["*End Instance"]
            if self.above:
                assembly += sets
        if self.place != "flat":
            lines += [*assembly, "*End Assembly"]
        return self._saved(lines, folder)

    def _placing(self, number: int) -> tuple[list[str], list[str]]:
        """Lines of an instance."""
        if self.place == "parts":
            return [], []
        if self.place == "turned":
            return [f"{0.1 + number}, 0.25, 0."], [f"0.5, 0., 0., 0.5, 0., {1 + number}, 30."]
        return [f"{number}., -0.5, 0."], []

    def _base(
        self, own: np.ndarray, nodes: np.ndarray, shift: Sequence[str], turn: Sequence[str]
    ) -> list[str]:
        """Nodes and elements."""
        deck, xyz = self.deck, self.deck.xyz[nodes]
        if self.place != "flat":
            for line in turn:
                a = np.array([float(x) for x in line.split(",")])
                axis = (a[3:6] - a[:3]) / np.linalg.norm(a[3:6] - a[:3])
                back = Rotation.from_rotvec(-np.radians(a[6]) * axis)
                xyz = back.apply(xyz - a[:3]) + a[:3]
            for line in shift:
                xyz = xyz - [float(x) for x in line.split(",")]
        rows = [
            f"{self._label(nodes, node)}, {', '.join(repr(float(x)) for x in place)}"
            for node, place in zip(nodes, xyz, strict=True)
        ]
        head = "*Node, nset=NALL" if self.nodes == "set" else "*Node"
        half = len(rows) // 2
        lines = [head, *rows]
        if self.nodes == "two":
            lines = [head, *rows[:half], "*NODE", *rows[half:]]
        left = own
        blocks: list[tuple[str, np.ndarray]] = []
        if self.elements != "plain":
            for name, chosen in deck.regions.items():
                inside = left[np.isin(left, chosen)]
                left = np.setdiff1d(left, inside)
                parts = [inside[:1], inside[1:]] if self.elements == "cut" else [inside]
                blocks += [(f", ELSET={name}", part) for part in parts if part.size]
        blocks = [*blocks, ("", left)] if left.size else blocks
        for option, block in blocks:
            lines.append(f"*Element, TYPE={deck.kind}{option}")
            for element in block:
                words = [self._label(own, element)]
                words += [self._label(nodes, node) for node in deck.elements[element]]
                cuts = range(0, len(words), 3) if "split" in self.text else [0]
                ends = [*cuts, len(words)]
                rows = [", ".join(words[a:b]) for a, b in pairwise(ends)]
                lines += [f"{row}," for row in rows[:-1]] + rows[-1:]
        return lines

    def _label(self, among: np.ndarray, number: int) -> str:
        """Number in the file: within a part from 1 on, else from 11 on."""
        if self.place == "flat":
            return str(int(number) + 11)
        return str(int(np.searchsorted(among, number)) + 1)

    def _set(
        self, kind: str, name: str, numbers: Sequence[str], instance: str, internal: bool = False
    ) -> list[str]:
        """A set of nodes or elements."""
        option = f", instance={instance}" if instance else ""
        option += ", internal" if internal else ""
        head = f"*{kind}, {kind}={name}{option}"
        numbers = list(numbers)
        if self.sets == "unsorted":
            self.rng.shuffle(numbers)
            head += ", unsorted"
        if self.sets == "generate":
            lines, values = [f"{head}, GENERATE"], sorted(map(int, numbers))
            runs = np.split(values, np.flatnonzero(np.diff(values) != 1) + 1)
            for k, run in enumerate(runs):
                lines.append(f"{run[0]}, {run[-1]}{', 1' if k % 2 else ''}")
            return lines
        half = (len(numbers) + 1) // 2
        first, second = _rows(numbers[:half]), _rows(numbers[half:])
        if self.sets == "nested" and second:
            mark = "" if internal else ", internal"
            parts = [f"*{kind}, {kind}={name}_{k}{option}{mark}" for k in "AB"]
            last = head.replace(f", instance={instance}", "")
            return [parts[0], *first, parts[1], *second, last, f"{name}_a, {name}_B"]
        if self.sets == "twice" and second:
            return [head, *first, head.replace(name, name.lower()), *second]
        return [head, *first, *second]

    def _sets(self, own: np.ndarray, nodes: np.ndarray, instance: str) -> list[str]:
        """All sets and surfaces of some elements."""
        deck, lines = self.deck, list[str]()
        if self.elements == "plain":
            for name, chosen in deck.regions.items():
                inside = [self._label(own, k) for k in chosen if k in own]
                lines += self._set("ELSET", name, inside, instance) if inside else []
        for name, node in deck.points.items():
            if node in nodes:
                lines += self._set("NSET", name, [self._label(nodes, node)], instance)
        for name, sides in deck.sides.items():
            sides = [each for each in sides if each[0] in own]
            if not sides:
                continue
            every = sorted({node for _, _, each in deck.sides[name] for node in each})
            on = [self._label(nodes, node) for node in every]
            if self.surfaces == "nset":
                lines += self._set("NSET", name, on, instance)
            elif self.surfaces == "nodes":
                lines += self._set("NSET", f"_{name}", on, instance, internal=True)
                lines += [f"*SURFACE, NAME={name}, TYPE=NODE", f"_{name}, 1."]
            elif self.surfaces == "single":
                lines.append(f"*SURFACE, NAME={name}")
                prefix = f"{instance}." if instance else ""
                lines += [f"{prefix}{self._label(own, k)}, S{side}" for k, side, _ in sides]
            else:
                rows = []
                for side in sorted({side for _, side, _ in sides}):
                    inside = [self._label(own, k) for k, each, _ in sides if each == side]
                    lines += self._set("ELSET", f"_{name}_S{side}", inside, instance, True)
                    rows.append(f"_{name}_S{side}, S{side}")
                lines += [f"*SURFACE, NAME={name}, TYPE=ELEMENT", *rows]
        return lines

    def _saved(self, lines: list[str], folder: Path) -> Path:
        """File with the lines as the way says."""
        files = {"model.inp": lines}
        if "model" in self.text:
            lines += MODEL.splitlines()
        if "comments" in self.text:
            lines[1:1] = ["** a comment, *NODE"]
            for at in range(len(lines) - 1, 4, -5):
                lines[at:at] = ["** another", "   "]
        if "exponents" in self.text:
            at = lines.index("*Node")
            lines[at + 1] = lines[at + 1].replace("0.0", "0.D+0").replace("0.D+0, 0", ", 0")
        if "continued" in self.text:
            lines = [line.replace(", ", ",\n  ") if line[0] == "*" else line for line in lines]
        if "lower" in self.text:
            names = {*self.deck.regions, *self.deck.sides, *self.deck.points}
            lines = [line if any(f"={name}" in line for name in names) else line.lower()
                     for line in lines]  # fmt: skip
        if "quoted" in self.text:
            for name in (*self.deck.regions, *self.deck.sides, *self.deck.points):
                lines = [line.replace(f"={name}", f'="{name}"') if line.endswith(f"={name}")
                         else line for line in lines]  # fmt: skip
        if "included" in self.text:
            at = next(k for k, line in enumerate(lines) if line.startswith("*Element"))
            (folder / "parts").mkdir(exist_ok=True)
            files = {"parts/nodes.inc": lines[2:at], "parts/rest.inc": lines[at:]}
            files["parts/both.inc"] = ["*INCLUDE, INPUT=parts/nodes.inc", "**",
                                       "*Include, input=parts/rest.inc"]  # fmt: skip
            files["model.inp"] = [*lines[:2], '*INCLUDE, INPUT="parts/both.inc"']
        else:
            files["model.inp"] = lines
        for name, own in files.items():
            text = "\n".join([*own, ""])
            if "crlf" in self.text:
                text = text.replace("\n", "\r\n")
            mark = "\ufeff" if "bom" in self.text else ""
            (folder / name).write_bytes((mark + text).encode())
        return folder / "model.inp"


def _rows(numbers: Sequence[str]) -> list[str]:
    """Lines of at most 16 numbers."""
    return [", ".join(numbers[at : at + 16]) for at in range(0, len(numbers), 16)]


#: What stands below a mesh in a whole model, and is passed over.
MODEL = """\
*MATERIAL, NAME=STEEL
*ELASTIC
 200000., 0.3
*DENSITY
 7.85E-9,
*SOLID SECTION, ELSET=ALL, MATERIAL=STEEL
*SURFACE INTERACTION, NAME=DRY
1.,
*FRICTION, SLIP TOLERANCE=0.005
 0.3,
*CONTACT PAIR, INTERACTION=DRY, TYPE=SURFACE TO SURFACE
upper_face, lower_face
*BOUNDARY
lower_end, ENCASTRE
*STEP, NLGEOM=NO
*FREQUENCY
 10,
*BOUNDARY
lower_end, 1, 3
*NODE FILE
U
*END STEP"""
