"""Operations on vectors for functions that run both in Python and in compiled loops.

A function that uses only these operations, slices, and loops over few entries runs in Python on
sparse or dense matrices. In compiled code the loops of :mod:`skfem_joint.linalg.kernels` replace
the operations, and allocate no memory. So :mod:`skfem_joint.stepping.energy` has a single version.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray


def product(A: Any, x: FloatArray, y: FloatArray) -> None:
    """Compute y = A x."""
    y[:] = A @ x


def dot(x: FloatArray, y: FloatArray) -> float:
    """Scalar product."""
    return float(x @ y)


def combine(out: FloatArray, a: float, x: FloatArray, b: float, y: FloatArray) -> None:
    """Compute out = a x + b y; ``out`` may be x or y."""
    out[:] = a * x + b * y


def add_mean_products(
    out: FloatArray, x: FloatArray, a: FloatArray, b: FloatArray, y: FloatArray
) -> None:
    """Add the products x (a + b)/2 y, entry by entry, to ``out``."""
    out += 0.5 * x * (a + b) * y


def raise_to(out: FloatArray, x: FloatArray) -> None:
    """Raise ``out`` to the magnitudes of x where these are larger."""
    np.maximum(out, np.abs(x), out=out)


def raise_to_norms(out: FloatArray, rows: FloatArray) -> None:
    """Raise ``out`` to `point_norms` of some rows where these are larger."""
    norms = np.empty_like(out)
    point_norms(rows, norms)
    np.maximum(out, norms, out=out)


def point_norms(rows: FloatArray, out: FloatArray) -> None:
    """Norms of vectors of points, (m,), from their rows: first ones of all, then second ones."""
    pairs = rows.size - out.size
    out[:] = np.abs(rows[: out.size])
    out[:pairs] = np.hypot(rows[:pairs], rows[out.size :])


def weighted(weights: FloatArray, places: IntArray, x: FloatArray) -> float:
    """Sum of weights times the entries of x at some places."""
    return float(weights @ x[places])


def largest_at(places: IntArray, x: FloatArray) -> float:
    """Largest entry of x at some places, not below 0."""
    return float(x[places].max(initial=0.0))


def largest_product(places: IntArray, x: FloatArray, factors: FloatArray) -> float:
    """Largest product of the entries of x at some places and ``factors``, not below 0."""
    return float((x[places] * factors).max(initial=0.0))


def weighted_beyond(
    weights: FloatArray,
    places: IntArray,
    x: FloatArray,
    least_x: float,
    y: FloatArray,
    factors: FloatArray,
    least_y: float,
    limits: FloatArray,
    times: float,
) -> float:
    """Sum of weights of the places at which x, and y times its factor, are large.

    There x reaches ``least_x``, and y exceeds ``least_y`` and its limit ``times`` a number.
    """
    large = y[places] * factors > np.maximum(least_y, limits * times)
    return float(weights @ (large & (x[places] >= least_x)))
