"""Active length of a joint: measured from a history, or estimated by Eqs. (17)-(20)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError

FloatArray = NDArray[np.float64]

#: Damping ratio of a joint in micro-slip, independent of its active length, Eq. (20).
DAMPING_RATIO = 2.0 / sqrt(9.0 * pi**2 - 16.0)

#: Displacement, relative to the interface's, above which a point counts as active.
THRESHOLD = 1e-3


def measured(distance: FloatArray, peak: FloatArray, threshold: float = THRESHOLD) -> float:
    """Active length from the largest displacements along a joint.

    Parameters
    ----------
    distance : ndarray, shape (m,)
        Distance of the contact points from the joint's loaded end, increasing from 0, m.
    peak : ndarray, shape (m,)
        Largest displacement of each point, m.
    threshold : float
        Points are active while their peak exceeds this share of the loaded end's. Interpolated
        between points. The response falls off smoothly, so the threshold matters: state it.

    Returns
    -------
    float
        Distance from the loaded end to the last active point, m; 0 if nothing moves.
    """
    if not 0.0 < threshold < 1.0:
        raise InputError(f"threshold: found {threshold}, must be between 0 and 1")
    limit = threshold * peak[0]
    if limit == 0.0:
        return 0.0
    inactive = np.flatnonzero(peak <= limit)
    if inactive.size == 0:
        return float(distance[-1])
    i = int(inactive[0])
    share = (peak[i - 1] - limit) / (peak[i - 1] - peak[i])
    return float(distance[i - 1] + share * (distance[i] - distance[i - 1]))


def amplification(frequency_ratio: float, damping_ratio: float = DAMPING_RATIO) -> float:
    """Amplification A_a of a linear oscillator, Eq. (17)."""
    r = frequency_ratio
    return 1.0 / sqrt((1.0 - r * r) ** 2 + (2.0 * r * damping_ratio) ** 2)


@dataclass(frozen=True)
class Estimate:
    """Active length by the fixed-point iteration of section 6.1.

    Attributes
    ----------
    length : float
        Active length, m.
    factors : tuple of float
        Iterates of A_a.
    frequency_ratio : float
        Excitation over natural frequency at the last iterate.
    converged : bool
        Whether the iteration settled; it does not near and above resonance.
    """

    length: float
    factors: tuple[float, ...]
    frequency_ratio: float
    converged: bool

    @property
    def factor(self) -> float:
        """Last A_a."""
        return self.factors[-1]


def estimate(
    static_length: float,
    frequency: float,
    natural_frequency: Callable[[float], float],
    iterations: int = 60,
    tolerance: float = 1e-4,
) -> Estimate:
    """Scale the static active length by A_a until it agrees with its natural frequency.

    Parameters
    ----------
    static_length : float
        Active length without inertia, F / tau, m.
    frequency : float
        Excitation frequency, Hz.
    natural_frequency : callable
        First natural frequency (Hz) of what moves when the active length is given (m);
        ``speed / (4 length)`` for an isolated joint.

    Returns
    -------
    Estimate
    """
    factors: list[float] = []
    factor = 1.0
    ratio = 0.0
    for _ in range(iterations):
        ratio = frequency / natural_frequency(factor * static_length)
        previous, factor = factor, amplification(ratio)
        factors.append(factor)
        if abs(factor - previous) <= tolerance * factor:
            return Estimate(factor * static_length, tuple(factors), ratio, True)
    return Estimate(factor * static_length, tuple(factors), ratio, False)


def scaled_for_impulse(length: float, force: float, other_force: float) -> float:
    """Active length under an impulse of another peak, by the ratio of the peaks (section 6.2)."""
    return length * other_force / force
