"""State transition of a period: how the state at its end depends on that at its start.

From the advanced state p and r (:mod:`skfem_joint.steady.advanced`) a step of the trapezoidal
rule solves ``H v1 + friction = f1 - K p + (2/h) M r`` with H = (2/h) M + C + (h/2) K, and leaves

    p1 = p + h v1,          r1 = 2 v1 - r.

In these coordinates a step is a reflected resolvent of a monotone operator (P.-L. Lions and B.
Mercier, SIAM J. Numer. Anal. 16, 1979): in the norm of energy, ``p K p + r M r``, two runs under
the same loads never move apart, whatever the step. Its derivative is what the linearisation of the
step problem (:mod:`skfem_joint.minimise.linearisation`) makes of the right side

    dg = -K dp + (2/h) M dr.

Unknowns of Coulomb points that stick in all steps of a period are left out of the transition.

With springs in series with friction, and kappa = k h/2, slips count from the offset -e / kappa, and
a step with the force q1 at its end leaves the advanced forces e1 = q1 + kappa B v1. Coordinates of
these are e / (kappa omega).

Elastic contact that opens presses at u1 = p + (h/2) v1, so that the bounds of the approaches change
by -(2/h) N dp. Friction limits that follow its forces make the tangent unsymmetric, and such runs
may move apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, as_dense
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.steady.advanced import Springs
from skfem_joint.system.system import System


@dataclass(frozen=True)
class Transition:
    """Derivative of the advanced state after some steps in that before them.

    Attributes
    ----------
    moving : ndarray of int, shape (k,)
        Unknowns that do not stick in all steps; the rows and columns of the matrix are their p, and
        their r over ``omega``.
    matrix : ndarray, shape (2 k, 2 k)
    omega : float
        Frequency, rad/s, that makes p and r alike in size.
    springs : ndarray, shape (s,)
        Where friction has springs in series, force of each that its coordinate, beyond those of p
        and r, is divided by with omega, N s/m; see the module.
    """

    moving: IntArray
    matrix: FloatArray
    omega: float
    springs: FloatArray = field(default_factory=lambda: np.zeros(0))

    def restricted(self, x: FloatArray) -> FloatArray:
        """Part (2 k + s,) of an advanced state (2 n + s,), in the coordinates of the matrix."""
        p, r = np.split(x[: x.size - self.springs.size], 2)
        forces = x[x.size - self.springs.size :] / (self.springs * self.omega)
        return np.concatenate([p[self.moving], r[self.moving] / self.omega, forces])

    def extended(self, x: FloatArray, part: FloatArray) -> FloatArray:
        """Copy of an advanced state (2 n + s,) with another ``part`` (2 k + s,)."""
        x, k, s = x.copy(), self.moving.size, self.springs.size
        x[self.moving] = part[:k]
        x[(x.size - s) // 2 + self.moving] = self.omega * part[k : 2 * k]
        x[x.size - s :] = self.omega * self.springs * part[2 * k :]
        return x


def unknowns_at_rest(points: ContactPoints, velocities: FloatArray) -> BoolArray:
    """Which unknowns stick under Coulomb friction at some velocities, (steps, n) of both.

    Each slip row picks an unknown, except where no point obeys Coulomb's law.
    """
    resting = np.zeros(velocities.shape, dtype=np.bool_)
    coulomb = (points.w > 0.0) & np.isinf(points.beta) & ~points.has_spring
    if coulomb.any():
        rows = np.flatnonzero(points.on_rows(coulomb))
        still = velocities[:, points.unknowns[rows]] == 0.0
        first = np.cumsum(points.directions[coulomb]) - points.directions[coulomb]
        both = np.logical_and.reduceat(still, first, axis=1)
        resting[:, points.unknowns[rows]] = np.repeat(both, points.directions[coulomb], axis=1)
    return resting


def moving_unknowns(system: System, velocities: FloatArray) -> IntArray:
    """Unknowns that do not stick at all of some velocities, (steps, n)."""
    resting = unknowns_at_rest(ContactPoints.of(system), velocities)
    return np.flatnonzero(~resting.all(axis=0))


def transition(
    system: System,
    kind: str,
    h: float,
    velocities: FloatArray,
    omega: float,
    displacements: FloatArray | None = None,
    forces: FloatArray | None = None,
) -> Transition:
    """Transition of steps of the trapezoidal rule.

    Parameters
    ----------
    system : System
        In stepping unknowns.
    kind : str
        Of the system, see :func:`skfem_joint.stepping.arrangement.arranged`.
    h : float
        Step, s.
    velocities : ndarray, shape (steps, n)
        At the ends of the steps, m/s.
    omega : float
        See `Transition`.
    displacements : ndarray, shape (steps, n), optional
        At the ends of the steps, m; needed with contact that opens, which must be elastic.
    forces : ndarray, shape (steps, s), optional
        Advanced forces at the starts of the steps, N; needed with springs in series with friction.
    """
    points, springs = ContactPoints.of(system, 0.5 * h, h), Springs.of(system, h)
    resting = unknowns_at_rest(points, velocities)
    moving = np.flatnonzero(~resting.all(axis=0))
    if kind == "chain" and not springs.rows.size:
        matrix = _of_chain(system, points, h, velocities, resting, moving, omega)
        return Transition(moving, matrix, omega)
    from skfem_joint.minimise.linearisation import (  # loads the compiler
        Changes,
        Linearisation,
        RowLinearisation,
    )

    contact, k = system.contact, moving.size
    slips = np.asarray((contact.B @ velocities.T).T)
    if forces is not None:
        slips[:, springs.rows] += forces / springs.by_step
    w = p = None
    if displacements is not None:
        p = contact.normal.elastic_forces(displacements)
        w = contact.limits(p.T).T
    M, C, K = (as_dense(A[moving][:, moving]) for A in (system.M, system.C, system.K))
    H = (2.0 / h) * M + C + (0.5 * h) * K
    method = RowLinearisation if kind == "dense" else Linearisation
    linear = method(H, points.in_unknowns(moving))
    driving = np.hstack([-K, (2.0 / h * omega) * M])
    X = np.eye(2 * k + springs.rows.size)
    u, r, e = X[:k], X[k : 2 * k], X[2 * k :]
    offset = bound = limits = None
    for at in linear.at(slips, w, p):
        if e.size:
            offset = np.zeros((slips.shape[1], len(X)))
            offset[springs.rows] = -omega * e
        if contact.opens:
            bound = (-2.0 / h) * (contact.normal.N @ u)
        v, normal = linear.solve(at, Changes(driving @ X[: 2 * k], offset, None, bound))
        if offset is not None:
            slip, limits = linear.B @ v, contact.gain @ normal if contact.opens else None
            force = linear.friction(at, slip - offset, limits)[springs.rows]
            e[:] = (force / springs.by_step[:, np.newaxis] + slip[springs.rows]) / omega
        r *= -1.0
        r += (2.0 / omega) * v
        u += h * v
    return Transition(moving, X, omega, springs.by_step)


def _of_chain(
    system: System,
    points: ContactPoints,
    h: float,
    velocities: FloatArray,
    resting: BoolArray,
    moving: IntArray,
    omega: float,
) -> FloatArray:
    """Matrix of a transition of a chain, whose step matrices are tridiagonal, by elimination."""
    from skfem_joint.linalg.kernels import bands
    from skfem_joint.minimise.law import along_and_across
    from skfem_joint.steady.chain_transition import carry_through

    k, n, unknowns = moving.size, system.n, points.unknowns
    M, C, K = (bands(A) for A in (system.M, system.C, system.K))
    H = type(M)(*((2.0 / h) * m + c + (0.5 * h) * s for m, c, s in zip(M, C, K, strict=True)))
    tangents = np.zeros_like(velocities)
    rubs = points.w > 0.0
    slopes = along_and_across(np.abs(velocities[:, unknowns[rubs]]), points.beta[rubs])[0]
    tangents[:, unknowns[rubs]] = points.w[rubs] * slopes
    tangents[resting] = np.inf
    p, r, work = np.zeros((3, n, 2 * k))
    p[moving, np.arange(k)] = 1.0
    r[moving, k + np.arange(k)] = omega
    carry_through(M, K, H, h, tangents, p, r, work, np.zeros(n))
    return np.vstack([p[moving], r[moving] / omega])
