"""Slips as unknowns: the change of variables after which each slip row picks one unknown.

Displacements u that obey ``u[fixed] = 0`` and ``H u = 0`` (contact that stays closed), with slips
``s = B u``, are written ``u = T q``. The unknowns q are the slips and those displacements that
nothing determines. Forces then follow from ``T`` transposed: a body that another is pressed on gets
the reaction, equal, opposite and along the same line. Supports, edges, faces, rigid bases and other
bodies are one case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import (
    connected_components,
    min_weight_full_bipartite_matching,
    structural_rank,
)

from skfem_joint.arrays import FloatArray, IntArray, Matrix
from skfem_joint.errors import InputError

if TYPE_CHECKING:
    from skfem_joint.system import System

#: Determinants below this are those of rows that depend on each other (rows of unit size).
_SINGULAR = 1e-10
#: Entries below this are round-off of the elimination.
_ROUND_OFF = 1e-14


@dataclass(frozen=True)
class Contact:
    """Friction rows to be added to matrices: what `contact` and `point_friction` make.

    ``a + b`` puts two contacts side by side. Results tell friction energies by the names of the
    contact points; points of the same name are one joint.
    """

    B: Matrix  #: (rows, n) slip from the unknowns of the matrices; a point's rows follow each other
    w: FloatArray  #: (m,) friction limit of each contact point, N
    beta: FloatArray  #: (m,) scaling constant of Eq. (2) of each, s/m; ``inf`` is Coulomb
    directions: NDArray[np.int64]  #: (m,) rows of each point, 1 or 2
    held: Matrix  #: (h, n) rows that vanish: motion across a contact that stays closed
    #: (h + rows,) unknown that each row determines, ``held`` first; None: found by a matching
    pivots: IntArray | None = None
    clamped: FloatArray | None = None  #: (h,) normal force on each of ``held``, N, if known
    names: tuple[str, ...] = ()  #: (m,) joint that each contact point is of; () if none has a name

    @property
    def normal_force(self) -> FloatArray:
        """``clamped``, or zeros, (h,), N."""
        return np.zeros(self.held.shape[0]) if self.clamped is None else self.clamped

    @property
    def joint_of_point(self) -> tuple[str, ...]:
        """``names``, or "contact" for each contact point, (m,)."""
        return self.names or ("contact",) * self.w.size

    @property
    def joints(self) -> tuple[tuple[str, ...], sparse.csr_array]:
        """Names of the joints, and which contact points each has, (joints, m)."""
        names = self.joint_of_point
        numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
        joint = np.array([numbers[name] for name in names], dtype=np.intp)
        return tuple(numbers), sparse.csr_array(selection(joint, len(numbers)).T)

    def __add__(self, other: Contact) -> Contact:
        """Both contacts, this one first."""
        n = self.B.shape[1]
        if other.B.shape[1] != n:
            raise InputError(f"contact: found rows for {n} and for {other.B.shape[1]} unknowns")
        pivots = None
        if self.pivots is not None and other.pivots is not None:
            h, k = self.held.shape[0], other.held.shape[0]
            pivots = np.concatenate(
                [self.pivots[:h], other.pivots[:k], self.pivots[h:], other.pivots[k:]]
            )
        return Contact(
            B=stacked([self.B, other.B], n),
            w=np.concatenate([self.w, other.w]),
            beta=np.concatenate([self.beta, other.beta]),
            directions=np.concatenate([self.directions, other.directions]),
            held=stacked([self.held, other.held], n),
            pivots=pivots,
            clamped=np.concatenate([self.normal_force, other.normal_force]),
            names=(*self.joint_of_point, *other.joint_of_point),
        )

    @staticmethod
    def none(n: int) -> Contact:
        """No contact for matrices of ``n`` unknowns."""
        empty, rows = np.zeros(0), sparse.csr_array((0, n))
        return Contact(rows, empty, empty, np.zeros(0, np.int64), rows, np.zeros(0, np.intp))

    def without(self, fixed: IntArray) -> Contact:
        """Same contact where some unknowns are fixed: what a support holds does not slip."""
        n = self.B.shape[1]
        free = np.ones(n)
        free[fixed] = 0.0
        touched, cut = (np.asarray(abs(A) @ (1.0 - free)) > 0.0 for A in (self.B, self.held))
        if not touched.any() and not cut.any():
            return self
        B, held = (sparse.csr_array(A @ sparse.diags_array(free)) for A in (self.B, self.held))
        held.eliminate_zeros()
        held = held[np.diff(held.indptr) > 0]
        rows = []
        for own in np.split(np.arange(B.shape[0]), np.cumsum(self.directions))[:-1]:
            rows.append(B[own])
            if touched[own].any():
                moved = np.unique(rows[-1].nonzero()[1])
                beside = held[:, moved].toarray()
                left = _independent(rows[-1][:, moved].toarray(), beside[beside.any(axis=1)])
                rows[-1] = sparse.csr_array(left @ selection(moved, n))
        directions = np.array([own.shape[0] for own in rows], dtype=np.int64)
        keep = directions > 0
        names = tuple(np.array(self.joint_of_point, dtype=object)[keep])
        return Contact(
            stacked(rows, n), self.w[keep], self.beta[keep], directions[keep], held, names=names
        )


@dataclass(frozen=True)
class Arrangement:
    """Two sets of unknowns of one system, and how each follows from the other."""

    forward: sparse.csr_array  #: (outer, inner), T: outer unknowns from the inner ones
    inverse: sparse.csr_array  #: (inner, outer), of outer unknowns that obey the constraints
    slips: IntArray  #: (rows of B,), inner unknown that is the slip of each row


def dof_numbers(given: Any, n: int, where: str = "fixed", first: int = 0) -> IntArray:
    """Numbers of degrees of freedom, given as such or by scikit-fem's ``get_dofs``, rising.

    There are ``n``, which count from ``first``; those returned count from 0.

    Raises
    ------
    InputError
        If they are not whole numbers in range, such as a mask.
    """
    # An array has a method of that name too, which tells something else.
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
    """``T u`` along the last axis of ``u``, (..., n)."""
    return np.asarray((T @ u.reshape(-1, u.shape[-1]).T).T).reshape(*u.shape[:-1], -1)


def selection(columns: IntArray, n: int) -> sparse.csr_array:
    """Matrix whose rows each pick one of ``n`` columns."""
    ones = np.ones(columns.size)
    return sparse.csr_array((ones, (np.arange(columns.size), columns)), shape=(columns.size, n))


def change_of_unknowns(
    n: int,
    fixed: IntArray,
    held: Matrix,
    slip: Matrix,
    pivots: IntArray | None = None,
) -> Arrangement:
    """Make the slips unknowns, and eliminate supports and closed contact.

    Of ``n`` outer unknowns, the ``fixed`` are zero. Rows ``held`` (h, n) vanish, the values of rows
    ``slip`` (r, n) are slips; together they are of full rank on the unknowns that are not fixed,
    else InputError. ``pivots`` (h + r,) is the unknown that each row determines, first those of
    ``held``, found by a matching of the largest coefficients if not given. The inner unknowns come
    in the order of the outer ones that they stand for.
    """
    free = np.ones(n, dtype=bool)
    free[fixed] = False
    rows = sparse.csr_array(sparse.vstack([sparse.csr_array(held), sparse.csr_array(slip)]))
    rows = sparse.csr_array(rows @ sparse.diags_array(free.astype(float)))
    rows.eliminate_zeros()
    if pivots is None:
        pivots = _matched(rows)
    free[pivots] = False
    rest = np.flatnonzero(free)
    h = sparse.csr_array(held).shape[0]
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
    return Arrangement(_clean(forward), _clean(inverse), of_slip.astype(np.intp))


def _clean(A: Matrix) -> sparse.csr_array:
    rows = sparse.csr_array(A)
    rows.data[np.abs(rows.data) < _ROUND_OFF] = 0.0
    rows.eliminate_zeros()
    rows.sort_indices()
    return rows


def _matched(rows: sparse.csr_array) -> IntArray:
    """Unknown of its own for each row, with large coefficients."""
    if rows.shape[0] == 0:
        return np.zeros(0, dtype=np.intp)
    # scipy before 1.15 takes short indices only, and sparse products give long ones.
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
    """Inverse of a square matrix that falls apart into small blocks."""
    if A.nnz == A.shape[0] and np.array_equal(A.indices, np.arange(A.nnz)):
        return sparse.csr_array(sparse.diags_array(1.0 / A.data))
    _, block = connected_components(A, directed=False)
    order, sizes = np.argsort(block, kind="stable"), np.bincount(block)
    parts = []
    for size in np.unique(sizes):
        members = order[sizes[block[order]] == size].reshape(-1, size)
        rows, columns = np.repeat(members, size, axis=1), np.tile(members, size)
        dense = A[rows, columns].toarray().reshape(-1, size, size)
        if np.any(np.abs(np.linalg.det(dense)) < _SINGULAR):
            raise InputError(
                "contact: slips depend on each other, as where bodies are pressed on each other in "
                "a circle; exchange the pressed part and what it is pressed against in one joint"
            )
        parts.append((np.linalg.inv(dense).ravel(), rows.ravel(), columns.ravel()))
    value, row, column = (np.concatenate(some) for some in zip(*parts, strict=True))
    found = sparse.csr_array((value, (row, column)), shape=A.shape)
    found.eliminate_zeros()
    return found


def congruent(A: Matrix, T: Matrix) -> Matrix:
    """``T^T A T`` made symmetric; a slice where a sparse T only selects unknowns."""
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


def _independent(rows: FloatArray, beside: FloatArray) -> FloatArray:
    """Rows with the same norm of ``rows @ u`` for all u with ``beside @ u = 0``, independent."""
    if len(beside):
        rows = rows - rows @ np.linalg.pinv(beside) @ beside
    _, size, right = np.linalg.svd(rows, full_matrices=False)
    keep = size > 1e-9 * max(1.0, size.max(initial=0.0))
    return rows if keep.all() and len(keep) == len(rows) else size[keep, np.newaxis] * right[keep]


def slips_as_unknowns(system: System) -> tuple[System, Arrangement]:
    """System of the same structure in whose slip operator each row picks an unknown of its own.

    Its unknowns are the slips, and the displacements that the slips leave. The given one is sparse,
    with slip rows of any kind that do not depend on each other, else InputError.
    """
    none = np.zeros(0, dtype=np.intp)
    new = change_of_unknowns(system.n, none, sparse.csr_array((0, system.n)), system.B)
    return system.in_unknowns(new), new


def stacked(parts: Sequence[Matrix], n: int) -> sparse.csr_array:
    """Sparse rows below each other; none give an empty matrix of ``n`` columns."""
    if not parts:
        return sparse.csr_array((0, n))
    return sparse.csr_array(sparse.vstack([sparse.csr_array(part) for part in parts]))
