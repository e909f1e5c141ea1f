"""Compressed rows of sparse matrices: for scipy, and for compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, Matrix


class CompressedRows(NamedTuple):
    """Sparse matrix for compiled loops.

    Attributes
    ----------
    start : ndarray of int, shape (rows + 1,)
        Row k has the entries ``start[k]:start[k + 1]`` of the other two arrays.
    column : ndarray of int, shape (entries,)
    value : ndarray, shape (entries,)
    """

    start: NDArray[np.int64]
    column: NDArray[np.int64]
    value: FloatArray


def as_compressed(A: Matrix) -> Matrix:
    """Compressed rows with sorted columns; dense matrices are returned unchanged.

    A matrix that has this form already is returned itself: a copy takes longer than most steps.
    """
    if isinstance(A, np.ndarray) or (isinstance(A, sparse.csr_array) and A.has_sorted_indices):
        return A
    rows = sparse.csr_array(A)
    rows.sort_indices()
    return rows


def compressed_rows(A: Matrix) -> CompressedRows:
    """Compressed rows of a dense or sparse matrix; zeros of a dense matrix are left out."""
    rows = sparse.csr_array(A) if isinstance(A, np.ndarray) else as_compressed(A)
    start, column = rows.indptr.astype(np.int64), rows.indices.astype(np.int64)
    return CompressedRows(start, column, rows.data.astype(float))
