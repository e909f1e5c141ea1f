"""Tables and mappings as text: CSV, JSON, and columns for a terminal."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from skfem_joint.ground.files import replacing

#: Columns of a table by their names.
Table: TypeAlias = Mapping[str, Sequence[Any]]


def write_json(path: Path, content: Any) -> None:
    """Write JSON; NaN and infinity are refused."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_csv(path: Path, rows: Iterable[Iterable[Any]]) -> None:
    """Write a table; its first row has the headings."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def write_table(path: Path, columns: Table) -> None:
    """Write a table of columns of one length by their names.

    Numbers have ten digits; cells are empty where a value is not known.
    """
    cells = zip(*columns.values(), strict=True)
    write_csv(path, [[*columns], *([_plain(value) for value in row] for row in cells)])


def by_columns(parts: Iterable[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Columns of a table from its rows, or from tables below each other, which have the same names.

    A value that is no column stands in all rows of its part.
    """
    columns: dict[str, list[Any]] = {}
    for part in parts:
        count = max((len(values) for values in part.values() if np.ndim(values)), default=1)
        for name, values in part.items():
            columns.setdefault(name, []).extend(values if np.ndim(values) else [values] * count)
    return columns


def _plain(value: Any) -> Any:
    """Cell of a table."""
    if isinstance(value, float | np.floating):
        return f"{value:.10g}" if np.isfinite(value) else ""
    return "" if value is None else value


@dataclass(frozen=True)
class TextTable:
    """Table whose cells are texts.

    Attributes
    ----------
    corner : str
        What stands above the labels of the rows.
    columns : sequence of str
        Headings.
    rows : mapping of str to sequence of str
        Cells by the labels of the rows.
    """

    corner: str
    columns: Sequence[str]
    rows: Mapping[str, Sequence[str]]

    @property
    def lines(self) -> list[list[str]]:
        """Cells with headings and labels, line by line."""
        return [
            [self.corner, *self.columns],
            *([label, *cells] for label, cells in self.rows.items()),
        ]

    def __str__(self) -> str:
        """Lines of the table, as wide as it needs to be whatever the width of the terminal."""
        table = self.lines
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        lines = [
            "   ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])])
            for row in table
        ]
        lines.insert(1, "-" * (sum(widths) + 3 * len(self.columns)))
        return "\n".join(line.rstrip() for line in lines)
