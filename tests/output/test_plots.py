"""Curves and maps show the data they are given, with units, and are written whole or not at all."""

import struct
from functools import cache

import matplotlib.image
import numpy as np
import pytest
from bodies import structure
from pictured import JOINT, bar, blocks, lap, side

import skfem_joint as sj
from skfem_joint.output import plots
from skfem_joint.reduction.pod import proper_decomposition
from skfem_joint.reduction.scaled.reference import lap_joint

ROWS = 50
FREQUENCY = 1000.0
STEP = 1.0 / FREQUENCY / ROWS


@cache
def system(elements: int = 20, frequency: float = FREQUENCY) -> sj.System:
    """The paper's lap joint, pulled at its end."""
    load = sj.Load("free_end", sj.Harmonic(63e3, frequency))
    return lap_joint(elements=elements, normal_force="consistent").system([load])


@pytest.fixture(scope="module")
def runs():
    options = {"step": STEP, "n_steps": 3 * ROWS, "cycle_steps": ROWS}
    full = sj.integrate(system(), save=sj.Save(fields=True), **options)
    reduced = system().project(proper_decomposition(full.u).modes[:, :3])
    return {"full": full, "reduced": sj.integrate(reduced, **options)}


@pytest.fixture(scope="module")
def proper(runs):
    return proper_decomposition(runs["full"].u)


@pytest.fixture(scope="module")
def figures(runs, proper):
    xi = np.linspace(0.0, 1.0, len(proper.modes))
    return {
        "histories": plots.histories_figure(runs, ["free_end"]),
        "hysteresis": plots.hysteresis_figure(runs, "free_end", 0, ROWS),
        "modes": plots.modes_figure(xi, proper, "the paper's reference joint"),
        "values": plots.proper_values_figure(proper, "the full model's own run"),
        "cycles": plots.energies_figure(runs),
    }


LABELS = {
    "histories": ["time, ms", "displacement, µm"],
    "hysteresis": ["displacement of free_end, µm", "force on free_end, kN"],
    "modes": ["position on the active length, ξ (1 = loaded end)"],
    "values": ["proper value, % of the sum", "cumulative sum, %", "number of the mode"],
    "cycles": ["work in the cycle, J", "cycle"],
}


@pytest.mark.parametrize("name", LABELS)
def test_axes_carry_quantity_and_unit(figures, name):
    panels = figures[name].axes
    written = {text for panel in panels for text in (panel.get_xlabel(), panel.get_ylabel())}
    assert set(LABELS[name]) <= written


def test_curves_and_bars_are_the_numbers_that_they_show(figures, runs, proper):
    for line, run in zip(figures["histories"].axes[0].get_lines(), runs.values(), strict=True):
        np.testing.assert_allclose(line.get_xdata(), 1e3 * run.times)
        np.testing.assert_allclose(line.get_ydata(), 1e6 * run.point("free_end"))
    lines = [one for one in figures["modes"].axes[0].get_lines() if one.get_label()[0] != "_"]
    shapes = np.array([line.get_ydata() for line in lines])
    assert shapes.max(axis=1) == pytest.approx(np.ones(5))
    overlaps = np.einsum("ki,ik->k", shapes, proper.modes[:, :5])
    assert np.abs(overlaps) == pytest.approx(np.linalg.norm(shapes, axis=1))
    left, right = figures["values"].axes
    heights = [bar.get_height() for bar in left.patches]
    np.testing.assert_allclose(heights, proper.proper_values[: len(heights)])
    np.testing.assert_allclose(right.get_lines()[0].get_ydata(), np.cumsum(heights))


def test_points_that_rest_or_move_as_another_have_no_panel():
    made = structure(sj.build_plate([("bar", 0.2, 6)], 0.05, 2, points={"tip": (0.2, 0.025)}))
    load = sj.Load("tip", sj.Harmonic(1e3, 100.0), (1.0, 0.0))
    run = sj.integrate(made.system([load]), step=1e-4, n_steps=50)
    assert run.system.points == ("tip", "tip.x", "tip.y")
    figure = plots.histories_figure({"full": run}, run.system.points)
    assert [panel.get_title(loc="left") for panel in figure.axes] == ["tip"]
    rest = made.system([sj.Load("tip", sj.Harmonic(0.0, 1.0), (1.0, 0.0))])
    still = sj.integrate(rest, step=1, n_steps=3)
    assert plots.histories_figure({"full": still}, ["tip"]).axes[0].lines


