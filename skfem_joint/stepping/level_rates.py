"""Derivatives of quasi-static levels by parameters of the system, by implicit differentiation.

A level obeys

    K u + B^T f + N^T (p - force) = alpha F,

with friction f and, where contact opens, normal forces p. Differentiated by a parameter, with the
same points sticking, slipping, closed and open, this is linear in the derivatives of u, f and p:

- a point that sticks moves on as it did at the level before, d(B u) = d(B u before);
- one that slips by the increment s in the direction e has df = dw e + w / |s| (I - e e^T) ds, and
  on a spring k in series the increment is that of the spring's force, q + k s, with q before it;
- a closed point keeps its gap, an open one has no force, an elastic one has its stiffness;
- limits that follow the normal forces have dw = d(gain) p + gain dp.

The matrix of these equations is the tangent of the level's last Newton step. Where a point is just
turning from one state to another there are two derivatives, one to each side: that of the state
which it has is taken, and `LevelRates.turning` counts such points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
from scipy import linalg, sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.schur import SchurComplement, condensed
from skfem_joint.minimise.opening_springs import OpeningOnSprings
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.opening import OpeningContact
from skfem_joint.sensitivity import OpeningSensitivity, SystemSensitivity
from skfem_joint.stepping.levels import Level
from skfem_joint.stepping.opening_levels import OpeningLevels
from skfem_joint.stepping.quasi_static import QuasiStatic
from skfem_joint.system import System
from skfem_joint.unknowns import selection

#: A point slips in an increment if it slips by more than this share of the largest slip, and one on
#: a spring if its force is less than this share below its limit.
STILL = 1e-9
#: Points that slip by less than this share of the largest slip of an increment may be turning.
TURNING = 1e-4


class Rates(NamedTuple):
    """Derivatives of a level, a column for each of k parameters.

    Attributes
    ----------
    values : ndarray, shape (f, k)
        Of the values that are looked at, such as displacements of points.
    slip : ndarray, shape (rows, k)
        Of the slip of each row, m; with contact that opens of that of its slider.
    friction : ndarray, shape (rows, k)
        Of the friction force of each row, N, where constant limits have springs in series; else 0.
    limits : ndarray, shape (m, k)
        Of the friction limits, N.
    normal : ndarray, shape (q, k)
        Of the normal forces of contact that opens, N.
    """

    values: FloatArray
    slip: FloatArray
    friction: FloatArray
    limits: FloatArray
    normal: FloatArray


class _Friction(NamedTuple):
    """Derivative of the friction of an increment: known + tangent d(slip).

    Attributes
    ----------
    direction : ndarray, shape (rows,)
        Direction of the force of each point that slips; zero of others.
    sticks : ndarray of bool, shape (rows,)
        Rows whose slip is as at the level before.
    tangent : sparse array, shape (rows, rows)
        N/m.
    known : ndarray, shape (rows, k)
        Without the part of limits that follow the derivatives of normal forces.
    """

    direction: FloatArray
    sticks: BoolArray
    tangent: sparse.csr_array
    known: FloatArray


class _Normals(NamedTuple):
    """Points that are pressed at a level.

    Attributes
    ----------
    closed, elastic : ndarray of int
        Numbers of the rigid and of the elastic pressure points among them.
    known : ndarray, shape (q, k)
        Derivative of the normal forces, N, but for what the approaches change: their stiffness at
        elastic points, and at closed ones what is left of the right sides.
    """

    closed: IntArray
    elastic: IntArray
    known: FloatArray


@dataclass(frozen=True)
class _Matrix:
    """Matrix of levels, condensed to the contact.

    Attributes
    ----------
    A : ndarray or sparse array, shape (z, z)
        Of the slips, and with contact that opens of the approaches after them.
    place : ndarray of int, shape (rows,)
        Unknown of A that is the slip of each row; -1 where no friction acts.
    approach : ndarray of int, shape (q,)
        Unknown of A that is the approach of each pressure point; -1 where it is never pressed.
    restrict, extend : callable
        Right sides of A from those of all unknowns, with what `extend` needs beside it; and back.
    sliders : int
        Unknowns that follow those of the system: sliders of springs beside contact that opens.
    """

    A: Any
    place: IntArray
    approach: IntArray
    restrict: Callable[[FloatArray], tuple[FloatArray, Any]]
    extend: Callable[[FloatArray, Any], FloatArray]
    sliders: int = 0

    @staticmethod
    def constant(path: QuasiStatic) -> _Matrix:
        """Of constant limits; factors of the path are used again."""
        system = path.to.system
        points = ContactPoints.of(system)
        if path.whole is not None:
            schur: Any = path.whole.schur
        else:
            H = as_compressed(path.K + path.shift * path.M)
            schur = condensed(H, points.limited)
        whole = isinstance(schur, SchurComplement)
        A = schur.complement if whole else schur.A
        at = np.full(system.n, -1)
        kept = schur.kept if whole else np.arange(system.n)
        at[kept] = np.arange(kept.size)
        place = np.where(points.on_rows(points.w) > 0.0, at[points.unknowns], -1)
        none = np.zeros(0, dtype=np.intp)
        return _Matrix(A, place, none, schur.restrict, schur.extend)

    @staticmethod
    def opening(levels: OpeningLevels, touch: tuple[BoolArray, BoolArray]) -> _Matrix:
        """Of contact that opens; the factor of the levels is used again.

        ``touch`` are the contact points, (m,), and pressure points, (q,), that carry a force at any
        level: all others are eliminated.
        """
        outer = cast("Any", levels.problem)
        on_springs = isinstance(outer, OpeningOnSprings)
        inner = outer.problem if on_springs else outer
        rubs = levels.to.system.on_rows(touch[0])
        kept = np.flatnonzero(np.concatenate([rubs, touch[1]]))
        at = np.full(inner.slips + touch[1].size, -1)
        at[kept] = np.arange(kept.size)
        apart = SchurComplement(inner.whole.A, kept)

        def restrict(g: FloatArray) -> tuple[FloatArray, Any]:
            right, beside = inner.restrict(g)
            right, others = apart.restrict(right)
            return right, (others, beside)

        def extend(z: FloatArray, beside: Any) -> FloatArray:
            others, inside = beside
            return np.asarray(inner.extend(apart.extend(z, others), inside))

        sliders = outer.rows.size if on_springs else 0
        places = at[: inner.slips], at[inner.slips :]
        return _Matrix(apart.complement, *places, restrict, extend, sliders)


class LevelRates:
    """Derivatives of the levels of a path under multiples of one force.

    Parameters
    ----------
    path : QuasiStatic or OpeningLevels
        What the levels were computed by.
    force : ndarray, shape (n,)
        Force F of the unit level, N, in the unknowns of ``path.to.system``.
    parameters : sequence of SystemSensitivity
        In the same unknowns. A last column is that by the logarithm of all levels at once.
    force_rates : ndarray, shape (n, k)
        Derivative of F by each parameter, N.
    looked_at : ndarray, shape (n, f)
        Values of a displacement (n,) that are differentiated, a column for each; first F, the
        inertia of a mode of unit mass.
    touch : tuple of ndarray of bool, shape (m,) and (q,), optional
        Contact points and pressure points of contact that opens that carry a force at any level.

    Attributes
    ----------
    turning : list of int
        Points that may turn between sticking and slipping, at each level last followed.
    """

    def __init__(
        self,
        path: QuasiStatic | OpeningLevels,
        force: FloatArray,
        parameters: Sequence[SystemSensitivity],
        force_rates: FloatArray,
        looked_at: FloatArray,
        touch: tuple[BoolArray, BoolArray] | None = None,
    ) -> None:
        self.system: System = path.to.system
        self.parameters = parameters
        self.contact: OpeningContact | None = self.system.opening
        if isinstance(path, OpeningLevels):
            m, q = self.system.w.size, path.contact.gap.size
            every = np.ones(m, dtype=bool), np.ones(q, dtype=bool)
            self.matrix, self.shift = _Matrix.opening(path, touch or every), path.shift
        else:
            self.matrix, self.shift = _Matrix.constant(path), 0.0
        # A x = g is condensed once for all right sides and values: v x = z v' + v'' g, with v' the
        # restricted v, and v'' the displacement under v with the contact held.
        self._force = self._padded(np.column_stack([force_rates, force]))
        self._right_of_force = self.matrix.restrict(self._force)[0]
        looked_at = self._padded(looked_at)
        self._seen, beside = self.matrix.restrict(looked_at)
        self._held = self.matrix.extend(np.zeros_like(self._seen), beside)
        self.row_point = np.repeat(np.arange(self.system.w.size), self.system.directions)
        rubs, z = self.matrix.place >= 0, self.matrix.A.shape[0]
        ones = np.ones(int(rubs.sum()))
        entries = ones, (np.flatnonzero(rubs), self.matrix.place[rubs])
        self.to_rows = sparse.csr_array(entries, shape=(rubs.size, z))
        self._contact_rates()
        self.turning: list[int] = []

    def _contact_rates(self) -> None:
        """Derivatives of limits, springs and normal contact, a column for each parameter."""
        system, count = self.system, len(self.parameters) + 1

        def columns(size: int, values: Sequence[FloatArray | None]) -> FloatArray:
            table = np.zeros((size, count))
            for j, value in enumerate(values):
                if value is not None:
                    table[:, j] = value
            return table

        m = system.w.size
        self.given = columns(m, [p.w for p in self.parameters])
        self.spring_rates = columns(m, [p.stiffness for p in self.parameters])
        self.gains: list[Any] = [None] * count
        if self.contact is None:
            return
        q = self.contact.gap.size
        parts = [p.opening or OpeningSensitivity() for p in self.parameters]
        self.gap = columns(q, [part.gap for part in parts])
        self.at_rest = columns(q, [part.force for part in parts])
        self.stiffness = columns(q, [part.stiffness for part in parts])
        self.gains = [part.gain for part in parts] + [None]
        # What is given beside normal forces: limits at rest without those of the forces at rest.
        self.given -= self.contact.gain @ self.at_rest
        for j, gain in enumerate(self.gains):
            if gain is not None:
                self.given[:, j] -= gain @ self.contact.force

    def rest(self) -> Rates:
        """Of the level at rest."""
        count = len(self.parameters) + 1
        zeros, values = (
            np.zeros((self.row_point.size, count)),
            np.zeros((self._seen.shape[1], count)),
        )
        normal, limits = np.zeros((0, count)), self.given
        if self.contact is not None:
            normal, limits = self.at_rest, self._limits(self.contact.force, self.at_rest)
        return Rates(values, zeros, zeros, limits, normal)

    def slips(self, level: Level) -> FloatArray:
        """Slips that `Rates.slip` are derivatives of, (rows,), m."""
        if self.contact is None or not self.system.has_springs:
            return level.slip
        return np.asarray(level.slip - self.system.spring_flexibility * level.friction)

    def slider(self, level: Level, rates: Rates) -> tuple[FloatArray, FloatArray]:
        """Slips of the sliders, (rows,), m, and their derivatives, (rows, k)."""
        if self.contact is not None or not self.system.has_springs:
            return self.slips(level), rates.slip
        flexibility = self.system.spring_flexibility
        softer = -(flexibility**2)[:, np.newaxis] * self.spring_rates[self.row_point]
        taken = flexibility[:, np.newaxis] * rates.friction
        slips = level.slip - flexibility * level.friction
        return slips, rates.slip - taken - softer * level.friction[:, np.newaxis]

    def follow(
        self, last: Rates, before: Level, walk: Sequence[tuple[float, Level]]
    ) -> list[Rates]:
        """Of levels at multiples of the force that follow each other from ``before``.

        Raises
        ------
        LinAlgError
            If everything slips, so that a level is not determined.
        """
        self.turning = []
        pushed = self._pushed([level for _, level in walk])
        right, found = self._right_of_force[:, :0], list[Rates]()
        if pushed.size:
            right = self.matrix.restrict(pushed)[0]
        pushed, right = (x.reshape(len(x), len(walk), -1) for x in (pushed, right))
        for k, (alpha, level) in enumerate(walk):
            both = self._total(alpha, self._force, pushed[:, k]), right[:, k]
            right_here = self._total(alpha, self._right_of_force, both[1])
            rates = self._next(last, before, level, both[0], right_here)
            if self.shift:  # which levels do not show, but the matrix has
                more = self.shift * rates.values[0]
                g = both[0] + np.outer(self._force[:, -1], more)
                right_here = right_here + np.outer(self._right_of_force[:, -1], more)
                rates = self._next(last, before, level, g, right_here)
            last, before = rates, level
            found.append(last)
        return found

    def _total(self, alpha: float, of_force: FloatArray, pushed: FloatArray) -> FloatArray:
        """Right side of a level, (n, k), from that of the unit force and what parameters push."""
        total = alpha * of_force
        total[:, self._pushing] += pushed
        return total

    def _next(
        self, last: Rates, before: Level, after: Level, g: FloatArray, right: FloatArray
    ) -> Rates:
        """Of the next level, from its right side ``g`` of all unknowns, and the restricted one."""
        friction = self._friction(last, before, after)
        z, held = np.zeros_like(right), np.zeros(len(right), dtype=bool)
        sticks = friction.sticks
        z[self.matrix.place[sticks]], held[self.matrix.place[sticks]] = last.slip[sticks], True
        normals = None if self.contact is None else self._normals(after, right)
        if normals is not None:
            closed = self.matrix.approach[normals.closed]
            z[closed], held[closed] = self.gap[normals.closed], True
        free, E, normal = np.flatnonzero(~held), self.to_rows, last.normal
        follows, known = None, E.T @ friction.known
        A = self.matrix.A[free]
        if normals is not None:
            follows = self._along(E.T @ friction.direction)
            normal = self._normal_forces(normals, z)
            known += follows @ normal
            known[self.matrix.approach[normals.elastic]] += normal[normals.elastic]
        J = self._tangent(friction, normals, follows, free)
        r = right[free] - known[free] - A @ z
        if normals is None or follows is None:
            z[free] = factorised(J)(r) if free.size else r
        else:
            self._couple(J, free, follows, normals)
            z[free] = linalg.lu_solve(linalg.lu_factor(J.T, overwrite_a=True), r, trans=1)
            normal = self._normal_forces(normals, z)
        values, slip = self._seen.T @ z + self._held.T @ g, E @ z
        if self.contact is None:
            forces = friction.known + friction.tangent @ slip
            sprung = self.system.on_rows(self.system.sprung)[:, np.newaxis]
            return Rates(values, slip, np.where(sprung, forces, 0.0), last.limits, normal)
        limits = self._limits(cast("FloatArray", after.normal), normal)
        acts = cast("FloatArray", after.limits) > 0.0
        return Rates(values, slip, 0.0 * slip, np.where(acts[:, np.newaxis], limits, 0.0), normal)

    def _tangent(
        self,
        friction: _Friction,
        normals: _Normals | None,
        follows: sparse.csr_array | None,
        free: IntArray,
    ) -> Any:
        """Matrix of the free unknowns, with the tangents of friction and of elastic points."""
        A, E = self.matrix.A, self.to_rows
        if not isinstance(A, np.ndarray):
            added = as_compressed(E.T @ friction.tangent @ E)
            if normals is not None and follows is not None:
                added = added + self._of_elastic(normals, follows)
            return A[free][:, free] + added[free][:, free]
        rows, columns, kept = self._blocks_in_matrix
        J = A.copy()
        np.add.at(J, (rows, columns), friction.tangent.data[kept])  # points may share unknowns
        if normals is not None and follows is not None and normals.elastic.size:
            contact = cast("OpeningContact", self.contact)
            at, springs = self.matrix.approach[normals.elastic], contact.stiffness[normals.elastic]
            J[at, at] += springs
            J[:, at] += follows[:, normals.elastic].toarray() * springs
        return J[np.ix_(free, free)]

    @cached_property
    def _blocks(self) -> tuple[IntArray, IntArray, IntArray]:
        """Pairs of rows of the same point: rows, columns, and where each row begins."""
        each = self.system.directions
        first = np.repeat(np.cumsum(each) - each, each)
        count = each[self.row_point]
        begins = np.append(0, np.cumsum(count))
        rows = np.repeat(np.arange(first.size), count)
        columns = first[rows] + np.arange(rows.size) - begins[rows]
        return rows, columns, begins

    @cached_property
    def _blocks_in_matrix(self) -> tuple[IntArray, IntArray, BoolArray]:
        """Unknowns of these pairs where friction acts, and which pairs they are."""
        rows, columns = (self.matrix.place[part] for part in self._blocks[:2])
        kept = (rows >= 0) & (columns >= 0)
        return rows[kept], columns[kept], kept

    @cached_property
    def _gain_of_unknowns(self) -> sparse.csr_array:
        """Friction limit of each unknown by normal forces, (z, q)."""
        gain = sparse.csr_array(cast("OpeningContact", self.contact).gain)[self.row_point]
        return sparse.csr_array(self.to_rows.T @ gain)

    def _padded(self, g: FloatArray) -> FloatArray:
        """Forces on all unknowns with those on sliders beside contact that opens, which are 0."""
        return np.vstack([g, np.zeros((self.matrix.sliders, g.shape[1]))])

    @cached_property
    def _pushing(self) -> IntArray:
        """Parameters that push the structure at a given level, beside the force."""
        pushes = [p.K is not None or p.opening is not None for p in self.parameters]
        if self.matrix.sliders:
            pushes = [
                a or p.stiffness is not None for a, p in zip(pushes, self.parameters, strict=True)
            ]
        return np.flatnonzero(pushes)

    def _pushed(self, levels: Sequence[Level]) -> FloatArray:
        """Right sides (n, levels x pushing) of what parameters push at some levels.

        They are what K and springs beside contact that opens change by, and forces at rest.
        """
        system, columns = self.system, list[FloatArray]()
        for level in levels:
            for j in self._pushing.tolist():
                parameter, g = self.parameters[j], np.zeros(system.n)
                if parameter.K is not None:
                    g -= parameter.K @ level.u
                if self.contact is not None:
                    g += self.contact.N.T @ self.at_rest[:, j]
                sliders = np.zeros(0)
                if self.matrix.sliders:
                    rates = self.spring_rates[self.row_point, j]
                    stiffer = system.spring_flexibility * level.friction * rates
                    g -= system.B.T @ stiffer
                    sliders = stiffer[system.on_rows(system.sprung)]
                columns.append(np.concatenate([g, sliders]))
        return np.reshape(columns, (len(columns), len(self._force))).T

    def _friction(self, last: Rates, before: Level, after: Level) -> _Friction:
        system, rows = self.system, self.row_point
        step = self.slips(after) - self.slips(before)
        limits = system.w if after.limits is None else after.limits
        w, acts = limits[rows], (limits[rows] > 0.0) & (self.matrix.place >= 0)
        springs = system.on_rows(system.spring_constants) if self.contact is None else 0.0 * w
        sprung = springs > 0.0
        size, force = (system.slip_norm(x)[rows] for x in (step, after.friction))
        trial = system.slip_norm(before.friction + springs * step)[rows]
        moves = np.where(sprung, force >= (1.0 - STILL) * w, size > STILL * size.max(initial=0.0))
        moves &= acts
        self._count_turning(moves, size, np.where(sprung, trial, force), w, acts)
        direction = np.divide(after.friction, force, out=np.zeros_like(w), where=moves)
        curved = np.divide(w, np.where(sprung, trial, size), out=np.zeros_like(w), where=moves)
        curved = np.where(sprung, springs * np.where(moves, curved, 1.0), curved)
        of_points = np.zeros(system.w.size)
        of_points[rows] = curved
        single = system.on_rows(system.directions == 1) & moves
        own, other, begins = self._blocks
        entries = np.where(own == other, curved[own], 0.0)
        entries -= direction[own] * of_points[rows[own]] * direction[other]
        entries = np.where(single[other], 0.0, entries)
        tangent = sparse.csr_array((entries, other, begins), shape=(rows.size, rows.size))
        held = last.friction + step[:, np.newaxis] * self.spring_rates[rows]
        share = np.divide(1.0, springs, out=np.zeros_like(w), where=sprung)
        zero = np.zeros_like(last.normal)
        given = self.given if after.normal is None else self._limits(after.normal, zero)
        known = direction[:, np.newaxis] * given[rows]
        known += share[:, np.newaxis] * (tangent @ held) - tangent @ last.slip
        return _Friction(direction, acts & ~moves & ~sprung, tangent, known)

    def _count_turning(
        self, moves: BoolArray, size: FloatArray, force: FloatArray, w: FloatArray, acts: BoolArray
    ) -> None:
        """Count points that hardly slip, or whose ``force`` hardly differs from the limit ``w``."""
        hardly = moves & (size < TURNING * size.max(initial=0.0))
        near = acts & ~moves & (force > (1.0 - TURNING) * w)
        self.turning.append(int(np.unique(self.row_point[hardly | near]).size))

    def _limits(self, normal: FloatArray, rates: FloatArray) -> FloatArray:
        """Derivatives of the friction limits, (m, k), N, by those (q, k) of normal forces (q,)."""
        contact = cast("OpeningContact", self.contact)
        limits = self.given + contact.gain @ rates
        for j, gain in enumerate(self.gains):
            if gain is not None:
                limits[:, j] += gain @ normal
        return np.asarray(limits)

    def _along(self, direction: FloatArray) -> sparse.csr_array:
        """Friction of each unknown by normal forces, (z, q), in the directions of slip (z,)."""
        gain = self._gain_of_unknowns
        data = gain.data * np.repeat(direction, np.diff(gain.indptr))
        return sparse.csr_array((data, gain.indices, gain.indptr), shape=gain.shape)

    def _normals(self, after: Level, right: FloatArray) -> _Normals:
        """Points that are pressed at a level, with the right side (z, k) of its equations."""
        contact = cast("OpeningContact", self.contact)
        pressed = cast("FloatArray", after.normal) > 0.0
        closed = np.flatnonzero(pressed & contact.rigid)
        elastic = np.flatnonzero(pressed & ~contact.rigid)
        known, over = np.zeros_like(self.gap), -contact.gaps(after.u)[elastic]
        known[closed] = right[self.matrix.approach[closed]]
        known[elastic] = self.at_rest[elastic] + over[:, np.newaxis] * self.stiffness[elastic]
        known[elastic] -= contact.stiffness[elastic, np.newaxis] * self.gap[elastic]
        return _Normals(closed, elastic, known)

    def _normal_forces(self, normals: _Normals, z: FloatArray) -> FloatArray:
        """Derivatives of the normal forces, (q, k), N, by those of the unknowns (z, k)."""
        contact, at = cast("OpeningContact", self.contact), self.matrix.approach
        forces, closed, elastic = normals.known.copy(), normals.closed, normals.elastic
        forces[closed] -= self.matrix.A[at[closed]] @ z
        forces[elastic] += contact.stiffness[elastic, np.newaxis] * z[at[elastic]]
        return forces

    def _of_elastic(self, normals: _Normals, follows: sparse.csr_array) -> sparse.csr_array:
        """Matrix, (z, z), of the springs of elastic points, and of friction by their forces."""
        contact, size = cast("OpeningContact", self.contact), self.matrix.A.shape[0]
        at, springs = self.matrix.approach[normals.elastic], contact.stiffness[normals.elastic]
        forces = sparse.diags_array(springs) @ selection(at, size)
        return sparse.csr_array((selection(at, size).T + follows[:, normals.elastic]) @ forces)

    def _couple(
        self, J: FloatArray, free: IntArray, follows: sparse.csr_array, normals: _Normals
    ) -> None:
        """Add to J, in place, what the forces of closed points do to friction, ``follows`` (z, q).

        They change by -A z.
        """
        if not normals.closed.size:
            return
        own = sparse.csc_array(follows[free][:, normals.closed])
        used = np.flatnonzero(np.diff(own.indptr))
        if used.size:
            forces = self.matrix.A[self.matrix.approach[normals.closed[used]]][:, free]
            J -= own[:, used] @ forces
