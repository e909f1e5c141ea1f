"""Schur complements: exact elimination of all unknowns but those that later changes act on.

With A split into kept unknowns k and interior ones r, A x = g becomes

    S x_k = g_k - A_kr A_rr^-1 g_r,    S = A_kk - A_kr A_rr^-1 A_rk,
    x_r = A_rr^-1 (g_r - A_rk x_k).

S is worth its cost where many problems follow that change A on the kept unknowns alone, as friction
does on the contact's.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import SuperLU

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense
from skfem_joint.linalg import bands
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.linalg.factors import (
    Factoriser,
    PartialFactor,
    factorised,
    partial_factor,
    symmetric_lu,
)
from skfem_joint.linalg.fill import Fill, fill

# Costs are in nanoseconds of a time step with friction, in which the complement or the matrix is
# multiplied some twenty times and a tangent is factorised once or twice. They were set by hand to
# times of 11 plates and 5 solids (720 to 38,000 unknowns, 144 to 3,344 of them kept; on a machine
# that others used), stepped in both ways. The three plates that took equally long do so by these
# numbers within 30 %; solids took a fifth to a thirtieth of the time if condensed.

#: Cost of a dense complement for the square and the cube of its unknowns, if steps work on all.
DENSE = (14.0, 0.0027)
# The same of a step that reads all rows a few times and otherwise works on what moves, a fifth of
# the unknowns: 63 ms of some 4,700 unknowns, the interior's two solves included.
_DENSE_MOVING = (4.0, 3e-5)
#: Unknowns from which on steps work on those that move.
FEWEST_MOVING = 1500
# Cost of the matrix itself for an entry, for an entry of its factor, and for a multiplication with
# an addition to make that factor.
_SPARSE = (30.0, 15.0, 0.15)
#: Most of the machine's memory that dense complements may take.
MEMORY_SHARE = 0.25
#: A complement of at least so many unknowns stays sparse if few of them are coupled to the
#: interior: at most half of them, and no more than `bands.WIDEST` rows.
FEWEST_SPARSE = 512
# Right sides that are solved for together while a dense complement is made.
_BLOCK = 64


def condensing_pays(A: Any, kept: IntArray, dense: tuple[float, float] | None = None) -> bool:
    """Whether problems that change A on its ``kept`` unknowns alone are cheaper if condensed.

    That is so if the complement stays sparse, or if it fits into memory and a step costs less with
    it than with A and its factor. It depends on the pattern of A and on the machine's memory, not
    on the memory that is free.

    Parameters
    ----------
    A : ndarray or sparse array, shape (n, n)
    kept : ndarray of int, shape (k,)
    dense : tuple of float, optional
        Cost of a dense complement for k^2 and for k^3, ns, where it is not that of a time step.
    """
    if isinstance(A, np.ndarray):
        return kept.size < len(A)
    if _narrow_border(A, kept).size:
        return True
    if dense_bytes(kept.size) > MEMORY_SHARE * physical_memory():
        return False
    k = float(kept.size)
    square, cube = dense or (DENSE if kept.size < FEWEST_MOVING else _DENSE_MOVING)
    least = Fill(0.5 * A.nnz, 0.0)  # of any factor: it has the entries of the matrix
    known = square * k**2 + cube * k**3 - _SPARSE[0] * A.nnz
    return bool(known <= _saved(least) or known <= _saved(fill(A)))


def _saved(factor: Fill) -> float:
    """Cost of a factor of all unknowns, less that of the interior's, which a complement needs."""
    entry, operation = _SPARSE[1:]
    # Of 6 ns for an entry are the two solves with the interior.
    return (entry - 6.0) * factor.entries + operation * factor.work


def dense_bytes(kept: int) -> int:
    """Memory for dense complements of so many unknowns, bytes."""
    # Three are in memory when one is made or a tangent of it is factorised.
    return 8 * 3 * kept**2


