"""Impulse on the joint, section 7.2: Figs. 15, 16 and 17."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.active_length import THRESHOLD, measured
from skfem_joint.paper.aims import aim_rows, below, errors_of, points_row
from skfem_joint.paper.cases import CASES, PLAIN, scene, study
from skfem_joint.paper.figures import STYLES, figure, finish
from skfem_joint.paper.items import Item, Row, published
from skfem_joint.paper.workspace import Workspace
from skfem_joint.pod import ProperModes, proper_modes
from skfem_joint.study import Study

FloatArray = NDArray[np.float64]

CASE = CASES["VII"]
DURATION, STEP = 2e-3, 1e-6
_TIME = {"duration": DURATION, "step": STEP}
#: Shape of the pulse: the text calls it an impulse; the captions of Figs. 16 and 17 call it a step.
SHAPE, STEP_SHAPE = "triangle", "ramp_and_hold"
SHAPES = (SHAPE, "half_sine", "versine", STEP_SHAPE)
DAMPINGS = (1e-5, 1e-6, 1e-7)
#: Share of the free end's displacement above which a node counts as active, beside the default.
LOWER_THRESHOLD = 1e-4
#: Reduced models of Fig. 17 by the paper's numbers.
MODELS: dict[str, tuple[str, dict[str, Any]]] = {
    "ii": ("5 modes of the impulse", {"reference": "self", "modes": 5}),
    "iii": ("11 modes of the impulse", {"reference": "self", "modes": 11}),
    "iv": ("5 modes of the harmonic run", {"active_length": "auto"}),
}


def _load(shape: str) -> dict[str, Any]:
    return {"kind": shape, "peak": CASE.force, "rise_time": published()["fig15"]["rise_time"]}


def _study(shape: str, reduction: dict[str, Any]) -> Study:
    both = ("full", "reduced")
    return study(CASE, load=_load(shape), time=_TIME, run=both, reduction=reduction)


@dataclass(frozen=True)
class _Full:
    """Full model under one pulse: modes, active length (share of the joint) by threshold."""

    found: Study
    proper: ProperModes
    active: float
    active_lower: float
    first_values: dict[float, float]


def _full(shape: str, damping: float = DAMPINGS[0]) -> _Full:
    """Run the full model alone and decompose its displacements."""
    found = study(
        CASE,
        load=_load(shape),
        time=_TIME,
        stiffness_damping=damping,
        output={"vtk": True, "frames": round(DURATION / STEP)},
    )
    run = found.models["full"].run
    distance = CASE.length - found.structure.position[found.structure.free]
    peak = np.abs(run.u).max(axis=0)
    active = [
        measured(distance[::-1], peak[::-1], threshold) / CASE.length
        for threshold in (THRESHOLD, LOWER_THRESHOLD)
    ]
    first = {
        end: float(proper_modes(run.u[: round(end / STEP) + 1]).proper_values[0])
        for end in (2e-4, 5e-4, DURATION)
    }
    return _Full(found, proper_modes(run.u), active[0], active[1], first)


def fig15(workspace: Workspace) -> Item:
    """Pulse, modes, active length and the four models of Fig. 17 with their errors."""
    printed = published()["fig15"]
    item = Item("fig15", "Section 7.2, Figs. 15 to 17: impulse on the joint of Case VII")
    full = _full(SHAPE)
    plain = {key: _study(SHAPE, PLAIN | keys) for key, (_, keys) in MODELS.items()}
    ours = {key: _study(SHAPE, keys) for key, (_, keys) in MODELS.items()}
    step = {key: _study(STEP_SHAPE, PLAIN | keys) for key, (_, keys) in MODELS.items()}
    unknown = (
        "the text prints neither the pulse nor another damping, which decide it; see the notes"
    )
    item.rows += [
        points_row(
            "active length, % of the joint",
            printed["active_percent"],
            100.0 * full.active,
            within=0.5,
            otherwise=f"differs: {unknown}",
        ),
        points_row(
            "first proper value, %",
            printed["first_proper_value"],
            float(full.proper.proper_values[0]),
            within=0.05,
            otherwise=f"differs: {unknown}",
        ),
        Row(
            "cumulative sum of five proper values, %",
            printed["cumulative_of_five"],
            float(full.proper.cumulative[4]),
            verdict="agrees" if full.proper.cumulative[4] > 99.0 else f"differs: {unknown}",
        ),
    ]
    steep = {"beta": PLAIN["beta"]}
    for key, (label, keys) in MODELS.items():
        same_law = errors_of(_study(SHAPE, steep | keys)).displacement_max
        for choice, runs in (("plain", plain), ("default", ours), (f"plain, {STEP_SHAPE}", step)):
            item.rows.append(
                below(
                    f"({key}) {label}, {choice}: largest error at any time",
                    f"{printed['error_percent']} %",
                    printed["error_percent"],
                    100.0 * errors_of(runs[key]).displacement_max,
                    f"with the full model's beta it errs by {100.0 * same_law:.2f} %"
                    if choice == "default"
                    else "more modes are needed",
                )
            )
    item.rows += aim_rows("impulse on the joint", errors_of(ours["iv"]))
    item.notes += _notes(full, plain, ours)
    _sensitivity(workspace, item)
    _store(item, full, plain, ours)
    if workspace.draws():
        _draw_pulse(workspace, item)
        _draw_modes(workspace, item, full)
        _draw_histories(workspace, item)
    return item


def _notes(full: _Full, plain: dict[str, Study], ours: dict[str, Study]) -> list[str]:
    """Say what was assumed and what it matters."""
    held = errors_of(_study(SHAPE, {"beta": PLAIN["beta"]}))
    default, choice = errors_of(ours["iv"]), errors_of(plain["iv"])
    finer = study(CASE, load=_load(SHAPE), time={"duration": DURATION, "step": STEP / 4.0}).models[
        "full"
    ]
    coarse = full.found.models["full"].run.point("free_end")
    step_error = np.abs(coarse - finer.run.point("free_end")[::4]).max() / np.abs(coarse).max()
    probe = plain["iv"].models["reduced"].active_length["joint"] / CASE.length
    return [
        f"The pulse is only in the lost Fig. 15: the text gives its peak (50 % of the limit) and "
        f"its rise time. Assumed is a {SHAPE} that falls as fast as it rises, with the damping of "
        f"{DAMPINGS[0]:g} s stated for all runs, {1e3 * DURATION:g} ms in steps of {STEP:g} s "
        f"(with a quarter of that step the free end changes by {100 * step_error:.2f} % of its "
        "peak). The captions of Figs. 16 and 17 speak of a step, so that a ramp that is held "
        "stands beside it. The normal force of 100 kN is an assumption too (Table 5).",
        f"Five modes of the harmonic run are those of the reference system (the paper says only "
        f"'the system'), on the active length of a probe run, {100 * probe:.0f} % of the joint: "
        "Eq. (17) is for harmonic loads.",
        "The first proper value depends on how long the history is: "
        + ", ".join(
            f"{value:.1f} % over {1e3 * end:g} ms" for end, value in full.first_values.items()
        )
        + ". The paper does not say how long its history is.",
        f"The automatic beta of the default reduction suits motion that goes on. After an impulse "
        "the joint comes to rest with friction locked in, and under a flatter law it creeps: the "
        f"default errs by {100 * default.displacement_max:.2f} % at any time and "
        f"{100 * default.friction_energy:+.2f} % in friction energy, with the full model's beta by "
        f"{100 * held.displacement_max:.2f} and {100 * held.friction_energy:+.2f} %, and the plain "
        f"choice by {100 * choice.displacement_max:.2f} and {100 * choice.friction_energy:+.2f} %.",
    ]


def _sensitivity(workspace: Workspace, item: Item) -> None:
    """Active length and first proper value by shape of the pulse and damping."""
    shapes = (SHAPE, STEP_SHAPE) if workspace.quick else SHAPES
    printed = published()["fig15"]
    lines = []
    for shape in shapes:
        runs = [_full(shape, damping) for damping in DAMPINGS]
        columns = {
            "damping_s": np.array(DAMPINGS),
            "active_length_percent": np.array([100 * run.active for run in runs]),
            "active_length_lower_percent": np.array([100 * run.active_lower for run in runs]),
            "first_proper_value_percent": np.array([run.proper.proper_values[0] for run in runs]),
            "cumulative_of_five_percent": np.array([run.proper.cumulative[4] for run in runs]),
        }
        for end in runs[0].first_values:
            columns[f"first_proper_value_of_{1e3 * end:g}_ms_percent"] = np.array(
                [run.first_values[end] for run in runs]
            )
        item.curves[f"fig15_sensitivity_{shape}"] = columns
        lines.append(
            f"{shape.replace('_', ' ')}: "
            + ", ".join(
                f"{100 * run.active:.0f} ({100 * run.active_lower:.0f}) and "
                f"{run.proper.proper_values[0]:.1f} %"
                for run in runs
            )
        )
    item.notes.append(
        "Active length in percent of the joint (displacement above 1/1000 of the free end's; in "
        "brackets 1/10000) and first proper value, for stiffness damping of "
        f"{', '.join(f'{d:g}' for d in DAMPINGS)} s: {'; '.join(lines)}. The paper prints "
        f"{printed['active_percent']:g} and {printed['first_proper_value']:g} %. Both depend more "
        "on shape, damping and duration than on anything the text says: no match is claimed."
    )
    if workspace.draws():
        _draw_sensitivity(workspace, item, shapes)


def _store(item: Item, full: _Full, plain: dict[str, Study], ours: dict[str, Study]) -> None:
    """Curves of Figs. 15 to 17."""
    structure = full.found.structure
    item.curves["fig16"] = {
        "position_m": structure.position[structure.free],
        **{f"mode_{k + 1}": full.proper.modes[:, k] for k in range(5)},
    }
    run = full.found.models["full"].run
    u = run.point("free_end")
    columns = {"time_s": run.times, "force_N": run.amplitudes[:, 0], "i_full_m": u}
    for choice, runs in (("plain", plain), ("default", ours)):
        for key, found in runs.items():
            reduced = found.models["reduced"].run.point("free_end")
            columns[f"{key}_{choice}_m"] = reduced
            columns[f"error_{key}_{choice}_percent"] = 100.0 * (reduced - u) / np.abs(u).max()
    item.curves["fig15_fig17"] = columns


def _draw_pulse(workspace: Workspace, item: Item) -> None:
    drawing, axes = figure(height=3.6)
    times = np.linspace(0.0, 1e-4, 501)
    for style, shape in zip(STYLES, SHAPES, strict=False):
        load = scene(CASE, load=_load(shape), time=_TIME).load[0].to_load()
        axes.plot(1e3 * times, load(times) / 1e3, label=shape.replace("_", " "), **style)
    rise = published()["fig15"]["rise_time"]
    axes.axvline(1e3 * rise, color="0.5", linewidth=0.8, label="published rise time")
    finish(axes, "time (ms)", "force (kN)", "Fig. 15, and other shapes")
    axes.legend(fontsize=9, handlelength=3.2, loc="center right")
    workspace.save(item, "fig15", drawing)


def _draw_modes(workspace: Workspace, item: Item, full: _Full) -> None:
    curve = item.curves["fig16"]
    drawing, axes = figure(width=7.0)
    x = 1e3 * curve["position_m"]
    for k, style in enumerate(STYLES[:5]):
        mode = curve[f"mode_{k + 1}"]
        label = f"{k + 1} ({full.proper.proper_values[k]:.2f} %)"
        axes.plot(x, mode * np.sign(mode[-1]), label=label, **style)
    length = 1e3 * CASE.length
    for share, text in (
        (full.active, "active, ours"),
        (published()["fig15"]["active_percent"] / 100.0, "active, published"),
    ):
        axes.axvline(length * (1.0 - share), color="0.5", linewidth=0.8)
        axes.text(length * (1.0 - share) + 4.0, -0.33, text, fontsize=9)
    axes.set_ylim(-0.37, 0.5)
    finish(axes, "distance from the held end (mm)", "mode (-)", f"Fig. 16, {SHAPE}")
    axes.legend(fontsize=9, handlelength=3.2, loc="upper left", title="mode (proper value)")
    workspace.save(item, "fig16", drawing)


def _draw_histories(workspace: Workspace, item: Item) -> None:
    curve = item.curves["fig15_fig17"]
    drawing, (whole, zoom, error) = figure(columns=3, width=5.0, height=4.2)
    time = 1e3 * curve["time_s"]
    for axes, title in ((whole, "Fig. 17(a)"), (zoom, "Fig. 17(b), zoomed")):
        axes.plot(time, 1e6 * curve["i_full_m"], label="(i) full", **STYLES[0])
        for style, (key, (label, _)) in zip(STYLES[1:], MODELS.items(), strict=False):
            axes.plot(time, 1e6 * curve[f"{key}_plain_m"], label=f"({key}) {label}", **style)
        finish(axes, "time (ms)", "displacement of the free end (µm)", title)
    zoom.set_xlim(0.0, 0.1)
    zoom.get_legend().remove()
    for style, key in zip(STYLES[1:], MODELS, strict=False):
        error.plot(time, curve[f"error_{key}_plain_percent"], label=f"({key}) plain", **style)
    error.plot(time, curve["error_iv_default_percent"], label="(iv) default", **STYLES[4])
    limit = float(published()["fig15"]["error_percent"].removeprefix("<"))
    error.axhline(limit, color="0.5", linewidth=0.8, label="published limit")
    error.axhline(-limit, color="0.5", linewidth=0.8)
    finish(error, "time (ms)", "error over the full model's peak (%)", "errors")
    workspace.save(item, "fig17", drawing)


def _draw_sensitivity(workspace: Workspace, item: Item, shapes: tuple[str, ...]) -> None:
    printed = published()["fig15"]
    drawing, panels = figure(columns=2, width=5.5, height=4.0)
    for axes, column, name, value in (
        (panels[0], "active_length_percent", "active length (% of the joint)", "active_percent"),
        (panels[1], "first_proper_value_percent", "first proper value (%)", "first_proper_value"),
    ):
        for style, shape in zip(STYLES, shapes, strict=False):
            curve = item.curves[f"fig15_sensitivity_{shape}"]
            label = shape.replace("_", " ")
            axes.semilogx(curve["damping_s"], curve[column], marker="o", label=label, **style)
        axes.axhline(printed[value], color="0.5", linewidth=0.8, label="published")
        finish(axes, "stiffness damping (s)", name)
    workspace.save(item, "fig15_sensitivity", drawing)
