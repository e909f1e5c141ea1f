"""Change of the normal forces by vibration, in contact that stays closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray, Matrix
from skfem_joint.system.slips import SlipRows
from skfem_joint.system.unknowns import change_of_unknowns


@dataclass(frozen=True)
class Reactions:
    """Change of normal forces, ``K u + M a - F f``, where contact is closed and pressed.

    Each of the k forces is the sum over a node and its neighbours: with elements of second order
    the reaction of a single node is no measure of the pressure.

    Attributes
    ----------
    K : sparse array, shape (k, n)
        From the unknowns' displacements, N/m.
    M : sparse array, shape (k, n)
        From their accelerations, kg.
    F : ndarray, shape (k, loads)
        From the loads' amplitudes.
    force : ndarray, shape (k,)
        Normal force that presses the contact at rest, N.
    dof : ndarray of int, shape (k,)
        Degree of freedom of the matrices on which each reaction acts.
    """

    K: Matrix
    M: Matrix
    F: FloatArray
    force: FloatArray
    dof: IntArray


def reactions(
    rows: SlipRows,
    fixed: IntArray,
    matrices: Sequence[Matrix],
    T: Matrix,
    F: FloatArray,
    cells: IntArray | None = None,
) -> Reactions:
    """Reactions of closed contact, as the work of all forces on a unit gap without slip.

    Parameters
    ----------
    rows : SlipRows
    fixed : ndarray of int
        Supported degrees of freedom.
    matrices : (sparse array, sparse array), shape (N, N)
        Mass and stiffness of all degrees of freedom.
    T : sparse array, shape (N, n)
        Degrees of freedom from the unknowns.
    F : ndarray, shape (N, loads)
        Load vectors.
    cells : ndarray of int, shape (cells, corners), optional
        Degrees of freedom of each cell of the contact, whose reactions are summed.
    """
    M, K = matrices
    n, h = K.shape[0], rows.closed.shape[0]
    both = sparse.vstack([rows.closed, rows.B])
    opened = change_of_unknowns(n, fixed, sparse.csr_array((0, n)), both, rows.pivots)
    pressed = np.flatnonzero(rows.clamped > 0.0)
    gaps = sparse.csr_array(opened.forward.tocsc()[:, opened.slips[:h][pressed]].T)
    dof = abs(gaps).argmax(axis=1) if rows.pivots is None else rows.pivots[pressed]
    force = rows.clamped[pressed]
    if cells is not None:
        count = np.repeat(np.arange(len(cells)), cells.shape[1])
        inside = sparse.csr_array((np.ones(cells.size), (count, cells.ravel())), (len(cells), n))
        beside = sparse.csr_array(inside[:, dof].T @ inside[:, dof])
        beside.data[:] = 1.0
        gaps, force = beside @ gaps, beside @ force
    return Reactions(gaps @ K @ T, gaps @ M @ T, gaps @ F, force, dof)
