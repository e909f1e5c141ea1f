"""Motions of a system that strain nothing: those of bodies that no support holds."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh, orth

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.system.modes import is_singular, strain_nothing
from skfem_joint.system.system import System


def rigid_of(system: System) -> FloatArray | None:
    """Motions (n, r) of unit mass that strain nothing, if they are known of a system, else None.

    They are those combinations of ``system.loose`` that supports, closed contact and springs let
    move without work.
    """
    if system.loose is None:
        return None
    K, R = system.K, system.loose.toarray()
    R = R[:, np.any(R != 0.0, axis=0)]
    if R.size:  # of bodies that are held but for a line of nodes some are the same motion
        R = orth(R / np.abs(R).max(axis=0), rcond=1e-9)
    stiffness = R.T @ (K @ R)
    R = R @ eigh(0.5 * (stiffness + stiffness.T))[1]
    R = R[:, strain_nothing(K, R)]
    mass, turn = eigh(R.T @ (system.M @ R)) if R.size else (np.zeros(0), np.zeros((0, 0)))
    return np.asarray(R @ (turn / np.sqrt(mass)))


def floats(system: System) -> bool:
    """Whether motions of a system strain nothing: known of it, or by the stiffness' pivots."""
    rigid = rigid_of(system)
    return is_singular(system.K) if rigid is None else rigid.shape[1] > 0
