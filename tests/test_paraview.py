"""A series of plates opens in ParaView itself, and the script for it shows the joint.

Skipped only where ParaView's Python, ``pvpython``, is not installed; drawing needs a display or
``xvfb-run`` besides (Debian: ``apt-get install paraview xvfb``).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest

from skfem_joint.plate import PlateJoint, build_plate_structure
from skfem_joint.plate_mesh import build_plate, merged
from skfem_joint.plate_plot import STATES
from skfem_joint.plate_vtk import LoadHistory, PlateField, write_load, write_series

SCRIPT = Path(__file__).parent.parent / "examples" / "paraview_joint.py"
TIMES = np.linspace(0.0, 2e-3, 9)
LARGEST = 6e-5

paraview = pytest.mark.skipif(shutil.which("pvpython") is None, reason="pvpython not installed")
drawing = pytest.mark.skipif(
    shutil.which("pvpython") is None or not (os.environ.get("DISPLAY") or shutil.which("xvfb-run")),
    reason="pvpython, or a display or xvfb-run for it, not there",
)

LOOK = """
import json, sys
from paraview import simple
reader = simple.OpenDataFile(sys.argv[1])
reader.UpdatePipeline()
tree = reader.GetDataInformation().GetHierarchy()
found = {
    "reader": type(reader).__name__,
    "times": list(reader.TimestepValues),
    "blocks": [
        tree.GetAttributeOrDefault(node, "label", "")
        for node in tree.GetChildNodes(tree.GetRootNode(), False)
    ],
    "bounds": list(reader.GetDataInformation().GetBounds()),
    "points": {}, "cells": {},
}
for time in reader.TimestepValues:
    reader.UpdatePipeline(time)
    for kind, data in (("points", reader.PointData), ("cells", reader.CellData)):
        for array in data:
            size = array.GetNumberOfComponents()
            ranges = [array.GetRange(k) for k in range(size)]
            found[kind].setdefault(array.GetName(), []).append(ranges)
print("FOUND" + json.dumps(found))
"""

# In a function: a programmable source writes its own names over those of the main module.
BUILD = """
import json, runpy, sys
from paraview import simple

def look():
    script = runpy.run_path(sys.argv[1], run_name="script")
    layout, view, time = script["joint"](simple.PVDReader(FileName=sys.argv[2]), arrows=True)
    sources = {}
    for (name, number), source in simple.GetSources().items():
        source.UpdatePipeline(time)
        sources.setdefault(type(source).__name__, []).append(
            [name, list(source.GetDataInformation().GetBounds())]
        )
    shown = [r for r in view.Representations if hasattr(r, "ColorArrayName")]
    charts = [v for v in simple.GetViews() if "Chart" in type(v).__name__]
    return {
        "time": time, "sources": sources,
        "annotations": list(simple.GetColorTransferFunction("contact_state").Annotations),
        "colours": [list(r.ColorArrayName) for r in shown],
        "curves": [
            [list(r.SeriesVisibility), r.XArrayName] for v in charts for r in v.Representations
        ],
    }

print("FOUND" + json.dumps(look(), default=lambda listed: listed.GetData()))
"""


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Full and reduced model of two plates, pulled apart along x."""
    lower = build_plate([("base", 0.2, 10), ("lower_joint", 0.1, 6)], 0.05, 4, prefix="lower_")
    upper = build_plate(
        [("joint", 0.1, 5), ("arm", 0.2, 10)], 0.05, 4, origin=(0.2, 0.0), prefix="upper_"
    )
    made = build_plate_structure(
        merged([lower, upper]), E=200e9, poisson=0.3, density=8e3, thickness=0.01,
        supports=[("lower_left", "xy")],
        joints=[PlateJoint("joint", "region", "lower_joint", 50e6, 0.7)],
    )  # fmt: skip
    patch, n = made.patches[0], made.nodes.shape[0]
    amplitude = np.sin(0.5 * np.pi * TIMES / TIMES[-1])[:, None]
    u = np.zeros((TIMES.size, n, 2))
    u[..., 0] = amplitude * LARGEST * made.nodes[:, 0] / 0.5
    state = np.full((TIMES.size, n), -1, dtype=np.int8)
    end = np.abs(made.nodes[patch.nodes, 0] - 0.25)
    state[:, patch.nodes] = (end > 0.05 - 0.03 * amplitude) | (amplitude >= 0.99)
    state[-1, patch.nodes] = end > 0.02
    traction = np.zeros_like(u)
    traction[:, patch.nodes, 0] = -35e6 * amplitude
    fields = [
        PlateField(name, u, u / 1e-3, traction, state, np.maximum(state, 0) * 7.0 * amplitude)
        for name in ("full", "reduced")
    ]
    pressure = np.zeros(n)
    pressure[patch.nodes] = 50e6
    path = tmp_path_factory.mktemp("series") / "fields.pvd"
    write_series(path, made, TIMES, fields, pressure)
    times = np.linspace(0.0, TIMES[-1], 100)
    write_load(path, LoadHistory(times, {"end": 60e3 * np.sin(0.5 * np.pi * times / TIMES[-1])}))
    return path


def in_paraview(code: str, *arguments: str | Path, folder: Path) -> dict[str, Any]:
    file = folder / "code.py"
    file.write_text(code)
    ended = subprocess.run(
        ["pvpython", str(file), *map(str, arguments)], capture_output=True, text=True, timeout=120.0
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith("FOUND")]
    return dict(json.loads(line.removeprefix("FOUND")))


