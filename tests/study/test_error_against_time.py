"""Error against run time: a reference that is one, a front that is one, advice that follows."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from joint_scenes import BARS, LENGTH, harmonic, joint, lap_joint, plate, plate_scene

import skfem_joint as sj
from skfem_joint.output.folder import write_error_time
from skfem_joint.results.history import difference, results
from skfem_joint.study import error_time as et
from skfem_joint.study.certificate import Reference, make_reference

TINY: dict[str, Any] = {"parts": (1, 4), "factors": (10.0,), "modes": (2, 1000)}
TINY["reduced_parts"] = (2,)
MESH = "full, coarser mesh"


def small(elements: int = 10, **changes: Any) -> sj.Scene:
    bar = sj.build_bar([("joint", LENGTH, elements)], BARS["lap_joint"][1])
    time, reduction = {"cycles": 2, "steps_per_cycle": 50}, {"reference": "paper"}
    options: dict[str, Any] = {"beta": 200.0, "time": time, "reduction": reduction}
    return lap_joint(bar=bar, **(options | changes))


@pytest.fixture(scope="module")
def truth():
    return make_reference(small(beta=1e3), quick=True)


def others(reference: Reference) -> Iterator[et.Job]:
    yield from et.other_jobs(reference, (1, 4), MESH, small(5).system(), {"mesh": "5"})
    wrong = results(reference.grid.integrate(reference.system, 1))
    yield et.Job("someone else's", {"tolerance": 1e-3}, lambda: et.Outcome(wrong, 1e-6))
    yield et.Job("someone else's", {}, lambda: et.Outcome(None, status="did not finish in 1 s"))


@pytest.fixture(scope="module")
def report():
    return et.error_time(small(), repeats=1, quick=True, wanted=TINY, more=others)


def point(wall: float, error: float, status: str = et.FINISHED, **what: Any) -> et.Measured:
    job = et.Job(
        what.pop("family", et.FULL), what, lambda: et.Outcome(None), what.pop("offline", 0.0)
    )
    return et.Measured(job, et.Outcome(None, wall, status=status), {et.RMS: error}, wall)


def test_error_of_the_full_model_falls_with_the_step(truth):
    errors = [
        difference(truth.results, results(truth.grid.integrate(truth.system, parts)))[et.RMS] or 0.0
        for parts in (2, 4, 8, 16)
    ]
    for coarse, fine in pairwise(errors):
        assert 1.7 < coarse / fine < 4.6  # orders 0.8 to 2.2


def test_report_has_all_models_and_what_they_cost(report):
    header, cells = report.table()
    rows = [dict(zip(header, row, strict=True)) for row in cells]
    assert len(rows) == len(report.points)
    families = {et.FULL, et.STEEPNESS, et.COULOMB, MESH, et.REDUCED, et.FEW_POINTS}
    assert {row["family"] for row in rows} == families | {"someone else's"}
    finished = [row for row in rows if row["status"] == et.FINISHED]
    needed = ("displacement_rms", "friction_energy", "loop_energy", "to fine mesh", "run time (s)")
    assert all(row[name] is not None for row in finished for name in needed)
    others = {row["status"] for row in rows} - {et.FINISHED}
    assert "did not finish in 1 s" in others
    assert any(one.startswith("reduction.modes: found 1000") for one in others)
    assert all(row["front"] == 0 for row in rows if row["status"] != et.FINISHED)
    for p in report.points:
        if p.job.family == et.FULL:
            assert p.error() == pytest.approx(p.error(et.TIME_ERROR))
        # Other meshes and laws err by more than their time step.
        is_other = p.job.family in (MESH, et.STEEPNESS)
        if is_other and p.outcome.work["steps"] == 4 * 50:
            assert p.error() > 2.0 * p.error(et.TIME_ERROR)
    text = report.markdown()
    assert text.index("How well") < text.index("Which model") < text.index("All points")


@pytest.mark.parametrize("count", range(31))
def test_front_is_the_lower_left_of_the_finished_points(count):
    """Also where points have a time or an error in common."""
    rng = np.random.default_rng(count)
    data = np.exp(rng.integers(-9, 1, (count, 2)) + rng.choice([0.0, 0.3], (count, 1))).tolist()
    done = rng.random(count) < 0.7
    measured = [point(w, e, et.FINISHED if ends else "extrapolated")
                for (w, e), ends in zip(data, done, strict=True)]  # fmt: skip
    finished = [(p.wall_s, p.error()) for p in measured if p.counts]
    ahead = [(p.wall_s, p.error()) for p in et.front(measured)]
    assert set(ahead) <= set(finished)
    assert ahead == sorted(ahead)
    assert [e for _, e in ahead] == sorted((e for _, e in ahead), reverse=True)
    for w, e in finished:
        assert any(a <= w and b <= e for a, b in ahead)
    for w, e in ahead:
        assert not any((a < w and b <= e) or (a <= w and b < e) for a, b in finished)


@pytest.mark.parametrize(
    ("wall", "error", "words"),
    [
        (1e-3, 5e-3, "A reduction pays 10 times"),
        (1e-1, 5e-3, "does not pay: the fastest that reaches it"),
        (9e-3, 5e-3, "use full (step (s) 1e-05; 10 ms). A reduction does not pay"),
        (1e-3, 5e-2, "does not pay: none reaches it, the best has 5.0e-02"),
    ],
)
def test_advice_says_whether_a_reduction_pays(wall, error, words):
    full = point(1e-2, 1e-3, **{"step (s)": 1e-5})
    reduced = point(wall, error, family=et.REDUCED, modes=5, offline=0.09)
    assert words in et.advice([full, reduced], 1e-2)
    if "pays" in words:
        assert "after 10 runs" in et.advice([full, reduced], 1e-2)
    assert "No reduced model was run" in et.advice([full], 1e-2)
    assert "no model of this report" in et.advice([full], 1e-9)


@pytest.mark.parametrize("kind", ["impulse", "plate"])
def test_scenes_without_cycles_and_of_plates_are_compared_too(kind):
    scene = plate_scene("full", mesh=plate(3), time={"cycles": 1, "steps_per_cycle": 50})
    if kind == "impulse":
        load = {"on": "free_end", "kind": "half_sine", "peak": 63e3, "rise_time": 2.5e-4}
        scene = small(beta=1e3, load=[load], time={"duration": 1e-3, "step": 1e-5})
    wanted = TINY | {"modes": (2,)}
    found = et.error_time(scene, bound=1.0, repeats=1, quick=True, wanted=wanted)
    full = [p for p in found.points if p.job.family == et.FULL]
    steps = [100, 400] if kind == "impulse" else [25, 100]
    assert [p.outcome.work["steps"] for p in full] == steps
    assert full[1].error() < 0.4 * full[0].error()
    assert {p.job.family for p in found.points} >= {et.COULOMB, et.REDUCED, et.FEW_POINTS}
    assert "beta" in found.markdown()


def test_what_does_not_converge_is_a_point_all_the_same(truth):
    def fail():
        raise sj.ConvergenceError("step 3")

    (found,) = et.measure([et.Job(et.FULL, {}, fail)], truth, repeats=2)
    assert found.outcome.status == "step 3"
    assert not found.counts


@pytest.mark.parametrize(
    ("changes", "options", "words"),
    [
        ({}, {"bound": 0.0}, "--bound: found 0, must be"),
        ({}, {"repeats": 0}, "--repeats: found 0, must be"),
        ({"joint": [joint(friction=0.0)]}, {}, "nothing slips"),
        ({"load": [harmonic(amplitude=0.0)]}, {}, "no load acts"),
    ],
)
def test_wrong_options_and_scenes_without_friction_or_load_are_refused(changes, options, words):
    with pytest.raises(sj.InputError, match=words):
        et.error_time(small(**changes), **options)


def test_report_is_written(report, tmp_path):
    files = write_error_time(tmp_path, report)
    names = {f"error-time.{s}" for s in ("md", "csv", "png")} | {"total-time.png", "summary.json"}
    assert {f.name for f in files} == names
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files[2:4])
    assert len(files[1].read_text(encoding="utf-8").splitlines()) == 1 + len(report.points)
    for total in (False, True):
        ahead = et.front(report.points, total=total)
        assert [p.seconds(total) for p in ahead] == sorted(p.seconds(total) for p in ahead)
    assert any(p.seconds(total=True) > p.wall_s for p in report.points if p.counts)
    assert et.threads_pinned(dict.fromkeys(et.THREADS, "1"))
    assert not et.threads_pinned({"OMP_NUM_THREADS": "1"})
