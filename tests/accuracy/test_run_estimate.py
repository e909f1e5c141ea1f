"""Errors of a run as `estimate` takes it: models changed by hand, joints of different laws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

import skfem_joint as sj
from skfem_joint.accuracy.against_coulomb import SETTLED, against_coulomb

STEPS = {"cycles": 5, "steps_per_cycle": 80}


def bar(*betas: float) -> sj.System:
    """Bar pressed on a base in one joint or two, of one law each."""
    segments = [("joint", 0.2, 10), ("arm", 0.2, 10), ("second", 0.1, 5), ("tip", 0.2, 10)]
    joints = [
        sj.Joint(name, pressure=pressure, friction=0.6, beta=beta)
        for name, pressure, beta in zip(("joint", "second"), (8e6, 4e6), betas, strict=False)
    ]
    structure = sj.Structure(
        sj.build_bar(segments, {"fixed": 0.0, "free_end": 0.7}),
        sj.Material(E=200e9, density=8000.0),
        width=0.05,
        thickness=0.01,
        fixed=["fixed"],
        joints=joints,
        stiffness_damping=1e-5,
    )
    return structure.system([sj.Load("free_end", sj.Harmonic(20e3, 300.0))])


def test_a_condensed_model_states_the_error_of_a_softer_law():
    system = bar(np.inf)
    softer = sj.integrate(sj.condense(system).with_beta(1e3), **STEPS)
    true = sj.compare(sj.integrate(system, **STEPS), softer).friction_energy_per_cycle
    errors = sj.estimate(softer)
    assert true > 0.3
    for source in ("law", "total"):
        assert 0.5 < errors.of(source, "friction_energy") / true < 3.0


@pytest.mark.parametrize("make", [lambda system: system, sj.condense, sj.reduce])
def test_joints_of_different_laws_are_compared_with_coulombs(make):
    system = bar(1e2, np.inf)
    errors = sj.estimate(sj.integrate(make(system), **STEPS))
    true = sj.compare(
        sj.integrate(system.with_beta(np.inf), **STEPS), sj.integrate(system, **STEPS)
    ).friction_energy_per_cycle
    assert errors.of("coulomb", "friction_energy") == pytest.approx(true, rel=0.2)


def test_a_reduced_model_makes_no_law_steeper():
    system = bar(10.0, np.inf)
    reduced = sj.reduce(system, friction_points="all", beta=1e4)
    assert set(reduced.contact.beta) == {10.0, 1e4}


def test_laws_are_compared_until_the_cycles_of_both_are_alike():
    """A lightly damped bar builds up for longer under Coulomb's law than under the own one."""
    made = bar(1e2)
    lightly = replace(made, C=1e-2 * made.C)
    frequency = sj.natural_modes(lightly, 1).frequencies[0]
    load = replace(lightly.loads[0], amplitude=sj.Harmonic(3e3, frequency))
    system = replace(lightly, loads=(load,))
    laws = (system, system.with_beta(np.inf))
    run, coulomb = (sj.integrate(law, cycles=40, steps_per_cycle=60) for law in laws)
    true = run.cycles.friction[-1] / coulomb.cycles.friction[-1] - 1.0
    stated = against_coulomb(system, run, run.plan)["friction_energy"]
    assert true > 1.0
    assert stated == pytest.approx(true, rel=SETTLED)


@pytest.mark.parametrize("changed", ["C", "K"])
@pytest.mark.parametrize("make", [sj.condense, sj.reduce])
def test_a_model_whose_matrices_were_changed_is_refused(make, changed):
    small = make(bar(1e3))
    other = replace(small, **{changed: 1.5 * getattr(small, changed)})
    run = sj.integrate(other, **STEPS)
    with pytest.raises(sj.InputError, match="matrices"):
        sj.estimate(run)


def test_points_that_share_an_unknown_are_compared_with_a_steep_law():
    # No set-valued law can be followed there, so that a steep one stands for it.
    pull = sj.AppliedLoad(np.ones(1), sj.Harmonic(3.0, 0.5), "mass")

    def stated(w, of):
        one, rows = of(np.ones((1, 1))), of(np.ones((len(w), 1)))
        given = one, 0.1 * one, 40.0 * one, sj.Contact(rows, w, 20.0), (pull,), one, ("mass",)
        run = sj.integrate(sj.System(*given), cycles=3, steps_per_cycle=100)
        return sj.estimate(run).of("coulomb", "friction_energy")

    two = stated([0.5, 1.0], csr_array)
    assert two == pytest.approx(stated([0.5, 1.0], np.array), rel=1e-6)
    assert two == pytest.approx(stated([1.5], csr_array), rel=0.05)


def test_a_dense_model_of_contact_apart_at_rest_is_compared_with_a_steep_law():
    # Nothing is pressed before it is closed: no friction limit at rest says what carries friction.
    eye = np.eye(2)
    apart = sj.NormalPart(eye[1:], np.array([0.01]), np.zeros(1), np.array([1e3]), np.ones(1))
    contact = sj.Contact(eye[:1], [0.0], 20.0, normal=apart, gain=csr_array([[0.3]]))
    push = sj.AppliedLoad(np.array([1.0, 2.0]), sj.Harmonic(2.0, 0.5), "mass")
    matrices = eye, 0.1 * eye, 20.0 * eye
    system = sj.System(*matrices, contact, loads=(push,), P=eye, points=("x", "y"))
    run = sj.integrate(system, cycles=3, steps_per_cycle=100)
    assert run.friction_work[0] > 0.0
    stated = sj.estimate(run).of("coulomb", "friction_energy")
    steep = sj.integrate(system.with_beta(2e4), cycles=3, steps_per_cycle=100)
    true = sj.compare(steep, run).friction_energy_per_cycle
    assert stated == pytest.approx(abs(true), rel=1e-6)
