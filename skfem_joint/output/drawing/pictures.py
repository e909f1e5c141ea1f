"""Pictures of a structure: warped bodies, coloured by stick and slip, above the load over time.

They show what ``examples/paraview_joint.py`` shows in ParaView. Every model has a column or a row
of panels: its bodies seen obliquely from above, and below them each face on which a solid is
pressed, seen at a right angle, because the bodies hide it. pyvista draws the panels, matplotlib
puts them together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, evenly
from skfem_joint.ground.files import needed, replacing
from skfem_joint.output.drawing.offscreen import drawn, offscreen, plotter_of
from skfem_joint.output.fields import Field, Frames
from skfem_joint.output.plots import DPI, envelope, new_figure, prefixed_unit, save_figure
from skfem_joint.output.series import Block, blocks_of, faces_of
from skfem_joint.results.borders import of_cells, smoothed, touching

#: Colours of -1 no contact, 0 stick, 1 slip; they differ in grey too.
STATES = {"no contact": "#d5d8dc", "stick": "#2f6db3", "slip": "#f08a24"}
#: Width of the picture, and heights that the bodies of all models share, and that a face has, at
#: most, inches.
_WIDTH, _TALLEST, _FACE = 9.4, 5.0, 2.8


def warp_factor(frames: Frames) -> float:
    """Factor of displacements, 1, 2 or 5 x 10^n; the largest is 1/50 to 1/20 of the length then."""
    largest = max(float(np.abs(field.displacement).max(initial=0.0)) for field in frames.fields)
    if largest == 0.0:
        return 1.0
    wanted = 0.05 * float(np.ptp(frames.structure.positions, axis=0).max()) / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted))


def frame_to_show(frames: Frames) -> tuple[int, str]:
    """Number of the frame where slip is fastest, or else the displacement is largest, and why.

    Slip is fastest among the frames in which nearly as many points slip as in any: where a load
    turns, all stick. It is a frame of the second half of the run, which has settled, unless less
    than half as many points slip there as in the first half.
    """
    first, count = frames.fields[0], len(frames.times)
    slipping = np.count_nonzero(first.slip_state[:count] == 1, axis=1)
    if slipping.any():
        late = count // 2 if 2 * slipping[count // 2 :].max() >= slipping.max() else 0
        rate = np.gradient(first.slip[:count], frames.times, axis=0) if count > 1 else first.slip
        speed = np.linalg.norm(rate[late:], axis=2).sum(axis=1)
        most = slipping[late:] >= 0.9 * slipping[late:].max()
        return late + int(np.where(most, speed, -1.0).argmax()), "slip is fastest"
    moves = np.abs(first.displacement[:count]).max(axis=(1, 2))
    return int(moves.argmax()), "largest displacement" if moves.any() else "nothing moves"


def still(path: str | Path, frames: Frames) -> None:
    """Draw the `frame_to_show` as a PNG.

    InputError without pyvista or a GL library, and for a path that cannot be written.
    """
    with _picture(frames) as picture:
        picture.show(*frame_to_show(frames))
        save_figure(Path(path), picture.figure)


def animation(path: str | Path, frames: Frames, *, most: int = 60) -> None:
    """Draw at most ``most`` evenly spread frames as a GIF of 15 frames a second.

    InputError as for :func:`still`.
    """
    with _picture(frames) as picture, replacing(Path(path)) as temporary:
        from matplotlib.animation import PillowWriter

        writer = PillowWriter(fps=15)
        with writer.saving(picture.figure, str(temporary), dpi=100):
            for frame in evenly(len(frames.times), most):
                picture.show(int(frame))
                writer.grab_frame()


@contextmanager
def _picture(frames: Frames) -> Iterator[Picture]:
    """Picture of frames, whose panels are closed at the end."""
    needed("pyvista", "vtk")  # a library that is missing is reported before a window is tried
    with offscreen(), ExitStack() as stack:
        yield Picture(frames, stack)


def outline(surface: Any) -> Any:
    """Border of a surface and edges at which it bends by more than 30 degrees, as lines.

    Neighbouring facets of a mesh may be numbered in opposite directions, so that their normals are
    opposite on an even face; they are made to agree first.
    """
    agreed = surface.compute_normals(
        cell_normals=True,
        point_normals=False,
        split_vertices=False,
        consistent_normals=True,
        auto_orient_normals=False,
    )
    return agreed.extract_feature_edges(30.0, manifold_edges=False)


@dataclass(frozen=True)
class View:
    """Content of a panel of a model, and the direction of view.

    Attributes
    ----------
    label : str
        Name of the face; empty for the bodies.
    blocks : sequence of Block
        What is drawn.
    axes : ndarray, shape (3, 3)
        Unit vectors across the picture, up, and from the blocks to the eye, as rows.
    low, high : ndarray, shape (2,)
        Least and largest coordinates across and up that any model reaches in any frame, m.
    """

    label: str
    blocks: Sequence[Block]
    axes: FloatArray
    low: FloatArray
    high: FloatArray


def views_of(frames: Frames, factor: float) -> list[View]:
    """View of the bodies, and views of the faces on which solids are pressed.

    Displacements are drawn ``factor`` times as large as they are.
    """
    structure = frames.structure
    parts = [("", blocks_of(structure), _axes(np.array([0.0, -0.55, 0.85])))]
    normals = {
        f"contact {patch.joint.on}": patch.normal.sum(axis=0)
        for patch in structure.patches
        if patch.normal is not None
    }
    parts += [  # the faces that are pressed; not those that they are pressed on
        (block.label, [block], _axes(normals[block.label]))
        for block in faces_of(structure)
        if block.label in normals
    ]
    count, views = len(frames.times), []
    moves = [factor * structure.body.in_space(f.displacement[:count]) for f in frames.fields]
    for label, blocks, axes in parts:
        reached = []
        for block in blocks:
            at = np.asarray(block.grid.points) @ axes[:2].T
            for u in moves:
                own = u[:, block.nodes] @ axes[:2].T
                reached += [at, at + own.min(axis=0), at + own.max(axis=0)]
        points = np.concatenate(reached)
        views.append(View(label, blocks, axes, points.min(axis=0), points.max(axis=0)))
    return views


def _axes(normal: FloatArray) -> FloatArray:
    """Orthonormal axes across the picture, up, and to the eye, which is above and on the normal.

    The first is x in the direction of view; if the normal is within 25 degrees of x, it is y.
    """
    eye = normal / (np.linalg.norm(normal) or 1.0) * (1.0 if normal[2] >= 0.0 else -1.0)
    across = np.eye(3)[0 if abs(eye[0]) < 0.9 else 1]
    across = across - (across @ eye) * eye
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(eye, across), eye])


def _cells(surface: Any) -> sparse.csr_array:
    """Matrix of sums over the points of each cell of a surface."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    polygons = surface.GetPolys()
    corners, starts = polygons.GetConnectivityArray(), polygons.GetOffsetsArray()
    convert: Any = vtk_to_numpy
    return of_cells(convert(corners), convert(starts), surface.n_points)