def test_the_area_of_the_drawn_loop_is_the_work_put_in_by_the_last_cycle(figures, runs):
    for line, run in zip(figures["hysteresis"].axes[0].get_lines(), runs.values(), strict=True):
        assert len(line.get_xdata()) == ROWS + 1
        u, force = 1e-6 * np.asarray(line.get_xdata()), 1e3 * np.asarray(line.get_ydata())
        work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(u))
        assert work == pytest.approx(run.cycles.input[-1].sum(), rel=1e-9)
    assert plots.is_loop(runs, "free_end", 0, ROWS)
    assert not plots.is_loop(runs, "free_end", 0, ROWS // 2)  # ends on the other side


def test_a_long_history_is_a_band_between_the_amplitudes_of_its_beats():
    t, base = np.linspace(0.0, 1.0, 80_001), 0.3
    u = base + np.sin(2 * np.pi * 1000 * t) * np.cos(2 * np.pi * t)
    band = plots.envelope(t, u)
    ends, low, high = band
    assert (ends[0], ends[-1], low.min(), high.max()) == (0.0, 1.0, u.min(), u.max())
    assert 300 < ends.size <= 400 + 1
    # A part holds cycles enough to reach the beat's amplitude somewhere in it.
    reached = np.abs(np.cos(2 * np.pi * (ends[1:] - 0.5 * np.diff(ends))))
    slope = 2 * np.pi * np.diff(ends).max()
    np.testing.assert_allclose(high[1:], base + reached, atol=slope)
    np.testing.assert_allclose(low[1:], base - reached, atol=slope)
    # Few cycles, or none but round-off after them, are drawn as they are.
    assert plots.envelope(t, np.sin(2 * np.pi * 100 * t)) is None
    rest = np.exp(-50.0 * t) * np.sin(2 * np.pi * 30 * t)
    assert plots.envelope(t, rest + 1e-9 * (-1.0) ** np.arange(t.size)) is None
    assert plots.envelope(t, np.zeros(t.size)) is None
    run = sj.integrate(system(2), step=STEP, n_steps=400 * ROWS, cycle_steps=ROWS)
    panel = plots.histories_figure({"full": run}, ["free_end"]).axes[0]
    assert not panel.lines
    largest = np.abs(panel.collections[0].get_paths()[0].vertices[:, 1]).max()
    assert largest == pytest.approx(1e6 * np.abs(run.point("free_end")).max())
    assert panel.get_title(loc="left") == "free_end: least and largest in each 2 ms"


def test_the_works_drawn_are_those_of_the_cycles_and_those_that_are_zero_are_left_out(
    figures, runs
):
    panels = {panel.get_title(loc="left"): panel for panel in figures["cycles"].axes}
    assert set(panels) == {"input", "friction", "viscous"}  # the scheme dissipates nothing
    for title in ("friction", "viscous"):
        lines = {line.get_label(): line for line in panels[title].get_lines()}
        for name, run in runs.items():
            np.testing.assert_array_equal(lines[name].get_xdata(), [1, 2, 3])
            scale = 1e-3 if "mJ" in panels[title].get_ylabel() else 1.0
            work = scale * np.asarray(lines[name].get_ydata())
            np.testing.assert_allclose(work, getattr(run.cycles, title))


@pytest.mark.parametrize(
    ("frequency", "unit"), [(1e-2, "s"), (1.0, "s"), (20.0, "ms"), (2e4, "µs"), (5e6, "µs")]
)
def test_the_time_axis_has_a_unit_that_suits_it(frequency, unit):
    steps = 10 if frequency < 1e6 else 50
    run = sj.integrate(system(2, frequency), step=1.0 / frequency / 10, n_steps=steps)
    panel = plots.histories_figure({"full": run}, ["free_end"]).axes[0]
    assert panel.get_xlabel() == f"time, {unit}"
    assert 1.0 <= panel.get_xlim()[1] <= 1000.0


def test_pictures_are_written_with_the_size_of_their_figure_and_nothing_else_is(tmp_path, figures):
    written = {
        name: plots.save_figure(tmp_path / f"{name}.png", figure)
        for name, figure in figures.items()
    }
    assert sorted(tmp_path.iterdir()) == sorted(written.values())
    for name, path in written.items():
        head = path.read_bytes()[:24]
        assert head[:8] == b"\x89PNG\r\n\x1a\n"
        inches = figures[name].get_size_inches()
        sizes = zip(struct.unpack(">II", head[16:24]), inches, strict=True)
        assert all(abs(size - x * 150) < 1.01 for size, x in sizes)  # matplotlib cuts or rounds
        assert matplotlib.image.imread(path).std() > 0.02  # not an empty page


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda runs: plots.histories_figure(runs, ["tip"]), "'tip'.*free_end"),
        (lambda runs: plots.hysteresis_figure(runs, "tip", 0, None), "'tip'.*free_end"),
        (lambda runs: plots.histories_figure(runs, []), "no points"),
        (lambda runs: plots.histories_figure({}, ["free_end"]), "no runs"),
        (lambda runs: plots.histories_figure({"a": bare()}, ["free_end"]), "stored no points"),
    ],
)
def test_mistakes_are_input_errors(runs, draw, message):
    with pytest.raises(sj.InputError, match=message):
        draw(runs)


