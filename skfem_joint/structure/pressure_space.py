"""Pressures of a face that may touch another one, as sums of hats of its corners.

The displacements of a face are of first or second order. Its pressure is continuous and linear
between the corners of the element faces, for both orders: with the hat psi_c of a corner,

    p = sum_c p_c psi_c,    F_c = p_c integral psi_c,    g_c = integral psi_c g / integral psi_c.

The forces F_c of the corners do work on the mean gaps g_c (mortar method; Wohlmuth, Acta Numerica
20, 2011). Quadratic displacements with linear pressures are a stable pair. With pressures of all
nodes of second order they are not: pressures swing between corners and the nodes between them, and
do so on finer meshes too.

Friction acts at all nodes of the face. A node i has the normal force N_i = p(x_i) integral phi_i
with the linear hat phi_i of the sub-cells between the nodes. As psi_c is taken as the sum of hats
phi_i that has its values at the nodes, these forces sum to those of the corners, to round-off. They
are positive where pressures are, zero at corners that are open, and even for an even pressure. For
first order the corners are the nodes, and N = F.

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
from skfem_joint.structure.body import Body
from skfem_joint.structure.clamps import PARALLEL
from skfem_joint.structure.joints import Joint
from skfem_joint.structure.nodes import feet, values_in
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
        Mean motion towards the other body over the hat of each corner.
    area : ndarray, shape (q,)
        Integral of each hat over the part that lies over the other face, m2.
    gap : ndarray, shape (q,)
        Mean initial gap over each hat, m.
    nodes : ndarray of int, shape (k,)
        Nodes of the body that lie over the other face.
    node_area : ndarray, shape (k,)
        Integral of the hat of each node over the part that lies over the other face, m2.
    G : sparse array, shape (k, q)
        Normal forces of the nodes from those of the corners; no entry is negative, and columns
        sum to 1.
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
    at_nodes: sparse.csr_array
    other: sparse.csr_array | None


def pressure_space(body: Body, joint: Joint) -> PressureSpace | None:
    """Pressures of a joint; None where cells lie on their base, across which nothing moves.

    A node takes part if a place opposite to it lies within the length of an element, and a corner
    if a node within its hat does. Where the other face ends inside a hat, integrals run over the
    part that is covered, and what a node beyond the end would bear is borne by the other nodes of
    the hat, in the ratio of their own shares.

    Parameters
    ----------
    body : Body
    joint : Joint
        On a boundary; its ``pressure`` does not matter.

    Raises
    ------
    InputError
        If no node lies over the other face.
    """
    p, where = body.properties, joint.label
    cells, beside, depth, normals = manifold_of(body, joint.on, p["width"], p["thickness"], where)
    if normals is None:
        return None
    hats, motion, gap = _integrals(body, joint, cells, beside, depth, normals)
    own = np.unique(cells)
    _, beyond, other = _opposite(body, joint, body.nodes[own], normals[own])
    area = np.asarray(hats.sum(axis=1)).ravel()
    over = ~np.isnan(beyond) & (area[own] > 0.0)
    if not over.any():
        raise InputError(
            f"{where}: no node of it lies over {joint.against!r}, or as near as elements are "
            "long; are these the faces that touch?"
        )
    nodes = own[over]
    shares = sparse.csr_array(sparse.diags_array(area[nodes]) @ body.from_vertices[nodes])
    corners = np.unique(shares.indices)
    borne = shares[:, corners]
    whole = sparse.csr_array(body.from_vertices[:, corners].T) @ hats
    inverse = sparse.diags_array(1.0 / np.asarray(whole.sum(axis=1)).ravel())
    return PressureSpace(
        corners=corners,
        N=sparse.csr_array(inverse @ (whole @ motion)),
        area=np.asarray(whole.sum(axis=1)).ravel(),
        gap=inverse @ (whole @ gap),
        nodes=nodes,
        node_area=area[nodes],
        G=sparse.csr_array(borne @ sparse.diags_array(1.0 / np.asarray(borne.sum(axis=0)).ravel())),
        at_nodes=sparse.csr_array(body.from_vertices[nodes][:, corners]),
        other=None if other is None else sparse.csr_array(other[over]),
    )


def _integrals(
    body: Body,
    joint: Joint,
    cells: IntArray,
    beside: IntArray,
    depth: FloatArray,
    normals: FloatArray,
) -> tuple[sparse.csr_array, sparse.csr_array, FloatArray]:
    """Integrals over a face by quadrature at k points, where it lies over the other face.

    Returns
    -------
    hats : sparse array, shape (nodes, k)
        Hats of the nodes times the weights of the points, m2; 0 where there is no opposite face.
    motion : sparse array, shape (k, dim N)
        Motion towards the other body.
    gap : ndarray, shape (k,)
        Initial gap, m.
    """
    dim = body.dim
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
    hats = hats @ sparse.diags_array(np.where(np.isnan(gap), 0.0, weight))
    own_element = np.repeat(beside[parent], points.shape[1])
    relative = values_in(body, own_element, x, np.zeros(len(x)))[0]
    if values_there is not None:
        relative = relative - values_there
    normal = rows_along(np.arange(len(x)), n, len(x))
    motion = normal @ sparse.kron(relative, sparse.eye_array(dim))
    return sparse.csr_array(hats), sparse.csr_array(motion), np.nan_to_num(gap)


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
