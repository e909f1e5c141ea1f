"""Kinds of elements, with scikit-fem's meshes and elements, and the checks that all meshes pass.

A check raises ValueError, which states place and reason. In all functions

- ``p``, shape (dim, n_vertices), are the positions of the vertices in the dimension of the mesh, m;
- ``xyz``, shape (n_vertices, 3), are their positions in space, m;
- ``t``, shape (corners, n_elements), are the vertices of the elements;
- ``facets``, shape (corners, n_facets), are the vertices of the facets;
- ``t2f``, shape (sides, n_elements), are the facets of the elements.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain, combinations
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray

#: Share of the mesh's size below which two positions are the same, and a bar or plane is straight.
TOLERANCE = 1e-9
#: Share of an edge below which distances come from coordinates that a file has rounded.
CONFORMING = 5e-4


@dataclass(frozen=True)
class Cell:
    """Kind of element.

    Attributes
    ----------
    name : str
        Name of the kind, such as "triangle".
    mesh : type
        Mesh of first order in scikit-fem.
    elements : tuple of type
        Scalar elements of first and second order in scikit-fem; their degrees of freedom are the
        nodes. Prisms have the first alone.
    mirrored : tuple of int
        Order of the corners that mirrors the element.
    sign : int
        Sign of scikit-fem's Jacobian determinant for an element whose corners have the order of
        Gmsh.
    gmsh : tuple of int
        Order in which Gmsh numbers the nodes of scikit-fem's second-order element, as far as it has
        them; () for the same order.
    host : str
        Kind that this one is a collapsed element of, see `skfem_joint.mesh.collapsed`; "" if there
        is none.
    at : tuple of int
        Corner of this element that stands at each corner of the host's.
    """

    name: str
    mesh: Any
    elements: tuple[Any, ...]
    mirrored: tuple[int, ...]
    sign: int = 1
    gmsh: tuple[int, ...] = ()
    host: str = ""
    at: tuple[int, ...] = ()

    @property
    def dim(self) -> int:
        """Dimension of the element."""
        return int(self.elements[0].refdom.dim())

    @property
    def bends(self) -> bool:
        """Whether elements of first order can have modes by which they bend."""
        return self.name in ("quadrilateral", "hexahedron")

    @property
    def corners(self) -> int:
        """Number of corners."""
        return len(self.mirrored)

    @property
    def corners_of_sides(self) -> set[int]:
        """Numbers of corners that sides of the element have."""
        return {len(set(side)) for side in self.elements[0].refdom.facets}

    @property
    def plural(self) -> str:
        """Name of several of them."""
        return f"{self.name}s".replace("hedrons", "hedra")

    @property
    def measure(self) -> str:
        """Word for the size of an element."""
        return ("length", "area", "volume")[self.dim - 1]

    @property
    def collapsed_places(self) -> FloatArray:
        """Own local places of the nodes of the host's element of second order, (nodes, dim)."""
        first, second = CELLS[self.host].elements
        weights = [first().lbasis(second.doflocs.T, i)[0] for i in range(len(self.at))]
        return np.asarray(np.transpose(weights) @ self.elements[0].doflocs[list(self.at)])

    def facets(self, t: IntArray, n_vertices: int) -> tuple[IntArray, IntArray]:
        """Vertices of each facet and facets of each element, numbered as scikit-fem does."""
        if self.dim == 1:  # facets are the vertices: no sorting of millions of numbers
            return np.arange(n_vertices)[np.newaxis], t
        facets, t2f = skfem.Mesh.build_entities(t, self.elements[0].refdom.facets, sort=False)
        return np.asarray(facets, dtype=np.intp), np.asarray(t2f, dtype=np.intp)


