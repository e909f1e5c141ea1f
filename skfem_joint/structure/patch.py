"""The contact manifold: surface of a joint, its pressed nodes, their forces and slip directions.

A joint on a region lies on its base with the cells (a strut, a plate in plan); a joint on a
boundary is pressed with the facets (the edge of a plate seen from the side, a face of a solid). The
slip directions of a node are perpendicular to its contact normal and to the directions that
supports hold: a single direction on a strut and an edge, two on a plate in plan and a face. Contact
stays closed. Friction limits follow in `skfem_joint.structure.contact.contact_rows`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.errors import InputError
from skfem_joint.mesh.cells import CONFORMING, outward, spot
from skfem_joint.slips import unit_vectors
from skfem_joint.structure.joints import PRELOAD, Joint
from skfem_joint.structure.nodes import Nodes, interpolation
from skfem_joint.structure.pressure import nodal_pressure
from skfem_joint.unknowns import expanded

#: Parts of a unit vector below this are round-off.
SMALL = 1e-9


@dataclass(frozen=True)
class NodalForces:
    """Pressure of a joint by clamping bolts; values are 0 at nodes outside the joint.

    Attributes
    ----------
    force : ndarray, shape (N,)
        Normal force of each node, N.
    area : ndarray, shape (N,)
        Area around each node that may touch, m2.
    gap : ndarray, shape (N,)
        Mean distance around each node by which the joint has opened, m.
    other : sparse array, shape (N, N), or None
        Displacement of the other body opposite to each node, from that of its nodes.
    contact_force, contact_gap : ndarray, shape (k,), or None
        Force, N, and gap, m, of the nodes of `PressureSpace`, where bolts press the joint.
    means : sparse array, shape (k, k), or None
        Normal forces of the same nodes from these forces, see `PressureSpace.means`.
    """

    force: FloatArray
    area: FloatArray
    gap: FloatArray
    other: sparse.csr_array | None
    contact_force: FloatArray | None = None
    contact_gap: FloatArray | None = None
    means: Matrix | None = None


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
    held_force, held_area : float
        Share of the clamping force (N) and of the area (m2) of pressed nodes that supports hold.
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
    opening : OpeningFace, optional
        Pressure points, where the contact opens and closes.
    opening_normal, opening_other
        Normals and displacement of the other body at the nodes of these.
    """

    joint: Joint
    nodes: IntArray
    points: IntArray
    normal_force: FloatArray
    area: FloatArray
    directions: FloatArray
    normal: FloatArray | None
    held_force: float
    held_area: float
    held_nodes: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    held_normal: FloatArray | None = None
    held_other: sparse.csr_array | None = None
    cells: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    other: sparse.csr_array | None = None
    bolt_shares: tuple[float, ...] = ()
    opening: Any = None
    opening_normal: FloatArray | None = None
    opening_other: sparse.csr_array | None = None

    @property
    def stiffness(self) -> FloatArray:
        """Of the spring in series with the friction of each node, (k,), N/m; inf for none."""
        return point_stiffness(self.joint, self.area)

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


def manifold_of(
    grid: Nodes, on: str, width: FloatArray, thickness: FloatArray, where: str
) -> tuple[IntArray, IntArray, FloatArray, FloatArray | None]:
    """Sub-cells on which a joint acts, with their elements, depths and normals.

    Parameters
    ----------
    grid : Nodes
    on : str
        Region or boundary.
    width, thickness : ndarray, shape (elements,)
        m.
    where : str
        What a message calls the joint.

    Returns
    -------
    cells : ndarray of int, shape (c, corners)
        Nodes of the sub-cells.
    elements : ndarray of int, shape (c,)
        Element beside each.
    depth : ndarray, shape (c,)
        Extent of the contact across each, m; 1 where sub-cells are areas already.
    normals : ndarray, shape (N, dim), or None
        Outward unit normals at the nodes of facets; None where cells lie on their base.

    Raises
    ------
    InputError
        If facets of the joint meet at more than 30 degrees, or more than two edges at a node.
    """
    mesh, dim = grid.mesh, grid.mesh.dim
    ones = np.ones_like(width)
    if on in mesh.regions:
        inside = np.isin(grid.cell_element, mesh.regions[on])
        # A bar lies on its base with its width; a cell of a plate in plan is an area already.
        own = grid.cell_element[inside]
        return grid.cells[inside], own, (width, ones)[dim - 1][own], None
    facets = mesh.boundaries[on]
    cells, facet = grid.facet_cells(facets)
    beside = mesh.mesh.f2t[0, facets][facet]
    return cells, beside, (thickness, ones)[dim - 2][beside], _normals(grid, cells, beside, where)


