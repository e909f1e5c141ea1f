"""Elements with corners that coincide: prisms, triangles beside quadrilaterals, and their sides."""

import re

import numpy as np
import pytest
import skfem
from benchmarks.inp import deck
from mesh_files import assert_same, boundary_sizes, region_sizes, saved, sizes
from mixed_meshes import mixed_box, mixed_plate, shaken

from skfem_joint.ground.errors import InputError
from skfem_joint.mesh import build_box, load_meshes, merged, named, write_mesh
from skfem_joint.mesh.cells import CELLS, corner_count
from skfem_joint.mesh.collapsed import dofs_of, joined
from skfem_joint.mesh.named import from_parts
from skfem_joint.mesh.splitting import split

MESHES = {"solid": mixed_box, "plate": mixed_plate}
BOTH = [(what, order) for what in MESHES for order in (1, 2)]
NONE: dict = {"regions": {}, "facets": {}, "points": {}}


def sides(mesh):
    """Sides of elements, (corners, n), and whether each belongs to one element alone."""
    real = corner_count(mesh.mesh.facets) >= mesh.dim
    return mesh.mesh.facets[:, real], mesh.mesh.f2t[1, real] < 0


@pytest.mark.parametrize(("what", "order"), BOTH)
def test_a_mesh_of_two_kinds_has_the_sizes_of_the_body(what, order):
    mesh = MESHES[what](order=order)
    kinds = {"solid": "hexahedron and prism", "plate": "quadrilateral and triangle"}[what]
    assert (mesh.kind, mesh.order, mesh.body.max()) == (kinds, order, 0)
    assert np.all(sizes(mesh) > 0.0)
    whole = 0.6 * 0.05 * 0.02 if what == "solid" else 0.6 * 0.06
    assert region_sizes(mesh) == pytest.approx({"arm": whole * 2 / 3, "lap": whole / 3}, rel=1e-13)
    areas = {"left": 1e-3, "right": 1e-3, "bottom": 0.012, "top": 0.012, "front": 0.03}
    areas |= {"back": 0.03, "face": 0.01}
    if what == "plate":
        areas = {"left": 0.06, "right": 0.06, "bottom": 0.6, "top": 0.6, "face": 0.2}
    assert boundary_sizes(mesh) == pytest.approx(areas, rel=1e-13)
    # Each element has a neighbour or the border on each of its sides: no side stands alone inside.
    facets, lone = sides(mesh)
    middle = mesh.mesh.p[:, facets].mean(axis=1)
    low, high = mesh.mesh.p.min(axis=1), mesh.mesh.p.max(axis=1)
    inside = ((low + 1e-9 < middle.T) & (high - 1e-9 > middle.T)).all(axis=1)
    assert inside.any()
    assert not lone[inside].any()


@pytest.mark.parametrize(("what", "order"), BOTH)
def test_nodes_of_second_order_are_those_of_vertices_edges_sides_and_cells(what, order):
    """Euler's formula for a body without holes counts them."""
    mesh = MESHES[what](order=order)
    element = mesh.mesh.elem() if order == 1 else CELLS[mesh.family].elements[1]()
    count = dofs_of(mesh.mesh, element).N
    n, vertices, facets = mesh.n_elements, mesh.mesh.nvertices, sides(mesh)[0].shape[1]
    if order == 1:
        assert count == vertices
    elif what == "plate":  # vertices - edges + cells = 1; a node inside of each cell
        assert vertices - facets + n == 1
        assert count == vertices + facets + n
    else:  # vertices - edges + sides - cells = 1
        edges = vertices + facets - n - 1
        assert count == vertices + edges + facets + n
    if order == 2:
        positions, nodes, *_ = split(mesh.mesh)
        assert np.unique(nodes).size == positions.shape[1] == count
        assert np.unique(positions.round(12), axis=1).shape[1] == count


def test_prisms_that_share_a_triangle_collapse_it_at_the_same_corner():
    """However the prisms of a stack are turned and numbered, the sides between them are one."""
    stack = build_box([("a", 0.2, 2)], (0.1, 0.3), (1, 4), kind="prism")
    rng = np.random.default_rng(2)
    own = stack.parts[0].corners.copy()
    for k in range(own.shape[1]):
        turn = np.roll([0, 1, 2], rng.integers(3))
        ends = [turn, turn + 3] if rng.random() < 0.5 else [turn[::-1] + 3, turn[::-1]]
        own[:, k] = own[np.concatenate(ends), k]
    cell, t = joined([(CELLS["prism"], own[:, rng.permutation(own.shape[1])])])
    mesh = from_parts(cell, stack.mesh.p, t, **NONE)
    assert mesh.body.max() == 0
    facets, lone = sides(mesh)
    assert facets.shape == sides(stack)[0].shape
    assert lone.sum() == sides(stack)[1].sum()
    # Both prisms have the corner that stands twice in the same place.
    assert np.unique(np.sort(facets, axis=0), axis=1).shape == facets.shape


