"""How often the intervals of damping curves hold, on free vibrations of known law; SI units."""

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import skfem_joint as sj

RATE, SECONDS = 2000.0, 3.0
#: Damping ratio and frequency over the amplitude.
LAWS = {
    "constant": (lambda a: 0.003 + 0.0 * a, lambda a: 100.0 + 0.0 * a),
    "joint": (lambda a: 0.001 + 0.006 * a / (a + 0.3), lambda a: 100.0 - 2.0 * a / (a + 0.5)),
    "steep": (lambda a: 0.002 + 0.02 * a**1.5, lambda a: 100.0 - 4.0 * a),
}


def vibration(law: str, seed: int, other: tuple[float, float, float] | None, noise: float):
    """Times, amplitude of the mode, and the signal with another mode and noise.

    ``other`` is its frequency, Hz, size and damping ratio.
    """
    damping, frequency = LAWS[law]
    random = np.random.default_rng([seed, list(LAWS).index(law)])
    t = np.arange(int(SECONDS * RATE)) / RATE

    def rates(_, y):
        omega, ratio = 2.0 * np.pi * frequency(np.exp(y[0])), damping(np.exp(y[0]))
        return [-ratio * omega, omega * np.sqrt(1.0 - ratio**2)]

    start = [0.0, random.uniform(0.0, 2.0 * np.pi)]
    a, phase = solve_ivp(rates, (0.0, SECONDS), start, t_eval=t, rtol=1e-9, atol=1e-11).y
    x = np.exp(a) * np.cos(phase) + noise * random.normal(size=t.size)
    if other is not None:
        f, size, ratio = other
        omega = 2.0 * np.pi * f
        x += (
            size * np.exp(-ratio * omega * t) * np.cos(omega * t + random.uniform(0.0, 2.0 * np.pi))
        )
    return t, np.exp(a), x


def scores(law: str, seed: int, other: tuple[float, float, float] | None, noise: float):
    """Errors of a curve over their stated deviations, (2, levels)."""
    t, a, x = vibration(law, seed, other, noise)
    curve = sj.damping_curve(t, x, 100.0)
    at = np.interp(curve.time, t, a)
    damping, frequency = (value(at) for value in LAWS[law])
    return np.array([
        (curve.damping_ratio - damping) / curve.damping_error,
        (curve.frequency - frequency) / curve.frequency_error,
    ])  # fmt: skip


def cases() -> Iterator[tuple[str, int, tuple[float, float, float] | None, float]]:
    others = None, (200.0, 1.0, 0.005), (50.0, 0.5, 0.004), (55.0, 1.0, 0.003)
    for seed in range(3):
        for law in LAWS:
            for k, other in enumerate(others):
                yield law, 10 * seed + k, other, (1e-2, 2e-3)[(seed + k) % 2]


@pytest.fixture(scope="module")
def all_scores() -> list[np.ndarray]:
    return [scores(*case) for case in cases()]


@pytest.mark.parametrize("level", [0, 1, -2, -1])
def test_intervals_hold_at_the_ends_of_a_record_too(all_scores, level):
    """With a mode a factor of two away; 95 % intervals, by either quantity and end."""
    of_level = np.abs([each[:, level] for each in all_scores])
    assert 0.9 <= (of_level < 1.96).mean() < 0.99
    assert of_level.max() < 5.0


@pytest.mark.parametrize("ratio", [0.5, 2.0, 3.0])
def test_a_mode_fifty_times_weaker_than_another_keeps_its_curve(ratio):
    found = scores("joint", 1, (100.0 * ratio, 50.0, 0.004), 1e-3)
    assert np.abs(found).max() < 3.5
