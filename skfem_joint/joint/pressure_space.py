"""Pressures of a face that may touch another one, at the nodes of its displacements.

The pressure is a sum of the linear hats phi_i of the sub-cells between the displacement nodes, for
displacements of first and of second order, and the gap is closed in the mean over each hat:

    p = sum_i p_i phi_i,    F_i = p_i integral phi_i,    g_i = integral phi_i g / integral phi_i,

so that forces do work on gaps (mortar method; Wohlmuth, Acta Numerica 20, 2011). An even pressure
stays even, also on elements of second order, whose nodal forces would have other signs.

For second order these pressures swing between the corners of elements and the nodes between them,
on finer meshes too: 43, 95, 78, 73, 65 MPa at a hole's edge where the mean falls evenly. What they
say of the extent of the contact, and of the force in each neighbourhood, is right. Limits of
constant friction are therefore made of their means over the hats psi_c of the corners:

    T_c = sum_i psi_c(x_i) F_i,    N_i = sum_c T_c psi_c(x_i) a_i / sum_j psi_c(x_j) a_j,

where a_i is the integral of phi_i: the forces under each hat are shared by areas among those of its
nodes that touch, or among all of them where none does. N = G F; the sum stays, no force becomes
negative, an even pressure stays even, and first order, whose nodes are the corners, stays as it is.

Where contact opens, the limit of a node is friction times its own force. Means over nodes that
touch at rest, or over all of them, let forces limit friction beside the contact, where faces slip
most. Two bolted plates of tetrahedra in a slow cycle, mJ, along at 30, 60, 90 % of slip and across
at 30 and 60 %: own forces 1.66, 8.86, 58.9 and 4.61; nodes that touch 1.61, 10.8, 74.1 and 5.47,
50.0; all nodes 2.97, 13.7, 69.3; CalculiX 1.69, 10.7, 61.3 and 5.62, 45.1.

Pressures at the corners alone, which do not swing either, were tried. They let contact reach a row
of elements too far: the first frequency of the Brake-Reuss beam is 147.4 Hz then, with elements of
half the size too, in place of 145.3, and two bolted plates lose 12.3 mJ in a slow cycle in place of
8.5.

On faces whose meshes do not match, both bodies are evaluated at the same quadrature points, so that
forces and moments balance to round-off.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from skfem_joint.body.nodes import Nodes, feet, values_in
from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.clamps import PARALLEL
from skfem_joint.joint.gaps import Resolution, gaps_at, is_relative, surfaces, without_plane
from skfem_joint.joint.joints import Joint
from skfem_joint.joint.manifold import Manifold, manifold_of
from skfem_joint.joint.pressure import hat_simplices, measure
from skfem_joint.mesh.cells import CONFORMING, spot
from skfem_joint.system.slips import rows_along, unit_vectors


@dataclass(frozen=True)
class PressureSpace:
    """Pressures of the face of a joint, which may touch the other body or a rigid base.

    With forces F >= 0 of the k nodes, contact acts on the displacements with ``-N.T @ F``, its
    mean gaps are ``gap + gap_scale given - N @ u``, and constant friction limits follow
    ``means(F) @ F``.

    Attributes
    ----------
    nodes : ndarray of int, shape (k,)
        Nodes of the body that lie over the other face.
    N : sparse array, shape (k, dim N)
        Mean motion towards the other body over the hat of each node; of a unit motion it is 1.
    area : ndarray, shape (k,)
        Integral of each hat over the part that lies over the other face, m2.
    gap : ndarray, shape (k,)
        Mean initial gap of the mesh over each hat, m.
    given : ndarray, shape (k,)
        Mean gap of the joint over each hat, m, without its factor ``gap_scale``.
    resolution : Resolution, optional
        How much of the joint's gap is in these means, where it is not the same everywhere.
    hats : sparse array, shape (k, corners)
        Values of the hats of the corners at the nodes; rows sum to 1.
    other : sparse array, shape (k, nodes of the body)
        Displacement of the other body opposite to the nodes; zero on a rigid base.
    """

    nodes: IntArray
    N: sparse.csr_array
    area: FloatArray
    gap: FloatArray
    given: FloatArray
    hats: sparse.csr_array
    other: sparse.csr_array
    resolution: Resolution | None = None

    def means(self, force: FloatArray) -> sparse.csr_array:
        """Means G of forces over the hats of corners, (k, k); columns sum to 1.

        ``force`` (k,) are forces at rest. What is under a hat is shared among its nodes that touch
        then, those with a force, or among all of them where none does.
        """
        shares = sparse.csr_array(sparse.diags_array(self.area) @ self.hats)
        touching = sparse.diags_array((force > 0.0).astype(np.float64)) @ shares
        bare = np.asarray(touching.sum(axis=0)).ravel() == 0.0
        shares = sparse.csr_array(touching + shares @ sparse.diags_array(bare.astype(np.float64)))
        whole = np.asarray(shares.sum(axis=0)).ravel()
        return sparse.csr_array(shares @ sparse.diags_array(1.0 / whole) @ self.hats.T)


def pressure_space(body: Nodes, joint: Joint) -> PressureSpace | None:
    """Pressures of a joint; None where cells lie on their base, across which nothing moves.

    A node takes part if a place opposite to it lies within the length of an element. Where the
    other face ends inside a hat, integrals run over the part that is covered.

    Parameters
    ----------
    body : Nodes
    joint : Joint
        On a boundary; its ``pressure`` does not matter.

    Raises
    ------
    InputError
        If no node lies over the other face, and what is wrong with the joint's gap there.
    """
    manifold = manifold_of(body, joint)
    if manifold.normals is None:
        return None
    own = np.unique(manifold.cells)
    _, beyond, other = _opposite(body, joint, body.nodes[own], manifold.normals[own])
    points = _FacePoints.of(body, joint, manifold, manifold.normals)
    node_area = points.hats @ points.weight
    over = ~np.isnan(beyond) & (node_area[own] > 0.0)
    if not over.any():
        raise InputError(
            f"{joint.label}: no node of it lies over {joint.against!r}, or as near as elements are "
            "long; are these the faces that touch?"
        )
    nodes = own[over]
    tests = sparse.csr_array(points.hats[nodes] @ sparse.diags_array(points.weight))
    area = np.asarray(tests.sum(axis=1)).ravel()
    mean = sparse.csr_array(sparse.diags_array(1.0 / area) @ tests)
    hats = body.from_vertices[nodes]
    given, resolution = _given_gap(joint, points, nodes, mean)
    return PressureSpace(
        nodes=nodes,
        N=sparse.csr_array(mean @ points.motion),
        area=area,
        gap=np.asarray(mean @ points.gap),
        given=given,
        resolution=resolution,
        hats=sparse.csr_array(hats[:, np.unique(hats.indices)]),
        other=sparse.csr_array(other[over]),
    )


#: Gap over the length of its face that only a wrong unit can mean.
_ABSURD = 10.0


def _given_gap(
    joint: Joint, points: _FacePoints, nodes: IntArray, mean: sparse.csr_array
) -> tuple[FloatArray, Resolution | None]:
    """Mean gap of a joint over the hats of nodes (k,), m, and how much of it these means have.

    ``mean`` (k, points) are the means over hats.
    """
    parts = surfaces(joint.gap)
    if not parts:
        return np.full(nodes.size, joint.gap, dtype=float), None
    over = np.flatnonzero(points.weight > 0.0)
    x, normal, weight = points.x[over], points.normal[over], points.weight[over]
    values = gaps_at(parts, x, normal, joint.label)
    touches = joint.remove_plane or is_relative(parts)
    if joint.remove_plane:
        values = without_plane(values, x, normal, weight)
    elif not touches and values.min() < 0.0:
        worst = int(values.argmin())
        raise InputError(
            f"{joint.label}: gap: found {values[worst]:.4g} m at {spot(x[worst])}, must be >= 0; "
            "is it a height (kind = 'height', the name of the column)? remove_plane = true shifts "
            "it so that the faces touch"
        )
    given = np.asarray(mean[:, over] @ values)
    level = given.min() if touches else 0.0
    hats = sparse.csr_array(points.hats[nodes][:, over])
    inside = np.asarray(hats.sum(axis=0)).ravel() > 1.0 - 1e-9  # under chosen hats alone
    fine = hats[:, np.flatnonzero(inside)]
    known = Resolution.of(values[inside] - level, x[inside], fine, weight[inside])
    if known.largest > _ABSURD * known.length:
        raise InputError(
            f"{joint.label}: gap: found up to {known.largest:.4g} m on a face of "
            f"{known.length:.4g} m, must be small beside it; is it in another unit? A file tells "
            "it in the name of its column, 'height (um)', a scene by scale"
        )
    return given - level, known


@dataclass(frozen=True)
class _FacePoints:
    """Quadrature points of a face.

    Attributes
    ----------
    x, normal : ndarray, shape (k, dim)
        Their positions, m, and the face's normals there.
    hats : sparse array, shape (nodes, k)
        Hats of the nodes.
    weight : ndarray, shape (k,)
        m2; 0 where there is no opposite face.
    motion : sparse array, shape (k, dim N)
        Motion towards the other body.
    gap : ndarray, shape (k,)
        Initial gap, m.
    """

    x: FloatArray
    normal: FloatArray
    hats: sparse.csr_array
    weight: FloatArray
    motion: sparse.csr_array
    gap: FloatArray

    @staticmethod
    def of(body: Nodes, joint: Joint, manifold: Manifold, normals: FloatArray) -> _FacePoints:
        """Points in the sub-cells of a joint, whose nodes have ``normals`` (N, dim)."""
        corners, gather, parent = hat_simplices(body.nodes, manifold.cells)
        places, weights = _quadrature(corners.shape[1])
        x = np.einsum("qc,ncd->nqd", places, corners).reshape(-1, body.dim)
        points, count = np.arange(len(x)).reshape(len(corners), -1), corners.shape[1]
        corner = np.arange(corners.shape[0] * count).reshape(len(corners), 1, count)
        rows, columns, values = np.broadcast_arrays(corner, points[..., np.newaxis], places)
        entries = values.ravel(), (rows.ravel(), columns.ravel())
        hats = gather @ sparse.csr_array(entries, shape=(corner.size, len(x)))
        normal = unit_vectors(hats.T @ normals)
        n, gap, values_there = _opposite(body, joint, x, normal)
        weight = np.outer(measure(corners) * manifold.depth[parent], weights).ravel()
        parent = np.repeat(parent, points.shape[1])
        own_values = values_in(body, manifold.elements[parent], x, np.zeros(len(x)))[0]
        relative = sparse.kron(own_values - values_there, sparse.eye_array(body.dim))
        return _FacePoints(
            x=x,
            normal=normal,
            hats=sparse.csr_array(hats),
            weight=np.where(np.isnan(gap), 0.0, weight),
            motion=sparse.csr_array(rows_along(np.arange(len(x)), n, len(x)) @ relative),
            gap=np.nan_to_num(gap),
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
) -> tuple[FloatArray, FloatArray, sparse.csr_array]:
    """Opposite body at points ``x`` (k, dim) of a pressed face with a ``normal`` (k, dim).

    Returns the direction (k, dim) to the other face, the gap (k,), m, which is NaN where there is
    no opposite face, and the displacement (k, N) of the other body there from that of its nodes.
    """
    if joint.against is None:
        return normal, np.zeros(len(x)), sparse.csr_array((len(x), body.n_nodes))
    mesh = body.mesh.mesh
    ends = mesh.p[:, mesh.facets[:, body.mesh.boundaries[joint.on]]]
    extent = np.ptp(ends, axis=1).max(axis=0)
    element, foot = feet(body, joint.against, x, float(extent.max()))
    way = foot - x
    distance = np.linalg.norm(way, axis=1)
    signed = np.einsum("kd,kd->k", way, normal)
    round_off = 1e-9 * body.mesh.size
    flat = np.ptp(normal, axis=0).max(initial=0.0) < 1e-9
    # The way from a flat face to one that touches it is that of rounded coordinates.
    apart = distance > (max(round_off, CONFORMING * extent.min()) if flat else round_off)
    opposite = np.abs(signed) > PARALLEL * distance
    along = (apart & opposite)[:, np.newaxis]
    n = np.where(along, np.sign(signed)[:, np.newaxis] * unit_vectors(way), normal)
    gap = np.where(apart, np.where(opposite, np.sign(signed) * distance, np.nan), signed)
    gap[distance <= round_off] = 0.0
    none = np.isnan(distance)
    gap[none] = np.nan
    return n, gap, values_in(body, element, foot, np.where(none, np.inf, 0.0))[0]
