"""Steady vibration over frequency at several levels of load, with the linear limits beside it.

Each point is a period of steady vibration (:mod:`skfem_joint.stepping.steady`), begun where the
frequency before it ended. Amplitudes are half of peak to peak: where joints come to rest depends on
the past, and is told as the offset.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from skfem_joint.analysis.history import relative
from skfem_joint.analysis.rows import Rows
from skfem_joint.arrays import FloatArray
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.loads import Harmonic, MultiHarmonic, common_period
from skfem_joint.progress import Progress, Tally, silent
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.reduction.interface_modes import motions_without_slip
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import Scheme
from skfem_joint.system import System
from skfem_joint.unknowns import congruent
from skfem_joint.values import COUNT, POSITIVE, check, check_each

State = tuple[FloatArray, FloatArray]
#: Harmonics of a response that are told.
HARMONICS = 5
#: Points that are added around a peak, and the distance to a known one, relative, from which on
#: none is; change of the amplitude between two points, over the largest, that asks for one more.
AROUND, CLOSE, STEEP = 6, 2e-4, 0.15
#: Times in a period at which a linear response is looked at; frequencies at which it is found
#: first, and force, relative, that may be left elsewhere.
SAMPLES, AMONG, EXACT = 256, 7, 1e-8


@dataclass(frozen=True)
class SteadyPoint:
    """Steady vibration at one frequency; ``failure`` says why there is none, all else is nan."""

    frequency: float  #: first harmonic of the loads, Hz
    amplitude: FloatArray  #: (points,) half of peak to peak, m
    offset: FloatArray  #: (points,) mean of the two peaks, m
    harmonics: FloatArray  #: (points, HARMONICS) complex, of exp(i k omega t), m
    phase: FloatArray  #: (points,) of the first harmonic after that of the first load, rad
    friction_energy: float  #: of a cycle, J
    input_energy: float  #: of a cycle, J
    slip: FloatArray  #: (m,) largest slip of each contact point, m
    share: float  #: of the friction limits that slips, by a thousandth of the largest slip
    periods: int  #: that were gone through
    change: float  #: of the state over the last one, relative
    state: State | None = None  #: at the period's end
    course: FloatArray | None = None  #: (steps + 1, n) over the period, of a dense system, m
    step_error: float = np.nan  #: estimated, relative, of the largest amplitude by the time step
    failure: str | None = None


@dataclass(frozen=True)
class Curve:
    """Response at one level of load, at rising frequencies."""

    level: float
    points: tuple[SteadyPoint, ...]

    def column(self, name: str) -> FloatArray:
        """One of the quantities at all frequencies."""
        return np.array([getattr(point, name) for point in self.points])

    @property
    def largest(self) -> int:
        """Number of the named point that moves most."""
        return int(np.nanmax(self.column("amplitude"), axis=0).argmax())

    @property
    def known(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies (Hz) with a steady vibration, and amplitudes (m) of the largest there."""
        f, A = self.column("frequency"), self.column("amplitude")[:, self.largest]
        return f[np.isfinite(A)], A[np.isfinite(A)]

    @property
    def peak(self) -> tuple[float, float]:
        """Frequency (Hz) and amplitude (m) of the peak, by a parabola through the three highest."""
        return _top(*self.known)


def at_frequency(system: System, frequency: float, level: float = 1.0) -> System:
    """Same system with its loads at another frequency (Hz, of their common period) and level.

    InputError if a load is not made of harmonics, or the frequency is not positive.
    """
    period = common_period(load.amplitude for load in system.loads)
    harmonic = all(load.amplitude.harmonics for load in system.loads)
    if period is None or frequency <= 0.0 or not harmonic:
        raise InputError(
            f"response: found frequency {frequency}, must be > 0, of loads that are harmonic"
        )
    faster, loads = frequency * period, []
    for load in system.loads:
        parts = load.amplitude.harmonics
        scaled = (Harmonic(level * a.amplitude, faster * a.frequency, a.phase) for a in parts)
        loads.append(replace(load, amplitude=MultiHarmonic(tuple(scaled))))
    return replace(system, loads=tuple(loads))


