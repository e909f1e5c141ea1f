"""Abaqus and CalculiX files are read for what they say, or refused with file, line and card."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from inp_files import TYPES, WAYS, Writer, deck_of, mesh_of
from mesh_files import assert_same, boundary_sizes, region_sizes, saved, sizes

import skfem_joint as sj
from skfem_joint.mesh.decks.keywords import PASSED

STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)
NODES = [f"{i + 1}, {0.05 * i:.12g}, 0., 0." for i in range(13)]
JOINT, ARM = ([f"{i}, {i}, {i + 1}" for i in range(*ends)] for ends in ((1, 5), (5, 13)))
NODE, FIXED, TIP = ["*NODE", *NODES], ["*NSET, NSET=FIXED", "1"], ["*NSET, NSET=TIP", "13"]
ALL = ["*ELEMENT, TYPE=B31", *JOINT, *ARM]
BLOCKS = ["*ELEMENT, TYPE=B31, ELSET=JOINT", *JOINT, "*ELEMENT, TYPE=B31, ELSET=ARM", *ARM]
B32 = [f"{i}, {2 * i - 1}, {2 * i}, {2 * i + 1}" for i in range(1, 7)]
#: A plate of two squares of 1 m, nodes 1 2 3 below and 4 5 6 above.
PLATE = ["*NODE", *(f"{1 + x + 3 * y}, {x}., {y}." for y in range(2) for x in range(3))]
SQUARES = ["*ELEMENT, TYPE=CPS4, ELSET=ALL", "1, 1, 2, 5, 4", "2, 2, 3, 6, 5"]
#: A cube of 1 m.
CUBE = ["*NODE", *(f"{1 + x + 2 * y + 4 * z}, {x}., {y}., {z}."
                   for z in range(2) for y in range(2) for x in range(2))]  # fmt: skip
BRICK = ["*ELEMENT, TYPE=C3D8I, ELSET=ALL", "1, 1, 2, 4, 3, 5, 6, 8, 7"]


def read(folder: Path, *parts: list[str], name: str = "bar.inp") -> sj.NamedMesh:
    text = "\n".join([line for part in parts for line in part])
    return sj.load_meshes(saved(folder, text + "\n", name))


def matrices(mesh: sj.NamedMesh) -> list[np.ndarray]:
    """Mass and stiffness; bars need a section."""
    section = {"width": 0.05, "thickness": 0.01} if mesh.dim == 1 else {"thickness": 0.01}
    options = section if mesh.dim < 3 else {}
    structure = sj.Structure(mesh, STEEL, free=True, **options)
    return [np.asarray(A.toarray()) for A in structure.matrices()]


@cache
def matrices_of(what: str, kind: str) -> list[np.ndarray]:
    return matrices(mesh_of(what, kind))


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("what", TYPES)
def test_a_mesh_is_the_same_in_whatever_way_it_is_written(tmp_path, what, way):
    """Sixty files: matrices and areas are those of the mesh that was written, to 1e-12."""
    number = [*WAYS].index(way)
    kind = TYPES[what][number % len(TYPES[what])]
    wanted = mesh_of(what, kind)
    mesh = sj.load_meshes(Writer(deck_of(wanted, kind), WAYS[way], number).written(tmp_path))
    assert (mesh.kind, mesh.order) == (wanted.kind, wanted.order)
    assert mesh.points.items() >= wanted.points.items()
    assert mesh.regions.keys() == wanted.regions.keys()
    assert not {*mesh.boundaries, *mesh.points} - {*wanted.boundaries, *wanted.points, "NALL"}
    for found, right in (
        (boundary_sizes(mesh), boundary_sizes(wanted)),
        (region_sizes(mesh), region_sizes(wanted)),
    ):
        for name, size in right.items():
            assert found[name] == pytest.approx(size, rel=1e-12)
    for found, right in zip(matrices(mesh), matrices_of(what, kind), strict=True):
        np.testing.assert_allclose(found, right, rtol=0, atol=1e-12 * np.abs(right).max())


# Situations that people report: the right value is that of the same bar written plainly.

LIMIT = 306_250.0  # N, of the joint from 0 to 0.2 m; its first node is held


@pytest.mark.parametrize(
    "parts",
    [
        (NODE, ["*ELEMENT, TYPE=B31", *ARM], BLOCKS[:5]),
        ([" * NODE"], [f"  {line}" for line in NODES], BLOCKS),
        (NODE, ["*NSET, NSET=ENDS", "FIXED, 13"], BLOCKS),
    ],
    ids=["a block without ELSET", "blanks", "a set of nodes and sets"],
)
def test_what_is_met_often_has_its_right_value(tmp_path, parts):
    bar = read(tmp_path, FIXED, TIP, *parts)
    assert bar.points == {"FIXED": 0, "TIP": 12}
    assert bar.regions["JOINT"].tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(bar.mesh.p[0], 0.05 * np.arange(13), atol=1e-15)
    joint = sj.Joint("JOINT", pressure=50e6, friction=0.7)
    structure = sj.Structure(bar, STEEL, width=0.05, thickness=0.01, fixed=["FIXED"],
                             joints=[joint])  # fmt: skip
    (patch,) = structure.patches
    assert joint.friction * patch.normal_force.sum() == pytest.approx(LIMIT, rel=1e-12)


def test_two_parts_that_number_from_one_are_two_bodies(tmp_path):
    """24 elements, 4.8 kg; names that only one instance has need no instance before them."""
    blocks = {"L": ("LFREE", "LLAP"), "U": ("ULAP", "UFREE")}
    lines = []
    for part, names in blocks.items():
        lines += [f"*PART, NAME={part}", *NODE, f"*ELEMENT, TYPE=B31, ELSET={names[0]}", *JOINT]
        lines += [f"*ELEMENT, TYPE=B31, ELSET={names[1]}", *ARM, "*END PART"]
    lines += ["*ASSEMBLY, NAME=A", "*INSTANCE, NAME=L-1, PART=L", "*END INSTANCE"]
    lines += ["*INSTANCE, NAME=U-1, PART=U", "0.4, 0., 0.01", "*END INSTANCE"]
    lines += ["*NSET, NSET=FIXED, INSTANCE=L-1", "1", "*NSET, NSET=TIP, INSTANCE=U-1", "13"]
    mesh = read(tmp_path, [*lines, "*END ASSEMBLY"])
    assert (mesh.n_elements, mesh.body.max(), mesh.points) == (24, 1, {"FIXED": 0, "TIP": 25})
    assert sorted(mesh.regions) == ["LFREE", "LLAP", "UFREE", "ULAP"]
    assert matrices(mesh)[0].sum() == pytest.approx(4.8, rel=1e-12)
    np.testing.assert_allclose(mesh.mesh.p[0, 13:], 0.4 + 0.05 * np.arange(13), atol=1e-15)
    np.testing.assert_allclose(mesh.coordinates[13], [0.4, 0.0, 0.01], atol=1e-15)


def test_one_part_placed_twice_has_the_instances_before_its_names(tmp_path):
    """The upper plate is the lower one turned by half a turn about x, as its faces then meet."""
    deck = deck_of(mesh_of("solids", "C3D10"), "C3D10")
    whole = Writer(deck, {"place": "parts"}).written(tmp_path).read_text().split("\n")
    part = whole[whole.index("*Part, name=P0") : whole.index("*End Part") + 1]
    sets = ["*ASSEMBLY, NAME=A", "*INSTANCE, NAME=under, PART=P0", "*END INSTANCE",
            "*INSTANCE, NAME=Over, PART=p0", "0., -0.03, -0.04", "0., 0., 0., 1., 0., 0., 180.",
            "*END INSTANCE", "*NSET, NSET=TWO", "under.1, Over.1",
            "*ELSET, ELSET=BOTH", "under.lower_lap, OVER.LOWER_LAP",
            "*SURFACE, NAME=under_again", "under.lower_lap, ", "*END ASSEMBLY"]  # fmt: skip
    with pytest.raises(sj.InputError, match=r"without a face .* touch other elements: name the"):
        read(tmp_path, part, sets)
    mesh = read(tmp_path, part, sets[:-3], sets[-1:])
    faces, volumes = boundary_sizes(mesh), region_sizes(mesh)
    assert faces["under.lower_face"] == pytest.approx(0.1 * 0.03, rel=1e-12)
    assert faces["Over.lower_face"] == pytest.approx(0.1 * 0.03, rel=1e-12)
    assert volumes["BOTH"] == pytest.approx(2 * 0.1 * 0.03 * 0.02, rel=1e-12)
    lower, upper = (mesh.mesh.p[:, mesh.mesh.facets[:, mesh.boundaries[f"{name}.lower_face"]]]
                    for name in ("under", "Over"))  # fmt: skip
    np.testing.assert_allclose([lower[2], upper[2]], 0.02, atol=1e-15)
    assert np.sort(lower[1].ravel()) == pytest.approx(np.sort(upper[1].ravel()), abs=1e-15)
    assert "'TWO' whose nodes do not make up whole sides" in mesh.notes[-1]


def test_faces_of_every_number_are_where_the_manual_has_them(tmp_path):
    """Outward normals of the cube's faces S1 to S6: -z, z, -y, x, y, -x."""
    lines = [f"*SURFACE, NAME=F{k}\nALL, S{k}" for k in range(1, 7)]
    mesh = read(tmp_path, CUBE, BRICK, lines)
    for name, axis, side in (("F1", 2, 0), ("F2", 2, 1), ("F3", 1, 0), ("F4", 0, 1), ("F5", 1, 1),
                             ("F6", 0, 0)):  # fmt: skip
        corners = mesh.mesh.p[:, mesh.mesh.facets[:, mesh.boundaries[name]]]
        np.testing.assert_allclose(corners[axis], side, atol=1e-15)
    assert boundary_sizes(mesh) == pytest.approx(dict.fromkeys(mesh.boundaries, 1.0))


