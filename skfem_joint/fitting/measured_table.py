"""Tables of measured curves and signals: columns with units, and comments that say what it is of.

A column is one of `COLUMNS`, alone or with a unit: ``amplitude``, ``amplitude (mm)`` or
``amplitude [mm]``. A comment ``# key: value`` states a key of `Head`, which are arguments of
:func:`skfem_joint.measured_curve` too; other comments are remarks. Columns and keys of other names
are refused.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, ValidationError

from skfem_joint.ground.arrays import FloatArray, IntArray, as_real, wrong_shapes
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.text_tables import (
    LENGTHS,
    Mistakes,
    column_units,
    number_in,
    plain_unit,
    read_columns,
)
from skfem_joint.scene.messages import mistake, sentences
from skfem_joint.scene.values import Count, Positive, SceneTable, has_no_repeats, key

#: Units of the amplitude of each quantity and what they are in SI.
AMPLITUDES: Mapping[str, Mapping[str, float]] = {
    "displacement": LENGTHS,
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "um/s": 1e-6},
    "acceleration": {"m/s2": 1.0, "mm/s2": 1e-3, "g": 9.80665},
}
_ANY_AMPLITUDE = {unit: value for units in AMPLITUDES.values() for unit, value in units.items()}
_FREQUENCY = {"Hz": 1.0, "kHz": 1e3, "rad/s": 0.5 / np.pi}
_DAMPING = {"1": 1.0, "%": 1e-2}
#: Units of each column; the first one is that of a column without a unit, except of amplitudes,
#: whose unit must be stated.
COLUMNS: Mapping[str, Mapping[str, float]] = {
    "amplitude": _ANY_AMPLITUDE,
    "frequency": _FREQUENCY,
    "damping": _DAMPING,
    "frequency_deviation": _FREQUENCY,
    "damping_deviation": _DAMPING,
    "time": {"s": 1.0, "ms": 1e-3},
    "signal": _ANY_AMPLITUDE,
}
#: Quantities of which empty cells and nan stand for what was not measured.
QUANTITIES = ("frequency", "damping")
_MAY_LACK = (*QUANTITIES, "frequency_deviation", "damping_deviation")
#: Sizes of values: squares of what is in between stay within the range of floats.
_SMALLEST, _LARGEST = 1e-20, 1e20
_EXAMPLE = "'amplitude (mm), frequency (Hz), damping (%)', or 'time (s), signal (m/s2)' of a decay"


class Samples(NamedTuple):
    """Columns of numbers as they were given, with their places for messages.

    Attributes
    ----------
    where : str
        File, or what arrays are called in messages.
    columns : dict of str to ndarray, shape (k,)
        In the units of ``units``; nan where nothing was measured.
    units : dict of str to str or None
        Of `COLUMNS`; None where none is stated.
    kind : str
        ``"line"`` of a file or ``"sample"`` of arrays.
    numbers : ndarray of int, shape (k,)
        Of lines or samples.
    stated : list of (str, str, str)
        Places, keys and texts of the comments that state a key.
    doubts : list of str
        Sentences about what is probably meant otherwise.
    """

    where: str
    columns: dict[str, FloatArray]
    units: dict[str, str | None]
    kind: str
    numbers: IntArray
    stated: list[tuple[str, str, str]]
    doubts: list[str]

    def place(self, k: np.intp) -> str:
        """Place of a row for messages."""
        return f"{self.where}: {self.kind} {self.numbers[k]}"

    def in_si(self, name: str) -> FloatArray:
        """Values of a column in SI units, (k,); nan if there is no such column."""
        factor = COLUMNS[name][self.units.get(name) or next(iter(COLUMNS[name]))]
        return np.asarray(factor * self.columns.get(name, np.full(self.numbers.size, np.nan)))


def read_samples(path: Path) -> Samples:
    """Samples from a text file with named columns (UTF-8).

    Raises
    ------
    InputError
        If it cannot be read, has other columns or keys, or cells are no numbers. The message names
        the file and the lines.
    """
    columns, units, lines, content = read_columns(path, _units_of, _MAY_LACK, _EXAMPLE)
    return Samples(str(path), columns, units, "line", lines, *_comments(path, content))


def given_samples(arrays: Mapping[str, Any], where: str) -> Samples:
    """Samples from arrays by the names of columns, which may have units as in files.

    Raises
    ------
    InputError
        If names are wrong or lack, or arrays are not real and of one shape (k,).
    """
    units = _units_of([str(name) for name in arrays], where)
    pairs = zip(units, arrays.values(), strict=True)
    columns = {name: as_real(given, f"{where}: {name}") for name, given in pairs}
    count = next(iter(columns.values())).size
    wrong = wrong_shapes({name: (own, (count,)) for name, own in columns.items()})
    refuse(f"{where}: {problem}; arrays must be of one shape (k,)" for problem in wrong)
    return Samples(where, columns, units, "sample", np.arange(count), [], [])


def _units_of(texts: Sequence[str], where: str) -> dict[str, str | None]:
    """Units of columns by their names; InputError for others than those of a curve or a signal."""
    units = column_units(texts, COLUMNS, where)
    for name in QUANTITIES:
        own, of = units.get(f"{name}_deviation"), units.get(name) or next(iter(COLUMNS[name]))
        if f"{name}_deviation" in units and name not in units:
            raise InputError(f"{where}: found column '{name}_deviation' and no {name!r}")
        if own not in (None, of):
            raise InputError(
                f"{where}: column '{name}_deviation': found unit {own!r}, must be that of {name}, "
                f"{of!r}; a share of the values is stated by relative_{name}_deviation"
            )
        if f"{name}_deviation" in units:
            units[f"{name}_deviation"] = of
    curve = "amplitude" in units and units.keys() & {*QUANTITIES}
    if units.keys() & {"time", "signal"} if curve else units.keys() != {"time", "signal"}:
        raise InputError(
            f"{where}: found columns {', '.join(units)}; must be amplitude with frequency, damping "
            f"or both, or time and signal, as in {_EXAMPLE}"
        )
    return units


def doubtful_damping(samples: Samples) -> Iterator[str]:
    """Sentence about dampings without a unit that are percent, by their size."""
    largest = np.nanmax(samples.columns.get("damping", np.zeros(1)), initial=0.0)
    # Joints in full slip reach some 10 %.
    if samples.units.get("damping", "1") is None and largest > 0.2:
        yield (
            f"the damping is up to {largest:g}, a ratio, in a column without a unit: is it in "
            "percent? Name it 'damping (%)', or 'damping (1)'."
        )


def check_samples(samples: Samples) -> None:
    """Refuse values that nothing measured can have: all mistakes at once, by their lines.

    Raises
    ------
    InputError
        If amplitudes or frequencies are not positive, dampings negative or not below 1, deviations
        not positive, values not finite, or a row has neither frequency nor damping.
    """
    mistakes = Mistakes(samples.where)
    for name, values in samples.columns.items():
        low, high = _SMALLEST, _LARGEST
        must = f"must be > 0, from {low:g} to {high:g}"
        if name in ("time", "signal"):
            low, must = -_LARGEST, f"must be finite, at most {_LARGEST:g} in size"
        elif name == "damping":
            below = 100.0 if samples.units[name] == "%" else 1.0
            low, high = 0.0, float(np.nextafter(below, 0.0))
            must = f"must be >= 0 and below {below:g}, a {'%' if below > 1.0 else 'ratio'}"
        lacks = np.isnan(values) & (name in _MAY_LACK)
        must += ", or empty where it was not measured" if name in _MAY_LACK else ""
        for k in np.flatnonzero(~lacks & ~((values >= low) & (values <= high))):
            mistakes.append(f"{samples.place(k)}: {name}: found {values[k]:g}, {must}")
    either = [samples.columns[name] for name in QUANTITIES if name in samples.columns]
    for k in np.flatnonzero(np.isnan(either).all(axis=0)) if either else ():
        mistakes.append(
            f"{samples.place(k)}: found neither a frequency nor a damping; leave the row out"
        )
    mistakes.refuse()
    if (count := samples.numbers.size) < 3:
        raise InputError(f"{samples.where}: found {count} rows of values, must be at least 3")


def _unit(text: str) -> str:
    if plain_unit(text) not in _ANY_AMPLITUDE:
        raise mistake(f"found {text!r}, must be one of {', '.join(_ANY_AMPLITUDE)}")
    return plain_unit(text)


def _direction(text: str) -> tuple[float, ...]:
    axes = {"x": "1, 0, 0", "y": "0, 1, 0", "z": "0, 0, 1"}
    parts = re.split(r"[,\s]+", axes.get(text, text).strip("[]() "))
    vector = np.array([number_in(part) for part in parts], dtype=float)  # nan of no number
    size = float(np.abs(vector).max())
    if not (0.0 < size < math.inf and vector.size <= 3):
        must = "x, y, z, or up to three finite numbers not all 0, as in 0, 1, 1"
        raise mistake(f"found {text!r}, must be {must}")
    return tuple((vector / size / np.linalg.norm(vector / size)).tolist())


def _share(text: str) -> Any:
    number = number_in(text.removesuffix("%"))
    return text if number is None else number / (100.0 if text.endswith("%") else 1.0)


_Text = Annotated[str, Field(min_length=1)]
_Share = Annotated[float | None, BeforeValidator(_share), Field(gt=0, le=1)]
_Offsets = Annotated[
    tuple[Literal["frequency", "damping"], ...],
    BeforeValidator(lambda text: [word for word in re.split(r"[,\s]+", text) if word != "none"]),
    AfterValidator(has_no_repeats),
]


class Head(SceneTable):
    """What a measured curve is of; values are read from texts."""

    model_config = ConfigDict(strict=False)

    name: _Text | None = key("name of the curve", None)
    point: _Text = key("point that was measured", "")
    direction: Annotated[tuple[float, ...], BeforeValidator(_direction)] | None = key(
        "unit vector along which it was measured", None
    )
    unit: Annotated[str, AfterValidator(_unit)] | None = key("unit of the amplitude", None)
    peak_to_peak: bool = key("amplitudes are the whole of peak to peak, not half", False)
    mode: Count = key("number of the mode", 1)
    offset: _Offsets = key("what is known up to a constant", ())
    lowest: float = key("lowest amplitude that is fitted, in the unit of the data", 0.0, ge=0)
    highest: float = key("highest amplitude that is fitted", math.inf, ge=0)
    relative_frequency_deviation: _Share = key("share of the values, or percent, as in 5 %", None)
    relative_damping_deviation: _Share = key("share of the values, or percent, as in 5 %", None)
    frequency: Positive | None = key("about that of the mode of a decay, Hz", None)


def _comments(path: Path, content: str) -> tuple[list[tuple[str, str, str]], list[str]]:
    """Places, keys and texts of the comments that state a key, and doubts about others.

    One that begins with a key is none of the remarks, whatever follows. Doubts are sentences about
    remarks by which amplitudes are not half of peak to peak.
    """
    stated, doubts = list[tuple[str, str, str]](), list[str]()
    for number, line in enumerate(io.StringIO(content, newline=None), start=1):
        text = line.partition("#")[2].strip("# \r\n")
        if not re.search(r":|\b(error|noise)\b", text, re.I) and re.search(
            r"\b(rms|r\.m\.s|(?<!half of )(?<!half of the )peak.to.peak|pk-pk|p-p|dB)\b", text, re.I
        ):
            doubts.append(
                f"line {number} says {text[:60]!r}: amplitudes are taken as half of peak to peak, "
                "1.414 times the root mean square of a sine; state peak_to_peak: true, or "
                "convert them, if they are not."
            )
        said = re.fullmatch(
            r"\s*#+\s*([A-Za-z_][\w -]*?)\s*(?:([:=])\s*([^#]*?)\s*)?(?:#.*)?\s*", line
        )
        if said is None:
            continue
        name = said[1].casefold()
        if said[2] != ":":
            name = re.sub("[ -]+", "_", name)
        known = Head.model_fields if said[2] else ("peak_to_peak",)  # others may head a column
        if said[2] == ":" or name in known:
            stated.append((f"{path}: line {number}", name, said[3] or ""))
    return stated, doubts


def head_of(samples: Samples, given: Mapping[str, Any]) -> Head:
    """Head of a curve from the comments of its file and from arguments, which win.

    Raises
    ------
    InputError
        If keys or arguments are unknown or wrong; all of them at once.
    """
    problems: list[str] = []
    places: dict[str, str] = {}
    values: dict[str, str] = {}
    for place, name, text in samples.stated:
        if name in places:
            problems.append(f"{place}: found {name!r} again, must be once")
        values[name], places[name] = text, place
    of_file = {*values}
    for name, value in given.items():
        if value is not None:
            several = isinstance(value, list | tuple | np.ndarray)
            text = ", ".join(map(str, value)) or "none" if several else str(value).strip()
            values[name], places[name] = text, "measured_curve"
    try:
        head = Head.model_validate(values)
    except ValidationError as error:
        problems += [
            f"{places[str(each['loc'][0])]}: {line}"
            for each in error.errors()
            for line in sentences(each, Head)
        ]
    problems += [
        f"{samples.where}: found both column '{name}_deviation' and key "
        f"'relative_{name}_deviation', must be one of them"
        for name in QUANTITIES
        if f"{name}_deviation" in samples.columns and f"relative_{name}_deviation" in of_file
    ]
    refuse(problems)
    if head.lowest > head.highest:
        raise InputError(
            f"{samples.where}: found a range of amplitudes from {head.lowest:g} to "
            f"{head.highest:g}, must rise"
        )
    return head
