"""Checks of words and names, with messages for users."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.errors import closest, listed
from skfem_joint.mesh import NamedMesh

#: Kinds of named parts of a mesh.
KINDS = ("region", "boundary", "point")


def one_of(where: str, value: str, allowed: Sequence[str]) -> Iterator[str]:
    """Yield a sentence if a word is not among the allowed words."""
    if value not in allowed:
        yield f"{where}: found {value!r}, must be one of {', '.join(allowed)}"


def wrong_name(mesh: NamedMesh, name: str, kinds: Sequence[str], where: str) -> list[str]:
    """What is wrong with the name of a part of the mesh, which must be of some of the kinds."""
    tables: dict[str, Mapping[str, Any]] = {
        "region": mesh.regions, "boundary": mesh.boundaries, "point": mesh.points
    }  # fmt: skip
    own_kinds = [kind for kind in tables if name in tables[kind]]
    if set(own_kinds) & set(kinds):
        return []
    if not any(tables.values()):
        return [
            f"{where}: found {name!r}, but nothing in the mesh has a name: name Physical Groups, "
            f"in Gmsh such as Physical Curve({name!r}) = {{1}}, Physical Surface, Physical Volume "
            "or Physical Point; save the mesh again"
        ]
    has = "; ".join(f"{kind}: {listed(tables[kind])}" for kind in kinds)
    wrong = f"which is a {own_kinds[0]}" if own_kinds else "no such name in the mesh"
    hint = "" if own_kinds else closest(name, [n for kind in kinds for n in tables[kind]])
    return [
        f"{where}: found {name!r}, {wrong}; a {' or '.join(kinds)} is needed; the mesh has {has}"
        f"{hint}"
    ]


def overlap(first: ArrayLike, second: ArrayLike) -> bool:
    """Whether two sets of element or facet numbers have a member in common."""
    return np.intersect1d(first, second).size > 0
