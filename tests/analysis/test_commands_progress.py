"""Commands that search tell how far they are, and end within a second of Ctrl-C."""

from __future__ import annotations

import io
import json
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
from rich.console import Console
from rich.progress import Progress as Bar
from scene_texts import written
from stepping_systems import arm

from skfem_joint.analysis.backbone import CHECKED, INCREMENTS, TRIALS, backbone
from skfem_joint.analysis.response import response
from skfem_joint.loads import Harmonic
from skfem_joint.progress import told as telling
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.steady import CHANGE

BAR = arm(Harmonic(30e3, 2025.0), elements=(20, 20), stiffness_damping=1e-6)


def told_by(search: Callable[[Any], Any]) -> tuple[Any, list[tuple[Any, ...]]]:
    """What a search finds, and what it tells on its way."""
    told: list[tuple[Any, ...]] = []
    return search(lambda *one: told.append(one)), told


@pytest.mark.parametrize("estimated", [True, False])
def test_a_response_tells_every_vibration_that_it_looks_for(estimated):
    frequencies, levels = np.linspace(1900.0, 2100.0, 5), (0.5, 1.0)
    curves, told = told_by(
        lambda tell: response(BAR, frequencies, levels, estimated=estimated, progress=tell)
    )
    looked_for = sum(len(curve.points) for curve in curves) * (2 if estimated else 1)
    found = [one for one in told if len(one) == 2]
    assert [done for done, _ in found] == list(range(1, looked_for + 1))
    assert found[-1] == (looked_for, looked_for)
    assert all("periods" in one[2] for one in told if len(one) > 2)
    assert found[0][1] == 10 * (2 if estimated else 1)  # those asked for, before any is added


def test_a_backbone_tells_every_level_and_part_of_a_loop():
    levels = 6
    _, told = told_by(lambda tell: backbone(BAR, (1, 2), levels, progress=tell))
    trials = len(told) - 2 * (levels + CHECKED * INCREMENTS)  # for where a joint slips as a whole
    assert 0 <= trials <= 2 * TRIALS
    assert [done for done, _ in told] == list(range(1, len(told) + 1))
    assert told[-1] == (len(told), len(told))
    assert told[0][1] >= len(told) - trials


def test_a_search_for_what_is_steady_tells_its_periods_and_how_far_they_are_from_it():
    run, told = told_by(
        lambda tell: integrate(BAR, until="steady", steps_per_cycle=100, progress=tell)
    )
    notes = dict.fromkeys(note.partition(", change ")[2] for *_, note in told)
    changes = [float(note.split()[0]) for note in notes if note]
    assert run.steady is not None
    assert told[-1][0] >= run.steady.periods  # and the one that is stored
    assert changes[-1] == pytest.approx(run.steady.change, rel=0.1)
    assert changes[-1] <= CHANGE < changes[-2]


def test_a_line_holds_the_note_of_what_cannot_be_counted():
    now, said = [0.0], list[str]()
    progress = telling(
        Bar(console=Console(file=io.StringIO()), get_time=lambda: now[0]), said.append
    )
    for done, total in ((3, 0), (3, 40)):
        now[0] += 20.0
        progress("full model", done, total, "3.5 periods")
    assert said == ["full model: 3.5 periods", "full model: 3 of 40, 3.5 periods"]


def interrupted(pattern: bytes, *arguments: str | Path) -> tuple[int, bytes, float]:
    """Status of a command whose terminal gets Ctrl-C once it shows a pattern, all, and seconds."""
    master, terminal = pty.openpty()
    with (
        os.fdopen(master, "rb", buffering=0) as screen,
        subprocess.Popen(
            [sys.executable, "-m", "skfem_joint", *map(str, arguments)],
            stdout=terminal, stderr=terminal, env={**os.environ, "TERM": "xterm", "COLUMNS": "150"},
            # A shell's job ignores it.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        ) as process,
    ):  # fmt: skip
        os.close(terminal)
        try:
            shown = b""
            while not re.search(pattern, shown):
                assert select.select([screen], [], [], 60.0)[0], shown
                shown += screen.read(4096)
            begin = time.monotonic()
            process.send_signal(signal.SIGINT)
            while select.select([screen], [], [], 60.0)[0]:
                try:
                    shown += screen.read(4096)
                except OSError:  # the other end is closed
                    break
            return process.wait(60.0), shown, time.monotonic() - begin
        finally:
            process.kill()


#: Tables that make each command search for longer than anybody waits.
LONG = {
    "backbone": "[backbone]\nlevels = 20_000",
    "response": "[response]\nfrequencies = { from = 400.0, to = 600.0, points = 200 }",
    "run": "",
}
FULL = ('["full", "reduced"]', '["full"]')


@pytest.mark.parametrize("command", LONG)
def test_ctrl_c_ends_a_search_within_a_second(tmp_path, command):
    """On a terminal, which shows a live line: status 130, no traceback, no files."""
    steady = ("cycles = 3", 'until = "steady"\nsteps_per_cycle = 20000')
    damping = ("[output]", "[damping]\nstiffness = 1e-12\n[output]")
    path, out = written(tmp_path, steady, FULL, damping, more=LONG[command]), tmp_path / "out"
    pattern = rb"full model.*\d%|[1-9][.]\d periods"
    status, shown, passed = interrupted(pattern, command, path, "--out", out)
    assert status == 130, shown
    assert b"interrupted" in shown
    assert b"Traceback" not in shown
    assert not out.exists() or not [file for file in out.rglob("*") if file.is_file()]
    assert passed < 5.0  # a second where nothing else runs


def test_ctrl_c_in_a_run_keeps_the_steps_that_are_done(tmp_path):
    path = written(tmp_path, ("cycles = 3", "cycles = 100000"), FULL, ("every = 1", "every = 1000"))
    out = tmp_path / "out"
    status, shown, _ = interrupted(rb"full model.*[1-9]\d*%", "run", path, "--out", out)
    assert status == 130
    assert b"interrupted in the full model" in shown
    steps = json.loads((out / "summary.json").read_text())["models"]["full"]["steps"]
    assert 0 < steps < 20_000_000
    with np.load(out / "history.npz", allow_pickle=False) as history:
        assert abs(history["time"].size - 1 - steps / 1000) <= 1
