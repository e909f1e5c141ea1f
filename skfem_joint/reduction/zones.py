"""Active zones: ends of joints along their axes where force enters, and how far in it reaches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np
from scipy import sparse
from scipy.linalg import null_space
from scipy.sparse.csgraph import connected_components

from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.linalg.factors import factorised
from skfem_joint.modes import eigenmodes
from skfem_joint.reduction.active_length import Estimate, estimate, measured
from skfem_joint.stepping.arrangement import picks_unknowns
from skfem_joint.stepping.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.stepping.resolution import longest_step
from skfem_joint.structure import AnyStructure, Body, Joint, Patch, Structure
from skfem_joint.system import System

#: Cycles of a quick run, least steps in one and in the shortest period of the loads.
QUICK_CYCLES, STEPS, STEPS_PER_PERIOD = 4, 100, 20
#: Numbers of a field that a probe stores.
_MOST_NUMBERS = 20_000_000
#: Positions along an axis that differ by less than this share of a joint's length are the same.
_SAME = 1e-7
#: Slip below this share of the largest is none.
_NO_SLIP = 1e-9


@dataclass(frozen=True)
class Zone:
    """Connected part of a joint's contact, seen from one end along the joint's axis: the mouth."""

    joint: Joint
    axis: FloatArray  #: (dim,), unit vector
    nodes: IntArray  #: (k,), from the mouth inwards, supported ones included
    points: IntArray  #: (k,), their contact points, -1 where a support holds them
    distance: FloatArray  #: (k,), from the mouth along the axis, m
    pairs: IntArray  #: (e, 2), places in ``nodes`` of each two corners of a contact cell
    tau: float  #: friction limit per length, averaged over the part, N/m

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.joint.name

    @property
    def length(self) -> float:
        """Length along the axis, m: the most that can be active."""
        return float(self.distance[-1])

    @property
    def at_mouth(self) -> BoolArray:
        """Whether each node lies at the mouth, (k,)."""
        return np.asarray(self.distance <= _SAME * self.length)

    @property
    def mouth(self) -> IntArray:
        """Contact points at the mouth."""
        return self.points[self.at_mouth & (self.points >= 0)]

    @property
    def is_line(self) -> bool:
        """Whether the nodes form a line rather than an area."""
        return len(self.pairs) < self.nodes.size

    def from_other_end(self) -> Zone:
        """The same part seen from its other end."""
        return replace(
            self,
            nodes=self.nodes[::-1],
            points=self.points[::-1],
            distance=self.length - self.distance[::-1],
            pairs=self.nodes.size - 1 - self.pairs,
        )

    def profile(self, slip_peak: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances from the mouth (m), and the largest slip (m) of each section across the axis.

        ``slip_peak`` (m) holds the largest slip of every contact point; it is linear between the
        corners of contact cells. Sections through supported nodes alone are left out.
        """
        new = np.diff(self.distance, prepend=-np.inf) > _SAME * self.length
        at, section = self.distance[new], np.cumsum(new) - 1
        slip = np.where(self.points >= 0, slip_peak[self.points], -1.0)
        largest = np.full(at.size, -1.0)
        np.maximum.at(largest, section, slip)
        free = self.pairs[np.all(self.points[self.pairs] >= 0, axis=1)]
        low, high = np.sort(free, axis=1).T  # nodes are in the order of their distances
        count = section[high] - section[low] + 1
        pair = np.repeat(np.arange(low.size), count)
        k = section[low][pair] + np.arange(pair.size) - np.repeat(np.cumsum(count) - count, count)
        start, stop = at[section[low]][pair], at[section[high]][pair]
        share = (at[k] - start) / np.where(stop > start, stop - start, 1.0)
        np.maximum.at(largest, k, (1.0 - share) * slip[low][pair] + share * slip[high][pair])
        return at[largest >= 0.0], largest[largest >= 0.0]

    def active_length(self, slip_peak: FloatArray) -> float:
        """Length that slips, m, at least one cell; see :meth:`profile` for ``slip_peak``."""
        beside = self.pairs[self.at_mouth[self.pairs].any(axis=1)]
        return max(measured(*self.profile(slip_peak)), float(self.distance[beside].max()))


