"""Picture of mode shapes: bars over their axis, plates in their plane, solids obliquely.

It needs no GL library: faces of solids are drawn from the farthest to the nearest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.output.drawing.preview_picture import EYE, add_shapes, on_paper
from skfem_joint.output.plots import new_figure
from skfem_joint.structure.structure import Structure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Largest displacement that is drawn, over the length of the structure.
_DRAWN = 0.08


def shapes_figure(
    structure: Structure, moved: Sequence[FloatArray], titles: Sequence[str]
) -> Figure:
    """Draw displacements of all nodes, (N, dim) each, over the structure at rest."""
    figure = new_figure(10.5, 3.0 * len(moved))
    rest = structure.nodes
    for number, (u, title) in enumerate(zip(moved, titles, strict=True), start=1):
        panel = figure.add_subplot(len(moved), 1, number)
        panel.set_title(title, loc="left")
        size = np.linalg.norm(u, axis=1)
        if structure.dim == 1:
            order = np.argsort(rest[:, 0])
            panel.plot(1e3 * rest[order, 0], u[order, 0] / size.max())
            panel.set(xlabel="position along the bar, mm", ylabel="displacement over the largest")
            panel.grid(alpha=0.3)
            continue
        there = rest + _DRAWN * np.ptp(rest, axis=0).max() / size.max() * u
        faces, at_rest = _faces(structure, there), on_paper(structure, rest)
        add_shapes(panel, at_rest[faces], facecolors="none", edgecolors="#d5d8dc")
        look = {"edgecolors": "#8a929b", "linewidths": 0.3, "cmap": "viridis"}
        polygons = add_shapes(panel, on_paper(structure, there)[faces], **look)
        polygons.set_array(size[faces].mean(axis=1) / size.max())
        figure.colorbar(polygons, ax=panel, label="displacement over the largest")
        panel.set_aspect("equal", anchor="W")
        panel.autoscale_view()
        panel.set_axis_off()
    return figure


def _faces(structure: Structure, places: FloatArray) -> IntArray:
    """Cells of a plate, or faces of solids from the farthest to the nearest, (k, corners)."""
    if structure.dim == 2:
        return structure.body.cells
    mesh = structure.mesh.mesh
    faces = mesh.facets[:, mesh.boundary_facets()].T
    # Corners go around.
    flat = on_paper(structure, places)[faces]
    away = flat - flat.mean(axis=1, keepdims=True)
    turn = np.argsort(np.arctan2(away[..., 1], away[..., 0]), axis=1)
    faces = np.take_along_axis(faces, turn, axis=1)
    depth = places[faces].mean(axis=1) @ EYE
    return np.asarray(faces[np.argsort(depth)], dtype=np.intp)
