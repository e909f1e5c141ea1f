"""A response over frequency at one level of load: its points, its peak and what to beware of.

Frequency responses of it are the motion of a point over the force, or over that of the base.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.loads import harmonic_factors
from skfem_joint.ground.plain_values import Tabular, spread
from skfem_joint.ground.values import check_kind as check_type
from skfem_joint.results.loss import Losses, stacked
from skfem_joint.results.peaks import parabola_vertex
from skfem_joint.system.system import System

State = tuple[FloatArray, FloatArray]

#: Kinds, their units over a force, and the power of i omega that makes each of a displacement.
KINDS = {
    "receptance": ("m/N", 0),
    "mobility": ("m/s/N", 1),
    "accelerance": ("m/s²/N", 2),
    "transmissibility": ("", 2),
}
#: Error of the largest amplitude by the time step alone from which on a note says so.
DOUBTFUL = 0.05


@dataclass(frozen=True)
class SteadyPoint:
    """Steady vibration at one frequency.

    Where none was found ``failure`` says why, and all other results are nan.

    Attributes
    ----------
    frequency : float
        First harmonic of the loads, Hz.
    amplitude : ndarray, shape (points,)
        Half of peak to peak of each named point, m.
    offset : ndarray, shape (points,)
        Mean of the two peaks, m.
    harmonics : ndarray of complex, shape (points, 5)
        Factors of ``exp(i k omega t)``, m; nan where a period has too few steps for them.
    phase : ndarray, shape (points,)
        Phase of the first harmonic after that of the first load, rad.
    slip : ndarray, shape (m,)
        Of each contact point, m, half of peak to peak: the place about which it slips to and fro
        depends on the way there.
    friction_energy : float
        Dissipated by friction in a period, J.
    input_energy : float
        Work of the loads in a period, J.
    share : float
        Share of the friction limits, with contact that opens of those at rest, whose points slip
        in the period, see `System.slipping`; 0 where all stick, wherever they came to rest before.
    periods : int
        Periods that the search took.
    change : float
        Change of the state over the last of them, relative.
    state : tuple of ndarray, shape (n,), optional
        Displacement (m) and velocity (m/s) at the end of the period.
    course : ndarray, shape (steps + 1, n), optional
        Displacement over the period, m; of dense systems only.
    step_error : float
        Estimated relative error of the largest amplitude by the time step; nan if it is not
        estimated.
    model_error : float
        Estimated relative error of the largest amplitude by the modes of a reduced model for a
        range; nan for other models.
    losses : Losses, optional
        Energies that a period loses, J, and its loss factor.
    friction_work : ndarray, shape (m,), optional
        Energy lost by friction in a period at each contact point, J.
    failure : str, optional
        Why no steady vibration was found.
    gross : bool
        Whether a joint slips as a whole: in the vibration, or in the search that was given up.
    stable : bool or None
        Whether disturbances vanish, where that was judged: by harmonic balance.
    """

    frequency: float
    amplitude: FloatArray
    offset: FloatArray
    harmonics: FloatArray
    phase: FloatArray
    slip: FloatArray
    friction_energy: float = np.nan
    input_energy: float = np.nan
    share: float = np.nan
    periods: int = 0
    change: float = np.nan
    state: State | None = None
    course: FloatArray | None = None
    step_error: float = np.nan
    model_error: float = np.nan
    losses: Losses | None = None
    friction_work: FloatArray | None = None
    failure: str | None = None
    gross: bool = False
    stable: bool | None = None


@dataclass(frozen=True)
class Curve(Tabular):
    """Response at one level of load.

    Attributes
    ----------
    level : float
        Factor of the loads' amplitudes.
    points : tuple of SteadyPoint
        At rising frequencies.
    """

    level: float
    points: tuple[SteadyPoint, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """What to beware of, in whole sentences."""
        return tuple(_notes(self))

    def column(self, name: str) -> FloatArray:
        """A quantity of `SteadyPoint` at all frequencies, by its name."""
        return np.array([getattr(point, name) for point in self.points])

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each frequency, as ``response.csv``, points by their numbers."""
        single = {
            "frequency_Hz": "frequency",
            "friction_energy_J": "friction_energy",
            "input_energy_J": "input_energy",
            "slipping_share": "share",
            "periods": "periods",
            "residual": "change",
            "step_error": "step_error",
            "failure": "failure",
        }
        each = {"amplitude_{}_m": "amplitude", "phase_{}_rad": "phase", "offset_{}_m": "offset"}
        columns: dict[str, Any] = {name: self.column(of) for name, of in single.items()}
        for name, of in each.items():
            columns |= spread(name, self.column(of))
        return columns | self.losses.table

    @property
    def losses(self) -> Losses:
        """Energies that a period loses at all frequencies, J, and loss factors."""
        return stacked([point.losses for point in self.points])

    @property
    def found(self) -> bool:
        """Whether a steady vibration was found at any frequency."""
        return any(point.failure is None for point in self.points)

    @property
    def gross(self) -> FloatArray:
        """Frequencies, Hz, at which a joint slips as a whole.

        Where the search was given up for that, at the last of them, higher ones were not tried.
        """
        return np.array([point.frequency for point in self.points if point.gross])

    @property
    def largest(self) -> int:
        """Number of the named point that moves most."""
        return int(np.nan_to_num(self.column("amplitude")).max(axis=0).argmax())

    @property
    def known(self) -> tuple[FloatArray, FloatArray]:
        """Frequencies (Hz) with a steady vibration, and amplitudes (m) of the largest there."""
        f, A = self.column("frequency"), self.column("amplitude")[:, self.largest]
        return f[np.isfinite(A)], A[np.isfinite(A)]

    @property
    def peak(self) -> tuple[float, float]:
        """Frequency (Hz) and amplitude (m) of the peak, by a parabola through the three highest.

        The highest point itself where it is the first or the last. ConvergenceError where no
        vibration was found.
        """
        f, A = self.known
        if not f.size:
            raise ConvergenceError(nothing_found(self))
        k = int(A.argmax())
        if not 0 < k < f.size - 1:
            return float(f[k]), float(A[k])
        frequency, amplitude = parabola_vertex(f[k - 1 : k + 2], A[k - 1 : k + 2])
        return float(frequency), float(amplitude)

    @property
    def start(self) -> State:
        """State from which a search at the peak may start: of the nearest vibration kept."""
        peak, _ = self.peak
        kept = ((abs(p.frequency - peak), p.state) for p in self.points if p.state is not None)
        return min(kept, key=itemgetter(0))[1]


