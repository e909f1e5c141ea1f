"""The contact manifold: where a joint acts, which nodes are pressed, how hard, against what.

On cells a body lies on its base (strut, plate in plan); on facets it is pressed by its border
(edge of a plate seen from the side, face of a solid). The slip directions of a node are what is
perpendicular to its contact normal and to the directions that supports hold. A strut has one, a
plate in plan two, an edge one, a face two; none leaves the contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.mesh.cells import spot
from skfem_joint.structure.nodes import Nodes, interpolation
from skfem_joint.structure.pressure import Pressure, nodal_pressure
from skfem_joint.unknowns import expanded

#: How a pressure is turned into nodal normal forces.
NORMAL_FORCES = ("consistent", "equal")
#: Pressure of joints that clamping bolts press.
PRELOAD = "preload"
#: Largest angle between two facets that meet at a node which slips, degrees.
LARGEST_TURN = 30.0
#: Parts of a unit vector that count as none.
SMALL = 1e-9


@dataclass(frozen=True)
class Joint:
    """A part of a body pressed on a rigid base or on another body.

    Its contact points are the nodes that the pressure reaches; elsewhere there is no contact.

    Attributes
    ----------
    on : str
        Region (friction over an area, or along a bar) or boundary that is pressed.
    pressure : float, PressureTable, Bolts or "preload"
        Pa; "preload": as the clamping bolts of the structure press it.
    friction : float
        Coefficient of friction.
    against : str, optional
        Region or boundary of another body; a rigid base if not given.
    beta : float
        Scaling constant of the arctan law, Eq. (2), s/m; ``inf`` is Coulomb.
    normal_force : {"consistent", "equal"}
        Integrals of pressure times hat function, second order in the size of the elements; or the
        paper's, the total divided equally among the nodes that can slip, first order.
    axis : tuple of float, optional
        Direction along which reference modes are laid; the bar itself in one dimension.
    """

    on: str
    pressure: Pressure | str
    friction: float
    against: str | None = None
    beta: float = 1e5
    normal_force: str = "consistent"
    axis: tuple[float, ...] | None = None

    @property
    def name(self) -> str:
        """Name of the joint: of what is pressed."""
        return self.on

    @property
    def label(self) -> str:
        """The joint in a message."""
        return f"joint {self.on!r}"


@dataclass(frozen=True)
class Pressed:
    """What clamping bolts give to the nodes of a joint; 0 at the others."""

    force: FloatArray  #: (N,), normal forces, N
    area: FloatArray  #: (N,), area that may touch, m2
    gap: FloatArray  #: (N,), m, mean around each node, by which the joint has opened
    other: sparse.csr_array | None  #: (N, N), values of the other body opposite to each node


@dataclass(frozen=True)
class Patch:
    """Contact points of a joint: its nodes that carry pressure and are not held."""

    joint: Joint
    nodes: IntArray  #: (k,), displacement nodes of the body that is pressed
    points: IntArray  #: (k,), numbers of the contact points in the system
    normal_force: FloatArray  #: (k,), N
    area: FloatArray  #: (k,), share of the contact area, m2
    #: (k, d, dim), unit slip directions, perpendicular to each other; last, zero, those that a
    #: node has not.
    directions: FloatArray
    normal: FloatArray | None  #: (k, dim), of facets, outwards; None where cells lie on their base
    held_force: float  #: share of the clamping force of pressed nodes that supports hold, N
    held_area: float  #: and of the area, m2
    held_nodes: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))  #: their numbers
    held_normal: FloatArray | None = None  #: their normals: they cannot leave the base either
    #: (c, corners), linear sub-cells of the contact on node numbers.
    cells: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    #: (k, N), values of the other body at the contact nodes from those of its nodes; None: a base.
    other: sparse.csr_array | None = None
    bolt_shares: tuple[float, ...] = ()  #: part of each bolt's ring that is on the joint

    @property
    def clamping_force(self) -> float:
        """Whole normal force of the joint, that on supported nodes included, N."""
        return float(self.normal_force.sum()) + self.held_force

    def relative(self, displacement: FloatArray) -> FloatArray:
        """Displacement (..., k, dim) of the contact nodes against what they are pressed on.

        ``displacement`` holds the values at all nodes, (..., N, dim).
        """
        own = displacement[..., self.nodes, :]
        if self.other is None:
            return own
        under = expanded(self.other, displacement.swapaxes(-1, -2))
        return np.asarray(own - under.swapaxes(-1, -2))


def manifold_of(
    grid: Nodes, on: str, width: FloatArray, thickness: FloatArray, where: str
) -> tuple[IntArray, IntArray, FloatArray, FloatArray | None]:
    """Where a joint acts: sub-cells (c, corners), their elements and depth (c,), m, and normals.

    These, (N, dim), are of facets; None where cells lie on their base.
    """
    mesh, dim = grid.mesh, grid.mesh.dim
    ones = np.ones_like(width)
    if on in mesh.regions:
        inside = np.isin(grid.cell_element, mesh.regions[on])
        # A bar lies on its base with its width; a plate in plan is an area already.
        own = grid.cell_element[inside]
        return grid.cells[inside], own, (width, ones)[dim - 1][own], None
    facets = mesh.boundaries[on]
    cells, facet = grid.facet_cells(facets)
    beside = mesh.mesh.f2t[0, facets][facet]
    return cells, beside, (thickness, ones)[dim - 2][beside], _normals(grid, cells, beside, where)


def _normals(grid: Nodes, cells: IntArray, beside: IntArray, where: str) -> FloatArray:
    """Unit normals (N, dim), outwards, at the nodes of facets: means of those that meet there."""
    x, mesh = grid.nodes, grid.mesh.mesh
    corners = x[cells]
    if x.shape[1] == 2:
        vector = (corners[:, 1] - corners[:, 0])[:, ::-1] * [1.0, -1.0]
        meeting = np.bincount(cells.ravel())
        if np.any(meeting > 2):
            place = spot(x[np.argmax(meeting)])
            raise InputError(f"{where}: more than two of its edges meet at {place}")
    else:  # half the product of the diagonals, of a triangle of two sides
        diagonals = corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1]
        vector = 0.5 * np.cross(*diagonals)
    outwards = corners.mean(axis=1) - mesh.p[:, mesh.t[:, beside]].mean(axis=1).T
    vector *= np.sign(np.einsum("kc,kc->k", vector, outwards))[:, None]
    unit = vector / np.linalg.norm(vector, axis=1)[:, None]
    total, mean = np.zeros_like(x), np.zeros_like(x)
    for corner in cells.T:
        np.add.at(total, corner, vector)
        np.add.at(mean, corner, unit)
    mean, turn = unit_vectors(mean), np.zeros(len(x))
    for corner in cells.T:
        cosine = np.clip(np.einsum("kc,kc->k", mean[corner], unit), 0, 1)
        np.maximum.at(turn, corner, 2.0 * np.degrees(np.arccos(cosine)))
    worst = int(np.argmax(turn))
    if turn[worst] > LARGEST_TURN:
        raise InputError(
            f"{where}: it turns by {turn[worst]:.3g} degrees at {spot(x[worst])}, must be at "
            f"most {LARGEST_TURN:g}, else no tangent is defined there; give each straight part a "
            "boundary and a joint of its own, a node apart"
        )
    return unit_vectors(total)


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Unit vectors along some (k, dim), zero where these are."""
    size = np.linalg.norm(vectors, axis=1)[:, None]
    return np.asarray(vectors / np.where(size > 0.0, size, 1.0))


