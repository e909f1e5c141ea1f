"""Tables and pictures of steady vibration: damping against amplitude, response over frequency."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.analysis.backbone import Backbone
from skfem_joint.analysis.backbone_peaks import backbone_peaks
from skfem_joint.analysis.history import QUANTITIES
from skfem_joint.analysis.normal_force import NormalChange
from skfem_joint.analysis.response import HARMONICS, Curve
from skfem_joint.analysis.scene_backbone import ModelBackbone, SceneBackbone
from skfem_joint.analysis.scene_response import SceneResponse
from skfem_joint.arrays import FloatArray
from skfem_joint.files import safe_names
from skfem_joint.output.backbone_peaks import peak_lines, peak_rows, peaks_figure
from skfem_joint.output.plots import new_figure, plain_ticks, prefixed_unit, save_figure
from skfem_joint.output.record import writing
from skfem_joint.output.tables import plain, write_csv
from skfem_joint.reduction.active_length import measured_lengths
from skfem_joint.structure import AnyStructure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = Sequence[Sequence[Any]]

_COLOURS = ("#1f5fa8", "#a33b00", "#2e7d32", "#8d5fb0", "#1a1a1a", "#b8860b")
_LINES = {"full": "-", "condensed": ":", "reduced": "--"}
#: Columns of a backbone with contact that opens.
_OPENING = ("modal_offset", "opened_share")
_DOTS = {"full": ".", "condensed": "+", "reduced": "x"}


def write_backbone(folder: Path, backbone: SceneBackbone) -> list[Path]:
    """Write ``backbone.csv``, ``ring_down.csv`` if asked for, ``backbone.png``, a summary."""
    points, structure = backbone.scene.system().points, backbone.scene.structure()
    curves = [c for model in backbone.models for c in model.curves]
    names, lengths = _active_lengths(structure, (slip for c in curves for slip in c.slip))
    opens = curves[0].opened is not None
    header = [
        "model", "mode", "level", "modal_amplitude", "frequency_Hz", "damping_ratio",
        *(f"displacement_{name}_m" for name in safe_names(points)),
        "slipping_share", "friction_damping_ratio", "viscous_damping_ratio", "state", "doubt",
        *(_OPENING if opens else ()), *names,
    ]  # fmt: skip
    rows = [
        [
            model.name, c.mode, c.level[k] / c.slips_at, c.amplitude[k], c.frequency[k],
            c.damping_ratio[k], *c.displacement[k], c.share[k], c.friction_damping[k],
            c.viscous_damping[k], c.state[k], c.doubts[k],
            *(() if c.offset is None or c.opened is None else (c.offset[k], c.opened[k])),
        ]
        for model in backbone.models
        for c in model.curves
        for k in range(c.level.size)
    ]  # fmt: skip
    rows = [[*row, *length] for row, length in zip(rows, lengths, strict=True)]
    tables: dict[str, Rows] = {"backbone.csv": [header, *rows]}
    if backbone.models[0].ring_downs:
        header = ["model", "mode", "time_s", "modal_amplitude", "frequency_Hz", "damping_ratio"]
        rows = [
            [model.name, c.mode, *row]
            for model in backbone.models
            for c, d in zip(model.curves, model.ring_downs, strict=True)
            for row in zip(d.time, d.amplitude, d.frequency, d.damping_ratio, strict=True)
        ]
        tables["ring_down.csv"] = [header, *rows]
    joints = [patch.joint.name for patch in structure.patches]
    changes = _normal_changes(backbone)
    content = {
        "models": {
            model.name: {
                "modes": [_mode(model, k, joints, changes) for k in range(len(model.curves))]
            }
            for model in backbone.models
        },
        "warnings": list(backbone.warnings),
    }
    figure = backbone_figure(backbone.models, backbone.largest)
    return _written({folder / "backbone.png": figure}, content, tables)


def backbone_lines(backbone: SceneBackbone) -> list[str]:
    """What is printed of damping against amplitude: the ends of each curve, and largest errors."""
    lines = []
    for model in backbone.models:
        for curve in model.curves:
            f, ratio, state = curve.frequency, 100.0 * curve.damping_ratio, curve.state
            lines.append(
                f"{model.name} model, mode {curve.mode}: {f[0]:.6g} to {f[-1]:.6g} Hz (stuck "
                f"{curve.stuck_frequency:.6g} Hz), damping {ratio[0]:.3g} to {ratio[-1]:.3g} %, "
                f"{state[0]} to {state[-1]} slip.{_opened(curve)}{_doubtful(curve)}"
            )
        if model.name != "full":
            worst = {k: 100.0 * max(e[k] for e in model.errors) for k in model.errors[0]}
            lines.append(
                f"It errs by {worst['frequency']:.2g} % in frequency and by "
                f"{worst['damping_ratio']:.2g} % in damping at most."
            )
    lines += [
        f"Mode {mode} at its highest level changes the normal force by {change.text}. "
        f"{change.of_the_mesh}"
        for mode, change in _normal_changes(backbone).items()
    ]
    return lines


def _doubtful(curve: Backbone) -> str:
    """Sentence about the levels of a curve not to rely on, and why; empty if there are none."""
    doubts = curve.doubts
    parts = [
        f"{sum(reason in doubt for doubt in doubts)} of {len(doubts)} levels: {reason}"
        for reason in ("whole slip", "ring-down differs")
        if any(reason in doubt for doubt in doubts)
    ]
    return f" Not to be relied on: {'; '.join(parts)}." if parts else ""


def _opened(curve: Backbone) -> str:
    """Sentence about contact that opens along a curve, and the errors of its cycles, if it can."""
    if curve.opened is None:
        return ""
    errors = " and ".join(
        f"{100.0 * error:.2g} % in {name.removesuffix('_ratio')}"
        for name, error in curve.estimated.items()
    )
    return (
        f" Up to {100.0 * curve.opened.max():.3g} % of what is pressed at rest opens; the cycles "
        f"err by an estimated {errors}."
    )


def _active_lengths(
    structure: AnyStructure, slips: Iterable[FloatArray]
) -> tuple[list[str], list[list[float]]]:
    """Names of columns of active lengths, and a row of lengths (m) for each slip of all points (m).

    Only joints with an axis have a column. A slip that is not known gives a row of NaN.
    """
    lengths = [None if np.isnan(x).any() else measured_lengths(structure, x) for x in slips]
    joints = list(next(known for known in lengths if known is not None))
    rows = [[np.nan] * len(joints) if x is None else list(x.values()) for x in lengths]
    return [f"active_length_{name}_m" for name in safe_names(joints)], rows


def _normal_changes(backbone: SceneBackbone) -> dict[int, NormalChange]:
    """Change of the normal force at the highest level of each mode, where a contact is closed."""
    curves = backbone.models[0].curves
    pairs = zip(curves, backbone.normal, strict=False)
    return {curve.mode: change for curve, change in pairs if change is not None}


def _mode(
    model: ModelBackbone, k: int, joints: Sequence[str], changes: Mapping[int, NormalChange]
) -> dict[str, Any]:
    c = model.curves[k]
    content: dict[str, Any] = {
        "mode": c.mode,
        "unknowns": c.states.shape[1],
        "stuck_frequency_Hz": c.stuck_frequency,
        "slips_as_a_whole_at": c.slips_at,
        "masing_error": c.masing_error,
        "largest_damping_ratio": float(c.damping_ratio.max()),
        "lowest_frequency_Hz": float(c.frequency.min()),
    }
    if c.estimated:
        content["estimated_error"] = dict(c.estimated)
    if c.opened is not None:
        content["opened_share"] = float(c.opened.max())
    if c.mode in changes:
        content["normal_force_change"] = changes[c.mode].share
    if model.name != "full":
        content["error"] = model.errors[k]
    for d in model.ring_downs[k : k + 1]:
        work = dict(zip(joints, d.friction_work[-1].tolist(), strict=True))
        content |= {"ring_down_energy_J": d.energy[0], "ring_down_friction_energy_J": work}
        content["ring_down_step_error"] = d.step_error
        content["ring_down_impact_energy_J"] = d.impact_work
    return content


def backbone_figure(models: Sequence[ModelBackbone], largest: Sequence[float] = ()) -> Figure:
    """Frequency and damping over the amplitude of each mode.

    ``largest`` is, for each mode, the displacement (m) of the node that it moves most at a modal
    amplitude of 1 m kg^1/2: the amplitude is then drawn as this node's displacement. Without it the
    modal amplitude is drawn, which grows with the load even where a named point does not.
    """
    first = models[0].curves
    figure = new_figure(7.5, 3.3 * len(first))
    panels = figure.subplots(len(first), 2, squeeze=False)
    for k, (row, curve) in enumerate(zip(panels, first, strict=True)):
        label, scale = "modal amplitude, m·√kg", 1.0
        if largest:
            unit, size = prefixed_unit("m", [largest[k] * curve.amplitude])
            label, scale = f"amplitude where the mode\nmoves most, {unit}", size / largest[k]
        for model, colour in zip(models, _COLOURS, strict=False):
            c, down = model.curves[k], [*model.ring_downs[k : k + 1]]
            x = c.amplitude / scale
            gross = np.array([state == "gross" for state in c.state])
            for panel, name in ((row[0], "frequency"), (row[1], "damping_ratio")):
                factor = 1.0 if panel is row[0] else 100.0
                y, how = factor * getattr(c, name), {"color": colour}
                panel.semilogx(x, y, _LINES[model.name], label=f"{model.name} model", **how)
                if gross.any():
                    label = "gross slip: not to be relied on"
                    panel.plot(x[gross], y[gross], "s", label=label, **how)
                if c.differs is not None and c.differs.any():
                    ring = {"markerfacecolor": "none", "markersize": 9} | how
                    label = "ring-down differs"
                    panel.plot(x[c.differs], y[c.differs], "o", label=label, **ring)
                for d in down:
                    drawn = d.amplitude >= c.amplitude[0]
                    at = d.amplitude[drawn] / scale
                    free = factor * getattr(d, name)[drawn]
                    panel.plot(
                        at, free, _DOTS[model.name], label=f"{model.name} model's ring-down", **how
                    )
        row[0].set(xlabel=label, ylabel="frequency, Hz")
        row[1].set(xlabel=label, ylabel="damping ratio, %")
        row[0].axhline(curve.stuck_frequency, color="#888888", linestyle=":", label="stuck")
        row[0].set_title(f"mode {curve.mode}", loc="left")
        row[0].legend(fontsize="small")
        for panel in row:
            plain_ticks(panel.xaxis)
            panel.grid(alpha=0.3)
    return figure


def write_response(
    folder: Path, response: SceneResponse, backbones: Sequence[Backbone] = ()
) -> list[Path]:
    """Write ``response.csv``, ``response.png`` and ``summary.json``.

    With ``backbones`` also ``peaks.csv`` and ``backbone_response.png``, which compare the peaks.
    """
    points, structure = response.scene.system().points, response.scene.structure()
    names = safe_names(points)
    every = [p for model in response.models for curve in model.curves for p in curve.points]
    joints, lengths = _active_lengths(structure, (p.slip for p in every))
    header = ["model", "level", "frequency_Hz", "converged"]
    header += [f"amplitude_{n}_m" for n in names] + [f"phase_{n}_rad" for n in names]
    header += [f"offset_{n}_m" for n in names]
    header += [f"harmonic_{k + 1}_{n}_m" for n in names for k in range(HARMONICS)]
    header += ["friction_energy_J", "input_energy_J"]
    header += ["largest_slip_m", "slipping_share", "periods", "residual"]
    served = any(np.isfinite(p.model_error) for p in every)  # by a model for a range
    header += ["step_error", *(["model_error"] if served else []), *joints]
    rows = [
        [
            model.name, curve.level, p.frequency, p.failure is None, *p.amplitude, *p.phase,
            *p.offset, *np.abs(p.harmonics).ravel(), p.friction_energy, p.input_energy,
            p.slip.max(initial=0.0), p.share, p.periods, p.change, p.step_error,
            *([p.model_error] if served else []),
        ]
        for model in response.models
        for curve in model.curves
        for p in curve.points
    ]  # fmt: skip
    rows = [[*row, *length] for row, length in zip(rows, lengths, strict=True)]
    content = {
        "models": {
            model.name: {
                "offline_s": model.offline_s,
                "compilation_s": model.compilation_s,
                "wall_s": model.wall_s,
                "levels": [
                    _level(curve, points, None if not model.estimates else model.estimates[k])
                    for k, curve in enumerate(model.curves)
                ],
            }
            for model in response.models
        },
        "warnings": list(response.warnings),
    }
    tables: dict[str, Rows] = {"response.csv": [header, *rows]}
    pictures = {folder / "response.png": response_figure(response)}
    if backbones:
        peaks = backbone_peaks(response.models, backbones)
        tables["peaks.csv"] = peak_rows(peaks)
        pictures[folder / "backbone_response.png"] = peaks_figure(response, backbones, peaks)
    return _written(pictures, content, tables)


def response_lines(response: SceneResponse, backbones: Sequence[Backbone] = ()) -> list[str]:
    """What is printed of steady vibration: the peak of each curve, and its place on a backbone."""
    lines = [
        f"{model.name} model, level {curve.level:g}: peak {1e3 * curve.peak[1]:.5g} mm at "
        f"{curve.peak[0]:.6g} Hz, {len(curve.points)} frequencies."
        for model in response.models
        for curve in model.curves
    ]
    return [*lines, *peak_lines(backbone_peaks(response.models, backbones))] if backbones else lines


def _level(curve: Curve, points: Sequence[str], estimate: Any) -> dict[str, Any]:
    (frequency, amplitude), error = curve.peak, curve.column("step_error")
    return {
        "level": curve.level,
        "point": points[curve.largest],
        "peak_frequency_Hz": frequency,
        "peak_amplitude_m": amplitude,
        "frequencies": len(curve.points),
        "periods": int(curve.column("periods").sum()),
        "largest_step_error": None if np.isnan(error).all() else float(np.nanmax(error)),
        "slips_as_a_whole_Hz": curve.gross.tolist(),
        "failed_Hz": [p.frequency for p in curve.points if p.failure is not None],
        "estimated_error": estimate
        and {quantity: estimate.of("total", quantity) for quantity in QUANTITIES},
    }


def response_figure(response: SceneResponse) -> Figure:
    """Amplitude over load level, and phase, of the point that moves most.

    The linear structures with stuck and with loose joints are drawn beside them.
    """
    points, most = response.scene.system().points, response.models[0].largest
    figure = new_figure(7.5, 6.0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    columns = [c.column("amplitude")[:, most] / c.level for m in response.models for c in m.curves]
    unit, scale = prefixed_unit("m", [np.nan_to_num(column) for column in columns])
    for name, limit, line in (("stuck", response.stuck, ":"), ("loose", response.loose, "-.")):
        upper.semilogy(
            response.linear_frequencies,
            limit[:, most] / scale,
            line,
            color="#888888",
            label=f"{name} joint",
        )
    for model in response.models:
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
    plain_ticks(upper.yaxis)
    for panel in (upper, lower):
        panel.grid(alpha=0.3)
    return figure


def _written(
    pictures: Mapping[Path, Figure], content: dict[str, Any], tables: Mapping[str, Rows]
) -> list[Path]:
    """Write a summary, tables whose first rows are their headings, and pictures in one folder."""
    folder = next(iter(pictures)).parent
    with writing(folder, content) as summary:
        for name, rows in tables.items():
            write_csv(folder / name, ([plain(value) for value in row] for row in rows))
        for picture, figure in pictures.items():
            save_figure(picture, figure)
    return [*(folder / name for name in tables), *pictures, summary]
