"""Compiled solution of a step on a chain: slip fronts first, then three tiers.

Every step solves the strictly convex problem H v + w sigma(v) = g for the new velocity v, with H
tridiagonal.

**Fronts** (no law regularised). A point that sticks separates its neighbours, so that elimination
can decide stick and slip as it goes: towards a meeting point that is at rest each point slips if it
would beside its inner neighbour's velocity of before, and on the way back each obeys its law. One
such pass moves a slip front over any number of nodes, where Newton's moves it by about one.

**Tiers**. Newton's iteration runs on the parameter s of the law's graph (see
:func:`skfem_joint.stepping.compiled.graph`), not on v: both v(s) and sigma(s) are smooth with
bounded slopes however steep the law is. Each tier is tried only when what comes before stalls:

1. Newton from the parameter extrapolated over the last two steps, or that of Coulomb's solution.
   Coulomb points that flip between stick and slip in a cycle are flipped one at a time once their
   number no longer falls, which ends after finitely many flips (Judice and Pires, Computers Ops
   Res. 21, 1994);
2. nested iteration: the same problem on a hierarchy of coarser chains (Galerkin), each level
   starting from the one below it, so that the slip front has to move a few nodes only on each level
   and the work stays proportional to the number of nodes;
3. Gauss-Seidel sweeps on the convex objective, which decrease it and converge from anywhere,
   with Newton steps accepted only when they decrease it further.

Passes start from rest: from the velocities of the last step they may alternate between two wrong
states.
"""

# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import atan, copysign, inf, log1p, pi

import numpy as np

from skfem_joint.friction import ARCTAN, COULOMB, FREE
from skfem_joint.stepping.compiled import compiled, graph, largest_of, parameters, resolvent

#: Passes under Coulomb friction: those that are not enough by then seldom ever are.
PASSES = 8
ROUND_OFF = 8 * np.finfo(np.float64).eps
#: Newton iterations before nesting, and on each level, to which share of the forces.
FAST_ITERATIONS, LEVEL_ITERATIONS, LEVEL_TOLERANCE = 14, 100, 1e-4
#: Iterations after which flips between stick and slip are watched, and the flips in which their
#: number may fail to fall before they are done one at a time.
FREE_FLIPS, PATIENCE = 12, 4
ABOVE_ONE = float(np.nextafter(1.0, 2.0))
#: Descents, and Newton steps in each.
SWEEPS, NEWTON_STEPS = 400, 6

# Fronts


@compiled
def _meeting_point(v, middle):
    """Middle of the longest run of points at rest; ``middle`` if none is."""
    longest = 0
    begin = 0
    for i in range(v.size + 1):
        if i == v.size or v[i] != 0.0:
            if i - begin > longest:
                longest = i - begin
                middle = (begin + i) // 2
            begin = i + 1
    return middle


@compiled
def _inwards(H0, H1, w, hold, pivot, stretch, g, v, slip, middle):
    """Eliminate from both ends to the meeting point, deciding stick and slip on the way.

    A point slips if it would with its inner neighbour at the velocity that ``v`` has for it.
    Leaves the sign of the slip in ``slip`` and, in ``v``, the velocity with the inner neighbour
    at rest. Runs of points in the same state have loops of their own: the next point then need
    not wait for the decision on the one before.
    """
    # Unsigned indices, which wrap: signed ones are checked for counting from an array's end.
    one, end = np.uint64(1), np.uint64(middle)
    t = g[end]
    diagonal = H0[end]
    for side in range(2):
        way = one if side == 0 else -one
        inner = np.uint64(0) if side == 0 else -one  # H1[j + inner] is inside of point j
        j = np.uint64(0) if side == 0 else np.uint64(v.size - 1)
        first = j  # where the stretch of slipping points begins
        x = 0.0
        outer = 0.0
        while j != end:
            held = g[j] - outer * x - H1[j + inner] * v[j + way]
            if abs(held) <= hold[j]:
                x = slip[j] = v[j] = 0.0
                j += way
                while j != end and abs(g[j] - H1[j + inner] * v[j + way]) <= hold[j]:
                    slip[j] = v[j] = 0.0
                    j += way
                first = j
                continue
            sign = copysign(1.0, held)
            while True:
                if stretch[j] != np.int64(first):
                    stretch[j] = first
                    taken = 0.0 if j == first else outer * outer * pivot[j - way]
                    pivot[j] = 1.0 / (H0[j] - taken)
                x = (g[j] - sign * w[j]) * pivot[j] - (outer * pivot[j]) * x
                v[j] = x
                slip[j] = sign
                outer = H1[j + inner]
                j += way
                if j == end or not sign * (g[j] - outer * x - H1[j + inner] * v[j + way]) > hold[j]:
                    break
        if first != end:
            t -= outer * x
            diagonal -= outer * outer * pivot[end - way]
    v[end] = 0.0 if abs(t) <= hold[end] else (t - copysign(w[end], t)) / diagonal


