"""Compiled kernels: products with matrices of three forms, vector operations, dense factors."""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import hypot, sqrt
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.compiling import (
    compiled,
    compiled_as,
    compiled_for,
    compiled_inside,
    inlined,
    sums_in_any_order,
)
from skfem_joint.linalg.compressed import CompressedRows
from skfem_joint.linalg.vectors import (
    add_mean_products,
    combine,
    dot,
    largest_at,
    largest_product,
    point_norms,
    product,
    raise_to,
    raise_to_norms,
    weighted,
    weighted_beyond,
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


def as_sparse(A: Any) -> Any:
    """Sparse matrix of bands; any other matrix as it is."""
    if not isinstance(A, Bands):
        return A
    i = np.arange(A.diagonal.size)
    rows, columns = np.concatenate([i, i[1:], i[:-1]]), np.concatenate([i, i[:-1], i[1:]])
    values = np.concatenate([A.diagonal, A.off, A.off])
    return sparse.csr_array((values, (rows, columns)), shape=(i.size, i.size))


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
        y[i] = sum_of_products(A.entries[i], x)


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


@inlined
def largest_entry(x):
    """Largest magnitude and where it is; an entry that is not a number counts as the largest."""
    largest, where = 0.0, 0
    for i in range(x.size):
        if not abs(x[i]) <= largest and largest == largest:
            largest, where = abs(x[i]), i
    return largest, where


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
def sum_of_magnitudes(a, b):
    """Sum of the magnitudes of products."""
    total = 0.0
    for i in range(a.size):
        total += abs(a[i] * b[i])
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


@compiled_as(largest_product)
def _largest_product(places, x, factors):
    largest = 0.0
    for i in range(places.size):
        largest = max(largest, x[places[i]] * factors[i])
    return largest


@compiled_as(weighted_beyond)
def _weighted_beyond(weights, places, x, least_x, y, factors, least_y, limits, times):
    total = 0.0
    for i in range(places.size):
        k = places[i]
        if x[k] >= least_x and y[k] * factors[i] > max(least_y, limits[i] * times):
            total += weights[i]
    return total


# Small dense factors


@compiled_inside
def combine_rows(B, x, out):
    """Sum of the rows of B, each times its entry of x; four rows at once, to write ``out`` less."""
    n = x.size
    first = n % 4
    for i in range(out.size):
        out[i] = 0.0
    for j in range(first):
        t, row = x[j], B[j]
        for i in range(out.size):
            out[i] += t * row[i]
    for j in range(first, n, 4):
        ta, tb, tc, td = x[j], x[j + 1], x[j + 2], x[j + 3]
        a, b, c, d = B[j], B[j + 1], B[j + 2], B[j + 3]
        for i in range(out.size):
            out[i] += (ta * a[i] + tb * b[i]) + (tc * c[i] + td * d[i])


@sums_in_any_order
def _four_products(B, j, x):
    """Scalar products of four rows of B with x."""
    a, b, c, d = B[j], B[j + 1], B[j + 2], B[j + 3]
    ta, tb, tc, td = 0.0, 0.0, 0.0, 0.0
    for i in range(x.size):
        ta += a[i] * x[i]
        tb += b[i] * x[i]
        tc += c[i] * x[i]
        td += d[i] * x[i]
    return ta, tb, tc, td


@compiled_inside
def add_row_products(B, x, out):
    """Add B x to ``out``."""
    n = out.size
    first = n % 4
    for j in range(first):
        out[j] += sum_of_products(B[j], x)
    for j in range(first, n, 4):
        ta, tb, tc, td = _four_products(B, j, x)
        out[j] += ta
        out[j + 1] += tb
        out[j + 2] += tc
        out[j + 3] += td


@sums_in_any_order
def _add_tile(X, Y, j, k, columns, S):
    """Add the products of four rows of X with two rows of Y: six loads for eight products."""
    a, b, c, d = X[j, :columns], X[j + 1, :columns], X[j + 2, :columns], X[j + 3, :columns]
    e, f = Y[k, :columns], Y[k + 1, :columns]
    ae, af, be, bf, ce, cf, de, df = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(columns):
        ae += a[i] * e[i]
        af += a[i] * f[i]
        be += b[i] * e[i]
        bf += b[i] * f[i]
        ce += c[i] * e[i]
        cf += c[i] * f[i]
        de += d[i] * e[i]
        df += d[i] * f[i]
    S[j, k] += ae
    S[j, k + 1] += af
    S[j + 1, k] += be
    S[j + 1, k + 1] += bf
    S[j + 2, k] += ce
    S[j + 2, k + 1] += cf
    S[j + 3, k] += de
    S[j + 3, k + 1] += df


@compiled_inside
def add_product(X, Y, columns, S, upper):
    """Add X Y' to S; only the first columns count.

    ``upper`` is whether the product is symmetric: then only the upper triangle of S is computed,
    and entries below the diagonal have no meaning.
    """
    n = len(S)
    last = n - n % 4
    for j in range(0, last, 4):
        begin = j if upper else 0
        end = n - (n - begin) % 2
        for k in range(begin, end, 2):
            _add_tile(X, Y, j, k, columns, S)
        if end < n:
            for i in range(j, j + 4):
                S[i, end] += sum_of_products(X[i, :columns], Y[end, :columns])
    for j in range(last, n):
        for k in range(j if upper else 0, n):
            S[j, k] += sum_of_products(X[j, :columns], Y[k, :columns])


@compiled_inside
def cholesky(A):
    """Overwrite the upper triangle of A by its factor U, A = U' U; False if there is none.

    The diagonal takes the reciprocals of the factor's, so that later loops need not divide. Rows
    are finished one after another; each takes four earlier ones at a time.
    """
    n = len(A)
    for i in range(n):
        row = A[i, i:]
        first = i % 4
        for k in range(first):
            t, above = A[k, i], A[k, i:]
            for j in range(row.size):
                row[j] -= t * above[j]
        for k in range(first, i, 4):
            ta, tb, tc, td = A[k, i], A[k + 1, i], A[k + 2, i], A[k + 3, i]
            a, b, c, d = A[k, i:], A[k + 1, i:], A[k + 2, i:], A[k + 3, i:]
            for j in range(row.size):
                row[j] -= (ta * a[j] + tb * b[j]) + (tc * c[j] + td * d[j])
        if not row[0] > 0.0:
            return False
        scale = 1.0 / sqrt(row[0])
        row[0] = scale
        for j in range(1, row.size):
            row[j] *= scale
    return True


@compiled_inside
def solve_factorised(A, x):
    """Solve A x = b in place (b in x) by the factor that `cholesky` left."""
    n = x.size
    for i in range(n):
        t = x[i] * A[i, i]
        x[i] = t
        row, rest = A[i, i + 1 :], x[i + 1 :]
        for j in range(rest.size):
            rest[j] -= t * row[j]
    for i in range(n - 1, -1, -1):
        x[i] = (x[i] - sum_of_products(A[i, i + 1 :], x[i + 1 :])) * A[i, i]


@compiled_inside
def lu(A, order):
    """Overwrite A by its factors, A P = L U, with the unknowns in the ``order`` P; False if none.

    L has a diagonal of ones, which is not stored, and the diagonal takes the reciprocals of that of
    U. As in `cholesky`, rows are finished one after another. The largest entry of each comes to the
    diagonal, unless that is within a tenth of it.
    """
    n = len(A)
    for i in range(n):
        order[i] = i
    for i in range(n):
        row = A[i]
        first = i % 4
        for k in range(first):
            t, above, rest = row[k] * A[k, k], A[k, k + 1 :], row[k + 1 :]
            row[k] = t
            for j in range(rest.size):
                rest[j] -= t * above[j]
        for k in range(first, i, 4):
            a, b, c, d = A[k], A[k + 1], A[k + 2], A[k + 3]
            ta = row[k] * a[k]
            tb = (row[k + 1] - ta * a[k + 1]) * b[k + 1]
            tc = (row[k + 2] - ta * a[k + 2] - tb * b[k + 2]) * c[k + 2]
            td = (row[k + 3] - ta * a[k + 3] - tb * b[k + 3] - tc * c[k + 3]) * d[k + 3]
            row[k], row[k + 1], row[k + 2], row[k + 3] = ta, tb, tc, td
            rest, a, b, c, d = row[k + 4 :], a[k + 4 :], b[k + 4 :], c[k + 4 :], d[k + 4 :]
            for j in range(rest.size):
                rest[j] -= (ta * a[j] + tb * b[j]) + (tc * c[j] + td * d[j])
        best = i
        for j in range(i + 1, n):
            if abs(row[j]) > abs(row[best]):
                best = j
        if not abs(row[best]) > 0.0:
            return False
        if abs(row[best]) > 10.0 * abs(row[i]):
            order[i], order[best] = order[best], order[i]
            for k in range(n):
                A[k, i], A[k, best] = A[k, best], A[k, i]
        row[i] = 1.0 / row[i]
    return True


@compiled_inside
def solve_lu(A, order, x, work):
    """Solve A x = b in place (b in x) by the factors that `lu` left."""
    n = x.size
    for i in range(n):
        work[i] = x[i] - sum_of_products(A[i, :i], work[:i])
    for i in range(n - 1, -1, -1):
        work[i] = (work[i] - sum_of_products(A[i, i + 1 :], work[i + 1 :])) * A[i, i]
    for i in range(n):
        x[order[i]] = work[i]
