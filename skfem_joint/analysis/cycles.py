"""What cycles of a load at rising levels give, followed by either kind of contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from skfem_joint.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class Cycles:
    """Cycles of a load between both signs of some levels.

    Attributes
    ----------
    level : ndarray, shape (levels,)
        Multiples of the load; fewer than asked for where the last ones have no state.
    states : ndarray, shape (levels, n)
        Displacement from the middle of a cycle to its end at the level, m.
    work : ndarray, shape (levels,)
        Work of friction in a cycle, J.
    slip, sliding : ndarray, shape (levels, m)
        Slip of each contact point that belongs to ``states``, m, and that of its slider: what is
        left by a spring in series, and zero where nothing is pressed all along.
    friction : ndarray, shape (levels, rows of B)
        Friction over its limit at the level.
    loops : ndarray, shape (increments, n)
        Increments of displacement along the half cycles that were followed, m, if they are kept.
    turned : ndarray, shape (increments, rows of B), or None
        Those of the friction over its limit.
    followed : ndarray of int
        Numbers of the levels whose half cycles these are.
    masing_error : float or None
        Largest relative error of the work by Masing's rule; None where it was not used.
    middle : ndarray, shape (levels, n), or None
        Displacement in the middle of both turning points, m; None where it is zero.
    opened : ndarray, shape (levels,), or None
        Share of the pressure points pressed at rest that opened; None where none can.
    limits : ndarray, shape (levels, m), or None
        Friction limits at the level, N; None where they are constant.
    shift : float
        1/s2; the states are those of K + shift M where friction alone holds the structure.
    errors : mapping of str to float
        Estimated relative errors of "frequency" and "damping_ratio", if they are known.
    notes : tuple of str
        What to beware of.
    """

    level: FloatArray
    states: FloatArray
    work: FloatArray
    slip: FloatArray
    sliding: FloatArray
    friction: FloatArray
    loops: FloatArray
    turned: FloatArray | None = None
    followed: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    masing_error: float | None = None
    middle: FloatArray | None = None
    opened: FloatArray | None = None
    limits: FloatArray | None = None
    shift: float = 0.0
    errors: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def carried(self, q: FloatArray) -> FloatArray:
        """Multiples of the load that K itself carries, (levels,), at amplitudes q of the mode.

        The load is the inertia M phi of a mode, and shift M u is q times that.
        """
        return np.asarray(self.level - self.shift * q)


def spread(levels: int, count: int) -> IntArray:
    """Numbers of ``count`` of some levels, evenly spread with both ends."""
    return np.unique(np.linspace(0, levels - 1, count).round().astype(np.intp))
