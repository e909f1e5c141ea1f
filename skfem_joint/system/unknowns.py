"""Changes of unknowns that make each slip an unknown.

Displacements u that obey ``u[fixed] = 0`` and ``H u = 0`` (contact that stays closed), with slips
``s = B u``, are written ``u = T q``. The unknowns q are the slips and those displacements that
neither slips nor constraints determine. Forces on q are ``T^T f``, so that the reaction of a joint
on the other body is equal, opposite and on the same line. This serves supports, edges, faces, rigid
bases and other bodies alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import (
    connected_components,
    min_weight_full_bipartite_matching,
    structural_rank,
)

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import InputError


@dataclass(frozen=True)
class ChangeOfUnknowns:
    """Maps between two sets of unknowns of a system, the outer and the inner ones.

    Attributes
    ----------
    forward : sparse array, shape (outer, inner)
        T: outer unknowns from the inner ones, u = T q.
    inverse : sparse array, shape (inner, outer)
        Inner unknowns from outer ones that obey the constraints.
    slips : ndarray of int, shape (rows of B,)
        Inner unknown that is the slip of each row.
    """

    forward: sparse.csr_array
    inverse: sparse.csr_array
    slips: IntArray


def dof_numbers(given: Any, n: int, where: str = "fixed", first: int = 0) -> IntArray:
    """Sorted numbers of degrees of freedom, counted from 0.

    Parameters
    ----------
    given : array_like of int, or skfem.DofsView
        Numbers from ``first`` on, or what scikit-fem's ``get_dofs`` returns.
    n : int
        Number of all degrees of freedom.
    where : str
        Name of the numbers in messages.
    first : int
        Number of the first degree of freedom in ``given``.

    Raises
    ------
    InputError
        If they are not whole numbers in range, such as a mask.
    """
    # `DofsView.all` returns the numbers; the method `all` of arrays is another.
    view = not isinstance(given, np.ndarray) and hasattr(given, "all")
    numbers = np.asarray(given.all() if view else given)
    if numbers.dtype.kind not in "iuf":
        raise InputError(
            f"{where}: found {numbers.dtype} values, must be numbers of degrees of freedom; of a "
            "mask take np.flatnonzero(mask)"
        )
    wrong = ~((numbers >= first) & (numbers < n + first) & (numbers == np.floor(numbers)))
    if wrong.any():
        raise InputError(
            f"{where}: found {numbers[wrong][0]:g}, must be whole numbers from {first} to "
            f"{n - 1 + first}"
        )
    return np.unique(numbers - first).astype(np.intp)


def expanded(T: Matrix, u: FloatArray) -> FloatArray:
    """Product ``T u`` along the last axis of ``u``, shape (..., n)."""
    return np.asarray((T @ u.reshape(-1, u.shape[-1]).T).T).reshape(*u.shape[:-1], -1)


def selection(columns: IntArray, n: int) -> sparse.csr_array:
    """Matrix, shape (columns, n), each of whose rows holds a single 1, in the given column."""
    ones = np.ones(columns.size)
    return sparse.csr_array((ones, (np.arange(columns.size), columns)), shape=(columns.size, n))


def distinct_rows(B: Matrix, may_repeat: BoolArray) -> tuple[IntArray, IntArray]:
    """Rows that remain if a row that ``may_repeat`` is left out where it equals an earlier one.

    Returns their numbers, and for each row of ``B`` the place of its equal among them.
    """
    if not may_repeat.any():
        every = np.arange(B.shape[0])
        return every, every
    rows = sparse.csr_array(B)
    rows.sort_indices()

    def key(k: int) -> object:
        """What rows have in common that are one."""
        own = slice(rows.indptr[k], rows.indptr[k + 1])
        return (rows.indices[own].tobytes(), rows.data[own].tobytes()) if may_repeat[k] else k

    kept: dict[object, int] = {}
    place = [kept.setdefault(key(k), len(kept)) for k in range(rows.shape[0])]
    return np.unique(place, return_index=True)[1], np.array(place, dtype=np.intp)


def change_of_unknowns(
    n: int,
    fixed: IntArray,
    closed: Matrix,
    slip: Matrix,
    pivots: IntArray | None = None,
) -> ChangeOfUnknowns:
    """Change of unknowns that eliminates supports and closed contact and makes slips unknowns.

    The inner unknowns come in the order of the outer ones that they stand for.

    Parameters
    ----------
    n : int
        Number of outer unknowns.
    fixed : ndarray of int
        Outer unknowns that are zero.
    closed : sparse array, shape (h, n)
        Rows that vanish: motion across a contact that stays closed.
    slip : sparse array, shape (r, n)
        Rows whose values are slips.
    pivots : ndarray of int, shape (h + r,), optional
        Outer unknown that each row determines, those of ``closed`` first. If not given, a matching
        of large coefficients chooses them.

    Raises
    ------
    InputError
        If the rows depend on each other where nothing is fixed.
    """
    free = np.ones(n, dtype=bool)
    free[fixed] = False
    rows = sparse.csr_array(sparse.vstack([sparse.csr_array(closed), sparse.csr_array(slip)]))
    rows = sparse.csr_array(rows @ sparse.diags_array(free.astype(float)))
    rows.eliminate_zeros()
    if pivots is None:
        pivots = _matched(rows)
    free[pivots] = False
    rest = np.flatnonzero(free)
    h = sparse.csr_array(closed).shape[0]
    inner = np.sort(np.concatenate([pivots[h:], rest]))
    of_slip, of_rest = np.searchsorted(inner, pivots[h:]), np.searchsorted(inner, rest)
    forward = sparse.csr_array(selection(rest, n).T @ selection(of_rest, inner.size))
    inverse = sparse.csr_array(selection(of_rest, inner.size).T @ selection(rest, n))
    if pivots.size:
        solved = _inverse(sparse.csr_array(rows[:, pivots]))
        follow = solved[:, h:] @ selection(of_slip, inner.size)
        follow = follow - solved @ rows[:, rest] @ selection(of_rest, inner.size)
        forward = forward + selection(pivots, n).T @ follow
        inverse = inverse + selection(of_slip, inner.size).T @ rows[h:]
    return ChangeOfUnknowns(_clean(forward), _clean(inverse), of_slip.astype(np.intp))


def _clean(A: Matrix) -> sparse.csr_array:
    """Compressed rows without the round-off of the elimination, whose rows are of unit size."""
    rows = sparse.csr_array(A)
    rows.data[np.abs(rows.data) < 1e-14] = 0.0
    rows.eliminate_zeros()
    rows.sort_indices()
    return rows


def _matched(rows: sparse.csr_array) -> IntArray:
    """Unknown of each row, all different, such that the sum of their coefficients is largest."""
    if rows.shape[0] == 0:
        return np.zeros(0, dtype=np.intp)
    # Before version 1.15 scipy takes 32-bit indices only, but sparse products have 64-bit ones.
    short = (index.astype(np.int32) for index in (rows.indices, rows.indptr))
    sizes = sparse.csr_array((np.abs(rows.data), *short), shape=rows.shape)
    if structural_rank(sizes) < rows.shape[0]:
        raise InputError(
            "contact: slip rows depend on each other or move fixed unknowns alone, so that not "
            "every slip can be an unknown; leave out the rows that follow from others"
        )
    row, column = min_weight_full_bipartite_matching(sizes, maximize=True)
    return np.asarray(column[np.argsort(row)], dtype=np.intp)


def _inverse(A: sparse.csr_array) -> sparse.csr_array:
    """Inverse of a square matrix that is block diagonal, with small blocks, in another order."""
    if A.nnz == A.shape[0] and np.array_equal(A.indices, np.arange(A.nnz)):
        return sparse.csr_array(sparse.diags_array(1.0 / A.data))
    _, block = connected_components(A, directed=False)
    order, sizes = np.argsort(block, kind="stable"), np.bincount(block)
    parts = []
    for size in np.unique(sizes):
        members = order[sizes[block[order]] == size].reshape(-1, size)
        rows, columns = np.repeat(members, size, axis=1), np.tile(members, size)
        dense = A[rows, columns].toarray().reshape(-1, size, size)
        if np.any(np.abs(np.linalg.det(dense)) < 1e-10):  # rows are of unit size
            raise InputError(
                "contact: slips depend on each other, as where bodies are pressed on each other in "
                "a circle; exchange the pressed part and what it is pressed against in one joint"
            )
        parts.append((np.linalg.inv(dense).ravel(), rows.ravel(), columns.ravel()))
    value, row, column = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    inverse = sparse.csr_array((value, (row, column)), shape=A.shape)
    inverse.eliminate_zeros()
    return inverse


def congruent(A: Matrix, T: Matrix) -> Matrix:
    """Symmetric product ``T^T A T``.

    If a sparse T only selects unknowns the product is a slice of A, which is faster and exact.
    """
    if isinstance(T, np.ndarray):
        product = T.T @ (A @ T)
        return 0.5 * (product + product.T)
    A, rows = sparse.csr_array(A), T.tocsc().indices
    if T.nnz == T.shape[1] == np.unique(rows).size and np.all(T.data == 1.0):
        return sparse.csr_array(A[rows][:, rows])
    product = T.T @ A @ T
    symmetric = sparse.csr_array(0.5 * (product + product.T))
    symmetric.eliminate_zeros()
    return symmetric


def stacked(parts: Sequence[Matrix], n: int) -> sparse.csr_array:
    """Sparse rows of all parts, with ``n`` columns; the matrix is empty if there are no parts."""
    if not parts:
        return sparse.csr_array((0, n))
    return sparse.csr_array(sparse.vstack([sparse.csr_array(part) for part in parts]))
