"""Newton's method for contact on the Schur complement of the unknowns in contact.

Contact acts on slips and approaches alone. All other unknowns are eliminated once, and the method
runs on a smaller matrix, which is mostly dense, for any number of right sides. Where approaches are
weighted means of several unknowns, as under hats of nodes on elements of second order, the unknowns
that they average are eliminated for given approaches. Of the rest, points of contact that opens
which are apart are eliminated, too (:mod:`skfem_joint.minimise.touching`).
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.schur import AllKept, SchurComplement
from skfem_joint.minimise.linearisation import Linearisation
from skfem_joint.minimise.moving import MovingNewton
from skfem_joint.minimise.problem import (
    ContactPoints,
    Minimum,
    Pressed,
    PressurePoints,
    StepProblem,
)
from skfem_joint.system.unknowns import selection

#: Share of the largest part of an approach that is not in others' below which it is none.
DEPENDENT = 1e-10


class CondensedNewton(StepProblem):
    """`MovingNewton` on the Schur complement of the unknowns in contact, see `StepProblem`.

    Parameters
    ----------
    H, points
        See `StepProblem`.
    beside : ndarray of int
        More unknowns that are kept.

    Attributes
    ----------
    schur : SchurComplement
        Of H, on the unknowns of points with friction and of pressure points.
    contact : MovingNewton
        The problem of these unknowns, or of slips and mean approaches.

    Raises
    ------
    InputError
        If approaches of pressure points depend on each other.
    """

    def __init__(self, H: Any, points: ContactPoints, beside: Sequence[int] = ()) -> None:
        self.H, self.points = H, points
        acts = points.w > 0.0 if points.normal is None else np.ones(points.w.size, dtype=bool)
        self._limited = np.flatnonzero(points.on_rows(acts))
        self._points = np.flatnonzero(acts)
        kept, self.means = np.unique(points.unknowns[self._limited]), None
        if points.normal is not None:
            kept = np.union1d(kept, sparse.csr_array(points.normal.N).indices)
        kept = np.union1d(kept, np.array(beside, dtype=kept.dtype))
        self.schur = SchurComplement(H, kept)
        self.matrix = self.schur.complement
        if points.normal is not None:
            self.means = MeanApproaches.of(as_dense(self.matrix), self._acting())
            self.matrix = as_dense(self.matrix) if self.means is None else self.means.matrix
        self.contact = self._contact()

    def _acting(self) -> ContactPoints:
        """Points with friction, and pressure points, in the unknowns of the complement."""
        points, some = self.points, self._points
        acting = ContactPoints(
            points.B[self._limited],
            points.directions[some],
            points.w[some],
            points.beta[some],
            None if points.flexible is None else points.flexible[some],
        ).in_unknowns(self.schur.kept)
        if (normal := points.normal) is None:
            return acting
        N = sparse.csr_array(sparse.csr_array(normal.N)[:, self.schur.kept])
        gain = sparse.csr_array(normal.gain)
        return replace(acting, normal=PressurePoints(N, gain, normal.stiffness))

    def _contact(self) -> MovingNewton:
        acting = self._acting()
        return MovingNewton(
            self.matrix, acting if self.means is None else self.means.points_of(acting)
        )

    def with_limits(self, points: ContactPoints) -> CondensedNewton:
        """Problem with other friction limits, zero where they were zero, and the same factors."""
        other = copy(self)
        other.points = points
        other.contact = other._contact()
        return other

    def of_kept(self) -> CondensedNewton:
        """The same problem, with the same factors, of the kept unknowns as all there are."""
        other = copy(self)
        other.points, other.H = self.points.in_unknowns(self.schur.kept), self.schur.complement
        other.schur = AllKept(self.schur.complement)
        return other

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far, that of the interior included."""
        return self.contact.factorizations + 1

    def linearisation(self, beta: FloatArray | None = None) -> Linearisation:
        """See `LinearisedProblem`; of the unknowns of the contact."""
        points = self.points.in_unknowns(self.schur.kept)
        if self.points.normal is not None:  # all points are those of the contact
            points = self.contact.points
        return Linearisation(self.contact.H, points.with_beta(beta), self)

    def compile(self) -> None:
        """See `StepProblem`."""
        self.contact.compile()

    def restrict(self, g: FloatArray) -> tuple[FloatArray, Any]:
        """Right side of the contact, (k,) or (k, m), and what `extend` needs beside it."""
        right, interior = self.schur.restrict(g)
        if self.means is None:
            return right, (None, interior)
        right, beside = self.means.restrict(right)
        return right, (beside, interior)

    def extend(self, z: FloatArray, beside: Any) -> FloatArray:
        """All unknowns, (n,) or (n, m), from those of the contact."""
        of_means, interior = beside
        return self.schur.extend(
            z if self.means is None else self.means.extend(z, of_means), interior
        )

    def start_of(self, v: FloatArray) -> FloatArray:
        """Unknowns of the contact, (k,), of all."""
        return v[self.schur.kept] if self.means is None else self.means.start_of(v[self.schur.kept])

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`."""
        force = float(np.abs(g).max())
        right, beside = self.restrict(g)
        law = None if beta is None else beta[self._points]
        slips = None if offset is None else offset[self._limited]
        z = None if start is None else self.start_of(start)
        inner = self.contact.minimise_beside(right, z, tolerance, law, force, slips, pressed)
        v, friction = self.extend(inner.v, beside), np.zeros(self.points.B.shape[0])
        friction[self._limited] = inner.sigma
        where = inner.where
        if self.means is not None:
            where = self.means.unknown(where)
        return replace(
            inner,
            v=v,
            sigma=friction,
            converged=inner.converged and bool(np.all(np.isfinite(v))),
            counts=inner.counts | {"linear_solves": inner.counts["linear_solves"] + 2},
            where=int(self.schur.kept[where]),
            w=self.points.w if pressed is None else inner.w,
        )

    def saved(self) -> dict[str, NDArray[Any]]:
        """See `StepProblem`."""
        return self.contact.saved()

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        self.contact.check(saved)

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        self.contact.restore(saved)


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
