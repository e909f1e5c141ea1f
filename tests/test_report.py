"""Summaries, tables and histories as files."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bars import LapJoint

from skfem_joint.errors import InputError
from skfem_joint.history import compare
from skfem_joint.integrate import integrate
from skfem_joint.recording import Run
from skfem_joint.report import model_summary, table, write_history, write_json

KEYS = {
    "dofs", "contact_points", "modes", "steps", "newton_iterations", "wall_s", "offline_s",
    "peak_displacement_m", "friction_energy_per_cycle_J", "loop_energy_per_cycle_J",
    "active_length_m", "energy_balance_residual",
}  # fmt: skip
ERROR_KEYS = {
    "displacement_rms", "displacement_max", "peak_displacement", "friction_energy_per_cycle",
    "loop_energy_per_cycle",
}  # fmt: skip


@pytest.fixture(scope="module")
def runs() -> dict[str, Run]:
    """Two meshes of one joint: the coarser one stands for a reduced model."""
    return {
        name: integrate(LapJoint(elements=n).system, step=1e-5, n_steps=300, cycle_steps=100)
        for name, n in (("full", 40), ("reduced", 20))
    }


def summary_of(runs: dict[str, Run]) -> dict[str, Any]:
    return {
        "models": {
            name: model_summary(
                run,
                modes=None if name == "full" else 5,
                offline_s=0.25,
                active_length={"joint": 0.2},
                errors=None if name == "full" else compare(runs["full"], run),
            )
            for name, run in runs.items()
        }
    }


def test_summary_has_the_keys_that_others_rely_on(runs: dict[str, Run]) -> None:
    models = summary_of(runs)["models"]
    assert set(models["full"]) >= KEYS
    assert set(models["reduced"]) >= KEYS | {"error"}
    assert "error" not in models["full"]
    assert set(models["reduced"]["error"]) >= ERROR_KEYS


def test_summary_holds_the_figures_of_the_run(runs: dict[str, Run]) -> None:
    run, summary = runs["full"], summary_of(runs)["models"]["full"]
    assert summary["dofs"] == summary["contact_points"] == 40
    assert summary["modes"] is None
    assert summary["steps"] == 300
    assert summary["peak_displacement_m"] == {"free_end": run.cycles.peak[-1, 0]}
    assert summary["friction_energy_per_cycle_J"] == run.cycles.friction[-1]
    assert summary["loop_energy_per_cycle_J"] == run.cycles.input[-1, 0]
    assert summary["energy_balance_residual"] == run.energy_residual
    works = summary["friction_energy_J"] + summary["viscous_work_J"] + summary["scheme_work_J"]
    stored = run.stored_energy[1]
    assert summary["input_work_J"] == pytest.approx(works + stored, rel=1e-10)


def test_summary_survives_json(runs: dict[str, Run], tmp_path: Path) -> None:
    summary = summary_of(runs)
    write_json(tmp_path / "summary.json", summary)
    assert json.loads((tmp_path / "summary.json").read_text()) == summary
    assert [file.name for file in tmp_path.iterdir()] == ["summary.json"]


def test_energies_per_cycle_are_null_without_cycles() -> None:
    run = integrate(LapJoint(elements=10).system, step=1e-5, n_steps=20)
    summary = model_summary(run, modes=None, offline_s=0.0, active_length={}, errors=None)
    assert summary["friction_energy_per_cycle_J"] is None
    assert summary["loop_energy_per_cycle_J"] is None
    assert summary["steady_state_reached"] is None
    assert summary["friction_energy_J"] > 0.0
    assert "friction energy, J" in table({"models": {"full": summary}})


def test_not_a_number_is_never_written(tmp_path: Path) -> None:
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not JSON compliant"):
            write_json(tmp_path / "summary.json", {"a": value})
    assert not list(tmp_path.iterdir())


def test_history_is_read_back_without_pickles(runs: dict[str, Run], tmp_path: Path) -> None:
    write_history(tmp_path / "history.npz", runs)
    with np.load(tmp_path / "history.npz", allow_pickle=False) as file:
        assert set(file) == {
            "time",
            "load_0_free_end",
            *(f"{m}_free_end_{q}" for m in runs for q in ("displacement", "velocity")),
        }
        assert np.array_equal(file["time"], runs["full"].times)
        assert np.array_equal(file["load_0_free_end"], runs["full"].amplitudes[:, 0])
        assert np.array_equal(file["reduced_free_end_velocity"], runs["reduced"].point_v[:, 0])


def test_history_of_an_interrupted_model_is_shorter(runs: dict[str, Run], tmp_path: Path) -> None:
    short = integrate(LapJoint(elements=20).system, step=1e-5, n_steps=100, cycle_steps=100)
    write_history(tmp_path / "history.npz", {"reduced": short, "full": runs["full"]})
    with np.load(tmp_path / "history.npz", allow_pickle=False) as file:
        assert file["time"].size == file["full_free_end_displacement"].size == 301
        assert file["reduced_free_end_displacement"].size == 101


def test_a_file_is_whole_or_not_there(tmp_path: Path) -> None:
    (tmp_path / "summary.json").mkdir()
    with pytest.raises(InputError, match=r"summary\.json: cannot be written"):
        write_json(tmp_path / "summary.json", {})
    with pytest.raises(InputError, match="cannot be written"):
        write_json(tmp_path / "missing" / "summary.json", {})
    assert [file.name for file in tmp_path.iterdir()] == ["summary.json"]
    write_json(tmp_path / "other.json", {"a": 1})
    write_json(tmp_path / "other.json", {"a": 2})
    assert json.loads((tmp_path / "other.json").read_text()) == {"a": 2}


def test_table_shows_what_the_summary_holds(runs: dict[str, Run]) -> None:
    summary = summary_of(runs)
    lines = table(summary).splitlines()
    assert lines[0].split() == ["full", "reduced"]
    rows = {line[: line.rindex("  ")].strip(): line for line in lines[2:]}
    text = "\n".join(lines)
    assert len(set(map(len, lines))) == 1  # columns stand below each other
    peak = 1e3 * runs["full"].cycles.peak[-1, 0]
    assert f"{peak:.5g}" in next(line for label, line in rows.items() if "peak" in label)
    error = summary["models"]["reduced"]["error"]["friction_energy_per_cycle"]
    line = next(line for line in lines if line.startswith("error of friction energy, %"))
    assert line.split()[-2:] == ["-", f"{100 * error:+.3g}"]
    assert "active length of joint, mm" in text
    assert "nan" not in text
    speed_up = runs["full"].wall_s / runs["reduced"].wall_s
    assert f"{speed_up:.2f}" in text


def test_table_of_one_model_shows_no_errors(runs: dict[str, Run]) -> None:
    text = table(summary_of({"full": runs["full"]}))
    assert "error" not in text
    assert "run time of the full model" not in text