@compiled
def _outwards(H0, H1, w, hold, pivot, g, v, slip, middle):
    """Go back to the ends: each point obeys its law at the inner neighbour's new velocity."""
    one, start = np.uint64(1), np.uint64(middle)
    for side in range(2):
        way = one if side == 1 else -one
        inner = np.uint64(0) if side == 0 else -one
        end = -one if side == 0 else np.uint64(v.size)
        i = start + way
        x = v[start]
        while i != end:
            while i != end:
                slipping = v[i] - (H1[i + inner] * pivot[i]) * x
                if not slipping * slip[i] > 0.0:
                    break
                x = v[i] = slipping
                i += way
            if x == 0.0:
                # Between points at rest; the outermost point is left to the lines below.
                while i != end and i + way != end:
                    if slip[i] != 0.0 or slip[i + way] != 0.0 or not abs(g[i]) <= hold[i]:
                        break
                    i += way
            if i == end:
                break
            t = g[i] - H1[i + inner] * x
            diagonal = H0[i]
            if i + way != end and slip[i + way] != 0.0:
                outer = H1[i + inner + way]
                t -= outer * v[i + way]
                diagonal -= outer * outer * pivot[i + way]
            x = v[i] = 0.0 if abs(t) <= hold[i] else (t - copysign(w[i], t)) / diagonal
            i += way


@compiled
def _friction_and_residual(H0, H1, w, g, v, friction, r):
    """Friction that holds the points at rest and opposes the others, and what it leaves over."""
    last = v.size - 1
    r[0] = H0[0] * v[0] - g[0]
    if last > 0:
        r[0] += H1[0] * v[1]
        r[last] = H0[last] * v[last] - g[last] + H1[last - 1] * v[last - 1]
    for i in range(1, last):
        r[i] = H0[i] * v[i] - g[i] + H1[i - 1] * v[i - 1] + H1[i] * v[i + 1]
    for i in range(v.size):
        friction[i] = min(max(-r[i], -w[i]), w[i]) if v[i] == 0.0 else copysign(w[i], v[i])
        r[i] += friction[i]


@compiled
def _beyond(x, bound):
    """How many entries are larger than a bound, or not numbers."""
    count = 0
    for i in range(x.size):
        count += not abs(x[i]) <= bound
    return count


@compiled
def passes_of(H0, H1, w, hold, pivot, stretch, kappa, g, s, v, sigma, slip, r, middle, tolerance):
    """Eliminations that decide stick and slip on their way, the first from rest.

    Returns passes, whether the last one solves the step's problem, and where they met at last.
    """
    bound = tolerance * largest_of(g)
    for i in range(v.size):
        v[i] = 0.0
    passes = 0
    converged = False
    while passes < PASSES and not converged:
        passes += 1
        if v[middle] != 0.0:  # slip spreads fast towards the meeting point alone
            middle = _meeting_point(v, middle)
        _inwards(H0, H1, w, hold, pivot, stretch, g, v, slip, middle)
        _outwards(H0, H1, w, hold, pivot, g, v, slip, middle)
        _friction_and_residual(H0, H1, w, g, v, sigma, r)
        converged = _beyond(r, bound) == 0
        if not converged:
            for i in range(v.size):
                slip[i] = H0[i] * v[i]
            converged = _beyond(r, ROUND_OFF * largest_of(slip)) == 0
    if converged:
        for i in range(v.size):
            sigma[i] = sigma[i] / w[i] if hold[i] > 0.0 else 0.0
            s[i] = kappa * v[i] + sigma[i]
    return passes, converged, middle


# Tiers


@compiled
def _residual(H0, H1, w, g, v, sigma, r):
    """Residual r = H v + w sigma - g; its largest entry and that entry's row."""
    n, last = v.size, v.size - 1
    for i in range(1, last):
        r[i] = H0[i] * v[i] + w[i] * sigma[i] - g[i] + H1[i - 1] * v[i - 1] + H1[i] * v[i + 1]
    r[0] = H0[0] * v[0] + w[0] * sigma[0] - g[0]
    if last > 0:
        r[0] += H1[0] * v[1]
        r[last] = H0[last] * v[last] + w[last] * sigma[last] - g[last] + H1[last - 1] * v[last - 1]
    largest = 0.0
    row = 0
    for i in range(n):
        size = abs(r[i])
        if not size <= largest and largest == largest:  # a residual that is not a number stays
            largest = size
            row = i
    return largest, row


@compiled
def _round_off(H0, v, s, dv):
    """Round-off of the residual: that of v, and that of s, which moves v by dv."""
    largest = 0.0
    for i in range(v.size):
        largest = max(largest, H0[i] * (abs(v[i]) + abs(s[i]) * dv[i]))
    return ROUND_OFF * largest


