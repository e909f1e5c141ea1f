"""Elements of a preview's structure; solids as an image that pyvista makes."""

from __future__ import annotations

from typing import Any

import numpy as np

from skfem_joint.files import needed
from skfem_joint.output.offscreen import offscreen
from skfem_joint.output.preview import colours
from skfem_joint.output.preview.drawing import Drawing
from skfem_joint.output.preview.projection import border
from skfem_joint.output.series import blocks_of

_LIGHT = {"ambient": 0.55, "diffuse": 0.5, "lighting": True}


def draw_bodies(drawing: Drawing) -> None:
    """Draw the elements."""
    from matplotlib.collections import PolyCollection

    reach, projection, panel = drawing.reach, drawing.projection, drawing.panel
    if drawing.dim == 3:
        panel.imshow(
            _solids(drawing), extent=(reach.low[0], reach.high[0], reach.low[1], reach.high[1]),
            aspect="auto", zorder=1,
        )  # fmt: skip
        return
    structure = drawing.preview.structure
    cells, body = structure.body.cells, structure.mesh.body[structure.body.cell_element]
    if drawing.dim == 1:
        lower, upper = projection.nodes(cells, -0.5), projection.nodes(cells, 0.5)
        shapes = np.concatenate([lower, upper[:, ::-1]], axis=1)
    else:
        shapes = projection.nodes(cells)
    edges = "#8a929b" if drawing.edges_shown else "none"
    panel.add_collection(
        PolyCollection(list(shapes), facecolors=[colours.of_body(number) for number in body],
                       edgecolors=edges, linewidths=0.4, alpha=0.75, zorder=1)
    )  # fmt: skip
    if drawing.dim == 2:
        for number in range(int(body.max()) + 1):
            ends = projection.nodes(border(cells[body == number]))
            drawing.lines(ends, "#2b2f33", 0.9, zorder=2)


def _solids(drawing: Drawing) -> Any:
    """Image of the solids with their named surfaces, of the size of the frame."""
    pyvista = needed("pyvista", "vtk")
    structure, reach = drawing.preview.structure, drawing.reach
    size = (160.0 * reach.frame).round().astype(int)
    height, eye = 1e-3 * (reach.high - reach.low)[1], drawing.projection.eye
    middle = 0.5e-3 * (reach.low + reach.high) @ drawing.projection.axes
    far = 10.0 * structure.body.size
    with offscreen():
        plotter = pyvista.Plotter(off_screen=True, window_size=size.tolist(), border=False)
        try:
            plotter.set_background("white")
            for number, block in enumerate(blocks_of(structure)):
                surface = block.grid.extract_surface(algorithm="dataset_surface")
                plotter.add_mesh(
                    surface, color=colours.of_body(number), show_edges=drawing.edges_shown,
                    edge_color="#7d858e", line_width=1, **_LIGHT,
                )  # fmt: skip
            for mark in drawing.preview.marks:
                if mark.kind in ("support", "bolt") and len(mark.cells):
                    corners = mark.cells.shape[1]
                    faces = np.pad(mark.cells, ((0, 0), (1, 0)), constant_values=corners)
                    surface = pyvista.PolyData(structure.positions, faces.ravel())
                    actor = plotter.add_mesh(
                        surface, color=colours.OF_KIND[mark.kind], opacity=0.6, **_LIGHT
                    )
                    # Three pixels nearer than the surface that it is part of.
                    actor.position = 3.0 * height / size[1] * eye
            plotter.camera.parallel_projection = True
            plotter.camera.focal_point = middle
            plotter.camera.position = middle + far * eye
            plotter.camera.up = drawing.projection.axes[1]
            plotter.camera.parallel_scale = 0.5 * height
            plotter.camera.clipping_range = (0.1 * far, 10.0 * far)
            return plotter.screenshot(return_img=True)
        finally:
            plotter.close()
