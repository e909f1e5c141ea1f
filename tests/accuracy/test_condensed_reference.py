"""Errors of reduced models against a condensed one, of each joint, and of runs from Python."""

from dataclasses import replace

import numpy as np
import pytest

import skfem_joint as sj
from skfem_joint.accuracy.condensed_reference import CondensedReference
from skfem_joint.accuracy.estimate import Estimate, verification_run
from skfem_joint.results.history import (
    QUANTITIES,
    Results,
    difference,
    joint_differences,
    results,
)
from skfem_joint.stepping.plan import Plan

CYCLE = {"cycles": 2, "steps_per_cycle": 40}


@pytest.fixture(scope="module")
def plate() -> sj.System:
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
def run(plate: sj.System) -> sj.Run:
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


def test_modes_of_its_run_leave_nothing_of_it(plate, run):
    reference = CondensedReference.of(plate)
    other = reference.run(run.plan, verification_run)
    V, M = run.system.origin.basis.V, plate.M
    few, all_of_them = (reference.missing_modes(V, other, count) for count in (8, 400))
    moved = reference.V @ other.v.T
    for (wide, velocities), left in ((few, None), (all_of_them, 1e-3)):
        assert np.abs(wide.T @ (M @ wide) - np.eye(wide.shape[1])).max() < 1e-9
        assert np.array_equal(wide[:, : V.shape[1]], V)
        share = np.linalg.norm(moved - wide @ velocities.T) / np.linalg.norm(moved)
        assert left is None or share < left
    assert few[0].shape[1] == V.shape[1] + 8


def test_a_large_contact_has_no_condensed_model(plate):
    """Of more than 700 slip rows, or for very many steps."""
    mesh = sj.build_plate([("far", 0.08, 120)], 0.04, 2)
    joint = sj.Joint("far", 4e6, friction=0.4, beta=np.inf)
    steel = sj.Material(E=200e9, density=8000.0, poisson=0.3)
    large = sj.Structure(mesh, steel, thickness=0.005, joints=[joint], free=True).system()
    assert CondensedReference.of(large) is None
    reference, short, long = CondensedReference.of(plate), Plan(1e-5, 100), Plan(1e-5, 10**6)
    assert reference.affords(short)
    assert not reference.affords(long)
    assert not reference.affords(long, steeper=False)


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


def test_a_measured_error_counts_where_it_is_larger():
    total = dict.fromkeys(QUANTITIES, 0.01)
    stated = Estimate({"total": total}, by_joint={"a": (0.01, 0.02), "b": (0.01, None)})
    beside = stated.beside(dict.fromkeys(QUANTITIES, 0.03), {"a": (0.005, 0.05), "b": (None, 0.04)})
    assert beside.parts["total"] == dict.fromkeys(QUANTITIES, 0.03)
    assert beside.by_joint == {"a": (0.01, 0.05), "b": (0.01, 0.04)}
    assert beside.unmeasured == total


def test_runs_whose_errors_cannot_be_estimated_are_refused(run, tmp_path):
    small = run.system
    loaded = sj.load(sj.save(small, tmp_path / "small.npz"))
    (load,) = small.loads
    other = replace(small, loads=(replace(load, amplitude=sj.Harmonic(2e3, 300.0)),))
    for wrong, words in (
        (sj.integrate(small, initial=run.final, **CYCLE), "starts displaced"),
        (sj.integrate(small, save=sj.Save(points=False), **CYCLE), "no named points"),
        (replace(run, interrupted=True), "interrupted"),
        (sj.integrate(loaded, **CYCLE), "loaded from a file"),
        (sj.integrate(other, **CYCLE), "are not those of the full"),
    ):
        with pytest.raises(sj.InputError, match=words):
            sj.estimate(wrong)


def test_the_condensed_model_errs_by_less_than_a_thousandth(plate, run):
    reference = CondensedReference.of(plate)
    own = results(reference.run(run.plan, verification_run))
    apart = difference(results(verification_run(plate, run.plan)), own)
    assert max(apart.values()) < 1e-3
