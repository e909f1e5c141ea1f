"""Derivatives of the natural frequency and shape of a mode by parameters of the stiffness.

With K phi = lambda M phi and phi^T M phi = 1,

    d(lambda) = phi^T dK phi,      (K - lambda M) d(phi) = -(dK - d(lambda) M) phi,

and d(phi) has no part along phi (R. L. Fox and M. P. Kapoor, AIAA J. 6, 1968). Its parts along
other modes that are known follow at once. What is left obeys the same equation in the space of
higher modes, where x = K^-1 (r + lambda M x) converges with the ratio of lambda to the next higher
one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.reduction.stuck import Stuck, StuckMode
from skfem_joint.system.sensitivity import SystemSensitivity

#: Relative change of the shape at which the iteration ends, and most iterations.
SETTLED, MOST = 1e-11, 500
#: Forces below this share of the largest one are none.
ROUND_OFF = 1e-11
#: Modes whose square frequencies differ by less than this, relative, are the same.
SAME = 1e-7
#: Modes of one frequency are mixed by a parameter that couples them by more than this share of its
#: largest part; what is less is round-off of the modes.
MIXED = 1e-6


def mode_rates(
    mode: StuckMode, parameters: Sequence[SystemSensitivity]
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of a frequency, (k,), Hz, and of its mode, (n, k), with the contact stuck.

    Parameters
    ----------
    mode : StuckMode
    parameters : sequence of SystemSensitivity
        k of them, in the unknowns of the mode's system.

    Raises
    ------
    InputError
        If another mode has the same frequency and a parameter mixes both, so that there is no
        derivative.
    ConvergenceError
        If the shape's derivative is not found.
    """
    system, frequencies, shapes = mode.stuck.system, mode.frequencies, mode.shapes
    values, phi, M, place = (2.0 * np.pi * frequencies) ** 2, mode.shape, system.M, mode.number - 1
    rates = [parameter.of_stuck_stiffness(system.contact) for parameter in parameters]
    of_value = np.zeros(len(rates))
    of_shape = np.zeros((system.n, len(rates)))
    changes = [j for j, rate in enumerate(rates) if rate is not None]
    if not changes:
        return of_value, of_shape
    pushed = np.column_stack([rate @ phi for rate in rates if rate is not None])
    of_value[changes] = phi @ pushed
    right = np.outer(M @ phi, of_value[changes]) - pushed
    along = shapes.T @ right
    apart = values - values[place]
    same = np.abs(apart) <= SAME * values[place]
    size = np.abs(shapes.T @ pushed).max(axis=0)
    mixed = same & (np.abs(along) > MIXED * size).any(axis=1)
    mixed[place] = False
    if mixed.any():
        raise InputError(
            f"modes {place + 1} and {int(np.flatnonzero(mixed)[0]) + 1} have the same frequency, "
            f"{frequencies[place]:.6g} Hz, and are not told apart: their derivatives do not exist; "
            "make the structure less symmetric"
        )
    known = np.where(same[:, np.newaxis], 0.0, along / np.where(same, 1.0, apart)[:, np.newaxis])
    rest = right - (M @ shapes) @ along
    sized = np.abs(rest).max(axis=0) > ROUND_OFF * np.abs(pushed).max(axis=0)
    of_shape[:, changes] = shapes @ known + _higher(
        mode.stuck, values[place], shapes, np.where(sized, rest, 0.0)
    )
    omega = 2.0 * np.pi * frequencies[place]
    return of_value / (2.0 * omega) / (2.0 * np.pi), of_shape


def _higher(stuck: Stuck, value: float, shapes: FloatArray, right: FloatArray) -> FloatArray:
    """Solution x of (K - value M) x = right among modes beyond the ``shapes``, (n, k)."""
    if not np.any(right):
        return np.zeros_like(right)
    solve, shift = stuck.solver
    Y, right = stuck.F.T @ shapes, stuck.F.T @ right
    MY, value = stuck.M @ Y, value + shift
    right = right - MY @ (Y.T @ right)
    x = np.zeros_like(right)
    for _ in range(MOST):
        before, x = x, np.asarray(solve(right + value * (stuck.M @ x)))
        x -= Y @ (MY.T @ x)
        if np.abs(x - before).max() <= SETTLED * np.abs(x).max():
            return np.asarray(stuck.F @ x)
    raise ConvergenceError(
        f"the derivative of a mode's shape was not found in {MOST} iterations: higher modes lie "
        "near it in frequency"
    )
