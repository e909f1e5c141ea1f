"""Steady vibration over frequency by harmonic balance, through turning points.

A level begins at the first frequency, where the load is raised from the level below. Its branch is
followed to the last frequency with few harmonics, then each of its points is found again with twice
as many until amplitude and friction energy settle: what they differ by is their error. What
Newton's method does not find is marched to, as `skfem_joint.response` does.

Friction is Coulomb's, rigid sticking has stiff springs. Where contact opens stability is judged by
Hill's method (:mod:`skfem_joint.harmonic.stability`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.progress import Progress, Tally, silent
from skfem_joint.ground.rows import Rows
from skfem_joint.ground.values import Kind, at_least, check
from skfem_joint.harmonic.balance import MOST
from skfem_joint.harmonic.newton import BranchPoint
from skfem_joint.harmonic.points import notes_of_law, notes_of_restless, state_of
from skfem_joint.harmonic.search import (
    HARMONICS,
    HELD,
    LADDER,
    OF_WORK,
    STEPS,
    Search,
    Settled,
    change,
)
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.harmonic.stability import stable
from skfem_joint.reduction.ranges.points import loaded_at, period_of
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.stepping.recording import Save
from skfem_joint.system.system import System
from skfem_joint.vibration.response import checked, steady_plan, suited_steps
from skfem_joint.vibration.response_curve import Curve, SteadyPoint, nothing_found

#: Springs of rigid sticking: they lower the square of the nearest stuck frequency by one over this.
STICKING = 3000.0
#: What they may be.
STIFF = Kind(">= 1 and finite", lambda x: 1.0 <= x < np.inf)
#: Most harmonics that may be asked for: two rungs of the ladder at least.
COUNTS = at_least(LADDER[1][0])
#: Results whose errors are stated.
NAMES = "amplitude", "friction_energy"
#: Relative errors of these beyond which a note says so.
DOUBTFUL = 0.01, 0.05


@dataclass(frozen=True)
class BalancedCurve(Curve):
    """Response at one level of load by harmonic balance.

    Attributes
    ----------
    level : float
    points : tuple of SteadyPoint
        Along the branch: where it turns frequencies fall. ``point.stable`` says whether
        disturbances vanish, None where that is not known; points with ``point.periods`` above zero
        were marched to.
    errors : dict of str to ndarray, shape (points,)
        Relative errors of ``amplitude`` and ``friction_energy`` by harmonics and samples: what a
        point with about four times as many, or twice, differs by, or where that is much, what it
        differs by from one with half as many; nan where there is none, and at points that were
        marched to.
    series : FourierSeries or None
        Largest one that a point took; None where all points were marched to.
    why : tuple of str
        Why points were marched to.
    sticking : tuple of float
        Largest relative distances of both from rigid sticking at the points that are judged, of
        about a quarter, half and all of the largest amplitude, and the smallest one that slips;
        zero where all points have springs, nan where it is not known.
    confirmed : dict of int to tuple of float
        Differences of both by time steps with the same springs, at points by number: the largest
        of the named points' amplitudes over the largest amplitude, and of the friction energy; nan
        where steps found nothing steady. Empty where it was not asked for.
    law : tuple of str
        What to know of friction whose own law is another one.
    turns : tuple of float
        Frequencies, Hz, at which the branch turns.
    held : float
        Largest mean force that keeps bodies in place which friction alone holds, over the friction
        limits. It stands for none. Where all of their points slip there is no such force, and they
        walk.
    walks : float
        Largest way, m, of bodies that walk in a period.
    restless : float
        Largest relative change of friction in the last of 100 periods where it is not periodic.
    """

    errors: Mapping[str, FloatArray] = field(default_factory=dict)
    series: FourierSeries | None = None
    why: tuple[str, ...] = ()
    sticking: tuple[float, float] = (0.0, 0.0)
    confirmed: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    law: tuple[str, ...] = ()
    turns: tuple[float, ...] = ()
    held: float = 0.0
    walks: float = 0.0
    restless: float = 0.0

    @property
    def notes(self) -> tuple[str, ...]:
        """What to beware of, in whole sentences."""
        own = [f"Level {self.level:g}: {note}" for note in self._own_notes()]
        return (*super().notes, *own)

    def _own_notes(self) -> Iterator[str]:
        """Sentences about harmonics, sticking, stability, marching and what it confirms."""
        marched = [f"{p.frequency:.6g}" for p in self.points if p.periods]
        yield from self.law
        yield from notes_of_restless(self.restless)
        for reason in self.why:
            yield f"{reason}."
        if marched:
            yield f"{', '.join(marched)} Hz were marched to, not found by harmonic balance."
        if self.held > HELD:
            yield (
                f"a mean force of {100.0 * self.held:.2g} % of the friction limits, or where there "
                "are none of the normal forces at rest or the inertia, keeps bodies in place that "
                "nothing else holds."
            )
        if self.walks > 0.0:
            yield (
                f"bodies that friction alone holds walk by up to {self.walks:.2g} m in a period. "
                "This is in no result, and where contact opens their stability is not known."
            )
        if self.turns:
            at = ", ".join(f"{f:.6g}" for f in self.turns)
            yield f"the branch turns at about {at} Hz: there are several vibrations between."
        if unstable := sum(p.stable is False for p in self.points):
            yield f"{unstable} of {len(self.points)} points are unstable: no vibration stays there."
        if unjudged := sum(p.stable is None and not p.periods for p in self.points):
            yield f"the stability of {unjudged} points is not known."
        if any(np.isnan(apart).any() for apart in self.confirmed.values()):
            yield "time steps did not become steady from a point that was to be confirmed."
        for number, name in enumerate(NAMES):
            shown = name.replace("_", " ")
            by_sticking = self.sticking[number]
            error = float(np.nanmax([0.0, *self.errors[name]]) + np.nan_to_num(by_sticking))
            unknown = np.isnan(self.errors[name]) & (self.column("periods") == 0)
            if count := np.count_nonzero(unknown):
                yield f"the error of the {shown} is not known at {count} points."
            if np.isnan(by_sticking):
                yield f"the error of the {shown} by springs of sticking is not known."
            if error > DOUBTFUL[number]:
                yield (
                    f"harmonics and springs of sticking leave an error of the {shown} of up to "
                    f"{100.0 * error:.2g} %."
                )
            apart = [differences[number] for differences in self.confirmed.values()]
            if np.nanmax([0.0, *apart]) > DOUBTFUL[number]:
                yield (
                    f"time steps with the same springs differ by {100.0 * np.nanmax(apart):.2g} % "
                    f"in the {shown}."
                )


def harmonic_response(
    system: System,
    frequencies: FloatArray,
    levels: Sequence[float] = (1.0,),
    *,
    confirm: bool = True,
    sticking: float = STICKING,
    harmonics: int = HARMONICS,
    progress: Progress = silent,
    rows: Rows | None = None,
) -> list[BalancedCurve]:
    """Steady vibration over frequency by harmonic balance, a curve for each level.

    Parameters
    ----------
    system : System
        Reduced by ``reduce(system, frequency=..., level=...)``, or small, with harmonic loads; its
        friction acts as Coulomb's, and its contact that opens is elastic.
    frequencies : ndarray, shape (k,)
        First harmonics of the loads, Hz, rising. Each has a point on the branch, that turns between
        them where it does; more points lie where it is steep.
    levels : sequence of float
        Factors of the loads' amplitudes.
    confirm : bool
        Whether three points of each curve that are not unstable are judged by time steps, with the
        same springs. Where these find nothing steady stability is not known.
    sticking : float
        Stiffness of the springs of points that have none of their own: they lower the square of the
        nearest stuck frequency by one over it.
    harmonics : int
        Most that a point takes, 9 or more: it has 9, 19, 39, 79 or 159, in proportion more where
        loads have harmonics above the fifth. On the flank of a bolted lap 39 left 0.3 % of an
        amplitude, and 79 left 0.05 % in nine times as long.
    progress : callable, optional
        Called with (points found, points asked for).
    rows : Rows, optional
        Where the curves are kept as they finish, and taken up again.

    Returns
    -------
    list of BalancedCurve
        In the order of ``levels``.

    Raises
    ------
    InputError
        If there is nothing to vibrate steadily, a frequency or level is not positive, a level is so
        small or large that numbers lose motion or friction, ``sticking`` is below 1 or
        ``harmonics`` below 9, the system is too large, its loads have too high harmonics, its
        contact that opens is rigid, or it is a reduced model made for something else or for a
        range.
    ConvergenceError
        If no point is found.
    """
    frequencies, asked = _checked(system, frequencies, levels, sticking)
    check("harmonic_response: harmonics", harmonics, COUNTS)
    tally, rows = Tally(progress, len(asked) * frequencies.size), rows or Rows()
    search = Search.of(system, frequencies, sticking, tally, harmonics)
    search.check(asked)
    curves = dict[float, BalancedCurve]()
    origin = rows.mark("harmonic curves", system, frequencies, confirm, float(sticking), harmonics)
    for level in sorted(set(asked)):
        mark = rows.mark(origin, *curves, level)
        if mark in rows:
            tally.add(frequencies.size)

        def compute(level: float = level) -> tuple[BalancedCurve, FloatArray, float]:
            return _curve(search, level, confirm), search.start, search.level

        curves[level], search.start, search.level = rows.row(mark, compute)
    if not any(curve.found for curve in curves.values()):
        raise ConvergenceError("; ".join(nothing_found(curve) for curve in curves.values()))
    return [curves[level] for level in asked]


def _checked(
    system: System, frequencies: FloatArray, levels: Sequence[float], sticking: float
) -> tuple[FloatArray, list[float]]:
    """Frequencies and levels; InputError as `harmonic_response`."""
    check("harmonic_response: sticking", sticking, STIFF)
    frequencies, levels = checked("harmonic_response", system, frequencies, levels)
    if frequencies.size < 2:
        raise InputError(
            "harmonic_response: frequencies: must be two at least, in Hz: a branch is followed "
            "from the first to the last"
        )
    if system.serves is not None:
        raise InputError(
            "harmonic_response: found a reduced model for a range, whose law depends on the "
            "frequency; give sj.at(model, ...), or one that sj.reduce makes for a response"
        )
    loaded_at(system, float(frequencies[0]), 1.0)  # refuses loads without a common period
    parts = {part.frequency for load in system.loads for part in load.amplitude.harmonics}
    highest = round(max(parts) * period_of(system))
    if 2 * highest * system.n > MOST:
        found = ", ".join(f"{f:.9g}" for f in sorted(parts))
        raise InputError(
            f"harmonic_response: loads: found {found} Hz, the highest of which is harmonic "
            f"{highest} of their common period, too many for a balance; give frequencies whose "
            "ratios are simple, such as 1 and 2"
        )
    return frequencies, levels


def _curve(search: Search, level: float, confirm: bool) -> BalancedCurve:
    """Curve of a level that is higher than those before."""
    items, why = search.branches(level)
    points, errors, settled = list[SteadyPoint](), [], dict[int, Settled]()
    most = held = walks = restless = 0.0  # friction energy so far, J, mean force, and way, m
    for item in items:
        if isinstance(item, SteadyPoint):
            points.append(item)
            errors.append((np.nan, np.nan))
            continue
        found = search.settled(item, level, most)
        balance, judges = found.forced.balance, found.coarser or found  # exponents take long
        holds = stable(
            judges.forced.balance, judges.place.q, judges.place.omega, _slips(found.point)
        )
        held = max(held, balance.held_softly(found.place.q))
        walks = max(walks, balance.walked(found.place.q))
        restless = max(restless, balance.sampled(found.place.q, False).restless)
        settled[len(points)] = found
        points.append(replace(found.point, stable=holds))
        errors.append(found.errors)
        most = max(most, found.point.friction_energy)
    distances = [np.abs([p.frequency for p in points] - f).min() for f in search.frequencies]
    if lacking := search.frequencies[np.array(distances) > 1e-9 * search.frequencies].tolist():
        at = ", ".join(f"{f:.6g}" for f in lacking)
        why.append(
            f"there is no point at {at} Hz, where the branch with more harmonics turns before"
        )
    curve = BalancedCurve(level, tuple(points), dict(zip(NAMES, np.transpose(errors), strict=True)))
    judged = _judged(curve, settled)
    confirmed = {k: _confirmed(search, settled[k], level) for k in judged if confirm}
    for k, apart in confirmed.items():
        if np.isnan(apart).any():
            points[k] = replace(points[k], stable=None)
    rungs = [found.rung for found in settled.values()]
    return replace(
        curve,
        points=tuple(points),
        series=search.forced[max(rungs)].balance.series if rungs else None,
        why=tuple(why),
        law=tuple(notes_of_law(search.forced[0].balance.system.contact)),
        turns=tuple(_turns([found.place for found in settled.values()]))
        if search.system.contact.opens
        else (),
        held=held,
        walks=walks,
        restless=restless,
        sticking=_sticking(search, settled, judged, level),
        confirmed=confirmed,
    )


def _slips(point: SteadyPoint) -> bool:
    """Whether friction takes energy beyond round-off."""
    return point.friction_energy > 1e-9 * point.input_energy


def _turns(places: Sequence[BranchPoint]) -> Iterator[float]:
    """Frequencies, Hz, at which a branch turns: the vertex of omega over the arc of three places.

    Tangents tell less: those of sampled contact change their side several times at a turn.
    """
    omega, arc = np.array([x.omega for x in places]), np.cumsum([x.arc for x in places])
    for k in np.flatnonzero(np.diff(omega)[:-1] * np.diff(omega)[1:] < 0.0) + 1:
        three = slice(k - 1, k + 2)
        a, b, c = np.polyfit((arc[three] - arc[k]) / np.ptp(arc[three]), omega[three], 2)
        yield float(c - b**2 / (4.0 * a)) / (2.0 * np.pi)


def _judged(curve: BalancedCurve, settled: Mapping[int, Settled]) -> list[int]:
    """Numbers of three points: of about a quarter and half of the largest amplitude, and it.

    They are not unstable. Fewer where there are not so many.
    """
    known = [k for k in settled if curve.points[k].stable is not False]
    if not known:
        return []
    reach = np.array([curve.points[k].amplitude.max() for k in known])
    shares = reach.max() * np.array([0.25, 0.5, 1.0])
    return list(dict.fromkeys(known[int(np.abs(reach - share).argmin())] for share in shares))


def _sticking(
    search: Search, settled: Mapping[int, Settled], judged: Sequence[int], level: float
) -> tuple[float, float]:
    """Largest relative distances of amplitude and friction energy from rigid sticking."""
    if not search.rigid:
        return 0.0, 0.0
    slips = [k for k, found in settled.items() if _slips(found.point)]
    least = sorted(slips, key=lambda k: float(settled[k].point.amplitude.max()))[:1]
    at = [settled[k] for k in {*judged, *least}]
    apart = np.array(
        [search.sticking(found.coarser or found, level) for found in at] or [(np.nan, np.nan)]
    )
    return float(apart[:, 0].max()), float(apart[:, 1].max())


def _confirmed(search: Search, found: Settled, level: float) -> tuple[float, float]:
    """Relative differences of amplitude and friction energy of a point by time steps.

    nan where these do not become steady.
    """
    point, forced = found.point, found.forced
    loaded = loaded_at(search.system, point.frequency, level)
    plan = replace(steady_plan(loaded, suited_steps(loaded, STEPS)), save=Save())
    start = state_of(forced.balance, found.place.q, found.place.omega)
    try:
        run = integrate_plan(loaded, plan, initial=start)
    except ConvergenceError:
        return np.nan, np.nan
    amplitude, energy = run.vibration.amplitude, float(run.friction_work.sum())
    apart, most = (float(x.max()) for x in (np.abs(amplitude - point.amplitude), amplitude))
    least = OF_WORK * point.input_energy
    return apart / most if most > 0.0 else 0.0, change(energy, point.friction_energy, least)
