"""Picture of a structure before it is run: mesh, names, supports, loads, joints and bolts.

`preview_of` collects what a scene describes as marks, `preview_figure` draws them. A bar is drawn
along its axis with its thickness enlarged, a plate in the plane of its mesh, a solid in space by
pyvista with each joint's face below it. Labels stand above the drawing, with lines to their places.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.files import needed
from skfem_joint.output.offscreen import offscreen
from skfem_joint.output.plots import new_figure, save_figure
from skfem_joint.output.preview_marks import Mark, Preview, preview_of
from skfem_joint.output.series import blocks_of, stack_heights
from skfem_joint.structure import Structure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Mark", "Preview", "check_target", "preview_figure", "preview_of", "write_preview"]

#: Colours of the kinds of marks.
COLOURS = {
    "joint": "#b35900",
    "support": "#1e7a34",
    "load": "#1f4fb4",
    "bolt": "#7a2f9e",
    "part": "#4a4f55",
}
_BODIES = ("#dfe3e8", "#c9d6e2", "#e4dccb", "#d3e0d1")
_PRESSURES = ("#fff8e6", "#f6b04a", "#c24e00")
#: Height over length of a plate below which its height is enlarged.
_SLENDER = 0.03
#: Faces of joints of solids that have a panel of their own, at most.
_MOST_FACES = 6


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


class _Projection:
    """Coordinates in the drawing, mm, of nodes, points and directions of a structure."""

    def __init__(self, structure: Structure) -> None:
        self.structure, self.dim = structure, structure.dim
        eye = np.array([0.45, -0.75, 0.55]) if self.dim == 3 else np.array([0.0, 0.0, 1.0])
        self.eye = eye / np.linalg.norm(eye)
        across = np.cross([0.0, 0.0, 1.0], self.eye) if self.dim == 3 else np.array([1.0, 0.0, 0.0])
        across = across / np.linalg.norm(across)
        self.axes = np.array([across, np.cross(self.eye, across)])
        wide, tall = np.ptp(structure.nodes, axis=0) if self.dim == 2 else (1.0, 1.0)
        self.enlarged = 1  # how much larger y is drawn than x, for plates seen from the side
        if tall < _SLENDER * wide:
            fits = [k for k in (2, 5, 10, 20, 50, 100) if k * tall <= 3.0 * _SLENDER * wide]
            self.enlarged = max(fits)
        self.heights = stack_heights(structure) if self.dim == 1 else np.zeros(1)

    def points(self, x: FloatArray, height: float = 0.0) -> FloatArray:
        """Points (..., dim), m; those of a bar at a height."""
        if self.dim == 1:
            return np.asarray(1e3 * np.concatenate([x, np.full_like(x, height)], axis=-1))
        return np.asarray(1e3 * (x @ self.axes[:, : self.dim].T)) * (1.0, self.enlarged)

    def nodes(self, numbers: IntArray, side: float = 0.0) -> FloatArray:
        """Nodes; of a bar at the height of its body, ``side`` thicknesses of the bar above it."""
        out = self.points(self.structure.nodes[numbers])
        if self.dim == 1:
            thick = float(self.structure.body.properties["thickness"].max())
            body = self.structure.body.body_of_node[numbers]
            out[..., 1] = 1e3 * (self.heights[body] + side * thick)
        return out

    def direction(self, vector: FloatArray) -> FloatArray:
        """Direction in the drawing, of a length of at most 1."""
        return np.asarray(self.points(vector) / 1e3) / (1.0, self.enlarged)

    def place(self, mark: Mark) -> FloatArray:
        """Place of a mark's label."""
        if self.dim == 1 and mark.nodes.size:
            near = np.argmin(np.abs(self.structure.nodes[mark.nodes, 0] - mark.at[0]))
            side = -0.5 if mark.kind == "joint" else 0.0
            return np.asarray(self.nodes(mark.nodes[[near]], side)[0])
        return self.points(mark.at)


def _border(cells: IntArray) -> IntArray:
    """Edges that belong to one cell alone, by node numbers, shape (edges, 2)."""
    if cells.shape[1] == 2:
        return cells
    edges = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(unique[count == 1], dtype=np.intp)


