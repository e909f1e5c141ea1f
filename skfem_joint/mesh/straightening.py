"""Change of lengths, areas and volumes where curved edges of elements are made straight.

All elements of this package have straight edges. If those of a file are curved, as Gmsh writes them
around holes, the middle nodes are moved to the middles of the straight edges. An element or facet
of size ``dx`` has the size ``det F dx`` or ``|cof(F) n| dx`` with curved edges. Here ``F`` is
``1 + grad d``, and ``d`` leads from the straight to the curved edges. Both sizes are integrated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import skfem

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.mesh.cells import CONFORMING, Cell, cell_of, spot
from skfem_joint.mesh.collapsed import dofs_of
from skfem_joint.mesh.splitting import split

#: Elements without nodes inside of faces and cells, by their number of nodes.
_SERENDIPITY = {8: skfem.ElementQuadS2, 20: skfem.ElementHexS2}


def at_nodes_of(cell: Cell, given: Sequence[tuple[Cell, FloatArray]]) -> FloatArray:
    """Positions at the nodes of the elements of second order of a mesh, (dim, nodes, n).

    Parameters
    ----------
    cell : Cell
        Kind of the mesh.
    given : sequence of (Cell, ndarray of shape (dim, nodes, n))
        Kinds of the elements, in their order, and positions of their own nodes in the order of
        scikit-fem; those of prisms and of triangles beside quadrilaterals in the order of VTK.
    """
    if all(kind is cell for kind, _ in given) and len({x.shape[1] for _, x in given}) == 1:
        return np.concatenate([x for _, x in given], axis=2)
    return np.concatenate([_at_nodes(cell, kind, x) for kind, x in given], axis=2)


def _at_nodes(cell: Cell, kind: Cell, x: FloatArray) -> FloatArray:
    """Positions at the nodes of a mesh's element from those of an element of some kind."""
    places = kind.collapsed_places if kind is not cell else cell.elements[1].doflocs
    if kind.name == "prism":  # products of functions of a triangle and of a line
        triangle, line = skfem.ElementTriP2(), skfem.ElementLineP2()
        across = np.array([triangle.lbasis(places.T[:2], i)[0] for i in range(6)])
        along = np.array([line.lbasis(places.T[2:], i)[0] for i in range(3)])
        weights = np.array([across[i] * along[j] for j in range(3) for i in range(6)])
        if x.shape[1] == 15:
            x = np.concatenate([x, _middles_of_sides(x)], axis=1)
        x = x[:, [0, 1, 2, 6, 7, 8, 3, 4, 5, 9, 10, 11, 12, 13, 14, 15, 16, 17]]
    else:
        element = _SERENDIPITY.get(x.shape[1], kind.elements[1])()
        weights = np.array([element.lbasis(places.T, i)[0] for i in range(x.shape[1])])
    return np.asarray(np.einsum("cin,ij->cjn", x, weights))


def _middles_of_sides(x: FloatArray) -> FloatArray:
    """Middles (dim, 3, n) of the quadrilateral sides of prisms of 15 nodes (dim, 15, n)."""
    first, next_ = [0, 1, 2], [1, 2, 0]
    corners = sum(x[:, np.add(at, shift)] for at in (first, next_) for shift in (0, 3))
    edges = x[:, 6:9] + x[:, 9:12] + x[:, 12:15] + x[:, 12:15][:, next_]
    return np.asarray(0.5 * edges - 0.25 * corners)


