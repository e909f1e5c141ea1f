"""Compiled loops over the contact points of the truncated Newton method.

A point slips in one or two directions: its unknowns are ``first[p]`` and, unless that is -1,
``second[p]``. ``stiff[p]`` is the largest eigenvalue of its block of H, ``w`` are friction limits,
and ``beta`` is the steepness of each point. Symmetric blocks of points are stored as (11, 12, 22),
shape (points, 3); of a point with a single direction only the first entry counts.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from math import hypot, inf
from typing import Any, NamedTuple

from skfem_joint.compiling import compiled, compiled_for, compiled_inside
from skfem_joint.linalg.kernels import subtract_column
from skfem_joint.minimise.law import across, resolvent, sigma, slope
from skfem_joint.minimise.line_search import friction_slope, line_search


@compiled_inside
def _relax(p, first, second, stiff, w, beta, r, s, v):
    """Minimise over the velocity of a point; ``r`` and ``s`` are its residual without friction.

    With two directions the block is replaced by its largest eigenvalue times the identity. That
    bounds the objective from above and touches it at the present velocity, so that the objective
    cannot grow; its minimiser has the direction of the force.
    """
    i = first[p]
    j = second[p]
    x = r + stiff[p] * v[i]
    if j < 0:
        v[i] = resolvent(x / w[p], stiff[p] / w[p], beta[p])[0]
        return
    y = s + stiff[p] * v[j]
    size = hypot(x, y)
    speed = resolvent(size / w[p], stiff[p] / w[p], beta[p])[0]
    v[i] = speed * (x / size) if size != 0.0 else 0.0
    v[j] = speed * (y / size) if size != 0.0 else 0.0


@compiled
def sweep_over(A, first, second, stiff, w, beta, r, v, backward):
    """Relax all points in turn, in place; r = g - A v is updated with v.

    Points that stay at rest cost nothing.
    """
    n = first.size
    for k in range(n):
        p = n - 1 - k if backward else k
        i = first[p]
        j = second[p]
        x = v[i]
        y = v[j] if j >= 0 else 0.0
        _relax(p, first, second, stiff, w, beta, r[i], r[j] if j >= 0 else 0.0, v)
        if v[i] != x:
            subtract_column(A, i, v[i] - x, r)
        if j >= 0 and v[j] != y:
            subtract_column(A, j, v[j] - y, r)


@compiled_inside
def _size(first, second, p, v):
    """Norm of a vector at a point."""
    return abs(v[first[p]]) if second[p] < 0 else hypot(v[first[p]], v[second[p]])


@compiled
def subtract_friction(first, second, w, beta, v, r, friction, sticking):
    """Subtract friction from the residual ``r`` = g - A v; returns its largest entry and where.

    An entry that is not a number counts as the largest. The friction of a Coulomb point at rest
    balances the residual as far as the limit allows; ``sticking`` marks the unknowns of points that
    it balances. ``friction`` takes the normalised force by unknown.
    """
    sticking[:] = False
    for p in range(first.size):
        speed = _size(first, second, p, v)
        holds = beta[p] == inf and speed == 0.0
        size = 1.0 / max(w[p], _size(first, second, p, r)) if holds else sigma(speed, beta[p])
        for i in (first[p], second[p]):
            if i >= 0:
                sticking[i] = holds
                # Divided by the speed, whose inverse may be infinite.
                moving = v[i] / speed * size if speed != 0.0 else 0.0
                friction[i] = r[i] * size if holds else moving
                r[i] -= w[p] * friction[i]
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
def tangent_blocks(first, second, stiff, w, beta, v, out):
    """Blocks of d(w sigma)/dv, N s/m; zero for Coulomb points at rest."""
    for p in range(first.size):
        i = first[p]
        j = second[p]
        out[p, :] = 0.0
        speed = _size(first, second, p, v)
        if beta[p] == inf and speed == 0.0:
            continue
        along = w[p] * slope(speed, beta[p])
        beside = w[p] * across(speed, beta[p])
        if beta[p] == inf:
            # Round-off of a much stiffer tangent would make the matrix singular along the slip.
            beside = min(beside, 1e8 * stiff[p])
        out[p, 0] = out[p, 2] = along
        if j >= 0 and speed > 0.0:
            x = v[i] / speed
            y = v[j] / speed
            out[p, 0] = beside + (along - beside) * x * x
            out[p, 1] = (along - beside) * x * y
            out[p, 2] = beside + (along - beside) * y * y


class PointLine(NamedTuple):
    """Line v + length d through the velocities of points, for the search along it."""

    first: Any
    second: Any
    w: Any
    beta: Any
    v: Any
    d: Any


@compiled_for(friction_slope, PointLine)
def _slope_along(line, length):
    """Derivative of sum w psi(|v + length d|) along the direction ``d``, W."""
    total = 0.0
    for p in range(line.first.size):
        i = line.first[p]
        j = line.second[p]
        x = line.v[i] + length * line.d[i]
        y = 0.0 if j < 0 else line.v[j] + length * line.d[j]
        beside = 0.0 if j < 0 else line.d[j]
        speed = hypot(x, y)
        if speed > 0.0:
            work = x * line.d[i] + y * beside
            total += line.w[p] * sigma(speed, line.beta[p]) * work / speed
    return total


@compiled
def search_along(line, linear, quadratic):
    """Length along a line, and the evaluations of friction that finding it took."""
    slope_0 = linear + friction_slope(line, 0.0)
    length, trials, _ = line_search(line, slope_0, linear, quadratic)
    return length, trials + 1


@compiled
def friction_round_off(first, second, w, beta, v):
    """Largest of w (sigma + slope |v|), N: what round-off of a velocity does to the friction."""
    largest = 0.0
    for p in range(first.size):
        change = 1.0
        if beta[p] != inf:
            speed = _size(first, second, p, v)
            change += speed * slope(speed, beta[p])
        largest = max(largest, w[p] * change)
    return largest


@compiled
def add_blocks(first, second, blocks, x, y):
    """Add the product of the points' blocks with ``x`` to ``y``."""
    for p in range(first.size):
        i = first[p]
        j = second[p]
        y[i] += blocks[p, 0] * x[i]
        if j >= 0:
            y[i] += blocks[p, 1] * x[j]
            y[j] += blocks[p, 1] * x[i] + blocks[p, 2] * x[j]
