"""Newton's iteration, and the way along a branch of solutions through its turning points.

Equations are one fewer than their unknowns: the harmonics of a motion, and what else is not given,
such as its frequency; the last one is the parameter. A solution is looked for in a plane that a
branch crosses: of one parameter, or at one length of arc. The length has a metric of the equations.

Friction that is sampled has kinks, at which a branch may turn back by more than a right angle. So
the sign of the determinant of derivatives and plane, which stays the same along a branch, tells
forwards from backwards there, and where steps become too short the derivatives a little beyond
say where a branch goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy import interpolate, linalg

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError

#: Norm of a residual of unknowns of size 1 that ends the iteration: 0.02 % of a damping ratio of
#: 0.25 %. States of points change one by one where it is smaller, which takes as long again.
TOLERANCE = 1e-6
#: Norm that will do where the iteration ends: points that just begin to slip between two samples
#: may leave so much.
ENOUGH = 1e-5
#: Norm that will do where a solution only judges another one.
ROUGH = 3e-5
#: Most derivatives, those of a step along a branch, and lengths that are tried of a step by a new
#: derivative, the last of which is taken in any case, and by one that is used again.
ITERATIONS, QUICK, TRIED, TRIED_AGAIN = 39, 11, 9, 3
#: Shares of a residual that vanish one after the other. More of them cost more than they find.
EASED = 0.25, 0.5, 0.75, 1.0
#: Change of the motion, relative, that is an arc of length 1.
CHANGE = 0.2
#: Longest and shortest step in arc length.
LONGEST, SHORTEST = 2.0, 1e-4
#: Most steps: so many, and so many for each parameter asked for.
LEAST_STEPS, MOST_STEPS = 100, 10
#: A point may lie so far from where it was expected, over the step: else it may be another branch.
ASTRAY = 1.0
#: Longest step after which the determinant may tell another side than the angle does, and cosine
#: of the angle below which the determinant is right then.
SHORT, SHARP = 0.05, 0.8
#: Distances beyond a kink at which it is looked for how a branch goes on, and the step there.
BEYOND, AFTER = (1e-4, 1e-3, 1e-2), 0.01
#: Relative distance of parameters that are the same.
SAME = 1e-9


class Equations(Protocol):
    """Equations of unknowns x (N,), the last of which is the parameter."""

    @property
    def unique(self) -> bool:
        """Whether there is one solution for each parameter, so that nothing turns."""

    def __call__(self, x: FloatArray, tangents: bool) -> tuple[FloatArray, FloatArray]:
        """Residual (N - 1,) and its derivative, which is empty where it is not wanted."""

    def rows(self, x: FloatArray) -> FloatArray:
        """What makes residuals of unknowns near ``x`` of size 1, (N - 1,)."""

    def metric(self, x: FloatArray) -> FloatArray:
        """Weights (N,) of the squares of changes in the square of the length of arc."""


@dataclass(frozen=True)
class Solution:
    """Solution in a plane.

    Attributes
    ----------
    equations : Equations
    x, normal : ndarray
        Unknowns, and normal of the plane.
    iterations : int
        Derivatives that it took.
    """

    equations: Equations
    x: FloatArray
    normal: FloatArray
    iterations: int

    @cached_property
    def ahead(self) -> tuple[FloatArray, float]:
        """Change of x along the branch, to the side of the normal, and the determinant's sign."""
        rows = self.equations.rows(self.x)
        return _tangent(_factor(self.equations, self.x, self.normal, rows))


class BranchPoint(NamedTuple):
    """A point of a branch.

    Attributes
    ----------
    q : ndarray, shape (nh, n)
        Coefficients of the motion.
    rest : ndarray
        Other unknowns.
    along : ndarray
        Change of q and the others along the branch.
    sense : float
        Of ``along``, see `Solution`.
    asked : bool
        Whether its parameter was asked for.
    arc : float
        Length of the arc from the place before.
    """

    q: FloatArray
    rest: FloatArray
    along: FloatArray
    sense: float = 1.0
    asked: bool = True
    arc: float = 0.0

    @classmethod
    def of(cls, point: Solution, shape: tuple[int, ...]) -> BranchPoint:
        """Point of an asked parameter, whose motion has a ``shape``; along its tangent."""
        size = int(np.prod(shape))
        q, rest = point.x[:size].reshape(shape), point.x[size:]
        return cls(q, rest, *point.ahead)

    @property
    def x(self) -> FloatArray:
        """All unknowns."""
        return np.append(self.q, self.rest)

    @property
    def omega(self) -> float:
        """Angular frequency, rad/s, the first of the other unknowns."""
        return float(self.rest[0])

    def mapped(self, change: Callable[[FloatArray], FloatArray]) -> BranchPoint:
        """Same point with other coefficients of motions."""
        size = self.q.size
        along = change(self.along[:size].reshape(self.q.shape))
        return self._replace(q=change(self.q), along=np.append(along, self.along[size:]))


