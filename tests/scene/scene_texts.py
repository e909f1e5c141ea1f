"""Texts of scenes for the tests, changed in places, and what is wrong with them."""

import csv
import tomllib
from pathlib import Path

import pytest

import skfem_joint as sj
from skfem_joint.scene import Scene, load_scene, scene_from

MESHES = Path(__file__).parents[2] / "meshes"
GOOD = """\
title = "two joints and a plain bar"
[mesh]
file = "bar.msh"
[material]
E = 200e9
density = 8000
[section]
width = 0.05
thickness = 0.01
[support]
fixed = ["fixed"]
[[joint]]
on = "joint"
pressure = 50e6
friction = 0.7
[[load]]
on = "free_end"
kind = "harmonic"
amplitude = 87.5e3
frequency = 500.0
[time]
cycles = 3
[models]
run = ["full", "reduced"]
[reduction]
modes = 5
[output]
every = 1
"""

Change = tuple[str, str]


def with_changes(text: str, *changes: Change) -> str:
    """The text with some of its parts exchanged, each of which stands in it once."""
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} must stand in the good scene once"
        text = text.replace(old, new)
    return text


def written(folder: Path, *changes: Change, text: str = GOOD, more: str = "") -> Path:
    """File of a scene on the mesh of the paper's structure, with changes and more tables."""
    path, meshes = folder / "scene.toml", MESHES.as_posix()
    text = text.replace("bar.msh", f"{meshes}/structure.msh").replace("../meshes", meshes)
    path.write_text(with_changes(text, *changes) + more, encoding="utf-8")
    return path


def scene_of(
    *changes: Change, folder: Path | None = None, mesh: sj.NamedMesh | None = None
) -> Scene:
    """The good scene with changes, in memory."""
    path = (folder or Path()) / "scene.toml"
    return scene_from(tomllib.loads(with_changes(GOOD, *changes)), mesh, path)


def problems_of(*changes: Change, folder: Path | None = None) -> list[str]:
    """What is wrong with the changed scene by itself, without the file name."""
    with pytest.raises(sj.InputError) as caught:
        scene_of(*changes, folder=folder)
    return _without_path(caught.value, (folder or Path()) / "scene.toml")


def problems_of_file(path: Path) -> list[str]:
    """What is wrong with a scene file, without the file name that starts every line."""
    with pytest.raises(sj.InputError) as caught:
        load_scene(path)
    return _without_path(caught.value, path)


def csv_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a table that a command has written, by their columns."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _without_path(error: sj.InputError, path: Path) -> list[str]:
    assert error.exit_status == 2
    assert all(problem.startswith(f"{path}: ") for problem in error.problems)
    return [problem.removeprefix(f"{path}: ") for problem in error.problems]
