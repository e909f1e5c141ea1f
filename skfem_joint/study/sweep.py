"""Run many scenes in any executor; each gives a row of results as it finishes, kept in a file."""

from __future__ import annotations

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
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

from skfem_joint.ground.errors import JointError
from skfem_joint.ground.files import holding
from skfem_joint.ground.plain_values import Tabular
from skfem_joint.ground.processes import Spawn, safe_path
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.ground.rows import Rows
from skfem_joint.ground.values import COUNT, check, check_some
from skfem_joint.scene import Scene
from skfem_joint.study.error_time import THREADS
from skfem_joint.study.models import origin_of
from skfem_joint.study.scene_range import make_missing
from skfem_joint.study.study import run_scene
from skfem_joint.study.summary import model_summary

Results = dict[str, Any]
#: Results, failure and warnings of a scene, as a `Row` has them.
Content = tuple[Results, str, Sequence[str]]
#: Result that says whether a model's vibration is steady; None where its loads do not repeat.
STEADY = "steady_state_reached"


@dataclass(frozen=True)
class Row(Tabular):
    """Results of a scene of a sweep.

    Attributes
    ----------
    number : int
        Number of the scene, from 0.
    results : dict
        Numbers of ``summary.json`` in SI units by dotted names, such as
        ``full.peak_displacement_m.free_end``, of the models that ran to their end.
    failure : str
        Why the others did not; empty where all did.
    notes : sequence of str
        What a run of the scene alone prints as notes.
    """

    number: int
    results: Results = field(default_factory=dict)
    failure: str = ""
    notes: Sequence[str] = ()

    @property
    def table(self) -> dict[str, Any]:
        """Columns of a single row; ``pandas.concat`` puts those of a sweep below each other."""
        row = {"number": self.number, **self.results, "failure": self.failure}
        return {name: [value] for name, value in row.items()}

    @property
    def steady(self) -> bool:
        """Whether each model whose loads repeat has reached a steady state."""
        return not any(k.endswith(f".{STEADY}") and x is False for k, x in self.results.items())


def sweep(
    scenes: Iterable[Scene],
    executor: Executor | Callable[[], Executor],
    journal: Path | None = None,
) -> Generator[Row]:
    """Run scenes, each in a call of its own, and yield the row of each as it finishes.

    A scene that fails gives a row that says why. A scene whose process is killed is run again,
    alone in a new pool; if that is killed too, the scene has failed.

    Parameters
    ----------
    scenes : iterable of Scene
    executor : Executor, or callable that makes one
        Any of the kind of `concurrent.futures`: a pool of processes, ``client.get_executor()`` of
        ``dask.distributed``, ``mpi4py.futures.MPIPoolExecutor``. A pool that breaks is replaced: by
        calling the callable again, or by `processes` where an executor was given. Pools that were
        made here are shut down at the end.
    journal : Path, optional
        File that each row is appended to. Scenes that have a row there are not run again: their
        rows come first. Scenes whose process was killed, or that raised an error, have no row.
        Reduced models for ranges are kept in its folder, by which an earlier sweep made them.

    Yields
    ------
    Row

    Raises
    ------
    InputError
        If the journal is no file of rows, or another process writes to its folder.
    InputError, ConvergenceError
        If the reduced model for a range of scenes cannot be made.
    """
    lock = nullcontext() if journal is None else holding(journal.parent)
    with lock, closing(rows(list(scenes), executor, Rows(journal))) as finished:
        yield from finished


def rows(
    scenes: Sequence[Scene],
    executor: Executor | Callable[[], Executor],
    kept: Rows,
    progress: Progress = silent,
) -> Generator[Row]:
    """Rows of scenes as `sweep` yields them, by a file of rows whose folder the caller has locked.

    ``progress`` is told of the models for ranges that are made.
    """
    marks = _marks(scenes, kept)
    waiting = deque(k for k, mark in enumerate(marks) if mark not in kept)
    yield from _taken(marks, kept)
    with ExitStack() as stack:
        folder = None if kept.path is None else kept.path.parent
        if any(scenes[k].reduction.range for k in waiting):
            folder = folder or Path(stack.enter_context(TemporaryDirectory()))
            make_missing((scenes[k] for k in waiting), folder, progress)
        for row, settled in stack.enter_context(closing(_rows(scenes, waiting, executor, folder))):
            if settled:
                content = {"results": row.results, "failure": row.failure}
                content["notes"] = list(row.notes)
                kept.keep(marks[row.number], content)
            yield row