def _arrow(projection: _Projection, mark: Mark, length: float) -> tuple[FloatArray, FloatArray]:
    """Start and end of a load's arrow; it ends at the body where it pushes on it."""
    at, along = projection.place(mark), projection.direction(np.asarray(mark.direction))
    nodes = projection.nodes(np.arange(projection.structure.n_nodes))
    outwards = at - 0.5 * (nodes.min(axis=0) + nodes.max(axis=0))
    step = length * along
    return (at - step, at) if along @ outwards < -1e-9 * length else (at, at + step)


def _placed(
    wanted: FloatArray, widths: FloatArray, lines: Sequence[int], width: float
) -> tuple[FloatArray, IntArray, list[float]]:
    """Middles (inches) and rows of labels that do not overlap, and the height of each row.

    ``wanted`` are the best middles, ``lines`` the numbers of lines.
    """
    rows = int(np.ceil(widths.sum() / (0.9 * width))) or 1
    while True:
        row, middle = np.zeros(len(wanted), np.intp), wanted.copy()
        order = np.argsort(wanted, kind="stable")
        row[order] = np.arange(len(wanted)) % rows
        fits = True
        for number in range(rows):
            own = order[row[order] == number]
            fits &= bool(widths[own].sum() <= width)
            middle[own] = _side_by_side(wanted[own], widths[own], width)
        if fits or rows >= len(wanted):
            break
        rows += 1
    heights = [0.17 * max([lines[int(k)] for k in np.flatnonzero(row == r)], default=0) + 0.14
               for r in range(rows)]  # fmt: skip
    return middle, row, heights


def _side_by_side(wanted: FloatArray, widths: FloatArray, width: float) -> FloatArray:
    """Middles of labels of given widths in a row, as near to the ascending wanted ones as fits."""
    before = np.cumsum(widths) - 0.5 * widths  # of labels that stand edge to edge
    groups: list[tuple[float, int]] = []  # mean of the shifts of a group of neighbours, and size
    for shift in wanted - before:
        mean, size = float(shift), 1
        while groups and groups[-1][0] > mean:
            other, count = groups.pop()
            mean, size = (size * mean + count * other) / (size + count), size + count
        groups.append((mean, size))
    shifts = np.repeat([mean for mean, _ in groups], [size for _, size in groups])
    return np.asarray(before + np.clip(shifts, 0.0, max(width - widths.sum(), 0.0)))


def preview_figure(preview: Preview) -> Figure:
    """Draw a preview.

    Raises
    ------
    InputError
        Without matplotlib, and for solids without pyvista or a GL library.
    """
    needed("matplotlib", "plot")
    return _Sheet(preview).figure


