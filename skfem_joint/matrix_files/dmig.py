"""Nastran's DMIG entries, as in punch files (``.pch``) and bulk data.

A header names the matrix, its form (6: symmetric, by one half), type and number of columns; an
entry for each column has its point and component, and rows of point, component and value. Fields
have 8 characters, in entries with ``*`` 16, or stand between commas; a number may lack the E of its
exponent (MSC Nastran Quick Reference Guide, "DMIG"; the punch file of EXTSEOUT or PARAM,EXTOUT,
DMIGPCH). A component of 0 or none is that of a scalar point, which modes are given.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import DIRECTIONS, as_labels, keys_of, label_text
from skfem_joint.matrix_files.symmetry import from_entries

_FORM = "DMIG of Nastran"
#: Forms of matrices that are read.
_SQUARE, _SYMMETRIC = 1, 6
_REAL = re.compile(r"([+-]?(?:\d+\.\d*|\.\d+|\d+))(?:[EeDd]?([+-]\d{1,3})|[EeDd](\d{1,3}))?")


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
        if not content.endswith(b"\n"):
            raise ValueError("the last line does not end, so that the file may be cut")
        self._matrices: dict[str, _Matrix] = {}
        for number, cells, lines in _entries(content.decode("latin-1")):
            try:
                self._add(number, cells, lines)
            except ValueError as error:
                text = str(error)
                raise ValueError(
                    text if text.startswith("line ") else f"line {number}: {text}"
                ) from error
        if not self._matrices:
            raise ValueError("holds no DMIG entry")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the matrices, in capitals."""
        return tuple(self._matrices)

    def _add(self, number: int, cells: list[str], lines: list[int]) -> None:
        """Add an entry, whose cells after its word come with their lines."""
        name, point = cells[0].upper(), _whole(cells[1])
        if not re.fullmatch(r"[A-Z]\w{0,7}", name):
            raise ValueError(f"found {cells[0]!r}, must be the name of a matrix")
        if point == 0:
            if name in self._matrices:
                raise ValueError(f"found a second header of {name}, must be one")
            form, kind = _whole(cells[2]), _whole(cells[3])
            polar = _whole(cells[5]) if len(cells) > 5 else 0
            columns = _whole(cells[7]) if len(cells) > 7 else 0
            if kind not in (1, 2) or polar:
                raise ValueError(f"{name}: found type {kind}, must be real numbers (1 or 2)")
            if form not in (_SQUARE, _SYMMETRIC):
                raise ValueError(f"{name}: found form {form}, must be 1 (square) or 6 (symmetric)")
            self._matrices[name] = _Matrix(number, form, columns)
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
            line = lines[4 + k]
            if row[3] and _real(row[3], line) != 0.0:
                raise ValueError(f"line {line}: found an imaginary part, must be real")
            matrix.points.append((_whole(row[0]), _component(row[1]), *column))
            matrix.values.append(_real(row[2], line))
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
        keys, first, number = np.unique(keys_of(places), return_index=True, return_inverse=True)
        labels = places[first]
        row, column = number.reshape(-1, 2).T

        def name_of(k: int) -> str:
            return label_text(labels[k])

        values = np.array(matrix.values)
        line_of = matrix.lines.__getitem__
        halves = matrix.form == _SYMMETRIC
        A = from_entries(row, column, values, keys.size, name_of, line_of, halves)
        notes: tuple[str, ...] = ()
        if matrix.columns not in (0, keys.size):
            notes = (
                f"{name} has {keys.size} unknowns with entries, and its header says "
                f"{matrix.columns}: the others are zero, or the file is cut.",
            )
        return GivenMatrix(A, _FORM, labels, notes=notes)


def is_dmig(content: bytes) -> bool:
    """Whether a text has DMIG entries."""
    return re.search(rb"^DMIG[ *,]", content, re.MULTILINE | re.IGNORECASE) is not None


def _entries(text: str) -> Iterator[tuple[int, list[str], list[int]]]:
    """Line, cells after the word, and their lines, of each DMIG entry with its continuations."""
    cells: list[str] = []
    lines: list[int] = []
    begin, inside = 0, False
    for number, raw in enumerate(text.split("\n"), start=1):
        line = raw.rstrip()
        if not line or line.startswith("$"):
            continue
        word = re.split(r"[\s,]", line[:8], maxsplit=1)[0].upper()
        continued = word[:1] in ("", "+", "*")
        if not continued:
            if inside:
                yield begin, cells, lines
            inside = word in ("DMIG", "DMIG*")
            begin, cells, lines = number, [], []
        if not inside:
            continue
        own = _cells(line, number)
        cells += own
        lines += [number] * len(own)
    if inside:
        yield begin, cells, lines


def _cells(line: str, number: int) -> list[str]:
    """Cells of a line after its word: eight of 8 characters, or four of 16."""
    wide = "*" in line[:8].partition(",")[0]
    count = 4 if wide else 8
    if not re.fullmatch(r"[ -#%-~]*", line):  # no tabs, no comments behind
        raise ValueError(
            f"line {number}: found {line[:60]!r}, must be fields of 8 or 16 characters, or commas"
        )
    if "," in line:
        cells = [cell.strip() for cell in line.split(",")][1:]
        rest = " ".join(cells[count:])
    else:
        width = 16 if wide else 8
        cells = [line[8 + width * k : 8 + width * (k + 1)].strip() for k in range(count)]
        rest = line[72:].strip()
    head = line[:8].partition(",")[0].strip()
    if not re.fullmatch(r"DMIG\*?|[+*]?\w{0,7}", head, re.IGNORECASE) or not any(cells):
        raise ValueError(f"line {number}: found {line[:60]!r}, must be fields of a DMIG entry")
    if not re.fullmatch(r"(?:[+*]\w{0,7})?", rest):
        raise ValueError(f"line {number}: found {rest[:40]!r} after the last field")
    cells = cells[:count]
    for cell in cells:
        if re.search(r"\s", cell):
            raise ValueError(f"line {number}: found {cell!r} in a field, must be one number")
    return [*cells, *[""] * (count - len(cells))]


def _whole(cell: str) -> int:
    if not cell:
        return 0
    if not re.fullmatch(r"\d{1,9}", cell):
        raise ValueError(f"found {cell!r}, must be a whole number")
    return int(cell)


def _component(cell: str) -> int:
    number = _whole(cell)
    if number >= len(DIRECTIONS):
        raise ValueError(f"found component {number}, must be 1 to 6, or 0 for a scalar point")
    return number


def _real(cell: str, line: int) -> float:
    found = _REAL.fullmatch(cell)
    if found is None:
        raise ValueError(f"line {line}: found {cell!r}, must be a number")
    return float(f"{found[1]}e{found[2] or found[3] or 0}")
