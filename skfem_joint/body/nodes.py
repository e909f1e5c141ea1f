"""Displacement nodes of a mesh of any dimension and order, and the linear sub-cells between them.

The nodes are the degrees of freedom of the scalar element: vertices, and for second order the
middles of edges, facets and cells. Linear sub-cells between the nodes carry pressures, areas and
pictures, because their hat functions are positive where shape functions of second order are not.
The functions at the end search for the element in which a point lies, and interpolate there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import skfem
from scipy import sparse
from scipy.spatial import cKDTree

from skfem_joint.body.assembly import on_elements
from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.mesh import NamedMesh
from skfem_joint.mesh.cells import Cell, cell_of, nearest_places, within_reach
from skfem_joint.mesh.collapsed import dofs_of
from skfem_joint.mesh.splitting import split


@dataclass(frozen=True)
class Nodes:
    """Displacement nodes of a named mesh, its basis, and the linear sub-cells between the nodes.

    Attributes
    ----------
    mesh : NamedMesh
    width, thickness : float, optional
        Extents across the mesh, m, of lines and of plates; 1 if not given.
    """

    mesh: NamedMesh
    width: float | None = field(default=None, kw_only=True)
    thickness: float | None = field(default=None, kw_only=True)

    @property
    def section(self) -> tuple[FloatArray, FloatArray]:
        """Width and thickness of each element, (elements,) each, m."""
        ones = np.ones(self.mesh.n_elements)
        width, thickness = (1.0 if x is None else x for x in (self.width, self.thickness))
        return width * ones, thickness * ones

    @property
    def dim(self) -> int:
        """Dimension of the mesh, 1, 2 or 3."""
        return self.mesh.dim

    @cached_property
    def cell(self) -> Cell:
        """Kind of the elements."""
        return cell_of(self.mesh.mesh)[0]

    @cached_property
    def element(self) -> Any:
        """Scalar element of scikit-fem for one component of the displacement."""
        return self.cell.elements[self.mesh.order - 1]()

    @property
    def is_simplex(self) -> bool:
        """Whether all elements are segments, triangles or tetrahedra, none of them collapsed."""
        return len(self.mesh.mesh.t) == self.cell.dim + 1

    @property
    def quadrature(self) -> int:
        """Order of quadrature: exact for the mass of simplices, prisms and parallelepipeds."""
        return 2 * self.mesh.order + (not self.is_simplex)

    @cached_property
    def basis(self) -> Any:
        """Scalar basis of scikit-fem: its degrees of freedom are the nodes."""
        return skfem.Basis(self.mesh.mesh, self.element, intorder=self.quadrature, dofs=self._dofs)

    @cached_property
    def _dofs(self) -> skfem.Dofs:
        """Numbers of the nodes."""
        return dofs_of(self.mesh.mesh, self.element)

    @cached_property
    def _split(self) -> tuple[FloatArray, IntArray, IntArray, IntArray, IntArray]:
        """Positions, nodes of elements and of facets, and their linear parts, as from `split`."""
        mesh = self.mesh.mesh
        if self.mesh.order == 2:
            return split(mesh)
        t, facets = (np.asarray(rows, dtype=np.intp) for rows in (mesh.t, mesh.facets))
        return mesh.p, t, facets, t[np.newaxis], facets[np.newaxis]

    @cached_property
    def nodes(self) -> FloatArray:
        """Positions of the nodes, (N, dim), m."""
        return np.ascontiguousarray(self._split[0].T)

    @property
    def n_nodes(self) -> int:
        """Number of nodes N."""
        return int(self._split[0].shape[1])

    @property
    def of_element(self) -> IntArray:
        """Nodes of the elements, (nodes of an element, elements)."""
        return self._split[1]

    @cached_property
    def cells(self) -> IntArray:
        """Linear sub-cells on the nodes, (sub-cells, corners)."""
        return _rows(self._split[3])[0]

    @cached_property
    def cell_element(self) -> IntArray:
        """Element of each sub-cell."""
        return _rows(self._split[3])[1]

    @cached_property
    def body_of_node(self) -> IntArray:
        """Number of the body to which each node belongs, (N,)."""
        body = np.full(self.n_nodes, -1, dtype=np.intp)
        body[self.of_element] = self.mesh.body
        return body

    @cached_property
    def from_vertices(self) -> sparse.csr_array:
        """Values at the nodes, linear between the vertices, from those at the vertices, (N, v)."""
        first, t = self.cell.elements[0](), self.mesh.mesh.t
        place, element = np.indices(self.of_element.shape)
        of_node = np.zeros((2, self.n_nodes), dtype=np.intp)
        of_node[:, self.of_element] = place, element  # any element beside a node
        shares = np.array([first.lbasis(self.element.doflocs.T, i)[0] for i in range(len(t))])
        rows = np.broadcast_to(np.arange(self.n_nodes), (len(t), self.n_nodes))
        entries = shares[:, of_node[0]].ravel(), (rows.ravel(), t[:, of_node[1]].ravel())
        matrix = sparse.csr_array(entries, shape=(self.n_nodes, self.mesh.mesh.p.shape[1]))
        matrix.eliminate_zeros()
        return matrix

    def nodes_of(self, name: str) -> IntArray:
        """Sorted nodes of a region, boundary or point."""
        if name in self.mesh.points:
            return np.array([self.mesh.points[name]], dtype=np.intp)
        if name in self.mesh.regions:
            return np.unique(self.of_element[:, self.mesh.regions[name]])
        return np.unique(self.facet_cells(self.mesh.boundaries[name])[0])

    def facet_cells(self, facets: IntArray) -> tuple[IntArray, IntArray]:
        """Linear sub-cells (sub-cells, corners) of facets, and the index in ``facets`` of each."""
        return _rows(self._split[4][:, :, facets])

    def even_shares(self, name: str) -> FloatArray:
        """Share (N,) of each node in a unit force spread over a boundary, region or point."""
        if name in self.mesh.points:
            return np.bincount([self.mesh.points[name]], minlength=self.n_nodes).astype(float)
        if name in self.mesh.regions:
            part = on_elements(self.basis, self.mesh.regions[name])
        else:
            part = self.facet_basis(self.mesh.boundaries[name])
        shares = np.asarray(skfem.LinearForm(lambda v, _: 1.0 * v).assemble(part))
        return _cleared(shares / shares.sum())

    def facet_basis(self, facets: IntArray) -> Any:
        """Scalar basis of scikit-fem on facets, with their normals."""
        return skfem.FacetBasis(
            self.mesh.mesh,
            self.element,
            facets=facets,
            intorder=self.quadrature,
            dofs=self._dofs,
        )

    def integrals(self, part: Any, value: FloatArray) -> FloatArray:
        """Integrals (N, components) of a vector times each shape function.

        ``part`` is a basis; ``value`` (components, its elements, points) is given at its points.
        """
        form = skfem.LinearForm(lambda v, w: w.value * v)
        columns = [form.assemble(part, value=np.broadcast_to(v, part.dx.shape)) for v in value]
        return _cleared(np.transpose(columns))


def _cleared(shares: FloatArray) -> FloatArray:
    """Integrals without the round-off that shape functions with a zero integral leave."""
    return np.asarray(np.where(np.abs(shares) < 1e-12 * np.abs(shares).max(), 0.0, shares))


def _rows(parts: IntArray) -> tuple[IntArray, IntArray]:
    """Sub-cells (sub-cells, corners) from parts (parts, corners, n), and the owner of each."""
    rows = np.moveaxis(parts, 1, 2).reshape(-1, parts.shape[1])
    owner = np.tile(np.arange(parts.shape[2], dtype=np.intp), len(parts))
    return np.ascontiguousarray(rows), owner


def interpolation(
    grid: Nodes, name: str, points: FloatArray
) -> tuple[sparse.csr_array, FloatArray]:
    """Matrix that interpolates values of the nodes at points of a region or boundary.

    Parameters
    ----------
    grid : Nodes
    name : str
        Region or boundary.
    points : ndarray, shape (k, dim)
        m.

    Returns
    -------
    matrix : sparse array, shape (k, N)
        Its rows sum to 1 and reproduce linear fields; a point on a node takes the node's value.
    gap : ndarray, shape (k,)
        Distance of points too far outside, m, whose rows are empty; 0 for the others.
    """
    element, gap, _ = _elements_at(grid, name, points)
    return values_in(grid, element, points, gap)


def values_in(
    grid: Nodes, element: IntArray, points: FloatArray, gap: FloatArray
) -> tuple[sparse.csr_array, FloatArray]:
    """As `interpolation`, where the element (k,) and the gap (k,) of each point are known."""
    local = np.zeros_like(points)
    local[gap == 0.0] = local_coordinates(grid, element[gap == 0.0], points[gap == 0.0])
    gap[np.isnan(local).any(axis=1)] = np.inf
    local[gap > 0.0] = 0.0
    count = len(grid.of_element)
    weights = np.stack([grid.element.lbasis(local.T, i)[0] for i in range(count)], axis=1)
    near = grid.of_element[:, element].T
    size = float(np.ptp(grid.nodes, axis=0).max())
    same = np.linalg.norm(grid.nodes[near] - points[:, None], axis=-1) < 1e-9 * size
    matched = same.any(axis=1)
    weights[matched] = same[matched]
    weights[np.abs(weights) < 1e-12] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    weights[gap > 0.0] = 0.0
    rows = np.repeat(np.arange(len(points)), count)
    shape = (len(points), grid.n_nodes)
    matrix = sparse.csr_array((weights.ravel(), (rows, near.ravel())), shape=shape)
    matrix.eliminate_zeros()
    return matrix, gap


def feet(grid: Nodes, name: str, points: FloatArray, reach: float) -> tuple[IntArray, FloatArray]:
    """Elements (k,) and nearest points (k, dim) of a region or boundary, for k given points.

    A nearest point is NaN if it is farther away than ``reach`` (m).
    """
    element, _, nearest = _elements_at(grid, name, points)
    far = np.isnan(nearest).any(axis=1)
    if far.any():
        element[far], _, nearest[far] = _elements_at(grid, name, points[far], reach)
    return element, nearest


def _elements_at(
    grid: Nodes, name: str, points: FloatArray, reach: float = 0.0
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Nearest element (k,), gap (k,) and nearest place (k, dim) for each of k points.

    If a point lies in several elements the first is taken. A point may lie outside the part by a
    tenth of the size of the element beside it, because curved borders of two meshes differ by that
    much; there the interpolation extrapolates, and the gap is 0. The search extends ``reach`` (m)
    beyond that; places are NaN where there is no element.
    """
    allowed = 0.1
    mesh = grid.mesh.mesh
    if name in grid.mesh.regions:
        element = grid.mesh.regions[name]
        cells = mesh.t[:, element]
    else:
        facets = grid.mesh.boundaries[name]
        element, cells = mesh.f2t[0, facets], mesh.facets[:, facets]
    corners = mesh.p.T[cells.T]
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=-1).max(axis=1)
    cell, near = within_reach(corners, cKDTree(points), reach + 2.0 * allowed * radius)
    beside = corners[cell]
    foot = nearest_places(beside, points[near])
    distance = np.linalg.norm(foot - points[near], axis=1)
    size = np.linalg.norm(beside - np.roll(beside, 1, axis=1), axis=-1).max(axis=1)
    order = np.lexsort((element[cell], np.where(distance < 1e-9 * size, 0.0, distance), near))
    first, index = np.unique(near[order], return_index=True)
    best = order[index]
    chosen = np.full(len(points), element[0], dtype=np.intp)
    chosen[first] = element[cell[best]]
    gap = cKDTree(corners.reshape(-1, points.shape[1])).query(points)[0]
    gap[first] = np.where(distance[best] > allowed * size[best], distance[best], 0.0)
    feet = np.full(points.shape, np.nan)
    feet[first] = foot[best]
    return chosen, gap, feet


