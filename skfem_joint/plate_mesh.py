"""Plane plates of triangles or quadrilaterals: read from files, built in memory, merged, refined.

Files are read with meshio, not with ``skfem.Mesh.load``, which keeps cells that a file holds twice,
loses groups inside the plate and the boundaries of second-order files, and drops one kind of cell
where two are mixed. Whatever is no proper plane mesh is refused with the place and the reason.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from skfem_joint.errors import InputError
from skfem_joint.mesh_file import cell_sets, lost_groups, name_problems, read_mesh
from skfem_joint.meshing import TOLERANCE, BarMesh, bar_of
from skfem_joint.plate_checks import (
    KINDS,
    Kind,
    check_connections,
    check_neighbours,
    check_shapes,
    corner_areas,
    facet_numbers,
    not_an_edge,
    spot,
)

if TYPE_CHECKING:
    import meshio

__all__ = [
    "PlateMesh",
    "build_plate",
    "load_meshes",
    "make_plate",
    "merged",
    "refined",
]

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
Side = Literal["left", "right", "bottom", "top"]

# Of the plate, m: its stiffness, mass and energies must not overflow.
_LONGEST = 1e20
# Corners and order of the cells, by meshio's names.
_CELLS = {
    "triangle": (3, 1),
    "triangle6": (3, 2),
    "quad": (4, 1),
    "quad8": (4, 2),
    "quad9": (4, 2),
}


@dataclass(frozen=True)
class PlateMesh:
    """Plane mesh of one or several bodies with named regions, boundaries and points.

    Attributes
    ----------
    mesh : skfem.MeshTri1 or skfem.MeshQuad1
        Straight-sided; ``p`` of shape (2, n_vertices), m; ``t`` runs counter-clockwise in every
        element. Regions are its subdomains, boundaries its boundaries.
    order : int
        Order of the displacement: 1, or 2 for six-node triangles and nine-node quadrilaterals.
    regions : dict of str to ndarray
        Sorted element numbers by region name; regions may overlap.
    boundaries : dict of str to ndarray
        Sorted facet numbers (columns of ``mesh.facets``) by boundary name; named curves inside a
        body are kept as well.
    points : dict of str to int
        Vertex number by point name.
    body : ndarray, shape (n_elements,)
        Body of each element: elements that share facets belong to one body. Bodies are numbered
        by their first elements and may lie over each other; nodes are never shared between them.
    path : str
        Files the plate came from, "" when built in memory.
    notes : tuple of str
        Sentences on repairs that changed the geometry.
    """

    mesh: skfem.MeshTri1 | skfem.MeshQuad1
    order: int
    regions: dict[str, IntArray]
    boundaries: dict[str, IntArray]
    points: dict[str, int]
    body: IntArray
    path: str = ""
    notes: tuple[str, ...] = ()

    @property
    def kind(self) -> Kind:
        """Kind of the elements."""
        return KINDS[len(self.mesh.t)]


def load_meshes(paths: Sequence[str | Path], scale: float = 1.0) -> BarMesh | PlateMesh:
    """Read a bar from a file of lines, or a plate from files of triangles or quadrilaterals.

    Plates are read from Gmsh files of format 2.2 or 4.1, ASCII or binary, in a plane z = const.
    Physical surfaces become regions, physical curves boundaries, physical points points. Bodies
    that share no nodes, in one file or in several, stay separate even where they lie over each
    other.

    Repaired: cells that a file repeats once per group are merged and belong to all their groups;
    nodes that no element uses are dropped; clockwise elements are turned round. Second-order
    elements keep their order and their corners, and their edges are made straight: ``notes`` say
    so where an edge was curved. Groups without a name are left out.

    Parameters
    ----------
    paths : sequence of str or Path
        Mesh files: one bar, or one or several plates of the same kind and order of elements, with
        different names.
    scale : float
        Metres per unit of length of the files, e.g. 1e-3 for meshes drawn in mm.

    Raises
    ------
    InputError
        A file is missing, cut or damaged, or holds no mesh as described; elements without area,
        non-convex, crossing themselves or lying over each other in one body; nodes of one body in
        one place without being merged; elements of one body that touch in a point only; named
        groups without elements; names used twice.
    """
    if not paths:
        raise InputError("no mesh file is given: name one, or several for several plates")
    if not (math.isfinite(scale) and scale > 0.0):
        files = ", ".join(map(str, paths))
        raise InputError(f"scale of mesh {files} is {scale}: it must be positive and finite")
    found: list[BarMesh | PlateMesh] = []
    problems: list[str] = []
    for path in paths:
        try:
            found.append(_load(Path(path), scale))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    if len(found) == 1:
        return found[0]
    plates = [mesh for mesh in found if isinstance(mesh, PlateMesh)]
    if len(plates) < len(found):
        bars = ", ".join(mesh.path for mesh in found if isinstance(mesh, BarMesh))
        raise InputError(
            f"{bars}: lines only, that is a bar; several mesh files together must all be plates of "
            "triangles or quadrilaterals. Give the bar alone"
        )
    return merged(plates)


def make_plate(
    p: FloatArray,
    t: IntArray,
    order: int = 1,
    regions: Mapping[str, IntArray] | None = None,
    boundaries: Mapping[str, IntArray] | None = None,
    points: Mapping[str, int] | None = None,
    path: str = "",
    notes: tuple[str, ...] = (),
) -> PlateMesh:
    """Plate from its vertices and elements, checked as one that is read.

    Parameters
    ----------
    p : ndarray, shape (2, n_vertices)
        Positions of the vertices, m; every vertex belongs to an element.
    t : ndarray, shape (3 or 4, n_elements)
        Vertices of each element, one after the other around it in either direction.
    order : {1, 2}
        Order of the displacement.
    regions : mapping of str to ndarray, optional
        Element numbers by region name.
    boundaries : mapping of str to ndarray of shape (2, n), optional
        Pairs of vertices, the ends of its facets, by boundary name.
    points : mapping of str to int, optional
        Vertex number by point name.
    path, notes
        As those of `PlateMesh`.

    Raises
    ------
    InputError
        The mesh is no proper plane mesh, see `load_meshes`.
    """
    try:
        return _checked(p, t, order, regions or {}, boundaries or {}, points or {}, path, notes)
    except ValueError as error:
        raise InputError(f"{path or 'plate'}: {error}") from error


def build_plate(
    strips: Sequence[tuple[str, float, int]],
    width: float,
    elements: int,
    *,
    origin: tuple[float, float] = (0.0, 0.0),
    kind: Kind = "quadrilateral",
    order: int = 1,
    prefix: str = "",
    boundaries: Mapping[str, Side | tuple[Side, str]] | None = None,
    points: Mapping[str, tuple[float, float]] | None = None,
) -> PlateMesh:
    """Rectangle of equal elements in each of consecutive strips along x.

    Vertices and elements are numbered column by column, upwards in each; two triangles share each
    cell, with diagonals in turn.

    Parameters
    ----------
    strips : sequence of (str, float, int)
        Region name, length along x (m) and number of elements along x, from the left on, e.g.
        ``[("linear", 0.5, 50), ("joint", 0.1, 10)]``. A name used more than once is one region.
    width : float
        Size along y, m.
    elements : int
        Number of elements along y.
    origin : (float, float)
        Position of the lower left corner, m.
    kind : {"quadrilateral", "triangle"}
        Kind of the elements.
    order : {1, 2}
        Order of the displacement.
    prefix : str
        Put before the names of the four default boundaries, e.g. "upper_".
    boundaries : mapping of str to str or (str, str), optional
        By name: a side ("left", "right", "bottom", "top"), or a side and the strip to whose edge
        it is limited, e.g. ``{"contact": ("bottom", "joint")}``. Default: the four sides under
        their own names.
    points : mapping of str to (float, float), optional
        Positions (m) by point name; each must coincide with a vertex.

    Raises
    ------
    InputError
        All mistakes in names, sizes, numbers and positions together.
    """
    sides: Sequence[Side] = ("left", "right", "bottom", "top")
    if boundaries is None:
        boundaries = {prefix + side: side for side in sides}
    points = points or {}
    strip_names = [name for name, _, _ in strips]
    problems = name_problems(region=strip_names, boundary=boundaries, point=points)
    if not strips:
        problems.append("a plate needs at least one strip")
    sizes = [(f"length of strip {name!r}", length) for name, length, _ in strips]
    for what, size in [*sizes, ("width of the plate", width)]:
        if not (math.isfinite(size) and size > 0.0):
            problems.append(f"{what} is {size}: it must be positive, finite")
    counts = [(f"strip {name!r}", count) for name, _, count in strips]
    for what, count in [*counts, ("the width of the plate", elements)]:
        if isinstance(count, bool) or not isinstance(count, int) or count < 1:
            problems.append(f"{what} has {count} elements: give an integer from 1 on")
    if not all(map(math.isfinite, origin)):
        problems.append(f"origin is {origin}: it must be finite")
    if kind not in KINDS.values():
        problems.append(f"kind of element {kind!r}: allowed are {', '.join(KINDS.values())}")
    if order not in (1, 2):
        problems.append(f"order of the elements is {order}: allowed are 1 and 2")
    limits = {n: (at, None) if isinstance(at, str) else at for n, at in boundaries.items()}
    for name, (side, strip) in limits.items():
        if side not in sides:
            problems.append(f"boundary {name!r} on side {side!r}: allowed are {', '.join(sides)}")
        if strip is not None and strip not in strip_names:
            problems.append(f"boundary {name!r} is limited to {strip!r}, which is no strip")
    if problems:
        raise InputError(problems)

    ends = np.cumsum([0.0, *(length for _, length, _ in strips)])
    columns = [count for _, _, count in strips]
    x = np.concatenate(
        [
            np.linspace(a, b, n + 1)[:-1]
            for a, b, n in zip(ends[:-1], ends[1:], columns, strict=True)
        ]
        + [ends[-1:]]
    )
    y = np.linspace(0.0, width, elements + 1)
    p = np.stack([np.repeat(x, y.size), np.tile(y, x.size)]) + np.array([origin]).T
    node = np.arange(x.size * y.size).reshape(x.size, y.size)
    a, b, c, d = (
        corner.ravel() for corner in (node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:])
    )
    t = np.stack([a, b, c, d])
    if kind == "triangle":
        even = np.add.outer(np.arange(x.size - 1), np.arange(y.size - 1)).ravel() % 2 == 0
        first = np.where(even, [a, b, c], [a, b, d])
        second = np.where(even, [a, c, d], [b, c, d])
        t = np.stack([first, second], axis=-1).reshape(3, -1)

    strip_of = np.repeat(np.arange(len(strips)), columns)  # of each column of cells
    per_column = t.shape[1] // strip_of.size
    inside = {
        name: np.isin(strip_of, [i for i, other in enumerate(strip_names) if other == name])
        for name in strip_names
    }
    edges = {
        "left": (np.stack([node[0, :-1], node[0, 1:]]), strip_of[:1]),
        "right": (np.stack([node[-1, :-1], node[-1, 1:]]), strip_of[-1:]),
        "bottom": (np.stack([node[:-1, 0], node[1:, 0]]), strip_of),
        "top": (np.stack([node[:-1, -1], node[1:, -1]]), strip_of),
    }
    pairs = {}
    for name, (side, strip) in limits.items():
        facets, strip_at = edges[side]
        chosen = np.array([strip is None or strip_names[i] == strip for i in strip_at])
        pairs[name] = facets[:, np.broadcast_to(chosen, facets.shape[1:])]
        if not chosen.any():
            problems.append(f"boundary {name!r}: strip {strip!r} does not reach the side {side!r}")
    vertices = {}
    for name, place in points.items():
        distance = np.linalg.norm(p - np.array([place]).T, axis=0)
        nearest = int(np.argmin(distance))
        vertices[name] = nearest
        if not distance[nearest] <= TOLERANCE * max(ends[-1], width):
            problems.append(
                f"point {name!r} at {tuple(place)} m is not on a vertex; the nearest one is at "
                f"{spot(p[:, nearest])}"
            )
    if problems:
        raise InputError(problems)
    return make_plate(
        p,
        t,
        order,
        {name: np.flatnonzero(np.repeat(which, per_column)) for name, which in inside.items()},
        pairs,
        vertices,
    )


def merged(plates: Sequence[PlateMesh]) -> PlateMesh:
    """Several plates in one mesh, their bodies apart: nodes in one place are not joined.

    Raises
    ------
    InputError
        No plate, different kinds or orders of elements, or a name that two plates use.
    """
    if not plates:
        raise InputError("no plates to put together")
    called = [plate.path or f"plate {number}" for number, plate in enumerate(plates, 1)]
    problems = [
        f"{name} holds {_described(plate)}, {called[0]} {_described(plates[0])}: several plates "
        "must have elements of the same kind and order; mesh one of them anew"
        for name, plate in zip(called, plates, strict=True)
        if _described(plate) != _described(plates[0])
    ]
    owner: dict[str, str] = {}
    for number, plate in enumerate(plates):
        for name in [*plate.regions, *plate.boundaries, *plate.points]:
            if name in owner:
                problems.append(
                    f"name {name!r} stands in {owner[name]} and in {called[number]}: give each its "
                    "own"
                )
            owner.setdefault(name, called[number])
    if problems:
        raise InputError(problems)
    regions: dict[str, IntArray] = {}
    pairs: dict[str, IntArray] = {}
    points: dict[str, int] = {}
    cells, vertices = 0, 0
    t = []
    for plate in plates:
        t.append(plate.mesh.t.astype(np.int64) + vertices)
        regions |= {name: numbers + cells for name, numbers in plate.regions.items()}
        pairs |= {
            name: plate.mesh.facets[:, numbers].astype(np.int64) + vertices
            for name, numbers in plate.boundaries.items()
        }
        points |= {name: vertex + vertices for name, vertex in plate.points.items()}
        cells += plate.mesh.nelements
        vertices += plate.mesh.nvertices
    return make_plate(
        np.hstack([plate.mesh.p for plate in plates]),
        np.hstack(t),
        plates[0].order,
        regions,
        pairs,
        points,
        ", ".join(plate.path for plate in plates if plate.path),
        tuple(note for plate in plates for note in plate.notes),
    )


def refined(plate: PlateMesh) -> PlateMesh:
    """Plate with every element split into four; names, order and vertex numbers stay.

    The parts of element e are the elements 4 e ... 4 e + 3.
    """
    fine = plate.mesh.refined()
    parts = fine.t.reshape(len(fine.t), 4, -1).transpose(0, 2, 1).reshape(len(fine.t), -1)
    return make_plate(
        fine.p,
        parts,
        plate.order,
        {
            name: (4 * elements[:, np.newaxis] + np.arange(4)).ravel()
            for name, elements in plate.regions.items()
        },
        {name: fine.facets[:, fine.boundaries[name]] for name in plate.boundaries},
        plate.points,
        plate.path,
        plate.notes,
    )


def _described(plate: PlateMesh) -> str:
    return f"{plate.kind}s of {'first' if plate.order == 1 else 'second'} order"


def _load(file: Path, scale: float) -> BarMesh | PlateMesh:
    raw = read_mesh(file, 2)
    dimensions = {block.dim for block in raw.cells if len(block.data)}
    if dimensions <= {0}:
        raise InputError(
            f"{file}: it holds neither lines (a bar) nor triangles or quadrilaterals (a plate). In "
            "Gmsh, mesh the curves or surfaces, and save elements of named groups or all"
        )
    if dimensions <= {0, 1}:
        return bar_of(raw, file, scale)
    if file.suffix.lower() != ".msh":
        raise InputError(
            f"{file}: plates are read from Gmsh files (.msh), of format 2.2 or 4.1; convert it"
        )
    try:
        return _plate_of(raw, str(file), scale)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def _plate_of(raw: meshio.Mesh, path: str, scale: float) -> PlateMesh:
    """Plate from what a Gmsh file holds; ValueError says why it is none."""
    types = sorted({block.type for block in raw.cells if block.dim == 2 and len(block.data)})
    if len({_CELLS[name] for name in types}) > 1:
        raise ValueError(
            f"it mixes cells of type {' and '.join(types)}: a mesh is made of triangles or of "
            "quadrilaterals, all of one order. In Gmsh, recombine all surfaces or none"
        )
    corners, order = _CELLS[types[0]]
    used = corners * order  # a nine-node quadrilateral is known by its first eight nodes
    sets = cell_sets(raw)
    cells: list[IntArray] = []
    regions: dict[str, list[IntArray]] = {}
    boundaries: dict[str, list[IntArray]] = {}
    points: dict[str, list[IntArray]] = {}
    n_cells = 0
    for number, block in enumerate(raw.cells):
        nodes = np.asarray(block.data, dtype=np.int64)
        for name, members in sets.items():
            chosen = members[number]
            if not chosen.size:
                continue
            if block.dim == 2:
                regions.setdefault(name, []).append(n_cells + chosen)
            elif block.dim == 1:
                boundaries.setdefault(name, []).append(nodes[chosen, :2])
            else:
                points.setdefault(name, []).append(nodes[chosen, 0])
        if block.dim == 2:
            cells.append(nodes[:, :used])
            n_cells += len(nodes)
    lost = lost_groups(raw, 3, regions.keys() | boundaries.keys() | points.keys())
    if lost:
        raise ValueError(lost)

    position = np.asarray(raw.points, dtype=np.float64) * scale
    strange = ~(np.abs(position) < _LONGEST).all(axis=1)
    if strange.any():
        node = int(np.argmax(strange))
        raise ValueError(
            f"node {node + 1} at {spot(position[node])}: coordinates must be finite, below 1e20 m"
        )
    cell = np.concatenate(cells)
    z = position[np.unique(cell), 2]
    size = float(np.ptp(position[np.unique(cell), :2], axis=0).max())
    if np.ptp(z) > TOLERANCE * size:
        raise ValueError(
            f"the mesh is not in a plane z = const: z runs from {z.min():.9g} to {z.max():.9g} m; "
            "turn it into the x-y plane, and give bodies in different planes as different files"
        )
    xy = position[:, :2].T
    vertices, t = np.unique(cell[:, :corners].T, return_inverse=True)
    t = t.reshape(corners, -1)
    check_shapes(xy[:, vertices], t)
    # Cells of the same corners are one element; all are convex, so that no two differ otherwise.
    _, first, element_of = np.unique(
        np.sort(t, axis=0), axis=1, return_index=True, return_inverse=True
    )
    kept = np.argsort(first)
    rank = np.empty(kept.size, np.int64)
    rank[kept] = np.arange(kept.size)
    element_of, first = rank[element_of.ravel()], first[kept]

    vertex_of = np.full(len(position), -1)
    vertex_of[vertices] = np.arange(vertices.size)
    named_pairs = {}
    for name, parts in boundaries.items():
        ends = np.concatenate(parts).T
        named_pairs[name] = vertex_of[ends]
        off = (named_pairs[name] < 0).any(axis=0)
        if off.any():
            a, b = xy[:, ends[:, np.argmax(off)]].T
            raise ValueError(not_an_edge(name, a, b))
    named_points = {}
    for name, marked in points.items():
        places = np.unique(np.concatenate(marked))
        if places.size != 1:
            raise ValueError(f"point name {name!r} marks {places.size} nodes: give each its own")
        if vertex_of[places[0]] < 0:
            raise ValueError(
                f"point {name!r} at {spot(xy[:, places[0]])} is not a corner of any element"
            )
        named_points[name] = int(vertex_of[places[0]])
    return make_plate(
        xy[:, vertices],
        t[:, first],
        order,
        {name: element_of[np.concatenate(parts)] for name, parts in regions.items()},
        named_pairs,
        named_points,
        path,
        _straightened(xy, cell[first].T, corners, path) if order == 2 else (),
    )


def _checked(
    p: FloatArray,
    t: IntArray,
    order: int,
    regions: Mapping[str, IntArray],
    pairs: Mapping[str, IntArray],
    points: Mapping[str, int],
    path: str,
    notes: tuple[str, ...],
) -> PlateMesh:
    p = np.ascontiguousarray(p, dtype=np.float64)
    check_shapes(p, t)
    clockwise = corner_areas(p, t)[0] < 0.0
    t = np.ascontiguousarray(np.where(clockwise, t[[0, *range(len(t) - 1, 0, -1)]], t))
    check_neighbours(p, t)

    regions = {name: np.unique(elements).astype(np.int64) for name, elements in regions.items()}
    made = skfem.MeshTri1 if len(t) == 3 else skfem.MeshQuad1
    # Sorting vertices would turn triangles round again; facets do not depend on it.
    mesh = made(p, t, sort_t=False)
    boundaries = {name: facet_numbers(mesh, ends, name) for name, ends in pairs.items()}
    mesh = made(p, t, _boundaries=boundaries or None, _subdomains=regions or None, sort_t=False)

    inside = mesh.f2t[:, mesh.f2t[1] >= 0]
    touching = coo_array((np.ones(inside.shape[1]), tuple(inside)), shape=(mesh.nelements,) * 2)
    body = connected_components(touching, directed=False)[1].astype(np.int64)
    check_connections(mesh, body)
    return PlateMesh(
        mesh, order, dict(regions), boundaries, dict(points), body, path=path, notes=notes
    )


def _straightened(xy: FloatArray, cells: IntArray, corners: int, path: str) -> tuple[str, ...]:
    """Note on middle nodes off their straight edges; cells are counted as isoparametric."""
    start, stop = cells[:corners], np.roll(cells[:corners], -1, axis=0)
    a, b, middle = xy[:, start], xy[:, stop], xy[:, cells[corners : 2 * corners]]
    along, to = b - a, middle - a
    share = ((along * to).sum(axis=0) / (along**2).sum(axis=0)).clip(0.0, 1.0)
    off = np.linalg.norm(to - share * along, axis=0)
    curved = off > TOLERANCE * np.ptp(xy[:, cells].reshape(2, -1), axis=1).max()
    if not curved.any():
        return ()
    edges = np.sort(np.stack([start[curved], stop[curved]]), axis=0)
    count = np.unique(edges, axis=1).shape[1]
    edges_were = "curved edge was" if count == 1 else "curved edges were"
    # A parabola through both ends and the middle node encloses 2/3 of base times height.
    bulge = to - 0.5 * along
    swept = 2.0 / 3.0 * (along[0] * bulge[1] - along[1] * bulge[0]).sum(axis=0)
    straight = 0.5 * (a[0] * b[1] - a[1] * b[0]).sum(axis=0)
    turn = np.sign(straight)
    area = np.abs(straight).sum()
    true_area = area - (turn * swept).sum()
    change = 100.0 * (area - true_area) / true_area
    return (
        f"{path}: {count} {edges_were} made straight; the largest moved by {off.max():.3g} m and "
        f"the area changed by {change:+.3g} %.",
    )
