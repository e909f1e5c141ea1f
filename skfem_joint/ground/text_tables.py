"""Tables in text files (CSV): lines and cells, for all readers, and tables of two columns."""

from __future__ import annotations

import io
import logging
import math
import re
import unicodedata
from array import array
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence, Set
from itertools import takewhile
from pathlib import Path

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.files import LARGEST_TABLE, UNFINISHED_LINE, read_text
from skfem_joint.ground.loads import Table

_log = logging.getLogger(__name__)

#: What may stand between cells, by the word of messages.
SEPARATORS = {",": "','", ";": "';'", "\t": "tab"}
#: Units of lengths, and what they are in metres.
LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
#: Most lines of a file that an error names.
MOST_LISTED = 10


def rows_of(lines: Iterable[str]) -> Iterator[tuple[int, str, list[str]]]:
    """Rows of a table: number of the line from 1, its text, and its cells without spaces.

    Empty lines and comments after ``#`` are left out; a line that ends with a separator has an
    empty last cell.

    The separator of all lines is that of the first line that has one: a comma, a semicolon or a
    tab.

    Raises
    ------
    ValueError
        If that line has several kinds of them.
    """
    separator = None
    for number, line in enumerate(lines, start=1):
        text = line.split("#", 1)[0].strip(" \r\n")  # tabs at the ends stand for empty cells
        if not text.strip():
            continue
        if separator is None:
            found = [mark for mark in SEPARATORS if mark in text]
            if len(found) > 1:
                kinds = " and ".join(SEPARATORS[mark] for mark in found)
                raise ValueError(
                    f"line {number}: found {kinds} between columns, must be one of them; decimals "
                    "have a point, as in 0.5"
                )
            separator = found[0] if found else None
        cells = text.split(separator) if separator else [text]
        yield number, text.strip(), [cell.strip() for cell in cells]


def read_rows(path: Path) -> tuple[str, Iterator[tuple[int, str, list[str]]]]:
    """Text of a file with a table (UTF-8), and its rows as `rows_of` gives them.

    A warning says where the last line does not end. InputError, with the name of the file, if it
    cannot be read, or has several kinds of separators.
    """
    content = read_text(path, LARGEST_TABLE)
    if content and not content.endswith(("\n", "\r")):
        _log.warning("%s: %s", path, UNFINISHED_LINE)

    def rows() -> Iterator[tuple[int, str, list[str]]]:
        try:
            yield from rows_of(io.StringIO(content, newline=None))
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error

    return content, rows()


def number_in(cell: str) -> float | None:
    """Number in a cell, as Python reads it; None if it is no number."""
    try:
        return float(cell)
    except ValueError:
        return None


def plain_unit(unit: str) -> str:
    """Unit in plain letters: µ is u, powers are plain digits, spaces are left out."""
    return re.sub(r"\s|\^|\*\*", "", unicodedata.normalize("NFKC", unit).replace("μ", "u"))


def column_units(
    texts: Sequence[str], allowed: Mapping[str, Mapping[str, float]], where: str
) -> dict[str, str | None]:
    """Units of columns by their names, from texts such as ``height (um)`` or ``height [µm]``.

    Parameters
    ----------
    texts : sequence of str
        What stands over the columns.
    allowed : mapping
        Units of each column that there may be.
    where : str
        Place for messages.

    Returns
    -------
    dict
        None for a column without a unit.

    Raises
    ------
    InputError
        For other columns, other units, and columns that stand twice; all of them at once.
    """
    units: dict[str, str | None] = {}
    problems = []
    for text in texts:
        parts = re.fullmatch(r"(.*?)\s*(?:[(\[](.*)[)\]])?", text.strip())
        name, unit = (parts[1].casefold(), plain_unit(parts[2] or "")) if parts else (text, "")
        if name not in allowed:
            problems.append(
                f"{where}: column {text!r}: must be one of {', '.join(allowed)}, with a unit in "
                "brackets"
            )
        elif name in units:
            problems.append(f"{where}: found column {name!r} again, must be once")
        elif unit and unit not in allowed[name]:
            problems.append(
                f"{where}: column {text!r}: found unit {parts and parts[2]!r}, must be one of "
                f"{', '.join(allowed[name])}"
            )
        else:
            units[name] = unit or None
    refuse(problems)
    return units


