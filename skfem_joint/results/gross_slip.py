"""Joints that slip as a whole: whether they do, and the load at which the first one does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.slow.levels import Level
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.system.slips import WHOLE_SHARE

#: The search begins this much, relative, above the load at which the forces on the stuck joint add
#: up to its limit.
ABOVE = 0.01
#: Factor of the load from one trial to the next, and the most trials: up to 190 times the first.
RAISED, TRIALS = 1.3, 20
#: The level is found to this, relative. Interpolated over `RAISED`, it was 0 to 15 % high.
NEAR = 0.02


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
    its friction limit: slip moves load to supports and to other joints. The level lies within
    `NEAR` above the last one at which no joint slips as a whole; where friction alone holds, all
    joints slip at the load of limit analysis at the latest.

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
    system, contact = path.to.system, path.to.system.contact
    rows = force - system.stuck_stiffness @ stuck
    if path.to.kind == "dense":  # more slip rows than unknowns: the smallest forces that hold it
        rows = np.linalg.lstsq(as_dense(contact.B).T, rows)[0]
    else:
        rows = contact.B @ rows
    forces = contact.slip_norm(np.asarray(rows, dtype=float))
    if contact.has_springs:  # points may share an unknown, and each has the force of its spring
        stretched = contact.spring_constants * contact.slip_norm(np.asarray(contact.B @ stuck))
        forces = np.where(contact.sprung, stretched, forces)
    by_joint, limits = contact.J @ forces, contact.J @ contact.w
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
        contact = self.path.to.system.contact
        self.path.tally.total += 1
        (way,) = self.path.walk(start[1], self.force, np.array([start[0], level]))
        reached = way[-1][1]
        sliders = reached.slip - contact.spring_flexibility * reached.friction
        both = contact.slip_norm(reached.slip), contact.slip_norm(sliders)
        return sticking_share(self.path, *both), reached

    def held(self, nominal: float) -> float:
        """Level where supports carry a part of the load."""
        state, low, high = self.path.rest(), 0.0, np.inf
        level = nominal * (1.0 + ABOVE)
        while level <= nominal * RAISED**TRIALS:
            sticking, reached = self.sticking(level, (low, state))
            if is_gross(sticking):
                high = level
            else:
                low, state = level, reached
            if low == 0.0:  # at the first trial
                break
            if high <= low * (1.0 + NEAR):
                return high
            level = 0.5 * (low + high) if np.isfinite(high) else level * RAISED
        # The basis of a dense system may not let a joint slip so far.
        return nominal

    def free(self, nominal: float, limit: float, raised: bool) -> float:
        """Level where friction alone holds, up to ``limit``."""
        state = self.path.rest()
        # Share of the load of limit analysis up to which joints are looked at one by one.
        low, high, last = 0.0, limit, 0.98 * limit
        level = min(nominal * (1.0 + ABOVE), last)
        for _ in range(TRIALS):
            sticking, reached = self.sticking(level, (low, state))
            if is_gross(sticking):
                high = level
            elif level == last:
                return limit if raised else min(nominal, limit)
            elif not raised and high == limit:
                return nominal
            else:
                low, state = level, reached
            if high <= low * (1.0 + NEAR):
                break
            level = min(low * RAISED, last) if high == limit else 0.5 * (low + high)
        return high if high < limit else low  # up to ``low`` none slips as a whole
