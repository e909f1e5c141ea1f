"""Preload: the pressure that clamping bolts give to joints, from a static contact problem.

Clamp forces act as equal and opposite loads. Contact is frictionless and unilateral: with the
pressure p and the gap g = g0 - n . (u - u_other) of each pressed face, the displacement is

    argmin 1/2 u K u - f u    with    g >= 0,    and then    p >= 0,    p g = 0.

The pressure is a sum of the linear hats of the sub-cells between the displacement nodes, and the
gap is closed in the mean over each hat (mortar method; Wohlmuth, Acta Numerica 20, 2011). Its
forces are consistent with the elements: an even pressure stays even, also in elements of second
order, whose nodal forces would have other signs. On faces whose meshes do not match, both bodies
are evaluated at the same quadrature points, so that forces and moments balance to round-off. The
nodes that touch are determined by an active set method, :mod:`skfem_joint.structure.active_set`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.errors import InputError
from skfem_joint.slips import rows_along, unit_vectors
from skfem_joint.structure import active_set
from skfem_joint.structure.active_set import UnilateralContact
from skfem_joint.structure.body import Body
from skfem_joint.structure.clamps import PARALLEL, Clamp, clamp_forces
from skfem_joint.structure.joints import PRELOAD, Joint
from skfem_joint.structure.nodes import feet, values_in
from skfem_joint.structure.patch import Pressed, manifold_of
from skfem_joint.structure.pressure import hat_simplices, measure
from skfem_joint.structure.rigid import body_label, body_motions, combinations_left_free
from skfem_joint.unknowns import selection, stacked


@dataclass(frozen=True)
class Preload:
    """Static solution of a structure under its clamp forces.

    Attributes
    ----------
    displacement : ndarray, shape (N, dim)
        m; without the rigid motions that neither supports nor contact determine.
    force : ndarray, shape (N, dim)
        Clamp forces, N.
    joints : tuple of Pressed or None
        Normal forces of each joint; None where its pressure is given.
    active_sets : int
        Sets of touching nodes that were tried.
    seconds : float
        Duration of the computation, s.
    """

    displacement: FloatArray
    force: FloatArray
    joints: tuple[Pressed | None, ...]
    active_sets: int
    seconds: float

    def sentences(self, joints: Sequence[Joint], bolts: Sequence[Clamp]) -> Iterator[str]:
        """What a description says about the preload of these joints by these bolts."""
        moved = float(np.linalg.norm(self.displacement, axis=1).max())
        plural = "s" if len(bolts) > 1 else ""
        yield (
            f"Preload by {len(bolts)} bolt{plural}, at rest and without friction: contact found in "
            f"{self.active_sets} steps and {self.seconds:.3g} s, largest displacement "
            f"{moved:.4g} m."
        )
        for joint, pressed in zip(joints, self.joints, strict=True):
            if pressed is not None:
                touches, area = pressed.force > 0.0, float(pressed.area.sum())
                touching = float(pressed.area[touches].sum())
                peak = float((pressed.force[touches] / pressed.area[touches]).max())
                yield (
                    f"Joint {joint.name} is pressed by {pressed.force.sum():.6g} N: "
                    f"{touching:.4g} of {area:.4g} m2 touch, {100.0 * touching / area:.3g} %; "
                    f"peak pressure {peak:.4g} Pa, mean of what touches "
                    f"{pressed.force.sum() / touching:.4g} Pa, largest gap "
                    f"{pressed.gap.max():.3g} m."
                )


def preload(
    body: Body, held: BoolArray, joints: Sequence[Joint], bolts: Sequence[Clamp]
) -> Preload:
    """Pressures of the joints that clamping bolts press, by a static frictionless contact problem.

    The initial gap between the faces is that of the mesh, along the shortest way from the pressed
    face to the other. Nodes without an opposite face within the length of an element never touch.
    Joints whose pressure is given stay closed. Rigid motions that neither supports nor contact
    determine do not matter, because clamp forces are in equilibrium by themselves.

    Parameters
    ----------
    body : Body
    held : ndarray of bool, shape (N, dim)
        Displacements that supports hold.
    joints : sequence of Joint
    bolts : sequence of Clamp

    Raises
    ------
    InputError
        If a clamp force pulls, pushes a body away, or leaves a joint without contact.
    ConvergenceError
        If the search for the touching nodes does not end.
    """
    begin, (_, K) = time.perf_counter(), body.matrices()
    clamps = (clamp_forces(body, bolt, f"bolt[{i}]") for i, bolt in enumerate(bolts))
    force = np.sum([*clamps], axis=0)
    every = ((i, _Face.of(body, joint)) for i, joint in enumerate(joints))
    faces = {i: face for i, face in every if face is not None}
    G = stacked([face.rows for face in faces.values()], force.size)
    area, gap, tied = (
        np.concatenate([getattr(face, name) for face in faces.values()])
        for name in ("area", "gap", "tied")
    )
    free, left_out = _moving(body, held, G, area, force)
    u = np.zeros(force.size)
    contact = UnilateralContact(K[free][:, free], G[:, free], area, gap, tied, force.ravel()[free])
    u[free], p, count = contact.solve()
    u -= left_out @ linalg.lstsq(left_out, u)[0]
    left = (gap - G @ u) / area
    touching = p > active_set.SETTINGS.round_off * p.max(initial=0.0)
    ends = np.cumsum([face.nodes.size for face in faces.values()])[:-1]
    parts = zip(faces.items(), *(np.split(x, ends) for x in (p, left, touching)), strict=True)
    pressed: list[Pressed | None] = [None] * len(joints)
    for (i, face), *values in parts:
        if not face.tied.any():
            pressed[i] = face.pressed(body.n_nodes, *values)
    seconds = time.perf_counter() - begin
    return Preload(u.reshape(force.shape), force, tuple(pressed), count, seconds)


def _moving(
    body: Body, held: BoolArray, G: Matrix, area: FloatArray, force: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Displacements (dim N,) to be solved for, and motions (dim N, k) that nothing determines.

    Displacements that supports hold are not solved for, and neither is an additional displacement
    for each rigid motion that supports and closed contact leave. That is a statically determinate
    support, on which loads in equilibrium give no reaction.
    """
    motions = body_motions(body)
    flat = motions.reshape(force.size, -1)
    loose = combinations_left_free([motions[held], (G @ flat) / area[:, np.newaxis]])
    free = ~held.ravel()
    modes = flat @ loose
    if loose.shape[1]:
        push = force.ravel() @ modes
        # Clamp forces may push such bodies a little: surfaces are seldom quite opposite.
        if np.abs(push).max() > 0.01 * np.abs(force).sum() * np.abs(modes).max():
            moved = np.abs(modes @ push).reshape(body.n_nodes, -1).max(axis=1)
            pushed = body_label(body.mesh, int(body.body_of_node[moved.argmax()]))
            raise InputError(
                f"bolt: the clamp forces push {pushed} where neither a "
                "support nor contact holds it; head and nut must press straight across a joint"
            )
        modes[~free] = 0.0
        free[linalg.qr(modes.T, mode="r", pivoting=True)[1][: loose.shape[1]]] = False
    return free, modes


