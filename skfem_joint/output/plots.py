"""Curves and maps of results: histories, hysteresis loops, modes, energies, and active regions.

Each function builds a figure; :func:`save_figure` writes it. Nothing touches matplotlib's global
state. All raise InputError for what does not fit, and where matplotlib is missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.body.body import Body
from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import needed, replacing
from skfem_joint.joint.patch import Patch
from skfem_joint.reduction.pod import ProperModes
from skfem_joint.results.borders import of_cells, smoothed, spread, touching
from skfem_joint.results.history import hysteresis_loop
from skfem_joint.runs.last_cycle import steady_state
from skfem_joint.stepping.recording import Run
from skfem_joint.study.error_time import RMS, Measured, front

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Resolution of pictures, pixels an inch.
DPI = 150
# Curves below this share of the largest are round-off, and are not drawn.
_AT_REST = 1e-9

# The full model is broad, pale and solid. The others are drawn over it, thin, dark and broken, so
# that equal curves can be told apart, in grey too. A single curve needs none of that.
_FULL: dict[str, Any] = {"color": "#7fb2e5", "linewidth": 3.2, "linestyle": "-"}
_OTHERS: tuple[dict[str, Any], ...] = (
    {"color": "#9c1c00", "linewidth": 1.4, "linestyle": "--"},
    {"color": "#1a1a1a", "linewidth": 1.4, "linestyle": ":"},
    {"color": "#2e6b2e", "linewidth": 1.4, "linestyle": "-."},
)
_ALONE: dict[str, Any] = {"color": "#1f5fa8", "linewidth": 1.2, "linestyle": "-"}
# Colours and lines of the modes in a picture of modes, which shows as many.
_MODES = (
    ("#000000", "-"),
    ("#a33b00", "--"),
    ("#1f5fa8", "-."),
    ("#2e7d32", ":"),
    ("#8d5fb0", (0, (6, 1, 1, 1, 1, 1))),
)


def new_figure(width: float, height: float, layout: Any = "constrained") -> Figure:
    """Empty figure of a size in inches."""
    library: Any = needed("matplotlib.figure", "plot")
    figure: Figure = library.Figure(figsize=(width, height), layout=layout)
    return figure


def save_figure(path: Path, figure: Figure) -> Path:
    """Write a figure as a PNG that takes its place when it is whole."""
    from matplotlib import rc_context

    # Without chunks, Agg gives up on a curve of very many points that fill the panel.
    with replacing(path) as temporary, rc_context({"agg.path.chunksize": 20_000}):
        figure.savefig(temporary, format="png", dpi=DPI)
    return path


def new_panels(
    width: float, height: float, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, Any]:
    """Figure with panels of a size each in inches, row by row; options as of `Figure.subplots`."""
    figure = new_figure(columns * width, rows * height)
    share = columns == 1
    panels = figure.subplots(rows, columns, sharex=share, squeeze=False, **options).ravel()
    for panel in panels:
        panel.grid(alpha=0.3)
        panel.set_axisbelow(True)
    return figure, panels


def prefixed_unit(unit: str, arrays: Iterable[FloatArray]) -> tuple[str, float]:
    """Return the unit with the SI prefix that suits the largest value, and its size."""
    largest = max((float(np.max(np.abs(array), initial=0.0)) for array in arrays), default=0.0)
    for prefix, size in (("M", 1e6), ("k", 1e3), ("", 1.0), ("m", 1e-3), ("µ", 1e-6), ("n", 1e-9)):
        if largest >= size and not (unit == "s" and size > 1.0):
            return prefix + unit, size
    return unit, 1.0


def plain_ticks(axis: Any) -> None:
    """Label 1, 2 and 5 of each decade of a logarithmic axis in numbers; fewer of many decades."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

    low, high = sorted(axis.get_view_interval())
    subs: Sequence[float] = (1.0, 2.0, 5.0) if high <= 1e3 * low else (1.0,)
    if high <= 10.0 * low:
        subs = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_locator(NullLocator())


