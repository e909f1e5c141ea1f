"""A sweep's folder: the table, the pictures, and what an interrupted command leaves to the next."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene_texts import csv_rows, written

import skfem_joint as sj
from skfem_joint import cli
from skfem_joint.output import folder, plots, sweeps

PRODUCT = '"joint[0].friction" = [0.3, 0.7]\n"time.cycles" = [1, 2, 3]'
ONE = '"load[0].amplitude" = {from = 1e3, to = 1e5, points = 3, scale = "log"}'
FULL = ('"full", "reduced"', '"full"')
WORDS = (
    'combine = "list"\n"joint[0].normal_force" = ["consistent", "equal"]\n"time.cycles" = [1, 2]'
)


def sweep_file(folder: Path, sweep: str, *changes: tuple[str, str]) -> Path:
    return written(folder, *changes, more=f"[sweep]\n{sweep}\n")


def swept_of(folder: Path, sweep: str) -> sj.Swept:
    return sj.load_sweep(sweep_file(folder, sweep, ("every = 1", "plots = true")))


def read(folder: Path) -> list[dict[str, str]]:
    """Rows of the table that is in a folder."""
    return csv_rows(folder / sweeps.TABLE)


def row(number: int, peak: float | None = None, failure: str = "") -> sj.Row:
    results: dict[str, Any] = {"dofs": 200, "wall_s": 0.1 + number, "interrupted": False}
    if peak is not None:
        results |= {"peak_displacement_m.free_end": peak, "friction_energy_per_cycle_J": None}
        results |= {"estimated_error.loop_energy.total": 0.01, "estimated_error.loop_energy.x": 1}
    models = {f"{model}.{name}": x for model in ("full", "reduced") for name, x in results.items()}
    return sj.Row(number, models, failure)


def test_the_table_is_in_the_order_of_the_scenes_and_has_what_is_asked_for(tmp_path):
    swept = swept_of(tmp_path, PRODUCT)
    rows = [row(k, 1e-4 * k) for k in (5, 2, 0, 1, 4)] + [row(3, failure="step 3")]
    files = sweeps.write(swept, rows, tmp_path)
    found = read(tmp_path)
    assert [int(one["scene"]) for one in found] == list(range(6))
    assert [float(one["joint[0].friction"]) for one in found] == [0.3] * 3 + [0.7] * 3
    assert [one["failure"] for one in found] == ["", "", "", "step 3", "", ""]
    results = ("wall_s", "peak_displacement_m.free_end", "estimated_error.loop_energy.total")
    wanted = {f"{model}.{name}" for model in ("full", "reduced") for name in results}
    always = {"scene", "joint[0].friction", "time.cycles", "warnings", "failure"}
    assert set(found[0]) == always | wanted
    assert float(found[2]["full.peak_displacement_m.free_end"]) == 2e-4
    assert found[3]["full.peak_displacement_m.free_end"] == ""
    names = {f"sweep_{name}.png" for name in results}
    assert {file.name for file in files} >= {"sweep.csv", *names}
    parquet = pytest.importorskip("pyarrow.parquet")
    columns = parquet.read_table(tmp_path / "sweep.parquet").to_pydict()
    assert set(columns) == set(found[0])
    assert columns["full.peak_displacement_m.free_end"] == [0.0, 1e-4, 2e-4, None, 4e-4, 5e-4]


def test_pictures_show_the_results_over_one_key_or_two(tmp_path):
    def drawn(sweep, rows):
        swept = swept_of(tmp_path, sweep)
        found = dict(sweeps.figures(swept, sweeps.columns(swept, rows)))
        return found.get("peak_displacement_m.free_end")

    (panel,) = drawn(ONE, [row(k, 1e-4 * k) for k in (2, 0, 1)]).axes
    assert panel.get_xscale() == "log"
    assert panel.get_xlabel() == "load[0].amplitude\namplitude of the force, N"
    assert panel.get_ylabel() == "peak displacement of free_end, µm"
    for line, name in zip(panel.lines, ("full", "reduced"), strict=True):
        assert line.get_label() == name
        np.testing.assert_allclose(line.get_xdata(), [1e3, 1e4, 1e5])
        np.testing.assert_allclose(line.get_ydata(), [0, 100, 200])
    (panel,) = drawn(WORDS, [row(0, 1e-4), row(1, 2e-4)]).axes
    assert [tick.get_text() for tick in panel.get_xticklabels()] == ["consistent", "equal"]
    rows = [row(k, 1e-4 * k) for k in (0, 1, 2, 4, 5)] + [row(3, failure="step 3")]
    figure = drawn(PRODUCT, rows)
    grid = figure.axes[0].images[0].get_array().filled(np.nan)
    np.testing.assert_allclose(grid, [[0, np.nan], [100, 400], [200, 500]])
    plots.save_figure(tmp_path / "map.png", figure)
    assert figure.axes[0].get_ylabel() == "time.cycles\nnumber of cycles"
    three = f'{PRODUCT}\n"damping.mass" = [1]'
    assert drawn(three, [row(k, 1e-4) for k in range(6)]) is None


@pytest.mark.slow
def test_an_interrupted_sweep_leaves_a_table_and_goes_on_and_so_does_a_killed_one(tmp_path, capsys):
    sweep = '"joint[0].friction" = { from = 0.1, to = 0.8, points = 8 }'
    alone = "cycles = 150\n[accuracy]\nestimate = false"
    path = sweep_file(tmp_path, sweep, ("cycles = 3", alone), FULL, ("every = 1", "plots = true"))
    out, count = tmp_path / "out", 8
    journal = out / sweeps.JOURNAL
    arguments = ["sweep", str(path), "--out", str(out), "--workers", "2"]

    def lines():
        return journal.read_text().splitlines(keepends=True) if journal.exists() else []

    for number in (signal.SIGINT, signal.SIGKILL):
        before, end = len(lines()) + 1, time.monotonic() + 120.0
        command = [sys.executable, "-m", "skfem_joint", *arguments]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        while len(lines()) <= before and time.monotonic() < end:  # two rows more are kept
            time.sleep(0.005)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        process.send_signal(number)
        said, _ = process.communicate(timeout=60.0)
        assert children
        while any(Path(f"/proc/{child}").exists() for child in children):
            assert time.monotonic() < end  # workers end with the process that started them
            time.sleep(0.05)
        if number == signal.SIGINT:
            assert process.returncode == cli.INTERRUPTED
            ended = len(read(out))
            assert ended == len(lines()) - 1 < count  # a row kept as the interrupt comes is in it
            assert not [*out.glob("*.png")]  # which take seconds
            assert f"{ended} of {count} scenes have ended, 0 of them failed" in said
    kept = [line for line in lines() if line.endswith("\n")]
    assert 2 <= len(kept) < count
    assert cli.main(arguments) == 0
    shown = capsys.readouterr()
    assert f"{len(kept) - 1} finished rows are taken up where they fit." in shown.err
    assert f"Note: {len(kept) - 1} finished parts were taken up from" in shown.out
    assert [*out.glob("*.png")]
    assert lines()[: len(kept)] == kept
    assert [int(one["scene"]) for one in read(out)] == list(range(count))
    # Another command's results take the place of the table, not of what the sweep goes on from.
    with folder.kept(out):
        assert {file.name for file in out.iterdir() if file.name[0] != "."} == {sweeps.JOURNAL}


def test_failed_scenes_are_reported_with_their_keys(tmp_path, capsys):
    sweep = '"reduction.reference" = ["static", "paper"]'
    short = "cycles = 1\n[accuracy]\nestimate = false"
    path = sweep_file(tmp_path, sweep, ("modes = 5\n", "modes = 5000\n"), ("cycles = 3", short))
    arguments = ["sweep", str(path), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert cli.main(["check", str(path)]) == 0
    assert "The sweep has 2 scenes, each valid." in capsys.readouterr().out
    assert cli.main(arguments) == 3
    said = capsys.readouterr().out
    assert "Scene 1, reduction.reference = 'paper': reduction.modes: found 5000" in said
    assert "2 of 2 scenes have ended, 1 of them failed" in said


def test_the_table_has_warnings_and_what_is_not_steady_and_the_summary_counts_them(tmp_path):
    swept = swept_of(tmp_path, PRODUCT)
    steady = {0: True, 1: False, 2: None}
    rows = [
        sj.Row(k, {"full.dofs": 3, "full.steady_state_reached": x}, notes=("It slid.",) * k)
        for k, x in steady.items()
    ]
    sweeps.write(swept, rows, tmp_path)
    found = read(tmp_path)
    assert [one["full.steady_state_reached"] for one in found] == ["True", "False", ""]
    assert [one["warnings"] for one in found] == ["", "It slid.", "It slid. It slid."]
    content = json.loads((tmp_path / "summary.json").read_text())
    assert (content["scenes_with_warnings"], content["scenes_not_steady"]) == (2, 1)
    assert content["warnings"] == {"1": ["It slid."], "2": ["It slid.", "It slid."]}


def test_results_that_no_scene_has_are_named(tmp_path):
    """A sweep without cycles has no loss factor, and says so."""
    swept = swept_of(tmp_path, PRODUCT + '\nresults = ["loss_factor", "dofs"]')
    rows = [sj.Row(0, {"full.dofs": 3, "full.friction_energy_per_cycle_J": None})]
    assert "No scene has loss_factor: what is of a cycle" in "\n".join(sweeps.lines(swept, rows))
    sweeps.write(swept, rows, tmp_path)
    assert "full.loss_factor" not in read(tmp_path)[0]
    content = json.loads((tmp_path / "summary.json").read_text())
    assert content["results_without_column"] == ["loss_factor"]
    whole = [sj.Row(0, {"full.dofs": 3, "full.loss_factor": 0.1})]
    assert "No scene has" not in "\n".join(sweeps.lines(swept, whole))
