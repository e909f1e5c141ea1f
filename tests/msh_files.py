"""Gmsh files for the tests, written by hand."""

from __future__ import annotations

from collections.abc import Sequence

#: Gmsh type, physical tag, node tags.
Cells = Sequence[tuple[int, int, Sequence[int]]]


def msh22(nodes: Sequence[Sequence[float]], cells: Cells, names: str) -> str:
    """Gmsh 2.2 ASCII; node tags count from 1, entities have the tags of the groups."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    lines += ["$PhysicalNames", f"{names.count(chr(10))}", names + "$EndPhysicalNames"]
    lines += ["$Nodes", f"{len(nodes)}"]
    lines += [f"{i} {x!r} {y!r} {z!r}" for i, (x, y, z) in enumerate(nodes, 1)]
    lines += ["$EndNodes", "$Elements", f"{len(cells)}"]
    lines += [
        f"{i} {kind} 2 {tag} {tag} {' '.join(map(str, at))}"
        for i, (kind, tag, at) in enumerate(cells, 1)
    ]
    return "\n".join([*lines, "$EndElements", ""])
