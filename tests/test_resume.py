"""Runs that are killed go on from their checkpoints: every file as if nothing had happened."""

import json
import os
import resource
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene_texts import written

import skfem_joint as sj
from skfem_joint import cli, output
from skfem_joint.output.record import LIST
from skfem_joint.study import study

ROOT = Path(__file__).parent.parent


class KilledError(Exception):
    """Ends a run as a kill would: nothing of it is left but its files."""


@pytest.fixture
def scene(tmp_path):
    def write(cycles=30, output="", run='"full", "reduced"'):
        time, all_modes = ("cycles = 3", f"cycles = {cycles}"), ("[reduction]\nmodes = 5\n", "")
        models, asked = ('"full", "reduced"', run), ("every = 1", output)
        return written(tmp_path, time, all_modes, models, asked)

    return write


def results(folder: Path) -> tuple[Mapping[str, Any], Mapping[str, bytes]]:
    """Summary without times, and the arrays of the history as bytes."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for model in summary["models"].values():
        for name in ("wall_s", "offline_s", "estimate_s", "compilation_s"):
            del model[name]
    with np.load(folder / "history.npz", allow_pickle=False) as history:
        return summary, {name: history[name].tobytes() for name in history}


def assert_only_whole_files(folder: Path) -> int:
    """Number of files below a folder, all of which can be read."""
    count = 0
    for path in folder.rglob("*"):
        if path.is_dir() or path.name.startswith("."):
            continue
        count += 1
        if path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))
        elif path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                assert all(arrays[name].size >= 0 for name in arrays)
        elif path.suffix == ".csv":
            assert np.isfinite(np.loadtxt(path, delimiter=",", skiprows=1)).all()
        elif path.suffix in (".pvd", ".vtm"):
            for data in ET.parse(path).getroot().findall(".//DataSet"):
                assert (path.parent / str(data.get("file"))).is_file()
        elif path.suffix == ".vtu":
            import pyvista

            assert pyvista.read(path).n_points > 0
        else:
            raise AssertionError(f"{path} should not be there")
    return count


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("structure_harmonic", "full"),
        ("structure_harmonic", "reduced"),
        ("structure_impulse", "full"),
        ("structure_impulse", "reduced"),
        pytest.param("plate_reference", "full", marks=pytest.mark.slow),
        pytest.param("plate_reference", "reduced", marks=pytest.mark.slow),
        pytest.param("two_plates", "full", marks=pytest.mark.slow),
        ("two_plates", "reduced"),
    ],
)
def test_every_file_of_a_resumed_run_is_that_of_a_whole_one(name, model, tmp_path):
    """Fields of frames before the checkpoint too: the stored ones are not mixed up with others."""
    scene = sj.load_scene(ROOT / "examples" / f"{name}.toml")
    few: dict[str, Any] = {"cycles": 2, "steps_per_cycle": 12}
    if scene.time.cycles is None:
        few = {"duration": 20 * scene.time_step}
    written = {"vtk": True, "plots": False, "history": True, "frames": 12}
    bars = {"estimate": scene.named_mesh.dim == 1}  # estimates of plates take their time
    scene = scene.changed(output=written, models={"run": (model,)}, time=few, accuracy=bars)
    whole, out = tmp_path / "whole", tmp_path / "out"

    def kill(label, done, total):
        if label == f"{model} model" and done >= total // 2:
            raise KilledError

    with output.prepare(scene, whole):
        output.write(study.run_scene(scene), whole)
    with pytest.raises(KilledError), output.prepare(scene, out):
        study.run_scene(scene, kill, sj.Checkpoints(out, every=1))
    with output.prepare(scene, out):
        checkpoints = sj.Checkpoints(out, every=1, resume=True)
        assert len(checkpoints.files()) == 1
        resumed = study.run_scene(scene, checkpoints=checkpoints)
        output.write(resumed, out)
        (out / "checkpoint_mine.npz").write_text("of the user")
        checkpoints.remove(resumed.models)
        (out / "checkpoint_mine.npz").unlink()  # it was left
    assert results(out) == results(whole)
    names = [sorted(path.relative_to(f) for path in f.rglob("*.vtu")) for f in (whole, out)]
    assert names[0] == names[1]
    assert len(names[0]) > 10
    for name in names[0]:
        assert (whole / name).read_bytes() == (out / name).read_bytes(), name


def test_a_finished_model_is_not_run_again(scene, tmp_path):
    path, out = scene(cycles=4), tmp_path / "out"
    assert cli.main(["run", str(path), "--out", str(tmp_path / "whole")]) == 0
    made = sj.load_scene(path)

    def kill(label, done, total):
        if label == "reduced model":
            raise KilledError

    with pytest.raises(KilledError), output.prepare(made, out):
        study.run_scene(made, kill, sj.Checkpoints(out, every=300))
    assert "checkpoint_full.npz" in {file.name for file in out.iterdir()}
    labels: set[str] = set()
    with output.prepare(made, out):
        checkpoints = sj.Checkpoints(out, every=300, resume=True)
        resumed = study.run_scene(made, lambda label, *_: labels.add(label), checkpoints)
        output.write(resumed, out)
        checkpoints.remove(resumed.models)
    assert "full model" not in labels
    assert "reduced model" in labels
    assert results(out) == results(tmp_path / "whole")
    assert not list(out.glob("checkpoint_*"))


def test_nothing_is_lost_without_resume(scene, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "checkpoint_full.npz").write_bytes(b"hours of work")
    arguments = ["run", str(scene()), "--out", str(out), "--checkpoint-every", "300"]
    assert cli.main(arguments) == 2
    assert "go on with --resume" in capsys.readouterr().err
    assert (out / "checkpoint_full.npz").read_bytes() == b"hours of work"
    assert cli.main([*arguments, "--resume"]) == 2
    assert "cannot be read as a checkpoint" in capsys.readouterr().err


def test_another_scene_or_mesh_is_refused(scene, tmp_path, capsys):
    path, out = scene(cycles=2, run='"full"'), tmp_path / "out"
    text = path.read_text(encoding="utf-8")
    mesh = (ROOT / "meshes" / "structure.msh").read_text(encoding="utf-8")
    (tmp_path / "own.msh").write_text(mesh, encoding="utf-8")
    text = text.replace((ROOT / "meshes" / "structure.msh").as_posix(), "own.msh")
    path.write_text(text, encoding="utf-8")
    out.mkdir()
    study.run_scene(sj.load_scene(path), checkpoints=sj.Checkpoints(out, every=100))
    arguments = ["run", str(path), "--out", str(out), "--resume"]
    own = tmp_path / "own.msh"
    for file, old, new in ((path, "friction = 0.7", "friction = 0.71"), (own, "0.6 ", "0.601 ")):
        good = file.read_text(encoding="utf-8")
        file.write_text(good.replace(old, new), encoding="utf-8")
        assert cli.main(arguments) == 2
        assert "another scene or mesh" in capsys.readouterr().err
        file.write_text(good, encoding="utf-8")
    assert cli.main(arguments) == 0


@pytest.mark.slow
def test_a_limit_on_file_sizes_leaves_whole_files(scene, tmp_path):
    out = tmp_path / "out"
    path = scene(cycles=2, output="vtk = true\nplots = true\nframes = 2", run='"full"')

    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (60 * 1024, 60 * 1024))

    arguments = ["run", str(path), "--out", str(out), "--checkpoint-every", "100"]
    command = [sys.executable, "-m", "skfem_joint", *arguments]
    ended = subprocess.run(command, capture_output=True, text=True, preexec_fn=limited)
    said = ended.stderr
    assert ended.returncode == 2, said
    assert "File too large" in said or "is the disk full?" in said
    assert "Traceback" not in said
    assert_only_whole_files(out)
    assert {file.name for file in out.rglob(".*")} <= {LIST}


def test_a_disk_that_is_full_at_any_moment_leaves_whole_files(scene, tmp_path, monkeypatch, capsys):
    path = scene(cycles=2, output="vtk = true\nframes = 4", run='"full"')
    real = os.replace
    counts = set()
    for allowed in range(40):
        left = [allowed]

        def full(source, target, left=left):
            if left[0] == 0:
                raise OSError(28, "No space left on device")
            left[0] -= 1
            real(source, target)

        monkeypatch.setattr("skfem_joint.ground.files.os.replace", full)
        out = tmp_path / f"out{allowed}"
        status = cli.main(["run", str(path), "--out", str(out), "--checkpoint-every", "100"])
        said = capsys.readouterr().err
        counts.add(assert_only_whole_files(out))
        assert {file.name for file in out.rglob(".*")} <= {LIST}
        if status == 0:
            break
        assert status == 2
        assert "No space left on device" in said
    assert status == 0
    assert len(counts) > 5
