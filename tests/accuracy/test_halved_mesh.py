"""The stated error by the mesh is the error: against closed forms and far finer meshes."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from joint_scenes import two_plates

import skfem_joint as sj
from skfem_joint.accuracy.estimate import Estimate, verification_run
from skfem_joint.output import report
from skfem_joint.output.damping import backbone_lines, write_backbone
from skfem_joint.results.history import difference, results
from skfem_joint.study.models import finer_mesh
from skfem_joint.study.scene_backbone import scene_backbone
from skfem_joint.vibration.mesh_of_curve import mesh_of_curve

STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)
PULL = sj.Harmonic(1.0, 1.0)


def pulled_bar(elements: int) -> sj.Structure:
    """Bar of which one half is pressed on a base, and the other end pulled."""
    mesh = sj.build_bar([("joint", 0.1, elements), ("arm", 0.1, 2)], {"end": 0.2})
    joint = sj.Joint("joint", pressure=10e6, friction=0.5)
    return sj.Structure(mesh, STEEL, width=0.05, thickness=0.01, joints=[joint])


def lap(elements: int, kind: str = "quadrilateral") -> sj.NamedMesh:
    """Two plates from the side, lapped over 0.08 m."""
    sides = {"held": "left", "upper_face": ("bottom", "upper_lap")}
    strips = [("upper_arm", 0.1, elements), ("upper_lap", 0.08, elements)]
    upper = sj.build_plate(strips, 0.012, 1, origin=(0.0, 0.012), kind=kind, boundaries=sides)
    sides = {"pulled": "right", "lower_face": ("top", "lower_lap")}
    strips = [("lower_lap", 0.08, elements), ("lower_arm", 0.1, elements)]
    lower = sj.build_plate(strips, 0.012, 1, origin=(0.1, 0.0), kind=kind, boundaries=sides)
    return sj.merged([upper, lower])


def lapped(mesh: sj.NamedMesh, load: float, frequency: float = 30.0) -> sj.System:
    joint = sj.Joint("upper_face", against="lower_face", pressure=10e6, friction=0.4)
    plain = {"order": mesh.order, "incompatible": False}
    fixed = {"thickness": 0.04, "fixed": ["held"], "damping_ratio": 0.01}
    made = sj.Structure(mesh, STEEL, joints=[joint], **fixed, **plain)
    pull = sj.Load("pulled", sj.Harmonic(load, frequency), direction=(0.0, 1.0))
    return made.system([pull], points=["pulled"])


@pytest.mark.parametrize("share", [0.2, 0.3, 0.4])
def test_few_points_across_the_slip_of_a_bar_err_as_the_closed_form_says(share):
    """With friction t by length the loop loses 2/3 F^3 / (E A t) (Masing)."""
    friction, load = 0.5 * 10e6 * 0.05, share * 0.5 * 10e6 * 0.05 * 0.1
    pull = [sj.Load("end", replace(PULL, amplitude=load))]
    coarse, fine = (pulled_bar(n).system(pull) for n in (6, 12))
    run = sj.quasi_static(coarse, cycles=2, steps_per_cycle=40)
    stated = sj.estimate(run, finer=fine).of("mesh", "friction_energy")
    exact = 2.0 / 3.0 * load**3 / (200e9 * 0.05 * 0.01 * friction)
    true = abs(run.cycles.friction[-1] / exact - 1.0)
    assert 0.5 * true <= stated <= max(3.0 * true, 0.03)


@pytest.mark.parametrize(("kind", "frequency"), [("quadrilateral", 80.0), ("triangle", 30.0)])
def test_a_run_errs_as_far_as_stated_with_what_locking_does_to_its_resonance(kind, frequency):
    """The first bending is at 121 Hz; elements of first order make it far too high."""
    mesh = lap(6, kind)
    run = sj.integrate(lapped(mesh, 2e3, frequency), cycles=5, steps_per_cycle=100)
    stated = sj.estimate(run, finer=lapped(sj.refined(mesh), 2e3, frequency))
    best = lapped(sj.refined(replace(mesh, order=2)), 2e3, frequency)
    plan = run.plan.storing(fields_every=0)
    true = difference(results(verification_run(sj.condense(best), plan)), results(run))
    for name in ("displacement_rms", "friction_energy", "loop_energy"):
        assert true[name] > 0.2
        assert 0.5 <= stated.of("mesh", name) / true[name] <= 3.0, name
        assert stated.of("total", name) >= stated.of("mesh", name)
        rest = stated.of("total", name) - stated.of("mesh", name)
        assert stated.on_its_mesh[name] == pytest.approx(rest)


def test_a_curve_errs_as_far_as_stated_by_level():
    mesh = replace(lap(8), order=2)
    (curve,) = sj.backbone(lapped(mesh, 1.0))
    stated = mesh_of_curve(curve, lapped(sj.refined(mesh), 1.0))
    best = lapped(sj.refined(sj.refined(sj.refined(mesh))), 1.0)
    (other,) = sj.backbone(best, levels=curve.level)
    true = np.abs(curve.damping_ratio / other.damping_ratio - 1.0)
    judged = true > 0.02
    assert judged.sum() >= 3
    ratio = stated["damping_ratio"] / true
    good = (ratio >= 0.5) & (ratio <= 3.0)
    assert good[judged].mean() >= 0.9
    assert stated["frequency"].max() < 0.01


def scene(*models: str) -> sj.Scene:
    return two_plates(*models, time={"cycles": 2, "steps_per_cycle": 60})


def test_all_models_of_a_scene_have_the_same_error_by_the_mesh_in_their_totals():
    one = scene("full", "condensed", "reduced")
    study = sj.run_scene(one)
    found = [model.estimate for model in study.models.values()]
    assert len(found) == 3
    for errors in found:
        assert errors.parts["mesh"] == found[0].parts["mesh"]
        assert errors.of("total", "friction_energy") > errors.of("mesh", "friction_energy") > 0.0
        assert not errors.lacks_mesh
    alone = sj.estimate(study.models["full"].run, finer=finer_mesh(one).system())
    assert alone.parts["mesh"] == pytest.approx(found[0].parts["mesh"], rel=1e-6)
    table = str(report.estimate_table(report.summary(study)))
    assert "condensed model, mesh" in table
    assert "without mesh" not in table


def test_curves_of_a_scene_have_their_errors_by_the_mesh_in_text_table_and_summary(tmp_path):
    found = scene_backbone(scene("full", "reduced").changed(backbone={"levels": 4}))
    (errors,) = found.mesh.values()
    assert 0.0 < errors["frequency"].min() <= errors["frequency"].max() < 0.2
    assert any(line.startswith("Mode 1: the mesh errs by") for line in backbone_lines(found))
    write_backbone(tmp_path, found)
    lines = (tmp_path / "backbone.csv").read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(lines))
    shown = [float(row["mesh_error_damping_ratio"]) for row in rows]
    assert shown == pytest.approx([*errors["damping_ratio"]] * 2, rel=1e-9, nan_ok=True)
    content = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    for model in content["models"].values():
        largest = model["modes"][0]["mesh_error"]["frequency"]
        assert largest == pytest.approx(errors["frequency"].max())
    plain = scene_backbone(found.scene.changed(accuracy={"estimate": False}))
    assert not plain.mesh


def test_a_mesh_that_changes_nothing_errs_by_nothing_and_totals_stay_unknown_where_they_are():
    parts = {"total": {"friction_energy": 0.02, "loop_energy": None}}
    found = Estimate(parts).with_mesh({"friction_energy": None, "loop_energy": 0.1})
    assert found.parts["total"] == {"friction_energy": 0.02, "loop_energy": None}


def test_a_finer_system_of_another_structure_or_load_is_refused():
    mesh = lap(3)
    run = sj.integrate(lapped(mesh, 2e3), cycles=1, steps_per_cycle=20)
    for other, words in (
        (run.system, r"finer: found .* must have more than"),
        (pulled_bar(400).system([sj.Load("end", PULL)]), "points"),
        (lapped(sj.refined(mesh), 4e3), "loads of other amplitudes than those of the run"),
    ):
        with pytest.raises(sj.InputError, match=words):
            sj.estimate(run, finer=other)
