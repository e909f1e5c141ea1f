"""Compiled loops over the contact points of the truncated Newton method.

A point slips in one or two directions, each of which is an unknown. Points with springs in series
that share their unknowns are a group, as the sliders of an Iwan joint are; any other point is a
group of its own. ``stiff[q]`` is the largest eigenvalue of the block of H of group q. Symmetric
blocks of groups are stored as (11, 12, 22), shape (groups, 3); of a group with a single direction
only the first entry counts.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from math import hypot, inf
from typing import Any, NamedTuple

from skfem_joint.compiling import compiled, compiled_for, compiled_inside
from skfem_joint.linalg.kernels import subtract_column
from skfem_joint.minimise.law import add_tangent, sprung_force, sprung_resolvent, sprung_slope
from skfem_joint.minimise.line_search import friction_slope, line_search


class Points(NamedTuple):
    """Contact points with friction, sorted by their groups.

    Attributes
    ----------
    first, second : ndarray of int, shape (groups,)
        Unknowns of each group; ``second`` is -1 where there is a single one.
    start : ndarray of int, shape (groups + 1,)
        Group q has the points ``start[q]:start[q + 1]``.
    w, beta, soft : ndarray, shape (m,)
        Friction limit (N), steepness (s/m) and compliance of the spring in series (m/s, 0 for none,
        see :mod:`skfem_joint.minimise.law`) of each point.
    x, y : ndarray, shape (m,)
        Velocity from which the slip of each point counts, m/s; zero without a spring.
    """

    first: Any
    second: Any
    start: Any
    w: Any
    beta: Any
    soft: Any
    x: Any
    y: Any


@compiled_inside
def _relax(q, points, stiff, r, s, v):
    """Minimise over the velocity of a group's point; ``r`` and ``s`` are its residual.

    That is without friction. With two directions the block is replaced by its largest eigenvalue
    times the identity. That bounds the objective from above and touches it at the present velocity,
    so that the objective cannot grow; its minimiser has the direction of the force.
    """
    i, j, p = points.first[q], points.second[q], points.start[q]
    w, k = points.w[p], stiff[q] / points.w[p]
    x = r + stiff[q] * (v[i] - points.x[p])
    if j < 0:
        slip = sprung_resolvent(x / w, k, points.beta[p], points.soft[p])[0]
        v[i] = slip + points.x[p]
        return
    y = s + stiff[q] * (v[j] - points.y[p])
    size = hypot(x, y)
    speed = sprung_resolvent(size / w, k, points.beta[p], points.soft[p])[0]
    v[i] = (speed * (x / size) if size != 0.0 else 0.0) + points.x[p]
    v[j] = (speed * (y / size) if size != 0.0 else 0.0) + points.y[p]


@compiled
def sweep_over(A, points, stiff, r, v, backward):
    """Relax all groups of a single point in turn, in place; r = g - A v is updated with v.

    Points that stay at rest cost nothing. Groups of several points have springs, so that their
    forces are smooth enough for Newton's method alone.
    """
    n = points.first.size
    for k in range(n):
        q = n - 1 - k if backward else k
        if points.start[q + 1] - points.start[q] > 1:
            continue
        i = points.first[q]
        j = points.second[q]
        x = v[i]
        y = v[j] if j >= 0 else 0.0
        _relax(q, points, stiff, r[i], r[j] if j >= 0 else 0.0, v)
        if v[i] != x:
            subtract_column(A, i, v[i] - x, r)
        if j >= 0 and v[j] != y:
            subtract_column(A, j, v[j] - y, r)


@compiled
def subtract_friction(points, v, r, friction, sticking):
    """Subtract friction from the residual ``r`` = g - A v; returns its largest entry and where.

    An entry that is not a number counts as the largest. The friction of a Coulomb point at rest
    without a spring balances the residual as far as the limit allows; ``sticking`` marks the
    unknowns of points that it balances. ``friction``, (m, 2), takes the normalised forces.
    """
    sticking[:] = False
    for q in range(points.first.size):
        i = points.first[q]
        j = points.second[q]
        for p in range(points.start[q], points.start[q + 1]):
            w = points.w[p]
            x = v[i] - points.x[p]
            y = v[j] - points.y[p] if j >= 0 else 0.0
            speed = abs(x) if j < 0 else hypot(x, y)
            holds = points.beta[p] == inf and points.soft[p] == 0.0 and speed == 0.0
            if holds:
                needed = abs(r[i]) if j < 0 else hypot(r[i], r[j])
                size = 1.0 / max(w, needed)
            else:
                size = sprung_force(speed, points.beta[p], points.soft[p])
            # Divided by the speed, whose inverse may be infinite.
            moving = x / speed * size if speed != 0.0 else 0.0
            sticking[i] = holds
            friction[p, 0] = r[i] * size if holds else moving
            r[i] -= w * friction[p, 0]
            if j >= 0:
                moving = y / speed * size if speed != 0.0 else 0.0
                sticking[j] = holds
                friction[p, 1] = r[j] * size if holds else moving
                r[j] -= w * friction[p, 1]
    largest = 0.0
    where = 0
    for i in range(r.size):
        if not abs(r[i]) <= largest:
            largest = abs(r[i])
            where = i
            if largest != largest:
                break
    return largest, where


@compiled
def tangent_blocks(points, stiff, v, out):
    """Blocks of d(w sigma)/dv of all groups, N s/m; zero for Coulomb points at rest."""
    for q in range(points.first.size):
        i = points.first[q]
        j = points.second[q]
        out[q, :] = 0.0
        for p in range(points.start[q], points.start[q + 1]):
            x = v[i] - points.x[p]
            y = v[j] - points.y[p] if j >= 0 else 0.0
            law = points.beta[p], points.soft[p]
            add_tangent(points.w[p], x, y, j >= 0, *law, 1e8 * stiff[q], out[q])


class PointLine(NamedTuple):
    """Line v + length d through the velocities of points, for the search along it."""

    points: Any
    v: Any
    d: Any


@compiled_for(friction_slope, PointLine)
def _slope_along(line, length):
    """Derivative of sum w psi(|v + length d|) along the direction ``d``, W."""
    points, v, d = line
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
                size = sprung_force(speed, points.beta[p], points.soft[p])
                total += points.w[p] * size * work / speed
    return total


@compiled
def search_along(line, linear, quadratic):
    """Length along a line, and the evaluations of friction that finding it took."""
    slope_0 = linear + friction_slope(line, 0.0)
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
            beta, soft = points.beta[p], points.soft[p]
            if beta != inf or soft != 0.0:
                x = v[i] - points.x[p]
                y = v[j] - points.y[p] if j >= 0 else 0.0
                speed = abs(x) if j < 0 else hypot(x, y)
                from_rest = speed + abs(points.x[p]) + abs(points.y[p])
                change += from_rest * sprung_slope(speed, beta, soft)
            total += points.w[p] * change
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
