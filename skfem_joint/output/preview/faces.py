"""Faces of the joints of solids, each in a panel, seen at a right angle to it."""

from __future__ import annotations

from typing import Any

import numpy as np

from skfem_joint.output.preview import colours
from skfem_joint.output.preview.drawing import Drawing
from skfem_joint.output.preview.marks import Mark, Preview

#: Height on the sheet of a row of panels, two a row, and of a panel, inches.
ROW, PANEL = 2.75, 1.75
#: Faces that have a panel, at most.
_MOST = 6


def faces_of(preview: Preview) -> tuple[Mark, ...]:
    """Joints whose faces have a panel."""
    return preview.of_kind("joint")[:_MOST] if preview.structure.dim == 3 else ()


def draw_face(drawing: Drawing, panel: Any, mark: Mark) -> None:
    """Draw the pressure on a joint's face and the bolts that pass through it."""
    x = drawing.preview.structure.nodes
    spread = np.linalg.svd(x[mark.nodes] - x[mark.nodes].mean(axis=0), full_matrices=False)[2]
    # The two coordinates that the face spans best.
    plane = sorted(int(axis) for axis in np.argsort(np.abs(spread[2]))[:2])
    corners = 1e3 * x[mark.cells][..., plane]
    drawing.colour(panel, corners, 1e-6 * np.asarray(mark.pressure), 2.0)
    panel.set_aspect("equal")
    panel.autoscale_view()
    panel.set_xlabel(f"{'xyz'[plane[0]]}, mm")
    panel.set_ylabel(f"{'xyz'[plane[1]]}, mm")
    panel.set_title(mark.text.replace("\n", ", "), fontsize=10, color=colours.OF_KIND["joint"],
                    parse_math=False)  # fmt: skip
    low, high = corners.reshape(-1, 2).min(axis=0), corners.reshape(-1, 2).max(axis=0)
    colour = colours.OF_KIND["bolt"]
    for bolt in drawing.preview.of_kind("bolt"):
        place = 1e3 * bolt.at[plane]
        if np.all(place >= low) and np.all(place <= high):
            panel.scatter(*place, marker="+", s=80, color=colour, zorder=4)
            panel.annotate(bolt.text.split("\n")[0], place, xytext=(9, 14), fontsize=8,
                           textcoords="offset points", color=colour, zorder=5,
                           bbox={"boxstyle": "round,pad=0.1", "facecolor": "white",
                                 "edgecolor": "none", "alpha": 0.85})  # fmt: skip
