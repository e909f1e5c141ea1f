"""Fewer friction points for reduced models: points that slip alike are merged.

A merged point slips as the mean of its parts, weighted with their friction limits, and its limit is
their sum, as is the stiffness of its spring. So weights are positive, which keeps every step
convex, and the total limit, which a joint carries when all of it slips, is kept. As the friction
potential is convex, a merged point never dissipates more than its parts do at the same velocities.

Fewer points are not only cheaper. A model with j modes cannot hold more than j points still; with
hundreds of points it creeps where it should stick, and dissipates too much.

Points slip alike if their histories of y / sqrt(|y|) are close, y being the slip velocity: the
squared distance of two of these is about the friction power that merging them loses.
``docs/verification/reduction.md`` compares other ways to choose points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.reduction.pod import thinned
from skfem_joint.system import System

#: Why nothing slips.
NOWHERE = "every joint has zero pressure or zero friction"
NO_FRICTION = f"models.run: 'reduced' needs friction in a joint; {NOWHERE}. Run 'full' alone."


@dataclass(frozen=True)
class MergingSettings:
    """Numbers of the search for points that slip alike.

    Attributes
    ----------
    many : int
        Contact points beyond which preliminary and verification runs merge them.
    merged : int
        Number of points that these have then. With 600 to 150 points a verification run stated an
        error of 10 % where 2.7 % was true, with 40 a hundred times the truth.
    times : int
        Most times at which slip velocities are compared.
    directions : int
        Principal directions of the histories that are kept.
    rounds : int
        Most rounds of the iteration for the sets of points.
    """

    many: int = 1000
    merged: int = 150
    times: int = 150
    directions: int = 40
    rounds: int = 200


SETTINGS = MergingSettings()


def friction_lost(unmerged: System, merged: System, velocities: FloatArray) -> float:
    """Share of the friction power that merging loses, both systems at the same velocities.

    Parameters
    ----------
    unmerged, merged : System
        The same reduced system with all contact points and with merged ones.
    velocities : ndarray, shape (times, n)
        Velocities of the unknowns.
    """
    rates = thinned(velocities, SETTINGS.times)
    all_of_it, rest = (
        float(
            (
                system.contact.slip_norm(rates @ np.asarray(system.contact.B).T) @ system.contact.w
            ).sum()
        )
        for system in (unmerged, merged)
    )
    return 1.0 - rest / all_of_it if all_of_it > 0.0 else 0.0


def merged_points(system: System, velocities: FloatArray, points: IntArray, count: int) -> System:
    """System with contact points that slip alike merged into at most ``count``.

    Points of different joints, numbers of slip directions or values of beta are not merged, nor
    those with springs and those without: at least one point of each kind is left. Kinds get points
    in proportion to their friction power.

    Parameters
    ----------
    system : System
    velocities : ndarray, shape (times, n)
        Velocities of the unknowns in a run that is typical of the runs to come.
    points : ndarray of int
        Contact points to merge; others are dropped.
    count : int

    Returns
    -------
    System
        Row k of its ``shares`` holds the weights of the old points in the new point k.
    """
    points = points[system.contact.w[points] > 0.0]
    joints = sparse.csr_array(system.contact.J)[:, points].toarray() > 0.0
    laws = system.contact.directions, system.contact.beta, np.isfinite(system.contact.stiffness)
    kinds = np.vstack([joints, *(law[points] for law in laws)]).T
    sets = [points[np.all(kinds == kind, axis=1)] for kind in np.unique(kinds, axis=0)]
    rates = thinned(velocities, SETTINGS.times)
    histories = [_histories(system, rates, members) for members in sets]
    power = [
        system.contact.w[p] @ (x * x).sum(axis=1) for p, x in zip(sets, histories, strict=True)
    ]
    sizes = np.array([members.size for members in sets])
    share = np.array(power) / (sum(power) or 1.0)
    wanted = np.clip((count * share).astype(int), 1, sizes)
    # Points that are left over go to kinds with members to spare, in proportion to these.
    spare = sizes - wanted
    wanted += np.minimum(spare, max(count - wanted.sum(), 0) * spare // max(spare.sum(), 1))
    owner, total = np.zeros(system.contact.w.size, dtype=np.intp), 0
    for members, x, most in zip(sets, histories, wanted, strict=True):
        owner[members] = total + partition(x, system.contact.w[members], int(most))
        total = int(owner[members].max()) + 1
    place = owner[points], points
    limits = sparse.csr_array(
        (system.contact.w[points], place), shape=(total, system.contact.w.size)
    )
    w = np.asarray(limits.sum(axis=1))
    return shared_points(system, sparse.csr_array(sparse.diags_array(1.0 / w) @ limits), w)


def shared_points(system: System, shares: sparse.csr_array, given: FloatArray) -> System:
    """System whose contact points are weighted means of old points with equal beta.

    The old points of a mean must have the same number of slip directions, too. The ``shares`` of
    the result refer to the points of the structure, even if ``system`` has merged points already.

    Parameters
    ----------
    system : System
    shares : sparse array, shape (new points, m)
        Weights of the old points in each new one.
    given : ndarray, shape (new points,)
        Friction limits of the new points, N, without those of normal forces that change.
    """
    contact = system.contact
    like = shares.indices[shares.indptr[:-1]]  # an old point of each new one
    directions = contact.directions[like]
    both = sparse.csr_array(sparse.kron(shares, np.eye(2)))  # as if all slipped in two directions
    new, old = (np.flatnonzero(d[:, np.newaxis] > [0, 1]) for d in (directions, contact.directions))
    B = both[new][:, old] @ contact.B
    alike = {"beta": contact.beta[like], "directions": directions}
    if contact.has_springs:  # in parallel
        members = sparse.csr_array((np.ones(shares.nnz), shares.indices, shares.indptr))
        members.resize(shares.shape)
        alike["stiffness"] = members @ contact.stiffness
    else:
        alike["stiffness"] = np.full(given.size, np.inf)
    of_all = shares if contact.shares is None else sparse.csr_array(shares @ contact.shares)
    gain = sparse.csr_array((shares > 0.0).astype(float) @ sparse.csr_array(contact.gain))
    J = contact.J @ shares.T
    changes = {"B": B, "given": given, "J": J, "shares": of_all, "gain": gain}
    return system.with_contact(**changes, **alike)


def _histories(system: System, velocities: FloatArray, points: IntArray) -> FloatArray:
    """Histories of y / sqrt(|y|) of points with equal directions, in their principal axes."""
    rows = system.contact.first_row[points][:, np.newaxis] + np.arange(
        system.contact.directions[points[0]]
    )
    slip = np.asarray(system.contact.B)[rows] @ velocities.T  # (points, directions, times)
    size = np.sqrt((slip * slip).sum(axis=1, keepdims=True))
    x = (slip / np.sqrt(np.where(size > 0.0, size, 1.0))).reshape(points.size, -1)
    axes = np.linalg.eigh(x.T @ x)[1]
    return np.asarray(x @ axes[:, -SETTINGS.directions :])


def partition(x: FloatArray, weight: FloatArray, count: int) -> IntArray:
    """Partition points into at most ``count`` sets of points that are close: weighted k-means.

    Lloyd's iteration (IEEE Trans. Inf. Theory 28, 1982) from starts that are far apart (Gonzalez,
    Theor. Comput. Sci. 38, 1985), so that the result depends on no random numbers.

    Parameters
    ----------
    x : ndarray, shape (m, d)
        Coordinates of the points.
    weight : ndarray, shape (m,)
        Positive weights.
    count : int

    Returns
    -------
    ndarray of int, shape (m,)
        Number of each point's set; no set is empty.
    """
    square = (x * x).sum(axis=1)
    distance, starts = np.full(len(x), np.inf), [int(np.argmax(weight * square))]
    while True:
        start = starts[-1]
        apart = square + square[start] - 2.0 * (x @ x[start])
        apart[apart <= 1e-14 * (square + square[start])] = 0.0  # round-off
        distance = np.minimum(distance, weight * apart)
        if len(starts) == count or distance.max() == 0.0:
            break
        starts.append(int(np.argmax(distance)))
    centres, label, near = x[starts], np.full(len(x), -1), np.empty((len(x), len(starts)))
    for _ in range(SETTINGS.rounds):
        old = label
        np.matmul(x, centres.T, out=near)
        near -= 0.5 * (centres * centres).sum(axis=1)
        label = np.argmax(near, axis=1)
        if np.array_equal(label, old):
            break
        place = label, np.arange(label.size)
        members = sparse.csr_array((weight, place), shape=(len(centres), label.size))
        total = members.sum(axis=1)
        centres[total > 0.0] = (members @ x)[total > 0.0] / total[total > 0.0, np.newaxis]
    return np.asarray(np.unique(label, return_inverse=True)[1], dtype=np.intp)
