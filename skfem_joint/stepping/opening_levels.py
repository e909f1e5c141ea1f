"""Levels of quasi-static runs with contact that opens and closes.

The increment d of the displacement from the level before minimises

    1/2 d K d - (f + N^T force - K u) d + sum w |B d|    with    N d <= gap - N u,

with the friction limits w of the normal forces at its end, see
:mod:`skfem_joint.minimise.contact_newton`. Where bodies are held by friction or contact alone K is
singular; a little of the mass is added to it, and each level is repeated until the added mass
carries nothing.

A reduced model has fewer unknowns than slips, of which each cannot stick by itself. Its friction is
w sigma(B d) with a law so steep that sticking points creep by a share `CREEP` of the largest slip
of any increment before; contact is elastic there, see
:mod:`skfem_joint.minimise.primal_dual_newton`. Points with springs have Coulomb's law.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, cast

import numpy as np

from skfem_joint.arrays import FloatArray, as_dense
from skfem_joint.errors import InputError
from skfem_joint.linalg import shifts
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.minimise.choice import step_problem
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed
from skfem_joint.minimise.touching import Touching
from skfem_joint.modes import is_singular
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.levels import Level, NoLevelError
from skfem_joint.system import System

#: Most times that a level is repeated until the added mass carries nothing.
REPEATED = 40
#: Share of the load that the added mass may carry at last.
CARRIED = 1e-9
#: Where the added mass carries this share, and so much of the forces is left at most, nothing holds
#: the structure: round-off of motions of kilometres is what is left.
FLIES, LEFT = 1e-3, 1e-3
#: Most that an increment is guessed longer than the one before.
LONGER = 2.0
#: Slip of a sticking point in an increment of a reduced model, over the largest slip of any.
CREEP = 1e-6
#: Slips below this share of the one that the law was made for ask for a steeper law, at most so
#: often.
SMALLER, STEEPER = 0.1, 10
#: Work of friction over that of the change of the loads below which the law is steep enough.
IDLE = 1e-8
NOT_HELD = "friction and contact do not hold the loads: the structure slides or lifts off"


class Kept(NamedTuple):
    """What is kept of an increment, as a guess of the next one.

    Attributes
    ----------
    v : ndarray, shape (n,)
        Increment of the displacement, m.
    work : float
        Work of the change of the forces on it, J.
    """

    v: FloatArray
    work: float

    def start(self, change: FloatArray) -> FloatArray:
        """Guess of the increment under a change of the forces (n,), N.

        It grows with the change, and is none where the load turns round: what slips one way is no
        guess of what will slip the other way. Points of a bar of 100 do not come to rest from it.
        """
        work = float(change @ self.v)
        return self.v * (min(work / self.work, LONGER) if work > 0.0 < self.work else 0.0)


class OpeningLevels:
    """Levels with contact that opens, see `skfem_joint.stepping.levels.LevelSolver`.

    Parameters
    ----------
    system : System
        Its masses matter only where contact alone holds a body.
    tolerance : float
        Largest force residual relative to the largest force.
    """

    def __init__(self, system: System, tolerance: float) -> None:
        self.to = arranged(system)
        inner = self.to.system
        if inner.opening is None:
            raise InputError("contact that opens: found a system without it")
        self.tolerance, self.contact = tolerance, inner.opening
        K = as_dense(inner.K) if inner.is_dense else as_compressed(inner.K)
        self.K, self.added, self.shift = K, None, 0.0
        if is_singular(K):
            self.shift = shifts.SETTINGS.least * inner.mean_square_frequency
            M = as_dense(inner.M) if inner.is_dense else as_compressed(inner.M)
            self.added = self.shift * M
        self.H = K if self.added is None else K + self.added
        self.few = self.to.kind == "dense"
        self.problem = step_problem(self.H, ContactPoints.of(inner), self.to.kind)
        self.largest_slip = 0.0
        self._friction = np.zeros(inner.B.shape[0])
        self.constant = inner.w - self.contact.limits_at_rest
        self.touching = Touching(self.contact.force > 0.0)
        self.kept = Kept(np.zeros(inner.n), 0.0)
        self._counts = {"factorizations": 1}

    @property
    def counts(self) -> Mapping[str, int]:
        """See `LevelSolver`."""
        return self._counts

    @property
    def creep(self) -> float:
        """Slip of a sticking point in an increment up to now, m; none but of few unknowns."""
        return CREEP * self.largest_slip

    def rest(self) -> Level:
        """See `LevelSolver`."""
        inner = self.to.system
        rows = np.zeros(inner.B.shape[0])
        return Level(np.zeros(inner.n), rows, rows, inner.w, self.contact.force)

    def next(self, last: Level, force: FloatArray) -> Level:
        """See `LevelSolver`."""
        change = self._change(last, force)
        self._friction = last.friction
        found, u = self._first_increment(last.u, force, change)
        first = u - last.u
        for _ in range(REPEATED):
            if self.added is None or self._carried(found, force) <= CARRIED:
                break
            self._friction = self._friction_of(found)
            found, u = self._increment(u, force, np.zeros_like(u))
        else:
            if self.added is not None:
                raise NoLevelError(NOT_HELD, beyond=True)
        self.kept = Kept(first, float(change @ first))
        friction = self._friction_of(found)
        slip = np.asarray(self.to.system.B @ u)
        return Level(u, friction, slip, found.w, found.p)

    def _first_increment(
        self, u: FloatArray, force: FloatArray, change: FloatArray
    ) -> tuple[Minimum, FloatArray]:
        """Increment from ``u``, guessed by that before; of few unknowns with a law steep enough."""
        start = self.kept.start(change)
        if not self.few:
            return self._increment(u, force, start)
        unknown = not self.largest_slip
        if unknown:  # that without friction is no less
            held = self.H + as_dense(self.contact.springs)
            self.largest_slip = self._slip(np.linalg.solve(held, change)) or 1.0
        for _ in range(STEEPER):
            found, after = self._increment(u, force, start)
            slip = self._slip(found.v)
            idle = found.w.sum() * slip <= IDLE * abs(float(change @ found.v))
            if not unknown or idle or slip >= SMALLER * self.largest_slip:
                break
            self.largest_slip *= SMALLER
            start = found.v
        self.largest_slip = max(self.largest_slip, slip)
        return found, after

    def _friction_of(self, found: Minimum) -> FloatArray:
        return np.asarray(found.sigma * self.to.system.on_rows(found.w))

    def _slip(self, d: FloatArray) -> float:
        """Largest slip of a point in an increment (n,), m."""
        inner = self.to.system
        return float(inner.slip_norm(np.asarray(inner.B @ d)).max(initial=0.0))

    def _change(self, last: Level, force: FloatArray) -> FloatArray:
        """Change of the forces from a level to ``force``, (n,), N: what does not balance yet."""
        normal = self.contact.force - cast("FloatArray", last.normal)
        held = self.to.system.B.T @ last.friction
        return np.asarray(force + self.contact.N.T @ normal - self.K @ last.u - held)

    def _increment(
        self, u: FloatArray, force: FloatArray, start: FloatArray
    ) -> tuple[Minimum, FloatArray]:
        """Increment from ``u`` under ``force``, and the displacement after it."""
        contact = self.contact
        bound = contact.gaps(u)
        soft = ~contact.rigid
        bound[soft] -= contact.force[soft] / contact.stiffness[soft]
        right = force + contact.N.T @ contact.force - self.K @ u
        steepness = 1.0 / self.creep if self.few else np.inf
        found = self.problem.minimise(
            right, start, self.tolerance, np.where(self.to.system.sprung, np.inf, steepness),
            self.to.system.spring_offset(np.zeros_like(u), self._friction),
            Pressed(bound, self.constant, touching=self.touching),
        )  # fmt: skip
        for name, count in found.counts.items():
            self._counts[name] = self._counts.get(name, 0) + count
        most = "largest_iterations"
        self._counts[most] = max(self._counts.get(most, 0), found.counts["newton_iterations"])
        if not found.converged:
            left = found.residual <= LEFT * float(np.abs(right).max())
            if self.added is not None and left and self._carried(found, force) > FLIES:
                raise NoLevelError(NOT_HELD, beyond=True)
            unknown = self.to.outer_number(max(found.where, 0))
            raise NoLevelError(
                f"a force residual of {found.residual:.3g} N is left at unknown {unknown}", unknown
            )
        self.touching.follow(found.p)
        return found, u + found.v

    def _carried(self, found: Minimum, force: FloatArray) -> float:
        """Share of the largest force that the added mass carries."""
        carried = 0.0 if self.added is None else float(np.abs(self.added @ found.v).max())
        largest = max(float(np.abs(force).max()), float(found.p.max(initial=0.0)))
        return carried / largest if largest > 0.0 else 0.0