def _marks(scenes: Iterable[Scene], kept: Rows) -> list[str]:
    """Names of the rows of scenes in a file."""
    return [kept.mark(origin_of(scene)) for scene in scenes]


def kept_rows(scenes: Iterable[Scene], kept: Rows) -> Iterator[Row]:
    """Rows of scenes that a file has."""
    return _taken(_marks(scenes, kept), kept)


def _taken(marks: Sequence[str], kept: Rows) -> Iterator[Row]:
    return (Row(k, **kept.take(mark)) for k, mark in enumerate(marks) if mark in kept)


def _rows(
    scenes: Sequence[Scene],
    waiting: deque[int],
    executor: Executor | Callable[[], Executor],
    folder: Path | None,
) -> Generator[tuple[Row, bool]]:
    """Rows as they finish, and whether another run of the scene would give the same.

    ``groups`` are scenes that are run together: all of them at first, then alone each of those that
    were in a pool when it broke.
    """
    renew = processes if isinstance(executor, Executor) else executor
    pool = executor if isinstance(executor, Executor) else executor()
    breaks: Counter[int] = Counter()
    groups, ended = [waiting], False
    try:
        while groups:
            broken: list[int] = []
            for number, future in _finished(pool, scenes, groups[-1], broken, folder):
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
                if breaks[number] == 1:
                    groups.append(deque([number]))
                    continue
                killed = (
                    "The process that ran it ended twice, the second time with this scene alone in "
                    "it; it may need more memory than there is"
                )
                yield Row(number, failure=killed), False
        ended = True
    finally:
        if pool is not executor:
            pool.shutdown(wait=ended)


def _finished(
    pool: Executor,
    scenes: Sequence[Scene],
    waiting: deque[int],
    broken: list[int],
    folder: Path | None,
) -> Iterator[tuple[int, Future[Content]]]:
    """Numbers and futures of scenes as they finish, until all have or the pool breaks.

    Then ``broken`` lists the scenes that were in it.
    """
    # A pool of processes is given no more than it runs, so that few are in it when it breaks.
    most = getattr(pool, "_max_workers", len(scenes))
    running: dict[Future[Content], int] = {}
    try:
        while running or (waiting and not broken):
            while waiting and not broken and len(running) < most:
                number = waiting.popleft()
                scene = scenes[number]
                # It is sent without its matrices, and stores no fields, which nobody would see.
                light = scene.unassembled(output={"vtk": False, "plots": False})
                try:
                    running[pool.submit(_run, light, folder)] = number
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


def _run(scene: Scene, folder: Path | None = None) -> Content:
    """Run a scene in the process that it is sent to: results, failure and warnings of its row.

    A model for its range is in the folder, unless the process has no access to it.
    """
    try:
        study = run_scene(scene, folder=folder, described=False)
    except JointError as error:
        return {}, str(error), []
    failure = "" if study.failure is None else str(study.failure.error)
    if study.interrupted:
        raise KeyboardInterrupt
    whole = {name: model for name, model in study.models.items() if not model.run.interrupted}
    models = {name: model_summary(study, model) for name, model in whole.items()}
    return dict(_flat(models)), failure, study.notes


def _flat(content: Mapping[str, Any], start: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested mappings with their dotted names."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{start}{name}.")
        else:
            yield start + name, value


def processes(workers: int | None = None) -> futures.ProcessPoolExecutor:
    """Pool of processes, as many as the machine has cores if ``workers`` is not given.

    Each runs one BLAS thread unless the environment says otherwise: variables of the environment
    are set here, which this process has read before. The processes end with this one, and leave
    interrupts to it. As with all spawned processes, a script makes the pool below
    ``if __name__ == "__main__"``.
    """
    check_some(COUNT, workers=workers)
    for name in THREADS:
        os.environ.setdefault(name, "1")
    with safe_path():  # the pool starts a process that tracks what the others share
        return futures.ProcessPoolExecutor(workers, Spawn(), initializer=_begin)


def _begin() -> None:
    """Prepare a process of the pool: leave interrupts to its parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def executors(workers: int | None = None) -> Iterator[Callable[[], Executor]]:
    """Callable that makes pools of so many `processes`, which end with the block.

    InputError for a number that is none.
    """
    if workers is not None:
        check("--workers", workers, COUNT)
    try:
        yield partial(processes, workers)
    finally:  # after an interrupt scenes are not waited for: they may take hours
        for process in multiprocessing.active_children():
            process.terminate()
