"""Pressures of a face that may touch another one, with an unknown at each corner of its elements.

Corners are those of the element faces, for displacements of first and of second order. With the
hat phi_c of a corner and a function psi_c of the same integral, the pressure p, the force F_c and
the mean gap g_c of the corner are

    p = sum_c p_c psi_c,    F_c = p_c integral phi_c,    g_c = integral psi_c g / integral phi_c,

so that forces do work on gaps (mortar method; Wohlmuth, Acta Numerica 20, 2011). For first order
psi_c = phi_c. For second order psi_c is the dual function, a sum of the hats of each element face
with integral psi_c phi_d = 0 for all other corners d: F_c = integral p phi_c then, and p_c is the
mean of the pressure p over the hat. Both sum to 1, so that an even pressure stays even.

Quadratic displacements with pressures at the corners are a stable pair. With pressures at all their
nodes they are not: such pressures swing between corners and the nodes between them, on finer meshes
too. A washer of radius 4.5 to 12 mm on a plate, elements of 1.75 mm, against a fine mesh: pressures
at all nodes err by 11 to 13 % in the mean square where meshes match and by 34 to 54 % where they do
not, those of dual functions by 8 to 11 %, and these never rise outwards. Hats as psi_c err by 8 to
13 % there, but swing by 14 % with elements of 2 to 4 mm, and they open the corners at the edge of
the contact too soon, because gaps in the whole of their elements count.

Friction acts at all nodes of the face. A node i has the normal force N_i = p(x_i) integral phi_i of
the pressure that is linear between the p_c, with the hat phi_i of the sub-cells between the nodes.
As phi_c is the sum of hats phi_i with its values at the nodes, these forces sum to those of the
corners, to round-off. They are nowhere negative, and those of first order are the F_c.

On faces whose meshes do not match, both bodies are evaluated at the same quadrature points, so that
forces and moments balance to round-off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.slips import rows_along, unit_vectors
from skfem_joint.structure.clamps import PARALLEL
from skfem_joint.structure.joints import Joint
from skfem_joint.structure.nodes import Nodes, feet, values_in
from skfem_joint.structure.patch import manifold_of
from skfem_joint.structure.pressure import hat_simplices, measure


@dataclass(frozen=True)
class PressureSpace:
    """Pressures of the face of a joint, which may touch the other body or a rigid base.

    With forces F >= 0 of the q corners, contact acts on the displacements with ``-N.T @ F``, its
    mean gaps are ``gap - N @ u``, and the normal forces of the k nodes are ``G @ F``.

    Attributes
    ----------
    corners : ndarray of int, shape (q,)
        Nodes of the body at the corners whose hats lie over the other face, at least in part.
    N : sparse array, shape (q, dim N)
        Mean motion towards the other body at each corner, weighted by psi_c; of a unit motion it
        is 1. With second order weights of both signs occur.
    area : ndarray, shape (q,)
        Integral of each hat over the part that lies over the other face, m2.
    gap : ndarray, shape (q,)
        Mean initial gap at each corner, with the same weights, m.
    nodes : ndarray of int, shape (k,)
        Nodes of the body that lie over the other face.
    node_area : ndarray, shape (k,)
        Area of each node, m2, ``G @ area``: the integral of its hat over the part that lies over
        the other face, and its share of nodes that do not lie over it.
    G : sparse array, shape (k, q)
        Normal forces of the nodes from those of the corners; no entry is negative, and columns
        sum to 1.
    integrals : sparse array, shape (k, q)
        Integrals of the pressure p over the hats of the nodes from the forces of the corners. With
        second order entries of both signs occur.
    at_nodes : sparse array, shape (k, q)
        Values at the nodes from those at the corners, linear between corners; rows sum to 1.
    other : sparse array, shape (k, nodes of the body), or None
        Displacement of the other body opposite to the nodes; None on a rigid base.
    """

    corners: IntArray
    N: sparse.csr_array
    area: FloatArray
    gap: FloatArray
    nodes: IntArray
    node_area: FloatArray
    G: sparse.csr_array
    integrals: sparse.csr_array
    at_nodes: sparse.csr_array
    other: sparse.csr_array | None

    def normal_force(self, force: FloatArray) -> FloatArray:
        """Normal forces (k,) of the nodes, N, from those of the corners (q,), where it is closed.

        As ``G @ force``, but nodes at the edge of the contact are open, and the closed nodes of the
        same hats bear their share. Open is a node beside a corner without force, and one around
        which the pressure p does not press in the mean. A corner has a force as soon as contact
        reaches into its elements. Of a pressure that falls linearly along a line the mean around
        the corner is positive if, and only if, contact reaches the corner itself.
        """
        around = self.integrals @ force
        is_open = around <= 1e-9 * np.abs(around).max()
        is_open |= self.at_nodes @ (force == 0.0).astype(float) > 0.0
        borne = sparse.csr_array(sparse.diags_array(1.0 * ~is_open) @ self.G)
        left = borne.sum(axis=0)
        none = left == 0.0  # the corner is open, or all nodes of its hat are
        there = borne @ np.where(none, 0.0, force / np.where(none, 1.0, left))
        return np.asarray(there + self.G @ np.where(none, force, 0.0))


def pressure_space(
    body: Nodes, joint: Joint, width: FloatArray, thickness: FloatArray
) -> PressureSpace | None:
    """Pressures of a joint; None where cells lie on their base, across which nothing moves.

    A node takes part if a place opposite to it lies within the length of an element, and a corner
    if a node within its hat does. Where the other face ends inside a hat, integrals run over the
    part that is covered, and what a node beyond the end would bear is borne by the other nodes of
    the hat, in the ratio of their own shares.

    Parameters
    ----------
    body : Nodes
    joint : Joint
        On a boundary; its ``pressure`` does not matter.
    width, thickness : ndarray, shape (elements,)
        m.

    Raises
    ------
    InputError
        If no node lies over the other face.
    """
    where = joint.label
    cells, beside, depth, normals = manifold_of(body, joint.on, width, thickness, where)
    if normals is None:
        return None
    own = np.unique(cells)
    _, beyond, other = _opposite(body, joint, body.nodes[own], normals[own])
    points = _Points.of(body, joint, cells, beside, depth, normals)
    node_area = points.hats @ points.weight
    over = ~np.isnan(beyond) & (node_area[own] > 0.0)
    if not over.any():
        raise InputError(
            f"{where}: no node of it lies over {joint.against!r}, or as near as elements are "
            "long; are these the faces that touch?"
        )
    nodes = own[over]
    shares = sparse.csr_array(sparse.diags_array(node_area[nodes]) @ body.from_vertices[nodes])
    corners = np.unique(shares.indices)
    tests = points.tests(body, joint)[corners]
    area, borne = tests.sum(axis=1), shares[:, corners]
    G = sparse.csr_array(borne @ sparse.diags_array(1.0 / borne.sum(axis=0)))
    mean = sparse.csr_array(sparse.diags_array(1.0 / area) @ tests)
    integrals = sparse.csr_array(points.hats[nodes] @ mean.T)
    return PressureSpace(
        corners=corners,
        N=sparse.csr_array(mean @ points.motion),
        area=area,
        gap=mean @ points.gap,
        nodes=nodes,
        node_area=G @ area,
        G=G,
        integrals=integrals,
        at_nodes=sparse.csr_array(body.from_vertices[nodes][:, corners]),
        other=None if other is None else sparse.csr_array(other[over]),
    )


@dataclass(frozen=True)
class _Points:
    """Quadrature points of a face.

    Attributes
    ----------
    hats : sparse array, shape (nodes, k)
        Hats of the nodes.
    weight : ndarray, shape (k,)
        m2; 0 where there is no opposite face.
    motion : sparse array, shape (k, dim N)
        Motion towards the other body.
    gap : ndarray, shape (k,)
        Initial gap, m.
    parent : ndarray of int, shape (k,)
        Sub-cell in which each lies.
    """

    hats: sparse.csr_array
    weight: FloatArray
    motion: sparse.csr_array
    gap: FloatArray
    parent: IntArray

    @staticmethod
    def of(
        body: Nodes,
        joint: Joint,
        cells: IntArray,
        beside: IntArray,
        depth: FloatArray,
        normals: FloatArray,
    ) -> _Points:
        """Points in the sub-cells of a joint; arguments are as from `manifold_of`."""
        corners, gather, parent = hat_simplices(body.nodes, cells)
        places, weights = _quadrature(corners.shape[1])
        x = np.einsum("qc,ncd->nqd", places, corners).reshape(-1, body.dim)
        points, count = np.arange(len(x)).reshape(len(corners), -1), corners.shape[1]
        corner = np.arange(corners.shape[0] * count).reshape(len(corners), 1, count)
        rows, columns, values = np.broadcast_arrays(corner, points[..., np.newaxis], places)
        entries = values.ravel(), (rows.ravel(), columns.ravel())
        hats = gather @ sparse.csr_array(entries, shape=(corner.size, len(x)))
        n, gap, values_there = _opposite(body, joint, x, unit_vectors(hats.T @ normals))
        weight = np.outer(measure(corners) * depth[parent], weights).ravel()
        parent = np.repeat(parent, points.shape[1])
        relative = values_in(body, beside[parent], x, np.zeros(len(x)))[0]
        if values_there is not None:
            relative = relative - values_there
        motion = rows_along(np.arange(len(x)), n, len(x)) @ sparse.kron(
            relative, sparse.eye_array(body.dim)
        )
        return _Points(
            hats=sparse.csr_array(hats),
            weight=np.where(np.isnan(gap), 0.0, weight),
            motion=sparse.csr_array(motion),
            gap=np.nan_to_num(gap),
            parent=parent,
        )

    def tests(self, body: Nodes, joint: Joint) -> sparse.csr_array:
        """Functions of the vertices that weight gaps, times weights, (vertices, k), m2.

        They are the hats themselves for first order, and on element faces that lie over the other
        face in part only; elsewhere dual functions.
        """
        hats = sparse.csc_array(body.from_vertices.T @ self.hats)
        if body.mesh.order == 1:
            return sparse.csr_array(hats @ sparse.diags_array(self.weight))
        hats.sort_indices()
        facet = body.facet_cells(body.mesh.boundaries[joint.on])[1][self.parent]
        values = hats.data.reshape(facet.size, -1)  # points lie inside: each has all corners
        sums = sparse.csr_array((self.weight, (facet, np.arange(facet.size))))
        products = values[:, :, np.newaxis] * values[:, np.newaxis]
        count = values.shape[1]
        mass = (sums @ products.reshape(facet.size, -1)).reshape(-1, count, count)
        whole = np.bincount(facet, self.weight == 0.0) == 0.0
        dual = np.broadcast_to(np.eye(count), mass.shape).copy()
        dual[whole] = mass[whole].sum(axis=2, keepdims=True) * np.linalg.inv(mass[whole])
        data = np.einsum("kab,kb,k->ka", dual[facet], values, self.weight)
        return sparse.csr_array(
            sparse.csc_array((data.ravel(), hats.indices, hats.indptr), shape=hats.shape)
        )


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
    body: Nodes, joint: Joint, x: FloatArray, normal: FloatArray
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
    apart = distance > 1e-9 * body.mesh.size  # else round-off
    opposite = np.abs(signed) > PARALLEL * distance
    n = np.where((apart & opposite)[:, np.newaxis], np.sign(signed)[:, None] * unit_vectors(way),
                 normal)  # fmt: skip
    gap = np.where(apart, np.where(opposite, np.sign(signed) * distance, np.nan), 0.0)
    none = np.isnan(distance)
    gap[none] = np.nan
    return n, gap, values_in(body, element, foot, np.where(none, np.inf, 0.0))[0]
