"""Loaded meshes are those that their files mean, or are refused with file, place and reason."""

import re
import runpy

import meshio
import numpy as np
import pytest
import skfem
from mesh_files import (
    BAR,
    BAR_NAMES,
    FLAT_AND_SOLID,
    KINDS,
    LINES,
    MESHES,
    Cells,
    assert_same,
    boundary_sizes,
    msh22,
    partitioned,
    region_sizes,
    saved,
    sizes,
    strip,
    tip_compliance,
)

from skfem_joint.ground.errors import InputError
from skfem_joint.mesh import NamedMesh, load_meshes, merged, named, write_mesh

# Two squares side by side, 1 m x 1 m each: nodes 1 2 3 below, 4 5 6 above.
PLATE = [(float(x), float(y), 0.0) for y in range(2) for x in range(3)]
PLATE_NAMES = '0 5 "corner"\n1 3 "left"\n1 4 "inside"\n2 1 "joint"\n2 2 "linear"\n'
SQUARES: Cells = [
    *((15, 5, [3]), (1, 3, [4, 1]), (1, 4, [2, 5])),
    *((3, 1, [1, 2, 5, 4]), (3, 2, [2, 3, 6, 5])),
]
# A cube of 1 m with a second one beside it: nodes 1 2 3 / 4 5 6 below, 7 8 9 / 10 11 12 above.
BOX = [(float(x), float(y), float(z)) for z in range(2) for y in range(2) for x in range(3)]
BOX_NAMES = '0 5 "corner"\n2 3 "left"\n2 4 "inside"\n3 1 "joint"\n3 2 "linear"\n'
CUBES: Cells = [
    *((15, 5, [3]), (3, 3, [1, 4, 10, 7]), (3, 4, [2, 8, 11, 5])),
    *((5, 1, [1, 2, 5, 4, 7, 8, 11, 10]), (5, 2, [2, 3, 6, 5, 8, 9, 12, 11])),
]
# The same as tetrahedra: each cube is cut into six about its diagonal from the first corner.
_SIX = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]
TETRAHEDRA: Cells = [
    *(CUBES[0], (2, 3, [1, 4, 10]), (2, 3, [1, 10, 7]), (2, 4, [2, 8, 11]), (2, 4, [2, 11, 5])),
    *((4, 1, [CUBES[3][2][i] for i in part]) for part in _SIX),
    *((4, 2, [CUBES[4][2][i] for i in part]) for part in _SIX),
]


def loaded(folder, nodes, cells, names=BAR_NAMES, **options) -> NamedMesh:
    return load_meshes([saved(folder, msh22(nodes, cells, names))], **options)


def by_position(mesh: NamedMesh) -> NamedMesh:
    """Same mesh with its vertices numbered along x, then y, then z, as those of bars are."""
    if mesh.dim == 1:
        return mesh
    order = np.lexsort(mesh.mesh.p[::-1])
    number = np.argsort(order)
    plain = type(mesh.mesh)(mesh.mesh.p[:, order], number[mesh.mesh.t], sort_t=False)
    middles = {tuple(sorted(facet)): i for i, facet in enumerate(plain.facets.T.tolist())}
    boundaries = {
        name: np.array(
            [middles[tuple(sorted(number[f].tolist()))] for f in mesh.mesh.facets[:, chosen].T]
        )
        for name, chosen in mesh.boundaries.items()
    }
    plain = plain.with_subdomains(mesh.regions).with_boundaries(boundaries)
    points = {name: int(number[at]) for name, at in mesh.points.items()}
    return named(plain, points=points, order=mesh.order)


