"""Meshes and Gmsh files for the tests of meshes."""

import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from skfem.helpers import dot, grad

import skfem_joint as sj

MESHES = Path(__file__).parents[2] / "meshes"
#: Gmsh type, physical tag, node tags.
Cells = Sequence[tuple[int, int, Sequence[int]]]
#: Three lines on x.
BAR = [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.3, 0.0, 0.0), (0.6, 0.0, 0.0)]
BAR_NAMES = '0 3 "fixed"\n0 4 "free_end"\n1 1 "joint"\n1 2 "linear"\n'
LINES: Cells = [(15, 3, [1]), (15, 4, [4]), (1, 1, [1, 2]), (1, 2, [2, 3]), (1, 2, [3, 4])]
#: Kind and order of the elements.
KINDS: list[tuple[Any, int]] = [
    ("line", 1),
    *(("triangle", 1), ("triangle", 2), ("quadrilateral", 1), ("quadrilateral", 2)),
    *(("tetrahedron", 1), ("tetrahedron", 2), ("hexahedron", 1), ("hexahedron", 2)),
    *(("prism", 1), ("prism", 2)),
]
FLAT_AND_SOLID = KINDS[1:]
#: Kinds of which scikit-fem has meshes of their own.
PLAIN = [kind for kind in KINDS if kind[0] != "prism"]
#: Meshes of second order of scikit-fem.
SECOND = {
    "triangle": skfem.MeshTri2,
    "quadrilateral": skfem.MeshQuad2,
    "tetrahedron": skfem.MeshTet2,
    "hexahedron": skfem.MeshHex2,
}
SIZES = {1: 0.6, 2: 0.6 * 0.05, 3: 0.6 * 0.05 * 0.02}


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


def partitioned(text: str) -> str:
    """Gmsh 4.1 ASCII file whose entities have become parts of a partitioned mesh.

    As Gmsh writes it, parts name their parents and partitions, and have the groups too.
    """
    before, _, rest = text.partition("$Entities\n")
    entities, _, after = rest.partition("$EndEntities\n")
    counts, *lines = entities.splitlines()
    parents, parts = [counts], ["2 1", "900 1", counts]  # two partitions with a ghost entity
    dims = [dim for dim, count in enumerate(map(int, counts.split())) for _ in range(count)]
    for dim, line in zip(dims, lines, strict=True):
        tag, values = line.split(" ", 1)
        parents.append(f"{int(tag) + 100} {values}")
        parts.append(f"{tag} {dim} {int(tag) + 100} 2 1 2 {values}")
    sections = {"Entities": parents, "PartitionedEntities": parts}
    own = "".join("\n".join([f"${n}", *x, f"$End{n}", ""]) for n, x in sections.items())
    return before + own + after


#: Prism of 1/2 m3 with the nodes between its corners in the order of VTK, and that of Nastran.
PRISM = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)], float)
EDGES = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)]
PRISM_15 = np.vstack([PRISM, [PRISM[list(ends)].mean(axis=0) for ends in EDGES]])
NASTRAN_15 = [*range(9), *range(12, 15), *range(9, 12)]


def saved(folder: Path, text: str | bytes, name: str = "mesh.msh") -> Path:
    """File with the given content."""
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def strip(kind: Any = "quadrilateral", order: int = 1, **options: Any) -> sj.NamedMesh:
    """Body of 0.6 m (x 0.05 m (x 0.02 m)), linear for 0.5 m, its first corner at 0.1 m, -0.2 m.

    Points stand at the first corner and at the one across.
    """
    strips = [("linear", 0.5, 5), ("joint", 0.1, 3)]
    if kind == "line":
        options = {"points": {"tip": 0.6, "foot": 0.0}, "origin": (0.1, -0.2, 0.0), **options}
        return sj.build_bar(strips, **options)
    options = {"kind": kind, "order": order, **options}
    if kind in ("triangle", "quadrilateral"):
        ends = {"tip": (0.7, -0.15), "foot": (0.1, -0.2)}
        return sj.build_plate(strips, 0.05, 4, **{"origin": (0.1, -0.2), "points": ends, **options})
    ends = {"tip": (0.7, -0.15, 0.32), "foot": (0.1, -0.2, 0.3)}
    options = {"origin": (0.1, -0.2, 0.3), "points": ends, **options}
    return sj.build_box(strips, (0.05, 0.02), (4, 2), **options)


