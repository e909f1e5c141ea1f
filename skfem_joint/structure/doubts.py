"""Reasons to doubt a structure under its loads: the last notes of its system."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from skfem_joint.body.body import Body
from skfem_joint.joint.doubts import coarse_for_waves, oscillating_impacts
from skfem_joint.joint.patch import Patch
from skfem_joint.joint.pressure import Bolts
from skfem_joint.linalg.factors import pardiso
from skfem_joint.mesh.cells import spot
from skfem_joint.structure.mesh_error import MeshError
from skfem_joint.system.system import System

#: Share by which a first frequency is too high by the mesh, from which on that is said.
_TOO_STIFF = 0.03
#: Unknowns beyond which models without PARDISO say what it saves.
_MANY = 20_000


def stiff(body: Body, error: MeshError | None, *, in_parts: bool) -> Iterator[str]:
    """Sentence about elements of first order that are too stiff, or why that is not known."""
    if body.dim == 1 or body.mesh.order > 1:
        return
    if error is None:
        many = "they are so many that its matrices would take a large part of this machine's memory"
        why = "it is not computed of a structure in parts" if in_parts else many
        yield f"How much too stiff the elements are is not known: {why}. {_cure(body)}"
    elif not error.is_known:
        yield (
            "How much too stiff the elements are is not known: they bend better than those that "
            "they are compared with, as in elements much longer than thick. Compare with "
            "mesh.order = 2."
        )
    elif error.largest > _TOO_STIFF:
        joints = "with the joints stuck " if error.joints == "stuck" else ""
        most = int(np.argmax(error.shares))
        now, better = error.frequencies[most], error.better[most]
        yield (
            f"The mesh is too stiff: {joints}it has {now:.4g} Hz where elements of "
            f"second order have {better:.4g} Hz, {100.0 * error.largest:.2g} % too high, the "
            "most of its first frequencies. Stiffness is too high by about twice as much, "
            "displacements and friction energies err accordingly, which no estimated total "
            f'"without mesh" counts. {_cure(body)}'
        )


def _cure(body: Body) -> str:
    """What to do about elements that are too stiff."""
    lumped = " Elements of second order need mass_matrix = 'consistent'."
    also = lumped if body.mass == "lumped" else ""
    if not any(part.kind.bends for part in body.mesh.parts):
        return f"Take elements of second order: leave mesh.order out, or let it be 2.{also}"
    if not body.has_incompatible_modes:
        return "Leave out mesh.incompatible = false."
    return (
        "Take smaller elements, above all across the thickness and where they are distorted, or "
        f"mesh.order = 2.{also}"
    )


def doubted(
    system: System,
    unusual: Sequence[str],
    patches: Sequence[Patch],
    body: Body | None = None,
    *,
    quasi_static: bool = False,
) -> System:
    """System whose notes also say which values, sizes, loads and joints suggest a mistake.

    Parameters
    ----------
    system : System
    unusual : sequence of str
        Sentences about mesh, values and size, or about given matrices.
    patches : sequence of Patch
        Contact points of each joint.
    body : Body, optional
    quasi_static : bool
        Whether the loads change slowly: then they excite no waves that elements should follow.
    """
    sentences = [*system.notes, *unusual, *without_pardiso(system.n)]
    if not quasi_static and body is not None:
        sentences += coarse_for_waves(body, system)
        sentences += oscillating_impacts(body, patches)
    for load in system.loads:
        largest = max((abs(h.phase) for h in load.amplitude.harmonics), default=0.0)
        if largest > 2.0 * np.pi:
            sentences.append(
                f"The load on '{load.on}' has a phase of {largest:.4g} rad, more than a turn: is "
                "it in degrees?"
            )
    if not patches:
        sentences.append("There is no joint: nothing slips, the structure is linear.")
    for patch in patches:
        joint = patch.joint
        if not np.any(system.contact.rubs[patch.points]) or joint.friction == 0.0:
            sentences.append(
                f"Joint '{joint.name}' carries no friction: its pressure or friction is 0, or "
                "supports hold all of it."
            )
        if isinstance(joint.pressure, Bolts) and body is not None:
            sentences += _bolt_doubts(body, patch, joint.pressure)
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
    return replace(system, notes=tuple(dict.fromkeys(sentences)))


def without_pardiso(n: int) -> Iterator[str]:
    """Sentence about what PARDISO saves a model of so many unknowns, where it is not installed."""
    if n > _MANY and pardiso() is None:
        yield (
            f"Of {n} unknowns factors take two to four times as long by SuperLU as by PARDISO, and "
            'more the more there are: pip install "skfem-joint[solids]" adds it (0.7 GB).'
        )


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
