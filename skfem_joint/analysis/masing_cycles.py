"""Cycles of a load with constant friction limits: by Masing's rule where slip keeps its direction.

The unloading path is then the loading path doubled, so that the work of a cycle is 4 sum w |slip|
without following it. Cycles are followed at some levels to check the rule; the ratio of the two
works, interpolated over the level, corrects the others. Where slip turns far the rule fails, and a
cycle is followed at each level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.analysis.cycles import Cycles, spread
from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.stepping.quasi_static import QuasiStatic
from skfem_joint.system import System


@dataclass(frozen=True)
class MasingSettings:
    """Numbers of cycles with constant friction limits.

    Attributes
    ----------
    increments : int
        Increments of each half of a cycle that is followed.
    checked : int
        Levels at which cycles are followed to check Masing's rule.
    idle : float
        Work of a cycle over that of its load below which it is round-off.
    turned : float
        Masing's rule is given up where the slip added up along the path is more than this times
        the slip at its end.
    """

    increments: int = 4
    checked: int = 3
    idle: float = 1e-12
    turned: float = 1.05


SETTINGS = MasingSettings()


def levels_to_follow(levels: int) -> int:
    """Quasi-static levels of so many cycles, as far as it is known before slip turns."""
    return levels + SETTINGS.increments * min(SETTINGS.checked, levels)


def masing_cycles(path: QuasiStatic, force: FloatArray, level: FloatArray) -> Cycles:
    """Cycles of a force (n,), N, between both signs of some levels, from rest.

    Raises
    ------
    ConvergenceError
        If a level does not converge.
    """
    system = path.to.system
    states = path.follow(np.outer(level, force), limit_share=np.inf)
    friction = path.frictions
    rows = np.asarray((system.contact.B @ states.T).T)
    sliders = system.contact.slider_slip(rows, friction)
    slip, sliding = system.contact.slip_norm(rows), system.contact.slip_norm(sliders)
    work, masing = 4.0 * sliding @ system.contact.w, keeps_direction(system, sliders)
    followed = spread(level.size, SETTINGS.checked) if masing else np.arange(level.size)
    energy = level * (states @ force)
    followed = followed[work[followed] > SETTINGS.idle * energy[followed]]
    loops, turned = _half_cycles(path, level, force, states, friction, followed)
    slid = system.contact.slider_slip(np.asarray((system.contact.B @ loops.T).T), turned)
    cycle = 2.0 * (system.contact.slip_norm(slid) @ system.contact.w).reshape(
        -1, SETTINGS.increments
    ).sum(axis=1)
    ratio = cycle / work[followed]
    error = float(np.abs(ratio - 1.0).max(initial=0.0)) if masing else None
    work *= between(level, followed, ratio)
    return Cycles(
        level, states, work, slip, sliding, friction, loops, turned, followed,
        masing_error=error, shift=path.shift,
    )  # fmt: skip


def keeps_direction(system: System, sliders: FloatArray) -> bool:
    """Whether slips of sliders (levels, rows), m, keep their directions, as Masing's rule needs."""
    along_the_path = np.cumsum(
        system.contact.slip_norm(np.diff(sliders, axis=0, prepend=0.0)), axis=0
    )
    slip = system.contact.slip_norm(sliders)
    return bool(
        np.all(along_the_path @ system.contact.w <= SETTINGS.turned * (slip @ system.contact.w))
    )


def between(level: FloatArray, followed: IntArray, ratio: FloatArray) -> FloatArray:
    """Ratios at all levels, (levels, ...), from those (followed, ...) of some; 1 without any."""
    if not followed.size:
        return np.ones(level.size)
    known, at = np.log(level[followed]), np.log(level)
    columns = [np.interp(at, known, column) for column in np.atleast_2d(ratio.T)]
    return np.array(columns).T.reshape(level.size, *ratio.shape[1:])


def _half_cycles(
    path: QuasiStatic,
    level: FloatArray,
    force: FloatArray,
    states: FloatArray,
    friction: FloatArray,
    followed: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """Increments (increments, n), m, of half cycles from some levels.

    Also returns those of the friction over its limit, (increments, rows).
    """
    path.tally.total += SETTINGS.increments * (followed.size - min(SETTINGS.checked, level.size))
    parts = [_half_cycle(path, level[k] * force, states[k], friction[k]) for k in followed]
    increments = np.reshape([part[0] for part in parts], (-1, states.shape[1]))
    turned = np.reshape([part[1] for part in parts], (-1, friction.shape[1]))
    return increments, turned


def _half_cycle(
    path: QuasiStatic, force: FloatArray, state: FloatArray, friction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Increments of displacement (increments, n), m, from a state to its mirror image.

    Also returns those of the friction over its limit, (increments, rows).
    """
    turn = np.linspace(1.0, -1.0, SETTINGS.increments + 1)[1:]
    start = state, force, friction
    states = path.follow(np.outer(turn, force), limit_share=np.inf, start=start)
    frictions = np.vstack([friction, path.frictions])
    return np.diff(np.vstack([state, states]), axis=0), np.diff(frictions, axis=0)
