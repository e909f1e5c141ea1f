"""Factors of symmetric matrices: dense, sparse along a narrow band, and sparse of any pattern."""

from __future__ import annotations

import ctypes
import logging
import os
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from importlib.util import find_spec
from typing import Any, cast
from weakref import finalize

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import SuperLU, splu

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.bands import Band
from skfem_joint.linalg.compressed import as_compressed

_log = logging.getLogger(__name__)


#: Unknowns from which on PARDISO is used where it is installed; with fewer SuperLU is as fast.
LARGE = 5000


NOT_DEFINITE = (
    "a matrix is not positive definite: does an unknown have no mass, is the step tiny, a body "
    "held by nothing, or do modes depend on each other? Use skfem_joint.reduction.pod.orthonormal "
    "then"
)


def factorised(A: Any) -> Any:
    """Solver of A x = b, which factorises A once.

    Parameters
    ----------
    A : ndarray or sparse array, shape (n, n)
        Symmetric positive definite. Sparse matrices may be indefinite, with less accuracy.

    Returns
    -------
    callable
        Takes right sides of shape (n,) or (n, m).

    Raises
    ------
    InputError
        If a dense A is not positive definite, or a sparse one is singular.
    """
    if isinstance(A, np.ndarray):
        try:
            factor = linalg.cho_factor(A.T, check_finite=False)
        except linalg.LinAlgError as error:
            raise InputError(NOT_DEFINITE) from error
        return lambda right: linalg.cho_solve(factor, right, check_finite=False)
    return Factoriser()(A)


class Factoriser:
    """`factorised` for a sequence of matrices; the search for a band is not repeated."""

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
            self._pattern, self._band = pattern, Band.of(A)
        banded = None if self._band is None else self._band.factorised(A.data)
        if banded is not None:
            _log.debug("factor of %d unknowns along a band", A.shape[0])
        return _of_any_pattern(A) if banded is None else banded


@cache
def pardiso() -> Any:
    """The package ``pypardiso``, or None where it is not installed or does not work.

    The package searches for Intel's library MKL when it is imported. It raises ImportError if there
    is none, and OSError if the library cannot be loaded. It would search again for each solver,
    which takes a quarter of a second; so it is told what it has found.
    """
    if find_spec("pypardiso") is None:
        return None
    try:
        import pypardiso
    except (ImportError, OSError) as error:
        _log.warning("pypardiso is installed but cannot be used, SuperLU is used: %s", error)
        return None
    os.environ.setdefault("PYPARDISO_MKL_RT", pypardiso.ps.libmkl._name)
    return pypardiso


def _of_any_pattern(A: Any) -> Any:
    """Solver by PARDISO for large matrices if it is installed and succeeds, else by SuperLU."""
    solver = _if_pardiso(PardisoFactor, A)
    try:
        return symmetric_lu(A).solve if solver is None else solver
    except RuntimeError as error:
        raise InputError(NOT_DEFINITE) from error


def partial_factor(A: Any, kept: IntArray) -> PartialFactor | None:
    """Factor of a sparse matrix up to its ``kept`` unknowns; None where PARDISO makes none."""
    if not 0 < kept.size < A.shape[0]:
        return None
    return cast("PartialFactor | None", _if_pardiso(PartialFactor, A, kept))


def _if_pardiso(make: Callable[..., Any], A: Any, *more: Any) -> Any:
    """``make(library, A, *more)`` for large matrices if PARDISO is installed; None if it fails."""
    if A.shape[0] < LARGE or (library := pardiso()) is None:
        return None
    try:
        return make(library, A, *more)
    except library.pardiso_wrapper.PyPardisoError as error:
        if error.value != -4:  # PARDISO's code for a matrix that is not positive definite
            raise
        return None


class _Pardiso:
    """Symmetric positive definite matrix in PARDISO; its memory is freed with the object.

    The library is called without the package's functions: they compare or copy the matrix, and
    number its rows anew, for each solution, which takes as long as a solution.
    """

    def __init__(self, library: Any, A: Any) -> None:
        self._library, self._solver = library, library.PyPardisoSolver(mtype=2)
        # 1: parameters are given; 2: order by METIS; 8: no iterative refinement, with which a
        # solution takes twice as long; 35: rows are numbered from 0.
        for place, value in {1: 1, 2: 2, 8: 0, 35: 1}.items():
            self._solver.set_iparm(place, value)
        rows = as_compressed(A)
        row = np.repeat(np.arange(rows.shape[0], dtype=np.int32), np.diff(rows.indptr))
        upper = rows.indices >= row
        ends = np.cumsum(np.bincount(row[upper], minlength=rows.shape[0]))
        self._start = np.concatenate([[0], ends]).astype(np.int32)
        self._column = rows.indices[upper].astype(np.int32)
        self._value = np.asarray(rows.data[upper], dtype=float)
        finalize(self, self._solver.free_memory, everything=True)

    def _call(self, phase: int, right: FloatArray) -> FloatArray:
        """Result of a phase for right sides of shape (n,) or (n, m)."""
        real, whole = ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_int32)

        def number(value: int) -> Any:
            return ctypes.byref(ctypes.c_int32(value))

        right = np.asfortranarray(right, dtype=float)
        x, error, solver = np.zeros_like(right), ctypes.c_int32(0), self._solver
        solver._mkl_pardiso(
            solver.pt.ctypes.data_as(ctypes.POINTER(ctypes.c_int64)),
            *(number(1), number(1), number(solver.mtype), number(phase)),
            number(self._start.size - 1),
            self._value.ctypes.data_as(real),
            self._start.ctypes.data_as(whole),
            self._column.ctypes.data_as(whole),
            solver.perm.ctypes.data_as(whole),
            number(1 if right.ndim == 1 else right.shape[1]),
            solver.iparm.ctypes.data_as(whole),
            number(0),
            right.ctypes.data_as(real),
            x.ctypes.data_as(real),
            ctypes.byref(error),
        )
        if error.value:
            raise self._library.pardiso_wrapper.PyPardisoError(error.value)
        return np.ascontiguousarray(x)


