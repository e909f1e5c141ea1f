"""Stability of periodic motions by Hill's method, from the derivative of the balance.

A disturbance exp(lambda t) times a periodic motion obeys the linear equations

    J + lambda (C + 2 omega D) + lambda^2,

J being the derivative of the balance and D that of coefficients by the angle. Exponents whose
imaginary parts lie within half of omega are the Floquet exponents; others are their copies, shifted
by multiples of omega, which a finite number of harmonics distorts. The disturbance of friction is
taken for one that repeats with the period: exact for lambda = 0, at turning points, and good for
disturbances that change slowly.

In large balances modes far above the highest harmonic follow without inertia. That may show growth
where there is none (of blocks that lift off, at four of ten points), so that what grows then is not
judged.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import linalg

from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.harmonic.balance import Balance
from skfem_joint.harmonic.series import FourierSeries

#: Modes up to so many times the highest harmonic keep their inertia, and so many at least.
INERT, LEAST = 3.0, 3
#: Most coefficients of a motion with which all modes keep it: a second for their exponents.
ALL = 500
#: Exponent of a growth that is told.
MOST = 100.0
#: Samples with which stability is judged, at least.
SAMPLES = 2048
#: Growth of a disturbance in a period beyond which a motion is not stable.
GROWS = 1e-5
#: Multiplier of a disturbance that changes sign in a period from which on friction may let it grow:
#: motions that double their period had -0.63 here.
FLIPS = 0.5


def multipliers(balance: Balance, q: FloatArray, omega: float) -> FloatArray:
    """Floquet multipliers of a motion with coefficients ``q`` (nh, n), complex, largest first."""
    series, n = balance.series, balance.frequencies.size
    J = balance.residual(q, omega).derivative
    assert J is not None
    keeps = _inert(balance, omega)
    size, low = series.size, int(np.count_nonzero(keeps))
    own = np.tile(keeps, size)
    J = J.reshape(size * n, size * n) / np.outer(*[np.tile(balance.scale, size)] * 2)
    stiffness = J[np.ix_(own, own)]
    if not own.all():
        follows = linalg.solve(J[np.ix_(~own, ~own)], J[np.ix_(~own, own)])
        stiffness = stiffness - J[np.ix_(own, ~own)] @ follows
    by = np.tile(balance.scale[keeps], size) / omega  # of disturbances in periods
    stiffness = stiffness * np.outer(by, by)
    D = series.rate(np.eye(size))
    damping = np.kron(np.eye(size), balance.C[np.ix_(keeps, keeps)] / omega)
    damping = damping + np.kron(2.0 * D, np.eye(low))
    none, one = np.zeros_like(stiffness), np.eye(size * low)
    exponents = linalg.eigvals(np.block([[none, one], [-stiffness, -damping]]))
    nearest = np.argsort(np.abs(exponents.imag), kind="stable")[: 2 * low]
    turned = 2.0 * np.pi * exponents[nearest]
    found = np.exp(np.minimum(turned.real, MOST) + 1j * turned.imag)
    return np.asarray(found[np.argsort(-np.abs(found))])


def _inert(balance: Balance, omega: float) -> BoolArray:
    """Which modes, (n,), keep their inertia: all, if they are not too many."""
    if balance.series.size * balance.frequencies.size <= ALL:
        return np.ones(balance.frequencies.size, np.bool_)
    keeps = balance.frequencies <= INERT * balance.series.highest * omega
    keeps[:LEAST] = True
    return keeps


def stable(balance: Balance, q: FloatArray, omega: float, slips: bool) -> bool | None:
    """Whether no disturbance of a motion grows; None if that is not judged.

    With constant contact none does: friction is monotone. Where contact opens bodies that walk are
    not judged, nor, where friction slips, a disturbance that changes sign from period to period
    unless it decays fast.
    """
    if not balance.system.contact.opens:
        return True
    if balance.walks:
        return None
    # samples make a turning point many small ones, between which multipliers go to and fro
    series = balance.series
    fine = FourierSeries(series.highest, max(series.samples, SAMPLES), series.odd)
    found = multipliers(replace(balance, series=fine), q, omega)
    holds = bool(np.abs(found[0]) <= 1.0 + GROWS)
    if holds and slips and (found.real < -FLIPS).any():
        return None
    return holds if holds or _inert(balance, omega).all() else None
