"""Arrays from .npz, MatrixMarket .mtx, MATLAB .mat and .csv files that may be damaged or hostile.

What a file says of the sizes of its arrays is compared with the bytes that it has before memory is
taken for them. Indices of sparse matrices are compared with their shape before compiled code
follows them, which would read and write anywhere. Nothing that can run code is loaded.
"""

from __future__ import annotations

import io
import logging
import math
import re
import struct
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

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import InputError
from skfem_joint.files import LARGEST, LARGEST_TABLE, UNFINISHED_LINE, read_whole

_log = logging.getLogger(__name__)

#: Bytes to which a compressed file may unpack, if the file itself has not more.
MOST_UNPACKED = 2**28
#: Rows or columns that a sparse matrix may say it has, if its file has fewer bytes.
MOST_ROWS = 10**6
#: What readers of zip files, arrays and matrices raise for files that are damaged or of another
#: kind.
DAMAGE = (
    *(ValueError, TypeError, LookupError, AttributeError, OSError, EOFError, ArithmeticError),
    *(RuntimeError, MemoryError, SyntaxError, zipfile.BadZipFile, zlib.error, struct.error),
)
_WITH_VARIABLE = re.compile(r"(.+\.(?:mat|npz)):(\w+)", re.IGNORECASE)
_NUMBERS_OF_MATLAB = ("sparse", "double", "single", *(f"int{k}" for k in (8, 16, 32, 64)))
_NUMBERS_OF_MATLAB += tuple(f"uint{k}" for k in (8, 16, 32, 64))
_WHOLE_NUMBER = rb"[+-]?\d+"
_NUMBER = rb"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|(?i:nan|inf))"
_COMPRESSED = 15  # kind of an element of a MATLAB file
_HEADER = 128  # bytes of a MATLAB file


class _NotRealError(ValueError):
    """A whole file whose values are texts, truth values or complex numbers."""


class _Stored(NamedTuple):
    """What a file holds: the names of its arrays, and how to read one of them."""

    names: tuple[str, ...]  #: none: one matrix without a name
    read: Callable[[str], Any]
    size: int  #: bytes, unpacked


def read_array(folder: Path, name: str) -> Any:
    """Array of doubles, sparse if it is stored so, from a .npz, .mtx, .mat or .csv file.

    Parameters
    ----------
    folder : Path
        That the file's name is relative to.
    name : str
        Name of the file, whose ending tells its kind; ``"model.mat:K"`` names a variable.

    Returns
    -------
    ndarray or csr_array
        Of doubles, whatever precision the file has; indices of a sparse one are in range.

    Raises
    ------
    InputError
        A file that cannot be read or is none of these, is damaged, has no such variable, or values
        that are not real numbers.
    """
    file, variable = match.groups() if (match := _WITH_VARIABLE.fullmatch(name)) else (name, None)
    path = folder / file
    kind = path.suffix.lower()
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
            found = stored.read(_chosen(stored.names, variable, path, file))
            return _doubles(found, stored.size)
    except _NotRealError as error:
        raise InputError(f"{path}: {error}") from error
    except (*DAMAGE, Warning) as error:
        later = content[:_HEADER].startswith(b"MATLAB 7.3")
        cure = "; of version 7.3: save it with -v7" if later else ""
        reason = str(error) or type(error).__name__
        raise InputError(f"{path}: is damaged, or no such file: {reason}{cure}") from error


def _chosen(names: tuple[str, ...], variable: str | None, path: Path, file: str) -> str:
    """Name of the array to be read; InputError if the file has none or several that fit."""
    if not names and path.suffix.lower() in (".npz", ".mat") and variable is not None:
        raise InputError(f"{path}: holds one sparse matrix without a name; leave ':{variable}' out")
    if not names or (variable is None and len(names) == 1):
        return names[0] if names else ""
    if variable not in names:
        shown = ", ".join(sorted(names)[:20]) + (" and more" if len(names) > 20 else "")
        what = "name one, as in" if variable is None else f"found no {variable!r}, as in"
        raise InputError(f"{path}: {what} '{file}:NAME'; it has {shown}")
    return variable