@cache
def physical_memory() -> float:
    """Memory of the machine, bytes; 4 GiB where the system does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):  # not on every system
        return 4.0 * 2**30


def condensed(A: Any, kept: IntArray, dense: tuple[float, float] | None = None) -> Uncondensed:
    """Schur complement of A on its ``kept`` unknowns where that pays, else A itself.

    Parameters are those of `condensing_pays`.
    """
    return SchurComplement(A, kept) if condensing_pays(A, kept, dense) else Uncondensed(A)


def _narrow_border(A: Any, kept: IntArray) -> IntArray:
    """Places of the kept unknowns that are coupled to the interior; empty if they are too many."""
    if isinstance(A, np.ndarray) or kept.size < FEWEST_SPARSE:
        return np.zeros(0, dtype=np.intp)
    inside = np.zeros(A.shape[0], dtype=bool)
    inside[kept] = True
    rows = sparse.csr_array(A)[kept]
    border = np.unique(np.repeat(np.arange(kept.size), np.diff(rows.indptr))[~inside[rows.indices]])
    few = border.size <= min(bands.WIDEST, kept.size // 2)
    return border[: border.size if few else 0]


class Uncondensed:
    """A matrix of which all unknowns are kept: the base class of `SchurComplement`.

    Callers need not know whether a matrix is condensed: they restrict right sides to the kept
    unknowns, solve for these, and extend the solution to all unknowns. Here restriction and
    extension do nothing; `SchurComplement` overrides them, and `solver_of_kept`.
    """

    def __init__(self, A: Any) -> None:
        self.A, self._factorise = A, Factoriser()

    def restrict(self, g: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Right side of the kept unknowns, (k,) or (k, m), from that of all, (n,) or (n, m).

        Also returns what `extend` needs of the interior's right side.
        """
        return g, g[:0]

    def extend(self, x: FloatArray, interior: FloatArray) -> FloatArray:
        """All unknowns, (n,) or (n, m), from the kept ones and what `restrict` gave beside them."""
        del interior
        return x

    def solver_of_kept(self, added: Any = None) -> Callable[[FloatArray], FloatArray]:
        """Solver for the kept unknowns, with a matrix (n, n) added that acts on them alone."""
        return self._factorise(self.A if added is None else self.A + added)

    def solver(self, added: Any = None) -> Callable[[FloatArray], FloatArray]:
        """Solver for all unknowns, with a matrix (n, n) added that acts on the kept ones alone."""
        return self.by(self.solver_of_kept(added))

    def by(self, solve: Callable[[FloatArray], FloatArray]) -> Callable[[FloatArray], FloatArray]:
        """Solver for all unknowns, by one for the kept ones."""

        def solve_all(g: FloatArray) -> FloatArray:
            right, interior = self.restrict(g)
            return self.extend(solve(right), interior)

        return solve_all


