"""Contact points that open and slip alike are merged: friction and pressure points together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from opening_blocks import block, loads
from scipy import sparse

import skfem_joint as sj
from skfem_joint.reduction.friction_points import merged_points
from skfem_joint.results.contact_history import normal_forces
from skfem_joint.results.history import difference, results

EXAMPLES = Path(__file__).parents[2] / "examples"
TIMING = {"cycles": 1, "steps_per_cycle": 100}


@pytest.fixture(scope="module")
def model():
    """Reduced model with all points, and its run."""
    small = sj.reduce(block(elements=24).system(loads(up=150e3)), modes=8, friction_points="all")
    return small, sj.integrate(small, **TIMING, save=sj.Save(fields=True))


def _merged(small, run, count):
    return merged_points(small, run.v, np.flatnonzero(small.contact.rubs), count, run.u)


def _apart(small, gaps):
    """The same model with pressure points that are apart at rest by ``gaps``, (q,), m."""
    normal = small.contact.normal
    force = np.where(gaps > 0.0, 0.0, normal.force)
    return small.with_contact(normal=replace(normal, gap=gaps, force=force))


def _halved(small):
    """The same model with each contact point as two of half its size at the same place."""
    contact, normal = small.contact, small.contact.normal
    m, pair, q = contact.given.size, np.ones((2, 1)), normal.gap.size
    twice, pressed = (sparse.kron(sparse.eye_array(k), pair, format="csr") for k in (m, q))
    values = ("force", "area", "stiffness")
    halves = {name: 0.5 * (pressed @ getattr(normal, name)) for name in values}
    return small.with_contact(
        B=twice @ contact.B,
        given=0.5 * (twice @ contact.given),
        beta=twice @ contact.beta,
        directions=np.ones(2 * m, dtype=int),
        J=contact.J @ twice.T,
        stiffness=None,
        shares=None,
        normal=replace(normal, N=pressed @ normal.N, gap=pressed @ normal.gap, **halves),
        gain=sparse.csr_array(sparse.kron(contact.gain, np.eye(2))),
    )


def test_closed_points_have_the_forces_and_limits_of_their_parts_together(model):
    small, run = model
    few, normal = _merged(small, run, 7), small.contact.normal
    sizes = few.contact.w.size, few.contact.normal.gap.size
    assert sizes == (6, 7)  # a point at a support does not slip
    u = np.random.default_rng(0).normal(size=(5, small.n))
    u[0] = 0.0
    pressed_in = normal.force / normal.stiffness
    u *= 0.5 / np.abs((normal.N @ u.T).T / pressed_in).max()
    every, merged = (system.contact.normal.elastic_forces(u) for system in (small, few))
    assert every.min() > 0.0
    members = (few.contact.normal.shares > 0.0).astype(float)
    np.testing.assert_allclose(merged, (members @ every.T).T, rtol=1e-9)
    np.testing.assert_allclose(few.contact.normal.area, members @ normal.area, rtol=1e-12)
    limits = small.contact.limits(every.T), few.contact.limits(merged.T)
    np.testing.assert_allclose(limits[1], (few.contact.shares > 0.0) @ limits[0], rtol=1e-9)


def test_points_that_are_alike_are_merged_without_an_error(model):
    small, run = model
    one = sj.integrate(replace(small, origin=None), **TIMING)
    few = _merged(_halved(small), run, small.contact.normal.gap.size)
    assert (few.contact.w.size, few.contact.normal.gap.size) == (
        small.contact.w.size,
        small.contact.normal.gap.size,
    )
    other = sj.integrate(few, **TIMING)
    np.testing.assert_allclose(other.point_u, one.point_u, atol=1e-9 * one.peak.max())
    assert other.friction_work.sum() == pytest.approx(one.friction_work.sum(), rel=1e-8)
    assert other.normal_force_peak.max() == pytest.approx(one.normal_force_peak.max(), rel=1e-8)


def test_merged_points_create_no_energy(model):
    """Released while a part of it is lifted off, the structure loses energy in every step."""
    small, run = model
    few = replace(_merged(small, run, 7), loads=())
    free = sj.integrate(
        few, duration=1e-4, step=5e-7, initial=(run.u[25], run.v[25]),
        scheme=sj.generalized_alpha(0.0), save=sj.Save(fields=True),
    )  # fmt: skip
    energy = np.array([few.stored_energy(*state) for state in zip(free.u, free.v, strict=True)])
    assert free.normal_force.min() == 0.0
    assert np.diff(energy).max() < 0.0
    assert energy[-1] < 0.5 * energy[0]
    lost = free.friction_work.sum() + free.viscous_work + free.scheme_work
    assert energy[0] - energy[-1] == pytest.approx(lost, rel=1e-9)
    assert free.friction_work.min() > 0.0


def test_points_apart_at_rest_stay_alone_or_are_left_out(model):
    small, run = model
    reach = (small.contact.normal.N @ run.u.T).max(axis=1)
    gaps = np.zeros(reach.size)
    near, far = np.argsort(reach)[[-1, -2]], np.argsort(reach)[[0, 1]]
    gaps[near], gaps[far] = 0.9 * reach[near], 2.0 * np.abs(reach[far]) + 1e-6
    few = _merged(_apart(small, gaps), run, 8)
    members = few.contact.normal.shares.toarray() > 0.0
    assert not members[:, far].any()
    assert np.all(members[members[:, near].any(axis=1)].sum(axis=1) == 1)
    assert sorted(few.contact.normal.gap[few.contact.normal.gap > 0.0]) == pytest.approx(
        sorted(gaps[near])
    )
    pressed = np.flatnonzero(gaps == 0.0)
    assert np.array_equal(np.flatnonzero(members.any(axis=0)), np.union1d(pressed, near))


def test_pressures_of_all_points_follow_from_the_motion_of_a_merged_model(model):
    small, run = model
    structure = block(elements=24)
    np.testing.assert_allclose(normal_forces(structure, run), run.normal_force, rtol=1e-12)
    few = sj.integrate(_merged(small, run, 12), **TIMING, save=sj.Save(fields=True))
    forces = normal_forces(structure, few)
    assert forces.shape == run.normal_force.shape
    assert few.normal_force.shape[1] == 12
    away = np.linalg.norm(forces - run.normal_force) / np.linalg.norm(run.normal_force)
    assert away < 0.02


def test_a_saved_model_runs_to_the_same_bits(model, tmp_path):
    few = replace(_merged(*model, 7), origin=None)
    again = sj.load(sj.save(few, tmp_path / "few.npz"))
    assert np.array_equal(
        again.contact.normal.shares.toarray(), few.contact.normal.shares.toarray()
    )
    runs = [sj.integrate(system, **TIMING) for system in (few, again)]
    assert np.array_equal(runs[0].point_u, runs[1].point_u)


def test_few_points_give_history_and_energy_of_all(model):
    small, run = model
    system = small.origin.system
    auto = sj.reduce(system, modes=8)
    assert auto.contact.w.size == small.contact.w.size  # fewer than three for each unknown
    errors = []
    for count in (4, 12):
        few = sj.reduce(system, modes=8, friction_points=count)
        errors.append(difference(results(run), results(sj.integrate(few, **TIMING))))
        assert few.contact.normal.gap.size == count
    assert errors[1]["displacement_rms"] < 0.005
    assert errors[1]["friction_energy"] < 0.02
    assert errors[0]["displacement_rms"] > 2.0 * errors[1]["displacement_rms"]


@pytest.mark.slow
def test_two_bolted_solid_plates_are_those_of_all_points():
    """The shipped plates, bent at 60 % of what makes them slip as a whole."""
    structure = sj.load_scene(EXAMPLES / "solid_lap_joint.toml").structure()
    joints = [replace(joint, contact="unilateral") for joint in structure.joints]
    load = sj.Load("lower_end", sj.Harmonic(423.0, 40.0), (0.0, 0.0, 1.0))
    system = replace(structure, joints=joints, fixed_y=[], fixed_z=[]).system([load])
    small = sj.reduce(system, modes=30)
    every = sj.reduce(system, modes=30, friction_points="all")
    points = small.contact.w.size
    assert points == small.contact.normal.gap.size <= 6 * small.n < every.contact.w.size // 2
    whole, run = (sj.integrate(one, cycles=2, steps_per_cycle=60) for one in (every, small))
    assert difference(results(whole), results(run))["displacement_rms"] < 0.01
    np.testing.assert_allclose(run.cycles.friction, whole.cycles.friction, rtol=0.02)