HOLES = 2 * 16 * 0.0055**2 * np.sin(np.pi / 16)  # two polygons of 32 sides
TWO = ("upper_joint", "lower_joint", "upper_linear", "lower_linear")
#: Kind, order, number of bodies, sizes of regions.
SHIPPED = {
    "lap_joint_250mm": ("line", 1, 1, {"joint": 0.25}),
    "lap_joint_500mm": ("line", 1, 1, {"joint": 0.5}),
    "structure": ("line", 1, 1, {"joint": 0.1, "linear": 0.5}),
    "plate_reference": ("quadrilateral", 1, 1, {"joint": 0.0125}),
    "plate_bolts": ("triangle", 2, 1, {"joint": 0.01 - HOLES, "linear": 0.015}),
    "two_plates": ("quadrilateral", 1, 2, dict(zip(TWO, (0.01, 0.01, 0.025, 0.025), strict=True))),
    "two_plates_side": (
        *("quadrilateral", 1, 2), dict(zip(TWO, (0.002, 0.002, 0.005, 0.005), strict=True)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_meshes_have_the_sizes_of_their_systems(name):
    kind, order, bodies, regions = SHIPPED[name]
    mesh = load_meshes([MESHES / f"{name}.msh"])
    assert (mesh.path, mesh.notes) == (str(MESHES / f"{name}.msh"), ())
    assert (mesh.kind, mesh.order, mesh.body.max() + 1) == (kind, order, bodies)
    assert region_sizes(mesh) == pytest.approx(regions, rel=1e-6)
    assert sizes(mesh).sum() == pytest.approx(sum(regions.values()), rel=1e-6)


def test_script_makes_the_shipped_meshes(tmp_path):
    runpy.run_path(str(MESHES / "make_meshes.py"))["main"](tmp_path)
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == sorted(path.name for path in MESHES.glob("*.msh"))
    for name in made:
        assert_same(load_meshes([tmp_path / name]), load_meshes([MESHES / name]), sorted_alike=True)


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_mesh_written_and_read_is_the_same_mesh(tmp_path, kind, order):
    """Groups overlap, lie inside bodies and cover each other; bodies lie side by side."""
    mesh = strip(kind, order)
    write_mesh(mesh, tmp_path / "plain.msh")
    assert_same(load_meshes([tmp_path / "plain.msh"]), mesh, sorted_alike=True)
    assert load_meshes([tmp_path / "plain.msh"]).notes == ()
    plain = mesh.mesh.with_subdomains({"half": np.arange(2, 5)})
    points = mesh.points | {"also foot": mesh.points["foot"]}
    if mesh.dim > 1:
        plain = plain.with_boundaries({"seam": np.flatnonzero(plain.f2t[1] >= 0)[[0, 7]]})
        plain = plain.with_boundaries({"left end": plain.boundaries["left"]})
    full = named(plain, points=points, order=order)
    if mesh.dim > 1:  # a file of lines is one bar
        other = strip(kind, order, origin=(0.3, -0.2, 0.3)[: mesh.dim], prefix="b ", points={})
        other = replace_regions(other, {"other": np.arange(3, 7)})  # the rest in no group
        full = merged([full, other])
    else:
        full = NamedMesh(**{**vars(full), "coordinates": mesh.coordinates})
    write_mesh(full, tmp_path / "full.msh")
    assert_same(load_meshes([tmp_path / "full.msh"]), full)


def replace_regions(mesh: NamedMesh, regions: dict[str, np.ndarray]) -> NamedMesh:
    plain = type(mesh.mesh)(mesh.mesh.p, mesh.mesh.t, mesh.mesh.boundaries, regions, sort_t=False)
    return named(plain, points=mesh.points, order=mesh.order)


@pytest.mark.parametrize("file_format", ["gmsh", "gmsh22"])
@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize(
    ("cell", "kind"),
    [
        *(("line", "line"), ("triangle", "triangle"), ("triangle6", "triangle")),
        *((name, "quadrilateral") for name in ("quad", "quad8", "quad9")),
        *(("tetra", "tetrahedron"), ("tetra10", "tetrahedron"), ("hexahedron", "hexahedron")),
        *(("hexahedron20", "hexahedron"), ("hexahedron27", "hexahedron")),
    ],
)
def test_both_gmsh_formats_give_the_same_mesh_for_every_cell(
    tmp_path, file_format, binary, cell, kind
):
    """As meshio writes them, with results beside, in both formats."""
    mesh = strip(kind, 2 if cell[-1].isdigit() else 1)
    write_mesh(mesh, tmp_path / "mesh.msh")
    raw = meshio.read(tmp_path / "mesh.msh")
    for block in raw.cells:  # nodes inside facets and elements are the last ones
        if (block.type, cell) in (("quad9", "quad8"), ("hexahedron27", "hexahedron20")):
            nodes = int(cell.removeprefix("quad").removeprefix("hexahedron"))
            block.type, block.data = cell, block.data[:, :nodes]
        elif cell == "hexahedron20" and block.type == "quad9":
            block.type, block.data = "quad8", block.data[:, :8]
    assert cell in raw.cells_dict
    raw.point_data["heat"] = np.arange(float(len(raw.points)))
    raw.cell_data["size"] = [np.ones(len(block.data)) for block in raw.cells]
    meshio.write(tmp_path / "again.msh", raw, file_format=file_format, binary=binary)
    content = (tmp_path / "again.msh").read_bytes()
    assert b"$ElementData" in content
    assert b"$NodeData" in content
    again = load_meshes([tmp_path / "again.msh"])
    assert_same(by_position(again), by_position(mesh))
    assert region_sizes(again) == pytest.approx(region_sizes(mesh), rel=1e-13)
    marked = load_meshes([saved(tmp_path, b"\xef\xbb\xbf" + content, "marked.msh")])
    assert_same(marked, again, sorted_alike=True)


@pytest.mark.parametrize(("kind", "order"), [kind for kind in KINDS if kind[1] == 2])
def test_second_order_nodes_are_written_where_gmsh_wants_them(kind, order, tmp_path):
    """Meshio gives each middle node its place between corners in the order of VTK."""
    cell, edges = {
        "triangle": ("triangle6", [(0, 1), (1, 2), (2, 0)]),
        "quadrilateral": ("quad9", [(0, 1), (1, 2), (2, 3), (3, 0), (0, 1, 2, 3)]),
        "tetrahedron": ("tetra10", [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]),
        "hexahedron": ("hexahedron27", [
            *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5)),
            *((2, 6), (3, 7), (0, 3, 4, 7), (1, 2, 5, 6), (0, 1, 4, 5), (2, 3, 6, 7)),
            *((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 2, 3, 4, 5, 6, 7)),
        ]),
        "prism": ("wedge18", [  # meshio leaves Gmsh's order
            *((0, 1), (0, 2), (0, 3), (1, 2), (1, 4), (2, 5), (3, 4), (3, 5), (4, 5)),
            *((0, 1, 3, 4), (0, 2, 3, 5), (1, 2, 4, 5)),
        ]),
    }[kind]  # fmt: skip
    mesh = strip(kind, order)
    write_mesh(mesh, tmp_path / "mesh.msh")
    raw = meshio.read(tmp_path / "mesh.msh")
    nodes = raw.points[raw.cells_dict[cell]]
    assert len(nodes) == mesh.n_elements
    middles = np.stack([nodes[:, between].mean(axis=1) for between in edges], axis=1)
    np.testing.assert_allclose(nodes[:, -len(edges) :], middles, atol=1e-15)


@pytest.mark.parametrize("end", [(0.36, 0.48, 0.0), (0.0, 0.0, 0.6), (-0.2, 0.4, -0.4)])
def test_inclined_bar_is_measured_by_arc_length(tmp_path, end):
    along = np.array(end) / 0.6
    bar = loaded(tmp_path, [tuple((0.7 + x * along).tolist()) for x, _, _ in BAR], LINES)
    assert bar.size == pytest.approx(0.6, rel=1e-14)
    assert tip_compliance(bar) == pytest.approx(0.6, rel=1e-12)
    # The first end is the smaller one: "fixed", unless the bar runs towards negative x.
    assert bar.points["fixed"] == (3 if end[0] < 0 else 0)
    np.testing.assert_allclose(bar.coordinates[bar.points["fixed"]], 0.7, rtol=1e-15)
    assert region_sizes(bar) == pytest.approx({"joint": 0.1, "linear": 0.5}, rel=1e-14)


def test_round_off_in_a_shared_coordinate_does_not_turn_the_bar_round(tmp_path):
    nodes = [(1e-17 * (3 - i), x, 0.0) for i, (x, _, _) in enumerate(BAR)]
    assert loaded(tmp_path, nodes, LINES).points["fixed"] == 0


def test_several_nodes_of_a_bar_in_one_group_are_a_boundary(tmp_path):
    """Also inner ones, which scikit-fem loses in files of format 2.2."""
    cells: Cells = [*LINES, (15, 3, [3]), (15, 6, [2])]
    bar = loaded(tmp_path, BAR, cells, BAR_NAMES + '0 6 "junction"\n')
    assert "junction" not in skfem.Mesh.load(tmp_path / "mesh.msh").boundaries
    np.testing.assert_array_equal(bar.boundaries["fixed"], [0, 2])
    assert bar.points == {"free_end": 3, "junction": 1}


@pytest.mark.parametrize("order", [2, 3, 4])
def test_lines_of_higher_order_are_split_at_their_inner_nodes(tmp_path, order):
    """Gmsh numbers the two ends of a line first, then its inner nodes from first to second end."""
    nodes = list(BAR)
    cells = list(LINES[:2])
    for _, tag, (a, b) in LINES[2:]:
        inner = np.linspace(nodes[a - 1][0], nodes[b - 1][0], order + 1)[1:-1]
        first = len(nodes) + 1
        nodes += [(float(x), 0.0, 0.0) for x in inner]
        cells.append(({2: 8, 3: 26, 4: 27}[order], tag, [a, b, *range(first, len(nodes) + 1)]))
    bar = loaded(tmp_path, nodes, cells)
    assert bar.n_elements == 3 * order
    assert tip_compliance(bar) == pytest.approx(0.6, rel=1e-12)
    assert bar.mesh.p[0, : order + 1] == pytest.approx(np.linspace(0.0, 0.1, order + 1))
    np.testing.assert_array_equal(bar.regions["joint"], np.arange(order))
    assert bar.points == {"fixed": 0, "free_end": 3 * order}


def test_several_bar_files_are_several_bodies(tmp_path):
    upper, lower = strip("line"), strip("line", points={"end": 0.6})
    lower = replace_regions(lower, {"lower": np.arange(8)})
    write_mesh(upper, tmp_path / "upper.msh")
    write_mesh(lower, tmp_path / "lower.msh")
    both = load_meshes([tmp_path / "upper.msh", tmp_path / "lower.msh"])
    assert_same(both, NamedMesh(**{**vars(merged([upper, lower])), "path": both.path}))
    assert both.path == f"{tmp_path / 'upper.msh'}, {tmp_path / 'lower.msh'}"
    with pytest.raises(InputError, match="a file holds one bar; write each bar"):
        write_mesh(both, tmp_path / "both.msh")


@pytest.mark.parametrize(
    ("nodes", "cells", "names"),
    [
        (BAR, LINES, BAR_NAMES),
        (PLATE, SQUARES, PLATE_NAMES),
        (BOX, CUBES, BOX_NAMES),
        (BOX, TETRAHEDRA, BOX_NAMES),
    ],
)
def test_what_files_hold_besides_and_twice_does_not_matter(tmp_path, nodes, cells, names):
    """Order and direction of elements, spare nodes, units, and cells repeated for each group."""
    expected = loaded(tmp_path, nodes, cells, names)
    assert (expected.order, expected.body.max(), expected.notes) == (1, 0, ())
    assert expected.path == str(tmp_path / "mesh.msh")
    if nodes is not BAR:
        assert region_sizes(expected) == pytest.approx({"joint": 1.0, "linear": 1.0})
        assert boundary_sizes(expected) == pytest.approx({"left": 1.0, "inside": 1.0})
        for name, x in {"left": 0.0, "inside": 1.0}.items():
            facets = expected.mesh.facets[:, expected.boundaries[name]]
            assert (expected.mesh.p[0, facets] == x).all()
        assert expected.coordinates[expected.points["corner"]].tolist() == [2.0, 0.0, 0.0]
    turned = [(kind, tag, list(at)[::-1]) for kind, tag, at in cells][::-1]
    if max(kind for kind, _, _ in cells) == 5:  # reversed, a cube would be another body
        turned = [(k, tag, [*at[4:], *at[:4]] if k == 5 else at) for k, tag, at in cells]
    mirrored = loaded(tmp_path, nodes, turned, names)
    assert np.all(sizes(mirrored) > 0.0)
    assert_same(by_position(mirrored), by_position(expected))

    plane = nodes is PLATE
    more = [(9e3, 9e3, 5e3), *((1e3 * x, 1e3 * y, 1e3 * z + 7e3 * plane) for x, y, z in nodes)]
    scaled = loaded(
        *(tmp_path, more, [(kind, tag, [n + 1 for n in at]) for kind, tag, at in cells], names),
        scale=1e-3,
    )
    np.testing.assert_allclose(scaled.mesh.p, expected.mesh.p, rtol=1e-15)
    np.testing.assert_allclose(scaled.coordinates[:, 2], expected.coordinates[:, 2] + 7.0 * plane)
    assert (scaled.points, scaled.n_elements) == (expected.points, expected.n_elements)

    top = max(3 - (cells is LINES) * 2 - plane, 1)
    whole = [(kind, 8, at) for kind, tag, at in turned if kind in {1: [1], 2: [3], 3: [4, 5]}[top]]
    twice = [*cells, *whole]
    names = names + f'{top} 8 "all"\n'
    if top > 1:  # a named side in two groups, too
        twice += [(kind, 7, at) for kind, tag, at in cells if tag == 3]
        names += f'{top - 1} 7 "again"\n'
    mesh = loaded(tmp_path, nodes, twice, names)
    assert mesh.n_elements == expected.n_elements
    np.testing.assert_array_equal(mesh.regions["all"], np.arange(mesh.n_elements))
    for name, elements in expected.regions.items():
        np.testing.assert_array_equal(mesh.regions[name], elements)
    assert sizes(mesh).sum() == pytest.approx(sizes(expected).sum(), rel=1e-14)
    if top > 1:
        np.testing.assert_array_equal(mesh.boundaries["again"], mesh.boundaries["left"])
    else:
        assert skfem.Mesh.load(tmp_path / "mesh.msh").nelements == 6  # what is repaired here
        assert tip_compliance(mesh) == pytest.approx(0.6, rel=1e-12)


def test_named_lines_in_a_solid_are_left_out_with_a_note(tmp_path):
    mesh = loaded(tmp_path, BOX, [*CUBES, (1, 9, [1, 2])], BOX_NAMES + '1 9 "edge"\n')
    assert mesh.notes == (f"{tmp_path / 'mesh.msh'}: group 'edge' of lines in a solid is left out",)
    assert "edge" not in {*mesh.regions, *mesh.boundaries, *mesh.points}


@pytest.mark.parametrize(("kind", "order"), FLAT_AND_SOLID)
def test_reversed_groups_and_ungrouped_elements_of_format_41(tmp_path, kind, order):
    """Gmsh marks a reversed entity by a negative tag, and saves all elements when asked to."""
    mesh = strip(kind, order, points={}, boundaries={"left": "left"})
    bare = replace_regions(mesh, {"joint": mesh.regions["joint"]})
    write_mesh(bare, tmp_path / "mesh.msh")
    text = (tmp_path / "mesh.msh").read_text()
    entity = next(line for line in text.splitlines() if line.endswith(" 1 1 0"))
    saved(tmp_path, text.replace(entity, entity[: -len("1 1 0")] + "1 -1 0"))
    with pytest.raises(ValueError, match="Incompatible cell data"):  # what is repaired here
        meshio.read(tmp_path / "mesh.msh")
    assert_same(load_meshes([tmp_path / "mesh.msh"]), bare)


def test_an_entity_of_format_41_that_is_not_listed_has_no_group(tmp_path):
    """A line on the edge of a plate of triangles, beside the surface that is listed."""
    plate = strip("triangle", points={}, boundaries={})
    write_mesh(plate, tmp_path / "plate.msh")
    before, _, cells = (tmp_path / "plate.msh").read_text().partition("$Elements\n")
    counts, rows = cells.split("\n", 1)
    blocks, count, first, last = map(int, counts.split())
    rows = rows.replace("$EndElements", f"1 99 1 1\n{last + 1} 1 2\n$EndElements")
    counts = f"{blocks + 1} {count + 1} {first} {last + 1}"
    mesh = load_meshes(saved(tmp_path, f"{before}$Elements\n{counts}\n{rows}"))
    assert_same(mesh, plate)


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_a_partitioned_mesh_is_the_whole_one(tmp_path, kind, order):
    write_mesh(strip(kind, order), tmp_path / "whole.msh")
    parts = partitioned((tmp_path / "whole.msh").read_text())
    whole = load_meshes(tmp_path / "whole.msh")
    assert_same(load_meshes(saved(tmp_path, parts)), whole, sorted_alike=True)


def test_a_solid_of_which_only_surfaces_are_named_asks_for_its_volume(tmp_path):
    """Gmsh then writes the surfaces alone; a tilted plate asks to be turned, plates to be split."""
    surfaces: Cells = [(3, 3, at) for at in ([1, 2, 5, 4], [7, 8, 11, 10], [1, 2, 8, 7])]
    for nodes, cells, cure in (
        (BOX, surfaces, "name the volume: in Gmsh give each volume a Physical Volume"),
        (BOX, surfaces[:2], "give bodies in different planes as different files"),
        (
            [(x, 0.8 * y, 0.6 * y) for x, y, _ in PLATE],
            [(3, 3, [1, 2, 5, 4])],
            "turn it into the x-y plane",
        ),
    ):
        path = saved(tmp_path, msh22(nodes, cells, '2 3 "left"\n'))
        with pytest.raises(InputError, match=cure):
            load_meshes(path)


@pytest.mark.parametrize("reverse", [False, True])
def test_curved_edges_are_made_straight_with_a_note(tmp_path, reverse):
    """A middle node that two elements share is counted once."""
    nodes = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    nodes += [(0.5, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 0.5), (0.52, 0.48)]
    cells = [(9, 1, [1, 2, 3, 5, 6, 9]), (9, 1, [1, 3, 4, 9, 7, 8])]
    if reverse:
        cells = [(9, 1, [3, 2, 1, 6, 5, 9]), (9, 1, [4, 3, 1, 7, 9, 8])]
    plate = loaded(tmp_path, [(*at, 0.0) for at in nodes], cells, '2 1 "joint"\n')
    assert (plate.order, plate.mesh.nvertices) == (2, 4)
    assert sizes(plate) == pytest.approx([0.5, 0.5])
    assert plate.notes == (
        f"{tmp_path / 'mesh.msh'}: 1 node of curved edges moved to the middles of straight ones, "
        "by 0.0283 m at most, which changes no size.",
    )


@pytest.mark.parametrize(("kind", "order"), [kind for kind in KINDS if kind[1] == 2])
def test_middle_nodes_in_the_order_of_another_program_are_refused(tmp_path, kind, order):
    """As converters write them: the last two of a tetrahedron's edges in Abaqus' order."""
    write_mesh(strip(kind, order), tmp_path / "mesh.msh")
    before, _, cells = (tmp_path / "mesh.msh").read_text().partition("$Elements\n")
    nodes = {"triangle": 6, "quadrilateral": 9, "tetrahedron": 10, "hexahedron": 27, "prism": 18}
    rows = [line.split(" ") for line in cells.splitlines()]
    edge = {"triangle": 5, "quadrilateral": 7, "tetrahedron": 9, "hexahedron": 18, "prism": 9}[kind]
    for row in rows:
        if len(row) == 1 + nodes[kind]:
            row[edge], row[edge + 1] = row[edge + 1], row[edge]
    text = before + "$Elements\n" + "".join(" ".join(row) + "\n" for row in rows)
    with pytest.raises(InputError, match=r"the node at \(.*\) m .* the order of another program"):
        load_meshes(saved(tmp_path, text))


def moved(nodes: list[tuple[float, ...]], node: int, *position: float) -> list[tuple[float, ...]]:
    return [*nodes[: node - 1], position, *nodes[node:]]


TETRAHEDRON = (4, 2, [1, 2, 5, 8])
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("nodes", "cells", "reason"),
    [
        (moved(BAR, 2, 0.1, 1e-8, 0.0), LINES, r"not straight: \(0\.1, 1e-08, 0\) m is 1e-08 m"),
        ([*BAR, (0.3, 0.1, 0.0)], [*LINES, (1, 2, [3, 5])], "not straight"),
        (moved(BAR, 3, 0.1, 0.1, 0.0), [*LINES, (1, 2, [1, 4])], "not straight"),
        (BAR, [*LINES[:3], LINES[4]], r"no element joins \(0\.1, 0, 0\) m to \(0\.3, "),
        (moved(BAR, 3, 0.1, 0.0, 0.0), [*LINES[:3], LINES[4]], r"joins \(0\.1, 0, 0\) m to \(0\.1"),
        ([(0.1, 0.0, 0.0)] * 4, LINES, "no length: all its nodes lie in one place"),
        (moved(BAR, 3, NAN, 0.0, 0.0), LINES, r"node 3 at \(nan, 0, 0\) m: .*finite"),
        (BAR, LINES[:2], r"neither lines \(a bar\) nor triangles"),
        (BAR, [*LINES, (1, 2, [4, 7])], "refers to node 7, which"),
        (BAR, [*LINES, (1, 2, [0, 4])], "refers to node 0, which"),
        (PLATE, [*SQUARES, (15, 5, [2])], "'corner' marks 2 nodes"),
        ([*BAR, (0.6, 0.1, 0.0)], [LINES[0], (15, 4, [5]), *LINES[2:]], r"'free_end': \(0\.6"),
        (BAR, LINES[1:], "groups without elements: fixed"),
        (BAR, [(kind, 0, at) for kind, _, at in LINES], "without elements: fixed.*Mesh.SaveAll"),
        ([(0.0, 0, 0), (0.6, 0, 0), (0.3, 0.01, 0)], [(15, 3, [1]), (15, 4, [2]), (8, 1, [1, 2, 3]),
         (1, 2, [1, 2])], r"not straight: \(0\.3, 0\.01, 0\) m is 0\.01 m off"),
        (moved(PLATE, 3, 1.2, 0.3, 0.0), SQUARES, r"not convex.*\(1, 0, 0\) m to \(1\.2, 0\.3"),
        (PLATE, [*SQUARES, (9, 2, [1, 2, 3, 4, 5, 6])], "mixes cells of type quad and triangle6"),
        (PLATE, [*SQUARES, (7, 2, [1, 2, 3, 4, 5])], "holds pyramids .*hexahedra and prisms: in"),
        (PLATE, [*SQUARES, (21, 2, [1, 2, 3, 4, 5, 6, 1, 2, 3, 4])], "third order.*ElementOrder"),
        (moved(PLATE, 3, 2.0, 0.0, 1e-6), SQUARES, "plane z = const: z runs from 0 to 1e-06 m"),
        (PLATE, [*SQUARES, (1, 3, [1, 5])], r"'left': \(0, 0, 0\) m to \(1, 1, 0\) m is no"),
        ([*PLATE, (5.0, 5.0, 0.0)], [*SQUARES, (1, 3, [1, 7])], r"'left': .* to \(5, 5, 0\)"),
        (BOX, [*CUBES, TETRAHEDRON], "hexahedra and tetrahedra cannot stand in one"),
        (BOX, [*TETRAHEDRA, CUBES[1]], "group 'left' holds cells that are no sides"),
        (BOX, [*TETRAHEDRA, (2, 3, [1, 2, 12])], r"'left': .* m to \(1, 0, 0\) m to \(2, 1"),
    ],
)  # fmt: skip
def test_meshes_that_cannot_be_are_refused_with_file_and_reason(
    tmp_path, capfd, nodes, cells, reason
):
    kinds = {kind for kind, _, _ in cells}
    names = BAR_NAMES
    if nodes[: len(PLATE)] == PLATE or kinds & {2, 3}:
        names = PLATE_NAMES
    if kinds & {4, 5}:
        names = BOX_NAMES
    path = saved(tmp_path, msh22(nodes, cells, names), "my mesh.msh")
    with pytest.raises(InputError, match=rf"my mesh\.msh: .*{reason}"):
        load_meshes([path])
    assert capfd.readouterr() == ("", "")