@dataclass(frozen=True)
class _Drawn:
    """A block with its surface and edges, the actor of its contact, and the surface's cells."""

    block: Block
    surface: Any
    edges: Any
    actor: Any
    cells: sparse.csr_array

    def show(self, arrays: dict[str, Any], factor: float) -> None:
        """Move to a frame, cut the contact out of the surface, and say where it slips."""
        grid, ids = self.block.fill(arrays), self.surface.point_data["vtkOriginalPointIds"]
        points = grid.points + factor * np.asarray(grid["displacement"])
        for mesh in (self.surface, self.edges):
            mesh.points = points[mesh.point_data["vtkOriginalPointIds"]]
        state, pressure = (np.asarray(grid[name])[ids] for name in ("slip_state", "pressure"))
        if "contact_pressure" in grid.point_data:
            pressure = np.maximum(pressure, np.asarray(grid["contact_pressure"])[ids])
        touches = state >= 0
        shown = self.surface.copy()
        shown.point_data["touches"] = touching(self.cells, np.where(touches, pressure, 0.0))
        shown.point_data["slips"] = smoothed(self.cells, (state == 1).astype(float), touches)
        contact = shown.clip_scalar(scalars="touches", value=0.5, invert=False)
        self.actor.visibility = contact.n_cells > 0
        if contact.n_cells:
            contact.set_active_scalars("slips")
            self.actor.mapper.dataset = contact


