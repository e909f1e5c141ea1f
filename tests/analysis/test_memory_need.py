"""A run that needs too much memory is refused beforehand, with a cure that helps."""

from collections.abc import Callable
from typing import Any

import pytest
from joint_scenes import BARS, bar_scene

import skfem_joint as sj
from skfem_joint.analysis import memory
from skfem_joint.scene import Scene

BOTH = ("full", "reduced")
SELF = {"reference": "self"}


def bar(
    *run: str, elements: int = 20, cycles: int = 20, steps: int = 200, **changes: Any
) -> Scene:  # fmt: skip
    strips = [("joint", 0.1, elements), ("linear", 0.5, elements)]
    time = {"cycles": cycles, "steps_per_cycle": steps}
    mesh = sj.build_bar(strips, BARS["structure"][1])
    return bar_scene(*(run or ("full",)), bar=mesh, time=time, **changes)


def need(scene: Scene) -> int:
    """Bytes that a scene is said to need."""
    return sum(memory.needed(scene).values())


def test_stored_arrays_are_counted():
    scene = bar(cycles=3, output={"vtk": True, "frames": 60})
    parts, run = memory.needed(scene), sj.run_scene(scene).models["full"].run
    rows = (run.times, run.point_u, run.point_v, run.joint_work, run.joint_slip, run.joint_slipping)
    fields = (run.u, run.v, run.sigma, run.friction_work_rows)
    for name, arrays in (("histories of points", rows), ("fields", fields)):
        stored = sum(array.nbytes for array in arrays)
        assert stored <= parts[name] <= 8 * stored


#: What needs much, what the refusal says, and what it asks for.
LARGE: list[tuple[Callable[[], Scene], str, dict[str, dict[str, Any]]]] = [
    (lambda: bar(cycles=10_000), "output.every", {"output": {"every": 100}}),
    (
        lambda: bar(elements=2000, cycles=10, output={"vtk": True, "frames": 2000}),
        "output.frames",
        {"output": {"frames": 20}},
    ),
    (
        lambda: bar(*BOTH, elements=500, cycles=3, steps=4000, reduction=SELF),
        'reduction.reference = "static"',
        {"reduction": {"reference": "static"}},
    ),
]


@pytest.mark.parametrize(("make", "cure", "changes"), LARGE)
def test_the_cure_of_a_refusal_helps(make, cure, changes):
    scene = make()
    limit = 0.5 * need(scene)
    with pytest.raises(sj.InputError) as caught:
        memory.check(scene, limit)
    assert cure in str(caught.value)
    memory.check(scene.changed(**changes), limit)


def test_a_mesh_that_is_too_fine_is_refused():
    fine = bar(elements=100_000, cycles=1, steps=10)
    with pytest.raises(sj.InputError, match=r"a coarser mesh. Or raise --memory-limit"):
        memory.check(fine, 0.5 * need(fine))


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_limit_is_positive(limit):
    with pytest.raises(sj.InputError, match=r"--memory-limit: found .* must be > 0"):
        memory.check(bar(cycles=1), limit)


def test_the_default_bound_is_a_share_of_what_is_there():
    assert 2**20 < memory.default_limit() < 2**50
