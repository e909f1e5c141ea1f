"""Pictures of joints: the warped bodies with the load beside them, as a still and as a film.

They show what ``examples/paraview_joint.py`` shows in ParaView, through pyvista, without a display.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import InputError
from skfem_joint.files import needed, replacing
from skfem_joint.output.fields import Field, Frames
from skfem_joint.output.plots import envelope, prefixed_unit
from skfem_joint.output.series import Block, blocks_of, faces_of
from skfem_joint.processes import SAFE_PATH
from skfem_joint.structure import Structure

#: Colours of -1 no contact, 0 stick, 1 slip; they differ in grey too.
STATES = {"no contact": "#d5d8dc", "stick": "#2f6db3", "slip": "#f08a24"}
#: Largest displacement in the picture, as a share of the structure's length.
SHARE = 0.05

_BETWEEN = 0.05  # of the width, between bodies and their faces
_SPEED = 15.0  # frames a second of a film
_WIDTH = 1400  # pixels
_TITLE = 70  # pixels above the bodies
_PANEL, _BAR = 300, 150  # pixels below them, with and without a load
_TALLEST = 760  # pixels for the bodies
_LABEL, _SPACE = 44, 30  # pixels above each model for its name, and between models
_VIEW = np.array([0.0, -0.55, 0.85]) / np.hypot(0.55, 0.85)  # from the bodies to the eye
# Across and up the picture, (3, 2).
_PLANE = np.stack([[1.0, 0.0, 0.0], np.cross(_VIEW, [1.0, 0.0, 0.0])], axis=1)
_LOADS = ("#1a1a1a", "#9c1c00", "#2e6b2e", "#8d5fb0")

_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
#: Kinds of window without a display, best first, as VTK names them; "" is VTK's own choice.
_WINDOWS = ("vtkOSOpenGLRenderWindow", "vtkEGLRenderWindow", "")
# VTK looks up its GL library when it draws first, and ends the process if there is none.
_PROBE = """
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
import vtkmodules.vtkRenderingOpenGL2
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.SetSize(8, 8)
window.AddRenderer(vtkRenderer())
window.Render()
print("drawn" if window.SupportsOpenGL() else "no OpenGL")
"""


@contextmanager
def offscreen() -> Iterator[None]:
    """Let VTK draw into memory while the block runs.

    Which kind of window works is tried out in a process of its own, once: a second. A choice that
    the environment variable ``VTK_DEFAULT_OPENGL_WINDOW`` makes is kept. InputError if none works.
    """
    chosen = os.environ.get(_VARIABLE)
    window = _working_window(chosen, os.environ.get("DISPLAY", ""))
    if window is None:
        why = f" ({_VARIABLE} = {chosen!r} does not work)" if chosen else ""
        raise InputError(
            f"pictures: VTK cannot draw here{why}: there is no display and no GL library that does "
            "without; install OSMesa (Debian: apt-get install libosmesa6) or EGL (libegl1 "
            "libgl1-mesa-dri), or switch pictures off and open the series in ParaView elsewhere"
        )
    if window:
        os.environ[_VARIABLE] = window
    try:
        yield
    finally:
        if not chosen:
            os.environ.pop(_VARIABLE, None)


@cache
def _working_window(chosen: str | None, display: str) -> str | None:
    """Kind of window that draws."""
    # With a display, and on systems that always have one, VTK's own choice is the right one.
    own = display or not sys.platform.startswith("linux")
    windows = (chosen,) if chosen else (_WINDOWS[::-1] if own else _WINDOWS)
    return next((window for window in windows if _draws(window)), None)


def _draws(window: str) -> bool:
    """Whether a process of its own can draw with a kind of window."""
    environment = {**os.environ, _VARIABLE: window}
    if not window:
        del environment[_VARIABLE]
    try:
        command = [sys.executable, SAFE_PATH, "-c", _PROBE]
        ended = subprocess.run(command, env=environment, capture_output=True, timeout=60.0)
    except (subprocess.TimeoutExpired, OSError):
        return False
    return ended.returncode == 0 and b"drawn" in ended.stdout


def warp_factor(frames: Frames) -> float:
    """Scale that makes the largest displacement a `SHARE` of the length: 1, 2 or 5e n."""
    largest = max(float(np.abs(one.displacement).max(initial=0.0)) for one in frames.fields)
    if largest == 0.0:
        return 1.0
    wanted = SHARE * float(np.ptp(frames.structure.positions, axis=0).max()) / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted))


def telling_frame(frames: Frames) -> tuple[int, str]:
    """Frame with most slip, else of largest displacement, and why it was taken.

    That of the second half of the run, which has settled, unless less than half as much slips
    there.
    """
    first, count = frames.fields[0], len(frames.times)
    slipping = np.count_nonzero(first.slip_state[:count] == 1, axis=1)
    if slipping.any():
        late = count // 2 if 2 * slipping[count // 2 :].max() >= slipping.max() else 0
        return late + int(slipping[late:].argmax()), "most slip"
    moves = np.abs(first.displacement[:count]).max(axis=(1, 2))
    return int(moves.argmax()), "largest displacement" if moves.any() else "nothing moves"


def still(path: str | Path, frames: Frames) -> None:
    """Draw the frame that tells most as a PNG: models side by side, forces below, with a mark.

    The faces on which solids are pressed lie below each model once more, level, alone.

    InputError without a GL library or pyvista, and for a path that cannot be written.
    """
    with _picture(path, frames) as (temporary, picture):
        picture.show(*telling_frame(frames))
        picture.plotter.screenshot(temporary)


def animation(path: str | Path, frames: Frames, *, most: int = 60) -> None:
    """Draw at most ``most`` evenly spread frames as a GIF; the rest as for :func:`still`."""
    needed("imageio", "gif")
    with _picture(path, frames) as (temporary, picture):
        chosen = np.unique(np.linspace(0, len(frames.times) - 1, most).round().astype(int))
        picture.plotter.open_gif(str(temporary), fps=_SPEED, subrectangles=True)
        for frame in chosen:
            picture.show(int(frame))
            picture.plotter.write_frame()
        picture.plotter.mwriter.close()


@contextmanager
def _picture(path: str | Path, frames: Frames) -> Iterator[tuple[Path, _Picture]]:
    """File that a picture is written to before it takes its place, and what it shows."""
    pyvista = needed("pyvista", "vtk")
    with offscreen():
        plotter = pyvista.Plotter(off_screen=True, window_size=[_WIDTH, 800])
        try:
            picture = _Picture(plotter, frames)
            with replacing(Path(path)) as temporary:
                yield temporary, picture
        finally:
            plotter.close()


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
class _Part:
    """A body of a model, or a face that is shown alone: turned, then moved."""

    block: Block
    turn: FloatArray  #: (3, 3)
    shift: FloatArray  #: (3,), m

    def placed(self, points: Any) -> FloatArray:
        """Where points (n, 3) are drawn."""
        return np.asarray(points @ self.turn.T + self.shift)


@dataclass
class _Body:
    """One part of one model in the picture."""

    field: Field
    part: _Part
    surface: Any
    edges: Any


def _level(structure: Structure, block: Block) -> _Part | None:
    """The face of a joint, turned to lie level; None of what is not pressed, only against it."""
    for patch in structure.patches:
        if block.label == f"contact {patch.joint.on}" and patch.normal is not None:
            normal = patch.normal.sum(axis=0)
            normal *= (1.0 if normal[2] >= 0.0 else -1.0) / (np.linalg.norm(normal) or 1.0)
            x, y, z = normal
            tilt = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
            turn = np.eye(3) + tilt + tilt @ tilt / (1.0 + z)
            middle = block.grid.points.mean(axis=0)
            return _Part(block, turn, middle - turn @ middle)
    return None


class _Picture:
    """The bodies, the loads' curves and the texts; ``show`` sets them to a frame."""

    def __init__(self, plotter: Any, frames: Frames) -> None:
        self.plotter, self.frames, self.factor = plotter, frames, warp_factor(frames)
        self.time_unit, self.time_scale = prefixed_unit("s", [np.asarray(frames.times)])
        self.bodies: list[_Body] = []
        plotter.set_background("white")
        self._add_bodies()
        self.marks = self._add_loads() if frames.forces else []

    def _add_bodies(self) -> None:
        """Lay the models out in the window, aim the camera at them, and add their bodies."""
        fields, structure = self.frames.fields, self.frames.structure
        parts, low, high, names = self._parts()
        n = len(fields)
        (wide, tall), label = high - low, _LABEL if n > 1 else 0
        layouts = []
        for columns, rows in ((1, n), (n, 1)):
            room = 0.94 * _WIDTH - (columns - 1) * _SPACE
            height = _TALLEST - rows * label - (rows - 1) * _SPACE
            layouts.append((max(columns * wide / room, rows * tall / height), columns, rows))
        pixel, columns, rows = min(layouts)  # world length of a pixel
        step = np.array([(columns > 1) * (wide + _SPACE * pixel), 0.0])
        if rows > 1:
            step[1] = -tall - (_SPACE + label) * pixel
        end = (n - 1) * step
        self._aim(low + np.minimum(end, 0.0), high + np.array([end[0], label * pixel]), pixel)
        for k, one in enumerate(fields):
            place = k * step
            if n > 1:
                x, y = (np.array([low[0], high[1]]) + place - self.origin) / pixel
                self._write(one.name, (x, y + 8.0), 13, f"model {one.name}")
            for name, at in names.items():
                x, y = (at + place - self.origin) / pixel
                self._write(name, (x, y + 4.0), 10, f"{one.name} {name}")
            shift = np.array([place[0], place[1] / _PLANE[1, 1], 0.0])
            for part in parts:
                mapper = self._add_body(one, replace(part, shift=part.shift + shift))
        if not structure.patches:
            return
        bottom = 100 if self.frames.forces else 40
        self.plotter.add_scalar_bar(
            title="", mapper=mapper, color="black", n_labels=0, vertical=False, width=0.24,
            height=60 / self.size[1], position_x=0.74, position_y=bottom / self.size[1],
        )  # fmt: skip
        self._write("contact", (0.74 * _WIDTH, bottom + 26.0), 10, "contact")
        for k, name in enumerate(STATES):
            x = (0.74 + 0.08 * (k + 0.5)) * _WIDTH
            self._write(name, (x, bottom - 26.0), 10, name).prop.justification_horizontal = "center"

    def _parts(self) -> tuple[list[_Part], FloatArray, FloatArray, dict[str, FloatArray]]:
        """Bodies and, below them, level faces; what they reach; the faces' names and places."""
        structure, names = self.frames.structure, {}
        parts = [_Part(block, np.eye(3), np.zeros(3)) for block in blocks_of(structure)]
        low, high = self._extents(parts)
        space = _BETWEEN * (high[0] - low[0])
        for face in (_level(structure, block) for block in faces_of(structure)):
            if face is not None:
                least, most = self._extents([face])
                down = low[1] - space - most[1]
                shift = np.array([0.0, down / _PLANE[1, 1], 0.0])
                parts.append(replace(face, shift=face.shift + shift))
                names[face.block.label] = np.array([least[0], most[1] + down])
                low = np.array([min(low[0], least[0]), least[1] + down])
                high[0] = max(high[0], most[0])
        return parts, low, high, names

    def _extents(self, parts: Sequence[_Part]) -> tuple[FloatArray, FloatArray]:
        """Least and largest coordinates across and up the picture that some parts reach."""
        in_space, count = self.frames.structure.body.in_space, len(self.frames.times)
        reached = []
        for one in self.frames.fields:
            u = self.factor * in_space(one.displacement[:count])
            for part in parts:
                moves = u[:, part.block.nodes] @ part.turn.T @ _PLANE
                at = part.placed(part.block.grid.points) @ _PLANE
                reached += [at + moves.min(axis=0), at + moves.max(axis=0)]
        points = np.concatenate(reached)
        return points.min(axis=0), points.max(axis=0)

    def _add_body(self, field: Field, part: _Part) -> Any:
        """Add a part, its edges and where they were; returns what gives it its colours."""
        surface = part.block.grid.extract_surface(algorithm="dataset_surface")
        edges = outline(surface)
        still_edges = edges.copy()
        still_edges.points = part.placed(np.asarray(edges.points))
        self.plotter.add_mesh(still_edges, color="#9aa0a6", line_width=1)
        self.bodies.append(_Body(field, part, surface, edges))
        surface.cell_data["state"] = np.zeros(surface.n_cells)
        actor = self.plotter.add_mesh(
            surface, scalars="state", clim=(-1.5, 1.5), show_scalar_bar=False, ambient=0.7,
            diffuse=0.35, cmap=list(STATES.values()),
        )  # fmt: skip
        self.plotter.add_mesh(edges, color="black", line_width=2)
        return actor.mapper

    def _aim(self, low: FloatArray, high: FloatArray, pixel: float) -> None:
        """Set the window's size and the camera for a rectangle in the plane of the picture."""
        panel = _PANEL if self.frames.forces else _BAR
        height = int(np.clip(np.ceil((high[1] - low[1]) / pixel), 160, _TALLEST))
        self.size = (_WIDTH, (_TITLE + height + panel + 1) // 2 * 2)
        self.plotter.window_size = self.size
        # The bodies' middle lies above the window's by half of what the panel has over the title.
        middle = 0.5 * (low + high) - [0.0, 0.5 * (panel - _TITLE) * pixel]
        self.origin = middle - 0.5 * pixel * np.array(self.size)
        centre, camera = _PLANE @ middle, self.plotter.camera
        camera.parallel_projection = True
        camera.focal_point = centre
        camera.position = centre + 10.0 * (np.ptp([low, high], axis=0).sum() + abs(high[1])) * _VIEW
        camera.up = _PLANE[:, 1]
        camera.parallel_scale = 0.5 * self.size[1] * pixel
        self.pixel = pixel

    def _add_loads(self) -> list[tuple[Any, FloatArray]]:
        """Curves of the loads with a mark each; returns the marks and the forces in their unit."""
        import pyvista

        forces, marks = self.frames.forces, []
        unit, scale = prefixed_unit("N", forces.values())
        chart = pyvista.Chart2D(size=(0.7, (_PANEL - 35) / self.size[1]), loc=(0.01, 0.005))
        for (on, force), colour in zip(forces.items(), cycle(_LOADS), strict=False):
            times, values = self.frames.load_times / self.time_scale, np.asarray(force) / scale
            if (band := envelope(times, values)) is None:
                chart.line(times, values, color=colour, width=2.0, label=on)
            else:
                chart.area(*band, color=pyvista.Color(colour, opacity=0.4), label=on)
            mark = chart.scatter([0.0], [0.0], color="#d11f1f", size=16, style="o")
            marks.append((mark, values))
        one = f" on {next(iter(forces))}" if len(forces) == 1 else ""
        chart.x_label, chart.y_label = f"time, {self.time_unit}", ""
        self._write(f"force{one}, {unit}", (0.02 * _WIDTH, _PANEL - 38.0), 10, "force")
        chart.legend_visible = len(forces) > 1
        chart.GetLegend().SetLabelSize(18)
        low = min(0.0, *(float(values.min(initial=0.0)) for _, values in marks))
        high = max(0.0, *(float(values.max(initial=0.0)) for _, values in marks))
        room = 0.15 * (high - low) or 1.0
        chart.y_range = (low - room, high + (1 + 3 * (len(forces) > 1)) * room)  # for the legend
        chart.background_color = chart.border_color = (1.0, 1.0, 1.0, 0.0)
        for axis in (chart.x_axis, chart.y_axis):
            axis.label_size, axis.tick_label_size, axis.grid = 20, 18, True
        self.plotter.add_chart(chart)
        return marks

    def _write(self, text: str, place: tuple[float, float], size: int, name: str) -> Any:
        """Write a text at pixels from the left lower corner; it replaces one of the same name."""
        return self.plotter.add_text(
            text, position=place, font_size=size, color="black", name=name, render=False
        )

    def show(self, frame: int, why: str = "") -> None:
        """Set everything to a frame; ``why`` says what is special about it."""
        for one in self.frames.fields:
            arrays = self.frames.arrays(one, frame)
            for body in (body for body in self.bodies if body.field is one):
                grid, surface = body.part.block.fill(arrays), body.surface
                moved = grid.points + self.factor * np.asarray(grid["displacement"])
                points = body.part.placed(moved)
                # Nearer to the eye, edges are not lost in the surface that they lie on.
                for part, nearer in ((surface, 0.0), (body.edges, 2.0 * self.pixel)):
                    at = np.asarray(part.point_data["vtkOriginalPointIds"])
                    part.points = points[at] + nearer * _VIEW
                state = np.asarray(grid.cell_data["contact_state"])[
                    surface.cell_data["vtkOriginalCellIds"]
                ]
                surface.cell_data["state"] = state.astype(float)
        time = self.frames.times[frame]
        now = [float(np.interp(time, self.frames.load_times, force)) for _, force in self.marks]
        largest = [np.abs(force).max(initial=0.0) for _, force in self.marks]
        if why and self.marks and max(map(abs, now)) <= 1e-3 * max(largest):
            why += ", no load then"
        text = f"t = {time / self.time_scale:.3f} {self.time_unit}{f' ({why})' if why else ''}"
        text += f"      displacement × {self.factor:g}"
        self._write(text, (0.03 * _WIDTH, self.size[1] - 48.0), 14, "frame")
        for (mark, _), force in zip(self.marks, now, strict=True):
            mark.update([time / self.time_scale], [force])
        self.plotter.reset_camera_clipping_range()
