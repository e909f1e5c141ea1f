"""Active zones: the ends of joints along their axes where force enters, and their active lengths.

A zone is a connected part of a joint's contact seen from its loaded end, a
`skfem_joint.reduction.active_length.ContactPart`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.patch import Patch
from skfem_joint.reduction.active_length import SAME_POSITION, ContactPart, axis_of, contact_parts
from skfem_joint.reduction.excitation import CYCLES, steps_of_a_period
from skfem_joint.reduction.scaled.estimated_length import estimate_active_length, picked
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System


def active_zones(structure: Structure, system: System) -> list[ContactPart]:
    """Zones of a structure: parts of joints seen from their loaded ends.

    Force enters at an end that is not supported if a load acts there, elements outside the joint
    touch it, or the other body reaches beyond it.

    Raises
    ------
    InputError
        Where scaled modes cannot follow: joints without axis or friction, joints that touch each
        other, a load inside a joint, or no load at all.
    """
    own = "use reference = 'static'"
    for patch in structure.patches:
        if axis_of(structure.body, patch.joint) is None:
            raise InputError(
                f"{patch.joint.label}: no axis is named; scaled reference modes need one, e.g. "
                f"axis = [1.0, 0.0]; or {own}"
            )
    force = np.abs(system.load_vectors()).sum(axis=1)
    loaded = system.contact.by_point(force[picked(system)]) > 0.0
    zones: list[ContactPart] = []
    for patch in structure.patches:
        others = [p.nodes for p in structure.patches if p is not patch]
        for low in contact_parts(structure.body, patch):
            high = low.from_other_end()
            between = low.points[~low.at_end & ~high.at_end[::-1] & (low.points >= 0)]
            if np.any(loaded[between]):
                raise InputError(
                    f"{patch.joint.label}: a load acts inside it; scaled reference modes hold for "
                    f"loads at a joint's end or on a linear region; {own}"
                )
            for zone, outwards in ((low, -low.axis), (high, low.axis)):
                if not zone.end_points.size:
                    continue
                if any(np.isin(zone.nodes[zone.at_end], nodes).any() for nodes in others):
                    raise InputError(
                        f"{patch.joint.label} touches another joint; scaled reference modes need "
                        f"a linear region between them; {own}"
                    )
                if np.any(loaded[zone.end_points]) or _is_open(structure, patch, zone, outwards):
                    zones.append(zone)
    for zone in zones:
        if zone.tau == 0.0:
            raise InputError(
                f"{zone.joint.label}: no friction acts in it, so that reference modes cannot be "
                f"scaled to its active length; leave the joint out or {own}"
            )
    if not zones or all(load.amplitude.peak_value == 0.0 for load in system.loads):
        raise InputError(
            "reduction: no force enters any joint, so that no active length can be found; give "
            f"loads that pull at joints, {own}, or run 'full' alone"
        )
    return zones


def _is_open(structure: Structure, patch: Patch, zone: ContactPart, outwards: FloatArray) -> bool:
    """Whether elements outside the joint touch the end, or the other body reaches beyond it."""
    end = zone.nodes[zone.at_end]
    cells = structure.body.cells
    touching = cells[np.isin(cells, end).any(axis=1)]
    if not np.isin(touching, zone.nodes).all():
        return True
    if patch.other is None:
        return False
    below = abs(patch.other[np.isin(patch.nodes, end)]).sum(axis=0) > SAME_POSITION
    around = cells[below[cells].any(axis=1)]
    reach = (structure.nodes[around] - structure.nodes[end[0]]) @ outwards
    return bool(reach.max() > SAME_POSITION * zone.length)


def loaded_ends(zones: Sequence[ContactPart]) -> IntArray:
    """Contact points at the loaded ends of all zones."""
    return np.unique(np.concatenate([zone.end_points for zone in zones]))


def probed(system: System, zones: Sequence[ContactPart], plan: Plan) -> Run:
    """Quick run of the full model with exact Coulomb friction, to measure active lengths.

    Coulomb friction costs least, and the slip beyond the active length is exactly zero, so that the
    length hardly depends on the threshold by which it is measured. The run stores the slips at the
    loaded ends. If the ``plan`` of the run to come has cycles it takes a few of them.
    """
    rows = np.isin(
        np.repeat(np.arange(system.contact.w.size), system.contact.directions), loaded_ends(zones)
    )
    coulomb = replace(
        system.with_beta(np.inf),
        P=sparse.csr_array(system.contact.B)[np.flatnonzero(rows)],
        points=tuple(f"slip {row}" for row in np.flatnonzero(rows)),
    )
    step, n_steps, cycle_steps = plan.step, plan.n_steps, plan.cycle_steps
    if cycle_steps is not None:
        period, cycles = step * cycle_steps, min(n_steps // cycle_steps, CYCLES)
        highest = max((load.amplitude.highest_frequency or 0.0) for load in system.loads)
        steps = steps_of_a_period(coulomb, period, cycles, highest, cycle_steps)
        step, n_steps = period / steps, cycles * steps
    numbers = 20_000_000  # of a stored field, in all
    save = Save(fields=True, fields_every=max(1, -(-n_steps * system.n // numbers)))
    return integrate_plan(coulomb, Plan(step, n_steps, save=save)).finished()


def zone_lengths(
    system: System,
    zones: Sequence[ContactPart],
    asked: str | float | Mapping[str, float],
    slip_peak: FloatArray,
) -> tuple[list[float], list[str]]:
    """Active length of each zone, m, and sentences about what to beware of.

    Lengths from both ends of one part are kept apart: they are scaled to fit.

    Parameters
    ----------
    system : System
    zones : sequence of ContactPart
    asked : "auto", "estimate", float or mapping
        Measured in a probe run, by Eqs. (17)-(20), or a length (m) for all joints or by name.
    slip_peak : ndarray, shape (m,)
        Largest slip of each contact point in the probe run, m.

    Raises
    ------
    InputError
        If Eqs. (17)-(20) cannot give a length, or a length is not positive or longer than the
        joint.
    """
    lengths: list[float] = []
    notes: list[str] = []
    for zone in zones:
        given = asked.get(zone.name, "auto") if isinstance(asked, Mapping) else asked
        if given == "auto":
            lengths.append(zone.active_length(slip_peak))
        elif given == "estimate":
            length, doubts = _estimated(system, zone)
            lengths.append(length)
            notes += doubts
        elif 0.0 < float(given) <= zone.length * (1.0 + 1e-9):
            lengths.append(float(given))
        else:
            raise InputError(
                f"active length of {zone.joint.label}: found {float(given):.6g} m, must be above 0 "
                f"and at most the joint's {zone.length:.6g} m along its axis"
            )
    capped = []
    for zone, length in zip(zones, lengths, strict=True):
        both_ends = [set(other.nodes) == set(zone.nodes) for other in zones]
        whole = float(np.array(lengths)[both_ends].sum())
        most = zone.length * length / whole
        note = (
            f"The active length of joint '{zone.name}' comes out as {whole:.4g} m, more than the "
            f"joint has: capped at {zone.length:.4g} m. The joint may slip as a whole (gross "
            "slip), which the method assumes it does not."
        )
        if length > most and note not in notes:
            notes.append(note)
        capped.append(min(length, most))
    return capped, notes


def _estimated(system: System, zone: ContactPart) -> tuple[float, list[str]]:
    """Active length of a zone by Eqs. (17)-(20), m, and sentences about what is doubtful."""
    guess = estimate_active_length(system, zone)
    if guess is None:
        raise InputError(
            "reduction.active_length: 'estimate' needs a bar under harmonic loads; use 'auto' or a "
            "length"
        )
    notes = []
    if not guess.converged or guess.frequency_ratio > 0.5:
        notes.append(
            f"The estimated active length of joint '{zone.name}' "
            + ("" if guess.converged else "did not settle and ")
            + f"is doubtful: the load has {guess.frequency_ratio:.2g} times the natural "
            "frequency, and Eq. (17) holds up to half of it. Use active_length = 'auto'."
        )
    return guess.length, notes
