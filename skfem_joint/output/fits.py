"""Tables, pictures and the scene of a fit."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint import __version__
from skfem_joint.analysis.fit import LEVEL, Fit, Profile
from skfem_joint.analysis.fit_curves import FineCurve, shifts
from skfem_joint.analysis.measured import MeasuredCurve
from skfem_joint.analysis.measured_table import AMPLITUDES
from skfem_joint.arrays import FloatArray
from skfem_joint.errors import JointError, refuse
from skfem_joint.files import replacing
from skfem_joint.output.plots import new_figure, plain_ticks, prefixed_unit, save_figure
from skfem_joint.output.record import writing
from skfem_joint.output.tables import plain, text_table, write_csv, write_json
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
_QUANTITIES = ("frequency", "damping")
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
    curves: Sequence[FineCurve],
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
    curves : sequence of FineCurve
        Of `fine_curves`.
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
    content = {"values": fit.values, "warnings": every}
    figures = {
        "fit.png": curves_figure(fit, curves),
        "residuals.png": residuals_figure(fit),
    }
    files = [folder / "fit.json"]
    with writing(folder, content) as summary:
        write_json(files[0], _content(fit, every))
        tables = {
            "values.csv": _value_rows(fit),
            "residuals.csv": _residual_rows(fit),
            "curve.csv": _curve_rows(curves),
        }
        if profiles:
            tables["profiles.csv"] = _profile_rows(profiles)
        for name, rows in tables.items():
            write_csv(folder / name, ([plain(value) for value in row] for row in rows))
            files.append(folder / name)
        for name, figure in figures.items():
            files.append(save_figure(folder / name, figure))
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
    return [text_table("", [level], rows), ""]


def fit_lines(fit: Fit) -> list[str]:
    """What is printed of a fit: its values, how well they fit, and what the data leave open."""
    rows = {}
    for name, best in _named(fit).items():
        own = fit.deviations[name]
        low, high = (_rounded(end, own) for end in fit.interval(name))
        unit = ", Hz" * (name in fit.offsets and name.endswith(": frequency"))
        rows[name + unit] = [_rounded(best, own), f"{own:.2g}", f"{low} to {high}"]
    level = f"{100.0 * LEVEL:g} % interval"
    samples = fit.degrees + fit.vector.size
    return [
        text_table("", ["value", "± deviation", level], rows),
        "",
        f"Sum of squares {fit.sum_of_squares:.4g} of {samples} residuals over their deviations, "
        f"{fit.degrees} degrees of freedom.",
        *fit.undetermined,
        f"{fit.computed} curves were computed in {fit.seconds:.2g} s"
        f"{f', in searches from {fit.searches} starts' * (fit.searches > 1)}.",
    ]


def curves_figure(fit: Fit, curves: Sequence[FineCurve]) -> Figure:
    """Frequency and damping over amplitude: samples, and the curve of the model with its band.

    Data of another mode or quantity have panels of their own.
    """
    figure, rows = _figure_of(fit)
    for panels, own, size in rows:
        alike = len({_what_is_computed(fit, k) for k in own}) == 1
        for k in own:
            curve, fine, style = fit.problem.curves[k], curves[k], _style(k)
            x, line = fine.amplitude / size, _MODEL if alike else style[0]
            for panel, quantity in zip(panels, _QUANTITIES, strict=True):
                factor = _AXES[quantity][1]
                _samples(panel, curve, quantity, style, size)
                y, half = (factor * getattr(fine, f"{quantity}{end}") for end in ("", "_band"))
                label = "model" if alike else f"model of {curve.name}"
                panel.plot(x, y, color=line, linewidth=1.5, label=label, zorder=2)
                panel.fill_between(
                    x, y - half, y + half, color=line, alpha=0.2, linewidth=0.0, zorder=1,
                    label=f"its {100.0 * LEVEL:g} % band",
                )  # fmt: skip
    _legend(figure)
    return figure


def residuals_figure(fit: Fit) -> Figure:
    """Residuals over their deviations against amplitude, beside lines at two deviations."""
    figure, rows = _figure_of(fit, "model less measured,\nover deviation")
    for panels, own, size in rows:
        for panel, quantity in zip(panels, _QUANTITIES, strict=True):
            panel.set_title(quantity, loc="right", fontsize="medium")
            panel.axhspan(-2.0, 2.0, color="0.92", zorder=0, label="two deviations")
            panel.axhline(0.0, color="0.5", linewidth=0.8, zorder=1)
            for k in own:
                curve, r = fit.problem.curves[k], _residuals(fit, k, quantity)
                for chosen, how, label in _kinds(curve, ~np.isnan(r), _style(k)):
                    panel.plot(
                        curve.amplitude[chosen] / size, r[chosen], linestyle="none", label=label,
                        **how,
                    )  # fmt: skip
    _legend(figure)
    return figure


def _figure_of(fit: Fit, label: str = "") -> tuple[Figure, list[tuple[Any, list[int], float]]]:
    """Figure with two panels for each mode and quantity, their curves and the unit's size."""
    groups: dict[tuple[int, str], list[int]] = {}
    for k, curve in enumerate(fit.problem.curves):
        groups.setdefault((curve.mode, curve.quantity), []).append(k)
    figure = new_figure(8.5, 0.6 + 3.5 * len(groups))
    grid = figure.subplots(len(groups), 2, squeeze=False)
    rows = []
    for panels, ((mode, quantity), own) in zip(grid, groups.items(), strict=True):
        of_all = [fit.problem.curves[k] for k in own]
        unit, size = prefixed_unit(_unit(quantity), [curve.amplitude for curve in of_all])
        if size > 1.0:  # nobody uses km/s²
            unit, size = _unit(quantity), 1.0
        points = {curve.point for curve in of_all}
        point = points.pop() if len(points) == 1 else ""
        for panel, name in zip(panels, _QUANTITIES, strict=True):
            panel.set_xscale("log")
            panel.set_xlabel(f"{quantity} amplitude{f' of {point}' * bool(point)}, {unit}")
            panel.set_ylabel(label or _AXES[name][0])
            plain_ticks(panel.xaxis)
            panel.grid(alpha=0.3)
            panel.set_axisbelow(True)
            panel.ticklabel_format(axis="y", useOffset=False)
        panels[0].set_title(f"mode {mode}", loc="left", fontsize="medium")
        rows.append((panels, own, size))
    return figure, rows


