"""The page on results names every key of a summary and every array that a run writes."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from skfem_joint.cli import main

ROOT = Path(__file__).resolve().parents[2]
#: Tables whose keys are names of points, joints or models.
NAMED = {
    *[
        "models",
        "joints",
        "bolts",
        "static_displacement_m",
        "peak_displacement_m",
        "offset_m",
        "files",
    ],
    *["ring_down_friction_energy_J", "failures", "warnings"],
    *["peak_displacement_whole_run_m", "amplitude_m", "drift_per_period_m", "friction_energy_J"],
    *["active_length_m", "active_area_fraction"],
    *["displacement_rms_by_point", "displacement_max_by_point"],
}


def keys(content, parent=""):
    """Keys of a summary at any depth that are not names of the scene."""
    if isinstance(content, dict):
        for key, value in content.items():
            if parent not in NAMED:
                yield key
            yield from keys(value, key)
    elif isinstance(content, list):
        for row in content:
            yield from keys(row, parent)


@pytest.fixture(scope="module")
def page():
    text = (ROOT / "docs" / "start" / "results.md").read_text(encoding="utf-8")
    return set(re.findall(r"`([\w.-]+)`", text))


#: What makes the shipped scene short, and what its other commands need.
SHORT = (
    ("cycles = 12", "cycles = 2"),
    ("steps_per_cycle = 200", "steps_per_cycle = 100"),
    ("plots = true", "plots = false"),
    ("vtk = true", "vtk = false"),
)
MORE = """
[backbone]
modes = [1]
levels = 3
up_to = 0.5
ring_down = 12

[response]
frequencies = { from = 2380.0, to = 2420.0, points = 2 }
levels = [0.003]

[sweep]
"joint[0].friction" = [0.6, 0.7]
results = ["peak_displacement_m"]
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Folder of what each command writes of a shipped scene, short and without pictures."""
    folder = tmp_path_factory.mktemp("results")
    assert main(["-q", "example", "structure_harmonic", "--out", str(folder)]) == 0
    scene = folder / "structure_harmonic.toml"
    text = scene.read_text(encoding="utf-8")
    for old, new in SHORT:
        assert old in text
        text = text.replace(old, new)
    scene.write_text(text, encoding="utf-8")
    assert main(["-q", "run", str(scene), "--out", str(folder / "run")]) == 0
    reduced = text.replace('["full", "reduced"]', '["reduced"]')
    scene.write_text(reduced + MORE, encoding="utf-8")
    for command in ("backbone", "response", "sweep"):
        workers = ["--workers", "1"] if command == "sweep" else []
        assert main(["-q", command, str(scene), "--out", str(folder / command), *workers]) == 0
    return folder


@pytest.mark.parametrize(
    ("command", "least"), [("run", 60), ("backbone", 12), ("response", 14), ("sweep", 7)]
)
def test_every_key_of_a_summary_is_named(results, page, command, least):
    content = json.loads((results / command / "summary.json").read_text(encoding="utf-8"))
    there = set(keys(content))
    assert len(there) > least
    assert there <= page, sorted(there - page)


def test_every_array_of_the_history_is_named(results, page):
    for array in np.load(results / "run" / "history.npz").files:
        if array.startswith("load_"):
            generic = re.sub(r"(load_\d+)_\w+", r"\1_LOAD", array)
        else:
            generic = re.sub(r"^(full|reduced)_", "MODEL_", array)
            generic = re.sub(r"_(free_end|junction)_", "_POINT_", generic)
            generic = re.sub(r"_joint_", "_JOINT_", generic)
        assert generic in page, array
