"""The drawing of a preview: its panel, its reach in mm, and lines and colours on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.output.preview import colours
from skfem_joint.output.preview.marks import Mark, Preview
from skfem_joint.output.preview.projection import Projection, border


@dataclass(frozen=True)
class Reach:
    """What a drawing extends over.

    Attributes
    ----------
    size : float
        Larger side of the structure in the drawing, mm.
    arrows : dict
        Start and end, mm, of the arrow of each load, by ``id`` of its mark.
    low, high : ndarray, shape (2,)
        Least and largest coordinates, with space around the structure and its arrows, mm.
    frame : ndarray, shape (2,)
        Width and height on the sheet, inches.
    """

    size: float
    arrows: dict[int, tuple[FloatArray, FloatArray]]
    low: FloatArray
    high: FloatArray
    frame: FloatArray

    @staticmethod
    def of(preview: Preview, projection: Projection, width: float) -> Reach:
        """Reach of a preview's drawing, at most ``width`` inches wide."""
        nodes, bars = projection.all_nodes(), projection.dim == 1
        size = float(np.ptp(nodes, axis=0).max())
        arrows = {id(mark): projection.arrow(mark, 0.09 * size) for mark in preview.of_kind("load")}
        shown = [nodes, *(np.array(ends) for ends in arrows.values())]
        if bars:
            thick = 1e3 * projection.thickness
            shown += [nodes - (0.0, 1.1 * thick), nodes + np.array((0.0, 0.9 * thick))]
        points = np.concatenate(shown)
        pad = 0.03 * size * np.array([1.0, 0.0 if bars else 1.0])
        low, high = points.min(axis=0) - pad, points.max(axis=0) + pad
        frame = np.array([width, 0.5 + 0.9 * projection.heights.size])
        if not bars:
            wide, tall = high - low
            frame = np.array([wide, tall]) * min(width / wide, 5.5 / tall)
        return Reach(size, arrows, low, high, frame)

    def anchor(self, projection: Projection, mark: Mark) -> FloatArray:
        """Place that a label points at, mm: the middle of an arrow, or of what is marked."""
        if mark.kind == "load":
            start, end = self.arrows[id(mark)]
            return np.asarray(0.5 * (start + end))
        return projection.place(mark)


@dataclass(frozen=True)
class Drawing:
    """Panel of a preview's drawing, and what all that is drawn on it needs.

    Attributes
    ----------
    preview : Preview
    projection : Projection
    reach : Reach
    panel : matplotlib.axes.Axes
        Its coordinates are those of the projection, mm.
    norm : matplotlib.colors.Normalize
        Scale of the pressures, MPa.
    """

    preview: Preview
    projection: Projection
    reach: Reach
    panel: Any
    norm: Any

    @property
    def dim(self) -> int:
        """Dimension of the structure."""
        return self.projection.dim

    @property
    def edges_shown(self) -> bool:
        """Whether elements are large enough in the drawing for their edges."""
        return edges_fit(self.preview, self.reach)

    def lines(self, ends: FloatArray, colour: str, width: float, **more: Any) -> None:
        """Draw line segments (k, 2, 2)."""
        from matplotlib.collections import LineCollection

        self.panel.add_collection(
            LineCollection(list(ends), colors=colour, linewidths=width, **more)
        )

    def dashed(self, mark: Mark) -> None:
        """Draw the border of a solid's surface, which other parts may hide."""
        ends = self.projection.nodes(border(mark.cells))
        colour = colours.OF_KIND[mark.kind]
        self.lines(ends, colour, 1.6, linestyles=(0, (3, 2)), zorder=4)

    def colour(self, panel: Any, corners: FloatArray, values: FloatArray, order: float) -> None:
        """Draw values at the corners of cells, (c, corners), between them by triangles."""
        from matplotlib.collections import PolyCollection

        count = corners.shape[1]
        number = np.arange(corners.shape[0] * count).reshape(-1, count)
        triangles = np.vstack([number[:, [0, k, k + 1]] for k in range(1, count - 1)])
        x, y = corners.reshape(-1, 2).T
        panel.tripcolor(x, y, triangles, values.ravel(), cmap=colours.of_pressures(),
                        norm=self.norm, shading="gouraud", zorder=order)  # fmt: skip
        if self.edges_shown:
            panel.add_collection(
                PolyCollection(list(corners), facecolors="none", edgecolors="#6b5a45",
                               linewidths=0.25, alpha=0.6, zorder=order + 0.1)
            )  # fmt: skip


def edges_fit(preview: Preview, reach: Reach) -> bool:
    """Whether elements are large enough in a drawing for their edges."""
    structure = preview.structure
    area = reach.frame[0] * (reach.frame[1] if structure.dim > 1 else 0.05)
    return bool(len(structure.body.cells) <= 4000.0 * area)
