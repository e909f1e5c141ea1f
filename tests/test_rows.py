"""Rows of finished work: kept to the bit, never wrong, and gone on from after an interrupt."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joint_scenes import bar_scene, joint, lap_joint

from skfem_joint import cli
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.plain_values import fingerprint
from skfem_joint.ground.rows import HEADER, Rows
from skfem_joint.study import error_time as et
from skfem_joint.study.scene_response import RESPONSE_ROWS, scene_response

ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Piece:
    """Something that a row may hold."""

    values: Any
    name: str = ""


def same(one: Any, other: Any) -> bool:
    """Whether two values have the same types and bits."""
    return fingerprint(one) == fingerprint(other)


#: Floats of any bits, infinite and no numbers, and others that a row may hold.
BITS = np.random.default_rng(5).integers(0, 2**64, 40, dtype=np.uint64).view(np.float64)
FLOATS = [*BITS, 0.0, -0.0, 5e-324, 1.7976931348623157e308, np.inf, -np.inf, np.nan]
OTHERS = [None, True, False, 0, -1, 2**80, "", "é\n\u2028\0\U0001f600", '"}', *map(float, FLOATS)]


@pytest.mark.parametrize("shape", [(0,), (1,), (3,), (0, 2), (2, 0), (1, 1), (5, 4)])
def test_contents_keep_type_and_every_bit(tmp_path, shape):
    array, number, others = np.resize(FLOATS, shape), FLOATS[-sum(shape)], OTHERS[sum(shape) :]
    rows = Rows(tmp_path / "rows.jsonl", (Piece,))
    content = Piece((array, np.float64(number), array.astype(complex)), "é\n"), {"others": others}
    kept = rows.keep(rows.mark("a"), content)
    again = Rows(rows.path, (Piece,))
    taken = again.take(again.mark("a"))
    for found in (kept, taken):
        assert same(found[0].values[:2], content[0].values[:2])
        assert found[0].values[2].tobytes() == array.astype(complex).tobytes()
        assert same(found[1], content[1])
    turned = rows.keep(rows.mark("b"), np.ones((2, 3)).T)
    assert turned.flags.f_contiguous  # products of arrays depend on their layout


def three(path: Path) -> Rows:
    rows = Rows(path)
    for k in range(3):
        rows.keep(rows.mark("row", k), {"value": k})
    return rows


def test_a_cut_last_line_is_removed_and_damaged_ones_are_not_used(tmp_path):
    rows = three(tmp_path / "rows.jsonl")
    whole = rows.path.read_bytes()
    lines = whole.splitlines(keepends=True)
    for cut in range(1, len(lines[-1])):
        rows.path.write_bytes(whole[:-cut])
        again = Rows(rows.path)
        assert again.known == 2
        assert rows.path.read_bytes() == b"".join(lines[:-1])
        assert rows.mark("row", 2) not in again
    for place in range(len(lines[2])):  # any one byte of a line in the middle
        line = bytearray(lines[2])
        line[place] ^= 1
        rows.path.write_bytes(b"".join([*lines[:2], bytes(line), lines[3]]))
        again = Rows(rows.path)
        assert rows.mark("row", 1) not in again
        assert again.take(rows.mark("row", 0)) == {"value": 0}
        assert again.damaged >= 1 or again.known == 1  # its end was damaged: two lines are one
        assert any("damaged" in note for note in again.notes())


@pytest.mark.parametrize("content", [b"", b"{}\n", b"no newline", HEADER[:-2], b"\x00" * 500])
def test_a_file_of_somebody_else_is_refused_and_left_alone(content, tmp_path):
    path = tmp_path / "rows.jsonl"
    path.write_bytes(content)
    with pytest.raises(InputError, match="line 1: is not that of a file of rows"):
        Rows(path)
    assert path.read_bytes() == content


def test_other_code_of_the_same_version_has_other_marks(tmp_path):
    """Of two copies of what makes marks that differ in a comment, elsewhere in the package."""
    package = tmp_path / "skfem_joint"
    shutil.copytree(ROOT / "skfem_joint" / "ground", package / "ground")
    for name in ("__init__.py", "__init__.pyi"):
        shutil.copy(ROOT / "skfem_joint" / name, package)
    code = "from skfem_joint.ground.rows import Rows, Path; print(Rows(Path('none')).mark('a'))"
    command, env = [sys.executable, "-P", "-c", code], {"PYTHONPATH": str(tmp_path)}
    marks = []
    for comment in ("# one", "# one", "# two"):
        (package / "definition.py").write_text(comment, encoding="utf-8")
        marks.append(subprocess.check_output(command, env=os.environ | env))
    assert marks[0] == marks[1] != marks[2]


def test_another_kind_has_other_marks(tmp_path):
    rows = Rows(tmp_path / "rows.jsonl", (Piece,))
    mark = rows.mark("a", 1.0)
    assert mark == Rows(rows.path, (Piece,)).mark("a", 1.0)
    assert mark != rows.mark("a", np.nextafter(1.0, 2.0))
    assert mark != Rows(rows.path).mark("a", 1.0)


class Interrupted(Rows):
    """Rows of a command that is interrupted when so many have been computed."""

    last = -1

    def keep(self, *given: Any) -> Any:
        kept = super().keep(*given)
        if self.computed == self.last:
            raise KeyboardInterrupt
        return kept


RESPONSE = {"frequencies": {"from": 1800.0, "to": 2000.0, "points": 3}, "levels": [0.1, 0.3]}


def response_of(rows: Rows, executor: Executor | None = None, **options: Any) -> Any:
    time = {"cycles": 1, "steps_per_cycle": 60}
    scene = bar_scene(bar="coarse", response=RESPONSE, reduction={}, time=time, **options)
    found = scene_response(scene, executor, rows=rows)
    return [(m.name, m.curves, m.estimates) for m in found.models], found.notes


def side_by_side(rows: Rows) -> Any:
    with ThreadPoolExecutor(2) as executor:
        return response_of(rows, executor)


def error_time_of(rows: Rows) -> Any:
    wanted = {"parts": (1, 4), "factors": (10.0,), "modes": (2, 1000), "reduced_parts": (2,)}
    scene = lap_joint(bar="short_lap_joint", beta=200.0, time={"cycles": 1, "steps_per_cycle": 50})
    found = et.error_time(scene, repeats=2, quick=True, wanted=wanted, rows=rows)
    header, table = found.table()
    times = {"front", "run time (s)", "off-line (s)"}
    kept = [k for k, name in enumerate(header) if name not in times]
    return [[str(row[k]) for k in kept] for row in table], found.certificate()


COMMANDS: dict[str, tuple[Callable[[Rows], Any], tuple[type, ...]]] = {
    "response": (response_of, RESPONSE_ROWS),
    "response, side by side": (side_by_side, RESPONSE_ROWS),
    "error-time": (error_time_of, et.ROWS),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Any, Rows]]:
    """Result of a command that is not interrupted, and its rows."""

    @cache
    def of(name: str) -> tuple[Any, Rows]:
        command, kinds = COMMANDS[name]
        rows = Rows(tmp_path_factory.mktemp("whole") / "rows.jsonl", kinds)
        return command(rows), rows

    return of


def test_a_response_side_by_side_is_that_of_one_point_after_another(whole):
    assert same(whole("response, side by side")[0], whole("response")[0])


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_interrupted_goes_on_and_ends_as_if_nothing_had_happened(name, tmp_path, whole):
    """To the bit, wherever it is interrupted; no finished row is computed again."""
    command, kinds = COMMANDS[name]
    result, count = whole(name)[0], whole(name)[1].computed
    assert count > 8
    path, known = tmp_path / "rows.jsonl", 0
    for last in (1, count // 2 - 1, count // 4, count):
        rows = Interrupted(path, kinds)
        rows.last = last
        if known + last < count:
            with pytest.raises(KeyboardInterrupt):
                command(rows)
        else:
            assert same(command(rows), result)
            assert rows.taken + rows.computed == count
        assert rows.known == known
        if name != "response, side by side":  # what runs beside it may be done by then
            assert rows.taken == known
        known = Rows(path, kinds).known
    assert known == count
    assert not Rows(path, kinds).damaged


def test_rows_of_another_scene_are_not_used(tmp_path, whole):
    path = shutil.copy(whole("response")[1].path, tmp_path)
    rows = Rows(Path(path), RESPONSE_ROWS)
    response_of(rows, joint=[joint(friction=0.65)])
    assert rows.taken == 0 < rows.computed


SCENE = """
[backbone]
levels = 2

