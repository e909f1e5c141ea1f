"""Errors of reduced models against a condensed one, of each joint, and of runs from Python."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import skfem_joint as sj
from skfem_joint.accuracy import condensed_reference
from skfem_joint.accuracy.condensed_reference import CondensedReference
from skfem_joint.accuracy.estimate import Estimate, verification_run
from skfem_joint.accuracy.ladder import HALVED, Series
from skfem_joint.accuracy.rungs import MODES_ADDED
from skfem_joint.results.history import (
    QUANTITIES,
    Results,
    difference,
    joint_differences,
    results,
)
from skfem_joint.stepping.plan import Plan
from skfem_joint.system.system import System

CYCLE = {"cycles": 2, "steps_per_cycle": 40}


@pytest.fixture(scope="module")
def plate() -> System:
    """Plate on a rigid base with two joints under Coulomb's law, pulled and bent in its plane."""
    strips = [("far", 0.08, 6), ("near", 0.08, 6), ("arm", 0.08, 4)]
    joints = [
        sj.Joint(name, p, friction=0.4, beta=np.inf) for name, p in (("far", 4e6), ("near", 2e6))
    ]
    structure = sj.Structure(
        sj.build_plate(strips, 0.04, 4),
        sj.Material(E=200e9, density=8000.0, poisson=0.3),
        thickness=0.005,
        joints=joints,
        damping_ratio=0.01,
        free=True,
    )
    load = sj.Load("right", sj.Harmonic(4e3, 300.0), direction=(1.0, 0.3))
    return structure.system([load], points=["right"])


@pytest.fixture(scope="module")
def run(plate: System) -> sj.Run:
    return sj.integrate(sj.reduce(plate, 4), **CYCLE)


def test_what_is_stated_is_what_the_full_model_with_far_smaller_steps_shows(plate, run):
    stated = sj.estimate(run)
    fine = run.plan.finer(8)
    truth, own = results(verification_run(plate, fine)), results(run)
    true = difference(truth, own)
    assert max(true.values()) > 0.02
    for name in QUANTITIES:
        if true[name] > 3e-3:
            assert 0.6 < stated.of("total", name) / true[name] < 1.7
    of_joints = joint_differences(truth, own, plate.contact.joints)
    for name in plate.contact.joints:
        for ours, theirs in zip(stated.by_joint[name], of_joints[name], strict=True):
            assert ours == pytest.approx(theirs, rel=0.5, abs=3e-3)
    worst = max(of_joints, key=lambda name: of_joints[name][1])
    assert stated.worst_joint == worst


def test_the_condensed_model_errs_by_less_than_a_thousandth(plate, run):
    reference = CondensedReference.of(plate)
    own = results(reference.run(run.plan, verification_run))
    apart = difference(results(verification_run(plate, run.plan)), own)
    assert max(apart.values()) < 1e-3


def test_modes_of_its_run_leave_nothing_of_it(plate, run):
    reference = CondensedReference.of(plate)
    other = reference.run(run.plan, verification_run)
    V, M = plate_basis(run), plate.M
    few, all_of_them = (reference.missing_modes(V, other, count) for count in (8, 400))
    moved = reference.V @ other.v.T
    for (wide, velocities), left in ((few, None), (all_of_them, 1e-3)):
        assert np.abs(wide.T @ (M @ wide) - np.eye(wide.shape[1])).max() < 1e-9
        assert np.array_equal(wide[:, : V.shape[1]], V)
        share = np.linalg.norm(moved - wide @ velocities.T) / np.linalg.norm(moved)
        assert left is None or share < left
    assert few[0].shape[1] == V.shape[1] + 8


def plate_basis(run: sj.Run) -> Any:
    return run.system.origin.basis.V


@pytest.mark.parametrize("limits", [{"rows": 0}, {"work": 0.0}, {"work_smooth": 0.0, "work": 0.0}])
def test_a_large_contact_has_no_condensed_model(plate, limits, monkeypatch):
    for name, limit in limits.items():
        monkeypatch.setattr(condensed_reference, name.upper(), limit)
    reference = CondensedReference.of(plate)
    assert reference is None or not reference.affords(Plan(1e-5, 100))


