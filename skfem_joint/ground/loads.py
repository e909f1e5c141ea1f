"""Amplitudes of loads: forces in newtons as functions of time.

Every shape is a callable object derived from `Amplitude`, and so are shapes that users define. A
plain function of time does as well, see `as_amplitude`. Values that are not finite or out of range
are refused by name with an `InputError`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from skfem_joint.ground.arrays import FloatArray, as_real
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.values import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    check_columns,
    problems,
    several,
)


class Amplitude(ABC):
    """Force as a function of time, with the properties that are known without sampling.

    A shape that defines ``_force`` alone counts as smooth and not periodic; its largest force and
    its highest frequency are not known.
    """

    @abstractmethod
    def _force(self, t: FloatArray) -> Any:
        """Force (N) at an array of times t (s), of any shape."""

    def __call__(self, t: ArrayLike) -> FloatArray:
        """Force (N) at a time or an array of times t (s), in the shape of t."""
        return np.asarray(self._force(np.asarray(t, dtype=float)))

    @property
    def harmonics(self) -> tuple[Harmonic, ...]:
        """Harmonics whose sum is the force; empty if it is no such sum."""
        return ()

    @property
    def period(self) -> float | None:
        """Shortest known period, s; None for a force that does not repeat."""
        return common_period([self])

    @property
    def oscillates(self) -> bool:
        """Whether it goes up and down as a harmonic does: steps must follow each period."""
        return self.period is not None

    @property
    def corners(self) -> tuple[float, ...]:
        """Times (s) at which the value or the slope jumps; a step should end there."""
        return ()

    @property
    def jumps(self) -> tuple[float, ...]:
        """Corners (s) at which the value itself jumps, at the time or just after it."""
        t = np.array(self.corners)
        if t.size == 0:
            return ()
        force = self([np.nextafter(t, -np.inf), t, np.nextafter(t, np.inf)])
        least = 1e-6 * (self.peak_value or np.abs(force).max(initial=0.0))  # above round-off
        return tuple(t[np.ptp(force, axis=0) > least].tolist())

    @property
    def shape(self) -> Amplitude:
        """The amplitude itself, without factors."""
        return self

    @property
    def span(self) -> tuple[float, float]:
        """First and last time (s) between which the force acts, as far as that is known."""
        return -np.inf, np.inf

    @property
    def peak_value(self) -> float | None:
        """Largest absolute force, N; None if it is not known."""
        return None

    @property
    def highest_frequency(self) -> float | None:
        """Highest frequency that is excited, Hz; None if it is not known.

        For an impulse it is 1 / (2 rise time), the paper's Nyquist rule (section 6.2).
        """
        return max((harmonic.frequency for harmonic in self.harmonics), default=None)


def _check(amplitude: Any, *positive: str) -> None:
    """Raise InputError naming every field that is not finite or out of its range."""
    meaning = {
        "amplitude": "force, N",
        "frequency": "Hz",
        "phase": "at time zero, rad",
        "peak": "largest force, N",
        "rise_time": "time from start to peak, s",
        "duration": "time that the force lasts, s",
        "start": "time at which the force sets in, s",
        "first_frequency": "Hz",
        "last_frequency": "Hz",
        "rate": "octaves per minute",
    }
    kinds = dict.fromkeys(positive, POSITIVE) | {"start": NOT_NEGATIVE}
    refuse(
        f"{problem} ({meaning[field.name]})"
        for field in fields(amplitude)
        for problem in problems(
            field.name, getattr(amplitude, field.name), kinds.get(field.name, FINITE)
        )
    )


@dataclass(frozen=True)
class Harmonic(Amplitude):
    """``amplitude * sin(2 pi frequency t + phase)``.

    Attributes
    ----------
    amplitude : float
        N, of either sign.
    frequency : float
        Hz, above 0.
    phase : float
        rad.
    """

    amplitude: float
    frequency: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        _check(self, "frequency")

    def _force(self, t: FloatArray) -> Any:
        return self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phase)

    @property
    def harmonics(self) -> tuple[Harmonic, ...]:
        """The force itself is the only harmonic."""
        return (self,)

    @property
    def peak_value(self) -> float:
        """Absolute amplitude, N."""
        return abs(self.amplitude)


@dataclass(frozen=True)
class MultiHarmonic(Amplitude):
    """Sum of harmonics, each with its own phase.

    Attributes
    ----------
    components : sequence of Harmonic
        Not empty.
    """

    components: Sequence[Harmonic]

    def __post_init__(self) -> None:
        object.__setattr__(self, "components", several("components", self.components, Harmonic))
        if not self.components:
            raise InputError("components: found none, must be at least one harmonic")

    def _force(self, t: FloatArray) -> Any:
        return sum(component(t) for component in self.components)

    @property
    def harmonics(self) -> tuple[Harmonic, ...]:
        """The components."""
        return tuple(self.components)

    @property
    def peak_value(self) -> float:
        """Largest absolute force over a common period, N.

        Without a common period it is the sum of the amplitudes, to which the force comes as near as
        desired if time is long enough.
        """
        bound = sum(component.peak_value for component in self.components)
        period = self.period
        if period is None or bound == 0:
            return bound
        periods = max(1, *(round(period * c.frequency) for c in self.components))
        n = 64 * periods  # samples, 64 in each period of the fastest harmonic
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


@dataclass(frozen=True)
class SweptSine(Amplitude):
    """Sine whose frequency goes from a first to a last value at a rate, zero after that.

    Its frequency at the time t (s) is first_frequency * 2^(rate t / 60), or the first one divided
    by that where the last one is lower.

    Attributes
    ----------
    amplitude : float
        N, of either sign.
    first_frequency, last_frequency : float
        Hz, above 0, not the same.
    rate : float
        Octaves per minute, above 0.
    """

    amplitude: float
    first_frequency: float
    last_frequency: float
    rate: float

    def __post_init__(self) -> None:
        _check(self, "first_frequency", "last_frequency", "rate")
        if self.first_frequency == self.last_frequency:
            raise InputError(
                f"last_frequency: found {self.last_frequency:g}, must differ from first_frequency"
            )

    @property
    def _growth(self) -> float:
        """Rate at which the logarithm of the frequency changes, 1/s."""
        rises = 1.0 if self.last_frequency > self.first_frequency else -1.0
        return rises * self.rate * math.log(2.0) / 60.0

    def _force(self, t: FloatArray) -> Any:
        k = self._growth
        angle = 2.0 * np.pi * self.first_frequency * np.expm1(k * np.minimum(t, self.span[1])) / k
        return np.where((t >= 0.0) & (t <= self.span[1]), self.amplitude * np.sin(angle), 0.0)

    @property
    def span(self) -> tuple[float, float]:
        """From zero to the end of the sweep, s."""
        return 0.0, math.log(self.last_frequency / self.first_frequency) / self._growth

    @property
    def corners(self) -> tuple[float, ...]:
        """Start and end of the sweep, s."""
        return self.span

    @property
    def oscillates(self) -> bool:
        """True, though no period repeats."""
        return True

    @property
    def peak_value(self) -> float:
        """Absolute amplitude, N."""
        return abs(self.amplitude)

    @property
    def highest_frequency(self) -> float:
        """The larger one of both frequencies, Hz."""
        return max(self.first_frequency, self.last_frequency)


class _Pulse(Amplitude):
    """Base of the shapes that rise to a peak; they are zero before their start.

    ``_LENGTH`` is the name of the duration, which must be positive and gives the highest frequency.
    ``_CORNERS`` are times since the start, and ``_END`` that of the end, in units of that duration.
    """

    peak: float
    start: float
    _LENGTH: ClassVar[str]
    _CORNERS: ClassVar[tuple[int, ...]] = ()
    _END: ClassVar[float] = 2.0

    def __post_init__(self) -> None:
        _check(self, self._LENGTH)

    @property
    def corners(self) -> tuple[float, ...]:
        """Times (s) at which the value or the slope jumps."""
        return tuple(self.start + x * getattr(self, self._LENGTH) for x in self._CORNERS)

    @property
    def span(self) -> tuple[float, float]:
        """Start and end, s."""
        return self.start, self.start + self._END * float(getattr(self, self._LENGTH))

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
    """Base of the impulses with a rise time.

    ``_shape`` is force over peak as a function of the time since the start over the rise time.

    Attributes
    ----------
    peak : float
        N; a negative force pushes instead of pulling.
    rise_time : float
        Time from the start to the peak, s, above 0.
    start : float
        Time at which the force sets in, s, not below 0.
    """

    peak: float
    rise_time: float
    start: float = 0.0

    _LENGTH = "rise_time"
    _shape: ClassVar[staticmethod[[FloatArray], Any]]

    def _force(self, t: FloatArray) -> Any:
        return self.peak * self._shape((t - self.start) / self.rise_time)


def _tent(x: FloatArray) -> Any:
    """Straight from 0 at x = 0 to 1 at x = 1 and back, exactly 0 elsewhere."""
    return np.maximum(0.0, 1.0 - np.abs(x - 1.0))


class Triangle(_Impulse):
    """Straight up to ``peak`` in ``rise_time``, straight down in as much.

    Impulse (area): peak * rise_time.

    Attributes
    ----------
    peak : float
        N; a negative force pushes instead of pulling.
    rise_time : float
        Time from the start to the peak, s, above 0.
    start : float
        Time at which the force sets in, s, not below 0.
    """

    _CORNERS = (0, 1, 2)
    _shape = staticmethod(_tent)


class HalfSine(_Impulse):
    """Half a sine wave of duration ``2 * rise_time``.

    Impulse (area): 4 / pi * peak * rise_time.

    Attributes
    ----------
    peak : float
        N; a negative force pushes instead of pulling.
    rise_time : float
        Time from the start to the peak, s, above 0.
    start : float
        Time at which the force sets in, s, not below 0.
    """

    _CORNERS = (0, 2)
    _shape = staticmethod(lambda x: np.sin(np.pi / 2 * _tent(x)))


class Versine(_Impulse):
    """``peak / 2 * (1 - cos)`` over a duration of ``2 * rise_time``: no jump of the slope.

    Impulse (area): peak * rise_time.

    Attributes
    ----------
    peak : float
        N; a negative force pushes instead of pulling.
    rise_time : float
        Time from the start to the peak, s, above 0.
    start : float
        Time at which the force sets in, s, not below 0.
    """

    _shape = staticmethod(lambda x: 0.5 * (1.0 - np.cos(np.pi * _tent(x))))


class RampAndHold(_Impulse):
    """Straight up to ``peak`` in ``rise_time``, held for ever after.

    Attributes
    ----------
    peak : float
        N; a negative force pushes instead of pulling.
    rise_time : float
        Time from the start to the peak, s, above 0.
    start : float
        Time at which the force sets in, s, not below 0.
    """

    _CORNERS, _END = (0, 1), np.inf
    _shape = staticmethod(lambda x: np.clip(x, 0.0, 1.0))


@dataclass(frozen=True)
class Rectangle(_Pulse):
    """``peak`` for ``start <= t < start + duration``, zero before and after.

    Attributes
    ----------
    peak : float
        Force, N, of either sign.
    duration : float
        s, above 0.
    start : float
        s, not below 0.
    """

    peak: float
    duration: float
    start: float = 0.0

    _LENGTH, _CORNERS, _END = "duration", (0, 1), 1.0

    def _force(self, t: FloatArray) -> Any:
        return np.where((t >= self.start) & (t < self.start + self.duration), self.peak, 0.0)


@dataclass(frozen=True, eq=False)
class Table(Amplitude):
    """Force given at points of time: linear between them, zero before the first and after the last.

    At the first and the last time the force is that of the table.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Strictly increasing, s; at least two.
    forces : ndarray, shape (n,)
        Forces at these times, N.
    """

    times: FloatArray
    forces: FloatArray

    def __post_init__(self) -> None:
        for name in ("times", "forces"):
            values = np.array(as_real(getattr(self, name), name))
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        check_columns("", "times", "forces", self.times, self.forces)

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
    def span(self) -> tuple[float, float]:
        """First and last time of the table, s."""
        return float(self.times[0]), float(self.times[-1])

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
    """A plain function of time; its period, corners and peak are not known.

    A call raises `InputError` where the function does not return a finite number for each time.

    Attributes
    ----------
    function : callable
        Takes a time (s), or better an array of times, and returns the force (N).
    """

    function: Callable[..., Any]

    def _force(self, t: FloatArray) -> Any:
        force = self._at_once(t) if t.size > 1 else None
        if force is None:
            each = (np.asarray(self.function(float(time))) for time in t.flat)
            numbers = [x.item() if x.size == 1 and _is_real(x) else np.nan for x in each]
            force = np.reshape(np.array(numbers, dtype=float), t.shape)
        wrong = ~np.isfinite(force)
        if wrong.any():
            raise InputError(
                f"load: the function of time {getattr(self.function, '__name__', '')!r} gives no "
                f"finite number at t = {t.flat[np.argmax(wrong)]:.9g} s, must give the force in N"
            )
        return force

    def _at_once(self, t: FloatArray) -> FloatArray | None:
        """Force at all times; None where the function takes single times only."""
        try:
            force = np.asarray(self.function(t.copy()))
        except (TypeError, ValueError):
            return (
                None  # as math.sin raises, or "if t < 1"; a mistake is raised again for each time
            )
        return force.astype(float) if force.shape == t.shape and _is_real(force) else None


def _is_real(values: NDArray[Any]) -> bool:
    """Whether an array has truth values, whole or real numbers."""
    return values.dtype.kind in "biuf"


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
    """Another amplitude times a factor.

    Attributes
    ----------
    of : Amplitude
    factor : float
    """

    of: Amplitude
    factor: float

    def _force(self, t: FloatArray) -> Any:
        return self.factor * self.of(t)

    @property
    def harmonics(self) -> tuple[Harmonic, ...]:
        """Harmonics of the other amplitude, scaled."""
        return tuple(replace(h, amplitude=self.factor * h.amplitude) for h in self.of.harmonics)

    @property
    def oscillates(self) -> bool:
        """Whether the other amplitude does."""
        return self.of.oscillates

    @property
    def corners(self) -> tuple[float, ...]:
        """Corners of the other amplitude, s."""
        return self.of.corners

    @property
    def shape(self) -> Amplitude:
        """The other amplitude, without factors."""
        return self.of.shape

    @property
    def span(self) -> tuple[float, float]:
        """Span of the other amplitude, s."""
        return self.of.span

    @property
    def peak_value(self) -> float | None:
        """Largest absolute force, N; None if it is not known."""
        peak = self.of.peak_value
        return None if peak is None else abs(self.factor) * peak

    @property
    def highest_frequency(self) -> float | None:
        """Highest frequency of the other amplitude, Hz."""
        return self.of.highest_frequency


def harmonic_factors(amplitudes: Sequence[Amplitude]) -> dict[int, NDArray[np.complex128]]:
    """Factors, N, of exp(i k w t) whose real parts add up to amplitudes made of harmonics.

    w is the angular frequency of their common period, and each array, (amplitudes,), that of a k;
    empty where there is no common period.
    """
    period, found = common_period(amplitudes) or 0.0, dict[int, NDArray[np.complex128]]()
    for number, amplitude in enumerate(amplitudes if period else ()):
        for part in amplitude.harmonics:
            own = found.setdefault(
                round(part.frequency * period), np.zeros(len(amplitudes), complex)
            )
            own[number] += part.amplitude * complex(np.sin(part.phase), -np.cos(part.phase))
    return found


def common_period(amplitudes: Iterable[Amplitude]) -> float | None:
    """Shortest time (s) after which all harmonics of the amplitudes repeat together.

    Amplitudes without harmonics do not count. None if there is no harmonic, or if the frequencies
    are not commensurate: their ratios must be fractions to 1e-12, and the common period must be at
    most 100,000 periods of the fastest harmonic, because no run reaches a longer period.
    """
    longest = 100_000
    frequencies = [h.frequency for amplitude in amplitudes for h in amplitude.harmonics]
    if not frequencies:
        return None
    # Ratios to the fastest are at most 1; their denominators bound the common period.
    fastest = max(frequencies)
    ratios = [Fraction(f / fastest).limit_denominator(longest) for f in frequencies]
    if any(
        abs(float(ratio) * fastest - f) > 1e-12 * f
        for ratio, f in zip(ratios, frequencies, strict=True)
    ):
        return None
    # The ratio of the fastest is 1, so the common period holds lcm(denominators) of its periods.
    periods_of_fastest = math.lcm(*(ratio.denominator for ratio in ratios))
    if periods_of_fastest > longest:
        return None
    return periods_of_fastest / fastest
