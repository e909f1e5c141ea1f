"""Curved edges of second-order elements made straight, and what that does to sizes.

Elements here have straight edges. Where a file has curved ones, as Gmsh writes around holes, the
middle nodes move to the middles of the straight edges. Both geometries are integrated: an element
or facet of size ``dx`` has the size ``det F dx`` or ``|cof(F) n| dx`` with its curved edges, where
``F = 1 + grad d`` and ``d`` is the distance of the nodes from where they are put.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import skfem

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.mesh.cells import TOLERANCE, cell_of, split

# Elements without nodes inside their sides and themselves, by number of nodes.
_SERENDIPITY = {8: skfem.ElementQuadS2, 20: skfem.ElementHexS2}
# Order of integration: exact for the volume of all these elements.
_ORDER = 6


@dataclass(frozen=True)
class Straightening:
    """Change of sizes where the curved edges of second-order elements were made straight.

    Attributes
    ----------
    lost : ndarray, shape (n_elements,)
        Area (m2) or volume (m3) of each element with its curved edges, less that with straight
        ones.
    boundaries : dict of str to float
        Length or area with straight edges over that with curved ones, less one, by boundary name.
    """

    lost: FloatArray
    boundaries: dict[str, float]


def straightening(
    mesh: skfem.Mesh, positions: FloatArray, boundaries: Mapping[str, IntArray]
) -> tuple[Straightening | None, list[str]]:
    """Change of sizes where second-order elements are made straight, and a sentence about it.

    Parameters
    ----------
    mesh : skfem.Mesh
        Of first order, the straight one.
    positions : ndarray, shape (dim, nodes, n_elements)
        Nodes of the elements as they were given, m, in the order of scikit-fem's elements of second
        order; quadrilaterals and hexahedra may lack the nodes inside their sides and themselves.
    boundaries : mapping
        Facets of ``mesh`` by name.

    Returns
    -------
    Straightening or None, list of str
        None and no sentence where all edges are straight already.
    """
    straight, nodes, *_ = split(mesh)
    nodes = nodes[: positions.shape[1]]
    offset = positions - straight[:, nodes]
    distance = np.linalg.norm(offset, axis=0)
    curved = distance > TOLERANCE * np.ptp(mesh.p, axis=1).max()
    moved = np.unique(nodes[curved]).size
    if not moved:
        return None, []
    cell, _ = cell_of(mesh)
    element = _SERENDIPITY.get(len(nodes), cell.elements[1])()
    dofs = skfem.Dofs(mesh, element)
    d = np.zeros((len(offset), dofs.N))
    d[:, dofs.element_dofs] = offset
    concerned = curved.any(axis=0)

    def part(kind: Any, **which: IntArray) -> Any:
        return kind(mesh, element, intorder=_ORDER, dofs=dofs, **which)

    lost = np.zeros(mesh.nelements)
    chosen = np.flatnonzero(concerned)
    inside = part(skfem.CellBasis, elements=chosen)
    lost[chosen] = ((np.linalg.det(_gradients(inside, d)) - 1.0) * inside.dx).sum(axis=1)
    changes = {}
    for name, facets in boundaries.items():
        size = skfem.FacetBasis(mesh, cell.elements[0](), facets=facets, intorder=_ORDER).dx.sum()
        bent = facets[concerned[mesh.f2t[0, facets]]]
        more = 0.0
        if bent.size:
            side = part(skfem.FacetBasis, facets=bent)
            normals = np.moveaxis(np.asarray(side.normals), 0, -1)[..., np.newaxis]
            stretch = np.linalg.norm(_cofactors(_gradients(side, d)) @ normals, axis=(-2, -1))
            more = ((stretch - 1.0) * side.dx).sum()
        changes[name] = float(size / (size + more) - 1.0)
    whole = float(skfem.CellBasis(mesh, cell.elements[0](), intorder=_ORDER).dx.sum())
    change = whole / (whole + lost.sum()) - 1.0
    note = (
        f"{moved} {'node' if moved == 1 else 'nodes'} of curved edges moved to the middles of "
        f"straight ones, by {distance.max():.3g} m at most. That changes the {cell.measure} of the "
        f"mesh by {round(100.0 * change, 6):.2g} %."
    )
    return Straightening(lost, changes), [note]


def together(parts: Sequence[tuple[int, Straightening | None]]) -> Straightening | None:
    """Change of sizes of several meshes in one, from the number of elements and change of each."""
    known = [part for _, part in parts if part is not None]
    if not known:
        return None
    return Straightening(
        np.concatenate([np.zeros(n) if part is None else part.lost for n, part in parts]),
        {name: change for part in known for name, change in part.boundaries.items()},
    )


def _gradients(part: Any, d: FloatArray) -> FloatArray:
    """``1 + grad d`` at the points of a basis, (elements, points, dim, dim)."""
    grad = np.array([part.interpolate(row).grad for row in d])
    return np.asarray(np.moveaxis(grad, (0, 1), (2, 3)) + np.eye(len(d)))


def _cofactors(F: FloatArray) -> FloatArray:
    """Cofactors of matrices (..., dim, dim) of two or three dimensions, which may be singular."""
    if F.shape[-1] == 2:
        return np.stack(
            [
                np.stack([F[..., 1, 1], -F[..., 1, 0]], axis=-1),
                np.stack([-F[..., 0, 1], F[..., 0, 0]], axis=-1),
            ],
            axis=-2,
        )
    return np.stack([np.cross(F[..., i - 2, :], F[..., i - 1, :]) for i in range(3)], axis=-2)
