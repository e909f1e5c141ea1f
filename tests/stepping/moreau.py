"""Moreau's time stepping in dense matrices, for tests; it shares no code with the package.

    M (v1 - v0) = h (f - C v - K u + N^T force) - N^T P - B^T R,        v = (v0 + v1) / 2,
    u1 = u0 + h v,                                                      u = u0 + h v / 2

(Moreau 1988; Jean, Comput. Methods Appl. Mech. Eng. 177, 1999), with the impulses P of the normal
points and R of the friction points in a step of h. N u is how far faces approach each other, B u is
slip. The laws hold for impulses and the velocity at the end of a step:

- rigid normal point: if ``gap - N (u0 + h v0 / 2) <= 0`` then N v1 <= 0, P >= 0, one of them zero
  (inelastic impact); else P = 0;
- elastic normal point: P = h max(0, force + stiffness (N u - gap));
- limit of the friction impulse: h w = h given + gain P;
- friction without a spring: R = h w sigma(B v1), of size at most h w; Coulomb's sigma is any vector
  of the unit ball at rest, that of the arctangent is 2/pi arctan(beta |.|) along the slip;
- friction with a spring in series: s1 = s0 + spring (h B v - h z), s1 = w sigma(z), z the rate of
  the slider, and R = h (s0 + s1) / 2.

Impulses are relaxed point by point to round-off. It is of first order where anything meets or comes
to rest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import atan, atan2, cos, hypot, inf, pi, sin

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
#: Change of velocities at which impulses are found, over those without any, and most sweeps.
ROUND_OFF, SWEEPS = 1e-14, 20_000


@dataclass(frozen=True)
class Equations:
    """Matrices (n, n), rows N (q, n) and B (rows, n), and what belongs to their points.

    ``load`` gives the forces (k, n) at times (k,). ``directions`` (m,) are the rows of each
    friction point. Stiffnesses are ``inf`` where there is no spring.
    """

    M: Floats
    C: Floats
    K: Floats
    load: Callable[[Floats], Floats]
    N: Floats
    gap: Floats
    force: Floats
    stiffness: Floats
    B: Floats
    directions: NDArray[np.int64]
    given: Floats
    gain: Floats
    beta: Floats
    spring: Floats


@dataclass(frozen=True)
class History:
    """Rows at the end of every so many steps, from the start on, and works up to them.

    ``steps`` is the number of steps whose impulses were found.
    """

    times: Floats
    u: Floats
    v: Floats
    friction: Floats
    impacts: Floats
    loads: Floats
    steps: int


def march(
    e: Equations, step: float, n_steps: int, start: Sequence[Floats] = (), every: int = 1
) -> History:
    """Follow the equations from a displacement and a velocity, or from rest; springs are slack."""
    n, h = e.M.shape[0], step
    u, v = start or np.zeros((2, n))
    inverse = np.linalg.inv(e.M + 0.5 * h * e.C + 0.25 * h * h * e.K)
    old = e.M - 0.5 * h * e.C - 0.25 * h * h * e.K
    first = np.concatenate([[0], np.cumsum(e.directions)]).astype(np.int64)
    forces = np.ascontiguousarray(e.load(h * (np.arange(n_steps) + 0.5)))
    rows = np.zeros((n_steps // every + 1, 2 * n + 3))
    steps = _march(
        h, every, np.ascontiguousarray(inverse), old, e.K, forces + e.force @ e.N, forces,
        np.vstack([e.N, e.B]), e.gap, e.force, e.stiffness, first, e.given,
        np.ascontiguousarray(e.gain), e.beta, e.spring, u.astype(float), v.astype(float), rows,
    )  # fmt: skip
    rows = rows[: steps // every + 1]
    times = h * every * np.arange(len(rows))
    return History(times, rows[:, :n], rows[:, n : 2 * n], *rows[:, 2 * n :].T, steps)


@numba.njit(cache=True)
def _march(
    h, every, inverse, old, K, pushed, forces, J, gap, force, stiffness, first, given, gain, beta,
    spring, u, v, rows,
):  # fmt: skip
    """Fill the rows; the number of steps whose impulses were found."""
    n, q = u.size, gap.size
    back = inverse @ J.T
    W, transition = J @ back, inverse @ old
    impulse, s = np.zeros(J.shape[0]), np.zeros(J.shape[0] - q)
    works, scale = np.zeros(3), gap.max() if q else 0.0
    rows[0, :n], rows[0, n : 2 * n] = u, v
    for k in range(forces.shape[0]):
        free = transition @ v + h * (inverse @ (pushed[k] - K @ u))
        before, place = J @ v, J @ u
        scale = max(scale, np.abs(u).max())
        active = gap - place[:q] - 0.5 * h * before[:q] <= 1e-12 * scale
        y = J @ free
        size = np.abs(y).max() if y.size else 0.0
        y -= W @ impulse
        for _sweep in range(SWEEPS):
            change = 0.0
            for i in range(q):
                c, new = y[i] + W[i, i] * impulse[i], 0.0
                if stiffness[i] < inf:
                    a = force[i] + stiffness[i] * (place[i] + 0.25 * h * (before[i] + c) - gap[i])
                    new = max(0.0, h * a / (1.0 + 0.25 * h * h * stiffness[i] * W[i, i]))
                elif active[i]:
                    new = max(0.0, c / W[i, i])
                change = max(change, _change(y, W, impulse, i, new))
            for j in range(given.size):
                limit = h * given[j]
                for i in range(q):
                    limit += gain[j, i] * impulse[i]
                a, b = q + first[j], q + first[j + 1] - 1
                new = _at_point(
                    W, y, impulse, before, s, a, b, q, max(limit, 0.0), beta[j], spring[j], h
                )
                change = max(change, _change(y, W, impulse, a, new[0]))
                if b > a:
                    change = max(change, _change(y, W, impulse, b, new[1]))
            if change <= ROUND_OFF * size:
                break
        else:
            return k
        mean = 0.5 * v
        v = free - back @ impulse
        mean += 0.5 * v
        u = u + h * mean
        mean_y = J @ mean
        works[2] += h * np.sum(forces[k] * mean)
        for i in range(q):
            if stiffness[i] == inf:
                works[1] += impulse[i] * mean_y[i]
        for j in range(given.size):
            for r in range(first[j], first[j + 1]):
                works[0] += impulse[q + r] * mean_y[q + r]
                if spring[j] < inf:
                    new_s = 2.0 * impulse[q + r] / h - s[r]
                    works[0] -= 0.5 * (new_s**2 - s[r] ** 2) / spring[j]
                    s[r] = new_s
        if (k + 1) % every == 0:
            row = rows[(k + 1) // every]
            row[:n], row[n : 2 * n], row[2 * n :] = u, v, works
    return forces.shape[0]


@numba.njit(cache=True)
def _change(y, W, impulse, i, new):
    """Change an impulse and the velocities; the largest change of these."""
    by, largest = new - impulse[i], 0.0
    impulse[i] = new
    for r in range(y.size):
        y[r] -= W[r, i] * by
        largest = max(largest, abs(W[r, i] * by))
    return largest


@numba.njit(cache=True)
def _at_point(W, y, impulse, before, s, a, b, q, limit, beta, spring, h):
    """Friction impulses of a point with the rows a to b (one or two), the others given."""
    two = b > a
    w, cross, w_b = W[a, a], W[a, b] if two else 0.0, W[b, b] if two else 1.0
    c = y[a] + w * impulse[a] + cross * impulse[b]
    c_b = y[b] + cross * impulse[a] + w_b * impulse[b] if two else 0.0
    if spring == inf:
        return _friction(w, cross, w_b, c, c_b, limit, beta)
    # (1 + k h^2/4 W) s1 + k h z = s0 + k h/2 (B v0 + c - h/2 W s0)
    s_a, s_b = s[a - q], s[b - q] if two else 0.0
    softer, half = 1.0 / (spring * h), 0.25 * h
    c = softer * s_a + 0.5 * (before[a] + c - 0.5 * h * (w * s_a + cross * s_b))
    c_b = softer * s_b + 0.5 * (before[b] + c_b - 0.5 * h * (cross * s_a + w_b * s_b))
    r, r_b = _friction(
        softer + half * w,
        half * cross,
        softer + half * w_b,
        c,
        c_b if two else 0.0,
        limit / h,
        beta,
    )
    return 0.5 * h * (s_a + r), 0.5 * h * (s_b + r_b)


@numba.njit(cache=True)
def _friction(w_a, cross, w_b, a, b, limit, beta):
    """Solve y + W r = (a, b), r = limit sigma(y), W = [[w_a, cross], [cross, w_b]], for r."""
    if limit == 0.0 or (a == 0.0 and b == 0.0):
        return 0.0, 0.0
    cosine, sine = 1.0, 0.0  # of the turn to the principal axes
    if cross != 0.0:
        angle = 0.5 * atan2(2.0 * cross, w_a - w_b)
        cosine, sine = cos(angle), sin(angle)
        mean, spread = 0.5 * (w_a + w_b), hypot(0.5 * (w_a - w_b), cross)
        w_a, w_b = mean + spread, mean - spread
    a, b = cosine * a + sine * b, cosine * b - sine * a
    if beta == inf and hypot(a / w_a, b / w_b) <= limit:
        a, b = a / w_a, b / w_b  # it sticks
        return cosine * a - sine * b, sine * a + cosine * b
    # With r = |y|, |(a, b) / (r + W g(r))| = 1: 1 / |...| - 1 rises with r and is nearly straight.
    low, high = 0.0, hypot(a, b)
    r, g = high, limit
    for _ in range(200):
        slope = 0.0
        if beta < inf:
            g = limit * 2.0 / pi * atan(beta * r)
            slope = limit * 2.0 / pi * beta / (1.0 + (beta * r) ** 2)
        t_a, t_b = r + w_a * g, r + w_b * g
        size = hypot(a / t_a, b / t_b)
        low, high = (low, r) if size < 1.0 else (r, high)
        rate = (a / t_a) ** 2 * (1.0 + w_a * slope) / t_a
        rate = (rate + (b / t_b) ** 2 * (1.0 + w_b * slope) / t_b) / size**3
        new = r - (1.0 / size - 1.0) / rate
        if not low <= new <= high:
            new = 0.5 * (low + high)
        if abs(new - r) <= 4e-16 * r:
            break
        r = new
    a, b = a * g / (r + w_a * g), b * g / (r + w_b * g)
    return cosine * a - sine * b, sine * a + cosine * b