def nothing_found(curve: Curve) -> str:
    """Why a curve has no vibration."""
    tried = "at every frequency" if len(curve.gross) == 0 else "no vibration was found"
    return f"response: level {curve.level:g}, {tried}: {curve.points[-1].failure}"


def _notes(curve: Curve) -> Iterator[str]:
    """Sentences about a curve, each after its level.

    They are about joints that slip as a whole, frequencies without a steady vibration, a peak that
    may lie outside of the frequencies, and the time step.
    """
    notes = [*_whole_slip(curve)]
    if curve.found:
        notes += [*_without(curve), *_largest_at_an_end(curve), *_time_step(curve)]
    yield from (f"Level {curve.level:g}: {note}" for note in notes)


def _whole_slip(curve: Curve) -> Iterator[str]:
    """Where a joint slips as a whole, and what is left out for that."""
    if curve.gross.size:
        low, high = curve.gross.min(), curve.gross.max()
        where = f"{low:.6g} Hz" if low == high else f"{low:.6g} to {high:.6g} Hz"
        note = f"a joint slips as a whole at {where}"
        given_up = [p.failure for p in curve.points if p.failure is not None and p.periods > 0]
        if given_up:
            what = "the curve ends there" if curve.found else "there is no curve"
            note += f"; {what}: {given_up[0]}"
        yield f"{note}."


def _without(curve: Curve) -> Iterator[str]:
    """Frequencies that have no steady vibration."""
    without = [f"{p.frequency:.6g}" for p in curve.points if p.failure is not None]
    if without:
        yield (
            f"there is no steady vibration at {', '.join(without)} Hz: these are no points of the "
            "curve."
        )


def _largest_at_an_end(curve: Curve) -> Iterator[str]:
    """Whether the largest amplitude is that of the lowest or the highest frequency of several.

    Where a joint slips as a whole the curve may end before its peak, which another note says.
    """
    f, amplitude = curve.known
    end = int(amplitude.argmax())
    if f.size > 1 and end in (0, f.size - 1) and not curve.gross.size:
        lowest = end == 0
        yield (
            f"the largest amplitude is at {f[end]:.6g} Hz, the {'lowest' if lowest else 'highest'} "
            "frequency of the curve: a peak may lie "
            f"{'below' if lowest else 'above'}. Take a wider range if you look for one."
        )