def histories_figure(runs: Mapping[str, Run], points: Sequence[str]) -> Figure:
    """Displacement of named points over time, one panel for each that moves.

    A point at rest beside the others, such as a component that is zero by symmetry, has no panel,
    and points that move alike share the first one's. ``runs`` are named in the legend; the run
    "full" is drawn solid beside others. Long histories are drawn as an `envelope`.
    """
    moving = _moving(runs, points)
    figure, panels = new_panels(7.5, 2.2 + 1.0 / len(moving), rows=len(moving))
    time_unit, time_scale = prefixed_unit("s", (run.times for run in runs.values()))
    for panel, point in zip(panels, moving, strict=True):
        unit, scale = prefixed_unit("m", (run.point(point) for run in runs.values()))
        title, filled = point, True
        for (name, run), style in zip(runs.items(), _styles(runs), strict=True):
            times, u = run.times / time_scale, run.point(point) / scale
            if (band := envelope(times, u)) is None:
                panel.plot(times, u, label=name, **style)
            else:
                face = (style["color"], 0.3) if filled else "none"
                panel.fill_between(*band, label=name, **style, facecolor=face)
                part, size = prefixed_unit("s", [np.diff(band[0][:2]) * time_scale])
                each = f"{(band[0][1] - band[0][0]) * time_scale / size:.3g} {part}"
                title, filled = f"{point}: least and largest in each {each}", False
        panel.set(ylabel=f"displacement, {unit}", xmargin=0.0)
        panel.set_title(title, loc="left")
    panels[-1].set_xlabel(f"time, {time_unit}")
    legend_above(figure)
    return figure