def ring(twist: int, count: int = 8):
    """Closed ring of prisms whose last triangle meets the first, turned by some corners."""
    angles = 2.0 * np.pi * np.arange(count) / count
    turn = twist * 2.0 * np.pi / 3.0 / count
    corner = 2.0 * np.pi * np.arange(3) / 3.0
    phase = corner[:, np.newaxis] + turn * np.arange(count)
    r = 1.0 + 0.2 * np.cos(phase)
    p = np.array([r * np.cos(angles), r * np.sin(angles), 0.2 * np.sin(phase)])  # (3, corner, k)
    node = np.arange(3 * count).reshape(3, count)
    after = np.roll(node, -1, axis=1)
    after[:, -1] = after[(np.arange(3) + twist) % 3, -1]
    return p.reshape(3, -1), np.vstack([node, after])


def test_a_closed_ring_of_prisms_is_read_unless_it_is_twisted():
    p, t = ring(0)
    mesh = from_parts(*_hosted(t, p), **NONE)
    assert (mesh.body.max(), mesh.kind) == (0, "prism")
    p, t = ring(1)
    with pytest.raises(ValueError, match=r"ring that is twisted, .* mesh the ring with hexahedra"):
        from_parts(*_hosted(t, p), **NONE)


def _hosted(t, p):
    cell, hosted = joined([(CELLS["prism"], t)])
    return cell, p, hosted


def test_triangles_on_halves_of_quadrilaterals_are_refused():
    """A prism whose triangle lies on a hexahedron's side would leave it half free to open."""
    cube = skfem.MeshHex1()
    p = np.hstack([cube.p, [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [2.0, 2.0, 2.0]]])
    at = {tuple(x): k for k, x in enumerate(p.T.tolist())}
    lower = [at[x, y, 1.0] for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))]
    prism = np.array([[*lower, 8, 9, 10]]).T
    cell, t = joined([(CELLS["hexahedron"], cube.t), (CELLS["prism"], prism)])
    with pytest.raises(
        ValueError, match=r"triangle \(.*\) m lies on half a quadrilateral .*\(1 su"
    ):
        from_parts(cell, p, t, **NONE)


def test_prisms_of_scikit_fem_keep_their_numbers_and_names():
    plain = skfem.MeshWedge1().with_subdomains({"all": lambda x: x[0] > -1.0})
    mesh = named(plain)
    np.testing.assert_array_equal(mesh.mesh.p, plain.p)
    (part,) = mesh.parts
    assert (mesh.kind, part.kind.name) == ("prism", "prism")
    np.testing.assert_array_equal(np.sort(part.corners, axis=0), np.sort(plain.t, axis=0))
    np.testing.assert_array_equal(mesh.regions["all"], np.arange(plain.nelements))


def test_parts_that_collapsed_sides_have_left_are_in_no_boundary():
    plain = mixed_box().mesh.with_boundaries({"end": lambda x: x[0] < 1e-9})
    mesh = named(plain)
    assert corner_count(plain.facets[:, plain.boundaries["end"]]).min() == 2
    assert corner_count(mesh.mesh.facets[:, mesh.boundaries["end"]]).min() == 3
    assert boundary_sizes(mesh)["end"] == pytest.approx(1e-3, rel=1e-13)


@pytest.mark.parametrize(("what", "order"), BOTH)
def test_written_and_read_it_is_the_same_mesh(what, order, tmp_path):
    mesh = shaken(MESHES[what](order=order), inside=True)
    write_mesh(mesh, tmp_path / "mesh.msh")
    again = load_meshes(tmp_path / "mesh.msh")
    write_mesh(again, tmp_path / "again.msh")
    third = load_meshes(tmp_path / "again.msh")
    for each in (again, third):
        assert (each.kind, each.order, each.notes) == (mesh.kind, order, ())
        assert sizes(each).sum() == pytest.approx(sizes(mesh).sum(), rel=1e-13)
        assert region_sizes(each) == pytest.approx(region_sizes(mesh), rel=1e-12)
        assert boundary_sizes(each) == pytest.approx(boundary_sizes(mesh), rel=1e-12)
        assert each.points.keys() == mesh.points.keys()
        count = [[part.elements.size for part in each.parts] for each in (each, mesh)]
        assert count[0] == count[1]
    assert_same(third, again)