def _tangents(normals: FloatArray, overall: FloatArray) -> FloatArray:
    """Tangents (k, dim - 1, dim) at unit normals (k, dim), alike from node to node.

    In the plane they run along x, or along y where the border as a whole does not run along x.
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
    """Slip directions (k, d, dim), last zero, at normals and held displacements, (k, dim) each."""
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
    preloaded: Pressed | None = None,
) -> Patch:
    """Contact points of one joint, ``held`` (N, dim) being the displacements that supports hold.

    ``width`` and ``thickness`` are those of the elements, m. ``numbering`` (N,) is the contact
    point of each node, -1 without; new ones are entered. ``preloaded`` is what clamping bolts give.
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
    pressed = np.flatnonzero(force > 0.0)
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
    other = None if joint.against is None else _other(grid, joint, pressed, held, opposite)[slips]
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
        held_force=float(force[still].sum()),
        held_area=float(area[still].sum()),
        bolt_shares=shares,
    )


def _other(
    grid: Nodes,
    joint: Joint,
    pressed: IntArray,
    held: BoolArray,
    opposite: sparse.csr_array | None,
) -> sparse.csr_array:
    """Values of the other body at contact nodes from those of its nodes, (N, N) if known."""
    supported = pressed[held[pressed].any(axis=1)]
    if supported.size:
        raise InputError(
            f"{joint.label}: {supported.size} of its nodes are supported, the first at "
            f"{spot(grid.nodes[supported[0]])}; what is pressed against {joint.against!r} must be "
            "free to follow it: move the support off the joint, or exchange the pressed part "
            "and `against`"
        )
    if opposite is not None:
        return sparse.csr_array(opposite[pressed])
    if pressed.size == 0:
        return sparse.csr_array((0, grid.n_nodes))
    values, gap = interpolation(grid, str(joint.against), grid.nodes[pressed])
    if gap.max() > 0.0:
        farthest = grid.nodes[pressed[np.argmax(gap)]]
        raise InputError(
            f"{joint.label}: {np.count_nonzero(gap)} of its {pressed.size} pressed nodes do not "
            f"overlap with {joint.against!r}; the farthest, at {spot(farthest)}, is about "
            f"{gap.max():.3g} m from it; the pressed part must lie inside the part it is "
            "pressed against: split the mesh where the overlap ends, or exchange both"
        )
    return values


