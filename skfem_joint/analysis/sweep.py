"""Many scenes run by any executor: rows of results as they finish, kept in a file on the way."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from skfem_joint import __version__
from skfem_joint.analysis import memory
from skfem_joint.analysis.error_time import THREADS
from skfem_joint.analysis.study import origin_of, run_scene
from skfem_joint.analysis.summary import model_summary
from skfem_joint.errors import InputError, JointError
from skfem_joint.files import holding, needed
from skfem_joint.stepping.checkpoint import fingerprint

if TYPE_CHECKING:
    from skfem_joint.scene import Scene

Results = dict[str, Any]
_KILLED = (
    "The process that ran it ended twice, the second time with this scene alone in it; it may "
    "need more memory than there is"
)


@dataclass(frozen=True)
class Row:
    """What one scene of a sweep gave.

    Attributes
    ----------
    number : int
        Which of the scenes, counted from 0.
    results : dict
        Numbers of ``summary.json`` in SI units by dotted names, such as
        ``full.peak_displacement_m.free_end``, of the models that ran to their end.
    failure : str
        Why others did not; empty where all did.
    """

    number: int
    results: Results = field(default_factory=dict)
    failure: str = ""


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
        If the journal is none, or another process writes to its folder.
    """
    scenes = list(scenes)
    with nullcontext() if journal is None else holding(journal.parent):
        waiting: deque[int] = deque()
        known = {} if journal is None else _read(journal)
        marks = [] if journal is None else [fingerprint(origin_of(s), __version__) for s in scenes]
        for number in range(len(scenes)):
            if journal is not None and marks[number] in known:
                yield Row(number, *known[marks[number]])
            else:
                waiting.append(number)
        with closing(_rows(scenes, waiting, executor)) as rows:
            for row, settled in rows:
                if journal is not None and settled:
                    _append(journal, {"scene": marks[row.number], **_content(row)})
                yield row


def _content(row: Row) -> dict[str, Any]:
    return {"results": row.results, "failure": row.failure}


def _rows(
    scenes: list[Scene], waiting: deque[int], executor: Executor | Callable[[], Executor]
) -> Generator[tuple[Row, bool]]:
    """Rows, and whether another run of the scene would give the same."""
    given = isinstance(executor, Executor)
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
            if not broken:
                continue
            if not given:
                pool.shutdown(wait=False)
            pool, given = renew(), False
            breaks.update(broken)
            # Which of them broke the pool is seen when each is alone in one.
            groups += [deque([number]) for number in broken if breaks[number] == 1]
            for number in broken:
                if breaks[number] > 1:
                    yield Row(number, failure=_KILLED), False
        ended = True
    finally:
        if not given:
            pool.shutdown(wait=ended)


def _finished(
    pool: Executor, scenes: list[Scene], waiting: deque[int], broken: list[int]
) -> Iterator[tuple[int, Future[tuple[Results, str]]]]:
    """Futures as they finish, until all are or the pool breaks: then ``broken`` has those in it."""
    # A pool of processes is given no more than it runs, so that few are in it when it breaks.
    most = getattr(pool, "_max_workers", len(scenes))
    running: dict[Future[tuple[Results, str]], int] = {}
    try:
        while running or (waiting and not broken):
            while waiting and not broken and len(running) < most:
                number = waiting.popleft()
                try:
                    running[pool.submit(_run, _slim(scenes[number]))] = number
                except BrokenExecutor:
                    broken.append(number)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                number = running.pop(future)
                if isinstance(future.exception(), BrokenExecutor):
                    broken.append(number)
                else:
                    yield number, future
    finally:
        for future in running:
            future.cancel()


def _slim(scene: Scene) -> Scene:
    """Scene without its matrices, and without fields that nobody sees."""
    return scene.changed(mesh=scene.named_mesh, output={"vtk": False, "plots": False})


def _run(scene: Scene) -> tuple[Results, str]:
    """Run one scene where it is sent: its numbers, and why there are not all of them."""
    memory.check(scene, memory.default_limit())
    failure = ""
    try:
        study = run_scene(scene)
    except JointError as error:
        failure = str(error)
        if error.results is None:
            return {}, failure
        study = error.results
    if study.interrupted:
        raise KeyboardInterrupt
    models = {name: model_summary(study, model) for name, model in study.models.items()}
    return dict(_flat(models)), failure


def _flat(content: Mapping[str, Any], start: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{start}{name}.")
        else:
            yield start + name, value


def _read(journal: Path) -> dict[str, tuple[Results, str]]:
    """Rows of a journal by the fingerprints of their scenes; a line that was torn is cut off."""
    if not journal.exists():
        return {}
    text = journal.read_bytes()
    whole = text.rfind(b"\n") + 1
    if whole < len(text):
        os.truncate(journal, whole)
    rows = {}
    for number, line in enumerate(text[:whole].splitlines(), 1):
        try:
            row = json.loads(line)
            rows[str(row["scene"])] = dict(row["results"]), str(row["failure"])
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{journal}: line {number}: is not a row of a sweep; move the file away, or choose "
                "another folder"
            ) from error
    return rows


def _append(journal: Path, row: Mapping[str, Any]) -> None:
    """Add a line to a journal, and see that it is on the disk."""
    with journal.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row, allow_nan=False) + "\n")
        file.flush()
        os.fsync(file.fileno())


def processes(workers: int | None = None) -> ProcessPoolExecutor:
    """Pool of processes, as many as the machine has cores if not said otherwise.

    They run one BLAS thread unless the environment says otherwise: it is set for this process too,
    which has read it before. They end with this process, and leave interrupts to it. As with any
    that are spawned, a script that is run starts them below ``if __name__ == "__main__"``.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")
    spawned = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, spawned, initializer=_follow_parent)


def _follow_parent() -> None:
    """Leave interrupts to the process that started this one, and end when that is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def end() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=end, daemon=True).start()


@contextmanager
def executors(
    kind: str, workers: int | None = None, address: str | None = None
) -> Iterator[Callable[[], Executor]]:
    """What makes executors of a kind, for as long as the block runs.

    Parameters
    ----------
    kind : {"processes", "dask", "mpi"}
    workers : int, optional
        Processes; not for a ``dask`` cluster of an address, which has its own.
    address : str, optional
        Of the scheduler of a ``dask`` cluster; one on this machine is made if it is not given.

    Raises
    ------
    InputError
        If the options do not fit each other, or a library is missing.
    """
    if workers is not None and workers < 1:
        raise InputError(f"--workers: found {workers}, must be >= 1")
    if address is not None and (kind != "dask" or workers is not None):
        raise InputError("--address: is for --executor dask, without --workers")
    if kind == "dask":
        distributed = needed("distributed", "dask")
        local = {"n_workers": workers, "threads_per_worker": 1, "dashboard_address": None}
        with distributed.Client(address, **({} if address else local)) as client:
            yield client.get_executor
    elif kind == "mpi":
        yield partial(needed("mpi4py.futures", "mpi").MPIPoolExecutor, workers)
    else:
        try:
            yield partial(processes, workers)
        finally:  # after an interrupt, not in the midst of a scene that may take hours
            for process in multiprocessing.active_children():
                process.terminate()
