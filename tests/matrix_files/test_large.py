"""A million unknowns in OUTPUT4 are read within 60 s of one processor and 8 GiB."""

import subprocess
import sys

import numpy as np
import pytest

from skfem_joint.matrix_files.reading import read_matrix

#: Nodes that a node is coupled with, by the difference of their numbers.
COUPLED = np.array([-6000, -600, -60, -3, -1, 0, 1, 3, 60, 600, 6000])
NAMES = ("KAA", "MAA")


def records(nodes, n, scale):
    """Records of the columns of nodes that are coupled with the same number of others."""
    rows = nodes[:, np.newaxis] + COUPLED
    there = (rows >= 0) & (rows < n)
    count = int(there[0].sum())
    rows = np.repeat(rows[there].reshape(-1, 1, count), 3, axis=1)
    words = 8 * count
    record = np.empty((len(nodes), 3, 5 + words), "<i4")
    record[..., [0, -1]] = 4 * (3 + words)
    record[..., 1] = 3 * nodes[:, np.newaxis] + np.arange(3) + 1
    record[..., 2], record[..., 3] = 0, words
    strings = record[..., 4:-1].reshape(len(nodes), 3, count, 8)
    strings[..., 0], strings[..., 1] = 7, 3 * rows + 1
    apart = np.abs(rows - nodes[:, np.newaxis, np.newaxis])[..., np.newaxis]
    own = np.where(np.eye(3, dtype=bool)[:, np.newaxis], 30.0, 0.5)
    values = np.where(apart == 0, own, -scale / (2.0 + apart))
    strings[..., 2:] = np.ascontiguousarray(values).view("<i4")
    record[..., 4:-1] = strings.reshape(len(nodes), 3, words)
    return record.tobytes()


def write(path, unknowns):
    """Write K and M; returns the number of their unknowns, a multiple of three."""
    n = unknowns // 3
    whole = np.array([24, 3 * n, -3 * n, 6, 2], "<i4").tobytes()
    last = np.array([20, 3 * n + 1, 1, 2], "<i4").tobytes() + np.sqrt(np.array([2.0])).tobytes()
    nodes = np.arange(n)
    rows = nodes[:, np.newaxis] + COUPLED
    counts = np.sum((rows >= 0) & (rows < n), axis=1)
    ends = np.flatnonzero(np.diff(counts)) + 1
    with path.open("wb") as file:
        for name, scale in zip(NAMES, (1.0, 0.01), strict=True):
            file.write(whole + f"{name:8}".encode() + whole[:4])
            for group in np.split(nodes, ends):
                for part in np.array_split(group, len(group) // 20000 + 1):
                    file.write(records(part, n, scale))
            file.write(last + last[:4])
    return 3 * n


def test_a_large_file_of_strings_holds_what_it_says(tmp_path):
    """Three unknowns a node, each coupled with those of eleven nodes: 33 entries a row."""
    write(tmp_path / "large.op4", 3 * 50)
    K = read_matrix(tmp_path, "large.op4:KAA", "K").matrix
    node = np.arange(50)
    apart = np.abs(node[:, np.newaxis] - node)
    coupled = np.isin(apart, np.abs(COUPLED))
    blocks = np.where(coupled & (apart > 0), -1.0 / (2.0 + apart), 0.0)
    expected = np.kron(blocks, np.ones((3, 3))) + np.kron(np.eye(50), 29.5 * np.eye(3) + 0.5)
    assert K.toarray() == pytest.approx(expected, rel=1e-15)


READ = """
import resource, sys, time
from pathlib import Path
from skfem_joint.matrix_files.reading import read_matrix
begin = time.process_time()
K, M = (read_matrix(Path(sys.argv[1]), f"large.op4:{letter}AA", letter).matrix for letter in "KM")
assert K.nnz == M.nnz
print(K.shape[0], K.nnz, time.process_time() - begin,
      resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
"""


@pytest.mark.slow
def test_a_million_unknowns_take_less_than_a_minute_and_8_gib(tmp_path):
    unknowns = write(tmp_path / "large.op4", 1_000_000)
    run = [sys.executable, "-c", READ, str(tmp_path)]
    said = subprocess.run(run, capture_output=True, text=True, check=True).stdout
    n, entries, seconds, gib = map(float, said.split())
    assert (n, round(entries / n, 1)) == (unknowns, 32.9)
    assert seconds < 60.0
    assert gib < 8.0
