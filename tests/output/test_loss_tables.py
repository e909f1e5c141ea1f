"""Loss factors, joints and bolts in tables, summaries and printed lines of scenes."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from joint_scenes import bar_scene, harmonic, plate_scene
from pydantic import ValidationError

import skfem_joint as sj
from skfem_joint.output.damping import backbone_lines, write_backbone, write_response
from skfem_joint.output.loss import joule, loss_label
from skfem_joint.output.plots import energies_figure
from skfem_joint.results.loss import COLUMNS
from skfem_joint.study.scene_backbone import scene_backbone
from skfem_joint.study.scene_response import scene_response

BOLTS = [
    {"at": [x, 0.025], "force": 20e3, "head_radius": 0.009, "hole_radius": 0.0055}
    for x in (0.05, 0.15)
]
PLACES = ("joint", "joint_bolt_1", "joint_bolt_2")


def bracket(*models: str, **changes: Any) -> sj.Scene:
    """Plate held by two bolts and shaken across its free end."""
    values: dict[str, Any] = {
        "mesh": sj.build_plate([("joint", 0.2, 16), ("free", 0.3, 10)], 0.05, 4),
        "material": {"E": 200e9, "density": 8000.0, "poisson": 0.3},
        "joint": [{"on": "joint", "pressure": {"bolts": BOLTS, "reach": 0.01}, "friction": 0.7}],
        "load": [harmonic("right", 50.0, 300.0) | {"direction": [0.0, 1.0]}],
        "damping": {"ratio": 2e-3},
    }
    return plate_scene(*models, **values | changes)


@pytest.fixture(scope="module")
def answered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Folder and printed lines of a curve with two amplitudes."""
    at = {"point": "right", "force": [5.0, 20.0]}
    scene = bracket("full", "condensed", backbone={"modes": [1], "levels": 4, "at": at})
    found, folder = scene_backbone(scene), tmp_path_factory.mktemp("answered")
    write_backbone(folder, found)
    return folder, backbone_lines(found)


def test_one_command_says_loss_factor_error_and_bolt(answered):
    folder, lines = answered
    (first,) = [line for line in lines if line.startswith("full model, mode 1, force of 20 N")]
    parts = re.search(
        r"loss factor (\S+) = (\S+) by friction \+ (\S+) by damping \(given, (.*?)\)", first
    )
    whole, friction, damping = (float(x) for x in parts.groups()[:3])
    assert whole == pytest.approx(friction + damping, rel=0.01)
    assert parts[4] == "[damping] ratio"
    assert ", numerical error without higher modes ± " in first
    assert re.search(r"\(of the friction part ± \S+ %\) by load increments and the mesh, Q", first)
    missing = lines[lines.index(first) + 1]
    assert missing.startswith("  Not counted: that of the damping coefficient, which is given; ")
    assert missing.endswith("by which the friction part may be twice as large or more.")
    (begins,) = [line for line in lines if line.startswith("  joint_bolt_2 begins to slip")]
    ends = [float(x) for x in re.search(r"force of (\S+) to (\S+) N", begins).groups()]
    levels = pd.read_csv(folder / "backbone.csv").query("model == 'full'")
    forces = lost_in(levels) / (np.pi * levels.displacement_right_m)
    np.testing.assert_allclose(levels.force_right_N, forces, rtol=1e-6)
    whole = int((levels.slipping_share_joint_bolt_2 >= 0.99).argmax())
    assert ends == pytest.approx([*forces[whole - 1 : whole + 1]], rel=1e-3)
    bolts = [line for line in lines if line.startswith("  joint_bolt_2: ")]
    assert len(bolts) == 4
    assert all(
        "% of the friction loss" in line and "of the normal force of all joints." in line
        for line in bolts
    )


def lost_in(rows: Any) -> Any:
    """Energy lost in the cycles of a table, J."""
    return rows.lost_by_friction_J + rows.lost_by_damping_J


def test_a_table_has_the_amplitudes_their_errors_and_all_places(answered):
    folder, _ = answered
    rows = pd.read_csv(folder / "amplitudes.csv")
    assert [*rows.model] == ["full"] * 2 + ["condensed"] * 2
    assert ([*rows.value], {*rows.unit}) == ([5.0, 20.0] * 2, {"N"})
    eta, lost, of_rows = rows.loss_factor, lost_in(rows), {"rtol": 1e-6}
    assert set(COLUMNS) - {"lost_by_impacts_J"} <= {*rows}
    np.testing.assert_allclose(eta, lost / (2.0 * np.pi * rows.largest_strain_energy_J), **of_rows)
    np.testing.assert_allclose(lost / (np.pi * rows.displacement_right_m), rows.value, rtol=1e-4)
    whole, *bolts = (rows[f"loss_share_{name}"] for name in PLACES)
    np.testing.assert_allclose(whole, 1.0, **of_rows)
    np.testing.assert_allclose(sum(bolts), 1.0, **of_rows)
    parts = rows.loss_factor_by_friction + rows.loss_factor_by_damping
    np.testing.assert_allclose(eta, parts, **of_rows)
    for of in ("loss_factor", "friction_loss"):
        errors = [rows[f"{of}_error_{source}"] for source in ("mesh", "cycles", "model", "total")]
        assert [*errors[2].notna()] == [False] * 2 + [True] * 2
        np.testing.assert_allclose(errors.pop(), np.nansum(errors, axis=0), **of_rows)
    assert rows.loss_factor_error_mesh.notna().all()
    for missing, value in zip(rows.not_counted, rows.value, strict=True):
        assert "not known" not in missing
        excited = [float(x) for x in re.findall(r"mode \d+ at (\S+) times", missing)]
        assert all(min(abs(x / m - 1.0) for m in (3, 5, 7)) < 0.075 for x in excited)
        assert bool(excited) == (value == 20.0)
    for name in ("lost_by_friction_J", "loss_factor_by_friction"):  # the distance is covered
        exact, found = np.reshape(rows[name], (2, 2))
        assert np.all(np.abs(found / exact - 1.0) <= rows.friction_loss_error_model[2:] + 1e-12)
    assert rows.friction_loss_error_cycles[:2].nunique() == 2  # each of its own amplitude
    levels = pd.read_csv(folder / "backbone.csv")
    assert levels.slipping_share.equals(levels.slipping_share_joint)
    assert set(COLUMNS) - {"lost_by_impacts_J"} <= {*levels}
    assert (levels.damping_ratio < levels.equivalent_viscous_ratio).all()


