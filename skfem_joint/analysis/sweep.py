"""Many scenes run by any executor: rows of results as they finish, kept in a file on the way."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent import futures
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

from skfem_joint.analysis import memory
from skfem_joint.analysis.error_time import THREADS
from skfem_joint.analysis.rows import Rows
from skfem_joint.analysis.study import origin_of, run_scene
from skfem_joint.analysis.summary import model_summary
from skfem_joint.errors import InputError, JointError
from skfem_joint.files import holding, needed
from skfem_joint.processes import SAFE_PATH, Spawn, interrupts_blocked, safe_path
from skfem_joint.scene import Scene
from skfem_joint.values import COUNT, check, check_some

Results = dict[str, Any]
#: Results, failure and warnings of a scene, as a `Row` has them.
Content = tuple[Results, str, Sequence[str]]
#: Result that says whether a model's vibration is steady; None where its loads do not repeat.
STEADY = "steady_state_reached"
_KILLED = (
    "The process that ran it ended twice, the second time with this scene alone in it; it may "
    "need more memory than there is"
)


@dataclass(frozen=True)
class Row:
    """What one scene of a sweep gave."""

    number: int  #: which of the scenes, counted from 0
    #: Numbers of ``summary.json`` in SI units by dotted names, such as
    #: ``full.peak_displacement_m.free_end``, of the models that ran to their end.
    results: Results = field(default_factory=dict)
    failure: str = ""  #: why others did not; empty where all did
    warnings: Sequence[str] = ()  #: what a run of the scene alone prints as notes

    @property
    def steady(self) -> bool:
        """Whether no model says that it has not reached a steady state."""
        return not any(k.endswith(f".{STEADY}") and x is False for k, x in self.results.items())


def sweep(
    scenes: Iterable[Scene],
    executor: Executor | Callable[[], Executor],
    journal: Path | None = None,
) -> Generator[Row]:
    """Run scenes, each in a call of its own, and yield a row for each as it finishes.

    What goes wrong with one scene is a row too. A scene whose process is killed is run again, alone
    in a new pool; if that is killed too, it has failed.

    Parameters
    ----------
    scenes : iterable of Scene
    executor : Executor, or callable that makes one
        Any of the kind of `concurrent.futures`: a pool of processes, ``client.get_executor()`` of
        ``dask.distributed``, ``mpi4py.futures.MPIPoolExecutor``. A callable is called again when
        a pool breaks, and what it made is shut down; where a given one breaks, `processes` goes on.
    journal : Path, optional
        File that each row is appended to. Scenes that have a row there are not run again, whoever
        wrote it: their rows come first. Those that were killed have none.

    Raises
    ------
    InputError
        If the journal is no file of rows, or another process writes to its folder.
    """
    scenes = list(scenes)
    with nullcontext() if journal is None else holding(journal.parent):
        kept = Rows(journal)
        marks = [kept.mark(origin_of(scene)) for scene in scenes]
        known = [mark in kept for mark in marks]
        yield from (Row(k, **kept.take(marks[k])) for k, there in enumerate(known) if there)
        waiting = deque(k for k, there in enumerate(known) if not there)
        with closing(_rows(scenes, waiting, executor)) as rows:
            for row, settled in rows:
                if settled:
                    content = {"results": row.results, "failure": row.failure}
                    content["warnings"] = list(row.warnings)
                    kept.keep(marks[row.number], content)
                yield row


def _rows(
    scenes: list[Scene], waiting: deque[int], executor: Executor | Callable[[], Executor]
) -> Generator[tuple[Row, bool]]:
    """Rows, and whether another run of the scene would give the same."""
    renew = processes if isinstance(executor, Executor) else executor
    pool = executor if isinstance(executor, Executor) else executor()
    breaks: Counter[int] = Counter()
    groups, ended = [waiting], False
    try:
        while groups:
            broken: list[int] = []
            for number, future in _finished(pool, scenes, groups[-1], broken):
                error = future.exception()
                if error is None:
                    yield Row(number, *future.result()), True
                elif isinstance(error, Exception):
                    kind = "" if isinstance(error, JointError) else f"{type(error).__name__}: "
                    yield Row(number, failure=f"{kind}{error}"), False
                else:
                    raise error
            if not groups[-1]:
                groups.pop()
            if broken:
                if pool is not executor:
                    pool.shutdown(wait=False)
                pool = renew()
            for number in broken:
                breaks[number] += 1
                if breaks[number] == 1:  # which of them broke it is seen when each is alone
                    groups.append(deque([number]))
                else:
                    yield Row(number, failure=_KILLED), False
        ended = True
    finally:
        if pool is not executor:
            pool.shutdown(wait=ended)


def _finished(
    pool: Executor, scenes: list[Scene], waiting: deque[int], broken: list[int]
) -> Iterator[tuple[int, Future[Content]]]:
    """Futures as they finish, until all are or the pool breaks: then ``broken`` has those in it."""
    # A pool of processes is given no more than it runs, so that few are in it when it breaks.
    most = getattr(pool, "_max_workers", len(scenes))
    running: dict[Future[Content], int] = {}
    try:
        while running or (waiting and not broken):
            while waiting and not broken and len(running) < most:
                number = waiting.popleft()
                scene = scenes[number]  # goes without its matrices, and fields that nobody sees
                output = {"vtk": False, "plots": False}
                try:
                    sent = pool.submit(_run, scene.unassembled(output=output))
                    running[sent] = number
                except BrokenExecutor:
                    broken.append(number)
            for future in futures.wait(running, return_when=futures.FIRST_COMPLETED).done:
                number = running.pop(future)
                if isinstance(future.exception(), BrokenExecutor):
                    broken.append(number)
                else:
                    yield number, future
    finally:
        for future in running:
            future.cancel()


def _run(scene: Scene) -> Content:
    """Run one scene where it is sent: its numbers, why there are not all of them, its notes."""
    memory.check(scene, memory.default_limit())
    failure = ""
    try:
        study = run_scene(scene)
    except JointError as error:
        failure = str(error)
        if error.results is None:
            return {}, failure, []
        study = error.results
    if study.interrupted:
        raise KeyboardInterrupt
    models = {name: model_summary(study, model) for name, model in study.models.items()}
    return dict(_flat(models)), failure, study.warnings


def _flat(content: Mapping[str, Any], start: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{start}{name}.")
        else:
            yield start + name, value


def processes(workers: int | None = None) -> futures.ProcessPoolExecutor:
    """Pool of processes, as many as the machine has cores if not said otherwise.

    They run one BLAS thread unless the environment says otherwise: it is set for this process too,
    which has read it before. They end with this process, and leave interrupts to it. As with any
    that are spawned, a script that is run starts them below ``if __name__ == "__main__"``.
    """
    check_some(COUNT, workers=workers)
    for name in THREADS:
        os.environ.setdefault(name, "1")
    with safe_path():  # of a process that counts what they share
        return futures.ProcessPoolExecutor(workers, Spawn(), initializer=_begin)


def _begin() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def executors(
    kind: str, workers: int | None = None, address: str | None = None
) -> Iterator[Callable[[], Executor]]:
    """What makes executors, of "processes", "dask" or "mpi", for as long as the block runs.

    ``address`` is that of the scheduler of a ``dask`` cluster, which has its own workers; one on
    this machine is made if it is not given. InputError if the options do not fit each other, or a
    library is missing.
    """
    if workers is not None:
        check("--workers", workers, COUNT)
    if address is not None and (kind != "dask" or workers is not None):
        raise InputError("--address: is for --executor dask, without --workers")
    if kind == "dask":
        distributed = needed("distributed", "dask")
        local = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None}
        # What goes wrong with a scene is in its row; that workers are cut off is meant at the end.
        local["silence_logs"] = logging.CRITICAL
        with ExitStack() as stack:
            stack.enter_context(safe_path())  # until the last: dead workers are started again
            with nullcontext() if address else interrupts_blocked():
                client = distributed.Client(address, **({} if address else local))
                stack.enter_context(client)
            yield client.get_executor
    elif kind == "mpi":
        library = needed("mpi4py.futures", "mpi")
        with safe_path():
            yield partial(library.MPIPoolExecutor, workers, python_args=[SAFE_PATH])
    else:
        try:
            yield partial(processes, workers)
        finally:  # after an interrupt, not in the midst of a scene that may take hours
            for process in multiprocessing.active_children():
                process.terminate()
