"""What a study leaves in its folder: figures of its runs, its own files only, whatever happened."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from joint_scenes import bar_scene, harmonic, joint, plate_scene

import skfem_joint as sj
from skfem_joint.ground.files import safe_name
from skfem_joint.output import folder, prepare, report, tables, write
from skfem_joint.output.damping import write_backbone
from skfem_joint.output.fields import frames_of
from skfem_joint.output.record import LIST
from skfem_joint.results.history import slip_state
from skfem_joint.study.scene_backbone import scene_backbone

JOINTS = ("joint", "second")
#: Points may have any name; files have safe ones.
TIP = "freie Länge / 2"
LOOP = f"hysteresis_{safe_name(TIP)}.png"
TIME = {"cycles": 3, "steps_per_cycle": 40}


def scene(*names: str, **tables: Any) -> sj.Scene:
    """Bar with joints, pulled by half of what one of them carries."""
    strips = [("joint", 0.1, 10), ("arm", 0.1, 4), ("second", 0.1, 10)]
    bar = sj.build_bar(strips, {"fixed": 0.0, TIP: 0.3})
    joints = [joint(name, pressure=8e6) for name in names or ("joint",)]
    base = {"title": "a bar", "joint": joints, "time": TIME, "reduction": {}}
    return bar_scene("full", bar=bar, **(base | {"load": [harmonic(TIP, 14e3, 1000.0)]} | tables))


@pytest.fixture(scope="module")
def study():
    """Full and reduced model of a bar with two joints."""
    made = scene(*JOINTS, output={"vtk": True, "frames": 60})
    made = made.changed(models={"run": ("full", "reduced")}, reduction={"modes": 8})
    return sj.run_scene(made)


KEYS = {
    "dofs", "contact_points", "modes", "steps", "newton_iterations", "wall_s", "offline_s",
    "compilation_s",
    "peak_displacement_m", "friction_energy_per_cycle_J", "loop_energy_per_cycle_J",
    "friction_energy_J", "active_length_m", "active_area_fraction", "energy_balance_residual",
}  # fmt: skip
QUANTITIES = {
    "displacement_rms", "peak_displacement", "friction_energy_per_cycle", "loop_energy_per_cycle"
}  # fmt: skip


def test_summary_has_the_keys_that_others_rely_on(study):
    models = report.summary(study)["models"]
    assert set(models["full"]) >= KEYS
    assert "error" not in models["full"]
    assert set(models["reduced"]["error"]) >= QUANTITIES | {"displacement_max"}
    sources = {"basis", "law", "points", "time_step", "total", "coulomb"}
    for errors in models["full"]["estimated_error"].values():
        assert set(errors) >= sources
        known = {source for source, error in errors.items() if error is not None}
        assert known == {"time_step", "mesh", "total", "coulomb"}
    assert set(models["full"]["estimated_error"]) == QUANTITIES


def test_summary_holds_the_figures_of_the_runs(study):
    assert report.summary(study)["warnings"] == list(study.notes)
    for name, summary in report.summary(study)["models"].items():
        run = study.models[name].run
        assert (summary["dofs"], summary["steps"]) == (run.system.n, 120)
        assert summary["modes"] == study.models[name].modes
        assert summary["peak_displacement_m"] == {TIP: run.cycles.peak[-1, 0]}
        assert summary["friction_energy_per_cycle_J"] == run.cycles.friction[-1]
        assert summary["loop_energy_per_cycle_J"] == run.cycles.input[-1, 0]
        assert summary["energy_balance_residual"] == run.energy_residual
        assert set(summary["friction_energy_J"]) == {"joint", "second"}
        friction = sum(summary["friction_energy_J"].values())
        assert friction == pytest.approx(run.friction_work.sum(), rel=1e-12)
        works = friction + summary["viscous_work_J"] + summary["scheme_work_J"]
        stored = run.stored_energy[1] - run.stored_energy[0]
        assert summary["input_work_J"] == pytest.approx(works + stored, rel=1e-10)


def test_each_joint_and_each_bolt_has_its_part():
    """The bolt near the load slips, the far one sticks; what both lose is what the joint loses."""
    at = [0.02, 0.08]
    bolts = [{"at": [x, 0.0], "force": 20e3, "head_radius": 0.01} for x in at]
    joints = [joint(pressure={"bolts": bolts}), joint("second", pressure=8e6, friction=0.1)]
    content = report.summary(sj.run_scene(scene(joint=joints)))
    found = content["models"]["full"]["joints"]
    far, near = found["joint"]["friction_energy_by_bolt_J"]
    assert 0.0 <= far < 1e-9 * near
    assert far + near == pytest.approx(found["joint"]["friction_energy_J"], rel=1e-12)
    assert 0.0 < found["joint"]["slipping_fraction"] < 0.5 < found["second"]["slipping_fraction"]
    assert 0.0 < found["joint"]["largest_slip_m"] < found["second"]["largest_slip_m"]
    table = str(report.summary_table(content))
    for words in ("of joint at bolt 2 over the run, J", "largest slip of second over the run, mm"):
        assert words in table


def test_an_estimated_error_stands_by_quantity_and_source(study):
    content = report.summary(study)
    for name, model in study.models.items():
        errors = content["models"][name]["estimated_error"]
        for source, parts in model.estimate.parts.items():
            assert errors["displacement_rms"][source] == parts["displacement_rms"]
            assert errors["friction_energy_per_cycle"][source] == parts["friction_energy"]
    shown = str(report.estimate_table(content)).splitlines()[2:]
    rows = {line[:33].strip(): line[33:].split() for line in shown}
    total = content["models"]["full"]["estimated_error"]["displacement_rms"]["total"]
    assert rows["full model, total"][0] == f"{100 * total:.2g}"
    assert "full model, mesh" in rows
    assert not content["models"]["full"]["estimated_total_without_mesh"]
    assert ("reduced model, basis" in rows, "full model, basis" in rows) == (True, False)
    alone = report.summary(sj.run_scene(scene(accuracy={"estimate": False})))
    assert "not estimated" in str(report.estimate_table(alone))


def test_energies_per_cycle_are_null_without_cycles():
    short = scene(time={"duration": 1e-4, "step": 1e-5})
    content = report.summary(sj.run_scene(short))
    summary = content["models"]["full"]
    for key in ("friction_energy_per_cycle_J", "loop_energy_per_cycle_J", "steady_state_reached"):
        assert summary[key] is None
    assert "friction_energy" in summary["estimated_error"]
    assert "friction energy, J" in str(report.summary_table(content))


def test_not_a_number_is_never_written(tmp_path):
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not JSON compliant"):
            tables.write_json(tmp_path / "summary.json", {"a": value})
    assert not list(tmp_path.iterdir())


def test_history_is_read_back_without_pickles(study, tmp_path):
    runs = {name: model.run for name, model in study.models.items()}
    # A model that was interrupted is shorter.
    steps = {"step": study.scene.time_step, "n_steps": 30}
    runs["short"] = sj.integrate(study.system, **steps, save=sj.Save(slips=True))
    report.write_history(tmp_path / "history.npz", runs)
    with np.load(tmp_path / "history.npz", allow_pickle=False) as file:
        parts = [f"{model}_{TIP}_{what}" for model in runs for what in ("displacement", "velocity")]
        kept = ("friction_energy", "slip", "slipping")
        parts += [f"{model}_{joint}_{what}" for model in runs for joint in JOINTS for what in kept]
        assert set(file) == {"time", f"load_0_{TIP}", *parts}
        energies = [file[f"reduced_{joint}_friction_energy"][-1] for joint in JOINTS]
        assert sum(energies) == pytest.approx(runs["reduced"].friction_work.sum(), rel=1e-12)
        assert np.array_equal(file["time"], runs["full"].times)
        assert np.array_equal(file[f"load_0_{TIP}"], runs["full"].amplitudes[:, 0])
        assert np.array_equal(file[f"reduced_{TIP}_velocity"], runs["reduced"].point_v[:, 0])
        assert file[f"short_{TIP}_displacement"].size == 31


def test_the_table_shows_what_the_summary_holds(study):
    content = report.summary(study)

    def rows():
        lines = str(report.summary_table(content)).splitlines()
        assert len(set(map(len, lines))) == 1  # columns stand below each other
        return {" ".join(line.split()[:-2]): line.split()[-2:] for line in lines[2:]}

    full, reduced = (content["models"][name] for name in ("full", "reduced"))
    peak, energy = full["peak_displacement_m"][TIP], full["friction_energy_J"]["second"]
    assert rows()[f"peak displacement at {TIP}, mm"][0] == f"{1e3 * peak:.5g}"
    assert rows()["friction energy of second over the run, J"][0] == f"{energy:.4g}"
    error = reduced["error"]["friction_energy_per_cycle"]
    assert rows()["error of friction energy, %"] == ["-", f"{100 * error:+.3g}"]
    # How much faster the reduced model is stands only beside what it took to make it, if it pays.
    both = reduced["wall_s"] + reduced["offline_s"]
    for paid, wall in ((False, 0.9 * both), (True, 3.0 * both)):
        full["wall_s"] = wall
        assert ("run time of the full model over this one's" in rows()) == paid
    assert rows()["the same with its off-line time"] == ["-", f"{full['wall_s'] / both:.3g}"]
    # Names are shown as they are, however long.
    full["peak_displacement_m"] = {"[red]" + "long name " * 20: 1.0}
    text = str(report.summary_table(content))
    assert "[red]long" in text
    assert "…" not in text


@pytest.mark.parametrize("dim", [1, 2])
def test_fields_add_up_to_the_friction_of_the_joints(study, dim):
    """Traction times area is the friction force, and the work's density the energy by joint."""
    if dim == 2:
        plate = sj.build_plate([("joint", 0.1, 6), ("arm", 0.1, 4)], 0.05, 3)
        load = [harmonic("left", 14e3, 1000.0) | {"direction": (1.0, 0.2)}]
        more = {"support": {"fixed": ["right"]}, "load": load, "output": {"vtk": True}}
        study = sj.run_scene(plate_scene("full", mesh=plate, time=TIME | {"cycles": 1}, **more))
    frames, structure = frames_of(study.structure, study.runs), study.structure
    content = report.summary(study)
    for field in frames.fields:
        energy = content["models"][field.name]["friction_energy_J"]
        for patch in structure.patches:
            moved = field.displacement[:, patch.nodes]  # on a rigid base
            np.testing.assert_allclose(field.slip[:, patch.nodes], moved, atol=1e-18)
            work = field.friction_work_density[-1, patch.nodes] @ patch.area
            assert work == pytest.approx(energy[patch.joint.name], rel=1e-9)
    run, full = study.models["full"].run, frames.fields[0]
    area = np.zeros(structure.n_nodes)
    for patch in structure.patches:
        area[patch.nodes] += patch.area
    contact = study.system.contact
    force = -(contact.B.T @ (contact.on_rows(contact.w) * run.sigma).T).T
    flat = (full.friction_traction * area[:, np.newaxis]).reshape(len(force), -1)
    np.testing.assert_allclose(flat @ study.system.T, force, atol=1e-9 * np.abs(force).max())
    slips = slip_state(contact.slip_norm((contact.B @ run.v.T).T), contact.beta)
    for patch in structure.patches:
        np.testing.assert_array_equal(full.slip_state[:, patch.nodes], slips[:, patch.points])
    assert set(np.unique(full.slip_state)) == {-1, 0, 1}
    np.testing.assert_allclose(frames.times, run.field_times)
    np.testing.assert_allclose(structure.expand(run.u), full.displacement)


