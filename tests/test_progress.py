"""Commands report their progress from time to time, and end within a second of Ctrl-C."""

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
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from scene_texts import written
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.ground.progress import announced, bar_on, shown_by
from skfem_joint.results.gross_slip import TRIALS
from skfem_joint.steady.steady import CHANGE
from skfem_joint.vibration.cycles import items_of_work

BAR = arm(sj.Harmonic(30e3, 2025.0), elements=(20, 20), stiffness_damping=1e-6)


def reported_by(search: Callable[[Any], Any]) -> tuple[Any, list[tuple[Any, ...]]]:
    """Result of a search, and what it reports on its way."""
    reports: list[tuple[Any, ...]] = []
    return search(lambda *report: reports.append(report)), reports


@pytest.mark.parametrize("estimated", [True, False])
def test_a_response_reports_every_vibration_that_it_searches_for(estimated):
    frequencies, levels = np.linspace(1900.0, 2100.0, 5), (0.5, 1.0)
    curves, reports = reported_by(
        lambda report: sj.response(BAR, frequencies, levels, estimated=estimated, progress=report)
    )
    each = 2 if estimated else 1
    frequency_counts = [len(curve.points) for curve in curves]
    searched = each * sum(frequency_counts)
    done, total = np.array([report for report in reports if len(report) == 2]).T
    np.testing.assert_array_equal(done, np.arange(1, searched + 1))
    assert total[-1] == searched
    assert all("periods" in report[2] for report in reports if len(report) > 2)
    assert total[0] == each * 2 * 5  # those asked for
    assert np.all(np.diff(total) >= 0)


def test_a_backbone_reports_every_level_and_part_of_a_loop():
    levels = 6
    _, reports = reported_by(lambda report: sj.backbone(BAR, (1, 2), levels, progress=report))
    # The other reports are of trials for the load at which a joint slips as a whole.
    trials = len(reports) - 2 * items_of_work(levels, opens=False)
    assert 0 <= trials <= 2 * TRIALS
    assert [done for done, _ in reports] == list(range(1, len(reports) + 1))
    assert reports[-1] == (len(reports), len(reports))
    assert reports[0][1] >= len(reports) - trials


def test_a_search_for_what_is_steady_reports_its_periods_and_how_far_they_are_from_it():
    run, reports = reported_by(
        lambda report: sj.integrate(BAR, until="steady", steps_per_cycle=100, progress=report)
    )
    notes = dict.fromkeys(note.partition(", change ")[2] for *_, note in reports)
    changes = [float(note.split()[0]) for note in notes if note]
    assert run.steady is not None
    assert reports[-1][0] >= run.steady.periods  # and the one that is stored
    assert changes[-1] == pytest.approx(run.steady.change, rel=0.1)
    assert changes[-1] <= CHANGE < changes[-2]


class Clock:
    """Progress in lines, each with the time at which it was said."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.said: list[tuple[float, str]] = []
        bar = bar_on(Console(file=io.StringIO()), get_time=lambda: self.now)
        self.progress = shown_by(bar, lambda line: self.said.append((self.now, line)))

    def steps(self, seconds: float, first: int, last: int, total: int) -> None:
        for done in range(first, last + 1):
            self.now += seconds
            self.progress("run", done, total)


def left(line: str) -> float:
    match: Any = re.search(r"about (?:(\d+) days?, )?(\d+):(\d\d):(\d\d) left", line)
    assert match, line
    days, hours, minutes, seconds = (int(part or 0) for part in match.groups())
    return float(((24 * days + hours) * 60 + minutes) * 60 + seconds)


@pytest.mark.parametrize(
    ("before", "seconds", "first", "total"),
    [(0, 0.001, 1, 200_000), (0, 0.6, 1, 4000), (0, 0.6, 3001, 4000), (0, 45.0, 3990, 4000),
     (100, 2.0, 1, 200)],
)  # fmt: skip
def test_the_remaining_time_is_that_of_the_steps_left(before, seconds, first, total):
    """Also of a run taken up again, which has its first steps for nothing, or of a second one."""
    clock = Clock()
    clock.steps(0.5, 1, before, before)
    begin = len(clock.said)
    clock.steps(seconds, first, total, total)
    said = [line for _, line in clock.said[begin:]]
    spoken = [line for line in said if "left" in line]
    assert len(spoken) >= len(said) - 2 > 3  # not the first of one call, nor at the end
    for line in spoken:
        done = int(line.split()[1])
        assert left(line) == pytest.approx((total - done) * seconds, abs=1.0)


def test_lines_come_now_and_then_and_ever_less():
    clock = Clock()
    clock.steps(0.5, 1, 19, 20)
    assert clock.said == []  # a run of less than ten seconds says nothing
    clock.steps(0.5, 1, 100_000, 100_000)  # fourteen hours
    times = [at for at, _ in clock.said]
    gaps = [after - before for before, after in pairwise(times)]
    assert min(gaps) >= 10.0
    assert len(times) < 80


def test_a_line_holds_the_note_of_what_cannot_be_counted():
    clock = Clock()
    for done, total in ((3, 0), (3, 40)):
        clock.now += 20.0
        clock.progress("full model", done, total, "3.5 periods")
    lines = ["full model: 3.5 periods", "full model: 3 of 40, 3.5 periods"]
    assert [line for _, line in clock.said] == lines


def test_work_that_cannot_be_counted_is_said_as_it_begins():
    clock = Clock()
    clock.now += 0.5
    for label in ("making the structure", "linear response"):
        with announced(clock.progress, label):
            clock.now += 3.0
    assert clock.said == [(1000.5, "making the structure"), (1003.5, "linear response")]


def test_a_bar_shows_names_as_they_are():
    screen = io.StringIO()
    bar = bar_on(Console(file=screen, force_terminal=True, width=200, color_system=None))
    with bar:
        shown_by(bar)("[red]\x1b]0;mine\x07", 1, 2, "\x9b31m")
    assert "[red]\\x1b]0;mine\\x07: \\x9b31m" in screen.getvalue()
    assert "\x1b]" not in screen.getvalue()


def interrupted(pattern: bytes, *arguments: str | Path) -> tuple[int, bytes, float]:
    """Status of a command whose terminal gets Ctrl-C once it shows a pattern, all, and seconds."""
    master, terminal = pty.openpty()
    with (
        os.fdopen(master, "rb", buffering=0) as screen,
        subprocess.Popen(
            [sys.executable, "-m", "skfem_joint", *map(str, arguments)],
            stdout=terminal, stderr=terminal, env={**os.environ, "TERM": "xterm", "COLUMNS": "150"},
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


@pytest.mark.slow
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
    files = {file.name for file in out.rglob("*") if file.is_file()} if out.exists() else set()
    assert files <= {f"{command}_rows.jsonl"}  # what is finished is kept
    assert passed < 20.0  # a second where nothing else runs


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
