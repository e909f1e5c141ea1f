"""How far a command has come: a bar on a terminal, elsewhere a line now and then."""

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

#: Called with what is done, steps done, steps in all (0: not known), and a note that tells more.
Progress = Callable[..., None]

#: A line comes after so many seconds, and after such a share of all the time that has passed.
LINE_S, LINE_SHARE = 10.0, 0.1
#: The time that remains goes by the pace of so many last seconds.
PACE_S = 120.0


def silent(*_: Any) -> None:
    """Progress that nobody asked for."""


@dataclass
class Tally:
    """What is done of what is asked for, as far as that is known; ``tell`` is called with both."""

    tell: Progress = silent
    asked: int = 0
    done: int = 0

    def add(self, count: int = 1) -> None:
        """Count so many more that are done."""
        self.done += count
        self.asked = max(self.asked, self.done)
        self.tell(self.done, self.asked)

    def within(self, *found: Any) -> None:
        """Tell the note that comes last of what one that is not done yet tells."""
        self.tell(self.done, self.asked, found[-1])


@contextmanager
def progress_bar(quiet: bool = False, lines: bool = False) -> Iterator[Progress]:
    """Progress on the error stream, if not ``quiet``; ``lines`` even where that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress as Bar

    console = Console(file=unfiltered(sys.stderr))
    bar = Bar(console=console, transient=True, speed_estimate_period=PACE_S)
    if quiet:
        yield silent
    elif lines or not sys.stderr.isatty():
        yield told(bar, lambda line: print(line, file=sys.stderr, flush=True))
    else:
        with bar:
            yield told(bar)


def told(bar: Bar, say: Callable[[str], None] | None = None) -> Progress:
    """What tells a bar of progress and, if there is ``say``, that of it in lines."""
    from rich.markup import escape

    tasks: dict[str, TaskID] = {}
    begin = last = bar.get_time()

    def progress(label: str, done: int, total: int, note: str = "") -> None:
        nonlocal last
        if label not in tasks:
            tasks[label] = bar.add_task("", total=None)
        (task,) = (one for one in bar.tasks if one.id == tasks[label])
        if done < task.completed:  # another run of the same name
            bar.reset(task.id)
        shown = f"{label}: {note}" if note else label
        description = escape(printable(shown))  # names of a scene are shown as they are
        bar.update(task.id, completed=done, total=total or None, description=description)
        now = bar.get_time()
        if say is not None and now - last >= max(LINE_S, LINE_SHARE * (now - begin)):
            last, left = now, task.time_remaining
            rest = "" if not left else f", about {timedelta(seconds=round(left))} left"
            counted = f"{done} of {total}" if total else ""
            say(f"{label}: {', '.join(filter(None, (counted, note)))}{rest}")

    return progress
