"""Results of a run are documented as they are, and shown in a few lines."""

import re
from dataclasses import fields

import numpy as np
import pytest
from stepping_systems import arm

import skfem_joint as sj

ENTRY = re.compile(r"^    (\w+(?:, \w+)*) : (.*)$", re.M)
SHAPE = re.compile(r"shape \(([^)]*)\)")


def described(result: type) -> dict[str, str]:
    """Type and shape of each attribute, from the docstring of a class."""
    text = str(result.__doc__).partition("Attributes\n")[2]
    return {name: kind for names, kind in ENTRY.findall(text) for name in names.split(", ")}


@pytest.fixture(scope="module")
def run() -> sj.Run:
    """Three cycles of a bar, with fields and slips stored."""
    system = arm(sj.Harmonic(3e4, 500.0))
    save = sj.Save(every=2, fields=True, fields_every=5, slips=True)
    return sj.integrate(system, cycles=3, steps_per_cycle=40, save=save)


@pytest.mark.parametrize("result", [sj.Run, sj.Save, sj.Cycles, sj.Counters, sj.Steady])
def test_every_attribute_is_described(result):
    assert list(described(result)) == [field.name for field in fields(result)]


def test_shapes_are_those_that_are_described(run):
    system = run.system
    sizes = {
        "rows": 61, "frames": 25, "cycles": 3, "n": system.n, "m": system.contact.w.size,
        "points": len(system.points), "loads": len(system.loads),
        "joints": len(system.contact.joints),
        "rows of B": system.contact.B.shape[0], "q": 0,
    }  # fmt: skip
    checked = 0
    for result in (run, run.cycles):
        for name, kind in described(type(result)).items():
            shape = SHAPE.search(kind)
            if shape is not None:
                expected = tuple(sizes[part.strip()] for part in shape[1].split(",") if part)
                assert getattr(result, name).shape == expected, name
                checked += 1
    assert checked == 32
    assert [part.shape for part in run.final] == [(system.n,), (system.n,)]


def test_a_system_is_shown_in_a_few_lines(run):
    system = run.system
    limit = f"{system.contact.w.sum():.6g} N"
    lines = repr(system).splitlines()
    assert lines[0].startswith(f"Full model: {system.n} unknowns for {system.n + 1} degrees of")
    assert lines[1] == f"  joints: joint ({system.contact.w.size} contact points, limit {limit})"
    assert lines[2:] == ["  loads: end", f"  points: {', '.join(system.points)}"]
    assert str(sj.condense(system)).startswith("Condensed or projected model: ")
    reduced = repr(sj.reduce(system, modes=3)).splitlines()
    assert reduced[0].startswith("Reduced model: ")
    assert f"limit {limit})" in reduced[1]
    assert reduced[-1] == "  made for: its loads as they are (500 Hz)"
    own = sj.System(np.eye(2), None, np.eye(2), sj.Contact(np.zeros((0, 2)), [], 1e5))
    assert repr(own) == "System: 2 unknowns\n  joints: none\n  loads: none\n  points: none"
    named = [f"p{k}" for k in range(6)]
    many = sj.System(
        np.eye(6), None, np.eye(6), sj.Contact(np.zeros((0, 6)), [], 1.0), P=np.eye(6), points=named
    )
    assert repr(many).endswith("  points: p0, p1, p2, p3, 2 more")
