"""Points of contact that opens which touch, followed from step to step.

A pressure point that is apart carries no force, and a friction point whose pressure points are all
apart carries none either. The unknowns of such points obey linear equations, and are eliminated
(:mod:`skfem_joint.minimise.condensed_newton`). Where a solution would let a point that was
eliminated pass its bound, the point is kept from then on and the problem solved again, so that the
solution does not depend on what is eliminated, but for round-off.

Another set of points costs something. Therefore points are also kept that would close within some
of the steps to come, and points are dropped only after they have been apart for some steps, and
several at a time.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import BoolArray, FloatArray, check_like

#: Fewest points worth being eliminated at all: of a joint with 36 points in all, eliminating some
#: made a step a twentieth longer.
FEWEST = 40
#: Fewest points worth being dropped together, and their least share of those kept.
DROPPED = 8, 0.02
#: Steps after which points that are apart may be dropped, and in which they would close if kept.
APART, SOON = 4, 4


class Touching:
    """Pressure points that are kept, which follow those that carry forces from step to step.

    Attributes
    ----------
    kept : ndarray of bool, shape (q,)
    apart : ndarray of int, shape (q,)
        Steps since each point last carried a force.
    """

    def __init__(self, pressed: BoolArray) -> None:
        self.kept = np.array(pressed, dtype=bool)
        self.apart = np.zeros(self.kept.size, dtype=np.int64)

    @property
    def some_apart(self) -> bool:
        """Whether enough points are apart, and some are not, for an elimination to pay."""
        apart = self.kept.size - np.count_nonzero(self.kept)
        return bool(FEWEST <= apart < self.kept.size)

    def closes(self, approach: FloatArray, bound: FloatArray) -> bool:
        """Whether points that are not kept pass their bounds: then these and others are kept.

        ``approach`` and ``bound`` (q,) are those of a step; the others are those that would pass
        within a few.
        """
        moves = ~self.kept & (approach > np.minimum(bound, 0.0))
        over = moves & (approach > bound)
        if not over.any():
            return False
        soon = moves & (approach * SOON > bound)
        self.kept = self.kept | over | soon
        self.apart[over | soon] = 0
        return True

    def follow(self, p: FloatArray) -> None:
        """Take note of the forces (q,), N, of a step, and drop points that are long apart."""
        self.apart = np.where(p > 0.0, 0, self.apart + 1)
        self.kept = self.kept | (p > 0.0)
        long_apart = self.kept & (self.apart >= APART)
        count = np.count_nonzero(long_apart)
        if count >= max(DROPPED[0], DROPPED[1] * np.count_nonzero(self.kept)):
            self.kept = self.kept & ~long_apart

    def saved(self) -> dict[str, NDArray[Any]]:
        """Arrays that later steps depend on, to the bit, for a checkpoint."""
        return {"kept": self.kept.copy(), "apart": self.apart.copy()}

    def restore(self, saved: Mapping[str, NDArray[Any]]) -> None:
        """Take up what `saved` returned; ValueError names an array that does not fit."""
        check_like({name: saved[name] for name in ("kept", "apart")}, self.saved(), "touching")
        self.kept, self.apart = np.array(saved["kept"]), np.array(saved["apart"])
