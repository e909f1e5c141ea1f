"""Contact of a structure that opens and closes: pressure points of a joint on its nodes.

The faces of a joint with ``contact = "unilateral"`` approach each other by
d_i = n_i (u_i - u_other) at each node i. The pressure points are the nodes of the face,
with the mean approaches of their hats, N u = W d (:mod:`skfem_joint.structure.pressure_space`). The
weights W are those of the pressed face; on the other body each node acts at the place opposite to
it, so that forces are equal, opposite, and on one line, on meshes that do not match too. d become
unknowns of the system, as slips do. The force at a node that supports hold against approaching
stays as it is at rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.mesh.cells import spot
from skfem_joint.normal import NormalPart
from skfem_joint.slips import NormalRows, rows_along
from skfem_joint.structure.joints import Joint
from skfem_joint.structure.nodes import Nodes
from skfem_joint.structure.patch import SMALL, NodalForces, Patch, manifold_of
from skfem_joint.structure.pressure import nodal_pressure
from skfem_joint.structure.pressure_space import PressureSpace, pressure_space
from skfem_joint.unknowns import selection


@dataclass(frozen=True)
class OpeningFace:
    """Pressure points of a joint that opens.

    Attributes
    ----------
    nodes : ndarray of int, shape (k,)
        Nodes of the pressed face that lie over the other one.
    W : sparse array, shape (q, k)
        Mean approach of each pressure point from those of the nodes; rows sum to 1.
    means : sparse array, shape (q, q)
        Means of forces over the hats of corners, by which pressures are shown.
    gap, force, area, stiffness : ndarray, shape (q,)
        As in :class:`skfem_joint.normal.NormalPart`.
    moves : ndarray of bool, shape (q,)
        Whether supports let the node of each pressure point approach; the others are not among the
        pressure points of a system.
    """

    nodes: IntArray
    W: sparse.csr_array
    means: sparse.csr_array
    gap: FloatArray
    force: FloatArray
    area: FloatArray
    stiffness: FloatArray
    moves: BoolArray


def opening_face(
    body: Nodes,
    joint: Joint,
    held: BoolArray,
    width: FloatArray,
    thickness: FloatArray,
    pressed: NodalForces | None = None,
    space: PressureSpace | None = None,
) -> tuple[NodalForces, OpeningFace]:
    """Nodal forces at rest of a joint that opens, and its pressure points.

    Parameters
    ----------
    body : Nodes
    joint : Joint
    held : ndarray of bool, shape (nodes of the body, dim)
        Displacements that supports hold.
    width, thickness : ndarray, shape (elements,)
        m.
    pressed : NodalForces, optional
        Of the preload; the joint's own pressure and the gap of the mesh count if not given.
    space : PressureSpace, optional
        Of the joint, if the preload has made it.

    Raises
    ------
    InputError
        If the joint has no boundary, or a pressure is given beside a gap.
    """
    cells, _, depth, normals = manifold_of(body, joint.on, width, thickness, joint.label)
    if space is None:
        space = pressure_space(body, joint, width, thickness)
    if space is None or normals is None:
        raise InputError(f"{joint.label}: contact = 'unilateral' needs a boundary")
    known = (None, None) if pressed is None else (pressed.contact_force, pressed.contact_gap)
    return _pressed_and_face(body, joint, held, space, normals, *known, (cells, depth))


def _pressed_and_face(
    body: Nodes,
    joint: Joint,
    held: BoolArray,
    space: PressureSpace,
    normals: FloatArray,
    known_force: FloatArray | None,
    known_gap: FloatArray | None,
    cells_and_depth: tuple[IntArray, FloatArray],
) -> tuple[NodalForces, OpeningFace]:
    """Nodal forces of a joint at rest, and its pressure points.

    Parameters
    ----------
    body : Nodes
    joint : Joint
    held : ndarray of bool, shape (nodes of the body, dim)
    space : PressureSpace
    normals : ndarray, shape (nodes of the body, dim)
        Outward unit normals of the face.
    known_force, known_gap : ndarray, shape (q,), or None
        Force, N, and gap, m, of each node under the preload; of the joint's pressure and of the
        mesh if not given.
    cells_and_depth : tuple
        Sub-cells of the face and their depths, from `manifold_of`.

    Raises
    ------
    InputError
        If a pressure is given beside a gap.
    """
    W = _weights(body, space, normals)
    force = np.zeros(space.nodes.size)
    if known_force is not None:
        force = known_force
    elif not isinstance(joint.pressure, str):
        nodal, _, _ = nodal_pressure(body.nodes, *cells_and_depth, joint.pressure, joint.label)
        force = nodal[space.nodes]
    gap = np.maximum(space.gap if known_gap is None else known_gap, 0.0)
    if known_gap is None:
        gap = gap + joint.gap
    if known_force is None and joint.gap > 0.0 and force.any():
        raise InputError(
            f"{joint.label}: found a pressure beside gap = {joint.gap:g} m: faces that are apart "
            "carry no pressure; leave one of them out"
        )
    gap = np.where((force > 0.0) | (gap <= 1e-9 * body.mesh.size), 0.0, gap)
    stiffness = joint.normal_stiffness * space.area
    at = selection(space.nodes, body.n_nodes).T
    other = None if space.other is None else sparse.csr_array(at @ space.other)
    pressed = NodalForces(at @ force, at @ space.area, at @ gap, other)
    free = np.where(held[space.nodes], 0.0, normals[space.nodes])
    moves = np.linalg.norm(free, axis=1) > SMALL
    face = OpeningFace(space.nodes, W, space.means(force), gap, force, space.area, stiffness, moves)
    return pressed, face


def _weights(body: Nodes, space: PressureSpace, normals: FloatArray) -> sparse.csr_array:
    """Mean approach of the pressure points from those of the nodes, (q, k).

    For first order they are the approaches of the nodes themselves. Means over hats, which couple
    neighbours, let forces swing at the end of a contact: on the block of the GRECO benchmark 403,
    10, 140 and 62 kN/m at the first four nodes, and slips up to 8 % off.
    """
    if body.mesh.order == 1:
        return selection(np.searchsorted(space.nodes, space.nodes), space.nodes.size)
    dim = body.dim
    columns = dim * space.nodes[:, None] + np.arange(dim)
    along = sparse.csr_array(
        (
            normals[space.nodes].ravel(),
            (columns.ravel(), np.repeat(np.arange(space.nodes.size), dim)),
        ),
        shape=(space.N.shape[1], space.nodes.size),
    )
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


def opening_rows(patches: Sequence[Patch], held: BoolArray, m: int) -> NormalRows | None:
    """Approaches of the nodes of joints that open, and their pressure points; None without any.

    ``held`` (N, dim) are the displacements that supports hold, ``m`` the number of contact points.
    """
    opening = [patch for patch in patches if patch.opening is not None]
    if not opening:
        return None
    count, dim = held.shape
    rows, pivots, parts, gains = [], [], [], []
    for patch in opening:
        face, moves = patch.opening, np.flatnonzero(patch.opening.moves)
        nodes = face.nodes[moves]
        n = np.where(held[nodes], 0.0, np.asarray(patch.opening_normal)[moves])
        relative = selection(nodes, count)
        if patch.opening_other is not None:
            relative = relative - patch.opening_other[moves]
        relative = sparse.kron(relative, sparse.eye_array(dim))
        # What a support holds of a slanted normal is no part of the approach.
        size = np.where(held[nodes].any(axis=1), np.linalg.norm(n, axis=1), 1.0)
        along = rows_along(np.arange(nodes.size), n, nodes.size)
        rows.append(sparse.diags_array(size) @ along @ relative)
        slips = np.zeros(count, dtype=np.intp)
        slips[patch.nodes] = np.count_nonzero(np.any(patch.directions != 0.0, axis=2), axis=1)
        free_first = np.argsort(held[nodes], axis=1, kind="stable")
        pivots.append(dim * nodes + free_first[np.arange(nodes.size), slips[nodes]])
        gain = patch.joint.friction * friction_gain(patch, m, count)
        every = NormalPart(face.W, face.gap, face.force, face.stiffness, face.area)
        parts.append(every.among(moves))
        gains.append(sparse.csc_array(gain)[:, moves])
    D = sparse.csr_array(sparse.vstack(rows))
    if not D.shape[0]:
        return None
    gain = sparse.csr_array(sparse.hstack(gains))
    return NormalRows(D, np.concatenate(pivots), NormalPart.joined(parts), gain)


def friction_gain(patch: Patch, m: int, count: int) -> sparse.csr_array:
    """Limits of ``m`` contact points by the forces of a joint's pressure points, (m, q).

    For a coefficient of friction of 1; ``count`` is the number of nodes of the body.
    """
    face = patch.opening
    place = np.full(count, -1)
    place[face.nodes] = np.arange(face.nodes.size)
    own = selection(place[patch.nodes], face.nodes.size)
    return sparse.csr_array(selection(patch.points, m).T @ own)
