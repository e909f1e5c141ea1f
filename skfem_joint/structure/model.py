"""Structures, whether given on a mesh or by matrices, and reasons to doubt them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np

from skfem_joint.body.body import Body
from skfem_joint.joint.doubts import coarse_for_waves, oscillating_impacts
from skfem_joint.joint.patch import Patch
from skfem_joint.joint.pressure import Bolts
from skfem_joint.mesh.cells import spot
from skfem_joint.structure.matrices import MatrixModel
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System

#: A jointed structure, given by a mesh or by matrices. Functions that need geometry use the
#: `Structure` that `meshed` returns, or the ``body``, which is None if it is given by matrices.
AnyStructure: TypeAlias = Structure | MatrixModel


def doubts(structure: AnyStructure, system: System, waves: bool = True) -> list[str]:
    """Sentences about values, size, loads and joints that suggest a mistake of the user.

    ``waves`` is whether the loads excite waves, which the elements should follow.
    """
    sentences = [*system.notes, *structure.unusual(system)]
    if waves and structure.body is not None:
        sentences += coarse_for_waves(structure.body, system)
        sentences += oscillating_impacts(structure.body, structure.patches)
    if not structure.patches:
        sentences.append("There is no joint: nothing slips, the structure is linear.")
    for patch in structure.patches:
        joint = patch.joint
        if not np.any(system.contact.rubs[patch.points]) or joint.friction == 0.0:
            sentences.append(
                f"Joint '{joint.name}' carries no friction: its pressure or friction is 0."
            )
        if isinstance(joint.pressure, Bolts) and structure.body is not None:
            sentences += _bolt_doubts(structure.body, patch, joint.pressure)
        force, area = patch.clamping_force, float(patch.area.sum()) + patch.held_area
        if force > 0.0 and not 1e3 <= force / area <= 1e10:
            sentences.append(
                f"Joint '{joint.name}' is pressed by {force / area:.4g} Pa; bolts press by "
                "1e6 to 1e9 Pa: is it in Pa?"
            )
        if joint.friction > 2.0:
            sentences.append(
                f"Joint '{joint.name}' has a coefficient of friction of "
                f"{joint.friction:.4g}; dry metals have 0.1 to 1: is it in percent?"
            )
    return sentences


def _bolt_doubts(body: Body, patch: Patch, bolts: Bolts) -> Iterator[str]:
    """Sentences about bolts whose ring leaves the joint or is poorly resolved by the mesh."""
    for bolt, share in zip(bolts.bolts, patch.bolt_shares, strict=True):
        where = f"The bolt at {spot(np.array(bolt.at))} in joint '{patch.joint.name}'"
        if bolt.force == 0.0:
            yield f"{where} has a force of 0 N: it presses nothing."
            continue
        if share < 0.99:
            yield f"{where} has {100 * share:.3g} % of its ring on the joint, and its whole force."
        centre = np.asarray(bolt.at[: body.dim])
        distance = np.linalg.norm(body.nodes[patch.nodes] - centre, axis=1)
        points = int(np.count_nonzero(distance <= bolts.outer_radius(bolt)))
        if points < 12:
            yield f"{where} presses only {points} nodes within its ring: refine the mesh around it."
