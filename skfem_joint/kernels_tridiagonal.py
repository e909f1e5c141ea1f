"""Compiled implicit steps for tridiagonal systems whose slip rows each pick one unknown.

Every step solves the strictly convex problem H v + w sigma(v) = g for the new velocity v, with H
tridiagonal. Newton's iteration runs on the parameter s of the law's graph (see
:func:`skfem_joint.friction.graph_point`), not on v: both v(s) and sigma(s) are smooth with bounded
slopes however steep the law is.

Where no law is regularised, most steps need none of that: see :mod:`skfem_joint.kernels_fronts`.

Three tiers, each tried only when what comes before stalls:

1. Newton from the parameter extrapolated over the last two steps, or that of Coulomb's solution.
   Coulomb points that flip between stick and slip in a cycle are flipped one at a time once their
   number no longer falls, which ends after finitely many flips (Judice and Pires, Computers Ops
   Res. 21, 1994);
2. nested iteration: the same problem on a hierarchy of coarser chains (Galerkin), each level
   starting from the one below it, so that the slip front has to move a few nodes only on each level
   and the work stays proportional to the number of nodes;
3. Gauss-Seidel sweeps on the convex objective, which decrease it and converge from anywhere,
   with Newton steps accepted only when they decrease it further.

What does not converge after that is reported by status, never returned as a solution.

What was tried, in microseconds a step (reference system of the paper, 100 elements, 100 steps a
period, beta = 1e5, 7.4 iterations a step; one core of a 2-core virtual Intel Xeon):

=========================================================================  =====
one point after the other, library arctangent, elimination from one end     22.9
without numba's checks for division by zero                                 22.9
law on all points without branches, own arctangent, elimination from both   13.4
ends
=========================================================================  =====

Under the arctan law Newton's iteration starts from Coulomb's solution for some steps after a slow
one, unless the chain is so long that nested iteration is cheaper (beta = 1e5, run time of the whole
of ``integrate`` in milliseconds for three periods of 25, 50 and 100 steps, fastest of 60):

=========================================================================  ====  ====  ====
extrapolated parameter, then nested (23, 15 and 7.4 iterations a step)     2.43  3.53  4.38
the same with the cheaper steps from above                                 2.26  3.31  4.16
Coulomb's solution, then nested (10, 8.4 and 5.8)                          1.51  2.40  3.45
=========================================================================  ====  ====  ====

Where steps are fine or beta is small the extrapolated parameter is the better start, by up to a
half of the run time; at beta = 1e9 Coulomb's solution saves two thirds.

Extrapolating the parameter over two steps saves 4 % of the iterations at 100 steps a period and
14 % at 1000. Scaling the parameter by the diagonal of H instead of by the reach of friction
(``chain.KAPPA``) fails on most steps from 800 elements on.
"""

from __future__ import annotations

from math import atan, copysign, inf, log1p, pi, tan

import numpy as np

from skfem_joint.friction import ARCTAN, COULOMB, FREE
from skfem_joint.kernels_friction import compiled, graph, scalar_resolvent
from skfem_joint.kernels_fronts import ROUND_OFF, passes_of

FAST_ITERATIONS = 14
LEVEL_ITERATIONS = 100
LEVEL_TOLERANCE = 1e-4
#: Iterations after which flips between stick and slip are watched, and the flips in which their
#: number may fail to fall before they are done one at a time.
FREE_FLIPS = 12
PATIENCE = 4
ABOVE_ONE = float(np.nextafter(1.0, 2.0))
SWEEPS = 400
#: Largest normalised force at which a regularised point is taken to stick.
STEEPEST = 0.999
NEWTON_STEPS = 6
#: Iterations of a slow step, and for how many steps after one the start is another: Coulomb's
#: solution on chains up to a length, nested on longer ones.
SLOW = 8
PERSISTENCE = 30
LONGEST = 2000


