"""Runs that are killed go on from their checkpoints to the same result, to the bit."""

from __future__ import annotations

import ast
import json
import os
import resource
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bars import LapJoint

import skfem_joint
from skfem_joint import cli, output, study
from skfem_joint.checkpoint import Checkpoint, Checkpoints, fingerprint
from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate
from skfem_joint.loads import Rectangle, Table
from skfem_joint.recording import Save
from skfem_joint.scene import load_scene
from skfem_joint.schemes import generalized_alpha
from skfem_joint.system import System

ROOT = Path(__file__).parent.parent

JOINT = LapJoint(elements=30)
BASIS = np.linalg.qr(np.random.default_rng(1).normal(size=(30, 5)))[0]
SYSTEMS: dict[str, System] = {
    "chain": JOINT.system,
    "Coulomb": replace(JOINT, beta=np.inf).system,
    # Jumps off the grid of steps: parts of steps, each with a matrix of its own.
    "jumps": replace(JOINT, load=Rectangle(62e3, 3.37e-4, 1.13e-4)).system,
    "dense": JOINT.system.project(BASIS),
    "linear": replace(JOINT, friction=0.0).system,
}
TIMING: dict[str, Any] = {
    "step": 1e-5,
    "n_steps": 300,
    "cycle_steps": 25,
    "save": Save(every=3, fields=True, fields_every=7),
    "scheme": generalized_alpha(0.8),
}


class KilledError(Exception):
    """Ends a run as a kill would: nothing of it is left but its files."""


def kill_at(step: int) -> Callable[[int, int], None]:
    def progress(done: int, total: int) -> None:
        if done >= step:
            raise KilledError

    return progress


def never(done: int, total: int) -> None:
    raise AssertionError(f"integrated {done} of {total} steps again")


def differing(one: Any, other: Any, where: str = "") -> list[str]:
    """Attributes of two results that are not equal to the bit, run times excepted."""
    if is_dataclass(one):
        names = [f.name for f in fields(one) if f.name not in ("wall_s", "preparation_s", "system")]
        pairs = [(getattr(one, n), getattr(other, n), f"{where}.{n}") for n in names]
        return [name for a, b, place in pairs for name in differing(a, b, place)]
    if isinstance(one, tuple):
        pairs = [(a, b, f"{where}[{i}]") for i, (a, b) in enumerate(zip(one, other, strict=True))]
        return [name for a, b, place in pairs for name in differing(a, b, place)]
    if isinstance(one, np.ndarray):
        return [] if one.shape == other.shape and one.tobytes() == other.tobytes() else [where]
    return [] if one == other else [where]


def test_the_comparison_of_this_file_sees_a_bit() -> None:
    run = integrate(JOINT.system, **TIMING)
    u = run.u.copy()
    u[-1, -1] = np.nextafter(u[-1, -1], 1.0)
    assert differing(run, run) == []
    assert differing(run, replace(run, u=u)) == [".u"]


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("killed", [25, 175, 275])
def test_a_run_taken_up_again_is_the_same_to_the_bit(
    name: str, killed: int, tmp_path: Path
) -> None:
    system, path = SYSTEMS[name], tmp_path / "run.npz"
    whole = integrate(system, **TIMING)
    with pytest.raises(KilledError):
        integrate(
            system, **TIMING, progress=kill_at(killed), checkpoint=Checkpoint(path, "a", every=50)
        )
    ends: list[int] = []
    run = integrate(
        system,
        **TIMING,
        progress=lambda done, total: ends.append(done),
        checkpoint=Checkpoint(path, "a", every=50, resume=True),
    )
    saved = killed // 50 * 50
    assert ends[0] == saved + 25
    assert differing(whole, run) == []
    again = integrate(
        system, **TIMING, progress=never, checkpoint=Checkpoint(path, "a", resume=True)
    )
    assert differing(whole, again) == []
    assert again.wall_s == run.wall_s > 0.0


def test_checkpoints_change_no_bit_of_a_run_that_is_not_killed(tmp_path: Path) -> None:
    for name, system in SYSTEMS.items():
        checkpoint = Checkpoint(tmp_path / f"{name}.npz", "a", every=1)
        run = integrate(system, **TIMING, checkpoint=checkpoint)
        assert differing(integrate(system, **TIMING), run) == []


