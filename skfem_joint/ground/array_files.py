"""Arrays from .npz, MatrixMarket .mtx, MATLAB .mat and .csv files that may be damaged or hostile.

Before memory is taken for an array, the size that the file states is compared with the bytes that
it has. Indices of a sparse matrix are compared with its shape before compiled code uses them, which
would read and write anywhere. Nothing that can run code is loaded. Compiled libraries for other
formats follow what a file says, and a damaged one could end this process: they read in another.
"""

from __future__ import annotations

import io
import logging
import math
import re
import struct
import subprocess
import sys
import tempfile
import tokenize
import warnings
import zipfile
import zlib
from array import array
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import LARGEST, LARGEST_TABLE, UNFINISHED_LINE, read_whole
from skfem_joint.ground.processes import SAFE_PATH
from skfem_joint.ground.text_tables import rows_of

_log = logging.getLogger(__name__)


#: Bytes to which a compressed file may unpack, if the file itself has not more.
UNPACKED = 2**28
#: Rows or columns that a sparse matrix may state, if its file has fewer bytes.
ROWS = 10**6
#: Errors that readers of zip files, arrays and matrices raise for damaged and other files.
DAMAGE = (
    *(ValueError, TypeError, LookupError, AttributeError, OSError, EOFError, ArithmeticError),
    *(RuntimeError, MemoryError, SyntaxError, zipfile.BadZipFile, zlib.error, struct.error),
    tokenize.TokenError,  # by which numpy reports some headers
)


class _NotRealError(ValueError):
    """A whole file whose values are texts, truth values or complex numbers."""


class _Stored(NamedTuple):
    """Content of a file.

    Attributes
    ----------
    names : tuple of str
        Names of its arrays; empty if it holds a single matrix without a name.
    read : callable
        Reads the array of a name.
    size : int
        Bytes, unpacked.
    """

    names: tuple[str, ...]
    read: Callable[[str], Any]
    size: int


def read_array(folder: Path, name: str, ending: str | None = None) -> Any:
    """Array of doubles, sparse if it is stored so, from a .npz, .mtx, .mat or .csv file.

    Parameters
    ----------
    folder : Path
        Folder to which the name of the file is relative.
    name : str
        Name of the file; ``"model.mat:K"`` names a variable.
    ending : str, optional
        The ending of such files, where that of the name is another; it states the kind of a file.

    Returns
    -------
    ndarray or csr_array
        Doubles, whatever the precision of the file; indices of a sparse array are in range.

    Raises
    ------
    InputError
        If the file cannot be read, is of another kind, is damaged, or has no such variable, and if
        its values are not real numbers.
    """
    known = r"(.{2,}):(\w+)" if ending in (".mat", ".npz") else r"(.+\.(?:mat|npz)):(\w+)"
    named = re.fullmatch(known, name, re.IGNORECASE)
    file, variable = named.groups() if named else (name, None)
    path = folder / file
    kind = ending or path.suffix.lower()
    if kind not in _READERS:
        raise InputError(
            f"{path}: unknown ending {path.suffix!r}, must be one of {', '.join(_READERS)}"
        )
    content = read_whole(path, LARGEST_TABLE if kind == ".csv" else LARGEST)
    if kind == ".csv" and not content.endswith((b"\n", b"\r")):
        _log.warning("%s: %s", path, UNFINISHED_LINE)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # readers warn of damage, and go on
            for harmless in (DeprecationWarning, PendingDeprecationWarning, FutureWarning):
                warnings.simplefilter("ignore", harmless)
            stored = _READERS[kind](content)
            array = stored.read(chosen(stored.names, variable, path, file))
            return _doubles(array, stored.size)
    except _NotRealError as error:
        raise InputError(f"{path}: {error}") from error
    except (*DAMAGE, Warning) as error:
        later = content.startswith(b"MATLAB 7.3")
        cure = "; of version 7.3: save it with -v7" if later else ""
        reason = str(error) or type(error).__name__
        raise InputError(f"{path}: is damaged, or no such file: {reason}{cure}") from error


def chosen(names: tuple[str, ...], variable: str | None, path: Path, file: str) -> str:
    """Name of the array to be read; InputError if none or several of the file's names fit."""
    if not names and variable is not None:
        raise InputError(f"{path}: holds one sparse matrix without a name; leave ':{variable}' out")
    if not names or (variable is None and len(names) == 1):
        return names[0] if names else ""
    if variable not in names:
        shown = ", ".join(sorted(names)[:20]) + (" and more" if len(names) > 20 else "")
        what = "name one, as in" if variable is None else f"found no {variable!r}, as in"
        raise InputError(f"{path}: {what} '{file}:NAME'; it has {shown}")
    return variable


def _doubles(stored: Any, size: int) -> Any:
    """Array or sparse rows of doubles, from an array in a file of ``size`` bytes."""
    if not isinstance(stored, np.ndarray):
        if not sparse.issparse(stored):
            raise ValueError("it holds no array of numbers")
        _check_sparse(stored, size)
        rows = sparse.csr_array(stored)
        _check_numbers(rows.dtype)
        return rows.astype(float)
    _check_numbers(stored.dtype)
    return stored.astype(float)


