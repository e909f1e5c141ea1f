"""Levels of a nonlinear mode: followed upwards, and found again with other equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.progress import Tally
from skfem_joint.harmonic.mode_equations import ModeEquations
from skfem_joint.harmonic.newton import SAME, TOLERANCE, BranchPoint, branch, by_parameter, solved
from skfem_joint.harmonic.series import FourierSeries

#: Amplitudes over the first one from which a mode is followed: the first at which contact sticks
#: and stays closed, or the last.
BELOW = 1.0, 0.3, 0.1, 1e-2, 1e-3
#: Size of a motion over that at the start below which a branch is not followed downwards, and most
#: steps to a level that is found again.
LOWEST, FEW = 0.3, 50
#: Damping below this share of the largest counts as so large, where its relative change is taken.
LEAST = 0.02
#: Damping ratio below which there is none: Newton's iteration finds no smaller one for sure.
NEGLIGIBLE = TOLERANCE
#: Share of a residual beyond which a step of an earlier derivative is not taken: a new one takes as
#: long as 4 to 40 steps. Along branches each step has its own.
SERVES = 0.9


@dataclass(frozen=True)
class Levels:
    """A mode at some amplitudes.

    Attributes
    ----------
    equations : ModeEquations
        Which they solve.
    amplitudes : ndarray, shape (levels,)
        m, or m kg^1/2.
    u : ndarray, shape (levels, nh, n)
        Coefficients of the unknowns of the system, m.
    omega, zeta : ndarray, shape (levels,)
        Angular frequency, rad/s, and damping ratio.
    met : ndarray of int, shape (levels,)
        How often the branch has met each amplitude; values are those of the first time.
    """

    equations: ModeEquations
    amplitudes: FloatArray
    u: FloatArray
    omega: FloatArray
    zeta: FloatArray
    met: IntArray

    def only(self, rows: BoolArray) -> Levels:
        """Some levels alone."""
        a, u, omega, zeta = (x[rows] for x in (self.amplitudes, self.u, self.omega, self.zeta))
        return Levels(self.equations, a, u, omega, zeta, self.met[rows])

    @property
    def series(self) -> FourierSeries:
        """Harmonics and samples."""
        return self.equations.balance.series

    @property
    def values(self) -> dict[str, FloatArray]:
        """Frequency, rad/s, and damping ratio by name."""
        return {"frequency": self.omega, "damping_ratio": self.zeta}


def _levels(equations: ModeEquations, points: Sequence[FloatArray], met: IntArray) -> Levels:
    """From unknowns at amplitudes."""
    parts = [equations.parts(x) for x in points]
    shape = len(parts), equations.balance.series.size, equations.balance.system.n
    u = np.array([equations.balance.outer(q) for q, *_ in parts]).reshape(shape)
    omega, zeta, amplitudes = np.array([x for _, *x in parts]).reshape(-1, 3).T
    return Levels(equations, amplitudes, u, omega, zeta, met)


def chosen(rungs: Sequence[Levels], numbers: IntArray) -> Levels:
    """Each level as in the rung of its number, (levels,), with the harmonics of the finest one."""
    finest = rungs[int(numbers.max())]
    own = [rungs[k] for k in numbers.tolist()]
    u = [finest.series.of(levels.u[i], levels.series) for i, levels in enumerate(own)]
    omega, zeta = (
        np.array([getattr(levels, name)[i] for i, levels in enumerate(own)])
        for name in ("omega", "zeta")
    )
    return replace(finest, u=np.array(u), omega=omega, zeta=zeta)


def climbed(equations: ModeEquations, amplitudes: FloatArray, tally: Tally) -> tuple[Levels, str]:
    """Levels that the branch of a linear mode meets; and why it does not meet the others."""
    points, met, why = dict[float, FloatArray](), dict.fromkeys(amplitudes.tolist(), 0), ""
    lost = "the linear mode is not found below the first one"
    try:
        start = _linear(equations, float(amplitudes[0]))
        # a node of the mode may pass the point, which moves the other way from there on
        ahead = branch(equations, start, np.append(-amplitudes, amplitudes))
        for place in chain([start], ahead):
            omega, _, amplitude = np.abs(place.rest).tolist()
            level = float(amplitudes[np.abs(amplitudes - amplitude).argmin()])
            if place.asked and abs(level - amplitude) <= SAME * level:
                tally.add(int(met[level] == 0))
                met[level] += 1
                points.setdefault(level, equations.upright(place.x))
            if met[float(amplitudes[-1])]:
                break
            if np.linalg.norm(place.q) < LOWEST * np.linalg.norm(start.q):
                why = "its branch turns back, and comes down to small amplitudes in another mode"
                break
            lost = f"its branch is lost at {amplitude:.4g}, {omega / (2.0 * np.pi):.6g} Hz"
    except ConvergenceError as error:
        why = f"{lost}: {error}"
    found = sorted(points)
    return _levels(equations, [points[a] for a in found], np.array([met[a] for a in found])), why


def _linear(equations: ModeEquations, first: float) -> BranchPoint:
    """Point at the first amplitude, or at a lower one if contact slips or opens there."""
    balance = equations.balance
    for below in BELOW:
        x = equations.linear(below * first)
        q = equations.parts(x)[0]
        sampled = balance.contact.sampled(balance.series, q, False)
        if not (sampled.moves.any() or sampled.opened.any()):
            break
    return BranchPoint.of(solved(equations, x, by_parameter(x.size)), q.shape)


def resolved(
    levels: Levels,
    equations: ModeEquations,
    tally: Tally,
    rows: BoolArray | None = None,
    falls: float = 0.0,
) -> tuple[Levels, BoolArray]:
    """Same levels by other equations, of ``rows`` (levels,) alone if given; and which are found.

    With other springs a level begins with its former state and what the level before changed, over
    the amplitude; with more harmonics that takes twice as long. If it is not found so it begins
    with its former state, is followed from the level before, or found from the linear mode: springs
    of sticking that are several times as stiff may slip where the former ones stuck. One that is
    not found at all keeps its former state.
    """
    points, found, changed = list[FloatArray](), list[bool](), np.zeros(0)
    balance, amplitudes = equations.balance, levels.amplitudes.tolist()
    asked = np.ones(len(amplitudes), np.bool_) if rows is None else rows
    tally.total += int(asked.sum())
    for k, (amplitude, wanted) in enumerate(zip(amplitudes, asked.tolist(), strict=True)):
        q = balance.inner(balance.series.of(levels.u[k], levels.series))
        x = np.append(q, [levels.omega[k], levels.zeta[k], amplitude])
        point: FloatArray | None = x
        if wanted:
            point = None
            if balance.series == levels.series and changed.any():
                point = _solved_near(equations, x, x + amplitude * changed, falls)
            if point is None:
                point = _solved_near(equations, x, x, falls)
            if point is None and k > 0 and found[-1]:
                point = _followed_from(equations, points[-1], amplitude)
            if point is None:
                point = _solved_near(equations, x, equations.linear(amplitude))
            tally.add()
        found.append(point is not None)
        points.append(x if point is None else point)
        changed = (points[-1] - x) / amplitude
    return _levels(equations, points, levels.met), np.array(found, np.bool_)


def _solved_near(
    equations: ModeEquations, x: FloatArray, start: FloatArray, falls: float = 0.0
) -> FloatArray | None:
    """Solution of the mode and amplitude of ``x``, if it is found from a ``start``."""
    for serves in (SERVES, 0.0):
        try:
            point = solved(equations, start, by_parameter(x.size), serves=serves, falls=falls)
        except ConvergenceError:
            continue
        if equations.near(point.x, x):
            return point.x
    return None


def _followed_from(equations: ModeEquations, x: FloatArray, amplitude: float) -> FloatArray | None:
    """Solution at an amplitude that a branch from near ``x`` meets, if it does in few steps."""
    try:
        start = solved(equations, x, by_parameter(x.size))
        place = BranchPoint.of(start, equations.parts(x)[0].shape)
        for ahead in islice(branch(equations, place, np.array([amplitude])), FEW):
            if ahead.asked:
                return ahead.x
    except ConvergenceError:
        pass
    return None


def relative(change: FloatArray, values: FloatArray) -> FloatArray:
    """Changes over the values, `LEAST` of the largest or `NEGLIGIBLE`, the most of these."""
    size = np.maximum(np.abs(values), max(LEAST * np.abs(values).max(), NEGLIGIBLE))
    return np.asarray(np.abs(change) / size)


def changes(after: Levels, before: Levels) -> dict[str, FloatArray]:
    """Relative changes, (levels,), of frequency and damping, the largest of each three levels.

    Values of single levels may meet by chance.
    """
    found = {}
    for name, new in after.values.items():
        change = relative(new - before.values[name], new)
        padded = np.pad(change, 1, mode="edge")
        found[name] = np.max([padded[:-2], padded[1:-1], padded[2:]], axis=0)
    return found
