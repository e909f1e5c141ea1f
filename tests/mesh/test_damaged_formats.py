"""A hundred damaged files of each format: refused in a sentence, or read as what they say.

No reader can see that a digit of a coordinate was changed into another, or that whole lines of a
text that states no counts are gone. What is read must then be what the damaged file says: of a text
the volumes and areas of all names are compared with a plain parse in this module; a binary file may
differ from the whole one in as few nodes, elements and names as the bytes that were changed hold.
"""

import random
import re
import resource
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from inp_files import WAYS, Writer, deck_of
from mesh_files import boundary_sizes, region_sizes, sizes
from stability.mutated import damaged
from test_formats import build, written
from test_mesh_damage import TOKENS, refused_within

import skfem_joint as sj

#: Of this process for a file, and of the processes that it starts.
MOST_BYTES, MOST_SECONDS, MOST_OF_OTHERS = 100e6, 60.0, 2 * 2**30
Groups = dict[str, list[tuple[str, ...]]]
Plain = Callable[[str], tuple[dict[str, list[float]], Groups]]


def number(cell: str) -> str:
    """Number of a node, element or group as all write it."""
    return str(int(float(cell)))


def of_msh(text: str) -> tuple[dict[str, list[float]], Groups]:
    """Positions, and corners of the cells of each name, of a text file of Gmsh."""
    sections = {name: body.split("\n") for name, body
                in re.findall(r"^\$(\w+)[ \t]*\n(.*?)\n\$End\1", text, re.M | re.S)}  # fmt: skip
    names = {}
    for line in sections["PhysicalNames"][1:]:
        dimension, tag, name = line.split(maxsplit=2)
        names[dimension, tag] = name.strip()[1:-1]
    corners = {"9": 3, "11": 4}
    places, groups = {}, {name: [] for name in names.values()}
    if sections["MeshFormat"][0].startswith("2"):
        for line in sections["Nodes"][1:]:
            tag, *place = line.split()
            places[number(tag)] = [float(x) for x in place]
        for line in sections["Elements"][1:]:
            _, kind, n_tags, group, *rest = line.split()
            name = names.get(({"9": "2", "11": "3"}.get(number(kind), "0"), number(group)))
            first = int(float(n_tags)) - 1
            cell = tuple(map(number, rest[first : first + corners.get(number(kind), 1)]))
            if name:
                groups[name].append(cell)
        return places, groups
    words = " ".join(sections["Entities"]).split()
    counts, at, of = [int(float(word)) for word in words[:4]], 4, {}
    for dimension, count in enumerate(counts):
        for _ in range(count):
            tag, at = number(words[at]), at + 1 + (6 if dimension else 3)
            own, at = words[at + 1 : at + 1 + int(float(words[at]))], at + 1 + int(float(words[at]))
            of[str(dimension), tag] = [number(word).lstrip("-") for word in own]
            if dimension:
                at += 1 + int(float(words[at]))
    words, at = " ".join(sections["Nodes"]).split(), 4
    while at < len(words):
        count = int(float(words[at + 3]))
        tags, at = words[at + 4 : at + 4 + count], at + 4 + count
        for k, tag in enumerate(tags):
            places[number(tag)] = [float(x) for x in words[at + 3 * k : at + 3 * k + 3]]
        at += 3 * count
    words, at = " ".join(sections["Elements"]).split(), 4
    while at < len(words):
        dimension, tag, kind, count = (number(word) for word in words[at : at + 4])
        width, at = {"9": 7, "11": 11, "15": 2, "8": 4}[kind], at + 4
        for group in of.get((dimension, tag), []):
            name = names.get((dimension, group))
            if name:
                groups[name] += [
                    tuple(map(number, words[at + width * k + 1 :][: corners.get(kind, 1)]))
                    for k in range(int(count))
                ]
        at += width * int(count)
    return places, groups


def real(cell: str) -> float:
    """Number that may lack the E of its exponent."""
    return (
        float(re.sub(r"(?<=[\d.])([+-])", r"E\1", cell.upper().replace("E", ""))) if cell else 0.0
    )


def of_bulk(text: str) -> tuple[dict[str, list[float]], Groups]:
    """The same of bulk data."""
    entries: list[list[str]] = []
    for line in text.partition("ENDDATA")[0].split("\n"):
        line = line.rstrip()
        width = 16 if "*" in line[:8] else 8
        cells = [line[8 + k : 8 + k + width] for k in range(0, 64, width)]
        if "," in line:
            cells = [*line.split(","), *[""] * 8][1 : 9 if width == 8 else 5]
        word = re.split(r"[\s,]", line[:8])[0]
        if not line or line.startswith("$"):
            continue
        if word[:1] in ("", "+", "*"):
            entries[-1] += cells
        else:
            entries.append([word.upper(), *cells])
    places, groups = {}, {}
    for word, *cells in entries:
        cells = [cell.strip() for cell in cells]
        if word.startswith("GRID"):
            places[number(cells[0])] = [real(cell) for cell in cells[2:5]]
        elif word in ("CTETRA", "CTRIA6"):
            name = f"{'PSOLID' if word == 'CTETRA' else 'PSHELL'}_{number(cells[1])}"
            corners = cells[2 : 6 if word == "CTETRA" else 5]
            groups.setdefault(name, []).append(tuple(map(number, corners)))
    return places, groups


