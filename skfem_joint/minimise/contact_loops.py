"""Compiled loops over the points of contact whose slips and approaches are unknowns.

A friction point slips in one or two directions, each of which is an unknown. Points with springs in
series that share their unknowns are a group, as the sliders of an Iwan joint are; any other point
is a group of its own. A pressure point approaches along one unknown, by up to its bound; there it
carries a force p >= 0, or beyond it ``stiffness`` times what it is beyond. Where there are pressure
points, friction limits follow their forces (`skfem_joint.minimise.limits`).

``stiff[q]`` is the largest eigenvalue of the block of H of group q. Symmetric blocks of groups, and
of the pressure points after them, are stored as (11, 12, 22), shape (groups + pressure points, 3);
where there is a single direction only the first entry counts. ``r`` is g - A v, from which the
forces of contact are not subtracted.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from math import hypot, inf
from typing import Any, NamedTuple

from skfem_joint.ground.compiling import compiled, compiled_for, compiled_inside
from skfem_joint.linalg.kernels import largest_entry, subtract_column
from skfem_joint.minimise.law import add_tangent, sprung_force, sprung_resolvent, sprung_slope
from skfem_joint.minimise.line_search import friction_slope, line_search


class Points(NamedTuple):
    """Friction points, sorted by their groups.

    Attributes
    ----------
    first, second : ndarray of int, shape (groups,)
        Unknowns of each group; ``second`` is -1 where there is a single one.
    start : ndarray of int, shape (groups + 1,)
        Group q has the points ``start[q]:start[q + 1]``.
    w, beta, flexible : ndarray, shape (m,)
        Friction limit (N), steepness (s/m) and slip that the spring in series takes under a unit
        force (m/s for each N, 0 for none, see :mod:`skfem_joint.minimise.law`) of each point.
    x, y : ndarray, shape (m,)
        Velocity from which the slip of each point counts, m/s; zero without a spring.
    """

    first: Any
    second: Any
    start: Any
    w: Any
    beta: Any
    flexible: Any
    x: Any
    y: Any


class Pressing(NamedTuple):
    """Pressure points, (q,): unknown, largest approach and stiffness; ``inf`` is rigid."""

    place: Any
    bound: Any
    stiffness: Any


class Limits(NamedTuple):
    """Friction limits from normal forces; empty where these are constant.

    Attributes
    ----------
    given, first, lower, upper, beyond, cap : ndarray, shape (m,)
        See `skfem_joint.minimise.limits.Hinges`.
    bias : ndarray, shape (n,)
        The same of each unknown.
    start, column, value : ndarray
        Gain by friction point and pressure point, a matrix of compressed rows.
    """

    given: Any
    first: Any
    lower: Any
    upper: Any
    beyond: Any
    cap: Any
    bias: Any
    start: Any
    column: Any
    value: Any


class CompiledContact(NamedTuple):
    """All that acts on the slips and approaches of a problem."""

    points: Any
    pressing: Any
    limits: Any


# Normal forces and friction limits


@compiled_inside
def _normal_force(pressing, c, v, r):
    """Force of a pressure point, N."""
    i = pressing.place[c]
    over = v[i] - pressing.bound[c]
    if pressing.stiffness[c] == inf:
        return max(r[i], 0.0) if over >= 0.0 else 0.0
    return pressing.stiffness[c] * max(over, 0.0)


@compiled_inside
def _limit(contact, p, v, r):
    """Friction limit of a point under the normal forces, N, and its derivative by x."""
    limits, pressing = contact.limits, contact.pressing
    total, x = limits.given[p], 0.0
    for k in range(limits.start[p], limits.start[p + 1]):
        c = limits.column[k]
        force = limits.value[k] * _normal_force(pressing, c, v, r)
        if pressing.stiffness[c] == inf:
            x += force
        else:
            total += force
    slope = limits.first[p]
    total += slope * x
    if x > limits.lower[p]:
        slope += 1.0
        total += x - limits.lower[p]
    if x > limits.upper[p]:
        slope += limits.beyond[p]
        total += limits.beyond[p] * (x - limits.upper[p])
    return max(total, 0.0), slope


@compiled
def renew_limits(contact, v, r, p, slopes):
    """Set normal forces ``p`` (q,), friction limits and their derivatives by x, ``slopes`` (m,)."""
    for c in range(p.size):
        p[c] = _normal_force(contact.pressing, c, v, r)
    for f in range(slopes.size):
        contact.points.w[f], slopes[f] = _limit(contact, f, v, r)


@compiled_inside
def _biased(contact, p):
    """Factor of the bias of a point, N."""
    return min(4.0 * contact.points.w[p], contact.limits.cap[p])


@compiled
def subtract_bias(contact, r):
    """Subtract from ``r`` what limits add to friction beside its law."""
    points, bias = contact.points, contact.limits.bias
    if bias.size == 0:
        return
    for q in range(points.first.size):
        i = points.first[q]
        j = points.second[q]
        for p in range(points.start[q], points.start[q + 1]):
            r[i] -= _biased(contact, p) * bias[i]
            if j >= 0:
                r[j] -= _biased(contact, p) * bias[j]


# Relaxation


@compiled_inside
def _beyond_round_off(new, old, offset):
    """A new velocity, or the old one where both differ by the round-off of the offset alone.

    In short steps offsets of springs are large beside velocities.
    """
    return old if abs(new - old) <= 2e-15 * abs(offset) else new


@compiled_inside
def _relax(q, contact, stiff, r, s, v):
    """Minimise over the velocity of a group's point; ``r`` and ``s`` are its residual.

    That is without friction. With two directions the block is replaced by its largest eigenvalue
    times the identity. That bounds the objective from above and touches it at the present velocity,
    so that the objective cannot grow; its minimiser has the direction of the force.
    """
    points = contact.points
    i, j, p = points.first[q], points.second[q], points.start[q]
    w, stiffness = points.w[p], stiff[q]
    if contact.limits.bias.size > 0:
        r -= _biased(contact, p) * contact.limits.bias[i]
        s -= _biased(contact, p) * contact.limits.bias[j] if j >= 0 else 0.0
    if w == 0.0:
        v[i] += r / stiffness
        if j >= 0:
            v[j] += s / stiffness
        return
    k, soft = stiffness / w, w * points.flexible[p]
    x = r + stiffness * (v[i] - points.x[p])
    if j < 0:
        slip = sprung_resolvent(x / w, k, points.beta[p], soft)[0]
        v[i] = _beyond_round_off(slip + points.x[p], v[i], points.x[p])
        return
    y = s + stiffness * (v[j] - points.y[p])
    size = hypot(x, y)
    speed = sprung_resolvent(size / w, k, points.beta[p], soft)[0]
    new = (speed * (x / size) if size != 0.0 else 0.0) + points.x[p]
    v[i] = _beyond_round_off(new, v[i], points.x[p])
    new = (speed * (y / size) if size != 0.0 else 0.0) + points.y[p]
    v[j] = _beyond_round_off(new, v[j], points.y[p])


@compiled_inside
def _relax_normals(A, contact, own, r, v, backward):
    """Minimise over the approach of each pressure point in turn, with its entry ``own`` of A."""
    pressing = contact.pressing
    n = pressing.place.size
    for k in range(n):
        c = n - 1 - k if backward else k
        i = pressing.place[c]
        bound = pressing.bound[c]
        x = v[i] + r[i] / own[c]
        if x > bound:
            kappa = pressing.stiffness[c]
            x = bound if kappa == inf else (own[c] * x + kappa * bound) / (own[c] + kappa)
        if x != v[i]:
            subtract_column(A, i, x - v[i], r)
            v[i] = x


@compiled
def sweep_over(A, contact, stiff, r, v, sweeps, backward, follow):
    """Relax all points in turn, in place, in some sweeps; r = g - A v is updated with v.

    Directions alternate, the first sweep goes ``backward`` or not. Limits ``follow`` the normal
    forces at hand or are as they are. Points that stay at rest cost nothing. Groups of several
    points have springs, so that their forces are smooth enough for Newton's method alone.
    """
    points = contact.points
    n = points.first.size
    for _ in range(sweeps):
        _relax_normals(A, contact, stiff[n:], r, v, backward)
        for k in range(n):
            q = n - 1 - k if backward else k
            p = points.start[q]
            if points.start[q + 1] - p > 1:
                continue
            if follow:
                points.w[p] = _limit(contact, p, v, r)[0]
            i = points.first[q]
            j = points.second[q]
            x = v[i]
            y = v[j] if j >= 0 else 0.0
            _relax(q, contact, stiff, r[i], r[j] if j >= 0 else 0.0, v)
            if v[i] != x:
                subtract_column(A, i, v[i] - x, r)
            if j >= 0 and v[j] != y:
                subtract_column(A, j, v[j] - y, r)
        backward = not backward


# Forces and tangents


@compiled
def subtract_forces(contact, v, r, p, friction, held):
    """Subtract friction and normal forces ``p`` from ``r``; returns its largest entry and where.

    An entry that is not a number counts as the largest. The friction of a Coulomb point at rest
    without a spring balances the residual as far as the limit allows. ``held`` marks unknowns that
    do not move now: of points that it balances, and of rigid pressure points that press.
    ``friction``, (m, 2), takes the normalised forces.
    """
    points, pressing = contact.points, contact.pressing
    held[:] = False
    for q in range(points.first.size):
        i = points.first[q]
        j = points.second[q]
        for f in range(points.start[q], points.start[q + 1]):
            w = points.w[f]
            if w == 0.0:
                friction[f, :] = 0.0
                continue
            x = v[i] - points.x[f]
            y = v[j] - points.y[f] if j >= 0 else 0.0
            speed = abs(x) if j < 0 else hypot(x, y)
            soft = w * points.flexible[f]
            holds = points.beta[f] == inf and soft == 0.0 and speed == 0.0
            if holds:
                needed = abs(r[i]) if j < 0 else hypot(r[i], r[j])
                size = 1.0 / max(w, needed)
            else:
                size = sprung_force(speed, points.beta[f], soft)
            # Divided by the speed, whose inverse may be infinite.
            moving = x / speed * size if speed != 0.0 else 0.0
            held[i] = holds
            friction[f, 0] = r[i] * size if holds else moving
            r[i] -= w * friction[f, 0]
            if j >= 0:
                moving = y / speed * size if speed != 0.0 else 0.0
                held[j] = holds
                friction[f, 1] = r[j] * size if holds else moving
                r[j] -= w * friction[f, 1]
    for c in range(p.size):
        i = pressing.place[c]
        held[i] = pressing.stiffness[c] == inf and v[i] >= pressing.bound[c] and r[i] >= 0.0
        r[i] -= p[c]
    return largest_entry(r)


@compiled
def tangent_blocks(contact, stiff, v, out):
    """Blocks of d(force)/dv of all groups and pressure points, N s/m, see the module.

    Zero for Coulomb points at rest, and for rigid pressure points.
    """
    points, pressing = contact.points, contact.pressing
    groups = points.first.size
    for q in range(groups):
        i = points.first[q]
        j = points.second[q]
        out[q, :] = 0.0
        for p in range(points.start[q], points.start[q + 1]):
            w = points.w[p]
            if w > 0.0:
                x = v[i] - points.x[p]
                y = v[j] - points.y[p] if j >= 0 else 0.0
                law = points.beta[p], w * points.flexible[p]
                add_tangent(w, x, y, j >= 0, *law, 1e8 * stiff[q], out[q])
    for c in range(pressing.place.size):
        kappa = pressing.stiffness[c]
        over = v[pressing.place[c]] > pressing.bound[c]
        out[groups + c, :] = 0.0
        out[groups + c, 0] = kappa if kappa != inf and over else 0.0


@compiled_inside
def _by_limit(contact, p, slip, other, friction):
    """Derivative of a point's force by its limit: its friction, less what its spring takes."""
    points = contact.points
    soft = points.w[p] * points.flexible[p]
    if soft == 0.0:
        return friction
    speed = hypot(slip, other)
    return friction * (1.0 - soft * sprung_slope(speed, points.beta[p], soft))


