"""Nastran's OUTPUT4 files, binary and text, with dense and sparse columns.

A matrix is a header (columns, rows, form, type, name) and a record for each column that is not
zero, with the column, its first row and its number of words. First row 0 means strings of
consecutive rows: each has its length and first row in two words where there are more than 65,535
rows or the header's rows are negative ("BIGMAT"), else both in one word. A last record has one
column more than the matrix. (MSC Nastran DMAP Programmer's Guide, "OUTPUT4"; MSC Nastran Utilities
Guide, "OUTPUT4"). Whole numbers have 32 or 64 bits, in either byte order.

The loops here compare all lengths and places in a file before they follow them. K and M of a
million unknowns with 33 entries in a row, 740 MB, take 3 s of one processor and 2 GiB. pyYeti,
which reads such files too (29 s, 3.8 GiB), takes lengths as the file says them: of a hundred
damaged binary files it read 13 of a diagonal matrix with eight to 57 wrong entries of 72, and 5 of
half a matrix with more than 500, without a word.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import IntArray
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.symmetry import symmetric

#: Rows from which on strings have two words of their own.
_LARGE = 65536
_FORM = "OUTPUT4 of Nastran"
#: Forms of matrices that are read.
_SQUARE, _SYMMETRIC = 1, 6


@dataclass(frozen=True)
class _Header:
    name: str
    columns: int
    rows: int
    form: int
    kind: int

    def check(self, size: int) -> None:
        """Refuse sizes that a file of ``size`` bytes cannot hold, and complex values."""
        if not 0 < self.columns <= size or abs(self.rows) > size:
            raise ValueError(
                f"says that {self.name or 'a matrix'} has {self.rows} rows and {self.columns} "
                f"columns, for which {size} bytes are too few"
            )
        if self.kind not in (1, 2, 3, 4):
            raise ValueError(f"{self.name}: found type {self.kind}, must be 1 to 4")

    def check_wanted(self) -> None:
        """Refuse a matrix that no stiffness, mass or damping can be."""
        if self.kind in (3, 4):
            raise ValueError(f"{self.name}: found complex values, must be real numbers")
        if abs(self.rows) != self.columns or self.form not in (_SQUARE, _SYMMETRIC):
            raise ValueError(
                f"{self.name}: found {abs(self.rows)} rows, {self.columns} columns and form "
                f"{self.form}, must be square or symmetric (form 1 or 6)"
            )


class Op4File:
    """A file of OUTPUT4: its names, and the matrix of a name.

    Parameters
    ----------
    content : bytes

    Raises
    ------
    ValueError
        If the file is damaged.
    """

    def __init__(self, content: bytes) -> None:
        self._binary = _is_binary(content)
        matrices = _Binary(content) if self._binary else _Text(content)
        self._matrices: _Binary | _Text = matrices
        self._at: dict[str, tuple[_Header, Any]] = {}
        for header, place in matrices.headers():
            name = header.name.upper()
            if name in self._at:
                raise ValueError(f"holds two matrices of the name {name!r}, must be one")
            self._at[name] = (header, place)
        if not self._at:
            raise ValueError("holds no matrix")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the matrices, in capitals."""
        return tuple(self._at)

    def matrix(self, name: str) -> GivenMatrix:
        """Symmetric matrix of a name; ValueError if it is none."""
        header, place = self._at[name]
        header.check_wanted()
        A = self._matrices.matrix(header, place)
        if not np.isfinite(A.data).all():
            raise ValueError(f"{name}: holds values that are no finite numbers")
        A = symmetric(A, lambda k: f"row {k + 1}", halves=header.form == _SYMMETRIC)
        return GivenMatrix(A, _FORM)


def is_op4(content: bytes) -> bool:
    """Whether a file looks like OUTPUT4."""
    return _is_binary(content) or _TEXT_HEADER.match(content) is not None


def _is_binary(content: bytes) -> bool:
    return any(_begins(content, order) for order in "<>")


def _begins(content: bytes, order: str) -> int:
    """Bytes of the header of a binary file in a byte order; 0 if it begins otherwise."""
    length = int(np.frombuffer(content[:4].ljust(4), order + "i4")[0])
    if length not in (24, 48) or len(content) < length + 8:
        return 0
    return length if content[4 + length : 8 + length] == content[:4] else 0


