"""Columns of measured curves: their names, their units, and reading them from files and arrays.

The name of a column is one of `COLUMNS`, alone or with a unit: ``amplitude``, ``amplitude (mm)``,
``amplitude [mm]``, ``amplitude_mm``. Capitals do not matter in names, spaces stand for underscores,
and ``damping_ratio`` is ``damping``. After an underscore ``_per_`` stands for a slash, as in
``amplitude_m_per_s2``. Columns of other names are not used, and a note says so.
"""

from __future__ import annotations

import io
import logging
import re
import unicodedata
from array import array
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skfem_joint.arrays import FloatArray, IntArray, as_real
from skfem_joint.errors import InputError, closest, refuse
from skfem_joint.files import LARGEST_TABLE, UNFINISHED_LINE, read_text
from skfem_joint.text_tables import Mistakes, Row, number_in, rows_of

_log = logging.getLogger(__name__)

#: Units of the amplitude of each quantity and what they are in SI.
AMPLITUDES: Mapping[str, Mapping[str, float]] = {
    "displacement": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6},
    "acceleration": {"m/s2": 1.0, "mm/s2": 1e-3, "g": 9.80665},
}
_ANY_AMPLITUDE = {unit: value for units in AMPLITUDES.values() for unit, value in units.items()}
_FREQUENCY = {"Hz": 1.0, "hz": 1.0, "kHz": 1e3, "khz": 1e3, "rad/s": 0.5 / np.pi}
_DAMPING = {"1": 1.0, "-": 1.0, "ratio": 1.0, "%": 1e-2, "percent": 1e-2}
#: Units of each column; the first one is that of a column without a unit, except of amplitudes,
#: whose unit or quantity must be stated.
COLUMNS: Mapping[str, Mapping[str, float]] = {
    "amplitude": _ANY_AMPLITUDE,
    "frequency": _FREQUENCY,
    "damping": _DAMPING,
    "frequency_deviation": _FREQUENCY,
    "damping_deviation": _DAMPING,
    "time": {"s": 1.0, "ms": 1e-3},
    "signal": _ANY_AMPLITUDE,
}
#: Columns in which empty cells and nan stand for what was not measured.
_MAY_LACK = ("frequency", "damping", "frequency_deviation", "damping_deviation")
#: Sizes of values: squares of what is in between stay within the range of floats.
_SMALLEST, _LARGEST = 1e-20, 1e20
_EXAMPLE = "'amplitude (mm), frequency (Hz), damping (%)', or 'time (s), signal (m/s2)' of a decay"


class Column(NamedTuple):
    """Name of a column of `COLUMNS` and its unit as `plain_unit`; None where none is stated."""

    name: str
    unit: str | None


class Samples(NamedTuple):
    """Columns of numbers as they were given, with their places for messages.

    Attributes
    ----------
    where : str
        File, or what arrays are called in messages.
    columns : dict of str to ndarray, shape (k,)
        In the units of ``units``; nan where nothing was measured.
    units : dict of str to str or None
        As `Column.unit`.
    kind : str
        ``"line"`` of a file or ``"sample"`` of arrays.
    numbers : ndarray of int, shape (k,)
        Of lines or samples, for messages.
    remarks : list of (int, str)
        Comment lines with their numbers.
    notes : list of str
        What was not used.
    """

    where: str
    columns: dict[str, FloatArray]
    units: dict[str, str | None]
    kind: str
    numbers: IntArray
    remarks: list[tuple[int, str]]
    notes: list[str]

    def place(self, k: int | np.intp) -> str:
        """Place of a row for messages."""
        return f"{self.where}: {self.kind} {self.numbers[k]}"

    def taken(self, rows: Any) -> Samples:
        """The same with some of the rows, by an index or a mask."""
        columns = {name: values[rows] for name, values in self.columns.items()}
        return self._replace(columns=columns, numbers=self.numbers[rows])


def plain_unit(text: str) -> str:
    """Unit in the letters of `COLUMNS`: µ is u, powers are plain digits, spaces are left out."""
    plain = unicodedata.normalize("NFKC", text).replace("μ", "u")
    return re.sub(r"\s|\^|\*\*", "", plain)


def shown_units(units: Mapping[str, float]) -> str:
    """Units for messages, without other spellings of the same."""
    return ", ".join(unit for unit in units if unit not in ("hz", "khz", "-", "ratio", "percent"))


