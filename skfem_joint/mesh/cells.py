"""Kinds of elements, from scikit-fem's own tables, and the checks that hold for all of them.

Each check raises ValueError, which states place and reason. In all functions

- ``p``, shape (dim, n_vertices), are the positions of the vertices, m;
- ``at``, shape (n_vertices, 3), are their positions in space, m, for messages;
- ``t``, shape (corners, n_elements), are the vertices of the elements;
- ``facets``, shape (corners, n_facets), are the vertices of the facets.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skfem.element import BOUNDARY_ELEMENT_MAP

from skfem_joint.arrays import BoolArray, FloatArray, IntArray

#: Share of the mesh's size below which positions are the same: straightness, coincident nodes,
#: positions of points.
TOLERANCE = 1e-9
#: Smallest size and largest coordinate of a mesh, m: energies must neither vanish nor overflow.
SHORTEST, LONGEST = 1e-20, 1e20


@dataclass(frozen=True)
class Cell:
    """One kind of element.

    Attributes
    ----------
    name : str
    mesh : type
        Mesh of first order in scikit-fem.
    elements : tuple of type
        Scalar elements of first and second order in scikit-fem; their degrees of freedom are the
        nodes.
    turned : tuple of int
        Corners of the mirrored element.
    sign : int
        Sign of scikit-fem's Jacobian determinant where that of Gmsh is positive.
    gmsh : tuple of int
        Nodes in the order of Gmsh, where it differs from scikit-fem's.
    """

    name: str
    mesh: Any
    elements: tuple[Any, ...]
    turned: tuple[int, ...]
    sign: int = 1
    gmsh: tuple[int, ...] = ()

    @property
    def dim(self) -> int:
        """Dimension of the element."""
        return int(self.elements[0].refdom.dim())

    @property
    def measure(self) -> str:
        """Word for the size of an element."""
        return ("length", "area", "volume")[self.dim - 1]

    def facets(self, t: IntArray, n_vertices: int) -> tuple[IntArray, IntArray]:
        """Vertices of each facet and facets of each element, numbered as scikit-fem does."""
        if self.dim == 1:  # facets are the vertices: no sorting of millions of numbers
            return np.arange(n_vertices)[np.newaxis], t
        facets, t2f = skfem.Mesh.build_entities(t, self.elements[0].refdom.facets, sort=False)
        return np.asarray(facets, dtype=np.intp), np.asarray(t2f, dtype=np.intp)


_HEXAHEDRON = (
    *(0, 3, 6, 2, 1, 5, 7, 4, 10, 9, 8, 16, 15, 14, 19, 13, 12, 11, 18, 17),
    *(21, 22, 20, 25, 23, 24, 26),
)
_KINDS: tuple[tuple[Any, ...], ...] = (
    ("line", "Line", "P", (1, 0)),
    ("triangle", "Tri", "P", (0, 2, 1)),
    ("quadrilateral", "Quad", "", (0, 3, 2, 1)),
    ("tetrahedron", "Tet", "P", (0, 2, 1, 3), 1, (0, 1, 2, 3, 4, 5, 6, 7, 9, 8)),
    ("hexahedron", "Hex", "", (1, 0, 4, 5, 2, 3, 7, 6), -1, _HEXAHEDRON),
)
#: Kinds of elements by name.
CELLS: dict[str, Cell] = {
    name: Cell(
        *(name, getattr(skfem, f"Mesh{word}1")),
        tuple(getattr(skfem, f"Element{word}{letter}{order}") for order in (1, 2)),
        *rest,
    )
    for name, word, letter, *rest in _KINDS
}


def cell_of(mesh: skfem.Mesh) -> tuple[Cell, int]:
    """Kind and order of the elements of a scikit-fem mesh; ValueError for other kinds."""
    for cell in CELLS.values():
        if mesh.elem in cell.elements and len(mesh.p) == cell.dim:
            return cell, 1 + cell.elements.index(mesh.elem)
    raise ValueError(
        f"{type(mesh).__name__} with {len(mesh.p)} coordinates is not a mesh of "
        f"{', '.join(CELLS)} elements of first or second order in their own dimension"
    )


def same_columns(a: NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Index of the first column in each set of equal columns, and the set of each column.

    The sets are sorted by the columns' content.
    """
    order = np.lexsort(a[::-1])
    new = np.ones(order.size, dtype=np.bool_)
    new[1:] = (np.diff(a[:, order], axis=1) != 0).any(axis=0)
    member = np.empty(order.size, dtype=np.intp)
    member[order] = np.cumsum(new) - 1
    return order[new], member


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
    dofs = skfem.Dofs(mesh, second)
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
    """Nodes of the parts of an element of second order, from the places of its nodes.

    The corners of the part at a corner are the middles between this corner and all others. In a
    triangle a fourth part joins the middles of the edges.
    """
    half = 0.5 * (places[:corners, np.newaxis] + places[:corners])
    parts = np.argmin(np.abs(half[:, :, np.newaxis] - places).sum(axis=-1), axis=-1)
    middle = [[3, 4, 5]] if (corners, len(places)) == (3, 6) else np.empty((0, corners))
    return np.vstack([parts, middle]).astype(np.intp)


