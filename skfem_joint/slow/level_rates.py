"""Derivatives of quasi-static levels by parameters of the system, by implicit differentiation.

A level obeys

    K u + B^T f + N^T (p - force) = alpha F,

with friction f and, where contact opens, normal forces p. It is the minimum of a step problem,
whose linearisation (:mod:`skfem_joint.minimise.linearisation`) takes what a parameter changes to
the derivatives of u, f and p. Slips count from those at the level before, less what springs k in
series were stretched by the friction q there, and approaches up to the gap:

    offset = B u_before - q / k,       bound = gap - force / stiffness,

so that derivatives go on from level to level. Where a point is just turning from one state to
another there are two derivatives, one to each side: that of the state which it has is taken, and
`LevelRates.turning` counts such points.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple, cast

import numpy as np

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.minimise.linearisation import Changes, Tangent
from skfem_joint.slow.levels import Level
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.system.sensitivity import SystemSensitivity

#: Slips below this share of those before and after an increment are round-off.
ROUND_OFF = 1e-13
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
        Of the friction force of each row, N, where it has a spring in series; else 0. Empty where
        no point has one.
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
        self.contact, self.parameters = path.to.system.contact, parameters
        self.opens, self.shift = path.opens, path.mass_shift  # springs carry nothing
        linear = path.linearisation()
        self.linear = linear if touch is None else linear.among(*touch)
        # K x = g is condensed once for all right sides and values: v x = z v' + v'' g, with v' the
        # restricted v, and v'' the displacement under v with the contact held.
        of_force = np.column_stack([force_rates, force])
        self._right_of_force = self.linear.restrict(of_force)[0]
        self._seen, beside = self.linear.restrict(looked_at)
        self._held = self.linear.extend(np.zeros_like(self._seen), beside)
        self._held_of_force = self._held.T @ of_force
        self.flexibility = self.contact.spring_flexibility[:, np.newaxis]
        self._contact_rates()
        self.turning: list[int] = []

    def _contact_rates(self) -> None:
        """Derivatives of limits, springs and normal contact, a column for each parameter."""

        def columns(size: int, values: Sequence[FloatArray | None]) -> FloatArray:
            none = np.zeros(size)
            return np.column_stack([*(none if x is None else x for x in values), none])

        m, normal = self.contact.w.size, self.contact.normal
        self.given = columns(m, [p.w for p in self.parameters])
        stiffer = columns(m, [p.stiffness for p in self.parameters])
        self._softer = self.flexibility**2 * np.repeat(stiffer, self.contact.directions, axis=0)
        if not self.opens:
            return
        parts = self.parameters
        q, stiffness = normal.gap.size, normal.stiffness[:, np.newaxis]
        self.at_rest = columns(q, [part.force for part in parts])
        self._bound = columns(q, [part.gap for part in parts]) - self.at_rest / stiffness
        self._bound_by_force = columns(q, [part.normal_stiffness for part in parts]) / stiffness**2
        self.gains = [part.gain for part in parts]
        # What is given beside normal forces: limits at rest without those of the forces at rest.
        self.given -= self.contact.gain @ self.at_rest + self._by_gain(normal.force)

    def _by_gain(self, normal: FloatArray) -> FloatArray:
        """What other gains change the friction limits by under normal forces (q,), (m, k), N."""
        change = np.zeros_like(self.given)
        for j, gain in enumerate(self.gains):
            if gain is not None:
                change[:, j] = gain @ normal
        return change

    def rest(self) -> Rates:
        """Of the level at rest."""
        none = np.zeros((self.linear.B.shape[0], self.given.shape[1]))
        values = np.zeros((self._seen.shape[1], self.given.shape[1]))
        limits, normal = self.given, none[:0]
        if self.opens:
            normal = self.at_rest
            limits = limits + self.contact.gain @ normal + self._by_gain(self.contact.normal.force)
        return Rates(values, none, none if self.contact.has_springs else none[:0], limits, normal)

    def sliders(
        self, levels: Sequence[Level], rates: Sequence[Rates]
    ) -> tuple[FloatArray, FloatArray]:
        """Slips of the sliders, (levels, rows), m, and their derivatives, (levels, rows, k)."""
        slips = np.array([level.slip for level in levels])
        of_slips = np.array([one.slip for one in rates])
        if not self.contact.has_springs:
            return slips, of_slips
        friction = np.array([level.friction for level in levels])
        of_slips -= self.flexibility * np.array([one.friction for one in rates])
        of_slips += friction[:, :, np.newaxis] * self._softer
        return slips - self.contact.spring_flexibility * friction, of_slips

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
        tangents, at = self._tangents(before, levels), self._pushing
        right, held = np.zeros((2, 0, 0))
        if at.size:
            pushed = self._pushed(levels)
            right, held = self.linear.restrict(pushed)[0], self._held.T @ pushed
        shape = len(walk), at.size
        right, held = (x.reshape(len(x), *shape) for x in (right, held))
        for k, (alpha, level) in enumerate(walk):
            right_here, held_here = alpha * self._right_of_force, alpha * self._held_of_force
            if at.size:
                right_here[:, at] += right[:, k]
                held_here[:, at] += held[:, k]
            last = self._next(last, tangents[k], (before, level), right_here, held_here)
            before = level
            found.append(last)
        return found

    def _next(
        self,
        last: Rates,
        at: Tangent,
        ends: tuple[Level, Level],
        right: FloatArray,
        held: FloatArray,
    ) -> Rates:
        """Of the next level, at the second one of both ``ends`` of an increment.

        Its right sides are restricted, (z, k), and ``held`` are the values that are looked at with
        the contact held, (f, k).
        """
        before, after = ends
        offset, given, bound, friction = last.slip, self.given, None, last.friction
        if self.contact.has_springs:
            stretched = (after.friction - before.friction)[:, np.newaxis]
            offset = offset - self.flexibility * last.friction - stretched * self._softer
        if self.opens:
            p = cast("FloatArray", after.normal)
            given = given + self._by_gain(p)
            more = (self.contact.normal.force - p)[:, np.newaxis]
            bound = self._bound + more * self._bound_by_force
        change = Changes(right, offset, given, bound)
        if self.shift:
            change, held = self._with_unit_force(change, held)
        z, normal = self.linear.solve(at, change)
        values = self._seen.T @ z + held
        if self.shift:
            values, z, normal = self._given_back(values, z, normal)
        slip, limits = np.asarray(self.linear.B @ z), given
        if self.opens:
            limits = given + self.contact.gain @ normal
            limits[~at.acts] = 0.0
        if self.contact.has_springs:
            friction = self.linear.friction(at, slip - offset, limits)
            friction[~self.contact.on_rows(self.contact.sprung)] = 0.0
        return Rates(values, slip, friction, limits, normal)

    def _with_unit_force(self, change: Changes, held: FloatArray) -> tuple[Changes, FloatArray]:
        """The same with a last column, the unit force, to give back what mass was added."""

        def wider(x: FloatArray | None) -> FloatArray | None:
            return None if x is None else np.column_stack([x, np.zeros(len(x))])

        force = np.column_stack([change.force, self._right_of_force[:, -1]])
        held = np.column_stack([held, self._held_of_force[:, -1]])
        return Changes(force, *map(wider, change[1:])), held

    def _given_back(self, values: FloatArray, *others: FloatArray) -> tuple[FloatArray, ...]:
        """Derivatives, (..., k), with the force given back that the mass added to K has.

        Levels have no added mass, but the matrix has: the last column of ``values`` and others,
        (..., k + 1), is by the unit force, which is the inertia of a mode of unit mass.
        """
        more = self.shift * values[0, :-1] / (1.0 - self.shift * values[0, -1])
        return tuple(x[:, :-1] + np.outer(x[:, -1], more) for x in (values, *others))

    @cached_property
    def _pushing(self) -> IntArray:
        """Parameters that push the structure at a given level, beside the force."""
        return np.flatnonzero([p.K is not None or p.force is not None for p in self.parameters])

    def _pushed(self, levels: Sequence[Level]) -> FloatArray:
        """Right sides (n, levels x pushing) of what parameters push at some levels.

        They are what K changes by, and forces at rest.
        """
        columns, u = list[FloatArray](), np.array([level.u for level in levels]).T
        for j in self._pushing.tolist():
            K = self.parameters[j].K
            columns.append(np.zeros(u.shape) if K is None else -(K @ u))
            if self.opens:
                columns[-1] += (self.contact.normal.N.T @ self.at_rest[:, j])[:, np.newaxis]
        return np.stack(columns, axis=2).reshape(len(u), -1)

    def _tangents(self, before: Level, levels: Sequence[Level]) -> list[Tangent]:
        """At the increments between levels that follow each other; counts points that may turn."""
        contact, path = self.contact, (before, *levels)
        forces, slips = (
            np.array([getattr(x, name) for x in path]) for name in ("friction", "slip")
        )
        limits = [contact.w if level.limits is None else level.limits for level in levels]
        step, w = np.diff(slips, axis=0), np.array(limits)
        stretch = step + contact.spring_flexibility * forces[:-1]
        acts, sprung, force = w > 0.0, contact.sprung, contact.slip_norm(forces[1:])
        # Slips of points that stick differ by round-off, so that it takes their friction too to
        # say which they are.
        size, whole = contact.slip_norm(step), contact.slip_norm(slips)
        size = np.where(size > ROUND_OFF * (whole[1:] + whole[:-1]), size, 0.0)
        trial = np.where(sprung, contact.spring_constants * contact.slip_norm(stretch), force)
        slides = np.where(sprung, trial > w, (size > 0.0) & (force >= (1.0 - TURNING) * w))
        moves, largest = acts & slides, np.where(acts, size, 0.0).max(axis=1, initial=0.0)
        # Points that hardly slip, or whose force hardly differs from the limit.
        hardly = moves & (size < TURNING * largest[:, np.newaxis])
        near = acts & ~moves & (trial > (1.0 - TURNING) * w)
        self.turning = (hardly | near).sum(axis=1).tolist()
        # Points slip along their friction, which has no round-off as differences of slips have.
        far = np.where(sprung, contact.slip_norm(stretch), size)
        ratio = np.divide(
            far, force, out=np.zeros_like(far), where=acts & (slides | sprung) & (force > 0.0)
        )
        slip = np.repeat(ratio, contact.directions, axis=1) * forces[1:]
        normal = np.array([level.normal for level in levels]) if self.opens else None
        return self.linear.at(slip, w, normal)
