"""Fewer friction points for reduced models: Gauss quadrature of the friction limits.

The friction of a joint does virtual work sum_i w_i sigma(v_i) v'_i over its nodes: an integral over
its active length with the nodal limits w_i as weights. The Gauss rule of that discrete measure with
p points has positive weights, so that a step stays convex, keeps the total limit, and is exact for
polynomials up to degree 2 p - 1 along the joint, whatever the mesh, the pressure or the lumping.

Fewer points are not only cheaper. A reduced model with j modes cannot hold more than j points
still: with a hundred of them it creeps where it should stick, and dissipates too much. About as
many points as modes let it stick.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh_tridiagonal

from skfem_joint.errors import InputError
from skfem_joint.system import System

FloatArray = NDArray[np.float64]


def gauss_rule(
    position: FloatArray, weight: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Gauss quadrature of a discrete measure, by Lanczos and its Jacobi matrix.

    Golub and Welsch, Math. Comp. 23 (1969); Gautschi, Orthogonal Polynomials (2004), section 2.2.

    Parameters
    ----------
    position, weight : ndarray, shape (m,)
        Support and positive weights of the measure.
    count : int
        Points of the rule, at most m.

    Returns
    -------
    position, weight : ndarray, shape (count,)
        Increasing; the weights are positive and have the same sum.
    """
    if not 1 <= count <= position.size:
        raise InputError(f"friction points: found {count}, must be from 1 to {position.size}")
    total = weight.sum()
    low, high = position.min(), position.max()
    x = (2.0 * position - low - high) / (high - low) if high > low else np.zeros_like(position)
    basis = np.zeros((count, position.size))
    basis[0] = np.sqrt(weight / total)
    diagonal, off_diagonal = np.zeros(count), np.zeros(max(count - 1, 0))
    for k in range(count):
        vector = x * basis[k]
        diagonal[k] = basis[k] @ vector
        if k + 1 == count:
            break
        for _ in range(2):  # twice is enough to keep the basis orthogonal
            vector -= basis[: k + 1].T @ (basis[: k + 1] @ vector)
        off_diagonal[k] = np.linalg.norm(vector)
        basis[k + 1] = vector / off_diagonal[k]
    points, vectors = eigh_tridiagonal(diagonal, off_diagonal)
    return 0.5 * (low + high + points * (high - low)), total * vectors[0] ** 2


def with_friction_points(
    system: System, position: FloatArray, stretches: list[NDArray[np.intp]], count: int
) -> System:
    """Replace the contact points of each stretch by a Gauss rule; other points are dropped.

    Parameters
    ----------
    system : System
        Reduced system whose slip rows are sampled along a joint.
    position : ndarray, shape (m,)
        Position of each slip row along the bar, m.
    stretches : list of ndarray of int
        Rows of each active stretch, of one beta each. Rows in none of them must not move.
    count : int
        Friction points of each stretch (fewer where it has fewer rows).

    Returns
    -------
    System
        Same unknowns; the new slip rows interpolate linearly between the old ones.
    """
    B = np.asarray(system.B)
    rows, weights, betas = [B[:0]], [np.zeros(0)], [np.zeros(0)]
    for stretch in stretches:
        order = stretch[np.argsort(position[stretch])]
        active = order[system.w[order] > 0.0]
        if active.size <= 1 or order.size == 1:
            rows.append(B[active])
            weights.append(system.w[active])
            betas.append(system.beta[active])
            continue
        x, w = gauss_rule(position[active], system.w[active], min(count, active.size))
        right = np.clip(np.searchsorted(position[order], x), 1, order.size - 1)
        a, b = order[right - 1], order[right]
        share = ((x - position[a]) / (position[b] - position[a]))[:, np.newaxis]
        rows.append((1.0 - share) * B[a] + share * B[b])
        weights.append(w)
        betas.append(np.full(w.size, system.beta[active[0]]))
    return replace(
        system,
        B=np.ascontiguousarray(np.vstack(rows)),
        w=np.concatenate(weights),
        beta=np.concatenate(betas),
    )
