"""Levels of a quasi-static run: what the driver needs of a solver, and Coulomb friction as one.

The driver (:mod:`skfem_joint.stepping.slow_run`) knows nothing of how a level is solved. A solver
says in which system and unknowns it works, and goes from one level to the next: from the
displacement, the friction forces and the slips of a level, and the forces of the next one. Friction
is in N, so that a solver may have limits that change from level to level. Where springs are in
series with friction, its forces are theirs: a level starts from those of the one before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple, Protocol

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import ConvergenceError
from skfem_joint.stepping.arrangement import Arranged
from skfem_joint.stepping.quasi_static import Increment, QuasiStatic
from skfem_joint.system import System

#: Where friction alone holds, a level is solved again at most so many times.
REPEATED = 3
#: A level that does not converge is reached in parts, halved at most this often.
HALVINGS = 8


class Level(NamedTuple):
    """State of a structure at a level of its loads.

    Attributes
    ----------
    u : ndarray, shape (n,)
        Displacement, m, in the unknowns of the solver.
    friction : ndarray, shape (rows,)
        Friction force of each slip row, N, with the sign of the slip that it resists.
    slip : ndarray, shape (rows,)
        Slip of each row, m.
    limits : ndarray, shape (m,), optional
        Friction limits, N, where they change from level to level.
    normal : ndarray, shape (q,), optional
        Normal forces of contact that opens, N.
    """

    u: FloatArray
    friction: FloatArray
    slip: FloatArray
    limits: FloatArray | None = None
    normal: FloatArray | None = None


class NoLevelError(ConvergenceError):
    """A level that was not found; `beyond` says that it does not exist, so that no part helps."""

    def __init__(self, message: str, unknown: int | None = None, beyond: bool = False) -> None:
        super().__init__(message, unknown)
        self.beyond = beyond


class LevelSolver(Protocol):
    """What the driver of quasi-static runs needs of a solver.

    Attributes
    ----------
    to : Arranged
        System in whose unknowns levels are solved, with maps to and from the caller's. Friction is
        recorded relative to its limits ``w``.
    counts : mapping of str to int
        Work done so far, by names of :class:`skfem_joint.stepping.recording.Counters`.
    """

    to: Arranged

    @property
    def counts(self) -> Mapping[str, int]:
        """Work done so far."""

    def rest(self) -> Level:
        """Level without loads, from which a run starts."""

    def next(self, last: Level, force: FloatArray) -> Level:
        """Level under ``force``, (n,), N, after the level ``last``.

        Raises
        ------
        NoLevelError
            If it does not exist, or was not found.
        """


def in_parts(
    next_level: Callable[[Level, FloatArray], Level],
    last: Level,
    before: FloatArray,
    after: FloatArray,
    depth: int = 0,
) -> Iterator[tuple[FloatArray, Level]]:
    """Levels on the way from loads ``before``, with the level ``last``, to loads ``after``.

    It is the one of ``after`` alone if that is found, and otherwise those of ever smaller parts.

    Parameters
    ----------
    next_level : callable
        Of the level before and the loads: `LevelSolver.next` for loads as forces.
    last : Level
    before, after : ndarray
        Loads, N, which change in proportion.
    depth : int
        How often the way was halved.

    Yields
    ------
    loads : ndarray
    level : Level

    Raises
    ------
    NoLevelError
        If a level does not exist, or is not found after `HALVINGS`.
    """
    try:
        level = next_level(last, after)
    except NoLevelError as error:
        if error.beyond or depth >= HALVINGS:
            raise
    else:
        yield after, level
        return
    for end in (0.5 * (before + after), after):
        for loads, level in in_parts(next_level, last, before, end, depth + 1):
            yield loads, level
            before, last = loads, level


class CoulombLevels:
    """Levels under Coulomb friction with constant limits and maybe springs, by `QuasiStatic`.

    Parameters
    ----------
    system : System
        Its law and masses do not count.
    tolerance : float
        Largest force residual relative to the largest force.

    Raises
    ------
    InputError
        If slip rows of a large sparse system depend on each other.
    """

    def __init__(self, system: System, tolerance: float) -> None:
        self.path = QuasiStatic(system, tolerance, frictionless=True)
        self.to = self.path.to
        self._counts: dict[str, int] = {}

    @property
    def counts(self) -> Mapping[str, int]:
        """See `LevelSolver`."""
        return self._counts | {"factorizations": self.path.factorizations}

    def rest(self) -> Level:
        """See `LevelSolver`."""
        n, rows = self.to.system.n, self.to.system.contact.B.shape[0]
        return Level(np.zeros(n), np.zeros(rows), np.zeros(rows))

    def next(self, last: Level, force: FloatArray) -> Level:
        """See `LevelSolver`."""
        tried = self._tried(last.u, force, last.friction)
        for _ in range(REPEATED):
            if tried.beyond:
                raise NoLevelError(self._beyond(self._limit(force)), beyond=True)
            if not tried.found.converged or tried.carried <= self.path.tolerance:
                break
            # What the added mass has carried is what is left of the load: once more from there.
            before, tried = tried.carried, self._tried(tried.u, force, tried.friction)
            if tried.found.converged and tried.carried > 0.5 * before:
                limit = self._limit(force)  # friction does not take it over
                if limit <= 1.0:
                    raise NoLevelError(self._beyond(limit), beyond=True)
                break
        if not tried.found.converged:
            unknown = self.to.outer_number(tried.found.where)
            raise NoLevelError(
                f"a force residual of {tried.found.residual:.3g} N is left at unknown {unknown}",
                unknown,
            )
        return Level(tried.u, tried.friction, np.asarray(self.to.system.contact.B @ tried.u))

    def _tried(self, u: FloatArray, force: FloatArray, friction: FloatArray) -> Increment:
        """Increment of the path, whose work is counted."""
        tried = self.path.increment(u, force, friction)
        self._count(tried.found.counts)
        return tried

    def _count(self, work: Mapping[str, int]) -> None:
        """Add the work of a level."""
        for name, number in work.items():
            if name == "factorizations":
                continue
            self._counts[name] = self._counts.get(name, 0) + number
        most, last = "largest_iterations", work.get("newton_iterations", 0)
        self._counts[most] = max(self._counts.get(most, 0), last)

    def _limit(self, force: FloatArray) -> float:
        """Multiple of forces (N) that supports and friction can just hold; 0 if it is not known."""
        if not self.to.system.contact.count:
            return 0.0
        inner = self.path.afresh(Arranged(self.to.system, self.to.kind))
        try:
            return inner.limit(force)
        except ConvergenceError:
            return 0.0

    def _beyond(self, limit: float) -> str:
        """Why there is no level, by the multiple of the loads that supports and friction hold."""
        if limit <= 0.0:
            return "neither a support nor friction holds the structure against the loads"
        return (
            f"the loads are {1.0 / limit:.6g} times what supports and friction hold: the "
            "structure slides"
        )