def of_inp(text: str) -> tuple[dict[str, list[float]], Groups]:
    """The same of a plain deck of Abaqus, with names in capitals and internal sets."""
    places: dict[str, list[float]] = {}
    elements, groups = dict[str, list[str]](), dict[str, list[tuple[str, ...]]]()
    members, card = dict[str, list[str]](), [""]
    sides = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}
    for line in text.upper().split("\n"):
        words = [word.strip() for word in line.split(",")]
        if line.strip().startswith("*"):
            card = words if not line.strip().startswith("**") else card
            continue
        options = (word.partition("=") for word in card[1:])
        names = [value.strip() for key, _, value in options if "SET" in key or key == "NAME"]
        if not line.strip():
            continue
        if card[0] == "*NODE":
            places[number(words[0])] = [float(x or 0) for x in [*words[1:], "", ""][:3]]
        elif card[0] == "*ELEMENT":
            own, *nodes = map(number, filter(None, words))
            elements[own] = nodes[:4]
            members.setdefault(names[0] if names else "", []).append(own)
        elif card[0] == "*ELSET":
            members.setdefault(names[0], []).extend(map(number, filter(None, words)))
        elif card[0] == "*SURFACE":
            groups.setdefault(names[0], []).extend(
                tuple(elements[element][k] for k in sides[words[1]])
                for element in members.get(words[0], [words[0]])
            )
    return places, groups | {
        name: [tuple(elements[each]) for each in own] for name, own in members.items()
    }


def said(plain: Plain, text: str) -> dict[str, float]:
    """Volumes and areas of all names of a text."""
    places, groups = plain(text)
    found = {}
    for name, cells in groups.items():
        own = np.array([[places[node] for node in cell] for cell in set(map(frozenset, cells))
                        for cell in [sorted(cell)]])  # fmt: skip
        edges = own[:, 1:] - own[:, :1]
        if edges.shape[1] == 3:
            found[name] = float(np.abs(np.linalg.det(edges)).sum() / 6.0)
        elif edges.shape[1] == 2:
            areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
            found[name] = float(areas.sum() / 2.0)
    return found


def differences(mesh: sj.NamedMesh, other: sj.NamedMesh) -> int:
    """How many nodes, elements and names differ; many, where counts do."""
    a, b = mesh.mesh, other.mesh
    if a.p.shape != b.p.shape or a.t.shape != b.t.shape:
        return 1000
    names: list[dict[tuple[str, str], np.ndarray]] = [
        {(kind, name): np.asarray(members) for kind in ("regions", "boundaries", "points")
         for name, members in getattr(each, kind).items()} for each in (mesh, other)
    ]  # fmt: skip
    same = sum(
        np.array_equal(names[0][name], names[1][name]) for name in names[0].keys() & names[1].keys()
    )
    moved = (a.p != b.p).any(axis=0).sum() + (a.t != b.t).any(axis=0).sum()
    return int(moved) + len(names[0].keys() | names[1].keys()) - same


def by_lines(data: bytes, rng: random.Random) -> bytes:
    """Text with a line that is left out, repeated, or exchanged with another."""
    lines = data.split(b"\n")
    k, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    way = rng.randrange(3)
    if way == 2:
        lines[k], lines[other] = lines[other], lines[k]
    else:
        lines[k : k + 1] = [lines[k]] * (2 * way)
    return b"\n".join(lines)


def by_contents(path: Path, rng: random.Random) -> None:
    """Change a number or the length of an array of a MED file, or take out what it has."""
    import h5py

    with h5py.File(path, "r+") as file:
        found = list[Any]()
        file.visititems(lambda _, each: found.append(each))
        arrays = [each for each in found if isinstance(each, h5py.Dataset)]
        array = rng.choice(arrays)
        values, way = array[()], rng.randrange(6)
        flat = values.reshape(-1)
        if way == 0:
            flat[rng.randrange(flat.size)] = rng.choice([0, -1, 1, 7, 2**31 - 1, 100])
            array[...] = values
        elif way == 1 and values.dtype == float:
            flat[rng.randrange(flat.size)] = rng.choice([np.nan, np.inf, 1e300, -1e3])
            array[...] = values
        elif way == 2:
            owner, name, attributes = array.parent, array.name.split("/")[-1], dict(array.attrs)
            del owner[name]
            made = owner.create_dataset(name, data=rng.choice([flat[:-1], flat[:0], [*flat, 1]]))
            made.attrs.update(attributes)
        elif way == 3:
            owner = rng.choice([each for each in found if each.attrs])
            name = rng.choice([*owner.attrs])
            owner.attrs[name] = rng.choice([0, 1, -1, 2, 5, 10**6, 10**18])
        elif way == 4:
            each = rng.choice(found)
            del file[each.name]
        else:
            each = rng.choice(found)
            file.move(each.name, f"{each.name} moved")


