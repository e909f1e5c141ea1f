"""A bar with a joint as first-order equations for ready-made integrators, in their best form.

The unknowns are interleaved, y = (u_1, v_1, u_2, v_2, ...), which gives every Jacobian of a
tridiagonal system three lower and two upper bands. With A = (1, M), G = (0 -1, K C) and the
friction g(v) = B^T (w * sigma(B v)) the equations are

    residual:  A y' + G y + g(v) - f(t) = 0,    rates:  y' = A^-1 (f(t) - G y - g(v)).

The residual form keeps the bands with any tridiagonal mass. The rates do so with a lumped mass
alone: the inverse of the consistent one is full, which makes their Jacobian full.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from skfem_joint import friction
from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.loads import Harmonic
from skfem_joint.system import System

#: Bands of the Jacobians below and above the diagonal.
LOWER, UPPER = 3, 2


def _equations(
    G: Any, A: Any, scale: Any, w: Any, beta: Any, loads: Any, now: Any, y: Any, rate: Any, out: Any
) -> None:
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


def _jacobian(G: Any, A: Any, c: float, w: Any, beta: Any, y: Any, square: bool, out: Any) -> None:
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
def _compiled() -> tuple[Any, Any]:
    """Compile the loops: what a user in a hurry would do as well."""
    from numba import njit

    compiler = njit(cache=True, error_model="numpy")
    return compiler(_equations), compiler(_jacobian)


def lumped(system: System) -> System:
    """Same system with the row sums of its mass matrix on the diagonal."""
    mass = np.asarray(system.M.sum(axis=1)).ravel()
    return replace(system, M=sparse.csr_array(sparse.diags_array(mass)))


def _scalar(load: Any) -> Callable[[float], float]:
    """Amplitude at one time; without numpy's overhead where it is a sine."""
    if isinstance(load, Harmonic):
        amplitude, omega, phase = load.amplitude, 2.0 * math.pi * load.frequency, load.phase
        return lambda t: amplitude * math.sin(omega * t + phase)
    return lambda t: float(load(t))


@dataclass(frozen=True)
class FirstOrder:
    """First-order form of a tridiagonal system of the arctan law, one unknown in a slip row."""

    system: System

    def __post_init__(self) -> None:
        s = self.system
        if s.is_dense or np.any(np.diff(sparse.csr_array(s.B).indptr) != 1):
            raise InputError("first-order form: must be given a bar, one unknown in each slip row")
        if np.abs(np.subtract(*s.K.nonzero())).max() > 1:
            raise InputError("first-order form: must be given nodes numbered along the bar")
        if np.any(np.isinf(s.beta[s.w > 0.0])):
            raise InputError("first-order form: set-valued Coulomb friction has no Jacobian")

    @property
    def size(self) -> int:
        """Number of unknowns, displacements and velocities."""
        return 2 * self.system.n

    @cached_property
    def _friction(self) -> tuple[FloatArray, FloatArray]:
        """Limits and steepness of all unknowns."""
        contact = sparse.csr_array(self.system.B).indices
        w, beta = np.zeros(self.system.n), np.ones(self.system.n)
        w[contact], beta[contact] = self.system.w, self.system.beta
        return w, np.where(w > 0.0, beta, 1.0)

    @cached_property
    def _matrices(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """A and G."""
        s, one = self.system, sparse.eye_array(self.system.n)
        order = np.arange(self.size).reshape(2, -1).T.ravel()
        A = sparse.block_diag([one, s.M], format="csr")
        G = sparse.block_array([[None, -one], [s.K, s.C]], format="csr")
        return tuple(sparse.csr_array(X[order][:, order]) for X in (A, G))

    def _filled(self, A: FloatArray, scale: FloatArray) -> Callable[..., None]:
        """``fill(t, y, rate, out)`` with the compiled equations."""
        compiled, (w, beta), G = _compiled()[0], self._friction, packed(self._matrices[1])
        loads = [_scalar(load.amplitude) for load in self.system.loads]
        vectors = np.ascontiguousarray(self.system.load_vectors().T)
        now = np.zeros(len(loads))

        def fill(t: float, y: FloatArray, rate: FloatArray, out: FloatArray) -> None:
            for k, load in enumerate(loads):
                now[k] = load(t)
            compiled(G, A, scale, w, beta, vectors, now, y, rate, out)

        return fill

    def residual(self) -> Callable[[float, FloatArray, FloatArray, FloatArray], None]:
        """``residual(t, y, rate, out)``, its sign turned."""
        return self._filled(packed(self._matrices[0]), np.ones(self.size))

    def rates(self) -> Callable[[float, FloatArray, FloatArray], None]:
        """``rates(t, y, out)`` with a lumped mass."""
        fill = self._filled(np.zeros((0, self.size)), 1.0 / self._matrices[0].diagonal())
        return lambda t, y, out: fill(t, y, y, out)

    def initial_rate(self, y: FloatArray) -> FloatArray:
        """Rates at the start, from y, with any mass."""
        force, rest = np.zeros((2, self.size))
        self.residual()(0.0, y, rest, force)
        return np.asarray(spsolve(self._matrices[0].tocsc(), force))

    def residual_jacobian(self) -> Callable[[FloatArray, float, FloatArray], None]:
        """``jacobian(y, c, out)``: in y plus c times that in the rates, square, sign turned."""
        (A, G), compiled, friction = map(packed, self._matrices), _compiled()[1], self._friction
        return lambda y, c, out: compiled(G, A, c, *friction, y, True, out)

    def rate_jacobian(self, square: bool) -> Callable[[FloatArray, FloatArray], None]:
        """``jacobian(y, out)`` of the rates with a lumped mass, square or packed."""
        scale, compiled = 1.0 / self._matrices[0].diagonal(), _compiled()[1]
        w, beta = self._friction
        G, none = packed(sparse.diags_array(scale) @ self._matrices[1]), np.zeros((0, self.size))
        w = w * scale[1::2]
        return lambda y, out: compiled(G, none, 0.0, w, beta, y, square, out)


def slip_work(system: System, u: FloatArray, v: FloatArray) -> float:
    """Friction energy (J) between samples of all unknowns, (samples, n), trapezoidal rule."""
    force, slip = (system.w * friction.force((system.B @ v.T).T, system.beta)), system.B @ u.T
    return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(slip.T, axis=0)))


def band_entries(size: int) -> tuple[IntArray, IntArray]:
    """Rows and columns of the entries between the bands, by columns."""
    offset = np.arange(-UPPER, LOWER + 1)
    row = (np.arange(size)[:, np.newaxis] + offset).ravel()
    column = np.repeat(np.arange(size), offset.size)
    inside = (row >= 0) & (row < size)
    return row[inside], column[inside]


def packed(A: Any) -> FloatArray:
    """Bands of a matrix, entry (i, j) in ``[UPPER + i - j, j]``."""
    entries = sparse.coo_array(A)
    bands = np.zeros((LOWER + UPPER + 1, entries.shape[1]))
    bands[UPPER + entries.row - entries.col, entries.col] = entries.data
    return bands
