"""State transition of a period where friction has springs in series.

With springs of stiffness k under the forces q, a step of the trapezoidal rule depends on the
advanced state (:mod:`skfem_joint.stepping.transition`) and on the *advanced forces*

    e = q + k (h/2) B v,

those half a step ahead if all sliders stuck. With kappa = k h/2 a step finds the force
``q1 = w sigma(B v1 + e / kappa)`` at its end and leaves ``e1 = q1 + kappa B v1``. Its derivative is

    dv1 = T^-1 (-K dp + (2/h) M dr - B^T G de / kappa),      T = H + B^T G B,
    de1 = G (B dv1 + de / kappa) + kappa B dv1,

with the tangents G of the points' laws. Coordinates of the forces are e / (kappa omega).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from skfem_joint.arrays import FloatArray, IntArray, as_dense
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.stepping.transition import Transition, unknowns_at_rest
from skfem_joint.system import System


@dataclass(frozen=True)
class Springs:
    """Springs in series with friction, by slip row.

    Attributes
    ----------
    system : System
    rows : ndarray of int, shape (s,)
        Slip rows that have them.
    stiffness, limit : ndarray, shape (s,)
        Stiffness, N/m, and friction limit, N, of each.
    half : float
        Half a step, s.
    """

    system: System
    rows: IntArray
    stiffness: FloatArray
    limit: FloatArray
    half: float

    @staticmethod
    def of(system: System, h: float) -> Springs:
        """Springs of a system for steps of ``h`` seconds."""
        rows = np.flatnonzero(system.contact.on_rows(system.contact.sprung))
        values = (
            system.contact.on_rows(system.contact.stiffness)[rows],
            system.contact.on_rows(system.contact.w)[rows],
        )
        return Springs(system, rows, *values, 0.5 * h)

    def advanced(self, v: FloatArray, sigma: FloatArray) -> FloatArray:
        """Advanced forces (s,), N, at velocities (n,) and friction over its limit (rows,)."""
        if not self.rows.size:
            return np.zeros(0)
        ahead = self.half * self.stiffness * np.asarray(self.system.contact.B @ v)[self.rows]
        return np.asarray(self.limit * sigma[self.rows] + ahead)

    def friction(self, e: FloatArray, v: FloatArray, sigma: FloatArray) -> FloatArray:
        """Friction over its limit (rows,) with that of springs under advanced forces ``e``."""
        sigma = sigma.copy()
        ahead = self.half * self.stiffness * np.asarray(self.system.contact.B @ v)[self.rows]
        sigma[self.rows] = (e - ahead) / self.limit
        return sigma


def sprung_transition(
    system: System, h: float, velocities: FloatArray, sigma: FloatArray, omega: float
) -> Transition:
    """Transition of steps of the trapezoidal rule of a system with springs.

    Parameters
    ----------
    system : System
        In stepping unknowns.
    h : float
        Step, s.
    velocities, sigma : ndarray, shape (steps + 1, n) and (steps + 1, rows)
        At the start and at the ends of the steps: m/s, and friction over its limit.
    omega : float
        See `Transition`.
    """
    points, springs = ContactPoints.of(system, 0.5 * h, h), Springs.of(system, h)
    resting = unknowns_at_rest(points, velocities[1:])
    moving = np.flatnonzero(~resting.all(axis=0))
    k, s = moving.size, springs.rows.size
    kappa = springs.half * springs.stiffness
    M, C, K = (as_dense(A[moving][:, moving]) for A in (system.M, system.C, system.K))
    H = (2.0 / h) * M + C + (0.5 * h) * K
    B = as_dense(system.contact.B[:, moving])
    own = B[springs.rows]
    X = np.eye(2 * k + s)
    driving = np.hstack([-K, (2.0 / h * omega) * M, np.zeros((k, s))])
    slips = _slips(system, springs, velocities, sigma)
    for slip, rests in zip(slips, resting[:, moving], strict=True):
        G = _tangent(points, slip)
        of_springs = G[:, springs.rows] * omega
        free = np.flatnonzero(~rests)
        T = (H + B.T @ G @ B)[np.ix_(free, free)]
        driven = driving.copy()
        driven[:, 2 * k :] = -(B.T @ of_springs)
        p, r, z = X[:k], X[k : 2 * k], X[2 * k :]
        dv = np.zeros((k, X.shape[1]))
        if free.size:
            dv[free] = linalg.solve(T, (driven @ X)[free], assume_a="pos", check_finite=False)
        slip_rate = own @ dv
        force = G[springs.rows] @ (B @ dv) + of_springs[springs.rows] @ z
        X = np.vstack(
            [
                p + h * dv,
                (2.0 / omega) * dv - r,
                (force / kappa[:, np.newaxis] + slip_rate) / omega,
            ]
        )
    return Transition(moving, X, omega, kappa)


def _slips(
    system: System, springs: Springs, velocities: FloatArray, sigma: FloatArray
) -> FloatArray:
    """Slips at which the laws of all rows are evaluated at the ends of steps, m/s."""
    slips = np.asarray((system.contact.B @ velocities[1:].T).T)
    before = zip(velocities[:-1], sigma[:-1], strict=True)
    e = np.array([springs.advanced(v, own) for v, own in before])
    slips[:, springs.rows] += e / (springs.half * springs.stiffness)
    return slips


def _tangent(points: ContactPoints, slip: FloatArray) -> FloatArray:
    """Tangent (rows, rows), N s/m, of the forces of all points at slips (rows,), m/s.

    Zero at rest under Coulomb friction without springs, where unknowns stick.
    """
    from skfem_joint.minimise.law import along_and_across, slip_tangent  # loads the compiler

    first, pair = points.first_row[:-1], points.directions == 2
    second = first[pair] + 1
    size = np.abs(slip[first])
    size[pair] = np.hypot(slip[first[pair]], slip[second])
    laws = along_and_across(size, points.beta, points.soft)
    along, across = (points.w * part for part in laws)
    G = np.zeros((slip.size, slip.size))
    G[first, first] = along
    first, norm = first[pair], np.where(size > 0.0, size, 1.0)[pair]
    x, y = slip[first] / norm, slip[second] / norm
    own, mixed, G[second, second] = slip_tangent(along[pair], across[pair], x, y, x, y)
    G[first, first], G[first, second], G[second, first] = own, mixed, mixed
    return G
