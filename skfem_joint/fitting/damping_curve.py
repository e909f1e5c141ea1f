"""Frequency and damping over amplitude of a free vibration that was measured or computed.

The vibration of a mode is x = exp(a(t)) cos(p(t)), with the logarithm a of its amplitude and its
phase p both cubic splines of time. With their derivatives the angular frequency w and the damping
ratio z obey

    z w = -a',    w sqrt(1 - z^2) = p'.

1. In short windows, weighted by a cosine bell, least squares find a wave of linearly changing
   amplitude. What other modes, harmonics and an offset add lies at other frequencies, which such a
   weight does not see. The amplitudes say how far the vibration stands out of the noise.
2. From there Gauss and Newton's method fits the splines to all samples at once. Their pieces have
   equal shares of the decay. Their number is that of the least sum of squares, over the variance of
   the noise, plus a penalty for each coefficient: a mode of constant damping is fitted with one
   piece and a joint's with several.
3. Other modes and harmonics that stand out of what is left are fitted in the same way and
   subtracted, the largest first, and the fit is made anew: near the ends of a record no weight
   keeps them apart.
4. Standard deviations come from the normal equations, with the level of the noise near the
   frequency in what the fit leaves. What another number of pieces would change counts as an error
   too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, sparse
from scipy.interpolate import BSpline
from scipy.signal import find_peaks, periodogram
from scipy.signal.windows import hann, tukey

from skfem_joint.ground.arrays import BoolArray, FloatArray, as_real
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.plain_values import Tabular
from skfem_joint.ground.values import POSITIVE, check_columns, check_some

#: How often a signal of each quantity is the derivative of the displacement.
DERIVATIVES = {"displacement": 0, "velocity": 1, "acceleration": 2}


#: Fewest samples in a period.
_FEWEST_SAMPLES = 6.0
#: Length of a window, in periods; windows overlap by half.
_WINDOW = 6.0
#: Fewest of them.
_FEWEST_WINDOWS = 4
#: The vibration ends where its amplitude in a window is less than this many standard deviations.
_OUT_OF_NOISE = 6.0
#: Noise is that within this share of the frequency.
_NEAR = 0.25
#: Length over which the weight rises at the start and falls at the end, in periods.
_ENDS = 2.0
#: Share of the decay at each end that the curve leaves out, where splines are loose.
_INSIDE = 0.04


@dataclass(frozen=True)
class DampingCurve(Tabular):
    """Frequency and damping ratio of a mode over its amplitude, from a free vibration.

    Attributes
    ----------
    time : ndarray, shape (k,)
        s.
    amplitude : ndarray, shape (k,)
        Half of peak to peak then, in the unit of the signal; it falls by the same factor from one
        value to the next.
    frequency : ndarray, shape (k,)
        Of the undamped mode, Hz.
    damping_ratio : ndarray, shape (k,)
    amplitude_error, frequency_error, damping_error : ndarray, shape (k,)
        Standard deviations of these, in their units.
    pieces : int
        Pieces of the splines. There are two values more than pieces, which are nearly independent.
    noise : float
        Standard deviation of white noise as strong as that near the frequency, in the unit of the
        signal.
    """

    time: FloatArray
    amplitude: FloatArray
    frequency: FloatArray
    damping_ratio: FloatArray
    amplitude_error: FloatArray
    frequency_error: FloatArray
    damping_error: FloatArray
    pieces: int
    noise: float

    @property
    def table(self) -> dict[str, FloatArray]:
        """Columns with a row for each amplitude; amplitudes are in the unit of the signal."""
        return {
            "time_s": self.time,
            "amplitude": self.amplitude,
            "frequency_Hz": self.frequency,
            "damping_ratio": self.damping_ratio,
            "amplitude_error": self.amplitude_error,
            "frequency_error_Hz": self.frequency_error,
            "damping_error": self.damping_error,
        }


def damping_curve(
    time: ArrayLike,
    signal: ArrayLike,
    frequency: float | None = None,
    quantity: str = "displacement",
) -> DampingCurve:
    """Frequency and damping ratio of a mode over its amplitude, from a free vibration.

    Parameters
    ----------
    time : array_like, shape (n,)
        Evenly spaced times, s, after the blow or the release.
    signal : array_like, shape (n,)
        Displacement, velocity, acceleration, or what is in proportion to one of them.
    frequency : float, optional
        About that of the mode, Hz; the one with the highest peak of the spectrum if not given.
        Other modes do no harm where their frequencies differ by a half or more, also if they are 50
        times larger; filter out those that are nearer.
    quantity : {"displacement", "velocity", "acceleration"}
        What the signal is. Where the frequency depends on the amplitude, a velocity does not decay
        as the displacement does; frequency and damping are those of the displacement.

    Returns
    -------
    DampingCurve

    Raises
    ------
    InputError
        If times are not even, values are missing or not finite, a period has too few samples, or
        the vibration is too short, grows, does not stand out of the noise, or changes too fast, as
        in gross slip.
    ConvergenceError
        If no fit converges.
    """
    if quantity not in DERIVATIVES:
        raise InputError(
            f"damping_curve: quantity: found {quantity!r}, must be one of {', '.join(DERIVATIVES)}"
        )
    t, x = as_real(time, "damping_curve: time"), as_real(signal, "damping_curve: signal")
    check_columns("damping_curve: ", "time", "signal", t, x)
    steps = np.diff(t)
    if np.ptp(steps) > 1e-3 * steps.mean() + 4e-16 * np.abs(t).max():
        raise InputError(
            "damping_curve: times must rise by even steps; found steps from "
            f"{steps.min():.6g} to {steps.max():.6g} s; interpolate the signal first"
        )
    if np.ptp(x) == 0.0:
        raise InputError("damping_curve: the signal does not change")
    check_some(POSITIVE, frequency=frequency)
    step = float(t[-1] - t[0]) / (t.size - 1)
    spectrum, power = periodogram(x, 1.0 / step)
    f = frequency or float(spectrum[power.argmax()])
    if f * step * _FEWEST_SAMPLES > 1.0:
        raise InputError(
            f"damping_curve: found {1.0 / (f * step):.3g} samples in a period of {f:.4g} Hz, must "
            f"be at least {_FEWEST_SAMPLES:g}"
        )
    return _curve(float(t[0]), *_alone(x, step, f), DERIVATIVES[quantity])


def _alone(x: FloatArray, step: float, f: float) -> tuple[_Fit, _Fit]:
    """Fits of the vibration near a frequency, Hz, with other modes and harmonics taken away.

    They are fitted in the same way to what the others leave, the largest first. InputError as
    `damping_curve`.
    """
    others, main = dict[float, FloatArray](), np.zeros(x.size)
    frequencies = _other_frequencies(x, step, f, larger=True)
    # How often other modes are fitted anew to what is left.
    for _ in range(3):
        for g in frequencies:
            rest = x - main - sum(wave for h, wave in others.items() if h != g)
            try:
                others[g] = _wave(_fits(rest, step, g)[0], x.size, step)
            except (InputError, ConvergenceError):
                others.pop(g, None)  # too short or too small to be a mode
        fits = _fits(x - sum(others.values()), step, f)
        main = _wave(fits[0], x.size, step)
        frequencies = _other_frequencies(x - main, step, f)
        if not frequencies:
            break
    return fits


def _fits(x: FloatArray, step: float, f: float) -> tuple[_Fit, _Fit]:
    """Fits of the vibration near a frequency, Hz, whatever else there is; errors as `_alone`."""
    windows = _windows(x, step, f)
    size = 1 + round(windows.time[-1] / step)
    return _best(x[:size] - x[:size].mean(), step, windows)


def _wave(fit: _Fit, size: int, step: float) -> FloatArray:
    """Vibration of a fit at each sample, (size,).

    Near the ends, where samples have little weight, and beyond its end it goes on with constant
    frequency and damping.
    """
    t, end, (a, p) = step * np.arange(size), float(fit.knots[-1]), fit.coefficients
    logarithm, phase = BSpline(fit.knots, a, 3), BSpline(fit.knots, p, 3)
    loose = min(_ENDS * 2.0 * np.pi * end / float(phase(end) - phase(0.0)), 0.5 * end)
    inside = np.clip(t, loose, end - loose)
    both = [spline(inside) + (t - inside) * spline(inside, 1) for spline in (logarithm, phase)]
    return np.asarray(np.exp(both[0]) * np.cos(both[1]))


def _other_frequencies(
    left: FloatArray, step: float, f: float, larger: bool = False
) -> list[float]:
    """Frequencies of modes that stand out beside the one at ``f``, Hz, the largest first.

    Or of those alone that are ``larger`` than that one.
    """
    frequencies, density = periodogram(left, 1.0 / step, "hann")
    # Multiples of the frequency between which other modes are looked for.
    low, high = (share * f for share in (0.2, 5.0))
    among = (frequencies > low) & (frequencies < high)
    own, away = _near(frequencies, f), among & ~_near(frequencies, f)
    if not away.any():
        return []
    # Height of their peaks in the spectrum over its median.
    least = density[own].max() if larger else 30.0 * np.median(density[among])
    peaks, _ = find_peaks(density, height=least, prominence=0.9 * least)
    peaks = peaks[away[peaks]]
    found = list[float]()
    for g in frequencies[peaks[np.argsort(-density[peaks])]].tolist():
        if all(abs(g - h) > _NEAR * h for h in found):
            found.append(g)
    # Most of them.
    return found[:4]


class _Windows(NamedTuple):
    """Amplitude and phase of a vibration in the middle of windows, each of shape (k,).

    Attributes
    ----------
    time : ndarray
        From the first sample, s.
    log_amplitude, phase : ndarray
        Of a cosine.
    noise : ndarray
        Standard deviation of white noise as strong as that near the frequency, a parabola of time
        in its logarithm.
    """

    time: FloatArray
    log_amplitude: FloatArray
    phase: FloatArray
    noise: FloatArray


def _windows(x: FloatArray, step: float, f: float) -> _Windows:
    """Windows in which the vibration stands out of the noise, from the first on.

    InputError if they are too few, or the amplitude does not fall.
    """
    size, omega = round(_WINDOW / (f * step)), 2.0 * np.pi * f
    weight, s = hann(size, sym=True)[:, np.newaxis], step * (np.arange(size) - 0.5 * (size - 1))
    parts = x[np.arange(size)[:, np.newaxis] + np.arange(0, x.size - size + 1, size // 2)]
    wave = np.exp(1j * omega * s)[:, np.newaxis] * (s[:, np.newaxis] / s[-1]) ** [0, 1]
    columns = np.hstack([wave.real, -wave.imag, np.ones((size, 1))])
    found = np.linalg.lstsq(weight * columns, weight * parts, rcond=None)[0]
    z, change = found[:2] + 1j * found[2:4]
    noise = _noise(parts - columns @ found, step, f)
    of_amplitude = 2.0 * noise * (weight**2).sum() / weight.sum() ** 2
    stands = np.abs(z) ** 2 > _OUT_OF_NOISE**2 * of_amplitude
    count = int(np.append(stands, False).argmin())
    if count < _FEWEST_WINDOWS:
        _refuse_windows(stands, noise, parts, step, f)
    z, rate = z[:count], omega + (change / z)[:count].imag / s[-1]
    at = step * (size // 2 * np.arange(count) + 0.5 * (size - 1))
    ahead = 0.5 * (rate[1:] + rate[:-1]) * np.diff(at)
    turned = ahead + np.angle(z[1:] / z[:-1] * np.exp(-1j * ahead))
    if abs(z[0]) <= abs(z[-1]):
        raise InputError(
            f"damping_curve: the vibration at {f:.4g} Hz does not decay; give the part after the "
            "blow or the release"
        )
    levels = np.polynomial.Polynomial.fit(at, 0.5 * np.log(noise[:count] + 1e-32), 2)(at)
    phase = np.cumsum(np.append(np.angle(z[0]), turned))
    return _Windows(np.asarray(at), np.log(np.abs(z)), phase, np.exp(levels))


def _refuse_windows(
    stands: BoolArray, noise: FloatArray, parts: FloatArray, step: float, f: float
) -> None:
    """InputError for too few windows from the start on, with the cause.

    What is in the first of the windows, ``parts`` (size, windows), that does not stand out is no
    noise if it lies near some frequency, or if there is by far less later: then it is a vibration
    that is not a wave of slowly changing amplitude and frequency.
    """
    most, count = _FEWEST_WINDOWS, int(np.append(stands, False).argmin())
    periods, needed = count * _WINDOW / 2.0, most * _WINDOW / 2.0
    apart = 0.5 * _WINDOW / f
    if count < len(stands):
        frequencies, power = periodogram(parts[:, count], 1.0 / step, "hann")
        g = float(frequencies[power.argmax()])
        # Share of the power of a window near its highest peak from which on it is no noise.
        vibrates = power[_near(frequencies, g)].sum() > 0.6 * power.sum()
        if vibrates or noise[count] > _OUT_OF_NOISE**2 * min(noise[count:]):
            runs = range(count + 1, len(stands) - most + 1)
            later = [k for k in runs if stands[k : k + most].all()]
            other = f"the part from {later[0] * apart:.4g} s on" if later else "another part"
            raise InputError(
                f"damping_curve: {count * apart:.4g} s after the first sample the signal is no "
                f"vibration at {f:.4g} Hz that slowly decays, but lies near {g:.4g} Hz: its "
                "frequency or amplitude changes too fast, as in gross slip or during a blow, or "
                f"another mode is larger; give {other}, or another frequency"
            )
    raise InputError(
        f"damping_curve: found {periods:.3g} periods of {f:.4g} Hz that stand out of the noise "
        f"from the start on, must be at least {needed:g}; give the part after the blow or the "
        "release, and the frequency of the mode"
    )


def _noise(left: FloatArray, step: float, f: float) -> Any:
    """Variance of white noise with the level that a residual, (n, ...), has near ``f``, Hz."""
    frequencies, density = periodogram(left, 1.0 / step, "hann", axis=0)
    return density[_near(frequencies, f)].mean(axis=0) / (2.0 * step)


def _squares(left: FloatArray, step: float, f: float) -> float:
    """Sum of squares of what a residual has near a frequency, Hz: other modes do not count."""
    frequencies, density = periodogram(left, 1.0 / step, detrend=False)
    return float(density[_near(frequencies, f)].sum()) / step


def _near(frequencies: FloatArray, f: float) -> BoolArray:
    return np.abs(frequencies - f) <= _NEAR * f


class _Fit(NamedTuple):
    """Splines of the logarithm of the amplitude and of the phase, fitted to all samples.

    Attributes
    ----------
    knots : ndarray
    coefficients : ndarray, shape (2, c)
    covariance : ndarray, shape (2 c, 2 c)
        For white noise of variance 1.
    left : float
        Sum of squares that is left near the frequency.
    noise : float
        Variance of white noise as strong as that near the frequency.
    """

    knots: FloatArray
    coefficients: FloatArray
    covariance: FloatArray
    left: float
    noise: float


def _best(x: FloatArray, step: float, windows: _Windows) -> tuple[_Fit, _Fit]:
    """Fit with the number of pieces of the least sum of squares with its penalty, and the next.

    The one before where there is none after it.
    """
    period = 2.0 * np.pi / float(np.diff(windows.phase).sum() / np.ptp(windows.time))
    end, fits = step * (x.size - 1), []
    time = np.concatenate([[0.0], windows.time[1:-1], [end]])
    # Numbers of pieces of the splines that are tried.
    for pieces in (1, 2, 3, 4, 6, 8, 11, 15, 20):
        # Times between pieces, in which the amplitude falls by the same factor.
        shares = np.linspace(0.0, 1.0, pieces + 1)[1:-1]
        inner = _fallen(time, windows.log_amplitude, shares)
        # Shortest piece, in periods.
        short = pieces > 1 and np.diff([0.0, *inner, end]).min() < 3.0 * period
        if short or pieces + 3 > windows.time.size:
            break
        if (fit := _fitted(x, step, inner, windows, 1.0 / period)) is not None:
            fits.append(fit)
    if not fits:
        raise ConvergenceError("damping_curve: no fit of the vibration converged")
    noise = min(fit.noise for fit in fits)
    # Sum of squares over the variance of noise that a coefficient must explain. Akaike's
    # criterion has 2, Bayes's the logarithm of the number of values, about 6.
    sums = [fit.left / noise + 3.0 * fit.coefficients.size for fit in fits]
    least = int(np.argmin(sums))
    return fits[least], fits[least + 1 if least + 1 < len(fits) else least - 1]


def _fallen(time: FloatArray, log_amplitude: FloatArray, shares: FloatArray) -> FloatArray:
    """Times at which some shares of the fall of an amplitude are over, s."""
    falling = np.minimum.accumulate(log_amplitude)
    falling = falling - np.linspace(0.0, 1e-9, falling.size)  # so that it falls everywhere
    fallen = (falling[0] - falling) / (falling[0] - falling[-1])
    return np.asarray(np.interp(shares, fallen, time))


def _fitted(
    x: FloatArray, step: float, inner: FloatArray, windows: _Windows, f: float
) -> _Fit | None:
    """Splines with some inner knots, by Gauss and Newton's method; None without convergence."""
    t = step * np.arange(x.size)
    knots = np.concatenate([4 * [0.0], inner, 4 * [t[-1]]])
    B = BSpline.design_matrix(t, knots, 3)
    rise = 2.0 * _ENDS / (f * t[-1])
    weight = tukey(x.size, min(rise, 1.0)) / np.interp(t, windows.time, windows.noise)
    near = BSpline.design_matrix(np.clip(windows.time, 0.0, t[-1]), knots, 3).toarray()
    smooth = 1e-6 * np.diff(np.eye(near.shape[1]), 2, axis=0)  # where there are few windows
    both = np.vstack([near, smooth])
    wanted = np.zeros((len(both), 2))
    wanted[: len(near)] = np.transpose([windows.log_amplitude, windows.phase])
    k = np.linalg.lstsq(both, wanted, rcond=None)[0].T
    count = k.shape[1]
    # Most iterations of a fit.
    for _ in range(30):
        wave = np.exp(B @ k[0] + 1j * (B @ k[1]))
        left = x - wave.real
        parts = (weight * wave.real)[:, np.newaxis], (-weight * wave.imag)[:, np.newaxis]
        J = sparse.hstack([B.multiply(part) for part in parts], format="csr")
        normal = (J.T @ J).toarray()
        try:
            factor = linalg.cho_factor(normal)
        except linalg.LinAlgError:
            return None
        change = linalg.cho_solve(factor, J.T @ (weight * left))
        if not np.isfinite(change).all():
            return None
        k = k + (change / max(1.0, np.abs(change).max())).reshape(2, count)
        noise = _noise(weight * left, step, f)
        inverse = linalg.cho_solve(factor, np.eye(2 * count))
        # Change of the exponents, over their standard deviations, at which a fit has converged.
        if np.all(np.abs(change) <= 1e-2 * np.sqrt(noise * np.diag(inverse)) + 1e-10):
            break
    else:
        return None
    return _Fit(knots, k, inverse, _squares(weight * left, step, f), noise)


