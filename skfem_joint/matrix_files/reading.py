"""One matrix of a file, whose format is told by its content."""

from __future__ import annotations

import re
from pathlib import Path

from scipy import sparse

from skfem_joint.ground.array_files import DAMAGE, chosen, read_array
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import read_whole
from skfem_joint.matrix_files.abaqus import read_named_rows, read_substructure
from skfem_joint.matrix_files.ansys_full import is_full, read_full
from skfem_joint.matrix_files.dmig import DmigFile, is_dmig
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.op4 import Op4File, is_op4
from skfem_joint.matrix_files.triples import read_triples

#: Largest file of matrices, bytes: K and M of some ten million unknowns.
LARGEST_MATRICES = 2**33
#: Kinds of files by how they begin, with the endings that `read_array` knows them by.
_ARRAYS = {b"PK\x03\x04": ".npz", b"%%MatrixMarket": ".mtx", b"MATLAB": ".mat"}


def read_matrix(folder: Path, name: str, letter: str) -> GivenMatrix:
    """Matrix of a file, symmetric where the file's format does not say otherwise.

    Parameters
    ----------
    folder : Path
        Folder to which the name of the file is relative.
    name : str
        Name of the file; ``"model.op4:KAA"`` names a matrix in it.
    letter : str
        K, M or C: which matrix is meant, where the file holds several by their kind.

    Raises
    ------
    InputError
        If the file cannot be read, is of no known format or damaged, or holds no such matrix.
    """
    file, variable = name, None
    named = re.fullmatch(r"(.{2,}):(\w+)", name)
    if named and not (folder / name).is_file():
        file, variable = named.groups()
    path = folder / file
    content = read_whole(path, LARGEST_MATRICES)
    for begin, ending in _ARRAYS.items():
        if content[: len(begin)].lower() == begin.lower():
            return _of_array(folder, name, ending)
    if path.suffix.lower() in (".npz", ".mat", ".csv"):  # damaged, or of an old MATLAB
        return _of_array(folder, name, path.suffix.lower())
    try:
        return _of_program(path, file, variable, content, letter)
    except DAMAGE as error:
        raise InputError(f"{path}: {str(error) or type(error).__name__}") from error


def _of_array(folder: Path, name: str, ending: str) -> GivenMatrix:
    array = read_array(folder, name, ending)
    if array.ndim != 2:
        array = array.reshape(array.shape[0], -1) if array.size else array.reshape(0, 0)
    return GivenMatrix(sparse.csr_array(array), ending)


def _of_program(
    path: Path, file: str, variable: str | None, content: bytes, letter: str
) -> GivenMatrix:
    """Matrix of a file of another program."""
    if is_full(content):
        return read_full(path, content, letter)
    is_text = b"\0" not in content[:4096]
    if is_text and not content.endswith(b"\n"):
        raise ValueError("the last line does not end, so that the file may be cut")
    reader = Op4File if is_op4(content) else DmigFile if is_text and is_dmig(content) else None
    if reader is not None:
        several = reader(content)
        wanted = variable.upper() if variable else None
        return several.matrix(chosen(several.names, wanted, path, file))
    if not is_text:
        raise ValueError(f"is of no known format, or damaged; {_KNOWN}")
    if variable is not None:
        raise ValueError(f"holds one matrix without a name; leave ':{variable}' out")
    if re.search(rb"^[ \t]*\*(?:USER ELEMENT|MATRIX)\b", content[: 10**6], re.MULTILINE | re.I):
        return read_substructure(content, letter)
    row = re.search(rb"^[ \t]*[+\-.\d][^\n]*", content[: 10**6], re.MULTILINE)
    columns = len(row[0].replace(b",", b" ").split()) if row else 0
    if columns == 5:
        return read_named_rows(content, letter)
    if columns == 3:
        return read_triples(content, letter)
    raise ValueError(f"is of no known format, or damaged; {_KNOWN}")


_KNOWN = (
    "known are .npz of scipy.sparse, MatrixMarket, MATLAB, Abaqus (*MATRIX OUTPUT, FORMAT=MATRIX "
    "INPUT or COORDINATE; *SUBSTRUCTURE MATRIX OUTPUT, OUTPUT FILE=USER DEFINED), CalculiX (.sti, "
    ".mas), Nastran (OUTPUT4, DMIG) and ANSYS (.full)"
)
