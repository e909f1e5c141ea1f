"""Slips and mean approaches in place of all unknowns of the contact.

Where approaches are weighted means of several unknowns, as under hats of nodes on elements of
second order, the unknowns that they average are eliminated for given approaches.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import linalg, sparse

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.system.unknowns import selection

#: Share of the largest part of an approach that is not in others' below which it is none.
DEPENDENT = 1e-10


class MeanApproaches:
    """Slips t and approaches s = W d, each a mean of unknowns d, in place of t and d.

    The unknowns averaged are d = P s + Z y with W P = 1 and W Z = 0, and y is eliminated. That
    works where contact alone holds a body as well: its stiffness for y is regular.

    Parameters
    ----------
    S : ndarray, shape (k, k)
        Matrix of t and d.
    t, d : ndarray of int
        Their numbers.
    W : ndarray, shape (q, d)

    Attributes
    ----------
    matrix : ndarray, shape (t + q, t + q)
        Of t, and of s behind them.
    """

    def __init__(self, S: FloatArray, t: IntArray, d: IntArray, W: FloatArray) -> None:
        Q, R = linalg.qr(W.T)
        q, size = len(W), np.abs(np.diagonal(R))
        if q > size.size or size.min(initial=np.inf) <= DEPENDENT * size.max(initial=0.0):
            raise InputError(
                "contact that opens: approaches of pressure points depend on each other, or no "
                "unknown moves one; leave out those that follow from others or cannot move, with "
                "what they give to friction limits in w alone"
            )
        self.t, self.d, self.W = t, d, W
        self.P = linalg.solve_triangular(R[:q], Q[:, :q].T).T
        self.Z = Q[:, q:]
        S_td, S_dd = S[np.ix_(t, d)], S[np.ix_(d, d)]
        S_dP = S_dd @ self.P
        S_ts = S_td @ self.P
        A = np.block([[S[np.ix_(t, t)], S_ts], [S_ts.T, self.P.T @ S_dP]])
        self.beside = np.hstack([(S_td @ self.Z).T, self.Z.T @ S_dP])
        self.factor = linalg.cho_factor(self.Z.T @ (S_dd @ self.Z))
        A -= self.beside.T @ self._interior(self.beside)
        self.matrix = np.ascontiguousarray(0.5 * (A + A.T))

    def _interior(self, right: FloatArray) -> FloatArray:
        """What forces on y move it by."""
        return np.asarray(linalg.cho_solve(self.factor, right, check_finite=False))

    @staticmethod
    def of(S: FloatArray, points: ContactPoints) -> MeanApproaches | None:
        """Of points in the unknowns of S; None where each approach is an unknown already."""
        N = sparse.csr_array(points.normal.N) if points.normal else sparse.csr_array((0, len(S)))
        d = np.unique(N.indices)
        W = as_dense(N[:, d])
        if N.data.size == d.size == len(W) and np.all(N.data == 1.0):
            return None
        return MeanApproaches(S, np.unique(points.unknowns), d, W)

    def points_of(self, points: ContactPoints) -> ContactPoints:
        """Points in the unknowns of the matrix."""
        n, count = len(self.matrix), self.t.size
        if points.normal is None:
            raise TypeError("points without normal contact have no approaches")
        N = selection(np.arange(count, n), n)
        B = selection(np.searchsorted(self.t, points.unknowns), n)
        return replace(points, B=B, normal=replace(points.normal, N=N))

    def start_of(self, v: FloatArray) -> FloatArray:
        """Unknowns of the matrix from t and d."""
        return np.concatenate([v[self.t], self.W @ v[self.d]])

    def unknown(self, where: int) -> int:
        """Unknown of t and d that belongs most to one of the matrix."""
        if where < self.t.size:
            return int(self.t[where])
        return int(self.d[np.abs(self.W[where - self.t.size]).argmax()])

    def restrict(self, g: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Right side of the matrix, and what `extend` needs."""
        of_y = self.Z.T @ g[self.d]
        right = np.concatenate([g[self.t], self.P.T @ g[self.d]])
        return right - self.beside.T @ self._interior(of_y), of_y

    def extend(self, z: FloatArray, of_y: FloatArray) -> FloatArray:
        """All of t and d."""
        v = np.empty((self.t.size + self.d.size, *z.shape[1:]))
        v[self.t] = z[: self.t.size]
        y = self._interior(of_y - self.beside @ z)
        v[self.d] = self.P @ z[self.t.size :] + self.Z @ y
        return v
