"""Frequency and damping of a mode over amplitude as they were measured: what a fit compares with.

They come from a table of text, from arrays, or from a free vibration over time. A file has comment
lines that say what it is of, the names of its columns with units
(:mod:`skfem_joint.fitting.measured_table`) and rows of numbers::

    # point: tip
    # direction: y
    # highest: 10
    amplitude (m/s2), frequency (Hz), damping (%)
    0.4,  402.1, 0.21
    1.3,  401.6, 0.26
    4.2,  399.8, 0.44

A free vibration becomes a curve by :func:`skfem_joint.damping_curve`. Of that only as many samples
are taken as its splines have coefficients of their own, its pieces and two more: samples between
them would repeat what these say. Neighbours among them are correlated by 0.6 at most, in decays of
a joint with noise of 2 %.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.fitting.damping_curve import DERIVATIVES, DampingCurve, damping_curve
from skfem_joint.fitting.measured_table import (
    AMPLITUDES,
    COLUMNS,
    QUANTITIES,
    Head,
    Samples,
    check_samples,
    doubtful_damping,
    given_samples,
    head_of,
    read_samples,
)
from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError, closest, first_of
from skfem_joint.ground.plain_values import Tabular

#: Standard deviations over the values where nothing is said. Frequencies repeat to about this from
#: test to test with the same bolts; of dampings, even careful tests repeat to some percent.
_ASSUMED = {"frequency": 1e-4, "damping": 0.05}


@dataclass(frozen=True)
class MeasuredCurve(Tabular):
    """Frequency and damping of a mode over the amplitude of a point, as measured.

    Attributes
    ----------
    name : str
        Of the file, or given.
    point : str
        Named point of the system that moves so, such as "tip" or its row "tip.y"; empty if not
        given, see `weights`.
    direction : ndarray, shape (1,), (2,) or (3,), optional
        Unit vector along which the point was measured.
    mode : int
        Number of the mode with the joints stuck, from 1.
    quantity : {"displacement", "velocity", "acceleration"}
        What the amplitude is of.
    amplitude : ndarray, shape (k,)
        Half of peak to peak, rising; m, m/s or m/s².
    frequency : ndarray, shape (k,)
        Hz; nan where it was not measured.
    damping : ndarray, shape (k,)
        Damping ratio; nan where it was not measured.
    frequency_deviation : ndarray, shape (k,)
        Standard deviation of the frequency, Hz; nan where that is.
    damping_deviation : ndarray, shape (k,)
        The same of the damping ratio.
    offset : tuple of str
        Of "frequency" and "damping" those that are known up to a constant.
    fitted : ndarray of bool, shape (k,)
        Samples that count in a fit; the others are compared only.
    notes : tuple of str
        What was assumed and what was not used.
    """

    name: str
    point: str
    direction: FloatArray | None
    mode: int
    quantity: str
    amplitude: FloatArray
    frequency: FloatArray
    damping: FloatArray
    frequency_deviation: FloatArray
    damping_deviation: FloatArray
    offset: tuple[str, ...]
    fitted: BoolArray
    notes: tuple[str, ...]

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each amplitude, which is in the unit of its quantity."""
        return {
            "amplitude": self.amplitude,
            "frequency_Hz": self.frequency,
            "damping_ratio": self.damping,
            "frequency_deviation_Hz": self.frequency_deviation,
            "damping_deviation": self.damping_deviation,
            "fitted": self.fitted,
        }

    @property
    def displacement(self) -> FloatArray:
        """Displacement amplitude of the point, (k,), m; half of peak to peak.

        That of a velocity is over ``2 pi f``, of an acceleration over its square. Where no
        frequency f was measured, it is linear between its neighbours over the amplitude's
        logarithm.
        """
        order = DERIVATIVES[self.quantity]
        if order == 0:
            return self.amplitude.copy()
        known = ~np.isnan(self.frequency)
        at, place = np.unique(self.amplitude[known], return_inverse=True)
        means = np.bincount(place, self.frequency[known]) / np.bincount(place)
        between = np.interp(np.log(self.amplitude), np.log(at), means)
        frequency = np.where(known, self.frequency, between)
        return np.asarray(self.amplitude / (2.0 * np.pi * frequency) ** order)

    def weights(self, points: Sequence[str]) -> FloatArray:
        """Weights that make the measured displacement of those of the named points of a system.

        Parameters
        ----------
        points : sequence of str
            Rows of the system, ``System.points``: "tip" of a bar, "tip.x", "tip.y" and so on.

        Returns
        -------
        ndarray, shape (len(points),)

        Raises
        ------
        InputError
            If the system has no such point, or several and none is given, or the direction does
            not fit.
        """
        names, shown = [*points], first_of([*points], 20)
        point = self.point or (names[0] if len(names) == 1 else "")
        vector = np.ones(1) if self.direction is None else self.direction
        rows = [row for c in "xyz" if (row := f"{point}.{c}") in names]
        if point in names and (self.direction is None or not rows):  # a load may have its name
            rows = [point]
        problem = ""
        if not point:
            problem = f"not given, must be one of {shown}"
        elif not rows:
            problem = f"found {point!r}, must be one of {shown}{closest(point, names)}"
        elif self.direction is None and rows != [point]:
            problem = (
                f"found {point!r} without a direction; give direction, such as x, or one of "
                f"{', '.join(rows)} as the point"
            )
        elif np.any(vector[len(rows) :]):
            problem = (
                f"found {point!r} and direction {vector.tolist()}, must be of as many components "
                f"as the system has there, {', '.join(rows)}"
            )
        if problem:
            raise InputError(f"{self.name}: point: {problem}")
        weights = np.zeros(len(names))
        for row, share in zip(rows, vector, strict=False):
            weights[names.index(row)] = share
        return weights