def read_columns(
    path: Path,
    units_of: Callable[[Sequence[str], str], dict[str, str | None]],
    may_lack: Container[str],
    example: str,
) -> tuple[dict[str, FloatArray], dict[str, str | None], IntArray, str]:
    """Columns of a text file (UTF-8) whose first line names them.

    Parameters
    ----------
    path : Path
    units_of : callable
        Units of the columns by their names, from the names with units and the place for messages.
    may_lack : container of str
        Columns of which cells may be empty.
    example : str
        First line of such a file, for messages.

    Returns
    -------
    columns : dict of str to ndarray, shape (k,)
        In their units; nan where cells are empty.
    units : dict of str to str or None
        None for a column without a unit.
    lines : ndarray of int, shape (k,)
        Line of each row.
    content : str
        Text of the file.

    Raises
    ------
    InputError
        If it cannot be read, has other columns, or cells are no numbers. The message names the
        file and the lines.
    """
    content, rows = read_rows(path)
    if "\0" in content:
        raise InputError(f"{path}: holds no text, must be a table of text (CSV) in UTF-8")
    number, text, names = next(rows, (0, "", list[str]()))
    if not names:
        raise InputError(f"{path}: found no columns, must begin with their names, as in {example}")
    if any(number_in(cell) is not None for cell in names):
        raise InputError(
            f"{path}: line {number}: found {text[:60]!r}, must be the names of the columns, as in "
            f"{example}"
        )
    units = units_of(names, f"{path}: line {number}")
    mistakes, values, numbers = Mistakes(path), array("d"), array("q")
    for number, _, cells in rows:
        place = f"{path}: line {number}"
        if len(cells) != len(units):
            mistakes.append(f"{place}: found {len(cells)} columns, must be {len(units)}")
        elif any(cells):  # spreadsheets leave empty rows at the end
            for name, cell in zip(units, cells, strict=True):
                value = number_in(cell or "nan")
                if value is None or (not cell and name not in may_lack):
                    hint = "; decimals have a point, as in 0.5" if "," in cell else ""
                    found = f"{place}: {name}: found {cell[:60]!r}"
                    mistakes.append(f"{found}, must be a number{hint}")
                values.append(math.nan if value is None else value)
            numbers.append(number)
    mistakes.refuse()
    columns = dict(zip(units, np.reshape(values, (-1, len(units))).T, strict=True))
    return columns, units, np.array(numbers, dtype=np.intp), content


class Mistakes(list[str]):
    """Sentences about lines of a file.

    Parameters
    ----------
    where : object
        File, for the sentence that counts those that are not shown.
    """

    def __init__(self, where: object) -> None:
        super().__init__()
        self.where = where

    def refuse(self) -> None:
        """Raise InputError with the sentences, if there are any; of very many with the first."""
        more = len(self) - MOST_LISTED
        rest = [f"{self.where}: and {more} more lines like these"] if more > 0 else []
        refuse([*self[:MOST_LISTED], *rest])


_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_NEWTONS = {"N": 1.0, "kN": 1e3, "MN": 1e6}
_PASCALS = {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "N/m2": 1.0, "N/mm2": 1e6}
#: Units of a load's columns, by the names that they may have, and of what it may be.
_TIMES = {"time": _SECONDS, "t": _SECONDS}
_AMPLITUDES: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    "force": {"force": _NEWTONS, "f": _NEWTONS},
    "traction": {"traction": _PASCALS},
    "pressure": {"pressure": _PASCALS},
    "acceleration": {"acceleration": {"m/s2": 1.0}},
}


def read_table(path: str | Path, quantity: str = "force") -> Table:
    """Table from a UTF-8 text file: time (s) and force (N), or another quantity, in its unit.

    The quantity is ``"force"``, ``"traction"``, ``"pressure"`` or ``"acceleration"``. See
    `read_pairs`.
    """
    times, forces, _ = read_pairs(path, _TIMES, _AMPLITUDES[quantity])
    return Table(times, forces)


def _head(
    cells: Sequence[str], columns: Sequence[Mapping[str, Mapping[str, float]]], where: str
) -> dict[str, str | None]:
    """Units of two columns by their names in a header; InputError for others, or swapped ones."""
    named = [
        f"{next(iter(names))} ({cell})"
        if any(plain_unit(cell) in units for units in names.values())
        else cell  # not a unit alone
        for cell, names in zip(cells, columns, strict=True)
    ]
    units = column_units(named, {**columns[0], **columns[1]}, where)
    for found, names in zip(units, columns, strict=True):
        if found not in names:
            raise InputError(f"{where}: found column {found!r}, must be {' or '.join(names)} here")
    return units


