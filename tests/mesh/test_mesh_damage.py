"""Damaged files are refused in words, within bounded time and memory, or read for what they say."""

import math
import random
import time
import tracemalloc
from pathlib import Path

import meshio
import numpy as np
import pytest
from inp_files import TYPES, WAYS, Writer, deck_of, mesh_of
from mesh_files import (
    BAR,
    BAR_NAMES,
    KINDS,
    LINES,
    assert_same,
    msh22,
    read_or_refusal,
    saved,
    sizes,
    strip,
    tip_compliance,
)
from stability.mutated import damaged

from skfem_joint.ground.errors import InputError
from skfem_joint.mesh import NamedMesh, build_bar, load_meshes, write_mesh

TOKENS = ("nan", "inf", "-1", "0", "1", "2", "15", "1e400", "1e99", "1e308", "4294967295",
          "4294967296", "9223372036854775807", "18446744073709551616", "0.1", "0.25", "x",
          "$EndNodes", "$Nodes", "", "1e-320", "-0.0", "3")  # fmt: skip
GOOD = msh22(BAR, LINES, BAR_NAMES)
SMALL = build_bar([("joint", 0.1, 2), ("linear", 0.5, 2)], {"fixed": 0.0})


def mesh_or_refusal(path: Path) -> NamedMesh | str:
    """Mesh of a file, or the words in which it is refused."""
    found: NamedMesh | str = read_or_refusal(load_meshes, path)
    return found


def refused_within(path: Path, memory: float) -> NamedMesh | str:
    """What `mesh_or_refusal` gives, in bounded memory (bytes)."""
    tracemalloc.start()
    try:
        mesh = mesh_or_refusal(path)
        assert tracemalloc.get_traced_memory()[1] < memory
    finally:
        tracemalloc.stop()
    return mesh


def files_of_all_kinds(mesh: NamedMesh, folder: Path) -> list[bytes]:
    """One mesh in formats 4.1 and 2.2, text and binary."""
    write_mesh(mesh, folder / "a.msh")
    files = [(folder / "a.msh").read_bytes()]
    raw = meshio.read(folder / "a.msh")
    for file_format in ("gmsh", "gmsh22"):
        for binary in (True, False):
            meshio.write(folder / "b.msh", raw, file_format=file_format, binary=binary)
            files.append((folder / "b.msh").read_bytes())
    return files


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", r"no section \$MeshFormat"),
        ("hello\n", r"no section \$MeshFormat"),
        (GOOD[: GOOD.index("$EndElements") - 3], r"\$Elements is not closed.* cut"),
        (GOOD[: GOOD.index("$Elements")], r"no section \$Elements"),
        (GOOD.replace("4 0.6 0.0 0.0\n", ""), r"\$Nodes announces more than it holds"),
        (GOOD.replace("2 0.1", "2 0.1x"), "could not be read to its end"),
        (GOOD.replace("\n2 0.1", "\n1 0.1"), "uses a node number twice"),
        (GOOD.replace('"linear"', '"joint"'), "2 groups are named 'joint'"),
        (GOOD.replace("2.2 0 8", "4 0 8"), r"Gmsh format 4; save it again.*4\.1"),
        (GOOD.replace("2.2 0 8", "2.2 0 4"), "unknown kind of Gmsh file: mode 0, data size 4"),
        (GOOD.replace("5 1 2 2 2 3 4", "5 1 0 3 4"), "some elements have tags and some have none"),
        (GOOD.replace("5 1 2 2 2 3 4", "5 1 -1 3 4"), "negative counts"),
        (GOOD + GOOD[GOOD.index("$Nodes") : GOOD.index("$Elements")], r"\$Nodes stands twice"),
        *((GOOD.replace("es\n4\n", f"es\n{n}\n"), "") for n in ("-1", "nan", "9" * 5000)),
        *((GOOD.replace("es\n4\n", f"es\n{n}\n"), "announces") for n in (5, 2**31, 2**63)),
        *((GOOD.replace("ents\n5\n", f"ents\n{n}\n"), "announces") for n in (6, 2**40, 2**63)),
    ],
)  # fmt: skip
def test_files_that_are_not_whole_are_refused_with_file_and_reason(tmp_path, capfd, text, reason):
    path = saved(tmp_path, text, "my bar.msh")
    with pytest.raises(InputError, match=rf"my bar\.msh: .*{reason}"):
        load_meshes([path])
    assert isinstance(refused_within(path, 20e6), str)
    assert capfd.readouterr() == ("", "")


def test_results_of_any_size_beside_a_mesh_do_not_matter(tmp_path):
    path = saved(tmp_path, GOOD + "$NodeData\n2000000000\n$EndNodeData\n" * 2)
    mesh = refused_within(path, 20e6)
    assert isinstance(mesh, NamedMesh)
    assert_same(mesh, load_meshes([saved(tmp_path, GOOD)]), sorted_alike=True)


