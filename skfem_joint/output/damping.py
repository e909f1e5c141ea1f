"""Tables and pictures of vibration: damping against amplitude, response, random vibration."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.files import safe_names
from skfem_joint.ground.plain_values import spread
from skfem_joint.output import loss
from skfem_joint.output.backbone_peaks import (
    COLOURS,
    LINES,
    drawn_curves,
    peak_columns,
    peak_lines,
    peaks_figure,
)
from skfem_joint.output.drawing.shapes import shapes_figure
from skfem_joint.output.plots import new_panels, plain_ticks, prefixed_unit, save_figure
from skfem_joint.output.record import adding, writing
from skfem_joint.output.tables import Table, by_columns, write_table
from skfem_joint.output.universal import over_one_force, scene_uff
from skfem_joint.reduction.active_length import measured_lengths
from skfem_joint.results.history import QUANTITIES
from skfem_joint.results.loss import over
from skfem_joint.results.places import JointPlaces, PlaceResults, places_of
from skfem_joint.scene import Scene
from skfem_joint.structure.model import AnyStructure
from skfem_joint.structure.structure import Structure
from skfem_joint.study.backbone_peaks import backbone_peaks
from skfem_joint.study.description import made_of
from skfem_joint.study.premises import (
    OF_MODES,
    damping_given,
    premises,
    random_loads_of,
    response_loads,
)
from skfem_joint.study.scene_backbone import AtAmplitudes, ModelBackbone, SceneBackbone, SceneRandom
from skfem_joint.study.scene_response import ModelResponse, SceneResponse
from skfem_joint.vibration.backbone import Backbone
from skfem_joint.vibration.random_response import RandomResponse
from skfem_joint.vibration.response import HARMONICS
from skfem_joint.vibration.response_curve import KINDS, Curve, frequency_response

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DOTS = {"full": ".", "condensed": "+", "reduced": "x"}


def write_backbone(folder: Path, backbone: SceneBackbone) -> list[Path]:
    """Write ``backbone.csv``, ``backbone.png``, a summary, and what else is asked for."""
    structure, system = backbone.scene.structure(), backbone.scene.system()
    names, places = safe_names(system.points), places_of(structure, system)
    curves, asked, rung = [], [], []
    for model in backbone.models:
        for c in model.curves:
            by_place = places.of_curve(c.friction_work, c.slip)
            mesh = backbone.mesh.get(c.mode, {})
            curves.append(
                _of_curve(model.name, c, names, by_place)
                | {f"mesh_error_{name}": error for name, error in mesh.items()}
                | c.losses.columns()
                | loss.place_columns(by_place)
                | by_columns(_active_lengths(structure, slip) for slip in c.slip)
            )
        for at in model.at:
            c, normal = at.curve, backbone.normal.get(at.curve.mode)
            by_place = places.of_curve(c.friction_work, c.slip)
            asked.append(
                loss.asked_columns(at)
                | _of_curve(model.name, c, names, by_place)
                | c.losses.columns()
                | loss.error_columns(at)
                | loss.place_columns(by_place)
                | {"not_counted": [loss.not_counted(at, k, normal) for k in range(c.level.size)]}
            )
        rung += [
            {"model": model.name, "mode": c.mode, **down.table}
            for c, down in zip(model.curves, model.ring_downs, strict=False)
        ]
    every = {"backbone.csv": curves, "amplitudes.csv": asked, "ring_down.csv": rung}
    tables = {name: by_columns(parts) for name, parts in every.items() if parts}
    models = {
        model.name: {"modes": [_mode(backbone, model, k, places) for k in range(len(model.curves))]}
        for model in backbone.models
    }
    figures = {"backbone.png": backbone_figure(backbone.models, backbone.largest)}
    if isinstance(structure, Structure):
        titles = [shape.partition(", moves")[0] for shape in backbone.shapes]
        figures["shapes.png"] = shapes_figure(structure, backbone.moved, titles)
    scene, notes, first = backbone.scene, [*backbone.notes], backbone.models[0]
    if scene.output.uff and first.name != "full":
        notes.append("backbone.uff has stuck modes alone: shapes at levels are of the full model.")
    about = {"told": backbone_lines(backbone), "notes": notes, "acting": OF_MODES}
    files = written(folder, scene, models, tables, figures, **about)
    shapes = first.curves if first.name == "full" else []
    return [*files, *_uff(folder / "backbone.uff", scene, backbones=shapes)]


def _of_curve(
    model: str, c: Backbone, names: Sequence[str], by_place: PlaceResults
) -> dict[str, Any]:
    """Columns of a curve, without what comes from elsewhere."""
    # At points that the mode leaves at rest no force drives it.
    moves = np.where(c.displacement > 1e-9 * c.amplitude[:, np.newaxis], c.displacement, 0.0)
    return {
        "model": model, "mode": c.mode, "level": c.level / c.slips_at,
        "modal_amplitude": c.amplitude, "frequency_Hz": c.frequency,
        "damping_ratio": c.damping_ratio,
        **spread("displacement_{}_m", c.displacement, names),
        **spread("force_{}_N", over(c.losses.lost[:, np.newaxis], np.pi * moves), names),
        "slipping_share": by_place.slipping_share_of_all,
        "friction_damping_ratio": c.friction_damping,
        "viscous_damping_ratio": c.viscous_damping, "state": c.state, "doubt": c.doubts,
        **({} if c.offset is None else {"modal_offset": c.offset}),
        **({} if c.opened is None else {"opened_share": c.opened}),
    }  # fmt: skip


def backbone_lines(backbone: SceneBackbone) -> list[str]:
    """What is printed of damping against amplitude: the ends of each curve, and largest errors."""
    lines, scene = [*backbone.shapes], backbone.scene
    for model in backbone.models:
        for curve in model.curves:
            f, ratio, state = curve.frequency, 100.0 * curve.damping_ratio, curve.state
            ends = dict.fromkeys((state[0], state[-1]))
            seen = "no" if [*ends] == ["stick"] else " to ".join(ends)
            lines.append(
                f"{model.name} model, mode {curve.mode}: {f[0]:.6g} to {f[-1]:.6g} Hz (stuck "
                f"{curve.stuck_frequency:.6g} Hz), damping {ratio[0]:.3g} to {ratio[-1]:.3g} %, "
                f"{seen} slip.{_opened(curve)}{_doubtful(curve)}"
            )
        if model.name != "full" and model.errors[0]:
            worst = {k: 100.0 * max(e[k] for e in model.errors) for k in model.errors[0]}
            lines.append(
                f"It errs by {worst['frequency']:.2g} % in frequency and by "
                f"{worst['damping_ratio']:.2g} % in damping at most."
            )
    for model in backbone.models:
        for curve, at in zip(model.curves, model.at, strict=False):
            places, given = places_of(scene.structure(), scene.system()), damping_given(scene)
            normal = backbone.normal.get(curve.mode)
            lines += loss.level_lines(model.name, curve, at, places)
            lines += loss.amplitude_lines(model.name, at, places, normal, given)
    lines += [
        f"Mode {mode}: the mesh errs by an estimated {_to(errors['frequency'])} % in frequency and "
        f"{_to(errors['damping_ratio'])} % in damping, from the lowest level to the highest."
        for mode, errors in backbone.mesh.items()
    ]
    lines += [
        f"Mode {mode} at its highest level changes the normal force by {change.text}. "
        f"{change.of_the_mesh}"
        for mode, change in backbone.normal.items()
    ]
    return lines


def _to(errors: FloatArray) -> str:
    """First and last of some errors, percent."""
    return " to ".join(f"{100.0 * error:.2g}" for error in (errors[0], errors[-1]))


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


def _active_lengths(structure: AnyStructure, slip: FloatArray) -> dict[str, float]:
    """Cells of a row with the active length (m) of each joint with an axis.

    By the slip of all points (m); nan where that is not known.
    """
    unknown = np.isnan(slip).any()
    lengths = measured_lengths(structure, np.zeros_like(slip) if unknown else slip)
    if unknown:
        lengths = dict.fromkeys(lengths, np.nan)
    return spread("active_length_{}_m", [*lengths.values()], safe_names(lengths))


def _mode(
    backbone: SceneBackbone, model: ModelBackbone, k: int, places: JointPlaces
) -> dict[str, Any]:
    """Content of the summary about the curve number ``k`` of a model."""
    c = model.curves[k]
    content: dict[str, Any] = {
        "mode": c.mode,
        "unknowns": c.states.shape[1],
        "stuck_frequency_Hz": c.stuck_frequency,
        "slips_as_a_whole_at": c.slips_at,
        "masing_error": c.masing_error,
        "largest_damping_ratio": float(c.damping_ratio.max()),
        "lowest_frequency_Hz": float(c.frequency.min()),
        "highest_level": loss.content(c.losses, places.of_curve(c.friction_work, c.slip), -1),
    }
    for at in model.at[k : k + 1]:
        content["amplitudes"] = loss.amplitude_content(at, places, backbone.normal.get(c.mode))
    if c.estimated:
        content["estimated_error"] = dict(c.estimated)
    if c.mode in backbone.mesh:
        mesh = backbone.mesh[c.mode]
        content["mesh_error"] = {name: float(np.nanmax(e)) for name, e in mesh.items()}
    if c.opened is not None:
        content["opened_share"] = float(c.opened.max())
    if c.mode in backbone.normal:
        content["normal_force_change"] = backbone.normal[c.mode].share
    if model.name != "full":
        content["error"] = model.errors[k]
    for d in model.ring_downs[k : k + 1]:
        joints = [patch.joint.name for patch in backbone.scene.structure().patches]
        content |= {
            "ring_down_energy_J": d.energy[0],
            "ring_down_friction_energy_J": dict(
                zip(joints, d.friction_work[-1].tolist(), strict=True)
            ),
            "ring_down_step_error": d.step_error,
            "ring_down_impact_energy_J": d.impact_work,
        }
    return content


def backbone_figure(models: Sequence[ModelBackbone], largest: Sequence[float] = ()) -> Figure:
    """Frequency, damping ratio and loss factor over the amplitude of each mode.

    ``largest`` is, for each mode, the displacement (m) of the node that it moves most at a modal
    amplitude of 1 m kg^1/2: the amplitude is then drawn as this node's displacement. Without it the
    modal amplitude is drawn, which grows with the load even where a named point does not.
    """
    first = models[0].curves
    figure, panels = new_panels(3.5, 3.3, len(first), 3)
    for k, (row, curve) in enumerate(zip(panels.reshape(-1, 3), first, strict=True)):
        label, scale = "modal amplitude, m·√kg", 1.0
        if largest:
            unit, size = prefixed_unit("m", [largest[k] * curve.amplitude])
            label, scale = f"amplitude where the mode\nmoves most, {unit}", size / largest[k]
        for model, colour in zip(models, COLOURS, strict=False):
            c, down = model.curves[k], [*model.ring_downs[k : k + 1]]
            x = c.amplitude / scale
            gross = np.array([state == "gross" for state in c.state])
            for panel, name, factor in (row[0], "frequency", 1.0), (row[1], "damping_ratio", 100.0):
                y, how = factor * getattr(c, name), {"color": colour}
                panel.semilogx(x, y, LINES[model.name], label=f"{model.name} model", **how)
                if gross.any():
                    told = "gross slip: not to be relied on"
                    panel.plot(x[gross], y[gross], "s", label=told, **how)
                if c.differs is not None and c.differs.any():
                    ring = {"markerfacecolor": "none", "markersize": 9} | how
                    panel.plot(x[c.differs], y[c.differs], "o", label="ring-down differs", **ring)
                for d in down:
                    drawn = d.amplitude >= c.amplitude[0]
                    at = d.amplitude[drawn] / scale
                    free = factor * getattr(d, name)[drawn]
                    panel.plot(
                        at, free, _DOTS[model.name], label=f"{model.name} model's ring-down", **how
                    )
            _draw_losses(row[2], c, model.at[k : k + 1], scale, colour, model.name)
        row[0].axhline(curve.stuck_frequency, color="#888888", linestyle=":", label="stuck")
        row[0].set_title(f"mode {curve.mode}", loc="left")
        row[0].legend(fontsize="small")
        shown = "frequency, Hz", "damping ratio, %", "loss factor"
        for panel, values in zip(row, shown, strict=True):
            panel.set(xlabel=label, ylabel=values)
            plain_ticks(panel.xaxis)
    return figure


def _draw_losses(
    panel: Any, c: Backbone, asked: Sequence[AtAmplitudes], scale: float, colour: str, model: str
) -> None:
    """Loss factor of a curve, and with its error at the amplitudes that were asked for."""
    panel.semilogx(c.amplitude / scale, c.losses.loss_factor, LINES[model], color=colour)
    for at in asked:
        eta = at.curve.losses.loss_factor
        error = np.nan_to_num(at.total[0]) * eta
        look = {"color": colour, "capsize": 3, "markerfacecolor": "none"}
        x, told = at.curve.amplitude / scale, f"{model} model, asked for, ± stated error"
        panel.errorbar(x, eta, error, fmt="o", label=told, **look)
        panel.legend(fontsize="small")


def write_response(folder: Path, response: SceneResponse) -> list[Path]:
    """Write ``response.csv``, ``response.png`` and ``summary.json``.

    With backbones also ``peaks.csv`` and ``backbone_response.png``, which compare the peaks.
    """
    scene = response.scene
    system, structure = scene.system(), scene.structure()
    names, numbers = safe_names(system.points), range(1, HARMONICS + 1)
    places = places_of(structure, system)
    every = [p for model in response.models for curve in model.curves for p in curve.points]
    served = any(np.isfinite(p.model_error) for p in every)  # by a model for a range
    judged = any(p.stable is not None for p in every)  # by harmonic balance
    rows, swept, models = list[dict[str, Any]](), list[dict[str, Any]](), dict[str, Any]()
    for model in response.models:
        levels = []
        for number, curve in enumerate(model.curves):
            by_place, column = loss.of_response(places, curve), curve.column
            harmonics = np.abs(column("harmonics")).reshape(len(curve.points), -1)
            rows.append({
                "model": model.name, "level": curve.level, "frequency_Hz": column("frequency"),
                "converged": [p.failure is None for p in curve.points],
                **spread("amplitude_{}_m", column("amplitude"), names),
                **spread("phase_{}_rad", column("phase"), names),
                **spread("offset_{}_m", column("offset"), names),
                **spread("harmonic_{}_m", harmonics, [f"{k}_{x}" for x in names for k in numbers]),
                "friction_energy_J": column("friction_energy"),
                "input_energy_J": column("input_energy"),
                "largest_slip_m": [p.slip.max(initial=0.0) for p in curve.points],
                "slipping_share": by_place.slipping_share_of_all,
                **_functions(response, curve),
                "periods": column("periods"), "residual": column("change"),
                "step_error": column("step_error"),
                **({"model_error": column("model_error")} if served else {}),
                **({"stable": column("stable")} if judged else {}),
                **curve.losses.columns(),
                **loss.place_columns(by_place),
                **by_columns(_active_lengths(structure, p.slip) for p in curve.points),
            })  # fmt: skip
            levels.append(_level(model, number, system.points, by_place))
        models[model.name] = {
            "offline_s": model.offline_s,
            "compilation_s": model.compilation_s,
            "wall_s": model.wall_s,
            "levels": levels,
        }
        swept += [
            {
                "model": model.name, "level": sweep.level, "octaves_per_minute": sweep.rate,
                "frequency_Hz": sweep.frequency, **spread("amplitude_{}_m", sweep.amplitude, names),
            }
            for sweep in model.sweeps
        ]  # fmt: skip
    tables: dict[str, Table] = {"response.csv": by_columns(rows)}
    figures = {"response.png": response_figure(response)}
    if swept:
        tables["swept.csv"] = by_columns(swept)
    if response.backbones:
        peaks = backbone_peaks(response)
        tables["peaks.csv"] = peak_columns(peaks)
        figures["backbone_response.png"] = peaks_figure(response, peaks)
    over_force, notes = over_one_force(system), [*response.notes]
    if scene.output.uff and not over_force:
        notes.append(
            "response.uff has geometry and modes alone: responses are taken over one force, which "
            "must be the only load."
        )
    told, acting = response_lines(response), response_loads(scene)
    about = folder, scene, models, tables, figures
    files = written(*about, told=told, notes=notes, acting=acting)
    curves = response.models[0].curves if over_force else []
    return [*files, *_uff(folder / "response.uff", scene, curves=curves)]


def _uff(path: Path, scene: Scene, **results: Any) -> list[Path]:
    """Write a universal file beside results, if a scene asks for one."""
    if not scene.output.uff:
        return []
    with adding(path.parent):
        return [scene_uff(path, scene, **results)]


def response_lines(response: SceneResponse) -> list[str]:
    """What is printed of steady vibration: the peak of each curve, and its place on a backbone."""
    lines = [
        f"{model.name} model, level {curve.level:g}: peak {1e3 * curve.peak[1]:.5g} mm at "
        f"{curve.peak[0]:.6g} Hz, {len(curve.points)} frequencies."
        for model in response.models
        for curve in model.curves
    ]
    for model in response.models:
        for curve, sweep in ((c, s) for c in model.curves for s in model.sweeps_at(c.level)):
            (frequency, amplitude), (steady, largest) = sweep.peak, curve.peak
            lines.append(
                f"{model.name} model, level {curve.level:g}, swept at {sweep.rate:+g} octaves a "
                f"minute: largest {1e3 * amplitude:.5g} mm at {frequency:.6g} Hz, "
                f"{100.0 * (amplitude / largest - 1.0):+.2g} % in amplitude and "
                f"{100.0 * (frequency / steady - 1.0):+.2g} % in frequency from the steady peak."
            )
    return [*lines, *peak_lines(backbone_peaks(response))]


def _level(
    model: ModelResponse, number: int, points: Sequence[str], by_place: PlaceResults
) -> dict[str, Any]:
    """Content of the summary about a curve of a response."""
    curve, sweeps = model.curves[number], model.sweeps_at(model.curves[number].level)
    (frequency, amplitude), error = curve.peak, curve.column("step_error")
    estimate = model.estimates[number] if model.estimates else None
    f, moved = curve.column("frequency"), curve.column("amplitude")[:, curve.largest]
    nearest = int(np.where(np.isfinite(moved), np.abs(f - frequency), np.inf).argmin())
    at_peak = loss.content(curve.losses, by_place, nearest)
    content = {
        "level": curve.level,
        "point": points[curve.largest],
        "peak_frequency_Hz": frequency,
        "peak_amplitude_m": amplitude,
        "frequencies": len(curve.points),
        "periods": int(curve.column("periods").sum()),
        "largest_step_error": None if np.isnan(error).all() else float(np.nanmax(error)),
        "slips_as_a_whole_Hz": curve.gross.tolist(),
        "failed_Hz": [p.frequency for p in curve.points if p.failure is not None],
        "estimated_error": estimate and {q: estimate.of("total", q) for q in QUANTITIES},
        "peak": {"frequency_Hz": float(f[nearest]), **at_peak},
    }
    if sweeps:
        content["sweeps"] = [
            {
                "octaves_per_minute": sweep.rate,
                "peak_frequency_Hz": sweep.peak[0],
                "peak_amplitude_m": sweep.peak[1],
            }
            for sweep in sweeps
        ]
    return content


def _functions(response: SceneResponse, curve: Curve) -> dict[str, FloatArray]:
    """Columns of the frequency responses that a scene asks for: size and phase, first harmonic."""
    system, columns = response.scene.system(), dict[str, FloatArray]()
    names = safe_names(system.points)
    for kind in response.scene.asked("response").functions:
        unit = KINDS[kind][0].replace("/", "_per_").replace("²", "2")
        for point, name in zip(system.points, names, strict=True):
            found = frequency_response(system, curve, point, kind)[:, 0]
            columns[f"{kind}_{name}{'_' * bool(unit)}{unit}"] = np.abs(found)
            columns[f"{kind}_{name}_phase_rad"] = np.angle(found)
    return columns


def response_figure(response: SceneResponse) -> Figure:
    """Amplitude over load level and phase of the point that moves most, and loss factor.

    The linear structures with stuck and with loose joints are drawn beside them, and swept
    sines of the first model.
    """
    points, most = response.scene.system().points, response.models[0].largest
    figure, (upper, lower, lost) = new_panels(7.5, 2.5, rows=3, height_ratios=(2, 1, 1))
    drawn = [(c, A / c.level, look) for c, A, look in drawn_curves(response)]
    unit, scale = prefixed_unit("m", [np.nan_to_num(column) for _, column, _ in drawn])
    for name, limit, line in (("stuck", response.stuck, ":"), ("loose", response.loose, "-.")):
        y, look = limit[:, most] / scale, {"color": "#888888", "label": f"{name} joint"}
        upper.semilogy(response.linear_frequencies, y, line, **look)
    for curve, column, look in drawn:
        f = curve.column("frequency")
        unstable = curve.column("stable") == np.False_
        upper.semilogy(f, np.where(unstable, np.nan, column) / scale, **look)
        if unstable.any():
            beside = np.convolve(unstable, np.ones(3), "same") > 0.0
            dashed = look | {"ls": (0, (2, 2)), "label": None}
            upper.semilogy(f, np.where(beside, column, np.nan) / scale, **dashed)
        phase = np.degrees(np.unwrap(np.nan_to_num(curve.column("phase")[:, most])))
        lower.plot(f, phase, **look)
        lost.plot(f, curve.losses.loss_factor, **look)
    sweeps = response.models[0].sweeps
    for sweep, grey in zip(sweeps, np.linspace(0.2, 0.7, len(sweeps)), strict=True):
        told = f"level {sweep.level:g}, {sweep.rate:+g} octaves a minute"
        y, line = sweep.amplitude[:, most] / sweep.level / scale, "-" if sweep.rate > 0.0 else ":"
        upper.semilogy(
            sweep.frequency, y, line, color=str(grey), linewidth=1.0, label=told, zorder=1
        )
    upper.set(ylabel=f"amplitude over level, {unit}", xmargin=0.0)
    upper.set_title(points[most], loc="left")
    upper.legend(fontsize="small", ncols=2)
    lower.set(ylabel="phase, degrees")
    lost.set(xlabel="frequency, Hz", ylabel="loss factor")
    plain_ticks(upper.yaxis)
    return figure


def write_random(folder: Path, random: SceneRandom) -> list[Path]:
    """Write ``random.csv``, ``random_psd.csv``, ``random.png`` and a summary.

    Works are in ``random_joints.csv``, and of contact points in ``random_points.csv``.
    """
    scene, found = random.scene, random.found
    names = safe_names(found.points)
    spectra: dict[str, Any] = {"frequency_Hz": found.frequencies}
    spectra |= spread("displacement_{}_m2_Hz", found.displacement_psd.T, names)
    spectra |= spread("acceleration_{}_m2_s4_Hz", found.acceleration_psd.T, names)
    tables: dict[str, Any] = {
        "random.csv": found.table,
        "random_joints.csv": {"joint": list(found.joints), "work_J_per_hour": found.joint_work},
        "random_psd.csv": spectra,
    }
    wear = _wear(scene.structure(), found.point_work)
    if wear:
        tables["random_points.csv"] = by_columns(wear)
    whole = {c.mode: float(np.interp(c.slips_at, c.level, c.amplitude)) for c in random.curves}
    modes = [
        {
            "mode": mode.mode,
            "frequency_Hz": mode.frequency,
            "damping_ratio": mode.damping_ratio,
            "rms_modal_amplitude": mode.rms,
            "peak_modal_amplitude": mode.peak,
            "rms_over_slip_as_a_whole": mode.rms / whole[mode.mode],
            "share_above_the_curve": mode.beyond,
        }
        for mode in found.modes
    ]
    return written(
        folder,
        scene,
        {"full": {"modes": modes}},
        tables,
        {"random.png": random_figure(found)},
        told=random_lines(random),
        notes=random.notes,
        acting=random_loads_of(scene, found.load),
        load=found.load,
        duration_s=found.duration,
        viscous_work_J_per_hour=found.viscous_work,
        estimated_error=dict(found.estimated),
    )


def _wear(structure: AnyStructure, work: FloatArray) -> list[dict[str, Any]]:
    """Columns of contact points with their place and work in an hour, (m,), J, for wear maps.

    None where nodes are not known.
    """
    if structure.body is None:
        return []
    return [
        {
            "joint": patch.joint.name,
            **spread("{}_m", structure.body.positions[patch.nodes], "xyz"),
            "area_m2": patch.area,
            "work_J_per_hour": work[patch.points],
            "work_density_J_m2_per_hour": over(work[patch.points], patch.area),
        }
        for patch in structure.patches
    ]


def random_lines(random: SceneRandom) -> list[str]:
    """What is printed of random vibration: modes, points, joints and errors."""
    found = random.found
    lines = [
        f"Mode {mode.mode}: {mode.frequency:.6g} Hz, damping {100.0 * mode.damping_ratio:.3g} %."
        for mode in found.modes
    ]
    lines += [
        f"{point}: root mean square {1e3 * found.displacement_rms[k]:.5g} mm and "
        f"{found.acceleration_rms[k]:.5g} m/s², largest in {found.duration:g} s "
        f"{1e3 * found.displacement_peak[k]:.4g} mm and {found.acceleration_peak[k]:.4g} m/s²."
        for k, point in enumerate(found.points)
    ]
    lines += [
        f"Joint {joint}: friction does {work:.5g} J in an hour."
        for joint, work in zip(found.joints, found.joint_work.tolist(), strict=True)
    ]
    errors = found.estimated
    return [
        *lines,
        f"The levels of the curves cause an estimated {100.0 * errors['displacement_rms']:.2g} % "
        f"of root mean squares and {100.0 * errors['friction_work']:.2g} % of the work.",
    ]


def random_figure(found: RandomResponse) -> Figure:
    """Spectral densities of displacement and acceleration of the named points."""
    figure, (upper, lower) = new_panels(7.5, 3.0, rows=2)
    for panel, density, unit in (
        (upper, found.displacement_psd, "displacement, m²/Hz"),
        (lower, found.acceleration_psd, "acceleration, (m/s²)²/Hz"),
    ):
        for point, values in zip(found.points, density, strict=True):
            panel.loglog(found.frequencies, values, label=point)
        panel.set(ylabel=unit)
    upper.legend(fontsize="small")
    lower.set(xlabel="frequency, Hz")
    plain_ticks(lower.xaxis)
    return figure


def written(
    folder: Path,
    scene: Scene,
    models: Mapping[str, Any],
    tables: Mapping[str, Table],
    figures: Mapping[str, Figure],
    *,
    told: Sequence[str],
    notes: Sequence[str],
    acting: Iterable[str],
    **more: Any,
) -> list[Path]:
    """Write tables, pictures and the summary of a command about vibration in one folder.

    The summary has results by model, what is printed, notes, what acts, and ``more`` entries.
    """
    content = {
        "title": scene.title,
        "models": models,
        "told": list(told),
        "warnings": list(notes),
        "premises": premises(scene, made_of(scene.structure()), acting),
        **more,
    }
    with writing(folder, content) as summary:
        for name, columns in tables.items():
            write_table(folder / name, columns)
        for name, figure in figures.items():
            save_figure(folder / name, figure)
    return [*(folder / name for name in (*tables, *figures)), summary]
