"""Rigid motions of bodies, and which of them supports and contact leave free."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from skfem_joint.body.body import Body
from skfem_joint.body.checks import body_label
from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.joint.patch import Patch
from skfem_joint.system.slips import SlipRows


def body_motions(body: Body) -> FloatArray:
    """Rigid motions of each body, shape (N, dim, motions): translations, then small rotations."""
    d, bodies = body.dim, int(body.mesh.body.max()) + 1
    turns = list(combinations(range(d), 2))
    each = d + len(turns)
    position = body.nodes - body.nodes.mean(axis=0)
    position /= np.abs(position).max()
    motions = np.zeros((body.n_nodes, d, each * bodies))
    node, first = np.arange(body.n_nodes), each * body.body_of_node
    for c in range(d):
        motions[node, c, first + c] = 1.0
    for k, (i, j) in enumerate(turns):
        motions[node, i, first + d + k] = -position[:, j]
        motions[node, j, first + d + k] = position[:, i]
    return motions


def combinations_left_free(rows: Sequence[FloatArray]) -> FloatArray:
    """Orthonormal combinations (motions, k) of motions on which all rows (.., motions) vanish.

    Singular values below 1e-9 count as zero, and squares below the round-off of the largest.
    """
    gram = sum(row.T @ row for row in rows) / max(1, sum(len(row) for row in rows))
    squares, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors[:, squares < 1e-18 + 1e-13 * squares.max(initial=0.0)])


def loose_bodies(
    body: Body, held: BoolArray, patches: Sequence[Patch], cuts: SlipRows, friction: bool = True
) -> list[str]:
    """Bodies, in words, that keep a rigid motion beside supports, closed contact and friction.

    Parameters
    ----------
    body : Body
    held : ndarray of bool, shape (N, dim)
        Displacements that supports hold.
    patches : sequence of Patch
        Contact points of the joints.
    cuts : SlipRows
        Rows that hold cut bolt shanks together.
    friction : bool
        Whether joints with friction hold their slips too.
    """
    motions = body_motions(body)
    rows = [motions[held]]
    for patch in patches:
        relative = np.moveaxis(patch.relative(np.moveaxis(motions, 2, 0)), 0, -1)
        if patch.normal is not None:
            rows.append(np.einsum("kc,kcm->km", patch.normal, relative))
        if friction and patch.joint.friction > 0.0:
            slips = np.einsum("kdc,kcm->kdm", patch.directions, relative)
            rows.append(slips.reshape(-1, motions.shape[2]))
    rows.append(cuts.closed @ motions.reshape(-1, motions.shape[2]))
    free = np.abs(combinations_left_free(rows))
    share = free.reshape(body.mesh.body.max() + 1, -1).max(axis=1, initial=0.0)
    return [body_label(body.mesh, number) for number in np.flatnonzero(share > 1e-6).tolist()]
