"""Scenes with ``time.quasi_static``: models, estimated errors, files, commands and refusals."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joint_scenes import bar_scene, harmonic, joint, plate_scene, scene_file, two_plates
from scene_texts import csv_rows

import skfem_joint as sj
from skfem_joint import cli
from skfem_joint.accuracy.estimate import QUANTITIES
from skfem_joint.output import plots, report
from skfem_joint.output.folder import curves
from skfem_joint.scene.shipped import write_shipped
from skfem_joint.study.summary import model_summary

SLOW = {"cycles": 2, "steps_per_cycle": 40, "quasi_static": True}


def arrays_of(path):
    with np.load(path) as file:
        return dict(file)


def slow_bar(*run, **changes):
    values = {"load": [harmonic(amplitude=50e3, frequency=1.0)], "reduction": {}, "time": SLOW}
    return bar_scene(*(run or ("full",)), bar="coarse", **values | changes)


@pytest.fixture(scope="module")
def plates():
    return sj.run_scene(two_plates("full", "condensed", "reduced", time=SLOW))


def test_models_agree_within_their_stated_errors(plates):
    assert plates.failure is None
    full = plates.models["full"]
    for name in ("condensed", "reduced"):
        model = plates.models[name]
        assert model.estimate is not None
        for quantity in QUANTITIES:
            assert model.estimate.of("full_run", quantity) <= model.estimate.of("total", quantity)
        stiffness = model.run.loops.secant_stiffness
        assert stiffness == pytest.approx(full.run.loops.secant_stiffness, rel=0.02)
    assert plates.models["condensed"].estimate.of("basis", QUANTITIES[0]) == 0.0
    assert "coulomb" not in full.estimate.parts
    assert not [note for note in plates.notes if "differs from the full" in note]


def test_summary_and_history_have_the_loops(plates, tmp_path):
    report.write_history(tmp_path / "history.npz", plates.runs)
    stored = arrays_of(tmp_path / "history.npz")
    run, content = plates.runs["full"], model_summary(plates, plates.models["full"])
    force, slip = (stored[f"full_upper_joint_{name}"] for name in ("force", "mean_slip"))
    assert np.array_equal(force, run.loops.force[:, 0])
    assert np.ptp(slip) > 0.0
    assert content["joints"]["upper_joint"]["secant_stiffness_N_per_m"] == pytest.approx(
        np.ptp(force[40:]) / np.ptp(slip[40:])
    )
    works = content["loads"]["upper_right"]["loop_energy_J"], content["loop_energy_per_cycle_J"]
    assert works[0] == pytest.approx(works[1])
    assert content["friction_energy_per_cycle_J"] == pytest.approx(works[0], rel=1e-3)
    assert content["viscous_work_J"] == content["scheme_work_J"] == 0.0
    shown = report.results_text(plates)
    assert "secant stiffness of upper_joint, N/m" in shown
    assert "secant stiffness at upper_right, N/m" in shown
    heading, *rows = report.loop_rows(plates.runs)
    assert heading[:3] == ["time_s", "full_upper_right_force_N", "full_upper_right_displacement_m"]
    assert len(rows) == 81
    assert [row[heading.index("full_upper_joint_force_N")] for row in rows] == list(force)


def test_notes_say_what_is_left_out_and_that_points_slip_apart(plates):
    notes = "\n".join(plates.notes)
    assert "The damping of the scene is left out" in notes
    assert "slip by different amounts" in notes
    assert "time.until" not in notes
    plain = slow_bar(joint=[joint(law="coulomb")], damping={})
    assert plain.left_out == ()


def test_a_cycle_from_rest_is_said_not_to_be_closed():
    one = sj.run_scene(slow_bar(time=SLOW | {"cycles": 1}, accuracy={"estimate": False}))
    assert any("is not closed" in note for note in one.notes)
    two = sj.run_scene(slow_bar(accuracy={"estimate": False}))
    assert not any("is not closed" in note for note in two.notes)
    assert model_summary(two, two.models["full"])["steady_state_reached"] is True


def test_the_summary_of_a_joint_has_its_stiffness():
    given = joint(law="coulomb", pressure=20e6, tangential_stiffness=1e13)
    study = sj.run_scene(slow_bar(joint=[given], damping={}, accuracy={"estimate": False}))
    content = model_summary(study, study.models["full"])["joints"]["joint"]
    total = float(study.system.contact.spring_constants.sum())
    assert content["tangential_stiffness_N_per_m"] == pytest.approx(total)
    assert content["friction_energy_J"] == pytest.approx(study.runs["full"].friction_work.sum())


def test_facts_leave_inertia_out():
    slow, fast = slow_bar(), slow_bar(time={"cycles": 2, "steps_per_cycle": 40})
    for scene, amplified in ((slow, False), (fast, True)):
        study = sj.run_scene(scene.changed(accuracy={"estimate": False}))
        facts = "\n".join(study.description.facts)
        assert ("amplified" in facts) is amplified
        assert ("wave travels" in facts) is amplified
        assert (study.description.values["amplification"] is not None) is amplified


def test_errors_meet_the_accuracy_asked_for():
    study = sj.run_scene(slow_bar("full", accuracy={"energy": 5e-3}))
    model = study.models["full"]
    assert model.estimate.on_its_mesh["friction_energy"] <= 5e-3
    fine = sj.run_scene(
        slow_bar(time=SLOW | {"steps_per_cycle": 1280}, accuracy={"estimate": False})
    )
    true = fine.runs["full"].cycles.friction[-1]
    assert model.run.cycles.friction[-1] == pytest.approx(true, rel=5e-3)


def test_own_modes_serve_too():
    scene = slow_bar("full", "reduced", reduction={"reference": "self", "modes": 2})
    study = sj.run_scene(scene)
    assert study.failure is None
    errors = study.models["reduced"].estimate
    assert errors.of("full_run", "friction_energy") <= errors.of("total", "friction_energy")


def test_pictures_of_loops_are_written(plates, tmp_path):
    shown = replace(plates, scene=plates.scene.changed(output={"plots": True}))
    plan = curves(shown)
    names = {"history.npz", "joint_loops.csv", "joint_loops.png", "hysteresis_upper_right.png"}
    assert names <= set(plan)
    for name in sorted(names):
        plan[name](tmp_path / name)
        assert (tmp_path / name).stat().st_size > 1000
    # A path that closes no cycle is drawn from rest on.
    time = {"duration": 0.7, "step": 0.02, "quasi_static": True}
    once = sj.run_scene(slow_bar(time=time, accuracy={"estimate": False}))
    scene = once.scene.changed(output={"plots": True})
    assert {"hysteresis_free_end.png", "joint_loops.png"} <= set(curves(replace(once, scene=scene)))
    figure = plots.hysteresis_figure(once.runs, "free_end", 0, None)
    assert figure.axes[0].get_title(loc="left") == "from rest on"


def sliding(folder: Path) -> Path:
    """File of a bar that friction alone holds, with 50 kN, pulled with up to 60 kN."""
    pull = {"on": "free_end", "kind": "triangle", "peak": 60e3, "rise_time": 1.0}
    held = joint(pressure=20e6, friction=0.5, law="coulomb", normal_force="consistent")
    time = {"duration": 2.0, "step": 0.05, "quasi_static": True}
    tables: dict[str, Any] = {"support": {}, "damping": {}, "reduction": {}}
    return scene_file(folder, bar_scene("full", joint=[held], load=[pull], time=time, **tables))


def test_command_beyond_slip_ends_with_status_3_and_writes_its_levels(tmp_path, capsys):
    path = sliding(tmp_path)
    out = tmp_path / "out"
    assert cli.main(["run", str(path), "--out", str(out), "-q"]) == 3
    assert "the structure slides" in capsys.readouterr().err
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["models"]["full"]["interrupted"] is True
    # Friction holds 50 kN, which the load exceeds at 0.833 s.
    history = arrays_of(out / "history.npz")
    assert history["time"][-1] == pytest.approx(0.8)
    assert history["load_0_free_end"][-1] == pytest.approx(48e3)
    assert history["full_joint_force"][-1] == pytest.approx(48e3, rel=1e-6)
    rows = csv_rows(out / "joint_loops.csv")
    assert len(rows) == 17
    assert float(rows[-1]["full_joint_force_N"]) == pytest.approx(48e3, rel=1e-6)


VIBRATION = ("time.quasi_static: found true", "computes vibration")


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("response", VIBRATION),
        ("backbone", VIBRATION),
        ("error-time", VIBRATION),
        ("run --checkpoint-every 5", ("has no checkpoints",)),
        ("run --resume", ("has no checkpoints",)),
    ],
)
def test_what_a_slow_path_has_not_is_refused(command, words, tmp_path, capsys):
    path = sliding(tmp_path)
    assert cli.main([*command.split(), str(path), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert all(word in error for word in words)


def test_a_scene_changes_to_quasi_static_and_back():
    fast = plate_scene("full", time={"cycles": 1, "steps_per_cycle": 40})
    assert np.isfinite(fast.system().contact.beta).all()
    slow = fast.changed(time={"quasi_static": True})
    assert np.isinf(slow.system().contact.beta).all()
    assert not slow.system().C.nnz or not np.any(slow.system().C.data)
    again = slow.changed(time={"quasi_static": False})
    assert np.isfinite(again.system().contact.beta).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plate_bolts", "two_plates", "solid_lap_joint"])
def test_shipped_meshes_balance_their_works(name, tmp_path):
    """In two and three dimensions, bodies held by friction alone among them."""
    path = write_shipped(name, tmp_path)[0]
    time = {"cycles": 2, "steps_per_cycle": 16, "quasi_static": True}
    scene = sj.load_scene(path).changed(
        time=time, models={"run": ("full",)}, accuracy={"estimate": False},
        output={"plots": False, "vtk": False},
    )  # fmt: skip
    study = sj.run_scene(scene)
    run = study.finished().runs["full"]
    assert run.energy_residual < 1e-8
    gap, work = run.loops.opening, run.cycles.input[-1].sum()
    assert work == pytest.approx(run.cycles.by_joint[-1].sum(), rel=2.0 * gap + 1e-8)
    peak = np.abs(run.amplitudes[:, 0]).max()
    assert np.abs(run.loops.force).max() <= peak * (1.0 + 1e-6)
