"""Steady vibration with contact that opens: the state that marching through periods leads to.

Friction limits follow the normal forces then, and faces hit each other. Friction is not monotone
(:mod:`skfem_joint.steady.steady`): two runs under the same loads may move apart, so that the map
of a period may expand. There may be several steady vibrations, and some from which any disturbance
grows; vibration may also repeat after several periods of the loads alone, or never. Contact is
one-sided, so that halves of a period are no mirror images: the map is that of a whole period.

All that a step starts from is the state: displacement, velocity, the scheme's accelerations,
friction, normal forces and friction limits. Its size is measured by mass and stiffness, where rigid
contact counts with the stiffness that the structure itself opposes to single points, for what rests
on contact alone has none.

The search has these parts.

- The first periods are marched through. Where points come to rest is decided there: mixing moves
  them to other places: of blocks that lift off, amplitudes differed from those of a long run by up
  to 3e-4 without these periods and by up to 8e-6 with 20 of them, after as many periods in all.
- Anderson's acceleration, as in :mod:`skfem_joint.steady.steady`. A mixture must not press faces
  into each other more than a state that was marched to has: a closed point stays where it is, so
  that a penetration would stay. It is shortened towards the last end of a period until it does not.
- Newton's method in place of that in models of few unknowns, whose contact is elastic and whose
  points creep. (A block lifted by 0.3 of what nearly lifts it off still changed by 5e-6 after 500
  periods of mixing with 15 unknowns; with 23 Newton's method took 36 to 40 periods in all.)
- A state at which the change over a period is small is disturbed a little, and marched on from for
  some periods. If the disturbance grows, marching leads away from that state. Else it is the
  result, after a last period that is marched through, so that it obeys the equations of the steps.
- Then, and where mixing comes no closer, the search is marching alone. Ends of some earlier periods
  are kept: if one of them is met again the vibration has a longer period, which the error says.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.steady.steady import (
    DISTANCE,
    EXACT,
    Anderson,
    EnergyNorm,
    Newton,
    Passage,
    PeriodMap,
    Place,
    Search,
    settles,
)
from skfem_joint.system.system import System

# Most periods of the search.
_PERIODS = 500
#: A disturbance grows if its largest size in the last three periods is more than this factor times
#: that in the three before: where it grows by 2 % in a period.
GROWN = 1.05


#: What a result says that has contact that opens.
MAY_DEPEND = (
    "With contact that opens a steady vibration need not be the only one: which one is reached may "
    "depend on how the vibration began. A run over given cycles shows where it leads from its "
    "start."
)


def opening_norm(system: System) -> EnergyNorm:
    """Norm of states of a system with contact that opens, see the module."""
    contact, K = system.contact.normal, system.K
    if not system.contact.opens:
        return EnergyNorm(K, system.M)
    stiffness = np.where(contact.rigid, contact.opposed(K), contact.stiffness)
    springs = contact.with_springs(stiffness)
    return EnergyNorm(K + (as_dense(springs) if system.is_dense else springs), system.M)


class Marching:
    """A search, see the module; arguments are those of `skfem_joint.steady.steady.periodic_state`.

    Attributes
    ----------
    x : ndarray
        Where the next period starts.
    alone : bool
        Whether it is marching alone.
    ends : list of ndarray
        Last ends of periods since then.
    """

    def __init__(
        self, start: FloatArray, through: PeriodMap, place: Place, changes: list[float]
    ) -> None:
        self.through, self.place, self.changes = through, place, changes
        self.norm, self.mixing = through.norm, Anderson(through.norm)
        self.newton = Newton(through.norm)
        self.n, self.x, self.alone = len(place.motions), place.without(start), False
        self.ends: list[FloatArray] = []

    def run(self) -> Search:
        """Search to its end; result and errors are those of `periodic_state`."""
        least, since, endured = np.inf, 0, False
        while len(self.changes) < _PERIODS:
            end, size, scale, settled = yield from self._period()
            after = self.place.without(end)
            if settled and (self.alone or endured):
                return np.asarray(end[: self.n] - after[: self.n])
            since += 1
            if size <= 0.5 * least:
                least, since = size, 0
            # Where the least change has not halved in so many periods follows marching alone.
            self.alone = self.alone or since > 40
            if len(self.changes) < 20:  # marched through before mixing begins
                self.x = after
            elif self.alone:
                self._refuse_longer(after, size)
                self.x = after
            elif settled:
                endured = yield from self._endures(after, scale)
                self.alone = not endured
            else:
                self.x, endured = self._better(after), False
        raise ConvergenceError(
            f"no steady vibration was found in {_PERIODS} periods: the state still changes "
            f"by {self.changes[-1]:.2g} of its size over the last. With contact that opens "
            "vibration need not repeat after a period of the loads, or at all: give cycles in "
            "place of until = 'steady' and follow it. Light damping forgets slowly, too: more of "
            "it takes fewer periods, best by [damping] stiffness, which damps high frequencies "
            "most, in a reduced model"
        )

    def _period(self) -> Generator[FloatArray, Passage, tuple[FloatArray, float, float, bool]]:
        """Go through a period: its end, the change, the largest state, and whether it is steady."""
        x, norm = self.x, self.norm
        end, energy, work, _ = yield x
        after = self.place.without(end)
        size, scale = self.mixing.add(after, after - x), float(np.sqrt(2.0 * energy))
        self.changes.append(size / scale if scale > 0.0 else 0.0)
        gained = 0.5 * (norm.squared(after) - norm.squared(x))
        left = self.changes[-1]
        settled = settles(left, gained, energy, work) and (
            left <= EXACT or norm(self._fixed(after) - x) <= DISTANCE * scale
        )
        return end, size, scale, settled

    def _fixed(self, after: FloatArray) -> FloatArray:
        """Fixed point as Newton's method sees it from the last period, or else as mixing does."""
        derivative = None if self.through.patience is None else self.through.derivative()
        if derivative is None:
            return self.mixing.mixed()
        return self.x + derivative.step(after - self.x, 0.0)

    def _better(self, after: FloatArray) -> FloatArray:
        """Where the next period starts: by Newton's method with a derivative, or else mixed."""
        if self.through.patience is not None:
            step = self.newton.next(self.x, after - self.x, self.through.derivative)
            if step is not None:
                return self.place.without(step)
        return self._mixture(self.mixing.mixed())

    def _endures(self, found: FloatArray, scale: float) -> Generator[FloatArray, Passage, bool]:
        """Whether a disturbance of a state that was found does not grow.

        The search goes on from that state if so, else from where the disturbance leads. It has the
        direction of an earlier state of the search, in which there is what is slow to vanish.
        """
        away = self.mixing.states[0] - found
        size = self.norm(away)
        if size == 0.0:
            self.x = found
            return True
        # A ten-thousandth of the largest state in the period.
        away *= 1e-4 * scale / size
        disturbed = [self._mixture(found + away), self._mixture(found - away)]
        self.x = max(disturbed, key=lambda x: self.norm(x - found))
        apart = []
        for _ in range(10):  # periods
            end = (yield self.x).end
            self.x = self.place.without(end)
            apart.append(self.norm(self.x - found))
            self.changes.append(apart[-1] / scale)
        if max(apart[-3:]) > GROWN * max(apart[-6:-3]):
            return False
        self.x = found
        return True

    def _refuse_longer(self, after: FloatArray, size: float) -> None:
        """Keep an end of a period; ConvergenceError if it is that of some periods ago."""
        self.ends.append(after)
        del self.ends[:-9]  # of eight periods, the longest vibration that is recognised
        for count in range(2, len(self.ends)):
            # An earlier state is met again if it is so near, beside the change over a period.
            if self.norm(after - self.ends[-1 - count]) <= 1e-4 * size:
                raise ConvergenceError(
                    f"no steady vibration was found: it repeats after {count} periods of the "
                    "loads, not after one, as contact that opens allows. Give cycles in place of "
                    "until = 'steady' and follow it"
                )

    def _mixture(self, mixed: FloatArray) -> FloatArray:
        """Mixture of states, shortened to the last where rigid faces would lie deeper than in all.

        Gaps are linear in the displacement.
        """
        states, contact = self.mixing.states, self.through.contact
        rigid = contact.rigid
        if not rigid.any():
            return mixed
        gaps = contact.gaps(np.array([x[: self.n] for x in (*states, mixed)]))[:, rigid]
        deepest = np.minimum(gaps[:-1].min(axis=0), 0.0)
        # Round-off of a mixture is no penetration.
        deepest -= 1e-12 * float(np.abs(mixed[: self.n]).max(initial=0.0))
        last, new = gaps[-2], gaps[-1]
        below = new < deepest
        if not below.any():
            return mixed
        share = float(((last - deepest)[below] / (last - new)[below]).min())
        return np.asarray(states[-1] + share * (mixed - states[-1]))
