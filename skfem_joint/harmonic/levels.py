"""Levels of a nonlinear mode: followed upwards, and found again with other equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.progress import Tally
from skfem_joint.harmonic.mode_equations import ModeEquations
from skfem_joint.harmonic.newton import TOLERANCE, Solution, followed, solved
from skfem_joint.harmonic.series import FourierSeries

#: Amplitude, over the first one, from which levels start if the first one is not found at once.
BELOW = 1e-3
#: Least step in the logarithm of the amplitude, and most steps to a level that is found again.
LEAST_STEP, FEW = 0.01, 4
#: Damping below this share of the largest counts as so large, where its relative change is taken.
LEAST = 0.02
#: Damping ratio below which there is none: Newton's iteration finds no smaller one for sure.
NEGLIGIBLE = TOLERANCE


@dataclass(frozen=True)
class Levels:
    """A mode at some amplitudes.

    Attributes
    ----------
    equations : ModeEquations
        Which they solve.
    parameters : ndarray, shape (levels,)
        Logarithms of the amplitudes.
    u : ndarray, shape (levels, nh, n)
        Coefficients of the unknowns of the system, m.
    omega, zeta : ndarray, shape (levels,)
        Angular frequency, rad/s, and damping ratio.
    """

    equations: ModeEquations
    parameters: FloatArray
    u: FloatArray
    omega: FloatArray
    zeta: FloatArray

    def up_to(self, count: int) -> Levels:
        """The first levels alone."""
        values = self.parameters, self.u, self.omega, self.zeta
        return Levels(self.equations, *(x[:count] for x in values))

    @property
    def series(self) -> FourierSeries:
        """Harmonics and samples."""
        return self.equations.balance.series

    @property
    def values(self) -> dict[str, FloatArray]:
        """Frequency, rad/s, and damping ratio by name."""
        return {"frequency": self.omega, "damping_ratio": self.zeta}


def _levels(equations: ModeEquations, parameters: FloatArray, points: list[Solution]) -> Levels:
    """From solutions at parameters."""
    motions = [
        equations.motion(point.y, at) for point, at in zip(points, parameters.tolist(), strict=True)
    ]
    u = np.array([equations.balance.outer(q) for q, _, _ in motions])
    omega, zeta = (np.array([motion[k] for motion in motions]) for k in (1, 2))
    return Levels(equations, parameters, u, omega, zeta)


def _arrived(
    equations: ModeEquations, point: Solution, start: float, end: float, least: float = LEAST_STEP
) -> Solution:
    """Solution at the parameter ``end``, followed from that at ``start`` in steps of ``least``."""
    *_, (_, last) = followed(equations, point, start, end, least, equations.near)
    return last


def climbed(
    equations: ModeEquations, parameters: FloatArray, tally: Tally
) -> tuple[Levels, ConvergenceError | None]:
    """Levels one after the other, from a linear mode on; and why they end before the last one.

    Raises
    ------
    ConvergenceError
        If the first level is not found.
    """
    first = float(parameters[0])
    point = _solved_near(equations, equations.linear(first), first)
    if point is None:
        low = first + float(np.log(BELOW))
        point = _arrived(equations, solved(equations, equations.linear(low), low), low, first)
    points, error = [point], None
    tally.add()
    for before, after in zip(parameters[:-1].tolist(), parameters[1:].tolist(), strict=True):
        try:
            point = _arrived(equations, points[-1], before, after)
        except ConvergenceError as failure:
            error = failure
            break
        points.append(point)
        tally.add()
    return _levels(equations, parameters[: len(points)], points), error


def resolved(
    levels: Levels, equations: ModeEquations, tally: Tally, rows: BoolArray | None = None
) -> tuple[Levels, BoolArray]:
    """Same levels by other equations, of ``rows`` (levels,) alone if given; and which are found.

    A level that is not found from its own former state is followed from the level before, or found
    from the linear mode: springs of sticking that are several times as stiff may slip where the
    former ones stuck. One that is not found so either keeps its former state.
    """
    points, found = list[Solution](), list[bool]()
    balance, parameters = equations.balance, levels.parameters.tolist()
    asked = np.ones(len(parameters), np.bool_) if rows is None else rows
    tally.total += int(asked.sum())
    for k, (at, wanted) in enumerate(zip(parameters, asked.tolist(), strict=True)):
        q = balance.inner(balance.series.of(levels.u[k], levels.series))
        y = equations.scaled(q, float(levels.omega[k]), float(levels.zeta[k]), at)
        point: Solution | None = Solution(y, np.zeros_like(y), 0)
        if wanted:
            point = _solved_near(equations, y, at)
            if point is None and k > 0 and found[-1]:
                point = _followed_from(equations, points[-1].y, parameters[k - 1], at)
            if point is None:
                point = _solved_near(equations, equations.linear(at), at)
                point = point if point and equations.near(point.y, y) else None
            tally.add()
        found.append(point is not None)
        points.append(point or Solution(y, np.zeros_like(y), 0))
    return _levels(equations, levels.parameters, points), np.array(found)


def _solved_near(equations: ModeEquations, y: FloatArray, at: float) -> Solution | None:
    """Solution of the mode of ``y``, if it is found."""
    try:
        point = solved(equations, y, at)
    except ConvergenceError:
        return None
    return point if equations.near(point.y, y) else None


def _followed_from(
    equations: ModeEquations, y: FloatArray, start: float, end: float
) -> Solution | None:
    """Solution that is followed from ``y`` at another parameter, if it is found in few steps."""
    point = _solved_near(equations, y, start)
    try:
        return point and _arrived(equations, point, start, end, least=(end - start) / FEW)
    except ConvergenceError:
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
