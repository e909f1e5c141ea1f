"""The contact manifold: the surface of a joint, its normals and its slip directions.

A joint on a region lies on its base with the cells (a strut, a plate in plan); a joint on a
boundary is pressed with the facets (the edge of a plate seen from the side, a face of a solid). The
slip directions of a node are perpendicular to its contact normal and to the directions that
supports hold: a single direction on a strut and an edge, two on a plate in plan and a face.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.body.nodes import Nodes
from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.joints import Joint
from skfem_joint.mesh.cells import CONFORMING, outward, spot
from skfem_joint.system.slips import unit_vectors

#: Parts of a unit vector below this are round-off.
SMALL = 1e-9


@dataclass(frozen=True)
class Manifold:
    """Sub-cells on which a joint acts.

    Attributes
    ----------
    cells : ndarray of int, shape (c, corners)
        Nodes of the sub-cells.
    elements : ndarray of int, shape (c,)
        Element beside each.
    depth : ndarray, shape (c,)
        Extent of the contact across each, m; 1 where sub-cells are areas already.
    normals : ndarray, shape (N, dim), or None
        Outward unit normals at the nodes of facets; None where cells lie on their base.
    """

    cells: IntArray
    elements: IntArray
    depth: FloatArray
    normals: FloatArray | None


def manifold_of(grid: Nodes, joint: Joint) -> Manifold:
    """Sub-cells of a joint.

    Raises
    ------
    InputError
        If facets of the joint meet at more than 30 degrees, or more than two edges at a node.
    """
    if joint.on in grid.mesh.regions:
        return Manifold(*cells_of_region(grid, grid.mesh.regions[joint.on]), None)
    cells, beside, depth = cells_of_boundary(grid, grid.mesh.boundaries[joint.on])
    return Manifold(cells, beside, depth, _normals(grid, cells, beside, joint.label))


def cells_of_region(grid: Nodes, elements: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """``cells``, ``elements`` and ``depth`` of elements that lie on a base, see `Manifold`."""
    inside = np.isin(grid.cell_element, elements)
    own = grid.cell_element[inside]
    # A bar lies on its base with its width; a cell of a plate in plan is an area already.
    return grid.cells[inside], own, grid.section[0][own]


def cells_of_boundary(grid: Nodes, facets: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """``cells``, ``elements`` and ``depth`` of facets, see `Manifold`."""
    cells, facet = grid.facet_cells(facets)
    beside = grid.mesh.mesh.f2t[0, facets][facet]
    return cells, beside, grid.section[1][beside]


def _normals(grid: Nodes, cells: IntArray, beside: IntArray, where: str) -> FloatArray:
    """Outward unit normals (N, dim) at the nodes of facets: means of those that meet there.

    Facets that meet at more than `largest_turn` degrees are refused: a node between them has no
    tangent. A face that is flat but for rounded coordinates has one normal, which holds no slip.
    """
    largest_turn = 30.0
    x, mesh = grid.nodes, grid.mesh.mesh
    if x.shape[1] == 2:
        meeting = np.bincount(cells.ravel())
        if np.any(meeting > 2):
            place = spot(x[np.argmax(meeting)])
            raise InputError(f"{where}: more than two of its edges meet at {place}")
    vector = outward(x[cells], mesh.p[:, mesh.t[:, beside]].mean(axis=1).T)
    unit = unit_vectors(vector)
    common = unit_vectors(vector.sum(axis=0, keepdims=True))
    if np.linalg.norm(unit - common, axis=1).max() < CONFORMING:  # flat but for rounded coordinates
        unit = np.repeat(common, len(unit), axis=0)
        vector = np.linalg.norm(vector, axis=1)[:, None] * unit
    total, mean = np.zeros_like(x), np.zeros_like(x)
    for corner in cells.T:
        np.add.at(total, corner, vector)
        np.add.at(mean, corner, unit)
    mean, turn = unit_vectors(mean), np.zeros(len(x))
    for corner in cells.T:
        cosine = np.clip(np.einsum("kc,kc->k", mean[corner], unit), 0, 1)
        np.maximum.at(turn, corner, 2.0 * np.degrees(np.arccos(cosine)))
    worst = int(np.argmax(turn))
    if turn[worst] > largest_turn:
        raise InputError(
            f"{where}: it turns by {turn[worst]:.3g} degrees at {spot(x[worst])}, must be at "
            f"most {largest_turn:g}, else no tangent is defined there; give each straight part a "
            "boundary and a joint of its own, a node apart"
        )
    return unit_vectors(total)


def _tangents(normals: FloatArray, overall: FloatArray) -> FloatArray:
    """Tangents (k, dim - 1, dim) at unit normals (k, dim), which vary little from node to node.

    ``overall`` (dim,) is the sum of all normals. In the plane tangents have a positive component
    along x, or along y where the border as a whole is perpendicular to x. In space the first
    tangent is the projection of the axis to which the border is most nearly parallel.
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
    """Slip directions of k nodes, shape (k, d, dim); absent ones are zero and come last.

    A node slips in the directions perpendicular to its normal and to what supports hold: the null
    space of both, whose vectors are signed so that the largest component is positive.

    Parameters
    ----------
    normals : ndarray, shape (k, dim), or None
        Unit normals of facets; None where cells lie on their base.
    held : ndarray of bool, shape (k, dim)
        Displacements that supports hold.
    """
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
