"""Friction points along a line: the Gauss rule of the friction limits of its contact points.

With p points it is exact for polynomials up to degree 2 p - 1, whatever the mesh, the pressure or
the way in which limits were lumped to nodes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.reduction.friction_points import shared_points
from skfem_joint.system.system import System


def gauss_rule(
    position: FloatArray, weight: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Gauss quadrature of a discrete measure, by its Jacobi matrix.

    Golub and Welsch, Math. Comp. 23 (1969); Gautschi, Orthogonal Polynomials (2004), section 2.2.

    Parameters
    ----------
    position, weight : ndarray, shape (m,)
        Points of the measure and their positive weights.
    count : int
        Number of points of the rule, from 1 to m.

    Returns
    -------
    points, weights : ndarray, shape (count,)
        Increasing positions, and weights with the same sum.
    """
    total = weight.sum()
    low, high = position.min(), position.max()
    x = (2.0 * position - low - high) / (high - low) if high > low else np.zeros_like(position)
    # Polynomials that are orthonormal in the measure, times the roots of its weights.
    Q = np.linalg.qr(np.sqrt(weight / total)[:, np.newaxis] * chebvander(x, count - 1))[0]
    points, vectors = np.linalg.eigh(Q.T @ (x[:, np.newaxis] * Q))
    points = np.clip(0.5 * (low + high + points * (high - low)), low, high)  # for round-off
    return points, total * vectors[0] ** 2


def gauss_points(
    system: System, lines: Sequence[tuple[IntArray, FloatArray]], count: int
) -> System:
    """Replace the contact points of each line by a Gauss rule; other points are dropped.

    A new point slips as the two old ones between which it lies, linearly.

    Parameters
    ----------
    system : System
    lines : sequence of (points, positions)
        Contact points with one slip direction and equal beta, and their positions, m. Points in
        none of the lines must not move.
    count : int
        Points of each line; fewer if the line has fewer.

    Returns
    -------
    System
        Its ``shares`` are those of the old points in the new ones.
    """
    shares, weights = [sparse.csr_array((0, system.contact.w.size))], [np.zeros(0)]
    for points, position in lines:
        order = np.argsort(position)
        points, position = points[order], position[order]
        acting = system.contact.w[points] > 0.0
        if not np.any(acting):
            continue
        most = min(count, int(np.count_nonzero(acting)))
        x, w = gauss_rule(position[acting], system.contact.w[points[acting]], most)
        left = np.clip(np.searchsorted(position, x), 1, max(points.size - 1, 1)) - 1
        right = np.minimum(left + 1, points.size - 1)
        gap = position[right] - position[left]
        share = (x - position[left]) / np.where(gap > 0.0, gap, 1.0)
        entries = np.concatenate([1.0 - share, share])
        places = np.tile(np.arange(x.size), 2), np.concatenate([points[left], points[right]])
        shares.append(sparse.csr_array((entries, places), shape=(x.size, system.contact.w.size)))
        weights.append(w)
    return shared_points(system, sparse.vstack(shares, format="csr"), np.concatenate(weights))
