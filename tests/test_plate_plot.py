"""Pictures of plates show what they are given, and no missing library ends the program silently."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from numpy.typing import NDArray

from skfem_joint import offscreen, plate_plot
from skfem_joint.errors import InputError
from skfem_joint.plate import PlateJoint, PlateStructure, build_plate_structure
from skfem_joint.plate_mesh import build_plate, merged
from skfem_joint.plate_vtk import LoadHistory, PlateField

TIMES = np.linspace(0.0, 4e-3, 9)
LOAD = LoadHistory(
    np.linspace(0.0, 4e-3, 200), {"end": 60e3 * np.sin(2 * np.pi * 250 * np.linspace(0, 4e-3, 200))}
)


def can_draw() -> bool:
    try:
        with offscreen.offscreen():
            return True
    except InputError:
        return False


draws = pytest.mark.skipif(not can_draw(), reason="no GL library: apt-get install libosmesa6")


@pytest.fixture(scope="module")
def lap() -> PlateStructure:
    lower = build_plate([("base", 0.2, 10), ("lower_joint", 0.1, 6)], 0.05, 4, prefix="lower_")
    upper = build_plate(
        [("joint", 0.1, 5), ("arm", 0.2, 10)], 0.05, 4, origin=(0.2, 0.0), prefix="upper_"
    )
    return build_plate_structure(
        merged([lower, upper]), E=200e9, poisson=0.3, density=8e3, thickness=0.01,
        supports=[("lower_left", "xy")],
        joints=[PlateJoint("joint", "region", "lower_joint", 50e6, 0.7)],
    )  # fmt: skip


@pytest.fixture(scope="module")
def side() -> PlateStructure:
    plate = build_plate([("bar", 0.2, 8)], 0.05, 2)
    return build_plate_structure(
        plate, E=200e9, poisson=0.3, density=8e3, thickness=0.01, supports=[("left", "xy")],
        joints=[PlateJoint("bottom", "boundary", None, 50e6, 0.7)],
    )  # fmt: skip


def pulled(structure: PlateStructure, name: str = "full") -> PlateField:
    """Stretched along x and waved across it; slips from the ends inwards as it is pulled."""
    x, y = structure.nodes.T
    amplitude = np.sin(2 * np.pi * 250 * TIMES)[:, None]
    u = np.stack([amplitude * 1e-4 * x, amplitude * 2e-5 * np.sin(9.0 * x) * y], axis=-1)
    patch = structure.patches[0]
    state = np.full(u.shape[:2], -1, dtype=np.int8)
    middle = np.abs(x[patch.nodes] - x[patch.nodes].mean())
    state[:, patch.nodes] = middle > 0.05 * (1.0 - 0.8 * np.abs(amplitude))
    traction = np.zeros_like(u)
    traction[:, patch.nodes, 0] = -35e6 * np.sign(amplitude)
    work = np.zeros(u.shape[:2])
    work[:, patch.nodes] = np.cumsum(state[:, patch.nodes] == 1, axis=0) * 7.0
    return PlateField(name, u, 2 * np.pi * 250 * u, traction, state, work)


def pressure(structure: PlateStructure) -> NDArray[np.float64]:
    p = np.zeros(structure.nodes.shape[0])
    p[structure.patches[0].nodes] = 50e6
    return p


def share_of(pixels: NDArray[np.float64], colour: str) -> float:
    """Share of a picture's pixels that have about a colour, lit or in shade."""
    wanted = np.array(matplotlib.colors.to_rgb(colour))
    close = np.linalg.norm(pixels[..., :3] - wanted, axis=-1) < 0.12
    return float(close.mean())


@draws
def test_a_still_shows_stick_slip_and_no_contact(tmp_path: Path, lap: PlateStructure) -> None:
    models = [pulled(lap), pulled(lap, "reduced")]
    path = plate_plot.still(
        tmp_path / "a.png", lap, TIMES, models, pressure(lap), load=LOAD, time=0.5e-3
    )
    pixels = matplotlib.image.imread(path)
    for colour in plate_plot.STATES.values():
        assert share_of(pixels, colour) > 0.005
    quiet = [pulled(lap)]
    quiet[0].slip_state[:, lap.patches[0].nodes] = 0
    plate_plot.still(tmp_path / "b.png", lap, TIMES, quiet, pressure(lap))
    stuck = matplotlib.image.imread(tmp_path / "b.png")
    # Only the legend's patch is left of "slip".
    bar = share_of(stuck, plate_plot.STATES["slip"]) * stuck[..., 0].size
    assert bar < 0.22 / 3 * stuck.shape[1] * 60
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]