def _check_sparse(A: Any, size: int) -> None:
    """Refuse a sparse matrix whose shape needs more than ``size`` bytes, or wrong indices."""
    if max(A.shape) > max(ROWS, size):
        raise ValueError(f"it says that its shape is {A.shape}, for which {size} bytes are too few")
    check_indices(A)


def _check_numbers(dtype: np.dtype[Any]) -> None:
    if dtype.kind not in "iuf":
        raise _NotRealError(f"found {dtype} values, must be real numbers")


def check_indices(A: Any) -> None:
    """Refuse a sparse matrix with indices outside its shape, by a ValueError.

    scipy checks the indices of single entries (COO) by itself, but not those of rows, columns,
    blocks and diagonals.
    """
    if A.format in ("csr", "csc", "bsr"):
        # scipy checks no further where the last of these is negative.
        if np.any(A.indptr[1:] < A.indptr[:-1]):
            raise ValueError("indptr must be a non-decreasing sequence")
        A.check_format(full_check=True)
    elif A.format == "dia":
        rows, columns = A.shape
        offsets = np.asarray(A.offsets, dtype=np.int64)
        if np.any((offsets <= -rows) | (offsets >= columns)) and offsets.size:
            raise ValueError(f"found a diagonal that a matrix of shape {A.shape} has not")


# .npz


def npz_arrays(file: BinaryIO) -> dict[str, NDArray[Any]]:
    """All arrays of an open .npz file, by name.

    Raises
    ------
    ValueError, zipfile.BadZipFile and others of `DAMAGE`
        If the file is damaged, needs more memory than its bytes, or would run code.
    """
    names, read, _ = _npz_members(file)
    return {name: read(name) for name in names}


def _npz_members(file: BinaryIO) -> _Stored:
    archive = zipfile.ZipFile(file)
    members = archive.infolist()
    by_name = {member.filename.removesuffix(".npy"): member for member in members}
    size = sum(member.file_size for member in members)
    most = max(UNPACKED, file.seek(0, io.SEEK_END))
    if size > most:
        raise ValueError(
            f"it unpacks to {size} bytes, must be at most {most}; save it without compression if "
            "that is meant"
        )
    return _Stored(tuple(by_name), lambda name: _npy(archive, by_name[name]), size)