def by_parameter(size: int) -> FloatArray:
    """Normal of the plane of one parameter, for a number of unknowns."""
    return np.append(np.zeros(size - 1), 1.0)


def solved(
    equations: Equations,
    x: FloatArray,
    normal: FloatArray,
    most: int = ITERATIONS,
    serves: float = 0.0,
    falls: float = 0.0,
    less: FloatArray | float = 0.0,
) -> Solution:
    """Solution near ``x`` in the plane through it, by Newton's iteration.

    Its steps are halved until residuals fall. A derivative, of which there are ``most``, is used
    again while a step leaves less than the share that ``serves`` of a residual. The last residual
    is below `TOLERANCE`, or if that ``falls`` to a share of the first one, below `ROUGH`. What is
    ``less``, (N - 1,), is taken off all of them.

    Raises
    ------
    ConvergenceError
        If it is not found.
    """
    rows, share, made = equations.rows(x), 1.0, 0
    residual, factor = rows * (equations(x, False)[0] - less), None
    tolerance = max(TOLERANCE, min(falls * float(np.linalg.norm(residual)), ROUGH))
    while True:
        size, fresh = float(np.linalg.norm(residual)), factor is None
        if size <= tolerance or (size <= ENOUGH and fresh and made == most):
            return Solution(equations, x, normal, made)
        if not np.isfinite(size) or (fresh and made == most):
            break
        if factor is None:
            factor, made = _factor(equations, x, normal, rows), made + 1
        step = -linalg.lu_solve(factor, np.append(residual, 0.0), check_finite=False)
        if not np.isfinite(step).all():
            break
        before, longest = share, min(1.0, 2.0 * share)
        for share in longest * 0.5 ** np.arange(TRIED if fresh else TRIED_AGAIN):
            tried = rows * (equations(x + share * step, False)[0] - less)
            left = float(np.linalg.norm(tried)) / size
            if left < (1.0 - 0.1 * share if fresh else serves):
                break
        else:
            if not fresh:
                factor, share = None, before
                continue
        x, residual, factor = x + share * step, tried, factor if serves else None
    raise ConvergenceError(f"Newton's iteration ends at a residual of {size:.2g}")


def _factor(
    equations: Equations, x: FloatArray, normal: FloatArray, rows: FloatArray
) -> tuple[FloatArray, FloatArray]:
    whole = np.vstack([equations(x, True)[1], normal])
    whole[:-1] *= rows[:, np.newaxis]
    lu, pivots = linalg.lu_factor(whole, overwrite_a=True, check_finite=False)
    return lu, pivots


def _tangent(factor: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, float]:
    """Change of unknowns by a step along the normal, and the sign of the determinant."""
    lu, pivots = factor
    swaps = np.count_nonzero(pivots != np.arange(pivots.size))
    ahead = linalg.lu_solve(factor, by_parameter(pivots.size), check_finite=False)
    return ahead, float(np.prod(np.sign(np.diag(lu)))) * (-1.0) ** swaps


def stepped(equations: Equations, point: Solution, end: float, least: float) -> Solution:
    """Solution at the parameter ``end``, from one of another parameter.

    The way is one step along the tangent if that is found, else steps that are halved, down to
    ``least``, and doubled again. ConvergenceError if they become smaller.
    """
    normal = by_parameter(point.x.size)
    step = end - point.x[-1]
    while point.x[-1] != end:
        step = min(step, end - point.x[-1], key=abs)
        x = point.x + step * point.ahead[0]
        x[-1] = end if abs(end - x[-1]) < 1e-12 * abs(end) else x[-1]
        try:
            point = solved(equations, x, normal)
            step *= 2.0
        except ConvergenceError:
            step *= 0.5
            if abs(step) < least:
                raise
    return point


