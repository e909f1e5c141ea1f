"""Step problems with contact that opens, and springs in series with friction.

A point with a spring slips by t = B v in all, of which its slider takes y and the spring the rest:

    minimise over v, y:   1/2 v H v - g v + sum k / 2 |B v - y|^2 + q (B v - y) + sum w psi(|y|)

with N v <= bound, the force q that the spring would have with v = y = 0, and its stiffness k. The
slider is a friction point like any other, with an unknown of its own; t is no slip any more. So the
problem is that of :mod:`skfem_joint.minimise.opening_newton`, with limits w that follow the normal
forces. The force k (B v - y) + q of the spring is the friction of the slider: it is cut to the
limit when that falls, and is zero where contact is open.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from scipy import sparse

from skfem_joint.arrays import FloatArray
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.minimise.opening_newton import OpeningNewton
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed

if TYPE_CHECKING:
    from skfem_joint.minimise.problem import PressurePoints


class OpeningOnSprings:
    """Step problem with contact that opens and springs in series with friction, see the module.

    Parameters
    ----------
    H, points
        As `OpeningNewton` takes them; rows of ``points`` with springs may share unknowns.
    """

    def __init__(self, H: Any, points: ContactPoints) -> None:
        normal = cast("PressurePoints", points.normal)
        flexible = points.on_rows(cast("FloatArray", points.flexible))
        springs = np.divide(1.0, flexible, out=np.zeros_like(flexible), where=flexible > 0.0)
        self.H, self.points, self.springs, N = H, points, springs, normal.N
        self.rows = np.flatnonzero(springs)
        self.n, count = H.shape[0], self.rows.size
        k, B = sparse.diags_array(springs[self.rows]), sparse.csr_array(points.B)
        self.B = B[self.rows]
        joined = sparse.csr_array(self.B.T @ k)
        both = sparse.block_array([[sparse.csr_array(H) + joined @ self.B, -joined],
                                   [-joined.T, k]])  # fmt: skip
        rigid = sparse.diags_array((springs == 0.0).astype(float)) @ B
        own = sparse.csr_array(
            (np.ones(count), (self.rows, np.arange(count))), shape=(springs.size, count)
        )
        sliders = sparse.csr_array(sparse.hstack([rigid, own]))
        sliders.eliminate_zeros()
        approach = sparse.csr_array(
            sparse.hstack([sparse.csr_array(N), sparse.csr_array((N.shape[0], count))])
        )
        H = both.toarray() if isinstance(H, np.ndarray) else as_compressed(both)
        self.problem = OpeningNewton(
            H, replace(points, B=sliders, flexible=None, normal=replace(normal, N=approach))
        )

    @property
    def factorizations(self) -> int:
        """See `OpeningNewton`."""
        return self.problem.factorizations

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`. Sliders start at rest."""
        q = np.zeros(self.rows.size)
        if offset is not None:
            q = -(self.springs * offset)[self.rows]
        right = np.concatenate([g - self.B.T @ q, q])
        begin = None if start is None else np.concatenate([start, np.zeros(q.size)])
        solved = self.problem.minimise(right, begin, tolerance, beta, None, pressed)
        where = solved.where
        if where >= self.n:
            where = int(self.B[[where - self.n]].indices[0])
        return replace(solved, v=solved.v[: self.n], where=where)
