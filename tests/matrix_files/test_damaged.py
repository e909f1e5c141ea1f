"""Damaged files of other programs' matrices: refused in a sentence, or read as what they say.

A number that is replaced by another number makes another whole file. Where a half is given nothing
in the file tells; what is read must then be what a plain parse of the damaged text gives.
"""

import random
import re
import resource
import shutil
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from matrix_writers import abaqus_rows, coordinates, dmig, substructure
from scipy import sparse
from test_laps import HERE, stored

from skfem_joint.ground.errors import InputError
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import read_labels
from skfem_joint.matrix_files.reading import read_matrix

Plain = Callable[[bytes], dict[tuple[float, ...], float]]
#: Of a process, beside what it has when a test begins.
MOST_BYTES, MOST_SECONDS = 2 * 2**30, 60.0


def damaged(content: bytes, seed: int) -> bytes:
    """Content cut, with bytes changed, put in, taken out or repeated, or numbers replaced."""
    at = random.Random(seed)
    here, size = at.randrange(len(content)), at.randrange(1, 40)
    numbers = [*re.finditer(rb"[-+.\dEe]+", content[here : here + 4000])]
    found = at.choice(numbers).span() if numbers else (0, 1)
    a, b = here + found[0], here + found[1]
    other = at.choice([b"nan", b"1e999", b"-1", b"0", b"7", b"99999999999", b"1.5", b"", b"1,5"])
    return [
        content[:here],
        content[:here] + bytes(at.randrange(256) for _ in range(size)) + content[here + size :],
        content[:here] + bytes([content[here] ^ (1 << at.randrange(8))]) + content[here + 1 :],
        content[:here] + content[here + size :],
        content[: here + size] + content[here:],
        content[:a] + other + content[b:],
    ][seed % 6]


def lines_of(content: bytes, columns: int) -> dict[tuple[float, ...], float]:
    """Entries of rows of numbers; the last is the value."""
    entries = {}
    for line in content.decode("latin-1").splitlines():
        cells = line.replace(",", " ").split()
        if cells:
            *place, value = (float(cell.upper().replace("D", "E")) for cell in cells)
            assert len(place) == columns - 1
            entries[tuple(place)] = value
    return entries


def columns_of(content: bytes, free: bool) -> dict[tuple[float, ...], float]:
    """Entries of DMIG columns as the writer of the tests sets them."""
    entries = {}
    column = (0.0, 0.0)
    for line in content.decode("latin-1").split("\n"):
        cells = [line[k : k + 16] for k in (8, 24, 40, 56)]
        if free:
            cells = [*line.split(","), "", "", ""][1:]
        if line.startswith("DMIG*"):
            column = float(cells[1]), float(cells[2])
        elif line.startswith("*"):
            place = *(float(cell or 0) for cell in cells[:2]), *column
            entries[place] = float(cells[2].replace("D", "E"))
    return entries


def write_op4(path: Path, K: np.ndarray, binary: bool) -> None:
    library = pytest.importorskip("pyyeti.nastran.op4")
    library.write(str(path), {"KAA": sparse.coo_matrix(K)}, binary=binary, sparse="bigmat")


def whole(path: Path, kind: str) -> Plain | None:
    """Write a whole file; returns a plain parse of its text, where there is one."""
    K, M, labels = stored()
    match kind:
        case "Abaqus rows":
            abaqus_rows(path, K, labels, "lower")
            return partial(lines_of, columns=5)
        case "Abaqus rows, whole":
            abaqus_rows(path, K, labels, "whole")
        case "coordinates":
            coordinates(path, np.tril(K))
            return partial(lines_of, columns=3)
        case "CalculiX":
            shutil.copy(HERE / "lap.sti", path)
            return partial(lines_of, columns=3)
        case "substructure":
            substructure(path, {"STIFFNESS": K, "MASS": M}, labels)
        case "DMIG":
            dmig(path, {"KAA": K}, labels)
            return partial(columns_of, free=False)
        case "DMIG, free":
            dmig(path, {"KAA": K}, labels, free=True)
            return partial(columns_of, free=True)
        case "ANSYS":
            examples = pytest.importorskip("ansys.mapdl.reader.examples", exc_type=ImportError)
            shutil.copy(examples.fullfile, path)
        case _:
            write_op4(path, K, binary="binary" in kind)
    return None


def entries_of(given: GivenMatrix, plain: dict[tuple[float, ...], float]) -> bool:
    """Whether a matrix has the entries of a plain parse, mirrored."""
    n, expected = given.matrix.shape[0], {}
    held = set(given.held.tolist())
    if given.labels is not None:
        number = {(float(a), float(b)): k for k, (a, b) in enumerate(given.labels)}
        items = ((number[p[:2]], number[p[2:]], x) for p, x in plain.items())
    else:
        first = 0 if any(0.0 in place for place in plain) else 1
        items = ((int(p[0]) - first, int(p[1]) - first, x) for p, x in plain.items())
    for i, j, x in items:
        if i not in held and j not in held and x:
            expected[i, j] = expected[j, i] = x
    rows = given.matrix.tocoo()
    read = {(int(i), int(j)): x for i, j, x in zip(*rows.coords, rows.data, strict=True)}
    kept = {place: x for place, x in read.items() if x and not held & {*place}}
    return n > 0 and kept == expected


KINDS = (
    *("Abaqus rows", "Abaqus rows, whole", "coordinates", "CalculiX", "substructure"),
    *("DMIG", "DMIG, free", "OUTPUT4 binary", "OUTPUT4 text", "ANSYS"),
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_or_read_as_what_they_say(tmp_path, kind):
    plain = whole(tmp_path / "K", kind)
    content = (tmp_path / "K").read_bytes()
    right = read_matrix(tmp_path, "K", "K")
    scale = np.sqrt(np.abs(right.matrix.diagonal()))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused = 0  # with the file
    for seed in range(40):
        changed = damaged(content, seed)
        (tmp_path / "K").write_bytes(changed)
        begin = time.process_time()
        try:
            given = read_matrix(tmp_path, "K", "K")
        except InputError as error:
            refused += str(error).startswith(str(tmp_path))
            continue
        finally:
            assert time.process_time() - begin < MOST_SECONDS
        assert np.isfinite(given.matrix.data).all()
        assert abs(given.matrix - given.matrix.T).max() == 0.0
        if changed == content:
            continue
        if plain is not None:
            assert entries_of(given, plain(changed)), seed
        elif given.matrix.shape == right.matrix.shape:
            # Both halves stand in the file, or the number itself was changed into another.
            difference = np.abs((given.matrix - right.matrix).toarray())
            places = np.count_nonzero(np.triu(difference > 1e-9 * np.outer(scale, scale)))
            assert places <= (1 if kind != "ANSYS" else 6), (seed, places)
        else:
            assert given.notes or kind == "Abaqus rows, whole", seed
    assert refused > 12
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_BYTES / 1024


@pytest.mark.slow
def test_damaged_names_of_unknowns_are_refused_or_read_as_what_they_say(tmp_path):
    content = (HERE / "lap.dof").read_bytes()
    for seed in range(100):
        changed = damaged(content, seed)
        (tmp_path / "names").write_bytes(changed)
        try:
            labels = read_labels(tmp_path / "names")
        except InputError:
            continue
        cells = re.findall(r"-?\w+", changed.decode())
        assert [str(x) for x in labels.ravel()] == [str(int(cell)) for cell in cells]
