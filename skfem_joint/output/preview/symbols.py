"""Joints, supports, bolts and loads on a preview's drawing."""

from __future__ import annotations

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.output.preview import colours
from skfem_joint.output.preview.drawing import Drawing
from skfem_joint.output.preview.marks import Mark
from skfem_joint.output.preview.projection import border


def draw_symbols(drawing: Drawing) -> None:
    """Draw joints, supports, bolts and loads, each kind over those before."""
    draw_kind = {"joint": _joint, "support": _support, "bolt": _bolt, "load": _load}
    for kind, draw in draw_kind.items():
        for mark in drawing.preview.of_kind(kind):
            draw(drawing, mark)


def _joint(drawing: Drawing, mark: Mark) -> None:
    """Colours of the pressure; of a solid the border, as its face is drawn below."""
    from matplotlib.collections import LineCollection

    projection = drawing.projection
    pressure, cells = 1e-6 * np.asarray(mark.pressure), mark.cells
    if drawing.dim == 3:
        drawing.dashed(mark)
    elif cells.shape[1] == 2:
        ends = projection.nodes(cells, -0.5)
        drawing.lines(ends, "#2b2f33", 9.0, zorder=3, capstyle="butt")
        lines = LineCollection(list(ends), cmap=colours.of_pressures(), norm=drawing.norm,
                               linewidths=7.0, capstyle="butt", zorder=4)  # fmt: skip
        lines.set_array(pressure.mean(axis=1))
        drawing.panel.add_collection(lines)
        if drawing.dim == 1 and "\non a rigid base\n" in mark.text:
            _base(drawing, ends)
    else:
        drawing.colour(drawing.panel, projection.nodes(cells), pressure, 2.5)
        drawing.lines(projection.nodes(border(cells)), colours.OF_KIND["joint"], 1.8, zorder=3)


def _base(drawing: Drawing, ends: FloatArray) -> None:
    """Hatched ground below lines (k, 2, 2)."""
    from matplotlib.patches import Rectangle

    points = ends.reshape(-1, 2)
    (left, level), (right, _) = points.min(axis=0), points.max(axis=0)
    depth = 0.1 * (drawing.reach.high - drawing.reach.low)[1]
    drawing.panel.add_patch(
        Rectangle((left, level - depth), right - left, depth, facecolor="white",
                  edgecolor="#6d747b", hatch="////", linewidth=0.0, zorder=2)
    )  # fmt: skip


def _surface(drawing: Drawing, mark: Mark, width: float) -> None:
    """Border of a surface of a solid, or the edges of a plate that are marked."""
    if drawing.dim == 3 and len(mark.cells):
        drawing.dashed(mark)
    elif drawing.dim == 2 and mark.cells.shape[1] == 2 and len(mark.cells):
        ends = drawing.projection.nodes(mark.cells)
        drawing.lines(ends, colours.OF_KIND[mark.kind], width, zorder=5)


def _support(drawing: Drawing, mark: Mark) -> None:
    """Surface or nodes of a support."""
    projection, colour = drawing.projection, colours.OF_KIND["support"]
    _surface(drawing, mark, 5.0)
    nodes = mark.nodes if len(mark.nodes) <= 60 else mark.nodes[:: len(mark.nodes) // 40]
    if drawing.dim == 1:
        ends = np.stack([projection.nodes(nodes, side) for side in (-0.65, 0.65)], axis=1)
        drawing.lines(ends, colour, 6.0 if len(nodes) == 1 else 2.0, zorder=6)
    elif drawing.dim == 2 or not len(mark.cells):
        x, y = projection.nodes(nodes).T
        drawing.panel.scatter(x, y, marker="^", s=36, color=colour, edgecolors="white", zorder=6)


def _bolt(drawing: Drawing, mark: Mark) -> None:
    """Surfaces and axis, or rings and middle, of a bolt."""
    projection, panel, colour = drawing.projection, drawing.panel, colours.OF_KIND["bolt"]
    _surface(drawing, mark, 5.0)
    if mark.line is not None:
        x, y = projection.points(mark.line).T
        panel.plot(x, y, color=colour, linewidth=1.5, linestyle="-.", zorder=6)
    if mark.rings:
        turn = np.linspace(0.0, 2.0 * np.pi, 73)
        ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        for radius in mark.rings if drawing.dim > 1 else ():
            at = np.pad(ring, ((0, 0), (0, drawing.dim - 2))) * radius + mark.at
            panel.plot(*projection.points(at).T, color=colour, lw=1.5, zorder=6)
        x, y = projection.points(mark.at)
        panel.scatter([x], [y], marker="+", s=90, color=colour, zorder=6)


def _load(drawing: Drawing, mark: Mark) -> None:
    """Arrow of a load; a circle with a point where it runs along the view."""
    panel, colour = drawing.panel, colours.OF_KIND["load"]
    start, end = drawing.reach.arrows[id(mark)]
    _surface(drawing, mark, 3.0)
    if np.linalg.norm(end - start) < 0.015 * drawing.reach.size:
        panel.scatter(*start, s=160, facecolors="white", edgecolors=colour, zorder=7)
        panel.scatter(*start, s=20, color=colour, zorder=8)
        return
    panel.annotate(
        "", xy=end, xytext=start, zorder=8, annotation_clip=False,
        arrowprops={"arrowstyle": "-|>,head_length=0.8,head_width=0.35", "color": colour,
                    "linewidth": 3.0, "shrinkA": 0.0, "shrinkB": 0.0},
    )  # fmt: skip
