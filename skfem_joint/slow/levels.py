"""Levels of slowly changing loads: what is known of one.

:mod:`skfem_joint.slow.quasi_static` goes from one level to the next: from the displacement, the
friction forces and the slips of a level, and the forces of the next one. Friction is in N, as
limits may change from level to level. Where springs are in series with friction, its forces are
theirs: a level starts from those of the one before.
"""

from __future__ import annotations

from typing import NamedTuple

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError


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
