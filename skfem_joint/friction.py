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

from math import atan, inf, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

#: Kinds of points: of the arctan law, of set-valued Coulomb friction, without friction.
ARCTAN, COULOMB, FREE = 0, 1, 2

#: Friction law names that a scene may use.
LAWS = ("arctan", "coulomb")


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
    """Convex potential psi(v), m/s, whose (sub)gradient is sigma(v); psi(0) = 0."""
    v_array, finite, coulomb = _split(v, beta)
    z = finite * v_array
    arctan_potential = (2.0 / pi) * (v_array * np.arctan(z) - 0.5 * np.log1p(z * z) / finite)
    return np.where(coulomb, np.abs(v_array), arctan_potential)


def norms(slip: ArrayLike, directions: NDArray[np.int64]) -> FloatArray:
    """Norms of the slip vectors of points.

    Parameters
    ----------
    slip : array_like, shape (..., rows)
        Slip of each row; the rows of a point follow each other.
    directions : ndarray of int, shape (m,)
        Rows of each point, 1 or 2.

    Returns
    -------
    ndarray, shape (..., m)
    """
    rows = np.asarray(slip, dtype=np.float64)
    if directions.size == rows.shape[-1]:
        return np.abs(rows)
    first = np.cumsum(directions) - directions
    return np.asarray(np.sqrt(np.add.reduceat(rows * rows, first, axis=-1)))


def force_vectors(slip: ArrayLike, beta: ArrayLike, directions: NDArray[np.int64]) -> FloatArray:
    """Normalised friction forces sigma(|y|) y / |y| of points with slip vectors y, isotropic.

    Parameters
    ----------
    slip : array_like, shape (..., rows)
        Slip velocity of each row, m/s; the rows of a point follow each other.
    beta : array_like
        Scaling constant of each point, s/m, broadcast against (..., m).
    directions : ndarray of int, shape (m,)
        Rows of each point, 1 or 2.

    Returns
    -------
    ndarray, shape (..., rows)
        The norm of a point's force is :func:`force` of the norm of its slip.
    """
    rows = np.asarray(slip, dtype=np.float64)
    if directions.size == rows.shape[-1]:
        return force(rows, beta)
    size = norms(rows, directions)
    ratio = force(size, beta) / np.where(size > 0.0, size, 1.0)
    return np.asarray(np.repeat(ratio, directions, axis=-1) * rows)


def tangent_blocks(slip: ArrayLike, beta: ArrayLike) -> FloatArray:
    """Derivatives of the forces of points with two directions.

    The slope of the law acts along the slip vector and force over norm across it; both are
    the slope at rest where nothing slips. Regularised points only.

    Parameters
    ----------
    slip : array_like, shape (..., 2)
        Slip velocities, m/s.
    beta : array_like
        Finite scaling constants, s/m, broadcast against (...).

    Returns
    -------
    ndarray, shape (..., 2, 2)
        Symmetric and positive definite, s/m.
    """
    y = np.asarray(slip, dtype=np.float64)
    size = np.hypot(y[..., 0], y[..., 1])
    moves = size > 0.0
    safe = np.where(moves, size, 1.0)
    along = slope(size, beta)
    across = np.where(moves, force(size, beta) / safe, along)
    t = y / safe[..., np.newaxis]
    dyad = t[..., :, np.newaxis] * t[..., np.newaxis, :]
    return np.asarray(
        across[..., np.newaxis, np.newaxis] * np.eye(2)
        + (along - across)[..., np.newaxis, np.newaxis] * dyad
    )