def _doubles(found: Any, size: int) -> Any:
    """Array of doubles, or sparse rows of them, from what a file of so many bytes holds."""
    if not isinstance(found, np.ndarray):
        if not sparse.issparse(found):
            raise ValueError("it holds no array of numbers")
        _check_sparse(found, size)
        rows = sparse.csr_array(found)
        _check_numbers(rows.dtype)
        return rows.astype(float)
    _check_numbers(found.dtype)
    return found.astype(float)


def _check_sparse(A: Any, size: int) -> None:
    """Refuse a sparse matrix whose shape needs more than ``size`` bytes, or indices out of it."""
    if max(A.shape) > max(MOST_ROWS, size):
        raise ValueError(f"it says that its shape is {A.shape}, for which {size} bytes are too few")
    check_indices(A)


def _check_numbers(dtype: np.dtype[Any]) -> None:
    if dtype.kind not in "iuf":
        raise _NotRealError(f"found {dtype} values, must be real numbers")


def check_indices(A: Any) -> None:
    """Refuse a sparse matrix whose indices are not in its shape; ValueError.

    scipy does so by itself for single entries (COO), but follows those of rows, columns, blocks and
    diagonals.
    """
    if A.format in ("csr", "csc", "bsr"):
        # scipy does not look further where the last of these is negative.
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
        For what is damaged, needs more memory than it has bytes, or would run code.
    """
    names, read, _ = _npz_members(file)
    return {name: read(name) for name in names}


def _npz_members(file: BinaryIO) -> _Stored:
    archive = zipfile.ZipFile(file)
    members = archive.infolist()
    by_name = {member.filename.removesuffix(".npy"): member for member in members}
    if len(by_name) < len(members):
        raise ValueError("two of its arrays have the same name")
    size = sum(member.file_size for member in members)
    _check_unpacked(size, file.seek(0, io.SEEK_END))
    return _Stored(tuple(by_name), lambda name: _npy(archive, by_name[name]), size)


def _check_unpacked(size: int, packed: int) -> None:
    most = max(MOST_UNPACKED, packed)
    if size > most:
        raise ValueError(
            f"it unpacks to {size} bytes, must be at most {most}; save it without compression if "
            "that is meant"
        )


def _npy(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    """One array of an .npz file, whose size must be what its header says."""
    name = member.filename
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{name} is packed in a way that numpy does not write")
    headers = {(1, 0): np.lib.format.read_array_header_1_0}
    headers[2, 0] = np.lib.format.read_array_header_2_0
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        if version not in headers:
            raise ValueError(f"{name} has version {version} of numpy's format, must be 1.0 or 2.0")
        shape, by_columns, dtype = headers[version](file)
        if dtype.hasobject:
            raise ValueError(f"{name} holds Python objects, which are not loaded, must be numbers")
        wanted, held = math.prod(shape) * dtype.itemsize, member.file_size - file.tell()
        if wanted != held or min(shape, default=0) < 0:
            raise ValueError(
                f"{name} says that its shape is {shape} of {dtype}, {wanted} bytes, and has {held}"
            )
        data = file.read(held)
        # The checksum is compared where the last byte is read.
        if len(data) != held or file.read(1):
            raise ValueError(f"{name} is cut")
    return np.ndarray(shape, dtype, data, order="F" if by_columns else "C").copy(order="K")


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
    """Sparse matrix from the arrays of `sparse_parts`, in a file of so many bytes.

    Raises
    ------
    ValueError and others of `DAMAGE`
        For what is damaged, no matrix, needs more memory than the bytes tell, or has indices that
        are not in its shape.
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

    rows, columns, entries, form, field, _ = mminfo(io.BytesIO(content))
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
    places = rb"\d+[ \t]+\d+[ \t]+" if form == "coordinate" else b""
    number = _WHOLE_NUMBER if "integer" in field else _NUMBER
    right = rb"[ \t]*(?:" + places + number + rb"[ \t]*)?\r?$|%"
    sizes = re.search(rb"^[ \t]*\d[\d \t\r]*\n", content, re.M)
    start = sizes.end() if sizes else 0
    if wrong := re.compile(rb"^(?!" + right + rb").*", re.M).search(content, start):
        line = content.count(b"\n", 0, wrong.start()) + 1
        if wrong.start() < len(content):  # what follows the last line end is no line
            text = wrong[0][:60].decode(errors="replace")
            raise ValueError(f"line {line}: found {text!r}, must be an entry of {field} numbers")
    return _Stored((), lambda _: mmread(io.BytesIO(content)), len(content))


