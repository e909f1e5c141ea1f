"""Nonlinear modes: frequency, damping, shape and harmonics over amplitude, into gross slip.

A mode is the periodic motion that the force 2 zeta omega M du/dt keeps up (extended periodic motion
concept, M. Krack, Comput. Struct. 154, 2015), by harmonic balance with exact Coulomb friction. Its
shape may change, joints may slip as a whole, contact may open.

A mode is followed along its branch from where it is linear, through turns in its amplitude, with
soft springs where contact sticks rigidly; its levels are found again with stiffer ones. Then
harmonics and samples are doubled at the levels that have not settled: the difference from a motion
with four times as many is stated as the error. Values are extrapolated from the two stiffest
springs to rigid ones.

Raised from 11 to 15 harmonics changed the damping of a bar by 0.4 % where 2 % was missing, because
a mode that lies near a multiple of the frequency does not show before that harmonic is there.
`examples/benchmarks/nonlinear_modes.py` measures stated errors beside true ones. The better motion
is found by Newton's method with its own derivative. Residuals alone do not find it: iterated with
the derivative of the coarser series, the linear one of each higher harmonic, and Anderson's
acceleration, 1 of 28 levels of a bar and a beam that stick rigidly converged in 60 passes, and of
12 points of a response of a bolted lap none in 40.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.progress import Progress, Tally, silent
from skfem_joint.ground.values import between, check_kind, check_numbers, rising
from skfem_joint.harmonic.balance import LARGEST, MODES, MOST, Balance, check_size, stuck_modes
from skfem_joint.harmonic.curve import NonlinearMode, curve_of, notes_of_errors
from skfem_joint.harmonic.levels import Levels, changes, chosen, climbed, relative, resolved
from skfem_joint.harmonic.marched import march
from skfem_joint.harmonic.mode_equations import ModeEquations
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.reduction.stuck import check_stuck_modes, traits_of
from skfem_joint.system.system import System

#: Harmonics and samples with which a mode is followed, one after the other until it reaches all
#: levels: where points slip one by one its way has kinks, fewer with more samples and without inner
#: loops.
STARTS = (3, 128), (3, 2048), (1, 512)
#: Those with which it is then followed anew, and most harmonics that judge others.
FOLLOWED, HIGHEST = (7, 256), 127
#: Springs of rigid sticking, by one over what they take off the square of the stuck frequency:
#: levels are climbed with the first, and extrapolated from the last two. The last are left out
#: where those before change no damping ratio by more than this, and where they lose a level.
RATIO = 10000.0 / 1400.0
FACTORS, CHANGED = (200.0, 1400.0, 10000.0, 10000.0 * RATIO), 0.05
#: What rigid sticking adds, over what the last springs changed: of frequency by the first order,
#: that of points that stick all the time, of damping by an order of 0.7, as points that stick again
#: as they turn come up by less: with springs up to 5e5 a bar and a beam showed 0.3 to 1, most of
#: them 0.5 to 0.8; and the error of both.
RIGID = {"frequency": 1.0 / (RATIO - 1.0), "damping_ratio": 1.0 / (RATIO**0.7 - 1.0)}
RIGID_ERROR = 0.3
#: Least stated errors, which Newton's iteration leaves.
FLOOR = {"frequency": 1e-5, "damping_ratio": 1e-4}
#: Relative errors of frequency and damping by which they have settled.
SETTLED = {"frequency": 3e-4, "damping_ratio": 5e-3}
#: Share of its first residual with which a level that only judges another one is found.
JUDGES = 0.1
#: Why a level is not found that was there with softer springs.
STIFFER = (
    "; with stiffer springs in place of rigid friction, found again from softer ones one by one, "
    "some are lost where points slip in another way"
)
#: Least and largest amplitude, whose squares and products with frequencies are numbers.
AMPLITUDES = between(1e-30, 1e30)
#: Displacement of a point, over the largest, below which a mode does not move it.
STILL = 1e-6


def nonlinear_modes(
    system: System,
    modes: Sequence[int] = (1,),
    *,
    amplitudes: ArrayLike,
    at: str | None = None,
    confirm: bool = True,
    progress: Progress = silent,
) -> list[NonlinearMode]:
    """Frequency, damping, shape and harmonics of some modes over their amplitude.

    Parameters
    ----------
    system : System
        Reduced, or small: its unknowns times coefficients of harmonics must be at most 1,300. Its
        friction acts as Coulomb's; its loads do not act. Contact that opens must be elastic.
    modes : sequence of int
        Numbers of the modes with the contact stuck, from 1.
    amplitudes : array_like, shape (levels,)
        Rising, m: first harmonic of the named point that the mode moves most, or modal amplitudes,
        m kg^1/2, where the system has no points.
    at : str, optional
        Name of the point whose amplitudes they are.
    confirm : bool
        Whether three levels are judged by time steps.
    progress : callable, optional
        Called with (levels done, levels in all as far as they are known).

    Returns
    -------
    list of NonlinearMode
        In the order of ``modes``.

    Raises
    ------
    InputError
        If amplitudes do not rise from 1e-30 to 1e30, there is no such mode or point, the mode is a
        motion as a rigid body, the system is too large, its contact that opens is rigid, or it is a
        reduced model made for something else, or all of it is in rigid contact.
    ConvergenceError
        If an amplitude is not found. The error's ``run`` is the curve up to there, if there is one.
    """
    check_kind("system", system, System)
    system.check_any_load("nonlinear_modes")
    if system.serves is not None:
        raise InputError(
            f"nonlinear_modes: found a reduced model for a range ({system.serves}), must be one of "
            "a curve, sj.reduce(system, curve=...), or a small full or condensed system"
        )
    check_numbers("nonlinear_modes: modes", modes)
    asked = rising("nonlinear_modes: amplitudes", amplitudes, AMPLITUDES)
    if at is not None and at not in system.points:
        raise InputError(
            f"nonlinear_modes: at: found {at!r}, must be one of "
            f"{', '.join(system.points) or 'none'}"
        )
    return [_mode(system, k, asked, at, confirm, progress) for k in modes]


def _mode(
    system: System,
    number: int,
    amplitudes: FloatArray,
    at: str | None,
    confirm: bool,
    progress: Progress,
) -> NonlinearMode:
    """One mode; ConvergenceError if an amplitude is not found."""
    rigid = bool(np.any(system.contact.rubs & ~system.contact.sprung))
    tally = Tally(progress, amplitudes.size)
    climbs = list[tuple[Levels, str]]()
    for start in STARTS if rigid else STARTS[:2]:
        equations = _equations(system, number, at, FACTORS[0], start)
        climbs.append(climbed(equations, amplitudes, tally))
        if climbs[-1][0].omega.size == amplitudes.size:
            break
    first, why = max(climbs, key=lambda one: one[0].omega.size)
    tries = list[tuple[Levels, Levels | None]]()
    for levels in _followed(first, tally):
        tries.append(_stiffened(system, at, levels, tally) if rigid else (levels, None))
        if tries[-1][0].omega.size == first.omega.size:
            break
    levels, softer = max(tries, key=lambda one: one[0].omega.size)
    if levels.omega.size < first.omega.size:
        why += STIFFER
    lacking = amplitudes[~np.isin(amplitudes, levels.amplitudes)]
    if levels.omega.size:
        settled = _settled(levels, tally)
        curve = _finished(*settled, softer, confirm and not lacking.size, tally)
        curve = replace(curve, traits=traits_of(system, curve.shape))
        if not lacking.size:
            return curve
    point = levels.equations.point
    unit = "m kg^1/2" if point is None else f"m of {system.points[point]!r}"
    raise ConvergenceError(
        f"nonlinear_modes: mode {number} is not found at {lacking.size} of {amplitudes.size} "
        f"amplitudes, {', '.join(f'{a:.4g}' for a in lacking)} {unit} ({why.lstrip('; ')}); "
        + (
            "the others are in the error's run. Ask for these, or see a ring-down"
            if levels.omega.size
            else "ask for lower ones, or see a ring-down"
        ),
        run=curve if levels.omega.size else None,
    )


def _stiffened(
    system: System, at: str | None, levels: Levels, tally: Tally
) -> tuple[Levels, Levels]:
    """Levels that are found with the stiffest springs, and with the next softer ones."""
    series = levels.series.highest, levels.series.samples
    softer = levels
    for factor in FACTORS[1:]:
        last = factor == FACTORS[-1]
        if last and changes(levels, softer)["damping_ratio"].max(initial=0.0) <= CHANGED:
            break
        equations = _equations(system, levels.equations.number, at, factor, series)
        stiffer, found = resolved(levels, equations, tally)
        if last and not found.all():
            break
        levels, softer = stiffer.only(found), levels.only(found)
    return levels, softer


def _equations(
    system: System, number: int, at: str | None, factor: float, series: tuple[int, int]
) -> ModeEquations:
    """Equations of a mode with springs of a factor, in a series of harmonics and samples.

    InputError if there is no such mode, it is a rigid motion, or does not move the point.
    """
    fourier = FourierSeries(*series, not system.contact.opens)
    check_size(system, fourier)
    frequencies, shapes = stuck_modes(system, max(MODES, number))
    check_stuck_modes("nonlinear_modes", [number], frequencies)
    reference, shape = float(frequencies[number - 1]), shapes[:, number - 1]
    balance = Balance.of(system, fourier, reference, factor)
    if not system.points:
        return ModeEquations(balance, number, shape, as_dense(system.M) @ shape, 1.0)
    moved = np.asarray(system.P @ shape)
    point = int(np.abs(moved).argmax()) if at is None else system.points.index(at)
    if np.abs(moved[point]) <= STILL * np.abs(system.expand(shape)).max():
        raise InputError(
            f"nonlinear_modes: at: mode {number} does not move {system.points[point]!r}, which has "
            "a direction of its own; choose another point or mode"
        )
    looked_at = np.sign(moved[point]) * as_dense(system.P)[point]
    modal = 1.0 / abs(float(moved[point]))
    return ModeEquations(balance, number, shape, looked_at, modal, point)


def _followed(levels: Levels, tally: Tally) -> Iterator[Levels]:
    """Levels followed anew with `FOLLOWED` harmonics, if the mode is not lost; then as they are.

    With more harmonics a mode may turn where another one takes part.
    """
    highest, samples = FOLLOWED
    series = FourierSeries(highest, max(samples, levels.series.samples), levels.series.odd)
    if levels.omega.size and levels.equations.balance.size(series) <= MOST:
        finer, _ = climbed(levels.equations.refined(series), levels.amplitudes, tally)
        if finer.omega.size == levels.omega.size:
            yield finer
    yield levels


def _settled(
    levels: Levels, tally: Tally
) -> tuple[list[Levels], IntArray, IntArray, dict[str, FloatArray]]:
    """Levels with more and more harmonics, which of these each takes and has, and relative errors.

    Harmonics are doubled. The error of a level is its difference from the one with four times as
    many, or where these are not found, or are too many, with twice as many. A level has the fewest
    with which it has settled, or the most whose error is known; it is nan where there are none.
    """
    rungs, taken = [levels], np.zeros(levels.omega.size, np.intp)
    errors, finest = {name: np.full(taken.size, np.nan) for name in SETTLED}, taken.copy()
    open_ = np.ones(taken.size, np.bool_)
    known = [open_]
    while open_.any():
        last, series = rungs[-1], rungs[-1].series.doubled
        size = last.equations.balance.size
        if series.highest > HIGHEST or size(series) > LARGEST:
            break
        ends = series.highest == HIGHEST or size(series.doubled) > MOST
        falls = JUDGES if series.highest == HIGHEST or size(series.doubled) > LARGEST else 0.0
        finer, found = resolved(last, last.equations.refined(series), tally, open_, falls)
        known.append(open_ & found)
        finest[known[-1]] = len(rungs)
        for rung in range(max(0, len(rungs) - 2), len(rungs)):
            rows = open_ & found & known[rung]
            apart = {
                name: relative(value - rungs[rung].values[name], value)
                for name, value in finer.values.items()
            }
            for name, error in errors.items():
                error[rows] = np.maximum(apart[name], FLOOR[name])[rows]
            taken[rows] = rung
            if ends or rung < len(rungs) - 1:
                settles = np.all([apart[name] <= SETTLED[name] for name in SETTLED], axis=0)
                open_ = open_ & ~(rows & settles)
        if ends:
            open_ = open_ & found
        rungs.append(finer)
    return rungs, taken, finest, errors


def _finished(
    rungs: list[Levels],
    taken: IntArray,
    finest: IntArray,
    errors: dict[str, FloatArray],
    softer: Levels | None,
    confirm: bool,
    tally: Tally,
) -> NonlinearMode:
    """Curve of levels, extrapolated from those with ``softer`` springs, where there are such.

    Its errors of sticking are nan where a level is not found with the softer springs. Time steps
    start on the motions with the most harmonics: others take periods to get those they lack.
    """
    levels = chosen(rungs, taken)
    by_source, values = {"harmonics": errors}, levels.values
    if softer is not None:
        others = [
            resolved(rung, softer.equations.refined(rung.series), tally, taken == k)
            for k, rung in enumerate(rungs[: taken.max() + 1])
        ]
        other = chosen([x for x, _ in others], taken)
        found = np.array([others[k][1][i] for i, k in enumerate(taken.tolist())])
        kept = {name: np.where(found, other.values[name], new) for name, new in values.items()}
        other = replace(other, omega=kept["frequency"], zeta=kept["damping_ratio"])
        by_source["sticking"] = {
            name: np.where(found, RIGID_ERROR * change, np.nan)
            for name, change in changes(levels, other).items()
        }
        values = {name: new + RIGID[name] * (new - kept[name]) for name, new in values.items()}
    best = replace(chosen(rungs, finest), omega=levels.omega, zeta=levels.zeta)
    marched = march(best, _judged(levels)) if confirm else None
    curve = curve_of(levels, values, by_source, marched)
    notes = (f"Mode {curve.mode}: {note}" for note in notes_of_errors(curve, SETTLED))
    return replace(curve, notes=(*curve.notes, *notes))


def _judged(levels: Levels) -> IntArray:
    """Numbers of three levels: where damping is largest, and half way to both ends."""
    last, peak = levels.omega.size - 1, int(levels.zeta.argmax())
    return np.unique([(peak + 1) // 2, peak, (peak + last + 1) // 2])
