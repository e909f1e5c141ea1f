"""Runs with contact that opens: saved models, refusals, stuck and closed systems, springs."""

from dataclasses import replace

import numpy as np
import pytest
from opening_blocks import block, loads, opening_system

import skfem_joint as sj

SPRUNG = {"tangential_stiffness": 2e13}


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("area", -1.0, "area: must be finite and positive"),
        ("force", np.ones(2), "normal: force: found shape"),
        ("gap", np.nan, "normal: gap: must be"),
        ("stiffness", np.ones((2, 1)), "normal: stiffness: found shape"),
    ],
)
def test_damaged_contact_is_refused(name, value, problem):
    system = opening_system()
    normal = system.contact.normal
    value = value if np.ndim(value) else np.full(normal.gap.size, value)
    with pytest.raises(sj.InputError, match=problem):
        system.with_contact(normal=replace(normal, **{name: value}))


def test_gains_that_are_negative_are_refused():
    system = opening_system()
    with pytest.raises(sj.InputError, match="gain: must be finite and not negative"):
        system.with_contact(gain=-system.contact.gain)


@pytest.mark.parametrize("order", [1, 2])
def test_the_closed_system_is_that_of_constant_contact(order):
    """Where all of a base is pressed both have the same motions, and so the same frequencies."""
    opens = opening_system(order=order).closed()
    constant = block(order=order, contact="constant").system(loads())
    assert not opens.contact.opens
    assert opens.n == constant.n
    for joints in ("loose", "stuck"):
        a, b = (sj.natural_modes(s, 4, joints=joints).frequencies for s in (opens, constant))
        assert a == pytest.approx(b, rel=1e-9)
    assert opens.contact.w.sum() == pytest.approx(constant.contact.w.sum())


def test_damping_ratios_take_contact_as_closed():
    made = (
        replace(s, damping_ratio=0.01, stiffness_damping=0.0)
        for s in (block(), block(contact="constant"))
    )
    opens, constant = (structure.system(loads()) for structure in made)
    assert opens.notes == constant.notes


def test_slipping_shares_follow_the_present_limits():
    """All of what is pressed slips in gross slip, however little that is."""
    run = sj.integrate(opening_system(), cycles=4, steps_per_cycle=30, save=sj.Save(slips=True))
    shares = run.joint_slipping[:, 0]
    assert np.all((shares >= 0.0) & (shares <= 1.0 + 1e-12))
    assert shares.max() == pytest.approx(1.0)


def test_joints_without_pressure_at_rest_have_loops_and_slips():
    system = block(pressure=0.0, gap=1e-6).system(loads(up=-100e3, across=20e3))
    run = sj.integrate(system, cycles=1, steps_per_cycle=100, save=sj.Save(slips=True))
    assert run.normal_force_peak.max() > 0.0
    assert run.friction_work.sum() > 0.0
    assert run.joint_slip.max() > 0.0
    assert run.energy_residual < 1e-12


@pytest.mark.parametrize("across", [{}, {"normal_stiffness": 1e14}])
def test_springs_beside_contact_that_opens_are_alike_in_full_and_condensed_models(across):
    full = block(elements=5, **SPRUNG, **across).system(loads())
    condensed = sj.condense(full, 12)
    runs = [sj.quasi_static(system, cycles=2, steps_per_cycle=40) for system in (full, condensed)]
    assert runs[0].cycles.friction[-1] == pytest.approx(runs[1].cycles.friction[-1], rel=1e-6)
    assert runs[0].slider_peak == pytest.approx(
        runs[1].slider_peak @ condensed.contact.shares, rel=1e-6
    )
    hammered = block(elements=5, **SPRUNG, **across).system(loads(up=230e3))
    run = sj.integrate(hammered, cycles=2, steps_per_cycle=100)
    assert run.opened.any()
    assert run.energy_residual < 1e-9


@pytest.mark.parametrize("beta", [np.inf, 100.0])
@pytest.mark.parametrize("solve", [sj.quasi_static, sj.integrate])
def test_springs_are_alike_in_a_reduced_model_with_a_full_basis(solve, beta):
    joint = SPRUNG | {"beta": beta, "normal_stiffness": 1e14}
    full = block(elements=4, **joint).system(loads(up=190e3))
    basis = np.linalg.qr(np.random.default_rng(3).normal(size=(full.n, full.n)))[0]
    runs = [solve(s, cycles=2, steps_per_cycle=60) for s in (full, full.project(basis))]
    whole, small = runs
    assert small.normal_force_least.min() < 0.2 * small.normal_force_peak.max()
    assert small.energy_residual < 1e-8
    assert small.friction_work == pytest.approx(whole.friction_work, rel=1e-6)
    for name in ("peak", "slip_peak", "slider_peak", "normal_force_peak"):
        value = getattr(whole, name)
        assert getattr(small, name) == pytest.approx(value, abs=1e-7 * value.max()), name
