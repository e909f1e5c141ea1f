"""Loaded bars have the length and stiffness that their files mean, or are refused with a reason."""

from __future__ import annotations

import runpy
import tracemalloc
from collections.abc import Sequence
from pathlib import Path

import meshio
import msh_files
import numpy as np
import pytest
import skfem
from msh_files import Cells
from skfem.helpers import dot, grad

from skfem_joint.errors import InputError
from skfem_joint.meshing import BarMesh, build_bar, load_mesh, write_mesh

MESHES = Path(__file__).parent.parent / "meshes"
EA = 200e9 * 0.05 * 0.01

BAR = [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.3, 0.0, 0.0), (0.6, 0.0, 0.0)]
NAMES = '0 3 "fixed"\n0 4 "free_end"\n1 1 "joint"\n1 2 "linear"\n'
CELLS: Cells = [
    (15, 3, [1]),
    (15, 4, [4]),
    (1, 1, [1, 2]),
    (1, 2, [2, 3]),
    (1, 2, [3, 4]),
]


def msh22(nodes: Sequence[Sequence[float]], cells: Cells, names: str = NAMES) -> str:
    return msh_files.msh22(nodes, cells, names)


def saved(folder: Path, text: str | bytes, name: str = "bar.msh") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def tip_compliance(bar: BarMesh) -> float:
    """Displacement of the last node under a unit force there, first node held, m/N."""
    basis = skfem.Basis(bar.mesh, skfem.ElementLineP1())
    stiffness = skfem.BilinearForm(lambda u, v, _: EA * dot(grad(u), grad(v))).assemble(basis)
    force = np.zeros(basis.N)
    force[-1] = 1.0
    return float(skfem.solve(*skfem.condense(stiffness, force, D=np.array([0])))[-1])


