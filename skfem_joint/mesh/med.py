"""MED files of Salome and code_aster (``.med``), with their groups.

h5py reads the arrays of the file; here they become what meshio would have read, if it kept groups.
Every node and element belongs to a family, and a family to the groups that it lists, in versions 3
and 4. MED orders the nodes of solids as the mirror image of VTK's elements, on the same edges:
mirrored elements are turned over where all meshes are.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skfem_joint.ground.array_files import arrays_read_apart
from skfem_joint.ground.arrays import IntArray
from skfem_joint.ground.errors import listed
from skfem_joint.ground.files import read_whole
from skfem_joint.mesh.cells import repeated
from skfem_joint.mesh.decks.cards import decoded
from skfem_joint.mesh.decks.elements import FORMS
from skfem_joint.mesh.decks.sides import Sides, blocks_of
from skfem_joint.mesh.file_mesh import FileMesh
from skfem_joint.mesh.gmsh import meshio_with_prisms
from skfem_joint.mesh.named import check_count

if TYPE_CHECKING:
    import meshio

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_READ = """
def numbers(kind, group):
    for what in ("COO", "NOD", "FAM"):
        if what in group:
            # Where a damaged file has no data, zeros stand, and no chance content of the memory.
            arrays[what + " " + kind] = np.zeros(group[what].shape, group[what].dtype)
            if group[what].size:
                group[what].read_direct(arrays[what + " " + kind])
            arrays["NBR " + what + " " + kind] = group[what].attrs["NBR"]

with h5py.File(path, "r") as file:
    arrays["version"] = file["INFOS_GENERALES"].attrs["MAJ"]
    meshes = file["ENS_MAA"]
    arrays["meshes"] = len(meshes)
    name, mesh = next(iter(meshes.items()))
    for what in ("ESP", "TYP", "REP"):
        arrays[what] = mesh.attrs[what]
    steps = list(mesh.values())
    arrays["steps"] = len(steps)
    numbers("", steps[0]["NOE"])
    for kind, group in steps[0]["MAI"].items():
        numbers(kind, group)
    families = file["FAS"][name] if "FAS" in file and name in file["FAS"] else {}
    for kind in ("NOEUD", "ELEME"):
        for place, family in enumerate(families[kind].values() if kind in families else ()):
            text = family["GRO/NOM"][()] if "GRO" in family else np.zeros(0, "u1")
            shape = len(text), -1 if len(text) else 0
            arrays[f"names {kind} {place}"] = np.frombuffer(text.tobytes(), "u1").reshape(shape)
            arrays[f"number {kind} {place}"] = family.attrs["NUM"]
"""
#: Name and number of nodes that meshio has for MED's types.
_TYPES = {
    **{"PO1": ("vertex", 1), "SE2": ("line", 2), "SE3": ("line3", 3), "TR3": ("triangle", 3)},
    **{"TR6": ("triangle6", 6), "QU4": ("quad", 4), "QU8": ("quad8", 8), "QU9": ("quad9", 9)},
    **{"TE4": ("tetra", 4), "T10": ("tetra10", 10), "PE6": ("wedge", 6), "P15": ("wedge15", 15)},
    **{"HE8": ("hexahedron", 8), "H20": ("hexahedron20", 20), "H27": ("hexahedron27", 27)},
}
#: In what order VTK has the nodes on the faces of H27: sides along x, y and z.
_FACES = (24, 22, 21, 23, 20, 25)


def read_med(path: Path) -> FileMesh:
    """Read a MED file.

    Groups of elements become regions or sides. A group of one node is a point; one of several is
    sides that have all their nodes in it, or is left out with a note. Where groups of several kinds
    have a name, their kind stands behind it.

    Raises
    ------
    ValueError
        Says what is refused, or that h5py is not installed.
    InputError
        If the file cannot be read.
    """
    meshio = meshio_with_prisms()
    if not read_whole(path).startswith(_SIGNATURE):
        raise ValueError("it is no MED file, which begins as HDF5 does: save it again as .med")
    cure = "pip install 'skfem-joint[salome]'; or save the mesh as .msh or .inp"
    arrays = arrays_read_apart(path, "import h5py", _READ, "h5py", cure)
    _check(arrays)
    places = _places(arrays)
    cells, families = list[tuple[str, IntArray]](), list[IntArray]()
    for kind in (key.removeprefix("NOD ") for key in arrays if key.startswith("NOD ")):
        cells.append(_cells(arrays, kind, len(places)))
        families.append(_families(arrays, kind, len(cells[-1][1])))
    found = meshio.Mesh(places, cells)
    _check_repeated(found)
    return FileMesh([found], _named_parts(arrays, found, families))


def _check(arrays: dict[str, np.ndarray]) -> None:
    """Refuse files of other kinds than one plain mesh."""
    found = {name: int(arrays[name]) for name in ("version", "meshes", "steps", "TYP", "REP")}
    if found["version"] not in (3, 4):
        raise ValueError(f"MED version {found['version']}, must be 3 or 4: save it again in Salome")
    if found["meshes"] != 1 or found["steps"] != 1:
        raise ValueError(
            f"it holds {found['meshes']} meshes, the first with {found['steps']} steps, must be "
            "one of each: export one mesh to a file of its own"
        )
    if found["TYP"] or found["REP"]:
        raise ValueError(
            "it holds a grid of rows and columns, or coordinates that are not Cartesian: save it "
            "as a mesh of elements, in x, y and z"
        )


def _places(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Positions of the nodes, all x before all y; shape (n, dimension of the space)."""
    space, places = int(arrays["ESP"]), _whole(arrays, "COO ", int(arrays["ESP"]))
    if space not in (1, 2, 3) or not np.issubdtype(places.dtype, np.floating):
        raise ValueError(f"its positions have {space} coordinates of type {places.dtype}: damaged")
    return places


