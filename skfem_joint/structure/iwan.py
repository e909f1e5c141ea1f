"""The four-parameter Iwan model of Segalman: a whole joint as elastic sliders in parallel.

An Iwan model is a distribution of elastic sliders over the slip phi (m) at which each begins to
slide. Segalman (J. Appl. Mech. 72, 2005) takes

    rho(phi) = R phi^chi on 0 < phi < phi_max, and S delta(phi - phi_max),

sliders of stiffness rho dphi and limit rho phi dphi. With the force F_S at which all slide, the
stiffness K_T while all stick, chi in (-1, 0] and beta = S (chi + 1) / (R phi_max^(chi + 1)) >= 0,

    phi_max = F_S (1 + beta) / (K_T (beta + (chi + 1) / (chi + 2))).

Its force at a first slip x <= phi_max, and the energy of a cycle between +-x, are

    F(x) = K_T x - R x^(chi + 2) / ((chi + 1) (chi + 2)),
    D(x) = 4 R x^(chi + 3) / ((chi + 2) (chi + 3)).

With a number of sliders D is a line with kinks in place of a curve. The sliders stand where it
touches the curve (1 + t) D at the ends of intervals, which are equal on a logarithmic axis from
``least`` phi_max up, so that the relative error is +t at the ends and -t between them: no other
places of as many kinks give a smaller largest error. It is

    t = (chi + 2)(chi + 3) / 16  (step of ln phi)^2.

Sliders below ``least`` stand in pairs by Gauss's rule, in intervals that become longer towards zero
so that the force, relative to F_S, errs alike in all of them.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import refuse
from skfem_joint.ground.values import NOT_NEGATIVE, POSITIVE, Kind, at_least, problems
from skfem_joint.joint.contact import point_friction
from skfem_joint.system.slips import SlipRows
from skfem_joint.system.unknowns import stacked

#: Share of the sliders below ``least``, but for a factor that depends on it: with this one the
#: force errs there by about half of what the energy may err by.
_BELOW = 0.5


def iwan(
    row: Any,
    F_S: float,
    K_T: float,
    chi: float,
    beta: float,
    *,
    sliders: int = 100,
    least: float = 0.25,
    name: str = "contact",
) -> SlipRows:
    """Four-parameter Iwan model of a whole joint, by Segalman (2005).

    Parameters
    ----------
    row : array_like, shape (N,) or (2, N)
        Slip of the joint from the degrees of freedom, as `point_friction` takes it. With two
        directions each slider is isotropic.
    F_S : float
        Force at which the whole joint slips, N.
    K_T : float
        Stiffness of the joint at small loads, N/m.
    chi : float
        Exponent, above -1 and at most 0: in micro-slip the energy of a cycle rises with the power
        3 + chi of the amplitude.
    beta : float
        Segalman's ratio of stiffnesses, at least 0; not the steepness of an arctan law.
    sliders : int
        Number of elastic sliders, at least 20.
    least : float
        Amplitude from which on energies are accurate, as a share of the slip at which the whole
        joint slips, between 0.001 and 0.9. With 100 sliders and the default the energy of a cycle
        errs by less than 1e-4; with another it errs by about (chi + 2) (chi + 3) / 16 times the
        square of ln(1 / least) over three quarters of the sliders. Smaller amplitudes are left to
        few sliders, which have the right force but not the right energy. With 100 sliders and the
        default it errs, for chi = 0, -0.3, -0.5 and -0.8, by up to 26, 9, 5 and 2 % down to a
        tenth of ``least``, and below by up to +110, +135, +168 and +335 %; it is zero (-100 %)
        below the first slider, at 0.036, 0.015, 0.0055 and 0.0006 of ``least``. Where energies at
        small amplitudes matter take the smallest of them for ``least``, with more sliders.
    name : str
        Joint under which results state its friction energy.

    Returns
    -------
    SlipRows
        For :meth:`skfem_joint.System.from_matrices`; a contact point for each slider.

    Raises
    ------
    InputError
        For numbers out of range, and rows that `point_friction` refuses.
    """
    wrong = [*problems("iwan: F_S", F_S, POSITIVE), *problems("iwan: K_T", K_T, POSITIVE)]
    wrong += problems("iwan: chi", chi, Kind("above -1 and at most 0", lambda x: -1.0 < x <= 0.0))
    wrong += problems("iwan: beta", beta, NOT_NEGATIVE)
    wrong += problems("iwan: sliders", sliders, at_least(20))
    wrong += problems("iwan: least", least, Kind("from 0.001 to 0.9", lambda x: 1e-3 <= x <= 0.9))
    refuse(wrong)
    one = point_friction(row, F_S, stiffness=K_T, name=name)
    stiffness, w = sliders_of(F_S, K_T, chi, beta, sliders, least)
    count = w.size
    return replace(
        one,
        B=stacked(count * [one.B], one.B.shape[1]),
        w=w,
        beta=np.full(count, np.inf),
        stiffness=stiffness,
        normal=None,
        directions=np.repeat(one.directions, count),
        names=one.names * count,
    )


def sliders_of(
    F_S: float, K_T: float, chi: float, beta: float, count: int, least: float
) -> tuple[FloatArray, FloatArray]:
    """Stiffness (N/m) and limit (N) of each slider; arguments as those of `iwan`.

    The limits add up to F_S, the stiffnesses to K_T.
    """
    phi_max = F_S * (1.0 + beta) / (K_T * (beta + (chi + 1.0) / (chi + 2.0)))
    R = K_T * (chi + 1.0) / ((1.0 + beta) * phi_max ** (chi + 1.0))
    power = 0.5 * (chi + 2.0)
    wanted = _BELOW * count * least**power / np.sqrt(power)
    pairs = max(2, round(0.5 * min(wanted, count / 3.0)))
    above = count - 2 * pairs - 1  # the last slider is the one at phi_max
    step = -np.log(least) / above
    low = least * np.linspace(0.0, 1.0, pairs + 1) ** (1.0 / power)
    w, phi = _gauss(phi_max * low, chi)
    ends = phi_max * least * np.exp(step * np.arange(above + 1))
    ends[-1] = phi_max
    # Between two ends the line has the slopes of the curve there: limit and place of the kink.
    first, second = (_moment(ends, chi, power) for power in (1, 2))
    share = 1.0 + (chi + 2.0) * (chi + 3.0) / 16.0 * step**2
    w, phi = R * share * np.append(w, first), np.append(phi, second / first)
    # What is left of the limit slides at phi_max, or is the last slider's.
    rest = F_S - w.sum()
    if rest > 0.0:
        w, phi = np.append(w, rest), np.append(phi, phi_max)
    else:
        w[-1] += rest
    stiffness = w / phi
    left = K_T - stiffness.sum()
    if left > -0.5 * stiffness[0]:  # a slider that slides at once, nearly
        stiffness[0] += left
    else:
        stiffness *= K_T / stiffness.sum()
    return stiffness, w


def _moment(ends: FloatArray, chi: float, power: int) -> FloatArray:
    """Integrals of phi^(chi + power) over the intervals between some ends."""
    return np.asarray(np.diff(ends ** (chi + 1.0 + power)) / (chi + 1.0 + power))


def _gauss(ends: FloatArray, chi: float) -> tuple[FloatArray, FloatArray]:
    """Limits and places of two sliders in each interval by Gauss's rule for the weight phi^chi.

    They have the stiffness, the limit and the loss of the interval.
    """
    w, phi = [], []
    for a, b in pairwise(ends.tolist()):
        m = [float(_moment(np.array([a / b, 1.0]), chi, power)[0]) for power in range(4)]
        hankel = np.array([[m[0], m[1]], [m[1], m[2]]])
        c = np.linalg.solve(hankel, -np.array([m[2], m[3]]))
        nodes = np.sort(np.roots([1.0, c[1], c[0]]).real)
        weights = np.linalg.solve(np.vander(nodes, increasing=True).T, m[:2])
        phi.append(b * nodes)
        w.append(weights * nodes * b ** (chi + 2.0))
    return np.concatenate(w), np.concatenate(phi)
