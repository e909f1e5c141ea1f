"""Nodes and directions by which other programs name the unknowns of their matrices."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from skfem_joint.ground.arrays import BoolArray, IntArray, Numbering
from skfem_joint.ground.errors import InputError, first_of
from skfem_joint.ground.files import LARGEST, read_text

#: Names of the directions 1 to 6; 0 is that of an unknown without direction, such as of a mode.
DIRECTIONS = ("", "x", "y", "z", "rx", "ry", "rz")
#: Largest number of a node in size, so that a node and a direction fit into one whole number.
LARGEST_NODE = 10**12
_PLACE = re.compile(r"(-?\d{1,12})(?:\.(\d|r?[xyz]))?")
_NAMED_ROW = re.compile(r"\s*(-?\d{1,12})\s*[.,;\s]\s*(\d|r?[xyz])\s*", re.IGNORECASE)


def label_text(label: IntArray) -> str:
    """Node and direction of an unknown in a message, such as '12.x'."""
    node, direction = label.tolist()
    return f"{node}.{DIRECTIONS[direction]}" if direction else f"{node} (no direction)"


def place_of(text: str) -> tuple[int, int | None] | None:
    """Node and direction from '12.x' or '12.1', from '12' the node alone; None if it is neither."""
    found = _PLACE.fullmatch(text)
    if found is None:
        return None
    node, direction = found.groups()
    if direction is None:
        return int(node), None
    number = direction_of(direction)
    return None if number is None else (int(node), number)


def direction_of(text: str) -> int | None:
    """Number of a direction that is given by name or number; None if there is no such direction."""
    if text.isdigit():
        return int(text) if int(text) < len(DIRECTIONS) else None
    return DIRECTIONS.index(text.lower())


def keys_of(labels: IntArray) -> IntArray:
    """One whole number for each node and direction, (n,), in their order."""
    return np.asarray(labels[..., 0] * 8 + labels[..., 1])


def is_scalar(labels: IntArray) -> BoolArray:
    """Whether unknowns belong to no node of a mesh: modes, scalar points, internal nodes."""
    return np.asarray((labels[:, 1] == 0) | (labels[:, 0] <= 0))


class RowsByName:
    """Search for the numbers of unknowns by node and direction.

    Parameters
    ----------
    labels : ndarray of int, shape (n, 2)
        Node and direction of each unknown.
    """

    def __init__(self, labels: IntArray) -> None:
        self._numbering = Numbering(keys_of(labels))
        self._nodes = np.unique(labels[:, 0])

    def find(self, labels: IntArray) -> IntArray:
        """Numbers of the unknowns of nodes and directions (..., 2), counted from 0; -1 for none."""
        return self._numbering.places(keys_of(labels))

    def of_node(self, node: int) -> IntArray:
        """Numbers of all unknowns of a node."""
        return self._numbering.between(8 * node, 8 * node + 7)

    def unknown_nodes(self, nodes: IntArray) -> IntArray:
        """Those of some nodes that have no unknown."""
        return np.setdiff1d(nodes, self._nodes)


def repeated_labels(labels: IntArray) -> str:
    """Sentence about nodes and directions that stand for several unknowns; empty if none do."""
    keys, counts = np.unique(keys_of(labels), return_counts=True)
    if counts.max(initial=1) == 1:
        return ""
    twice = labels[np.isin(keys_of(labels), keys[counts > 1])]
    names = list(dict.fromkeys(label_text(label) for label in twice))
    return f"found {first_of(names)} more than once, must name each unknown once"


def read_labels(path: Path) -> IntArray:
    """Node and direction of each unknown, (n, 2), from a file with one of them in a line.

    That is CalculiX's file ``.dof`` (``12.1``), and any table of two columns; directions are 1 to
    6 or x to rz, or 0 for an unknown without direction.

    Raises
    ------
    InputError
        If the file cannot be read, for lines that are neither, and for unknowns that repeat.
    """
    labels, problem = [], ""
    text = read_text(path, LARGEST)
    if text and not text.endswith(("\n", "\r")):
        raise InputError(f"{path}: the last line does not end, so that the file may be cut")
    for number, line in enumerate(text.splitlines(), start=1):
        found = _NAMED_ROW.fullmatch(line)
        direction = direction_of(found[2]) if found else None
        if found is None or direction is None:
            problem = (
                f"line {number}: found {line.strip()[:40]!r}, must be a node and a direction, as "
                "'12.1' or '12, x'; directions are 1 to 6, or x, y, z, rx, ry, rz"
            )
            break
        labels.append((int(found[1]), direction))
    array = as_labels(labels)
    if problem := problem or repeated_labels(array):
        raise InputError(f"{path}: {problem}")
    return array


def as_labels(labels: Iterable[tuple[int, int]]) -> IntArray:
    """Array (n, 2) of nodes and directions, also of none."""
    return np.array([*labels], dtype=np.intp).reshape(-1, 2)
