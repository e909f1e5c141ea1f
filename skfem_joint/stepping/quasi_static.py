"""What a structure does under forces that change slowly, with Coulomb friction: no inertia.

From the state before, each increment d of the displacement solves

    minimise  1/2 d K d - (f - K u) d + sum w |B d|,

the problem of a time step with K in place of the step's matrix and the increment in place of the
velocity. Points that stick do so exactly, reversals and histories of loads come by themselves. Each
increment goes straight: slips that turn within one are not resolved. Dense systems, as reduction
makes them, have more contact points than unknowns, which cannot all stick: there Coulomb's law is
the limit of steeper and steeper ones.

Bodies that friction alone holds have no stiffness of their own: there K gets a little of M, and
forces that make everything slip are scaled back to just below what friction holds. That load is
found from the rigid motion d it sets off: by virtue of the upper bound theorem of limit analysis
sum w |B d| / f d is never below the limit, and Dinkelbach's iteration (Manag. Sci. 13, 1967)
brings it down to it.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property
from typing import cast

import numpy as np
from scipy import linalg, sparse

from skfem_joint.arrays import FloatArray, as_dense
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.linalg.factors import factorised, pivots
from skfem_joint.linalg.schur import Uncondensed
from skfem_joint.progress import Tally
from skfem_joint.stepping.arrangement import Arranged, arranged
from skfem_joint.stepping.chain import bands, build_chain, make_memory
from skfem_joint.stepping.chain_solver import passes_of
from skfem_joint.stepping.contact_problem import ContactProblem, Solution
from skfem_joint.stepping.dense import Dense, contact_of, found_alone
from skfem_joint.stepping.dense import make_memory as make_dense_memory
from skfem_joint.stepping.steppers import Condensed, Points
from skfem_joint.system import System

#: Share of the load at which everything slips that is taken where nothing else holds.
HELD = 0.98
#: A level that is not found at once is gone to in parts, halved at most this often.
HALVINGS = 6
#: Force that the added mass may carry, as a share of the load, and how much of it is added.
_SHIFTED, _SHIFT = 1e-3, 1e-12
#: Pivots below this share of the largest are zero; iterations for the friction limit; stiffness of
#: motions without strain, as a share of the mean square frequency, and most of them; share of their
#: displacement that is no slip.
_SINGULAR, _ITERATIONS, _RIGID, _MOST_RIGID, _STILL = 1e-11, 20, 1e-9, 12, 1e-6
#: Steepness of the laws that Coulomb's is the limit of in dense systems, over the largest slip, and
#: their stiffness, over the least of all, beyond which round-off hides that one.
_STEEPER, _STIFFEST = (1e2, 1e4, 1e6), 1e12
#: Steepness of the law that a path starts with, over that of its own, and the tolerance for it. (To
#: slip at once as far as a load's peak takes a plate of 20,000 unknowns 7 iterations, not 14.)
_SOFTER, _ROUGHLY = 1e-2, 0.1


class QuasiStatic:
    """Quasi-static response of one system: one matrix for all levels and histories of load.

    Parameters
    ----------
    system : System
        Its limits ``w`` count, its law and masses do not.
    tolerance : float
        Largest force residual relative to the largest force.
    tally : Tally, optional
        Takes each level that is found.

    Raises
    ------
    InputError
        If no point carries friction, or slip rows of a large sparse system depend on each other.
    """

    def __init__(self, system: System, tolerance: float = 1e-8, tally: Tally | None = None) -> None:
        self.to = arranged(system)
        inner = self.to.system
        acting = inner.w > 0.0
        if not acting.any():
            raise InputError("quasi-static slip: needs friction, no contact point carries any")
        self.tolerance, self.tally = tolerance, tally or Tally()
        dense = self.to.kind == "dense"
        self.K, self.M = (as_dense(A) if dense else as_compressed(A) for A in (inner.K, inner.M))
        self.shift = _SHIFT * inner.mean_square_frequency if is_singular(self.K) else 0.0
        # Of the unknowns that are stepped through: stiffness, what is added to it, slip rows.
        self.stiffness, self.added, self.B = self.K, self.shift * self.M, inner.B
        self.A, self.beta = as_compressed(self.K + self.added), inner.beta[acting]
        self.problem: ContactProblem | Condensed | _Dense
        self.whole: Condensed | None = None  # what is condensed
        self.condensed: Condensed | None = None  # the same, where the contact is stepped alone
        if dense:
            self.problem, self._limited = _Dense(self.A, inner), np.flatnonzero(acting)
            self._rate = self.problem.beta
        else:
            points = Points.of(inner)
            chain = self.to.kind == "chain"  # its own factors cost nothing
            self.problem = contact = (points.problem if chain else points.best_problem)(self.A)
            if isinstance(contact, Condensed):
                self.whole, points = contact, points.numbered(contact.kept)
                contact = contact.problem
                self._step_contact_alone(self.whole)
            self._limited, self._rate = np.searchsorted(contact.first, points.first), contact.beta
        self._fronts = _Fronts(self.A, inner) if self.to.kind == "chain" else None
        self.last = np.zeros(self.A.shape[0])
        self.solves = 0
        self.held_back = 0  # levels whose forces were scaled back

    def afresh(self, to: Arranged, tolerance: float | None = None) -> QuasiStatic:
        """One with the same factors that has followed nothing; ``to``: of what was arranged."""
        path = copy(self)
        path.to, path.tally = to, Tally()
        path.tolerance = self.tolerance if tolerance is None else tolerance
        path.last, path.solves, path.held_back = np.zeros_like(self.last), 0, 0
        return path

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return self.problem.factorizations

    def _step_contact_alone(self, whole: Condensed) -> None:
        """Let all else follow, unless it can move as a rigid body without slip.

        Nor where bodies can move rigidly and the contact is sparse: what is added to it is not.
        """
        rigid = self.rigid[whole.kept]
        if rigid.size:
            still = _STILL * np.abs(self.rigid).max()
            if not whole.problem.dense or np.linalg.svd(rigid, compute_uv=False).min() <= still:
                return
        self.condensed, self.problem, self.A = whole, whole.problem, whole.problem.A
        self.stiffness, self.added, self.B = self.A, 0.0 * self.A, self.B[:, whole.kept]
        if rigid.size:
            image = self.A @ rigid
            self.added = image @ np.linalg.solve(rigid.T @ image, image.T)
            self.stiffness = self.A - self.added

    def _without_friction(self) -> Callable[[FloatArray], FloatArray]:
        """Solver of A u = f."""
        if isinstance(self.problem, Condensed):
            return self.problem.solver()
        return cast("Callable[[FloatArray], FloatArray]", factorised(self.A))

    @cached_property
    def rigid(self) -> FloatArray:
        """Motions without strain, (n, r), in the unknowns of ``to.system``.

        Inverse iteration finds them at once, so small is what is added to K.
        """
        n = self.to.system.n
        if not self.shift:
            return np.zeros((n, 0))
        solve = self._without_friction()
        X = np.random.default_rng(0).normal(size=(n, min(_MOST_RIGID, n)))
        for _ in range(3):
            X = np.linalg.qr(solve(self.M @ X))[0]
        squares, shares = linalg.eigh(X.T @ (self.K @ X), X.T @ (self.M @ X))
        limit = _RIGID * self.to.system.mean_square_frequency
        return np.asarray(X @ shares[:, squares < limit])

    def stuck(self, F: sparse.csc_array) -> Callable[[FloatArray], FloatArray] | None:
        """Solver for motions that pick the unknowns of the columns of F, if it is there already."""
        if self.whole is None or self.to.maps or not np.array_equal(F.indices, self.whole.rest):
            return None
        return cast("Callable[[FloatArray], FloatArray]", self.whole.solve_interior)

    @property
    def unshifted(self) -> Uncondensed | None:
        """The stiffness, condensed, in the system's own unknowns, if it is there."""
        return None if self.shift or self.to.maps else self.whole

    def follow(
        self,
        forces: FloatArray,
        times: FloatArray | None = None,
        held: float = HELD,
        start: tuple[FloatArray, FloatArray] | None = None,
    ) -> FloatArray:
        """Displacements (levels, n), m, under forces (levels, n), N, one after another.

        Parameters
        ----------
        forces : ndarray, shape (levels, n)
        times : ndarray, shape (levels,), optional
            When each level is reached, s, from 0: the system's own law acts, which creeps.
            Coulomb's, which time does not matter to, if not given.
        held : float
            Forces that make everything slip where nothing else holds are scaled to this share of
            what friction can hold; ``inf`` leaves them as they are.
        start : tuple of ndarray, shape (n,), optional
            Displacement, m, and the force that it was reached under, N; at rest if not given.

        Raises
        ------
        ConvergenceError
            If a level does not converge.
        """
        right, inside = self.to.force(forces.T), self.condensed
        if inside is not None:
            right, still = inside.restrict(right)
        u = f = np.zeros(len(right))
        if start is not None:
            u, f = self.to.inner(start[0]), self.to.force(start[1])
            if inside is not None:
                u, f = u[inside.kept], inside.restrict(f)[0]
        path = np.empty((len(forces), u.size))
        lasting = np.zeros(len(forces)) if times is None else np.diff(times, prepend=0.0)
        for level, force in enumerate(right.T):
            before, f = f, np.ascontiguousarray(force)
            rate = np.inf if times is None else self.beta / lasting[level]
            u = path[level] = self._state(u, before, f, held, rate)
            self.tally.add()
        return self.to.outer(path if inside is None else inside.extend(path.T, still).T)

    def limit(self, force: FloatArray) -> float:
        """Multiple of the forces (N) that friction can just hold; ``inf`` where more holds."""
        self._rate[self._limited] = np.inf
        if not self.shift:
            return np.inf
        f = self.to.force(force)
        return self._limit(f if self.condensed is None else self.condensed.restrict(f)[0])

    def _state(
        self,
        u: FloatArray,
        before: FloatArray,
        f: FloatArray,
        held: float,
        rate: FloatArray | float,
        halvings: int = 0,
    ) -> FloatArray:
        """Displacement under ``f`` from ``u`` under the forces ``before``, in parts if need be."""
        self._rate[self._limited] = rate
        found = self._solve(f - self.stiffness @ u)
        if np.isfinite(held) and self._carried(found, f) > _SHIFTED:
            self.held_back += 1
            found = self._solve(min(1.0, held * self._limit(f)) * f - self.stiffness @ u)
        elif not found.converged and halvings < HALVINGS:
            middle = 0.5 * (before + f)
            rest = (held, 2.0 * rate, halvings + 1)
            return self._state(self._state(u, before, middle, *rest), middle, f, *rest)
        elif not found.converged:
            where = found.where if self.condensed is None else self.condensed.kept[found.where]
            raise ConvergenceError(
                "the slip under a slowly changing load was not found: a force residual of "
                f"{found.residual:.3g} N is left at unknown {where}"
            )
        self.last = found.v
        return u + found.v

    def _solve(self, right: FloatArray) -> Solution:
        """Increment, from a multiple of the last one: that which is best under Coulomb's law."""
        self.solves += 1
        if self._fronts is not None and np.isinf(self._rate[self._limited]).all():
            found = self._fronts.solve(right, self.tolerance)
            if found is not None:
                return found
        problem, work = self.problem, float(right @ self.last)
        stored = float(self.last @ (self.A @ self.last))
        lost = problem.objective(self.last, right) - 0.5 * stored + work
        start = self.last * (np.sign(work) * max(abs(work) - lost, 0.0) / stored if stored else 0.0)
        if problem.objective(start, right) >= 0.0:
            start = self._of_softer_law(right)
        return problem.solve(right, start, self.tolerance)

    def _of_softer_law(self, right: FloatArray) -> FloatArray:
        """Increment, roughly, under a law less steep, which few iterations find from rest."""
        start, steep = np.zeros_like(right), self._rate[self._limited]
        if isinstance(self.problem, _Dense) or np.isinf(steep).any():
            return start
        self._rate[self._limited] = _SOFTER * steep
        found = self.problem.solve(right, start, _ROUGHLY)
        self._rate[self._limited] = steep
        return found.v if self.problem.objective(found.v, right) < 0.0 else start

    def _carried(self, found: Solution, f: FloatArray) -> float:
        """Share of the load that the added mass carries."""
        if not self.shift:
            return 0.0
        carried = float(np.linalg.norm(self.added @ found.v))
        return carried / float(np.linalg.norm(f)) if carried > 0.0 else 0.0

    def _limit(self, f: FloatArray) -> float:
        """Multiple of the forces at which everything slips."""
        limit, inner = np.inf, self.to.system
        multiple, without_friction = 1.0, self._without_friction()
        for _ in range(_ITERATIONS):
            found = self._solve(multiple * f)
            if self._carried(found, multiple * f) <= _SHIFTED:
                if np.isfinite(limit):
                    return limit
                if multiple > 1e6:
                    return np.inf
                multiple *= 10.0
                continue
            rigid = without_friction(self.added @ found.v)  # without what strains
            lower = float(inner.w @ inner.slip_norm(self.B @ rigid) / (f @ rigid))
            if lower >= limit * (1.0 - 1e-6):
                return limit
            limit, multiple = lower, 1.01 * lower
        return limit


