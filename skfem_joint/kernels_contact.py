"""Compiled parts of the contact solver: relaxation, tangent and line search, point by point.

A contact point slips in one or two directions: its unknowns are ``first[p]`` and, unless that is
-1, ``second[p]``. Symmetric blocks of a point are stored as (11, 12, 22), shape (points, 3); of a
point with one direction only the first entry counts. ``w`` may be zero: no friction there.
"""

from __future__ import annotations

from math import hypot, inf, pi

import numpy as np

from skfem_joint.kernels_friction import arctangent, compiled, scalar_resolvent


@compiled
def _relax(p, first, second, block, w, beta, r, s, v):
    """Minimise over the velocity of one point; ``r`` and ``s`` are its residual without friction.

    With two directions the block is replaced by its largest eigenvalue, seen from the velocity
    now: a majorant, so that the objective cannot grow, with a closed direction.
    """
    i = first[p]
    j = second[p]
    if j < 0:
        a = block[p, 0]
        if w[p] == 0.0:
            v[i] += r / a
        else:
            v[i] = scalar_resolvent((r + a * v[i]) / w[p], a / w[p], beta[p])[0]
        return
    a, b, c = block[p, 0], block[p, 1], block[p, 2]
    if w[p] == 0.0:
        determinant = a * c - b * b
        v[i] += (c * r - b * s) / determinant
        v[j] += (a * s - b * r) / determinant
        return
    largest = 0.5 * (a + c) + hypot(0.5 * (a - c), b)
    x = r + largest * v[i]
    y = s + largest * v[j]
    size = hypot(x, y)
    if size == 0.0:
        v[i] = 0.0
        v[j] = 0.0
        return
    speed = scalar_resolvent(size / w[p], largest / w[p], beta[p])[0]
    v[i] = speed * (x / size)
    v[j] = speed * (y / size)


@compiled
def sweep_sparse(start, column, value, first, second, block, w, beta, g, v, backward):
    """Relax all points of a sparse matrix (compressed rows) one after another, in place."""
    n = first.size
    for k in range(n):
        p = n - 1 - k if backward else k
        i = first[p]
        r = g[i]
        for e in range(start[i], start[i + 1]):
            r -= value[e] * v[column[e]]
        s = 0.0
        j = second[p]
        if j >= 0:
            s = g[j]
            for e in range(start[j], start[j + 1]):
                s -= value[e] * v[column[e]]
        _relax(p, first, second, block, w, beta, r, s, v)


@compiled
def sweep_dense(A, first, second, block, w, beta, g, v, backward):
    """Relax all points of a dense matrix one after another, in place."""
    n = first.size
    for k in range(n):
        p = n - 1 - k if backward else k
        i = first[p]
        r = g[i] - np.dot(A[i], v)
        s = 0.0
        j = second[p]
        if j >= 0:
            s = g[j] - np.dot(A[j], v)
        _relax(p, first, second, block, w, beta, r, s, v)


@compiled
def _speed(first, second, p, v):
    return abs(v[first[p]]) if second[p] < 0 else hypot(v[first[p]], v[second[p]])


@compiled
def subtract_friction(first, second, w, beta, v, r, sigma, held):
    """Subtract friction from the residual ``r`` = g - A v; returns its largest entry and where.

    What is not a number counts as larger than any number.

    The force of a Coulomb point at rest is what the residual asks for, as far as it can hold.
    ``held`` marks the unknowns of such points; ``sigma`` is filled by unknown.
    """
    held[:] = False
    for p in range(first.size):
        if w[p] == 0.0:
            continue
        i = first[p]
        j = second[p]
        speed = _speed(first, second, p, v)
        if beta[p] == inf and speed == 0.0:
            size = abs(r[i]) if j < 0 else hypot(r[i], r[j])
            share = 1.0 / max(w[p], size)
            sigma[i] = r[i] * share
            held[i] = True
            if j >= 0:
                sigma[j] = r[j] * share
                held[j] = True
        elif speed == 0.0:
            sigma[i] = 0.0
            if j >= 0:
                sigma[j] = 0.0
        else:
            # The inverse of the speed may be infinite, its products then are not numbers.
            share = 1.0 if beta[p] == inf else 2.0 / pi * arctangent(beta[p] * speed)
            sigma[i] = v[i] / speed * share
            if j >= 0:
                sigma[j] = v[j] / speed * share
        r[i] -= w[p] * sigma[i]
        if j >= 0:
            r[j] -= w[p] * sigma[j]
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
def tangent(first, second, w, beta, v, out):
    """Blocks of d(w sigma)/dv, N s/m; zero for Coulomb points at rest, which are held instead."""
    for p in range(first.size):
        i = first[p]
        j = second[p]
        out[p, :] = 0.0
        if w[p] == 0.0:
            continue
        speed = _speed(first, second, p, v)
        if beta[p] == inf:
            along = 0.0
            across = w[p] / speed if speed > 0.0 else 0.0
        else:
            z = beta[p] * speed
            along = w[p] * 2.0 / pi * beta[p] / (1.0 + z * z)
            across = w[p] * 2.0 / pi * arctangent(z) / speed if speed > 0.0 else along
        if j < 0:
            out[p, 0] = along
        elif speed == 0.0:
            out[p, 0] = along
            out[p, 2] = along
        else:
            x = v[i] / speed
            y = v[j] / speed
            out[p, 0] = across + (along - across) * x * x
            out[p, 1] = (along - across) * x * y
            out[p, 2] = across + (along - across) * y * y


@compiled
def slope(first, second, w, beta, v, d, length):
    """Derivative of sum w psi(|v + length d|) along the direction ``d``, W."""
    total = 0.0
    for p in range(first.size):
        if w[p] == 0.0:
            continue
        i = first[p]
        j = second[p]
        x = v[i] + length * d[i]
        y = 0.0 if j < 0 else v[j] + length * d[j]
        across = 0.0 if j < 0 else d[j]
        speed = hypot(x, y)
        if speed > 0.0:
            sigma = 1.0 if beta[p] == inf else 2.0 / pi * arctangent(beta[p] * speed)
            total += w[p] * sigma * (x * d[i] + y * across) / speed
    return total


@compiled
def round_off(first, second, w, beta, v):
    """Largest of w (sigma + slope |v|), N: what round-off of a velocity does to the friction."""
    largest = 0.0
    for p in range(first.size):
        if w[p] > 0.0:
            change = 1.0
            if beta[p] != inf:
                z = beta[p] * _speed(first, second, p, v)
                change += 2.0 / pi * z / (1.0 + z * z)
            largest = max(largest, w[p] * change)
    return largest


@compiled
def add_blocks(first, second, blocks, x, y):
    """Add the product of the points' blocks with ``x`` to ``y``."""
    for p in range(first.size):
        i = first[p]
        j = second[p]
        if j < 0:
            y[i] += blocks[p, 0] * x[i]
        else:
            y[i] += blocks[p, 0] * x[i] + blocks[p, 1] * x[j]
            y[j] += blocks[p, 1] * x[i] + blocks[p, 2] * x[j]