def assert_same_bar(bar: BarMesh, other: BarMesh) -> None:
    np.testing.assert_allclose(bar.mesh.p, other.mesh.p, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(bar.mesh.t, other.mesh.t)
    np.testing.assert_array_equal(bar.coordinates, other.coordinates)
    assert bar.points == other.points
    assert bar.regions.keys() == other.regions.keys()
    for name, elements in bar.regions.items():
        np.testing.assert_array_equal(elements, other.regions[name])


@pytest.mark.parametrize(
    ("name", "regions", "points"),
    [
        ("lap_joint_250mm", {"joint": (0.0, 0.25, 100)}, {"fixed": 0.0, "free_end": 0.25}),
        ("lap_joint_500mm", {"joint": (0.0, 0.5, 100)}, {"fixed": 0.0, "free_end": 0.5}),
        (
            "structure",
            {"joint": (0.0, 0.1, 100), "linear": (0.1, 0.6, 100)},
            {"fixed": 0.0, "junction": 0.1, "free_end": 0.6},
        ),
    ],
)
def test_shipped_meshes_have_the_papers_sizes_for_every_reader(name, regions, points):
    path = MESHES / f"{name}.msh"
    bar = load_mesh(path)
    s = bar.mesh.p[0]
    assert bar.path == str(path)
    assert {key: pytest.approx(s[at], abs=1e-15) for key, at in bar.points.items()} == points
    for key, (start, stop, elements) in regions.items():
        nodes = bar.region_nodes(key)
        assert s[nodes[[0, -1]]] == pytest.approx([start, stop], abs=1e-15)
        np.testing.assert_allclose(np.diff(s[nodes]), (stop - start) / elements, rtol=1e-12)
    assert set(bar.regions) == set(regions)

    raw = meshio.read(path)
    assert {key for key in raw.cell_sets if not key.startswith("gmsh:")} == {*regions, *points}
    loaded = skfem.Mesh.load(path)
    for key, (start, stop, elements) in regions.items():
        inside = loaded.p[0, loaded.t[:, loaded.subdomains[key]]]
        assert inside.shape[1] == elements
        assert (inside.min(), inside.max()) == (start, stop)
    assert {key: loaded.p[0, loaded.boundaries[key]] for key in points} == points


def test_script_makes_the_shipped_files(tmp_path):
    runpy.run_path(str(MESHES / "make_meshes.py"))["main"](tmp_path)
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert made == {path.name: path.read_bytes() for path in MESHES.glob("*.msh")}
    assert len(made) == 7


def test_names_are_usable_through_skfem():
    mesh = load_mesh(MESHES / "structure.msh").mesh
    basis = skfem.Basis(mesh, skfem.ElementLineP1())
    np.testing.assert_array_equal(basis.get_dofs(elements="joint").all(), np.arange(101))
    assert basis.get_dofs("junction").all() == [100]
    assert mesh.p[0, basis.get_dofs("free_end").all()] == pytest.approx(0.6, abs=1e-15)


def test_bar_built_written_and_read_is_the_same_bar(tmp_path):
    bar = build_bar(
        [("joint", 0.1, 4), ("linear", 0.5, 3), ("joint", 0.2, 2), ("end part", 0.05, 1)],
        {"fixed": 0.0, "clamp": 0.0, "middle": 0.05, "free_end": 0.85},
    )
    np.testing.assert_array_equal(bar.regions["joint"], [0, 1, 2, 3, 7, 8])
    np.testing.assert_array_equal(bar.region_nodes("joint"), [0, 1, 2, 3, 4, 7, 8, 9])
    overlapping = {**bar.regions, "half": np.arange(2, 6)}
    overlapping = BarMesh(bar.mesh, bar.coordinates, overlapping, bar.points, "")
    write_mesh(overlapping, tmp_path / "bar.msh")
    assert_same_bar(load_mesh(tmp_path / "bar.msh"), overlapping)


@pytest.mark.parametrize("file_format", ["gmsh", "gmsh22"])
@pytest.mark.parametrize("binary", [True, False])
def test_both_gmsh_formats_give_the_same_bar(tmp_path, file_format, binary):
    raw = meshio.read(MESHES / "structure.msh")
    meshio.write(tmp_path / "again.msh", raw, file_format=file_format, binary=binary)
    assert_same_bar(load_mesh(tmp_path / "again.msh"), load_mesh(MESHES / "structure.msh"))


def test_other_format_with_named_sets(tmp_path):
    """Abaqus: element sets become regions, node sets of one node become points."""
    text = "*NODE\n1, 0.0, 0.0, 0.0\n2, 0.1, 0.0, 0.0\n3, 0.3, 0.0, 0.0\n"
    text += "*ELEMENT, TYPE=T3D2\n1, 1, 2\n2, 2, 3\n*NSET, NSET=FIXED\n1\n"
    text += "*ELSET, ELSET=JOINT\n1\n"
    bar = load_mesh(saved(tmp_path, text, "bar.inp"))
    np.testing.assert_array_equal(bar.mesh.p[0], [0.0, 0.1, 0.3])
    assert bar.points == {"FIXED": 0}
    assert {name: elements.tolist() for name, elements in bar.regions.items()} == {"JOINT": [0]}


@pytest.mark.parametrize("end", [(0.36, 0.48, 0.0), (0.0, 0.0, 0.6), (-0.2, 0.4, -0.4)])
def test_inclined_bar_is_measured_by_arc_length(tmp_path, end):
    along = np.array(end) / 0.6
    nodes = [tuple((0.7 + x * along).tolist()) for x, _, _ in BAR]
    bar = load_mesh(saved(tmp_path, msh22(nodes, CELLS)))
    assert bar.length == pytest.approx(0.6, rel=1e-14)
    assert tip_compliance(bar) == pytest.approx(0.6 / EA, rel=1e-12)
    # the first end is the smaller one: "fixed", unless the bar runs towards negative x
    assert bar.points["fixed"] == (3 if end[0] < 0 else 0)
    np.testing.assert_allclose(bar.coordinates[bar.points["fixed"]], 0.7, rtol=1e-15)
    joint = bar.mesh.p[0, bar.region_nodes("joint")]
    assert np.ptp(joint) == pytest.approx(0.1, rel=1e-14)


def test_round_off_in_a_shared_coordinate_does_not_turn_the_bar_round(tmp_path):
    nodes = [(1e-17 * (3 - i), x, 0.0) for i, (x, _, _) in enumerate(BAR)]
    assert load_mesh(saved(tmp_path, msh22(nodes, CELLS))).points["fixed"] == 0


def test_scale_turns_file_units_into_metres(tmp_path):
    nodes = [(1000.0 * x, 0.0, 0.0) for x, _, _ in BAR]
    bar = load_mesh(saved(tmp_path, msh22(nodes, CELLS)), scale=1e-3)
    np.testing.assert_allclose(bar.mesh.p[0], [x for x, _, _ in BAR], rtol=1e-15)
    np.testing.assert_allclose(bar.coordinates, BAR, rtol=1e-15)
    for scale in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match=r"bar\.msh.*positive"):
            load_mesh(tmp_path / "bar.msh", scale=scale)


