"""A jointed plate or several: materials, supports, joints and their contact points.

The unknowns are chosen so that every row of the slip operator picks one of them. A displacement
of all nodes is ``T`` times the unknowns: supports are left out; a node pressed on a rigid base
has its slip; a node pressed on another body has its slip against that body as its own unknown, its
displacement being slip plus what the other body does there. Forces on the other body then follow
from ``T`` transposed, equal and opposite and along the same line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.bolts import Bolts
from skfem_joint.errors import InputError
from skfem_joint.plate_contact import (
    NodalPressure,
    Pressure,
    edge_pressure,
    edge_tangents,
    interpolation,
    locate,
    locate_on_edges,
    region_pressure,
)
from skfem_joint.plate_mesh import PlateMesh

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

_LARGEST_TURN = 30.0  # degrees between two edges of a boundary that slips
#: Parts of a unit vector that count as none.
SMALL = 1e-9


@dataclass(frozen=True)
class PlateJoint:
    """A part of a plate pressed on a rigid base or on another body.

    Its contact points are the nodes that the pressure reaches; elsewhere there is no contact.

    Attributes
    ----------
    name : str
        Region or boundary that is pressed.
    kind : {"region", "boundary"}
        Friction over an area with slip in two directions, or along an edge.
    against : str or None
        Region or boundary of another body; None is a rigid base.
    pressure : float, AxialPressure or Bolts
        Clamping pressure, Pa, or bolts (on regions only).
    friction : float
        Coefficient of friction.
    beta : float
        Scaling constant of the arctan law, Eq. (2), s/m; ``inf`` is Coulomb.
    """

    name: str
    kind: Literal["region", "boundary"]
    against: str | None
    pressure: Pressure
    friction: float
    beta: float = 1e5

    @property
    def label(self) -> str:
        """The joint in a message."""
        return f"joint {self.name!r}"


@dataclass(frozen=True)
class Patch:
    """Contact points of a joint: its nodes that carry pressure and are not held.

    Attributes
    ----------
    joint : PlateJoint
    nodes : ndarray of int, shape (k,)
        Displacement nodes of the body that is pressed.
    points : ndarray of int, shape (k,)
        Numbers of the contact points in the system.
    normal_force : ndarray, shape (k,)
        N.
    area : ndarray, shape (k,)
        Nodal share of the contact area, m2 (edges: length times thickness).
    directions : ndarray, shape (k, d, 2)
        Unit slip directions, d = 2 for a region and 1 for a boundary; zero for a direction that a
        support holds, which comes last.
    other : sparse array, shape (k, N), or None
        Values of the other body at the contact nodes from those of its nodes; None: rigid base.
    held_nodes : ndarray of int
        Nodes that carry pressure but cannot slip, being supported.
    held_force, held_area : float
        What those carry of the clamping force (N) and area (m2).
    bolt_shares : tuple of float
        Part of the ring pressed by each bolt that lies on the joint.
    """

    joint: PlateJoint
    nodes: IntArray
    points: IntArray
    normal_force: FloatArray
    area: FloatArray
    directions: FloatArray
    other: sparse.csr_array | None
    held_nodes: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    held_force: float = 0.0
    held_area: float = 0.0
    bolt_shares: tuple[float, ...] = ()

    @property
    def clamping_force(self) -> float:
        """Whole normal force of the joint, that on supported nodes included, N."""
        return float(self.normal_force.sum()) + self.held_force

    def relative(self, displacement: FloatArray) -> FloatArray:
        """Displacement (..., k, 2) of the contact nodes against what they are pressed on.

        ``displacement`` holds the values at all nodes, (..., N, 2), see
        :meth:`PlateStructure.expand`.
        """
        own = displacement[..., self.nodes, :]
        if self.other is None:
            return own
        flat = np.moveaxis(displacement, -2, 0).reshape(displacement.shape[-2], -1)
        under = (self.other @ flat).reshape(-1, *displacement.shape[:-2], 2)
        return np.asarray(own - np.moveaxis(under, 0, -2))


@dataclass(frozen=True)
class PlateStructure:
    """Plates with joints; the arrays of properties hold one value an element.

    Attributes
    ----------
    plate : PlateMesh
    E, poisson, density, thickness : ndarray
        Pa, dimensionless, kg/m3, m.
    plane : {"stress", "strain"}
    supports : tuple of (str, str)
        Name of a boundary, region or point, and the directions held there: "xy", "x" or "y".
    joints : tuple of PlateJoint
    stiffness_damping, mass_damping : float
        C = stiffness_damping K + mass_damping M, in s and 1/s.
    """

    plate: PlateMesh
    E: FloatArray
    poisson: FloatArray
    density: FloatArray
    thickness: FloatArray
    plane: str
    supports: tuple[tuple[str, str], ...]
    joints: tuple[PlateJoint, ...] = ()
    stiffness_damping: float = 0.0
    mass_damping: float = 0.0

    @cached_property
    def element(self) -> Any:
        """Scalar element of scikit-fem for one component of the displacement."""
        from skfem import ElementQuad1, ElementQuad2, ElementTriP1, ElementTriP2

        triangles = self.plate.mesh.t.shape[0] == 3
        if self.plate.order == 1:
            return ElementTriP1() if triangles else ElementQuad1()
        return ElementTriP2() if triangles else ElementQuad2()

    @cached_property
    def basis(self) -> Any:
        """Scalar basis: its degrees of freedom are the displacement nodes."""
        from skfem import Basis

        return Basis(self.plate.mesh, self.element, intorder=self.quadrature)

    @property
    def quadrature(self) -> int:
        """Order of integration: exact for the mass of triangles, and of any quadrilateral."""
        order = self.plate.order
        return 2 * order if self.plate.mesh.t.shape[0] == 3 else 2 * order + 1

    @cached_property
    def _refined(self) -> Any:
        return self.plate.mesh if self.plate.order == 1 else self.plate.mesh.refined()

    @property
    def nodes(self) -> FloatArray:
        """Positions of the displacement nodes, (N, 2): vertices, edge middles, cell middles, m."""
        return np.asarray(self._refined.p.T)

    @property
    def cells(self) -> IntArray:
        """Linear sub-cells on the nodes, (sub-cells, 3 or 4)."""
        return np.asarray(self._refined.t.T, dtype=np.intp)

    @cached_property
    def cell_element(self) -> IntArray:
        """Element of each sub-cell."""
        elements = self.plate.mesh.t.shape[1]
        number: IntArray = np.tile(np.arange(elements), len(self.cells) // elements)
        return number

    @property
    def n_nodes(self) -> int:
        """Number of displacement nodes N."""
        return int(self._refined.p.shape[1])

    @cached_property
    def element_nodes(self) -> IntArray:
        """Displacement nodes of the elements, (nodes of an element, elements)."""
        return np.asarray(self.basis.dofs.element_dofs, dtype=np.intp)

    @cached_property
    def body(self) -> IntArray:
        """Body of each node, (N,)."""
        body = np.full(self.n_nodes, -1, dtype=np.intp)
        body[self.element_nodes] = self.plate.body
        return body

    def nodes_of(self, name: str) -> IntArray:
        """Displacement nodes of a region, boundary or point, in rising order."""
        if name in self.plate.points:
            return np.array([self.plate.points[name]], dtype=np.intp)
        if name in self.plate.regions:
            return np.unique(self.element_nodes[:, self.plate.regions[name]])
        return np.unique(self._edges(name))

    def _edges(self, boundary: str) -> IntArray:
        """Two-node edges of a boundary, each with its body on the left."""
        mesh, facets = self.plate.mesh, self.plate.boundaries[boundary]
        ends = mesh.facets[:, facets].T.astype(np.intp)
        along = self.nodes[ends[:, 1]] - self.nodes[ends[:, 0]]
        inwards = mesh.p[:, mesh.t[:, mesh.f2t[0, facets]]].mean(axis=1).T - self.nodes[ends[:, 0]]
        left = along[:, 0] * inwards[:, 1] - along[:, 1] * inwards[:, 0] > 0.0
        ends = np.asarray(np.where(left[:, None], ends, ends[:, ::-1]), dtype=np.intp)
        if self.plate.order == 1:
            return ends
        middle = mesh.p.shape[1] + np.asarray(facets, dtype=np.intp)
        return np.concatenate(
            [np.stack([ends[:, 0], middle], axis=1), np.stack([middle, ends[:, 1]], axis=1)]
        )

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """Whether a support holds each displacement, (N, 2)."""
        held = np.zeros((self.n_nodes, 2), dtype=bool)
        for name, directions in self.supports:
            for direction in directions:
                held[self.nodes_of(name), "xy".index(direction)] = True
        return held

    @cached_property
    def patches(self) -> tuple[Patch, ...]:
        """Contact points of each joint."""
        problems: list[str] = []
        patches: list[Patch] = []
        numbering = np.full(self.n_nodes, -1, dtype=np.intp)
        for joint in self.joints:
            try:
                patch = _patch(self, joint, numbering)
                _check_shared(self, patches, patch)
            except InputError as error:
                problems += error.problems
                continue
            patches.append(patch)
        if problems:
            raise InputError(problems)
        return tuple(patches)

    @cached_property
    def _node_directions(self) -> tuple[FloatArray, IntArray]:
        """Directions (N, 2, 2) of the unknowns of each node, and how many they are (N,)."""
        directions = np.zeros((self.n_nodes, 2, 2))
        free = ~self.held
        directions[:, 0, 0] = free[:, 0]
        directions[:, 0, 1] = ~free[:, 0] & free[:, 1]
        directions[:, 1, 1] = free[:, 0] & free[:, 1]
        count = free.sum(axis=1)
        for patch in self.patches:
            if patch.joint.kind == "boundary":
                directions[patch.nodes, 0] = patch.directions[:, 0]
                directions[patch.nodes, 1] = 0.0
                count[patch.nodes] = 1
            # A support along the edge and the base across it leave no motion.
            directions[patch.held_nodes] = 0.0
            count[patch.held_nodes] = 0
        return directions, count.astype(np.intp)

    @cached_property
    def first_unknown(self) -> IntArray:
        """First unknown of each node, and the number of unknowns, (N + 1,)."""
        return np.concatenate([[0], np.cumsum(self._node_directions[1])]).astype(np.intp)

    @cached_property
    def T(self) -> sparse.csr_array:
        """Displacement of all nodes from the unknowns, (2N, n); row 2 i + c is component c."""
        directions, count = self._node_directions
        node, which = np.nonzero(np.arange(2) < count[:, None])
        rows = 2 * node[:, None] + np.arange(2)
        columns = np.repeat((self.first_unknown[node] + which)[:, None], 2, axis=1)
        size = (2 * self.n_nodes, int(self.first_unknown[-1]))
        own = sparse.csr_array(
            (directions[node, which].ravel(), (rows.ravel(), columns.ravel())), shape=size
        )
        own.eliminate_zeros()
        under = self._other_bodies
        T = own
        # A body may rest on one that rests on a third, and so on.
        for _ in range(len(self.joints) + 1):
            longer = sparse.csr_array(own + under @ T)
            if abs(longer - T).sum() == 0.0:
                T.eliminate_zeros()
                return T
            T = longer
        names = [joint.name for joint in self.joints if joint.against is not None]
        raise InputError(
            f"joints {', '.join(names)}: bodies are pressed on each other in a circle, so that no "
            "slip is independent; exchange the pressed part and `against` of one of them"
        )

    @cached_property
    def _other_bodies(self) -> sparse.csr_array:
        """Share (2N, 2N) of the displacement of contact nodes that other bodies give them."""
        R = sparse.csr_array((self.n_nodes, self.n_nodes))
        for patch in self.patches:
            if patch.other is not None:
                new = ~np.isin(patch.nodes, R.nonzero()[0])
                R = R + selection(patch.nodes[new], self.n_nodes).T @ patch.other[new]
        return sparse.csr_array(sparse.kron(R, sparse.eye_array(2)))

    def expand(self, u: FloatArray) -> FloatArray:
        """Displacement of all nodes, (..., N, 2), from that of the unknowns, (..., n)."""
        flat = (self.T @ u.reshape(-1, u.shape[-1]).T).T
        return np.asarray(flat).reshape(*u.shape[:-1], self.n_nodes, 2)


def selection(columns: IntArray, n: int) -> sparse.csr_array:
    """Matrix whose rows each pick one of ``n`` columns."""
    ones = np.ones(columns.size)
    return sparse.csr_array((ones, (np.arange(columns.size), columns)), shape=(columns.size, n))


def _place(structure: PlateStructure, node: int) -> str:
    x, y = structure.nodes[node]
    return f"({x:.6g}, {y:.6g})"


def _pressure(structure: PlateStructure, joint: PlateJoint) -> NodalPressure:
    """Nodal normal forces and areas of a joint on all nodes."""
    plate = structure.plate
    if joint.kind == "region":
        inside = np.isin(structure.cell_element, plate.regions[joint.name])
        return region_pressure(
            structure.nodes, structure.cells[inside], joint.pressure, joint.label
        )
    if isinstance(joint.pressure, Bolts):
        raise InputError(
            f"{joint.label}: bolts press regions; a boundary needs a pressure in Pa, constant or "
            "as positions and values"
        )
    edges = structure._edges(joint.name)
    beside = plate.mesh.f2t[0, plate.boundaries[joint.name]]
    thickness = np.tile(structure.thickness[beside], structure.plate.order)
    return edge_pressure(structure.nodes, edges, thickness, joint.pressure)


def _patch(structure: PlateStructure, joint: PlateJoint, numbering: IntArray) -> Patch:
    """Contact points of one joint; new ones are entered in ``numbering`` (N,)."""
    pressure = _pressure(structure, joint)
    nodes = np.flatnonzero(pressure.force > 0.0)
    held = structure.held[nodes]
    directions = np.zeros((nodes.size, 2, 2))
    if joint.kind == "region":
        directions[:, 0, 0] = ~held[:, 0]
        directions[:, 0, 1] = held[:, 0] & ~held[:, 1]
        directions[:, 1, 1] = ~held[:, 0] & ~held[:, 1]
    else:
        tangents = edge_tangents(
            structure.nodes, structure._edges(joint.name), _LARGEST_TURN, joint.label
        )
        stopped = np.any(held & (np.abs(tangents[nodes]) > SMALL), axis=1)
        directions[:, 0] = np.where(stopped[:, None], 0.0, tangents[nodes])
        directions = directions[:, :1]
    other = None
    if joint.against is not None:
        if np.any(held):
            worst = nodes[np.flatnonzero(held.any(axis=1))]
            raise InputError(
                f"{joint.label}: {worst.size} of its nodes are supported, the first at "
                f"{_place(structure, worst[0])}; what is pressed against {joint.against!r} must be "
                "free to follow it: move the support off the joint, or exchange the pressed part "
                "and `against`"
            )
        other = _interpolation(structure, joint, nodes)
    slips = np.any(directions[:, 0] != 0.0, axis=1)
    if not np.any(slips) and nodes.size:
        raise InputError(
            f"{joint.label} has no free node: all its nodes are supported, nothing in it can "
            "slip; refine it or leave it out"
        )
    still, nodes = nodes[~slips], nodes[slips]
    new = nodes[numbering[nodes] < 0]
    numbering[new] = numbering.max() + 1 + np.arange(new.size)
    return Patch(
        joint=joint,
        nodes=nodes,
        points=numbering[nodes],
        normal_force=pressure.force[nodes],
        area=pressure.area[nodes],
        directions=directions[slips],
        other=None if other is None else other[slips],
        held_nodes=still,
        held_force=float(pressure.force[still].sum()),
        held_area=float(pressure.area[still].sum()),
        bolt_shares=pressure.bolt_shares,
    )


def _interpolation(
    structure: PlateStructure, joint: PlateJoint, nodes: IntArray
) -> sparse.csr_array:
    """Values of the other body at contact nodes from those of its nodes."""
    plate, points = structure.plate, structure.nodes[nodes]
    against = str(joint.against)
    if nodes.size == 0:
        return sparse.csr_array((0, structure.n_nodes))
    if joint.kind == "region":
        located = locate(plate.mesh, plate.regions[against], points)
    else:
        located = locate_on_edges(plate.mesh, plate.boundaries[against], points)
    outside = (located.element < 0) | (located.distance > located.allowed)
    if np.any(outside):
        worst = int(np.argmax(np.where(outside, located.distance, -1.0)))
        raise InputError(
            f"{joint.label}: {np.count_nonzero(outside)} of its {nodes.size} pressed nodes do "
            f"not overlap with {against!r}; the farthest, at {_place(structure, nodes[worst])}, is "
            f"about {located.distance[worst]:.3g} m from it; the pressed part must lie inside the "
            "part it is pressed against: split the mesh where the overlap ends, or exchange both"
        )
    return interpolation(
        plate.mesh,
        structure.element,
        structure.element_nodes,
        structure.nodes,
        points,
        located,
    )


def _check_shared(structure: PlateStructure, patches: Sequence[Patch], new: Patch) -> None:
    """Refuse contact points shared with another joint whose law or slip is not the same."""
    for patch in patches:
        shared, mine, old = np.intersect1d(new.nodes, patch.nodes, return_indices=True)
        if shared.size == 0:
            continue
        same = patch.joint.beta == new.joint.beta and patch.joint.kind == new.joint.kind
        same = same and (patch.other is None) == (new.other is None)
        if same:
            same = np.allclose(patch.directions[old], new.directions[mine], atol=SMALL)
        if same and patch.other is not None and new.other is not None:
            same = bool(abs(patch.other[old] - new.other[mine]).max() < SMALL)
        if not same:
            raise InputError(
                f"{new.joint.label} shares a node, at {_place(structure, shared[0])}, with "
                f"{patch.joint.label} of another law, beta, slip direction or body; give both "
                "the same, or leave an element between them"
            )
