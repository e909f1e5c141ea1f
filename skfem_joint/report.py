"""Results as text: the printed table, ``summary.json`` and ``history.npz``."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.files import replacing
from skfem_joint.history import Errors, peaks, steady_state
from skfem_joint.recording import Run


def write_json(path: Path, content: Any) -> None:
    """Write JSON; NaN and infinity are refused."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_history(path: Path, runs: dict[str, Run]) -> None:
    """Histories of the named points as ``history.npz``.

    Arrays: ``time`` (s), ``load_<number>_<name>`` (N) and, for each model and point,
    ``<model>_<point>_displacement`` (m) and ``<model>_<point>_velocity`` (m/s).
    """
    arrays: dict[str, Any] = {}
    for model, run in runs.items():
        if "time" not in arrays or run.times.size > arrays["time"].size:
            arrays["time"] = run.times
            for k, load in enumerate(run.system.loads):
                arrays[f"load_{k}_{load.on}"] = run.amplitudes[:, k]
        for k, point in enumerate(run.system.points):
            arrays[f"{model}_{point}_displacement"] = run.point_u[:, k]
            arrays[f"{model}_{point}_velocity"] = run.point_v[:, k]
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def model_summary(
    run: Run,
    *,
    modes: int | None,
    offline_s: float,
    active_length: dict[str, float],
    errors: Errors | None,
    active_area_fraction: dict[str, float] | None = None,
) -> dict[str, Any]:
    """Entry of one model in ``summary.json``; SI units, see the key names."""
    cycles = run.cycles
    has_cycles = cycles.friction.size > 0
    state = steady_state(run)
    summary: dict[str, Any] = {
        "dofs": run.system.n,
        "contact_points": run.system.contact_points,
        "modes": modes,
        "steps": run.counters.steps,
        "newton_iterations": run.counters.newton_iterations,
        "largest_iterations_of_a_step": run.counters.largest_iterations,
        "friction_evaluations": run.counters.friction_evaluations,
        "halved_steps": run.counters.halved_steps,
        "wall_s": run.wall_s,
        "offline_s": offline_s,
        "peak_displacement_m": _by_point(run, peaks(run)),
        "peak_displacement_whole_run_m": _by_point(run, run.peak),
        "friction_energy_per_cycle_J": float(cycles.friction[-1]) if has_cycles else None,
        "loop_energy_per_cycle_J": float(cycles.input[-1].sum()) if has_cycles else None,
        "friction_energy_J": float(run.friction_work.sum()),
        "input_work_J": float(run.input_work.sum()),
        "viscous_work_J": run.viscous_work,
        "scheme_work_J": run.scheme_work,
        "active_length_m": active_length,
        **({"active_area_fraction": active_area_fraction} if active_area_fraction else {}),
        "energy_balance_residual": run.energy_residual,
        "steady_state_reached": state.reached if state is not None else None,
        "interrupted": run.interrupted,
    }
    if errors is not None:
        summary["error"] = {
            "displacement_rms": errors.displacement_rms,
            "displacement_max": errors.displacement_max,
            "displacement_rms_by_point": {k: a for k, (a, _) in errors.by_point.items()},
            "displacement_max_by_point": {k: b for k, (_, b) in errors.by_point.items()},
            "peak_displacement": errors.peak_displacement,
            "friction_energy_per_cycle": errors.friction_energy_per_cycle,
            "loop_energy_per_cycle": errors.loop_energy_per_cycle,
            "friction_energy": errors.friction_energy,
        }
    return summary


def _by_point(run: Run, values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(run.system.points, values, strict=True)}


def certificate_table(certificate: dict[str, dict[str, dict[str, float]]]) -> str:
    """Estimated errors by model and source, percent, for reading."""
    lines = [f"{'estimated error, %':26}" + "".join(f"{name:>20}" for name in _HEADINGS.values())]
    for model, sources in certificate.items():
        for source, errors in sources.items():
            numbers = "".join(f"{100.0 * errors[key]:20.2g}" for key in _HEADINGS)
            lines.append(f"{model + ', ' + source:26}{numbers}")
    return "\n".join(lines)