def test_files_that_do_not_go_together_are_refused_with_their_names(tmp_path):
    for name, mesh in (("a", strip()), ("b", strip()), ("c", strip("triangle", 2))):
        write_mesh(mesh, tmp_path / f"{name}.msh")
    with pytest.raises(InputError) as caught:
        load_meshes([tmp_path / "a.msh", tmp_path / "b.msh"])
    assert len(caught.value.problems) == 8
    for name in ("joint", "left", "tip"):
        assert re.search(
            rf"name '{name}' stands in .*a\.msh and in .*b\.msh: give", str(caught.value)
        )
    with pytest.raises(InputError, match=r"c\.msh holds triangle elements .*a\.msh quad"):
        load_meshes([tmp_path / "a.msh", tmp_path / "c.msh"])
    for join, none in ((load_meshes, "no mesh file is given"), (merged, "no meshes")):
        with pytest.raises(InputError, match=none):
            join([])
    with pytest.raises(InputError) as caught:
        load_meshes([tmp_path / "no.msh", tmp_path / "a.msh", tmp_path / "none.msh"])
    assert len(caught.value.problems) == 2
    for scale in (0.0, -1.0, NAN, INF):
        with pytest.raises(InputError, match=r"a\.msh is .*positive"):
            load_meshes([tmp_path / "a.msh"], scale=scale)
    with pytest.raises(InputError, match=r"no folder.mesh\.msh: cannot be written"):
        write_mesh(strip(), tmp_path / "no folder" / "mesh.msh")


def test_paths_that_hold_no_mesh_are_refused(tmp_path, capfd):
    path = tmp_path / "nowhere.msh"
    for given in (str(path), path, [path]):
        with pytest.raises(InputError) as caught:
            load_meshes(given)
        (problem,) = caught.value.problems
        assert problem == f"{path}: no such mesh file; a mesh file is needed, e.g. a Gmsh .msh"
    with pytest.raises(InputError, match="not a file"):
        load_meshes([tmp_path])
    for name in ("bar.vtk", "bar.msh", "bar.inp"):
        with pytest.raises(InputError, match=name):
            load_meshes([saved(tmp_path, "something else\n", name)])
    assert capfd.readouterr() == ("", "")