@draws
@pytest.mark.parametrize("thickness", [1e-3, 0.05])
@pytest.mark.parametrize("width", [0.02, 0.3])
def test_models_and_their_names_lie_clear_of_each_other(thickness: float, width: float) -> None:
    made = build_plate_structure(
        build_plate([("bar", 0.2, 8)], width, 2), E=200e9, poisson=0.3, density=8e3,
        thickness=thickness, supports=[("left", "xy")],
        joints=[PlateJoint("bottom", "boundary", None, 50e6, 0.7)],
    )  # fmt: skip
    models = [pulled(made), pulled(made, "reduced")]
    inside = plate_plot._picture(made, TIMES, models, pressure(made), "slip_state", LOAD, None)
    with inside as picture:
        renderer, size = picture.plotter.renderer, picture.size
        boxes = {}
        for frame in range(TIMES.size):
            picture.show(frame)
            picture.plotter.render()
            for body in picture.bodies:
                pixels = []
                for point in np.asarray(body.surface.points):
                    renderer.SetWorldPoint(*point, 1.0)
                    renderer.WorldToDisplay()
                    pixels.append(renderer.GetDisplayPoint()[:2])
                low, high = np.min(pixels, axis=0), np.max(pixels, axis=0)
                assert np.all(low > 0.0)
                assert np.all(high < size)
                old = boxes.get(body.field.name, (low, high))
                boxes[body.field.name] = (np.minimum(low, old[0]), np.maximum(high, old[1]))
        for name in ("full", "reduced"):
            bounds = [0] * 4
            picture.plotter.actors[f"model {name}"].GetBoundingBox(renderer, bounds)
            right, height = bounds[1], bounds[3]
            left, top = boxes[name][0][0], boxes[name][1][1]
            origin = picture.plotter.actors[f"model {name}"].GetPosition()
            assert origin[0] == pytest.approx(left, abs=5.0)
            assert 0.0 < origin[1] - top < plate_plot._LABEL
            boxes[f"name {name}"] = (
                np.array(origin), np.array([origin[0] + right, origin[1] + height])
            )  # fmt: skip
    for one, other in combinations(boxes.values(), 2):
        assert np.any((one[1] < other[0]) | (other[1] < one[0]))


@draws
@pytest.mark.parametrize(
    ("quantity", "title", "largest"),
    [
        ("displacement", "displacement, µm", 50.0),
        ("velocity", "velocity, mm/s", 78.5),
        ("friction_traction", "friction traction, MPa", 35.0),
        ("pressure", "pressure, MPa", 50.0),
        ("friction_work_density", "friction work density, J/m²", 63.0),
    ],
)
def test_the_scale_has_the_unit_and_the_range_of_all_frames(
    lap: PlateStructure, quantity: str, title: str, largest: float
) -> None:
    inside = plate_plot._picture(lap, TIMES, [pulled(lap)], pressure(lap), quantity, None, None)
    with inside as picture:
        (bar,) = picture.plotter.scalar_bars.values()
        assert bar.GetTitle().strip() == title
        low, high = bar.GetLookupTable().GetTableRange()
        assert low == 0.0
        assert high == pytest.approx(largest, rel=0.02)


@draws
def test_the_mark_on_the_load_moves_with_the_frame(lap: PlateStructure) -> None:
    inside = plate_plot._picture(lap, TIMES, [pulled(lap)], pressure(lap), "slip_state", LOAD, None)
    with inside as picture:
        ((mark, _),) = picture.marks
        for frame in (2, 3):
            picture.show(frame)
            assert mark.x == pytest.approx([1e3 * TIMES[frame]])
            expected = 60.0 * np.sin(2 * np.pi * 250 * TIMES[frame])
            assert mark.y == pytest.approx([expected], abs=0.05)


@draws
def test_plates_are_drawn_where_they_have_moved_to(lap: PlateStructure) -> None:
    source = pulled(lap)
    inside = plate_plot._picture(lap, TIMES, [source], pressure(lap), "slip_state", None, 100.0)
    with inside as picture:
        picture.show(2)
        right = max(body.surface.bounds[1] for body in picture.bodies)
    assert right == pytest.approx(0.5 + 100.0 * source.displacement[2, :, 0].max())


