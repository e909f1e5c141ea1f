"""Friction with springs in series: closed forms, other solvers, limits and conservation."""

from dataclasses import replace
from itertools import permutations
from math import inf
from typing import Any

import numpy as np
import pytest
from stepping_systems import not_a_chain

import skfem_joint as sj
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.arrangement import arranged

LIMIT, SPRING, HELD = 30.0, 2e5, 1e12


def bar(stiffness: float, beta: float = inf, n: int = 24, **changes: Any) -> sj.System:
    """Bar on a rigid base, with free length beyond it."""
    values = {"width": 0.05, "thickness": 0.01, "fixed": ["fixed"], "stiffness_damping": 1e-6}
    structure = sj.Structure(
        sj.build_bar([("joint", 0.25, n), ("free", 0.3, 12)], {"fixed": 0.0, "end": 0.55}),
        sj.Material(E=200e9, density=8000.0),
        joints=[sj.Joint("joint", 8e6, 0.7, beta=beta, tangential_stiffness=stiffness)],
        **(values | changes),
    )
    return structure.system([sj.Load("end", sj.Harmonic(23e3, 1000.0))])


def test_a_cycle_of_a_jenkins_point_loses_four_times_limit_times_slip():
    force, stiffness = 200.0, 1e5
    contact = sj.point_friction([1.0], LIMIT, stiffness=SPRING)
    load = {"x": (0, sj.Harmonic(force, 1.0))}
    system = sj.System.from_matrices([[1e-3]], [[stiffness]], [[5.0]], contact=contact, loads=load)
    run = sj.integrate(system, cycles=3, steps_per_cycle=2000)
    amplitude = run.cycles.peak[-1, 0]
    expected = 4.0 * LIMIT * (amplitude - LIMIT / SPRING)
    assert run.cycles.friction[-1] == pytest.approx(expected, rel=2e-5)
    assert amplitude == pytest.approx((force - LIMIT) / stiffness, rel=1e-3)


@pytest.mark.parametrize("n", [100, 400])
def test_a_point_on_a_circle_loses_what_its_slider_does(n):
    """The slider goes round a polygon; the force at the end of a step is along its side.

    With many sides the spring is perpendicular to the radius of the slider's circle.
    """
    radius, stretch = 4e-4, LIMIT / SPRING
    turn = 2.0 * np.pi * np.arange(4 * n + 1) / n
    circle = radius * np.column_stack([np.cos(turn), np.sin(turn)]) - [radius, 0.0]
    contact = sj.point_friction(np.eye(2), LIMIT, stiffness=SPRING)
    system = sj.System.from_matrices(np.eye(2), HELD * np.eye(2), contact=contact)
    path = QuasiStatic(system, 1e-13)
    u, force = path.follow(HELD * circle, limit_share=np.inf), path.frictions
    np.testing.assert_allclose(np.linalg.norm(force[n:], axis=1), LIMIT, rtol=1e-9)
    slider = u - force / SPRING
    work = 0.5 * ((force[1:] + force[:-1]) * np.diff(slider, axis=0)).sum(axis=1)[-n:].sum()
    half = np.pi / n
    lag = stretch * np.sin(half)
    own = np.sqrt(radius**2 - stretch**2 + lag**2) - lag
    expected = n * LIMIT * 2.0 * own * np.sin(half) * 0.5 * (1.0 + np.cos(2.0 * half))
    assert work == pytest.approx(expected, rel=1e-6)
    limit = 2.0 * np.pi * LIMIT * np.sqrt(radius**2 - stretch**2)
    assert expected == pytest.approx(limit, rel=1.5 / n)
    middle = slider[-n:].mean(axis=0)
    np.testing.assert_allclose(np.linalg.norm(slider[-n:] - middle, axis=1), own, rtol=1e-6)


