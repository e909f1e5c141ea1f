"""Internal unknowns without mass, which Abaqus writes beside those of nodes.

Abaqus gives its internal nodes (of beams, connectors, hybrid elements) negative numbers, and takes
their mass to the nodes of the model. Where they have none they follow the others without inertia,
and K without them is its Schur complement, exactly.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from skfem_joint.ground.arrays import IntArray
from skfem_joint.ground.errors import InputError, first_of
from skfem_joint.matrix_files.given import GivenMatrix
from skfem_joint.matrix_files.labels import label_text

#: Unknowns of one internal block: beyond it K would be filled.
_LARGEST_BLOCK = 100


def without_internal(K: GivenMatrix, labels: IntArray, internal: IntArray) -> GivenMatrix:
    """Stiffness without internal unknowns that have no mass.

    Raises
    ------
    InputError
        If their stiffness is singular, or couples too many of them with each other.
    """
    kept = np.setdiff1d(np.arange(len(labels)), internal)
    names = first_of([label_text(label) for label in labels[internal]])
    rows = K.matrix[internal]
    across = sparse.csr_array(rows[:, kept])
    try:
        follow = _inverse_of_blocks(sparse.csr_array(rows[:, internal])) @ across
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InputError(
            f"M: lacks internal unknowns of K ({names}), which cannot be eliminated: {error}"
        ) from error
    A = K.matrix[kept][:, kept] - across.T @ follow
    note = (
        f"{internal.size} internal unknowns of the other program have no mass; they are "
        f"eliminated from K, which is exact: {names}."
    )
    return replace(
        K,
        matrix=sparse.csr_array(0.5 * (A + A.T)),
        labels=labels[kept],
        held=np.searchsorted(kept, K.held),
        notes=(*K.notes, note),
    )


def _inverse_of_blocks(A: sparse.csr_array) -> sparse.csr_array:
    """Inverse of a matrix that is block diagonal, with small blocks, in another order."""
    _, block = connected_components(A, directed=False)
    sizes = np.bincount(block)
    if sizes.max() > _LARGEST_BLOCK:
        raise ValueError(f"found {sizes.max()} coupled with each other, most are {_LARGEST_BLOCK}")
    order = np.argsort(block, kind="stable")
    parts = []
    for size in np.unique(sizes):
        members = order[sizes[block[order]] == size].reshape(-1, size)
        row, column = np.repeat(members, size, axis=1), np.tile(members, size)
        dense = A[row, column].toarray().reshape(-1, size, size)
        if np.linalg.cond(dense).max() > 1e12:
            raise ValueError("their stiffness is singular, as of Lagrange multipliers")
        parts.append((np.linalg.inv(dense).ravel(), row.ravel(), column.ravel()))
    value, row, column = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return sparse.csr_array(sparse.coo_array((value, (row, column)), shape=A.shape))