def _time_step(curve: Curve) -> Iterator[str]:
    """Where the time step makes the curve doubtful, and the cure; where its error is not known.

    The steps are exact at the driven frequency: what errs are the harmonics of friction, where they
    meet higher modes.
    """
    error = curve.column("step_error")
    known = np.isfinite(error)
    failed = np.array([point.failure is not None for point in curve.points])
    if known.any() and not (known | failed).all():
        yield (
            "there is no steady vibration with half the step at every frequency: where step_error "
            "is empty in response.csv, nan in Python, the error of the step is not known."
        )
    error = np.nan_to_num(error)
    doubtful = error > DOUBTFUL
    if doubtful.any():
        frequency = curve.column("frequency")[doubtful]
        # Errors fall with the square of the step: so many times the steps leave one per cent.
        times = np.sqrt(error.max() / 0.01)
        yield (
            f"the time step alone errs by up to {100 * error.max():.2g} % of the amplitude, and by "
            f"more than {100 * DOUBTFUL:g} % at {frequency.size} frequencies from "
            f"{frequency[0]:.6g} to {frequency[-1]:.6g} Hz, where harmonics of friction meet "
            "higher modes; see column step_error of response.csv. Take "
            f"{times:.1f} times as many steps_per_cycle."
        )


def frequency_response(
    system: System, curve: Curve, point: str, kind: str = "receptance"
) -> FloatArray:
    """Motion of a named point over the load at each frequency of a response.

    The harmonics of a steady vibration are those of ``exp(i k omega t)``. Each harmonic of a
    point's displacement, velocity or acceleration is divided by the first harmonic of the first
    load; those beyond the first are what friction adds. All depend on the level, for the vibration
    is not linear. Where the load is an accelerated base displacements are relative to it. The
    transmissibility is the absolute motion of a point, along its own direction, over that of the
    base.

    Parameters
    ----------
    system : System
        That the response is of.
    curve : Curve
        One of its curves.
    point : str
        One of ``system.points``.
    kind : {"receptance", "mobility", "accelerance", "transmissibility"}
        Displacement (m/N), velocity (m/s/N) or acceleration (m/s²/N) over the force of the first
        load; or, of a base that is accelerated, absolute motion over that of the base.

    Returns
    -------
    ndarray of complex, shape (frequencies, 5)
        Harmonics over the first harmonic of the load, with the phase after it; nan where there is
        no steady vibration. The first column is what is measured as frequency response.

    Raises
    ------
    InputError
        For another kind or point, a load without a first harmonic, and a transmissibility where no
        base moves.
    """
    check_type("system", system, System)
    check_type("curve", curve, Curve)
    check_kind(system, kind)
    if point not in system.points:
        raise InputError(
            f"frequency response: found point {point!r}, must be one of {', '.join(system.points)}"
        )
    load, number = system.loads[0], system.points.index(point)
    frequency = curve.column("frequency")
    X = curve.column("harmonics")[:, number]
    order = np.arange(1, X.shape[1] + 1)
    i_omega = 2j * np.pi * frequency[:, np.newaxis] * order
    factors = harmonic_factors([one.amplitude for one in system.loads])
    force = curve.level * np.array([factors[k][0] if k in factors else 0.0 for k in order.tolist()])
    if kind != "transmissibility" or load.carried is None:
        return np.asarray(i_omega ** KINDS[kind][1] * X / force[0])
    base = -force / load.mass
    return np.asarray((i_omega**2 * X + load.carried[number] * base) / base[0])


def check_kind(system: System, kind: str) -> None:
    """Refuse a kind of frequency response that there is not, or that a system has not; InputError.

    Its first load must have a first harmonic, and be that of a moving base for a transmissibility.
    """
    if kind not in KINDS:
        raise InputError(f"frequency response: found {kind!r}, must be one of {', '.join(KINDS)}")
    load = system.loads[0]
    if not harmonic_factors([one.amplitude for one in system.loads]).get(1, [0.0])[0]:
        raise InputError(
            f"frequency response: the first load, on {load.on!r}, has no first harmonic to divide "
            "by; put one that has it first"
        )
    if kind == "transmissibility" and load.carried is None:
        raise InputError(
            "frequency response: found 'transmissibility', which needs a base that moves as the "
            "first load; ask for a receptance, mobility or accelerance"
        )
