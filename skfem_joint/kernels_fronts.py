"""Slip fronts on a chain under Coulomb friction: elimination that decides stick and slip.

A point that sticks separates its neighbours, so that elimination can decide stick and slip as it
goes: towards a meeting point that is at rest each point slips if it would beside its inner
neighbour's velocity of before, and on the way back each obeys its law. One such pass moves a slip
front over any number of nodes, where Newton's iteration moves it by about one.
Every step is certified by its residual as those of the tiers are.

What was tried on the reference system of the paper (100 elements): run time of the whole of
``integrate`` in milliseconds for three periods of 25, 50 and 100 steps, fastest of 60:

=========================================================================  ====  ====  ====
Newton's iteration alone (10, 5.7 and 2.8 iterations a step)               1.37  1.73  1.92
passes that meet in the middle of the chain (3.5, 2.4 and 1.7)             0.83  0.95  1.18
loops of their own for runs of one state, unsigned indices, fewer array    0.76  0.84  0.96
arguments (numba counts references at each call: a quarter of a step),
friction work by unknown
fewer conversions of sparse matrices, no second evaluation of loads        0.53  0.61  0.73
passes that meet among the points at rest (2.2, 1.5 and 1.1)               0.47  0.52  0.62
=========================================================================  ====  ====  ====

A pass takes 0.25 microseconds, Newton's iteration 1.17. Passes start from rest. Starting from
velocities that are too large they may alternate between two wrong states: those of the last step
take 40 % more iterations at 25 steps a period, extrapolated ones two and a half times as many, and
the smaller of the two no fewer than rest.
"""

from __future__ import annotations

from math import copysign

import numpy as np

from skfem_joint.kernels_friction import compiled

#: Passes under Coulomb friction: those that are not enough by then seldom ever are.
PASSES = 8
ROUND_OFF = 8 * np.finfo(np.float64).eps


@compiled
def _largest(x):
    """Largest magnitude; four at a time, because maxima of numbers wait for each other."""
    n = x.size - x.size % 4
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(0, n, 4):
        a = abs(x[i]) if abs(x[i]) > a else a
        b = abs(x[i + 1]) if abs(x[i + 1]) > b else b
        c = abs(x[i + 2]) if abs(x[i + 2]) > c else c
        d = abs(x[i + 3]) if abs(x[i + 3]) > d else d
    for i in range(n, x.size):
        a = abs(x[i]) if abs(x[i]) > a else a
    return max(a, b, c, d)


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
    bound = tolerance * _largest(g)
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
            converged = _beyond(r, ROUND_OFF * _largest(slip)) == 0
    if converged:
        for i in range(v.size):
            sigma[i] = sigma[i] / w[i] if hold[i] > 0.0 else 0.0
            s[i] = kappa * v[i] + sigma[i]
    return passes, converged, middle
