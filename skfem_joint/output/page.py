"""One page of HTML about the results in a folder, to be read without the program or a network.

`write_report` reads ``summary.json``, the tables and the pictures of `run`, `backbone` or
`response`, and writes ``report.html`` beside them. It computes nothing.
"""

from __future__ import annotations

import base64
import csv
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import holding, needed, read_text, replacing
from skfem_joint.output import report
from skfem_joint.output.loss import run_lines
from skfem_joint.output.record import SUMMARY, adding
from skfem_joint.output.tables import TextTable

PAGE = "report.html"
#: Rows of a table that are shown; of longer ones as many, evenly.
_ROWS = 12
#: Columns of tables that a page shows, of those whose name begins so, with their heading.
_COLUMNS: dict[str, tuple[str, ...]] = {
    "amplitudes.csv": (
        *("point", "quantity", "value", "unit", "model", "mode", "level", "frequency_Hz"),
        *("loss_factor", "quality_factor", "friction_loss_error_total", "displacement_"),
        *("loss_share_", "slipping_share_", "largest_slip_", "state", "doubt"),
    ),
    "backbone.csv": (
        *("model", "mode", "level", "force_", "displacement_", "frequency_Hz", "damping_ratio"),
        *("loss_factor", "slipping_share_", "state", "doubt", "mesh_error_"),
    ),
    "nonlinear_modes.csv": (
        *("mode", "amplitude_m", "frequency_Hz", "damping_ratio", "frequency_error"),
        *("time_steps_", "quasi_static_", "ring_down_", "loss_factor", "state"),
    ),
    "peaks.csv": (),
    "stress.csv": (
        *("model", "region", "largest", "x_m", "y_m", "z_m", "preload_", "vibration_", "total_"),
        *("alternating_", "mean_von_mises_"),
    ),
    "random.csv": (),
    "random_joints.csv": (),
}
#: What these tables are of.
_TABLES = {
    "amplitudes.csv": "At the amplitudes asked for",
    "backbone.csv": "Over the level, which is 1 where the first joint slips as a whole",
    "nonlinear_modes.csv": "Modes over the amplitude of their first harmonic",
    "stress.csv": "Where stresses of elements are largest, in the last cycle or in a run without",
    "peaks.csv": "Peaks beside the damping curves",
    "random.csv": "Motion of the named points",
    "random_joints.csv": "Work of the joints",
}
#: What columns of these tables mean whose names begin so.
_WORDS = {
    "level": "Inertia that loads the mode, over that at which the first joint slips as a whole.",
    "force_": "Amplitude of a harmonic force at the point that keeps the mode at its resonance.",
    "loss_factor": "Energy lost in a cycle over 2π times the largest strain energy in it; half of "
    "it is the equivalent viscous damping ratio. By friction and by damping are its parts.",
    "quality_factor": "Q, one over the loss factor.",
    "damping_ratio": "Energy lost in a cycle over 4π times half of α q, with the force α of the "
    "mode's inertia and its displacement q, as in quasi-static modal analysis. Where joints slip "
    "α q / 2 is more than the largest strain energy, so that the ratio is less than half of the "
    "loss factor.",
    "friction_loss_error": "Stated error of friction's part in the loss factor, and of the "
    "energy that it takes in a cycle.",
    "loss_share": "Part of a joint or bolt in what friction takes in a cycle.",
    "slipping_share": "Share of the friction limit of a joint or bolt whose points slip; from 0.99 "
    "on it slips as a whole.",
    "state": "stick, partial (some points slip), or gross (a joint slips as a whole).",
}
#: Names without a unit of which a page says so.
_PURE = ("loss_", "quality_", "friction_loss_", "damping_", "slipping_", "level", "mesh_error_")
#: Units that end names of columns.
_UNITS = {"m", "Hz", "J", "Pa", "s", "N"}
#: Columns of a table beyond which its rows stand side by side, with a line for each column.
_WIDE = 7
_CAPTIONS = {
    "histories": "Displacement of the named points over time",
    "energies": "Energy put in by the loads and lost by friction in each cycle",
    "hysteresis": "Force over displacement of the loaded point; the area is the energy of a cycle",
    "proper_values": "Proper values of the reduced model's basis",
    "proper_orthogonal_modes": "Proper orthogonal modes of the reference joint",
    "active_region": "Largest slip over the joint",
    "friction_work": "Energy that friction takes of the joint, by area",
    "joint_loops": "Force over mean slip of each joint",
    "joint": "Stick and slip on the moving structure. A still shows the time at which slip is "
    "fastest: where the load turns, all stick",
    "backbone_response": "Response beside the damping curves",
    "backbone": "Frequency and damping over amplitude",
    "nonlinear_modes": "Frequency and damping of modes into gross slip, over amplitude",
    "response": "Amplitude over frequency",
    "shapes": "Shapes of the modes with the joints stuck",
    "random": "Spectral density of displacement and acceleration",
}
_KINDS = {".png": "image/png", ".gif": "image/gif"}


