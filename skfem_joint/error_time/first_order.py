"""A strut system as first-order equations for ready-made integrators.

The unknowns are interleaved, y = (u_1, v_1, u_2, v_2, ...), which gives every Jacobian of a
tridiagonal system three lower and two upper bands:

    residual:   u' - v = 0,   M v' + C v + K u + B^T (w * sigma(B v)) - f(t) = 0
    rates:      u' = v,       v' = M^-1 (f(t) - C v - K u - B^T (w * sigma(B v)))

The residual form keeps the bands with any tridiagonal mass. The rates do so with a lumped mass
alone: the inverse of the consistent one is full.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.chain import bands
from skfem_joint.errors import InputError
from skfem_joint.loads import Harmonic, Load
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: Bands of the Jacobians below and above the diagonal.
LOWER, UPPER = 3, 2


def _internal(y: Any, chain: Any, vectors: Any, amplitudes: Any, right: Any) -> None:
    """Loads minus damping, elastic and friction forces of all unknowns, N."""
    C0, C1, K0, K1, w, beta = chain
    n = C0.size
    for i in range(n):
        u, v = y[2 * i], y[2 * i + 1]
        force = C0[i] * v + K0[i] * u + w[i] * (2.0 / math.pi) * math.atan(beta[i] * v)
        if i > 0:
            force += C1[i - 1] * y[2 * i - 1] + K1[i - 1] * y[2 * i - 2]
        if i < n - 1:
            force += C1[i] * y[2 * i + 3] + K1[i] * y[2 * i + 2]
        for k in range(amplitudes.size):
            force -= vectors[k, i] * amplitudes[k]
        right[i] = -force


def _residual(y: Any, rate: Any, M0: Any, M1: Any, right: Any, out: Any) -> None:
    """Residual from the forces ``right``."""
    n = M0.size
    for i in range(n):
        out[2 * i] = rate[2 * i] - y[2 * i + 1]
        inertia = M0[i] * rate[2 * i + 1]
        if i > 0:
            inertia += M1[i - 1] * rate[2 * i - 1]
        if i < n - 1:
            inertia += M1[i] * rate[2 * i + 3]
        out[2 * i + 1] = inertia - right[i]


def _rates(y: Any, pivot: Any, factor: Any, right: Any, out: Any) -> None:
    """Rates from the forces ``right`` by the factors M = L D L^T; changes ``right``."""
    n = pivot.size
    for i in range(1, n):
        right[i] -= factor[i - 1] * right[i - 1]
    for i in range(n - 1, -1, -1):
        acceleration = right[i] / pivot[i]
        if i < n - 1:
            acceleration -= factor[i] * out[2 * i + 3]
        out[2 * i] = y[2 * i + 1]
        out[2 * i + 1] = acceleration


def _jacobian(
    y: Any, chain: Any, M0: Any, M1: Any, row: Any, c: Any, packed: int, out: Any
) -> None:
    """Banded Jacobian: rows u hold (c[0], c[1]), rows v ``row`` times K and C + slope + c[2] M.

    Entry (i, j) goes to ``out[i, j]``, or to ``out[UPPER + i - j, j]`` if ``packed`` is 1.
    """
    C0, C1, K0, K1, w, beta = chain
    n = C0.size
    for i in range(n):
        a, b = 2 * i, 2 * i + 1
        z = beta[i] * y[b]
        slope = w[i] * (2.0 / math.pi) * beta[i] / (1.0 + z * z)
        out[a - packed * (a - 2), a] = c[0]
        out[a - packed * (b - 2), b] = c[1]
        out[b - packed * (a - 2), a] = row[i] * K0[i]
        out[b - packed * (b - 2), b] = row[i] * (C0[i] + slope + c[2] * M0[i])
        if i > 0:
            out[b - packed * (a - 4), a - 2] = row[i] * K1[i - 1]
            out[b - packed * (b - 4), b - 2] = row[i] * (C1[i - 1] + c[2] * M1[i - 1])
        if i < n - 1:
            out[b - packed * a, a + 2] = row[i] * K1[i]
            out[b - packed * b, b + 2] = row[i] * (C1[i] + c[2] * M1[i])


@cache
def _compiled() -> tuple[Any, Any, Any, Any]:
    """Compile the four loops: what a user in a hurry would do as well."""
    from numba import njit

    return tuple(
        njit(cache=True, error_model="numpy")(loop)
        for loop in (_internal, _residual, _rates, _jacobian)
    )  # type: ignore[return-value]


def lumped(system: System) -> System:
    """Same system with the row sums of its mass matrix on the diagonal."""
    mass = np.asarray(system.M.sum(axis=1)).ravel()
    return replace(system, M=sparse.csr_array(sparse.diags_array(mass)))


def _scalar(load: Load) -> Callable[[float], float]:
    """Amplitude at one time; without numpy's overhead where it is a sine."""
    if isinstance(load, Harmonic):
        amplitude, omega, phase = load.amplitude, 2.0 * math.pi * load.frequency, load.phase
        return lambda t: amplitude * math.sin(omega * t + phase)
    return lambda t: float(load(t))


