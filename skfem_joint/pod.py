"""Proper orthogonal decomposition of a history, Eq. (3), and truncation of its modes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class ProperModes:
    """Proper orthogonal modes and values.

    Attributes
    ----------
    modes : ndarray, shape (n, r)
        Modes in columns, orthonormal in the inner product they were made with.
    singular_values : ndarray, shape (r,)
        In decreasing order.
    """

    modes: FloatArray
    singular_values: FloatArray

    @property
    def proper_values(self) -> FloatArray:
        """Singular values in percent of their sum, as in Table 1."""
        return np.asarray(100.0 * self.singular_values / self.singular_values.sum())

    @property
    def cumulative(self) -> FloatArray:
        """Cumulative sums of the proper values, percent."""
        return np.asarray(np.cumsum(self.proper_values))

    def count_for(self, percent: float = 99.0, extra: int = 1) -> int:
        """Modes whose cumulative sum reaches ``percent``, plus ``extra`` (section 5: 99 %, one)."""
        if not 0.0 < percent <= 100.0:
            raise InputError(f"percent: found {percent}, must be above 0 and at most 100")
        reached = int(np.searchsorted(self.cumulative, percent * (1.0 - 1e-12))) + 1
        return min(reached + extra, self.singular_values.size)


def proper_modes(snapshots: FloatArray, mass: FloatArray | None = None) -> ProperModes:
    """Proper orthogonal decomposition by a thin singular value decomposition.

    Parameters
    ----------
    snapshots : ndarray, shape (times, n)
        One state in each row.
    mass : ndarray, shape (n, n), optional
        Symmetric positive definite matrix of the inner product; Euclidean if not given.

    Returns
    -------
    ProperModes
        ``min(times, n)`` modes, V^T V = I or V^T M V = I.

    Raises
    ------
    InputError
        If the snapshots are not a finite matrix, or nothing moves in them.
    """
    if snapshots.ndim != 2 or not np.all(np.isfinite(snapshots)):
        raise InputError("snapshots: must be a matrix (times, n) of finite numbers")
    if not np.any(snapshots):
        raise InputError("snapshots: all zero, nothing moves; is the load too small or absent?")
    if mass is None:
        _, values, rows = np.linalg.svd(snapshots, full_matrices=False)
        return ProperModes(np.ascontiguousarray(rows.T), values)
    factor = np.linalg.cholesky(np.asarray(mass))
    _, values, rows = np.linalg.svd(snapshots @ factor, full_matrices=False)
    return ProperModes(np.linalg.solve(factor.T, rows.T), values)


def orthonormal(V: FloatArray, M: FloatArray, tolerance: float = 3e-7) -> FloatArray:
    """Basis of the span of ``V`` with V^T M V = I; directions that depend on others are dropped.

    Parameters
    ----------
    V : ndarray, shape (n, j)
        Columns of any scale.
    M : ndarray or sparse array, shape (n, n)
        Mass, kg.
    tolerance : float
        Relative singular value below which a direction is dropped; not below the square root of
        the round-off.
    """
    scale = np.sqrt(np.einsum("ij,ij->j", V, M @ V))
    V = V[:, scale > 0.0] / scale[scale > 0.0]
    values, vectors = np.linalg.eigh(V.T @ (M @ V))
    keep = values > tolerance**2 * values[-1]
    if np.all(keep):
        # Gram-Schmidt keeps the order and the look of the modes.
        return np.asarray(np.linalg.solve(np.linalg.cholesky(V.T @ (M @ V)), V.T).T)
    return np.asarray(V @ (vectors[:, keep] / np.sqrt(values[keep])))
