"""Natural frequencies against closed forms, with joints loose and stuck."""

from dataclasses import replace

import numpy as np
import pytest

import skfem_joint as sj
from skfem_joint.steady.steady import unstrained

LENGTH, SPEED = 1.0, 5000.0  # m, m/s
STEEL = sj.Material(E=200e9, density=8000.0)


def bar(fixed=(), joints=()):
    """A bar of one metre, the first half of which may be pressed on a base."""
    strips = [("joint", 0.5, 100), ("arm", 0.5, 100)]
    mesh = sj.build_bar(strips, {"wall": 0.0, "middle": 0.5, "tip": LENGTH})
    size = {"width": 0.01, "thickness": 0.01}
    return sj.Structure(mesh, STEEL, fixed=fixed, joints=joints, free=True, **size).system()


def test_a_bar_has_the_frequencies_of_the_closed_form():
    held, free = (sj.natural_modes(bar(fixed), 4) for fixed in (["wall"], []))
    k = np.arange(4)
    np.testing.assert_allclose(held.frequencies, (2 * k + 1) * SPEED / 4.0, rtol=1e-3)
    np.testing.assert_allclose(free.frequencies, k * SPEED / 2.0, rtol=1e-3)
    assert (held.rigid_motions, free.rigid_motions) == (0, 1)
    assert free.straining.modes.shape[1] == 3


@pytest.mark.parametrize("make", [lambda system: system, sj.condense])
def test_modes_are_orthonormal_by_mass_and_stuck_joints_hold_what_they_touch(make):
    """Its pressed half stuck, the bar is one of half the length that is held at its end."""
    system = make(bar(joints=[sj.Joint("joint", 1e6, 0.5)]))
    for joints in ("loose", "stuck"):
        found = sj.natural_modes(system, 5, joints=joints)
        gram = found.modes.T @ (system.M @ found.modes)
        np.testing.assert_allclose(gram, np.eye(5), atol=1e-9)
        squares = np.diag(found.modes.T @ (system.K @ found.modes))
        omega = 2.0 * np.pi * found.frequencies
        np.testing.assert_allclose(squares, omega**2, rtol=1e-6, atol=1.0)
    assert np.abs(system.contact.B @ found.modes).max() < 1e-9 * np.abs(found.modes).max()
    assert found.frequencies[0] == pytest.approx(SPEED / (4.0 * 0.5), rel=1e-3)


def test_nothing_is_left_where_everything_sticks_and_words_are_checked():
    mesh = sj.build_bar([("joint", 0.5, 4)], {"tip": 0.5})
    joints = [sj.Joint("joint", 1e6, 0.5)]
    whole = sj.Structure(mesh, STEEL, width=0.01, thickness=0.01, joints=joints).system()
    assert sj.natural_modes(whole, joints="stuck").frequencies.size == 0
    with pytest.raises(sj.InputError, match="joints: found 'glued'"):
        sj.natural_modes(whole, joints="glued")
    with pytest.raises(sj.InputError, match="count"):
        sj.natural_modes(whole, 0)


@pytest.mark.parametrize("contact", ["constant", "unilateral"])
def test_condensation_leaves_rigid_motions_rigid(contact):
    """A box on another one floats in three ways on its face, and held by weak springs in none."""
    sides = [{"wall": "left", "face": ("back", "lower_lap")}, {"foot": ("front", "upper_lap")}]
    sides[1] |= {"tip": "right"}
    arms = [("lower_arm", 0.1, 4), ("lower_lap", 0.05, 4), ("upper_lap", 0.05, 3)]
    boxes = [
        sj.build_box(strips, (0.02, 0.005), (2, 1), origin=origin, boundaries=own)
        for strips, origin, own in (
            (arms[:2], (0.0, 0.0, 0.0), sides[0]),
            ([arms[2], ("upper_arm", 0.1, 4)], (0.1, 0.0, 0.005), sides[1]),
        )
    ]
    joint = sj.Joint("foot", 3e6, 0.3, against="face", contact=contact)
    steel = sj.Material(200e9, 8000.0, 0.3)
    made = sj.Structure(sj.merged(boxes), steel, fixed=["wall"], joints=[joint])
    small = sj.condense(made.system([sj.Load("tip", sj.Harmonic(1.0, 100.0), (1.0, 0.0, 0.0))]))
    assert sj.natural_modes(small, 8).rigid_motions == 3
    assert unstrained(small).shape[1] == 3
    K = small.K + 1e-9 * small.K.diagonal().max() * np.eye(small.n)
    assert sj.natural_modes(replace(small, K=K), 8).rigid_motions == 0
