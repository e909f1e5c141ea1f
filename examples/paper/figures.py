"""Pictures of curves, as ``pictures.toml`` chooses them: one style, a unit on each axis."""

import re
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.output.plots import new_figure, save_figure

#: Line styles by order: dark to light, and differently broken.
STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#000000", "linestyle": "-", "linewidth": 1.6},
    {"color": "#9c1c0c", "linestyle": "--", "linewidth": 1.6},
    {"color": "#1f5fa8", "linestyle": "-.", "linewidth": 1.6},
    {"color": "#2e8033", "linestyle": ":", "linewidth": 2.0},
    {"color": "#8f62b5", "linestyle": (0, (5, 1, 1, 1, 1, 1)), "linewidth": 1.6},
    {"color": "#8a8a8a", "linestyle": (0, (8, 2)), "linewidth": 1.6},
)
#: What columns are drawn as, by the unit at the end of their names: unit, factor, usual quantity.
UNITS = {
    "s": ("ms", 1e3, "time"),
    "m": ("µm", 1e6, "displacement"),
    "N": ("kN", 1e-3, "force"),
    "Hz": ("kHz", 1e-3, "frequency"),
    "m_per_s": ("mm/s", 1e3, "velocity"),
    "percent": ("%", 1.0, "difference"),
    "%": ("%", 1.0, "difference"),
}
_THIN = {"color": "0.5", "linewidth": 0.8}

Curves = Mapping[str, Mapping[str, FloatArray]]


def _read(column: str) -> tuple[str, str, float]:
    """Name of a column, label of an axis for it, and the factor to its unit there."""
    found = re.fullmatch(r"(.*?)(?:_| \()(m_per_s|s|m|N|Hz|percent|%)\)?", column)
    if not found:
        return column.replace("_", " "), column.replace("_", " "), 1.0
    unit, factor, quantity = UNITS[found[2]]
    return found[1].replace("_", " "), f"{quantity} ({unit})", factor


def _matching(names: Any, patterns: str | list[str]) -> list[str]:
    """Names that match the patterns, in the patterns' order."""
    asked = [patterns] if isinstance(patterns, str) else patterns
    return [name for pattern in asked for name in names if fnmatchcase(name, pattern)]


def _lines(panel: Mapping[str, Any], curves: Curves) -> list[tuple[str, str, str, str]]:
    """Curve, column of x, column of y and label of each line of a panel."""
    lines, chosen = [], _matching(curves, panel["curve"])
    start, _, end = panel["curve"].partition("*")
    for name in chosen:
        first, *others = curves[name]
        x, y = panel.get("x", first), panel.get("y", others)
        columns = _matching(curves[name], x if isinstance(x, list) else y)
        for column in columns:
            parts = [name.removeprefix(start).removesuffix(end)] if len(chosen) > 1 else []
            parts += [_read(column)[0]] if len(columns) > 1 or not parts else []
            pair = (column, y) if isinstance(x, list) else (x, column)
            lines.append((name, *pair, ", ".join(parts).replace("_", " ")))
    return lines


def _draw_panel(
    panel: Mapping[str, Any], curves: Curves, mark: Callable[[str], float], axes: Any
) -> None:
    rows = slice(*panel.get("rows", [None]))
    lines = _lines(panel, curves)
    for k, (name, x, y, label) in enumerate(lines):
        (_, x_label, x_factor), (_, y_label, y_factor) = _read(x), _read(y)
        x_factor, factor = panel.get("xfactor", x_factor), panel.get("factor", y_factor)
        values = factor * curves[name][y][rows]
        values = np.abs(values) if panel.get("absolute") else values
        look = STYLES[k % len(STYLES)] | {"marker": panel.get("marker"), "markersize": 3.5}
        axes.plot(x_factor * curves[name][x][rows], values, label=label, **look)
    for name in panel.get("levels", []):
        axes.axhline(factor * mark(name), label=name.replace("_", " "), **_THIN)
    for name in panel.get("at", []):
        axes.axvline(x_factor * mark(name), label=name.replace("_", " "), **_THIN)
    for sign in (-1.0, 1.0) if "limits" in panel else ():
        axes.axhline(sign * mark(panel["limits"]), **_THIN)
    axes.set(xlabel=panel.get("xlabel", x_label), ylabel=panel.get("ylabel", y_label))
    axes.set(**{key: panel[key] for key in ("xlim", "ylim", "xscale", "yscale") if key in panel})
    axes.grid(alpha=0.3)
    axes.set_title(panel.get("title", ""), loc="left", fontsize=11)
    if len(lines) > 1 and panel.get("legend", True):
        axes.legend(fontsize=9, handlelength=3.2)


def draw(
    picture: Mapping[str, Any], curves: Curves, mark: Callable[[str], float], path: Path
) -> None:
    """Write a picture as PNG.

    ``picture`` is as in ``pictures.toml``; ``curves`` are columns by name, by the name of their
    curve; ``mark`` gives the value of a line across by its name.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    panels = [{**picture, **panel} for panel in picture.get("panels", [{}])]
    columns = picture.get("columns", len(panels))
    rows, (width, height) = -(-len(panels) // columns), picture.get("size", (6.0, 4.0))
    drawing = new_figure(columns * width, rows * height)
    for panel, axes in zip(
        panels, drawing.subplots(rows, columns, squeeze=False).flat, strict=True
    ):
        _draw_panel(panel, curves, mark, axes)
    save_figure(path, drawing)