def axis_of(body: Body, joint: Joint) -> FloatArray | None:
    """Unit vector along a joint, (dim,): trivial in one dimension, else None if none is named."""
    axis = np.ones(1) if joint.axis is None else np.asarray(joint.axis, dtype=float)
    return axis / np.linalg.norm(axis) if axis.size == body.dim else None


def stretches(body: Body, patch: Patch) -> list[Zone]:
    """Connected parts of a joint's contact, seen from the low end; none without axis."""
    axis = axis_of(body, patch.joint)
    if axis is None:
        return []
    number = np.full(body.n_nodes, -2)
    number[patch.held_nodes], number[patch.nodes] = -1, patch.points
    corners = combinations(range(patch.cells.shape[1]), 2)
    pairs = np.concatenate([patch.cells[:, pair] for pair in corners])
    pairs = pairs[np.all(number[pairs] > -2, axis=1)]
    graph = sparse.csr_array((np.ones(len(pairs)), pairs.T), shape=(number.size, number.size))
    label = connected_components(graph, directed=False)[1]
    limit = np.zeros(body.n_nodes)
    limit[patch.nodes] = patch.joint.friction * patch.normal_force
    limit[patch.held_nodes] = (
        patch.joint.friction * patch.held_force / max(len(patch.held_nodes), 1)
    )
    place, found = np.zeros_like(number), []
    inside = np.flatnonzero(number > -2)
    for part in np.unique(label[inside]):
        nodes = inside[label[inside] == part]
        nodes = nodes[np.argsort(body.nodes[nodes] @ axis, kind="stable")]
        along = body.nodes[nodes] @ axis
        if along[-1] > along[0] and np.any(number[nodes] >= 0):
            place[nodes] = np.arange(nodes.size)
            own = place[pairs[label[pairs[:, 0]] == part]]
            tau = float(limit[nodes].sum() / (along[-1] - along[0]))
            distance = along - along[0]
            found.append(Zone(patch.joint, axis, nodes, number[nodes], distance, own, tau))
    return sorted(found, key=lambda zone: float(body.nodes[zone.nodes[0]] @ axis))


def active_zones(structure: Structure, system: System) -> list[Zone]:
    """Find the ends of joints where force enters.

    An end is open if it is not supported and a load acts there, elements outside the joint touch
    it, or the other body reaches beyond it. InputError where scaled modes cannot follow: joints
    without axis or friction or that touch, a load inside a joint, no load at all.
    """
    own = "use reference = 'static'"
    for patch in structure.patches:
        if axis_of(structure.body, patch.joint) is None:
            raise InputError(
                f"{patch.joint.label}: no axis is named; scaled reference modes need one, e.g. "
                f"axis = [1.0, 0.0]; or {own}"
            )
    force = np.abs(system.load_vectors()).sum(axis=1)
    loaded = system.by_point(force[picked(system)]) > 0.0
    zones: list[Zone] = []
    for patch in structure.patches:
        others = [p.nodes for p in structure.patches if p is not patch]
        for low in stretches(structure.body, patch):
            high = low.from_other_end()
            between = low.points[~low.at_mouth & ~high.at_mouth[::-1] & (low.points >= 0)]
            if np.any(loaded[between]):
                raise InputError(
                    f"{patch.joint.label}: a load acts inside it; scaled reference modes hold for "
                    f"loads at a joint's end or on a linear region; {own}"
                )
            for zone, outwards in ((low, -low.axis), (high, low.axis)):
                if not zone.mouth.size:
                    continue
                if any(np.isin(zone.nodes[zone.at_mouth], nodes).any() for nodes in others):
                    raise InputError(
                        f"{patch.joint.label} touches another joint; scaled reference modes need "
                        f"a linear region between them; {own}"
                    )
                if np.any(loaded[zone.mouth]) or _is_open(structure, patch, zone, outwards):
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


