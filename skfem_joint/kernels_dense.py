"""Compiled implicit steps for small dense systems, as Galerkin reduction makes them.

A reduced model has more contact points than unknowns, so that they cannot all stick: Newton's
iteration runs on the velocity itself, with an exact search along each direction of the strictly
convex objective 1/2 q H q - g q + sum w psi(B q). The search uses the objective's derivative
alone, so that it is not limited by the round-off of the objective. It never failed on reduced
models and is globally convergent for a finite beta.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np

from skfem_joint.kernels_friction import compiled, forces

ITERATIONS = 200
SEARCH = 60
ROUND_OFF = 16 * np.finfo(np.float64).eps


@compiled
def _cholesky_solve(A, x):
    """Solve A x = b in place (b in x, lower triangle of A overwritten by its factor)."""
    n = x.size
    for i in range(n):
        for j in range(i + 1):
            t = A[i, j]
            for k in range(j):
                t -= A[i, k] * A[j, k]
            if i == j:
                if not t > 0.0:
                    return False
                A[i, i] = sqrt(t)
            else:
                A[i, j] = t / A[j, j]
    for i in range(n):
        t = x[i]
        for k in range(i):
            t -= A[i, k] * x[k]
        x[i] = t / A[i, i]
    for i in range(n - 1, -1, -1):
        t = x[i]
        for k in range(i + 1, n):
            t -= A[k, i] * x[k]
        x[i] = t / A[i, i]
    return True


@compiled
def _round_off(H, B, w, beta, q, slip, sigma):
    """Round-off of the residual: of H q, and of the slip velocities times the law's slope."""
    n = q.size
    largest = 0.0
    for j in range(n):
        total = 0.0
        for k in range(n):
            total += abs(H[j, k] * q[k])
        for i in range(slip.size):
            size = 0.0
            for k in range(n):
                size += abs(B[i, k] * q[k])
            z = beta[i] * slip[i]
            slope = 2.0 / pi * beta[i] / (1.0 + z * z)
            total += abs(B[i, j]) * w[i] * (abs(sigma[i]) + slope * size)
        largest = max(largest, total)
    return ROUND_OFF * largest


@compiled
def solve_step(H, B, w, beta, g, q, slip, sigma, tolerance, room):
    """Minimise the step's objective from the start in ``q``.

    ``room`` is a tuple of arrays of shape (n,), (n, n), (m,) and (m,).

    Returns
    -------
    iterations, evaluations, converged, residual
        The solution is in ``q``, its slip velocities in ``slip`` and forces in ``sigma``.
    """
    n = q.size
    m = slip.size
    r, A, d_slip, trial = room
    scale = 0.0
    for i in range(n):
        scale = max(scale, abs(g[i]))
    evaluations = 0
    largest = 0.0
    known = False  # whether slip and sigma belong to q
    for iteration in range(ITERATIONS + 1):
        for i in range(n):
            t = -g[i]
            for j in range(n):
                t += H[i, j] * q[j]
                A[i, j] = H[i, j]
            r[i] = t
        if not known:
            for i in range(m):
                t = 0.0
                for j in range(n):
                    t += B[i, j] * q[j]
                slip[i] = t
            forces(beta, slip, sigma)
            evaluations += 1
        for i in range(m):
            force = w[i] * sigma[i]
            z = beta[i] * slip[i]
            weight = w[i] * 2.0 / pi * beta[i] / (1.0 + z * z)
            for j in range(n):
                r[j] += B[i, j] * force
                t = weight * B[i, j]
                for k in range(j + 1):
                    A[j, k] += t * B[i, k]
        largest = 0.0
        for i in range(n):
            if r[i] != r[i]:
                return iteration, evaluations, False, r[i]
            largest = max(largest, abs(r[i]))
        if largest <= tolerance * scale or (
            largest <= 1e-6 * scale and largest <= _round_off(H, B, w, beta, q, slip, sigma)
        ):
            return iteration, evaluations, True, largest
        if iteration == ITERATIONS or not _cholesky_solve(A, r):
            break
        # r is minus the direction; slopes of the objective along the direction at 0 and 1.
        linear = 0.0
        quadratic = 0.0
        for i in range(n):
            t = 0.0
            for j in range(n):
                t += H[i, j] * r[j]
            linear -= t * q[i] - g[i] * r[i]
            quadratic += t * r[i]
        slope_0 = linear
        for i in range(m):
            t = 0.0
            for j in range(n):
                t -= B[i, j] * r[j]
            d_slip[i] = t
            slope_0 += w[i] * sigma[i] * t
        low, slope_low = 0.0, slope_0
        high, slope_high = 0.0, 0.0
        length = 1.0
        known = False
        for _ in range(SEARCH):
            if not slope_0 < 0.0:
                break  # no descent left but round-off: the full step
            for i in range(m):
                trial[i] = slip[i] + length * d_slip[i]
            forces(beta, trial, sigma)
            evaluations += 1
            slope = linear + length * quadratic
            for i in range(m):
                slope += w[i] * sigma[i] * d_slip[i]
            # Accept a step short of the minimum along the line, or one just past it.
            short = slope <= 0.0 and (length == 1.0 or slope >= 0.5 * slope_0)
            if short or (length == 1.0 and 0.0 < slope <= -0.05 * slope_0):
                known = True
                break
            if slope > 0.0:
                high, slope_high = length, slope
            else:
                low, slope_low = length, slope
            length = low - slope_low * (high - low) / (slope_high - slope_low)
            length = min(max(length, low + 0.05 * (high - low)), high - 0.05 * (high - low))
        for i in range(n):
            q[i] -= length * r[i]
        if known:
            for i in range(m):
                slip[i] = trial[i]
    return ITERATIONS, evaluations, False, largest