class PardisoFactor(_Pardiso):
    """Factor by PARDISO; calling it solves for right sides of shape (n,) or (n, m)."""

    def __init__(self, library: Any, A: Any) -> None:
        super().__init__(library, A)
        n = self._start.size - 1
        pattern = blake2b(self._start.tobytes() + self._column.tobytes()).digest()
        known = _ORDERS.get(pattern)
        # 5: an order of the unknowns is given, or asked for.
        self._solver.set_iparm(5, 2 if known is None else 1)
        self._solver.perm = np.zeros(n, dtype=np.int32) if known is None else known
        _log.debug("factor of %d unknowns by PARDISO", n)
        self._call(12, np.zeros(n))
        _ORDERS[pattern] = self._solver.perm
        if len(_ORDERS) > _MOST_ORDERS:
            del _ORDERS[next(iter(_ORDERS))]  # the oldest one

    def __call__(self, right: FloatArray) -> FloatArray:
        """Solution for right sides of shape (n,) or (n, m)."""
        return self._call(33, right)


class PartialFactor(_Pardiso):
    """Factor of a matrix up to some of its unknowns, and its Schur complement on these.

    A solution with the complement between `forward` and `backward` is one with the matrix: both
    together take as long as a solution, and the factor as long as one of the whole matrix.

    Attributes
    ----------
    complement : ndarray, shape (k, k)
    """

    def __init__(self, library: Any, A: Any, kept: IntArray) -> None:
        super().__init__(library, A)
        n = self._start.size - 1
        # 36: the complement of unknowns that are marked, and the factor of the others.
        self._solver.set_iparm(36, 2)
        self._solver.perm = np.zeros(n, dtype=np.int32)
        self._solver.perm[kept] = 1
        _log.debug("factor of %d unknowns up to %d of them by PARDISO", n, kept.size)
        S = self._call(12, np.zeros((kept.size, kept.size)))
        self.complement = 0.5 * (S + S.T)

    def forward(self, right: FloatArray) -> FloatArray:
        """Right sides, (n,) or (n, m), eliminated: those of the kept unknowns stand there."""
        return self._call(331, right)

    def backward(self, x: FloatArray) -> FloatArray:
        """Solutions from what `forward` gives, with solutions at the kept unknowns."""
        return self._call(333, x)


# Orders of the unknowns by which PARDISO factorised the last few patterns, by the digests of these.
# They take a fifth of the time of a factor. To find a pattern again takes a hundredth of it.
# SuperLU takes none: to permute a matrix takes longer than to order it.
_ORDERS: dict[bytes, IntArray] = {}
_MOST_ORDERS = 4


def symmetric_lu(A: Any, order: str = "MMD_AT_PLUS_A", pivot: float = 0.0) -> SuperLU:
    """LU factors of a sparse matrix with pivots from the diagonal.

    Where one is smaller than the share ``pivot`` of its column another one is taken.

    Raises
    ------
    RuntimeError
        If a pivot is zero.
    """
    how: dict[str, Any] = {"diag_pivot_thresh": pivot, "options": {"SymmetricMode": True}}
    _log.debug("factor of %d unknowns by SuperLU", A.shape[0])
    rows = as_compressed(sparse.csr_array(A))
    columns = rows.data, rows.indices, rows.indptr  # of a symmetric matrix they are its rows
    return splu(sparse.csc_array(columns, shape=rows.shape), order, **how)