@compiled_inside
def _add_coupling(A, contact, f, row, change, by_bias, p, slope, free, place, J):
    """Add to a row of J what the normal forces change a friction point's force by."""
    limits, pressing = contact.limits, contact.pressing
    for k in range(limits.start[f], limits.start[f + 1]):
        c = limits.column[k]
        if p[c] <= 0.0:
            continue
        i = pressing.place[c]
        kappa = pressing.stiffness[c]
        if kappa == inf:  # its force changes by -A d
            t = limits.value[k] * slope * (change + by_bias)
            of_normal = A[i]
            for b in range(free.size):
                J[row, b] -= t * of_normal[free[b]]
        elif place[i] >= 0:
            J[row, place[i]] += limits.value[k] * (change + by_bias) * kappa


@compiled
def coupled_tangent(A, contact, blocks, v, friction, p, slopes, free, place, J):
    """Set J (k, k), dense and not symmetric, to the tangent on the unknowns ``free`` (k,).

    It has the change of the friction limits by that of the normal forces, which are ``p``. The
    number of each unknown among the free ones is in ``place``, -1 of others.
    """
    points, pressing = contact.points, contact.pressing
    groups, bias = points.first.size, contact.limits.bias
    for a in range(free.size):
        row = A[free[a]]
        for b in range(free.size):
            J[a, b] = row[free[b]]
    for c in range(pressing.place.size):
        a = place[pressing.place[c]]
        if a >= 0:
            J[a, a] += blocks[groups + c, 0]
    for q in range(groups):
        i = points.first[q]
        j = points.second[q]
        a = place[i]
        b = place[j] if j >= 0 else -1
        if a >= 0:
            J[a, a] += blocks[q, 0]
        if b >= 0:
            J[b, b] += blocks[q, 2]
        if a >= 0 and b >= 0:
            J[a, b] += blocks[q, 1]
            J[b, a] += blocks[q, 1]
        for f in range(points.start[q], points.start[q + 1]):
            w = points.w[f]
            if w == 0.0:
                continue
            x = v[i] - points.x[f]
            y = v[j] - points.y[f] if j >= 0 else 0.0
            biased = bias.size > 0 and 4.0 * w < contact.limits.cap[f]
            for side, row, unknown in ((0, a, i), (1, b, j)):
                if row >= 0:
                    change = _by_limit(contact, f, x, y, friction[f, side])
                    by = 4.0 * bias[unknown] if biased else 0.0
                    _add_coupling(A, contact, f, row, change, by, p, slopes[f], free, place, J)


