"""Nastran's DMIG entries, as in punch files (``.pch``) and bulk data.

A header names the matrix, its form (6: symmetric, by one half), type and number of columns; an
entry for each column has its point and component, and rows of point, component and value (MSC
Nastran Quick Reference Guide, "DMIG"; the punch file of EXTSEOUT or PARAM,EXTOUT,DMIGPCH). A
component of 0 or none is that of a scalar point, which modes are given.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from skfem_joint.matrix_files.bulk_data import Entry, entries, real, whole
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import DIRECTIONS, as_labels
from skfem_joint.matrix_files.symmetry import from_named_entries

_FORM = "DMIG of Nastran"
#: Forms of matrices that are read.
_SQUARE, _SYMMETRIC = 1, 6


@dataclass
class _Matrix:
    """Entries of a matrix as they are read."""

    line: int
    form: int
    columns: int
    points: list[tuple[int, int, int, int]] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    seen: set[tuple[int, int]] = field(default_factory=set)


class DmigFile:
    """A file with DMIG entries: its names, and the matrix of a name.

    Other entries of the bulk data are passed over: points, sets, coordinates.

    Raises
    ------
    ValueError
        For what is no such file, with the line.
    """

    def __init__(self, content: bytes) -> None:
        self._matrices: dict[str, _Matrix] = {}
        for entry in entries(content.decode("latin-1"), lambda word, _: word == "DMIG"):
            try:
                self._add(entry)
            except ValueError as error:
                text = str(error)
                raise ValueError(
                    text if text.startswith("line ") else f"line {entry.line}: {text}"
                ) from error
        if not self._matrices:
            raise ValueError("holds no DMIG entry")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the matrices, in capitals."""
        return tuple(self._matrices)

    def _add(self, entry: Entry) -> None:
        """Add a header or a column."""
        cells = entry.cells
        name, point = cells[0].upper(), whole(cells[1])
        if not re.fullmatch(r"[A-Z]\w{0,7}", name):
            raise ValueError(f"found {cells[0]!r}, must be the name of a matrix")
        if point == 0:
            if name in self._matrices:
                raise ValueError(f"found a second header of {name}, must be one")
            form, kind = whole(cells[2]), whole(cells[3])
            polar = whole(cells[5]) if len(cells) > 5 else 0
            columns = whole(cells[7]) if len(cells) > 7 else 0
            if kind not in (1, 2) or polar:
                raise ValueError(f"{name}: found type {kind}, must be real numbers (1 or 2)")
            if form not in (_SQUARE, _SYMMETRIC):
                raise ValueError(f"{name}: found form {form}, must be 1 (square) or 6 (symmetric)")
            self._matrices[name] = _Matrix(entry.line, form, columns)
            return
        matrix = self._matrices.get(name)
        if matrix is None:
            raise ValueError(f"found a column of {name} before its header, DMIG {name} 0 ...")
        column = point, _component(cells[2])
        if column in matrix.seen:
            raise ValueError(f"found a second entry of column {column[0]}, {column[1]} of {name}")
        matrix.seen.add(column)
        rows = cells[4:]
        if len(rows) < 3:
            raise ValueError(f"found a column of {name} without a row")
        for k in range(0, len(rows), 4):
            row = [*rows[k : k + 4], "", "", ""][:4]
            if not any(row):
                continue
            line = entry.lines[4 + k]
            if row[3] and real(row[3], line) != 0.0:
                raise ValueError(f"line {line}: found an imaginary part, must be real")
            matrix.points.append((whole(row[0]), _component(row[1]), *column))
            matrix.values.append(real(row[2], line))
            matrix.lines.append(line)

    def matrix(self, name: str) -> GivenMatrix:
        """Symmetric matrix of a name; ValueError if it is none."""
        matrix = self._matrices[name]
        places = as_labels((p, c) for a, b, p2, c2 in matrix.points for p, c in ((a, b), (p2, c2)))
        if not len(places):
            raise ValueError(f"line {matrix.line}: {name} has a header, and no columns")
        if places[:, 0].min() < 1:
            raise ValueError(f"{name}: found point {places[:, 0].min()}, must be > 0")
        scalar = np.intersect1d(places[places[:, 1] == 0, 0], places[places[:, 1] > 0, 0])
        if scalar.size:
            raise ValueError(
                f"{name}: found point {scalar[0]} with components and without, must be either"
            )
        values, line_of = np.array(matrix.values), matrix.lines.__getitem__
        A, labels = from_named_entries(places, values, line_of, matrix.form == _SYMMETRIC)
        notes: tuple[str, ...] = ()
        if matrix.columns not in (0, len(labels)):
            notes = (
                f"{name} has {len(labels)} unknowns with entries, and its header says "
                f"{matrix.columns}: the others are zero, or the file is cut.",
            )
        return GivenMatrix(A, _FORM, labels, notes=notes)


def is_dmig(content: bytes) -> bool:
    """Whether a text has DMIG entries."""
    return re.search(rb"^DMIG[ *,]", content, re.MULTILINE | re.IGNORECASE) is not None


def _component(cell: str) -> int:
    number = whole(cell)
    if number >= len(DIRECTIONS):
        raise ValueError(f"found component {number}, must be 1 to 6, or 0 for a scalar point")
    return number
