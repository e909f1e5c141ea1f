"""Compiled loops over the words of binary OUTPUT4 files."""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from skfem_joint.ground.compiling import compiled

#: What a loop found, in words; 0 is success.
WRONG = {
    1: "ends within a matrix",
    2: "has a record whose two lengths differ",
    3: "has a record whose length does not fit its number of words",
    4: "has columns that do not rise, or are out of range",
    5: "has rows that do not rise within a column, or are out of range",
    6: "has a string whose length does not fit its column",
}


@compiled
def integer_at(words, at, wide, big):
    """Whole number at a 32-bit word, of one word, or of two where it is ``wide``."""
    if not wide:
        return int(words[at])
    low, high = words[at], words[at + 1]
    if big:
        low, high = high, low
    return (int(high) << 32) | (int(low) & 0xFFFFFFFF)


@compiled
def read_columns(words, at, rows, columns, layout, indptr, indices, values, fill):
    """Columns of a matrix from its first record on.

    Parameters
    ----------
    words : ndarray of int32
        The file, in the byte order of this machine.
    at : int
        Word at which the first record begins, with its length.
    rows, columns : int
    layout : ndarray of int
        Whether whole numbers have two words, whether the file is big-endian, words of a value, and
        whether rows of strings are words of their own.
    indptr : ndarray of int, shape (columns + 1,)
        Set to the number of entries before each column.
    indices : ndarray of int32
        Rows of the entries.
    values : ndarray of int32
        Words of the entries.
    fill : bool
        Whether entries are stored, or only counted.

    Returns
    -------
    (int, int, int)
        Key of `WRONG`, or 0; the word after the matrix; the number of entries.
    """
    wide, big, per, large = layout[0] == 1, layout[1] == 1, layout[2], layout[3] == 1
    size = 2 if wide else 1
    n, count, last = words.shape[0], 0, -1
    indptr[0] = 0
    while True:
        if at + 1 + 3 * size > n:
            return 1, at, count
        length = words[at]
        if length < 12 * size or length % 4:
            return 3, at, count
        end = at + 1 + length // 4
        if end >= n:
            return 1, at, count
        if words[end] != length:
            return 2, at, count
        column = integer_at(words, at + 1, wide, big) - 1
        row = integer_at(words, at + 1 + size, wide, big) - 1
        left = integer_at(words, at + 1 + 2 * size, wide, big)
        here = at + 1 + 3 * size
        if left < 0 or left > n or here + left * size != end:
            return 3, at, count
        if column == columns:
            for k in range(last + 1, columns):
                indptr[k + 1] = count
            return 0, end + 1, count
        if column <= last or column > columns:
            return 4, at, count
        for k in range(last + 1, column):
            indptr[k + 1] = count
        last = column
        next_row = 0
        dense = row >= 0
        while here < end:
            if not dense:
                if large:
                    if here + 2 * size > end:
                        return 6, at, count
                    amount = integer_at(words, here, wide, big) - 1
                    row = integer_at(words, here + size, wide, big) - 1
                    here += 2 * size
                else:
                    both = integer_at(words, here, wide, big)
                    amount = (both >> 16) - 1
                    row = (both & 0xFFFF) - 1
                    here += size
                amount *= size
            else:
                amount = end - here
            if amount <= 0 or here + amount > end or amount % per:
                return 6, at, count
            entries = amount // per
            if row < next_row or row + entries > rows:
                return 5, at, count
            if fill:
                for k in range(entries):
                    indices[count + k] = row + k
                for k in range(amount):
                    values[count * per + k] = words[here + k]
            count += entries
            next_row = row + entries
            here += amount
        indptr[column + 1] = count
        at = end + 1
