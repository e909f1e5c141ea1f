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

import numpy as np

from skfem_joint.ground.arrays import Matrix, as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.shifts import shifted
from skfem_joint.system.system import System

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
