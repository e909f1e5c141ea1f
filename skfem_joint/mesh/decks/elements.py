"""Elements of Abaqus and CalculiX files: types, order of the nodes, and numbers of the faces.

All programs order the nodes of these elements as VTK and meshio do, but for the three-node bar.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

_TRIANGLE = ((0, 1), (1, 2), (2, 0))
_SQUARE = (*_TRIANGLE[:2], (2, 3), (3, 0))
_TETRAHEDRON = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
_PRISM = (*_TRIANGLE, (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5))
_CUBE = (*_SQUARE, (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7))
_SIDES_OF_CUBE = ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3),
                  (3, 7, 4, 0))  # fmt: skip
_SIDES_OF_PRISM = ((0, 1, 2), (3, 5, 4), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))


@dataclass(frozen=True)
class ElementForm:
    """Shape of an element and its order.

    Attributes
    ----------
    name : str
        As meshio calls it.
    dim, nodes : int
        Dimension, and number of nodes.
    edges : tuple of pair of int
        Corners at the ends of the edges, in the order of the nodes between them.
    sides : dict of str to tuple of int
        Corners of the faces by their labels.
    """

    name: str
    dim: int
    nodes: int
    edges: tuple[tuple[int, int], ...]
    sides: dict[str, tuple[int, ...]]

    @property
    def corners(self) -> int:
        """Number of corners, its first nodes; of a line all nodes, which may part at the middle."""
        return self.nodes - len(self.edges) if self.dim > 1 else self.nodes

    @property
    def family(self) -> str:
        """Name of the shape beside whose elements these may stand in a mesh."""
        beside = {"triangle": "quad", "triangle6": "quad8", "wedge": "hexahedron"}
        return (beside | {"wedge15": "hexahedron20"}).get(self.name, self.name)

    @cached_property
    def nodes_of_sides(self) -> dict[str, list[int]]:
        """All nodes of the sides, those between the corners last."""
        between = list(enumerate(self.edges, self.nodes - len(self.edges)))
        return {
            label: [*corners, *(node for node, ends in between if set(ends) <= set(corners))]
            for label, corners in self.sides.items()
        }


def _numbered(sides: tuple[tuple[int, ...], ...]) -> dict[str, tuple[int, ...]]:
    return {f"S{number}": corners for number, corners in enumerate(sides, 1)}


_ENDS: dict[str, tuple[int, ...]] = {"END1": (0,), "END2": (1,)}
_OF_TETRAHEDRON = _numbered(((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)))
#: Shapes by the names that meshio has for them.
FORMS = {
    "line": ElementForm("line", 1, 2, (), _ENDS),
    "line3": ElementForm("line3", 1, 3, ((0, 1),), _ENDS),
    "triangle": ElementForm("triangle", 2, 3, (), _numbered(_TRIANGLE)),
    "triangle6": ElementForm("triangle6", 2, 6, _TRIANGLE, _numbered(_TRIANGLE)),
    "quad": ElementForm("quad", 2, 4, (), _numbered(_SQUARE)),
    "quad8": ElementForm("quad8", 2, 8, _SQUARE, _numbered(_SQUARE)),
    "tetra": ElementForm("tetra", 3, 4, (), _OF_TETRAHEDRON),
    "tetra10": ElementForm("tetra10", 3, 10, _TETRAHEDRON, _OF_TETRAHEDRON),
    "hexahedron": ElementForm("hexahedron", 3, 8, (), _numbered(_SIDES_OF_CUBE)),
    "hexahedron20": ElementForm("hexahedron20", 3, 20, _CUBE, _numbered(_SIDES_OF_CUBE)),
    "wedge": ElementForm("wedge", 3, 6, (), _numbered(_SIDES_OF_PRISM)),
    "wedge15": ElementForm("wedge15", 3, 15, _PRISM, _numbered(_SIDES_OF_PRISM)),
}
#: Endings that change how a program computes an element, and not its nodes, by type.
_VARIANTS = {
    **dict.fromkeys(("T2D2", "T3D2", "T2D3", "T3D3", "B21", "B22"), ("", "H")),
    **dict.fromkeys(("B31", "B32"), ("", "H", "R")),
    **{"CPS3": ("",), "CPE3": ("", "H"), "CPS6": ("", "M"), "CPE6": ("", "H", "M", "MH")},
    **{"CPS4": ("", "R", "I"), "CPE4": ("", "R", "I", "H", "RH", "IH")},
    **{"CPS8": ("", "R"), "CPE8": ("", "R", "H", "RH")},
    **{"C3D4": ("", "H"), "C3D10": ("", "H", "M", "MH", "HS", "T")},
    **{"C3D8": ("", "R", "I", "H", "RH", "IH"), "C3D20": ("", "R", "H", "RH")},
    **{"C3D6": ("", "H"), "C3D15": ("", "H")},
}
_NAMES = {
    **{"T2D2": "line", "T3D2": "line", "B21": "line", "B31": "line"},
    **{"T2D3": "line3", "T3D3": "line3", "B22": "line3", "B32": "line3"},
    **{f"CP{plane}3": "triangle" for plane in "SE"},
    **{f"CP{plane}4": "quad" for plane in "SE"},
    **{f"CP{plane}6": "triangle6" for plane in "SE"},
    **{f"CP{plane}8": "quad8" for plane in "SE"},
    **{"C3D4": "tetra", "C3D10": "tetra10", "C3D8": "hexahedron", "C3D20": "hexahedron20"},
    **{"C3D6": "wedge", "C3D15": "wedge15"},
}
#: Shape of each type that is read.
TYPES = {
    kind + ending: FORMS[_NAMES[kind]] for kind, endings in _VARIANTS.items() for ending in endings
}
#: Types that are met often and not read, by what they begin with, and what to do.
_OTHERS = {
    "C3D5": "pyramids are not read: mesh with tetrahedra alone, or with hexahedra and prisms",
    "C3D13": "pyramids are not read: mesh with tetrahedra alone, or with hexahedra and prisms",
    "C3D27": "save them with 20 nodes, C3D20",
    **dict.fromkeys(("S3", "S4", "S6", "S8", "STRI", "SC", "M3D"),
                    "shells and membranes are not read: mesh the body as a solid"),
    **dict.fromkeys(("SPRING", "DASHPOT", "MASS", "ROTARYI", "GAP", "CONN", "DCOUP"),
                    "springs, masses and couplings of nodes are not read: take them out"),
    **dict.fromkeys(("CAX", "CGAX"), "bodies of revolution are not read: mesh the solid"),
}  # fmt: skip


def form_of_type(kind: str) -> ElementForm:
    """Shape of a type; ValueError for types that are not read, with those that are."""
    if kind in TYPES:
        return TYPES[kind]
    why = next((why for start, why in _OTHERS.items() if kind.startswith(start)), "")
    base = max((name for name in _NAMES if kind.startswith(name)), key=len, default="")
    if base and not why:
        endings = ", ".join(f"{base}{ending}" for ending in _VARIANTS[base])
        raise ValueError(f"type {kind[:20]}: allowed are {endings}")
    raise ValueError(
        f"type {kind[:20] or 'missing'}: {f'{why}; ' if why else ''}allowed are "
        f"{', '.join(_NAMES)}, most of them with endings such as R, I, H, M"
    )


def plane_of(kind: str) -> str:
    """What a type says of the state across a plate: stress, strain, or nothing."""
    return {"CPS": "stress", "CPE": "strain"}.get(kind[:3], "")


def remark(kind: str) -> str:
    """How elements of a type are computed, if it is not as the type says; else empty."""
    form = TYPES[kind]
    if kind.startswith("B"):
        return "are computed as bars, which carry no bending"
    if form.name in ("quad", "hexahedron") and "I" not in kind:
        plain = kind.rstrip("RH")
        return (
            f"have incompatible modes, as {plain}I has, unless mesh.incompatible = false"
            f"{', and full integration' if 'R' in kind else ''}"
        )
    if form.name in ("quad8", "hexahedron20"):
        nodes, where = (9, "in the middle") if form.dim == 2 else (27, "in faces and middle")
        return (
            f"are computed with {nodes} nodes, those {where} added on the same edges, and with "
            "full integration"
        )
    if form.name == "wedge":
        return "have full integration, and bend too stiffly unless mesh.order is 'auto' or 2"
    if form.name == "wedge15":
        return (
            "are computed with 21 nodes, those in the middles of faces and of the triangle between "
            "added on the same edges"
        )
    ending = kind[len(kind.rstrip("HMSTR")) :] if form.dim > 1 else ""
    return f"are computed as {kind.removesuffix(ending)}" if ending else ""