def _style(k: int) -> tuple[str, str]:
    """Colour and marker of a data set."""
    return _COLOURS[k % len(_COLOURS)], _MARKS[k % len(_MARKS)]


def _samples(
    panel: Any, curve: MeasuredCurve, quantity: str, style: tuple[str, str], size: float
) -> None:
    """Draw measured samples with their deviations; filled those that are fitted."""
    factor = _AXES[quantity][1]
    y, deviation = getattr(curve, quantity), getattr(curve, f"{quantity}_deviation")
    for chosen, how, label in _kinds(curve, ~np.isnan(y), style):
        panel.errorbar(
            curve.amplitude[chosen] / size, factor * y[chosen], factor * deviation[chosen],
            linestyle="none", capsize=2.0, elinewidth=1.0, label=label, zorder=3, **how,
        )  # fmt: skip


def _kinds(
    curve: MeasuredCurve, known: Any, style: tuple[str, str]
) -> Iterator[tuple[Any, dict[str, Any], str]]:
    """Which samples are fitted and which are compared only, with the look and name of each."""
    colour, mark = style
    look = {"color": colour, "marker": mark, "markersize": 5.0}
    fitted, rest = known & curve.fitted, known & ~curve.fitted
    if fitted.any():
        yield fitted, look, curve.name
    if rest.any():
        yield rest, {**look, "markerfacecolor": "white"}, f"{curve.name}, not fitted"