KINDS: dict[str, tuple[str, dict[str, float], Plain | None]] = {
    "Gmsh 4.1, text": ("msh", {"MshFileVersion": 4.1}, of_msh),
    "Gmsh 2.2, text": ("msh", {"MshFileVersion": 2.2}, of_msh),
    "Gmsh 4.1, binary": ("msh", {"MshFileVersion": 4.1, "Binary": 1}, None),
    "Gmsh 2.2, binary": ("msh", {"MshFileVersion": 2.2, "Binary": 1}, None),
    "MED": ("med", {}, None),
    "MED, its contents": ("med", {}, None),
    "bulk data, free": ("bdf", {"BdfFieldFormat": 0}, of_bulk),
    "bulk data, short": ("bdf", {"BdfFieldFormat": 1}, of_bulk),
    "bulk data, long": ("bdf", {"BdfFieldFormat": 2}, of_bulk),
    "Abaqus": ("inp", {}, of_inp),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Whole files of each kind."""
    gmsh: Any = pytest.importorskip("gmsh")
    folder = tmp_path_factory.mktemp("whole")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    build(gmsh)
    made = {}
    for k, (kind, (ending, options, _)) in enumerate(KINDS.items()):
        if ending == "inp":
            deck = deck_of(sj.load_meshes(made["Gmsh 4.1, text"]), "C3D10")
            made[kind] = Writer(deck, WAYS["plain"]).written(folder)
            continue
        made[kind] = written(gmsh, folder / f"{k}.{ending}", **options, SaveElementTagType=2)
    gmsh.finalize()
    return made


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_or_read_as_what_they_say(tmp_path, files, kind):
    _, _, plain = KINDS[kind]
    path = shutil.copy(files[kind], tmp_path / f"mesh{files[kind].suffix}")
    data, right, rng = path.read_bytes(), sj.load_meshes(path), random.Random(kind)
    # The largest of all children of this process so far, those of other tests included.
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    refused = 0
    for seed in range(100):
        path.write_bytes(data)
        if kind == "MED, its contents":
            by_contents(path, rng)
        elif plain is not None and seed % 3 == 0:
            path.write_bytes(by_lines(data, rng))
        else:
            path.write_bytes(damaged(data, rng, TOKENS))
        start = time.monotonic()
        mesh = refused_within(path, MOST_BYTES)
        assert time.monotonic() - start < MOST_SECONDS
        if isinstance(mesh, str):
            refused += 1
            continue
        assert np.all(sizes(mesh) > 0.0)
        if plain is not None:
            expected = said(plain, path.read_text(encoding="latin-1"))
            found = region_sizes(mesh) | boundary_sizes(mesh)
            if kind == "Abaqus":  # whose names have no case, and whose sets may be internal
                found = {name.upper(): size for name, size in found.items()}
                expected = {name: expected[name] for name in found}
            assert found == pytest.approx(expected, rel=1e-9), seed
        else:
            assert differences(mesh, right) < 40, seed
    assert refused > 30
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    assert most <= max(before, MOST_OF_OTHERS / 1024)


@pytest.mark.parametrize("ending", ["inp", "bdf", "med"])
def test_elements_with_the_corners_of_others_are_refused_whatever_their_middles(tmp_path, ending):
    """They would count once, without a word: a mesh has its elements by their corners."""
    places = np.array(
        [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1],
         [1, 0, 1], [0, 1, 1], [1.1, 0, 0]], dtype=float,
    )  # fmt: skip
    once = list(range(1, 11))
    twice = [*once[:4], 11, *once[5:]]
    path = tmp_path / f"mesh.{ending}"
    if ending == "inp":
        nodes = [f"{k}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(places.tolist(), 1)]
        cells = [f"{k}, {', '.join(map(str, own))}" for k, own in ((1, once), (2, twice))]
        lines = ["*NODE", *nodes, "*ELEMENT, TYPE=C3D10, ELSET=all", *cells]
    elif ending == "bdf":
        nodes = [f"GRID,{k},,{x},{y},{z}" for k, (x, y, z) in enumerate(places.tolist(), 1)]
        cells = [
            f"CTETRA,{k},1,{','.join(map(str, own[:6]))}\n,{','.join(map(str, own[6:]))}"
            for k, own in ((1, once), (2, twice))
        ]
        lines = ["BEGIN BULK", *nodes, *cells, "ENDDATA"]
    if ending == "med":
        meshlane = pytest.importorskip("meshlane")
        cells = [("tetra10", np.array([once, twice]) - 1)]
        meshlane.write(path, meshlane.Mesh(places, cells))
    else:
        path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    with pytest.raises(sj.InputError, match=r"element 2 .*has the corners of element 1"):
        sj.load_meshes(path)
