"""How a solution of a step problem changes with what it is given: its linearisation.

At a solution v of a step problem (:mod:`skfem_joint.minimise.problem`), with friction F at the
slips y = B v - offset and normal forces p, changes obey

    H dv + B^T dF + N^T dp = dg,
    dF = T (B dv - d offset) + dF/dw dw,       dw = d given + gain dp,
    dp = stiffness (N dv - d bound),

with the same points sticking, slipping, closed and open:

- a Coulomb point that sticks without a spring has B dv = d offset, and the friction that balances;
- a rigid pressure point that is pressed has N dv = d bound, and the force that balances;
- points without a limit have dF = 0, and open ones dp = 0.

T is the tangent of a slip vector, :func:`skfem_joint.minimise.law.slip_tangent`. Friction changes
by dF/dw = sigma (1 - soft slope) under another limit: on a spring whose slider sticks it does not.
A flexibility that changes by df is a change F df of the offset.

Where a point is just turning from one state to another there are two derivatives, one to each side:
that of the state which it has is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Protocol, cast

import numpy as np
from scipy import linalg, sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, as_dense, slip_norms
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.factors import BlockFactors, RowFactors
from skfem_joint.linalg.schur import SchurComplement, Uncondensed
from skfem_joint.minimise.law import along_and_across, slip_tangent
from skfem_joint.minimise.problem import ContactPoints, PressurePoints


class Changes(NamedTuple):
    """Changes of what a minimisation is given, a column for each of k; None where there are none.

    Attributes
    ----------
    force : ndarray, shape (n, k)
        Of the right side g.
    offset : ndarray, shape (rows, k)
        Of the slips from which those of each row count.
    given : ndarray, shape (m, k)
        Of the friction limits, but for what normal forces change them by.
    bound : ndarray, shape (q, k)
        Of the bounds of the approaches.
    """

    force: FloatArray
    offset: FloatArray | None = None
    given: FloatArray | None = None
    bound: FloatArray | None = None


class Tangent(NamedTuple):
    """Derivatives of the contact forces at a solution.

    Attributes
    ----------
    blocks : ndarray, shape (m, 3)
        Entries 11, 12 and 22 of the tangent T of each point.
    by_limit : ndarray, shape (rows,)
        Derivative of the friction of each row by its limit.
    sticks : ndarray of int
        Rows of Coulomb points that stick without a spring.
    acts : ndarray of bool, shape (m,)
        Points that have a friction limit.
    pressed : ndarray of bool, shape (q,)
        Pressure points that are pressed.
    """

    blocks: FloatArray
    by_limit: FloatArray
    sticks: IntArray
    acts: BoolArray
    pressed: BoolArray


class LinearisedProblem(Protocol):
    """Step problem with friction, whose solutions have a linearisation."""

    def linearisation(self, beta: FloatArray | None = None) -> Linearisation:
        """Linearisation of the problem, with the values of ``beta`` that `minimise` was given."""


class Condensation(Protocol):
    """Elimination of unknowns that no contact acts on."""

    def restrict(self, g: FloatArray) -> tuple[FloatArray, Any]:
        """Right sides of the unknowns that are kept, and what `extend` needs beside them."""

    def extend(self, z: FloatArray, beside: Any) -> FloatArray:
        """All unknowns from those that are kept."""


class _Twice:
    """A condensation, and another one of what it keeps."""

    def __init__(self, outer: Condensation, inner: Condensation) -> None:
        self.outer, self.inner = outer, inner

    def restrict(self, g: FloatArray) -> tuple[FloatArray, Any]:
        """See `Condensation`."""
        right, outside = self.outer.restrict(g)
        right, inside = self.inner.restrict(right)
        return right, (outside, inside)

    def extend(self, z: FloatArray, beside: Any) -> FloatArray:
        """See `Condensation`."""
        outside, inside = beside
        return self.outer.extend(self.inner.extend(z, inside), outside)


class Linearisation:
    """Linearisation of a step problem whose slips are unknowns, for all of its solutions.

    Parameters
    ----------
    H : ndarray or csr_array, shape (n, n)
        Dense with pressure points.
    points : ContactPoints
        Each row of ``B``, and of ``N``, picks an unknown, or none where nothing acts.
    outer : Condensation, optional
        What H was condensed by: ``restrict`` and ``extend`` are its own. They do nothing if it is
        not given.
    """

    def __init__(self, H: Any, points: ContactPoints, outer: Condensation | None = None) -> None:
        self.H, self.points, self.outer = H, points, outer or Uncondensed(H)
        self.restrict, self.extend = self.outer.restrict, self.outer.extend
        self.first, self.pairs = points.first_row[:-1], np.flatnonzero(points.directions == 2)
        self.second = self.first[self.pairs] + 1
        self.B = points.B
        self._arrange()

    @property
    def _normal(self) -> PressurePoints:
        """Pressure points, of a problem that has them."""
        return cast("PressurePoints", self.points.normal)

    def _arrange(self) -> None:
        """Place the contact among the unknowns."""
        self.B, self.place = sparse.csr_array(self.B), _picked(self.B)
        self.Bt = sparse.csr_array(self.B.T)
        first, second = self.place[self.first], np.full(self.first.size, -1)
        second[self.pairs] = self.place[self.second]
        self._acting: Any = np.flatnonzero(first >= 0)
        unknowns = first[self._acting], second[self._acting]
        self._factors: BlockFactors | RowFactors = BlockFactors(self.H, *unknowns)
        if self.points.normal is None:
            return
        # What normal forces act on: their own unknowns, and slips by the limits that they give.
        by_point = sparse.csr_array(self._normal.gain)
        gain = by_point[self.points.on_rows(np.arange(by_point.shape[0]))].tocoo()
        self._approach = _picked(self._normal.N)
        presses = np.flatnonzero(self._approach >= 0)
        onto = np.concatenate([self.place[gain.row], self._approach[presses]])
        self._order = np.argsort(onto, kind="stable")[np.count_nonzero(onto < 0) :]
        start = np.searchsorted(onto[self._order], np.arange(len(self.H) + 1))
        pressure = np.concatenate([gain.col, presses])[self._order]
        self._pattern, self._entries = (pressure, start), (gain.data, gain.row, presses)

    def among(self, rubs: BoolArray, presses: BoolArray) -> Linearisation:
        """The same, condensed to the unknowns of points that carry a force at any solution.

        ``rubs``, (m,), and ``presses``, (q,), mark the contact points and pressure points.
        """
        normal = self._normal
        slips = self.place[self.points.on_rows(rubs)]
        schur = SchurComplement(self.H, np.union1d(slips, self._approach[presses]))
        normal = replace(normal, N=sparse.csr_array(normal.N)[:, schur.kept])
        points = replace(self.points.in_unknowns(schur.kept), normal=normal)
        return Linearisation(schur.complement, points, _Twice(self.outer, schur))

    def at(
        self, slip: FloatArray, w: FloatArray | None = None, p: FloatArray | None = None
    ) -> list[Tangent]:
        """Tangents at some solutions.

        Parameters
        ----------
        slip : ndarray, shape (solutions, rows)
            B v - offset; zero where Coulomb points stick.
        w : ndarray, shape (solutions, m), optional
            Friction limits, N; those of the points if not given.
        p : ndarray, shape (solutions, q), optional
            Normal forces, N; needed with pressure points.
        """
        points, pairs, size = self.points, self.pairs, slip_norms(slip, self.points.directions)
        w = np.broadcast_to(points.w, size.shape) if w is None else w
        p = np.zeros((len(slip), 0)) if p is None else p
        acts, soft = w > 0.0, 0.0 if points.flexible is None else w * points.flexible
        along, across = along_and_across(size, points.beta, soft)
        by_limit = np.where(acts, across, 0.0) * (1.0 - soft * along)
        along, across = w * along, w * across
        blocks = np.zeros((*size.shape, 3))
        blocks[..., 0] = along
        if pairs.size:
            norm = np.where(size > 0.0, size, 1.0)[:, pairs]
            x, y = slip[:, self.first[pairs]] / norm, slip[:, self.second] / norm
            entries = slip_tangent(along[:, pairs] - across[:, pairs], across[:, pairs], x, y, x, y)
            blocks[:, pairs] = np.stack(entries, axis=-1)
        sticks = acts & np.isinf(points.beta) & ~points.has_spring & (size == 0.0)
        by_limit, sticks = (np.repeat(x, points.directions, axis=1) for x in (by_limit, sticks))
        sticks = map(np.flatnonzero, sticks & (self.place >= 0))
        of_solutions = blocks, by_limit * slip, sticks, acts, p > 0.0
        return list(map(Tangent, *of_solutions))

    def solve(self, at: Tangent, change: Changes) -> tuple[FloatArray, FloatArray]:
        """Changes of a solution: of v, (n, k), and of the normal forces, (q, k), N.

        Raises
        ------
        LinAlgError, InputError or RuntimeError
            If everything slips, so that a solution is not determined; by whoever finds no factor.
        """
        right, offset, given, bound = change
        v, fixed = np.zeros_like(right), np.zeros(len(right), dtype=np.bool_)
        fixed[self.place[at.sticks]] = True
        if offset is not None:
            v[self.place[at.sticks]] = offset[at.sticks]
            right = right - self.Bt @ self.friction(at, -offset, given)
        if self.points.normal is not None:
            return self._coupled(at, right, bound, v, fixed)
        if not fixed.all():
            solve = self._factors.factorised(at.blocks[self._acting], fixed)
            v += solve(right - self.H @ v if offset is not None and at.sticks.size else right)
        return v, np.zeros((0, v.shape[1]))

    def friction(
        self, at: Tangent, slip: FloatArray, limits: FloatArray | None = None
    ) -> FloatArray:
        """Changes of the friction of a solution, (rows, k), but of points that stick rigidly.

        Parameters
        ----------
        slip : ndarray, shape (rows, k)
            Of the slips B v - offset.
        limits : ndarray, shape (m, k), optional
            Of the friction limits; zero if not given.
        """
        first, force = slip[self.first], np.empty_like(slip)
        own, mixed, other = at.blocks.T[:, :, np.newaxis]
        force[self.first] = own * first
        if self.pairs.size:
            second, mixed, other = slip[self.second], mixed[self.pairs], other[self.pairs]
            force[self.first[self.pairs]] += mixed * second
            force[self.second] = mixed * first[self.pairs] + other * second
        if limits is not None:
            force += at.by_limit[:, np.newaxis] * self.points.on_rows(limits)
        return force

    def _coupled(
        self,
        at: Tangent,
        right: FloatArray,
        bound: FloatArray | None,
        v: FloatArray,
        fixed: BoolArray,
    ) -> tuple[FloatArray, FloatArray]:
        """`solve` with pressure points, in place; unknowns that are ``fixed`` have values in v.

        Normal forces change by what is known and by ``by_unknowns``, (q, n), times v.
        """
        normal = self._normal
        rigid = np.isinf(normal.stiffness)
        elastic, closed = (np.flatnonzero(at.pressed & x) for x in (~rigid, rigid))
        known = np.zeros((rigid.size, v.shape[1]))
        by_unknowns = np.zeros((rigid.size, len(v)))
        stiffness = normal.stiffness[elastic, np.newaxis]
        by_unknowns[elastic] = stiffness * self._approaches(elastic)
        if bound is not None:
            known[elastic] = -stiffness * bound[elastic]
        if closed.size:
            place = self._approach[closed]
            known[closed], by_unknowns[closed], fixed[place] = right[place], -self.H[place], True
            if bound is not None:
                v[place] = bound[closed]
        onto = self._onto(at, elastic)
        J = self._factors.matrix(at.blocks[self._acting]) + onto(by_unknowns)
        if not fixed.any():
            v = linalg.solve(J, right - onto(known), check_finite=False)
            return v, np.asarray(known + by_unknowns @ v)
        right = right - onto(known + by_unknowns @ v) - self.H @ v
        free = np.flatnonzero(~fixed)
        v[free] = linalg.solve(J[np.ix_(free, free)], right[free], check_finite=False)
        return v, np.asarray(known + by_unknowns @ v)

    def _approaches(self, some: IntArray) -> FloatArray:
        """Approaches of some pressure points by the unknowns, (some, n)."""
        rows = np.zeros((some.size, len(self.H)))
        rows[np.arange(some.size), self._approach[some]] = 1.0
        return rows

    def _onto(self, at: Tangent, elastic: IntArray) -> Callable[[FloatArray], FloatArray]:
        """What normal forces (q, k) act on the unknowns with, (n, k), also by friction.

        Rigid points that are pressed act by friction alone: their own unknowns are fixed.
        """
        gain, row, presses = self._entries
        acts = np.zeros(at.pressed.size)
        acts[elastic] = 1.0
        values = np.concatenate([gain * at.by_limit[row], acts[presses]])[self._order]
        onto = sparse.csr_array((values, *self._pattern), shape=(len(self.H), acts.size))
        return lambda normal: np.asarray(onto @ normal)


class RowLinearisation(Linearisation):
    """The same of a dense problem whose slips depend on each other, without rigid points.

    ``B``, and ``N``, are dense.

    Raises
    ------
    InputError
        For set-valued Coulomb friction without springs: not all such points can stick.
    """

    def _arrange(self) -> None:
        points = self.points
        if (np.isinf(points.beta) & (points.w > 0.0) & ~points.has_spring).any():
            raise InputError(
                "derivatives: found set-valued Coulomb friction (beta = inf) on slips that depend "
                "on each other, must be on slips that can be unknowns; give the points springs "
                "(tangential_stiffness)"
            )
        self.B, self._acting = as_dense(self.B), slice(None)
        self.Bt = self.B.T
        self.place = np.full(self.B.shape[0], -1)
        self._factors = RowFactors(self.H, self.B[self.first], self.B[self.second], self.pairs)

    def _approaches(self, some: IntArray) -> FloatArray:
        return as_dense(self._normal.N)[some]

    def _onto(self, at: Tangent, elastic: IntArray) -> Callable[[FloatArray], FloatArray]:
        def onto(normal: FloatArray) -> FloatArray:
            limits = self.points.on_rows(self._normal.gain @ normal)
            own = self._approaches(elastic).T @ normal[elastic]
            return np.asarray(own + self.Bt @ (at.by_limit[:, np.newaxis] * limits))

        return onto


def _picked(rows: Any) -> IntArray:
    """Unknown that each row picks, (rows,); -1 where it picks none."""
    rows = sparse.csr_array(rows)
    place = np.full(rows.shape[0], -1, dtype=np.intp)
    place[np.diff(rows.indptr) > 0] = rows.indices
    return place
