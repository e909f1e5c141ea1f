"""The gallery: each script asks a question, draws, and gives the numbers that it speaks of."""

import ast
import io
import re
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.image
import numpy as np
import pytest
from gallery import EXAMPLES, SCRIPTS, run_script

from skfem_joint.scene.shipped import QUESTIONS, shipped_scene

STUDIES = "measured_beam", "two_plates"  # which print tables
TABLE_1 = (86.55, 10.24, 1.70, 0.73, 0.29)  # percent
HEADER = (EXAMPLES / "GALLERY_HEADER.txt").read_text(encoding="utf-8")
README = (EXAMPLES / "README.md").read_text(encoding="utf-8")
#: Scripts that take more than some seconds in their short forms.
LONG = (
    "brake_reuss", "damping", "fit_joint", "fit_sampler", "gross_slip", "measured_beam",
    "plate_bolts", "plate_reference", "range_model", "solid_lap_joint", "sweep", "two_plates",
    "two_plates_held",
)  # fmt: skip


class Ran(NamedTuple):
    """A script that was run: its names, what it printed, and the folder in which it was run."""

    names: dict[str, Any]
    printed: str
    folder: Path


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Run a script, once for all tests of it."""

    @cache
    def of(name):
        folder = tmp_path_factory.mktemp(name)
        with redirect_stdout(io.StringIO()) as printed:
            names = run_script(name, folder)
        return Ran(names, printed.getvalue(), folder)

    return of


@pytest.fixture(scope="module")
def run(ran):
    """Run a script, once; its names."""
    return lambda name: ran(name).names


def text_of(name):
    return (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")


def docstring(name):
    return ast.get_docstring(ast.parse(text_of(name)))


def title(name):
    return docstring(name).splitlines()[0]


def lines_of_code(text):
    """Lines that are neither empty nor comments; a text over several lines counts as one."""
    body = ast.parse(text).body[1:]  # without the docstring
    texts = [node for node in ast.walk(ast.Module(body, [])) if isinstance(node, ast.Constant)]
    within = {line for node in texts for line in range(node.lineno + 1, (node.end_lineno or 0) + 1)}
    lines = list(enumerate(text.splitlines(), 1))[body[0].lineno - 1 :]
    return sum(
        bool(line.strip()) and not line.lstrip().startswith("#") and number not in within
        for number, line in lines
    )


@pytest.mark.parametrize("name", [name for name in SCRIPTS if name not in STUDIES])
def test_literate_examples_are_short(name):
    assert lines_of_code(text_of(name)) < 40


@pytest.mark.parametrize("name", SCRIPTS)
def test_each_script_has_a_question_as_its_title_and_says_what_is_computed(name):
    question, line, empty, *text = docstring(name).splitlines()
    assert question.endswith("?")
    assert (line, empty) == ("=" * len(question), "")
    assert ".. math::" in text


@pytest.mark.parametrize("name", QUESTIONS)
def test_each_shipped_scene_has_its_script_with_its_question_and_command(name):
    (script,) = (script for script in SCRIPTS if title(script) == QUESTIONS[name])
    text = text_of(script)
    assert f'shipped_scene("{name}")' in text
    assert f"skfem-joint example {name}\n" in text
    kind = "sweep" if "[sweep]" in shipped_scene(name).read_text(encoding="utf-8") else "run"
    assert f"skfem-joint {kind} {name}/{name}.toml --out {name}/out\n" in text


def test_the_first_pages_show_each_script_once():
    assert sorted(re.findall(r"^ +\.\./examples/(\w+)\.py$", HEADER, re.MULTILINE)) == [*SCRIPTS]
    listed = dict(re.findall(r"^\| \[(\w+)\.py\]\(\1\.py\) \| (.+) \|$", README, re.MULTILINE))
    assert listed == {name: title(name) for name in SCRIPTS}


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in SCRIPTS],
)
def test_each_script_runs_in_any_folder_and_leaves_its_picture_alone(name, ran):
    assert len(ran(name).printed.splitlines()) >= 2
    assert [path.name for path in ran(name).folder.iterdir()] == [f"{name}.png"]
    drawn = matplotlib.image.imread(ran(name).folder / f"{name}.png")
    assert drawn.shape[0] > 200
    assert drawn.shape[1] > 500
    assert drawn.std() > 0.01  # not one colour


def test_a_link_between_scripts_leads_to_one():
    for name in SCRIPTS:
        assert set(re.findall(r":doc:`(\w+)`", docstring(name))) <= set(SCRIPTS) - {name}


# Numbers


def test_the_lap_joint_has_the_proper_values_of_table_1_and_its_closed_form(run):
    names = run("lap_joint")
    assert names["proper"].proper_values[:5] == pytest.approx(TABLE_1, abs=0.01)
    # Peak F^2 / (2 EA tau) with EA = 100 MN and tau = 0.7 x 8 MPa x 50 mm; inertia adds to it.
    assert names["peak_static"] == pytest.approx(63e3**2 / (2 * 100e6 * 280e3), rel=1e-12)
    assert 1.0 < names["peak"] / names["peak_static"] < 1.1
    assert names["run"].energy_residual < 1e-12
    # Pseudo-static loss of a cycle, 2 F^3 / (3 EA tau), from Masing's loops.
    loss = 2 * 63e3**3 / (3 * 100e6 * 280e3)
    assert 1.0 < names["run"].cycles.friction[-1] / loss < 1.15


def test_the_reduced_structure_is_small_and_close_to_the_full_one(run):
    names = run("reduced_structure")
    small, full = names["small"], names["system"]
    assert (full.n, full.contact.count) == (200, 100)
    # Modes, the load's response, interface modes.
    assert (small.n, names["last"].shape) == (10 + 1 + 2, (201, 1))
    assert 30 <= small.contact.w.size <= 39
    assert small.points == full.points
    assert names["errors"].by_point["free_end"][1] < 0.001
    assert abs(names["errors"].peak_displacement) < 0.001
    assert abs(names["errors"].friction_energy_per_cycle) < 0.01
    (wall,), (tip,) = names["last"][[0, -1]]
    assert wall == 0.0
    assert tip == pytest.approx(names["reduced"].point_u[-1, 0], rel=1e-12)


def test_the_beam_has_its_static_deflection_and_friction_holds_its_tip(run):
    names = run("own_basis")
    free, half, stuck = (names["runs"][limit].peak_of("tip") for limit in (0.0, 0.5, 1.1))
    # Slow beside the first natural frequency, 2.9 Hz; the start sets off a little more.
    assert 1.0 < free / names["static"] < 1.15
    assert half < 0.7 * free
    assert stuck == 0.0


@pytest.mark.slow
def test_a_sweep_loses_what_the_closed_form_says(run):
    names = run("sweep")
    assert [row.number for row in names["rows"]] == list(range(25))
    assert np.abs(names["away"]).max() < 0.005


@pytest.mark.slow
def test_the_brake_reuss_beam_has_the_published_frequencies(run):
    """Between or within 2 % of those of two finite-element models with frictionless contact.

    Their sideways bending, the second, is that of elements with one point of integration. With
    elements that bend, and nuts joined to the shanks as here, their mesh has 157.7 Hz.
    """
    names = run("brake_reuss")
    assert names["pressed"].force.sum() == pytest.approx(36e3, rel=1e-10)
    circles = 3 * np.pi * 0.00425**2  # which the polygons of the holes are as large as
    assert names["pressed"].area.sum() == pytest.approx(0.12 * 0.0254 - circles, rel=1e-6)
    published = list(names["PUBLISHED"])
    published[1] = 157.7, 157.7
    pairs = zip(names["frequency"], published, strict=False)
    assert all(0.98 * low < one < 1.02 * high for one, (low, high) in pairs)
    curve = names["curve"]
    assert names["frequency"][0] < curve.frequency[-1] < curve.stuck_frequency
    assert 0.01 < curve.damping_ratio[-1] < 0.1


def test_a_lifted_block_is_in_equilibrium_and_its_faces_only_push(run):
    names = run("contact_opens")
    opened, pressed = names["run"], names["pressed"]
    lift = 0.15 * pressed * np.sin(2.0 * np.pi * opened.field_times)
    force = opened.normal_force
    np.testing.assert_allclose(force.sum(axis=1), pressed - lift, rtol=1e-9)
    assert force.min() == 0.0
    gap = opened.system.contact.normal.gaps(opened.u)
    assert gap.min() > -1e-15  # m
    assert np.abs(force * gap).max() < 1e-12 * pressed * names["length"]
    assert opened.energy_residual < 1e-9  # what rigid contact is solved to


@pytest.mark.slow
def test_peaks_of_the_response_lie_where_the_structure_rings_down(run):
    names = run("damping")
    down, end = names["down"], names["end"]
    amplitude, frequency = end * down.amplitude[::-1], down.frequency[::-1]
    for curve in names["swept"]:
        peak, size = curve.peak
        assert peak == pytest.approx(np.interp(size, amplitude, frequency), rel=5e-3)
    # Quasi-static damping is lower: the frequencies are as 1 : 3 : 5.
    ratio = np.interp(down.amplitude, names["curve"].amplitude, names["curve"].damping_ratio)
    assert 1.1 < np.median(down.damping_ratio / ratio) < 2.0
    assert 0.8 * down.energy[0] < down.friction_work[-1].sum() < down.energy[0]
