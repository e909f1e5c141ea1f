"""Active length of a joint: measured from histories, and estimated by section 6.1."""

from __future__ import annotations

import numpy as np
import pytest
from bars import CASE_I, EA, SPEED, LapJoint

from skfem_joint import active_length, pseudo_static
from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate


def test_measured_length_of_a_linear_decay() -> None:
    distance = np.linspace(0.0, 1.0, 11)
    peak = np.maximum(0.0, 2e-3 * (1.0 - distance / 0.75))
    for threshold in (0.02, 0.1, 0.5):
        # Exact while the last active element holds no kink: linear interpolation of a line.
        length = active_length.measured(distance, peak, threshold)
        if 0.75 * (1 - threshold) <= 0.7:
            assert length == pytest.approx(0.75 * (1.0 - threshold), rel=1e-12)
        else:
            assert 0.7 < length <= 0.8


def test_measured_length_does_not_depend_on_the_scale_of_the_motion() -> None:
    distance = np.linspace(0.0, 0.25, 50)
    peak = np.exp(-40.0 * distance)
    length = active_length.measured(distance, peak, 1e-3)
    assert length == pytest.approx(np.log(1e3) / 40.0, rel=1e-2)
    assert active_length.measured(distance, 1e-9 * peak, 1e-3) == pytest.approx(length, rel=1e-12)


def test_measured_length_at_its_ends() -> None:
    distance = np.linspace(0.0, 1.0, 5)
    assert active_length.measured(distance, np.ones(5)) == 1.0
    assert active_length.measured(distance, np.zeros(5)) == 0.0
    for threshold in (0.0, 1.0, -0.1, np.nan):
        with pytest.raises(InputError, match="threshold"):
            active_length.measured(distance, np.ones(5), threshold)


def slipped(joint: LapJoint, steps_per_cycle: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the free end, and the largest displacement there, over four cycles."""
    structure = joint.structure
    run = integrate(
        joint.system, step=1 / joint.frequency / steps_per_cycle, n_steps=4 * steps_per_cycle
    )
    return (joint.length - structure.position[structure.free])[::-1], run.slip_peak[::-1]


def test_slow_joint_is_active_over_the_pseudo_static_slip_length() -> None:
    # Displacement falls with the square of the distance to the end of slip, so the threshold
    # cuts off its square root of the slip length.
    joint = LapJoint(frequency=1.0, beta=np.inf, normal_force="consistent", elements=200)
    static = pseudo_static.slip_length(joint.force, joint.tau)
    distance, peak = slipped(joint, 400)
    length = active_length.measured(distance, peak, 1e-3)
    assert length == pytest.approx(static * (1.0 - np.sqrt(1e-3)), rel=5e-3)


def test_case_i_is_active_over_the_share_found_for_figure_7() -> None:
    distance, peak = slipped(CASE_I, 200)
    assert active_length.measured(distance, peak, 1e-4) / CASE_I.length == pytest.approx(
        0.63, abs=0.01
    )


def test_amplification_is_that_of_a_linear_oscillator() -> None:
    zeta = active_length.DAMPING_RATIO
    assert active_length.amplification(0.0) == 1.0
    assert active_length.amplification(1.0) == pytest.approx(1 / (2 * zeta), rel=1e-14)
    # Modulus of the complex frequency response.
    for r in (0.3, 0.9, 1.5):
        response = 1.0 / (1.0 - r**2 + 2j * zeta * r)
        assert active_length.amplification(r) == pytest.approx(abs(response), rel=1e-14)
    assert active_length.amplification(0.5, 0.0) == pytest.approx(4 / 3, rel=1e-14)


def test_damping_ratio_dissipates_what_the_pseudo_static_loop_does() -> None:
    # A loop of a harmonic force and displacement with phase phi has the area pi F u sin(phi);
    # equal to the joint's loop with tan(phi) = 2 zeta, whatever force, section and friction.
    force, tau = 1.7e4, 3e5
    area = pseudo_static.loop_energy(force, EA, tau)
    sine = area / (np.pi * force * pseudo_static.peak_displacement(force, EA, tau))
    zeta = active_length.DAMPING_RATIO
    assert np.sin(np.arctan(2.0 * zeta)) == pytest.approx(sine, rel=1e-14)


def test_case_i_at_2000_hz_has_the_factors_of_figure_6() -> None:
    static = pseudo_static.slip_length(CASE_I.force, CASE_I.tau)
    found = active_length.estimate(static, 2000.0, lambda length: SPEED / (4 * length))
    assert found.converged
    assert found.factors[0] == pytest.approx(1.162, abs=1e-3)
    assert found.factor == pytest.approx(1.3, abs=5e-3)
    assert found.length == pytest.approx(0.325, abs=1.5e-3)


def test_estimate_is_a_fixed_point() -> None:
    def natural(length: float) -> float:
        return SPEED / (4 * length)

    for frequency in (10.0, 500.0, 1500.0):
        found = active_length.estimate(0.25, frequency, natural, tolerance=1e-12)
        assert found.converged
        factor = active_length.amplification(frequency / natural(found.length))
        assert found.length == pytest.approx(0.25 * factor, rel=1e-9)
    slow = active_length.estimate(0.25, 1e-3, natural)
    assert slow.length == pytest.approx(0.25, rel=1e-9)


def test_estimate_that_does_not_settle_says_so() -> None:
    # Around resonance a longer active length is off resonance again: the iterates go to and fro.
    found = active_length.estimate(0.25, 5000.0, lambda length: SPEED / (4 * length))
    assert not found.converged
    assert len(found.factors) == 60


def test_impulse_scales_with_its_peak() -> None:
    assert active_length.scaled_for_impulse(0.2, 1e4, 1.5e4) == pytest.approx(0.3, rel=1e-14)
