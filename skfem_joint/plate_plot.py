"""Pictures of plates: the warped joint with the load beside it, and where its contact has slipped.

``still`` and ``animation`` draw what ``examples/paraview_joint.py`` shows in ParaView, through
pyvista and without a display; ``active_region`` draws one contact with matplotlib.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.files import replacing
from skfem_joint.offscreen import offscreen
from skfem_joint.plate import PlateStructure
from skfem_joint.plate_vtk import (
    Block,
    Contact,
    LoadHistory,
    PlateField,
    field_problems,
    filled,
    plate_blocks,
)
from skfem_joint.plot import new_figure, prefixed_unit, save_figure
from skfem_joint.vtk_files import needed_pyvista

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.tri import Triangulation

FloatArray = NDArray[np.float64]

#: What can be drawn in colour, with its unit.
QUANTITIES = {
    "slip_state": "",
    "displacement": "m",
    "velocity": "m/s",
    "friction_traction": "Pa",
    "pressure": "Pa",
    "friction_work_density": "J/m²",
}

#: Colours of -1 no contact, 0 stick, 1 slip; they differ in grey too.
STATES = {"no contact": "#d5d8dc", "stick": "#2f6db3", "slip": "#f08a24"}

#: Largest displacement in the picture, as a share of the plates' length.
SHARE = 0.05

_WIDTH = 1400  # pixels
_TITLE = 70  # pixels above the plates
_PANEL, _BAR = 300, 150  # pixels below them, with and without a load
_TALLEST = 760  # pixels for the plates
_LABEL, _SPACE = 44, 30  # pixels above each model for its name, and between models
_VIEW = np.array([0.0, -0.55, 0.85]) / np.hypot(0.55, 0.85)  # from the plates to the eye
_UP = np.cross(_VIEW, [1.0, 0.0, 0.0])
_LOADS = ("#1a1a1a", "#9c1c00", "#2e6b2e", "#8d5fb0")


def warp_factor(fields: Sequence[PlateField], nodes: FloatArray, share: float = SHARE) -> float:
    """Scale of the displacements that makes the largest a ``share`` of the length: 1, 2 or 5e n."""
    largest = max(float(np.abs(field.displacement).max(initial=0.0)) for field in fields)
    if largest == 0.0:
        return 1.0
    wanted = share * float(np.ptp(nodes, axis=0).max()) / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted))


def still(
    path: str | Path,
    structure: PlateStructure,
    times: FloatArray,
    fields: Sequence[PlateField],
    pressure: FloatArray,
    *,
    time: float | None = None,
    quantity: str = "slip_state",
    load: LoadHistory | None = None,
    factor: float | None = None,
) -> Path:
    """Draw one frame of one or more models as a PNG, the models below or beside each other.

    Parameters
    ----------
    path : str or Path
        Ending in ".png".
    structure, times, fields, pressure
        As for :func:`skfem_joint.plate_vtk.write_series`.
    time : float, optional
        The frame nearest to it, s; the one with the largest displacement if not given.
    quantity : str
        What the colour shows, of `QUANTITIES`; vectors by their length.
    load : LoadHistory, optional
        Drawn below the plates, with a mark at the frame.
    factor : float, optional
        Scale of the displacements; from :func:`warp_factor` if not given.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        Arrays that do not fit, an unknown quantity, no GL library to draw with, a path that cannot
        be written, or pyvista is missing.
    """
    file = _ending(path, ".png")
    with _picture(structure, times, fields, pressure, quantity, load, factor) as picture:
        if time is None:
            frame = int(np.abs(fields[0].displacement[: len(times)]).max(axis=(1, 2)).argmax())
        else:
            frame = int(np.abs(np.asarray(times) - time).argmin())
        picture.show(frame)
        with replacing(file) as temporary:
            picture.plotter.screenshot(temporary)
    return file


def animation(
    path: str | Path,
    structure: PlateStructure,
    times: FloatArray,
    fields: Sequence[PlateField],
    pressure: FloatArray,
    *,
    quantity: str = "slip_state",
    load: LoadHistory | None = None,
    factor: float | None = None,
    frames: int = 60,
    frames_per_second: float = 15.0,
) -> Path:
    """Draw at most ``frames`` evenly spread frames as a GIF; the rest as for :func:`still`.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        As for :func:`still`, for fewer than one frame, or if imageio is missing.
    """
    file = _ending(path, ".gif")
    if frames < 1 or not frames_per_second > 0.0:
        raise InputError(
            f"frames, frames_per_second: found {frames}, {frames_per_second}; must be positive"
        )
    if importlib.util.find_spec("imageio") is None:
        raise InputError(
            "animations need imageio: pip install 'skfem-joint[gif]', or switch them off"
        )
    with _picture(structure, times, fields, pressure, quantity, load, factor) as picture:
        chosen = np.unique(np.linspace(0, len(times) - 1, frames).round().astype(int))
        with replacing(file) as temporary:
            picture.plotter.open_gif(str(temporary), fps=frames_per_second, subrectangles=True)
            for frame in chosen:
                picture.show(int(frame))
                picture.plotter.write_frame()
            picture.plotter.mwriter.close()
    return file


@dataclass
class _Body:
    """One body of one model in the picture."""

    field: PlateField
    block: Block
    surface: Any
    edges: Any
    shift: FloatArray


class _Picture:
    """The plates, the load's curve and the texts; ``show`` sets them to a frame."""

    def __init__(
        self,
        plotter: Any,
        structure: PlateStructure,
        times: FloatArray,
        fields: Sequence[PlateField],
        pressure: FloatArray,
        quantity: str,
        load: LoadHistory | None,
        factor: float,
    ) -> None:
        self.plotter, self.times, self.fields = plotter, times, fields
        self.pressure, self.quantity, self.factor = pressure, quantity, factor
        self.contact = Contact(structure)
        self.load = load
        self.scale, self.title = 1.0, ""
        plotter.set_background("white")
        self._add_plates(structure)
        self._add_colours()
        self.marks = self._add_load() if load is not None else []

    def _add_plates(self, structure: PlateStructure) -> None:
        """Lay the models out in the window, aim the camera at them, and add their bodies."""
        limits, blocks = self._limits(), plate_blocks(structure)
        low, high = self._extents(blocks)
        (wide, tall), n = high - low, len(self.fields)
        label = _LABEL if n > 1 else 0
        layouts = []
        for columns, rows in ((1, n), (n, 1)):
            room = 0.94 * _WIDTH - (columns - 1) * _SPACE
            height = _TALLEST - rows * label - (rows - 1) * _SPACE
            layouts.append((max(columns * wide / room, rows * tall / height), columns, rows))
        pixel, columns, rows = min(layouts)  # world length of a pixel
        right, down = wide + _SPACE * pixel, tall + (_SPACE + label) * pixel
        beside = columns > 1
        self.bodies: list[_Body] = []
        self._aim(
            np.array([low[0], low[1] - (rows - 1) * down]),
            np.array([high[0] + (columns - 1) * right, high[1] + label * pixel]),
            pixel,
        )
        for k, field in enumerate(self.fields):
            place = np.array([k * right, 0.0] if beside else [0.0, -k * down])
            shift = np.array([place[0], place[1] / _UP[1], 0.0])
            if n > 1:
                self._add_label(field.name, np.array([low[0], high[1]]) + place)
            for block in blocks if k == 0 else plate_blocks(structure):
                self._add_body(field, block, shift, limits)

    def _extents(self, blocks: Sequence[Block]) -> tuple[FloatArray, FloatArray]:
        """Least and largest coordinates across and up the picture that a model reaches."""
        low, high = np.full(2, np.inf), np.full(2, -np.inf)
        for block in blocks:
            points = np.asarray(block.grid.points)
            still = np.column_stack([points[:, 0], points @ _UP])
            low, high = np.minimum(low, still.min(axis=0)), np.maximum(high, still.max(axis=0))
            for field in self.fields:
                moves = field.displacement[: len(self.times), block.nodes]
                moves = self.factor * moves * [1.0, _UP[1]]
                low = np.minimum(low, (still + moves.min(axis=0)).min(axis=0))
                high = np.maximum(high, (still + moves.max(axis=0)).max(axis=0))
        return low, high

    def _add_body(
        self, field: PlateField, block: Block, shift: FloatArray, limits: tuple[float, float]
    ) -> None:
        grid = block.grid
        grid.point_data["point"] = np.arange(grid.n_points)
        grid.cell_data["cell"] = np.arange(grid.n_cells)
        surface = grid.extract_surface(algorithm="dataset_surface")
        edges = surface.extract_feature_edges(30.0, manifold_edges=False)
        still_edges = edges.copy()
        still_edges.points = np.asarray(edges.points) + shift
        self.plotter.add_mesh(still_edges, color="#9aa0a6", line_width=1)
        self.bodies.append(_Body(field, block, surface, edges, shift))
        if self.quantity == "slip_state":
            surface.cell_data["colour"] = np.zeros(surface.n_cells)
            colours: dict[str, Any] = {
                "cmap": list(STATES.values()),
                "annotations": dict(zip((-1.0, 0.0, 1.0), STATES, strict=True)),
            }
        else:
            surface.point_data["colour"] = np.zeros(surface.n_points)
            colours = {"cmap": "viridis"}
        actor = self.plotter.add_mesh(
            surface, scalars="colour", clim=limits, show_scalar_bar=False, ambient=0.5,
            diffuse=0.55, **colours,
        )  # fmt: skip
        self.mapper = actor.mapper
        self.plotter.add_mesh(edges, color="black", line_width=2)

    def _add_label(self, text: str, corner: FloatArray) -> None:
        """Write a model's name above the left upper corner of what it reaches."""
        x, y = (corner - self.origin) / self.pixel
        self.plotter.add_text(
            text, position=(float(x), float(y) + 8.0), font_size=13, color="black",
            name=f"model {text}", render=False,
        )  # fmt: skip

    def _limits(self) -> tuple[float, float]:
        """Range of the colours over all frames, in the unit of the scale."""
        if self.quantity == "slip_state":
            self.title = "contact"
            return -1.5, 1.5
        name = {"friction_traction": "traction", "friction_work_density": "friction_work"}
        if self.quantity == "pressure":
            arrays = [self.pressure]
        else:
            arrays = [getattr(f, name.get(self.quantity, self.quantity)) for f in self.fields]
        sizes = [np.linalg.norm(a, axis=-1) if a.ndim == 3 else np.abs(a) for a in arrays]
        unit, self.scale = prefixed_unit(QUANTITIES[self.quantity], sizes)
        self.title = f"{self.quantity.replace('_', ' ')}, {unit}"
        largest = max(float(size.max(initial=0.0)) for size in sizes) / self.scale
        return 0.0, largest if largest > 0.0 else 1.0

    def _aim(self, low: FloatArray, high: FloatArray, pixel: float) -> None:
        """Set the window's size and the camera for a rectangle in the plane of the picture."""
        panel = _PANEL if self.load is not None else _BAR
        middle = int(np.clip(np.ceil((high[1] - low[1]) / pixel), 160, _TALLEST))
        self.size = (_WIDTH, (_TITLE + middle + panel + 1) // 2 * 2)
        self.plotter.window_size = self.size
        across, up = 0.5 * (low + high)
        # The plates' middle lies above the window's by half of what the panel has over the title.
        up -= 0.5 * (panel - _TITLE) * pixel
        self.pixel = pixel
        self.origin = np.array([across, up]) - 0.5 * pixel * np.array(self.size)
        centre = np.array([across, 0.0, 0.0]) + up * _UP
        camera = self.plotter.camera
        camera.parallel_projection = True
        camera.focal_point = centre
        camera.position = centre + 10.0 * (np.ptp([low, high], axis=0).sum() + abs(up)) * _VIEW
        camera.up = _UP
        camera.parallel_scale = 0.5 * self.size[1] * pixel

    def _add_colours(self) -> None:
        bottom = 100 if self.load is not None else 20
        self.plotter.add_scalar_bar(
            title=f"{self.title}\n ", mapper=self.mapper, color="black", fmt="%.3g",
            title_font_size=22, label_font_size=20,
            n_labels=0 if self.quantity == "slip_state" else 3, vertical=False,
            width=0.22, height=120 / self.size[1],
            position_x=0.75, position_y=bottom / self.size[1],
        )  # fmt: skip

    def _add_load(self) -> list[tuple[Any, FloatArray]]:
        """Curves of the loads with a mark each; returns the marks and the forces in their unit."""
        import pyvista

        assert self.load is not None
        forces = list(self.load.forces.values())
        unit, scale = prefixed_unit("N", forces)
        _, time_scale = self._time_unit()
        share = (_PANEL - 15) / self.size[1]
        chart = pyvista.Chart2D(size=(0.7, share), loc=(0.01, 0.005))
        marks = []
        for (on, force), colour in zip(self.load.forces.items(), cycle(_LOADS), strict=False):
            values = np.asarray(force) / scale
            chart.line(self.load.times / time_scale, values, color=colour, width=2.0, label=on)
            mark = chart.scatter([0.0], [0.0], color="#d11f1f", size=16, style="o")
            marks.append((mark, values))
        one = f" on {next(iter(self.load.forces))}" if len(forces) == 1 else ""
        chart.x_label, chart.y_label = f"time, {self._time_unit()[0]}", f"force{one}, {unit}"
        chart.legend_visible = len(forces) > 1
        largest = max(float(np.abs(values).max(initial=0.0)) for _, values in marks)
        chart.y_range = (-1.15 * largest, 1.15 * largest) if largest > 0.0 else (-1.0, 1.0)
        chart.background_color = (1.0, 1.0, 1.0, 0.0)
        chart.border_color = (1.0, 1.0, 1.0, 0.0)
        for axis in (chart.x_axis, chart.y_axis):
            axis.label_size, axis.tick_label_size = 20, 18
            axis.grid = True
        self.plotter.add_chart(chart)
        return marks

    def _time_unit(self) -> tuple[str, float]:
        return prefixed_unit("s", [np.asarray(self.times)])

    def show(self, frame: int) -> None:
        """Set everything to a frame."""
        for field in self.fields:
            values = self.contact.values(field, frame, self.pressure)
            for body in self.bodies:
                if body.field is not field:
                    continue
                grid = filled(body.block, values)
                points = np.asarray(grid.points) + self.factor * np.asarray(grid["displacement"])
                points += body.shift
                for part in (body.surface, body.edges):
                    part.points = points[np.asarray(part.point_data["point"])]
                self._colour(body)
        unit, scale = self._time_unit()
        time = self.times[frame]
        text = f"t = {time / scale:.3f} {unit}      displacement × {self.factor:g}"
        self.plotter.add_text(
            text, position=(0.03, 1.0 - 48 / self.size[1]), viewport=True, font_size=14,
            color="black", name="frame", render=False,
        )  # fmt: skip
        for mark, force in self.marks:
            assert self.load is not None
            mark.update([time / scale], [float(np.interp(time, self.load.times, force))])
        self.plotter.reset_camera_clipping_range()

    def _colour(self, body: _Body) -> None:
        surface, grid = body.surface, body.block.grid
        if self.quantity == "slip_state":
            state = np.asarray(grid.cell_data["contact_state"])[
                np.asarray(surface.cell_data["cell"])
            ]
            surface.cell_data["colour"] = state.astype(float)
            return
        values = np.asarray(grid.point_data[self.quantity])[np.asarray(surface.point_data["point"])]
        size = np.linalg.norm(values, axis=1) if values.ndim == 2 else values
        surface.point_data["colour"] = size / self.scale


@contextmanager
def _picture(
    structure: PlateStructure,
    times: FloatArray,
    fields: Sequence[PlateField],
    pressure: FloatArray,
    quantity: str,
    load: LoadHistory | None,
    factor: float | None,
) -> Iterator[_Picture]:
    times = np.asarray(times, dtype=float)
    problems = field_problems(structure, times.size, fields, pressure, "swept")
    if not fields or times.ndim != 1 or times.size == 0:
        problems.append("times and fields: there must be at least one of each to draw")
    if quantity not in QUANTITIES:
        problems.append(f"quantity: found {quantity!r}, must be one of {', '.join(QUANTITIES)}")
    if problems:
        raise InputError(problems)
    pyvista = needed_pyvista("pictures of plates")
    if factor is None:
        factor = warp_factor(fields, structure.nodes)
    with offscreen():
        plotter = pyvista.Plotter(off_screen=True, window_size=[_WIDTH, 800])
        try:
            yield _Picture(plotter, structure, times, fields, pressure, quantity, load, factor)
        finally:
            plotter.close()


def _ending(path: str | Path, ending: str) -> Path:
    file = Path(path)
    if file.suffix.lower() != ending:
        raise InputError(f"{file}: the name of this picture must end in {ending}")
    return file


def active_region_figure(
    structure: PlateStructure, joint: int, largest_slip: FloatArray, active: NDArray[np.bool_]
) -> Figure:
    """Contact coloured by its largest slip; see :func:`active_region`."""
    patch = structure.patches[joint]
    k = patch.nodes.size
    if np.shape(largest_slip) != (k,) or np.shape(active) != (k,):
        raise InputError(
            f"active region of {patch.joint.name!r}: found shapes {np.shape(largest_slip)} and "
            f"{np.shape(active)}, must be those of its {k} contact points"
        )
    active = np.asarray(active, dtype=bool)
    share = float(patch.area[active].sum() / (patch.area.sum() + patch.held_area))
    unit, scale = prefixed_unit("m", [largest_slip])
    slip = largest_slip / scale
    position = structure.nodes[patch.nodes]
    title = f"{patch.joint.name}: active on {100.0 * share:.1f} % of the area"
    if patch.joint.kind == "boundary":
        return _edge_figure(position, slip, active, title, unit)
    return _area_figure(structure, joint, slip, active, title, unit)


def _edge_figure(
    position: FloatArray, slip: FloatArray, active: NDArray[np.bool_], title: str, unit: str
) -> Figure:
    along = int(np.ptp(position, axis=0).argmax())
    order = np.argsort(position[:, along])
    place, slip, active = position[order, along], slip[order], active[order]
    figure = new_figure(7.5, 3.5)
    panel = figure.subplots()
    panel.fill_between(
        place, 0.0, 1.0, where=active, transform=panel.get_xaxis_transform(), color="#f08a24",
        alpha=0.3, linewidth=0.0, label="active",
    )  # fmt: skip
    panel.plot(place, slip, color="#1a1a1a", marker=".", label="largest slip")
    panel.set_xlabel(f"{'xy'[along]}, m")
    panel.set_ylabel(f"largest slip, {unit}")
    panel.set_title(title, loc="left")
    panel.set_ylim(bottom=0.0)
    panel.margins(x=0.0)
    panel.grid(alpha=0.3)
    panel.legend(loc="best")
    return figure


def _area_figure(
    structure: PlateStructure, joint: int, slip: FloatArray, active: NDArray[np.bool_],
    title: str, unit: str,
) -> Figure:  # fmt: skip
    patch = structure.patches[joint]
    nodes = np.concatenate([patch.nodes, patch.held_nodes])  # the held ones do not slip
    slip = np.concatenate([slip, np.zeros(patch.held_nodes.size)])
    active = np.concatenate([active, np.zeros(patch.held_nodes.size, dtype=bool)])
    number = np.full(structure.nodes.shape[0], -1, dtype=np.intp)
    number[nodes] = np.arange(nodes.size)
    cells = number[structure.cells]
    cells = cells[np.all(cells >= 0, axis=1)]
    triangles = cells if cells.shape[1] == 3 else np.vstack([cells[:, :3], cells[:, [0, 2, 3]]])
    x, y = structure.nodes[nodes].T
    wide, tall = np.ptp(x), np.ptp(y)
    figure = new_figure(8.0, float(np.clip(2.4 + 6.8 * tall / wide, 3.0, 9.0)))
    figure.set_layout_engine("compressed")
    from matplotlib.collections import LineCollection
    from matplotlib.tri import Triangulation

    panel = figure.subplots()
    grid = Triangulation(x, y, triangles)
    drawn = panel.tripcolor(grid, slip, shading="gouraud", cmap="viridis")
    if not active.all():
        panel.tricontourf(
            grid, active.astype(float), levels=[-1.0, 0.5], colors=["#ffffff"], alpha=0.75
        )
    border = _active_border(grid, active)
    for colour, width in (("#ffffff", 4.5), ("#d11f1f", 2.5)):
        if active.any() and not active.all():
            panel.tricontour(
                grid, active.astype(float), levels=[0.5], colors=colour, linewidths=width
            )
        panel.add_collection(
            LineCollection(border, colors=colour, linewidths=width, capstyle="round", zorder=2.5)
        )
    pad = 0.02 * max(wide, tall)
    panel.set_xlim(x.min() - pad, x.max() + pad)
    panel.set_ylim(y.min() - pad, y.max() + pad)
    panel.set_aspect("equal")
    panel.set_xlabel("x, m")
    panel.set_ylabel("y, m")
    figure.suptitle(f"{title} (outlined; the rest is faded)")
    figure.colorbar(drawn, ax=panel, label=f"largest slip, {unit}", location="bottom", aspect=40)
    return figure


def _active_border(grid: Triangulation, active: NDArray[np.bool_]) -> list[FloatArray]:
    """Parts of the mesh's outer border that are active, each with its two ends, shape (2, 2)."""
    triangle, side = np.nonzero(grid.neighbors == -1)
    ends = np.stack([grid.triangles[triangle, side], grid.triangles[triangle, (side + 1) % 3]], 1)
    ends = ends[active[ends].any(axis=1)]
    place = np.stack([grid.x, grid.y], axis=1)[ends]
    middle = place.mean(axis=1, keepdims=True)
    return list(np.where(active[ends][..., np.newaxis], place, middle))


def active_region(
    path: str | Path,
    structure: PlateStructure,
    joint: int,
    largest_slip: FloatArray,
    active: NDArray[np.bool_],
) -> Path:
    """Draw where a contact has slipped: an area from above, a boundary as a curve along it.

    Parameters
    ----------
    path : str or Path
        PNG file.
    structure : PlateStructure
    joint : int
        Which of the structure's joints, counted from 0.
    largest_slip : ndarray, shape (k,)
        Largest norm of the slip displacement at the joint's contact points, m.
    active : ndarray of bool, shape (k,)
        Which of them belong to the active region; its share of the contact's area stands in the
        title.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        Arrays that do not fit, a path that cannot be written, or matplotlib is missing.
    """
    return save_figure(path, active_region_figure(structure, joint, largest_slip, active))
