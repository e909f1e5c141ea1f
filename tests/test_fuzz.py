"""Damaged scene and mesh files are refused in words, or read for what they say."""

from __future__ import annotations

import itertools
import math
import random
import struct
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import meshio
import numpy as np
import pytest
import skfem
from skfem.helpers import dot, grad

from skfem_joint import cli, memory
from skfem_joint.errors import InputError
from skfem_joint.meshing import BarMesh, load_mesh
from skfem_joint.scene import AnyScene, load_scene
from skfem_joint.study import full_system

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.toml"))
MESHES = sorted((ROOT / "meshes").glob("*.msh"))
BARS = [mesh for mesh in MESHES if "plate" not in mesh.stem]
#: Longest time that any single file may take, s: far above what it takes, far below a hang.
PATIENCE = 5.0

TOKENS = ("nan", "inf", "-inf", "1e400", "-1", "0", "0.0", "1e-320", "1e308", "9" * 400, "true",
          "[]", "{}", "''", '"free_end"', '"joint"', '"\\u0000"', "[[joint]]", "[load]", "=", "#",
          "]", '"""', "1979-05-27", "0x7fffffffffffffff", "[1, 2]", "{a = 1}", "\x00", "é",
          '"../../../../etc/passwd"', '"/dev/zero"', '"."', '""', '"CON"')  # fmt: skip


def mutations(data: bytes, tokens: tuple[str, ...], rng: random.Random) -> Iterator[bytes]:
    """Endless damaged copies: bytes, tokens and lines changed, cut, doubled or exchanged."""

    def byte(copy: bytearray) -> None:
        copy[rng.randrange(len(copy))] = rng.randrange(256)

    def bit(copy: bytearray) -> None:
        copy[rng.randrange(len(copy))] ^= 1 << rng.randrange(8)

    def digit(copy: bytearray) -> None:
        places = [i for i, c in enumerate(copy) if chr(c).isdigit()]
        copy[rng.choice(places)] = ord(rng.choice("0123456789.-e"))

    def token(copy: bytearray) -> None:
        words = bytes(copy).split(b" ")
        words[rng.randrange(len(words))] = rng.choice(tokens).encode()
        copy[:] = b" ".join(words)

    def value(copy: bytearray) -> None:
        lines = bytes(copy).split(b"\n")
        place = rng.choice([i for i, line in enumerate(lines) if line.strip()])
        key, equals, _ = lines[place].partition(b"=")
        words = key.split()
        if not equals and words:
            words[rng.randrange(len(words))] = rng.choice(tokens).encode()
            lines[place] = b" ".join(words)
        else:
            lines[place] = key + b"= " + rng.choice(tokens).encode()
        copy[:] = b"\n".join(lines)

    def line(copy: bytearray) -> None:
        lines = bytes(copy).split(b"\n")
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[i : i + 1] = rng.choice([[], [lines[i]] * 2, [lines[j]], [lines[j], lines[i]]])
        copy[:] = b"\n".join(lines)

    def cut(copy: bytearray) -> None:
        del copy[rng.randrange(len(copy)) :]

    def hole(copy: bytearray) -> None:
        start = rng.randrange(len(copy))
        del copy[start : start + rng.randrange(1, 60)]

    def insert(copy: bytearray) -> None:
        start = rng.randrange(len(copy))
        copy[start:start] = bytes(rng.randrange(256) for _ in range(rng.randrange(1, 8)))

    changes: list[Callable[[bytearray], None]] = [
        byte, bit, digit, digit, token, value, value, line, hole, insert, cut
    ]  # fmt: skip
    while True:
        copy = bytearray(data)
        for _ in range(rng.choice([1, 1, 1, 2, 4])):
            if any(chr(c).isdigit() for c in copy) and copy.strip():
                rng.choice(changes)(copy)
        yield bytes(copy)


# Scenes


def outcome(path: Path) -> AnyScene | str:
    """Scene that a file gives, or the words in which it is refused; nothing else passes."""
    begin = time.perf_counter()
    try:
        scene = load_scene(path)
        system = full_system(scene)
    except InputError as error:
        text = str(error)
    else:
        assert np.all(np.isfinite(system.w))
        assert memory.needed(scene).total > 0
        return scene
    finally:
        assert time.perf_counter() - begin < PATIENCE
    assert text
    return text


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_damaged_scenes_are_refused_or_valid(example: Path, tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "examples").mkdir()
    for mesh in MESHES:
        (tmp_path / "meshes" / mesh.name).write_bytes(mesh.read_bytes())
    path = tmp_path / "examples" / "scene.toml"
    rng = random.Random(example.stem)
    valid, count = 0, 40 if "plate" in example.stem else 1000  # plates take longer to assemble
    for data in itertools.islice(mutations(example.read_bytes(), TOKENS, rng), count):
        path.write_bytes(data)
        valid += not isinstance(outcome(path), str)
    # Comments and harmless digits; the rest is refused.
    assert 0.04 * count < valid < 0.96 * count
    assert sorted(file.name for file in tmp_path.rglob("*") if file.is_file()) == sorted(
        ["scene.toml", *(mesh.name for mesh in MESHES)]
    )


