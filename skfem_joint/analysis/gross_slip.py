"""Joints that slip as a whole: whether they do, and the load at which the first one does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.arrays import FloatArray, as_dense
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.slips import WHOLE_SHARE
from skfem_joint.stepping.levels import Level
from skfem_joint.stepping.quasi_static import QuasiStatic


@dataclass(frozen=True)
class GrossSlipSettings:
    """Numbers of gross slip.

    Attributes
    ----------
    above : float
        The search begins this much, relative, above the load at which the forces on the stuck
        joint add up to its limit.
    raised : float
        Factor of the load from one trial to the next.
    trials : int
        Most trials, up to 190 times the first load.
    near : float
        Where friction alone holds, the level is found to this, relative.
    """

    above: float = 0.01
    raised: float = 1.3
    trials: int = 20
    near: float = 0.02


SETTINGS = GrossSlipSettings()


def still_share(path: QuasiStatic) -> float:
    """Share of the largest slip below which a point of a path counts as sticking."""
    # Points whose slip is below this share of the largest slip count as sticking. In dense
    # systems, which have fewer unknowns than points, points cannot stick exactly: there the share
    # is a thousandth.
    return THRESHOLD if path.to.kind == "dense" else 1e-9


def sticking_share(path: QuasiStatic, slip: FloatArray, sliding: FloatArray | None = None) -> float:
    """Least share of a joint's friction limit whose points stick, by the slip (m,), m, of a state.

    ``sliding``, (m,), m, is that of the sliders, if some have springs in series.
    """
    own = slip if sliding is None else sliding
    return path.to.system.contact.least_share(own <= still_share(path) * slip.max(initial=0.0))


def is_gross(sticking: float) -> bool:
    """Whether a joint slips as a whole, by the share of its limit that sticks exactly."""
    return sticking <= 1.0 - WHOLE_SHARE


def gross_slip_level(
    path: QuasiStatic, force: FloatArray, stuck: FloatArray, limit: float, raised: bool = True
) -> float:
    """Multiple of a force at which the first joint slips as a whole.

    The load is raised from that at which the forces on a joint, with all joints stuck, add up to
    its friction limit: slip moves load to supports and to other joints. Where supports carry a
    part, the level is interpolated between the last two steps. Where friction alone holds, all
    joints slip at the load of limit analysis; where one slips as a whole before, the level lies
    within `GrossSlipSettings.near` above the last one at which none did.

    Parameters
    ----------
    path : QuasiStatic
        Of the system.
    force : ndarray, shape (n,)
        N, in the unknowns of ``path.to.system``.
    stuck : ndarray, shape (n,)
        Displacement, m, under that force with all joints stuck.
    limit : float
        Multiple of the force that friction can just hold, `QuasiStatic.limit`.
    raised : bool
        Where friction alone holds: whether levels are looked at beyond that at which the forces on
        a stuck joint add up to its limit; it is returned if not, unless a joint slips before.

    Returns
    -------
    float
        ``limit`` where the force loads no joint.

    Raises
    ------
    ConvergenceError
        If the response to a load does not converge.
    """
    system = path.to.system
    balanced = force - system.stuck_stiffness @ stuck
    # A dense system has more slip rows than unknowns: the smallest forces that hold it are taken.
    dense = path.to.kind == "dense"
    rows = (
        np.linalg.lstsq(as_dense(system.contact.B).T, balanced)[0]
        if dense
        else system.contact.B @ balanced
    )
    forces = system.contact.slip_norm(np.asarray(rows, dtype=float))
    if (
        system.contact.has_springs
    ):  # points may share an unknown, and each has the force of its spring
        stretched = system.contact.spring_constants * system.contact.slip_norm(
            np.asarray(system.contact.B @ stuck)
        )
        forces = np.where(system.contact.sprung, stretched, forces)
    by_joint, limits = system.contact.J @ forces, system.contact.J @ system.contact.w
    loaded = (by_joint > 0.0) & (limits > 0.0)
    if not loaded.any():
        return limit
    nominal = float((limits[loaded] / by_joint[loaded]).min())
    search = _FirstWhole(path, force)
    return search.held(nominal) if np.isinf(limit) else search.free(nominal, limit, raised)


@dataclass
class _FirstWhole:
    """Search for the multiple of a force at which the first joint slips as a whole.

    Attributes
    ----------
    path : QuasiStatic
    force : ndarray, shape (n,)
        N.
    """

    path: QuasiStatic
    force: FloatArray

    def sticking(self, level: float, start: tuple[float, Level]) -> tuple[float, Level]:
        """Least share of a joint's limit that sticks at a level, and the state there.

        ``start`` are a level and the state there.
        """
        system = self.path.to.system
        self.path.tally.total += 1
        (way,) = self.path.walk(start[1], self.force, np.array([start[0], level]))
        reached = way[-1][1]
        sliders = reached.slip - system.contact.spring_flexibility * reached.friction
        both = system.contact.slip_norm(reached.slip), system.contact.slip_norm(sliders)
        return sticking_share(self.path, *both), reached

    def held(self, nominal: float) -> float:
        """Level where supports carry a part of the load."""
        level, sticking = nominal * (1.0 + SETTINGS.above), 1.0
        start = 0.0, self.path.rest()
        for _ in range(SETTINGS.trials):
            last = sticking
            sticking, reached = self.sticking(level, start)
            if is_gross(sticking):
                if last == 1.0:  # at the first trial, or from all sticking to none
                    return nominal
                beyond = (1.0 - WHOLE_SHARE - sticking) / (last - sticking)
                return float(level * SETTINGS.raised**-beyond)
            start = level, reached
            level *= SETTINGS.raised
        # The basis of a dense system may not let a joint slip so far.
        return nominal

    def free(self, nominal: float, limit: float, raised: bool) -> float:
        """Level where friction alone holds, up to ``limit``."""
        state = self.path.rest()
        # Share of the load of limit analysis up to which joints are looked at one by one.
        low, high, last = 0.0, limit, 0.98 * limit
        level = min(nominal * (1.0 + SETTINGS.above), last)
        for _ in range(SETTINGS.trials):
            sticking, reached = self.sticking(level, (low, state))
            if is_gross(sticking):
                high = level
            elif level == last:
                return limit if raised else min(nominal, limit)
            elif not raised and high == limit:
                return nominal
            else:
                low, state = level, reached
            if high <= low * (1.0 + SETTINGS.near):
                break
            level = min(low * SETTINGS.raised, last) if high == limit else 0.5 * (low + high)
        return high if high < limit else low  # up to ``low`` none slips as a whole