@dataclass(frozen=True)
class _Face:
    """The pressed face of a joint, which may touch the other body or the base.

    Attributes
    ----------
    joint : Joint
    nodes : ndarray of int, shape (m,)
        Displacement nodes that lie over the other face.
    rows : sparse array, shape (m, dim N)
        Integrals of hats times motion towards the other body, m2.
    area : ndarray, shape (m,)
        Integral of each hat over the part that lies over the other face, m2.
    gap : ndarray, shape (m,)
        Integrals of hats times the initial gap, m3.
    other : sparse array, shape (m, N), or None
        Displacement of the other body opposite to the nodes.
    """

    joint: Joint
    nodes: IntArray
    rows: sparse.csr_array
    area: FloatArray
    gap: FloatArray
    other: sparse.csr_array | None

    @property
    def tied(self) -> BoolArray:
        """Whether contact stays closed because its pressure is given, (m,)."""
        return np.full(self.nodes.size, self.joint.pressure != PRELOAD)

    @staticmethod
    def of(body: Body, joint: Joint) -> _Face | None:
        """Face of a joint; None where cells lie on their base, across which nothing moves."""
        p, dim = body.properties, body.dim
        where = joint.label
        cells, beside, depth, normals = manifold_of(
            body, joint.on, p["width"], p["thickness"], where
        )
        if normals is None:
            return None
        corners, gather, parent = hat_simplices(body.nodes, cells)
        places, weights = _quadrature(corners.shape[1])
        x = np.einsum("qc,ncd->nqd", places, corners).reshape(-1, dim)
        points, count = np.arange(len(x)).reshape(len(corners), -1), corners.shape[1]
        corner = np.arange(corners.shape[0] * count).reshape(len(corners), 1, count)
        rows, columns, values = np.broadcast_arrays(corner, points[..., np.newaxis], places)
        entries = values.ravel(), (rows.ravel(), columns.ravel())
        hats = gather @ sparse.csr_array(entries, shape=(corner.size, len(x)))
        n, gap, values_there = _opposite(body, joint, x, unit_vectors(hats.T @ normals))
        weight = np.outer(measure(corners) * depth[parent], weights).ravel()
        hats = sparse.csr_array(hats @ sparse.diags_array(np.where(np.isnan(gap), 0.0, weight)))
        own = np.unique(cells)
        _, beyond, other = _opposite(body, joint, body.nodes[own], normals[own])
        area = np.asarray(hats.sum(axis=1)).ravel()[own]
        over = ~np.isnan(beyond) & (area > 0.0)
        if not over.any():
            raise InputError(
                f"{where}: no node of it lies over {joint.against!r}, or as near as elements are "
                "long; are these the faces that touch?"
            )
        nodes, hats = own[over], hats[own[over]]
        own_element = np.repeat(beside[parent], points.shape[1])
        relative = values_in(body, own_element, x, np.zeros(len(x)))[0]
        if values_there is not None:
            relative = relative - values_there
        normal = rows_along(np.arange(len(x)), n, len(x))
        motion = normal @ sparse.kron(relative, sparse.eye_array(dim))
        other = None if other is None else sparse.csr_array(other[over])
        gap = hats @ np.nan_to_num(gap)
        return _Face(joint, nodes, sparse.csr_array(hats @ motion), area[over], gap, other)

    def pressed(
        self, n_nodes: int, pressure: FloatArray, gap: FloatArray, touches: BoolArray
    ) -> Pressed:
        """Normal forces of the joint at all nodes, from values at the nodes of the face."""
        if not touches.any():
            raise InputError(
                f"{self.joint.label}: the preload leaves no contact, it opens everywhere; do the "
                "bolts press elsewhere?"
            )
        at = selection(self.nodes, n_nodes).T
        force = np.where(touches, pressure * self.area, 0.0)
        other = None if self.other is None else sparse.csr_array(at @ self.other)
        return Pressed(at @ force, at @ self.area, at @ gap, other)


