"""Compiled implicit steps for small dense systems, as Galerkin reduction makes them.

A reduced model has more contact points than unknowns, so that they cannot all stick: Newton's
iteration runs on the velocity itself, with an exact search along each direction of the strictly
convex objective 1/2 q H q - g q + sum w psi(B q). The search uses the objective's derivative
alone, so that it is not limited by the round-off of the objective. It never failed on reduced
models and is globally convergent for a finite beta.
"""

from __future__ import annotations

from math import hypot, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from skfem_joint.kernels_friction import compiled, forces

ITERATIONS = 200
SEARCH = 60
_TWO_OVER_PI = 2.0 / pi
#: For sums over many points: their order is left to the compiler, for vector instructions.
sums_in_any_order = njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
ROUND_OFF = 16 * np.finfo(np.float64).eps


@compiled
def _cholesky_solve(A, x):
    """Solve A x = b in place (b in x, lower triangle of A overwritten by its factor).

    The diagonal takes the reciprocals of the factor's, so that the loops need not divide.
    """
    n = x.size
    for i in range(n):
        for j in range(i + 1):
            t = A[i, j]
            for k in range(j):
                t -= A[i, k] * A[j, k]
            if i == j:
                if not t > 0.0:
                    return False
                A[i, i] = 1.0 / sqrt(t)
            else:
                A[i, j] = t * A[j, j]
    for i in range(n):
        t = x[i]
        for k in range(i):
            t -= A[i, k] * x[k]
        x[i] = t * A[i, i]
    for i in range(n - 1, -1, -1):
        t = x[i]
        for k in range(i + 1, n):
            t -= A[k, i] * x[k]
        x[i] = t * A[i, i]
    return True


class Contact(NamedTuple):
    """Contact points of a dense system, those with two slip directions first.

    The loops run along the points, so that they become vector instructions: first come the first
    rows of all points, then the second rows of those that have one.

    Attributes
    ----------
    B : ndarray, shape (n, rows)
        Transposed slip operator.
    w : ndarray, shape (rows,)
        Friction limit of each row's point, N.
    beta : ndarray, shape (m,)
        Finite scaling constant of each point, s/m.
    point : ndarray of int64, shape (m,)
        Number of each point in the system.
    row : ndarray of int64, shape (rows,)
        Number of each row in the system.
    """

    B: Any
    w: Any
    beta: Any
    point: Any
    row: Any


class Room(NamedTuple):
    """Arrays that a step works in.

    ``size`` and ``ratio``, shape (m,), are the norm of the slip vectors and force over norm. They
    are only kept where some points have two rows.
    """

    r: Any
    A: Any
    direction: Any
    d_slip: Any
    trial: Any
    weight: Any
    scaled: Any
    cross: Any
    size: Any
    ratio: Any


def contact_of(B: Any, first_row: Any, w: Any, beta: Any) -> Contact:
    """Contact points from the rows of a system, see :class:`skfem_joint.system.System`."""
    pair = np.diff(first_row) == 2
    point = np.concatenate([np.flatnonzero(pair), np.flatnonzero(~pair)])
    row = np.concatenate([first_row[point], first_row[np.flatnonzero(pair)] + 1])
    limits = np.concatenate([w[point], w[pair]])
    return Contact(np.ascontiguousarray(B[row].T), limits, beta[point], point, row)


@compiled
def make_room(n, rows, m):
    """Make the arrays for n unknowns, some slip rows and m points."""
    pairs = rows > m
    return Room(
        np.empty(n),
        np.empty((n, n)),
        np.empty(n),
        np.empty(rows),
        np.empty(rows),
        np.empty(rows),
        np.empty(rows),
        np.empty(rows - m),
        np.empty(m if pairs else 0),
        np.empty(m if pairs else 0),
    )


@sums_in_any_order
def _dot(a, b):
    t = 0.0
    for i in range(a.size):
        t += a[i] * b[i]
    return t


@sums_in_any_order
def _work(w, sigma, d_slip):
    """Work of the friction forces on the slip ``d_slip``."""
    t = 0.0
    for i in range(w.size):
        t += w[i] * sigma[i] * d_slip[i]
    return t


@compiled
def _slip(B, q, slip):
    """Slip of all rows."""
    for i in range(slip.size):
        slip[i] = B[0, i] * q[0]
    for j in range(1, q.size):
        t = q[j]
        row = B[j]
        for i in range(slip.size):
            slip[i] += t * row[i]


@compiled
def _evaluate(beta, slip, size, ratio, sigma):
    """Normalised friction of all rows."""
    m = beta.size
    pairs = slip.size - m
    if pairs == 0:
        forces(beta, slip, sigma)
        return
    for p in range(pairs):
        size[p] = sqrt(slip[p] * slip[p] + slip[m + p] * slip[m + p])
    for p in range(pairs, m):
        size[p] = abs(slip[p])
    forces(beta, size, ratio)
    for p in range(m):
        ratio[p] = ratio[p] / size[p] if size[p] > 0.0 else _TWO_OVER_PI * beta[p]
        sigma[p] = ratio[p] * slip[p]
    for p in range(pairs):
        sigma[m + p] = ratio[p] * slip[m + p]