def branch(equations: Equations, place: BranchPoint, targets: FloatArray) -> Iterator[BranchPoint]:
    """Points of a branch from one on, until no target is ahead.

    Parameters
    ----------
    equations : Equations
    place : BranchPoint
    targets : ndarray
        Parameters asked for: there is a point wherever the branch meets one.

    Raises
    ------
    ConvergenceError
        If steps become too short, or too many.
    """
    step, shape, most = 1.0, place.q.shape, LEAST_STEPS + MOST_STEPS * targets.size
    for _ in range(most):
        x, weights = place.x, equations.metric(place.x)
        along = place.along / _length(place.along, weights)
        kinked = False
        while True:
            away = (targets - x[-1]) * np.sign(along[-1])
            away = away[away > SAME * np.abs(targets)]
            if not away.size:
                return
            ahead = float(away.min() / np.abs(along[-1])) if along[-1] else np.inf
            lands = ahead <= 1.2 * step
            length = ahead if lands else step
            normal = by_parameter(x.size) if lands else weights * along
            try:
                point = solved(equations, x + length * along, normal, QUICK)
                turned, sense = _onwards(point, place.sense, along, weights, length)
                if _length(point.x - x - length * along, weights) > ASTRAY * length:
                    raise ConvergenceError("the next point lies far from where it was expected")
                if equations.unique and not turned[-1] * along[-1] > 0.0:
                    raise ConvergenceError("it turns where nothing turns")
                if not lands and abs(point.x[-1] - x[-1]) >= away.min() * (1.0 - SAME):
                    raise ConvergenceError("a parameter that was asked for is passed")
                met = _met(targets, [x[-1], point.x[-1]], [length * along[-1], length * turned[-1]])
                if length > SHORT and met > lands:
                    raise ConvergenceError("a parameter that was asked for is met at a turn")
            except ConvergenceError:
                step = 0.5 * min(step, length)
                if step >= SHORTEST:
                    continue
                if kinked or equations.unique:
                    raise
                along, step, kinked = _beyond(equations, place, along, weights), AFTER, True
                continue
            break
        arc = _length(point.x - x, weights)
        new = BranchPoint.of(point, shape)
        place = new._replace(along=turned, sense=sense, asked=lands, arc=arc)
        step = min(LONGEST, step * (1.5 if point.iterations <= 6 else 0.7))
        yield place
    raise ConvergenceError(f"it has not ended after {most} steps")


def _met(targets: FloatArray, ends: Sequence[float], slopes: Sequence[float]) -> int:
    """How often a cubic from one of two ends to the other, with these slopes, meets targets."""
    cubic = interpolate.CubicHermiteSpline([0.0, 1.0], ends, slopes)
    turns = cubic(cubic.derivative().roots(extrapolate=False))
    way = np.concatenate([ends[:1], turns, ends[1:]])
    rises, margin = np.sign(np.diff(way)), SAME * np.abs(targets[:, np.newaxis])
    begun, ended = (rises * (targets[:, np.newaxis] - x) > margin for x in (way[:-1], way[1:]))
    return int(np.count_nonzero(begun & ~ended))


def _length(change: FloatArray, weights: FloatArray) -> float:
    return float(np.sqrt(change @ (weights * change)))


def _onwards(
    point: Solution, sense: float, along: FloatArray, weights: FloatArray, length: float
) -> tuple[FloatArray, float]:
    """Direction onwards from a point after a step ``along``, with its sense.

    ConvergenceError if angle and determinant tell two sides after a long step.
    """
    tangent, own = point.ahead
    ahead = tangent / _length(tangent, weights)
    cosine = float(ahead @ (weights * along))
    side = float(np.sign(cosine))
    if side != own * sense:  # another sheet, a kink, or another branch that crosses
        if length > SHORT:
            raise ConvergenceError("it turns too sharply")
        side *= 1.0 if abs(cosine) > SHARP else -1.0
    return side * ahead, side * own


def _beyond(
    equations: Equations, place: BranchPoint, along: FloatArray, weights: FloatArray
) -> FloatArray:
    """Direction in which a branch goes on beyond a kink; ConvergenceError if it is not found."""
    normal, rows = weights * along, equations.rows(place.x)
    for distance in BEYOND:
        x = place.x + distance * along
        tangent, sense = _tangent(_factor(equations, x, normal, rows))
        turned = tangent * (sense * place.sense / _length(tangent, weights))
        if turned @ normal < 0.9:
            return np.asarray(turned)
    raise ConvergenceError("steps along the branch become too short")


def eased(equations: Equations, x: FloatArray, normal: FloatArray) -> Solution:
    """Solution as `solved`, in steps in which the residual at ``x`` vanishes, if need be."""
    try:
        return solved(equations, x, normal)
    except ConvergenceError:
        residual = equations(x, False)[0]
        for share in EASED:
            point = solved(equations, x, normal, less=(1.0 - share) * residual)
            x = point.x
        return point