class Panel:
    """A view of a model, which pyvista draws and matplotlib shows.

    Parameters
    ----------
    field : Field
    view : View
    pixel : float
        Length of a pixel, m.
    image : AxesImage
        What shows it.

    Attributes
    ----------
    plotter : pyvista.Plotter
    blocks : list of _Drawn
        Each block with what moves with the frames.
    """

    def __init__(self, field: Field, view: View, pixel: float, image: Any) -> None:
        self.field, self.image = field, image
        self.plotter = plotter_of(view.axes, view.low, view.high, pixel)
        self.blocks = [self._add(block, 2.0 * pixel * view.axes[2]) for block in view.blocks]

    def _add(self, block: Block, nearer: FloatArray) -> _Drawn:
        """Add a block's surface, contact and edges, in grey too where they were at rest."""
        surface = block.grid.extract_surface(algorithm="dataset_surface")
        edges, light = outline(surface), {"ambient": 0.7, "diffuse": 0.35}
        self.plotter.add_mesh(edges.copy(), color="#9aa0a6", line_width=1)
        self.plotter.add_mesh(surface, color=STATES["no contact"], **light)
        contact = surface.copy()
        contact.point_data["slips"] = np.zeros(contact.n_points)
        # Two colours of a field that is interpolated first: a smooth border within the cells.
        actor = self.plotter.add_mesh(
            contact, scalars="slips", clim=(0.0, 1.0), show_scalar_bar=False,
            interpolate_before_map=True, cmap=[STATES["stick"], STATES["slip"]], n_colors=2,
            **light,
        )  # fmt: skip
        # Nearer to the eye, so that the surface hides neither its contact nor its own edges.
        actor.position = 0.5 * nearer
        self.plotter.add_mesh(edges, color="black", line_width=2).position = nearer
        return _Drawn(block, surface, edges, actor, _cells(surface))

    def show(self, arrays: dict[str, Any], factor: float) -> None:
        """Move the blocks to a frame, colour their contact by stick and slip, and draw them."""
        for drawing in self.blocks:
            drawing.show(arrays, factor)
        self.image.set_data(drawn(self.plotter))


