"""Pressure points in dense problems: normal forces, and friction limits that follow them.

The method is that of :mod:`skfem_joint.minimise.primal_dual_newton`, its loop that of
:mod:`skfem_joint.minimise.dense_loop`, which says what ``normal`` and ``follows`` are.

Of the normal law this module has `press_beyond`, its potential's slope in `slope_of_pressures`, its
size in `magnitude_of_pressures`, and the stiffness in `_differences`; the other places are in
``docs/contributing/extend.md``.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple, cast

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import as_dense
from skfem_joint.ground.compiling import compiled, compiled_inside, inlined
from skfem_joint.linalg.kernels import (
    add_product,
    add_row_products,
    aligned,
    combine_rows,
    largest_of,
    sum_of_magnitudes,
    sum_of_products,
)
from skfem_joint.minimise.problem import ContactPoints, Places, PressurePoints

#: Iterations in which the residual must halve; otherwise limits are kept for a while.
PATIENCE = 8
# Change of the derivative of a point's friction by its limit, over 1, up to which the earlier one
# stays.
_TURN = 0.02


class PressureRows(NamedTuple):
    """Pressure points of a dense problem, their forces now, and what belongs to their tangent.

    Attributes
    ----------
    N : ndarray, shape (n, q)
        Transposed operator of approaches.
    stiffness, bound : ndarray, shape (q,)
        Stiffness, in N over the unit of v, and approach at which each point begins to carry.
    start, column, gain : ndarray
        Compressed rows of the friction limit of each friction point by the forces p.
    point_start, point, point_gain : ndarray
        The same by columns: the friction points that each pressure point gives a limit.
    given : ndarray, shape (m,)
        Friction limits without forces, N.
    flexible : ndarray, shape (m,)
        Slip that the springs in series take under a unit of force; empty if no point has one.
    steep : ndarray, shape (m,)
        Steepness of each point where it has friction.
    over, p, d_over : ndarray, shape (q,)
        How far points are beyond their bounds, their forces, N, and the change along a direction.
    change, held_change : ndarray, shape (rows,)
        Derivative of friction by its limit, now and as it is added up in U.
    pressed : ndarray, shape (q,)
        1 where the stiffness of a point is added up in U, else 0.
    held : ndarray, shape (n, q)
        Stiffness of each point, N s/m, with what it gives to friction: U is held N'.
    U : ndarray, shape (n, n)
        Tangent of the normal forces, and of friction by them.
    order : ndarray of int, shape (n,)
        Unknowns in the order of the factor.
    pushed, tried, left, old_w, old_sigma, slip, rows : ndarray
        Arrays to work in: by unknown, slip row and, the last one, pressure point.
    X, Y : ndarray, shape (n, q)
        Arrays to work in.
    listed : ndarray of int, shape (q,)
        Pressure points whose tangents changed.
    watch : ndarray, shape (3,)
        Least residual up to now, N, iterations since it halved last, which are none between
        minimisations with limits that follow, and of limits that follow the
        largest normal force on an unknown, of others the residual that is enough, N.
    """

    N: Any
    stiffness: Any
    bound: Any
    start: Any
    column: Any
    gain: Any
    point_start: Any
    point: Any
    point_gain: Any
    given: Any
    flexible: Any
    steep: Any
    over: Any
    p: Any
    d_over: Any
    change: Any
    held_change: Any
    pressed: Any
    held: Any
    U: Any
    order: Any
    pushed: Any
    tried: Any
    left: Any
    old_w: Any
    old_sigma: Any
    slip: Any
    rows: Any
    X: Any
    Y: Any
    listed: Any
    watch: Any


def pressure_rows(points: ContactPoints, places: Places) -> PressureRows:
    """Pressure points of contact points whose friction has some places in the loops."""
    normal, order = cast("PressurePoints", points.normal), np.argsort(places.point)
    N = np.ascontiguousarray(as_dense(normal.N).T)
    (n, q), rows, m = N.shape, points.B.shape[0], order.size
    by_point = sparse.csr_array(normal.gain)[order]
    by_pressure = sparse.csr_array(by_point.T)
    compressed = [
        np.array(x, dtype=kind)
        for G in (by_point, by_pressure)
        for x, kind in zip((G.indptr, G.indices, G.data), (np.int64, np.int64, float), strict=True)
    ]
    flexible = np.zeros(0) if points.flexible is None else points.flexible[order]
    own = aligned(q, m, m, *3 * [q], *2 * [rows], q, n * n, *3 * [n], *3 * [rows], q)
    bound, given, steep, *forces, U, pushed, tried, left, old_w, old_sigma, slip, rows = own
    held, X, Y = np.zeros((3, n, q))
    arrays: list[Any] = [N, np.array(normal.stiffness, dtype=float), bound, *compressed, given]
    arrays += [flexible, steep, *forces, held, U.reshape((n, n)), np.zeros(n, np.int64), pushed]
    arrays += [tried, left, old_w, old_sigma, slip, rows, X, Y, np.zeros(q, np.int64)]
    arrays += [np.array([np.inf, 0.0, 0.0])]
    return PressureRows._make(arrays)


@compiled_inside
def press_beyond(normal):
    """Forces of the pressure points from how far they are beyond their bounds."""
    over, p, stiffness = normal.over, normal.p, normal.stiffness
    for c in range(p.size):
        p[c] = stiffness[c] * max(over[c], 0.0)


@compiled_inside
def follow(contact, normal):
    """Friction limits that follow the normal forces."""
    for f in range(normal.given.size):
        limit = normal.given[f]
        for e in range(normal.start[f], normal.start[f + 1]):
            limit += normal.gain[e] * normal.p[normal.column[e]]
        _set_limit(contact, normal, f, max(limit, 0.0))


@compiled_inside
def _set_limit(contact, normal, f, limit):
    """Give a point a friction limit, N."""
    m = contact.beta.size
    contact.w[f] = limit
    if m + f < contact.w.size:
        contact.w[m + f] = limit
    if contact.soft.size > 0:
        contact.soft[f] = limit * normal.flexible[f]
        contact.beta[f] = normal.steep[f] if limit > 0.0 or normal.steep[f] < inf else 0.0


@compiled_inside
def _changes(contact, sigma, slopes, change):
    """Derivatives of friction by its limit, (rows,).

    A spring whose slider does not move has the same force under any limit; else the slider's slip
    changes too.
    """
    m = contact.beta.size
    for f in range(m):
        follows = 1.0 if contact.w[f] > 0.0 else 0.0
        if contact.soft.size > 0:
            follows *= 1.0 - contact.soft[f] * slopes[f]
        change[f] = follows * sigma[f]
        if m + f < change.size:
            change[m + f] = follows * sigma[m + f]


@compiled_inside
def _list_pressures(normal, m, anew):
    """List pressure points whose tangent changed; returns their number.

    All if it is made ``anew``, else those that closed, opened, or press points whose friction
    changes by its limit in another way.
    """
    change, held, count = normal.change, normal.held_change, 0
    for c in range(normal.p.size):
        pressed = 1.0 if normal.over[c] > 0.0 else 0.0
        listed = pressed != normal.pressed[c]
        if pressed > 0.0 and not listed:
            for e in range(normal.point_start[c], normal.point_start[c + 1]):
                f = normal.point[e]
                listed |= abs(change[f] - held[f]) > _TURN
                if m + f < change.size:
                    listed |= abs(change[m + f] - held[m + f]) > _TURN
        normal.pressed[c] = pressed
        normal.listed[count] = c
        count += listed
    for i in range(change.size):
        if anew or abs(change[i] - held[i]) > _TURN:
            held[i] = change[i]
    return count


@compiled_inside
def _differences(normal, contact, count, coupled):
    """Changes of the held tangents of listed pressure points, and their approaches, in X and Y."""
    B, N, X, Y, listed = contact.B, normal.N, normal.X, normal.Y, normal.listed
    change, mixed = normal.change, normal.old_w
    m = contact.beta.size
    pairs = change.size - m
    for j in range(len(N)):
        held, row, own, x, y = normal.held[j], N[j], B[j], X[j], Y[j]
        if coupled:
            for f in range(m):
                mixed[f] = change[f] * own[f]
            for f in range(pairs):
                mixed[f] += change[m + f] * own[m + f]
        for i in range(count):
            c = listed[i]
            t = row[c]
            if coupled:
                for e in range(normal.point_start[c], normal.point_start[c + 1]):
                    t += normal.point_gain[e] * mixed[normal.point[e]]
            t *= normal.stiffness[c] * normal.pressed[c]
            x[i], y[i], held[c] = t - held[c], row[c], t


@compiled_inside
def _hold_pressures(contact, normal, space, sigma, anew, coupled):
    """Changes of the tangent U of the normal forces in X and Y; returns how many points changed."""
    if coupled:
        _changes(contact, sigma, space.scaled, normal.change)
    else:
        for i in range(sigma.size):
            normal.change[i] = 0.0
    if anew:
        for j in range(len(normal.U)):
            for k in range(len(normal.U)):
                normal.U[j, k] = 0.0
            for c in range(normal.p.size):
                normal.held[j, c] = 0.0
        for c in range(normal.p.size):
            normal.pressed[c] = 0.0
    count = _list_pressures(normal, contact.beta.size, anew)
    _differences(normal, contact, count, coupled)
    return count


@inlined
def press(contact, normal, follows, q):
    """Forces of the pressure points at velocities q, and the friction limits that follow them."""
    if normal is not None:
        combine_rows(normal.N, q, normal.over)
        for c in range(normal.over.size):
            normal.over[c] -= normal.bound[c]
        press_beyond(normal)
        if follows is not None:
            follow(contact, normal)


@inlined
def add_pressures(normal, r):
    """Add the normal forces to the residual ``r``; returns the largest on an unknown, N."""
    if normal is None:
        return 0.0
    pushed = normal.pushed
    for j in range(r.size):
        pushed[j] = 0.0
    add_row_products(normal.N, normal.p, pushed)
    for j in range(r.size):
        r[j] += pushed[j]
    return largest_of(pushed)


@inlined
def magnitude_of_pressures(normal, q, j):
    """Sum of the magnitudes that are added up in the normal forces on an unknown, N."""
    if normal is None:
        return 0.0
    rows, bound = normal.rows, normal.bound
    if j == 0:
        for c in range(rows.size):
            rows[c] = abs(bound[c]) if normal.over[c] > 0.0 else 0.0
        for k in range(q.size):
            row, t = normal.N[k], abs(q[k])
            for c in range(rows.size):
                rows[c] += t * abs(row[c])
        for c in range(rows.size):
            rows[c] = normal.stiffness[c] * rows[c] if normal.over[c] > 0.0 else 0.0
    return sum_of_magnitudes(normal.N[j], rows)


@inlined
def slope_of_pressures(normal, length):
    """Derivative of the potential of the pressure points along a direction, W."""
    if normal is None:
        return 0.0
    over, d_over, rows = normal.over, normal.d_over, normal.rows
    for c in range(over.size):
        rows[c] = normal.stiffness[c] * max(over[c] + length * d_over[c], 0.0)
    return sum_of_products(rows, d_over)


@inlined
def renew_tangent_of_pressures(contact, normal, follows, space, sigma, anew):
    """Bring the tangent U of the normal forces up to date."""
    if normal is not None:
        count = _hold_pressures(contact, normal, space, sigma, anew, follows is not None)
        add_product(normal.X, normal.Y, count, normal.U, follows is None)


@inlined
def stalls(normal, follows, largest):
    """Whether the iteration does not lead on, after an iteration with a residual, N.

    That is so if the residual has not halved for some iterations, or if limits are kept and it is
    small enough.
    """
    if normal is None:
        return False
    watch = normal.watch
    if follows is None:
        return largest <= watch[2] or largest == inf
    if largest <= 0.5 * watch[0]:
        watch[0], watch[1] = largest, 0.0
    watch[1] += 1.0
    return watch[1] > PATIENCE or largest == inf


@inlined
def watch_anew(normal, follows):
    """Begin to watch the residual of the next minimisation."""
    if follows is not None:
        normal.watch[0], normal.watch[1] = inf, 0.0


@compiled
def keep_limits(contact, normal, limits):
    """Give all points friction limits (m,), N."""
    for f in range(limits.size):
        _set_limit(contact, normal, f, limits[f])
