"""Table, picture and sentences of modes into gross slip, with slow curves and ring-downs beside."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.files import safe_names
from skfem_joint.ground.plain_values import spread
from skfem_joint.harmonic.curve import NonlinearMode
from skfem_joint.output import loss
from skfem_joint.output.backbone_peaks import COLOURS
from skfem_joint.output.damping import written
from skfem_joint.output.plots import new_panels, plain_ticks, prefixed_unit
from skfem_joint.output.tables import by_columns
from skfem_joint.results.loss import known
from skfem_joint.results.places import places_of
from skfem_joint.study.scene_backbone import ModelBackbone, SceneNonlinearModes
from skfem_joint.vibration.backbone import Backbone
from skfem_joint.vibration.ring_down import RingDown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ACTS = (
    "Each mode vibrates by itself, kept up by a force in proportion to its momentum, under "
    "Coulomb's law; loads of the scene only name points and directions.",
)
#: Values of all curves, with the end of their columns.
_VALUES = {"frequency": "frequency_Hz", "damping_ratio": "damping_ratio"}
_SAID = {
    "quasi_static": "The quasi-static curve reaches",
    "ring_down": "The ring-down reaches",
    "time_steps": "Time steps judge",
}


def write_nonlinear_modes(folder: Path, modes: SceneNonlinearModes) -> list[Path]:
    """Write ``nonlinear_modes.csv``, ``nonlinear_modes.png`` and a summary."""
    scene, model = modes.scene, modes.model
    system = scene.system()
    names, places = safe_names(system.points), places_of(scene.structure(), system)
    rows, content = list[dict[str, Any]](), []
    for c in modes.curves.values():
        by_place = places.of_curve(c.friction_work, c.slip)
        table: dict[str, Any] = {
            "model": model.name,
            "mode": c.mode,
            "amplitude_m": _amplitude(c, system.points),
            "modal_amplitude": c.amplitude,
            **{column: getattr(c, name) for name, column in _VALUES.items()},
            **{f"{name}_error": c.error(name) for name in _VALUES},
            "decrement_ratio": c.decrement,
            "decrement_ratio_error": c.decrement_error,
            **{
                f"{what}_{column}": values[name]
                for what, values in _beside(model, c).items()
                for name, column in _VALUES.items()
            },
            "friction_damping_ratio": c.friction_damping,
            "viscous_damping_ratio": c.viscous_damping,
            "state": c.state,
            "opened_share": c.opened,
            **spread("displacement_{}_m", c.displacement, names),
        }
        rows.append(table | c.losses.columns() | loss.place_columns(by_place))
        content.append(
            {
                "mode": c.mode,
                "unknowns": c.harmonics.shape[2],
                "stuck_frequency_Hz": c.stuck_frequency,
                "point": c.point,
                "harmonics": c.series.highest,
                "samples": c.series.samples,
                "estimated_error": {
                    source: known({name: float(values.max()) for name, values in errors.items()})
                    for source, errors in c.errors.items()
                },
                "highest_level": loss.content(c.losses, by_place, -1),
            }
        )
    by_model, tables = {model.name: {"modes": content}}, {"nonlinear_modes.csv": by_columns(rows)}
    figures = {"nonlinear_modes.png": nonlinear_figure(modes)}
    about = {"told": nonlinear_lines(modes), "notes": modes.notes, "acting": _ACTS}
    return written(folder, scene, by_model, tables, figures, **about)


def nonlinear_lines(modes: SceneNonlinearModes) -> list[str]:
    """What is printed: the ends of each curve, its largest damping, and its errors."""
    points = modes.scene.system().points
    return [line for c in modes.curves.values() for line in _lines(modes.model, c, points)]


def _lines(model: ModelBackbone, c: NonlinearMode, points: tuple[str, ...]) -> Iterator[str]:
    f, ratio, peak = c.frequency, 100.0 * c.damping_ratio, int(c.damping_ratio.argmax())
    at = f"{_amplitude(c, points)[peak]:.3g} m" + (f" of {c.point!r}" if c.point else "")
    yield (
        f"{model.name} model, mode {c.mode}: {f[0]:.6g} to {f[-1]:.6g} Hz (stuck "
        f"{c.stuck_frequency:.6g} Hz), damping {ratio[0]:.3g} to {ratio[-1]:.3g} %, at most "
        f"{ratio[peak]:.3g} % at {at}, {c.state[0]} to {c.state[-1]} slip. It errs by an estimated "
        f"{_percent(c.estimated)} at most, with {c.series.highest} harmonics and "
        f"{c.series.samples} samples a period."
    )
    for what, values in _beside(model, c).items():
        known = np.isfinite(values["frequency"])
        if what == "time_steps" and not known.any():
            continue
        own = {name: getattr(c, name) for name in _VALUES}
        if what == "ring_down":  # whose damping ratio is another one
            own["damping_ratio"] = c.decrement
        apart = {
            name: float(np.abs(of[known] / own[name][known] - 1.0).max(initial=0.0))
            for name, of in values.items()
        }
        off = f", off by {_percent(apart)} at most" if known.any() else ""
        yield f"{_SAID[what]} {np.count_nonzero(known)} of {f.size} levels{off}."


def _percent(errors: Mapping[str, float]) -> str:
    shown = (
        f"{100.0 * e:.2g} % in {name.split('_')[0]}"
        if np.isfinite(e)
        else f"an unknown share in {name.split('_')[0]}"
        for name, e in errors.items()
    )
    return " and ".join(shown)


def _amplitude(c: NonlinearMode, points: tuple[str, ...]) -> FloatArray:
    """Amplitudes that were asked for, (levels,), m; without a point modal ones."""
    return c.displacement[:, points.index(c.point)] if c.point else c.amplitude


def _curves(model: ModelBackbone, mode: int) -> dict[str, tuple[FloatArray, dict[str, FloatArray]]]:
    """Modal amplitudes and values of the slow curve of a mode, and of its ring-down.

    The slow curve ends before its first doubtful level.
    """
    number = [curve.mode for curve in model.curves].index(mode)
    curve, curves = model.curves[number], {}
    doubtful = [k for k, doubt in enumerate(curve.doubts) if doubt]
    every: list[tuple[str, Backbone | RingDown, int | None]]
    every = [("quasi_static", curve, doubtful[0] if doubtful else None)]
    every += [("ring_down", down, None) for down in model.ring_downs[number : number + 1]]
    for what, one, end in every:
        amplitude, first = np.unique(one.amplitude[:end], return_index=True)
        curves[what] = amplitude, {name: getattr(one, name)[first] for name in _VALUES}
    return curves


def _beside(model: ModelBackbone, c: NonlinearMode) -> dict[str, dict[str, FloatArray]]:
    """Values of other curves at the modal amplitudes of a mode, and by time steps, or nan."""
    from scipy.interpolate import PchipInterpolator  # slow to load

    nowhere = np.full(c.amplitude.size, np.nan)
    found = {}
    for what, (amplitude, values) in _curves(model, c.mode).items():
        found[what] = dict.fromkeys(values, nowhere)
        if amplitude.size > 1:
            curves = PchipInterpolator(np.log(amplitude), [*zip(*values.values(), strict=True)])
            seen = c.displaced if what == "ring_down" else c.amplitude
            at = curves(np.log(seen), extrapolate=False)
            found[what] = dict(zip(values, at.T, strict=True))
    judged = found["time_steps"] = {name: nowhere.copy() for name in _VALUES}
    if c.marched is not None:
        k = c.marched.levels
        for name, marched in judged.items():
            marched[k] = getattr(c, name)[k] * (1.0 + getattr(c.marched, name))
    return found


def nonlinear_figure(modes: SceneNonlinearModes) -> Figure:
    """Frequency and damping ratio of each mode over its amplitude.

    Slow curves and ring-downs stand where the mode has their modal amplitude; beyond its levels
    the point's share in it is that of the nearest one.
    """
    points = modes.scene.system().points
    figure, panels = new_panels(4.25, 3.3, len(modes.curves), 2)
    look = {"quasi_static": "--", "ring_down": "x"}
    for row, c in zip(panels.reshape(-1, 2), modes.curves.values(), strict=True):
        x = _amplitude(c, points)
        unit, size = prefixed_unit("m", [x]) if c.point else ("m·√kg", 1.0)
        for panel, name, factor in zip(row, _VALUES, (1.0, 100.0), strict=True):
            y = factor * getattr(c, name)
            label = f"nonlinear mode, {modes.model.name} model"
            panel.semilogx(x / size, y, ".-", color=COLOURS[0], label=label)
            if name == "damping_ratio" and "ring_down" in _curves(modes.model, c.mode):
                decay = {"linestyle": ":", "label": "as it rings down"}
                decays = panel.plot(x / size, factor * c.decrement, color=COLOURS[0], **decay)
                panel.legend(handles=decays, fontsize="small")  # others are those of frequency
            if c.marched is not None:
                k, ring = c.marched.levels, {"markerfacecolor": "none", "markersize": 8}
                label = "judged by time steps"
                panel.plot(x[k] / size, y[k], "o", color=COLOURS[0], label=label, **ring)
            others = _curves(modes.model, c.mode).items()
            for (what, (amplitude, values)), colour in zip(others, COLOURS[1:], strict=False):
                seen = c.displaced if what == "ring_down" else c.amplitude
                ratio = np.interp(np.log(amplitude), np.log(seen), x / seen)
                shown = ratio * amplitude / size, factor * values[name]
                known = {"label": what.replace("_", "-")} if amplitude.size else {}
                panel.plot(*shown, look[what], color=colour, **known)
            # A ring-down goes on to amplitudes far below all curves.
            curves = [line.get_xdata() for line in panel.lines if line.get_linestyle() != "None"]
            least = 0.1 * min(float(np.min(each)) for each in curves if len(each))
            panel.set_xlim(left=max(panel.get_xlim()[0], least))
            plain_ticks(panel.xaxis)
            panel.set_xlabel(
                f"first harmonic of {c.point}, {unit}" if c.point else f"modal, {unit}"
            )
        row[0].axhline(c.stuck_frequency, color="#888888", linestyle=":", label="stuck")
        row[0].set(ylabel="frequency, Hz")
        row[0].set_title(f"mode {c.mode}", loc="left")
        row[0].legend(fontsize="small")
        row[1].set(ylabel="damping ratio, %")
    return figure
