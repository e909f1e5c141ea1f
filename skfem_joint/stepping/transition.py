"""State transition of a period: how the state at its end depends on that at its start.

A step of the trapezoidal rule depends on displacement u, velocity v and acceleration d through two
vectors alone, the *advanced state*

    p = u + (h/2) v,        r = v + (h/2) d,

of displacement and velocity half a step ahead by Euler's method. A step solves
``H v1 + friction = f1 - K p + (2/h) M r`` with H = (2/h) M + C + (h/2) K, and leaves

    p1 = p + h v1,          r1 = 2 v1 - r.

In these coordinates a step is a reflected resolvent of a monotone operator (P.-L. Lions and B.
Mercier, SIAM J. Numer. Anal. 16, 1979): in the norm of energy, ``p K p + r M r``, two runs under
the same loads never move apart, whatever the step. Its derivative follows from the tangent of the
step problem at the velocity v1,

    dv1 = T^-1 (-K dp + (2/h) M dr),        T = H + B^T (w sigma'(B v1)) B.

Coulomb points that stick keep v1 = 0: their unknowns are left out of T. Unknowns that stick in all
steps of a period are left out of the transition.

Elastic contact that opens presses with p(u1) at u1 = p + (h/2) v1, and the friction limits are
w = given + G p(u1). Both depend on the advanced state alone, too. With their tangent

    A = N^T p' N + B^T (sigma (G p' N)),        p' the stiffness where p > 0, else 0,

K is K + A in the derivative and T has (h/2) A beside the tangent of friction under the limits now.
A is not symmetric, and such runs may move apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve

from skfem_joint.arrays import BoolArray, FloatArray, IntArray, as_dense
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.stepping.schemes import State
from skfem_joint.system import System


def advanced(state: State, h: float) -> FloatArray:
    """Advanced state (2 n,), p (m) and r (m/s), of a state before a step of ``h`` seconds."""
    return np.concatenate([state.u + 0.5 * h * state.v, state.v + 0.5 * h * state.d])


def state_of(x: FloatArray, sigma: FloatArray, h: float) -> State:
    """A state of an advanced state (2 n,): that without acceleration. ``sigma`` is its friction."""
    p, r = np.split(x, 2)
    none = np.zeros_like(p)
    return State(p - 0.5 * h * r, r.copy(), none, none.copy(), sigma.copy())


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
        and r, is divided by with omega, N s/m; see `skfem_joint.stepping.sprung_transition`.
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
        At the ends of the steps, m, of a dense system with elastic contact that opens.
    """
    points = ContactPoints.of(system)
    resting = unknowns_at_rest(points, velocities)
    moving = np.flatnonzero(~resting.all(axis=0))
    if displacements is not None:
        matrix = _of_opening(system, points, h, displacements, velocities, omega)
    elif kind == "chain":
        matrix = _of_chain(system, points, h, velocities, resting, moving, omega)
    else:
        picks = kind == "contact"
        matrix = _of_dense(system, points, picks, h, velocities, resting, moving, omega)
    return Transition(moving, matrix, omega)


def _of_dense(
    system: System,
    points: ContactPoints,
    picks: bool,
    h: float,
    velocities: FloatArray,
    resting: BoolArray,
    moving: IntArray,
    omega: float,
) -> FloatArray:
    """Matrix of a transition by dense algebra on the moving unknowns."""
    k = moving.size
    M, C, K = (as_dense(A[moving][:, moving]) for A in (system.M, system.C, system.K))
    H = (2.0 / h) * M + C + (0.5 * h) * K
    driving = np.hstack([-K, (2.0 / h * omega) * M])
    friction = _FrictionTangent(system, points, moving, picks)
    X = np.eye(2 * k)
    for v, rests in zip(velocities, resting[:, moving], strict=True):
        T, right = friction.added(H, v), driving
        free: slice | NDArray[np.intp] = slice(None)
        if rests.any():
            free = np.flatnonzero(~rests)
            T, right = T[np.ix_(free, free)], driving[free]
        image = right @ X
        p, r = X[:k], X[k:]
        r *= -1.0
        if len(T):
            dv = cho_solve(cho_factor(T, lower=True, check_finite=False), image, check_finite=False)
            r[free] += (2.0 / omega) * dv
            p[free] += h * dv
    return X


