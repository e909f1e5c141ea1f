"""Loss factors, joints and bolts in tables, summaries and printed lines of scenes."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joint_scenes import bar_scene, harmonic, plate_scene
from pydantic import ValidationError
from scene_texts import csv_rows

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
    low, high = (float(x) for x in re.search(r"force of (\S+) to (\S+) N", begins).groups())
    shares = [row for row in csv_rows(folder / "backbone.csv") if row["model"] == "full"]
    for row in shares:
        lost = float(row["lost_by_friction_J"]) + float(row["lost_by_damping_J"])
        work = np.pi * float(row["force_right_N"]) * float(row["displacement_right_m"])
        assert work == pytest.approx(lost, rel=1e-6)
    forces = [
        (float(row["lost_by_friction_J"]) + float(row["lost_by_damping_J"]))
        / (np.pi * float(row["displacement_right_m"]))
        for row in shares
    ]
    whole = [float(row["slipping_share_joint_bolt_2"]) >= 0.99 for row in shares].index(True)
    assert (low, high) == pytest.approx((forces[whole - 1], forces[whole]), rel=1e-3)
    bolts = [line for line in lines if line.startswith("  joint_bolt_2: ")]
    assert len(bolts) == 4
    assert all(
        "% of the friction loss" in line and "of the normal force of all joints." in line
        for line in bolts
    )


def test_a_table_has_the_amplitudes_their_errors_and_all_places(answered):
    folder, _ = answered
    rows = csv_rows(folder / "amplitudes.csv")
    assert [(row["model"], row["value"], row["unit"]) for row in rows] == [
        ("full", "5", "N"), ("full", "20", "N"), ("condensed", "5", "N"), ("condensed", "20", "N")
    ]  # fmt: skip
    for row in rows:
        eta, lost = float(row["loss_factor"]), 0.0
        assert set(COLUMNS) - {"lost_by_impacts_J"} <= row.keys()
        for name in ("lost_by_friction_J", "lost_by_damping_J"):
            lost += float(row[name])
        assert eta == pytest.approx(lost / (2.0 * np.pi * float(row["largest_strain_energy_J"])))
        force = lost / (np.pi * float(row["displacement_right_m"]))
        assert force == pytest.approx(float(row["value"]), rel=1e-4)
        shares = [float(row[f"loss_share_{name}"]) for name in PLACES]
        assert shares[0] == pytest.approx(shares[1] + shares[2]) == pytest.approx(1.0)
        by_friction, by_damping = (
            float(row[f"loss_factor_by_{x}"]) for x in ("friction", "damping")
        )
        assert eta == pytest.approx(by_friction + by_damping)
        known = [float(row[f"loss_factor_error_{name}"]) for name in ("mesh", "cycles")]
        model = row["loss_factor_error_model"]
        assert bool(model) == (row["model"] == "condensed")
        total = float(row["loss_factor_error_total"])
        assert total == pytest.approx(sum(known) + float(model or 0.0))
        assert "not known" not in row["not_counted"]
        excited = [float(x) for x in re.findall(r"mode \d+ at (\S+) times", row["not_counted"])]
        assert all(min(abs(x / m - 1.0) for m in (3, 5, 7)) < 0.075 for x in excited)
        assert bool(excited) == (row["value"] == "20")
        own = [float(row[f"friction_loss_error_{name}"] or 0.0) for name in ("mesh", "cycles")]
        apart = float(row["friction_loss_error_model"] or 0.0)
        assert float(row["friction_loss_error_total"]) == pytest.approx(sum(own) + apart)
    for exact, row in zip(rows[:2], rows[2:], strict=True):  # the distance is covered
        for name in ("lost_by_friction_J", "loss_factor_by_friction"):
            apart = abs(float(row[name]) / float(exact[name]) - 1.0)
            assert apart <= float(row["friction_loss_error_model"]) * (1.0 + 1e-9)
    cycles = [float(row["friction_loss_error_cycles"]) for row in rows[:2]]
    assert cycles[0] != cycles[1]  # each of its own amplitude
    levels = csv_rows(folder / "backbone.csv")
    assert {row["slipping_share"] == row["slipping_share_joint"] for row in levels} == {True}
    assert set(COLUMNS) - {"lost_by_impacts_J"} <= levels[0].keys()
    for row in levels:
        assert float(row["damping_ratio"]) < float(row["equivalent_viscous_ratio"])


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
    rows = csv_rows(tmp_path / "response.csv")
    for k, row in enumerate(rows):
        assert row["slipping_share"] == row["slipping_share_joint"]
        assert float(row["loss_factor"]) == pytest.approx(curve.losses.loss_factor[k])
        bolts = [float(row[f"loss_share_{name}"]) for name in PLACES]
        assert bolts[0] == pytest.approx(bolts[1] + bolts[2])
        for kind, unit in zip(
            functions, ("m_per_N", "m_per_s_per_N", "m_per_s2_per_N"), strict=True
        ):
            expected = sj.frequency_response(system, curve, "right", kind)[k, 0]
            assert float(row[f"{kind}_right_{unit}"]) == pytest.approx(abs(expected))
            assert float(row[f"{kind}_right_phase_rad"]) == pytest.approx(np.angle(expected))
    (level,) = json.loads((tmp_path / "summary.json").read_text())["models"]["reduced"]["levels"]
    assert set(level["peak"]["bolts"]) == set(PLACES[1:])


def test_what_does_not_fit_together_is_refused():
    with pytest.raises((sj.InputError, ValidationError), match="exactly one of displacement"):
        bracket("full", backbone={"at": {"point": "right"}})
    with pytest.raises((sj.InputError, ValidationError), match="must rise"):
        bracket("full", backbone={"at": {"point": "right", "force": [2.0, 1.0]}})
    with pytest.raises(sj.InputError, match="found 'left', must be one of right"):
        scene_backbone(bracket("full", backbone={"at": {"point": "left", "force": [2.0]}}))
    response = {"frequencies": {"from": 2e2, "to": 3e2}, "functions": ["transmissibility"]}
    with pytest.raises(sj.InputError, match="needs a base that moves"):
        scene_response(bracket("full", response=response))


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