@pytest.mark.parametrize("largest", [1e-9, 3.3e-5, 4e-5, 1.0])
def test_the_largest_displacement_is_drawn_as_a_fortieth_to_a_twentieth_of_the_length(
    lap: PlateStructure, largest: float
) -> None:
    source = pulled(lap)
    source.displacement[:] *= largest / np.abs(source.displacement).max()
    factor = plate_plot.warp_factor([source], lap.nodes)
    assert 0.4 * 0.05 * 0.5 <= factor * largest * (1 + 1e-12) <= 0.05 * 0.5 * (1 + 1e-9)
    assert f"{factor:.0e}"[0] in "125"


def test_nothing_moving_is_drawn_as_it_is(lap: PlateStructure) -> None:
    source = pulled(lap)
    source.displacement[:] = 0.0
    assert plate_plot.warp_factor([source], lap.nodes) == 1.0


@draws
def test_a_gif_has_the_frames_asked_for(tmp_path: Path, side: PlateStructure) -> None:
    from PIL import Image

    path = plate_plot.animation(
        tmp_path / "a.gif", side, TIMES, [pulled(side)], pressure(side), load=LOAD, frames=5
    )
    with Image.open(path) as picture:
        assert picture.n_frames == 5
        first = np.asarray(picture.convert("RGB"), dtype=float)
        picture.seek(1)
        second = np.asarray(picture.convert("RGB"), dtype=float)
    assert np.abs(first - second).max() > 50.0
    assert list(tmp_path.iterdir()) == [path]


def test_the_active_share_of_the_area_is_in_the_title(lap: PlateStructure) -> None:
    patch = lap.patches[0]
    x = lap.nodes[patch.nodes, 0]
    slip = 1e-6 * np.abs(x - 0.25)
    figure = plate_plot.active_region_figure(lap, 0, slip, x > 0.27)  # columns at 0.28 and 0.3
    panel, bar = figure.axes
    assert figure.get_suptitle() == (
        "joint: active on 30.0 % of the area (outlined; the rest is faded)"
    )
    assert bar.get_xlabel() == "largest slip, nm"
    contours = [c for c in panel.collections if len(getattr(c, "levels", [])) == 1]
    outline = np.vstack([path.vertices for path in contours[-1].get_paths()])
    np.testing.assert_allclose(outline[:, 0], 0.27)  # half way between the columns
    (border, _) = (c for c in panel.collections if isinstance(c, LineCollection))
    ends = np.array(border.get_segments())
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    assert length == pytest.approx(2 * 0.03 + 0.05)  # with the contour a closed line
    assert ends[..., 0].min() == pytest.approx(0.27)


@pytest.mark.parametrize(("length", "width"), [(0.1, 0.004), (0.1, 0.05), (0.05, 0.2)])
def test_title_and_axes_of_an_active_region_are_inside_its_picture(
    length: float, width: float
) -> None:
    made = build_plate_structure(
        build_plate([("joint", length, 6), ("arm", 0.1, 4)], width, 3), E=200e9, poisson=0.3,
        density=8e3, thickness=0.01, supports=[("right", "xy")],
        joints=[PlateJoint("joint", "region", None, 50e6, 0.7)],
    )  # fmt: skip
    k = made.patches[0].nodes.size
    figure = plate_plot.active_region_figure(made, 0, np.linspace(0, 1e-6, k), np.arange(k) < 9)
    FigureCanvasAgg(figure).draw()
    boxes = [panel.get_tightbbox() for panel in figure.axes]
    boxes += [text.get_window_extent() for text in figure.texts]
    assert len(boxes) == 3
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1


def test_the_active_part_of_an_edge_is_a_share_of_its_length(side: PlateStructure) -> None:
    patch = side.patches[0]
    slip = 1e-6 * side.nodes[patch.nodes, 0]
    figure = plate_plot.active_region_figure(side, 0, slip, np.ones(slip.size, dtype=bool))
    # All but the half element at the support.
    assert "93.8 %" in figure.axes[0].get_title(loc="left")
    assert figure.axes[0].get_xlabel() == "x, m"
    assert figure.axes[0].get_ylabel() == "largest slip, nm"


