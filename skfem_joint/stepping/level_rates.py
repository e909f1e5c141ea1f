"""Derivatives of quasi-static levels by parameters of the system, by implicit differentiation.

A level obeys

    K u + B^T f + N^T (p - force) = alpha F,

with friction f and, where contact opens, normal forces p. Differentiated by a parameter, with the
same points sticking, slipping, closed and open, this is linear in the derivatives of u, f and p:

- a point that sticks moves on as it did at the level before, d(B u) = d(B u before);
- one that slips by the increment s in the direction e has df = dw e + w / |s| (I - e e^T) ds, and
  on a spring k in series the increment is that of the spring's force, q + k s, with q before it,
  so that df = dq + k ds + dk s where the slider sticks;
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
from scipy import sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.linalg.factors import BlockFactors
from skfem_joint.linalg.schur import SchurComplement, Uncondensed
from skfem_joint.minimise.law import slip_tangent
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.sensitivity import OpeningSensitivity, SystemSensitivity
from skfem_joint.stepping.levels import Level
from skfem_joint.stepping.quasi_static import QuasiStatic
from skfem_joint.system import System

#: Slips below this share of those before and after an increment are round-off.
ROUND_OFF = 1e-13
#: A point on a spring slips in an increment if its force is less than this share below its limit.
STILL = 1e-9
#: What a slider slips by less, over what its spring takes at the limit, is an error of the forces.
SLID = 1e-7
#: Points that slip by less than this share of the largest slip of an increment may be turning, and
#: others whose friction is less than this share below its limit.
TURNING = 1e-4


class Rates(NamedTuple):
    """Derivatives of a level, a column for each of k parameters.

    Attributes
    ----------
    values : ndarray, shape (f, k)
        Of the values that are looked at, such as displacements of points.
    slip : ndarray, shape (rows, k)
        Of the slip of each row, m.
    friction : ndarray, shape (rows, k)
        Of the friction force of each row, N, where it has a spring in series; else 0.
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
    """Derivatives of the friction of increments: known + tangent d(s).

    s is the increment of the slip, and on springs more than that by what the friction before has
    stretched them. Arrays have a row for each increment, or are of one increment alone. The tangent
    has a block for each point.

    Attributes
    ----------
    direction : ndarray, shape (levels, rows)
        Direction of the force of each point that slips; zero of others.
    sticks : ndarray of bool, shape (levels, rows)
        Rows whose slip is as at the level before.
    diagonal, beside : ndarray, shape (levels, rows)
        Entries of the tangent, N/m: on its diagonal, and of the other row of the same point.
    known : ndarray, shape (levels, rows, k)
        Of the limits and springs alone.
    turning : ndarray of int, shape (levels,)
        Points that may turn.
    """

    direction: FloatArray
    sticks: BoolArray
    diagonal: FloatArray
    beside: FloatArray
    known: FloatArray
    turning: IntArray


