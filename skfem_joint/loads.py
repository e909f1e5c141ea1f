"""Scalar amplitudes of time, in newtons, that a load gives to the point it acts on.

Every load is a frozen, callable object: ``load(t)`` takes a time or an array of times (s) and
returns the force (N) in the shape of ``t``. Beside that it answers what the rest of the package has
to know without sampling it:

``period``
    Shortest known period, s, or None for a load that does not repeat.
``corners``
    Times (s) at which the value or the slope jumps; a step should end there.
``peak_value``
    Largest absolute force, N.
``highest_frequency``
    Highest frequency the load excites, Hz. For an impulse the paper's Nyquist rule (section 6.2):
    1 / (2 * rise time). None where no such figure exists.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from skfem_joint.errors import InputError
from skfem_joint.files import read_whole

Force: TypeAlias = NDArray[np.float64]

# Frequencies count as commensurate when their ratios are fractions to this relative accuracy and
# the common period holds at most this many periods of the fastest: beyond that no run reaches it.
_RATIO_TOLERANCE = 1e-12
_LONGEST_COMMON_PERIOD = 100_000
_SAMPLES_PER_PERIOD = 64
_MOST_PROBLEMS_LISTED = 10
_LARGEST = 1e20  # of the numbers in a file: slopes and energies must not overflow


def _check(load: Harmonic | _Impulse | Rectangle, positive: str) -> None:
    """Raise InputError naming every field that is not finite or out of its range."""
    problems = []
    for field in fields(load):
        value = getattr(load, field.name)
        if not math.isfinite(value):
            problems.append(f"{field.name}: found {value!r}, must be finite")
        elif field.name == positive and value <= 0:
            problems.append(f"{field.name}: found {value!r}, must be > 0")
        elif field.name == "start" and value < 0:
            problems.append(f"{field.name}: found {value!r}, must be >= 0")
    if problems:
        raise InputError(problems)


@dataclass(frozen=True)
class Harmonic:
    """``amplitude * sin(2 pi frequency t + phase)``.

    Parameters
    ----------
    amplitude : float
        N; a negative one turns the sign.
    frequency : float
        Hz, > 0.
    phase : float
        rad.

    Raises
    ------
    InputError
        A value that is not finite, or a frequency that is not positive.
    """

    amplitude: float
    frequency: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is not allowed."""
        _check(self, positive="frequency")

    def __call__(self, t: ArrayLike) -> Force:
        """Force (N) at the times t (s)."""
        t = np.asarray(t, dtype=float)
        return np.asarray(self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phase))

    @property
    def period(self) -> float | None:
        """1 / frequency, s."""
        return 1 / self.frequency

    @property
    def corners(self) -> tuple[float, ...]:
        """None: the load is smooth."""
        return ()

    @property
    def peak_value(self) -> float:
        """Absolute amplitude, N."""
        return abs(self.amplitude)

    @property
    def highest_frequency(self) -> float | None:
        """The frequency, Hz."""
        return self.frequency


