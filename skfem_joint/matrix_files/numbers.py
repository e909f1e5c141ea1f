"""Numbers in texts that Fortran programs write, checked before they are converted."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from skfem_joint.ground.arrays import FloatArray

INTEGER = rb"[+-]?\d{1,12}+"
#: Also 1.5D+03 and, as Fortran writes exponents of three digits, 1.5-103.
REAL = rb"[+-]?(?:\d++\.?+\d*+|\.\d++)(?:[EeDd][+-]?\d{1,3}+|[+-]\d{3})?+"
_BETWEEN = rb"(?:[ \t]*+,[ \t]*+|[ \t]++)"
_END = rb"[ \t]*+,?[ \t]*+\r?\n"
#: Empty lines and comments of Abaqus.
_EMPTY = rb"[ \t]*+(?:\*\*[^\n]*+)?+\r?\n"
_PLAIN = bytes.maketrans(b",DdE", b" eee")
_WITHOUT_E = re.compile(rb"(?<=[\d.])([+-]\d{3})")


def real_numbers(text: bytes) -> FloatArray:
    """Numbers of a text that is known to hold nothing else, between commas and white space."""
    plain = _WITHOUT_E.sub(rb"e\1", text.translate(_PLAIN))
    return np.fromstring(plain, sep=" ")


def number_rows(
    content: bytes, columns: tuple[bytes, ...], meaning: str
) -> tuple[FloatArray, Callable[[int], int]]:
    """Rows of numbers, (k, columns), and a function that returns the line of a row.

    Parameters
    ----------
    content : bytes
        Lines that end.
    columns : tuple of bytes
        `INTEGER` or `REAL` for each column.
    meaning : str
        The columns in words, for messages.

    Raises
    ------
    ValueError
        With the first line that is not such a row.
    """
    row = rb"[ \t]*+" + _BETWEEN.join(columns) + _END
    rows = re.compile(rb"(?:" + row + rb"|" + _EMPTY + rb")*+")
    end = rows.match(content)
    stop = end.end() if end else 0
    if stop < len(content):
        number = content.count(b"\n", 0, stop) + 1
        line = content[stop:].partition(b"\n")[0]
        raise ValueError(f"line {number}: found {shown(line)}, must be {meaning}")
    kept = re.sub(rb"\*\*[^\n]*", b"", content) if b"*" in content else content
    numbers = real_numbers(kept).reshape(-1, len(columns))

    def line_of(k: int) -> int:
        empty = re.compile(_EMPTY)
        count = -1
        for number, line in enumerate(content.splitlines(keepends=True), start=1):
            count += empty.fullmatch(line) is None
            if count == k:
                return number
        return 0

    return numbers, line_of


def shown(line: bytes) -> str:
    """A line of a file in a message."""
    return repr(line[:60].decode("latin-1").strip())