def names(path: Path) -> set[str]:
    files = {file.relative_to(path).as_posix() for file in path.rglob("*") if file.is_file()}
    return files - {LIST}


def test_the_next_run_replaces_what_this_one_wrote_and_nothing_else(study, tmp_path):
    (tmp_path / "notes.txt").write_text("of the user")
    with prepare(study.scene, tmp_path, overwrite=True) as notes:
        assert "notes.txt" in " ".join(notes)
        written = write(study, tmp_path)
    files = {"summary.json", "history.npz", "fields.pvd", "fields_load.csv"}
    assert {file.name for file in written} == files
    listed = json.loads((tmp_path / "summary.json").read_text())["files"]
    assert {*listed, "summary.json", "notes.txt"} == names(tmp_path)
    assert len(pyvista.PVDReader(tmp_path / "fields.pvd").time_values) == 61
    with pytest.raises(RuntimeError), prepare(study.scene, tmp_path):
        raise RuntimeError  # a run that fails leaves no old summary
    assert names(tmp_path) == {"notes.txt"}


def test_an_interrupted_study_is_written_as_far_as_it_came(study, tmp_path):
    save = sj.Save(fields=True, fields_every=2)
    part = sj.integrate(study.system, step=study.scene.time_step, n_steps=40, save=save)
    full = study.models["full"]
    models = {"full": full, "part": replace(full, name="part", run=replace(part, interrupted=True))}
    write(replace(study, models=models), tmp_path)
    assert len(pyvista.PVDReader(tmp_path / "fields.pvd").time_values) == 21