def resolvent(s: ArrayLike, kappa: ArrayLike, beta: ArrayLike) -> FloatArray:
    """Slip velocity v that solves kappa v + sigma(v) = s (Minty's parametrisation of the law).

    Parameters
    ----------
    s : array_like
        Resolvent variable, dimensionless.
    kappa : array_like
        Positive scale, s/m.
    beta : array_like
        Scaling constant of Eq. (2), s/m, ``inf`` for Coulomb.

    Returns
    -------
    ndarray
        Slip velocity, m/s.
    """
    s_array, kappa_array, beta_array = np.broadcast_arrays(
        *(np.asarray(a, dtype=np.float64) for a in (s, kappa, beta))
    )
    coulomb = np.isinf(beta_array)
    finite = np.where(coulomb, 1.0, beta_array)
    magnitude = np.abs(s_array)
    k = kappa_array / finite
    # Upper end of the root's bracket: the arctangent is at least z / (z + pi / 2).
    z = _rational_root(magnitude, k, pi / 2.0)
    # k z + 2/pi arctan(z) - |s| is concave in z >= 0 and not negative at the start: Newton from
    # there may step below the root once and rises to it from then on.
    for _ in range(60):
        residual = k * z + 2.0 / pi * np.arctan(z) - magnitude
        step = residual / (k + 2.0 / pi / (1.0 + z * z))
        z_next = np.maximum(z - step, 0.0)
        if np.all(np.abs(z_next - z) <= 4e-16 * z):
            break
        z = z_next
    v = np.where(coulomb, np.maximum(magnitude - 1.0, 0.0) / kappa_array, z / finite)
    return np.asarray(np.copysign(v, s_array))


def _rational_root(s: FloatArray, k: FloatArray, c: float) -> FloatArray:
    """Root z >= 0 of k z + z / (z + c) = s for s >= 0, without cancellation."""
    b = s - 1.0 - k * c
    root = np.sqrt(b * b + 4.0 * k * c * s)
    return np.where(b > 0.0, (b + root) / (2.0 * k), 2.0 * c * s / (root - b + 1e-300))


def graph_point(s: float, kappa: float, beta: float) -> tuple[float, float, float, float]:
    """Point of the law's graph that belongs to the parameter s, with derivatives in s.

    Written for one point so that the compiled steps can use it as it is. For Coulomb it is
    the resolvent itself. For the arctangent the velocity is the resolvent of the rational law
    z / (z + 1), z = beta v, which has a closed form; the force is the arctangent at that velocity,
    so the point lies on the law's graph to round-off, with one square root and one arctangent.
    Like the resolvent, both v(s) and sigma(s) have bounded slopes however large beta is, which is
    what keeps a Newton iteration on s from degrading.

    Parameters
    ----------
    s : float
        Parameter along the graph; close to kappa v + sigma(v).
    kappa : float
        Positive scale, s/m.
    beta : float
        Scaling constant of Eq. (2), s/m, ``inf`` for Coulomb.

    Returns
    -------
    v, sigma, dv, dsigma : float
        Slip velocity (m/s), normalised force, and their derivatives with respect to s.
    """
    if beta == inf:
        if s > 1.0:
            return (s - 1.0) / kappa, 1.0, 1.0 / kappa, 0.0
        if s < -1.0:
            return (s + 1.0) / kappa, -1.0, 1.0 / kappa, 0.0
        return 0.0, s, 0.0, 1.0
    k = kappa / beta
    magnitude = abs(s)
    b = magnitude - 1.0 - k
    root = sqrt(b * b + 4.0 * k * magnitude)
    # Of the two forms of the root, the one without cancellation.
    z = (b + root) / (2.0 * k) if b > 0.0 else 2.0 * magnitude / (root - b)
    dz = (z + 1.0) / root
    sigma = 2.0 / pi * atan(z)
    dsigma = 2.0 / pi / (1.0 + z * z) * dz
    if s < 0.0:
        return -z / beta, -sigma, dz / beta, dsigma
    return z / beta, sigma, dz / beta, dsigma


def parameter(v: ArrayLike, sigma: ArrayLike, kappa: float, beta: ArrayLike) -> FloatArray:
    """Parameter s of the points (v, sigma) of the graph: the inverse of :func:`graph_point`."""
    v_array, finite, coulomb = _split(v, beta)
    z = np.abs(finite * v_array)
    arctan_parameter = np.copysign(kappa / finite * z + z / (z + 1.0), v_array)
    return np.where(coulomb, kappa * v_array + np.asarray(sigma), arctan_parameter)