def shares_of(patches: Sequence[Patch], w: FloatArray) -> sparse.csr_array:
    """Part of the friction limit ``w`` (m,), N, of each point that each joint has, (joints, m)."""
    points = np.concatenate([np.zeros(0, np.intp), *(patch.points for patch in patches)])
    limits = np.concatenate([[], *(p.joint.friction * p.normal_force for p in patches)])
    joint = np.repeat(np.arange(len(patches)), [patch.points.size for patch in patches])
    limits = np.where(w[points] > 0.0, limits, 1.0)
    share = limits / np.bincount(points, limits, w.size)[points]
    return sparse.csr_array((share, (joint, points)), shape=(len(patches), w.size))


def _alike(a: Any, b: Any, rows_a: IntArray, rows_b: IntArray) -> bool:
    """Whether two arrays are of one kind, and the same in some rows."""
    if a is None or b is None or a.shape[1] != b.shape[1]:
        return a is b
    return bool(abs(a[rows_a] - b[rows_b]).max() < SMALL) if rows_a.size else True


def check_shared(grid: Nodes, patches: Sequence[Patch], new: Patch) -> None:
    """Refuse contact points shared with another joint whose law or slip is not the same."""
    for patch in patches:
        shared, mine, old = np.intersect1d(new.nodes, patch.nodes, return_indices=True)
        same = patch.joint.beta == new.joint.beta and _alike(patch.other, new.other, old, mine)
        if shared.size and not (same and _alike(patch.directions, new.directions, old, mine)):
            raise InputError(
                f"{new.joint.label} shares a node, at {spot(grid.nodes[shared[0]])}, with "
                f"{patch.joint.label} of another law, beta, slip direction or body; give both "
                "the same, or leave an element between them"
            )