def with_pivots(A: Any) -> tuple[FloatArray, Callable[[FloatArray], FloatArray]]:
    """Pivots of a symmetric matrix, (n,), whose signs are those of its eigenvalues, and a solver.

    Raises
    ------
    RuntimeError
        If a pivot is zero.
    """
    entries, n = sparse.coo_array(A), A.shape[0]
    # Share of entries from which on pivots come from a dense Cholesky factor: 3000 unknowns with
    # all entries take a tenth of SuperLU's time.
    if entries.nnz > 0.25 * n**2:
        factor, failed = linalg.lapack.dpotrf(entries.toarray(), clean=False, overwrite_a=True)
        if not failed:
            return factor.diagonal() ** 2, lambda right: linalg.cho_solve((factor, False), right)
    elif (along := Band(entries.row, entries.col, n).factorised(entries.data)) is not None:
        return along.pivots, along
    lu = symmetric_lu(A)
    return np.asarray(lu.U.diagonal()), lu.solve


class BlockFactors:
    """Factors of a fixed matrix plus symmetric 1 x 1 or 2 x 2 blocks at given points.

    The matrix is that of a step, the blocks are tangents of friction. Its pattern is arranged once.

    Parameters
    ----------
    A : csr_array or ndarray, shape (n, n)
    first, second : ndarray of int, shape (m,)
        Unknowns of each point; ``second`` is -1 where a point has one unknown.
    """

    def __init__(self, A: Any, first: IntArray, second: IntArray) -> None:
        self.A, self.both = A, second >= 0
        i, j = first[self.both], second[self.both]
        self.rows, self.columns = np.concatenate([first, j, i, j]), np.concatenate([first, j, j, i])
        self.band: Band | None = None

    def factorised(
        self, blocks: FloatArray, fixed: BoolArray
    ) -> Callable[[FloatArray], FloatArray]:
        """Solver with the blocks added, restricted to unknowns that are not ``fixed``, (n,).

        ``blocks``, shape (m, 3), has the entries (11, 12, 22) of each block. Solutions are zero at
        unknowns that are fixed.
        """
        values, moving = self._values(blocks), np.flatnonzero(~fixed)
        solve: Callable[[FloatArray], FloatArray]
        solve = self._solver(values, ~fixed if fixed.any() else None)
        if not fixed.any():
            return solve

        def factor(x: FloatArray) -> FloatArray:
            y = np.zeros_like(x)
            y[moving] = solve(x[moving])
            return y

        return factor

    def matrix(self, blocks: FloatArray) -> FloatArray:
        """Dense matrix with the blocks added."""
        return self._with(self._values(blocks))

    def _with(self, values: FloatArray) -> FloatArray:
        """Dense matrix with entries added at ``rows`` and ``columns``."""
        T = np.array(self.A)
        np.add.at(T, (self.rows, self.columns), values)
        return T

    def _values(self, blocks: FloatArray) -> FloatArray:
        """Entries of the blocks at their ``rows`` and ``columns``."""
        return np.concatenate([blocks[:, 0], blocks[self.both, 2], *2 * [blocks[self.both, 1]]])

    def _solver(self, values: FloatArray, among: BoolArray | None) -> Any:
        if isinstance(self.A, np.ndarray):
            if among is None:
                return factorised(self._with(values))
            place, moves = np.cumsum(among) - 1, among[self.rows] & among[self.columns]
            free = np.flatnonzero(among)
            T = self.A.take(free, axis=0).take(free, axis=1)
            np.add.at(T, (place[self.rows[moves]], place[self.columns[moves]]), values[moves])
            return factorised(T)
        values, n = np.concatenate([self.A.data, values]), self.A.shape[0]
        if self.band is None:
            entries = self.A.tocoo(copy=False)
            self.rows = np.concatenate([entries.row, self.rows])
            self.columns = np.concatenate([entries.col, self.columns])
            self.band = Band(self.rows, self.columns, n)
        banded = self.band.factorised(values, among)
        if banded is not None:
            return banded
        T = sparse.csr_array((values, (self.rows, self.columns)), shape=(n, n))
        return _of_any_pattern(T if among is None else T[among][:, among])


class RowFactors:
    """`BlockFactors` of a dense matrix where slips, in place of unknowns, have the blocks.

    Parameters
    ----------
    A : ndarray, shape (n, n)
    first, second : ndarray, shape (m, n) and (pairs, n)
        First slip of each point by the unknowns, and the second one of those that have two.
    pairs : ndarray of int
        Points that have two.
    """

    def __init__(
        self, A: FloatArray, first: FloatArray, second: FloatArray, pairs: IntArray
    ) -> None:
        self.A, self.first, self.second, self.pairs = A, first, second, pairs

    def matrix(self, blocks: FloatArray) -> FloatArray:
        """See `BlockFactors`."""
        T = self.A + (self.first.T * blocks[:, 0]) @ self.first
        if self.pairs.size:
            of_pairs, second = blocks[self.pairs], self.second
            mixed = (self.first[self.pairs].T * of_pairs[:, 1]) @ second
            T += (second.T * of_pairs[:, 2]) @ second + mixed + mixed.T
        return np.asarray(T)

    def factorised(
        self, blocks: FloatArray, fixed: BoolArray
    ) -> Callable[[FloatArray], FloatArray]:
        """See `BlockFactors`; no unknown is ``fixed``."""
        solve: Callable[[FloatArray], FloatArray] = factorised(self.matrix(blocks))
        return solve