@compiled
def _eliminate(H0, H1, w, dv, dsigma, r, x, factor):
    """Solve (H D + w S) x = -r, D and S the diagonals dv and dsigma; x may be r.

    No pivoting: the matrix is symmetric positive definite up to its column scaling (with unit
    columns where Coulomb points stick). Elimination runs from both ends to the middle: two
    independent chains of divisions take little longer than one.
    """
    n = r.size
    middle = n // 2
    # What the points before take from the next one's pivot and right side, from both ends.
    taken, moved, other_taken, other_moved = 0.0, 0.0, 0.0, 0.0
    for j in range(middle):
        # From the first row down ...
        inverse = 1.0 / (H0[j] * dv[j] + w[j] * dsigma[j] - taken)
        factor[j] = H1[j] * dv[j + 1] * inverse
        x[j] = (-r[j] - moved) * inverse
        taken, moved = H1[j] * dv[j] * factor[j], H1[j] * dv[j] * x[j]
        # ... and from the last row up.
        k = n - 1 - j
        if k > middle:
            inverse = 1.0 / (H0[k] * dv[k] + w[k] * dsigma[k] - other_taken)
            factor[k] = H1[k - 1] * dv[k - 1] * inverse
            x[k] = (-r[k] - other_moved) * inverse
            other_taken, other_moved = H1[k - 1] * dv[k] * factor[k], H1[k - 1] * dv[k] * x[k]
    pivot = H0[middle] * dv[middle] + w[middle] * dsigma[middle] - taken - other_taken
    x[middle] = (-r[middle] - moved - other_moved) / pivot
    for j in range(1, middle + 1):
        x[middle - j] -= factor[middle - j] * x[middle - j + 1]
        k = middle + j
        if k < n:
            x[k] -= factor[k] * x[k - 1]


@compiled
def _slips(s):
    """Sign of a Coulomb point's slip; 0 if it sticks."""
    return 1 if s > 1.0 else (-1 if s < -1.0 else 0)


@compiled
def _newton(chain, level, g, s, work, limit, tolerance):
    """Newton iteration on s at one level; returns iterations, converged, residual and its row.

    ``work`` holds v, sigma, dv, dsigma, r and the elimination factors, row by row.
    """
    a, b = chain.start[level], chain.start[level + 1]
    n = b - a
    H0, H1, w = chain.H0[a:b], chain.H1[a:b], chain.w[a:b]
    kind, inverse_beta = chain.kind[a:b], chain.inverse_beta[a:b]
    g, s = g[a:b], s[a:b]
    v, sigma, dv = work[0, :n], work[1, :n], work[2, :n]
    dsigma, r, factor = work[3, :n], work[4, :n], work[5, :n]
    scale = largest_of(g)
    iteration, fewest, patience = 0, n + 1, PATIENCE
    while True:
        graph(kind, chain.mixed, chain.kappa, inverse_beta, s, v, sigma, dv, dsigma)
        largest, row = _residual(H0, H1, w, g, v, sigma, r)
        if largest <= tolerance * scale or largest <= _round_off(H0, v, s, dv):
            return iteration, True, largest, row
        if iteration == limit or not largest < inf:
            return iteration, False, largest, row
        iteration += 1
        _eliminate(H0, H1, w, dv, dsigma, r, r, factor)
        if chain.mixed == 0 or iteration <= FREE_FLIPS:
            for i in range(n):
                s[i] += r[i]
            continue
        flips = 0
        last = -1
        noise = max(tolerance * scale, _round_off(H0, v, s, dv))
        for i in range(n):
            before = _slips(s[i])
            s[i] += r[i]
            factor[i] = before
            if kind[i] == COULOMB and _slips(s[i]) != before:
                # A flip within the noise of the residual is none: stay at the edge.
                beyond = abs(abs(s[i]) - 1.0)
                if beyond * (w[i] if before == 0 else H0[i] / chain.kappa) <= noise:
                    s[i] = copysign(1.0, s[i]) if before == 0 else before * ABOVE_ONE
                else:
                    flips += 1
                    last = i
        if flips < fewest:
            fewest = flips
            patience = PATIENCE
        else:
            patience -= 1
        if patience < 0:
            for i in range(last):
                before = factor[i]
                if kind[i] == COULOMB and _slips(s[i]) != before:
                    s[i] = min(max(s[i], -1.0), 1.0) if before == 0 else before * ABOVE_ONE


