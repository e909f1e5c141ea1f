"""Frictionless unilateral contact with rigidly closed gaps, by a primal-dual active set method.

    minimise over u:   1/2 u K u - f u    with   G u <= gap

The pressures p are the multipliers. A set of closed gaps is assumed and the linear problem with
these equations is solved. Then closed gaps with a negative pressure are opened, and open gaps with
penetration are closed, until no gap changes (Hintermueller, Ito, Kunisch, SIAM J. Optim. 13,
2002). The linear problem is solved by an augmented Lagrangian: a stiff spring in each closed gap,
and iterations for the multipliers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, Matrix, as_dense
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.parts import Parts, PartwiseComplement
from skfem_joint.linalg.schur import AllKept, SchurComplement, Uncondensed, condensed

# Most sets of touching nodes that are tried.
_ACTIVE_SETS = 100
# Share of the forces that may be left out of balance.
_TOLERANCE = 1e-9
#: Most unknowns of a solution whose factor is kept for its derivatives. Two solid plates of 47,808
#: unknowns keep 170 MB (by PARDISO).
KEPT = 50_000
#: Pressures and penetrations below this part of the largest are zero.
ROUND_OFF = 1e-8


@dataclass(frozen=True)
class UnilateralContact:
    """Minimum of ``1/2 u K u - f u`` with ``G u <= gap``, or ``G u = gap`` where tied.

    Attributes
    ----------
    K : ndarray or sparse array, shape (n, n)
    G : sparse array, shape (m, n)
    area, gap : ndarray, shape (m,)
        Integrals of the hat of each node over the faces that may touch, m2, and of its hat times
        the initial gap, m3.
    tied : ndarray of bool, shape (m,)
    force : ndarray, shape (n,)
    reach : float
        Largest displacement, m, of unknowns that are eliminated, with contact held: where all of
        it closes the displacements here are round-off, and say nothing of how large any are.
    """

    K: Matrix
    G: Matrix
    area: FloatArray
    gap: FloatArray
    tied: BoolArray
    force: FloatArray
    reach: float = 0.0
    _last: list[tuple[BoolArray, Callable[[FloatArray], FloatArray]]] = field(
        init=False, repr=False, compare=False, default_factory=list
    )

    def __getstate__(self) -> dict[str, Any]:
        """Without factors, which cannot be pickled."""
        names = (f.name for f in fields(self))
        return {name: getattr(self, name) for name in names} | {"_last": []}

    @cached_property
    def penalty(self) -> FloatArray:
        """Stiffness of closed contact, Pa/m3."""
        size = abs(self.G)
        mean = np.asarray(size @ self.K.diagonal()) / np.asarray(size.sum(axis=1)).ravel()
        # So much stiffer than the elements it speeds up the iteration for the multipliers, which
        # make contact exactly rigid.
        return np.asarray(1e5 * mean / self.area**2)

    @cached_property
    def _open(self) -> Uncondensed:
        """Stiffness with contact open, condensed to the unknowns that closed contact changes."""
        # Cost of a set of touching nodes with the stiffness condensed to those in contact, ns for
        # the square and the cube of their unknowns: all are factorised, and solved for a few
        # times.
        return condensed(_shifted(self.K), np.unique(self.G.indices), (4.0, 0.0133))

    def _solver(self, active: BoolArray) -> Callable[[FloatArray], FloatArray]:
        """Solver with given contact closed, (m,); the last one is kept."""
        known = self._kept_solver(active)
        if known is None:
            self._last.clear()  # two factors at once may be too large
            known = self._open.solver(self._springs(active))
            self._last.append((active.copy(), known))
        return known

    def _kept_solver(self, active: BoolArray) -> Callable[[FloatArray], FloatArray] | None:
        """The last solver, if it was for the same contact."""
        same = (solve for closed, solve in self._last if np.array_equal(closed, active))
        return next(same, None)

    def _springs(self, active: BoolArray) -> sparse.csr_array:
        """Stiffness of closed contact, (n, n)."""
        G = self.G[active]
        return sparse.csr_array(G.T @ sparse.diags_array(self.penalty[active]) @ G)

    def solve(
        self,
        first: BoolArray | None = None,
        progress: Progress = silent,
        parts: Parts | None = None,
    ) -> tuple[FloatArray, FloatArray, BoolArray, int]:
        """Displacement (m), pressure (Pa), what is closed, and the number of sets tried.

        ``first`` (m,) is what is tried as closed first, everything if not given. ``progress`` is
        called with the number of sets tried, 0, and a note, after each of them. With ``parts`` all
        is found on the unknowns in contact alone, to which these are condensed: the stiffness of
        the others must have a factor while those in contact are held.
        """
        if parts is not None:
            kept = np.unique(self.G.indices).astype(np.intp)
            inside = PartwiseComplement(self.K, kept, parts)
            inner, interior = self._of_kept(inside)
            inner = replace(inner, K=as_dense(inner.K))
            u, p, active, count = inner.solve(first, progress)
            return inside.extend(u, interior), p, active, count
        active = np.ones(self.area.size, dtype=bool) if first is None else first | self.tied
        u, p, count = np.zeros(self.force.size), np.zeros(self.area.size), 0
        if isinstance(self._open, SchurComplement):
            # The sets are found with the stiffness that is factorised, on the unknowns of contact
            # alone: without a solution for the others. What its shift changes is corrected then.
            inner, interior = self._of_kept(self._open)
            vars(inner).update(penalty=self.penalty, _open=AllKept(inner.K))
            z = np.zeros(inner.force.size)
            z, p, active, count = inner._searched(active, z, p, progress, 0)
            u = self._open.extend(z, interior)
            self._last[:] = [(closed, self._open.by(kept)) for closed, kept in inner._last]
        return self._searched(active, u, p, progress, count)

    def _of_kept(
        self, inside: SchurComplement | PartwiseComplement
    ) -> tuple[UnilateralContact, FloatArray]:
        """The same on the unknowns of contact, and what extends its solution to the others."""
        force, interior = inside.restrict(self.force)
        reach = float(np.abs(inside.extend(np.zeros(force.size), interior)).max())
        G = sparse.csr_array(self.G)[:, inside.kept]
        return replace(self, K=inside.complement, G=G, force=force, reach=reach), interior

    def _searched(
        self, active: BoolArray, u: FloatArray, p: FloatArray, progress: Progress, tried: int
    ) -> tuple[FloatArray, FloatArray, BoolArray, int]:
        """See `solve`; the search goes on from some values, with the last of the sets tried."""
        force, gap = self.force[:, None], self.gap[:, None]
        of_u, of_p, seen = u[:, None], p[:, None], set[bytes]()
        for count in range(max(tried, 1), _ACTIVE_SETS + 1):
            of_u, of_p, left = self._balanced(active, self._solver(active), force, gap, of_u, of_p)
            u, p = of_u[:, 0], of_p[:, 0]
            opening = self.gap - self.G @ u
            largest = max(np.abs(u).max(), self.reach, np.abs(self.gap / self.area).max())
            moved = self.area * largest
            pulls = active & ~self.tied & (p < -ROUND_OFF * np.abs(p).max())
            enters = ~active & (opening < -ROUND_OFF * moved)
            wrong = np.flatnonzero(pulls | enters)
            if count > tried:
                progress(count, 0, f"{wrong.size} of {self.area.size} pressure points still change")
            if not wrong.size and left < _TOLERANCE:
                return u, np.maximum(p, 0.0), active, count
            if not wrong.size:
                raise ConvergenceError(
                    f"preload: a share of {left:.2g} of the clamp forces is left out of balance; "
                    "do supports and contact hold every body?"
                )
            # If a set comes again, change one node at a time (Murty, Opsearch 11, 1974).
            flipped = wrong[-1:] if active.tobytes() in seen else wrong
            seen.add(active.tobytes())
            active[flipped] ^= True
        raise ConvergenceError(
            f"preload: the nodes that touch were not found in {_ACTIVE_SETS} tries; "
            f"{wrong.size} of {self.area.size} still change; refine the mesh of the pressed faces, "
            "or see whether bodies are held"
        )

    def _balanced(
        self,
        active: BoolArray,
        solve: Callable[[FloatArray], FloatArray],
        force: FloatArray,
        gap: FloatArray,
        u: FloatArray,
        p: FloatArray,
    ) -> tuple[FloatArray, FloatArray, float]:
        """Displacements (n, k) and pressures (m, k) for closed contact, by an augmented Lagrangian.

        A solution under forces (n, k), with gaps (m, k), is corrected with the same factor until
        the residual is round-off. The third value returned is the residual as a share of the
        forces.
        """
        G, penalty, area = self.G[active], self.penalty[active, None], self.area[active, None]
        G_T, gap = sparse.csr_array(G.T), gap[active]
        largest = np.abs(force).max(axis=0)
        p, left, last = p[active], np.inf, np.inf
        for _ in range(20):
            r, apart = force - self.K @ u - G_T @ p, gap - G @ u
            bearing = np.where(largest > 0.0, largest, np.abs(G_T @ p).max(axis=0))
            left = float((np.abs(r).max(axis=0) / np.where(bearing > 0.0, bearing, 1.0)).max())
            if apart.size and (u.any() or apart.any()):
                # Before anything has moved, the gaps themselves are the measure.
                first = 0.0 if u.any() else np.abs(gap / area).max()
                least = max(self.reach, np.finfo(float).tiny, first)
                moved = np.abs(u).max(axis=0, initial=least)
                left += float((np.abs(apart / area) / moved).max())
            # It is corrected until little is left, or until that falls no further.
            if left < 1e-13 or (left > 0.5 * last and left < _TOLERANCE):
                break
            last = min(last, left)
            du = solve(r + G_T @ (penalty * apart))
            u, p = u + du, p + penalty * (G @ du - apart)
        whole = np.zeros((active.size, p.shape[1]))
        whole[active] = p
        return u, whole, left

    def rates(
        self, active: BoolArray, force_rates: FloatArray, gap_rates: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of displacement, (n, k), and pressure, (m, k), while the same is closed.

        One factor serves all parameters: that of `solve`, if it was called before and ended with
        what is closed. Else the whole stiffness has a factor: to condense it first pays only for
        several sets of what is closed.

        Parameters
        ----------
        active : ndarray of bool, shape (m,)
            What is closed, from `solve`.
        force_rates : ndarray, shape (n, k)
            Derivatives of the forces by k parameters.
        gap_rates : ndarray, shape (m, k)
            Derivatives of the initial gaps times areas.

        Raises
        ------
        ConvergenceError
            If forces are left out of balance.
        """
        solve = self._kept_solver(active)
        if solve is None:
            solve = factorised(sparse.csr_array(_shifted(self.K) + self._springs(active)))
        u, p = np.zeros(force_rates.shape), np.zeros((active.size, force_rates.shape[1]))
        u, p, left = self._balanced(active, solve, force_rates, gap_rates, u, p)
        if left >= _TOLERANCE:
            raise ConvergenceError(
                f"derivatives of the preload: a share of {left:.2g} of the forces is left out of "
                "balance; do supports and contact hold every body?"
            )
        return u, p


def _shifted(K: Matrix) -> Matrix:
    """Stiffness with a share of its diagonal, which has a factor also where bodies are loose."""
    # Share of the stiffness' diagonal that is added before factorisation, because K is singular
    # while too few nodes touch to support every body.
    added = 1e-10 * K.diagonal()
    if isinstance(K, np.ndarray):
        return K + np.diag(added)
    return sparse.csr_array(K + sparse.diags_array(added))
