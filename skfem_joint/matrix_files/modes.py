"""Fixed-interface modes among the unknowns of another program's condensed model."""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense
from skfem_joint.matrix_files.labels import is_scalar

#: Share of the highest frequency of fixed-interface modes up to which they serve: modes are kept up
#: to one and a half times the highest frequency of interest by rule.
SERVED = 2.0 / 3.0
#: Coupling in K with the nodes, of the root of the diagonals, below which modes have a fixed
#: interface.
_UNCOUPLED = 1e-6


def fixed_interface_frequencies(
    K: sparse.csr_array, M: sparse.csr_array, labels: IntArray | None
) -> FloatArray | None:
    """Frequencies of the fixed-interface modes among the unknowns, Hz, ascending.

    They are natural frequencies of the unknowns without a node while all nodes are held. None if
    those are no fixed-interface modes: K couples them with nodes, or they are no vibration. Empty
    if there are no such unknowns.
    """
    own = np.zeros(K.shape[0], dtype=bool) if labels is None else is_scalar(labels)
    modes, nodes = np.flatnonzero(own), np.flatnonzero(~own)
    if not modes.size:
        return np.zeros(0)
    diagonal = np.abs(K.diagonal())
    across = sparse.coo_array(K[modes][:, nodes])
    row, column = across.coords
    size = np.sqrt(diagonal[modes[row]] * diagonal[nodes[column]])
    if np.any(np.abs(across.data) > _UNCOUPLED * size):
        return None
    try:
        squares = linalg.eigh(
            as_dense(K[modes][:, modes]), as_dense(M[modes][:, modes]), eigvals_only=True
        )
    except (linalg.LinAlgError, ValueError):
        return None
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi))


def highest_served(frequencies: FloatArray | None) -> float:
    """Frequency up to which given modes serve, Hz; infinity where there are none or other ones."""
    if frequencies is None or not frequencies.size:
        return np.inf
    return SERVED * float(frequencies[-1])


def about_modes(frequencies: FloatArray | None, labels: IntArray | None) -> str:
    """Sentence about the unknowns without a node; empty if there are none."""
    count = 0 if labels is None else int(np.count_nonzero(is_scalar(labels)))
    if not count:
        return ""
    if frequencies is None:
        return (
            f"{count} unknowns have no node, and K couples them with nodes: they are no modes with "
            "a fixed interface, and up to which frequency they serve is not known."
        )
    return (
        f"{count} unknowns are fixed-interface modes of the other program, of "
        f"{frequencies[0]:.5g} to {frequencies[-1]:.5g} Hz: they serve up to some "
        f"{highest_served(frequencies):.4g} Hz, two thirds of the highest."
    )
