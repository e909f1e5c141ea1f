"""Shipped scenes: listed, and written with their meshes; `test_wheel` has those of a wheel."""

import re
import tomllib
from contextlib import chdir
from pathlib import Path

import pytest

from skfem_joint import cli, load_scene
from skfem_joint.scene.shipped import QUESTIONS

ROOT = Path(__file__).parents[2]
COMMANDS = "backbone", "response", "nonlinear-modes", "random", "fit", "error-time", "sweep"


def contents(folder: Path) -> dict[str, bytes]:
    """Contents of all files below a folder."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_each_scene_is_listed_with_its_question(capsys):
    assert {path.stem for path in (ROOT / "examples").glob("*.toml")} == {*QUESTIONS}
    assert cli.main(["example"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [tuple(line.split(maxsplit=1)) for line in lines[: len(QUESTIONS)]] == [
        *QUESTIONS.items()
    ]


@pytest.mark.parametrize("name", QUESTIONS)
def test_each_written_scene_is_valid_and_differs_in_its_mesh_s_path_alone(name, tmp_path, capsys):
    with chdir(tmp_path):
        assert cli.main(["example", name]) == 0
        shown = capsys.readouterr().out
        assert QUESTIONS[name] in shown
        (command,) = re.findall(r"^    skfem-joint (.+)$", shown, re.MULTILINE)
        kind, scene, *rest = command.split()
        assert kind == ("sweep" if name == "lap_joint_sweep" else "run")
        assert rest == ["--out", str(Path(name, "out"))]
        load_scene(scene)

    text = (tmp_path / scene).read_text(encoding="utf-8")
    original = (ROOT / "examples" / f"{name}.toml").read_text(encoding="utf-8")
    assert text == original.replace("../meshes/", "")
    mesh = tomllib.loads(text)["mesh"]["file"]
    assert contents(tmp_path / name).keys() == {f"{name}.toml", mesh}
    assert (tmp_path / name / mesh).read_bytes() == (ROOT / "meshes" / mesh).read_bytes()


@pytest.mark.parametrize(
    "name",
    [
        # those of bolts on many pressure points take four seconds each
        pytest.param(x, marks=[pytest.mark.slow] * (x in ("plate_bolts", "solid_lap_joint")))
        for x in QUESTIONS
    ],
)
def test_each_scene_is_accepted_by_check_with_its_frequencies(name, capsys):
    assert cli.main(["check", str(ROOT / "examples" / f"{name}.toml")]) == 0
    assert " Hz" in capsys.readouterr().out


@pytest.mark.parametrize("name", QUESTIONS)
def test_no_command_is_told_of_keys_that_are_for_another_one(name):
    """They have ``vtk`` for ``run``, and serve other commands too."""
    scene = load_scene(ROOT / "examples" / f"{name}.toml")
    assert [scene.passed_over(command) for command in COMMANDS] == [[]] * len(COMMANDS)
    asked = scene.changed(output={"uff": True})
    assert "random takes no account of output.uff." in asked.passed_over("random")[0]


@pytest.mark.parametrize("there", ["structure_impulse.toml", "structure.msh"])
def test_no_file_that_is_there_is_overwritten(there, tmp_path, capsys):
    (tmp_path / there).write_text("mine", encoding="utf-8")
    assert cli.main(["example", "structure_impulse", "--out", str(tmp_path)]) == 2
    assert f"{there}: is there already and is not overwritten" in capsys.readouterr().err
    assert contents(tmp_path) == {there: b"mine"}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["structure_harmonc"], "did you mean 'structure_harmonic'?"),
        (["../meshes"], "found '../meshes', must be one of 'lap_joint_case_I'"),
        (["--out", "out"], "--out: needs the NAME of a scene"),
        (["two_plates", "--out", "file"], "cannot be written to"),
    ],
)
def test_what_cannot_be_written(arguments, says, tmp_path, capsys):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    with chdir(tmp_path):
        assert cli.main(["example", *arguments]) == 2
    assert says in capsys.readouterr().err
    assert contents(tmp_path) == {"file": b"mine"}