def test_a_surface_without_a_face_has_the_free_sides(tmp_path):
    mesh = read(tmp_path, PLATE, SQUARES, ["*SURFACE, NAME=OUTLINE", "ALL"])
    assert boundary_sizes(mesh)["OUTLINE"] == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("nodes", "said"),
    [
        ("2, 5", None),
        ("1, 4", None),
        ("1, 2, 3", None),
        ("1, 3", "do not make up whole sides"),
        ("1, 2, 4, 5", "all nodes of an element, a part of a body"),
        ("1, 4, 7", "nodes of no element"),
    ],
)
def test_sets_of_nodes_are_sides_where_their_nodes_are_whole_ones(tmp_path, nodes, said):
    """Also one between two elements; a set that is left out is said to be where it is named."""
    plate = read(tmp_path, PLATE, ["7, 5., 5."], SQUARES, ["*NSET, NSET=SOME", nodes])
    if said is None:
        assert boundary_sizes(plate)["SOME"] == pytest.approx(2.0 if nodes == "1, 2, 3" else 1.0)
        return
    (note,) = (note for note in plate.notes if "left out" in note)
    assert "'SOME' w" in note
    assert said in note
    with pytest.raises(sj.InputError, match=rf"fixed: found 'SOME'.*{said}"):
        sj.Structure(plate, STEEL, thickness=0.01, fixed=["SOME"])


