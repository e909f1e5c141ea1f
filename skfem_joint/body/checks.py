"""Checks of words and names, with messages for users."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from skfem_joint.ground.errors import closest, listed
from skfem_joint.mesh import NamedMesh
from skfem_joint.mesh.cells import TOLERANCE, nearest_places, outward, spot, within_reach

#: Kinds of named parts of a mesh.
KINDS = ("region", "boundary", "point")


def one_of(where: str, value: str, allowed: Sequence[str]) -> Iterator[str]:
    """Yield a sentence if a word is not among the allowed words."""
    if value not in allowed:
        yield f"{where}: found {value!r}, must be one of {', '.join(allowed)}"


def wrong_name(mesh: NamedMesh, name: Any, kinds: Sequence[str], where: str) -> list[str]:
    """What is wrong with the name of a part of the mesh, which must be of some of the kinds."""
    if not isinstance(name, str):
        return [f"{where}: found {name!r}, must be a name, which is text: {str(name)!r}"]
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
            + "".join(f"; {note}" for note in mesh.notes if repr(name) in note)
        ]
    has = "; ".join(f"{kind}: {listed(tables[kind])}" for kind in kinds)
    wrong = f"which is a {own_kinds[0]}" if own_kinds else "no such name in the mesh"
    hint = "" if own_kinds else closest(name, [n for kind in kinds for n in tables[kind]])
    hint += "".join(f"; {note}" for note in mesh.notes if repr(name) in note)
    return [
        f"{where}: found {name!r}, {wrong}; a {' or '.join(kinds)} is needed; the mesh has {has}"
        f"{hint}"
    ]


def overlap(first: ArrayLike, second: ArrayLike) -> bool:
    """Whether two sets of element or facet numbers have a member in common."""
    return np.intersect1d(first, second).size > 0


def body_label(mesh: NamedMesh, number: int) -> str:
    """A body in a message, named after the regions that lie in it alone, if there are any."""
    own = [
        repr(name)
        for name, elements in sorted(mesh.regions.items())
        if len(elements) and np.all(mesh.body[elements] == number)
    ]
    if own:
        return f"the body with the region{'s' if len(own) > 1 else ''} {', '.join(own)}"
    middle = mesh.mesh.p[:, mesh.mesh.t[:, mesh.body == number]].mean(axis=(1, 2))
    return f"the body around {spot(middle)}"


def both_faces(mesh: NamedMesh, name: str, where: str) -> Iterator[str]:
    """Refuse a region or boundary in which one body lies on another.

    Faces lie on each other if they look at each other and are no farther apart than a tenth of
    their shortest edge; cells of a region if the middle of one lies in the other.
    """
    side = name in mesh.boundaries
    own = (mesh.boundaries if side else mesh.regions)[name]
    cells = (mesh.mesh.facets if side else mesh.mesh.t)[:, own]
    element = mesh.mesh.f2t[0, own] if side else own
    body = mesh.body[element]
    if np.all(body == body[0]):
        return
    corners = mesh.mesh.p.T[cells.T]
    middle = corners.mean(axis=1)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    shortest = np.min(edges, axis=1, where=edges > 0.0, initial=np.inf)
    reach = (0.1 if side else TOLERANCE) * shortest
    first, second = within_reach(corners, cKDTree(middle), reach, 1)
    apart = body[first] != body[second]
    first, second = first[apart], second[apart]
    gap = np.linalg.norm(nearest_places(corners[first], middle[second]) - middle[second], axis=1)
    facing = gap <= reach[first]
    if side:
        normal = outward(corners, mesh.mesh.p[:, mesh.mesh.t[:, element]].mean(axis=1).T)
        normal /= np.linalg.norm(normal, axis=1)[:, np.newaxis]
        facing &= np.einsum("kd,kd->k", normal[first], normal[second]) < -0.5
    if not facing.any():
        return
    one, other = (body_label(mesh, int(body[of[facing][0]])) for of in (first, second))
    yield (
        f"{where}: {name!r} holds both {'faces' if side else 'parts'} of an interface, of {one} "
        f"and of {other}, at {spot(middle[second[facing][0]])}: give each body's own part a group, "
        "and name one as on and the other as against"
    )
