"""The one system type: full, coarse, reduced and hyper-reduced models are all of it.

    M a + C v + K u + B^T (w * sigma(B v)) = sum_k load_k amplitude_k(t)        (Eq. (1))

Every map between models takes a system and returns a system.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.errors import InputError
from skfem_joint.friction import norms
from skfem_joint.loads import Load

FloatArray = NDArray[np.float64]
Matrix = Any  # ndarray or scipy sparse array, shape (n, n) or (m, n)


@dataclass(frozen=True)
class AppliedLoad:
    """A spatial load vector times a scalar amplitude of time.

    Attributes
    ----------
    vector : ndarray, shape (n,)
        Spatial distribution, dimensionless for a point load (1 at the loaded unknown).
    amplitude : Load
        Force in N as a vectorised function of time in s, see :mod:`skfem_joint.loads`.
    on : str
        Name of the loaded point.
    """

    vector: FloatArray
    amplitude: Load
    on: str = ""


@dataclass(frozen=True)
class System:
    """Second-order system with friction rows.

    Attributes
    ----------
    M, C, K : ndarray or sparse array, shape (n, n)
        Mass (kg), damping (N s/m) and stiffness (N/m); symmetric, M positive definite.
    B : ndarray or sparse array, shape (rows, n)
        Slip operator: slip velocity of each contact point from the velocities, one row for each
        direction of slip; the rows of a point follow each other.
    w : ndarray, shape (m,)
        Friction limit of each contact point, N.
    beta : ndarray, shape (m,)
        Scaling constant of Eq. (2) of each point, s/m; ``inf`` is Coulomb.
    loads : tuple of AppliedLoad
    P : ndarray or sparse array, shape (p, n)
        Displacement of the named points from the unknowns.
    points : tuple of str
        Names of the rows of ``P``.
    directions : ndarray of int, shape (m,)
        Directions in which each contact point can slip, 1 or 2; all 1 if not given. The friction
        force of a point with two is opposite to its slip vector and depends on the norm of it.
    """

    M: Matrix
    C: Matrix
    K: Matrix
    B: Matrix
    w: FloatArray
    beta: FloatArray
    loads: tuple[AppliedLoad, ...] = ()
    P: Matrix = field(default=None)
    points: tuple[str, ...] = ()
    directions: Any = field(default=None)

    def __post_init__(self) -> None:
        n = self.M.shape[0]
        if self.P is None:
            object.__setattr__(self, "P", sparse.csr_array((0, n)))
        m = self.w.shape[0]
        if self.directions is None:
            object.__setattr__(self, "directions", np.ones(m, dtype=np.int64))
        if self.directions.shape != (m,) or not np.isin(self.directions, (1, 2)).all():
            raise InputError(f"directions: must be 1 or 2 for each of the {m} contact points")
        expected = {
            "M": (n, n),
            "C": (n, n),
            "K": (n, n),
            "B": (int(self.directions.sum()), n),
            "P": (len(self.points), n),
        }
        problems = [
            f"{name}: found shape {getattr(self, name).shape}, must be {shape}"
            for name, shape in expected.items()
            if getattr(self, name).shape != shape
        ]
        if self.beta.shape != (m,):
            problems.append(f"beta: found shape {self.beta.shape}, must be {(m,)}")
        if np.any(~np.isfinite(self.w)) or np.any(self.w < 0.0):
            problems.append("w: friction limits must be finite and not negative")
        if np.any(~(self.beta > 0.0)):
            problems.append("beta: must be positive (inf for Coulomb)")
        if problems:
            raise InputError(problems)

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return int(self.M.shape[0])

    @property
    def contact_points(self) -> int:
        """Number of contact points that can carry friction."""
        return int(np.count_nonzero(self.w))

    @property
    def first_row(self) -> NDArray[np.int64]:
        """Row of ``B`` at which each contact point starts, and the number of rows, (m + 1,)."""
        return np.concatenate([[0], np.cumsum(self.directions)])

    def on_rows(self, values: FloatArray) -> FloatArray:
        """Repeat a value of each contact point for each of its rows of ``B``."""
        return np.repeat(values, self.directions)

    def by_point(self, values: FloatArray) -> FloatArray:
        """Sum values of the rows of ``B``, (..., rows), over the rows of each point, (..., m)."""
        if values.shape[-1] == self.w.size:
            return values
        return np.asarray(np.add.reduceat(values, self.first_row[:-1], axis=-1))

    def slip_norm(self, slip: FloatArray) -> FloatArray:
        """Norm of the slip vector of each contact point, shape (..., m), from (..., rows)."""
        return norms(slip, self.directions)

    @property
    def is_dense(self) -> bool:
        """Whether the matrices are stored dense, as those of a reduced system are."""
        return isinstance(self.M, np.ndarray)

    def project(self, V: FloatArray) -> System:
        """Galerkin projection on the columns of ``V``, Eqs. (4)-(9).

        Parameters
        ----------
        V : ndarray, shape (n, j)
            Basis; u = V q.

        Returns
        -------
        System
            Dense system of size j with the same contact points and named points.
        """
        if V.ndim != 2 or V.shape[0] != self.n or not np.all(np.isfinite(V)):
            raise InputError(
                f"basis: found shape {V.shape}, must be ({self.n}, j) with finite entries"
            )

        def congruence(A: Matrix) -> FloatArray:
            reduced = V.T @ (A @ V)
            return np.asarray(0.5 * (reduced + reduced.T))

        return System(
            M=congruence(self.M),
            C=congruence(self.C),
            K=congruence(self.K),
            B=np.ascontiguousarray(self.B @ V),
            w=self.w,
            beta=self.beta,
            loads=tuple(replace(load, vector=V.T @ load.vector) for load in self.loads),
            P=np.ascontiguousarray(self.P @ V),
            points=self.points,
            directions=self.directions,
        )

    def with_beta(self, beta: float) -> System:
        """Give every contact point the scaling constant ``beta`` (s/m)."""
        return replace(self, beta=np.full(self.w.shape, float(beta)))

    def stored_energy(self, u: FloatArray, v: FloatArray) -> float:
        """Kinetic plus strain energy, J."""
        return float(0.5 * (v @ (self.M @ v)) + 0.5 * (u @ (self.K @ u)))

    def load_amplitudes(self, times: FloatArray) -> FloatArray:
        """Amplitudes of all loads, shape (loads, times), N."""
        if not self.loads:
            return np.zeros((0, times.size))
        return np.array([np.asarray(load.amplitude(times), dtype=float) for load in self.loads])

    def load_vectors(self) -> FloatArray:
        """Spatial load vectors, shape (n, loads)."""
        if not self.loads:
            return np.zeros((self.n, 0))
        return np.stack([load.vector for load in self.loads], axis=1)
