"""Contact that opens and closes: approaches, gaps and normal forces of pressure points.

Faces approach each other at each pressure point by N u, the mean approach of the displacements
around it (`skfem_joint.joint.pressure_space`). Faces do not pass through each other, and press
but never pull:

    N u <= gap,   p >= 0,   (N u - gap) p = 0       (rigid)
    p = max(0, force + stiffness (N u - gap)),      (with a stiffness)

where ``gap`` and ``force`` are those at rest, u = 0. The equations of motion get the forces
-N^T (p - force). What the forces give to friction limits is in `skfem_joint.system.contacts`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, sparse

from skfem_joint.ground.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    Matrix,
    make_real,
    wrong_shapes,
)
from skfem_joint.system.unknowns import selection


@dataclass(frozen=True)
class NormalPart:
    """Normal part of a contact, on the unknowns of a system.

    Attributes
    ----------
    N : ndarray or sparse array, shape (q, n)
        Mean approach of the faces at each pressure point, m, from the unknowns.
    gap : ndarray, shape (q,)
        Gap at rest, m; zero where faces touch.
    force : ndarray, shape (q,)
        Normal force at rest, N; zero where faces are apart.
    stiffness : ndarray, shape (q,)
        Of each pressure point, N/m; ``inf`` is rigid.
    area : ndarray, shape (q,)
        Area of each pressure point, m2.
    shares : sparse array, shape (q, q_all), or None
        Share of each pressure point of the structure in each pressure point of a reduced model,
        which are means of these with their stiffness; rows add up to 1. None where both are the
        same points.
    """

    N: Matrix
    gap: FloatArray
    force: FloatArray
    stiffness: FloatArray
    area: FloatArray
    shares: Matrix = None

    def __post_init__(self) -> None:
        make_real(self, ("N", "gap", "force", "stiffness", "area", "shares"), "normal: ")

    @staticmethod
    def none(n: int) -> NormalPart:
        """Without pressure points, for ``n`` unknowns."""
        return NormalPart(sparse.csr_array((0, n)), *np.zeros((4, 0)))

    @staticmethod
    def joined(parts: Sequence[NormalPart]) -> NormalPart:
        """Pressure points of several, each with unknowns of its own."""
        values = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("gap", "force", "stiffness", "area")
        }
        return NormalPart(sparse.csr_array(sparse.block_diag([p.N for p in parts])), **values)

    def problems(self, n: int) -> list[str]:
        """What is wrong with shapes and values for ``n`` unknowns."""
        q = self.gap.size
        shapes = {"N": (q, n)} | dict.fromkeys(("gap", "force", "stiffness", "area"), (q,))
        if self.shares is not None:
            shapes["shares"] = (q, self.shares.shape[1])
        arrays = {f"normal: {name}": (getattr(self, name), shapes[name]) for name in shapes}
        if wrong := wrong_shapes(arrays):
            return wrong
        for name in ("gap", "force"):
            value = getattr(self, name)
            if np.any(~np.isfinite(value)) or np.any(value < 0.0):
                wrong.append(f"normal: {name}: must be finite and not negative")
        if np.any(~(self.area > 0.0)) or np.any(np.isinf(self.area)):
            wrong.append("normal: area: must be finite and positive")
        if np.any(~(self.stiffness > 0.0)):
            wrong.append("normal: stiffness: must be positive (inf for rigid contact)")
        if not wrong and np.any((self.gap > 0.0) & (self.force > 0.0)):
            wrong.append("normal: a point with a gap at rest cannot carry a normal force")
        return wrong

    @cached_property
    def rigid(self) -> BoolArray:
        """Whether each pressure point is rigid, (q,)."""
        return np.asarray(np.isinf(self.stiffness))

    def closed_motions(self) -> sparse.csc_array:
        """Motions, (n, k), in which all rigid points that are pressed at rest stay closed.

        Columns are unit vectors, but for the motions of unknowns that pressed points and others
        average together, which are orthonormal.
        """
        N = sparse.csr_array(self.N)
        held = N[np.flatnonzero((self.force > 0.0) & self.rigid)]
        touched = np.unique(held.indices[held.data != 0.0])
        n = N.shape[1]
        free = sparse.csc_array(sparse.eye_array(n))[:, np.setdiff1d(np.arange(n), touched)]
        if touched.size <= held.shape[0]:
            return free
        Q = linalg.qr(held[:, touched].T.toarray())[0]
        others = selection(touched, n).T @ sparse.csc_array(Q[:, held.shape[0] :])
        return sparse.csc_array(sparse.hstack([free, others]))

    @property
    def springs(self) -> sparse.csc_array:
        """Stiffness, (n, n), N/m, of elastic points that are pressed at rest, while they are."""
        return self.with_springs(np.where(self.rigid | (self.force <= 0.0), 0.0, self.stiffness))

    def with_springs(self, stiffness: FloatArray) -> sparse.csc_array:
        """Stiffness, (n, n), N/m, of springs of a ``stiffness`` (q,) at all pressure points."""
        N = sparse.csr_array(self.N)
        return sparse.csc_array(N.T @ sparse.diags_array(stiffness) @ N)

    def opposed(self, K: Matrix) -> FloatArray:
        """Stiffness, (q,), N/m, that a structure opposes to the approach of single points."""
        N = sparse.csr_array(self.N)
        diagonal = np.asarray(K.diagonal())
        compliance = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
        of_points = np.asarray((N * N) @ compliance)
        own = np.divide(1.0, of_points, out=np.zeros_like(of_points), where=of_points > 0.0)
        return np.asarray(own)

    def among(self, moves: IntArray) -> NormalPart:
        """Of nodes each of which has its pressure point, those with some numbers.

        ``N`` has a column for each node.
        """
        values = {x: getattr(self, x)[moves] for x in ("gap", "force", "stiffness", "area")}
        return NormalPart(sparse.csr_array(sparse.csc_array(self.N)[:, moves])[moves], **values)

    def in_unknowns(self, T: Matrix) -> NormalPart:
        """Same contact in the unknowns q of u = T q."""
        N = self.N @ T
        if sparse.issparse(N):
            N = sparse.csr_array(N)
            N.data[np.abs(N.data) < 1e-14] = 0.0
            N.eliminate_zeros()
        return replace(self, N=N)

    def merged(self, shares: sparse.csr_array) -> NormalPart:
        """Contact whose pressure points are means of present ones, with ``shares`` (k, q).

        Forces, stiffness and areas are summed. Where the shares are those of the stiffness, closed
        points together have the force that each of them would have at its own approach.
        """
        members = sparse.csr_array(shares > 0.0).astype(float)
        return NormalPart(
            N=shares @ self.N,
            gap=shares @ self.gap,
            force=members @ self.force,
            stiffness=members @ self.stiffness,
            area=members @ self.area,
            shares=shares if self.shares is None else sparse.csr_array(shares @ self.shares),
        )

    def at_all(self, values: FloatArray | BoolArray) -> FloatArray:
        """Values such as forces, (q,), shared among all pressure points of the structure."""
        return np.asarray(values if self.shares is None else self.shares.T @ values, dtype=float)

    def gaps(self, u: FloatArray) -> FloatArray:
        """Gap of each pressure point, (..., q), m, from unknowns (..., n)."""
        return np.asarray(self.gap - (self.N @ u.T).T)

    def elastic_forces(self, u: FloatArray) -> FloatArray:
        """Normal forces, (..., q), N, of points with a stiffness; zero at rigid ones."""
        over = -self.gaps(u)
        stiffness = np.where(self.rigid, 0.0, self.stiffness)
        return np.where(self.rigid, 0.0, np.maximum(self.force + stiffness * over, 0.0))

    def work_left(self, before: FloatArray, after: FloatArray, approach: FloatArray) -> float:
        """Work of forces (q,), N, that change while faces approach by (q,), m, as steps have it, J.

        The trapezoidal means of the forces do it; what elastic points store is not in it.
        """
        compressed = (after - before) / self.stiffness
        return float(0.5 * (before + after) @ (approach - compressed))

    def potential(self, u: FloatArray) -> float:
        """Energy, J, of the forces at rest and of elastic points, zero at rest.

        Bolts press the faces on each other with the forces at rest; they work as the faces move.
        """
        approach = np.asarray(self.N @ u)
        energy = -float(self.force @ approach)
        soft = ~self.rigid
        if soft.any():
            k = self.stiffness[soft]
            now, before = self.elastic_forces(u)[soft], self.force[soft]
            energy += float(((now**2 - before**2) / (2.0 * k)).sum())
        return energy
