"""Results of a run are documented as they are, and shown in a few lines."""

import re
from dataclasses import fields

import pytest
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.stepping.recording import Counters, Cycles, Run, Steady

ENTRY = re.compile(r"^    (\w+(?:, \w+)*) : (.*)$", re.M)
SHAPE = re.compile(r"shape \(([^)]*)\)")


def described(result: type) -> dict[str, str]:
    """Type and shape of each attribute, from the docstring of a class."""
    text = str(result.__doc__).partition("Attributes\n")[2]
    return {name: kind for names, kind in ENTRY.findall(text) for name in names.split(", ")}


@pytest.fixture(scope="module")
def run() -> Run:
    """Three cycles of a bar, with fields and slips stored."""
    system = arm(sj.Harmonic(3e4, 500.0))
    save = sj.Save(every=2, fields=True, fields_every=5, slips=True)
    return sj.integrate(system, cycles=3, steps_per_cycle=40, save=save)


@pytest.mark.parametrize("result", [Run, sj.Save, Cycles, Counters, Steady])
def test_every_attribute_is_described(result):
    assert list(described(result)) == [field.name for field in fields(result)]


def test_shapes_are_those_that_are_described(run):
    system = run.system
    sizes = {
        "rows": 61, "frames": 25, "cycles": 3, "n": system.n, "m": system.w.size,
        "points": len(system.points), "loads": len(system.loads), "joints": len(system.joints),
        "rows of B": system.B.shape[0],
    }  # fmt: skip
    checked = 0
    for result in (run, run.cycles):
        for name, kind in described(type(result)).items():
            shape = SHAPE.search(kind)
            if shape is not None:
                expected = tuple(sizes[part.strip()] for part in shape[1].split(",") if part)
                assert getattr(result, name).shape == expected, name
                checked += 1
    assert checked == 22
    assert [part.shape for part in run.final] == [(system.n,), (system.n,)]
