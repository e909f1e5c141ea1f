"""How far a command has come: a bar on a terminal, elsewhere a line now and then."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

#: Called with what is done, steps done, steps in all.
Progress = Callable[[str, int, int], None]

#: A line comes after so many seconds, and after such a share of all the time that has passed.
LINE_S, LINE_SHARE = 10.0, 0.1
#: The time that remains goes by the pace of so many last seconds.
PACE_S = 120.0


@contextmanager
def progress_bar(quiet: bool = False, lines: bool = False) -> Iterator[Progress]:
    """Progress on the error stream, if not ``quiet``; ``lines`` even where that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress as Bar

    bar = Bar(console=Console(stderr=True), transient=True, speed_estimate_period=PACE_S)
    if quiet:
        yield lambda *_: None
    elif lines or not sys.stderr.isatty():
        yield told(bar, lambda line: print(line, file=sys.stderr, flush=True))
    else:
        with bar:
            yield told(bar)


def told(bar: Bar, say: Callable[[str], None] | None = None) -> Progress:
    """What tells a bar of progress and, if there is ``say``, that of it in lines."""
    tasks: dict[str, TaskID] = {}
    begin = last = bar.get_time()

    def progress(label: str, done: int, total: int) -> None:
        nonlocal last
        if label not in tasks:
            tasks[label] = bar.add_task(label, total=total)
        (task,) = (one for one in bar.tasks if one.id == tasks[label])
        if done < task.completed or total != task.total:  # another run of the same name
            bar.reset(task.id, total=total)
        bar.update(task.id, completed=done)
        now = bar.get_time()
        if say is not None and now - last >= max(LINE_S, LINE_SHARE * (now - begin)):
            last, left = now, task.time_remaining
            rest = "" if not left else f", about {timedelta(seconds=round(left))} left"
            say(f"{label}: {done} of {total}{rest}")

    return progress