@pytest.mark.parametrize(
    ("series", "ratios"), [(MODES_ADDED, (0.1, 0.4, 0.75)), (HALVED, (0.25, 0.35, 0.5))]
)
def test_the_rest_of_a_geometric_series_is_exact(series: Series, ratios):
    one = dict.fromkeys(QUANTITIES, 2.0)
    for ratio in ratios:
        two = dict.fromkeys(QUANTITIES, 2.0 * ratio)
        whole = 2.0 / (1.0 - ratio)
        for rest in series.rest([one, two]).values():
            assert 2.0 + 2.0 * ratio + rest == pytest.approx(whole, rel=1e-12)
    (rest,) = set(series.rest([one, dict.fromkeys(QUANTITIES, 0.0)]).values())
    assert rest == 0.0


def test_half_a_step_alone_is_taken_to_be_of_second_order():
    for rest in HALVED.rest([dict.fromkeys(QUANTITIES, 3.0)]).values():
        assert 3.0 + rest == pytest.approx(4.0, rel=1e-12)


def energies(*by_joint: float) -> Results:
    return Results(("a",), np.ones((2, 1)), 1.0, sum(by_joint), 1.0, np.array(by_joint))


def test_errors_of_joints_may_cancel_in_their_sum():
    truth, other = energies(8.0, 2.0), energies(7.0, 3.0)
    assert difference(truth, other)["friction_energy"] == 0.0
    found = joint_differences(truth, other, ("large", "small"))
    assert found == {"large": (0.1, 0.125), "small": (0.1, 0.5)}
    assert Estimate({}, by_joint=found).worst_joint == "small"
    more = joint_differences(truth, other, ("large", "small"), left=0.1)
    assert more["small"] == pytest.approx((0.12, 0.6))
    assert joint_differences(energies(0.0), energies(1.0), ("one",)) == {"one": (None, None)}


def test_energies_of_joints_add_up_to_that_of_all(run):
    found = results(run)
    assert found.by_joint.sum() == pytest.approx(found.friction_energy, rel=1e-12)
    twice = found.plus(2.0, found, energies_of(found, 0.5))
    assert np.allclose(twice.by_joint, 2.0 * found.by_joint)


def energies_of(found: Results, share: float) -> Results:
    return replace(found, by_joint=share * found.by_joint)


def test_a_measured_error_counts_where_it_is_larger():
    total = dict.fromkeys(QUANTITIES, 0.01)
    stated = Estimate({"total": total}, by_joint={"a": (0.01, 0.02), "b": (0.01, None)})
    beside = stated.beside(dict.fromkeys(QUANTITIES, 0.03), {"a": (0.005, 0.05), "b": (None, 0.04)})
    assert beside.parts["total"] == dict.fromkeys(QUANTITIES, 0.03)
    assert beside.by_joint == {"a": (0.01, 0.05), "b": (0.01, 0.04)}
    assert beside.unmeasured == total


def test_an_estimate_of_a_condensed_and_of_a_full_run_states_what_they_miss(plate):
    for system, sources in ((sj.condense(plate), {"basis", "time_step"}), (plate, {"time_step"})):
        one = sj.integrate(system, **CYCLE)
        stated = sj.estimate(one)
        true = difference(results(verification_run(plate, one.plan.finer(8))), results(one))
        for name in QUANTITIES:
            if true[name] > 3e-3:
                assert 0.5 < stated.of("total", name) / true[name] < 3.0
        assert sources <= set(stated.parts)
        assert "Estimate of relative errors" in repr(stated)


def test_runs_whose_errors_cannot_be_estimated_are_refused(plate, run, tmp_path):
    small = run.system
    with pytest.raises(sj.InputError, match="starts displaced"):
        sj.estimate(sj.integrate(small, initial=run.final, **CYCLE))
    with pytest.raises(sj.InputError, match="no named points"):
        sj.estimate(sj.integrate(small, save=sj.Save(points=False), **CYCLE))
    with pytest.raises(sj.InputError, match="interrupted"):
        sj.estimate(replace(run, interrupted=True))
    loaded = sj.load(sj.save(small, tmp_path / "small.npz"))
    with pytest.raises(sj.InputError, match="loaded from a file"):
        sj.estimate(sj.integrate(loaded, **CYCLE))
    (load,) = small.loads
    other = replace(small, loads=(replace(load, amplitude=sj.Harmonic(2e3, 300.0)),))
    with pytest.raises(sj.InputError, match="are not those of the full"):
        sj.estimate(sj.integrate(other, **CYCLE))
