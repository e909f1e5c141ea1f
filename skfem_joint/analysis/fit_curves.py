"""Curves of a fitted structure over the measured range, finer than its samples, with bands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skfem_joint.analysis.fit import Fit
from skfem_joint.analysis.fit_model import PredictedCurve
from skfem_joint.analysis.measured import MeasuredCurve
from skfem_joint.arrays import FloatArray

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


def fine_curves(fit: Fit, count: int = COUNT) -> list[FineCurve]:
    """Curves beside each measured one, in its range as far as the structure reaches.

    InputError and ConvergenceError as `FitModel.predict`.
    """
    places = [_amplitudes(curve, count) for curve in fit.problem.curves]
    at = [
        _at(curve, displacement)
        for curve, (_, displacement) in zip(fit.problem.curves, places, strict=True)
    ]
    found = fit.problem.model.predict([*fit.values.values()], at)
    return [
        _fine(fit, k, amplitude, predicted)
        for k, ((amplitude, _), predicted) in enumerate(zip(places, found, strict=True))
    ]


def shifts(fit: Fit, k: int) -> dict[str, float]:
    """What is added to frequency and damping of the model beside measured curve ``k``."""
    name = fit.problem.curves[k].name
    return {
        quantity: fit.offsets.get(f"offset of {name}: {quantity}", 0.0)
        for quantity in ("frequency", "damping")
    }


def _amplitudes(curve: MeasuredCurve, count: int) -> tuple[FloatArray, FloatArray]:
    """Amplitudes in equal ratios over the range of a curve, and their displacements (m)."""
    known, place = np.unique(np.log(curve.amplitude), return_inverse=True)
    mean = np.bincount(place, np.log(curve.displacement)) / np.bincount(place)
    wanted = np.linspace(known[0], known[-1], count if known.size > 1 else 1)
    return np.exp(wanted), np.exp(np.interp(wanted, known, mean))


def _at(curve: MeasuredCurve, displacement: FloatArray) -> MeasuredCurve:
    """The same point and mode at other displacements, at which nothing was measured."""
    nothing = np.full(displacement.size, np.nan)
    return replace(
        curve,
        quantity="displacement",
        amplitude=displacement,
        frequency=nothing,
        damping=nothing,
        frequency_deviation=nothing,
        damping_deviation=nothing,
        fitted=np.ones(displacement.size, dtype=bool),
    )


def _fine(fit: Fit, k: int, amplitude: FloatArray, predicted: PredictedCurve) -> FineCurve:
    inside, added, bands = predicted.inside, shifts(fit, k), fit.band(predicted, number=k)
    return FineCurve(
        measured=fit.problem.curves[k],
        amplitude=amplitude[inside],
        frequency=(predicted.frequency + added["frequency"])[inside],
        damping=(predicted.damping + added["damping"])[inside],
        frequency_band=bands[0][inside],
        damping_band=bands[1][inside],
    )
