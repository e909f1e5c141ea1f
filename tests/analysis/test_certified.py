"""The estimated errors are the errors: each against a run that has hardly any."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joint_scenes import BARS, LENGTH, harmonic, joint, lap_joint, plate, plate_scene

from skfem_joint.analysis import study
from skfem_joint.analysis.certificate import (
    Estimate,
    certify,
    difference,
    extrapolated,
    make_reference,
    results,
    run_alone,
)
from skfem_joint.errors import InputError
from skfem_joint.mesh import build_bar
from skfem_joint.scene import Scene

STEPS = 50


def coarse(*run: str, **changes: Any) -> Scene:
    return lap_joint(*run, bar="short_lap_joint", **changes)


def error(estimate: Estimate, name: str = "friction_energy") -> float:
    value = estimate.errors[name]
    assert value is not None
    return value


def peak_and_energy(one: Scene) -> tuple[float, float]:
    run = run_alone(one)
    return float(run.cycles.peak[-1].max()), float(run.cycles.friction[-1])


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
def test_extrapolation_is_exact_for_a_power_of_the_step(order: float) -> None:
    values = [1.0 + h**order for h in (1.0, 0.5, 0.25)]
    error, found = extrapolated(values[0] - values[1], values[1] - values[2])
    assert error == pytest.approx(1.0, rel=1e-12)
    assert found == pytest.approx(order, rel=1e-12)


def test_errors_of_step_mesh_and_law_are_distances_from_runs_that_have_hardly_any() -> None:
    base = coarse(beta=1e4)
    step, mesh, law = certify(base, "full")
    assert [step.source, mesh.source, law.source] == ["time step", "mesh", "beta"]
    peak, energy = peak_and_energy(base)
    finest = peak_and_energy(base.changed(time={"steps_per_cycle": 64 * STEPS}))
    for name, ours, true in zip(
        ("peak_displacement", "friction_energy"), (peak, energy), finest, strict=True
    ):
        assert 0.5 <= error(step, name) / abs(ours / true - 1.0) <= 3.0
    fine = build_bar([("joint", LENGTH, 40 * 32)], BARS["short_lap_joint"][1])
    exact, _ = peak_and_energy(base.changed(mesh=fine))
    assert mesh.order == pytest.approx(1.0, abs=0.1)  # equal nodal forces
    assert mesh.errors["peak_displacement"] == pytest.approx(abs(peak / exact - 1.0), rel=0.1)
    _, exact = peak_and_energy(coarse(beta=np.inf))
    assert law.errors["friction_energy"] == pytest.approx(abs(1.0 - exact / energy), rel=1e-9)


def test_coulomb_has_no_error_of_beta_and_what_is_zero_is_not_certified_as_exact() -> None:
    assert [one.source for one in certify(coarse(beta=np.inf), "full")] == ["time step", "mesh"]
    smooth = coarse(joint=[joint(friction=0.0)])
    for estimate in certify(smooth, "full"):
        assert estimate.errors["friction_energy"] is None
        assert estimate.errors["peak_displacement"] is not None
    still = coarse(load=[harmonic(amplitude=0.0)])
    assert set(certify(still, "full")[0].errors.values()) == {None}


def test_mode_error_shrinks_with_modes_and_needs_no_full_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("the full model was run")

    monkeypatch.setitem(study._MAKERS, "full", refuse)
    errors = []
    for modes in (2, 5, 9):
        base = coarse("full", "reduced", reduction={"reference": "paper", "modes": modes})
        (_, estimate, points) = certify(base, "reduced")
        assert (estimate.source, points.source) == ("modes", "friction points")
        errors.append(error(estimate, "displacement_rms"))
    assert errors == sorted(errors, reverse=True)
    with pytest.raises(InputError, match="does not run the reduced model"):
        certify(coarse("full"), "reduced")


def test_certified_errors_of_a_plate_shrink_with_its_elements() -> None:
    time = {"cycles": 2, "steps_per_cycle": 40}
    found = []
    for elements in (4, 8):
        estimates = certify(plate_scene("full", mesh=plate(elements), time=time), "full")
        assert [one.source for one in estimates] == ["time step", "mesh", "beta"]
        found.append(error(estimates[1]))
    assert found[0] > 1.5 * found[1] > 0.0


@pytest.mark.parametrize("dimension", [1, 2])
def test_a_reference_is_known_better_than_its_certificate_says(dimension: int) -> None:
    time = {"cycles": 2, "steps_per_cycle": 50}
    scene = coarse(beta=1e3, time=time) if dimension == 1 else plate_scene(
        "full", mesh=plate(3), time=time
    )  # fmt: skip
    reference = make_reference(scene, quick=True, bound=0.2)
    finer = results(reference.grid.integrate(reference.system, 2 * reference.parts))
    off = difference(finer, reference.results)
    estimate = reference.estimates[0]
    assert (off["displacement_rms"] or 0.0) < 0.2 * error(estimate, "displacement_rms")
    assert (off["friction_energy"] or 0.0) < error(estimate)
