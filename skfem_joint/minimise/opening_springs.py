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
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.arrays import FloatArray
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.minimise.opening_loops import Hinges
from skfem_joint.minimise.opening_newton import OpeningMinimum, OpeningNewton
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.minimise.touching import Touching


class OpeningOnSprings:
    """Step problem with contact that opens and springs in series with friction, see the module.

    Parameters
    ----------
    H, points, N, gain, stiffness
        As `OpeningNewton` takes them; rows of ``points`` with springs may share unknowns.
    springs : ndarray, shape (rows,)
        Stiffness of the spring of each row of B, in N over the unit of v; zero for none.
    """

    def __init__(
        self,
        H: Any,
        points: ContactPoints,
        N: Any,
        gain: Any,
        stiffness: FloatArray,
        springs: FloatArray,
    ) -> None:
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
            H, replace(points, B=sliders, soft=None), approach, gain, stiffness
        )

    @property
    def factorizations(self) -> int:
        """See `OpeningNewton`."""
        return self.problem.factorizations

    def minimise(
        self,
        g: FloatArray,
        bound: FloatArray,
        given: FloatArray,
        gain: FloatArray | float = 1.0,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        touching: Touching | None = None,
        hinges: Hinges | None = None,
        held: FloatArray | None = None,
    ) -> OpeningMinimum:
        """Minimise for the right side ``g``, see `OpeningNewton.minimise`.

        ``held``, (rows,), N, is the force q of the module; none if not given. Sliders start at
        rest.
        """
        q = np.zeros(self.rows.size) if held is None else held[self.rows]
        right = np.concatenate([g - self.B.T @ q, q])
        begin = None if start is None else np.concatenate([start, np.zeros(q.size)])
        solved = self.problem.minimise(
            right, bound, given, gain, begin, tolerance, beta, touching, hinges
        )
        where = solved.where
        if where >= self.n:
            where = int(self.B[[where - self.n]].indices[0])
        return replace(solved, v=solved.v[: self.n], where=where)
