"""Contact of a structure that opens and closes: pressure points of a joint on its nodes.

The faces of a joint with ``contact = "unilateral"`` approach each other by
d_i = n_i (u_i - u_other) at each node i. The pressure points are the nodes of the face,
with the mean approaches of their hats, N u = W d (:mod:`skfem_joint.joint.pressure_space`). The
weights W are those of the pressed face; on the other body each node acts at the place opposite to
it, so that forces are equal, opposite, and on one line, on meshes that do not match too. d become
unknowns of the system, as slips do. The force at a node that supports hold against approaching
stays as it is at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from skfem_joint.body.nodes import Nodes
from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.joints import Joint
from skfem_joint.joint.manifold import SMALL
from skfem_joint.joint.pressure_space import PressureSpace
from skfem_joint.mesh.cells import spot
from skfem_joint.system.normal import NormalPart


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
    other : sparse array, shape (N, N)
        Displacement of the other body opposite to each node, from that of its nodes.
    contact_force, contact_gap : ndarray, shape (k,)
        Force, N, and gap, m, of the nodes of `PressureSpace`.
    means : sparse array, shape (k, k)
        Normal forces of the same nodes from these forces, see `PressureSpace.means`.
    """

    force: FloatArray
    area: FloatArray
    gap: FloatArray
    other: sparse.csr_array
    contact_force: FloatArray
    contact_gap: FloatArray
    means: Matrix


@dataclass(frozen=True, kw_only=True)
class OpeningFace(NormalPart):
    """Pressure points of a joint that opens; its ``N`` takes the approaches of their nodes.

    Attributes
    ----------
    nodes : ndarray of int, shape (k,)
        Nodes of the pressed face that lie over the other one.
    normals : ndarray, shape (k, dim)
        Outward normals there.
    other : sparse array, shape (k, nodes of the body)
        Displacement of the other body opposite to them; zero on a rigid base.
    means : sparse array, shape (q, q)
        Means of forces over the hats of corners, by which pressures are shown.
    moves : ndarray of bool, shape (q,)
        Whether supports let the node of each pressure point approach; the others are not among the
        pressure points of a system.
    """

    nodes: IntArray
    normals: FloatArray
    other: sparse.csr_array
    means: sparse.csr_array
    moves: BoolArray

    @staticmethod
    def closed(n: int, dim: int) -> OpeningFace:
        """Of contact that stays closed, on a body of ``n`` nodes: without pressure points."""
        return OpeningFace(
            **vars(NormalPart.none(0)),
            nodes=np.zeros(0, dtype=np.intp),
            normals=np.zeros((0, dim)),
            other=sparse.csr_array((0, n)),
            means=sparse.csr_array((0, 0)),
            moves=np.zeros(0, dtype=bool),
        )

    @property
    def moving(self) -> NormalPart:
        """The pressure points of a system."""
        return self.among(np.flatnonzero(self.moves))


def opening_face(
    body: Nodes,
    joint: Joint,
    held: BoolArray,
    normals: FloatArray,
    nodal: FloatArray,
    preloaded: NodalForces | None,
    space: PressureSpace,
) -> OpeningFace:
    """Pressure points of a joint that opens.

    Parameters
    ----------
    body : Nodes
    joint : Joint
    held : ndarray of bool, shape (nodes of the body, dim)
        Displacements that supports hold.
    normals : ndarray, shape (nodes of the body, dim)
        Outward unit normals of the face.
    nodal : ndarray, shape (nodes of the body,)
        Normal forces by the joint's own pressure, N.
    preloaded : NodalForces or None
        What counts in their place under a preload, and in place of the gap of mesh and joint.
    space : PressureSpace
        Of the joint.

    Raises
    ------
    InputError
        If a pressure is given beside a gap.
    """
    if preloaded is None:
        given = joint.gap_scale * space.given
        force, gap = nodal[space.nodes], np.maximum(space.gap, 0.0) + given
        if given.any() and force.any():
            raise InputError(
                f"{joint.label}: found a pressure beside a gap of up to {given.max():.4g} m: faces "
                "that are apart carry no pressure; leave one of them out, or let bolts close the "
                "gap (pressure = 'preload')"
            )
    else:
        force, gap = preloaded.contact_force, np.maximum(preloaded.contact_gap, 0.0)
    own = normals[space.nodes]
    return OpeningFace(
        nodes=space.nodes,
        normals=own,
        other=space.other,
        N=_weights(body, space, own),
        means=space.means(force),
        gap=np.where((force > 0.0) | (gap <= 1e-9 * body.mesh.size), 0.0, gap),
        force=force,
        area=space.area,
        stiffness=joint.normal_stiffness * space.area,
        moves=np.linalg.norm(np.where(held[space.nodes], 0.0, own), axis=1) > SMALL,
    )


def _weights(body: Nodes, space: PressureSpace, normals: FloatArray) -> sparse.csr_array:
    """Mean approach of the pressure points from those of the nodes, (q, k).

    For first order they are the approaches of the nodes themselves. Means over hats, which couple
    neighbours, let forces swing at the end of a contact: on the block of the GRECO benchmark 403,
    10, 140 and 62 kN/m at the first four nodes, and slips up to 8 % off.
    """
    if body.mesh.order == 1:
        return sparse.csr_array(sparse.eye_array(space.nodes.size))
    rows = body.dim * space.nodes[:, None] + np.arange(body.dim)
    each = normals.ravel(), rows.ravel(), body.dim * np.arange(len(normals) + 1)
    along = sparse.csc_array(each, shape=(space.N.shape[1], len(normals)))
    W = sparse.csr_array(space.N @ along)
    W.data[np.abs(W.data) < 1e-12] = 0.0
    W.eliminate_zeros()
    total = np.asarray(W.sum(axis=1)).ravel()
    if np.any(total < 0.1):
        worst = space.nodes[int(total.argmin())]
        raise InputError(
            f"contact that opens: the face around {spot(body.nodes[worst])} hardly lies over the "
            "other one; split the mesh where the overlap ends"
        )
    return sparse.csr_array(sparse.diags_array(1.0 / total) @ W)
