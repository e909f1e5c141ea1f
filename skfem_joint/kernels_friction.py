"""Compiled friction laws for many points at once; see :mod:`skfem_joint.friction` for the laws.

The loops hold no branches, so that the compiler turns them into vector instructions. That asks for
an arctangent of its own: the argument is folded to |t| <= tan(pi/8), where arctan(t)/t is a
polynomial of degree 12 in t^2 (interpolation at the Chebyshev nodes, computed with 60 digits). Its
relative error is below 4e-16.
"""

from __future__ import annotations

from math import atan, copysign, inf, pi, sqrt

import numpy as np
from numba import njit

from skfem_joint.friction import ARCTAN, COULOMB

compiled = njit(cache=True, error_model="numpy")


_TAN_1 = float(np.tan(np.pi / 8.0))
_TAN_3 = float(np.tan(3.0 * np.pi / 8.0))
_TWO_OVER_PI = 2.0 / pi
_C1 = -0.33333333333333326
_C2 = 0.19999999999997015
_C3 = -0.1428571428532971
_C4 = 0.11111111085322109
_C5 = -0.09090908059031191
_C6 = 0.07692281099937744
_C7 = -0.06666205259976526
_C8 = 0.05876834004614161
_C9 = -0.05217312574061591
_C10 = 0.04499500728984032
_C11 = -0.03338782450121195
_C12 = 0.015113765096600925


@compiled
def arctangent(z):
    """arctan(z) for z >= 0, without branches."""
    steep = z > _TAN_3
    middle = z > _TAN_1
    numerator = -1.0 if steep else (z - 1.0 if middle else z)
    denominator = z if steep else (z + 1.0 if middle else 1.0)
    offset = 0.5 * pi if steep else (0.25 * pi if middle else 0.0)
    t = numerator / denominator
    q = t * t
    p = _C12
    p = p * q + _C11
    p = p * q + _C10
    p = p * q + _C9
    p = p * q + _C8
    p = p * q + _C7
    p = p * q + _C6
    p = p * q + _C5
    p = p * q + _C4
    p = p * q + _C3
    p = p * q + _C2
    p = p * q + _C1
    return offset + (t + t * (q * p))


@compiled
def forces(beta, slip, sigma):
    """Normalised friction force of regularised points."""
    for i in range(slip.size):
        z = beta[i] * slip[i]
        sigma[i] = copysign(_TWO_OVER_PI * arctangent(abs(z)), z)


@compiled
def graph(kind, mixed, kappa, inverse_beta, s, v, sigma, dv, dsigma):
    """:func:`skfem_joint.friction.graph_point` for all points; free ones have v = s / kappa.

    Parameters
    ----------
    kind : ndarray of int8
        ARCTAN, COULOMB or FREE.
    mixed : int
        0 if all points are ARCTAN, 1 if some are, 2 if none is.
    inverse_beta : ndarray
        1 / beta, m/s; any positive number where the kind is not ARCTAN.
    """
    if mixed < 2:
        for i in range(s.size):
            k = kappa * inverse_beta[i]
            m = abs(s[i])
            b = m - 1.0 - k
            root = sqrt(b * b + 4.0 * k * m)
            beyond = b > 0.0
            z = (b + root if beyond else 2.0 * m) / (2.0 * k if beyond else root - b)
            w = 1.0 + z * z
            slope = (z + 1.0) / (root * w)
            v[i] = copysign(z * inverse_beta[i], s[i])
            sigma[i] = copysign(_TWO_OVER_PI * arctangent(z), s[i])
            dv[i] = slope * w * inverse_beta[i]
            dsigma[i] = _TWO_OVER_PI * slope
    if mixed > 0:
        inverse = 1.0 / kappa
        for i in range(s.size):
            if kind[i] != ARCTAN:
                coulomb = kind[i] == COULOMB
                inside = min(max(s[i], -1.0), 1.0) if coulomb else 0.0
                sticks = coulomb and abs(s[i]) <= 1.0
                v[i] = (s[i] - inside) * inverse
                sigma[i] = inside
                dv[i] = 0.0 if sticks else inverse
                dsigma[i] = 1.0 if sticks else 0.0


@compiled
def scalar_resolvent(x, k, beta):
    """Solve k v + sigma(v) = x for one point; returns v and sigma."""
    if beta == inf:
        if abs(x) <= 1.0:
            return 0.0, x
        v = (abs(x) - 1.0) / k
        return (v, 1.0) if x > 0.0 else (-v, -1.0)
    magnitude = abs(x)
    k = k / beta
    c = 0.5 * pi
    b = magnitude - 1.0 - k * c
    root = sqrt(b * b + 4.0 * k * c * magnitude)
    z = (b + root) / (2.0 * k) if b > 0.0 else 2.0 * c * magnitude / (root - b)
    for _ in range(60):
        step = (k * z + 2.0 / pi * atan(z) - magnitude) / (k + 2.0 / pi / (1.0 + z * z))
        z_next = max(z - step, 0.0)
        if abs(z_next - z) <= 4e-16 * z:
            break
        z = z_next
    sigma = 2.0 / pi * atan(z)
    return (z / beta, sigma) if x > 0.0 else (-z / beta, -sigma)