@compiled
def _add_friction(contact, slip, sigma, room):
    """Add the friction forces to the residual and their tangent to the lower triangle of A.

    The tangent of a slip vector is the law's slope along it and force over norm across it.
    """
    B, w, beta = contact.B, contact.w, contact.beta
    weight, cross, scaled = room.weight, room.cross, room.scaled
    size, ratio = room.size, room.ratio
    m = beta.size
    pairs = slip.size - m
    at = size if pairs > 0 else slip
    for p in range(m):
        z = beta[p] * at[p]
        weight[p] = w[p] * (_TWO_OVER_PI * beta[p] / (1.0 + z * z))
    for p in range(pairs):
        moves = size[p] > 0.0
        t = slip[p] / size[p] if moves else 1.0
        n = slip[m + p] / size[p] if moves else 0.0
        across = w[p] * ratio[p]
        more = weight[p] - across
        weight[p] = across + more * (t * t)
        weight[m + p] = across + more * (n * n)
        cross[p] = more * (t * n)
    for j in range(room.r.size):
        row, other = B[j], B[j, m:]
        room.r[j] += _work(w, sigma, row)
        for p in range(pairs):
            scaled[p] = weight[p] * row[p] + cross[p] * other[p]
        for p in range(pairs):
            scaled[m + p] = weight[m + p] * other[p] + cross[p] * row[p]
        for p in range(pairs, m):
            scaled[p] = weight[p] * row[p]
        for k in range(j + 1):
            room.A[j, k] += _dot(scaled, B[k])


@compiled
def _round_off(H, contact, q, slip, sigma, room):
    """Round-off of the residual: of H q, and of the slip velocities times the law's slope."""
    B, w, beta = contact.B, contact.w, contact.beta
    n = q.size
    m = beta.size
    pairs = slip.size - m
    largest = 0.0
    for j in range(n):
        total = 0.0
        for k in range(n):
            total += abs(H[j, k] * q[k])
        for i in range(slip.size):
            magnitude = 0.0
            for k in range(n):
                magnitude += abs(B[k, i] * q[k])
            if pairs > 0:
                slope = room.ratio[i if i < m else i - m]  # the larger of the two
            else:
                z = beta[i] * slip[i]
                slope = _TWO_OVER_PI * beta[i] / (1.0 + z * z)
            total += abs(B[j, i]) * w[i] * (abs(sigma[i]) + slope * magnitude)
        largest = max(largest, total)
    return ROUND_OFF * largest


@compiled
def solve_step(H, contact, g, q, slip, sigma, tolerance, room):
    """Minimise the step's objective from the start in ``q``.

    ``slip`` and ``sigma`` have one entry for each row of the contact.

    Returns
    -------
    iterations, evaluations, converged, residual
        The solution is in ``q``, its slip velocities in ``slip`` and forces in ``sigma``.
    """
    n = q.size
    B, w, beta = contact.B, contact.w, contact.beta
    r, A, direction, d_slip, trial = room.r, room.A, room.direction, room.d_slip, room.trial
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
            _slip(B, q, slip)
            _evaluate(beta, slip, room.size, room.ratio, sigma)
            evaluations += 1
        _add_friction(contact, slip, sigma, room)
        largest = 0.0
        for i in range(n):
            if r[i] != r[i]:
                return iteration, evaluations, False, r[i]
            largest = max(largest, abs(r[i]))
        if largest <= tolerance * scale or (
            largest <= 1e-6 * scale and largest <= _round_off(H, contact, q, slip, sigma, room)
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
            direction[i] = -r[i]
        _slip(B, direction, d_slip)
        slope_0 = linear + _work(w, sigma, d_slip)
        low, slope_low = 0.0, slope_0
        high, slope_high = 0.0, 0.0
        length = 1.0
        known = False
        for _ in range(SEARCH):
            if not slope_0 < 0.0:
                break  # no descent left but round-off: the full step
            for i in range(slip.size):
                trial[i] = slip[i] + length * d_slip[i]
            _evaluate(beta, trial, room.size, room.ratio, sigma)
            evaluations += 1
            slope = linear + length * quadratic + _work(w, sigma, d_slip)
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
            for i in range(slip.size):
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
    contact,
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
    B, w, beta, point, row = contact
    m = beta.size
    n_rows = w.size
    u, v, a, d, v_old = state[0], state[1], state[2], state[3], state[4]
    room = make_room(n, n_rows, m)
    slip, sigma, position = np.empty(n_rows), np.empty(n_rows), np.empty(n_rows)
    _slip(B, v, slip)
    _evaluate(beta, slip, room.size, room.ratio, sigma)
    sigma_old = sigma.copy()
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
            H, contact, g, q, slip, sigma, tolerance, room
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
        _slip(B, change, room.d_slip)
        _slip(B, u, position)
        for i in range(n_rows):
            p = point[i if i < m else i - m]
            sums.friction_work[p] += 0.5 * w[i] * (sigma_old[i] + sigma[i]) * room.d_slip[i]
            sigma_old[i] = sigma[i]
        for p in range(m):
            size = abs(position[p]) if p >= n_rows - m else hypot(position[p], position[m + p])
            sums.slip_peak[point[p]] = max(sums.slip_peak[point[p]], size)
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
            for i in range(n_rows):
                stored.sigma[field_rows, row[i]] = sigma[i]
            for p in range(m):
                stored.work[field_rows, p] = sums.friction_work[p]
            field_rows += 1
    return n_steps, rows, field_rows, largest, 0
