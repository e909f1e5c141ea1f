"""Scalar amplitudes of time, in newtons, that a load gives to what it acts on.

Every shape is a callable object, see `Amplitude`, which one's own shape derives from; a plain
function of time does as well, see `as_amplitude`. Values that are not finite or out of the range
stated are refused by name with an `InputError`.
"""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar

from skfem_joint.arrays import FloatArray, as_real
from skfem_joint.errors import InputError, refuse
from skfem_joint.files import LARGEST_TABLE, UNFINISHED_LINE, read_text
from skfem_joint.values import FINITE, NOT_NEGATIVE, POSITIVE, problems

_log = logging.getLogger(__name__)

# Frequencies count as commensurate when their ratios are fractions to this relative accuracy and
# the common period holds at most this many periods of the fastest: beyond that no run reaches it.
_RATIO_TOLERANCE = 1e-12
_LONGEST_COMMON_PERIOD = 100_000
_SAMPLES_PER_PERIOD = 64
_MOST_PROBLEMS_LISTED = 10
_LEAST_JUMP = 1e-6  # of the largest force
_REAL = "biuf"  # kinds of numbers that a function of time may return
_MEANING = {
    "amplitude": "force, N",
    "frequency": "Hz",
    "phase": "at time zero, rad",
    "peak": "largest force, N",
    "rise_time": "time from start to peak, s",
    "duration": "time that the force lasts, s",
    "start": "time at which the force sets in, s",
}
_LARGEST = 1e20  # of the numbers in a file: slopes and energies must not overflow


class Amplitude(ABC):
    """Force as a function of time, and what is known of it without sampling.

    A shape that defines no more than ``_force`` is smooth, does not repeat, and has neither a
    largest force nor a highest frequency that is known.
    """

    @abstractmethod
    def _force(self, t: FloatArray) -> Any:
        """Force (N) at an array of times t (s), of any shape."""

    def __call__(self, t: ArrayLike) -> FloatArray:
        """Force (N) at a time or an array of times t (s), in the shape of t."""
        return np.asarray(self._force(np.asarray(t, dtype=float)))

    @property
    def harmonics(self) -> tuple[Harmonic, ...]:
        """Harmonics that the force is the sum of; none if it is not."""
        return ()

    @property
    def period(self) -> float | None:
        """Shortest known period, s; None for a force that does not repeat."""
        return common_period([self])

    @property
    def corners(self) -> tuple[float, ...]:
        """Times (s) at which the value or the slope jumps; a step should end there."""
        return ()

    @property
    def jumps(self) -> tuple[float, ...]:
        """Those of the corners (s) at which the value jumps, be it at the time or just after it."""
        t = np.array(self.corners)
        if t.size == 0:
            return ()
        force = self([np.nextafter(t, -np.inf), t, np.nextafter(t, np.inf)])
        least = _LEAST_JUMP * (self.peak_value or np.abs(force).max(initial=0.0))
        return tuple(t[np.ptp(force, axis=0) > least].tolist())

    @property
    def peak_value(self) -> float | None:
        """Largest absolute force, N; None if it is not known."""
        return None

    @property
    def highest_frequency(self) -> float | None:
        """Highest frequency that is excited, Hz; None where no such figure exists.

        Of an impulse 1 / (2 * rise time): the paper's Nyquist rule, section 6.2.
        """
        return max((one.frequency for one in self.harmonics), default=None)


def _check(amplitude: Any, positive: str) -> None:
    """Raise InputError naming every field that is not finite or out of its range."""
    kinds = {positive: POSITIVE, "start": NOT_NEGATIVE}
    refuse(
        f"{problem} ({_MEANING[field.name]})"
        for field in fields(amplitude)
        for problem in problems(
            field.name, getattr(amplitude, field.name), kinds.get(field.name, FINITE)
        )
    )