#: Kinds of elements by name.
CELLS = {
    cell.name: cell
    for cell in (
        Cell("line", skfem.MeshLine1, (skfem.ElementLineP1, skfem.ElementLineP2), (1, 0)),
        Cell(
            "triangle",
            skfem.MeshTri1,
            (skfem.ElementTriP1, skfem.ElementTriP2),
            (0, 2, 1),
            host="quadrilateral",
            at=(0, 1, 2, 2),
        ),
        Cell(
            "quadrilateral", skfem.MeshQuad1, (skfem.ElementQuad1, skfem.ElementQuad2), (0, 3, 2, 1)
        ),
        Cell(
            "tetrahedron",
            skfem.MeshTet1,
            (skfem.ElementTetP1, skfem.ElementTetP2),
            (0, 2, 1, 3),
            gmsh=(0, 1, 2, 3, 4, 5, 6, 7, 9, 8),
        ),
        Cell(
            "hexahedron",
            skfem.MeshHex1,
            (skfem.ElementHex1, skfem.ElementHex2),
            (1, 0, 4, 5, 2, 3, 7, 6),
            sign=-1,
            gmsh=(
                *(0, 3, 6, 2, 1, 5, 7, 4, 10, 9, 8, 16, 15, 14, 19, 13, 12, 11, 18, 17),
                *(21, 22, 20, 25, 23, 24, 26),
            ),
        ),
        Cell(
            "prism",
            skfem.MeshWedge1,
            (skfem.ElementWedge1,),
            (3, 4, 5, 0, 1, 2),
            host="hexahedron",
            at=(0, 3, 2, 1, 5, 4, 2, 5),
        ),
    )
}


def cell_of(mesh: skfem.Mesh) -> tuple[Cell, int]:
    """Kind of the elements of a scikit-fem mesh, and their order; ValueError for other kinds."""
    for cell in CELLS.values():
        if mesh.elem in cell.elements and len(mesh.p) == cell.dim:
            return cell, 1 + cell.elements.index(mesh.elem)
    raise ValueError(
        f"{type(mesh).__name__} with {len(mesh.p)} coordinates is not a mesh of "
        f"{', '.join(CELLS)} elements of first or second order in their own dimension"
    )


def corner_count(columns: IntArray) -> IntArray:
    """Number of different vertices in each column (corners, n), of which some stand twice."""
    return np.asarray(1 + (np.diff(np.sort(columns, axis=0), axis=0) != 0).sum(axis=0))


def distinct(columns: IntArray) -> IntArray:
    """Columns (corners, n) sorted, with vertices that stand twice replaced by -1 at the end."""
    ordered = np.sort(columns, axis=0)
    ordered[1:][ordered[1:] == ordered[:-1]] = np.iinfo(ordered.dtype).max
    ordered.sort(axis=0)
    ordered[ordered == np.iinfo(ordered.dtype).max] = -1
    return ordered


