"""A dense symmetric matrix of which a changing set of unknowns is eliminated.

Of unknowns e that are eliminated and others k that are at hand the symmetric array

    T = [[-A_ee^-1, A_ee^-1 A_ek], [A_ke A_ee^-1, A_kk - A_ke A_ee^-1 A_ek]]

holds all that eliminations need. To eliminate some more unknowns, or to take some back, is a
principal pivot of T on their rows (M. J. Tsatsomeros, Linear Algebra Appl. 307, 2000): it costs two
operations for each entry of T and each unknown, not a factor of A_ee.

Round-off adds up over the pivots. Solutions are corrected by residuals with A, and T is made anew
when as many unknowns have changed as are eliminated.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, check_like
from skfem_joint.linalg.kernels import times

#: Growth of the array where unknowns are taken in.
GROWTH = 1.1
# Rows of a symmetric array that are copied to its columns together.
_BLOCK = 256


class Eliminated:
    """A symmetric positive definite matrix A, (n, n), with some of its unknowns eliminated.

    Attributes
    ----------
    out : ndarray of bool, shape (n,)
        Unknowns that are eliminated.
    place : ndarray of int, shape (n,)
        Place of each unknown in T, -1 of those that are not at hand.
    changes : list of tuple
        All that made T, in turn: a name of `_CHANGES` and unknowns.
    """

    def __init__(self, A: FloatArray) -> None:
        self.A = A
        self._begin()

    def _begin(self) -> None:
        """With no unknown at hand."""
        n = self.A.shape[0]
        self.out, self.place = np.zeros(n, dtype=np.bool_), np.full(n, -1, dtype=np.intp)
        self.changes: list[tuple[str, IntArray]] = []
        self._T, self._at, self._changed = np.zeros((0, 0)), 0, 0

    def let(self, out: BoolArray, kept: IntArray) -> None:
        """Eliminate the unknowns ``out``, (n,), and no others, and have those ``kept`` at hand."""
        back, more = np.flatnonzero(self.out & ~out), np.flatnonzero(out & ~self.out)
        if self._changed + back.size + more.size > np.count_nonzero(out):
            self._begin()
            back, more = back[:0], np.flatnonzero(out)
        for name, unknowns in (
            ("take in", more[self.place[more] < 0]),
            ("take back", back),
            ("eliminate", more),
            ("take in", kept[self.place[kept] < 0]),
        ):
            if unknowns.size:
                self._change(name, unknowns)
        # The first elimination is no change.
        begun = len(self.changes) <= 3 and not back.size
        self._changed += 0 if begun else back.size + more.size

    def _change(self, name: str, unknowns: IntArray) -> None:
        """Make a change, and take note of it."""
        _CHANGES[name](self, unknowns)
        self.changes.append((name, unknowns))

    def _take_in(self, new: IntArray) -> None:
        """Have more unknowns at hand."""
        old, count = np.flatnonzero(self.place >= 0), self._at
        if count + new.size > len(self._T):
            T = np.zeros(2 * (max(count + new.size, int(GROWTH * count)),))
            T[:count, :count] = self._T[:count, :count]
            self._T = T
        e = np.flatnonzero(self.out)
        rows, square = np.zeros((new.size, len(self._T))), self.A[np.ix_(new, new)]
        rows[:, self.place[old]] = self.A[np.ix_(new, old)]
        if e.size:
            p, of_eliminated = self.place[e], self.A[np.ix_(new, e)]
            rows[:, p] = 0.0
            rows -= of_eliminated @ self._T[p]
            square -= rows[:, p] @ of_eliminated.T
        self.place[new] = own = count + np.arange(new.size)
        self._T[own], self._T[:, own] = rows, rows.T
        self._T[np.ix_(own, own)] = square
        self._at = count + new.size

    def _eliminate(self, unknowns: IntArray) -> None:
        """Eliminate unknowns that are at hand."""
        self._pivot(self.place[unknowns], 1.0)
        self.out[unknowns] = True

    def _take_back(self, unknowns: IntArray) -> None:
        """Have unknowns at hand again that were eliminated."""
        self._pivot(self.place[unknowns], -1.0)
        self.out[unknowns] = False

    def _pivot(self, p: IntArray, sign: float) -> None:
        """Pivot on places ``p``; ``sign`` is that of their block, which is definite."""
        T = self._T
        L = linalg.cholesky(sign * T[np.ix_(p, p)], lower=True, check_finite=False)
        inverse = linalg.lapack.dpotri(L, lower=1)[0]
        inverse = np.tril(inverse) + np.tril(inverse, -1).T
        if p.size < self._at:
            half = linalg.solve_triangular(L, T[p], lower=True, check_finite=False)
            # In place, of the transpose of T, as BLAS has arrays: it is T. Half of it is computed.
            linalg.blas.dsyrk(-sign, half, 1.0, T.T, trans=1, lower=1, overwrite_c=1)
            for k in range(0, len(T), _BLOCK):
                own, after = slice(k, k + _BLOCK), slice(k + _BLOCK, None)
                T[own, own] = np.triu(T[own, own]) + np.triu(T[own, own], 1).T
                T[after, own] = T[own, after].T
            T[p] = linalg.solve_triangular(L, half, lower=True, trans=1, check_finite=False)
            T[:, p] = T[p].T
        T[np.ix_(p, p)] = -sign * inverse

    def complement(self, kept: IntArray) -> FloatArray:
        """Schur complement on unknowns that are at hand and not eliminated."""
        p = self.place[kept]
        return np.asarray(self._T[np.ix_(p, p)])

    def restrict(self, r: FloatArray, kept: IntArray) -> tuple[FloatArray, FloatArray]:
        """Forces (n,) on all unknowns as forces on those kept.

        Also returns the displacement of the eliminated ones, where the others are held.
        """
        e = np.flatnonzero(self.out)
        moved = self._times(e, r[e])
        return r[kept] - moved[self.place[kept]], -moved[self.place[e]]

    def follow(self, x: FloatArray, kept: IntArray) -> FloatArray:
        """Displacement of the eliminated unknowns, in order, where those kept move by x."""
        return -self._times(kept, x)[self.place[np.flatnonzero(self.out)]]

    def _times(self, unknowns: IntArray, x: FloatArray) -> FloatArray:
        """Product of T and a vector that is x at some unknowns."""
        vector = np.zeros(len(self._T))
        vector[self.place[unknowns]] = x
        return times(self._T, vector)

    def saved(self) -> dict[str, NDArray[np.int64]]:
        """All that made T, from which it is made again to the bit."""
        names = list(_CHANGES)
        every = [np.zeros(0, dtype=np.int64), *(x.astype(np.int64) for _, x in self.changes)]
        kinds = [(names.index(name), x.size) for name, x in self.changes]
        return {
            "changes": np.array(kinds, dtype=np.int64).reshape(-1, 2),
            "changed": np.concatenate(every),
            "since": np.array(self._changed, dtype=np.int64),
        }

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See that arrays are such as `saved` gives; ValueError if not."""
        kinds, unknowns = saved.get("changes", np.zeros(0)), saved.get("changed", np.zeros(0))
        planned = {
            "changes": np.zeros((len(kinds), 2), dtype=np.int64),
            "changed": np.zeros(unknowns.size, dtype=np.int64),
            "since": np.array(0, dtype=np.int64),
        }
        check_like(saved, planned, "eliminated")
        n, names = self.A.shape[0], list(_CHANGES)
        fits = (kinds >= 0).all() and (kinds[:, 0] < len(names)).all()
        fits = fits and kinds[:, 1].sum() == unknowns.size
        if not fits or np.any((unknowns < 0) | (unknowns >= n)):
            raise ValueError(f"eliminated/changes are none of {n} unknowns")
        at_hand, out = np.zeros((2, n), dtype=np.bool_)
        for kind, own in zip(kinds[:, 0], np.split(unknowns, np.cumsum(kinds[:, 1])), strict=False):
            name = names[kind]
            may = {"take in": ~at_hand, "eliminate": at_hand & ~out, "take back": out}[name]
            if not may[own].all():
                raise ValueError(f"eliminated/changes {name} unknowns that cannot be")
            at_hand[own], out[own] = True, name == "eliminate"

    def restore(self, saved: dict[str, NDArray[np.int64]]) -> None:
        """Make T as it was when ``saved`` was made."""
        self._begin()
        names, at = list(_CHANGES), 0
        for kind, size in saved["changes"].tolist():
            self._change(names[kind], saved["changed"][at : at + size].astype(np.intp))
            at += size
        self._changed = int(saved["since"])


_CHANGES = {
    "take in": Eliminated._take_in,
    "eliminate": Eliminated._eliminate,
    "take back": Eliminated._take_back,
}
