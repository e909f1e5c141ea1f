"""Frequency and damping of a mode over amplitude as they were measured: what a fit compares with.

They come from a table of text, from arrays, or from a free vibration over time. A file has comment
lines that say what it is of (:mod:`skfem_joint.analysis.measured_head`), the names of its columns
with units (:mod:`skfem_joint.analysis.measured_columns`) and rows of numbers::

    # point: tip
    # direction: y
    # fit: 0.5..10
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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.analysis.damping_curve import DERIVATIVES, DampingCurve, damping_curve
from skfem_joint.analysis.measured_columns import (
    AMPLITUDES,
    COLUMNS,
    Samples,
    check_samples,
    given_samples,
    read_samples,
    shown_units,
)
from skfem_joint.analysis.measured_head import OFFSETS, Head, head_of
from skfem_joint.arrays import BoolArray, FloatArray
from skfem_joint.errors import ConvergenceError, InputError, closest, first_of


@dataclass(frozen=True)
class MeasuredSettings:
    """What is assumed of measurements that do not say how sure they are.

    Attributes
    ----------
    frequency_deviation, damping_deviation : float
        Standard deviation over the value. Frequencies repeat to about this from test to test with
        the same bolts; of dampings, even careful tests repeat to some percent.
    doubtful_damping : float
        Damping ratio from which on a note asks whether it is meant in percent.
    """

    frequency_deviation: float = 1e-4
    damping_deviation: float = 0.05
    doubtful_damping: float = 0.2


SETTINGS = MeasuredSettings()


@dataclass(frozen=True)
class MeasuredCurve:
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
        names, where = [*points], f"{self.name}: point"
        weights = np.zeros(len(names))
        point = self.point or (names[0] if len(names) == 1 else "")
        shown = first_of(names, 20)
        if not point:
            raise InputError(f"{where}: not given, must be one of {shown}")
        rows = [names.index(row) for c in "xyz" if (row := f"{point}.{c}") in names]
        if point in names and (self.direction is None or not rows):  # a load may have its name
            along = np.zeros(0) if self.direction is None else self.direction[1:]
            if np.any(along):
                raise InputError(
                    f"{where}: found {point!r} and a direction, must be one row alone; leave the "
                    "direction out"
                )
            weights[names.index(point)] = 1.0
            return weights
        if not rows:
            raise InputError(
                f"{where}: found {point!r}, must be one of {shown}{closest(point, names)}"
            )
        if self.direction is None:
            raise InputError(
                f"{where}: found {point!r} without a direction; give direction, such as x, or one "
                f"of {', '.join(names[row] for row in rows)} as the point"
            )
        vector = np.pad(self.direction, (0, 3 - self.direction.size))
        if np.any(vector[len(rows) :]):
            raise InputError(
                f"{where}: found direction {self.direction.tolist()}, must be of {len(rows)} "
                "components, as the structure has"
            )
        weights[rows] = vector[: len(rows)]
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
        even steps. Units stand behind the names, as in "amplitude (mm)" or "damping (%)".
    **given
        What the curve is of; each wins over the line ``# key: value`` of the file.

        - ``point`` (str) and ``direction`` ("x", "y", "z" or a vector): what was measured.
        - ``quantity`` ("displacement", "velocity", "acceleration") or ``unit`` (str) of the
          amplitude; one of them, or a unit in its column, is needed.
        - ``peak_to_peak`` (bool): amplitudes are the whole of peak to peak, not half. False.
        - ``mode`` (int): number of the mode, 1.
        - ``offset`` (sequence of str): "frequency", "damping", where known up to a constant.
        - ``lowest``, ``highest`` (float): amplitudes that a fit takes, in the unit of the data as
          they stand there; a file states them by ``# fit: 0.5..10``.
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
    samples = _samples(source)
    head, notes = head_of(samples, given)
    check_samples(samples)
    quantity, unit, assumed = _unit_of_amplitude(samples, head)
    if "signal" in samples.columns:
        samples = _of_decay(samples, head, quantity)
    elif head.frequency is not None:
        raise InputError(
            f"{samples.where}: found key 'frequency', which is about that of a signal over time; "
            "leave it out: frequencies of a curve stand in a column"
        )
    order = np.argsort(samples.columns["amplitude"], kind="stable")
    curve = _curve(samples.taken(order), head, quantity, unit)
    return replace(curve, notes=(*samples.notes, *notes, *assumed, *curve.notes))


def _samples(source: Any) -> Samples:
    """Samples of a file, of arrays or of a damping curve, not checked."""
    if isinstance(source, DampingCurve):
        return given_samples(_arrays(source), "data")
    if isinstance(source, Mapping):
        return given_samples(source, "data")
    if isinstance(source, str | os.PathLike):
        return read_samples(Path(source))
    raise InputError(
        f"measured_curve: found a {type(source).__name__} as the source, must be the path of a "
        "file, a mapping from names of columns to arrays, or a DampingCurve"
    )


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


def _unit_of_amplitude(samples: Samples, head: Head) -> tuple[str, str, list[str]]:
    """Quantity and unit of the amplitude, and a note if the unit is assumed.

    InputError if neither is stated, or if they do not fit.
    """
    column = "signal" if "signal" in samples.columns else "amplitude"
    of_column = samples.units[column]
    if head.unit is not None and of_column is not None and head.unit != of_column:
        raise InputError(
            f"{samples.where}: found unit {head.unit!r} beside {of_column!r} in the name of the "
            f"column {column!r}, must be the same"
        )
    unit, quantity = head.unit or of_column, head.quantity
    assumed = []
    if unit is None:
        if quantity is None:
            raise InputError(
                f"{samples.where}: found no unit of the {column}, must be in the name of its "
                f"column, as in '{column} (m/s2)', or be stated by unit: one of "
                f"{shown_units(COLUMNS[column])}; or state quantity, one of "
                f"{', '.join(DERIVATIVES)}, for values in SI units"
            )
        unit = next(iter(AMPLITUDES[quantity]))
        assumed = [f"{samples.where}: the {column} has no unit; it is read in {unit}."]
    own = next(name for name, units in AMPLITUDES.items() if unit in units)
    if quantity not in (None, own):
        raise InputError(
            f"{samples.where}: found quantity {quantity!r} in {unit!r}, which is a unit of "
            f"{own}; must be one of {shown_units(AMPLITUDES[str(quantity)])}"
        )
    lacks = "frequency" not in samples.columns or np.isnan(samples.columns["frequency"]).all()
    if own != "displacement" and column == "amplitude" and lacks:
        raise InputError(
            f"{samples.where}: found amplitudes of {own} and no frequency, by which they become "
            "displacements; add a column 'frequency (Hz)', or give amplitudes of displacement"
        )
    return own, unit, assumed


def _of_decay(samples: Samples, head: Head, quantity: str) -> Samples:
    """Curve of a free vibration, with amplitudes in the unit of its signal.

    InputError and ConvergenceError as `damping_curve`, with the name of the file.
    """
    where = samples.where
    if head.peak_to_peak:
        raise InputError(
            f"{where}: found peak_to_peak beside a signal over time, whose amplitudes are half of "
            "peak to peak; leave it out"
        )
    time = samples.columns["time"] * COLUMNS["time"][samples.units["time"] or "s"]
    try:
        curve = damping_curve(time, samples.columns["signal"], head.frequency, quantity)
    except InputError as error:
        raise InputError([f"{where}: {problem}" for problem in error.problems]) from error
    except ConvergenceError as error:
        raise ConvergenceError(f"{where}: {error}") from error
    found = given_samples(_arrays(curve), where)
    note = f"{where}: the free vibration gives {curve.amplitude.size} samples of the curve."
    notes = [*samples.notes, note]
    if lost := int(np.isnan(found.columns["damping"]).sum()):
        notes.append(f"{where}: noise hides the damping of {lost} of them.")
    return found._replace(notes=notes)


def _curve(samples: Samples, head: Head, quantity: str, unit: str) -> MeasuredCurve:
    """Curve of samples over rising amplitude, with notes of what is assumed or doubtful."""
    name = head.name or Path(samples.where).name
    raw = samples.columns["amplitude"]
    fitted = raw >= (head.lowest or 0.0)
    if head.highest is not None:
        fitted &= raw <= head.highest
    if not fitted.any():
        raise InputError(
            f"{samples.where}: found no amplitude in the range that is fitted; amplitudes are "
            f"{raw[0]:g} to {raw[-1]:g} in their unit"
        )
    values = {own: _in_si(samples, own) for own in OFFSETS}
    deviations, notes = {}, []
    for own, value in values.items():
        share = getattr(head, f"relative_{own}_deviation")
        deviations[own], said = _deviation(samples, own, value, share)
        notes += said
    notes += _doubts(samples, quantity, values["frequency"], values["damping"])
    return MeasuredCurve(
        name=name,
        point=head.point,
        direction=head.direction,
        mode=head.mode,
        quantity=quantity,
        amplitude=raw * AMPLITUDES[quantity][unit] * (0.5 if head.peak_to_peak else 1.0),
        frequency=values["frequency"],
        damping=values["damping"],
        frequency_deviation=deviations["frequency"],
        damping_deviation=deviations["damping"],
        offset=head.offset,
        fitted=fitted,
        notes=tuple(f"{samples.where}: {sentence}" for sentence in notes),
    )


def _in_si(samples: Samples, column: str) -> FloatArray:
    """Values of a column in SI units, (k,); nan if there is no such column."""
    if column not in samples.columns:
        return np.full(samples.numbers.size, np.nan)
    return samples.columns[column] * _factor(samples, column)


def _factor(samples: Samples, column: str) -> float:
    units = COLUMNS[column]
    return units[samples.units[column] or next(iter(units))]


def _deviation(
    samples: Samples, column: str, value: FloatArray, share: float | None
) -> tuple[FloatArray, list[str]]:
    """Standard deviations of a column's values (k,) in SI units, nan where these are; and notes.

    ``share`` is that of the values that was stated; where nothing is stated, one is assumed.
    """
    own, notes = f"{column}_deviation", []
    stated = samples.units.get(own)
    if stated is not None and _factor(samples, own) != _factor(samples, column):
        raise InputError(
            f"{samples.where}: column {own!r}: found unit {stated!r}, must be that of {column}, "
            f"{samples.units[column] or next(iter(COLUMNS[column]))!r}; a share of the values is "
            f"stated by relative_{column}_deviation"
        )
    if own in samples.columns and share is None:
        deviation = samples.columns[own] * _factor(samples, column)
    else:
        deviation = np.full(value.size, np.nan)
    if own in samples.columns and share is not None:
        notes = [f"relative_{column}_deviation takes the place of column {own!r}."]
    missing = ~np.isnan(value) & np.isnan(deviation)
    if share is None and missing.any():
        share = float(getattr(SETTINGS, own))
        of = "" if missing.sum() == (~np.isnan(value)).sum() else f" of {missing.sum()} samples"
        notes = [
            f"standard deviations of the {column}{of} are not given; {100.0 * share:g} % of each "
            f"value is assumed. State relative_{column}_deviation if they are known."
        ]
    deviation = np.where(missing, value * (share or 1.0), deviation)
    if np.any(deviation == 0.0):
        k = int(np.argmin(np.where(np.isnan(deviation), np.inf, deviation)))
        raise InputError(
            f"{samples.place(k)}: {column}: found 0, whose standard deviation cannot be a share of "
            f"it; give a column {own!r}, or leave the value empty"
        )
    return np.where(np.isnan(value), np.nan, deviation), notes


def _doubts(
    samples: Samples, quantity: str, frequency: FloatArray, damping: FloatArray
) -> list[str]:
    """Sentences about what is allowed and may not be meant."""
    notes = []
    lacking = int(np.isnan(frequency).sum())
    if quantity != "displacement" and lacking:
        notes.append(
            f"{lacking} samples have no frequency; their displacement is found by that between "
            "their neighbours."
        )
    repeats = samples.numbers.size - np.unique(samples.columns["amplitude"]).size
    if repeats:
        notes.append(f"{repeats} amplitudes are repeated; each sample counts by itself.")
    largest = np.nanmax(damping) if not np.isnan(damping).all() else 0.0
    if samples.units.get("damping") is None and largest > SETTINGS.doubtful_damping:
        notes.append(
            f"damping up to {largest:g} is read as a ratio, {100.0 * largest:.3g} % of critical "
            "damping; if it is in percent, name the column 'damping (%)'."
        )
    return notes
