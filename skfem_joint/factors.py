"""Factors of symmetric positive definite matrices: dense, along a narrow band, of any pattern."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any
from weakref import finalize

import numpy as np
from scipy import linalg, sparse
from scipy.linalg import lapack
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
    reverse_cuthill_mckee,
)
from scipy.sparse.linalg import SuperLU, splu

from skfem_joint.arrays import BoolArray, FloatArray, IntArray, as_compressed, as_dense
from skfem_joint.errors import InputError

#: Rows of a band up to which its factor is faster than one that is made for any pattern: 20,000
#: unknowns of a plate with 50 take 0.01 s, and 0.9 ms a solution, instead of 0.09 s and 4 ms; with
#: 280 solutions take longer.
BAND = 128
#: Rows of a band up to which it is not looked for a narrower one, and up to which LAPACK factorises
#: it column by column: with the upper factor solutions take two thirds of the time then.
THIN, UNBLOCKED = 16, 65
#: Unknowns from which on PARDISO is used where it is installed; its error for other matrices than
#: positive definite ones.
LARGE, NOT_DEFINITE = 5000, -4
#: Right sides solved at once while condensing.
BLOCK = 64
#: Most unknowns that a matrix is condensed to as a dense one, and the most that their square may be
#: for each of its entries: beyond it dense products cost more than sparse ones. Fewest that stay
#: sparse, where at most `BAND` of them meet the others.
CONDENSED, CONDENSED_SQUARE, SPARSE = 1200, 3, 512


def factorised(A: Any) -> Any:
    """Solver of A x = b for a symmetric positive definite A, factorised once.

    Raises
    ------
    InputError
        If a dense A is not positive definite.
    """
    if isinstance(A, np.ndarray):
        try:
            factor = linalg.cho_factor(A.T, check_finite=False)
        except linalg.LinAlgError as error:
            raise InputError(
                "a matrix is not positive definite: is the step tiny, a body held by nothing, or "
                "do modes depend on each other? Use skfem_joint.reduction.pod.orthonormal then"
            ) from error
        return lambda right: linalg.cho_solve(factor, right, check_finite=False)
    return Factoriser()(A)


class Factoriser:
    """`factorised` for matrices one after another.

    Places along a band serve again for the next one of the same pattern.
    """

    def __init__(self) -> None:
        self._pattern: tuple[IntArray, IntArray] | None = None

    def __call__(self, A: Any) -> Callable[[FloatArray], FloatArray]:
        """Solver of A x = b."""
        solve: Callable[[FloatArray], FloatArray]
        if isinstance(A, np.ndarray):
            solve = factorised(A)
            return solve
        A = sparse.csr_array(A)
        pattern = A.indptr, A.indices
        if self._pattern is None or not all(map(np.array_equal, pattern, self._pattern)):
            entries = A.tocoo(copy=False)
            self._pattern, self._band = pattern, Band(entries.row, entries.col, A.shape[0])
        banded = self._band.factorised(A.data)
        return _of_any_pattern(A) if banded is None else banded


def _of_any_pattern(A: Any) -> Any:
    """By PARDISO where it is installed and pays, and A is positive definite; else by SuperLU."""
    if A.shape[0] >= LARGE and find_spec("pypardiso") is not None:
        from pypardiso.pardiso_wrapper import PyPardisoError

        try:
            return _by_pardiso(A)
        except PyPardisoError as error:
            if error.value != NOT_DEFINITE:
                raise
    return symmetric_lu(A).solve


def _by_pardiso(A: Any) -> Callable[[FloatArray], FloatArray]:
    """Solver with a handle of its own, whose memory goes with it."""
    from pypardiso import PyPardisoSolver

    solver = PyPardisoSolver(mtype=2)  # symmetric positive definite, by its upper triangle
    upper = sparse.csr_matrix(sparse.triu(A, format="csr"))
    # None of its defaults; ordered by METIS; no iterative refinement: a solution takes half as long
    for place, value in {1: 1, 2: 2, 8: 0}.items():
        solver.set_iparm(place, value)
    solver.factorize(upper)

    def solve(right: FloatArray) -> FloatArray:
        return np.asarray(solver.solve(upper, right))

    finalize(solve, solver.free_memory, everything=True)
    return solve


def symmetric_lu(A: Any, order: str = "MMD_AT_PLUS_A") -> SuperLU:
    """Factors of a sparse matrix, its pivots taken from the diagonal.

    RuntimeError if one of them is zero.
    """
    how: dict[str, Any] = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    return splu(sparse.csc_array(A), order, **how)


def pivots(A: Any) -> FloatArray:
    """Pivots of a symmetric matrix.

    RuntimeError if one of them is zero.
    """
    entries = sparse.coo_array(A)
    factor = Band(entries.row, entries.col, A.shape[0]).factorised(entries.data)
    return np.asarray(symmetric_lu(A).U.diagonal()) if factor is None else factor.pivots


def condenses(A: Any, kept: IntArray) -> bool:
    """Whether it is cheaper to condense a matrix to the unknowns that are ``kept``."""
    if isinstance(A, np.ndarray):
        return kept.size < len(A)
    most = min(CONDENSED, np.sqrt(CONDENSED_SQUARE * A.nnz))
    return bool(kept.size <= most or _narrow_border(A, kept).size)


def condensed(A: Any, kept: IntArray, most: int = 0) -> Uncondensed:
    """A sparse matrix, to which others will be added that act on what is ``kept`` alone.

    It is condensed to that where that is cheaper, or at most so many are kept.
    """
    if kept.size <= most or condenses(A, kept):
        return Condensation(A, kept)
    return Uncondensed(A)


def _narrow_border(A: Any, kept: IntArray) -> IntArray:
    """Places of what is ``kept`` that meet the other unknowns, if they are few of many."""
    if isinstance(A, np.ndarray) or kept.size < SPARSE:
        return np.zeros(0, dtype=np.intp)
    others = np.setdiff1d(np.arange(A.shape[0]), kept)
    border = np.unique(sparse.csr_array(A[others][:, kept]).indices)
    return border[: border.size if border.size <= min(BAND, kept.size // 2) else 0]


class Uncondensed:
    """What a `Condensation` does, by a matrix that is not condensed: all unknowns are kept."""

    def __init__(self, A: Any) -> None:
        self.A, self._factorise = A, Factoriser()

    def inward(self, g: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Right side for what is kept alone, (k,) or (k, m), from that of all unknowns.

        What the rest does while what is kept rests comes second.
        """
        return g, g[:0]

    def outward(self, x: FloatArray, still: FloatArray) -> FloatArray:
        """All unknowns, (n,) or (n, m), from those that are kept, and the others at their rest."""
        del still
        return x

    def alone(self, added: Any = None) -> Callable[[FloatArray], FloatArray]:
        """Solver for what is kept, with a matrix added, (n, n)."""
        return self._factorise(self.A if added is None else self.A + added)

    def solver(self, added: Any = None) -> Callable[[FloatArray], FloatArray]:
        """Solver for all unknowns, with a matrix added, (n, n)."""
        solve = self.alone(added)

        def whole(g: FloatArray) -> FloatArray:
            right, still = self.inward(g)
            return self.outward(solve(right), still)

        return whole


