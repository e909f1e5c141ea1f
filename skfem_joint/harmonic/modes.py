"""Nonlinear modes: frequency, damping, shape and harmonics over amplitude, into gross slip.

A mode is the periodic motion that the force 2 zeta omega M du/dt keeps up (extended periodic motion
concept, M. Krack, Comput. Struct. 154, 2015), by harmonic balance with exact Coulomb friction. Its
shape may change, joints may slip as a whole, contact may open.

Levels follow each other from a linear mode on, with soft springs where contact sticks rigidly, and
are found again with stiffer ones. Then harmonics and samples are raised at the levels that have not
settled; a share of what the last rise changed is stated as their error. Values are extrapolated
from the two stiffest springs to rigid ones.

Harmonics are doubled. Raised from 11 to 15 they changed the damping of a bar by 0.4 % where 2 %
was missing, because a mode that lies near a multiple of the frequency does not show before that
harmonic is there. Shares are those of curves beside solutions with four times the harmonics:
`examples/benchmarks/nonlinear_modes.py` measures them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense, as_real
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.progress import Progress, Tally, silent
from skfem_joint.ground.values import check_numbers
from skfem_joint.harmonic.balance import MODES, MOST, Balance, check_size, stuck_modes
from skfem_joint.harmonic.curve import NonlinearMode, curve_of, notes_of_errors
from skfem_joint.harmonic.levels import Levels, changes, climbed, resolved
from skfem_joint.harmonic.marched import march
from skfem_joint.harmonic.mode_equations import ModeEquations
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.system.system import System

#: Harmonics and samples, raised until values settle.
LADDER = (3, 128), (7, 256), (15, 512), (31, 1024), (63, 2048)
#: Springs of rigid sticking, by one over what they take off the square of the stuck frequency:
#: levels are climbed with the first, and extrapolated from the last two.
FACTORS = 200.0, 1400.0, 10000.0
#: What rigid sticking adds, over what the last springs changed: by the first order, and of damping
#: by some 0.8, as points that stick again as they turn come up by less; and the error of that.
RIGID, RIGID_ERROR = (
    {"frequency": 1.0 / (FACTORS[-1] / FACTORS[-2] - 1.0), "damping_ratio": 0.25},
    0.12,
)
#: Share of what the last rise of harmonics changed that is left: with springs in series, with rigid
#: sticking, and where harmonics that are not there, up to the highest that matters, meet a mode.
SHARE_LEFT, SHARE_RIGID, SHARE_MET, MEETS = 0.1, 0.4, 0.6, 31
#: Least stated errors, which Newton's iteration leaves.
FLOOR = {"frequency": 1e-5, "damping_ratio": 1e-4}
#: Relative errors of frequency and damping by which they have settled, if half of what the last
#: rise of harmonics changed is below them, too.
SETTLED = {"frequency": 3e-4, "damping_ratio": 5e-3}
#: Least and largest amplitude, whose squares and products with frequencies are numbers.
AMPLITUDES = 1e-30, 1e30
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
    system.check_any_load("nonlinear_modes")
    if system.serves is not None:
        raise InputError(
            f"nonlinear_modes: found a reduced model for a range ({system.serves}), must be one of "
            "a curve, sj.reduce(system, curve=...), or a small full or condensed system"
        )
    check_numbers("nonlinear_modes: modes", modes)
    asked = np.asarray(as_real(amplitudes, "nonlinear_modes: amplitudes"))
    low, high = AMPLITUDES
    rises = asked.ndim == 1 and asked.size and np.all(np.diff(asked) > 0.0)
    if not rises or not np.all((asked >= low) & (asked <= high)):
        raise InputError(
            f"nonlinear_modes: amplitudes: found {asked.tolist()}, must be positive and rise, from "
            f"{low:g} to {high:g}"
        )
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
    levels, failure = climbed(_equations(system, number, at, FACTORS[0]), np.log(amplitudes), tally)
    softer = None
    for factor in FACTORS[1:] if rigid else ():
        softer = levels
        levels, found = resolved(levels, _equations(system, number, at, factor), tally)
        if not found.all():
            failure = failure or ConvergenceError("with stiffer springs of sticking")
            levels = levels.up_to(int(np.argmin(found)))
    softer = softer and softer.up_to(levels.omega.size)
    if not levels.omega.size:
        raise ConvergenceError(
            f"nonlinear_modes: mode {number} is not found at the first amplitude; ask for lower "
            "ones"
        )
    levels, errors = _settled(levels, rigid, tally)
    if failure is None:
        return _finished(levels, errors, softer, confirm, tally)
    curve = _finished(levels, errors, softer, False, tally)
    where = f"{amplitudes[levels.omega.size]:.4g} m" + (f" of {curve.point!r}" * bool(curve.point))
    raise ConvergenceError(
        f"nonlinear_modes: mode {number} is not found at an amplitude of {where} ({failure}); the "
        f"{levels.omega.size} levels below are in the error's run. Ask for levels up to there, or "
        "see a ring-down",
        run=curve,
    )


def _equations(system: System, number: int, at: str | None, factor: float) -> ModeEquations:
    """Equations of a mode with springs of a factor, in the first series.

    InputError if there is no such mode, it is a rigid motion, or does not move the point.
    """
    highest, samples = LADDER[0]
    series = FourierSeries(highest, samples, not system.contact.opens)
    check_size(system, series)
    frequencies, shapes = stuck_modes(system, max(MODES, number))
    if number > frequencies.size:
        raise InputError(
            f"nonlinear_modes: found mode {number}, there are {frequencies.size} with the contact "
            "stuck"
        )
    reference, shape = float(frequencies[number - 1]), shapes[:, number - 1]
    if reference == 0.0:
        raise InputError(
            f"nonlinear_modes: mode {number} moves the structure as a rigid body; support it, or "
            "choose a higher mode"
        )
    balance = Balance.of(system, series, reference, factor)
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


def _settled(levels: Levels, rigid: bool, tally: Tally) -> tuple[Levels, dict[str, FloatArray]]:
    """Levels with as many harmonics as it takes, and the relative errors left.

    A level that is not found with more harmonics keeps its own, and the largest error of all.
    Errors are nan where more harmonics were never found, or would make too large a derivative.
    """
    errors = {name: np.full(levels.omega.size, np.nan) for name in SETTLED}
    open_ = np.ones(levels.omega.size, np.bool_)
    for highest, samples in LADDER[1:]:
        balance = levels.equations.balance
        series = FourierSeries(highest, samples, balance.series.odd)
        if series.size * balance.frequencies.size > MOST or not open_.any():
            break
        equations = replace(levels.equations, balance=balance.refined(series))
        finer, found = resolved(levels, equations, tally, open_)
        share, settled = _share_left(finer, rigid), np.ones_like(open_)
        for name, change in changes(finer, levels).items():
            new = np.where(open_ & found, np.maximum(share * change, FLOOR[name]), errors[name])
            errors[name] = np.where(found, new, new.max())
            settled &= np.maximum(errors[name], 0.5 * change) <= SETTLED[name]
        levels, open_ = finer, open_ & ~settled
    return levels, errors


def _share_left(levels: Levels, rigid: bool) -> FloatArray:
    """Share, (levels,), of what the last rise of harmonics changed that is left as an error."""
    omega, modes = levels.omega[:, np.newaxis], levels.equations.balance.frequencies
    met = (modes > levels.series.highest * omega) & (modes < MEETS * omega)
    return np.where(met.any(axis=1), SHARE_MET, SHARE_RIGID if rigid else SHARE_LEFT)


def _finished(
    levels: Levels,
    errors: dict[str, FloatArray],
    softer: Levels | None,
    confirm: bool,
    tally: Tally,
) -> NonlinearMode:
    """Curve of levels, extrapolated from those with ``softer`` springs, where there are such.

    Its errors of sticking are nan where a level is not found with the softer springs.
    """
    by_source, values = {"harmonics": errors}, levels.values
    if softer is not None:
        balance = softer.equations.balance.refined(levels.series)
        other, found = resolved(levels, replace(softer.equations, balance=balance), tally)
        kept = {name: np.where(found, other.values[name], new) for name, new in values.items()}
        other = replace(other, omega=kept["frequency"], zeta=kept["damping_ratio"])
        by_source["sticking"] = {
            name: np.where(found, RIGID_ERROR * change, np.nan)
            for name, change in changes(levels, other).items()
        }
        values = {name: new + RIGID[name] * (new - kept[name]) for name, new in values.items()}
    marched = march(levels, _judged(levels)) if confirm else None
    curve = curve_of(levels, values, by_source, marched)
    notes = (f"Mode {curve.mode}: {note}" for note in notes_of_errors(curve, SETTLED))
    return replace(curve, notes=(*curve.notes, *notes))


def _judged(levels: Levels) -> IntArray:
    """Numbers of three levels: where damping is largest, and half way to both ends."""
    last, peak = levels.omega.size - 1, int(levels.zeta.argmax())
    return np.unique([(peak + 1) // 2, peak, (peak + last + 1) // 2])
