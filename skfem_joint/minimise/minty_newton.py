"""Newton's method on the law's graph, for chains: three tiers, each tried if the last has failed.

The unknown is the parameter s of the law's graph (Minty's, :func:`skfem_joint.minimise.law.graph`),
not the velocity: v(s) and sigma(s) are smooth with bounded slopes however steep the law is.

1. Newton from the given start. Coulomb points may flip between stick and slip in a cycle. Once the
   number of flips no longer falls only a single point is flipped at a time, which ends after
   finitely many flips (Judice and Pires, Computers Ops Res. 21, 1994).
2. Nested iteration: the same problem on a hierarchy of coarser chains (Galerkin). Each level starts
   from the solution on the next coarser level. The slip front then moves by a few nodes only on
   each level, and the work stays proportional to the number of nodes.
3. Gauss-Seidel sweeps on the convex objective, which decrease it and converge from any start, with
   Newton steps accepted only if they decrease it further.
"""

# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import copysign, inf

import numpy as np

from skfem_joint.ground.compiling import compiled, compiled_inside
from skfem_joint.linalg.kernels import largest_entry, largest_of
from skfem_joint.minimise.law import (
    COULOMB,
    FREE,
    REGULAR,
    add_springs,
    graph,
    graph_parameters,
    sprung_force,
    sprung_psi,
    sprung_resolvent,
    sticks,
)

# Newton iterations on each level.
_LEVEL = 100
# Iterations in which the number of flips may fail to fall before single flips are made.
_PATIENCE = 4
# Descents of the third tier.
_SWEEPS = 400
#: Accepted residual on chains in units of the forces that are added up.
ROUND_OFF = 8 * float(np.finfo(np.float64).eps)


_ABOVE_ONE = float(np.nextafter(1.0, 2.0))


@compiled_inside
def _residual(H0, H1, w, g, v, sigma, r):
    """Residual r = H v + w sigma - g; its largest entry and that entry's row."""
    last = v.size - 1
    for i in range(1, last):
        r[i] = H0[i] * v[i] + w[i] * sigma[i] - g[i] + H1[i - 1] * v[i - 1] + H1[i] * v[i + 1]
    r[0] = H0[0] * v[0] + w[0] * sigma[0] - g[0]
    if last > 0:
        r[0] += H1[0] * v[1]
        r[last] = H0[last] * v[last] + w[last] * sigma[last] - g[last] + H1[last - 1] * v[last - 1]
    return largest_entry(r)


@compiled_inside
def _round_off(H0, v, s, dv):
    """Round-off of the residual: that of v, and that of s, which moves v by dv."""
    largest = 0.0
    for i in range(v.size):
        largest = max(largest, H0[i] * (abs(v[i]) + abs(s[i]) * dv[i]))
    return ROUND_OFF * largest


@compiled_inside
def _law_of(chain, i):
    """Steepness of a point, s/m, compliance of its spring, m/s, and offset of its slip, m/s."""
    beta = 1.0 / chain.inverse_beta[i] if chain.kind[i] == REGULAR else inf
    if chain.soft.size == 0:
        return beta, 0.0, 0.0
    return beta, chain.soft[i], chain.offset[i]


@compiled_inside
def _force_at_rest(chain, begin, end):
    """Largest force of springs on points at rest, N: a scale where no load acts."""
    largest = 0.0
    for i in range(begin, end):
        beta, soft, offset = _law_of(chain, i)
        if soft > 0.0:
            largest = max(largest, chain.w[i] * sprung_force(abs(offset), beta, soft))
    return largest


@compiled_inside
def _round_off_of_springs(H0, soft, offset, sigma):
    """Round-off of the residual by the slips of springs, under their forces, and their offsets."""
    largest = 0.0
    for i in range(soft.size):
        largest = max(largest, H0[i] * (soft[i] * abs(sigma[i]) + abs(offset[i])))
    return ROUND_OFF * largest


@compiled_inside
def _eliminate(H0, H1, w, dv, dsigma, r, x, factor):
    """Solve (H D + w S) x = -r, D and S the diagonals dv and dsigma; x may be r.

    No pivoting: the matrix is symmetric positive definite up to its column scaling (with unit
    columns where Coulomb points stick). Elimination runs from both ends to the middle: two
    independent sequences of divisions take little longer than a single sequence of the same length.
    """
    n = r.size
    middle = n // 2
    # Updates of the next pivot and right side by the eliminated points, from both ends.
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


@compiled_inside
def _direction(s):
    """Sign of a Coulomb point's slip; 0 if it sticks."""
    return 0 if sticks(s, 1.0) else (1 if s > 0.0 else -1)