class _Dense:
    """Increments of a dense system: `ContactProblem` for points that cannot all stick."""

    factorizations = 0

    def __init__(self, A: FloatArray, system: System) -> None:
        self.A, self.B, self.system = A, as_dense(system.B), system
        self.beta = np.ones(system.w.size)
        self.contact, places = contact_of(self.B, system.first_row, system.w, self.beta)
        self.places = places.point
        sticking = (self.B.T * system.on_rows(system.w)) @ self.B
        unit = np.trace(A) / np.trace(sticking)
        sticking = A + unit * sticking
        self.first = factorised(sticking)
        softest = np.linalg.eigvalsh(sticking)[0]
        self.steepest = _STIFFEST * unit * softest / np.trace(A)
        self.memory = make_dense_memory(system.n, self.contact.w.size, system.w.size)

    def solve(self, g: FloatArray, start: FloatArray, tolerance: float) -> Solution:
        """Increment; Coulomb's law is as steep, at last, as the largest slip found asks for."""
        memory, coulomb = self.memory, np.isinf(self.beta)
        memory.velocity[:] = start if start.any() else self.first(g)
        for steepness in _STEEPER:
            slip = self.system.slip_norm(self.B @ memory.velocity).max()
            steep = min(steepness / slip, self.steepest) if slip > 0.0 else self.steepest
            self.contact.beta[self.places] = np.where(coulomb, steep, self.beta)
            memory.old_velocity[:] = v = memory.velocity.copy()
            found = found_alone(Dense(self.A, self.contact), memory, g, v, tolerance)
            if not (found.converged and coulomb.any()):
                break
        counts = {"newton_iterations": found.newton_iterations}
        v, sigma = memory.velocity.copy(), memory.force.copy()
        return Solution(v, sigma, found.converged, counts, found.residual, found.unknown)

    def objective(self, v: FloatArray, g: FloatArray) -> float:
        """1/2 v A v - g v + sum w |v_p|."""
        return float(v @ (0.5 * self.A @ v - g) + self.system.w @ self.system.slip_norm(self.B @ v))