def _normals(grid: Nodes, cells: IntArray, beside: IntArray, where: str) -> FloatArray:
    """Outward unit normals (N, dim) at the nodes of facets: means of those that meet there.

    Facets that meet at more than `largest_turn` degrees are refused: a node between them has no
    tangent. A face that is flat but for rounded coordinates has one normal, which holds no slip.
    """
    largest_turn = 30.0
    x, mesh = grid.nodes, grid.mesh.mesh
    if x.shape[1] == 2:
        meeting = np.bincount(cells.ravel())
        if np.any(meeting > 2):
            place = spot(x[np.argmax(meeting)])
            raise InputError(f"{where}: more than two of its edges meet at {place}")
    vector = outward(x[cells], mesh.p[:, mesh.t[:, beside]].mean(axis=1).T)
    unit = unit_vectors(vector)
    common = unit_vectors(vector.sum(axis=0, keepdims=True))
    if np.linalg.norm(unit - common, axis=1).max() < CONFORMING:  # flat but for rounded coordinates
        unit = np.repeat(common, len(unit), axis=0)
        vector = np.linalg.norm(vector, axis=1)[:, None] * unit
    total, mean = np.zeros_like(x), np.zeros_like(x)
    for corner in cells.T:
        np.add.at(total, corner, vector)
        np.add.at(mean, corner, unit)
    mean, turn = unit_vectors(mean), np.zeros(len(x))
    for corner in cells.T:
        cosine = np.clip(np.einsum("kc,kc->k", mean[corner], unit), 0, 1)
        np.maximum.at(turn, corner, 2.0 * np.degrees(np.arccos(cosine)))
    worst = int(np.argmax(turn))
    if turn[worst] > largest_turn:
        raise InputError(
            f"{where}: it turns by {turn[worst]:.3g} degrees at {spot(x[worst])}, must be at "
            f"most {largest_turn:g}, else no tangent is defined there; give each straight part a "
            "boundary and a joint of its own, a node apart"
        )
    return unit_vectors(total)


def _tangents(normals: FloatArray, overall: FloatArray) -> FloatArray:
    """Tangents (k, dim - 1, dim) at unit normals (k, dim), which vary little from node to node.

    ``overall`` (dim,) is the sum of all normals. In the plane tangents have a positive component
    along x, or along y where the border as a whole is perpendicular to x. In space the first
    tangent is the projection of the axis to which the border is most nearly parallel.
    """
    if normals.shape[1] == 2:
        t = np.stack([normals[:, 1], -normals[:, 0]], axis=1)
        whole = np.array([overall[1], -overall[0]])
        leading = whole[0] if abs(whole[0]) > SMALL * np.linalg.norm(whole) else whole[1]
        return np.asarray(-t if leading < 0.0 else t)[:, np.newaxis]
    axes = np.eye(3)[np.argsort(np.abs(overall), kind="stable")]
    first = axes[0] - normals * (normals @ axes[0])[:, None]
    weak = np.linalg.norm(first, axis=1) < 0.1
    first[weak] = axes[1] - normals[weak] * (normals[weak] @ axes[1])[:, None]
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normals, first)], axis=1)


