"""The command line: exit statuses, messages, and the files it leaves."""

import io
import json
import logging
import os
import subprocess
import sys
from concurrent.futures import BrokenExecutor
from contextlib import chdir, redirect_stdout
from pathlib import Path

import numpy as np
import pytest
from scene_texts import written

import skfem_joint as sj
from skfem_joint import __version__, cli
from skfem_joint.ground.files import replacing
from skfem_joint.output.record import LIST, writing
from skfem_joint.study import study

ROOT = Path(__file__).parent.parent
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def scene(tmp_path):
    """Write the harmonic structure of ``examples/``, short, with some of its text replaced."""

    def write(*changes, more=""):
        text = (ROOT / "examples" / "structure_harmonic.toml").read_text(encoding="utf-8")
        short = ("cycles = 12", "cycles = 2"), ("vtk = true\nplots = true", NO_OUTPUT)
        return written(tmp_path, *short, *changes, text=text, more=more)

    return write


FULL_ONLY = ('run = ["full", "reduced"]', 'run = ["full"]')
ONE_CYCLE = ("cycles = 2", "cycles = 1")
NO_OUTPUT = "vtk = false\nplots = false"


def files_below(folder: Path) -> list[str]:
    """Names of all files and folders below a folder, but the list of what was written."""
    return sorted(str(f.relative_to(folder)) for f in folder.rglob("*") if f.name != LIST)


def command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "skfem_joint", *map(str, arguments)]


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ([], 0, "usage: skfem-joint"),
        (["--help"], 0, "error-time"),
        (["check", "--help"], 0, "SCENE.toml"),
        (["--version"], 0, __version__),
        (["fly"], 2, "usage: skfem-joint"),
        (["run", "scene.toml"], 2, "usage: skfem-joint"),
    ],
)
def test_help_and_wrong_usage(arguments, status, words, capsys):
    try:
        found: object = cli.main(arguments)
    except SystemExit as ended:
        found = ended.code
    shown = capsys.readouterr()
    assert found == status
    assert words in (shown.err if status else shown.out)


