"""Displacement nodes of a mesh of any dimension and order, and the linear cells between them.

Degrees of freedom of the scalar element are the nodes: vertices, then the middles of edges, facets
and cells as the order asks for. Between them lie linear sub-cells; they carry pressures, pictures
and areas, because their hat functions are positive where shape functions of second order are not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import skfem

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.mesh import NamedMesh
from skfem_joint.mesh.cells import Cell, cell_of, split


@dataclass(frozen=True)
class Nodes:
    """Nodes of a named mesh, and what lies between them."""

    mesh: NamedMesh

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
        """Whether the elements are segments, triangles or tetrahedra."""
        return len(self.mesh.mesh.t) == self.cell.dim + 1

    @property
    def quadrature(self) -> int:
        """Order of integration: exact for the mass of simplices, and of straight other elements."""
        return 2 * self.mesh.order + (not self.is_simplex)

    @cached_property
    def basis(self) -> Any:
        """Scalar basis of scikit-fem: its degrees of freedom are the nodes."""
        return skfem.Basis(self.mesh.mesh, self.element, intorder=self.quadrature)

    @cached_property
    def _split(self) -> tuple[FloatArray, IntArray, IntArray, IntArray, IntArray]:
        """Positions, nodes of elements and facets, and parts of these, as `split` gives them."""
        mesh = self.mesh.mesh
        if self.mesh.order == 2:
            return split(mesh)
        t, facets = (np.asarray(some, dtype=np.intp) for some in (mesh.t, mesh.facets))
        return mesh.p, t, facets, t[np.newaxis], facets[np.newaxis]

    @cached_property
    def nodes(self) -> FloatArray:
        """Positions, (N, dim), m."""
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
    def body(self) -> IntArray:
        """Body of each node, (N,)."""
        body = np.full(self.n_nodes, -1, dtype=np.intp)
        body[self.of_element] = self.mesh.body
        return body

    def nodes_of(self, name: str) -> IntArray:
        """Nodes of a region, boundary or point, in rising order."""
        if name in self.mesh.points:
            return np.array([self.mesh.points[name]], dtype=np.intp)
        if name in self.mesh.regions:
            return np.unique(self.of_element[:, self.mesh.regions[name]])
        return np.unique(self.facet_cells(self.mesh.boundaries[name])[0])

    def facet_cells(self, facets: IntArray) -> tuple[IntArray, IntArray]:
        """Linear sub-cells (sub-cells, corners) of facets, and the place in ``facets`` of each."""
        return _rows(self._split[4][:, :, facets])

    def even_shares(self, name: str) -> FloatArray:
        """Share (N,) of each node in a unit spread evenly over a boundary, a region or a point."""
        if name in self.mesh.points:
            return np.bincount([self.mesh.points[name]], minlength=self.n_nodes).astype(float)
        if name in self.mesh.regions:
            part = self.basis.with_elements(self.mesh.regions[name])
        else:
            part = self.facet_basis(self.mesh.boundaries[name])
        shares = np.asarray(skfem.LinearForm(lambda v, _: 1.0 * v).assemble(part))
        return _cleared(shares / shares.sum())

    def facet_basis(self, facets: IntArray) -> Any:
        """Scalar basis of scikit-fem on facets, which knows their normals."""
        how = {"facets": facets, "intorder": self.quadrature}
        return skfem.FacetBasis(self.mesh.mesh, self.element, **how)

    def integrals(self, part: Any, value: FloatArray) -> FloatArray:
        """Integrals (N, components) of a vector times each shape function.

        ``part`` is a basis; ``value`` (components, its elements, points) is given at its points.
        """
        form = skfem.LinearForm(lambda v, w: w.value * v)
        columns = [form.assemble(part, value=np.broadcast_to(v, part.dx.shape)) for v in value]
        return _cleared(np.transpose(columns))


def _cleared(shares: FloatArray) -> FloatArray:
    """Without the round-off that shape functions of other nodes and of second order give."""
    return np.asarray(np.where(np.abs(shares) < 1e-12 * np.abs(shares).max(), 0.0, shares))


def _rows(parts: IntArray) -> tuple[IntArray, IntArray]:
    """Sub-cells in rows from parts (parts, corners, n), and the owner of each."""
    rows = np.moveaxis(parts, 1, 2).reshape(-1, parts.shape[1])
    owner = np.tile(np.arange(parts.shape[2], dtype=np.intp), len(parts))
    return np.ascontiguousarray(rows), owner
