"""Time and memory for K and M of a million unknowns in one OUTPUT4 file of Nastran.

    python examples/benchmarks/op4_reading.py [--unknowns 1000000]

The file has three unknowns a node, each coupled with those of eleven nodes: 33 entries a row, in
strings of three rows ("BIGMAT"). It is written to a temporary folder, 740 MB for a million
unknowns, and read into sparse matrices. Seconds are those of one processor.
"""

import argparse
import resource
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import numpy as np

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


def measured(unknowns):
    """Entries of K, seconds to read K and M, and GiB that the process took at most."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "large.op4"
        n = write(path, unknowns)
        size = path.stat().st_size
        begin = time.process_time()
        K, M = (
            read_matrix(path.parent, f"{path.name}:{name}", letter).matrix
            for name, letter in zip(NAMES, "KM", strict=True)
        )
        seconds = time.process_time() - begin
    assert K.shape == M.shape == (n, n)
    assert K.nnz == M.nnz
    return K, size, seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--unknowns", type=int, default=1_000_000)
    K, size, seconds, memory = measured(parser.parse_args(arguments).unknowns)
    print(
        f"{K.shape[0]} unknowns, {K.nnz / K.shape[0]:.1f} entries a row, {size / 1e6:.0f} MB: "
        f"K and M read in {seconds:.1f} s, {memory:.2f} GiB"
    )


if __name__ == "__main__":
    main()
