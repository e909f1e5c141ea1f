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
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, Matrix
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.schur import Uncondensed, condensed


@dataclass(frozen=True)
class ActiveSetSettings:
    """Numbers of the contact solve.

    Attributes
    ----------
    stiffness : float
        Stiffness of closed contact over that of the elements. It speeds up the iteration for the
        multipliers, which make contact exactly rigid.
    active_sets : int
        Most sets of touching nodes that are tried.
    corrections : int
        Most corrections of a solution.
    tolerance : float
        Shares of the forces that may be left out of balance, and that are not corrected further.
    kept : int
        Most unknowns of a solution whose factor is kept for its derivatives. Two solid plates of
        47,808 unknowns keep 170 MB (by PARDISO).
    round_off : float
        Pressures and penetrations below this part of the largest are zero.
    """

    stiffness: float = 1e5
    active_sets: int = 100
    corrections: int = 20
    tolerance: float = 1e-9
    kept: int = 50_000
    round_off: float = 1e-8


SETTINGS = ActiveSetSettings()


@dataclass(frozen=True)
class UnilateralContact:
    """Minimum of ``1/2 u K u - f u`` with ``G u <= gap``, or ``G u = gap`` where tied.

    Attributes
    ----------
    K : sparse array, shape (n, n)
    G : sparse array, shape (m, n)
    area, gap : ndarray, shape (m,)
        Integrals of the hat of each node over the faces that may touch, m2, and of its hat times
        the initial gap, m3.
    tied : ndarray of bool, shape (m,)
    force : ndarray, shape (n,)
    """

    K: Matrix
    G: Matrix
    area: FloatArray
    gap: FloatArray
    tied: BoolArray
    force: FloatArray
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
        return np.asarray(SETTINGS.stiffness * mean / self.area**2)

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
        self, first: BoolArray | None = None, progress: Progress = silent
    ) -> tuple[FloatArray, FloatArray, BoolArray, int]:
        """Displacement (m), pressure (Pa), what is closed, and the number of sets tried.

        ``first`` (m,) is what is tried as closed first, everything if not given. ``progress`` is
        called with the number of sets tried, 0, and a note, after each of them.
        """
        active = np.ones(self.area.size, dtype=bool) if first is None else first | self.tied
        u, p = np.zeros(self.force.size), np.zeros(self.area.size)
        seen: set[bytes] = set()
        for count in range(1, SETTINGS.active_sets + 1):
            u, p, left = self._with_closed(active, u, np.where(active, p, 0.0))
            opening = self.gap - self.G @ u
            moved = self.area * max(np.abs(u).max(), np.abs(self.gap / self.area).max())
            pulls = active & ~self.tied & (p < -SETTINGS.round_off * np.abs(p).max())
            enters = ~active & (opening < -SETTINGS.round_off * moved)
            wrong = np.flatnonzero(pulls | enters)
            progress(count, 0, f"{wrong.size} of {self.area.size} pressure points still change")
            if not wrong.size and left < SETTINGS.tolerance:
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
            f"preload: the nodes that touch were not found in {SETTINGS.active_sets} tries; "
            f"{wrong.size} of {self.area.size} still change; refine the mesh of the pressed faces, "
            "or see whether bodies are held"
        )

    def _with_closed(
        self, active: BoolArray, u: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Displacement and pressure for a given set of closed contact, by an augmented Lagrangian.

        The solution is corrected with the same factor until the residual is round-off. The third
        value returned is the residual as a share of the clamp forces.
        """
        G, penalty, gap = self.G[active], self.penalty[active], self.gap[active]
        solve = self._solver(active)
        p, last = p[active], np.inf
        for _ in range(SETTINGS.corrections):
            r, apart = self.force - self.K @ u - G.T @ p, gap - G @ u
            left = float(np.abs(r).max() / np.abs(self.force).max())
            if apart.size and u.any():
                left += float(np.abs(apart / self.area[active]).max() / np.abs(u).max())
            if _balanced(left, last):
                break
            last = min(last, left)
            du = solve(r + G.T @ (penalty * apart))
            u, p = u + du, p + penalty * (G @ du - apart)
        whole = np.zeros(active.size)
        whole[active] = p
        return u, whole, left

    def rates(self, active: BoolArray, force_rates: FloatArray) -> tuple[FloatArray, FloatArray]:
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

        Raises
        ------
        ConvergenceError
            If forces are left out of balance.
        """
        G, penalty = self.G[active], self.penalty[active, np.newaxis]
        G_T = sparse.csr_array(G.T)
        solve = self._kept_solver(active)
        if solve is None:
            solve = factorised(sparse.csr_array(_shifted(self.K) + self._springs(active)))
        size = np.abs(force_rates).max(axis=0)
        force = force_rates / np.where(size > 0.0, size, 1.0)
        u, p, last, left = np.zeros(force.shape), np.zeros((len(penalty), size.size)), np.inf, 0.0
        for _ in range(SETTINGS.corrections):
            r, apart = force - self.K @ u - G_T @ p, -(G @ u)
            left = float(np.abs(r).max(initial=0.0))
            if apart.size and u.any():
                moved = np.abs(u).max(axis=0, initial=np.finfo(float).tiny)
                left += float((np.abs(apart / self.area[active, np.newaxis]) / moved).max())
            if _balanced(left, last):
                break
            last = min(last, left)
            du = solve(r + G_T @ (penalty * apart))
            u, p = u + du, p + penalty * (G @ du - apart)
        if left >= SETTINGS.tolerance:
            raise ConvergenceError(
                f"derivatives of the preload: a share of {left:.2g} of the forces is left out of "
                "balance; do supports and contact hold every body?"
            )
        whole = np.zeros((active.size, size.size))
        whole[active] = p
        return u * size, whole * size


def _balanced(left: float, before: float) -> bool:
    """Whether a share of the forces is so small that it is not corrected, or falls no further."""
    # Share of the forces that is not corrected further.
    return left < 1e-13 or (left > 0.5 * before and left < SETTINGS.tolerance)


def _shifted(K: Matrix) -> sparse.csr_array:
    """Stiffness with a share of its diagonal, which has a factor also where bodies are loose."""
    # Share of the stiffness' diagonal that is added before factorisation, because K is singular
    # while too few nodes touch to support every body.
    return sparse.csr_array(K + 1e-10 * sparse.diags_array(K.diagonal()))
