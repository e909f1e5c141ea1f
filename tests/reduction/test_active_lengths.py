"""Active length and area of joints, measured from their largest slips."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import structure as structure_of
from reduced_joints import case, fig_18

import skfem_joint as sj
from skfem_joint.mesh import build_plate, named
from skfem_joint.reduction.active_length import (
    active_fractions,
    contact_parts,
    measured,
    measured_lengths,
)
from skfem_joint.reduction.scaled.reference import FORCE, FRICTION, PRESSURE, WIDTH, lap_joint


def test_measured_length_of_a_linear_decay():
    distance = np.linspace(0.0, 1.0, 11)
    peak = np.maximum(0.0, 2e-3 * (1.0 - distance / 0.75))
    for threshold in (0.02, 0.1, 0.5):
        # Exact while the last active element holds no kink: linear interpolation of a line.
        length = measured(distance, peak, threshold)
        if 0.75 * (1 - threshold) <= 0.7:
            assert length == pytest.approx(0.75 * (1.0 - threshold), rel=1e-12)
        else:
            assert 0.7 < length <= 0.8


def test_measured_length_at_its_ends():
    distance = np.linspace(0.0, 1.0, 5)
    assert measured(distance, np.ones(5)) == 1.0
    assert measured(distance, np.zeros(5)) == 0.0


def test_slow_joint_is_active_over_the_pseudo_static_slip_length():
    # Displacement falls with the square of the distance to the end of slip, so the threshold
    # cuts off its square root of the slip length, force over friction per length.
    structure = lap_joint(beta=np.inf, normal_force="consistent", elements=200)
    system = structure.system([sj.Load("free_end", sj.Harmonic(FORCE, 1.0))])
    run, patch = sj.integrate(system, cycles=4, steps_per_cycle=400), structure.patches[0]
    x = structure.nodes[patch.nodes, 0]
    order = np.argsort(-x)  # from the free end on
    distance = structure.nodes[:, 0].max() - x[order]
    length = measured(distance, run.slip_peak[patch.points][order], 1e-3)
    static = FORCE / (FRICTION * PRESSURE * WIDTH)
    assert length == pytest.approx(static * (1.0 - np.sqrt(1e-3)), rel=5e-3)


def test_active_area_counts_the_area_of_slipping_points():
    structure, system, _ = case("lap")
    patch = structure.patches[0]
    x = structure.nodes[patch.nodes, 0]
    peak = np.zeros(system.contact.w.size)
    assert active_fractions(structure, system, peak, 0.0) == ({"joint": 0.0}, {"joint": 0.0})
    peak[patch.points] = np.where(x > 0.125, 1e-4, 1e-8)
    # Nodes right of the middle: 19 whole columns and half a one, of 40.
    area, nodes = (part["joint"] for part in active_fractions(structure, system, peak, 0.0))
    assert area == pytest.approx(19.5 / 40.0, rel=1e-12)
    assert nodes == pytest.approx(20.0 / 41.0, rel=1e-12)
    peak[patch.points] = 1.0
    held = active_fractions(structure, system, peak, 0.0)[0]["joint"]
    assert held == pytest.approx(39.5 / 40.0, rel=1e-12)


def test_creep_of_points_that_stick_is_no_slip():
    """Under the arctan law a point at half of its limit creeps by period / beta."""
    _, system, _ = case("lap")
    period, beta = 1e-3, float(system.contact.beta[0])
    creep = np.full(system.contact.w.size, 0.9 * period / beta)
    assert not system.slipping(creep, period).any()
    assert system.slipping(creep).all()
    assert system.with_beta(np.inf).slipping(creep, period).all()


def test_each_ring_of_bolts_is_a_part_of_its_own():
    plan = build_plate([("one", 0.02, 2), ("gap", 0.06, 6), ("two", 0.02, 2)], 0.05, 3)
    joint = np.concatenate([plan.regions["one"], plan.regions["two"]])
    mesh = named(plan.mesh.with_subdomains({"joint": joint}))
    made = structure_of(mesh, [sj.Joint("joint", 8e6, 0.7, axis=(1.0, 0.0))])
    found = contact_parts(made.body, made.patches[0])
    assert [round(zone.length, 9) for zone in found] == [0.02, 0.02]


def test_profile_is_the_largest_slip_of_each_section_of_any_mesh():
    rng = np.random.default_rng(3)
    structure, system, _ = case("lap")
    mesh = structure.mesh.mesh
    inner = np.setdiff1d(np.arange(mesh.p.shape[1]), mesh.boundary_nodes())
    moved = mesh.p.copy()
    moved[:, inner] += rng.uniform(-1.5e-3, 1.5e-3, (2, inner.size))
    shaken = replace(structure, mesh=replace(structure.mesh, mesh=replace(mesh, doflocs=moved)))
    for s in (structure, shaken):
        (low,) = contact_parts(s.body, s.patches[0])
        zone = low.from_other_end()
        x = s.nodes[s.patches[0].nodes, 0]
        slip = np.zeros(system.contact.w.size)
        slip[s.patches[0].points] = np.maximum(x - 0.1, 0.0)  # alike across the axis
        distance, peak = zone.profile(slip)
        smooth = distance < 0.14
        np.testing.assert_allclose(peak[smooth], 0.15 - distance[smooth], atol=1e-12)
        assert zone.active_length(slip) == pytest.approx(0.15, abs=0.008)
        # Sections stick where all their points do: one row that slips keeps them moving.
        y = s.nodes[s.patches[0].nodes, 1]
        slip[s.patches[0].points] = np.where(y == 0.0, x, 0.0)
        assert zone.active_length(slip) > 0.23


def test_measured_lengths_are_taken_from_the_end_that_moves_most():
    structure, system = fig_18()
    patch = structure.patches[0]
    x = structure.nodes[patch.nodes, 0]
    for decay in (np.exp(-200.0 * (0.1 - x)), np.exp(-200.0 * x)):
        slip = np.zeros(system.contact.w.size)
        slip[patch.points] = decay
        expected = np.sort(decay)[::-1]
        length = measured(np.arange(100) * 1e-3, expected)
        assert measured_lengths(structure, slip) == {"joint": pytest.approx(length, rel=1e-9)}
    plain = replace(case("lap")[0].joints[0], axis=None)
    plate_joint = replace(case("lap")[0], joints=[plain])
    assert measured_lengths(plate_joint, np.ones(case("lap")[1].contact.w.size)) == {}
