"""Two deformable bars pressed on each other: friction on their relative slip.

Each bar is a structure of its own. Where the upper one is pressed on the lower one, its unknown is
its slip against the lower bar, and its displacement is that slip plus what the lower bar does
there. So every slip is one unknown, as with plates, and the reaction on the lower bar follows from
the same matrix transposed: equal, opposite, and with the same work.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.errors import InputError
from skfem_joint.loads import Load
from skfem_joint.meshing import TOLERANCE, BarMesh
from skfem_joint.structure import Structure, assemble
from skfem_joint.system import System

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# Sine of the angle between two bars that count as parallel.
_PARALLEL = 1e-6


@dataclass(frozen=True)
class TwoBars:
    """Two parallel bars, one pressed on the other.

    Attributes
    ----------
    upper : Structure
        Its joints named in ``against`` are pressed on the lower bar, its others on a rigid base.
    lower : Structure
        Its own joints are pressed on a rigid base.
    against : mapping of str to str
        Region of the lower bar by region of the upper bar's joint. Where each node of the joint
        lies on it is decided by the coordinates in space, along the bars; the distance across them
        does not count.
    """

    upper: Structure
    lower: Structure
    against: Mapping[str, str]

    @cached_property
    def nodes(self) -> IntArray:
        """Nodes of the upper bar that are pressed on the lower one, in rising order.

        Raises
        ------
        InputError
            Joints that do not exist, nodes that are supported or pressed on a rigid base too.
        """
        _check(self)
        joints = [joint for joint in self.upper.joints if joint.region in self.against]
        return np.unique(
            np.concatenate([self.upper.joint_nodes(joint) for joint in joints])
        ).astype(np.intp)

    @cached_property
    def other(self) -> sparse.csr_array:
        """Displacement of the lower bar at ``nodes`` from that of its nodes, (k, lower nodes).

        Positive along the upper bar. Rows have a sum of 1, or of -1 where the lower bar's arc
        length runs against the upper bar's. Nodes that match are taken as they are; between nodes
        the interpolation is linear.

        Raises
        ------
        InputError
            Bars that are not parallel, regions that do not exist or do not overlap, and all that
            `nodes` refuses.
        """
        pressed = self.nodes
        along, sense = _axes(self.upper.bar, self.lower.bar)
        rows = sparse.csr_array((self.upper.n_nodes, self.lower.n_nodes))
        entered = np.zeros(self.upper.n_nodes, dtype=bool)
        problems: list[str] = []
        for joint in self.upper.joints:
            if joint.region not in self.against:
                continue
            nodes = self.upper.joint_nodes(joint)
            nodes = nodes[~entered[nodes]]
            entered[nodes] = True
            x = (self.upper.bar.coordinates[nodes] - self.lower.bar.coordinates[0]) @ along
            try:
                found = _interpolation(
                    self.lower.bar, self.against[joint.region], x, f"joint {joint.region!r}"
                )
            except InputError as error:
                problems += error.problems
                continue
            place = (np.ones(nodes.size), (nodes, np.arange(nodes.size)))
            rows = rows + sparse.csr_array(place, shape=(rows.shape[0], nodes.size)) @ found
        if problems:
            raise InputError(problems)
        return sparse.csr_array(sense * rows[pressed])

    @cached_property
    def under(self) -> sparse.csr_array:
        """Displacement of the upper bar's unknowns by the lower bar's, (n upper, n lower)."""
        place = np.searchsorted(self.upper.free, self.nodes)
        ones = (np.ones(place.size), (place, np.arange(place.size)))
        spread = sparse.csr_array(ones, shape=(self.upper.free.size, place.size))
        return sparse.csr_array(spread @ self.other[:, self.lower.free])

    def expand(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Displacements of all nodes of the upper and of the lower bar from the unknowns.

        Each is positive along its own bar; ``u`` has the unknowns along its last axis.
        """
        n = self.upper.free.size
        own, below = u[..., :n], u[..., n:]
        flat = below.reshape(-1, below.shape[-1])
        carried = np.asarray((self.under @ flat.T).T).reshape(own.shape)
        return self.upper.expand(own + carried), self.lower.expand(below)