@compiled
def stop_on_the_way(contact, v, d, stopped):
    """Shorten a step ``d`` of points that would reverse, to rest, or pass their bounds, to these.

    Of friction points only those that may stick reverse. ``stopped`` marks their unknowns; returns
    whether there are any.
    """
    points, pressing = contact.points, contact.pressing
    some = False
    for q in range(points.first.size):
        f = points.start[q]
        if points.w[f] == 0.0 or points.flexible[f] > 0.0 or points.beta[f] != inf:
            continue
        i = points.first[q]
        j = points.second[q]
        turning = v[i] * (v[i] + d[i])
        if j >= 0:
            turning += v[j] * (v[j] + d[j])
        if turning < 0.0:
            some = True
            d[i], stopped[i] = -v[i], True
            if j >= 0:
                d[j], stopped[j] = -v[j], True
    for c in range(pressing.place.size):
        i = pressing.place[c]
        if pressing.stiffness[c] == inf and v[i] + d[i] > pressing.bound[c]:
            some = some or v[i] < pressing.bound[c]
            d[i], stopped[i] = pressing.bound[c] - v[i], True
    return some


# Line search


class PointLine(NamedTuple):
    """Line v + length d through the velocities of points, for the search along it."""

    contact: Any
    v: Any
    d: Any


