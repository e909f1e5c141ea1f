"""What straight edges in place of curved ones do to lengths, areas, volumes and mass."""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from mesh_files import SECOND, msh22, saved, strip

from skfem_joint import Material, Structure
from skfem_joint.mesh import load_meshes, named
from skfem_joint.mesh.cells import cell_of

EDGES, RADIUS, DEPTH = 7, 4.5e-3, 0.01
#: Gmsh types of elements of second order by number of nodes, and of their sides.
TYPES = {("triangle", 6): 9, ("quadrilateral", 8): 16, ("quadrilateral", 9): 10}
TYPES |= {("tetrahedron", 10): 11, ("hexahedron", 20): 17, ("hexahedron", 27): 12}
SIDES = {"triangle": 1, "quadrilateral": 1, "tetrahedron": 2, "hexahedron": 3}
# Edge of the heptagon in the hole, and how far the circle is from its middle. Between a chord and a
# parabola lie two thirds of their product (Archimedes).
CHORD, SAGITTA = 2.0 * RADIUS * np.sin(np.pi / EDGES), RADIUS * (1.0 - np.cos(np.pi / EDGES))
SEGMENT = 2.0 / 3.0 * CHORD * SAGITTA
ARC = 0.5 * np.hypot(CHORD, 4.0 * SAGITTA)
ARC += CHORD**2 / (8.0 * SAGITTA) * np.arcsinh(4.0 * SAGITTA / CHORD)
#: Area of the ring between two heptagons, m2.
RING = 3.0 * 0.5 * EDGES * RADIUS**2 * np.sin(2.0 * np.pi / EDGES)


def ring(kind: str) -> skfem.Mesh:
    """Ring of second order: a hole with parabolas through the circle, straight edges outside."""
    first, second = type(strip(kind).mesh), SECOND[kind]
    axes = [np.linspace(0.0, EDGES, EDGES + 1), np.linspace(0.0, 1.0, 2), np.array([0.0, DEPTH])]
    flat = first.init_tensor(*axes[: first.elem.refdom.dim()])
    angle, radius = 2.0 * np.pi / EDGES * flat.p[0], RADIUS * (1.0 + flat.p[1])
    p = np.vstack([radius * np.cos(angle), radius * np.sin(angle), flat.p[2:]])
    _, kept, number = np.unique(p.round(9), axis=1, return_index=True, return_inverse=True)
    mesh = first(p[:, kept], number.ravel()[flat.t], sort_t=False)
    inner = np.linalg.norm(mesh.p[:2], axis=0) < 1.05 * RADIUS
    sides = {"hole": inner, "rim": ~inner}
    if mesh.dim() == 3:
        sides |= {"washer": mesh.p[2] > 0.0, "foot": mesh.p[2] == 0.0}
    facets = {name: np.flatnonzero(at[mesh.facets].all(axis=0)) for name, at in sides.items()}
    straight = replace(mesh, _boundaries=facets, _subdomains={"all": np.arange(mesh.nelements)})
    curved = second.from_mesh(straight)
    nodes = curved.doflocs.copy()
    distance = np.linalg.norm(nodes[:2], axis=0)
    on_hole = distance < 1.05 * RADIUS
    nodes[:2, on_hole] *= RADIUS / distance[on_hole]
    return replace(curved, doflocs=nodes, _boundaries=facets, _subdomains=straight.subdomains)


def changes(notes: tuple[str, ...]) -> dict[str, str]:
    """Changes of sizes in percent, by what changes, as the first of some notes says."""
    said = notes[0].rpartition("which changes ")[2].removesuffix(" %.")
    return dict(each.removeprefix("the ").split(" by ") for each in said.split(" %, "))


@pytest.mark.parametrize("kind", SECOND)
def test_sizes_lost_by_straight_edges_are_those_between_chords_and_parabolas(kind):
    mesh = named(ring(kind))
    found, whole = changes(mesh.notes), RING / (RING - EDGES * SEGMENT) - 1.0
    expected = {"length of 'hole'": CHORD / ARC - 1.0, "area of the mesh": whole}
    if mesh.dim == 3:
        expected = {"area of 'hole'": CHORD / ARC - 1.0, "volume of the mesh": whole}
        expected |= {f"area of '{name}'": whole for name in ("washer", "foot")}
    assert found == {what: f"{100.0 * change:.2g}" for what, change in expected.items()}
    warning = mesh.notes[1]
    assert all(what in warning for what in expected)
    assert "smaller elements" in warning


@pytest.mark.parametrize(("kind", "nodes"), TYPES)
def test_files_of_gmsh_lose_the_same(tmp_path, kind, nodes):
    """Also elements without nodes inside their sides and themselves."""
    mesh = ring(kind)
    cell, _ = cell_of(mesh)
    order = list(cell.gmsh or range(27))[:nodes]
    positions = np.pad(mesh.doflocs, ((0, 3 - mesh.dim()), (0, 0))).T.tolist()
    cells = [(TYPES[kind, nodes], 1, at) for at in (1 + mesh.dofs.element_dofs[order]).T.tolist()]
    names = f'{mesh.dim()} 1 "all"\n'
    for tag, (name, facets) in enumerate(mesh.boundaries.items(), 2):
        cells += [(SIDES[kind], tag, at) for at in (1 + mesh.facets[:, facets]).T.tolist()]
        names += f'{mesh.dim() - 1} {tag} "{name}"\n'
    read = load_meshes([saved(tmp_path, msh22(positions, cells, names))])
    assert changes(read.notes) == changes(named(mesh).notes)


@pytest.mark.parametrize("bend", [1e-3, 0.2])
def test_the_warning_comes_above_one_percent(bend):
    """A unit square with one bent edge loses two thirds of the bend."""
    square = skfem.MeshQuad2.from_mesh(skfem.MeshQuad1())
    nodes = square.doflocs.copy()
    middle = np.flatnonzero((nodes[0] == 0.5) & (nodes[1] == 0.0))
    nodes[1, middle] -= bend
    mesh = named(replace(square, doflocs=nodes, _subdomains={"all": np.array([0])}))
    steel = Material(E=200e9, density=8000.0, poisson=0.3)
    structure = Structure(mesh, steel, thickness=0.01, free=True)
    said = structure.system().notes
    lost = 2.0 / 3.0 * bend
    area = f"the area of the mesh by {-100.0 * lost / (1.0 + lost):.2g} %"
    assert any(area in text for text in said)
    assert any(text.startswith("Straight edges in place") for text in said) == (lost > 0.01)
