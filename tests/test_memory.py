"""Memory stays within what is estimated, and a run that needs too much is refused beforehand."""

from __future__ import annotations

import re
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from skfem_joint import cli, memory, output
from skfem_joint.errors import InputError
from skfem_joint.meshing import build_bar
from skfem_joint.scene import Scene, scene_from
from skfem_joint.study import run_scene

ROOT = Path(__file__).parent.parent
MIB = 2**20


def scene(
    elements: int = 20,
    cycles: int = 20,
    steps: int = 200,
    run: tuple[str, ...] = ("full",),
    reference: str = "paper",
    **options: Any,
) -> Scene:
    bar = build_bar(
        [("joint", 0.1, elements), ("linear", 0.5, elements)],
        {"fixed": 0.0, "junction": 0.1, "free_end": 0.6},
    )
    load = {"on": "free_end", "kind": "harmonic", "amplitude": 87.5e3, "frequency": 500.0}
    tables = {
        "mesh": {"file": "bar.msh"},
        "material": {"E": 200e9, "density": 8000.0},
        "section": {"width": 0.05, "thickness": 0.01},
        "support": {"fixed": ["fixed"]},
        "joint": [{"region": "joint", "pressure": 50e6, "friction": 0.7}],
        "load": [load],
        "time": {"cycles": cycles, "steps_per_cycle": steps},
        "models": {"run": list(run)},
        "reduction": {"reference": reference},
        "output": options,
    }
    return scene_from(tables, bar)


BOTH = ("full", "reduced")


@pytest.mark.parametrize(
    "what",
    [
        scene(cycles=600),
        scene(cycles=300, run=BOTH),
        scene(elements=500, cycles=5, steps=100, vtk=True, frames=500),
        scene(elements=200, cycles=3, steps=600, run=BOTH, reference="self", history=False),
        scene(elements=6000, cycles=1, steps=10, history=False),
        scene(cycles=5000, steps=10, history=False),
    ],
    ids=["points", "two models", "fields", "training", "nodes", "cycles"],
)
def test_the_estimate_bounds_what_a_run_takes_and_is_no_more_than_thrice_that(
    what: Scene, tmp_path: Path
) -> None:
    run_scene(scene(elements=4, cycles=1, run=what.models.run))  # compiles, keeps the reference
    if what.output.vtk:
        output.write(run_scene(scene(elements=4, cycles=1, vtk=True, frames=1)), tmp_path)
    tracemalloc.start()
    try:
        output.write(run_scene(what), tmp_path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    total = memory.needed(what).total
    assert peak <= total <= 3 * peak


def test_a_billion_steps_are_refused_before_anything_is_made(tmp_path: Path) -> None:
    long = scene(cycles=5_000_000)
    with pytest.raises(InputError) as caught:
        memory.check(long, 4 * memory.GIB)
    (text,) = caught.value.problems
    needed = memory.needed(long).total
    assert f"would need {memory.size(needed)}" in text
    assert "more than the 4 GiB" in text
    assert "output.every = " in text
    assert "histories of points" in text


@pytest.mark.parametrize(
    ("what", "named", "not_named"),
    [
        ({}, ["output.every", "output.history = false"], ["vtk", "frames", "reference"]),
        ({"run": BOTH}, ["output.every"], ["output.history", "reference"]),
        ({"plots": True}, ["output.every", "output.plots = false"], ["output.history"]),
        (
            {"elements": 2000, "cycles": 10, "vtk": True, "frames": 2000},
            ["output.frames", "output.vtk = false"],
            ["output.every", "output.history"],
        ),
        (
            {"elements": 500, "cycles": 3, "steps": 4000, "run": BOTH, "reference": "self"},
            ['reduction.reference = "paper"'],
            ["output.frames"],
        ),
        ({"elements": 100_000, "cycles": 1, "steps": 10}, ["coarser mesh"], ["output."]),
    ],
)
def test_the_options_named_are_those_that_store_less(
    what: dict[str, Any], named: list[str], not_named: list[str]
) -> None:
    dear = scene(**({"cycles": 10_000} | what))
    with pytest.raises(InputError) as caught:
        memory.check(dear, 0.5 * memory.needed(dear).total)
    text = str(caught.value)
    assert all(word in text for word in named)
    assert not any(word in text for word in not_named)


def test_the_stride_proposed_makes_the_run_fit() -> None:
    limit = 20 * MIB
    with pytest.raises(InputError) as caught:
        memory.check(scene(cycles=10_000, steps=200), limit)
    every = re.search(r"output\.every = (\d+)", str(caught.value))
    assert every is not None
    assert memory.check(scene(cycles=10_000, every=int(every[1])), limit).total <= limit


def test_the_bound_is_a_share_of_what_is_available(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: 10 * memory.GIB)
    assert memory.default_limit() == 8 * memory.GIB
    monkeypatch.setattr(memory, "available", lambda: None)
    assert memory.default_limit() == 4 * memory.GIB


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("MemTotal: 9 kB\nMemAvailable:   2048 kB\nSwapFree: 0 kB\n", 2 * MIB),
        ("MemTotal: 9 kB\n", None),
        ("MemAvailable: much kB\n", None),
        ("nothing of the kind", None),
    ],
)
def test_available_memory_as_the_system_says(
    text: str, expected: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "read_text", lambda *_, **__: text)
    assert memory.available() == expected


def test_a_system_that_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object, **__: object) -> str:
        raise FileNotFoundError

    monkeypatch.setattr(Path, "read_text", missing)
    assert memory.available() is None


@pytest.mark.parametrize("limit", ["1e-6", "0", "-1", "nan"])
def test_the_command_refuses_and_makes_no_folder(
    limit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = ROOT / "examples" / "structure_harmonic.toml"
    out = tmp_path / "out"
    assert cli.main(["run", str(path), "--out", str(out), f"--memory-limit={limit}"]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "memory" in shown.err
    assert "Traceback" not in shown.err
    assert not out.exists()


def test_check_says_what_a_run_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", str(ROOT / "examples" / "structure_harmonic.toml")]) == 0
    assert re.search(r"needs about [\d.]+ MiB", capsys.readouterr().out)