def test_what_is_integrated_must_be_the_same(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100)
    system = JOINT.system
    integrate(system, **TIMING, checkpoint=checkpoint)
    before = checkpoint.path.read_bytes()
    changes: list[tuple[System, dict[str, Any]]] = [
        (replace(system, beta=np.nextafter(system.beta, 0.0)), {}),
        (replace(JOINT, force=63e3 + 1.0).system, {}),
        (system, {"step": 1.1e-5}),
        (system, {"n_steps": 301}),
        (system, {"cycle_steps": None}),
        (system, {"save": Save()}),
        (system, {"scheme": generalized_alpha(0.9)}),
        (system, {"tolerance": 1e-12}),
    ]
    for changed, timing in changes:
        with pytest.raises(InputError, match=r"run\.npz: the model .* differs"):
            integrate(changed, **(TIMING | timing), checkpoint=replace(checkpoint, resume=True))
    with pytest.raises(InputError, match="another scene or mesh"):
        integrate(system, **TIMING, checkpoint=replace(checkpoint, origin="b", resume=True))
    assert checkpoint.path.read_bytes() == before


def test_another_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100, resume=True)
    integrate(JOINT.system, **TIMING, checkpoint=checkpoint)
    monkeypatch.setattr("skfem_joint.checkpoint.__version__", "99.0")
    with pytest.raises(InputError, match=r"written by version .*, this is 99\.0"):
        integrate(JOINT.system, **TIMING, checkpoint=checkpoint)


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_checkpoint_is_refused_or_is_the_whole_one(seed: int, tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100, resume=True)
    system = replace(JOINT, elements=4).system
    whole = integrate(system, **TIMING, checkpoint=checkpoint)
    data, rng = checkpoint.path.read_bytes(), np.random.default_rng(seed)
    damaged = [data[: rng.integers(len(data))] for _ in range(20)] + [b""]
    for _ in range(60):
        copy = bytearray(data)
        for place in rng.integers(len(data), size=rng.integers(1, 4)):
            copy[place] = rng.integers(256)
        damaged.append(bytes(copy))
    messages = []
    for content in damaged:
        checkpoint.path.write_bytes(content)
        try:
            run = integrate(system, **TIMING, checkpoint=checkpoint)
        except InputError as error:
            messages.append(str(error))
        else:
            assert differing(whole, run) == []
    assert len(messages) > 50
    assert all(message.startswith(str(checkpoint.path)) for message in messages)


