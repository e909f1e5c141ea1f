"""Response of natural modes to forces that are straight lines between time steps."""

from __future__ import annotations

from typing import Literal

import numpy as np

from skfem_joint.ground.arrays import FloatArray


def modal_response(
    omega: FloatArray,
    damping: FloatArray,
    force: FloatArray,
    step: float,
    quantity: Literal["displacement", "acceleration"] = "displacement",
) -> FloatArray:
    """Displacement or acceleration of modes of unit mass, each a damped oscillator.

    Each mode follows ``x'' + c x' + omega^2 x = f(t)`` from rest. The solution is exact for a force
    that is linear within each step: the oscillator is discretised with a first-order hold, and the
    recursion that results is one linear filter.

    Parameters
    ----------
    omega : ndarray, shape (k,)
        Natural angular frequencies, rad/s.
    damping : ndarray, shape (k,)
        Damping ``c`` of each mode, 1/s.
    force : ndarray, shape (k, times)
        Modal force at the time steps. It is zero before them: a first value other than zero is
        reached during the step before the first one.
    step : float
        Time step, s.
    quantity : {"displacement", "acceleration"}
        Which of the two is returned.

    Returns
    -------
    ndarray, shape (k, times)
    """
    from scipy.signal import cont2discrete, lfilter  # slow to load

    numerator = [1.0] if quantity == "displacement" else [1.0, 0.0, 0.0]
    response = np.empty(force.shape)
    for k, (w, c) in enumerate(zip(omega, damping, strict=True)):
        b, a, _ = cont2discrete((numerator, [1.0, c, w**2]), step, "foh")
        response[k] = lfilter(b.ravel(), a, force[k])
    return response