@dataclass(frozen=True)
class Harmonic(Amplitude):
    """``amplitude * sin(2 pi frequency t + phase)``."""

    amplitude: float  #: N; a negative one turns the sign
    frequency: float  #: Hz, > 0
    phase: float = 0.0  #: rad

    def __post_init__(self) -> None:
        _check(self, positive="frequency")

    def _force(self, t: FloatArray) -> Any:
        return self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phase)

    @property
    def harmonics(self) -> tuple[Harmonic, ...]:
        """Itself."""
        return (self,)

    @property
    def peak_value(self) -> float:
        """Absolute amplitude, N."""
        return abs(self.amplitude)


@dataclass(frozen=True)
class MultiHarmonic(Amplitude):
    """Sum of harmonics, each with its own phase."""

    components: Sequence[Harmonic]  #: at least one

    def __post_init__(self) -> None:
        object.__setattr__(self, "components", tuple(self.components))
        if not self.components:
            raise InputError("components: found none, must be at least one harmonic")

    def _force(self, t: FloatArray) -> Any:
        return sum(component(t) for component in self.components)

    @property
    def harmonics(self) -> tuple[Harmonic, ...]:
        """Its components."""
        return tuple(self.components)

    @property
    def peak_value(self) -> float:
        """Largest absolute force over a common period, N.

        Without a common period the sum of the amplitudes, which the force comes as near to as one
        waits for.
        """
        bound = sum(component.peak_value for component in self.components)
        period = self.period
        if period is None or bound == 0:
            return bound
        n = _SAMPLES_PER_PERIOD * max(1, *(round(period * c.frequency) for c in self.components))
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


class _Pulse(Amplitude):
    """What the shapes share that rise to a peak; they are zero before their start."""

    peak: float
    start: float
    #: Name of the time that must be positive and that the highest frequency goes with.
    _LENGTH: ClassVar[str]
    #: Corners, at times since the start in units of that time.
    _CORNERS: ClassVar[tuple[int, ...]] = ()

    def __post_init__(self) -> None:
        _check(self, positive=self._LENGTH)

    @property
    def corners(self) -> tuple[float, ...]:
        """Times (s) at which the value or the slope jumps."""
        return tuple(self.start + x * getattr(self, self._LENGTH) for x in self._CORNERS)

    @property
    def peak_value(self) -> float:
        """Absolute peak, N."""
        return abs(self.peak)

    @property
    def highest_frequency(self) -> float:
        """1 / (2 rise time), or 1 / (2 duration) of a rectangle, Hz."""
        return float(1 / (2 * getattr(self, self._LENGTH)))


@dataclass(frozen=True)
class _Impulse(_Pulse):
    """What the impulses with a rise time share."""

    peak: float  #: N; a negative one pushes instead of pulling
    rise_time: float  #: time from the start to the peak, s, > 0
    start: float = 0.0  #: time at which the force sets in, s, >= 0

    _LENGTH = "rise_time"
    #: Force over the peak at times since the start in units of the rise time.
    _shape: ClassVar[staticmethod[[FloatArray], Any]]

    def _force(self, t: FloatArray) -> Any:
        return self.peak * self._shape((t - self.start) / self.rise_time)


def _tent(x: FloatArray) -> Any:
    """Straight from 0 at x = 0 to 1 at x = 1 and back, exactly 0 elsewhere."""
    return np.maximum(0.0, 1.0 - np.abs(x - 1.0))


class Triangle(_Impulse):
    """Straight up to ``peak`` in ``rise_time``, straight down in as much.

    Impulse (area): peak * rise_time.
    """

    _CORNERS = (0, 1, 2)
    _shape = staticmethod(_tent)


class HalfSine(_Impulse):
    """Half a sine wave of duration ``2 * rise_time``.

    Impulse (area): 4 / pi * peak * rise_time.
    """

    _CORNERS = (0, 2)
    _shape = staticmethod(lambda x: np.sin(np.pi / 2 * _tent(x)))