@dataclass(frozen=True)
class MultiHarmonic:
    """Sum of harmonics, each with its own phase.

    Parameters
    ----------
    components : tuple of Harmonic
        At least one.

    Raises
    ------
    InputError
        No component.
    """

    components: tuple[Harmonic, ...]

    def __post_init__(self) -> None:
        """Refuse what is not allowed."""
        object.__setattr__(self, "components", tuple(self.components))
        if not self.components:
            raise InputError("components: found none, must be at least one harmonic")

    def __call__(self, t: ArrayLike) -> Force:
        """Force (N) at the times t (s)."""
        return np.asarray(sum(component(t) for component in self.components))

    @property
    def period(self) -> float | None:
        """Shortest common period, s; None if the frequencies are not commensurate."""
        return _common_period([component.frequency for component in self.components])

    @property
    def corners(self) -> tuple[float, ...]:
        """None: the load is smooth."""
        return ()

    @property
    def peak_value(self) -> float:
        """Largest absolute force over a common period, N.

        Without a common period the sum of the amplitudes, which the load comes as near to as one
        waits for.
        """
        bound = sum(component.peak_value for component in self.components)
        period = self.period
        if period is None or bound == 0:
            return bound
        fastest = max(component.frequency for component in self.components)
        n = _SAMPLES_PER_PERIOD * max(1, round(period * fastest))
        step = period / n
        t = step * np.arange(n)
        force = np.abs(self(t))
        # A sampled maximum lies below the true one by at most half the curvature times step².
        curvature = sum(c.peak_value * (2 * np.pi * c.frequency) ** 2 for c in self.components)
        is_peak = (force >= np.roll(force, 1)) & (force >= np.roll(force, -1))
        near_best = force >= force.max() - 0.5 * curvature * step**2
        return max(
            -float(
                minimize_scalar(
                    lambda x: -abs(float(self(x))),
                    bounds=(t_peak - step, t_peak + step),
                    method="bounded",
                    options={"xatol": 1e-6 * step},
                ).fun
            )
            for t_peak in t[is_peak & near_best]
        )

    @property
    def highest_frequency(self) -> float | None:
        """Highest frequency among the components, Hz."""
        return max(component.frequency for component in self.components)


@dataclass(frozen=True)
class _Impulse:
    """What the impulses with a rise time share.

    Parameters
    ----------
    peak : float
        N; a negative one pushes instead of pulling.
    rise_time : float
        Time from the start to the peak, s, > 0.
    start : float
        Time at which the force sets in, s, >= 0.

    Raises
    ------
    InputError
        A value that is not finite or out of range.
    """

    peak: float
    rise_time: float
    start: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is not allowed."""
        _check(self, positive="rise_time")

    def _since_start(self, t: ArrayLike) -> Force:
        """Time since the start in units of the rise time."""
        return np.asarray((np.asarray(t, dtype=float) - self.start) / self.rise_time)

    def _tent(self, t: ArrayLike) -> Force:
        """Straight from 0 at the start to 1 at the peak and back, exactly 0 elsewhere."""
        return np.asarray(np.maximum(0.0, 1 - np.abs(self._since_start(t) - 1)))

    @property
    def period(self) -> float | None:
        """None: an impulse does not repeat."""
        return None

    @property
    def peak_value(self) -> float:
        """Absolute peak, N."""
        return abs(self.peak)

    @property
    def highest_frequency(self) -> float | None:
        """1 / (2 rise time), Hz: the paper's Nyquist rule, section 6.2."""
        return 1 / (2 * self.rise_time)


@dataclass(frozen=True)
class Triangle(_Impulse):
    """Straight up to ``peak`` in ``rise_time``, straight down in as much.

    Impulse (area): peak * rise_time. Parameters as those of the other impulses: peak (N),
    rise_time (s), start (s).
    """

    def __call__(self, t: ArrayLike) -> Force:
        """Force (N) at the times t (s)."""
        return np.asarray(self.peak * self._tent(t))

    @property
    def corners(self) -> tuple[float, ...]:
        """Start, peak and end, s."""
        return self.start, self.start + self.rise_time, self.start + 2 * self.rise_time


@dataclass(frozen=True)
class HalfSine(_Impulse):
    """Half a sine wave of duration ``2 * rise_time``.

    Impulse (area): 4 / pi * peak * rise_time.
    """

    def __call__(self, t: ArrayLike) -> Force:
        """Force (N) at the times t (s)."""
        return np.asarray(self.peak * np.sin(np.pi / 2 * self._tent(t)))

    @property
    def corners(self) -> tuple[float, ...]:
        """Start and end, s."""
        return self.start, self.start + 2 * self.rise_time


@dataclass(frozen=True)
class Versine(_Impulse):
    """``peak / 2 * (1 - cos)`` over a duration of ``2 * rise_time``: no jump of the slope.

    Impulse (area): peak * rise_time.
    """

    def __call__(self, t: ArrayLike) -> Force:
        """Force (N) at the times t (s)."""
        return np.asarray(self.peak / 2 * (1 - np.cos(np.pi * self._tent(t))))

    @property
    def corners(self) -> tuple[float, ...]:
        """None: value and slope are continuous."""
        return ()