def test_a_scene_with_plots_draws_what_there_is(tmp_path):
    periodic = scene("joint", "second", output={"plots": True, "history": False, "frames": 3})
    with prepare(periodic, tmp_path / "a"):
        files = write(sj.run_scene(periodic), tmp_path / "a")
    assert [file.name for file in files] == [
        "summary.json", "histories.png", "energies.png", LOOP,
        "active_region_joint.png", "friction_work_joint.png",
        "active_region_second.png", "friction_work_second.png", "joint.png", "joint.gif",
    ]  # fmt: skip
    # Where nothing is done, there is nothing to draw of it; no loop and no cycles where the load
    # is not periodic.
    output = {"plots": True, "history": False, "frames": 3}
    rest = scene(output=output, load=[harmonic(TIP, 0.0, 1e3)])
    load = {"on": TIP, "kind": "half_sine", "peak": 14e3, "rise_time": 1e-4}
    pulse = scene(output=output, time={"duration": 2e-4, "step": 1e-5}, load=[load])
    always = {"histories.png", "joint.gif", "joint.png", "summary.json"}
    slips = {"active_region_joint.png", "friction_work_joint.png"}
    for name, made, more in (("b", rest, set()), ("c", pulse, slips)):
        (tmp_path / name).mkdir()
        write(sj.run_scene(made), tmp_path / name)
        assert names(tmp_path / name) == always | more