@paraview
def test_paraview_reads_blocks_times_and_arrays(series: Path, tmp_path: Path) -> None:
    found = in_paraview(LOOK, series, folder=tmp_path)
    assert found["reader"] == "PVDReader"
    assert found["times"] == TIMES.tolist()
    assert found["blocks"] == [
        "full: body 1", "full: body 2", "reduced: body 1", "reduced: body 2"
    ]  # fmt: skip
    assert found["bounds"] == pytest.approx([0.0, 0.5, 0.0, 0.05, 0.0, 0.025])
    points = {name: np.array(ranges[-1]) for name, ranges in found["points"].items()}
    for name in ("displacement", "velocity", "friction_traction"):
        assert points[name].shape == (3, 2)
        np.testing.assert_array_equal(points[name][2], 0.0)
    np.testing.assert_allclose(points["displacement"][0], [0.0, LARGEST])
    np.testing.assert_allclose(points["velocity"][0], [0.0, LARGEST / 1e-3])
    # The pressed body feels the traction, the other one its reaction.
    np.testing.assert_allclose(points["friction_traction"][0], [-35e6, 35e6])
    np.testing.assert_allclose(points["pressure"], [[0.0, 50e6]])
    np.testing.assert_allclose(points["friction_work_density"], [[0.0, 7.0]])
    np.testing.assert_array_equal(points["slip_state"], [[-1, 1]])
    displaced = [ranges[0][1] for ranges in found["points"]["displacement"]]
    np.testing.assert_allclose(
        displaced, LARGEST * np.sin(0.5 * np.pi * TIMES / TIMES[-1]), atol=1e-12
    )
    cells = {name: np.array(ranges[-1]) for name, ranges in found["cells"].items()}
    np.testing.assert_array_equal(cells["contact_state"], [[-1, 1]])
    np.testing.assert_array_equal(cells["body"], [[0, 1]])
    np.testing.assert_allclose(cells["thickness"], [[0.01, 0.01]])


@paraview
def test_the_script_builds_what_it_is_to_show(series: Path, tmp_path: Path) -> None:
    found = in_paraview(BUILD, SCRIPT, series, folder=tmp_path)
    assert found["time"] == TIMES[-1]  # of the largest displacement
    warped = {name: bounds for name, bounds in found["sources"]["WarpByVector"]}
    assert set(warped) == {"full, displacement x 200", "reduced, displacement x 200"}
    reach = [bounds[1] for bounds in warped.values()]
    assert reach == pytest.approx([0.5 + 200 * LARGEST] * 2)
    full, reduced = (np.array(bounds).reshape(3, 2) for bounds in warped.values())
    # What the eye sees of a body reaches from its lower front edge to its upper rear one.
    assert reduced[1, 1] * 0.85 + reduced[2, 1] * 0.55 < full[1, 0] * 0.85 + full[2, 0] * 0.55
    assert found["annotations"] == ["-1", "no contact", "0", "stick", "1", "slip"]
    assert [colour for colour in found["colours"] if colour[1]] == [["CELLS", "contact_state"]] * 2
    assert len(found["sources"]["Glyph"]) == 2
    assert found["curves"] == [
        [["force on end, kN"], "time, ms"], [["now 1"], "time, ms"]
    ]  # fmt: skip


@paraview
def test_without_a_display_the_script_draws_or_says_what_is_missing(
    series: Path, tmp_path: Path
) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    picture = tmp_path / "a.png"
    ended = subprocess.run(
        ["pvpython", str(SCRIPT), str(series), str(picture)],
        capture_output=True, text=True, timeout=120.0, env=environment,
    )  # fmt: skip
    if ended.returncode == 0:  # built for EGL or OSMesa
        assert matplotlib.image.imread(picture).std() > 0.05
    else:
        assert ended.returncode == 1
        assert "xvfb-run" in ended.stderr
        assert "Traceback" not in ended.stderr
        assert not picture.exists()


@drawing
def test_the_script_draws_stick_slip_and_no_contact(series: Path, tmp_path: Path) -> None:
    picture = tmp_path / "a.png"
    command = ["pvpython", str(SCRIPT), str(series), str(picture)]
    if not os.environ.get("DISPLAY"):
        command = ["xvfb-run", "-a", *command]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=240.0)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    pixels = matplotlib.image.imread(picture)[..., :3]
    assert pixels.shape == (900, 1400, 3)
    joint = pixels[: int(0.6 * 900)]
    for colour in STATES.values():
        close = np.linalg.norm(joint - matplotlib.colors.to_rgb(colour), axis=-1) < 0.12
        assert close.mean() > 0.005, colour
    mark = np.linalg.norm(pixels[int(0.63 * 900) :] - (0.82, 0.12, 0.12), axis=-1) < 0.12
    assert mark.sum() > 20  # on the load's curve


def test_the_script_and_the_package_use_the_same_words_and_colours() -> None:
    text = SCRIPT.read_text(encoding="utf-8")
    for name, colour in STATES.items():
        parts = matplotlib.colors.to_rgb(colour)
        assert f'"{name}", ({", ".join(f"{part:.2f}" for part in parts)})' in text
