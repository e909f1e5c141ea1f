"""Contact points of a joint: its pressed nodes, their forces and slip directions.

Contact stays closed, or has the pressure points of `skfem_joint.joint.opening`. Friction limits
follow in `skfem_joint.joint.contact.contact_rows`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.body.nodes import Nodes, interpolation
from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.joints import Joint
from skfem_joint.joint.manifold import SMALL, manifold_of, slip_directions
from skfem_joint.joint.opening import NodalForces, OpeningFace, opening_face
from skfem_joint.joint.pressure import nodal_pressure
from skfem_joint.joint.pressure_space import PressureSpace
from skfem_joint.mesh.cells import spot
from skfem_joint.system.unknowns import expanded, selection


def point_stiffness(joint: Joint, area: FloatArray) -> FloatArray:
    """Stiffness of points with some shares of a joint's area (m2), N/m; ``inf`` for no spring."""
    if np.isinf(joint.tangential_stiffness):
        return np.full(area.shape, np.inf)
    return np.where(area > 0.0, area * joint.tangential_stiffness, np.inf)


@dataclass(frozen=True)
class Patch:
    """Contact points of a joint: its k nodes that carry pressure and that supports leave free.

    Attributes
    ----------
    joint : Joint
    nodes : ndarray of int, shape (k,)
        Displacement nodes of the body that is pressed.
    points : ndarray of int, shape (k,)
        Numbers of the contact points in the system.
    normal_force : ndarray, shape (k,)
        Force that presses each node, N.
    area : ndarray, shape (k,)
        Share of each node in the contact area, m2.
    directions : ndarray, shape (k, d, dim)
        Unit slip directions, perpendicular to each other. A node with fewer than d directions has
        zeros in place of the last.
    normal : ndarray, shape (k, dim), or None
        Outward normals of facets; None where cells lie on their base.
    held_forces, held_areas : ndarray, shape (held nodes,)
        Forces (N) and areas (m2) of pressed nodes that supports hold.
    held_nodes : ndarray of int
        Numbers of these nodes.
    held_normal : ndarray, shape (held nodes, dim), or None
        Normals of these nodes: closed contact fixes their displacement along the normal in the
        directions that supports leave free.
    held_other : sparse array, shape (held nodes, N), or None
        Displacement of the other body at these nodes.
    cells : ndarray of int, shape (c, corners)
        Linear sub-cells of the contact, by node numbers.
    other : sparse array, shape (k, N), or None
        Displacement of the other body at the contact nodes, from that of its nodes; None on a
        rigid base.
    bolt_shares : tuple of float
        Part of each bolt's ring that lies on the joint.
    opening : OpeningFace
        Pressure points of contact that opens and closes; without any where it stays closed.
    """

    joint: Joint
    nodes: IntArray
    points: IntArray
    normal_force: FloatArray
    area: FloatArray
    directions: FloatArray
    normal: FloatArray | None
    held_forces: FloatArray
    held_areas: FloatArray
    held_nodes: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    held_normal: FloatArray | None = None
    held_other: sparse.csr_array | None = None
    cells: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    other: sparse.csr_array | None = None
    bolt_shares: tuple[float, ...] = ()
    opening: OpeningFace = field(default_factory=lambda: OpeningFace.closed(0, 0))

    @property
    def stiffness(self) -> FloatArray:
        """Of the spring in series with the friction of each node, (k,), N/m; inf for none."""
        return point_stiffness(self.joint, self.area)

    @property
    def held_force(self) -> float:
        """Share of the clamping force of nodes that supports hold, N."""
        return float(self.held_forces.sum())

    @property
    def held_area(self) -> float:
        """Share of the area of nodes that supports hold, m2."""
        return float(self.held_areas.sum())

    @property
    def clamping_force(self) -> float:
        """Normal force of the whole joint, N, that on supported nodes included."""
        return float(self.normal_force.sum()) + self.held_force

    def relative(self, displacement: FloatArray) -> FloatArray:
        """Displacement of the contact nodes relative to the other body or base, (..., k, dim).

        ``displacement`` holds the values at all nodes, (..., N, dim).
        """
        own = displacement[..., self.nodes, :]
        if self.other is None:
            return own
        opposite = expanded(self.other, displacement.swapaxes(-1, -2))
        return np.asarray(own - opposite.swapaxes(-1, -2))


