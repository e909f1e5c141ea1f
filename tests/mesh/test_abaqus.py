"""Abaqus files of bars are read for what they say, or refused with keyword and line."""

from pathlib import Path

import numpy as np
import pytest
from mesh_files import assert_same, saved

from skfem_joint.ground.errors import InputError
from skfem_joint.mesh import NamedMesh, load_meshes

NODES = [f"{i + 1}, {0.05 * i:.12g}, 0., 0." for i in range(13)]
JOINT, ARM = ([f"{i}, {i}, {i + 1}" for i in range(*ends)] for ends in ((1, 5), (5, 13)))
NODE, FIXED, TIP = ["*NODE", *NODES], ["*NSET, NSET=FIXED", "1"], ["*NSET, NSET=TIP", "13"]
JOINT_SET, ARM_SET = ["*ELSET, ELSET=JOINT", "1, 2", "3, 4"], ["*ELSET, ELSET=ARM", *"5678"]
ALL = ["*ELEMENT, TYPE=B31", *JOINT, *ARM]
BLOCKS = ["*ELEMENT, TYPE=B31, ELSET=JOINT", *JOINT, "*ELEMENT, TYPE=B31, ELSET=ARM", *ARM]
B32 = [f"{i}, {2 * i - 1}, {2 * i}, {2 * i + 1}" for i in range(1, 7)]


def read(folder: Path, *parts: list[str]) -> NamedMesh:
    text = "\n".join([line for part in parts for line in part])
    return load_meshes(saved(folder, text + "\n", "bar.inp"))


@pytest.mark.parametrize(
    "parts",
    [
        (NODE, BLOCKS, FIXED, TIP),
        (["** made by hand", "*HEADING", "a bar"], NODE,
         [line.replace("B31", "T3D2") for line in BLOCKS], FIXED, TIP),
        (NODE[:4], ["** half of them"], NODE[4:], BLOCKS[:3], ["**"], BLOCKS[3:], FIXED, TIP),
        (["*Node, NSET=Nall"], NODES, [line.lower().replace("joint", "JOINT").replace("arm", "ARM")
                                      for line in BLOCKS], FIXED, TIP),
        (["*Part, name=BAR"], NODE, BLOCKS, ["*End Part", "*Assembly, name=A",
         "*Instance, name=BAR-1, part=BAR", "*End Instance", "*Nset, nset=FIXED, instance=BAR-1",
         "1,", "*Nset, nset=TIP, instance=BAR-1", "13,", "*End Assembly"]),
        ([" * NODE"], [f"  {line}" for line in NODES], BLOCKS, FIXED, TIP, ["*STEP", "*STATIC",
         "1., 1.", "*BOUNDARY", "FIXED, 1, 6", "*NODE PRINT, NSET=TIP", "U", "*END STEP"]),
    ],
    ids=["plain", "heading", "comments", "other case", "one part", "spaces and a step"],
)  # fmt: skip
def test_a_file_in_any_of_these_words_is_the_same_bar(tmp_path, parts):
    bar = read(tmp_path, *parts)
    np.testing.assert_allclose(bar.mesh.p[0], 0.05 * np.arange(13), atol=1e-15)
    assert bar.points == {"FIXED": 0, "TIP": 12}
    assert {name: at.tolist() for name, at in bar.regions.items()} == {
        "JOINT": [0, 1, 2, 3], "ARM": [4, 5, 6, 7, 8, 9, 10, 11],
    }  # fmt: skip