@dataclass(frozen=True)
class RampAndHold(_Impulse):
    """Straight up to ``peak`` in ``rise_time``, held for ever after."""

    def __call__(self, t: ArrayLike) -> Force:
        """Force (N) at the times t (s)."""
        return np.asarray(self.peak * np.clip(self._since_start(t), 0, 1))

    @property
    def corners(self) -> tuple[float, ...]:
        """Both ends of the ramp, s."""
        return self.start, self.start + self.rise_time


@dataclass(frozen=True)
class Rectangle:
    """``peak`` for ``start <= t < start + duration``, zero before and after.

    Parameters
    ----------
    peak : float
        N.
    duration : float
        s, > 0.
    start : float
        s, >= 0.

    Raises
    ------
    InputError
        A value that is not finite or out of range.
    """

    peak: float
    duration: float
    start: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is not allowed."""
        _check(self, positive="duration")

    def __call__(self, t: ArrayLike) -> Force:
        """Force (N) at the times t (s)."""
        t = np.asarray(t, dtype=float)
        return np.where((t >= self.start) & (t < self.start + self.duration), self.peak, 0.0)

    @property
    def period(self) -> float | None:
        """None: an impulse does not repeat."""
        return None

    @property
    def corners(self) -> tuple[float, ...]:
        """Start and end, s: the force jumps at both."""
        return self.start, self.start + self.duration

    @property
    def peak_value(self) -> float:
        """Absolute peak, N."""
        return abs(self.peak)

    @property
    def highest_frequency(self) -> float | None:
        """1 / (2 duration), Hz."""
        return 1 / (2 * self.duration)


@dataclass(frozen=True, eq=False)
class Table:
    """Force given at points of time: linear between them, zero before the first and after the last.

    Parameters
    ----------
    times : array_like, shape (n,)
        s, strictly increasing, n >= 2.
    forces : array_like, shape (n,)
        N.

    Raises
    ------
    InputError
        Lengths that differ, fewer than two points, a value that is not finite, times that do not
        increase.
    """

    times: Force
    forces: Force

    def __post_init__(self) -> None:
        """Refuse what is not allowed."""
        for name in ("times", "forces"):
            values = np.array(getattr(self, name), dtype=float)
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if self.times.ndim != 1 or self.times.shape != self.forces.shape or self.times.size < 2:
            raise InputError(
                f"times, forces: found shapes {self.times.shape} and {self.forces.shape}, "
                "must be two lists of one length, at least 2"
            )
        problems = [
            f"{name}[{i}]: found {values[i]}, must be finite"
            for name, values in (("times", self.times), ("forces", self.forces))
            for i in np.flatnonzero(~np.isfinite(values))
        ]
        problems += [
            f"times[{i + 1}]: found {self.times[i + 1]}, must be > {self.times[i]}, the time before"
            for i in np.flatnonzero(np.diff(self.times) <= 0)
        ]
        if problems:
            raise InputError(problems)

    def __call__(self, t: ArrayLike) -> Force:
        """Force (N) at the times t (s)."""
        t = np.asarray(t, dtype=float)
        return np.asarray(np.interp(t, self.times, self.forces, left=0.0, right=0.0))

    @property
    def period(self) -> float | None:
        """None: a table is taken once."""
        return None

    @property
    def corners(self) -> tuple[float, ...]:
        """The times at which the slope changes, and an end at which the force is not zero, s."""
        slope = np.concatenate([[0.0], np.diff(self.forces) / np.diff(self.times), [0.0]])
        scale = np.abs(slope).max()
        is_corner = np.abs(np.diff(slope)) > 1e-9 * scale
        is_corner[[0, -1]] |= self.forces[[0, -1]] != 0
        return tuple(float(time) for time in self.times[is_corner])

    @property
    def peak_value(self) -> float:
        """Largest absolute force in the table, N."""
        return float(np.abs(self.forces).max())

    @property
    def highest_frequency(self) -> float | None:
        """1 / (2 smallest time between two points), Hz."""
        return float(1 / (2 * np.diff(self.times).min()))


Load: TypeAlias = (
    Harmonic | MultiHarmonic | Triangle | HalfSine | Versine | RampAndHold | Rectangle | Table
)


def common_period(loads: Iterable[Load]) -> float | None:
    """Shortest time after which all harmonics in the loads repeat together.

    Parameters
    ----------
    loads : iterable of Load
        Impulses and tables among them are passed over.

    Returns
    -------
    float or None
        s; None if there is no harmonic among the loads or their frequencies are not commensurate.
    """
    frequencies: list[float] = []
    for load in loads:
        if isinstance(load, Harmonic):
            frequencies.append(load.frequency)
        elif isinstance(load, MultiHarmonic):
            frequencies += [component.frequency for component in load.components]
    return _common_period(frequencies)


def _common_period(frequencies: Sequence[float]) -> float | None:
    """Reciprocal of the greatest common divisor of the frequencies (Hz), or None."""
    if not frequencies:
        return None
    # Ratios to the fastest are at most 1, and their denominators bound the length searched for.
    fastest = max(frequencies)
    ratios = [Fraction(f / fastest).limit_denominator(_LONGEST_COMMON_PERIOD) for f in frequencies]
    if any(
        abs(float(ratio) * fastest - f) > _RATIO_TOLERANCE * f
        for ratio, f in zip(ratios, frequencies, strict=True)
    ):
        return None
    # The ratio of the fastest is 1, so the common period holds lcm(denominators) of its periods.
    periods_of_fastest = math.lcm(*(ratio.denominator for ratio in ratios))
    if periods_of_fastest > _LONGEST_COMMON_PERIOD:
        return None
    return periods_of_fastest / fastest


def read_table(path: str | Path) -> Table:
    """Load from a text file with two columns separated by a comma: time (s) and force (N).

    A first line that holds no number is a header; empty lines and what follows a ``#`` are passed
    over.

    Parameters
    ----------
    path : str or Path
        The file, UTF-8.

    Returns
    -------
    Table

    Raises
    ------
    InputError
        A file that cannot be read, and every line that is not two finite numbers with the time
        above the time before it; the message names file and line.
    """
    path = Path(path)
    try:
        lines = read_whole(path).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        bad_line = error.object[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: line {bad_line}: not UTF-8 text") from error

    rows: list[tuple[float, float]] = []
    problems: list[str] = []
    header_allowed = True
    for number, line in enumerate(lines, start=1):
        columns = [column.strip() for column in line.split("#", 1)[0].split(",")]
        if columns == [""]:
            continue
        values = [_number(column) for column in columns]
        is_header = header_allowed and len(columns) == 2 and values == [None, None]
        header_allowed = False
        if is_header:
            continue
        match values:
            case [float(time), float(force)] if abs(time) <= _LARGEST and abs(force) <= _LARGEST:
                if rows and not time - rows[-1][0] >= 1.0 / _LARGEST:
                    problems.append(
                        f"{path}: line {number}: found time {time:g}, "
                        f"must be > {rows[-1][0]:g}, the time before it"
                    )
                rows.append((time, force))
            case _:
                problems.append(
                    f"{path}: line {number}: found {line.strip()[:60]!r}, "
                    "must be two finite numbers separated by a comma: time in s, force in N; "
                    f"none larger than {_LARGEST:g}"
                )
    if not problems and len(rows) < 2:
        problems = [f"{path}: line {max(1, len(lines))}: found {len(rows)} points, must be >= 2"]
    if len(problems) > _MOST_PROBLEMS_LISTED:
        more = len(problems) - _MOST_PROBLEMS_LISTED
        problems = [*problems[:_MOST_PROBLEMS_LISTED], f"{path}: and {more} more lines like these"]
    if problems:
        raise InputError(problems)
    times, forces = np.array(rows).T
    return Table(times, forces)


def _number(text: str) -> float | None:
    """Read one column of a line; None if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return None
