"""Axes of a preview's drawing in mm."""

from __future__ import annotations

import numpy as np

from skfem_joint.output.preview.drawing import Drawing


def draw_scales(drawing: Drawing) -> None:
    """Draw ticks at the frame, or of a solid along three edges of its bounding box."""
    panel = drawing.panel
    if drawing.dim == 3:
        panel.set_axis_off()
        _rulers(drawing)
        return
    panel.spines[["top", "right"]].set_visible(False)
    if drawing.dim == 1:
        panel.set_xlabel("position along the bar, mm")
        panel.set_yticks([])
        panel.spines["left"].set_visible(False)
        return
    enlarged = drawing.projection.enlarged
    panel.set_xlabel("x, mm")
    panel.set_ylabel("y, mm")
    panel.yaxis.set_major_formatter(lambda value, _: f"{value / enlarged:g}")
    panel.locator_params(axis="y", nbins=max(2, int(drawing.reach.frame[1] / 0.3)))


def _rulers(drawing: Drawing) -> None:
    """Lines with ticks along the edges x, y and z of the bounding box."""
    from matplotlib.ticker import MaxNLocator

    panel, points, reach = drawing.panel, drawing.projection.points, drawing.reach
    nodes = drawing.preview.structure.nodes
    low, high = nodes.min(axis=0), nodes.max(axis=0)
    inch = (reach.high - reach.low)[0] / reach.frame[0]  # mm in the drawing
    centre = points(0.5 * (low + high))
    starts = (low, np.array([high[0], low[1], low[2]]), low)
    for axis, start in enumerate(starts):
        end = start.copy()
        end[axis] = high[axis]
        ends = points(np.array([start, end]))
        length = np.linalg.norm(ends[1] - ends[0])
        along = (ends[1] - ends[0]) / length
        away = np.array([-along[1], along[0]])
        away *= np.sign(away @ (ends.mean(axis=0) - centre)) or 1.0
        line = ends + 0.08 * inch * away
        panel.plot(*line.T, color="black", lw=1.0, clip_on=False, zorder=9)
        least, most = 1e3 * low[axis], 1e3 * high[axis]
        values = MaxNLocator(max(1, int(length / (0.55 * inch)))).tick_values(least, most)
        for value in values[(values >= least - 1e-6) & (values <= most + 1e-6)]:
            at = start.copy()
            at[axis] = 1e-3 * value
            tick = points(at) + 0.08 * inch * away
            tip = tick + 0.06 * inch * away
            panel.plot(*np.array([tick, tip]).T, color="black", lw=1.0, clip_on=False)
            panel.text(*(tick + 0.2 * inch * away), f"{value:g}", ha="center", va="center",
                       fontsize=8, clip_on=False)  # fmt: skip
        name = line.mean(axis=0) + 0.58 * inch * away
        panel.text(*name, f"{'xyz'[axis]}, mm", ha="center", va="center", fontsize=9)
