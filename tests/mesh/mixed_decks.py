"""Decks of Abaqus and CalculiX of meshes of two kinds of elements, for the tests of both."""

import numpy as np

from skfem_joint.mesh import NamedMesh

#: Types by kind of element, of first and second order.
TYPES = {
    "hexahedron": ("C3D8I", "C3D20"),
    "prism": ("C3D6", "C3D15"),
    "quadrilateral": ("CPS4", "CPS8"),
    "triangle": ("CPS3", "CPS6"),
}
#: Corners at the ends of edges, and of the faces, in the order of the programs.
EDGES = {
    "hexahedron": (
        *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
    "prism": ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
    "quadrilateral": ((0, 1), (1, 2), (2, 3), (3, 0)),
    "triangle": ((0, 1), (1, 2), (2, 0)),
}
FACES = {
    "hexahedron": (
        *((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
    ),
    "prism": ((0, 1, 2), (3, 5, 4), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    "quadrilateral": EDGES["quadrilateral"],
    "triangle": EDGES["triangle"],
}
#: Corners of scikit-fem's hexahedron in the programs' order.
HEXAHEDRON = [0, 3, 6, 2, 1, 5, 7, 4]


def deck(mesh: NamedMesh, surfaces: bool = True) -> list[str]:
    """Lines of a deck: nodes, elements, regions as sets, and boundaries as surfaces or sets."""
    tables = {}
    for kind, elements, corners in mesh.parts:
        own = corners[HEXAHEDRON] if kind.name == "hexahedron" else corners
        tables[kind.name] = (elements, own.T)
    xyz, between = mesh.coordinates, {}
    if mesh.order == 2:
        pairs = [np.sort(t[:, EDGES[kind]], axis=2) for kind, (_, t) in tables.items()]
        every, place = np.unique(
            np.vstack([each.reshape(-1, 2) for each in pairs]), axis=0, return_inverse=True
        )
        ends = np.cumsum([each[..., 0].size for each in pairs])[:-1]
        places = np.split(len(xyz) + place.ravel(), ends)
        between = {
            kind: own.reshape(len(t), -1)
            for (kind, (_, t)), own in zip(tables.items(), places, strict=True)
        }
        xyz = np.vstack([xyz, xyz[every].mean(axis=1)])
    lines = ["*NODE, NSET=NALL"]
    lines += [f"{k}, {x!r}, {y!r}, {z!r}" for k, (x, y, z) in enumerate(xyz.tolist(), 1)]
    sides: dict[tuple[int, ...], tuple[int, int, list[int]]] = {}
    for kind, (elements, t) in tables.items():
        nodes = np.hstack([t, between[kind]]) if between else t
        lines.append(f"*ELEMENT, TYPE={TYPES[kind][mesh.order - 1]}, ELSET=EALL")
        for element, row in zip(elements.tolist(), (nodes + 1).tolist(), strict=True):
            words = [str(element + 1), *map(str, row)]
            lines += [", ".join(words[:16]) + ("," if words[16:] else "")]
            lines += [", ".join(words[16:])] if words[16:] else []
            for number, face in enumerate(FACES[kind], 1):
                edges = [k for k, pair in enumerate(EDGES[kind]) if set(pair) <= set(face)]
                on = [row[k] for k in face]
                on += [row[len(t[0]) + k] for k in edges] if between else []
                sides[tuple(sorted({row[k] for k in face}))] = element + 1, number, on
    for name, chosen in mesh.regions.items():
        lines += [f"*ELSET, ELSET={name}", *_listed(chosen + 1)]
    for name, facets in mesh.boundaries.items():
        found = [
            sides[tuple(sorted(set((mesh.mesh.facets[:, facet] + 1).tolist())))] for facet in facets
        ]
        if surfaces:
            lines += [f"*SURFACE, NAME={name}", *(f"{e}, S{side}" for e, side, _ in found)]
        else:
            nodes = np.unique(np.concatenate([on for _, _, on in found]))
            lines += [f"*NSET, NSET={name}", *_listed(nodes)]
    return lines


def _listed(numbers: np.ndarray) -> list[str]:
    """Lines of at most sixteen numbers."""
    words = list(map(str, numbers.tolist()))
    return [", ".join(words[at : at + 16]) for at in range(0, len(words), 16)]
