"""Scenes with contact = "unilateral": models, estimates, files, commands and refusals."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.scenes import draw
from joint_scenes import plate_scene, scene_file

import skfem_joint as sj
from skfem_joint import cli
from skfem_joint.accuracy.estimate import QUANTITIES
from skfem_joint.output import report
from skfem_joint.output.fields import frames_of
from skfem_joint.scene import Scene, scene_from
from skfem_joint.steady import marching
from skfem_joint.study import error_time
from skfem_joint.study.against_opening import against_opening
from skfem_joint.study.certificate import certify
from skfem_joint.study.description import description_of
from skfem_joint.study.scene_backbone import scene_backbone
from skfem_joint.study.scene_response import CREPT, scene_response
from skfem_joint.study.summary import model_summary
from skfem_joint.vibration import response

SIZE = 0.04
SIDES = {"base": "bottom", "top": "top", "left": "left", "right": "right"}
BASE: dict[str, Any] = {"on": "base", "friction": 0.5, "pressure": 50e6, "contact": "unilateral"}
UP = {"on": "top", "direction": [0.0, 1.0], "kind": "harmonic", "frequency": 2000.0}
ACROSS = UP | {"on": "left", "direction": [1.0, 0.0], "amplitude": 200e3}
MODELS = ("full", "condensed", "reduced")
UNESTIMATED = {"accuracy": {"estimate": False}}
SLOW = {"cycles": 2, "steps_per_cycle": 20, "quasi_static": True}


def block(*run: str, up: float = 185e3, contact: dict[str, Any] = BASE, **changes: Any) -> Scene:
    """Block of 40 mm on a base, pressed by 200 kN and lifted by up to ``up``, N."""
    values: dict[str, Any] = {
        "material": {"E": 200e9, "density": 8e3, "poisson": 0.3, "mass_matrix": "lumped"},
        "section": {"thickness": 0.1},
        "support": {"fixed_x": ["right"]},
        "joint": [contact],
        "damping": {"stiffness": 2e-7},
        "load": [UP | {"amplitude": up}, ACROSS],
        "time": {"cycles": 2, "steps_per_cycle": 100},
        "output": {"vtk": True, "frames": 20},
    }
    mesh = sj.build_plate([("block", SIZE, 3)], SIZE, 3, boundaries=SIDES)
    return plate_scene(*(run or ("full",)), mesh=mesh, **values | changes)


@pytest.fixture(scope="module")
def study():
    return sj.run_scene(block("full", "condensed"))


def test_models_agree_within_their_stated_errors(study):
    assert study.failure is None
    condensed = study.models["condensed"].estimate
    for quantity in QUANTITIES:
        assert condensed.of("full_run", quantity) <= condensed.of("total", quantity)
        basis, whole = condensed.of("basis", quantity), condensed.of("total", quantity)
        assert 0.0 < basis < whole


def test_stated_errors_of_the_step_are_those_against_a_fine_step(study):
    fine = sj.run_scene(
        block(time={"cycles": 2, "steps_per_cycle": 1600}, accuracy={"estimate": False})
    )
    stated, run = study.models["full"].estimate, study.runs["full"]
    true = abs(run.cycles.friction[-1] / fine.runs["full"].cycles.friction[-1] - 1.0)
    assert 0.5 < stated.on_its_mesh["friction_energy"] / true < 3.0


def test_summary_has_impacts_normal_forces_and_openings(study):
    run, content = study.runs["full"], model_summary(study, study.models["full"])
    assert content["impact_energy_J"] == run.impact_work >= 0.0
    largest = content["largest_normal_force_N"]
    assert largest == run.normal_force_peak.max() > 1.9 * run.normal_force[0].max()
    assert content["opened_fraction"] == 0.5
    assert content["energy_balance_residual"] < 1e-12
    shown = report.results_text(study)
    for row in ("energy lost by impacts", "largest normal force", "contact opened"):
        assert row in shown
    constant = sj.run_scene(block(contact=BASE | {"contact": "constant"}, up=1e3))
    assert "impact_energy_J" not in model_summary(constant, constant.models["full"])
    assert "impacts" not in report.results_text(constant)
    frames = frames_of(constant.structure, constant.runs)
    assert not {"gap", "contact_pressure"} & frames.arrays(frames.fields[0], 0).keys()


def test_models_take_the_steps_and_modes_for_an_accuracy():
    """Against the full model with an eighth of the step that it needed itself."""
    asked = {"displacement": 0.05, "energy": 0.15}
    rough = {"cycles": 2, "steps_per_cycle": 30}
    found = {name: sj.run_scene(block(name, accuracy=asked, time=rough)) for name in MODELS[::2]}
    steps = {name: each.scene.time_step for name, each in found.items()}
    finer = {"cycles": 2, "steps_per_cycle": round(8.0 / UP["frequency"] / steps["full"])}
    (whole,) = sj.run_scene(block(time=finer, **UNESTIMATED)).runs.values()
    for name, each in found.items():
        run = each.runs[name]
        assert run.peak_of("top") == pytest.approx(whole.peak_of("top"), rel=asked["displacement"])
        friction = whole.cycles.friction[-1]
        assert run.cycles.friction[-1] == pytest.approx(friction, rel=asked["energy"])
        assert f"For the accuracy asked for the {name} model has" in "\n".join(each.notes)
    assert max(steps.values()) < block(time=rough).time_step


def test_an_accuracy_that_modes_do_not_reach_is_refused():
    with pytest.raises(
        sj.ConvergenceError, match="what its modes miss is more than what is asked for"
    ):
        sj.run_scene(block("condensed", accuracy={"displacement": 1e-4}))


def test_fields_have_the_present_pressure_and_gap(study):
    for name, run in study.runs.items():
        frames = frames_of(study.structure, {name: run})
        field, nodes = frames.fields[0], study.structure.patches[0].opening.nodes
        pressure, gap = field.contact_pressure[:, nodes], field.gap[:, nodes]
        assert np.any(gap > 0.0)
        assert not np.any((gap > 0.0) & (pressure > 0.0))  # p g = 0 at nodes that are corners
        weight = study.structure.patches[0].opening.area
        assert pressure @ weight == pytest.approx(run.normal_force.sum(axis=1))
        moved = study.structure.unpacked(run.system.expand(run.u))[:, nodes, 1]
        assert gap == pytest.approx(np.where(run.normal_force > 0.0, 0.0, moved), abs=1e-15)
        free = np.isin(nodes, study.structure.patches[0].nodes)  # a support holds the last one
        apart = field.slip_state[:, nodes] == -1
        assert np.array_equal(apart[:, free], (run.normal_force == 0.0)[:, free])
        traction = np.linalg.norm(field.friction_traction[:, nodes], axis=2)
        assert np.all(traction[gap > 0.0] == 0.0)
        arrays = frames.arrays(field, 3)
        assert arrays["contact_pressure"][nodes] == pytest.approx(pressure[3])
        assert arrays["gap"].shape == arrays["pressure"].shape


IN_RANGE = {"slip": [0.1, 0.8], "frequency": [1000.0, 2500.0], "joint[0].friction": [0.4, 0.6]}


def in_range(amplitude: float, friction: float) -> Scene:
    """Block pulled to the side, as a point of one model for a range."""
    return block(
        "reduced",
        contact=BASE | {"friction": friction},
        load=[ACROSS | {"amplitude": amplitude}],
        reduction={"range": IN_RANGE, "modes": 8},
        output={"vtk": False},
    )


def test_scenes_of_a_range_share_a_model_that_opens_and_states_its_errors(tmp_path):
    for amplitude, friction in ((80e3, 0.45), (90e3, 0.55)):
        scene = in_range(amplitude, friction)
        study = sj.run_scene(scene, folder=tmp_path)
        run = study.models["reduced"].run
        assert not [text for text in study.notes if "does not serve" in text]
        assert run.system.serves.point.limits == pytest.approx({"base": friction / 0.24**0.5})
        full = sj.integrate(scene.system(), cycles=2, steps_per_cycle=100)
        errors, stated = sj.compare(full, run), study.models["reduced"].estimate.parts["total"]
        assert errors.displacement_rms < min(0.02, stated["displacement_rms"])
        assert abs(errors.friction_energy_per_cycle or 0.0) <= stated["friction_energy"]
    assert len(list(tmp_path.glob("range_*.npz"))) == 1


def test_pressure_of_contact_that_opens_is_no_key_of_a_range():
    with pytest.raises(sj.InputError, match="open at other loads as they are pressed otherwise"):
        block(reduction={"range": IN_RANGE | {"joint[0].pressure": [40e6, 60e6]}})


def written(folder: Path, *run: str, up: float = 185e3, **changes: Any) -> Path:
    """File of the block of plain elements, which opens at these levels, lifted alone."""
    time = {"cycles": 1, "steps_per_cycle": 50}
    values: dict[str, Any] = {"damping": {}, "output": {}, "time": time} | UNESTIMATED
    scene = block(*run, load=[UP | {"amplitude": up}], **values | changes)
    path = scene_file(folder, scene)
    path.write_text(path.read_text().replace("[mesh]", "[mesh]\nincompatible = false"))
    return path


def test_a_backbone_and_a_ring_down_are_written(tmp_path, capsys):
    table, folder = {"levels": 3, "up_to": 0.05, "ring_down": 12}, tmp_path / "o"
    path = written(tmp_path, *MODELS, backbone=table)
    assert cli.main(["backbone", str(path), "--out", str(folder)]) == 0
    shown = capsys.readouterr().out
    assert "% of what is pressed at rest opens; the cycles err by an estimated" in shown
    assert "set contact = 'unilateral'" not in shown
    header, *rows = (folder / "backbone.csv").read_text().splitlines()
    assert {"modal_offset", "opened_share"} <= set(header.split(","))
    assert len(rows) == 9
    (mode,) = json.loads((folder / "summary.json").read_text())["models"]["full"]["modes"]
    assert mode["opened_share"] > 0.0
    assert set(mode["estimated_error"]) == {"frequency", "damping_ratio"}
    header, *rows = (folder / "ring_down.csv").read_text().splitlines()
    frequency = header.split(",").index("frequency_Hz")
    found = [[float(row.split(",")[frequency]) for row in rows if row.startswith(name)]
             for name in MODELS]  # fmt: skip
    ends = [one[-1] for one in found]
    assert ends[:2] == pytest.approx([mode["stuck_frequency_Hz"]] * 2, rel=5e-3)
    # Contact of the reduced model is elastic; its impacts make 1 % of a window out of round-off.
    assert np.mean(found[2]) == pytest.approx(np.mean(found[0]), rel=0.05)


def test_a_response_is_written(tmp_path, capsys):
    """Its second point starts from the first, and has the amplitude of a scene of its own."""
    table = {"frequencies": {"from": 1900.0, "to": 2000.0, "points": 2}, "levels": [1.0]}
    given = {"up": 150e3, "damping": {"stiffness": 2e-7}, "response": table}
    time, folder = {"cycles": 1, "steps_per_cycle": 24}, tmp_path / "o"
    path = written(tmp_path, "condensed", time=time, **given)
    assert cli.main(["response", str(path), "--out", str(folder)]) == 0
    assert marching.MAY_DEPEND in capsys.readouterr().out
    header, *rows = (folder / "response.csv").read_text().splitlines()
    columns = header.split(",")
    assert len(rows) == 2
    path = written(tmp_path, "full", time={"until": "steady", "steps_per_cycle": 24}, **given)
    assert cli.main(["run", str(path), "--out", str(folder)]) == 0
    assert marching.MAY_DEPEND in capsys.readouterr().out
    model = json.loads((folder / "summary.json").read_text())["models"]["full"]
    assert model["steady_state_reached"] is True
    amplitude = float(rows[1].split(",")[columns.index("amplitude_top_m")])
    assert amplitude == pytest.approx(model["amplitude_m"]["top"], rel=1e-3)


def test_certified_by_a_finer_mesh():
    study = sj.run_scene(block(time={"cycles": 1, "steps_per_cycle": 40}))
    assert certify(study, "full").estimate.of("mesh", "displacement_rms") > 0.0


def test_check_says_how_far_constant_normal_forces_err():
    """As quasi-static runs of the full model with both kinds of contact do."""
    constant = block(contact=BASE | {"contact": "constant"}, up=150e3)
    change = description_of(constant).values["normal_force_change"]
    told = against_opening(constant, change)
    steps = {"cycles": 2, "steps_per_cycle": 24}
    a, b = (sj.quasi_static(scene.system(), **steps) for scene in (constant, block(up=150e3)))
    for less in (
        1.0 - a.cycles.friction[-1] / b.cycles.friction[-1],
        1.0 - a.slip_peak.max() / b.slip_peak.max(),
    ):
        assert f"{100 * abs(less):.2g} % {'less' if less > 0 else 'more'}" in told
    (doubt,) = [d for d in description_of(constant).doubts if "normal force" in d]
    assert "set contact = 'unilateral' in that [[joint]]" in doubt


def test_check_says_when_that_is_not_computed():
    constant = block(contact=BASE | {"contact": "constant"}, up=300e3)
    assert against_opening(constant, 0.05) is None
    assert against_opening(constant, None) is None
    assert "was not computed" in against_opening(constant, 0.5)  # it would be lifted off
    mesh = sj.build_plate([("block", SIZE, 200)], SIZE, 1, boundaries=SIDES)
    wide = scene_from(constant.model_dump(exclude_unset=True), mesh)
    told = against_opening(wide, 0.5)
    assert "was not computed: 401 contact unknowns in 802 are more than 400" in told
    assert "time.quasi_static = true" in told


def test_faces_that_will_hit_each_other_want_a_lumped_mass():
    apart = BASE | {"gap": 1e-5, "pressure": 0.0}
    steel = {"E": 200e9, "density": 8e3, "poisson": 0.3}
    for contact, mass, said in (
        (apart, "consistent", True),
        (apart, "lumped", False),
        (BASE, "consistent", False),
    ):
        scene = block(contact=contact, material=steel | {"mass_matrix": mass})
        notes = scene.system().notes
        assert any("mass_matrix = 'lumped'" in note for note in notes) is said


def test_a_response_of_a_reduced_model_is_that_of_the_condensed_one_within_its_stated_error():
    """At a level below that of its modes, too; its stated errors are those at the peak."""
    table = {"frequencies": {"from": 1900.0, "to": 2000.0, "points": 2}, "levels": [0.5, 1.0]}
    time = {"cycles": 1, "steps_per_cycle": 16}
    scene = block("reduced", up=120e3, time=time, response=table, reduction={"modes": 6})
    found = scene_response(scene)
    assert marching.MAY_DEPEND in found.notes
    (model,) = found.models
    assert CREPT in model.notes
    condensed = sj.condense(scene.system())
    for curve, stated in zip(model.curves, model.estimates, strict=True):
        frequency, amplitude = curve.peak
        # The first point begins at rest, which may take some hundred periods.
        assert max(point.periods for point in curve.points[1:]) < 60
        other = response.steady_point(condensed, frequency, curve.level, 16)
        true = abs(amplitude / other.amplitude.max() - 1.0)
        assert true < 2.0 * stated.of("basis", "displacement_rms") < 0.2
        assert stated.of("total", "friction_energy") > 0.0


@pytest.fixture(scope="module")
def curves(tmp_path_factory):
    """Damping curves of all models of two lapped plates from the side."""
    drawn = draw("laps-opening", 2029, 1, tmp_path_factory.mktemp("lap")).scene
    models, table = {"run": ["full", "condensed", "reduced"]}, {"levels": 4, "up_to": 0.6}
    lap = drawn.changed(models=models, backbone=table, reduction={"modes": "auto"})
    return scene_backbone(lap).models


def test_a_reduced_model_has_the_damping_curve_of_the_full_one(curves):
    """Elastic contact and 24 modes of its cycles cost 0.01 % in frequency, 1 % in damping."""
    full, _, reduced = (model.curves[0] for model in curves)
    assert full.opened[-1] > 0.1
    assert reduced.opened[-1] == pytest.approx(full.opened[-1], abs=0.1)
    errors = curves[2].errors[0]
    assert errors["frequency"] < 5e-4
    assert errors["damping_ratio"] < 0.03


def test_points_that_creep_under_the_steep_law_of_a_reduced_model_stick(curves):
    full, _, reduced = (model.curves[0] for model in curves)
    assert full.friction_damping[0] == 0.0
    assert reduced.friction_damping[0] < 1e-6 * reduced.friction_damping[-1]
    assert reduced.state[0] == full.state[0] == "stick"


@pytest.mark.slow
def test_error_against_time_is_measured():
    """Steps half as long err less, and a reduced model keeps all of its points."""
    scene = block("full", "reduced", time={"cycles": 1, "steps_per_cycle": 100})
    points = error_time.error_time(scene, repeats=1, quick=True).points
    errors = [p.error() for p in points if p.job.family == error_time.COULOMB]
    assert errors[-1] < 0.2 * errors[0]
    assert {p.job.family for p in points} == {error_time.COULOMB, error_time.REDUCED}
