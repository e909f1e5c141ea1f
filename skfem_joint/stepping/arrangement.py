"""The unknowns in which a system is stepped, the kind of its matrices, and the method for it.

All follow from the matrices, never from the kind of structure: a line mesh whose nodes are
numbered at random is renumbered into a chain, and slips that are differences of displacements
become unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee, structural_rank

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.linalg.schur import condensing_pays
from skfem_joint.minimise.problem import ContactPoints, LinearProblem, StepProblem
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import ChangeOfUnknowns, selection

#: Most unknowns of a sparse system with dependent slips: it can only be stepped as a dense one.
MOST_DENSE = 500
#: What slips and approaches must be if they are no unknowns of their own.
_SMOOTH = (
    "each must have its own, or contact be elastic (normal_stiffness) and friction have springs "
    f"(tangential_stiffness) or a finite beta, in a system of at most {MOST_DENSE} unknowns, such "
    "as sj.condense makes"
)


@dataclass(frozen=True)
class Arranged:
    """System in stepping unknowns, with maps to and from the caller's unknowns.

    It has the same contact points, slip rows, loads and named points.

    Attributes
    ----------
    system : System
    kind : str
        Of its matrices: "linear" (no friction), "chain" (tridiagonal, each slip an unknown),
        "contact" (each slip an unknown, and each approach where contact opens) or "dense".
    maps : tuple of ChangeOfUnknowns
        Changes of unknowns that led to it, in turn; none if the unknowns are the caller's.
    """

    system: System
    kind: str
    maps: tuple[ChangeOfUnknowns, ...] = ()

    def inner(self, u: FloatArray) -> FloatArray:
        """Stepping unknowns, (n,), from the caller's."""
        for arrangement in self.maps:
            u = np.asarray(arrangement.inverse @ u)
        return u

    def force(self, f: FloatArray) -> FloatArray:
        """Forces on the stepping unknowns, (n,), from those on the caller's."""
        for arrangement in self.maps:
            f = np.asarray(arrangement.forward.T @ f)
        return f

    def outer(self, u: FloatArray) -> FloatArray:
        """The caller's unknowns, (..., n), from the stepping ones."""
        for arrangement in reversed(self.maps):
            u = np.ascontiguousarray((arrangement.forward @ u.T).T)
        return u

    def outer_number(self, unknown: int) -> int:
        """The caller's unknown that depends most on a stepping unknown."""
        for arrangement in reversed(self.maps):
            column = sparse.csc_array(arrangement.forward)[:, [unknown]].tocoo()
            unknown = int(column.coords[0][np.abs(column.data).argmax()])
        return unknown


def arranged(system: System) -> Arranged:
    """System in unknowns that include the slips, renumbered into a chain where that is possible.

    Dense systems (reduced or condensed), systems without friction, and small ones whose slip rows
    depend on each other keep their unknowns.

    Raises
    ------
    InputError
        If slip rows of a large system depend on each other, or approaches of contact that opens
        on slips.
    """
    if system.contact.opens:
        return _arranged_opening(system)
    if system.contact.count == 0:
        return Arranged(system, "linear")
    if system.is_dense:  # a sparse B tells that slips are unknowns
        keeps = not isinstance(system.contact.B, np.ndarray) and slips_are_unknowns(system)
        return Arranged(system, "contact" if keeps else "dense")
    maps: tuple[ChangeOfUnknowns, ...] = ()
    if not slips_are_unknowns(system):
        try:
            system, slips = system.with_slips_as_unknowns()
        except InputError:
            if system.n > MOST_DENSE:
                raise
            return Arranged(system, "dense")
        maps = (slips,)
    if is_chain(system):
        return Arranged(system, "chain", maps)
    path = _path(system) if picks_unknowns(system.contact.B) else None
    if path is not None:
        return Arranged(system.in_unknowns(path), "chain", (*maps, path))
    return Arranged(system, "contact", maps)


def _arranged_opening(system: System) -> Arranged:
    """Of a system with contact that opens: slips are unknowns, apart from those that approach.

    Reduced models keep their unknowns, and so do small systems whose slips or approaches depend on
    each other, if contact is elastic and friction smooth. A rigid point that touches could not slip
    where it approaches by that, and how rigid points share a force at one place is not determined.
    """
    given, contact = system, system.contact.normal
    maps: tuple[ChangeOfUnknowns, ...] = ()
    if isinstance(contact.N, np.ndarray):
        return Arranged(system, "dense")
    try:
        if not slips_are_unknowns(system):
            system, slips = system.with_slips_as_unknowns()
            maps = (slips,)
        N = sparse.csr_array(system.contact.normal.N)
        if np.isin(N.indices, sparse.csr_array(system.contact.B).indices).any():
            raise InputError(
                "contact that opens: its normal motion and a slip are the same displacement; "
                f"{_SMOOTH}"
            )
        if structural_rank(N) < N.shape[0]:
            raise InputError(
                "contact that opens: points approach by the same displacement, or by none; "
                f"{_SMOOTH}"
            )
    except InputError:
        smooth = np.isfinite(given.contact.beta) | given.contact.sprung | ~given.contact.rubs
        if contact.rigid.any() or not smooth.all() or given.n > MOST_DENSE:
            raise
        return Arranged(given, "dense")
    return Arranged(system, "contact", maps)


