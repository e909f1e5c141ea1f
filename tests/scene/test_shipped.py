"""Shipped scenes: listed, written with their meshes, found by an installed wheel too."""

import os
import re
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

from skfem_joint import cli
from skfem_joint.scene.shipped import QUESTIONS, write_shipped

ROOT = Path(__file__).parents[2]


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
def test_each_written_scene_is_valid_and_differs_in_its_mesh_s_path_alone(
    name, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["example", name]) == 0
    shown = capsys.readouterr().out
    assert QUESTIONS[name] in shown
    (command,) = re.findall(r"^    skfem-joint (.+)$", shown, re.MULTILINE)
    kind, scene, *rest = command.split()
    assert kind == ("sweep" if name == "lap_joint_sweep" else "run")
    assert rest == ["--out", str(Path(name, "out"))]
    assert cli.main(["check", scene]) == 0
    assert f"{scene}: valid." in capsys.readouterr().out

    text = Path(scene).read_text(encoding="utf-8")
    original = (ROOT / "examples" / f"{name}.toml").read_text(encoding="utf-8")
    assert text == original.replace("../meshes/", "")
    mesh = tomllib.loads(text)["mesh"]["file"]
    assert contents(tmp_path / name).keys() == {f"{name}.toml", mesh}
    assert Path(name, mesh).read_bytes() == (ROOT / "meshes" / mesh).read_bytes()


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
def test_what_cannot_be_written(arguments, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("mine", encoding="utf-8")
    assert cli.main(["example", *arguments]) == 2
    assert says in capsys.readouterr().err
    assert contents(tmp_path) == {"file": b"mine"}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder into which a wheel of the checkout was installed, without what it needs."""
    for tool in ("hatchling", "pip"):
        if find_spec(tool) is None:
            pytest.skip(f"{tool} is not installed: pip install '.[test]' in a virtual environment")
    wheels, target = tmp_path_factory.mktemp("wheels"), tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    offline = ["--no-deps", "--no-index", "--quiet"]
    build = [*pip, "wheel", *offline, "--no-build-isolation", "--wheel-dir", wheels, ROOT]
    subprocess.run(build, check=True, timeout=300)
    (wheel,) = wheels.glob("*.whl")
    subprocess.run([*pip, "install", *offline, "--target", target, wheel], check=True, timeout=300)
    return target


def test_an_installed_wheel_writes_the_same_scenes(installed, tmp_path):
    def python(*arguments: str) -> str:
        environment = os.environ | {"PYTHONPATH": str(installed)}
        command = [sys.executable, *arguments]
        return subprocess.run(
            command, cwd=empty, env=environment, check=True, capture_output=True, text=True
        ).stdout

    (empty := tmp_path / "empty").mkdir()
    where = python("-c", "import skfem_joint; print(skfem_joint.__file__)")
    assert Path(where.strip()).is_relative_to(installed)
    assert "structure_harmonic/out" in python("-m", "skfem_joint", "example", "structure_harmonic")
    scene = "structure_harmonic/structure_harmonic.toml"
    assert "valid." in python("-m", "skfem_joint", "check", scene)

    loop = "for name in shipped.QUESTIONS: shipped.write_shipped(name, Path('all', name))"
    python("-c", f"from pathlib import Path\nfrom skfem_joint.scene import shipped\n{loop}")
    for name in QUESTIONS:
        write_shipped(name, tmp_path / "all" / name)
    assert contents(empty / "all") == contents(tmp_path / "all")
    load = "skfem_joint.load_scene(shipped.shipped_scene('plate_bolts')).title"
    read = f"import skfem_joint\nfrom skfem_joint.scene import shipped\nprint({load})"
    assert python("-c", read).strip() == "Plate with two bolt holes"
