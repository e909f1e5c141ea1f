"""An installed wheel works alone: shipped scenes, preview and run in an empty folder."""

import json
import os
import subprocess
import sys
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest

from skfem_joint.scene.shipped import QUESTIONS, write_shipped

ROOT = Path(__file__).parents[1]


def contents(folder: Path) -> dict[str, bytes]:
    """Contents of all files below a folder."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """A wheel of the checkout, built without a network."""
    for tool in ("hatchling", "pip"):
        if find_spec(tool) is None:
            pytest.skip(f"{tool} is not installed: pip install --group test in an environment")
    folder = tmp_path_factory.mktemp("wheels")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--quiet"]
    offline = ["--no-deps", "--no-index", "--no-build-isolation"]
    subprocess.run([*pip, *offline, "--wheel-dir", folder, ROOT], check=True, timeout=300)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Folder into which the wheel was installed, without what it needs."""
    folder = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    offline = ["--no-deps", "--no-index"]
    subprocess.run([*pip, *offline, "--target", folder, wheel], check=True, timeout=300)
    return folder


@pytest.fixture
def python(installed, tmp_path):
    """Python in an empty folder, with the installed wheel and nothing of the checkout."""

    def run(*arguments: str) -> str:
        # The checkout, if it is installed as editable, comes after this folder.
        environment = os.environ | {"PYTHONPATH": str(installed)}
        ended = subprocess.run(
            [sys.executable, *arguments],
            cwd=tmp_path, env=environment, check=False, capture_output=True, text=True,
        )  # fmt: skip
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    where = run("-c", "import skfem_joint; print(skfem_joint.__file__)")
    assert Path(where.strip()).is_relative_to(installed)
    return run


def test_the_wheel_has_all_modules_and_scenes_and_nothing_else(wheel):
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    package = (ROOT / "skfem_joint").rglob("*.py")
    scenes = [*(ROOT / "examples").glob("*.toml"), *(ROOT / "meshes").glob("*.msh")]
    assert names == {
        *("skfem_joint/py.typed", "skfem_joint/__init__.pyi", "skfem_joint/output/page.html"),
        *(path.relative_to(ROOT).as_posix() for path in package),
        *(f"skfem_joint/shipped/{path.relative_to(ROOT).as_posix()}" for path in scenes),
    }


def test_an_installed_wheel_writes_the_same_scenes(python, tmp_path):
    loop = "for name in shipped.QUESTIONS: shipped.write_shipped(name, Path('all', name))"
    python("-c", f"from pathlib import Path\nfrom skfem_joint.scene import shipped\n{loop}")
    for name in QUESTIONS:
        write_shipped(name, tmp_path / "checkout" / name)
    assert contents(tmp_path / "all") == contents(tmp_path / "checkout")


@pytest.mark.slow
def test_an_installed_wheel_previews_and_computes_a_shipped_scene(python, tmp_path):
    command = ("-m", "skfem_joint")
    assert all(name in python(*command, "example") for name in QUESTIONS)
    shown = python(*command, "example", "structure_harmonic")
    (run,) = [line.split() for line in shown.splitlines() if " run " in line]
    assert run[:2] == ["skfem-joint", "run"]
    scene = run[2]
    assert "valid." in python(*command, "check", scene)

    python(*command, "preview", scene, "--out", "preview.png")
    assert (tmp_path / "preview.png").read_bytes().startswith(b"\x89PNG")

    python(*command, *run[1:])
    out = tmp_path / "structure_harmonic" / "out"
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert {"full", "reduced"} <= summary["models"].keys()
