"""Child processes: safe import paths, and interrupts that are left to the parent."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, ClassVar

#: Option with which Python imports no module from the current folder.
SAFE_PATH = "-P"


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep Python processes that are started in the block from code in the current folder.

    Otherwise a file ``numpy.py`` there would be run in place of the library.
    """
    variable = "PYTHONSAFEPATH"
    before = os.environ.get(variable)
    os.environ[variable] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(variable, None)
        else:
            os.environ[variable] = before


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block interrupts in processes and threads that are started in the block.

    They are left to this process. Here an interrupt takes effect when the block ends, not while a
    process is half started. On systems without signal masks nothing is done.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # The tracker starts with the first process, and would unblock interrupts while it does.
    resource_tracker.ensure_running()
    came = []
    # A signal may reach any thread, but its handler runs in the main thread.
    handled = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda *_: came.append(True)) if handled else None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if handled:
            signal.signal(signal.SIGINT, handler or signal.SIG_DFL)
        if came:
            signal.raise_signal(signal.SIGINT)


class _Process(SpawnProcess):
    def start(self) -> None:
        with safe_path(), interrupts_blocked():
            super().start()


class Spawn(SpawnContext):
    """Context of `multiprocessing`: processes have a safe path and leave interrupts to this one."""

    Process: ClassVar[Any] = _Process