def _legend(figure: Figure) -> None:
    """Legend of the curves of all panels above them, each once."""
    entries: dict[str, Any] = {}
    for panel in figure.axes:
        handles, labels = panel.get_legend_handles_labels()
        for label, handle in zip(labels, handles, strict=True):
            entries.setdefault(label, handle)
    figure.legend(
        [*entries.values()], [*entries], loc="outside upper center", ncols=4, fontsize="small"
    )


def _what_is_computed(fit: Fit, k: int) -> tuple[Any, ...]:
    """What the curve of the model beside a measured one depends on."""
    weights = fit.problem.curves[k].weights(fit.problem.model.points)
    return (*np.abs(weights).tolist(), *shifts(fit, k).values())


def _unit(quantity: str) -> str:
    """SI unit of an amplitude, as it is read."""
    return next(iter(AMPLITUDES[quantity])).replace("2", "²")


def _named(fit: Fit) -> dict[str, float]:
    """Best values and offsets."""
    return {**fit.values, **fit.offsets}


def _residuals(fit: Fit, k: int, quantity: str) -> FloatArray:
    """Model less measured over the standard deviation, of all samples of a curve; nan if none."""
    curve, predicted = fit.problem.curves[k], fit.predicted[k]
    model = getattr(predicted, quantity) + shifts(fit, k)[quantity]
    r = (model - getattr(curve, quantity)) / getattr(curve, f"{quantity}_deviation")
    return np.where(predicted.inside, r, np.nan)


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
                "name": curve.name,
                "point": curve.point,
                "mode": curve.mode,
                "quantity": curve.quantity,
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


def _value_rows(fit: Fit) -> Iterator[list[Any]]:
    yield ["name", "best", "deviation", "lowest", "highest", "lower_bound", "upper_bound"]
    for k, (name, best) in enumerate(_named(fit).items()):
        bounds = fit.problem.lowest[k], fit.problem.highest[k]
        yield [name, best, fit.deviations[name], *fit.interval(name), *bounds]


def _profile_rows(profiles: Sequence[Profile]) -> Iterator[list[Any]]:
    yield ["name", "value", "excess_of_squares"]
    for profile in profiles:
        for value, excess in zip(profile.values, profile.excess, strict=True):
            yield [profile.name, float(value), float(excess)]


def _residual_rows(fit: Fit) -> Iterator[list[Any]]:
    yield [
        "data", "mode", "quantity", "amplitude", "unit", "fitted",
        "frequency_Hz", "model_frequency_Hz", "frequency_residual",
        "damping_ratio", "model_damping_ratio", "damping_residual",
    ]  # fmt: skip
    for k, (curve, predicted) in enumerate(zip(fit.problem.curves, fit.predicted, strict=True)):
        added, columns = shifts(fit, k), list[FloatArray]()
        for quantity in _QUANTITIES:
            model = getattr(predicted, quantity) + added[quantity]
            model = np.where(predicted.inside, model, np.nan)
            columns += [getattr(curve, quantity), model, _residuals(fit, k, quantity)]
        for i, amplitude in enumerate(curve.amplitude):
            yield [
                curve.name, curve.mode, curve.quantity, amplitude, _unit(curve.quantity),
                bool(curve.fitted[i]), *(column[i] for column in columns),
            ]  # fmt: skip


def _curve_rows(curves: Sequence[FineCurve]) -> Iterator[list[Any]]:
    yield [
        "data", "mode", "quantity", "amplitude", "unit",
        "frequency_Hz", "frequency_band_Hz", "damping_ratio", "damping_ratio_band",
    ]  # fmt: skip
    for fine in curves:
        curve = fine.measured
        for row in zip(
            fine.amplitude, fine.frequency, fine.frequency_band, fine.damping, fine.damping_band,
            strict=True,
        ):  # fmt: skip
            of_curve = curve.name, curve.mode, curve.quantity, row[0], _unit(curve.quantity)
            yield [*of_curve, *row[1:]]


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
