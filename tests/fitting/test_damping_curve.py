"""Frequency and damping over amplitude of signals of known law, with noise and other modes."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy import sparse
from scipy.integrate import solve_ivp

import skfem_joint as sj

RATE = 4000.0  # Hz, of sampling
LAWS = {
    "constant": (lambda a: 0.002 + 0.0 * a, lambda a: 80.0 + 0.0 * a, 3.0),
    "joint": (lambda a: 0.001 + 0.004 * a / (a + 0.3), lambda a: 80.0 - 0.8 * a / (a + 0.5), 4.0),
    "falls": (lambda a: 0.002 + 0.0005 / (a + 0.05), lambda a: 80.0 + 0.0 * a, 1.0),
    "cubic": (lambda a: 0.004 + 0.0 * a, lambda a: 50.0 + 2.0 * a**2, 2.0),
    "steep": (lambda a: 0.002 + 0.02 * a**1.5, lambda a: 80.0 - 3.0 * a, 4.0),
}


@cache
def decaying(law, seconds, rate=RATE):
    """Times, amplitudes and phases of a mode from the amplitude 1."""
    damping, frequency, _ = LAWS[law]

    def rates(_, y):
        omega, ratio = 2.0 * np.pi * frequency(np.exp(y[0])), damping(np.exp(y[0]))
        return [-ratio * omega, omega * np.sqrt(1.0 - ratio**2)]

    t = np.arange(int(seconds * rate)) / rate
    found = solve_ivp(rates, (0.0, seconds), [0.0, 0.3], t_eval=t, rtol=1e-10, atol=1e-12)
    return t, np.exp(found.y[0]), found.y[1]


def others(t, amplitude, phase):
    """What else a sensor shows: a harmonic, another mode after the blow, an offset."""
    return (
        0.05 * amplitude * np.cos(3.0 * phase)
        + 0.3 * np.exp(-9.0 * t) * np.cos(2.0 * np.pi * 297.0 * t)
        + 0.02
    )


@pytest.mark.parametrize(
    ("law", "proportional"),
    [("joint", False), ("joint", True), ("falls", True), ("cubic", False)],
)
def test_laws_are_found_in_noise_of_one_percent(law, proportional):
    """Noise of 1 % of the first amplitude, or of the present one: within 0.05 % and 3 %.

    So it is where the stated standard deviations are below a third of that; errors over their
    standard deviations have a mean square near 1.
    """
    damping, frequency, seconds = LAWS[law]
    t, amplitude, phase = decaying(law, seconds)
    signal = amplitude * np.cos(phase) + others(t, amplitude, phase)
    scores, all_sure = [], []
    for seed in range(2):
        noise = 0.01 * np.random.default_rng([seed, 7]).normal(size=t.size)
        curve = sj.damping_curve(t, signal + noise * (amplitude if proportional else 1.0))
        a = np.interp(curve.time, t, amplitude)
        sure = curve.damping_error < 0.01 * curve.damping_ratio
        sure &= curve.frequency_error < 1.7e-4 * curve.frequency
        all_sure += sure.tolist()
        assert curve.amplitude[sure] == pytest.approx(a[sure], rel=0.02)
        assert curve.frequency[sure] == pytest.approx(frequency(a[sure]), rel=5e-4)
        assert curve.damping_ratio[sure] == pytest.approx(damping(a[sure]), rel=0.03)
        scores.append((curve.damping_ratio - damping(a)) / curve.damping_error)
        scores.append((curve.frequency - frequency(a)) / curve.frequency_error)
    assert np.mean(all_sure) > 0.2
    assert 0.2 < np.mean(np.concatenate(scores) ** 2) < 4.0


def scores(law, seed, noise, ratio=None, size=1.0, damping=0.004):
    """Errors of a curve over their stated deviations, (2, levels), beside another mode.

    ``ratio`` is that of its frequency; its ``size`` is relative too.
    """
    of_damping, of_frequency, _ = LAWS[law]
    t, amplitude, phase = decaying(law, 3.5, 2000.0)
    random = np.random.default_rng([seed, 5])
    turn, other_turn = random.uniform(0.0, 2.0 * np.pi, 2)
    signal = amplitude * np.cos(phase + turn) + noise * random.normal(size=t.size)
    if ratio is not None:
        omega = 2.0 * np.pi * 80.0 * ratio
        signal += size * np.exp(-damping * omega * t) * np.cos(omega * t + other_turn)
    curve = sj.damping_curve(t, signal, 80.0)
    a = np.interp(curve.time, t, amplitude)
    of_curve = (curve.damping_ratio - of_damping(a)) / curve.damping_error
    return np.array([of_curve, (curve.frequency - of_frequency(a)) / curve.frequency_error])


@pytest.mark.slow
def test_intervals_hold_at_the_ends_of_a_record_too():
    """With a mode a factor of two away; 95 % intervals, by either quantity and end."""
    modes = (None,), (2.0, 1.0, 0.005), (0.5, 0.5, 0.004), (0.55, 1.0, 0.003)
    found = [
        scores(law, 10 * seed + k, (1e-2, 2e-3)[(seed + k) % 2], *mode)
        for seed, law, (k, mode) in product(
            range(3), ("constant", "joint", "steep"), enumerate(modes)
        )
    ]
    for level in (0, 1, -2, -1):
        of_level = np.abs([each[:, level] for each in found])
        assert 0.9 <= (of_level < 1.96).mean() < 0.99
        assert of_level.max() < 5.0


@pytest.mark.parametrize("ratio", [0.5, 3.0])
def test_a_mode_fifty_times_weaker_than_another_keeps_its_curve(ratio):
    assert np.abs(scores("joint", 1, 1e-3, ratio, 50.0)).max() < 3.5


def test_frequency_and_damping_are_those_of_the_displacement():
    """Whatever derivative is measured, where frequency and damping depend on the amplitude."""
    damping, frequency, seconds = LAWS["cubic"]
    t, amplitude, phase = decaying("cubic", seconds)
    x = amplitude * np.cos(phase)
    v = np.gradient(x, t, edge_order=2)
    for quantity, signal in {"displacement": x, "velocity": v}.items():
        curve = sj.damping_curve(t, signal, quantity=quantity)
        a = np.interp(curve.time, t, amplitude)
        assert curve.frequency == pytest.approx(frequency(a), rel=1e-4)
        assert curve.damping_ratio == pytest.approx(damping(a), rel=5e-3)
    bare = sj.damping_curve(t, v)
    a = np.interp(bare.time, t, amplitude)
    assert bare.damping_ratio[0] > 1.05 * damping(a[0])


def test_an_oscillator_with_coulomb_friction_loses_the_same_amplitude_in_each_cycle():
    """Its extremes fall by 4 w / k in a cycle: damping ratio 2 w / (pi k a)."""
    k, w, m = 1e4, 1.0, 1.0
    one = sparse.csr_array([[1.0]])
    contact = sj.Contact(one, [w], np.inf)
    system = sj.System(m * one, None, k * one, contact, P=one, points=("x",))
    a = 200.0 * w / k
    run = sj.integrate(
        system, step=2.5e-4, n_steps=11000, initial=(np.array([a]), np.zeros(1)),
        scheme=sj.generalized_alpha(1.0),
    )  # fmt: skip
    curve = sj.damping_curve(run.times, run.point("x"))
    assert curve.amplitude == pytest.approx(
        a - 4.0 * w / k * curve.time * 100 / 2 / np.pi, rel=0.01
    )
    known = 2.0 * w / (np.pi * k * curve.amplitude)
    assert curve.damping_ratio == pytest.approx(known, rel=0.03)
    assert curve.frequency == pytest.approx(100.0 / 2.0 / np.pi, rel=2e-3)


@pytest.mark.parametrize("frequency", [None, 127.3])
def test_each_of_two_modes_has_its_own_damping(frequency):
    """Another mode of the same size, 60 % away, without noise that would hide its traces."""
    t = np.arange(10000) / (0.5 * RATE)
    signal = np.exp(-t) * np.sin(500.0 * t) + 0.9 * np.exp(-t) * np.sin(800.0 * t)
    curve = sj.damping_curve(t, signal, frequency)
    omega, decay = (500.0, 1.0) if frequency is None else (800.0, 1.0)
    assert curve.frequency == pytest.approx(omega / 2.0 / np.pi, rel=1e-3)
    assert curve.damping_ratio == pytest.approx(decay / omega, rel=0.03)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"time": np.arange(10.0)}, "must be two columns of one length"),
        ({"time": np.r_[0.0, np.arange(1, 12000) ** 1.01]}, "even steps"),
        ({"signal": np.full(12000, np.nan)}, "and 11990 more mistakes"),
        ({"signal": np.ones(12000)}, "does not change"),
        ({"signal": ["one"] * 12000}, "must be real numbers"),
        ({"quantity": "force"}, "must be one of displacement"),
        ({"frequency": -1.0}, "must be"),
        ({"frequency": 1500.0}, "samples in a period"),
        ({"signal": np.random.default_rng(0).normal(size=12000), "frequency": 80.0}, "noise"),
        ({"signal": np.exp(np.arange(12000) / RATE)
          * np.sin(500.0 * np.arange(12000) / RATE)}, "does not decay"),
    ],
)  # fmt: skip
def test_what_is_no_free_vibration_is_refused(changes, says):
    t, amplitude, phase = decaying("constant", 3.0)
    given = {"time": t, "signal": amplitude * np.cos(phase)} | changes
    with pytest.raises(sj.InputError, match=says):
        sj.damping_curve(**given)


@pytest.mark.parametrize("start", [1.0, 3.0, 10.0])
def test_gross_slip_in_the_first_cycles_is_not_called_noise(start):
    """A mass on a spring beside an elastic slider, released far beyond slip, without any noise."""
    k, spring, limit, damping, step = 1.0, 0.8, 0.05, 0.005, 4.7e-3
    u, v, q, signal = start, 0.0, limit, []
    for _ in range(30000):
        v -= step * (k * u + q + damping * v)
        u += step * v
        q = max(-limit, min(limit, q + spring * step * v))
        signal.append(u)
    time = step * np.arange(3000) * 10
    with pytest.raises(sj.InputError, match="as in gross slip or during a blow"):
        sj.damping_curve(time, signal[::10], np.sqrt(k + spring) / (2.0 * np.pi))
