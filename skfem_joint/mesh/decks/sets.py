"""Nodes, elements, sets and surfaces of Abaqus and CalculiX files, by the scope they stand in.

A scope is an instance of a part, or all that stands outside of instances. Numbers of nodes and
elements count within it. Sets keep what their cards list until all nodes and elements are known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray, Numbering
from skfem_joint.ground.errors import closest, listed
from skfem_joint.mesh.cells import repeated
from skfem_joint.mesh.decks.cards import Card, bare
from skfem_joint.mesh.decks.elements import ElementForm, form_of_type

#: Largest coordinate.
FARTHEST = 1e20
#: Finds members of a set among all nodes or elements, when all are placed.
_Part = Callable[[], IntArray]
#: What the members of sets are called.
_MEMBER = {"NSET": "node", "ELSET": "element"}


@dataclass
class NameSet:
    """A set: its name as first written, and what finds the members that cards list in it."""

    name: str
    card: Card
    internal: bool = False
    parts: list[_Part] = field(default_factory=list)
    used: int | None = None  # line of a card that has listed it
    found: IntArray | None = None

    def members(self) -> IntArray:
        """Sorted places of the members among all nodes or elements, when all are placed."""
        if self.found is None:
            none = np.zeros(0, np.intp)
            try:
                every = np.concatenate([none, *(part() for part in self.parts)])
            except RecursionError:
                self.card.refuse(
                    f"set {self.name!r} lists itself, or sets stand inside each other too often: "
                    "write its members out"
                )
            self.found = every if np.all(np.diff(every) > 0) else np.unique(every)
        return self.found


@dataclass
class Surface:
    """A surface: faces of elements, each with a label and a line; or a set of nodes."""

    name: str
    card: Card
    internal: bool
    nodes: NameSet | None = None
    faces: list[tuple[str, _Part, int]] = field(default_factory=list)


@dataclass(frozen=True)
class _Block:
    """Nodes or elements of a card: numbers, line of data of each, and coordinates or nodes."""

    card: Card
    numbers: IntArray
    rows: IntArray
    values: FloatArray | IntArray


class Scope:
    """Nodes, elements and sets that stand in one instance, or outside of all instances.

    Parameters
    ----------
    name : str
        Name of the instance, "" outside of all.
    others : mapping of str to Scope
        Instances that may be named in it, by their names in capitals; more may come.
    nodes_of : callable
        Nodes of elements, when all are placed.

    Attributes
    ----------
    sets : dict of dict
        Sets of nodes and of elements, NSET and ELSET, by their names in capitals.
    surfaces : dict of str to Surface
        Surfaces by their names in capitals.
    kinds : dict of str to Card
        First card of each type of elements.
    numbering : dict of str to Numbering
        Numbers of nodes and elements, NSET and ELSET, known when all are `placed`.
    """

    def __init__(
        self, name: str, others: Mapping[str, Scope], nodes_of: Callable[[IntArray], IntArray]
    ) -> None:
        self.name, self.others, self._nodes_of = name, others, nodes_of
        self.sets: dict[str, dict[str, NameSet]] = {"NSET": {}, "ELSET": {}}
        self.surfaces: dict[str, Surface] = {}
        self.kinds: dict[str, Card] = {}
        self.numbering: dict[str, Numbering] = {}
        self._nodes: list[_Block] = []
        self._elements: list[_Block] = []

    def read(self, keyword: str, card: Card) -> None:
        """Take up a card."""
        if keyword == "NODE":
            self._read_nodes(card)
        elif keyword == "ELEMENT":
            self._read_elements(card)
        elif keyword == "SURFACE":
            self._read_surface(card)
        elif keyword in self.sets:
            self._read_set(keyword, card)

    def _read_nodes(self, card: Card) -> None:
        values, counts = card.numbers
        if not counts.size:
            return
        wrong = (counts < 2) | (counts > 7)  # coordinates, and perhaps directions of normals
        if wrong.any():
            row = int(np.argmax(wrong))
            card.refuse(
                f"found {counts[row]} numbers, must be those of a node and its coordinates",
                card.line_of(row),
            )
        starts = np.cumsum(counts) - counts
        places = np.zeros((counts.size, 3))
        for axis in range(3):
            has = counts > axis + 1
            given = values[starts[has] + axis + 1]
            places[has, axis] = np.where(np.isnan(given), 0.0, given)  # empty fields are zero
        far = ~(np.abs(places) < FARTHEST).all(axis=1)
        if far.any():
            card.refuse(
                f"coordinates must be finite and below {FARTHEST:g}",
                card.line_of(int(np.argmax(far))),
            )
        rows = np.arange(counts.size)
        block = _Block(card, _whole(card, values[starts], rows), rows, places)
        self._nodes.append(block)
        if "NSET" in card.options:
            self._named("NSET", card).parts.append(self._listed("NSET", card, block.numbers))

    def _read_elements(self, card: Card) -> None:
        kind = card.options.get("TYPE", "").upper()
        try:
            width = 1 + form_of_type(kind).nodes
        except ValueError as error:
            card.refuse(str(error))
        values, counts = card.numbers
        if not counts.size:
            card.refuse("has no elements: take it out, or is the file cut?")
        ends = np.cumsum(counts)
        wanted = np.arange(width, values.size + width, width)
        rows = np.searchsorted(ends, wanted - width, side="right")
        # Each element begins with a line of its own.
        wrong = ~np.isin(wanted, ends)
        if wrong.any():
            row = int(rows[np.argmax(wrong)])
            card.refuse(
                f"must be the number of an element of type {kind} and of its {width - 1} nodes, "
                f"found {counts[row]} numbers in this line",
                card.line_of(row),
            )
        table = _whole(card, values, np.repeat(rows, width)).reshape(-1, width)
        block = _Block(card, table[:, 0], rows, table[:, 1:])
        self.kinds.setdefault(kind, card)
        self._elements.append(block)
        if "ELSET" in card.options:
            self._named("ELSET", card).parts.append(self._listed("ELSET", card, block.numbers))

    def _named(self, kind: str, card: Card) -> NameSet:
        """Set that a card names, which is made if it is new."""
        name = card.name(kind)
        known = self.sets[kind].setdefault(name.upper(), NameSet(name, card, True))
        if known.name != name and '"' in card.options[kind]:  # which may be another name
            card.refuse(f"name {name!r} differs from {known.name!r} in capitals alone: change one")
        known.internal &= "INTERNAL" in card.options
        if known.used is not None:
            card.refuse(
                f"set {name!r} is made larger after line {known.used} has used it: write that "
                "below, or give this a name of its own"
            )
        return known

    def _read_set(self, kind: str, card: Card) -> None:
        scope, known = self._scope_of(card), self._named(kind, card)
        before = len(known.parts)
        if kind == "NSET" and "ELSET" in card.options:
            of = scope._found("ELSET", card.name("ELSET"), card, card.line)
            known.parts.append(lambda: np.unique(self._nodes_of(of())))
            if card.body.strip():
                card.refuse("has members beside ELSET: write them in a card of their own")
        elif "GENERATE" in card.options:
            known.parts += [scope._range(kind, card, line, words) for line, words in card.rows()]
        elif card.is_numeric:
            numbers = card.numbers
            lines = np.repeat(np.arange(numbers.counts.size), numbers.counts)
            own = _whole(card, numbers.values, lines)
            known.parts += [scope._listed(kind, card, own)] if own.size else []
        else:
            for line, words in card.rows():
                for word in words:
                    known.parts.append(scope._member(kind, word, card, line))
        if len(known.parts) == before:
            card.refuse("has no members: take it out, or is the file cut?")

    def _range(self, kind: str, card: Card, line: int, words: list[str]) -> _Part:
        """Members that a line gives by first, last and, if it is not 1, increment."""
        if not (1 < len(words) < 4 and all(word.isdecimal() for word in words)):
            card.refuse("a line of GENERATE has first, last and increment, such as 5, 12, 1", line)
        first, last, step = (_single(word, card, line) for word in [*words, "1"][:3])
        if first > last or (last - first) % step:
            card.refuse(
                f"found {', '.join(words)}: first must be no larger than last, and the increment "
                "must lead from one to the other",
                line,
            )
        return lambda: self.numbering[kind].between(first, last, step)

    def _listed(self, kind: str, card: Card, numbers: IntArray, line: int | None = None) -> _Part:
        """Members with the numbers that a card lists, of which the line is known of single ones."""

        def members() -> IntArray:
            places = self.numbering[kind].places(numbers)
            if (places < 0).any():
                number = numbers[np.argmin(places)]
                of = f" of instance {self.name!r}" if self.name else ""
                card.refuse(
                    f"{_MEMBER[kind]} {number} is not in the file{of}: name only what is there",
                    line or _line_with(card, int(number)),
                )
            return places

        return members

    def _member(self, kind: str, word: str, card: Card, line: int) -> _Part:
        """What a word of a set's card stands for: a number or the name of a set."""
        word, scope, number = bare(word), self, bare(word)
        for name, other in self.others.items():
            rest = word[len(name) + 1 :]
            if word.upper().startswith(f"{name}.") and rest.isdecimal():
                scope, number = other, rest
        if number.isdecimal():
            return scope._listed(kind, card, np.array([_single(number, card, line)]), line)
        return self._found(kind, word, card, line)

    def _found(self, kind: str, word: str, card: Card, line: int) -> _Part:
        """Members of the set with a name, which may stand further below."""
        known = self._named_above(kind, word)
        if known is not None:
            known.used = known.used or line
            return known.members

        def members() -> IntArray:
            below = self._named_above(kind, word)
            if below is None:
                there = [each.name for each in self.sets[kind].values()]
                card.refuse(
                    f"found {bare(word)[:40]!r}, must be a number or a set of the file: "
                    f"{listed(there)}{closest(word.upper(), there)}",
                    line,
                )
            return below.members()

        return members

    def _named_above(self, kind: str, word: str) -> NameSet | None:
        """Set with a name, of this scope or, after a dot, of an instance, if it stands above."""
        name = bare(word).upper()
        known = self.sets[kind].get(name)
        for instance, scope in self.others.items():
            if known is None and name.startswith(f"{instance}."):
                known = scope.sets[kind].get(name[len(instance) + 1 :])
        return known

    def _scope_of(self, card: Card) -> Scope:
        """Scope whose numbers a card lists."""
        if "INSTANCE" not in card.options:
            return self
        name = card.name("INSTANCE")
        if name.upper() not in self.others:
            card.refuse(
                f"found instance {name!r}, must be one that stands above: "
                f"{listed([scope.name for scope in self.others.values()])}"
            )
        return self.others[name.upper()]

    def _read_surface(self, card: Card) -> None:
        name, kind = card.name("NAME"), card.options.get("TYPE", "ELEMENT").upper()
        if name.upper() in self.surfaces:
            other = self.surfaces[name.upper()].card
            card.refuse(f"surface {name!r} stands in line {other.line} already: give each its own")
        if kind not in ("ELEMENT", "NODE"):
            card.refuse(f"found TYPE={kind}, must be ELEMENT, faces of elements, or NODE")
        made = Surface(name, card, "INTERNAL" in card.options)
        self.surfaces[name.upper()] = made
        singles: dict[str, list[tuple[int, int]]] = {}  # numbers and lines by label
        for line, words in card.rows():
            if len(words) > 2 or not words[0]:
                card.refuse(
                    "a line of a surface has an element or a set and a face, such as PLATE, S1; "
                    "one of nodes has a node or a set",
                    line,
                )
            if kind == "NODE":
                made.nodes = made.nodes or NameSet(name, card)
                made.nodes.parts.append(self._member("NSET", words[0], card, line))
                continue
            label = words[1].upper() if len(words) > 1 else ""
            if words[0].isdecimal():
                singles.setdefault(label, []).append((_single(words[0], card, line), line))
            else:
                made.faces.append((label, self._member("ELSET", words[0], card, line), line))
        for label, own_lines in singles.items():
            numbers = np.array(own_lines, dtype=np.intp)
            part = self._listed("ELSET", card, numbers[:, 0])
            made.faces.append((label, part, int(numbers[0, 1])))
        if made.nodes is None and not made.faces:
            card.refuse("has no members: take it out, or is the file cut?")

    def placed(self, nodes: int, elements: int) -> None:
        """Number all nodes and elements, after so many of the scopes before."""
        for kind, blocks, offset in (
            ("NSET", self._nodes, nodes),
            ("ELSET", self._elements, elements),
        ):
            numbers = [block.numbers for block in blocks]
            every = np.concatenate(numbers) if numbers else np.zeros(0, dtype=np.intp)
            self.numbering[kind] = numbering = Numbering(every, offset)
            again, first = numbering.repeated()
            if kind == "NSET" and again.size:  # the same node may be written twice
                places = self.places
                again = again[(places[again] != places[first]).any(axis=1)]
            if again.size:
                block, row = _block_of(blocks, int(again.min()))
                block.card.refuse(
                    f"{_MEMBER[kind]} {block.numbers[row]} stands twice: number them anew",
                    block.card.line_of(int(block.rows[row])),
                )

    @property
    def places(self) -> FloatArray:
        """Positions of the nodes as they are written, shape (n, 3)."""
        return np.concatenate([np.zeros((0, 3)), *(block.values for block in self._nodes)])

    def nodes_of_elements(self, forms: Sequence[ElementForm]) -> tuple[IntArray, IntArray]:
        """Places of the nodes of all elements, shape (n, nodes), and the number of their form.

        The places of nodes that an element does not have are -1.
        """
        width = max(form.nodes for form in forms)
        found, form_of = [np.zeros((0, width), dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
        for block in self._elements:
            numbers = np.asarray(block.values, dtype=np.intp)
            places = self.numbering["NSET"].places(numbers)
            missing = (places < 0).any(axis=1)
            if missing.any():
                row = int(np.argmax(missing))
                number = numbers[row, np.argmin(places[row])]
                block.card.refuse(
                    f"node {number} of element {block.numbers[row]} is not in the file",
                    block.card.line_of(int(block.rows[row])),
                )
            more = ((0, 0), (0, width - places.shape[1]))
            found.append(np.pad(places, more, constant_values=-1))
            form = form_of_type(block.card.options["TYPE"].upper())
            form_of.append(np.full(len(places), forms.index(form)))
        nodes, form_of_each = np.concatenate(found), np.concatenate(form_of)
        if again := repeated(nodes, np.array([form.corners for form in forms])[form_of_each]):
            (block, row), (other, known) = (_block_of(self._elements, place) for place in again)
            block.card.refuse(
                f"element {block.numbers[row]} has the corners of element {other.numbers[known]}, "
                "which would count twice: take one of them out",
                block.card.line_of(int(block.rows[row])),
            )
        return nodes, form_of_each


def _whole(card: Card, values: FloatArray, rows: IntArray) -> IntArray:
    """Values as whole numbers from 1 on; ``rows`` are their lines of data."""
    wrong = ~((values >= 1) & (values < 2**31) & (values == np.floor(values)))
    if wrong.any():
        k = int(np.argmax(wrong))
        found = "an empty field" if np.isnan(values[k]) else f"{values[k]:.15g}"
        card.refuse(
            f"found {found}, must be a whole number from 1 to {2**31 - 1}", card.line_of(rows[k])
        )
    return values.astype(np.intp)


def _single(word: str, card: Card, line: int) -> int:
    """Number of a node or element that a word of digits gives."""
    if len(word) > 10 or not 0 < int(word) < 2**31:
        card.refuse(f"found {word[:40]}, must be a whole number from 1 to {2**31 - 1}", line)
    return int(word)


def _line_with(card: Card, number: int) -> int | None:
    """First line of a card's data that holds a number."""
    return next((line for line, words in card.rows() if str(number) in words), None)


def _block_of(blocks: list[_Block], place: int) -> tuple[_Block, int]:
    """Block that holds the node or element at a place, and its row in it."""
    for block in blocks:
        if place < block.numbers.size:
            return block, place
        place -= block.numbers.size
    raise IndexError(place)
