"""Minimiser of a step's convex objective 1/2 v A v - g v + sum w psi(|v_p|) over the velocity.

A is large and sparse, or dense once everything but the contact has been condensed; psi is the
potential of the friction law, arctan or set-valued Coulomb, of each point's slip vector v_p. The
method is the truncated nonsmooth Newton method (Graeser and Kornhuber, J. Comput. Math. 27, 2009;
Graeser, Sack and Sander, Int. J. Numer. Methods Eng. 2018): points are relaxed one after another,
each with its law solved exactly, then one Newton step on all points but those that Coulomb friction
holds, and an exact search along it. Every part lowers the objective, so that the iteration
converges from any start whatever beta is; it needs no parameter. Newton's systems are solved by
conjugate gradients, preconditioned by the factor of an earlier tangent where the law acts as it did
then and by the diagonal where it does not; that factor serves for several steps.

What was tried on a plate in contact everywhere (90 % of the friction limit, 200 steps a period,
beta = 1e5, 4,200 unknowns; a solve is one with the factor):

===============================================  ===============  ============================
start and linear solver                          Newton's steps   solves and factors a step
===============================================  ===============  ============================
Newton with a search, no relaxation              9.3              9.3 and 9.3
one sweep of relaxation before each              5.2              5.2 and 5.2
three sweeps                                     4.0              4.0 and 4.0
three sweeps, factor of A kept                   5.2              49.5 and 0
three sweeps, factor of a tangent kept (8)       5.6              31.7 and 0.35
the same, given up after 4 solves instead of 8   4.8              16.3 and 1.0
===============================================  ===============  ============================

A factor costs about thirty solves. Newton's method on a parametrisation of the law's graph, so good
on chains, takes 9.0 steps and 145 solves there, up to 34 steps in one, if its scale is a tenth of
the diagonal over the friction limit and its systems are solved to 1e-3. With a scale three times as
large, or with systems solved to 0.1, it fails.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import lapack

from skfem_joint.errors import InputError
from skfem_joint.steppers_shared import factorised
from skfem_joint.system import System

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Most iterations, sweeps of relaxation in each, and trials of a search along a direction.
ITERATIONS, SWEEPS, SEARCH = 100, 3, 20
#: Newton's systems are solved to this share of their right side, in so many solves at most.
FORCING, MOST_SOLVES = 0.1, 60
#: The kept factor is given up when a system takes more solves.
PATIENCE = 8
#: Accepted round-off: so many units in the last place of the forces that are added up.
ROUND_OFF = 16 * float(np.finfo(np.float64).eps)
#: Forces, N, that count as none: products of smaller ones are lost.
NOTHING = 1e-140


@dataclass(frozen=True)
class Solution:
    """What :meth:`ContactProblem.solve` found.

    Attributes
    ----------
    v : ndarray, shape (n,)
        Velocity, m/s.
    sigma : ndarray, shape (n,)
        Normalised friction by unknown; zero off the contact.
    converged : bool
    iterations, evaluations, linear_solves, factorizations : int
        Newton steps, evaluations of the law on all points, solves with the factor kept, factors.
    residual : float
        Largest force residual, N, at the unknown ``where``.
    """

    v: FloatArray
    sigma: FloatArray
    converged: bool
    iterations: int
    evaluations: int
    linear_solves: int
    factorizations: int
    residual: float
    where: int


def _inverse(A: FloatArray) -> FloatArray:
    """Inverse of a symmetric positive definite matrix: a product is faster than two solves."""
    factor, failed = lapack.dpotrf(A, lower=1)
    if not failed:
        inverse, failed = lapack.dpotri(factor, lower=1)
    if failed:
        raise InputError("the condensed step matrix is not positive definite: is the step tiny?")
    lower = np.tril(inverse)
    return np.asarray(lower + np.tril(lower, -1).T)


def contact_unknowns(system: System) -> tuple[IntArray, IntArray]:
    """Unknowns that each contact point slips by, -1 for a second direction that it has not.

    For systems whose slip rows each pick an unknown of their own.
    """
    unknown = np.asarray(sparse.csr_array(system.B).indices, dtype=np.int64)
    row = system.first_row[:-1]
    second = np.full(row.size, -1)
    two = system.directions == 2
    second[two] = unknown[row[two] + 1]
    return unknown[row], second


class ContactProblem:
    """One matrix with its contact points, to be solved for many right sides.

    Parameters
    ----------
    A : csr_array or ndarray, shape (n, n)
        Symmetric positive definite, kg/s.
    first, second : ndarray of int, shape (m,)
        Unknowns of each contact point; ``second`` is -1 where it slips in one direction.
    w, beta : ndarray, shape (m,)
        Friction limit, N, and scaling constant, s/m (``inf``: Coulomb).
    """

    def __init__(
        self,
        A: Any,
        first: IntArray,
        second: IntArray,
        w: FloatArray,
        beta: FloatArray,
    ) -> None:
        n = A.shape[0]
        self.A, self.sizes = A, abs(A)
        self.factor: Callable[[FloatArray], FloatArray] | None = None
        self.factorizations = 0
        free = np.ones(n, dtype=bool)
        free[first] = False
        free[second[second >= 0]] = False
        others = np.flatnonzero(free)
        # Unknowns off the contact are relaxed like points without friction.
        self.first = np.concatenate([first, others]).astype(np.int64)
        self.second = np.concatenate([second, np.full(others.size, -1)]).astype(np.int64)
        order = np.argsort(self.first, kind="stable")
        self.first, self.second = self.first[order], self.second[order]
        self.w = np.concatenate([w, np.zeros(others.size)])[order]
        self.beta = np.concatenate([beta, np.ones(others.size)])[order]
        self.block = np.zeros((n, 3))[: self.first.size]
        self.diagonal = diagonal = A.diagonal()
        self.added = np.zeros(n)
        self.block[:, 0] = diagonal[self.first]
        both = self.second >= 0
        i, j = self.first[both], self.second[both]
        self.block[both, 1] = np.asarray(A[i, j]).ravel()
        self.block[both, 2] = diagonal[j]
        self.points = self.first, self.second
        self.law = self.w, self.beta

    def solve(
        self, g: FloatArray, start: FloatArray, tolerance: float, force: float = 0.0
    ) -> Solution:
        """Velocity at which A v + friction = g, from the velocity ``start``.

        Parameters
        ----------
        g : ndarray, shape (n,)
            Right side, N.
        tolerance : float
            Largest force residual relative to the largest force.
        force : float, optional
            Largest force besides those of ``g``, N.

        Returns
        -------
        Solution
            Not converged where anything is not finite.
        """
        from skfem_joint import kernels_contact as kernels

        scale = max(float(np.abs(g).max()), force)
        v = start.copy() if scale > NOTHING else np.zeros_like(start)
        sigma = np.zeros(v.size)
        held = np.zeros(v.size, dtype=np.bool_)
        tangents = np.zeros_like(self.block)
        factorizations, evaluations, solves = self.factorizations, 0, 0
        residual, where, converged = np.inf, 0, False
        for iteration in range(ITERATIONS):
            for sweep in range(SWEEPS):
                self._sweep(g, v, bool((sweep + iteration) % 2))
            Av = self.A @ v
            r = g - Av
            residual, where = kernels.subtract_friction(*self.points, *self.law, v, r, sigma, held)
            evaluations += SWEEPS + 1
            if not np.isfinite(residual):
                break
            converged = residual <= max(tolerance * scale, NOTHING) or (
                residual <= 1e-6 * scale and residual <= self._round_off(v, g)
            )
            if converged:
                break
            kernels.tangent(*self.points, *self.law, v, tangents)
            r[held] = 0.0
            d, more = self._newton_direction(r, tangents, held)
            solves += more
            length, trials = self._search(v, d, g, Av)
            evaluations += trials
            v += length * d
        factorizations = self.factorizations - factorizations
        return Solution(
            v, sigma, converged, iteration, evaluations, solves, factorizations, residual, where
        )

    def forget(self) -> None:
        """Drop the factor kept: what follows does not depend on what went before."""
        self.factor = None

    def _sweep(self, g: FloatArray, v: FloatArray, backward: bool) -> None:
        from skfem_joint import kernels_contact as kernels

        rest = (*self.points, self.block, *self.law, g, v, backward)
        if isinstance(self.A, np.ndarray):
            kernels.sweep_dense(self.A, *rest)
        else:
            kernels.sweep_sparse(self.A.indptr, self.A.indices, self.A.data, *rest)

    def _round_off(self, v: FloatArray, g: FloatArray) -> float:
        from skfem_joint import kernels_contact as kernels

        size = float((self.sizes @ np.abs(v)).max()) + float(np.abs(g).max())
        return ROUND_OFF * (size + float(kernels.round_off(*self.points, *self.law, v)))

    def _newton_direction(
        self, r: FloatArray, tangents: FloatArray, held: NDArray[np.bool_]
    ) -> tuple[FloatArray, int]:
        """Solve (A + tangent) d = r on the unknowns that are not held.

        The factor kept is that of an earlier tangent: conjugate gradients make up for what has
        changed, until that takes longer than to factorise again.
        """
        if not np.any(r):  # only held points are out of balance: relaxation sets them free
            return np.zeros_like(r), 0
        if self.factor is not None:
            d, solves, solved = self._conjugate_gradients(r, tangents, held, PATIENCE)
            if solved:
                return d, solves
        else:
            solves = 0
        self._factorise(tangents, held)
        d, more, _ = self._conjugate_gradients(r, tangents, held, MOST_SOLVES)
        return d, solves + more

    def _factorise(self, tangents: FloatArray, held: NDArray[np.bool_]) -> None:
        """Keep the factor of A + tangent on the unknowns that are not held."""
        self.factorizations += 1
        first, second = self.points
        both = second >= 0
        i, j = first[both], second[both]
        moving = np.flatnonzero(~held)
        if isinstance(self.A, np.ndarray):
            T = self.A.copy()
            T[first, first] += tangents[:, 0]
            T[j, j] += tangents[both, 2]
            T[i, j] += tangents[both, 1]
            T[j, i] += tangents[both, 1]
        else:
            rows = np.concatenate([first, j, i, j])
            columns = np.concatenate([first, j, j, i])
            values = np.concatenate([tangents[:, 0], tangents[both, 2], *2 * [tangents[both, 1]]])
            T = self.A + sparse.csr_array((values, (rows, columns)), shape=self.A.shape)
        if moving.size < held.size:
            T = T[moving][:, moving]
        solve = _inverse(T).__matmul__ if isinstance(T, np.ndarray) else factorised(T)
        self.added = np.full(held.size, np.inf)
        self.added[first] = tangents[:, 0]
        self.added[j] = tangents[both, 2]
        self.added[held] = np.inf

        def factor(x: FloatArray) -> FloatArray:
            y = np.zeros_like(x)
            y[moving] = solve(x[moving])
            return y

        self.factor = factor if moving.size < held.size else solve

    def _conjugate_gradients(
        self, r: FloatArray, tangents: FloatArray, held: NDArray[np.bool_], most: int
    ) -> tuple[FloatArray, int, bool]:
        """Direction, solves with the factor kept, and whether they were enough."""
        from skfem_joint import kernels_contact as kernels

        assert self.factor is not None
        first, second = self.points
        both = second >= 0
        now = np.zeros_like(r)
        now[first] = tangents[:, 0]
        now[second[both]] = tangents[both, 2]
        now += self.diagonal
        then = self.diagonal + self.added
        # The factor where the tangent is as it was, the diagonal where it is not.
        share = np.minimum(1.0, then / now)
        rest = (1.0 - np.minimum(share, now / then)) / now
        share[np.isinf(then)] = 0.0
        share[held] = rest[held] = 0.0

        def times_tangent(x: FloatArray) -> FloatArray:
            y = np.asarray(self.A @ x)
            kernels.add_blocks(*self.points, tangents, x, y)
            y[held] = 0.0
            return y

        d = np.zeros_like(r)
        left = r.copy()
        enough = FORCING * np.linalg.norm(r)
        p = np.zeros_like(r)
        before = 1.0
        for solves in range(1, most + 1):
            z = share * self.factor(share * left) + rest * left
            product = float(left @ z)
            p = z + (product / before if solves > 1 else 0.0) * p
            before = product
            image = times_tangent(p)
            step = product / float(p @ image)
            d += step * p
            left -= step * image
            if np.linalg.norm(left) <= enough:
                return d, solves, True
        return d, most, False

    def _search(
        self, v: FloatArray, d: FloatArray, g: FloatArray, Av: FloatArray
    ) -> tuple[float, int]:
        """Length along ``d`` that is the minimum, nearly, and not beyond it by much."""
        from skfem_joint import kernels_contact as kernels

        quadratic = float(d @ (self.A @ d))
        linear = float(d @ (Av - g))

        def slope(length: float) -> float:
            friction = kernels.slope(*self.points, *self.law, v, d, length)
            return linear + length * quadratic + float(friction)

        at_start = slope(0.0)
        if not at_start < 0.0:  # round-off: the direction descends
            return 1.0, 1
        low, slope_low = 0.0, at_start
        high, slope_high = np.inf, np.inf
        length = 1.0
        for trial in range(SEARCH):
            here = slope(length)
            if abs(here) <= 0.1 * abs(at_start) or (length == 1.0 and here <= 0.0):
                return length, trial + 2
            if here > 0.0:
                high, slope_high = length, here
            else:
                low, slope_low = length, here
            # The slope at `low` is negative and that at `high` positive.
            length = low - slope_low * (high - low) / (slope_high - slope_low)
            margin = 0.05 * (high - low)
            length = min(max(length, low + margin), high - margin)
        return low, SEARCH + 1
