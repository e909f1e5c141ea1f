"""A sweep's folder: a table of its scenes, and pictures of the results over one or two keys."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skfem_joint.ground.files import replacing, safe_names
from skfem_joint.output import plots
from skfem_joint.output.record import writing
from skfem_joint.output.tables import write_csv
from skfem_joint.scene import Scene, Swept
from skfem_joint.scene.messages import meaning
from skfem_joint.scene.sweep_table import RangeTable
from skfem_joint.study.sweep import STEADY, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Rows as they finish, and all of them in order.
JOURNAL, TABLE = "sweep_rows.jsonl", "sweep.csv"
_WORDS = {"wall": "run time", "offline": "off-line time", "dofs": "unknowns"}


def columns(swept: Swept, rows: Iterable[Row]) -> dict[str, list[Any]]:
    """Columns of the table: scene, its keys, results, warnings, why it failed.

    Results are those that are asked for, then whether each model's vibration is steady. Those that
    no scene has, such as energies per cycle of scenes without cycles, have no column. Warnings are
    whole sentences, those of a scene in one cell.
    """
    ordered = sorted(rows, key=lambda row: row.number)
    table: dict[str, list[Any]] = {"scene": [row.number for row in ordered]}
    for key in swept.values[0]:
        table[key] = [swept.values[row.number][key] for row in ordered]
    names = list(dict.fromkeys(name for row in ordered for name in row.results))
    chosen = [name for name in names if _is_chosen(name, swept.table.results)]
    for name in (*chosen, *(name for name in names if name.endswith(f".{STEADY}"))):
        values = [row.results.get(name) for row in ordered]
        if any(value is not None for value in values):
            table[name] = values
    table["warnings"] = [" ".join(row.notes) for row in ordered]
    return table | {"failure": [row.failure for row in ordered]}


def doubtful(rows: Iterable[Row]) -> dict[str, int]:
    """Numbers of scenes that have warnings, and of those that are not steady where they could be.

    Under the names that they have in ``summary.json``.
    """
    rows = list(rows)
    warned, unsteady = sum(bool(row.notes) for row in rows), sum(not row.steady for row in rows)
    return {"scenes_with_warnings": warned, "scenes_not_steady": unsteady}


def without_column(swept: Swept, rows: Iterable[Row]) -> list[str]:
    """Results that the scene asks for by name and that no row has, such as losses of a pulse."""
    if "results" not in swept.table.model_fields_set:
        return []
    found = {name.split(".")[1] for row in rows for name, x in row.results.items() if x is not None}
    return [name for name in swept.table.results if name not in found]


def lines(swept: Swept, rows: Sequence[Row]) -> list[str]:
    """What is printed of a sweep: why scenes failed, and how many ended, failed or are doubtful."""
    failed = [row for row in rows if row.failure]
    printed = [f"Scene {row.number}, {swept.label(row.number)}: {row.failure}\n" for row in failed]
    printed.append(
        f"{len(rows)} of {len(swept.scenes)} scenes have ended, {len(failed)} of them failed."
    )
    if missing := without_column(swept, rows):
        printed.append(
            f"No scene has {', '.join(missing)}: what is of a cycle needs time.cycles or "
            'time.until = "steady", and errors need accuracy.estimate or a full model.'
        )
    doubts = doubtful(rows)
    if any(doubts.values()):
        printed.append(
            f"{doubts['scenes_with_warnings']} have warnings, {doubts['scenes_not_steady']} are "
            f"not steady: see the columns of {TABLE}."
        )
    return printed


def _is_chosen(name: str, results: Iterable[str]) -> bool:
    _, result, *rest = name.split(".")
    return result in results and (result != "estimated_error" or rest[-1] == "total")


def write(swept: Swept, rows: Sequence[Row], folder: Path, drawn: bool = True) -> list[Path]:
    """Write the table of what has finished, as Parquet too where pyarrow is, and the pictures.

    Pictures take seconds: after an interrupt ``drawn`` is false. InputError if a file cannot be
    written. The caller has locked the folder.
    """
    table = columns(swept, rows)
    cells = {name: [_cell(value) for value in values] for name, values in table.items()}
    shown = dict(figures(swept, table)) if drawn and swept.scenes[0].output.plots else {}
    pictures = [folder / f"sweep_{name}.png" for name in safe_names(shown)]
    parquet = [folder / "sweep.parquet"] if find_spec("pyarrow") else []
    files = [folder / TABLE, *parquet, *pictures]
    content = {
        "scenes": len(swept.scenes),
        "ended": len(rows),
        "failures": {str(row.number): row.failure for row in rows if row.failure},
        **doubtful(rows),
        "warnings": {str(row.number): list(row.notes) for row in rows if row.notes},
        "results_without_column": without_column(swept, rows),
    }
    with writing(folder, content) as summary:
        write_csv(files[0], [list(cells), *zip(*cells.values(), strict=True)])
        for path in parquet:
            from pyarrow import parquet as library, table as arrow  # isort: skip

            with replacing(path) as temporary:
                library.write_table(arrow({name: _alike(cells[name]) for name in cells}), temporary)
        for path, figure in zip(pictures, shown.values(), strict=True):
            plots.save_figure(path, figure)
    return [*files, summary]


def _cell(value: Any) -> Any:
    return json.dumps(value) if isinstance(value, list | dict) else value


def _alike(values: list[Any]) -> list[Any]:
    """Values of one type, as a column of Parquet has: texts if any is one."""
    texts = any(isinstance(value, str) for value in values)
    return [str(value) if texts and value is not None else value for value in values]


def figures(swept: Swept, table: Mapping[str, list[Any]]) -> Iterator[tuple[str, Figure]]:
    """Figure of each result over one key, or over two; those of a list are drawn over the first."""
    keys = list(swept.values[0])
    if swept.table.combine == "list":
        keys = keys[:1]
    if len(keys) > 2:
        return
    results: dict[str, dict[str, list[Any]]] = {}
    for name in list(table)[1 + len(swept.values[0]) : -2]:
        if name.endswith(f".{STEADY}"):
            continue
        model, _, result = name.partition(".")
        results.setdefault(result, {})[model] = table[name]
    axes = [(f"{key}\n{meaning(key, Scene)}".strip(), table[key]) for key in keys]
    given = (swept.table.model_extra or {})[keys[0]]
    log = isinstance(given, RangeTable) and given.scale == "log"
    for result, by_model in results.items():
        label, unit = _label(result)
        if len(keys) == 1:
            yield result, plots.sweep_curves_figure(*axes[0], by_model, label, unit, log=log)
        else:
            yield result, plots.sweep_maps_figure(axes[0], axes[1], by_model, label, unit)


def _label(result: str) -> tuple[str, str]:
    """What a result is, and its unit."""
    name, _, what = result.partition(".")
    with_unit = re.fullmatch("(.*)_([mJs])", name)
    word, unit = with_unit.groups() if with_unit else (name, "%" * ("error" in name))
    if unit == "%":
        what = what.removesuffix(".total").replace("_", " ")
    return _WORDS.get(word, word).replace("_", " ") + (f" of {what}" if what else ""), unit
