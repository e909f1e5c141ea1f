"""Tables, pictures and the scene of a fit."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint import __version__
from skfem_joint.fitting.fit import LEVEL, Fit, Profile
from skfem_joint.fitting.measured import MeasuredCurve
from skfem_joint.fitting.measured_table import AMPLITUDES, QUANTITIES
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import JointError, refuse
from skfem_joint.ground.files import replacing
from skfem_joint.output.plots import (
    legend_above,
    new_panels,
    plain_ticks,
    prefixed_unit,
    save_figure,
)
from skfem_joint.output.record import writing
from skfem_joint.output.tables import TextTable, by_columns, write_json, write_table
from skfem_joint.scene import load_scene
from skfem_joint.scene.rewriting import rewritten
from skfem_joint.structure.parameters import single_values, value_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Names of the files of a fit; one of other origin is not overwritten.
NAMES = re.compile(
    r"fit\.(json|png)|(values|residuals|curve|profiles)\.csv|residuals\.png|fitted\.toml"
)

_COLOURS = ("#1f5fa8", "#a33b00", "#2e7d32", "#8d5fb0", "#b8860b")
_MODEL = "#1a1a1a"
_MARKS = "oDs^v"
#: Label and factor of each quantity in a picture.
_AXES = {"frequency": ("frequency, Hz", 1.0), "damping": ("damping ratio, %", 100.0)}


def check_apart(folder: Path, files: Sequence[Path]) -> None:
    """Refuse to read a file that would be replaced by one of the results in a folder.

    Raises
    ------
    InputError
        If a file that is read has the name of a result, in that folder.
    """
    refuse(
        f"{file}: is read, and a file of the results would replace it; choose another --out, or "
        "another name"
        for file in files
        if NAMES.fullmatch(file.name) and file.resolve().parent == folder.resolve()
    )


def write_fit(
    folder: Path,
    fit: Fit,
    curves: Sequence[MeasuredCurve],
    text: str,
    notes: Sequence[str] = (),
    profiles: Sequence[Profile] = (),
) -> tuple[list[Path], list[str]]:
    """Write all files of the fit of a scene.

    Parameters
    ----------
    folder : Path
    fit : Fit
        Of a scene that was read from a file.
    curves : sequence of MeasuredCurve
        Of `Fit.curves`.
    text : str
        Of the scene's file.
    notes : sequence of str
        About the folder.
    profiles : sequence of Profile
        Profile likelihoods, if they were computed.

    Returns
    -------
    files : list of Path
    notes : list of str
        All notes: those of the fit, those given, and one if the scene could not be written.
    """
    every = [*fit.notes, *notes]
    tables = {
        "values.csv": by_columns(_value_rows(fit)),
        "residuals.csv": by_columns(_residual_rows(fit)),
        "curve.csv": by_columns(_curve_rows(curves)),
    }
    if profiles:
        tables["profiles.csv"] = by_columns(
            {"name": of.name, "value": of.values, "excess_of_squares": of.excess} for of in profiles
        )
    figures = {"fit.png": curves_figure(fit, curves), "residuals.png": residuals_figure(fit)}
    files = [folder / name for name in ("fit.json", *tables, *figures)]
    with writing(folder, {"values": fit.values, "warnings": every}) as summary:
        write_json(files[0], _content(fit, every))
        for name, columns in tables.items():
            write_table(folder / name, columns)
        for name, figure in figures.items():
            save_figure(folder / name, figure)
        try:
            files.append(_write_scene(folder / "fitted.toml", fit, text))
        except JointError as error:
            every.append(f"The scene with the best values was not written: {error}")
    return [*files, summary], every


def profile_lines(profiles: Sequence[Profile]) -> list[str]:
    """What is printed of profile likelihoods: an interval of each value."""
    if not profiles:
        return []
    level = f"{100.0 * LEVEL:g} % interval by profile"
    rows = {}
    for profile in profiles:
        size = float(np.ptp(profile.interval)) or float(profile.values[0])
        low, high = (_rounded(end, 0.25 * size) for end in profile.interval)
        rows[profile.name] = [f"{low} to {high}"]
    return [str(TextTable("", [level], rows)), ""]


def fit_lines(fit: Fit) -> list[str]:
    """What is printed of a fit: its values, how well they fit, and what the data leave open."""
    rows = {}
    for name, best in (fit.values | fit.offsets).items():
        own = fit.deviations[name]
        low, high = (_rounded(end, own) for end in fit.interval(name))
        unit = ", Hz" * (name in fit.offsets and name.endswith(": frequency"))
        rows[name + unit] = [_rounded(best, own), f"{own:.2g}", f"{low} to {high}"]
    level = f"{100.0 * LEVEL:g} % interval"
    samples = fit.degrees + fit.vector.size
    return [
        str(TextTable("", ["value", "± deviation", level], rows)),
        "",
        f"Sum of squares {fit.sum_of_squares:.4g} of {samples} residuals over their deviations, "
        f"{fit.degrees} degrees of freedom.",
        *fit.undetermined,
        f"{fit.computed} curves were computed in {fit.seconds:.2g} s"
        f"{f', in searches from {fit.searches} starts' * (fit.searches > 1)}.",
    ]


def curves_figure(fit: Fit, curves: Sequence[MeasuredCurve]) -> Figure:
    """Frequency and damping over amplitude: samples, and the curve of the model with its band.

    Data of another mode or quantity have panels of their own.
    """
    figure, panels = _figure_of(fit)
    for panel, name, own, size in panels:
        factor = _AXES[name][1]
        alike = len({_what_is_computed(fit, k) for k in own}) == 1
        for k in own:
            curve, fine = fit.problem.curves[k], curves[k]
            (y, deviation), (model, half) = (
                [factor * getattr(one, name + end) for end in ("", "_deviation")]
                for one in (curve, fine)
            )
            for chosen, look in _kinds(curve, k, ~np.isnan(y)):
                panel.errorbar(
                    curve.amplitude[chosen] / size, y[chosen], deviation[chosen],
                    capsize=2.0, elinewidth=1.0, zorder=3, **look,
                )  # fmt: skip
            x, colour = fine.amplitude / size, _MODEL if alike else _COLOURS[k % len(_COLOURS)]
            label = "model" if alike else f"model of {curve.name}"
            panel.plot(x, model, color=colour, linewidth=1.5, label=label, zorder=2)
            panel.fill_between(
                x, model - half, model + half, color=colour, alpha=0.2, linewidth=0.0, zorder=1,
                label=f"its {100.0 * LEVEL:g} % band",
            )  # fmt: skip
    legend_above(figure, fontsize="small")
    return figure


def residuals_figure(fit: Fit) -> Figure:
    """Residuals over their deviations against amplitude, beside lines at two deviations."""
    figure, panels = _figure_of(fit, "model less measured,\nover deviation")
    for panel, name, own, size in panels:
        panel.set_title(name, loc="right", fontsize="medium")
        panel.axhspan(-2.0, 2.0, color="0.92", zorder=0, label="two deviations")
        panel.axhline(0.0, color="0.5", linewidth=0.8, zorder=1)
        for k in own:
            curve, (_, r) = fit.problem.curves[k], _beside(fit, k, name)
            for chosen, look in _kinds(curve, k, ~np.isnan(r)):
                panel.plot(curve.amplitude[chosen] / size, r[chosen], **look)
    legend_above(figure, fontsize="small")
    return figure


def _figure_of(fit: Fit, label: str = "") -> tuple[Figure, list[tuple[Any, str, list[int], float]]]:
    """Figure with two panels for each mode and quantity.

    Of each panel also what it shows, "frequency" or "damping", the numbers of its curves, and the
    size of the unit of the amplitude.
    """
    groups: dict[tuple[int, str], list[int]] = {}
    for k, curve in enumerate(fit.problem.curves):
        groups.setdefault((curve.mode, curve.quantity), []).append(k)
    figure, grid = new_panels(4.25, 3.5 + 0.6 / len(groups), len(groups), 2)
    panels = []
    for row, ((mode, quantity), own) in zip(grid.reshape(-1, 2), groups.items(), strict=True):
        of_all = [fit.problem.curves[k] for k in own]
        unit, size = prefixed_unit(_unit(quantity), [curve.amplitude for curve in of_all])
        if size > 1.0:  # nobody uses km/s²
            unit, size = _unit(quantity), 1.0
        points = {curve.point for curve in of_all}
        point = points.pop() if len(points) == 1 else ""
        where = f"{quantity} amplitude{f' of {point}' * bool(point)}, {unit}"
        for panel, name in zip(row, QUANTITIES, strict=True):
            panel.set(xscale="log", xlabel=where, ylabel=label or _AXES[name][0])
            plain_ticks(panel.xaxis)
            panel.ticklabel_format(axis="y", useOffset=False)
            panels.append((panel, name, own, size))
        row[0].set_title(f"mode {mode}", loc="left", fontsize="medium")
    return figure, panels


def _kinds(curve: MeasuredCurve, k: int, known: Any) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Which samples of curve ``k`` are fitted, filled, and which compared only, and their look."""
    for chosen, face, label in (
        (known & curve.fitted, {}, curve.name),
        (known & ~curve.fitted, {"markerfacecolor": "white"}, f"{curve.name}, not fitted"),
    ):
        if chosen.any():
            colour, mark = _COLOURS[k % len(_COLOURS)], _MARKS[k % len(_MARKS)]
            look = {"color": colour, "marker": mark, "markersize": 5.0, "linestyle": "none"}
            yield chosen, {**look, **face, "label": label}


