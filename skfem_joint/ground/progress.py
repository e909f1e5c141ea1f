"""How far a command has come: a bar on a terminal, elsewhere a line now and then."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from skfem_joint.ground.terminal import printable, unfiltered

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

#: Called with the name of a piece of work, steps done, steps in all (0 if not known), and a note.
Progress = Callable[..., None]


def silent(*_: Any) -> None:
    """Progress that nobody asked for."""


@dataclass
class Tally:
    """Count of items that are done.

    Attributes
    ----------
    report : callable
        Called with both numbers, and with a note if there is one, whenever they change.
    total : int
        Number of all items, as far as it is known.
    done : int
        Number of items that are done.
    """

    report: Progress = silent
    total: int = 0
    done: int = 0

    def add(self, count: int = 1) -> None:
        """Count ``count`` more items as done."""
        self.done += count
        self.total = max(self.total, self.done)
        self.report(self.done, self.total)

    def within(self, *progress: Any) -> None:
        """Forward the status note, the last argument, of an item that is not done yet."""
        self.report(self.done, self.total, progress[-1])


@contextmanager
def announced(report: Progress, label: str) -> Iterator[None]:
    """Report the begin and the end of work that cannot be counted."""
    report(label, 0, 0)
    yield
    report(label, 1, 1)


@contextmanager
def progress_bar(quiet: bool = False, lines: bool = False) -> Iterator[Progress]:
    """Progress on the error stream: a bar on a terminal, else lines now and then.

    With ``quiet`` nothing is shown; with ``lines`` a terminal gets lines too.
    """
    from rich.console import Console

    bar = bar_on(Console(file=unfiltered(sys.stderr)))
    if quiet:
        yield silent
    elif lines or not sys.stderr.isatty():
        yield shown_by(bar, lambda line: print(line, file=sys.stderr, flush=True))
    else:
        with bar:
            yield shown_by(bar)


def bar_on(console: Console, **options: Any) -> Bar:
    """Bar whose remaining time follows the pace of the last two minutes."""
    from rich.progress import Progress as Bar

    return Bar(console=console, transient=True, speed_estimate_period=120.0, **options)


def shown_by(bar: Bar, write: Callable[[str], None] | None = None) -> Progress:
    """Progress that updates a bar and, if there is ``write``, writes lines of it.

    A line comes at least ten seconds after the one before, and at least a tenth of the time that
    has passed since the start. Work that cannot be counted, of which nothing else is heard before
    it ends, has its line as it begins.
    """
    from rich.markup import escape

    tasks: dict[str, TaskID] = {}
    begin = last = bar.get_time()

    def progress(label: str, done: int, total: int, note: str = "") -> None:
        nonlocal last
        if label not in tasks:
            tasks[label] = bar.add_task("", total=None)
        (task,) = (task for task in bar.tasks if task.id == tasks[label])
        if done < task.completed:  # another run of the same name
            bar.reset(task.id)
        shown = f"{label}: {note}" if note else label
        description = escape(printable(shown))  # without markup or control characters
        bar.update(task.id, completed=done, total=total or None, description=description)
        now = bar.get_time()
        begins = total == 0 and not note
        if write is not None and (begins or now - last >= max(10.0, 0.1 * (now - begin))):
            last, left = now, task.time_remaining
            rest = "" if not left else f", about {timedelta(seconds=round(left))} left"
            counted = f"{done} of {total}" if total else ""
            said = ", ".join(filter(None, (counted, note)))
            write((f"{label}: {said}" if said else label) + rest)

    return progress