def response(
    system: System,
    frequencies: FloatArray,
    levels: Sequence[float] = (1.0,),
    *,
    steps_per_cycle: int = 200,
    scheme: Scheme | None = None,
    refined: bool = True,
    estimated: bool = True,
    executor: Executor | None = None,
    progress: Progress = silent,
    rows: Rows | None = None,
) -> list[Curve]:
    """Steady vibration over frequency, a curve for each level.

    Parameters
    ----------
    system : System
        Full or condensed; its loads are harmonic. What `skfem_joint.reduce` made is good for its
        own loads alone.
    frequencies : ndarray
        First harmonics of the loads, Hz, rising.
    levels : sequence of float
        Factors of the loads' amplitudes.
    steps_per_cycle, scheme
        As `integrate` takes them.
    refined : bool
        Whether points are added around peaks and where a curve is steep.
    estimated : bool
        Whether each point is found with twice the step too, which tells the error of its step.
    executor : concurrent.futures.Executor, optional
        Where levels are run side by side.
    progress : callable, optional
        Called with (frequencies done, frequencies in all as far as they are known), and between
        them, without an executor, with a note on the search.
    rows : Rows, optional
        Where steady vibrations are kept as they are found, and taken up again.

    Raises
    ------
    InputError
        If there is nothing to vibrate steadily, a frequency or level is not positive, or the system
        is a reduced model made for its own loads.
    ConvergenceError
        If no frequency of a level has a steady vibration.
    """
    system.check_any_load("response")
    check_each("response: frequencies", frequencies, POSITIVE)
    check_each("response: levels", levels, POSITIVE)
    check("response: steps_per_cycle", steps_per_cycle, COUNT)
    frequencies, levels = np.asarray(frequencies, dtype=float), np.asarray(levels).tolist()
    if np.any(np.diff(frequencies) <= 0.0):
        raise InputError("response: frequencies must be positive and rise, in Hz")
    if not system.points:
        raise InputError("response: nothing is observed; name a point")
    if all(load.amplitude.peak_value == 0.0 for load in system.loads):
        raise InputError("response: no load acts; give one an amplitude above 0")
    rows, each = rows or Rows(), frequencies.size * (2 if estimated else 1)
    tally = Tally(progress, each * len(levels))

    def expect(count: int) -> None:
        """Count points that nobody knew of."""
        tally.asked += count
        rows.asked += count

    rest = steps_per_cycle, refined, estimated, expect
    curves = [_curve(frequencies, level, *rest) for level in levels]
    return _followed(curves, system, scheme, executor, tally, rows)


@dataclass(frozen=True)
class _Asked:
    """A steady vibration that a curve asks for next."""

    frequency: float  #: Hz
    level: float
    steps_per_cycle: int
    start: State | None
    whole: bool  #: whether others begin with its state

    def found(self, system: System, scheme: Scheme | None, progress: Progress) -> SteadyPoint:
        """Find it."""
        how = self.steps_per_cycle, scheme, self.start, progress
        point = steady_point(system, self.frequency, self.level, *how)
        return point if self.whole else replace(point, state=None, course=None)


_CurveOfPoints: TypeAlias = Generator[_Asked, SteadyPoint, Curve]


def _followed(
    curves: list[_CurveOfPoints],
    system: System,
    scheme: Scheme | None,
    executor: Executor | None,
    tally: Tally,
    rows: Rows,
) -> list[Curve]:
    """Whole curves: one after another, or side by side with an executor.

    Each point is a row, named by all that it depends on.
    """
    of = rows.mark("steady point", system, scheme)
    ended: dict[int, Curve] = {}
    running: dict[Future[SteadyPoint], tuple[int, str, float]] = {}

    def go_on(number: int, point: SteadyPoint | None) -> None:
        """Give a curve its next points, up to one that an executor has to find."""
        try:
            while True:
                asked = curves[number].send(point)  # type: ignore[arg-type]  # None begins it
                mark = rows.mark(of, asked)
                if executor is not None and mark not in rows:
                    sent = executor.submit(asked.found, system, scheme, silent)
                    running[sent] = number, mark, time.perf_counter()
                    return
                point = rows.row(mark, partial(asked.found, system, scheme, tally.within))
                tally.add()
        except StopIteration as end:
            ended[number] = end.value

    try:
        for number in range(len(curves)):
            go_on(number, None)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                number, mark, begin = running.pop(future)
                point = rows.keep(mark, future.result(), time.perf_counter() - begin)
                tally.add()
                go_on(number, point)
    finally:
        for future in running:
            future.cancel()
    return [ended[number] for number in range(len(curves))]


