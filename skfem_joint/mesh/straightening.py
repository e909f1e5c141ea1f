"""Change of lengths, areas and volumes where curved edges of elements are made straight.

All elements of this package have straight edges. If those of a file are curved, as Gmsh writes them
around holes, the middle nodes are moved to the middles of the straight edges. An element or facet
of size ``dx`` has the size ``det F dx`` or ``|cof(F) n| dx`` with curved edges. Here ``F`` is
``1 + grad d``, and ``d`` leads from the straight to the curved edges. Both sizes are integrated.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import skfem

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.mesh.cells import CONFORMING, cell_of, split, spot


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
    serendipity = {8: skfem.ElementQuadS2, 20: skfem.ElementHexS2}  # by number of nodes
    element = serendipity.get(len(nodes), cell.elements[1])()
    dofs = skfem.Dofs(mesh, element)
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
        wrong = (apart < least) & (np.arange(len(apart)) != node)[:, np.newaxis]
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
