"""Sides of the elements of a file: those that a set of nodes makes up, and those that are free."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, IntArray
from skfem_joint.mesh.cells import same_columns
from skfem_joint.mesh.inp_elements import ElementForm

#: Why a set of nodes has no sides.
OF_NO_ELEMENT = "with nodes of no element"
OF_A_BODY = "with all nodes of an element, a part of a body: name its elements or its surface"
OF_NO_SIDES = "whose nodes do not make up whole sides of elements"


class Sides:
    """Sides of elements of one form.

    Parameters
    ----------
    form : ElementForm
    elements : ndarray of int, shape (n_elements, nodes)
        Nodes of the elements.
    n_nodes : int
        Number of nodes, used or not.
    """

    def __init__(self, form: ElementForm, elements: IntArray, n_nodes: int) -> None:
        self.form, self.elements, self.n_nodes = form, elements, n_nodes

    @cached_property
    def used(self) -> BoolArray:
        """Whether each node belongs to an element."""
        used = np.zeros(self.n_nodes, dtype=np.bool_)
        used[self.elements] = True
        return used

    @cached_property
    def _at_nodes(self) -> sparse.csc_array:
        """Which elements each node belongs to."""
        ends = np.arange(len(self.elements) + 1) * self.form.nodes
        entries = np.ones(self.elements.size, dtype=np.bool_), self.elements.ravel(), ends
        table = sparse.csr_array(entries, shape=(len(self.elements), self.n_nodes))
        return sparse.csc_array(table.tocsc())

    def numbered(self, elements: IntArray, label: str) -> IntArray:
        """Corners (n, corners) of the sides with a label."""
        return self.elements[elements][:, self.form.sides[label]]

    def group(self, nodes: IntArray) -> tuple[str, IntArray | str]:
        """What a named set of nodes becomes, "sides" or "nodes", and its members.

        Several nodes of a plate or solid are sides, if they make up some. Members are corners
        (n, corners) or nodes (n,), or the reason why there are none.
        """
        if self.form.dim > 1 and nodes.size > 1:
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
        near = np.flatnonzero(beside)
        inside = among[self.elements[near]]
        if inside.all(axis=1).any():
            return OF_A_BODY
        parts = [
            self.elements[near[inside[:, own].all(axis=1)]][:, own]
            for own in self.form.nodes_of_sides.values()
        ]
        sides = np.concatenate(parts)
        if not sides.size:
            return OF_NO_SIDES
        corners = sides[:, : self._corners]
        first, set_of = same_columns(np.sort(corners, axis=1).T)
        outer = first[np.bincount(set_of) == 1]
        for chosen in (outer, first):
            if np.unique(sides[chosen]).size == nodes.size:
                return np.asarray(corners[chosen])
        return OF_NO_SIDES

    def free(self, elements: IntArray) -> IntArray:
        """Corners (n, corners) of the sides of some elements that no other of them has."""
        corners = np.concatenate([self.numbered(elements, label) for label in self.form.sides])
        first, set_of = same_columns(np.sort(corners, axis=1).T)
        return np.asarray(corners[np.sort(first[np.bincount(set_of) == 1])])

    def are_free(self, corners: IntArray) -> bool:
        """Whether each side, given by its corners (n, corners), belongs to one element alone."""
        at = self._at_nodes
        beside = at[:, corners[:, 0]]
        for column in corners.T[1:]:
            beside = beside.multiply(at[:, column])
        return bool((beside.sum(axis=0) == 1).all())

    @property
    def _corners(self) -> int:
        return len(next(iter(self.form.sides.values())))
