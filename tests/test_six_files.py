"""A public call reaches the compiled loops in which it takes its time through at most six files."""

import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import WIDTH, pressed, structure
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.ground.compiling import compiled
from skfem_joint.stepping.time_loop import time_loop

MOST = 6
PAGE = Path(__file__).parents[1] / "docs" / "contributing" / "architecture.md"
LOAD = sj.Harmonic(20e3, 900.0)
CALLS: dict[str, Callable[[sj.System], Any]] = {
    "integrate": lambda system: sj.integrate(system, cycles=1, steps_per_cycle=20),
    "backbone": lambda system: sj.backbone(system, levels=2),
    "response": lambda system: sj.response(
        system, np.array([900.0]), steps_per_cycle=20, refined=False, estimated=False
    ),
    "reduce": lambda system: sj.reduce(system),
}


def plate() -> sj.System:
    mesh = sj.build_plate([("joint", 0.25, 6), ("free", 0.25, 6)], WIDTH, 2)
    made = structure(mesh, [pressed(beta=np.inf)], stiffness_damping=1e-5)
    return made.system([sj.Load("right", LOAD, (1.0, 0.2))])


SYSTEMS = {"a chain": lambda: arm(LOAD, elements=(10, 10)), "slips are unknowns": plate}


def ways(call: Callable[[], Any]) -> Counter[frozenset[str]]:
    """Modules on the ways from a call to a compiled loop, both ends included, and how often."""
    call()  # compiles
    found: Counter[frozenset[str]] = Counter()

    def look(frame: Any, event: str, _: Any) -> None:
        if event != "call" or frame.f_code is not compiled.__call__.__code__:
            return
        loop, arguments = frame.f_locals["self"], frame.f_locals["arguments"]
        names = {loop.__module__}
        if loop is time_loop:  # it calls the method of the step problem, in compiled code
            names.add(type(arguments[5]).__module__)
        while (frame := frame.f_back) is not None:
            names.add(frame.f_globals.get("__name__", ""))
        found[frozenset(name for name in names if name.startswith("skfem_joint."))] += 1

    sys.setprofile(look)
    try:
        call()
    finally:
        sys.setprofile(None)
    return found


@pytest.mark.parametrize("kind", SYSTEMS)
@pytest.mark.parametrize("call", CALLS)
def test_a_call_reaches_its_loops_through_six_files_which_the_page_names(call, kind):
    system = SYSTEMS[kind]()
    found = ways(lambda: CALLS[call](system))
    assert max(map(len, found)) <= MOST, max(found, key=len)
    (commonest, _), *_ = found.most_common(1)
    assert len(commonest) >= 4
    page = PAGE.read_text(encoding="utf-8")
    for name in commonest:
        assert f"`{name.removeprefix('skfem_joint.').replace('.', '/')}.py`" in page