def bare():
    """Run without its points."""
    return sj.integrate(system(), step=STEP, n_steps=2, save=sj.Save(points=False))


def active_figure(made, slip, active):
    return plots.active_region_figure(made.body, made.patches[0], slip, active)


def test_the_active_share_of_the_area_is_in_the_title_and_the_region_is_outlined():
    x = lap().nodes[lap().patches[0].nodes, 0]
    figure = active_figure(lap(), 1e-6 * np.abs(x - 0.25), x > 0.27)
    panel, scale = figure.axes  # columns of nodes at 0.28 and 0.3 are active
    assert figure.get_suptitle() == "joint: active on 30.0 % of the area"
    assert scale.get_xlabel() == "largest slip, nm"
    contours = [c for c in panel.collections if len(getattr(c, "levels", [])) == 1]
    outline = np.vstack([path.vertices for path in contours[-1].get_paths()])
    np.testing.assert_allclose(outline[:, 0], 270.0)  # half way between the columns
    for beyond, said in ((-1.0, "all of it active"), (9.0, "faded: nothing is active")):
        assert active_figure(lap(), 1e-6 * x, x > beyond).axes[0].get_title() == said


def joint_of(length: float, width: float) -> sj.Structure:
    strips = [("joint", length, 6), ("arm", 0.1, 4)]
    return structure(sj.build_plate(strips, width, 3), [JOINT], ["right"])


@pytest.mark.parametrize(
    ("made", "ends"),
    [
        *((joint_of(x, y), (0.0, x)) for x, y in ((0.1, 0.004), (0.1, 0.05), (0.05, 0.2))),
        *((blocks(kind), (0.05, 0.15)) for kind in ("hexahedron", "tetrahedron")),
    ],
)
def test_a_plate_or_a_face_is_drawn_in_its_plane(made, ends):
    k = made.patches[0].nodes.size
    panel = active_figure(made, np.linspace(0, 1e-6, k), np.arange(k) < 9).axes[0]
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("x, mm", "y, mm")
    assert panel.get_xlim() == pytest.approx(
        [1e3 * x for x in ends], abs=30.0 * (ends[1] - ends[0])
    )


def test_the_work_of_friction_is_drawn_by_area_and_added_up():
    patch = lap().patches[0]
    figure = plots.friction_work_figure(lap().body, patch, 2e-3 * patch.area)
    assert figure.get_suptitle() == f"joint: {2e-3 * patch.area.sum():.4g} J over the run"
    panel, scale = figure.axes
    assert scale.get_xlabel() == "friction work over the run, mJ/m²"
    drawn = panel.collections[0].get_array()
    assert np.allclose(drawn[drawn > 0.0], 2.0)  # a support does no work


@pytest.mark.parametrize(
    ("made", "share", "name"), [(side(), "100.0", "x, mm"), (bar(), "87.5", "position, mm")]
)
def test_the_active_part_of_a_line_is_a_share_of_its_area(made, share, name):
    patch = made.patches[0]
    slip = 1e-6 * made.nodes[patch.nodes, 0]
    figure = active_figure(made, slip, np.ones(slip.size, dtype=bool))
    # All but the half element at a support.
    assert figure.get_suptitle().endswith(f"on {share} % of the area")
    assert figure.axes[0].get_xlabel() == name
    assert figure.axes[0].get_ylabel() == "largest slip, nm"
    held = patch.held_nodes.size
    assert len(figure.axes[0].get_lines()[0].get_xdata()) == slip.size + held


@pytest.mark.parametrize("decades", [1, 3, 9])
def test_logarithmic_axes_have_numbers_over_few_and_many_decades(decades):
    figure = plots.new_figure(4.0, 3.0)
    panel = figure.subplots()
    panel.semilogx([10.0**-decades, 1.0], [0.0, 1.0])
    plots.plain_ticks(panel.xaxis)
    low, high = panel.get_xlim()
    shown = [tick for tick in panel.get_xticks() if low <= tick <= high]
    assert 3 <= len(shown) <= 12