class Versine(_Impulse):
    """``peak / 2 * (1 - cos)`` over a duration of ``2 * rise_time``: no jump of the slope.

    Impulse (area): peak * rise_time.
    """

    _shape = staticmethod(lambda x: 0.5 * (1.0 - np.cos(np.pi * _tent(x))))


class RampAndHold(_Impulse):
    """Straight up to ``peak`` in ``rise_time``, held for ever after."""

    _CORNERS = (0, 1)
    _shape = staticmethod(lambda x: np.clip(x, 0.0, 1.0))


@dataclass(frozen=True)
class Rectangle(_Pulse):
    """``peak`` for ``start <= t < start + duration``, zero before and after."""

    peak: float  #: N
    duration: float  #: s, > 0
    start: float = 0.0  #: s, >= 0

    _LENGTH, _CORNERS = "duration", (0, 1)

    def _force(self, t: FloatArray) -> Any:
        return np.where((t >= self.start) & (t < self.start + self.duration), self.peak, 0.0)


@dataclass(frozen=True, eq=False)
class Table(Amplitude):
    """Force given at points of time: linear between them, zero before the first and after the last.

    At the first and the last time the force is that of the table.
    """

    times: FloatArray  #: shape (n,), s, strictly increasing, n >= 2
    forces: FloatArray  #: shape (n,), N

    def __post_init__(self) -> None:
        for name in ("times", "forces"):
            values = np.array(as_real(getattr(self, name), name))
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if self.times.ndim != 1 or self.times.shape != self.forces.shape or self.times.size < 2:
            raise InputError(
                f"times, forces: found shapes {self.times.shape} and {self.forces.shape}, "
                "must be two lists of one length, at least 2"
            )
        wrong = [
            f"{name}[{i}]: found {values[i]}, must be finite"
            for name, values in (("times", self.times), ("forces", self.forces))
            for i in np.flatnonzero(~np.isfinite(values))
        ]
        wrong += [
            f"times[{i + 1}]: found {self.times[i + 1]}, must be > {self.times[i]}, the time before"
            for i in np.flatnonzero(np.diff(self.times) <= 0)
        ]
        refuse(wrong)

    def _force(self, t: FloatArray) -> Any:
        return np.interp(t, self.times, self.forces, left=0.0, right=0.0)

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
    def highest_frequency(self) -> float:
        """1 / (2 smallest time between two points), Hz."""
        return float(1 / (2 * np.diff(self.times).min()))


@dataclass(frozen=True)
class Function(Amplitude):
    """A plain function of time, of which nothing more is known: no period, no corners, no peak.

    It takes a time (s), or better an array of times, and returns the force (N); a call raises
    `InputError` where that is not one finite number for each time.
    """

    function: Callable[..., Any]

    def _force(self, t: FloatArray) -> Any:
        force = self._at_once(t) if t.size > 1 else None
        if force is None:
            found = [np.asarray(self.function(float(time))) for time in t.flat]
            each = [x.item() if x.size == 1 and x.dtype.kind in _REAL else np.nan for x in found]
            force = np.reshape(np.array(each, dtype=float), t.shape)
        wrong = ~np.isfinite(force)
        if wrong.any():
            raise InputError(
                f"load: the function of time {getattr(self.function, '__name__', '')!r} gives no "
                f"finite number at t = {t.flat[np.argmax(wrong)]:.9g} s, must give the force in N"
            )
        return force

    def _at_once(self, t: FloatArray) -> FloatArray | None:
        """Force at all times; None where the function must be asked for each of them."""
        try:
            force = np.asarray(self.function(t.copy()))
        except (TypeError, ValueError):
            return None  # such as math.sin, or "if t < 1"; a true mistake is raised again for each
        is_force = force.shape == t.shape and force.dtype.kind in _REAL
        return force.astype(float) if is_force else None


