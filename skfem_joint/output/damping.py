"""Tables and pictures of steady vibration: damping against amplitude, response over frequency."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.analysis.history import QUANTITIES
from skfem_joint.analysis.response import HARMONICS
from skfem_joint.files import safe_name
from skfem_joint.output.folder import SUMMARY
from skfem_joint.output.plots import new_figure, prefixed_unit, save_figure
from skfem_joint.output.report import write_csv, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from skfem_joint.analysis.backbone import Backbone, RingDown, SceneBackbone
    from skfem_joint.analysis.response import Curve, SceneResponse

_COLOURS = ("#1f5fa8", "#a33b00", "#2e7d32", "#8d5fb0", "#1a1a1a", "#b8860b")
_LINES = {"full": "-", "reduced": "--"}


def write_backbone(folder: Path, found: SceneBackbone) -> list[Path]:
    """Write ``backbone.csv``, ``backbone.png`` and ``summary.json``."""
    points, curves, downs = found.scene.system().points, found.curves, found.ring_downs
    lengths = [[found.active_lengths(slip) for slip in curve.slip] for curve in curves]
    joints = list(lengths[0][0])
    header = [
        "mode", "level", "modal_amplitude", "frequency_Hz", "damping_ratio",
        *(f"displacement_{safe_name(point)}_m" for point in points),
        "slipping_share", "friction_damping_ratio", "viscous_damping_ratio", "state",
        *(f"active_length_{safe_name(joint)}_m" for joint in joints),
    ]  # fmt: skip
    rows = [
        [
            c.mode, c.level[k] / c.slips_at, c.amplitude[k], c.frequency[k], c.damping_ratio[k],
            *c.displacement[k], c.share[k], c.friction_damping[k], c.viscous_damping[k],
            c.state[k], *length[k].values(),
        ]
        for c, length in zip(curves, lengths, strict=True)
        for k in range(c.level.size)
    ]  # fmt: skip
    files = [_table(folder / "backbone.csv", header, rows)]
    files.append(save_figure(folder / "backbone.png", backbone_figure(curves, points, downs)))
    content = {
        "modes": [
            {
                "mode": c.mode,
                "stuck_frequency_Hz": c.stuck_frequency,
                "slips_as_a_whole_at": c.slips_at,
                "masing_error": c.masing_error,
                "largest_damping_ratio": float(c.damping_ratio.max()),
                "lowest_frequency_Hz": float(c.frequency.min()),
                "ring_down_friction_work_J": None if d is None else d.friction_work.tolist(),
            }
            for c, d in zip(curves, downs, strict=True)
        ],
        "warnings": found.warnings,
    }
    return [*files, _summary(folder, content, files)]


def backbone_figure(
    curves: Sequence[Backbone], points: Sequence[str], downs: Sequence[RingDown | None]
) -> Figure:
    """Frequency and damping over the displacement of the point that moves most, for each mode."""
    figure = new_figure(7.5, 3.2 * len(curves))
    panels = figure.subplots(len(curves), 2, squeeze=False)
    for row, curve, down in zip(panels, curves, downs, strict=True):
        x, label, scale = curve.amplitude, "modal amplitude, m·√kg", 1.0
        if points:
            most = int(curve.displacement[-1].argmax())
            x = curve.displacement[:, most]
            unit, scale = prefixed_unit("m", [x])
            label = f"displacement of {points[most]}, {unit}"
        gross = np.array([state == "gross" for state in curve.state])
        for panel, y, name in (
            (row[0], curve.frequency, "frequency, Hz"),
            (row[1], 100.0 * curve.damping_ratio, "damping ratio, %"),
        ):
            panel.semilogx(x / scale, y, color=_COLOURS[0], label="quasi-static")
            panel.plot(x[gross] / scale, y[gross], "s", color=_COLOURS[1], label="gross slip")
            if down is not None:
                at = np.interp(down.amplitude, curve.amplitude, x) / scale
                seen = down.amplitude >= curve.amplitude[0]
                free = down.frequency if panel is row[0] else 100.0 * down.damping_ratio
                panel.plot(at[seen], free[seen], ".", color=_COLOURS[4], label="ring-down")
            panel.set(xlabel=label, ylabel=name)
            _plain_ticks(panel.xaxis)
            panel.grid(alpha=0.3)
        row[0].axhline(curve.stuck_frequency, color="#888888", linestyle=":", label="stuck")
        row[0].set_title(f"mode {curve.mode}", loc="left")
        handles, labels = row[0].get_legend_handles_labels()
        kept = [k for k, one in enumerate(labels) if one != "gross slip" or gross.any()]
        row[0].legend([handles[k] for k in kept], [labels[k] for k in kept], fontsize="small")
    return figure


def write_response(folder: Path, found: SceneResponse) -> list[Path]:
    """Write ``response.csv``, ``response.png`` and ``summary.json``."""
    points = found.scene.system().points
    names = [safe_name(point) for point in points]
    header = ["model", "level", "frequency_Hz", "converged"]
    header += [f"amplitude_{n}_m" for n in names] + [f"phase_{n}_rad" for n in names]
    header += [f"offset_{n}_m" for n in names]
    header += [f"harmonic_{k + 1}_{n}_m" for n in names for k in range(HARMONICS)]
    header += ["friction_energy_J", "input_energy_J"]
    header += ["largest_slip_m", "slipping_share", "periods", "residual"]
    rows = [
        [
            model.name, curve.level, p.frequency, p.failure is None, *p.amplitude, *p.phase,
            *p.offset, *np.abs(p.harmonics).ravel(), p.friction_energy, p.input_energy,
            p.slip.max(initial=0.0), p.share, p.periods, p.change,
        ]
        for model in found.models
        for curve in model.curves
        for p in curve.points
    ]  # fmt: skip
    files = [_table(folder / "response.csv", header, rows)]
    files.append(save_figure(folder / "response.png", response_figure(found)))
    content = {
        "models": {
            model.name: {
                "offline_s": model.offline_s,
                "wall_s": model.wall_s,
                "levels": [
                    _level(curve, points, None if not model.estimates else model.estimates[k])
                    for k, curve in enumerate(model.curves)
                ],
            }
            for model in found.models
        },
        "warnings": found.warnings,
    }
    return [*files, _summary(folder, content, files)]


def _level(curve: Curve, points: Sequence[str], estimate: Any) -> dict[str, Any]:
    frequency, amplitude = curve.peak
    return {
        "level": curve.level,
        "point": points[curve.largest],
        "peak_frequency_Hz": frequency,
        "peak_amplitude_m": amplitude,
        "frequencies": len(curve.points),
        "periods": int(curve.column("periods").sum()),
        "failed_Hz": [p.frequency for p in curve.points if p.failure is not None],
        "estimated_error": estimate
        and {quantity: estimate.of("total", quantity) for quantity in QUANTITIES},
    }


def response_figure(found: SceneResponse) -> Figure:
    """Amplitude over load and phase of the point that moves most, with the linear limits."""
    points, most = found.scene.system().points, found.models[0].largest
    figure = new_figure(7.5, 6.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    columns = [c.column("amplitude")[:, most] / c.level for m in found.models for c in m.curves]
    unit, scale = prefixed_unit("m", [np.nan_to_num(column) for column in columns])
    for name, limit, line in (("stuck", found.stuck, ":"), ("free", found.free, "-.")):
        upper.semilogy(
            found.frequencies, limit[:, most] / scale, line, color="#888888", label=f"{name} joint"
        )
    for model in found.models:
        for curve, colour in zip(model.curves, _COLOURS * len(model.curves), strict=False):
            f, line = curve.column("frequency"), _LINES[model.name]
            label = f"{model.name}, level {curve.level:g}"
            y = curve.column("amplitude")[:, most] / curve.level / scale
            upper.semilogy(f, y, line, color=colour, label=label)
            phase = np.degrees(np.unwrap(np.nan_to_num(curve.column("phase")[:, most])))
            lower.plot(f, phase, line, color=colour)
    upper.set(ylabel=f"amplitude over level, {unit}", xmargin=0.0)
    upper.set_title(points[most], loc="left")
    upper.legend(fontsize="small", ncols=2)
    lower.set(xlabel="frequency, Hz", ylabel="phase, degrees")
    _plain_ticks(upper.yaxis)
    for panel in (upper, lower):
        panel.grid(alpha=0.3)
    return figure


def _plain_ticks(axis: Any) -> None:
    """Label 1, 2 and 5 of each decade of a logarithmic axis, in plain numbers."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_locator(NullLocator())


def _table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
    write_csv(path, [header, *([_plain(value) for value in row] for row in rows)])
    return path


def _plain(value: Any) -> Any:
    """Numbers with ten digits; nothing for what is not known."""
    if isinstance(value, float | np.floating):
        return f"{value:.10g}" if np.isfinite(value) else ""
    return "" if value is None else value


def _summary(folder: Path, content: dict[str, Any], files: Sequence[Path]) -> Path:
    write_json(folder / SUMMARY, content | {"files": [file.name for file in files]})
    return folder / SUMMARY