def test_order_and_direction_of_elements_in_the_file_do_not_matter(tmp_path):
    turned = [(kind, tag, list(at)[::-1]) for kind, tag, at in CELLS][::-1]
    expected = load_mesh(saved(tmp_path, msh22(BAR, CELLS)))
    assert_same_bar(load_mesh(saved(tmp_path, msh22(BAR, turned))), expected)


def test_repeated_cells_belong_to_both_groups_and_do_not_double_the_stiffness(tmp_path):
    cells = [*CELLS, *((1, 5, at[:: (-1) ** i]) for i, (_, _, at) in enumerate(CELLS[2:]))]
    path = saved(tmp_path, msh22(BAR, cells, NAMES + '1 5 "bar"\n'))
    assert skfem.Mesh.load(path).nelements == 6  # what is repaired here
    bar = load_mesh(path)
    assert tip_compliance(bar) == pytest.approx(0.6 / EA, rel=1e-12)
    assert {name: elements.tolist() for name, elements in bar.regions.items()} == {
        "joint": [0],
        "linear": [1, 2],
        "bar": [0, 1, 2],
    }


def test_interior_point_groups_of_format_22_are_kept(tmp_path):
    path = saved(tmp_path, msh22(BAR, [*CELLS, (15, 6, [2])], NAMES + '0 6 "junction"\n'))
    assert "junction" not in skfem.Mesh.load(path).boundaries  # what is repaired here
    assert load_mesh(path).points == {"fixed": 0, "free_end": 3, "junction": 1}


@pytest.mark.parametrize("order", [2, 3, 4])
def test_lines_of_higher_order_are_split_at_their_inner_nodes(tmp_path, order):
    """Gmsh numbers the two ends of a line first, then its inner nodes from first to second end."""
    nodes = list(BAR)
    cells = list(CELLS[:2])
    for _, tag, (a, b) in CELLS[2:]:
        inner = np.linspace(nodes[a - 1][0], nodes[b - 1][0], order + 1)[1:-1]
        first = len(nodes) + 1
        nodes += [(float(x), 0.0, 0.0) for x in inner]
        cells.append(({2: 8, 3: 26, 4: 27}[order], tag, [a, b, *range(first, len(nodes) + 1)]))
    bar = load_mesh(saved(tmp_path, msh22(nodes, cells)))
    assert bar.mesh.nelements == 3 * order
    assert tip_compliance(bar) == pytest.approx(0.6 / EA, rel=1e-12)
    assert bar.mesh.p[0, bar.region_nodes("joint")] == pytest.approx(
        np.linspace(0.0, 0.1, order + 1)
    )
    assert bar.points == {"fixed": 0, "free_end": 3 * order}


