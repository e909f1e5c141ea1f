"""Fewer contact points for reduced models: points that slip and are pressed alike are merged.

A merged point slips as the mean of its parts, weighted with their friction limits, and its limit is
their sum, as is the stiffness of its spring. So weights are positive, which keeps every step
convex, and the total limit, which a joint carries when all of it slips, is kept. As the friction
potential is convex, a merged point never dissipates more than its parts do at the same velocities.

Fewer points are not only cheaper. A model with j modes cannot hold more than j points still; with
hundreds of points it creeps where it should stick, and dissipates too much.

Points slip alike if their histories of y / sqrt(|y|) are close, y being the slip velocity: the
squared distance of two of these is about the friction power that merging them loses.
``docs/verification/reduction.md`` compares other ways to choose points.

With contact that opens a friction point and the pressure point that gives it its limit are merged
with other such pairs. The pressure point of them all approaches by the mean of its parts, weighted
with their stiffness, and has their forces at rest, areas and stiffness together: it is an elastic
point as any other, which cannot create energy. While all its parts are closed it has the sum of
their forces. Slips are weighted with the mean limits of the training, as those at rest may be zero.
Parts have the same gain, so that limits at rest, and their change with the forces, are sums too.
Pairs are alike if, beside their slips, their histories of what they are pressed into each other are
close: the squared distance times the stiffness is the elastic energy that merging loses.

Points that are apart at rest slip far while they touch: one of them may have a twentieth of the
friction energy of a joint of hundreds. Each is left for itself. Those whose faces do not come near
each other in the training are left out.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.reduction.pod import thinned
from skfem_joint.system.system import System

#: Why nothing slips.
NOWHERE = "every joint has zero pressure or zero friction"
NO_FRICTION = f"models.run: 'reduced' needs friction in a joint; {NOWHERE}. Run 'full' alone."


#: Contact points beyond which preliminary and verification runs merge them.
MANY = 1000
#: Number of points that these have then. With 600 to 150 points a verification run stated an
#: error of 10 % where 2.7 % was true, with 40 a hundred times the truth.
MERGED = 150
#: Most times at which slip velocities are compared.
TIMES = 150
#: Principal directions of the histories that are kept.
DIRECTIONS = 40
#: Most rounds of the iteration for the sets of points.
ROUNDS = 200
#: Weight of the share of elastic energy that merging loses over that of friction power.
PRESSED = 3.0
#: Points that are apart at rest are left out if they stay apart by this share of their gap.
NEAR = 0.02
#: Largest share of such points in the number of points; more of them are merged as others.
APART = 0.75
#: Share of the friction power that merging may lose.
MOST_LOST = 0.003


def friction_lost(
    unmerged: System,
    merged: System,
    velocities: FloatArray,
    displacements: FloatArray | None = None,
) -> float:
    """Share of the friction power that merging loses, both systems at the same velocities.

    Parameters
    ----------
    unmerged, merged : System
        The same reduced system with all contact points and with merged ones.
    velocities, displacements : ndarray, shape (times, n)
        Of the unknowns; with contact that opens limits are means over these displacements.
    """
    rates = thinned(velocities, TIMES)
    powers = []
    for system in (unmerged, merged):
        speeds = system.contact.slip_norm(rates @ np.asarray(system.contact.B).T)
        powers.append(float((speeds @ _States.of(system, displacements).limits).sum()))
    return abs(1.0 - powers[1] / powers[0]) if powers[0] > 0.0 else 0.0


def few_points(
    unmerged: System,
    points: IntArray,
    numbers: Iterable[int],
    velocities: FloatArray,
    displacements: FloatArray,
) -> System:
    """System with the first of some numbers of merged points that loses little friction power.

    It has the last of them if none loses so little. The other arguments are those of
    `merged_points`.
    """
    for count in numbers:
        merged = merged_points(unmerged, velocities, points, count, displacements)
        if friction_lost(unmerged, merged, velocities, displacements) <= MOST_LOST:
            break
    return merged


def merged_points(
    system: System,
    velocities: FloatArray,
    points: IntArray,
    count: int,
    displacements: FloatArray | None = None,
) -> System:
    """System with contact points that slip and are pressed alike merged into at most ``count``.

    Points of different joints, numbers of slip directions or values of beta are not merged, nor
    those with springs and those without, those whose limits follow their normal forces differently,
    or those that are pressed at rest and those that are apart: at least one point of each kind is
    left. Kinds get points in proportion to their friction power. Points that limit each other in
    other ways than one by one are left as they are.

    Parameters
    ----------
    system : System
        Contact that opens has a stiffness.
    velocities : ndarray, shape (times, n)
        Velocities of the unknowns in a run that is typical of the runs to come.
    points : ndarray of int
        Friction points to merge; others are dropped.
    count : int
    displacements : ndarray, shape (times, n), optional
        Unknowns in that run, by which contact opens; at rest if not given.

    Returns
    -------
    System
        Row k of its ``shares`` holds the weights of the old points in the new point k.
    """
    states = _States.of(system, displacements)
    units = _Units.of(system, points, states, count)
    sets = units.sets
    histories = units.histories(system, states, thinned(velocities, TIMES), sets)
    weights = [units.weight[members] for members in sets]
    single = np.array([units.alone[members[0]] for members in sets])
    power = np.array([w @ (x * x).sum(axis=1) for w, x in zip(weights, histories, strict=True)])
    power[single], left = 0.0, count - int(single.sum())
    sizes = np.array([members.size for members in sets])
    share = power / (sum(power) or 1.0)
    wanted = np.clip((left * share).astype(int), 1, sizes)
    # Points that are left over go to kinds with members to spare, in proportion to these.
    spare = sizes - wanted
    wanted += np.minimum(spare, max(count - wanted.sum(), 0) * spare // max(spare.sum(), 1))
    owner, total = np.zeros(units.weight.size, dtype=np.intp), 0
    for members, w, x, most in zip(sets, weights, histories, wanted, strict=True):
        owner[members] = total + partition(x, w, int(most))
        total = int(owner[members].max()) + 1
    return units.merged(system, states, owner)


def shared_points(
    system: System,
    shares: sparse.csr_array,
    given: FloatArray,
    pressed: sparse.csr_array | None = None,
) -> System:
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
    pressed : sparse array, shape (new pressure points, q), optional
        Shares of the old pressure points in the new ones; they stay as they are if not given.
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
    normal, gain = contact.normal, sparse.csr_array(contact.gain)
    gain = sparse.csr_array((shares > 0.0).astype(float) @ gain)
    if pressed is not None:
        normal, gain = normal.merged(pressed), sparse.csr_array(gain @ pressed.T)
    J = contact.J @ shares.T
    changes = {"B": B, "given": given, "J": J, "shares": of_all, "gain": gain, "normal": normal}
    return system.with_contact(**changes, **alike)


class _States(NamedTuple):
    """What contact does at rest and at the displacements of a training run.

    Attributes
    ----------
    reach : ndarray, shape (times, q)
        How far the faces are beyond their bound at each pressure point, m; negative apart.
    limits : ndarray, shape (m,)
        Means of the friction limits of all friction points, N.
    """

    reach: FloatArray
    limits: FloatArray

    @classmethod
    def of(cls, system: System, displacements: FloatArray | None) -> _States:
        """States of a system whose contact that opens has a stiffness."""
        normal, u = system.contact.normal, np.zeros((1, system.n))
        if displacements is not None:
            u = np.vstack([u, thinned(displacements, TIMES)])
        reach = normal.force / normal.stiffness - normal.gaps(u)
        limits = system.contact.limits(normal.elastic_forces(u).mean(axis=0))
        # Those of points that are pressed at no time are not zero, as they are weights.
        return cls(reach, np.maximum(limits, 1e-9 * limits.max(initial=0.0)))


class _Units(NamedTuple):
    """What may be merged: friction points, pressure points, and pairs of one of each.

    Attributes
    ----------
    slider, presser : ndarray of int, shape (u,)
        Friction point and pressure point of each unit; -1 for none.
    kinds : ndarray, shape (u, k)
        Units with equal rows may be merged.
    alone : ndarray of bool, shape (u,)
        Whether a unit is left for itself.
    weight : ndarray, shape (u,)
        Weight in the partition: the stiffness, N/m, or the friction limit, N, without one.
    """

    slider: IntArray
    presser: IntArray
    kinds: FloatArray
    alone: BoolArray
    weight: FloatArray

    @classmethod
    def of(cls, system: System, points: IntArray, states: _States, count: int) -> _Units:
        """Units of some friction points of a system, and of all pressure points that touch."""
        contact, normal = system.contact, system.contact.normal
        gain = sparse.csr_array(contact.gain, copy=True)
        gain.eliminate_zeros()
        pressing, limited = np.diff(gain.indptr), np.bincount(gain.indices, minlength=gain.shape[1])
        pairs = np.flatnonzero(pressing == 1)
        pairs = pairs[limited[gain.indices[gain.indptr[pairs]]] == 1]
        partner = np.full(pressing.size, -1)
        partner[pairs] = gain.indices[gain.indptr[pairs]]
        pressed = normal.force > 0.0
        touches = pressed | (states.reach.max(axis=0) + NEAR * normal.gap >= 0.0)
        # The number -1 stands for none, and takes what is appended.
        left = np.where(np.append(touches, False)[partner], partner, -1)
        kept = contact.rubs & ((left == partner) | (contact.given > 0.0))
        slider = points[kept[points]]
        others = np.setdiff1d(np.flatnonzero(touches), left[slider])
        presser = np.concatenate([left[slider], others])
        slider = np.concatenate([slider, np.full(others.size, -1)])
        slides, presses = slider >= 0, presser >= 0
        links = np.where(slides, np.append(pressing, 0)[slider], np.append(limited, 0)[presser])
        apart = presses & ~np.append(pressed, False)[presser]
        few = np.count_nonzero(apart) <= APART * count
        alone = (links > 0) & ~(slides & presses) | (apart & few)
        slopes = np.where(slides & presses, np.append(gain.sum(axis=1), 0.0)[slider], 0.0)
        slopes = np.round(slopes / (slopes.max(initial=0.0) or 1.0), 9)
        own = np.where(alone, np.arange(1, slider.size + 1), 0)
        kinds = np.hstack([laws_of(system, slider), np.stack([presses, apart, slopes, own]).T])
        stiffness, limits = np.append(normal.stiffness, 0.0), np.append(states.limits, 0.0)
        weight = np.where(presses, stiffness[presser], limits[slider])
        return cls(slider, presser, kinds, alone, weight)

    @property
    def sets(self) -> list[IntArray]:
        """Numbers of the units of each kind."""
        return [
            np.flatnonzero(np.all(self.kinds == kind, axis=1))
            for kind in np.unique(self.kinds, axis=0)
        ]

    def histories(
        self, system: System, states: _States, rates: FloatArray, sets: list[IntArray]
    ) -> list[FloatArray]:
        """Coordinates of the units of each of some sets, by which they are alike."""
        slips, presses, lost = [], [], [0.0, 0.0]
        for members in sets:
            slider, presser = self.slider[members], self.presser[members]
            x = over = np.zeros((members.size, 0))
            if slider[0] >= 0:
                x = _slips(system, rates, slider)
            if presser[0] >= 0:
                x = x * np.sqrt(states.limits[slider] / self.weight[members])[:, np.newaxis]
                over = np.maximum(states.reach[:, presser], 0.0).T
            slips.append(x)
            presses.append(over)
            moved = over - over.sum(axis=1, keepdims=True) / len(states.reach)
            for k, part in enumerate((x, moved)):
                lost[k] += float(self.weight[members] @ (part * part).sum(axis=1))
        scale = np.sqrt(PRESSED * lost[0] / lost[1]) if min(lost) > 0.0 else 1.0
        parts = zip(slips, presses, strict=True)
        return [_along_axes(np.hstack([x, scale * over])) for x, over in parts]

    def merged(self, system: System, states: _States, owner: IntArray) -> System:
        """System whose points merge the units with the same number, (u,)."""
        slides, presses = self.slider >= 0, self.presser >= 0
        slider = owner[slides], self.slider[slides]
        given = np.asarray(_members(*slider, system.contact.given).sum(axis=1))
        shares = means_of(*slider, states.limits)
        pressed = means_of(owner[presses], self.presser[presses], system.contact.normal.stiffness)
        return shared_points(system, shares, given, pressed)


def _members(owner: IntArray, points: IntArray, weights: FloatArray) -> sparse.csr_array:
    """Matrix of the weights (m,) of some points in the sets that own them, (sets, m)."""
    number = np.unique(owner, return_inverse=True)[1]
    shape = int(number.max(initial=-1)) + 1, weights.size
    return sparse.csr_array((weights[points], (number, points)), shape=shape)


def means_of(owner: IntArray, points: IntArray, weights: FloatArray) -> sparse.csr_array:
    """The same, with the sum 1 in each row."""
    members = _members(owner, points, weights)
    return sparse.csr_array(sparse.diags_array(1.0 / np.asarray(members.sum(axis=1))) @ members)


def laws_of(system: System, points: IntArray) -> FloatArray:
    """Joints, directions, law and springs of friction points, (k, ...); zero for the number -1."""
    contact = system.contact
    joints = sparse.csr_array(contact.J)[:, points].toarray() > 0.0
    laws = contact.directions, contact.beta, np.isfinite(contact.stiffness)
    return np.where(points >= 0, np.vstack([joints, *(law[points] for law in laws)]), 0.0).T


def _slips(system: System, velocities: FloatArray, points: IntArray) -> FloatArray:
    """Histories of y / sqrt(|y|) of points with equal directions."""
    contact = system.contact
    rows = contact.first_row[points][:, np.newaxis] + np.arange(contact.directions[points[0]])
    slip = np.asarray(contact.B)[rows] @ velocities.T  # (points, directions, times)
    size = np.sqrt((slip * slip).sum(axis=1, keepdims=True))
    return (slip / np.sqrt(np.where(size > 0.0, size, 1.0))).reshape(points.size, -1)


def _along_axes(x: FloatArray) -> FloatArray:
    """Coordinates (m, d) in their principal axes, those that count."""
    axes = np.linalg.eigh(x.T @ x)[1]
    return np.asarray(x @ axes[:, -DIRECTIONS:])


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
    for _ in range(ROUNDS):
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
