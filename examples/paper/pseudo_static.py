"""Closed-form micro-slip of a uniform joint without inertia (pseudo-static, refs. [2, 4]).

A bar of axial stiffness EA, pressed with friction tau per length on a rigid base and pulled by a
force F at its free end, slips over the length F / tau, where it is strained linearly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.ground.arrays import FloatArray


def slip_length(force: float, tau: float) -> float:
    """Length that slips under the force amplitude ``force`` (N), m."""
    return force / tau


def peak_displacement(force: float, EA: float, tau: float) -> float:
    """Displacement of the free end under ``force`` (N) at first loading, F^2 / (2 EA tau), m."""
    return force**2 / (2.0 * EA * tau)


def loop_energy(force: float, EA: float, tau: float) -> float:
    """Area of the hysteresis loop for a force amplitude, 2 F^3 / (3 EA tau), J."""
    return 2.0 * force**3 / (3.0 * EA * tau)


def loop(force: float, EA: float, tau: float, phase: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Hysteresis loop, displacement (m) and force (N), under ``force * sin(phase)``, steady.

    On each branch the displacement departs from its turning point with the square of the change of
    force: du = (dF)^2 / (4 EA tau).
    """
    angle = np.asarray(phase, dtype=float)
    load = force * np.sin(angle)
    rising = np.cos(angle) >= 0.0
    peak = peak_displacement(force, EA, tau)
    up = -peak + (load + force) ** 2 / (4.0 * EA * tau)
    down = peak - (force - load) ** 2 / (4.0 * EA * tau)
    return np.where(rising, up, down), load