def test_unused_nodes_are_dropped(tmp_path):
    nodes = [(9.0, 9.0, 9.0), *BAR[:2], (0.2, 1.0, 0.0), *BAR[2:]]
    renumbered = {1: 2, 2: 3, 3: 5, 4: 6}
    cells = [(kind, tag, [renumbered[n] for n in at]) for kind, tag, at in CELLS]
    bar = load_mesh(saved(tmp_path, msh22(nodes, cells)))
    assert_same_bar(bar, load_mesh(saved(tmp_path, msh22(BAR, CELLS))))


def moved(node: int, *position: float) -> list[tuple[float, ...]]:
    return [*BAR[: node - 1], position, *BAR[node:]]


@pytest.mark.parametrize(
    ("nodes", "cells", "reason"),
    [
        (moved(2, 0.1, 1e-8, 0.0), CELLS, r"not straight: node 2 .* 1e-08 m off"),
        (moved(2, 0.5, 0.0, 0.0), CELLS, "folds back or overlaps itself: the element from node"),
        ([*BAR, (0.3, 0.1, 0.0)], [*CELLS, (1, 2, [3, 5])], "branches.* 3 elements meet at node 3"),
        ([*BAR, (0.9, 0.0, 0.0)], [*CELLS, (1, 2, [3, 5])], "overlaps.* 3 elements meet at node 3"),
        (moved(3, 0.1, 0.1, 0.0), [*CELLS, (1, 2, [1, 4])], "closed: it has no end"),
        (BAR, [CELLS[0], CELLS[1], CELLS[2], CELLS[4]], "disconnected: .* node 2 .* and node 3"),
        (
            moved(3, 0.1, 0.0, 0.0),
            [*CELLS[:3], *CELLS[4:]],
            "one place: node 2 at .* and node 3 at",
        ),
        (moved(3, 0.1, 0.0, 0.0), CELLS, "no length: from node 2 at .* to node 3"),
        (BAR, [*CELLS, (1, 2, [3, 3])], "no length: from node 3 at .* to node 3"),
        (moved(3, float("nan"), 0.0, 0.0), CELLS, "node 3 .*finite"),
        (moved(3, 0.0, 0.0, float("inf")), CELLS, "node 3 .*finite"),
        (BAR, [*CELLS, (2, 2, [1, 2, 3])], "type 2 .*triangle.* this loader is for bars"),
        (BAR, [*CELLS, (3, 2, [1, 2, 3, 4])], "type 3 .*quadrangle.* this loader is for bars"),
        (BAR, CELLS[:2], "no line elements"),
        (BAR, [], "no line elements"),
        (BAR, [*CELLS, (1, 2, [4, 7])], "refers to node 7, which"),
        (BAR, [*CELLS, (1, 2, [0, 4])], "refers to node 0, which"),
        (BAR, [*CELLS, (15, 3, [2])], "'fixed' marks 2 nodes"),
        ([*BAR, (0.6, 0.1, 0.0)], [CELLS[0], (15, 4, [5]), *CELLS[2:]], "'free_end' is not on the"),
        (BAR, CELLS[1:], "groups without elements: fixed"),
        (BAR, [(kind, 0, at) for kind, _, at in CELLS], "without elements: fixed.*Mesh.SaveAll"),
    ],
)
def test_meshes_that_are_no_straight_bar_are_refused_with_file_and_reason(
    tmp_path, capfd, nodes, cells, reason
):
    path = saved(tmp_path, msh22(nodes, cells), "my bar.msh")
    with pytest.raises(InputError, match=rf"my bar\.msh: .*{reason}"):
        load_mesh(path)
    assert capfd.readouterr() == ("", "")


