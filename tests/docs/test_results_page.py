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
    *["models", "joints", "static_displacement_m", "peak_displacement_m", "offset_m", "files"],
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


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What a run of a shipped scene writes, short and without pictures."""
    folder = tmp_path_factory.mktemp("results")
    assert main(["-q", "example", "structure_harmonic", "--out", str(folder)]) == 0
    scene = folder / "structure_harmonic.toml"
    text = scene.read_text(encoding="utf-8")
    for old, new in (
        ("cycles = 12", "cycles = 2"),
        ("plots = true", "plots = false"),
        ("vtk = true", "vtk = false"),
    ):
        assert old in text
        text = text.replace(old, new)
    scene.write_text(text, encoding="utf-8")
    assert main(["-q", "run", str(scene), "--out", str(folder / "out")]) == 0
    return folder / "out"


@pytest.fixture(scope="module")
def others(results):
    """What the other commands write of the same scene, short."""
    folder = results.parent
    scene = folder / "structure_harmonic.toml"
    text = scene.read_text(encoding="utf-8").replace('["full", "reduced"]', '["reduced"]')
    text += """
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
    scene.write_text(text, encoding="utf-8")
    commands = "backbone", "response", "sweep"
    for command in commands:
        workers = ["--workers", "1"] if command == "sweep" else []
        assert main(["-q", command, str(scene), "--out", str(folder / command), *workers]) == 0
    return {command: folder / command / "summary.json" for command in commands}


def test_every_key_of_the_summary_is_named(results, page):
    content = json.loads((results / "summary.json").read_text(encoding="utf-8"))
    there = set(keys(content))
    assert len(there) > 60
    assert there <= page, sorted(there - page)


def test_every_key_of_the_other_summaries_is_named(others, page):
    for command, least in (("backbone", 12), ("response", 14), ("sweep", 7)):
        content = json.loads(others[command].read_text(encoding="utf-8"))
        there = set(keys(content))
        assert len(there) > least, command
        assert there <= page, (command, sorted(there - page))


def test_every_array_of_the_history_is_named(results, page):
    for array in np.load(results / "history.npz").files:
        if array.startswith("load_"):
            generic = re.sub(r"(load_\d+)_\w+", r"\1_LOAD", array)
        else:
            generic = re.sub(r"^(full|reduced)_", "MODEL_", array)
            generic = re.sub(r"_(free_end|junction)_", "_POINT_", generic)
            generic = re.sub(r"_joint_", "_JOINT_", generic)
        assert generic in page, array
