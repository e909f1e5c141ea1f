"""Symmetric matrices from entries of which a file gives all, or those of one half."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.matrix_files.labels import keys_of, label_text

#: Difference of entries that should be equal, of the root of the product of their diagonals.
ROUND_OFF = 1e-9


def from_entries(
    row: IntArray,
    column: IntArray,
    value: FloatArray,
    n: int,
    name_of: Callable[[int], str],
    line_of: Callable[[int], int],
    halves: bool = True,
) -> sparse.csr_array:
    """Symmetric matrix of entries in any order, each given once.

    Parameters
    ----------
    row, column : ndarray of int, shape (k,)
        From 0.
    value : ndarray, shape (k,)
    n : int
        Number of unknowns.
    name_of : callable
        Name of an unknown in messages.
    line_of : callable
        Line of an entry in the file, for messages.
    halves : bool
        Whether one half may be given.

    Raises
    ------
    ValueError
        For values that are not finite, entries that repeat, and matrices that are not symmetric.
    """
    if not np.isfinite(value).all():
        wrong = int(np.argmin(np.isfinite(value)))
        raise ValueError(f"line {line_of(wrong)}: found a number too large, must be finite")
    key = row * n + column
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    if twice.size:
        a, b = sorted(order[twice[0] : twice[0] + 2].tolist())
        raise ValueError(
            f"lines {line_of(a)} and {line_of(b)}: both give the entry of {name_of(int(row[a]))} "
            f"and {name_of(int(column[a]))}, must be given once"
        )
    rows = sparse.csr_array(sparse.coo_array((value, (row, column)), shape=(n, n)))
    return symmetric(rows, name_of, halves)


def from_named_entries(
    places: IntArray, value: FloatArray, line_of: Callable[[int], int], halves: bool = True
) -> tuple[sparse.csr_array, IntArray]:
    """Symmetric matrix of `from_entries`, and the node and direction of its unknowns, (n, 2).

    ``places``, (2 k, 2), are those of the row and of the column of each entry in turn.
    """
    keys, first, number = np.unique(keys_of(places), return_index=True, return_inverse=True)
    labels = places[first]
    row, column = number.reshape(-1, 2).T

    def name_of(k: int) -> str:
        return label_text(labels[k])

    return from_entries(row, column, value, keys.size, name_of, line_of, halves), labels


def symmetric(
    A: sparse.csr_array, name_of: Callable[[int], str], halves: bool = True
) -> sparse.csr_array:
    """Symmetric matrix of which all entries, or those of one half where that may be, are given.

    A half gives each entry outside the diagonal on one side only, which need not be the lower or
    the upper one: programs number their unknowns otherwise inside.

    Raises
    ------
    ValueError
        If entries on both sides of the diagonal differ by more than round-off.
    """
    A.eliminate_zeros()
    mirrored = sparse.csr_array(A.T)
    difference = sparse.coo_array(A - mirrored)
    if not difference.nnz:
        return A
    diagonal = A.diagonal()
    on_both_sides = A.astype(bool).multiply(mirrored.astype(bool)).nnz
    if halves and on_both_sides == np.count_nonzero(diagonal):
        return sparse.csr_array(A + mirrored - sparse.diags_array(diagonal))
    row, column = difference.coords
    scale = np.sqrt(np.abs(diagonal[row] * diagonal[column]))
    wrong = np.abs(difference.data) > ROUND_OFF * scale
    if not wrong.any():
        return sparse.csr_array(0.5 * (A + mirrored))
    worst = int(np.argmax(np.where(wrong, np.abs(difference.data), 0.0)))
    i, j = int(row[worst]), int(column[worst])
    raise ValueError(
        f"is not symmetric: {A[i, j]:.6g} for {name_of(i)} and {name_of(j)}, {A[j, i]:.6g} the "
        "other way round, the largest difference; friction and reduction need symmetric matrices "
        "(follower loads, gyroscopic forces and friction of the other program make others)"
    )