def test_the_active_region_is_written_as_a_png(tmp_path: Path, lap: PlateStructure) -> None:
    k = lap.patches[0].nodes.size
    path = plate_plot.active_region(
        tmp_path / "a.png", lap, 0, np.linspace(0.0, 1e-6, k), np.arange(k) > k / 2
    )
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", head[16:24])[0] > 800
    assert matplotlib.image.imread(path).std() > 0.02


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"quantity": "stress"}, "quantity: found 'stress'.*slip_state"),
        ({"path": "a.jpg"}, r"a\.jpg: .* must end in \.png"),
        ({"times": TIMES[:0]}, "at least one"),
        ({"pressure": np.ones(2)}, "pressure: found shape"),
        pytest.param({"path": "missing/a.png"}, "cannot be written", marks=draws),
    ],
)
def test_mistakes_are_input_errors(
    tmp_path: Path, lap: PlateStructure, change: dict[str, Any], message: str
) -> None:
    arguments: dict[str, Any] = {
        "path": "a.png", "structure": lap, "times": TIMES, "fields": [pulled(lap)],
        "pressure": pressure(lap), **change,
    }  # fmt: skip
    arguments["path"] = tmp_path / arguments["path"]
    with pytest.raises(InputError, match=message):
        plate_plot.still(**arguments)
    assert not list(tmp_path.iterdir())


def test_active_regions_that_do_not_fit_are_input_errors(lap: PlateStructure) -> None:
    with pytest.raises(InputError, match="'joint'"):
        plate_plot.active_region_figure(lap, 0, np.zeros(3), np.zeros(3, dtype=bool))


@pytest.mark.parametrize(
    ("library", "draw", "extra"),
    [("pyvista", plate_plot.still, "vtk"), ("imageio", plate_plot.animation, "gif")],
)
def test_without_a_library_the_message_names_the_extra(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    lap: PlateStructure,
    library: str,
    draw: Callable[..., Path],
    extra: str,
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    name = "a.gif" if library == "imageio" else "a.png"
    with pytest.raises(InputError, match=rf"pip install 'skfem-joint\[{extra}\]'"):
        draw(tmp_path / name, lap, TIMES, [pulled(lap)], pressure(lap))
    assert not list(tmp_path.iterdir())


def test_a_gl_library_that_ends_the_process_is_an_input_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lap: PlateStructure
) -> None:
    monkeypatch.setattr(
        offscreen, "_PROBE", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
    )
    monkeypatch.setattr(offscreen, "_found", {})
    with pytest.raises(InputError, match="libosmesa6"):
        plate_plot.still(tmp_path / "a.png", lap, TIMES, [pulled(lap)], pressure(lap))
    assert not list(tmp_path.iterdir())


def test_a_kind_of_window_that_vtk_does_not_have_is_not_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []

    def draws(window: str) -> bool:
        tried.append(window)
        return window == "vtkEGLRenderWindow"

    monkeypatch.setattr(offscreen, "_draws", draws)
    monkeypatch.setattr(offscreen, "_found", {})
    monkeypatch.delenv("VTK_DEFAULT_OPENGL_WINDOW", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    for _ in range(2):
        with offscreen.offscreen():
            assert os.environ["VTK_DEFAULT_OPENGL_WINDOW"] == "vtkEGLRenderWindow"
        assert "VTK_DEFAULT_OPENGL_WINDOW" not in os.environ
    assert tried == ["vtkOSOpenGLRenderWindow", "vtkEGLRenderWindow"]  # found once, then known


def test_the_users_choice_of_window_is_kept_or_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offscreen, "_draws", lambda window: window != "broken")
    monkeypatch.setattr(offscreen, "_found", {})
    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "mine")
    with offscreen.offscreen():
        assert os.environ["VTK_DEFAULT_OPENGL_WINDOW"] == "mine"
    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "broken")
    with pytest.raises(InputError, match="'broken' does not work"), offscreen.offscreen():
        pass


def test_importing_draws_in_no_heavy_library() -> None:
    code = (
        "import sys\n"
        "from skfem_joint import plate_plot, plate_vtk\n"
        "heavy = ('matplotlib', 'pyvista', 'vtkmodules', 'imageio')\n"
        "assert not any(name in sys.modules for name in heavy)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