def test_a_model_of_merged_points_says_that_shares_of_bolts_are_rough():
    at = {"point": "right", "force": [20.0]}
    options = {"modes": 6, "friction_points": 12}
    scene = bracket("reduced", backbone={"levels": 3, "at": at}, reduction=options)
    lines = backbone_lines(scene_backbone(scene))
    (said,) = [line for line in lines if "friction points stand for" in line]
    count = scene.system().contact.w.size
    assert said.startswith(f"  12 friction points stand for {count}, which does not resolve")
    assert not any("begins to slip as a whole" in line for line in lines)
    (first,) = [line for line in lines if "force of 20 N" in line]
    assert " by load increments and the mesh and the smaller model, Q" in first


def test_the_summary_has_what_a_report_needs(answered):
    folder, _ = answered
    summary = json.loads((folder / "summary.json").read_text())
    (mode,) = summary["models"]["full"]["modes"]
    assert [entry["value"] for entry in mode["amplitudes"]] == [5.0, 20.0]
    for entry in (*mode["amplitudes"], mode["highest_level"]):
        assert set(entry["bolts"]) == set(PLACES[1:])
        assert sum(bolt["loss_share"] for bolt in entry["bolts"].values()) == pytest.approx(1.0)
        for bolt in entry["bolts"].values():
            assert bolt["normal_force_N"] == pytest.approx(20e3)
            assert bolt["normal_force_share"] == pytest.approx(0.5)
        assert entry["quality_factor"] == pytest.approx(1.0 / entry["loss_factor"])


def test_a_response_has_losses_places_and_the_functions_asked_for(tmp_path):
    functions = ["receptance", "mobility", "accelerance"]
    response = {"frequencies": {"from": 200.0, "to": 240.0, "points": 2}, "functions": functions}
    scene = bracket("reduced", response=response, accuracy={"estimate": False})
    found = scene_response(scene)
    write_response(tmp_path, found)
    (curve,), system = found.models[0].curves, scene.system()
    rows = pd.read_csv(tmp_path / "response.csv")
    assert rows.slipping_share.equals(rows.slipping_share_joint)
    np.testing.assert_allclose(rows.loss_factor, curve.losses.loss_factor, rtol=1e-6)
    whole, *bolts = (rows[f"loss_share_{name}"] for name in PLACES)
    np.testing.assert_allclose(whole, sum(bolts), rtol=1e-6)
    units = ("m_per_N", "m_per_s_per_N", "m_per_s2_per_N")
    for kind, unit in zip(functions, units, strict=True):
        expected = sj.frequency_response(system, curve, "right", kind)[:, 0]
        np.testing.assert_allclose(rows[f"{kind}_right_{unit}"], np.abs(expected), rtol=1e-6)
        np.testing.assert_allclose(rows[f"{kind}_right_phase_rad"], np.angle(expected), rtol=1e-6)
    (level,) = json.loads((tmp_path / "summary.json").read_text())["models"]["reduced"]["levels"]
    assert set(level["peak"]["bolts"]) == set(PLACES[1:])


def test_what_does_not_fit_together_is_refused():
    with pytest.raises((sj.InputError, ValidationError), match="exactly one of displacement"):
        bracket("full", backbone={"at": {"point": "right"}})
    with pytest.raises((sj.InputError, ValidationError), match="must rise"):
        bracket("full", backbone={"at": {"point": "right", "force": [2.0, 1.0]}})


@pytest.fixture(scope="module")
def run_of_two_models() -> sj.Study:
    return sj.run_scene(bar_scene("full", "reduced", time={"cycles": 3}, reduction={"modes": 3}))


def test_the_stated_error_of_a_loss_factor_covers_what_a_reduction_changes(run_of_two_models):
    full, reduced = run_of_two_models.models.values()
    exact, found = (float(sj.losses(model.run).loss_factor) for model in (full, reduced))
    apart = abs(found / exact - 1.0)
    assert 0.01 < apart < reduced.loss_error < 3.0 * apart


def test_no_total_error_is_less_than_one_of_its_parts(run_of_two_models):
    for model in run_of_two_models.models.values():
        parts = {source: e for source, e in model.estimate.parts.items() if source != "coulomb"}
        total = parts.pop("total")
        for name in ("peak_displacement", "friction_energy", "loop_energy"):
            assert total[name] >= max(errors[name] for errors in parts.values())


def test_pictures_of_a_run_name_its_loss_factor(run_of_two_models):
    model = run_of_two_models.models["full"]
    label, lost = loss_label(model, on_mesh=True), sj.losses(model.run)
    number = f"loss factor {float(lost.loss_factor):#.3g} ± "
    assert label.startswith(number)
    assert label.endswith(f"/ (2π · {joule(float(lost.strain))})")
    figure = energies_figure(run_of_two_models.runs, {"full": label})
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [f"full: {label}", "reduced"]
