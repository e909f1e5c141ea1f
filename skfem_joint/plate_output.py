"""What a study of plates writes beside its summary: fields for ParaView, and pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skfem_joint.files import safe_name
from skfem_joint.history import slip_state
from skfem_joint.plate_reduction import slips
from skfem_joint.plate_study import PlateStudy, period_of
from skfem_joint.plate_vtk import LoadHistory, PlateField, write_load, write_series
from skfem_joint.results import Model

FloatArray = NDArray[np.float64]


def plate_pressure(study: PlateStudy) -> FloatArray:
    """Clamping pressure at all displacement nodes, 0 off the contact, shape (N,), Pa."""
    pressure = np.zeros(len(study.structure.nodes))
    for patch in study.structure.patches:
        pressure[patch.nodes] += patch.normal_force / patch.area
    return pressure


def plate_field(study: PlateStudy, model: Model) -> PlateField:
    """Stored fields of a model on all displacement nodes.

    Traction is that of friction on the pressed body; nodes that are not pressed have no contact.
    """
    structure, system = study.structure, study.system
    u, v = model.fields()
    frames, count = u.shape[0], len(structure.nodes)
    sigma = model.normalised_friction(system)
    state = slip_state(system.slip_norm((system.B @ v.T).T), system.beta)
    work = friction_work(study, model, u, sigma)
    field = PlateField(
        model.name,
        structure.expand(u),
        structure.expand(v),
        np.zeros((frames, count, 2)),
        np.full((frames, count), -1, dtype=np.int8),
        np.zeros((frames, count)),
    )
    for patch in structure.patches:
        points = patch.points
        limit = patch.joint.friction * patch.normal_force
        for k in range(patch.directions.shape[1]):
            free = system.directions[points] > k
            force = -limit[free] * sigma[:, system.first_row[points[free]] + k]
            traction = (force / patch.area[free])[..., np.newaxis] * patch.directions[free, k]
            field.traction[:, patch.nodes[free]] += traction
        field.slip_state[:, patch.nodes] = state[:, points]
        # Joints that share a point share its work.
        whole = system.w[points] * patch.area
        share = np.divide(limit, whole, out=np.zeros_like(limit), where=whole > 0.0)
        field.friction_work[:, patch.nodes] += work[:, points] * share
    return field


def friction_work(study: PlateStudy, model: Model, u: FloatArray, sigma: FloatArray) -> FloatArray:
    """Friction work of each contact point of the full model since the start, (frames, m), J.

    The work of a reduced model that has friction points of its own is known in total; it is spread
    over the contact points as their friction and slip at the stored frames say.
    """
    system, run = study.system, model.run
    rows = run.friction_work_rows
    if run.system.w.size == system.w.size:
        return rows
    slip = (system.B @ u.T).T
    parts = system.on_rows(system.w) * 0.5 * (sigma[1:] + sigma[:-1]) * np.diff(slip, axis=0)
    parts = system.by_point(parts)
    spread = np.zeros((u.shape[0], system.w.size))
    np.cumsum(np.maximum(parts, 0.0), axis=0, out=spread[1:])
    total = spread.sum(axis=1)
    known = rows.sum(axis=1)
    scale = np.divide(known, total, out=np.zeros_like(total), where=total > 0.0)
    return np.asarray(spread * scale[:, np.newaxis])


def load_history(study: PlateStudy) -> LoadHistory:
    """Histories of the loads, at the times of the stored points or else of the fields."""
    run = next(iter(study.models.values())).run
    times = run.times if run.times.size else run.field_times
    forces: dict[str, FloatArray] = {}
    for load, history in zip(study.system.loads, study.system.load_amplitudes(times), strict=True):
        forces[load.on] = forces.get(load.on, np.zeros(times.size)) + history
    return LoadHistory(times, forces)


def write_plate_series(study: PlateStudy, path: Path) -> list[Path]:
    """Write the models' stored fields as a series for ParaView, and the loads beside it."""
    times, fields = _frames(study)
    write_series(
        path,
        study.structure,
        times,
        fields,
        plate_pressure(study),
        shape=study.scene.output.shape,
    )
    return [path, write_load(path, load_history(study))]


def _frames(study: PlateStudy) -> tuple[FloatArray, list[PlateField]]:
    fields = [plate_field(study, model) for model in study.models.values()]
    frames = min(len(field.displacement) for field in fields)
    return next(iter(study.models.values())).run.field_times[:frames], fields


def write_plate_pictures(study: PlateStudy, folder: Path) -> list[Path]:
    """Draw the joints: where they slip, and the warped plates as a picture and a film."""
    from skfem_joint import plate_plot

    paths = []
    full = study.models.get("full")
    slipping = np.zeros(study.system.w.size, dtype=np.bool_)
    if full is not None:
        peak = full.run.slip_peak
        slipping = slips(study.structure, study.system, peak, period_of(study.scene))
    for k, patch in enumerate(study.structure.patches):
        if full is None or patch.points.size == 0:
            continue
        slip = full.run.slip_peak[patch.points]
        active = slipping[patch.points]
        path = folder / f"active_region_{safe_name(patch.joint.name)}.png"
        paths.append(plate_plot.active_region(path, study.structure, k, slip, active))
    times, fields = _frames(study)
    pressure, load = plate_pressure(study), load_history(study)
    common = (study.structure, times, fields, pressure)
    # The frame with most slip in the second half of the run, when it has settled.
    half = times.size // 2
    most = half + int(np.argmax((fields[0].slip_state[half : times.size] == 1).sum(axis=1)))
    paths.append(plate_plot.still(folder / "joint.png", *common, time=times[most], load=load))
    paths.append(plate_plot.animation(folder / "joint.gif", *common, load=load))
    return paths
