"""Sides of the elements of a file: those that a set of nodes makes up, and those that are free."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, IntArray
from skfem_joint.mesh.cells import corner_count, distinct, same_columns
from skfem_joint.mesh.decks.elements import ElementForm

#: Why a set of nodes has no sides.
OF_NO_ELEMENT = "with nodes of no element"
OF_A_BODY = "with all nodes of an element, a part of a body: name its elements or its surface"
OF_NO_SIDES = "whose nodes do not make up whole sides of elements"


class Sides:
    """Sides of elements of one form, or of several that go together.

    Corners of sides come as many for all: the last corner of a triangle stands twice where others
    are quadrilaterals.

    Parameters
    ----------
    forms : sequence of ElementForm
    form_of : ndarray of int, shape (n_elements,)
        Number of each element's form among them.
    elements : ndarray of int, shape (n_elements, nodes)
        Nodes of the elements; -1 behind those of forms with fewer.
    n_nodes : int
        Number of nodes, used or not.
    """

    def __init__(
        self, forms: Sequence[ElementForm], form_of: IntArray, elements: IntArray, n_nodes: int
    ) -> None:
        self.forms, self.form_of, self.elements, self.n_nodes = forms, form_of, elements, n_nodes
        self.dim = forms[0].dim
        every = [side for form in forms for side in form.sides.values()]
        self._corners = max(map(len, every))

    @cached_property
    def used(self) -> BoolArray:
        """Whether each node belongs to an element."""
        used = np.zeros(self.n_nodes, dtype=np.bool_)
        used[self.elements[self.elements >= 0]] = True
        return used

    @cached_property
    def _at_nodes(self) -> sparse.csc_array:
        """Which elements each node belongs to."""
        has = self.elements >= 0
        ends = np.concatenate([[0], np.cumsum(has.sum(axis=1))])
        entries = np.ones(ends[-1], dtype=np.bool_), self.elements[has], ends
        table = sparse.csr_array(entries, shape=(len(self.elements), self.n_nodes))
        return sparse.csc_array(table.tocsc())

    def _by_form(self, elements: IntArray) -> Iterator[tuple[ElementForm, IntArray]]:
        """Forms that some elements have, with these elements."""
        for number, form in enumerate(self.forms):
            own = elements[self.form_of[elements] == number]
            if own.size:
                yield form, own

    def labels(self, elements: IntArray) -> list[str]:
        """Labels of sides that each of some elements has."""
        tables = [form.sides for form, _ in self._by_form(elements)]
        return [label for label in tables[0] if all(label in table for table in tables)]

    def numbered(self, elements: IntArray, label: str) -> IntArray:
        """Corners (n, corners) of the sides with a label."""
        parts = [
            self.elements[own][:, _filled(form.sides[label], self._corners)]
            for form, own in self._by_form(elements)
        ]
        return np.concatenate(parts) if parts else np.zeros((0, self._corners), dtype=np.intp)

    def group(self, nodes: IntArray) -> tuple[str, IntArray | str]:
        """What a named set of nodes becomes, "sides" or "nodes", and its members.

        Several nodes of a plate or solid are sides, if they make up some. Members are corners
        (n, corners) or nodes (n,), or the reason why there are none.
        """
        if self.dim > 1 and nodes.size > 1:
            return "sides", self.of_nodes(nodes)
        return "nodes", nodes if self.used[nodes].all() else OF_NO_ELEMENT

    def of_nodes(self, nodes: IntArray) -> IntArray | str:
        """Corners (n, corners) of the sides that a set of nodes makes up, or why there are none.

        All nodes of the sides are in the set, and all nodes of the set are on them. Outer sides
        are preferred to those between two elements.
        """
        if not self.used[nodes].all():
            return OF_NO_ELEMENT
        among = np.zeros(self.n_nodes, dtype=np.bool_)
        among[nodes] = True
        beside = np.zeros(len(self.elements), dtype=np.bool_)
        beside[self._at_nodes[:, nodes].indices] = True
        parts = []
        for form, near in self._by_form(np.flatnonzero(beside)):
            inside = among[self.elements[near][:, : form.nodes]]
            if inside.all(axis=1).any():
                return OF_A_BODY
            for label, own in form.nodes_of_sides.items():
                ends = form.sides[label]
                # Nodes between the corners follow them; all sides have as many of both.
                columns = _filled(ends, self._corners)
                columns += _filled([*own[len(ends) :], ends[-1]], self._corners + 1)
                parts.append(self.elements[near[inside[:, own].all(axis=1)]][:, columns])
        sides = np.concatenate(parts)
        if not sides.size:
            return OF_NO_SIDES
        corners = sides[:, : self._corners]
        first, set_of = same_columns(distinct(corners.T))
        outer = first[np.bincount(set_of) == 1]
        for chosen in (outer, first):
            if np.unique(sides[chosen]).size == nodes.size:
                return np.asarray(corners[chosen])
        return OF_NO_SIDES

    def free(self, elements: IntArray) -> IntArray:
        """Corners (n, corners) of the sides of some elements that no other of them has."""
        corners = np.concatenate(
            [
                self.numbered(own, label)
                for form, own in self._by_form(elements)
                for label in form.sides
            ]
        )
        first, set_of = same_columns(distinct(corners.T))
        return np.asarray(corners[np.sort(first[np.bincount(set_of) == 1])])

    def are_free(self, corners: IntArray) -> bool:
        """Whether each side, given by its corners (n, corners), belongs to one element alone."""
        at = self._at_nodes
        beside = at[:, corners[:, 0]]
        for column in corners.T[1:]:
            beside = beside.multiply(at[:, column])
        return bool((beside.sum(axis=0) == 1).all())


def blocks_of(corners: IntArray) -> list[tuple[str, IntArray]]:
    """Sides (n, corners) of each number of corners, with the name that meshio has for them.

    The last corner of a triangle stands twice beside quadrilaterals.
    """
    count = corner_count(corners.T)
    names = ("", "vertex", "line", "triangle", "quad")
    return [(names[k], corners[count == k, :k]) for k in np.unique(count).tolist()]


def _filled(values: Sequence[int], count: int) -> list[int]:
    """Values, of which the last is repeated until they are so many."""
    return [*values, *[values[-1]] * (count - len(values))]