def _path(system: System) -> ChangeOfUnknowns | None:
    """Numbering of the unknowns in which the matrices are tridiagonal; None if there is none."""
    n = system.n
    pattern = sparse.csr_array(abs(system.M) + abs(system.C) + abs(system.K))
    pattern.setdiag(0.0)
    pattern.eliminate_zeros()
    if np.any(system.contact.directions != 1) or np.diff(pattern.indptr).max(initial=0) > 2:
        return None
    # Breadth first from an end: along each path, unless it is closed to a ring.
    order = reverse_cuthill_mckee(sparse.csr_array(pattern), symmetric_mode=True).astype(np.intp)
    rank = np.empty(n, dtype=np.intp)
    rank[order] = np.arange(n)
    row, column = pattern.tocoo().coords
    if np.any(np.abs(rank[row] - rank[column]) > 1):
        return None
    picks = selection(order, n)
    slips = rank[sparse.csr_array(system.contact.B).indices]
    return ChangeOfUnknowns(sparse.csr_array(picks.T), picks, slips)


def is_chain(system: System) -> bool:
    """Whether a sparse system is tridiagonal, and each slip row picks an unknown of its own."""
    for A in (system.M, system.C, system.K):
        rows = as_compressed(A)
        row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
        beyond = np.abs(row - rows.indices) > 1
        if beyond.any() and rows.data[beyond].any():
            return False
    return bool(np.all(system.contact.directions == 1)) and picks_unknowns(system.contact.B)


def slips_are_unknowns(system: System) -> bool:
    """Whether each slip row picks an unknown of its own, or one that points with springs share."""
    if not system.contact.has_springs:
        return picks_unknowns(system.contact.B)
    rows = sparse.csr_array(system.contact.B)
    if not ((np.diff(rows.indptr) == 1).all() and (rows.data == 1.0).all()):
        return False
    column, sprung = rows.indices, system.contact.on_rows(system.contact.sprung)
    shared = np.bincount(column)[column] > 1
    if not sprung[shared].all():
        return False
    # Points that share an unknown must share all of them, in the same order.
    first = system.contact.first_row[:-1]
    pair = system.contact.directions == 2
    second = np.full(first.size, -1)
    second[pair] = column[first[pair] + 1]
    unknowns = np.unique(np.column_stack([column[first], second]), axis=0)
    used = unknowns[unknowns >= 0]
    return np.unique(used).size == used.size


def picks_unknowns(B: Any) -> bool:
    """Whether each row holds a single 1, in a column of its own."""
    rows = B if isinstance(B, sparse.csr_array) else sparse.csr_array(B)
    if not ((np.diff(rows.indptr) == 1).all() and (rows.data == 1.0).all()):
        return False
    return rows.indices.size == 0 or bool(np.bincount(rows.indices).max() == 1)


def step_problem(H: Any, points: ContactPoints, kind: str, condense: bool = True) -> StepProblem:
    """Step problem by the method for a kind of matrices.

    - "chain" (H tridiagonal, each slip an unknown):
      :class:`~skfem_joint.minimise.front_elimination.FrontElimination`;
    - "contact" (any other H with each slip an unknown):
      :class:`~skfem_joint.minimise.contact_newton.ContactNewton`, or
      :class:`~skfem_joint.minimise.condensed_newton.CondensedNewton` where that is cheaper, and
      always where contact opens;
    - "dense" (dense H with slips that depend on each other, as in reduced models):
      :class:`~skfem_joint.minimise.primal_dual_newton.PrimalDualNewton`;
    - "linear" (no friction at all): `LinearProblem`.

    Chains and dense problems are minimised in the compiled loop over steps, others by
    `skfem_joint.stepping.driver.PythonStepper`, one minimisation at a time.

    Parameters
    ----------
    H : ndarray or csr_array, shape (n, n), or its compiled form
        Symmetric positive definite; N s/m for the velocity.
    points : ContactPoints
    kind : str
        As `arranged` finds it. All but "linear" load the compiler.
    condense : bool
        Whether a problem of kind "contact" may be condensed to the contact. That pays if it is
        minimised more than once.
    """
    if kind == "linear":
        return LinearProblem(H, points)
    if kind == "chain":
        from skfem_joint.minimise.front_elimination import FrontElimination

        return FrontElimination(H, points)
    if kind == "dense":
        from skfem_joint.minimise.primal_dual_newton import PrimalDualNewton

        return PrimalDualNewton(H, points)
    from skfem_joint.minimise.condensed_newton import CondensedNewton
    from skfem_joint.minimise.contact_newton import ContactNewton

    opens = points.normal is not None
    pays = opens or (condense and condensing_pays(H, points.limited))
    return CondensedNewton(H, points) if pays else ContactNewton(H, points)
