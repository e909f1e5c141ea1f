"""Straight bars from mesh files: named regions and points, ordered along the arc length.

A bar is read with meshio, not with ``skfem.Mesh.load``, which projects inclined bars onto x, keeps
cells that a file holds twice and loses groups. Whatever cannot be read as one straight chain of
line elements is refused with the place and the reason.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import skfem
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.mesh_file import cell_sets, lost_groups, name_problems, read_mesh

if TYPE_CHECKING:
    import meshio

__all__ = ["BarMesh", "build_bar", "load_mesh", "write_mesh"]

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

TOLERANCE = 1e-9  # of the bar's length: straightness, coincident nodes, positions of points
# Of the bar, m: its stiffness, mass and energies must not overflow.
_SHORTEST, _LONGEST = 1e-20, 1e20

_LINE_TYPE = re.compile(r"line\d*|VTK_LAGRANGE_CURVE")


@dataclass(frozen=True)
class BarMesh:
    """A straight bar measured by its arc length, with named regions and points.

    Attributes
    ----------
    mesh : skfem.MeshLine1
        ``p`` of shape (1, n_nodes) is the arc length from the bar's first end, m, ascending;
        element i joins nodes i and i + 1. Regions are its subdomains, points its boundaries.
    coordinates : ndarray, shape (n_nodes, 3)
        Positions in space, m.
    regions : dict of str to ndarray
        Sorted element indices by region name; regions may overlap.
    points : dict of str to int
        Node index by point name.
    path : str
        File the bar came from, "" when built in memory.
    """

    mesh: skfem.MeshLine1
    coordinates: FloatArray
    regions: dict[str, IntArray]
    points: dict[str, int]
    path: str

    @property
    def length(self) -> float:
        """Length of the bar, m."""
        return float(self.mesh.p[0, -1] - self.mesh.p[0, 0])

    def region_nodes(self, name: str) -> IntArray:
        """Sorted indices of the nodes that belong to the elements of a region.

        Raises
        ------
        InputError
            The bar has no region of that name.
        """
        if name not in self.regions:
            known = ", ".join(sorted(self.regions)) or "none"
            raise InputError(
                f"{self.path or 'bar'}: no region named {name!r}; regions of this mesh: {known}"
            )
        elements = self.regions[name]
        return np.union1d(elements, elements + 1)


def load_mesh(path: str | Path, scale: float = 1.0) -> BarMesh:
    """Read a straight bar from a mesh file.

    Gmsh 2.2 and 4.1 (ASCII and binary) are the main formats. Abaqus files (.inp) are
    read with their element sets as regions and their node sets as points; of the other formats
    that meshio reads none keeps both. The first end of the bar is the one with the
    lexicographically smaller position.

    Repaired: cells that a file repeats once per group are merged and belong to all their groups;
    nodes that no line uses are dropped; lines of higher order are split at their inner nodes into
    two-node elements, so that every node of the file is kept as a node of the bar. Groups without
    a name are left out.

    Parameters
    ----------
    path : str or Path
        Mesh file.
    scale : float
        Metres per unit of length of the file, e.g. 1e-3 for a mesh drawn in mm.

    Returns
    -------
    BarMesh

    Raises
    ------
    InputError
        The file is missing, empty, cut or damaged; it holds cells other than lines and points, a
        named group without elements, a point name on several nodes or off the bar, coordinates
        that are not finite, elements without length, coincident nodes; or its lines are not one
        straight chain (curved, branched, closed, folded, overlapping, disconnected).
    """
    if not (math.isfinite(scale) and scale > 0.0):
        raise InputError(f"scale of mesh {path} is {scale}: it must be positive and finite")
    file = Path(path)
    return bar_of(read_mesh(file, 1), file, scale)


def bar_of(raw: meshio.Mesh, file: Path, scale: float) -> BarMesh:
    """Bar from what a file holds; parameters, repairs and errors as those of `load_mesh`."""
    try:
        segments, regions, points = _lines_and_names(raw)
        if raw.points.ndim != 2 or raw.points.shape[1] > 3:
            raise ValueError("it holds no nodes in space")
        coordinates = np.zeros((len(raw.points), 3))
        coordinates[:, : raw.points.shape[1]] = raw.points
        return _chain(coordinates * scale, segments, regions, points, str(file))
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def build_bar(regions: Sequence[tuple[str, float, int]], points: Mapping[str, float]) -> BarMesh:
    """Bar along x from consecutive regions of equal elements.

    Parameters
    ----------
    regions : sequence of (str, float, int)
        Name, length (m) and number of elements, from the first end on. A name used more than once
        is one region with several parts.
    points : mapping of str to float
        Position along the bar (m) by point name; it must coincide with a node.

    Raises
    ------
    InputError
        All mistakes in names, lengths, numbers and positions together.
    """
    problems = name_problems(region=[name for name, _, _ in regions], point=points)
    if not regions:
        problems.append("a bar needs at least one region")
    for name, length, elements in regions:
        if not (math.isfinite(length) and length > 0.0):
            problems.append(f"length of region {name!r} is {length}: it must be positive, finite")
        if isinstance(elements, bool) or not isinstance(elements, int) or elements < 1:
            problems.append(f"region {name!r} has {elements} elements: give an integer from 1 on")
    if problems:
        raise InputError(problems)

    ends = np.cumsum([0.0, *(length for _, length, _ in regions)])
    counts = [elements for _, _, elements in regions]
    position = np.concatenate(
        [
            np.linspace(start, stop, count + 1)[:-1]
            for start, stop, count in zip(ends[:-1], ends[1:], counts, strict=True)
        ]
        + [ends[-1:]]
    )
    nodes = {}
    for name, wanted in points.items():
        node = int(np.argmin(np.abs(position - wanted)))
        if not abs(position[node] - wanted) <= TOLERANCE * ends[-1]:
            problems.append(
                f"point {name!r} at {wanted} m is not on a node; the nearest one is at "
                f"{position[node]:.9g} m"
            )
        nodes[name] = node
    if problems:
        raise InputError(problems)

    first = np.cumsum([0, *counts])
    parts: dict[str, list[IntArray]] = {}
    for (name, _, _), start, stop in zip(regions, first[:-1], first[1:], strict=True):
        parts.setdefault(name, []).append(np.arange(start, stop))
    coordinates = np.column_stack([position, np.zeros((position.size, 2))])
    named = {name: np.concatenate(pieces) for name, pieces in parts.items()}
    return BarMesh(_skfem_mesh(position, named, nodes), coordinates, named, nodes, "")


def refined(bar: BarMesh) -> BarMesh:
    """Bar with every element halved; names stay."""
    s = bar.mesh.p[0]
    middle = 0.5 * (s[:-1] + s[1:])
    coordinates = np.empty((2 * s.size - 1, 3))
    coordinates[::2] = bar.coordinates
    coordinates[1::2] = 0.5 * (bar.coordinates[:-1] + bar.coordinates[1:])
    nodes = np.empty(2 * s.size - 1)
    nodes[::2], nodes[1::2] = s, middle
    regions = {
        name: (2 * elements[:, np.newaxis] + np.arange(2)).ravel()
        for name, elements in bar.regions.items()
    }
    points = {name: 2 * node for name, node in bar.points.items()}
    mesh = _skfem_mesh(nodes, regions, points)
    return BarMesh(mesh, coordinates, regions, points, bar.path)


def write_mesh(bar: BarMesh, path: str | Path) -> None:
    """Write a bar as Gmsh 4.1 ASCII with its regions and points as physical groups.

    Curves run between the ends of the bar, its named points and the borders of its regions, so
    that overlapping regions need no repeated cells.

    Raises
    ------
    InputError
        A name cannot stand in the format, or the file cannot be written.
    """
    problems = name_problems(region=bar.regions, point=bar.points)
    if problems:
        raise InputError([f"{path}: {problem}" for problem in problems])
    n_nodes = len(bar.coordinates)
    member = np.zeros((len(bar.regions), n_nodes - 1), dtype=bool)
    for row, elements in enumerate(bar.regions.values()):
        member[row, elements] = True
    borders = np.flatnonzero((member[:, 1:] != member[:, :-1]).any(axis=0)) + 1
    corners = sorted({0, n_nodes - 1, *bar.points.values(), *borders.tolist()})
    curves = list(itertools.pairwise(corners))
    point_tags = {name: len(bar.regions) + 1 + i for i, name in enumerate(bar.points)}
    tags_at = {
        node: [point_tags[name] for name, at in bar.points.items() if at == node]
        for node in corners
    }

    def words(values: Iterable[Any]) -> str:
        return " ".join(str(value) for value in values)

    def position(node: int) -> str:
        return words(bar.coordinates[node].tolist())

    names = [f'0 {tag} "{name}"' for name, tag in point_tags.items()]
    names += [f'1 {tag} "{name}"' for tag, name in enumerate(bar.regions, 1)]
    lines = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat"]
    if names:
        lines += ["$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames"]

    lines += ["$Entities", f"{len(corners)} {len(curves)} 0 0"]
    for tag, node in enumerate(corners, 1):
        lines.append(f"{tag} {position(node)} {words([len(tags_at[node]), *tags_at[node]])}")
    for tag, (start, stop) in enumerate(curves, 1):
        ends = bar.coordinates[[start, stop]]
        box = words([*ends.min(axis=0).tolist(), *ends.max(axis=0).tolist()])
        physical = (np.flatnonzero(member[:, start]) + 1).tolist()
        lines.append(f"{tag} {box} {words([len(physical), *physical])} 2 {tag} {-(tag + 1)}")

    blocks = [(0, tag, [node]) for tag, node in enumerate(corners, 1)]
    blocks += [(1, tag, list(range(a + 1, b))) for tag, (a, b) in enumerate(curves, 1) if b > a + 1]
    lines += ["$EndEntities", "$Nodes", f"{len(blocks)} {n_nodes} 1 {n_nodes}"]
    for dimension, tag, nodes in blocks:
        lines.append(f"{dimension} {tag} 0 {len(nodes)}")
        lines += [str(node + 1) for node in nodes]
        lines += [position(node) for node in nodes]

    marked = [(tag, node) for tag, node in enumerate(corners, 1) if tags_at[node]]
    total = len(marked) + n_nodes - 1
    lines += ["$EndNodes", "$Elements", f"{len(marked) + len(curves)} {total} 1 {total}"]
    for number, (tag, node) in enumerate(marked, 1):
        lines += [f"0 {tag} 15 1", f"{number} {node + 1}"]
    for tag, (start, stop) in enumerate(curves, 1):
        lines.append(f"1 {tag} 1 {stop - start}")
        lines += [f"{len(marked) + i + 1} {i + 1} {i + 2}" for i in range(start, stop)]
    lines += ["$EndElements", ""]
    try:
        Path(path).write_text("\n".join(lines), encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def _skfem_mesh(
    position: FloatArray, regions: Mapping[str, IntArray], points: Mapping[str, int]
) -> skfem.MeshLine1:
    nodes = np.arange(position.size)
    return skfem.MeshLine1(
        position[np.newaxis],
        np.vstack([nodes[:-1], nodes[1:]]),
        {name: np.array([node]) for name, node in points.items()} or None,
        dict(regions) or None,
    )


def _lines_and_names(
    raw: meshio.Mesh,
) -> tuple[IntArray, dict[str, IntArray], dict[str, IntArray]]:
    """Two-node segments, segment indices by region name, node indices by point name.

    Raises ValueError for other cells, and for names that hold nothing.
    """
    others = {block.type for block in raw.cells if len(block.data)}
    others = {kind for kind in others if kind != "vertex" and not _LINE_TYPE.fullmatch(kind)}
    if others:
        raise ValueError(
            f"it holds cells of type {', '.join(sorted(others))}: this loader is for bars; allowed "
            "are lines and points. Save the curves alone"
        )
    sets = cell_sets(raw)
    segments: list[IntArray] = []
    regions: dict[str, list[IntArray]] = {}
    points: dict[str, list[IntArray]] = {
        name: [np.asarray(nodes, dtype=np.int64).ravel()] for name, nodes in raw.point_sets.items()
    }
    count = 0
    for number, block in enumerate(raw.cells):
        cells = np.asarray(block.data, dtype=np.int64)
        if not cells.size:
            continue
        # Nodes of a line of higher order: the two ends, then the inner ones from first to second.
        chain = cells[:, [0, *range(2, cells.shape[1]), 1]] if block.type != "vertex" else cells
        per_cell = chain.shape[1] - 1
        for name, members in sets.items():
            chosen = members[number]
            if not chosen.size:
                continue
            if block.type == "vertex":
                points.setdefault(name, []).append(cells[chosen, 0])
            else:
                inside = count + chosen[:, np.newaxis] * per_cell + np.arange(per_cell)
                regions.setdefault(name, []).append(inside.ravel())
        if block.type != "vertex":
            pairs = np.stack([chain[:, :-1], chain[:, 1:]], axis=-1)
            segments.append(pairs.reshape(-1, 2))
            count += len(segments[-1])
    if not segments:
        raise ValueError("it holds no line elements: a bar is made of lines")
    lost = lost_groups(raw, 1, regions.keys() | points.keys())
    if lost:
        raise ValueError(lost)
    return (
        np.concatenate(segments),
        {name: np.concatenate(parts) for name, parts in regions.items()},
        {name: np.concatenate(parts) for name, parts in points.items()},
    )


def _chain(
    coordinates: FloatArray,
    segments: IntArray,
    regions: Mapping[str, IntArray],
    points: Mapping[str, IntArray],
    path: str,
) -> BarMesh:
    """Order segments along a straight line; ValueError says where they are not one chain."""

    def at(node: int) -> str:
        x, y, z = coordinates[node]
        return f"node {node + 1} at ({x:.9g}, {y:.9g}, {z:.9g}) m"

    if segments.min() < 0 or segments.max() >= len(coordinates):
        raise ValueError("an element refers to a node that the file does not hold")
    strange = ~(np.abs(coordinates) < _LONGEST).all(axis=1)
    if strange.any():
        raise ValueError(f"{at(int(np.argmax(strange)))}: coordinates must be finite, below 1e20 m")
    segments, element_of = np.unique(np.sort(segments, axis=1), axis=0, return_inverse=True)
    size = np.linalg.norm(coordinates[segments[:, 1]] - coordinates[segments[:, 0]], axis=1)
    if size.min() == 0.0:
        a, b = segments[np.argmin(size)]
        raise ValueError(f"an element has no length: from {at(a)} to {at(b)}")
    neighbours = np.bincount(segments.ravel(), minlength=len(coordinates))
    if neighbours.max() > 2:
        node = int(np.argmax(neighbours))
        raise ValueError(
            f"the bar branches or overlaps itself: {neighbours[node]} elements meet at {at(node)}"
        )
    if not (neighbours == 1).any():
        raise ValueError(f"the bar is closed: it has no end, going on from {at(segments[0, 0])}")

    nodes = np.flatnonzero(neighbours)
    start, direction = _line(coordinates[nodes])
    position = (coordinates[nodes] - start) @ direction
    off_line = np.linalg.norm(
        coordinates[nodes] - start - position[:, np.newaxis] * direction, axis=1
    )
    length = float(position.max())
    if length < _SHORTEST:
        raise ValueError(f"the bar is {length:.3g} m long: it must be {_SHORTEST:g} m or more")
    if off_line.max() > TOLERANCE * length:
        worst = int(np.argmax(off_line))
        raise ValueError(
            f"the bar is not straight: {at(nodes[worst])} is {off_line[worst]:.3g} m off the line "
            f"between the farthest nodes; {TOLERANCE * length:.1g} m are allowed"
        )
    order = np.argsort(position, kind="stable")
    nodes, position = nodes[order], position[order]
    gaps = np.diff(position)
    if gaps.min() <= TOLERANCE * length:
        i = int(np.argmin(gaps))
        raise ValueError(
            f"two nodes in one place: {at(nodes[i])} and {at(nodes[i + 1])}; merge them "
            "(Gmsh: Coherence Mesh)"
        )
    rank = np.full(len(coordinates), -1)
    rank[nodes] = np.arange(nodes.size)
    ends = np.sort(rank[segments], axis=1)
    passed = ends[:, 1] - ends[:, 0] > 1
    if passed.any():
        a, b = ends[np.argmax(passed)]
        raise ValueError(
            f"the bar folds back or overlaps itself: the element from {at(nodes[a])} to "
            f"{at(nodes[b])} passes {at(nodes[a + 1])}"
        )
    broken = np.setdiff1d(np.arange(nodes.size - 1), ends[:, 0])
    if broken.size:
        raise ValueError(
            f"the bar is disconnected: no element between {at(nodes[broken[0]])} and "
            f"{at(nodes[broken[0] + 1])}"
        )

    named_points = {}
    for name, marked in points.items():
        places = np.unique(marked)
        if places.size != 1:
            raise ValueError(f"point name {name!r} marks {places.size} nodes: give each its own")
        if not 0 <= places[0] < len(rank) or rank[places[0]] < 0:
            raise ValueError(f"point {name!r} is not on the bar: no element uses its node")
        named_points[name] = int(rank[places[0]])
    named_regions = {
        name: np.unique(ends[element_of[members], 0]) for name, members in regions.items()
    }
    return BarMesh(
        _skfem_mesh(position, named_regions, named_points),
        coordinates[nodes],
        named_regions,
        named_points,
        path,
    )


def _line(coordinates: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First end and unit direction of the line through the farthest nodes along an axis."""
    axis = int(np.argmax(np.ptp(coordinates, axis=0)))
    a, b = int(np.argmin(coordinates[:, axis])), int(np.argmax(coordinates[:, axis]))
    along = coordinates[b] - coordinates[a]
    length = math.hypot(*along)
    # Lexicographic order of the ends, blind to round-off in a coordinate that they share.
    if along[np.argmax(np.abs(along) > TOLERANCE * length)] < 0.0:
        a, along = b, -along
    return coordinates[a], along / length