def local_coordinates(grid: Nodes, elements: IntArray, points: FloatArray) -> FloatArray:
    """Reference coordinates (k, dim) of k points, each in or beside the element given for it.

    scikit-fem's own inverse of mappings that are not affine raises if a single point lies outside
    its element. Here points may lie a little outside; those far off get NaN. Newton's iteration
    ends when no coordinate changes by more than 1e-9: as it converges quadratically, the next
    change would be of the size of round-off.
    """
    if elements.size == 0:
        return np.zeros_like(points)
    mesh = grid.mesh.mesh
    mapping, x = mesh.mapping(), points.T[:, :, None]
    if grid.is_simplex:
        return np.asarray(mapping.invF(x, tind=elements)[..., 0].T)
    corners = mesh.p[:, mesh.t[:, elements]]
    size = np.abs(corners - corners[:, :1]).max(axis=(0, 1))
    X = np.full(x.shape, 0.5)
    for _ in range(30):
        residual = x - mapping.F(X, tind=elements)
        jacobian = np.moveaxis(mapping.DF(X, tind=elements)[..., 0], -1, 0)
        usable = np.abs(np.linalg.det(jacobian)) > 1e-12 * size ** len(X)
        jacobian[~usable] = np.eye(len(X))
        change = np.linalg.solve(jacobian, np.moveaxis(residual, 1, 0))
        last, X = X, np.clip(X + np.moveaxis(change, 0, 1), -2.0, 3.0)
        if np.abs(X - last).max() < 1e-9:
            break
    local = np.array(X[..., 0].T)
    residual = (x - mapping.F(X, tind=elements))[..., 0].T
    local[np.abs(residual).max(axis=1) > 1e-10 * size] = np.nan
    return local