def test_a_name_of_two_kinds_gets_its_kinds(tmp_path):
    """As the set of an edge, which Abaqus' own preprocessor writes for nodes and for elements."""
    sets = ["*NSET, NSET=Set-1", "1, 4", "*ELSET, ELSET=Set-1", "1"]
    plate = read(tmp_path, PLATE, SQUARES, sets)
    assert sorted(plate.regions) == ["ALL", "Set-1 (elements)"]
    assert list(plate.boundaries) == ["Set-1 (nodes)"]
    body = ["*NSET, NSET=Set-1", "1, 2, 4, 5", "*ELSET, ELSET=Set-1", "1"]
    assert sorted(read(tmp_path, PLATE, SQUARES, body).regions) == ["ALL", "Set-1"]


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 1, 3, 2), (0, 2, 1, 3)])
@pytest.mark.parametrize("kind", ["B32", "T3D3", "B22H"])
def test_elements_of_three_nodes_have_the_middle_one_between_the_others(tmp_path, order, kind):
    """Abaqus writes it in the middle, other programs last."""
    rows = [", ".join(np.array(line.split(", "))[list(order)]) for line in B32]
    bar = read(tmp_path, NODE, [f"*ELEMENT, TYPE={kind}, ELSET=BAR", *rows], FIXED, TIP)
    assert_same(bar, read(tmp_path, NODE, ["*ELEMENT, TYPE=B31, ELSET=BAR", *JOINT, *ARM], FIXED,
                          TIP))  # fmt: skip


