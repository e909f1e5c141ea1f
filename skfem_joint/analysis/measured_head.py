"""What a measured curve is of: keys of the head of its file and arguments by the same names.

A comment line ``# key: value`` of a file states a key of `KEYS`; arguments win over it. Other
comments are remarks: they are not used, and a note names those that look like keys.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from skfem_joint.analysis.damping_curve import DERIVATIVES
from skfem_joint.analysis.measured_columns import COLUMNS, Samples, plain_unit, shown_units
from skfem_joint.arrays import FloatArray
from skfem_joint.errors import InputError, closest, first_of, refuse
from skfem_joint.values import COUNT, POSITIVE

#: Quantities that may be known up to a constant.
OFFSETS = ("frequency", "damping")


@dataclass(frozen=True)
class Head:
    """What a measured curve is of.

    Attributes
    ----------
    name : str, optional
    point : str
        Empty if not given.
    direction : ndarray, shape (1,), (2,) or (3,), optional
        Unit vector.
    quantity : str, optional
        Of `DERIVATIVES`.
    unit : str, optional
        Of the amplitude.
    peak_to_peak : bool
        Whether amplitudes are the whole of peak to peak rather than half.
    mode : int
        From 1.
    offset : tuple of str
        Of `OFFSETS`.
    lowest, highest : float, optional
        Range of amplitudes that is fitted, in the unit of the data.
    relative_frequency_deviation, relative_damping_deviation : float, optional
        Standard deviations as shares of the values.
    frequency : float, optional
        About that of the mode of a decay, Hz.
    """

    name: str | None = None
    point: str = ""
    direction: FloatArray | None = None
    quantity: str | None = None
    unit: str | None = None
    peak_to_peak: bool = False
    mode: int = 1
    offset: tuple[str, ...] = ()
    lowest: float | None = None
    highest: float | None = None
    relative_frequency_deviation: float | None = None
    relative_damping_deviation: float | None = None
    frequency: float | None = None


class _WrongError(ValueError):
    """What a value must be."""


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        raise _WrongError("a name")
    return value.strip()


def _direction(value: Any) -> FloatArray:
    axes = {"x": 0, "y": 1, "z": 2}
    if isinstance(value, str) and value.strip() in axes:
        return np.asarray(np.eye(3)[axes[value.strip()]])
    parts = re.split(r"[,\s]+", value.strip(" []()")) if isinstance(value, str) else value
    try:
        vector = np.asarray(parts, dtype=float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.ndim != 1 or not 1 <= vector.size <= 3 or not np.isfinite(vector).all():
        vector = np.zeros(0)
    length = float(np.abs(vector).max(initial=0.0))
    if length == 0.0:
        raise _WrongError(
            "x, y, z, or up to three finite numbers that are not all 0, as in 0, 1, 1"
        )
    vector = vector / length
    return np.asarray(vector / np.linalg.norm(vector))


def _quantity(value: Any) -> str:
    if value not in DERIVATIVES:
        raise _WrongError(f"one of {', '.join(DERIVATIVES)}")
    return str(value)


def _unit(value: Any) -> str:
    units = COLUMNS["amplitude"]
    plain = plain_unit(value) if isinstance(value, str) else ""
    if plain not in units:
        raise _WrongError(f"one of {shown_units(units)}")
    return plain


def _truth(value: Any) -> bool:
    words = {"true": True, "false": False}
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, str) and value.strip().casefold() in words:
        return words[value.strip().casefold()]
    raise _WrongError("true or false")


def _mode(value: Any) -> int:
    number = int(value) if isinstance(value, str) and re.fullmatch(r"\d{1,9}", value) else value
    if number not in COUNT:
        raise _WrongError(COUNT.words)
    return int(number)


def _offset(value: Any) -> tuple[str, ...]:
    names = re.split(r"[,\s]+", value.strip()) if isinstance(value, str) else value
    names = [] if names == ["none"] else names
    if not isinstance(names, list | tuple) or not all(name in OFFSETS for name in names):
        raise _WrongError(f"one or both of {', '.join(OFFSETS)}, or none")
    return tuple(name for name in OFFSETS if name in names)


def _number(value: Any) -> float:
    """Finite number of a text or a number; _WrongError for others."""
    try:
        number = float(value) if isinstance(value, str | Real) else np.nan
    except (ValueError, OverflowError):
        number = np.nan
    if isinstance(value, bool) or not np.isfinite(number):
        raise _WrongError("a finite number")
    return number


def _bound(value: Any) -> float:
    number = _number(value)
    if number < 0.0:
        raise _WrongError(">= 0 and finite")
    return number


def _share(value: Any) -> float:
    text = isinstance(value, str) and re.fullmatch(r"(.*?)\s*%", value.strip())
    try:
        number = _number(text[1]) / 100.0 if text else _number(value)
    except _WrongError:
        number = np.nan
    if not 0.0 < number <= 1.0:
        raise _WrongError("a share of the value above 0 and at most 1, or percent, as in 5 %")
    return number


def _frequency(value: Any) -> float:
    number = _number(value)
    if number not in POSITIVE:
        raise _WrongError(f"{POSITIVE.words}, in Hz")
    return number


#: Keys of the head and arguments, by what reads their text or value.
KEYS: Mapping[str, Callable[[Any], Any]] = {
    "name": _text,
    "point": _text,
    "direction": _direction,
    "quantity": _quantity,
    "unit": _unit,
    "peak_to_peak": _truth,
    "mode": _mode,
    "offset": _offset,
    "lowest": _bound,
    "highest": _bound,
    "relative_frequency_deviation": _share,
    "relative_damping_deviation": _share,
    "frequency": _frequency,
}


def head_of(samples: Samples, given: Mapping[str, Any]) -> tuple[Head, list[str]]:
    """Head of a curve from the comments of its file and from arguments, and notes.

    Raises
    ------
    InputError
        If keys or arguments are unknown or wrong; all of them at once.
    """
    problems: list[str] = []
    notes: list[str] = []
    values: dict[str, Any] = {}
    for place, key, text in _stated(samples, notes, problems):
        if key in values:
            problems.append(f"{place}: found {key!r} again, must be once")
        else:
            values |= _read(place, key, text, problems)
    arguments: dict[str, Any] = {}
    for key, value in given.items():
        if key not in KEYS:
            problems.append(
                f"measured_curve: found argument {key!r}, must be one of {', '.join(KEYS)}"
                f"{closest(key, KEYS)}"
            )
        elif value is not None:
            arguments |= _read("measured_curve", key, value, problems)
    refuse(problems)
    _check_deviations(samples, values)
    head = Head(**(values | arguments))
    if head.lowest is not None and head.highest is not None and head.lowest > head.highest:
        raise InputError(
            f"{samples.where}: found a range of amplitudes from {head.lowest:g} to "
            f"{head.highest:g}, must rise"
        )
    return head, notes


def _stated(
    samples: Samples, notes: list[str], problems: list[str]
) -> Iterator[tuple[str, str, str]]:
    """Places, keys and texts of the comments that state a key.

    A range ``fit: 0..10`` comes as ``lowest`` and ``highest``.
    """
    keys = [key for key in KEYS if key not in ("lowest", "highest")] + ["fit"]
    unused: list[str] = []
    for number, remark in samples.remarks:
        place = f"{samples.where}: line {number}"
        line = remark.lstrip("#").split("#", 1)[0]
        stated = re.fullmatch(r"\s*([A-Za-z_][A-Za-z_ -]*?)\s*:\s*(.*?)\s*", line)
        if stated is None:
            continue
        key, text = re.sub(r"[\s-]+", "_", stated[1]).casefold(), stated[2]
        if key not in keys:
            if near := closest(key, keys):
                problems.append(
                    f"{place}: found key {stated[1]!r}, must be one of {', '.join(keys)}{near} "
                    "(write a remark without a colon)"
                )
            else:
                unused.append(f"{stated[1]!r} (line {number})")
        elif key == "fit":
            low, dots, high = (part.strip() for part in text.partition(".."))
            if not dots or high.startswith(".") or not (low or high):
                problems.append(
                    f"{place}: fit: found {text!r}, must be a range of amplitudes in the unit of "
                    "the data, as in 0.5..10, or 0.5.. or ..10"
                )
            for name, bound in (("lowest", low), ("highest", high)) if dots else ():
                if bound:
                    yield place, name, bound
        else:
            yield place, key, text
    if unused:
        notes.append(f"{samples.where}: comments are not used: {first_of(unused)}.")


def _read(place: str, key: str, value: Any, problems: list[str]) -> dict[str, Any]:
    """The value of a key by its name; none, and a sentence, if it is wrong."""
    try:
        return {key: KEYS[key](value)}
    except _WrongError as error:
        found = repr(value)
        found = found if len(found) <= 60 else f"{found[:57]}..."
        problems.append(f"{place}: {key}: found {found}, must be {error}")
        return {}


def _check_deviations(samples: Samples, values: Mapping[str, Any]) -> None:
    """Refuse a head that states deviations as shares beside a column that has them."""
    refuse(
        f"{samples.where}: found both column '{name}_deviation' and key "
        f"'relative_{name}_deviation', must be one of them"
        for name in OFFSETS
        if f"{name}_deviation" in samples.columns and f"relative_{name}_deviation" in values
    )
