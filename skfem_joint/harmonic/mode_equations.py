"""Equations of a nonlinear mode: periodic motion of a given amplitude, kept up by its own inertia.

Unknowns are the coefficients of q over the amplitude, the angular frequency omega and the damping
ratio zeta; two more equations fix the amplitude and the phase of a displacement that is looked at,

    l c_1 = a,   l s_1 = 0.

All are scaled to be of size 1, and divided by the amplitude: a linear mode does not change with it.
The parameter is the logarithm of the amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.harmonic.balance import Balance


@dataclass(frozen=True)
class ModeEquations:
    """Equations of a mode.

    Attributes
    ----------
    balance : Balance
    looked_at : ndarray, shape (n,)
        Displacement l whose first harmonic is the amplitude, from the unknowns of the system.
    modal : float
        Modal amplitude, m kg^1/2, of a displacement of 1 m, by which unknowns are scaled.
    """

    balance: Balance
    looked_at: FloatArray
    modal: float

    def __call__(
        self, y: FloatArray, parameter: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual of ``y`` at the logarithm of an amplitude, and derivatives by both."""
        balance, a = self.balance, float(np.exp(parameter))
        series, n = balance.series, balance.frequencies.size
        q, omega, zeta = self.motion(y, parameter)
        residual = balance.residual(q, omega, zeta)
        weights, size, reference = 1.0 / balance.scale, series.size * n, balance.reference
        by = 1.0 / (a * self.modal * reference)
        functional = (balance.Phi.T @ self.looked_at) * weights * self.modal * reference
        first = series.first * n
        values = np.zeros(size + 2)
        values[:size] = (residual.values * weights).ravel() * by
        values[size:] = y[first : first + 2 * n].reshape(2, n) @ functional - [1.0, 0.0]
        derivative = np.zeros((size + 2, size + 2))
        assert residual.derivative is not None
        J = residual.derivative
        J *= weights[:, np.newaxis, np.newaxis]
        J *= weights
        derivative[:size, :size] = J.reshape(size, size)
        derivative[:size, size] = (residual.by_omega * weights).ravel() * (by * reference)
        derivative[:size, size + 1] = (residual.by_zeta * weights).ravel() * by
        derivative[size, first : first + n] = functional
        derivative[size + 1, first + n : first + 2 * n] = functional
        by_parameter = np.zeros(size + 2)
        by_parameter[:size] = derivative[:size, :size] @ y[:size] - values[:size]
        return values, derivative, by_parameter

    def motion(self, y: FloatArray, parameter: float) -> tuple[FloatArray, float, float]:
        """Coefficients (nh, n) of q, omega (rad/s) and zeta of scaled unknowns."""
        balance = self.balance
        by = float(np.exp(parameter)) * self.modal * balance.reference
        q = y[:-2].reshape(balance.series.size, -1) * (by / balance.scale)
        return q, float(y[-2]) * balance.reference, float(y[-1])

    def scaled(self, q: FloatArray, omega: float, zeta: float, parameter: float) -> FloatArray:
        """Scaled unknowns of a motion: the inverse of `motion`."""
        balance = self.balance
        by = float(np.exp(parameter)) * self.modal * balance.reference
        return np.concatenate(
            [(q * (balance.scale / by)).ravel(), [omega / balance.reference, zeta]]
        )
