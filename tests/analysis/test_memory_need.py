"""Memory stays within what is estimated, and a run that needs too much is refused beforehand."""

import re
import tracemalloc
from collections.abc import Callable
from typing import Any

import pytest
from joint_scenes import BARS, LENGTH, WIDTH, bar_scene, plate, plate_scene

import skfem_joint as sj
from skfem_joint.analysis import memory
from skfem_joint.output import write
from skfem_joint.scene import Scene

Make = Callable[[], Scene]
MIB = 2**20
BOTH = ("full", "reduced")


def bar(
    *run: str, elements: int = 20, cycles: int = 20, steps: int = 200, reference: str = "paper",
    **output: Any,
) -> Scene:  # fmt: skip
    strips = [("joint", 0.1, elements), ("linear", 0.5, elements)]
    return bar_scene(
        *(run or ("full",)),
        bar=sj.build_bar(strips, BARS["structure"][1]),
        time={"cycles": cycles, "steps_per_cycle": steps},
        reduction={"reference": reference},
        output=output,
    )


def in_plan(
    *run: str, elements: int = 20, cycles: int = 1, steps: int = 150, **output: Any
) -> Scene:
    corners = {f"at {k}": (LENGTH, WIDTH * (k % 3) / 2) for k in range(9)}
    return plate_scene(
        *(run or ("full",)),
        mesh=plate(elements, points=corners),
        time={"cycles": cycles, "steps_per_cycle": steps},
        reduction={"modes": 8},
        output=output,
    )


def need(scene: Scene) -> int:
    """Bytes that a scene is said to need."""
    return sum(memory.needed(scene).values())


CASES: dict[str, Make] = {
    "points": lambda: bar(cycles=600),
    "two models": lambda: bar(*BOTH, cycles=300),
    # No two cycles from which looks could tell that the run has settled.
    "two models, one cycle": lambda: bar(*BOTH, cycles=1, steps=30_000),
    "fields": lambda: bar(elements=500, cycles=3, steps=80, vtk=True, frames=240),
    "training": lambda: bar(
        *BOTH, elements=200, cycles=3, steps=600, reference="self", history=False
    ),
    "nodes": lambda: bar(elements=6000, cycles=1, steps=10, history=False),
    "cycles": lambda: bar(cycles=1500, steps=10, history=False),
    "plate, points": lambda: in_plan(
        elements=2, cycles=8, steps=100, points=["right", "top", *(f"at {k}" for k in range(9))]
    ),
    "plate, fields": lambda: in_plan(vtk=True, frames=150, history=False),
    "plate, training": lambda: in_plan(*BOTH, history=False),
    "plate, nodes": lambda: in_plan(elements=200, steps=10, history=False),
}


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """Compile, and load what solves and writes, which takes memory of its own."""
    folder = tmp_path_factory.mktemp("out")
    for make in (bar, in_plan):
        small: Any = {"elements": 4, "cycles": 1, "steps": 50, "vtk": True, "frames": 2}
        write(sj.run_scene(make(*BOTH, **small)), folder)


@pytest.mark.usefixtures("loaded")
@pytest.mark.parametrize("case", CASES)
def test_the_estimate_bounds_what_a_run_takes_and_is_not_far_above(case, tmp_path):
    tracemalloc.start()
    try:
        scene = CASES[case]()
        write(sj.run_scene(scene), tmp_path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak <= need(scene) <= (4 if "plate" in case else 3) * peak


#: What is dear, and options that the refusal must and must not name.
DEAR: list[tuple[Make, list[str], list[str]]] = [
    (lambda: bar(cycles=10_000), ["output.every", "output.history"], ["frames", "reference"]),
    (lambda: bar(*BOTH, cycles=10_000), ["output.every", "output.history"], ["reference"]),
    (
        lambda: bar(elements=2000, cycles=10, vtk=True, frames=2000),
        ["output.frames", "output.vtk = false"],
        ["output.every", "output.history"],
    ),
    (
        lambda: bar(*BOTH, elements=500, cycles=3, steps=4000, reference="self"),
        ['reduction.reference = "static"'],
        ["output.frames"],
    ),
    (lambda: bar(elements=100_000, cycles=1, steps=10), ["coarser mesh"], ["output."]),
]


@pytest.mark.parametrize(("scene", "named", "not_named"), DEAR)
def test_the_options_named_are_those_that_store_less(scene, named, not_named):
    dear = scene()
    with pytest.raises(sj.InputError) as caught:
        memory.check(dear, 0.5 * need(dear))
    text = str(caught.value)
    assert all(word in text for word in named)
    assert not any(word in text for word in not_named)


def test_a_long_run_is_refused_with_a_stride_that_fits():
    limit = 20 * MIB
    dear = bar(cycles=5_000_000)
    with pytest.raises(sj.InputError) as caught:
        memory.check(dear, limit)
    (text,) = caught.value.problems
    assert f"would need {memory.size(need(dear))}" in text
    assert "more than the 20 MiB" in text
    assert "histories of points" in text
    dear = bar(cycles=10_000)
    with pytest.raises(sj.InputError) as caught:
        memory.check(dear, limit)
    every = re.search(r"output\.every = (\d+)", str(caught.value))
    fitting = dear.changed(output={"every": int(every[1])})
    memory.check(fitting, limit)
    assert need(fitting) <= limit
    for wrong in (0.0, -1.0, float("nan")):
        with pytest.raises(sj.InputError, match=r"--memory-limit: found .* must be > 0"):
            memory.check(fitting, wrong)


def test_the_bound_is_a_share_of_what_is_available(monkeypatch):
    assert 16 * MIB < memory.available() < 2**50
    monkeypatch.setattr(memory, "available", lambda: 10 * memory.GIB)
    assert memory.default_limit() == 8 * memory.GIB
    monkeypatch.setattr(memory, "available", lambda: None)
    assert memory.default_limit() == 4 * memory.GIB
