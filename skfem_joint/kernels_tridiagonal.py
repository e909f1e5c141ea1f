"""Compiled implicit steps for tridiagonal systems whose slip rows each pick one unknown.

Every step solves the strictly convex problem H v + w sigma(v) = g for the new velocity v, with H
tridiagonal. Newton's iteration runs on the parameter s of the law's graph (see
:func:`skfem_joint.friction.graph_point`), not on v: both v(s) and sigma(s) are smooth with bounded
slopes however steep the law is. Three tiers, each tried only when the one before stalls:

1. Newton from the parameter extrapolated over the last two steps;
2. nested iteration: the same problem on a hierarchy of coarser chains (Galerkin), each level
   starting from the one below it, so that the slip front has to move a few nodes only on each level
   and the work stays proportional to the number of nodes;
3. Gauss-Seidel sweeps on the convex objective, which decrease it and converge from anywhere,
   with Newton steps accepted only when they decrease it further.

What does not converge after that is reported by status, never returned as a solution.
"""

from __future__ import annotations

from math import atan, inf, log1p, pi, sqrt

import numpy as np
from numba import njit

from skfem_joint import friction

_graph_point = njit(cache=True, inline="always")(friction.graph_point)

FAST_ITERATIONS = 14
LEVEL_ITERATIONS = 40
SWEEPS = 400
NESTED_PERSISTENCE = 30
ROUND_OFF = 16 * np.finfo(np.float64).eps


@njit(cache=True)
def _residual(H0, H1, w, g, v, sigma, r):
    """Residual r = H v + w sigma - g; its largest entry, that entry's row, and its round-off."""
    n = v.size
    largest = 0.0
    row = 0
    round_off = 0.0
    for i in range(n):
        t = H0[i] * v[i] + w[i] * sigma[i] - g[i]
        if i > 0:
            t += H1[i - 1] * v[i - 1]
        if i < n - 1:
            t += H1[i] * v[i + 1]
        r[i] = t
        if not abs(t) <= largest:  # also catches a residual that is not a number
            largest = abs(t)
            row = i
        round_off = max(round_off, H0[i] * abs(v[i]))
    return largest, row, ROUND_OFF * round_off


@njit(cache=True)
def _newton(H0, H1, w, beta, kappa, g, s, work, limit, tolerance):
    """Newton iteration on s; returns iterations, converged, residual and its row.

    ``work`` holds v, sigma, dv, dsigma, r and the elimination factors, row by row.
    """
    n = g.size
    v, sigma, dv, dsigma, r, factor = work[0], work[1], work[2], work[3], work[4], work[5]
    scale = 0.0
    for i in range(n):
        scale = max(scale, abs(g[i]))
    iteration = 0
    while True:
        for i in range(n):
            if w[i] > 0.0:
                v[i], sigma[i], dv[i], dsigma[i] = _graph_point(s[i], kappa, beta[i])
            else:
                v[i] = s[i] / kappa
                sigma[i] = 0.0
                dv[i] = 1.0 / kappa
                dsigma[i] = 0.0
        largest, row, round_off = _residual(H0, H1, w, g, v, sigma, r)
        if largest <= max(tolerance * scale, round_off):
            return iteration, True, largest, row
        if iteration == limit or not largest < inf:
            return iteration, False, largest, row
        iteration += 1
        # Elimination without pivoting: the Jacobian is a symmetric positive definite matrix
        # with scaled columns (and unit columns where Coulomb points stick).
        pivot = H0[0] * dv[0] + w[0] * dsigma[0]
        r[0] = -r[0] / pivot
        for i in range(1, n):
            lower = H1[i - 1] * dv[i - 1]
            factor[i - 1] = H1[i - 1] * dv[i] / pivot
            pivot = H0[i] * dv[i] + w[i] * dsigma[i] - lower * factor[i - 1]
            r[i] = (-r[i] - lower * r[i - 1]) / pivot
        s[n - 1] += r[n - 1]
        for i in range(n - 2, -1, -1):
            r[i] -= factor[i] * r[i + 1]
            s[i] += r[i]


