"""Progress by a clock of its own: lines now and then, and the time that remains."""

import io
import re
from itertools import pairwise
from typing import Any

import pytest
from rich.console import Console
from rich.progress import Progress as Bar

from skfem_joint.progress import LINE_S, PACE_S, told


class Clock:
    """Progress in lines, each with the time at which it was said."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.said: list[tuple[float, str]] = []
        console = Console(file=io.StringIO())
        bar = Bar(console=console, get_time=lambda: self.now, speed_estimate_period=PACE_S)
        self.progress = told(bar, lambda line: self.said.append((self.now, line)))

    def steps(self, seconds: float, first: int, last: int, total: int) -> None:
        for done in range(first, last + 1):
            self.now += seconds
            self.progress("run", done, total)


def left(line: str) -> float:
    found: Any = re.search(r"about (?:(\d+) days?, )?(\d+):(\d\d):(\d\d) left", line)
    assert found, line
    days, hours, minutes, seconds = (int(part or 0) for part in found.groups())
    return float(((24 * days + hours) * 60 + minutes) * 60 + seconds)


# A run taken up again has its first steps for nothing.
@pytest.mark.parametrize(("seconds", "first"), [(0.001, 1), (0.6, 1), (0.6, 3001), (45.0, 3990)])
def test_the_remaining_time_is_that_of_the_steps_left(seconds, first):
    clock = Clock()
    total = 4000 if seconds > 0.01 else 200_000
    clock.steps(seconds, first, total, total)
    spoken = [(at, line) for at, line in clock.said if "left" in line]
    assert len(spoken) >= len(clock.said) - 2 > 3  # not the first of one call, nor at the end
    for _, line in spoken:
        done = int(line.split()[1])
        assert left(line) == pytest.approx((total - done) * seconds, abs=1.0)


def test_a_second_run_of_the_same_name_starts_anew():
    clock = Clock()
    clock.steps(0.5, 1, 100, 100)
    said = len(clock.said)
    clock.steps(2.0, 1, 50, 200)
    assert len(clock.said) > said + 2
    for _, line in clock.said[said + 1 :]:
        assert left(line) == pytest.approx((200 - int(line.split()[1])) * 2.0, abs=1.0)


def test_lines_come_now_and_then_and_ever_less():
    clock = Clock()
    clock.steps(0.5, 1, 19, 20)
    assert clock.said == []  # a run of less than ten seconds says nothing
    clock.steps(0.5, 1, 100_000, 100_000)  # fourteen hours
    times = [at for at, _ in clock.said]
    gaps = [after - before for before, after in pairwise(times)]
    assert min(gaps) >= LINE_S
    assert len(times) < 80