def make_patch(
    grid: Nodes,
    joint: Joint,
    held: BoolArray,
    numbering: IntArray,
    preloaded: NodalForces | None,
    space: PressureSpace | None,
) -> Patch:
    """Contact points of a joint.

    Parameters
    ----------
    grid : Nodes
    joint : Joint
    held : ndarray of bool, shape (N, dim)
        Displacements that supports hold.
    numbering : ndarray of int, shape (N,)
        Contact point of each node, -1 where there is none. New points are entered in it.
    preloaded : NodalForces or None
        Normal forces from clamping bolts.
    space : PressureSpace or None
        Pressures of a joint that opens.

    Raises
    ------
    InputError
        If nothing in the joint can slip, or if pressed nodes are supported or lie outside the other
        body.
    """
    manifold = manifold_of(grid, joint)
    shares: tuple[float, ...] = ()
    if preloaded is not None:
        force, area = preloaded.force, preloaded.area
    elif not isinstance(joint.pressure, str):
        at = manifold.cells, manifold.depth, joint.pressure, joint.label
        force, area, shares = nodal_pressure(grid.nodes, *at)
    else:  # by bolts that are still to be tightened
        force = area = np.zeros(grid.n_nodes)
    opening = OpeningFace.closed(*held.shape)
    pressed = np.flatnonzero(force > 0.0)
    opposite = None if preloaded is None else preloaded.other
    if joint.opens:  # all nodes of whose face are contact points, with forces of their own
        face: Any = manifold.normals, force, preloaded, space
        opening = opening_face(grid, joint, held, *face)
        pressed, at_node = opening.nodes, selection(opening.nodes, grid.n_nodes).T
        force, area = at_node @ opening.force, at_node @ opening.area
        opposite = sparse.csr_array(at_node @ opening.other)
    if joint.normal_force == "equal" and pressed.size:
        pressed = np.unique(manifold.cells)
    normal = None if manifold.normals is None else manifold.normals[pressed]
    directions = slip_directions(normal, held[pressed])
    slips = np.any(directions[:, 0] != 0.0, axis=1)
    still, own = pressed[~slips], pressed[slips]
    if own.size == 0 and pressed.size:
        raise InputError(
            f"{joint.label} has no free node: all its nodes are supported, nothing in it can slip; "
            "refine it or leave it out"
        )
    if joint.normal_force == "equal":
        total, force = force.sum(), np.zeros_like(force)
        force[own] = total / max(own.size, 1)
    other = None if joint.against is None else _other(grid, joint, pressed, held, opposite)
    new = own[numbering[own] < 0]
    numbering[new] = numbering.max(initial=-1) + 1 + np.arange(new.size)
    return Patch(
        joint=joint,
        nodes=own,
        points=numbering[own],
        normal_force=force[own],
        area=area[own],
        directions=directions[slips],
        normal=None if normal is None else normal[slips],
        cells=manifold.cells,
        other=None if other is None else other[slips],
        held_nodes=still,
        held_normal=None if normal is None else normal[~slips],
        held_other=None if other is None else other[~slips],
        held_forces=force[still],
        held_areas=area[still],
        bolt_shares=shares,
        opening=opening,
    )


def _other(
    grid: Nodes,
    joint: Joint,
    pressed: IntArray,
    held: BoolArray,
    opposite: sparse.csr_array | None,
) -> sparse.csr_array:
    """Displacement of the other body at the pressed nodes, shape (k, N), from that of its nodes.

    ``opposite`` (N, N) is the same for all nodes, if a preload has computed it before.
    """
    values, gap = opposite, np.zeros(pressed.size)
    if values is not None:
        values = sparse.csr_array(values[pressed])
    elif pressed.size:
        values, gap = interpolation(grid, str(joint.against), grid.nodes[pressed])
    else:
        values = sparse.csr_array((0, grid.n_nodes))
    if gap.max(initial=0.0) > 0.0:
        farthest = grid.nodes[pressed[np.argmax(gap)]]
        raise InputError(
            f"{joint.label}: {np.count_nonzero(gap)} of its {pressed.size} pressed nodes do not "
            f"overlap with {joint.against!r}; the farthest, at {spot(farthest)}, is about "
            f"{gap.max():.3g} m from it; the pressed part must lie inside the part it is "
            "pressed against: split the mesh where the overlap ends, or exchange both"
        )
    # Both bodies may be held alike, as on a plane of symmetry: there the slip is zero.
    alone = held[pressed] & (values @ (~held).astype(float) > SMALL)
    if alone.any():
        supported = pressed[alone.any(axis=1)]
        raise InputError(
            f"{joint.label}: {supported.size} of its nodes are supported, the first at "
            f"{spot(grid.nodes[supported[0]])}; what is pressed against {joint.against!r} must be "
            "free to follow it: hold both bodies there alike, as on a plane of symmetry, move the "
            "support off the joint, or exchange the pressed part and `against`"
        )
    return values


def shares_of(patches: Sequence[Patch], w: FloatArray) -> sparse.csr_array:
    """Share of each joint in the friction limit ``w`` (m,), N, of each point, (joints, m)."""
    points = np.concatenate([np.zeros(0, np.intp), *(patch.points for patch in patches)])
    limits = np.concatenate([[], *(p.joint.friction * p.normal_force for p in patches)])
    joint = np.repeat(np.arange(len(patches)), [patch.points.size for patch in patches])
    limits = np.where(w[points] > 0.0, limits, 1.0)
    share = limits / np.bincount(points, limits, w.size)[points]
    return sparse.csr_array((share, (joint, points)), shape=(len(patches), w.size))


def _alike(a: Any, b: Any, rows_a: IntArray, rows_b: IntArray) -> bool:
    """Whether both arrays are absent, or equal in the given rows."""
    if a is None or b is None or a.shape[1] != b.shape[1]:
        return a is b
    return bool(abs(a[rows_a] - b[rows_b]).max() < SMALL) if rows_a.size else True


def _law(joint: Joint) -> tuple[float, float]:
    """What points that two joints share must have alike."""
    return joint.beta, joint.tangential_stiffness


def check_shared(grid: Nodes, patches: Sequence[Patch], new: Patch) -> None:
    """Refuse contact points that ``new`` shares with a joint of another law or slip direction."""
    for patch in patches:
        shared, mine, old = np.intersect1d(new.nodes, patch.nodes, return_indices=True)
        if shared.size and (patch.joint.opens or new.joint.opens):
            raise InputError(
                f"{new.joint.label} shares a node, at {spot(grid.nodes[shared[0]])}, with "
                f"{patch.joint.label}, and contact = 'unilateral' needs nodes of its own; make "
                "both a single joint, or leave an element between them"
            )
        same = _alike(patch.other, new.other, old, mine) and _law(patch.joint) == _law(new.joint)
        if shared.size and not (same and _alike(patch.directions, new.directions, old, mine)):
            raise InputError(
                f"{new.joint.label} shares a node, at {spot(grid.nodes[shared[0]])}, with "
                f"{patch.joint.label} of another law, beta, tangential_stiffness, slip direction "
                "or body; give both the same, or leave an element between them"
            )