def test_joints_whose_names_make_the_same_file_have_a_picture_and_a_column_each(tmp_path):
    bar = sj.build_bar(
        [("a b", 0.1, 10), ("arm", 0.1, 4), ("a_b", 0.1, 10)], {"fixed": 0.0, TIP: 0.3}
    )
    tables = {
        "joint": [joint(name, pressure=8e6) for name in ("a b", "a_b")],
        "load": [harmonic(TIP, 35e3, 1000.0)],
        "time": TIME,
        "output": {"plots": True, "history": False},
        "backbone": {"levels": 2},
    }
    made = bar_scene("full", bar=bar, **tables)
    drawn = folder.curves(sj.run_scene(made))
    assert {"active_region_a_b.png", "active_region_a_b_2.png"} <= drawn.keys()
    write_backbone(tmp_path, scene_backbone(made))
    columns = (tmp_path / "backbone.csv").read_text().splitlines()[0].split(",")
    assert columns[-2:] == ["active_length_a_b_m", "active_length_a_b_2_m"]


def test_a_series_written_by_hand_is_that_of_the_scene(study, tmp_path):
    write(study, tmp_path)
    by_hand = sj.write_vtk(tmp_path / "hand" / "fields.pvd", study.structure, study.runs)
    assert {file.name for file in by_hand} == {
        "fields.pvd", "fields_load.csv", *(file.name for file in (tmp_path / "fields").iterdir())
    }  # fmt: skip
    for file in by_hand:
        scenes = tmp_path / file.relative_to(tmp_path / "hand")
        assert scenes.read_bytes() == file.read_bytes()


def test_runs_that_have_no_fields_or_other_contact_are_refused_not_shown_without(study, tmp_path):
    path, structure, run = tmp_path / "a.pvd", study.structure, study.models["full"].run
    bare = sj.integrate(study.system, step=1e-5, n_steps=3)
    free = replace(structure, joints=structure.joints[:1])
    later = replace(run, field_times=run.field_times + 1e-5)
    for made, runs, words in (
        (structure, {"full": bare}, r"stored no fields: integrate with Save\(fields=True\)"),
        (free, {"full": run}, "joints joint, second with .* the structure joint"),
        (structure, {"full": run, "later": later}, "the same times"),
        (structure, {}, "at least one"),
        (structure, run, "runs by name"),
    ):
        with pytest.raises(sj.InputError, match=words):
            sj.write_vtk(path, made, runs)
    assert not list(tmp_path.iterdir())


def test_friction_of_projected_models_is_the_forces_of_their_points(study):
    """Every contact point kept, or merged ones: they pull as hard as all points that they are."""
    system = study.system.with_beta(1e4)
    how = {"step": study.scene.time_step, "n_steps": 60, "save": sj.Save(fields=True)}
    V = sj.proper_modes(sj.integrate(system, **how)).modes[:, :8]
    for small in (system.project(V), sj.reduce(system, 6, duration=1e-3, beta=1e4)):
        run = sj.integrate(small, **how)
        (field,) = frames_of(study.structure, {"small": run}).fields
        total = small.contact.J @ (small.contact.w * np.abs(run.sigma)).T
        for patch, force in zip(study.structure.patches, total, strict=True):
            traction = np.abs(field.friction_traction[:, patch.nodes, 0]) @ patch.area
            assert np.abs(traction - force).max() < 0.1 * force.max()
            assert force.max() > 0.0
