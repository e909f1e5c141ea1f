"""Pictures of a structure: warped bodies, coloured by stick and slip, above the load over time.

They show what ``examples/paraview_joint.py`` shows in ParaView, drawn by pyvista. Every model has a
column or a row of panels: its bodies seen obliquely from above, and below them each face on which
a solid is pressed, seen at a right angle, because the bodies hide it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.files import needed, replacing
from skfem_joint.output.fields import Field, Frames
from skfem_joint.output.offscreen import offscreen
from skfem_joint.output.plots import envelope, prefixed_unit
from skfem_joint.output.series import Block, blocks_of, faces_of

#: Colours of -1 no contact, 0 stick, 1 slip; they differ in grey too.
STATES = {"no contact": "#d5d8dc", "stick": "#2f6db3", "slip": "#f08a24"}


#: Of the picture, pixels, as all sizes here.
_WIDTH = 1400
#: Height that the bodies and faces of all models share at most.
_TALLEST = 760
#: Height of the line above each panel that names it.
_LABEL = 44
#: Space below bodies; beside them are at least 40.
_SPACE = 10


def warp_factor(frames: Frames) -> float:
    """Factor of displacements, 1, 2 or 5 x 10^n; the largest is 1/50 to 1/20 of the length then."""
    largest = max(float(np.abs(field.displacement).max(initial=0.0)) for field in frames.fields)
    if largest == 0.0:
        return 1.0
    wanted = 0.05 * float(np.ptp(frames.structure.positions, axis=0).max()) / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted))


def frame_to_show(frames: Frames) -> tuple[int, str]:
    """Number of the frame where most points slip, or else the displacement is largest, and why.

    It is a frame of the second half of the run, which has settled, unless less than half as many
    points slip there as in the first half.
    """
    first, count = frames.fields[0], len(frames.times)
    slipping = np.count_nonzero(first.slip_state[:count] == 1, axis=1)
    if slipping.any():
        late = count // 2 if 2 * slipping[count // 2 :].max() >= slipping.max() else 0
        return late + int(slipping[late:].argmax()), "most points slip"
    moves = np.abs(first.displacement[:count]).max(axis=(1, 2))
    return int(moves.argmax()), "largest displacement" if moves.any() else "nothing moves"


def still(path: str | Path, frames: Frames) -> None:
    """Draw the `frame_to_show` as a PNG.

    InputError without pyvista or a GL library, and for a path that cannot be written.
    """
    with _picture(path, frames) as (temporary, picture):
        picture.show(*frame_to_show(frames))
        picture.plotter.screenshot(temporary)


def animation(path: str | Path, frames: Frames, *, most: int = 60) -> None:
    """Draw at most ``most`` evenly spread frames as a GIF of 15 frames a second.

    InputError as for :func:`still`, and without imageio.
    """
    needed("imageio", "gif")
    with _picture(path, frames) as (temporary, picture):
        chosen = np.unique(np.linspace(0, len(frames.times) - 1, most).round().astype(int))
        picture.plotter.open_gif(str(temporary), fps=15.0, subrectangles=True)
        for frame in chosen:
            picture.show(int(frame))
            picture.plotter.write_frame()
        picture.plotter.mwriter.close()


@contextmanager
def _picture(path: str | Path, frames: Frames) -> Iterator[tuple[Path, Picture]]:
    """Temporary file, which replaces the target once it is complete, and the picture for it."""
    needed("pyvista", "vtk")  # a library that is missing is reported before a window is tried
    with offscreen():
        picture = Picture(frames)
        try:
            with replacing(Path(path)) as temporary:
                yield temporary, picture
        finally:
            picture.plotter.close()


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


@dataclass(frozen=True)
class _Drawn:
    """A block of a model in the picture: its surface and edges, which move with the frames."""

    field: Field
    block: Block
    surface: Any
    edges: Any


class Picture:
    """Panels of all models and the curves of the loads; `show` sets them to a frame.

    Parameters
    ----------
    frames : Frames
        Stored fields of the models and their loads.

    Attributes
    ----------
    plotter : pyvista.Plotter
        The picture, with the title in the first row, the models' panels below it and the loads and
        the legend in the last row.
    views : list of View
        The panels of each model.
    """

    def __init__(self, frames: Frames) -> None:
        pyvista = needed("pyvista", "vtk")
        self.frames, self.factor = frames, warp_factor(frames)
        self.views = views_of(frames, self.factor)
        self.time_unit, self.time_scale = prefixed_unit("s", [np.asarray(frames.times)])
        models, each = len(frames.fields), len(self.views)
        self.pixel, self.columns = self._arranged()
        heights = [self._height(view) for view in self.views] * (models // self.columns)
        # Height of the lowest panel with and without curves of loads.
        self.panel = 300 if frames.forces else 130
        # Height of the line with the time.
        weights = [64, *heights, self.panel]
        last = len(weights) - 1
        self.plotter = pyvista.Plotter(
            off_screen=True, window_size=(_WIDTH, sum(weights)), border=False,
            shape=(last + 1, self.columns), row_weights=weights,
            groups=[(0, slice(None)), (last, slice(None))],
        )  # fmt: skip
        self.plotter.set_background("white", all_renderers=True)
        self.drawn: list[_Drawn] = []
        for k, field in enumerate(frames.fields):
            row, column = divmod(k, self.columns)
            for j, view in enumerate(self.views):
                self.plotter.subplot(1 + row * each + j, column)
                self._add_view(field, view)
        self.plotter.subplot(last, 0)
        self.marks = self._add_loads() if frames.forces else []
        if frames.structure.patches:
            self._add_legend()

    def _arranged(self) -> tuple[float, int]:
        """Length of a pixel (m) and number of columns, with models beside or below each other.

        The arrangement that draws them larger is taken.
        """
        models = len(self.frames.fields)
        wide, tall = np.transpose([view.high - view.low for view in self.views])
        lines = len(self.views) * (_LABEL + _SPACE)
        arrangements = []
        for columns, rows in ((1, models), (models, 1)):
            across = _WIDTH / columns - 2 * 40
            up = max(_TALLEST / rows - lines, 0.1 * _TALLEST / rows)
            arrangements.append((max(float(wide.max() / across), float(tall.sum() / up)), columns))
        return min(arrangements)

    def _height(self, view: View) -> int:
        """Height of a view's panel, pixels."""
        body = (view.high[1] - view.low[1]) / self.pixel
        return _LABEL + _SPACE + int(np.ceil(body))

    def _add_view(self, field: Field, view: View) -> None:
        """Add the blocks of a view to the current panel, with its name, and aim the camera."""
        size = np.array([_WIDTH / self.columns, self._height(view)])
        left = 0.5 * (size[0] - (view.high[0] - view.low[0]) / self.pixel)  # it is in the middle
        corner = view.low - self.pixel * np.array([left, 0.5 * _SPACE])
        middle = (corner + 0.5 * self.pixel * size) @ view.axes[:2]
        far = 10.0 * float(np.ptp(self.frames.structure.positions, axis=0).max()) + 1.0
        camera = self.plotter.camera
        camera.parallel_projection = True
        camera.focal_point, camera.up = middle, view.axes[1]
        camera.position = middle + far * view.axes[2]
        camera.parallel_scale = 0.5 * float(size[1]) * self.pixel
        for block in view.blocks:
            self.drawn.append(self._add_block(field, block, view))
        names = [field.name] if len(self.frames.fields) > 1 else []
        name = ", ".join([*names, view.label] if view.label else names)
        self._write(name, (left, size[1] - _LABEL + 10.0), 12)

    def _add_block(self, field: Field, block: Block, view: View) -> _Drawn:
        """Add a block's surface and its edges, in grey too where they were at rest."""
        surface = block.grid.extract_surface(algorithm="dataset_surface")
        edges = outline(surface)
        surface.cell_data["state"] = np.zeros(surface.n_cells)
        self.plotter.add_mesh(edges.copy(), color="#9aa0a6", line_width=1)
        self.mapper = self.plotter.add_mesh(
            surface, scalars="state", clim=(-1.5, 1.5), show_scalar_bar=False, ambient=0.7,
            diffuse=0.35, cmap=list(STATES.values()),
        ).mapper  # fmt: skip
        actor = self.plotter.add_mesh(edges, color="black", line_width=2)
        # Two pixels nearer to the eye, so that the surface does not hide its own edges.
        actor.position = 2.0 * self.pixel * view.axes[2]
        return _Drawn(field, block, surface, edges)

    def _add_legend(self) -> None:
        """Add a legend of the colours of contact at the right of the current panel."""
        left, bottom, wide = 0.74 * _WIDTH, 0.5 * self.panel - 40.0, 0.08 * _WIDTH
        self.plotter.add_scalar_bar(
            title="", mapper=self.mapper, color="black", n_labels=0, vertical=False, width=0.24,
            height=60 / self.panel, position_x=0.74, position_y=bottom / self.panel,
        )  # fmt: skip
        self._write("contact", (left, bottom + 26.0), 10)
        for k, name in enumerate(STATES):
            text = self._write(name, (left + (k + 0.5) * wide, bottom - 26.0), 10)
            text.prop.justification_horizontal = "center"

    def _add_loads(self) -> list[tuple[Any, FloatArray]]:
        """Curves of the loads with a mark each; returns the marks and the forces in their unit."""
        pyvista = needed("pyvista", "vtk")
        forces, marks = self.frames.forces, []
        unit, scale = prefixed_unit("N", forces.values())
        chart = pyvista.Chart2D(size=(0.7, 1.0 - 35 / self.panel), loc=(0.01, 0.01))
        colours = cycle(("#1a1a1a", "#9c1c00", "#2e6b2e", "#8d5fb0"))
        for (on, force), colour in zip(forces.items(), colours, strict=False):
            times, values = self.frames.load_times / self.time_scale, np.asarray(force) / scale
            if (band := envelope(times, values)) is None:
                chart.line(times, values, color=colour, width=2.0, label=on)
            else:
                chart.area(*band, color=pyvista.Color(colour, opacity=0.4), label=on)
            mark = chart.scatter([0.0], [0.0], color="#d11f1f", size=16, style="o")
            marks.append((mark, values))
        where = f" on {next(iter(forces))}" if len(forces) == 1 else ""
        chart.x_label, chart.y_label = f"time, {self.time_unit}", ""
        self._write(f"force{where}, {unit}", (0.02 * _WIDTH, self.panel - 38.0), 10)
        chart.legend_visible = len(forces) > 1
        chart.GetLegend().SetLabelSize(18)
        low = min(0.0, *(float(values.min(initial=0.0)) for _, values in marks))
        high = max(0.0, *(float(values.max(initial=0.0)) for _, values in marks))
        space = 0.15 * (high - low) or 1.0
        chart.y_range = (low - space, high + (4 if len(forces) > 1 else 1) * space)  # the legend's
        chart.background_color = chart.border_color = (1.0, 1.0, 1.0, 0.0)
        for axis in (chart.x_axis, chart.y_axis):
            axis.label_size, axis.tick_label_size, axis.grid = 20, 18, True
        self.plotter.add_chart(chart)
        return marks

    def _write(self, text: str, place: tuple[float, float], size: int) -> Any:
        """Write a text at a position in pixels from the lower left corner of the current panel.

        It takes the place of an earlier text there.
        """
        return self.plotter.add_text(
            text, position=place, font_size=size, color="black", name=f"text at {place}",
            render=False,
        )  # fmt: skip

    def show(self, frame: int, why: str = "") -> None:
        """Set everything to a frame; ``why`` says what is special about it."""
        for field in self.frames.fields:
            arrays = self.frames.arrays(field, frame)
            for drawn in self.drawn:
                if drawn.field is field:
                    self._move(drawn, arrays)
        time = self.frames.times[frame]
        now = [float(np.interp(time, self.frames.load_times, force)) for _, force in self.marks]
        largest = [np.abs(force).max(initial=0.0) for _, force in self.marks]
        if why and self.marks and max(map(abs, now)) <= 1e-3 * max(largest):
            why += ", no load then"
        text = f"t = {time / self.time_scale:.3f} {self.time_unit}{f' ({why})' if why else ''}"
        text += f"      displacement × {self.factor:g}"
        self.plotter.subplot(0, 0)
        self._write(text, (0.03 * _WIDTH, 12.0), 14)
        for (mark, _), force in zip(self.marks, now, strict=True):
            mark.update([time / self.time_scale], [force])
        for renderer in self.plotter.renderers:
            renderer.reset_camera_clipping_range()

    def _move(self, drawn: _Drawn, arrays: dict[str, Any]) -> None:
        """Move a block to a frame and colour it by its contact."""
        grid, surface = drawn.block.fill(arrays), drawn.surface
        points = grid.points + self.factor * np.asarray(grid["displacement"])
        for mesh in (surface, drawn.edges):
            mesh.points = points[mesh.point_data["vtkOriginalPointIds"]]
        cells = surface.cell_data["vtkOriginalCellIds"]
        surface.cell_data["state"] = grid.cell_data["contact_state"][cells].astype(float)
