"""Write a study's folder: summary, history, ParaView series, plots."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint import report
from skfem_joint.errors import InputError
from skfem_joint.files import remove_unfinished, replacing, safe_name
from skfem_joint.history import slip_state
from skfem_joint.offscreen import offscreen
from skfem_joint.plate_output import write_plate_pictures, write_plate_series
from skfem_joint.plate_study import PlateStudy
from skfem_joint.results import Model
from skfem_joint.scene import AnyScene, PlateScene
from skfem_joint.study import AnyStudy, Study


def prepare(scene: AnyScene, folder: Path) -> None:
    """See that the output can be made, before anything is computed: libraries and the folder.

    Raises
    ------
    InputError
        If a library is missing or the folder cannot be written to.
    """
    needed = [("matplotlib", "plots", "plot"), ("pyvista", "vtk", "vtk")]
    draws_plates = isinstance(scene, PlateScene) and scene.output.plots
    if draws_plates:
        needed.append(("pyvista", "plots", "vtk"))
    for library, key, extra in needed:
        if getattr(scene.output, key) and importlib.util.find_spec(library) is None:
            raise InputError(
                f"output.{key}: needs {library}; pip install 'skfem-joint[{extra}]', or set "
                f"output.{key} = false"
            )
    if draws_plates:
        with offscreen():  # tells what is missing before the run
            pass
    prepare_folder(folder)


def prepare_folder(folder: Path) -> None:
    """Make a folder, see that it can be written to, and clear it of half-written files.

    Raises
    ------
    InputError
        If not.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"--out {folder}: cannot be made a folder ({error.strerror}); choose another"
        ) from error
    remove_unfinished(folder)
    with replacing(folder / ".writable"):
        pass
    (folder / ".writable").unlink()


def summary(study: AnyStudy) -> dict[str, Any]:
    """Content of ``summary.json``."""
    return {
        "title": study.scene.title,
        "models": {
            name: report.model_summary(
                model.run,
                modes=None if model.basis is None else int(model.basis.shape[1]),
                offline_s=model.offline_s,
                active_length=model.active_length,
                errors=model.errors,
                active_area_fraction=model.active_area_fraction,
            )
            for name, model in study.models.items()
        },
        "warnings": study.warnings,
    }


def write(
    study: AnyStudy, folder: Path, certificate: Mapping[str, Any] | None = None
) -> list[Path]:
    """Write what the scene asks for; returns the main files."""
    output = study.scene.output
    runs = {name: model.run for name, model in study.models.items()}
    written = [folder / "summary.json"]
    content = summary(study)
    if certificate:
        content["certificate"] = certificate
    report.write_json(written[0], content)
    if output.history:
        written.append(folder / "history.npz")
        report.write_history(written[-1], runs)
    if output.plots:
        written += _plots(study, folder)
    if output.vtk and isinstance(study, PlateStudy):
        written += write_plate_series(study, folder / "fields.pvd")
    elif output.vtk and isinstance(study, Study):
        written.append(write_series(study, folder / "fields.pvd"))
    return written


def write_series(study: Study, path: Path) -> Path:
    """Write the models' stored fields as a series for ParaView; returns the index, ``path``."""
    from skfem_joint import vtk

    fields = [_field(study, model) for model in study.models.values()]
    frames = min(field.displacement.shape[0] for field in fields)
    times = next(iter(study.models.values())).run.field_times[:frames]
    vtk.write_series(path, study.structure, times, fields, shape=study.scene.output.shape)
    return path


def _field(study: Study, model: Model) -> Any:
    from skfem_joint import vtk

    structure, system = study.structure, study.system
    u, v = model.fields()
    force = np.zeros((u.shape[0], structure.n_nodes))
    state = np.full((u.shape[0], structure.n_nodes), -1, dtype=np.int8)
    if system.contact_points:
        nodes = structure.free[system.B.indices]
        sigma = model.normalised_friction(system)
        force[:, nodes] = -system.w * sigma
        state[:, nodes] = slip_state(v[:, system.B.indices], system.beta)
    return vtk.Field(model.name, structure.expand(u), structure.expand(v), force, state)


def _plots(study: AnyStudy, folder: Path) -> list[Path]:
    from skfem_joint import plot

    scene = study.scene
    runs = {name: model.run for name, model in study.models.items()}
    points = study.system.points
    paths = [plot.histories(folder / "histories.png", runs, points)]
    rows = None
    if scene.time.cycles is not None and scene.time.steps_per_cycle % scene.output.every == 0:
        rows = scene.time.steps_per_cycle // scene.output.every
    loads = study.system.loads
    for k, load in enumerate(loads):
        if load.on in points:
            number = f"_load_{k}" if len(loads) > 1 else ""
            path = folder / f"hysteresis_{safe_name(load.on)}{number}.png"
            paths.append(plot.hysteresis(path, runs, load.on, k, cycle_rows=rows))
    if scene.time.cycles is not None:
        paths.append(plot.energies(folder / "energies.png", runs))
    for model in study.models.values():
        if model.proper is not None:
            paths.append(plot.proper_values(folder / "proper_values.png", model.proper))
        if model.reference is not None:
            reference = model.reference
            path = folder / "proper_orthogonal_modes.png"
            paths.append(
                plot.proper_orthogonal_modes(path, reference.xi, reference.modes, reference.proper)
            )
    if isinstance(study, PlateStudy):
        paths += write_plate_pictures(study, folder)
    return paths