class _Fronts:
    """Increments of a chain under Coulomb's law, from its slip fronts: no matrix is factorised."""

    def __init__(self, A: sparse.csr_array, system: System) -> None:
        limits = np.zeros(A.shape[0])
        limits[sparse.csr_array(system.B).indices] = system.w
        self.chain = build_chain(bands(A), limits, np.full(limits.size, np.inf))
        self.memory = make_memory(limits.size)

    def solve(self, right: FloatArray, tolerance: float) -> Solution | None:
        """Increment; None where the fronts are not found."""
        chain, memory = self.chain, self.memory
        limits = chain.w[: right.size]
        count, found, memory.middle[0] = passes_of(
            chain.H0, chain.H1, chain.w, limits, chain.pivot, chain.stretch, chain.kappa, right,
            memory.new_parameter, memory.velocity, memory.force, memory.work[2], memory.work[4],
            memory.middle[0], tolerance,
        )  # fmt: skip
        if not found:
            return None
        counts = {"newton_iterations": int(count)}
        return Solution(memory.velocity.copy(), memory.force.copy(), True, counts, 0.0, 0)


def is_singular(K: sparse.csr_array) -> bool:
    """Whether a positive semidefinite matrix is singular, by its smallest pivot."""
    try:
        found = pivots(K)
    except RuntimeError:  # exactly singular
        return True
    return bool(np.min(found) <= _SINGULAR * np.max(found))
