"""Plates read, built, refined and written are the plates that their files mean, or are refused."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import meshio
import msh_files
import numpy as np
import pytest
import skfem
from msh_files import Cells
from skfem.helpers import dot

from skfem_joint.errors import InputError
from skfem_joint.meshing import BarMesh, build_bar, write_mesh
from skfem_joint.plate_file import write_plate
from skfem_joint.plate_mesh import (
    PlateMesh,
    build_plate,
    load_meshes,
    make_plate,
    merged,
    refined,
)

MESHES = Path(__file__).parent.parent / "meshes"

# Two squares side by side, 1 m x 1 m each: nodes 1 2 3 below, 4 5 6 above.
NODES = [(float(x), float(y), 0.0) for y in range(2) for x in range(3)]
NAMES = '0 5 "corner"\n1 3 "left"\n1 4 "inside"\n2 1 "joint"\n2 2 "linear"\n'
CELLS: Cells = [
    (15, 5, [3]),
    (1, 3, [4, 1]),
    (1, 4, [2, 5]),
    (3, 1, [1, 2, 5, 4]),
    (3, 2, [2, 3, 6, 5]),
]


def msh22(nodes: Sequence[Sequence[float]], cells: Cells, names: str = NAMES) -> str:
    return msh_files.msh22(nodes, cells, names)


def saved(folder: Path, text: str, name: str = "plate.msh") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def loaded(path: Path, **options: float) -> PlateMesh:
    plate = load_meshes([path], **options)
    assert isinstance(plate, PlateMesh)
    return plate


def areas(plate: PlateMesh) -> np.ndarray:
    """Area of each element, negative where it runs clockwise, m2."""
    x, y = plate.mesh.p[:, plate.mesh.t]
    return 0.5 * (x * np.roll(y, -1, axis=0) - y * np.roll(x, -1, axis=0)).sum(axis=0)


def region_areas(plate: PlateMesh) -> dict[str, float]:
    return {name: areas(plate)[elements].sum() for name, elements in plate.regions.items()}


def lengths(plate: PlateMesh) -> dict[str, float]:
    a, b = plate.mesh.p[:, plate.mesh.facets].transpose(1, 0, 2)
    size = np.linalg.norm(b - a, axis=0)
    return {name: size[facets].sum() for name, facets in plate.boundaries.items()}


def assert_same_plate(plate: PlateMesh, other: PlateMesh, sorted_alike: bool = False) -> None:
    """Same bodies, elements and names; element numbers may differ unless ``sorted_alike``."""
    assert (plate.kind, plate.order) == (other.kind, other.order)
    np.testing.assert_array_equal(plate.mesh.p, other.mesh.p)
    rank = [np.lexsort(np.sort(each.mesh.t, axis=0)) for each in (plate, other)]
    if sorted_alike:
        np.testing.assert_array_equal(plate.mesh.t, other.mesh.t)
    np.testing.assert_array_equal(
        np.sort(plate.mesh.t, axis=0)[:, rank[0]], np.sort(other.mesh.t, axis=0)[:, rank[1]]
    )
    np.testing.assert_array_equal(plate.body[rank[0]], other.body[rank[1]])
    assert plate.points == other.points
    assert plate.regions.keys() == other.regions.keys()
    assert plate.boundaries.keys() == other.boundaries.keys()
    for name in plate.regions:
        inside = [
            np.isin(at, each.regions[name]) for at, each in zip(rank, (plate, other), strict=True)
        ]
        np.testing.assert_array_equal(*inside)
    for name, facets in plate.boundaries.items():  # facets are numbered by their vertices
        np.testing.assert_array_equal(facets, other.boundaries[name])


def by_position(plate: PlateMesh) -> PlateMesh:
    """Same plate with its vertices numbered along x, then y."""
    order = np.lexsort(plate.mesh.p[::-1])
    number = np.argsort(order)
    pairs = {name: number[plate.mesh.facets[:, f]] for name, f in plate.boundaries.items()}
    points = {name: int(number[at]) for name, at in plate.points.items()}
    t = number[plate.mesh.t]
    return make_plate(plate.mesh.p[:, order], t, plate.order, plate.regions, pairs, points)


def strip(kind="quadrilateral", order=1, **options) -> PlateMesh:
    """Plate of 0.6 m x 0.05 m with its corner at (0.1, -0.2) m."""
    options = {"points": {"tip": (0.7, -0.15), "foot": (0.1, -0.2)}, **options}
    return build_plate(
        [("linear", 0.5, 5), ("joint", 0.1, 3)],
        *(0.05, 4),
        **{"origin": (0.1, -0.2), "kind": kind, "order": order, **options},
    )


KINDS = [("triangle", 1), ("triangle", 2), ("quadrilateral", 1), ("quadrilateral", 2)]


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_built_plate_has_its_sizes_and_names(kind, order):
    plate = strip(kind, order)
    per_cell = 2 if kind == "triangle" else 1
    assert (plate.kind, plate.order, plate.mesh.nelements) == (kind, order, 32 * per_cell)
    assert np.all(areas(plate) > 0.0)
    assert region_areas(plate) == pytest.approx({"linear": 0.025, "joint": 0.005}, rel=1e-13)
    assert lengths(plate) == pytest.approx({"left": 0.05, "right": 0.05, "bottom": 0.6, "top": 0.6})
    places = {name: plate.mesh.p[:, at].tolist() for name, at in plate.points.items()}
    assert places == {"tip": pytest.approx([0.7, -0.15]), "foot": pytest.approx([0.1, -0.2])}
    assert not plate.body.any()
    assert (plate.path, plate.notes) == ("", ())


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_named_facets_lie_where_they_should_for_scikit_fem(kind, order):
    """The flux of (x, 0) through the right side and the area over the joint, by scikit-fem."""
    mesh = strip(kind, order).mesh
    element = skfem.ElementTriP1() if kind == "triangle" else skfem.ElementQuad1()

    @skfem.Functional
    def outward(w):
        return dot(w.n, w.x)

    @skfem.Functional
    def one(w):
        return 1.0 + 0.0 * w.x[0]

    through = {
        name: outward.assemble(skfem.FacetBasis(mesh, element, facets=name))
        for name in mesh.boundaries
    }
    expected = {"left": -0.1 * 0.05, "right": 0.7 * 0.05, "bottom": 0.2 * 0.6, "top": -0.15 * 0.6}
    assert through == pytest.approx(expected, rel=1e-12)
    assert one.assemble(skfem.Basis(mesh, element, elements="joint")) == pytest.approx(0.005)


def test_boundaries_may_be_chosen_and_limited_to_a_strip():
    chosen = {"end": "left", "contact": ("bottom", "joint"), "tip end": ("right", "joint")}
    plate = strip(boundaries=chosen)
    assert lengths(plate) == pytest.approx({"end": 0.05, "contact": 0.1, "tip end": 0.05})
    x, y = plate.mesh.p[:, plate.mesh.facets[:, plate.boundaries["contact"]]]
    assert (x.min(), x.max()) == pytest.approx((0.6, 0.7))
    np.testing.assert_array_equal(y, -0.2)
    assert set(strip(prefix="upper_").boundaries) == {
        *("upper_left", "upper_right", "upper_bottom", "upper_top")
    }


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_plate_written_and_read_is_the_same_plate(tmp_path, kind, order):
    plate = strip(kind, order)
    shifted = strip(kind, order, origin=(0.3, -0.2), prefix="other ", points={})
    shifted = make_plate(
        *(shifted.mesh.p, shifted.mesh.t, order),
        {"other": np.arange(3, 12)},  # the rest in no group
        {n: shifted.mesh.facets[:, f] for n, f in shifted.boundaries.items()},
    )
    both = merged([plate, shifted])
    assert np.bincount(both.body).tolist() == [plate.mesh.nelements] * 2
    overlapping = {**both.regions, "half": np.arange(2, 40)}
    inner = np.flatnonzero(both.mesh.f2t[1] >= 0)[[0, 7]]
    ends = {"seam": inner, "left end": both.boundaries["left"], **both.boundaries}
    pairs = {name: both.mesh.facets[:, facets] for name, facets in ends.items()}
    full = make_plate(both.mesh.p, both.mesh.t, order, overlapping, pairs, both.points)
    write_plate(full, tmp_path / "plate.msh")
    assert_same_plate(loaded(tmp_path / "plate.msh"), full)
    write_plate(plate, tmp_path / "plain.msh")
    assert_same_plate(loaded(tmp_path / "plain.msh"), plate, sorted_alike=True)
    assert loaded(tmp_path / "plain.msh").notes == ()


@pytest.mark.parametrize("file_format", ["gmsh", "gmsh22"])
@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("cell", ["triangle", "triangle6", "quad", "quad8", "quad9"])
def test_both_gmsh_formats_give_the_same_plate_for_every_cell(tmp_path, file_format, binary, cell):
    kind = "triangle" if cell.startswith("tri") else "quadrilateral"
    plate = strip(kind, 2 if cell[-1].isdigit() else 1)
    write_plate(plate, tmp_path / "plate.msh")
    raw = meshio.read(tmp_path / "plate.msh")
    if cell == "quad8":
        for block in raw.cells:
            if block.type == "quad9":
                block.type, block.data = "quad8", block.data[:, :8]
    assert cell in raw.cells_dict
    on_entities = raw.point_data["gmsh:dim_tags"]  # meshio writes the entities that own nodes
    blocks = list(zip(raw.cells, raw.cell_data["gmsh:geometrical"], strict=True))
    for block, entity in sorted(blocks, key=lambda item: -item[0].dim):
        on_entities[np.unique(block.data)] = block.dim, entity[0]
    meshio.write(tmp_path / "again.msh", raw, file_format=file_format, binary=binary)
    again = loaded(tmp_path / "again.msh")
    assert_same_plate(by_position(again), by_position(plate))
    assert region_areas(again) == pytest.approx({"linear": 0.025, "joint": 0.005}, rel=1e-13)


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_refined_plate_has_four_times_the_elements_and_the_same_names(kind, order):
    plate = merged([strip(kind, order), replace_names(strip(kind, order), "lower ")])
    middle = np.flatnonzero(plate.mesh.f2t[1] >= 0)[::5]
    pairs = {n: plate.mesh.facets[:, f] for n, f in {**plate.boundaries, "cut": middle}.items()}
    plate = make_plate(plate.mesh.p, plate.mesh.t, order, plate.regions, pairs, plate.points)
    fine = refined(plate)
    assert fine.order == order
    assert fine.points == plate.points
    np.testing.assert_array_equal(fine.mesh.p[:, : plate.mesh.nvertices], plate.mesh.p)
    np.testing.assert_array_equal(fine.body, np.repeat(plate.body, 4))
    np.testing.assert_allclose(areas(fine).reshape(-1, 4).sum(axis=1), areas(plate), rtol=1e-12)
    assert np.all(areas(fine) > 0.0)
    assert lengths(fine) == pytest.approx(lengths(plate), rel=1e-13)
    for name, elements in plate.regions.items():
        np.testing.assert_array_equal(np.unique(fine.regions[name] // 4), elements)
    for name, facets in plate.boundaries.items():  # both halves lie on the coarse facets
        assert fine.boundaries[name].size == 2 * facets.size
        coarse = plate.mesh.p[:, plate.mesh.facets[:, facets]].mean(axis=1).T
        halves = fine.mesh.p[:, fine.mesh.facets[:, fine.boundaries[name]]]
        for middle in coarse:
            touching = np.isclose(halves, middle[:, np.newaxis, np.newaxis], atol=1e-12, rtol=0)
            assert touching.all(axis=0).any(axis=0).sum() == 2


def replace_names(plate: PlateMesh, prefix: str) -> PlateMesh:
    return make_plate(
        *(plate.mesh.p, plate.mesh.t, plate.order),
        {prefix + name: elements for name, elements in plate.regions.items()},
        {prefix + n: plate.mesh.facets[:, f] for n, f in plate.boundaries.items()},
        {prefix + name: at for name, at in plate.points.items()},
    )


def test_file_with_quadrilaterals(tmp_path):
    plate = loaded(saved(tmp_path, msh22(NODES, CELLS)))
    assert (plate.kind, plate.order, plate.mesh.nelements) == ("quadrilateral", 1, 2)
    assert {name: at.tolist() for name, at in plate.regions.items()} == {
        "joint": [0],
        "linear": [1],
    }
    named = {n: plate.mesh.p[:, plate.mesh.facets[:, f]] for n, f in plate.boundaries.items()}
    np.testing.assert_array_equal(np.sort(named["left"][:, :, 0]), [[0.0, 0.0], [0.0, 1.0]])
    np.testing.assert_array_equal(np.sort(named["inside"][:, :, 0]), [[1.0, 1.0], [0.0, 1.0]])
    assert plate.mesh.p[:, plate.points["corner"]].tolist() == [2.0, 0.0]
    assert plate.path == str(tmp_path / "plate.msh")


def test_clockwise_elements_are_turned_and_repeated_ones_merged(tmp_path):
    whole = [(kind, 6, list(at)[::-1]) for kind, _, at in CELLS[3:]]
    text = msh22(NODES, [*CELLS, *whole, (1, 7, [1, 4])], NAMES + '2 6 "all"\n1 7 "again"\n')
    plate = loaded(saved(tmp_path, text))
    np.testing.assert_allclose(areas(plate), [1.0, 1.0])
    assert {name: at.tolist() for name, at in plate.regions.items()} == {
        "joint": [0],
        "linear": [1],
        "all": [0, 1],
    }
    np.testing.assert_array_equal(plate.boundaries["again"], plate.boundaries["left"])
    turned = [CELLS[0], CELLS[1], CELLS[2], *((k, t, list(at)[::-1]) for k, t, at in CELLS[3:])]
    assert_same_plate(
        loaded(saved(tmp_path, msh22(NODES, turned))), loaded(saved(tmp_path, msh22(NODES, CELLS)))
    )


def test_unused_nodes_are_dropped_and_units_scaled(tmp_path):
    nodes = [(9e3, 9e3, 5e3), *((1e3 * x, 1e3 * y, 7e3) for x, y, _ in NODES)]
    cells = [(kind, tag, [n + 1 for n in at]) for kind, tag, at in CELLS]
    plate = loaded(saved(tmp_path, msh22(nodes, cells)), scale=1e-3)
    assert_same_plate(plate, loaded(saved(tmp_path, msh22(NODES, CELLS), "other.msh")))
    with pytest.raises(InputError, match=r"plate\.msh is nan: it must be positive"):
        load_meshes([tmp_path / "plate.msh"], scale=float("nan"))


def test_reversed_curves_and_surfaces_without_groups_of_format_41(tmp_path):
    """Gmsh marks a reversed curve by a negative tag, and saves all surfaces when asked to."""
    plate = strip()
    bare = make_plate(
        *(plate.mesh.p, plate.mesh.t, 1),
        {"joint": plate.regions["joint"]},
        {"left": plate.mesh.facets[:, plate.boundaries["left"]]},
    )
    write_plate(bare, tmp_path / "plate.msh")
    text = (tmp_path / "plate.msh").read_text()
    entity = next(line for line in text.splitlines() if line.endswith(" 1 1 0"))
    saved(tmp_path, text.replace(entity, entity[: -len("1 1 0")] + "1 -1 0"))
    with pytest.raises(ValueError, match="Incompatible cell data"):  # what is repaired here
        meshio.read(tmp_path / "plate.msh")
    assert_same_plate(loaded(tmp_path / "plate.msh"), bare)


def test_curved_edges_are_made_straight_with_a_note(tmp_path):
    """A unit square whose right side is a parabola of height h has 2 h / 3 more area."""
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]
    middles = [(0.5, 0.0, 0.0), (1.3, 0.5, 0.0), (0.5, 1.0, 0.0), (0.0, 0.45, 0.0)]
    for cell in ([1, 2, 3, 4, 5, 6, 7, 8], [4, 3, 2, 1, 7, 6, 5, 8]):  # either direction
        text = msh22([*corners, *middles], [(16, 1, cell)], '2 1 "joint"\n')
        plate = loaded(saved(tmp_path, text))
        assert (plate.order, plate.mesh.nvertices) == (2, 4)
        assert areas(plate).tolist() == [1.0]
        change = 100.0 * (1.0 / 1.2 - 1.0)
        assert plate.notes == (
            f"{tmp_path / 'plate.msh'}: 1 curved edge was made straight; the largest moved by "
            f"0.3 m and the area changed by {change:.3g} %.",
        )


def test_an_edge_curved_inside_the_plate_is_counted_once_and_keeps_the_area(tmp_path):
    nodes = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    nodes += [(0.5, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 0.5), (0.52, 0.48)]
    cells = [(9, 1, [1, 2, 3, 5, 6, 9]), (9, 1, [1, 3, 4, 9, 7, 8])]
    text = msh22([(*at, 0.0) for at in nodes], cells, '2 1 "joint"\n')
    (note,) = loaded(saved(tmp_path, text)).notes
    assert "1 curved edge was" in note
    assert "moved by 0.0283 m" in note
    assert float(note.split()[-2]) == pytest.approx(0.0, abs=1e-12)


def test_bodies_over_each_other_stay_apart(tmp_path):
    """In one file or in two, and where all their nodes coincide."""
    upper, lower = strip(prefix="upper_"), replace_names(strip(), "lower ")
    write_plate(upper, tmp_path / "upper.msh")
    write_plate(lower, tmp_path / "lower.msh")
    write_plate(merged([upper, lower]), tmp_path / "both.msh")
    two = load_meshes([tmp_path / "upper.msh", tmp_path / "lower.msh"])
    assert_same_plate(two, loaded(tmp_path / "both.msh"), sorted_alike=True)
    assert two.path == f"{tmp_path / 'upper.msh'}, {tmp_path / 'lower.msh'}"
    assert np.bincount(two.body).tolist() == [32, 32]
    vertices = [np.unique(two.mesh.t[:, two.body == body]) for body in (0, 1)]
    assert np.intersect1d(*vertices).size == 0
    assert lengths(two)["lower top"] == pytest.approx(0.6)
    assert set(two.body[two.regions["lower joint"]]) == {1}


def test_plates_that_do_not_go_together_are_refused_with_both_files(tmp_path):
    write_plate(strip(), tmp_path / "a.msh")
    write_plate(strip(), tmp_path / "b.msh")
    write_plate(strip("triangle", 2), tmp_path / "c.msh")
    write_mesh(build_bar([("joint", 0.1, 2)], {"fixed": 0.0}), tmp_path / "bar.msh")
    with pytest.raises(InputError) as caught:
        load_meshes([tmp_path / "a.msh", tmp_path / "b.msh"])
    assert len(caught.value.problems) == 8
    for name in ("joint", "left", "tip"):
        assert any(
            f"name '{name}' stands in {tmp_path / 'a.msh'} and in {tmp_path / 'b.msh'}" in problem
            for problem in caught.value.problems
        )
    with pytest.raises(InputError, match=r"c\.msh holds triangles of second order, .*a\.msh quad"):
        load_meshes([tmp_path / "a.msh", tmp_path / "c.msh"])
    with pytest.raises(InputError, match=r"bar\.msh: lines only"):
        load_meshes([tmp_path / "a.msh", tmp_path / "bar.msh"])
    with pytest.raises(InputError, match=r"bar\.msh: lines only"):
        load_meshes([tmp_path / "bar.msh", tmp_path / "bar.msh"])
    with pytest.raises(InputError, match="no mesh file is given"):
        load_meshes([])
    with pytest.raises(InputError, match="no plates"):
        merged([])
    with pytest.raises(InputError) as caught:
        load_meshes([tmp_path / "no.msh", tmp_path / "a.msh", tmp_path / "none.msh"])
    assert len(caught.value.problems) == 2


def test_lines_alone_are_a_bar(tmp_path):
    bar = load_meshes([MESHES / "structure.msh"], scale=2.0)
    assert isinstance(bar, BarMesh)
    assert bar.length == pytest.approx(1.2)


def moved(node: int, *position: float) -> list[tuple[float, ...]]:
    return [*NODES[: node - 1], position, *NODES[node:]]


BOW_TIE = [*NODES, (0.0, -1.0, 0.0), (1.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (-1.0, -1.0, 0.0)]
TETRAHEDRON = (4, 2, [1, 2, 4, 5])


@pytest.mark.parametrize(
    ("nodes", "cells", "reason"),
    [
        (moved(3, 1.2, 0.3, 0.0), CELLS, r"is not convex.*\(1, 0\), \(1\.2, 0\.3\), \(2, 1\)"),
        (moved(3, 1.0, 0.5, 0.0), CELLS, "has no area or three corners on one line"),
        (NODES, [*CELLS[:4], (3, 2, [2, 6, 3, 5])], r"crosses itself: with corners at \(1, 0\)"),
        (NODES, [*CELLS[:4], (3, 2, [2, 3, 3, 5])], "no area or three corners"),
        (
            [*NODES, (0.5, 0.1, 0.0), (0.5, 0.9, 0.0)],
            [*CELLS, (3, 2, [2, 5, 8, 7])],
            r"same side of their edge from \(1, .\) m to \(1, .\) m: .* inverted",
        ),
        (NODES, [*CELLS[:4], (2, 2, [2, 3, 6])], "mixes cells of type quad and triangle"),
        (NODES, [*CELLS[:4], (16, 2, [2, 3, 6, 5, 1, 1, 1, 1])], "mixes cells of type quad and"),
        (NODES, [*CELLS, TETRAHEDRON], "Gmsh type 4 .*tetrahedron.* allowed are"),
        (NODES, [*CELLS, (21, 2, [1, 2, 3, 4, 5, 6, 1, 2, 3, 4])], "type 21 .*third order"),
        (moved(3, 2.0, 0.0, 1e-6), CELLS, "not in a plane z = const: z runs from 0 to 1e-06 m"),
        (moved(3, 2.0, float("nan"), 0.0), CELLS, r"node 3 at \(2, nan, 0\).*finite"),
        (moved(3, 2.0, 0.0, float("inf")), CELLS, r"node 3 at \(2, 0, inf\).*finite"),
        ([(0.0, 0.0, 0.0)] * 6, CELLS, "0 m in size"),
        (BOW_TIE, [*CELLS, (3, 2, [1, 7, 10, 9])], r"only touch in the point \(0, 0\) m, a hinge"),
        (NODES, [*CELLS, (1, 3, [1, 5])], r"'left': .* from \(0, 0\) m to \(1, 1\) m is not an ed"),
        ([*NODES, (5.0, 5.0, 0.0)], [*CELLS, (1, 3, [1, 7])], r"'left': .* m to \(5, 5\) m is not"),
        (NODES, [*CELLS, (15, 5, [2])], "'corner' marks 2 nodes"),
        ([*NODES, (5.0, 5.0, 0.0)], [(15, 5, [7]), *CELLS[1:]], r"'corner' at \(5, 5\) m is not a"),
        (NODES, CELLS[1:], "groups without elements: corner"),
        (NODES, [CELLS[0], *CELLS[2:]], "groups without elements: left"),
        (NODES, CELLS[:4], "groups without elements: linear"),
        (NODES, CELLS[:1], "neither lines .* nor triangles"),
        (NODES, [], "neither lines .* nor triangles"),
        (NODES, [*CELLS, (3, 1, [1, 2, 5, 9])], "refers to node 9, which"),
    ],
)
def test_meshes_that_are_no_plate_are_refused_with_file_and_reason(
    tmp_path, capfd, nodes, cells, reason
):
    path = saved(tmp_path, msh22(nodes, cells), "my plate.msh")
    with pytest.raises(InputError, match=rf"my plate\.msh: .*{reason}"):
        load_meshes([path])
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
def test_a_crack_by_mistake_is_refused_and_a_gap_is_not(kind):
    """Two by two cells whose right part has its middle node twice."""
    mesh = build_plate([("joint", 2.0, 2)], 2.0, 2, kind=kind).mesh
    middle = int(np.flatnonzero((mesh.p == [[2.0], [1.0]]).all(axis=0))[0])
    upper = mesh.p[1, mesh.t].mean(axis=0) > 1.0
    t = np.where((mesh.t == middle) & upper, mesh.nvertices, mesh.t)
    for gap, cracked in ((0.0, True), (1e-10, True), (1e-3, False)):
        p = np.hstack([mesh.p, [[2.0], [1.0 + gap]]])
        if cracked:
            with pytest.raises(
                InputError, match=r"2 nodes of one body .* first at \(2, 1\) m.*Merge"
            ):
                make_plate(p, t)
        else:
            assert make_plate(p, t).body.max() == 0


def test_triangles_without_area_and_folded_ones_are_refused():
    p = np.array([[0.0, 1.0, 1.0, 0.5], [0.0, 0.0, 1.0, 1e-12]])
    with pytest.raises(InputError, match=r"triangle has no area: with corners at \(0, 0\)"):
        make_plate(p, np.array([[0, 1, 2], [0, 1, 3]]).T)
    p[:, 3] = 0.7, 0.2
    with pytest.raises(InputError, match="same side of their edge"):
        make_plate(p, np.array([[0, 1, 2], [0, 1, 3]]).T)
    p[:, 3] = 0.5, -0.2
    with pytest.raises(InputError, match=r"boundary 'end'.* is not an edge"):
        make_plate(p, np.array([[0, 1, 2], [0, 1, 3]]).T, boundaries={"end": np.array([[2], [3]])})


def test_bodies_are_numbered_by_their_first_elements():
    parts = [strip(boundaries={}, points={}, origin=(float(i), 0.0)).mesh for i in range(3)]
    t = np.hstack([part.t + i * part.nvertices for i, part in enumerate(parts)])
    shuffled = np.random.default_rng(3).permutation(t.shape[1])
    plate = make_plate(np.hstack([part.p for part in parts]), t[:, shuffled])
    whose = shuffled // parts[0].nelements
    _, first = np.unique(whose, return_index=True)
    np.testing.assert_array_equal(plate.body, np.argsort(np.argsort(first))[whose])


def test_turned_plate_keeps_numbers_and_names():
    plate = strip("triangle", 2)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    pairs = {name: plate.mesh.facets[:, f] for name, f in plate.boundaries.items()}
    turned = make_plate(turn @ plate.mesh.p, plate.mesh.t, 2, plate.regions, pairs, plate.points)
    np.testing.assert_array_equal(turned.mesh.t, plate.mesh.t)
    for name, facets in plate.boundaries.items():
        np.testing.assert_array_equal(turned.boundaries[name], facets)
    assert lengths(turned) == pytest.approx(lengths(plate), rel=1e-12)
    assert region_areas(turned) == pytest.approx(region_areas(plate), rel=1e-12)


def test_build_plate_names_every_mistake_at_once():
    with pytest.raises(InputError) as caught:
        build_plate(
            [("joint", -1.0, 10), ("", 1.0, 0)],
            *(float("nan"), True),
            origin=(0.0, float("inf")),
            kind="hexagon",
            order=3,
            boundaries={"joint": "left", "b": "above", "c": ("top", "bolt")},
        )
    text = str(caught.value)
    assert len(caught.value.problems) == 11
    for mistake in (
        *("'joint' is -1.0", "name ''", "has 0 elements", "width of the plate is nan"),
        *("has True elements", "both a region and a boundary", "origin is", "'hexagon'"),
        *("order of the elements is 3", "'above'", "'bolt', which is no strip"),
    ):
        assert mistake in text
    with pytest.raises(
        InputError, match=r"'p' at \(0\.3, 0\) m .* nearest one is at \(0\.2, 0\) m"
    ):
        build_plate([("joint", 0.4, 2)], 0.1, 1, points={"p": (0.3, 0)}, origin=(0.0, 0.0))
    with pytest.raises(InputError, match="strip 'b' does not reach the side 'left'"):
        build_plate([("a", 1.0, 1), ("b", 1.0, 1)], 1.0, 1, boundaries={"end": ("left", "b")})
    with pytest.raises(InputError, match="at least one strip"):
        build_plate([], 1.0, 1)


def test_plate_that_cannot_be_written_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match=r"no folder.plate\.msh: cannot be written"):
        write_plate(strip(), tmp_path / "no folder" / "plate.msh")
    bad = make_plate(strip().mesh.p, strip().mesh.t, regions={'a"b': np.arange(3)})
    with pytest.raises(InputError, match=r"plate\.msh: name 'a\"b'"):
        write_plate(bad, tmp_path / "plate.msh")


def test_surfaces_of_another_format_are_refused(tmp_path):
    text = "*NODE\n1, 0.0, 0.0, 0.0\n2, 1.0, 0.0, 0.0\n3, 0.0, 1.0, 0.0\n"
    text += "*ELEMENT, TYPE=S3\n2, 1, 2, 3\n"
    with pytest.raises(InputError, match=r"plate\.inp: plates are read from Gmsh files"):
        load_meshes([saved(tmp_path, text, "plate.inp")])


def test_damage_anywhere_gives_a_proper_plate_or_a_refusal(tmp_path):
    """No other exception, no warning, and every element runs counter-clockwise."""
    random = np.random.default_rng(2)
    plate = build_plate([("joint", 1.0, 1), ("linear", 1.0, 1)], 1.0, 1, points={"p": (0.0, 0.0)})
    write_plate(plate, tmp_path / "a.msh")
    files = [(tmp_path / "a.msh").read_bytes(), msh22(NODES, CELLS).encode()]
    raw = meshio.read(tmp_path / "a.msh")
    for file_format in ("gmsh", "gmsh22"):
        meshio.write(tmp_path / "b.msh", raw, file_format=file_format, binary=True)
        files.append((tmp_path / "b.msh").read_bytes())
    refused = 0
    for data in files:
        for _ in range(100):
            damaged = bytearray(data)
            for at in random.integers(0, len(data), 2):
                damaged[at] = random.choice(list(b"0123456789 -.\n$ax\x00\xff"))
            (tmp_path / "c.msh").write_bytes(bytes(damaged))
            try:
                found = load_meshes([tmp_path / "c.msh"])
            except InputError:
                refused += 1
            else:
                assert isinstance(found, PlateMesh)
                assert np.all(areas(found) > 0.0)
    assert refused > 100


@pytest.mark.parametrize(
    ("name", "shape", "regions", "boundaries", "bodies"),
    [
        (
            *("plate_reference", ("quadrilateral", 1), {"joint": 0.25 * 0.05}),
            {"fixed": 0.05, "free_end": 0.05, "bottom": 0.25, "top": 0.25},
            1,
        ),
        (
            *("plate_bolts", ("triangle", 2)),
            {
                "joint": 0.2 * 0.05 - 2 * 16 * 0.0055**2 * np.sin(np.pi / 16),
                "linear": 0.3 * 0.05,
            },
            {
                **{"fixed": 0.05, "free_end": 0.05},
                **dict.fromkeys(["hole_1", "hole_2"], 64 * 0.0055 * np.sin(np.pi / 32)),
            },
            1,
        ),
        (
            *("two_plates", ("quadrilateral", 1)),
            {
                **dict.fromkeys(["upper_linear", "lower_linear"], 0.5 * 0.05),
                **dict.fromkeys(["upper_joint", "lower_joint"], 0.2 * 0.05),
            },
            {"upper_end": 0.05, "lower_end": 0.05},
            2,
        ),
        (
            *("two_plates_side", ("quadrilateral", 1)),
            {
                **dict.fromkeys(["upper_linear", "lower_linear"], 0.5 * 0.01),
                **dict.fromkeys(["upper_joint", "lower_joint"], 0.2 * 0.01),
            },
            {
                **dict.fromkeys(["upper_end", "lower_end"], 0.01),
                **dict.fromkeys(["upper_contact", "lower_contact"], 0.2),
            },
            2,
        ),
    ],
)
def test_shipped_plates_have_the_sizes_of_their_systems(name, shape, regions, boundaries, bodies):
    path = MESHES / f"{name}.msh"
    plate = loaded(path)
    assert path.stat().st_size < 300_000
    assert (plate.kind, plate.order) == shape
    assert region_areas(plate) == pytest.approx(regions, rel=1e-6)
    assert areas(plate).sum() == pytest.approx(sum(regions.values()), rel=1e-6)
    assert lengths(plate) == pytest.approx(boundaries, rel=1e-6)
    assert plate.body.max() + 1 == bodies
    assert plate.notes == ()


def test_shipped_holes_are_where_the_bolts_are():
    plate = loaded(MESHES / "plate_bolts.msh")
    for name, x in (("hole_1", 0.05), ("hole_2", 0.15)):
        rim = plate.mesh.p[:, plate.mesh.facets[:, plate.boundaries[name]]].reshape(2, -1)
        np.testing.assert_allclose(np.hypot(rim[0] - x, rim[1] - 0.025), 0.0055, atol=1e-9)
    assert plate.mesh.p[0, plate.mesh.t[:, plate.regions["joint"]]].max() == 0.2


def test_shipped_plates_overlap_with_matching_nodes_and_touch_with_others():
    plan, side = loaded(MESHES / "two_plates.msh"), loaded(MESHES / "two_plates_side.msh")
    nodes = {
        name: np.unique(plan.mesh.t[:, plan.regions[name]])
        for name in ("upper_joint", "lower_joint")
    }
    assert np.intersect1d(*nodes.values()).size == 0
    np.testing.assert_allclose(*(plan.mesh.p[:, at] for at in nodes.values()), rtol=0, atol=1e-15)
    contact = {
        name: side.mesh.p[:, np.unique(side.mesh.facets[:, side.boundaries[name]])]
        for name in ("upper_contact", "lower_contact")
    }
    for (x, y), spacing in zip(contact.values(), (0.005, 0.004), strict=True):
        np.testing.assert_allclose(y, 0.01, rtol=1e-15)
        np.testing.assert_allclose(np.diff(x), spacing, rtol=1e-12)
        assert (x.min(), x.max()) == pytest.approx((0.5, 0.7), rel=1e-15)
