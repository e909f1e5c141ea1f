"""Elements of several kinds in one mesh of scikit-fem: triangles and prisms as collapsed elements.

A mesh of scikit-fem has elements of one kind. A triangle is a quadrilateral, and a prism a
hexahedron, with corners that coincide::

    triangle       (a, b, c, c)                     an edge collapsed
    prism          (a, b, c, c; d, e, f, f)         two edges, and the side between them, collapsed

In local coordinates r and s of the quadrilateral the functions of its corners are those of the
triangle, ``(1 - r)(1 - s)``, ``r (1 - s)`` and ``s (1 - r) + s r = s``, as s is its third area
coordinate: collapsed elements of first order *are* the linear triangle and prism, and their
matrices are added to those of the others by the usual assembly. The Jacobian determinant has the
factor ``1 - s``, by which integrals over them need one more degree; it vanishes at the collapsed
edge alone, where Gauss's points do not lie. Sides are collapsed quadrilaterals in the same way.

Of second order, all nodes of a collapsed edge or side coincide. The functions of a triangle are
then the six quadratic ones and one inner function ``r (1 - r) s (1 - s)``, those of a prism their
products with the three along it: they include all quadratic ones and meet those of the elements
beside. `dofs_of` counts the nodes that coincide once.

So that two prisms which share a triangle collapse it at the same corner, each is turned about its
axis (`turned_alike`); the sides that both have are then the same to scikit-fem.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import skfem
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.mesh.cells import CELLS, Cell, cell_of, corner_count, same_columns, spot


def joined(parts: Sequence[tuple[Cell, IntArray]]) -> tuple[Cell, IntArray]:
    """Kind and vertices of a mesh of all elements, in their order.

    Parameters
    ----------
    parts : sequence of (Cell, ndarray of int, shape (corners, n))
        Kinds and vertices of the elements.

    Raises
    ------
    ValueError
        For kinds that do not go together.
    """
    cells = [cell for cell, _ in parts]
    hosts = {cell.host or cell.name for cell in cells}
    if len({cell.name for cell in cells}) == 1 and cells[0].elements[1:]:
        return cells[0], np.hstack([t for _, t in parts])
    if len(hosts) > 1:
        names = " and ".join(dict.fromkeys(cell.plural for cell in cells))
        raise ValueError(
            f"{names} cannot stand in one mesh: hexahedra and prisms can, and so can "
            "quadrilaterals and triangles. Mesh all bodies with those, or with tetrahedra"
        )
    host = CELLS[hosts.pop()]
    return host, np.hstack([t if cell is host else t[list(cell.at)] for cell, t in parts])


class ElementsOfKind(NamedTuple):
    """Elements of one kind in a mesh.

    Attributes
    ----------
    kind : Cell
    elements : ndarray of int, shape (n,)
        Their numbers.
    corners : ndarray of int, shape (corners, n)
        Their own vertices, each once.
    """

    kind: Cell
    elements: IntArray
    corners: IntArray


def parts_of(cell: Cell, t: IntArray) -> list[ElementsOfKind]:
    """Elements of a mesh by their kind, that of the mesh first.

    Parameters
    ----------
    cell : Cell
        Kind of the mesh.
    t : ndarray of int, shape (corners, n)
        Vertices of the elements.

    Raises
    ------
    ValueError
        For an element with other corners in one place than collapsed ones have.
    """
    every, some = np.arange(t.shape[1]), is_collapsed(cell, t)
    if not some.any():
        return [ElementsOfKind(cell, every, t)]
    found = [ElementsOfKind(cell, every[~some], t[:, ~some])] if not some.all() else []
    kind = _collapsed_kind(cell)
    own = t[[kind.at.index(corner) for corner in range(max(kind.at) + 1)]][:, some]
    other = (own[list(kind.at)] != t[:, some]).any(axis=0) | (corner_count(own) < len(own))
    if other.any():
        vertices = ", ".join(map(str, t[:, every[some][np.argmax(other)]]))
        raise ValueError(
            f"a {cell.name} with vertices {vertices} has corners in one place, and not those that "
            f"make a {kind.name} of it"
        )
    return [*found, ElementsOfKind(kind, every[some], own)]


def is_collapsed(cell: Cell, t: IntArray) -> BoolArray:
    """Whether each element with vertices t (corners, n) is a collapsed one."""
    if not any(kind.host == cell.name for kind in CELLS.values()):
        return np.zeros(t.shape[1], dtype=np.bool_)
    at = _collapsed_kind(cell).at
    pairs = ((i, j) for i, j in combinations(range(len(at)), 2) if at[i] == at[j])
    return np.asarray(np.any([t[i] == t[j] for i, j in pairs], axis=0))


def _collapsed_kind(cell: Cell) -> Cell:
    """Kind whose elements are collapsed ones of a kind."""
    return next(kind for kind in CELLS.values() if kind.host == cell.name)


def turned_alike(prisms: IntArray, xyz: FloatArray) -> IntArray:
    """Prisms (6, n) turned about their axes, so that those that share a triangle turn alike.

    Edges along the axis are joined over shared triangles. Each prism gets the edge of the largest
    set of joined ones last. ``xyz`` are the positions of the vertices, for a message.
    """
    n = prisms.shape[1]
    triangles = np.hstack([prisms[:3], prisms[3:]])
    order = np.argsort(triangles, axis=0)
    edge = np.tile(np.arange(3 * n).reshape(3, n), 2)  # along the axis, at each corner
    edge = np.take_along_axis(edge, order, axis=0)
    first, set_of = same_columns(np.take_along_axis(triangles, order, axis=0))
    ends = edge.ravel(), edge[:, first[set_of]].ravel()
    links = coo_array((np.ones(6 * n), ends), shape=(3 * n, 3 * n))
    joined_edges = connected_components(links, directed=False)[1].reshape(3, n)
    twisted = corner_count(joined_edges) < 3
    if twisted.any():
        raise ValueError(
            f"prisms form a closed ring that is twisted, one with corners at "
            f"{spot(*xyz[prisms[:, np.argmax(twisted)]])}: mesh the ring with hexahedra"
        )
    last = joined_edges.argmax(axis=0)
    turn = (np.arange(3)[:, np.newaxis] + last + 1) % 3
    return np.take_along_axis(prisms, np.vstack([turn, turn + 3]), axis=0)


def dofs_of(mesh: skfem.Mesh, element: Any) -> skfem.Dofs:
    """Degrees of freedom of a scalar element: its nodes, of which those in one place are one.

    Parameters
    ----------
    mesh : skfem.Mesh
    element : skfem.Element
        Of first or second order.
    """
    dofs = skfem.Dofs(mesh, element)
    cell = cell_of(mesh)[0]
    some = is_collapsed(cell, mesh.t)
    if not some.any() or len(element.doflocs) == len(mesh.t):
        return dofs
    places = _collapsed_kind(cell).collapsed_places
    apart = np.abs(places[:, np.newaxis] - places).max(axis=-1)
    same = np.argmax(apart < 1e-9, axis=1)  # first node in the same place
    at = np.arange(dofs.N)
    own = dofs.element_dofs[:, some]
    at[own] = own[same]
    kept, number = np.unique(at, return_inverse=True)
    for name in ("nodal_dofs", "edge_dofs", "facet_dofs", "interior_dofs", "element_dofs"):
        table = getattr(dofs, name)
        setattr(dofs, name, number[table].astype(table.dtype) if table.size else table)
    dofs.N = kept.size
    return dofs
