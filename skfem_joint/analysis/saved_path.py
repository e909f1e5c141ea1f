"""Quasi-static response that stores each load level in a file, to be resumed after an interrupt."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.analysis.rows import Rows
from skfem_joint.arrays import FloatArray
from skfem_joint.progress import Tally
from skfem_joint.stepping.arrangement import Arranged
from skfem_joint.stepping.quasi_static import SETTINGS as QUASI_STATIC
from skfem_joint.stepping.quasi_static import QuasiStatic
from skfem_joint.system import System


class SavedPath(QuasiStatic):
    """Quasi-static response that stores each level as a row of `Rows`; a later command reads it.

    A level depends, to the bit, only on its force, on the state that it starts from and on the
    increment before it. A digest of these is the name of its row; the solver keeps nothing else
    from one level to the next.

    Parameters
    ----------
    system : System
    tolerance : float
        As `QuasiStatic` takes it.
    tally : Tally
        Counts the levels, computed or taken up.
    rows : Rows
        Where levels are kept.

    Attributes
    ----------
    origin : str
        Name of what all rows depend on: the system and the tolerance.

    Where a small multiple of M makes K definite, ``shift``, its forces on all but rigid motions
    count at every level in full: (K + shift M) u + B^T f = F. They are known from u then, which
    those of the last increment alone would not be.
    """

    def __init__(self, system: System, tolerance: float, tally: Tally, rows: Rows) -> None:
        super().__init__(system, tolerance, tally)
        if self.shift and self.condensed is None:
            self._spare_rigid(self.rigid)
        self.rows, self.origin = rows, rows.mark("level", system, tolerance)

    def again(self, to: Arranged, tally: Tally, rows: Rows) -> SavedPath | None:
        """Path at rest of a system that differs in limits, springs and damping alone, or None.

        Factors of the stiffness are used again.
        """
        old, new = self.to.system, to.system
        known = self.whole is not None and to.kind == self.to.kind
        if not known or not all(
            _same(getattr(old, name), getattr(new, name)) for name in ("K", "M", "B", "beta")
        ):
            return None
        if not np.array_equal(old.w > 0.0, new.w > 0.0):
            return None
        path = self.limited(to)
        path.tally, path.rows = tally, rows
        path.origin = rows.mark("level", new, self.tolerance)
        return path

    def follow(
        self,
        forces: FloatArray,
        times: FloatArray | None = None,
        limit_share: float = QUASI_STATIC.limit_share,
        start: tuple[FloatArray, ...] | None = None,
    ) -> FloatArray:
        """As `QuasiStatic.follow`; levels at given times are not stored."""
        if times is not None:
            self.forget()
            states = super().follow(forces, times, limit_share, start)
            self.forget()
            return states
        levels, frictions = [], []
        start = tuple(np.zeros((2, forces.shape[1]))) if start is None else start
        if len(start) == 2:
            start = *start, np.zeros_like(self.sigma)
        for force in forces:
            u = self._level(force, limit_share, start)
            levels.append(u)
            frictions.append(self.sigma)
            start = u, force, self.sigma
        self.frictions = np.array(frictions)
        return np.array(levels)

    def _level(
        self, force: FloatArray, limit_share: float, start: tuple[FloatArray, ...]
    ) -> FloatArray:
        """Displacement (n,), m, under a force (N), from a start as of `follow`."""
        mark = self.rows.mark(self.origin, force, limit_share, *start, self.last)
        counted = self.tally.done

        def compute() -> tuple[FloatArray, ...]:
            self.forget(self.last)
            follow = super(SavedPath, self).follow
            levels = follow(force[np.newaxis], limit_share=limit_share, start=start)
            return levels[0], self.last, self.sigma

        state, self.last, self.sigma = self.rows.row(mark, compute)
        if self.tally.done == counted:  # taken up, so that nobody has counted it
            self.tally.add()
        return state

    def limit(self, force: FloatArray) -> float:
        """As `QuasiStatic.limit`, as a row that depends on the force alone."""
        self.forget()
        compute = super().limit
        mark = self.rows.mark(self.origin, "limit", force)
        limit = self.rows.row(mark, lambda: compute(force))
        self.forget()
        return limit


def _same(A: Any, B: Any) -> bool:
    """Whether two arrays or sparse arrays are the same, entry by entry."""
    if not (sparse.issparse(A) and sparse.issparse(B)):
        return type(A) is type(B) and np.array_equal(A, B)
    parts = ((x.indptr, x.indices, x.data) for x in (A, B))
    return A.format == B.format and all(map(np.array_equal, *parts))