class _Normals(NamedTuple):
    """Points that are pressed at a level.

    Attributes
    ----------
    closed, elastic : ndarray of int
        Numbers of the rigid and of the elastic pressure points among them.
    known : ndarray, shape (q, k)
        Derivative of the normal forces, N, but for what the unknowns change.
    by_unknowns : ndarray, shape (q, z)
        Derivative of the normal forces by the unknowns, N/m.
    """

    closed: IntArray
    elastic: IntArray
    known: FloatArray
    by_unknowns: FloatArray

    def forces(self, z: FloatArray) -> FloatArray:
        """Derivatives of the normal forces, (q, k), N, from those of the unknowns (z, k)."""
        return np.asarray(self.known + self.by_unknowns @ z)


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
    """

    A: Any
    place: IntArray
    approach: IntArray
    restrict: Callable[[FloatArray], tuple[FloatArray, Any]]
    extend: Callable[[FloatArray, Any], FloatArray]

    @staticmethod
    def constant(path: QuasiStatic) -> _Matrix:
        """Of constant limits; factors of the path are used again."""
        system = path.to.system
        points = ContactPoints.of(system)
        schur: Any = Uncondensed(as_compressed(path.K + path.shift * path.M))
        if path.whole is not None:
            schur = path.whole.schur
        whole = isinstance(schur, SchurComplement)
        A = schur.complement if whole else schur.A
        at = np.full(system.n, -1)
        kept = schur.kept if whole else np.arange(system.n)
        at[kept] = np.arange(kept.size)
        place = np.where(points.on_rows(points.w) > 0.0, at[points.unknowns], -1)
        none = np.zeros(0, dtype=np.intp)
        return _Matrix(A, place, none, schur.restrict, schur.extend)

    @staticmethod
    def opening(levels: QuasiStatic, touch: tuple[BoolArray, BoolArray]) -> _Matrix:
        """Of contact that opens; the factor of the levels is used again.

        ``touch`` are the contact points, (m,), and pressure points, (q,), that carry a force at any
        level: all others are eliminated.
        """
        problem = cast("Any", levels.problem)
        inner = problem.contact
        slips, approaches = inner.points.unknowns, inner.contact.pressing.place
        rubs = levels.to.system.contact.on_rows(touch[0])
        kept = np.union1d(slips[rubs], approaches[touch[1]])
        at = np.full(len(inner.H), -1)
        at[kept] = np.arange(kept.size)
        apart = SchurComplement(inner.H, kept)

        def restrict(g: FloatArray) -> tuple[FloatArray, Any]:
            right, beside = problem.restrict(g)
            right, others = apart.restrict(right)
            return right, (others, beside)

        def extend(z: FloatArray, beside: Any) -> FloatArray:
            others, inside = beside
            return np.asarray(problem.extend(apart.extend(z, others), inside))

        return _Matrix(apart.complement, at[slips], at[approaches], restrict, extend)


class LevelRates:
    """Derivatives of the levels of a path under multiples of one force.

    Parameters
    ----------
    path : QuasiStatic
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
        path: QuasiStatic,
        force: FloatArray,
        parameters: Sequence[SystemSensitivity],
        force_rates: FloatArray,
        looked_at: FloatArray,
        touch: tuple[BoolArray, BoolArray] | None = None,
    ) -> None:
        self.system: System = path.to.system
        self.parameters = parameters
        self.contact, self.opens, self.shift = path.contact, path.opens, path.shift
        self.matrix = _Matrix.constant(path) if touch is None else _Matrix.opening(path, touch)
        # A x = g is condensed once for all right sides and values: v x = z v' + v'' g, with v' the
        # restricted v, and v'' the displacement under v with the contact held.
        of_force = np.column_stack([force_rates, force])
        self._right_of_force = self.matrix.restrict(of_force)[0]
        self._seen, beside = self.matrix.restrict(looked_at)
        self._held = self.matrix.extend(np.zeros_like(self._seen), beside)
        self._held_of_force = self._held.T @ of_force
        self.row_point = np.repeat(
            np.arange(self.system.contact.w.size), self.system.contact.directions
        )
        self.flexibility = self.system.contact.spring_flexibility
        # Rows whose friction has springs in series.
        self._sprung: BoolArray | None = None
        if self.system.contact.has_springs:
            self._sprung = self.system.contact.on_rows(self.system.contact.sprung)[:, np.newaxis]
        self._rubs = np.flatnonzero(self.matrix.place >= 0)
        ones, size = np.ones(self._rubs.size), (self.matrix.A.shape[0], self.row_point.size)
        entries = ones, (self.matrix.place[self._rubs], self._rubs)
        self._from_rows = sparse.csr_array(entries, shape=size)  # points may share unknowns
        begins = self.system.contact.first_row[:-1]
        acts, two = self.matrix.place[begins] >= 0, self.system.contact.directions == 2
        self._first, self._second = begins[acts], (begins + two)[acts]
        self._partner = np.arange(self.row_point.size)
        self._partner[begins[two]] += 1
        self._partner[begins[two] + 1] -= 1
        if not self.opens:
            second = np.where(two[acts], self.matrix.place[self._second], -1)
            first = self.matrix.place[self._first]
            self._factors = BlockFactors(self.matrix.A, first, second)
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

        m = system.contact.w.size
        self.given = columns(m, [p.w for p in self.parameters])
        self.spring_rates = columns(m, [p.stiffness for p in self.parameters])
        self.gains: list[Any] = [None] * count
        if not self.opens:
            return
        q = self.contact.gap.size
        parts = [p.opening or OpeningSensitivity() for p in self.parameters]
        self.gap = columns(q, [part.gap for part in parts])
        self.at_rest = columns(q, [part.force for part in parts])
        self.stiffness = columns(q, [part.stiffness for part in parts])
        self.gains = [part.gain for part in parts] + [None]
        # What is given beside normal forces: limits at rest without those of the forces at rest.
        self.given -= self.system.contact.gain @ self.at_rest
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
        if self.opens:
            normal, limits = self.at_rest, self._limits(self.contact.force, self.at_rest)
        return Rates(values, zeros, zeros, limits, normal)

    def sliders(
        self, levels: Sequence[Level], rates: Sequence[Rates]
    ) -> tuple[FloatArray, FloatArray]:
        """Slips of the sliders, (levels, rows), m, and their derivatives, (levels, rows, k)."""
        slips = np.array([level.slip for level in levels])
        of_slips = np.array([one.slip for one in rates])
        if self._sprung is None:
            return slips, of_slips
        friction = np.array([level.friction for level in levels])
        flexibility = self.flexibility[:, np.newaxis]
        softer = flexibility**2 * self.spring_rates[self.row_point]
        of_slips -= flexibility * np.array([one.friction for one in rates])
        of_slips += friction[:, :, np.newaxis] * softer
        return slips - self.flexibility * friction, of_slips

    def follow(
        self, last: Rates, before: Level, walk: Sequence[tuple[float, Level]]
    ) -> list[Rates]:
        """Of levels at multiples of the force that follow each other from ``before``.

        Raises
        ------
        LinAlgError, InputError or RuntimeError
            If everything slips, so that a level is not determined; by whoever finds no factor.
        """
        levels, found = [level for _, level in walk], list[Rates]()
        friction = self._friction(before, levels)
        self.turning = friction.turning.tolist()
        pushed, at = self._pushed(levels), self._pushing
        right, held = np.zeros((2, 0, 0))
        if at.size:
            right, held = self.matrix.restrict(pushed)[0], self._held.T @ pushed
        shape = len(walk), at.size
        right, held = (x.reshape(len(x), *shape) for x in (right, held))
        for k, (alpha, level) in enumerate(walk):
            right_here, held_here = alpha * self._right_of_force, alpha * self._held_of_force
            if at.size:
                right_here[:, at] += right[:, k]
                held_here[:, at] += held[:, k]
            increment = _Friction(*(part[k] for part in friction))
            last = self._next(last, increment, level, right_here, held_here)
            found.append(last)
        return found

    def _next(
        self,
        last: Rates,
        friction: _Friction,
        after: Level,
        right: FloatArray,
        held: FloatArray,
    ) -> Rates:
        """Of the next level.

        Its right sides are restricted, (z, k), and ``held`` are the values that are looked at with
        the contact held, (f, k).
        """
        fixed = np.zeros(len(right), dtype=bool)
        sticks = np.flatnonzero(friction.sticks)
        begin = -last.slip
        if self._sprung is not None:
            begin += self.flexibility[:, np.newaxis] * last.friction
        forces = friction.known + self._by_slip(friction, begin)
        if self.shift:  # one more right side, the unit force, to give back what mass was added
            right = np.column_stack([right, self._right_of_force[:, -1]])
            held = np.column_stack([held, self._held_of_force[:, -1]])
        z, known = np.zeros_like(right), np.zeros_like(right)
        known[:, : forces.shape[1]] = self._from_rows @ forces
        z[self.matrix.place[sticks], : last.slip.shape[1]] = last.slip[sticks]
        fixed[self.matrix.place[sticks]] = True
        if self.opens:
            return self._next_opening(friction, after, right, held, z, known, forces, fixed)
        if not fixed.all():
            ends = friction.diagonal[self._first], friction.diagonal[self._second]
            blocks = np.stack([ends[0], friction.beside[self._first], ends[1]], axis=1)
            solve, r = self._factors.factorised(blocks, fixed), right - known
            z += solve(r - self.matrix.A @ z if sticks.size else r)
        values, z = self._given_back(self._seen.T @ z + held, z)
        slip = self._on_rows(z)
        forces = self._of_springs(friction, forces, slip)
        return Rates(values, slip, forces, last.limits, last.normal)

    def _of_springs(self, friction: _Friction, forces: FloatArray, slip: FloatArray) -> FloatArray:
        """Derivatives of the friction on springs, (rows, k), from what is known and the slips."""
        if self._sprung is None:
            return np.zeros_like(forces)
        return np.where(self._sprung, forces + self._by_slip(friction, slip), 0.0)

    def _given_back(self, values: FloatArray, *others: FloatArray) -> tuple[FloatArray, ...]:
        """Derivatives, (..., k), with the force given back that the mass added to K has.

        Levels have no added mass, but the matrix has: the last column of ``values`` and others,
        (..., k + 1), is by the unit force, which is the inertia of a mode of unit mass.
        """
        if not self.shift:
            return values, *others
        more = self.shift * values[0, :-1] / (1.0 - self.shift * values[0, -1])
        return tuple(x[:, :-1] + np.outer(x[:, -1], more) for x in (values, *others))

    def _next_opening(
        self,
        friction: _Friction,
        after: Level,
        right: FloatArray,
        held: FloatArray,
        z: FloatArray,
        known: FloatArray,
        forces: FloatArray,
        fixed: BoolArray,
    ) -> Rates:
        """Of the next level with contact that opens; unknowns that are ``fixed`` have values."""
        contact, A, at = self.contact, self.matrix.A, self.matrix.approach
        normals = self._normals(after, right)
        elastic, closed = normals.elastic, at[normals.closed]
        z[closed, : self.gap.shape[1]], fixed[closed] = self.gap[normals.closed], True
        of_rows = self._along(friction.direction)
        follows = self._from_rows @ of_rows
        J = A + follows @ normals.by_unknowns
        J[at[elastic], at[elastic]] += contact.stiffness[elastic]
        rubs = self._rubs
        own, other = (self.matrix.place[x] for x in (rubs, self._partner[rubs]))
        np.add.at(J, (own, own), friction.diagonal[rubs])
        np.add.at(J, (own, other), friction.beside[rubs])
        normal = normals.forces(z)
        known += follows @ normal
        known[at[elastic]] += normal[elastic]
        free = np.flatnonzero(~fixed)
        r = right[free] - known[free] - A[free] @ z
        z[free] = np.linalg.solve(J[np.ix_(free, free)], r)
        values, z, normal = self._given_back(self._seen.T @ z + held, z, normals.forces(z))
        slip = self._on_rows(z)
        limits = self._limits(cast("FloatArray", after.normal), normal)
        acts = cast("FloatArray", after.limits) > 0.0
        forces = self._of_springs(friction, forces + of_rows @ normal, slip)
        return Rates(values, slip, forces, np.where(acts[:, np.newaxis], limits, 0.0), normal)

    def _on_rows(self, z: FloatArray) -> FloatArray:
        """Slips of all rows, (rows, k), from the unknowns (z, k)."""
        slip = np.zeros((self.row_point.size, z.shape[1]))
        slip[self._rubs] = z[self.matrix.place[self._rubs]]
        return slip

    def _by_slip(self, friction: _Friction, slip: FloatArray) -> FloatArray:
        """What slips (..., rows, k) of increments change their friction by, (..., rows, k)."""
        forces = friction.diagonal[..., np.newaxis] * slip
        if self.row_point.size > self.system.contact.w.size:
            forces += friction.beside[..., np.newaxis] * slip[..., self._partner, :]
        return forces

    @cached_property
    def _gain_of_rows(self) -> sparse.csr_array:
        """Friction limit of each slip row by normal forces, (rows, q)."""
        gain = sparse.csr_array(self.system.contact.gain)
        return sparse.csr_array(gain[self.row_point])

    @cached_property
    def _pushing(self) -> IntArray:
        """Parameters that push the structure at a given level, beside the force."""
        return np.flatnonzero([p.K is not None or p.opening is not None for p in self.parameters])

    def _pushed(self, levels: Sequence[Level]) -> FloatArray:
        """Right sides (n, levels x pushing) of what parameters push at some levels.

        They are what K changes by, and forces at rest.
        """
        columns = list[FloatArray]()
        u = np.array([level.u for level in levels]).T
        for j in self._pushing.tolist():
            parameter, g = self.parameters[j], np.zeros(u.shape)
            if parameter.K is not None:
                g -= parameter.K @ u
            if self.opens:
                g += (self.contact.N.T @ self.at_rest[:, j])[:, np.newaxis]
            columns.append(g)
        return np.stack(columns, axis=2).reshape(len(columns[0]), -1) if columns else u[:, :0]

    def _friction(self, before: Level, levels: Sequence[Level]) -> _Friction:
        """Of the increments between levels that follow each other."""
        system, rows, place = self.system, self.row_point, self.matrix.place
        path = before, *levels
        forces = np.array([level.friction for level in path])
        slips = np.array([level.slip for level in path])
        step = np.diff(slips, axis=0)
        limits = np.array(
            [system.contact.w if level.limits is None else level.limits for level in levels]
        )
        w = limits[:, rows]
        acts = (w > 0.0) & (place >= 0)
        springs = system.contact.on_rows(system.contact.spring_constants)
        sprung = springs > 0.0
        size, force, trial = (
            system.contact.slip_norm(x)[:, rows]
            for x in (step, forces[1:], forces[:-1] + springs * step)
        )
        # Slips of points that stick differ by round-off, and of sliders by what forces err by, so
        # that it takes their friction too to say which they are.
        whole = system.contact.slip_norm(slips)[:, rows]
        size = np.where(size > ROUND_OFF * (whole[1:] + whole[:-1]), size, 0.0)
        largest = np.where(acts, size, 0.0).max(axis=1, initial=0.0, keepdims=True)
        slid = np.diff(slips - self.flexibility * forces, axis=0)
        slides = system.contact.slip_norm(slid)[:, rows] > SLID * self.flexibility * w
        at_limit = force >= (1.0 - np.where(sprung & ~slides, STILL, TURNING)) * w
        moves = acts & at_limit & (sprung | (size > 0.0))
        # Points that hardly slip, or whose force hardly differs from the limit.
        hardly = moves & (size < TURNING * largest)
        near = acts & ~moves & (np.where(sprung, trial, force) > (1.0 - TURNING) * w)
        turning = system.contact.by_point(1.0 * (hardly | near)) > 0.0
        direction = np.divide(forces[1:], force, out=np.zeros_like(w), where=moves)
        curved = np.divide(w, np.where(sprung, trial, size), out=np.zeros_like(w), where=moves)
        curved = np.where(sprung & acts, springs * np.where(moves, curved, 1.0), curved)
        single, across = (
            system.contact.on_rows(system.contact.directions == 1),
            direction[:, self._partner],
        )
        along = np.where(moves, 0.0, curved)
        diagonal, mixed, _ = slip_tangent(along, curved, direction, across, direction, across)
        given = self.given[rows]
        if any(gain is not None for gain in self.gains):
            none = np.zeros_like(self.at_rest)
            of_levels = [self._limits(cast("FloatArray", one.normal), none) for one in levels]
            given = np.array(of_levels)[:, rows]
        found = _Friction(
            direction=direction,
            sticks=acts & ~moves & ~sprung,
            diagonal=np.where(single, along, diagonal),
            beside=np.where(single, 0.0, mixed),
            known=direction[:, :, np.newaxis] * given,
            turning=turning.sum(axis=1),
        )
        if self._sprung is None:
            return found
        stiffer = (self.flexibility * step)[:, :, np.newaxis] * self.spring_rates[rows]
        return found._replace(known=found.known + self._by_slip(found, stiffer))

    def _limits(self, normal: FloatArray, rates: FloatArray) -> FloatArray:
        """Derivatives of the friction limits, (m, k), N, by those (q, k) of normal forces (q,)."""
        contact = self.system.contact
        limits = self.given + contact.gain @ rates
        for j, gain in enumerate(self.gains):
            if gain is not None:
                limits[:, j] += gain @ normal
        return np.asarray(limits)

    def _along(self, direction: FloatArray) -> sparse.csr_array:
        """Friction of each slip row by normal forces, (rows, q), in the directions of slip."""
        gain = self._gain_of_rows
        data = gain.data * np.repeat(direction, np.diff(gain.indptr))
        return sparse.csr_array((data, gain.indices, gain.indptr), shape=gain.shape)

    def _normals(self, after: Level, right: FloatArray) -> _Normals:
        """Points that are pressed at a level, with the right side (z, k) of its equations."""
        contact, at = self.contact, self.matrix.approach
        pressed = cast("FloatArray", after.normal) > 0.0
        closed = np.flatnonzero(pressed & contact.rigid)
        elastic = np.flatnonzero(pressed & ~contact.rigid)
        known, over = np.zeros((at.size, right.shape[1])), -contact.gaps(after.u)[elastic]
        by_unknowns = np.zeros((at.size, len(right)))
        known[closed], by_unknowns[closed] = right[at[closed]], -self.matrix.A[at[closed]]
        springs, given = contact.stiffness[elastic], self.at_rest[elastic]
        given = given + over[:, np.newaxis] * self.stiffness[elastic]
        given -= springs[:, np.newaxis] * self.gap[elastic]
        known[elastic, : given.shape[1]], by_unknowns[elastic, at[elastic]] = given, springs
        return _Normals(closed, elastic, known, by_unknowns)