def test_objects_in_a_checkpoint_are_not_loaded(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[Any, ...]:
            return (Path.write_text, (tmp_path / "sprung", "code ran"))

    path = tmp_path / "run.npz"
    np.savez(path, notes=np.array([Trap()], dtype=object))
    with pytest.raises(InputError, match="cannot be read as a checkpoint"):
        Checkpoint(path, "a", resume=True).load("b")
    assert not (tmp_path / "sprung").exists()


def test_no_module_loads_what_can_run_code() -> None:
    """No pickle, marshal, shelve or eval, and numpy is told not to either."""
    package = Path(skfem_joint.__file__).parent
    loads = 0
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name.split(".")[0] for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [str(node.module).split(".")[0]]
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                names = [node.func.id] if node.func.id in ("eval", "exec", "__import__") else []
            forbidden = {"pickle", "dill", "joblib", "cloudpickle", "marshal", "shelve"}
            assert not forbidden & set(names), path
            assert not {"eval", "exec", "__import__"} & set(names), path
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("np.load", "numpy.load"):
                options = {key.arg: ast.unparse(key.value) for key in node.keywords}
                assert options.get("allow_pickle") == "False", f"{path}: line {node.lineno}"
                loads += 1
    assert loads > 0


def test_fingerprints_tell_apart_what_differs_and_nothing_else() -> None:
    table = Table([0.0, 1.0], [0.0, 1.0])
    same = fingerprint(JOINT.system, table, {"a": 1.0}, [None, True, "text"])
    assert fingerprint(JOINT.system, table, {"a": 1.0}, (None, True, "text")) != same
    assert fingerprint(replace(JOINT).system, table, {"a": 1.0}, [None, True, "text"]) == same
    parts: list[Any] = [0, 0.0, -0.0, False, None, "", "0", [], [0], [[0]], [0, 0], {}, {"": 0},
                        np.zeros(1), np.zeros(2), np.zeros((1, 1)), np.zeros(1, int), table,
                        Table([0.0, 1.0], [0.0, 2.0]), ["ab", "c"], ["a", "bc"]]  # fmt: skip
    assert len({fingerprint(part) for part in parts}) == len(parts)
    with pytest.raises(TypeError, match="function"):
        fingerprint(kill_at)


# The command


@pytest.fixture
def scene(tmp_path: Path) -> Callable[..., Path]:
    def write(
        steps: int = 200, cycles: int = 30, output: str = "", run: str = '"full", "reduced"'
    ) -> Path:
        mesh = (ROOT / "meshes" / "structure.msh").as_posix()
        text = (
            f'[mesh]\nfile = "{mesh}"\n[material]\nE = 200e9\ndensity = 8000.0\n'
            "[section]\nwidth = 0.05\nthickness = 0.01\n"
            '[support]\nfixed = ["fixed"]\n'
            '[[joint]]\nregion = "joint"\npressure = 50e6\nfriction = 0.7\n'
            '[[load]]\non = "free_end"\nkind = "harmonic"\namplitude = 87.5e3\nfrequency = 500.0\n'
            f"[time]\ncycles = {cycles}\nsteps_per_cycle = {steps}\n"
            f"[models]\nrun = [{run}]\n[output]\n{output}\n"
        )
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def results(folder: Path) -> tuple[Mapping[str, Any], Mapping[str, bytes]]:
    """Summary without times, and the arrays of the history as bytes."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    for model in summary["models"].values():
        del model["wall_s"], model["offline_s"]
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
        elif path.suffix == ".png":
            from matplotlib.image import imread

            assert imread(path).ndim == 3
        elif path.suffix == ".pvd":
            for data in ET.parse(path).getroot().findall(".//DataSet"):
                assert (folder / str(data.get("file"))).is_file()
        elif path.suffix == ".vtu":
            import pyvista

            assert pyvista.read(path).n_points > 0
        else:
            raise AssertionError(f"{path} should not be there")
    return count


def launch(*arguments: str | Path, **options: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "skfem_joint", *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options,
    )  # fmt: skip


def test_killed_at_random_times_and_resumed_is_the_same_to_the_bit(
    scene: Callable[..., Path], tmp_path: Path
) -> None:
    path = scene(cycles=200, output="every = 10")
    assert cli.main(["run", str(path), "--out", str(tmp_path / "whole")]) == 0
    rng = np.random.default_rng(5)
    out = tmp_path / "out"
    arguments = ("run", path, "--out", out, "--checkpoint-every", "400", "--resume")
    kills = 0
    for _ in range(6):
        checkpoint = out / f"checkpoint_{('full', 'full', 'reduced')[kills % 3]}.npz"
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        process = launch(*arguments)
        try:
            # Let it get one checkpoint further, then anything from nothing to many more.
            end = time.monotonic() + 30.0
            while process.poll() is None and time.monotonic() < end:
                if checkpoint.exists() and checkpoint.stat().st_mtime_ns != before:
                    break
                time.sleep(0.002)
            time.sleep(float(rng.uniform(0.0, 0.1)))
            process.send_signal(signal.SIGKILL)
        finally:
            process.kill()
            process.communicate()
        kills += process.returncode == -signal.SIGKILL
        assert_only_whole_files(out)
        if process.returncode == 0:
            break
    assert kills >= 3
    process = launch(*arguments)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == 0, said
    assert results(out) == results(tmp_path / "whole")
    assert sorted(file.name for file in out.rglob("*")) == ["history.npz", "summary.json"]


#: Scenes of each kind, with what distinguishes them from the first one.
KINDS = {
    "bar": "structure_harmonic.toml",
    "bar under an impulse": "structure_impulse.toml",
    "plate": "plate_reference.toml",
    "two plates": "two_plates.toml",
}


@pytest.mark.parametrize("model", ["full", "reduced"])
@pytest.mark.parametrize("kind", KINDS)
def test_every_file_of_a_resumed_run_is_that_of_a_whole_one(
    kind: str, model: str, tmp_path: Path
) -> None:
    """Fields of frames before the checkpoint too: the stored ones are not mixed up with others."""
    scene = load_scene(ROOT / "examples" / KINDS[kind])
    output_table = {"vtk": True, "plots": False, "history": True, "frames": 12}
    changes: dict[str, Any] = {
        "output": scene.output.model_copy(update=output_table),
        "models": scene.models.model_copy(update={"run": (model,)}),
    }
    if scene.time.cycles is None:
        times = {"duration": 20 * scene.time_step}
    else:
        times = {"cycles": 2, "steps_per_cycle": 12}
    changes["time"] = scene.time.model_copy(update=times)
    scene = scene.model_copy(update=changes)
    whole, out = tmp_path / "whole", tmp_path / "out"
    for folder in (whole, out):
        output.prepare(scene, folder)

    def kill(label: str, done: int, total: int) -> None:
        if label == f"{model} model" and done >= total // 2:
            raise KilledError

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("skfem_joint.integrate.MOST_STEPS_IN_A_CHUNK", 5)
        output.write(study.run_scene(scene), whole)
        with pytest.raises(KilledError):
            study.run_scene(scene, kill, Checkpoints(out, every=1))
        checkpoints = Checkpoints(out, every=1, resume=True)
        resumed = study.run_scene(scene, None, checkpoints)
    checkpoints.remove()
    output.write(resumed, out)
    assert results(out) == results(whole)
    names = [sorted(path.relative_to(f) for path in f.rglob("*.vtu")) for f in (whole, out)]
    assert names[0] == names[1]
    assert len(names[0]) > 10
    for name in names[0]:
        assert (whole / name).read_bytes() == (out / name).read_bytes(), name


def test_killed_while_it_writes_leaves_whole_files(
    scene: Callable[..., Path], tmp_path: Path
) -> None:
    path = scene(cycles=2, output="vtk = true\nplots = true\nframes = 40", run='"full"')
    out = tmp_path / "out"
    rng = np.random.default_rng(7)
    seen = set()
    for _ in range(3):
        process = launch("run", path, "--out", out)
        try:
            end = time.monotonic() + 30.0
            while not list(out.glob("*.json")) and time.monotonic() < end:
                time.sleep(0.002)
            time.sleep(float(rng.uniform(0.0, 1.2)))
            process.send_signal(signal.SIGKILL)
        finally:
            process.kill()
            process.communicate()
        seen.add(assert_only_whole_files(out))
        for file in out.rglob("*.json"):
            file.unlink()
    assert cli.main(["run", str(path), "--out", str(out)]) == 0
    assert_only_whole_files(out)
    assert not list(out.rglob(".*"))  # what the killed ones had begun is cleared


def test_a_finished_model_is_not_run_again(
    scene: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, out = scene(cycles=4), tmp_path / "out"
    assert cli.main(["run", str(path), "--out", str(tmp_path / "whole")]) == 0
    original = study._reduced

    def killed(*_: Any) -> Any:
        raise KilledError

    monkeypatch.setattr(study, "_reduced", killed)
    arguments = ["run", str(path), "--out", str(out), "--checkpoint-every", "300"]
    with pytest.raises(KilledError):
        cli.main(arguments)
    assert [file.name for file in out.iterdir()] == ["checkpoint_full.npz"]
    monkeypatch.setattr(study, "_reduced", original)
    steps: list[str] = []
    scene_read = study.run_scene

    def watched(what: Any, progress: Any, checkpoints: Any) -> Any:
        return scene_read(what, lambda label, done, total: steps.append(label), checkpoints)

    monkeypatch.setattr(study, "run_scene", watched)
    assert cli.main([*arguments, "--resume"]) == 0
    assert set(steps) == {"reduced model"}
    assert results(out) == results(tmp_path / "whole")
    assert not list(out.glob("checkpoint_*"))


def test_nothing_is_lost_without_resume(
    scene: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "checkpoint_full.npz").write_bytes(b"hours of work")
    arguments = ["run", str(scene()), "--out", str(out), "--checkpoint-every", "300"]
    assert cli.main(arguments) == 2
    assert "go on with --resume" in capsys.readouterr().err
    assert (out / "checkpoint_full.npz").read_bytes() == b"hours of work"
    assert cli.main([*arguments, "--resume"]) == 2
    assert "cannot be read as a checkpoint" in capsys.readouterr().err


def test_another_scene_or_mesh_is_refused(
    scene: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = scene(cycles=2, run='"full"'), tmp_path / "out"
    text = path.read_text(encoding="utf-8")
    mesh = (ROOT / "meshes" / "structure.msh").read_text(encoding="utf-8")
    (tmp_path / "own.msh").write_text(mesh, encoding="utf-8")
    text = text.replace((ROOT / "meshes" / "structure.msh").as_posix(), "own.msh")
    path.write_text(text, encoding="utf-8")
    out.mkdir()
    study.run_scene(load_scene(path), checkpoints=Checkpoints(out, every=100))
    arguments = ["run", str(path), "--out", str(out), "--resume"]
    for change in (("friction = 0.7", "friction = 0.71"), ("cycles = 2", "cycles = 3")):
        path.write_text(text.replace(*change), encoding="utf-8")
        assert cli.main(arguments) == 2
        assert "another scene or mesh" in capsys.readouterr().err
    path.write_text(text, encoding="utf-8")
    (tmp_path / "own.msh").write_text(mesh.replace("0.6 ", "0.601 "))
    assert cli.main(arguments) == 2
    assert "another scene or mesh" in capsys.readouterr().err
    (tmp_path / "own.msh").write_text(mesh, encoding="utf-8")
    assert cli.main(arguments) == 0


@pytest.mark.parametrize("steps", ["0", "-3"])
def test_steps_between_checkpoints_must_be_positive(
    steps: str, scene: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert cli.main(["run", str(scene()), "--out", str(out), f"--checkpoint-every={steps}"]) == 2
    assert "--checkpoint-every: found" in capsys.readouterr().err
    assert not out.exists()


# A disk that fills up


@pytest.mark.parametrize("kilobytes", [6, 60])
def test_a_limit_on_file_sizes_leaves_whole_files(
    kilobytes: int, scene: Callable[..., Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    path = scene(cycles=2, output="vtk = true\nplots = true\nframes = 2", run='"full"')

    def limited() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1024 * kilobytes, 1024 * kilobytes))

    arguments = ("run", path, "--out", out, "--checkpoint-every", "100")
    process = launch(*arguments, preexec_fn=limited)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == 2, said
    assert "File too large" in said or "is the disk full?" in said
    assert "Traceback" not in said
    assert_only_whole_files(out)
    assert not list(out.rglob(".*"))


def test_a_full_disk_of_a_library_is_told_without_a_traceback(
    scene: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Numba keeps compiled code in files of its own."""

    def full(*_: Any) -> Any:
        raise OSError(28, "No space left on device", "cache")

    monkeypatch.setattr(study, "_full", full)
    assert cli.main(["run", str(scene()), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "No space left on device: 'cache'" in said
    assert said.count("\n") == 1


def test_a_disk_that_is_full_at_any_moment_leaves_whole_files(
    scene: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = scene(cycles=2, output="plots = true\nvtk = true\nframes = 2", run='"full"')
    real = os.replace
    counts = set()
    for allowed in range(40):
        left = [allowed]

        def full(source: Any, target: Any, left: list[int] = left) -> None:
            if left[0] == 0:
                raise OSError(28, "No space left on device")
            left[0] -= 1
            real(source, target)

        monkeypatch.setattr("skfem_joint.files.os.replace", full)
        out = tmp_path / f"out{allowed}"
        status = cli.main(["run", str(path), "--out", str(out), "--checkpoint-every", "100"])
        said = capsys.readouterr().err
        counts.add(assert_only_whole_files(out))
        assert not list(out.rglob(".*"))
        if status == 0:
            break
        assert status == 2
        assert "No space left on device" in said
    assert status == 0
    assert len(counts) > 5


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint = Checkpoint(tmp_path / "run.npz", "a", every=100)
    checkpoint.save({"run": {"rows": np.arange(3)}}, "b", 100, 1.0)

    def half(file: Any, **_: Any) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("skfem_joint.checkpoint.np.savez", half)
    with pytest.raises(InputError, match="No space left"):
        checkpoint.save({"run": {"rows": np.arange(4)}}, "b", 200, 2.0)
    loaded = replace(checkpoint, resume=True).load("b")
    assert loaded is not None
    assert loaded[1:] == (100, 1.0)
    assert loaded[0]["run"]["rows"].size == 3
    assert os.listdir(tmp_path) == ["run.npz"]