@compiled
def _residual(H0, H1, w, g, v, sigma, r):
    """Residual r = H v + w sigma - g; its largest entry and that entry's row."""
    n = v.size
    last = n - 1
    for i in range(1, last):
        r[i] = H0[i] * v[i] + w[i] * sigma[i] - g[i] + H1[i - 1] * v[i - 1] + H1[i] * v[i + 1]
    if n == 1:
        r[0] = H0[0] * v[0] + w[0] * sigma[0] - g[0]
    else:
        r[0] = H0[0] * v[0] + w[0] * sigma[0] - g[0] + H1[0] * v[1]
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
    pivot_inverse = 0.0
    other_inverse = 0.0
    for j in range(middle):
        # From the first row down ...
        pivot = H0[j] * dv[j] + w[j] * dsigma[j]
        right = -r[j]
        if j > 0:
            lower = H1[j - 1] * dv[j - 1]
            pivot -= lower * factor[j - 1]
            right -= lower * x[j - 1]
        pivot_inverse = 1.0 / pivot
        factor[j] = H1[j] * dv[j + 1] * pivot_inverse
        x[j] = right * pivot_inverse
        # ... and from the last row up.
        k = n - 1 - j
        if k > middle:
            pivot = H0[k] * dv[k] + w[k] * dsigma[k]
            right = -r[k]
            if j > 0:
                upper = H1[k] * dv[k + 1]
                pivot -= upper * factor[k + 1]
                right -= upper * x[k + 1]
            other_inverse = 1.0 / pivot
            factor[k] = H1[k - 1] * dv[k - 1] * other_inverse
            x[k] = right * other_inverse
    pivot = H0[middle] * dv[middle] + w[middle] * dsigma[middle]
    right = -r[middle]
    if middle > 0:
        lower = H1[middle - 1] * dv[middle - 1]
        pivot -= lower * factor[middle - 1]
        right -= lower * x[middle - 1]
    if middle < n - 1:
        upper = H1[middle] * dv[middle + 1]
        pivot -= upper * factor[middle + 1]
        right -= upper * x[middle + 1]
    x[middle] = right / pivot
    for j in range(1, middle + 1):
        x[middle - j] -= factor[middle - j] * x[middle - j + 1]
        k = middle + j
        if k < n:
            x[k] -= factor[k] * x[k - 1]


