"""Minimiser of a step's convex objective 1/2 v A v - g v + sum w psi(|v_p|) over the velocity.

A is large and sparse, or dense once everything but the contact has been condensed; psi is the
potential of the friction law, arctan or set-valued Coulomb, of each point's slip vector v_p. The
method is the truncated nonsmooth Newton method (Graeser and Kornhuber, J. Comput. Math. 27, 2009;
Graeser, Sack and Sander, Int. J. Numer. Methods Eng. 2018): contact points are relaxed one after
another, each with its law solved exactly, then one Newton step on all points but those that Coulomb
friction holds, and an exact search along it. Where that is short, points that would turn over on it
are stopped, and the step is made anew for the others, if that leads further down: one of them would
block all the others. Every part lowers the objective, so that the iteration converges from any
start whatever beta is; it needs no parameter. Newton's systems are solved by conjugate gradients,
preconditioned by the factor of an earlier tangent where the law acts as it did then and by the
diagonal where it does not; that factor serves for several iterations.

Measured on a plate in contact over 40 % (half of the friction limit, 200 steps a period, beta =
1e5, 3,960 unknowns; ``examples/benchmarks/plates.py``), Newton's steps with solves and factors a
step of time: 6.8 with 9.2 and 7.2 without relaxation and with a factor for each, 2.9 with 4.9 and
2.9 after four sweeps, 3.7 with 12.7 and 0.5 if factors are kept while six solves do and few
unknowns have changed, 4.2 with 33 and 0.1 while ten do. A factor costs ten solves along a narrow
band, thirty elsewhere.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import hypot, inf, pi
from typing import Any

import numpy as np

from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.linalg.factors import BlockFactors
from skfem_joint.friction import potential
from skfem_joint.stepping.compiled import arctangent, compiled, resolvent
from skfem_joint.stepping.march import Full, subtract_column, subtract_product, times
from skfem_joint.linalg.compressed import compressed_rows

#: Most iterations, sweeps of relaxation in each, and trials of a search along a direction.
ITERATIONS, SWEEPS, SEARCH = 100, 4, 20
#: Most solves of a Newton's system; the kept factor is given up when one takes more; share of their
#: right side that the systems are solved to; unknowns whose diagonal has changed by half or doubled
#: from which on it is not tried (of 178 trials with more, 3 took no more than four solves).
MOST_SOLVES, PATIENCE, FORCING, CHANGED = 60, 6, 0.05, 32
#: Unknowns of a dense system that moves up to which a factor of its own costs less than that.
FEW = 512
#: Accepted round-off: so many units in the last place of the forces that are added up.
ROUND_OFF = 16 * float(np.finfo(np.float64).eps)
#: Largest tangent across a slip over the diagonal: round-off of larger ones is singular along it.
STIFFEST = 1e8
#: Forces, N, that count as none: products of smaller ones are lost.
NOTHING = 1e-140

# A contact point slips in one or two directions: its unknowns are ``first[p]`` and,
# unless that is -1, ``second[p]``. ``stiff[p]`` is the largest eigenvalue of its block of A.
# Symmetric blocks of a point are stored as (11, 12, 22), shape (points, 3); of a point with one
# direction only the first entry counts.


@compiled
def _relax(p, first, second, stiff, w, beta, r, s, v):
    """Minimise over the velocity of one point; ``r`` and ``s`` are its residual without friction.

    With two directions the block is replaced by its largest eigenvalue, seen from the velocity
    now: a majorant, so that the objective cannot grow, with a closed direction.
    """
    i = first[p]
    j = second[p]
    x = r + stiff[p] * v[i]
    if j < 0:
        v[i] = resolvent(x / w[p], stiff[p] / w[p], beta[p])[0]
        return
    y = s + stiff[p] * v[j]
    size = hypot(x, y)
    speed = resolvent(size / w[p], stiff[p] / w[p], beta[p])[0]
    v[i] = speed * (x / size) if size != 0.0 else 0.0
    v[j] = speed * (y / size) if size != 0.0 else 0.0


@compiled
def _sweep(A, first, second, stiff, w, beta, r, v, backward):
    """Relax all points one after another, in place, and keep the residual r = g - A v.

    Points that rest and stay so cost nothing.
    """
    n = first.size
    for k in range(n):
        p = n - 1 - k if backward else k
        i = first[p]
        j = second[p]
        x = v[i]
        y = v[j] if j >= 0 else 0.0
        _relax(p, first, second, stiff, w, beta, r[i], r[j] if j >= 0 else 0.0, v)
        if v[i] != x:
            subtract_column(A, i, v[i] - x, r)
        if j >= 0 and v[j] != y:
            subtract_column(A, j, v[j] - y, r)


@compiled
def _size(first, second, p, v):
    """Norm of a vector at a point."""
    return abs(v[first[p]]) if second[p] < 0 else hypot(v[first[p]], v[second[p]])


@compiled
def _subtract_friction(first, second, w, beta, v, r, sigma, held):
    """Subtract friction from the residual ``r`` = g - A v; returns its largest entry and where.

    What is not a number counts as larger than any number.

    The force of a Coulomb point at rest is what the residual asks for, as far as it can hold.
    ``held`` marks the unknowns of such points; ``sigma`` is filled by unknown.
    """
    held[:] = False
    for p in range(first.size):
        speed = _size(first, second, p, v)
        holds = beta[p] == inf and speed == 0.0
        if holds:
            share = 1.0 / max(w[p], _size(first, second, p, r))
        else:
            share = 1.0 if beta[p] == inf else 2.0 / pi * arctangent(beta[p] * speed)
        for i in (first[p], second[p]):
            if i >= 0:
                held[i] = holds
                # The inverse of the speed may be infinite, its products then are not numbers.
                sigma[i] = r[i] * share if holds else v[i] / speed * share if speed != 0.0 else 0.0
                r[i] -= w[p] * sigma[i]
    largest = 0.0
    where = 0
    for i in range(r.size):
        if not abs(r[i]) <= largest:
            largest = abs(r[i])
            where = i
            if largest != largest:
                break
    return largest, where


@compiled
def _tangent(first, second, stiff, w, beta, v, out):
    """Blocks of d(w sigma)/dv, N s/m; zero for Coulomb points at rest, which are held instead."""
    for p in range(first.size):
        i = first[p]
        j = second[p]
        out[p, :] = 0.0
        speed = _size(first, second, p, v)
        if beta[p] == inf:
            along = 0.0
            most = STIFFEST * stiff[p]
            across = 0.0 if speed == 0.0 else w[p] / speed if most * speed > w[p] else most
        else:
            z = beta[p] * speed
            along = w[p] * 2.0 / pi * beta[p] / (1.0 + z * z)
            across = w[p] * 2.0 / pi * arctangent(z) / speed if speed > 0.0 else along
        out[p, 0] = out[p, 2] = along
        if j >= 0 and speed > 0.0:
            x = v[i] / speed
            y = v[j] / speed
            out[p, 0] = across + (along - across) * x * x
            out[p, 1] = (along - across) * x * y
            out[p, 2] = across + (along - across) * y * y


@compiled
def _slope(first, second, w, beta, v, d, length):
    """Derivative of sum w psi(|v + length d|) along the direction ``d``, W."""
    total = 0.0
    for p in range(first.size):
        i = first[p]
        j = second[p]
        x = v[i] + length * d[i]
        y = 0.0 if j < 0 else v[j] + length * d[j]
        across = 0.0 if j < 0 else d[j]
        speed = hypot(x, y)
        if speed > 0.0:
            sigma = 1.0 if beta[p] == inf else 2.0 / pi * arctangent(beta[p] * speed)
            total += w[p] * sigma * (x * d[i] + y * across) / speed
    return total


@compiled
def _round_off(first, second, w, beta, v):
    """Largest of w (sigma + slope |v|), N: what round-off of a velocity does to the friction."""
    largest = 0.0
    for p in range(first.size):
        change = 1.0
        if beta[p] != inf:
            z = beta[p] * _size(first, second, p, v)
            change += 2.0 / pi * z / (1.0 + z * z)
        largest = max(largest, w[p] * change)
    return largest


@compiled
def _add_blocks(first, second, blocks, x, y):
    """Add the product of the points' blocks with ``x`` to ``y``."""
    for p in range(first.size):
        i = first[p]
        j = second[p]
        y[i] += blocks[p, 0] * x[i]
        if j >= 0:
            y[i] += blocks[p, 1] * x[j]
            y[j] += blocks[p, 1] * x[i] + blocks[p, 2] * x[j]