def same_columns(a: NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Index of the first column of each set of equal columns, and the number of each column's set.

    The sets are sorted by the columns' content, as by ``numpy.unique(a, axis=1)``, which takes much
    longer for the facets of a large mesh.
    """
    order = np.lexsort(a[::-1])
    new = np.ones(order.size, dtype=np.bool_)
    new[1:] = (np.diff(a[:, order], axis=1) != 0).any(axis=0)
    set_of = np.empty(order.size, dtype=np.intp)
    set_of[order] = np.cumsum(new) - 1
    return order[new], set_of


def repeated(elements: IntArray, corners: IntArray | int) -> tuple[int, int] | None:
    """First element, by its nodes (n, nodes), that has the corners of an earlier one, and that one.

    ``corners``, of all or of each element, (n,), says how many of its first nodes are corners.
    """
    others = np.arange(elements.shape[1]) >= np.reshape(corners, (-1, 1))
    first, set_of = same_columns(np.sort(np.where(others, -1, elements), axis=1).T)
    if first.size == len(elements):
        return None
    again = int(np.argmax(first[set_of] != np.arange(len(elements))))
    return again, int(first[set_of[again]])


def _det(matrices: FloatArray) -> FloatArray:
    """Determinants of matrices (n, dim, dim)."""
    return matrices[:, 0, 0] if matrices.shape[1] == 1 else np.linalg.det(matrices)


def spot(*positions: FloatArray) -> str:
    """Positions (m) as text for a message."""
    texts = (", ".join(f"{value:.9g}" for value in position) for position in positions)
    return " to ".join(f"({text}) m" for text in texts)


def check_shapes(cell: Cell, p: FloatArray, t: IntArray, xyz: FloatArray) -> BoolArray:
    """Refuse elements that have no size, are not convex or cross themselves.

    The Jacobian determinant must have the same sign at all nodes of the second-order element.

    Returns
    -------
    ndarray of bool, shape (n_elements,)
        Whether each element is mirrored.
    """
    size = float(np.ptp(p, axis=1).max())
    if size < 1e-20:
        raise ValueError(f"the mesh is {size:.3g} m in size: it must be 1e-20 m or more")
    pairs = combinations(range(len(t)), 2)
    lengths = [np.linalg.norm(p[:, t[i]] - p[:, t[j]], axis=0) for i, j in pairs]
    places = cell.elements[1].doflocs if cell.elements[1:] else cell.collapsed_places
    if len(t) == cell.dim + 1:
        places = places[:1]  # the Jacobian of a simplex is constant
    element, shape = cell.elements[0](), (cell.dim, len(places))
    slopes = [np.broadcast_to(element.lbasis(places.T, i)[1], shape) for i in range(len(t))]
    jacobians = (
        np.einsum("icn,cj->nij", p[:, t], slope) for slope in np.moveaxis(np.array(slopes), 2, 0)
    )
    determinants = cell.sign * np.array([_det(jacobian) for jacobian in jacobians])
    least, most = determinants.min(axis=0), determinants.max(axis=0)
    thin = TOLERANCE * np.max(lengths, axis=0) ** cell.dim
    for wrong, reason in (
        (np.min(lengths, axis=0) <= TOLERANCE * size, "has two corners in one place"),
        ((least < -thin) & (most > thin), "crosses itself or is not convex"),
        (
            np.abs(determinants).min(axis=0) <= thin,
            f"has no {cell.measure}, as a whole or at a corner",
        ),
    ):
        if wrong.any():
            more = f" ({wrong.sum()} such elements)" if wrong.sum() > 1 else ""
            raise ValueError(
                f"a {cell.name} {reason}: with corners at {spot(*xyz[t[:, np.argmax(wrong)]])}"
                f"{more}. Mesh this place anew"
            )
    return np.asarray(most < 0.0)


def find_bodies(
    p: FloatArray,
    t: IntArray,
    facets: IntArray,
    t2f: IntArray,
    xyz: FloatArray,
    regions: Mapping[str, IntArray],
) -> IntArray:
    """Number of the body of each element, shape (n_elements,).

    Elements that share facets belong to the same body. Bodies are numbered by their first elements.
    Refused are elements on the same side of a facet, nodes that hang on sides of other elements of
    their body, bodies that share a node, and two nodes of a body in the same place. ``regions`` are
    the elements of each region, for messages.
    """
    beside = _beside(p, t, facets, t2f, xyz)
    joined = beside[:, (beside >= 0).all(axis=0)]
    touching = coo_array((np.ones(joined.shape[1]), tuple(joined)), shape=(t.shape[1],) * 2)
    body = np.asarray(connected_components(touching, directed=False)[1], dtype=np.intp)
    body_of = np.empty(len(xyz), dtype=np.intp)
    body_of[t] = body
    whole = body  # bodies that share nodes count as one
    shared = t[body_of[t] != body]
    if shared.size:
        n, ends = body.max() + 1, (body_of[t].ravel(), np.tile(body, len(t)))
        links = coo_array((np.ones(t.size), ends), shape=(n, n))
        whole = np.asarray(connected_components(links, directed=False)[1])[body]
    if len(p) > 1:  # in a bar elements of which none branches or folds back only share ends
        _check_conforming(p, t, facets, beside, whole, xyz, regions)
    if shared.size:
        raise ValueError(
            f"elements only touch in the point {spot(xyz[shared[0]])}, a hinge: join them along a "
            "whole side, or give them separate nodes"
        )
    return body


def pieces(mesh: skfem.Mesh) -> int:
    """Number of parts of a mesh whose elements share facets; bodies may share less inside."""
    first, second = mesh.f2t[:, (mesh.f2t[1] >= 0) & (corner_count(mesh.facets) >= mesh.dim())]
    n = mesh.nelements
    shared = coo_array((np.ones(first.size), (first, second)), shape=(n, n))
    return int(connected_components(shared, directed=False)[0])


def _check_conforming(
    p: FloatArray,
    t: IntArray,
    facets: IntArray,
    beside: IntArray,
    body: IntArray,
    xyz: FloatArray,
    regions: Mapping[str, IntArray],
) -> None:
    """Refuse nodes on sides of elements of their body of which they are no corners.

    Such a node hangs on an edge or face, or lies in one place with a corner. Both can only be where
    facets belong to one element, as cracks do.
    """
    lone = np.flatnonzero((beside >= 0).sum(axis=0) == 1)
    sides, element = facets[:, lone], beside[:, lone].max(axis=0)
    _check_kinds_of_sides(sides, xyz)
    nodes = np.unique(sides)
    places = cKDTree(p.T[nodes])
    body_of = np.empty(len(xyz), dtype=np.intp)
    body_of[t] = body
    pairs = combinations(t[:, element], 2)
    lengths = [np.linalg.norm(p[:, a] - p[:, b], axis=0) for a, b in pairs]
    shortest = np.min(lengths, axis=0, where=np.array(lengths) > 0.0, initial=np.inf)
    reach = CONFORMING * shortest
    found: list[IntArray] = []
    for part in np.array_split(np.arange(lone.size), 1 + lone.size // 5000):  # bounds the memory
        corners = sides[:, part]
        side, near = within_reach(p.T[corners.T], places, reach[part], len(corners))
        node = nodes[near]
        other = body_of[node] == body[element[part[side]]]
        other &= (corners[:, side] != node).all(axis=0)
        side, node = side[other], node[other]
        foot = nearest_places(p.T[corners[:, side].T], p.T[node])
        on = np.linalg.norm(foot - p.T[node], axis=1) <= reach[part[side]]
        found.append(np.array([node[on], part[side[on]]]))
    node, side = np.hstack(found)
    if not node.size:
        return
    to_corner = np.linalg.norm(p[:, sides[:, side]] - p[:, np.newaxis, node], axis=0).min(axis=0)
    hangs = to_corner > reach[side]
    if not hangs.any():
        raise ValueError(
            f"{np.unique(node).size} nodes of one body lie in one place with another node that is "
            f"not joined to them, the first at {spot(xyz[node.min()])}: the body would be cracked "
            "there. Merge them (Gmsh: Coherence Mesh), or open the gap if it is meant"
        )
    count, first = np.unique(node[hangs]).size, node[hangs].min()
    side = side[hangs & (node == first)][0]
    within = ", ".join(repr(n) for n, chosen in regions.items() if np.isin(element[side], chosen))
    raise ValueError(
        f"node {first} at {spot(xyz[first])} hangs on a side of element {element[side]}"
        f"{f' of region {within}' if within else ''}, from {spot(*xyz[sides[:, side]])}: it is no "
        f"corner of it, and the body would open there ({count} such nodes). Divide both sides of "
        "this place alike, so that elements meet corner to corner; mesh bodies in contact with "
        f"nodes of their own; open a gap that is meant by more than {reach[side]:.2g} m"
    )


def _check_kinds_of_sides(sides: IntArray, xyz: FloatArray) -> None:
    """Refuse a triangle that lies on half a quadrilateral; ``sides`` are those of one element."""
    if len(sides) < 4:
        return
    count = corner_count(sides)
    whole, half = sides[:, count == 4], distinct(sides[:, count == 3])[:3]
    if not (whole.size and half.size):
        return
    halves = [np.sort(np.delete(whole, i, axis=0), axis=0) for i in range(4)]
    first, set_of = same_columns(np.hstack([*halves, half]))
    lies = first[set_of[4 * whole.shape[1] :]] < 4 * whole.shape[1]
    if lies.any():
        raise ValueError(
            f"the triangle {spot(*xyz[half[:, np.argmax(lies)]])} lies on half a quadrilateral of "
            f"another element ({lies.sum()} such sides): the body would open there. Mesh this "
            "place so that triangles meet triangles, and quadrilaterals quadrilaterals"
        )


def outward(corners: FloatArray, centres: FloatArray) -> FloatArray:
    """Normals (k, dim) of sides with corners (k, corners, dim), of the size of each side.

    ``centres`` (k, dim) are those of the elements that the normals point out of.
    """
    if corners.shape[-1] == 2:
        normals = (corners[:, 1] - corners[:, 0])[:, ::-1] * [1.0, -1.0]
    else:  # half the cross product of the diagonals; in a triangle, of two sides
        diagonals = corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1]
        normals = 0.5 * np.cross(*diagonals)
    away = np.einsum("kc,kc->k", normals, corners.mean(axis=1) - centres)
    return np.asarray(normals * np.sign(away)[:, np.newaxis])


def within_reach(
    corners: FloatArray, points: cKDTree, reach: FloatArray, crowded: int = 0
) -> tuple[IntArray, IntArray]:
    """Pairs of cells, with corners (n, corners, dim), and of points that may be near.

    They hold all points that are no farther than ``reach`` (n,) from a cell, and some more. Cells
    with no more than ``crowded`` points have none.
    """
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, np.newaxis], axis=-1).max(axis=1)
    radius = (1.0 + TOLERANCE) * radius + reach
    counts = points.query_ball_point(middle, radius, return_length=True)
    cells = np.flatnonzero(counts > crowded)
    members = points.query_ball_point(middle[cells], radius[cells])
    return np.repeat(cells, counts[cells]), np.fromiter(chain.from_iterable(members), np.intp)


def nearest_places(corners: FloatArray, points: FloatArray) -> FloatArray:
    """Nearest place in each of k cells to the point (k, dim) that is given for it.

    Cells are segments, triangles or quadrilaterals, (k, corners, dim). The corners of
    quadrilaterals may have any order, and two of them one place, as those of a triangle.
    """
    if len(points) == 0:
        return points
    # Segments or triangles that cover a cell with so many corners.
    parts = {2: [[0, 1]], 3: [[0, 1, 2]], 4: [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]}
    return _nearest([_foot(corners[:, part], points) for part in parts[corners.shape[1]]], points)


def _nearest(candidates: list[FloatArray], points: FloatArray) -> FloatArray:
    """Nearest of several candidates, each (k, dim), to each of k points."""
    every = np.array(candidates)
    best = np.linalg.norm(every - points, axis=-1).argmin(axis=0)
    return np.asarray(every[best, np.arange(len(points))])


def _foot(corners: FloatArray, points: FloatArray) -> FloatArray:
    """Nearest places in segments or triangles (k, 2 or 3, dim) to k points, (k, dim)."""
    start, sides = corners[:, 0], corners[:, 1:] - corners[:, :1]
    gram = np.einsum("kid,kjd->kij", sides, sides)
    right = np.einsum("kid,kd->ki", sides, points - start)
    # Of a triangle with two corners in one place the border is all there is, of a segment a point.
    flat = (corners == np.roll(corners, 1, axis=1)).all(axis=-1).any(axis=1)
    gram[flat] = np.eye(gram.shape[1])
    share = np.linalg.solve(gram, right[..., None])[..., 0]
    if corners.shape[1] == 2:
        share = np.clip(share, 0.0, 1.0)
    foot = start + np.einsum("ki,kid->kd", share, sides)
    if corners.shape[1] == 2:
        return np.asarray(foot)
    border = _nearest([_foot(corners[:, [i - 1, i]], points) for i in range(3)], points)
    above = (share >= 0.0).all(axis=1) & (share.sum(axis=1) <= 1.0) & ~flat
    return np.where(above[:, np.newaxis], foot, border)


def _beside(
    p: FloatArray, t: IntArray, facets: IntArray, t2f: IntArray, xyz: FloatArray
) -> IntArray:
    """Element on each side of each facet, shape (2, n_facets); -1 where there is none.

    The sign of the determinant of vectors along the facet and to the element's centre tells the
    side. What is left of a side that a collapsed element has lost has no element on either.
    """
    dim, corners, centre = len(p), p[:, facets], p[:, t].mean(axis=1)
    spans = [corners[:, -1 - i] - corners[:, dim - 2 - i] for i in range(dim - 1)]
    middle = corners.mean(axis=1)
    code = 2 * t2f
    for row, facet in zip(code, t2f, strict=True):
        vectors = np.array([*(span[:, facet] for span in spans), centre - middle[:, facet]])
        row += _det(vectors.transpose(2, 0, 1)) > 0.0
    is_side = corner_count(facets) >= dim  # those that collapsed elements have lost are none
    uses = np.bincount(code[is_side[t2f]], minlength=2 * facets.shape[1])
    if uses.max() > 1:
        both = np.flatnonzero((code == np.argmax(uses)).any(axis=0))[:2]
        a, b = (spot(xyz[t[:, element]].mean(axis=0)) for element in both)
        raise ValueError(
            f"two elements, with centres at {a} and {b}, lie on the same side of what joins them, "
            f"{spot(*xyz[facets[:, np.argmax(uses) // 2]])}: the mesh branches, folds back or "
            "overlaps itself, or an element is inverted. Bodies over each other must not share "
            "nodes"
        )
    beside = np.full(2 * facets.shape[1], -1, dtype=np.intp)
    beside[code] = np.arange(t.shape[1])
    beside = beside.reshape(-1, 2).T
    beside[:, ~is_side] = -1
    return beside
