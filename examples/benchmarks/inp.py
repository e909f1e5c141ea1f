"""Meshes of the package as decks of Abaqus and CalculiX, and frequencies by CalculiX."""

import re
import subprocess

import numpy as np

#: Types by kind of element, of first and second order.
TYPES = {
    "tetrahedron": ("C3D4", "C3D10"),
    "hexahedron": ("C3D8I", "C3D20"),
    "prism": ("C3D6", "C3D15"),
    "quadrilateral": ("CPS4", "CPS8"),
    "triangle": ("CPS3", "CPS6"),
}
_TRIANGLE, _SQUARE = ((0, 1), (1, 2), (2, 0)), ((0, 1), (1, 2), (2, 3), (3, 0))
#: Corners at the ends of edges, and of the sides S1, S2, ..., in the order of the programs.
EDGES = {
    "line": (),
    "triangle": _TRIANGLE,
    "quadrilateral": _SQUARE,
    "tetrahedron": ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)),
    "prism": (*_TRIANGLE, (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    "hexahedron": (
        *(*_SQUARE, (4, 5), (5, 6), (6, 7), (7, 4)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}
SIDES = {
    "triangle": _TRIANGLE,
    "quadrilateral": _SQUARE,
    "tetrahedron": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "prism": ((0, 1, 2), (3, 5, 4), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "hexahedron": (
        *((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
    ),
}
#: Corners of scikit-fem's hexahedron in the programs' order.
HEXAHEDRON = [0, 3, 6, 2, 1, 5, 7, 4]


def model(mesh, order=None):
    """Places of the nodes, those between corners last, and numbers and nodes by kind of element."""
    tables, xyz = {}, mesh.coordinates
    for kind, elements, corners in mesh.parts:
        own = corners[HEXAHEDRON] if kind.name == "hexahedron" else corners
        tables[kind.name] = (elements, own.T)
    if (order or mesh.order) == 1:
        return xyz, tables
    pairs = [np.sort(t[:, EDGES[kind]], axis=2) for kind, (_, t) in tables.items()]
    every, place = np.unique(
        np.vstack([each.reshape(-1, 2) for each in pairs]), axis=0, return_inverse=True
    )
    ends = np.cumsum([each[..., 0].size for each in pairs])[:-1]
    places = np.split(len(xyz) + place.ravel(), ends)
    for (kind, (elements, t)), between in zip(tables.items(), places, strict=True):
        tables[kind] = elements, np.hstack([t, between.reshape(len(t), -1)])
    return np.vstack([xyz, xyz[every].mean(axis=1)]), tables


def sides(mesh, name, tables):
    """Element, number from 1 on, and nodes of each side of a boundary."""
    facets = mesh.boundaries[name]
    beside = mesh.mesh.f2t[0, facets]
    for kind, (elements, nodes) in tables.items():
        corners = 1 + max(map(max, SIDES[kind]))
        inside = np.isin(beside, elements)
        for element, facet in zip(beside[inside], facets[inside], strict=True):
            row = nodes[np.searchsorted(elements, element)].tolist()
            on = {row.index(k) for k in mesh.mesh.facets[:, facet]}
            (number,) = (k for k, side in enumerate(SIDES[kind], 1) if set(side) == on)
            edges = [k for k, ends in enumerate(EDGES[kind], corners) if set(ends) <= on]
            yield int(element), number, [row[k] for k in (*on, *edges) if k < len(row)]


def listed(numbers):
    """Lines of at most sixteen numbers from 1 on."""
    words = [str(number + 1) for number in np.asarray(numbers).tolist()]
    return [", ".join(words[at : at + 16]) for at in range(0, len(words), 16)]


def deck(mesh, surfaces=None, *, types=TYPES, order=None, body=None):
    """Lines of a deck: nodes, elements in the set EALL, regions and boundaries.

    Parameters
    ----------
    mesh : NamedMesh
    surfaces : sequence of str, optional
        Boundaries that are surfaces; the others are sets of nodes. All if not given.
    types : mapping
        As `TYPES`.
    order : {1, 2}, optional
        That of the mesh, if not given.
    body : int, optional
        The one that is written, with its own numbers; all if not given.
    """
    xyz, tables = model(mesh, order)
    chosen = np.flatnonzero(np.ones(mesh.n_elements) if body is None else mesh.body == body)
    own = {}
    for kind, (elements, nodes) in tables.items():
        inside = np.isin(elements, chosen)
        own[kind] = elements[inside], nodes[inside]
    used = np.unique(np.concatenate([nodes.ravel() for _, nodes in own.values()]))
    lines = ["*NODE"]
    lines += [f"{k}, {x!r}, {y!r}, {z!r}" for k, (x, y, z) in enumerate(xyz[used].tolist(), 1)]
    for kind, (elements, nodes) in own.items():
        kind_of = types[kind][(order or mesh.order) - 1]
        lines.append(f"*ELEMENT, TYPE={kind_of}, ELSET=EALL")
        for element, row in zip(elements, np.searchsorted(used, nodes), strict=True):
            first, *more = listed([np.searchsorted(chosen, element), *row])
            lines += [f"{first},", *more] if more else [first]
    for name, members in mesh.regions.items():
        if (inside := np.flatnonzero(np.isin(chosen, members))).size:
            lines += [f"*ELSET, ELSET={name}", *listed(inside)]
    for name in mesh.boundaries:
        found = [*sides(mesh, name, own)]
        if found and (surfaces is None or name in surfaces):
            lines.append(f"*SURFACE, NAME={name}, TYPE=ELEMENT")
            lines += [f"{np.searchsorted(chosen, e) + 1}, S{number}" for e, number, _ in found]
        elif found:
            nodes = np.unique(np.concatenate([on for _, _, on in found]))
            lines += [f"*NSET, NSET={name}", *listed(np.searchsorted(used, nodes))]
    return lines


def by_calculix(lines, folder):
    """What CalculiX prints for a deck: before its eigenvalues, and its frequencies, Hz."""
    (folder / "run.inp").write_text("\n".join([*lines, ""]), encoding="utf-8")
    subprocess.run(["ccx", "run"], cwd=folder, capture_output=True, check=True)
    before, _, found = (folder / "run.dat").read_text().partition("E I G E N V A L U E")
    values = re.findall(r"^\s+\d+\s+\S+\s+\S+\s+(\S+)\s+\S+\s*$", found, re.MULTILINE)
    return before, np.array(values, dtype=float)
