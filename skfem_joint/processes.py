"""Processes that this one starts: what they inherit, and what they do not."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, ClassVar

#: What lets a Python process look for no module in the current folder.
SAFE_PATH = "-P"
_SAFE_PATH = "PYTHONSAFEPATH"


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep Python processes that are started in the block from code in the current folder.

    Otherwise a file ``numpy.py`` there would be run in place of the library.
    """
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE_PATH, None)
        else:
            os.environ[_SAFE_PATH] = before


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Let processes and threads that are started in the block leave interrupts to this process.

    An interrupt of this one takes effect when the block ends, not while a process is half started.
    Where a system knows no signals of threads, nothing is done.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # It is started with the first process, and lets interrupts through afterwards.
    resource_tracker.ensure_running()
    came = []
    # A signal may reach any thread, but its handler runs in the main one.
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
    """Context of `multiprocessing` whose processes are spawned in this way."""

    Process: ClassVar[Any] = _Process
