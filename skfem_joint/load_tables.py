"""Tables of force over time in text files."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from skfem_joint.errors import refuse
from skfem_joint.files import LARGEST_TABLE, UNFINISHED_LINE, read_text
from skfem_joint.loads import Table

_log = logging.getLogger(__name__)


def read_table(path: str | Path) -> Table:
    """Table from a UTF-8 text file with two columns separated by a comma: time (s) and force (N).

    Lines of two words before the first number are a header. Empty lines and comments after ``#``
    are left out. Numbers are at most 1e20 in size, so that slopes and energies do not overflow.

    Raises
    ------
    InputError
        If the file cannot be read, or if lines are not two finite numbers with increasing times.
        The message names the file and the lines.
    """
    path = Path(path)
    content = read_text(path, LARGEST_TABLE)
    if not content.endswith(("\n", "\r")):
        _log.warning("%s: %s", path, UNFINISHED_LINE)
    lines = content.splitlines()
    most_listed, largest = 10, 1e20
    rows: list[list[float]] = []
    mistakes: list[str] = []
    more = 0
    for number, line in enumerate(lines, start=1):
        if len(mistakes) > most_listed:  # counted, not kept
            more += len(mistakes) - most_listed
            del mistakes[most_listed:]
        text = line.split("#", 1)[0].strip()
        values = [_number(column) for column in text.split(",")]
        is_header = values == [None, None] and not rows and not mistakes
        if not text or is_header:
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
                    f"{path}: line {number}: found {text[:60]!r}, must be two finite numbers "
                    f"separated by a comma: time in s, force in N; none larger than {largest:g}"
                )
    if not mistakes and len(rows) < 2:
        mistakes = [f"{path}: line {max(1, len(lines))}: found {len(rows)} points, must be >= 2"]
    more += len(mistakes[most_listed:])
    if more:
        mistakes = mistakes[:most_listed]
        mistakes.append(f"{path}: and {more} more lines like these")
    refuse(mistakes)
    return Table(*np.array(rows).T)


def _number(text: str) -> float | None:
    """Number in a column of a line; None if it is no number."""
    try:
        return float(text)
    except ValueError:
        return None