def _whole(arrays: dict[str, np.ndarray], name: str, columns: int) -> np.ndarray:
    """Table (n, columns) of which the file says how many rows it has."""
    values, rows = arrays[name], int(arrays[f"NBR {name}"])
    if columns < 1 or values.ndim != 1 or values.size != rows * columns:
        raise ValueError(
            f"its table {name.strip()!r} has {values.size} numbers, must have {rows} times "
            f"{columns}: the file is damaged"
        )
    return values.reshape((rows, columns), order="F")


def _cells(arrays: dict[str, np.ndarray], kind: str, n_nodes: int) -> tuple[str, IntArray]:
    """Cells of a type of MED, by meshio's name and the order that it has for the nodes."""
    if kind not in _TYPES:
        what = "pyramids" if kind in ("PY5", "P13") else "elements"
        raise ValueError(
            f"it holds {what} of MED's type {kind}; allowed are {', '.join(_TYPES)}: "
            "mesh it with these, or take the others out"
        )
    name, nodes = _TYPES[kind]
    table = _whole(arrays, f"NOD {kind}", nodes)
    if not np.issubdtype(table.dtype, np.integer) or not np.all((table > 0) & (table <= n_nodes)):
        raise ValueError(f"elements of type {kind} refer to nodes that are not in the file")
    table = table.astype(np.intp) - 1
    return name, table[:, [*range(20), *_FACES, 26]] if kind == "H27" else table


def _families(arrays: dict[str, np.ndarray], kind: str, count: int) -> IntArray:
    """Family of each element of a type, or of each node; 0, without a group, if none is given."""
    if f"FAM {kind}" not in arrays:
        return np.zeros(count, dtype=np.intp)
    families = _whole(arrays, f"FAM {kind}", 1)[:, 0]
    if len(families) != count or not np.issubdtype(families.dtype, np.integer):
        raise ValueError(f"families of type {kind or 'node'} do not fit the elements: damaged")
    return families.astype(np.intp)


def _names(arrays: dict[str, np.ndarray], kind: str) -> dict[int, list[str]]:
    """Groups of each family of nodes or elements, by its number."""
    names: dict[int, list[str]] = {0: []}
    for key in arrays:
        if not key.startswith(f"number {kind} "):
            continue
        number, rows = int(arrays[key]), arrays[key.replace("number", "names", 1)]
        if names.get(number):
            raise ValueError(f"it holds two families of number {number}: the file is damaged")
        texts = [bytes(row.tolist()).partition(b"\0")[0].strip() for row in rows]
        names[number] = [decoded(text) for text in texts]
    return names


def _members(names: dict[int, list[str]], families: IntArray) -> dict[str, IntArray]:
    """Places of the members of each group."""
    found = defaultdict[str, list[IntArray]](list)
    unknown = np.setdiff1d(families, [*names])
    if unknown.size:
        raise ValueError(f"family {unknown[0]} is not in the file: it is damaged, or cut")
    for number, own in names.items():
        members = np.flatnonzero(families == number)
        for name in own if members.size else ():
            found[name].append(members)
    return {name: np.unique(np.concatenate(parts)) for name, parts in found.items()}


