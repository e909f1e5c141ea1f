"""Folders of results: what is checked before a command runs, and all that is written after it.

Every command lists its files, so that the next one knows which are ours, however the one before
ended: see `record`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skfem_joint.ground.files import holding, needed, replacing, safe_name, safe_names
from skfem_joint.ground.progress import Progress
from skfem_joint.output import plots, report, series
from skfem_joint.output.drawing import pictures
from skfem_joint.output.drawing.offscreen import offscreen
from skfem_joint.output.fields import frames_of
from skfem_joint.output.loss import loss_label
from skfem_joint.output.record import clear, writing
from skfem_joint.output.tables import write_csv, write_table
from skfem_joint.output.universal import scene_uff
from skfem_joint.scene import Scene
from skfem_joint.study.error_time import FILES, Report
from skfem_joint.study.results import Study

Writer = Callable[[Path], object]
_log = logging.getLogger(__name__)

# What proper orthogonal modes come from, by the scene's `reduction.reference`.
_WHOSE = {
    "static": "the static slip path of",
    "self": "the full model's own run with",
    "paper": "the paper's reference joint, scaled to",
}


def check_libraries(scene: Scene) -> None:
    """See that the libraries of a scene's output are there; InputError names what is missing."""
    if scene.output.plots or scene.output.vtk:
        needed("pyvista", "vtk")
    if scene.output.plots:
        needed("matplotlib", "plot")
    if scene.output.uff:
        needed("pyuff", "uff")


@contextmanager
def prepare(scene: Scene, folder: Path, overwrite: bool = False) -> Iterator[list[str]]:
    """Check before a run that a scene's output can be written, and reserve its folder.

    InputError if a library is missing or nothing can be drawn, and for the reasons of `kept`.
    """
    check_libraries(scene)
    if scene.output.plots:
        with offscreen():  # reports what is missing before the run
            pass
    with kept(folder, scene.output.plots, overwrite) as notes:
        yield notes


@contextmanager
def kept(folder: Path, drawn: bool = True, overwrite: bool = False) -> Iterator[list[str]]:
    """Reserve a folder for the results of one command, and remove an earlier command's results.

    They are removed so that nobody takes old results for new ones if this command fails. All other
    files stay; the notes that are yielded name them.

    Parameters
    ----------
    folder : Path
    drawn : bool
        Whether the command draws curves, which needs matplotlib.
    overwrite : bool
        Whether results may replace files of the same names that were changed, or are of other
        origin.

    Raises
    ------
    InputError
        If the folder cannot be written to, another command is writing to it, matplotlib is missing,
        or as `clear`.
    """
    if drawn:
        needed("matplotlib", "plot")
    with holding(folder):
        left = clear(folder, overwrite)
        names = ", ".join(left[:3]) + (" and others" if len(left) > 3 else "")
        note = f"{folder} has other files, which stay unless results replace them: {names}."
        yield [note] if left else []


def write_error_time(folder: Path, measured: Report) -> list[Path]:
    """Write a report's page, table and pictures with a summary, into a folder that exists."""
    files = [folder / name for name in FILES]
    header, rows = measured.table()
    with writing(folder, {"title": measured.title, "warnings": measured.notes}) as summary:
        with replacing(files[0]) as temporary:
            temporary.write_text(measured.markdown(), encoding="utf-8")
        write_csv(files[1], [header, *rows])
        for path, total in ((files[2], False), (files[3], True)):
            plots.save_figure(path, plots.error_time_figure(measured.points, total))
    return [*files, summary]