def test_the_plane_of_a_plate_is_that_of_its_elements(tmp_path):
    strain = [line.replace("CPS4", "CPE4R") for line in SQUARES]
    plate = read(tmp_path, PLATE, strain)
    sj.Structure(plate, STEEL, thickness=0.01, plane="strain", free=True)
    with pytest.raises(sj.InputError, match=r"found 'stress', but .* plane strain"):
        sj.Structure(plate, STEEL, thickness=0.01, free=True)
    assert read(tmp_path, PLATE, SQUARES).plane == "stress"


def test_how_elements_are_computed_is_said(tmp_path):
    def said(*parts):
        return " ".join(read(tmp_path, *parts).notes)

    brick = [BRICK[0].replace("C3D8I", "C3D8R"), *BRICK[1:]]
    assert "C3D8R have incompatible modes, as C3D8I has, unless" in said(CUBE, brick)
    assert said(CUBE, BRICK) == ""
    two = ["*MATERIAL, NAME=Steel", "*DENSITY", "1.", "*MATERIAL, NAME=Alu", "*DENSITY", "2."]
    assert "it has 2 materials, 'Alu', 'Steel': [material] holds for all" in said(CUBE, BRICK, two)
    assert "B31 are computed as bars" in said(NODE, ALL)
    pair = ["*CONTACT PAIR, INTERACTION=A, ADJUST=0.1", "S, M"]
    assert "ADJUST of *CONTACT PAIR, which moves nodes" in said(CUBE, BRICK, pair)
    assert "ADJUST" not in said(CUBE, BRICK, ["*CONTACT PAIR, INTERACTION=A", "S, M"])
    model = [f"*{name.strip()}" for text in PASSED.values() for name in text.split(",")]
    note = said(CUBE, BRICK, model, ["*STEP", "*ANY NEW THING", "1, 2", "*END STEP"])
    for word in ("[material] says (*MATERIAL, ", "[[joint]] says", "steps, which", "*ANY NEW"):
        assert word in note


#: Cards that change the model in ways that are not read, each of which is refused.
REFUSED = [
    ["*TIE, NAME=T", "A, B"], ["*Tie, name=T, adjust=yes", "A, B"], ["*MPC", "BEAM, 1, 2"],
    ["*EQUATION", "2", "1, 1, 1., 2, 1, -1."], ["*equation", "2", "1, 1, 1., 2, 1, -1."],
    ["*COUPLING, CONSTRAINT NAME=C, REF NODE=1, SURFACE=S"], ["*KINEMATIC", "1, 3"],
    ["*DISTRIBUTING"], ["*KINEMATIC COUPLING, REF NODE=1", "2, 1, 3"],
    ["*DISTRIBUTING COUPLING, ELSET=E"], ["*RIGID BODY, NSET=TIP, REF NODE=1"],
    ["*PRE-TENSION SECTION, SURFACE=S, NODE=7"], ["*Pre-tension  Section, surface=S, node=7"],
    ["*SYSTEM", "0., 0., 1."], ["*TRANSFORM, NSET=TIP, TYPE=C", "0., 0., 0., 0., 0., 1."],
    ["*NGEN, NSET=N", "1, 13, 1"], ["*ELGEN, ELSET=ARM", "1, 12"], ["*NFILL", "A, B, 3, 10"],
    ["*NCOPY, CHANGE NUMBER=100, OLD SET=A, SHIFT", "0., 0., 0."], ["*ELCOPY", "A"],
    ["*NMAP, NSET=A"], ["*EMBEDDED ELEMENT", "A"], ["*FASTENER, INTERACTION NAME=F"],
    ["*MASS, ELSET=M", "1."], ["*SPRING, ELSET=S", "1", "1e6"], ["*DASHPOT, ELSET=D", "1", "1e3"],
    ["*NONSTRUCTURAL MASS, UNITS=TOTAL MASS", "1."], ["*CONNECTOR SECTION, ELSET=C", "BEAM"],
    ["*MODEL CHANGE, REMOVE", "ARM"],
    ["*IMPERFECTION, FILE=buckled, STEP=1", "1, 0.1"], ["*PARAMETER", "length = 3."],
    ["*CYCLIC SYMMETRY MODEL, N=12, TIE=T"], ["*NETWORK MPC", "BEAM, 1, 2"],
    ["*NODES", "14, 1., 1., 1."], ["*ELEMENTT, TYPE=B31", "13, 12, 13"], ["*SOMETHING NEW"],
    ["*NODE, SYSTEM=C", "14, 1., 90., 0."], ["*NODE, INPUT=nodes.txt"],
    ["*ELEMENT, TYPE=B31, OFFSET=100", "13, 12, 13"], ["*ELEMENT, TYPE=SPRING1", "13, 13"],
    ["*ELEMENT, TYPE=C3D5", "13, 1, 2, 3, 4, 5"], ["*ELEMENT, TYPE=S4R", "13, 1, 2, 3, 4"],
    ["*SURFACE, NAME=S, COMBINE=UNION", "A, B"], ["*SURFACE, NAME=S, TYPE=CUTTING SURFACE", "1"],
    ["*INSTANCE, NAME=I, PART=P, LIBRARY=job", "*END INSTANCE"],
]  # fmt: skip