def test_an_unused_set_of_all_nodes_changes_nothing_but_is_there(tmp_path):
    parts = NODE, BLOCKS, FIXED, TIP
    bar = read(tmp_path, *parts, ["*NSET, NSET=NALL, GENERATE", "1, 13, 1"])
    np.testing.assert_array_equal(bar.boundaries["NALL"], np.arange(13))
    plain = read(tmp_path, *parts)
    assert (bar.points, plain.boundaries) == (plain.points, {})
    np.testing.assert_array_equal(bar.mesh.t, plain.mesh.t)


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 1, 3, 2), (0, 2, 1, 3)])
@pytest.mark.parametrize("kind", ["B32", "T3D3", "B22H"])
def test_elements_of_three_nodes_have_the_middle_one_between_the_others(tmp_path, order, kind):
    """Abaqus writes it in the middle, Gmsh and meshio last."""
    rows = [", ".join(np.array(line.split(", "))[list(order)]) for line in B32]
    bar = read(tmp_path, NODE, [f"*ELEMENT, TYPE={kind}, ELSET=BAR", *rows], FIXED, TIP)
    assert_same(bar, read(tmp_path, NODE, ["*ELEMENT, TYPE=B31, ELSET=BAR", *JOINT, *ARM], FIXED,
                          TIP))  # fmt: skip


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        ((NODE, ["*ELEMENT, TYPE=B31", *ARM], BLOCKS[:5]), "line 24: .ELEMENT: .*line 15 lacks"),
        ((NODE, BLOCKS[:3], BLOCKS), r"line 18: \*ELEMENT: set 'JOINT' stands in line 15 already"),
        ((NODE, BLOCKS[:3], [BLOCKS[0].lower(), "3, 3, 4"]), "line 18: .*'joint'.*line 15"),
        ((NODE, ALL, JOINT_SET, JOINT_SET), r"line 31: \*ELSET: set 'JOINT' stands in line 28"),
        ((NODE, BLOCKS, JOINT_SET), r"line 29: \*ELSET: set 'JOINT' .* line 15 .*in one \*ELSET"),
        ((NODE, ALL, FIXED, FIXED), r"line 30: \*NSET: set 'FIXED' .* line 28 .*in one \*NSET"),
        ((["*NODE, NSET=FIXED", *NODES], ALL, FIXED), "line 28: .*'FIXED' stands in line 1"),
        ((NODE, BLOCKS, ["*ELSET, ELSET=ALL", "JOINT, ARM"]), "line 30: .ELSET: found 'JO"),
        ((NODE, BLOCKS, ["*NSET, NSET=ENDS", "FIXED, 13"]), r"line 30: \*NSET: found 'FIXED, 13'"),
        ((NODE, ALL, ["*ELSET, ELSET=ARM, GENERATE", "5, 12"]), "line 29: .ELSET: GENERATE"),
        ((NODE, ALL, ["*ELSET, ELSET=A, GENERATE", "5, 12, 1", "1, 2, 1"]), "line 30: .ELSET: GEN"),
        ((NODE, ALL, ["*ELSET, ELSET=A, GENERATE", "1, 2000000000, 1"]), "line 29: .*found 2000"),
        ((NODE, ALL, ["*NSET, NSET=A, GENERATE", "1, 14, 1"]), "line 29: .NSET: node 14 does not"),
        ((NODE[:6], ["*NODE"], NODE[6:], ALL), "line 7: .NODE: stands in line 1 "),
        ((["*PART, NAME=A"], NODE, ALL, ["*PART, NAME=B"], NODE, ALL), "line 29: .PART: .*own"),
        ((["*INSTANCE, NAME=A, PART=P"] * 2,), "line 2: .INSTANCE: .*file of its own"),
        ((["*INSTANCE, NAME=A, PART=P", "0., 0., 0.01"],), "line 2: .*part is moved"),
        ((NODE, ["*INCLUDE, INPUT=rest.inp"]), r"line 15: \*INCLUDE: is not read"),
        ((NODE, ["*ELGEN, ELSET=ARM", "1, 12"]), r"line 15: \*ELGEN: is not read"),
        ((["*NODE, SYSTEM=C", *NODES], ALL), r"line 1: \*NODE: SYSTEM is not read"),
        ((NODE, ["*ELEMENT, INPUT=elements.txt, TYPE=B31"]), "line 15: .*INPUT is not"),
        ((NODE, ["*ELEMENT, TYPE=B31,", "ELSET=JOINT", *JOINT]), "line 15: .*: goes on"),
        ((NODE, ALL, JOINT_SET, BLOCKS[5:]), r"line 31: \*ELEMENT: stands after an \*ELSET"),
        ((NODE, BLOCKS, ["*NSET, ELSET=JOINT, NSET=N"]), r"line 29: \*NSET: ELSET is not read"),
        ((NODE, ALL, ["*ELSET, ELSET=ARM", "12, 13"]), "line 29: .ELSET: element 13 does"),
        ((NODE, ["*ELEMENT, TYPE=B31", "1, 1, 2", "1, 2, 3"]), "line 17: .*element 1 stands"),
        ((NODE, ["*ELEMENT, TYPE=B31", *B32]), "line 16: .ELEMENT: found 4 numbers"),
        ((NODE, ["*ELEMENT, TYPE=B31", "1, 13, 14"]), "line 16: .ELEMENT: node 14 does"),
        ((NODE, ["*ELEMENT, TYPE=B33", *B32]), "line 15: .ELEMENT: type B33: .*only bars"),
        ((NODE, ["*ELEMENT, TYPE=S3", "1, 1, 2, 3"]), "line 15: .ELEMENT: type S3: from"),
        ((NODE, ALL, ["*NSET, NSET=NONE"], FIXED), "line 29: .NSET: .*no members"),
    ],
)  # fmt: skip
def test_what_would_be_read_wrongly_is_refused_with_keyword_and_line(tmp_path, parts, reason):
    with pytest.raises(InputError, match=rf"bar\.inp: .*{reason}"):
        read(tmp_path, *parts)