@compiled
def march(
    n_steps,
    first_step,
    every,
    fields_every,
    coefficients,
    M,
    C,
    K,
    H,
    B,
    w,
    beta,
    tolerance,
    load_vectors,
    amplitude,
    P,
    state,
    sums,
    stored,
):
    """Advance ``n_steps`` equal steps in place; arguments as in the tridiagonal ``march``.

    ``state`` has rows displacement, velocity, auxiliary acceleration, acceleration and previous
    velocity; ``counters`` holds iterations, line searches beyond the full step, an unused entry,
    friction evaluations and the largest iterations of a step.
    """
    h, c_M, c_K, u_v, u_a, y_a, y_d, a_v, a_a, d_a, d_a0, d_d0, trapezoidal = coefficients
    counters = sums.counters
    n = M.shape[0]
    m = w.size
    u, v, a, d, v_old = state[0], state[1], state[2], state[3], state[4]
    slip = np.empty(m)
    sigma = np.empty(m)
    for i in range(m):
        t = 0.0
        for j in range(n):
            t += B[i, j] * v[j]
        slip[i] = t
    forces(beta, slip, sigma)
    sigma_old = sigma.copy()
    room = (np.empty(n), np.empty((n, n)), np.empty(m), np.empty(m))
    q = np.empty(n)
    g = np.empty(n)
    y = np.empty(n)
    change = np.empty(n)
    mean = np.empty(n)
    mean_d = np.empty(n)
    drift = np.empty(n)
    rows = 0
    field_rows = 0
    largest = 0.0
    for step in range(n_steps):
        for i in range(n):
            u[i] += u_v * v[i] + u_a * a[i]
            y[i] = c_M * v[i] + y_a * a[i] + y_d * d[i]
        for i in range(n):
            t = 0.0
            for j in range(n):
                t += M[i, j] * y[j] - K[i, j] * u[j]
            for k in range(load_vectors.shape[1]):
                t += load_vectors[i, k] * amplitude[k, step + 1]
            g[i] = t
            q[i] = 2.0 * v[i] - v_old[i]
        iterations, evaluations, converged, largest = solve_step(
            H, B, w, beta, g, q, slip, sigma, tolerance, room
        )
        counters[0] += iterations
        counters[1] += evaluations - iterations - 1
        counters[3] += evaluations
        counters[4] = max(counters[4], iterations)
        if not converged:
            for i in range(n):
                u[i] -= u_v * v[i] + u_a * a[i]
            return step, rows, field_rows, largest, 0
        for i in range(n):
            a_new = a_v * (q[i] - v[i]) + a_a * a[i]
            d_new = d_a * a_new + d_a0 * a[i] + d_d0 * d[i]
            change[i] = u_v * v[i] + u_a * a[i] + c_K * q[i]
            mean[i] = 0.5 * (v[i] + q[i])
            mean_d[i] = 0.5 * (d[i] + d_new)
            drift[i] = h * mean_d[i] - (q[i] - v[i])
            u[i] += c_K * q[i]
            a[i] = a_new
            d[i] = d_new
            v_old[i] = v[i]
            v[i] = q[i]
        viscous = 0.0
        dissipated = 0.0
        for i in range(n):
            t = 0.0
            for j in range(n):
                t += C[i, j] * mean[j]
            viscous += t * change[i]
            if not trapezoidal:
                m_y = 0.0
                m_drift = 0.0
                for j in range(n):
                    m_y += M[i, j] * mean_d[j]
                    m_drift += M[i, j] * drift[j]
                dissipated += (change[i] - h * mean[i]) * m_y + mean[i] * m_drift
        sums.dissipated[0] += viscous
        sums.dissipated[1] += dissipated
        for k in range(load_vectors.shape[1]):
            t = 0.0
            for i in range(n):
                t += load_vectors[i, k] * change[i]
            sums.input_work[k] += 0.5 * (amplitude[k, step] + amplitude[k, step + 1]) * t
        for i in range(m):
            t = 0.0
            position = 0.0
            for j in range(n):
                t += B[i, j] * change[j]
                position += B[i, j] * u[j]
            sums.friction_work[i] += 0.5 * w[i] * (sigma_old[i] + sigma[i]) * t
            sums.slip_peak[i] = max(sums.slip_peak[i], abs(position))
            sigma_old[i] = sigma[i]
        store = stored.point_u.shape[0] > 0 and (first_step + step + 1) % every == 0
        for k in range(P.shape[0]):
            t = 0.0
            t_v = 0.0
            for j in range(n):
                t += P[k, j] * u[j]
                t_v += P[k, j] * v[j]
            sums.peak[k] = max(sums.peak[k], abs(t))
            if store:
                stored.point_u[rows, k] = t
                stored.point_v[rows, k] = t_v
        if store:
            rows += 1
        if stored.u.shape[0] > 0 and (first_step + step + 1) % fields_every == 0:
            for i in range(n):
                stored.u[field_rows, i] = u[i]
                stored.v[field_rows, i] = v[i]
            for i in range(m):
                stored.sigma[field_rows, i] = sigma[i]
            field_rows += 1
    return n_steps, rows, field_rows, largest, 0