def _what_is_computed(fit: Fit, k: int) -> tuple[float, ...]:
    """What the curve of the model beside a measured one depends on."""
    curve = fit.problem.curves[k]
    weights = np.abs(curve.weights(fit.problem.model.points))
    offsets = (fit.offsets.get(f"offset of {curve.name}: {name}", 0.0) for name in QUANTITIES)
    return (*weights.tolist(), *offsets)


def _unit(quantity: str) -> str:
    """SI unit of an amplitude, as it is read."""
    return next(iter(AMPLITUDES[quantity])).replace("2", "²")


def _beside(fit: Fit, k: int, name: str) -> tuple[FloatArray, FloatArray]:
    """Frequency or damping of the model at all samples of a curve, and the residual over deviation.

    nan where there is none.
    """
    curve, predicted = fit.problem.curves[k], fit.predicted[k]
    model, _ = fit.problem.beside(k, name, predicted, fit.vector)
    model = np.where(predicted.inside, model, np.nan)
    return model, (model - getattr(curve, name)) / getattr(curve, f"{name}_deviation")


def _content(fit: Fit, notes: Sequence[str]) -> dict[str, Any]:
    """Content of ``fit.json``."""
    problem = fit.problem
    bounds = zip(problem.names, problem.lowest.tolist(), problem.highest.tolist(), strict=True)
    return {
        "values": fit.values,
        "offsets": fit.offsets,
        "deviations": fit.deviations,
        "level": LEVEL,
        "intervals": {name: [*fit.interval(name)] for name in problem.names},
        "bounds": {name: [low, high] for name, low, high in bounds if np.isfinite(high - low)},
        "covariance": {"names": [*problem.names], "matrix": fit.covariance.tolist()},
        "sum_of_squares": fit.sum_of_squares,
        "degrees": fit.degrees,
        "widened": fit.widened,
        "undetermined": [*fit.undetermined],
        "data": [
            {
                **{key: getattr(curve, key) for key in ("name", "point", "mode", "quantity")},
                "samples": curve.amplitude.size,
                "fitted": int(curve.fitted.sum()),
                "points_turning": predicted.turning,
            }
            for curve, predicted in zip(problem.curves, fit.predicted, strict=True)
        ],
        "evaluations": fit.evaluations,
        "curves": fit.computed,
        "seconds": fit.seconds,
        "notes": [*notes],
        "version": __version__,
    }


