"""Matrices in texts of Abaqus: ``*MATRIX GENERATE`` and substructures.

``*MATRIX OUTPUT`` writes, as ``*MATRIX INPUT`` reads, a line for each entry with the row's node and
degree of freedom, the column's, and the value; the matrix stands there whole or by one half (Abaqus
Keywords Guide, "*MATRIX INPUT"). Boundary conditions appear in K as 1e36 on the diagonal.

``*SUBSTRUCTURE MATRIX OUTPUT, OUTPUT FILE=USER DEFINED`` writes the cards of a linear user element:
the nodes in comments, the degrees of freedom from each node on, and the lower half of each matrix
row by row, four numbers in a line (Abaqus Keywords Guide, "*SUBSTRUCTURE MATRIX OUTPUT", "*USER
ELEMENT" and "*MATRIX"). CalculiX writes the same cards.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import IntArray
from skfem_joint.ground.errors import first_of
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import (
    DIRECTIONS,
    as_labels,
    label_text,
    repeated_labels,
)
from skfem_joint.matrix_files.numbers import INTEGER, REAL, number_rows, real_numbers, shown
from skfem_joint.matrix_files.symmetry import from_named_entries, symmetric

#: Stiffness on the diagonal from which on a degree of freedom is a boundary condition.
PENALTY = 0.999e36
#: Types of *MATRIX by the letters of matrices.
TYPES = {"K": "STIFFNESS", "M": "MASS", "C": "VISCOUS DAMPING"}


def read_named_rows(content: bytes, letter: str) -> GivenMatrix:
    """Matrix in lines of node, direction, node, direction, value; ValueError for other content."""
    numbers, line_of = number_rows(
        content,
        (INTEGER, INTEGER, INTEGER, INTEGER, REAL),
        "row node, row direction, column node, column direction, value",
    )
    places = numbers[:, :4].astype(np.intp).reshape(-1, 2)
    wrong = (places[:, 1] < 0) | (places[:, 1] >= len(DIRECTIONS))
    if wrong.any():
        at = int(np.argmax(wrong))
        raise ValueError(
            f"line {line_of(at // 2)}: found degree of freedom {places[at, 1]} of node "
            f"{places[at, 0]}, must be 1 to 6: displacements and rotations"
        )
    A, labels = from_named_entries(places, numbers[:, 4], line_of)
    form = "the text of Abaqus (*MATRIX OUTPUT)"
    return without_penalties(GivenMatrix(A, form, labels), letter)


def without_penalties(given: GivenMatrix, letter: str) -> GivenMatrix:
    """Stiffness without the stand-in for boundary conditions, whose unknowns are held instead."""
    if letter != "K":
        return given
    diagonal = given.matrix.diagonal()
    held = np.flatnonzero(diagonal >= PENALTY)
    if not held.size:
        return given
    kept = np.ones(diagonal.size)
    kept[held] = 0.0
    usual = float((kept * diagonal).max(initial=0.0)) or 1.0
    selected = sparse.diags_array(kept)
    A = selected @ given.matrix @ selected + sparse.diags_array((1.0 - kept) * usual)
    names = [
        str(k + 1) if given.labels is None else label_text(given.labels[k]) for k in held.tolist()
    ]
    note = (
        f"{held.size} unknowns have 1e36 on the diagonal of K, Abaqus's stand-in for boundary "
        f"conditions; they are held: {first_of(names)}."
    )
    return replace(given, matrix=sparse.csr_array(A), held=held, notes=(*given.notes, note))


# Substructures


def read_substructure(content: bytes, letter: str) -> GivenMatrix:
    """Matrix of a letter in the cards of a linear user element; ValueError for other content."""
    lines = content.split(b"\n")
    cards = [k for k, line in enumerate(lines) if re.match(rb"[ \t]*\*[^*]", line)]
    named = [(k, *_card(lines[k])) for k in cards]
    elements = [(k, parameters) for k, name, parameters in named if name == "USER ELEMENT"]
    if len(elements) != 1:
        raise ValueError(
            f"found {len(elements)} cards *USER ELEMENT, must be one: that of a substructure, not "
            "of single elements"
        )
    for k, name, _ in named:
        if name not in ("USER ELEMENT", "MATRIX"):
            raise ValueError(f"line {k + 1}: found *{name}, must be *USER ELEMENT or *MATRIX")
    begin, parameters = elements[0]
    if "UNSYMM" in parameters:
        raise ValueError(f"line {begin + 1}: found UNSYMM, must be a symmetric matrix")
    ends = {k: after for k, after in zip(cards, [*cards[1:], len(lines)], strict=True)}
    labels = _unknowns_of(lines, begin, ends[begin], parameters.get("NODES", ""))
    kinds = {parameters.get("TYPE", ""): k for k, name, parameters in named if name == "MATRIX"}
    wanted = TYPES[letter]
    if wanted not in kinds:
        found = ", ".join(kinds) or "none"
        raise ValueError(
            f"has no *MATRIX, TYPE={wanted}; it has {found}. Ask the other program for it, as by "
            f"{wanted.split()[0]}=YES in *SUBSTRUCTURE MATRIX OUTPUT"
        )
    if sum(name == "MATRIX" for _, name, _ in named) > len(kinds):
        raise ValueError("found two *MATRIX of one TYPE, must be one")
    k = kinds[wanted]
    A = _lower_rows(lines, k + 1, ends[k], len(labels))
    form = "a substructure of Abaqus (*USER ELEMENT)"
    return GivenMatrix(symmetric(A, lambda i: label_text(labels[i])), form, labels)


def _card(line: bytes) -> tuple[str, dict[str, str]]:
    """Name and parameters of a card, in capitals."""
    name, *rest = (part.strip().upper() for part in line.decode("latin-1").split(","))
    pairs = (part.partition("=") for part in rest if part)
    return name.lstrip("*").strip(), {key.strip(): value.strip() for key, _, value in pairs}


def _unknowns_of(lines: list[bytes], begin: int, end: int, count: str) -> IntArray:
    """Nodes and directions of the unknowns of a user element, whose cards begin at a line."""
    listing = begin + 1
    nodes: list[int] = []
    while listing < end and lines[listing].lstrip().startswith(b"**"):
        text = lines[listing].strip().lstrip(b"*").strip().rstrip(b",")
        if text and re.fullmatch(rb"-?\d+(?:\s*,\s*-?\d+)*", text):
            nodes += [int(cell) for cell in text.split(b",")]
        listing += 1
    if not count.isdigit() or not 0 < int(count) <= 10**6:
        raise ValueError(f"line {begin + 1}: found NODES={count[:20]}, must be their number")
    if len(nodes) > int(count):
        raise ValueError(
            f"line {begin + 1}: found NODES={count}, but {len(nodes)} nodes are listed"
        )
    # What is not listed has no node of the mesh: the generalised unknowns of retained modes.
    nodes += [-k for k in range(1, int(count) - len(nodes) + 1)]
    changes = [*_changes(lines, listing, end, int(count))]
    labels: list[tuple[int, int]] = []
    for (position, directions), (after, _) in zip(
        changes, [*changes[1:], (int(count) + 1, ())], strict=True
    ):
        if after <= position:
            raise ValueError(f"line {begin + 1}: positions of nodes must rise, found {after}")
        for node in nodes[position - 1 : after - 1]:
            labels += [(node, direction) for direction in directions]
    array = as_labels(labels)
    scalar = array[:, 0] <= 0
    if np.any(array[~scalar, 1] >= len(DIRECTIONS)):
        worst = int(array[~scalar, 1].max())
        raise ValueError(
            f"line {listing + 1}: found degree of freedom {worst}, must be 1 to 6: displacements "
            "and rotations"
        )
    # Unknowns without a node are numbered on, whatever degrees of freedom they are called.
    array[scalar] = np.stack([-1 - np.arange(scalar.sum()), np.zeros(scalar.sum(), int)], axis=1)
    if problem := repeated_labels(array):
        raise ValueError(f"line {begin + 1}: {problem}")
    return array


def _changes(
    lines: list[bytes], begin: int, end: int, count: int
) -> Iterator[tuple[int, Sequence[int]]]:
    """Position of a node, from 1, and the degrees of freedom from there on."""
    first = True
    for number in range(begin, end):
        text = lines[number].strip().rstrip(b",")
        if not text or text.startswith(b"**"):
            continue
        if not re.fullmatch(rb"\d{1,7}(?:\s*,\s*\d{1,7})*", text):
            raise ValueError(
                f"line {number + 1}: found {shown(lines[number])}, must be degrees of freedom"
            )
        cells = [int(cell) for cell in text.split(b",")]
        position, directions = (1, cells) if first else (cells[0], cells[1:])
        if not 1 <= position <= count or not directions or min(directions) < 1:
            raise ValueError(
                f"line {number + 1}: found {shown(lines[number])}, must be the position of a node, "
                f"1 to {count}, and its degrees of freedom"
            )
        yield position, directions
        first = False
    if first:
        raise ValueError(f"line {begin + 1}: found no degrees of freedom of the nodes")


def _lower_rows(lines: list[bytes], begin: int, end: int, n: int) -> sparse.csr_array:
    """Lower half of a matrix from its rows, each of which begins in a line of its own."""
    counts = []
    cell = re.compile(rb"[ \t]*(?:" + REAL + rb"[ \t]*(?:,[ \t]*|(?=\r?$)|[ \t]))*\r?")
    for number in range(begin, end):
        line = lines[number]
        if not line.strip() or line.lstrip().startswith(b"**"):
            continue
        if not cell.fullmatch(line):
            raise ValueError(f"line {number + 1}: found {shown(line)}, must be numbers")
        counts.append((number, len(re.findall(REAL, line))))
    total = sum(count for _, count in counts)
    if total != n * (n + 1) // 2:
        raise ValueError(
            f"line {begin}: found {total} numbers, must be {n * (n + 1) // 2}: the lower half of a "
            f"matrix of {n} unknowns"
        )
    left, row = 0, 0
    for number, count in counts:
        if left == 0:
            row, left = row + 1, row + 1
        left -= count
        if left < 0:
            raise ValueError(
                f"line {number + 1}: found {-left} numbers too many for row {row}, which has {row}"
            )
    text = b"\n".join(lines[number] for number, _ in counts)
    values = real_numbers(text)
    if not np.isfinite(values).all():
        raise ValueError(f"line {begin}: found a number too large, must be finite")
    dense = np.zeros((n, n))
    dense[np.tril_indices(n)] = values
    return sparse.csr_array(dense)
