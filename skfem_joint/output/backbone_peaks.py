"""Picture, table and sentences of a response whose peaks are compared with a backbone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.analysis.backbone import Backbone
from skfem_joint.analysis.backbone_peaks import BackbonePeak, backbone_errors
from skfem_joint.analysis.scene_response import SceneResponse
from skfem_joint.output.plots import new_figure, prefixed_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_COLOURS = ("#1f5fa8", "#a33b00", "#2e7d32", "#8d5fb0", "#1a1a1a", "#b8860b")
_LINES = {"full": "-", "condensed": ":", "reduced": "--"}
_MARKS = {"full": "o", "condensed": "s", "reduced": "x"}


#: Columns of ``peaks.csv`` and what they hold of a peak.
_COLUMNS = {
    "model": "model",
    "level": "level",
    "mode": "mode",
    "peak_frequency_Hz": "frequency",
    "peak_frequency_error": "frequency_error",
    "peak_amplitude_m": "amplitude",
    "peak_amplitude_error": "amplitude_error",
    "backbone_frequency_Hz": "backbone_frequency",
    "backbone_frequency_error": "backbone_error",
    "apart": "apart",
    "error_of_both": "error",
}


def peak_rows(peaks: Sequence[BackbonePeak]) -> list[list[Any]]:
    """Rows of ``peaks.csv``, the first of which is its heading."""
    return [[*_COLUMNS], *([getattr(p, name) for name in _COLUMNS.values()] for p in peaks)]


def peak_lines(peaks: Sequence[BackbonePeak]) -> list[str]:
    """What is printed: how far each peak is from the backbone, and whether the errors say so."""
    lines = []
    for p in peaks:
        where = f"Peak of the {p.model} model at level {p.level:g}"
        if p.at_end:
            lines.append(
                f"{where}: none between its frequencies, the amplitude is largest at "
                f"{p.frequency:.6g} Hz, an end of them; widen response.frequencies."
            )
            continue
        if np.isnan(p.backbone_frequency):
            lines.append(f"{where}: beyond the backbone of mode {p.mode}; raise backbone.up_to.")
            continue
        unknown = np.isnan(p.amplitude_error)
        within = "within" if abs(p.apart) <= p.error else "more than"
        lines.append(
            f"{where}: {100.0 * p.apart:+.2g} % off the backbone of mode {p.mode} in frequency, "
            f"{within} the {100.0 * p.error:.2g} % that both state"
            + (" without the amplitude's error, which is not known." if unknown else ".")
        )
    if any(abs(p.apart) > p.error for p in peaks if not p.at_end):
        lines.append(
            "Where a peak is off by more, the vibration is not that of one mode: higher "
            "frequencies near odd multiples take part, or another mode is near."
        )
    return lines


def peaks_figure(
    response: SceneResponse, curves: Sequence[Backbone], peaks: Sequence[BackbonePeak]
) -> Figure:
    """Amplitude over frequency at each level, its peaks, and the backbones, with their errors."""
    points, most = response.scene.system().points, response.models[0].largest
    figure = new_figure(7.5, 5.0)
    panel = figure.subplots()
    columns = [c.column("amplitude")[:, most] for m in response.models for c in m.curves]
    unit, scale = prefixed_unit("m", [np.nan_to_num(column) for column in columns])
    for model in response.models:
        for curve, colour in zip(model.curves, _COLOURS * len(model.curves), strict=False):
            x, y = curve.column("frequency"), curve.column("amplitude")[:, most] / scale
            label = f"{model.name}, level {curve.level:g}"
            panel.semilogy(x, y, _LINES[model.name], color=colour, label=label)
    low, high = response.frequencies[[0, -1]]
    least = min(float(np.nanmin(column)) for column in columns) / scale
    for mode in curves:
        f, error = np.r_[mode.stuck_frequency, mode.frequency], np.r_[0.0, backbone_errors(mode)]
        if f.max() < low or f.min() > high:
            continue
        moved = np.maximum.accumulate(np.abs(mode.displacement[:, most])) / scale
        y = np.geomspace(min(least, moved[0]), moved[-1], 200)
        f, error = (np.interp(y, np.r_[0.0, moved], values) for values in (f, error))
        panel.plot(f, y, color="#444444", label=f"backbone of mode {mode.mode}")
        panel.fill_betweenx(y, f * (1.0 - error), f * (1.0 + error), color="#999999", alpha=0.4)
    for p in (p for p in peaks if not p.at_end):
        panel.errorbar(
            p.frequency,
            p.amplitude / scale,
            xerr=p.frequency * p.frequency_error,
            yerr=p.amplitude * np.nan_to_num(p.amplitude_error) / scale,
            fmt=_MARKS[p.model],
            color="#c2185b",
            capsize=3,
            markersize=5,
            markerfacecolor="none",
            label=f"peaks, {p.model} model" if p is _first(peaks, p.model) else None,
        )
    panel.set(xlabel="frequency, Hz", ylabel=f"amplitude, {unit}")
    panel.set_xlim(low, high)
    panel.set_title(points[most], loc="left")
    panel.legend(fontsize="small")
    panel.grid(alpha=0.3)
    return figure


def _first(peaks: Sequence[BackbonePeak], model: str) -> BackbonePeak:
    """First of the peaks of a model that are drawn."""
    return next(p for p in peaks if p.model == model and not p.at_end)