def as_amplitude(shape: object) -> Amplitude:
    """Amplitude from any of the shapes above, or from a plain function of time (s) that returns N.

    InputError for anything else.
    """
    if isinstance(shape, Amplitude):
        return shape
    if callable(shape) and not isinstance(shape, type):
        return Function(shape)
    raise InputError(
        f"load: found {shape!r}, must be a force as a function of time: a shape such as "
        "Harmonic(amplitude, frequency), or a function of t in s that returns N"
    )


@dataclass(frozen=True)
class Scaled(Amplitude):
    """The same course in time, so many times as large."""

    of: Amplitude
    factor: float

    def _force(self, t: FloatArray) -> Any:
        return self.factor * self.of(t)

    @property
    def harmonics(self) -> tuple[Harmonic, ...]:
        """Those of the other, scaled."""
        return tuple(replace(h, amplitude=self.factor * h.amplitude) for h in self.of.harmonics)

    @property
    def corners(self) -> tuple[float, ...]:
        """Those of the other, s."""
        return self.of.corners

    @property
    def peak_value(self) -> float | None:
        """Largest absolute force, N; None if it is not known."""
        peak = self.of.peak_value
        return None if peak is None else abs(self.factor) * peak

    @property
    def highest_frequency(self) -> float | None:
        """That of the other, Hz."""
        return self.of.highest_frequency


def common_period(amplitudes: Iterable[Amplitude]) -> float | None:
    """Shortest time (s) after which all harmonics among the amplitudes repeat together.

    Those without harmonics are passed over. None if there is no harmonic, or if the frequencies are
    not commensurate.
    """
    frequencies = [one.frequency for amplitude in amplitudes for one in amplitude.harmonics]
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
    """Table from a UTF-8 text file with two columns separated by a comma: time (s) and force (N).

    Lines of two words before the first number are a header; empty lines and what follows a ``#``
    are passed over.

    Raises
    ------
    InputError
        A file that cannot be read, and every line that is not two finite numbers with the time
        above the time before it; the message names file and line.
    """
    path = Path(path)
    content = read_text(path, LARGEST_TABLE)
    if not content.endswith(("\n", "\r")):
        _log.warning("%s: %s", path, UNFINISHED_LINE)
    lines = content.splitlines()
    rows: list[list[float]] = []
    mistakes: list[str] = []
    more = 0
    for number, line in enumerate(lines, start=1):
        if len(mistakes) > _MOST_PROBLEMS_LISTED:  # counted, not kept
            more += len(mistakes) - _MOST_PROBLEMS_LISTED
            del mistakes[_MOST_PROBLEMS_LISTED:]
        text = line.split("#", 1)[0].strip()
        values = [_number(column) for column in text.split(",")]
        is_header = values == [None, None] and not rows and not mistakes
        if not text or is_header:
            continue
        match values:
            case [float(time), float(force)] if abs(time) <= _LARGEST and abs(force) <= _LARGEST:
                if rows and not time - rows[-1][0] >= 1.0 / _LARGEST:
                    mistakes.append(
                        f"{path}: line {number}: found time {time:g}, "
                        f"must be > {rows[-1][0]:g}, the time before it"
                    )
                rows.append([time, force])
            case _:
                mistakes.append(
                    f"{path}: line {number}: found {text[:60]!r}, must be two finite numbers "
                    f"separated by a comma: time in s, force in N; none larger than {_LARGEST:g}"
                )
    if not mistakes and len(rows) < 2:
        mistakes = [f"{path}: line {max(1, len(lines))}: found {len(rows)} points, must be >= 2"]
    more += len(mistakes[_MOST_PROBLEMS_LISTED:])
    if more:
        mistakes = mistakes[:_MOST_PROBLEMS_LISTED]
        mistakes.append(f"{path}: and {more} more lines like these")
    refuse(mistakes)
    return Table(*np.array(rows).T)


def _number(text: str) -> float | None:
    """Read one column of a line; None if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return None
