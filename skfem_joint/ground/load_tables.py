"""Tables of force over time in text files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skfem_joint.ground.loads import Table
from skfem_joint.ground.text_tables import Mistakes, number_in, read_rows


def read_table(path: str | Path) -> Table:
    """Table from a UTF-8 text file with two columns: time (s) and force (N).

    They are separated by a comma, a semicolon or a tab. Lines of two words before the first number
    are a header. Empty lines and comments after ``#`` are left out. Numbers are at most 1e20 in
    size, so that slopes and energies do not overflow.

    Raises
    ------
    InputError
        If the file cannot be read, or if lines are not two finite numbers with increasing times.
        The message names the file and the lines.
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
            case [float(time), float(force)] if abs(time) <= largest and abs(force) <= largest:
                if rows and not time - rows[-1][0] >= 1.0 / largest:
                    mistakes.append(
                        f"{path}: line {number}: found time {time:g}, "
                        f"must be > {rows[-1][0]:g}, the time before it"
                    )
                rows.append([time, force])
            case _:
                mistakes.append(
                    f"{path}: line {number}: found {text[:60]!r}, must be two finite "
                    "numbers separated by a comma: time in s, force in N; none larger than "
                    f"{largest:g}"
                )
    if not mistakes and len(rows) < 2:
        mistakes.append(f"{path}: line {number}: found {len(rows)} points, must be >= 2")
    mistakes.refuse()
    return Table(*np.array(rows).T)
