"""Sliding of whole joints, beside the modes of reduced models for quasi-static runs.

A reduced model has fewer unknowns than contact points: of the friction forces of points that stick
only those sums are determined that do work on its basis. The sum over a joint, which its loop
shows, is one of them if the basis has the motion in which all points of the joint slip alike. All
else follows this motion statically, so that it costs the least strain energy.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.linalg import shifts
from skfem_joint.linalg.factors import factorised
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.system.system import System


def joint_slides(system: System) -> FloatArray:
    """Motions in which all points of a joint slip by one alike and all other points stick, (n, k).

    One for each joint and direction of slip, whose components are those of the slip rows. None for
    a system whose slips depend on each other.
    """
    to = arranged(system)
    inner = to.system
    if to.kind not in ("chain", "contact") or inner.is_dense:
        return np.zeros((system.n, 0))
    carrying = np.flatnonzero(inner.contact.on_rows(inner.contact.w) > 0.0)
    kept = sparse.csr_array(inner.contact.B).indices[carrying]
    point = np.repeat(np.arange(inner.contact.w.size), inner.contact.directions)[carrying]
    component = carrying - inner.contact.first_row[point]
    own = as_dense(inner.contact.J)[:, point] > 0.0
    slips = [own[j] & (component == c) for j in range(len(own)) for c in (0, 1)]
    U = np.array([slip for slip in slips if slip.any()], dtype=float).T
    X = np.zeros((inner.n, U.shape[1]))
    np.maximum.at(X, kept, U)  # points with springs may share an unknown
    rest = np.setdiff1d(np.arange(inner.n), kept)
    if rest.size:
        K, M = (sparse.csr_array(A)[rest] for A in (inner.K, inner.M))
        K_rest = K[:, rest] + shifts.LEAST * inner.mean_square_frequency * M[:, rest]
        X[rest] = -factorised(sparse.csc_array(K_rest))(np.asarray(K[:, kept] @ U))
    return to.outer(X.T).T