@compiled
def _newton(chain, level, g, s, work, limit, tolerance):
    """Newton iteration on s at one level; returns iterations, converged, residual (N) and its row.

    ``work`` holds v, sigma, dv, dsigma, r and the elimination factors, row by row.
    """
    sprung = chain.soft.size > 0
    a, b = chain.start[level], chain.start[level + 1]
    n = b - a
    H0, H1, w = chain.H0[a:b], chain.H1[a:b], chain.w[a:b]
    kind, inverse_beta = chain.kind[a:b], chain.inverse_beta[a:b]
    g, s = g[a:b], s[a:b]
    v, sigma, dv = work[0, :n], work[1, :n], work[2, :n]
    dsigma, r, factor = work[3, :n], work[4, :n], work[5, :n]
    scale, added = largest_of(g), 0.0
    if sprung:
        scale = max(scale, _force_at_rest(chain, a, b))
    iteration, fewest, patience = 0, n + 1, _PATIENCE
    while True:
        graph(kind, chain.mixed, chain.kappa, inverse_beta, s, v, sigma, dv, dsigma)
        if sprung:
            add_springs(chain.soft[a:b], chain.offset[a:b], v, sigma, dv, dsigma)
            added = _round_off_of_springs(H0, chain.soft[a:b], chain.offset[a:b], sigma)
        largest, row = _residual(H0, H1, w, g, v, sigma, r)
        if largest <= tolerance * scale or largest <= _round_off(H0, v, s, dv) + added:
            return iteration, True, largest, row
        if iteration == limit or not largest < inf:
            return iteration, False, largest, row
        iteration += 1
        _eliminate(H0, H1, w, dv, dsigma, r, r, factor)
        # Flips between stick and slip are watched only later.
        if chain.mixed == 0 or iteration <= 12:
            for i in range(n):
                s[i] += r[i]
            continue
        flips = 0
        last = -1
        noise = max(tolerance * scale, _round_off(H0, v, s, dv) + added)
        for i in range(n):
            before = _direction(s[i])
            s[i] += r[i]
            factor[i] = before
            if kind[i] == COULOMB and _direction(s[i]) != before:
                # A flip within the noise of the residual is none: stay at the edge.
                beyond = abs(abs(s[i]) - 1.0)
                if beyond * (w[i] if before == 0 else H0[i] / chain.kappa) <= noise:
                    s[i] = copysign(1.0, s[i]) if before == 0 else before * _ABOVE_ONE
                else:
                    flips += 1
                    last = i
        if flips < fewest:
            fewest = flips
            patience = _PATIENCE
        else:
            patience -= 1
        if patience < 0:
            for i in range(last):
                before = factor[i]
                if kind[i] == COULOMB and _direction(s[i]) != before:
                    s[i] = min(max(s[i], -1.0), 1.0) if before == 0 else before * _ABOVE_ONE


@compiled_inside
def _objective(chain, g, v):
    """Convex objective 1/2 v H v - g v + sum w psi(v) whose minimiser is the step's velocity."""
    total = 0.0
    for i in range(v.size):
        t = 0.5 * chain.H0[i] * v[i] - g[i]
        if i > 0:
            t += chain.H1[i - 1] * v[i - 1]
        beta, soft, offset = _law_of(chain, i)
        total += t * v[i] + chain.w[i] * sprung_psi(v[i] - offset, beta, soft)
    return total


@compiled_inside
def _sweep(chain, g, v, sigma, s, z):
    """One Gauss-Seidel sweep down and up the finest chain; s is set to that of v and sigma."""
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
            z[i] = v[i] = right / chain.H0[i]
        else:
            beta, soft, offset = _law_of(chain, i)
            right -= chain.H0[i] * offset
            slip, sigma[i] = sprung_resolvent(right / w, chain.H0[i] / w, beta, soft)
            v[i], z[i] = slip + offset, slip - soft * sigma[i]
    graph_parameters(chain.kind, chain.kappa, chain.inverse_beta, z, sigma, s)


@compiled
def _descend(chain, g, s, work, trial, tolerance):
    """Third tier: sweeps, and Newton steps that decrease the objective; returns as `_newton`."""
    n = chain.start[1]
    v, sigma = work[0, :n], work[1, :n]
    # Plain integers: numba compiles a function once more for each literal argument.
    finest, few = np.int64(0), np.int64(6)
    largest, row = inf, 0
    for sweep in range(_SWEEPS):
        _sweep(chain, g, v, sigma, s, work[4, :n])
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
    return _SWEEPS, False, largest, row


@compiled
def _nested(chain, g, s, work, tolerance):
    """Second tier: solve from coarse to fine; returns the same as `_newton`."""
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
            if chain.soft.size > 0:
                chain.offset[coarse + j] = chain.offset[i]
    iterations = 0
    limit = np.int64(_LEVEL)
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
        # Solutions on coarse levels only serve as starts.
        count, converged, largest, row = _newton(
            chain, k, g, s, work, limit, tolerance if k == 0 else 1e-4
        )
        iterations += count
        if not largest < inf:
            break
    return iterations, converged, largest, row


@compiled
def newton_on_graph(chain, g, s, work, trial, tolerance, start_nested):
    """Solve H v + w sigma(v) = g by the tiers; returns iterations, tier (0 to 2), and as `_newton`.

    ``g`` and ``s`` hold the right side and the start of the parameter on the finest level. The
    solution is in ``work[0]`` (v), ``work[1]`` (sigma) and ``s``.
    """
    deep = chain.start.size > 2
    iterations = 0
    if not start_nested:
        # Chains that have coarser ones soon go on to the second tier.
        limit = np.int64(14 if deep else _LEVEL)
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