@pytest.mark.parametrize("beta", [inf, 1e5])
@pytest.mark.parametrize("rho", [1.0, 0.7])
def test_energy_is_kept_and_all_methods_agree(rho, beta):
    system = bar(1e12, beta)
    ways = {
        "chain": system,
        "contact": not_a_chain(system),
        "dense": system.project(np.eye(system.n)),
    }
    runs = {}
    for kind, way in ways.items():
        assert arranged(way).kind == kind
        run = runs[kind] = sj.integrate(
            way, cycles=2, steps_per_cycle=100, scheme=sj.generalized_alpha(rho),
            save=sj.Save(fields=True),
        )  # fmt: skip
        same = runs["chain"]
        assert run.energy_residual < (1e-11 if kind == "contact" else 1e-12)
        assert np.all(run.friction_work >= -1e-15)
        np.testing.assert_allclose(run.point_u, same.point_u, atol=1e-10 * same.peak.max())
        assert run.friction_work.sum() == pytest.approx(same.friction_work.sum(), rel=1e-9)
        assert np.abs(run.sigma).max() <= 1.0 + 1e-12


def test_sliders_that_never_slide_are_springs():
    system = bar(1e12)
    system = system.with_contact(given=1e6 * system.contact.w)
    linear = replace(system.with_contact(given=0.0 * system.contact.w), K=system.stuck_stiffness)
    plan = {"cycles": 2, "steps_per_cycle": 100}
    run, springs = sj.integrate(system, **plan), sj.integrate(linear, **plan)
    np.testing.assert_allclose(run.point_u, springs.point_u, atol=1e-9 * run.peak.max())
    assert abs(run.friction_work.sum()) <= 1e-12 * run.input_work.sum()
    assert run.stored_energy[1] == pytest.approx(springs.stored_energy[1], rel=1e-9)


def test_a_point_that_loses_its_limit_lets_its_spring_go():
    """A later, lower limit cuts the force: as by the radial return."""
    contact = sj.point_friction([1.0], LIMIT, stiffness=SPRING)
    system = sj.System.from_matrices([[1.0]], [[HELD]], contact=contact)
    for share in (0.5, 0.0):
        lower = system.with_contact(given=share * system.contact.w)
        start = np.zeros(1), np.zeros(1), np.array([0.9])
        run = sj.integrate(lower, step=1e-6, n_steps=1, initial=start, save=sj.Save(fields=True))
        force = lower.contact.w * run.sigma[-1]
        assert np.all(np.abs(force) <= lower.contact.w)


@pytest.mark.parametrize("stiffness", [1e11, 1e12])
def test_steady_vibration_is_where_a_long_run_ends(stiffness):
    system = bar(stiffness, n=12)
    steady = sj.integrate(system, steps_per_cycle=100, until="steady")
    long = sj.integrate(system, cycles=120, steps_per_cycle=100)
    high = np.abs(np.ptp(long.point_u[-101:], axis=0)) / 2
    assert steady.steady.periods < 20
    assert steady.energy_residual < 1e-12
    assert steady.steady.amplitude == pytest.approx(high, rel=1e-5)
    assert steady.friction_work.sum() == pytest.approx(long.cycles.friction[-1], rel=1e-4)


@pytest.mark.parametrize("between", [False, True])
@pytest.mark.parametrize("stiffness", [(inf, 2e4, inf), (2e4, inf, 5e4), (2e4, 1e4, 3e4)])
def test_sliders_along_a_chain_do_not_depend_on_their_order(between, stiffness):
    """On masses and between them, sprung and rigid, for each order of joints and numbering.

    A load that jumps starts them anew.
    """
    n, places = 9, (2, 4, 7)
    k = 1e4 * (1.0 + np.arange(n) % 3)
    K = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    numberings = [np.arange(n), np.arange(n)[::-1], np.random.default_rng(0).permutation(n)]

    def works(order: Any, numbering: Any) -> Any:
        M, Q = np.diag(np.linspace(1.0, 2.0, n)), np.eye(n)[numbering]
        contact, end = None, Q @ np.eye(n)[-1]
        for joint in order:
            row = np.eye(n)[places[joint]] - between * np.eye(n)[places[joint] + between]
            limit, spring = 3.0 + joint, stiffness[joint]
            one = sj.point_friction(Q @ row, limit, name=str(joint), stiffness=spring)
            contact = one if contact is None else contact + one
        system = sj.System.from_matrices(
            Q @ M @ Q.T, Q @ K @ Q.T, stiffness_damping=1e-4, contact=contact,
            loads={"end": (end, sj.Harmonic(40.0, 11.0)), "jump": (end, sj.Rectangle(5.0, 0.1))},
        )  # fmt: skip
        run = sj.integrate(system, cycles=2, steps_per_cycle=50, tolerance=1e-13)
        assert run.energy_residual < 1e-10
        own = dict(zip(system.contact.joints, system.contact.J @ run.friction_work, strict=True))
        return [*(own[str(joint)] for joint in range(3)), run.peak_of("end")]

    first = works((0, 1, 2), numberings[0])
    for k, order in enumerate(permutations(range(3)), 1):
        np.testing.assert_allclose(works(order, numberings[k % 3]), first, rtol=1e-10)


