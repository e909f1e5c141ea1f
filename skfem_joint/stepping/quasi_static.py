"""Quasi-static response to slowly changing forces under Coulomb friction, without inertia.

From the state before, each increment d of the displacement solves

    minimise  1/2 d K d - (f - K u) d + sum w |B d|,

the step problem with the stiffness for its matrix and the increment for its unknown
(:mod:`skfem_joint.minimise.problem`). Points that stick do so exactly; reversals and histories of
loads need no special treatment. Within an increment the direction of slip is constant: increments
must be short enough to resolve how it turns. Dense systems, which come from reduction, have more
contact points than unknowns, so that not all points can stick: there Coulomb's law is approached by
ever steeper laws.

Springs in series with friction stretch before sliders slip. Their forces are part of the state, as
friction over its limit, and follow from one level to the next.

Bodies that friction alone holds have a singular stiffness. A little of the mass is added to it, and
forces that would make everything slip are scaled back to just below what friction holds. That limit
is found from the rigid motion d that a load sets off: by the upper bound theorem of limit analysis
sum w |B d| / f d is never below the limit, and Dinkelbach's iteration (Manag. Sci. 13, 1967)
decreases it to the limit. The motion in which everything slips strains nothing: where the rigid
motions are known the limit is their least ratio, which repeated least squares find without a solve.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Self, cast

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import aslinearoperator

from skfem_joint.arrays import FloatArray, as_dense
from skfem_joint.errors import ConvergenceError, InputError, JointError
from skfem_joint.linalg import shifts
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.schur import SchurComplement
from skfem_joint.minimise.choice import step_problem
from skfem_joint.minimise.problem import ContactPoints, Minimum, StepProblem
from skfem_joint.modes import is_singular
from skfem_joint.progress import Tally
from skfem_joint.stepping.arrangement import Arranged, arranged
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.minimise.condensed_newton import CondensedNewton


@dataclass(frozen=True)
class QuasiStaticSettings:
    """Numbers of quasi-static paths.

    Attributes
    ----------
    limit_share : float
        Share of the friction limit to which loads are scaled back where friction alone holds.
    given_back : int
        Most times that a level is solved again to take the added mass out of it.
    halvings : int
        A level that does not converge at once is reached in parts, halved at most this often.
    carried : float
        Share of the load that the added mass may carry before everything counts as slipping.
    limit_iterations : int
        Most iterations for the friction limit.
    least_squares : int
        Most repetitions of least squares for it.
    settled : float
        It is found when a repetition lowers it by no more than this share.
    rigid : float
        Motions whose stiffness over mass is below this share of the mean square frequency are
        rigid.
    most_rigid : int
        Most rigid motions.
    still : float
        Share of a rigid motion's displacement that is no slip.
    """

    limit_share: float = 0.98
    given_back: int = 4
    halvings: int = 6
    carried: float = 1e-3
    limit_iterations: int = 20
    least_squares: int = 200
    settled: float = 1e-9
    rigid: float = 1e-9
    most_rigid: int = 12
    still: float = 1e-6


SETTINGS = QuasiStaticSettings()


class Increment(NamedTuple):
    """A level that `QuasiStatic.increment` has tried.

    Attributes
    ----------
    u : ndarray, shape (n,)
        Displacement, m.
    friction : ndarray, shape (rows,)
        Friction force of each slip row, N.
    found : Minimum
        Whether the minimisation converged, and its work.
    carried : float
        Share of the load that the added mass carries, or that is not given back of it; it is zero
        where supports hold.
    """

    u: FloatArray
    friction: FloatArray
    found: Minimum
    carried: float

    @property
    def beyond(self) -> bool:
        """Whether the level has no solution: friction does not hold the loads."""
        return self.carried > SETTINGS.carried


class QuasiStatic:
    """Quasi-static response of one system: one matrix for all levels and histories of load.

    Parameters
    ----------
    system : System
        Its limits ``w`` count, its law and masses do not.
    tolerance : float
        Largest force residual relative to the largest force.
    tally : Tally, optional
        Counts the levels that are solved.
    frictionless : bool
        Whether a system without friction is taken too, which is linear.

    Raises
    ------
    InputError
        If no point carries friction, or slip rows of a large sparse system depend on each other.
    """

    def __init__(
        self,
        system: System,
        tolerance: float = 1e-8,
        tally: Tally | None = None,
        frictionless: bool = False,
    ) -> None:
        self.to = arranged(system)
        inner = self.to.system
        if not inner.contact_points and not frictionless:
            raise InputError("quasi-static slip: needs friction, no contact point carries any")
        self.tolerance, self.tally = tolerance, tally or Tally()
        dense = self.to.kind == "dense"
        self.K, self.M = (as_dense(A) if dense else as_compressed(A) for A in (inner.K, inner.M))
        self.shift = 0.0
        if is_singular(self.K):
            self.shift = shifts.SETTINGS.least * inner.mean_square_frequency
        # Of the unknowns that are stepped through: stiffness, what is added to it, slip rows.
        self.stiffness, self.added, self.B = self.K, self.shift * self.M, inner.B
        self.A, self.beta = as_compressed(self.K + self.added), inner.beta
        # Friction over its limit at the last level, by slip row.
        self.sigma = np.zeros(inner.B.shape[0])
        self.acting: Any = slice(None)  # slip rows of the problem
        self.problem: StepProblem = step_problem(self.A, ContactPoints.of(inner), self.to.kind)
        self.whole: CondensedNewton | None = None  # the problem, where it is condensed
        self.condensed: SchurComplement | None = None  # where the contact is stepped alone
        if self.to.kind == "contact":
            from skfem_joint.minimise.condensed_newton import CondensedNewton  # loads the compiler

            if isinstance(self.problem, CondensedNewton):
                self.whole = self.problem
                self._step_contact_alone(self.whole)
        self.last = np.zeros(self.A.shape[0])
        self.frictions = np.zeros((0, inner.B.shape[0]))
        self.solves = 0
        self.scaled_back = 0  # levels whose forces were scaled back

    def afresh(self, to: Arranged, tolerance: float | None = None) -> Self:
        """Copy at rest that reuses the factorisations; ``to`` maps to the caller's unknowns."""
        path = copy(self)
        path.to, path.tally = to, Tally()
        path.tolerance = self.tolerance if tolerance is None else tolerance
        path.last, path.solves, path.scaled_back = np.zeros_like(self.last), 0, 0
        path.sigma = np.zeros_like(self.sigma)
        return path

    def with_limits(self, w: FloatArray) -> Self:
        """Copy at rest with other friction limits (m,), N, zero where they were zero.

        Factors of the stiffness are used again.
        """
        return self.limited(replace(self.to, system=replace(self.to.system, w=w)))

    def limited(self, to: Arranged) -> Self:
        """Copy at rest for a system that differs in friction limits, springs and damping alone.

        Limits are zero where they were zero. Factors of the stiffness are used again.
        """
        path = self.afresh(to)
        points = ContactPoints.of(path.to.system)
        if self.whole is None:
            path.problem = step_problem(self.A, points, self.to.kind)
            return path
        path.whole = self.whole.with_limits(points)
        path.problem = path.whole if self.condensed is None else path.whole.contact
        return path

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return self.problem.factorizations

    def _step_contact_alone(self, whole: CondensedNewton) -> None:
        """Iterate on contact unknowns only, unless a rigid motion without slip exists.

        Neither is it done where bodies can move rigidly and the contact is sparse: the projection
        that is added to it is dense.
        """
        kept, contact = whole.schur.kept, whole.contact
        rigid = self.rigid[kept]
        if rigid.size:
            still = SETTINGS.still * np.abs(self.rigid).max()
            more = rigid.shape[1] > rigid.shape[0]  # than contact unknowns
            slips = not more and np.linalg.svd(rigid, compute_uv=False).min() > still
            if not contact.dense or not slips:
                return
        self.condensed, self.problem, self.A = whole.schur, contact, contact.H
        acting = self.to.system.w > 0.0
        self.beta, self.acting = self.beta[acting], np.repeat(acting, self.to.system.directions)
        self.B = self.B[:, kept]
        self._spare_rigid(rigid)

    def spare_rigid(self) -> None:
        """Let what is added to K act on all but rigid motions, at every level in full.

        The forces of a level, (K + shift M) u + B^T f = F, are known from u then, which those of
        the last increment alone would not be.
        """
        if self.shift and self.condensed is None:
            self._spare_rigid(self.rigid)

    def _spare_rigid(self, rigid: FloatArray) -> None:
        """Take what is added to K from each level's forces for rigid motions alone, (n, r)."""
        image = self.A @ rigid
        among = np.linalg.solve(rigid.T @ image, image.T)
        self.added = aslinearoperator(image) @ aslinearoperator(among)
        self.stiffness = aslinearoperator(self.A) - self.added

    def _without_friction(self) -> Callable[[FloatArray], FloatArray]:
        """Solver of A u = f."""
        if self.whole is not None and self.condensed is None:
            return self.whole.schur.solver()
        return cast("Callable[[FloatArray], FloatArray]", factorised(self.A))

    @cached_property
    def rigid(self) -> FloatArray:
        """Rigid motions, (n, r), in the unknowns of ``to.system``.

        Inverse iteration finds them in a few steps, because so little is added to K.
        """
        n = self.to.system.n
        if not self.shift:
            return np.zeros((n, 0))
        solve = self._without_friction()
        X = np.random.default_rng(0).normal(size=(n, min(SETTINGS.most_rigid, n)))
        for _ in range(3):
            X = np.linalg.qr(solve(self.M @ X))[0]
        squares, shares = linalg.eigh(X.T @ (self.K @ X), X.T @ (self.M @ X))
        limit = SETTINGS.rigid * self.to.system.mean_square_frequency
        return np.asarray(X @ shares[:, squares < limit])

    def stuck(self, F: sparse.csc_array) -> Callable[[FloatArray], FloatArray] | None:
        """Solver for the unknowns that the columns of F pick, if their factor exists already."""
        if self.whole is None or self.to.maps:
            return None
        schur = self.whole.schur
        if not np.array_equal(F.indices, schur.interior):
            return None
        return cast("Callable[[FloatArray], FloatArray]", schur.solve_interior)

    @property
    def unshifted(self) -> SchurComplement | None:
        """Schur complement of the stiffness in the system's own unknowns, if it exists already."""
        return None if self.shift or self.to.maps or self.whole is None else self.whole.schur

    def follow(
        self,
        forces: FloatArray,
        times: FloatArray | None = None,
        limit_share: float = SETTINGS.limit_share,
        start: tuple[FloatArray, ...] | None = None,
    ) -> FloatArray:
        """Displacements (levels, n), m, under forces (levels, n), N, one after another.

        Parameters
        ----------
        forces : ndarray, shape (levels, n)
        times : ndarray, shape (levels,), optional
            When each level is reached, s, from 0: the system's own law acts, which creeps.
            Coulomb's, which time does not matter to, if not given.
        limit_share : float
            Where friction alone holds, forces that would make everything slip are scaled to this
            share of what friction can hold; ``inf`` leaves them as they are.
        start : tuple of ndarray, shape (n,), optional
            Displacement, m, and the force that it was reached under, N; at rest if not given. Where
            friction has springs in series, also the friction over its limit at it, (rows,), as
            `friction_of` has it; without that the springs are without force.

        Raises
        ------
        ConvergenceError
            If a level does not converge, or what friction can hold is not found.
        """
        right, inside = self.to.force(forces.T), self.condensed
        if inside is not None:
            right, interior = inside.restrict(right)
        u = f = np.zeros(len(right))
        self.sigma = np.zeros_like(self.sigma)
        self.frictions = np.zeros((len(forces), self.sigma.size))
        if start is not None:
            if len(start) > 2:
                self.sigma = np.array(start[2])
            u, f = self.to.inner(start[0]), self.to.force(start[1])
            if inside is not None:
                u, f = u[inside.kept], inside.restrict(f)[0]
        path = np.empty((len(forces), u.size))
        lasting = np.zeros(len(forces)) if times is None else np.diff(times, prepend=0.0)
        for level, force in enumerate(right.T):
            before, f = f, np.ascontiguousarray(force)
            rate = np.full(self.beta.size, np.inf) if times is None else self.beta / lasting[level]
            u = path[level] = self._state(u, before, f, limit_share, rate)
            self.frictions[level] = self.sigma
            self.tally.add()
        return self.to.outer(path if inside is None else inside.extend(path.T, interior).T)

    def increment(self, u: FloatArray, f: FloatArray, friction: FloatArray) -> Increment:
        """One level by Coulomb's law, in one part, with its friction and without scaling back.

        Where the contact is stepped alone, the added mass acts on all but rigid motions at first.
        The level is then solved again with the mass' force given back, until that hardly changes.

        Parameters
        ----------
        u : ndarray, shape (n,)
            Displacement of the level before, m, in the unknowns of ``to.system``.
        f : ndarray, shape (n,)
            Forces of the level, N, on these unknowns.
        friction : ndarray, shape (rows,)
            Friction force of the level before, N, which counts where springs are in series.
        """
        tried = self._increment(u, f, friction)
        if self.condensed is None or not self.shift:
            return tried
        for _ in range(SETTINGS.given_back):
            if not tried.found.converged or tried.beyond:
                break
            again = self._increment(u, f, friction, self.shift * (self.M @ tried.u))
            counts = {
                name: n + again.found.counts.get(name, 0) for name, n in tried.found.counts.items()
            }
            tried = again._replace(found=replace(again.found, counts=counts))
            if tried.carried <= self.tolerance:
                break
        return tried

    def _increment(
        self, u: FloatArray, f: FloatArray, friction: FloatArray, given: FloatArray | None = None
    ) -> Increment:
        """As `increment`; with the forces ``given`` back, (n,), for those of the added mass, N."""
        system, inside = self.to.system, self.condensed
        limits = system.on_rows(system.w)
        before = np.divide(friction, limits, out=np.zeros_like(limits), where=limits > 0.0)
        right, start, interior = f, u, f[:0]
        if inside is not None:
            right, interior = inside.restrict(f if given is None else f + given)
            start = u[inside.kept]
        held = self.stiffness if given is None else self.A
        driving = right - held @ start  # of an unloaded level it is the larger one
        found = self._minimise(driving, np.full(self.beta.size, np.inf), before)
        after = start + found.v
        if inside is None:
            new = limits * found.sigma
        else:
            after, new = inside.extend(after, interior), np.zeros_like(limits)
            new[self.acting] = limits[self.acting] * found.sigma
            found = replace(found, where=int(inside.kept[found.where]))
        largest = max(right, driving, key=lambda force: float(np.linalg.norm(force)))
        carried = self._carried(found, largest)
        if given is not None:
            carried = _share(self.shift * (self.M @ after) - given, largest)
        if found.converged and carried <= SETTINGS.carried:
            self.last = found.v
        return Increment(after, new, found, carried)

    def friction_of(self, level: int) -> FloatArray:
        """Friction over its limit at a level of the last path, (rows,), for a path from there.

        Springs in series keep it; elsewhere the next level does not depend on it.
        """
        return np.array(self.frictions[level])

    def limit(self, force: FloatArray) -> float:
        """Multiple of the forces (N) that friction can just hold; ``inf`` where supports hold.

        ConvergenceError if the search for it does not end.
        """
        if not self.shift:
            return np.inf
        f = self.to.force(force)
        if self.condensed is not None:
            f = self.condensed.restrict(f)[0]
        return self._limit(f, np.full(self.beta.size, np.inf))

    def _state(
        self,
        u: FloatArray,
        before: FloatArray,
        f: FloatArray,
        limit_share: float,
        rate: FloatArray,
        halvings: int = 0,
    ) -> FloatArray:
        """Displacement under ``f`` from ``u`` under the forces ``before``, in parts if need be.

        ``rate`` is the law's steepness for increments of displacement, 1/m, of each point.
        """
        start = self.sigma
        increment = self._minimise(f - self.stiffness @ u, rate, start)
        if np.isfinite(limit_share) and self._carried(increment, f) > SETTINGS.carried:
            self.scaled_back += 1
            right = min(1.0, limit_share * self._limit(f, rate)) * f - self.stiffness @ u
            increment = self._minimise(right, rate, start)
            halvings = SETTINGS.halvings  # scaled back, the load has no path to follow in parts
        if not increment.converged and halvings < SETTINGS.halvings:
            middle = 0.5 * (before + f)
            rest = (limit_share, 2.0 * rate, halvings + 1)
            return self._state(self._state(u, before, middle, *rest), middle, f, *rest)
        if not increment.converged:
            where = (
                increment.where if self.condensed is None else self.condensed.kept[increment.where]
            )
            raise ConvergenceError(
                "the slip under a slowly changing load was not found: a force residual of "
                f"{increment.residual:.3g} N is left at unknown {where}"
            )
        self.last = increment.v
        self.sigma = np.zeros_like(start)
        self.sigma[self.acting] = increment.sigma
        return u + increment.v

    def _minimise(
        self, right: FloatArray, rate: FloatArray, sigma: FloatArray | None = None
    ) -> Minimum:
        """Increment, from the multiple of the last one that is best under Coulomb's law.

        ``sigma`` is the friction over its limit before it, (rows,); none if not given.
        """
        self.solves += 1
        problem, inner, work = self.problem, self.to.system, float(right @ self.last)
        offset = None
        if inner.has_springs:
            before = np.zeros_like(self.sigma) if sigma is None else sigma
            offset = inner.spring_offset(np.zeros(inner.n), inner.on_rows(inner.w) * before)
            offset = None if offset is None else offset[self.acting]
        law = rate, offset
        if self.to.kind == "chain" and np.isinf(rate).all():  # elimination starts from rest
            return problem.minimise(right, None, self.tolerance, *law)
        stored = float(self.last @ (self.A @ self.last))
        at_rest = 0.0 if offset is None else problem.objective(0.0 * self.last, right, *law)
        lost = problem.objective(self.last, right, *law) - at_rest - 0.5 * stored + work
        start = self.last * (np.sign(work) * max(abs(work) - lost, 0.0) / stored if stored else 0.0)
        if problem.objective(start, right, *law) < at_rest:
            return problem.minimise(right, start, self.tolerance, *law)
        return problem.minimise(right, None, self.tolerance, *law)

    def _carried(self, increment: Minimum, f: FloatArray) -> float:
        """Share of the load that the added mass carries."""
        return _share(self.added @ increment.v, f) if self.shift else 0.0

    def _least_of_rigid(self, f: FloatArray) -> tuple[float, bool]:
        """Smallest sum w |B d| / f d found among rigid motions d, and whether it is the least.

        Repeated least squares with weights w / |B d|; each lowers the sum. It is ``inf`` where the
        forces set off no rigid motion, and not the least where there may be more motions.
        """
        rigid = self.rigid if self.condensed is None else self.rigid[self.condensed.kept]
        work, system = f @ rigid, self.to.system
        if np.all(np.abs(work) <= SETTINGS.still * (np.abs(f) @ np.abs(rigid))):
            return np.inf, False
        slips, weight, least = np.asarray(self.B @ rigid), system.w, np.inf
        for _ in range(SETTINGS.least_squares):
            square = slips.T @ (system.on_rows(weight)[:, np.newaxis] * slips)
            d = linalg.lstsq(square, work)[0]
            if not work @ d > 0.0:
                break
            slip = system.slip_norm(slips @ d) / float(work @ d)
            before, least = least, min(least, float(system.w @ slip))
            if least >= before * (1.0 - SETTINGS.settled):
                return least, rigid.shape[1] < SETTINGS.most_rigid
            weight = system.w / np.maximum(slip, SETTINGS.still * slip.max())
        return least, False

    def _limit(self, f: FloatArray, rate: FloatArray) -> float:
        """Multiple of the forces at which everything slips; ConvergenceError as `limit`."""
        (limit, least), inner = self._least_of_rigid(f), self.to.system
        if least:
            return limit
        multiple = 1.01 * limit if np.isfinite(limit) else 1.0
        without_friction = self._without_friction()
        for _ in range(SETTINGS.limit_iterations):
            increment = self._minimise(multiple * f, rate)
            if self._carried(increment, multiple * f) <= SETTINGS.carried:
                if np.isfinite(limit):
                    return limit
                if multiple > 1e6:
                    return np.inf
                multiple *= 10.0
                continue
            slip = without_friction(self.added @ increment.v)  # the rigid part of it
            lower = float(inner.w @ inner.slip_norm(self.B @ slip) / (f @ slip))
            if lower >= limit * (1.0 - 1e-6):
                return limit
            limit, multiple = lower, 1.01 * lower
        raise ConvergenceError(
            f"what friction can hold was not found in {SETTINGS.limit_iterations} iterations: the "
            f"limit is at most {limit:.6g} of the forces, and may be lower"
        )


def _share(carried: FloatArray, f: FloatArray) -> float:
    """Forces of the added mass over a load; zero without a load: friction holds what was held."""
    force = float(np.linalg.norm(f))
    return float(np.linalg.norm(carried)) / force if force > 0.0 else 0.0


def factors_at_rest(system: System) -> QuasiStatic | None:
    """Quasi-static response of a system, for all passes that need its factors.

    None where they are not needed, because no load or no friction acts, or cannot be had: whoever
    then asks for a quasi-static response gets the reason as an error.
    """
    if not system.contact_points or not any(np.any(load.vector) for load in system.loads):
        return None
    try:
        return QuasiStatic(system)
    except (JointError, RuntimeError, np.linalg.LinAlgError):
        return None
