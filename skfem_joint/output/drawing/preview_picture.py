"""Picture of a preview: bars along their axis, plates in their plane, solids in space by pyvista.

All places are drawn in mm, also those that other parts of a solid hide. Labels stand in rows above,
in the order of the places that they point at.
"""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import needed
from skfem_joint.output.drawing.offscreen import drawn, offscreen, plotter_of
from skfem_joint.output.drawing.preview import Mark, Preview
from skfem_joint.output.plots import new_figure, save_figure
from skfem_joint.output.series import blocks_of
from skfem_joint.structure.structure import Structure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = {"joint": "#b35900", "support": "#1e7a34", "load": "#1f4fb4", "bolt": "#7a2f9e",
            "part": "#4a4f55"}  # fmt: skip
_BODIES = np.array(["#dfe3e8", "#c9d6e2", "#e4dccb", "#d3e0d1"])
#: Unit vectors of the picture of a solid: to the eye; to the right and upwards.
EYE, _PAPER = np.array([0.48, -0.64, 0.6]), np.array([[0.8, 0.6, 0.0], [-0.36, 0.48, 0.8]])
_WIDTH, _PER_ROW = 14.0, 7  # inches, labels


def write_preview(path: Path, preview: Preview) -> Path:
    """Draw a preview as a PNG, in place of what is there.

    InputError where it cannot be written, without matplotlib, and for solids without pyvista or a
    GL library.
    """
    return save_figure(path, preview_figure(preview))


def check_target(path: Path, *, overwrite: bool = False) -> None:
    """Refuse a path of another ending than ``.png``, or of a file that may not be replaced."""
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: found ending {path.suffix!r}, must be '.png'")
    if path.exists() and not overwrite:
        raise InputError(
            f"{path}: is there already and stays as it is; choose another file by --out, or give "
            "--overwrite"
        )


def preview_figure(preview: Preview) -> Figure:
    """Draw a preview.

    Raises
    ------
    InputError
        Without matplotlib, and for solids without pyvista or a GL library.
    """
    needed("matplotlib", "plot")
    from matplotlib import cm, colors

    structure, marks, notes = preview.structure, preview.marks, [*preview.notes]
    nodes, joints = on_paper(structure, structure.nodes), preview.of_kind("joint")
    if structure.dim == 1:
        nodes[:, 1] = structure.body.body_of_node
        notes.append("The thickness of bars is not to scale.")
    if preview.of_kind("load"):
        notes.append("Arrows show loads in their positive direction.")
    size = np.ptp(nodes, axis=0)
    slender = size[1] < 0.1 * size[0]
    if slender and structure.dim == 2:
        notes.append("Lengths along y are drawn larger than along x.")
    tall = 3.0 if slender else float(np.clip(12.0 * size[1] / size[0], 3.0, 9.0))
    rows = 1 + len(marks) // _PER_ROW
    height = tall + 0.65 * rows + 2.4
    figure = new_figure(_WIDTH, height, layout=None)
    panel = figure.add_axes((0.06, 1.6 / height, 0.88, tall / height))
    panel.margins(0.05, 0.5 if slender else 0.05)
    panel.set_aspect("auto" if slender else "equal", adjustable="datalim")
    along = "position along the bar, mm" if structure.dim == 1 else "x, mm"
    panel.set(xlabel=along, ylabel="y, mm")
    panel.yaxis.set_visible(structure.dim > 1)
    if structure.dim == 1:
        panel.set_ylim(-1.0, size[1] + 1.0)
    _draw_bodies(panel, structure, nodes)
    largest = max((float(np.asarray(mark.pressure).max()) for mark in joints), default=0.0)
    colours = colors.LinearSegmentedColormap.from_list("", ["#fff8e6", "#f6b04a", "#c24e00"])
    pressures = cm.ScalarMappable(colors.Normalize(0.0, 1e-6 * largest or 1.0), colours)
    if joints:
        scale = figure.add_axes((0.7, 0.4 / height, 0.26, 0.14 / height))
        figure.colorbar(pressures, scale, orientation="horizontal")
        scale.set_title("pressure on the joints, MPa", fontsize=9.5)
    places = [_draw_mark(panel, structure, nodes, mark, pressures) for mark in marks]
    for rank, k in enumerate(np.argsort([place[0] for place in places], kind="stable")):
        row = (tall + 1.75 + 0.65 * (rank % rows)) / height
        _label(
            panel, marks[k], places[k], (0.04 + 0.92 * (rank + 0.5) / len(marks), row), rank % rows
        )
    extent = " x ".join(f"{1e3 * x:.4g}" for x in np.ptp(structure.nodes, axis=0))
    kind = ("Bars", "Plates", "Solids")[structure.dim - 1]
    heading = f"{kind}, {extent} mm: {structure.overview()}"
    for y, text, points, weight in (
        (height - 0.33, preview.title, 14, "bold"),
        (height - 0.58, heading, 10, "normal"),
        (0.15, "\n".join(notes), 9, "normal"),
    ):
        figure.text(0.02, y / height, text, fontsize=points, weight=weight, parse_math=False)
    return figure


