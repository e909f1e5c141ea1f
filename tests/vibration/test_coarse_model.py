"""Reduced models that lead the responses of larger ones; SI units."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import pressed, structure
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.vibration.coarse_model import CoarseModel
from skfem_joint.vibration.response import response, steady_point

FIRST = 1062.0  # Hz, the first resonance if all sticks


def plate(free: int = 50) -> sj.System:
    """A plate that bends in its plane, of more unknowns than Newton's method takes by itself.

    A fifth to a quarter of its friction limit slips.
    """
    mesh = sj.build_plate([("joint", 0.1, 6), ("free", 0.2, free)], 0.05, 2)
    plain = {"stiffness_damping": 1e-6, "incompatible": False}  # elements of which FIRST is
    made = structure(mesh, [pressed(pressure=8e6, friction=0.5)], **plain)
    return made.system([sj.Load("right", sj.Harmonic(1e3, FIRST), (1.0, 0.2))])


def test_the_vibration_is_the_same_and_found_in_fewer_periods():
    system = plate()
    coarse = CoarseModel.of(system, FIRST, 1.0, None)
    assert coarse is not None
    led, plain = [], []
    for frequency in (0.95 * FIRST, FIRST):
        guide = coarse.guide(frequency, 1.0, 100, None)
        start = (led[-1].state, plain[-1].state) if led else (None, None)
        led.append(steady_point(system, frequency, 1.0, 100, start[0], correction=guide.correction))
        plain.append(steady_point(system, frequency, 1.0, 100, start[1]))
        np.testing.assert_allclose(led[-1].amplitude, plain[-1].amplitude, rtol=1e-4)
        assert led[-1].friction_energy == pytest.approx(plain[-1].friction_energy, rel=1e-3)
    assert sum(p.periods for p in led) < 0.75 * sum(p.periods for p in plain)


def test_the_error_of_the_step_is_that_of_the_larger_model():
    system = plate()
    coarse = CoarseModel.of(system, FIRST, 1.0, None)
    f, own = np.array([0.95 * FIRST, FIRST]), {"steps_per_cycle": 40, "refined": False}
    (led,) = response(system, f, (1.0,), coarse=coarse, **own)
    (plain,) = response(system, f, (1.0,), **own)
    assert led.column("step_error") == pytest.approx(plain.column("step_error"), rel=0.5)
    far = replace(coarse, system=replace(coarse.system, P=1.2 * coarse.system.P))
    (other,) = response(system, f, (1.0,), coarse=far, **own)
    np.testing.assert_allclose(other.column("step_error"), plain.column("step_error"), rtol=1e-2)


def test_chains_small_systems_and_loads_that_are_not_odd_need_none():
    system = plate()
    two = sj.MultiHarmonic((sj.Harmonic(1e3, FIRST), sj.Harmonic(1e2, 2.0 * FIRST)))
    uneven = replace(system, loads=(replace(system.loads[0], amplitude=two),))
    bar = arm(sj.Harmonic(1e4, 1000.0), elements=(200, 200))
    for none in (uneven, bar, plate(free=6)):
        assert CoarseModel.of(none, FIRST, 1.0, None) is None


def test_in_a_basis_of_all_unknowns_it_is_that_of_the_full_model():
    system = plate()
    basis = np.random.default_rng(0).normal(size=(system.n, system.n))
    one, other = (CoarseModel.of(system, FIRST, 1.0, V) for V in (None, basis))
    np.testing.assert_allclose(basis @ other.up, one.up, atol=1e-8 * np.abs(one.up).max())
    down = one.down @ basis
    np.testing.assert_allclose(other.down, down, atol=1e-8 * np.abs(down).max())
