"""Pseudo-static joint: the closed forms against quadrature of strain, and Table 3 of the paper."""

import numpy as np
import pytest
from paper import pseudo_static
from scipy.integrate import quad

#: Case I: 437.5 kN on 50 MPa over a width of 0.05 m with a friction coefficient of 0.7.
FORCE, TAU, EA = 437.5e3, 0.7 * 50e6 * 0.05, 200e9 * 0.05 * 0.01


def test_peak_is_the_integral_of_the_strain_along_the_slip_length():
    # Friction takes the bar's force from F at the free end to zero, tau for each length.
    length = pseudo_static.slip_length(FORCE, TAU)
    stretch, _ = quad(lambda x: (FORCE - TAU * x) / EA, 0.0, length, epsrel=1e-13)
    assert pseudo_static.peak_displacement(FORCE, EA, TAU) == pytest.approx(stretch, rel=1e-12)


def test_loop_encloses_its_energy():
    def power(phase):
        # F du by parts is -u dF over the closed loop.
        u, _ = pseudo_static.loop(FORCE, EA, TAU, phase)
        return -float(u) * FORCE * np.cos(phase)

    turning = [np.pi / 2, 3 * np.pi / 2]
    area, _ = quad(power, 0.0, 2 * np.pi, points=turning, epsrel=1e-12)
    assert pseudo_static.loop_energy(FORCE, EA, TAU) == pytest.approx(area, rel=1e-11)


def test_loop_is_closed_continuous_and_symmetric():
    peak = pseudo_static.peak_displacement(FORCE, EA, TAU)
    phase = np.linspace(0.0, 2 * np.pi, 4001)
    u, load = pseudo_static.loop(FORCE, EA, TAU, phase)
    np.testing.assert_allclose(load, FORCE * np.sin(phase), rtol=1e-15)
    assert u[0] == pytest.approx(u[-1], rel=1e-12)
    assert u.max() == pytest.approx(peak, rel=1e-12)
    assert u.min() == pytest.approx(-peak, rel=1e-12)
    # |du/dphase| is at most 3 sqrt(3) / 4 of the peak.
    assert np.abs(np.diff(u)).max() < 1.31 * peak * phase[1]
    opposite, _ = pseudo_static.loop(FORCE, EA, TAU, phase + np.pi)
    np.testing.assert_allclose(opposite, -u, atol=1e-11 * peak)
    # Masing: a branch is the virgin curve F^2 / (2 EA tau) at twice the scale, from the tip.
    rising = np.abs(phase) < np.pi / 2
    virgin = pseudo_static.peak_displacement((load[rising] + FORCE) / 2, EA, TAU)
    np.testing.assert_allclose(u[rising], 2 * virgin - peak, atol=1e-12 * peak)
