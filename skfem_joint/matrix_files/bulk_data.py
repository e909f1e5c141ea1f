"""Entries of Nastran's bulk data: a word with fields, which go on in the lines below.

Fields have 8 characters, in entries with ``*`` 16, or stand between commas; a number may lack the E
of its exponent (MSC Nastran Quick Reference Guide, "Format of Bulk Data Entries").
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

_REAL = re.compile(r"([+-]?(?:\d+\.\d*|\.\d+|\d+))(?:[EeDd]?([+-]\d{1,3})|[EeDd](\d{1,3}))?")
_TEXT = re.compile(r"[ -#%-~]*")
#: End of a word, first field of a line, and last field, which names the next line.
_BREAK = re.compile(r"[\s,]")
_HEAD = re.compile(r"[A-Za-z]\w{0,7}\*?|[+*]?\w{0,7}")
_NEXT = re.compile(r"[+*]\w{0,7}")


class Entry(NamedTuple):
    """An entry.

    Attributes
    ----------
    line : int
        Line of its word.
    word : str
        In capitals, without the ``*`` of long fields.
    cells : list of str
        Fields after the word.
    lines : list of int
        Lines of the fields.
    """

    line: int
    word: str
    cells: list[str]
    lines: list[int]


def entries(text: str, wanted: Callable[[str, int], bool], first: int = 1) -> Iterator[Entry]:
    """Entries whose word, with its line, is wanted; the lines are counted from ``first``.

    Comments are left out. ValueError, which begins with the line, for damaged fields, for a word
    that does not begin in the first column, where a line without a word goes on, and for a line
    that goes on from another one than that above it.
    """
    entry: Entry | None = None
    last = ""  # name by which the next line goes on
    for number, raw in enumerate(text.split("\n"), first):
        line = raw.rstrip()
        if not line or line.lstrip().startswith("$"):
            continue
        head = line[:8].partition(",")[0].strip()
        word = _BREAK.split(line[:8], maxsplit=1)[0].upper()
        if head[:1].isalpha() and not word:
            raise ValueError(f"line {number}: found {line[:60]!r}, must begin in the first column")
        if word[:1] not in ("", "+", "*"):
            if entry is not None:
                yield entry
            plain, last = word.removesuffix("*"), ""
            entry = Entry(number, plain, [], []) if wanted(plain, number) else None
        if entry is not None:
            name = "" if number == entry.line else head.lstrip("+*")
            if name and name != last:
                raise ValueError(
                    f"line {number}: found a line that goes on by the name {name!r} below one that "
                    f"ends with {last or 'none'!r}: put it below the line that it belongs to"
                )
            own, last = _cells(line, head, number)
            entry.cells.extend(own)
            entry.lines.extend([number] * len(own))
    if entry is not None:
        yield entry


def _cells(line: str, head: str, number: int) -> tuple[list[str], str]:
    """Cells of a line after its ``head``, eight of 8 characters or four of 16; and its end's name.

    That is the name, without its sign, of the line by which it goes on.
    """
    wide = "*" in line[:8].partition(",")[0]
    count = 4 if wide else 8
    if not _TEXT.fullmatch(line):  # no tabs, no comments behind
        raise ValueError(
            f"line {number}: found {line[:60]!r}, must be fields of 8 or 16 characters, or commas, "
            "without tabs between them and comments behind"
        )
    if "," in line:
        cells = [cell.strip() for cell in line.split(",")][1:]
        rest = " ".join(cells[count:])
    else:
        width = 16 if wide else 8
        cells = [line[8 + width * k : 8 + width * (k + 1)].strip() for k in range(count)]
        rest = line[72:].strip()
    if not _HEAD.fullmatch(head) or not any(cells):
        raise ValueError(f"line {number}: found {line[:60]!r}, must be fields of an entry")
    if rest and not _NEXT.fullmatch(rest):
        raise ValueError(f"line {number}: found {rest[:40]!r} after the last field")
    cells = cells[:count]
    for cell in cells:
        if " " in cell:
            raise ValueError(f"line {number}: found {cell!r} in a field, must be one number")
    return [*cells, *[""] * (count - len(cells))], rest.lstrip("+*")


def whole(cell: str) -> int:
    """Number of a field, 0 if it is empty; ValueError if it is no whole number from 0 on."""
    if not cell:
        return 0
    if not (cell.isascii() and cell.isdecimal() and len(cell) < 10):
        raise ValueError(f"found {cell!r}, must be a whole number")
    return int(cell)


def real(cell: str, line: int) -> float:
    """Number of a field in a line; ValueError if it is none."""
    found = _REAL.fullmatch(cell)
    if found is None:
        raise ValueError(f"line {line}: found {cell!r}, must be a number")
    return float(f"{found[1]}e{found[2] or found[3] or 0}")
