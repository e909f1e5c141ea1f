"""Equations of a nonlinear mode: periodic motion of a given amplitude, kept up by its own inertia.

Unknowns are the coefficients of q, the angular frequency omega, the damping ratio zeta, and the
amplitude a, which is the parameter. Two more equations fix the amplitude and the phase of a
displacement that is looked at,

    l c_1 = a,   l s_1 = 0.

A mode is followed by its arc length in a metric of the relative changes of the motion, by the mass
and without its mean, and of omega, and of the change of zeta. The amplitude has no part in it: it
may vanish where a node of the mode passes the point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.harmonic.balance import Balance
from skfem_joint.harmonic.newton import CHANGE
from skfem_joint.harmonic.series import FourierSeries

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
        Modal amplitude, m kg^1/2, of a displacement of 1 m, by which residuals are scaled.
    point : int or None
        Number of the named point that is looked at; None for the modal amplitude.
    unique : bool
        See `Equations`: a mode may turn in its amplitude.
    """

    balance: Balance
    number: int
    shape: FloatArray
    looked_at: FloatArray
    modal: float
    point: int | None = None
    unique: bool = False

    def refined(self, series: FourierSeries) -> ModeEquations:
        """Same equations of another series."""
        return replace(self, balance=self.balance.refined(series))

    def __call__(self, x: FloatArray, tangents: bool) -> tuple[FloatArray, FloatArray]:
        """See `Equations`."""
        balance, (q, omega, zeta, amplitude) = self.balance, self.parts(x)
        if omega <= 0.0:  # too far away: the line search comes back
            return np.full(x.size - 1, np.inf), np.zeros((0, 0))
        found = balance.residual(q, omega, zeta, tangents=tangents)
        size, first, seen = q.size, balance.series.first, balance.Phi.T @ self.looked_at
        values = np.append(found.values, q[first : first + 2] @ seen - [amplitude, 0.0])
        if found.derivative is None:
            return values, np.zeros((0, 0))
        derivative = np.zeros((x.size - 1, x.size))
        derivative[:size, :size] = found.derivative.reshape(size, size)
        derivative[:size, size] = found.by_omega.ravel()
        derivative[:size, size + 1] = found.by_zeta.ravel()
        for row in range(2):
            a = (first + row) * seen.size
            derivative[size + row, a : a + seen.size] = seen
        derivative[size, -1] = -1.0
        return values, derivative

    def rows(self, x: FloatArray) -> FloatArray:
        """See `Equations`."""
        size = float(np.linalg.norm(x[:-3]))
        return np.append(self.balance.rows(size), np.full(2, self.modal / size))

    def metric(self, x: FloatArray) -> FloatArray:
        """See `Equations`."""
        of_motion = self.balance.metric(CHANGE * float(np.linalg.norm(x[:-3])))
        return np.append(of_motion, [(CHANGE * x[-3]) ** -2, CHANGE**-2, 0.0])

    def parts(self, x: FloatArray) -> tuple[FloatArray, float, float, float]:
        """Coefficients (nh, n) of q, omega (rad/s), zeta and amplitude of all unknowns."""
        return x[:-3].reshape(self.balance.series.size, -1), *x[-3:].tolist()

    def upright(self, x: FloatArray) -> FloatArray:
        """Same motion with a positive amplitude, by half of a period later if need be."""
        q, *rest, amplitude = self.parts(x)
        if amplitude >= 0.0:
            return x
        sign = (-1.0) ** self.balance.series.coefficient_orders[:, np.newaxis]
        return np.append(sign * q, [*rest, -amplitude])

    def linear(self, amplitude: float) -> FloatArray:
        """Unknowns of the linear mode with stuck and closed contact."""
        balance, mass = self.balance, as_dense(self.balance.system.M)
        mode = int(np.abs(balance.Phi.T @ (mass @ self.shape)).argmax())
        q = np.zeros((balance.series.size, balance.frequencies.size))
        q[balance.series.first, mode] = amplitude / float(self.looked_at @ balance.Phi[:, mode])
        omega = float(balance.frequencies[mode])
        return np.append(q, [omega, 0.5 * float(balance.C[mode, mode]) / omega, amplitude])

    def near(self, x: FloatArray, other: FloatArray) -> bool:
        """Whether two solutions are of one mode: alike in frequency and in the first harmonic."""
        first = self.balance.series.first
        one, two = (self.parts(y)[0][first : first + 2].ravel() for y in (x, other))
        alike = float(one @ two) > ALIKE * float(np.linalg.norm(one) * np.linalg.norm(two))
        return alike and abs(float(x[-3] / other[-3]) - 1.0) < APART