class Condensation(Uncondensed):
    """A symmetric positive definite matrix condensed to the unknowns that are ``kept``, sorted.

    Attributes
    ----------
    kept, rest : ndarray of int, shape (k,) and (n - k,)
    inside : callable
        Solver of the rest alone.
    complement : ndarray or csr_array, shape (k, k)
        Schur complement of those that are kept; sparse if they are many and few meet the rest.
    """

    def __init__(self, A: Any, kept: IntArray) -> None:
        self.kept, self.rest = kept, np.setdiff1d(np.arange(A.shape[0]), kept)
        self.inside = factorised(A[self.rest][:, self.rest])
        self._outwards = as_compressed(A[self.rest][:, kept])
        self._inwards = as_compressed(self._outwards.T)
        self._border = _narrow_border(A, kept)
        if self._border.size:
            coupling = as_dense(self._outwards[:, self._border])
            self._led = self.inside(coupling)  # what the rest does where the border goes
            lost = sparse.csr_array(coupling.T @ self._led)
            place = sparse.eye_array(kept.size, format="csr")[:, self._border]
            lost = place @ (0.5 * (lost + lost.T)) @ place.T
            self.complement = as_compressed(A[kept][:, kept] - lost)
        else:
            self.complement = _complement(A, kept, self.rest, self.inside)
        self._factorise = Factoriser()

    def inward(self, g: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Uncondensed`."""
        still = self.inside(g[self.rest])
        return np.asarray(g[self.kept] - self._inwards @ still), still

    def outward(self, x: FloatArray, still: FloatArray) -> FloatArray:
        """See `Uncondensed`."""
        every = np.empty((self.kept.size + self.rest.size, *x.shape[1:]))
        every[self.kept] = x
        led = self._led @ x[self._border] if self._border.size else self.inside(self._outwards @ x)
        every[self.rest] = still - led
        return every

    def alone(self, added: Any = None) -> Callable[[FloatArray], FloatArray]:
        """See `Uncondensed`."""
        if added is None:
            return self._factorise(self.complement)
        return self._factorise(self.complement + sparse.csr_array(added)[self.kept][:, self.kept])


def _complement(A: Any, kept: IntArray, rest: IntArray, solve: Any) -> FloatArray:
    """Schur complement, dense.

    Of large matrices it is what the last pivots leave: one more factorisation in place of a
    solution for each unknown.
    """
    lu = getattr(solve, "__self__", None)
    if isinstance(lu, SuperLU):
        order = np.concatenate([rest[np.argsort(lu.perm_c)], kept])
        whole = symmetric_lu(as_compressed(A)[order][:, order], "NATURAL")
        last = np.argsort(whole.perm_c)[rest.size :] - rest.size
        # Bodies that are apart keep their contact apart.
        if last.size and last.min() == 0 and np.array_equal(whole.perm_r, whole.perm_c):
            L, U = (as_dense(part[rest.size :, rest.size :]) for part in (whole.L, whole.U))
            S = np.empty((kept.size, kept.size))
            S[np.ix_(last, last)] = L @ U
            return np.asarray(0.5 * (S + S.T))
    S, columns = as_dense(A[kept][:, kept]), as_compressed(A[rest][:, kept].T)
    for k in range(0, kept.size, BLOCK):
        S[:, k : k + BLOCK] -= columns @ solve(as_dense(columns[k : k + BLOCK].T))
    return np.ascontiguousarray(0.5 * (S + S.T))


@dataclass(frozen=True)
class BandFactor:
    """Cholesky's factor along a band, which solves for a right side."""

    factor: FloatArray
    lower: bool
    order: IntArray  #: of the unknowns along the band
    place: IntArray  #: of each unknown

    def __call__(self, right: FloatArray) -> FloatArray:
        """Solution, (n,) or (n, m)."""
        x = lapack.dpbtrs(self.factor, right[self.order], self.lower, overwrite_b=1)[0]
        return np.asarray(x[self.place])

    @property
    def pivots(self) -> FloatArray:
        """Pivots in the order of the band."""
        return np.asarray(self.factor[0 if self.lower else -1] ** 2)


class Band:
    """Places of the entries of symmetric matrices of order ``n`` along a band.

    An entry may come more than once: its values are added up.
    """

    def __init__(self, rows: IntArray, columns: IntArray, n: int) -> None:
        self.height = BAND + 1
        if not rows.size:
            return
        ones = np.ones(rows.size)
        pattern = sparse.csr_matrix((ones, (rows, columns)), shape=(n, n))

        def placed(order: IntArray) -> tuple[int, IntArray, IntArray, IntArray]:
            place = np.argsort(order)
            row, column = place[rows], place[columns]
            return int(np.abs(row - column).max()) + 1, order, row, column

        given = int(np.abs(rows - columns).max()) + 1, np.arange(n), rows, columns
        corner = placed(reverse_cuthill_mckee(pattern, symmetric_mode=True))
        known = [given, corner]
        # From its end a strip is half as wide as from a corner: none looked for if it is given so.
        if THIN < min(given[0], corner[0]) <= 2 * BAND and given[0] > 0.6 * corner[0]:
            known.append(placed(_from_far_end(pattern, corner[1])))
        self.height, self.order, row, column = min(known, key=lambda one: one[0])
        self._lower = np.flatnonzero(row >= column)
        self._row, self._column = row[self._lower], column[self._lower]

    def factorised(self, values: FloatArray, among: BoolArray | None = None) -> BandFactor | None:
        """Solver by Cholesky's method, of the matrix of the unknowns ``among``, in their order.

        None where the band is wide, or round-off leaves it not positive definite.
        """
        if self.height > BAND:
            return None
        row, column, values = self._row, self._column, values[self._lower]
        order, height = self.order, self.height
        if among is not None:
            inside = among[order]
            both = inside[row] & inside[column]
            number = np.cumsum(inside) - 1
            row, column, values = number[row[both]], number[column[both]], values[both]
            order = (np.cumsum(among) - 1)[order[inside]]
            height = int((row - column).max(initial=0)) + 1
        lower = height > UNBLOCKED
        place = column * height + row - column if lower else (row + 1) * height - 1 - row + column
        entries = np.bincount(place, values, height * order.size).reshape(-1, height).T
        factor, failed = lapack.dpbtrf(entries, lower, overwrite_ab=1)
        return None if failed else BandFactor(factor, lower, order, np.argsort(order))


def _from_far_end(pattern: sparse.csr_matrix, order: IntArray) -> IntArray:
    """Order of the unknowns of a pattern by their distance from its far end, seen from ``order``.

    Cuthill and McKee start at one unknown, mostly at a corner: about a corner of a strip, levels of
    equal distance are twice as wide as the strip is. From all of its end at once they are not.
    """
    count, part = connected_components(pattern, directed=False)
    starts = np.zeros(count, dtype=np.intp)
    starts[part[order]] = order  # of each part the last one, where the order starts
    found, depth = _levels(pattern, starts)
    deepest = np.zeros(count, dtype=np.intp)
    np.maximum.at(deepest, part[found], depth)
    found = _levels(pattern, found[depth == deepest[part[found]]])[0]
    return found[np.argsort(part[found], kind="stable")]


def _levels(pattern: sparse.csr_matrix, starts: IntArray) -> tuple[IntArray, IntArray]:
    """Unknowns of a pattern in the order of their distance from all ``starts``, and that one."""
    n, indices = pattern.shape[0], np.concatenate([pattern.indices, starts])
    # One more unknown, which meets the starts.
    entries = np.ones(indices.size), indices, np.append(pattern.indptr, indices.size)
    order, before = breadth_first_order(sparse.csr_matrix(entries, shape=(n + 1, n + 1)), n)
    place = np.argsort(order)[before[order[1:]]]
    ends = [1]
    while ends[-1] < order.size:
        ends.append(1 + int(np.searchsorted(place, ends[-1])))
    return order[1:], np.repeat(np.arange(len(ends) - 1), np.diff(ends))


class BlockFactors:
    """Factors of one matrix with blocks added at its points, on unknowns that are not held.

    Parameters
    ----------
    A : csr_array or ndarray, shape (n, n)
    first, second : ndarray of int, shape (m,)
        Unknowns of each point; ``second`` is -1 where there is but one.
    """

    def __init__(self, A: Any, first: IntArray, second: IntArray) -> None:
        self.A, self.both = A, second >= 0
        i, j = first[self.both], second[self.both]
        self.rows, self.columns = np.concatenate([first, j, i, j]), np.concatenate([first, j, j, i])
        self.band: Band | None = None

    def factorised(self, blocks: FloatArray, held: BoolArray) -> Callable[[FloatArray], FloatArray]:
        """Solver with symmetric blocks (m, 3), stored as (11, 12, 22), added; zero where held."""
        values = np.concatenate([blocks[:, 0], blocks[self.both, 2], *2 * [blocks[self.both, 1]]])
        moving = np.flatnonzero(~held)
        solve: Callable[[FloatArray], FloatArray]
        solve = self._solver(values, ~held if held.any() else None)
        if not held.any():
            return solve

        def factor(x: FloatArray) -> FloatArray:
            y = np.zeros_like(x)
            y[moving] = solve(x[moving])
            return y

        return factor

    def _solver(self, values: FloatArray, among: BoolArray | None) -> Any:
        if isinstance(self.A, np.ndarray):
            T = self.A.copy() if among is None else self.A[np.ix_(among, among)]
            place, moves = np.arange(len(self.A)), np.ones(self.rows.size, dtype=bool)
            if among is not None:
                place, moves = np.cumsum(among) - 1, among[self.rows]
            T[place[self.rows[moves]], place[self.columns[moves]]] += values[moves]
            return factorised(T)
        entries, n = self.A.tocoo(copy=False), self.A.shape[0]
        values = np.concatenate([entries.data, values])
        if self.band is None:
            self.rows = np.concatenate([entries.row, self.rows])
            self.columns = np.concatenate([entries.col, self.columns])
            self.band = Band(self.rows, self.columns, n)
        banded = self.band.factorised(values, among)
        if banded is not None:
            return banded
        T = sparse.csr_array((values, (self.rows, self.columns)), shape=(n, n))
        return _of_any_pattern(T if among is None else T[among][:, among])
