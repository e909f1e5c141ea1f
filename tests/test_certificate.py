"""The estimated errors are the errors: each against a run that has hardly any."""

from __future__ import annotations

import numpy as np
import pytest

from skfem_joint.certificate import certify, extrapolated
from skfem_joint.paper.cases import CASES, scene
from skfem_joint.scene import Scene
from skfem_joint.study import run_scene

STEPS = 50


def coarse(**options: object) -> Scene:
    time = {"cycles": 3, "steps_per_cycle": STEPS}
    return scene(CASES["reference"], **({"time": time, "elements": 40} | options))  # type: ignore[arg-type]


def peak_and_energy(one: Scene) -> tuple[float, float]:
    (model,) = run_scene(one).models.values()
    return float(model.run.cycles.peak[-1].max()), float(model.run.cycles.friction[-1])


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
def test_extrapolation_is_exact_for_a_power_of_the_step(order: float) -> None:
    values = [1.0 + h**order for h in (1.0, 0.5, 0.25)]
    error, found = extrapolated(values[0] - values[1], values[1] - values[2])
    assert error == pytest.approx(1.0, rel=1e-12)
    assert found == pytest.approx(order, rel=1e-12)


def test_time_step_error_is_the_distance_from_a_run_with_tiny_steps() -> None:
    base = coarse()
    estimate = certify(base, "full")[0]
    finest = coarse(time={"cycles": 3, "steps_per_cycle": 64 * STEPS})
    exact = peak_and_energy(finest)
    found = peak_and_energy(base)
    for name, ours, true in zip(
        ("peak_displacement", "friction_energy"), found, exact, strict=True
    ):
        actual = abs(ours / true - 1.0)
        assert estimate.errors[name] >= 0.5 * actual
        assert estimate.errors[name] <= 3.0 * actual


def test_mesh_error_is_the_distance_from_a_fine_mesh() -> None:
    base = coarse()
    estimate = certify(base, "full")[1]
    assert estimate.source == "mesh"
    assert estimate.order == pytest.approx(1.0, abs=0.1)  # equal nodal forces
    peak, _ = peak_and_energy(base)
    exact, _ = peak_and_energy(coarse(elements=40 * 32))
    assert estimate.errors["peak_displacement"] == pytest.approx(abs(peak / exact - 1.0), rel=0.1)


def test_beta_error_is_the_distance_from_coulomb() -> None:
    base = coarse(beta=1e4)
    estimate = certify(base, "full")[2]
    assert estimate.source == "beta"
    _, energy = peak_and_energy(base)
    _, exact = peak_and_energy(coarse(beta=np.inf))
    assert estimate.errors["friction_energy"] == pytest.approx(abs(1.0 - exact / energy), rel=1e-9)


def test_coulomb_has_no_error_of_beta() -> None:
    assert [one.source for one in certify(coarse(beta=np.inf), "full")] == ["time step", "mesh"]


def test_mode_error_shrinks_with_modes_and_needs_no_full_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("the full model was run")

    monkeypatch.setattr("skfem_joint.study._full", refuse)
    errors = []
    for modes in (2, 5, 9):
        base = coarse(run=("full", "reduced"), reduction={"modes": modes})
        (_, estimate, points) = certify(base, "reduced")
        assert (estimate.source, points.source) == ("modes", "friction points")
        errors.append(estimate.errors["displacement_rms"])
    assert errors[0] > errors[1] > errors[2]
