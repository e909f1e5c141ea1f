"""Backbones with contact that opens: closed forms of oscillators, limits, stated errors."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from opening_blocks import block, loads
from scipy import sparse
from scipy.optimize import brentq
from test_backbone import bar

import skfem_joint as sj
from skfem_joint.vibration import cycles

K0, K1, K2 = 3e6, 2e6, 1e6  # N/m
PRESSED, MU = 500.0, 0.3  # N


def oscillator(
    K: list[list[float]], normal: list[float], slip: list[float], stiffness: float = np.inf
) -> sj.System:
    """Unit masses, of which one vibrates, with a pressure point and a contact point."""
    pressed = {"friction": MU, "force": PRESSED, "normal_stiffness": stiffness}
    contact = sj.point_contact(slip, normal, **pressed)
    return sj.System.from_matrices(sparse.eye_array(len(K)), sparse.csr_array(K), contact=contact)


def test_a_mass_on_a_preloaded_spring_has_the_secant_of_two_stiffnesses():
    """K0 alone once the spring of stiffness K1 has lost its preload; x, and a slip that is not."""
    system = oscillator([[K0, 0.0], [0.0, K2]], [1.0, 0.0], [0.0, 1.0], K1)
    lifts = PRESSED * (K0 + K1) / K1
    (curve,) = sj.backbone(system, slips_at=lifts, levels=6, up_to=3.0)
    assert curve.stuck_frequency == pytest.approx(np.sqrt(K0 + K1) / (2 * np.pi))
    F = curve.level
    down = np.where(lifts < F, (F - PRESSED) / K0, F / (K0 + K1))
    up = F / (K0 + K1)
    assert curve.amplitude == pytest.approx(0.5 * (up + down))
    assert curve.frequency == pytest.approx(np.sqrt(2.0 * F / (up + down)) / (2 * np.pi))
    assert np.abs(curve.offset) == pytest.approx(0.5 * (down - up), abs=1e-12)
    assert np.array_equal(curve.opened, lifts < F)
    assert any("what impacts take" in text for text in curve.notes)
    assert np.all(curve.friction_damping == 0.0)
    assert max(curve.estimated.values()) < 1e-6


def test_a_rigid_stop_that_lifts_leaves_both_springs_in_series():
    """Mass on a spring K2 from a foot that is pressed on a base and held by a spring K0."""
    K = [[K0 + K2, -K2, 0.0], [-K2, K2, 0.0], [0.0, 0.0, K1]]
    system = oscillator(K, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    (curve,) = sj.backbone(system, slips_at=PRESSED, levels=6, up_to=3.0)
    lifted = np.maximum(curve.level - PRESSED, 0.0) / K0
    assert curve.stuck_frequency == pytest.approx(np.sqrt(K2) / (2 * np.pi))
    assert curve.amplitude == pytest.approx(curve.level / K2 + 0.5 * lifted)
    assert np.abs(curve.offset) == pytest.approx(0.5 * lifted, abs=1e-12)


def slider() -> sj.System:
    """Mass x that drags a slider t by a spring K1 and presses it by a spring K2; unknowns t, n, x.

    The friction limit is MU (PRESSED + K2 x) while the slider is pressed.
    """
    K = [[K1, 0.0, -K1], [0.0, K2, -K2], [-K1, -K2, K0 + K1 + K2]]
    return oscillator(K, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])


def loop_of_the_slider(F: float) -> tuple[float, float]:
    """Half of peak to peak, and the work of friction, of its closed cycle."""
    high = (F - MU * PRESSED) / (K0 + K2 + MU * K2)
    low = -(F - MU * PRESSED) / (K0 + K2 - MU * K2)
    t_high = high - MU * (PRESSED + K2 * high) / K1
    t_low = low + MU * (PRESSED + K2 * low) / K1
    from_high = (K1 * t_high - MU * PRESSED) / (K1 + MU * K2)  # where it begins to slip
    from_low = (K1 * t_low + MU * PRESSED) / (K1 - MU * K2)
    force = 2.0 * MU * PRESSED + 0.5 * MU * K2 * (from_high + low + from_low + high)
    return 0.5 * (high - low), force * (t_high - t_low)


def test_a_slider_under_a_normal_force_that_varies_has_the_loop_of_its_closed_form(monkeypatch):
    """Four times as many increments leave less than a quarter of the error."""
    slips = MU * PRESSED * (K0 + K1 + K2) / K1
    errors = []
    for increments in (8, 16, 32):
        monkeypatch.setattr(cycles, "INCREMENTS", increments)
        (curve,) = sj.backbone(slider(), slips_at=slips, levels=3, up_to=3.0)
        assert curve.state == ("stick", "stick", "gross")
        q, work = loop_of_the_slider(curve.level[-1])
        exact = work / (2.0 * np.pi * curve.level[-1] * q)
        assert curve.amplitude[-1] == pytest.approx(q, rel=1e-9)
        errors.append(abs(curve.friction_damping[-1] / exact - 1.0))
        assert errors[-1] < 3.0 * curve.estimated["damping_ratio"]
    assert errors[0] < 0.03
    assert errors[2] < 0.25 * errors[0]


def test_normal_forces_that_cannot_vary_have_the_curve_of_constant_ones():
    """Points whose normal motion is that of springs of their own."""
    constant = bar()
    m, n, w = constant.contact.w.size, constant.n, constant.contact.w
    beside = sparse.eye_array(m, format="csr")
    both = {
        name: sparse.block_diag([getattr(constant, name), 1e9 * beside], format="csr")
        for name in ("M", "C", "K")
    }
    B = sparse.hstack([constant.contact.B, sparse.csr_array((m, m))], format="csr")
    N = sparse.hstack([sparse.csr_array((m, n)), beside], format="csr")
    normal = sj.NormalPart(N, np.zeros(m), w / MU, np.full(m, np.inf), np.ones(m))
    opens = sj.System(
        **both, contact=sj.Contact(B, np.zeros(m), np.inf, normal=normal, gain=MU * beside)
    )
    (one,) = sj.backbone(constant, levels=6)
    (other,) = sj.backbone(opens, levels=6, slips_at=one.slips_at)
    for name in ("amplitude", "frequency", "friction_damping", "share"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-6)
    assert other.state == one.state
    assert np.all(other.opened == 0.0)
    assert other.masing_error is None
    assert max(other.estimated.values()) < 1e-6
    (own,) = sj.backbone(opens.with_contact(beta=np.full(m, 1e3)), levels=2)
    assert any("the curve is of Coulomb's law" in text for text in own.notes)


def plain_block(**values: Any) -> sj.Structure:
    """The block of plain elements, whose base opens at the levels of the tests."""
    return replace(block(**values), incompatible=False)


def with_gaps(order: int) -> sj.System:
    """Block two of whose pressure points are apart at rest."""
    system = plain_block(order=order).system(loads())
    contact = system.contact.normal
    apart = np.arange(contact.gap.size) < 2
    contact = replace(
        contact, gap=np.where(apart, 1e-5, 0.0), force=np.where(apart, 0.0, contact.force)
    )
    return system.with_contact(normal=contact)


@pytest.mark.parametrize("order", [1, 2])
def test_small_vibration_has_the_stuck_frequency(order):
    """Also where a mean over a hat has nodes of pressed points and of others."""
    system = with_gaps(order)
    (curve,) = sj.backbone(system, levels=2, up_to=1e-3)
    assert curve.state == ("stick", "stick")
    assert curve.frequency == pytest.approx(curve.stuck_frequency, rel=1e-6)
    modes = sj.natural_modes(system, 1, joints="stuck")
    assert modes.frequencies[0] == pytest.approx(curve.stuck_frequency)


def test_a_condensed_model_has_the_curve_of_the_full_one():
    system = plain_block().system(loads())
    full, small = (sj.backbone(s, levels=4, up_to=0.05)[0] for s in (system, sj.condense(system)))
    assert full.opened[-1] > 0.0
    for name in ("frequency", "amplitude"):
        assert getattr(small, name) == pytest.approx(getattr(full, name), rel=0.01)


def test_what_lifts_off_ends_the_curve():
    system = block().system(loads())
    (curve,) = sj.backbone(system, levels=8, up_to=0.7)
    assert 0 < curve.level.size < 8
    assert len(curve.state) == len(curve.states) == len(curve.middle) == curve.level.size
    assert any("the curve ends at" in text and "lifts off" in text for text in curve.notes)
    with pytest.raises(sj.ConvergenceError, match="there is no cycle at 1 of the highest level"):
        sj.backbone(system, levels=1, up_to=0.7)


def frequency_of_two_stiffnesses(amplitude: float) -> float:
    """Hz, of free vibration of the mass on K0 and the preloaded K1, which has half cycles of each.

    ``amplitude`` is half of peak to peak, m.
    """
    stiff, soft = np.sqrt(K0 + K1), np.sqrt(K0)
    lifts, centre = PRESSED / K1, PRESSED / K0  # of the motion on K0 alone
    if amplitude <= lifts:
        return float(stiff / (2.0 * np.pi))

    def radius(high: float) -> float:
        return float(np.hypot(centre + lifts, stiff / soft * np.sqrt(high**2 - lifts**2)))

    def missing(high: float) -> float:
        return 0.5 * (high + radius(high) - centre) - amplitude

    high = brentq(missing, lifts, 10.0 * amplitude)
    closed = 2.0 * (np.pi - np.arccos(lifts / high)) / stiff
    return float(1.0 / (closed + 2.0 * np.arccos((centre + lifts) / radius(high)) / soft))


def test_a_ring_down_has_the_frequency_of_two_stiffnesses_at_each_amplitude():
    ratio = 1e-3
    system = oscillator([[K0, 0.0], [0.0, K2]], [1.0, 0.0], [0.0, 1.0], K1)
    system = replace(system, C=2.0 * ratio * np.sqrt(K0 + K1) * system.M)
    lifts = PRESSED * (K0 + K1) / K1
    (curve,) = sj.backbone(system, slips_at=lifts, levels=2, up_to=3.0)
    assert abs(curve.highest[0]) == pytest.approx(3.0 * lifts / (K0 + K1))  # the pressed side
    errors = []
    for steps in (50, 100):
        rung = sj.ring_down(system, curve, 30, steps)
        exact = np.array([frequency_of_two_stiffnesses(a) for a in rung.amplitude])
        assert exact[-1] / exact[0] > 1.005  # it rises as the mass comes to rest
        errors.append(np.abs(rung.frequency / exact - 1.0)[2:].max())
        assert rung.impact_work == 0.0  # of an elastic contact
    assert errors[1] < 5e-4
    assert errors[1] < 0.35 * errors[0]
    assert rung.damping_ratio[2:] == pytest.approx(ratio, rel=0.15)
