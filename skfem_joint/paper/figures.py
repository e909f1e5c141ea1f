"""Figures in one style: readable in greyscale, a unit on every axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from skfem_joint.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Line styles by order: dark to light, and differently broken.
STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#000000", "linestyle": "-", "linewidth": 1.6},
    {"color": "#9c1c0c", "linestyle": "--", "linewidth": 1.6},
    {"color": "#1f5fa8", "linestyle": "-.", "linewidth": 1.6},
    {"color": "#2e8033", "linestyle": ":", "linewidth": 2.0},
    {"color": "#8f62b5", "linestyle": (0, (5, 1, 1, 1, 1, 1)), "linewidth": 1.6},
    {"color": "#8a8a8a", "linestyle": (0, (8, 2)), "linewidth": 1.6},
)


def figure(
    columns: int = 1, rows: int = 1, width: float = 6.0, height: float = 4.0
) -> tuple[Figure, Any]:
    """Figure and its axes (an array if there are several), in inches per panel.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("pictures need matplotlib: pip install 'skfem-joint[plot]'") from error
    drawing = Figure(figsize=(columns * width, rows * height), layout="constrained")
    return drawing, drawing.subplots(rows, columns)


def finish(axes: Any, x: str, y: str, title: str = "", legend: bool = True) -> None:
    """Label an axes object: names with units."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.3)
    if title:
        axes.set_title(title, loc="left", fontsize=11)
    if legend and axes.get_legend_handles_labels()[0]:
        axes.legend(fontsize=9, handlelength=3.2)
