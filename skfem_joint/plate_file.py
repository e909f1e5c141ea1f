"""Plates written as Gmsh files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.mesh_file import name_problems
from skfem_joint.plate_mesh import PlateMesh

IntArray = NDArray[np.int64]

# Gmsh's numbers of the element types, by corners and order.
_GMSH_TYPES = {(2, 1): 1, (2, 2): 8, (3, 1): 2, (3, 2): 9, (4, 1): 3, (4, 2): 10}


def write_plate(plate: PlateMesh, path: str | Path) -> None:
    """Write a plate as Gmsh 4.1 ASCII; regions, boundaries and points are its physical groups.

    Elements of the same regions make one surface, facets of the same boundaries one curve, so that
    overlapping groups need no repeated cells. Elements are written in the order of first
    appearance of their surfaces. Of order 2, elements are written with their middle nodes.

    Raises
    ------
    InputError
        A name cannot stand in the format, or the file cannot be written.
    """
    problems = name_problems(region=plate.regions, boundary=plate.boundaries, point=plate.points)
    if problems:
        raise InputError([f"{path}: {problem}" for problem in problems])
    mesh, order = plate.mesh, plate.order
    positions, facets, cells = mesh.p, mesh.facets, mesh.t
    if order == 2:
        middle = mesh.nvertices + np.arange(mesh.nfacets)
        positions = np.hstack([positions, mesh.p[:, mesh.facets].mean(axis=1)])
        facets = np.vstack([facets, middle])
        # scikit-fem's third facet of a triangle and fourth of a quadrilateral close the circle.
        cells = np.vstack([cells, middle[mesh.t2f]])
        if plate.kind == "quadrilateral":
            cells = np.vstack([cells, positions.shape[1] + np.arange(mesh.nelements)])
            positions = np.hstack([positions, mesh.p[:, mesh.t].mean(axis=1)])

    tags: dict[tuple[int, str], int] = {}
    names = []
    groups: tuple[Iterable[str], ...] = (plate.points, plate.boundaries, plate.regions)
    for dimension, named in enumerate(groups):
        for name in named:
            tags[dimension, name] = len(tags) + 1
            names.append(f'{dimension} {tags[dimension, name]} "{name}"')
    vertex_groups = {name: np.array([vertex]) for name, vertex in plate.points.items()}
    # Dimension, physical tags, element type and rows of node numbers of each entity.
    entities: list[tuple[int, list[int], int, IntArray]] = []
    for dimension, named, nodes, kind in (
        (0, vertex_groups, np.arange(mesh.nvertices)[np.newaxis], 15),
        (1, plate.boundaries, facets, _GMSH_TYPES[2, order]),
        (2, plate.regions, cells, _GMSH_TYPES[len(mesh.t), order]),
    ):
        for members, chosen in _by_membership(named, nodes.shape[1]):
            if members or dimension == 2:
                physical = [tags[dimension, name] for name in members]
                entities.append((dimension, physical, kind, nodes[:, chosen].T))

    counts = [sum(entity[0] == dimension for entity in entities) for dimension in range(3)]
    lines = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat"]
    if names:
        lines += ["$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames"]
    lines += ["$Entities", _words([*counts, 0])]
    surface = len(entities) - counts[2] + 1
    for tag, (dimension, physical, _, nodes) in enumerate(entities, 1):
        used = positions[:, np.unique(nodes)]
        low, high = ([*side.tolist(), 0.0] for side in (used.min(axis=1), used.max(axis=1)))
        box = low if dimension == 0 else [*low, *high]
        bounds = [] if dimension == 0 else [0]
        lines.append(_words([tag, *box, len(physical), *physical, *bounds]))
    n_nodes = positions.shape[1]
    lines += ["$EndEntities", "$Nodes", f"1 {n_nodes} 1 {n_nodes}", f"2 {surface} 0 {n_nodes}"]
    lines += [str(number) for number in range(1, n_nodes + 1)]
    lines += [f"{x!r} {y!r} 0.0" for x, y in positions.T.tolist()]
    total = sum(len(nodes) for _, _, _, nodes in entities)
    lines += ["$EndNodes", "$Elements", f"{len(entities)} {total} 1 {total}"]
    number = 0
    for tag, (dimension, _, kind, nodes) in enumerate(entities, 1):
        lines.append(f"{dimension} {tag} {kind} {len(nodes)}")
        for row in (nodes + 1).tolist():
            number += 1
            lines.append(_words([number, *row]))
    lines += ["$EndElements", ""]
    try:
        Path(path).write_text("\n".join(lines), encoding="utf-8", newline="\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def _words(values: Sequence[float]) -> str:
    return " ".join(map(str, values))


def _by_membership(named: Mapping[str, IntArray], count: int) -> list[tuple[list[str], IntArray]]:
    """Names of the groups and numbers of the things that are in just these, by first thing."""
    member = np.zeros((count, len(named)), dtype=bool)
    for column, numbers in enumerate(named.values()):
        member[numbers, column] = True
    which, first, at = np.unique(member, axis=0, return_index=True, return_inverse=True)
    names = list(named)
    return [
        ([names[i] for i in np.flatnonzero(which[row])], np.flatnonzero(at.ravel() == row))
        for row in np.argsort(first)
    ]
