"""One Markdown page with the tables and pictures in the paper's order, and CSV of every curve."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skfem_joint.files import replacing
from skfem_joint.paper.items import Item, Row

HEADINGS = ("quantity", "published", "ours, full", "ours, reduced", "difference", "verdict")


def _cell(value: float | str | None, form: str) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else format(value, form)


def cells(row: Row) -> tuple[str, ...]:
    """Cells of a row as text, in the order of the headings."""
    printed = row.published if isinstance(row.published, str) else _cell(row.published, "g")
    return (
        row.quantity,
        printed or "",
        _cell(row.full, row.form),
        _cell(row.reduced, row.form),
        row.difference,
        row.verdict,
    )


def text_table(item: Item) -> str:
    """Table of an item for the terminal."""
    rows = [HEADINGS, *(cells(row) for row in item.rows)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEADINGS))]
    lines = [
        "  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join([item.title, lines[0], "-" * len(lines[0]), *lines[1:]])


def markdown_table(rows: Sequence[Row]) -> str:
    """Table of an item for the page."""
    lines = [HEADINGS, ("---",) * len(HEADINGS), *(cells(row) for row in rows)]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def write_page(folder: Path, items: Sequence[Item]) -> Path:
    """Write ``reproduction.md``; returns its path."""
    parts = [
        "# The paper's tables and figures, computed anew",
        "*Proper orthogonal decomposition of the dynamics in bolted joints*, Journal of Sound and "
        "Vibration (2010). Published numbers are as printed there; everything else on this page "
        "was computed in the run that wrote it.",
    ]
    for item in items:
        parts.append(f"## {item.title}")
        if item.rows:
            parts.append(markdown_table(item.rows))
        parts += item.notes
        parts += [f"![{item.title}]({path.as_posix()})" for path in item.pictures]
        if item.curves:
            names = ", ".join(f"[{name}.csv](curves/{name}.csv)" for name in item.curves)
            parts.append(f"Curves: {names}.")
    path = folder / "reproduction.md"
    with replacing(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path


def write_curves(folder: Path, item: Item) -> None:
    """Write the curves of an item as CSV files with a header."""
    for name, columns in item.curves.items():
        (folder / "curves").mkdir(parents=True, exist_ok=True)
        with replacing(folder / "curves" / f"{name}.csv") as temporary:
            np.savetxt(
                temporary,
                np.column_stack(list(columns.values())),
                delimiter=",",
                header=",".join(columns),
                comments="",
                fmt="%.9g",
            )
