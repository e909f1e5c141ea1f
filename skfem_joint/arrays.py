"""Names of the arrays' types, and matrices of either kind, once for the whole package."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.errors import InputError

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]
#: ndarray or scipy sparse array, shape (n, n) or (m, n).
Matrix: TypeAlias = Any


def as_real(value: Any, what: str) -> Matrix:
    """Array or sparse array of doubles, from numbers of any real type.

    Parameters
    ----------
    value : array_like or sparse array
        A sparse array stays sparse, in its own format.
    what : str
        What the message calls it.

    Raises
    ------
    InputError
        For complex values, whose imaginary part would be lost, and for what is no number.
    """
    given = value if sparse.issparse(value) else np.asarray(value)
    if given.dtype.kind == "c":
        raise InputError(
            f"{what}: found {given.dtype} values, must be real: motion is computed over time. Give "
            f"the real part if the imaginary one is zero; of a stiffness K (1 + i eta) give K, and "
            "eta K / omega as part of C, which has the same loss at the angular frequency omega; "
            "the phase of a load goes into its force over time"
        )
    if given.dtype.kind not in "iuf":
        raise InputError(f"{what}: found {given.dtype} values, must be real numbers")
    return given.astype(float, copy=False)


def as_dense(A: Matrix) -> FloatArray:
    """Array of a matrix or of lists of numbers, its rows side by side."""
    return np.ascontiguousarray(A.toarray() if sparse.issparse(A) else A, dtype=float)


def as_compressed(A: Matrix) -> Matrix:
    """Compressed rows of a sparse matrix, with sorted entries; a dense one as it is."""
    if isinstance(A, np.ndarray):
        return A
    rows = sparse.csr_array(A)
    rows.sort_indices()
    return rows
