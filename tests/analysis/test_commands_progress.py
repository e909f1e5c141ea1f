"""Commands that search tell how far they are, and end within a second of Ctrl-C."""

from __future__ import annotations

import io
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mesh_files import MESHES
from rich.console import Console
from rich.progress import Progress as Bar
from scene_texts import GOOD, with_changes

from skfem_joint.analysis.backbone import CHECKED, INCREMENTS, TRIALS, backbone
from skfem_joint.analysis.response import response
from skfem_joint.loads import Harmonic
from skfem_joint.mesh import build_bar
from skfem_joint.progress import told as telling
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.steady import CHANGE
from skfem_joint.structure import Joint, Load, Material, Structure
from skfem_joint.system import System


def bar() -> System:
    mesh = build_bar([("joint", 0.2, 20), ("free", 0.5, 20)], {"fixed": 0.0, "end": 0.7})
    structure = Structure(
        mesh, Material(200e9, 8000.0), width=0.05, thickness=0.01, fixed=["fixed"],
        joints=[Joint("joint", 50e6, 0.7, beta=np.inf)], stiffness_damping=1e-6,
    )  # fmt: skip
    return structure.system([Load("end", Harmonic(30e3, 2025.0))])


def told_by(search: Callable[[Any], Any]) -> tuple[Any, list[tuple[Any, ...]]]:
    """What a search finds, and what it tells on its way."""
    told: list[tuple[Any, ...]] = []
    return search(lambda *one: told.append(one)), told


@pytest.mark.parametrize("estimated", [True, False])
def test_a_response_tells_every_vibration_that_it_looks_for(estimated: bool) -> None:
    frequencies, levels = np.linspace(1900.0, 2100.0, 5), (0.5, 1.0)
    curves, told = told_by(
        lambda tell: response(bar(), frequencies, levels, estimated=estimated, progress=tell)
    )
    looked_for = sum(len(curve.points) for curve in curves) * (2 if estimated else 1)
    found = [one for one in told if len(one) == 2]
    assert [done for done, _ in found] == list(range(1, looked_for + 1))
    assert found[-1] == (looked_for, looked_for)
    assert all("periods" in one[2] for one in told if len(one) > 2)
    assert found[0][1] == 10 * (2 if estimated else 1)  # those asked for, before any is added


def test_a_backbone_tells_every_level_and_part_of_a_loop() -> None:
    levels = 6
    _, told = told_by(lambda tell: backbone(bar(), (1, 2), levels, progress=tell))
    trials = len(told) - 2 * (levels + CHECKED * INCREMENTS)  # for where a joint slips as a whole
    assert 0 <= trials <= 2 * TRIALS
    assert [done for done, _ in told] == list(range(1, len(told) + 1))
    assert told[-1] == (len(told), len(told))
    assert told[0][1] >= len(told) - trials


def test_a_search_for_what_is_steady_tells_its_periods_and_how_far_they_are_from_it() -> None:
    run, told = told_by(
        lambda tell: integrate(bar(), until="steady", steps_per_cycle=100, progress=tell)
    )
    notes = dict.fromkeys(note.partition(", change ")[2] for *_, note in told)
    changes = [float(note.split()[0]) for note in notes if note]
    assert run.steady is not None
    assert told[-1][0] >= run.steady.periods  # and the one that is stored
    assert changes[-1] == pytest.approx(run.steady.change, rel=0.1)
    assert changes[-1] <= CHANGE < changes[-2]


def test_a_line_holds_the_note_of_what_cannot_be_counted() -> None:
    now, said = [0.0], list[str]()
    progress = telling(
        Bar(console=Console(file=io.StringIO()), get_time=lambda: now[0]), said.append
    )
    for done, total in ((3, 0), (3, 40)):
        now[0] += 20.0
        progress("full model", done, total, "3.5 periods")
    assert said == ["full model: 3.5 periods", "full model: 3 of 40, 3.5 periods"]


#: Changes of the scene that make each command search for longer than anybody waits.
LONG = {
    "backbone": "levels = 20_000",
    "response": "frequencies = { from = 400.0, to = 600.0, points = 200 }",
    "run": "",
}


@pytest.mark.parametrize("command", LONG)
def test_ctrl_c_ends_a_search_within_a_second(tmp_path: Path, command: str) -> None:
    """On a terminal, which shows a live line: status 130, no traceback, no files."""
    path, out = tmp_path / "scene.toml", tmp_path / "out"
    text = with_changes(
        GOOD,
        ("bar.msh", (MESHES / "structure.msh").as_posix()),
        ("cycles = 3", 'until = "steady"\nsteps_per_cycle = 20000'),
        ('["full", "reduced"]', '["full"]'),
        ("[output]", "[damping]\nstiffness = 1e-12\n[output]"),
    )
    path.write_text(text + (f"[{command}]\n{LONG[command]}\n" if LONG[command] else ""))
    master, terminal = pty.openpty()
    with (
        os.fdopen(master, "rb", buffering=0) as screen,
        subprocess.Popen(
            [sys.executable, "-m", "skfem_joint", command, str(path), "--out", str(out)],
            stdout=terminal, stderr=terminal, env={**os.environ, "TERM": "xterm", "COLUMNS": "150"},
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        ) as process,
    ):  # fmt: skip
        os.close(terminal)
        try:
            shown = b""
            while not re.search(rb"full model.*\d%|[1-9][.]\d periods", shown):
                assert select.select([screen], [], [], 60.0)[0], shown
                shown += screen.read(4096)
            begin = time.monotonic()
            process.send_signal(signal.SIGINT)
            while select.select([screen], [], [], 60.0)[0]:
                try:
                    shown += screen.read(4096)
                except OSError:  # the other end is closed
                    break
            status, passed = process.wait(60.0), time.monotonic() - begin
        finally:
            process.kill()
    assert status == 130, shown
    assert b"interrupted" in shown
    assert b"Traceback" not in shown
    assert not out.exists() or not [file for file in out.rglob("*") if file.is_file()]
    assert passed < 5.0  # a second where nothing else runs
