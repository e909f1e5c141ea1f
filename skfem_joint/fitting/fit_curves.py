"""Curves of a fitted structure over the measured range, finer than its samples, with bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.fitting.fit import QUANTITIES, Fit
from skfem_joint.fitting.measured import MeasuredCurve
from skfem_joint.ground.arrays import FloatArray

#: Amplitudes of a fine curve.
COUNT = 40


@dataclass(frozen=True)
class FineCurve:
    """Curve of a fitted structure beside a measured one, offsets added.

    Attributes
    ----------
    measured : MeasuredCurve
        What it is drawn beside.
    amplitude : ndarray, shape (k,)
        Of the measured quantity, half of peak to peak; m, m/s or m/s².
    frequency, damping : ndarray, shape (k,)
        Hz, and damping ratio.
    frequency_band, damping_band : ndarray, shape (k,)
        Half widths of their bands by the uncertainty of values and offsets.
    """

    measured: MeasuredCurve
    amplitude: FloatArray
    frequency: FloatArray
    damping: FloatArray
    frequency_band: FloatArray
    damping_band: FloatArray


def fine_curves(fit: Fit) -> list[FineCurve]:
    """Curves beside each measured one, in its range as far as the structure reaches.

    InputError and ConvergenceError as `FitModel.predict`.
    """
    problem, fine = fit.problem, []
    places = [_amplitudes(curve) for curve in problem.curves]
    found = problem.predict(fit.vector, [displacement for _, displacement in places])
    for k, (predicted, (amplitude, _)) in enumerate(zip(found, places, strict=True)):
        values = [problem.beside(k, name, predicted, fit.vector)[0] for name in QUANTITIES]
        columns = amplitude, *values, *fit.band(predicted, number=k)
        fine.append(FineCurve(problem.curves[k], *(x[predicted.inside] for x in columns)))
    return fine


def _amplitudes(curve: MeasuredCurve) -> tuple[FloatArray, FloatArray]:
    """Amplitudes in equal ratios over the range of a curve, and their displacements (m)."""
    known, place = np.unique(np.log(curve.amplitude), return_inverse=True)
    mean = np.bincount(place, np.log(curve.displacement)) / np.bincount(place)
    wanted = np.linspace(known[0], known[-1], COUNT if known.size > 1 else 1)
    return np.exp(wanted), np.exp(np.interp(wanted, known, mean))
