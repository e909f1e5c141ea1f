"""Steps that are too long for a load are refused before anything is integrated."""

from __future__ import annotations

from math import inf, pi

import numpy as np
import pytest
from bars import DENSITY, E, LapJoint, oscillator

from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate
from skfem_joint.loads import HalfSine, Harmonic, Load, Rectangle, Triangle, Versine
from skfem_joint.recording import Save
from skfem_joint.resolution import check_resolution
from skfem_joint.schemes import generalized_alpha


@pytest.mark.parametrize(
    ("load", "step", "names"),
    [
        (Harmonic(1e3, 1000.0), 1e-3, "1/8 of its fastest period; use a step of at most 0.000125"),
        (Triangle(1e3, 1e-7, 1e-4), 1e-5, "rises in 1e-07 s; use a step of at most 5e-08"),
        (Harmonic(1e3, 0.1, pi / 2), 0.1, "it jumps"),
        (Rectangle(1e3, 1.0, 0.0), 0.1, "let the load rise in a ramp"),
    ],
)
def test_a_step_that_is_too_long_is_refused_with_the_one_that_does(
    load: Load, step: float, names: str
) -> None:
    with pytest.raises(InputError, match=names):
        integrate(LapJoint(load=load, elements=20).system, step=step, n_steps=100)


@pytest.mark.parametrize("load", [HalfSine(1.0, 1e-3, 0.5), Versine(1.0, 1e-3, 0.5)])
def test_round_pulses_between_two_steps_are_never_missed(load: Load) -> None:
    with pytest.raises(InputError, match="too long for a pulse"):
        integrate(oscillator(load), step=0.01, n_steps=100)


def test_a_rectangle_inside_a_step_is_allowed_where_nothing_is_faster() -> None:
    # The oscillator takes a hundred steps a period: the momentum of the pulse is all that counts.
    check_resolution(oscillator(Rectangle(1.0, 1e-4, 0.3123)), 0.01, 200)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
@pytest.mark.parametrize("beta", [1e5, inf])
def test_dissipating_schemes_do_not_overshoot_when_a_load_is_switched_on(
    rho: float, beta: float
) -> None:
    joint = LapJoint(elements=20, beta=beta, load=Harmonic(63e3, 1000.0, pi / 2))
    coarse = integrate(joint.system, step=1e-5, n_steps=200, scheme=generalized_alpha(rho))
    fine = integrate(joint.system, step=1e-7, n_steps=20_000, save=Save(every=100))
    difference = np.abs(coarse.point_u - fine.point_u).max()
    assert difference < 0.1 * fine.peak[0]
    assert coarse.energy_residual < 1e-10


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_jump_below_the_friction_limit_sets_off_the_part_that_slips(share: float) -> None:
    """Static slip tau x^2 / (2 EA) over the active length a: 2 pi sqrt(3/20) a / c by Rayleigh."""
    joint = LapJoint(elements=200, beta=inf)
    load = Rectangle(share * float(joint.system.w.sum()), 1.0)
    system = LapJoint(elements=200, beta=inf, load=load).system
    period = 2.0 * pi * np.sqrt(3.0 / 20.0) * share * joint.length / np.sqrt(E / DENSITY)
    check_resolution(system, 0.095 * period, 10)
    with pytest.raises(InputError, match="it jumps"):
        check_resolution(system, 0.105 * period, 10)