class SchurComplement(Uncondensed):
    """Symmetric positive definite matrix condensed to some of its unknowns.

    Parameters
    ----------
    A : ndarray or sparse array, shape (n, n)
    kept : ndarray of int, shape (k,)
        Kept unknowns in increasing order.

    Attributes
    ----------
    kept, interior : ndarray of int, shape (k,) and (n - k,)
        Kept and interior unknowns.
    complement : ndarray or csr_array, shape (k, k)
        S; sparse if many unknowns are kept and few of them are coupled to the interior.
    """

    def __init__(self, A: Any, kept: IntArray) -> None:
        super().__init__(A)
        self.kept, self.interior = kept, np.setdiff1d(np.arange(A.shape[0]), kept)
        self._parts = _parts(A, kept, self.interior)
        self.complement = self._parts.complement

    def solve_interior(self, g: FloatArray) -> FloatArray:
        """Solution of A_rr x = g, (n - k,) or (n - k, m)."""
        return self._parts.solve_interior(g)

    def restrict(self, g: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Uncondensed`; the second value is for `extend` alone."""
        return self._parts.restrict(g)

    def extend(self, x: FloatArray, interior: FloatArray) -> FloatArray:
        """See `Uncondensed`."""
        return self._parts.extend(x, interior)

    def solver_of_kept(self, added: Any = None) -> Callable[[FloatArray], FloatArray]:
        """See `Uncondensed`."""
        if added is not None:
            added = sparse.csr_array(added)[self.kept][:, self.kept]
            return self._factorise(self.complement + added)
        if isinstance(self.complement, np.ndarray):  # if nearly singular, Cholesky refuses it
            return partial(linalg.lu_solve, linalg.lu_factor(self.complement))
        return self._factorise(self.complement)


class AllKept(SchurComplement):
    """A matrix of which all unknowns are kept, as its own complement."""

    restrict, extend = Uncondensed.restrict, Uncondensed.extend

    def __init__(self, A: Any) -> None:
        Uncondensed.__init__(self, A)
        self.kept, self.complement = np.arange(A.shape[0]), A


def _parts(A: Any, kept: IntArray, interior: IntArray) -> _ByInterior | _ByPardiso:
    """Complement of A on its kept unknowns, and solutions by what it was made with."""
    border = _narrow_border(A, kept)
    factor = None if isinstance(A, np.ndarray) or border.size else partial_factor(A, kept)
    if factor is None:
        return _ByInterior(A, kept, interior, border)
    return _ByPardiso(factor, kept, interior)


class _ByPardiso:
    """By one factor, which makes the complement too. See `SchurComplement`."""

    def __init__(self, factor: PartialFactor, kept: IntArray, interior: IntArray) -> None:
        self.factor, self.kept, self.interior = factor, kept, interior
        self.complement: Any = factor.complement

    def solve_interior(self, g: FloatArray) -> FloatArray:
        y = np.zeros((self.kept.size + self.interior.size, *g.shape[1:]))
        y[self.interior] = g
        return self.extend(np.zeros((self.kept.size, *g.shape[1:])), self.factor.forward(y))[
            self.interior
        ]

    def restrict(self, g: FloatArray) -> tuple[FloatArray, FloatArray]:
        y = self.factor.forward(g)
        return y[self.kept], y

    def extend(self, x: FloatArray, interior: FloatArray) -> FloatArray:
        y = interior.copy()
        y[self.kept] = x
        return self.factor.backward(y)


class _ByInterior:
    """By a factor of the interior. See `SchurComplement`."""

    def __init__(self, A: Any, kept: IntArray, interior: IntArray, border: IntArray) -> None:
        self.kept, self.interior, self._border = kept, interior, border
        self.solve_interior = factorised(A[interior][:, interior])
        self._to_interior = as_compressed(A[interior][:, kept])
        self._to_kept = as_compressed(self._to_interior.T)
        self.complement: Any
        if border.size:
            coupling = as_dense(self._to_interior[:, border])
            self._response = self.solve_interior(coupling)  # of the interior, to its border
            product = sparse.csr_array(coupling.T @ self._response)
            place = sparse.eye_array(kept.size, format="csr")[:, border]
            product = place @ (0.5 * (product + product.T)) @ place.T
            self.complement = as_compressed(A[kept][:, kept] - product)
        else:
            self.complement = _dense_complement(A, kept, interior, self.solve_interior)

    def restrict(self, g: FloatArray) -> tuple[FloatArray, FloatArray]:
        interior = self.solve_interior(g[self.interior])
        return np.asarray(g[self.kept] - self._to_kept @ interior), interior

    def extend(self, x: FloatArray, interior: FloatArray) -> FloatArray:
        u = np.empty((self.kept.size + self.interior.size, *x.shape[1:]))
        u[self.kept] = x
        if self._border.size:
            u[self.interior] = interior - self._response @ x[self._border]
        else:
            u[self.interior] = interior - self.solve_interior(self._to_interior @ x)
        return u


def _dense_complement(A: Any, kept: IntArray, interior: IntArray, solve: Any) -> FloatArray:
    """Dense Schur complement by a factor of the interior.

    From SuperLU it is the product L D L^T of the last pivot blocks of a factorisation of A that has
    the kept unknowns last: a solution with A_rr for each kept unknown takes several times as long.
    """
    lu = getattr(solve, "__self__", None)
    if isinstance(lu, SuperLU):
        order = np.concatenate([interior[np.argsort(lu.perm_c)], kept])
        whole = symmetric_lu(as_compressed(A)[order][:, order], "NATURAL")
        last = np.argsort(whole.perm_c)[interior.size :] - interior.size
        # SuperLU may reorder across bodies that are apart: then kept unknowns do not come last.
        pivots = whole.U.diagonal()[interior.size :]
        in_order = last.size and last.min() == 0 and np.array_equal(whole.perm_r, whole.perm_c)
        if in_order and np.all(pivots > 0.0):
            L = whole.L[interior.size :, interior.size :].toarray()
            return _times_transpose(L * np.sqrt(pivots))[np.ix_(np.argsort(last), np.argsort(last))]
    S, columns = as_dense(A[kept][:, kept]), as_compressed(A[interior][:, kept].T)
    for k in range(0, kept.size, _BLOCK):
        part = slice(k, k + _BLOCK)
        S[:, part] -= columns @ solve(as_dense(columns[part].T))
    return np.ascontiguousarray(0.5 * (S + S.T))


def _times_transpose(L: FloatArray) -> FloatArray:
    """Product L L^T of a lower triangle, in a sixth of the time of one of full matrices."""
    # LAPACK has it of upper triangles: L with its rows and columns reversed is one.
    upper = linalg.lapack.dlauum(np.asfortranarray(L[::-1, ::-1]), lower=0, overwrite_c=1)[0]
    S = np.tril(upper[::-1, ::-1])
    return np.asarray(S + np.tril(S, -1).T)
