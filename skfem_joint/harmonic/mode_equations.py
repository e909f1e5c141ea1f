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

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.harmonic.balance import Balance

#: Least correlation of the first harmonics, and largest relative difference in frequency, of
#: neighbouring solutions: others are of another mode, to which the iteration went over.
ALIKE, APART = 0.8, 0.1


@dataclass(frozen=True)
class ModeEquations:
    """Equations of a mode.

    Attributes
    ----------
    balance : Balance
    number : int
        Of the mode, from 1.
    shape : ndarray, shape (n,)
        Mode with the contact stuck, of unit mass.
    looked_at : ndarray, shape (n,)
        Displacement l whose first harmonic is the amplitude, from the unknowns of the system.
    modal : float
        Modal amplitude, m kg^1/2, of a displacement of 1 m, by which unknowns are scaled.
    point : int or None
        Number of the named point that is looked at; None for the modal amplitude.
    """

    balance: Balance
    number: int
    shape: FloatArray
    looked_at: FloatArray
    modal: float
    point: int | None = None

    def __call__(
        self, y: FloatArray, parameter: float, tangents: bool
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual of ``y`` at the logarithm of an amplitude, and derivatives by both."""
        balance = self.balance
        series, n, reference = balance.series, balance.frequencies.size, balance.reference
        q, omega, zeta = self.motion(y, parameter)
        if omega <= 0.0:  # too far away: the line search comes back
            return np.full(y.size, np.inf), np.zeros((0, 0)), np.zeros(0)
        residual = balance.residual(q, omega, zeta, tangents=tangents)
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
        balance, mass = self.balance, as_dense(self.balance.system.M)
        mode = int(np.abs(balance.Phi.T @ (mass @ self.shape)).argmax())
        q = np.zeros((balance.series.size, balance.frequencies.size))
        moved = float(self.looked_at @ balance.Phi[:, mode])
        q[balance.series.first, mode] = float(np.exp(parameter)) / moved
        omega = float(balance.frequencies[mode])
        return self.scaled(q, omega, 0.5 * float(balance.C[mode, mode]) / omega, parameter)

    def near(self, y: FloatArray, other: FloatArray) -> bool:
        """Whether two solutions are of one mode: alike in frequency and in the first harmonic."""
        n, first = self.balance.frequencies.size, self.balance.series.first
        one, two = (
            x[first * n : (first + 2) * n] * np.tile(1.0 / self.balance.scale, 2)
            for x in (y, other)
        )
        alike = float(one @ two) > ALIKE * float(np.linalg.norm(one) * np.linalg.norm(two))
        return alike and abs(float(y[-2] / other[-2]) - 1.0) < APART
