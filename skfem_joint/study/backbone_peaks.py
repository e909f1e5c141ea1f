"""Peaks of a response beside the backbone of the mode that they belong to.

A backbone (:mod:`skfem_joint.vibration.backbone`) says at which frequency a mode vibrates freely
with an amplitude; the peaks of steady vibration must lie on it, as far as the motion is that of one
mode with one harmonic. Each peak is compared with the backbone at the peak's own amplitude, and
both state an error.

A peak is the vertex of the parabola through the amplitudes A of the three highest points. The error
of its frequency is its distance from the vertex of one through 1 / A^2, which is exact for a single
degree of freedom, or a third of that from one through points further away, if that is larger. The
error of its amplitude is estimated with the response.

The error of a backbone's frequency has two parts. The curve takes the ratio of force and
displacement at the peak, omega^2 = alpha / q; with the loop of Masing's rule the first harmonic of
the force is

    omega_1^2 = 2 / (pi q) int_0^pi F(q cos t) cos t dt,   F(x) = alpha(q) - 2 alpha((q - x) / 2),

which agrees with the ratio as long as alpha is a parabola in q. The relative difference of both
frequencies is the error by the one value at the peak. The amplitude of a driven vibration of the
damping ratio zeta is largest at omega (1 - zeta^2) and not at omega, which is the other one. Twice
their sum is stated: higher modes take part by as much even where they are far from odd multiples.
(A bar with a tip mass, whose modes lie at 1 : 4.7 : 8.9, was off by up to 1.8 times the sum.)
Where a higher frequency lies near an odd multiple, friction excites it, and the peaks leave the
backbone by more than both errors. (Modes of a bar at 1 : 3 : 5: by 0.2 to 1 %, some twenty times
the sum.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.results.peaks import parabola_vertex
from skfem_joint.study.scene_response import SceneResponse
from skfem_joint.vibration.backbone import Backbone
from skfem_joint.vibration.response_curve import Curve

#: Instants of half a period at which the force of a loop is evaluated.
_INSTANTS = 201
#: Factor of both parts of a backbone's error, for higher modes that take part a little.
_OTHER_MODES = 2.0


@dataclass(frozen=True)
class BackbonePeak:
    """The peak of a response at one level, and the backbone at its amplitude.

    Attributes
    ----------
    model : str
        Name of the model whose response it is.
    level : float
        Factor of the loads' amplitudes.
    mode : int
        Number of the mode whose backbone is nearest.
    frequency, amplitude : float
        Of the peak, Hz and m.
    frequency_error, amplitude_error : float
        Estimated relative errors of both. The first is nan where the amplitude is largest at an end
        of the curve, which is no peak, the second where it is not known.
    backbone_frequency : float
        At this amplitude, Hz; nan beyond the highest level of the backbone.
    backbone_error : float
        Estimated relative error of that.
    slope : float
        Relative change of the backbone's frequency over that of the amplitude.
    """

    model: str
    level: float
    mode: int
    frequency: float
    amplitude: float
    frequency_error: float
    amplitude_error: float
    backbone_frequency: float
    backbone_error: float
    slope: float

    @property
    def at_end(self) -> bool:
        """Whether the largest amplitude is at an end of the frequencies, which is no peak."""
        return bool(np.isnan(self.frequency_error))

    @property
    def apart(self) -> float:
        """Relative distance of the peak from the backbone, nan beyond it."""
        return self.frequency / self.backbone_frequency - 1.0

    @property
    def error(self) -> float:
        """Sum of the errors of both, with that of the amplitude, if known, at which they meet."""
        by_amplitude = abs(self.slope) * float(np.nan_to_num(self.amplitude_error))
        return self.frequency_error + by_amplitude + self.backbone_error


def first_harmonic(curve: Backbone) -> FloatArray:
    """Frequencies of the first harmonic of the force, over those at its peak, (levels,)."""
    from scipy.interpolate import PchipInterpolator  # slow to load

    q, omega = curve.amplitude, 2.0 * np.pi * curve.stuck_frequency
    # The stiffness alpha / q, which is that of the stuck mode at no amplitude.
    stiffness = PchipInterpolator(np.r_[0.0, q], np.r_[omega**2, curve.level / q])
    angle = np.linspace(0.0, np.pi, _INSTANTS)
    x = 0.5 * q[:, np.newaxis] * (1.0 - np.cos(angle))
    force = curve.level[:, np.newaxis] - 2.0 * x * stiffness(x)
    first = (2.0 / np.pi) * np.trapezoid(force * np.cos(angle), angle, axis=1) / q
    return np.asarray(np.sqrt(np.maximum(first, 0.0) * q / curve.level))


def backbone_errors(curve: Backbone) -> FloatArray:
    """Estimated relative errors of a backbone's frequencies, (levels,)."""
    apart = np.abs(first_harmonic(curve) - 1.0)
    return np.asarray(_OTHER_MODES * (apart + curve.damping_ratio**2))


def _peak(curve: Curve) -> tuple[float, float, float]:
    """Frequency (Hz) and amplitude (m) of the peak, and the relative error of the frequency.

    The error is nan where the largest amplitude is at an end of the curve, which is no peak.
    """
    f, A = curve.known
    frequency, amplitude = curve.peak
    k = int(A.argmax())
    if not 0 < k < f.size - 1:
        return frequency, amplitude, np.nan
    other, _ = parabola_vertex(f[k - 1 : k + 2], A[k - 1 : k + 2] ** -2.0)
    error = abs(other / frequency - 1.0)
    if 1 < k < f.size - 2:
        # The error of a vertex is proportional to the square of the distance of the points.
        wide, _ = parabola_vertex(f[k - 2 : k + 3 : 2], A[k - 2 : k + 3 : 2])
        error = max(error, abs(wide / frequency - 1.0) / 3.0)
    return frequency, amplitude, float(error)


def backbone_peaks(response: SceneResponse) -> list[BackbonePeak]:
    """Peaks of a response beside its backbones; none without these.

    A peak belongs to the mode whose backbone is nearest in frequency. Curves of fewer than three
    points with an amplitude have no peak.
    """
    peaks, modes = [], response.backbones
    curves = ((model, *each) for model in response.models for each in enumerate(model.curves))
    for model, k, curve in curves if modes else ():
        f, A = curve.known
        if f.size < 3 or not A.any():
            continue
        frequency, amplitude, off = _peak(curve)
        mode = min(modes, key=lambda c: float(np.abs(c.frequency / frequency - 1.0).min()))
        known = model.estimates[k].of("total", "peak_displacement") if model.estimates else None
        where = model.name, curve.level, mode.mode, frequency, amplitude, off
        reading = _read(mode, curve.largest, amplitude)
        peaks.append(BackbonePeak(*where, np.nan if known is None else known, *reading))
    return peaks


def _read(curve: Backbone, point: int, amplitude: float) -> tuple[float, float, float]:
    """Frequency of a backbone at an amplitude of a named point, its error, and its slope."""
    x, f = np.abs(curve.displacement[:, point]), curve.frequency
    rising = np.r_[0.0, np.maximum.accumulate(x)]
    if not 0.0 < amplitude <= rising[-1]:
        return np.nan, np.nan, np.nan
    frequency = np.r_[curve.stuck_frequency, f]
    errors = np.r_[0.0, backbone_errors(curve)]
    here, error = (float(np.interp(amplitude, rising, y)) for y in (frequency, errors))
    two = np.minimum(amplitude * np.array([0.99, 1.01]), rising[-1])
    near = np.interp(two, rising, frequency)
    return here, error, float((near[1] - near[0]) / np.log(two[1] / two[0]) / here)
