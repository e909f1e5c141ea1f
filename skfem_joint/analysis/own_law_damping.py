"""Friction damping of a mode under the system's own law, beside that of Coulomb's.

A law of finite steepness lets joints creep that Coulomb's law holds, and damps small vibration much
more. At a few levels a cycle is followed with the system's own law, at the speed that it has at the
frequency of the curve. The cycle is divided into small steps, which gives a work some percent below
the exact one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from skfem_joint.analysis.saved_path import SavedPath
from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import ConvergenceError
from skfem_joint.minimise.law import force as friction_force


@dataclass(frozen=True)
class OwnLawSettings:
    """Numbers of the damping by the system's own law.

    Attributes
    ----------
    increments : int
        Increments of each half of a cycle.
    differs : float
        A note says that the own law damps more where it does by more than this share.
    """

    increments: int = 16
    differs: float = 0.1


SETTINGS = OwnLawSettings()


def own_law_damping(
    path: SavedPath,
    mode: int,
    force: FloatArray,
    level: FloatArray,
    states: FloatArray,
    friction: FloatArray,
    coulomb: FloatArray,
    chosen: IntArray,
) -> tuple[FloatArray, list[str]]:
    """Damping ratio of friction by the system's own law.

    Cycles are followed at some of the levels; between them the difference from Coulomb's damping
    is interpolated over the logarithm of the level. It changes slowly: with beta = 100 s/m from
    0.76 to 0.45 % over a curve from 0.17 to 3 %.

    Parameters
    ----------
    path : SavedPath
        Of the system.
    mode : int
        Number of the mode, for the notes.
    force : ndarray, shape (n,)
        Inertia of the mode, N at level 1.
    level : ndarray, shape (levels,)
        Multiples of the force.
    states : ndarray, shape (levels, n)
        Displacements at the peaks, m, by Coulomb's law.
    friction : ndarray, shape (levels, rows)
        Friction over its limit at the peaks, which springs in series keep.
    coulomb : ndarray, shape (levels,)
        Damping ratios by Coulomb's law.
    chosen : ndarray of int
        Levels at which a cycle is followed.

    Returns
    -------
    damping : ndarray, shape (levels,)
        ``coulomb`` itself where that is the system's law; nan where a cycle does not converge.
    notes : list of str
        Where the two laws differ, or why the damping is not known.
    """
    system = path.to.system
    if np.isinf(system.beta[system.w > 0.0]).all():
        return coulomb, []
    omega = np.sqrt(level / (states @ force))
    path.tally.total += 2 * SETTINGS.increments * chosen.size
    path.rows.total += chosen.size
    own = np.empty(chosen.size)
    try:
        for row, k in enumerate(chosen):
            origin = path.origin, "own law", level[k], force, states[k], omega[k]
            peak = states[k], friction[k]
            compute = partial(_damping_at, path, level[k], force, peak, omega[k])
            own[row] = path.rows.row(path.rows.mark(*origin), compute)
    except ConvergenceError as error:
        note = f"Mode {mode}: how much the joints' own law damps is not known: {error}."
        return np.full_like(coulomb, np.nan), [note]
    difference = own - coulomb[chosen]
    damping = coulomb + np.interp(np.log(level), np.log(level[chosen]), difference)
    # Less than Coulomb's is no matter of the law: loops of slips that turn are rough with few
    # increments (7 to 10 % too much for a bolted plate at the highest level).
    if np.all(difference <= SETTINGS.differs * own):
        return damping, []
    return damping, [_note(path, mode, (states @ force)[chosen], coulomb[chosen], own)]


def _damping_at(
    path: SavedPath, level: float, force: FloatArray, peak: tuple[FloatArray, ...], omega: float
) -> float:
    """Damping ratio of friction at one level, by a cycle that begins at the state of its peak.

    ``peak`` is its displacement and its friction over the limit. Only the second half of the cycle
    counts, because the first one forgets where it began.
    """
    system, n = path.to.system, SETTINGS.increments
    turn = np.pi * np.arange(1, 2 * n + 1) / n
    top = level * force
    start = peak[0], top, *peak[1:]
    cycle = path.follow(np.outer(np.cos(turn), top), turn / omega, np.inf, start)
    half = cycle[n - 1 :]
    slip = np.asarray((system.B @ np.diff(half, axis=0).T).T)
    if system.has_springs:
        sigma = path.frictions[n - 1 :]
        slid = system.slider_slip(slip, np.diff(sigma, axis=0))
        work = float(np.vdot(system.on_rows(system.w) * sigma[1:], slid))
    else:
        size = system.slip_norm(slip).T
        speed = size * (n * omega / np.pi)
        friction = friction_force(speed, system.beta[:, np.newaxis]) * system.w[:, np.newaxis]
        work = float(np.vdot(friction, size))
    q = 0.5 * float(np.ptp(half @ force))
    return float(2.0 * work / (2.0 * np.pi * level * q))


def _note(path: SavedPath, mode: int, q: FloatArray, coulomb: FloatArray, own: FloatArray) -> str:
    """Sentence about the damping by the system's own law where it is not Coulomb's."""
    system = path.to.system
    beta = system.beta[(system.w > 0.0) & np.isfinite(system.beta)]
    shown = [
        f"{100 * b:.3g} % where the curve says {100 * a:.3g} % (modal amplitude {x:.3g})"
        for x, a, b in zip(q, coulomb, own, strict=True)
    ]
    return (
        f"Mode {mode}: the curve is of Coulomb's law. The joints' own, with beta = "
        f"{beta.min():.3g} s/m, lets them creep, and friction damps by {', '.join(shown)}; see "
        "own_law_damping. A ring-down and steady response have the joints' own law; a steeper "
        "beta, or none, brings them to the curve."
    )