@compiled_for(friction_slope, PointLine)
def _slope_along(line, length):
    """Derivative of the potentials of contact at v + length d along the direction ``d``, W."""
    contact, v, d = line
    points, pressing = contact.points, contact.pressing
    total = 0.0
    for q in range(points.first.size):
        i = points.first[q]
        j = points.second[q]
        to_x = v[i] + length * d[i]
        to_y = 0.0 if j < 0 else v[j] + length * d[j]
        beside = 0.0 if j < 0 else d[j]
        for p in range(points.start[q], points.start[q + 1]):
            x = to_x - points.x[p]
            y = to_y - points.y[p]
            speed = hypot(x, y)
            if speed > 0.0:
                work = x * d[i] + y * beside
                w = points.w[p]
                size = sprung_force(speed, points.beta[p], w * points.flexible[p])
                total += w * size * work / speed
    for c in range(pressing.place.size):
        if pressing.stiffness[c] != inf:
            i = pressing.place[c]
            over = v[i] + length * d[i] - pressing.bound[c]
            total += pressing.stiffness[c] * max(over, 0.0) * d[i]
    return total


@compiled
def search_along(line, linear, quadratic):
    """Length along a line, and the evaluations of friction that finding it took.

    None of a direction that bounds have turned uphill.
    """
    slope_0 = linear + friction_slope(line, 0.0)
    if slope_0 > 0.0 and line.contact.pressing.place.size > 0:
        return 0.0, 1
    length, trials, _ = line_search(line, slope_0, linear, quadratic)
    return length, trials + 1


@compiled
def friction_round_off(points, v):
    """Largest of w (sigma + slope |v|), N: what round-off of a velocity does to the friction."""
    largest = 0.0
    for q in range(points.first.size):
        i = points.first[q]
        j = points.second[q]
        total = 0.0
        for p in range(points.start[q], points.start[q + 1]):
            change = 1.0
            beta, w = points.beta[p], points.w[p]
            soft = w * points.flexible[p]
            if beta != inf or soft != 0.0:
                x = v[i] - points.x[p]
                y = v[j] - points.y[p] if j >= 0 else 0.0
                speed = abs(x) if j < 0 else hypot(x, y)
                from_rest = speed + abs(points.x[p]) + abs(points.y[p])
                change += from_rest * sprung_slope(speed, beta, soft)
            total += w * change
        largest = max(largest, total)
    return largest


@compiled
def add_blocks(first, second, blocks, x, y):
    """Add the product of the groups' blocks with ``x`` to ``y``."""
    for p in range(first.size):
        i = first[p]
        j = second[p]
        y[i] += blocks[p, 0] * x[i]
        if j >= 0:
            y[i] += blocks[p, 1] * x[j]
            y[j] += blocks[p, 1] * x[i] + blocks[p, 2] * x[j]
