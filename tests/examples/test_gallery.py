"""The gallery: each script asks a question, runs by itself and draws; each scene has its script."""

import ast
import re

import matplotlib.image
import pytest
from gallery import EXAMPLES, SCRIPTS, run_script

from skfem_joint.scene.shipped import QUESTIONS, shipped_scene

HEADER = (EXAMPLES / "GALLERY_HEADER.txt").read_text(encoding="utf-8")
README = (EXAMPLES / "README.md").read_text(encoding="utf-8")
#: Scripts that take more than some seconds in their short forms.
LONG = (
    "brake_reuss", "damping", "fit_joint", "fit_sampler", "measured_beam", "plate_bolts",
    "range_model", "solid_lap_joint", "two_plates",
)  # fmt: skip


def docstring(name):
    return ast.get_docstring(ast.parse((EXAMPLES / f"{name}.py").read_text(encoding="utf-8")))


def title(name):
    return docstring(name).splitlines()[0]


@pytest.mark.parametrize("name", SCRIPTS)
def test_each_script_has_a_question_as_its_title_and_says_what_is_computed(name):
    question, line, empty, *text = docstring(name).splitlines()
    assert question.endswith("?")
    assert (line, empty) == ("=" * len(question), "")
    assert ".. math::" in text


@pytest.mark.parametrize("name", QUESTIONS)
def test_each_shipped_scene_has_its_script_with_its_question_and_command(name):
    (script,) = (script for script in SCRIPTS if title(script) == QUESTIONS[name])
    text = (EXAMPLES / f"{script}.py").read_text(encoding="utf-8")
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
def test_each_script_runs_in_any_folder_and_leaves_its_picture_alone(
    name, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    run_script(name)
    assert len(capsys.readouterr().out.splitlines()) >= 2
    assert [path.name for path in tmp_path.iterdir()] == [f"{name}.png"]
    drawn = matplotlib.image.imread(tmp_path / f"{name}.png")
    assert drawn.shape[0] > 200
    assert drawn.shape[1] > 500
    assert drawn.std() > 0.01  # not one colour


def test_a_link_between_scripts_leads_to_one():
    for name in SCRIPTS:
        assert set(re.findall(r":doc:`(\w+)`", docstring(name))) <= set(SCRIPTS) - {name}