def sizes(mesh: sj.NamedMesh) -> np.ndarray:
    """Length, area or volume of each element, negative where it runs the wrong way round."""
    places, weights = skfem.quadrature.get_quadrature(mesh.mesh.elem, 4)
    sign = -1.0 if mesh.family == "hexahedron" else 1.0  # scikit-fem's own cubes are mirrored
    determinants = mesh.mesh.mapping().detDF(places)
    return sign * np.broadcast_to(determinants, (mesh.n_elements, weights.size)) @ weights


def region_sizes(mesh: sj.NamedMesh) -> dict[str, float]:
    """Size of each region."""
    return {name: sizes(mesh)[elements].sum() for name, elements in mesh.regions.items()}


def boundary_sizes(mesh: sj.NamedMesh) -> dict[str, float]:
    """Length or area of each boundary, by scikit-fem; number of its points on lines."""
    if mesh.dim == 1:
        return {name: facets.size for name, facets in mesh.boundaries.items()}
    unit = skfem.Functional(lambda w: 1.0 + 0.0 * w.x[0])
    return {
        name: unit.assemble(skfem.FacetBasis(mesh.mesh, mesh.mesh.elem(), facets=facets))
        for name, facets in mesh.boundaries.items()
    }


def read_or_refusal(read: Callable[[Path], Any], path: Path) -> Any:
    """What a file is read as, or the words in which it is refused; nothing else passes."""
    try:
        return read(path)
    except sj.InputError as error:
        text = str(error)
    assert text.startswith(str(path))
    return text


def tip_compliance(bar: sj.NamedMesh) -> float:
    """Displacement of the last node under a unit force there, first node held, m/N."""
    basis = skfem.Basis(bar.mesh, skfem.ElementLineP1())
    matrix = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    force = np.zeros(basis.N)
    force[-1] = 1.0
    return float(skfem.solve(*skfem.condense(matrix, force, D=np.array([0])))[-1])


def assert_same(mesh: sj.NamedMesh, other: sj.NamedMesh, sorted_alike: bool = False) -> None:
    """Same bodies, elements and names; element numbers may differ unless ``sorted_alike``."""
    assert (mesh.kind, mesh.order) == (other.kind, other.order)
    np.testing.assert_allclose(mesh.mesh.p, other.mesh.p, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(mesh.coordinates, other.coordinates)
    rank = [np.lexsort(np.sort(each.mesh.t, axis=0)) for each in (mesh, other)]
    if sorted_alike:
        np.testing.assert_array_equal(mesh.mesh.t, other.mesh.t)
    np.testing.assert_array_equal(
        np.sort(mesh.mesh.t, axis=0)[:, rank[0]], np.sort(other.mesh.t, axis=0)[:, rank[1]]
    )
    np.testing.assert_array_equal(mesh.body[rank[0]], other.body[rank[1]])
    assert mesh.points == other.points
    assert mesh.regions.keys() == other.regions.keys()
    assert mesh.boundaries.keys() == other.boundaries.keys()
    for name in mesh.regions:
        np.testing.assert_array_equal(
            np.isin(rank[0], mesh.regions[name]), np.isin(rank[1], other.regions[name])
        )
    for name, facets in mesh.boundaries.items():  # facets are numbered by their vertices
        np.testing.assert_array_equal(facets, other.boundaries[name])


def read_in_a_process_of_its_own(file: Path) -> str:
    """Kind, order and volumes of a mesh that a process reads as its first one."""
    program = (
        "import sys, skfem_joint as sj; m = sj.load_meshes(sys.argv[1]); "
        "print(m.kind, m.order, {k: m.n_elements for k in m.regions}, *m.notes)"
    )
    command = [sys.executable, "-c", program, str(file)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    return ran.stdout + ran.stderr