def assemble_two_bars(
    bars: TwoBars,
    loads: Sequence[tuple[str, Load]] = (),
    points: Sequence[str] | None = None,
) -> System:
    """Assemble the system of two bars pressed on each other.

    Parameters
    ----------
    bars : TwoBars
    loads : sequence of (name, load)
        Axial forces, positive along the bar that has the named point or region.
    points : sequence of str, optional
        Named points of either bar to observe; all unsupported ones if not given.

    Returns
    -------
    System
        Sparse. The unknowns are those of the upper bar (slips where it is pressed on the lower
        one, displacements elsewhere), then the displacements of the lower bar, see
        :meth:`TwoBars.expand`; every row of ``B`` picks one. Contact points come in the same order.

    Raises
    ------
    InputError
        For names that neither bar has or both have, and all that `TwoBars.other` refuses.
    """
    both = (bars.upper, bars.lower)
    names = [{*bar.bar.points, *bar.bar.regions} for bar in both]
    problems = [
        f"name {name!r} stands in both bars: give each its own"
        for name in sorted(names[0] & names[1])
    ]
    known = ", ".join(sorted(names[0] | names[1]))
    problems += [
        f"{where}: no point or region named {name!r} in either bar; they have: {known}"
        for where, wanted in (("load", [on for on, _ in loads]), ("points", points or ()))
        for name in wanted
        if name not in names[0] | names[1]
    ]
    if problems:
        raise InputError(problems)
    parts = [
        assemble(
            bar,
            [(on, load) for on, load in loads if on in own],
            None if points is None else [name for name in points if name in own],
        )
        for bar, own in zip(both, names, strict=True)
    ]
    carry = sparse.block_array(
        [
            [sparse.eye_array(parts[0].n), bars.under],
            [None, sparse.eye_array(parts[1].n)],
        ],
        format="csr",
    )

    def congruence(name: str) -> sparse.csr_array:
        A = carry.T @ _side_by_side(parts, name) @ carry
        symmetric = sparse.csr_array(0.5 * (A + A.T))
        symmetric.eliminate_zeros()
        return symmetric

    offset = [np.zeros(parts[0].n), np.zeros(parts[1].n)]
    remaining = [iter(part.loads) for part in parts]
    applied = []
    for on, _ in loads:
        which = int(on in names[1])
        load = next(remaining[which])
        vector = np.concatenate([load.vector if i == which else offset[i] for i in (0, 1)])
        applied.append(replace(load, vector=carry.T @ vector))
    row = {name: i for i, name in enumerate(parts[0].points + parts[1].points)}
    observed = tuple(row) if points is None else tuple(dict.fromkeys(points))
    P = sparse.csr_array(_side_by_side(parts, "P") @ carry)
    return System(
        M=congruence("M"),
        C=congruence("C"),
        K=congruence("K"),
        B=_side_by_side(parts, "B"),
        w=np.concatenate([part.w for part in parts]),
        beta=np.concatenate([part.beta for part in parts]),
        loads=tuple(applied),
        P=P[[row[name] for name in observed]],
        points=observed,
    )


def _side_by_side(parts: Sequence[System], name: str) -> Any:
    return sparse.csr_array(sparse.block_diag([getattr(part, name) for part in parts]))


def _check(bars: TwoBars) -> None:
    """Refuse joints that do not exist, that are supported, or that share nodes with others."""
    joints = {joint.region: joint for joint in bars.upper.joints}
    problems = [
        f"against: {region!r} is no joint of the upper bar; its joints: "
        f"{', '.join(sorted(joints)) or 'none'}"
        for region in bars.against
        if region not in joints
    ]
    if not bars.against:
        problems.append("against: found no joint; name at least one that presses the bars together")
    on_base = [
        bars.upper.joint_nodes(joint) for name, joint in joints.items() if name not in bars.against
    ]
    for region in bars.against:
        if region not in joints:
            continue
        nodes = bars.upper.bar.region_nodes(region)
        supported = np.intersect1d(nodes, bars.upper.fixed_nodes)
        if supported.size:
            problems.append(
                f"joint {region!r}: {supported.size} of its nodes are supported; what is pressed "
                "on the lower bar must be free to follow it: move the support off the joint, or "
                "exchange the bars"
            )
        if any(np.intersect1d(nodes, others).size for others in on_base):
            problems.append(
                f"joint {region!r} shares a node with a joint on a rigid base; leave an element "
                "between them"
            )
    if problems:
        raise InputError(problems)


def _axes(upper: BarMesh, lower: BarMesh) -> tuple[FloatArray, float]:
    """Direction of the lower bar, and 1 if the upper one runs the same way, -1 if against it."""
    units = []
    for bar in (upper, lower):
        whole = bar.coordinates[-1] - bar.coordinates[0]
        units.append(whole / np.linalg.norm(whole))
    sine = float(np.linalg.norm(np.cross(units[0], units[1])))
    if sine > _PARALLEL:
        raise InputError(
            f"the bars are not parallel: they make an angle of {np.degrees(np.arcsin(sine)):.3g} "
            "degrees"
        )
    return np.asarray(units[1]), float(np.sign(units[0] @ units[1]))


def _interpolation(bar: BarMesh, region: str, x: FloatArray, where: str) -> sparse.csr_array:
    """Values at the arc lengths ``x`` from a bar's start, inside a region, from its nodes."""
    inside = bar.region_nodes(region)
    position = np.asarray(bar.mesh.p[0]) - bar.mesh.p[0, 0]
    element = np.clip(np.searchsorted(position, x, side="right") - 1, 0, position.size - 2)
    share = (x - position[element]) / (position[element + 1] - position[element])
    for end in (0, 1):
        share[np.abs(x - position[element + end]) <= TOLERANCE * bar.length] = end
    on = np.isin(element, bar.regions[region])
    on |= (share == 0.0) & np.isin(element, inside)
    on |= (share == 1.0) & np.isin(element + 1, inside)
    outside = ~on | (share < 0.0) | (share > 1.0)
    if np.any(outside):
        gap = np.abs(x[outside][:, np.newaxis] - position[inside]).min(axis=1)
        raise InputError(
            f"{where}: {np.count_nonzero(outside)} of its {x.size} pressed nodes do not overlap "
            f"with {region!r}; the farthest is {gap.max():.3g} m from it; the pressed part must "
            "lie inside the part it is pressed against: split the mesh where the overlap ends, or "
            "exchange the bars"
        )
    number = np.arange(x.size)
    matrix = sparse.csr_array(
        (
            np.concatenate([1.0 - share, share]),
            (np.concatenate([number, number]), np.concatenate([element, element + 1])),
        ),
        shape=(x.size, position.size),
    )
    matrix.eliminate_zeros()
    return matrix