def _around_diagonals(positions: FloatArray, nodes: IntArray) -> IntArray:
    """Corners (4, 4, n) of the inner parts of tetrahedra of second order."""
    diagonals = np.array([[4, 9], [5, 7], [6, 8]])
    rings = np.array([[5, 6, 7, 8], [4, 6, 9, 8], [4, 5, 9, 7]])
    ends = positions[:, nodes[diagonals]]
    shortest = np.argmin(((ends[:, :, 0] - ends[:, :, 1]) ** 2).sum(axis=0), axis=0)
    around, across = nodes.T[:, rings.T], nodes.T[:, diagonals.T]
    every = np.arange(nodes.shape[1])
    ring, diagonal = around[every, :, shortest].T, across[every, :, shortest].T
    return np.stack([np.stack([*diagonal, ring[i], ring[i - 3]]) for i in range(4)])


def _det(matrices: FloatArray) -> FloatArray:
    """Determinants of matrices (n, dim, dim); in one dimension the numbers themselves."""
    return matrices[:, 0, 0] if matrices.shape[1] == 1 else np.linalg.det(matrices)


def spot(*positions: FloatArray) -> str:
    """Positions (m) in a message."""
    words = (", ".join(f"{value:.9g}" for value in position) for position in positions)
    return " to ".join(f"({word}) m" for word in words)


def check_shapes(cell: Cell, p: FloatArray, t: IntArray, at: FloatArray) -> BoolArray:
    """Refuse elements that have no size, are not convex or cross themselves.

    Returns whether each element runs the wrong way round, shape (n_elements,).
    """
    size = float(np.ptp(p, axis=1).max())
    if size < SHORTEST:
        raise ValueError(f"the mesh is {size:.3g} m in size: it must be {SHORTEST:g} m or more")
    pairs = combinations(range(len(t)), 2)
    lengths = [np.linalg.norm(p[:, t[i]] - p[:, t[j]], axis=0) for i, j in pairs]
    places = cell.elements[1].doflocs
    if len(t) == cell.dim + 1:
        places = places[:1]  # the Jacobian of a simplex is the same everywhere
    element, shape = cell.elements[0](), (cell.dim, len(places))
    slopes = [np.broadcast_to(element.lbasis(places.T, i)[1], shape) for i in range(len(t))]
    jacobians = (
        np.einsum("icn,cj->nij", p[:, t], slope) for slope in np.moveaxis(np.array(slopes), 2, 0)
    )
    area = cell.sign * np.array([_det(jacobian) for jacobian in jacobians])
    least, most = area.min(axis=0), area.max(axis=0)
    thin = TOLERANCE * np.max(lengths, axis=0) ** cell.dim
    for wrong, reason in (
        (np.min(lengths, axis=0) <= TOLERANCE * size, "has two corners in one place"),
        ((least < -thin) & (most > thin), "crosses itself or is not convex"),
        (np.abs(area).min(axis=0) <= thin, f"has no {cell.measure}, as a whole or at a corner"),
    ):
        if wrong.any():
            more = f" ({wrong.sum()} such elements)" if wrong.sum() > 1 else ""
            raise ValueError(
                f"a {cell.name} {reason}: with corners at {spot(*at[t[:, np.argmax(wrong)]])}"
                f"{more}. Mesh this place anew"
            )
    return np.asarray(most < 0.0)


