"""Tables of two columns in text files: force over time, density over frequency."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.files import read_text
from skfem_joint.ground.loads import Table
from skfem_joint.ground.text_tables import Mistakes, number_in, read_rows


def read_table(path: str | Path) -> Table:
    """Table from a UTF-8 text file with two columns: time (s) and force (N), see `read_pairs`."""
    return Table(*read_pairs(path, ("time", "s"), ("force", "N")))


def head_of(path: str | Path) -> str:
    """Names of the columns of a table of text; empty if it begins with numbers."""
    lines = (line.partition("#")[0].strip() for line in read_text(Path(path)).splitlines())
    first = next(filter(None, lines), "")
    return first if number_in(re.split(r"[,;\t]", first)[0]) is None else ""


def read_pairs(
    path: str | Path, first: tuple[str, str], second: tuple[str, str]
) -> tuple[FloatArray, FloatArray]:
    """Two columns of a UTF-8 text file, of which the first one rises.

    They are separated by a comma, a semicolon or a tab. Lines of two words before the first number
    are a header. Empty lines and comments after ``#`` are left out. Numbers are at most 1e20 in
    size, so that slopes and energies do not overflow.

    Parameters
    ----------
    path : str or Path
    first, second : tuple of str
        Name and unit of each column, for messages.

    Raises
    ------
    InputError
        If the file cannot be read, or if lines are not two finite numbers, or the first ones do not
        rise. The message names the file and the lines.
    """
    path = Path(path)
    number, largest = 1, 1e20
    rows: list[list[float]] = []
    mistakes = Mistakes(path)
    for number, text, cells in read_rows(path)[1]:
        values = [number_in(cell) for cell in cells]
        if values == [None, None] and not rows and not mistakes:  # a header
            continue
        match values:
            case [float(x), float(y)] if abs(x) <= largest and abs(y) <= largest:
                if rows and not x - rows[-1][0] >= 1.0 / largest:
                    mistakes.append(
                        f"{path}: line {number}: found {first[0]} {x:g}, "
                        f"must be > {rows[-1][0]:g}, the {first[0]} before it"
                    )
                rows.append([x, y])
            case _:
                mistakes.append(
                    f"{path}: line {number}: found {text[:60]!r}, must be two finite "
                    f"numbers separated by a comma: {first[0]} in {first[1]}, {second[0]} in "
                    f"{second[1]}; none larger than {largest:g}"
                )
    if not mistakes and len(rows) < 2:
        mistakes.append(f"{path}: line {number}: found {len(rows)} points, must be >= 2")
    mistakes.refuse()
    x_column, y_column = np.array(rows).T
    return x_column, y_column