def on_paper(structure: Structure, x: FloatArray) -> FloatArray:
    """Points (k, dim), m, on the paper (k, 2), mm; solids are seen obliquely from above."""
    axes = _PAPER if structure.dim == 3 else np.eye(2, structure.dim)
    return np.asarray(1e3 * x @ axes.T)


def add_shapes(panel: Any, shapes: FloatArray, **how: Any) -> Any:
    """Add lines (k, 2, 2) or polygons (k, corners, 2) to a panel."""
    from matplotlib.collections import LineCollection, PolyCollection

    kind = LineCollection if shapes.shape[1] == 2 else PolyCollection
    return panel.add_collection(kind(list(shapes), **how))


def _border(cells: IntArray) -> IntArray:
    """Edges that belong to one cell alone, by node numbers, shape (edges, 2)."""
    edges = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]  # a triangle may be a collapsed quadrilateral
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return cells if cells.shape[1] == 2 else np.asarray(unique[count == 1], dtype=np.intp)


def _draw_bodies(panel: Any, structure: Structure, nodes: FloatArray) -> None:
    """Draw the elements; of solids an image, and the directions of the coordinates."""
    body = structure.body
    if structure.dim < 3:
        colours = _BODIES[structure.mesh.body[body.cell_element] % len(_BODIES)]
        how = {"facecolors": colours, "edgecolors": "#8a929b"} if structure.dim > 1 else {
            "colors": colours}  # fmt: skip
        add_shapes(panel, nodes[body.cells], linewidths=0.5 if structure.dim > 1 else 16.0, **how)
        return
    low, size = nodes.min(axis=0), np.ptp(nodes, axis=0)
    low, high = low - 0.05 * size.max(), low + size + 0.05 * size.max()
    panel.imshow(_image(structure, low, high), extent=(low[0], high[0], low[1], high[1]))
    panel.set_axis_off()
    for name, axis in zip("xyz", np.eye(3), strict=True):
        end = low + 0.08 * size.max() * (axis @ _PAPER.T)
        panel.annotate(name, low, end, arrowprops={"arrowstyle": "<-"}, annotation_clip=False)


def _image(structure: Structure, low: FloatArray, high: FloatArray) -> Any:
    """Image of solids between corners of the paper, mm."""
    low, high = 1e-3 * low, 1e-3 * high
    with offscreen():
        plotter = plotter_of(np.vstack([_PAPER, EYE]), low, high, np.max(high - low) / 1800.0)
        try:
            for block, colour in zip(blocks_of(structure), cycle(_BODIES), strict=False):
                surface = block.grid.extract_surface(algorithm="dataset_surface")
                plotter.add_mesh(surface, color=colour, show_edges=True, edge_color="#7d858e",
                                 ambient=0.55, diffuse=0.5)  # fmt: skip
            return drawn(plotter)
        finally:
            plotter.close()


def _draw_mark(
    panel: Any, structure: Structure, nodes: FloatArray, mark: Mark, pressures: Any
) -> FloatArray:
    """Draw a joint, support, bolt or load; return the place of its label."""
    colour, cells = _COLOURS[mark.kind], mark.cells
    place = on_paper(structure, mark.at) if mark.kind == "bolt" else nodes[mark.nodes[0]]
    if mark.pressure is not None:
        down = (0.0, 0.25 if structure.dim == 1 else 0.0)
        drawn = add_shapes(
            panel, nodes[cells] - down, cmap=pressures.cmap, norm=pressures.norm, alpha=0.8
        )
        drawn.set(array=1e-6 * np.mean(mark.pressure, axis=1), linewidth=7.0 if cells.shape[1] == 2
                  else 0.3, zorder=2)  # fmt: skip
    if len(cells) and structure.dim > 1:
        width = 1.8 if mark.pressure is not None or structure.dim == 3 else 4.0
        add_shapes(panel, nodes[_border(cells)], colors=colour, linewidths=width, zorder=3)
    elif mark.kind == "support":
        few = nodes[np.sort(mark.nodes)[:: 1 + len(mark.nodes) // 50]]
        panel.scatter(*few.T, marker="^", s=60, color=colour, edgecolors="white", zorder=6)
    for line in mark.lines:
        panel.plot(*on_paper(structure, line).T, color=colour, linewidth=1.5, zorder=6)
    if mark.direction is not None:
        along = on_paper(structure, mark.direction) / 1e3
        panel.quiver(*place, *along, color=colour, scale=12.0, width=0.004, zorder=8, clip_on=False)
    return place


def _label(panel: Any, mark: Mark, place: FloatArray, at: tuple[float, float], row: int) -> None:
    """Write a label at a place of the figure, with a line to what it names behind lower rows."""
    colour = _COLOURS[mark.kind]
    box = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.9}
    line = {"arrowstyle": "-", "color": colour, "linewidth": 0.7, "relpos": (0.5, 0.0)}
    panel.annotate(
        mark.text, place, at, textcoords="figure fraction", zorder=99 - row, annotation_clip=False,
        parse_math=False, ha="center", va="bottom", fontsize=9, color=colour, bbox=box,
        arrowprops=line,
    )  # fmt: skip
    panel.scatter(*place, s=14, color=colour, edgecolors="white", linewidths=0.6, zorder=99)