FIVE, HUGE = (number.to_bytes(8, "little") for number in (5, 2 * 10**9))


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        (0, b"$Nodes\n3 5 1 5\n", b"$Nodes\n3 2000000000 1 2000000000\n"),
        (0, b"$Nodes\n3 5 1 5\n", b"$Nodes\n2000000000 5 1 5\n"),
        (0, b"\n1 2 0 2\n", b"\n1 2 0 2000000000\n"),
        (0, b"\n1 2 0 2\n2\n", b"\n1 2 0 2\n2000000000\n"),
        (0, b"\n1 2 1 2\n", b"\n1 2 1 2000000000\n"),
        (0, b"\n1 0.0 0.0 0.0 1 1\n", b"\n1 0.0 0.0 0.0 2000000000 1\n"),
        (1, FIVE + (1).to_bytes(8, "little"), HUGE + (1).to_bytes(8, "little")),
        (3, b"$Nodes\n5\n", b"$Nodes\n2000000000\n"),
        (4, b"$Nodes\n5\n", b"$Nodes\n2000000000\n"),
        (4, b"$Nodes\n5\n1 ", b"$Nodes\n5\n2000000000 "),
    ],
)
def test_numbers_that_a_file_cannot_hold_are_refused_in_bounded_memory(tmp_path, kind, old, new):
    data = files_of_all_kinds(SMALL, tmp_path)[kind]
    path = saved(tmp_path, data.replace(old, new, 1))
    assert path.read_bytes() != data
    assert isinstance(refused_within(path, 20e6), str)


def test_a_file_of_two_gigabytes_is_refused_unread(tmp_path):
    path = tmp_path / "bar.msh"
    with path.open("wb") as file:
        file.truncate(2 * 2**30)  # the file takes no space on the disk
    assert isinstance(refused_within(path, 10e6), str)


@pytest.mark.parametrize("kind", ["line", "quadrilateral", "tetrahedron"])
def test_a_file_cut_anywhere_is_refused_or_whole(tmp_path, kind):
    for data in files_of_all_kinds(strip(kind), tmp_path):
        end = data.index(b"$EndElements") + len(b"$EndElements")
        whole = load_meshes([saved(tmp_path, data)])
        assert_same(load_meshes([saved(tmp_path, data[:end])]), whole)
        for length in range(0, end, 7 if kind == "line" else 67):
            assert isinstance(mesh_or_refusal(saved(tmp_path, data[:length])), str)


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_damage_anywhere_gives_a_proper_mesh_or_a_refusal(tmp_path, kind, order):
    """No other exception, no warning, and every element has its size and direction."""
    rng = random.Random(f"{kind} {order}")
    refused, count = 0, 5 if kind in ("tetrahedron", "hexahedron") else 12
    for data in files_of_all_kinds(strip(kind, order), tmp_path):
        assert isinstance(mesh_or_refusal(saved(tmp_path, data)), NamedMesh)
        for _ in range(count):
            mesh = mesh_or_refusal(saved(tmp_path, damaged(data, rng, TOKENS)))
            if isinstance(mesh, str):
                refused += 1
                continue
            assert np.all(sizes(mesh) > 0.0)
            if mesh.dim == 1:
                assert np.all(np.diff(mesh.mesh.p[0]) > 0.0)
                assert tip_compliance(mesh) == pytest.approx(mesh.size, rel=1e-6)
                assert math.dist(*mesh.coordinates[[0, -1]]) == pytest.approx(mesh.size, rel=1e-9)
    assert refused > count


#: Words that stand in files of Abaqus and CalculiX.
WORDS = ("nan", "-1", "0", "1", "2", "1.5", "1e400", "4294967296", "18446744073709551616", "x", "",
         "*NODE", "*ELEMENT,", "*END PART", "*STEP", "TYPE=C3D8", "TYPE=B31", "GENERATE", "NSET=A",
         "**", ",", '"', "S1", "S7", "ELSET=lower_lap,", "INSTANCE=Body-1,")  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("what", TYPES)
@pytest.mark.parametrize("way", WAYS)
def test_damaged_abaqus_files_are_refused_or_meshes(tmp_path, what, way):
    """Six hundred files: no other exception, bounded memory and time, elements of proper size."""
    number = [*WAYS].index(way)
    kind = TYPES[what][number % len(TYPES[what])]
    path = Writer(deck_of(mesh_of(what, kind), kind), WAYS[way], number).written(tmp_path)
    data, rng, refused = path.read_bytes(), random.Random(f"{what} {way}"), 0
    for _ in range(10):
        path.write_bytes(damaged(data, rng, WORDS))
        start = time.process_time()
        mesh = refused_within(path, 100e6)
        assert time.process_time() - start < 10.0
        refused += isinstance(mesh, str)
        assert isinstance(mesh, str) or np.all(sizes(mesh) > 0.0)
    assert refused > 0


@pytest.mark.slow
def test_a_cut_abaqus_file_of_parts_is_refused(tmp_path):
    """One without parts is whole wherever it ends with a line, as the programs have it too."""
    kind = "C3D10"
    path = Writer(deck_of(mesh_of("solids", kind), kind), WAYS["parts"]).written(tmp_path)
    data = path.read_bytes()
    for length in range(0, len(data) - 14, 211):
        path.write_bytes(data[:length])
        assert isinstance(mesh_or_refusal(path), str)
