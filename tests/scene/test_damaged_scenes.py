"""Damaged scene files are refused in words, or read for what they say."""

import random
from pathlib import Path

import numpy as np
import pytest
from stability.mutated import damaged

import skfem_joint as sj

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.toml"))
MESHES = sorted((ROOT / "meshes").glob("*.msh"))
TOKENS = ("nan", "inf", "-inf", "1e400", "-1", "0", "0.0", "1e-320", "1e308", "9" * 400, "true",
          "[]", "{}", "''", '"free_end"', '"joint"', '"\\u0000"', "[[joint]]", "[load]", "=", "#",
          "]", '"""', "1979-05-27", "0x7fffffffffffffff", "[1, 2]", "{a = 1}", "\x00", "é",
          '"../../../../etc/passwd"', '"/dev/zero"', '"."', '""', '"CON"')  # fmt: skip


def outcome(path: Path) -> sj.Scene | str:
    """Scene that a file gives, or the words in which it is refused; nothing else passes."""
    try:
        scene = sj.load_scene(path)
    except sj.InputError as error:
        text = str(error)
    else:
        assert np.all(np.isfinite(scene.system().contact.w))
        assert scene.n_steps > 0
        assert scene.time_step > 0.0
        return scene
    assert text
    assert all(line.startswith(str(path)) for line in text.splitlines())
    return text


@pytest.mark.parametrize(
    "example", [p for p in EXAMPLES if not p.stem.startswith("solid")], ids=lambda path: path.stem
)
def test_damaged_scenes_are_refused_or_valid(example, tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "examples").mkdir()
    for mesh in MESHES:
        (tmp_path / "meshes" / mesh.name).write_bytes(mesh.read_bytes())
    path = tmp_path / "examples" / "scene.toml"
    rng = random.Random(example.stem)
    slow = {"two": 40, "plate": 40}  # plates take longer; solids have no table of their own
    valid, count = 0, slow.get(example.stem.split("_")[0], 100)
    for _ in range(count):
        path.write_bytes(damaged(example.read_bytes(), rng, TOKENS))
        valid += not isinstance(outcome(path), str)
    # Comments and harmless digits; the rest is refused.
    assert 0.04 * count < valid < 0.96 * count
    assert sorted(file.name for file in tmp_path.rglob("*") if file.is_file()) == sorted(
        ["scene.toml", *(mesh.name for mesh in MESHES)]
    )


@pytest.mark.parametrize(
    "name", ["/dev/zero", "/dev/null", "/dev/stdin", ".", "..", "/", "../scene.toml", "scene.toml",
             "/proc/self/mem", "/etc/passwd", "x" * 300, "x/" * 3000, "~", "a:b", "%s%n", "*",
             "\u202emsh", "http://localhost/x.msh", "file:///x.msh"]
)  # fmt: skip
@pytest.mark.parametrize("key", ["mesh", "table"])
def test_files_that_a_scene_may_not_mean(name, key, tmp_path):
    """Devices never end and are refused unread; all else says why it cannot be read."""
    text = (ROOT / "examples" / "lap_joint_case_I.toml").read_text(encoding="utf-8")
    mesh = '"../meshes/lap_joint_500mm.msh"'
    if key == "mesh":
        text = text.replace(mesh, f"'{name}'")
    else:
        text = text.replace(mesh, f"'{(ROOT / 'meshes').as_posix()}/lap_joint_500mm.msh'")
        load = 'kind = "harmonic"\namplitude = 437.5e3\nfrequency = 2000.0'
        assert load in text
        text = text.replace(load, f"kind = 'table'\nfile = '{name}'")
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    refused = outcome(path)
    assert isinstance(refused, str)
    assert f"{path}: {'mesh' if key == 'mesh' else 'load[0]'}.file: " in refused


@pytest.mark.parametrize("name", ["scène 1.toml", "-scene.toml", "a'b\"c.toml", "%d.toml",
                                  "new\nline.toml"])  # fmt: skip
def test_scenes_and_folders_may_have_odd_names(name, tmp_path):
    folder = tmp_path / name.removesuffix(".toml")
    folder.mkdir()
    text = EXAMPLES[0].read_text(encoding="utf-8").replace("../meshes", str(ROOT / "meshes"))
    (folder / name).write_text(text, encoding="utf-8")
    assert sj.load_scene(folder / name).path == folder / name
