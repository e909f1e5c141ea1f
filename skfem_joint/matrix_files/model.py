"""Matrices of several files put in one order of unknowns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import IntArray
from skfem_joint.ground.errors import InputError, first_of
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import RowsByName, as_labels, label_text
from skfem_joint.matrix_files.massless import without_internal


@dataclass(frozen=True)
class GivenModel:
    """Matrices of a structure by their letters, in one order of unknowns.

    Attributes
    ----------
    matrices : mapping of str to csr_array, shape (n, n)
    labels : ndarray of int, shape (n, 2), optional
        Node and direction of each unknown.
    held : ndarray of int
        Unknowns that the other program holds.
    notes : tuple of str
        What was left out, in sentences.
    """

    matrices: Mapping[str, sparse.csr_array]
    labels: IntArray | None
    held: IntArray
    notes: tuple[str, ...]


def in_one_order(given: Mapping[str, GivenMatrix], named: IntArray | None = None) -> GivenModel:
    """Matrices in the order of the unknowns of K.

    Parameters
    ----------
    given : mapping of str to GivenMatrix
        By the letters K, M and C.
    named : ndarray of int, shape (n, 2), optional
        Node and direction of each unknown, where the files do not tell.

    Raises
    ------
    InputError
        If some files name their unknowns and others do not, or name others; the messages begin with
        the letter.
    """
    if named is not None:
        given = {letter: _labelled(letter, matrix, named) for letter, matrix in given.items()}
    first = given["K"]
    without = [letter for letter, matrix in given.items() if matrix.labels is None]
    if without and len(without) < len(given):
        others = [f"{letter} ({given[letter].form})" for letter in given if letter not in without]
        raise InputError(
            f"{without[0]}: {given[without[0]].form} does not name its unknowns, but "
            f"{' and '.join(others)} does, in an order of its own: take files of one format"
        )
    if first.labels is None:
        matrices = {letter: matrix.matrix for letter, matrix in given.items()}
        return GivenModel(matrices, None, first.held, _notes(given))
    if "M" in given and given["M"].labels is not None:
        lacking = RowsByName(given["M"].labels).find(first.labels) < 0
        internal = np.flatnonzero(lacking & (first.labels[:, 0] < 0))
        if internal.size:
            first = without_internal(first, first.labels, internal)
            given = {**given, "K": first}
    labels = first.labels if first.labels is not None else as_labels([])
    places = RowsByName(labels)
    matrices = {
        k: x.matrix if x is first else _moved(k, x, places, first) for k, x in given.items()
    }
    return GivenModel(matrices, labels, first.held, _notes(given))


def _notes(given: Mapping[str, GivenMatrix]) -> tuple[str, ...]:
    return tuple(note for matrix in given.values() for note in matrix.notes)


def _labelled(letter: str, matrix: GivenMatrix, named: IntArray) -> GivenMatrix:
    if matrix.labels is not None:
        raise InputError(
            f"unknowns: found beside {letter}, whose file names its unknowns ({matrix.form}); "
            "leave it out"
        )
    if len(named) != matrix.matrix.shape[0]:
        raise InputError(
            f"unknowns: found {len(named)} lines, must be one for each of the "
            f"{matrix.matrix.shape[0]} rows of {letter}"
        )
    return replace(matrix, labels=named)


def _moved(
    letter: str, given: GivenMatrix, places: RowsByName, first: GivenMatrix
) -> sparse.csr_array:
    """Matrix in the order of the first one."""
    labels = first.labels if first.labels is not None else as_labels([])
    own = given.labels if given.labels is not None else as_labels([])
    to = places.find(own)
    if np.any(to < 0):
        names = first_of([label_text(label) for label in own[to < 0]])
        raise InputError(
            f"{letter}: has unknowns that K has not: {names}; is a file of another model?"
        )
    n = len(labels)
    missing = np.setdiff1d(np.setdiff1d(np.arange(n), to), first.held)
    if missing.size and letter == "M":
        names = first_of([label_text(label) for label in labels[missing]])
        raise InputError(
            f"M: lacks unknowns that K has: {names}; every unknown needs mass, and the file may be "
            "cut"
        )
    entries = sparse.coo_array(given.matrix)
    row, column = (to[index] for index in entries.coords)
    return sparse.csr_array(sparse.coo_array((entries.data, (row, column)), shape=(n, n)))
