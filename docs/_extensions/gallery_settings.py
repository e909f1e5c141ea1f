"""Order of the gallery, and how its scripts are run."""

from pathlib import Path
from typing import Any

#: Scripts in the order of their pages: what each is about, the simplest first. Others follow.
ORDER = (
    # What a joint does
    "lap_joint_reference",
    "plate_reference",
    "two_plates_held",
    "plate_bolts",
    "solid_lap_joint",
    # From a mesh or matrices to a run in Python
    "lap_joint",
    "two_plates",
    "bolted_plates",
    "own_basis",
    # Reduced models
    "structure_harmonic",
    "structure_impulse",
    "reduced_structure",
    "lap_joint_case_I",
    "paper_by_hand",
    # Damping, and many scenes
    "damping",
    "brake_reuss",
    "sweep",
)


def order(script: str) -> tuple[int, str]:
    """Key by which the pages of scripts are sorted."""
    name = Path(script).stem
    return (ORDER.index(name) if name in ORDER else len(ORDER)), name


def short_form(configuration: dict[str, Any], script: dict[str, Any]) -> list[str]:
    """Arguments of a script, whose folder is known to it as when Python runs it."""
    script["example_globals"]["__file__"] = script["src_file"]
    return ["--short"]