@dataclass(frozen=True)
class FirstOrder:
    """First-order form of a tridiagonal system of the arctan law.

    Attributes
    ----------
    system : System
        Sparse, tridiagonal, one unknown in each slip row, every beta finite.
    """

    system: System

    def __post_init__(self) -> None:
        rows = sparse.csr_array(self.system.B)
        if self.system.is_dense or np.any(np.diff(rows.indptr) != 1):
            raise InputError("first-order form: needs a strut system, one unknown in a slip row")
        if np.any(np.isinf(self.system.beta[self.system.w > 0.0])):
            raise InputError("first-order form: set-valued Coulomb friction has no Jacobian")

    @property
    def size(self) -> int:
        """Number of unknowns, displacements and velocities."""
        return 2 * self.system.n

    @cached_property
    def _chain(self) -> tuple[FloatArray, ...]:
        s = self.system
        contact = sparse.csr_array(s.B).indices
        w, beta = np.zeros(s.n), np.ones(s.n)
        w[contact] = s.w
        beta[contact] = np.where(s.w > 0.0, s.beta, 1.0)
        return (*bands(s.C), *bands(s.K), w, beta)

    @cached_property
    def _mass(self) -> tuple[FloatArray, FloatArray]:
        return bands(self.system.M)

    @cached_property
    def _factors(self) -> tuple[FloatArray, FloatArray]:
        """Pivots and off-diagonal of M = L D L^T."""
        M0, M1 = self._mass
        pivot, factor = M0.copy(), np.zeros_like(M1)
        for i in range(1, M0.size):
            factor[i - 1] = M1[i - 1] / pivot[i - 1]
            pivot[i] -= factor[i - 1] * M1[i - 1]
        return pivot, factor

    @cached_property
    def _inverse_mass(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.system.M.toarray()))

    @cached_property
    def _constant(self) -> FloatArray:
        """Dense Jacobian of the rates without friction."""
        n, s = self.system.n, self.system
        J = np.zeros((2 * n, 2 * n))
        J[::2, 1::2] = np.eye(n)
        J[1::2, ::2] = -self._inverse_mass @ s.K.toarray()
        J[1::2, 1::2] = -self._inverse_mass @ s.C.toarray()
        return J

    def residual_function(self) -> Callable[[float, FloatArray, FloatArray, FloatArray], None]:
        """``residual(t, y, rate, out)``."""
        internal, residual, _, _ = _compiled()
        forces, right = self._forces(internal)
        M0, M1 = self._mass

        def fill(t: float, y: FloatArray, rate: FloatArray, out: FloatArray) -> None:
            forces(t, y)
            residual(y, rate, M0, M1, right, out)

        return fill

    def rate_function(self) -> Callable[[float, FloatArray, FloatArray], None]:
        """``rates(t, y, out)``."""
        internal, _, rates, _ = _compiled()
        forces, right = self._forces(internal)
        pivot, factor = self._factors

        def fill(t: float, y: FloatArray, out: FloatArray) -> None:
            forces(t, y)
            rates(y, pivot, factor, right, out)

        return fill

    def _forces(self, internal: Any) -> tuple[Callable[[float, FloatArray], None], FloatArray]:
        loads = [_scalar(load.amplitude) for load in self.system.loads]
        vectors = np.ascontiguousarray(self.system.load_vectors().T)
        amplitudes, right, chain = np.zeros(len(loads)), np.zeros(self.system.n), self._chain

        def forces(t: float, y: FloatArray) -> None:
            for k, load in enumerate(loads):
                amplitudes[k] = load(t)
            internal(y, chain, vectors, amplitudes, right)

        return forces, right

    def residual_jacobian(self) -> Callable[[FloatArray, float, FloatArray], None]:
        """``jacobian(y, c, out)``: that of the residual in y plus c times that in the rates."""
        jacobian = _compiled()[3]
        chain, (M0, M1), ones = self._chain, self._mass, np.ones(self.system.n)

        def fill(y: FloatArray, c: float, out: FloatArray) -> None:
            jacobian(y, chain, M0, M1, ones, (c, -1.0, c), 0, out)

        return fill

    def rate_jacobian(self, packed: bool) -> Callable[[FloatArray, FloatArray], None]:
        """``jacobian(y, out)`` of the rates with a lumped mass: square, or its bands alone."""
        jacobian = _compiled()[3]
        chain, (M0, M1) = self._chain, self._mass
        row = -1.0 / M0

        def fill(y: FloatArray, out: FloatArray) -> None:
            jacobian(y, chain, M0, M1, row, (0.0, 1.0, 0.0), int(packed), out)

        return fill

    def full_rate_jacobian(self, y: FloatArray, out: FloatArray) -> None:
        """Full Jacobian of the rates, with any mass."""
        w, beta = self._chain[4:]
        z = beta * y[1::2]
        out[:] = self._constant
        out[1::2, 1::2] -= self._inverse_mass * (w * (2.0 / np.pi) * beta / (1.0 + z * z))
