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
from skfem_joint.analysis.saved_path import SavedPath
from skfem_joint.arrays import FloatArray


@dataclass(frozen=True)
class MasingSettings:
    """Numbers of cycles with constant friction limits.

    Attributes
    ----------
    increments : int
        Increments of each half of a cycle that is followed.
    checked : int
        Levels at which cycles are followed to check Masing's rule.
    turned : float
        Masing's rule is given up where the slip added up along the path is more than this times
        the slip at its end.
    """

    increments: int = 4
    checked: int = 3
    turned: float = 1.05


SETTINGS = MasingSettings()


def levels_to_follow(levels: int) -> int:
    """Quasi-static levels of so many cycles, as far as it is known before slip turns."""
    return levels + SETTINGS.increments * min(SETTINGS.checked, levels)


def masing_cycles(path: SavedPath, force: FloatArray, level: FloatArray) -> Cycles:
    """Cycles of a force (n,), N, between both signs of some levels, from rest.

    Raises
    ------
    ConvergenceError
        If a level does not converge.
    """
    system = path.to.system
    states = path.follow(np.outer(level, force), limit_share=np.inf)
    friction = path.frictions
    work, loops, masing_error = _friction_work(path, level, force, states, friction)
    rows = np.asarray((system.B @ states.T).T)
    slip = system.slip_norm(rows)
    sliding = system.slip_norm(system.slider_slip(rows, friction))
    return Cycles(level, states, work, slip, sliding, friction, loops, masing_error)


def _friction_work(
    path: SavedPath,
    level: FloatArray,
    force: FloatArray,
    states: FloatArray,
    friction: FloatArray,
) -> tuple[FloatArray, FloatArray, float | None]:
    """Work of friction in a cycle at each level, (levels,), J.

    Returns also the increments (k, n), m, of the half cycles that were followed, and the largest
    relative error of Masing's rule; None where it was not used.
    """
    system = path.to.system
    rows = system.slider_slip(np.asarray((system.B @ states.T).T), friction)
    slip = system.slip_norm(rows)
    work = 4.0 * slip @ system.w
    along_the_path = np.cumsum(system.slip_norm(np.diff(rows, axis=0, prepend=0.0)), axis=0)
    masing = bool(np.all(along_the_path @ system.w <= SETTINGS.turned * (slip @ system.w)))
    followed = spread(level.size, SETTINGS.checked) if masing else np.arange(level.size)
    followed = followed[work[followed] > 0.0]
    more = SETTINGS.increments * (followed.size - min(SETTINGS.checked, level.size))
    path.tally.total += more
    path.rows.total += more
    parts = [_half_cycle(path, level[k] * force, states[k], friction[k]) for k in followed]
    increments = np.reshape([part[0] for part in parts], (-1, system.n))
    turned = np.reshape([part[1] for part in parts], (-1, system.B.shape[0]))
    slid = system.slider_slip(np.asarray((system.B @ increments.T).T), turned)
    dissipated = system.slip_norm(slid) @ system.w
    cycle = 2.0 * dissipated.reshape(-1, SETTINGS.increments).sum(axis=1)
    ratio = cycle / work[followed]
    if followed.size:
        work *= np.interp(np.log(level), np.log(level[followed]), ratio)
    error = float(np.abs(ratio - 1.0).max(initial=0.0)) if masing else None
    return work, increments, error


def _half_cycle(
    path: SavedPath, force: FloatArray, state: FloatArray, friction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Increments of displacement (increments, n), m, from a state to its mirror image.

    Also returns those of the friction over its limit, (increments, rows).
    """
    turn = np.linspace(1.0, -1.0, SETTINGS.increments + 1)[1:]
    start = state, force, *([friction] if path.to.system.has_springs else [])
    states = path.follow(np.outer(turn, force), limit_share=np.inf, start=start)
    frictions = np.vstack([friction, path.frictions])
    return np.diff(np.vstack([state, states]), axis=0), np.diff(frictions, axis=0)