def column_of(text: str) -> Column | None:
    """Column with a name and maybe a unit; None if the name is none of `COLUMNS`.

    Raises
    ------
    InputError
        If the unit is none of those of the column, or the name is nearly that of a column.
    """
    bracket = re.fullmatch(r"(.*?)\s*[(\[]([^()\[\]]*)[)\]]", text.strip())
    words, unit = bracket.groups() if bracket else (text.strip(), "")
    words = re.sub(r"[\s_-]+", "_", words)
    words = re.sub(r"^damping_ratio(?=_|$)", "damping", words, flags=re.IGNORECASE)
    for name in sorted(COLUMNS, key=len, reverse=True):
        rest = words[len(name) :]
        if words[: len(name)].casefold() != name or rest[:1] not in ("", "_"):
            continue
        if rest and bracket:
            break
        unit = rest[1:].replace("_per_", "/") if rest else unit
        plain = plain_unit(unit)
        if plain and plain not in COLUMNS[name]:
            near = closest(words, COLUMNS)
            if rest and near and f"'{name}'" not in near:  # such as damping_deviations
                break
            raise InputError(
                f"column {text!r}: found unit {unit!r}, must be one of {shown_units(COLUMNS[name])}"
            )
        return Column(name, plain or None)
    if near := closest(words, COLUMNS):
        raise InputError(f"column {text!r}: is none of {', '.join(COLUMNS)}{near}")
    return None


