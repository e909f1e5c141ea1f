"""Where the time step alone makes a response doubtful, and by which cause."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from skfem_joint.analysis.response import Curve, follows_twice
from skfem_joint.arrays import FloatArray
from skfem_joint.stepping.schemes import Scheme
from skfem_joint.system import System

#: Relative error of an amplitude by its time step that is doubtful.
DOUBTFUL = 0.05


def step_error_notes(
    name: str, curve: Curve, system: System, steps_per_cycle: int, scheme: Scheme
) -> Iterator[str]:
    """Sentences about where the time step makes a curve doubtful, by which cause, and the cure.

    They say so where the error is not estimated. Two causes are told apart. Time steps lower the
    natural frequency, which changes the amplitude most where damping is light. What that cannot
    explain is due to harmonics of friction, which meet higher modes.

    Parameters
    ----------
    name : str
        Of the model, for the sentences.
    curve : Curve
        With its estimated errors of the step.
    system : System
        Of the model.
    steps_per_cycle : int
    scheme : Scheme
    """
    if not follows_twice(system, steps_per_cycle):
        yield (
            f"The errors of the time step are not estimated along the curves of the {name} model: "
            f"twice the step does not follow the loads. Set time.steps_per_cycle = "
            f"{2 * steps_per_cycle}."
        )
        return
    error = curve.column("step_error")
    failed = np.array([point.failure is not None for point in curve.points])
    if not (np.isfinite(error) | failed).all():
        yield (
            f"The {name} model at level {curve.level:g} has no steady vibration with twice the "
            "step at every frequency: where step_error is empty in response.csv the error of the "
            "step is not known."
        )
    error = np.nan_to_num(error)
    shift = scheme.frequency_shift(2.0 * np.pi / steps_per_cycle)
    width = half_power_widths(curve, system)
    by_shift = error <= 2.0 * _error_by_shift(curve, shift, width)
    # Errors fall with the square of the step: so many steps leave one percent, in whole fifties.
    enough = 50 * np.ceil(steps_per_cycle * np.sqrt(error.max() / 0.01) / 50)
    for cause_is_shift in (True, False):
        doubtful = (error > DOUBTFUL) & (by_shift if cause_is_shift else ~by_shift)
        if not doubtful.any():
            continue
        frequency, largest = curve.column("frequency")[doubtful], float(error[doubtful].max())
        cause = "where harmonics of friction meet higher modes"
        if cause_is_shift:
            cause = (
                f"where damping is light: the steps lower the natural frequency by "
                f"{100 * shift:.2g} %, and the resonance is only "
                f"{100 * width[doubtful].min():.2g} % wide at half its power"
            )
        yield (
            f"The {name} model at level {curve.level:g}: the time step alone errs by up to "
            f"{100 * largest:.2g} % of the amplitude, and by more than {100 * DOUBTFUL:g} % at "
            f"{frequency.size} frequencies from {frequency[0]:.6g} to {frequency[-1]:.6g} Hz, "
            f"{cause}; see column step_error of response.csv. Set time.steps_per_cycle = "
            f"{enough:.0f}."
        )


def half_power_widths(curve: Curve, system: System) -> FloatArray:
    """Half-power width over frequency of a resonance at each point of a curve, (points,).

    It is the loss factor: energy lost in a period over 2 pi times the energy stored.
    """
    stored = [np.nan if p.state is None else system.stored_energy(*p.state) for p in curve.points]
    energy = 2.0 * np.pi * np.array(stored)
    lost = np.abs(curve.column("input_energy"))
    width = np.full(energy.shape, np.inf)
    np.divide(lost, energy, out=width, where=energy > 0.0)
    return width


def _error_by_shift(curve: Curve, shift: float, width: FloatArray) -> FloatArray:
    """Largest relative error of the amplitude where the natural frequency is off by ``shift``.

    For each relative change of the frequency the amplitude on the flank of a resonance changes by
    at most 1 / width of itself, and by at most 1 / distance, both over frequency.
    """
    f, (known, A) = curve.column("frequency"), curve.known
    peaks = known[np.flatnonzero(np.diff(np.sign(np.diff(np.pad(A, 1)))) < 0)]
    distance = np.abs(f[:, np.newaxis] / peaks - 1.0).min(axis=1, initial=np.inf)
    return np.asarray(shift / np.maximum(width, distance))
