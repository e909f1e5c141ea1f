"""Fewer friction points for reduced models, with positive weights and the total limit kept.

Positive weights keep every step convex, and the sum of the limits is what a joint carries when all
of it slips. Fewer points are not only cheaper: a model with j modes cannot hold more than j points
still; with a hundred of them it creeps where it should stick, and dissipates too much.

Along a line (:func:`gauss_points`) the Gauss rule of the nodal limits with p points is exact for
polynomials up to degree 2 p - 1, whatever the mesh, the pressure or the lumping. Elsewhere
(:func:`merged_points`) points that slip alike become one: their histories of y / sqrt(|y|) are
close, y the slip velocity. As the friction potential is convex, a merged point never dissipates
more than its parts at equal velocities. ``examples/reduction.md`` has what other ways leave.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.linalg import eigh_tridiagonal

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.reduction.pod import thinned
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.reduction.basis import Basis

NO_FRICTION = (
    "models.run: 'reduced' needs friction in a joint; every joint has zero pressure or zero "
    "friction. Run 'full' alone."
)

#: Friction points for each mode: of each active stretch along a line; of all that is merged, more
#: while merging loses more than a share of the friction power.
POINTS_PER_MODE, MERGED_PER_MODE, MOST_LOST = 4, (3, 6, 12), 3e-3
#: Contact points beyond which looks at a model merge them, as its basis slips, and to how many
#: (that of 600 to 150 said 10 % where 2.7 % was true, to 40 a hundred times the truth).
MANY, MERGED = 1000, 150
#: Resolving the friction law more finely than the modes resolve velocities gains nothing. A free
#: decay comes to rest, where a law less steep would let the joint creep: there it is steeper.
DECAYING = 100.0
#: Slip velocity of a joint that sticks throughout, for the choice of beta, m/s.
STUCK_VELOCITY = 1e-3
#: Times at which slip velocities are compared, principal directions that are kept of them, the
#: squared distance, relative, that is round-off, and rounds in which sets are found.
_TIMES, _DIRECTIONS, _ALIKE, _ROUNDS = 150, 40, 1e-14, 200


def reduced_system(
    system: System,
    basis: Basis,
    *,
    friction_points: str | int = "auto",
    beta: str | float = "auto",
    periodic: bool = True,
) -> System:
    """Reduced system with friction points and a steepness of its own.

    ``friction_points`` ("auto", "all" or a number) are Gauss points of each stretch of the basis,
    or where it has none merged points in all. ``beta`` (s/m) is the system's where the modes
    resolve it, and no steeper, but for a free decay (not ``periodic``), which gets a steeper law.
    Its ``notes`` say what to beware of. Its ``shares`` say which points of
    ``system`` each of its own stands for. InputError if no point carries friction, or for less
    than one point.
    """
    if system.contact_points == 0:
        raise InputError(NO_FRICTION)
    reduced, notes = system.project(basis.V), []
    count = None if isinstance(friction_points, str) else friction_points
    if count is not None and count < 1:
        raise InputError(f"reduction.friction_points: found {count}, must be >= 1")
    if friction_points != "all" and basis.stretches is not None:
        each = count or POINTS_PER_MODE * basis.modes
        reduced = gauss_points(reduced, basis.stretches, each)
    elif friction_points != "all":
        every, rates = reduced, basis.velocities
        tried = [k * every.n for k in MERGED_PER_MODE] if count is None else [count]
        for most in tried:
            reduced = merged_points(every, rates, basis.active, most)
            if friction_lost(every, reduced, rates) <= MOST_LOST:
                break
        if count is not None and reduced.w.size < count:
            notes.append(
                f"The reduced model has {reduced.w.size} friction points instead of {count}: no "
                "more of the joints' points slip apart from each other."
            )
    if not isinstance(beta, str):
        return replace(reduced, beta=np.full_like(reduced.beta, beta), notes=tuple(notes))
    velocity = basis.slip_velocity or STUCK_VELOCITY
    share = basis.resolved if periodic else basis.resolved / DECAYING
    steepest = 1.0 / (share * velocity)
    if np.any(system.beta > steepest):
        notes.append(
            f"The reduced model uses beta = {steepest:.3g} s/m: its modes do not resolve slip "
            f"velocities below {share:g} of the largest ({velocity:.3g} m/s), where a steeper law "
            "would differ. Set reduction.beta to choose."
        )
    return replace(reduced, beta=np.minimum(reduced.beta, steepest), notes=tuple(notes))


def friction_lost(every: System, few: System, velocities: FloatArray) -> float:
    """Share of the friction power that fewer points lose at equal velocities (times, n)."""
    rates = thinned(velocities, _TIMES)
    powers = [
        float((one.slip_norm(rates @ np.asarray(one.B).T) @ one.w).sum()) for one in (every, few)
    ]
    return 1.0 - powers[1] / powers[0] if powers[0] > 0.0 else 0.0


def gauss_rule(
    position: FloatArray, weight: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Gauss quadrature of a discrete measure: positions, increasing, and weights of equal sum.

    By Lanczos and its Jacobi matrix: Golub and Welsch, Math. Comp. 23 (1969); Gautschi, Orthogonal
    Polynomials (2004), section 2.2.
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


def gauss_points(
    system: System, stretches: Sequence[tuple[IntArray, FloatArray]], count: int
) -> System:
    """Replace the contact points of each stretch by a Gauss rule; other points are dropped.

    A stretch is contact points with one slip direction and one beta, and their positions along a
    line, m; points in none of them must not move. Each gets ``count`` points (fewer where it has
    fewer), between old ones, whose shares in the new ones are the ``shares`` of the system.
    """
    shares, weights = [sparse.csr_array((0, system.w.size))], [np.zeros(0)]
    for points, position in stretches:
        order = np.argsort(position)
        points, position = points[order], position[order]
        acting = system.w[points] > 0.0
        if not np.any(acting):
            continue
        most = min(count, int(np.count_nonzero(acting)))
        x, w = gauss_rule(position[acting], system.w[points[acting]], most)
        left = np.clip(np.searchsorted(position, x), 1, max(points.size - 1, 1)) - 1
        right = np.minimum(left + 1, points.size - 1)
        gap = position[right] - position[left]
        share = (x - position[left]) / np.where(gap > 0.0, gap, 1.0)
        entries = np.concatenate([1.0 - share, share])
        places = np.tile(np.arange(x.size), 2), np.concatenate([points[left], points[right]])
        shares.append(sparse.csr_array((entries, places), shape=(x.size, system.w.size)))
        weights.append(w)
    return shared_points(system, sparse.vstack(shares, format="csr"), np.concatenate(weights))


def merged_points(system: System, velocities: FloatArray, points: IntArray, count: int) -> System:
    """Merge contact points that slip alike into at most ``count``; others than ``points`` go.

    Alike in ``velocities`` (times, n) of the unknowns in a run that slips as the runs to come.
    At least one is left of each joint, beta and number of directions. Its slip rows are means,
    weighted with the friction limits, of those it stands for, and its limit is their sum; the
    ``shares`` of the system are these weights.
    """
    points = points[system.w[points] > 0.0]
    joints = sparse.csr_array(system.J)[:, points].toarray() > 0.0
    kinds = np.vstack([joints, system.directions[points], system.beta[points]]).T
    sets = [points[np.all(kinds == kind, axis=1)] for kind in np.unique(kinds, axis=0)]
    rates = thinned(velocities, _TIMES)
    histories = [_histories(system, rates, members) for members in sets]
    # The points go where the most friction power is, those that are left over where there is room.
    power = [system.w[p] @ (x * x).sum(axis=1) for p, x in zip(sets, histories, strict=True)]
    sizes = np.array([members.size for members in sets])
    share = np.array(power) / (sum(power) or 1.0)
    wanted = np.clip((count * share).astype(int), 1, sizes)
    room = sizes - wanted
    wanted += np.minimum(room, max(count - wanted.sum(), 0) * room // max(room.sum(), 1))
    owner, total = np.zeros(system.w.size, dtype=np.intp), 0
    for members, x, most in zip(sets, histories, wanted, strict=True):
        owner[members] = total + partition(x, system.w[members], int(most))
        total = int(owner[members].max()) + 1
    place = owner[points], points
    limits = sparse.csr_array((system.w[points], place), shape=(total, system.w.size))
    w = np.asarray(limits.sum(axis=1))
    return shared_points(system, sparse.csr_array(sparse.diags_array(1.0 / w) @ limits), w)


def shared_points(system: System, shares: sparse.csr_array, w: FloatArray) -> System:
    """System with new points of limits ``w`` (N) that slip as shares of old ones alike in kind.

    ``shares`` is sparse, (new points, m); those of the system are of the points of the structure,
    whatever ``system`` itself stands for.
    """
    like = shares.indices[shares.indptr[:-1]]
    directions = system.directions[like]
    both = sparse.csr_array(sparse.kron(shares, np.eye(2)))  # as if all slipped in two directions
    new, old = (np.flatnonzero(d[:, np.newaxis] > [0, 1]) for d in (directions, system.directions))
    B = both[new][:, old] @ system.B
    alike = {"beta": system.beta[like], "directions": directions}
    of_all = shares if system.shares is None else sparse.csr_array(shares @ system.shares)
    return replace(system, B=B, w=w, J=system.J @ shares.T, shares=of_all, **alike)


def _histories(system: System, velocities: FloatArray, points: IntArray) -> FloatArray:
    """Histories of y / sqrt(|y|) of points alike in directions, in their principal axes."""
    rows = system.first_row[points][:, np.newaxis] + np.arange(system.directions[points[0]])
    slip = np.asarray(system.B)[rows] @ velocities.T  # (points, directions, times)
    size = np.sqrt((slip * slip).sum(axis=1, keepdims=True))
    x = (slip / np.sqrt(np.where(size > 0.0, size, 1.0))).reshape(points.size, -1)
    axes = np.linalg.eigh(x.T @ x)[1]
    return np.asarray(x @ axes[:, -_DIRECTIONS:])


def partition(x: FloatArray, weight: FloatArray, count: int) -> IntArray:
    """Partition points into at most ``count`` sets that are close together: weighted k-means.

    Lloyd's iteration (IEEE Trans. Inf. Theory 28, 1982) from starts far apart (Gonzalez, Theor.
    Comput. Sci. 38, 1985), so that the result depends on no random numbers. Of points ``x`` (m, d)
    with positive weights (m,); gives the number of the set of each, (m,), none of them empty.
    """
    square = (x * x).sum(axis=1)
    distance, starts = np.full(len(x), np.inf), [int(np.argmax(weight * square))]
    while True:
        start = starts[-1]
        apart = square + square[start] - 2.0 * (x @ x[start])
        apart[apart <= _ALIKE * (square + square[start])] = 0.0
        distance = np.minimum(distance, weight * apart)
        if len(starts) == count or distance.max() == 0.0:
            break
        starts.append(int(np.argmax(distance)))
    centres, label, near = x[starts], np.full(len(x), -1), np.empty((len(x), len(starts)))
    for _ in range(_ROUNDS):
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
