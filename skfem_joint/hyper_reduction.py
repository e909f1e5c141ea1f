"""Fewer friction points for reduced models, with positive weights and the total limit kept.

The friction of a joint does virtual work sum_i w_i sigma(v_i) v'_i over its nodes. Positive weights
keep every step convex, and the sum of the limits is what a joint carries when all of it slips.

Struts: :func:`with_friction_points`. The sum is an integral over the active length with the nodal
limits w_i as weights. The Gauss rule of that discrete measure with p points is exact for
polynomials up to degree 2 p - 1 along the joint, whatever the mesh, the pressure or the lumping.

Fewer points are not only cheaper. A reduced model with j modes cannot hold more than j points
still: with a hundred of them it creeps where it should stick, and dissipates too much. About as
many points as modes let it stick.

Plates: :func:`with_merged_points`. Points that slip alike are merged into one that slips as their
weighted mean and carries their limits together. Alike means: the histories of y / sqrt(|y|), whose
square is |y|, are close, y the slip velocity; a k-means partition finds the sets. As the friction
potential is convex, a merged point never dissipates more than its parts at equal velocities.
Measured on plates of 140 and 200 contact points with 12 to 14 modes (largest difference of the free
end's history in percent of its peak | of friction energy in percent of the last cycle; against the
full model, so with what the modes leave out, which is the row "all"):

====================================  ============  ============  ============  ============
points                                lap joint     axial         bending       both
====================================  ============  ============  ============  ============
all                                   0.5 | +1.3    0.1 | +1.2    0.5 | +4.1    0.3 | +0.9
merged, y / sqrt(|y|): 12             1.3 | +2.5    0.2 | +3.7    5.0 | +7.6    0.6 | +0.3
merged, y / sqrt(|y|): 20             0.8 | +1.9    0.1 | +1.6    2.2 | +5.0    0.3 | +0.1
merged, y / sqrt(|y|): 30             0.7 | +1.6    0.1 | +1.5    1.7 | +6.3    0.3 | +1.1
merged, velocity: 20                  0.9 | +2.0    0.1 | +1.9    8.3 | +16     4.4 | +8.0
merged, force: 20                     4.2 | +6.0    0.2 | +2.5    1.3 | +4.0    0.5 | +1.8
Gauss tensor rule 10 x 2              0.9 | +1.3    0.1 | +1.7    3.5 | +11     2.5 | -6.8
Gauss tensor rule 10 x 3              0.9 | +1.5    0.2 | +4.1    1.0 | +3.2    1.2 | -2.6
nonnegative fit of forces: 20         4.1 | +7.9    0.2 | -0.5    0.7 | +4.4    0.3 | -0.3
nonnegative fit of forces: 40         0.9 | +1.9    0.1 | +1.2    0.6 | +4.1    0.4 | +0.5
====================================  ============  ============  ============  ============

The fit chooses nodes and weights so that the friction forces on the modes are matched over the
snapshots (ECSW: Farhat, Chapman and Avery, Int. J. Numer. Meth. Engng 102, 2015; empirical
cubature: Hernandez, Caicedo and Ferrer, CMAME 313, 2017), the total limit with them. It needs twice
the points where a slip front travels. Gauss rules need a rectangle.
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
    if np.any(system.directions != 1):
        raise InputError("friction points along a bar slip in one direction, found some with two")
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
        directions=np.ones(sum(w.size for w in weights), dtype=np.int64),
    )


#: Times at which slip velocities are compared, and principal directions that are kept of them.
_TIMES, _DIRECTIONS = 150, 40


def with_merged_points(
    system: System, velocities: FloatArray, points: NDArray[np.int64], count: int
) -> tuple[System, NDArray[np.int64]]:
    """Merge contact points that slip alike; other points than those given are dropped.

    Parameters
    ----------
    system : System
        Reduced system.
    velocities : ndarray, shape (times, n)
        Velocities of its unknowns in a run that slips as the runs to come.
    points : ndarray of int
        Contact points to keep; the others must not move. Those that stick cost nothing.
    count : int
        Most points that are left. At least one is left of each kind, that is of the points with
        equal beta and as many directions.

    Returns
    -------
    system : System
        Same unknowns; the slip rows of a point are the means, weighted with the friction limits,
        of those it stands for, and its limit is their sum.
    owner : ndarray of int, shape (m,)
        Point of the new system that stands for each old one; -1 if it was dropped.
    """
    if count < 1:
        raise InputError(f"friction points: found {count}, must be >= 1")
    B, first = np.asarray(system.B), system.first_row
    points = points[system.w[points] > 0.0]
    kinds = np.stack([system.directions[points].astype(float), system.beta[points]], axis=1)
    sets = [points[np.all(kinds == kind, axis=1)] for kind in np.unique(kinds, axis=0)]
    rates = velocities[:: -(-len(velocities) // _TIMES)]
    histories = [_histories(B, first, system.directions, rates, members) for members in sets]
    # The points go where the most friction power is.
    power = [system.w[p] @ (x * x).sum(axis=1) for p, x in zip(sets, histories, strict=True)]
    owner = np.full(system.w.size, -1, dtype=np.int64)
    rows = [B[:0]]
    weights: list[float] = []
    betas: list[float] = []
    directions: list[int] = []
    for members, x, share in zip(sets, histories, power, strict=True):
        wanted = max(1, int(count * share / sum(power))) if sum(power) > 0.0 else 1
        label = partition(x, system.w[members], min(wanted, members.size))
        d = int(system.directions[members[0]])
        owner[members] = len(weights) + label
        for k in range(label.max() + 1):
            merged = members[label == k]
            w = system.w[merged]
            slip_rows = first[merged][:, np.newaxis] + np.arange(d)
            rows.append(np.einsum("p,pdj->dj", w / w.sum(), B[slip_rows]))
            weights.append(float(w.sum()))
            betas.append(float(system.beta[merged[0]]))
            directions.append(d)
    new = replace(
        system,
        B=np.ascontiguousarray(np.vstack(rows)),
        w=np.array(weights),
        beta=np.array(betas),
        directions=np.array(directions, dtype=np.int64),
    )
    return new, owner


def _histories(
    B: FloatArray,
    first: NDArray[np.int64],
    directions: NDArray[np.int64],
    velocities: FloatArray,
    points: NDArray[np.int64],
) -> FloatArray:
    """Histories of y / sqrt(|y|) of points alike in directions, in their principal axes."""
    rows = first[points][:, np.newaxis] + np.arange(directions[points[0]])
    slip = np.einsum("pdj,tj->ptd", B[rows], velocities)
    size = np.sqrt((slip * slip).sum(axis=2, keepdims=True))
    x = (slip / np.sqrt(np.where(size > 0.0, size, 1.0))).reshape(points.size, -1)
    axes = np.linalg.eigh(x.T @ x)[1]
    return np.asarray(x @ axes[:, -_DIRECTIONS:])


def partition(x: FloatArray, weight: FloatArray, count: int) -> NDArray[np.int64]:
    """Partition points into sets that are close together: weighted k-means.

    Lloyd's iteration (IEEE Trans. Inf. Theory 28, 1982) from starts far apart (Gonzalez, Theor.
    Comput. Sci. 38, 1985), so that the result depends on no random numbers.

    Parameters
    ----------
    x : ndarray, shape (m, d)
    weight : ndarray, shape (m,)
        Positive.
    count : int
        Most sets, at most m.

    Returns
    -------
    ndarray of int, shape (m,)
        Set of each point; every number from 0 to the largest occurs.
    """
    square = (x * x).sum(axis=1)
    starts = [int(np.argmax(weight * square))]
    distance = weight * ((x - x[starts[0]]) ** 2).sum(axis=1)
    while len(starts) < count and distance.max() > 0.0:
        starts.append(int(np.argmax(distance)))
        distance = np.minimum(distance, weight * ((x - x[starts[-1]]) ** 2).sum(axis=1))
    centres = x[starts]
    label = np.full(len(x), -1)
    for _ in range(200):
        old = label
        label = np.argmin((centres * centres).sum(axis=1) - 2.0 * x @ centres.T, axis=1)
        if np.array_equal(label, old):
            break
        total = np.bincount(label, weight, minlength=len(centres))
        for k in np.flatnonzero(total):
            members = label == k
            centres[k] = weight[members] @ x[members] / total[k]
    return np.unique(label, return_inverse=True)[1].astype(np.int64)
