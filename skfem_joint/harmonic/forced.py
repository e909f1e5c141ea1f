"""Equations of a forced periodic motion, and the way along them through turning points.

Unknowns are the coefficients of q over a size, times the frequencies that make them alike, and the
angular frequency over that of reference. A branch is followed by its arc length in the metric

    ds^2 = (d omega / grid)^2 + |dq|^2 / (0.2 |q|)^2,

with the norm of q by the mass, without its mean: offsets, which hardly change anything else, and
modes of the contact, at megahertz, would dominate others. (In the metric of all unknowns it stalls
where offsets grow, in that of the first harmonic where slip ends.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.harmonic.balance import Balance
from skfem_joint.harmonic.newton import Equations, Solution, solved
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.system.system import System

#: Change of the motion, relative, that counts as much as one step of the frequencies asked for.
CHANGE = 0.2
#: Longest and shortest step in arc length, and most steps for each frequency asked for.
LONGEST, SHORTEST, MOST_STEPS = 2.0, 1e-4, 60
#: Shares of a residual that vanish one after the other. More of them cost more than they find.
EASED = 0.25, 0.5, 0.75, 1.0
#: A point may lie so far from where it was expected, over the step: else it may be another branch.
ASTRAY = 1.0
#: Share of the frequency in a step of length 1 below which a branch is about to turn.
STEEP = 0.05


class BranchPoint(NamedTuple):
    """A point of a branch.

    Attributes
    ----------
    q : ndarray, shape (nh, n)
    omega : float
        rad/s.
    along : ndarray, shape (nh n + 1,)
        Change of q, and of omega, along the branch.
    asked : bool
        Whether its frequency was asked for.
    arc : float
        Length of the arc from the place before.
    """

    q: FloatArray
    omega: float
    along: FloatArray
    asked: bool
    arc: float = 0.0


@dataclass(frozen=True)
class Forced:
    """Forced motion of a system.

    Attributes
    ----------
    balance : Balance
    force : ndarray, shape (nh, n)
        Coefficients of the loads on q.
    size : float
        Norm of q by the mass that unknowns are over.
    """

    balance: Balance
    force: FloatArray
    size: float = 1.0

    @classmethod
    def of(cls, balance: Balance, system: System, period: float) -> Forced:
        """From harmonic loads with a common ``period``, s."""
        return cls(balance, load_of(system, balance.series, period) @ balance.Phi)

    def walking(self, walks: bool) -> Forced:
        """Same equations, in which bodies walk that nothing holds, or do not."""
        return replace(self, balance=replace(self.balance, walks=walks))

    def refined(self, other: Forced, place: BranchPoint) -> BranchPoint:
        """Place of other equations that differ in their series, with the coefficients of this."""
        own, before = self.balance.series, other.balance.series
        along = own.of(place.along[:-1].reshape(place.q.shape), before)
        changes = np.append(along.ravel(), place.along[-1])
        return place._replace(q=own.of(place.q, before), along=changes)

    @property
    def by_size(self) -> FloatArray:
        """What unknowns are over, (nh n,)."""
        by = self.size * self.balance.reference / self.balance.scale
        return np.tile(by, self.balance.series.size)

    def scaled(self, q: FloatArray) -> FloatArray:
        """Scaled unknowns of a motion."""
        return q.ravel() / self.by_size

    def motion(self, y: FloatArray) -> FloatArray:
        """Motion (nh, n) of scaled unknowns."""
        return (y * self.by_size).reshape(self.balance.series.size, -1)

    def sized(self, q: FloatArray) -> Forced:
        """Same equations whose unknowns are over the norm of ``q``."""
        size = float(np.linalg.norm(q))
        return replace(self, size=size) if size > 0.0 else self

    def at(
        self, y: FloatArray, omega: float, level: float, tangents: bool = True
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Residual, its derivative, and those by omega over the reference and by the level."""
        force = level * self.force
        found = self.balance.residual(self.motion(y), omega, force=force, tangents=tangents)
        reference = self.balance.reference
        weights = 1.0 / (self.balance.scale * self.size * reference)
        J = np.zeros((0, 0))
        if found.derivative is not None:
            J = found.derivative.reshape(y.size, y.size)
            over = np.tile(1.0 / self.balance.scale, self.balance.series.size)
            J *= over[:, np.newaxis]
            J *= over
        by_omega = (found.by_omega * weights).ravel() * reference
        by_level = -(self.force * weights).ravel()
        return (found.values * weights).ravel(), J, by_omega, by_level


