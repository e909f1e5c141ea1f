"""Results of a study: what is printed, the content of ``summary.json``, and ``history.npz``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.accuracy.estimate import NAMES, SOURCES, WITHOUT_MESH
from skfem_joint.ground.files import replacing
from skfem_joint.output.loss import run_lines
from skfem_joint.output.tables import Table, TextTable, by_columns
from skfem_joint.results.history import QUANTITIES
from skfem_joint.stepping.recording import Run
from skfem_joint.study.premises import premises
from skfem_joint.study.results import Study
from skfem_joint.study.summary import model_summary


def write_history(path: Path, runs: Mapping[str, Run]) -> None:
    """Histories of the named points as ``history.npz``.

    Arrays: ``time`` (s), ``load_<number>_<name>`` (N) and, for each model and point,
    ``<model>_<point>_displacement`` (m) and ``<model>_<point>_velocity`` (m/s), for each joint
    ``<model>_<joint>_friction_energy`` (J), dissipated since the start, ``<model>_<joint>_slip``
    (m), the largest of its points, and ``<model>_<joint>_slipping``, the share of its friction
    limit whose points slip, see `Run`. Of quasi-static runs also the loop of each joint,
    ``<model>_<joint>_force`` (N) over ``<model>_<joint>_mean_slip`` (m), see `Loops`. Rows are
    stored times.
    """
    longest = max(runs.values(), key=lambda run: run.times.size)
    arrays: dict[str, Any] = {"time": longest.times}
    for k, load in enumerate(longest.system.loads):
        arrays[f"load_{k}_{load.on}"] = longest.amplitudes[:, k]
    for model, run in runs.items():
        for k, point in enumerate(run.system.points):
            arrays[f"{model}_{point}_displacement"] = run.point_u[:, k]
            arrays[f"{model}_{point}_velocity"] = run.point_v[:, k]
        for k, joint in enumerate(run.system.contact.joints):
            arrays[f"{model}_{joint}_friction_energy"] = run.joint_work[:, k]
            if run.joint_slip.size:
                arrays[f"{model}_{joint}_slip"] = run.joint_slip[:, k]
                arrays[f"{model}_{joint}_slipping"] = run.joint_slipping[:, k]
            if run.loops is not None:
                rows = np.searchsorted(run.loops.times, run.times * (1.0 - 1e-9))
                arrays[f"{model}_{joint}_force"] = run.loops.force[rows, k]
                arrays[f"{model}_{joint}_mean_slip"] = run.loops.slip[rows, k]
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def loop_rows(runs: Mapping[str, Run]) -> Iterator[list[Any]]:
    """Table of the loops of quasi-static runs, at every level: its heading, then its rows.

    Columns: time (s); of each model force (N) and displacement (m) of each load, then force (N),
    mean slip (m) and friction energy (J) of each joint. Cells are empty after a model's last level.
    """
    known = {name: run.loops for name, run in runs.items() if run.loops is not None}
    columns: dict[str, Any] = {}
    for model, loops in known.items():
        system = runs[model].system
        for k, load in enumerate(system.loads):
            start = f"{model}_{load.on or f'load_{k}'}"
            columns[f"{start}_force_N"] = loops.load_force[:, k]
            columns[f"{start}_displacement_m"] = loops.load_displacement[:, k]
        for k, joint in enumerate(system.contact.joints):
            columns[f"{model}_{joint}_force_N"] = loops.force[:, k]
            columns[f"{model}_{joint}_mean_slip_m"] = loops.slip[:, k]
            columns[f"{model}_{joint}_friction_energy_J"] = loops.work[:, k]
    times = max((loops.times for loops in known.values()), key=len)
    yield ["time_s", *columns]
    for row, t in enumerate(times.tolist()):
        cells = (float(x[row]) if row < len(x) else "" for x in columns.values())
        yield [t, *cells]


def stress_rows(content: Mapping[str, Any]) -> Table:
    """Table of the stresses of a summary: a row for each model, region and largest stress."""
    return by_columns(
        {"model": model, "region": region, "largest": name, **row}
        for model, results in content["models"].items()
        for region, rows in results.get("stress", {}).items()
        for name, row in rows.items()
    )


def results_text(study: Study) -> str:
    """What is printed of the models of a study: its title, facts of the structure, and a table."""
    parts = [
        study.scene.title,
        "\n".join(study.description.facts),
        str(summary_table(_of_models(study))),
    ]
    return "\n\n".join(parts if study.scene.title else parts[1:])


def estimates_text(study: Study) -> str:
    """What is printed of estimated errors: a table, and how long they took."""
    took = [
        f"{model.estimate_s:.3g} s of the {name} model"
        for name, model in study.models.items()
        if model.estimate_s > 0.0
    ]
    content = _of_models(study)
    parts = [str(estimate_table(content))]
    if lost := [*run_lines(content)]:
        parts.append("\n".join(lost))
    if took:
        parts.append(f"Time of the estimates: {', '.join(took)}.")
    return "\n\n".join(parts)


def summary(study: Study) -> dict[str, Any]:
    """Content of ``summary.json``, all but the list of files."""
    return {
        "title": study.scene.title,
        "structure": study.description.values,
        **_of_models(study),
        "warnings": list(study.notes),
        "premises": premises(study.scene, study.description.facts),
    }


def _of_models(study: Study) -> dict[str, Any]:
    """Part of the summary that tables are of."""
    return {"models": {name: model_summary(study, model) for name, model in study.models.items()}}


def estimate_table(content: Mapping[str, Any]) -> TextTable:
    """Estimated errors of the models of a summary by source, percent."""
    rows = {}
    for name, model in content["models"].items():
        errors = list(model["estimated_error"].values())
        for source in SOURCES:
            values = [error[source] for error in errors]
            if any(value is not None for value in values):
                shown = [_percent(value) for value in values]
                label = NAMES.get(source, source.replace("_", " "))
                if source == "total" and model["estimated_total_without_mesh"]:
                    label = WITHOUT_MESH
                rows[f"{name} model, {label}"] = shown
        joints = {
            joint: value
            for joint, results in model["joints"].items()
            if (value := results["friction_energy_error_of_own"]) is not None
        }
        if len(joints) > 1:  # errors of joints may cancel in the sum
            worst = max(joints, key=lambda joint: joints[joint])
            shown = ["-"] * len(errors)
            shown[QUANTITIES.index("friction_energy")] = _percent(joints[worst])
            rows[f"{name} model, joint {worst} alone"] = shown
        if all(error["total"] is None for error in errors):
            rows[f"{name} model"] = ["not estimated"] * len(errors)
    return TextTable("estimated error, %", [key.replace("_", " ") for key in QUANTITIES], rows)


def summary_table(content: Mapping[str, Any]) -> TextTable:
    """Table of the models of a summary.

    It states how many times faster than the full model each runs, without and with its off-line
    time, if it is faster with it and neither run was interrupted.
    """
    models: dict[str, dict[str, Any]] = content["models"]
    full = models.get("full")
    rows: dict[str, list[str]] = {}

    def add(label: str, form: str, values: list[Any], scale: float = 1.0) -> None:
        if any(value is not None for value in values):
            rows[label] = [_shown(value, form, scale) for value in values]

    def at(*keys: str) -> list[Any]:
        """Entry of each model, None where there is none."""
        entries: list[Any] = list(models.values())
        for key in keys:
            entries = [None if entry is None else entry.get(key) for entry in entries]
        return entries

    def faster(model: dict[str, Any], offline: bool) -> float | None:
        """Run time of the full model over that of a model; None if that is not stated."""
        if full is None or model is full or full["interrupted"] or model["interrupted"]:
            return None
        total = model["wall_s"] + model["offline_s"]
        pays = full["wall_s"] > total
        return float(full["wall_s"] / (total if offline else model["wall_s"])) if pays else None

    def add_each(of: str, *shown: tuple[Any, ...]) -> None:
        """Rows of each name of a table: label with {} for it, format, scale, and keys below it."""
        for name in names(of):
            for label, form, scale, *keys in shown:
                add(label.format(name), form, at(of, name, *keys), scale)

    def names(*of: str) -> list[str]:
        """Names that a table has in any model, each once."""
        return list(dict.fromkeys(name for table in at(*of) for name in table or ()))

    cycles = any(value is not None for value in at("friction_energy_per_cycle_J"))
    steps = zip(at("newton_iterations"), at("steps"), strict=True)
    add("unknowns", "{}", at("dofs"))
    add("contact points", "{}", at("contact_points"))
    add_each("peak_displacement_m", ("peak displacement at {}, mm", "{:.5g}", 1e3))
    add_each("amplitude_m", ("amplitude (half of peak to peak) at {}, mm", "{:.5g}", 1e3))
    add_each("offset_m", ("offset (mean of both peaks) at {}, mm", "{:.5g}", 1e3))
    add("friction energy per cycle, J", "{:.4g}", at("friction_energy_per_cycle_J"))
    add("loop energy per cycle, J", "{:.4g}", at("loop_energy_per_cycle_J"))
    add("loss factor", "{:.4g}", at("loss_factor"))
    lacks = ", without mesh" * any(at("estimated_total_without_mesh"))
    label = f"stated error of the loss factor{lacks}, %"
    add(label, "{:.2g}", at("loss_factor_error_total"), 100.0)
    if not cycles:
        totals = [sum(energies.values()) for energies in at("friction_energy_J")]
        add("friction energy, J", "{:.4g}", totals)
    stiffness = "{:.4g}", 1.0, "secant_stiffness_N_per_m"
    add_each("loads", ("secant stiffness at {}, N/m", *stiffness))
    joints = names("joints")
    for name in joints:
        if len(joints) > 1:
            energy = at("joints", name, "friction_energy_J")
            add(f"friction energy of {name} over the run, J", "{:.4g}", energy)
        by_bolt = [bolts or () for bolts in at("joints", name, "friction_energy_by_bolt_J")]
        for number, energies in enumerate(zip(*by_bolt, strict=True), 1):
            label = f"friction energy of {name} at bolt {number} over the run, J"
            add(label, "{:.4g}", list(energies))
        for label, form, scale, key in (
            ("secant stiffness of {}, N/m", *stiffness),
            ("largest slip of {} over the run, mm", "{:.4g}", 1e3, "largest_slip_m"),
            ("active length of {}, mm", "{:.4g}", 1e3, "active_length_m"),
            ("active part of {}, %", "{:.4g}", 100.0, "active_area_fraction"),
            ("points of {} that slip, %", "{:.4g}", 100.0, "slipping_fraction"),
        ):
            add(label.format(name), form, at("joints", name, key), scale)
    add_each(
        "bolts",
        ("share of {} in the friction loss, %", "{:.3g}", 100.0, "loss_share"),
        ("share of {} that slips, %", "{:.3g}", 100.0, "slipping_share"),
    )
    for label, key, form in (
        ("displacement history", "displacement_rms", "{:.3g}"),
        ("peak displacement", "peak_displacement", "{:+.3g}"),
        ("friction energy", f"friction_energy{'_per_cycle' * cycles}", "{:+.3g}"),
        ("loop energy", "loop_energy_per_cycle", "{:+.3g}"),
    ):
        add(f"error of {label}, %", form, at("error", key), 100.0)
    add_each("stress", *(
        (f"largest von Mises stress of {{}}, {of}, MPa", "{:.4g}", 1e-6, of, f"{of}_von_mises_Pa")
        for of in ("preload", "vibration", "total", "alternating")
    ))  # fmt: skip
    add("energy lost by impacts, J", "{:.4g}", at("impact_energy_J"))
    add("largest normal force of a pressure point, N", "{:.4g}", at("largest_normal_force_N"))
    add("contact opened, % of the pressure points", "{:.3g}", at("opened_fraction"), 100.0)
    pairs = zip(at("scheme_work_J"), at("input_work_J"), strict=True)
    shares = [scheme / work if work else None for scheme, work in pairs]
    if any(shares):
        add("dissipated by the scheme itself, % of the input", "{:.3g}", shares, 100.0)
    add("steps", "{}", at("steps"))
    add("Newton iterations a step", "{:.2f}", [newton / max(done, 1) for newton, done in steps])
    add("energy balance residual", "{:.1e}", at("energy_balance_residual"))
    add("run time, ms", "{:.3g}", at("wall_s"), 1e3)
    add("off-line time, ms", "{:.3g}", at("offline_s"), 1e3)
    if any(at("compilation_s")):
        add("compilation, once on a machine, ms", "{:.3g}", at("compilation_s"), 1e3)
    for label, offline in (
        ("run time of the full model over this one's", False),
        ("the same with its off-line time", True),
    ):
        add(label, "{:.3g}", [faster(model, offline) for model in models.values()])
    return TextTable("", list(models), rows)


def _percent(value: float | None) -> str:
    """Relative error to two digits; whole percents from 100 % on."""
    return _shown(value, "{:.2g}" if value is None or value < 0.995 else "{:.0f}", 100.0)


def _shown(value: Any, form: str, scale: float = 1.0) -> str:
    return "-" if value is None else form.format(value if scale == 1.0 else scale * value)
