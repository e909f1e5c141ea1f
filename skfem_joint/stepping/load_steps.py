"""How loads divide a run: where its steps are cut, and the load amplitudes at the ends of steps."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.loads import Amplitude
from skfem_joint.system.system import System

#: Kinks of a load end steps only if there are at most so many; jumps always do.
MOST_KINKS = 64
#: Steps for which the loads are evaluated together. Blocks always begin at the same steps, so that
#: results do not depend on where a run is continued.
BLOCK = 16_384


def ends_steps(amplitude: Amplitude, end: float) -> bool:
    """Whether all kinks of a load up to the time ``end``, s, end steps: few enough of them."""
    return sum(0.0 <= t <= end for t in amplitude.corners) <= MOST_KINKS


class LoadSteps:
    """Steps of a run, cut where its loads jump or kink, with the load amplitudes at their ends.

    Parameters
    ----------
    system : System
    h : float
        Time step, s.
    n_steps : int
        Number of steps.

    Attributes
    ----------
    jumps : dict of float to tuple of float
        By the end of a step or part of one: the times of the loads' first and last jump there, s.
    cuts : dict of int to list of float
        By number of the step: the times at which it is cut, s; none if it only has to be done
        alone, as the first step and those before and after a jump are.
    """

    def __init__(self, system: System, h: float, n_steps: int) -> None:
        self.system, self.h, self.n_steps = system, h, n_steps
        self.jumps: dict[float, tuple[float, float]] = {}
        self.cuts: dict[int, list[float]] = {0: []}
        # Number and load amplitudes of the block of steps that was evaluated last.
        self._block: tuple[int, FloatArray] = (-1, np.zeros((0, 0)))
        for load in system.loads:
            jumps = set(load.amplitude.jumps)
            last = (n_steps + 1e-9) * h  # the latest time that counts as the end
            kinks = ends_steps(load.amplitude, last)
            for t in load.amplitude.corners:
                if 0.0 <= t <= last and (t in jumps or kinks):
                    self._cut(t, t in jumps)
        self._order = sorted(self.cuts)

    def _cut(self, t: float, jump: bool) -> None:
        """Cut the step in which a load jumps or kinks."""
        h = self.h
        k = round(t / h)
        on_grid = abs(t - k * h) <= 1e-9 * h
        if jump:
            at = k * h if on_grid else t
            first, last = self.jumps.get(at, (t, t))
            self.jumps[at] = min(first, t), max(last, t)
            if on_grid and 0 < k < self.n_steps:
                self.cuts.setdefault(k - 1, [])
                self.cuts.setdefault(k, [])
        if not on_grid:
            cuts = self.cuts.setdefault(int(t // h), [])
            if t not in cuts:
                cuts.append(t)

    def next_cut(self, first: int) -> int | None:
        """Number of the first step from ``first`` on that is cut or done alone, if there is one."""
        place = bisect_left(self._order, first)
        return self._order[place] if place < len(self._order) else None

    def parts(self, step: int) -> list[float]:
        """Ends of the parts of a step that is cut, from its start to its end, s."""
        return [self.h * step, *sorted(self.cuts[step]), self.h * (step + 1)]

    def end_of_block(self, step: int) -> int:
        """First step of the block after that of a step."""
        return (step // BLOCK + 1) * BLOCK

    def of_steps(self, first: int, end: int) -> FloatArray:
        """Load amplitudes (loads, end - first + 1), N, at the ends of steps within one block."""
        number = first // BLOCK
        begin = number * BLOCK
        if self._block[0] != number:
            last = min(begin + BLOCK, self.n_steps)
            times = self.h * np.arange(begin, last + 1, dtype=np.float64)
            self._block = number, self.system.load_amplitudes(times)
        amplitudes = self._block[1][:, first - begin : end - begin + 1].copy()
        return self._from_inside(amplitudes, self.h * first, self.h * end)

    def at(self, *times: float) -> FloatArray:
        """Load amplitudes (loads, times), N, at the start, or at start and end, of a part (s)."""
        amplitudes = self.system.load_amplitudes(np.array(times))
        return self._from_inside(amplitudes, times[0], times[-1])

    def _from_inside(self, amplitudes: FloatArray, first: float, last: float) -> FloatArray:
        """Put in the limits from inside where loads jump at the first and the last time."""
        if last in self.jumps and last > first:
            before = np.nextafter(self.jumps[last][0], -np.inf)
            amplitudes[:, -1] = self.system.load_amplitudes(np.array([before]))[:, 0]
        if first in self.jumps:
            after = np.nextafter(self.jumps[first][1], np.inf)
            amplitudes[:, 0] = self.system.load_amplitudes(np.array([after]))[:, 0]
        return amplitudes