def _check_repeated(mesh: meshio.Mesh) -> None:
    """Refuse elements on the same corners, but those that only name sides or edges."""
    top = max((block.dim for block in mesh.cells), default=0)
    for block in mesh.cells if top else ():
        if block.dim < top:
            continue
        # MED's types with nodes in faces have the corners of those without.
        form = FORMS[{"quad9": "quad8", "hexahedron27": "hexahedron20"}.get(block.type, block.type)]
        if again := repeated(block.data, form.corners):
            one, other = (place + 1 for place in again)
            raise ValueError(
                f"element {one} of its {block.type} cells has the corners of element {other}, "
                "which would count twice: take one of them out"
            )


def _named_parts(
    arrays: dict[str, np.ndarray], mesh: meshio.Mesh, families: list[IntArray]
) -> list[str]:
    """Give a mesh its groups, of which ``families`` has those of each block; returns notes."""
    names = {kind: _names(arrays, kind) for kind in ("ELEME", "NOEUD")}
    groups = _groups_of_elements(names["ELEME"], mesh, families)
    of_nodes = _members(names["NOEUD"], _families(arrays, "", len(mesh.points)))
    twice = {name for name, own in groups.items() if len(own) + (name in of_nodes) > 1}
    shown = [(f"{name} ({kind})" if name in twice else name, blocks)
             for name, own in groups.items() for kind, blocks in own.items()]  # fmt: skip
    nodes = {f"{name} (nodes)" if name in twice else name: own for name, own in of_nodes.items()}
    check_count(len(shown) + len(nodes))
    counts = Counter([name for name, _ in shown] + [*nodes])
    if again := [name for name, count in counts.items() if count > 1]:
        raise ValueError(f"names of groups come about twice: {listed(again)}; give each its own")
    mesh.cell_sets = dict(shown)  # as blocks and members, which meshio's constructor does not take
    known = {name for table in names.values() for own in table.values() for name in own}
    empty = known - groups.keys() - of_nodes.keys()
    notes = [f"groups without members are left out: {listed(empty)}"] if empty else []
    return notes + _add_groups_of_nodes(mesh, nodes)


def _groups_of_elements(
    names: dict[int, list[str]], mesh: meshio.Mesh, families: list[IntArray]
) -> dict[str, dict[str, dict[int, IntArray]]]:
    """Members of each group by its name, the kind of its elements, and the block."""
    groups = defaultdict[str, dict[str, dict[int, IntArray]]](dict)
    for place, (block, own) in enumerate(zip(mesh.cells, families, strict=True)):
        kind = ("points", "edges", "faces", "volumes")[block.dim]
        for name, members in _members(names, own).items():
            groups[name].setdefault(kind, {})[place] = members
    return groups


def _add_groups_of_nodes(mesh: meshio.Mesh, groups: dict[str, IntArray]) -> list[str]:
    """Add groups of nodes to a mesh, as points or as sides; returns notes on those left out."""
    import meshio

    sides, notes = _sides(mesh), list[str]()
    for name, nodes in groups.items():
        if sides is None and nodes.size > 1:
            notes.append(f"group {name!r} of nodes beside these elements: left out")
            continue
        what, members = ("nodes", nodes) if sides is None else sides.group(nodes)
        if isinstance(members, str):
            notes.append(f"group {name!r} {members}: left out")
        elif what == "nodes" or sides is None:
            mesh.point_sets[name] = members
        else:
            mesh.cell_sets[name] = {}
            for side, corners in blocks_of(members):
                mesh.cell_sets[name][len(mesh.cells)] = np.arange(len(corners))
                mesh.cells.append(meshio.CellBlock(side, corners))
    return notes


def _sides(mesh: meshio.Mesh) -> Sides | None:
    """Sides of the elements; None where these are of kinds without a table."""
    top = max((block.dim for block in mesh.cells), default=0)
    blocks = [block for block in mesh.cells if block.dim == top]
    forms = [FORMS[block.type] for block in blocks if block.type in FORMS]
    if len(forms) < len(blocks) or len({form.family for form in forms}) != 1:
        return None
    width = max(form.nodes for form in forms)
    nodes = [
        np.pad(block.data, ((0, 0), (0, width - form.nodes)), constant_values=-1)
        for block, form in zip(blocks, forms, strict=True)
    ]
    form_of = np.repeat(np.arange(len(forms)), [len(block.data) for block in blocks])
    return Sides(forms, form_of, np.concatenate(nodes), len(mesh.points))
