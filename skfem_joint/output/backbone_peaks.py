"""Picture, table and sentences of a response whose peaks are compared with a backbone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.output.plots import new_panels, plain_ticks, prefixed_unit
from skfem_joint.study.backbone_peaks import BackbonePeak, backbone_errors
from skfem_joint.study.scene_response import SceneResponse
from skfem_joint.vibration.response_curve import Curve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Look of curves: a colour for each level, a line and a mark for each model.
COLOURS = ("#1f5fa8", "#a33b00", "#2e7d32", "#8d5fb0", "#1a1a1a", "#b8860b")
LINES = {"full": "-", "condensed": ":", "reduced": "--"}
_MARKS = {"full": "o", "condensed": "s", "reduced": "x"}
#: Columns of ``peaks.csv``, and the attributes of a peak that stand there.
_COLUMNS = {
    "model": "model", "level": "level", "mode": "mode", "peak_frequency_Hz": "frequency",
    "peak_frequency_error": "frequency_error", "peak_amplitude_m": "amplitude",
    "peak_amplitude_error": "amplitude_error", "backbone_frequency_Hz": "backbone_frequency",
    "backbone_frequency_error": "backbone_error", "apart": "apart", "error_of_both": "error",
}  # fmt: skip


def peak_columns(peaks: Sequence[BackbonePeak]) -> dict[str, list[Any]]:
    """Columns of ``peaks.csv``."""
    return {column: [getattr(p, name) for p in peaks] for column, name in _COLUMNS.items()}


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


def peaks_figure(response: SceneResponse, peaks: Sequence[BackbonePeak]) -> Figure:
    """Amplitude over frequency at each level, its peaks, and the backbones, with their errors."""
    figure, (panel,) = new_panels(7.5, 5.0)
    most = response.models[0].largest
    drawn = drawn_curves(response)
    unit, scale = prefixed_unit("m", [np.nan_to_num(column) for _, column, _ in drawn])
    for curve, column, look in drawn:
        panel.semilogy(curve.column("frequency"), column / scale, **look)
    low, high = response.frequencies[[0, -1]]
    least = min(float(np.nanmin(column)) for _, column, _ in drawn) / scale
    for mode in response.backbones:
        f, error = np.r_[mode.stuck_frequency, mode.frequency], np.r_[0.0, backbone_errors(mode)]
        if f.max() < low or f.min() > high:
            continue
        moved = np.maximum.accumulate(np.abs(mode.displacement[:, most])) / scale
        y = np.geomspace(min(least, moved[0]), moved[-1], 200)
        f, error = (np.interp(y, np.r_[0.0, moved], values) for values in (f, error))
        panel.plot(f, y, color="#444444", label=f"backbone of mode {mode.mode}")
        panel.fill_betweenx(y, f * (1.0 - error), f * (1.0 + error), color="#999999", alpha=0.4)
    for name, mark in _MARKS.items():
        own = [p for p in peaks if p.model == name and not p.at_end]
        if own:
            names = "frequency", "amplitude", "frequency_error", "amplitude_error"
            f, A, of_f, of_A = (np.array([getattr(p, of) for p in own]) for of in names)
            panel.errorbar(
                f, A / scale, A * np.nan_to_num(of_A) / scale, f * of_f,
                fmt=mark, color="#c2185b", capsize=3, markersize=5, markerfacecolor="none",
                label=f"peaks, {name} model",
            )  # fmt: skip
    panel.set(xlabel="frequency, Hz", ylabel=f"amplitude, {unit}")
    panel.set_xlim(low, high)
    plain_ticks(panel.yaxis)
    panel.set_title(response.scene.system().points[most], loc="left")
    panel.legend(fontsize="small")
    return figure


def drawn_curves(response: SceneResponse) -> list[tuple[Curve, FloatArray, dict[str, Any]]]:
    """Curves of all models, with the amplitude (m) of the point that moves most in the first one.

    Also the colour, line and label of each.
    """
    drawn, most = [], response.models[0].largest
    for model in response.models:
        for curve, colour in zip(model.curves, cycle(COLOURS), strict=False):
            label = f"{model.name}, level {curve.level:g}"
            look = {"color": colour, "ls": LINES[model.name], "label": label}
            drawn.append((curve, curve.column("amplitude")[:, most], look))
    return drawn