def test_quadratic_line_with_its_middle_node_off_the_line_is_refused(tmp_path):
    nodes = [(0.0, 0.0, 0.0), (0.6, 0.0, 0.0), (0.3, 0.01, 0.0)]
    path = saved(tmp_path, msh22(nodes, [(8, 1, [1, 2, 3])], '1 1 "joint"\n'))
    with pytest.raises(InputError, match=r"not straight: node 3 .* 0\.01 m off"):
        load_mesh(path)


GOOD = msh22(BAR, CELLS)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "the file is empty"),
        ("hello\n", r"no section \$MeshFormat"),
        (GOOD[: GOOD.index("$EndElements") - 3], r"\$Elements is not closed"),
        (GOOD[: GOOD.index("$Elements")], r"no section \$Elements"),
        (GOOD.replace("4 0.6 0.0 0.0\n", ""), r"\$Nodes announces more than it holds"),
        (GOOD.replace("\n2 0.1", "\n1 0.1"), "uses a node number twice"),
        (GOOD.replace('"linear"', '"joint"'), "2 groups are named 'joint'"),
        (GOOD.replace("2.2 0 8", "4 0 8"), r"Gmsh format 4; save it again.*4\.1"),
        (GOOD + "$NodeData\n2000000000\n$EndNodeData\n", r"holds results \(\$NodeData\)"),
        (GOOD + GOOD[GOOD.index("$Nodes") : GOOD.index("$Elements")], r"\$Nodes stands twice"),
    ],
)
def test_damaged_files_are_refused_with_file_and_reason(tmp_path, capfd, text, reason):
    with pytest.raises(InputError, match=rf"bar\.msh: .*{reason}"):
        load_mesh(saved(tmp_path, text))
    assert capfd.readouterr() == ("", "")


def test_paths_that_hold_no_mesh_are_refused(tmp_path, capfd):
    with pytest.raises(InputError, match=r"nowhere\.msh: no such mesh file"):
        load_mesh(tmp_path / "nowhere.msh")
    with pytest.raises(InputError, match="not a file"):
        load_mesh(tmp_path)
    for name in ("bar.xyz", "bar.vtk", "bar.inp", "bar.vtu", "bar.stl"):
        with pytest.raises(InputError, match=name):
            load_mesh(saved(tmp_path, "something else\n", name))
    assert capfd.readouterr() == ("", "")


def test_triangles_of_another_format_are_refused(tmp_path):
    text = "*NODE\n1, 0.0, 0.0, 0.0\n2, 1.0, 0.0, 0.0\n3, 0.0, 1.0, 0.0\n"
    text += "*ELEMENT, TYPE=T3D2\n1, 1, 2\n*ELEMENT, TYPE=S3\n2, 1, 2, 3\n"
    with pytest.raises(InputError, match=r"plate\.inp: .*triangle.*bars"):
        load_mesh(saved(tmp_path, text, "plate.inp"))


FIVE, HUGE = (number.to_bytes(8, "little") for number in (5, 2 * 10**9))


def files_of_all_kinds(folder: Path) -> list[bytes]:
    """One small bar in formats 2.2 and 4.1, text and binary."""
    write_mesh(build_bar([("joint", 0.1, 2), ("linear", 0.5, 2)], {"fixed": 0.0}), folder / "a.msh")
    raw = meshio.read(folder / "a.msh")
    files = [(folder / "a.msh").read_bytes(), GOOD.encode()]
    for file_format in ("gmsh", "gmsh22"):
        meshio.write(folder / "b.msh", raw, file_format=file_format, binary=True)
        files.append((folder / "b.msh").read_bytes())
    return files


def test_a_file_cut_anywhere_is_refused_or_whole(tmp_path):
    for data in files_of_all_kinds(tmp_path):
        whole = load_mesh(saved(tmp_path, data))
        end = data.index(b"$EndElements") + len(b"$EndElements")
        assert_same_bar(load_mesh(saved(tmp_path, data[:end])), whole)
        for length in range(0, end, 7):
            with pytest.raises(InputError, match=r"bar\.msh"):
                load_mesh(saved(tmp_path, data[:length]))


