"""Forces of springs in series with friction along histories of slip that are known.

Without springs friction follows from the velocity of slip. With them it depends on what went
before, and is followed here from one instant to the next, as in a step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.minimise.law import force, force_vectors
from skfem_joint.system.system import System


def friction_along(
    system: System, slip: FloatArray, rate: FloatArray, times: FloatArray, repeats: bool = False
) -> FloatArray:
    """Friction over its limit, (times, rows), along a history of slip.

    Parameters
    ----------
    system : System
        Contact points and their laws.
    slip, rate : ndarray, shape (times, rows)
        Slip, m, and its velocity, m/s, which alone counts at points without springs.
    times : ndarray, shape (times,)
        s, rising.
    repeats : bool
        Whether it is a period of steady vibration, which springs go through before. If not, springs
        are without force at the first time.
    """
    friction = force_vectors(rate, system.contact.beta, system.contact.directions)
    if not system.contact.has_springs:
        return friction
    points = np.flatnonzero(system.contact.sprung)
    rows = np.flatnonzero(system.contact.on_rows(system.contact.sprung))
    directions = system.contact.directions[points]
    moved, lasts = np.diff(slip[:, rows], axis=0), np.diff(times)
    now = np.zeros(rows.size)
    for _ in range(2 if repeats else 1):
        friction[0, rows] = now
        for k, change in enumerate(moved, 1):
            now = _after(system, points, directions, now, change, lasts[k - 1])
            friction[k, rows] = now
    return friction


def _after(
    system: System,
    points: NDArray[np.intp],
    directions: NDArray[np.int64],
    before: FloatArray,
    change: FloatArray,
    lasts: float,
) -> FloatArray:
    """Friction over its limit after a change of slip, m, in some time, s, of points on springs."""
    soft = system.contact.w[points] / system.contact.stiffness[points]
    stretch = np.repeat(soft, directions) * before + change
    squares = np.add.reduceat(stretch**2, np.cumsum(directions) - directions)
    size = np.sqrt(squares)
    ratio = force(size, system.contact.beta[points] / lasts, soft) / np.where(size > 0.0, size, 1.0)
    return np.asarray(np.repeat(ratio, directions) * stretch)
