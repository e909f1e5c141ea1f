"""Picture of a preview: bars along their axis, plates in their plane, solids in space by pyvista.

From below: notes, legend, the faces of joints of solids, the drawing in mm, and its labels, each
above its place in the lowest row in which it finds room.
"""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.files import needed
from skfem_joint.output.offscreen import offscreen
from skfem_joint.output.plots import new_figure, save_figure
from skfem_joint.output.preview import Mark, Preview
from skfem_joint.output.series import blocks_of, stack_heights

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = {"joint": "#b35900", "support": "#1e7a34", "load": "#1f4fb4", "bolt": "#7a2f9e",
            "part": "#4a4f55"}  # fmt: skip
_BODIES = np.array(["#dfe3e8", "#c9d6e2", "#e4dccb", "#d3e0d1"])
#: Width of the picture, what panels keep from its sides, and heights of a row of two faces and of
#: a row of labels, inches.
_WIDTH, _MARGIN, _FACE, _ROW = 14.0, 0.75, 2.75, 0.62


def write_preview(path: str | Path, preview: Preview, *, overwrite: bool = False) -> Path:
    """Draw a preview as a PNG.

    Parameters
    ----------
    path : str or Path
        File that ends in ``.png``, in a folder that exists.
    preview : Preview
    overwrite : bool
        Whether a file of this name may be replaced.

    Raises
    ------
    InputError
        For another ending, a file that is there already or cannot be written, without matplotlib,
        and for solids without pyvista or a GL library.
    """
    check_target(path := Path(path), overwrite=overwrite)
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
    view = _View(preview)
    joints = preview.of_kind("joint")
    faces = joints if view.dim == 3 else ()
    bottom = 1.4 + _FACE * -(-len(faces) // 2)
    left, top = 0.5 * (_WIDTH - view.frame[0]), bottom + view.frame[1] + 0.3
    middles, rows = _label_places(view, left)
    height = top + _ROW * (1 + max(rows, default=0)) + 0.7
    figure = new_figure(_WIDTH, height, layout=None)

    def panel_at(x: float, y: float, wide: float, tall: float) -> Any:
        return figure.add_axes((x / _WIDTH, y / height, wide / _WIDTH, tall / height))

    panel = panel_at(left, bottom, *view.frame)
    panel.set(xlim=(view.low[0], view.high[0]), ylim=(view.low[1], view.high[1]))
    _draw_bodies(view, panel)
    for mark, x, row in zip(preview.marks, middles, rows, strict=True):
        _draw_mark(view, panel, mark)
        _label(panel, mark, view.anchor(mark), (x / _WIDTH, (top + _ROW * row) / height), row)
    for number, mark in enumerate(faces):
        row, column = divmod(number, 2)
        x = 0.5 * _WIDTH * column if len(faces) > 1 else 0.25 * _WIDTH
        _draw_face(view, panel_at(x + _MARGIN, bottom - 2.5 - _FACE * row, 5.5, 1.75), mark)
    if joints:
        scale = panel_at(9.7, 0.3, 3.6, 0.14)
        figure.colorbar(view.pressures, scale, orientation="horizontal")
        scale.set_title("pressure on the joints, MPa", fontsize=9.5)
    kind = ("Bars", "Plates", "Solids")[view.dim - 1]
    for y, text, size, weight in (
        (height - 0.33, preview.title, 14, "bold"),
        (height - 0.58, f"{kind}: {view.structure.overview()}", 10, "normal"),
        (0.15, "\n".join(view.notes()), 9, "normal"),
    ):
        figure.text(0.02, y / height, text, fontsize=size, weight=weight, parse_math=False)
    return figure


class _View:
    """Coordinates of a drawing, mm: of a bar along its axis, of a solid seen obliquely from above.

    Attributes
    ----------
    nodes : ndarray, shape (n_nodes, 2)
    thick : float
        Thickness of bars, mm.
    scale : ndarray, shape (2,)
        How much larger y is drawn than x, in slender plates seen from the side.
    size : float
        Larger side of the structure, mm.
    low, high : ndarray, shape (2,)
        Least and largest coordinates with space around the structure and its arrows, mm.
    frame : ndarray, shape (2,)
        Width and height on the paper, inches.
    pressures : matplotlib.cm.ScalarMappable
        Colours of the pressures of all joints, MPa.
    edge : float
        Width of lines between elements; 0 if these are too small for lines.
    """

    def __init__(self, preview: Preview) -> None:
        self.preview, self.structure = preview, preview.structure
        self.dim, self.axes = self.structure.dim, np.eye(2, self.structure.dim)
        if self.dim == 3:
            self.eye = np.array([0.45, -0.75, 0.55]) / np.linalg.norm([0.45, -0.75, 0.55])
            across = np.cross([0.0, 0.0, 1.0], self.eye) / np.hypot(*self.eye[:2])
            self.axes = np.array([across, np.cross(self.eye, across)])
        body, self.thick = self.structure.body, 0.0
        self.nodes = self.points(self.structure.nodes)
        if self.dim == 1:
            self.thick = 1e3 * float(body.properties["thickness"].max())
            self.nodes[:, 1] = 1e3 * stack_heights(self.structure)[body.body_of_node]
        wide, tall = np.ptp(self.nodes, axis=0)
        enlarged = [k for k in (5, 10, 20, 50, 100) if self.dim == 2 and k * tall <= 0.09 * wide]
        self.scale, self.size = np.array([1, max(enlarged, default=1)]), max(wide, tall)
        arrows = [end for mark in preview.of_kind("load") for end in self.arrow(mark)]
        shown = np.vstack([self.nodes, *arrows])
        pad = (0.06 if self.dim == 3 else 0.03) * self.size / self.scale
        pad = np.array([pad[0], self.thick]) if self.dim == 1 else pad
        self.low, self.high = shown.min(axis=0) - pad, shown.max(axis=0) + pad
        frame = (self.high - self.low) * self.scale
        fits = (_WIDTH - 2 * _MARGIN) / frame[0], np.inf if self.dim == 1 else 5.5 / frame[1]
        self.frame = frame * min(fits)
        if self.dim == 1:
            self.frame[1] = 0.5 + 0.9 * np.unique(self.nodes[:, 1]).size
        at_joints = [np.max(np.asarray(mark.pressure)) for mark in preview.of_kind("joint")]
        self.pressures = _scale_of_pressures(1e-6 * max(at_joints, default=1.0))
        area = self.frame[0] * (self.frame[1] if self.dim > 1 else 0.05)
        self.edge = 0.4 if len(body.cells) <= 4000.0 * area else 0.0

    def points(self, x: FloatArray) -> FloatArray:
        """Points (..., dim), m, in the drawing."""
        return np.asarray(1e3 * x @ self.axes.T)

    def place(self, mark: Mark) -> FloatArray:
        """Place of a mark; of a joint of bars it is at their lower side."""
        if mark.nodes.size and mark.kind != "bolt":
            down = 0.5 * self.thick * (mark.kind == "joint")
            return np.asarray(self.nodes[mark.nodes[0]] - (0.0, down))
        return self.points(mark.at)

    def arrow(self, mark: Mark) -> tuple[FloatArray, FloatArray]:
        """Start and end of a load's arrow; it ends at the body where it pushes on it."""
        at = self.place(mark)
        step = 0.09 * self.size * (np.asarray(mark.direction) @ self.axes.T) / self.scale
        outwards = at - 0.5 * (self.nodes.min(axis=0) + self.nodes.max(axis=0))
        return (at - step, at) if step @ outwards < -1e-9 * self.size**2 else (at, at + step)

    def anchor(self, mark: Mark) -> FloatArray:
        """Place that a label points at: of a load the middle of its arrow."""
        ends = self.arrow(mark) if mark.kind == "load" else [self.place(mark)]
        return np.asarray(np.mean(ends, axis=0))

    def notes(self) -> list[str]:
        """Sentences on what the picture leaves out and what is not to scale."""
        scale = f"Lengths along y are drawn {self.scale[1]} times as large."
        notes = {
            "The thickness of bars is not to scale.": self.dim == 1,
            "Dashed outlines mark surfaces, also where other parts hide them.": self.dim == 3,
            scale: self.scale[1] > 1,
            "The mesh is too fine for this picture: its edges are left out.": not self.edge,
            "Arrows show loads in their positive direction.": bool(self.preview.of_kind("load")),
        }
        return [*self.preview.notes, *(note for note, holds in notes.items() if holds)]


def _scale_of_pressures(largest: float) -> Any:
    """Colours from 0 to the largest pressure."""
    from matplotlib import cm, colors

    colours = colors.LinearSegmentedColormap.from_list("", ["#fff8e6", "#f6b04a", "#c24e00"])
    return cm.ScalarMappable(colors.Normalize(0.0, largest or 1.0), colours)


def _label_places(view: _View, left: float) -> tuple[FloatArray, IntArray]:
    """Middles of the labels on the paper, inches, and their rows, the lowest that have room."""
    marks = view.preview.marks
    inch = view.frame[0] / (view.high - view.low)[0]
    middles = np.array([left + inch * (view.anchor(mark) - view.low)[0] for mark in marks])
    half = np.array([0.12 + 0.04 * max(map(len, mark.text.split("\n"))) for mark in marks])
    middles, rows = np.clip(middles, half, _WIDTH - half), np.zeros(len(marks), np.intp)
    ends: list[float] = []
    for k in np.argsort(middles, kind="stable"):
        least = np.array([*ends, -np.inf]) + half[k]  # a label moves by at most 0.7
        rows[k] = np.argmax((least <= middles[k] + 0.7) & (least + half[k] <= _WIDTH))
        middles[k] = max(middles[k], least[rows[k]])
        ends[rows[k] : rows[k] + 1] = [middles[k] + half[k]]
    return middles, rows


def _label(panel: Any, mark: Mark, place: FloatArray, at: tuple[float, float], row: int) -> None:
    """Write a label at a place of the figure, with a line to what it names behind lower rows."""
    from matplotlib.patheffects import withStroke

    colour = _COLOURS[mark.kind]
    box = {"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.9}
    line = {"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkA": 0.0, "shrinkB": 0.0,
            "relpos": (0.5, 0.0)}  # fmt: skip
    text = panel.annotate(
        mark.text, place, at, textcoords="figure fraction", zorder=99 - row, annotation_clip=False,
        parse_math=False, ha="center", va="bottom", fontsize=9, color=colour, bbox=box,
        arrowprops=line,
    )  # fmt: skip
    text.arrow_patch.set_path_effects([withStroke(linewidth=2.2, foreground="white", alpha=0.75)])
    panel.scatter(*place, s=14, color=colour, edgecolors="white", linewidths=0.6, zorder=99)


def _add(panel: Any, shapes: FloatArray, **how: Any) -> Any:
    """Add lines (k, 2, 2) or polygons (k, corners, 2) to a panel."""
    from matplotlib.collections import LineCollection, PolyCollection

    kind = LineCollection if shapes.shape[1] == 2 else PolyCollection
    return panel.add_collection(kind(list(shapes), **how))


def _border(cells: IntArray) -> IntArray:
    """Edges that belong to one cell alone, by node numbers, shape (edges, 2)."""
    edges = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return cells if cells.shape[1] == 2 else np.asarray(unique[count == 1], dtype=np.intp)


def _draw_bodies(view: _View, panel: Any) -> None:
    """Draw the elements and the scales in mm."""
    if view.dim == 3:
        panel.set_axis_off()
        reach = (view.low[0], view.high[0], view.low[1], view.high[1])
        panel.imshow(_image(view), extent=reach, aspect="auto")
        _draw_rulers(view, panel)
        return
    structure = view.structure
    cells, body = structure.body.cells, structure.mesh.body[structure.body.cell_element]
    shapes = view.nodes[cells]
    if view.dim == 1:
        half = np.array([0.0, 0.5 * view.thick])
        shapes = np.concatenate([shapes - half, shapes[:, ::-1] + half], axis=1)
    _add(panel, shapes, facecolors=_BODIES[body % len(_BODIES)], edgecolors="#8a929b",
         linewidths=view.edge, alpha=0.75)  # fmt: skip
    for number in range(int(body.max()) + 1 if view.dim == 2 else 0):
        _add(panel, view.nodes[_border(cells[body == number])], colors="#2b2f33", lw=0.9, zorder=2)
    panel.spines[["top", "right"]].set_visible(False)
    panel.set(xlabel="position along the bar, mm" if view.dim == 1 else "x, mm", ylabel="y, mm")
    panel.locator_params(axis="y", nbins=max(2, int(view.frame[1] / 0.3)))
    if view.dim == 1:
        panel.yaxis.set_visible(False)
        panel.spines["left"].set_visible(False)


def _draw_rulers(view: _View, panel: Any) -> None:
    """Draw lines along three edges of the bounding box with the coordinates of their ends."""
    low, high = view.structure.nodes.min(axis=0), view.structure.nodes.max(axis=0)
    centre = view.points(0.5 * (low + high))
    for axis, start in enumerate((low, np.array([high[0], low[1], low[2]]), low)):
        end = np.where(np.arange(3) == axis, high, start)
        ends = view.points(np.array([start, end]))
        away = np.array([-1.0, 1.0]) * (ends[1] - ends[0])[::-1] / np.linalg.norm(ends[1] - ends[0])
        away *= 0.035 * view.size * np.sign(away @ (ends.mean(axis=0) - centre))
        panel.plot(*(ends + 0.3 * away).T, color="black", linewidth=1.0, marker="o", markersize=3)
        names = (f"{1e3 * low[axis]:g}", f"{'xyz'[axis]}, mm", f"{1e3 * high[axis]:g}")
        for place, name in zip((ends[0], ends.mean(axis=0), ends[1]), names, strict=True):
            panel.text(*(place + away), name, ha="center", va="center", fontsize=9)


def _image(view: _View) -> Any:
    """Image of solids with their named surfaces, of the size of the frame."""
    pyvista = needed("pyvista", "vtk")
    structure, middle = view.structure, 0.5 * (view.low + view.high) @ view.axes
    light = {"ambient": 0.55, "diffuse": 0.5}
    with offscreen():
        size = (160.0 * view.frame).round().astype(int).tolist()
        plotter = pyvista.Plotter(off_screen=True, window_size=size, border=False)
        try:
            for block, colour in zip(blocks_of(structure), cycle(_BODIES), strict=False):
                surface = block.grid.scale(1e3).extract_surface(algorithm="dataset_surface")
                plotter.add_mesh(surface, color=colour, show_edges=view.edge > 0.0,
                                 edge_color="#7d858e", **light)  # fmt: skip
            for mark in view.preview.marks:
                if mark.kind in ("support", "bolt") and len(mark.cells):
                    surface = pyvista.PolyData.from_regular_faces(1e3 * structure.nodes, mark.cells)
                    colour = _COLOURS[mark.kind]
                    actor = plotter.add_mesh(surface, color=colour, opacity=0.6, **light)
                    actor.position = 0.003 * view.size * view.eye  # nearer than what it lies on
            plotter.enable_parallel_projection()
            eye, up = middle + 10.0 * view.size * view.eye, (0.0, 0.0, 1.0)
            plotter.camera_position = [eye, middle, up]
            plotter.camera.parallel_scale = 0.5 * (view.high - view.low)[1]
            plotter.reset_camera_clipping_range()
            return plotter.screenshot(return_img=True)
        finally:
            plotter.close()


def _draw_mark(view: _View, panel: Any, mark: Mark) -> None:
    """Draw a joint, support, bolt or load."""
    colour, cells = _COLOURS[mark.kind], mark.cells
    if view.dim > 1 and len(cells):
        width = 1.8 if cells.shape[1] > 2 else 9.0 if mark.kind == "joint" else 4.0
        style = (0, (3, 2)) if view.dim == 3 else "-"
        _add(panel, view.nodes[_border(cells)], colors=colour, linewidths=width, linestyles=style)
    if mark.kind == "joint" and view.dim < 3:
        shapes = view.nodes[cells] - (0.0, 0.5 * view.thick)
        _draw_pressure(view, panel, mark, shapes)
        if view.dim == 1 and "\non a rigid base\n" in mark.text:
            x, y = shapes.reshape(-1, 2).T
            panel.fill_between([x.min(), x.max()], y.min(), y.min() - 0.3 * view.thick, linewidth=0,
                               facecolor="white", edgecolor="#6d747b", hatch="////")  # fmt: skip
    elif mark.kind == "support" and view.dim == 1:
        x, y = view.nodes[mark.nodes].T
        panel.vlines(x, y - 0.65 * view.thick, y + 0.65 * view.thick, color=colour, lw=5.0)
    elif mark.kind == "support" and (view.dim == 2 or not len(cells)):
        nodes = view.nodes[np.sort(mark.nodes)[:: 1 + len(mark.nodes) // 50]]
        panel.scatter(*nodes.T, marker="^", s=36, color=colour, edgecolors="white", zorder=6)
    elif mark.kind == "bolt":
        for line in mark.lines:
            panel.plot(*view.points(line).T, color=colour, linewidth=1.5, zorder=6)
        panel.scatter(*view.points(mark.at), marker="+", s=90, color=colour, zorder=6)
    elif mark.kind == "load":
        start, end = view.arrow(mark)
        arrow = {"arrowstyle": "-|>,head_length=0.8,head_width=0.35", "linewidth": 3.0,
                 "shrinkA": 0.0, "shrinkB": 0.0, "color": colour}  # fmt: skip
        panel.annotate("", end, start, zorder=8, annotation_clip=False, arrowprops=arrow)
        if np.linalg.norm((end - start) * view.scale) < 0.015 * view.size:  # along the view
            panel.scatter(*start, s=160, facecolors="white", edgecolors=colour, zorder=9)


def _draw_pressure(view: _View, panel: Any, mark: Mark, shapes: FloatArray) -> None:
    """Colour the cells of a joint, with corners (c, corners, 2) in mm, by their pressure."""
    drawn = _add(panel, shapes, cmap=view.pressures.cmap, norm=view.pressures.norm)
    drawn.set_array(1e-6 * np.mean(np.asarray(mark.pressure), axis=1))
    if shapes.shape[1] == 2:
        drawn.set(linewidth=7.0, zorder=3)
    else:
        drawn.set(linewidth=0.6 * view.edge, edgecolor="#6b5a45")


def _draw_face(view: _View, panel: Any, mark: Mark) -> None:
    """Draw the pressure on a joint's face and the bolts that pass through it."""
    corners, x = view.structure.nodes[mark.cells], view.structure.nodes[mark.nodes]
    normal = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)[2][2]
    i, j = np.sort(np.argsort(np.abs(normal))[:2])  # coordinates that the face spans best
    _draw_pressure(view, panel, mark, 1e3 * corners[..., [i, j]])
    panel.set_aspect("equal")
    panel.autoscale_view()
    panel.set(xlabel=f"{'xyz'[i]}, mm", ylabel=f"{'xyz'[j]}, mm")
    panel.set_title(mark.text.replace("\n", ", "), fontsize=10, color=_COLOURS["joint"],
                    parse_math=False)  # fmt: skip
    for bolt in view.preview.of_kind("bolt"):
        if panel.viewLim.contains(*(at := 1e3 * bolt.at[[i, j]])):
            panel.scatter(*at, marker="+", s=80, color=_COLOURS["bolt"])
            panel.annotate(bolt.text.split("\n")[0], at, (9, 14), color=_COLOURS["bolt"],
                           textcoords="offset points", fontsize=8,
                           bbox={"facecolor": "white", "edgecolor": "none", "pad": 1})  # fmt: skip
