"""Compiled loops of contact that opens and closes, over pressure points and friction points.

Unknowns z are the slips of the friction points and, behind them, the approaches of the faces at the
pressure points. A is the dense matrix of these; ``r`` is g - A z, from which the forces of contact
are not subtracted.

A pressure point c may approach by up to ``bound[c]``; there it carries the force p >= 0. With a
stiffness it carries ``stiffness[c] (z - bound[c])`` beyond the bound. The friction limit of point f
is what is given plus a function of ``gain`` times the forces of the pressure points around it, see
`Hinges`, and never below 0. Its friction is that limit times sigma, which follows from its slip,
and a part along a given bias.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from math import hypot, inf
from typing import Any, NamedTuple

from skfem_joint.compiling import compiled, compiled_for, compiled_inside
from skfem_joint.minimise.law import add_tangent, resolvent, sigma
from skfem_joint.minimise.line_search import friction_slope, line_search


class Pressing(NamedTuple):
    """Pressure points: unknown, largest approach and stiffness of each; ``inf`` is rigid."""

    place: Any
    bound: Any
    stiffness: Any


class Gain(NamedTuple):
    """Friction limits by normal forces: a matrix of compressed rows."""

    start: Any
    column: Any
    value: Any


class Hinges(NamedTuple):
    """How the friction of each point follows x, the gain times the forces of rigid points.

    Its limit is w = given + first x + max(0, x - lower) + beyond max(0, x - upper), all (m,), and
    its friction w sigma + min(4 w, cap) bias, with the bias of each slip row, (rows,).
    """

    first: Any
    lower: Any
    upper: Any
    beyond: Any
    cap: Any
    bias: Any


class Limits(NamedTuple):
    """Friction limits from normal forces: what is given, the gain, and hinges of rigid points."""

    given: Any
    gain: Any
    rigid: Any
    hinges: Any


class Rubbing(NamedTuple):
    """Friction points: unknowns (second -1 for one direction), eigenvalue of the block, law.

    ``cap`` and ``bias``, by unknown, are those of `Hinges`.
    """

    first: Any
    second: Any
    stiff: Any
    beta: Any
    cap: Any
    bias: Any


@compiled_inside
def _subtract(A, i, step, r):
    """Subtract a step times the i-th row of the symmetric A."""
    row = A[i]
    for k in range(r.size):
        r[k] -= step * row[k]


@compiled
def residual(A, right, z, r):
    """Set ``r`` to right - A z; unknowns at rest, as many are, cost nothing. A is symmetric."""
    for i in range(r.size):
        r[i] = right[i]
    for i in range(z.size):
        if z[i] != 0.0:
            _subtract(A, i, z[i], r)


@compiled_inside
def _force(stiffness, over, r):
    """Force of a pressure point that is ``over`` its bound (0 at it); ``r`` is its residual."""
    if stiffness == inf:
        return max(r, 0.0) if over >= 0.0 else 0.0
    return stiffness * max(over, 0.0)


@compiled
def normal_forces(pressing, z, r, p):
    """Forces of the pressure points at ``z``, N."""
    for c in range(p.size):
        i = pressing.place[c]
        p[c] = _force(pressing.stiffness[c], z[i] - pressing.bound[c], r[i])


@compiled
def friction_limits(limits, p, w, slopes):
    """Friction limits under the normal forces ``p``, N, and derivatives by x, see `Hinges`."""
    gain = limits.gain
    hinges = limits.hinges
    for f in range(w.size):
        total = limits.given[f]
        x = 0.0
        for k in range(gain.start[f], gain.start[f + 1]):
            c = gain.column[k]
            if limits.rigid[c]:
                x += gain.value[k] * p[c]
            else:
                total += gain.value[k] * p[c]
        slopes[f] = hinges.first[f]
        total += slopes[f] * x
        if x > hinges.lower[f]:
            slopes[f] += 1.0
            total += x - hinges.lower[f]
        if x > hinges.upper[f]:
            slopes[f] += hinges.beyond[f]
            total += hinges.beyond[f] * (x - hinges.upper[f])
        w[f] = max(total, 0.0)


@compiled
def relax_normals(A, pressing, z, r, backward):
    """Minimise over the approach of each pressure point in turn, in place."""
    n = pressing.place.size
    for k in range(n):
        c = n - 1 - k if backward else k
        i = pressing.place[c]
        bound = pressing.bound[c]
        own = A[i, i]
        x = z[i] + r[i] / own
        if x > bound:
            kappa = pressing.stiffness[c]
            x = bound if kappa == inf else (own * x + kappa * bound) / (own + kappa)
        if x != z[i]:
            _subtract(A, i, x - z[i], r)
            z[i] = x


@compiled
def relax_slips(A, rubbing, w, z, r, backward):
    """Minimise over the slip of each friction point in turn for given limits, in place.

    With two directions the block is replaced by its largest eigenvalue times the identity, which
    bounds the objective from above.
    """
    n = rubbing.first.size
    for k in range(n):
        f = n - 1 - k if backward else k
        i = rubbing.first[f]
        j = rubbing.second[f]
        stiff = rubbing.stiff[f]
        before = z[i]
        beside = z[j] if j >= 0 else 0.0
        given = min(4.0 * w[f], rubbing.cap[f])
        x = r[i] - given * rubbing.bias[i] + stiff * before
        y = r[j] - given * rubbing.bias[j] + stiff * beside if j >= 0 else 0.0
        size = hypot(x, y)
        speed = size / stiff
        if w[f] > 0.0:
            speed = resolvent(size / w[f], stiff / w[f], rubbing.beta[f])[0]
        new = speed * (x / size) if size != 0.0 else 0.0
        if new != before:
            _subtract(A, i, new - before, r)
            z[i] = new
        if j >= 0:
            new = speed * (y / size) if size != 0.0 else 0.0
            if new != beside:
                _subtract(A, j, new - beside, r)
                z[j] = new


@compiled_inside
def _speed(rubbing, f, z):
    i = rubbing.first[f]
    j = rubbing.second[f]
    return abs(z[i]) if j < 0 else hypot(z[i], z[j])


@compiled
def subtract_forces(rubbing, pressing, w, p, z, r, force, held):
    """Subtract the forces of contact from ``r``; returns its largest entry and where it is.

    ``force`` takes them by unknown, N, without friction by a bias, and ``held`` marks the unknowns
    that cannot move now: of points that stick, and of rigid pressure points that are closed.
    """
    held[:] = False
    force[:] = 0.0
    for f in range(rubbing.first.size):
        speed = _speed(rubbing, f, z)
        i = rubbing.first[f]
        j = rubbing.second[f]
        given = min(4.0 * w[f], rubbing.cap[f])
        r[i] -= given * rubbing.bias[i]
        if j >= 0:
            r[j] -= given * rubbing.bias[j]
        rests = rubbing.beta[f] == inf and speed == 0.0 and w[f] > 0.0
        size = 0.0
        if rests:
            pull = abs(r[i]) if j < 0 else hypot(r[i], r[j])
            size = 1.0 if pull <= w[f] else w[f] / pull
        elif speed > 0.0:
            size = w[f] * sigma(speed, rubbing.beta[f])
        for k in (i, j):
            if k >= 0:
                held[k] = rests
                if rests:
                    force[k] = r[k] * size
                elif speed > 0.0:
                    force[k] = size * (z[k] / speed)
    for c in range(p.size):
        i = pressing.place[c]
        force[i] = p[c]
        held[i] = pressing.stiffness[c] == inf and z[i] >= pressing.bound[c]
    largest = 0.0
    where = 0
    for k in range(r.size):
        r[k] -= force[k]
        if not abs(r[k]) <= largest:
            largest = abs(r[k])
            where = k
            if largest != largest:
                break
    return largest, where


@compiled
def tangents(rubbing, pressing, w, z, blocks, diagonal):
    """Blocks (11, 12, 22) of d(friction)/dz by point, and of the normal force by pressure point."""
    for f in range(rubbing.first.size):
        blocks[f, :] = 0.0
        j = rubbing.second[f]
        if w[f] > 0.0:
            x = z[rubbing.first[f]]
            y = z[j] if j >= 0 else 0.0
            stiffest = 1e8 * rubbing.stiff[f]
            add_tangent(w[f], x, y, j >= 0, rubbing.beta[f], 0.0, stiffest, blocks[f])
    for c in range(pressing.place.size):
        kappa = pressing.stiffness[c]
        pressed = kappa != inf and z[pressing.place[c]] > pressing.bound[c]
        diagonal[c] = kappa if pressed else 0.0


class ContactLine(NamedTuple):
    """Line z + length d, for the search along it with given friction limits."""

    rubbing: Any
    pressing: Any
    w: Any
    z: Any
    d: Any


@compiled_for(friction_slope, ContactLine)
def _slope_along(line, length):
    """Derivative of the potentials of friction and of elastic normal contact along the line, W."""
    total = 0.0
    rubbing = line.rubbing
    for f in range(rubbing.first.size):
        i = rubbing.first[f]
        j = rubbing.second[f]
        x = line.z[i] + length * line.d[i]
        y = 0.0 if j < 0 else line.z[j] + length * line.d[j]
        beside = 0.0 if j < 0 else line.d[j]
        speed = hypot(x, y)
        if speed > 0.0 and line.w[f] > 0.0:
            work = x * line.d[i] + y * beside
            total += line.w[f] * sigma(speed, rubbing.beta[f]) * work / speed
    pressing = line.pressing
    for c in range(pressing.place.size):
        kappa = pressing.stiffness[c]
        if kappa != inf:
            i = pressing.place[c]
            over = line.z[i] + length * line.d[i] - pressing.bound[c]
            total += kappa * max(over, 0.0) * line.d[i]
    return total


@compiled
def length_along(line, linear, quadratic):
    """Length along the line at which the objective for given limits is nearly least.

    ``linear`` is its slope at the start without sigma and elastic normal forces, W.
    """
    slope_0 = linear + friction_slope(line, 0.0)
    return line_search(line, slope_0, linear, quadratic)[0]
