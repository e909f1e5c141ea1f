"""Active length and area of joints: where their contact slips, measured from the largest slips.

The active length runs from the loaded end of a joint, where force enters it, to where the largest
slip has fallen to a thousandth of that at the end. Beyond lies the grey length, which sticks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from skfem_joint.body.body import Body
from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.joint.joints import Joint
from skfem_joint.joint.patch import Patch
from skfem_joint.structure.model import AnyStructure
from skfem_joint.system.system import System

#: Displacement or slip, relative to the largest, above which a point counts as active.
THRESHOLD = 1e-3
#: Positions along an axis that differ by less than this share of a joint's length are the same.
SAME_POSITION = 1e-7


def measured(distance: FloatArray, peak: FloatArray, threshold: float = THRESHOLD) -> float:
    """Active length from the largest displacements along a joint, m; 0 if nothing moves.

    Peaks are linear between points. As the response falls off smoothly, the length depends on the
    threshold: state it with the length.

    Parameters
    ----------
    distance : ndarray, shape (m,)
        Distances of contact points from the loaded end, increasing, m.
    peak : ndarray, shape (m,)
        Largest displacement of each point, m.
    threshold : float
        Points are active while their peak exceeds this share of the loaded end's.
    """
    limit = threshold * peak[0]
    if limit == 0.0:
        return 0.0
    inactive = np.flatnonzero(peak <= limit)
    if inactive.size == 0:
        return float(distance[-1])
    i = int(inactive[0])
    share = (peak[i - 1] - limit) / (peak[i - 1] - peak[i])
    return float(distance[i - 1] + share * (distance[i] - distance[i - 1]))


@dataclass(frozen=True)
class ContactPart:
    """Connected part of a joint's contact, seen from one of its ends along the joint's axis.

    Attributes
    ----------
    joint : Joint
    axis : ndarray, shape (dim,)
        Unit vector along the joint.
    nodes : ndarray of int, shape (k,)
        Nodes of the part from the near end on, supported ones included.
    points : ndarray of int, shape (k,)
        Their contact points, -1 where a support holds the node.
    distance : ndarray, shape (k,)
        Distances from the near end along the axis, m.
    pairs : ndarray of int, shape (e, 2)
        Places in ``nodes`` of each two corners of a contact cell.
    tau : float
        Friction limit per length, averaged over the part, N/m.
    """

    joint: Joint
    axis: FloatArray
    nodes: IntArray
    points: IntArray
    distance: FloatArray
    pairs: IntArray
    tau: float

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.joint.name

    @property
    def length(self) -> float:
        """Length along the axis, m: the largest possible active length."""
        return float(self.distance[-1])

    @property
    def at_end(self) -> BoolArray:
        """Whether each node lies at the near end, (k,)."""
        return np.asarray(self.distance <= SAME_POSITION * self.length)

    @property
    def end_points(self) -> IntArray:
        """Contact points at the near end."""
        return self.points[self.at_end & (self.points >= 0)]

    @property
    def is_line(self) -> bool:
        """Whether the nodes form a line rather than an area."""
        return len(self.pairs) < self.nodes.size

    def from_other_end(self) -> ContactPart:
        """The same part seen from its other end."""
        return replace(
            self,
            nodes=self.nodes[::-1],
            points=self.points[::-1],
            distance=self.length - self.distance[::-1],
            pairs=self.nodes.size - 1 - self.pairs,
        )

    def profile(self, slip_peak: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances from the end (m), and the largest slip (m) of each section across the axis.

        ``slip_peak`` (m,) holds the largest slip of every contact point of the structure, m. It is
        linear between the corners of contact cells. Sections through supported nodes alone are left
        out.
        """
        new = np.diff(self.distance, prepend=-np.inf) > SAME_POSITION * self.length
        at, section = self.distance[new], np.cumsum(new) - 1
        slip = np.where(self.points >= 0, slip_peak[self.points], -1.0)
        largest = np.full(at.size, -1.0)
        np.maximum.at(largest, section, slip)
        # Each pair of free corners also gives a slip to all sections between the two.
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
        """Active length from this end, m, at least one cell; see `profile` for ``slip_peak``."""
        beside = self.pairs[self.at_end[self.pairs].any(axis=1)]
        return max(measured(*self.profile(slip_peak)), float(self.distance[beside].max()))


def axis_of(body: Body, joint: Joint) -> FloatArray | None:
    """Unit vector along a joint, (dim,); None where a plane or solid joint names no axis."""
    axis = np.ones(1) if joint.axis is None else np.asarray(joint.axis, dtype=float)
    return axis / np.linalg.norm(axis) if axis.size == body.dim else None


def contact_parts(body: Body, patch: Patch) -> list[ContactPart]:
    """Connected parts of a joint's contact, seen from their low ends; none without an axis."""
    axis = axis_of(body, patch.joint)
    if axis is None:
        return []
    # Contact point of each node: -1 where a support holds it, -2 outside the contact.
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
    place, parts = np.zeros_like(number), []
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
            parts.append(ContactPart(patch.joint, axis, nodes, number[nodes], distance, own, tau))
    return sorted(parts, key=lambda part: float(body.nodes[part.nodes[0]] @ axis))


def measured_lengths(structure: AnyStructure, slip_peak: FloatArray) -> dict[str, float]:
    """Active length (m) of each joint with an axis, the sum of those of its parts.

    Each part is measured from the end that slips most. ``slip_peak`` (m,) is the largest slip of
    each contact point, m.
    """
    lengths: dict[str, float] = {}
    if structure.body is None:
        return lengths
    for patch in structure.patches:
        for part in contact_parts(structure.body, patch):
            distance, peak = part.profile(slip_peak)
            if peak[-1] > peak[0]:
                distance, peak = distance[-1] - distance[::-1], peak[::-1]
            moves = peak.max() > 1e-9 * slip_peak.max()  # less is round-off
            length = measured(distance - distance[0], peak) if moves else 0.0
            lengths[part.name] = lengths.get(part.name, 0.0) + length
    return lengths


def active_fractions(
    structure: AnyStructure, system: System, slip_peak: FloatArray, period: float
) -> tuple[dict[str, float], dict[str, float]]:
    """Share of each joint's contact area, and share of its nodes, that slips.

    Nodes that a support holds do not slip. See `System.slipping`, by which a point does, for
    ``slip_peak`` (m,), m, and ``period`` (s).
    """
    active = system.slipping(slip_peak, period)
    areas, nodes = {}, {}
    for patch in structure.patches:
        name, slipping = patch.joint.name, active[patch.points]
        area = float(patch.area.sum()) + patch.held_area
        count = patch.nodes.size + patch.held_nodes.size
        areas[name] = float(patch.area[slipping].sum() / area) if area > 0.0 else 0.0
        nodes[name] = float(slipping.sum() / count) if count else 0.0
    return areas, nodes
