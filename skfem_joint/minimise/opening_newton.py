"""Step problems with contact that opens and closes, and friction whose limits follow its force.

    minimise over v:   1/2 v H v - g v + sum_f w_f psi(|B_f v|)   with   N v <= bound

is one convex problem for given friction limits w; the multipliers p >= 0 of the bounds are normal
forces, and w = given + gain p, or a function of it (`Hinges`). That w depends on p is no part of
the minimisation (friction is not associated): the solution is a fixed point of w -> p -> w.

All is condensed to the slips t = B v and the mean approaches s = N v of the pressure points. Where
s are weighted means of several unknowns, as under hats of nodes on elements of second order, the
unknowns that they average are eliminated for given s by their Schur complement. What is left is a
dense problem z = (t, s) in which friction acts on single points and bounds on single unknowns. Of
these, points that are apart are eliminated too (:mod:`skfem_joint.minimise.touching`).

Each iteration relaxes all points in turn, each with its law solved exactly and its limit from the
normal forces at hand, and then makes a Newton step on all that moves, with the change of the limits
by the change of the normal forces in its (not symmetric) tangent. Where the residual does not fall,
limits are kept until the convex problem for them is solved, then renewed: a contraction as long as
friction is not far above 1. That iteration converged in all prototypes where the coupled one
cycled (friction 1 and large steps), and the coupled one takes a third of its work where both do.
Anderson's acceleration of the limits replaces a contraction where there is none: of 320 random
problems whose stiffness varies over four decades, with friction 0.3, 1, 2 and 4, the coupled
iteration and plain renewal left 0, 3, 35 and 40 unsolved, with the acceleration 0, 0, 2 and 4.
Nothing is returned as converged whose forces do not balance with the limits of its own normal
forces.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from scipy import linalg, sparse

from skfem_joint.arrays import BoolArray, FloatArray, as_dense
from skfem_joint.errors import InputError
from skfem_joint.linalg.schur import SchurComplement
from skfem_joint.minimise.opening_loops import (
    ContactLine,
    Gain,
    Hinges,
    Limits,
    Pressing,
    Rubbing,
    friction_limits,
    length_along,
    normal_forces,
    relax_normals,
    relax_slips,
    residual,
    subtract_forces,
    tangents,
)
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed
from skfem_joint.minimise.touching import DenseContact, Part, Touching

if TYPE_CHECKING:
    from skfem_joint.minimise.problem import PressurePoints


class OpeningSettings(NamedTuple):
    """Numbers of the method.

    Attributes
    ----------
    iterations : int
        Most iterations.
    sweeps : int
        Sweeps of relaxation in each.
    patience : int
        Iterations in which the residual must halve; otherwise limits are kept while the convex
        problem is solved.
    again : float
        Limits follow the normal forces in each iteration again when those kept have brought the
        residual to this share of what it was.
    history : int
        Limits that are kept in mind to find the next ones.
    inner : float
        The convex problem is solved to this share of the residual that its limits leave.
    stops : int
        Most times that a Newton step is made anew because points would reverse.
    dependent : float
        Share of the largest part of an approach that is not in others' below which it is none.
    round_off : float
        Accepted residual in units of the forces that are added up.
    """

    iterations: int = 200
    sweeps: int = 2
    patience: int = 6
    again: float = 1e-2
    history: int = 8
    damped: float = 0.5
    inner: float = 0.1
    stops: int = 3
    dependent: float = 1e-10
    round_off: float = 64 * float(np.finfo(np.float64).eps)


SETTINGS = OpeningSettings()


class OpeningNewton:
    """Step problem with contact that opens, see the module.

    Parameters
    ----------
    H : csr_array or ndarray, shape (n, n)
        Symmetric positive definite.
    points : ContactPoints
        Friction points, each row of whose ``B`` picks an unknown of its own, and pressure points;
        the unknowns of ``N`` are no slips.

    Raises
    ------
    InputError
        If rows of N depend on each other.
    """

    def __init__(self, H: Any, points: ContactPoints) -> None:
        normal = cast("PressurePoints", points.normal)
        self.H, self.points, self.N = H, points, sparse.csr_array(normal.N)
        slips, normals = points.unknowns, np.unique(self.N.indices)
        kept = np.sort(np.concatenate([slips, normals]))
        self.schur = SchurComplement(H, kept)
        S = as_dense(self.schur.complement)
        self._t, self._d = np.searchsorted(kept, slips), np.searchsorted(kept, normals)
        self.slips = slips.size
        W = as_dense(self.N[:, normals])
        self._picks = bool(np.array_equal(W, np.eye(normals.size)))
        A = self._condensed(S, W)
        self.factorizations = 1
        self.whole = DenseContact.of(
            A, points.directions, points.beta, sparse.csr_array(normal.gain), normal.stiffness
        )
        self._part: Part | None = None

    def _condensed(self, S: FloatArray, W: FloatArray) -> FloatArray:
        """Matrix of slips and mean approaches, from that of slips and the unknowns averaged.

        The unknowns averaged are d = P s + Z y with W P = 1 and W Z = 0, and y is eliminated. That
        works where contact alone holds a body as well: its stiffness for y is regular.
        """
        t, d = self._t, self._d
        if self._picks:
            both = np.concatenate([t, d])
            return np.ascontiguousarray(S[np.ix_(both, both)])
        Q, R = linalg.qr(W.T)
        q, size = len(W), np.abs(np.diagonal(R))
        if q > size.size or size.min() <= SETTINGS.dependent * size.max():
            raise InputError(
                "contact that opens: approaches of pressure points depend on each other, or no "
                "unknown moves one; leave out those that follow from others or cannot move, with "
                "what they give to friction limits in w alone"
            )
        self._P = linalg.solve_triangular(R[:q], Q[:, :q].T).T
        self._Z = Q[:, q:]
        S_td, S_dd = S[np.ix_(t, d)], S[np.ix_(d, d)]
        S_dP = S_dd @ self._P
        S_ts = S_td @ self._P
        A = np.block([[S[np.ix_(t, t)], S_ts], [S_ts.T, self._P.T @ S_dP]])
        self._beside = np.hstack([(S_td @ self._Z).T, self._Z.T @ S_dP])
        self._factor = linalg.cho_factor(self._Z.T @ (S_dd @ self._Z))
        A -= self._beside.T @ linalg.cho_solve(self._factor, self._beside)
        return np.ascontiguousarray(0.5 * (A + A.T))

    def restrict(self, g: FloatArray) -> tuple[FloatArray, Any]:
        """Right side of z, (t + q,) or (t + q, k), and what `extend` needs beside it."""
        right, interior = self.schur.restrict(g)
        g_t, g_d = right[self._t], right[self._d]
        if self._picks:
            return np.concatenate([g_t, g_d]), (g_d, interior)
        g_y = self._Z.T @ g_d
        right = np.concatenate([g_t, self._P.T @ g_d])
        right -= self._beside.T @ linalg.cho_solve(self._factor, g_y)
        return right, (g_y, interior)

    def extend(self, z: FloatArray, beside: Any) -> FloatArray:
        """All unknowns, (n,) or (n, k), from slips and approaches."""
        g_y, interior = beside
        kept = np.empty((self.schur.kept.size, *z.shape[1:]))
        kept[self._t] = z[: self.slips]
        kept[self._d] = (
            z[self.slips :]
            if self._picks
            else self._P @ z[self.slips :]
            + self._Z @ (linalg.cho_solve(self._factor, g_y - self._beside @ z))
        )
        return self.schur.extend(kept, interior)

    def start_of(self, v: FloatArray) -> FloatArray:
        """Slips and approaches, (t + q,), of all unknowns."""
        return np.concatenate([v[self.points.unknowns], self.N @ v])

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
        bound, given, gain, hinges, touching = cast("Pressed", pressed)
        if not np.isfinite(g).all():
            v, sigma = np.full(g.size, np.nan), np.zeros(self.slips)
            where = int(np.flatnonzero(~np.isfinite(g))[0])
            p, w = np.zeros(bound.size), np.zeros(given.size)
            return Minimum(v, sigma, False, {"newton_iterations": 0}, np.nan, where, p, w)
        right, beside = self.restrict(g)
        z = np.zeros(right.size) if start is None else self.start_of(start)
        scale = max(float(np.abs(right).max()), float(np.abs(g).max()))
        law = self.whole.beta if beta is None else np.asarray(beta, dtype=float)
        gain = np.broadcast_to(np.asarray(gain, dtype=float), bound.shape)
        if hinges is None:
            none = np.full(given.size, np.inf)
            zero = np.zeros(given.size)
            hinges = Hinges(np.ones(given.size), none, none, zero, none, np.zeros(self.slips))
        solved = self._solution(
            right, z, _Right(bound, given, gain, law, hinges), tolerance, scale, touching
        )
        v = self.extend(solved.v, beside)
        limits = self.points.on_rows(solved.w)
        sigma = solved.sigma / np.where(limits > 0.0, limits, 1.0)
        return replace(
            solved,
            v=v,
            sigma=np.clip(sigma, -1.0, 1.0),
            converged=solved.converged and bool(np.isfinite(v).all()),
            where=int(self.points.unknowns[solved.where]) if solved.where < self.slips else -1,
        )

    def _solution(
        self,
        right: FloatArray,
        z: FloatArray,
        given: _Right,
        tolerance: float,
        scale: float,
        touching: Touching | None,
    ) -> Minimum:
        """Solution from ``z``, in slips and approaches, with friction forces in place of sigma.

        Points that pass their bounds though they count as apart are kept.
        """
        counts: Counter[str] = Counter()
        while True:
            part = None if touching is None else self._parted(touching, given.limits)
            if part is None or touching is None:
                search = _Search(self.whole, right, given)
                search.run(z, tolerance, scale)
                counts.update(search.counts)
                return Minimum(
                    search.z, search.force[: self.slips], search.converged, dict(counts),
                    search.residual, search.where, search.p, search.w,
                )  # fmt: skip
            own, apart = part.restrict(right)
            search = _Search(part.problem, own, given.among(part))
            search.run(z[part.unknowns], tolerance, scale)
            counts.update(search.counts)
            z = part.extend(search.z, apart)
            if not (search.converged and touching.closes(z[self.slips :], given.bound)):
                break
        p, w = np.zeros(given.bound.size), np.zeros(given.limits.size)
        force = np.zeros(right.size)
        p[part.pressures], w[part.frictions] = search.p, search.w
        force[part.unknowns] = search.force
        return Minimum(
            z, force[: self.slips], search.converged, dict(counts), search.residual,
            int(part.unknowns[search.where]), p, w,
        )  # fmt: skip

    def _parted(self, touching: Touching, given: FloatArray) -> Part | None:
        """The points that touch, or None where it does not pay to eliminate the others."""
        if not touching.some_apart:
            return None
        if self._part is None or not np.array_equal(self._part.kept, touching.kept):
            self._part = Part(self.whole, touching.kept)
            self.factorizations += 1
        others = np.ones(given.size, dtype=bool)
        others[self._part.frictions] = False
        return None if np.any(given[others] > 0.0) else self._part


class _Right(NamedTuple):
    """What a minimisation is given beside its right side, see `OpeningNewton.minimise`."""

    bound: FloatArray
    limits: FloatArray
    gain: FloatArray
    beta: FloatArray
    hinges: Hinges

    def among(self, part: Part) -> _Right:
        """Of some of the points."""
        c, f = part.pressures, part.frictions
        bias = self.hinges.bias[part.unknowns[: part.problem.slips]]
        first, lower, upper, beyond, cap = (x[f] for x in self.hinges[:-1])
        hinges = Hinges(first, lower, upper, beyond, cap, bias)
        return _Right(self.bound[c], self.limits[f], self.gain[c], self.beta[f], hinges)


def _solved(J: FloatArray, right: FloatArray) -> FloatArray:
    """Solution x of J x = right, NaN where J is singular; overwrites ``J``, a C array.

    LAPACK itself: estimates of the condition, as in `scipy.linalg.solve`, take as long.
    """
    factor, pivots, info = linalg.lapack.dgetrf(J.T, overwrite_a=True)
    if info != 0:
        return np.full(right.size, np.nan)
    return np.asarray(linalg.lapack.dgetrs(factor, pivots, right, trans=1)[0])


class Renewal:
    """Friction limits that become those of their own normal forces, by Anderson's acceleration.

    The map of limits to the limits of the normal forces under them has a fixed point for any
    friction, but contracts only where friction is not far above 1.
    """

    def __init__(self) -> None:
        self.limits: list[FloatArray] = []
        self.changes: list[FloatArray] = []
        self.least, self.since, self.share = np.inf, 0, 1.0

    def next(self, limits: FloatArray, image: FloatArray) -> FloatArray:
        """Limits to try next, (m,), N, from ``limits`` and those of the forces under them."""
        change = image - limits
        size = float(np.linalg.norm(change))
        self.since += 1
        if size <= 0.5 * self.least:
            self.least, self.since = size, min(self.since, 0)
        if self.since >= 0 and (size > 10.0 * self.least or self.since > SETTINGS.history):
            self.limits, self.changes, self.since = [], [], -SETTINGS.history
            self.share *= SETTINGS.damped
        if self.since < 0:  # small steps converge where large ones swing
            return limits + self.share * change
        self.limits, self.changes = [*self.limits, limits], [*self.changes, change]
        del self.limits[: -SETTINGS.history], self.changes[: -SETTINGS.history]
        step = change.copy()
        if len(self.changes) > 1:
            of_changes, of_limits = np.diff(self.changes, axis=0).T, np.diff(self.limits, axis=0).T
            shares = linalg.lstsq(of_changes, change, cond=1e-10)[0]
            step -= (of_limits + of_changes) @ shares
        return np.maximum(limits + step, 0.0)


class _Search:
    """The iteration for one right side, see the module."""

    def __init__(
        self,
        problem: DenseContact,
        right: FloatArray,
        given: _Right,
    ) -> None:
        self.problem, self.right = problem, right
        t = problem.slips
        self.A, n = problem.A, right.size
        beta = np.array(given.beta, dtype=float)
        places = np.arange(t, n)
        self.pressing = Pressing(places, np.array(given.bound, dtype=float), problem.stiffness)
        bias = np.concatenate([given.hinges.bias, np.zeros(places.size)])
        self.rubbing = Rubbing(
            problem.first, problem.second, problem.stiff, beta, given.hinges.cap, bias
        )
        self.gain = G = sparse.csr_array(problem.gain @ sparse.diags_array(given.gain))
        self.limits = Limits(
            np.array(given.limits, dtype=float),
            Gain(G.indptr.astype(np.int64), G.indices.astype(np.int64), G.data),
            np.isinf(problem.stiffness),
            given.hinges,
        )
        self._row_gain = G[problem.row_point]
        self.p, self.w, self.slopes = np.zeros(places.size), *np.zeros((2, beta.size))
        self.force, self.held = np.zeros(n), np.zeros(n, dtype=np.bool_)
        self.counts = {
            "newton_iterations": 0,
            "friction_evaluations": 0,
            "linear_solves": 2,
            "factorizations": 0,
            "renewed_limits": 0,
        }
        self.residual, self.where, self.converged = np.inf, 0, False

    def run(self, z: FloatArray, tolerance: float, scale: float) -> None:
        """Iterate from ``z`` until the forces balance to the tolerance times ``scale``, N."""
        self.z = z = z.copy()
        rigid = np.isinf(self.problem.stiffness)
        t = self.problem.slips
        z[t:] = np.where(rigid, np.minimum(z[t:], self.pressing.bound), z[t:])
        renewal: Renewal | None = None  # while limits are kept
        best, since, inner_target, mark = np.inf, 0, 0.0, (z.copy(), np.inf)
        r = np.empty_like(z)
        residual(self.A, self.right, z, r)
        for iteration in range(SETTINGS.iterations):
            self._relax(z, r, iteration, renewal is not None)
            residual(self.A, self.right, z, r)
            frozen, left = self.w.copy(), r.copy()
            self._renew(z, r)
            self.residual = self._subtract(z, left)
            if not np.isfinite(self.residual):
                return
            if self.residual <= tolerance * scale or (
                self.residual <= 1e-6 * scale and self.residual <= self._round_off(z)
            ):
                self.converged = True
                return
            if renewal is not None:
                left, image = r.copy(), self.w
                self.w = frozen
                if self._subtract(z, left) <= max(inner_target, 0.1 * tolerance * scale):
                    self.counts["renewed_limits"] += 1
                    inner_target = SETTINGS.inner * self.residual
                    if self.residual <= SETTINGS.again * mark[1]:
                        renewal, best, since = None, self.residual, 0
                        mark, self.w = (z.copy(), self.residual), image
                    else:
                        self.w = renewal.next(frozen, image)
                    left = r.copy()
                    self._subtract(z, left)
            elif self.residual <= 0.5 * best:
                best, since = self.residual, 0
            else:
                since += 1
                if since >= SETTINGS.patience:
                    renewal, inner_target = Renewal(), SETTINGS.inner * self.residual
                    if mark[1] < self.residual:
                        z[:] = mark[0]
                        residual(self.A, self.right, z, r)
                        self._renew(z, r)
                        left = r.copy()
                        self._subtract(z, left)
                    else:
                        mark = (z.copy(), self.residual)
            self._newton(z, left, r, coupled=renewal is None)
            residual(self.A, self.right, z, r)

    def _relax(self, z: FloatArray, r: FloatArray, iteration: int, kept: bool) -> None:
        """Relax all points in turn, in place, with limits as they are if they are ``kept``."""
        for sweep in range(SETTINGS.sweeps):
            backward = bool((sweep + iteration) % 2)
            relax_normals(self.A, self.pressing, z, r, backward)
            if not kept:
                self._renew(z, r)
            relax_slips(self.A, self.rubbing, self.w, z, r, backward)
        self.counts["newton_iterations"] += 1
        self.counts["friction_evaluations"] += SETTINGS.sweeps + 1

    def _subtract(self, z: FloatArray, left: FloatArray) -> float:
        """Subtract contact forces under the present limits from ``left``; its largest entry."""
        residual, self.where = subtract_forces(
            self.rubbing, self.pressing, self.w, self.p, z, left, self.force, self.held
        )
        return float(residual)

    def _renew(self, z: FloatArray, r: FloatArray) -> None:
        normal_forces(self.pressing, z, r, self.p)
        friction_limits(self.limits, self.p, self.w, self.slopes)

    def _round_off(self, z: FloatArray) -> float:
        size = float((self.problem.sizes @ np.abs(z)).max()) + float(np.abs(self.right).max())
        return SETTINGS.round_off * size

    def _newton(self, z: FloatArray, left: FloatArray, r: FloatArray, coupled: bool) -> None:
        """Newton step in place on all that moves; ``left`` is the residual, ``r`` that of A z."""
        first, second = self.rubbing.first, self.rubbing.second
        t, n = self.problem.slips, z.size
        blocks, diagonal = np.zeros((first.size, 3)), np.zeros(n - t)
        tangents(self.rubbing, self.pressing, self.w, z, blocks, diagonal)
        held, target = self.held.copy(), np.zeros(n)
        both = second >= 0
        for _ in range(SETTINGS.stops):
            free = np.flatnonzero(~held)
            if not free.size:
                return
            rows = self.A.take(free, axis=0)
            J = rows.take(free, axis=1)
            place = np.full(n + 1, -1)
            place[free] = np.arange(free.size)
            self._add_tangents(J, place, blocks, diagonal, both)
            right, moved = left[free], np.flatnonzero(target)
            if moved.size:
                right -= rows.take(moved, axis=1) @ target[moved]
            if coupled:
                right = self._couple(J, free, place, right, target)
            d = target.copy()
            d[free] = _solved(J, right)
            self.counts["factorizations"] += 1
            turning = z * (z + d)
            i, j = first[both], second[both]
            turning[i] = turning[j] = turning[i] + turning[j]
            coulomb = np.zeros(n, dtype=bool)
            acting = (self.w > 0.0) & np.isinf(self.rubbing.beta)
            coulomb[first[acting]] = True
            coulomb[second[acting & both]] = True
            reverses = coulomb & ~held & (turning < 0.0)
            over = np.zeros(n, dtype=bool)
            rigid = np.isinf(self.problem.stiffness)
            over[t:] = rigid & ~held[t:] & (z[t:] + d[t:] > self.pressing.bound)
            if not (reverses.any() or over.any()):
                break
            target[reverses] = -z[reverses]
            target[t:][over[t:]] = self.pressing.bound[over[t:]] - z[t:][over[t:]]
            held |= reverses | over
        d[t:] = np.where(rigid, np.minimum(d[t:], self.pressing.bound - z[t:]), d[t:])
        length = 1.0
        if not coupled:
            along = self.A @ d
            line = ContactLine(self.rubbing, self.pressing, self.w, z, d)
            given = np.minimum(4.0 * self.w, self.rubbing.cap)[self.problem.row_point]
            linear = float(d[:t] @ (given * self.rubbing.bias[:t])) - float(d @ r)
            length = min(length_along(line, linear, float(d @ along)), 1.0)
        z += length * d
        ahead = np.isclose(z[t:], self.pressing.bound, rtol=1e-14, atol=0.0) & rigid
        z[t:][ahead] = self.pressing.bound[ahead]

    def _add_tangents(
        self, J: FloatArray, place: Any, blocks: FloatArray, diagonal: FloatArray, both: BoolArray
    ) -> None:
        """Add the tangents of friction and of elastic normal contact to J, in place."""
        first, second, t = self.rubbing.first, self.rubbing.second, self.problem.slips
        k = place[first]
        moves = k >= 0
        J[k[moves], k[moves]] += blocks[moves, 0]
        pair = both & moves
        i, j = place[first[pair]], place[second[pair]]
        J[j, j] += blocks[pair, 2]
        J[i, j] += blocks[pair, 1]
        J[j, i] += blocks[pair, 1]
        k = place[t:-1]
        J[k[k >= 0], k[k >= 0]] += diagonal[k >= 0]

    def _couple(
        self, J: FloatArray, free: Any, place: Any, right: FloatArray, target: FloatArray
    ) -> FloatArray:
        """Add what the change of the normal forces does to friction to J; returns the right side.

        The force of a closed rigid pressure point changes by -A d, that of an elastic one by its
        stiffness.
        """
        t, problem = self.problem.slips, self.problem
        limits = self.w[problem.row_point]
        moving = np.flatnonzero((limits > 0.0) & (place[:t] >= 0))
        closed = self.p > 0.0
        if not (closed.any() and moving.size):
            return right
        weights = sparse.csr_array(self._row_gain[moving])
        lengths = np.diff(weights.indptr)
        weights.data *= closed[weights.indices]
        sigma = self.force[moving] / limits[moving]
        rigid, rows = np.isinf(problem.stiffness), place[moving]
        change = sigma * self.slopes[problem.row_point[moving]]
        below = 4.0 * limits[moving] < self.rubbing.cap[problem.row_point[moving]]
        change += np.where(below, 4.0 * self.rubbing.bias[moving], 0.0)
        of_rigid = weights.copy()
        of_rigid.data = of_rigid.data * np.repeat(change, lengths) * rigid[weights.indices]
        pressing = np.unique(of_rigid.indices)
        of_rigid, of_pressing = of_rigid[:, pressing], self.A.take(t + pressing, axis=0)
        J[rows] -= of_rigid @ of_pressing.take(free, axis=1)
        moved = np.flatnonzero(target)
        right = right.copy()
        if moved.size:
            right[rows] += of_rigid @ (of_pressing.take(moved, axis=1) @ target[moved])
        if not rigid.all():
            stiffness = np.where(rigid, 0.0, problem.stiffness)
            weights.data *= np.repeat(sigma, lengths)
            of_soft = (weights @ sparse.diags_array(stiffness)).toarray()
            soft = np.flatnonzero(~rigid & (place[t:-1] >= 0))
            J[np.ix_(rows, place[t + soft])] += of_soft[:, soft]
        return right
