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
    number : int
        Of the mode, from 1.
    looked_at : ndarray, shape (n,)
        Displacement l whose first harmonic is the amplitude, from the unknowns of the system.
    modal : float
        Modal amplitude, m kg^1/2, of a displacement of 1 m, by which unknowns are scaled.
    point : int or None
        Number of the named point that is looked at; None for the modal amplitude.
    """

    balance: Balance
    number: int
    looked_at: FloatArray
    modal: float
    point: int | None = None

    def __call__(
        self, y: FloatArray, parameter: float, tangents: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual of ``y`` at the logarithm of an amplitude, and derivatives by both."""
        balance = self.balance
        series, n, reference = balance.series, balance.frequencies.size, balance.reference
        residual = balance.residual(*self.motion(y, parameter), tangents=tangents)
        weights, size = 1.0 / balance.scale, series.size * n
        by = 1.0 / (float(np.exp(parameter)) * self.modal * reference)
        functional = (balance.Phi.T @ self.looked_at) * weights * self.modal * reference
        first = series.first * n
        values = np.empty(size + 2)
        values[:size] = (residual.values * weights).ravel() * by
        values[size:] = y[first : first + 2 * n].reshape(2, n) @ functional - [1.0, 0.0]
        if residual.derivative is None:
            return values, np.zeros((0, 0)), np.zeros(0)
        derivative, by_parameter = np.zeros((size + 2, size + 2)), np.zeros(size + 2)
        own = residual.derivative
        own *= weights[:, np.newaxis, np.newaxis]
        own *= weights
        derivative[:size, :size] = own.reshape(size, size)
        derivative[:size, size] = (residual.by_omega * weights).ravel() * (by * reference)
        derivative[:size, size + 1] = (residual.by_zeta * weights).ravel() * by
        derivative[size, first : first + n] = functional
        derivative[size + 1, first + n : first + 2 * n] = functional
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

    def linear(self, parameter: float) -> FloatArray:
        """Scaled unknowns of the linear mode with stuck and closed contact."""
        balance, mode = self.balance, self.number - 1
        q = np.zeros((balance.series.size, balance.frequencies.size))
        moved = float(self.looked_at @ balance.Phi[:, mode])
        q[balance.series.first, mode] = float(np.exp(parameter)) / moved
        omega = float(balance.frequencies[mode])
        return self.scaled(q, omega, 0.5 * float(balance.C[mode, mode]) / omega, parameter)
