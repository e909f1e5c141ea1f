"""The estimated errors are the errors: each against a run that has hardly any."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_scenes import BARS, LENGTH, harmonic, joint, lap_joint, plate, plate_scene

import skfem_joint as sj
from skfem_joint.accuracy.estimate import Estimate, verification_run
from skfem_joint.output import report
from skfem_joint.results.history import Results, difference, results
from skfem_joint.study.certificate import certify, halved, make_reference
from skfem_joint.study.models import plan_of


def coarse(*run: str, **changes: Any) -> sj.Scene:
    return lap_joint(*run, bar="short_lap_joint", **changes)


def certified(scene: sj.Scene) -> Estimate:
    return certify(sj.run_scene(scene), "full").estimate


def peak_and_energy(one: sj.Scene) -> tuple[float, float]:
    run = verification_run(one.system(), plan_of(one))
    return float(run.cycles.peak[-1].max()), float(run.cycles.friction[-1])


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
def test_extrapolation_is_exact_for_a_power_of_the_step(order):
    def off(error: float) -> Results:
        whole = np.array([1.0 + error])
        return Results(("a",), whole[:, np.newaxis], *(1.0 + error,) * 3, by_joint=whole)

    found = halved("step", [off(1e-3 * h**order) for h in (1.0, 0.5, 0.25)])
    for error in found.errors.values():
        assert error == pytest.approx(1e-3, rel=2e-3)  # relative to a result that errs itself
    assert found.order == pytest.approx(order, abs=2e-3)


def test_the_error_of_the_mesh_is_the_distance_from_a_run_that_has_hardly_any():
    base = coarse(beta=1e4)
    found = certified(base)
    peak, _ = peak_and_energy(base)
    fine = sj.build_bar([("joint", LENGTH, 40 * 32)], BARS["short_lap_joint"][1])
    exact, _ = peak_and_energy(base.changed(mesh=fine))
    assert found.of("mesh", "peak_displacement") == pytest.approx(abs(peak / exact - 1.0), rel=0.1)
    parts = [found.of(source, "friction_energy") for source in ("time_step", "mesh")]
    assert found.of("total", "friction_energy") == pytest.approx(sum(filter(None, parts)))


def test_a_plate_has_the_same_error_by_the_mesh_with_and_without_a_certificate():
    scene = plate_scene("full", mesh=plate(3), time={"cycles": 2, "steps_per_cycle": 50})
    study = sj.run_scene(scene)
    own, found = (m.estimate for m in (study.models["full"], certify(study, "full")))
    stated = own.of("mesh", "displacement_rms")
    assert stated > 0.0
    # One is relative to the finer run, the other to the extrapolated one.
    assert found.of("mesh", "displacement_rms") == pytest.approx(stated, rel=0.6 * stated + 1e-9)


@pytest.mark.parametrize("model", ["full", "reduced"])
def test_an_executor_certifies_the_same(model):
    study = sj.run_scene(coarse(model, beta=1e4))
    with ThreadPoolExecutor(2) as executor:
        found = certify(study, model, executor=executor)
    assert found == certify(study, model)


def test_a_total_is_not_known_where_that_of_the_step_is_not():
    found = certified(coarse(beta=1e4, accuracy={"estimate": False}))
    assert (found.of("mesh", "peak_displacement") or 0.0) > 0.0
    assert set(found.parts["total"].values()) == {None}


def test_what_is_zero_is_not_certified_as_exact():
    smooth = certified(coarse(joint=[joint(friction=0.0)]))
    for source in smooth.parts:
        assert smooth.of(source, "friction_energy") is None
        assert smooth.of(source, "peak_displacement") is not None
    still = certified(coarse(load=[harmonic(amplitude=0.0)]))
    assert {error for part in still.parts.values() for error in part.values()} == {None}


def test_a_short_full_run_certifies_a_reduced_model_that_runs_alone():
    scene = coarse("reduced", reduction={"reference": "paper", "modes": 3})
    results_of_it = sj.run_scene(scene)
    found = certify(results_of_it, "reduced").estimate
    full = verification_run(scene.system(), plan_of(scene))
    reduced = results_of_it.models["reduced"].run
    true = difference(results(full), results(reduced))["friction_energy"]
    assert found.of("full_run", "friction_energy") == pytest.approx(true, rel=0.01)
    total, by_run = (found.of(source, "friction_energy") for source in ("total", "full_run"))
    assert total >= by_run
    with pytest.raises(sj.InputError, match="does not run the full model"):
        certify(results_of_it, "full")


def test_a_total_that_lacks_the_mesh_says_so_beside_the_number(monkeypatch):
    """Of a large structure only a certified full model knows its mesh, not a reduced one."""
    monkeypatch.setattr("skfem_joint.study.models.MOST_UNKNOWNS", 0)
    for models, name, label in (
        (("full", "reduced"), "full", "total"),
        (("full", "reduced"), "reduced", "total without mesh"),
        (("reduced",), "reduced", "total without mesh"),
    ):
        study = sj.run_scene(coarse(*models, beta=1e4))
        assert "\n  total without mesh: " in repr(study.models[name].estimate)
        study = replace(study, models={name: certify(study, name) for name in models})
        content = report.summary(study)
        assert f"\n  {label}: " in repr(study.models[name].estimate)
        lines = [line.split("  ")[0] for line in str(report.estimate_table(content)).splitlines()]
        assert [f"{name} model, {label}"] == [
            x for x in lines if x.startswith(f"{name} model, tot")
        ]
        assert content["models"][name]["estimated_total_without_mesh"] == (label != "total")


def test_a_reference_is_known_better_than_its_certificate_says():
    scene = plate_scene("full", mesh=plate(3), time={"cycles": 2, "steps_per_cycle": 50})
    reference = make_reference(scene, quick=True, bound=0.2)
    finer = results(reference.grid.integrate(reference.system, 2 * reference.parts))
    off = difference(finer, reference.results)
    errors = reference.estimates[0].errors
    for name, share in (("displacement_rms", 0.2), ("friction_energy", 1.0)):
        assert (off[name] or 0.0) < share * (errors[name] or 0.0)