@dataclass(frozen=True)
class ByLevel:
    """Equations at an angular frequency, whose parameter is the level over a ``unit``."""

    forced: Forced
    omega: float
    unit: float

    def __call__(
        self, y: FloatArray, parameter: float, tangents: bool = True
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual and derivatives by unknowns and parameter."""
        values, J, _, by_level = self.forced.at(y, self.omega, parameter * self.unit, tangents)
        return values, J, by_level * self.unit


@dataclass(frozen=True)
class ByFrequency:
    """Equations at a level, whose parameter is the angular frequency over that of reference."""

    forced: Forced
    level: float

    def __call__(
        self, y: FloatArray, parameter: float, tangents: bool = True
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual and derivatives by unknowns and parameter."""
        omega = parameter * self.forced.balance.reference
        values, J, by_omega, _ = self.forced.at(y, omega, self.level, tangents)
        return values, J, by_omega


@dataclass(frozen=True)
class ByArc:
    """Equations at a level, with the frequency as the last unknown; the parameter is the arc.

    Attributes
    ----------
    start : ndarray
        Scaled unknowns that the arc counts from.
    normal : ndarray
        Change of the arc with the unknowns.
    """

    forced: Forced
    level: float
    start: FloatArray
    normal: FloatArray

    def __call__(
        self, y: FloatArray, parameter: float, tangents: bool = True
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residual and derivatives by unknowns and parameter."""
        omega = float(y[-1]) * self.forced.balance.reference
        values, J, by_omega, _ = self.forced.at(y[:-1], omega, self.level, tangents)
        whole, by_parameter = J, np.append(np.zeros(y.size - 1), -1.0)
        if tangents:
            whole = np.vstack([np.column_stack([J, by_omega]), self.normal])
        arc = float(self.normal @ (y - self.start)) - parameter
        return np.append(values, arc), whole, by_parameter


@dataclass(frozen=True)
class Metric:
    """Metric of a branch in scaled unknowns, with the frequency as the last one.

    Attributes
    ----------
    weights : ndarray
        Of their squares.
    """

    weights: FloatArray

    @classmethod
    def of(cls, forced: Forced, grid: float) -> Metric:
        """For frequencies asked for that are ``grid`` rad/s apart."""
        weights = (forced.by_size / (CHANGE * forced.size)) ** 2
        weights[: forced.balance.series.first * forced.balance.frequencies.size] = 0.0
        return cls(np.append(weights, (forced.balance.reference / grid) ** 2))

    def norm(self, y: FloatArray) -> float:
        """Length of a change."""
        return float(np.sqrt(y @ (self.weights * y)))


def load_of(system: System, series: FourierSeries, period: float) -> FloatArray:
    """Coefficients (nh, n) of the loads of a system, N."""
    force = np.zeros((series.size, system.n))
    for load in system.loads:
        for part in load.amplitude.harmonics:
            order = round(part.frequency * period)
            a = series.first + 2 * int(np.searchsorted(series.orders, order))
            vector = part.amplitude * np.asarray(load.vector)
            force[a] += np.sin(part.phase) * vector
            force[a + 1] += np.cos(part.phase) * vector
    return force


def branch(
    forced: Forced, level: float, place: BranchPoint, targets: FloatArray, grid: float
) -> Iterator[BranchPoint]:
    """Points of a branch from one on to the last of ``targets``, or back to the first.

    With constant contact, where there is one vibration at each frequency, it never turns.

    Parameters
    ----------
    place : BranchPoint
        At the first frequency; ``along`` points to the others.
    targets : ndarray
        Angular frequencies asked for, rad/s, with the first one: points lie on each of them.
    grid : float
        Mean distance of these, rad/s.

    Raises
    ------
    ConvergenceError
        If steps become too short, or too many.
    """
    step, unique = 1.0, not forced.balance.system.contact.opens
    for _ in range(MOST_STEPS * targets.size):
        here = forced.sized(place.q)
        reference = here.balance.reference
        metric, start, along = _frame(here, place, grid)
        ahead = targets[(targets - place.omega) * along[-1] > 1e-9 * grid * abs(along[-1])]
        if not ahead.size:
            return
        target = float(ahead[np.abs(ahead - place.omega).argmin()]) / reference
        while True:
            if step < SHORTEST:
                at = place.omega / (2.0 * np.pi)
                raise ConvergenceError(f"the branch is lost beyond {at:.6g} Hz")
            length = step
            lands = (target - start[-1]) / along[-1] <= 1.2 * step
            try:
                if lands:
                    length = float((target - start[-1]) / along[-1])
                    point = solved(ByFrequency(here, level), (start + length * along)[:-1], target)
                    y, turned = _landed(point, target, along)
                else:
                    arc = ByArc(here, level, start, metric.weights * along)
                    point = solved(arc, start + length * along, length)
                    y, turned = point.y, point.tangent
                if metric.norm(y - start - length * along) > ASTRAY * length:
                    raise ConvergenceError("astray")
                if unique and not turned[-1] * along[-1] > 0.0:
                    raise ConvergenceError("turned where nothing turns")
                lowest, highest = sorted((start[-1], y[-1]))
                passed = targets[(targets > lowest * reference) & (targets < highest * reference)]
                passed = passed[np.abs(passed - place.omega) > 1e-9 * grid]
                if passed.size:
                    at = float(passed[np.abs(passed - place.omega).argmin()]) / reference
                    share = (at - start[-1]) / (y[-1] - start[-1])
                    point = solved(ByFrequency(here, level), (start + share * (y - start))[:-1], at)
                    end = y
                    y, turned = _landed(point, at, y - start)
                    if metric.norm(y - start - share * (end - start)) > ASTRAY * length:
                        raise ConvergenceError("astray")
                    lands = True
            except ConvergenceError:
                step = 0.5 * min(step, length)
                continue
            break
        turned /= metric.norm(turned)
        place = BranchPoint(
            here.motion(y[:-1]),
            float(y[-1]) * reference,
            np.append(here.motion(turned[:-1]).ravel(), turned[-1] * reference),
            lands,
            metric.norm(y - start),
        )
        step = min(LONGEST, step * (1.5 if point.iterations <= 6 else 0.7))
        yield place
    raise ConvergenceError(f"the branch has not ended after {MOST_STEPS * targets.size} steps")


def _frame(here: Forced, place: BranchPoint, grid: float) -> tuple[Metric, FloatArray, FloatArray]:
    """Metric at a place, its scaled unknowns, and their change along the branch, of length 1."""
    metric, reference = Metric.of(here, grid), here.balance.reference
    start = np.append(here.scaled(place.q), place.omega / reference)
    along = np.append(here.scaled(place.along[:-1]), place.along[-1] / reference)
    return metric, start, along / metric.norm(along)


def _landed(point: Solution, omega: float, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unknowns and tangent, to the side of ``along``, of a point at a frequency."""
    ahead = np.append(point.tangent, 1.0) * np.sign(along[-1])
    return np.append(point.y, omega), ahead


def eased(equations: Equations, y: FloatArray, parameter: float) -> Solution:
    """Solution near ``y``, in steps in which the residual there vanishes, if need be.

    ConvergenceError if it is not found.
    """
    try:
        return solved(equations, y, parameter)
    except ConvergenceError:
        easing = _Easing(equations, parameter, equations(y, parameter, False)[0])
        for share in EASED:
            point = solved(easing, y, share)
            y = point.y
        return point


@dataclass(frozen=True)
class _Easing:
    """Equations at a ``parameter`` less a share of a residual; the new parameter is its rest."""

    equations: Equations
    parameter: float
    residual: FloatArray

    def __call__(
        self, y: FloatArray, parameter: float, tangents: bool = True
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        values, derivative, _ = self.equations(y, self.parameter, tangents)
        return values - (1.0 - parameter) * self.residual, derivative, self.residual


def corrected(forced: Forced, level: float, place: BranchPoint, grid: float) -> BranchPoint:
    """Point of other equations near a place, of its frequency unless the branch turns about there.

    ConvergenceError if there is none.
    """
    here = forced.sized(place.q)
    reference = here.balance.reference
    y = here.scaled(place.q)
    turns = here.balance.system.contact.opens
    metric, start, along = _frame(here, place, grid)
    if place.asked or not turns or abs(along[-1]) * reference > STEEP * grid:
        try:
            point = eased(ByFrequency(here, level), y, place.omega / reference)
            return place._replace(q=here.motion(point.y))
        except ConvergenceError:  # beyond the turning point of a coarser series
            if not turns:
                raise
    point = eased(ByArc(here, level, start, metric.weights * along), start, 0.0)
    return place._replace(
        q=here.motion(point.y[:-1]), omega=float(point.y[-1]) * reference, asked=False
    )
