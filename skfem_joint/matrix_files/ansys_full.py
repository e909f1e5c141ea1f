"""ANSYS ``.full`` files, read by ansys-mapdl-reader in a process of its own.

Its compiled part follows what the file says, and a damaged file could end this process. The other
one has a limit of time and of memory, and hands arrays over in a file.
"""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy import sparse

from skfem_joint.ground.array_files import npz_arrays
from skfem_joint.ground.errors import first_of
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import DIRECTIONS, label_text, repeated_labels
from skfem_joint.matrix_files.symmetry import symmetric

_FORM = "a .full file of ANSYS"
#: Seconds for a file, and bytes beside it that the other process may take for each byte of it.
_SECONDS, _MEMORY, _PER_BYTE = 50, 2**31, 16
#: Status of the other process where its reader is not installed.
_MISSING = 3
_READ = """
import sys
try:
    import numpy as np
    from ansys.mapdl.reader.full import FullFile
except ImportError:
    sys.exit(3)
path, to, most = sys.argv[1], sys.argv[2], int(sys.argv[3])
try:
    import resource
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
except ImportError:
    pass
full = FullFile(path)
labels, k, m = full.load_km(sort=True)
arrays = {"labels": labels, "const": full.const}
for name, A in (("K", k), ("M", m)):
    if A is not None:
        A = A.tocoo()
        arrays |= {name + "row": A.row, name + "column": A.col, name + "value": A.data}
np.savez(to, **arrays)
"""


def is_full(content: bytes) -> bool:
    """Whether a file begins as a ``.full`` file: a record of 100 words, and the number 4."""
    return len(content) > 800 and struct.unpack("<iii", content[:12])[::2] == (100, 4)


def read_full(path: Path, content: bytes, letter: str) -> GivenMatrix:
    """Stiffness or mass of a ``.full`` file, by one half there.

    ValueError if it is damaged, and if ansys-mapdl-reader is not installed.
    """
    if letter == "C":
        raise ValueError("holds no damping matrix that can be read; leave C out, or give a ratio")
    with tempfile.TemporaryDirectory() as folder:
        to = Path(folder) / "arrays.npz"
        most = str(_MEMORY + _PER_BYTE * len(content))
        command = [sys.executable, "-c", _READ, str(path.resolve()), str(to), most]
        try:
            ended = subprocess.run(
                command, capture_output=True, text=True, timeout=_SECONDS, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"could not be read within {_SECONDS} s") from error
        if ended.returncode == _MISSING:
            raise ValueError(
                "needs ansys-mapdl-reader: pip install 'skfem-joint[ansys]'; or let ANSYS write "
                "MatrixMarket files, by *SMAT and *EXPORT"
            )
        if ended.returncode or not to.is_file():
            said = (ended.stderr.strip().splitlines() or ["its reader ended without a word"])[-1]
            raise ValueError(f"ansys-mapdl-reader: {said[:200]}")
        arrays = npz_arrays(io.BytesIO(to.read_bytes()))
    return _matrix(arrays, letter)


def _matrix(arrays: dict[str, np.ndarray], letter: str) -> GivenMatrix:
    """Matrix from what the reader found, without unknowns that ANSYS holds."""
    labels = arrays["labels"].reshape(-1, 2).astype(np.intp)
    labels[:, 1] += 1  # the reader counts directions from 0
    n = len(labels)
    if labels.min(initial=1) < 1 or labels[:, 1].max(initial=1) >= len(DIRECTIONS):
        raise ValueError("has other degrees of freedom than displacements and rotations")
    if problem := repeated_labels(labels):
        raise ValueError(problem)
    if f"{letter}row" not in arrays:
        cure = "; write the file in a modal analysis" if letter == "M" else ""
        raise ValueError(f"holds no {'stiffness' if letter == 'K' else 'mass'} matrix{cure}")
    row, column = arrays[f"{letter}row"], arrays[f"{letter}column"]
    value = arrays[f"{letter}value"].astype(float)
    if min(row.min(initial=0), column.min(initial=0)) < 0 or not np.isfinite(value).all():
        raise ValueError("holds indices that are out of range, or values that are not finite")
    if max(row.max(initial=0), column.max(initial=0)) >= n:
        raise ValueError("holds indices that are out of range")
    A = sparse.csr_array(sparse.coo_array((value, (row, column)), shape=(n, n)))
    held = np.unique(arrays["const"].reshape(-1, 2).astype(np.intp), axis=0)
    held[:, 1] += 1
    is_held = np.isin(labels @ [8, 1], held @ [8, 1])
    kept = np.flatnonzero(~is_held)
    A = sparse.csr_array(A[kept][:, kept])
    labels = labels[kept]
    empty = np.flatnonzero(A.diagonal() == 0.0)
    if empty.size and letter == "K":
        names = first_of([label_text(label) for label in labels[empty]])
        raise ValueError(f"K has zeros on its diagonal: {names}; the file may be damaged")
    notes: tuple[str, ...] = ()
    if held.size:
        names = first_of([label_text(label) for label in held])
        notes = (f"{len(held)} unknowns that ANSYS holds are left out: {names}.",)
    return GivenMatrix(symmetric(A, lambda k: label_text(labels[k])), _FORM, labels, notes=notes)