def test_as_much_is_said_as_is_asked_for(scene, tmp_path, capsys):
    out = tmp_path / "out"
    run = ["run", str(scene(FULL_ONLY, ONE_CYCLE)), "--out", str(out)]
    assert cli.main([*run, "-q"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (out / "history.npz").exists()
    assert cli.main([*run, "-v"]) == 0
    shown = capsys.readouterr()
    assert "Written to" in shown.out
    for words in ("200 unknowns", "200 of 200 steps", "newton iterations", "errors of the full"):
        assert words in shown.err
    assert cli.main(["-q", "check", str(tmp_path / "none.toml")]) == 2
    assert "none.toml" in capsys.readouterr().err


def test_a_shell_completes_every_command():
    shown = pytest.importorskip("shtab").complete(cli.parser(), "bash")
    names = "run check example keys backbone response random fit report error-time sweep"
    for name in ["nonlinear-modes", *names.split()]:
        assert name in shown
    assert "--checkpoint-every" in shown


def test_check_of_a_valid_scene_writes_nothing(scene, tmp_path, capsys):
    path = scene((NO_OUTPUT, "vtk = true\nplots = true"))
    with chdir(tmp_path):
        assert cli.main(["check", str(path)]) == 0
    shown = capsys.readouterr()
    assert "valid. 200 unknowns, 100 contact points, 400 steps of 1e-05 s" in shown.out
    assert "of what makes the first joint slip as a whole" in shown.out
    assert shown.err == ""
    assert files_below(tmp_path) == ["scene.toml"]


PULSE = """[[load]]
on = "free_end"
kind = "half_sine"
peak = 1e3
rise_time = 1e-3
"""


def test_check_refuses_what_the_command_refuses(scene, tmp_path, capsys):
    path = scene(("cycles = 2", 'until = "steady"'), more=f"\n{PULSE}")
    for asked in (["check", str(path)], ["run", str(path), "--out", str(tmp_path / "out")]):
        assert cli.main(asked) == 2
        assert "'steady' needs loads that repeat" in capsys.readouterr().err


def test_run_writes_what_the_scene_asks_for(scene, tmp_path, capsys):
    out = tmp_path / "deep" / "results"
    path = scene((NO_OUTPUT, "vtk = true\nframes = 4\nplots = true"))
    assert cli.main(["run", str(path), "--out", str(out)]) == 0
    shown = capsys.readouterr()
    assert "\x1b" not in shown.err  # no progress bar where there is no terminal
    assert "Jointed structure, harmonic load" in shown.out
    assert "friction energy per cycle, J" in shown.out
    assert "Written to" in shown.out
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert len(summary["warnings"]) >= 2
    assert all(f"Note: {sentence}" in shown.out for sentence in summary["warnings"])
    found = study.run_scene(sj.load_scene(path))
    assert list(found.notes) == summary["warnings"]
    assert all(fact in shown.out for fact in found.description.facts)
    assert summary["structure"] == found.description.values
    assert {"history.npz", "fields.pvd", "joint.png"} <= set(files_below(out))
    assert [file.name for file in out.rglob(".*")] == [LIST]  # no leftovers


def test_check_says_what_each_joint_is_and_each_note_once(tmp_path, capsys):
    text = (ROOT / "examples" / "plate_reference.toml").read_text(encoding="utf-8")
    table = "pressure = { positions = [-1.0, 0.0, 0.3], values = [0.0, 9e6, 2e6] }"
    changes = (("pressure = 8e6", table), ("thickness = 0.01", "thickness = 10.0"))
    assert cli.main(["check", str(written(tmp_path, *changes, text=text))]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "1 body, 1000 elements of order 1." in lines
    (joint,) = [line for line in lines if line.startswith("Joint joint: 1100 contact points")]
    assert "Position 0.0025 m of its pressures is at (0.0025, 0, 0) m." in joint
    assert "Regions: joint (1000 elements, 0.0125 m2)." in lines
    (names,) = [line for line in lines if line.startswith("Boundaries: ")]
    assert "fixed (10 sides, 0.05 m); free_end (10 sides, 0.05 m)" in names
    notes = [line for line in lines if line.startswith("Note: ")]
    assert len(notes) == len(set(notes)) == 2
    assert "is the mesh in metres?" in notes[0]


def test_files_are_whole_when_nobody_reads_the_table(scene, tmp_path):
    """A closed pipe, a full terminal and a file that knows no ° or é lose no result."""
    path = scene(FULL_ONLY, ONE_CYCLE, ('title = "', 'title = "Ring Ø 5 é '))
    read, write = os.pipe()
    os.close(read)
    for name, output, status in (("closed", write, 141), ("full", "/dev/full", 2)):
        with open(output, "wb") as stream:
            ended = subprocess.run(
                command("run", path, "--out", tmp_path / name), stdout=stream,
                stderr=subprocess.PIPE, text=True, timeout=120,
            )  # fmt: skip
        assert ended.returncode == status
        assert "Traceback" not in ended.stderr
        assert "Exception" not in ended.stderr
    with (tmp_path / "text").open("w", encoding="ascii") as stream, redirect_stdout(stream):
        assert cli.main(["run", str(path), "--out", str(tmp_path / "ascii")]) == 0
    assert (tmp_path / "text").read_bytes().startswith(b"Ring \\xd8 5 \\xe9 ")
    for name in ("closed", "full", "ascii"):
        assert files_below(tmp_path / name) == ["history.npz", "summary.json"]


def test_results_are_printed_before_their_errors_are_estimated(scene, tmp_path):
    """Files are written once errors are known: there is none when results are printed."""
    out, printed = tmp_path / "out", []

    class Watched(io.StringIO):
        def write(self, text):
            printed.append((text, (out / "summary.json").exists()))
            return len(text)

    with redirect_stdout(Watched()):
        assert cli.main(["run", str(scene(FULL_ONLY, ONE_CYCLE)), "--out", str(out)]) == 0
    (results,) = [there for text, there in printed if "peak displacement at free_end, mm" in text]
    (estimates,) = [there for text, there in printed if "full model, time step" in text]
    assert not results
    assert estimates
    assert any("Time of the estimates: " in text for text, _ in printed)


@pytest.mark.slow
@pytest.mark.parametrize("closed", [(1,), (2,), (1, 2), (0, 1, 2)])
def test_closed_streams_lose_no_result_and_get_into_no_file(closed, scene, tmp_path):
    path, out = scene(FULL_ONLY, ONE_CYCLE), tmp_path / "out"
    for run, status in ((command("run", path, "--out", out), 0), (command("check", out), 2)):
        ended = subprocess.run(
            run, timeout=120, preexec_fn=lambda: [os.close(number) for number in closed],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        assert ended.returncode == status
    assert files_below(out) == ["history.npz", "summary.json"]
    json.loads((out / "summary.json").read_text(encoding="utf-8"))
    with np.load(out / "history.npz", allow_pickle=False) as history:
        assert all(history[name].size for name in history)


def test_broken_streams_end_without_a_traceback(tmp_path):
    read, write = os.pipe()
    os.close(read)
    run = command("check", tmp_path / "none.toml")
    ended = subprocess.run(run, stdout=write, stderr=write, timeout=120)
    os.close(write)
    assert ended.returncode == 141


def test_what_a_terminal_would_obey_is_shown_as_escapes(scene, tmp_path, capsys):
    """A title, a name and a key: in results, refusals and progress."""
    wild = "\\u001B]0;mine\\u0007\\u009B31m\\u202Ered"
    path = scene(FULL_ONLY, ONE_CYCLE, ('title = "', f'title = "{wild}'))
    assert cli.main(["run", str(path), "--out", str(tmp_path / "out"), "-v"]) == 0
    refused = scene(("[output]\n", f'[output]\n"{wild}" = 1\n'))
    assert cli.main(["check", str(refused)]) == 2
    shown = capsys.readouterr()
    for text in shown:
        assert text.replace("\n", "").isprintable()
        assert "]0;mine" in text
    assert r"\x1b]0;mine\x07\x9b31m\u202ered" in shown.out


def test_check_takes_a_key_that_stands_in_the_sweep_alone(scene, capsys):
    wrong = scene(more='\n[sweep]\n"joint[7].friction" = [0.5, 0.7]\n')
    refused(["check", str(wrong)], capsys, "joint[7].friction")
    path = scene(("frequency = 500.0\n", ""), more='\n[sweep]\n"load[0].frequency" = [400, 500]\n')
    assert cli.main(["check", str(path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "the sweep's first, load[0].frequency = 400" in said
    assert "load[0].frequency: missing" in said
    assert "The sweep has 2 scenes, each valid." in said
    refused(["run", str(path), "--out", "out"], capsys, "load[0].frequency: missing")


@pytest.mark.parametrize(
    ("error", "status"),
    [(sj.ConvergenceError("step 7"), 3), (BrokenExecutor("killed"), 3), (KeyboardInterrupt(), 130)],
)
def test_results_outlive_what_ends_their_certificate(error, status, scene, tmp_path, monkeypatch):
    def fail(*args, **options):
        raise error

    monkeypatch.setattr("skfem_joint.study.certificate.certify", fail)
    out = tmp_path / "out"
    path = scene(FULL_ONLY, ONE_CYCLE)
    assert cli.main(["run", str(path), "--certify", "--out", str(out)]) == status
    summary = json.loads((out / "summary.json").read_text())
    assert summary["models"]["full"]["steps"] == 200
    assert any("errors" in warning for warning in summary["warnings"])


def refused(arguments: list[str], capsys: Capture, *words: str) -> list[str]:
    """Lines of the message of a command that ends with 2."""
    assert cli.main(arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("skfem-joint: ")
    assert "Traceback" not in shown.err
    for word in words:
        assert word in shown.err
    return shown.err.splitlines()


def refused_run(scene_file: Path, out: Path, capsys: Capture) -> list[str]:
    """Lines of the message of a scene that is refused, alike by `run` and `check`."""
    lines = refused(["check", str(scene_file)], capsys)
    assert refused(["run", str(scene_file), "--out", str(out)], capsys) == lines
    assert not out.exists()
    return lines


def test_missing_or_broken_files(scene, tmp_path, capsys):
    whole = (ROOT / "meshes" / "structure.msh").read_bytes()
    (tmp_path / "cut.msh").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "broken.toml").write_bytes(b"[mesh")
    paths = [tmp_path / "none.toml", tmp_path / "broken.toml"]
    for path in paths:
        assert str(path) in refused_run(path, tmp_path / "out", capsys)[0]
    for mesh in ("cut.msh", "none.msh"):
        path = scene((f"{(ROOT / 'meshes').as_posix()}/structure.msh", mesh))
        (line,) = refused_run(path, tmp_path / "out", capsys)
        assert "mesh.file: " in line
        assert mesh in line


@pytest.mark.parametrize(
    ("library", "asked"), [("matplotlib", "plots = true"), ("pyvista", "vtk = true")]
)
def test_a_missing_optional_library_is_named_before_the_run(
    library, asked, scene, tmp_path, capsys, monkeypatch
):
    for module in [name for name in sys.modules if name.split(".")[0] == library]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)
    path = scene(FULL_ONLY, (NO_OUTPUT, asked))
    refused(["run", str(path), "--out", str(tmp_path / "out")], capsys, "skfem-joint[")


STEADY = """
[backbone]
levels = 6
ring_down = 8

[response]
frequencies = { from = 2200.0, to = 2500.0, points = 3 }
levels = [0.1]
"""


def earlier(out: Path) -> Path:
    """Folder with results of another command, and a file of somebody else."""
    (out / "fields").mkdir(parents=True)
    (out / "notes.txt").write_text("old")
    with writing(out, {}):
        for name in ("joint.png", "fields/joint_0.vtu"):
            with replacing(out / name) as temporary:
                temporary.write_text("old")
    return out


@pytest.mark.parametrize("name", ["backbone", "response"])
def test_steady_vibration_leaves_a_table_a_picture_and_a_summary(name, scene, tmp_path, capsys):
    path, out = scene(more=STEADY), earlier(tmp_path / "out")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("[output]", "[output]\nuff = true"), encoding="utf-8")
    assert cli.main([name, str(path), "--out", str(out)]) == 0
    # The scene has a backbone too, which a response is drawn over.
    others = {
        "backbone": {"ring_down.csv", "shapes.png"},
        "response": {"peaks.csv", "backbone_response.png"},
    }
    ours = {f"{name}.csv", f"{name}.png", f"{name}.uff", "summary.json"} | others[name]
    assert set(files_below(out)) == ours | {"notes.txt"}
    rows = (out / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    columns = rows[0].split(",")
    wanted = {
        "backbone": {"mode", "level", "modal_amplitude", "frequency_Hz", "damping_ratio"},
        "response": {"level", "frequency_Hz", "amplitude_free_end_m", "residual", "step_error"},
    }
    assert wanted[name] <= set(columns)
    assert all(len(row.split(",")) == len(columns) for row in rows)
    content = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert list(content["models"]) == ["full", "reduced"]
    shown = capsys.readouterr().out
    assert f"Written to {out}" in shown
    assert "which stay unless results replace them: notes.txt." in shown


def test_random_vibration_leaves_tables_a_picture_and_a_summary(scene, tmp_path, capsys):
    (tmp_path / "psd.csv").write_text("Hz,N2/Hz\n500,1e3\n5000,1e3\n", encoding="utf-8")
    more = "[backbone]\nlevels = 12\nup_to = 2.0\n[random]\npsd = 'psd.csv'\n"
    asked = "vtk = false", "vtk = true\nuff = true"
    path, out = scene(FULL_ONLY, asked, more=more), tmp_path / "out"
    assert cli.main(["random", str(path), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "Note: The command random takes no account of output.uff." in shown
    assert "root mean square" in shown
    assert "friction does" in shown
    tables = {f"random{part}.csv" for part in ("", "_joints", "_points", "_psd")}
    assert set(files_below(out)) == tables | {"random.png", "summary.json"}
    content = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    (mode,) = content["models"]["full"]["modes"]
    assert mode["mode"] == 1
    assert content["load"] == "free_end"
    assert cli.main(["report", str(out)]) == 0
    base = "[[load]]\nkind = 'harmonic'\nbase = 'x'\namplitude = 1.0\nfrequency = 100.0\n"
    (tmp_path / "base.csv").write_text("Hz,(m/s2)2/Hz\n500,1e2\n5000,1e2\n", encoding="utf-8")
    lists = more.replace("'psd.csv'", "['psd.csv', 'base.csv']") + base
    out = tmp_path / "both"
    assert cli.main(["random", str(scene(FULL_ONLY, more=lists)), "--out", str(out)]) == 0
    content = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert content["load"] == "free_end and mass_x"
    *_, first, second, last = content["premises"]["assumptions"]
    assert "on 'free_end'" in first
    assert "1000 N²/Hz" in first
    assert "on 'mass_x'" in second
    assert "100 (m/s²)²/Hz" in second
    assert last == "These loads act without correlation."


def test_files_that_no_list_has_are_of_other_origin_and_stay(scene, tmp_path, capsys):
    """With --overwrite too, but those of the names of results."""
    out = earlier(tmp_path / "out")
    (out / LIST).unlink()
    (out / "history.npz").write_text("old")
    before = files_below(out)
    for name in ("error-time", "run", "backbone", "response"):
        assert cli.main([name, str(scene(more=STEADY)), "--out", str(out)]) == 2
        assert "give --overwrite" in capsys.readouterr().err
    assert files_below(out) == before
    assert cli.main(["run", str(scene(FULL_ONLY)), "--out", str(out), "--overwrite"]) == 0
    assert files_below(out) == before
    assert (out / "history.npz").read_bytes() != b"old"
    assert (out / "joint.png").read_text() == (out / "notes.txt").read_text() == "old"


@pytest.mark.parametrize(
    ("command", "table", "says"),
    [
        ("response", "", "response: missing"),
        ("error-time --repeats 0", "", "--repeats: found 0"),
        ("run --workers 2", "", "--certify"),
        ("run --checkpoint-every=0", "", "--checkpoint-every: found 0"),
        ("backbone", '[backbone]\nreleased = "loads"\n', "backbone.released"),
    ],
)
def test_what_a_command_cannot_be_asked_for(command, table, says, scene, tmp_path, capsys):
    path, out = scene(more=f"\n{table}"), earlier(tmp_path / "out")
    before = files_below(out)
    assert cli.main([*command.split(), str(path), "--out", str(out)]) == 2
    assert says in capsys.readouterr().err
    assert files_below(out) == before


def test_the_models_of_the_command_take_the_place_of_the_scene_s(scene, tmp_path):
    path, out = scene(ONE_CYCLE), tmp_path / "out"
    for given, found in (("reduced", ["reduced"]), ("reduced,full", ["full", "reduced"])):
        assert cli.main(["run", str(path), "--out", str(out), "--models", given]) == 0
        assert list(json.loads((out / "summary.json").read_text())["models"]) == found


@pytest.mark.parametrize(
    ("models", "changes", "says"),
    [
        ("full,small", (), "models.run[1]: found 'small', must be 'full', 'condensed' or"),
        ("", (), "models.run[0]: found '', must be 'full', 'condensed' or 'reduced'"),
        ("full,full", (), "models.run: "),
        ("full", [('run = ["full", "reduced"]', "fun = 3")], "models.fun: unknown key"),
        ("full", [("[models]\nrun = ", "[output.models]\nrun = ")], "output.models: "),
    ],
)
def test_models_of_the_command_are_checked_as_the_scene_s_are(
    models, changes, says, scene, tmp_path, capsys
):
    path, out = scene(*changes), tmp_path / "out"
    assert cli.main(["run", str(path), "--out", str(out), "--models", models]) == 2
    where = "--models" if says.startswith("models.run") else path
    assert f"{where}: {says}" in capsys.readouterr().err
    assert not out.exists()


def test_a_command_leaves_the_level_of_the_log_as_it_was():
    """A program that calls `main` quietly still hears the warnings of the package afterwards."""
    log = logging.getLogger("skfem_joint")
    before = log.level
    assert cli.main(["check", str(ROOT / "examples" / "structure_harmonic.toml"), "--quiet"]) == 0
    assert log.level == before