def _of_opening(
    system: System,
    points: ContactPoints,
    h: float,
    displacements: FloatArray,
    velocities: FloatArray,
    omega: float,
) -> FloatArray:
    """Matrix of a transition of a dense system with elastic contact that opens."""
    from skfem_joint.minimise.law import force_vectors  # loads the compiler

    n, contact = system.n, system.contact.normal
    M, C, K, B, N = map(as_dense, (system.M, system.C, system.K, system.contact.B, contact.N))
    H = (2.0 / h) * M + C + (0.5 * h) * K
    rubs = system.contact.rubs
    friction = _FrictionTangent(system, replace(points, w=rubs.astype(float)), np.arange(n), False)
    beta = np.where(rubs, system.contact.beta, 0.0)
    X = np.eye(2 * n)
    for u, v in zip(displacements, velocities, strict=True):
        force = contact.elastic_forces(u)
        limits = system.contact.limits(force)
        stiff = np.where(force > 0.0, contact.stiffness, 0.0)[:, np.newaxis] * N
        of_limits = np.where(limits > 0.0, 1.0, 0.0)[:, np.newaxis] * (system.contact.gain @ stiff)
        sigma = force_vectors(B @ v, beta, system.contact.directions)[:, np.newaxis]
        A = N.T @ stiff + B.T @ (sigma * np.repeat(of_limits, system.contact.directions, axis=0))
        T = friction.added(H, v, limits) + (0.5 * h) * A
        p, r = X[:n], X[n:]
        dv = solve(T, (2.0 / h * omega) * (M @ r) - (K + A) @ p, check_finite=False)
        r *= -1.0
        r += (2.0 / omega) * dv
        p += h * dv
    return X


class _FrictionTangent:
    """Adds the tangent of friction to dense matrices of some unknowns.

    ``picks`` is whether each slip row picks an unknown.
    """

    def __init__(
        self, system: System, points: ContactPoints, unknowns: IntArray, picks: bool
    ) -> None:
        self.B, self.picks = system.contact.B, picks
        rubs = points.w > 0.0
        if picks:  # points that stick all the time have no rows in the matrices
            rubs[rubs] = np.isin(points.unknowns[points.first_row[:-1][rubs]], unknowns)
        self.rubs, self.first = rubs, points.first_row[:-1][rubs]
        self.w, self.beta = points.w[rubs], points.beta[rubs]
        self.pairs = np.flatnonzero(points.directions[rubs] == 2)
        self.second = self.first[self.pairs] + 1
        if picks:
            place = np.full(system.n, -1, dtype=np.intp)
            place[unknowns] = np.arange(unknowns.size)
            self.i, self.j = place[points.unknowns[self.first]], place[points.unknowns[self.second]]
        else:
            own = self.B[:, unknowns]
            self.rows = as_dense(own[self.first]), as_dense(own[self.second])

    def added(self, H: FloatArray, v: FloatArray, limits: FloatArray | None = None) -> FloatArray:
        """H plus the tangent at the velocities v (n,) of all unknowns.

        ``limits`` (m,) are those of all points, N, if not the constant ones.
        """
        if not self.w.size:
            return H
        from skfem_joint.minimise.law import along_and_across, slip_tangent  # loads the compiler

        w = self.w if limits is None else limits[self.rubs]
        slip, pairs = self.B @ v, self.pairs
        one, two = slip[self.first], slip[self.second]
        size = np.abs(one)
        size[pairs] = np.hypot(one[pairs], two)
        along, across = (w * part for part in along_and_across(size, self.beta))
        norm = np.where(size > 0.0, size, 1.0)[pairs]
        x, y, own = one[pairs] / norm, two / norm, along
        own[pairs], cross, other = slip_tangent(along[pairs], across[pairs], x, y, x, y)
        if self.picks:
            T, i, j = H.copy(), self.i, self.j
            T[i, i] += own
            T[j, j] += other
            T[i[pairs], j] += cross
            T[j, i[pairs]] += cross
            return T
        first, second = self.rows
        T = H + (first.T * own) @ first
        if pairs.size:
            mixed = (first[pairs].T * cross) @ second
            T += (second.T * other) @ second + mixed + mixed.T
        return np.asarray(T)


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
    from skfem_joint.stepping.chain_transition import carry_through

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