class _Binary:
    """Matrices of a binary file, as 32-bit words in the byte order of this machine."""

    def __init__(self, content: bytes) -> None:
        self.big = not _begins(content, "<")
        order = ">" if self.big else "<"
        self.wide = _begins(content, order) == 48
        self.content = content
        words = np.frombuffer(content, order + "i4", len(content) // 4)
        self.words = np.ascontiguousarray(words.astype(np.int32, copy=False))

    def headers(self) -> Iterator[tuple[_Header, tuple[int, IntArray]]]:
        """Headers, with the word at which columns begin, and the entries before each column."""
        at, n, size = 0, self.words.size, 8 if self.wide else 4
        length = 48 if self.wide else 24
        kind = (">" if self.big else "<") + ("i8" if self.wide else "i4")
        while at < n:
            record = self.content[4 * at : 4 * at + length + 8]
            if len(record) < length + 8 or record[:4] != record[-4:]:
                raise ValueError(f"ends within a header, or is damaged there, at byte {4 * at}")
            if self.words[at] != length:
                raise ValueError(f"found no header of a matrix at byte {4 * at}")
            numbers = np.frombuffer(record[4:], kind, 4).tolist()
            header = _Header(_name(record[4 + 4 * size : -4]), *numbers)
            header.check(len(self.content))
            begin = at + length // 4 + 2
            none = np.zeros(0, np.int32)
            indptr = np.zeros(header.columns + 1, np.int64)
            at = self._columns(header, begin, indptr, none, none)
            yield header, (begin, indptr)
        if len(self.content) % 4:
            raise ValueError("ends within a word, so that it may be cut")

    def matrix(self, header: _Header, place: tuple[int, IntArray]) -> sparse.csr_array:
        """Transpose of a matrix, of which `headers` gave the place."""
        n, per = header.columns, self._words_of_value(header)
        begin, indptr = place
        count = int(indptr[-1])
        indices, values = np.zeros(count, np.int32), np.zeros(count * per, np.int32)
        self._columns(header, begin, indptr, indices, values)
        if per == 1:
            data = values.view(np.float32).astype(float)
        else:
            # Both words of a value stand in the file's order.
            pairs = values.reshape(-1, 2)[:, ::-1].ravel() if self.big else values
            data = np.ascontiguousarray(pairs).view(np.float64)
        if count < 2**31:
            indptr = indptr.astype(np.int32)
        return sparse.csr_array((data, indices, indptr), shape=(n, n))

    def _words_of_value(self, header: _Header) -> int:
        """Words of a real number; of a complex one half of its words."""
        return 2 if self.wide or header.kind in (2, 4) else 1

    def _columns(
        self,
        header: _Header,
        begin: int,
        indptr: IntArray,
        indices: np.ndarray,
        values: np.ndarray,
    ) -> int:
        """Word after a matrix, whose entries are counted, and stored if there is space."""
        from skfem_joint.matrix_files.op4_loops import WRONG, read_columns

        large = header.rows < 0 or header.rows >= _LARGE
        per = self._words_of_value(header) * (2 if header.kind in (3, 4) else 1)
        layout = np.array([self.wide, self.big, per, large], np.int64)
        rows = abs(header.rows)
        arguments = begin, rows, header.columns, layout, indptr, indices, values
        wrong, at, _ = read_columns(self.words, *arguments, bool(indices.size))
        if wrong:
            raise ValueError(f"{header.name}: {WRONG[wrong]}, at byte {4 * at}")
        return int(at)


def _name(text: bytes) -> str:
    """Name of a matrix, without what fills it up."""
    name = text.decode("latin-1").strip(" \0")
    if not re.fullmatch(r"\w{1,16}", name):
        raise ValueError(f"found {name!r}, must be the name of a matrix")
    return name


# Text

_TEXT_HEADER = re.compile(
    rb"([ \d]{7}\d)([- \d]{7}\d)([ \d]{7}\d)([ \d]{7}\d)(.{8})\s*(?:1P,)?(\d{1,2})[ED](\d{1,2})"
    rb"\.\d+(?:E\d+)?[^\n|]*\n"
)
_WIDE_HEADER = re.compile(
    rb"([ \d]{15}\d)([- \d]{15}\d)([ \d]{7}\d)([ \d]{7}\d)(.{8})\s*(?:1P,)?(\d{1,2})[ED](\d{1,2})"
    rb"\.\d+(?:E\d+)?\|I16[^\n]*\n"
)


class _Text:
    """Matrices of a text file, read line by line."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0  # byte at which the next line begins
        self.size = len(content)

    def headers(self) -> Iterator[tuple[_Header, sparse.csr_array]]:
        """Headers, with the transposes of their matrices."""
        while self.at < self.size and self.content[self.at :].strip(b"\r\n "):
            found = _TEXT_HEADER.match(self.content, self.at)
            found = found or _WIDE_HEADER.match(self.content, self.at)
            if found is None:
                raise ValueError(f"line {self._line() + 1}: found no header of a matrix")
            numbers = [int(cell) for cell in found.groups()[:4]]
            header = _Header(_name(found[5]), *numbers)
            header.check(self.size)
            per_line, width = int(found[6]), int(found[7])
            if min(per_line, width) < 1:
                raise ValueError(f"line {self._line() + 1}: found no format of numbers")
            self.at = found.end()
            yield header, self._matrix(header, per_line, width)

    def matrix(self, _: _Header, place: sparse.csr_array) -> sparse.csr_array:
        """Transpose of a matrix, of which `headers` gave the place."""
        return place

    def _matrix(self, header: _Header, per_line: int, width: int) -> sparse.csr_array:
        """Transpose of the matrix that begins here."""
        strings = [*self._strings(header, per_line, width)]
        shape = header.columns, abs(header.rows)
        if header.kind in (3, 4):  # complex, which is refused where it is wanted
            return sparse.csr_array(shape)
        counts = np.array([len(numbers) for _, _, numbers in strings], dtype=np.intp)
        column = np.repeat([string[0] for string in strings], counts).astype(np.intp)
        first = np.repeat([string[1] for string in strings], counts).astype(np.intp)
        begin = np.repeat(np.cumsum(counts) - counts, counts)
        row = first + np.arange(counts.sum()) - begin
        data = np.array([x for string in strings for x in string[2]], dtype=float)
        return sparse.csr_array(sparse.coo_array((data, (column, row)), shape=shape))

    def _strings(
        self, header: _Header, per_line: int, width: int
    ) -> Iterator[tuple[int, int, list[float]]]:
        """Column, first row and numbers of the strings of consecutive rows of a matrix."""
        large = header.rows < 0 or header.rows >= _LARGE
        words = 2 if header.kind in (2, 4) else 1  # of a real number
        last = 0
        while True:
            column, row, left = self._integers(3)
            if not last < column <= header.columns + 1:
                raise ValueError(
                    f"line {self._line()}: found column {column}, must be {last + 1} to "
                    f"{header.columns + 1}"
                )
            if column == header.columns + 1:
                self._next()
                return
            last, next_row = column, 1
            dense = row > 0
            while left > 0:
                # Counts of dense columns are those of numbers, of strings those of words.
                amount = left
                if dense:
                    left = 0
                else:
                    if large:
                        length, row = self._integers(2)
                        amount, left = length - 1, left - length - 1
                    else:
                        (both,) = self._integers(1)
                        amount, row = (both >> 16) - 1, both & 0xFFFF
                        left -= amount + 1
                    amount = amount // words if amount % words == 0 else 0
                if amount < 1 or left < 0 or row < next_row or amount > self.size:
                    raise ValueError(
                        f"line {self._line()}: found row {row} and {amount} numbers, which does "
                        "not fit the column"
                    )
                entries = amount // 2 if header.kind in (3, 4) else amount
                if row + entries - 1 > abs(header.rows):
                    raise ValueError(f"line {self._line()}: found row {row}, out of range")
                yield column - 1, row - 1, self._numbers(amount, per_line, width)
                next_row = row + entries

    def _numbers(self, amount: int, per_line: int, width: int) -> list[float]:
        """Numbers of fixed width in the next lines."""
        numbers: list[float] = []
        while len(numbers) < amount:
            line = self._next()
            here = min(per_line, amount - len(numbers))
            cells = [line[width * k : width * (k + 1)] for k in range(here)]
            if line[width * here :].strip() or not all(map(_REAL_CELL.fullmatch, cells)):
                raise ValueError(
                    f"line {self._line()}: found {line[:60]!r}, must be {here} numbers of "
                    f"{width} characters"
                )
            numbers += [float(cell.translate(_TO_E)) for cell in cells]
        return numbers

    def _next(self) -> bytes:
        """Next line."""
        end = self.content.find(b"\n", self.at)
        if end < 0:
            raise ValueError("ends within a matrix")
        line, self.at = self.content[self.at : end].rstrip(b"\r"), end + 1
        return line

    def _integers(self, count: int) -> list[int]:
        """Whole numbers of the next line, of eight characters each, or sixteen."""
        line = self._next()
        cells = line.split()
        if len(cells) < count:  # without spaces between them
            cells = [line[8 * k : 8 * k + 8].strip() for k in range(count)]
        if len(cells) != count or not all(re.fullmatch(rb"-?\d{1,16}", cell) for cell in cells):
            raise ValueError(
                f"line {self._line()}: found {line[:60]!r}, must be {count} whole numbers"
            )
        return [int(cell) for cell in cells]

    def _line(self) -> int:
        """Number of the line that was read last."""
        return self.content.count(b"\n", 0, self.at)


_REAL_CELL = re.compile(rb"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d{1,3})?\s*")
_TO_E = bytes.maketrans(b"Dd", b"Ee")