def measured_curve(
    source: str | os.PathLike[str] | Mapping[str, Any] | DampingCurve, **given: Any
) -> MeasuredCurve:
    """Frequency and damping over amplitude as measured, from a file or from arrays.

    Parameters
    ----------
    source : path, mapping or DampingCurve
        A text file (CSV, UTF-8), a mapping from names of columns to arrays of shape (k,), or a
        curve of :func:`damping_curve`. Columns are ``amplitude`` with ``frequency``, ``damping``
        (a ratio) or both, and maybe their standard deviations ``frequency_deviation`` and
        ``damping_deviation``, in the same units; or ``time`` and ``signal`` of a free vibration at
        even steps. Units stand behind the names, as in "amplitude (mm)" or "damping (%)". Other
        columns and other lines ``# key: value`` are refused.
    **given
        What the curve is of; each wins over the line ``# key: value`` of the file.

        - ``point`` (str) and ``direction`` ("x", "y", "z" or a vector): what was measured.
        - ``unit`` (str) of the amplitude, which is needed if its column has none.
        - ``peak_to_peak`` (bool): amplitudes are the whole of peak to peak, not half. False.
        - ``mode`` (int): number of the mode, 1.
        - ``offset`` (sequence of str): "frequency", "damping", where known up to a constant.
        - ``lowest``, ``highest`` (float): amplitudes that a fit takes, in the unit of the data as
          they stand there.
        - ``relative_frequency_deviation``, ``relative_damping_deviation`` (float): standard
          deviations as shares of the values, in place of those of columns; 1e-4 and 0.05 where
          nothing says how sure the values are.
        - ``frequency`` (float): about that of the mode of a free vibration, Hz.
        - ``name`` (str): of the curve, that of the file if not given.

    Returns
    -------
    MeasuredCurve
        Its ``notes`` say what was assumed.

    Raises
    ------
    InputError
        If the source cannot be read, or columns, values or arguments are wrong or missing.
    ConvergenceError
        If no curve is found of a free vibration.
    """
    if isinstance(source, str | os.PathLike):
        samples = read_samples(Path(source))
    elif isinstance(source, Mapping | DampingCurve):
        arrays = _arrays(source) if isinstance(source, DampingCurve) else source
        samples = given_samples(arrays, "data")
    else:
        raise InputError(
            f"measured_curve: found a {type(source).__name__} as the source, must be the path of a "
            "file, a mapping from names of columns to arrays, or a DampingCurve"
        )
    head = head_of(samples, given)
    check_samples(samples)
    quantity, unit = _unit_of_amplitude(samples, head)
    notes = [*samples.doubts, *doubtful_damping(samples)]
    if "signal" in samples.columns:
        samples, said = _of_decay(samples, head, quantity)
        notes += said
    elif head.frequency is not None:
        raise InputError(
            f"{samples.where}: found key 'frequency', which is about that of a signal over time; "
            "leave it out: frequencies of a curve stand in a column"
        )
    return _curve(samples, head, quantity, unit, notes)


def _arrays(curve: DampingCurve) -> dict[str, FloatArray]:
    """Columns of a damping curve; a damping that noise has made negative was not measured."""
    known = curve.damping_ratio > 0.0
    return {
        "amplitude": curve.amplitude,
        "frequency": curve.frequency,
        "damping": np.where(known, curve.damping_ratio, np.nan),
        "frequency_deviation": curve.frequency_error,
        "damping_deviation": np.where(known, curve.damping_error, np.nan),
    }