class Picture:
    """Panels of all models and the curves of the loads; `show` sets them to a frame.

    Parameters
    ----------
    frames : Frames
        Stored fields of the models and their loads.
    stack : ExitStack
        Closes what pyvista draws into.

    Attributes
    ----------
    figure : Figure
    panels : list of Panel
        The views of each model.
    marks : list of (Line2D, ndarray)
        Marks on the curves of the loads, and their forces in the unit of the curve.
    """

    def __init__(self, frames: Frames, stack: ExitStack) -> None:
        needed("matplotlib", "plot")
        from matplotlib.patches import Patch

        self.frames, self.factor = frames, warp_factor(frames)
        self.time_unit, self.time_scale = prefixed_unit("s", [np.asarray(frames.times)])
        views, models = views_of(frames, self.factor), len(frames.fields)
        sizes = [view.high - view.low for view in views]
        # Models stand beside or below each other, as their bodies are drawn larger: length of an
        # inch of the bodies. Faces are drawn as large as there is room.
        (wide, tall), *_ = sizes
        inch, columns = min(
            (max(wide / (_WIDTH / k - 0.6), models // k * tall / _TALLEST), k) for k in (1, models)
        )
        width = _WIDTH / columns - 0.6
        inches = [inch, *(max(wide / width, tall / _FACE) for wide, tall in sizes[1:])]
        # Lines of the border are drawn whole.
        edges = [3.0 * inch / DPI for inch in inches]
        views = [
            replace(view, low=view.low - edge, high=view.high + edge)
            for view, edge in zip(views, edges, strict=True)
        ]
        heights = [max(tall / inch, 0.1) for (_, tall), inch in zip(sizes, inches, strict=True)]
        heights *= models // columns
        loads = [1.6] if frames.forces else []
        height = 0.5 + sum(heights) + 0.4 * len(heights) + 2.2 * len(loads)
        self.figure = new_figure(_WIDTH, height)
        grid = self.figure.add_gridspec(
            len(heights) + len(loads), columns, height_ratios=[*heights, *loads]
        )
        self.panels = []
        for number, field in enumerate(frames.fields):
            row, column = divmod(number, columns)
            for k, view in enumerate(views):
                panel = self.figure.add_subplot(grid[row * len(views) + k, column])
                panel.set_axis_off()
                names = [field.name] * (models > 1) + [view.label] * bool(view.label)
                panel.set_title(", ".join(names), loc="left")
                (left, low), (right, high) = view.low.tolist(), view.high.tolist()
                image = panel.imshow(np.ones((1, 1, 3)), extent=(left, right, low, high))
                middle = 0.5 * (view.low + view.high)[0]
                half = 0.5 * inches[k] * width + edges[k]
                panel.set_xlim(middle - half, middle + half)
                self.panels.append(Panel(field, view, inches[k] / DPI, image))
                stack.callback(self.panels[-1].plotter.close)
        self.marks = self._add_loads(self.figure.add_subplot(grid[-1, :])) if loads else []
        if frames.structure.patches:
            patches = [Patch(color=colour, label=name) for name, colour in STATES.items()]
            self.figure.legend(handles=patches, loc="outside upper right", ncols=3, frameon=False)
        self._write("t")
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")  # it takes time, and moves nothing any more

    def _add_loads(self, panel: Any) -> list[tuple[Any, FloatArray]]:
        """Curves of the loads with a mark each; returns the marks and the forces in their unit."""
        forces, marks = self.frames.forces, []
        unit, scale = prefixed_unit("N", forces.values())
        colours = cycle(("#1a1a1a", "#9c1c00", "#2e6b2e", "#8d5fb0"))
        for (on, force), colour in zip(forces.items(), colours, strict=False):
            times, values = self.frames.load_times / self.time_scale, np.asarray(force) / scale
            if (band := envelope(times, values)) is None:
                panel.plot(times, values, color=colour, label=on)
            else:
                panel.fill_between(*band, color=colour, alpha=0.4, label=on)
            marks.append((panel.plot([], [], "o", color="#d11f1f", markersize=8)[0], values))
        where = f"\non {next(iter(forces))}" if len(forces) == 1 else ""
        panel.set(xlabel=f"time, {self.time_unit}", ylabel=f"force{where}, {unit}", xmargin=0.0)
        panel.grid(alpha=0.3)
        if len(forces) > 1:
            panel.legend()
        return marks

    def _write(self, text: str) -> None:
        self.figure.suptitle(text, x=0.02, horizontalalignment="left")

    def show(self, frame: int, why: str = "") -> None:
        """Set everything to a frame; ``why`` says what is special about it."""
        for field in self.frames.fields:
            arrays = self.frames.arrays(field, frame)
            for panel in self.panels:
                if panel.field is field:
                    panel.show(arrays, self.factor)
        time = self.frames.times[frame]
        now = [float(np.interp(time, self.frames.load_times, force)) for _, force in self.marks]
        largest = [np.abs(force).max(initial=0.0) for _, force in self.marks]
        if why and self.marks and max(map(abs, now)) <= 1e-3 * max(largest):
            why += ", no load then"
        text = f"t = {time / self.time_scale:.3f} {self.time_unit}{f' ({why})' if why else ''}"
        self._write(f"{text},  displacement × {self.factor:g}")
        for (mark, _), force in zip(self.marks, now, strict=True):
            mark.set_data([time / self.time_scale], [force])