def envelope(
    times: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Band of a history with very many cycles: ends of parts, least and largest values in them.

    There are at most 400 parts, of two cycles or more. None for a history that crosses its mean at
    most 300 times (values near the mean do not count): a curve shows each of its cycles.
    """
    away = values - 0.5 * (values.max(initial=-np.inf) + values.min(initial=np.inf))
    far = away[np.abs(away) > 0.01 * np.abs(away).max(initial=0.0)]
    crossings = int(np.count_nonzero(np.diff(np.sign(far))))
    if crossings <= 300:
        return None
    starts = np.linspace(0, values.size, min(400, crossings // 4), endpoint=False).astype(int)
    low, high = (part.reduceat(values, starts) for part in (np.minimum, np.maximum))
    # From the first to the last time, each part's values at its end.
    ends = times[np.append(starts, values.size - 1)]
    return ends, np.append(low[0], low), np.append(high[0], high)


def _moving(runs: Mapping[str, Run], points: Sequence[str]) -> list[str]:
    """Points that move, without those that move as an earlier point does."""
    if not runs or not points or min(run.times.size for run in runs.values()) == 0:
        raise InputError("histories: found no runs, no points, or a run that stored no points")
    moves = [np.concatenate([run.point(point) for run in runs.values()]) for point in points]
    largest = _AT_REST * max(np.abs(u).max() for u in moves)
    drawn: dict[str, FloatArray] = {}
    for point, u in zip(points, moves, strict=True):
        others = [np.zeros(1), *drawn.values()]
        if all(np.abs(u - other).max() > largest for other in others) or largest == 0.0:
            drawn[point] = u
    return list(drawn)


def hysteresis_figure(
    runs: Mapping[str, Run],
    point: str,
    load: int,
    cycle_rows: int | None,
    lost: Mapping[str, str] | None = None,
) -> Figure:
    """Force of a load over the displacement of a point, in the last cycle.

    ``load`` is the number of the load, from 0; ``cycle_rows`` the number of stored rows in a cycle,
    None for the whole run; ``lost`` what the legend says of each run's loss. The title says so if
    the cycle is not steady.
    """
    _moving(runs, [point])  # refuses what is not there
    loops = [hysteresis_loop(run, point, load, cycle_rows) for run in runs.values()]
    states = [run.steady or steady_state(run) for run in runs.values()]
    transient = any(state is None or not getattr(state, "reached", True) for state in states)
    unit, scale = prefixed_unit("m", (u for u, _ in loops))
    force_unit, force_scale = prefixed_unit("N", (force for _, force in loops))
    figure, (panel,) = new_panels(6.0, 5.0)
    for name, (u, force), style in zip(runs, loops, _styles(runs), strict=True):
        panel.plot(u / scale, force / force_scale, label=_with(name, lost), **style)
    loaded = sorted({run.system.loads[load].on for run in runs.values()} - {""})
    where = f" on {' and '.join(loaded)}" if loaded else ""
    panel.set(xlabel=f"displacement of {point}, {unit}", ylabel=f"force{where}, {force_unit}")
    shown = "last cycle" + ", not steady yet" * transient
    panel.set_title("from rest on" if cycle_rows is None else shown, loc="left")
    legend_above(figure)
    return figure


def joint_loops_figure(runs: Mapping[str, Run]) -> Figure:
    """Friction force of each joint over its slip in quasi-static runs, a panel for each joint.

    The last cycle is drawn in full strength, what was before it pale. Titles have the energy of the
    last cycle, or of the run without cycles, and the secant stiffness of the first model. Joints
    that do not slip have no panel.
    """
    known = {name: run.loops for name, run in runs.items() if run.loops is not None}
    joints = next(iter(runs.values())).system.contact.joints
    most = [max(np.ptp(loops.slip[:, k]) for loops in known.values()) for k in range(len(joints))]
    moving = [k for k, slip in enumerate(most) if slip > _AT_REST * max(most)]
    if not moving:
        raise InputError("joint loops: found no quasi-static run in which a joint slips")
    columns = min(len(moving), 3)
    figure, panels = new_panels(4.8, 4.4, -(-len(moving) // columns), columns)
    for panel in panels[len(moving) :]:
        panel.set_axis_off()
    for panel, k in zip(panels, moving, strict=False):
        unit, scale = prefixed_unit("m", (loops.slip[:, k] for loops in known.values()))
        force_unit, size = prefixed_unit("N", (loops.force[:, k] for loops in known.values()))
        for (name, loops), style in zip(known.items(), _styles(known), strict=True):
            slip, force = loops.slip[:, k] / scale, loops.force[:, k] / size
            before = slice(0, (loops.last.start or 0) + 1)
            panel.plot(slip[before], force[before], **style, alpha=0.4)
            panel.plot(slip[loops.last], force[loops.last], label=name, **style)
        first = next(iter(known.values()))
        energy_unit, energy_size = prefixed_unit("J", [first.energy[[k]]])
        each = " a cycle" * (first.opening is not None)
        panel.set_title(
            f"{joints[k]}: {first.energy[k] / energy_size:.4g} {energy_unit}{each},\n"
            f"secant stiffness {first.secant_stiffness[k]:.4g} N/m",
            loc="left",
            fontsize="medium",
        )
        panel.set(xlabel=f"mean slip, {unit}", ylabel=f"friction force, {force_unit}")
    legend_above(figure)
    return figure


def is_loop(runs: Mapping[str, Run], point: str, load: int, cycle_rows: int) -> bool:
    """Whether each run's last cycle ends where it began, to a twentieth of its size."""
    loops = [hysteresis_loop(run, point, load, cycle_rows)[0] for run in runs.values()]
    return all(abs(u[-1] - u[0]) <= 0.05 * np.ptp(u) != 0.0 for u in loops)


def modes_figure(xi: FloatArray, proper: ProperModes, whose: str) -> Figure:
    """First five modes over positions on the unit active length, each with the largest value 1.

    ``whose`` says what moves in these modes, for the title.
    """
    modes, values = proper.modes.T, proper.proper_values
    figure, (panel,) = new_panels(7.5, 4.5)
    panel.axhline(0.0, color="0.6", linewidth=0.8)
    for k, (mode, value, style) in enumerate(zip(modes, values, _MODES, strict=False), 1):
        largest, (colour, line) = mode[np.argmax(np.abs(mode))], style
        panel.plot(
            xi, mode / (largest or 1.0), color=colour, linestyle=line, linewidth=1.8,
            label=f"{k}: {value:.3g} %",
        )  # fmt: skip
    panel.set_title(f"proper orthogonal modes of\n{whose}", loc="left")
    panel.set(
        xlabel="position on the active length, ξ (1 = loaded end)",
        ylabel="mode, relative to its largest value",
        xmargin=0.0,
    )
    figure.legend(loc="outside right center", title="mode: proper value", alignment="left")
    return figure


def proper_values_figure(proper: ProperModes, whose: str) -> Figure:
    """Proper values (percent, logarithmic) and their cumulative sum, with a line at 99 %."""
    values, sums = proper.proper_values, proper.cumulative
    count = min(20, int(np.count_nonzero(values > 1e-12 * values[0])))
    number = np.arange(1, count + 1)
    figure, (left, right) = new_panels(4.0, 3.8, columns=2)
    figure.suptitle(f"proper orthogonal modes of {whose}")
    left.bar(number, values[:count], color="#7fb2e5", edgecolor="#1a1a1a", linewidth=0.6)
    left.set(yscale="log", ylabel="proper value, % of the sum")
    right.plot(number, sums[:count], color="#9c1c00", marker="o", markersize=4, linewidth=1.2)
    right.axhline(99.0, color="0.4", linestyle="--", linewidth=1.0, label="99 %")
    right.set(ylabel="cumulative sum, %")
    right.legend(loc="lower right")
    for panel in (left, right):
        panel.set(xlabel="number of the mode", xlim=(0.4, count + 0.6))
        panel.set_xticks(number if count <= 10 else [1, *range(5, count + 1, 5)])
    return figure


def _with(name: str, lost: Mapping[str, str] | None) -> str:
    """Name of a run for a legend, with what is said of its loss."""
    return f"{name}: {lost[name]}" if lost and lost.get(name) else name


def energies_figure(runs: Mapping[str, Run], lost: Mapping[str, str] | None = None) -> Figure:
    """Input, friction, viscous and scheme work of each cycle; works that are zero have no panel.

    ``lost`` is what the legend says of each run's loss.
    """
    cycles = [run.cycles for run in runs.values()]
    works = {"input": [works_of.input.sum(axis=1) for works_of in cycles]}
    works |= {
        name: [getattr(works_of, name) for works_of in cycles]
        for name in ("friction", "viscous", "scheme")
    }
    size = {name: max(np.abs(work).max(initial=0.0) for work in works[name]) for name in works}
    titles = [name for name in works if size[name] > _AT_REST * size["input"]] or ["input"]
    columns = 2 if len(titles) == 4 else len(titles)
    figure, panels = new_panels(3.8, 3.0, len(titles) // columns, columns)
    for panel, title in zip(panels, titles, strict=True):
        unit, scale = prefixed_unit("J", works[title])
        for name, work, style in zip(runs, works[title], _styles(runs), strict=True):
            number = np.arange(1, work.size + 1)
            marks = {"marker": "o", "markersize": 4} if work.size <= 50 else {}
            panel.plot(number, work / scale, label=_with(name, lost), **marks, **style)
        panel.axhline(0.0, color="0.6", linewidth=0.8, zorder=1)
        panel.set_title(title, loc="left")
        panel.set(xlabel="cycle", ylabel=f"work in the cycle, {unit}")
        panel.xaxis.get_major_locator().set_params(integer=True)
    legend_above(figure)
    return figure


def error_time_figure(points: Sequence[Measured], total: bool = False) -> Figure:
    """Error against run time with the front, in ``total`` with off-line time."""
    figure, panels = new_panels(6.5, 5.5, columns=2)
    families = dict.fromkeys(p.job.family for p in points if p.counts)
    shown = "off-line and run time (s)" if total else "run time (s)"
    for panel, name in zip(panels, (RMS, "friction_energy"), strict=True):
        known = [p for p in points if p.counts and 0.0 < p.error(name) < np.inf]
        for family, marker in zip(families, cycle("oDs^vPx*h+1234"), strict=False):
            some = [p for p in known if p.job.family == family]
            places = [p.seconds(total) for p in some], [p.error(name) for p in some]
            panel.plot(*places, marker, label=family, alpha=0.85)
        ahead = front(known, name, total)
        places = [p.seconds(total) for p in ahead], [p.error(name) for p in ahead]
        panel.step(*places, "k-", where="post", linewidth=1.0, label="front: fastest at an error")
        if known:  # a logarithmic axis refuses to be empty
            panel.set(xscale="log", yscale="log")
        panel.set_xlabel(shown)
        panel.set_ylabel(f"relative error: {name.replace('_', ' ')}")
    handles = panels[0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=4, fontsize=9)
    return figure


def sweep_curves_figure(
    xlabel: str,
    values: Sequence[Any],
    results: Mapping[str, Sequence[float | None]],
    label: str,
    unit: str,
    *,
    log: bool = False,
) -> Figure:
    """Result of each model over the values of one key, numbers or words; gaps where there is none.

    ``log`` sets the values in equal ratios; ``unit`` is that of the results, "%" of shares.
    """
    unit, scaled = _scaled(results, unit)
    figure, (panel,) = new_panels(7.0, 4.2)
    numbers = all(isinstance(value, int | float) for value in values)
    places = np.array(values if numbers else [str(value) for value in values])
    order = places.argsort() if numbers else slice(None)
    for (name, result), style in zip(scaled.items(), _styles(results), strict=True):
        panel.plot(places[order], result[order], label=name, marker="o", markersize=5, **style)
    panel.set(xlabel=xlabel, ylabel=f"{label}{unit}")
    if log:
        panel.set_xscale("log")
    legend_above(figure)
    return figure


def sweep_maps_figure(
    across: tuple[str, Sequence[Any]],
    up: tuple[str, Sequence[Any]],
    results: Mapping[str, Sequence[float | None]],
    label: str,
    unit: str,
) -> Figure:
    """Result of each model over the values of two keys, a panel each; grey where there is none.

    Each key comes with its label; cells are of one size, whatever the distance of their values.
    """
    unit, scaled = _scaled(results, unit)
    columns, rows = (list(dict.fromkeys(map(_short, values))) for _, values in (across, up))
    place = [rows.index(_short(v)) for v in up[1]], [columns.index(_short(v)) for v in across[1]]
    figure = new_figure(0.6 + 5.0 * len(results), 4.8)
    figure.suptitle(f"{label}{unit}")
    panels = figure.subplots(1, len(results), sharey=True, squeeze=False)[0]
    for panel, (name, result) in zip(panels, scaled.items(), strict=True):
        grid = np.full((len(rows), len(columns)), np.nan)
        grid[place] = result
        image = panel.imshow(grid, origin="lower", aspect="auto", cmap="viridis")
        panel.set(facecolor="0.8", xlabel=across[0])
        panel.set_title(name, loc="left")
        for axis, names in ((panel.xaxis, columns), (panel.yaxis, rows)):
            ticks = np.arange(0, len(names), -(-len(names) // 8))
            axis.set_ticks(ticks, [names[tick] for tick in ticks])
        if len(rows) <= 12 and len(columns) <= 8:
            for (i, j), value in np.ndenumerate(grid):
                dark = image.norm(value) < 0.6 if np.isfinite(value) else False
                text = f"{value:.4g}" if np.isfinite(value) else "none"
                panel.text(j, i, text, ha="center", va="center", color="w" if dark else "k")
        figure.colorbar(image, ax=panel, location="bottom", aspect=40)
    panels[0].set_ylabel(up[0])
    return figure


def _short(value: Any) -> str:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return f"{value:.6g}" if is_number else str(value)


def _scaled(
    results: Mapping[str, Sequence[float | None]], unit: str
) -> tuple[str, dict[str, FloatArray]]:
    """Unit with a comma before it and results in it; not a number where there is none."""
    values = {name: np.array(result, dtype=float) for name, result in results.items()}
    finite = [result[np.isfinite(result)] for result in values.values()]
    unit, scale = prefixed_unit(unit, finite) if len(unit) == 1 and unit != "%" else (unit, 1.0)
    scale = 0.01 if unit == "%" else scale
    return f", {unit}" * bool(unit), {name: result / scale for name, result in values.items()}


def _styles(runs: Mapping[str, Any]) -> list[dict[str, Any]]:
    others = cycle(_OTHERS if len(runs) > 1 else (_ALONE,))
    return [_FULL if name == "full" and len(runs) > 1 else next(others) for name in runs]


def legend_above(figure: Figure, **look: Any) -> None:
    """Legend of the curves of all panels, each once, above them, where it hides nothing."""
    each: dict[str, Any] = {}
    for panel in figure.axes:
        handles, labels = panel.get_legend_handles_labels()
        each |= dict(zip(labels, handles, strict=True))
    columns = 1 if any("\n" in label for label in each) else 4  # broad ones below each other
    figure.legend(
        [*each.values()], [*each], loc="outside upper center", ncols=columns, handlelength=3.0,
        **look,
    )  # fmt: skip


def active_region_figure(
    body: Body, patch: Patch, largest_slip: FloatArray, active: BoolArray
) -> Figure:
    """Where a joint has slipped: an area from above, a line as a curve along it.

    Of each of its k contact points ``largest_slip`` (k,) is the largest norm of the slip (m),
    ``active`` (k,) whether it belongs to the active region, whose share of the contact's area
    stands in the title.
    """
    share = 100.0 * float(patch.area[active].sum() / (patch.area.sum() + patch.held_area))
    unit, scale = prefixed_unit("m", [largest_slip])
    figure = _over_contact(body, patch, largest_slip / scale, active, ("largest slip", unit))
    figure.suptitle(f"{patch.joint.name}: active on {share:.1f} % of the area")
    return figure


def friction_work_figure(body: Body, patch: Patch, work: FloatArray) -> Figure:
    """Energy that friction takes of a joint in a run, by area, drawn as `active_region_figure`.

    ``work`` (k,) is that of each of its k contact points (J).
    """
    unit, scale = prefixed_unit("J", [work / patch.area])
    label = "friction work over the run", f"{unit}/m²"
    figure = _over_contact(body, patch, work / patch.area / scale, None, label)
    figure.suptitle(f"{patch.joint.name}: {work.sum():.4g} J over the run")
    return figure


def _over_contact(
    body: Body, patch: Patch, values: FloatArray, active: BoolArray | None, label: tuple[str, str]
) -> Figure:
    """Values of contact points over an area or along a line; what is not active is told apart.

    ``label`` has the name of the values and their unit.
    """
    held = patch.held_nodes.size
    # Held nodes do not slip.
    nodes = np.concatenate([patch.nodes, patch.held_nodes])
    values = np.concatenate([values, np.zeros(held)])
    if active is not None:
        active = np.concatenate([active, np.zeros(held, dtype=bool)])
    length, size = prefixed_unit("m", [body.nodes[nodes]])
    place, corners = body.nodes[nodes] / size, patch.cells.shape[1]
    # A line along its longest direction; an area in its two longest.
    axes = np.sort(np.argsort(-np.ptp(place, axis=0))[: 1 if corners == 2 else 2])
    names = [f"{'xyz'[axis] if body.dim > 1 else 'position'}, {length}" for axis in axes]
    if corners == 2:
        figure, (panel,) = new_panels(7.5, 3.5)
        order = np.argsort(along := place[:, axes[0]])
        if active is not None:
            panel.fill_between(
                along[order], 0.0, 1.0, where=active[order], label="active", linewidth=0.0,
                transform=panel.get_xaxis_transform(), color="#f08a24", alpha=0.3,
            )  # fmt: skip
        panel.plot(along[order], values[order], color="#1a1a1a", marker=".", label=label[0])
        panel.set(ylabel=", ".join(label), xmargin=0.0)
        panel.set_ylim(bottom=0.0)
        panel.legend(loc="best")
    else:
        wide, tall = np.ptp(place[:, axes], axis=0)
        height = float(np.clip(2.4 + 6.8 * tall / wide, 2.7, 9.0))
        figure = new_figure(float(np.clip(2.6 + 7.0 * wide / tall, 4.5, 8.0)), height, "compressed")
        panel = figure.subplots()
        _area(panel, body.nodes[:, axes] / size, patch, nodes, values, active, ", ".join(label))
    panel.set(**dict(zip(("xlabel", "ylabel"), names, strict=False)))
    return figure


def _area(
    panel: Any, place: FloatArray, patch: Patch, nodes: IntArray, values: FloatArray,
    active: BoolArray | None, label: str,
) -> None:  # fmt: skip
    """Colour a contact seen from above by values; its cells at its border are drawn in part.

    What is not active is faded, with the border between.
    """
    from matplotlib.tri import Triangulation

    cells, width = patch.cells[np.isin(patch.cells, nodes).any(axis=1)], patch.cells.shape[1]
    used, number = np.unique(cells, return_inverse=True)
    place, cells, nodes = place[used], number.reshape(-1, width), np.searchsorted(used, nodes)
    sums = of_cells(cells.ravel(), width * np.arange(len(cells) + 1), used.size)
    triangles = cells if width == 3 else np.vstack([cells[:, :3], cells[:, [0, 2, 3]]])
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    grid = Triangulation(place[:, 0], place[:, 1], triangles)
    pressed, of_nodes, border, contact = np.zeros((4, used.size))
    pressure = patch.normal_force / patch.area
    pressed[nodes] = pressure.max(initial=0.0)  # where it is held too
    pressed[nodes[: pressure.size]] = pressure
    of_nodes[nodes], contact[nodes] = values, True
    known = contact > 0.0
    artists = [
        panel.tripcolor(
            grid, spread(sums, of_nodes, known), shading="gouraud", vmin=0.0,
            cmap="viridis" if active is not None else "magma", vmax=values.max() or 1.0,
        )
    ]  # fmt: skip
    ends = place[nodes]
    side = "bottom" if np.ptp(ends[:, 0]) > np.ptp(ends[:, 1]) else "right"
    panel.figure.colorbar(artists[0], ax=panel, label=label, location=side, aspect=40)
    if active is not None:
        border[nodes] = active
        artists += _faded(panel, grid, smoothed(sums, border, known), active)
    if not known.all():
        # A field whose contour 0.5 is the border of the contact.
        inside = panel.tricontourf(grid, touching(sums, pressed), levels=[0.5, 2.0])
        (path,) = inside.get_paths()
        for artist in artists:
            artist.set_clip_path(path, panel.transData)
        inside.remove()
        ends = path.vertices
    panel.set(aspect="equal")
    panel.use_sticky_edges = False
    low, high = ends.min(axis=0), ends.max(axis=0)
    (left, lowest), (right, highest) = low - 0.02 * (high - low), high + 0.02 * (high - low)
    panel.set(xlim=(left, right), ylim=(lowest, highest))


def _faded(panel: Any, grid: Any, border: FloatArray, active: BoolArray) -> list[Any]:
    """Fade what is not active, with a line at its border, and say so; returns the artists."""
    artists = []
    if not active.all():
        faded = {"levels": [-1.0, 0.5], "colors": "w", "alpha": 0.75}
        artists.append(panel.tricontourf(grid, border, **faded))
    if active.any() and not active.all():
        for colour, thick in (("#ffffff", 4.5), ("#d11f1f", 2.5)):
            line = {"levels": [0.5], "colors": colour, "linewidths": thick}
            artists.append(panel.tricontour(grid, border, **line))
    told = "faded: not active; red line: border between"
    if active.all():
        told = "all of it active"
    panel.set_title(told if active.any() else "faded: nothing is active", fontsize="small")
    return artists
