"""Change of lengths, areas and volumes where curved edges of elements are made straight.

All elements of this package have straight edges. If those of a file are curved, as Gmsh writes them
around holes, the middle nodes are moved to the middles of the straight edges. Sizes with curved
edges are those of scikit-fem's meshes of second order.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import skfem

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.mesh.cells import CONFORMING, Cell, cell_of, split, spot

#: Meshes with curved edges, by the kind of their elements.
_CURVED = {
    "triangle": skfem.MeshTri2,
    "quadrilateral": skfem.MeshQuad2,
    "tetrahedron": skfem.MeshTet2,
    "hexahedron": skfem.MeshHex2,
}
#: Elements without nodes inside of them and of their sides, by number of nodes.
_SERENDIPITY = {8: skfem.ElementQuadS2, 20: skfem.ElementHexS2}


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
    straight, every, *_ = split(mesh)
    nodes = every[: positions.shape[1]]
    offset = positions - straight[:, nodes]
    distance = np.linalg.norm(offset, axis=0)
    curved = distance > CONFORMING * np.ptp(mesh.p[:, mesh.t], axis=1).max(axis=0)
    moved = np.unique(nodes[curved]).size
    if not moved:
        return []
    concerned = curved.any(axis=0)
    _check_order(positions[:, :, concerned], straight[:, nodes[:, concerned]])
    cell, _ = cell_of(mesh)
    curves = _CURVED[cell.name](_completed(cell, straight, every, positions), mesh.t, sort_t=False)
    at = {"elem": cell.elements[0](), "intorder": 6}  # exact for the volume of all these elements
    bent = np.flatnonzero(concerned)
    lost, gained = (skfem.CellBasis(x, elements=bent, **at).dx.sum() for x in (mesh, curves))
    whole = float(skfem.CellBasis(mesh, **at).dx.sum())
    changes = {f"the {cell.measure} of the mesh": whole / (whole - lost + gained) - 1.0}
    size_of_sides = ("length", "area")[cell.dim - 2]
    for name, facets in boundaries.items():
        size, curved_size = (
            skfem.FacetBasis(x, facets=facets, **at).dx.sum() for x in (mesh, curves)
        )
        changes[f"the {size_of_sides} of {name!r}"] = float(size / curved_size - 1.0)
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


def _completed(
    cell: Cell, straight: FloatArray, nodes: IntArray, positions: FloatArray
) -> FloatArray:
    """Positions (dim, N) of all nodes of second order; missing ones follow from the others.

    ``straight`` (dim, N) are those with straight edges, ``nodes`` (all, n) the nodes of the
    elements.
    """
    x, known = straight.copy(), positions.shape[1]
    x[:, nodes[:known]] = positions
    if known in _SERENDIPITY:
        element, places = _SERENDIPITY[known](), cell.elements[1].doflocs[known:].T
        shapes = np.array([element.lbasis(places, i)[0] for i in range(known)])
        x[:, nodes[known:]] = np.einsum("dkn,km->dmn", positions, shapes)
    return x