def _is_open(structure: Structure, patch: Patch, zone: Zone, outwards: FloatArray) -> bool:
    """Whether elements outside the joint touch a mouth, or the other body reaches beyond it."""
    mouth = zone.nodes[zone.at_mouth]
    cells = structure.body.cells
    touching = cells[np.isin(cells, mouth).any(axis=1)]
    if not np.isin(touching, zone.nodes).all():
        return True
    if patch.other is None:
        return False
    below = abs(patch.other[np.isin(patch.nodes, mouth)]).sum(axis=0) > _SAME
    around = cells[below[cells].any(axis=1)]
    reach = (structure.nodes[around] - structure.nodes[mouth[0]]) @ outwards
    return bool(reach.max() > _SAME * zone.length)


def picked(system: System) -> IntArray:
    """Unknown that each row of the slip operator picks."""
    return np.asarray(sparse.csr_array(system.B).indices, dtype=np.intp)


def motions_without_slip(system: System, carrying: bool = False) -> sparse.csc_array:
    """Motions (n, k) in which no contact point slips, or none ``carrying`` friction, in columns.

    Unit vectors where each slip row picks an unknown, else orthonormal ones.
    """
    rows = np.arange(system.B.shape[0])
    B = sparse.csr_array(system.B)[rows[system.on_rows(system.w) > 0.0] if carrying else rows]
    if picks_unknowns(B):
        free = np.setdiff1d(np.arange(system.n), B.indices)
        return sparse.eye_array(system.n, format="csc")[:, free]
    return sparse.csc_array(null_space(B.toarray(), rcond=_NO_SLIP))


def measured_lengths(structure: AnyStructure, slip_peak: FloatArray) -> dict[str, float]:
    """Active length (m) of each joint with an axis, from the end of each part that slips most."""
    lengths: dict[str, float] = {}
    if structure.body is None:
        return lengths
    for patch in structure.patches:
        for low in stretches(structure.body, patch):
            distance, peak = low.profile(slip_peak)
            if peak[-1] > peak[0]:
                distance, peak = distance[-1] - distance[::-1], peak[::-1]
            moves = peak.max() > _NO_SLIP * slip_peak.max()
            found = measured(distance - distance[0], peak) if moves else 0.0
            lengths[low.name] = lengths.get(low.name, 0.0) + found
    return lengths