def _quadrature(corners: int) -> tuple[FloatArray, FloatArray]:
    """Quadrature points in a segment or triangle, and weights that sum to 1.

    The points (points, corners) are given by their hats. The rule is exact for products of hats
    and shape functions of a quadrilateral of second order.
    """
    from skfem.quadrature import get_quadrature
    from skfem.refdom import RefLine, RefTri

    x, weights = get_quadrature(RefLine if corners == 2 else RefTri, 5)
    return np.vstack([1.0 - x.sum(axis=0), x]).T, weights / weights.sum()


def _opposite(
    body: Body, joint: Joint, x: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray, sparse.csr_array | None]:
    """Opposite body at points ``x`` (k, dim) of a pressed face with a ``normal`` (k, dim).

    Returns the direction (k, dim) to the other face, the gap (k,), m, which is NaN where there is
    no opposite face, and the displacement (k, N) of the other body there from that of its nodes.
    """
    if joint.against is None:
        return normal, np.zeros(len(x)), None
    mesh = body.mesh.mesh
    ends = mesh.p[:, mesh.facets[:, body.mesh.boundaries[joint.on]]]
    element, foot = feet(body, joint.against, x, float(np.ptp(ends, axis=1).max()))
    way = foot - x
    distance = np.linalg.norm(way, axis=1)
    signed = np.einsum("kd,kd->k", way, normal)
    apart = distance > 1e-9 * body.size  # else round-off
    opposite = np.abs(signed) > PARALLEL * distance
    n = np.where((apart & opposite)[:, np.newaxis], np.sign(signed)[:, None] * unit_vectors(way),
                 normal)  # fmt: skip
    gap = np.where(apart, np.where(opposite, np.sign(signed) * distance, np.nan), 0.0)
    none = np.isnan(distance)
    gap[none] = np.nan
    return n, gap, values_in(body, element, foot, np.where(none, np.inf, 0.0))[0]
