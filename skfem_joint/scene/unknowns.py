"""Tables of a scene that give unknowns of matrices by number, or by node and direction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense
from skfem_joint.ground.errors import InputError, first_of, refuse
from skfem_joint.matrix_files.labels import LARGEST_NODE, RowsByName, place_of
from skfem_joint.system.system import vector_of
from skfem_joint.system.unknowns import dof_numbers

#: Columns of a contact whose unknowns have names: nodes of a pair, normal, area, and gap if given.
_COLUMNS = 7


class NumberedUnknowns:
    """Tables of a scene that give unknowns by their numbers.

    Parameters
    ----------
    n : int
        Number of unknowns.
    first : int
        Number of the first one.
    values : mapping
        What is given, by its key; InputError for names of unknowns in it.
    """

    def __init__(self, n: int, first: int, values: Mapping[str, Any]) -> None:
        self.n, self.first = n, first
        refuse(
            f"{where}: found {name!r}, but the files do not name their unknowns; give their "
            "numbers, or their names by matrices.unknowns"
            for where, value in values.items()
            for name in (value if isinstance(value, tuple) else (value,))
            if isinstance(name, str)
        )

    def pairs(self, where: str, rows: FloatArray) -> FloatArray:
        """Rows of a contact, whose numbers count from 0 then."""
        del where  # what is wrong with numbers the model says
        pairs = rows.copy()
        pairs[:, :6] -= self.first
        return pairs

    def weights(self, where: str, value: Any) -> FloatArray:
        """Weights of a point, (n,), from a number or from a vector."""
        if not isinstance(value, int):
            value = as_dense(value)
            value = value.ravel() if value.size == self.n else value
        return vector_of(value, self.n, where, self.first)

    def held(self, value: Any) -> IntArray:
        """Numbers of supported unknowns."""
        return dof_numbers(as_dense(value), self.n, "fixed", self.first)


class NamedUnknowns:
    """Tables of a scene that give unknowns by node and direction.

    Parameters
    ----------
    labels : ndarray of int, shape (n, 2)
        Node and direction of each unknown.
    first : int
        Number of the first one of the scene, which must be 0.
    """

    def __init__(self, labels: IntArray, first: int = 0) -> None:
        if first:
            raise InputError(
                "first: found 1, but the files name their unknowns by node and direction; leave it "
                "out"
            )
        self.n, self.places = len(labels), RowsByName(labels)

    def pairs(self, where: str, rows: FloatArray) -> FloatArray:
        """Rows of a contact with degrees of freedom, from its rows with nodes."""
        if rows.ndim != 2 or rows.shape[1] not in (_COLUMNS - 1, _COLUMNS):
            raise InputError(
                f"{where}: found shape {rows.shape}, must have {_COLUMNS - 1} columns, since "
                "the matrices name their unknowns: the first node, the second, empty for a rigid "
                "base, normal x, y, z, area; and one more where pairs have gaps"
            )
        nodes = rows[:, :2]
        absent = np.isnan(nodes) & (np.arange(2) == 1)
        whole = absent | (
            np.isfinite(nodes) & (nodes == np.floor(nodes)) & (np.abs(nodes) < LARGEST_NODE)
        )
        refuse(
            f"{where}: pair {k + 1}, found {nodes[k, 0]:g}, {nodes[k, 1]:g}, must be numbers of "
            "nodes"
            for k in np.flatnonzero(~whole.all(axis=1))[:1]
        )
        number = np.where(absent, 0, nodes).astype(np.intp)
        unknown = self.places.unknown_nodes(number[~absent])
        if unknown.size:
            names = first_of([str(node) for node in unknown.tolist()])
            raise InputError(
                f"{where}: the matrices have no unknown of node {names}; "
                "leave the second node of a pair empty where it is held, and the pair out where "
                "the first one is"
            )
        directions = np.broadcast_to(np.arange(1, 4), (len(rows), 2, 3))
        labels = np.stack([np.broadcast_to(number[..., np.newaxis], directions.shape), directions])
        dofs = self.places.find(np.moveaxis(labels, 0, -1)).astype(float)
        dofs[(dofs < 0.0) | absent[..., np.newaxis]] = np.nan
        return np.hstack([dofs.reshape(-1, 6), rows[:, 2:]])

    def weights(self, where: str, value: Any) -> FloatArray:
        """Weights of a point, (n,), from '12.x' or from rows of node, direction and weight."""
        if isinstance(value, str):
            place = place_of(value) or (0, None)
            if place[1] is None:
                raise InputError(f"{where}: found {value!r}, must have a direction, as '{value}.x'")
            rows = np.array([[*place, 1.0]])
        elif isinstance(value, int):
            raise InputError(
                f"{where}: found {value}, but the files name their unknowns: give node and "
                f"direction, as '{value}.x'"
            )
        else:
            rows = np.atleast_2d(as_dense(value))
        if rows.shape[1:] != (3,) or not np.isfinite(rows).all():
            raise InputError(
                f"{where}: found shape {rows.shape}, must be rows of node, direction (1 to 6) and "
                "weight"
            )
        weights = np.zeros(self.n)
        np.add.at(weights, self._unknowns(where, rows[:, :2]), rows[:, 2])
        return weights

    def held(self, value: Any) -> IntArray:
        """Numbers of supported unknowns, from nodes and from nodes with directions."""
        if not isinstance(value, tuple):
            rows = as_dense(value)
            rows = rows[:, np.newaxis] if rows.ndim == 1 else rows
            if rows.ndim != 2 or rows.shape[1] not in (1, 2) or not np.isfinite(rows).all():
                raise InputError(
                    f"fixed: found shape {rows.shape}, must be nodes, in a second column directions"
                )
            places = [(*row, None)[:2] for row in rows.tolist()]
        else:
            places = [place_of(x) or (0, None) if isinstance(x, str) else (x, None) for x in value]
        numbers = []
        for node, direction in places:
            if direction is not None:
                numbers.append(self._unknowns("fixed", np.array([[node, direction]], dtype=float)))
                continue
            own = self.places.of_node(int(node))
            if not own.size or node != int(node):
                raise InputError(f"fixed: the matrices have no unknown of node {node:g}")
            numbers.append(own)
        return np.concatenate([np.zeros(0, dtype=np.intp), *numbers])

    def _unknowns(self, where: str, places: FloatArray) -> IntArray:
        """Numbers of the unknowns of nodes and directions, (k,)."""
        whole = np.isfinite(places) & (places == np.floor(places)) & (np.abs(places) < LARGEST_NODE)
        found = self.places.find(np.where(whole, places, 0).astype(np.intp))
        found[~whole.all(axis=1) | (places[:, 1] < 0.0) | (places[:, 1] > 6.0)] = -1
        refuse(
            f"{where}: found node {places[k, 0]:g}, direction {places[k, 1]:g}, of which the "
            "matrices have no unknown; directions are 1 to 6, or x, y, z, rx, ry, rz"
            for k in np.flatnonzero(found < 0)[:1]
        )
        return found
