"""Reduced models with contact that opens: elastic contact, modes of its path, stated errors."""

from dataclasses import replace

import numpy as np
import pytest
from opening_blocks import block, loads

import skfem_joint as sj
from skfem_joint.reduction.elastic_contact import elastic, strain_norm
from skfem_joint.reduction.excitation import Excitation
from skfem_joint.reduction.interface_modes import driven
from skfem_joint.results.history import QUANTITIES, difference, results
from skfem_joint.slow.quasi_static import HELD, QuasiStatic
from skfem_joint.stepping.plan import Plan

TIMING = {"cycles": 1, "steps_per_cycle": 100}


def _system(elements=5, **joint):
    return block(elements=elements, **joint).system(loads(up=150e3))


def test_stiffness_is_by_area_and_a_given_one_stays():
    contact = elastic(_system(elements=4)).contact.normal
    own = contact.stiffness / contact.area
    np.testing.assert_allclose(own, own[0], rtol=1e-12)
    given = _system(elements=4, normal_stiffness=1e13)
    assert np.array_equal(elastic(given).contact.normal.stiffness, given.contact.normal.stiffness)
    assert not elastic(block().system(loads()).closed()).contact.opens
    # In proportion to the stiffness of the structure.
    softer = replace(block(elements=4), material=sj.Material(1e11, 8000.0, 0.3))
    other = elastic(softer.system(loads())).contact.normal
    np.testing.assert_allclose(2.0 * other.stiffness, contact.stiffness, rtol=1e-12)


def test_the_norm_has_the_energy_of_elastic_contact():
    system = elastic(_system())
    u = np.random.default_rng(0).normal(size=system.n) * 1e-6
    contact = system.contact.normal
    assert np.all(contact.force > 0.0)
    pressed = 0.5 * contact.stiffness @ (contact.N @ u) ** 2
    whole = 0.5 * u @ (strain_norm(system) @ u)
    assert whole == pytest.approx(0.5 * u @ (system.K @ u) + pressed, rel=1e-6)


def test_forces_beyond_what_is_held_are_followed_as_far_as_they_are():
    """Lifted by twice what presses it, the block is left with up to 1/16 of its normal force."""
    system = elastic(_system(elements=3))
    contact, up = system.contact.normal, system.load_vectors()[:, 0]  # a force of 1 N
    pressed = contact.force.sum()
    path = QuasiStatic(system, 1e-9)
    states = path.follow(np.array([[0.5], [2.0], [0.5]]) * up * pressed)
    left = np.array([contact.elastic_forces(u).sum() for u in states]) / pressed
    np.testing.assert_allclose(left[[0, 2]], 0.5, atol=1e-3)
    assert 0.0 < left[1] <= 2.0 / 2**HELD
    assert path.scaled_back == 1


def test_errors_fall_with_modes_and_are_stated():
    system = _system(elements=8)
    whole = sj.integrate(elastic(system), **TIMING)
    finer = {"cycles": 1, "steps_per_cycle": 8 * TIMING["steps_per_cycle"]}
    truth = results(sj.integrate(sj.condense(system), **finer, save=sj.Save(every=8)))
    errors = []
    for modes in (2, 8, 20):
        small = sj.reduce(system, modes=modes)
        assert small.n < 25
        run = sj.integrate(small, **TIMING)
        assert run.energy_residual < 1e-8
        errors.append(np.abs(run.point_u - whole.point_u).max() / whole.peak.max())
        stated = sj.estimate(run)
        true = difference(truth, results(run))
        for name in ("displacement_rms", "friction_energy"):
            if true[name] > 3e-3:
                assert stated.of("total", name) > 0.5 * true[name], (modes, name)
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]
    assert errors[2] < 0.01


