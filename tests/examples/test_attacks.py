"""Scenes drawn at random, damaged files, runs that are killed: a little of each script."""

import io
import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
from joint_scenes import bar_scene
from scipy.io import savemat
from stability import hostile, killed, mutated, pairs

from skfem_joint import build_bar, run_scene


@pytest.mark.slow
def test_scenes_drawn_at_random_break_nothing(tmp_path, capsys):
    assert mutated.main(["--out", str(tmp_path), "--count", "60", "--seed", "77"]) == 0
    said = capsys.readouterr().out
    assert said.count("valid, ") == 3
    assert "damaged: refused" in said
    assert "60 scenes" in said


def test_what_breaks_is_reported_and_its_scene_kept(tmp_path, capsys):
    def judged(number, seed, folder):
        mutated.judge(number + 1, seed, folder)
        mutated.hold(False, "it is off")

    assert mutated.main(["--out", str(tmp_path), "--count", "1"], judged) == 1
    assert "scene 0: BrokenError: it is off" in capsys.readouterr().out
    assert (tmp_path / "broken_0" / "scene.toml").exists()


@pytest.fixture(scope="module")
def study():
    bar = build_bar([("joint", 0.1, 5)], {"fixed": 0.0, "free_end": 0.1})
    return run_scene(bar_scene("full", bar=bar, time={"cycles": 1}, output={"vtk": True}))


@pytest.mark.parametrize(
    ("of", "damage", "words"),
    [
        ("input_work", lambda work: 2.0 * work, "energy open by"),
        ("sigma", lambda sigma: -sigma, "not against the slip"),
        ("peak", lambda peak: np.nan * peak, "not finite"),
    ],
)
def test_a_broken_invariant_is_seen(study, of, damage, words):
    mutated.check(study)
    full = study.models["full"]
    run = replace(full.run, **{of: damage(getattr(full.run, of))})
    with pytest.raises(mutated.BrokenError, match=words):
        mutated.check(replace(study, models={"full": replace(full, run=run)}))


def test_another_motion_is_seen(study):
    mutated.same(study, study, 1.0, 1.0)
    with pytest.raises(mutated.BrokenError, match="differs by 1e-05 of the displacement"):
        mutated.same(study, study, 1.0 / (1.0 + 1e-5), 1.0)


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
def test_a_hostile_file_whose_results_differ_is_wrong_in_silence(tmp_path):
    kind, context = "packed.mat", multiprocessing.get_context("forkserver")
    hostile.write_scene(tmp_path / "whole", kind)
    hostile.run_apart(context, tmp_path / "whole")
    whole, _ = hostile.results(tmp_path / "whole")
    file = io.BytesIO()
    savemat(file, {"K": 2.0 * hostile.stiffness("csc")})
    hostile.write_scene(tmp_path / "stiffer", kind)
    case = hostile.Case(kind, "type", kind, file.getvalue())
    verdict = hostile.judge(case, tmp_path / "stiffer", context, whole)
    assert verdict.outcome == "wrong in silence"
    assert not verdict.is_right


@pytest.mark.slow
def test_killed_and_paired_runs_leave_the_files_of_whole_ones(tmp_path, capsys):
    few = ["--kinds", "plate", "--kills", "2", "--pairs", "1"]
    assert killed.main(["--out", str(tmp_path), *few]) == 0
    said = capsys.readouterr().out
    assert said.count("the same to the bit") == 1
    assert "every file right" in said


@pytest.mark.slow
def test_an_amplitude_that_differs_from_long_time_integration_is_reported(capsys):
    assert pairs.main(["--count", "1"], allowed=0.0) == 1
    assert "WRONG" in capsys.readouterr().out
