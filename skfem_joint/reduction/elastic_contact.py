"""Contact that opens in reduced models: elastic, so that few unknowns suffice.

Modes in which closed contact moves apart at none of its points and opens at others would have to
know beforehand which points close. A reduced model therefore has elastic contact in place of a
rigid one: each rigid pressure point c of area a_c gets the stiffness

    k_c = factor a_c (sum_i s_i) / (sum_i a_i),    s_i = 1 / (N diag(K)^-1 N^T)_ii,

with the stiffness s_i that the structure itself opposes to a motion of the point alone. The normal
forces then follow from the modes, which are made from paths of the same elastic contact: in these
the faces pass through each other by the normal force over the stiffness, and proper orthogonal
modes in the norm of strain energy, that of the contact included, have the pressures with the
displacements.

The factor is a compromise, see ``docs/theory/opening-reduced.md``: softer contact is easier to
follow, but wrong where contact takes a good part of the motion.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from skfem_joint.ground.arrays import FloatArray, Matrix, as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.shifts import shifted
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.system.system import System

#: Increments of half a slow cycle that modes are made of.
IN_HALF = 8
#: Largest force residual of a state relative to the largest force.
TOLERANCE = 3e-5
#: Stiffness of contact over that which the structure opposes to single points.
FACTOR = 10.0


def elastic(system: System) -> System:
    """System whose rigid contact that opens is elastic; itself if there is none."""
    contact = system.contact.normal
    if not contact.rigid.any():
        return system
    own = contact.opposed(system.K)
    stiffness = FACTOR * own.sum() / contact.area.sum() * contact.area
    stiffness = np.where(contact.rigid, stiffness, contact.stiffness)
    return system.with_contact(normal=replace(contact, stiffness=stiffness))


def check_reference(system: System, reference: str) -> None:
    """Refuse modes of contact that opens that do not come from its static path."""
    if system.contact.opens and reference != "static":
        raise InputError(
            f"reduction.reference: found {reference!r}, must be 'static' with contact that opens, "
            "whose modes come from a path of elastic contact"
        )


def strain_norm(system: System) -> Matrix:
    """Stiffness, (n, n), in whose norm modes are made: with that of elastic contact at rest.

    A little of the mass is added to it, as bodies may move freely.
    """
    springs = system.contact.normal.springs
    return shifted(system.K + (as_dense(springs) if system.is_dense else springs), system.M)


def states_of_cycles(
    system: System, force: FloatArray, level: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """States of slow cycles of a force at some levels, for modes of a damping curve.

    Parameters
    ----------
    system : System
        With elastic contact.
    force : ndarray, shape (n,)
        N at the level 1.
    level : ndarray, shape (levels,)
        Rising levels.

    Returns
    -------
    states, increments : ndarray, shape (s, n)
        Displacements, m, and their changes on the way.
    rigid : ndarray, shape (n, r)
        Motions of bodies that friction and contact alone hold.

    Raises
    ------
    ConvergenceError
        If a level does not converge.
    """
    turns = [0.0]
    for top in level.tolist():
        turns += [top, -top, top]
    shares = [np.linspace(a, b, IN_HALF + 1)[1:] for a, b in pairwise(turns)]
    path = QuasiStatic(system, TOLERANCE)
    states = path.follow(np.concatenate(shares)[:, np.newaxis] * force)
    return states, np.diff(states, axis=0, prepend=0.0), path.to.outer(path.rigid.T).T