def _mat(content: bytes) -> _Stored:
    from scipy.io import loadmat, whosmat
    from scipy.io.matlab import MatReadError

    def read(name: str) -> Any:
        shape, kind = listed[name]
        if kind not in _NUMBERS_OF_MATLAB:
            raise _NotRealError(f"found {kind} values in {name!r}, must be real numbers")
        if kind != "sparse" and math.prod(shape) > len(whole):
            raise ValueError(
                f"{name!r} says that its shape is {shape}, for which {len(whole)} bytes are too few"
            )
        try:
            return loadmat(io.BytesIO(whole), variable_names=[name])[name]
        except MatReadError as error:
            raise ValueError(str(error)) from error

    whole = _unpacked(content)
    try:
        found = whosmat(io.BytesIO(whole))
    except MatReadError as error:
        raise ValueError(str(error)) from error
    listed = {name: (shape, kind) for name, shape, kind in found if not name.startswith("__")}
    if len({name for name, _, _ in found}) < len(found):
        raise ValueError("two of its variables have the same name")
    if not listed:
        raise ValueError("it holds no variables")
    return _Stored(tuple(listed), read, len(whole))


def _unpacked(content: bytes) -> bytes:
    """A MATLAB file of version 5 whose compressed variables are unpacked; others as they are."""
    order = {b"IM": "<", b"MI": ">"}.get(content[126:_HEADER])
    if order is None or 0 in content[:4]:  # of version 4, which has no compression
        return content
    parts, at, size = [content[:_HEADER]], _HEADER, _HEADER
    while at < len(content):
        kind, length = struct.unpack_from(f"{order}II", content, at)
        end = at + 8 + length
        if end > len(content):
            raise ValueError("it is cut: a variable announces more bytes than there are")
        if kind == _COMPRESSED:
            unpacker, most = zlib.decompressobj(), max(MOST_UNPACKED, len(content)) - size
            part = unpacker.decompress(content[at + 8 : end], most + 1)
            _check_unpacked(size + len(part), len(content))
            if not unpacker.eof:
                raise ValueError("it is cut: a compressed variable has no end")
        else:
            part = content[at:end]
        parts.append(part)
        at, size = end, size + len(part)
    return b"".join(parts)


def _csv(content: bytes) -> _Stored:
    """Rows of numbers, NaN for nothing; a header and what follows a ``#`` are passed over."""
    values, columns = array("d"), 0
    lines = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig")
    for number, line in enumerate(lines, start=1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        cells = text.split(",")
        try:
            row = [float(cell) if cell.strip() else np.nan for cell in cells]
        except ValueError as error:
            if not values and not re.search(r"(^|,)\s*[\d.+-]+\s*(,|$)", text):
                continue
            raise ValueError(f"line {number}: {error}") from error
        if values and len(row) != columns:
            raise ValueError(f"line {number}: found {len(row)} columns, must be {columns}")
        columns = len(row)
        values.extend(row)
    found: FloatArray = np.frombuffer(values).reshape(-1, columns) if values else np.zeros(0)
    return _Stored((), lambda _: found, len(content))


_READERS: Mapping[str, Callable[[bytes], _Stored]] = {
    ".npz": _npz,
    ".mtx": _mtx,
    ".mat": _mat,
    ".csv": _csv,
}