# All points together


@dataclass(frozen=True)
class Solution:
    """What :meth:`ContactProblem.solve` found."""

    v: FloatArray  #: velocity, m/s
    sigma: FloatArray  #: normalised friction by unknown; zero off the contact
    converged: bool
    counts: dict[str, int]  #: work done, by the names of `Counters`
    residual: float  #: largest force residual, N, at the unknown ``where``
    where: int


class ContactProblem:
    """One matrix with its contact points, to be solved for many right sides.

    Parameters
    ----------
    A : csr_array or ndarray, shape (n, n)
        Symmetric positive definite, kg/s.
    first, second : ndarray of int, shape (m,)
        Unknowns of each contact point; ``second`` is -1 where it slips in one direction.
    w, beta : ndarray, shape (m,)
        Friction limit, N, and scaling constant, s/m (``inf``: Coulomb); points without a limit
        count as off the contact.
    """

    #: Tangents and held unknowns of the factor that is kept, on which further solutions depend.
    kept: tuple[FloatArray, BoolArray] | None = None

    def __init__(
        self, A: Any, first: IntArray, second: IntArray, w: FloatArray, beta: FloatArray
    ) -> None:
        n = A.shape[0]
        self.A, self.sizes, self.dense = A, abs(A), isinstance(A, np.ndarray)
        self.rows = Full(A) if self.dense else compressed_rows(A)
        self.factor: Callable[[FloatArray], FloatArray] | None = None
        self.factorizations = 0
        order = np.argsort(first, kind="stable")
        order = order[w[order] > 0.0]
        self.first = np.asarray(first, dtype=np.int64)[order]
        self.second = np.asarray(second, dtype=np.int64)[order]
        self.w, self.beta = np.array(w, dtype=float)[order], np.array(beta, dtype=float)[order]
        self.both = self.second >= 0
        self.pairs = i, j = self.first[self.both], self.second[self.both]
        self.diagonal = diagonal = A.diagonal()
        self.added = np.zeros(n)
        self.stiff = diagonal[self.first]
        mean, half = 0.5 * (diagonal[i] + diagonal[j]), 0.5 * (diagonal[i] - diagonal[j])
        self.stiff[self.both] = mean + np.hypot(half, np.asarray(A[i, j]).ravel())
        self.limited = np.zeros(n, dtype=bool)  # unknowns that friction acts on
        self.limited[self.first] = self.limited[j] = True
        self.points = self.first, self.second
        self.factors = BlockFactors(A, *self.points)
        self.laws = *self.points, self.w, self.beta

    def compile(self) -> None:
        """Compile all that solving needs, on no points."""
        none, nothing, block = self.first[:0], self.w[:0], np.zeros((0, 3))
        laws = none, none, nothing, nothing
        x, y, z = np.zeros((3, self.A.shape[0]))
        subtract_product(self.rows, x, y)
        _sweep(self.rows, none, none, nothing, nothing, nothing, x, y, False)
        _subtract_friction(*laws, x, y, z, np.zeros(x.size, dtype=np.bool_))
        _tangent(none, none, nothing, nothing, nothing, x, block)
        _slope(*laws, x, y, 1.0)
        _round_off(*laws, x)
        _add_blocks(none, none, block, x, y)

    def solve(
        self, g: FloatArray, start: FloatArray, tolerance: float, force: float = 0.0
    ) -> Solution:
        """Velocity at which A v + friction = g (N), from the velocity ``start``.

        ``tolerance`` is the largest residual relative to the largest force, which is that of ``g``
        or ``force`` (N). Not converged where anything is not finite.
        """
        scale = max(float(np.abs(g).max()), force)
        v = start.copy() if scale > NOTHING else np.zeros_like(start)
        sigma = np.zeros(v.size)
        held = np.zeros(v.size, dtype=np.bool_)
        factorizations, evaluations, solves = self.factorizations, 0, 0
        residual, where, converged = np.inf, 0, False
        r = g - times(self.A, v)
        for iteration in range(ITERATIONS):
            for sweep in range(SWEEPS):
                backward = bool((sweep + iteration) % 2)
                _sweep(self.rows, *self.points, self.stiff, self.w, self.beta, r, v, backward)
            r = g - times(self.A, v)
            left = r.copy()
            residual, where = _subtract_friction(*self.laws, v, r, sigma, held)
            evaluations += SWEEPS + 1
            if not np.isfinite(residual):
                break
            converged = residual <= max(tolerance * scale, NOTHING) or (
                residual <= 1e-6 * scale and residual <= self._round_off(v, g)
            )
            if converged:
                break
            d, along, length, more, trials = self._newton_step(v, left, r, held)
            solves, evaluations = solves + more, evaluations + trials
            if length < 1.0 and (turns := self._turns(v, d)).any():
                stopped, more, trials = self._stopped(v, turns, g)
                solves, evaluations = solves + more, evaluations + trials + 2
                if self.objective(v + stopped, g) < self.objective(v + length * d, g):
                    length, d, along = 1.0, stopped, times(self.A, stopped)
            v += length * d
            r = left - length * along
        counts = {
            "newton_iterations": iteration,
            "friction_evaluations": evaluations,
            "linear_solves": solves,
            "factorizations": self.factorizations - factorizations,
        }
        return Solution(v, sigma, converged, counts, residual, where)

    def objective(self, v: FloatArray, g: FloatArray) -> float:
        """1/2 v A v - g v + sum w psi(|v_p|)."""
        return float(v @ (0.5 * times(self.A, v) - g)) + self.lost(v)

    def lost(self, v: FloatArray) -> float:
        """Sum w psi(|v_p|)."""
        slip = np.hypot(v[self.first], np.where(self.second < 0, 0.0, v[self.second]))
        return float(self.w @ potential(slip, self.beta))

    def _newton_step(
        self, v: FloatArray, left: FloatArray, r: FloatArray, held: BoolArray
    ) -> tuple[FloatArray, FloatArray, float, int, int]:
        """Newton's direction d from ``v``, A d, and its length; solves and trials.

        ``left`` is g - A v, ``r`` that without friction; unknowns that are ``held`` rest.
        """
        tangents = np.zeros((self.first.size, 3))
        _tangent(*self.points, self.stiff, self.w, self.beta, v, tangents)
        r[held] = 0.0
        d, solves = self._newton_direction(r, tangents, held)
        along = times(self.A, d)
        length, trials = self._search(v, d, left, along)
        return d, along, length, solves, trials

    def _turns(self, v: FloatArray, d: FloatArray) -> BoolArray:
        """Unknowns of points whose slip would turn over along ``d``."""
        i, j = self.pairs
        turning = v * (v + d)
        turning[i] = turning[j] = turning[i] + turning[j]
        return np.asarray(self.limited & (turning < 0.0))

    def _stopped(
        self, v: FloatArray, turns: BoolArray, g: FloatArray
    ) -> tuple[FloatArray, int, int]:
        """Step that stops the slips which would turn over, and is Newton's for the others.

        One point that turns would block all the others. Solves and trials come with it.
        """
        stop = np.where(turns, -v, 0.0)
        r = g - times(self.A, v + stop)
        left, sigma, held = r.copy(), np.zeros_like(r), np.zeros_like(turns)
        _subtract_friction(*self.laws, v + stop, r, sigma, held)
        d, _, length, solves, trials = self._newton_step(v + stop, left, r, held | turns)
        return stop + length * d, solves, trials

    def _round_off(self, v: FloatArray, g: FloatArray) -> float:
        size = float(times(self.sizes, np.abs(v)).max()) + float(np.abs(g).max())
        return ROUND_OFF * (size + float(_round_off(*self.laws, v)))

    def _newton_direction(
        self, r: FloatArray, tangents: FloatArray, held: BoolArray
    ) -> tuple[FloatArray, int]:
        """Solve (A + tangent) d = r on the unknowns that are not held.

        The factor kept is that of an earlier tangent: conjugate gradients make up for what has
        changed, until that takes longer than to factorise again.
        """
        if not np.any(r):  # only held points are out of balance: relaxation sets them free
            return np.zeros_like(r), 0
        if self.dense and (free := np.flatnonzero(~held)).size <= FEW:
            self.factorizations += 1
            d = np.zeros_like(r)
            d[free] = self.factors.factorised(tangents, held)(r)[free]
            return d, 1
        solves = 0
        if self.factor is not None:
            d, solves, solved = self._conjugate_gradients(r, tangents, held, PATIENCE)
            if solved:
                return d, solves
        self.keep(tangents, held)
        d, more, _ = self._conjugate_gradients(r, tangents, held, MOST_SOLVES)
        return d, solves + more

    def keep(self, tangents: FloatArray, held: BoolArray) -> None:
        """Keep the factor of A + tangent on the unknowns that are not held."""
        self.factorizations += 1
        self.kept = tangents.copy(), held.copy()
        self.factor = self.factors.factorised(tangents, held)
        self.added = np.where(held, np.inf, self._diagonal(tangents))

    def _diagonal(self, tangents: FloatArray) -> FloatArray:
        """Diagonal of the points' blocks, by unknown."""
        diagonal = np.zeros(self.diagonal.size)
        diagonal[self.first], diagonal[self.pairs[1]] = tangents[:, 0], tangents[self.both, 2]
        return diagonal

    def _conjugate_gradients(
        self, r: FloatArray, tangents: FloatArray, held: BoolArray, most: int
    ) -> tuple[FloatArray, int, bool]:
        """Direction, solves with the factor kept, and whether they were enough."""
        assert self.factor is not None
        now = self.diagonal + self._diagonal(tangents)
        then = self.diagonal + self.added
        # The factor where the tangent is as it was, the diagonal where it is not.
        share = np.minimum(1.0, then / now)
        rest = (1.0 - np.minimum(share, now / then)) / now
        share[np.isinf(then)] = 0.0
        changed = np.where(held, np.isfinite(then), rest * now > 0.5)
        if np.count_nonzero(changed) >= CHANGED:
            return r, 0, False
        share[held] = rest[held] = 0.0

        d, p, before = np.zeros_like(r), np.zeros_like(r), np.inf
        left, enough = r.copy(), FORCING * np.linalg.norm(r)
        for solves in range(1, most + 1):
            z = share * self.factor(share * left) + rest * left
            product = float(left @ z)
            p = z + product / before * p
            before = product
            image = times(self.A, p)
            _add_blocks(*self.points, tangents, p, image)
            image[held] = 0.0
            step = product / float(p @ image)
            d += step * p
            left -= step * image
            if np.linalg.norm(left) <= enough:
                return d, solves, True
        return d, most, False

    def _search(
        self, v: FloatArray, d: FloatArray, left: FloatArray, along: FloatArray
    ) -> tuple[float, int]:
        """Length along ``d`` that is the minimum, nearly, and not beyond it by much.

        ``left`` is g - A v, ``along`` A d.
        """
        quadratic, linear = float(d @ along), -float(d @ left)

        def slope(length: float) -> float:
            friction = _slope(*self.laws, v, d, length)
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