def find_bodies(
    p: FloatArray, t: IntArray, facets: IntArray, t2f: IntArray, at: FloatArray
) -> IntArray:
    """Number of the body of each element, shape (n_elements,).

    Elements that share facets belong to one body; bodies are numbered by their first elements.
    Refused are elements on the same side of a facet, bodies that share a node, and two nodes of
    one body in the same place.
    """
    beside = _beside(p, t, facets, t2f, at)
    joined = beside[:, (beside >= 0).all(axis=0)]
    touching = coo_array((np.ones(joined.shape[1]), tuple(joined)), shape=(t.shape[1],) * 2)
    body = np.asarray(connected_components(touching, directed=False)[1], dtype=np.intp)
    body_of = np.empty(len(at), dtype=np.intp)
    body_of[t] = body
    shared = t[body_of[t] != body]
    if shared.size:
        raise ValueError(
            f"elements only touch in the point {spot(at[shared[0]])}, a hinge: join them along a "
            "whole side, or give them separate nodes"
        )
    nodes = np.unique(facets[:, (beside < 0).any(axis=0)])  # cracks are part of the surface
    size = float(np.ptp(at[nodes], axis=0).max())
    apart = np.column_stack([at[nodes], 2.0 * size * body_of[nodes]])  # bodies may overlap
    double = cKDTree(apart).query(apart, k=2)[0][:, 1] <= TOLERANCE * size
    if double.any():
        raise ValueError(
            f"{double.sum()} nodes of one body lie in one place with another node that is not "
            f"joined to them, the first at {spot(at[nodes[np.argmax(double)]])}: the body would be "
            "cracked there. Merge them (Gmsh: Coherence Mesh), or open the gap if it is meant"
        )
    return body


def _beside(
    p: FloatArray, t: IntArray, facets: IntArray, t2f: IntArray, at: FloatArray
) -> IntArray:
    """Element (2, n_facets) on each side of each facet, -1 where there is none."""
    dim, corners, centre = len(p), p[:, facets], p[:, t].mean(axis=1)
    spans = [corners[:, -1 - i] - corners[:, dim - 2 - i] for i in range(dim - 1)]
    middle = corners.mean(axis=1)
    code = 2 * t2f
    for row, facet in zip(code, t2f, strict=True):
        vectors = np.array([*(span[:, facet] for span in spans), centre - middle[:, facet]])
        row += _det(vectors.transpose(2, 0, 1)) > 0.0
    uses = np.bincount(code.ravel(), minlength=2 * facets.shape[1])
    if uses.max() > 1:
        both = np.flatnonzero((code == np.argmax(uses)).any(axis=0))[:2]
        a, b = (spot(at[t[:, element]].mean(axis=0)) for element in both)
        raise ValueError(
            f"two elements, with centres at {a} and {b}, lie on the same side of what joins them, "
            f"{spot(*at[facets[:, np.argmax(uses) // 2]])}: the mesh branches, folds back or "
            "overlaps itself, or an element is inverted. Bodies over each other must not share "
            "nodes"
        )
    beside = np.full(2 * facets.shape[1], -1, dtype=np.intp)
    beside[code] = np.arange(t.shape[1])
    return beside.reshape(-1, 2).T
