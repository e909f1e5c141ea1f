"""Meshes of bars, plates and boxes, of consecutive strips along x with equal elements each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.values import COUNT, FINITE, POSITIVE, check_kind, several
from skfem_joint.mesh.cells import CELLS, TOLERANCE, spot
from skfem_joint.mesh.collapsed import joined
from skfem_joint.mesh.named import NamedMesh, from_parts, name_problems

#: Name, length along x (m) and number of elements along x.
Strip = tuple[str, float, int]
#: A side, or a side and the strip to whose edge it is limited.
Side = str | tuple[str, str]
# Sides perpendicular to x, y and z, by scikit-fem's names.
_SIDES = ("left", "right", "bottom", "top", "front", "back")


def build_bar(
    regions: Sequence[Strip],
    points: Mapping[str, float] | None = None,
    *,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
) -> NamedMesh:
    """Bar along x from consecutive regions of equal elements.

    Parameters
    ----------
    regions : sequence of (str, float, int)
        Name, length (m) and number of elements of each region, from the first end on. Parts with
        the same name make one region.
    points : mapping of str to float, optional
        Position along the bar (m) by point name; each must coincide with a node.
    origin : sequence of three float
        Position of the first end in space, m, which matters for bars that are merged.

    Returns
    -------
    NamedMesh

    Raises
    ------
    InputError
        For all mistakes in names, lengths and numbers together.
    """
    return _built("line", regions, (), (), 1, origin, points, {})


def build_plate(
    strips: Sequence[Strip],
    width: float,
    elements: int,
    *,
    origin: Sequence[float] = (0.0, 0.0),
    kind: Literal["quadrilateral", "triangle"] = "quadrilateral",
    order: int = 1,
    prefix: str = "",
    boundaries: Mapping[str, Side] | None = None,
    points: Mapping[str, Sequence[float]] | None = None,
) -> NamedMesh:
    """Rectangle of consecutive strips along x, each of equal elements.

    Vertices and elements are numbered column by column, upwards in each. Each cell of the grid is
    one quadrilateral or two triangles, whose diagonals alternate.

    Parameters
    ----------
    strips : sequence of (str, float, int)
        Region name, length along x (m) and number of elements along x, from the left on, e.g.
        ``[("linear", 0.5, 50), ("joint", 0.1, 10)]``. Strips with the same name make one region.
    width : float
        Size along y, m.
    elements : int
        Number of elements along y.
    origin : sequence of two float
        Position of the lower left corner, m.
    kind : {"quadrilateral", "triangle"}
        Kind of the elements.
    order : {1, 2}
        Order of the displacement.
    prefix : str
        Prefix of the names of the default boundaries, e.g. ``"upper_"``.
    boundaries : mapping of str to str or (str, str), optional
        By name: a side ("left", "right", "bottom", "top"), or a side and the strip to whose edge
        it is limited, e.g. ``{"contact": ("bottom", "joint")}``. By default the four sides with
        their own names.
    points : mapping of str to (float, float), optional
        Positions (m) by point name; each must coincide with a vertex.

    Returns
    -------
    NamedMesh

    Raises
    ------
    InputError
        For all mistakes in names, sizes and numbers together, then for those in positions.
    """
    return _built(kind, strips, (width,), (elements,), order, origin, points, boundaries, prefix)


def build_box(
    strips: Sequence[Strip],
    size: tuple[float, float],
    elements: tuple[int, int],
    *,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    kind: Literal["hexahedron", "prism", "tetrahedron"] = "hexahedron",
    order: int = 1,
    prefix: str = "",
    boundaries: Mapping[str, Side] | None = None,
    points: Mapping[str, Sequence[float]] | None = None,
) -> NamedMesh:
    """Box of consecutive strips along x, each of equal elements.

    Each cell of the grid is one hexahedron, two prisms along z or six tetrahedra.

    Parameters
    ----------
    strips : sequence of (str, float, int)
        Region name, length along x (m) and number of elements along x, as in `build_plate`.
    size : (float, float)
        Sizes along y and z, m.
    elements : (int, int)
        Numbers of elements along y and z.
    origin : sequence of three float
        Position of the corner with the smallest coordinates, m.
    kind : {"hexahedron", "prism", "tetrahedron"}
        Kind of the elements.
    order : {1, 2}
        Order of the displacement.
    prefix : str
        Prefix of the names of the default boundaries.
    boundaries : mapping of str to str or (str, str), optional
        By name: a side, or a side and the strip to whose face it is limited. The sides are "left"
        and "right" (x), "bottom" and "top" (y), "front" and "back" (z), as in scikit-fem. By
        default the six sides with their own names.
    points : mapping of str to (float, float, float), optional
        Positions (m) by point name; each must coincide with a vertex.

    Returns
    -------
    NamedMesh

    Raises
    ------
    InputError
        For all mistakes in names, sizes and numbers together, then for those in positions.
    """
    for where, given in (("size", size), ("elements", elements)):
        if len(several(where, given)) != 2:
            raise InputError(f"{where}: found {given!r}, must be two numbers, along y and z")
    return _built(kind, strips, size, elements, order, origin, points, boundaries, prefix)


def _built(
    kind: str,
    strips: Sequence[Strip],
    size: Sequence[float],
    elements: Sequence[int],
    order: int,
    origin: Sequence[float],
    points: Mapping[str, Any] | None,
    boundaries: Mapping[str, Side] | None,
    prefix: str = "",
) -> NamedMesh:
    """Mesh of a grid of any dimension; the coordinate of a bar starts at 0, whatever its origin."""
    strips, origin = several("strips" if size else "regions", strips), several("origin", origin)
    check_kind("prefix", prefix, str)
    if boundaries is None:
        boundaries = {prefix + side: side for side in _SIDES[: 2 + 2 * len(size)]}
    check_kind("boundaries", boundaries, Mapping)
    check_kind("points", {} if points is None else points, Mapping)
    limits = {
        name: (side, None) if isinstance(side, str) else side for name, side in boundaries.items()
    }
    refuse(
        f"{what}: found {given!r}, must be {allowed}"
        for what, given, count, allowed in (
            *(("strips", strip, 3, "a name, a length (m) and a number") for strip in strips),
            *((f"boundary {n!r}", side, 2, "a side and a strip") for n, side in limits.items()),
        )
        if not isinstance(given, Sequence) or len(given) != count
    )
    if len(origin) > 3:
        raise InputError(f"origin: found {len(origin)} numbers, must be at most 3")
    names = [name for name, _, _ in strips]
    problems = name_problems(region=names, boundary=boundaries, point=points or {})
    problems += _problems(kind, strips, size, elements, order, origin, limits)
    refuse(problems)
    counts = [count for _, _, count in strips]
    ends = np.cumsum([0.0, *(length for _, length, _ in strips)])
    axes = [np.linspace(a, b, n + 1)[:-1] for (a, b), n in zip(pairwise(ends), counts, strict=True)]
    axes = [np.concatenate([*axes, ends[-1:]])]
    axes += [np.linspace(0.0, side, count + 1) for side, count in zip(size, elements, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij")).reshape(len(axes), -1)
    xyz = np.pad(grid, ((0, 3 - len(grid)), (0, 0))).T + np.pad(origin, (0, 3 - len(origin)))
    p = grid if len(grid) == 1 else xyz.T[: len(grid)]
    shape = [axis.size for axis in axes]
    t = _elements(kind, shape)
    strip_of = np.repeat([names.index(name) for name in names], counts)
    strip_of = np.repeat(strip_of, t.shape[1] // strip_of.size)
    cell, hosted = joined([(CELLS[kind], t)])
    try:
        return from_parts(
            cell,
            p,
            hosted,
            xyz=xyz,
            order=order,
            regions={name: np.flatnonzero(strip_of == names.index(name)) for name in names},
            facets=_sides(kind, t, strip_of, shape, limits, names),
            points=_vertices(p, points or {}),
            body=np.zeros(t.shape[1], dtype=np.intp),
            keep_order=len(axes) == 1,  # nodes of bars ascend already
        )
    except ValueError as error:
        raise InputError(f"{kind}s: {error}") from error


def _vertices(p: FloatArray, points: Mapping[str, Any]) -> dict[str, int]:
    """Vertex at the position of each point; ValueError if there is none."""
    vertices, problems = {}, []
    for name, point in points.items():
        position = np.atleast_1d(np.asarray(point, dtype=np.float64))
        if position.shape != (len(p),):
            problems.append(f"point {name!r} at {point}: give {len(p)} coordinates (m)")
            continue
        distance = np.linalg.norm(p - position[:, np.newaxis], axis=0)
        vertices[name] = int(np.argmin(distance))
        if not distance[vertices[name]] <= TOLERANCE * np.ptp(p, axis=1).max():
            problems.append(
                f"point {name!r} at {spot(position)} is not on a node; the nearest node is at "
                f"{spot(p[:, vertices[name]])}"
            )
    if problems:
        raise ValueError("\n".join(problems))
    return vertices


def _problems(
    kind: str,
    strips: Sequence[Strip],
    size: Sequence[float],
    elements: Sequence[int],
    order: int,
    origin: Sequence[float],
    limits: Mapping[str, tuple[str, str | None]],
) -> list[str]:
    """Problems of the parameters of a grid, except those of names."""
    parts = [(f"strip {name!r}", length, count) for name, length, count in strips]
    parts += zip(("width", "depth"), size, elements, strict=False)
    problems = [] if strips else ["a mesh needs at least one strip"]
    for what, length, count in parts:
        if length not in POSITIVE:
            problems.append(f"length of {what} is {length}: it must be positive, finite")
        if count not in COUNT:
            problems.append(f"{what} has {count} elements: give an integer from 1 on")
    if not all(coordinate in FINITE for coordinate in origin):
        problems.append(f"origin is {origin}: it must be finite")
    kinds = [name for name, cell in CELLS.items() if cell.dim == 1 + len(size)]
    sides, names = _SIDES[: 2 + 2 * len(size)], [None, *(name for name, _, _ in strips)]
    given: list[tuple[str, Any, Sequence[Any]]] = [
        ("kind of element", kind, kinds),
        ("order of the elements", order, (1, 2)),
    ]
    given += [(f"side of boundary {name!r}", side, sides) for name, (side, _) in limits.items()]
    given += [(f"strip of boundary {name!r}", strip, names) for name, (_, strip) in limits.items()]
    return problems + [
        f"{what} is {value!r}: allowed are {', '.join(map(str, filter(None, allowed)))}"
        for what, value, allowed in given
        if value not in allowed
    ]


def _elements(kind: str, shape: Sequence[int]) -> IntArray:
    """Vertices (corners, n) of the elements of a grid whose last axis is numbered fastest."""
    node = np.arange(math.prod(shape)).reshape(shape)
    grid = CELLS[("line", "quadrilateral", "hexahedron")[len(shape) - 1]]
    places = grid.elements[0].refdom.p.astype(int).T
    boxes = ([slice(i, i + n - 1) for i, n in zip(place, shape, strict=True)] for place in places)
    cells = np.stack([node[tuple(box)].ravel() for box in boxes])
    if kind == grid.name:
        return np.asarray(cells, dtype=np.intp)
    # Corners of the grid's cells that the elements of even and odd cells have.
    even, odd = [[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]
    if kind == "tetrahedron":
        even = [[0, 1, 3, 4], [0, 3, 2, 4], [2, 3, 4, 6], [3, 4, 6, 7], [3, 4, 5, 7], [1, 3, 4, 5]]
        odd = even
    elif kind == "prism":  # along z
        odd = even = [[7, 4, 1, 6, 2, 0], [7, 1, 5, 6, 0, 3]]
    parity = np.indices([n - 1 for n in shape]).sum(axis=0).ravel() % 2
    t = np.where(parity == 0, cells[np.array(even)], cells[np.array(odd)]).transpose(1, 2, 0)
    return np.asarray(t.reshape(t.shape[0], -1), dtype=np.intp)


def _sides(
    kind: str,
    t: IntArray,
    strip_of: IntArray,
    shape: Sequence[int],
    limits: Mapping[str, tuple[str, str | None]],
    names: Sequence[str],
) -> dict[str, IntArray]:
    """Vertices (corners, n) of the facets on the named sides of a grid."""
    if not limits:
        return {}
    facets, t2f = CELLS[kind].facets(t, math.prod(shape))
    owner = np.empty(facets.shape[1], dtype=np.intp)  # strip of an element of each facet
    owner[t2f] = strip_of
    boundaries = {}
    for name, (side, strip) in limits.items():
        axis, end = divmod(_SIDES.index(side), 2)
        on_side = np.indices(shape)[axis].ravel() == end * (shape[axis] - 1)
        chosen = on_side[facets].all(axis=0)
        if strip is not None:
            chosen &= owner == names.index(strip)
        if not chosen.any():
            raise ValueError(f"boundary {name!r}: strip {strip!r} does not reach side {side!r}")
        boundaries[name] = facets[:, chosen]
    return boundaries
