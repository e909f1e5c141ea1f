"""Meshes of Abaqus and CalculiX files (.inp), with their sets and surfaces as named groups.

`skfem_joint.mesh.decks.cards` takes the file apart, `keywords` says which cards count,
`sets` keeps what they list, scope by scope. Here instances are put in their places, and sets
become what meshio would have read, if it read them: cells, sets of cells and points.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import listed
from skfem_joint.mesh.decks.cards import Card, read_cards
from skfem_joint.mesh.decks.elements import TYPES, ElementForm, plane_of, remark
from skfem_joint.mesh.decks.keywords import sorted_out
from skfem_joint.mesh.decks.sets import FARTHEST, NameSet, Scope, Surface
from skfem_joint.mesh.decks.sides import Sides, blocks_of
from skfem_joint.mesh.file_mesh import FileMesh
from skfem_joint.mesh.gmsh import meshio_with_prisms
from skfem_joint.mesh.named import check_count

if TYPE_CHECKING:
    import meshio

#: Members of all sets together, of which each takes 8 bytes.
_MOST_MEMBERS = 10**8
#: Cards without lines of data.
_BARE = ("PART", "END PART", "END INSTANCE", "ASSEMBLY", "END ASSEMBLY")
#: What a name in use twice is told apart by.
_KINDS = {"NSET": "nodes", "ELSET": "elements", "SURFACE": "surface"}


def read_inp(path: Path) -> FileMesh:
    """Read an Abaqus or CalculiX file.

    Raises
    ------
    ValueError
        Says what is refused, with line, keyword and cure.
    InputError
        If the file cannot be read.
    """
    cards, notes = sorted_out(read_cards(path))
    deck = _Deck()
    for keyword, card in cards:
        deck.read(keyword, card)
    deck.ended()
    return deck.mesh(notes)


@dataclass
class _PartOf:
    """A part or an instance as it is read: its name and card, and the cards in it."""

    name: str
    card: Card
    cards: list[tuple[str, Card]] = field(default_factory=list)
    used: bool = False


class _Deck:
    """Parts, instances and all that stands outside of them."""

    def __init__(self) -> None:
        self.parts: dict[str, _PartOf] = {}
        self.instances: dict[str, Scope] = {}
        self.outside = Scope("", self.instances, self.nodes_of)
        self.shifts: dict[str, list[FloatArray]] = {}  # shift, and axis and angle, by instance
        self.open: _PartOf | None = None  # part or instance that has not ended
        self.assembly: Card | None = None
        self._nodes = np.zeros((0, 0), dtype=np.intp)

    @property
    def scopes(self) -> list[Scope]:
        """All scopes, that outside of instances first."""
        return [self.outside, *self.instances.values()]

    def nodes_of(self, elements: IntArray) -> IntArray:
        """Nodes of elements."""
        nodes = self._nodes[elements]
        return nodes[nodes >= 0]

    def read(self, keyword: str, card: Card) -> None:
        """Take up the next card."""
        if keyword in _BARE and card.body.strip():
            card.refuse("has lines of data: is the file damaged?", card.first)
        if keyword in ("PART", "INSTANCE"):
            self._begin(keyword, card)
        elif keyword in ("END PART", "END INSTANCE"):
            self._end(keyword, card)
        elif keyword in ("ASSEMBLY", "END ASSEMBLY"):
            if self.open or (self.assembly is None) == (keyword == "END ASSEMBLY"):
                card.refuse("stands where nothing begins or ends: is the file cut?")
            self.assembly = card if keyword == "ASSEMBLY" else None
        elif self.open is not None:
            self.open.cards.append((keyword, card))
        else:
            self.outside.read(keyword, card)

    def _begin(self, keyword: str, card: Card) -> None:
        """Begin a part or an instance."""
        name = card.name("NAME")
        if self.open is not None:
            last = self.open.card
            card.refuse(f"*{last.keyword} of line {last.line} has not ended: is the file cut?")
        known: Iterable[str] = self.parts if keyword == "PART" else self.instances
        if name.upper() in known:
            card.refuse(f"name {name!r} stands above already: give each its own")
        self.open = _PartOf(name, card)
        if keyword == "PART":
            self.parts[name.upper()] = self.open
            return
        part = self.parts.get(card.name("PART").upper())
        if part is None:
            there = listed([each.name for each in self.parts.values()])
            card.refuse(f"found part {card.name('PART')!r}, must be one that stands above: {there}")
        part.used = True
        self.open.cards += part.cards
        self.shifts[name.upper()] = _shift(card)

    def _end(self, keyword: str, card: Card) -> None:
        """End a part or an instance; the cards of an instance are read now."""
        kind, own = keyword.removeprefix("END "), self.open
        if own is None or own.card.keyword != kind:
            card.refuse(f"stands without *{kind} above: is the file cut?")
        self.open = None
        if kind == "INSTANCE":
            scope = self.instances[own.name.upper()] = Scope(own.name, {}, self.nodes_of)
            for inner, each in own.cards:
                scope.read(inner, each)

    def ended(self) -> None:
        """Refuse a file that ends inside of a part, an instance or the assembly."""
        last = self.open.card if self.open else self.assembly
        if last is not None:
            last.refuse(f"has no *END {last.keyword}: is the file cut?")

    def mesh(self, notes: list[str]) -> FileMesh:
        """The mesh; ``notes`` are added to."""
        kinds = {kind: card for scope in self.scopes for kind, card in scope.kinds.items()}
        spare = [part.name for part in self.parts.values() if not part.used]
        if not kinds:
            where = f"; no *INSTANCE places part {listed(spare)}" if spare else ""
            raise ValueError(f"it holds no elements: write *NODE and *ELEMENT{where}")
        if spare:
            notes.append(f"part {listed(spare)} is left out, since no *INSTANCE places it")
        forms, plane = _forms(kinds)
        notes += [
            f"elements of type {kind} {remark(kind)}" for kind in sorted(kinds) if remark(kind)
        ]
        places, form_of, owns = self._placed(forms)
        if forms[0].name == "line3":
            self._nodes = _inner_last(places, self._nodes)
        sides = Sides(forms, form_of, self._nodes, len(places))
        found = _Groups(sides)
        for scope in self.scopes:
            found.add(scope)
        notes += [f"{listed(names)} {why}: left out" for why, names in found.left_out.items()]
        bodies = owns if sides.dim == 1 else [slice(0, len(self._nodes))]
        groups = found.named()
        return FileMesh([_body(sides, places, own, groups) for own in bodies], notes, plane)

    def _placed(self, forms: Sequence[ElementForm]) -> tuple[FloatArray, IntArray, list[slice]]:
        """Positions of all nodes, forms of elements, and the elements of scopes that have some."""
        places, elements, form_of = list[FloatArray](), list[IntArray](), list[IntArray]()
        n_nodes = n_elements = 0
        for scope in self.scopes:
            scope.placed(n_nodes, n_elements)
            places.append(_moved(scope.places, self.shifts.get(scope.name.upper(), [])))
            own, own_forms = scope.nodes_of_elements(forms)
            elements.append(own)
            form_of.append(own_forms)
            n_nodes, n_elements = n_nodes + len(places[-1]), n_elements + len(elements[-1])
        self._nodes = np.concatenate(elements)
        ends = np.cumsum([0, *map(len, elements)]).tolist()
        owns = [slice(*pair) for pair in pairwise(ends)]
        owns = [own for own in owns if own.start < own.stop]
        return np.concatenate(places), np.concatenate(form_of), owns


@dataclass(frozen=True)
class _Group:
    """A named group.

    Attributes
    ----------
    scope, kind, name, card : str, str, str, Card
        Instance, kind of set, name and first card.
    what : {"elements", "sides", "nodes"}
        What ``members`` are: elements (n,), corners of sides (n, corners), or nodes (n,).
    members : ndarray of int
    """

    scope: str
    kind: str
    name: str
    card: Card
    what: str
    members: IntArray


class _Groups:
    """Groups that sets and surfaces become, and names of those that become none, by the reason."""

    def __init__(self, sides: Sides) -> None:
        self.sides, self.size = sides, 0
        self.groups: list[_Group] = []
        self.left_out: dict[str, list[str]] = {}

    def add(self, scope: Scope) -> None:
        """Add sets and surfaces of a scope, but internal ones."""
        every: list[tuple[str, NameSet | Surface]] = [
            *((kind, each) for kind, table in scope.sets.items() for each in table.values()),
            *(("SURFACE", each) for each in scope.surfaces.values()),
        ]
        shown = [(kind, each) for kind, each in every if not each.internal]
        check_count(len(self.groups) + len(shown))
        for kind, each in shown:
            if isinstance(each, Surface):
                what, members = self._of_surface(each)
            else:
                what, members = self._of_set(kind, each.members())
            if isinstance(members, str):
                name = f"{scope.name}.{each.name}" if scope.name else each.name
                self.left_out.setdefault(members, []).append(name)
                continue
            self.size += members.size
            if self.size > _MOST_MEMBERS:
                each.card.refuse(f"all sets together have more than {_MOST_MEMBERS} members")
            self.groups.append(_Group(scope.name, kind, each.name, each.card, what, members))

    def _of_set(self, kind: str, members: IntArray) -> tuple[str, IntArray | str]:
        """What a set becomes, and its members or why it becomes nothing."""
        if not members.size:
            return "", f"{'with' if kind == 'NSET' else 'of elements with'} no members"
        if kind == "ELSET":
            return "elements", members
        return self.sides.group(members)

    def _of_surface(self, surface: Surface) -> tuple[str, IntArray | str]:
        """The same of a surface."""
        if surface.nodes is not None:
            return self._of_set("NSET", surface.nodes.members())
        parts = list[IntArray]()
        for label, own, line in surface.faces:
            elements = np.unique(own())
            labels = self.sides.labels(elements) if elements.size else [label]
            if label and label not in labels:
                surface.card.refuse(
                    f"found face {label[:40]!r}, must be one of {', '.join(labels)}", line
                )
            if label:
                parts.append(self.sides.numbered(elements, label))
                continue
            of_set = self.sides.free(elements)
            if not self.sides.are_free(of_set):
                surface.card.refuse(
                    "without a face these are the free sides of the elements, and some of those "
                    f"touch other elements: name the faces, {', '.join(labels)}",
                    line,
                )
            parts.append(of_set)
        sides = np.concatenate(parts)
        if not sides.size:
            return "", "with no members"
        return ("nodes", np.unique(sides)) if self.sides.dim == 1 else ("sides", sides)

    def named(self) -> dict[str, _Group]:
        """Groups by the names that they get.

        A name has the instance before it where it stands in several scopes, and its kind behind
        it where sets of several kinds in a scope have it.
        """
        scopes, kinds = dict[str, set[str]](), Counter[tuple[str, str]]()
        for group in self.groups:
            scopes.setdefault(group.name.upper(), set()).add(group.scope)
            kinds[group.scope, group.name.upper()] += 1
        named = dict[str, _Group]()
        for group in self.groups:
            name, key = group.name, group.name.upper()
            if group.scope and len(scopes[key]) > 1:
                name = f"{group.scope}.{name}"
            if kinds[group.scope, key] > 1:
                name = f"{name} ({_KINDS[group.kind]})"
            if name in named:
                group.card.refuse(f"name {name!r} comes about twice: give each its own")
            named[name] = group
        return named


def _body(sides: Sides, places: FloatArray, own: slice, groups: dict[str, _Group]) -> meshio.Mesh:
    """Mesh of some elements, with their groups."""
    chosen = np.arange(len(sides.elements))[own]
    cells, block_of = list[tuple[str, IntArray]](), list[IntArray]()
    for number, form in enumerate(sides.forms):
        block_of.append(chosen[sides.form_of[chosen] == number])
        cells.append((form.name, sides.elements[block_of[-1]][:, : form.nodes]))
    cell_sets, points = dict[str, dict[int, IntArray]](), dict[str, IntArray]()
    used = np.zeros(len(places), dtype=np.bool_)
    nodes = sides.elements[own]
    used[nodes[nodes >= 0]] = True
    for name, group in groups.items():
        if group.what == "elements":
            inside = [np.flatnonzero(np.isin(block, group.members)) for block in block_of]
            members = {number: numbers for number, numbers in enumerate(inside) if numbers.size}
            if members:
                cell_sets[name] = members
        elif group.what == "sides":
            cell_sets[name] = {}
            for side in blocks_of(group.members):
                cell_sets[name][len(cells)] = np.arange(len(side[1]))
                cells.append(side)
        elif used[group.members].any():
            points[name] = group.members[used[group.members]]
    mesh = meshio_with_prisms().Mesh(places, cells, point_sets=points)
    mesh.cell_sets = cell_sets  # as blocks and members, which its constructor does not take
    return mesh


def _forms(kinds: Mapping[str, Card]) -> tuple[list[ElementForm], str]:
    """Shapes of the elements, and the state across a plate.

    Refuses shapes that do not go together, and several states.
    """
    first, *others = kinds
    for kind in others:
        one, other = TYPES[first], TYPES[kind]
        where = f"elements of type {first} stand in line {kinds[first].line}"
        if one.dim != other.dim:
            kinds[kind].refuse(
                f"type {kind}: {where}, and a mesh holds bars, plates or solids alone: take "
                "elements of other kinds out, or save each body in a file of its own"
            )
        if one.family != other.family:
            kinds[kind].refuse(
                f"type {kind}: {where}, and all elements must have the same order, and shapes that "
                "go together: hexahedra and prisms, or quadrilaterals and triangles; mesh one of "
                "them anew"
            )
        if plane_of(first) != plane_of(kind):
            kinds[kind].refuse(
                f"type {kind}: {where}, and a mesh has plane stress or plane strain: choose one"
            )
    forms = {TYPES[kind].name: TYPES[kind] for kind in kinds}
    return [*forms.values()], plane_of(first)


def _shift(card: Card) -> list[FloatArray]:
    """Shift of an instance, and the two ends of an axis with an angle in degrees, if given."""
    values, counts = card.numbers
    sizes = counts.tolist()
    if sizes not in ([], [3], [7], [3, 7]) or not (np.abs(values) < FARTHEST).all():
        card.refuse(
            "has a line with a shift, of three numbers, and one with two points of an axis and an "
            f"angle, of seven, below {FARTHEST:g}; both may be missing",
            card.first,
        )
    parts = np.split(values, np.cumsum(sizes)[:-1])
    for ends in parts:
        if ends.size == 7 and np.linalg.norm(ends[:3] - ends[3:6]) < 1.0 / FARTHEST:
            card.refuse("both points of the axis lie in one place", card.line_of(len(sizes) - 1))
    return parts if sizes else []


def _moved(places: FloatArray, shift: list[FloatArray]) -> FloatArray:
    """Positions (n, 3), first shifted, then turned about an axis."""
    for part in shift:
        if part.size == 3:
            places = places + part
            continue
        start, along = part[:3], part[3:6] - part[:3]
        turn = Rotation.from_rotvec(np.radians(part[6]) * along / np.linalg.norm(along))
        places = turn.apply(places - start) + start
    return places


def _inner_last(places: FloatArray, nodes: IntArray) -> IntArray:
    """Nodes (n, 3) of bars with the one between the ends last, as in Gmsh.

    Programs write it in different places: it is the one opposite to the longest side.
    """
    x = places[nodes]
    opposite = np.linalg.norm(np.roll(x, 1, axis=1) - np.roll(x, -1, axis=1), axis=-1)
    order = np.array([[1, 2, 0], [0, 2, 1], [0, 1, 2]])[opposite.argmax(axis=1)]
    return np.take_along_axis(nodes, order, axis=1)