@pytest.mark.parametrize("surfaces", [True, False], ids=["surfaces", "sets of nodes"])
@pytest.mark.parametrize(("what", "order"), BOTH)
def test_a_deck_of_two_kinds_is_the_mesh_that_was_written(what, order, surfaces, tmp_path):
    mesh = shaken(MESHES[what](order=order), inside=True)
    path = saved(tmp_path, "\n".join([*deck(mesh, None if surfaces else ()), ""]), "mesh.inp")
    read = load_meshes(path)
    assert (read.kind, read.order) == (mesh.kind, order)
    assert [part.elements.size for part in read.parts] == [p.elements.size for p in mesh.parts]
    want = region_sizes(mesh)
    assert region_sizes(read) == pytest.approx(want | {"EALL": sum(want.values())}, rel=1e-12)
    assert boundary_sizes(read) == pytest.approx(boundary_sizes(mesh), rel=1e-12)
    places = read.mesh.p.T[np.lexsort(read.mesh.p)], mesh.mesh.p.T[np.lexsort(mesh.mesh.p)]
    np.testing.assert_allclose(*places, atol=1e-15)


def test_free_sides_of_a_set_are_triangles_and_quadrilaterals(tmp_path):
    """A surface of a set alone has all sides on the border of the body."""
    mesh = mixed_box()
    lines = [*deck(mesh), "*SURFACE, NAME=skin", "EALL,"]
    read = load_meshes(saved(tmp_path, "\n".join([*lines, ""]), "mesh.inp"))
    assert boundary_sizes(read)["skin"] == pytest.approx(2 * (1e-3 + 0.012 + 0.03), rel=1e-12)


def test_kinds_that_do_not_go_together_are_refused_by_name():
    parts = [build_box([(f"{kind}_body", 0.1, 1)], (0.1, 0.1), (1, 1), kind=kind, prefix=kind)
             for kind in ("hexahedron", "prism", "tetrahedron")]  # fmt: skip
    both = merged(parts[:2])
    assert (both.kind, both.body.max()) == ("hexahedron and prism", 1)
    with pytest.raises(
        InputError, match="holds tetrahedron elements of order 1, mesh 1 hexahedron"
    ):
        merged(parts)


@pytest.mark.parametrize("file", ["mesh.msh", "mesh.inp"])
@pytest.mark.parametrize("what", MESHES)
def test_curved_edges_of_both_kinds_are_reported_with_what_straight_ones_change(
    what, file, tmp_path
):
    """Parabolas of height h over edges of length l take away 2/3 h l of the area."""
    sag, mesh = 0.003, MESHES[what](order=2)
    upper = 0.06 if what == "plate" else 0.05

    def moved(line: str) -> str:
        mark = "," if "," in line else " "
        *number, x, y, z = line.replace(",", " ").split()
        middle = round(float(x) / 0.05) % 2 == 1 and abs(float(y) - upper) < 1e-9
        return mark.join([*number, x, repr(float(y) + sag * middle), z])

    if file == "mesh.msh":
        write_mesh(mesh, tmp_path / file)
        before, nodes, after = re.split(r"\$(?:End)?Nodes\n", (tmp_path / file).read_text())
        lines = [moved(x) if len(x.split()) == 3 else x for x in nodes.splitlines()]
        text = f"{before}$Nodes\n{chr(10).join(lines)}\n$EndNodes\n{after}"
    else:
        lines = deck(mesh)
        last = next(k for k, line in enumerate(lines) if line.startswith("*ELEMENT"))
        text = "\n".join([lines[0], *map(moved, lines[1:last]), *lines[last:], ""])
    read = load_meshes(saved(tmp_path, text, file))
    (note,) = (each for each in read.notes if "straight ones" in each)
    percent = 100.0 * (1.0 / (1.0 + 2.0 / 3.0 * sag / upper) - 1.0)
    size = {"plate": "area", "solid": "volume"}[what]
    assert f"changes the {size} of the mesh by {percent:.2g} %" in note
    assert boundary_sizes(read) == pytest.approx(boundary_sizes(mesh), rel=1e-12)
