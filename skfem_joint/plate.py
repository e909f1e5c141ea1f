"""A jointed plate or several: materials, supports and joints, assembled to a system.

The unknowns are chosen so that every row of the slip operator picks one of them. A displacement
of all nodes is ``T`` times the unknowns: supports are left out; a node pressed on a rigid base
has its slip; a node pressed on another body has its slip against that body as its own unknown, its
displacement being slip plus what the other body does there. Forces on the other body then follow
from ``T`` transposed, equal and opposite and along the same line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.bolts import Bolts
from skfem_joint.errors import InputError
from skfem_joint.forms import plate_mass, plate_stiffness, unit_load
from skfem_joint.loads import Load
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
from skfem_joint.system import AppliedLoad, System

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

#: Plane states: thin plate in its plane, and slice of a body long across the plane.
PLANES = ("stress", "strain")
#: Directions a support can hold.
SUPPORTS = ("xy", "x", "y")

_KINDS = ("region", "boundary", "point")
_PLURALS = {"region": "regions", "boundary": "boundaries", "point": "points"}
_LARGEST_TURN = 30.0  # degrees between two edges of a boundary that slips
_SMALL = 1e-9


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

        return Basis(self.plate.mesh, self.element, intorder=self._quadrature)

    @property
    def _quadrature(self) -> int:
        # Exact for the mass of triangles, and of quadrilaterals of any shape.
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
                R = R + _selection(patch.nodes[new], self.n_nodes).T @ patch.other[new]
        return sparse.csr_array(sparse.kron(R, sparse.eye_array(2)))

    def expand(self, u: FloatArray) -> FloatArray:
        """Displacement of all nodes, (..., N, 2), from that of the unknowns, (..., n)."""
        flat = (self.T @ u.reshape(-1, u.shape[-1]).T).T
        return np.asarray(flat).reshape(*u.shape[:-1], self.n_nodes, 2)


def _selection(columns: IntArray, n: int) -> sparse.csr_array:
    ones = np.ones(columns.size)
    return sparse.csr_array((ones, (np.arange(columns.size), columns)), shape=(columns.size, n))


def _label(joint: PlateJoint) -> str:
    return f"joint {joint.name!r}"


def _place(structure: PlateStructure, node: int) -> str:
    x, y = structure.nodes[node]
    return f"({x:.6g}, {y:.6g})"


def _pressure(structure: PlateStructure, joint: PlateJoint) -> NodalPressure:
    """Nodal normal forces and areas of a joint on all nodes."""
    plate = structure.plate
    if joint.kind == "region":
        inside = np.isin(structure.cell_element, plate.regions[joint.name])
        return region_pressure(
            structure.nodes, structure.cells[inside], joint.pressure, _label(joint)
        )
    if isinstance(joint.pressure, Bolts):
        raise InputError(
            f"{_label(joint)}: bolts press regions; a boundary needs a pressure in Pa, constant or "
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
            structure.nodes, structure._edges(joint.name), _LARGEST_TURN, _label(joint)
        )
        stopped = np.any(held & (np.abs(tangents[nodes]) > _SMALL), axis=1)
        directions[:, 0] = np.where(stopped[:, None], 0.0, tangents[nodes])
        directions = directions[:, :1]
    other = None
    if joint.against is not None:
        if np.any(held):
            worst = nodes[np.flatnonzero(held.any(axis=1))]
            raise InputError(
                f"{_label(joint)}: {worst.size} of its nodes are supported, the first at "
                f"{_place(structure, worst[0])}; what is pressed against {joint.against!r} must be "
                "free to follow it: move the support off the joint, or exchange the pressed part "
                "and `against`"
            )
        other = _interpolation(structure, joint, nodes)
    slips = np.any(directions[:, 0] != 0.0, axis=1)
    if not np.any(slips) and nodes.size:
        raise InputError(
            f"{_label(joint)} has no free node: all its nodes are supported, nothing in it can "
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
            f"{_label(joint)}: {np.count_nonzero(outside)} of its {nodes.size} pressed nodes do "
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
            same = np.allclose(patch.directions[old], new.directions[mine], atol=_SMALL)
        if same and patch.other is not None and new.other is not None:
            same = bool(abs(patch.other[old] - new.other[mine]).max() < _SMALL)
        if not same:
            raise InputError(
                f"{_label(new.joint)} shares a node, at {_place(structure, shared[0])}, with "
                f"{_label(patch.joint)} of another law, beta, slip direction or body; give both "
                "the same, or leave an element between them"
            )


def build_plate_structure(
    plate: PlateMesh,
    *,
    E: float,
    poisson: float,
    density: float,
    thickness: float,
    supports: Sequence[tuple[str, str]],
    joints: Sequence[PlateJoint] = (),
    plane: str = "stress",
    stiffness_damping: float = 0.0,
    mass_damping: float = 0.0,
    regions: Mapping[str, Mapping[str, float]] | None = None,
) -> PlateStructure:
    """Structure with the same material and thickness everywhere but where ``regions`` says other.

    Parameters
    ----------
    plate : PlateMesh
    E, poisson, density, thickness : float
        Pa, dimensionless, kg/m3, m.
    supports : sequence of (name, directions)
        Boundary, region or point and "xy", "x" or "y".
    joints : sequence of PlateJoint
    plane : {"stress", "strain"}
    stiffness_damping, mass_damping : float
        s and 1/s.
    regions : mapping, optional
        ``{region: {"E": ..., "thickness": ...}}``: values that differ in a region.

    Raises
    ------
    InputError
        For values out of range, names that the mesh does not have or that are of another kind,
        joints or bodies that do not overlap, and bodies that nothing holds.
    """
    problems: list[str] = []
    n_elements = plate.mesh.t.shape[1]
    values = {"E": E, "poisson": poisson, "density": density, "thickness": thickness}
    fields = {name: np.full(n_elements, float(value)) for name, value in values.items()}
    for region, overrides in (regions or {}).items():
        problem = _wrong_name(plate, region, ("region",), f"regions.{region}")
        if problem:
            problems.append(problem)
            continue
        for name, value in overrides.items():
            if name not in fields:
                problems.append(
                    f"regions.{region}: unknown property {name!r}, must be one of "
                    f"{', '.join(fields)}"
                )
            else:
                fields[name][plate.regions[region]] = value
    for name, array in fields.items():
        if name == "poisson":
            good, allowed = (array > -1.0) & (array < 0.5), "between -1 and 0.5"
        else:
            good, allowed = (array > 0.0) & np.isfinite(array), "> 0"
        if not np.all(good):
            problems.append(f"{name}: found {array[~good][0]}, must be {allowed}")
    if plane not in PLANES:
        problems.append(f"plane: found {plane!r}, must be one of {', '.join(PLANES)}")
    for name, value in (("stiffness", stiffness_damping), ("mass", mass_damping)):
        if not (value >= 0.0 and np.isfinite(value)):
            problems.append(f"damping.{name}: found {value}, must be >= 0")
    for name, directions in supports:
        problem = _wrong_name(plate, name, _KINDS, "support")
        if problem:
            problems.append(problem)
        if directions not in SUPPORTS:
            problems.append(
                f"support {name!r}: found {directions!r}, must be one of {', '.join(SUPPORTS)}"
            )
    problems += _wrong_joints(plate, joints)
    if problems:
        raise InputError(problems)
    structure = PlateStructure(
        plate=plate,
        E=fields["E"],
        poisson=fields["poisson"],
        density=fields["density"],
        thickness=fields["thickness"],
        plane=plane,
        supports=tuple((name, directions) for name, directions in supports),
        joints=tuple(joints),
        stiffness_damping=stiffness_damping,
        mass_damping=mass_damping,
    )
    problems = _loose_bodies(structure)
    if problems:
        raise InputError(problems)
    _ = structure.T  # finds circles of bodies
    return structure


def _tables(plate: PlateMesh) -> dict[str, Mapping[str, Any]]:
    return {"region": plate.regions, "boundary": plate.boundaries, "point": plate.points}


def _wrong_name(plate: PlateMesh, name: str, kinds: Sequence[str], where: str) -> str | None:
    """What is wrong with a name that must be of one of the kinds."""
    tables = _tables(plate)
    found = [kind for kind in _KINDS if name in tables[kind]]
    right = [kind for kind in found if kind in kinds]
    needed = " or ".join([", ".join(kinds[:-1]), kinds[-1]] if len(kinds) > 1 else kinds)
    if len(right) == 1:
        if right[0] != "point" and len(tables[right[0]][name]) == 0:
            return f"{where}: the {right[0]} {name!r} is empty"
        return None
    if len(right) > 1:
        return (
            f"{where}: {name!r} is the name of a {' and of a '.join(right)}; rename one of them "
            "in the mesh"
        )
    if found:
        known = ", ".join(sorted(name for kind in kinds for name in tables[kind])) or "none"
        return (
            f"{where}: found {name!r}, which is a {found[0]}; a {needed} is needed; the mesh has: "
            f"{known}"
        )
    has = "; ".join(f"{_PLURALS[kind]} {', '.join(sorted(tables[kind])) or '-'}" for kind in _KINDS)
    return f"{where}: no {needed} named {name!r} in the mesh; it has: {has}"


def _wrong_joints(plate: PlateMesh, joints: Sequence[PlateJoint]) -> list[str]:
    """What is wrong with joints, as far as it can be told without their nodes."""
    problems: list[str] = []
    taken: dict[str, dict[int, str]] = {"region": {}, "boundary": {}}
    outer = set(plate.mesh.boundary_facets().tolist())
    for joint in joints:
        where = _label(joint)
        if joint.kind not in taken:
            problems.append(f"{where}: kind {joint.kind!r} must be region or boundary")
            continue
        if not (joint.friction >= 0.0 and np.isfinite(joint.friction)):
            problems.append(f"{where}: friction {joint.friction} must be >= 0")
        if not joint.beta > 0.0:
            problems.append(f"{where}: beta {joint.beta} must be > 0")
        if isinstance(joint.pressure, (int, float)) and not (
            joint.pressure >= 0.0 and np.isfinite(joint.pressure)
        ):
            problems.append(f"{where}: pressure {joint.pressure} must be >= 0")
        table = _tables(plate)[joint.kind]
        names = [joint.name] if joint.against is None else [joint.name, joint.against]
        wrong = [
            problem for name in names if (problem := _wrong_name(plate, name, (joint.kind,), where))
        ]
        problems += wrong
        if wrong:
            continue
        parts = [np.asarray(table[name]) for name in names]
        if joint.kind == "boundary":
            inner = [
                name
                for name, part in zip(names, parts, strict=True)
                if not outer.issuperset(part.tolist())
            ]
            problems += [
                f"{where}: {name!r} runs inside a body; a joint must be on its border"
                for name in inner
            ]
        if len(parts) == 2:
            of = [part if joint.kind == "region" else plate.mesh.f2t[0, part] for part in parts]
            both = np.intersect1d(plate.body[of[0]], plate.body[of[1]])
            if both.size:
                problems.append(
                    f"{where}: {joint.name!r} and {joint.against!r} belong to the same body; "
                    "a joint needs two bodies that do not share nodes"
                )
        others = sorted({taken[joint.kind][i] for i in parts[0].tolist() if i in taken[joint.kind]})
        if others:
            problems.append(f"{where} overlaps joint {', '.join(map(repr, others))}")
        taken[joint.kind].update(dict.fromkeys(parts[0].tolist(), joint.name))
    return problems


def _loose_bodies(structure: PlateStructure) -> list[str]:
    """Bodies left with a rigid motion by supports, closed contact and friction, in words."""
    bodies = int(structure.plate.body.max()) + 1
    position = structure.nodes - structure.nodes.mean(axis=0)
    position /= np.abs(position).max()
    motions = np.zeros((structure.n_nodes, 2, 3 * bodies))
    node, first = np.arange(structure.n_nodes), 3 * structure.body
    motions[node, 0, first] = 1.0
    motions[node, 1, first + 1] = 1.0
    motions[node, 0, first + 2] = -position[:, 1]
    motions[node, 1, first + 2] = position[:, 0]
    rows = [motions[structure.held]]
    for patch in structure.patches:
        relative = np.moveaxis(patch.relative(np.moveaxis(motions, 2, 0)), 0, -1)
        if patch.joint.kind == "boundary":
            tangent = patch.directions[:, 0]
            normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
            rows.append(np.einsum("kc,kcm->km", normal, relative))
        if patch.joint.friction > 0.0:
            held = np.einsum("kdc,kcm->kdm", patch.directions, relative)
            rows.append(held.reshape(-1, 3 * bodies))
    gram = sum(row.T @ row for row in rows)
    squares, vectors = np.linalg.eigh(gram / structure.n_nodes)
    loose = np.abs(vectors[:, squares < _SMALL**2 + 1e-13 * squares.max(initial=0.0)])
    moving = loose.reshape(bodies, -1).max(axis=1, initial=0.0) > 1e-6
    return [
        f"{_body_label(structure.plate, body)} is left unsupported: it can move or turn freely; "
        "hold it by a support, or by a joint with friction on a body that is held"
        for body in np.flatnonzero(moving).tolist()
    ]


def _body_label(plate: PlateMesh, body: int) -> str:
    """A body in words, after its regions if it has any."""
    own = [
        repr(name)
        for name, elements in sorted(plate.regions.items())
        if len(elements) and np.all(plate.body[elements] == body)
    ]
    if own:
        return f"the body with the region{'s' if len(own) > 1 else ''} {', '.join(own)}"
    if plate.body.max() == 0:
        return "the plate"
    x, y = plate.mesh.p[:, plate.mesh.t[:, plate.body == body]].mean(axis=(1, 2))
    return f"the body around ({x:.6g}, {y:.6g})"


def full_matrices(structure: PlateStructure) -> tuple[sparse.csr_array, sparse.csr_array]:
    """Mass and stiffness of all nodes before supports and contact, (2N, 2N) each, kg and N/m."""
    from skfem import Basis, ElementQuad0, ElementTriP0, ElementVector, asm

    mesh = structure.plate.mesh
    basis = Basis(mesh, ElementVector(structure.element), intorder=structure._quadrature)
    constant = basis.with_element(ElementTriP0() if mesh.t.shape[0] == 3 else ElementQuad0())
    nu = structure.poisson
    shear = structure.E / (2.0 * (1.0 + nu))
    # Plane strain has Lamé's first constant, plane stress that of no stress across.
    share = 1.0 - nu if structure.plane == "stress" else 1.0 - 2.0 * nu
    first = 2.0 * shear * nu / share
    K = asm(
        plate_stiffness(),
        basis,
        first=constant.interpolate(first * structure.thickness),
        second=constant.interpolate(shear * structure.thickness),
    )
    mass = structure.density * structure.thickness
    M = asm(plate_mass(), basis, mass_per_area=constant.interpolate(mass))
    return _symmetric(M), _symmetric(K)


def _symmetric(A: Any) -> sparse.csr_array:
    symmetric = sparse.csr_array(0.5 * (A + A.T))
    symmetric.eliminate_zeros()
    return symmetric


def assemble_plate(
    structure: PlateStructure,
    loads: Sequence[tuple[str, Sequence[float], Load]] = (),
    points: Sequence[str] | None = None,
) -> System:
    """Assemble the system of jointed plates.

    Parameters
    ----------
    structure : PlateStructure
    loads : sequence of (name, direction, load)
        Total force spread evenly over a boundary (per length) or region (per area), or at a point,
        along ``direction`` (2,), whose length does not count.
    points : sequence of str, optional
        Points, boundaries or regions to observe, the latter two by their mean; all points that
        can move if not given.

    Returns
    -------
    System
        Sparse; every row of ``B`` picks one unknown. Rows of ``P``: one named as each load, the
        displacement the load works on (a second load of the same name gets ".2" and so on), then
        "name.x" and "name.y" for what is observed.

    Raises
    ------
    InputError
        For unknown names, directions without length, and loads on what cannot move.
    """
    problems = [
        problem
        for name, where in [(on, "load") for on, _, _ in loads]
        + [(name, "points") for name in points or ()]
        if (problem := _wrong_name(structure.plate, name, _KINDS, where))
    ]
    for on, direction, _ in loads:
        vector = np.asarray(direction, dtype=float)
        if vector.shape != (2,) or not np.all(np.isfinite(vector)) or not np.any(vector):
            problems.append(
                f"load on {on!r}: direction {direction} must be two finite numbers, not both zero"
            )
    if problems:
        raise InputError(problems)

    T = structure.T
    applied: list[AppliedLoad] = []
    rows: list[FloatArray] = []
    names: list[str] = []
    for on, direction, load in loads:
        unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
        vector = T.T @ np.outer(_even_shares(structure, on), unit).ravel()
        if not np.any(vector):
            problems.append(
                f"load on {on!r}: a support holds it along {tuple(direction)}, a force there does "
                "nothing; load a free part"
            )
        earlier = sum(other == on for other, _, _ in loads[: len(applied)])
        name = on if earlier == 0 else f"{on}.{earlier + 1}"
        applied.append(AppliedLoad(vector, load, name))
        rows.append(vector)
        names.append(name)
    observed = points
    if observed is None:
        observed = [
            name for name, node in structure.plate.points.items() if T[[2 * node, 2 * node + 1]].nnz
        ]
    for name in dict.fromkeys(observed):
        shares = _even_shares(structure, name)
        both = [T.T @ np.outer(shares, unit).ravel() for unit in np.eye(2)]
        if not np.any(both):
            problems.append(f"points: {name!r} is supported and does not move")
        rows += both
        names += [f"{name}.x", f"{name}.y"]
    if problems:
        raise InputError(problems)

    M, K = (_symmetric(T.T @ A @ T) for A in full_matrices(structure))
    C = _symmetric(structure.stiffness_damping * K + structure.mass_damping * M)
    w, beta, directions, picked = _friction(structure)
    return System(
        M=M,
        C=C,
        K=K,
        B=_selection(picked, T.shape[1]),
        w=w,
        beta=beta,
        loads=tuple(applied),
        P=sparse.csr_array(np.reshape(rows, (len(rows), T.shape[1]))),
        points=tuple(names),
        directions=directions,
    )


def _friction(
    structure: PlateStructure,
) -> tuple[FloatArray, FloatArray, NDArray[np.int64], IntArray]:
    """Limit (m,), beta (m,) and directions (m,) of the contact points, unknowns (rows,) of B."""
    m = max((int(patch.points.max(initial=-1)) for patch in structure.patches), default=-1) + 1
    w, beta = np.zeros(m), np.ones(m)
    node = np.zeros(m, dtype=np.intp)
    for patch in structure.patches:
        w[patch.points] += patch.joint.friction * patch.normal_force
        beta[patch.points] = patch.joint.beta
        node[patch.points] = patch.nodes
    count = np.diff(structure.first_unknown)[node].astype(np.int64)
    point, which = np.nonzero(np.arange(2) < count[:, None])
    return w, beta, count, structure.first_unknown[node[point]] + which


def _even_shares(structure: PlateStructure, name: str) -> FloatArray:
    """Share (N,) of each node in a unit spread evenly over a boundary, a region or a point."""
    plate = structure.plate
    if name in plate.points:
        shares = np.zeros(structure.n_nodes)
        shares[plate.points[name]] = 1.0
        return shares
    if name in plate.regions:
        part = structure.basis.with_elements(plate.regions[name])
    else:
        from skfem import FacetBasis

        part = FacetBasis(
            plate.mesh,
            structure.element,
            facets=plate.boundaries[name],
            intorder=structure._quadrature,
        )
    shares = np.asarray(unit_load().assemble(part))
    # Shape functions of other nodes, and some of the second order, give round-off.
    shares[np.abs(shares) < 1e-12 * np.abs(shares).max()] = 0.0
    return np.asarray(shares / shares.sum())
