"""Sweeps: every scene has one row, whatever happens to processes, and none is run for nothing."""

import json
import multiprocessing
import os
import signal
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import closing
from typing import Any, ClassVar

import pytest
from joint_scenes import bar_scene, harmonic, joint

import skfem_joint as sj
from skfem_joint.ground.files import holding
from skfem_joint.study.sweep import Row, executors, processes, sweep

FRICTION = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
PEAK = "full.peak_displacement_whole_run_m.free_end"


def scene(friction: float, *run: str, **changes: Any) -> sj.Scene:
    short: dict[str, Any] = {"time": {"cycles": 2}, "accuracy": {"estimate": False}}
    values = short | {"joint": [joint(friction=friction)]} | changes
    return bar_scene(*(run or ("full",)), bar="coarse", **values)


@pytest.fixture(scope="module")
def scenes():
    return [scene(friction) for friction in FRICTION]


def assert_all_there(rows: list[Row], scenes: list[sj.Scene]) -> None:
    """One row for each scene, with the results of its own run."""
    assert sorted(row.number for row in rows) == list(range(len(scenes)))
    assert not any(row.failure for row in rows)
    for row in rows:
        run = sj.run_scene(scenes[row.number]).models["full"].run
        assert row.results[PEAK] == run.peak_of("free_end")


class Recording(ThreadPoolExecutor):
    """One thread that says what each scene gives, without a run, and notes which were run."""

    def __init__(self, gives: Callable[[float], Any], workers: int = 1) -> None:
        super().__init__(workers)
        self.gives, self.ran = gives, list[float]()

    def submit(self, _: Any, scene: sj.Scene, folder: Any) -> Future[Any]:
        return super().submit(self._give, scene.joint[0].friction)

    def _give(self, friction: float) -> Any:
        self.ran.append(friction)
        return self.gives(friction)


class Pool(Recording):
    """Two threads that break together, as processes do; 0.3 breaks them."""

    runs: ClassVar[Counter[float]] = Counter()
    broken = False

    def __init__(self) -> None:
        super().__init__(lambda _: ({"full.dofs": 1}, ""), 2)

    def submit(self, *call: Any) -> Future[Any]:
        if self.broken:
            raise BrokenExecutor
        return super().submit(*call)

    def _give(self, friction: float) -> Any:
        self.runs[friction] += 1
        self.broken |= friction == 0.3
        time.sleep(0.05)
        if self.broken:
            raise BrokenExecutor
        return super()._give(friction)


def test_only_what_was_in_a_broken_pool_is_run_again_and_only_the_culprit_fails(scenes):
    rows = list(sweep(scenes, Pool))
    assert sorted(row.number for row in rows) == list(range(6))
    assert [row.number for row in rows if row.failure] == [2]
    assert Pool.runs[0.3] == 2
    assert sum(Pool.runs.values()) in (7, 8)  # with one neighbour in the pool, or with none


def test_what_goes_wrong_is_a_row_and_what_went_well_is_kept():
    too_many = scene(0.4, "full", "reduced", reduction={"reference": "paper", "modes": 1000})
    with ThreadPoolExecutor(1) as executor:
        rows = list(sweep([scene(0.4), too_many], executor))
    assert [bool(row.failure) for row in rows] == [False, True]
    assert rows[1].failure.startswith("reduction.modes: found 1000")
    assert rows[1].results[PEAK] == rows[0].results[PEAK]


def test_rows_in_the_journal_are_not_run_again_but_those_of_changed_scenes(scenes, tmp_path):
    def gives(friction):
        if friction == 0.2:
            raise MemoryError("for want of memory")
        return {"full.dofs": 1}, "step 3" * (friction == 0.3)

    journal = tmp_path / "deep" / "rows.jsonl"
    with Recording(gives) as executor:
        ran = executor.ran
        with closing(sweep(scenes, executor, journal)) as rows:
            stopped = [next(rows) for _ in range(4)]
            with pytest.raises(sj.InputError, match="another run"), holding(journal.parent):
                pass
        with journal.open("ab") as file:
            file.write(b'{"scene": "torn')
        before = set(ran)
        ran.clear()
        changed = [*scenes[1:], scene(0.7)]
        found = list(sweep(changed, executor, journal))
    assert [row.failure for row in stopped] == ["", "MemoryError: for want of memory", "step 3", ""]
    assert before >= {0.1, 0.2, 0.3, 0.4}
    assert set(ran) == {0.2, 0.5, 0.6, 0.7}  # what gives the same again is not run again
    assert sorted(row.number for row in found) == list(range(6))
    assert {row.number: row.failure for row in found}[1] == "step 3"
    marks = [json.loads(line)["row"] for line in journal.read_text().splitlines()[1:]]
    assert len(marks) == len(set(marks)) == 6
    for others in ("{}\n", "notes of the user", "{}\n{"):
        journal.write_text(others)
        with pytest.raises(sj.InputError, match="line 1: is not that"):
            next(sweep(scenes, executor, journal))
        assert journal.read_text() == others


@pytest.mark.slow
@pytest.mark.parametrize("given", [True, False])
def test_a_killed_process_costs_no_row(scenes, given):
    def killing(rows):
        for k, row in enumerate(rows):
            if k == 1:
                multiprocessing.active_children()[0].kill()
            yield row

    if given:
        with processes(2) as executor:
            rows = list(killing(sweep(scenes, executor)))
    else:
        with executors(2) as make:
            rows = list(killing(sweep(scenes, make)))
    assert_all_there(rows, scenes)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_killed_worker_of_dask_costs_no_row():
    distributed = pytest.importorskip("distributed")
    scenes = [scene(friction, time={"cycles": 200}) for friction in FRICTION]
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    )
    with cluster, distributed.Client(cluster) as client:
        killed, _ = client.run(os.getpid).values()
        executor: Executor = client.get_executor()
        rows = []
        for row in sweep(scenes, executor):
            if not rows:  # the other five take longer than this
                os.kill(killed, signal.SIGKILL)
            rows.append(row)
        client.wait_for_workers(2)
        assert killed not in client.run(os.getpid).values()
    assert_all_there(rows, scenes)


def test_a_number_of_processes_that_there_cannot_be():
    with pytest.raises(sj.InputError, match="--workers: found 0"), executors(0):
        pass


def test_a_joint_that_slides_away_is_a_row_with_the_warnings_of_its_run(tmp_path):
    slides = scene(0.001, time={"cycles": 2}, load=[harmonic(amplitude=400e3)])
    journal = tmp_path / "rows.jsonl"
    with ThreadPoolExecutor(1) as executor:
        (row,) = sweep([slides], executor, journal)
        (again,) = sweep([slides], executor, journal)
    assert any("not reached a steady state" in text for text in row.notes)
    assert any(text.startswith("Nearly every point of joint") for text in row.notes)
    assert tuple(row.notes) == sj.run_scene(slides).notes
    assert not row.steady
    assert row.results["full.steady_state_reached"] is False
    assert (again.results, list(again.notes)) == (row.results, list(row.notes))