def test_damage_anywhere_gives_a_straight_bar_or_a_refusal(tmp_path):
    """No other exception, and elements always join neighbours along a positive length."""
    random = np.random.default_rng(1)
    refused = 0
    for data in files_of_all_kinds(tmp_path):
        for _ in range(150):
            damaged = bytearray(data)
            for at in random.integers(0, len(data), 2):
                damaged[at] = random.choice(list(b"0123456789 -.\n$ax\x00\xff"))
            try:
                bar = load_mesh(saved(tmp_path, bytes(damaged)))
            except InputError:
                refused += 1
            else:
                assert np.all(np.diff(bar.mesh.p[0]) > 0.0)
                assert tip_compliance(bar) == pytest.approx(bar.length / EA, rel=1e-9)
    assert refused > 100


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        (0, b"$Nodes\n5 5 1 5\n", b"$Nodes\n5 2000000000 1 2000000000\n"),
        (0, b"$Nodes\n5 5 1 5\n", b"$Nodes\n2000000000 5 1 5\n"),
        (0, b"\n1 1 0 1\n2\n", b"\n1 1 0 2000000000\n2\n"),
        (0, b"\n1 1 0 1\n2\n", b"\n1 1 0 1\n2000000000\n"),
        (0, b"\n1 1 1 2\n", b"\n1 1 1 2000000000\n"),
        (1, b"$Nodes\n4\n", b"$Nodes\n2000000000\n"),
        (0, b"\n1 0.0 0.0 0.0 1 3\n", b"\n1 0.0 0.0 0.0 2000000000 3\n"),
        (1, b"$Nodes\n4\n", b"$Nodes\n5\n2000000000 9 9 9\n"),
        (1, b"$Elements\n5\n", b"$Elements\n2000000000\n"),
        (2, FIVE * 2, FIVE + HUGE),
        (2, FIVE * 2, HUGE + FIVE),
        (3, b"$Nodes\n5\n", b"$Nodes\n2000000000\n"),
    ],
)
def test_numbers_that_a_file_cannot_hold_are_refused_in_bounded_memory(tmp_path, kind, old, new):
    data = files_of_all_kinds(tmp_path)[kind]
    path = saved(tmp_path, data.replace(old, new, 1))
    assert path.read_bytes() != data
    tracemalloc.start()
    with pytest.raises(InputError, match=r"bar\.msh"):
        load_mesh(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6


def test_build_bar_names_every_mistake_at_once():
    with pytest.raises(InputError) as caught:
        build_bar(
            [("joint", -1.0, 10), ("", 1.0, 0), ("far", float("inf"), 3)],
            {"joint": 0.0},
        )
    text = str(caught.value)
    assert len(caught.value.problems) == 5
    for mistake in ("'joint' is -1.0", "name ''", "0 elements", "'far' is inf", "both a region"):
        assert mistake in text
    with pytest.raises(InputError, match=r"'p' at 0\.06 m .* nearest one is at 0\.05 m"):
        build_bar([("joint", 0.1, 2)], {"p": 0.06})
    with pytest.raises(InputError, match="'p' at nan m"):
        build_bar([("joint", 0.1, 2)], {"p": float("nan")})
    with pytest.raises(InputError, match="at least one region"):
        build_bar([], {})


def test_unknown_region_lists_the_known_ones():
    with pytest.raises(InputError, match=r"no region named 'bolt'; .*joint, linear"):
        load_mesh(MESHES / "structure.msh").region_nodes("bolt")


def test_mesh_that_cannot_be_written_is_an_input_error(tmp_path):
    bar = build_bar([("joint", 0.1, 2)], {"fixed": 0.0})
    with pytest.raises(InputError, match=r"no folder.bar\.msh: cannot be written"):
        write_mesh(bar, tmp_path / "no folder" / "bar.msh")