def straightening(
    mesh: skfem.Mesh, positions: FloatArray, boundaries: Mapping[str, IntArray]
) -> list[str]:
    """Sentences about sizes that change as edges of second-order elements are made straight.

    Parameters
    ----------
    mesh : skfem.Mesh
        Mesh of first order with straight edges.
    positions : ndarray, shape (dim, nodes, n_elements)
        Given nodes of the elements, m, in the order of scikit-fem's second-order element. Those
        inside quadrilaterals, and inside hexahedra and their sides, may be missing.
    boundaries : mapping
        Facets of ``mesh`` by name.

    There are none if all edges are straight already.
    """
    straight, nodes, *_ = split(mesh)
    nodes = nodes[: positions.shape[1]]
    offset = positions - straight[:, nodes]
    distance = np.linalg.norm(offset, axis=0)
    curved = distance > CONFORMING * np.ptp(mesh.p[:, mesh.t], axis=1).max(axis=0)
    moved = np.unique(nodes[curved]).size
    if not moved:
        return []
    concerned = curved.any(axis=0)
    _check_order(positions[:, :, concerned], straight[:, nodes[:, concerned]])
    cell, _ = cell_of(mesh)
    element = _SERENDIPITY.get(len(nodes), cell.elements[1])()
    dofs = dofs_of(mesh, element)
    d = np.zeros((len(offset), dofs.N))
    d[:, dofs.element_dofs] = offset

    intorder = 6  # exact for the volume of all these elements
    inside = skfem.CellBasis(
        mesh, element, intorder=intorder, elements=np.flatnonzero(concerned), dofs=dofs
    )
    lost = float(((np.linalg.det(_gradients(inside, d)) - 1.0) * inside.dx).sum())
    whole = float(skfem.CellBasis(mesh, cell.elements[0](), intorder=intorder).dx.sum())
    changes = {f"the {cell.measure} of the mesh": whole / (whole + lost) - 1.0}
    size_of_sides = ("length", "area")[cell.dim - 2]
    for name, facets in boundaries.items():
        straight_side = skfem.FacetBasis(mesh, cell.elements[0](), facets=facets, intorder=intorder)
        size, more = straight_side.dx.sum(), 0.0
        bent = facets[concerned[mesh.f2t[0, facets]]]
        if bent.size:
            side = skfem.FacetBasis(mesh, element, intorder=intorder, facets=bent, dofs=dofs)
            normals = np.moveaxis(np.asarray(side.normals), 0, -1)[..., np.newaxis]
            stretch = np.linalg.norm(_cofactors(_gradients(side, d)) @ normals, axis=(-2, -1))
            more = ((stretch - 1.0) * side.dx).sum()
        changes[f"the {size_of_sides} of {name!r}"] = float(size / (size + more) - 1.0)
    by_how_much = [f"{what} by {100.0 * x:.2g} %" for what, x in changes.items() if abs(x) > 1e-9]
    notes = [
        f"{moved} {'node' if moved == 1 else 'nodes'} of curved edges moved to the middles of "
        f"straight ones, by {distance.max():.3g} m at most, which changes "
        f"{', '.join(by_how_much) or 'no size'}."
    ]
    much = [what for what, x in changes.items() if abs(x) > 0.01]
    if much:
        notes.append(
            f"Straight edges in place of curved ones change {', '.join(much)} by more than 1 %: "
            "use smaller elements there (in Gmsh Mesh.MeshSizeFromCurvature = 36, elements a turn)."
        )
    return notes


def _check_order(positions: FloatArray, straight: FloatArray) -> None:
    """Refuse elements with a node in a place of another node (dim, nodes, n) of the same element.

    Files of other programs, converted without care, have middle nodes in another order.
    """
    least = CONFORMING * np.ptp(straight, axis=1).max(axis=0)
    for node in range(positions.shape[1]):
        apart = np.linalg.norm(straight - positions[:, [node]], axis=0)
        own = (straight == straight[:, [node]]).all(axis=0)  # of collapsed elements several
        wrong = (apart < least) & ~own
        if wrong.any():
            element = positions[:, node, np.argmax(wrong.any(axis=0))]
            raise ValueError(
                f"the node at {spot(element)} does not lie on the edge that its place in an "
                "element of second order asks for, but on another one: the nodes between the "
                "corners have the order of another program. Write them in Gmsh's order (Abaqus and "
                "VTK write the last two of ten-node tetrahedra the other way round, and those of "
                "hexahedra otherwise), or elements of first order"
            )


def _gradients(part: Any, d: FloatArray) -> FloatArray:
    """``F = 1 + grad d`` at the quadrature points, shape (elements, points, dim, dim)."""
    grad = np.array([part.interpolate(row).grad for row in d])
    return np.asarray(np.moveaxis(grad, (0, 1), (2, 3)) + np.eye(len(d)))


def _cofactors(F: FloatArray) -> FloatArray:
    """Cofactors of matrices of shape (..., dim, dim), which may be singular.

    The rows of a 3 x 3 cofactor matrix are vector products of rows of F. A 2 x 2 matrix is a block
    of a 3 x 3 matrix.
    """
    dim = F.shape[-1]
    whole = np.broadcast_to(np.eye(3), (*F.shape[:-2], 3, 3)).copy()
    whole[..., :dim, :dim] = F
    rows = [np.cross(whole[..., i - 2, :], whole[..., i - 1, :]) for i in range(3)]
    return np.stack(rows, axis=-2)[..., :dim, :dim]
