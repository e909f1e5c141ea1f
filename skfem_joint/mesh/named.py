"""Meshes with named regions, boundaries and points, of one, two or three dimensions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import skfem
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.values import check_kind, several
from skfem_joint.linalg.fill import fill
from skfem_joint.mesh import cells
from skfem_joint.mesh.cells import Cell, cell_of, spot
from skfem_joint.mesh.collapsed import (
    ElementsOfKind,
    dofs_of,
    is_collapsed,
    joined,
    parts_of,
    turned_alike,
)
from skfem_joint.mesh.splitting import split
from skfem_joint.mesh.straightening import straightening


@dataclass(frozen=True)
class NamedMesh:
    """Mesh of one or several bodies with named regions, boundaries and points.

    Attributes
    ----------
    mesh : skfem.MeshLine1, MeshTri1, MeshQuad1, MeshTet1 or MeshHex1
        Mesh with straight edges and vertices ``p``, shape (dim, n_vertices), m. Prisms, and
        triangles beside quadrilaterals, are elements with corners that coincide, see
        `skfem_joint.mesh.collapsed`. The coordinate of a bar is the arc length along the first
        bar. Regions are the subdomains of this mesh. Boundaries, also those inside bodies, are its
        boundaries; points of a line mesh are among them too. In meshes that were read or built, the
        corners of an element have the order of Gmsh, and nodes and elements of each bar ascend.
    order : int
        Order of the displacement, 1 or 2.
    points : dict of str to int
        Vertex by point name.
    coordinates : ndarray, shape (n_vertices, 3)
        Positions in space, m.
    body : ndarray, shape (n_elements,)
        Number of the body of each element: elements that share facets belong to the same body.
        Bodies are numbered by their first elements. They may overlap but never share nodes.
    path : str
        Files that the mesh was read from, "" for a mesh built in memory.
    notes : tuple of str
        Sentences on repairs that changed the geometry and on groups that were left out.
    plane : {"", "stress", "strain"}
        State across a plate, where the file says it.
    """

    mesh: skfem.Mesh
    order: int
    points: dict[str, int]
    coordinates: FloatArray
    body: IntArray
    path: str = ""
    notes: tuple[str, ...] = ()
    plane: str = ""

    @property
    def dim(self) -> int:
        """Dimension of the mesh."""
        return int(self.mesh.dim())

    @cached_property
    def parts(self) -> list[ElementsOfKind]:
        """Elements by their kind."""
        return parts_of(cell_of(self.mesh)[0], self.mesh.t)

    @property
    def kind(self) -> str:
        """Kind of the elements: line, triangle, quadrilateral, tetrahedron, hexahedron, prism.

        Of several kinds that of the most corners, then the others, such as "hexahedron and prism".
        """
        return " and ".join(part.kind.name for part in self.parts)

    @property
    def family(self) -> str:
        """Kind of which all elements are, as they are or collapsed, or would be among others."""
        return cell_of(self.mesh)[0].host or cell_of(self.mesh)[0].name

    @cached_property
    def regions(self) -> dict[str, IntArray]:
        """Sorted element numbers by region name; regions may overlap."""
        return dict(self.mesh.subdomains or {})

    @cached_property
    def boundaries(self) -> dict[str, IntArray]:
        """Sorted facet numbers (columns of ``mesh.facets``) by boundary name."""
        groups = (self.mesh.boundaries or {}).items()
        return {name: facets for name, facets in groups if name not in self.points}

    @property
    def identity(self) -> list[Any]:
        """Arrays and names that distinguish this mesh from another."""
        geometry = [self.mesh.p, self.mesh.t, self.order, self.coordinates]
        return [geometry, [self.regions, self.boundaries, self.points]]

    @cached_property
    def other_order(self) -> NamedMesh:
        """The same straight mesh with displacements of the other order, 2 or 1."""
        return replace(self, order=3 - self.order)

    @cached_property
    def factor_bytes(self) -> float:
        """Memory of a factor of the stiffness, bytes; 0 below 50,000 unknowns, which always fit."""
        nodes = dofs_of(self.mesh, cell_of(self.mesh)[0].elements[self.order - 1]())
        if self.dim * nodes.N < 50_000:
            return 0.0
        of_element = nodes.element_dofs
        element = np.broadcast_to(np.arange(self.n_elements), of_element.shape)
        entries = np.ones(of_element.size), (of_element.ravel(), element.ravel())
        beside = sparse.csr_array(entries, shape=(nodes.N, self.n_elements))
        # SuperLU keeps both triangles.
        return 2.0 * 8.0 * self.dim**2 * fill(beside @ beside.T).entries

    @property
    def n_elements(self) -> int:
        """Number of elements."""
        return int(self.mesh.t.shape[1])

    @property
    def size(self) -> float:
        """Largest extent, m."""
        return float(np.ptp(self.mesh.p, axis=1).max())


def named(
    mesh: skfem.Mesh,
    *,
    points: Mapping[str, int] | None = None,
    order: int | None = None,
) -> NamedMesh:
    """Named mesh from any mesh of scikit-fem; vertices and elements keep their numbers.

    Parameters
    ----------
    mesh : skfem.Mesh
        Mesh of lines, triangles, quadrilaterals, tetrahedra or hexahedra, of first or second
        order, or of prisms (MeshWedge1). Its subdomains become regions. Boundaries of a line mesh
        with a single vertex become points. Curved edges of second-order elements are made straight,
        with a note in ``notes``.
    points : mapping of str to int, optional
        Vertex by point name.
    order : {1, 2}, optional
        Order of the displacement, by default that of the mesh; lines have 1.

    Raises
    ------
    InputError
        The mesh is of another kind or wrong in itself (see `load_meshes`); a vertex belongs to no
        element; a group is empty or out of range; a name is used twice.
    """
    if not isinstance(mesh, skfem.Mesh):
        raise InputError(
            f"mesh: found {type(mesh).__name__}, must be a mesh of scikit-fem, a mesh from "
            "load_meshes, build_bar, build_plate or build_box, or the name of a file"
        )
    check_kind("points", {} if points is None else points, Mapping)
    try:
        own_cell, own_order = cell_of(mesh)
        cell, t = joined([(own_cell, mesh.t)])
        straight = mesh
        if own_order == 2:
            if is_collapsed(cell, t).any():
                raise ValueError(
                    "elements of second order with corners in one place: give the mesh of first "
                    "order, and order = 2"
                )
            straight = cell.mesh(mesh.p[:, : mesh.nvertices], mesh.t, sort_t=False)
        spare = np.setdiff1d(np.arange(straight.p.shape[1]), mesh.t)
        if spare.size:
            raise ValueError(
                f"vertex {spare[0]} belongs to no element; take mesh.remove_unused_nodes()"
            )
        regions = _numbers("region", mesh.subdomains, mesh.nelements)
        boundaries = _numbers("boundary", mesh.boundaries, mesh.nfacets)
        vertices = _numbers("point", points, mesh.nvertices)
        is_side = cells.corner_count(mesh.facets) >= cell.dim  # not what a collapsed one has left
        checked = from_parts(
            cell,
            straight.p,
            t,
            order=own_order if order is None else order,
            regions=regions,
            facets={
                name: mesh.facets[:, chosen[is_side[chosen]]] for name, chosen in boundaries.items()
            },
            points={name: int(numbers[0]) for name, numbers in vertices.items()},
            keep_order=True,
        )
        if own_order == 1:
            return checked
        curved = mesh.p[:, mesh.dofs.element_dofs]
        notes = straightening(checked.mesh, curved, checked.boundaries)
        return replace(checked, notes=tuple(notes))
    except ValueError as error:
        raise InputError(f"mesh: {error}") from error


def _numbers(what: str, groups: Mapping[str, Any] | None, count: int) -> dict[str, IntArray]:
    """Sorted numbers of each group, all of them below ``count``; ValueError if they are not."""
    sorted_groups = {name: np.unique(np.asarray(values)) for name, values in (groups or {}).items()}
    for name, numbers in sorted_groups.items():
        if not isinstance(name, str):
            raise ValueError(
                f"{what} {name!r}: names must be text, found {type(name).__name__}; give "
                f"{{{str(name)!r}: ...}}"
            )
        if not numbers.size:
            raise ValueError(f"{what} {name!r} is empty: take it out, or give it members")
        if numbers.dtype.kind not in "iu" or numbers[0] < 0 or numbers[-1] >= count:
            raise ValueError(
                f"{what} {name!r} must hold whole numbers from 0 to {count - 1}, found "
                f"{numbers[0]} to {numbers[-1]}"
            )
    return {name: numbers.astype(np.intp) for name, numbers in sorted_groups.items()}


def from_parts(
    cell: Cell,
    p: FloatArray,
    t: IntArray,
    *,
    xyz: FloatArray | None = None,
    order: int = 1,
    regions: Mapping[str, IntArray],
    facets: Mapping[str, IntArray],
    points: Mapping[str, int],
    body: IntArray | None = None,
    keep_order: bool = False,
) -> NamedMesh:
    """Named mesh from its parts, which are checked.

    Parameters
    ----------
    cell : Cell
        Kind of the elements.
    p, t, xyz : ndarray
        As in `skfem_joint.mesh.cells`, without unused vertices.
    order : {1, 2}
        Order of the displacement.
    regions : mapping of str to ndarray of int
        Elements by region name.
    facets : mapping of str to ndarray of int, shape (corners, n)
        Vertices of the facets by boundary name.
    points : mapping of str to int
        Vertex by point name.
    body : ndarray of int, shape (n_elements,), optional
        Body of each element. With it the joining of elements is not checked.
    keep_order : bool
        Keep the order of corners, and of nodes and elements of bars. Otherwise mirrored elements
        are turned over and nodes and elements of bars ascend.

    Raises
    ------
    ValueError
        Says what is wrong with the parts.
    """
    check_count(len(regions) + len(facets) + len(points))
    if order not in ((1, 2) if cell.dim > 1 else (1,)):
        raise ValueError(f"order of the elements is {order}: allowed are 1 and 2, for lines 1")
    p, t = np.ascontiguousarray(p, dtype=np.float64), np.ascontiguousarray(t, dtype=np.intp)
    xyz = np.pad(p, ((0, 3 - cell.dim), (0, 0))).T if xyz is None else xyz
    check_finite(xyz)
    t = _checked(cell, p, t, xyz, keep_order)
    sides, t2f = cell.facets(t, p.shape[1])
    body = cells.find_bodies(p, t, sides, t2f, xyz, regions) if body is None else body
    if cell.dim == 1:  # boundaries of one vertex are points, and nodes of bars ascend
        single = {name: int(ends[0, 0]) for name, ends in facets.items() if ends.shape[1] == 1}
        single = {name: node for name, node in single.items() if points.get(name, node) == node}
        facets = {name: ends for name, ends in facets.items() if name not in single}
        points = single | dict(points)
        if not keep_order:
            body_of = np.empty(p.shape[1], dtype=np.intp)
            body_of[t] = body
            along = np.lexsort((p[0], body_of))
            rank = np.argsort(along)
            by_place = np.argsort(rank[t[0]])
            p, xyz, t, body = p[:, along], xyz[along], rank[t[:, by_place]], body[by_place]
            place = np.argsort(by_place)
            regions = {name: place[chosen] for name, chosen in regions.items()}
            facets = {name: rank[ends] for name, ends in facets.items()}
            points = {name: int(rank[vertex]) for name, vertex in points.items()}
    groups = {name: np.unique(chosen) for name, chosen in regions.items()}
    boundaries = facet_numbers(sides, facets, xyz)
    problems = name_problems(region=groups, boundary=boundaries, point=points)
    if problems:
        raise ValueError("\n".join(problems))
    if cell.dim == 1:  # to scikit-fem named vertices of line meshes are boundaries
        boundaries |= {name: np.array([vertex]) for name, vertex in points.items()}
    mesh = cell.mesh(p, t, boundaries or None, groups or None, sort_t=False)
    return NamedMesh(mesh, order, dict(points), xyz, body)


def _checked(cell: Cell, p: FloatArray, t: IntArray, xyz: FloatArray, keep_order: bool) -> IntArray:
    """Vertices of the elements, of which all have a shape that is allowed.

    Mirrored elements are turned over unless the order is kept; prisms are turned alike.
    """
    turned = t.copy()
    for kind, elements, corners in parts_of(cell, t):
        mirrored = cells.check_shapes(kind, p, corners, xyz)
        if mirrored.any() and not keep_order:
            corners = np.where(mirrored, corners[list(kind.mirrored)], corners)
        if kind.name == "prism":
            corners = turned_alike(corners, xyz)
        turned[:, elements] = corners if kind is cell else corners[list(kind.at)]
    return turned


def check_finite(xyz: FloatArray) -> None:
    """Refuse positions (n, 3) that are not finite or too far away; ValueError with the place."""
    strange = ~(np.abs(xyz) < 1e20).all(axis=1)  # energies must not overflow
    if strange.any():
        node = int(np.argmax(strange))
        raise ValueError(
            f"node {node + 1} at {spot(xyz[node])}: coordinates must be finite and below 1e+20 m"
        )


def facet_numbers(
    facets: IntArray, groups: Mapping[str, IntArray], xyz: FloatArray
) -> dict[str, IntArray]:
    """Sorted numbers of the facets of each group, given by their vertices (corners, n)."""
    if not groups:
        return {}
    n_facets = facets.shape[1]
    ends = [np.reshape(group, (len(facets), -1)) for group in groups.values()]
    first, set_of = cells.same_columns(cells.distinct(np.hstack([facets, *ends])))
    sizes = np.cumsum([group.shape[1] for group in ends])[:-1]
    numbers = np.split(first[set_of[n_facets:]], sizes)
    for name, own, group in zip(groups, numbers, ends, strict=True):
        outside = own >= n_facets  # these vertices occur in groups alone
        if outside.any():
            raise ValueError(not_a_side(name, xyz[group[:, np.argmax(outside)]]))
    return {name: np.unique(own) for name, own in zip(groups, numbers, strict=True)}


def check_count(names: int) -> None:
    """Refuse a mesh with more than 10,000 named groups, whose reading would take hours.

    ValueError says so.
    """
    if names > 10_000:
        raise ValueError(
            f"it has {names} named groups, must be at most 10000: name only the parts that are "
            "loaded, held, joined or observed, or that have other properties"
        )


def not_a_side(name: str, corners: FloatArray) -> str:
    """Message about a group with a part that is not a side of any element."""
    return (
        f"group {name!r}: {spot(*corners)} is no side or corner of an element. In Gmsh, give "
        "the surface or volume beside it a physical group, without which its elements are not "
        "written; inside of a surface or volume, embed it there before meshing"
    )


def name_problems(**names: Iterable[Any]) -> list[str]:
    """Problems of names, given by kind: no texts, forbidden characters, too long, of two kinds."""
    no_texts = [
        f"name {name!r}: found {type(name).__name__}, must be text"
        for given in names.values()
        for name in given
        if not isinstance(name, str)
    ]
    if no_texts:
        return no_texts
    kinds: dict[str, list[str]] = {}
    for kind, given in names.items():
        for name in dict.fromkeys(given):
            kinds.setdefault(name, []).append(kind)
    problems = [
        f"name {name!r}: names may not be empty nor hold quotes, backslashes or control characters"
        for name in sorted(kinds)
        if not name.strip() or re.search(r'["\\\x00-\x1f\x7f]', name)
    ]
    problems += [
        f"name {name[:40]!r}...: found {len(name)} characters, must be at most 127"
        for name in sorted(kinds)
        if len(name) > 127  # the limit of Gmsh
    ]
    return problems + [
        f"name {name!r} is both a {' and a '.join(kinds[name])}: give each its own"
        for name in sorted(kinds)
        if len(kinds[name]) > 1
    ]


def merged(meshes: Sequence[NamedMesh]) -> NamedMesh:
    """Several meshes as a single mesh with separate bodies: coincident nodes are not joined.

    Bars must be parallel. Their coordinate is then the position along the axis of the first bar,
    from its first end; a bar in the opposite direction is renumbered so that it ascends.

    Parameters
    ----------
    meshes : sequence of NamedMesh
        With the same order of elements, of kinds that go together, and with different names.

    Returns
    -------
    NamedMesh

    Raises
    ------
    InputError
        No mesh or something else, different kinds or orders of elements, bars that are not
        parallel, or a name that two meshes use.
    """
    meshes = several("meshes", meshes, NamedMesh)
    if not meshes:
        raise InputError("no meshes to merge")
    titles = [each.path or f"mesh {number}" for number, each in enumerate(meshes, 1)]
    problems = [
        f"{title} holds {each.kind} elements of order {each.order}, {titles[0]} {meshes[0].kind} "
        f"elements of order {meshes[0].order}: several meshes must have elements that go together, "
        "of the same order; mesh one of them anew"
        for title, each in zip(titles, meshes, strict=True)
        if (each.order, each.family) != (meshes[0].order, meshes[0].family)
    ]
    names = [{*each.regions, *each.boundaries, *each.points} for each in meshes]
    problems += [
        f"name {group!r} stands in {titles[i]} and in {titles[j]}: give each its own"
        for i, j in combinations(range(len(meshes)), 2)
        for group in sorted(names[i] & names[j])
    ]
    planes = {each.plane for each in meshes if each.plane}
    if len(planes) > 1:
        problems.append(
            f"{', '.join(titles)}: some elements are of plane stress and some of plane strain: "
            "write all with the same types"
        )
    refuse(problems)
    counts = [(each.n_elements, len(each.coordinates), each.body.max() + 1) for each in meshes]
    before = np.cumsum([(0, 0, 0), *counts[:-1]], axis=0).tolist()
    parts = list(zip(meshes, before, strict=True))
    try:
        cell, t = joined(
            [(cell_of(each.mesh)[0], each.mesh.t.astype(np.intp) + n) for each, (_, n, _) in parts]
        )
        mesh = from_parts(
            cell,
            np.hstack([_along_first(meshes[0], each) for each in meshes]),
            t,
            xyz=np.vstack([each.coordinates for each in meshes]),
            order=meshes[0].order,
            regions={
                name: chosen + elements
                for each, (elements, _, _) in parts
                for name, chosen in each.regions.items()
            },
            facets={
                name: each.mesh.facets[:, chosen] + vertices
                for each, (_, vertices, _) in parts
                for name, chosen in each.boundaries.items()
            },
            points={
                name: vertex + vertices
                for each, (_, vertices, _) in parts
                for name, vertex in each.points.items()
            },
            body=np.concatenate([each.body + bodies for each, (_, _, bodies) in parts]),
        )
    except ValueError as error:
        raise InputError(f"{', '.join(titles)}: {error}") from error
    return replace(
        mesh,
        path=", ".join(dict.fromkeys(each.path for each in meshes if each.path)),
        notes=tuple(dict.fromkeys(note for each in meshes for note in each.notes)),
        plane="".join(planes),
    )


def _along_first(first: NamedMesh, bar: NamedMesh) -> FloatArray:
    """Positions (dim, n_vertices) of a mesh, those of a bar along the axis of the first bar.

    ValueError for bars that are not parallel.
    """
    if bar is first or bar.dim > 1:
        return np.asarray(bar.mesh.p)
    (origin, axis), (start, along) = bar_axis(first), bar_axis(bar)
    sign = 1.0 if along @ axis > 0.0 else -1.0
    if np.linalg.norm(along - sign * axis) > cells.TOLERANCE:
        raise ValueError(f"bars must be parallel: they run along {spot(axis, along)}")
    return np.asarray((start - origin) @ axis + sign * bar.mesh.p)


def bar_axis(bar: NamedMesh) -> tuple[FloatArray, FloatArray]:
    """Origin of the coordinate of a bar in space, m, and the unit vector along the bar."""
    nodes = bar.mesh.t[:, bar.body == 0].ravel()
    position = bar.mesh.p[0, nodes]
    a, b = nodes[np.argmin(position)], nodes[np.argmax(position)]
    direction = (bar.coordinates[b] - bar.coordinates[a]) / np.ptp(position)
    return bar.coordinates[a] - position.min() * direction, direction


def refined(mesh: NamedMesh) -> NamedMesh:
    """Mesh with every element split into 2**dim parts, with the same names and order.

    Element e becomes the elements ``2**dim * e`` and following. Vertices keep their numbers, except
    in bars, whose nodes ascend. scikit-fem's own ``refined`` is not used because it mixes up the
    regions of line meshes and drops the boundaries of solids.

    Parameters
    ----------
    mesh : NamedMesh

    Returns
    -------
    NamedMesh

    Raises
    ------
    InputError
        It is no mesh.
    """
    check_kind("mesh", mesh, NamedMesh)
    number = np.arange(2**mesh.dim * mesh.n_elements).reshape(mesh.n_elements, -1)
    places = np.vstack([mesh.mesh.p, mesh.coordinates.T])
    values, _, _, parts, sides = split(mesh.mesh, places)
    fine = from_parts(
        cell_of(mesh.mesh)[0],
        values[: mesh.dim],
        parts.transpose(1, 2, 0).reshape(parts.shape[1], -1),
        xyz=values[mesh.dim :].T,
        order=mesh.order,
        regions={name: number[chosen].ravel() for name, chosen in mesh.regions.items()},
        facets={
            name: np.concatenate(sides[:, :, chosen], axis=1)
            for name, chosen in mesh.boundaries.items()
        },
        points=mesh.points,
        body=np.repeat(mesh.body, 2**mesh.dim),
    )
    return replace(fine, path=mesh.path, notes=mesh.notes, plane=mesh.plane)
