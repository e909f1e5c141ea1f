"""Scenes drawn at random, damaged files, runs that are killed: a little of each script."""

import io

import pytest
from scipy.io import savemat
from stability import checks, hostile, killed, mutated, pairs


@pytest.mark.slow
def test_scenes_drawn_at_random_break_nothing(tmp_path, capsys):
    assert mutated.main(["--out", str(tmp_path), "--count", "60", "--seed", "77"]) == 0
    said = capsys.readouterr().out
    assert said.count("valid, ") == 3
    assert "damaged: refused" in said
    assert "60 scenes" in said


@pytest.mark.parametrize(
    ("where", "bound"), [(mutated, "SAME"), (mutated, "ENERGY"), (checks, "ROUND_OFF")]
)
def test_a_broken_invariant_is_reported_and_its_scene_kept(
    tmp_path, capsys, monkeypatch, where, bound
):
    monkeypatch.setattr(where, bound, -2.0)
    assert mutated.main(["--out", str(tmp_path), "--count", "1"]) == 1
    assert "BROKEN: BrokenError: 1" in capsys.readouterr().out
    assert (tmp_path / "broken_0" / "scene.toml").exists()


FEW = ["csr.npz", "plain.mat", "coordinate.mtx", "mesh.msh", "checkpoint.npz"]


@pytest.mark.slow
def test_hostile_files_are_refused_or_run_rightly(tmp_path, capsys):
    arguments = ["--out", str(tmp_path), "--count", "15", "--kinds", *FEW]
    assert hostile.main(arguments) == 0
    said = capsys.readouterr().out
    assert "15 files: " in said
    assert "0 broken" in said
    assert said.count("| refused |") >= 8
    assert [*tmp_path.iterdir()] == []


@pytest.mark.slow
def test_a_hostile_file_whose_results_differ_is_reported_and_kept(tmp_path, capsys, monkeypatch):
    def stiffer(content, rng, kind):
        file = io.BytesIO()
        savemat(file, {"K": 2.0 * hostile.stiffness("csc")})
        return "type", file.getvalue()

    monkeypatch.setitem(hostile.SPECIAL, "packed.mat", stiffer)
    arguments = ["--out", str(tmp_path), "--count", "1", "--kinds", "packed.mat"]
    assert hostile.main(arguments) == 1
    assert "1 wrong in silence; 1 broken" in capsys.readouterr().out
    assert (tmp_path / "file_0" / "packed.mat").exists()


@pytest.mark.slow
def test_killed_and_paired_runs_leave_the_files_of_whole_ones(tmp_path, capsys, monkeypatch):
    short = killed.KINDS["bar"][0], "cycles = 10", *killed.KINDS["bar"][2:]
    monkeypatch.setitem(killed.KINDS, "bar", short)
    few = ["--kinds", "bar", "two plates", "--kills", "3", "--pairs", "1", "--rows", "0"]
    assert killed.main(["--out", str(tmp_path), *few]) == 0
    said = capsys.readouterr().out
    assert said.count("the same to the bit") == 2
    assert "every file right" in said


@pytest.mark.slow
def test_steady_vibration_of_pairs_of_plates_is_that_of_long_time_integration(capsys):
    assert pairs.main(["--count", "4"]) == 0
    assert "4 of 4 amplitudes" in capsys.readouterr().out


@pytest.mark.slow
def test_an_amplitude_that_differs_from_long_time_integration_is_reported(capsys, monkeypatch):
    monkeypatch.setattr(pairs, "ALLOWED", 0.0)
    assert pairs.main(["--count", "1"]) == 1
    assert "WRONG" in capsys.readouterr().out