def _values(fit: _Fit, t: FloatArray, derivatives: int) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Values of a fit at some times, (k,) each, with their variances.

    They are the logarithm of the "amplitude", the "decay" (1/s) and the angular frequency, "rate"
    (rad/s).
    """
    splines = BSpline(fit.knots, np.eye(fit.coefficients.shape[1]), 3)
    value, slope, bend = (splines(t, order) for order in range(3))
    (a, p), none = fit.coefficients, np.zeros_like(value)
    rate = np.asarray(slope @ p)

    def variance(*rows: FloatArray) -> FloatArray:
        """Of linear functions of the coefficients."""
        both = np.hstack(rows)
        return np.asarray(fit.noise * np.einsum("ij,jk,ik->i", both, fit.covariance, both))

    decay = -(slope @ a) + derivatives * (bend @ p) / rate
    return {
        "amplitude": (value @ a, variance(value, none)),
        "decay": (decay, variance(-slope, derivatives * bend / rate[:, np.newaxis])),
        "rate": (rate, variance(none, slope)),
    }


def _curve(begin: float, fit: _Fit, next_fit: _Fit, derivatives: int) -> DampingCurve:
    """Curve of a fit of a derivative of the displacement, from the time ``begin``, s."""
    pieces = fit.knots.size - 7
    fine = np.linspace(0.0, fit.knots[-1], 400 * pieces)
    inside = np.linspace(_INSIDE, 1.0 - _INSIDE, pieces + 2)
    t = _fallen(fine, BSpline(fit.knots, fit.coefficients[0], 3)(fine), inside)
    ours, richer = (_values(each, t, derivatives) for each in (fit, next_fit))
    # Standard deviations with all that the next fit changes, of which a part is noise. Without that
    # part 73 % of the intervals held at the first level, where too few pieces err most.
    errors = {
        name: np.sqrt(variance + (richer[name][0] - value) ** 2)
        for name, (value, variance) in ours.items()
    }
    (logarithm, _), (decay, _), (rate, _) = ours.values()
    omega, amplitude = np.hypot(rate, decay), np.exp(logarithm)
    return DampingCurve(
        time=begin + t,
        amplitude=amplitude,
        frequency=omega / (2.0 * np.pi),
        damping_ratio=decay / omega,
        amplitude_error=amplitude * errors["amplitude"],
        frequency_error=errors["rate"] / (2.0 * np.pi),
        damping_error=errors["decay"] / omega,
        pieces=pieces,
        noise=float(np.sqrt(fit.noise)),
    )
