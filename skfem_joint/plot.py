"""Pictures of results: histories, hysteresis loops, proper orthogonal modes and energies.

Each picture comes as a function that builds the figure (``..._figure``, for notebooks and for
changing it) and one that writes it as a PNG. Nothing touches matplotlib's global state.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.files import replacing
from skfem_joint.history import hysteresis_loop
from skfem_joint.pod import ProperModes
from skfem_joint.recording import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

#: Dots per inch of the written pictures.
DPI = 150

# The full model is broad, pale and solid; the others go over it thin, dark and broken, so that
# curves on top of each other stay apart, in grey too.
_FULL: dict[str, Any] = {"color": "#7fb2e5", "linewidth": 3.2, "linestyle": "-"}
_OTHERS: tuple[dict[str, Any], ...] = (
    {"color": "#9c1c00", "linewidth": 1.4, "linestyle": "--"},
    {"color": "#1a1a1a", "linewidth": 1.4, "linestyle": ":"},
    {"color": "#2e6b2e", "linewidth": 1.4, "linestyle": "-."},
)
_HATCHES = ("", "///", "...", "xxx")

#: Modes in a picture of modes, and values in a picture of values.
MODES, VALUES = 5, 20


def histories_figure(runs: Mapping[str, Run], points: Sequence[str]) -> Figure:
    """Displacement of named points over time, one panel a point; see :func:`histories`."""
    _check_points(runs, points)
    figure = new_figure(7.5, 1.0 + 2.2 * len(points))
    panels = figure.subplots(len(points), 1, sharex=True, squeeze=False)[:, 0]
    time_unit, time_scale = prefixed_unit("s", (run.times for run in runs.values()))
    for panel, point in zip(panels, points, strict=True):
        unit, scale = prefixed_unit("m", (run.point(point) for run in runs.values()))
        for (name, run), style in zip(runs.items(), _styles(runs), strict=True):
            panel.plot(run.times / time_scale, run.point(point) / scale, label=name, **style)
        panel.set_ylabel(f"displacement, {unit}")
        panel.set_title(point, loc="left")
        panel.margins(x=0.0)
        panel.grid(alpha=0.3)
    panels[-1].set_xlabel(f"time, {time_unit}")
    _legend_above(figure, panels[0])
    return figure


def hysteresis_figure(
    runs: Mapping[str, Run], point: str, load_index: int = 0, cycle_rows: int | None = None
) -> Figure:
    """Force over displacement of a point; see :func:`hysteresis`."""
    _check_points(runs, [point])
    if cycle_rows is not None and cycle_rows < 1:
        raise InputError(f"cycle_rows: found {cycle_rows}, must be at least 1")
    for name, run in runs.items():
        if not 0 <= load_index < len(run.system.loads):
            raise InputError(
                f"{name}: no load {load_index}; it has {len(run.system.loads)}, counted from 0"
            )
    loops = []
    for run in runs.values():
        # A run that was stopped in its first cycle has nothing but that.
        rows = cycle_rows if cycle_rows is not None and run.times.size > cycle_rows else None
        loops.append(hysteresis_loop(run, point, load_index, rows))
    unit, scale = prefixed_unit("m", (u for u, _ in loops))
    force_unit, force_scale = prefixed_unit("N", (force for _, force in loops))
    figure = new_figure(6.0, 5.0)
    panel = figure.subplots()
    for name, (u, force), style in zip(runs, loops, _styles(runs), strict=True):
        panel.plot(u / scale, force / force_scale, label=name, **style)
    loaded = {run.system.loads[load_index].on for run in runs.values()} - {""}
    panel.set_xlabel(f"displacement of {point}, {unit}")
    where = f" on {' and '.join(sorted(loaded))}" if loaded else ""
    panel.set_ylabel(f"force{where}, {force_unit}")
    panel.grid(alpha=0.3)
    _legend_above(figure, panel)
    return figure


def proper_orthogonal_modes_figure(
    xi: FloatArray, modes: FloatArray, proper: ProperModes
) -> Figure:
    """First modes over the unit active length; see :func:`proper_orthogonal_modes`."""
    if xi.ndim != 1 or modes.ndim != 2 or modes.shape[0] != xi.size or modes.shape[1] == 0:
        raise InputError(
            f"modes: found shape {modes.shape} for xi of shape {xi.shape}, must be (points, modes)"
        )
    count = min(MODES, modes.shape[1], proper.proper_values.size)
    figure = new_figure(7.5, 4.5)
    panel = figure.subplots()
    lines = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)))
    shades = ("#000000", "#a33b00", "#1f5fa8", "#2e7d32", "#8d5fb0")
    panel.axhline(0.0, color="0.6", linewidth=0.8)
    for k in range(count):
        mode = modes[:, k]
        largest = mode[np.argmax(np.abs(mode))]
        panel.plot(
            xi,
            mode / largest if largest != 0.0 else mode,
            label=f"{k + 1}: {proper.proper_values[k]:.3g} %",
            color=shades[k],
            linestyle=lines[k],
            linewidth=1.8,
        )
    panel.set_xlabel("position on the active length, ξ (1 = loaded end)")
    panel.set_ylabel("mode, relative to its largest value")
    panel.margins(x=0.0)
    panel.grid(alpha=0.3)
    figure.legend(loc="outside right upper", title="mode: proper value", alignment="left")
    return figure


def proper_values_figure(proper: ProperModes) -> Figure:
    """Proper values and their cumulative sum; see :func:`proper_values`."""
    values, sums = proper.proper_values, proper.cumulative
    count = min(VALUES, int(np.count_nonzero(values > 1e-12 * values[0])))
    number = np.arange(1, count + 1)
    figure = new_figure(8.0, 3.8)
    left, right = figure.subplots(1, 2)
    left.bar(number, values[:count], color="#7fb2e5", edgecolor="#1a1a1a", linewidth=0.6)
    left.set_yscale("log")
    left.set_ylabel("proper value, % of the sum")
    right.plot(number, sums[:count], color="#9c1c00", marker="o", markersize=4, linewidth=1.2)
    right.axhline(99.0, color="0.4", linestyle="--", linewidth=1.0, label="99 %")
    right.set_ylabel("cumulative sum, %")
    right.legend(loc="lower right")
    for panel in (left, right):
        panel.set_xlabel("number of the mode")
        panel.set_xlim(0.4, count + 0.6)
        panel.set_xticks(number if count <= 10 else [1, *range(5, count + 1, 5)])
        panel.grid(alpha=0.3, axis="y")
        panel.set_axisbelow(True)
    return figure


def energies_figure(runs: Mapping[str, Run]) -> Figure:
    """Works of each cycle, or of the whole run; see :func:`energies`."""
    if not runs:
        raise InputError("runs: found none, there must be at least one to draw")
    counts = [run.cycles.friction.size for run in runs.values()]
    return _energies_of_cycles(runs) if max(counts) > 0 else _energies_of_runs(runs)


def _energies_of_cycles(runs: Mapping[str, Run]) -> Figure:
    from matplotlib.ticker import MaxNLocator

    parts = {
        name: {
            "input": run.cycles.input.sum(axis=1),
            "friction": run.cycles.friction,
            "viscous": run.cycles.viscous,
            "scheme": run.cycles.scheme,
        }
        for name, run in runs.items()
    }
    figure = new_figure(8.0, 5.5)
    panels = figure.subplots(2, 2, sharex=True)
    for panel, title in zip(panels.flat, ("input", "friction", "viscous", "scheme"), strict=True):
        unit, scale = prefixed_unit("J", (part[title] for part in parts.values()))
        for (name, part), style in zip(parts.items(), _styles(runs), strict=True):
            number = np.arange(1, part[title].size + 1)
            panel.plot(number, part[title] / scale, label=name, marker="o", markersize=4, **style)
        panel.axhline(0.0, color="0.6", linewidth=0.8, zorder=1)
        panel.set_title(title, loc="left")
        panel.set_ylabel(f"work in the cycle, {unit}")
        panel.grid(alpha=0.3)
    for panel in panels[-1]:
        panel.set_xlabel("cycle")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
    _legend_above(figure, panels[0, 0])
    return figure


def _energies_of_runs(runs: Mapping[str, Run]) -> Figure:
    labels = ("input", "friction", "viscous", "scheme", "change of\nstored energy")
    works = [
        np.array(
            [
                run.input_work.sum(),
                run.friction_work.sum(),
                run.viscous_work,
                run.scheme_work,
                run.stored_energy[1] - run.stored_energy[0],
            ]
        )
        for run in runs.values()
    ]
    unit, scale = prefixed_unit("J", works)
    figure = new_figure(7.0, 4.0)
    panel = figure.subplots()
    width = 0.8 / len(runs)
    place = np.arange(len(labels)) - 0.4 + 0.5 * width
    colors = cycle([_FULL["color"], "#e8c9a0", "#cccccc", "#a9cfa9"])
    for k, (name, work, color, hatch) in enumerate(
        zip(runs, works, colors, cycle(_HATCHES), strict=False)
    ):
        bars = panel.bar(
            place + k * width, work / scale, width, label=name, color=color, hatch=hatch,
            edgecolor="#1a1a1a", linewidth=0.8,
        )  # fmt: skip
        panel.bar_label(bars, fmt="%.3g", fontsize=8, padding=2)
    panel.set_xticks(np.arange(len(labels)), labels)
    panel.set_ylabel(f"energy over the run, {unit}")
    panel.axhline(0.0, color="#1a1a1a", linewidth=0.8)
    panel.margins(y=0.1)
    panel.grid(alpha=0.3, axis="y")
    panel.set_axisbelow(True)
    _legend_above(figure, panel)
    return figure


def histories(path: str | Path, runs: Mapping[str, Run], points: Sequence[str]) -> Path:
    """Write the displacement of named points over time, one panel a point.

    Parameters
    ----------
    path : str or Path
        PNG file; folders are made.
    runs : mapping of str to Run
        By the name in the legend; the one called "full" is drawn solid, the others broken.
    points : sequence of str

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        No runs or points, a run that did not store a point, a path that cannot be written, or
        matplotlib is missing.
    """
    return save_figure(path, histories_figure(runs, points))


def hysteresis(
    path: str | Path,
    runs: Mapping[str, Run],
    point: str,
    load_index: int = 0,
    cycle_rows: int | None = None,
) -> Path:
    """Write the force of a load over the displacement of a point.

    Parameters
    ----------
    path, runs
        As for :func:`histories`.
    point : str
    load_index : int
        Which of the system's loads, counted from 0.
    cycle_rows : int, optional
        Stored rows a cycle: draws the last cycle. The whole run if not given or shorter.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        As for :func:`histories`, and for a load that a run does not have.
    """
    return save_figure(path, hysteresis_figure(runs, point, load_index, cycle_rows))


def proper_orthogonal_modes(
    path: str | Path, xi: FloatArray, modes: FloatArray, proper: ProperModes
) -> Path:
    """Write the first five modes over the unit active length.

    Parameters
    ----------
    path : str or Path
    xi : ndarray, shape (points,)
        Position on the active length, 0 where it ends and 1 at the loaded end.
    modes : ndarray, shape (points, modes)
        Drawn with the largest value 1.
    proper : ProperModes
        Source of the proper values in the legend.

    Returns
    -------
    Path
    """
    return save_figure(path, proper_orthogonal_modes_figure(xi, modes, proper))


def proper_values(path: str | Path, proper: ProperModes) -> Path:
    """Write the proper values (percent, logarithmic) beside their cumulative sum and the 99 % line.

    Returns
    -------
    Path
    """
    return save_figure(path, proper_values_figure(proper))


def energies(path: str | Path, runs: Mapping[str, Run]) -> Path:
    """Write input, friction, viscous and scheme work of each cycle.

    Runs without complete cycles are drawn as bars over the whole run, with the change of the
    stored energy, which closes the balance.

    Returns
    -------
    Path
    """
    return save_figure(path, energies_figure(runs))


def new_figure(width: float, height: float) -> Figure:
    """Empty figure of a size in inches."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError(
            "plots need matplotlib: pip install 'skfem-joint[plot]', or switch them off"
        ) from error
    return Figure(figsize=(width, height), layout="constrained")


