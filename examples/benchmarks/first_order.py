"""A bar with a joint as first-order equations for ready-made integrators, in their best form.

The unknowns are interleaved, y = (u_1, v_1, u_2, v_2, ...), which gives every Jacobian of a
tridiagonal system three lower and two upper bands. With A = (1, M), G = (0 -1, K C) and the
friction g(v) = B^T (w * sigma(B v)) the equations are

    residual:  A y' + G y + g(v) - f(t) = 0,    rates:  y' = A^-1 (f(t) - G y - g(v)).

The residual form keeps the bands with any tridiagonal mass. The rates do so with a lumped mass
alone: the inverse of the consistent one is full, which makes their Jacobian full.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Harmonic
from skfem_joint.minimise import law

#: Bands of the Jacobians below and above the diagonal.
LOWER, UPPER = 3, 2


def _equations(G, A, scale, w, beta, loads, now, y, rate, out):
    """``scale`` times loads minus friction, G y and A y'; bands as :func:`packed` gives them."""
    for i in range(w.size):
        force = -w[i] * (2.0 / math.pi) * math.atan(beta[i] * y[2 * i + 1])
        for k in range(now.size):
            force += loads[k, i] * now[k]
        out[2 * i], out[2 * i + 1] = 0.0, force
    for k in range(LOWER + UPPER + 1):
        shift = k - UPPER
        for j in range(max(0, -shift), min(y.size, y.size - shift)):
            out[j + shift] -= G[k, j] * y[j]
        if A.shape[0] > 0:
            for j in range(max(0, -shift), min(y.size, y.size - shift)):
                out[j + shift] -= A[k, j] * rate[j]
    for i in range(y.size):
        out[i] *= scale[i]


def _jacobian(G, A, c, w, beta, y, square, out):
    """Minus G + c A and the slope of the friction, into a square matrix or its bands."""
    for k in range(LOWER + UPPER + 1):
        shift = k - UPPER
        for j in range(max(0, -shift), min(y.size, y.size - shift)):
            value = -G[k, j]
            if A.shape[0] > 0:
                value -= c * A[k, j]
            if k == UPPER and j % 2 == 1:
                z = beta[j // 2] * y[j]
                value -= w[j // 2] * (2.0 / math.pi) * beta[j // 2] / (1.0 + z * z)
            out[j + shift if square else k, j] = value


@cache
def _compiled():
    """Compile the loops, as a user would who needs speed."""
    from numba import njit

    compiler = njit(cache=True, error_model="numpy")
    return compiler(_equations), compiler(_jacobian)


def lumped(system):
    """System with a lumped mass: the row sums of its mass matrix on the diagonal."""
    mass = np.asarray(system.M.sum(axis=1)).ravel()
    return replace(system, M=sparse.csr_array(sparse.diags_array(mass)))


def _scalar(load):
    """Amplitude of a load as a function of time; a sine avoids numpy's overhead."""
    if isinstance(load, Harmonic):
        amplitude, omega, phase = load.amplitude, 2.0 * math.pi * load.frequency, load.phase
        return lambda t: amplitude * math.sin(omega * t + phase)
    return lambda t: float(load(t))


class FirstOrder:
    """First-order form of a tridiagonal system of the arctan law, one unknown in a slip row."""

    def __init__(self, system):
        points, B = system.contact, sparse.csr_array(system.contact.B)
        if system.is_dense or np.any(np.diff(B.indptr) != 1):
            raise InputError("first-order form: must be given a bar, one unknown in each slip row")
        if np.abs(np.subtract(*system.K.nonzero())).max() > 1:
            raise InputError("first-order form: must be given nodes numbered along the bar")
        if np.any(np.isinf(points.beta[points.w > 0.0])):
            raise InputError("first-order form: set-valued Coulomb friction has no Jacobian")
        self.system, self.size = system, 2 * system.n
        contact, unit = B.indices, sparse.eye_array(system.n)
        self.w, self.beta = np.zeros(system.n), np.ones(system.n)
        self.w[contact] = points.w
        self.beta[contact] = np.where(points.w > 0.0, points.beta, 1.0)
        order = np.arange(self.size).reshape(2, -1).T.ravel()
        A = sparse.block_diag([unit, system.M], format="csr")
        G = sparse.block_array([[None, -unit], [system.K, system.C]], format="csr")
        self.A, self.G = (sparse.csr_array(X[order][:, order]) for X in (A, G))
        self.none = np.zeros((0, self.size))

    def _filled(self, A, scale):
        """Function ``fill(t, y, rate, out)`` of the compiled equations."""
        compiled, w, beta, G = _compiled()[0], self.w, self.beta, packed(self.G)
        loads = [_scalar(load.amplitude) for load in self.system.loads]
        vectors = np.ascontiguousarray(self.system.load_vectors().T)
        now = np.zeros(len(loads))

        def fill(t, y, rate, out):
            for k, load in enumerate(loads):
                now[k] = load(t)
            compiled(G, A, scale, w, beta, vectors, now, y, rate, out)

        return fill

    def residual(self):
        """Function ``residual(t, y, rate, out)`` of the negative residual."""
        return self._filled(packed(self.A), np.ones(self.size))

    def rates(self):
        """Function ``rates(t, y, out)`` for a lumped mass."""
        fill = self._filled(self.none, 1.0 / self.A.diagonal())
        return lambda t, y, out: fill(t, y, y, out)

    def initial_rate(self, y):
        """Rates at the start for any mass matrix."""
        force, rest = np.zeros((2, self.size))
        self.residual()(0.0, y, rest, force)
        return spsolve(self.A.tocsc(), force)

    def residual_jacobian(self):
        """Function ``jacobian(y, c, out)``: minus the derivative by y and c times that by rates."""
        A, G, w, beta, compiled = packed(self.A), packed(self.G), self.w, self.beta, _compiled()[1]
        return lambda y, c, out: compiled(G, A, c, w, beta, y, True, out)

    def rate_jacobian(self, square):
        """Function ``jacobian(y, out)`` of the rates for a lumped mass, square or as bands."""
        scale, none, beta, compiled = 1.0 / self.A.diagonal(), self.none, self.beta, _compiled()[1]
        G, w = packed(sparse.diags_array(scale) @ self.G), self.w * scale[1::2]
        return lambda y, out: compiled(G, none, 0.0, w, beta, y, square, out)


def slip_work(system, u, v):
    """Friction energy (J) between samples of all unknowns, (samples, n), trapezoidal rule."""
    contact = system.contact
    force, slip = contact.w * law.force((contact.B @ v.T).T, contact.beta), contact.B @ u.T
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(slip.T, axis=0)))


def packed(A):
    """Bands of a matrix, entry (i, j) in ``[UPPER + i - j, j]``."""
    entries = sparse.coo_array(A)
    bands = np.zeros((LOWER + UPPER + 1, entries.shape[1]))
    bands[UPPER + entries.row - entries.col, entries.col] = entries.data
    return bands
