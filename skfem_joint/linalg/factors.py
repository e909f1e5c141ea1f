"""Factors of symmetric matrices: dense, sparse along a narrow band, and sparse of any pattern."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from typing import Any, cast
from weakref import finalize

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import SuperLU, splu

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.bands import Band

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
    """`factorised` for a sequence of matrices; the order of a pattern that repeats is kept."""

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
    solve = _if_pardiso(_by_pardiso, A)
    try:
        return symmetric_lu(A).solve if solve is None else solve
    except RuntimeError as error:
        raise InputError(NOT_DEFINITE) from error


def complement(A: Any, kept: IntArray) -> FloatArray | None:
    """Dense Schur complement of a sparse matrix on its ``kept`` unknowns, (k, k), by PARDISO.

    It takes little longer than a factor. None where PARDISO is not used or does not succeed.
    """
    return cast("FloatArray | None", _if_pardiso(_complement_by_pardiso, A, kept))


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


def _pardiso_solver(library: Any, A: Any) -> tuple[Any, sparse.csr_matrix]:
    """Solver of PARDISO for symmetric positive definite A, and the upper triangle that it takes."""
    solver = library.PyPardisoSolver(mtype=2)
    # 1: parameters are given; 2: order by METIS; 8: no iterative refinement, with which a solution
    # takes twice as long.
    for place, value in {1: 1, 2: 2, 8: 0}.items():
        solver.set_iparm(place, value)
    upper = sparse.csr_matrix(sparse.triu(A, format="csr"))
    upper.sort_indices()
    return solver, upper


def _complement_by_pardiso(library: Any, A: Any, kept: IntArray) -> FloatArray:
    """See `complement`."""
    solver, upper = _pardiso_solver(library, A)
    solver.set_iparm(36, 1)  # the Schur complement of unknowns that are marked
    solver.perm = np.zeros(A.shape[0], dtype=np.int32)
    solver.perm[kept] = 1
    solver.set_phase(12)
    try:  # the package has no public way to have it
        return np.asarray(solver._call_pardiso(upper, np.zeros((kept.size, kept.size))))
    finally:
        solver.free_memory(everything=True)


def _by_pardiso(library: Any, A: Any) -> Callable[[FloatArray], FloatArray]:
    """Solver by PARDISO; its memory is freed with the solver."""
    solver, upper = _pardiso_solver(library, A)
    solver.factorize(upper)

    def solve(right: FloatArray) -> FloatArray:
        return np.asarray(solver.solve(upper, right))

    finalize(solve, solver.free_memory, everything=True)
    return solve


def symmetric_lu(A: Any, order: str = "MMD_AT_PLUS_A", pivot: float = 0.0) -> SuperLU:
    """LU factors of a sparse matrix with pivots from the diagonal.

    Where one is smaller than the share ``pivot`` of its column another one is taken.

    Raises
    ------
    RuntimeError
        If a pivot is zero.
    """
    how: dict[str, Any] = {"diag_pivot_thresh": pivot, "options": {"SymmetricMode": True}}
    return splu(sparse.csc_array(A), order, **how)


def pivots(A: Any) -> FloatArray:
    """Pivots of a symmetric matrix, (n,); their signs are those of its eigenvalues.

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
        return np.asarray(symmetric_lu(A).U.diagonal() if failed else factor.diagonal() ** 2)
    along = Band(entries.row, entries.col, n).factorised(entries.data)
    return np.asarray(symmetric_lu(A).U.diagonal()) if along is None else along.pivots


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
        T = np.array(self.A)
        np.add.at(T, (self.rows, self.columns), self._values(blocks))
        return T

    def _values(self, blocks: FloatArray) -> FloatArray:
        """Entries of the blocks at their ``rows`` and ``columns``."""
        return np.concatenate([blocks[:, 0], blocks[self.both, 2], *2 * [blocks[self.both, 1]]])

    def _solver(self, values: FloatArray, among: BoolArray | None) -> Any:
        if isinstance(self.A, np.ndarray):
            place, moves = np.arange(len(self.A)), np.ones(self.rows.size, dtype=bool)
            T = self.A.copy()
            if among is not None:
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