def probed(system: System, zones: Sequence[Zone], plan: Plan) -> Run:
    """Quick run of the full model with exact Coulomb friction, which costs least.

    Its points are the slips at the mouths. The slip beyond the active length is exactly zero, so
    that the length measured hardly depends on the threshold. Where a run is counted in cycles it
    takes a few of them.
    """
    rows = np.isin(np.repeat(np.arange(system.w.size), system.directions), mouths(zones))
    coulomb = replace(
        system.with_beta(np.inf),
        P=sparse.csr_array(system.B)[np.flatnonzero(rows)],
        points=tuple(f"slip {row}" for row in np.flatnonzero(rows)),
    )
    step, n_steps, cycle_steps = plan.step, plan.n_steps, plan.cycle_steps
    if cycle_steps is not None:
        period, cycles = step * cycle_steps, min(n_steps // cycle_steps, QUICK_CYCLES)
        highest = max((load.amplitude.highest_frequency or 0.0) for load in system.loads)
        steps = steps_of_a_period(coulomb, period, cycles, highest, cycle_steps)
        step, n_steps = period / steps, cycles * steps
    save = Save(fields=True, fields_every=max(1, -(-n_steps * system.n // _MOST_NUMBERS)))
    return integrate_plan(coulomb, Plan(step, n_steps, save=save)).finished()


def steps_of_a_period(system: System, period: float, cycles: int, highest: float, most: int) -> int:
    """Fewest steps (at most so many) that the highest frequency (Hz) and jumps of loads allow."""
    least = max(STEPS_PER_PERIOD * highest * period, STEPS)
    least = max(least, period / longest_step(system, cycles * period))
    return min(most, int(np.ceil(least * (1.0 - 1e-9))))


def mouths(zones: Sequence[Zone]) -> IntArray:
    """Contact points at the mouths of all zones."""
    return np.unique(np.concatenate([zone.mouth for zone in zones]))


def zone_lengths(
    system: System,
    zones: Sequence[Zone],
    asked: str | float | Mapping[str, float],
    slip_peak: FloatArray,
) -> tuple[list[float], list[str]]:
    """Active length of each zone, m, and sentences about what to beware of.

    Lengths from both ends of one part are kept apart.

    ``asked`` is "auto" (measured in a probe, by the largest ``slip_peak`` (m,) of its contact
    points, m), "estimate" (Eqs. (17)-(20)), or a length (m) for all joints or by name. InputError
    for an estimate that Eqs. (17)-(20) cannot give, or a length that the joint has not.
    """
    lengths: list[float] = []
    notes: list[str] = []
    for zone in zones:
        given = asked.get(zone.name, "auto") if isinstance(asked, Mapping) else asked
        if given == "auto":
            lengths.append(zone.active_length(slip_peak))
        elif given == "estimate":
            length, doubts = _estimated_length(system, zone)
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
        told = (
            f"The active length of joint '{zone.name}' comes out as {whole:.4g} m, more than the "
            f"joint has: capped at {zone.length:.4g} m. The joint may slip as a whole (gross "
            "slip), which the method assumes it does not."
        )
        if length > most and told not in notes:
            notes.append(told)
        capped.append(min(length, most))
    return capped, notes


def _estimated_length(system: System, zone: Zone) -> tuple[float, list[str]]:
    """Active length of a zone by Eqs. (17)-(20), m, and what is doubtful of it."""
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


def estimate_active_length(system: System, zone: Zone) -> Estimate | None:
    """Active length of a zone from the linear analysis of the structure, section 6.1.

    The static force at the zone's mouth, with all joints stuck and the amplitudes of all harmonics
    superposed, gives the static length; the first natural frequency of what moves with the active
    part gives A_a. None where a load is not harmonic, or anything can move but along the axis.
    """
    highest, force = 0.0, np.zeros(system.n)
    if zone.axis.size > 1 or not all(load.amplitude.harmonics for load in system.loads):
        return None
    for load in system.loads:
        for part in load.amplitude.harmonics:
            force += abs(part.amplitude) * np.abs(load.vector)
            highest = max(highest, part.frequency)
    K, M = sparse.csr_array(system.K), sparse.csr_array(system.M)
    unknowns = picked(system)[zone.points[zone.points >= 0]]
    linear = np.setdiff1d(np.arange(system.n), picked(system))
    at_mouth = float(force[unknowns[0]])
    if linear.size:
        u = factorised(K[linear][:, linear])(force[linear])
        at_mouth += abs(float((K[unknowns[:1]][:, linear] @ u)[0]))

    @cache
    def frequency_up_to(node: int) -> float:
        """Natural frequency of what moves when the zone moves up to one of its nodes."""
        moving = np.union1d(unknowns[: max(node, 1)], linear)
        return float(eigenmodes(K[moving][:, moving], M[moving][:, moving], 1)[0][0])

    def frequency_of(length: float) -> float:
        """Natural frequency, interpolated between the nodes on both sides of the length."""
        node = int(np.clip(np.searchsorted(zone.distance, length), 1, zone.nodes.size - 1))
        a, b = zone.distance[node - 1], zone.distance[node]
        share = min((length - a) / (b - a), 1.0)
        found = (1.0 - share) * frequency_up_to(node - 1) + share * frequency_up_to(node)
        # Beyond the joint the moving length is capped only by the formula.
        return float(found * (b / length if length > b and linear.size == 0 else 1.0))

    return estimate(at_mouth / zone.tau, highest, frequency_of)