@njit(cache=True)
def _scalar_resolvent(x, k, beta):
    """Solve k v + sigma(v) = x for one point; returns v and sigma."""
    if beta == inf:
        if abs(x) <= 1.0:
            return 0.0, x
        v = (abs(x) - 1.0) / k
        return (v, 1.0) if x > 0.0 else (-v, -1.0)
    magnitude = abs(x)
    k = k / beta
    c = pi / 2.0
    b = magnitude - 1.0 - k * c
    root = sqrt(b * b + 4.0 * k * c * magnitude)
    z = (b + root) / (2.0 * k) if b > 0.0 else 2.0 * c * magnitude / (root - b)
    for _ in range(60):
        step = (k * z + 2.0 / pi * atan(z) - magnitude) / (k + 2.0 / pi / (1.0 + z * z))
        z_next = max(z - step, 0.0)
        if abs(z_next - z) <= 4e-16 * z:
            break
        z = z_next
    sigma = 2.0 / pi * atan(z)
    return (z / beta, sigma) if x > 0.0 else (-z / beta, -sigma)


@njit(cache=True)
def _objective(H0, H1, w, beta, g, v):
    """Convex objective 1/2 v H v - g v + sum w psi(v) whose minimiser is the step's velocity."""
    total = 0.0
    for i in range(v.size):
        t = 0.5 * H0[i] * v[i] - g[i]
        if i > 0:
            t += H1[i - 1] * v[i - 1]
        total += t * v[i]
        if w[i] > 0.0:
            if beta[i] == inf:
                total += w[i] * abs(v[i])
            else:
                z = beta[i] * v[i]
                total += w[i] * 2.0 / pi * (v[i] * atan(z) - 0.5 * log1p(z * z) / beta[i])
    return total


@njit(cache=True)
def _descend(H0, H1, w, beta, kappa, g, s, work, trial, tolerance):
    """Gauss-Seidel on the objective with Newton steps accepted on decrease; as `_newton`."""
    n = g.size
    v, sigma, r = work[0], work[1], work[4]
    scale = 0.0
    for i in range(n):
        scale = max(scale, abs(g[i]))
        v[i] = 0.0
        sigma[i] = 0.0
    best = 0.0
    for sweep in range(SWEEPS):
        for j in range(2 * n):
            i = j if j < n else 2 * n - 1 - j
            right = g[i]
            if i > 0:
                right -= H1[i - 1] * v[i - 1]
            if i < n - 1:
                right -= H1[i] * v[i + 1]
            if w[i] > 0.0:
                v[i], sigma[i] = _scalar_resolvent(right / w[i], H0[i] / w[i], beta[i])
            else:
                v[i] = right / H0[i]
        largest, row, round_off = _residual(H0, H1, w, g, v, sigma, r)
        for i in range(n):
            if w[i] > 0.0 and beta[i] < inf:
                z = abs(beta[i] * v[i])
                s[i] = kappa / beta[i] * z + z / (z + 1.0)
                if v[i] < 0.0:
                    s[i] = -s[i]
            else:
                s[i] = kappa * v[i] + sigma[i]
        if largest <= max(tolerance * scale, round_off):
            return sweep + 1, True, largest, row
        best = _objective(H0, H1, w, beta, g, v)
        for i in range(n):
            trial[0, i] = v[i]
            trial[1, i] = sigma[i]
            trial[2, i] = s[i]
        _, converged, largest, row = _newton(H0, H1, w, beta, kappa, g, s, work, 3, tolerance)
        if converged:
            return sweep + 1, True, largest, row
        if not _objective(H0, H1, w, beta, g, v) < best:
            for i in range(n):
                v[i] = trial[0, i]
                sigma[i] = trial[1, i]
                s[i] = trial[2, i]
    return SWEEPS, False, largest, row


@njit(cache=True)
def _nested(level_start, H0, H1, w, beta, kappa, g, s, work, tolerance):
    """Solve coarse to fine; level k occupies level_start[k]:level_start[k + 1], 0 the finest."""
    levels = level_start.size - 1
    for k in range(levels - 1):
        fine, coarse, end = level_start[k], level_start[k + 1], level_start[k + 2]
        n_fine = coarse - fine
        n_coarse = end - coarse
        shift = n_fine - 1 - 2 * (n_coarse - 1)  # fine index of the first coarse node: 0 or 1
        for j in range(n_coarse):
            i = fine + 2 * j + shift
            t = g[i]
            if i > fine:
                t += 0.5 * g[i - 1]
            if i < coarse - 1:
                t += 0.5 * g[i + 1]
            g[coarse + j] = t
    iterations = 0
    for k in range(levels - 1, -1, -1):
        a, b = level_start[k], level_start[k + 1]
        if k == levels - 1:
            s[a:b] = 0.0
        else:
            n_coarse = level_start[k + 2] - b
            shift = b - a - 1 - 2 * (n_coarse - 1)
            for j in range(n_coarse):
                i = a + 2 * j + shift
                s[i] = s[b + j]
                if i > a:
                    s[i - 1] = 0.5 * (s[b + j] + (s[b + j - 1] if j > 0 else 0.0))
        count, converged, largest, row = _newton(
            H0[a:b],
            H1[a:b],
            w[a:b],
            beta[a:b],
            kappa,
            g[a:b],
            s[a:b],
            work[:, : b - a],
            LEVEL_ITERATIONS,
            tolerance if k == 0 else 1e-4,
        )
        iterations += count
        if not largest < inf:
            break
    return iterations, converged, largest, row


