"""What is allowed but looks like a slip is said, and nothing else is."""

from __future__ import annotations

import re
from typing import Any

import pytest
from plates import plate_structure, pressed

from skfem_joint.bolts import Bolt, Bolts
from skfem_joint.loads import Harmonic
from skfem_joint.plate import PlateJoint, assemble_plate
from skfem_joint.plate_doubts import doubts
from skfem_joint.plate_mesh import build_plate


def said(joint: PlateJoint, force: float = 1e3, elements: int = 40, **changes: Any) -> list[str]:
    plate = build_plate([("joint", 0.1, elements), ("rest", 0.1, 10)], 0.05, elements // 2)
    structure = plate_structure(plate, [joint], [("right", "xy")], **changes)
    return doubts(
        structure, assemble_plate(structure, [("left", (1.0, 0.0), Harmonic(force, 1.0))], [])
    )


def bolted(at: tuple[float, float], force: float = 20e3) -> PlateJoint:
    return pressed(pressure=Bolts((Bolt(at, force, 0.009, 0.005),), 0.01))


def test_a_sound_structure_raises_no_doubt() -> None:
    assert said(pressed()) == []
    assert said(bolted((0.05, 0.025))) == []


@pytest.mark.parametrize(
    ("joint", "changes", "sentence"),
    [
        (pressed(), {"thickness": 1e-5}, "is the mesh in metres"),
        (pressed(), {"thickness": 10.0}, "is the mesh in metres"),
        (pressed(), {"force": 30e3}, "more than all joints can hold by friction, 2.8e\\+04 N"),
        (pressed(friction=0.0), {}, "Joint 'joint' carries no friction"),
        (bolted((0.003, 0.025)), {}, "of its ring on the joint"),
        (bolted((0.05, 0.025)), {"elements": 8}, "refine the mesh"),
    ],
)
def test_what_looks_wrong_is_said(
    joint: PlateJoint, changes: dict[str, Any], sentence: str
) -> None:
    (found,) = said(joint, **changes)
    assert re.search(sentence, found)
