"""Friction laws: Coulomb regularised by the arctangent, and set-valued Coulomb as its limit.

One family carries both laws. With the slip velocity v (m/s) and the scaling constant
beta (s/m) of Eq. (2), the normalised friction force is

    sigma(v) = 2/pi arctan(beta v),        beta finite,
    sigma(v) in Sgn(v),                    beta = inf (set-valued Coulomb),

so that ``w * sigma`` is the force in N for a point of friction limit ``w``. The law is the
gradient of an even convex potential ``psi``, which makes every implicit step a strictly convex
minimisation. A slip *vector* follows the same law radially (:func:`force_vectors`): the force has
the direction of the slip and depends on its norm. Its potential is ``psi`` of the norm.

All functions take arrays that broadcast against each other; ``beta`` may differ from point to
point and may be ``inf``.
"""

from __future__ import annotations

from math import inf, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skfem_joint.arrays import FloatArray

#: Kinds of points: of the arctan law, of set-valued Coulomb friction, without friction.
ARCTAN, COULOMB, FREE = 0, 1, 2
#: Share of its limit from which on friction counts as having reached it: the arctan law never does.
AT_LIMIT = 0.99


def _split(v: ArrayLike, beta: ArrayLike) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Broadcast; give Coulomb points a harmless finite beta and say where they are."""
    v_array, beta_array = np.broadcast_arrays(
        np.asarray(v, dtype=np.float64), np.asarray(beta, dtype=np.float64)
    )
    coulomb = np.isinf(beta_array)
    return v_array, np.where(coulomb, 1.0, beta_array), coulomb


def force(v: ArrayLike, beta: ArrayLike) -> FloatArray:
    """Normalised friction force sigma(v) in [-1, 1], Eq. (2).

    For Coulomb points at v = 0, where any value in [-1, 1] may act, the value 0 is returned.
    """
    v_array, finite, coulomb = _split(v, beta)
    return np.where(coulomb, np.sign(v_array), 2.0 / pi * np.arctan(finite * v_array))


def slope(v: ArrayLike, beta: ArrayLike) -> FloatArray:
    """Derivative d sigma / d v, s/m; for Coulomb points 0 in slip and ``inf`` in stick."""
    v_array, finite, coulomb = _split(v, beta)
    arctan_slope = 2.0 / pi * finite / (1.0 + (finite * v_array) ** 2)
    return np.where(coulomb, np.where(v_array == 0.0, inf, 0.0), arctan_slope)


def potential(v: ArrayLike, beta: ArrayLike) -> FloatArray:
    """Potential psi(v), m/s, whose derivative is :func:`force`; zero at rest, |v| for Coulomb."""
    v_array, finite, coulomb = _split(v, beta)
    z = finite * v_array
    arctan_potential = 2.0 / pi * (v_array * np.arctan(z) - 0.5 * np.log1p(z * z) / finite)
    return np.where(coulomb, np.abs(v_array), arctan_potential)


def norms(slip: ArrayLike, directions: NDArray[np.int64]) -> FloatArray:
    """Norms (..., m) of the slip vectors of points, from the slip (..., rows) of each row.

    ``directions`` (m,) tells the rows of each point, 1 or 2, which follow each other.
    """
    rows = np.asarray(slip, dtype=np.float64)
    if directions.size == rows.shape[-1]:
        return np.abs(rows)
    first = np.cumsum(directions) - directions
    return np.asarray(np.sqrt(np.add.reduceat(rows * rows, first, axis=-1)))


def force_vectors(slip: ArrayLike, beta: ArrayLike, directions: NDArray[np.int64]) -> FloatArray:
    """Normalised friction forces sigma(|y|) y / |y| of points with slip vectors y, isotropic.

    Of each row, (..., rows), from its slip velocity, m/s, alike; see `norms` for ``directions``.
    ``beta`` is the scaling constant of each point, s/m, broadcast against (..., m). The norm of a
    point's force is :func:`force` of the norm of its slip.
    """
    rows = np.asarray(slip, dtype=np.float64)
    if directions.size == rows.shape[-1]:
        return force(rows, beta)
    size = norms(rows, directions)
    ratio = force(size, beta) / np.where(size > 0.0, size, 1.0)
    return np.asarray(np.repeat(ratio, directions, axis=-1) * rows)