def _columns_of(texts: Sequence[str], where: str) -> list[Column | None]:
    """Columns of names; InputError if a name or unit is wrong, or two columns are the same."""
    columns: list[Column | None] = []
    problems = []
    for text in texts:
        try:
            columns.append(column_of(text))
        except InputError as error:
            problems.append(f"{where}: {error}")
    names = [column.name for column in columns if column is not None]
    problems += [
        f"{where}: found column {name!r} {names.count(name)} times, must be once"
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
    refuse(problems)
    refuse(_lacking(names, where))
    return columns


def _lacking(names: Sequence[str], where: str) -> list[str]:
    """Sentence about columns that make neither a curve nor a signal over time."""
    of_time = {"time", "signal"} & {*names}
    of_curve = {*names} - of_time
    if of_time and of_curve:
        return [
            f"{where}: found columns {', '.join(names)}; must be those of a curve over amplitude, "
            "or time and signal"
        ]
    if of_time == {"time", "signal"}:
        return []
    lacks = [
        name
        for name in ("frequency", "damping")
        if f"{name}_deviation" in names and name not in names
    ]
    if lacks:
        return [f"{where}: found column '{lacks[0]}_deviation' and no '{lacks[0]}'"]
    if "amplitude" in names and {"frequency", "damping"} & {*names}:
        return []
    found = f"columns {', '.join(names)}" if names else "no column of a known name"
    return [
        f"{where}: found {found}; must be amplitude with frequency, damping or both, as in "
        f"{_EXAMPLE}"
    ]


def read_samples(path: Path) -> Samples:
    """Samples from a text file with named columns (UTF-8).

    Raises
    ------
    InputError
        If it cannot be read, has no such columns, or cells are no numbers. The message names the
        file and the lines.
    """
    content = read_text(path, LARGEST_TABLE)
    if "\0" in content:
        raise InputError(f"{path}: holds no text, must be a table of text (CSV) in UTF-8")
    if content and not content.endswith(("\n", "\r")):
        _log.warning("%s: %s", path, UNFINISHED_LINE)
    rows = rows_of(io.StringIO(content, newline=None))
    try:
        first = next(rows, None)
        if first is None:
            raise InputError(
                f"{path}: found no columns, must begin with their names, as in {_EXAMPLE}"
            )
        columns = _columns_of(_names_in(first, path), f"{path}: line {first.number}")
        values, numbers = _numbers(path, columns, rows)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    return Samples(
        where=str(path),
        columns={own.name: values[:, k] for k, own in enumerate(filter(None, columns))},
        units={own.name: own.unit for own in columns if own is not None},
        kind="line",
        numbers=numbers,
        remarks=[
            (number, line.strip())
            for number, line in enumerate(io.StringIO(content, newline=None), start=1)
            if line.lstrip().startswith("#")
        ],
        notes=[
            f"{path.name}: column {name!r} is not used."
            for name, own in zip(first.cells, columns, strict=True)
            if name and own is None
        ],
    )


def _names_in(first: Row, path: Path) -> list[str]:
    """Names of the columns in the first row; InputError if it has numbers."""
    if any(number_in(cell) is not None for cell in first.cells):
        raise InputError(
            f"{path}: line {first.number}: found {first.text[:60]!r}, must be the names of the "
            f"columns, as in {_EXAMPLE}"
        )
    return first.cells


def _numbers(
    path: Path, columns: Sequence[Column | None], rows: Iterable[Row]
) -> tuple[FloatArray, IntArray]:
    """Values of the used columns, (k, used), and the lines of their rows, (k,).

    Rows without any value, which spreadsheets leave at the end, are left out.
    """
    used = [(k, own.name) for k, own in enumerate(columns) if own is not None]
    mistakes = Mistakes(path)
    values, lines = array("d"), array("q")
    for line, _, cells in rows:
        if not any(cells):
            continue
        if len(cells) != len(columns):
            mistakes.add(
                f"{path}: line {line}: found {len(cells)} columns, must be {len(columns)}, as the "
                "names have"
            )
            continue
        for k, name in used:
            cell = cells[k]
            number = np.nan if not cell and name in _MAY_LACK else number_in(cell)
            if number is None:
                hint = "; decimals have a point, as in 0.5" if "," in cell else ""
                mistakes.add(
                    f"{path}: line {line}: {name}: found {cell[:60]!r}, must be a number{hint}"
                )
                continue
            values.append(number)
        lines.append(line)
    mistakes.refuse()
    return np.array(values).reshape(-1, len(used)), np.array(lines, dtype=np.intp)


def given_samples(arrays: Mapping[str, Any], where: str) -> Samples:
    """Samples from arrays by the names of columns, which may have units as in files.

    Raises
    ------
    InputError
        If names are wrong or lack, or arrays are not real and of one shape (k,).
    """
    names = [str(name) for name in arrays]
    columns = _columns_of(names, where)
    values = {
        own.name: as_real(given, f"{where}: {own.name}")
        for own, given in zip(columns, arrays.values(), strict=True)
        if own is not None
    }
    shapes = {name: own.shape for name, own in values.items()}
    if len(set(shapes.values())) > 1 or any(len(shape) != 1 for shape in shapes.values()):
        found = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise InputError(f"{where}: found arrays of shapes {found}; must be one shape (k,)")
    count = next(iter(values.values())).size
    unused = [name for name, own in zip(names, columns, strict=True) if own is None]
    return Samples(
        where=where,
        columns=values,
        units={own.name: own.unit for own in columns if own is not None},
        kind="sample",
        numbers=np.arange(count),
        remarks=[],
        notes=[f"{where}: {name!r} is not used." for name in unused],
    )


def check_samples(samples: Samples) -> None:
    """Refuse values that nothing measured can have: all mistakes at once, by their lines.

    Raises
    ------
    InputError
        If amplitudes or frequencies are not positive, dampings negative or not below 1, deviations
        not positive, values not finite, or a row has neither frequency nor damping.
    """
    mistakes = Mistakes(samples.where)
    positive = f"must be > 0, from {_SMALLEST:g} to {_LARGEST:g}"
    finite = f"must be finite, at most {_LARGEST:g} in size"
    rules = {"time": finite, "signal": finite, "amplitude": positive}
    for name, values in samples.columns.items():
        factor = COLUMNS[name].get(samples.units[name] or "", 1.0)
        right = (np.abs(values) <= _LARGEST) | (np.isnan(values) if name in _MAY_LACK else False)
        if name == "damping":
            right &= ~(values < 0.0) & ~(values * factor >= 1.0)
        elif name not in ("time", "signal"):
            right &= ~(values < _SMALLEST)
        rule = rules.get(name, f"{positive}, or empty where it was not measured")
        for k in np.flatnonzero(~right):
            more = rule
            if name == "damping":
                more = f"must be >= 0 and below {1.0 / factor:g}, or empty"
                if factor == 1.0 and values[k] >= 1.0:
                    more += "; is it in percent? Then name the column 'damping (%)'"
            mistakes.add(f"{samples.place(k)}: {name}: found {values[k]:g}, {more}")
    either = [samples.columns[name] for name in ("frequency", "damping") if name in samples.columns]
    if either:
        for k in np.flatnonzero(np.isnan(either).all(axis=0)):
            mistakes.add(
                f"{samples.place(k)}: found neither a frequency nor a damping; leave the row out"
            )
    mistakes.refuse()
    count = samples.numbers.size
    if count < 3:
        raise InputError(f"{samples.where}: found {count} rows of values, must be at least 3")