def _curve(
    frequencies: FloatArray,
    level: float,
    steps_per_cycle: int,
    refined: bool,
    estimated: bool,
    expect: Callable[[int], None],
) -> _CurveOfPoints:
    """Ask for the points of a curve one after another; ``expect`` counts those that are added."""
    points: list[SteadyPoint] = []
    state: State | None = None
    for frequency in frequencies.tolist():
        points.append((yield _Asked(frequency, level, steps_per_cycle, state, True)))
        state = points[-1].state
    if all(point.failure is not None for point in points):
        raise ConvergenceError(
            f"response: level {level:g}, at every frequency: {points[0].failure}"
        )
    for _ in range(4 * AROUND if refined else 0):
        wanted = next(_wanted(Curve(level, tuple(points))), None)
        if wanted is None:
            break
        expect(2 if estimated else 1)
        state = min(points, key=lambda point: abs(point.frequency - wanted)).state
        points.append((yield _Asked(wanted, level, steps_per_cycle, state, True)))
        points.sort(key=lambda point: point.frequency)
    curve = Curve(level, tuple(points))
    if not estimated or steps_per_cycle < 4:
        return curve
    coarse, largest = steps_per_cycle // 2, curve.largest
    order = (steps_per_cycle / coarse) ** 2 - 1.0  # all schemes are of second order
    for k, point in enumerate(points):
        if point.failure is None:
            other = yield _Asked(point.frequency, level, coarse, point.state, False)
            apart = relative(other.amplitude[largest], point.amplitude[largest])
            error = np.nan if apart is None else abs(apart) / order
            points[k] = replace(point, step_error=error)
    return Curve(level, tuple(points))


def _wanted(curve: Curve) -> Iterator[float]:
    """Frequencies that a curve lacks: first where it is steep, then around its peak."""
    f, A = curve.known
    if f.size < 3:
        return
    width = np.diff(f)
    steep = np.flatnonzero(
        (np.abs(np.diff(A)) > STEEP * A.max()) & (width > 0.25 * np.median(width))
    )
    for k in steep:
        yield float(0.5 * (f[k] + f[k + 1]))
    top, _ = _top(f, A)
    if np.abs(f - top).min() > CLOSE * top:
        yield top


def _top(f: FloatArray, A: FloatArray) -> tuple[float, float]:
    """Top of a parabola through the highest point and its neighbours; that point at an end."""
    k = int(A.argmax())
    if 0 < k < f.size - 1:
        parabola = np.polyfit(f[k - 1 : k + 2] - f[k], A[k - 1 : k + 2], 2)
        if parabola[0] < 0.0:
            shift = -0.5 * parabola[1] / parabola[0]
            return float(f[k] + shift), float(np.polyval(parabola, shift))
    return float(f[k]), float(A[k])


def steady_point(
    system: System,
    frequency: float,
    level: float = 1.0,
    steps_per_cycle: int = 200,
    scheme: Scheme | None = None,
    start: State | None = None,
    progress: Progress = silent,
) -> SteadyPoint:
    """Steady vibration at one frequency (Hz); one that is not found says so."""
    loaded = at_frequency(system, frequency, level)
    try:
        run = integrate(
            loaded,
            until="steady",
            steps_per_cycle=steps_per_cycle,
            scheme=scheme,
            save=Save(fields=system.is_dense),
            initial=start,
            progress=progress,
        )
    except ConvergenceError as error:
        nothing = np.full(len(system.points), np.nan)
        harmonics = np.full((nothing.size, HARMONICS), np.nan + 0j)
        slip = np.full(system.w.size, np.nan)
        return SteadyPoint(
            frequency, nothing, nothing, harmonics, nothing, np.nan, np.nan, slip, np.nan, 0,
            np.nan, failure=str(error),
        )  # fmt: skip
    found = run.vibration
    harmonics = _harmonics(run.point_u[:-1])
    slip, limit = run.slip_peak.max(initial=0.0), float(system.w.sum())
    first = _harmonics(loaded.load_amplitudes(run.times[:-1])[:1].T)[0, 0]
    return SteadyPoint(
        frequency=frequency,
        amplitude=found.amplitude,
        offset=found.offset,
        harmonics=harmonics,
        phase=np.angle(harmonics[:, 0] / first) if first else np.angle(harmonics[:, 0]),
        friction_energy=float(run.friction_work.sum()),
        input_energy=float(run.input_work.sum()),
        slip=run.slip_peak,
        share=float(system.w[run.slip_peak > THRESHOLD * slip].sum() / limit) if limit else 0.0,
        periods=found.periods,
        change=found.change,
        state=run.final,
        course=run.u if system.is_dense else None,
    )


