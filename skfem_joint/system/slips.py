"""Slip rows: what contact adds to the matrices of a structure, whatever they were assembled from.

A contact point slips in one direction or in two. Each direction is a row of the slip operator B,
which gives the slip from the displacements. Contact that stays closed adds rows that vanish.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import InputError
from skfem_joint.system.contacts import Contact
from skfem_joint.system.normal import NormalPart
from skfem_joint.system.unknowns import (
    ChangeOfUnknowns,
    change_of_unknowns,
    distinct_rows,
    selection,
    stacked,
)

#: A point whose slip is below this share of the largest does not count as slipping.
SLIPPING_SHARE = 1e-3
#: A joint slips as a whole if points with this share of its friction limit slip.
WHOLE_SHARE = 0.99


@dataclass(frozen=True)
class NormalRows:
    """Approaches of the nodes of contact that opens, on N degrees of freedom.

    Attributes
    ----------
    D : sparse array, shape (k, N)
        Approach of the faces at each node, m.
    pivots : ndarray of int, shape (k,)
        Degree of freedom that each row determines.
    part : NormalPart
        A pressure point for each node; its ``N``, shape (k, k), takes the approaches of the nodes.
    gain : sparse array, shape (m, k)
        Friction limit of each contact point by the normal force of each pressure point.
    """

    D: Matrix
    pivots: IntArray
    part: NormalPart
    gain: Matrix

    @staticmethod
    def none(n: int, m: int) -> NormalRows:
        """Of ``m`` contact points that stay closed, on ``n`` degrees of freedom."""
        at, gain = np.zeros(0, dtype=np.intp), sparse.csr_array((m, 0))
        return NormalRows(sparse.csr_array((0, n)), at, NormalPart.none(0), gain)

    @staticmethod
    def of_points(D: sparse.csr_array, part: NormalPart, gain: Matrix) -> NormalRows:
        """Rows of single points, for `SlipRows` without pivots."""
        pivots = np.asarray(abs(D).argmax(axis=1), dtype=np.intp)
        return NormalRows(D, pivots, part, gain)

    def __add__(self, other: NormalRows) -> NormalRows:
        """Rows of the contact points of ``self``, then those of ``other``."""
        return NormalRows(
            stacked([self.D, other.D], self.D.shape[1]),
            np.concatenate([self.pivots, other.pivots]),
            NormalPart.joined([self.part, other.part]),
            sparse.csr_array(sparse.block_diag([self.gain, other.gain])),
        )

    def without(self, free: FloatArray, keep: NDArray[np.bool_]) -> NormalRows:
        """Rows that are left where degrees of freedom (N,) are ``free`` (1) or held (0).

        ``keep`` (m,) are the contact points that can still slip. Faces approach each other only by
        what is free; at nodes that are held altogether normal forces stay as they are at rest.
        """
        D = sparse.csr_array(self.D @ sparse.diags_array(free))
        D.eliminate_zeros()
        moves = np.flatnonzero(np.diff(D.indptr) > 0)
        gain = sparse.csr_array(sparse.csc_array(self.gain)[:, moves])[np.flatnonzero(keep)]
        return NormalRows(D[moves], self.pivots[moves], self.part.among(moves), gain)


@dataclass(frozen=True)
class SlipRows:
    """Slip rows and closed contact on the N degrees of freedom of some matrices.

    They are made by `contact` and `point_friction`. ``a + b`` puts the rows of both together.
    Results state friction energies by the names of the contact points; points of the same name are
    the same joint.

    Attributes
    ----------
    B : sparse array, shape (rows, N)
        Slip from the displacements; the rows of a contact point follow each other.
    w : ndarray, shape (m,)
        Friction limit of each contact point, N; with contact that opens that at rest.
    beta : ndarray, shape (m,)
        Steepness of the law of friction of each point, s/m; ``inf`` is Coulomb.
    directions : ndarray of int, shape (m,)
        Rows of each point, 1 or 2.
    closed : sparse array, shape (h, N)
        Rows that vanish: motion across a contact that stays closed.
    pivots : ndarray of int, shape (h + rows,), optional
        Degree of freedom that each row determines, those of ``closed`` first. If not given, a
        matching of large coefficients chooses them.
    clamped : ndarray, shape (h,)
        Normal force on each row of ``closed``, N; zeros where it is not given.
    names : tuple of str, length m
        Joint that each contact point belongs to; "contact" if not given.
    stiffness : ndarray, shape (m,)
        Of the spring in series with the friction of each point, N/m; ``inf``, which is none, at all
        points if not given.
    normal : NormalRows
        Contact that opens and closes; none if not given.
    notes : tuple of str
        Sentences about the contact, which go to those of the `System`.
    """

    B: Matrix
    w: FloatArray
    beta: FloatArray
    directions: NDArray[np.int64]
    closed: Matrix
    pivots: IntArray | None = None
    clamped: Any = None
    names: tuple[str, ...] = ()
    stiffness: Any = None
    normal: Any = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, m = self.B.shape[-1], self.w.size
        completed = {
            "clamped": np.zeros(self.closed.shape[0]) if self.clamped is None else self.clamped,
            "names": self.names or ("contact",) * m,
            "stiffness": np.full(m, np.inf) if self.stiffness is None else self.stiffness,
            "normal": NormalRows.none(n, m) if self.normal is None else self.normal,
        }
        for name, value in completed.items():
            object.__setattr__(self, name, value)

    @property
    def joints(self) -> tuple[tuple[str, ...], sparse.csr_array]:
        """Names of the joints, and a matrix (joints, m) with a 1 for each point of a joint."""
        numbers = {name: number for number, name in enumerate(dict.fromkeys(self.names))}
        joint = np.array([numbers[name] for name in self.names], dtype=np.intp)
        return tuple(numbers), sparse.csr_array(selection(joint, len(numbers)).T)

    def change_of_unknowns(self, fixed: IntArray, approaches: bool = True) -> ChangeOfUnknowns:
        """Unknowns in which slips, and approaches of contact that opens, are unknowns.

        Its ``slips`` are of the rows of ``B``, then those of approaches, if these shall be
        unknowns. Points with springs and the same row share an unknown.
        """
        n, h = self.B.shape[1], self.closed.shape[0]
        on_springs = np.repeat(np.isfinite(self.stiffness), self.directions)
        kept, place = distinct_rows(self.B, on_springs)
        own_rows = self.normal.D if approaches else self.normal.D[:0]
        rows, pivots = stacked([sparse.csr_array(self.B)[kept], own_rows], n), self.pivots
        if pivots is not None:
            own = self.normal.pivots if approaches else self.normal.pivots[:0]
            pivots = np.concatenate([pivots[:h], pivots[h:][kept], own])
        new = change_of_unknowns(n, fixed, self.closed, rows, pivots)
        return replace(new, slips=np.concatenate([new.slips[place], new.slips[kept.size :]]))

    def contact_in(self, new: ChangeOfUnknowns) -> Contact:
        """Contact in the unknowns of :meth:`change_of_unknowns`."""
        n, rows = new.forward.shape[1], self.B.shape[0]
        own = new.slips[rows:]
        joints, J = self.joints
        normal, gain = self.normal.part, self.normal.gain
        N = selection(own, n) if own.size else self.normal.D @ new.forward
        normal = normal.in_unknowns(N)
        given = self.w - gain @ normal.force
        given[given <= 1e-12 * self.w] = 0.0  # round-off
        return Contact(
            B=selection(new.slips[:rows], n),
            given=given,
            beta=self.beta,
            directions=self.directions,
            stiffness=self.stiffness,
            normal=normal,
            gain=self.normal.gain,
            J=J,
            joints=joints,
        )

    def __add__(self, other: SlipRows) -> SlipRows:
        """Slip rows of ``self``, then those of ``other``."""
        n = self.B.shape[1]
        if other.B.shape[1] != n:
            raise InputError(f"contact: found rows for {n} and for {other.B.shape[1]} unknowns")
        pivots, both = None, (self, other)
        if self.pivots is not None and other.pivots is not None:
            h, k = self.closed.shape[0], other.closed.shape[0]
            pivots = np.concatenate(
                [self.pivots[:h], other.pivots[:k], self.pivots[h:], other.pivots[k:]]
            )
        values: dict[str, Any] = {
            name: np.concatenate([getattr(rows, name) for rows in both])
            for name in ("w", "beta", "directions", "clamped", "stiffness")
        }
        for name in ("names", "normal", "notes"):
            values[name] = getattr(self, name) + getattr(other, name)
        B, closed = (stacked([getattr(x, name) for x in both], n) for name in ("B", "closed"))
        return SlipRows(B=B, closed=closed, pivots=pivots, **values)

    @staticmethod
    def none(n: int) -> SlipRows:
        """No contact, for matrices of ``n`` degrees of freedom."""
        empty, rows = np.zeros(0), sparse.csr_array((0, n))
        return SlipRows(rows, empty, empty, np.zeros(0, np.int64), rows, np.zeros(0, np.intp))

    def without(self, fixed: IntArray) -> SlipRows:
        """Slip rows that remain when supports hold the degrees of freedom ``fixed``.

        Columns of fixed degrees of freedom become zero. If rows of a point then depend on each
        other or on closed contact, they are replaced by independent rows that give the slip vector
        the same norm.
        """
        n = self.B.shape[1]
        free = np.ones(n)
        free[fixed] = 0.0
        touched, cut, across = (
            np.asarray(abs(A) @ (1.0 - free)) > 0.0 for A in (self.B, self.closed, self.normal.D)
        )
        if not touched.any() and not cut.any() and not across.any():
            return self
        B, closed = (sparse.csr_array(A @ sparse.diags_array(free)) for A in (self.B, self.closed))
        closed.eliminate_zeros()
        closed = closed[np.diff(closed.indptr) > 0]
        rows = []
        for own in np.split(np.arange(B.shape[0]), np.cumsum(self.directions))[:-1]:
            rows.append(B[own])
            if touched[own].any():
                moved = np.unique(rows[-1].nonzero()[1])
                beside = closed[:, moved].toarray()
                left = _independent(rows[-1][:, moved].toarray(), beside[beside.any(axis=1)])
                rows[-1] = sparse.csr_array(left @ selection(moved, n))
        directions = np.array([own.shape[0] for own in rows], dtype=np.int64)
        keep = directions > 0
        names = tuple(np.array(self.names, dtype=object)[keep])
        held = [name for name in dict.fromkeys(self.names) if name not in names]
        return SlipRows(
            stacked(rows, n),
            self.w[keep],
            self.beta[keep],
            directions[keep],
            closed,
            names=names,
            stiffness=self.stiffness[keep],
            normal=self.normal.without(free, keep),
            notes=(
                *self.notes,
                *(f"Joint '{name}' carries no friction: supports hold all of it." for name in held),
            ),
        )


def _independent(rows: FloatArray, beside: FloatArray) -> FloatArray:
    """Independent rows that keep the norm of ``rows @ u`` for all u with ``beside @ u = 0``."""
    if len(beside):
        rows = rows - rows @ np.linalg.pinv(beside) @ beside
    _, size, right = np.linalg.svd(rows, full_matrices=False)
    keep = size > 1e-9 * max(1.0, size.max(initial=0.0))
    return rows if keep.all() and len(keep) == len(rows) else size[keep, np.newaxis] * right[keep]


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Unit vectors along given ones, (k, dim); zero where these are zero."""
    size = np.linalg.norm(vectors, axis=1)[:, None]
    return np.asarray(vectors / np.where(size > 0.0, size, 1.0))


def rows_along(point: IntArray, vectors: FloatArray, m: int) -> sparse.csr_array:
    """Rows that take the components of ``m`` points' displacements along some vectors.

    Parameters
    ----------
    point : ndarray of int, shape (k,)
        Point of each row.
    vectors : ndarray, shape (k, dim)
        Directions; their lengths do not count.

    Returns
    -------
    sparse array, shape (k, dim m)
        Rows on ``dim * point + component``.
    """
    k, dim = vectors.shape
    columns = dim * point[:, None] + np.arange(dim)
    entries = unit_vectors(vectors).ravel(), columns.ravel(), dim * np.arange(k + 1)
    picked = sparse.csr_array(entries, shape=(k, dim * m))
    picked.eliminate_zeros()
    return picked
