"""Rows of row, column and value: CalculiX's ``.sti`` and ``.mas``, and Abaqus in coordinates.

CalculiX writes one half, counted from 1, by ``*FREQUENCY, SOLVER=MATRIXSTORAGE`` (CalculiX
CrunchiX User's Manual 2.20, section "*FREQUENCY"), and the node and direction of each row into
``.dof``. Abaqus writes such rows by ``*MATRIX OUTPUT, FORMAT=COORDINATE`` (Abaqus Keywords Guide).
"""

from __future__ import annotations

import numpy as np

from skfem_joint.matrix_files.abaqus import without_penalties
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.numbers import INTEGER, REAL, number_rows
from skfem_joint.matrix_files.symmetry import from_entries

_FORM = "rows of row, column and value, as of CalculiX"


def read_triples(content: bytes, letter: str) -> GivenMatrix:
    """Matrix of rows of row, column and value; ValueError for any other content.

    Rows and columns count from 1, or from 0 if that occurs.
    """
    numbers, line_of = number_rows(content, (INTEGER, INTEGER, REAL), "row, column and value")
    places = numbers[:, :2].astype(np.intp)
    first = 1 if places.min(initial=1) > 0 else 0
    if places.min(initial=0) < 0:
        wrong = int(np.argmax(places.min(axis=1) < 0))
        raise ValueError(
            f"line {line_of(wrong)}: found row or column {places[wrong].min()}, must be >= 0: it "
            "is an unknown that the other program added; write the matrix with names of unknowns "
            "(FORMAT=MATRIX INPUT)"
        )
    places -= first
    n = int(places.max(initial=-1)) + 1
    present = np.unique(places)
    if present.size < n:
        missing = int(np.setdiff1d(np.arange(min(n, present.size + 1)), present)[0])
        raise ValueError(f"has no entry of row {missing + first}, must have some of each of {n}")

    def name_of(k: int) -> str:
        return f"row {k + first}"

    A = from_entries(places[:, 0], places[:, 1], numbers[:, 2], n, name_of, line_of)
    return without_penalties(GivenMatrix(A, _FORM), letter)