def test_condensed_and_reduced_models_keep_springs():
    system = bar(1e12)
    plan = {"cycles": 3, "steps_per_cycle": 100}
    full = sj.integrate(system, **plan)
    condensed = sj.integrate(sj.condense(system), **plan)
    assert condensed.energy_residual < 1e-11
    assert condensed.friction_work.sum() == pytest.approx(full.friction_work.sum(), rel=1e-3)
    model = sj.reduce(system, modes=8, friction_points=10)
    assert model.contact.w.size <= 10
    assert model.contact.stiffness.sum() == pytest.approx(system.contact.stiffness.sum(), rel=1e-12)
    assert np.all(
        np.isinf(model.contact.beta)
    )  # sliders on springs need no law of finite steepness
    reduced = sj.integrate(model, **plan)
    assert reduced.energy_residual < 1e-12
    assert reduced.friction_work.sum() == pytest.approx(full.friction_work.sum(), rel=0.1)
    every = sj.integrate(sj.reduce(system, modes=10, friction_points="all"), **plan)
    assert every.friction_work.sum() == pytest.approx(full.friction_work.sum(), rel=0.01)


def test_sums_keep_springs():
    both = sj.point_friction([1.0, 0.0], 1.0) + sj.point_friction([0.0, 1.0], 1.0, stiffness=5.0)
    assert both.stiffness.tolist() == [inf, 5.0]


def test_stiffness_of_points_is_that_of_the_area():
    system = bar(1e12)
    held = 0.5 * 0.25 / 24  # of the node at the support
    assert system.contact.stiffness.sum() == pytest.approx(1e12 * 0.05 * (0.25 - held), rel=1e-12)


def test_stuck_joints_are_those_on_their_springs():
    system = bar(1e12)
    stuck = replace(system.with_contact(given=0.0 * system.contact.w), K=system.stuck_stiffness)
    expected = sj.natural_modes(stuck, 3).frequencies
    found = sj.natural_modes(system, 3, joints="stuck").frequencies
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    (curve,) = sj.backbone(system, levels=3)
    assert curve.stuck_frequency == pytest.approx(expected[0], rel=1e-9)
    assert curve.frequency[0] == pytest.approx(expected[0], rel=1e-3)
    assert curve.masing_error is not None
    assert curve.masing_error < 1e-9
    ring = sj.ring_down(system, curve, cycles=20, steps_per_cycle=100)
    assert ring.frequency[-1] == pytest.approx(expected[0], rel=1e-3)
    damped = bar(1e12, stiffness_damping=0.0).with_damping_ratio(0.01)
    assert f"{expected[0]:.5g} Hz" in damped.notes[-1]


@pytest.mark.parametrize("force", [1e-2, 1e-6])
def test_a_long_bar_on_soft_springs_moves_as_a_mass_under_a_small_force(force):
    """Friction could hold 70 kN, at which the springs would stretch by 700 m."""
    area, stiffness, n = 0.05 * 0.25, 100.0, 400
    held = bar(stiffness / area, n=n, fixed=[], free=True, stiffness_damping=0.0)
    mass = 8000.0 * 0.55 * 0.05 * 0.01
    omega = np.sqrt(stiffness / mass)
    load = sj.AppliedLoad(held.loads[0].vector, sj.Harmonic(force, omega / np.pi), "end")
    run = sj.integrate(replace(held, loads=(load,)), cycles=4, steps_per_cycle=200)
    sines = np.sin(2.0 * omega * run.times) - 2.0 * np.sin(omega * run.times)
    exact = -force / (3.0 * stiffness) * sines
    np.testing.assert_allclose(run.point("end"), exact, atol=2e-3 * np.abs(exact).max())
