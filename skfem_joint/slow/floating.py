"""Motions of a structure that floats: in which nothing slips, and a support that holds them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.linalg import shifts
from skfem_joint.system.modes import ROUND_OFF

#: Share of a rigid motion's displacement that is no slip.
STILL = 1e-6
#: Work of a force on a motion that is round-off, over both their sizes. In few coordinates a force
#: and a motion may have no entry in common but round-off.
NO_WORK = 1e-9


def pushes(force: FloatArray, motions: FloatArray) -> BoolArray:
    """Whether a force, (n,), works on each of some motions, (n, r), beyond round-off: (r,)."""
    least = STILL * (np.abs(force) @ np.abs(motions))
    size = np.linalg.norm(force) * np.linalg.norm(motions, axis=0)
    return np.asarray(np.abs(force @ motions) > np.maximum(least, NO_WORK * size))


def held(
    K: FloatArray, M: FloatArray, rows: FloatArray, shift: float
) -> tuple[FloatArray, FloatArray]:
    """Rigid motions (n, k) of a dense system, and a mass whose shift holds some of them firmly.

    In those that the ``rows``, (m, n), do not see loads in balance do nothing. As stiff as others
    they are no least stiffness, which limits the laws by which Coulomb's is approached.
    """
    squares, modes = linalg.eigh(K, M)
    loose = squares < ROUND_OFF * shift
    # The least modes have round-off of the highest ones, which a step of inverse iteration takes.
    rigid = np.linalg.solve(K + shift * M, M @ modes[:, loose])
    rigid = rigid @ np.linalg.inv(np.linalg.cholesky(rigid.T @ (M @ rigid)).T)
    _, values, turn = np.linalg.svd(linalg.qr(rows @ rigid, mode="economic")[1])
    moves = np.count_nonzero(values > STILL * np.abs(rows @ modes).max(initial=0.0))
    momenta = M @ rigid @ turn[moves:].T
    return rigid, np.asarray(M + momenta @ momenta.T / shifts.LEAST)


@dataclass(frozen=True)
class Still:
    """Motions of a structure in which nothing slips and nothing is strained.

    Attributes
    ----------
    motions, momenta : ndarray, shape (n, r)
        Motions of unit mass, and the mass times them.
    held : ndarray of int, shape (r,)
        Unknowns that hold them, as a support that is statically determinate: on loads in balance it
        has no reaction.
    kept : ndarray of int
        These and the unknowns of the contact.
    sliding : ndarray, shape (n, j)
        Other motions in which nothing is strained: all of them slip.
    """

    motions: FloatArray
    momenta: FloatArray
    held: IntArray
    kept: IntArray
    sliding: FloatArray

    @staticmethod
    def of(rigid: FloatArray, limited: IntArray, M: Matrix) -> Still:
        """Of rigid motions of unit mass, (n, k), by the unknowns of the contact."""
        sizes = np.abs(rigid).max(axis=0)
        slips = linalg.qr(rigid[limited] / sizes, mode="economic")[1]
        _, values, turn = np.linalg.svd(slips)
        sliding, still = np.split(
            rigid / sizes @ turn.T, [np.count_nonzero(values > STILL)], axis=1
        )
        mass, turn = linalg.eigh(still.T @ (M @ still))
        still = np.asarray(still @ (turn / np.sqrt(mass)))
        still[limited] = 0.0
        held: IntArray = linalg.qr(still.T, mode="r", pivoting=True)[1][: still.shape[1]]
        held = np.sort(held).astype(np.intp)
        return Still(still, np.asarray(M @ still), held, np.union1d(limited, held), sliding)

    def springs(self, K: Matrix, shift: float) -> sparse.csr_array:
        """What is added to K over ``shift``: springs of unknowns that are held, and less of others.

        The springs of the contact hold what slips where nothing sticks. Unlike a shift by the mass
        they carry nothing where all sticks, however soft a part is beside the one that floats.
        """
        stiffness = K.diagonal()
        each = np.zeros(stiffness.size)
        each[self.kept] = shifts.LEAST * stiffness.sum() / self.kept.size
        each[self.held] = stiffness[self.held]
        return sparse.csr_array(sparse.diags_array(each / shift))

    def pushed(self, force: FloatArray) -> bool:
        """Whether a force, (n,), N, moves the structure as a whole."""
        return bool(pushes(force, self.motions).any())

    def placed(self, u: FloatArray) -> FloatArray:
        """Displacements, (n, ...), without these motions, which loads in balance do not set off."""
        return np.asarray(u - self.motions @ (self.momenta.T @ u))
