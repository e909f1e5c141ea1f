"""The paper's estimate of the active length of a bar's joint, section 6.1, Eqs. (17)-(20).

Without inertia the active length is the force at the loaded end over the friction limit per length.
With inertia it is longer by the amplification of a linear oscillator, whose natural frequency
depends on the active length: a fixed-point iteration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import pi, sqrt

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import IntArray
from skfem_joint.linalg import shifts
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.shifts import shifted
from skfem_joint.reduction.active_length import ContactPart
from skfem_joint.system.modes import lowest_modes
from skfem_joint.system.system import System

#: Damping ratio of a joint in micro-slip, independent of its active length, Eq. (20).
DAMPING_RATIO = 2.0 / sqrt(9.0 * pi**2 - 16.0)


def amplification(frequency_ratio: float) -> float:
    """Amplification A_a of a linear oscillator, Eq. (17)."""
    r = frequency_ratio
    return 1.0 / sqrt((1.0 - r * r) ** 2 + (2.0 * r * DAMPING_RATIO) ** 2)


@dataclass(frozen=True)
class ActiveLengthEstimate:
    """Active length by the fixed-point iteration of section 6.1.

    Attributes
    ----------
    length : float
        Active length, m.
    factors : tuple of float
        Iterates of A_a.
    frequency_ratio : float
        Frequency of the load over the natural frequency at the last iterate.
    converged : bool
        Whether the iteration converged; near and above resonance it does not.
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
) -> ActiveLengthEstimate:
    """Scale the static active length by A_a until it agrees with its natural frequency.

    Parameters
    ----------
    static_length : float
        Active length without inertia, force over friction limit per length, m.
    frequency : float
        Frequency of the load, Hz.
    natural_frequency : callable
        First natural frequency (Hz) of what moves with a given active length (m).
    iterations : int
        Most iterations.
    tolerance : float
        Relative change of A_a that ends the iteration.
    """
    factors, ratio, converged = [1.0], 0.0, False
    while len(factors) <= iterations and not converged:
        ratio = frequency / natural_frequency(factors[-1] * static_length)
        factors.append(amplification(ratio))
        converged = abs(factors[-1] - factors[-2]) <= tolerance * factors[-1]
    return ActiveLengthEstimate(factors[-1] * static_length, tuple(factors[1:]), ratio, converged)


def estimate_active_length(system: System, zone: ContactPart) -> ActiveLengthEstimate | None:
    """Active length of a zone from the linear analysis of the structure, section 6.1.

    The static force at the zone's loaded end, with all joints stuck and the amplitudes of all
    harmonics added up, gives the static length. The first natural frequency of what moves with the
    active part gives A_a. None if a load is not harmonic, or anything can move but along the axis.
    """
    highest, force = 0.0, np.zeros(system.n)
    if zone.axis.size > 1 or not all(load.amplitude.harmonics for load in system.loads):
        return None
    for load in system.loads:
        for part in load.amplitude.harmonics:
            force += abs(part.amplitude) * np.abs(load.vector)
            highest = max(highest, part.frequency)
    K, M = sparse.csr_array(system.K), sparse.csr_array(system.M)
    slipping = picked(system)
    unknowns = slipping[zone.points[zone.points >= 0]]
    linear = np.setdiff1d(np.arange(system.n), slipping)
    at_end = float(force[unknowns[0]])
    if linear.size:
        K_rest = shifted(K[linear][:, linear], M[linear][:, linear], shifts.LEAST)
        u = factorised(K_rest)(force[linear])
        at_end += abs(float((K[unknowns[:1]][:, linear] @ u)[0]))

    @cache
    def frequency_up_to(node: int) -> float:
        """Natural frequency of what moves when the zone moves up to one of its nodes."""
        moving = np.union1d(unknowns[: max(node, 1)], linear)
        return float(lowest_modes(K[moving][:, moving], M[moving][:, moving], 1)[0][0])

    def frequency_of(length: float) -> float:
        """Natural frequency, interpolated between the nodes on both sides of the length."""
        node = int(np.clip(np.searchsorted(zone.distance, length), 1, zone.nodes.size - 1))
        a, b = zone.distance[node - 1], zone.distance[node]
        share = min((length - a) / (b - a), 1.0)
        frequency = (1.0 - share) * frequency_up_to(node - 1) + share * frequency_up_to(node)
        # Beyond the joint the moving length is capped only by the formula.
        return float(frequency * (b / length if length > b and linear.size == 0 else 1.0))

    return estimate(at_end / zone.tau, highest, frequency_of)


def picked(system: System) -> IntArray:
    """Unknown that each row of the slip operator picks."""
    return np.asarray(sparse.csr_array(system.contact.B).indices, dtype=np.intp)
