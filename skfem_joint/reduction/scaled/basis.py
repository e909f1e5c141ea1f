"""Basis of modes of the paper's reference joint, scaled to the active zones of a structure.

The reference modes are stretched over each active zone along the axis of its joint; they are zero
in the grey length. They prescribe the slip along the axis. The slip across it, and all that is not
in contact, follows statically with the least strain energy (rigidly, where nothing else holds it).

As friction resists the slip across the axis too, as many modes that move the contact apart and
together across the axis stand beside them: without them the friction energy of a joint of two
plates errs by 22 %, with them by 0.2 %. Static responses to the loads and fixed-interface modes
complete the basis, as in the method of Craig and Bampton (AIAA J. 6, 1968).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray, slip_norms
from skfem_joint.reduction.active_length import THRESHOLD, ContactPart, axis_of
from skfem_joint.reduction.basis import Basis, Options, basis_of
from skfem_joint.reduction.interface_modes import (
    RestrictedMotion,
    motions_without_slip,
    participating,
)
from skfem_joint.reduction.pod import ProperModes
from skfem_joint.reduction.scaled.gauss import gauss_points
from skfem_joint.reduction.scaled.reference import ReferenceModes, paper_reference
from skfem_joint.reduction.scaled.zones import active_zones, loaded_ends, probed, zone_lengths
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.model import AnyStructure
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System

#: Gauss points along each line for each of its modes.
POINTS_PER_MODE = 4


@dataclass(frozen=True)
class ScaledBasis(Basis):
    """Basis of scaled modes, or of modes of a system's own run, with its zones.

    Attributes
    ----------
    lines : tuple of (points, positions), optional
        Contact points and positions (m) of each active zone where all zones are lines: the friction
        points are then those of a Gauss rule.
    """

    lines: tuple[tuple[IntArray, FloatArray], ...] | None = None

    @property
    def followed(self) -> FloatArray:
        """Motions of the full system that the joint modes come from: none of a reference joint."""
        own = self.modes_of_unit_length is None
        return super().followed if own else np.zeros((len(self.V), 0))

    def fewer_points(self, unmerged: System, count: int | None) -> System:
        """Reduced system with Gauss points, ``count`` of each line; without lines as `Basis`."""
        if self.lines is None:
            return super().fewer_points(unmerged, count)
        return gauss_points(unmerged, self.lines, count or POINTS_PER_MODE * self.modes)

    def enriched(self, system: System, V: FloatArray, velocities: FloatArray) -> Basis:
        """Basis of more vectors, as `Basis.enriched`; friction points are merged ones from then."""
        return Basis.enriched(replace(self, lines=None), system, V, velocities)


def paper_basis(
    structure: AnyStructure,
    system: System,
    options: Options,
    plan: Plan,
    *,
    enriched: bool = False,
) -> Basis:
    """Basis of the paper's modes by options; makes the reference run and the probe run.

    Notes and errors are those of `active_zones`, `zone_lengths` and `Basis.judged`.
    """
    meshed = structure.meshed(
        "reduction.reference: found 'paper', whose modes are laid along a mesh; take 'static' "
        "or 'self' instead"
    )
    zones = active_zones(meshed, system)
    probe = probed(system, zones, plan)
    lengths, notes = zone_lengths(system, zones, options.active_length, probe.slip_peak)
    reference = paper_reference(snapshots=options.snapshots, inner_product=options.product)
    basis = scaled_basis(meshed, system, reference, zones, lengths, probe, options)
    return replace(basis, notes=tuple(notes)).judged(options, enriched)


def scaled_basis(
    structure: Structure,
    system: System,
    reference: ReferenceModes,
    zones: Sequence[ContactPart],
    lengths: Sequence[float],
    probe: Run,
    options: Options,
) -> ScaledBasis:
    """Reference modes scaled along each zone, and what completes them in the structure.

    Parameters
    ----------
    structure : Structure
    system : System
    reference : ReferenceModes
    zones : sequence of ContactPart
        Active zones, seen from their loaded ends.
    lengths : sequence of float
        Active length of each, m.
    probe : Run
        Run in which the lengths were measured.
    modes : int
        Modes of each zone.
    interface_modes : "auto" or int
        Fixed-interface modes, see `skfem_joint.reduction.interface_modes.participating`.
    """
    slips, modes, contact = _slip_vectors(structure, system), options.mode_count, system.contact
    active = np.zeros(contact.w.size, dtype=bool)
    pulled, breathing, lines = [], [], []
    whole: dict[str, float] = {}
    for zone, length in zip(zones, lengths, strict=True):
        whole[zone.name] = whole.get(zone.name, 0.0) + length
        free = zone.points >= 0
        points, distance, x = zone.points[free], zone.distance[free], structure.nodes[zone.nodes]
        values = reference.at(1.0 - distance / length, modes)
        middle = 0.5 * (x.max(axis=0) + x.min(axis=0))
        offset = ((x[free] - middle) * slips.sideways[points]).sum(axis=1)
        pulled.append(slips.along[:, points] @ values)
        breathing.append(slips.across[:, points] @ (values * offset[:, np.newaxis]))
        inside = distance < length
        active[points[inside]] = True
        lines.append((points[inside], distance[inside]))
    F = motions_without_slip(system)
    turning = slips.across[:, active & (np.diff(slips.across.indptr) > 0)]
    wide = RestrictedMotion.of(system, sparse.csc_array(sparse.hstack([F, turning])))
    parts = [_following(system, wide, np.hstack(pulled))]
    parts.append(_following(system, RestrictedMotion.of(system, F), np.hstack(breathing)))
    if F.shape[1]:
        parts += _beside(system, wide, parts[0], options.interface_modes)
    velocity = slip_norms(probe.point_v, contact.directions[loaded_ends(zones)])
    basis = basis_of(
        system,
        np.hstack(parts),
        modes,
        reference.proper,
        u=probe.u,
        v=probe.v,
        slip_peak=probe.slip_peak,
        slip_velocity=float(velocity.max(initial=0.0)),
        active=active & (contact.w > 0.0),
    )
    on_lines = all(zone.is_line for zone in zones) and np.all(contact.directions[active] == 1)
    scaled = ProperModes(reference.modes, reference.proper.singular_values)
    return ScaledBasis(
        basis.V,
        basis.modes,
        basis.proper,
        basis.history,
        active_length=whole,
        modes_of_unit_length=(reference.xi, scaled),
        lines=tuple(lines) if on_lines else None,
    )


@dataclass(frozen=True)
class _SlipVectors:
    """Motions of the unknowns by a unit slip of each contact point along and across its axis.

    Attributes
    ----------
    along : sparse array, shape (n, m)
        Slip along the joint's axis, times the share of the axis in the slip directions.
    across : sparse array, shape (n, m)
        Slip across the axis; empty columns for points that slip along it alone.
    sideways : ndarray, shape (m, dim)
        Directions of the slips across.
    """

    along: sparse.csc_array
    across: sparse.csc_array
    sideways: FloatArray


def _slip_vectors(structure: Structure, system: System) -> _SlipVectors:
    """Slips along and across the axes of a structure's joints."""
    m = system.contact.w.size
    directions, axis = np.zeros((m, 2, structure.dim)), np.zeros((m, structure.dim))
    for patch in structure.patches:
        directions[patch.points, : patch.directions.shape[1]] = patch.directions
        axis[patch.points] = axis_of(structure.body, patch.joint)
    along, across = np.einsum("mkd,md->mk", directions, axis), np.zeros((m, 2))
    size = np.linalg.norm(along, axis=1)[:, np.newaxis]
    # A point with one slip direction, nearly perpendicular to the axis, slips across alone.
    lone = (system.contact.directions == 1) & (size[:, 0] <= THRESHOLD)
    along[lone], across[lone] = 0.0, [1.0, 0.0]
    pair = system.contact.directions == 2
    turned = along[:, ::-1] * [-1.0, 1.0] / np.where(size > 0.0, size, 1.0)
    across[pair] = np.where(size > 0.0, turned, [0.0, 1.0])[pair]
    has = system.contact.directions[:, np.newaxis] > [0, 1]
    place = np.arange(np.count_nonzero(has)), np.repeat(np.arange(m), system.contact.directions)
    A, C = (sparse.csr_array((x[has], place), shape=(len(place[0]), m)) for x in (along, across))
    C.eliminate_zeros()
    B = sparse.csr_array(system.contact.B)
    sideways = np.einsum("mk,mkd->md", across, directions)
    return _SlipVectors(sparse.csc_array(B.T @ A), sparse.csc_array(B.T @ C), sideways)


def _following(system: System, restricted: RestrictedMotion, V: FloatArray) -> FloatArray:
    """Prescribed motions V (n, k) with what the columns of F follow at the least strain energy."""
    if restricted.F.shape[1] == 0:
        return V
    return np.asarray(V - restricted.F @ restricted.solver(restricted.F.T @ (system.K @ V)))


def _beside(
    system: System, restricted: RestrictedMotion, V: FloatArray, count: str | int
) -> list[FloatArray]:
    """Static responses to the loads and fixed-interface modes in the columns of F."""
    loads = system.load_vectors()
    forces = restricted.F.T @ loads
    forces = forces[:, np.abs(forces).max(axis=0) > 1e-9 * np.abs(loads).max(axis=0)]
    responses = [restricted.F @ restricted.solver(forces)] if forces.size else []
    return [*responses, participating(system, restricted, V, forces, count)]
