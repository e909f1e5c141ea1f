"""Nodes of second order of a mesh, and the parts of its elements and sides between them."""

from __future__ import annotations

import numpy as np
import skfem
from skfem.element import BOUNDARY_ELEMENT_MAP

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.mesh.cells import cell_of
from skfem_joint.mesh.collapsed import dofs_of


def split(
    mesh: skfem.Mesh, values: FloatArray | None = None
) -> tuple[FloatArray, IntArray, IntArray, IntArray, IntArray]:
    """Split the elements and facets of a first-order mesh at the middles of their edges.

    Nodes are numbered as the degrees of freedom of the second-order element. Of the eight parts of
    a tetrahedron, the inner four meet at the shortest diagonal.

    Parameters
    ----------
    mesh : skfem.Mesh
        Of first order, with n elements or facets.
    values : ndarray, shape (k, n_vertices), optional
        Values at the vertices; their positions if not given.

    Returns
    -------
    values : ndarray, shape (k, N)
        Values interpolated at the nodes.
    element_nodes, facet_nodes : ndarray of int, shape (nodes, n)
        Nodes of the elements and of the facets.
    element_parts, facet_parts : ndarray of int, shape (parts, corners, n)
        Nodes of the parts of the elements and of the facets.
    """
    cell, _ = cell_of(mesh)
    first, second = (element() for element in cell.elements)
    dofs = dofs_of(mesh, second)
    nodes = np.asarray(dofs.element_dofs, dtype=np.intp)
    weights = np.array([first.lbasis(second.doflocs.T, i)[0] for i in range(len(mesh.t))])
    corners = (mesh.p if values is None else values)[:, mesh.t]
    full = np.empty((len(corners), dofs.N))
    for row, weight in zip(nodes, weights.T, strict=True):
        full[:, row] = np.einsum("kcn,c->kn", corners, weight)
    on_facet = [mesh.facets]
    on_facet += [dofs.edge_dofs[0, mesh.f2e]] if cell.dim == 3 else []
    on_facet += [dofs.facet_dofs] if dofs.facet_dofs.size else []
    facet_nodes = np.asarray(np.vstack(on_facet), dtype=np.intp)
    cells = nodes[_parts(second.doflocs, len(mesh.t))]
    if cell.name == "tetrahedron":
        cells = np.concatenate([cells, _around_diagonals(full, nodes)])
    places = np.zeros((1, 1)) if cell.dim == 1 else BOUNDARY_ELEMENT_MAP[type(second)].doflocs
    return full, nodes, facet_nodes, cells, facet_nodes[_parts(places, len(mesh.facets))]


def _parts(places: FloatArray, corners: int) -> IntArray:
    """Nodes of the parts of an element of second order, shape (parts, corners).

    The corners of the part at a corner are the middles between this corner and all others. In a
    triangle a fourth part joins the middles of the edges. ``places`` are the local coordinates of
    the nodes.
    """
    half = 0.5 * (places[:corners, np.newaxis] + places[:corners])
    parts = np.argmin(np.abs(half[:, :, np.newaxis] - places).sum(axis=-1), axis=-1)
    middle = [[3, 4, 5]] if (corners, len(places)) == (3, 6) else np.empty((0, corners))
    return np.vstack([parts, middle]).astype(np.intp)


def _around_diagonals(positions: FloatArray, nodes: IntArray) -> IntArray:
    """Nodes of the inner parts of tetrahedra of second order, shape (parts, corners, n).

    They surround the shortest of the diagonals between the middles of opposite edges.
    """
    diagonals = np.array([[4, 9], [5, 7], [6, 8]])
    rings = np.array([[5, 6, 7, 8], [4, 6, 9, 8], [4, 5, 9, 7]])
    ends = positions[:, nodes[diagonals]]
    shortest = np.argmin(((ends[:, :, 0] - ends[:, :, 1]) ** 2).sum(axis=0), axis=0)
    around, across = nodes.T[:, rings.T], nodes.T[:, diagonals.T]
    every = np.arange(nodes.shape[1])
    ring, diagonal = around[every, :, shortest].T, across[every, :, shortest].T
    return np.stack([np.stack([*diagonal, ring[i], ring[i - 3]]) for i in range(4)])