def _colours() -> Any:
    """Colours of the pressures, from none to the largest."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("pressures", _PRESSURES)


class _Sheet:
    """The figure of a preview, with lengths in inches from its lower left corner."""

    WIDTH, MARGIN = 14.0, 0.75

    def __init__(self, preview: Preview) -> None:
        self.preview, self.structure = preview, preview.structure
        self.projection = projection = _Projection(self.structure)
        self.dim = self.structure.dim
        nodes = projection.nodes(np.arange(self.structure.n_nodes))
        self.size = float(np.ptp(nodes, axis=0).max())
        self.arrows = {
            id(mark): _arrow(projection, mark, 0.09 * self.size) for mark in preview.of_kind("load")
        }
        self.low, self.high = self._reach(nodes)
        room = self.WIDTH - 2 * self.MARGIN
        wide, tall = self.high - self.low
        if self.dim == 1:
            self.frame = np.array([room, 0.5 + 0.9 * self.projection.heights.size])
        else:
            self.frame = np.array([wide, tall]) * min(room / wide, 5.5 / tall)
        self._arrange_labels()
        joints = preview.of_kind("joint") if self.dim == 3 else ()
        self.faces = joints[:_MOST_FACES]
        self.bottom = 1.05 + 0.2 * len(self._notes())
        below = 2.75 * int(np.ceil(len(self.faces) / 2))
        self.frame_bottom = self.bottom + below + 0.6
        labels_bottom = self.frame_bottom + self.frame[1] + 0.3
        self.height = labels_bottom + sum(self.row_heights) + 0.75
        self.row_bottoms = labels_bottom + np.cumsum([0.0, *self.row_heights])
        self.figure = new_figure(self.WIDTH, self.height, layout=None)
        self.norm = self._norm()
        left = 0.5 * (self.WIDTH - self.frame[0])
        self.main = self._axes(left, self.frame_bottom, *self.frame)
        self.main.set_xlim(self.low[0], self.high[0])
        self.main.set_ylim(self.low[1], self.high[1])
        self._draw_bodies()
        self._draw_marks()
        self._draw_scale()
        self._draw_labels(left)
        for number, mark in enumerate(self.faces):
            self._draw_face(number, mark)
        self._draw_words()

    def _axes(self, left: float, bottom: float, wide: float, tall: float) -> Any:
        """Panel at a place in inches."""
        box = (left / self.WIDTH, bottom / self.height, wide / self.WIDTH, tall / self.height)
        return self.figure.add_axes(box)

    def _reach(self, nodes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Least and largest coordinates of the drawing, with room around it."""
        shown = [nodes, *(np.array(ends) for ends in self.arrows.values())]
        if self.dim == 1:
            thick = 1e3 * float(self.structure.body.properties["thickness"].max())
            shown.append(
                np.vstack([nodes - (0.0, 1.1 * thick), nodes + np.array((0.0, 0.9 * thick))])
            )
        points = np.concatenate(shown)
        low, high = points.min(axis=0), points.max(axis=0)
        pad = 0.03 * self.size * np.array([1.0, 0.0 if self.dim == 1 else 1.0])
        return low - pad, high + pad

    def _norm(self) -> Any:
        """Scale of the pressures of all joints, from 0, MPa."""
        from matplotlib.colors import Normalize

        joints = self.preview.of_kind("joint")
        top = max((float(np.max(np.asarray(mark.pressure))) for mark in joints), default=0.0)
        return Normalize(0.0, 1e-6 * top or 1.0)

    def _fine(self) -> bool:
        """Whether elements are too small in the drawing for their edges."""
        area = self.frame[0] * (self.frame[1] if self.dim > 1 else 0.05)
        return bool(len(self.structure.body.cells) > 4000.0 * area)

    def _notes(self) -> list[str]:
        notes = list(self.preview.notes)
        if self.dim == 1:
            notes.append("The thickness of bars is not to scale.")
        if self.dim == 3:
            notes.append("Dashed outlines mark surfaces, also where other parts hide them.")
        if self.projection.enlarged > 1:
            notes.append(f"Lengths along y are drawn {self.projection.enlarged} times as large.")
        left = len(self.preview.of_kind("joint")) - len(self.faces) if self.dim == 3 else 0
        if left:
            notes.append(f"The faces of {left} further joints are not drawn below.")
        if self._fine():
            notes.append("The mesh is too fine for this picture: its edges are left out.")
        return notes

    def _draw_bodies(self) -> None:
        """Draw the elements."""
        from matplotlib.collections import PolyCollection

        if self.dim == 3:
            self.main.imshow(
                self._solid(), extent=(self.low[0], self.high[0], self.low[1], self.high[1]),
                aspect="auto", zorder=1,
            )  # fmt: skip
            return
        body, mesh = self.structure.body, self.structure.mesh
        cells = body.cells
        if self.dim == 1:
            lower, upper = self.projection.nodes(cells, -0.5), self.projection.nodes(cells, 0.5)
            shapes = np.concatenate([lower, upper[:, ::-1]], axis=1)
        else:
            shapes = self.projection.nodes(cells)
        colours = [_BODIES[number % len(_BODIES)] for number in mesh.body[body.cell_element]]
        edges = "none" if self._fine() else "#8a929b"
        self.main.add_collection(
            PolyCollection(list(shapes), facecolors=colours, edgecolors=edges, linewidths=0.4,
                           alpha=0.75, zorder=1)
        )  # fmt: skip
        if self.dim == 2:
            for number in range(int(mesh.body.max()) + 1):
                own = cells[mesh.body[body.cell_element] == number]
                self._lines(self.projection.nodes(_border(own)), "#2b2f33", 0.9, zorder=2)

    def _lines(self, ends: FloatArray, colour: str, width: float, **more: Any) -> None:
        """Draw line segments (k, 2, 2)."""
        from matplotlib.collections import LineCollection

        self.main.add_collection(
            LineCollection(list(ends), colors=colour, linewidths=width, **more)
        )

    def _solid(self) -> Any:
        """Image of the solids with their named surfaces, of the size of the frame."""
        pyvista = needed("pyvista", "vtk")
        size = (160.0 * self.frame).round().astype(int)
        middle = 0.5e-3 * (self.low + self.high) @ self.projection.axes
        eye, pixel = self.projection.eye, 1e-3 * (self.high - self.low)[1] / size[1]
        far = 10.0 * self.structure.body.size
        with offscreen():
            plotter = pyvista.Plotter(off_screen=True, window_size=size.tolist(), border=False)
            try:
                plotter.set_background("white")
                light = {"ambient": 0.55, "diffuse": 0.5, "lighting": True}
                for number, block in enumerate(blocks_of(self.structure)):
                    surface = block.grid.extract_surface(algorithm="dataset_surface")
                    plotter.add_mesh(
                        surface, color=_BODIES[number % len(_BODIES)], show_edges=not self._fine(),
                        edge_color="#7d858e", line_width=1, **light,
                    )  # fmt: skip
                for mark in self.preview.marks:
                    if mark.kind in ("support", "bolt") and len(mark.cells):
                        faces = np.pad(mark.cells, ((0, 0), (1, 0)),
                                       constant_values=mark.cells.shape[1])  # fmt: skip
                        surface = pyvista.PolyData(self.structure.positions, faces.ravel())
                        actor = plotter.add_mesh(
                            surface, color=COLOURS[mark.kind], opacity=0.6, **light
                        )
                        actor.position = 3.0 * pixel * eye  # nearer than the surface it is part of
                plotter.camera.parallel_projection = True
                plotter.camera.focal_point = middle
                plotter.camera.position = middle + far * eye
                plotter.camera.up = self.projection.axes[1]
                plotter.camera.parallel_scale = 0.5e-3 * (self.high - self.low)[1]
                plotter.camera.clipping_range = (0.1 * far, 10.0 * far)
                return plotter.screenshot(return_img=True)
            finally:
                plotter.close()

    def _draw_marks(self) -> None:
        """Draw joints, supports, bolts and loads over the elements."""
        for mark in self.preview.of_kind("joint"):
            self._draw_joint(mark)
        for mark in self.preview.of_kind("support"):
            self._draw_support(mark)
        for mark in self.preview.of_kind("bolt"):
            self._draw_bolt(mark)
        for mark in self.preview.of_kind("load"):
            self._draw_load(mark)

    def _dashed(self, mark: Mark) -> None:
        """Border of a solid's surface, which other parts may hide."""
        ends = self.projection.nodes(_border(mark.cells))
        self._lines(ends, COLOURS[mark.kind], 1.6, linestyles=(0, (3, 2)), zorder=4)

    def _draw_joint(self, mark: Mark) -> None:
        """Colours of the pressure; of a solid the border, as its face is drawn below."""
        from matplotlib.collections import LineCollection

        pressure, cells = 1e-6 * np.asarray(mark.pressure), mark.cells
        if self.dim == 3:
            self._dashed(mark)
        elif cells.shape[1] == 2:
            ends = self.projection.nodes(cells, -0.5)
            self._lines(ends, "#2b2f33", 9.0, zorder=3, capstyle="butt")
            lines = LineCollection(list(ends), cmap=_colours(), norm=self.norm, linewidths=7.0,
                                   capstyle="butt", zorder=4)  # fmt: skip
            lines.set_array(pressure.mean(axis=1))
            self.main.add_collection(lines)
            if self.dim == 1 and "\non a rigid base\n" in mark.text:
                self._draw_base(ends)
        else:
            self._colour(self.main, self.projection.nodes(cells), pressure, 2.5)
            ends = self.projection.nodes(_border(cells))
            self._lines(ends, COLOURS["joint"], 1.8, zorder=3)

    def _draw_base(self, ends: FloatArray) -> None:
        """Hatched ground below lines (k, 2, 2)."""
        from matplotlib.patches import Rectangle

        (left, level), (right, _) = ends.reshape(-1, 2).min(axis=0), ends.reshape(-1, 2).max(axis=0)
        depth = 0.1 * (self.high - self.low)[1]
        self.main.add_patch(
            Rectangle((left, level - depth), right - left, depth, facecolor="white",
                      edgecolor="#6d747b", hatch="////", linewidth=0.0, zorder=2)
        )  # fmt: skip

    def _colour(self, panel: Any, corners: FloatArray, values: FloatArray, order: float) -> None:
        """Colours of values at the corners of cells, (c, corners), between them by triangles."""
        from matplotlib.collections import PolyCollection

        count = corners.shape[1]
        number = np.arange(corners.shape[0] * count).reshape(-1, count)
        triangles = np.vstack([number[:, [0, k, k + 1]] for k in range(1, count - 1)])
        x, y = corners.reshape(-1, 2).T
        panel.tripcolor(x, y, triangles, values.ravel(), cmap=_colours(), norm=self.norm,
                        shading="gouraud", zorder=order)  # fmt: skip
        if not self._fine():
            panel.add_collection(
                PolyCollection(list(corners), facecolors="none", edgecolors="#6b5a45",
                               linewidths=0.25, alpha=0.6, zorder=order + 0.1)
            )  # fmt: skip

    def _draw_support(self, mark: Mark) -> None:
        """Surface or nodes of a support."""
        colour = COLOURS["support"]
        if self.dim == 3 and len(mark.cells):
            self._dashed(mark)
        elif self.dim == 2 and mark.cells.shape[1] == 2 and len(mark.cells):
            self._lines(self.projection.nodes(mark.cells), colour, 5.0, zorder=5)
        nodes = mark.nodes if len(mark.nodes) <= 60 else mark.nodes[:: len(mark.nodes) // 40]
        if self.dim == 1:
            ends = np.stack([self.projection.nodes(nodes, side) for side in (-0.65, 0.65)], axis=1)
            self._lines(ends, colour, 6.0 if len(nodes) == 1 else 2.0, zorder=6)
        elif self.dim == 2 or not len(mark.cells):
            x, y = self.projection.nodes(nodes).T
            self.main.scatter(x, y, marker="^", s=36, color=colour, edgecolors="white", zorder=6)

    def _draw_bolt(self, mark: Mark) -> None:
        """Surfaces and axis, or rings and middle, of a bolt."""
        colour = COLOURS["bolt"]
        if self.dim == 3 and len(mark.cells):
            self._dashed(mark)
        elif len(mark.cells):
            self._lines(self.projection.nodes(mark.cells), colour, 5.0, zorder=5)
        if mark.line is not None:
            x, y = self.projection.points(mark.line).T
            self.main.plot(x, y, color=colour, linewidth=1.5, linestyle="-.", zorder=6)
        if mark.rings:
            turn = np.linspace(0.0, 2.0 * np.pi, 73)
            ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
            for radius in mark.rings if self.dim > 1 else ():
                at = np.pad(ring, ((0, 0), (0, self.dim - 2))) * radius + mark.at
                self.main.plot(*self.projection.points(at).T, color=colour, lw=1.5, zorder=6)
            x, y = self.projection.points(mark.at)
            self.main.scatter([x], [y], marker="+", s=90, color=colour, zorder=6)

    def _draw_load(self, mark: Mark) -> None:
        """Arrow of a load; a circle with a cross or point where it runs along the view."""
        colour, (start, end) = COLOURS["load"], self.arrows[id(mark)]
        if self.dim == 3 and len(mark.cells):
            self._dashed(mark)
        elif self.dim == 2 and mark.cells.shape[1] == 2 and len(mark.cells):
            self._lines(self.projection.nodes(mark.cells), colour, 3.0, zorder=5)
        if np.linalg.norm(end - start) < 0.015 * self.size:
            self.main.scatter(*start, s=160, facecolors="white", edgecolors=colour, zorder=7)
            self.main.scatter(*start, s=20, color=colour, zorder=8)
            return
        self.main.annotate(
            "", xy=end, xytext=start, zorder=8, annotation_clip=False,
            arrowprops={"arrowstyle": "-|>,head_length=0.8,head_width=0.35", "color": colour,
                        "linewidth": 3.0, "shrinkA": 0.0, "shrinkB": 0.0},
        )  # fmt: skip

    def _draw_scale(self) -> None:
        """Axes in mm: ticks at the frame, of a solid along three edges of its bounding box."""
        if self.dim == 3:
            self.main.set_axis_off()
            self._draw_rulers()
            return
        self.main.spines[["top", "right"]].set_visible(False)
        along = "position along the bar, mm" if self.dim == 1 else "x, mm"
        self.main.set_xlabel(along)
        if self.dim == 1:
            self.main.set_yticks([])
            self.main.spines["left"].set_visible(False)
        else:
            enlarged = self.projection.enlarged
            self.main.set_ylabel("y, mm")
            self.main.yaxis.set_major_formatter(lambda value, _: f"{value / enlarged:g}")
            self.main.locator_params(axis="y", nbins=max(2, int(self.frame[1] / 0.3)))

    def _draw_rulers(self) -> None:
        """Lines with ticks in mm along the edges x, y and z of the bounding box."""
        from matplotlib.ticker import MaxNLocator

        low, high = self.structure.nodes.min(axis=0), self.structure.nodes.max(axis=0)
        inch = (self.high - self.low)[0] / self.frame[0]  # mm in the drawing
        centre = self.projection.points(0.5 * (low + high))
        starts = (low, np.array([high[0], low[1], low[2]]), low)
        for axis, start in enumerate(starts):
            end = start.copy()
            end[axis] = high[axis]
            ends = self.projection.points(np.array([start, end]))
            along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            away = np.array([-along[1], along[0]])
            away *= np.sign(away @ (ends.mean(axis=0) - centre)) or 1.0
            line = ends + 0.08 * inch * away
            self.main.plot(*line.T, color="black", lw=1.0, clip_on=False, zorder=9)
            count = max(1, int(np.linalg.norm(ends[1] - ends[0]) / (0.55 * inch)))
            values = MaxNLocator(count).tick_values(1e3 * low[axis], 1e3 * high[axis])
            for value in values[(values >= 1e3 * low[axis] - 1e-6)
                                & (values <= 1e3 * high[axis] + 1e-6)]:  # fmt: skip
                at = start.copy()
                at[axis] = 1e-3 * value
                tick = self.projection.points(at) + 0.08 * inch * away
                tip = tick + 0.06 * inch * away
                self.main.plot(*np.array([tick, tip]).T, color="black", lw=1.0, clip_on=False)
                self.main.text(*(tick + 0.2 * inch * away), f"{value:g}", ha="center",
                               va="center", fontsize=8, clip_on=False)  # fmt: skip
            name = line.mean(axis=0) + 0.58 * inch * away
            self.main.text(*name, f"{'xyz'[axis]}, mm", ha="center", va="center", fontsize=9)

    def _arrange_labels(self) -> None:
        """Choose places of the labels above the drawing."""
        marks = self.preview.marks
        self.places = np.array([self._anchor(mark) for mark in marks])
        left = 0.5 * (self.WIDTH - self.frame[0])
        at = (self.places - self.low) / (self.high - self.low) * self.frame
        texts = [mark.text.split("\n") for mark in marks]
        widths = np.array([0.25 + 0.077 * max(map(len, lines)) for lines in texts])
        room = self.WIDTH - 0.4
        middles, self.rows, self.row_heights = _placed(
            at[:, 0] + left - 0.2, widths, [len(lines) for lines in texts], room
        )
        self.middles = middles + 0.2

    def _anchor(self, mark: Mark) -> FloatArray:
        """Place that a label points at: the middle of an arrow, or of what is marked."""
        if mark.kind == "load":
            start, end = self.arrows[id(mark)]
            return np.asarray(0.5 * (start + end))
        return self.projection.place(mark)

    def _draw_labels(self, left: float) -> None:
        """Write the labels, with a line to each place."""
        for mark, place, middle, row in zip(
            self.preview.marks, self.places, self.middles, self.rows, strict=True
        ):
            colour = COLOURS[mark.kind]
            at = (middle / self.WIDTH, (self.row_bottoms[row] + 0.05) / self.height)
            self.main.annotate(
                "", xy=place, xytext=at, textcoords="figure fraction", zorder=10,
                annotation_clip=False,
                arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.7, "shrinkA": 0.0,
                            "shrinkB": 0.0},
            )  # fmt: skip
            self.figure.text(  # above all lines
                *at, mark.text, parse_math=False, ha="center", va="bottom", fontsize=9,
                color=colour, bbox={"boxstyle": "round,pad=0.12", "facecolor": "white",
                                    "edgecolor": "none", "alpha": 0.9},
            )  # fmt: skip
            self.main.scatter(*place, s=14, color=colour, edgecolors="white", linewidths=0.6,
                              zorder=11, clip_on=False)  # fmt: skip

    def _draw_face(self, number: int, mark: Mark) -> None:
        """Panel of a joint of a solid, seen at a right angle to its face."""
        row, column = divmod(number, 2)
        columns = min(2, len(self.faces))
        wide = (self.WIDTH - 2 * self.MARGIN - 0.9 * (columns - 1)) / columns
        rows = int(np.ceil(len(self.faces) / 2))
        bottom = self.bottom + 0.5 + 2.75 * (rows - 1 - row)
        panel = self._axes(self.MARGIN + column * (wide + 0.9), bottom, wide, 1.75)
        x = self.structure.nodes
        spread = np.linalg.svd(x[mark.nodes] - x[mark.nodes].mean(axis=0), full_matrices=False)[2]
        normal = spread[2]
        across = np.argsort(np.abs(normal))[:2]  # the coordinates that the face spans best
        first, second = sorted(int(axis) for axis in across)
        corners = 1e3 * x[mark.cells][..., [first, second]]
        self._colour(panel, corners, 1e-6 * np.asarray(mark.pressure), 2.0)
        panel.set_aspect("equal")
        panel.autoscale_view()
        panel.set_xlabel(f"{'xyz'[first]}, mm")
        panel.set_ylabel(f"{'xyz'[second]}, mm")
        panel.set_title(mark.text.replace("\n", ", "), fontsize=10, color=COLOURS["joint"],
                        parse_math=False)  # fmt: skip
        for bolt in self.preview.of_kind("bolt"):
            place = 1e3 * bolt.at[[first, second]]
            low, high = corners.reshape(-1, 2).min(axis=0), corners.reshape(-1, 2).max(axis=0)
            if np.all(place >= low) and np.all(place <= high):
                panel.scatter(*place, marker="+", s=80, color=COLOURS["bolt"], zorder=4)
                panel.annotate(bolt.text.split("\n")[0], place, xytext=(9, 14), fontsize=8,
                               textcoords="offset points", color=COLOURS["bolt"], zorder=5,
                               bbox={"boxstyle": "round,pad=0.1", "facecolor": "white",
                                     "edgecolor": "none", "alpha": 0.85})  # fmt: skip

    def _draw_words(self) -> None:
        """Write title, notes and legend, and the scale of the pressures."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch as Square

        def write(x: float, y: float, text: str, **more: Any) -> None:
            self.figure.text(x / self.WIDTH, y / self.height, text, parse_math=False, **more)

        write(0.3, self.height - 0.33, self.preview.title, fontsize=14, weight="bold")
        kind = {1: "Bars", 2: "Plates", 3: "Solids"}[self.dim]
        write(0.3, self.height - 0.58, f"{kind}: {self.structure.overview()}", fontsize=10)
        for number, note in enumerate(self._notes()):
            write(0.3, 0.15 + 0.2 * number, note, fontsize=9, color="#4a4f55")
        present = {mark.kind for mark in self.preview.marks}
        handles: list[Any] = [Square(facecolor=_BODIES[0], edgecolor="#8a929b", label="element")]
        if "joint" in present:
            handles.append(
                Square(
                    facecolor="white" if self.dim == 3 else _PRESSURES[1],
                    edgecolor=COLOURS["joint"],
                    linestyle="--" if self.dim == 3 else "-",
                    label="joint, its face is below" if self.dim == 3 else "joint",
                )
            )
        if "support" in present:
            handles.append(Line2D([], [], color=COLOURS["support"], marker="^", lw=3,
                                  label="support"))  # fmt: skip
        if "load" in present:
            handles.append(Line2D([], [], color=COLOURS["load"], marker=">", lw=3,
                                  label="load, in its positive direction"))  # fmt: skip
        if "bolt" in present:
            handles.append(Line2D([], [], color=COLOURS["bolt"], marker="+", lw=1.5, label="bolt"))
        if "part" in present:
            handles.append(Line2D([], [], color=COLOURS["part"], marker="o", lw=0.7, ms=4,
                                  label="named part"))  # fmt: skip
        level = (self.bottom - 0.45) / self.height
        self.figure.legend(handles=handles, loc="center left", ncols=len(handles), frameon=False,
                           bbox_to_anchor=(0.2 / self.WIDTH, level), fontsize=9.5)  # fmt: skip
        if "joint" in present:
            scale = self._axes(self.WIDTH - 4.3, self.bottom - 0.5, 3.6, 0.14)
            bar = self.figure.colorbar(
                ScalarMappable(self.norm, _colours()), cax=scale, orientation="horizontal"
            )
            bar.ax.set_title("pressure on the joints, MPa", fontsize=9.5)
            bar.ax.tick_params(labelsize=8.5)