def slip_directions(normals: FloatArray | None, held: BoolArray) -> FloatArray:
    """Slip directions of k nodes, shape (k, d, dim); absent ones are zero and come last.

    A node slips in the directions perpendicular to its normal and to what supports hold: the null
    space of both, whose vectors are signed so that the largest component is positive.

    Parameters
    ----------
    normals : ndarray, shape (k, dim), or None
        Unit normals of facets; None where cells lie on their base.
    held : ndarray of bool, shape (k, dim)
        Displacements that supports hold.
    """
    k, dim = held.shape
    if normals is None:
        free = np.broadcast_to(np.eye(dim), (k, dim, dim)).copy()
    else:
        free = _tangents(normals, normals.sum(axis=0))
    bound = np.flatnonzero(held.any(axis=1))
    if bound.size:
        constraints = np.einsum("kc,cd->kcd", held[bound].astype(float), np.eye(dim))
        if normals is not None:
            constraints = np.concatenate([constraints, normals[bound, np.newaxis]], axis=1)
        _, size, vectors = np.linalg.svd(constraints)
        size = np.concatenate([size, np.zeros((bound.size, dim - size.shape[1]))], axis=1)
        null = np.where((size > SMALL)[:, :, np.newaxis], 0.0, vectors)
        largest = np.take_along_axis(null, np.abs(null).argmax(axis=2)[..., None], axis=2)
        null = null * np.where(largest < 0.0, -1.0, 1.0)
        null[np.abs(null) < SMALL] = 0.0
        order = np.argsort(size > SMALL, axis=1, kind="stable")
        free[bound] = np.take_along_axis(null, order[..., None], axis=1)[:, : free.shape[1]]
    return free


def make_patch(
    grid: Nodes,
    joint: Joint,
    held: BoolArray,
    width: FloatArray,
    thickness: FloatArray,
    numbering: IntArray,
    preloaded: NodalForces | None = None,
    opening: Any = None,
) -> Patch:
    """Contact points of a joint.

    Parameters
    ----------
    grid : Nodes
    joint : Joint
    held : ndarray of bool, shape (N, dim)
        Displacements that supports hold.
    width, thickness : ndarray, shape (elements,)
        m.
    numbering : ndarray of int, shape (N,)
        Contact point of each node, -1 where there is none. New points are entered in it.
    preloaded : NodalForces, optional
        Normal forces from clamping bolts, or of contact that opens.
    opening : OpeningFace, optional
        Pressure points of contact that opens, whose nodes are all contact points.

    Raises
    ------
    InputError
        If nothing in the joint can slip, if pressed nodes are supported or lie outside the other
        body, or if a pressure of "preload" comes without bolts.
    """
    label = joint.label
    cells, _, depth, normals = manifold_of(grid, joint.on, width, thickness, label)
    shares: tuple[float, ...] = ()
    if preloaded is not None:
        force, area = preloaded.force, preloaded.area
    elif isinstance(joint.pressure, str):
        raise InputError(
            f"{label}: pressure: found {joint.pressure!r}, must be in Pa; {PRELOAD!r} needs the "
            "bolts of a Structure"
        )
    else:
        force, area, shares = nodal_pressure(grid.nodes, cells, depth, joint.pressure, label)
    pressed = np.flatnonzero(force > 0.0) if opening is None else opening.nodes
    if joint.normal_force == "equal" and pressed.size:
        pressed = np.unique(cells)
    normal = None if normals is None else normals[pressed]
    directions = slip_directions(normal, held[pressed])
    slips = np.any(directions[:, 0] != 0.0, axis=1)
    still, own = pressed[~slips], pressed[slips]
    if own.size == 0 and pressed.size:
        raise InputError(
            f"{label} has no free node: all its nodes are supported, nothing in it can slip; "
            "refine it or leave it out"
        )
    if joint.normal_force == "equal":
        total, force = force.sum(), np.zeros_like(force)
        force[own] = total / max(own.size, 1)
    opposite = None if preloaded is None else preloaded.other
    opening_other = None if joint.against is None else _other(grid, joint, pressed, held, opposite)
    other = None if opening_other is None else opening_other[slips]
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
        cells=cells,
        other=other,
        held_nodes=still,
        held_normal=None if normal is None else normal[~slips],
        held_other=None if opening_other is None else opening_other[~slips],
        held_force=float(force[still].sum()),
        held_area=float(area[still].sum()),
        bolt_shares=shares,
        opening=opening,
        opening_normal=None if opening is None or normals is None else normals[opening.nodes],
        opening_other=None if opening is None else opening_other,
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
