"""Damaged and hostile files of matrices are refused in a sentence; nothing else ends a command."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.io import mmwrite, savemat

from skfem_joint.ground.array_files import ROWS, UNPACKED, read_array
from skfem_joint.ground.arrays import as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import LARGEST_TABLE

N = 12
K = sparse.csr_array(2.0 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
FORMS = ["csr", "csc", "bsr", "coo", "dia"]
Change = Callable[[np.ndarray], None]


def refused(folder: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_array(folder, name)
    assert str(caught.value).startswith(str(folder / name.split(":")[0]))


def stored(folder: Path, form: str, **changed: Any) -> str:
    """A sparse matrix in a file, some of whose arrays are others."""
    sparse.save_npz(folder / "K.npz", K.asformat(form))
    with np.load(folder / "K.npz") as arrays:
        parts = dict(arrays) | changed
    np.savez(folder / "K.npz", **parts)
    return "K.npz"


@pytest.mark.parametrize("form", FORMS)
def test_every_sparse_format_is_read_as_it_was_stored(tmp_path, form):
    array = read_array(tmp_path, stored(tmp_path, form))
    assert (array != K).nnz == 0
    assert array.dtype == np.float64


def set_(place: int, value: int) -> Change:
    def change(indices: np.ndarray) -> None:
        indices[place] = value

    return change


def down(indices: np.ndarray) -> None:
    indices[2:4] = indices[3:1:-1]


@pytest.mark.parametrize(
    ("form", "part", "change"),
    [
        (form, "indices", set_(3, value))
        for form in ("csr", "csc", "bsr")
        for value in (N, 10**9, -1, -(10**9))
    ]
    + [
        (form, "indptr", change)
        for form in ("csr", "csc")
        for change in (set_(4, 2**30), set_(4, -5), set_(0, 3), set_(-1, 2**30), set_(-1, -1), down)
    ]
    + [("coo", part, set_(3, value)) for part in ("row", "col") for value in (N, -1, 2**30)]
    + [("dia", "offsets", set_(1, value)) for value in (N, -N, 2**30, -(2**31))],
)
def test_an_index_out_of_range_is_refused_before_it_is_followed(tmp_path, form, part, change):
    stored(tmp_path, form)
    with np.load(tmp_path / "K.npz") as arrays:
        indices = arrays[part].copy()
    change(indices)
    refused(tmp_path, stored(tmp_path, form, **{part: indices}), "is damaged, or no such file")


@pytest.mark.parametrize("form", ["csr", "coo"])
@pytest.mark.parametrize("kind", [float, complex, np.bool_])
def test_indices_that_are_no_whole_numbers_are_refused(tmp_path, form, kind):
    part = "indices" if form == "csr" else "row"
    stored(tmp_path, form)
    with np.load(tmp_path / "K.npz") as arrays:
        indices = arrays[part].astype(kind)
    refused(tmp_path, stored(tmp_path, form, **{part: indices}), "must be whole numbers")


@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize("index", [N, 2**30, -1, -(2**31)])
def test_an_overwritten_row_index_of_matlab_is_refused(tmp_path, packed, index):
    content = io.BytesIO()
    savemat(content, {"K": sparse.csc_matrix(K)})
    data, indices = content.getvalue(), sparse.csc_array(K).indices.astype("<i4").tobytes()
    at = data.index(indices) + 8
    data = data[:at] + struct.pack("<i", index) + data[at + 4 :]
    if packed:
        part = zlib.compress(data[128:])
        data = data[:128] + struct.pack("<II", 15, len(part)) + part
    (tmp_path / "K.mat").write_bytes(data)
    refused(tmp_path, "K.mat", "is damaged, or no such file: (indices must be|.*axis 0 index)")


def header(shape: str, kind: str = "<f8") -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def archived(path: Path, data: bytes, how: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", how, compresslevel=1) as archive:
        archive.writestr("K.npy", data)


@pytest.mark.parametrize(
    "shape", ["(1000000000000, 1000000000000)", "(100000, 100000)", "(3,)", "(-2, -1)", "()"]
)
def test_a_size_that_is_not_that_of_the_bytes_is_refused(tmp_path, shape):
    archived(tmp_path / "K.npz", header(shape) + 4 * 8 * b"\0")
    refused(tmp_path, "K.npz", "is damaged, or no such file: ")


HUGE = [(10**12, 10**12), (10 * ROWS, 10 * ROWS)]


@pytest.mark.parametrize("shape", HUGE)
def test_sparse_matrices_that_say_they_are_huge_are_refused(tmp_path, shape):
    entry = sparse.coo_array(([1.0], ([0], [0])), shape=shape)
    sparse.save_npz(tmp_path / "K.npz", entry)
    refused(tmp_path, "K.npz", r"says that its shape is .* bytes are too few")
    mmwrite(tmp_path / "K.mtx", entry)
    refused(tmp_path, "K.mtx", r"says that its shape is .* bytes are too few")


COORDINATES = "coordinate real general\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (COORDINATES + "% 1,5\n2 2 2\n2 2 1\n1 1 2,5\n", "line 5: found '1 1 2,5'; decimals have"),
        (COORDINATES + "3 3 1000000000000\n1 1 1.0\n", r"announces \d+ entries .* bytes are too"),
        ("array real general\n1000000 1000000\n1.0\n", r"announces \d+ entries .* bytes are too"),
        ("array real symmetric\n1000000 1000000\n1.0\n", r"announces \d+ entries .* bytes are"),
    ],
)
def test_matrixmarket_with_decimal_commas_or_more_than_it_holds_is_refused(tmp_path, text, message):
    (tmp_path / "K.mtx").write_text(f"%%MatrixMarket matrix {text}")
    refused(tmp_path, "K.mtx", message)


def test_sizes_of_matlab_that_the_file_cannot_hold_are_refused(tmp_path):
    content = io.BytesIO()
    savemat(content, {"K": np.ones((7, 9))})
    data = content.getvalue()
    at = data.index(struct.pack("<ii", 7, 9))
    huge = data[:at] + struct.pack("<ii", 2**30, 2**30) + data[at + 8 :]
    (tmp_path / "K.mat").write_bytes(huge)
    refused(tmp_path, "K.mat", "says that its shape is .* bytes are too few")


def test_files_that_unpack_to_far_more_are_refused(tmp_path):
    """A dense matrix of zeros takes a thousandth of its size as a file."""
    zeros = header(f"({UNPACKED // 8},)") + bytes(UNPACKED)
    archived(tmp_path / "K.npz", zeros, zipfile.ZIP_DEFLATED)
    assert (tmp_path / "K.npz").stat().st_size < UNPACKED // 200
    refused(tmp_path, "K.npz", "it unpacks to .* bytes, must be at most")
    content = io.BytesIO()
    savemat(content, {"K": np.zeros((2, 2))})
    part = zlib.compress(content.getvalue()[128:] + bytes(UNPACKED), level=1)
    data = content.getvalue()[:128] + struct.pack("<II", 15, len(part)) + part
    (tmp_path / "K.mat").write_bytes(data)
    refused(tmp_path, "K.mat", "Did not fully consume compressed contents")
    savemat(tmp_path / "K.mat", {"K": np.zeros((UNPACKED // 8 + 1, 1))}, do_compression=True)
    refused(tmp_path, "K.mat", "says that its shape is .* bytes are too few")


@pytest.mark.parametrize("name", ["K.npz", "K.mtx", "K.mat", "K.csv"])
def test_a_cut_file_is_refused_or_reported(tmp_path, name, caplog):
    """What is left of a table that is cut at the end of a row is another table."""
    path, whole = tmp_path / name, K.toarray()
    if name == "K.npz":
        sparse.save_npz(path, K)
    elif name == "K.mtx":
        mmwrite(path, K)
    elif name == "K.mat":
        savemat(path, {"K": K.tocsc()}, do_compression=True)
    else:
        np.savetxt(path, whole, delimiter=",", fmt="%g")
    content = path.read_bytes()
    assert np.array_equal(as_dense(read_array(tmp_path, name)), whole)
    assert not caplog.messages
    for at in range(len(content)):
        path.write_bytes(content[:at])
        caplog.clear()
        try:
            array = read_array(tmp_path, name)
        except InputError:
            continue
        assert name == "K.csv"
        assert caplog.messages or content[at - 1 : at] == b"\n" or array.size == 0
    assert at > 100


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.eye(2) * 1j, "complex128 values, must be real numbers"),
        (np.eye(2) > 0.0, "bool values, must be real numbers"),
        (np.array(["a"]), "<U1 values, must be real numbers"),
        (np.zeros(2, dtype="m8[s]"), "must be real numbers"),
        (np.zeros(2, dtype=[("a", "f8")]), "must be real numbers"),
        (np.array([{}], dtype=object), "Object arrays cannot be loaded"),
    ],
)
def test_what_is_no_real_number_is_refused(tmp_path, values, message):
    np.savez(tmp_path / "K.npz", K=values)
    refused(tmp_path, "K.npz", message)


@pytest.mark.parametrize("form", ["npz", "mtx", "mat"])
def test_complex_matrices_in_files_are_refused(tmp_path, form):
    path = tmp_path / f"K.{form}"
    for A in (K * 1j, K.toarray() * 1j):
        if form == "mtx":
            mmwrite(path, A)
        elif form == "mat":
            savemat(path, {"K": A})
        elif sparse.issparse(A):
            sparse.save_npz(path, A)
        else:
            np.savez(path, K=A)
        refused(tmp_path, path.name, "complex.* values, must be real|complex128")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("text", "found char values"),
        (np.array([[True]]), "found logical values"),
        ({"a": 1.0}, "found struct values"),
        (np.array([np.eye(2), "a"], dtype=object), "found cell values"),
    ],
)
def test_variables_of_matlab_that_are_no_numbers_are_refused(tmp_path, values, message):
    savemat(tmp_path / "K.mat", {"K": values})
    refused(tmp_path, "K.mat:K", message)


def test_half_precision_is_read_as_doubles(tmp_path):
    whole = K.toarray().astype(np.float16)
    np.savez(tmp_path / "K.npz", K=whole)
    array = read_array(tmp_path, "K.npz")
    assert array.dtype == np.float64
    assert np.array_equal(array, K.toarray())
    array = read_array(tmp_path, stored(tmp_path, "csr", data=K.data.astype(np.float16)))
    assert (array != K).nnz == 0


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_tables_of_text_have_one_kind_of_separator(tmp_path, separator):
    """Empty cells are nan, at the ends of lines too."""
    text = "x, y, area\n,1,2 # first\n\n3,4,\n"
    (tmp_path / "K.csv").write_text(text.replace(",", separator))
    expected = np.array([[np.nan, 1.0, 2.0], [3.0, 4.0, np.nan]])
    assert np.array_equal(read_array(tmp_path, "K.csv"), expected, equal_nan=True)
    (tmp_path / "K.csv").write_text("0,5;1\n")
    refused(tmp_path, "K.csv", "line 1: found ',' and ';' between columns, must be one of them")


def test_large_tables_are_refused_by_their_size(tmp_path):
    (tmp_path / "K.csv").write_bytes(b"1\n" * (LARGEST_TABLE // 2 + 1))
    refused(tmp_path, "K.csv", "must be at most")
