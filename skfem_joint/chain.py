"""The problem of a step on a chain of unknowns, with coarser chains to start from.

A chain is a tridiagonal system with at most one slip row an unknown, as struts make them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from skfem_joint.friction import ARCTAN, COULOMB, FREE

FloatArray = NDArray[np.float64]

#: Scale of the law's parameter: kappa = KAPPA / max |H^-1 w|, the largest velocity that friction
#: can change in a step. Measured: 1 to 5 do; from 10 on steps fail to converge, and scales taken
#: from the diagonal of H fail on fine meshes because they grow with the mesh.
KAPPA = 3.0
#: Chains shorter than this are not coarsened.
SHORTEST = 48


class Chain(NamedTuple):
    """Problem of a step on a chain and its coarser chains, concatenated, the finest first.

    Attributes
    ----------
    start : ndarray of int64, shape (levels + 1,)
        Level k occupies ``start[k]:start[k + 1]`` of the other arrays.
    H0, H1 : ndarray
        Diagonal and off-diagonal of H, N s/m.
    w : ndarray
        Friction limits, N.
    kind : ndarray of int8
        Kind of each point, see :mod:`skfem_joint.kernels_friction`.
    mixed : int
        0 if all points are of the arctan kind, 1 if some are, 2 if none is.
    inverse_beta : ndarray
        1 / beta, m/s.
    kappa : float
        Scale of the law's parameter, s/m.
    """

    start: Any
    H0: Any
    H1: Any
    w: Any
    kind: Any
    mixed: int
    inverse_beta: Any
    kappa: float


class LoadRows(NamedTuple):
    """Spatial load vectors in compressed rows."""

    start: Any
    node: Any
    value: Any


def bands(A: Any) -> tuple[FloatArray, FloatArray]:
    """Diagonal and off-diagonal of a symmetric tridiagonal matrix."""
    return (
        np.ascontiguousarray(A.diagonal(), dtype=float),
        np.ascontiguousarray(A.diagonal(1), dtype=float),
    )


def build_chain(H0: FloatArray, H1: FloatArray, w: FloatArray, beta: FloatArray) -> Chain:
    """Galerkin hierarchy by halving a chain down to a few dozen unknowns.

    Coarse node j sits on fine node 2 j (or 2 j + 1, so that the last node stays); the fine nodes
    between get the mean of their neighbours.

    Parameters
    ----------
    H0, H1 : ndarray, shape (n,) and (n - 1,)
        Diagonal and off-diagonal of H, N s/m.
    w, beta : ndarray, shape (n,)
        Friction limits (N; 0 where no friction acts) and scaling constants (s/m).
    """
    kappa = KAPPA / np.abs(_solve(H0, H1, w)).max()
    start, levels = [0], []
    while True:
        n = H0.size
        levels.append((H0, np.append(H1, 0.0), w, beta))
        start.append(start[-1] + n)
        if n < SHORTEST:
            break
        n_coarse = (n + 1) // 2
        fine = 2 * np.arange(n_coarse) + n - 1 - 2 * (n_coarse - 1)
        P = sparse.lil_array((n, n_coarse))
        P[fine, np.arange(n_coarse)] = 1.0
        left, right = fine > 0, fine < n - 1
        P[fine[left] - 1, np.flatnonzero(left)] = 0.5
        P[fine[right] + 1, np.flatnonzero(right)] = 0.5
        P = P.tocsr()
        H = P.T @ (sparse.diags_array([H1, H0, H1], offsets=[-1, 0, 1]).tocsr() @ P)
        (H0, H1), w, beta = bands(H), P.T @ w, beta[fine]
    H0, H1, w, beta = (np.concatenate([level[i] for level in levels]) for i in range(4))
    kind = np.where(w > 0.0, np.where(np.isinf(beta), COULOMB, ARCTAN), FREE).astype(np.int8)
    regular = kind == ARCTAN
    return Chain(
        start=np.array(start, dtype=np.int64),
        H0=H0,
        H1=H1,
        w=w,
        kind=kind,
        mixed=0 if np.all(regular) else 1 if np.any(regular) else 2,
        inverse_beta=1.0 / np.where(regular, beta, 1.0),
        kappa=float(kappa),
    )


def _solve(H0: FloatArray, H1: FloatArray, right: FloatArray) -> FloatArray:
    if H0.size == 1:
        return right / H0
    return np.asarray(linalg.solveh_banded(np.array([np.append(0.0, H1), H0]), right))