def _styles(runs: Mapping[str, Run]) -> list[dict[str, Any]]:
    others = cycle(_OTHERS)
    return [_FULL if name == "full" else next(others) for name in runs]


def _legend_above(figure: Figure, panel: Any) -> None:
    """Legend of a panel's curves above all panels, where it hides nothing."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, handlelength=3.0)


def prefixed_unit(unit: str, arrays: Iterable[FloatArray]) -> tuple[str, float]:
    """Return the unit with the SI prefix that suits the largest value, and its size."""
    largest = max((float(np.max(np.abs(array), initial=0.0)) for array in arrays), default=0.0)
    for prefix, size in (("M", 1e6), ("k", 1e3), ("", 1.0), ("m", 1e-3), ("µ", 1e-6), ("n", 1e-9)):
        if largest >= size and not (unit == "s" and size > 1.0):
            return prefix + unit, size
    return unit, 1.0


def _check_points(runs: Mapping[str, Run], points: Sequence[str]) -> None:
    if not runs or not points:
        raise InputError("runs and points: there must be at least one of each to draw")
    problems = []
    for name, run in runs.items():
        known = ", ".join(run.system.points) or "none"
        problems += [
            f"{name}: no point named {point!r}; points of this run: {known}"
            for point in points
            if point not in run.system.points
        ]
        if run.times.size == 0:
            problems.append(f"{name}: the run stored no points; integrate with Save(points=True)")
    if problems:
        raise InputError(problems)


def save_figure(path: str | Path, figure: Figure) -> Path:
    """Write a figure as a PNG that takes its place when it is whole."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    file = Path(path)
    # Without chunks, Agg gives up on a curve of very many points that fill the panel.
    with replacing(file) as temporary, rc_context({"agg.path.chunksize": 20_000}):
        FigureCanvasAgg(figure).print_figure(temporary, format="png", dpi=DPI)
    return file