def _commented(
    content: str, columns: Sequence[Mapping[str, Mapping[str, float]]], path: Path
) -> Iterator[dict[str, str | None]]:
    """Units of two columns by their names, of each comment before numbers that is a header.

    Both of its cells begin with a name of their column or have a unit of it. One whose cells state
    values, as ``t = 25 C, f = 3``, is none. InputError for one in another form, and for units in
    brackets of which it is not clear whether they are those of columns.
    """
    above = takewhile(lambda line: not re.match(r"\s*[-+.\d]", line), content.splitlines())
    units = [{unit for units in names.values() for unit in units} for names in columns]
    for number, line in enumerate(above, start=1):
        text, where = line.partition("#")[2].strip("# \t"), f"{path}: line {number}"
        cells = re.split(r"[,;\t]", text)
        values = all(re.search(r"[:=]\s*[-+.]*\d", cell) for cell in cells)
        orders = (cells, cells[::-1]) if len(cells) == 2 and not values else ()
        if any(all(map(_belongs, order, columns, units)) for order in orders):
            try:
                yield _head(cells, columns, where)
            except InputError as error:
                refuse(f"{problem}; {_REMARK}" for problem in error.problems)
        elif any(_bracketed(text) & known for known in units):
            raise InputError(
                f"{where}: found {text[:60]!r}, a comment with units in brackets; if the columns "
                "have them, write 'name (unit), name (unit)', if not, leave the brackets out"
            )


#: Cure of a comment that reads as a header and is none.
_REMARK = "if it is a remark, write 'name = value, name = value', or no separator"


def _belongs(cell: str, names: Container[str], units: Set[str]) -> bool:
    """Whether a cell of a comment begins with a name of a column, or has a unit of it."""
    first, words = re.match(r"\s*([^\W_]*)", cell), re.split(r"[\s_:=]+", cell)
    found = {plain_unit(word) for word in (cell, *words)} | _bracketed(cell)
    return (first is not None and first[1].casefold() in names) or not found.isdisjoint(units)


def _bracketed(text: str) -> set[str]:
    """What stands in brackets, as units are written."""
    return {plain_unit(unit) for unit in re.findall(r"[(\[]([^()\[\]]+)[)\]]", text)}


def read_pairs(
    path: str | Path,
    first: Mapping[str, Mapping[str, float]],
    second: Mapping[str, Mapping[str, float]],
) -> tuple[FloatArray, FloatArray, str | None]:
    """Two columns of a UTF-8 text file, of which the first one rises.

    They are separated by a comma, a semicolon or a tab. Lines of two words before the first number
    are a header: names, with units or without, or units alone. So are such comments after ``#``
    above all numbers; a line that is no comment, or else the last one, counts. Other comments and
    empty lines are left out. Numbers are at most 1e20 in size, so that slopes and energies do not
    overflow.

    Parameters
    ----------
    path : str or Path
    first, second : mapping
        Factors of units of each column by its names. The first name stands in messages, its first
        unit is that of columns without a unit.

    Returns
    -------
    columns : ndarray, shape (k,), twice
        Times the factors of their units.
    unit : str or None
        What the header states for the second one.

    Raises
    ------
    InputError
        If the file cannot be read, the header has other names, another order or other units, lines
        are not two finite numbers, or the first ones do not rise. The message names the file and
        the lines.
    """
    path, largest, number = Path(path), 1e20, 1
    factors, unit = np.ones(2), None
    (x_name, x_units), (y_name, y_units) = (next(iter(names.items())) for names in (first, second))
    rows: list[list[float]] = []
    mistakes = Mistakes(path)
    content, lines = read_rows(path)
    heads = [*_commented(content, (first, second), path)]
    for number, text, cells in lines:
        values = [number_in(cell) for cell in cells]
        if values == [None, None] and not rows and not mistakes:  # a header
            heads.append(_head(cells, (first, second), f"{path}: line {number}"))
            continue
        match values:
            case [float(x), float(y)] if abs(x) <= largest and abs(y) <= largest:
                if rows and not x - rows[-1][0] >= 1.0 / largest:
                    mistakes.append(
                        f"{path}: line {number}: found {x_name} {x:g}, "
                        f"must be > {rows[-1][0]:g}, the {x_name} before it"
                    )
                rows.append([x, y])
            case _:
                mistakes.append(
                    f"{path}: line {number}: found {text[:60]!r}, must be two finite "
                    f"numbers separated by a comma: {x_name} in {next(iter(x_units))}, {y_name} in "
                    f"{next(iter(y_units))}; none larger than {largest:g}"
                )
    if not mistakes and len(rows) < 2:
        mistakes.append(f"{path}: line {number}: found {len(rows)} points, must be >= 2")
    mistakes.refuse()
    for head in heads:
        for k, (name, stated) in enumerate(head.items()):
            if stated is not None:
                factors[k], unit = (first, second)[k][name][stated], stated if k else unit
    x_column, y_column = factors[:, np.newaxis] * np.array(rows).T
    return x_column, y_column, unit
