"""Fewer contact points for condensed models: points that move alike with loose joints are merged.

Elements of second order have two to four times as many contact points as those of first order, and
a step of a condensed model costs several times as much. Half of the points often cost less accuracy
than the mesh itself, but not always, see ``docs/verification/elements.md``: so points are
merged where that is asked for, and what it causes is estimated.

A condensed model has no modes that hold what sticks: points that are merged because both of them
stick under one load may slide against each other under another. (Points merged by their slips at a
low load were 16 to 47 % off in the friction energy, at that load and at higher ones.) So points are
merged for any load: those with nearly the same slips in the lowest modes with loose joints, which
are neighbours. Merged points slip as the mean of their parts, weighted with their limits, and have
the sum of their limits, as in `skfem_joint.reduction.friction_points`: where all of a joint slips
one way, its forces are those of all points, with their resultant and moments.
"""

from __future__ import annotations

import numpy as np

from skfem_joint.ground.arrays import IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.reduction.friction_points import laws_of, means_of, partition, shared_points
from skfem_joint.system.modes import lowest_modes
from skfem_joint.system.system import System

#: Modes with loose joints in which merged points have nearly the same slips.
MODES = 60
#: Slips are divided by the root of the frequency, but by no less than that of this share of the
#: highest: rigid motions count as the lowest modes.
LEAST = 1e-3


def with_points(system: System, points: str | int) -> System:
    """System with at most some number of contact points, or with "all" of them.

    It is the system itself where nothing is merged.

    Raises
    ------
    InputError
        If points of contact that opens would have to be merged.
    """
    count = system.contact.count
    if isinstance(points, str) or points >= count:
        return system
    if system.contact.opens:
        raise InputError(
            f"models.contact_points: found {points}, must be 'all' where contact opens: each of "
            f"its {count} points opens by itself; a reduced model merges them"
        )
    contact, rubbing = system.contact, np.flatnonzero(system.contact.rubs)
    frequency, modes = lowest_modes(system.K, system.M, min(MODES, system.n - 1))
    known = np.maximum(frequency, LEAST * frequency.max())
    slips = np.asarray(contact.B @ (modes / np.sqrt(known)))
    kinds = laws_of(system, rubbing)
    owner, total = np.zeros(rubbing.size, dtype=np.intp), 0
    for kind in np.unique(kinds, axis=0):
        members = np.flatnonzero(np.all(kinds == kind, axis=1))
        own = rubbing[members]
        rows = contact.first_row[own][:, np.newaxis] + np.arange(contact.directions[own[0]])
        most = max(1, points * members.size // rubbing.size)
        coordinates = slips[rows].reshape(members.size, -1)
        owner[members] = total + partition(coordinates, contact.given[own], most)
        total = int(owner[members].max()) + 1
    shares = means_of(owner, rubbing, contact.given)
    given = np.bincount(owner, weights=contact.given[rubbing]).astype(np.float64)
    return shared_points(system, shares, given)


def points_of(small: System) -> IntArray:
    """Number of points of the structure in each contact point of a condensed model, (m,)."""
    return np.asarray(np.diff(small.contact.shares.indptr), dtype=np.intp)


def with_points_of(system: System, small: System) -> System:
    """Full system with the contact points of a condensed model of it."""
    shares = small.contact.shares
    members = (shares > 0.0).astype(float)
    return shared_points(system, shares, np.asarray(members @ system.contact.given))
