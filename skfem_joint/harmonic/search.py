"""Search for the branches of a forced system at rising levels.

A level begins at the first frequency, where the load is raised from the level below. Its branch is
followed to the last frequency with few harmonics. Then each of its points is found again with twice
as many until amplitude and friction energy settle: what they differ by is their error. Where the
branch is lost the next frequency is marched to, and the branch is followed on from there, if
Newton's method finds it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.loads import harmonic_factors
from skfem_joint.ground.progress import Tally
from skfem_joint.harmonic.balance import LARGEST, Balance
from skfem_joint.harmonic.forced import Forced, Raised, corrected
from skfem_joint.harmonic.newton import BranchPoint, branch, by_parameter, solved, stepped
from skfem_joint.harmonic.points import point_of
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.steady.steady import odd_loads
from skfem_joint.system.system import System
from skfem_joint.vibration.response import steady_point
from skfem_joint.vibration.response_curve import SteadyPoint

#: Harmonics and samples, raised until amplitude and friction energy settle.
LADDER = (5, 128), (9, 256), (19, 512), (39, 1024), (79, 2048), (159, 4096)
#: Most harmonics, if not asked for more.
HARMONICS = 39
#: Least samples where contact opens: with fewer a branch has many small turns beside each true one.
SMOOTH = 1024
#: Relative errors of amplitude and friction energy with which they have settled.
SETTLED = 3e-4, 3e-3
#: Friction energies below these shares, of the largest so far and of the work of the loads, count
#: as so large where their change is taken.
LEAST, OF_WORK = 0.02, 1e-3
#: Steps in a period of vibration that is marched to.
STEPS = 200
#: Force that keeps bodies in place, over the friction limits, above which they are let go.
HELD = 1e-3
#: Ways in a period with which a walk is looked for, over what the soft springs' acceleration times
#: the square of the period is: where points stick without a way there is no slope to follow.
WAYS = 0.0, 0.01
#: Springs of rigid sticking are this much stiffer where their error is judged.
STIFFER = 10.0
#: Least norm by the mass of a linear motion, whose square is a number, and largest force of its
#: inertia over the friction limits, with which friction has digits beside springs of sticking.
LOW, HIGH = 1e-100, 1e6


class Settled(NamedTuple):
    """A point with as many harmonics as it takes.

    Attributes
    ----------
    place : BranchPoint
    rung : int
    forced : Forced
        The equations that it solves, and their number.
    point : SteadyPoint
    errors : tuple of float
        Relative ones of amplitude and friction energy: the differences from the next rung but one,
        or where it has not settled from the rung before.
    coarser : Settled or None
        The point of the rung before, where it has not settled.
    """

    place: BranchPoint
    rung: int
    forced: Forced
    point: SteadyPoint
    errors: tuple[float, float]
    coarser: Settled | None = None


def change(new: float, old: float, least: float = 0.0) -> float:
    """Relative change of a value; of ``least`` if that is more."""
    size = max(abs(new), least)
    return abs(new - old) / size if size > 0.0 else 0.0


@dataclass
class Search:
    """Search for branches at rising levels.

    Attributes
    ----------
    system : System
        With springs of sticking and Coulomb's law.
    forced : list of Forced
        With more and more harmonics.
    stiffer : list of Forced
        The same with stiffer springs of sticking.
    frequencies : ndarray, shape (k,)
        Asked for, Hz.
    tally : Tally
    rigid : bool
        Whether any point of the given system sticks rigidly.
    linear : ndarray, shape (nh, n)
        Motion at the first frequency and a level of 1, if nothing slips.
    start : ndarray, shape (nh, n)
        Motion at the first frequency and ``level``.
    level : float
    """

    system: System
    forced: list[Forced]
    stiffer: list[Forced]
    frequencies: FloatArray
    tally: Tally
    rigid: bool
    linear: FloatArray
    start: FloatArray
    level: float = 0.0

    @classmethod
    def of(
        cls,
        system: System,
        frequencies: FloatArray,
        sticking: float,
        tally: Tally,
        harmonics: int = HARMONICS,
    ) -> Search:
        """At rest, with springs of a factor ``sticking``, see `springs_of_sticking`."""
        odd = odd_loads(system)
        loaded = max(harmonic_factors([load.amplitude for load in system.loads]))
        least = SMOOTH if system.contact.opens else 1
        times = -(-loaded // LADDER[0][0])
        rungs = [
            FourierSeries(
                max(highest, highest * loaded // LADDER[0][0]), max(times * samples, least), odd
            )
            for highest, samples in LADDER
        ]
        reference = 2.0 * np.pi * float(np.sqrt(frequencies[0] * frequencies[-1]))
        grid = 2.0 * np.pi * float(np.ptp(frequencies)) / (frequencies.size - 1)
        fewest = [
            Forced.of(Balance.of(system, rungs[0], reference, factor), system, grid)
            for factor in (sticking, sticking * STIFFER)
        ]
        most = LARGEST * max(1.0, harmonics / HARMONICS)
        used = [
            x
            for x, (highest, _) in zip(rungs, LADDER, strict=True)
            if highest <= harmonics and x.size * system.n <= most
        ]
        forced, stiffer = ([first.refined(series) for series in used] for first in fewest)
        rest = np.zeros((rungs[0].size, system.n))
        raised = Raised(forced[0], 2.0 * np.pi * float(frequencies[0]))
        at_rest = solved(raised, np.zeros(rest.size + 1), by_parameter(rest.size + 1))
        linear = at_rest.ahead[0][:-1].reshape(rest.shape)
        coulomb = fewest[0].balance.system.with_beta(np.inf)
        rigid = bool(np.any(system.contact.rubs & ~system.contact.sprung))
        return cls(coulomb, forced, stiffer, frequencies, tally, rigid, linear, rest)

    @property
    def targets(self) -> FloatArray:
        """Angular frequencies asked for, rad/s."""
        return 2.0 * np.pi * self.frequencies

    def check(self, levels: Sequence[float]) -> None:
        """Refuse levels whose motions, or friction beside springs, are lost in numbers."""
        balance = self.forced[0].balance
        limits, force = balance.system.contact.w.sum(), balance.inertia(self.linear)
        low, high = LOW / np.linalg.norm(self.linear), 1.0 / LOW
        high = HIGH * limits / force if limits > 0.0 and force > 0.0 else high
        if wrong := [x for x in levels if not low <= x <= high]:
            raise InputError(
                f"harmonic_response: levels: found {', '.join(f'{x:g}' for x in wrong)}, must be "
                f"from {low:.2g} to {high:.2g}: numbers lose motions below, and above friction, "
                "whose limits are too small beside the forces of inertia"
            )

    def branches(self, level: float) -> tuple[list[BranchPoint | SteadyPoint], list[str]]:
        """Points of a level above those before, some of them marched to, and why these are."""
        found, why, after = list[BranchPoint | SteadyPoint](), list[str](), 0
        state, place = None, None
        try:
            place = self._raised(level)
        except ConvergenceError as error:
            why.append(f"the load is not raised at {self.frequencies[0]:.6g} Hz ({error})")
        while True:
            if place is not None:
                found.append(place)
                try:
                    for ahead in branch(self.forced[0].at(level), place, self.targets):
                        place = ahead
                        found.append(place)
                        self.tally.add(int(place.asked))
                    if place.omega < self.targets[-1] * (1.0 - 1e-9):
                        why.append("the branch turns back below the first frequency")
                except ConvergenceError as error:
                    at = place.omega / (2.0 * np.pi)
                    why.append(f"the branch is lost beyond {at:.6g} Hz: {error}")
                reached = max(x.omega for x in found if isinstance(x, BranchPoint))
                after = max(after, int(np.searchsorted(self.targets, reached * (1.0 + 1e-9))))
            if after >= self.targets.size:
                return found, why
            frequency = float(self.frequencies[after])
            marched = steady_point(self.system, frequency, level, STEPS, state)
            self.tally.add()
            after, state = after + 1, marched.state
            place = self._taken_up(marched, level)
            if place is None:
                found.append(marched)

    def _raised(self, level: float) -> BranchPoint:
        """Place at the first frequency; ConvergenceError if it is not found."""
        omega, size = float(self.targets[0]), level * float(np.linalg.norm(self.linear))
        raised, x = Raised(self.forced[0], omega, size), np.append(self.start, self.level)
        below = solved(raised, x, by_parameter(x.size))
        try:
            place = BranchPoint.of(stepped(raised, below, level, 1e-3 * level), self.start.shape)
        except ConvergenceError:  # the load may turn back and rise again
            start = BranchPoint.of(below, self.start.shape)
            *_, place = start, *branch(raised, start, np.array([level]))
            if not place.asked:
                raise ConvergenceError("the load turns back before") from None
        self.start, self.level = place.q, level
        return self._placed(place.q, level, omega)

    def _placed(self, q: FloatArray, level: float, omega: float) -> BranchPoint:
        """Place at an asked frequency near a motion; ConvergenceError if there is none."""
        x = np.append(q, omega)
        return BranchPoint.of(solved(self.forced[0].at(level), x, by_parameter(x.size)), q.shape)

    def _taken_up(self, marched: SteadyPoint, level: float) -> BranchPoint | None:
        """Place at a vibration that was marched to; None if it is not found from there."""
        if marched.course is None:
            return None
        balance = self.forced[0].balance
        series, course = balance.series, marched.course[:-1]
        every = FourierSeries(series.highest, len(course), False)
        u = series.of(every.projection.T @ course, every)
        try:
            return self._placed(balance.inner(u), level, 2.0 * np.pi * marched.frequency)
        except ConvergenceError:
            return None

    def settled(self, place: BranchPoint, level: float, most: float) -> Settled:
        """Point with as many harmonics as it takes; ``most`` is the largest energy so far, J.

        It is the first one that has settled, or the one with the most harmonics that are found,
        whose errors are what it differs by from the one before; nan where there is none.
        """
        forced, place = self._let_go(self.forced[0].at(level), place)
        kept = [Settled(place, 0, forced, _point(forced, place), (np.nan, np.nan))]
        for rung, finer in enumerate(self.forced[1:], start=1):
            finer = finer.at(level).walking(forced.balance.walks)
            refined = partial(finer.balance.series.of, other=kept[-1].forced.balance.series)
            try:
                place = corrected(finer, kept[-1].place.mapped(refined))
            except ConvergenceError:
                break
            point, last = _point(finer, place), rung + 1 == len(self.forced)
            for old in kept[-2:]:
                errors = _apart(point, old.point, most)
                settles = errors[0] <= SETTLED[0] and errors[1] <= SETTLED[1]
                if settles and (old is not kept[-1] or last):
                    return old._replace(errors=errors, coarser=None)
            kept.append(Settled(place, rung, finer, point, errors, kept[-1]))
        return kept[-1]

    def _let_go(self, forced: Forced, place: BranchPoint) -> tuple[Forced, BranchPoint]:
        """Equations in which bodies walk, if soft springs hold them and nothing is in their way.

        They are solved near a place; both are the given ones if they have no solution there.
        """
        if forced.balance.held_softly(place.q) <= HELD:
            return forced, place
        walking = forced.walking(True)
        still, _ = walking.balance.parted(place.q)
        pushed = (2.0 * np.pi / place.omega) ** 2 * forced.balance.soft @ place.q[0]
        for share in WAYS:
            q = still.copy()
            q[0] += share * pushed
            try:
                found = corrected(walking, place._replace(q=q))
            except ConvergenceError:
                continue
            if walking.balance.goes_on(found.q):
                return walking, found
        return forced, place

    def sticking(self, found: Settled, level: float) -> tuple[float, float]:
        """Relative distances of amplitude and friction energy from rigid sticking.

        By stiffer springs: distances fall with the root of the stiffness, as marches with springs
        up to 1e9 N/m show. nan where these have no solution.
        """
        soft = found.forced.balance
        stiff = self.stiffer[found.rung].at(level).walking(soft.walks)
        try:
            place = corrected(
                stiff, found.place.mapped(lambda q: stiff.balance.inner(soft.outer(q)))
            )
        except ConvergenceError:
            return np.nan, np.nan
        amplitude, energy = _apart(_point(stiff, place), found.point, 0.0)
        left = 1.0 - np.sqrt(1.0 / STIFFER)
        return amplitude / left, energy / left


def _apart(new: SteadyPoint, old: SteadyPoint, most: float) -> tuple[float, float]:
    """Relative differences of amplitude and friction energy; ``most`` is as in `Search.settled`."""
    least = max(LEAST * most, OF_WORK * new.input_energy)
    return (
        change(float(new.amplitude.max()), float(old.amplitude.max())),
        change(new.friction_energy, old.friction_energy, least),
    )


def _point(forced: Forced, place: BranchPoint) -> SteadyPoint:
    """Results of a place, without its stability."""
    return point_of(forced.balance, place.q, place.omega, forced.force)