[response]
frequencies = { from = 2200.0, to = 2500.0, points = 3 }
levels = [0.1]
"""


def timeless(folder: Path) -> dict[str, Any]:
    """Content of the tables and of the summary of a folder, without times."""
    found: dict[str, Any] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix == ".csv":
            found[path.name] = path.read_text(encoding="utf-8")
        elif path.suffix == ".json":
            summary = json.loads(path.read_text(encoding="utf-8"))
            for model in summary.get("models", {}).values():
                model.pop("wall_s", None)
                model.pop("offline_s", None)
                model.pop("compilation_s", None)
            found[path.name] = summary
        else:
            found[path.name] = None
    return found


@pytest.mark.parametrize(
    "number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM]
)
def test_a_command_that_gets_a_signal_to_end_keeps_its_rows_and_goes_on(
    number, tmp_path, capsys, monkeypatch
):
    text = (ROOT / "examples" / "structure_harmonic.toml").read_text(encoding="utf-8")
    text = text.replace("steps_per_cycle = 200", "steps_per_cycle = 100")
    text = text.replace("../meshes", (ROOT / "meshes").as_posix()).replace(', "reduced"', "")
    text = text.replace("vtk = true\nplots = true", "vtk = false\nplots = false")
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(text.replace("cycles = 12", "cycles = 1") + SCENE, encoding="utf-8")
    command = ["response", str(scene)]
    assert cli.main([*command, "--out", str(tmp_path / "whole")]) == 0
    assert "taken up" not in capsys.readouterr().out
    keep = Rows.keep

    def stopped(self: Rows, *given: Any) -> Any:
        kept = keep(self, *given)
        if self.computed == 4:
            os.kill(os.getpid(), number)
        return kept

    with monkeypatch.context() as patch:
        patch.setattr(Rows, "keep", stopped)
        assert cli.main([*command, "--out", str(out)]) == 130
    shown = capsys.readouterr()
    assert [file.name for file in out.iterdir()] == ["response_rows.jsonl"]  # and no lock
    assert "\n4 rows are finished" in f"\n{shown.out}"
    assert "The same command goes on." in shown.out
    assert signal.getsignal(signal.SIGTERM) is not signal.default_int_handler
    assert cli.main([*command, "--out", str(out)]) == 0
    shown = capsys.readouterr()
    assert "4 finished rows are taken up where they fit." in shown.err
    assert "Note: 4 finished parts were taken up" in shown.out
    assert timeless(out) == timeless(tmp_path / "whole")
