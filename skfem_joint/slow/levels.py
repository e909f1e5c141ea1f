"""Levels of slowly changing loads: what is known of one, and what drivers need of a solver.

Drivers (:mod:`skfem_joint.runs.slow_run`, :mod:`skfem_joint.vibration.cycles`) know nothing of
how a level is solved: :mod:`skfem_joint.slow.quasi_static` does it, for all kinds of contact. A
solver says in which system and unknowns it works, and goes from one level to the next: from the
displacement, the friction forces and the slips of a level, and the forces of the next one. Friction
is in N, so that a solver may have limits that change from level to level. Where springs are in
series with friction, its forces are theirs: a level starts from those of the one before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple, Protocol

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.stepping.arrangement import Arranged

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
    moved : ndarray, shape (n,), optional
        Increment of the displacement that led to it, m, by which the next one is guessed.
    work : float
        Work of the change of the forces on it, J.
    """

    u: FloatArray
    friction: FloatArray
    slip: FloatArray
    limits: FloatArray | None = None
    normal: FloatArray | None = None
    moved: FloatArray | None = None
    work: float = 0.0


#: Levels that follow each other, with their multiples of a force.
Walk = list[tuple[float, Level]]


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
