"""Names of the arrays' types, and matrices of either kind, once for the whole package."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]
#: ndarray or scipy sparse array, shape (n, n) or (m, n).
Matrix: TypeAlias = Any


def as_dense(A: Matrix) -> FloatArray:
    """Array of a matrix or of lists of numbers, its rows side by side."""
    return np.ascontiguousarray(A.toarray() if sparse.issparse(A) else A, dtype=float)


def slip_norms(slip: FloatArray, directions: NDArray[np.int64]) -> FloatArray:
    """Norms of slip vectors.

    Parameters
    ----------
    slip : ndarray, shape (..., rows)
        Slip of each row; the rows of a point follow each other.
    directions : ndarray of int, shape (m,)
        Rows of each point, 1 or 2.

    Returns
    -------
    ndarray, shape (..., m)
    """
    rows = np.asarray(slip, dtype=np.float64)
    if directions.size == rows.shape[-1]:
        return np.abs(rows)
    first = np.cumsum(directions) - directions
    return np.asarray(np.sqrt(np.add.reduceat(rows * rows, first, axis=-1)))