@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 100, b"\xff\xfe", b"[", b"a" * 100_000, b"[" * 50_000, b"a=" + b"[" * 50_000,
     b"a=" + b"{a=" * 5_000, b"\n" * 100_000, b"[mesh]\nfile = 1", b"title = 'a\0b'",
     b"x" + b".x" * 20_000 + b" = 1",
     b"".join(b"a%d = 1\n" % i for i in range(50_000))],
    ids=lambda data: repr(data[:8]),
)  # fmt: skip
def test_what_is_no_scene_at_all_is_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(data)
    text = outcome(path)
    assert isinstance(text, str)
    assert all(line.startswith(str(path)) for line in text.splitlines())


@pytest.mark.parametrize(
    "name", ["/dev/zero", "/dev/null", "/dev/stdin", ".", "..", "/", "../scene.toml", "scene.toml",
             "/proc/self/mem", "/etc/passwd", "x" * 300, "x/" * 3000, "~", "a:b", "%s%n", "*",
             "\u202emsh", "http://localhost/x.msh", "file:///x.msh"]
)  # fmt: skip
@pytest.mark.parametrize("key", ["mesh", "table"])
def test_files_that_a_scene_may_not_mean(name: str, key: str, tmp_path: Path) -> None:
    """Devices never end and are refused unread; all else says why it cannot be read."""
    text = (ROOT / "examples" / "lap_joint_case_I.toml").read_text(encoding="utf-8")
    mesh = '"../meshes/lap_joint_500mm.msh"'
    if key == "mesh":
        text = text.replace(mesh, f"'{name}'")
    else:
        text = text.replace(mesh, f"'{(ROOT / 'meshes').as_posix()}/lap_joint_500mm.msh'")
        load = 'kind = "harmonic"\namplitude = 437.5e3\nfrequency = 2000.0'
        assert load in text
        text = text.replace(load, f"kind = 'table'\nfile = '{name}'")
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    refused = outcome(path)
    assert isinstance(refused, str)
    assert f"{path}: {'mesh' if key == 'mesh' else 'load[0]'}.file: " in refused


@pytest.mark.parametrize("name", ["scène 1.toml", "-scene.toml", "a'b\"c.toml", "%d.toml",
                                  "new\nline.toml"])  # fmt: skip
