"""The problem of a step on a chain of unknowns, with coarser chains to start from.

A chain is a tridiagonal system with at most one slip row an unknown, as struts make them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

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
    hold : ndarray
        Largest force at which a point of the finest chain sticks, N: w under Coulomb, -1 elsewhere.
    pivot, stretch : ndarray
        Inverse pivots (m/(N s)) of the finest chain between points that stick, as far as they were
        needed, and the end of the stretch of slipping points that each belongs to.
    """

    start: Any
    H0: Any
    H1: Any
    w: Any
    kind: Any
    mixed: int
    inverse_beta: Any
    kappa: float
    hold: Any
    pivot: Any
    stretch: Any


class LoadRows(NamedTuple):
    """Spatial load vectors in compressed rows."""

    start: Any
    node: Any
    value: Any


def load_rows(vectors: Sequence[FloatArray]) -> LoadRows:
    """Compressed rows of load vectors."""
    nodes = [np.flatnonzero(vector) for vector in vectors]
    return LoadRows(
        start=np.cumsum([0, *(node.size for node in nodes)]),
        node=np.concatenate([np.zeros(0, dtype=np.int64), *nodes]),
        value=np.concatenate([np.zeros(0), *map(np.take, vectors, nodes)]),
    )


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
        first = (n - 1) % 2  # so that the last node stays
        H0, H1, w = _halved(H0, H1, w, first)
        beta = beta[first::2]
    H0, H1, w, beta = (np.concatenate([level[i] for level in levels]) for i in range(4))
    kind = np.where(w > 0.0, np.where(np.isinf(beta), COULOMB, ARCTAN), FREE).astype(np.int8)
    regular = kind == ARCTAN
    n = start[1]
    return Chain(
        start=np.array(start, dtype=np.int64),
        H0=H0,
        H1=H1,
        w=w,
        kind=kind,
        mixed=0 if np.all(regular) else 1 if np.any(regular) else 2,
        inverse_beta=1.0 / np.where(regular, beta, 1.0),
        kappa=float(kappa),
        hold=np.where(kind[:n] == COULOMB, w[:n], -1.0),
        pivot=np.zeros(n),
        stretch=np.full(n, -1),
    )


def _halved(
    H0: FloatArray, H1: FloatArray, w: FloatArray, first: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Galerkin projection of a chain on every second node: P^T H P and P^T w.

    P has 1 at a coarse node and 1/2 at its neighbours. Written out, because a step size that is
    used once should not cost more than its steps.
    """
    diagonal = np.concatenate([[0.0], H0, [0.0]])
    off = np.concatenate([[0.0], H1, [0.0]])  # off[i] couples nodes i - 1 and i
    limit = np.concatenate([[0.0], w, [0.0]])
    node = np.arange(first, H0.size, 2)
    coarse_0 = H0[node] + 0.25 * (diagonal[node] + diagonal[node + 2]) + off[node] + off[node + 1]
    between = node[:-1] + 1
    coarse_1 = 0.25 * H0[between] + 0.5 * (H1[between - 1] + H1[between])
    return coarse_0, coarse_1, w[node] + 0.5 * (limit[node] + limit[node + 2])


def _solve(H0: FloatArray, H1: FloatArray, right: FloatArray) -> FloatArray:
    if H0.size == 1:
        return right / H0
    return np.asarray(linalg.solveh_banded(np.array([np.append(0.0, H1), H0]), right))