@compiled
def _regularise(kind, v, sigma, kappa, inverse_beta, s):
    """Parameter where the arctan law comes near Coulomb's: at its velocity, or force in stick."""
    for i in range(v.size):
        if kind[i] == ARCTAN:
            force = min(abs(sigma[i]), STEEPEST)
            z = abs(v[i]) / inverse_beta[i] if v[i] != 0.0 else tan(0.5 * pi * force)
            s[i] = copysign(kappa * inverse_beta[i] * z + z / (1.0 + z), sigma[i])


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
    scale = 0.0
    for i in range(n):
        scale = max(scale, abs(g[i]))
    iteration = 0
    fewest = n + 1
    patience = PATIENCE
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
            v[i], sigma[i] = scalar_resolvent(right / w, chain.H0[i] / w, beta)
    for i in range(n):
        if chain.kind[i] == ARCTAN:
            width = chain.inverse_beta[i]
            z = abs(v[i]) / width
            s[i] = copysign(chain.kappa * width * z + z / (z + 1.0), v[i])
        else:
            s[i] = chain.kappa * v[i] + sigma[i]


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
        n_coarse = end - coarse
        shift = coarse - fine - 1 - 2 * (n_coarse - 1)  # fine index of the first coarse node
        for j in range(n_coarse):
            i = fine + 2 * j + shift
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
            n_coarse = start[k + 2] - b
            shift = b - a - 1 - 2 * (n_coarse - 1)
            for j in range(n_coarse):
                i = a + 2 * j + shift
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
    """Solve H v + w sigma(v) = g by the three tiers.

    Parameters
    ----------
    g, s : ndarray, shape (chain.start[-1],)
        Right-hand side and start of the parameter on the finest level; room for the others.
    work, trial : ndarray, shape (6, n) and (3, n)
        Room.

    Returns
    -------
    iterations, tier, converged, residual, row
        The solution is in ``work[0]`` (v), ``work[1]`` (sigma) and ``s`` (finest level).
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


@compiled
def _product(A0, A1, x, y):
    """Compute y = A x for a symmetric tridiagonal A."""
    for i in range(x.size):
        y[i] = A0[i] * x[i]
    for i in range(A1.size):
        y[i] += A1[i] * x[i + 1]
    for i in range(A1.size):
        y[i + 1] += A1[i] * x[i]


@compiled
def march(
    n_steps,
    first_step,
    every,
    fields_every,
    coefficients,
    bands,
    chain,
    tolerance,
    loads,
    amplitude,
    point_node,
    contact_node,
    state,
    sums,
    stored,
):
    """Advance ``n_steps`` equal steps in place and accumulate works, peaks and stored rows.

    Parameters
    ----------
    coefficients : tuple of float
        See :meth:`skfem_joint.schemes.Scheme.coefficients`.
    bands : tuple of ndarray
        Diagonals and off-diagonals of mass, damping and stiffness.
    chain : Chain
    loads : LoadRows
    amplitude : ndarray, shape (loads, n_steps + 1)
        N.
    state : ndarray, shape (7, n)
        Displacement, velocity, auxiliary acceleration, acceleration, s, previous s, sigma.
    sums : Sums
    stored : Rows

    Returns
    -------
    done, rows, field_rows, residual, row
        Steps completed (fewer than ``n_steps`` when a step did not converge), rows stored of
        the points and of the fields, and the residual (N) and unknown of the last solve.
    """
    h, c_M, c_K, u_v, u_a, y_a, y_d, a_v, a_a, d_a, d_a0, d_d0, trapezoidal = coefficients
    M0, M1, C0, C1, K0, K1 = bands
    # By name: an attribute that is looked up in a loop is counted as a reference each time.
    load_start, load_node, load_value = loads
    input_work, dissipated, friction_work, peak, slip_peak, counters = sums
    stored_u, stored_v, stored_sigma, stored_work, stored_point_u, stored_point_v = stored
    n = M0.size
    H0, H1, w, hold = chain.H0[:n], chain.H1[:n], chain.w[:n], chain.hold
    kind, inverse_beta = chain.kind[:n], chain.inverse_beta[:n]
    pivot, stretch, kappa, coulomb = chain.pivot, chain.stretch, chain.kappa, chain.mixed == 2
    u, v, a, d = state[0], state[1], state[2], state[3]
    s, s_old, sigma = state[4], state[5], state[6]
    s_all = np.empty(chain.start[-1])
    g = np.empty(chain.start[-1])
    right, s_fine = g[:n], s_all[:n]
    work = np.zeros((6, n))
    v_new, sigma_new, slip, r = work[0], work[1], work[2], work[4]
    trial = np.zeros((3, n))
    y = np.empty(n)
    image = np.empty(n)
    change = np.empty(n)
    mean = np.empty(n)
    drift = np.empty(n)
    rubbed = np.zeros(n)  # friction work and largest slip by unknown, in vector instructions
    farthest = np.zeros(n)
    for j in range(contact_node.size):
        rubbed[contact_node[j]] = friction_work[j]
        farthest[contact_node[j]] = slip_peak[j]
    middle = n // 2
    done = 0
    rows = 0
    field_rows = 0
    largest = 0.0
    row = 0
    for step in range(n_steps):
        for i in range(n):
            u[i] += u_v * v[i] + u_a * a[i]  # predictor; completed by c_K v below
            y[i] = c_M * v[i] + y_a * a[i] + y_d * d[i]
            s_all[i] = 2.0 * s[i] - s_old[i]
        _product(M0, M1, y, right)
        _product(K0, K1, u, image)
        for i in range(n):
            g[i] -= image[i]
        for k in range(load_start.size - 1):
            f = amplitude[k, step + 1]
            for j in range(load_start[k], load_start[k + 1]):
                g[load_node[j]] += f * load_value[j]
        iterations, converged, near, tier = 0, False, False, 0
        if coulomb:
            iterations, converged, middle = passes_of(
                H0, H1, w, hold, pivot, stretch, kappa, right, s_fine, v_new, sigma_new,
                slip, r, middle, tolerance,
            )  # fmt: skip
        if counters[5] > 0 and not coulomb and n <= LONGEST:
            iterations, near, middle = passes_of(
                H0, H1, w, w, pivot, stretch, kappa, right, s_fine, v_new, sigma_new,
                slip, r, middle, tolerance,
            )  # fmt: skip
            if near:
                _regularise(kind, v_new, sigma_new, kappa, inverse_beta, s_fine)
        if not converged:
            count, tier, converged, largest, row = solve_step(
                chain, g, s_all, work, trial, tolerance, counters[5] > 0 and not near
            )
            iterations += count
        counters[0] += iterations
        counters[3] += iterations + 1
        counters[4] = max(counters[4], iterations)
        if tier > 0:
            counters[tier] += 1
        if not converged:
            for i in range(n):
                u[i] -= u_v * v[i] + u_a * a[i]
            break
        if counters[5] == 0 and (tier == 1 or iterations > SLOW):
            counters[5] = PERSISTENCE
        elif counters[5] > 0:
            counters[5] -= 1
        # u holds the predictor: the step's change of displacement is what it adds to u.
        for i in range(n):
            change[i] = u_v * v[i] + u_a * a[i] + c_K * v_new[i]
            mean[i] = 0.5 * (v[i] + v_new[i])
        for i in range(n):
            u[i] += c_K * v_new[i]
            s_old[i] = s[i]
            s[i] = s_all[i]
        if not trapezoidal:
            for i in range(n):
                drift[i] = v[i] - v_new[i]
                y[i] = 0.5 * d[i]
        for i in range(n):
            a_new = a_v * (v_new[i] - v[i]) + a_a * a[i]
            d[i] = d_a * a_new + d_a0 * a[i] + d_d0 * d[i]
            a[i] = a_new
            v[i] = v_new[i]
        _product(C0, C1, mean, image)
        viscous = 0.0
        for i in range(n):
            viscous += image[i] * change[i]
        dissipated[0] += viscous
        if not trapezoidal:
            numerical = 0.0
            for i in range(n):
                y[i] += 0.5 * d[i]
                drift[i] += h * y[i]
            _product(M0, M1, y, image)
            for i in range(n):
                numerical += (change[i] - h * mean[i]) * image[i]
            _product(M0, M1, drift, image)
            for i in range(n):
                numerical += mean[i] * image[i]
            dissipated[1] += numerical
        for k in range(load_start.size - 1):
            f = 0.5 * (amplitude[k, step] + amplitude[k, step + 1])
            for j in range(load_start[k], load_start[k + 1]):
                input_work[k] += f * load_value[j] * change[load_node[j]]
        for i in range(n):
            rubbed[i] += 0.5 * w[i] * (sigma[i] + sigma_new[i]) * change[i]
            farthest[i] = abs(u[i]) if abs(u[i]) > farthest[i] else farthest[i]
            sigma[i] = sigma_new[i]
        for j in range(point_node.size):
            peak[j] = max(peak[j], abs(u[point_node[j]]))
        if stored_u.shape[0] > 0 and (first_step + step + 1) % fields_every == 0:
            for i in range(n):
                stored_u[field_rows, i] = u[i]
                stored_v[field_rows, i] = v[i]
            for j in range(contact_node.size):
                stored_sigma[field_rows, j] = sigma[contact_node[j]]
                stored_work[field_rows, j] = rubbed[contact_node[j]]
            field_rows += 1
        if stored_point_u.shape[0] > 0 and (first_step + step + 1) % every == 0:
            for j in range(point_node.size):
                stored_point_u[rows, j] = u[point_node[j]]
                stored_point_v[rows, j] = v[point_node[j]]
            rows += 1
        done += 1
    for j in range(contact_node.size):
        friction_work[j] = rubbed[contact_node[j]]
        slip_peak[j] = farthest[contact_node[j]]
    return done, rows, field_rows, largest, row