_HEADINGS = {
    "displacement_rms": "displacement",
    "peak_displacement": "peak",
    "friction_energy": "friction energy",
    "loop_energy": "loop energy",
}


def _entry(key: str, name: str, model: dict[str, Any]) -> float | None:
    """Entry of a table by name, mm."""
    value = model[key].get(name)
    return None if value is None else 1e3 * value


def _percent(key: str, name: str, model: dict[str, Any]) -> float | None:
    """Entry of a table by name, percent."""
    value = model.get(key, {}).get(name)
    return None if value is None else 100.0 * value


def table(summary: dict[str, Any]) -> str:
    """Table of the models of a summary, for reading."""
    models = summary["models"]
    names = list(models)
    rows: list[tuple[str, list[str]]] = []

    def add(label: str, pick: Callable[[dict[str, Any]], Any], form: str = "{}") -> None:
        cells = []
        for name in names:
            value = pick(models[name])
            cells.append("-" if value is None else form.format(value))
        if any(cell != "-" for cell in cells):
            rows.append((label, cells))

    add("unknowns", lambda m: m["dofs"])
    add("contact points", lambda m: m["contact_points"])
    for point in models[names[0]]["peak_displacement_m"]:
        add(
            f"peak displacement at {point}, mm",
            partial(_entry, "peak_displacement_m", point),
            "{:.5g}",
        )
    add("friction energy per cycle, J", lambda m: m["friction_energy_per_cycle_J"], "{:.4g}")
    add("loop energy per cycle, J", lambda m: m["loop_energy_per_cycle_J"], "{:.4g}")
    if all(m["friction_energy_per_cycle_J"] is None for m in models.values()):
        add("friction energy, J", lambda m: m["friction_energy_J"], "{:.4g}")
    for joint in models[names[0]]["active_length_m"]:
        add(
            f"active length of {joint}, mm",
            partial(_entry, "active_length_m", joint),
            "{:.4g}",
        )
    for joint in models[names[0]].get("active_area_fraction", {}):
        add(
            f"active part of {joint}, %",
            partial(_percent, "active_area_fraction", joint),
            "{:.3g}",
        )

    def error(key: str) -> Callable[[dict[str, Any]], Any]:
        def pick(m: dict[str, Any]) -> Any:
            value = m.get("error", {}).get(key)
            return None if value is None else 100.0 * value

        return pick

    add("error of displacement history, %", error("displacement_rms"), "{:.3g}")
    add("error of peak displacement, %", error("peak_displacement"), "{:+.3g}")
    add("error of friction energy, %", error("friction_energy_per_cycle"), "{:+.3g}")
    add("error of loop energy, %", error("loop_energy_per_cycle"), "{:+.3g}")
    add("steps", lambda m: m["steps"])
    add("Newton iterations a step", lambda m: m["newton_iterations"] / max(m["steps"], 1), "{:.2f}")
    add("energy balance residual", lambda m: m["energy_balance_residual"], "{:.1e}")
    add("run time, ms", lambda m: 1e3 * m["wall_s"], "{:.3g}")
    add("off-line time, ms", lambda m: 1e3 * m["offline_s"], "{:.3g}")
    if "full" in models and len(names) > 1:
        full = models["full"]["wall_s"]
        add("run time of the full model over this", lambda m: full / m["wall_s"], "{:.2f}")

    left = max(len(label) for label, _ in rows)
    widths = [max(len(names[k]), *(len(cells[k]) for _, cells in rows)) for k in range(len(names))]
    lines = [
        f"{'':{left}}  " + "  ".join(f"{n:>{w}}" for n, w in zip(names, widths, strict=True)),
        "-" * (left + 2 + sum(widths) + 2 * (len(widths) - 1)),
    ]
    lines += [
        f"{label:{left}}  " + "  ".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True))
        for label, cells in rows
    ]
    return "\n".join(lines)
