"""Modes of a structure's own run."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_scenes import harmonic, plate_scene
from reduced_joints import STEPS, case, errors, fig_18, full, three_periods
from scipy.linalg import subspace_angles

import skfem_joint as sj


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_own_modes_reproduce_the_reference_plate(poisson):
    _, system, step = case("lap", poisson)
    run = full("lap", poisson)
    small, few = (sj.reduce(system, 12, run=run, friction_points=k) for k in ("all", 36))
    V, M = small.origin.basis.V, system.M
    np.testing.assert_allclose(V.T @ (M @ V), np.eye(12), atol=1e-10)
    velocities = small.origin.basis.history.velocities
    np.testing.assert_allclose(velocities, run.v @ (M @ V), rtol=1e-12)
    every = three_periods(small, step)
    history, energy = errors(every, run)
    assert history < 0.01
    assert abs(energy) < 0.02
    history, energy = errors(three_periods(few, step), every)
    assert history < 0.003
    assert abs(energy) < 0.005


def test_fixed_interface_modes_do_not_slip():
    _, system, _ = case("strip")
    plain, more = (
        sj.reduce(system, 6, run=full("strip"), interface_modes=count).origin.basis.V
        for count in (0, 2)
    )
    assert more.shape[1] == 8
    assert np.sin(subspace_angles(more, plain)).max() < 1e-12  # holds the others
    assert np.linalg.matrix_rank(system.contact.B @ more, tol=1e-9 * np.abs(more).max()) == 6


def test_modes_need_a_run_that_moves_and_holds_enough_snapshots():
    _, system, step = case("strip")
    save = sj.Save(fields=True)
    still = sj.integrate(replace(system, loads=()), step=step, n_steps=10, save=save)
    with pytest.raises(sj.InputError, match="nothing moves"):
        sj.reduce(system, 4, run=still)
    with pytest.raises(sj.InputError, match=r"reduction\.modes: found 999, must be from 1"):
        sj.reduce(system, 999, run=full("strip"))


def strip(modes: int, cycles: int, *direction: float, **reduction: Any) -> sj.Scene:
    """Scene of the plate whose reduced model has modes of its own run."""
    pull = harmonic("right", 87.5e3 if direction == (1.0, 0.0) else 2e3)
    return plate_scene(
        "reduced",
        mesh=sj.build_plate([("joint", 0.1, 16), ("arm", 0.5, 16)], 0.05, 2),
        material={"E": 200e9, "density": 8000.0, "poisson": 0.3},
        joint=[{"on": "joint", "pressure": 50e6, "friction": 0.7, "beta": 1e5}],
        load=[pull | {"direction": [*direction]}],
        time={"cycles": cycles, "steps_per_cycle": STEPS},
        reduction={"reference": "self", "modes": modes, **reduction},
        accuracy={"estimate": False},
    )


def test_own_modes_of_a_structure_come_from_its_first_three_cycles():
    scene = strip(6, 5, 1.0, 0.0, interface_modes=2, active_length=0.05)
    study = sj.run_scene(scene)
    system, five = scene.system(), {"cycles": 5, "steps_per_cycle": STEPS}
    three = five | {"cycles": 3, "save": sj.Save(fields=True)}
    small = sj.reduce(system, 6, run=sj.integrate(system, **three), interface_modes=2)
    found, expected = study.models["reduced"].run, sj.integrate(small, **five)
    assert found.system.n == 8
    atol = 1e-9 * np.abs(expected.point_u).max()
    np.testing.assert_allclose(found.point_u, expected.point_u, atol=atol)
    note = "reduction.active_length has no effect but beside reference = 'paper'."
    assert note in study.notes


def test_keys_without_effect_on_modes_of_the_static_path_are_named():
    scene = strip(6, 1, 1.0, 0.0, reference="static", snapshots="rates", inner_product="mass")
    for key in ("snapshots", "inner_product"):
        note = f"reduction.{key} has no effect but beside reference = 'self' or 'paper'."
        assert note in sj.run_scene(scene).notes


def test_a_basis_that_cannot_follow_its_run_is_refused_or_doubted():
    study = sj.run_scene(strip(2, 3, 0.0, 1.0))
    assert any("cannot follow" in warning for warning in study.notes)
    with pytest.raises(sj.InputError, match="cannot follow"):
        sj.run_scene(strip(1, 3, 0.0, 1.0))


def test_loads_that_do_not_repeat_need_a_duration():
    structure, _ = fig_18()
    system = structure.system([sj.Load("end", sj.HalfSine(5e4, 5e-4))])
    with pytest.raises(sj.InputError, match="no common period"):
        sj.reduce(system)
    assert sj.reduce(system, 8, duration=2e-3).n >= 8 + 1