def _value_rows(fit: Fit) -> Iterator[dict[str, Any]]:
    for k, (name, best) in enumerate((fit.values | fit.offsets).items()):
        lowest, highest = fit.interval(name)
        yield {
            "name": name, "best": best, "deviation": fit.deviations[name],
            "lowest": lowest, "highest": highest,
            "lower_bound": fit.problem.lowest[k], "upper_bound": fit.problem.highest[k],
        }  # fmt: skip


def _residual_rows(fit: Fit) -> Iterator[dict[str, Any]]:
    for k, curve in enumerate(fit.problem.curves):
        columns: dict[str, Any] = {"fitted": curve.fitted}
        for name, column in zip(QUANTITIES, ("frequency_Hz", "damping_ratio"), strict=True):
            columns[column] = getattr(curve, name)
            columns[f"model_{column}"], columns[f"{name}_residual"] = _beside(fit, k, name)
        yield _amplitudes(curve) | columns


def _curve_rows(curves: Sequence[MeasuredCurve]) -> Iterator[dict[str, Any]]:
    for fine in curves:
        yield _amplitudes(fine) | {
            "frequency_Hz": fine.frequency, "frequency_band_Hz": fine.frequency_deviation,
            "damping_ratio": fine.damping, "damping_ratio_band": fine.damping_deviation,
        }  # fmt: skip


def _amplitudes(curve: MeasuredCurve) -> dict[str, Any]:
    """First columns of a table over the amplitudes of a curve."""
    return {
        "data": curve.name, "mode": curve.mode, "quantity": curve.quantity,
        "amplitude": curve.amplitude, "unit": _unit(curve.quantity),
    }  # fmt: skip


def _write_scene(path: Path, fit: Fit, text: str) -> Path:
    """Write the scene with the best values, once it is sure that it is read as such."""
    structure = fit.problem.model.structure
    values = single_values(structure, fit.values)
    new = rewritten(text, values, fit.scene.path.parent, path.parent)
    with replacing(path) as temporary:
        temporary.write_text(new, encoding="utf-8")
        read = load_scene(temporary).structure().meshed("fit")
        refuse(
            f"{key}: found {found:g} in the new text, must be {value:g}"
            for key, value in values.items()
            if (found := value_of(read, key)) != value
        )
    return path


def _rounded(value: float, deviation: float) -> str:
    """Number with as many digits as its deviation leaves, at least five."""
    known = abs(value) / deviation if deviation > 0.0 else 0.0
    digits = int(np.clip(np.ceil(np.log10(max(known, 1.0))) + 2, 5, 10))
    return f"{value:.{digits}g}"