def write(study: Study, folder: Path, progress: Progress = lambda *_: None) -> list[Path]:
    """Write the files that the scene asks for; returns all but those of the frames.

    InputError if a file cannot be written.
    """
    plan = curves(study)
    output = study.scene.output
    pictured = output.plots and study.structure.body is not None
    if pictured or output.vtk:
        frames = frames_of(study.structure, study.runs)
    if output.vtk:
        plan["fields.pvd"] = partial(series.write_series, frames=frames)
        plan["fields_load.csv"] = partial(series.write_load, frames=frames)
    if output.uff:
        plan["model.uff"] = partial(scene_uff, scene=study.scene)
    if pictured:
        plan["joint.png"] = partial(pictures.still, frames=frames)
        plan["joint.gif"] = partial(pictures.animation, frames=frames)
    content = report.summary(study)
    if stresses := report.stress_rows(content):
        plan["stress.csv"] = partial(write_table, columns=stresses)
    with writing(folder, content) as summary:
        for k, (name, writer) in enumerate(plan.items()):
            progress("pictures and files", k, len(plan))
            writer(folder / name)
            _log.info("%s is written.", name)
    return [summary, *(folder / name for name in plan)]


def curves(study: Study) -> dict[str, Writer]:
    """Writers, by the names of their files, of the histories and curves that a scene asks for."""
    scene, system = study.scene, study.system
    runs = study.runs
    plan: dict[str, Writer] = {}
    if scene.output.history:
        plan["history.npz"] = partial(report.write_history, runs=runs)
        if scene.time.quasi_static:
            plan["joint_loops.csv"] = lambda path: write_csv(path, report.loop_rows(runs))
    if not scene.output.plots:
        return plan

    def add(name: str, figure: Callable[..., Any], *arguments: Any) -> None:
        plan[name] = lambda path: plots.save_figure(path, figure(*arguments))

    add("histories.png", plots.histories_figure, runs, system.points)
    works = scene.cycle_steps is not None and any(run.cycles.input.any() for run in runs.values())
    if works:
        on_mesh = study.structure.body is not None
        lost = {name: loss_label(model, on_mesh) for name, model in study.models.items()}
        add("energies.png", plots.energies_figure, runs, lost)
    # Rows of a whole cycle, so that the loop closes.
    rows = -(-(scene.cycle_steps or 1) // scene.output.every)
    stored, slow = min(run.times.size for run in runs.values()), scene.time.quasi_static
    for k, load in enumerate(system.loads):
        name = f"hysteresis_{safe_name(load.on)}{f'_load_{k}' * (len(system.loads) > 1)}.png"
        if works and stored > rows and plots.is_loop(runs, load.on, k, rows):
            add(name, plots.hysteresis_figure, runs, load.on, k, rows, lost)
        elif slow and stored > 1:  # the path of a load that closes no cycle
            add(name, plots.hysteresis_figure, runs, load.on, k, None)
    slips = (run.loops is not None and np.ptp(run.loops.slip) > 0.0 for run in runs.values())
    if slow and system.contact.joints and any(slips):
        add("joint_loops.png", plots.joint_loops_figure, runs)
    if "reduced" in study.models and (basis := study.models["reduced"].basis):
        joints = [patch.joint.name for patch in study.structure.patches]
        count = repr(joints[0]) if len(joints) == 1 else f"{len(joints)} joints"
        whose = f"{_WHOSE[scene.reduction.reference]} {count}"
        add("proper_values.png", plots.proper_values_figure, basis.proper, whose)
        if basis.modes_of_unit_length is not None:
            scaled = basis.modes_of_unit_length
            add("proper_orthogonal_modes.png", plots.modes_figure, *scaled, whose)
    # The first model: if only a reduced model runs, this is what the run it was made from had.
    model = next(iter(study.models.values()))
    peak = model.slip_peak
    shares, work = model.run.system.contact.shares, model.run.friction_work
    work = work if shares is None else shares.T @ work
    active = system.slipping(model.slider_peak(system), study.period)
    body = study.structure.body
    patches = study.structure.patches if body is not None else ()
    names = safe_names(patch.joint.name for patch in patches)
    for patch, name in zip(patches, names, strict=True):
        if peak[patch.points].any():
            slip = (peak[patch.points], active[patch.points])
            add(f"active_region_{name}.png", plots.active_region_figure, body, patch, *slip)
        if (own := work[patch.points]).any():
            add(f"friction_work_{name}.png", plots.friction_work_figure, body, patch, own)
    return plan
