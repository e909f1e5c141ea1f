"""Steady vibration over frequency, a curve for each level of load.

Each point of a curve is one period of steady vibration (:mod:`skfem_joint.steady.steady`). The
search for it starts from the steady state at the frequency before, so that few periods are needed.
Amplitudes are half of peak to peak. The mean of both peaks, which depends on how the vibration
began, is a result of its own, the offset.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from scipy import sparse

from skfem_joint.accuracy.range_modes import alone, steady_in_range
from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.errors import ConvergenceError, GrossSlipError, InputError
from skfem_joint.ground.loads import common_period, harmonic_factors
from skfem_joint.ground.progress import Progress, Tally, silent
from skfem_joint.ground.rows import Rows
from skfem_joint.ground.values import COUNT, POSITIVE, check, check_each, check_kind, rising
from skfem_joint.reduction.ranges.points import check_short_of_gross_slip, loaded_at
from skfem_joint.results.history import relative
from skfem_joint.results.loss import losses
from skfem_joint.runs.integrate import TOLERANCE
from skfem_joint.runs.steady_run import steady_run
from skfem_joint.steady.correction import Correction
from skfem_joint.steady.steady import odd_loads
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Save
from skfem_joint.system.served import Served
from skfem_joint.system.system import System
from skfem_joint.vibration.response_curve import Curve, State, SteadyPoint, nothing_found

_log = logging.getLogger(__name__)

#: Harmonics of the steady vibration that results report.
HARMONICS = 5
#: Periods in turn in which a joint slips as a whole after which a search is given up, see
#: `Plan.gross_periods`.
GROSS = 10


class Guide(NamedTuple):
    """What a reduced model says of a steady vibration of a larger one.

    Attributes
    ----------
    amplitude : float
        Its largest amplitude, m; nan if none was found.
    step_error : float
        Relative error of that by the time step; nan if it is not known.
    correction : Correction or None
        Of the search for the larger model's vibration.
    """

    amplitude: float
    step_error: float
    correction: Correction | None

    def error_of(self, amplitude: float) -> float:
        """Error of the step of an amplitude, nan if that of the reduced model is another one."""
        # Where the amplitude of a coarse model differs by more than this share, the error of the
        # step is found on the larger model itself.
        alike = abs(self.amplitude - amplitude) <= 0.1 * amplitude
        return self.step_error if alike else np.nan


def at_frequency(system: System, frequency: float, level: float = 1.0) -> System:
    """Same system with its loads at another frequency (Hz, of their common period) and level.

    InputError if a load is not made of harmonics, or the frequency is not positive, or outside the
    range of a model for one.
    """
    if system.serves is not None:  # its law and limits are those of the point
        return steady_in_range(system, frequency, level)
    check("response: frequency", frequency, POSITIVE)
    return loaded_at(system, frequency, level)


def steady_plan(system: System, steps_per_cycle: int) -> Plan:
    """Plan of a search for the steady vibration of a system under its harmonic loads.

    Steps are of the trapezoidal rule, exact at the frequency of the strongest harmonic.
    """
    amplitudes = [load.amplitude for load in system.loads]
    period = common_period(amplitudes) or 1.0
    parts = [part for amplitude in amplitudes for part in amplitude.harmonics]
    strongest = max(parts, key=lambda part: (abs(part.amplitude), -part.frequency))
    return Plan(
        step=period / steps_per_cycle,
        n_steps=steps_per_cycle,
        cycle_steps=steps_per_cycle,
        until="steady",
        gross_periods=GROSS,
        exact_at=strongest.frequency,
    )


def suited_steps(system: System, steps_per_cycle: int) -> int:
    """Least number of steps in a period, from the one asked for on, that suits the search.

    The trapezoidal rule turns the sign of the force at sticking points from step to step, for ever.
    A period, or half of one with a change of sign, must not end with the sign that it began with:
    else Newton's method has no unique step. With contact that opens, where the search is marching,
    the sign must be the same: else points would come to rest differently in every second period.
    """
    if odd_loads(system) or system.contact.opens:
        return 4 * -(-steps_per_cycle // 4)
    return steps_per_cycle + 1 - steps_per_cycle % 2


def response(
    system: System,
    frequencies: FloatArray,
    levels: Sequence[float] = (1.0,),
    *,
    steps_per_cycle: int = 200,
    refined: bool = True,
    estimated: bool = True,
    executor: Executor | None = None,
    workers: int | None = None,
    coarse: Any = None,
    progress: Progress = silent,
    rows: Rows | None = None,
) -> list[Curve]:
    """Steady vibration over frequency, a curve for each level.

    Parameters
    ----------
    system : System
        Full, condensed, or reduced by ``reduce(system, frequency=..., level=...)`` or for a range
        by ``reduce(system, range=...)``; its loads are harmonic, and contact may open. A model that
        `skfem_joint.reduce` made for its loads as they are, or for a curve, is refused. One for a
        range has no points in gross slip, which say so.
    frequencies : ndarray, shape (k,)
        First harmonics of the loads, Hz, rising.
    levels : sequence of float
        Factors of the loads' amplitudes.
    steps_per_cycle : int
        Time steps in a period of the loads, at least; the next number from there is taken that
        `suited_steps` allows. They are of the trapezoidal rule, exact at the frequency of the
        strongest harmonic for linear vibration (:mod:`skfem_joint.stepping.warp`).
    refined : bool
        Whether points are added around peaks and where a curve is steep.
    estimated : bool
        Whether each point is computed with half the step too, which gives the error of its step.
    executor : concurrent.futures.Executor, optional
        Where levels are run side by side.
    workers : int, optional
        How many it has: levels that take longest go first where they are fewer.
    coarse : CoarseModel, optional
        Reduced model beside a larger one, see `skfem_joint.vibration.coarse_model`: it corrects the
        searches, and the error of the step is found on it.
    progress : callable, optional
        Called with (vibrations found, vibrations in all), and between them, without an executor,
        with a note on the search. Those in all grow as frequencies are added.
    rows : Rows, optional
        Where steady vibrations are kept as they finish, and taken up again.

    Returns
    -------
    list of Curve
        In the order of ``levels``. Those at which a joint slips as a whole say so
        (``curve.gross``), also to the log. There a search that is not steady after ten periods, or
        fifty where it has Newton's method or contact opens, is given up with the frequencies that
        follow, and the next level begins; ``curve.found`` is False where nothing was found.

    Raises
    ------
    InputError
        If there is nothing to vibrate steadily, a frequency or level is not positive, the system
        is a reduced model made for something else, or a level is above its highest.
    ConvergenceError
        If no frequency of any level has a steady vibration.
    """
    check("response: steps_per_cycle", steps_per_cycle, COUNT)
    frequencies, levels = checked("response", system, frequencies, levels)
    for frequency in frequencies[[0, -1]].tolist():
        at_frequency(system, frequency)  # refuses what is outside of a range
    by_model = estimated and system.serves is not None  # by the larger model that it carries
    steps_per_cycle = suited_steps(system, steps_per_cycle)
    rows, tally = rows or Rows(), Tally(progress)
    # Vibrations of each frequency: itself, with half the step, of a larger model.
    each = 1 + (estimated and coarse is None) + by_model
    tally.total = each * len(levels) * frequencies.size
    finer = suited_steps(system, 2 * steps_per_cycle) if estimated else None
    of_coarse = None if coarse is None else finer
    first = _Request(float(frequencies[0]), 1.0, steps_per_cycle, of_coarse)
    searches = [
        _search(frequencies, replace(first, level=level), finer, refined, tally, each)
        for level in levels
    ]
    curves = _curves(searches, system, coarse, executor, workers, tally, rows)
    if not any(curve.found for curve in curves):
        raise ConvergenceError("; ".join(nothing_found(curve) for curve in curves))
    if not by_model:
        return curves
    return [_with_model_errors(c, system, steps_per_cycle, tally, rows) for c in curves]


def checked(
    what: str, system: System, frequencies: FloatArray, levels: Sequence[float]
) -> tuple[FloatArray, list[float]]:
    """Frequencies (Hz) and levels of a response; InputError for others, which ``what`` begins.

    InputError too if nothing is observed, or no load acts.
    """
    check_kind("system", system, System)
    frequencies = rising(f"{what}: frequencies", frequencies)
    check_each(f"{what}: levels", levels, POSITIVE)
    system.check_any_load("response", max(levels))
    if not system.points:
        raise InputError(f"{what}: nothing is observed; name a point")
    if all(load.amplitude.peak_value == 0.0 for load in system.loads):
        raise InputError(f"{what}: no load acts; give one an amplitude above 0")
    return frequencies, np.asarray(levels, dtype=float).tolist()


def _with_model_errors(
    curve: Curve, system: System, steps_per_cycle: int, tally: Tally, rows: Rows
) -> Curve:
    """Curve of a model for a range with its distance from that of its larger model.

    What a distance says of the error was found where the model was made.
    """
    largest, points, serves = curve.largest, [], Served.by(system)
    origin = rows.mark("larger model", system, steps_per_cycle)
    for point in curve.points:
        at, found = (point.frequency, curve.level), point
        if point.failure is None:
            loaded = alone(steady_in_range(system, *at))
            compute = partial(_steady, loaded, at[0], steps_per_cycle, None, tally.within)
            other = rows.row(rows.mark(origin, at), compute)
            change = relative(point.amplitude[largest], other.amplitude[largest])
            error = np.nan if change is None else serves.error("amplitude", abs(change))
            found = replace(point, model_error=error)
            tally.add()
        points.append(found)
    return Curve(curve.level, tuple(points))


@dataclass(frozen=True)
class _Request:
    """A steady vibration that the search for a curve needs next.

    ``finer`` is the number of steps in a period with which the error of the step is found on a
    coarse model, None if it is not. ``with_state`` says whether others will start from its state.
    """

    frequency: float
    level: float
    steps_per_cycle: int
    finer: int | None
    start: State | None = None
    with_state: bool = True

    def compute(self, system: System, coarse: Any, progress: Progress) -> SteadyPoint:
        """The vibration of a system, beside which there may be a coarse model."""
        at = self.frequency, self.level, self.steps_per_cycle
        guide = Guide(np.nan, np.nan, None) if coarse is None else coarse.guide(*at, self.finer)
        point = steady_point(system, *at, self.start, progress, guide.correction)
        if not self.with_state:
            return replace(point, state=None, course=None)
        if point.failure is not None:
            return point
        return replace(point, step_error=guide.error_of(float(point.amplitude.max())))


#: A search yields requests, is sent their results, and returns its curve.
_Search: TypeAlias = Generator[_Request, SteadyPoint, Curve]


def _curves(
    searches: list[_Search],
    system: System,
    coarse: Any,
    executor: Executor | None,
    workers: int | None,
    tally: Tally,
    rows: Rows,
) -> list[Curve]:
    """Curves of all searches: one after another, or side by side with an executor.

    Each steady vibration is a row, named by all that it depends on. Levels rise, and high ones take
    longest: theirs go first where there are fewer workers than levels.
    """
    origin = rows.mark("steady point", system, coarse)
    curves: dict[int, Curve] = {}
    workers = workers or len(searches)
    waiting: dict[int, tuple[str, _Request]] = {}
    running: dict[Future[SteadyPoint], tuple[int, str, float]] = {}

    def advance(number: int, point: SteadyPoint | None) -> None:
        """Answer the requests of a search up to its end, or to one that waits for the executor."""
        try:
            while True:
                request = searches[number].send(point)  # type: ignore[arg-type]  # None begins it
                mark = rows.mark(origin, request)
                if mark in rows:
                    point = rows.take(mark)
                elif executor is None:
                    begin = time.perf_counter()
                    point = request.compute(system, coarse, tally.within)
                    point = rows.keep(mark, point, time.perf_counter() - begin)
                else:
                    waiting[number] = mark, request
                    return
                tally.add()
        except StopIteration as end:
            curves[number] = end.value

    try:
        for number in range(len(searches)):
            advance(number, None)
        while executor is not None and (waiting or running):
            while waiting and len(running) < workers:
                number = max(waiting)
                mark, request = waiting.pop(number)
                future = executor.submit(request.compute, system, coarse, silent)
                running[future] = number, mark, time.perf_counter()
            found: dict[int, SteadyPoint] = {}
            # What is finished is kept before anything that failed is raised.
            for future in sorted(wait(running, return_when=FIRST_COMPLETED).done, key=_failed):
                number, mark, begin = running.pop(future)
                found[number] = rows.keep(mark, future.result(), time.perf_counter() - begin)
                tally.add()
            for number, point in found.items():
                advance(number, point)
    finally:
        for future in running:
            future.cancel()
    return [curves[number] for number in range(len(searches))]


def _failed(future: Future[SteadyPoint]) -> bool:
    """Whether the result of a future that is done would raise."""
    return future.cancelled() or future.exception() is not None


def _search(
    frequencies: FloatArray,
    first: _Request,
    finer: int | None,
    refined: bool,
    tally: Tally,
    each: int,
) -> _Search:
    """Request the points of a curve: those asked for, those added, then some with a finer step.

    Parameters
    ----------
    first : _Request
        The first one.
    finer : int or None
        Number of steps in a period with which the error of the step is found where no coarse model
        has found it; None for no estimate.
    tally : Tally
        Has ``each`` vibrations for each frequency that is asked for; others are added.
    """
    level = first.level
    points: list[SteadyPoint] = []
    state: State | None = None
    said = False
    for frequency in frequencies.tolist():
        points.append((yield replace(first, frequency=frequency, start=state)))
        state = points[-1].state
        if points[-1].gross and not said:
            said = True
            _log.warning("response: level %g: a joint slips as a whole at %g Hz", level, frequency)
        if points[-1].failure is not None and points[-1].periods > 0:
            break  # a search given up, as those of the frequencies that follow would be
    if not Curve(level, tuple(points)).found:
        tally.total -= frequencies.size * (each - 1)
        return Curve(level, tuple(points))
    refined = refined and len(points) >= frequencies.size
    # Most frequencies that are added to those asked for, of each curve.
    for _ in range(24 if refined else 0):
        added = next(_frequencies_to_add(Curve(level, tuple(points))), None)
        if added is None:
            break
        tally.total += each
        state = min(points, key=lambda point: abs(point.frequency - added)).state
        points.append((yield replace(first, frequency=added, start=state)))
        points.sort(key=lambda point: point.frequency)
    failed = sum(point.failure is not None for point in points)
    failed += max(0, frequencies.size - len(points))
    tally.total -= failed * (each - 1)
    if finer is None:
        return Curve(level, tuple(points))
    left = [k for k, p in enumerate(points) if p.failure is None and np.isnan(p.step_error)]
    if first.finer is not None:
        tally.total += len(left)
    largest, steps = Curve(level, tuple(points)).largest, first.steps_per_cycle
    for k in left:
        point = points[k]
        half = replace(first, frequency=point.frequency, steps_per_cycle=finer, finer=None)
        other = yield replace(half, start=point.state, with_state=False)
        amplitudes = point.amplitude[largest], other.amplitude[largest]
        points[k] = replace(point, step_error=error_of_step(*amplitudes, steps, finer))
    return Curve(level, tuple(points))


def error_of_step(amplitude: float, other: float, steps: int, finer: int) -> float:
    """Relative error of an amplitude by ``steps`` in a period, from another one with more steps.

    All schemes are of second order. nan if neither is known.
    """
    change = relative(other, amplitude)
    return np.nan if change is None else abs(change) / (1.0 - (steps / finer) ** 2)


def _frequencies_to_add(curve: Curve) -> Iterator[float]:
    """Frequencies (Hz) that would refine a curve: first where it is steep, then at its peak."""
    f, A = curve.known
    if f.size < 3:
        return
    width = np.diff(f)
    # No frequency is added in intervals narrower than this share of the median interval.
    wide = width > 0.25 * np.median(width)
    # A frequency is added between two whose amplitudes differ by more than this share of the
    # largest.
    for k in np.flatnonzero((np.abs(np.diff(A)) > 0.15 * A.max()) & wide):
        yield float(0.5 * (f[k] + f[k + 1]))
    peak, _ = curve.peak
    # No frequency is added at the peak if another one is nearer than this share of the peak's.
    if np.abs(f - peak).min() > 2e-4 * peak:
        yield peak


def steady_point(
    system: System,
    frequency: float,
    level: float = 1.0,
    steps_per_cycle: int = 200,
    start: State | None = None,
    progress: Progress = silent,
    correction: Correction | None = None,
) -> SteadyPoint:
    """Steady vibration at one frequency (Hz); ``failure`` says why where there is none.

    ``start`` is the displacement (m) and velocity (m/s) that the search starts from; rest if not
    given. ``correction`` is a smaller model's. The other arguments are those of :func:`response`.
    """
    loaded = at_frequency(system, frequency, level)
    return _steady(loaded, frequency, steps_per_cycle, start, progress, correction)


def _steady(
    system: System,
    frequency: float,
    steps_per_cycle: int,
    start: State | None,
    progress: Progress,
    correction: Correction | None = None,
) -> SteadyPoint:
    """Steady vibration of a system that has its loads at a frequency (Hz)."""
    plan = replace(steady_plan(system, steps_per_cycle), save=Save(fields=system.is_dense))
    start = start or (np.zeros(system.n), np.zeros(system.n))
    count, slips = len(system.points), [f"slip {k}" for k in range(system.contact.B.shape[0])]
    both = system.P, system.contact.B  # slips are seen as named points are
    P = np.vstack([*map(as_dense, both)]) if system.is_dense else sparse.vstack(both).tocsr()
    seen = replace(system, P=P, points=(*system.points, *slips))
    try:
        run = steady_run(seen, plan, start, TOLERANCE, progress, correction)
        if system.serves is not None:  # its modes do not follow joints that slip as a whole
            check_short_of_gross_slip(run)
    except ConvergenceError as error:
        return _without_vibration(system, frequency, error)
    slip = system.contact.slid(run.friction_work)
    vibration, harmonics = run.vibration, harmonics_of(run.point_u[:-1, :count])
    return SteadyPoint(
        frequency=frequency,
        amplitude=vibration.amplitude[:count],
        offset=vibration.offset[:count],
        harmonics=harmonics,
        phase=phases_of(harmonics, system),
        friction_energy=float(run.friction_work.sum()),
        input_energy=float(run.input_work.sum()),
        slip=system.contact.slip_norm(vibration.amplitude[count:]),
        losses=losses(run),
        friction_work=run.cycles.by_point,
        share=float(system.slipping_share(slip, plan.duration)),
        gross=system.slips_as_a_whole(slip, plan.duration),
        periods=vibration.periods,
        change=vibration.change,
        state=(*run.final,),
        course=run.u if system.is_dense else None,
    )


def _without_vibration(system: System, frequency: float, why: ConvergenceError) -> SteadyPoint:
    """Point of a frequency (Hz) without steady vibration."""
    nothing, gross = np.full(len(system.points), np.nan), isinstance(why, GrossSlipError)
    cure = (
        "; or balance harmonics, which marches through no periods, of a reduced or small model: "
        "sj.harmonic_response, in a scene response.method = 'harmonic'"
    )
    return SteadyPoint(
        frequency=frequency,
        amplitude=nothing,
        offset=nothing,
        harmonics=np.full((nothing.size, HARMONICS), np.nan + 0j),
        phase=nothing,
        slip=np.full(system.contact.w.size, np.nan),
        periods=why.periods if isinstance(why, GrossSlipError) else 0,
        failure=str(why) if gross else f"{why}{cure}",
        gross=gross,
    )


def phases_of(harmonics: FloatArray, system: System) -> FloatArray:
    """Phases of the first of ``harmonics`` (points, k) to that of the first load, rad.

    Where that load has none they are those to a cosine. Its vector does not count.
    """
    load = harmonic_factors([load.amplitude for load in system.loads]).get(1, [0.0])[0]
    return np.asarray(np.angle(harmonics[:, 0] / (load or 1.0)))


def harmonics_of(rows: FloatArray) -> FloatArray:
    """Harmonics of the columns over a period, (columns, harmonics), complex.

    Those from half the sampling rate on, which so few rows do not determine, are nan.
    """
    harmonics = np.full((rows.shape[1], HARMONICS), np.nan + 0j)
    known = min((len(rows) - 1) // 2, HARMONICS)
    harmonics[:, :known] = 2.0 * np.fft.rfft(rows, axis=0)[1 : known + 1].T / len(rows)
    return harmonics