@compiled
def _objective(chain, g, v):
    """Convex objective 1/2 v H v - g v + sum w psi(v) whose minimiser is the step's velocity."""
    total = 0.0
    for i in range(v.size):
        t = 0.5 * chain.H0[i] * v[i] - g[i]
        if i > 0:
            t += chain.H1[i - 1] * v[i - 1]
        total += t * v[i]
        if chain.kind[i] == ARCTAN:
            width = chain.inverse_beta[i]
            z = v[i] / width
            psi = 2.0 / pi * (v[i] * atan(z) - 0.5 * log1p(z * z) * width)
        else:
            psi = abs(v[i])
        total += chain.w[i] * psi
    return total


@compiled
def _sweep(chain, g, v, sigma, s):
    """One Gauss-Seidel sweep down and up the finest chain; s follows v and sigma."""
    n = chain.start[1]
    for j in range(2 * n):
        i = j if j < n else 2 * n - 1 - j
        right = g[i]
        if i > 0:
            right -= chain.H1[i - 1] * v[i - 1]
        if i < n - 1:
            right -= chain.H1[i] * v[i + 1]
        w = chain.w[i]
        if chain.kind[i] == FREE:
            v[i] = right / chain.H0[i]
        else:
            beta = 1.0 / chain.inverse_beta[i] if chain.kind[i] == ARCTAN else inf
            v[i], sigma[i] = resolvent(right / w, chain.H0[i] / w, beta)
    parameters(chain.kind, chain.kappa, chain.inverse_beta, v, sigma, s)


@compiled
def _descend(chain, g, s, work, trial, tolerance):
    """Gauss-Seidel on the objective, Newton steps accepted on decrease; returns as `_newton`."""
    n = chain.start[1]
    v, sigma = work[0, :n], work[1, :n]
    # Plain integers: numba compiles a function anew for each literal that it is called with.
    finest, few = np.int64(0), np.int64(NEWTON_STEPS)
    largest, row = inf, 0
    for sweep in range(SWEEPS):
        _sweep(chain, g, v, sigma, s)
        best = _objective(chain, g, v)
        for i in range(n):
            trial[0, i] = v[i]
            trial[1, i] = sigma[i]
            trial[2, i] = s[i]
        _, converged, largest, row = _newton(chain, finest, g, s, work, few, tolerance)
        if converged:
            return sweep + 1, True, largest, row
        if not _objective(chain, g, v) < best:
            for i in range(n):
                v[i] = trial[0, i]
                sigma[i] = trial[1, i]
                s[i] = trial[2, i]
    return SWEEPS, False, largest, row


@compiled
def _nested(chain, g, s, work, tolerance):
    """Solve coarse to fine, each level from the one below it; returns as `_newton`."""
    start = chain.start
    levels = start.size - 1
    for k in range(levels - 1):
        fine, coarse, end = start[k], start[k + 1], start[k + 2]
        for j in range(end - coarse):
            i = fine + 2 * j + (coarse - fine - 1) % 2  # the last node stays
            t = g[i]
            if i > fine:
                t += 0.5 * g[i - 1]
            if i < coarse - 1:
                t += 0.5 * g[i + 1]
            g[coarse + j] = t
    iterations = 0
    limit = np.int64(LEVEL_ITERATIONS)
    converged, largest, row = False, inf, 0
    for k in range(levels - 1, -1, -1):
        a, b = start[k], start[k + 1]
        if k == levels - 1:
            s[a:b] = 0.0
        else:
            for j in range(start[k + 2] - b):
                i = a + 2 * j + (b - a - 1) % 2
                s[i] = s[b + j]
                if i > a:
                    s[i - 1] = 0.5 * (s[b + j] + (s[b + j - 1] if j > 0 else 0.0))
        count, converged, largest, row = _newton(
            chain, k, g, s, work, limit, tolerance if k == 0 else LEVEL_TOLERANCE
        )
        iterations += count
        if not largest < inf:
            break
    return iterations, converged, largest, row


@compiled
def solve_step(chain, g, s, work, trial, tolerance, start_nested):
    """Solve H v + w sigma(v) = g by the three tiers; returns iterations, tier, and as `_newton`.

    ``g`` and ``s`` hold the right side and the start of the parameter on the finest level. The
    solution is in ``work[0]`` (v), ``work[1]`` (sigma) and ``s``.
    """
    deep = chain.start.size > 2
    iterations = 0
    if not start_nested:
        limit = np.int64(FAST_ITERATIONS if deep else LEVEL_ITERATIONS)
        finest = np.int64(0)
        iterations, converged, largest, row = _newton(chain, finest, g, s, work, limit, tolerance)
        if converged:
            return iterations, 0, True, largest, row
    if deep:
        count, converged, largest, row = _nested(chain, g, s, work, tolerance)
        iterations += count
        if converged:
            return iterations, 1, True, largest, row
    if not largest < inf:
        work[:2] = 0.0
    count, converged, largest, row = _descend(chain, g, s, work, trial, tolerance)
    return iterations + count, 2, converged, largest, row
