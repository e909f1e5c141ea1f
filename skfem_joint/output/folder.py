"""Folders of results: what can be told before a command runs, and all that is written after it.

Every command lists its files in a ``summary.json`` that it writes before them, so that the next one
knows which files are ours, however the one before ended.
"""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from skfem_joint.analysis.error_time import FILES, Report
from skfem_joint.analysis.study import Study
from skfem_joint.errors import InputError
from skfem_joint.files import holding, needed, replacing, safe_name
from skfem_joint.output import pictures, plots, report, series
from skfem_joint.output.fields import frames_of
from skfem_joint.progress import Progress
from skfem_joint.reduction.active_length import slips
from skfem_joint.scene import Scene

Writer = Callable[[Path], object]
_log = logging.getLogger(__name__)

SUMMARY, SERIES = "summary.json", "fields.pvd"
# Names that commands may give to their files; what belongs to somebody else is not overwritten.
_OURS = re.compile(
    r"history\.npz|fields\.pvd|fields_load\.csv|joint\.(png|gif)|histories\.png|energies\.png|"
    r"proper_(values|orthogonal_modes)\.png|(hysteresis|active_region)_.*\.png|"
    r"(backbone|response)\.(csv|png)|ring_down\.csv|error-time\.(md|csv|png)|total-time\.png|"
    r"sweep\.(csv|parquet)|sweep_.*\.png"
)
# What proper orthogonal modes come from, by the scene's `reduction.reference`.
_WHOSE = {
    "static": "the static slip path of",
    "self": "the full model's own run with",
    "paper": "the paper's reference joint, scaled to",
}
# What an unfinished run or a sweep goes on from, and hidden files.
_PASSED = re.compile(r"checkpoint_.*\.npz|sweep_rows\.jsonl|\..*")


@contextmanager
def prepare(scene: Scene, folder: Path) -> Iterator[list[str]]:
    """See that a scene's output can be made before anything is computed, and keep its folder.

    InputError if a library is missing or nothing can be drawn, and as `kept`.
    """
    if scene.output.plots or scene.output.vtk:
        needed("pyvista", "vtk")
    if scene.output.plots:
        needed("imageio", "gif")
        with pictures.offscreen():  # tells what is missing before the run
            pass
    with kept(folder, scene.output.plots) as notes:
        yield notes


@contextmanager
def kept(folder: Path, drawn: bool = True) -> Iterator[list[str]]:
    """Keep a folder for the results of one command, with pictures of curves if they are ``drawn``.

    What an earlier command wrote into it, as its summary lists it, is removed: if this one fails,
    no old results stand for its own. All else is left alone, of which the sentences tell that are
    yielded. InputError if the folder cannot be written to, another command is writing to it, it has
    files of other origin under names that commands use, or matplotlib is missing.
    """
    if drawn:
        needed("matplotlib", "plot")
    with holding(folder):
        remove_old(folder)
        left = sorted(path.name for path in folder.iterdir() if not _PASSED.fullmatch(path.name))
        if foreign := [name for name in left if _OURS.fullmatch(name)]:
            raise InputError(
                f"{folder}: has {', '.join(foreign)}, which no run that a {SUMMARY} there knows of "
                "wrote and this one might overwrite; move them away, or choose another folder"
            )
        names = ", ".join(left[:3]) + (" and others" if len(left) > 3 else "")
        yield [f"{folder} has files of other origin, left as they are: {names}."] if left else []