def _unit_of_amplitude(samples: Samples, head: Head) -> tuple[str, str]:
    """Quantity and unit of the amplitude; InputError if that is not one unit."""
    column, where = "signal" if "signal" in samples.columns else "amplitude", samples.where
    stated = {head.unit, samples.units[column]} - {None}
    if len(stated) != 1:
        found = " and ".join(sorted(map(str, stated))) or "no unit"
        raise InputError(
            f"{where}: found {found} of the {column}, must be one unit, in the name of the column, "
            f"as in '{column} (m/s2)', or stated by unit: one of {', '.join(COLUMNS[column])}"
        )
    unit = str(stated.pop())
    quantity = next(name for name, units in AMPLITUDES.items() if unit in units)
    lacks = bool(np.isnan(samples.in_si("frequency")).all())
    if quantity != "displacement" and column == "amplitude" and lacks:
        raise InputError(
            f"{where}: found amplitudes of {quantity} and no frequency, by which they become "
            "displacements; add a column 'frequency (Hz)', or give amplitudes of displacement"
        )
    return quantity, unit


def _of_decay(samples: Samples, head: Head, quantity: str) -> tuple[Samples, list[str]]:
    """Curve of a free vibration, with amplitudes in the unit of its signal; and notes.

    InputError and ConvergenceError as `damping_curve`, with the name of the file.
    """
    where = samples.where
    if head.peak_to_peak:
        raise InputError(
            f"{where}: found peak_to_peak beside a signal over time, whose amplitudes are half of "
            "peak to peak; leave it out"
        )
    time, signal = samples.in_si("time"), samples.columns["signal"]
    try:
        curve = damping_curve(time, signal, head.frequency, quantity)
    except InputError as error:
        raise InputError([f"{where}: {problem}" for problem in error.problems]) from error
    except ConvergenceError as error:
        raise ConvergenceError(f"{where}: {error}") from error
    found = given_samples(_arrays(curve), where)
    notes = [f"the free vibration gives {curve.amplitude.size} samples of the curve."]
    if lost := int(np.isnan(found.columns["damping"]).sum()):
        notes.append(f"noise hides the damping of {lost} of them.")
    return found, notes


def _curve(
    samples: Samples, head: Head, quantity: str, unit: str, notes: list[str]
) -> MeasuredCurve:
    """Curve of samples over rising amplitude, with notes of what is assumed."""
    raw = samples.columns["amplitude"]
    fitted = (raw >= head.lowest) & (raw <= head.highest)
    if not fitted.any():
        raise InputError(
            f"{samples.where}: found no amplitude in the range that is fitted; amplitudes are "
            f"{raw.min():g} to {raw.max():g} in their unit"
        )
    rise, arrays = np.argsort(raw, kind="stable"), {}
    for name in QUANTITIES:
        arrays[name] = samples.in_si(name)[rise]
        share = getattr(head, f"relative_{name}_deviation")
        deviation, said = _deviation(samples, name, share)
        arrays[f"{name}_deviation"] = deviation[rise]
        notes = notes + said
    lacking = int(np.isnan(arrays["frequency"]).sum())
    if quantity != "displacement" and lacking:
        notes.append(
            f"{lacking} samples have no frequency; their displacement is found by that between "
            "their neighbours."
        )
    return MeasuredCurve(
        name=head.name or Path(samples.where).name,
        point=head.point,
        direction=None if head.direction is None else np.array(head.direction),
        mode=head.mode,
        quantity=quantity,
        amplitude=raw[rise] * AMPLITUDES[quantity][unit] * (0.5 if head.peak_to_peak else 1.0),
        offset=head.offset,
        fitted=fitted[rise],
        notes=tuple(f"{samples.where}: {sentence}" for sentence in notes),
        **arrays,
    )


def _deviation(samples: Samples, name: str, share: float | None) -> tuple[FloatArray, list[str]]:
    """Standard deviations of a column (k,) in SI units, nan where its values are; and notes.

    ``share`` is that of the values that was stated, and takes the place of a column of deviations;
    where nothing is stated, one is assumed.
    """
    value, notes = samples.in_si(name), []
    deviation = samples.in_si(f"{name}_deviation") if share is None else np.full(value.size, np.nan)
    missing = ~np.isnan(value) & np.isnan(deviation)
    if share is None and missing.any():
        share = _ASSUMED[name]
        notes = [
            f"standard deviations of the {name} of {missing.sum()} samples are not given; "
            f"{100.0 * share:g} % of each value is assumed. State relative_{name}_deviation if "
            "they are known."
        ]
    for k in np.flatnonzero(missing & (value == 0.0)):
        raise InputError(
            f"{samples.place(k)}: {name}: found 0, whose standard deviation cannot be a share of "
            f"it; give a column '{name}_deviation', or leave the value empty"
        )
    deviation = np.where(missing, value * (share or 1.0), deviation)
    return np.where(np.isnan(value), np.nan, deviation), notes