def test_scenes_and_folders_may_have_odd_names(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / name.removesuffix(".toml")
    folder.mkdir()
    text = EXAMPLES[0].read_text(encoding="utf-8").replace("../meshes", str(ROOT / "meshes"))
    (folder / name).write_text(text, encoding="utf-8")
    assert cli.main(["check", str(folder / name)]) == 0
    assert "valid" in capsys.readouterr().out


# Meshes


def read_again(text: str) -> tuple[float, float]:
    """Length and sum of element lengths of a Gmsh 4.1 file, read without the package's reader."""

    def section(name: str) -> list[str]:
        return text.split(f"${name}\n")[1].split(f"$End{name}")[0].split()

    words = iter(section("Nodes"))
    blocks, *_ = (next(words) for _ in range(4))
    at: dict[int, tuple[float, ...]] = {}
    for _ in range(int(float(blocks))):
        *_, count = (next(words) for _ in range(4))
        tags = [int(float(next(words))) for _ in range(int(float(count)))]
        for tag in tags:
            at[tag] = tuple(float(next(words)) for _ in range(3))
    words = iter(section("Elements"))
    blocks, *_ = (next(words) for _ in range(4))
    lines: set[tuple[int, int]] = set()
    for _ in range(int(float(blocks))):
        _, _, kind, count = (int(float(next(words))) for _ in range(4))
        for _ in range(count):
            next(words)
            nodes = [int(float(next(words))) for _ in range(2 if kind == 1 else 1)]
            if kind == 1:
                lines.add((min(nodes), max(nodes)))
    used = [at[node] for pair in lines for node in pair]
    first, last = min(used), max(used)
    return math.dist(first, last), math.fsum(math.dist(at[a], at[b]) for a, b in lines)


def tip_compliance(bar: BarMesh) -> float:
    """Displacement of the last node under a unit force with EA = 1, the first node held, m/N."""
    basis = skfem.Basis(bar.mesh, skfem.ElementLineP1())
    stiffness = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    force = np.zeros(basis.N)
    force[-1] = 1.0
    return float(skfem.solve(*skfem.condense(stiffness, force, D=np.array([0])))[-1])


def bar_or_refusal(path: Path) -> BarMesh | str:
    """Bar that a file gives, or the words in which it is refused; nothing else passes."""
    begin = time.perf_counter()
    try:
        return load_mesh(path)
    except InputError as error:
        text = str(error)
    finally:
        assert time.perf_counter() - begin < PATIENCE
    assert text.startswith(str(path))
    return text


MESH_TOKENS = ("nan", "inf", "-1", "0", "1", "2", "15", "1e400", "1e99", "1e308", "4294967295",
               "4294967296", "9223372036854775807", "18446744073709551616", "0.1", "0.25", "x",
               "$EndNodes", "$Nodes", "", "1e-320", "-0.0", "3")  # fmt: skip


@pytest.mark.parametrize("mesh", BARS, ids=lambda path: path.stem)
def test_damaged_meshes_are_refused_or_have_the_length_and_stiffness_they_say(
    mesh: Path, tmp_path: Path
) -> None:
    path = tmp_path / "bar.msh"
    rng = random.Random(mesh.stem)
    accepted = 0
    for data in itertools.islice(mutations(mesh.read_bytes(), MESH_TOKENS, rng), 800):
        path.write_bytes(data)
        bar = bar_or_refusal(path)
        if isinstance(bar, str):
            continue
        accepted += 1
        distance, along = read_again(data.decode("utf-8"))
        assert bar.length == pytest.approx(distance, rel=1e-12)
        assert bar.length == pytest.approx(along, rel=1e-9)
        assert tip_compliance(bar) == pytest.approx(bar.length, rel=1e-9)
    assert 10 < accepted < 790


def abaqus() -> bytes:
    text = "*HEADING\nbar\n*NODE\n"
    text += "".join(f"{i + 1}, {0.05 * i!r}, 0.0, 0.0\n" for i in range(13))
    text += "*ELEMENT, TYPE=T3D2\n"
    text += "".join(f"{i}, {i}, {i + 1}\n" for i in range(1, 13))
    text += "*NSET, NSET=fixed\n1\n*NSET, NSET=free_end\n13\n"
    return (text + "*ELSET, ELSET=joint\n1, 2, 3,\n4, 5\n").encode()


@pytest.mark.parametrize("file_format", ["gmsh", "gmsh22", "abaqus"])
@pytest.mark.parametrize("binary", [True, False])
def test_damaged_files_of_other_formats(file_format: str, binary: bool, tmp_path: Path) -> None:
    path = tmp_path / ("bar.inp" if file_format == "abaqus" else "bar.msh")
    if file_format == "abaqus":
        path.write_bytes(abaqus())
    else:
        raw = meshio.read(BARS[-1])
        meshio.write(path, raw, file_format=file_format, binary=binary)
    assert isinstance(bar_or_refusal(path), BarMesh)
    rng = random.Random(f"{file_format} {binary}")
    refused = 0
    for data in itertools.islice(mutations(path.read_bytes(), MESH_TOKENS, rng), 300):
        path.write_bytes(data)
        bar = bar_or_refusal(path)
        if isinstance(bar, str):
            refused += 1
        else:
            assert np.all(np.diff(bar.mesh.p[0]) > 0.0)
            assert tip_compliance(bar) == pytest.approx(bar.length, rel=1e-6)
            ends = bar.coordinates[[0, -1]]
            assert math.dist(*ends) == pytest.approx(bar.length, rel=1e-9)
    assert refused > 50


NODES = {1: (0.0, 0.0, 0.0), 2: (0.1, 0.0, 0.0), 3: (0.3, 0.0, 0.0), 4: (0.6, 0.0, 0.0)}
LINES = [(1, 2), (2, 3), (3, 4)]


def gmsh(
    nodes: dict[int, tuple[float, float, float]],
    lines: list[tuple[int, int]],
    names: str = '0 3 "fixed"\n0 4 "free_end"\n1 1 "joint"\n',
    counts: tuple[object, object] | None = None,
) -> str:
    """Bar in Gmsh 2.2, its first line the joint; ``counts`` are those that it claims."""
    n_nodes, n_cells = counts or (len(nodes), len(lines) + 2)
    text = f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n{names.count(chr(10))}\n{names}"
    text += f"$EndPhysicalNames\n$Nodes\n{n_nodes}\n"
    text += "".join(f"{tag} {x!r} {y!r} {z!r}\n" for tag, (x, y, z) in nodes.items())
    text += f"$EndNodes\n$Elements\n{n_cells}\n1 15 2 3 1 1\n2 15 2 4 4 4\n"
    for i, (a, b) in enumerate(lines):
        text += f"{i + 3} 1 2 {1 if i == 0 else 2} 1 {a} {b}\n"
    return text + "$EndElements\n"


def moved(tag: int, x: float) -> dict[int, tuple[float, float, float]]:
    return NODES | {tag: (x, 0.0, 0.0)}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (gmsh(moved(3, math.nan), LINES), "finite"),
        (gmsh(moved(3, math.inf), LINES), "finite"),
        (gmsh(moved(3, 1e200), LINES), "below 1e20"),
        (gmsh(moved(3, 0.1), LINES), "no length"),
        (gmsh(NODES | {5: (0.1, 0.0, 0.0)}, [(1, 2), (5, 3), (3, 4)]), "two nodes in one place"),
        (gmsh(NODES, [*LINES, (2, 2)]), "no length"),
        (gmsh(moved(3, 0.05), LINES), "folds back"),
        (gmsh(NODES, [(1, 2), (3, 4)]), "disconnected"),
        (gmsh(NODES, [(1, 2), (2, 4), (3, 4)]), "folds back"),
        (gmsh(NODES, [(1, 2), (2, 3), (3, 9)]), "refers to node 9"),
        (gmsh(NODES, [(1, 2), (2, 3), (3, 1)]), "closed"),
        (gmsh(NODES | {3: (0.3, 1e-3, 0.0)}, LINES), "not straight"),
        (gmsh(NODES, LINES, counts=(2**31, 5)), "announces more"),
        (gmsh(NODES, LINES, counts=(4, 2**40)), "announces more"),
        (gmsh(NODES, LINES, counts=(2**63, 2**63)), "announces more"),
        (gmsh(NODES, LINES, counts=(-1, 5)), ""),
        (gmsh(NODES, LINES, counts=("nan", 5)), ""),
        (gmsh(NODES, LINES, counts=("9" * 5000, 5)), ""),
        (gmsh(NODES, LINES)[:-30], "cut"),
        ("", "empty"),
    ],
)
def test_meshes_that_make_no_bar(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "bar.msh"
    path.write_text(text)
    tracemalloc.start()
    try:
        refused = bar_or_refusal(path)
        assert tracemalloc.get_traced_memory()[1] < 30 * 2**20
    finally:
        tracemalloc.stop()
    assert isinstance(refused, str)
    assert words in refused


@pytest.mark.parametrize("lines", [[(2, 1), (2, 3), (4, 3)], [(3, 4), (1, 2), (2, 3)]])
def test_inverted_and_shuffled_elements_make_the_same_bar(
    lines: list[tuple[int, int]], tmp_path: Path
) -> None:
    path = tmp_path / "bar.msh"
    path.write_text(gmsh(NODES, lines))
    bar = load_mesh(path)
    np.testing.assert_array_equal(bar.mesh.p[0], [0.0, 0.1, 0.3, 0.6])
    assert tip_compliance(bar) == pytest.approx(0.6, rel=1e-12)


@pytest.mark.parametrize("blocks", [2**31 // 8, 2**62])
def test_binary_files_that_claim_gigabytes(blocks: int, tmp_path: Path) -> None:
    path = tmp_path / "bar.msh"
    meshio.write(path, meshio.read(BARS[-1]), file_format="gmsh", binary=True)
    data = path.read_bytes()
    start = data.index(b"$Nodes\n") + len(b"$Nodes\n")
    for place in range(0, 60, 4):
        copy = bytearray(data)
        copy[start + place : start + place + 8] = struct.pack("<Q", blocks)
        path.write_bytes(copy)
        tracemalloc.start()
        try:
            bar = bar_or_refusal(path)
            assert tracemalloc.get_traced_memory()[1] < 50 * 2**20
        finally:
            tracemalloc.stop()
        if not isinstance(bar, str):
            assert tip_compliance(bar) == pytest.approx(0.6, rel=1e-9)


def test_a_file_of_two_gigabytes_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "bar.msh"
    with path.open("wb") as file:
        file.truncate(2 * 2**30)  # takes no room on the disk
    begin = time.perf_counter()
    tracemalloc.start()
    try:
        refused = bar_or_refusal(path)
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()
    assert isinstance(refused, str)
    assert time.perf_counter() - begin < 1.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([('region = "joint"', 'region = "joint_2"')], "joint[0].region: found 'joint_2'"),
        ([('fixed = ["fixed"]', "fixed = []")], "free body"),
        ([('fixed = ["fixed"]', 'fixed = ["fixed_2"]')], "support.fixed[0]: found 'fixed_2'"),
        ([('fixed = ["fixed"]', "")], "support.fixed: missing"),
    ],
)
def test_joints_and_supports_that_the_mesh_has_not(
    changes: list[tuple[str, str]], words: str, tmp_path: Path
) -> None:
    text = EXAMPLES[0].read_text(encoding="utf-8").replace("../meshes", str(ROOT / "meshes"))
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    assert words in str(outcome(path))