def _npy(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """Array of a member of an .npz file, whose size must be that of its header."""
    with archive.open(member) as file:
        array: NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
        if more := file.read():  # to its end, where the checksum is compared
            raise ValueError(
                f"{member.filename} says that its shape is {array.shape} of {array.dtype}, and has "
                f"{len(more)} bytes more"
            )
    return array


def _npz(content: bytes) -> _Stored:
    members = _npz_members(io.BytesIO(content))
    if "format" not in members.names:
        return members
    return _Stored((), lambda _: _sparse(members.read), members.size)


def sparse_parts(A: Any) -> dict[str, NDArray[Any]]:
    """Arrays of a sparse matrix by the names that `scipy.sparse.save_npz` gives them.

    A matrix of a format without such names comes in compressed rows.
    """
    A = A if A.format in _PARTS else sparse.csr_array(A)
    parts = {name: getattr(A, name) for name in _PARTS[A.format]}
    return {"format": np.array(A.format), "shape": np.array(A.shape), "data": A.data, **parts}


def sparse_array(part: Callable[[str], NDArray[Any]], size: int) -> Any:
    """Sparse matrix from the arrays of `sparse_parts`, in a file of ``size`` bytes.

    Raises
    ------
    ValueError and others of `DAMAGE`
        If the arrays are damaged or make no matrix, if the shape needs more memory than the file
        has bytes, and if indices are outside the shape.
    """
    A = _sparse(part)
    _check_sparse(A, size)
    return A


def _sparse(part: Callable[[str], NDArray[Any]]) -> Any:
    """Sparse matrix from the arrays that `scipy.sparse.save_npz` writes."""
    form = part("format").item()
    form = form.decode("ascii") if isinstance(form, bytes) else str(form)
    if form not in _PARTS:
        raise ValueError(f"found sparse format {form!r}, must be one of {', '.join(_PARTS)}")
    data, shape = part("data"), part("shape")
    _check_numbers(data.dtype)
    indices = [part(name) for name in _PARTS[form]]
    if any(index.dtype.kind not in "iu" for index in (shape, *indices)) or shape.shape != (2,):
        raise ValueError("its shape and indices must be whole numbers")
    values = data.astype(float)  # scipy has no sparse matrices of half precision
    entries = (values, tuple(indices)) if form == "coo" else (values, *indices)
    make = getattr(sparse, f"{form}_array")
    return make(entries, shape=tuple(shape.tolist()))


_PARTS: Mapping[str, tuple[str, ...]] = {
    "csr": ("indices", "indptr"),
    "csc": ("indices", "indptr"),
    "bsr": ("indices", "indptr"),
    "coo": ("row", "col"),
    "dia": ("offsets",),
}


# The others


def _mtx(content: bytes) -> _Stored:
    from scipy.io import mminfo, mmread

    rows, columns, entries, _, field, _ = mminfo(io.BytesIO(content))
    if field not in ("real", "double", "integer", "unsigned-integer"):
        raise _NotRealError(f"found {field} values, must be real numbers")
    if max(entries, 0) > len(content):
        raise ValueError(
            f"it announces {entries} entries of {rows} rows and {columns} columns, for which "
            f"{len(content)} bytes are too few"
        )
    if not content.endswith(b"\n"):
        raise ValueError(UNFINISHED_LINE)
    # scipy passes over what follows a number, such as the decimals after a comma.
    if wrong := re.search(rb"^[^%\n]*,.*", content, re.MULTILINE):
        line, text = content.count(b"\n", 0, wrong.start()) + 1, wrong[0][:60].decode("latin-1")
        raise ValueError(f"line {line}: found {text!r}; decimals have a point, as in 0.5")
    return _Stored((), lambda _: mmread(io.BytesIO(content)), len(content))


def _mat(content: bytes) -> _Stored:
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    def read(name: str) -> Any:
        shape, kind = listed[name]
        if kind not in ("sparse", "double", "single") and not re.fullmatch(r"u?int\d+", kind):
            raise _NotRealError(f"found {kind} values in {name!r}, must be real numbers")
        if kind != "sparse" and math.prod(shape) > most:
            raise ValueError(
                f"{name!r} says that its shape is {shape}, for which {len(content)} bytes are too "
                "few; save it without compression if that is meant"
            )
        return loadmat(io.BytesIO(content), variable_names=[name])[name]

    most = max(UNPACKED // 8, len(content))
    try:
        variables = whosmat(io.BytesIO(content))
    except MatReadError as error:
        raise ValueError(str(error)) from error
    listed = {name: (shape, kind) for name, shape, kind in variables if not name.startswith("__")}
    if not listed:
        raise ValueError("it holds no variables")
    return _Stored(tuple(listed), read, len(content))


def _csv(content: bytes) -> _Stored:
    """Rows of numbers, NaN for empty cells; a header and comments after ``#`` are left out."""
    values, columns = array("d"), 0
    lines = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig")
    for number, _, cells in rows_of(lines):
        try:
            row = [float(cell) if cell else np.nan for cell in cells]
        except ValueError as error:
            if not values and not any(re.fullmatch(r"[\d.+-]+", cell) for cell in cells):
                continue
            raise ValueError(f"line {number}: {error}") from error
        if values and len(row) != columns:
            raise ValueError(f"line {number}: found {len(row)} columns, must be {columns}")
        columns = len(row)
        values.extend(row)
    table: FloatArray = np.frombuffer(values).reshape(-1, columns) if values else np.zeros(0)
    return _Stored((), lambda _: table, len(content))


_READERS: Mapping[str, Callable[[bytes], _Stored]] = {
    ".npz": _npz,
    ".mtx": _mtx,
    ".mat": _mat,
    ".csv": _csv,
}


# In a process of its own

#: Seconds for a file, and bytes beside it that the other process may take for each byte of it.
_SECONDS, _MEMORY, _PER_BYTE = 50, 2**31, 16
#: Status of the other process where its library is not installed.
_MISSING = 3
_SCRIPT = """
import sys
path, to, most = sys.argv[1], sys.argv[2], int(sys.argv[3])
try:
    import numpy as np
    {imports}
except ImportError:
    sys.exit(3)
try:
    import resource
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
except ImportError:
    pass
arrays = {{}}
{read}
np.savez(to, **arrays)
"""


def arrays_read_apart(path: Path, imports: str, read: str, library: str, cure: str) -> dict[
    str, np.ndarray
]:  # fmt: skip
    """Arrays that a few lines of Python put into the dictionary ``arrays``.

    Parameters
    ----------
    path : Path
        File, which the lines have as ``path``.
    imports, read : str
        A line that imports the library, and lines that read the file.
    library, cure : str
        Name of the library, and what to do where it is not installed.

    Raises
    ------
    ValueError
        If the library is not installed, ends with an error, or exceeds its limits.
    """
    with tempfile.TemporaryDirectory() as folder:
        to = Path(folder) / "arrays.npz"
        script = _SCRIPT.format(imports=imports, read=read)
        most = str(_MEMORY + _PER_BYTE * path.stat().st_size)
        command = [sys.executable, SAFE_PATH, "-c", script, str(path.resolve()), str(to), most]
        try:
            ended = subprocess.run(
                command, capture_output=True, text=True, timeout=_SECONDS, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"could not be read within {_SECONDS} s") from error
        if ended.returncode == _MISSING:
            raise ValueError(f"needs {library}: {cure}")
        if ended.returncode or not to.is_file():
            said = (ended.stderr.strip().splitlines() or ["its reader ended without a word"])[-1]
            raise ValueError(f"{library}: {said[:200]}")
        return npz_arrays(io.BytesIO(to.read_bytes()))