def test_slow_cycles_agree_with_the_condensed_model_within_their_stated_errors():
    """Coulomb's law of sticking points that creep by 1e-5 of the slips, without inertia."""
    system = _system(elements=8)
    slow = {"cycles": 2, "steps_per_cycle": 40}
    whole = sj.quasi_static(sj.condense(system), **slow)
    elastically = sj.quasi_static(elastic(system), **slow)
    away = []
    for modes in (4, 20):
        run = sj.quasi_static(sj.reduce(system, modes=modes, quasi_static=True), **slow)
        assert run.energy_residual < 1e-8
        stated, true = sj.estimate(run), difference(results(whole), results(run))
        for name in QUANTITIES:
            if true[name] > 3e-3:  # both by the same steps
                assert stated.of("basis", name) == pytest.approx(true[name], rel=0.2), name
                assert 0.5 * true[name] < stated.of("total", name), name
        away.append(difference(results(elastically), results(run))["friction_energy"])
    assert away[0] > 3.0 * away[1]
    assert away[1] < 0.01


@pytest.mark.parametrize("lift", [1.0, 1.5])
def test_a_slow_load_that_lifts_a_body_off_ends_the_run_of_a_reduced_model_too(lift):
    """What presses the block is 200 kN; a slow load that lifts by more has no level."""
    system = block(elements=4).system(loads(up=lift * 185e3, across=0.0))
    small = sj.reduce(system, modes=6, quasi_static=True)
    if lift == 1.0:
        run = sj.quasi_static(small, cycles=1, steps_per_cycle=40, save=sj.Save(fields=True))
        assert run.normal_force.sum(axis=1).min() == pytest.approx(15e3, rel=1e-3)
        return
    with pytest.raises(sj.ConvergenceError, match="there is no level at"):
        sj.quasi_static(small, cycles=1, steps_per_cycle=40)


def test_energy_that_steps_alone_give_raises_and_shorter_ones_have_the_motion():
    """40 cycles on a shaken base, beyond the level of the modes: loads put in 0.2 J, steps 6e6."""
    weak, strong = (
        block(elements=5).system([sj.Load(base="x", amplitude=sj.Harmonic(a, 300.0))])
        for a in (1e5, 5e5)
    )
    made, peaks = sj.reduce(weak, modes=10, duration=2 / 300.0, step=1 / 60e3), []
    push = replace(made.loads[0], amplitude=strong.loads[0].amplitude)
    small = replace(made, loads=(push,))
    for steps in (120, 240):
        run = sj.integrate(small, cycles=40, steps_per_cycle=steps)
        assert abs(run.scheme_work) < 0.01 * run.input_work.sum()
        peaks.append(run.peak)
    np.testing.assert_allclose(*peaks, rtol=2e-3)
    with pytest.raises(sj.ConvergenceError, match=r"the time steps added .* shorter step"):
        sj.integrate(small, cycles=40, steps_per_cycle=60)


def test_modes_of_a_run_are_refused():
    system = _system(elements=3)
    run = sj.integrate(system, **TIMING, save=sj.Save(fields=True))
    with pytest.raises(sj.InputError, match="must be 'static' with contact that opens"):
        sj.reduce(system, run=run)


def test_fixed_interface_modes_are_those_of_contact_that_stays_closed():
    system = elastic(_system(elements=4))
    plan = Plan(1.0 / 2000.0 / 100, 100)
    response = np.linalg.solve(system.K.toarray() + np.eye(system.n), system.load_vectors())
    shapes, _ = driven(system, response, Excitation.of(system, plan), 6)
    closed = system.K + system.contact.normal.springs
    found = np.einsum("ij,ij->j", shapes, closed @ shapes)
    found /= np.einsum("ij,ij->j", shapes, system.M @ shapes)
    known = sj.natural_modes(system, 15, joints="stuck").frequencies
    off = np.abs(np.sqrt(found) / (2.0 * np.pi) - known[:, np.newaxis]).min(axis=0)
    assert shapes.shape[1] >= 3
    assert off.max() < 1e-6 * known[0]