def remove_old(folder: Path) -> None:
    """Remove what an earlier run wrote into a folder, as the summary there lists it.

    InputError if no run of this package wrote that summary, or a file cannot be removed.
    """
    path, root = folder / SUMMARY, folder.resolve()
    if not path.exists():
        return
    try:
        listed = [folder / str(name) for name in json.loads(path.read_bytes())["files"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: is not the summary of a run of this package, or of an older version of it; "
            "move it away, or choose another folder"
        ) from error
    inside = [file for file in listed if root in file.resolve().parents and not file.is_dir()]
    files = [path, *inside]
    try:
        for file in files:
            file.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be removed: {error.strerror}") from error
    for below in {file.parent.resolve() for file in files} - {root}:
        with suppress(OSError):  # something else is in it
            below.rmdir()


def write_summary(folder: Path, content: Mapping[str, Any], names: Sequence[str]) -> Path:
    """Write ``summary.json`` in place of old results, listing the files that are to be written."""
    remove_old(folder)
    report.write_json(folder / SUMMARY, {**content, "files": list(names)})
    return folder / SUMMARY


def write_error_time(folder: Path, found: Report, notes: Sequence[str] = ()) -> list[Path]:
    """Write a report's page, table and pictures with a summary, into a folder that exists."""
    files = [folder / name for name in FILES]
    summary = write_summary(folder, {"title": found.title, "warnings": notes}, FILES)
    with replacing(files[0]) as temporary:
        temporary.write_text(found.markdown(), encoding="utf-8")
    header, rows = found.table()
    report.write_csv(files[1], [header, *rows])
    for path, total in ((files[2], False), (files[3], True)):
        plots.save_figure(path, plots.error_time_figure(found.points, total))
    return [*files, summary]


def write(study: Study, folder: Path, progress: Progress = lambda *_: None) -> list[Path]:
    """Write what the scene asks for; returns the main files.

    ``progress`` is called with what is done, and how much of how much.
    InputError if a file cannot be written.
    """
    plan, names = curves(study), []
    output = study.scene.output
    pictured = output.plots and study.structure.body is not None
    if pictured or output.vtk:
        frames = frames_of(study)
    if output.vtk:
        plan[SERIES] = partial(series.write_series, frames=frames)
        plan["fields_load.csv"] = partial(series.write_load, frames=frames)
        rows = series.series_files(folder / SERIES, frames)
        names = [file.relative_to(folder).as_posix() for row in rows for file in row]
    if pictured:
        plan["joint.png"] = partial(pictures.still, frames=frames)
        plan["joint.gif"] = partial(pictures.animation, frames=frames)
    write_summary(folder, report.summary(study), [*plan, *names])
    for k, (name, writer) in enumerate(plan.items()):
        progress("pictures and files", k, len(plan))
        writer(folder / name)
        _log.info("%s is written.", name)
    return [folder / name for name in (SUMMARY, *plan)]


def curves(study: Study) -> dict[str, Writer]:
    """Histories and pictures of curves that a scene asks for, each with what writes it."""
    scene, system = study.scene, study.system
    runs = {name: model.run for name, model in study.models.items()}
    plan: dict[str, Writer] = {}
    if scene.output.history:
        plan["history.npz"] = partial(report.write_history, runs=runs)
    if not scene.output.plots:
        return plan

    def add(name: str, figure: Callable[..., Any], *arguments: Any) -> None:
        plan[name] = lambda path: plots.save_figure(path, figure(*arguments))

    add("histories.png", plots.histories_figure, runs, system.points)
    if scene.cycle_steps is not None:  # a loop only where there is one
        works = any(run.cycles.input.any() for run in runs.values())
        if works:
            add("energies.png", plots.energies_figure, runs)
        rows = -(-scene.cycle_steps // scene.output.every)  # a whole cycle, lest it stay open
        works &= min(run.times.size for run in runs.values()) > rows
        for k, load in enumerate(system.loads if works else ()):
            name = f"hysteresis_{safe_name(load.on)}{f'_load_{k}' * (len(system.loads) > 1)}.png"
            if plots.is_loop(runs, load.on, k, rows):
                add(name, plots.hysteresis_figure, runs, load.on, k, rows)
    if "reduced" in study.models and (basis := study.models["reduced"].basis):
        joints = [patch.joint.name for patch in study.structure.patches]
        count = repr(joints[0]) if len(joints) == 1 else f"{len(joints)} joints"
        whose = f"{_WHOSE[scene.reduction.reference]} {count}"
        add("proper_values.png", plots.proper_values_figure, basis.proper, whose)
        if basis.reference is not None:
            add("proper_orthogonal_modes.png", plots.modes_figure, basis.reference, whose)
    # Where a reduced model runs alone, the run that it was made from tells.
    model = next(iter(study.models.values()))
    peak = model.slip_peak
    active = slips(study.structure, system, peak, study.period)
    body = study.structure.body
    for patch in study.structure.patches if body is not None else ():
        if peak[patch.points].any():
            name = f"active_region_{safe_name(patch.joint.name)}.png"
            slip = (peak[patch.points], active[patch.points])
            add(name, plots.active_region_figure, body, patch, *slip)
    return plan
