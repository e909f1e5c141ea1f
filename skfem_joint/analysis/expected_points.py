"""How many vibrations a response will take, for its progress: known ones and expected ones."""

from __future__ import annotations

import numpy as np

from skfem_joint.analysis.rows import Rows
from skfem_joint.progress import Tally


class Expected:
    """Vibrations of all curves: those that are known, and those that are expected.

    One with half the step, or of a larger model, counts like others: it starts from a steady state.
    (On a lapped solid 58 with half the step took 0.8 of the time of the others.)

    Parameters
    ----------
    tally : Tally
        Its total is kept up to date.
    rows : Rows
        Their total counts what is known alone.
    each : int
        Vibrations of each frequency: itself, with half the step, of a larger model.
    curves, asked : int
        Number of curves, and of frequencies asked for of each.
    likely : int or None
        Frequencies that are expected to be added to the first curve; None if none ever is.
    """

    def __init__(
        self, tally: Tally, rows: Rows, each: int, curves: int, asked: int, likely: int | None
    ) -> None:
        self.tally, self.rows, self.each = tally, rows, each
        self.added = np.zeros(curves, dtype=int)
        self.complete = np.full(curves, likely is None)
        self.known = curves * asked * each
        self.likely = likely or 0
        self._count()

    def of_curve(
        self, number: int, added: int = 0, complete: bool = False, failed: int = 0, more: int = 0
    ) -> None:
        """Note frequencies ``added`` to a curve, that it has all, or that some ``failed``.

        Of those that have no steady vibration no other one is computed. ``more`` is a number of
        other vibrations that are needed.
        """
        self.added[number] += added
        self.complete[number] |= complete
        self.known += more - failed * (self.each - 1)
        self.rows.total += added * self.each + more - failed * (self.each - 1)
        self._count()

    def _count(self) -> None:
        """Update the total: curves still to be refined get as many as those before, on average."""
        likely = self.likely
        if self.complete.any():
            likely = round(float(self.added[self.complete].mean()))
        added = np.where(self.complete, self.added, np.maximum(self.added, likely))
        self.tally.total = self.known + self.each * int(added.sum())