def _harmonics(rows: FloatArray) -> FloatArray:
    """Harmonics of the columns over a period, (columns, HARMONICS), complex."""
    return np.asarray(2.0 * np.fft.rfft(rows, axis=0)[1 : HARMONICS + 1].T / len(rows))


def linear_response(system: System, frequencies: FloatArray, stuck: bool) -> FloatArray:
    """Amplitudes (m) with all contact points held, or free: (frequencies, points).

    The limits of small and of large loads; from the exact complex stiffness.
    """
    inner = arranged(system).system
    V = motions_without_slip(inner, True) if stuck else sparse.eye_array(inner.n, format="csc")
    solve = _Harmonic(*(sparse.csr_array(congruent(A, V)) for A in (inner.K, inner.C, inner.M)))
    P, F = inner.P @ V, V.T @ inner.load_vectors()
    turn = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    found = np.zeros((frequencies.size, len(system.points)))
    # From far to near, so that most lie between others.
    far = np.unique(np.linspace(0, frequencies.size - 1, AMONG).astype(int))
    for at in [*far, *np.setdiff1d(np.arange(frequencies.size), far)]:
        frequency, motion = float(frequencies[at]), np.zeros((len(system.points), SAMPLES))
        for force, load in zip(F.T, at_frequency(inner, frequency).loads, strict=True):
            for part in load.amplitude.harmonics:
                u = P @ solve(2.0 * np.pi * part.frequency, force) * part.amplitude
                phase = turn * part.frequency / frequency + part.phase
                motion += (u[:, np.newaxis] * np.exp(1j * phase)).imag
        found[at] = 0.5 * np.ptp(motion, axis=1)
    return found


class _Harmonic:
    """Motion under harmonic forces by few factors: most lie in the span of those found before.

    Where the residual there is more than `EXACT` of the force, a factor is made.
    """

    def __init__(self, K: sparse.csr_array, C: sparse.csr_array, M: sparse.csr_array) -> None:
        self.matrices = K, C, M
        self.factor: tuple[float, SuperLU] | None = None  # the last one, and its frequency
        self.V = np.zeros((K.shape[0], 0))
        self.images = [self.V, self.V, self.V]

    def __call__(self, omega: float, force: FloatArray) -> NDArray[np.complex128]:
        """Complex amplitude, (n,), at an angular frequency."""
        factors = 1.0, 1j * omega, -(omega**2)
        if self.V.shape[1]:
            image = sum(a * A for a, A in zip(factors, self.images, strict=True))
            u = np.linalg.solve(self.V.T @ image, self.V.T @ force)
            if np.linalg.norm(force - image @ u) <= EXACT * np.linalg.norm(force):
                return np.asarray(self.V @ u)
        if self.factor is None or self.factor[0] != omega:  # loads often share a frequency
            H = sum(a * A for a, A in zip(factors, self.matrices, strict=True))
            self.factor = omega, splu(sparse.csc_array(H))
        u = self.factor[1].solve(force.astype(complex))
        more = np.stack([u.real, u.imag], axis=1)
        for _ in range(2):
            more = more - self.V @ (self.V.T @ more)
            more = orthonormal(more, sparse.eye_array(u.size))
        self.V = np.hstack([self.V, more])
        self.images = [
            np.hstack([B, A @ more]) for A, B in zip(self.matrices, self.images, strict=True)
        ]
        return np.asarray(u)
