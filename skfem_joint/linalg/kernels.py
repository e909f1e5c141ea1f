"""Compiled kernels: products with matrices of three forms, vector operations, dense factors."""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import hypot, sqrt
from typing import Any, NamedTuple

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.compiling import (
    compiled,
    compiled_as,
    compiled_for,
    compiled_inside,
    sums_in_any_order,
)
from skfem_joint.linalg.compressed import CompressedRows
from skfem_joint.linalg.vectors import (
    add_mean_products,
    combine,
    dot,
    largest_at,
    mark_reached,
    point_norms,
    product,
    raise_to,
    raise_to_norms,
    weighted,
)


class Bands(NamedTuple):
    """Diagonal (n,) and off-diagonal (n - 1,) of a symmetric tridiagonal matrix."""

    diagonal: FloatArray
    off: FloatArray


class Full(NamedTuple):
    """Dense matrix, (n, n)."""

    entries: FloatArray


def bands(A: Any) -> Bands:
    """Bands of a symmetric tridiagonal matrix."""
    diagonal, off = (np.ascontiguousarray(A.diagonal(k), dtype=float) for k in (0, 1))
    return Bands(diagonal, off)


def aligned(*sizes: int) -> list[FloatArray]:
    """Arrays of zeros that begin at a cache line; loops over other arrays take a fifth longer."""
    line = 8  # numbers in a line of the cache
    memory = np.zeros(sum(sizes) + line * (2 * len(sizes) + 1))
    arrays, at = [], -(memory.ctypes.data // memory.itemsize) % line
    for size in sizes:
        arrays.append(memory[at : at + size])
        at += line * (size // line + 2)
    return arrays


# Products, by the form of the matrix


@compiled_for(product, CompressedRows)
def _product_of_compressed(A, x, y):
    for k in range(y.size):
        t = 0.0
        for e in range(A.start[k], A.start[k + 1]):
            t += A.value[e] * x[A.column[e]]
        y[k] = t


@compiled_for(product, Bands)
def _product_of_bands(A, x, y):
    diagonal, off = A
    for i in range(x.size):
        y[i] = diagonal[i] * x[i]
    for i in range(off.size):
        y[i] += off[i] * x[i + 1]
    for i in range(off.size):
        y[i + 1] += off[i] * x[i]


@compiled_for(product, Full)
def _product_of_full(A, x, y):
    for i in range(x.size):
        t = 0.0
        for j in range(x.size):
            t += A.entries[i, j] * x[j]
        y[i] = t


def subtract_column(A, i, step, r):
    """Subtract ``step`` times column i of a symmetric A from r, for `CompressedRows` and `Full`."""
    raise NotImplementedError


@compiled_for(subtract_column, CompressedRows)
def _subtract_of_compressed(A, i, step, r):
    for e in range(A.start[i], A.start[i + 1]):
        r[A.column[e]] -= A.value[e] * step


@compiled_for(subtract_column, Full)
def _subtract_of_full(A, i, step, r):
    row = A.entries[i]
    for k in range(r.size):
        r[k] -= row[k] * step


@compiled
def subtract_product(A, v, r):
    """Subtract A v from r; columns of unknowns at rest are skipped."""
    for i in range(v.size):
        if v[i] != 0.0:
            subtract_column(A, i, v[i], r)


def times(A: Any, x: FloatArray) -> FloatArray:
    """Product A x; columns of unknowns at rest are skipped where A is dense."""
    if not isinstance(A, np.ndarray):
        return np.asarray(A @ x)
    y = np.zeros_like(x)
    subtract_product(Full(A), -x, y)
    return y


# Sums and sizes


@compiled_inside
def largest_of(x):
    """Largest magnitude, from four maxima side by side: a single maximum would wait for itself."""
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


@sums_in_any_order
def sum_of_products(a, b):
    """Scalar product."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@sums_in_any_order
def sum_of_triple_products(a, b, c):
    """Sum of products of three entries."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i] * c[i]
    return total


@sums_in_any_order
def _weighted_sum(weights, places, x):
    total = 0.0
    for i in range(weights.size):
        total += weights[i] * x[places[i]]
    return total


# Vector operations, see skfem_joint.linalg.vectors


@compiled_as(dot)
def _dot(x, y):
    return sum_of_products(x, y)


@compiled_as(weighted)
def _weighted(weights, places, x):
    return _weighted_sum(weights, places, x)


@compiled_as(combine)
def _combine(out, a, x, b, y):
    for i in range(out.size):
        out[i] = a * x[i] + b * y[i]


@compiled_as(add_mean_products)
def _add_mean_products(out, x, a, b, y):
    for i in range(out.size):
        out[i] += 0.5 * x[i] * (a[i] + b[i]) * y[i]


@compiled_as(raise_to)
def _raise_to(out, x):
    for i in range(out.size):
        out[i] = abs(x[i]) if abs(x[i]) > out[i] else out[i]


@compiled_as(point_norms)
def _point_norms(rows, out):
    m = out.size
    pairs = rows.size - m
    for p in range(pairs):
        out[p] = hypot(rows[p], rows[m + p])
    # Slices, because a loop that does not start at 0 is checked for counting from an array's end.
    single, norm = rows[pairs:m], out[pairs:]
    for p in range(norm.size):
        norm[p] = abs(single[p])


@compiled_as(raise_to_norms)
def _raise_to_norms(out, rows):
    m = out.size
    pairs = rows.size - m
    for p in range(pairs):
        out[p] = max(out[p], hypot(rows[p], rows[m + p]))
    single, norm = rows[pairs:m], out[pairs:]
    for p in range(norm.size):
        norm[p] = abs(single[p]) if abs(single[p]) > norm[p] else norm[p]


@compiled_as(largest_at)
def _largest_at(places, x):
    largest = 0.0
    for i in range(places.size):
        largest = max(largest, x[places[i]])
    return largest


@compiled_as(mark_reached)
def _mark_reached(x, limit):
    for i in range(x.size):
        x[i] = 1.0 if x[i] >= limit else 0.0


# Small dense factors


@compiled_inside
def cholesky(A):
    """Overwrite the lower triangle of A by its factor; False if A is not positive definite.

    The diagonal takes the reciprocals of the factor's, so that later loops need not divide.
    """
    for i in range(len(A)):
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
    return True


@compiled_inside
def solve_factorised(A, x):
    """Solve A x = b in place (b in x) by the factor that `cholesky` left."""
    n = x.size
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
