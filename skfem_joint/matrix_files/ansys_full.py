"""ANSYS ``.full`` files, read by ansys-mapdl-reader in a process of its own."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from scipy import sparse

from skfem_joint.ground.array_files import arrays_read_apart
from skfem_joint.ground.errors import first_of
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import DIRECTIONS, label_text, repeated_labels
from skfem_joint.matrix_files.symmetry import symmetric

_FORM = "a .full file of ANSYS"
_READ = """
full = FullFile(path)
labels, k, m = full.load_km(sort=True)
arrays |= {"labels": labels, "const": full.const}
for name, A in (("K", k), ("M", m)):
    if A is not None:
        A = A.tocoo()
        arrays |= {name + "row": A.row, name + "column": A.col, name + "value": A.data}
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
    arrays = arrays_read_apart(
        path,
        "from ansys.mapdl.reader.full import FullFile",
        _READ,
        "ansys-mapdl-reader",
        "pip install 'skfem-joint[ansys]'; or let ANSYS write MatrixMarket files, by *SMAT and "
        "*EXPORT",
    )
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