@pytest.mark.parametrize("card", REFUSED, ids=lambda card: card[0][1:28])
@pytest.mark.parametrize("in_file", ["bar.inp", "rest.inc"])
def test_what_is_not_read_is_refused_with_card_and_line(tmp_path, card, in_file):
    """More than forty cards, in the file itself and in one that it includes."""
    below = card
    if in_file == "rest.inc":
        saved(tmp_path, "\n".join(["** below", *card, ""]), in_file)
        below = [f"*INCLUDE, INPUT={in_file}"]
    keyword = " ".join(card[0][1:].partition(",")[0].upper().split())
    place = "included file rest.inc, line 2" if in_file == "rest.inc" else "line 33"
    with pytest.raises(sj.InputError) as caught:
        read(tmp_path, NODE, BLOCKS, FIXED, TIP, below)
    (problem,) = caught.value.problems
    assert problem.startswith(f"{tmp_path / 'bar.inp'}: {place}: *{keyword}: ")
    if keyword == "PRE-TENSION SECTION":
        assert "say it as [[bolt]], with head and nut" in problem


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        ((["nothing"],), r"line 1: found 'nothing', must be a card"),
        ((NODE,), "it holds no elements"),
        ((["*PART, NAME=A"], NODE, ALL, ["*END PART"]), "no .INSTANCE places part 'A'"),
        ((["*PART, NAME=A"], NODE, ALL, ["*PART, NAME=B"]), "line 29: .PART: .PART of line 1 has"),
        ((["*PART, NAME=A"], NODE, ALL), "line 1: .PART: has no .END PART: is the file cut"),
        ((NODE, ALL, ["*STEP", "*STATIC"]), "line 28: .STEP: has no .END STEP: the file is cut"),
        ((["*INSTANCE, NAME=A, PART=P"],), "line 1: .INSTANCE: found part 'P', must be one"),
        ((["*END PART"],), "line 1: .END PART: stands without .PART above"),
        ((NODE, ALL, ["*NSET, NSET=N, INSTANCE=I", "1"]), "line 28: .NSET: found instance 'I'"),
        ((NODE, ["*INCLUDE, INPUT=no.inp"]), "line 15: .INCLUDE: .*no.inp: .*relative to the"),
        ((NODE, ["*INCLUDE, INPUT=bar.inp"]), "line 15: .INCLUDE: bar.inp includes itself"),
        ((NODE, ALL, FIXED[:1], ALL), "line 28: .NSET: has no members"),
        ((NODE, ALL, ["*NSET, NSET"]), "line 28: .NSET: NSET is missing: write .NSET, NSET=NAME"),
        ((NODE, ALL, ["*NSET, NSET=A", "B"]), "line 29: .NSET: found 'B', must be a number or"),
        ((NODE, ALL, ["*ELSET, ELSET=A", "1, 2", "x y"]), "line 30: .ELSET: found 'x y'"),
        ((NODE, ALL, ["*ELSET, ELSET=A, GENERATE", "5, 12, 2"]), "line 29: .* the increment must"),
        ((NODE, ALL, ["*ELSET, ELSET=A, GENERATE", "A, B"]), "line 29: .* such as 5, 12, 1"),
        ((NODE, ALL, ["*NSET, NSET=A", "2,3", "1, 14"]), "line 30: .NSET: node 14 is not in the"),
        ((NODE, ALL, ["*ELSET, ELSET=A", "12, 13"]), "line 29: .ELSET: element 13 is not in"),
        ((NODE, ALL, ["*NSET, NSET=A", "1, 1.5"]), "line 29: .NSET: found 1.5, must be a whole"),
        ((NODE, ["*NODE", "3, 1., 1., 1."], ALL), "line 16: .NODE: node 3 stands twice"),
        ((NODE, ["14, 0., x, 0."], ALL), "line 15: .NODE: found 'x', must be a number"),
        ((NODE, ["14, 0., nan, 0."], ALL), "line 15: .NODE: found 'nan', must be a number"),
        ((NODE, ["14"], ALL), "line 15: .NODE: found 1 numbers, must be those of a node"),
        ((NODE, ["0, 1., 1., 1."], ALL), "line 15: .NODE: found 0, must be a whole number"),
        ((NODE, ["*ELEMENT, TYPE=B31", "1, 1, 2", "1, 2, 3"]), "line 17: .*element 1 stands twice"),
        ((NODE, ["*ELEMENT, TYPE=B31", "1, 1, 2", *B32]), "line 17: .ELEMENT: must be the number"),
        ((NODE, ["*ELEMENT, TYPE=B31", "1, 13, 14"]), "line 16: .ELEMENT: node 14 of element 1"),
        ((NODE, ["*ELEMENT, TYPE=B31", "1, 13,", "2, 1, 2"]), "line 16: .ELEMENT: must be the n"),
        ((NODE, ["*ELEMENT, TYPE=B33", *B32]), "line 15: .ELEMENT: type B33: allowed are T2D2"),
        ((NODE, ["*ELEMENT, TYPE=C3D5", *B32]), "pyramids are not read: .* hexahedra and prisms"),
        ((NODE, ["*ELEMENT", *B32]), "line 15: .ELEMENT: type missing: allowed are"),
        ((NODE, ["*ELEMENT, TYPE=B31"], FIXED), "line 15: .ELEMENT: has no elements"),
        ((NODE, ALL, ["*ELEMENT, TYPE=CPS3", "20, 1, 2, 3"]), "line 28: .*type CPS3: elements of "
                                                              "type B31 stand in line 15, and a"),
        ((PLATE, SQUARES, ["*ELEMENT, TYPE=CPS6", "20, 1, 2, 4, 7, 8, 9"]),
         "line 11: .* same order, and"),
        ((PLATE, SQUARES, ["*ELEMENT, TYPE=CPE4", "20, 1, 2, 5, 4"]), "line 11: .*choose one"),
        ((PLATE, SQUARES, ["7, 5, 2, 3, 6"]), "line 11: .*element 7 has the corners of element 2"),
        ((PLATE, SQUARES, ["*SURFACE, NAME=S", "1, S5"]), "line 12: .*face 'S5', must be one of "
                                                          "S1, S2, S3, S4"),
        ((PLATE, SQUARES, ["*SURFACE, NAME=S", "1, S1"] * 2), "line 13: .* stands in line 11"),
        ((PLATE, SQUARES, ["*SURFACE, NAME=S", f"{2**64}, S1"]), "line 12: .*found 18446744073709"),
        ((PLATE, SQUARES, ["*SURFACE, NAME=S", "1, S1", "3, S1"]), "line 13: .*element 3 is not"),
        ((NODE, ALL, ["*NSET, NSET=A, GENERATE", f"1, {'9' * 5000}"]), "line 29: .NSET: found 999"),
        ((PLATE, SQUARES, ["*SURFACE, NAME=S", "SOME, S1"]), "line 12: .*found 'SOME'"),
        ((PLATE, SQUARES, ["*ELSET, ELSET=A", "ALL", "*ELSET, ELSET=ALL", "1"]),
         "line 13: .ELSET: set 'ALL' is made larger after line 12 has used it"),
        ((PLATE, SQUARES, ["*ELSET, ELSET=A", "B", "*ELSET, ELSET=B", "A"]),
         "line 11: .ELSET: set 'A' lists itself|line 13: .ELSET: set 'B' lists itself"),
        ((PLATE, SQUARES, ["*ELSET, ELSET=A", "B", "*NSET, NSET=B", "1"]),
         "line 12: .ELSET: found 'B', must be a number or a set of the file: 'A', 'ALL'"),
        ((PLATE, SQUARES, ["*ELSET, ELSET=A, IN", "1"]), "line 11: .ELSET: option 'IN' is not"),
        ((PLATE, ["*ELEMENT, TYPE=CPS4X", "1, 1, 2, 5, 4"]), "line 8: .*allowed are CPS4, CPS4R, "),
        ((PLATE, SQUARES, ['*ELSET, ELSET="All"', "1"]), "line 11: .* in capitals alone"),
        ((PLATE, SQUARES, ['*ELSET, ELSET="A', "1"]), "line 11: .*quote is not closed"),
        ((PLATE, SQUARES, ["*NSET, NSET=A, ELSET=ALL", "1"]), "line 11: .*members beside ELSET"),
        ((NODE, ["*ELEMENT, TYPE=B31,", "1, 1, 2", *JOINT]), "line 15: .*option '1' is not read"),
        ((NODE, ALL, ["*NSET, NSET=A, NSET=B", "1"]), "line 28: .NSET: option 'NSET=B' is"),
        ((["*PART, NAME=A", "1, 2, 3"],), "line 2: .PART: has lines of data"),
        ((["*PART, NAME=A", *NODE, *ALL, "*END PART", "*INSTANCE, NAME=I, PART=A", "1., 2.",
           "*END INSTANCE"],), "line 31: .INSTANCE: has a line with a shift"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_with_its_line(tmp_path, parts, reason):
    with pytest.raises(sj.InputError, match=rf"bar\.inp: .*{reason}"):
        read(tmp_path, *parts)


def test_sets_may_stand_below_those_that_list_them_and_options_be_abbreviated(tmp_path):
    lists = ["*SURFACE, NAM=side", "FIRST, S1", "*NSET, NSET=NODES, ELS=BOTH"]
    lists += ["*ELSET, ELSET=BOTH", "FIRST, LAST", "*ELSET, ELSET=CHAIN", "BOTH"]
    below = ["*ELSET, ELSET=FIRST, GEN", "1, 1", "*Elset, elset=last, unsort, intern", "2"]
    mesh = read(tmp_path, PLATE, lists, SQUARES, below)
    sizes_of = {"ALL": 2.0, "FIRST": 1.0, "BOTH": 2.0, "CHAIN": 2.0}
    assert region_sizes(mesh) == pytest.approx(sizes_of, rel=1e-12)
    assert boundary_sizes(mesh) == pytest.approx({"side": 1.0}, rel=1e-12)
    assert "'NODES' with all nodes of an element" in " ".join(mesh.notes)


def test_bytes_that_are_no_text_are_refused_and_names_in_other_alphabets_are_read(tmp_path):
    with pytest.raises(sj.InputError, match=r"line 2: holds bytes that are no text"):
        sj.load_meshes(saved(tmp_path, b"*NODE\n1, \x00\n", "bar.inp"))
    text = "\n".join([*NODE, *ALL, "*ELSET, ELSET=Größe", "1", ""])
    for encoding in ("utf-8", "latin-1"):
        bar = sj.load_meshes(saved(tmp_path, text.encode(encoding), "bar.inp"))
        assert list(bar.regions) == ["Größe"]


def test_numbers_that_a_range_leaves_out_are_not_in_the_set(tmp_path):
    """As in the programs; a set in which nothing is left is none."""
    ranges = [
        "*ELSET, ELSET=A, GENERATE",
        "11, 100",
        "*NSET, NSET=NONE, GENERATE",
        "50, 2000000000",
    ]
    bar = read(tmp_path, NODE, ALL, ranges)
    assert bar.regions["A"].tolist() == [10, 11]
    assert "'NONE' with no members: left out" in bar.notes[-1]
    assert np.all(sizes(bar) > 0.0)


def test_a_set_that_lists_another_one_twice_has_its_members_once(tmp_path):
    """Forty in a row would list each element 2^40 times."""
    rows = [[f"*ELSET, ELSET=S{k + 1}", f"S{k}, S{k}"] for k in range(40)]
    mesh = read(tmp_path, PLATE, SQUARES, ["*ELSET, ELSET=S0", "2"], *rows)
    np.testing.assert_array_equal(mesh.regions["S40"], mesh.regions["S0"])