@njit(cache=True)
def solve_step(level_start, H0, H1, w, beta, kappa, g, s, work, trial, tolerance, start_nested):
    """Solve H v + w sigma(v) = g by the three tiers.

    Returns
    -------
    iterations, tier, converged, residual, row
        The solution is in ``work[0]`` (v), ``work[1]`` (sigma) and ``s`` (level 0).
    """
    n = level_start[1]
    iterations = 0
    if not start_nested:
        iterations, converged, largest, row = _newton(
            H0[:n],
            H1[:n],
            w[:n],
            beta[:n],
            kappa,
            g[:n],
            s[:n],
            work[:, :n],
            FAST_ITERATIONS if level_start.size > 2 else LEVEL_ITERATIONS,
            tolerance,
        )
        if converged:
            return iterations, 0, True, largest, row
    if level_start.size > 2:
        count, converged, largest, row = _nested(
            level_start, H0, H1, w, beta, kappa, g, s, work, tolerance
        )
        iterations += count
        if converged:
            return iterations, 1, True, largest, row
    count, converged, largest, row = _descend(
        H0[:n], H1[:n], w[:n], beta[:n], kappa, g[:n], s[:n], work[:, :n], trial, tolerance
    )
    return iterations + count, 2, converged, largest, row


@njit(cache=True)
def march(
    n_steps,
    first_step,
    every,
    fields_every,
    coefficients,
    M0,
    M1,
    C0,
    C1,
    K0,
    K1,
    level_start,
    H0,
    H1,
    w,
    beta,
    kappa,
    tolerance,
    load_start,
    load_node,
    load_value,
    amplitude,
    point_node,
    contact_node,
    state,
    input_work,
    viscous_scheme,
    friction_work,
    peak,
    slip_peak,
    counters,
    rows_u,
    rows_v,
    rows_sigma,
    rows_point_u,
    rows_point_v,
):
    """Advance ``n_steps`` equal steps in place and accumulate works, peaks and stored rows.

    Parameters
    ----------
    coefficients : tuple of float
        See :meth:`skfem_joint.schemes.Scheme.coefficients`.
    M0, M1, C0, C1, K0, K1 : ndarray, shape (n,) and (n - 1,)
        Diagonals and off-diagonals of mass, damping and stiffness.
    level_start, H0, H1, w, beta
        Hierarchy of the step's problem, level 0 first.
    load_start, load_node, load_value
        Spatial load vectors in compressed rows; ``amplitude`` has shape (loads, n_steps + 1).
    state : ndarray, shape (7, n)
        Displacement, velocity, auxiliary acceleration, acceleration, s, previous s, sigma.
    input_work, viscous_scheme, friction_work : ndarray
        Accumulated work by load (J); viscous and scheme dissipation (J); friction by contact (J).
    counters : ndarray of int64
        Iterations, nested solves, descents, points evaluated, largest iterations of a step,
        steps left in which to start nested.

    Returns
    -------
    done, rows, field_rows, residual, row
        Steps completed (fewer than ``n_steps`` when a step did not converge), rows stored of
        the points and of the fields,
        and the residual (N) and unknown of the last solve.
    """
    h, c_M, c_K, u_v, u_a, y_a, y_d, a_v, a_a, d_a, d_a0, d_d0, trapezoidal = coefficients
    n = M0.size
    u, v, a, d = state[0], state[1], state[2], state[3]
    s, s_old, sigma = state[4], state[5], state[6]
    total = level_start[-1]
    s_all = np.empty(total)
    g = np.empty(total)
    work = np.zeros((6, n))
    trial = np.zeros((3, n))
    y = np.empty(n)
    change = np.empty(n)
    mean = np.empty(n)
    rows = 0
    field_rows = 0
    largest = 0.0
    row = 0
    for step in range(n_steps):
        for i in range(n):
            u[i] += u_v * v[i] + u_a * a[i]  # predictor; completed by c_K v below
            y[i] = c_M * v[i] + y_a * a[i] + y_d * d[i]
        for i in range(n):
            t = M0[i] * y[i] - K0[i] * u[i]
            if i > 0:
                t += M1[i - 1] * y[i - 1] - K1[i - 1] * u[i - 1]
            if i < n - 1:
                t += M1[i] * y[i + 1] - K1[i] * u[i + 1]
            g[i] = t
        for k in range(load_start.size - 1):
            f = amplitude[k, step + 1]
            for j in range(load_start[k], load_start[k + 1]):
                g[load_node[j]] += f * load_value[j]
        for i in range(n):
            s_all[i] = 2.0 * s[i] - s_old[i]
        iterations, tier, converged, largest, row = solve_step(
            level_start, H0, H1, w, beta, kappa, g, s_all, work, trial, tolerance, counters[5] > 0
        )
        counters[0] += iterations
        counters[3] += iterations + 1
        counters[4] = max(counters[4], iterations)
        if tier > 0:
            counters[tier] += 1
        if not converged:
            for i in range(n):
                u[i] -= u_v * v[i] + u_a * a[i]
            return step, rows, field_rows, largest, row
        if tier == 1 and counters[5] == 0:
            counters[5] = NESTED_PERSISTENCE
        elif counters[5] > 0:
            counters[5] -= 1
        v_new, sigma_new = work[0], work[1]
        for i in range(n):
            a_new = a_v * (v_new[i] - v[i]) + a_a * a[i]
            d_new = d_a * a_new + d_a0 * a[i] + d_d0 * d[i]
            # u holds the predictor: the step's change of displacement is what it adds to u.
            change[i] = u_v * v[i] + u_a * a[i] + c_K * v_new[i]
            mean[i] = 0.5 * (v[i] + v_new[i])
            u[i] += c_K * v_new[i]
            y[i] = 0.5 * (d[i] + d_new)
            trial[0, i] = v_new[i] - v[i]
            a[i] = a_new
            d[i] = d_new
            v[i] = v_new[i]
            s_old[i] = s[i]
            s[i] = s_all[i]
        viscous = 0.0
        dissipated = 0.0
        for i in range(n):
            t = C0[i] * mean[i]
            if i > 0:
                t += C1[i - 1] * mean[i - 1]
            if i < n - 1:
                t += C1[i] * mean[i + 1]
            viscous += t * change[i]
        if not trapezoidal:
            for i in range(n):
                slack = change[i] - h * mean[i]
                drift = h * y[i] - trial[0, i]
                m_y = M0[i] * y[i]
                m_drift = M0[i] * drift
                if i > 0:
                    m_y += M1[i - 1] * y[i - 1]
                    m_drift += M1[i - 1] * (h * y[i - 1] - trial[0, i - 1])
                if i < n - 1:
                    m_y += M1[i] * y[i + 1]
                    m_drift += M1[i] * (h * y[i + 1] - trial[0, i + 1])
                dissipated += slack * m_y + mean[i] * m_drift
        viscous_scheme[0] += viscous
        viscous_scheme[1] += dissipated
        for k in range(load_start.size - 1):
            f = 0.5 * (amplitude[k, step] + amplitude[k, step + 1])
            for j in range(load_start[k], load_start[k + 1]):
                input_work[k] += f * load_value[j] * change[load_node[j]]
        for j in range(contact_node.size):
            i = contact_node[j]
            friction_work[j] += 0.5 * w[i] * (sigma[i] + sigma_new[i]) * change[i]
            slip_peak[j] = max(slip_peak[j], abs(u[i]))
        for i in range(n):
            sigma[i] = sigma_new[i]
        for j in range(point_node.size):
            peak[j] = max(peak[j], abs(u[point_node[j]]))
        if rows_u.shape[0] > 0 and (first_step + step + 1) % fields_every == 0:
            rows_u[field_rows] = u
            rows_v[field_rows] = v
            for j in range(contact_node.size):
                rows_sigma[field_rows, j] = sigma[contact_node[j]]
            field_rows += 1
        if rows_point_u.shape[0] > 0 and (first_step + step + 1) % every == 0:
            for j in range(point_node.size):
                rows_point_u[rows, j] = u[point_node[j]]
                rows_point_v[rows, j] = v[point_node[j]]
            rows += 1
    return n_steps, rows, field_rows, largest, row