def write_report(folder: Path | str) -> Path:
    """Write ``report.html`` about results of `run`, a curve of modes, `response` or `random`.

    The page has the results with their stated errors, what to beware of, the structure, what is
    assumed, the pictures, and the scene. Pictures are part of the file, which needs no network.

    Parameters
    ----------
    folder : Path or str
        That the command was given as ``--out``.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If the folder has no results of these commands, files of it are missing or damaged, it
        cannot be written to, or jinja2 is missing.
    """
    folder = Path(folder)
    jinja2 = needed("jinja2", "report")
    content = _content(folder)
    source = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    template = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    ).from_string(source)
    text = template.render(_parts(folder, content))
    path = folder / PAGE
    with holding(folder), adding(folder), replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def _content(folder: Path) -> dict[str, Any]:
    """Summary of a folder of results that can be reported on."""
    path = folder / SUMMARY
    if not path.is_file():
        raise InputError(
            f"{folder}: has no {SUMMARY}, must be the folder --out of run, backbone, "
            "nonlinear-modes, response or random"
        )
    try:
        content = json.loads(read_text(path))
    except ValueError as error:
        raise InputError(f"{path}: not the JSON that skfem-joint wrote: {error}") from error
    if not isinstance(content, dict) or "premises" not in content:
        raise InputError(
            f"{path}: is of another command or an older version, must be of run, backbone, "
            "nonlinear-modes, response or random; run it again"
        )
    return content


def _parts(folder: Path, content: Mapping[str, Any]) -> dict[str, Any]:
    """Values of the template."""
    premises, by = content["premises"], content["written_by"]
    day = datetime.fromtimestamp((folder / SUMMARY).stat().st_mtime)
    notes = [note for note in content["warnings"] if note not in premises["notes"]]
    return {
        "title": content["title"] or folder.absolute().name,
        "made": f"{by['program']} {by['version']} with {by['libraries']}, {day:%d %B %Y}.",
        "told": content["told"] if "told" in content else [*run_lines(content)],
        "tables": [*_tables(folder, content)],
        "notes": notes,
        "structure_notes": premises["notes"],
        "structure": premises["structure"],
        "assumptions": premises["assumptions"],
        "pictures": [*_pictures(folder, content["files"])],
        "words": [*_words(folder, content)],
        "scene": premises["scene"],
    }


def _tables(folder: Path, content: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Tables of results and of their estimated errors."""
    if "told" not in content:  # of models that were run
        yield _of_text("Results of the models", report.summary_table(content))
        yield _of_text("Estimated errors", report.estimate_table(content))
    for name, columns in _COLUMNS.items():
        if name in content["files"] and (table := _of_file(folder / name, columns)):
            yield table


def _of_text(caption: str, table: TextTable) -> dict[str, Any]:
    heading, *rows = table.lines
    return {"caption": caption, "heading": heading, "rows": rows}


def _of_file(path: Path, columns: tuple[str, ...]) -> dict[str, Any] | None:
    """Table of a file: the columns whose names begin so (all, if none are given), without empty.

    None without rows.
    """
    heading, *rows = [*csv.reader(read_text(path).splitlines())] or [[]]
    if any(len(row) != len(heading) for row in rows) or not heading:
        raise InputError(f"{path}: is cut off or was changed; run the command again")
    if not rows:
        return None
    chosen = [
        k
        for k, name in enumerate(heading)
        if (not columns or name.startswith(columns)) and any(row[k] for row in rows)
    ]
    step = -(-len(rows) // _ROWS)
    evenly = rows[(len(rows) - 1) % step :: step]  # of which the last row is one
    shown = [[_rounded(row[k]) for k in chosen] for row in evenly]
    caption = _TABLES[path.name] + (f" (one of {step} rows)" if step > 1 else "")
    names = [_with_unit(heading[k]) for k in chosen]
    if len(names) > _WIDE:
        names, *shown = ([*line] for line in zip(names, *shown, strict=True))
    return {"caption": caption, "heading": names, "rows": shown}


def _with_unit(name: str) -> str:
    """Name of a column as a heading with its unit, "-" for a pure number."""
    stem, _, end = name.rpartition("_")
    if stem and end in _UNITS:
        return f"{stem.replace('_', ' ')}, {end}"
    return name.replace("_", " ") + (", -" if name.startswith(_PURE) else "")


def _words(folder: Path, content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Names on the page that may be taken for something else, and what they mean."""
    shown = {"amplitudes.csv", "backbone.csv"}.intersection(content["files"])
    names = [
        name for file in shown for name in next(csv.reader(read_text(folder / file).splitlines()))
    ]
    if "told" not in content and [*run_lines(content)]:
        names.append("loss_factor")
    for word, meaning in _WORDS.items():
        if any(name.startswith(word) for name in names):
            yield word.replace("_", " "), meaning


def _rounded(cell: str) -> str:
    """Number of a cell to five digits."""
    return f"{float(cell):.5g}" if re.fullmatch(r"[-+.\de]*\.[-+\de]*|\d+e-\d+", cell) else cell


def _pictures(folder: Path, names: Iterable[str]) -> Iterator[dict[str, str]]:
    """Pictures among the files of a folder, an animation in place of its still."""
    shown = [name for name in names if Path(name).suffix in _KINDS and "/" not in name]
    moving = {Path(name).stem for name in shown if name.endswith(".gif")}
    for name in shown:
        stem, suffix = Path(name).stem, Path(name).suffix
        if suffix == ".png" and stem in moving:
            continue
        try:
            data = base64.b64encode((folder / name).read_bytes()).decode()
        except OSError as error:
            raise InputError(f"{folder / name}: cannot be read: {error.strerror}") from error
        caption = next((text for start, text in _CAPTIONS.items() if stem.startswith(start)), stem)
        yield {"name": name, "caption": caption, "kind": _KINDS[suffix], "data": data}
