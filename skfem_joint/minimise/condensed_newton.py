"""Truncated Newton method on the Schur complement of the unknowns in contact.

Friction acts on the slips alone. All other unknowns are eliminated once, and the method runs on a
smaller matrix, which is mostly dense, for any number of right sides.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.arrays import FloatArray
from skfem_joint.linalg.schur import SchurComplement
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed
from skfem_joint.minimise.truncated_newton import TruncatedNewton


class CondensedNewton:
    """`TruncatedNewton` on the Schur complement of the unknowns in contact, see `StepProblem`.

    Attributes
    ----------
    schur : SchurComplement
        Of H, on the unknowns of points with friction.
    contact : TruncatedNewton
        The problem of these unknowns.
    """

    def __init__(self, H: Any, points: ContactPoints) -> None:
        self.H, self.points = H, points
        self._limited = np.flatnonzero(points.on_rows(points.w))
        self._points = np.flatnonzero(points.w > 0.0)
        self.schur = SchurComplement(H, points.limited)
        self.contact = self._contact()

    def _contact(self) -> TruncatedNewton:
        """The problem of the unknowns of points with friction."""
        points, some = self.points, self._points
        acting = ContactPoints(
            points.B[self._limited],
            points.directions[some],
            points.w[some],
            points.beta[some],
            None if points.flexible is None else points.flexible[some],
        )
        return TruncatedNewton(self.schur.complement, acting.in_unknowns(self.schur.kept))

    def with_limits(self, points: ContactPoints) -> CondensedNewton:
        """Problem with other friction limits, zero where they were zero, and the same factors."""
        other = copy(self)
        other.points = points
        other.contact = other._contact()
        return other

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far, that of the interior included."""
        return self.contact.factorizations + 1

    def with_matrix(self, H: Any) -> CondensedNewton:
        """See `StepProblem`."""
        return CondensedNewton(H, self.points)

    def compile(self) -> None:
        """See `StepProblem`."""
        self.contact.compile()

    def objective(
        self,
        v: FloatArray,
        g: FloatArray,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
    ) -> float:
        """See `StepProblem`."""
        laws = self.contact.laws_of(
            None if beta is None else beta[self._points],
            None if offset is None else offset[self._limited],
        )
        friction = self.contact.friction_potential(v[self.schur.kept], laws)
        return float(v @ (0.5 * (self.H @ v) - g)) + friction

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`."""
        schur, force = self.schur, float(np.abs(g).max())
        right, interior = schur.restrict(g)
        inner = self.contact.minimise_beside(
            right,
            None if start is None else start[schur.kept],
            tolerance,
            None if beta is None else beta[self._points],
            force,
            None if offset is None else offset[self._limited],
        )
        v, friction = schur.extend(inner.v, interior), np.zeros(self.points.B.shape[0])
        friction[self._limited] = inner.sigma
        return replace(
            inner,
            v=v,
            sigma=friction,
            converged=inner.converged and bool(np.all(np.isfinite(v))),
            counts=inner.counts | {"linear_solves": inner.counts["linear_solves"] + 2},
            where=int(schur.kept[inner.where]),
            w=self.points.w,
        )

    def saved(self) -> dict[str, NDArray[Any]]:
        """See `StepProblem`."""
        return self.contact.saved()

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        self.contact.check(saved)

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        self.contact.restore(saved)
