"""Pictures of curves, as ``pictures.toml`` chooses them: one style, a unit on each axis."""

import re
from fnmatch import fnmatchcase

import numpy as np

from skfem_joint.output.plots import new_figure, save_figure

#: Line styles by order: dark to light, and differently broken; colour, dashes, width.
STYLES = (
    ("#000000", "-", 1.6),
    ("#9c1c0c", "--", 1.6),
    ("#1f5fa8", "-.", 1.6),
    ("#2e8033", ":", 2.0),
    ("#8f62b5", (0, (5, 1, 1, 1, 1, 1)), 1.6),
    ("#8a8a8a", (0, (8, 2)), 1.6),
)
#: Unit, factor and quantity in a picture, by the unit at the end of a column's name.
UNITS = {
    "s": ("ms", 1e3, "time"),
    "m": ("µm", 1e6, "displacement"),
    "N": ("kN", 1e-3, "force"),
    "Hz": ("kHz", 1e-3, "frequency"),
    "m_per_s": ("mm/s", 1e3, "velocity"),
    "percent": ("%", 1.0, "difference"),
    "%": ("%", 1.0, "difference"),
}
THIN = {"color": "0.5", "linewidth": 0.8}


def _read(column):
    """Name of a column, label of an axis for it, and the factor to its unit there."""
    match = re.fullmatch(r"(.*?)(?:_| \()(m_per_s|s|m|N|Hz|percent|%)\)?", column)
    if not match:
        return column.replace("_", " "), column.replace("_", " "), 1.0
    unit, factor, quantity = UNITS[match[2]]
    return match[1].replace("_", " "), f"{quantity} ({unit})", factor


def _matching(names, patterns):
    """Names that match the patterns, in the patterns' order."""
    asked = [patterns] if isinstance(patterns, str) else patterns
    return [name for pattern in asked for name in names if fnmatchcase(name, pattern)]


def _lines(panel, curves):
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


def _draw_panel(panel, curves, mark, axes):
    rows, lines = slice(*panel.get("rows", [None])), _lines(panel, curves)
    for k, (name, x, y, label) in enumerate(lines):
        (_, x_label, x_factor), (_, y_label, y_factor) = _read(x), _read(y)
        x_factor, factor = panel.get("xfactor", x_factor), panel.get("factor", y_factor)
        values = factor * curves[name][y][rows]
        values = np.abs(values) if panel.get("absolute") else values
        styled = panel.get("styles", range(len(STYLES)))
        chosen = STYLES[styled[k % len(styled)]]
        style = dict(zip(("color", "linestyle", "linewidth"), chosen, strict=True))
        style |= {"marker": panel.get("marker"), "markersize": 3.5}
        axes.plot(x_factor * curves[name][x][rows], values, label=label, **style)
    for name in panel.get("levels", []):
        axes.axhline(factor * mark(name), label=name.replace("_", " "), **THIN)
    for name in panel.get("at", []):
        axes.axvline(x_factor * mark(name), label=name.replace("_", " "), **THIN)
    for sign in (-1.0, 1.0) if "limits" in panel else ():
        axes.axhline(sign * mark(panel["limits"]), **THIN)
    axes.set(xlabel=panel.get("xlabel", x_label), ylabel=panel.get("ylabel", y_label))
    axes.set(**{key: panel[key] for key in ("xlim", "ylim", "xscale", "yscale") if key in panel})
    axes.grid(alpha=0.3)
    axes.set_title(panel.get("title", ""), loc="left", fontsize=11)
    if len(lines) > 1 and panel.get("legend", True) is True:
        axes.legend(fontsize=9, handlelength=3.2)


def draw(picture, curves, mark, path):
    """Write a picture as PNG.

    ``picture`` is as in ``pictures.toml``; ``curves`` are columns by name, by the name of their
    curve; ``mark`` gives the value of a line across by its name.
    """
    panels = [{**picture, **panel} for panel in picture.get("panels", [{}])]
    columns = picture.get("columns", len(panels))
    rows, (width, height) = -(-len(panels) // columns), picture.get("size", (6.0, 4.0))
    drawing = new_figure(columns * width, rows * height)
    places = drawing.subplots(rows, columns, squeeze=False).flat
    for panel, axes in zip(panels, places, strict=True):
        _draw_panel(panel, curves, mark, axes)
    if picture.get("legend") == "shared":
        handles, labels = drawing.axes[0].get_legend_handles_labels()
        labels = [label.partition(", ")[2] for label in labels]  # without the place
        options = {"loc": "outside upper center", "ncols": len(labels), "handlelength": 3.2}
        drawing.legend(handles, labels, fontsize=9, **options)
    save_figure(path, drawing)
