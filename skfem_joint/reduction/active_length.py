"""Active length and area of a joint: measured from a run, or estimated by Eqs. (17)-(20)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from scipy.spatial import cKDTree

from skfem_joint.arrays import BoolArray, FloatArray
from skfem_joint.errors import InputError
from skfem_joint.structure import AnyStructure
from skfem_joint.system import System

#: Damping ratio of a joint in micro-slip, independent of its active length, Eq. (20).
DAMPING_RATIO = 2.0 / sqrt(9.0 * pi**2 - 16.0)
#: Displacement, relative to the interface's, above which a point counts as active.
THRESHOLD = 1e-3
#: A joint slips as a whole when its least relative slip exceeds this share of its largest.
GROSS_SLIP = 0.02


def measured(distance: FloatArray, peak: FloatArray, threshold: float = THRESHOLD) -> float:
    """Active length from the largest displacements along a joint, m; 0 if nothing moves.

    Contact points, at an increasing ``distance`` (m,) from the loaded end (m), are active while
    their ``peak`` (m,), m, exceeds a share of the loaded end's; linear between points. The response
    falls off smoothly, so the ``threshold`` matters: state it.
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
    """Active length by the fixed-point iteration of section 6.1."""

    length: float  #: active length, m
    factors: tuple[float, ...]  #: iterates of A_a
    frequency_ratio: float  #: excitation over natural frequency at the last iterate
    converged: bool  #: the iteration settled; it does not near and above resonance

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

    From the active length without inertia, F / tau (m), the frequency of the load (Hz), and the
    first natural frequency (Hz) of what moves with a given active length (m).
    """
    factors, ratio, converged = [1.0], 0.0, False
    while len(factors) <= iterations and not converged:
        ratio = frequency / natural_frequency(factors[-1] * static_length)
        factors.append(amplification(ratio))
        converged = abs(factors[-1] - factors[-2]) <= tolerance * factors[-1]
    return Estimate(factors[-1] * static_length, tuple(factors[1:]), ratio, converged)


def slips(
    structure: AnyStructure, system: System, slip_peak: FloatArray, period: float
) -> BoolArray:
    """Contact points that slip rather than creep, shape (m,).

    Their largest slip, ``slip_peak`` (m), exceeds a thousandth of the largest in their joint, and
    what they creep at half of their limit in a ``period`` (s) of the load.
    """
    active = np.zeros(system.w.size, dtype=np.bool_)
    for patch in structure.patches:
        points = patch.points[system.w[patch.points] > 0.0]
        least = THRESHOLD * slip_peak[points].max(initial=0.0)
        creep = period / system.beta[points]
        active[points] = slip_peak[points] > np.maximum(least, creep)
    return active


def active_fractions(
    structure: AnyStructure, system: System, slip_peak: FloatArray, period: float
) -> tuple[dict[str, float], dict[str, float]]:
    """Share of each joint's contact area, and of its nodes, that slips; held nodes do not.

    See :func:`slips` for ``slip_peak`` (m) and ``period`` (s).
    """
    active = slips(structure, system, slip_peak, period)
    areas, nodes = {}, {}
    for patch in structure.patches:
        name, slipping = patch.joint.name, active[patch.points]
        area = float(patch.area.sum()) + patch.held_area
        count = patch.nodes.size + patch.held_nodes.size
        areas[name] = float(patch.area[slipping].sum() / area) if area > 0.0 else 0.0
        nodes[name] = float(slipping.sum() / count) if count else 0.0
    return areas, nodes


def gross_slip(structure: AnyStructure, slip_peak: FloatArray, period: float) -> list[str]:
    """Sentences about joints without a point that sticks.

    The largest slip of each point, ``slip_peak`` (m), is compared with that of a body strained
    evenly between its support and the point that moves most. While they stick, all points creep a
    little in a ``period`` (s) of the load.
    """
    found = []
    for patch in structure.patches:
        peak = slip_peak[patch.points]
        if peak.size == 0 or peak.max() <= 10.0 * period / patch.joint.beta:
            continue
        room = np.ones(peak.size)
        if patch.held_nodes.size and structure.body is not None:
            nodes = structure.body.nodes
            room = cKDTree(nodes[patch.held_nodes]).query(nodes[patch.nodes])[0]
        if (peak / room).min() > GROSS_SLIP * peak.max() / room.max():
            found.append(
                f"Every point of joint '{patch.joint.name}' slips, the least by "
                f"{peak.min():.3g} m: the paper's assumption of no gross slip is violated."
            )
    return found
