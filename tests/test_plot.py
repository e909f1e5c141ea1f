"""Pictures show the data they are given, with units, and are written whole or not at all."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from bars import LapJoint
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from skfem_joint import plot
from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.pod import ProperModes, proper_modes
from skfem_joint.recording import Run, Save

ROWS = 50
JOINT = LapJoint(elements=20)
STEP = 1.0 / JOINT.frequency / ROWS


@pytest.fixture(scope="module")
def runs() -> dict[str, Run]:
    system = JOINT.system
    full = integrate(system, step=STEP, n_steps=3 * ROWS, cycle_steps=ROWS, save=Save(fields=True))
    reduced = system.project(proper_modes(full.u).modes[:, :3])
    return {
        "full": full,
        "reduced": integrate(reduced, step=STEP, n_steps=3 * ROWS, cycle_steps=ROWS),
    }


@pytest.fixture(scope="module")
def proper(runs: dict[str, Run]) -> ProperModes:
    return proper_modes(runs["full"].u)


@pytest.fixture(scope="module")
def figures(runs: dict[str, Run], proper: ProperModes) -> dict[str, Figure]:
    xi = np.linspace(0.0, 1.0, proper.modes.shape[0])
    totals = {name: integrate(run.system, step=STEP, n_steps=30) for name, run in runs.items()}
    return {
        "histories": plot.histories_figure(runs, ["free_end"]),
        "hysteresis": plot.hysteresis_figure(runs, "free_end", cycle_rows=ROWS),
        "modes": plot.proper_orthogonal_modes_figure(xi, proper.modes, proper),
        "values": plot.proper_values_figure(proper),
        "cycles": plot.energies_figure(runs),
        "totals": plot.energies_figure(totals),
    }


def png_size(path: Path) -> tuple[int, int]:
    """Width and height from the header of a PNG."""
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", head[16:24])
    return width, height


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("histories", ["time, ms", "displacement, µm"]),
        ("hysteresis", ["displacement of free_end, µm", "force on free_end, kN"]),
        ("modes", ["position on the active length, ξ (1 = loaded end)"]),
        ("values", ["proper value, % of the sum", "cumulative sum, %", "number of the mode"]),
        ("cycles", ["work in the cycle, J", "cycle"]),
        ("totals", ["energy over the run, J"]),
    ],
)
def test_axes_carry_quantity_and_unit(
    figures: dict[str, Figure], name: str, labels: list[str]
) -> None:
    panels = figures[name].axes
    found = {text for panel in panels for text in (panel.get_xlabel(), panel.get_ylabel())}
    assert set(labels) <= found
    assert all(panel.get_ylabel() for panel in panels)


@pytest.mark.parametrize("name", ["histories", "hysteresis", "modes", "values", "cycles", "totals"])
def test_nothing_written_in_a_picture_overlaps_or_is_cut(
    figures: dict[str, Figure], name: str
) -> None:
    figure = figures[name]
    figure.draw_without_rendering()
    boxes = [legend.get_window_extent() for legend in figure.legends]
    for panel in figure.axes:
        boxes += [panel.xaxis.label.get_window_extent(), panel.yaxis.label.get_window_extent()]
        boxes += [panel.get_window_extent()]
    boxes = [box for box in boxes if box.width > 0.0 and box.height > 0.0]
    for i, box in enumerate(boxes):
        assert figure.bbox.x0 <= box.x0
        assert box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0
        assert box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other) for other in boxes[i + 1 :])


def test_histories_draw_the_stored_displacement(
    figures: dict[str, Figure], runs: dict[str, Run]
) -> None:
    lines = figures["histories"].axes[0].get_lines()
    assert [line.get_label() for line in lines] == ["full", "reduced"]
    for line, run in zip(lines, runs.values(), strict=True):
        np.testing.assert_allclose(line.get_xdata(), 1e3 * run.times)
        np.testing.assert_allclose(line.get_ydata(), 1e6 * run.point("free_end"))


def test_full_is_solid_reduced_broken_and_both_differ_in_grey(
    figures: dict[str, Figure], runs: dict[str, Run]
) -> None:
    swapped = plot.histories_figure({n: runs[n] for n in ("reduced", "full")}, ["free_end"])
    for figure in (figures["histories"], swapped):
        full, reduced = sorted(figure.axes[0].get_lines(), key=lambda line: line.get_label())
        assert (full.get_linestyle(), reduced.get_linestyle()) == ("-", "--")
        grey = [np.dot([0.2126, 0.7152, 0.0722], to_rgb(c.get_color())) for c in (full, reduced)]
        assert abs(grey[0] - grey[1]) > 0.3


def test_the_area_of_the_drawn_loop_is_the_work_put_in_by_the_last_cycle(
    figures: dict[str, Figure], runs: dict[str, Run]
) -> None:
    for line, run in zip(figures["hysteresis"].axes[0].get_lines(), runs.values(), strict=True):
        assert len(line.get_xdata()) == ROWS + 1
        u, force = 1e-6 * np.asarray(line.get_xdata()), 1e3 * np.asarray(line.get_ydata())
        work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(u))
        assert work == pytest.approx(run.cycles.input[-1].sum(), rel=1e-9)


def test_a_run_shorter_than_a_cycle_is_drawn_whole(runs: dict[str, Run]) -> None:
    figure = plot.hysteresis_figure(runs, "free_end", cycle_rows=1000)
    assert len(figure.axes[0].get_lines()[0].get_xdata()) == 3 * ROWS + 1


def test_five_modes_with_largest_value_one_and_their_proper_values(
    figures: dict[str, Figure], proper: ProperModes
) -> None:
    figure = figures["modes"]
    lines = [line for line in figure.axes[0].get_lines() if not line.get_label().startswith("_")]
    assert len(lines) == 5
    for k, line in enumerate(lines):
        shape = np.asarray(line.get_ydata())
        assert np.abs(shape).max() == pytest.approx(1.0)
        assert shape.max() == pytest.approx(1.0)
        overlap = shape @ proper.modes[:, k] / np.linalg.norm(shape)
        assert abs(overlap) == pytest.approx(1.0)
        assert line.get_label() == f"{k + 1}: {proper.proper_values[k]:.3g} %"
    assert len({str(line.get_linestyle()) + str(line.get_color()) for line in lines}) == 5


def test_proper_values_are_bars_and_their_sums_a_line(
    figures: dict[str, Figure], proper: ProperModes
) -> None:
    left, right = figures["values"].axes
    heights = [bar.get_height() for bar in left.patches]
    assert left.get_yscale() == "log"
    np.testing.assert_allclose(heights, proper.proper_values[: len(heights)])
    np.testing.assert_allclose(right.get_lines()[0].get_ydata(), np.cumsum(heights))


def test_vanishing_proper_values_are_left_out() -> None:
    figure = plot.proper_values_figure(ProperModes(np.eye(3), np.array([3.0, 1.0, 0.0])))
    assert [bar.get_height() for bar in figure.axes[0].patches] == [75.0, 25.0]


def test_the_works_drawn_for_the_whole_run_close_the_balance(figures: dict[str, Figure]) -> None:
    containers = figures["totals"].axes[0].containers
    assert [bars.get_label() for bars in containers] == ["full", "reduced"]
    for bars in containers:
        work, *others = bars.datavalues
        assert sum(others) == pytest.approx(work, rel=1e-9)


def test_the_works_drawn_for_cycles_are_those_of_the_run(
    figures: dict[str, Figure], runs: dict[str, Run]
) -> None:
    panels = {panel.get_title(loc="left"): panel for panel in figures["cycles"].axes}
    assert set(panels) == {"input", "friction", "viscous", "scheme"}
    lines = {line.get_label(): line for line in panels["friction"].get_lines()}
    for name, run in runs.items():
        np.testing.assert_array_equal(lines[name].get_xdata(), [1, 2, 3])
        np.testing.assert_allclose(lines[name].get_ydata(), run.cycles.friction)


@pytest.mark.parametrize(
    ("frequency", "unit"), [(1e-2, "s"), (1.0, "s"), (20.0, "ms"), (2e4, "µs"), (5e6, "µs")]
)
def test_the_time_axis_has_a_unit_that_suits_it(frequency: float, unit: str) -> None:
    system = LapJoint(elements=2, load=Harmonic(1.0, frequency)).system
    run = integrate(system, step=1.0 / frequency / 10, n_steps=10 if frequency < 1e6 else 50)
    panel = plot.histories_figure({"full": run}, ["free_end"]).axes[0]
    assert panel.get_xlabel() == f"time, {unit}"
    assert 1.0 <= panel.get_xlim()[1] <= 1000.0


def test_pictures_are_written_with_the_size_of_their_figure_and_nothing_else_is(
    tmp_path: Path, runs: dict[str, Run], proper: ProperModes, figures: dict[str, Figure]
) -> None:
    xi = np.linspace(0.0, 1.0, proper.modes.shape[0])
    folder = tmp_path / "pictures"
    folder.mkdir()
    written = {
        "histories": plot.histories(folder / "a.png", runs, ["free_end"]),
        "hysteresis": plot.hysteresis(folder / "b.png", runs, "free_end", cycle_rows=ROWS),
        "modes": plot.proper_orthogonal_modes(folder / "c.png", xi, proper.modes, proper),
        "values": plot.proper_values(folder / "d.png", proper),
        "cycles": plot.energies(str(folder / "e.png"), runs),
    }
    assert sorted(folder.iterdir()) == sorted(written.values())
    for name, path in written.items():
        inches = figures[name].get_size_inches()
        assert png_size(path) == tuple(int(x * plot.DPI) for x in inches)
        pixels = matplotlib.image.imread(path)
        assert pixels.std() > 0.02  # not an empty page


def test_an_interruption_leaves_the_old_picture_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, proper: ProperModes
) -> None:
    path = plot.proper_values(tmp_path / "a.png", proper)
    before = path.read_bytes()

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("skfem_joint.files.os.replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        plot.proper_values(path, proper)
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == before


def test_a_place_that_cannot_be_written_is_an_input_error(
    tmp_path: Path, proper: ProperModes
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        plot.proper_values(tmp_path / "file" / "a.png", proper)
    with pytest.raises(InputError, match=r"a\.png: cannot be written: No such file or directory"):
        plot.proper_values(tmp_path / "missing" / "a.png", proper)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda runs: plot.histories_figure(runs, ["tip"]), "no point named 'tip'.*free_end"),
        (lambda runs: plot.histories_figure(runs, []), "at least one"),
        (lambda runs: plot.histories_figure({}, ["free_end"]), "at least one"),
        (lambda runs: plot.hysteresis_figure(runs, "free_end", 1), "no load 1"),
        (lambda runs: plot.hysteresis_figure(runs, "free_end", -1), "no load -1"),
        (lambda runs: plot.hysteresis_figure(runs, "free_end", 0, 0), "cycle_rows"),
        (lambda runs: plot.energies_figure({}), "at least one"),
    ],
)
def test_mistakes_are_input_errors(
    runs: dict[str, Run], draw: Callable[[dict[str, Run]], Figure], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        draw(runs)


def test_modes_that_do_not_fit_their_positions_are_an_input_error(proper: ProperModes) -> None:
    with pytest.raises(InputError, match="must be \\(points, modes\\)"):
        plot.proper_orthogonal_modes_figure(np.linspace(0.0, 1.0, 7), proper.modes, proper)


def test_a_run_that_stored_no_points_is_an_input_error() -> None:
    run = integrate(JOINT.system, step=STEP, n_steps=2, save=Save(points=False))
    with pytest.raises(InputError, match="stored no points"):
        plot.histories_figure({"full": run}, ["free_end"])


def test_without_matplotlib_the_message_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, proper: ProperModes
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match=r"pip install 'skfem-joint\[plot\]'"):
        plot.proper_values_figure(proper)


def test_plotting_leaves_the_global_state_of_matplotlib_alone() -> None:
    code = (
        "import sys, numpy as np, io, pathlib, tempfile\n"
        "from skfem_joint import plot, vtk\n"
        "from skfem_joint.pod import ProperModes\n"
        "heavy = ('matplotlib', 'pyvista', 'vtkmodules')\n"
        "assert not any(name in sys.modules for name in heavy)\n"
        "with tempfile.TemporaryDirectory() as folder:\n"
        "    modes = ProperModes(np.eye(2), np.array([2.0, 1.0]))\n"
        "    plot.proper_values(pathlib.Path(folder) / 'a.png', modes)\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
