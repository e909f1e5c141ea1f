"""Progress of a command: a bar on a terminal, elsewhere a line from time to time."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from skfem_joint.terminal import printable, unfiltered

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

#: Called with the name of a task, the steps done, the steps in all (0: not known), and a note.
Progress = Callable[..., None]


@dataclass(frozen=True)
class ProgressSettings:
    """When progress is printed in lines.

    Attributes
    ----------
    interval, share : float
        A line comes after this time, s, and after this share of the time since the start.
    pace : float
        The remaining time is estimated from the pace of the last seconds, so many.
    """

    interval: float = 10.0
    share: float = 0.1
    pace: float = 120.0


SETTINGS = ProgressSettings()


def silent(*_: Any) -> None:
    """Progress that is not shown."""


@dataclass
class Tally:
    """Count of finished items.

    Attributes
    ----------
    report : callable
        Called with ``done`` and ``asked``, and a note if there is one.
    asked : int
        Items in all, as far as they are known.
    done : int
        Finished items.
    """

    report: Progress = silent
    asked: int = 0
    done: int = 0

    def add(self, count: int = 1) -> None:
        """Count more finished items."""
        self.done += count
        self.asked = max(self.asked, self.done)
        self.report(self.done, self.asked)

    def within(self, *reported: Any) -> None:
        """Forward the status note of an unfinished item: the last value that it reports."""
        self.report(self.done, self.asked, reported[-1])


@contextmanager
def progress_bar(quiet: bool = False, lines: bool = False) -> Iterator[Progress]:
    """Progress on the error stream.

    It is a bar on a terminal, and lines elsewhere or if ``lines`` is true; nothing if ``quiet``.
    """
    from rich.console import Console
    from rich.progress import Progress as Bar

    console = Console(file=unfiltered(sys.stderr))
    bar = Bar(console=console, transient=True, speed_estimate_period=SETTINGS.pace)
    if quiet:
        yield silent
    elif lines or not sys.stderr.isatty():
        yield shown_on(bar, lambda line: print(line, file=sys.stderr, flush=True))
    else:
        with bar:
            yield shown_on(bar)


def shown_on(bar: Bar, print_line: Callable[[str], None] | None = None) -> Progress:
    """Progress that moves a bar and, with ``print_line``, prints a line from time to time."""
    from rich.markup import escape

    tasks: dict[str, TaskID] = {}
    begin = last = bar.get_time()

    def progress(label: str, done: int, total: int, note: str = "") -> None:
        nonlocal last
        if label not in tasks:
            tasks[label] = bar.add_task("", total=None)
        (task,) = (known for known in bar.tasks if known.id == tasks[label])
        if done < task.completed:  # another run of the same name
            bar.reset(task.id)
        shown = f"{label}: {note}" if note else label
        description = escape(printable(shown))  # names of a scene are shown as they are
        bar.update(task.id, completed=done, total=total or None, description=description)
        now = bar.get_time()
        wait = max(SETTINGS.interval, SETTINGS.share * (now - begin))
        if print_line is not None and now - last >= wait:
            last, left = now, task.time_remaining
            rest = "" if not left else f", about {timedelta(seconds=round(left))} left"
            counted = f"{done} of {total}" if total else ""
            print_line(f"{label}: {', '.join(filter(None, (counted, note)))}{rest}")

    return progress
